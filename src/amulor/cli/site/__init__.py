"""Commands for sites: many scans, one frame."""
