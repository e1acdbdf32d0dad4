"""Spatial unwrapping: surfaces across ambiguity intervals, and what it refuses."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import imaging
from amulor.cube import QualityFlag
from amulor.errors import CubeError, MissingExtraError

#: 200 MHz in air repeat after 0.7495 m.
FREQUENCY = 200e6


def _scene(
    distance: np.ndarray, *, frequency: float = FREQUENCY, noise: float = 1e-3
) -> xr.Dataset:
    """Return a target signal in air, seen by parallel beams, without any water."""
    rng = np.random.default_rng(1)
    shape = (1, 1, *distance.shape)
    phase = 4 * np.pi * frequency * distance / speed_of_light
    signal = np.exp(1j * phase) + noise * (
        rng.standard_normal(distance.shape) + 1j * rng.standard_normal(distance.shape)
    )
    x, y = np.meshgrid(
        np.arange(distance.shape[1]) * 1e-3, np.arange(distance.shape[0]) * 1e-3
    )
    return cubes.build(
        "target_signal",
        {
            "in_phase": signal.real.reshape(shape),
            "quadrature": signal.imag.reshape(shape),
            "in_phase_uncertainty": np.full(shape, noise),
            "quadrature_uncertainty": np.full(shape, noise),
            "water_in_phase": np.zeros(shape),
            "water_quadrature": np.zeros(shape),
            "quality_flag": np.zeros(shape, dtype=np.int16),
        },
        {
            "modulation_frequency": [frequency],
            "polarization": ["none"],
            "azimuth": np.zeros(distance.shape),
            "elevation": np.zeros(distance.shape),
            "origin_x": x,
            "origin_y": y,
            "origin_z": np.zeros(distance.shape),
        },
        geometry={
            "group_index": 1.0,
            "refractive_index": 1.0,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("target_signal", title="wall", source="by hand"),
    )


SLOPE = np.linspace(1.0, 3.2, 60) + np.linspace(0, 0.2, 20)[:, None]


def test_a_slope_through_three_intervals_is_followed() -> None:
    cube = _scene(SLOPE)
    # Pixel by pixel the interval is ambiguous and every pixel is lost.
    alone = imaging.range_image(cube, interval=(0.8, 3.6))
    assert np.isnan(alone["slant_range"]).all()
    image = imaging.unwrapped_range_image(cube, interval=(0.8, 3.6))
    cubes.check(image, "range_image")
    # 1e-3 rad are 0.12 mm; five of them.
    assert_allclose(image["slant_range"], SLOPE, rtol=0, atol=6e-4)
    sigma = 1e-3 * speed_of_light / (4 * np.pi * FREQUENCY)
    assert_allclose(image["slant_range_uncertainty"], sigma, rtol=1e-2)


@settings(max_examples=15)
@given(near=st.floats(0.3, 3.0), tilt=st.floats(-0.02, 0.02))
def test_any_gentle_plane_comes_out_in_its_place(near: float, tilt: float) -> None:
    distance = near + 0.5 + tilt * np.arange(20) + 0.004 * np.arange(8)[:, None]
    low, high = distance.min() - 0.05, distance.max() + 0.05
    image = imaging.unwrapped_range_image(_scene(distance), interval=(low, high))
    assert_allclose(image["slant_range"], distance, rtol=0, atol=6e-4)


@pytest.mark.parametrize("turned", [False, True])
def test_a_single_line_is_unwrapped(turned: bool) -> None:
    line = np.linspace(1.0, 3.2, 60)[None, :]
    line = line.T if turned else line
    image = imaging.unwrapped_range_image(_scene(line), interval=(0.8, 3.4))
    assert_allclose(image["slant_range"], line, rtol=0, atol=6e-4)


def test_a_surface_that_fits_in_two_ways_is_flagged() -> None:
    flat = np.full((6, 8), 1.5)
    image = imaging.unwrapped_range_image(_scene(flat), interval=(1.0, 2.5))
    assert (image["quality_flag"].values & QualityFlag.AMBIGUOUS).all()
    assert np.isnan(image["slant_range"]).all()


def test_surfaces_apart_from_each_other_stand_on_their_own() -> None:
    distance = np.full((6, 21), 1.2)
    distance[:, 11:] = np.linspace(1.0, 2.1, 10)
    cube = _scene(distance)
    cube["quality_flag"].values[..., 10] = QualityFlag.NO_TARGET
    image = imaging.unwrapped_range_image(cube, interval=(0.9, 2.2))
    # The slope fills the interval in one way only, the flat part fits in two.
    assert np.isnan(image["slant_range"][:, :11]).all()
    assert_allclose(image["slant_range"][:, 11:], distance[:, 11:], rtol=0, atol=6e-4)


def test_unusable_pixels_stay_unusable() -> None:
    cube = _scene(SLOPE)
    cube["quality_flag"].values[0, 0, 5, 7] = QualityFlag.SATURATED
    image = imaging.unwrapped_range_image(cube, interval=(0.8, 3.6))
    assert np.isnan(image["slant_range"][5, 7])
    assert int(image["slant_range"].isnull().sum()) == 1


def test_a_frequency_that_is_not_there_is_named() -> None:
    with pytest.raises(CubeError, match="at 100 MHz, but at 200 MHz"):
        imaging.unwrapped_range_image(
            _scene(SLOPE), interval=(0.8, 3.6), modulation_frequency=100e6
        )


def test_without_scikit_image_the_remedy_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest: object) -> object:
        if name.startswith("skimage"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingExtraError, match="scikit-image"):
        imaging.unwrapped_range_image(_scene(SLOPE), interval=(0.8, 3.6))


@pytest.mark.parametrize(
    ("errors", "chosen"),
    # Error of the range is that of the phase over the frequency: 4 / 2 against 3 / 1,
    # and 7 / 2 against 3 / 1.
    [((3e-3, 4e-3), 1), ((3e-3, 7e-3), 0)],
)
def test_the_frequency_with_the_smallest_error_of_the_range_is_taken(
    errors: tuple[float, float], chosen: int
) -> None:
    scenes = [
        _scene(SLOPE, frequency=frequency, noise=noise)
        for frequency, noise in zip((FREQUENCY, 2 * FREQUENCY), errors, strict=True)
    ]
    both = xr.concat(
        scenes, "modulation_frequency", data_vars="minimal", join="outer",
        coords="minimal", compat="override", combine_attrs="override",
    )  # fmt: skip
    image = imaging.unwrapped_range_image(both, interval=(0.8, 3.6))
    alone = imaging.unwrapped_range_image(scenes[chosen], interval=(0.8, 3.6))
    np.testing.assert_array_equal(
        image["slant_range"].values, alone["slant_range"].values
    )


@pytest.mark.parametrize("below", [-1.0, 1.5, 2.5, 3.9])
def test_a_lone_weak_pixel_below_the_interval_by_more_than_its_noise_is_flagged(
    below: float,
) -> None:
    sigma = 0.05 * speed_of_light / (4 * np.pi * FREQUENCY)
    distance = np.full((5, 5), 1.2)
    distance[2, 2] = 1.0 - below * sigma
    cube = _scene(distance)
    for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
        cube[name].values[..., 2, 2] = 0.05
    # No neighbor has a target: the pixel is a surface of its own.
    cube["quality_flag"].values[..., 1:4, 1:4] = QualityFlag.NO_TARGET
    cube["quality_flag"].values[..., 2, 2] = 0
    image = imaging.unwrapped_range_image(cube, interval=(1.0, 1.6))
    ambiguous = (image["quality_flag"].values & QualityFlag.AMBIGUOUS) != 0
    assert ambiguous[2, 2] == (below > 2)
    assert not ambiguous[0].any()
