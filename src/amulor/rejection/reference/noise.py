"""Whether the stated noise of samples is as large as their open-water shots scatter."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance, covariance_of
from amulor.rejection.reference.places import FEWEST_SHOTS, Places, places_of
from amulor.rejection.reference.shots import directions_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Attribute that says the factor.
NOISE_SCALE = "open_water_noise_scale"
#: The excess must stand out of chance by this many standard errors [1].
_SURE = 4.0
#: A direction whose scatter is this many standard errors off holds a spike [1].
_SPIKE = 6.0
#: Noise of directions that are alike to this cannot be told from a fluctuation [1].
_ALIKE = 1e-6
#: Steps of the fit, each with the weights of the one before.
_STEPS = 12


def with_noise_of_shots(
    cube: xr.Dataset, scale: float | None = None
) -> tuple[xr.Dataset, float]:
    """Return samples whose stated errors are as large as those of their shots.

    The stated errors of samples and shots times `scale`, by default that of
    `noise_scale`, which the attribute `open_water_noise_scale` says; the cube as it is,
    if that is 1 or was done. Also return the scale.
    """
    if scale is None:
        scale = _scale_of(cube)
    if scale == 1:
        return cube, scale
    larger = {}
    for name, values in cube.data_vars.items():
        if not str(name).startswith(("truth_", "user_")):
            if str(name).endswith(("in_phase_uncertainty", "quadrature_uncertainty")):
                larger[name] = values.copy(data=scale * values.values)
            elif str(name).endswith("in_phase_quadrature_covariance"):
                larger[name] = values.copy(data=scale**2 * values.values)
    return cube.assign(larger).assign_attrs({NOISE_SCALE: scale}), scale


def _scale_of(cube: xr.Dataset) -> float:
    """Return the factor of the stated errors of a cube, 1 if they have been scaled."""
    shots: xr.Dataset | None = cube.amulor.open_water
    if shots is None or shots.sizes["shot"] < FEWEST_SHOTS or NOISE_SCALE in cube.attrs:
        return 1.0
    signal, errors = shots.amulor.signal.values, covariance_of(shots)
    usable = np.isfinite(signal + errors.in_phase + errors.quadrature + errors.cross)
    directions = directions_of(cube, shots)
    parts = [
        scatter_of(signal[index][use], errors.part(index).part(use), places)
        for index in np.ndindex(signal.shape[:2])
        if (use := usable[index]).any() and (places := places_of(directions[use]))
    ]
    return noise_scale([each for part in parts for each in part])


#: Of the directions of one channel: scatter and what is stated [V^2], squared signal
#: [V^2], degrees of freedom.
Scatter = tuple[Floats, Floats, Floats, Floats]


def scatter_of(
    shots: Complex, instrument: Covariance, places: Places
) -> tuple[Scatter, Scatter]:
    """Return how the shots of each direction scatter along their mean and across it.

    Parameters
    ----------
    shots : ndarray of complex, shape (n,)
        Samples without a target, of one channel [V].
    instrument : Covariance
        Their stated errors.
    places : Places
        Their directions.

    Returns
    -------
    tuple of two tuples
        Variance about the mean, stated variance, squared mean and degrees of freedom of
        the directions that were repeated, radial and tangential.
    """
    mean = places.mean_of(shots)
    size = np.abs(mean)
    turn = np.exp(1j * np.angle(mean))
    turned = instrument.turned(np.conj(turn)[places.group])
    rest = (shots - mean[places.group]) / turn[places.group]
    often = places.size > 1
    freedom = np.asarray(places.size[often] - 1, dtype=float)
    parts = []
    for values, stated in (
        (rest.real, turned.in_phase),
        (rest.imag, turned.quadrature),
    ):
        variance = places.sum_of(values**2)[often] / freedom
        own = places.sum_of(stated)[often] / places.size[often]
        parts.append((variance, own, size[often] ** 2, freedom))
    return parts[0], parts[1]


def noise_scale(scatters: list[Scatter]) -> float:
    r"""Return by which factor the noise of shots exceeds what is stated.

    Parameters
    ----------
    scatters : list of Scatter
        From `scatter_of`, of all channels and frequencies.

    Returns
    -------
    float
        At least 1; 1 where chance or a fluctuation of the water explains the excess.

    Notes
    -----
    Shots of a direction scatter by :math:`s^2 u^2 + r\,|W|^2`: noise, which is stated
    as u, and a fluctuation of the water in proportion to its signal W, one r for each
    channel along W and across it. Where directions or channels differ in |W|, the two
    can be told apart; s is one number for the cube. Maximum likelihood of the sample
    variances by weighted least squares with weights of the step before; directions
    that scatter far more than the rest are left out.
    """
    known = [each for each in scatters if each[0].size and each[1].min() > 0]
    if not known:
        return 1.0
    # From above, so that no direction is taken for a spike that only noise spreads.
    square = float(np.median(np.concatenate([each[0] / each[1] for each in known])))
    found, information = 0.0, 0.0
    ratio = [0.0] * len(known)
    for _ in range(_STEPS):
        score = information = 0.0
        for k, (variance, stated, power, freedom) in enumerate(known):
            expected = square * stated + ratio[k] * power
            unsure = expected * np.sqrt(2 / freedom)
            weight = np.where(variance - expected < _SPIKE * unsure, unsure**-2, 0.0)
            own = float(np.sum(weight * power**2))
            # At a fixed s the fluctuation follows; it is not below zero.
            left = float(np.sum(weight * power * (variance - square * stated)))
            ratio[k] = max(left / own, 0.0) if own > 0 else 0.0
            # What of the noise no fluctuation could be, of either sign.
            shared = float(np.sum(weight * stated * power)) / own if own > 0 else 0.0
            across = stated - shared * power
            if np.abs(across).max() < _ALIKE * stated.max():
                continue
            information += float(np.sum(weight * across * stated))
            score += float(np.sum(weight * across * variance))
        if not information > 0:
            return 1.0
        found = score / information
        square = max(found, 0.1)
    error = information**-0.5
    return float(np.sqrt(found)) if found > 1 + _SURE * error else 1.0
