"""Range images of exact shapes, made by the tests' own geometry."""

from __future__ import annotations

import numpy as np
import xarray as xr

from amulor import cube as cubes

#: Ladder of the demo: a first step of 40 mm, then three of 10 mm, treads of 20 mm.
DEPTHS = (1.5, 1.46, 1.45, 1.44, 1.43)
TREAD = 0.02


def directions(
    rows: int, columns: int, *, half: float = 0.04
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return azimuth, elevation and unit vectors (right, down, forward)."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-half, half, columns),
        np.linspace(half * rows / columns, -half * rows / columns, rows),
    )
    unit = np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ],
        axis=-1,
    )
    return azimuth, elevation, unit


def image_of(
    distance: np.ndarray,
    azimuth: np.ndarray,
    elevation: np.ndarray,
    *,
    own: float = 1e-4,
    shared: float = 0.0,
) -> xr.Dataset:
    """Return a range image with the same errors at all pixels."""
    shape = distance.shape
    return cubes.build(
        "range_image",
        {
            "slant_range": distance,
            "slant_range_uncertainty": np.full(shape, np.hypot(own, shared)),
            "slant_range_common_uncertainty": np.full(shape, shared),
            "intensity": 0.01 * (1 + np.arange(distance.size).reshape(shape) % 7),
            "quality_flag": np.where(np.isfinite(distance), 0, 4).astype(np.int16),
        },
        {"azimuth": azimuth, "elevation": elevation},
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes(
            "range_image",
            title="scene",
            source="exact geometry",
            modulation_frequencies=np.array([39e6]),
        ),
    )


def plane(
    normal: tuple[float, float, float],
    offset: float,
    *,
    rows: int = 20,
    columns: int = 30,
    **errors: float,
) -> xr.Dataset:
    """Return the plane normal . p = offset."""
    azimuth, elevation, unit = directions(rows, columns)
    return image_of(offset / (unit @ np.array(normal)), azimuth, elevation, **errors)


def ladder(*, rows: int = 20, columns: int = 60, **errors: float) -> xr.Dataset:
    """Return the treads of the demo's ladder, each where its beams meet it first."""
    azimuth, elevation, unit = directions(rows, columns, half=0.033)
    best = np.full(azimuth.shape, np.nan)
    for number, depth in enumerate(DEPTHS):
        left = (number - len(DEPTHS) / 2) * TREAD
        distance = depth / unit[..., 2]
        right = distance * unit[..., 0]
        meets = (right >= left) & (right < left + TREAD)
        best = np.where(meets, np.fmin(best, distance), best)
    return image_of(best, azimuth, elevation, **errors)


def cone(**errors: float) -> xr.Dataset:
    """Return an upright cone, its tip 0.3 m above the beam and 1.5 m away.

    The radius is a fifth of the distance from the tip.
    """
    azimuth, elevation, unit = directions(40, 40, half=0.06)
    a = unit[..., 1] ** 2 - 1 / 1.04
    b = 1.5 * unit[..., 2] / 1.04 - unit[..., 1] * -0.3 * (1 - 1 / 1.04)
    c = 0.09 * (1 - 1 / 1.04) - 2.25 / 1.04
    ranges = (-b + np.sqrt(np.where(b**2 > a * c, b**2 - a * c, np.nan))) / a
    return image_of(ranges, azimuth, elevation, **errors)


def drawn(image: xr.Dataset, rng: np.random.Generator, own: float) -> xr.Dataset:
    """Return the image with noise of its own on every range."""
    noise = rng.normal(scale=own, size=image["slant_range"].shape)
    return image.assign(slant_range=image["slant_range"] + noise)
