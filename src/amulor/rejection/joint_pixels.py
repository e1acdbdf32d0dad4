"""Likelihood of the samples of many pixels, and its highest point for each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.optics import rays
from amulor.rejection import _joint_kernels as kernels
from amulor.rejection import _joint_search_kernels as search
from amulor.rejection.joint_water import Frame, Table
from amulor.rejection.reference import Covariance

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


@dataclass(frozen=True)
class Estimates:
    """Most likely path of each pixel, and what belongs to it."""

    path: Floats
    """Optical path, out and back; not a number where none is possible [m]."""
    amplitude: Floats
    """Target amplitude in each channel, (pixel, channel) [V]."""
    cost: Floats
    """Sum of squared errors in units of their standard deviation [1]."""
    empty_cost: Floats
    """The same for open water without a target [1]."""
    information: Floats
    """Inverse variance of the path with the water signal known [1/m^2]."""
    lower: Floats
    """How far the path may be shorter until `cost` has risen by 1 [m]."""
    upper: Floats
    """How far it may be longer [m]."""
    wrong: Floats
    """Probability that the path lies in another ambiguity interval [1]."""
    used: NDArray[np.intp]
    """Number of outputs that count, two for each sample."""
    influence: Complex
    """Shift of the path per unit of in-phase + 1j * quadrature, as the real part of
    the product with its conjugate, (pixel, channel, frequency) [m/V]."""


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
        beam.entry[:, None],
        beam.direction[:, None],
        beam.length_before[:, None],
        beam.optical_length_before[:, None],
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


def estimate(
    pixels: Pixels,
    weights: Floats,
    table: Table,
    *,
    gain: Complex,
    transfer: Complex,
    wavenumber: Floats,
    known: Floats | None = None,
) -> Estimates:
    """Return the most likely path of each pixel for a given water signal.

    Parameters
    ----------
    pixels : Pixels
        Samples.
    weights : ndarray
        Their inverse covariance, from `weight`.
    table : Table
        Water signal against its end.
    gain : ndarray of complex, shape (channel, frequency)
        Strength of the water signal [V].
    transfer : ndarray of complex, shape (frequency,)
        What the echo of the target has beyond its delay [1].
    wavenumber : ndarray, shape (frequency,)
        Phase per path [1/m].
    known : ndarray, optional
        Paths to start from instead of looking for the highest likelihood anywhere;
        leaves the limits of the profile and other intervals alone [m].

    Returns
    -------
    Estimates
        Arrays over the pixels.
    """
    count, channels, frequencies = pixels.signal.shape
    grid = grid_of(pixels, wavenumber) if count else np.arange(2.0)
    out = np.empty((count, search.COLUMNS))
    amplitude = np.empty((count, channels))
    influence = np.empty((count, channels, 2, frequencies))
    search.estimate(
        parts(pixels.signal),
        np.ascontiguousarray(weights),
        parts(gain),
        shares(pixels, table),
        pixels.turned,
        parts(table.value),
        parts(table.slope),
        table.step,
        wavenumber,
        parts(transfer),
        grid,
        pixels.shortest,
        pixels.longest,
        pixels.depths,
        np.zeros(0) if known is None else known,
        known is not None,
        out,
        amplitude,
        influence,
    )
    return Estimates(
        path=out[:, search.PATH],
        amplitude=amplitude,
        cost=out[:, search.COST],
        empty_cost=out[:, search.EMPTY_COST],
        information=out[:, search.INFORMATION],
        lower=out[:, search.LOWER],
        upper=out[:, search.UPPER],
        wrong=out[:, search.WRONG],
        used=out[:, search.USED].astype(np.intp),
        influence=influence[..., 0, :] + 1j * influence[..., 1, :],
    )


def water_at(
    pixels: Pixels, path: Floats, table: Table, wavenumber: Floats
) -> tuple[Floats, Complex, Complex]:
    """Return depth [m], water signal of unit strength, and its slope in the path.

    Parameters
    ----------
    pixels : Pixels
        Their places count.
    path : ndarray, shape (pixel,)
        Optical path; infinite for open water [m].
    table : Table
        Water signal against its end.
    wavenumber : ndarray, shape (frequency,)
        Phase per path [1/m].

    Returns
    -------
    tuple of ndarrays
        Depth, signal [1] and slope [1/m], the latter over (pixel, frequency).
    """
    count = len(pixels)
    depth = np.empty(count)
    water = np.empty((count, 2, wavenumber.size))
    change = np.empty_like(water)
    kernels.water_at(
        path,
        pixels.shortest,
        pixels.longest,
        pixels.depths,
        table.step,
        shares(pixels, table),
        parts(table.value),
        parts(table.slope),
        pixels.turned,
        wavenumber,
        depth,
        water,
        change,
    )
    return (
        depth,
        water[:, 0] + 1j * water[:, 1],
        change[:, 0] + 1j * change[:, 1],
    )


def shape_changes(
    pixels: Pixels, depth: Floats, table: Table, wavenumber: Floats
) -> Complex:
    """Return the derivatives of the water signal with respect to its shape.

    Parameters
    ----------
    pixels : Pixels
        Their places count.
    depth : ndarray, shape (pixel,)
        Where the water ends, infinite for open water [m].
    table : Table
        Water signal against its end.
    wavenumber : ndarray, shape (frequency,)
        Phase per path [1/m].

    Returns
    -------
    ndarray of complex, shape (pixel, parameter, frequency)
        Derivatives [1].
    """
    out = np.empty((len(pixels), len(table.change), wavenumber.size), dtype=complex)
    kernels.interpolate(depth, table.step, shares(pixels, table), table.change, out)
    turn = np.exp(1j * pixels.turned[:, None] * wavenumber)
    out *= turn[:, None, :]
    return out
