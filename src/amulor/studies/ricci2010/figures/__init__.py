"""The figures of Ricci et al. 2010, one a file."""
