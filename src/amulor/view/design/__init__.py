"""Which instrument: figures, report and the page with sliders."""
