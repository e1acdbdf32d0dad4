"""Deviation of a scan from a reference, a model or an earlier scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from amulor._discoveries import largest_discovered
from amulor.errors import CubeError
from amulor.imaging.frame import Frame
from amulor.imaging.products.surface import Surface
from amulor.transport.ray_caster import RayCaster

Floats = NDArray[np.float64]

#: Of the pixels called significant, at most this share is so by chance.
FALSE_SHARE = 0.05


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Distances of the vertices of a surface from a reference."""

    value: Floats
    """Distance from the reference along its normal, positive towards the instrument;
    NaN if the beam misses the reference, shape (n,) [m]."""
    uncertainty: Floats
    """Combined standard uncertainty, including an earlier scan's, shape (n,) [m]."""
    own: Floats
    """Part of the uncertainty from noise of single pixels [m]."""
    significant: NDArray[np.bool_]
    """Mask of significant deviations, shape (n,)."""
    surface: Surface
    """Surface of the scan."""
    mean: float
    """Mean deviation [m]."""
    mean_uncertainty: float
    """Standard uncertainty of the mean, including shared errors [m]."""
    spread: float
    """Root mean square deviation about the mean [m]."""

    @property
    def compared(self) -> int:
        """Number of vertices with a deviation [1]."""
        return int(np.isfinite(self.value).sum())


def deviation(
    surface: Surface,
    vertices: Floats,
    faces: NDArray[np.intp],
    *,
    own: Floats | None = None,
    shared: Floats | None = None,
    reference: Frame | None = None,
    farthest: float | None = None,
) -> Deviation:
    r"""Compare a scan with a reference surface.

    Parameters
    ----------
    surface : Surface
        Surface of the scan.
    vertices : ndarray, shape (k, 3)
        Vertices of the reference, in the scan's frame [m].
    faces : ndarray of int, shape (m, 3)
        Triangles of the reference.
    own, shared : ndarray, shape (k,), optional
        Standard uncertainties of the reference along its own beams, independent between
        vertices and common to all; 0 for a model [m].
    reference : Frame, optional
        Frame of an earlier scan. If its pose differs, the errors of both poses are
        added. If the pose is the same, the instrument was not moved, and they cancel.
        By default only the errors of the scan's pose are added.
    farthest : float, optional
        Largest deviation; beyond it the reference is another object and is omitted [m].

    Returns
    -------
    Deviation
        Deviations where the scan's beams, extended to both sides, meet the reference.

    Raises
    ------
    CubeError
        If no beam meets the reference.

    Notes
    -----
    Each beam is extended to the reference, so that the deviation of a pixel depends on
    its own range only: with :math:`\Delta r` the measured less the reference's range,
    beam d and the reference's normal N, the deviation is
    :math:`-\Delta r\,|d \cdot N|`, and :math:`u = |d \cdot N| \sqrt{u_1^2 + u_2^2}`.
    Significance is by Benjamini and Hochberg [1]_: 5 % of the significant pixels are so
    by chance, whatever their number. Beams and model are assumed to be exact, apart
    from the pose.

    References
    ----------
    .. [1] Y. Benjamini, Y. Hochberg, J. R. Stat. Soc. B 57 (1995) 289,
       :doi:`10.1111/j.2517-6161.1995.tb02031.x`.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> surface = imaging.products.surface(image)

    >>> own = imaging.products.deviation(surface, surface.position, surface.triangles)
    >>> bool(own.significant.any()), round(abs(own.mean), 6)  # from itself
    (False, 0.0)
    """
    hit, face = _met(surface, vertices, faces)
    corner = vertices[faces[face]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    start, ahead = surface.position[hit], surface.direction[hit]
    facing = np.einsum("ij,ij->i", ahead, normal)
    off = np.einsum("ij,ij->i", corner[:, 0] - start, normal) / facing
    value = off * np.abs(facing)
    noise = (facing * surface.own[hit]) ** 2
    common = (facing * surface.shared[hit]) ** 2
    if own is not None or shared is not None:
        place = start + off[:, None] * ahead
        weight = _barycentric(corner, place)
        mine = np.zeros(len(vertices)) if own is None else own
        theirs = np.zeros(len(vertices)) if shared is None else shared
        noise += facing**2 * ((weight * mine[faces[face]]) ** 2).sum(axis=1)
        common += (facing * (weight * theirs[faces[face]]).sum(axis=1)) ** 2
    for frame in _poses(surface.frame, reference):
        pose = frame.shared_errors(start)
        common += (np.einsum("kij,ij->ki", pose, normal) ** 2).sum(axis=0)
    near = np.isfinite(value)
    if farthest is not None:
        near &= np.abs(value) <= farthest
    if not near.any():
        raise CubeError(
            "no pixel lies near the reference along its beam; look whether both are in "
            "the same frame (--axes) and unit (--unit), and at --farthest"
        )
    return _result(surface, hit[near], value[near], noise[near], common[near])


def _met(
    surface: Surface, vertices: Floats, faces: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return vertices whose beams hit the reference, and the triangles they hit."""
    caster = RayCaster(vertices[faces])
    place, ahead = surface.position, surface.direction
    # Of surfaces before and behind the measured point the one that is next to it.
    met = np.full(len(place), -1)
    nearest = np.full(len(place), np.inf)
    for direction in (ahead, -ahead):
        triangle = caster.first(place - caster.gap * direction, direction)
        ray = np.flatnonzero(triangle >= 0)
        corner = vertices[faces[triangle[ray]]]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        off = np.einsum("ij,ij->i", corner[:, 0] - place[ray], normal) / np.einsum(
            "ij,ij->i", ahead[ray], normal
        )
        # Nothing behind the instrument is meant.
        near = (np.abs(off) < nearest[ray]) & (off > -_before(surface)[ray])
        met[ray[near]] = triangle[ray[near]]
        nearest[ray[near]] = np.abs(off[near])
    number = np.flatnonzero(met >= 0)
    return number, met[number]


def _poses(frame: Frame, reference: Frame | None) -> tuple[Frame, ...]:
    """Frames whose pose errors enter the comparison of a scan with its reference."""
    if reference is None:
        return (frame,)
    return () if reference.pose == frame.pose else (frame, reference)


def _before(surface: Surface) -> Floats:
    """Distance from the instrument to each measured point [m]."""
    away = surface.position - surface.frame.position
    return np.asarray(np.linalg.norm(away, axis=1))


def _barycentric(corner: Floats, place: Floats) -> Floats:
    """Barycentric coordinates of points in triangles."""
    edge_a, edge_b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    off = place - corner[:, 0]
    a = np.einsum("ij,ij->i", edge_a, edge_a)
    b = np.einsum("ij,ij->i", edge_a, edge_b)
    c = np.einsum("ij,ij->i", edge_b, edge_b)
    x, y = np.einsum("ij,ij->i", off, edge_a), np.einsum("ij,ij->i", off, edge_b)
    below = a * c - b * b
    second, third = (c * x - b * y) / below, (a * y - b * x) / below
    return np.stack([1 - second - third, second, third], axis=1)


def _result(
    surface: Surface,
    hit: NDArray[np.intp],
    value: Floats,
    noise: Floats,
    common: Floats,
) -> Deviation:
    count = len(surface.position)

    def spread_out(values: Floats) -> Floats:
        filled = np.full(count, np.nan)
        filled[hit] = values
        return filled

    sigma = np.sqrt(noise + common)
    significant = np.zeros(count, dtype=bool)
    significant[hit] = _significant(value, sigma)
    mean = float(value.mean())
    shared = float(np.sqrt(common).mean())
    return Deviation(
        value=spread_out(value),
        uncertainty=spread_out(sigma),
        own=spread_out(np.sqrt(noise)),
        significant=significant,
        surface=surface,
        mean=mean,
        mean_uncertainty=float(np.hypot(np.sqrt(noise.sum()) / len(value), shared)),
        spread=float(value.std()),
    )


def _significant(value: Floats, sigma: Floats) -> NDArray[np.bool_]:
    """Mask of significantly nonzero values, at a limited false-discovery rate."""
    with np.errstate(divide="ignore", invalid="ignore"):
        chance = 2 * ndtr(-np.abs(value) / sigma)
    chance = np.where(np.isfinite(chance), chance, 1.0)
    return np.asarray(chance <= largest_discovered(chance, share=FALSE_SHARE))
