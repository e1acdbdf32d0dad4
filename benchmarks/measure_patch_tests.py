"""Errors of patch tests on simulated lines, appended to a table.

Usage: python benchmarks/measure_patch_tests.py FILE [RUNS]. Lines, sea bed, motion and
errors come from tests/oracles/patch_lines.py, which shares no code with the product.
Each run has other errors. Rows that FILE has are not computed again.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from amulor import cube as cubes
from amulor import imaging
from amulor.platform import Mounting, Trajectory

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "oracles"))
import patch_lines

NAMES = (
    "arm_right", "arm_down", "arm_forward", "about_right", "about_down",
    "about_forward", "clock", "drift",
)  # fmt: skip
COLUMNS = (
    "seed", *(f"{name}_{part}" for name in NAMES for part in ("error", "sigma")),
    "misfit", "position_walk", "attitude_walk",
)  # fmt: skip
#: Stated mounting, and standard deviations from which its errors are drawn.
ARM, ANGLES, OFFSET = (0.1, 0.25, 0.8), (0.02, -1.52, 0.01), 0.05
SPREAD = np.array([*[0.01] * 3, *[np.radians(1.0)] * 3, 0.02, 2e-5])
NOISE = 1e-3
ERRORS = {"shift": 0.005, "position_walk": 2e-4, "attitude_walk": 2e-5}
#: Position of the middle of each line [m], heading [deg] and speed [m/s].
LINES = (
    ((0.0, 0.0, -9.2), 0.0, 0.25),
    ((0.1, 0.1, -9.2), 180.0, 0.25),
    ((0.1, -0.1, -9.0), 90.0, 0.2),
    ((0.0, 0.1, -7.0), 270.0, 0.3),
    ((-0.1, 0.0, -6.6), 20.0, 0.25),
    ((0.0, 0.0, -6.8), 200.0, 0.25),
)
ROCKING = np.radians([3.0, 6.0, 6.0])


def lines_of(seed: int, *, lines=LINES, rows: int = 90, columns: int = 36):
    """Images, trajectories and the true errors of the mounting of one run."""
    rng = np.random.default_rng([seed, 4207])
    error = rng.normal(0, SPREAD)
    images, tracks = [], []
    for middle, heading, speed in lines:
        vehicle = patch_lines.Vehicle(
            rng, middle=middle, heading=np.radians(heading), speed=speed,
            duration=2.5 / speed, wave=0.01, rocking=ROCKING,
        )  # fmt: skip
        line = patch_lines.line_of(
            rng, vehicle, arm=ARM + error[:3], angles=ANGLES, bend=error[3:6],
            offset=OFFSET + error[6], drift=error[7], rows=rows, columns=columns,
            fan=np.radians(40), noise=NOISE, errors=ERRORS,
        )  # fmt: skip
        images.append(image_of(line))
        tracks.append(track_of(line, ERRORS))
    return images, tracks, error


def image_of(line: dict) -> xr.Dataset:
    """Range image with the ranges and times of a simulated line."""
    shape = line["slant_range"].shape
    return cubes.build(
        "range_image",
        {
            "slant_range": line["slant_range"],
            "slant_range_uncertainty": np.full(shape, NOISE),
            "intensity": np.ones(shape),
            "quality_flag": np.zeros(shape, dtype=np.int16),
        },
        {
            "azimuth": line["azimuth"],
            "elevation": np.zeros(shape),
            "time": line["time"],
            "reading_time": line["time"][None],
            "reading_duration": np.zeros((1, *shape)),
            "reading_weight": np.ones(1),
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("range_image", title="line", source="simulated"),
    )


def track_of(line: dict, errors: dict[str, float]) -> Trajectory:
    """Trajectory that a navigation system with these errors states."""
    since = line["stamps"] - line["stamps"][0]
    covariance = np.zeros((len(since), 6, 6))
    for axis in range(6):
        walk = errors["position_walk" if axis < 3 else "attitude_walk"]
        fixed = errors["shift"] if axis < 3 else 0.0
        covariance[:, axis, axis] = fixed**2 + walk**2 * since
    return Trajectory(
        time=line["stamps"],
        position=line["position"],
        attitude=Rotation.from_matrix(line["rotation"]).as_quat(),
        covariance=covariance,
        longest_gap=1.0,
    )


def stated_mounting() -> Mounting:
    """Mounting before the patch test."""
    return Mounting(
        lever_arm=ARM,
        heading=ANGLES[0],
        pitch=ANGLES[1],
        roll=ANGLES[2],
        clock_offset=OFFSET,
        lever_arm_uncertainty=SPREAD[0],
        boresight_uncertainty=SPREAD[3],
        clock_uncertainty=SPREAD[6],
        clock_drift_uncertainty=SPREAD[7],
    )


def measured(seed: int) -> dict[str, float]:
    """Run a patch test, and return errors and stated uncertainties."""
    images, tracks, error = lines_of(seed)
    result = imaging.patch_test(
        images, trajectories=tracks, mounting=stated_mounting(), suggest=False
    )
    row: dict[str, float] = {"seed": seed, "misfit": result.misfit}
    row["position_walk"] = result.position_walk
    row["attitude_walk"] = result.attitude_walk
    for name, found, true, sigma in zip(
        NAMES, result.change, error, result.uncertainty, strict=True
    ):
        row[f"{name}_error"], row[f"{name}_sigma"] = found - true, sigma
    return {name: float(f"{value:.6g}") for name, value in row.items()}


def main(path: Path, runs: int) -> None:
    """Append the missing runs to a table, and print errors and coverage."""
    present = list(csv.DictReader(path.open())) if path.exists() else []
    done = {int(float(row["seed"])) for row in present}
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if not present:
            writer.writeheader()
        for seed in range(runs):
            if seed not in done:
                writer.writerow(measured(seed))
                file.flush()
    rows = list(csv.DictReader(path.open()))
    print(f"{len(rows)} runs")
    for name in NAMES:
        error, sigma = (
            np.array([float(row[f"{name}_{part}"]) for row in rows])
            for part in ("error", "sigma")
        )
        inside = 100 * np.mean(np.abs(error) < 1.96 * sigma)
        print(
            f"{name:14} error {np.sqrt(np.mean(error**2)):.3g} "
            f"stated {np.sqrt(np.mean(sigma**2)):.3g} inside {inside:.1f} %"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 200)
