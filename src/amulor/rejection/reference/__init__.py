"""Reference for the water signal: open-water shots, limited to the target's depth."""
