"""The journal of a scan: nothing that was measured is lost."""
