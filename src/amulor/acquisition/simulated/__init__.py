"""Simulated instruments: an optical bench in front of a scene, and its devices."""
