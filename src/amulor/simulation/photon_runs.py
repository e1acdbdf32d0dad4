"""Photon transport at single places of a scan: what the grid of photons is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.transport import (
    GaussianReceiver,
    Layer,
    Medium,
    PlaneTarget,
    Progress,
    Source,
    Tally,
    simulate,
)

__all__ = ["Light", "Place", "Setting", "follow", "run", "way"]

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Place:
    """How the receiver looks at a beam, and where that beam ends."""

    baseline: float
    """Distance of receiver and beam where the depth is zero [m]."""
    tilt: float
    """Inclination of the beam against the receiver's axis, along the baseline [rad]."""
    cross_tilt: float
    """The inclination across the baseline [rad]."""
    standoff: float
    """Air and glass before the water, as a depth of water [m]."""
    depth: float
    """Where the surface stands, along the beam; infinite in open water [m]."""
    reflectance: float
    """Of the surface [1]."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What all places of a survey share."""

    absorption: float
    """Absorption coefficient [1/m]."""
    scattering: float
    """Scattering coefficient [1/m]."""
    phase_function: PhaseFunction
    """Phase function of the water."""
    group_index: float
    """Group index of the water [1]."""
    receiver_radius: float
    """1/e radius of the aperture [m]."""
    acceptance_angle: float
    """1/e semi-angle of the receiver in the water [rad]."""
    beam_radius: float = 0.0
    """1/e half-width of the beam at its start [m]."""
    beam_divergence: float = 0.0
    """1/e semi-angle of the beam in the water [rad]."""


@dataclass(frozen=True, kw_only=True)
class Light:
    """Received per launched light at each frequency, with standard errors."""

    water: Complex
    """Light that met water only, shape (n,) [1]."""
    water_error: Floats
    """Its standard error, real and imaginary part together [1]."""
    target: Complex
    """Light that met the surface, scattered on its way or not [1]."""
    target_error: Floats
    """Its standard error [1]."""


def follow(
    setting: Setting,
    place: Place,
    frequency: Floats,
    *,
    relative_error: float,
    histories: int,
    seed: int,
    progress: Callable[[Progress], None] | None = None,
) -> Light:
    """Follow photons at one place.

    Parameters
    ----------
    setting, place, frequency, relative_error, histories, seed, progress
        As in `run`.

    Returns
    -------
    Light
        With the phase counted from where the water begins.

    Raises
    ------
    KeyboardInterrupt
        If the run was stopped from the keyboard.
    """
    tally = run(
        setting,
        place,
        frequency,
        relative_error=relative_error,
        histories=histories,
        seed=seed,
        progress=progress,
    )
    return Light(
        water=tally.water_signal,
        water_error=_error(tally.water_covariance),
        target=tally.target_signal,
        target_error=_error(tally.target_covariance),
    )


def run(
    setting: Setting,
    place: Place,
    frequency: Floats,
    *,
    relative_error: float,
    histories: int,
    seed: int,
    progress: Callable[[Progress], None] | None = None,
) -> Tally:
    """Follow photons at one place, and keep all that is known of their light.

    Parameters
    ----------
    setting : Setting
        Water and receiver.
    place : Place
        Beam and surface; the surface faces the beam.
    frequency : ndarray
        Modulation frequencies, the first one 0 [Hz].
    relative_error : float
        Of all light at the first frequency, where the photons stop [1].
    histories : int
        Where they stop in any case.
    seed : int
        Seed of the random numbers.
    progress : callable, optional
        Called after each batch.

    Returns
    -------
    Tally
        With the phase counted from where the water begins.

    Raises
    ------
    KeyboardInterrupt
        If the run was stopped from the keyboard.
    """
    layer = Layer(
        absorption=setting.absorption,
        scattering=setting.scattering,
        phase_function=setting.phase_function,
    )
    gap = place.standoff
    if gap > 0:
        clear = Layer(
            absorption=0.0,
            scattering=0.0,
            phase_function=setting.phase_function,
            thickness=gap,
        )
        medium = Medium.layered([clear, layer], group_index=setting.group_index)
    else:
        medium = Medium(layers=(layer,), group_index=setting.group_index)
    start, direction, point = ends(place)
    target = None
    if np.isfinite(place.depth):
        target = PlaneTarget(
            position=point,
            normal=-direction,
            reflectance=place.reflectance,
        )
    tally = simulate(
        medium,
        Source(
            position=start,
            direction=direction,
            radius=setting.beam_radius,
            divergence=setting.beam_divergence,
        ),
        GaussianReceiver(
            position=(place.baseline, 0.0, 0.0),
            radius=setting.receiver_radius,
            acceptance_angle=setting.acceptance_angle,
        ),
        frequency,
        histories=histories,
        seed=seed,
        target=target,
        relative_error=relative_error,
        progress=progress,
    )
    if tally.interrupted:
        raise KeyboardInterrupt
    return tally.delayed(-gap, group_index=setting.group_index) if gap else tally


def ends(place: Place) -> tuple[Floats, Floats, Floats]:
    """Return where a beam enters the water, its direction, and where it ends.

    Parameters
    ----------
    place : Place
        In front of a receiver that looks forwards.

    Returns
    -------
    tuple of three ndarrays, shape (3,)
        Start [m], unit vector, end [m]; without a surface the end is the start.
    """
    across = np.array([place.tilt, place.cross_tilt])
    direction = np.append(across, np.sqrt(1.0 - across @ across))
    start = place.standoff * np.append(across, 1.0)
    depth = place.depth if np.isfinite(place.depth) else 0.0
    return start, direction, start + depth * direction


def way(place: Place) -> float:
    """Return the way to the surface and back to the middle of the aperture [m].

    Parameters
    ----------
    place : Place
        With a surface.

    Returns
    -------
    float
        Less the gap between receiver and water.
    """
    _, _, point = ends(place)
    back = np.linalg.norm(point - np.array([place.baseline, 0.0, 0.0]))
    return place.depth + float(back) - place.standoff


def _error(covariance: Floats) -> Floats:
    """Return the root of the summed variances of real and imaginary part."""
    return np.asarray(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1)))
