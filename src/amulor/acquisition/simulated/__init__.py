"""Simulated instruments: a bench in front of a scene, and devices on it."""
