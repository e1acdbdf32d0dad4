"""Integrals of an oscillating function over the depth, panel by panel."""
