"""Studies: published experiments repeated, and tests of the rejection methods."""
