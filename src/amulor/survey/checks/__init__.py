"""What a survey must keep to be of an instrument that can exist, and to fit memory."""
