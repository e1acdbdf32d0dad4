"""Tables of the water signal: what they hold is the diffusion model."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.testing import assert_allclose

from amulor.optics import small_angle_diffusion
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint.model import water_at
from amulor.rejection.joint.overlap.frame import frame_of
from amulor.rejection.joint.overlap.integral import table_of
from amulor.rejection.joint.overlap.shape import Shape
from amulor.rejection.joint.pixels import Pixels
from amulor.survey import Survey, water_properties
from amulor.survey.view import kernel_arguments, medium, view


def test_the_table_is_the_water_signal_of_the_diffusion_model(
    samples: xr.Dataset,
) -> None:
    frequency = samples["modulation_frequency"].values
    azimuth, elevation = samples["azimuth"].values, samples["elevation"].values
    frame = frame_of(samples, azimuth.ravel(), elevation.ravel())
    # So much scattering that no light goes straight.
    shape = Shape(0.255, 0.0357, 1e4, np.zeros(0), np.zeros(0))
    table = table_of(frame, shape, deepest=3.0)
    count = azimuth.size
    depth = np.linspace(0.3, 2.9, count)
    nothing = np.zeros((count, 1, frequency.size))
    pixels = Pixels(
        signal=nothing.astype(complex),
        covariance=Covariance(nothing + 1.0, nothing + 1.0, nothing),
        usable=nothing == 0,
        interpolation=frame.directions.interpolation(
            azimuth.ravel(), elevation.ravel()
        ),
        offset=np.zeros(count),
        shortest=np.zeros(count),
        longest=np.full(count, 4.0),
        # The path is the depth itself.
        depths=4.0 * np.linspace(0, 1, 33) ** 2 * np.ones((count, 1)),
        trends=np.zeros((count, 0)),
    )
    end, water, slope = water_at(pixels, depth, table, frame.phase_per_path)
    assert_allclose(end, depth, rtol=1e-12)
    survey = Survey.from_text(samples.attrs["survey"])
    properties = water_properties(survey)
    where = view(
        survey, azimuth.ravel(), elevation.ravel(), medium=medium(survey, properties)
    )
    geometry = kernel_arguments(survey, properties, where)
    stated = {
        "absorption": 0.255,
        "forward_scattering": 0.0357,
        "diffuse_scattering": 0.0,
        "second_moment": 1.0,
    }

    def response(depth: np.ndarray) -> np.ndarray:
        return small_angle_diffusion.water_response(
            frequency[:, None],
            backscatter_vsf=1.0,
            group_index=1.38,
            end=depth,
            **(geometry | stated),
        ).T

    exact = response(depth)
    largest = abs(exact).max()
    # The interpolation over the scan is good to 1e-4 of the largest overlap.
    assert_allclose(water * table.strength / largest, exact / largest, atol=3e-4)
    rise = (response(depth + 1e-4) - response(depth - 1e-4)) / 2e-4
    steepest = abs(rise).max()
    # The same for the derivative, with the cubic's error of its own.
    assert_allclose(slope * table.strength / steepest, rise / steepest, atol=3e-3)
