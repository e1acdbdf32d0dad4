"""Instruments that are not there: a bench before a scene, and devices on it."""
