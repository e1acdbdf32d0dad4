"""The journal of a scan, an append-only file of its samples."""
