"""The command that writes sample data."""
