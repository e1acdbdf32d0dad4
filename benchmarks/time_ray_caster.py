"""The ray caster: hierarchy of a mesh and a scan of it, beside embree if it is there.

Seconds are CPU time. embree was measured through trimesh and embreex before amulor left
it; ``pip install embreex trimesh`` brings its rows back.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from amulor.transport.ray_caster import RayCaster

#: Cells along each side of the sphere, for 100,000 and a million triangles.
CELLS = (226, 708)
SIDE = 1000


def wavy_sphere(cells: int) -> np.ndarray:
    """Return the corners of the triangles of a sphere with waves, 3 m ahead [m]."""
    u, v = np.meshgrid(
        np.linspace(0, 2 * np.pi, cells + 1),
        np.linspace(0.01, np.pi - 0.01, cells + 1),
        indexing="ij",
    )
    radius = 1 + 0.05 * np.sin(9 * u) * np.sin(7 * v)
    place = radius[..., None] * np.stack(
        [np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1
    )
    place[..., 2] += 3
    a, b, c, d = place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]
    halves = [
        np.stack(half, axis=-2).reshape(-1, 3, 3) for half in ((a, b, c), (a, c, d))
    ]
    return np.concatenate(halves)


def rays() -> np.ndarray:
    """Return the directions of a scan of a million pixels that half see the sphere."""
    axis = np.linspace(-0.45, 0.45, SIDE)
    right, down = np.meshgrid(axis, axis)
    way = np.stack([right, down, np.ones_like(right)], axis=-1).reshape(-1, 3)
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return a result and the CPU time that it took [s]."""
    begun = time.process_time()
    result = work()
    return result, time.process_time() - begun


def embree(corners: np.ndarray) -> Any:
    """Return embree's caster, or None where it is not installed."""
    try:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    except ImportError:
        return None
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
    caster = RayMeshIntersector(mesh, scale_to_box=False)
    caster.intersects_first(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))  # builds
    return caster


def main() -> None:
    """Print the rows and add them to the history."""
    import history

    way = rays()
    start = np.zeros_like(way)
    RayCaster(wavy_sphere(10)).first(start[:1], way[:1])  # compiled code is loaded
    figures = {}
    for cells in CELLS:
        corners = wavy_sphere(cells)
        name = f"{len(corners)} triangles"
        caster, figures[f"{name}: build [s]"] = timed(lambda c=corners: RayCaster(c))
        met, figures[f"{name}: a million rays [s]"] = timed(
            lambda c=caster: c.first(start, way)
        )
        other, build = timed(lambda c=corners: embree(c))
        if other is not None:
            figures[f"{name}: build by embree [s]"] = build
            theirs, figures[f"{name}: a million rays by embree [s]"] = timed(
                lambda c=other: c.intersects_first(start, way)
            )
            figures[f"{name}: other hits than embree"] = np.sum(
                (met < 0) != (theirs < 0)
            )
        figures[f"{name}: hits"] = np.sum(met >= 0)
    for name, figure in figures.items():
        print(f"{name:<50} {figure:.6g}")
    history.append("time_ray_caster", figures)


if __name__ == "__main__":
    main()
