"""The part of the open water that lies behind the target, and so is not there."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.optics import ambiguity, detection, rays
from amulor.rejection.covariance import Covariance
from amulor.rejection.reference import column_fraction
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.reach import unsettled_interval
from amulor.survey.view import medium


def hidden_fraction(
    cube: xr.Dataset,
    target_signal: NDArray[np.complex128],
    uncertainty: Covariance,
    *,
    interval: tuple[float, float] | None,
) -> NDArray[np.complex128] | None:
    """Return which part of the open-water signal comes from behind the target.

    Parameters
    ----------
    cube : xarray.Dataset
        Samples whose attribute `survey` describes the water; the description is what
        the user knew beforehand, not the truth of a simulation.
    target_signal : ndarray, shape (modulation_frequency, polarization, row, column)
        Target signal so far, from whose phase the distance is taken [V].
    uncertainty : Covariance
        Its errors.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    ndarray of the same shape, or None
        Fraction of the open-water signal, a complex number since it comes later [1];
        NaN where the distance is not settled. None if the cube has no survey to take
        the water from.

    Raises
    ------
    ValueError
        If the interval is empty or holds far too many ambiguity intervals.

    Notes
    -----
    Decision on (46) of Ricci et al. 2010, as rebuilt: open water is integrated to its
    end, water with a target to the target; the difference stays when open water is
    subtracted. That difference itself moves the distance by millimetres, and the
    fraction by a few tenths of a per cent of its value, which a second pass would not
    be worth. Large scans take the fraction from a table over directions and depths, see
    `column_fraction.fractions`.
    """
    text = cube.attrs.get("survey")
    if not text:
        return None
    survey = Survey.from_text(text, name="survey in the cube")
    water = water_properties(survey)
    depth = _depth(cube, target_signal, uncertainty, survey, water, interval)
    if interval is None and unsettled_interval(
        survey, modulation_frequency=cube["modulation_frequency"].values
    ):
        depth = np.full_like(depth, np.nan)
    settled = np.isfinite(depth)
    frequency = cube["modulation_frequency"].values
    fraction = np.full((frequency.size, *depth.shape), np.nan, dtype=complex)
    fraction[:, settled] = column_fraction.fractions(
        survey,
        cube["azimuth"].values[settled],
        cube["elevation"].values[settled],
        depth[settled],
        modulation_frequency=frequency,
    )
    return np.broadcast_to(fraction[:, None], target_signal.shape)


def _depth(
    cube: xr.Dataset,
    signal: NDArray[np.complex128],
    uncertainty: Covariance,
    survey: Survey,
    water: WaterProperties,
    interval: tuple[float, float] | None,
) -> NDArray[np.float64]:
    """Return the water in front of the target; NaN where it is not settled [m]."""
    surroundings = medium(survey, water)
    beam = rays.enter_water(
        survey.instrument.emitter.position,
        rays.direction(cube["azimuth"].values, cube["elevation"].values),
        medium=surroundings,
    )
    receiver = np.asarray(survey.instrument.receiver.position)
    frequency = cube["modulation_frequency"].values
    # One depth for all channels, from the sum of what they see of the target.
    summed = np.nansum(signal, axis=1)
    seen = (np.isfinite(signal).any(axis=1) & (summed != 0)).all(axis=0)
    sigma = detection.phase_uncertainty(
        np.where(seen, summed, 1.0),
        in_phase_variance=np.nansum(uncertainty.in_phase, axis=1),
        quadrature_variance=np.nansum(uncertainty.quadrature, axis=1),
        covariance=np.nansum(uncertainty.cross, axis=1),
    )
    shortest, longest = rays.path_limits(
        interval,
        beam,
        receiver,
        medium=surroundings,
        modulation_frequency=frequency,
    )
    path = ambiguity.optical_path(
        np.where(seen, np.angle(np.where(seen, summed, 1.0)), 0.0),
        sigma,
        modulation_frequency=frequency,
        shortest=shortest,
        longest=longest,
        # What is behind the target is still in the phases: they may disagree.
        doubt=np.inf,
    )
    slant_range = rays.slant_range_of_path(
        path.length, beam, receiver, medium=surroundings
    )
    depth = np.maximum(slant_range - beam.length_before, 0.0)
    return np.where(seen & path.settled, depth, np.nan)
