"""Scenes of Ricci et al. 2010: waters, targets, and their simulated measurements."""
