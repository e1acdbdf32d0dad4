"""Simulates a wreck site: nine scans in two waters and two visits, an amphora moved.

    python make_site.py FOLDER [--rows 120] [--seed 1] [--still]

Errors are drawn as the range images state them: noise, delay of the instrument, index
of the water of each visit, reference of each scan. In the second visit a fish swims
through one scan.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import bodies
import numpy as np
import scanning
import trimesh

from amulor import io
from amulor.imaging import flag_mixed, flag_outliers

#: Places of the instrument (east, north, up) of each visit, and what it looks at [m].
STATIONS = {
    "2025": [
        ("a1", (-1.3, -1.3, 1.6)),
        ("a2", (1.4, -1.1, 1.7)),
        ("a3", (0.2, 1.7, 1.8)),
        ("a4", (-1.6, 0.5, 1.6)),
        ("a5", (1.5, 0.7, 1.7)),
    ],
    "2026": [
        ("b1", (-1.1, -1.5, 1.7)),
        ("b2", (1.3, -1.3, 1.6)),
        ("b3", (-0.3, 1.8, 1.7)),
        ("b4", (1.6, 0.4, 1.8)),
    ],
}
LOOK_AT = (0.0, 0.05, 0.1)
#: How far the amphora lay from its place in the second visit (east, north) [m].
MOVED = np.array([0.0090, 0.0079, 0.0])
AMPHORA = (0.15, -0.35, 0.13)
#: Spheres on stakes (east, north, up) and their radius [m].
SPHERES = {
    "S1": (-0.75, -0.75, 0.3),
    "S2": (0.85, -0.7, 0.35),
    "S3": (0.35, 0.95, 0.62),
}
RADIUS = 0.08
ERRORS = scanning.Errors(own=1e-3, delay=1e-3, index=2e-4, reference=5e-4)
HALF = 0.38


def scene(*, moved: bool) -> trimesh.Trimesh:
    """Return the site, with the amphora in its first or its second place."""
    away = MOVED if moved else np.zeros(3)
    parts = [
        bodies.sea_bed(relief=0.05),
        bodies.turned(bodies.amphora(0.7), tuple(np.array(AMPHORA) + away), 0.5, 0.05),
        bodies.turned(bodies.amphora(0.55), (-0.55, 0.15, 0.1), -0.8, -0.08),
        bodies.turned(bodies.planks(), (0.1, 0.45, 0.0), 0.1),
        bodies.turned(bodies.anchor(), (-0.35, -0.55, 0.05), 2.4),
    ]
    for place in SPHERES.values():
        ball = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
        ball.apply_translation(place)
        parts.append(ball)
    return trimesh.util.concatenate(parts)


def fish() -> trimesh.Trimesh:
    """Return a fish above the site."""
    body = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    body.apply_scale([0.14, 0.05, 0.06])
    body.apply_translation([0.1, 0.1, 0.75])
    return body


def make(folder: Path, *, rows: int = 120, seed: int = 1, moved: bool = True) -> Path:
    """Write the scans and the site file, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    draw = scanning.Draw(rng)
    columns = rows * 4 // 3
    azimuth, elevation, unit = scanning.grid(rows, columns, HALF)
    entries = []
    places: dict[str, list[str]] = {name: [] for name in SPHERES}
    for visit, stations in STATIONS.items():
        site = scene(moved=moved and visit == "2026")
        for name, place in stations:
            rotation, position = scanning.looking(place, LOOK_AT)
            seen = site
            if name == "b2":
                seen = trimesh.util.concatenate([site, fish()])
            distance = scanning.ranges(seen, rotation, position, unit)
            image = scanning.image(
                distance, azimuth, elevation, errors=ERRORS, draw=draw, scan=name,
                instrument=f"instrument {visit}", water=f"water {visit}",
            )  # fmt: skip
            image = flag_outliers(flag_mixed(image))
            io.write_cube(image, folder / f"{name}.nc", overwrite=True)
            entries.append(scan_entry(name, visit, rotation, position, rng))
            for ball, centre in SPHERES.items():
                pixel = pixel_of(rotation, position, unit, np.array(centre))
                if pixel is None:
                    continue
                at = distance[pixel]
                away = np.linalg.norm(np.array(centre) - position)
                # Nothing stands before it, and enough beams meet it.
                clear = abs(away - at - RADIUS) < 0.3 * RADIUS
                if clear and RADIUS / away > 4 * 2 * HALF / columns:
                    places[ball].append(
                        f'{{scan = "{name}", row = {pixel[0]}, column = {pixel[1]}}}'
                    )
    path = folder / "site.toml"
    text = site_text(entries, places)
    if rows < 100:  # coarse pixels: smaller windows, or few are on one surface
        text += "\n[registration]\nwindow = 5\n"
    path.write_text(text)
    return path


def pixel_of(
    rotation: np.ndarray, position: np.ndarray, unit: np.ndarray, point: np.ndarray
) -> tuple[int, int] | None:
    """Return the pixel whose beam passes nearest to a point, if it is in the scan."""
    away = (point - position) @ rotation
    cosine = unit @ (away / np.linalg.norm(away))
    row, column = np.unravel_index(int(np.argmax(cosine)), cosine.shape)
    edge = row in (0, cosine.shape[0] - 1) or column in (0, cosine.shape[1] - 1)
    return None if edge else (int(row), int(column))


def scan_entry(
    name: str,
    visit: str,
    rotation: np.ndarray,
    position: np.ndarray,
    rng: np.random.Generator,
) -> str:
    """Return the table of a scan, with a start pose as a diver's compass gives it."""
    forward = rotation[:, 2]
    heading = np.arctan2(forward[0], forward[1]) + 0.02 * rng.normal()
    pitch = np.arcsin(forward[2]) + 0.01 * rng.normal()
    roll = 0.01 * rng.normal()
    at = position + 0.03 * rng.normal(size=3)
    where = ", ".join(f'"{value:.3f} m"' for value in at)
    return f"""
[[scan]]
name = "{name}"
file = "{name}.nc"
epoch = "{visit}"
[scan.start]
position = [{where}]
heading = "{np.degrees(heading) % 360:.2f} deg"
pitch = "{np.degrees(pitch):.2f} deg"
roll = "{np.degrees(roll):.2f} deg"
position_uncertainty = "3 cm"
heading_uncertainty = "20 mrad"
level_uncertainty = "10 mrad"
"""


def site_text(entries: list[str], places: dict[str, list[str]]) -> str:
    """Return the site file."""
    targets = [
        f"""
[[target]]
kind = "sphere"
name = "{name}"
radius = "{RADIUS * 1e3:g} mm"
radius_uncertainty = "0.05 mm"
places = [{", ".join(seen)}]
"""
        for name, seen in places.items()
        if seen
    ]
    gap = float(np.linalg.norm(np.subtract(SPHERES["S1"], SPHERES["S2"])))
    bar = f"""
[[target]]
kind = "scale-bar"
name = "bar"
ends = ["S1", "S2"]
length = "{gap * 1e3:.2f} mm"
length_uncertainty = "0.1 mm"
"""
    return (
        """name = "Wreck, simulated"

[[epoch]]
name = "2025"
date = 2025-06-10

[[epoch]]
name = "2026"
date = 2026-06-14
"""
        + "".join(entries)
        + "".join(targets)
        + (bar if places["S1"] and places["S2"] else "")
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rows", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--still", action="store_true", help="nothing moved")
    given = parser.parse_args()
    print(make(given.folder, rows=given.rows, seed=given.seed, moved=not given.still))
