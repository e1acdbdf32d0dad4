"""Times and memory of a site of large scans: measure_large_site.py 20 FOLDER

The site has scans of a million pixels of a bed, in two visits, with a bump in the
second one. The script registers, merges and compares them by commands, and prints the
times and the peak memory of each, and of each step of the registration. FOLDER keeps
the files of the site. Sites come from `tests/oracles/underwater_sites.py`.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
for folder in ("oracles", "support"):
    sys.path.insert(0, str(HERE.parent / "tests" / folder))

import drawn_sites  # noqa: E402
import underwater_sites as oracle  # noqa: E402
from measure_sites import rotation_vector  # noqa: E402

from amulor._progress import listening  # noqa: E402
from amulor.site import Site  # noqa: E402
from amulor.site.registration.register import register  # noqa: E402
from amulor.site.registration.result import (  # noqa: E402
    read_registration,
    write_registration,
)

#: Middle and height of the bump in the second visit [m].
MIDDLE, BUMP = (0.1, 0.05), 0.01


class _Images(dict[str, Any]):
    """Range images of two visits, computed when needed; they fill no memory."""

    def __init__(self, stations: dict[str, dict[str, Any]], rows: int) -> None:
        super().__init__()
        self.rows, self.rng = rows, np.random.default_rng([42, rows])
        self.drawn = oracle.Drawn(self.rng)
        bed = oracle.bed(self.rng)
        later = dataclasses.replace(bed, bump=BUMP, middle=MIDDLE)
        self.scans = {
            name: (scene, station, visit)
            for (visit, of_visit), scene in zip(
                stations.items(), (bed, later), strict=True
            )
            for name, station in of_visit.items()
        }
        self.beams = oracle.grid(rows, rows * 4 // 3)[2]

    def __missing__(self, name: str) -> Any:
        noise = oracle.Noise()
        scene, station, visit = self.scans[name]
        true = oracle.cast(scene, station, self.beams)
        distance = oracle.measured(true, noise, self.drawn, scan=name, visit=visit)
        return drawn_sites.range_image(
            distance, self.rows, self.rows * 4 // 3, noise=noise, name=name
        )


def large_stations(count: int) -> dict[str, dict[str, Any]]:
    """Stations of two visits, half of the scans each."""
    rng = np.random.default_rng([42, count])
    return {
        visit: {
            f"{letter}{k + 1}": place
            for k, place in enumerate(oracle.ring(count // 2, rng))
        }
        for visit, letter in (("one", "a"), ("two", "b"))
    }


def write_large(count: int, rows: int, folder: Path) -> None:
    """Write the files of a site of many large scans."""
    rng = np.random.default_rng([43, count])
    stations = large_stations(count)
    starts = {
        name: oracle.start_of(place, rng, position=0.05, angle=0.03)
        for of_visit in stations.values()
        for name, place in of_visit.items()
    }
    starts["a1"] = oracle.start_of(
        stations["one"]["a1"], rng,
        position=drawn_sites.SURVEYED[0], angle=drawn_sites.SURVEYED[1],
    )  # fmt: skip
    scenes = dict.fromkeys(stations, oracle.Bed())
    small = drawn_sites.drawn_site(scenes, stations, starts, rng, rows=30)
    site = dataclasses.replace(small, images=_Images(stations, rows))
    folder.mkdir(parents=True, exist_ok=True)
    drawn_sites.written(site, folder)


def timed(label: str, *arguments: object) -> str:
    """Run a Python command; return its times and peak memory in words."""
    begin = time.monotonic()
    words = [sys.executable, *map(str, arguments)]
    process = subprocess.Popen(words)
    _, status, used = os.wait4(process.pid, 0)
    elapsed = time.monotonic() - begin
    return (
        f"{label}: {elapsed:.0f} s, {used.ru_utime + used.ru_stime:.0f} s of "
        f"processor time, peak memory {used.ru_maxrss / 2**20:.2f} GiB, "
        f"exit code {os.waitstatus_to_exitcode(status)}"
    )


def register_large(folder: Path) -> None:
    """Register a large site; print processor time and peak memory after each step."""
    marks: list[tuple[str, float]] = []

    def listener(step: str, _: float) -> None:
        name = "reading" if step.startswith("reading") else step
        if not marks or marks[-1][0] != name:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            if marks:
                spent = time.process_time() - marks[-1][1]
                print(f"  {marks[-1][0]}: {spent:.0f} s, {peak:.2f} GiB", flush=True)
            marks.append((name, time.process_time()))

    with listening(listener):
        result = register(Site.from_toml(folder / "site.toml"))
        listener("end", 1.0)
    write_registration(result, folder / "poses.json", overwrite=True)


def measured_large(count: int, folder: Path, rows: int) -> None:
    """Register, merge and compare large scans; print time, memory and errors."""
    site, poses = folder / "site.toml", folder / "poses.json"
    if not site.is_file():
        write_large(count, rows, folder)
    print(f"{count} scans of {rows * (rows * 4 // 3)} pixels", flush=True)
    print(timed("register", __file__, count, folder, "--only-register"), flush=True)
    result = read_registration(poses)
    names, errors = [], []
    for of_visit in large_stations(count).values():
        for name, station in of_visit.items():
            pose = result.poses[name]
            turn = rotation_vector(pose.rotation @ station.matrix.T)
            names.append(f"pose {name}")
            errors.append(np.concatenate([pose.position - station.place, turn]))
    largest = max(float(np.linalg.norm(error[:3])) for error in errors)
    print(f"largest error {1e3 * largest:.2f} mm", flush=True)
    print(agreement(np.concatenate(errors), result.covariance_of(*names)), flush=True)
    for command, name in (("merge", "merged"), ("compare", "change.csv")):
        output = folder / name
        print(
            timed(command, "-m", "amulor", "site", command, site, "--poses", poses,
                  "-o", output, "--overwrite"),
            flush=True,
        )  # fmt: skip


def agreement(error: np.ndarray, covariance: np.ndarray) -> str:
    """Agreement of errors of poses with their joint covariance, in words.

    All poses of a site share a few errors: of the surveyed station, the delay and the
    index. So the share of components within their uncertainties differs from site to
    site. Its range is that of errors drawn from the covariance. The chi-square of all
    components has no such range.
    """
    sigma = np.sqrt(np.diag(covariance))
    values, axes = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    score = error / sigma
    square = float(((axes.T @ score) ** 2 / values).mean())
    rng = np.random.default_rng(0)
    drawn = (rng.normal(size=(4000, len(score))) * np.sqrt(values)) @ axes.T
    lines = [
        f"chi-square of all poses {square:.2f} for each of {len(score)} components, "
        f"1 +- {np.sqrt(2 / len(score)):.2f} expected"
    ]
    for limit in (1.0, 1.96):
        share = float((np.abs(score) < limit).mean())
        low, high = np.quantile((np.abs(drawn) < limit).mean(axis=1), [0.025, 0.975])
        lines.append(
            f"{share:.0%} of the components within {limit:g} stated uncertainties; "
            f"{low:.0%} to {high:.0%} in 95 % of sites with this covariance"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure a large site, or only register it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, help="number of scans, even")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rows", type=int, default=866)
    parser.add_argument("--only-register", action="store_true")
    options = parser.parse_args()
    if options.only_register:
        register_large(options.folder)
    else:
        measured_large(options.count, options.folder, options.rows)


if __name__ == "__main__":
    main()
