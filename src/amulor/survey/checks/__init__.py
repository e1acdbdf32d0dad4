"""What a survey file must keep to be about an instrument that can exist."""
