"""Range images of exact shapes, with errors drawn as an image states them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from amulor import cube as cubes

#: Own noise, delay, share of the group index, reference [m, m, 1, m].
OWN, DELAY, INDEX, REFERENCE = 1e-3, 2e-3, 1e-3, 1.5e-3
FREQUENCY, GROUP_INDEX = 80e6, 1.36
LIGHT = 299792458.0


@dataclass(frozen=True)
class Beams:
    """Directions of a scan from the origin."""

    azimuth: np.ndarray
    elevation: np.ndarray

    @property
    def unit(self) -> np.ndarray:
        """Right, down, forward."""
        return np.stack(
            [
                np.sin(self.azimuth) * np.cos(self.elevation),
                -np.sin(self.elevation),
                np.cos(self.azimuth) * np.cos(self.elevation),
            ],
            axis=-1,
        )


def beams(*, rows: int = 24, columns: int = 32, half: float = 0.16) -> Beams:
    """Return a scan that looks forward."""
    return Beams(
        *np.meshgrid(
            np.linspace(-half, half, columns),
            np.linspace(0.75 * half, -0.75 * half, rows),
        )
    )


def to_plane(scan: Beams, normal: np.ndarray, offset: float) -> np.ndarray:
    """Return where beams meet the plane n.p = offset."""
    return offset / (scan.unit @ normal)


def to_sphere(scan: Beams, centre: np.ndarray, radius: float) -> np.ndarray:
    """Return where beams first meet a sphere, not a number beside it."""
    along = scan.unit @ centre
    inside = along**2 - centre @ centre + radius**2
    return along - np.sqrt(np.where(inside > 0, inside, np.nan))


def to_cylinder(
    scan: Beams, point: np.ndarray, axis: np.ndarray, radius: float
) -> np.ndarray:
    """Return where beams first meet a cylinder."""
    flat = scan.unit - (scan.unit @ axis)[..., None] * axis
    start = -(point - (point @ axis) * axis)
    a, b = (flat**2).sum(-1), flat @ start
    inside = b**2 - a * (start @ start - radius**2)
    return (-b - np.sqrt(np.where(inside > 0, inside, np.nan))) / a


def errors(ranges: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return errors that are drawn, each kind in its own way."""
    turn = 4 * np.pi * FREQUENCY * GROUP_INDEX / LIGHT * ranges
    one, other = rng.normal(size=2)
    return (
        OWN * rng.normal(size=ranges.shape)
        + DELAY * rng.normal()
        + INDEX * ranges * rng.normal()
        + REFERENCE * (one * np.cos(turn) + other * np.sin(turn))
    )


def image(scan: Beams, ranges: np.ndarray) -> xr.Dataset:
    """Return a range image that states these errors; degree 0 of the reference."""
    there = np.isfinite(ranges)
    size = np.where(there, ranges, np.nan)
    shared = np.hypot(np.hypot(DELAY, INDEX * size), REFERENCE)

    def full(value: float) -> np.ndarray:
        return np.where(there, value, np.nan)

    return cubes.build(
        "range_image",
        {
            "slant_range": size,
            "slant_range_uncertainty": np.hypot(shared, OWN),
            "slant_range_common_uncertainty": shared,
            "slant_range_uncertainty_counting": full(OWN),
            "slant_range_uncertainty_reference": full(REFERENCE),
            "slant_range_uncertainty_delay": full(DELAY),
            "slant_range_uncertainty_group_index": INDEX * size,
            "intensity": full(0.01),
            "quality_flag": np.where(there, 0, 4).astype(np.int16),
        },
        {"azimuth": scan.azimuth, "elevation": scan.elevation},
        geometry={
            "group_index": GROUP_INDEX,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.array([0.07, 0.0, 0.0]),
        },
        attributes=cubes.attributes(
            "range_image",
            title="shapes",
            source="a test",
            modulation_frequencies=np.array([FREQUENCY]),
            open_water_degree=np.array([0, 0], dtype=np.int32),
        ),
    )
