"""Tables of the water signal: they hold the small-angle form, and the diffusion one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.optics import small_angle, small_angle_diffusion
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint.normal import water_at
from amulor.rejection.joint.overlap import Shape, frame_of
from amulor.rejection.joint.samples import Pixels
from amulor.rejection.joint.tables import table_of
from amulor.rejection.observation import Observation
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.view import View, kernel_arguments, view
from amulor.survey.waters.whole_function import whole_function_arguments

Response = Callable[[np.ndarray], np.ndarray]


@pytest.mark.parametrize("form", ["small-angle", "diffusion", "stretched"])
def test_the_table_is_the_water_signal_of_the_form(
    samples: xr.Dataset, form: str
) -> None:
    azimuth = samples["azimuth"].values.ravel()
    elevation = samples["elevation"].values.ravel()
    frame = frame_of(Observation(cube=samples), azimuth, elevation)
    if form == "diffusion":
        # So much scattering that no light goes straight.
        shape = Shape(0.255, 0.0357, 1e4, np.zeros(0), np.zeros(0))
        response = diffusion_form(samples)
    elif form == "small-angle":
        # The water of the survey, 0.06 rad^2.
        shape = Shape(0.255, 0.595 * 0.06, 0.595, np.zeros(0), np.zeros(0))
        response = small_angle_form(samples, forward=0.595)
    else:
        # Twice as much scattering by angles that are half as large.
        shape = Shape(0.255, 1.19 * 0.015, 1.19, np.zeros(0), np.zeros(0))
        response = small_angle_form(samples, forward=1.19, narrower=2)
    table = table_of(frame, shape, deepest=3.0)
    frequency = samples["modulation_frequency"].values
    count = azimuth.size
    depth = np.linspace(0.3, 2.9, count)
    nothing = np.zeros((count, 1, frequency.size))
    pixels = Pixels(
        signal=nothing.astype(complex),
        covariance=Covariance(nothing + 1.0, nothing + 1.0, nothing),
        usable=nothing == 0,
        interpolation=frame.directions.interpolation(azimuth, elevation),
        offset=np.zeros(count),
        shortest=np.zeros(count),
        longest=np.full(count, 4.0),
        # The path is the depth itself.
        depths=4.0 * np.linspace(0, 1, 33) ** 2 * np.ones((count, 1)),
        trends=np.zeros((count, 0)),
    )
    end, water, slope = water_at(pixels, depth, table, frame.phase_per_path)
    assert_allclose(end, depth, rtol=1e-12)
    exact = response(depth)
    largest = abs(exact).max()
    # The interpolation over the scan is good to 1e-4 of the largest overlap.
    assert_allclose(water * table.strength / largest, exact / largest, atol=3e-4)
    rise = (response(depth + 1e-4) - response(depth - 1e-4)) / 2e-4
    steepest = abs(rise).max()
    # The same for the derivative, with the cubic's error of its own.
    assert_allclose(slope * table.strength / steepest, rise / steepest, atol=3e-3)


def test_derivatives_of_the_table_are_differences_of_tables(
    samples: xr.Dataset,
) -> None:
    azimuth = samples["azimuth"].values.ravel()
    elevation = samples["elevation"].values.ravel()
    frame = frame_of(Observation(cube=samples), azimuth, elevation)
    shape = Shape(0.3, 0.02, 0.4, np.array([0.1, -0.2]), np.array([0.5, 1.5]))
    weights = frame.directions.interpolation(azimuth, elevation)

    def open_water(shape: Shape) -> np.ndarray:
        table = table_of(frame, shape, deepest=3.0)
        signal: np.ndarray = weights @ table.basis @ table.value[:, -1]
        return signal

    changes = table_of(frame, shape, deepest=3.0).changes
    for parameter in range(shape.size):
        step = np.zeros(shape.size)
        step[parameter] = 1e-4
        rise = open_water(shape.moved(step)) - open_water(shape.moved(-step))
        derivative = weights @ changes.basis @ changes.value[parameter, :, -1]
        assert_allclose(derivative, rise / 2e-4, atol=2e-4 * abs(rise / 2e-4).max())


def diffusion_form(samples: xr.Dataset) -> Response:
    """Return the water signal by (46) against its end."""
    survey, properties, where = looks(samples)
    stated = {
        "absorption": 0.255,
        "forward_scattering": 0.0357,
        "diffuse_scattering": 0.0,
        "second_moment": 1.0,
    }
    arguments = kernel_arguments(survey, properties, where) | stated
    return partial(_response, samples, small_angle_diffusion.water_response, arguments)


def small_angle_form(
    samples: xr.Dataset, *, forward: float, narrower: float = 1.0
) -> Response:
    """Return the water signal by (29), the phase function made narrower."""
    survey, properties, where = looks(samples)
    arguments = whole_function_arguments(survey, properties, where)
    whole, split = arguments["phase_function"], arguments["split_angle"]
    fraction, _ = whole.forward_split(split)
    # What goes beyond the split angle is lost.
    loss = {"absorption": 0.255 - forward * (1 / fraction - 1)}
    arguments |= loss | {"scattering": forward / fraction}
    if narrower != 1:
        arguments |= {"absorption": 0.255, "scattering": forward}
        arguments |= {"split_angle": split / narrower}
        # As small angles have it: the solid angle falls with the square.
        arguments["phase_function"] = Narrowed(whole, narrower, split, fraction)
    return partial(_response, samples, small_angle.water_response, arguments)


@dataclass(frozen=True)
class Narrowed:
    """A phase function whose forward angles are smaller, with nothing beyond."""

    whole: PhaseFunction
    factor: float
    split: float
    fraction: float

    def __call__(self, angle: np.ndarray) -> np.ndarray:
        solid = np.sinc(self.factor * angle / np.pi) / np.sinc(angle / np.pi)
        inside = np.minimum(self.factor * angle, self.split)
        value = self.factor**2 * self.whole(inside) * solid / self.fraction
        return np.where(self.factor * angle <= self.split, value, 0.0)


def looks(samples: xr.Dataset) -> tuple[Survey, WaterProperties, View]:
    """Return survey, water and how the receiver looks at the pixels."""
    survey = Survey.from_text(samples.attrs["survey"])
    properties = water_properties(survey)
    where = view(
        survey,
        samples["azimuth"].values.ravel(),
        samples["elevation"].values.ravel(),
    )
    return survey, properties, where


def _response(samples, form, arguments, depth):
    return form(
        samples["modulation_frequency"].values[:, None],
        backscatter_vsf=1.0,
        group_index=1.38,
        end=depth,
        **arguments,
    ).T
