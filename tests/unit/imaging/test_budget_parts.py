"""Terms of an error budget, against sums on paper."""

from __future__ import annotations

import datetime
import math
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light
from scipy.special import stdtrit

from amulor.cube import QualityFlag
from amulor.cube.schema import TERMS
from amulor.imaging import budget
from amulor.imaging.budget import (
    age_in_words,
    calibration_age,
    error_budget,
    instrument_term,
    joint_instrument_terms,
    uncertainties,
    with_deviations,
)
from amulor.imaging.late_light import LateFit, LateLight
from amulor.imaging.ranges import Ranges

SHAPE = (1, 3)
FREQUENCY = np.array([30e6, 80e6])
PER_PHASE = speed_of_light / (2 * np.pi * FREQUENCY)
WEIGHT = np.array([0.3, 0.7])


def _map(*values: float) -> np.ndarray:
    """Values of the pixels of one row."""
    return np.array([values]) if len(values) > 1 else np.full(SHAPE, values[0])


def _ranges(**changes: Any) -> Ranges:
    fields: dict[str, Any] = {
        "slant_range": _map(1.0, 2.0, 3.0),
        "path": _map(2.76, 5.52, 8.28),
        "slope": _map(0.36),
        "flag": np.zeros(SHAPE, dtype=np.int16),
        "weight": WEIGHT,
        "total": _map(5e-3),
        "terms": {"signal": _map(4e-3), "water_model": _map(3e-3)},
        "common": _map(3e-3),
        "others": {"slant_range_bias": _map(1e-4)},
    }
    return Ranges(**{**fields, **changes})


def _observation(**changes: Any) -> Any:
    """Channel of a cube without a survey."""
    attributes = changes.pop("attributes", {})
    fields: dict[str, Any] = {
        "channel": xr.Dataset(
            coords={"modulation_frequency": FREQUENCY, "polarization": "VV"},
            attrs=attributes,
        ),
        "survey": None,
        "frequency": FREQUENCY,
        "path_per_phase": PER_PHASE[:, None, None],
        "signal": np.array([1.0, 2.0, 4.0]) * np.ones((2, *SHAPE)) * (0.6 + 0.8j),
        "frequency_phase": None,
        "joint_values": lambda *_: None,
        "geometry": SimpleNamespace(
            depth=lambda values: values - 0.5,
            error_by_index=lambda path, size: size * path / 10,
            error_by_place=lambda path, place, turn, axes=3: (
                place * axes + turn + 0 * path
            ),
        ),
    }
    return SimpleNamespace(**{**fields, **changes})


def _completed(
    monkeypatch: pytest.MonkeyPatch,
    observation: Any,
    ranges: Ranges,
    *,
    light: LateLight | None = None,
    corners: np.ndarray | None = None,
    surroundings: np.ndarray | None = None,
) -> tuple[Any, ...]:
    """Complete ranges with given errors by light."""
    absent = LateLight(late=_map(0.0), uncertainty=_map(0.0), note="absent")
    taken: dict[str, Any] = {}

    def late(observation: Any, slant_range: Any, **options: Any) -> Any:
        taken["late"] = slant_range, options
        return light or absent, LateFit()

    def by_corners(observation: Any, slant_range: Any, **options: Any) -> Any:
        taken["corners"] = slant_range, options
        return corners, None

    def around(observation: Any, slant_range: Any, **options: Any) -> Any:
        taken["around"] = slant_range, options
        return surroundings, None

    monkeypatch.setattr(budget, "late_light", late)
    monkeypatch.setattr(budget, "corner_error", by_corners)
    monkeypatch.setattr(budget, "surroundings_error", around)
    return (*budget.completed(observation, ranges), taken)


def test_terms_add_to_the_total_and_to_the_common_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    light = LateLight(
        late=_map(0.01, 0.02, 0.03), uncertainty=_map(2e-3), note="taken off"
    )
    corners, surroundings = _map(6e-3, 6.2e-3, 6.3e-3), _map(3.5e-3)
    phase = {"calibration_phase_uncertainty_rad": np.array([0.01, 0.02])}
    observation = _observation(attributes=phase)
    ranges = _ranges(flag=np.array([[32, 0, 4]], dtype=np.int16))
    made, attributes, *_, taken = _completed(
        monkeypatch, observation, ranges, light=light, corners=corners,
        surroundings=surroundings,
    )  # fmt: skip
    assert_allclose(made.slant_range, _map(0.99, 1.98, 2.97))
    instrument = 0.36 * np.linalg.norm(WEIGHT * PER_PHASE * [0.01, 0.02])
    added = instrument**2 + 2e-3**2 + corners**2 + 3.5e-3**2
    assert_allclose(made.total, np.sqrt(5e-3**2 + added))
    assert made.common is not None
    assert_allclose(made.common, np.sqrt(3e-3**2 + added))
    assert list(made.terms) == [
        "signal", "water_model", "instrument", "surroundings", "corners", "late_echo",
    ]  # fmt: skip
    assert_allclose(made.terms["instrument"], instrument)
    # Corners are named where they exceed total and instrument: 6.08 mm.
    assert 6e-3 < math.hypot(5e-3, instrument) < 6.2e-3
    assert_array_equal(made.flag, [[32, QualityFlag.CORNER, 4 | QualityFlag.CORNER]])
    assert_array_equal(made.others["slant_range_late_echo"], light.late)
    assert_array_equal(made.others["slant_range_bias"], _map(1e-4))
    assert attributes == {
        "late_echo_correction": "taken off",
        "uncertainty_unknown": "delay group_index geometry",
    }
    # Pixels without a target have no range for the light of corners.
    late, _ = taken["late"]
    assert_allclose(late, [[1.0, 2.0, np.nan]])
    assert_allclose(taken["corners"][0], [[0.99, 1.98, np.nan]])
    rest = np.hypot(5e-3, instrument)
    assert_allclose(taken["around"][1]["noise"], rest)
    assert_allclose(taken["corners"][1]["noise"], 5e-3)


def test_unknown_terms_are_named_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    unknown = LateLight(late=_map(0.0), uncertainty=None, note="not known: no survey")
    drift = {"open_water_drift_uncertainty": np.array([1.0, np.inf])}
    made, attributes, *_ = _completed(
        monkeypatch, _observation(attributes={**drift, "open_water_degree": 1}),
        _ranges(common=None), light=unknown,
    )  # fmt: skip
    names = attributes["uncertainty_unknown"].split()
    assert set(names) == {
        "drift", "column", "late_echo", "delay", "group_index", "geometry",
    }  # fmt: skip
    assert names == [name for name in TERMS if name in names]
    assert attributes["late_echo_correction"] == "not known: no survey"
    assert "slant_range_late_echo" not in made.others
    assert made.common is None
    assert_array_equal(made.total, _map(5e-3))


def test_errors_without_a_common_part_make_one(monkeypatch: pytest.MonkeyPatch) -> None:
    made, *_ = _completed(
        monkeypatch, _observation(), _ranges(common=None), surroundings=_map(1e-3)
    )
    assert made.common is not None
    assert_allclose(made.common, 1e-3)
    assert_allclose(made.total, math.hypot(5e-3, 1e-3))


@pytest.mark.parametrize(
    ("attributes", "residual", "names"),
    [
        ({}, False, []),
        ({"open_water_drift_uncertainty": np.array([0.1, 0.2])}, False, []),
        ({"open_water_drift_uncertainty": np.nan}, False, ["drift"]),
        ({"open_water_degree": 0}, False, ["column"]),
        ({"open_water_degree": 0}, True, []),
    ],
)
def test_open_water_references_leave_terms_unknown(
    attributes: dict[str, Any], residual: bool, names: list[str]
) -> None:
    channel = xr.Dataset(attrs=attributes)
    if residual:
        channel["residual_in_phase"] = 0.0
    assert budget._unknown_of_water(channel) == names


def test_instrument_errors_of_a_joint_estimation_count_once() -> None:
    sizes = (1e-11, 2e-3, 0.0)
    observation = _observation(joint_values=lambda *_: sizes)
    ranges = _ranges(path=_map(2.76))
    terms = joint_instrument_terms(observation, ranges.path, ranges.slope)
    assert list(terms) == ["delay", "group_index"]
    delay, index = 0.36 * speed_of_light * 1e-11, 2e-3 * 0.276
    assert_allclose(terms["delay"], delay)
    assert_allclose(terms["group_index"], index)
    made, shared = budget._without_instrument(observation, ranges)
    counted = delay**2 + index**2
    assert made.common is not None
    assert_allclose(made.common, np.sqrt(9e-6 - counted))
    assert_allclose(made.total, np.sqrt(25e-6 - counted))
    assert_allclose(made.terms["water_model"], made.common)
    assert_allclose(made.terms["signal"], 4e-3)
    assert_allclose(shared["delay"], delay)
    # No more than the common error contains.
    small = _ranges(path=_map(2.76), common=_map(1e-4), total=_map(2e-4))
    made, shared = budget._without_instrument(observation, small)
    assert made.common is not None
    assert_allclose(made.common, 0.0, atol=1e-10)
    assert_allclose(made.total, np.sqrt(3) * 1e-4)
    assert_allclose(np.hypot(shared["delay"], shared["group_index"]), 1e-4)
    ratio = shared["delay"] / shared["group_index"]
    assert_allclose(ratio, delay / index)
    placed = _observation(joint_values=lambda *_: (0.0, 0.0, 3e-3))
    place = joint_instrument_terms(placed, ranges.path, ranges.slope)
    assert list(place) == ["geometry"]
    # Two axes: the receiver is unsure across the beam only.
    assert_allclose(place["geometry"], 6e-3)
    for plain in (_observation(), observation):
        unchanged = _ranges(common=None) if plain is observation else _ranges()
        assert budget._without_instrument(plain, unchanged) == (unchanged, {})


def test_late_light_of_a_joint_estimation_counts_once() -> None:
    four = np.array([30e6, 50e6, 80e6, 120e6])

    def observation(count: int, sizes: Any = (0.5, 0.004)) -> Any:
        return _observation(joint_values=lambda *_: sizes, frequency=four[:count])

    ranges = _ranges(slant_range=_map(1.5, 2.5, 3.5))
    made = budget._without_late_light(observation(4), ranges)
    counted = 0.5 * 0.25 * 0.004 * np.array([[1.0, 4.0, 9.0]])
    assert made.common is not None
    assert_allclose(made.common, np.sqrt(np.maximum(9e-6 - counted**2, 0)))
    assert_allclose(made.total, np.sqrt(np.maximum(25e-6 - counted**2, 0)))
    assert_array_equal(made.terms["water_model"], made.common)
    assert budget._without_late_light(observation(3), ranges) is ranges
    assert budget._without_late_light(observation(4, None), ranges) is ranges
    open_ = _ranges(common=None)
    assert budget._without_late_light(observation(4), open_) is open_


def test_phases_and_drifts_of_an_instrument_add() -> None:
    ones = np.ones(SHAPE)
    assert instrument_term(_observation(), WEIGHT, 0.36 * ones) is None
    phase = {"calibration_phase_uncertainty_rad": np.array([0.01, 0.02])}
    parts = WEIGHT * PER_PHASE * [0.01, 0.02]
    found = instrument_term(_observation(attributes=phase), WEIGHT, 0.36 * ones)
    assert_allclose(found, 0.36 * np.linalg.norm(parts))
    drift = {
        "instrument_drift_uncertainty_s": np.array([1e-11, 2e-11]),
        "temperature_delay_uncertainty_s": 3e-11,
        "method_disagreement_m": 2e-3,
    }
    found = instrument_term(_observation(attributes=phase | drift), WEIGHT, 0.36 * ones)
    late = speed_of_light * math.hypot(1.7e-11, 3e-11)
    path = math.hypot(np.linalg.norm(parts), late)
    assert_allclose(found, math.hypot(0.36 * path, 2e-3))
    only = {"method_disagreement_m": 2e-3}
    found = instrument_term(_observation(attributes=only), WEIGHT, 0.36 * ones)
    assert_allclose(found, 2e-3)


def test_leakage_turns_weak_echoes_most() -> None:
    leakage = {"leakage_uncertainty_volt": np.array([2e-3, 3e-3])}
    found = instrument_term(
        _observation(attributes=leakage), WEIGHT, np.full(SHAPE, 0.36)
    )
    parts = WEIGHT * PER_PHASE * [2e-3, 3e-3]
    expected = 0.36 * np.linalg.norm(parts) / np.array([[1.0, 2.0, 4.0]])
    assert_allclose(found, expected)
    dark = _observation(attributes=leakage)
    dark.signal = np.zeros((2, *SHAPE))
    assert instrument_term(dark, WEIGHT, np.full(SHAPE, 0.36)) is None


def test_contradictory_frequencies_add_with_one_sign() -> None:
    deviations = np.array([0.03, 0.04])
    found = instrument_term(
        _observation(frequency_phase=deviations), WEIGHT, np.full(SHAPE, 0.36)
    )
    size = 0.05 / math.sqrt(2) * stdtrit(2, 0.975) / 1.96
    assert_allclose(found, 0.36 * (WEIGHT * PER_PHASE).sum() * size)
    stated = with_deviations(np.array([0.03, 1.0]), deviations)
    factor = stdtrit(2, 0.975) / 1.96
    expected = factor * np.sqrt((np.array([0.03, 1.0]) ** 2 + 0.05**2) / 2)
    assert_allclose(stated, np.maximum([0.03, 1.0], expected))
    many = with_deviations(np.array([1.0]), np.full(50, 1e-3))
    assert_allclose(many, 1.0)


@pytest.mark.parametrize(
    ("start", "end", "days"),
    [
        ("2026-05-11T12:00:00Z", None, 10.0),
        ("2026-05-11T06:00:00Z", "2026-05-11T12:00:00Z", 9.875),
        ("2026-05-11T14:00:00+02:00", None, 10.0),
        ("2026-05-11T12:00:00", "2026-05-12T12:00:00", 10.5),
        ("2026-04-30T12:00:00Z", None, -1.0),
    ],
)
def test_the_age_of_a_calibration_is_that_at_the_middle_of_the_scan(
    start: str, end: str | None, days: float
) -> None:
    calibration: Any = SimpleNamespace(date=datetime.date(2026, 5, 1))
    attributes = {"time_coverage_start": start}
    if end is not None:
        attributes["time_coverage_end"] = end
    assert calibration_age(attributes, calibration) == pytest.approx(days)
    assert calibration_age({}, calibration) is None
    assert calibration_age(attributes, None) is None
    undated: Any = SimpleNamespace(date=None)
    assert calibration_age(attributes, undated) is None


@pytest.mark.parametrize(
    ("days", "words"),
    [
        (math.nan, ""),
        (0.0, ", 0 days before the scan"),
        (12.4, ", 12 days before the scan"),
        (-3.6, ", 4 days after the scan"),
    ],
)
def test_an_age_in_words_follows_a_date(days: float, words: str) -> None:
    assert age_in_words(days) == words


@pytest.mark.parametrize(
    ("changes", "attributes", "expected"),
    [
        ({}, {}, 3e-10),
        ({"delay_uncertainty": None}, {}, None),
        ({"delay_growth": 1e-11}, {}, None),
        ({"delay_growth": 1e-11}, {"reference_calibrated": 1}, 3e-10),
        (
            {"delay_growth": 1e-11},
            {"time_coverage_start": "2026-04-01T12:00:00Z"},
            math.hypot(3e-10, 3e-10),
        ),
        (
            {"delay_per_degree": 2e-11, "instrument_temperature_uncertainty": 5.0},
            {},
            math.hypot(3e-10, 1e-10),
        ),
        ({"delay_per_degree": 2e-11}, {}, 3e-10),
        (
            {"delay_per_degree": 2e-11, "instrument_temperature_uncertainty": 5.0},
            {"temperature_delay_uncertainty_s": 1e-12},
            3e-10,
        ),
    ],
)
def test_a_delay_ages_and_warms(
    changes: dict[str, Any], attributes: dict[str, Any], expected: float | None
) -> None:
    calibration: Any = SimpleNamespace(
        **{
            "delay_uncertainty": 3e-10, "delay_growth": None, "delay_per_degree": None,
            "instrument_temperature_uncertainty": None,
            "date": datetime.date(2026, 5, 1), **changes,
        }
    )  # fmt: skip
    found = budget._delay_uncertainty(attributes, calibration)
    assert found == (None if expected is None else pytest.approx(expected))


def test_uncertainties_are_named_by_their_terms() -> None:
    names = uncertainties(_ranges())
    assert list(names) == [
        "slant_range_uncertainty",
        "slant_range_common_uncertainty",
        "slant_range_uncertainty_signal",
        "slant_range_uncertainty_water_model",
    ]
    assert "slant_range_common_uncertainty" not in uncertainties(_ranges(common=None))


def test_a_budget_has_medians_of_pixels_with_an_error() -> None:
    image = scenes.plane((0, 0, 1), 1.5, rows=2, columns=3)
    total = np.array([[1.0, 2.0, 3.0], [4.0, np.nan, 0.0]])
    image["slant_range_uncertainty"].values[:] = total
    image["slant_range_common_uncertainty"].values[:] = [[5, 1, 2], [3, 9, 9]]
    for name, share in (("fluctuation", 0.6), ("counting", 0.8)):
        values = share * np.nan_to_num(total, nan=7.0)
        image[f"slant_range_uncertainty_{name}"] = (("row", "column"), values)
    image["slant_range_late_echo"] = (("row", "column"), 0.01 * total)
    image = image.assign_attrs(
        open_water_shots=40, uncertainty_unknown="delay nothing geometry",
        late_echo_correction="taken off", delay_calibrated="2026-05-01",
        delay_calibration_age_days=3.0,
    )  # fmt: skip
    found = error_budget(image)
    assert [line.term.name for line in found.lines] == ["counting", "fluctuation"]
    counting, fluctuation = found.lines
    assert counting.uncertainty == pytest.approx(0.8 * 2.5)
    assert counting.share == pytest.approx(0.64)
    assert counting.samples is None
    assert fluctuation.samples == 40
    assert found.combined == pytest.approx(2.5)
    assert found.expanded == pytest.approx(5.0)
    assert found.common == pytest.approx(2.5)
    assert found.late == pytest.approx(0.025)
    assert [term.name for term in found.unknown] == ["delay", "geometry"]
    assert (found.late_echo, found.calibrated, found.age) == (
        "taken off",
        "2026-05-01",
        3,
    )
    plain = error_budget(image.drop_attrs())
    assert plain.lines[1].samples is None
    assert (plain.late_echo, plain.calibrated, plain.unknown) == ("", "", ())
    assert math.isnan(plain.age)
    image["slant_range_uncertainty"].values[:] = np.nan
    nothing = error_budget(image)
    assert nothing.lines == ()
    assert math.isnan(nothing.combined)
    assert math.isnan(nothing.common)
    assert math.isnan(error_budget(image.drop_vars("slant_range_late_echo")).late)
