"""Where a scan stands follows from three targets that are not on a line."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from amulor.errors import CubeError
from amulor.site.registration.network import Centre
from amulor.site.registration.register import _guessed

TURN = Rotation.from_rotvec([0.3, -0.8, 1.1]).as_matrix()
SHIFT = np.array([0.4, -2.0, 1.5])
TARGETS = np.array([[0.0, 0.0, 2.0], [1.0, 0.1, 2.5], [-0.2, 0.8, 3.0]])


def _seen(targets: np.ndarray) -> tuple[Any, tuple[Centre, ...]]:
    """Return two scans, the second turned and shifted, and their targets."""
    site = SimpleNamespace(scan=[SimpleNamespace(name=name) for name in "ab"])
    centres = tuple(
        Centre(
            target=f"t{number}",
            scan=scan,
            position=place,
            covariance=1e-6 * np.eye(3),
            shared={},
        )
        for scan, places in (("a", targets), ("b", (targets - SHIFT) @ TURN))
        for number, place in enumerate(places)
    )
    return site, centres


def test_three_targets_tell_the_pose() -> None:
    site, centres = _seen(TARGETS)
    found = _guessed(site, centres, {}, {}, "a")
    assert list(found) == ["b"]
    assert_allclose(found["b"].place((TARGETS - SHIFT) @ TURN), TARGETS, atol=1e-12)


def test_targets_on_a_line_do_not() -> None:
    line = np.array([[0.0, 0.0, 2.0], [0.5, 0.2, 2.0], [1.0, 0.4, 2.0]])
    site, centres = _seen(line)
    with pytest.raises(CubeError, match="scan 'b': its 3 targets stand on a line"):
        _guessed(site, centres, {}, {}, "a")
    # Two of them are too few to ask.
    assert _guessed(site, centres[:2] + centres[3:5], {}, {}, "a") == {}
