"""Interference maxima and minima over modulation frequency, and their spacing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics._bounds import (
    at_least,
    broadcast,
    finite,
    measured,
    not_negative,
    one_axis,
    require,
)

__all__ = ["Extrema", "find", "group_depth", "ripple", "separation"]


@dataclass(frozen=True)
class Extrema:
    """Modulation frequencies of the maxima and minima of a curve, in rising order.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics.extrema import find
    >>> frequency = np.linspace(0, 100e6, 201)
    >>> found = find(frequency, np.cos(2 * np.pi * frequency / 40e6))
    >>> print((found.maxima / 1e6).round(2), (found.minima / 1e6).round(2))
    [40. 80.] [20. 60.]
    """

    maxima: NDArray[np.float64]
    """Modulation frequencies of the maxima [Hz]."""
    minima: NDArray[np.float64]
    """Modulation frequencies of the minima [Hz]."""

    @property
    def separations(self) -> NDArray[np.float64]:
        """Spacings of successive maxima, then those of successive minima [Hz]."""
        return np.concatenate([np.diff(self.maxima), np.diff(self.minima)])


def find(modulation_frequency: ArrayLike, value: ArrayLike) -> Extrema:
    """Return the modulation frequencies of the maxima and minima of a curve.

    Parameters
    ----------
    modulation_frequency : array_like, shape (n,)
        Frequencies that increase, at least three [Hz].
    value : array_like, shape (n,)
        Values of the curve. Noise causes additional extrema, so smooth measured sweeps
        first.

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
    Extrema of the interference of target and water, eqs. (50)-(54) of Ricci et al.
    2010, as rederived, are spaced by `separation`.

    Examples
    --------
    >>> frequency = np.linspace(0, 100e6, 201)
    >>> result = find(frequency, np.cos(2 * np.pi * frequency / 40e6))
    >>> print(np.round(result.maxima / 1e6, 2), np.round(result.minima / 1e6, 2))
    [40. 80.] [20. 60.]
    """
    f, y = _sweep(modulation_frequency, finite(value, name="value"), name="value")
    left, right = y[1:-1] - y[:-2], y[2:] - y[1:-1]
    # A flat step counts once, at its right end.
    peak = np.flatnonzero(
        (left >= 0) & (right < 0) & (y[1:-1] > np.minimum(y[:-2], y[2:]))
    )
    pit = np.flatnonzero(
        (left <= 0) & (right > 0) & (y[1:-1] < np.maximum(y[:-2], y[2:]))
    )
    return Extrema(_vertex(f, y, peak + 1), _vertex(f, y, pit + 1))


def group_depth(
    modulation_frequency: ArrayLike,
    water_signal: ArrayLike,
    *,
    group_index: float,
) -> NDArray[np.float64]:
    r"""Return the apparent depth of a water signal from the slope of its phase [m].

    Parameters
    ----------
    modulation_frequency : array_like, shape (n,)
        Frequencies that increase, at least three [Hz].
    water_signal : array_like of complex, shape (n,)
        Signal of the water, of any unit, sampled so finely that its phase turns by
        less than a quarter from one frequency to the next.
    group_index : float
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray, shape (n,)
        Group depth z_w at each frequency, along the receiver axis, from the origin of
        the phase [m].

    Raises
    ------
    ValueError
        If the shapes differ, there are fewer than three samples, the frequencies do
        not increase, a signal is zero or not finite, the phase turns by a quarter or
        more between samples, or the group index is below 1.

    Notes
    -----
    :math:`z_w = (v / 2)\, d\varphi_w / d\omega`, as a target at the depth z has the
    phase :math:`2 \omega z / v`. At zero frequency it is the mean depth of the signal.
    The derivative is that of the parabola through three samples. Its error grows with
    the square of their spacing. At a deep minimum of a response the group depth can be
    negative: it is no physical depth.

    Examples
    --------
    >>> frequency = np.linspace(0, 100e6, 101)
    >>> from amulor.optics.low_pass import first_order_response
    >>> signal = first_order_response(frequency, cut_off=20e6)
    >>> depth = group_depth(frequency, signal, group_index=1.34)
    >>> print(np.round(depth[[0, 40]], 2))  # (v / 4 pi f_c) / (1 + (f / f_c)^2)
    [0.89 0.18]
    """
    f, w = _sweep(modulation_frequency, water_signal, name="water_signal")
    require(
        w,
        np.isfinite(w) & (w != 0),
        name="water_signal",
        rule="finite and other than 0",
        hint="zero has no phase",
    )
    index = at_least(group_index, 1, name="group_index")
    turn = np.angle(w[1:] / w[:-1])
    if np.max(np.abs(turn)) >= np.pi / 2:
        raise ValueError(
            "the phase of water_signal must turn by less than a quarter between "
            f"samples, got {np.max(np.abs(turn)) / (2 * np.pi):.2f} of a turn; sample "
            "the sweep more finely"
        )
    phase = np.append(0.0, np.cumsum(turn))
    slope = np.gradient(phase, 2 * np.pi * f, edge_order=2)
    return np.asarray(speed_of_light / index / 2 * slope)


def separation(
    distance: ArrayLike, *, group_depth: ArrayLike, group_index: float
) -> NDArray[np.float64]:
    r"""Return the frequency period of target and water-signal interference [Hz].

    Parameters
    ----------
    distance : array_like
        Distance d of the target, from the origin of the phase [m].
    group_depth : array_like
        Group depth z_w of the water signal between the maxima, as `group_depth`
        returns it; below the distance [m].
    group_index : float
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray
        Full period in modulation frequency, of the broadcast shape [Hz].

    Raises
    ------
    ValueError
        If a distance is negative, not beyond the group depth, or the group index is
        below 1.

    Notes
    -----
    :math:`\Delta f = v / 2 (d - z_w)`: a full turn of the angle :math:`\psi` of eq.
    (51) of Ricci et al. 2010 [1]_, as rederived, for a nearly constant group depth.
    With :math:`z_w = 0` the period would be too short.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> print(f"{separation(3.9, group_depth=0.9, group_index=1.34) / 1e6:.1f} MHz")
    37.3 MHz
    """
    far = measured(distance, name="distance", unit="m")
    near = finite(group_depth, name="group_depth", unit="m")
    index = at_least(group_index, 1, name="group_index")
    broadcast(distance=far, group_depth=near, group_index=index)
    ahead = far - near
    require(
        ahead,
        ~(ahead <= 0),
        name="distance - group_depth",
        rule="above 0",
        unit="m",
        hint="the target must be behind what the water signal comes from",
    )
    return np.asarray(speed_of_light / index / (2 * ahead))


def ripple(value: ArrayLike) -> float:
    """Return the ripple (max - min) / mean of a curve over frequency.

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
    y = finite(value, name="value")
    require(y.mean(), y.mean() > 0, name="the mean of value", rule="above 0")
    return float(np.ptp(y) / y.mean())


def _sweep(
    modulation_frequency: ArrayLike, value: ArrayLike, *, name: str
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Return frequencies and values of a curve; ValueError unless frequencies rise."""
    f = not_negative(modulation_frequency, name="modulation_frequency", unit="Hz")
    y = np.asarray(value)
    one_axis(3, modulation_frequency=f, **{name: y})
    rising = np.append(True, np.diff(f) > 0)
    require(
        f,
        rising,
        name="modulation_frequency",
        rule="rising",
        unit="Hz",
        hint="sort the sweep by it",
    )
    return f, y


def _vertex(
    f: NDArray[np.float64], y: NDArray[np.float64], at: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return the vertex frequencies of parabolas through three samples [Hz]."""
    before, after = f[at - 1] - f[at], f[at + 1] - f[at]
    low, high = y[at - 1] - y[at], y[at + 1] - y[at]
    curve = (high / after - low / before) / (after - before)
    slope = low / before - curve * before
    vertex: NDArray[np.float64] = f[at] - slope / (2 * curve)
    return vertex
