"""Open-water reference of the water signal, truncated at the target's depth."""
