"""Change between two visits with its significance, and motion of objects."""
