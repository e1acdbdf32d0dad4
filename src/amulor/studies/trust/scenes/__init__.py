"""The scenes of the trust study: what can go wrong, one kind a file."""
