"""What stands in the water of Ricci et al. 2010, and what is seen of it."""
