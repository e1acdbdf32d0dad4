"""Choice of a model behind shots, and of a table of hidden water, by given models."""

from __future__ import annotations

import sys
from functools import partial
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import amulor.rejection.reference.column
import amulor.rejection.reference.model
from amulor.cube.tiles import Span
from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance

module: Any = sys.modules[amulor.rejection.reference.model.__name__]
column: Any = sys.modules[amulor.rejection.reference.column.__name__]
FREQUENCY = np.array([20e6, 50e6])


def survey_of(moves: str = "beam") -> Any:
    return SimpleNamespace(scan=SimpleNamespace(moves=moves))


def grid(columns: int, rows: int) -> np.ndarray:
    """Return directions from -1 to 1, row by row."""
    axes = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows))
    return np.stack([axis.ravel() for axis in axes], axis=1)


@pytest.mark.parametrize(("size", "smooth"), [(0.9, True), (1.1, False)])
def test_water_is_smooth_up_to_half_a_percent_of_its_largest_signal(
    monkeypatch: pytest.MonkeyPatch, size: float, smooth: bool
) -> None:
    # A wave that is zero at all shots is missed whole: by the second frequency.
    def open_water(survey: Any, places: Any, frequency: Any) -> Any:
        wave = np.sin(np.pi * 2 * places[:, 0])
        largest = np.abs(np.sin(np.pi * 2 * np.linspace(-1, 1, 9))).max()
        share = size * 0.005 * wave / largest
        return np.stack([np.full(len(places), 3.0 + 0j), 2.0 * (1 + 1j * share)])

    monkeypatch.setattr(module, "open_water", open_water)
    found = module._is_smooth(survey_of(), grid(5, 3), FREQUENCY, 4)
    assert found is smooth


def test_candidates_are_waters_of_five_turbidities_and_the_paper(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[Any] = []

    def open_water(survey: Any, places: Any, frequency: Any, **options: Any) -> Any:
        given.append((survey, len(places), options))
        return np.ones((2, len(places)), dtype=complex)

    monkeypatch.setattr(module, "open_water", open_water)
    monkeypatch.setattr(
        module, "by_coefficients", lambda survey, *, factor: ("times", factor)
    )
    monkeypatch.setattr(module, "_is_smooth", lambda *_: False)
    survey = survey_of()
    found = module.models_for(survey, grid(3, 2), FREQUENCY, repeats=2)
    assert len(found) == 6
    waters = [survey, *(("times", factor) for factor in (0.5, 0.7, 1.4, 2.0))]
    assert given == [
        *((water, 1, {}) for water in waters), (survey, 1, {"paper": True}),
    ]  # fmt: skip
    assert all(isinstance(candidate, partial) for candidate in found)


@pytest.mark.parametrize("reason", ["one direction", "moves", "smooth", "refused"])
def test_some_scans_need_or_have_no_model(
    monkeypatch: pytest.MonkeyPatch, reason: str
) -> None:
    def open_water(survey: Any, places: Any, frequency: Any, **options: Any) -> Any:
        if reason == "refused":
            raise CubeError("no water")
        return np.ones((2, len(places)), dtype=complex)

    monkeypatch.setattr(module, "open_water", open_water)
    monkeypatch.setattr(module, "by_coefficients", lambda survey, *, factor: survey)
    monkeypatch.setattr(module, "_is_smooth", lambda *_: reason == "smooth")
    survey = survey_of("both" if reason == "moves" else "beam")
    directions = grid(3, 2)[: 1 if reason == "one direction" else None]
    found = module.models_for(survey, directions, FREQUENCY, repeats=2)
    assert found is None
    # Two directions are enough.
    if reason == "one direction":
        assert module.models_for(survey, grid(2, 1), FREQUENCY, repeats=2) is not None


@pytest.mark.parametrize(("ratio", "measure"), [(0.99e6, True), (1.01e6, False)])
def test_a_model_varies_by_a_million_at_most(ratio: float, measure: bool) -> None:
    assert module.is_measure(np.array([1j, -ratio, 2.0])) is measure
    assert not module.is_measure(np.zeros(3))


class Shots:
    """Shots of one channel, in five directions three times."""

    def __init__(self) -> None:
        self.directions = np.tile(grid(5, 1), (3, 1))
        rng = np.random.default_rng(1)
        peak = np.exp(-4 * self.directions[:, 0] ** 2)
        noise = 1e-3 * rng.standard_normal((2, 1, 15))
        self.signal: Any = np.stack([peak, 2 * peak])[:, None] + noise
        size = np.full(self.signal.shape, 1e-6)
        self.covariance = Covariance(size, size, 0 * size)
        self.usable = np.ones(self.signal.shape, dtype=bool)


def test_the_model_of_least_error_at_directions_left_out_is_chosen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shots: Any = Shots()
    asked: list[Any] = []

    def flat(places: Any, frequency: Any) -> Any:
        return np.ones((2, len(places)), dtype=complex)

    def peaked(places: Any, frequency: Any) -> Any:
        return np.exp(-4 * places[:, 0] ** 2) * np.ones((2, 1)) + 0j

    def models_for(
        survey: Any, directions: Any, frequency: Any, *, repeats: int
    ) -> Any:
        asked.append((directions, repeats))
        return candidates

    monkeypatch.setattr(module, "models_for", models_for)
    scan: Any = SimpleNamespace(survey="survey", frequency=FREQUENCY)
    span = Span(azimuth=(-1.0, 1.0), elevation=(-0.5, 0.5))
    candidates: Any = [flat, peaked]
    found = module.model_behind_shots(scan, shots, shots.directions, span=span)
    assert_array_equal(asked[0][0], grid(5, 1))
    assert asked[0][1] == 3
    assert_allclose(found.at_shots, peaked(shots.directions, FREQUENCY))
    pixels = np.array([[0.3, 0.2], [-0.9, -0.4]])
    assert_allclose(
        found.model(pixels, FREQUENCY), peaked(pixels, FREQUENCY), atol=1e-6
    )
    (first, second) = found.over(pixels, FREQUENCY)
    assert_allclose(first.at_shots, found.at_shots[0])
    assert_allclose(second.at_pixels, peaked(pixels, FREQUENCY)[1], atol=1e-6)
    use = np.arange(15) < 4
    part = first.part(use)
    assert_array_equal(part.at_shots, first.at_shots[use])
    assert part.at_pixels is first.at_pixels
    # A polynomial alone is taken where no model is better.
    candidates = [lambda places, frequency: 1e-9 + (places[:, 0] ** 2 > 0.9)
                  * np.ones((2, 1)) + 0j]  # fmt: skip
    assert module.model_behind_shots(scan, shots, shots.directions, span=span) is None
    candidates = None
    assert module.model_behind_shots(scan, shots, shots.directions, span=span) is None
    bare: Any = SimpleNamespace(survey=None, frequency=FREQUENCY)
    assert module.model_behind_shots(bare, shots, shots.directions, span=span) is None


def test_errors_add_up_over_channels_with_enough_shots() -> None:
    shots: Any = Shots()
    whole = module._cross_validation_error(None, shots.directions, shots)
    parts = []
    for lost in range(2):
        shots.usable[:] = True
        shots.usable[lost, 0, 4:] = False
        parts.append(module._cross_validation_error(None, shots.directions, shots))
    # Four shots do not count, and five do.
    assert whole == pytest.approx(sum(parts))
    shots.usable[1, 0, 4] = True
    five = module._cross_validation_error(None, shots.directions, shots)
    assert five != pytest.approx(parts[1])
    odd = np.ones((2, 15), dtype=complex)
    odd[0, 0] = 1e-7
    assert module._cross_validation_error(odd, shots.directions, shots) == np.inf


# -- hidden water ----------------------------------------------------------------------


class Table:
    """Table with an error and a size that depend on its nodes."""

    made: ClassVar[list[tuple[int, int, int]]] = []

    def __init__(
        self, survey: Any, places: Any, nodes: Any, frequency: Any, *, paper: bool
    ) -> None:
        self.nodes, self.filled = nodes, False
        self.size = int(np.prod(nodes))
        self.made.append(nodes)

    def fill(self) -> None:
        self.filled = True

    def fractions(self, places: np.ndarray) -> np.ndarray:
        assert self.filled
        return np.full((2, places.shape[1]), 0.5 + self.off[self.nodes])

    off: ClassVar[dict[Any, float]] = {}


@pytest.mark.parametrize("good", [0, 1, None])
def test_the_smallest_table_that_is_accurate_is_taken(
    monkeypatch: pytest.MonkeyPatch, good: int | None
) -> None:
    error = column.LARGEST_ERROR / 2
    Table.made = []
    Table.off = {
        nodes: error * (0.99 if k == good else 1.01)
        for k, nodes in enumerate(column._NODES)
    }
    exact: list[int] = []

    def integrated(survey: Any, places: Any, frequency: Any, *, paper: bool) -> Any:
        exact.append(places.shape[1])
        return np.full((2, places.shape[1]), 0.5 + 0j)

    monkeypatch.setattr(column, "_Table", Table)
    monkeypatch.setattr(column, "integrated", integrated)
    monkeypatch.setattr(column, "_WORTH", 1e9)
    rng = np.random.default_rng(1)
    places = rng.random((3, 40))
    found = column.column_of("survey", places, FREQUENCY, paper=False)
    if good is None:
        assert isinstance(found, column._Listed)
        assert Table.made == list(column._NODES)
        assert len(exact) == 2
        assert exact[1] == 40
    else:
        assert found.nodes == column._NODES[good]
        assert len(Table.made) == good + 1
        assert len(exact) == 1


def test_a_table_larger_than_its_worth_is_not_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first = int(np.prod(column._NODES[0]))
    Table.off = dict.fromkeys(column._NODES, 0.0)
    monkeypatch.setattr(column, "_Table", Table)
    monkeypatch.setattr(
        column, "integrated",
        lambda survey, places, frequency, *, paper: np.full((2, places.shape[1]), 0.5),
    )  # fmt: skip
    monkeypatch.setattr(column, "_WORTH", 2)
    few = int(np.ceil(first / 2)) - 1
    for count, table in ((few, False), (few + 1, True)):
        places = np.random.default_rng(1).random((3, count))
        found = column.column_of("survey", places, FREQUENCY, paper=False)
        assert isinstance(found, Table) == table
    empty = column.column_of("survey", np.zeros((3, 0)), FREQUENCY, paper=False)
    assert empty.fractions(np.zeros((3, 0))).shape == (2, 0)


def test_listed_pixels_are_integrated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def integrated(survey: Any, places: Any, frequency: Any, *, paper: bool) -> Any:
        asked.append((places.shape[1], paper))
        return np.stack([places.sum(axis=0), places[0] - places[2]]) + 0j

    monkeypatch.setattr(column, "integrated", integrated)
    places = np.random.default_rng(1).random((3, 6))
    listed = column._Listed("survey", places, FREQUENCY, paper=True)
    assert asked == [(6, True)]
    expected = np.stack([places.sum(axis=0), places[0] - places[2]])
    assert_array_equal(listed.fractions(places), expected)
    part = places[:, [4, 1]].copy()
    assert_array_equal(listed.fractions(part), expected[:, [4, 1]])
    assert len(asked) == 1
    # Only places that are not listed are integrated.
    mixed = np.concatenate([places[:, [2]], places[:, [3]] + 1, places[:, [5]]], axis=1)
    found = listed.fractions(mixed)
    assert asked[1:] == [(1, True)]
    assert_array_equal(found[:, [0, 2]], expected[:, [2, 5]])
    assert_allclose(found[0, 1], mixed[:, 1].sum())
