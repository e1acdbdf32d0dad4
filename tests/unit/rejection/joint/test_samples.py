"""Samples of a joint estimation: refusals, weights, grids and parts."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import estimate, samples
from amulor.rejection.joint.samples import Pixels
from amulor.rejection.observation import observe_scan


def pixels(count: int = 5, *, motion: bool = True) -> Pixels:
    """Return samples of different numbers everywhere."""
    rng = np.random.default_rng(1)
    shape = count, 2, 3
    variance = rng.uniform(1, 2, (2, *shape))
    return Pixels(
        signal=rng.standard_normal(shape) + 1j * rng.standard_normal(shape),
        covariance=Covariance(variance[0], variance[1], rng.uniform(-0.5, 0.5, shape)),
        usable=rng.random(shape) > 0.2,
        interpolation=rng.random((count, 4)),
        offset=rng.random(count),
        shortest=1.0 + rng.random(count),
        longest=4.0 + rng.random(count),
        depths=rng.random((count, 7)),
        trends=rng.random((count, 2)),
        motion=rng.random((*shape, 2)) if motion else None,
    )


@pytest.mark.parametrize("motion", [False, True])
def test_a_part_holds_all_arrays_of_its_pixels(motion: bool) -> None:
    whole = pixels(motion=motion)
    assert len(whole) == 5
    for index in (np.array([3, 0]), slice(1, 4)):
        part = whole.part(index)
        for name, values in vars(whole).items():
            found = getattr(part, name)
            if name == "covariance":
                for own, all_of in zip(
                    vars(found).values(), vars(values).values(), strict=True
                ):
                    assert_array_equal(own, all_of[index])
            elif values is None:
                assert found is None
            else:
                assert_array_equal(found, values[index])


@pytest.mark.parametrize("scale", [1.0, 1.7])
@pytest.mark.parametrize("moves", [False, True])
def test_weights_are_inverse_covariances(scale: float, moves: bool) -> None:
    part = pixels()
    deviation = 0.3 * part.signal if moves else None
    found = samples.weight(part, deviation, scale)
    assert found.shape == (5, 2, 3, 3)
    for n, c, f in np.ndindex(5, 2, 3):
        if not part.usable[n, c, f]:
            assert_array_equal(found[n, c, :, f], 0.0)
            continue
        xx, yy, xy = (v[n, c, f] for v in vars(part.covariance).values())
        square = scale**2 * np.array([[xx, xy], [xy, yy]])
        if deviation is not None:
            move = deviation[n, c, f]
            side = np.array([move.real, move.imag])
            square = square + np.outer(side, side)
        inverse = np.linalg.inv(square)
        expected = [inverse[0, 0], inverse[0, 1], inverse[1, 1]]
        assert_allclose(found[n, c, :, f], expected, rtol=1e-9)


def test_a_grid_has_twelve_points_in_a_period_and_spans_all_pixels() -> None:
    part = pixels()
    rates = np.array([0.8, 2.5, 1.1])
    grid = samples.grid_of(part, rates)
    step = 2 * np.pi / 2.5 / 12
    assert_allclose(np.diff(grid), step)
    # Whole numbers of steps, one beyond each end.
    assert_allclose(grid / step, np.round(grid / step), atol=1e-9)
    assert part.shortest.min() - 2 * step < grid[0] <= part.shortest.min() - step
    assert part.longest.max() + step <= grid[-1] < part.longest.max() + 2 * step


@pytest.mark.parametrize(("points", "refused"), [(20_000, False), (20_001, True)])
def test_a_grid_of_too_many_points_is_refused(points: int, refused: bool) -> None:
    part = pixels()
    # A step of 1 m, from -1 m on.
    rates = np.array([2 * np.pi / 12])
    part = Pixels(
        **vars(part)
        | {"shortest": np.full(5, 0.5), "longest": np.full(5, points - 3.0)}
    )
    if not refused:
        assert samples.grid_of(part, rates).size == points
        return
    words = (
        "the interval holds 1.67e+03 ambiguity intervals of the highest modulation "
        "frequency; narrow it"
    )
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        samples.grid_of(part, rates)
    assert str(refusal.value) == words


def test_one_frequency_is_refused() -> None:
    samples.refuse_single_frequency(np.array([20e6, 30e6]))
    with pytest.raises(CubeError) as refusal:
        samples.refuse_single_frequency(np.array([20.5e6]))
    assert str(refusal.value) == (
        "the cube has one modulation frequency, 20.5 MHz; joint estimation needs two "
        "or more to tell target from water: record a sweep, or use open-water, "
        "polarization or cross-polarized"
    )


def frame_at(window: float | None) -> Any:
    emitter = SimpleNamespace(position=(0.3, 0.1, 0.5))
    return SimpleNamespace(
        medium=SimpleNamespace(window_distance=window),
        survey=SimpleNamespace(instrument=SimpleNamespace(emitter=emitter)),
    )


def test_an_emitter_may_not_move_towards_its_window() -> None:
    near = 0.5 + np.array([[0.0, 0.99e-4], [-0.99e-4, 0.0]])
    samples.refuse_other_windows(near, frame_at(0.1))
    samples.refuse_other_windows(near + 1.0, frame_at(None))
    for off in (0.02, -0.02):
        place = 0.5 + np.array([[0.0, 0.01], [off, -0.01]])
        with pytest.raises(CubeError) as refusal:
            samples.refuse_other_windows(place, frame_at(0.1))
        assert str(refusal.value) == (
            f"origin_z is up to {off:g} m off the emitter of the survey, behind a "
            "window: joint estimation needs the same way to the window in all pixels; "
            "split the scan, with a survey for each part, or use the open-water method"
        )
    with pytest.raises(CubeError, match=r"up to 0\.000101 m"):
        samples.refuse_other_windows(np.array([0.500101]), frame_at(0.1))


@pytest.mark.parametrize(
    ("errors", "refused"),
    [
        ((1.0, 1.0, 0.99), False),
        ((1.0, 1.0, 1.0), True),
        ((0.0, 1.0, 0.0), True),
        ((1.0, 0.0, 0.0), True),
        ((np.nan, 1.0, 0.0), True),
    ],
)
def test_samples_without_an_error_are_refused(
    errors: tuple[float, float, float], refused: bool
) -> None:
    good = np.array([1.0, 1.0])
    covariance = Covariance(
        *(np.append(other * good, value) for other, value in zip((1, 1, 0), errors,
                                                                strict=True))
    )  # fmt: skip
    samples.refuse_errors_of_zero(covariance, np.array([True, True, False]))
    if not refused:
        samples.refuse_errors_of_zero(covariance, np.ones(3, dtype=bool))
        return
    with pytest.raises(CubeError) as refusal:
        samples.refuse_errors_of_zero(covariance, np.ones(3, dtype=bool))
    assert str(refusal.value) == (
        "in_phase_uncertainty and quadrature_uncertainty must be above 0 V in every "
        "sample: joint estimation weighs the samples by them; state the noise of the "
        "instrument"
    )


def shots_of(count: int, **directions: Any) -> Any:
    signal = np.arange(count) + np.zeros((2, 1, 1)) + 0j
    angles = tuple(directions.get(name) for name in ("azimuth", "elevation"))
    return SimpleNamespace(signal=signal, directions=angles)


def test_shots_of_unknown_direction_stand_in_the_middle() -> None:
    for found in samples.shot_directions((0.1, 0.2), None):
        assert found.shape == (0,)
    azimuth, elevation = samples.shot_directions((0.1, 0.2), shots_of(3))
    assert_array_equal(azimuth, [0.1, 0.1, 0.1])
    assert_array_equal(elevation, [0.2, 0.2, 0.2])
    known = shots_of(2, azimuth=np.array([1.0, 2.0]), elevation=np.array([3.0, 4.0]))
    azimuth, elevation = samples.shot_directions((0.1, 0.2), known)
    assert_array_equal(azimuth, [1.0, 2.0])
    assert_array_equal(elevation, [3.0, 4.0])


@pytest.mark.parametrize(("count", "taken"), [(1, 1), (1024, 1024), (1025, 1024)])
def test_shots_are_taken_evenly_up_to_1024(
    monkeypatch: pytest.MonkeyPatch, count: int, taken: int
) -> None:
    good = Covariance(np.ones(1), np.ones(1), np.zeros(1))

    class Flat:
        def part(self, index: np.ndarray) -> Any:
            return SimpleNamespace(
                index=index, covariance=good, usable=np.ones(1, dtype=bool)
            )

    def pixels_of(frame: Any, part: Any, azimuth: Any, elevation: Any) -> Any:
        return frame, part.index, azimuth, elevation

    monkeypatch.setattr(samples, "pixels_of", pixels_of)
    shots = shots_of(count)
    shots.flat = Flat
    directions = np.arange(count) + 0.5, np.arange(count) - 0.5
    frame: Any = object()
    found: Any = samples.shot_pixels(frame, shots, directions)
    assert found[0] is frame
    index = found[1]
    assert len(index) == taken
    assert (index[0], index[-1]) == (0, count - 1)
    assert set(np.diff(index)) <= {1, 2}
    assert_array_equal(found[2], index + 0.5)
    assert_array_equal(found[3], index - 0.5)
    assert samples.shot_pixels(frame, None, directions) is None
    bad = Covariance(np.zeros(1), np.ones(1), np.zeros(1))
    monkeypatch.setattr(
        Flat, "part", lambda self, index: SimpleNamespace(
            covariance=bad, usable=np.ones(1, dtype=bool)
        ),
    )  # fmt: skip
    with pytest.raises(CubeError, match="must be above 0 V"):
        samples.shot_pixels(frame, shots, directions)


def test_a_scan_with_an_error_of_zero_is_refused(
    by_hand: Callable[..., xr.Dataset],
) -> None:
    cube = by_hand(frequency=[20e6, 50e6], channels={"VV": (1.0, 1.0)}, shape=(3, 4))
    estimate._extent_of(observe_scan(cube))
    cube["quadrature_uncertainty"].values[1, 0, 2, 3] = 0.0
    with pytest.raises(CubeError, match="must be above 0 V in every sample"):
        estimate._extent_of(observe_scan(cube))
