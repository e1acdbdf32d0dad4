"""From the journal of a scan to its measurement cube."""
