"""Course of a joint estimation: sampled pixels, fits with and without shots, blocks."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.rejection.joint.priors import Clock
from amulor.rejection.observation import Observation, observe_scan

Make = Callable[..., xr.Dataset]
module: Any = importlib.import_module("amulor.rejection.joint.estimate")


@pytest.fixture
def cube(by_hand: Make) -> xr.Dataset:
    return by_hand(
        frequency=[20e6, 50e6, 80e6], channels={"VV": (1.0, 1.0)}, shape=(5, 6),
        shots=9,
    )  # fmt: skip


class Course:
    """A fit of shared parameters whose parts are given, and what asks for them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **shared: Any) -> None:
        self.fits: list[Any] = []
        self.doubts: list[Any] = []
        values = {"evidence": 20.0, "water_departs": True}
        self.shared = SimpleNamespace(**values | shared)
        self.frame = SimpleNamespace(name="frame")
        self.sample: Any = None
        self.shots: Any = "shots"

        def frame_of(head: Any, azimuth: Any, elevation: Any) -> Any:
            self.directions = azimuth, elevation
            return self.frame

        def sampled(
            scan: Any, sample: Any, frame: Any, clock: Any, interval: Any
        ) -> Any:
            self.sample = sample
            pixels = SimpleNamespace(
                depths=np.array([[1.0, 3.5], [2.0, 0.5]]),
                longest=np.array([5.0, 9.0]), shortest=np.array([1.0, 4.0]),
            )  # fmt: skip
            return pixels, "geometry"

        def fit(frame: Any, pixels: Any, shots: Any, **options: Any) -> Any:
            self.fits.append((shots, options))
            return self.shared

        def echo_departs(*arguments: Any) -> bool:
            self.doubts.append(arguments)
            return True

        monkeypatch.setattr(module, "frame_of", frame_of)
        monkeypatch.setattr(module, "_sampled", sampled)
        monkeypatch.setattr(module, "shot_pixels", lambda *_: self.shots)
        monkeypatch.setattr(module.joint_shared, "fit", fit)
        monkeypatch.setattr(module, "solve", lambda *arguments: "result")
        monkeypatch.setattr(module, "typical_of", lambda *_: (0.02, 3e-4))
        monkeypatch.setattr(module, "echo_departs", echo_departs)

    def run(self, cube: xr.Dataset, **options: Any) -> Any:
        words: dict[str, Any] = {
            "interval": (1.0, 2.0), "transfer": np.ones(3, dtype=complex),
            "instrument": SimpleNamespace(direction=0.03),
        }  # fmt: skip
        return module.common_of(observe_scan(cube), **words | options)


def test_shared_parameters_are_those_of_a_sample_of_the_pixels(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = Course(monkeypatch, evidence=9.9)
    cube["in_phase"].values[:2, 0, 2, 3] = np.nan
    cube["in_phase"].values[:1, 0, 2, 4] = np.nan
    found = course.run(cube)
    # All pixels with two frequencies or more.
    assert_array_equal(course.sample, np.delete(np.arange(30), 15))
    ((shots, options),) = course.fits
    assert shots == "shots"
    assert options["deepest"] == 3.5
    assert options["turn_width"] == 0.03
    assert found.interval == (1.0, 2.0)
    assert found.scan.frame is course.frame
    assert found.scan.shared is course.shared
    assert found.scan.span == 5.0
    assert (found.scan.late_spread, found.scan.instrument_uncertainty) == (0.02, 3e-4)
    assert not found.scan.echo_is_doubted
    assert (found.clock.rows, found.clock.columns) == (5, 6)
    # Directions of the scan's ends and of the shots.
    azimuth, elevation = course.directions
    assert azimuth.shape == elevation.shape == (11,)
    assert_allclose(azimuth[:2], [-0.02, 0.02])
    assert_allclose(elevation[:2], [-0.01, 0.01])
    assert_array_equal(azimuth[2:], cube["open_water_azimuth"].values)
    assert_array_equal(elevation[2:], cube["open_water_elevation"].values)


@pytest.mark.parametrize(
    ("shared", "shots", "doubted"),
    [
        ({}, "shots", True),
        ({"evidence": 10.0}, "shots", False),
        ({"evidence": 10.1}, "shots", True),
        ({"water_departs": False}, "shots", False),
        ({}, None, False),
    ],
)
def test_shots_of_other_water_are_doubted_by_a_fit_without_them(
    cube: xr.Dataset,
    monkeypatch: pytest.MonkeyPatch,
    shared: dict[str, Any],
    shots: Any,
    doubted: bool,
) -> None:
    course = Course(monkeypatch, **shared)
    course.shots = shots
    found = course.run(cube)
    assert found.scan.echo_is_doubted == doubted
    assert [given for given, _ in course.fits] == [shots, *([None] if doubted else [])]
    if doubted:
        ((geometry, result, shared_of, instrument),) = course.doubts
        assert (geometry, result) == ("geometry", "result")
        assert shared_of is course.shared
        assert instrument.direction == 0.03


def test_a_large_scan_is_sampled_evenly(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = Course(monkeypatch)
    monkeypatch.setattr(module, "SHARING", 7)
    cube = by_hand(frequency=[2e7, 5e7], channels={"VV": (1.0, 1.0)}, shape=(3, 9))
    course.run(cube, transfer=np.ones(2, dtype=complex))
    assert_array_equal(course.sample, [0, 4, 8, 13, 17, 21, 26])


def test_a_scan_without_usable_pixels_is_refused(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = Course(monkeypatch)
    cube["in_phase"].values[1:] = np.nan
    with pytest.raises(CubeError) as refusal:
        course.run(cube)
    assert str(refusal.value) == (
        "no pixel has usable samples at two frequencies or more; look at the flags of "
        "the samples (missing, saturated) and measure again"
    )


def test_sampled_pixels_come_from_all_tiles(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []

    def pixels_of(
        frame: Any, samples: Any, azimuth: Any, elevation: Any, **options: Any
    ) -> Any:
        given.append((samples.signal[:, 0, 0], azimuth, elevation, options))
        return "pixels"

    def trends_of(rows: Observation, clock: Any, *, row: int) -> np.ndarray:
        count = rows.azimuth.size
        return 6.0 * row + np.arange(count)[:, None]

    monkeypatch.setattr(module, "pixels_of", pixels_of)
    monkeypatch.setattr(module, "trends_of", trends_of)
    monkeypatch.setattr(module, "_joined", lambda parts: parts)
    source = tiles.InMemory(cube)
    scan: Any = SimpleNamespace(
        bands=[(0, 2), (2, 3), (3, 5)], columns=6,
        tile=lambda begin, end: Observation(cube=source.tile(begin, end)),
    )  # fmt: skip
    frame: Any = SimpleNamespace(
        geometry=lambda azimuth, elevation: (azimuth, elevation)
    )
    sample = np.array([0, 5, 11, 18, 29])
    parts, geometry = module._sampled(scan, sample, frame, "clock", (1.0, 2.0))
    # No pixel of the third row.
    assert parts == ["pixels", "pixels"]
    flat = cube.amulor.signal.values[0, 0].ravel()
    assert_array_equal(np.concatenate([part[0] for part in given]), flat[sample])
    azimuth, elevation = cube["azimuth"].values, cube["elevation"].values
    assert_array_equal(geometry[0], azimuth.ravel()[sample])
    assert_array_equal(geometry[1], elevation.ravel()[sample])
    for _, _, _, options in given:
        assert options["interval"] == (1.0, 2.0)
    trends = np.concatenate([part[3]["trends"] for part in given])
    assert_array_equal(trends[:, 0], sample)


@pytest.mark.parametrize("at_once", [4, 7, 12, 100])
def test_rows_are_estimated_in_blocks(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    given: list[Any] = []
    clock = Clock(rows=50, columns=6, has_times=False, begin=0.0, length=299.0)

    def pixels_of(
        frame: Any, samples: Any, azimuth: Any, elevation: Any, **options: Any
    ) -> Any:
        return azimuth, options

    def trends_of(block: Any, clock: Any, *, row: int, column: int) -> Any:
        given.append((row, column, block.azimuth.shape))
        return "trends"

    def cube_of(block: Observation, scan: Any, result: Any) -> xr.Dataset:
        return block.cube[["in_phase"]] * 2

    monkeypatch.setattr(module, "_AT_ONCE", at_once)
    monkeypatch.setattr(module, "pixels_of", pixels_of)
    monkeypatch.setattr(module, "trends_of", trends_of)
    monkeypatch.setattr(module, "solve", lambda *_: "result")
    monkeypatch.setattr(module, "cube_of", cube_of)
    monkeypatch.setattr(module, "each", lambda function, places: map(function, places))
    common: Any = SimpleNamespace(
        scan=SimpleNamespace(frame="frame", shared="shared"), clock=clock,
        interval=(1.0, 2.0), transfer="transfer",
    )  # fmt: skip
    bare = cube.drop_vars([n for n in cube.variables if "open_water" in str(n)])
    found = module.of_rows(bare, common, 10)
    assert_array_equal(found["in_phase"].values, 2 * cube["in_phase"].values)
    wide = min(6, at_once)
    high = max(1, at_once // wide)
    expected = [
        (10 + row, column, (min(high, 5 - row), min(wide, 6 - column)))
        for row in range(0, 5, high)
        for column in range(0, 6, wide)
    ]
    assert given == expected


@pytest.mark.parametrize(
    ("transfer", "accepted"),
    [
        ([1.0, 0.9j, -0.5], True), ([1.0, 0.9], False), ([1.0, 0.0, 1.0], False),
        ([1.0, np.nan, 1.0], False), ([1.0, np.inf, 1.0], False),
    ],
)  # fmt: skip
def test_a_transfer_has_a_number_for_each_frequency(
    transfer: list[complex], accepted: bool
) -> None:
    frequency = np.array([20e6, 50e6, 80e6])
    assert_array_equal(module._checked_transfer(None, frequency), np.ones(3))
    values = np.array(transfer)
    if accepted:
        found = module._checked_transfer(values, frequency)
        assert_array_equal(found, values)
        assert found.dtype == complex
        return
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        module._checked_transfer(values, frequency)
    assert str(refusal.value) == (
        "echo_transfer must be one finite number other than 0 for each of the 3 "
        f"modulation frequencies, got shape {values.shape}"
    )


@pytest.mark.parametrize("late", [False, True])
def test_an_instrument_has_these_errors_by_default(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch, late: bool
) -> None:
    given: list[Any] = []
    monkeypatch.setattr(
        module, "common_of", lambda scan, **options: given.append(options)
    )
    if not late:
        cube.attrs["late_echo"] = "absent"
    source = tiles.InMemory(cube)
    module.prepared(source)
    instrument = given[0]["instrument"]
    assert (instrument.delay, instrument.group_index, instrument.position) == (0, 0, 0)
    assert instrument.direction == pytest.approx(np.radians(1.0))
    assert instrument.late_echo == (0.5 if late else 0.0)
    assert given[0]["interval"] is None
    assert_array_equal(given[0]["transfer"], np.ones(3))
    module.prepared(
        source, interval=(1.0, 2.0), delay_uncertainty=1e-11,
        group_index_uncertainty=1e-3, receiver_position_uncertainty=2e-3,
        receiver_direction_uncertainty=3e-3, late_echo_uncertainty=0.2,
    )  # fmt: skip
    instrument = given[1]["instrument"]
    found = (
        instrument.delay, instrument.group_index, instrument.position,
        instrument.direction, instrument.late_echo,
    )  # fmt: skip
    assert found == (1e-11, 1e-3, 2e-3, 3e-3, 0.2)
    assert given[1]["interval"] == (1.0, 2.0)
