"""Samples of many pixels with all that their likelihood needs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.optics import rays
from amulor.rejection.covariance import Covariance, times
from amulor.rejection.joint._kernels import bundles
from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.joint.overlap.frame import Frame
from amulor.rejection.joint.overlap.table import Table, to_pairs

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

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
    """Return samples with all that their likelihood needs.

    Parameters
    ----------
    frame : Frame
        How the receiver looks at the scan.
    signal, covariance, usable
        As in `Pixels`.
    azimuth, elevation : ndarray, shape (pixel,)
        Directions [rad].
    interval : tuple of float, optional
        Nearest and farthest slant range [m].
    modulation_frequency : ndarray
        Modulation frequencies [Hz].
    trends : ndarray, shape (pixel, trend)
        As in `Pixels` [1].

    Returns
    -------
    Pixels
        The same samples.
    """
    beam = frame.beam(azimuth, elevation)
    shortest, longest = rays.path_limits(
        interval,
        beam,
        frame.receiver,
        medium=frame.medium,
        modulation_frequency=modulation_frequency,
    )
    place = np.linspace(0, 1, _DEPTH_NODES) ** 2
    path = shortest[:, None] + (longest - shortest)[:, None] * place
    wide = rays.Beam(
        entry=beam.entry[:, None],
        direction=beam.direction[:, None],
        length_before=beam.length_before[:, None],
        optical_length_before=beam.optical_length_before[:, None],
    )
    slant_range = rays.slant_range_of_path(
        path, wide, frame.receiver, medium=frame.medium
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
    """Return the inverse covariance of the samples.

    Parameters
    ----------
    pixels : Pixels
        Samples with their stated errors.
    deviation : ndarray of complex, optional
        One standard deviation of a random change of the water signal, along the
        direction of that change [V].
    scale : float, optional
        How many times the stated errors are too small [1].

    Returns
    -------
    ndarray, shape (pixel, channel, 3, frequency)
        Elements (in phase, both, quadrature); 0 where a sample does not count [1/V^2].
    """
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
    """Return the paths at which the likelihood is looked at first.

    Parameters
    ----------
    pixels : Pixels
        Their limits count.
    phase_per_path : ndarray
        2 pi f / c_0 of each frequency [rad/m].

    Returns
    -------
    ndarray
        Paths in equal steps, one beyond the limits on both sides [m].

    Raises
    ------
    ValueError
        If there would be far too many.
    """
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
