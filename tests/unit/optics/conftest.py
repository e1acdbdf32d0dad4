"""Mueller matrices of Jones matrices, by the fields themselves."""

import numpy as np
import pytest

from amulor.optics.polarization import stokes


@pytest.fixture(scope="session")
def mueller_of():
    """Return what makes a Mueller matrix of a Jones matrix, from five fields."""

    def make(jones):
        half = np.sqrt(0.5)
        fields = [[1, 0], [0, 1], [half, half], [half, -half], [half, -1j * half]]
        out = np.array(fields) @ jones.T
        h, v, p, m, r = stokes.from_field(out[:, 0], out[:, 1])
        intensity = (h + v) / 2
        return np.stack([intensity, (h - v) / 2, (p - m) / 2, r - intensity], axis=-1)

    return make


@pytest.fixture(scope="session")
def turned():
    """Return what turns the Jones matrix of an element about the beam."""

    def make(jones, angle):
        cosine, sine = np.cos(angle), np.sin(angle)
        rotation = np.array([[cosine, -sine], [sine, cosine]])
        return rotation @ jones @ rotation.T

    return make
