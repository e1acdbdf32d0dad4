"""Directions of open-water shots, and polynomials over them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Highest degree of the polynomial over azimuth and elevation.
HIGHEST_DEGREE = 4
#: Shots beyond the coefficients of the polynomial, to judge how much they scatter.
FREEDOM = 4
#: A constant, and enough shots to judge it.
FEWEST_SHOTS = 1 + FREEDOM


@dataclass(frozen=True, kw_only=True)
class Places:
    """Directions of shots on -1 to 1, and which of them are repeats."""

    centre: Floats
    """Azimuth and elevation in the middle [rad]."""
    scale: Floats
    """Half of what they span, 1 where that is nothing [rad]."""
    where: Floats
    """Of every shot, shape (n, 2) [1]."""
    distinct: Floats
    """Of every direction, shape (groups, 2) [1]."""
    group: NDArray[np.intp]
    """Number of the direction of every shot."""
    size: NDArray[np.intp]
    """Shots in every direction."""
    powers: NDArray[np.intp]
    """Exponents that the directions can tell apart, shape (terms, 2)."""

    def scaled(self, direction: Floats) -> Floats:
        """Return directions on the scale of the shots."""
        return np.asarray((direction - self.centre) / self.scale)

    def sum_of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return sums over the shots of each direction."""
        if not np.iscomplexobj(values):
            return np.asarray(np.bincount(self.group, values))
        real, imaginary = (self.sum_of(part) for part in (values.real, values.imag))
        return np.asarray(real + 1j * imaginary)

    def mean_of(self, values: Complex) -> Complex:
        """Return means over the shots of each direction."""
        return np.asarray(self.sum_of(values) / self.size)

    def up_to(self, degree: int) -> NDArray[np.intp]:
        """Return the exponents of a polynomial of some degree."""
        return np.asarray(self.powers[self.powers.sum(axis=1) <= degree])

    def highest(self, shots: int) -> int:
        """Return the highest degree that leaves shots to judge their scatter."""
        order = self.powers.sum(axis=1)
        return max(
            d
            for d in range(int(order.max()) + 1)
            if d == 0 or shots - int(np.sum(order <= d)) >= FREEDOM
        )


def places_of(direction: Floats) -> Places:
    """Return the places of shots; channels of a cube share them.

    Parameters
    ----------
    direction : ndarray, shape (n, 2)
        Azimuth and elevation [rad].

    Returns
    -------
    Places
        Directions within a billionth of the span count as one.
    """
    return _remembered(np.ascontiguousarray(direction).tobytes())


@lru_cache(maxsize=8)
def _remembered(directions: bytes) -> Places:
    direction = np.frombuffer(directions).reshape(-1, 2)
    low, high = direction.min(axis=0), direction.max(axis=0)
    centre, scale = (low + high) / 2, np.where(high > low, (high - low) / 2, 1.0)
    where = (direction - centre) / scale
    distinct, group, size = np.unique(
        np.round(where, 9), axis=0, return_inverse=True, return_counts=True
    )
    count = [len(np.unique(np.round(column, 9))) for column in where.T]
    powers = np.array(
        [
            (i, j)
            for i in range(min(count[0], HIGHEST_DEGREE + 1))
            for j in range(min(count[1], HIGHEST_DEGREE + 1))
            if i + j <= HIGHEST_DEGREE
        ]
    )
    return Places(
        centre=centre,
        scale=scale,
        where=where,
        distinct=distinct,
        group=group.ravel(),
        size=size,
        powers=powers,
    )


def design_of(where: Floats, powers: NDArray[np.intp]) -> Floats:
    """Return the monomials of directions.

    Parameters
    ----------
    where : ndarray, shape (n, 2)
        Directions on -1 to 1 [1].
    powers : ndarray of int, shape (terms, 2)
        Exponents.

    Returns
    -------
    ndarray, shape (n, terms)
        Products of powers [1].
    """
    # Powers by repeated products: a general power costs ten times as much.
    tables = []
    for axis, highest in zip(where.T, powers.max(axis=0), strict=True):
        table = np.ones((int(highest) + 1, len(axis)))
        for power in range(1, int(highest) + 1):
            table[power] = table[power - 1] * axis
        tables.append(table)
    columns: Floats = (tables[0][powers[:, 0]] * tables[1][powers[:, 1]]).T
    return np.ascontiguousarray(columns)
