"""Target and water estimated together, by maximum likelihood."""
