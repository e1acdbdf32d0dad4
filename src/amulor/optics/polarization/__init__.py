"""Stokes vectors and Mueller matrices: light, optical parts, targets, channels."""
