"""Figures 1 and 3-15 of Ricci et al. 2010, redrawn, with what the text says of them."""
