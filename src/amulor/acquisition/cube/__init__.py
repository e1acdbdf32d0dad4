"""Measurement cube of a scan, built from its journal."""
