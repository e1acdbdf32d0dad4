"""Instrument design: figures, report and the page with sliders."""
