"""Instruments that scans drive: one maker or model a file."""
