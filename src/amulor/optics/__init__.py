"""Formulas of underwater modulated-laser imaging: arrays in, arrays out."""
