"""Optical properties of the water from an open-water sweep, with uncertainties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.optics import low_pass
from amulor.rejection.joint import shared as joint_shared
from amulor.rejection.joint.overlap import COEFFICIENTS, Frame, Shape
from amulor.rejection.joint.priors import Shared
from amulor.rejection.joint.samples import open_water_samples
from amulor.rejection.observation import Observation

Floats = NDArray[np.float64]

#: Error of the logarithm of a coefficient below which the data determine it [1].
_KNOWN = 0.5
#: Share of unscattered light from z_max below which b_f has no upper limit [1].
_UNSCATTERED = 0.01
#: Step of a parameter for derivatives of derived quantities [1].
_STEP = 1e-3
_DEPTHS = 2000
_HIGHEST_FREQUENCY = 2e9
_FEWEST_FREQUENCIES = 3


@dataclass(frozen=True, kw_only=True)
class WaterFit:
    """Estimates of water properties from an open-water sweep, with uncertainties."""

    reduced_attenuation: float
    """Reduced attenuation coefficient k' = a + b_d [1/m]."""
    reduced_attenuation_uncertainty: float
    """Standard uncertainty of the reduced attenuation [1/m]."""
    spread: float
    """Growth b_f <theta^2> of the mean square angle of the light [rad^2/m]."""
    spread_uncertainty: float
    """Standard uncertainty of the spread [rad^2/m]."""
    forward_scattering: float
    """Forward scattering coefficient b_f, from the unscattered light [1/m]."""
    forward_scattering_uncertainty: float
    """Standard uncertainty of the forward scattering coefficient [1/m]."""
    strength: tuple[float, ...]
    """Open-water signal at frequency 0 in the middle of the scan, by channel [V]."""
    strength_uncertainty: tuple[float, ...]
    """Standard uncertainty of the strength [V]."""
    depth_of_maximum: float
    """Depth z_max with the largest overlap [m]."""
    depth_of_maximum_uncertainty: float
    """Standard uncertainty of z_max [m]."""
    cut_off: float
    """Half-power frequency of the water signal [Hz]."""
    cut_off_uncertainty: float
    """Standard uncertainty of the half-power frequency [Hz]."""
    fluctuation: float
    """Relative random change of the water signal from sample to sample [1]."""
    misfit: float
    """Chi-square per degree of freedom, fluctuation included [1]."""
    departure_evidence: float
    """Twice the log odds of a water departure from the model [1]."""
    names: tuple[str, ...]
    """Names of the parameters of `covariance` and `direction`."""
    covariance: Floats
    """Covariance of the relative errors of the parameters in `names` [1]."""
    identified: tuple[bool, ...]
    """Whether the data determine each parameter to better than a factor of 1.6."""
    direction: Floats
    """Eigenvectors of the log parameters' Fisher information, as columns, the best
    determined first [1]."""
    direction_uncertainty: Floats
    """Standard uncertainty along each eigenvector, without priors [1]."""


@dataclass(frozen=True, kw_only=True)
class ScatteringSplit:
    """Absorption and scattering of the water, for a known phase function.

    Examples
    --------
    >>> from amulor.rejection import ScatteringSplit
    >>> split = ScatteringSplit(
    ...     absorption=0.25, absorption_uncertainty=0.02,
    ...     scattering=0.60, scattering_uncertainty=0.05,
    ... )
    >>> print(f"c = {split.absorption + split.scattering:.2f} 1/m")
    c = 0.85 1/m
    """

    absorption: float
    """Absorption coefficient a; negative for an unsuitable phase function [1/m]."""
    absorption_uncertainty: float
    """Standard uncertainty of the absorption coefficient [1/m]."""
    scattering: float
    """Scattering coefficient b [1/m]."""
    scattering_uncertainty: float
    """Standard uncertainty of the scattering coefficient [1/m]."""


def water_fit(cube: xr.Dataset, *, no_target: bool = False) -> WaterFit:
    r"""Fit the shape of the open-water signal against frequency and direction.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots at three modulation frequencies or more
        and the attribute `survey`, of which the instrument is used.
    no_target : bool, optional
        Whether the scan itself shows open water, without a target. Shots are then not
        needed.

    Returns
    -------
    WaterFit
        Coefficients, derived quantities, and which of them the data determine.

    Raises
    ------
    CubeError
        If there is no open water, no survey, or fewer than three frequencies.

    Notes
    -----
    Maximum likelihood with the model and the weak priors of `joint`. The signal depends
    on scattering only through :math:`k' = a + b_d`, :math:`b_f \langle\theta^2\rangle`
    and, as long as some light is unscattered, :math:`b_f`. `split_scattering` separates
    absorption and scattering if the phase function is known. The strength contains the
    calibration of the instrument, and cannot be separated from the backscatter without
    it.

    Examples
    --------
    The water was made with a = 0.255 / m and all of its scattering forward of the split
    angle, so that k' = a:

    >>> from amulor import rejection, samples
    >>> four = samples.cube("sweep").isel(modulation_frequency=[0, 4, 6, 8])
    >>> fit = rejection.water_fit(four.isel(polarization=[0], shot=slice(0, None, 8)))
    >>> print(f"{fit.reduced_attenuation:.2f} 1/m")
    0.26 1/m

    Its phase function is known; scattering is the spread over the second moment:

    >>> split = split_scattering(fit, second_moment=0.06, forward_fraction=1.0)
    >>> print(f"{split.scattering:.2f} 1/m")
    0.68 1/m
    """
    cube = cubes.checked(cube, "samples")
    scan = Observation(cube=cube)
    count = len(scan.frequency)
    if count < _FEWEST_FREQUENCIES:
        raise CubeError(
            f"the cube has {count} modulation frequencies; the shape of the water "
            f"signal takes {_FEWEST_FREQUENCIES} or more: record a sweep"
        )
    if scan.shots is None and not no_target:
        raise CubeError(
            "the cube has no open-water shots (group open_water); record them with the "
            "target out of the beam, or say that there was no target (no_target)"
        )
    frame, pixels = open_water_samples(scan, no_target=no_target)
    shared = joint_shared.fit(
        frame,
        pixels.part(slice(0, 0)),
        pixels,
        transfer=np.ones(count, dtype=complex),
        deepest=_SHORT,
    )
    return _result(frame, shared, scan.polarizations)


#: The table of depths is unused: all samples contain the full water column [m].
_SHORT = 1.0


def split_scattering(
    fit: WaterFit, *, second_moment: float, forward_fraction: float
) -> ScatteringSplit:
    r"""Return absorption and scattering for a known phase function.

    Parameters
    ----------
    fit : WaterFit
        From `water_fit`.
    second_moment : float
        Mean square angle of the forward part, above zero [rad^2].
    forward_fraction : float
        Fraction of the scattering in the forward part, above 0 to 1 [1].

    Returns
    -------
    ScatteringSplit
        :math:`b = b_f \langle\theta^2\rangle / \eta \langle\theta^2\rangle` and
        :math:`a = k' - (1 - \eta) b`.

    Raises
    ------
    ValueError
        If the moment or the fraction is out of range.
    """
    if not second_moment > 0:
        raise ValueError(f"second_moment must be above 0 rad^2, got {second_moment:g}")
    if not 0 < forward_fraction <= 1:
        raise ValueError(
            f"forward_fraction must be above 0 and at most 1, got {forward_fraction:g}"
        )
    scattering = fit.spread / (second_moment * forward_fraction)
    diffuse = (1 - forward_fraction) * scattering
    which = [fit.names.index(name) for name in ("reduced_attenuation", "spread")]
    slope = np.array([fit.reduced_attenuation, -diffuse])
    block = fit.covariance[np.ix_(which, which)]
    return ScatteringSplit(
        absorption=fit.reduced_attenuation - diffuse,
        absorption_uncertainty=float(np.sqrt(slope @ block @ slope)),
        scattering=scattering,
        scattering_uncertainty=scattering * float(np.sqrt(block[1, 1])),
    )


def _result(frame: Frame, shared: Shared, channels: list[str]) -> WaterFit:
    """Return the fitted water properties, with derived quantities."""
    count = len(channels)
    size = count + COEFFICIENTS
    relative = np.ones(len(shared.covariance))
    relative[:count] = np.where(shared.strength > 0, shared.strength, 1.0)
    scaled = shared.covariance / np.outer(relative, relative)
    errors = np.sqrt(np.diag(scaled))
    names = (
        *(f"strength {name}" for name in channels),
        "reduced_attenuation",
        "spread",
        "forward_scattering",
    )
    shape = shared.shape
    maximum, maximum_error = _propagated(shared, lambda s: _depth_of_maximum(frame, s))
    corner = _cut_off(frame, shape)
    # The level at a fixed frequency moves, and along the response so does the corner.
    _, level_error = _propagated(shared, lambda s: _level(frame, s, corner))
    further = corner * (1 + _STEP)
    fall = (_level(frame, shape, further) - _level(frame, shape, corner)) / (
        further - corner
    )
    corner_error = level_error / abs(fall)
    straight = np.exp(-2 * shape.forward_scattering * maximum)
    unscattered_known = bool(errors[size - 1] < _KNOWN and straight > _UNSCATTERED)
    data = shared.parametric / np.outer(relative[:size], relative[:size])
    values, vectors = np.linalg.eigh(data)
    strength_error = shared.strength * errors[:count]
    return WaterFit(
        reduced_attenuation=shape.reduced_attenuation,
        reduced_attenuation_uncertainty=float(
            shape.reduced_attenuation * errors[count]
        ),
        spread=shape.spread,
        spread_uncertainty=float(shape.spread * errors[count + 1]),
        forward_scattering=shape.forward_scattering,
        forward_scattering_uncertainty=float(
            shape.forward_scattering * errors[count + 2]
        ),
        strength=tuple(float(value) for value in shared.strength),
        strength_uncertainty=tuple(float(value) for value in strength_error),
        depth_of_maximum=maximum,
        depth_of_maximum_uncertainty=maximum_error,
        cut_off=corner,
        cut_off_uncertainty=corner_error,
        fluctuation=shared.fluctuation,
        misfit=shared.misfit,
        departure_evidence=shared.evidence,
        names=names,
        covariance=scaled[:size, :size],
        identified=(
            *(bool(error < _KNOWN) for error in errors[: size - 1]),
            unscattered_known,
        ),
        direction=vectors,
        direction_uncertainty=np.sqrt(np.maximum(values, 0.0)),
    )


def _propagated(
    shared: Shared, function: Callable[[Shape], float]
) -> tuple[float, float]:
    """Evaluate a function of the shape; return value and first-order uncertainty."""
    begin = len(shared.strength)
    count = COEFFICIENTS + len(shared.shape.knots)
    slope = np.empty(count)
    for k in range(count):
        step = np.zeros(count)
        step[k] = _STEP
        rise = function(shared.shape.moved(step)) - function(shared.shape.moved(-step))
        slope[k] = rise / (2 * _STEP)
    block = shared.covariance[begin : begin + count, begin : begin + count]
    return function(shared.shape), float(np.sqrt(slope @ block @ slope))


def _depth_of_maximum(frame: Frame, shape: Shape) -> float:
    """Return the depth of the maximum overlap, by parabolic interpolation [m]."""
    depth = np.linspace(0, min(frame.nothing_left(shape), frame.end), _DEPTHS)
    light = frame.middle(depth, shape)
    k = int(np.clip(np.argmax(light), 1, _DEPTHS - 2))
    before, level, after = light[k - 1 : k + 2]
    bend = before - 2 * level + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(depth[k] + shift * (depth[1] - depth[0]))


def _responses(frame: Frame, shape: Shape, frequency: Floats) -> Floats:
    """Return the water-signal amplitude in the middle of the scan."""
    depth = np.linspace(0, min(frame.nothing_left(shape), frame.end), _DEPTHS)
    light = frame.middle(depth, shape)
    light[[0, -1]] /= 2
    delay = 4 * np.pi * frame.medium.group_index / speed_of_light * depth
    moduli = [abs(np.sum(light * np.exp(1j * f * delay))) for f in frequency]
    return np.array(moduli)


def _level(frame: Frame, shape: Shape, frequency: float) -> float:
    """Return the water-signal amplitude relative to zero frequency [1]."""
    at_zero, response = _responses(frame, shape, np.array([0.0, frequency]))
    return float(response / at_zero)


def _cut_off(frame: Frame, shape: Shape) -> float:
    """Return the frequency at which the response falls to half its power [Hz]."""
    far = min(frame.nothing_left(shape), frame.end)
    # At most the frequency that the depth steps resolve.
    highest = speed_of_light / frame.medium.group_index / (16 * far / _DEPTHS)
    return low_pass.cut_off(
        lambda frequency: _responses(frame, shape, np.atleast_1d(frequency)),
        maximum_frequency=float(min(_HIGHEST_FREQUENCY, highest)),
    )
