"""Scenes of the trust study, one file for each kind of difficulty."""
