"""The misfit of empty water is that of normal errors with a departure of the water."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.cube.tiles import Span
from amulor.rejection.covariance import Covariance
from amulor.rejection.reference.presence import (
    DEPARTURE,
    CutColumns,
    _cut_columns,
    _Problem,
    _problem,
)
from amulor.survey import Survey

SAMPLES = 4


def _drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, Covariance]:
    """Return what is left, water, 2 x 2 covariances of one pixel, and these again."""
    rng = np.random.default_rng(seed)
    left, water = (
        rng.standard_normal((SAMPLES, 1)) + 1j * rng.standard_normal((SAMPLES, 1))
        for _ in range(2)
    )
    root = rng.standard_normal((SAMPLES, 2, 2))
    each = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
    errors = Covariance(each[:, :1, 0], each[:, 1:, 1], each[:, :1, 1])
    return left, water, each, errors


def _stacked(values: np.ndarray) -> np.ndarray:
    return np.stack([values[:, 0].real, values[:, 0].imag], axis=1).ravel()


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0, 1))
def test_a_departure_of_the_water_counts_as_an_error_that_samples_share(
    seed: int, share: float
) -> None:
    left, water, each, errors = _drawn(seed)
    problem = _problem(left, water, errors, np.arange(SAMPLES), None)
    found = problem.misfit(np.array([share + 0j]))
    rest, front = _stacked(left + share * water), _stacked((1 - share) * water)
    whole = np.zeros((2 * SAMPLES, 2 * SAMPLES))
    for k in range(SAMPLES):
        whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = each[k]
    whole += DEPARTURE**2 * np.outer(front, front)
    assert_allclose(found, rest @ np.linalg.solve(whole, rest), rtol=1e-9)


def test_saturated_samples_say_nothing_about_a_target() -> None:
    left, water, _, errors = _drawn(3)
    first = np.arange(SAMPLES) < 1
    problem = _problem(left, water, errors, np.arange(SAMPLES), first[:, None])
    parts = (part[1:] for part in (errors.in_phase, errors.quadrature, errors.cross))
    without = _problem(
        left[1:], water[1:], Covariance(*parts), np.arange(1, SAMPLES), None
    )
    share = np.array([0.3 + 0j])
    assert_allclose(problem.misfit(share), without.misfit(share), rtol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0, 0.5))
def test_what_no_cut_can_undercut_is_below_each_of_them(
    seed: int, share: float
) -> None:
    left, water, _, errors = _drawn(seed)
    problem = _problem(left, water, errors, np.arange(SAMPLES), None)
    least = problem.surely_more_than(np.full(SAMPLES, share))
    turned = share * np.exp(1j * np.random.default_rng(seed).uniform(0, 6.3, SAMPLES))
    for part in (1.0, 0.5, 0.0):
        assert least <= problem.misfit(part * turned[:, None]) + 25
    # Without any share the bound is the misfit but for the departure.
    alone = problem.surely_more_than(np.full(SAMPLES, -5 * DEPARTURE))
    assert alone <= problem._product(left, left) * (1 + 1e-9)


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0, 0.5))
def test_the_bound_of_all_cuts_has_the_least_weight_of_each_sample(
    seed: int, share: float
) -> None:
    left, water, each, errors = _drawn(seed)
    left[0] *= 100
    limits = share + np.array([0.0, 0.1, 0.2])
    which = np.array([0, 1, 1, 2])
    found = _problem(left, water, errors, which, None).surely_more_than(limits)
    # Each frequency by its own limit, and five times a departure of 5 % of the water.
    free = np.abs(left[:, 0]) - (limits[which] + 5 * 0.05) * np.abs(water[:, 0])
    least = np.linalg.eigvalsh(np.linalg.inv(each))[:, 0]
    assert_allclose(found, np.sum(least * np.maximum(free, 0) ** 2), rtol=1e-9)


def test_samples_without_number_or_error_do_not_count() -> None:
    left, water, _, errors = _drawn(5)
    left[0], water[1] = np.nan, np.inf
    errors.in_phase[2], errors.cross[2] = 0.0, 0.0
    problem = _problem(left, water, errors, np.arange(SAMPLES), None)
    assert problem.count.tolist() == [1]
    assert np.isfinite(problem.misfit(np.array([0.2 + 0j]))).all()


@pytest.mark.parametrize("depth", [1.9, 2.0, 2.61])
def test_water_that_ends_between_two_depths_is_found_there(depth: float) -> None:
    wavenumber, fraction, sigma = np.array([2.0, 3.0]), 0.3, 0.01
    nodes = np.linspace(1.0, 3.0, 9)
    columns = CutColumns(
        smooth=np.full((2, 9, 2, 2), fraction, dtype=complex),
        depth=nodes,
        wavenumber=wavenumber,
    )
    hidden = fraction * np.exp(2j * wavenumber * depth)[:, None]
    pixels = _Problem(
        difference=-hidden,
        water=np.ones((2, 1), dtype=complex),
        in_phase=np.full((2, 1), sigma**-2),
        quadrature=np.full((2, 1), sigma**-2),
        cross=np.zeros((2, 1)),
        frequency=np.arange(2),
    )
    middle = np.array([0.5])
    # Depths 4 mm apart are tried: at 3 rad/m, an angle of 0.024 of 0.3 at most.
    assert columns.lowest(pixels, middle, middle)[0] < 2 * (0.3 * 0.024 / sigma) ** 2
    # At the nodes alone, it is 0.3 times an angle of 0.2 and more, but for 2 m.
    other = np.delete(nodes, np.argmin(np.abs(nodes - depth)))
    turns = np.exp(2j * np.outer(wavenumber, other))
    least = min(pixels.misfit(fraction * turn[:, None])[0] for turn in turns.T)
    assert least > 20


def test_columns_begin_with_all_of_the_water_and_end_with_none(plate: Survey) -> None:
    frequency = np.array([20e6, 80e6])
    span = Span(azimuth=(0.02, 0.02), elevation=(-0.01, 0.01))
    turbid = plate.with_({"water.absorption": "1.2 1/m"})

    def columns(survey: Survey, interval: tuple[float, float] | None) -> CutColumns:
        return _cut_columns(survey, frequency, interval, span, paper=False)

    found = columns(turbid, None)
    wave = 2 * np.pi * frequency * 1.38 / speed_of_light
    assert_allclose(found.wavenumber, wave, rtol=1e-12)
    assert found.depth[0] == 0
    assert_allclose(np.diff(found.depth, 2), 0, atol=1e-9)
    # Eight depths or more for each turn of the highest frequency.
    assert np.diff(found.depth).max() < speed_of_light / (2 * 1.38 * 80e6) / 8
    turn = np.exp(2j * np.multiply.outer(wave, found.depth))
    fractions = found.smooth * turn[:, :, None, None]
    assert_allclose(fractions[:, 0], 1, rtol=1e-6)
    assert np.abs(fractions[:, -1]).max() < 1e-2
    near = columns(turbid, (1.0, 2.0)).depth
    assert (near[0], near[-1]) == (1.0, 2.0)
    tank = columns(turbid.with_({"water.column_end": "1.7 m"}), None)
    assert tank.depth[-1] == pytest.approx(1.7)
    assert_allclose(tank.smooth[:, -1], 0, atol=1e-6)
