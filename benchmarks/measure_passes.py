"""Coverage of points of simulated passes over an amphora, appended to a table.

Usage: python benchmarks/measure_passes.py FILE [PASSES]. Each pass has other motion,
mounting, navigation errors and noise, drawn from the uncertainties of the survey. Rows
that FILE has are not computed again.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from amulor import Survey, imaging, rejection, simulation
from amulor.cube import DOUBTFUL

SURVEY = Path(__file__).parents[1] / "examples" / "vehicle" / "amphora.toml"
SPEEDS = (0.1, 0.2, 0.3)
COLUMNS = (
    "speed", "seed", "points", "inside_68", "inside_95", "error_mm", "uncertainty_mm",
    "range_error_mm", "range_uncertainty_mm",
)  # fmt: skip
#: Half widths of the intervals with 68.27 and 95 % [standard uncertainties].
_LIMITS = (1.0, 1.96)


def measured(survey: Survey, speed: float, seed: int) -> dict[str, float]:
    """Simulate and process a pass; return rates of coordinates inside their intervals.

    Doubtful points are left out: their flags say that the error may be larger.
    """
    row = survey.scan.columns * survey.scan.dwell
    # Rows of 10 mm at each speed, so that all passes cover the amphora alike.
    chosen = survey.with_(
        {
            "platform.course.speed": speed,
            "scan.dwell": survey.scan.dwell * 0.01 / (speed * row),
        }
    )
    cube = simulation.simulate(chosen, rng=seed, model=simulation.ClosureModel())
    image = imaging.range_image(rejection.open_water(cube))
    track = simulation.measured_trajectory(chosen, rng=seed)
    cloud = imaging.point_cloud(
        image, frame=imaging.moving_frame(image, trajectory=track)
    )
    place = cloud["row"].values, cloud["column"].values
    true = np.stack(
        [image[f"truth_{a}"].values[place] for a in ("east", "north", "up")]
    )
    good = (cloud["quality_flag"].values & int(DOUBTFUL)) == 0
    good &= np.isfinite(true).all(axis=0)
    error = (np.stack([cloud[a].values for a in "xyz"]) - true)[:, good]
    sigma = np.stack([cloud[f"{a}_uncertainty"].values for a in "xyz"])[:, good]
    inside = [float((np.abs(error) < limit * sigma).mean()) for limit in _LIMITS]
    off = (image["slant_range"] - image["truth_slant_range"]).values[place][good]
    own = image["slant_range_uncertainty"].values[place][good]

    def rms(values: np.ndarray) -> float:
        return float(1e3 * np.sqrt(np.mean(values**2)))

    return {
        "speed": speed, "seed": seed, "points": int(good.sum()),
        "inside_68": inside[0], "inside_95": inside[1],
        "error_mm": rms(error), "uncertainty_mm": rms(sigma),
        "range_error_mm": rms(off), "range_uncertainty_mm": rms(own),
    }  # fmt: skip


def main(path: Path, passes: int) -> None:
    """Append the missing passes to a table, and print the rates by speed."""
    # The constant error of the position is as small as the others.
    survey = Survey.from_toml(SURVEY).with_(
        {
            "scan.columns": 24,
            "scan.rows": 30,
            "platform.navigation.position_uncertainty": 1e-3,
        }
    )
    present = list(csv.DictReader(path.open())) if path.exists() else []
    done = {(float(row["speed"]), int(row["seed"])) for row in present}
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if not present:
            writer.writeheader()
        for seed in range(passes):
            for speed in SPEEDS:
                if (speed, seed) not in done:
                    writer.writerow(measured(survey, speed, seed))
                    file.flush()
    rows = list(csv.DictReader(path.open()))
    for speed in SPEEDS:
        chosen = [row for row in rows if float(row["speed"]) == speed]
        rates = [
            100 * np.mean([float(row[name]) for row in chosen])
            for name in ("inside_68", "inside_95")
        ]
        print(
            f"{speed:g} m/s: {len(chosen)} passes, {rates[0]:.1f} and {rates[1]:.1f} %"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 50)
