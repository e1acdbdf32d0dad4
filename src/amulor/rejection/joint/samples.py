"""Samples of a cube as the joint estimation takes them, and what it must refuse."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.optics import rays
from amulor.rejection.covariance import Covariance, covariance_of, times
from amulor.rejection.joint._kernels import bundles
from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.joint.overlap import Frame, frame_of
from amulor.rejection.joint.tables import Table, to_pairs

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
    return pixels_of(
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
    """Return the open water of a cube as samples of the likelihood."""
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
    return frame, pixels_of(
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


#: Paths at which the depth of each pixel is tabulated.
_DEPTH_NODES = 33
#: Points of the coarse likelihood within one period of the highest frequency.
_POINTS_PER_PERIOD = 12
_MOST_POINTS = 20_000


@dataclass(frozen=True, kw_only=True)
class Pixels:
    """Samples with their errors, and where each pixel may lie.

    Arrays run over (pixel, channel, frequency).
    """

    signal: Complex
    """Samples; 0 where none is usable [V]."""
    covariance: Covariance
    """Their stated errors [V^2]."""
    usable: NDArray[np.bool_]
    """Whether a sample counts."""
    interpolation: Floats
    """Place within the scan, from `Frame.interpolation`, (pixel, node) [1]."""
    offset: Floats
    """Optical path before the water, out and back [m]."""
    shortest: Floats
    """Shortest optical path [m]."""
    longest: Floats
    """Longest optical path [m]."""
    depths: Floats
    """Depth of water at a series of paths, finer in front [m]."""
    trends: Floats
    """Polynomials of the time of each pixel, (pixel, trend); zero where the water has
    a strength of its own [1]."""

    def __len__(self) -> int:
        """Return the number of pixels."""
        return len(self.signal)

    def part(self, which: NDArray[np.intp] | slice) -> Pixels:
        """Return some of the pixels."""
        return replace(
            self,
            covariance=Covariance(
                self.covariance.in_phase[which],
                self.covariance.quadrature[which],
                self.covariance.cross[which],
            ),
            **{
                name: getattr(self, name)[which]
                for name in (
                    "signal",
                    "usable",
                    "interpolation",
                    "offset",
                    "shortest",
                    "longest",
                    "depths",
                    "trends",
                )
            },
        )


def pixels_of(
    frame: Frame,
    signal: Complex,
    covariance: Covariance,
    usable: NDArray[np.bool_],
    azimuth: Floats,
    elevation: Floats,
    *,
    interval: tuple[float, float] | None,
    modulation_frequency: Floats,
    trends: Floats,
) -> Pixels:
    """Return samples with all that their likelihood needs."""
    geometry = frame.geometry(azimuth, elevation)
    beam = geometry.beam
    shortest, longest = geometry.path_limits(interval, modulation_frequency)
    place = np.linspace(0, 1, _DEPTH_NODES) ** 2
    path = shortest[:, None] + (longest - shortest)[:, None] * place
    wide = rays.Beam(
        entry=beam.entry[:, None],
        direction=beam.direction[:, None],
        length_before=beam.length_before[:, None],
        optical_length_before=beam.optical_length_before[:, None],
    )
    slant_range = rays.slant_range_of_path(
        path, wide, geometry.receiver, medium=geometry.medium
    )
    return Pixels(
        signal=np.where(usable, signal, 0.0),
        covariance=covariance,
        usable=usable,
        interpolation=frame.directions.interpolation(azimuth, elevation),
        offset=frame.optical_offset(azimuth, elevation).astype(float),
        shortest=shortest,
        longest=longest,
        depths=np.nan_to_num(np.maximum(slant_range - wide.length_before, 0.0)),
        trends=trends,
    )


def weight(
    pixels: Pixels, deviation: Complex | None = None, scale: float = 1.0
) -> Floats:
    """Return the inverse covariance of the samples."""
    errors = pixels.covariance
    xx, yy, xy = errors.in_phase, errors.quadrature, errors.cross
    if scale != 1:
        xx, yy, xy = scale**2 * xx, scale**2 * yy, scale**2 * xy
    if deviation is not None:
        xx = xx + deviation.real**2
        yy = yy + deviation.imag**2
        xy = xy + deviation.real * deviation.imag
    safe = np.where(pixels.usable, xx * yy - xy**2, 1.0)
    inverse = np.stack([yy, -xy, xx], axis=-2) / safe[..., None, :]
    return np.where(pixels.usable[..., None, :], inverse, 0.0)


def grid_of(pixels: Pixels, phase_per_path: Floats) -> Floats:
    """Return the paths at which the likelihood is looked at first."""
    step = 2 * np.pi / phase_per_path.max() / _POINTS_PER_PERIOD
    # Whole numbers of steps: the same paths whichever pixels come together.
    first = int(np.floor(pixels.shortest.min() / step)) - 1
    count = int(np.ceil(pixels.longest.max() / step)) + 2 - first
    if count > _MOST_POINTS:
        raise ValueError(
            f"the interval holds {count / _POINTS_PER_PERIOD:.3g} ambiguity intervals "
            "of the highest modulation frequency; narrow it"
        )
    return np.asarray(step * np.arange(first, first + count))


def coefficients(pixels: Pixels, table: Table) -> Floats:
    """Return the coefficients of the components of a table, (pixel, component) [1]."""
    return times(pixels.interpolation, table.basis)


def samples(pixels: Pixels, weights: Floats) -> bundles.Samples:
    """Return samples and their inverse covariance as compiled loops take them."""
    return bundles.Samples(to_pairs(pixels.signal), np.ascontiguousarray(weights))


def places(pixels: Pixels, table: Table) -> bundles.Places:
    """Return where pixels look, as compiled loops take it."""
    return bundles.Places(
        coefficients(pixels, table),
        pixels.offset,
        pixels.shortest,
        pixels.longest,
        pixels.depths,
    )


def echo_of(transfer: Complex, phase_per_path: Floats) -> bundles.Echo:
    """Return what turns a path into an echo, as compiled loops take it."""
    return bundles.Echo(phase_per_path, to_pairs(transfer))


def phasors(path: Floats, echo: bundles.Echo) -> bundles.Grid:
    """Return paths with the echoes of unit amplitude from there."""
    phasor = np.empty((path.size, 2, echo.phase_per_path.size))
    kernels.fill_phasors(path, echo, phasor)
    return bundles.Grid(path, phasor)
