"""Ranges of readings in turn from a vehicle that moves between them.

Usage: python benchmarks/measure_readings_in_turn.py [SEED ...]. The vehicle of
examples/vehicle hovers above the amphora; waves move it at 0.1 to 0.3 m/s (rms in each
coordinate). It reads four frequencies in turn, 17 ms each. The rows go to
readings_in_turn.csv.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from amulor import Survey, imaging, rejection, simulation
from amulor.cube import DOUBTFUL

SURVEY = Path(__file__).parents[1] / "examples" / "vehicle" / "amphora.toml"
FILE = Path(__file__).with_name("readings_in_turn.csv")
SPEEDS, PERIOD, DWELL = (0.1, 0.2, 0.3), 3.0, 0.017
#: Interval of possible ranges [m].
INTERVAL = (1.2, 2.6)


def cube_of(speed: float, seed: int):
    """Cube of a hovering vehicle that waves move."""
    wave = {
        "current": (0.0, 0.0, 0.0),
        "position": speed * PERIOD / (2 * np.pi),
        "period": PERIOD,
    }
    survey = Survey.from_toml(SURVEY).with_(
        {
            "instrument.modulation_frequencies": [
                "40 MHz", "80 MHz", "120 MHz", "160 MHz",
            ],
            "instrument.lock_in.time_constant": "2 ms",
            "platform.course": {"kind": "hover", "start": (431.2, 88.0, -8.0)},
            "platform.disturbance": wave,
            "platform.readings": "in-turn",
            "scan.columns": 28,
            "scan.rows": 28,
            "scan.elevation_span": "20 deg",
            "scan.dwell": DWELL,
            # Their errors are not simulated.
            "calibration.delay_uncertainty": 0.0,
            "calibration.group_index_uncertainty": 0.0,
            "calibration.receiver_position_uncertainty": 0.0,
            "calibration.direction_uncertainty": 0.0,
            "scan.open_water": {"columns": 5, "rows": 5, "repeats": 6},
        }
    )  # fmt: skip
    return simulation.simulate(survey, rng=seed, model=simulation.ClosureModel())


def measured(cube, method: str) -> dict[str, float]:
    """Reject and image a cube, and compare the ranges with the true ones."""
    target = getattr(rejection, method.replace("-", "_"))(cube, interval=INTERVAL)
    return scored(imaging.range_image(target, interval=INTERVAL))


def scored(image) -> dict[str, float]:
    """Good pixels of an image, their errors and the coverage of their intervals."""
    ranges, true = image["slant_range"].values, image["truth_slant_range"].values
    good = (image["quality_flag"].values & int(DOUBTFUL)) == 0
    good &= np.isfinite(ranges) & np.isfinite(true)
    error = (ranges - true)[good]
    sigma = image["slant_range_uncertainty"].values[good]
    score = np.abs(error) / sigma if good.any() else np.zeros(1)
    return {
        "good": good.mean() / np.isfinite(true).mean(),
        "error_mm": 1e3 * np.sqrt(np.mean(error**2)) if good.any() else np.nan,
        "stated_mm": 1e3 * np.median(sigma) if good.any() else np.nan,
        "within_1": np.mean(score < 1),
        "within_1_96": np.mean(score < 1.96),
        "largest_score": score.max(),
    }


def main() -> None:
    """Measure all speeds and both methods, and write a row for each scan."""
    seeds = [int(word) for word in sys.argv[1:]] or [0, 1, 2, 3, 4]
    rows = []
    for speed in SPEEDS:
        for seed in seeds:
            cube = cube_of(speed, seed)
            for method in ("open-water", "joint"):
                row = {"speed": speed, "seed": seed, "method": method}
                row |= {k: f"{v:.4g}" for k, v in measured(cube, method).items()}
                print(*row.values(), flush=True)
                rows.append(row)
    with FILE.open("w", encoding="utf-8", newline="") as stream:
        table = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


if __name__ == "__main__":
    main()
