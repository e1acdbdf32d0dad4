"""Published experiments, repeated with amulor's public functions."""
