"""Compiled loops of instrument design."""
