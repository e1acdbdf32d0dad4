"""What is stated of a site before it is put together: scans, targets, control."""
