"""Commands for the design of instruments."""
