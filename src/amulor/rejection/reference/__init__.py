"""The water signal alone: measured in open water, fitted, cut off at the target."""
