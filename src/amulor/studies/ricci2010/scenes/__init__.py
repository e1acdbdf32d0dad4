"""Simulated scenes of Ricci et al. 2010: waters, targets and measurements."""
