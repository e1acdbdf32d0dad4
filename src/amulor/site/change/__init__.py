"""Change between two visits to a site, its significance, and motion of objects."""
