"""Reference for the water signal: open-water shots, and their cut at the target."""
