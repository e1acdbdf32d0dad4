"""Targets in the pixels of a scan, against open water and columns that end early."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from amulor.cube.tiles import Span
from amulor.rejection.covariance import Covariance
from amulor.rejection.reference import presence
from amulor.rejection.reference.presence import CutColumns, shows_target

SHAPE = (2, 2, 3, 4)
#: Standard error of each output, of samples and of the reference together [V].
ERROR = 1e-3


def scan_of(
    difference: Any,
    *,
    saturated: Any = None,
    turbidity: Any = None,
    drift: complex = 0.0,
    water: Any = None,
) -> tuple[Any, Any]:
    """Return a scan and the water before its targets, with half of the errors each."""
    half = Covariance(
        *(np.full(SHAPE, v) for v in (0.5 * ERROR**2, 0.5 * ERROR**2, 0.0))
    )
    elevation, azimuth = np.meshgrid(
        np.linspace(-0.1, 0.1, 3), np.linspace(-0.3, 0.3, 4), indexing="ij"
    )
    scan = SimpleNamespace(
        covariance=half,
        saturated=saturated,
        frequency=np.array([20e6, 60e6]),
        azimuth=azimuth,
        elevation=elevation,
    )
    span = Span(azimuth=(-0.3, 0.3), elevation=(-0.1, 0.1))
    before = SimpleNamespace(
        to_the_end=np.full(SHAPE, 0.2 + 0.1j) if water is None else water,
        difference=np.broadcast_to(difference, SHAPE).astype(complex),
        common=half,
        fits=[],
        estimated_turbidity=turbidity,
        drift=np.full((2, 2, 1, 1), drift),
        fit=SimpleNamespace(shots=SimpleNamespace(span=span)),
    )
    return scan, before


@pytest.fixture(autouse=True)
def steady(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the water not fluctuate."""
    none = Covariance(*(np.zeros(SHAPE) for _ in range(3)))
    monkeypatch.setattr(presence, "fluctuation_of", lambda *_: none)


def across(size: float) -> complex:
    """Return light a quarter of a turn off the water."""
    return size * 1j * (0.2 + 0.1j) / abs(0.2 + 0.1j)


@pytest.mark.parametrize("factor", [0.999, 1.001])
def test_a_target_is_one_in_a_hundred_thousand(factor: float) -> None:
    # Four samples have eight degrees of freedom. Across the water no change of it
    # explains what is left.
    limit = chi2.isf(1e-5, 8)
    off = across(factor * ERROR * np.sqrt(limit / 4))
    difference = np.zeros(SHAPE, dtype=complex)
    difference[:, :, 1, 2] = off
    found, cut, chance = shows_target(*scan_of(difference), interval=None)
    expected = np.zeros(SHAPE[2:], dtype=bool)
    expected[1, 2] = factor > 1
    assert_array_equal(found, expected)
    assert cut is None
    assert_allclose(chance[~expected & (difference[0, 0] == 0)], 1.0)
    if factor < 1:
        assert chance[1, 2] == pytest.approx(chi2.sf(factor**2 * limit, 8))
    else:
        assert np.isnan(chance[1, 2])


def test_a_change_of_all_water_by_a_twentieth_is_no_target() -> None:
    # Along the water the departure counts: chi-square of a factor c is c^2 / 0.05^2.
    for factor, target in ((0.25, False), (0.35, True)):
        found, _, chance = shows_target(*scan_of(factor * (0.2 + 0.1j)), interval=None)
        assert found.all() == target
        if not target:
            assert_allclose(chance, chi2.sf((factor / 0.05) ** 2, 8), rtol=0.05)


def test_overloaded_and_lost_samples_do_not_count() -> None:
    difference = np.full(SHAPE, across(20 * ERROR))
    saturated = np.zeros(SHAPE, dtype=bool)
    saturated[..., 0, 0] = True
    saturated[0, 0] = True
    difference[0, 1] = 0.0
    difference[1, :, 0, 1] = 0.0
    difference[1, 0, 2, 3] = difference[1, 1, 2, 3] = np.nan
    found, _, chance = shows_target(
        *scan_of(difference, saturated=saturated), interval=None
    )
    expected = np.ones(SHAPE[2:], dtype=bool)
    # No sample, samples without light, and lost ones beside them.
    expected[0, 0] = expected[0, 1] = expected[2, 3] = False
    assert_array_equal(found, expected)
    expected[0, 0] = True
    assert_array_equal(np.isnan(chance), expected)
    assert chance[0, 1] == pytest.approx(1.0)


def test_a_drift_of_the_shots_is_an_error_along_itself() -> None:
    # The variance of a line from -1/2 to 1/2 is a twelfth of its square.
    off = across(6 * ERROR)
    plain, _, _ = shows_target(*scan_of(off), interval=None)
    assert plain.all()
    drift = 1j * 6 * ERROR / abs(0.2 + 0.1j)
    drifting, _, chance = shows_target(*scan_of(off, drift=drift), interval=None)
    assert not drifting.any()
    variance = 1 + 36 / 12
    assert_allclose(chance, chi2.sf(4 * 36 / variance, 8), rtol=1e-6)


def test_pixels_in_blocks_have_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    difference = 4 * ERROR * (rng.standard_normal(SHAPE) + 1j * rng.random(SHAPE))
    saturated = rng.random(SHAPE) < 0.2
    whole = shows_target(*scan_of(difference, saturated=saturated), interval=None)
    monkeypatch.setattr(presence, "_AT_ONCE", 5)
    parts = shows_target(*scan_of(difference, saturated=saturated), interval=None)
    assert whole[0].any()
    assert not whole[0].all()
    assert_array_equal(parts[0], whole[0])
    assert_allclose(parts[2], whole[2])


def columns() -> CutColumns:
    """Return water of which 50, 30 and 0 % lie behind three depths."""
    smooth = np.zeros((2, 3, 2, 2), dtype=complex)
    smooth[:, 0], smooth[:, 1] = 0.5, 0.3
    # The other end of the scan has less.
    smooth[:, :, :, 1] *= 0.5
    return CutColumns(
        smooth=smooth, depth=np.array([1.0, 1.5, 2.0]), wavenumber=np.zeros(2)
    )


@pytest.mark.parametrize("known", [False, True])
def test_a_shadow_is_no_target_where_a_survey_describes_the_water(
    known: bool,
) -> None:
    # A dark object takes 40 % of the water away; on the right less would be left.
    turbidity = SimpleNamespace(shown=0.0) if known else None
    scan, before = scan_of(-0.4 * (0.2 + 0.1j), turbidity=turbidity)
    found, cut, chance = shows_target(
        scan, before, interval=None, fit=columns() if known else None
    )
    if not known:
        assert found.all()
        return
    assert cut is not None
    assert_array_equal(found[:, 0], False)
    assert_array_equal(found[:, 3], True)
    assert (chance[:, 0] > 0.9).all()


@pytest.mark.parametrize("shown", [0.0, 0.05])
@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_a_model_of_columns_has_an_error_of_two_percent(
    shown: float, factor: float
) -> None:
    # Light across the water before a dark object. The error of the model is that of
    # both outputs together, beside the part that the shots show.
    water = abs(0.2 + 0.1j)
    variance = ERROR**2 + water**2 * np.hypot(0.02, shown) ** 2 / 2
    size = factor * np.sqrt(chi2.isf(1e-5, 8) / 4 * variance)
    scan, before = scan_of(
        across(size) - 0.4 * (0.2 + 0.1j), turbidity=SimpleNamespace(shown=shown)
    )
    found, _, _ = shows_target(scan, before, interval=None, fit=columns())
    assert_array_equal(found[:, 0], factor > 1)


def test_a_cut_is_computed_once_from_the_corrected_survey(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[Any] = []

    def cut_columns(*arguments: Any, **options: Any) -> CutColumns:
        given.append((arguments, options))
        return columns()

    monkeypatch.setattr(presence, "_cut_columns", cut_columns)
    turbidity = SimpleNamespace(shown=0.0, survey="survey", paper=True)
    scan, before = scan_of(0.0, turbidity=turbidity)
    _, cut, _ = shows_target(scan, before, interval=(1.0, 2.0))
    ((survey, frequency, interval, span), options) = given[0]
    assert (survey, interval, options) == ("survey", (1.0, 2.0), {"paper": True})
    assert_array_equal(frequency, scan.frequency)
    assert span is before.fit.shots.span
    again = shows_target(scan, before, interval=(1.0, 2.0), fit=cut)
    assert again[1] is cut
    assert len(given) == 1


def test_places_of_pixels_are_counted_in_nodes() -> None:
    found = presence._places(np.array([[-0.3, 0.0], [0.15, 0.3]]), -0.3, 0.3)
    assert_allclose(found, [0.0, 2.0, 3.0, 4.0])
    assert_array_equal(presence._places(np.array([0.1, 0.1]), 0.1, 0.1), [0.0, 0.0])
    assert_allclose(presence._nodes(-0.3, 0.3), [-0.3, -0.15, 0.0, 0.15, 0.3])
    assert_allclose(presence._nodes(0.1, 0.1), [0.1])
    first, share = presence._between(np.array([-0.2, 0.0, 1.25, 4.0, 4.5]), 5)
    assert_array_equal(first, [0, 0, 1, 3, 3])
    assert_allclose(share, [-0.2, 0.0, 0.25, 1.0, 1.5])
    first, share = presence._between(np.array([0.0, 0.0]), 1)
    assert_array_equal(first, [0, 0])
