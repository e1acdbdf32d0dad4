"""Samples of a recording: temperatures, frequencies, pixels, neighbors and frames."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.errors import FormatError
from amulor.io import recording_samples as parts
from amulor.survey import Survey
from amulor.survey.directions import scan_directions

PATH = Path("record.csv")


def test_temperatures_are_rounded_to_a_tenth() -> None:
    found = parts.rounded_temperatures(np.array([20.04, 19.96, 20.06, 25.0]))
    assert_allclose(found, [20.0, 20.1, 25.0])


def test_a_temperature_has_the_samples_within_half_a_degree() -> None:
    values = np.array([19.4, 19.5, 20.5, 20.6, np.nan])
    assert parts.at_temperature(values, 20.0).tolist() == [0, 1, 1, 0, 0]


def test_one_of_several_temperatures_must_be_chosen() -> None:
    def refuse(values: list[float], chosen: float | None) -> str:
        measured = np.array(values)
        rounded = parts.rounded_temperatures(measured)
        with pytest.raises(FormatError) as refused:
            parts.refuse_several(PATH, rounded, measured, chosen)
        return str(refused.value)

    parts.refuse_several(PATH, np.array([]), np.array([20.0, 21.0]), None)
    parts.refuse_several(PATH, np.array([]), np.array([]), None)
    parts.refuse_several(PATH, np.array([]), np.array([10.0, 20.0]), 20.4)
    assert refuse([20.0, 21.1], None) == (
        "record.csv: was recorded at several temperatures (20, 21.1 degC); choose one "
        "(--temperature), and import the others into cubes of their own"
    )
    assert refuse([20.0], 20.6) == (
        "record.csv: holds no sample at 20.6 degC; there are 20"
    )
    assert refuse([], 20.0).endswith("there are none with a temperature")


def samples(count: int, **fields: Any) -> parts.Samples:
    nothing = np.full(count, np.nan)
    given = {
        "signal": np.ones(count, complex), "mean": nothing, "frequency": nothing,
        "polarization": np.full(count, "VV"), "azimuth": nothing, "elevation": nothing,
        "row": nothing, "column": nothing, "temperature": nothing,
        "water": np.zeros(count, bool), **fields,
    }  # fmt: skip
    return parts.Samples(**given)


def test_samples_of_one_temperature_are_kept() -> None:
    warm = samples(3, temperature=np.array([20.0, 30.0, 20.2]),
                   mean=np.array([1.0, 2.0, 3.0]))  # fmt: skip
    assert parts.of_one_temperature(PATH, warm, 20.0).mean.tolist() == [1, 3]
    cold = samples(2, temperature=np.array([20.0, 20.2]))
    assert parts.of_one_temperature(PATH, cold, None) is cold


def test_equal_frequencies_are_one_with_their_mean() -> None:
    values = np.array([60e6, 40e6, 60e6 + 30, 40e6 + 50])
    means, group = parts.distinct(values)
    assert_allclose(means, [40e6, 40e6 + 50, 60e6 + 15], rtol=1e-12)
    assert group.tolist() == [2, 0, 2, 1]
    assert parts.groups(np.array([40e6])).tolist() == [0]
    assert parts.groups(np.array([100.0, 100.00009, 100.0003])).tolist() == [0, 0, 1]


def test_places_come_from_rows_then_angles_then_the_order() -> None:
    some = np.array([np.nan, 1.0])
    assert parts.places_known_by(samples(2, row=some, azimuth=some)) == "rows"
    assert parts.places_known_by(samples(2, azimuth=some)) == "angles"
    assert parts.places_known_by(samples(2)) == "order"


def channel_of(*numbers: int) -> tuple[Any, Any]:
    return np.array(numbers), np.zeros(len(numbers), int)


def test_samples_of_a_channel_are_counted_through_parts() -> None:
    before: dict[tuple[int, int], int] = {}
    assert parts.turn(channel_of(0, 1, 0, 0), before).tolist() == [0, 0, 1, 2]
    assert parts.turn(channel_of(1, 0), before).tolist() == [1, 3]
    assert parts.turn(channel_of(1, 0)).tolist() == [0, 0]


@pytest.mark.parametrize(
    ("order", "columns"), [("serpentine", [0, 1, 2, 2, 1, 0]),
                           ("raster", [0, 1, 2, 0, 1, 2])],
)  # fmt: skip
def test_pixels_in_order_follow_the_scan(order: str, columns: list[int]) -> None:
    scan = SimpleNamespace(rows=2, columns=3, order=order)
    survey: Any = SimpleNamespace(scan=scan)
    channel = channel_of(*[0] * 6)
    row, column = parts.pixels(PATH, samples(6), channel, survey)
    assert row.tolist() == [0, 0, 0, 1, 1, 1]
    assert column.tolist() == columns
    with pytest.raises(FormatError) as refused:
        parts.pixels(PATH, samples(8), channel_of(*[0] * 8), survey)
    assert str(refused.value).startswith(
        "record.csv: 2 of 8 samples of the scan lie between or beyond its 2 x 3 "
        "pixels, the first one at row 2, column 0; check"
    )


def test_pixels_of_rows_are_inside_the_scan() -> None:
    survey: Any = SimpleNamespace(scan=SimpleNamespace(rows=2, columns=3, order="x"))
    rows, columns = np.array([0.4, 1.0]), np.array([2.0, 0.5])
    found = parts.pixels(
        PATH, samples(2, row=rows, column=columns), channel_of(0, 0), survey
    )
    assert [part.tolist() for part in found] == [[0, 1], [2, 0]]
    for row, column in ((-1, 0), (2, 0), (0, -1), (0, 3)):
        beyond = samples(1, row=np.array([row]), column=np.array([column]))
        with pytest.raises(FormatError, match=f"at row {row}, column {column};"):
            parts.pixels(PATH, beyond, channel_of(0), survey)


def test_pixels_of_angles_are_the_nearest_of_the_grid(plate: Survey) -> None:
    azimuth, elevation, _ = scan_directions(plate)
    near = samples(2, azimuth=azimuth[[0, 5], [0, 11]],
                   elevation=elevation[[2, 4], [0, 0]])  # fmt: skip
    row, column = parts.pixels(PATH, near, channel_of(0, 0), plate)
    assert row.tolist() == [2, 4]
    assert column.tolist() == [0, 11]
    step = azimuth[0, 1] - azimuth[0, 0]
    for share, place in ((0.49, 3), (0.51, 4)):
        moved = samples(1, azimuth=azimuth[0, 3:4] + share * step,
                        elevation=elevation[1:2, 0])  # fmt: skip
        found = parts.pixels(PATH, moved, channel_of(0), plate, known_by="angles")
        assert (found[0][0], found[1][0]) == (1, place)


def test_steps_of_a_grid_are_counted_from_its_first_angle() -> None:
    found = parts._steps(np.array([0.3, 0.15, -0.1]), np.array([0.3, 0.2, 0.1]))
    assert_allclose(found, [0, 1.5, 4])
    assert parts._steps(np.array([5.0, 7.0]), np.array([1.0])).tolist() == [0, 0]


def test_neighbors_are_the_eight_around() -> None:
    signal = (np.arange(6.0).reshape(1, 1, 2, 3)).astype(complex)
    found = parts.around(signal)
    assert len(found) == 8
    of_first = [complex(part[0, 0, 0, 0]) for part in found]
    assert sorted(value.real for value in of_first if value == value) == [1, 3, 4]
    of_middle = [complex(part[0, 0, 1, 1]) for part in found]
    # From the upper left to the lower right.
    assert [v.real for v in of_middle[:5]] == [0, 1, 2, 3, 5]
    assert np.isnan([v.real for v in of_middle[5:]]).all()


def test_the_nearest_neighbor_is_the_least_different() -> None:
    signal = np.array([[[[1.0, 4.0, np.nan], [1 + 1j, 9.0, 20.0]]]], complex)
    found = parts.nearest_distance(signal)[0, 0]
    assert_allclose(found, [[1, 3, np.nan], [1, 5, 11]])
    alone = parts.nearest_distance(np.ones((1, 1, 1, 1), complex))
    assert np.isnan(alone).all()
    assert parts.median_of(found) == 3
    assert np.isnan(parts.median_of(alone))


def test_the_distance_from_mixtures_is_that_from_lines() -> None:
    beside = np.array([[0.0 + 0j, 0], [4.0, 2j], [np.nan, np.nan]])
    off, spread = parts.off_mixtures(np.array([1 + 2j, 1 + 5j]), beside)
    # Off the line from 0 to 4 by 2; beyond the end of that from 0 to 2i.
    assert_allclose(off, [2, np.hypot(1, 3)])
    assert_allclose(spread, [4, 2])
    same, none = parts.off_mixtures(np.array([3 + 4j]), np.array([[0j], [0j]]))
    assert (same[0], none[0]) == (5, 0)


def frames(steps: Any, **constants: Any) -> Any:
    settings: Any = SimpleNamespace(
        frequencies=(40e6, 60e6), phase_steps=steps, phase_unit="deg", scale=2.0,
        radians=lambda unit: np.pi / 180 if unit == "deg" else np.nan, **constants,
    )  # fmt: skip
    lists = (("a", "b", "c"), ("d", "e", "f"))
    return SimpleNamespace(constants=settings, columns=SimpleNamespace(phases=lists))


@pytest.mark.parametrize("steps", [None, (0.0, 100.0, 220.0)])
def test_frames_are_a_mean_and_a_wave(steps: Any) -> None:
    turn = np.radians(steps if steps is not None else [0, 120, 240])
    offset, amplitude, phase = np.array([5.0, 1.0]), np.array([2.0, 3.0]), 0.7
    values = {
        name: offset + size * amplitude * np.cos(phase + turn[k % 3])
        for k, (name, size) in enumerate(zip("abcdef", [1, 1, 1, 2, 2, 2], strict=True))
    }
    signal, mean, frequency = parts._of_frames(frames(steps), values.__getitem__)
    wave = np.exp(1j * phase)
    assert_allclose(signal, np.array([4, 6, 8, 12]) * wave)
    # A mean below the amplitude is none of light.
    assert_allclose(mean, [10, np.nan, 10, np.nan])
    assert frequency.tolist() == [40e6, 40e6, 60e6, 60e6]


def test_steps_that_do_not_differ_determine_no_phase() -> None:
    values = dict.fromkeys("abcdef", np.ones(1))
    for steps in ((0.0, 180.0, 360.0), (0.0, 0.05, 0.1)):
        with pytest.raises(FormatError) as refused:
            parts._of_frames(frames(steps), values.__getitem__)
        assert str(refused.value) == (
            "constants.phase_steps do not determine the phase; needed are three or "
            "more different phases of the reference"
        )
