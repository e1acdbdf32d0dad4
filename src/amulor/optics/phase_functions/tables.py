r"""Phase functions from tables: measurements in sea water, or tables of the user.

Between its points a table is a power law, a straight line on double logarithmic axes.
Below its first angle, where there are no data, the power law is extrapolated, and the
description of the object states this.

>>> harbour = petzold("NUC 2040")
>>> print(harbour.description.replace(", ", "\n"))
Petzold 1972
NUC 2040; below 0.1 deg
where 5.2 % of the scattering lies
a power law with the exponent -1.346
without data
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import _tables
from amulor.optics._bounds import checked_angle, finite, one_axis, positive
from amulor.optics.phase_functions.integrals import INNERMOST_ANGLE, Panels
from amulor.optics.phase_functions.phase_function import PhaseFunction

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

__all__ = ["STATIONS", "from_cumulative", "petzold", "tabulated"]

STATIONS = (
    "AUTEC 7",
    "AUTEC 8",
    "AUTEC 9",
    "HAOCE 5",
    "HAOCE 11",
    "NUC 2200",
    "NUC 2040",
    "NUC 2240",
)
"""Petzold's stations: clear ocean (AUTEC), coast (HAOCE), San Diego Harbor (NUC)."""


def tabulated(
    angle: ArrayLike,
    *,
    value: ArrayLike,
    head_exponent: float | None = None,
    name: str = "tabulated",
) -> PhaseFunction:
    r"""Return a phase function from a table of its values.

    Parameters
    ----------
    angle : array_like
        Scattering angles, rising to pi, 1-D, from 0 or from 1e-9 rad at least [rad].
    value : array_like
        Phase function [1/sr], or volume scattering function [1/(m sr)], at the
        angles, above 0. It is divided by its integral, which the result keeps.
    head_exponent : float, optional
        Exponent s of the power law :math:`\theta^{-s}` below the first angle, below 2
        [1]. By default that between the first two angles.
    name : str
        Name of the table.

    Returns
    -------
    PhaseFunction
        `head_angle` is the first angle of the table.

    Raises
    ------
    ValueError
        If the table cannot be used, or its power law below the first angle has infinite
        scattering.

    Notes
    -----
    A table that starts at 0 needs no extrapolation. Up to its second angle, the
    logarithm of the value is linear in the square of the angle, as in a diffraction
    lobe.

    Examples
    --------
    >>> angle = np.radians([0.1, 1, 10, 90, 180])
    >>> table = tabulated(angle, value=[90, 9, 0.5, 3e-3, 4e-3])
    >>> print(f"{table.integral:.3f}, {table.head_exponent:.2f}")
    0.283, 1.00
    """
    theta, density = _checked(angle, value, name="value")
    positive(density, name="value", unit="1/sr")
    head = 0.0
    if theta[0] > 0:
        first = -np.log(density[1] / density[0]) / np.log(theta[1] / theta[0])
        head = float(first if head_exponent is None else head_exponent)
    elif head_exponent is not None:
        raise ValueError(
            "head_exponent must be left out, as the table starts at 0 rad: it has no "
            f"head; got {head_exponent:g}"
        )
    _refuse_heavy(head)
    logs = np.log(density)
    edges = _edges(theta, np.concatenate([[0.0], np.abs(np.diff(logs))]))
    table = partial(_table_value, node=theta, logs=logs, head=head)
    integral = Panels(table, edges, head).mean(np.ones_like)
    unit = partial(_table_value, node=theta, logs=logs - np.log(integral), head=head)
    return PhaseFunction(
        name=name,
        panels=Panels(unit, edges, head),
        head_angle=float(theta[0]),
        integral=integral,
    )


def from_cumulative(
    angle: ArrayLike, *, cumulative: ArrayLike, name: str = "from cumulative"
) -> PhaseFunction:
    r"""Return a phase function from a table of cumulative fractions.

    Parameters
    ----------
    angle : array_like
        Angles, 1e-9 rad at least, rising to pi, 1-D, at least 4 [rad].
    cumulative : array_like
        Fraction of the scattering below each angle, above 0, rising to 1 [1].
    name : str
        Name of the table.

    Returns
    -------
    PhaseFunction
        `head_angle` is the first angle of the table.

    Raises
    ------
    ValueError
        If the table cannot be used.

    Notes
    -----
    The logarithm of the fraction is a monotone cubic function of the logarithm of
    :math:`\sin^2(\theta/2)` (F. N. Fritsch and J. Butland, SIAM J. Sci. Stat. Comput.
    5, 300 (1984)). Below the first angle it continues as the straight line through the
    first two fractions. Fractions at the angles of the table are exact, values have the
    error of the differences of its rounded fractions.

    Examples
    --------
    >>> angle = np.linspace(0.05, np.pi, 60)
    >>> p = from_cumulative(angle, cumulative=np.sin(angle / 2) ** 2)
    >>> print(f"{4 * np.pi * p(1.0):.3f}")
    1.000
    """
    theta, fraction = _checked(angle, cumulative, name="cumulative")
    if theta.size < 4 or theta[0] == 0:
        raise ValueError(
            "angle must have at least 4 values above 0 rad, got "
            f"{theta.size} from {theta[0]:g} rad"
        )
    if (
        not (fraction[0] > 0 and np.all(np.diff(fraction) > 0))
        or abs(fraction[-1] - 1) > 1e-9
    ):
        raise ValueError(
            "cumulative must be above 0 and rise to 1, got values from "
            f"{fraction[0]:g} to {fraction[-1]:g}"
        )
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    log_height = np.log(np.sin(theta / 2) ** 2)
    log_fraction = np.log(fraction)
    slopes = PchipInterpolator(log_height, log_fraction)(log_height, 1)
    slopes[0] = (log_fraction[1] - log_fraction[0]) / (log_height[1] - log_height[0])
    curve = CubicHermiteSpline(log_height, log_fraction, slopes)
    slope = float(slopes[0])
    head = 2 - 2 * slope
    _refuse_heavy(head)
    value = partial(_slope_value, curve=curve, node=theta, slope=slope)
    at = value(theta)
    changes = np.concatenate([[0.0], np.abs(np.diff(np.log(np.maximum(at, 1e-300))))])
    panels = Panels(value, _edges(theta, np.minimum(changes, 30.0)), head)
    return PhaseFunction(name=name, panels=panels, head_angle=float(theta[0]))


def petzold(station: str) -> PhaseFunction:
    """Return a phase function from Petzold's measurements in natural water.

    Parameters
    ----------
    station : str
        One of `STATIONS`, among them "AUTEC 8", usual for clear ocean, "HAOCE 11", for
        coastal and "NUC 2040", for harbor water; or "average_particle", the average of
        Mobley et al. without the scattering of water.

    Returns
    -------
    PhaseFunction
        For a station, with the water itself; `integral` is its scattering coefficient
        [1/m].

    Raises
    ------
    ValueError
        If there is no such station.

    Notes
    -----
    T. J. Petzold, Volume Scattering Functions for Selected Ocean Waters, SIO Ref. 72-78
    (1972), at 530 nm, and C. D. Mobley et al., Appl. Opt. 32, 7484 (1993),
    :doi:`10.1364/AO.32.007484`. At AUTEC and HAOCE the values below 0.169 degrees are
    extrapolated by the report. The power law below 0.1 degree has the report's slope;
    for the average particle, that of its fractions. Shapes hold for other wavelengths
    better than scattering coefficients do. The value of the average particle at 180
    degrees comes from fractions given to 1e-6 and has an error of a few percent.

    Examples
    --------
    >>> harbour = petzold("NUC 2040")
    >>> print(f"b = {harbour.integral:.2f} 1/m, {harbour.backscatter_fraction:.3f}")
    b = 1.82 1/m, 0.020
    """
    if station == "average_particle":
        degrees, fraction = _tables.numbers("mobley_1993_average_particle.csv").T
        return from_cumulative(
            _radians(degrees),
            cumulative=fraction,
            name="average particle of Mobley et al. 1993",
        )
    if station not in STATIONS:
        raise ValueError(
            f"station must be 'average_particle' or one of {', '.join(STATIONS)}; "
            f"got {station!r}"
        )
    column = STATIONS.index(station)
    table = _tables.numbers("petzold_1972_vsf.csv")
    row = _tables.rows("petzold_1972_coefficients.csv")[column]
    slope = float(row["slope_below_0.1_deg"])
    return tabulated(
        _radians(table[:, 0]),
        value=table[:, column + 1],
        head_exponent=-slope,
        name=f"Petzold 1972, {station}",
    )


def _table_value(
    angle: NDArray[np.float64],
    *,
    node: NDArray[np.float64],
    logs: NDArray[np.float64],
    head: float,
) -> NDArray[np.float64]:
    """Evaluate a table by power laws between angles, and a power law or lobe near 0."""
    start = 1 if node[0] == 0 else 0
    with np.errstate(divide="ignore"):  # log(0) meets the lobe, or a head refused
        log_angle = np.log(angle)
    value = np.interp(log_angle, np.log(node[start:]), logs[start:])
    if start:
        lobe = logs[0] + (logs[1] - logs[0]) * (angle / node[1]) ** 2
        value = np.where(angle < node[1], lobe, value)
    elif head != 0:
        below = np.minimum(log_angle - np.log(node[0]), 0.0)
        value = value - head * below
    return np.asarray(np.exp(value))


def _slope_value(
    angle: NDArray[np.float64],
    *,
    curve: CubicHermiteSpline,
    node: NDArray[np.float64],
    slope: float,
) -> NDArray[np.float64]:
    """Return the phase function as derivative of cumulative fractions [1/sr]."""
    tiny = np.maximum(np.sin(angle / 2) ** 2, 1e-300)
    first = np.sin(node[0] / 2) ** 2
    position = np.log(np.clip(tiny, first, 1.0))
    # The curve rises; where it is level, rounding may cause values below zero.
    fraction, steepness = np.exp(curve(position)), np.maximum(curve(position, 1), 0.0)
    # d(solid angle) = 4 pi dh with h = sin^2(angle / 2).
    value = fraction * steepness / (4 * np.pi * np.maximum(tiny, first))
    head = (np.minimum(tiny, first) / first) ** (slope - 1)
    return np.asarray(value * head)


def _edges(
    node: NDArray[np.float64], change: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return edges of angle panels that span at most a factor of 2 in angle [rad]."""
    start = 1 if node[0] == 0 else 0
    first = node[start]
    parts = [np.geomspace(INNERMOST_ANGLE, first, 2 + int(np.log2(first) + 40))[:-1]]
    for low, high, steps in zip(
        node[start:-1], node[start + 1 :], change[start + 1 :], strict=True
    ):
        count = int(np.ceil(max(np.log2(high / low), steps / 3, 1.0)))
        parts.append(np.geomspace(low, high, count + 1)[:-1])
    return np.concatenate([*parts, [np.pi]])


def _checked(
    angle: ArrayLike, table: ArrayLike, *, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return angles and values of a table; ValueError unless angles rise to pi."""
    theta = checked_angle(angle, name="angle")
    column = finite(table, name=name)
    one_axis(2, angle=theta, **{name: column})
    if not np.all(np.diff(theta) > 0) or theta[-1] < np.pi - 1e-9:
        raise ValueError(
            "angle must rise strictly and end at pi rad (180 degrees), got "
            f"{theta[0]:g} to {theta[-1]:g} rad; extend the table first"
        )
    if theta[1] < 1e-9 or 0 < theta[0] < 1e-9:
        raise ValueError(
            f"angles above 0 must be at least 1e-9 rad, got {theta[:2]} rad first"
        )
    theta = theta.copy()
    theta[-1] = np.pi
    return theta, column.copy()


def _refuse_heavy(head_exponent: float) -> None:
    """Raise a ValueError if a small-angle power law has an infinite integral."""
    if not (np.isfinite(head_exponent) and head_exponent < 2):
        raise ValueError(
            "the head below the first angle must be a power law with an exponent "
            f"below 2 for finite scattering, got {head_exponent:g}; give "
            "head_exponent, or a table that starts at 0 rad"
        )


def _radians(degrees: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert degrees to radians, at most pi."""
    return np.minimum(np.radians(degrees), np.pi)
