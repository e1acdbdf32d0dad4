"""Errors that the pixels of a scan share, as a few shapes of unit variance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube.terms import ALIKE_TERMS, RANGE_PREFIX, WATER_TERMS
from amulor.optics import ranging

Floats = NDArray[np.float64]

#: Shapes kept for the errors of one scan's reference and water; the rest is below ...
_MOST_SHAPES = 24
#: ... this part of the variance of all [1].
_LEFT_OUT = 1e-9
#: Power of the range that terms grow with; late light goes with its square.
_POWER = {"delay": 0.0, "geometry": 0.0, "group_index": 1.0, "late_echo": 2.0}


@dataclass(frozen=True, kw_only=True)
class Shared:
    """Errors of slant ranges that pixels share: each shape times a normal number."""

    keys: tuple[str, ...]
    """Which number each shape is multiplied by; scans with one key share it."""
    shapes: Floats
    """How far one standard deviation moves each range, shape (k, row, column); 0 where
    there is no range [m]."""
    growth: Floats
    """How the shapes change with the range of their pixel, of the same shape [1]."""


def shared_errors(
    image: xr.Dataset, *, scan: str, instrument: str, water: str
) -> Shared:
    r"""Return the errors that the pixels of a scan share.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    scan, instrument, water : str
        What delay and geometry (instrument), group index and late light (water) and all
        the rest (scan) are shared by.

    Returns
    -------
    Shared
        The sum of the outer products of the shapes is the covariance of
        `amulor.imaging.correlation.covariance` without what pixels have by themselves.

    Notes
    -----
    A cosine of the difference of two phases is :math:`\cos a \cos b + \sin a \sin b`,
    so the correlations of reference and water are sums of products of shapes: those of
    the polynomial of the reference times the two parts of each frequency. Principal
    axes of these are few.
    """
    distance = image["slant_range"].values
    there = np.isfinite(distance)
    reach = np.where(there & (distance > 0), distance, 1.0)
    keys: list[str] = []
    shapes: list[Floats] = []
    growth: list[Floats] = []
    of = {"delay": instrument, "geometry": instrument}
    of |= {"group_index": water, "late_echo": water}
    known = np.zeros(distance.shape)
    for name in ALIKE_TERMS:
        if f"{RANGE_PREFIX}{name}" in image:
            term = _filled(image[f"{RANGE_PREFIX}{name}"].values, there)
            known += term**2
            if term.any():
                keys.append(f"{name}: {of[name]}")
                shapes.append(term)
                growth.append(_POWER[name] * term / reach)
    own: list[tuple[Floats, Floats]] = []
    turns = _turns(image, reach)
    for name in WATER_TERMS:
        if f"{RANGE_PREFIX}{name}" in image:
            term = _filled(image[f"{RANGE_PREFIX}{name}"].values, there)
            known += term**2
            own += [(term * turn, term * change) for turn, change in turns]
    if "slant_range_common_uncertainty" in image:
        common = _filled(image["slant_range_common_uncertainty"].values, there) ** 2
        rest = np.sqrt(np.maximum(common - known, 0.0))
        for basis in _basis(image):
            part = rest * basis
            own += [(part * turn, part * change) for turn, change in turns]
    for number, (shape, change) in enumerate(_principal(own)):
        keys.append(f"shape {number + 1}: {scan}")
        shapes.append(shape)
        growth.append(change)
    whole = (len(keys), *distance.shape)
    return Shared(
        keys=tuple(keys),
        shapes=np.array(shapes).reshape(whole),
        growth=np.array(growth).reshape(whole),
    )


def _filled(values: Floats, there: NDArray[np.bool_]) -> Floats:
    return np.where(there & np.isfinite(values), values, 0.0)


def _turns(image: xr.Dataset, distance: Floats) -> list[tuple[Floats, Floats]]:
    """Return the two parts of the phase at each frequency, and their slopes [1, 1/m].

    The squares of the parts add up to 1.
    """
    group_index = float(image["geometry"].attrs["group_index"])
    frequency = np.atleast_1d(image.attrs["modulation_frequencies"])
    parts: list[tuple[Floats, Floats]] = []
    size = 1 / np.sqrt(len(frequency))
    for each in frequency:
        factor = float(ranging.phase_per_range(each, group_index=group_index))
        cosine, sine = np.cos(factor * distance), np.sin(factor * distance)
        parts += [
            (size * cosine, -size * factor * sine),
            (size * sine, size * factor * cosine),
        ]
    return parts


def _basis(image: xr.Dataset) -> list[Floats]:
    """Return the parts of the reference's polynomial, whose squares add up to 1."""
    shape = image["slant_range"].shape
    if "open_water_degree" not in image.attrs:
        return [np.ones(shape)]
    degree = int(np.max(image.attrs["open_water_degree"]))
    axes = []
    for name in ("azimuth", "elevation"):
        values = image[name].values
        span = np.ptp(values)
        axes.append((values - values.mean()) * (2 / span if span > 0 else 0.0))
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    columns = np.stack([(axes[0] ** i * axes[1] ** j).ravel() for i, j in powers], 1)
    basis, singular, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, singular > 1e-9 * singular[0]]
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    return [part.reshape(shape) for part in basis.T]


def _principal(
    shapes: list[tuple[Floats, Floats]],
) -> list[tuple[Floats, Floats]]:
    """Return the principal axes of shapes, strongest first, with their slopes."""
    if not shapes:
        return []
    flat, slopes = (
        np.array([pair[part].ravel() for pair in shapes]) for part in (0, 1)
    )
    energy, axes = np.linalg.eigh(flat @ flat.T)
    kept = np.flatnonzero(energy > _LEFT_OUT * max(float(energy.sum()), 1e-300))
    kept = kept[::-1][:_MOST_SHAPES]
    size = shapes[0][0].shape
    return [
        ((axes[:, at] @ flat).reshape(size), (axes[:, at] @ slopes).reshape(size))
        for at in kept
    ]
