"""The part of the open water that lies behind the target, and so is not there."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics import rays, small_angle_diffusion
from amulor.survey import Survey, water_properties
from amulor.survey.view import kernel_arguments, medium, view


def hidden_share(
    cube: xr.Dataset, target_signal: NDArray[np.complex128]
) -> NDArray[np.complex128] | None:
    """Return which part of the open-water signal comes from behind the target.

    Parameters
    ----------
    cube : xarray.Dataset
        Samples whose attribute `survey` describes the water; the description is what
        the user knew beforehand, not the truth of a simulation.
    target_signal : ndarray, shape (modulation_frequency, polarization, row, column)
        Target signal so far, from whose phase the distance is taken [V].

    Returns
    -------
    ndarray of the same shape, or None
        Share of the open-water signal, a complex number since it comes later [1];
        None if the cube has no survey to take the water from.

    Notes
    -----
    Decision on (46) of Ricci et al. 2010: open water is integrated to its end, water
    with a target to the target; the difference stays when open water is subtracted.
    The distance is that of the first ambiguity interval of the lowest frequency.
    """
    text = cube.attrs.get("survey")
    if not text:
        return None
    survey = Survey.from_text(text, name="survey in the cube")
    water = water_properties(survey)
    surroundings = medium(survey, water)
    azimuth, elevation = cube["azimuth"].values, cube["elevation"].values
    frequency = cube["modulation_frequency"].values
    beam = rays.enter_water(
        survey.instrument.emitter.position,
        rays.direction(azimuth, elevation),
        medium=surroundings,
    )
    # One depth for all channels, from the sum of what they see of the target.
    phase = np.mod(np.angle(target_signal[0].sum(axis=0)), 2 * np.pi)
    slant_range = rays.slant_range_of_path(
        phase * speed_of_light / (2 * np.pi * frequency[0]),
        beam,
        survey.instrument.receiver.position,
        medium=surroundings,
    )
    depth = np.maximum(slant_range - beam.length_before, 0.0)
    depth = np.where(np.isfinite(depth), depth, np.inf)
    arguments = kernel_arguments(
        survey, water, view(survey, azimuth, elevation, medium=surroundings)
    ) | {
        "backscatter_vsf": water.backscatter_vsf,
        "group_index": water.group_index,
    }
    each = frequency[:, None, None]
    end = np.inf if survey.water.column_end is None else survey.water.column_end
    whole = small_angle_diffusion.water_response(each, end=end, **arguments)
    behind = small_angle_diffusion.water_tail(
        each, end=np.minimum(depth, end), **arguments
    )
    if np.isfinite(end):
        behind = behind - small_angle_diffusion.water_tail(each, end=end, **arguments)
    share: NDArray[np.complex128] = behind / whole
    return np.broadcast_to(share[:, None], target_signal.shape)
