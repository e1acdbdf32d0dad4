"""Reproduction of Ricci et al. 2010: figures 1 and 3 to 15, and checked statements."""
