"""Input of the likelihood: samples, possible optical paths and depths by pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.optics import rays
from amulor.rejection.covariance import Covariance, times
from amulor.rejection.joint._kernels import bundles
from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.joint.overlap import Frame, frame_of
from amulor.rejection.joint.tables import Changes, Table, to_pairs
from amulor.rejection.observation import FlatSamples, Observation

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels of the fit of shared parameters, evenly spread over the scan; likewise shots.
SHARING = 1024
FEWEST_FREQUENCIES = 2
#: Distance below which two emitters coincide [m].
_SAME_PLACE = 1e-4


def shot_directions(
    middle: tuple[float, float], shots: Observation | None
) -> tuple[Floats, Floats]:
    """Return directions of references; the scan's middle if not recorded [rad]."""
    if shots is None:
        return np.zeros(0), np.zeros(0)
    azimuth, elevation = (
        np.full(shots.signal.shape[-1], mean) if angle is None else angle
        for angle, mean in zip(shots.directions, middle, strict=True)
    )
    return azimuth, elevation


def shot_pixels(
    frame: Frame, shots: Observation | None, directions: tuple[Floats, Floats]
) -> Pixels | None:
    """Return a sample of the open-water references; None if there are none."""
    if shots is None:
        return None
    count = shots.signal.shape[-1]
    index = np.linspace(0, count - 1, min(SHARING, count)).astype(int)
    samples = shots.flat().part(index)
    refuse_errors_of_zero(samples.covariance, samples.usable)
    return pixels_of(frame, samples, directions[0][index], directions[1][index])


def open_water_samples(scan: Observation, *, no_target: bool) -> tuple[Frame, Pixels]:
    """Return frame and samples of open water, from references or a target-free scan."""
    if not no_target:
        middle = float(scan.azimuth.mean()), float(scan.elevation.mean())
        directions = shot_directions(middle, scan.shots)
        frame = frame_of(scan, *directions)
        pixels = shot_pixels(frame, scan.shots, directions)
        assert pixels is not None
        return frame, pixels
    samples = scan.flat()
    refuse_errors_of_zero(samples.covariance, samples.usable)
    azimuth, elevation = scan.azimuth.ravel(), scan.elevation.ravel()
    frame = frame_of(scan, azimuth, elevation)
    count = len(samples.signal)
    index = np.linspace(0, count - 1, min(SHARING, count)).astype(int)
    return frame, pixels_of(
        frame, samples.part(index), azimuth[index], elevation[index]
    )


def refuse_single_frequency(frequency: Floats) -> None:
    """Raise a CubeError for a scan with one modulation frequency."""
    if len(frequency) < FEWEST_FREQUENCIES:
        raise CubeError(
            f"the cube has one modulation frequency, {frequency[0] / 1e6:g} MHz; joint "
            "estimation needs two or more to tell target from water: record a sweep, "
            "or use open-water, polarization or cross-polarized"
        )


def refuse_other_windows(origin_z: Floats, frame: Frame) -> None:
    """Raise a CubeError if the distance from emitter to window varies.

    Sideways, emitter and receiver move together and see the same water everywhere.
    """
    if frame.medium.window_distance is None:
        return
    shift = origin_z - frame.survey.instrument.emitter.position[2]
    farthest = float(shift.flat[np.argmax(np.abs(shift))])
    if abs(farthest) > _SAME_PLACE:
        raise CubeError(
            f"origin_z is up to {farthest:g} m off the emitter of the survey, behind a "
            "window: joint estimation needs the same way to the window in all pixels; "
            "split the scan, with a survey for each part, or use the open-water method"
        )


def refuse_errors_of_zero(errors: Covariance, usable: NDArray[np.bool_]) -> None:
    """Raise a CubeError for samples whose stated error is zero."""
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
    """Samples with their errors, and the possible optical paths of each pixel.

    Arrays run over (pixel, channel, frequency).
    """

    signal: Complex
    """Samples, 0 if unusable [V]."""
    covariance: Covariance
    """Covariance of the stated errors [V^2]."""
    usable: NDArray[np.bool_]
    """Mask of usable samples."""
    interpolation: Floats
    """Interpolation weights of the direction nodes, (pixel, node) [1]."""
    offset: Floats
    """Round-trip optical path before the water [m]."""
    shortest: Floats
    """Shortest optical path [m]."""
    longest: Floats
    """Longest optical path [m]."""
    depths: Floats
    """Water depths at a series of optical paths, finer in front [m]."""
    trends: Floats
    """Polynomials of each pixel's time, (pixel, trend); zero for shots with their own
    water strength [1]."""
    motion: Floats | None = None
    """Standard deviation of the optical path at each reading by the range rate, with a
    sign, and by its change, along a last axis; None for readings at once [m]."""

    def __len__(self) -> int:
        """Return the number of pixels."""
        return len(self.signal)

    def part(self, index: NDArray[np.intp] | slice) -> Pixels:
        """Return the pixels at an index."""
        return replace(
            self,
            covariance=Covariance(
                self.covariance.in_phase[index],
                self.covariance.quadrature[index],
                self.covariance.cross[index],
            ),
            motion=None if self.motion is None else self.motion[index],
            **{
                name: getattr(self, name)[index]
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
    samples: FlatSamples,
    azimuth: Floats,
    elevation: Floats,
    *,
    interval: tuple[float, float] | None = None,
    trends: Floats | None = None,
) -> Pixels:
    """Return samples with optical paths, depths and interpolation weights by pixel.

    `trends` are polynomials of the time, of water that changes during the scan.
    """
    geometry = frame.geometry(azimuth, elevation)
    beam = geometry.beam
    shortest, longest = geometry.path_limits(interval, frame.frequency)
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
        signal=np.where(samples.usable, samples.signal, 0.0),
        covariance=samples.covariance,
        usable=samples.usable,
        interpolation=frame.directions.interpolation(azimuth, elevation),
        offset=frame.optical_offset(azimuth, elevation).astype(float),
        shortest=shortest,
        longest=longest,
        depths=np.nan_to_num(np.maximum(slant_range - wide.length_before, 0.0)),
        trends=np.zeros((len(azimuth), 0)) if trends is None else trends,
        motion=samples.motion,
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
    """Return the coarse grid of optical paths for the search [m]."""
    step = 2 * np.pi / phase_per_path.max() / _POINTS_PER_PERIOD
    # Whole numbers of steps, so that paths do not depend on the other pixels.
    first = int(np.floor(pixels.shortest.min() / step)) - 1
    count = int(np.ceil(pixels.longest.max() / step)) + 2 - first
    if count > _MOST_POINTS:
        raise ValueError(
            f"the interval holds {count / _POINTS_PER_PERIOD:.3g} ambiguity intervals "
            "of the highest modulation frequency; narrow it"
        )
    return np.asarray(step * np.arange(first, first + count))


def coefficients(pixels: Pixels, table: Table | Changes) -> Floats:
    """Return the coefficients of the components of a table, (pixel, component) [1]."""
    return times(pixels.interpolation, table.basis)


def samples(pixels: Pixels, weights: Floats) -> bundles.Samples:
    """Return samples and their inverse covariance for compiled loops."""
    return bundles.Samples(to_pairs(pixels.signal), np.ascontiguousarray(weights))


def places(pixels: Pixels, table: Table) -> bundles.Places:
    """Return directions and possible optical paths of pixels for compiled loops."""
    return bundles.Places(
        coefficients(pixels, table),
        pixels.offset,
        pixels.shortest,
        pixels.longest,
        pixels.depths,
    )


def echo_of(transfer: Complex, phase_per_path: Floats) -> bundles.Echo:
    """Return phase per path and transfer function for compiled loops."""
    return bundles.Echo(phase_per_path, to_pairs(transfer))


def phasors(path: Floats, echo: bundles.Echo) -> bundles.Grid:
    """Return optical paths with their echoes of unit amplitude."""
    phasor = np.empty((path.size, 2, echo.phase_per_path.size))
    kernels.fill_phasors(path, echo, phasor)
    return bundles.Grid(path, phasor)
