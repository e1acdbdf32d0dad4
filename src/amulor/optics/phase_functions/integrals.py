r"""Integrals of a phase function: forward fraction, cumulative, Hankel transform.

Scattering in the sea rises towards 0 degrees over many decades of the angle. Every
integral is therefore a sum of Gauss-Legendre rules over panels that widen with the
angle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from amulor.optics._bounds import checked_split_angle, not_negative

__all__ = ["Panels", "forward_split", "gauss_legendre"]

Density = Callable[[NDArray[np.float64]], NDArray[np.float64]]

INNERMOST_ANGLE = 1e-12
"""Angle below which a phase function is integrated as a power law [rad]."""

LARGEST_DIRECTION_FREQUENCY = 1e9
"""Largest frequency accepted by `Panels.hankel` [1/rad]."""


@dataclass(frozen=True, eq=False)
class Panels:
    r"""Intervals of angle in which a phase function is smooth, for quadrature.

    Parameters
    ----------
    value : callable
        Phase function [1/sr] of an array of angles [rad].
    edges : ndarray
        Ends of the panels, rising from `INNERMOST_ANGLE` to pi [rad]. Each ends at
        no more than about twice the angle at which it starts.
    head_exponent : float
        Exponent s, below 2, of the power law :math:`\theta^{-s}` that holds below
        the first edge; 0 if the phase function is finite there [1].

    Notes
    -----
    Rules of 16 points. For a function whose singularities lie no closer to a panel
    than the angle 0 does, their relative error is about 1e-12.

    Examples
    --------
    Isotropic scattering: half of it goes forward.

    >>> import numpy as np
    >>> panels = Panels(
    ...     value=lambda angle: np.full(angle.shape, 1 / (4 * np.pi)),
    ...     edges=np.geomspace(1e-8, np.pi, 40),
    ... )
    >>> print(f"{panels.cumulative(np.array([np.pi / 2]))[0]:.6f}")
    0.500000
    """

    value: Density
    edges: NDArray[np.float64]
    head_exponent: float = 0.0

    def cumulative(self, angle: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the solid-angle integral of the phase function up to angles [1]."""
        flat = angle.ravel()
        panel = np.searchsorted(self.edges, flat, side="right") - 1
        panel = np.minimum(panel, self.edges.size - 2)
        low = self.edges[np.maximum(panel, 0)]
        fractions = self._rule(self.edges[:-1], self.edges[1:])[1].sum(axis=1)
        below = self._innermost() + np.concatenate([[0.0], np.cumsum(fractions)])
        inside = self._rule(low, np.maximum(flat, low))[1].sum(axis=1)
        head = self._innermost() * (flat / self.edges[0]) ** (2 - self.head_exponent)
        total: NDArray[np.float64] = np.where(
            panel < 0, head, below[np.maximum(panel, 0)] + inside
        )
        return total.reshape(angle.shape)

    def mean(self, weight: Density, *, low: float = 0.0, high: float = np.pi) -> float:
        """Return the solid-angle integral of the phase function times a weight.

        Parameters
        ----------
        weight : callable
            Function of an array of scattering angles [rad].
        low, high : float
            Ends of the integral [rad].

        Returns
        -------
        float
            The integral [unit of the weight].

        Examples
        --------
        >>> flat = Panels(lambda angle: 0 * angle + 0.25 / np.pi, np.geomspace(
        ...     INNERMOST_ANGLE, np.pi, 40))
        >>> print(f"{flat.mean(np.ones_like, high=np.pi / 2):.6f}")
        0.500000
        """
        start = max(low, self.edges[0])
        inner = self.edges[(self.edges > start) & (self.edges < high)]
        edges = np.concatenate([[start], inner, [high]])
        angle, fraction = self._rule(edges[:-1], edges[1:])
        total = float(np.sum(weight(angle) * fraction))
        if low < self.edges[0]:
            total += float(weight(self.edges[:1])[0]) * self._innermost()
        return total

    def hankel(
        self, direction_frequency: NDArray[np.float64], *, split_angle: float
    ) -> NDArray[np.float64]:
        r"""Return the Hankel transform of the phase function below a split angle.

        Parameters
        ----------
        direction_frequency : ndarray
            Conjugate q of the angle, from 0 to `LARGEST_DIRECTION_FREQUENCY` [1/rad].
        split_angle : float
            Upper end, above `INNERMOST_ANGLE` to pi [rad].

        Returns
        -------
        ndarray
            Transform, of the shape of `direction_frequency`, not renormalised [1].

        Notes
        -----
        Where a panel holds less than about half an oscillation, the plain rule. In
        others :math:`J_0 = \operatorname{Re} H_0^{(1)}` is split into
        :math:`e^{ik\theta}` and a slow factor; the product of that and of
        :math:`p \sin\theta` becomes a Legendre series, whose terms transform into
        spherical Bessel functions (L. N. G. Filon, Proc. R. Soc. Edinburgh 49, 38
        (1928), in the Legendre form of N. S. Bakhvalov and L. G. Vasil'eva, USSR
        Comput. Math. Math. Phys. 8, 241 (1968)). The error does not grow with k.
        """
        flat = direction_frequency.ravel()
        edges = self.edges[self.edges < split_angle]
        edges = np.append(edges, split_angle)
        low, high = edges[:-1], edges[1:]
        at_ends = self.value(edges)
        # The rule of 7 points serves panels of 10 % and a change of 30 %.
        narrow = high <= 1.1 * low
        with np.errstate(divide="ignore", invalid="ignore"):
            narrow &= np.abs(np.log(at_ends[1:] / at_ends[:-1])) <= 0.3
        reach = flat * self.edges[0]  # at most 1e-3
        curvature = (2 - self.head_exponent) / (4 - self.head_exponent) / 4
        total: NDArray[np.float64] = self._innermost() * (1 - curvature * reach**2)
        if np.any(narrow):
            # Loads the compiler, which those who integrate nothing do without.
            from amulor.optics._quadrature import bessel
            from amulor.optics.phase_functions import _kernels

            nodes = _kernels.NODES
            angle, fraction = self._rule(low[narrow], high[narrow], order=nodes)
            _kernels.narrow_panels(
                flat, angle, fraction, bessel(), _legendre(nodes), total
            )
        if not np.all(narrow):
            angle, fraction = self._rule(low[~narrow], high[~narrow])
            # About 2e5 pairs of a frequency and a panel at once.
            step = max(1, 200_000 // angle.shape[0])
            for first in range(0, flat.size, step):
                part = slice(first, first + step)
                total[part] += _oscillating(flat[part], angle, fraction)
        return total.reshape(direction_frequency.shape)

    def _innermost(self) -> float:
        """Return the phase-function integral over angles below the first edge [1]."""
        end = self.edges[:1]
        fraction = 2 * np.pi * self.value(end) * end**2 / (2 - self.head_exponent)
        return float(fraction[0])

    def _rule(
        self, low: NDArray[np.float64], high: NDArray[np.float64], *, order: int = 16
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return angles, and quadrature weights times 2 pi p sin(angle), by panel."""
        nodes, weights = gauss_legendre(order)
        half = (high - low)[:, np.newaxis] / 2
        angle = np.minimum(low[:, np.newaxis] + half * (nodes + 1), np.pi)
        return angle, 2 * np.pi * self.value(angle) * np.sin(angle) * half * weights


def _oscillating(
    direction_frequency: NDArray[np.float64],
    angle: NDArray[np.float64],
    fraction: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the Hankel transform over angle panels, precise for fast oscillations."""
    from amulor.optics.phase_functions import _kernels

    order = angle.shape[1]
    nodes, _ = gauss_legendre(order)
    half = (angle[:, -1] - angle[:, 0]) / (nodes[-1] - nodes[0])
    centre = angle.mean(axis=1)
    stretch = direction_frequency[:, np.newaxis] * half
    slow = stretch < _kernels.SLOW
    row, panel = np.nonzero(slow)
    waves = special.j0(direction_frequency[row, np.newaxis] * angle[panel])
    value = np.sum(fraction[panel] * waves, axis=1)
    total: NDArray[np.float64] = np.zeros(direction_frequency.size)
    total += np.bincount(row, value, minlength=direction_frequency.size)
    row, panel = np.nonzero(~slow)
    if row.size:
        k = direction_frequency[row]
        phased = fraction[panel] * special.hankel1e(0, k[:, np.newaxis] * angle[panel])
        degree = np.arange(order)
        # fraction holds the weights of the rule, so these are 2 / (2 l + 1) times the
        # terms of the series; the transform of P_l is 2 i^l j_l.
        series = phased @ (_legendre(order).T * 1j**degree)
        stretched = special.spherical_jn(degree, stretch[row, panel][:, np.newaxis])
        wave = np.exp(1j * k * centre[panel])
        value = np.real(wave * np.sum(series * stretched, axis=1))
        total += np.bincount(row, value, minlength=direction_frequency.size)
    return total


@cache
def _legendre(order: int) -> NDArray[np.float64]:
    """Return (2 l + 1) times Legendre polynomial P_l at quadrature nodes, in row l."""
    nodes, _ = gauss_legendre(order)
    degree = np.arange(order)[:, np.newaxis]
    return np.ascontiguousarray((2 * degree + 1) * special.eval_legendre(degree, nodes))


def forward_split(
    phase_function: Callable[[NDArray[np.float64]], ArrayLike],
    *,
    split_angle: float,
) -> tuple[float, float]:
    r"""Return the forward fraction and the second moment of a phase function.

    Parameters
    ----------
    phase_function : callable
        Phase function [1/sr] of an array of angles from 0 to pi [rad], same shape.
        Its integral over the sphere must be 1 within 2 %, as that of measured
        tables with their rounded scattering coefficients is.
    split_angle : float
        Angle between the forward and the diffuse part, above 0 to pi [rad].

    Returns
    -------
    forward_fraction : float
        Fraction of the scattering below the split angle [1].
    second_moment : float
        Mean square scattering angle below the split angle, sin-weighted and
        renormalized [rad^2].

    Raises
    ------
    ValueError
        If the split angle is outside of its range, or if the phase function is
        negative, not finite, changes the shape, or does not integrate to 1.

    Notes
    -----
    Eqs. (10) and (33) of Ricci et al. 2010, as rederived. Adaptive Gauss-Legendre
    quadrature over the logarithm of the angle from 1e-18 rad, relative error 1e-9;
    steps and kinks are found by halving. Scattering below 1e-18 rad is omitted, which
    for a peak like :math:`\theta^{-1.6}` is less than 1e-7 of the total.

    Examples
    --------
    >>> def isotropic(angle):
    ...     return np.full_like(angle, 1 / (4 * np.pi))
    >>> fraction, moment = forward_split(isotropic, split_angle=np.pi / 2)
    >>> print(f"{fraction:.4f}, {moment:.4f} rad^2")
    0.5000, 1.1416 rad^2
    """
    split = float(checked_split_angle(split_angle))
    forward, moment = _weighted_integrals(phase_function, _SMALLEST_ANGLE, split)
    diffuse = 0.0
    if split < np.pi:
        diffuse, _ = _weighted_integrals(phase_function, split, np.pi)
    total = forward + diffuse
    if not abs(total - 1) < 0.02:
        raise ValueError(
            "phase_function must integrate to 1 over the sphere within 2 %, got "
            f"{total:g}; divide it by its integral, or a volume scattering function "
            "by the scattering coefficient"
        )
    if not forward > 0:
        raise ValueError(
            f"phase_function must scatter something below {split:g} rad, got nothing"
        )
    return forward / total, moment / forward


_SMALLEST_ANGLE = 1e-18


def _weighted_integrals(
    phase_function: Callable[[NDArray[np.float64]], ArrayLike], low: float, high: float
) -> tuple[float, float]:
    """Return solid-angle integrals of a phase function, plain and times angle^2."""
    nodes, weights = gauss_legendre(12)
    tolerance = np.array([1e-11, 1e-11])  # of the whole sphere, and of its fraction
    panels = max(4, int(np.ceil(np.log(high / low))))
    edges = np.linspace(np.log(low), np.log(high), panels + 1)
    lower, upper = edges[:-1], edges[1:]
    total = np.zeros(2)

    def integrate(
        lower: NDArray[np.float64], upper: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        half = (upper - lower)[:, np.newaxis] / 2
        angle = np.exp(lower[:, np.newaxis] + half * (nodes + 1))
        angle = np.clip(angle, low, high)  # exp(log(pi)) is not pi
        flat = angle.ravel()
        value = np.asarray(phase_function(flat), dtype=np.float64)
        if value.shape != flat.shape:
            raise ValueError(
                "phase_function must return one value per angle: "
                f"{flat.shape} angles gave shape {value.shape}"
            )
        not_negative(value, name="phase_function", unit="1/sr")
        fraction = 2 * np.pi * value.reshape(angle.shape) * np.sin(angle) * angle
        fraction *= half * weights
        return np.stack([fraction.sum(axis=1), (fraction * angle**2).sum(axis=1)])

    coarse = integrate(lower, upper)
    for _ in range(60):
        middle = (lower + upper) / 2
        first, second = integrate(lower, middle), integrate(middle, upper)
        fine = first + second
        scale = np.maximum(np.abs(total + fine.sum(axis=1)), 1e-300)
        done = np.all(np.abs(fine - coarse) <= (tolerance * scale)[:, np.newaxis], 0)
        total += fine[:, done].sum(axis=1)
        if np.all(done):
            return float(total[0]), float(total[1])
        lower, upper = (
            np.concatenate([lower[~done], middle[~done]]),
            np.concatenate([middle[~done], upper[~done]]),
        )
        coarse = np.concatenate([first[:, ~done], second[:, ~done]], axis=1)
    raise ValueError(
        "the integral of phase_function does not settle between "
        f"{low:g} and {high:g} rad; give a function that is finite there"
    )


@cache
def gauss_legendre(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Gauss-Legendre nodes and weights on -1..1, cached.

    Parameters
    ----------
    count : int
        Number of points, above zero [1].

    Returns
    -------
    tuple of two ndarrays
        Nodes and weights, shape (count,) [1].

    Notes
    -----
    Exact for polynomials of a degree below twice the number of points.

    Examples
    --------
    Two points integrate x^2 over -1 to 1, 2/3, without error:

    >>> from amulor.optics.phase_functions.integrals import gauss_legendre
    >>> nodes, weights = gauss_legendre(2)
    >>> print(f"{(weights * nodes**2).sum():.6f}")
    0.666667
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights
