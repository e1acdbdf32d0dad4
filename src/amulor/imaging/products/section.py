"""Sections of a surface along a line of a drawing, with uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import CubeError
from amulor.imaging.products.surface import Plane, Surface

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Section:
    """Section through a surface, as one or more continuous lines."""

    along: Floats
    """Distance from the start of the section line, shape (n,) [m]."""
    height: Floats
    """Height towards the viewer above the frame's origin, shape (n,) [m]."""
    uncertainty: Floats
    """Combined standard uncertainty, perpendicular to the profile, shape (n,) [m]."""
    own: Floats
    """Part of the uncertainty from noise of single pixels [m]."""
    piece: NDArray[np.intp]
    """Number of each point's piece, shape (n,) [1]."""
    start: tuple[float, float]
    """Start of the section line, right and up in the drawing [m]."""
    end: tuple[float, float]
    """End of the section line [m]."""
    plane: Plane
    """Drawing plane."""
    surface: Surface
    """Surface of the section."""


def section(
    surface: Surface, plane: Plane, *, start: ArrayLike, end: ArrayLike
) -> Section:
    r"""Cut a surface along a line of a drawing, perpendicular to the drawing plane.

    Parameters
    ----------
    surface : Surface
        Vertices and triangles.
    plane : Plane
        Drawing plane.
    start, end : array_like, shape (2,)
        Ends of the line, right and up [m].

    Returns
    -------
    Section
        Points at which the cut crosses triangle edges, in order along each piece.

    Raises
    ------
    CubeError
        If the line meets no surface, or has no length.

    Notes
    -----
    A point between the pixels i and j is their mean with weights w; its range errors
    shift the profile perpendicular to itself by
    :math:`g = d \cdot N / \sqrt{1 - (N \cdot q)^2}` with the beam d, the normal N and
    the normal q of the cutting plane.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> surface = imaging.products.surface(image)
    >>> plane = imaging.products.plane_of(surface.frame)
    >>> ends = {"start": (-0.05, 0.0), "end": (0.05, 0.0)}
    >>> cut = imaging.products.section(surface, plane, **ends)
    >>> print(f"{cut.along.size} points, {np.ptp(cut.height) * 1e3:.0f} mm deep")
    179 points, 93 mm deep
    """
    first, last = (np.asarray(v, dtype=float) for v in (start, end))
    length = float(np.linalg.norm(last - first))
    if not length > 0:
        raise CubeError("the line of the section has no length; give two points apart")
    along = (last - first) / length
    flat = surface.position @ plane.axes.T
    side = (flat[:, :2] - first) @ np.array([-along[1], along[0]])
    sides, neighbours = _crossed(surface.triangles, side)
    if not len(sides):
        raise CubeError(_missed(surface, flat, first, last))
    i, j = sides.T
    share = side[i] / (side[i] - side[j])
    points = (1 - share)[:, None] * flat[i] + share[:, None] * flat[j]
    distance = (points[:, :2] - first) @ along
    across = plane.axes[:2].T @ np.array([-along[1], along[0]])
    gain = _gain(surface, across)
    pixel_noise = np.hypot(
        (1 - share) * gain[i] * surface.own[i], share * gain[j] * surface.own[j]
    )
    shared = (1 - share) * gain[i] * surface.shared[i]
    shared += share * gain[j] * surface.shared[j]
    pose = _pose_errors(surface, points @ plane.axes, plane, along)
    values = np.stack(
        [
            distance,
            points[:, 2],
            np.sqrt(pixel_noise**2 + shared**2 + pose),
            pixel_noise,
        ]
    )
    values, neighbours = _with_ends(values, neighbours, length)
    inside = (values[0] >= -1e-12) & (values[0] <= length + 1e-12)
    order, piece = _pieces(neighbours, inside, values[0])
    if not len(order):
        raise CubeError(_missed(surface, flat, first, last))
    along_it, height, sigma, noise = values[:, order]
    return Section(
        along=along_it,
        height=height,
        uncertainty=sigma,
        own=noise,
        piece=piece,
        start=(float(first[0]), float(first[1])),
        end=(float(last[0]), float(last[1])),
        plane=plane,
        surface=surface,
    )


def _crossed(
    triangles: NDArray[np.intp], side: Floats
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Triangle edges that the section crosses, and their pairs within each triangle.

    A vertex on the cut counts as beyond it, so that every crossed triangle has two.
    """
    beyond = side >= 0
    cut = triangles[np.ptp(beyond[triangles].astype(int), axis=1) > 0]
    edges = np.stack([cut, np.roll(cut, -1, axis=1)], axis=-1)
    differs = beyond[edges[..., 0]] != beyond[edges[..., 1]]
    pairs = np.sort(edges[differs].reshape(-1, 2), axis=1)
    if not len(pairs):
        return pairs, pairs
    unique, place = np.unique(pairs, axis=0, return_inverse=True)
    return unique, np.asarray(place).reshape(-1, 2)


def _with_ends(
    values: Floats, neighbours: NDArray[np.intp], length: float
) -> tuple[Floats, NDArray[np.intp]]:
    """Section points and connections, cut off at both ends of the line."""
    for end in (0.0, length):
        off = values[0][neighbours] - end
        passing = off[:, 0] * off[:, 1] < 0
        i, j = neighbours[passing].T
        share = off[passing, 0] / (off[passing, 0] - off[passing, 1])
        added = values[:, i] * (1 - share) + values[:, j] * share
        added[0] = end
        numbers = values.shape[1] + np.arange(len(i))[:, None]
        outside = off[passing] < 0 if end == 0 else off[passing] > 0
        neighbours = neighbours.copy()
        neighbours[passing] = np.where(outside, numbers, neighbours[passing])
        values = np.concatenate([values, added], axis=1)
    return values, neighbours


def _pieces(
    neighbours: NDArray[np.intp], inside: NDArray[np.bool_], distance: Floats
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Section points ordered along continuous pieces, with piece numbers."""
    joined: dict[int, list[int]] = {}
    for first, second in neighbours.tolist():
        if inside[first] and inside[second]:
            joined.setdefault(first, []).append(second)
            joined.setdefault(second, []).append(first)
    lines: list[list[int]] = []
    remaining = set(joined)
    # Open pieces first; the remaining pieces are closed.
    starts = sorted(remaining, key=lambda p: (len(joined[p]) != 1, distance[p]))
    for begin in starts:
        if begin not in remaining:
            continue
        line, current = [begin], begin
        remaining.discard(begin)
        while True:
            onward = [p for p in joined[current] if p in remaining]
            if not onward:
                break
            current = onward[0]
            remaining.discard(current)
            line.append(current)
        if len(line) > 2 and begin in joined[line[-1]]:
            line.append(begin)
        lines.append(line)
    lines.sort(key=lambda line: float(distance[line].min()))
    order = np.array([p for line in lines for p in line], dtype=np.intp)
    piece = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    return order, piece


def _gain(surface: Surface, across: Floats) -> Floats:
    """Displacement of the profile, perpendicular to itself, per unit of range [1]."""
    normal = surface.normal
    towards = np.einsum("ij,ij->i", surface.direction, normal)
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = towards / np.sqrt(1 - (normal @ across) ** 2)
    return np.asarray(np.clip(np.where(np.isfinite(gain), gain, 1.0), -20.0, 20.0))


def _pose_errors(
    surface: Surface, points: Floats, plane: Plane, along: Floats
) -> Floats:
    """Variance of section points from pose errors, within the section plane [m^2]."""
    shifts = surface.frame.shared_errors(points) @ plane.axes.T
    return np.asarray(
        ((shifts[..., :2] @ along) ** 2 + shifts[..., 2] ** 2).sum(axis=0)
    )


def _missed(surface: Surface, flat: Floats, first: Floats, last: Floats) -> str:
    used = flat[np.unique(surface.triangles), :2]
    low, high = used.min(axis=0), used.max(axis=0)
    return (
        f"the line from ({first[0]:g}, {first[1]:g}) to ({last[0]:g}, {last[1]:g}) m "
        f"meets no surface, which reaches from ({low[0]:.3f}, {low[1]:.3f}) to "
        f"({high[0]:.3f}, {high[1]:.3f}) m"
    )
