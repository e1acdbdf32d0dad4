"""Sites of tests/oracles/underwater_sites.py as the package reads them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import underwater_sites as oracle
import xarray as xr

from amulor import cube as cubes
from amulor import io
from amulor.imaging import flag_mixed, flag_outliers
from amulor.site import Site
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.register import surface_of
from amulor.site.registration.result import Registration, write_registration
from amulor.site.registration.surface import ScanSurface


def range_image(
    distance: np.ndarray, rows: int, columns: int, *, noise: oracle.Noise, name: str
) -> xr.Dataset:
    """Return measured ranges as a range image that states their errors."""
    azimuth, elevation, _ = oracle.grid(rows, columns)
    there = np.isfinite(distance)
    shared = np.sqrt(
        noise.delay**2 + (noise.index * distance) ** 2 + noise.reference**2
    )

    def full(value: float) -> np.ndarray:
        return np.where(there, value, np.nan)

    image = cubes.build(
        "range_image",
        {
            "slant_range": distance,
            "slant_range_uncertainty": np.hypot(shared, noise.own),
            "slant_range_common_uncertainty": shared,
            "slant_range_uncertainty_counting": full(noise.own),
            "slant_range_uncertainty_reference": full(noise.reference),
            "slant_range_uncertainty_delay": full(noise.delay),
            "slant_range_uncertainty_group_index": noise.index * distance,
            "intensity": full(0.01),
            "quality_flag": np.where(there, 0, 4).astype(np.int16),
        },
        {"azimuth": azimuth, "elevation": elevation},
        geometry={
            "group_index": oracle.GROUP_INDEX,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes(
            "range_image",
            title=name,
            source="exact geometry, errors drawn",
            modulation_frequencies=np.array([oracle.FREQUENCY]),
            open_water_degree=np.array([0, 0], dtype=np.int32),
        ),
    )
    return flag_outliers(flag_mixed(image))


@dataclass
class DrawnSite:
    """Scans of one site with their true stations."""

    site: Site
    stations: dict[str, oracle.Station]
    images: dict[str, xr.Dataset]
    surfaces: dict[str, ScanSurface] = field(default_factory=dict)

    def wrong(self, registration: Any) -> dict[str, tuple[float, float]]:
        """Return how far poses are off [m], [rad]."""
        found = {}
        for name, station in self.stations.items():
            pose = registration.poses[name]
            found[name] = (
                float(np.linalg.norm(pose.position - station.place)),
                oracle.angle_between(pose.rotation, station.matrix),
            )
        return found


def drawn_site(
    scenes: dict[str, Any],
    stations: dict[str, dict[str, oracle.Station]],
    starts: dict[str, oracle.Start],
    rng: np.random.Generator,
    *,
    rows: int = 105,
    noise: oracle.Noise | None = None,
    spoiled: dict[str, Any] | None = None,
    **settings: Any,
) -> DrawnSite:
    """Return a site of visits; `spoiled` changes the ranges of a scan."""
    noise = noise or oracle.Noise()
    columns = rows * 4 // 3
    beams = oracle.grid(rows, columns)[2]
    drawn = oracle.Drawn(rng)
    scans, images, known = [], {}, {}
    for visit, of_visit in stations.items():
        for name, station in of_visit.items():
            true = oracle.cast(scenes[visit], station, beams)
            seen = oracle.measured(true, noise, drawn, scan=name, visit=visit)
            if spoiled and name in spoiled:
                seen = spoiled[name](seen)
            images[name] = range_image(seen, rows, columns, noise=noise, name=name)
            known[name] = station
            start = starts[name]
            scans.append(
                {
                    "name": name,
                    "file": f"{name}.nc",
                    "epoch": visit,
                    "water": visit,
                    "start": {
                        "position": tuple(map(float, start.station.place)),
                        "heading": float(
                            np.arctan2(np.sin(start.station.heading),
                                       np.cos(start.station.heading))
                        ),
                        "pitch": float(start.station.pitch),
                        "roll": float(start.station.roll),
                        "position_uncertainty": start.position,
                        "heading_uncertainty": start.heading,
                        "level_uncertainty": start.level,
                    },
                }
            )  # fmt: skip
    site = Site.model_validate(
        {
            "name": "drawn",
            "epoch": [{"name": visit} for visit in stations],
            "scan": scans,
            **settings,
        }
    )
    surfaces = {one.name: surface_of(site, one, images[one.name]) for one in site.scan}
    return DrawnSite(site=site, stations=known, images=images, surfaces=surfaces)


#: Error of a station that surveyors tied to the site [m, rad].
SURVEYED = (5e-4, 2e-4)


def one_visit(
    kind: str,
    seed: int,
    *,
    position: float = 0.05,
    angle: float = np.radians(3),
    stated: tuple[float, float] | None = None,
    rows: int = 105,
    **more: Any,
) -> DrawnSite:
    """Return a visit of four stations, the first one surveyed, the others started."""
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    if kind == "wall":
        scene, places = oracle.wall(rng), oracle.wall_stations(4, rng)
    elif kind == "corner":
        scene, places = oracle.corner(rng), oracle.corner_stations(4, rng)
    elif kind == "plane":
        scene, places = oracle.Bed(), oracle.ring(4, rng)
    elif kind == "low bed":
        scene, places = oracle.bed(rng, high=(0.003, 0.005)), oracle.ring(4, rng)
    else:
        scene = {"bed": oracle.bed, "amphorae": oracle.amphorae}[kind](rng)
        places = oracle.ring(4, rng)
    stations = {f"a{number + 1}": one for number, one in enumerate(places)}
    starts = {
        name: oracle.start_of(one, rng, position=position, angle=angle, stated=stated)
        for name, one in stations.items()
    }
    starts["a1"] = oracle.start_of(
        stations["a1"], rng, position=SURVEYED[0], angle=SURVEYED[1]
    )
    return drawn_site({"one": scene}, {"one": stations}, starts, rng, rows=rows, **more)


def two_visits(
    before: Any,
    after: Any,
    rng: np.random.Generator,
    *,
    count: int = 4,
    position: float = 0.02,
    angle: float = 0.01,
    rows: int = 105,
    **more: Any,
) -> DrawnSite:
    """Return two visits of some stations each, the first station surveyed."""
    stations = {
        visit: {
            f"{letter}{k + 1}": one for k, one in enumerate(oracle.ring(count, rng))
        }
        for visit, letter in (("one", "a"), ("two", "b"))
    }
    starts = {
        name: oracle.start_of(one, rng, position=position, angle=angle)
        for of_visit in stations.values()
        for name, one in of_visit.items()
    }
    starts["a1"] = oracle.start_of(
        stations["one"]["a1"], rng, position=SURVEYED[0], angle=SURVEYED[1]
    )
    scenes = {"one": before, "two": after}
    return drawn_site(scenes, stations, starts, rng, rows=rows, **more)


def written(drawn: DrawnSite, folder: Path) -> Path:
    """Write a site as files and return its site file."""
    lines = [f'name = "{drawn.site.name}"']
    for epoch in drawn.site.epoch:
        lines += ["[[epoch]]", f'name = "{epoch.name}"']
    for scan in drawn.site.scan:
        io.write_cube(drawn.images[scan.name], folder / scan.file.name)
        start = scan.start
        assert start is not None
        lines += [
            "[[scan]]",
            f'name = "{scan.name}"',
            f'file = "{scan.file.name}"',
            f'epoch = "{scan.epoch}"',
            "[scan.start]",
            f"position = {json.dumps([f'{v!r} m' for v in start.position])}",
        ]
        lines += [
            f'{key} = "{getattr(start, key)!r} {unit}"'
            for key, unit in (
                ("heading", "rad"),
                ("pitch", "rad"),
                ("roll", "rad"),
                ("position_uncertainty", "m"),
                ("heading_uncertainty", "rad"),
                ("level_uncertainty", "rad"),
            )
        ]
    (folder / "site.toml").write_text("\n".join(lines) + "\n")
    return folder / "site.toml"


def bumped_site(
    folder: Path, *, rows: int, height: float, middle: tuple[float, float]
) -> Path:
    """Write two visits between which a plateau appears, with true poses beside them."""
    rng = np.random.default_rng(1)
    before = oracle.bed(rng, high=(0.03, 0.08))
    after = replace(before, bump=height, middle=middle)
    noise = oracle.Noise(own=1e-3, delay=1e-5, index=1e-6, reference=1e-5)
    drawn = two_visits(before, after, rng, rows=rows, noise=noise)
    write_registration(known_registration(drawn), folder / "poses.json")
    return written(drawn, folder)


def known_registration(drawn: DrawnSite) -> Registration:
    """Return the true poses of a site as its registration, without errors."""
    poses = {
        name: ScanPose(station.matrix, np.array(station.place))
        for name, station in drawn.stations.items()
    }
    keys = dict.fromkeys(
        key for surface in drawn.surfaces.values() for key in surface.shared.keys
    )
    places = {f"error {key}": (at, at + 1) for at, key in enumerate(keys)}
    return Registration(
        site=drawn.site.name,
        poses=poses,
        points={},
        errors=dict.fromkeys(keys, 0.0),
        places=places,
        covariance=np.eye(len(keys)),
        pairs=(),
        disagreements=(),
        weaknesses=(),
        contradictions=(),
        remarks=(),
        settled=True,
    )
