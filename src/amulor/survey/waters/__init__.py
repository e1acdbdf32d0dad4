"""Kinds of water: their optical properties and phase functions."""
