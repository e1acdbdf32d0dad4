"""Samples of a cube as the joint estimation takes them, and what it must refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance, covariance_of
from amulor.rejection.joint import pixels as joint_pixels
from amulor.rejection.joint.overlap.frame import Frame, frame_of
from amulor.rejection.joint.pixels import Pixels

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels that settle what all share, evenly spread over the scan, and shots likewise.
SHARING = 1024
FEWEST_FREQUENCIES = 2
#: Emitters that are this close to each other are in one place [m].
_SAME_PLACE = 1e-4


def flat(cube: xr.Dataset) -> tuple[Complex, Covariance, NDArray[np.bool_]]:
    """Return samples over (pixel, channel, frequency), their errors, which count."""

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        wide = values.reshape(*values.shape[:2], -1)
        return np.ascontiguousarray(wide.transpose(2, 1, 0))

    signal = flat(cube.amulor.signal.values)
    stated = covariance_of(cube)
    errors = Covariance(
        flat(stated.in_phase), flat(stated.quadrature), flat(stated.cross)
    )
    usable = np.isfinite(signal) & np.isfinite(
        errors.in_phase + errors.quadrature + errors.cross
    )
    if "saturated" in cube:
        usable &= flat(cube["saturated"].values) == 0
    return signal, errors, usable


def count(cube: xr.Dataset) -> tuple[NDArray[np.bool_], Covariance]:
    """Return which samples count, and their errors, all of the shape of the samples."""
    errors = covariance_of(cube)
    total = cube["in_phase"].values + cube["quadrature"].values
    for each in (errors.in_phase, errors.quadrature, errors.cross):
        total += each
    usable: NDArray[np.bool_] = np.isfinite(total)
    if "saturated" in cube:
        usable &= cube["saturated"].values == 0
    return usable, errors


def shot_directions(
    middle: tuple[float, float], shots: xr.Dataset | None
) -> tuple[Floats, Floats]:
    """Return where the open-water shots point; to the middle if that is not known."""
    if shots is None:
        return np.zeros(0), np.zeros(0)
    places = []
    for name, mean in zip(("azimuth", "elevation"), middle, strict=True):
        if name in shots:
            places.append(shots[name].values.astype(float))
        else:
            places.append(np.full(shots.sizes["shot"], mean))
    return places[0], places[1]


def shot_pixels(
    frame: Frame,
    shots: xr.Dataset | None,
    places: tuple[Floats, Floats],
    frequency: Floats,
) -> Pixels | None:
    """Return open-water shots as samples of the likelihood."""
    if shots is None:
        return None
    count = shots.sizes["shot"]
    which = np.linspace(0, count - 1, min(SHARING, count)).astype(int)

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values.transpose(2, 1, 0)[which])

    signal = flat(shots["in_phase"].values + 1j * shots["quadrature"].values)
    stated = covariance_of(shots)
    errors = Covariance(
        flat(stated.in_phase), flat(stated.quadrature), flat(stated.cross)
    )
    usable = np.isfinite(signal) & np.isfinite(
        errors.in_phase + errors.quadrature + errors.cross
    )
    refuse_errors_of_zero(errors, usable)
    return joint_pixels.pixels_of(
        frame,
        signal,
        errors,
        usable,
        places[0][which],
        places[1][which],
        interval=None,
        modulation_frequency=frequency,
        trends=np.zeros((len(which), 0)),
    )


def open_water_samples(cube: xr.Dataset, *, no_target: bool) -> tuple[Frame, Pixels]:
    """Return the open water of a cube as samples of the likelihood.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.
    no_target : bool
        True to take the samples themselves, false to take the open-water shots.

    Returns
    -------
    tuple of Frame and Pixels
        How the receiver looks at them, and the samples.

    Raises
    ------
    CubeError
        If the cube has no survey, or states errors of zero.
    """
    frequency = cube["modulation_frequency"].values
    if not no_target:
        shots = cube.amulor.open_water
        middle = (
            float(cube["azimuth"].values.mean()),
            float(cube["elevation"].values.mean()),
        )
        places = shot_directions(middle, shots)
        frame = frame_of(cube, *places)
        pixels = shot_pixels(frame, shots, places, frequency)
        assert pixels is not None
        return frame, pixels
    signal, errors, usable = flat(cube)
    refuse_errors_of_zero(errors, usable)
    azimuth = cube["azimuth"].values.ravel().astype(float)
    elevation = cube["elevation"].values.ravel().astype(float)
    frame = frame_of(cube, azimuth, elevation)
    some = np.linspace(0, len(signal) - 1, min(SHARING, len(signal))).astype(int)
    return frame, joint_pixels.pixels_of(
        frame,
        signal[some],
        Covariance(errors.in_phase[some], errors.quadrature[some], errors.cross[some]),
        usable[some],
        azimuth[some],
        elevation[some],
        interval=None,
        modulation_frequency=frequency,
        trends=np.zeros((len(some), 0)),
    )


def refuse_what_cannot_be_told_apart(cube: xr.Dataset) -> None:
    """Refuse a cube of one frequency."""
    count = cube.sizes["modulation_frequency"]
    if count < FEWEST_FREQUENCIES:
        frequency = float(cube["modulation_frequency"][0]) / 1e6
        raise CubeError(
            f"the cube has one modulation frequency, {frequency:g} MHz; joint "
            "estimation needs two or more to tell target from water: record a sweep, "
            "or use open-water, polarization or cross-polarized"
        )


def refuse_other_windows(cube: xr.Dataset, frame: Frame) -> None:
    """Refuse a scan that moves towards its window or away from it.

    Sideways, emitter and receiver move together and see the same water everywhere.
    """
    if "origin_z" not in cube.coords or frame.medium.window_distance is None:
        return
    off = cube["origin_z"].values - frame.survey.instrument.emitter.position[2]
    furthest = float(off.flat[np.argmax(np.abs(off))])
    if abs(furthest) > _SAME_PLACE:
        raise CubeError(
            f"origin_z is up to {furthest:g} m off the emitter of the survey, behind a "
            "window: joint estimation needs the same way to the window in all pixels; "
            "split the scan, with a survey for each part, or use the open-water method"
        )


def refuse_errors_of_zero(errors: Covariance, usable: NDArray[np.bool_]) -> None:
    """Refuse samples that have no weight."""
    determinant = errors.in_phase * errors.quadrature - errors.cross**2
    if np.any(usable & ~(determinant > 0)):
        raise CubeError(
            "in_phase_uncertainty and quadrature_uncertainty must be above 0 V in "
            "every sample: joint estimation weighs the samples by them; state the "
            "noise of the instrument"
        )
