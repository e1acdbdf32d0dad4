"""Compiled loops of the photon transport."""
