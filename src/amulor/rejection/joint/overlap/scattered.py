"""Light that was scattered on its way, for any strength and width of the scattering."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev, legendre
from numpy.typing import NDArray
from scipy.special import j0

from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.rejection.joint._kernels import scattered as kernels

Floats = NDArray[np.float64]

#: Steps of asinh(z / length) between the nodes of depth, and the farthest node [m].
_STEP, _FARTHEST = 0.04, 2.2e3
#: Edges of panels of the spatial frequency, times the width of the view, with nodes
#: each, and the turn of the oscillations that one panel follows [rad].
_PANELS = np.array([0, 0.02, 0.06, 0.15, 0.4, 0.9, 1.8, 3.2, 5.0, 7.0, 10.0])
_NODES, _PHASE = 10, 18.0
#: Widths of the view beyond which no scattered light is counted [1].
_ASIDE = 20.0
#: Terms of the series over ln(1 + q) for each unit of it, and as many more.
_PER_UNIT, _FEWEST = 9, 8
#: Cells of the table of what is lost over the logarithm of x, for each unit of it,
#: and between which x [1/rad].
_CELLS, _LOWEST, _HIGHEST = 8, 0.02, 3e3


class Scattered:
    """Light that was scattered forward, by the small-angle form (29).

    Parameters
    ----------
    function : PhaseFunction
        Its forward part gives the shape.
    split_angle : float
        Where that ends [rad].
    radius, angle : float
        1/e radius [m] and semi-angle of receiver and beam together [rad].
    standoff : float
        Path in front of the water, as a depth of water [m].
    """

    def __init__(
        self,
        function: PhaseFunction,
        split_angle: float,
        *,
        radius: float,
        angle: float,
        standoff: float,
    ) -> None:
        self.function, self.split_angle = function, split_angle
        #: Fraction of the forward part, and its mean square angle as it is [rad^2].
        self.fraction, self.moment = function.forward_split(split_angle)
        self._lost = _lost(function, split_angle)
        self._length = max(0.5 * radius / angle, 1e-3)
        count = int(np.ceil(np.arcsinh(_FARTHEST / self._length) / _STEP))
        depth = self._length * np.sinh(_STEP * np.arange(1, count + 1))
        #: Nodes of depth [m].
        self.depth: Floats = depth
        self._path = depth + standoff
        self._area = radius**2 + (angle * self._path) ** 2
        self._peak = np.pi * (radius * angle) ** 2
        self._low, self._high = np.empty(0), np.empty(0)
        self._known: tuple[float, float, Floats] | None = None

    def light(
        self, depth: Floats, *, forward_scattering: float, spread: float, offset: Floats
    ) -> Floats:
        """Return the overlap of scattered light, without reduced attenuation [sr].

        Parameters
        ----------
        depth : ndarray, shape (n,)
            Where it turns back [m].
        forward_scattering : float
            Forward scattering b_f [1/m].
        spread : float
            Growth of its mean square angle: the phase function is stretched to have
            it [rad^2/m].
        offset : ndarray, shape (direction, node)
            Distance of beam and axis of the receiver at the nodes of `depth` [m].

        Returns
        -------
        ndarray, shape (direction, n)
            Eq. (29) of Ricci et al. 2010, as rebuilt, less unscattered light.
        """
        aside = np.log1p(offset**2 / self._area)
        self._reach(aside)
        terms = self._terms(forward_scattering, spread)
        at_nodes = np.empty(offset.shape)
        place = (2 * aside - self._low - self._high) / (self._high - self._low)
        kernels.along(np.clip(place, -1, 1), terms, at_nodes)
        at_nodes[offset > _ASIDE * np.sqrt(self._area)] = 0.0
        out = np.empty((len(offset), depth.size))
        where = np.arcsinh(depth / self._length) / _STEP
        # Nothing is scattered before the water begins.
        begun = np.concatenate([np.zeros((len(offset), 1)), at_nodes], axis=1)
        kernels.between(begun, where, out)
        return np.maximum(out, 0.0)

    def _terms(self, forward_scattering: float, spread: float) -> Floats:
        """Return the series over the offset at every node of depth, or the last one."""
        known = self._known
        if known is not None and known[:2] == (forward_scattering, spread):
            return known[2]
        stretch = 0.5 * np.log(spread / (forward_scattering * self.moment))
        thickness = 2 * forward_scattering * self.depth
        terms = np.empty(self._rule.shape[:2])
        kernels.series(
            thickness, self._place, stretch * _CELLS, self._lost, self._rule, terms
        )
        self._known = forward_scattering, spread, terms
        return terms

    def _reach(self, aside: Floats) -> None:
        """Make the rule anew where beams are further aside than it reaches."""
        low, high = aside.min(axis=0), aside.max(axis=0)
        if self._low.size and np.all((low >= self._low) & (high <= self._high)):
            return
        spare = 0.1 + 0.5 * (high - low)
        if self._low.size:
            low, high = np.minimum(low, self._low), np.maximum(high, self._high)
        most = np.log1p(_ASIDE**2)
        self._low = np.clip(low - spare, 0, most - 0.1)
        self._high = np.minimum(high + spare, most)
        self._make_rule()

    def _make_rule(self) -> None:
        """Set the nodes of the spatial frequency, and what they weigh in each term."""
        width = self._high - self._low
        count = _FEWEST + int(np.ceil(_PER_UNIT * width.max()))
        place = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        aside = self._low[:, None] + 0.5 * width[:, None] * (place + 1)
        # In widths of the view.
        offset = np.sqrt(np.expm1(aside))
        rate, weight = _frequencies(float(offset.max()))
        self._place = (
            np.log(rate * (self.depth / np.sqrt(self._area))[:, None] / _LOWEST)
            * _CELLS
        )
        weight = 0.5 * weight * rate * np.exp(-(rate**2) / 4)
        value = j0(offset[:, :, None] * rate) * weight
        value *= (self._peak / self._area)[:, None, None]
        series = chebyshev.chebvander(place, count - 1) * 2 / count
        series[:, 0] /= 2
        self._rule = np.ascontiguousarray(series.T @ value)
        self._known = None


def _frequencies(aside: float) -> tuple[Floats, Floats]:
    """Return nodes and weights of the spatial frequency, times the width of the view.

    For beams that are up to so many widths of the view aside.
    """
    edges = [np.zeros(1)]
    for low, high in itertools.pairwise(_PANELS):
        parts = max(int(np.ceil((high - low) * aside / _PHASE)), 1)
        edges.append(np.linspace(low, high, parts + 1)[1:])
    edge = np.concatenate(edges)
    node, weight = legendre.leggauss(_NODES)
    half = 0.5 * np.diff(edge)[:, None]
    rate = edge[:-1, None] + half * (node + 1)
    return rate.ravel(), (half * weight).ravel()


@lru_cache(maxsize=8)
def _lost(function: PhaseFunction, split_angle: float) -> Floats:
    """Return the logarithm of 1 less the mean transform up to x, over ln x."""
    count = int(np.ceil(np.log(_HIGHEST / _LOWEST) * _CELLS)) + 1
    edge = _LOWEST * np.exp(np.arange(count) / _CELLS)
    node, weight = legendre.leggauss(2)
    half = 0.5 * np.diff(edge)[:, None]
    x = edge[:-1, None] + half * (node + 1)
    flat = function.hankel(x.ravel(), split_angle=split_angle).reshape(x.shape)
    part = ((1 - flat) * weight * half).sum(axis=1)
    # In front of the first node it grows with the square.
    start = (1 - flat[0, 0]) * edge[0] ** 3 / x[0, 0] ** 2 / 3
    total = start + np.append(0.0, np.cumsum(part))
    found: Floats = np.log(total / edge)
    return found
