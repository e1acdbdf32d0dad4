"""Polarization channels: which there are, how they mix target and water."""
