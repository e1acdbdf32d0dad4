"""Compiled loops of the joint estimation."""
