"""Polarized light in a layer with reflecting faces, by coherency matrices.

A layer of Rayleigh scatterers from z = 0 to `thickness` is lit from above, z < 0, by
plane waves at an angle of incidence in the plane of x and z. Lengths are in units of
the mean free path. Both faces reflect and refract by Fresnel's formulas; the upper one
may be rough.

Light is a coherency matrix, the 3 x 3 mean of E E^H in x, y and z. Stokes vectors,
Mueller matrices and axes that travel with the photon are not used:

- A scatterer is a dipole. Seen along m it radiates the field P E, P = 1 - m m^T.
- A plane multiplies the field along and across the plane of incidence by Fresnel's
  ratios, which are complex in total reflection. The across field is along n x normal.

The rough face is the model of Heitz et al. (2016): facets at random heights, here with
an even distribution of heights from 0 to 1, without a relation between a facet's height
and slope. A ray meets it in short steps: within a step in which the height changes by
dh at the height h, it meets a facet with the chance Lambda dh / h, where h is also the
fraction of heights below. The slopes of a facet are drawn from a normal distribution by
rejection, with a chance that is proportional to the facet's area across the ray.

Nothing is shared with the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Array = NDArray[Any]


@dataclass(frozen=True)
class Layer:
    """Layer and its faces."""

    albedo: float = 1.0
    thickness: float = 1.0
    near: float = 1.0  # index inside over outside
    far: float = 1.0
    slope: float = 0.0  # of the near face, root mean square along one axis


def fields_of(stokes: Array, direction: Array) -> Array:
    """Return coherency matrices of Stokes vectors; the parallel axis is in x and z.

    Field ratios for exp(-i omega t): I, Q = |Ep|^2 +- |Es|^2, U + i V = 2 Ep Es^*.
    """
    i, q, u, v = stokes
    along, across = meridian(direction)
    p, s = along[..., :, None], across[..., :, None]
    cross = (u + 1j * v) / 2 * p * np.conj(np.swapaxes(s, -1, -2))
    return (
        (i + q) / 2 * p * np.swapaxes(p, -1, -2)
        + (i - q) / 2 * s * np.swapaxes(s, -1, -2)
        + cross
        + np.conj(np.swapaxes(cross, -1, -2))
    )


def meridian(n: Array) -> tuple[Array, Array]:
    """Return unit vectors along and across the plane of a direction and z."""
    flat = np.hypot(n[..., 0], n[..., 1])
    upright = flat < 1e-9
    safe = np.where(upright, 1.0, flat)
    x = np.where(upright, 1.0, n[..., 0] / safe)
    y = np.where(upright, 0.0, n[..., 1] / safe)
    along = np.stack([n[..., 2] * x, n[..., 2] * y, -flat], -1)
    return along, np.stack([-y, x, 0 * x], -1)


def stokes_of(field: Array, n: Array) -> Array:
    """Return the Stokes vectors of coherency matrices in the meridian plane."""
    p, s = meridian(n)
    pp = np.einsum("ni,nij,nj->n", p, field, p).real
    ss = np.einsum("ni,nij,nj->n", s, field, s).real
    ps = np.einsum("ni,nij,nj->n", p, field, s)
    return np.stack([pp + ss, pp - ss, 2 * ps.real, 2 * ps.imag])


def trace(field: Array) -> Array:
    """Return the light of coherency matrices."""
    total: Array = np.einsum("nii->n", field).real
    return total


def at_plane(
    n: Array, field: Array, normal: Array, ratio: Array, random: Any
) -> tuple[Array, Array, Array]:
    """Reflect or refract light at planes; return what passed, direction and field.

    `ratio` is the index of the light's medium over that behind the plane.
    """
    cosine = -np.sum(n * normal, axis=-1)
    across = np.cross(n, normal)
    size = np.linalg.norm(across, axis=-1)
    _, other = meridian(n)
    across = np.where(
        size[:, None] > 1e-9, across / np.maximum(size, 1e-9)[:, None], other
    )
    behind = np.sqrt(1 - (ratio**2 * (1 - cosine**2)).astype(complex))
    # The square root of a negative number is +i kappa, which fades behind the plane.
    r_across = (ratio * cosine - behind) / (ratio * cosine + behind)
    r_along = (cosine - ratio * behind) / (cosine + ratio * behind)
    t_across = 2 * ratio * cosine / (ratio * cosine + behind)
    t_along = 2 * ratio * cosine / (cosine + ratio * behind)
    mirrored = n + 2 * cosine[:, None] * normal
    bent = ratio[:, None] * n + (ratio * cosine - behind.real)[:, None] * normal
    passes = np.empty(len(n), dtype=bool)
    light = trace(field)

    def turned(after: Array, along: Array, side: Array) -> Array:
        """Return fields with new ratios and directions."""
        before, now = np.cross(across, n), np.cross(across, after)
        # A field along `before` becomes one along `now`, one across stays across.
        matrix = along[:, None, None] * now[:, :, None] * before[:, None, :]
        matrix = matrix + side[:, None, None] * across[:, :, None] * across[:, None, :]
        result: Array = matrix @ field @ np.conj(np.swapaxes(matrix, 1, 2))
        return result

    reflected = turned(mirrored, r_along, r_across)
    passes = random.random(len(n)) * light >= trace(reflected)
    after = np.where(passes[:, None], bent, mirrored)
    after /= np.linalg.norm(after, axis=-1)[:, None]
    through = turned(after, t_along, t_across)
    result = np.where(passes[:, None, None], through, reflected)
    result *= (light / trace(result))[:, None, None]
    return passes, after, result


def shadow(cotangent: Array, slope: float) -> Array:
    """Return Smith's Lambda of rising directions for normal slopes."""
    a = np.maximum(cotangent, 1e-6) / (np.sqrt(2) * slope)
    result: Array = (erf(a) - 1) / 2 + np.exp(-a * a) / (2 * a * np.sqrt(np.pi))
    return result


def facets(n: Array, slope: float, random: Any) -> Array:
    """Draw normals (with z > 0) of facets that rays along n meet from above."""
    normal = np.zeros_like(n)
    open_ = np.arange(len(n))
    # No slope beyond nine standard deviations is drawn.
    most = np.maximum(-n[:, 2], 0) + 9 * slope * np.hypot(n[:, 0], n[:, 1]) + 1e-12
    while open_.size:
        drawn = slope * random.standard_normal((open_.size, 2))
        vector = np.concatenate([-drawn, np.ones((open_.size, 1))], 1)
        area = -np.sum(n[open_] * vector, 1)
        taken = random.random(open_.size) * most[open_] < area
        unit = vector[taken] / np.linalg.norm(vector[taken], axis=1)[:, None]
        normal[open_[taken]] = unit
        open_ = open_[~taken]
    return normal


def at_face(
    n: Array, field: Array, inside: bool, index: float, slope: float, up: float,
    random: Any, *, steps: int = 60,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Follow light at a face; return whether it is inside, its direction and field.

    `up` is the direction out of the layer along z. Here z counts along it.
    """
    n = n * [1.0, 1.0, up]
    field = field * np.outer([1, 1, up], [1, 1, up])
    within = np.full(len(n), inside)
    height = np.where(within, 0.0, 1.0)
    open_ = np.arange(len(n))
    while open_.size:
        ray = n[open_]
        side = np.where(within[open_], -1.0, 1.0)  # +1 above the face
        # Seen from its own side, a ray falls towards the face if own_z < 0.
        own_z = side * ray[:, 2]
        leaves = own_z > 0
        met = np.where(within[open_], 0.0, 1.0)
        if slope > 0:
            lower = np.where(side > 0, height[open_], 1 - height[open_])
            flat = np.sqrt(1 - np.minimum(own_z**2, 1)) + 1e-12
            rising = shadow(np.abs(own_z) / flat, slope)
            strength = np.where(own_z > 0, rising, 1 + rising)
            meets = np.zeros(open_.size, dtype=bool)
            at = lower.copy()
            # Steps of an equal ratio; a rising ray leaves at 1.
            for _ in range(40 * steps):
                active = ~meets & (at < 1 - 1e-9) | ~meets & (own_z <= 0)
                if not active.any():
                    break
                change = np.where(own_z > 0, np.minimum(at / steps, 1 - at), at / steps)
                middle = at + np.sign(own_z) * change / 2
                # The chance over a short step at its middle.
                chance = -np.expm1(-strength * change / middle)
                now = active & (random.random(open_.size) < chance)
                at = np.where(active, at + np.sign(own_z) * change, at)
                at = np.where(now, middle, at)
                meets |= now
                lower = np.where(now, middle, lower)
            leaves = ~meets & (own_z > 0)
            met = np.where(side > 0, lower, 1 - lower)
        height[open_] = met
        open_, ray, side = open_[~leaves], ray[~leaves], side[~leaves]
        if not open_.size:
            break
        own = ray * np.stack([0 * side + 1, 0 * side + 1, side], 1)
        normal = (
            facets(own, slope, random)
            if slope > 0
            else np.tile([0.0, 0.0, 1.0], (open_.size, 1))
        )
        normal = normal * np.stack([0 * side + 1, 0 * side + 1, side], 1)
        ratio = np.where(side > 0, 1 / index, index)
        passes, n[open_], field[open_] = at_plane(
            ray, field[open_], normal, ratio, random
        )
        within[open_] ^= passes
    return within, n * [1.0, 1.0, up], field * np.outer([1, 1, up], [1, 1, up])


def light(
    layer: Layer, *, incidence: float, stokes: Any, photons: int, seed: int
) -> tuple[Array, Array, Array, Array]:
    """Return side, direction, Stokes vector and path length of all photons that leave.

    The side is 0 for reflected and 1 for transmitted light; the light of a photon is 1.
    """
    random = np.random.default_rng(seed)
    n = np.tile([np.sin(incidence), 0.0, np.cos(incidence)], (photons, 1))
    field = fields_of(np.asarray(stokes, dtype=float), n)
    results: list[tuple[Array, Array, Array, Array]] = []
    within, n, field = at_face(n, field, False, layer.near, layer.slope, -1.0, random)
    z, length = np.zeros(photons), np.zeros(photons)

    def leave(which: Array, side: int) -> None:
        """Record photons and keep the others."""
        nonlocal n, field, z, length
        vector = stokes_of(field[which], n[which])
        sides = np.full(which.sum(), side)
        results.append((sides, n[which], vector.T, length[which]))
        n, field, z, length = n[~which], field[~which], z[~which], length[~which]

    leave(~within, 0)
    while len(n):
        way = random.exponential(size=len(n))
        to_face = np.where(n[:, 2] > 0, layer.thickness - z, z) / np.maximum(
            np.abs(n[:, 2]), 1e-12
        )
        hits = to_face < way
        length = length + np.minimum(way, to_face)
        z = np.where(
            hits, np.where(n[:, 2] > 0, layer.thickness, 0.0), z + way * n[:, 2]
        )
        # Collisions: absorption, or a dipole that radiates along m.
        dies = ~hits & (random.random(len(n)) >= layer.albedo)
        m = n.copy()
        open_ = np.flatnonzero(~hits & ~dies)
        while open_.size:
            vector = random.standard_normal((open_.size, 3))
            vector /= np.linalg.norm(vector, axis=1)[:, None]
            seen = (
                trace(field[open_])
                - np.einsum("ni,nij,nj->n", vector, field[open_], vector).real
            )
            taken = random.random(open_.size) * trace(field[open_]) < seen
            m[open_[taken]] = vector[taken]
            open_ = open_[~taken]
        scattered = ~hits & ~dies
        project = np.eye(3) - m[:, :, None] * m[:, None, :]
        radiated = project @ field @ project
        before = trace(field)
        field = np.where(scattered[:, None, None], radiated, field)
        field *= (before / trace(field))[:, None, None]
        n = np.where(scattered[:, None], m, n)
        gone, heading = np.zeros(len(n), dtype=int), n[:, 2].copy()
        for up, index, slope, code in (
            (-1.0, layer.near, layer.slope, 1),
            (1.0, layer.far, 0.0, 2),
        ):
            at = np.flatnonzero(hits & (heading * up > 0))
            if at.size == 0:
                continue
            if index == 1.0:
                gone[at] = code
                continue
            stays, n[at], field[at] = at_face(
                n[at], field[at], True, index, slope, up, random
            )
            gone[at[~stays]] = code
        keep = ~dies
        n, field, z, length = n[keep], field[keep], z[keep], length[keep]
        gone = gone[keep]
        for code in (1, 2):
            leave(gone == code, code - 1)
            gone = gone[gone != code]
    return tuple(np.concatenate(part) for part in zip(*results, strict=True))  # type: ignore[return-value]
