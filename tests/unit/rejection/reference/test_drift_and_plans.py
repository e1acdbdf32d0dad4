"""Drifts of references, plans of shots, and hidden columns, by given numbers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.stats import chi2, norm, t

from amulor.cube.tiles import Span
from amulor.errors import CubeError
from amulor.rejection.reference import grid, instrument, shots
from amulor.rejection.reference.column import hidden_error
from amulor.rejection.reference.shots import drift_of
from amulor.survey import OpenWater

FREQUENCY = np.array([20e6, 50e6, 90e6])
RATE = 2 * np.pi * FREQUENCY


def drift_with(
    monkeypatch: pytest.MonkeyPatch, change: np.ndarray, error: np.ndarray
) -> Any:
    """Return the drift of references whose halves differ by a given change."""
    shots = SimpleNamespace(signal=np.ones((*change.shape, 8), dtype=complex))
    monkeypatch.setattr(
        instrument, "Observation", lambda cube: SimpleNamespace(shots=shots)
    )
    monkeypatch.setattr(instrument, "directions_of", lambda *_: np.zeros((8, 2)))
    monkeypatch.setattr(instrument, "_halves", lambda *_: (change, error))
    count = len(change)
    cube: Any = xr.Dataset({"modulation_frequency": ("f", FREQUENCY[:count])})
    return instrument.drift_of_references(cube)


ERROR = np.array([[1e-3, 2e-3], [2e-3, 1e-3], [1e-3, 1e-3]])


def test_one_delay_stands_for_all_frequencies(monkeypatch: pytest.MonkeyPatch) -> None:
    noise = np.array([[1e-4, -2e-4], [1e-4, 0.0], [-1e-4, 1e-4]])
    change = 1j * (RATE[:, None] * 1e-10 + noise) + 0.001
    found = drift_with(monkeypatch, change, ERROR)
    # Least squares of all six phases.
    rate = RATE[:, None] * np.ones(2)
    information = np.sum((rate / ERROR) ** 2)
    delay = np.sum(rate * change.imag / ERROR**2) / information
    assert_allclose(found.phase, RATE * delay)
    assert_allclose(found.uncertainty, RATE / np.sqrt(information))


def test_phases_that_are_no_delay_stay_as_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    phase = np.array([0.02, 0.0201, 0.0199])
    found = drift_with(monkeypatch, 1j * phase[:, None] * np.ones(2), ERROR)
    assert_allclose(found.phase, phase)
    uncertainty = np.sum(ERROR**-2, axis=1) ** -0.5
    assert_allclose(found.uncertainty, uncertainty)
    # On both sides of the chance at which a delay is refused.
    information = np.sum((RATE / uncertainty) ** 2)
    across = np.array([1.0, -1.0, 0.3]) * uncertainty
    across -= RATE * np.sum(RATE * across / uncertainty**2) / information
    across /= np.sqrt(np.sum((across / uncertainty) ** 2))
    limit = np.sqrt(chi2.isf(1e-3, 2))
    for factor, is_delay in ((0.999, True), (1.001, False)):
        phase = RATE * 2e-10 + factor * limit * across
        found = drift_with(monkeypatch, 1j * phase[:, None] * np.ones(2), ERROR)
        assert np.allclose(found.phase / (RATE * 2e-10), 1.0, rtol=1e-6) == is_delay


def test_channels_that_turn_apart_are_no_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    weight = ERROR**-2
    split = np.array([1.0, -1.0]) * weight[:, ::-1] / weight.sum(axis=1, keepdims=True)
    split /= np.sqrt(np.sum(weight * split**2))
    limit = np.sqrt(chi2.isf(1e-3, 3))
    for factor, agrees in ((0.999, True), (1.001, False)):
        change = 1j * (RATE[:, None] * 2e-10 + factor * limit * split)
        assert (drift_with(monkeypatch, change, ERROR) is not None) == agrees
    # One channel agrees with itself.
    alone = drift_with(monkeypatch, 1j * RATE[:, None] * 2e-10, ERROR[:, :1])
    assert_allclose(alone.phase, RATE * 2e-10)


def test_a_drift_is_significant_and_no_change_of_strength(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sigma = np.sum(ERROR[0] ** -2) ** -0.5
    for factor, found in ((0.999, False), (1.001, True)):
        size = factor * 6.0 * sigma
        change = np.zeros((3, 2), dtype=complex)
        change[0] = 1j * size
        assert (drift_with(monkeypatch, change, ERROR) is not None) == found
    turned = 1j * RATE[:, None] * 2e-10 * np.ones(2)
    for real, found in ((0.999, True), (1.001, False)):
        stronger = turned + real * np.abs(turned).max()
        assert (drift_with(monkeypatch, stronger, ERROR) is not None) == found


def test_half_of_a_drift_is_removed_from_the_scan(
    monkeypatch: pytest.MonkeyPatch, by_hand: Any
) -> None:
    cube = by_hand(frequency=[20e6, 60e6], channels={"VV": (1.0, 1.0)}, shots=7)
    phase, error = np.array([0.02, 0.05]), np.array([1e-3, 2e-3])
    drift = instrument.PhaseDrift(phase=phase, uncertainty=error)
    monkeypatch.setattr(instrument, "drift_of_references", lambda cube: drift)
    found = instrument.without_drift(cube)
    turn = (found.amulor.signal / cube.amulor.signal).values
    assert_allclose(np.angle(turn), -phase[:, None, None, None] / 2 + 0 * turn.real)
    before, after = (
        part["open_water_in_phase"] + 1j * part["open_water_quadrature"]
        for part in (cube, found)
    )
    turned = np.angle((after / before).values)
    # The second half of the shots, beginning with the fourth of seven.
    assert_allclose(turned[..., :3], 0, atol=1e-12)
    assert_allclose(turned[..., 3:], -phase[:, None, None] + 0 * turned[..., 3:])
    rate = 2 * np.pi * np.array([20e6, 60e6])
    assert_allclose(found.attrs["instrument_drift_delay_s"], phase / rate)
    left = np.sqrt(phase**2 / 12 + error**2 / 4)
    assert_allclose(found.attrs["instrument_drift_uncertainty_s"], left / rate)


def test_a_drift_of_shots_is_a_line_over_their_order() -> None:
    rng = np.random.default_rng(1)
    where = np.repeat([[0.0, 0.0], [1.0, 0.0]], 3, axis=0)[[0, 3, 1, 4, 2, 5]]
    level: Any = np.array([1.0, 2j])[[0, 1] * 3]
    order = np.linspace(-0.5, 0.5, 6)
    parts = 1e-3 * rng.standard_normal((2, 6))
    shots = level * (1 + (0.1 + 0.02j) * order + parts[0] + 1j * parts[1] + 0.3)
    found = drift_of(shots, level, where)
    relative = shots / level - 1
    design = np.stack([order, where[:, 0] == 0, where[:, 0] == 1], axis=1).astype(float)
    solve = np.linalg.pinv(design)
    chances = []
    for part, name in ((relative.real, "real"), (relative.imag, "imag")):
        best = solve @ part
        rest = part - design @ best
        error = np.sqrt(rest @ rest / 3 * (solve @ solve.T)[0, 0])
        assert getattr(found.change, name) == pytest.approx(best[0])
        assert getattr(found.uncertainty, name) == pytest.approx(error)
        chances.append(2 * t.sf(abs(best[0]) / error, 3))
    # The smaller chance of two.
    assert found.chance == pytest.approx(2 * min(chances))
    steady = drift_of(level.copy(), level, where)
    assert (steady.change, steady.chance) == (0j, 1.0)
    assert drift_of(shots[:4], level[:4], where[:4]).chance <= 1.0
    few = drift_of(shots[:3], level[:3], where[:3])
    assert np.isinf(few.uncertainty.real)


@pytest.mark.parametrize(("frequencies", "factor"), [(1, 1.0), (3, 6.0)])
def test_errors_of_hidden_water_are_those_of_turbidity_and_model(
    frequencies: int, factor: float
) -> None:
    rng = np.random.default_rng(2)
    shape = frequencies, 1, 2, 2

    def drawn(size: float) -> Any:
        parts = rng.standard_normal((2, *shape))
        return size * (parts[0] + 1j * parts[1])

    water, hidden = drawn(1.0), drawn(0.2)
    steeper = hidden + drawn(0.05)
    hidden[:, 0, 0, 0], hidden[:, 0, 0, 1] = np.nan, 1e-6
    found = hidden_error(water, hidden, steeper, misfit=0.03)
    size = np.abs(np.nan_to_num(hidden) * water)
    # A part of the column is off as much as the whole, at most by all of itself.
    first = np.minimum(0.03 * np.abs(water[:1]) / np.maximum(size[:1], 1e-300), 1.0)
    model = factor * (first * size) ** 2 / 2
    moved = np.nan_to_num(steeper) - np.nan_to_num(hidden)
    moved = moved * water * np.sqrt(frequencies)
    assert_allclose(found.in_phase, moved.real**2 + model, rtol=1e-9)
    assert_allclose(found.quadrature, moved.imag**2 + model, rtol=1e-9)
    assert_allclose(found.cross, moved.real * moved.imag, rtol=1e-9, atol=1e-15)


def plan_of(
    monkeypatch: pytest.MonkeyPatch, errors: dict[tuple[int, int], float],
    plan: tuple[int, int, int], **scan: Any,
) -> Any:  # fmt: skip
    """Return the judgement of a plan, with an error for each number of shots."""
    tried: list[tuple[int, int]] = []

    class Judge:
        def __init__(self, survey: Any) -> None:
            pass

        def error(self, plan: OpenWater) -> float:
            tried.append((plan.columns, plan.rows))
            assert plan.repeats == 2
            return errors.get((plan.columns, plan.rows), 1.0)

    monkeypatch.setattr(grid, "_Judge", Judge)
    columns, rows, repeats = plan
    water = OpenWater(columns=columns, rows=rows, repeats=repeats)
    values: dict[str, Any] = {
        "open_water": water, "moves": "emitter", "columns": 10, "rows": 8,
        "azimuth_span": 0.1, "elevation_span": 0.1,
    }  # fmt: skip
    survey: Any = SimpleNamespace(scan=SimpleNamespace(**values | scan))
    return grid.judge_plan(survey), tried


def test_the_smallest_plan_that_is_accurate_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, _ = plan_of(monkeypatch, {(3, 3): 0.0099}, (3, 3, 2))
    assert found.enough == (3, 3)
    assert found.holds
    # One percent of the largest signal.
    errors = {(3, 3): 0.0101, (7, 5): 0.0099, (5, 9): 0.001, (11, 3): 0.0099}
    found, tried = plan_of(monkeypatch, errors, (3, 3, 2))
    assert found.error == 0.0101
    assert not found.holds
    assert found.enough == (11, 3)
    assert tried[:4] == [(3, 3), (3, 3), (3, 5), (5, 3)]
    assert all(columns >= 3 and rows >= 3 for columns, rows in tried)
    none, tried = plan_of(monkeypatch, {}, (7, 5, 2))
    assert none.enough is None
    # 1, 3, 5, 7, 9 or 11 of each, not fewer than planned.
    assert set(tried) == {(c, r) for c in (7, 9, 11) for r in (5, 7, 9, 11)}


@pytest.mark.parametrize(
    ("plan", "scan", "refused"),
    [
        ((1, 1, 4), {}, "they are 4, and 5 are needed to judge their scatter"),
        ((1, 3, 2), {}, "they do not reach the edges of the scan from side to side"),
        ((3, 1, 2), {}, "they do not reach the edges of the scan from top to bottom"),
        ((1, 3, 2), {"columns": 1}, ""),
        ((1, 3, 2), {"azimuth_span": 1.99e-4}, ""),
        ((1, 3, 2), {"azimuth_span": 2.01e-4},
         "they do not reach the edges of the scan from side to side"),
        ((3, 1, 2), {"elevation_span": 1.99e-4}, ""),
        ((3, 1, 2), {"rows": 1}, ""),
        ((1, 1, 5), {"moves": "both"}, ""),
    ],
)  # fmt: skip
def test_shots_that_a_method_would_refuse_are_named(
    plan: tuple[int, int, int], scan: dict[str, Any], refused: str
) -> None:
    values: dict[str, Any] = {
        "moves": "emitter", "columns": 10, "rows": 8, "azimuth_span": 0.1,
        "elevation_span": 0.1,
    }  # fmt: skip
    columns, rows, repeats = plan
    given: Any = SimpleNamespace(**values | scan)
    water = OpenWater(columns=columns, rows=rows, repeats=repeats)
    assert grid._refused(given, water) == refused


def scan_of(**changed: Any) -> Any:
    values: dict[str, Any] = {
        "survey": None,
        "frequency": np.array([20e6, 60e6]),
        "polarizations": ["VV", "VH"],
    }
    return SimpleNamespace(**values | changed)


def drifting(change: complex, uncertainty: complex, chance: float = 1e-9) -> Any:
    return SimpleNamespace(drift=shots.Drift(change, uncertainty, chance))


@pytest.mark.parametrize(
    ("change", "uncertainty", "chance", "refused", "leaks"),
    [
        # A fifth, beyond three standard uncertainties.
        (0.201j, 0j, 1e-9, True, False),
        (0.199, 0j, 1e-9, False, False),
        (0.351, 0.05 + 0j, 1e-9, True, False),
        (0.349, 0.05j, 1e-9, False, False),
        # More than the water itself is leakage.
        (-1.001, 0j, 1e-9, True, True),
        (0.999, 0j, 1e-9, True, False),
        # A chance of one in a thousand, of four tests.
        (0.5, 0j, 0.249e-3, True, False),
        (0.5, 0j, 0.251e-3, False, False),
    ],
)
def test_a_drift_beyond_a_fifth_is_refused(
    change: complex, uncertainty: complex, chance: float, refused: bool, leaks: bool
) -> None:
    steady = drifting(0j, 1 + 1j, 1.0)
    fits = [steady, steady, drifting(change, uncertainty, chance), steady]
    real = shots.real_drift_of(fits, (2, 2, 5, 6))
    assert real.shape == (2, 2, 1, 1)
    assert real[1, 0, 0, 0] == (change if chance < 0.25e-3 else 0)
    if not refused:
        shots._refuse_strong_drift(scan_of(), fits, (2, 2))
        return
    said = f"at 60 MHz in channel VV changed by {abs(change):.0%}"
    with pytest.raises(CubeError, match=said) as caught:
        shots._refuse_strong_drift(scan_of(), fits, (2, 2))
    assert ("leakage that drifts" in str(caught.value)) == leaks


@pytest.mark.parametrize(
    ("azimuth", "elevation", "beyond"),
    [
        # A tenth of the span of the shots, or 0.1 mrad.
        ((-0.0199, 0.2199), (0.0, 0.0), ""),
        ((-0.0201, 0.2), (0.0, 0.0), "1.15 degrees beyond .* in azimuth"),
        ((0.0, 0.2201), (0.0, 0.0), "1.15 degrees beyond .* in azimuth"),
        ((0.0, 0.2), (-0.99e-4, 0.99e-4), ""),
        ((0.0, 0.2), (0.0, 2e-3), "0.11 degrees beyond .* in elevation"),
        ((0.0, 0.2), (-2e-3, 0.0), "0.11 degrees beyond .* in elevation"),
    ],
)
def test_a_scan_reaches_a_little_beyond_the_shots(
    azimuth: tuple[float, float], elevation: tuple[float, float], beyond: str
) -> None:
    places = np.array([[0.0, 0.0], [0.2, 0.0]])
    span = Span(azimuth=azimuth, elevation=elevation)
    if not beyond:
        shots._refuse_a_scan_beyond_the_shots(scan_of(), places, span)
        return
    with pytest.raises(CubeError, match=beyond):
        shots._refuse_a_scan_beyond_the_shots(scan_of(), places, span)
    both = SimpleNamespace(scan=SimpleNamespace(moves="both"))
    shots._refuse_a_scan_beyond_the_shots(scan_of(survey=both), places, span)


def test_angles_closer_than_a_fiftieth_of_the_span_are_repeats() -> None:
    angle = np.array([0.0, 0.0199, 1.0, 0.5, 0.5199])
    assert shots._clusters(angle, at_least=0.0).tolist() == [0, 0, 2, 1, 1]
    apart = np.array([0.0, 0.0201, 1.0, 0.5, 0.5201])
    assert shots._clusters(apart, at_least=0.0).tolist() == [0, 1, 4, 2, 3]
    # Or than the misses of the stages; a chain of angles is no direction.
    assert shots._clusters(apart, at_least=0.03).tolist() == [0, 0, 2, 1, 1]
    chain = np.linspace(0.0, 0.885, 60)
    assert len(set(shots._clusters(chain, at_least=0.0))) == 60
    assert shots._groups(np.array([3.0, 1.0, 3.0])).tolist() == [1, 0, 1]


def test_stages_miss_by_the_median_of_their_errors() -> None:
    rng = np.random.default_rng(3)
    off = 1e-3 * rng.standard_normal(400) + 0.02
    off[:3] = np.nan, 5.0, -5.0
    meant = rng.uniform(-1, 1, 400)
    cube = xr.Dataset(
        {"azimuth": ("pixel", meant + off), "user_commanded_azimuth": ("pixel", meant)}
    )
    middle = np.nanmedian(off)
    expected = np.nanmedian(np.abs(off - middle)) / norm.ppf(0.75)
    assert shots._jitter(scan_of(cube=cube), "azimuth") == pytest.approx(
        expected, rel=1e-4
    )
    assert expected == pytest.approx(1e-3, rel=0.15)
    assert shots._jitter(scan_of(cube=cube), "elevation") == 0.0
    lost = cube.assign(azimuth=("pixel", np.full(400, np.nan)))
    with pytest.warns(RuntimeWarning, match="All-NaN"):
        assert shots._jitter(scan_of(cube=lost), "azimuth") == 0.0
