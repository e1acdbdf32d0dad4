"""Water in front of targets: both passes of the distance, and its change by a prior."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import amulor.rejection.reference.before_target
from amulor.rejection.covariance import Covariance
from amulor.rejection.reference.before_target import (
    DEPARTURE,
    WaterFit,
    raised_to_shot_amplitude,
    strength_of,
    water_before_target,
)

module: Any = sys.modules[amulor.rejection.reference.before_target.__name__]
SHAPE = (2, 1, 2, 3)


class Course:
    """A scan whose fits, turbidity and columns are given, and what asks for them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, survey: Any = "stated"):
        self.calls: list[tuple[str, Any, dict[str, Any]]] = []
        self.signal = np.full(SHAPE, 1.0 + 0.5j)
        self.water = np.full(SHAPE, 0.3 + 0.1j)
        errors = Covariance(*(np.full(SHAPE, v) for v in (1e-6, 2e-6, 0.0)))
        self.scan: Any = SimpleNamespace(
            signal=self.signal, survey=survey, covariance=errors
        )
        self.common = Covariance(*(np.full(SHAPE, v) for v in (3e-6, 4e-6, 0.0)))
        self.turbidity = SimpleNamespace(
            survey="corrected", steeper="steeper", paper=True, misfit=0.07
        )
        self.hidden = {
            "first": np.full(SHAPE, 0.2 + 0j),
            "second": np.full(SHAPE, 0.4 + 0.1j),
            "steeper": np.full(SHAPE, 0.5 + 0j),
        }
        self.hidden["second"][..., 1, 1] = np.nan
        monkeypatch.setattr(module, "fit_shots", self._fit_shots)
        monkeypatch.setattr(
            module, "expected_at_pixels", lambda fits, shape: (self.water, self.common)
        )
        monkeypatch.setattr(
            module, "fluctuation_of", lambda fits, signal: ("fluctuates", signal)
        )
        monkeypatch.setattr(module, "turbidity_of", self._turbidity)
        monkeypatch.setattr(module.column, "depth", self._depth)
        monkeypatch.setattr(module.column, "hidden_fraction", self._hidden)
        monkeypatch.setattr(module.column, "hidden_error", self._hidden_error)

    def _fit_shots(self, scan: Any, **options: Any) -> Any:
        self.calls.append(("shots", (), options))
        return ["fits"], "shots"

    def _turbidity(self, *arguments: Any) -> Any:
        self.calls.append(("turbidity", arguments, {}))
        return self.turbidity

    def _depth(self, *arguments: Any, **options: Any) -> Any:
        self.calls.append(("depth", arguments, options))
        number = sum(name == "depth" for name, _, _ in self.calls)
        return f"depth {number}", np.full((2, 3), float(number)), f"choices {number}"

    def _hidden(self, scan: Any, survey: Any, depth: Any, **options: Any) -> Any:
        self.calls.append(("hidden", (survey, depth), options))
        kind = "steeper" if survey == "steeper" else (
            "first" if depth == "depth 1" else "second"
        )  # fmt: skip
        return self.hidden[kind], f"column {kind}"

    def _hidden_error(self, *arguments: Any, **options: Any) -> Any:
        self.calls.append(("error", arguments, options))
        return "error"

    def of(self, name: str) -> list[tuple[Any, dict[str, Any]]]:
        return [(given, options) for kind, given, options in self.calls if kind == name]


def test_the_distance_is_found_again_with_the_column(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    course = Course(monkeypatch)
    found = water_before_target(course.scan, interval=(1.0, 2.0), span="span")
    difference = course.signal - course.water
    assert_allclose(found.difference, difference)
    assert found.to_the_end is course.water
    (first, second) = course.of("depth")
    for arguments, options in (first, second):
        assert arguments[0] is course.scan
        assert_allclose(arguments[2].in_phase, 4e-6)
        assert_allclose(arguments[2].quadrature, 6e-6)
        assert arguments[3] == "corrected"
        assert options == {"interval": (1.0, 2.0), "fit": None}
    assert_allclose(first[0][1], difference)
    # The column of the first pass is in the signal of the second one.
    assert_allclose(second[0][1], difference + 0.2 * course.water)
    assert [given for given, _ in course.of("hidden")] == [
        ("corrected", "depth 1"), ("corrected", "depth 2"), ("steeper", "depth 2"),
    ]  # fmt: skip
    for _, options in course.of("hidden"):
        assert options == {"paper": True, "fit": None}
    ((arguments, options),) = course.of("error")
    assert arguments[0] is course.water
    assert arguments[1] is course.hidden["second"]
    assert arguments[2] is course.hidden["steeper"]
    assert options == {"misfit": 0.07}
    assert found.hidden_error == "error"
    assert found.hidden_fraction is course.hidden["second"]
    # Where the distance is unknown all of the water counts.
    part = np.where(np.isnan(course.hidden["second"]), 0, 0.4 + 0.1j)
    assert_allclose(found.signal, (1 - part) * course.water)
    assert found.fluctuation[0] == "fluctuates"
    assert found.fluctuation[1] is found.signal
    assert found.common is course.common
    assert_array_equal(found.path, 2.0)
    assert (found.survey, found.turbidity) == ("corrected", course.turbidity)
    assert found.estimated_turbidity is course.turbidity
    assert vars(found.fit) == {
        "shots": "shots",
        "estimated_turbidity": course.turbidity,
        "first": ("choices 1", "column first"),
        "choices": "choices 2",
        "column": "column second",
        "steeper": "column steeper",
    }
    assert course.of("shots") == [((), {"fit": None, "span": "span"})]


def test_a_survey_that_is_right_is_not_corrected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    course = Course(monkeypatch)
    found = water_before_target(course.scan, interval=None, survey_is_right=True)
    assert found.survey == "stated"
    assert found.turbidity is None
    assert found.estimated_turbidity is course.turbidity
    assert found.hidden_error is None
    assert course.of("error") == []
    surveys = [given[0] for given, _ in course.of("hidden")]
    assert surveys == ["stated", "stated"]
    assert {options["paper"] for _, options in course.of("hidden")} == {False}
    assert found.fit.steeper is None


def test_without_a_survey_all_of_the_water_is_in_front(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    course = Course(monkeypatch, survey=None)
    found = water_before_target(course.scan, interval=None)
    assert found.signal is course.water
    assert found.hidden_fraction is None
    assert found.hidden_error is None
    assert np.isnan(found.path).all()
    assert found.path.shape == (2, 3)
    assert course.of("turbidity") == []
    assert vars(found.fit) == {
        "shots": "shots", "estimated_turbidity": None, "first": None,
        "choices": None, "column": None, "steeper": None,
    }  # fmt: skip


def test_rows_take_choices_and_columns_of_the_scan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    course = Course(monkeypatch)
    known: Any = SimpleNamespace(
        survey="of the scan", steeper="steeper", paper=False, misfit=0.01
    )
    fit: Any = WaterFit(
        shots="shots before", estimated_turbidity=known,
        first=("choices a", "column a"), choices="choices b", column="column b",
        steeper="column c",
    )  # fmt: skip
    found = water_before_target(course.scan, interval=None, fit=fit)
    assert course.of("turbidity") == []
    assert [options["fit"] for _, options in course.of("depth")] == [
        "choices a", "choices b",
    ]  # fmt: skip
    assert [options["fit"] for _, options in course.of("hidden")] == [
        "column a", "column b", "column c",
    ]  # fmt: skip
    assert course.of("shots")[0][1]["fit"] == "shots before"
    assert found.survey == "of the scan"


def test_water_is_raised_to_the_size_of_the_references(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    course = Course(monkeypatch, survey=None)
    water = np.full(SHAPE, 0.1j)
    water[..., 0, 1] = -2.0
    found, fit = raised_to_shot_amplitude(course.scan, water)
    expected = np.full(SHAPE, 1j * abs(0.3 + 0.1j))
    expected[..., 0, 1] = -2.0
    assert_allclose(found, expected)
    assert fit.shots == "shots"


# -- change of the water ---------------------------------------------------------------

FREQUENCY = np.array([20e6, 50e6, 80e6])
WATER: Any = 0.3 / (1 - 1j * FREQUENCY / 30e6)


def changed(
    *, own: float = 1e-3, shared: float = 0.0, change: float = 1e-5, late: Any = None
) -> Any:
    """Return the strength for twelve equal pixels at 4 m of path."""
    shape = (3, 1, 3, 4)
    echo = np.exp(2j * np.pi * FREQUENCY / 299792458.0 * 4.0)
    water = np.broadcast_to(WATER[:, None, None, None], shape)
    left = echo[:, None, None, None] + change * water
    errors = [
        Covariance(np.full(shape, v**2), np.full(shape, v**2), np.zeros(shape))
        for v in (own, shared)
    ]
    return strength_of(
        left, water, *errors,
        modulation_frequency=FREQUENCY, path=np.full((3, 4), 4.0), late=late,
    )  # fmt: skip


def variance_of(found: Any, change: float = 1e-5) -> float:
    """Return the variance of the fit, by the share of the change that the prior leaves.

    It is p / (p + v), for a prior variance p.
    """
    prior = DEPARTURE**2
    share = found.change / change
    # The variance of both together is that of the prior less this share of it.
    assert found.uncertainty**2 == pytest.approx(prior * (1 - share), rel=1e-3)
    return float(prior * (1 / share - 1))


def test_errors_of_pixels_average_out_and_shared_ones_add_up() -> None:
    shape = np.ones((3, 4))
    own = variance_of(changed(own=0.02))
    assert variance_of(changed(own=0.04)) == pytest.approx(4 * own, rel=1e-2)
    # A shared error of the same size counts twelve times; there is some of both.
    both = variance_of(changed(own=0.02, shared=0.02))
    assert both == pytest.approx(13 * own, rel=1e-2)
    # One free path of a pixel takes a direction from the phases, weighted alike.
    turn = np.imag(WATER / np.exp(2j * np.pi * FREQUENCY / 299792458.0 * 4.0))
    rest = turn - FREQUENCY * (FREQUENCY @ turn) / (FREQUENCY @ FREQUENCY)
    assert own == pytest.approx(0.02**2 / 12 / (rest @ rest), rel=1e-2)
    assert shape.sum() == 12


def test_a_delay_of_late_light_is_wrong_everywhere() -> None:
    plain = variance_of(changed(own=0.02))
    none = np.zeros((3, 3, 4))
    late = np.array([0.01, 0.02, 0.05])[:, None, None] * np.ones((3, 3, 4))
    found = variance_of(changed(own=0.02, late=(none, late)))
    turn = np.imag(WATER / np.exp(2j * np.pi * FREQUENCY / 299792458.0 * 4.0))
    rest = turn - FREQUENCY * (FREQUENCY @ turn) / (FREQUENCY @ FREQUENCY)
    by_late = ((np.array([0.01, 0.02, 0.05]) @ rest) / (rest @ rest)) ** 2
    assert found - plain == pytest.approx(by_late, rel=2e-2)


def test_known_late_light_is_no_change() -> None:
    turn = 1e-5 * np.imag(WATER / np.exp(2j * np.pi * FREQUENCY / 299792458.0 * 4.0))
    late = turn[:, None, None] * np.ones((3, 3, 4))
    found = changed(late=(late, np.zeros((3, 3, 4))))
    assert found.change == pytest.approx(0.0, abs=1e-9)
    # Where it is unknown it counts as none.
    lost = np.full((3, 3, 4), np.nan)
    again = changed(late=(lost, lost))
    assert again.change == pytest.approx(changed().change)


def test_a_change_far_beyond_the_prior_widens_it() -> None:
    # Nearly all of a change of a tenth is taken, with the error of the fit.
    large = changed(own=0.005, change=0.1)
    small = changed(own=0.005)
    variance = variance_of(small)
    assert large.change == pytest.approx(0.1 - variance / 0.1, abs=5e-3)
    assert large.uncertainty == pytest.approx(np.sqrt(variance), rel=0.1)
    assert not large.is_untested


def test_samples_without_an_error_do_not_count() -> None:
    # Errors of zero say that nothing was measured there.
    assert changed(own=0.0).change == 0.0
    assert changed(own=0.0).uncertainty == DEPARTURE
    assert changed(own=0.0, shared=0.01).uncertainty == DEPARTURE
    # A phase is blurred beyond 0.2 rad.
    assert changed(own=0.199).change != 0.0
    assert changed(own=0.201).change == 0.0
    assert changed(own=0.15, shared=0.15).change == 0.0
