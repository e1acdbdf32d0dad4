"""Drivers of instruments, one file for each maker or model."""
