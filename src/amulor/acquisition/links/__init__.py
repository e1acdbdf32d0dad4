"""Links to instruments by VISA, serial port or network."""
