"""Checks of the numbers and vectors in a transport problem."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray


def at_least(value: float, limit: float, *, name: str, unit: str) -> float:
    """Return a number as float; ValueError if below a limit or not finite."""
    number = float(value)
    if not (math.isfinite(number) and number >= limit):
        raise ValueError(f"{name} must be at least {limit:g} {unit}, got {value!r}")
    return number


def above(value: float, limit: float, *, name: str, unit: str) -> float:
    """Return a number as float; ValueError unless above a limit and finite."""
    number = float(value)
    if not (math.isfinite(number) and number > limit):
        raise ValueError(f"{name} must be above {limit:g} {unit}, got {value!r}")
    return number


def at_most(value: float, limit: float, *, name: str, unit: str) -> float:
    """Return a number as float; ValueError unless above 0 and at most the limit."""
    number = above(value, 0.0, name=name, unit=unit)
    if number > limit:
        raise ValueError(f"{name} must not exceed {limit:g} {unit}, got {value!r}")
    return number


def place(value: ArrayLike, *, name: str) -> NDArray[np.float64]:
    """Return a position (right, down, forward) as array; ValueError unless finite."""
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(
            f"{name} must be three finite numbers (right, down, forward), got {value!r}"
        )
    return vector


def unit_vector(value: ArrayLike, *, name: str) -> NDArray[np.float64]:
    """Return a vector (right, down, forward) normalized to unit length."""
    vector = place(value, name=name)
    norm = float(np.linalg.norm(vector))
    if norm == 0:
        raise ValueError(f"{name} must have a length above zero")
    result: NDArray[np.float64] = vector / norm
    return result


def axes_of(direction: NDArray[np.float64], *, name: str) -> NDArray[np.float64]:
    """Return right, down and forward unit vectors of a view along a direction, as rows.

    The first axis is the part of "right" that is perpendicular to the direction.
    """
    right = np.array([1.0, 0.0, 0.0])
    right = right - (right @ direction) * direction
    norm = float(np.linalg.norm(right))
    if norm < 1e-6:
        raise ValueError(
            f"{name} must not lie along the axis to the right, from which the angle "
            "of polarization is counted"
        )
    right = right / norm
    return np.stack([right, np.cross(direction, right), direction])
