"""Light by the length of its path: each length turns the phase and is absorbed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.transport.tally import PathRecord

SPEED = 299792458.0


def test_each_length_counts_with_its_phase_and_its_absorption() -> None:
    found = PathRecord(
        length=np.array([1.0, 4.0]),
        water=np.array([[0.5, 0.1], [0.0, 0.0]]),
        target=np.array([[0.0, 0.0], [2.0, -0.3]]),
        beyond=0.0,
    )
    frequency = np.array([0.0, 50e6])
    stokes = found.stokes(frequency, group_index=1.36, more_absorption=0.2)
    turn = 2j * np.pi * frequency * 1.36 / SPEED
    near, far = (np.exp(turn * length - 0.2 * length) for length in (1.0, 4.0))
    assert_allclose(stokes[:, 0], 0.5 * near + 2.0 * far, rtol=1e-12)
    assert_allclose(stokes[:, 1], 0.1 * near - 0.3 * far, rtol=1e-12)
    with pytest.raises(ValueError, match="at least 0 1/m"):
        found.stokes(frequency, group_index=1.36, more_absorption=-0.1)
