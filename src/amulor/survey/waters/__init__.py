"""Kinds of water, with their optical properties and phase functions."""
