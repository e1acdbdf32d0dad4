"""Properties of the water itself: index, absorption, scattering, named waters."""
