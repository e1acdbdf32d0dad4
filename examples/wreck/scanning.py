"""Scans of meshes from several places, with errors drawn as the images state them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import trimesh
import xarray as xr

from amulor import cube as cubes
from amulor.transport.ray_caster import RayCaster

FREQUENCY, GROUP_INDEX, LIGHT = 40e6, 1.36, 299792458.0


@dataclass(frozen=True)
class Errors:
    """Standard deviations of what a scan's ranges suffer from."""

    own: float = 1e-3
    delay: float = 2e-3
    index: float = 5e-4
    reference: float = 1e-3


@dataclass
class Draw:
    """Numbers that scans of one instrument or one water share."""

    rng: np.random.Generator
    numbers: dict[str, float] = field(default_factory=dict)

    def of(self, key: str) -> float:
        """Return the number of a key, always the same."""
        return self.numbers.setdefault(key, float(self.rng.normal()))


def looking(
    place: tuple[float, ...], at: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and place of an instrument that looks at a point, level."""
    forward = np.array(at, dtype=float) - np.array(place)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    return np.stack([right, down, forward], axis=1), np.array(place, dtype=float)


def grid(
    rows: int, columns: int, half: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return azimuth, elevation and unit vectors of a scan."""
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


def ranges(
    mesh: trimesh.Trimesh, rotation: np.ndarray, place: np.ndarray, unit: np.ndarray
) -> np.ndarray:
    """Return where beams first meet a mesh, in double precision; NaN for none."""
    beams = (unit @ rotation.T).reshape(-1, 3)
    starts = np.broadcast_to(place, beams.shape)
    face = RayCaster(mesh.triangles).first(starts, beams)
    hit = face >= 0
    corner = mesh.triangles[face[hit]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    found = np.full(len(beams), np.nan)
    found[hit] = np.einsum("ij,ij->i", corner[:, 0] - place, normal) / np.einsum(
        "ij,ij->i", beams[hit], normal
    )
    return found.reshape(unit.shape[:-1])


def image(
    distance: np.ndarray,
    azimuth: np.ndarray,
    elevation: np.ndarray,
    *,
    errors: Errors,
    draw: Draw | None,
    scan: str,
    instrument: str = "instrument",
    water: str = "water",
) -> xr.Dataset:
    """Return a range image; its errors are drawn unless `draw` is None."""
    turn = 4 * np.pi * FREQUENCY * GROUP_INDEX / LIGHT * distance
    there = np.isfinite(distance)
    seen = distance
    if draw is not None:
        seen = (
            distance
            + errors.own * draw.rng.normal(size=distance.shape)
            + errors.delay * draw.of(f"delay {instrument}")
            + errors.index * distance * draw.of(f"index {water}")
            + errors.reference
            * (
                draw.of(f"in phase {scan}") * np.cos(turn)
                + draw.of(f"quadrature {scan}") * np.sin(turn)
            )
        )
    shared = np.sqrt(errors.delay**2 + (errors.index * seen) ** 2 + errors.reference**2)

    def full(value: float) -> np.ndarray:
        return np.where(there, value, np.nan)

    return cubes.build(
        "range_image",
        {
            "slant_range": seen,
            "slant_range_uncertainty": np.hypot(shared, errors.own),
            "slant_range_common_uncertainty": shared,
            "slant_range_uncertainty_counting": full(errors.own),
            "slant_range_uncertainty_reference": full(errors.reference),
            "slant_range_uncertainty_delay": full(errors.delay),
            "slant_range_uncertainty_group_index": errors.index * seen,
            "intensity": full(0.01),
            "quality_flag": np.where(there, 0, 4).astype(np.int16),
        },
        {"azimuth": azimuth, "elevation": elevation},
        geometry={
            "group_index": GROUP_INDEX,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes(
            "range_image",
            title=scan,
            source="exact geometry of a mesh, errors drawn",
            modulation_frequencies=np.array([FREQUENCY]),
            open_water_degree=np.array([0, 0], dtype=np.int32),
            simulated=np.int32(1),
        ),
    )
