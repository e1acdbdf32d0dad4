"""The part of the open water that lies behind the target, and so is not there."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.optics import ambiguity, detection, rays
from amulor.rejection.covariance import Covariance, along, isotropic
from amulor.rejection.reference import column_fraction
from amulor.survey import Survey, water_properties
from amulor.survey.reach import unsettled_interval
from amulor.survey.view import medium


def hidden_fraction(
    cube: xr.Dataset,
    survey: Survey,
    depth: NDArray[np.float64],
    *,
    paper: bool = False,
    fit: column_fraction.Column | None = None,
) -> tuple[NDArray[np.complex128], column_fraction.Column]:
    """Return which part of the open-water signal comes from behind the target.

    Fraction of the open-water signal over (modulation_frequency, polarization, row,
    column), complex since it comes later [1], NaN where the depth [m] is not settled;
    and the fractions over the scan that it was taken from, `fit` if it is stated. The
    survey describes the water: what the user knew beforehand, perhaps corrected by the
    shots.

    Decision on (46) of Ricci et al. 2010, as rebuilt: open water is integrated to its
    end, water with a target to the target; the difference stays when open water is
    subtracted. That difference itself moves the distance by millimetres, and the
    fraction by a few tenths of a per cent of its value, which a second pass would not
    be worth. Large scans take the fraction from a table over directions and depths, see
    `column_fraction.column_of`.
    """
    settled = np.isfinite(depth)
    frequency = cube["modulation_frequency"].values
    fraction = np.full((frequency.size, *depth.shape), np.nan, dtype=complex)
    places = np.stack(
        [
            cube["azimuth"].values[settled],
            cube["elevation"].values[settled],
            depth[settled],
        ]
    )
    if fit is None:
        fit = column_fraction.column_of(survey, places, frequency, paper=paper)
    fraction[:, settled] = fit.fractions(places)
    shape = (frequency.size, cube.sizes["polarization"], *depth.shape)
    return np.broadcast_to(fraction[:, None], shape), fit


def hidden_error(
    water_signal: NDArray[np.complex128],
    fraction: NDArray[np.complex128],
    steeper: NDArray[np.complex128],
    *,
    misfit: float,
) -> Covariance:
    """Return the error of the water that is put back behind targets.

    Parameters
    ----------
    water_signal : ndarray of complex
        The whole column [V].
    fraction, steeper : ndarray of complex
        Which part of it is behind the target, and the same in water that is more
        turbid by one standard uncertainty [1].
    misfit : float
        Departure of the model from the open water, in parts of it [1].

    Returns
    -------
    Covariance
        Of the shape of the signal; zero where the fraction is not known [V^2].

    Notes
    -----
    The turbidity moves the column along a known direction. A model that is off by so
    much of the whole column is off by as much of a part of it, at most by all of that
    part; compared at the lowest frequency. With several frequencies all of it may
    turn the phase; with one, whose misfit is a bound by itself, it has any direction.
    """
    known = np.nan_to_num(fraction)
    # Both errors belong to the model, so that frequencies share them: stated for each
    # sample as if they did not, they must be larger by what a mean would take off.
    frequencies = len(water_signal)
    by_turbidity = (np.nan_to_num(steeper) - known) * water_signal * frequencies**0.5
    size = np.abs(known * water_signal)
    # At high frequencies the whole column cancels itself and the part behind an edge
    # does not, so the lowest frequency tells how wrong the model is of that part.
    allowed = misfit * np.abs(water_signal[:1])
    relative = np.divide(
        allowed, size[:1], out=np.ones(size[:1].shape), where=size[:1] > allowed
    )
    own = isotropic(relative * size).scaled(2 * frequencies if frequencies > 1 else 1)
    return along(by_turbidity, 1.0) + own


def depth(
    cube: xr.Dataset,
    signal: NDArray[np.complex128],
    uncertainty: Covariance,
    survey: Survey,
    *,
    interval: tuple[float, float] | None,
    fit: ambiguity.Choices | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], ambiguity.Choices | None]:
    """Return the depth of water in front of the target, the optical path and choices.

    Both lengths over (row, column), NaN where the distance is not settled [m]; and the
    choices between frequencies that all pixels share, `fit` if it is given. The signal
    is that of the target so far, from whose phase the distance is taken [V].
    """
    shape = signal.shape[2:]
    if interval is None and unsettled_interval(
        survey, modulation_frequency=cube["modulation_frequency"].values
    ):
        return np.full(shape, np.nan), np.full(shape, np.nan), fit
    water = water_properties(survey)
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
    arguments: dict[str, Any] = {
        "phase": np.where(seen, np.angle(np.where(seen, summed, 1.0)), 0.0),
        "uncertainty": sigma,
        "modulation_frequency": frequency,
        "shortest": shortest,
        "longest": longest,
        # What is behind the target is still in the phases: they may disagree.
        "doubt": np.inf,
    }
    if fit is None:
        path, fit = ambiguity.fit(**arguments)
    else:
        path = ambiguity.optical_path(**arguments, choices=fit)
    slant_range = rays.slant_range_of_path(
        path.length, beam, receiver, medium=surroundings
    )
    found = np.maximum(slant_range - beam.length_before, 0.0)
    settled = seen & path.settled
    return (
        np.where(settled, found, np.nan),
        np.where(settled, path.length, np.nan),
        fit,
    )
