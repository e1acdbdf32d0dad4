"""Meshes of a wreck: a sea bed with ripples, planks, amphorae, an anchor, spheres."""

from __future__ import annotations

import numpy as np
import trimesh


def sea_bed(
    size: float = 4.0, step: float = 0.02, *, relief: float = 0.03
) -> trimesh.Trimesh:
    """Return a sea bed in the plane z = 0 with ripples and humps [m]."""
    axis = np.arange(-size / 2, size / 2 + step / 2, step)
    x, y = np.meshgrid(axis, axis)
    z = relief * (
        0.5 * np.sin(2.1 * x + 0.6) * np.cos(1.7 * y - 0.3)
        + 0.3 * np.sin(4.3 * y + 1.1 * x)
        + 0.2 * np.cos(5.9 * x - 2.3 * y)
    )
    return grid_mesh(x, y, z)


def grid_mesh(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> trimesh.Trimesh:
    """Return the surface through a grid of points."""
    numbers = np.arange(x.size).reshape(x.shape)
    a, b = numbers[:-1, :-1].ravel(), numbers[:-1, 1:].ravel()
    c, d = numbers[1:, :-1].ravel(), numbers[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    return trimesh.Trimesh(points, faces, process=False)


def revolved(
    radius: np.ndarray, along: np.ndarray, *, around: int = 96
) -> trimesh.Trimesh:
    """Return a body of revolution about x, with radii at places along it [m]."""
    angle = np.linspace(0, 2 * np.pi, around + 1)
    r, t = np.meshgrid(radius, angle)
    x, _ = np.meshgrid(along, angle)
    mesh = grid_mesh(x, r * np.cos(t), r * np.sin(t))
    mesh.merge_vertices()
    return mesh


def amphora(length: float = 0.8) -> trimesh.Trimesh:
    """Return an amphora that lies along x, its middle at the origin [m]."""
    part = np.array(
        [0.0, 0.02, 0.06, 0.15, 0.3, 0.45, 0.6, 0.7, 0.76, 0.8, 0.9, 0.97, 1.0]
    )
    radius = np.array(
        [
            0.0,
            0.03,
            0.05,
            0.1,
            0.155,
            0.18,
            0.165,
            0.12,
            0.075,
            0.055,
            0.055,
            0.068,
            0.06,
        ]
    )
    from scipy.interpolate import PchipInterpolator

    fine = np.linspace(0, 1, 90)
    return revolved(
        PchipInterpolator(part, radius)(fine) * length / 0.8, (fine - 0.5) * length
    )


def planks(width: float = 1.6, count: int = 5) -> trimesh.Trimesh:
    """Return the curved side of a hull, of planks that stand off each other [m]."""
    along = np.linspace(-width / 2, width / 2, 120)
    across = np.linspace(0, 1, 40 * count)
    u, v = np.meshgrid(along, across)
    lap = 0.012 * (v * count - np.floor(v * count))
    x = u
    y = 0.55 * v + 0.1 * u**2
    z = 0.45 * v**1.6 + lap + 0.02 * np.cos(2.5 * u)
    return grid_mesh(x, y, z)


def anchor() -> trimesh.Trimesh:
    """Return an anchor that lies on its side: shank, stock, two arms [m]."""
    parts = [
        revolved(np.full(40, 0.035), np.linspace(-0.5, 0.5, 40), around=48),
    ]
    stock = revolved(np.full(30, 0.03), np.linspace(-0.3, 0.3, 30), around=48)
    stock.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1]))
    stock.apply_translation([0.42, 0, 0.02])
    parts.append(stock)
    angle = np.linspace(-1.1, 1.1, 60)
    centre = np.stack([-0.5 + 0.4 * (1 - np.cos(angle)), 0.4 * np.sin(angle)], axis=1)
    ring = np.linspace(0, 2 * np.pi, 37)
    t, r = np.meshgrid(np.arange(60), ring)
    outward = np.stack([-np.cos(angle), np.sin(angle)], axis=1)
    radius = 0.03 * (1 - 0.5 * np.abs(angle / 1.1) ** 3)
    x = centre[t, 0] + radius[t] * np.cos(r) * outward[t, 0]
    y = centre[t, 1] + radius[t] * np.cos(r) * outward[t, 1]
    z = radius[t] * np.sin(r)
    parts.append(grid_mesh(x, y, z))
    return trimesh.util.concatenate(parts)


def turned(
    mesh: trimesh.Trimesh,
    place: tuple[float, float, float],
    heading: float = 0.0,
    tilt: float = 0.0,
) -> trimesh.Trimesh:
    """Return a mesh turned about its y by `tilt`, then about z, then moved [rad, m]."""
    mesh = mesh.copy()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(tilt, [0, 1, 0]))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(heading, [0, 0, 1]))
    mesh.apply_translation(place)
    return mesh
