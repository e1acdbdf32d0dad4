"""Maxima and minima of a sweep over modulation frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Extrema", "find", "ripple"]


@dataclass(frozen=True)
class Extrema:
    """Where a curve turns, in rising order of frequency."""

    maxima: NDArray[np.float64]
    """Modulation frequencies of the maxima [Hz]."""
    minima: NDArray[np.float64]
    """Modulation frequencies of the minima [Hz]."""

    @property
    def separations(self) -> NDArray[np.float64]:
        """Distances of successive maxima and of successive minima [Hz]."""
        return np.concatenate([np.diff(self.maxima), np.diff(self.minima)])


def find(modulation_frequency: ArrayLike, value: ArrayLike) -> Extrema:
    """Return where amplitude, contrast or another quantity is largest and smallest.

    Parameters
    ----------
    modulation_frequency : array_like, shape (n,)
        Frequencies that increase, at least three [Hz].
    value : array_like, shape (n,)
        The quantity; noise makes extrema of its own, so smooth measured sweeps first.

    Returns
    -------
    Extrema
        Turning points inside the sweep, each from the parabola through its three
        nearest samples.

    Raises
    ------
    ValueError
        If the shapes differ, there are fewer than three samples, or the frequencies
        do not increase.

    Notes
    -----
    Successive maxima of the interference of target and water lie v / 2 (d - z_w)
    apart, with the group depth z_w of the water signal; see eqs. (50)-(54) of Ricci et
    al. 2010, as rebuilt.

    Examples
    --------
    >>> frequency = np.linspace(0, 100e6, 201)
    >>> found = find(frequency, np.cos(2 * np.pi * frequency / 40e6))
    >>> print(np.round(found.maxima / 1e6, 2), np.round(found.minima / 1e6, 2))
    [40. 80.] [20. 60.]
    """
    f = np.asarray(modulation_frequency, dtype=float)
    y = np.asarray(value, dtype=float)
    if f.ndim != 1 or f.shape != y.shape or f.size < 3:
        raise ValueError(
            "modulation_frequency and value must be 1-D, of one length, at least 3; "
            f"got shapes {f.shape} and {y.shape}"
        )
    if np.any(np.diff(f) <= 0):
        raise ValueError("modulation_frequency must increase; sort the sweep by it")
    left, right = y[1:-1] - y[:-2], y[2:] - y[1:-1]
    # A flat step counts once, at its right end.
    peak = np.flatnonzero(
        (left >= 0) & (right < 0) & (y[1:-1] > np.minimum(y[:-2], y[2:]))
    )
    pit = np.flatnonzero(
        (left <= 0) & (right > 0) & (y[1:-1] < np.maximum(y[:-2], y[2:]))
    )
    return Extrema(_vertex(f, y, peak + 1), _vertex(f, y, pit + 1))


def ripple(value: ArrayLike) -> float:
    """Return (max - min) / mean of a sweep.

    Parameters
    ----------
    value : array_like
        Amplitudes, with a mean above zero.

    Returns
    -------
    float
        Ripple [1].

    Raises
    ------
    ValueError
        If the mean is not above zero.

    Examples
    --------
    >>> ripple([1.0, 3.0, 2.0])
    1.0
    """
    y = np.asarray(value, dtype=float)
    if not y.mean() > 0:
        raise ValueError(f"the mean of value must be above 0, got {y.mean():g}")
    return float(np.ptp(y) / y.mean())


def _vertex(
    f: NDArray[np.float64], y: NDArray[np.float64], at: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return the vertices of the parabolas through samples and their neighbours."""
    before, after = f[at - 1] - f[at], f[at + 1] - f[at]
    low, high = y[at - 1] - y[at], y[at + 1] - y[at]
    curve = (high / after - low / before) / (after - before)
    slope = low / before - curve * before
    vertex: NDArray[np.float64] = f[at] - slope / (2 * curve)
    return vertex
