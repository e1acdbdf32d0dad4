"""Samples of many pixels with all that their likelihood needs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.optics import rays
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint.frame import Frame, Table

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Paths at which the depth of each pixel is tabulated.
_DEPTH_NODES = 33
#: Points of the coarse likelihood within one period of the highest frequency.
_POINTS_PER_PERIOD = 12
_MOST_POINTS = 20_000


@dataclass(frozen=True)
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
    weights: Floats
    """Place within the scan, from `Frame.weights`, (pixel, node) [1]."""
    turned: Floats
    """Optical path before the water, out and back [m]."""
    shortest: Floats
    """Shortest optical path [m]."""
    longest: Floats
    """Longest optical path [m]."""
    depths: Floats
    """Depth of water at a series of paths, finer in front [m]."""

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
                    "weights",
                    "turned",
                    "shortest",
                    "longest",
                    "depths",
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
        np.where(usable, signal, 0.0),
        covariance,
        usable,
        frame.weights(azimuth, elevation),
        frame.optical_offset(azimuth, elevation).astype(float),
        shortest,
        longest,
        np.nan_to_num(np.maximum(slant_range - wide.length_before, 0.0)),
    )


def weight(pixels: Pixels, stray: Complex | None = None) -> Floats:
    """Return the inverse covariance of the samples.

    Parameters
    ----------
    pixels : Pixels
        Samples with their stated errors.
    stray : ndarray of complex, optional
        One standard deviation of a random change of the water signal, along the
        direction of that change [V].

    Returns
    -------
    ndarray, shape (pixel, channel, 3, frequency)
        Elements (in phase, both, quadrature); 0 where a sample does not count [1/V^2].
    """
    errors = pixels.covariance
    xx, yy, xy = errors.in_phase, errors.quadrature, errors.cross
    if stray is not None:
        xx = xx + stray.real**2
        yy = yy + stray.imag**2
        xy = xy + stray.real * stray.imag
    safe = np.where(pixels.usable, xx * yy - xy**2, 1.0)
    inverse = np.stack([yy, -xy, xx], axis=-2) / safe[..., None, :]
    return np.where(pixels.usable[..., None, :], inverse, 0.0)


def grid_of(pixels: Pixels, wavenumber: Floats) -> Floats:
    """Return the paths at which the likelihood is looked at first.

    Parameters
    ----------
    pixels : Pixels
        Their limits count.
    wavenumber : ndarray
        Phase per path of each frequency [1/m].

    Returns
    -------
    ndarray
        Paths in equal steps, one beyond the limits on both sides [m].

    Raises
    ------
    ValueError
        If there would be far too many.
    """
    step = 2 * np.pi / wavenumber.max() / _POINTS_PER_PERIOD
    first, last = pixels.shortest.min() - step, pixels.longest.max() + step
    count = int(np.ceil((last - first) / step)) + 1
    if count > _MOST_POINTS:
        raise ValueError(
            f"the interval holds {count / _POINTS_PER_PERIOD:.3g} ambiguity intervals "
            "of the highest modulation frequency; narrow it"
        )
    return np.asarray(first + step * np.arange(count))


def shares(pixels: Pixels, table: Table) -> Floats:
    """Return how much of each component of a table the pixels have [1]."""
    return np.ascontiguousarray(pixels.weights @ table.basis)


def parts(values: Complex) -> Floats:
    """Return complex numbers as real and imaginary parts, the axis before the last."""
    return np.ascontiguousarray(np.stack([values.real, values.imag], axis=-2))
