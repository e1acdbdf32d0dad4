"""Time and coverage of joint estimation while the vehicle moves.

Usage: python benchmarks/time_moving_joint.py [SEED ...]. The amphora of
examples/vehicle is measured with four frequencies at 0.2 m/s, with readings at once or
in turn. Water and ranges are estimated together, from every reading at its own place.
The time is that of the processor.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import history
import numpy as np
from measure_readings_in_turn import scored

from amulor import Survey, imaging, rejection, simulation

SURVEY = Path(__file__).parents[1] / "examples" / "vehicle" / "amphora.toml"
COLUMNS, ROWS, SPEED = 200, 200, 0.2
#: Distance of rows [m], and interval of possible ranges [m].
SPACING, INTERVAL = 0.01, (1.2, 2.6)


def cube_of(readings: str, seed: int, rows: int = ROWS):
    """Cube of a pass with readings at once or in turn."""
    dwell = SPACING / (SPEED * COLUMNS)
    if readings == "in-turn":
        dwell /= 4
    survey = Survey.from_toml(SURVEY).with_(
        {
            "instrument.modulation_depth": 0.2,
            "instrument.modulation_frequencies": [
                "40 MHz", "80 MHz", "120 MHz", "160 MHz",
            ],
            "instrument.lock_in.time_constant": "5 us",
            "platform.navigation.position_uncertainty": 1e-3,
            "platform.course.speed": SPEED,
            "platform.readings": readings,
            "scan.columns": COLUMNS,
            "scan.rows": rows,
            "scan.dwell": dwell,
        }
    )  # fmt: skip
    return simulation.simulate(survey, rng=seed, model=simulation.ClosureModel())


def measured(readings: str, seed: int) -> dict[str, float]:
    """Pixels per second of processor time, and errors and coverage of good pixels."""
    cube = cube_of(readings, seed)
    start = time.process_time()
    target = rejection.joint(cube, interval=INTERVAL)
    taken = time.process_time() - start
    image = imaging.range_image(target)
    scores = scored(image)
    return {"pixels_per_s": image["slant_range"].size / taken} | {
        name: scores[name] for name in ("good", "error_mm", "within_1", "within_1_96")
    }


def main() -> None:
    """Measure both kinds of readings, and append the means over the seeds."""
    seeds = [int(word) for word in sys.argv[1:]] or [0, 1, 2, 3, 4]
    rejection.joint(cube_of("at-once", 0, rows=4), interval=INTERVAL)  # Compiles.
    figures: dict[str, float] = {"seeds": len(seeds)}
    for readings in ("at-once", "in-turn"):
        rows = [measured(readings, seed) for seed in seeds]
        for name in rows[0]:
            values = [row[name] for row in rows]
            figures[f"{readings}: {name}"] = float(np.mean(values))
            print(f"{readings}: {name}", *(f"{value:.4g}" for value in values))
    history.append("time_moving_joint", figures)


if __name__ == "__main__":
    main()
