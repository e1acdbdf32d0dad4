"""Change between two visits to a site, its significance, and moved objects."""
