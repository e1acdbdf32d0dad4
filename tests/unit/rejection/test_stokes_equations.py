"""Unmixing by Mueller matrices: chi-square by dense algebra, and its limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from amulor.errors import CubeError
from amulor.rejection import stokes
from amulor.rejection.covariance import Covariance
from amulor.rejection.stokes import _changed, _departure, _matrices, _States, _states

CHANNELS = ["VV", "VH", "RR", "RL"]
TARGET = np.diag([1.0, 0.4, -0.4, -0.2])
WATER = np.diag([1.0, 0.85, -0.85, -0.7])


def test_analyzers_pass_their_parts_of_both_matrices() -> None:
    found = _states((TARGET, WATER), CHANNELS)
    # (1 + m22) / 2 and (1 - m22) / 2; circular light keeps its sense by (1 - m44) / 2
    # of a mirror's reversal.
    target = np.array([0.7, 0.3, 0.4, 0.6])
    water = np.array([0.925, 0.075, 0.15, 0.85])
    assert set(np.round(found.target[2:] * 0.7, 9)) == {0.4, 0.6}
    assert_allclose(found.target[:2], target[:2] / 0.7)
    assert_allclose(found.water[:2], water[:2] / 0.7)
    assert_allclose(found.target[2:].sum(), 1 / 0.7)
    null = found.null()
    assert null.shape == (2, 4)
    assert_allclose(null @ found.target, 0, atol=1e-12)
    assert_allclose(null @ found.water, 0, atol=1e-12)
    assert_allclose(null @ null.T, np.eye(2), atol=1e-12)


def test_matrices_that_look_alike_are_refused() -> None:
    for off, refused in ((0.999, True), (1.001, False)):
        # The angle between both, of small sizes: half of its square.
        angle = off * stokes._SMALLEST_ANGLE
        share = 0.5 * np.array([1 + 0.4, 1 - 0.4])
        across = np.array([-share[1], share[0]])
        turned = np.cos(angle) * share + np.sin(angle) * across
        m22 = (turned[0] - turned[1]) / turned.sum()
        other = np.diag([1.0, m22, -m22, 0.0])
        if refused:
            with pytest.raises(CubeError, match="in the same proportions"):
                _states((TARGET, other), ["VV", "VH"])
        else:
            assert _states((TARGET, other), ["VV", "VH"]).water[0] > 0


def test_the_water_is_what_a_target_leaves_along_itself() -> None:
    rng = np.random.default_rng(1)
    states = _states((TARGET, WATER), CHANNELS)
    parts = rng.standard_normal((2, 2, 3, 4, 5))
    target, water = parts[:, 0] + 1j * parts[:, 1]
    signal = (
        states.target[:, None, None] * target[:, None]
        + states.water[:, None, None] * water[:, None]
    )
    assert_allclose(states.water_of(signal, target), water)
    across = states.null()[0][:, None, None]
    assert_allclose(states.water_of(signal + across, target), water)


def test_elements_are_changed_one_after_the_other() -> None:
    found = list(_changed((TARGET, WATER), CHANNELS, 0.02))
    plain = _states((TARGET, WATER), CHANNELS)
    # Of m33 linear and circular analyzers see nothing.
    assert len(found) == 4
    # Towards zero, by the whole uncertainty.
    expected = _states((np.diag([1.0, 0.38, -0.4, -0.2]), WATER), CHANNELS)
    assert_allclose(found[0].target, expected.target)
    assert_allclose(found[0].water, expected.water)
    assert_allclose(found[2].target, plain.target)
    less = np.diag([1.0, 0.83, -0.85, -0.7])
    assert_allclose(found[2].water, _states((TARGET, less), CHANNELS).water)
    assert list(_changed((TARGET, WATER), CHANNELS, 0.0)) == []
    assert len(list(_changed((TARGET, WATER), ["VV", "VH"], 0.02))) == 2


def test_the_chance_of_a_departure_is_that_of_dense_algebra() -> None:
    rng = np.random.default_rng(2)
    states = _states((TARGET, WATER), CHANNELS)
    changed = list(_changed((TARGET, WATER), CHANNELS, 0.02))
    parts = rng.standard_normal((6, 2, 4, 1, 3))
    target, water = 1 + 0.1 * parts[:2, :, 0] + 0j
    target, water = target * np.exp(0.4j), water * 0.5
    signal = (
        states.target[:, None, None] * target[:, None]
        + states.water[:, None, None] * water[:, None]
        + 0.02 * (parts[2] + 1j * parts[3])
    )
    variance = 0.02**2 * (1 + 0.3 * np.abs(parts[4:]))
    errors = Covariance(variance[0], variance[1], 0 * variance[0])
    found = _departure(signal, states, changed, errors, target, water)
    null = states.null()
    for j in range(3):
        square = 0.0
        for f in range(2):
            rest = null @ signal[f, :, 0, j]
            mean = np.diag((variance[0] + variance[1])[f, :, 0, j] / 2)
            total = (null @ mean @ null.T).astype(complex)
            for part in changed:
                moved = null @ (
                    part.target * target[f, 0, j] + part.water * water[f, 0, j]
                )
                total += np.outer(moved, moved.conj()) / 2
            square += (rest.conj() @ np.linalg.solve(total, rest)).real
        # Two outputs of two combinations of two frequencies.
        assert found[0, j] == pytest.approx(chi2.sf(square, 8), rel=1e-6)


def scan_of(targets: bool = True) -> Any:
    mueller = (0.4, -0.4, -0.2)
    survey = SimpleNamespace(
        targets=[SimpleNamespace(mueller=mueller)] if targets else []
    )
    return SimpleNamespace(survey=survey)


def test_matrices_come_from_arguments_or_the_survey(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        stokes, "water_properties",
        lambda survey: SimpleNamespace(backscatter_mueller=(0.85, -0.85, -0.7)),
    )  # fmt: skip
    target, water = _matrices(scan_of(), None, None)
    assert_allclose(target, TARGET)
    assert_allclose(water, WATER)
    target, water = _matrices(scan_of(), (0.1, 0.2, 0.3), np.eye(4))
    assert_allclose(target, np.diag([1.0, 0.1, 0.2, 0.3]))
    assert_allclose(water, np.eye(4))
    bare: Any = SimpleNamespace(survey=None)
    for scan in (bare, scan_of(targets=False)):
        with pytest.raises(CubeError, match="no target with a Mueller matrix"):
            _matrices(scan, None, WATER)
    with pytest.raises(CubeError, match="no survey with the Mueller matrix of its wa"):
        _matrices(bare, TARGET, None)
    for wrong in (np.ones(4), np.ones((3, 3)), 1.0):
        with pytest.raises(ValueError, match="target_mueller must be three elements"):
            _matrices(scan_of(), wrong, WATER)
        with pytest.raises(ValueError, match="water_mueller must be three elements"):
            _matrices(scan_of(), TARGET, wrong)


@pytest.mark.parametrize(
    ("channels", "suits"),
    [(["VV", "VH"], False), (["VV", "VH", "RR"], True), (["VV", "VH", "VR"], False),
     (["VV", "RR", "none"], False)],
)  # fmt: skip
def test_two_launched_states_of_three_channels_test_the_matrices(
    channels: list[str], suits: bool
) -> None:
    cube: Any = SimpleNamespace(amulor=SimpleNamespace(polarizations=channels))
    assert (stokes._unsuited(cube, None) == "") == suits


def test_states_of_one_direction_have_no_null_space() -> None:
    states = _States(target=np.array([1.0, 0.4]), water=np.array([1.3, 0.1]))
    assert states.null().shape == (0, 2)
