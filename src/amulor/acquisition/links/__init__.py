"""Lines of text to and from an instrument, by VISA or by network."""
