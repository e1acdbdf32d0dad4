"""Simulate four lines over an amphora for a patch test, in the present folder.

The stated mounting in rov.toml differs from that of the simulated vehicle. Go on with
amulor calibrate platform; see docs/how-to/vehicle.md.
"""

import math
from pathlib import Path

from amulor import Survey, imaging, io, rejection, simulation
from amulor.io.trajectories import write_trajectory

#: Start (east, north, up) [m], heading [deg] and speed [m/s] of each line.
LINES = {
    "line-1": ((431.00, 87.65, -8.0), 30, 0.15),
    "line-2": ((431.40, 88.35, -8.0), 210, 0.15),
    "line-3": ((430.85, 88.20, -7.6), 120, 0.20),
    "line-4": ((431.55, 87.80, -8.2), 300, 0.12),
}
#: Mounting of the simulated vehicle; the stated one is a little wrong.
TRUE = {
    "lever_arm": (0.012, 0.305, 0.192),
    "pitch": -math.pi / 2,
    "boresight": (0.012, -0.008, 0.015),
    "clock_offset": 0.013,
}
STATED = """\
[mounting]
lever_arm = ["0 m", "0.3 m", "0.2 m"]
pitch = "-90 deg"
lever_arm_uncertainty = "1 cm"
boresight_uncertainty = "1 deg"
clock_uncertainty = "20 ms"
"""

if __name__ == "__main__":
    survey = Survey.from_toml(Path(__file__).with_name("amphora.toml"))
    for number, (name, (start, heading, speed)) in enumerate(LINES.items(), start=1):
        line = survey.with_(
            {
                "scan.columns": 48,
                "scan.rows": 110,
                "scan.azimuth_span": 0.5,
                "scan.dwell": 0.8 / speed / 48 / 110,
                "platform.course.start": start,
                "platform.course.heading": math.radians(heading),
                "platform.course.speed": speed,
                "platform.disturbance.heading": 0.03,
                "platform.disturbance.pitch": 0.06,
                "platform.disturbance.roll": 0.08,
                "platform.navigation": {
                    "interval": 0.05,
                    "position_uncertainty": 0.005,
                    "position_walk": 0.001,
                    "attitude_walk": 1e-4,
                },
                "platform.mounting": TRUE,
            }
        )
        cube = simulation.simulate(line, rng=number, model=simulation.ClosureModel())
        image = imaging.range_image(rejection.open_water(cube))
        image = imaging.flag_mixed(image)
        io.write_cube(image, f"{name}.nc", overwrite=True)
        track = simulation.measured_trajectory(line, rng=number)
        write_trajectory(track, f"{name}.csv", overwrite=True)
    Path("rov.toml").write_text(STATED)
