"""Simulate three lines over an amphora on a rippled bed, in the present folder.

The vehicle and its mounting are those of make_lines.py. Go on with amulor site; see
docs/how-to/vehicle.md.
"""

import math
from pathlib import Path

import numpy as np
from make_lines import TRUE

from amulor import Survey, imaging, io, rejection, simulation
from amulor.io.trajectories import write_trajectory

#: Start (east, north, up) [m], heading [deg] and speed [m/s] of each line.
LINES = {
    "survey-1": ((430.72, 87.78, -8.0), 30, 0.15),
    "survey-2": ((431.68, 88.22, -8.0), 210, 0.15),
    "survey-3": ((430.68, 88.30, -7.9), 120, 0.15),
}
#: Length of a line [m], its rows and columns.
LENGTH, ROWS, COLUMNS = 1.2, 170, 56


def write_bed(path: Path) -> None:
    """Write a sea bed with ripples of 6 cm as a mesh: right, down, forward."""
    size, half = 121, 2.0
    right, down = np.meshgrid(*[np.linspace(-half, half, size)] * 2)
    ripples = 0.06 * np.sin(4.1 * right + 0.4) * np.cos(3.3 * down + 1.0)
    ripples += 0.03 * np.sin(6.7 * down - 3.9 * right)
    corners = np.stack([right, down, ripples], axis=-1).reshape(-1, 3)
    first = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    faces = [
        face
        for a in first
        for face in ((a, a + 1, a + size), (a + 1, a + size + 1, a + size))
    ]
    lines = [
        "ply", "format ascii 1.0", f"element vertex {len(corners)}",
        "property float x", "property float y", "property float z",
        f"element face {len(faces)}", "property list uchar int vertex_indices",
        "end_header",
        *(" ".join(f"{value:.6f}" for value in corner) for corner in corners),
        *(f"3 {a} {b} {c}" for a, b, c in faces),
    ]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    write_bed(Path("bed.ply"))
    survey = Survey.from_toml(Path(__file__).with_name("amphora.toml"))
    amphora = survey.targets[1].model_dump()
    bed = {
        "kind": "mesh",
        "file": str(Path("bed.ply").resolve()),
        "position": (0.0, 0.0, 2.0),
        "reflectance": 0.15,
    }
    for number, (name, (start, heading, speed)) in enumerate(LINES.items(), start=11):
        line = survey.with_(
            {
                "targets": [bed, amphora],
                "scan.columns": COLUMNS,
                "scan.rows": ROWS,
                "scan.azimuth_span": 0.55,
                "scan.dwell": LENGTH / speed / COLUMNS / ROWS,
                "platform.course.start": start,
                "platform.course.heading": math.radians(heading),
                "platform.course.speed": speed,
                "platform.navigation": {
                    "interval": 0.05,
                    "position_uncertainty": 0.02,
                    "position_walk": 0.003,
                    "attitude_walk": 2e-4,
                },
                "platform.mounting": TRUE,
            }
        )
        cube = simulation.simulate(line, rng=number, model=simulation.ClosureModel())
        image = imaging.range_image(rejection.open_water(cube))
        image = imaging.flag_outliers(imaging.flag_mixed(image))
        io.write_cube(image, f"{name}.nc", overwrite=True)
        track = simulation.measured_trajectory(line, rng=number)
        write_trajectory(track, f"{name}.csv", overwrite=True)
