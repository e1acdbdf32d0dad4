"""A survey and a goal that are quick to work on."""

from __future__ import annotations

import pytest

from amulor.design import Goal
from amulor.survey import Survey

SURVEY = """
name = "Plate"
[water]
absorption = "0.1 1/m"
scattering = "0.25 1/m"
asymmetry = 0.95
refractive_index = 1.34
group_index = 1.38
backscatter_mueller = [0.85, -0.85, -0.7]
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "2 m"]
width = "60 cm"
height = "60 cm"
reflectance = 0.2
mueller = [0.4, -0.4, -0.2]
[instrument]
phase_uncertainty = "0 deg"
wavelength = "532 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = ["39 MHz"]
polarizations = ["VH"]
[instrument.receiver]
position = ["10 cm", "0 m", "0 m"]
azimuth = "-0.05 rad"
radius = "2 cm"
acceptance = "0.06 rad"
[instrument.detector]
optical_transmission = "30 %"
dark_rate = "1 kHz"
[instrument.lock_in]
time_constant = "1 ms"
phase_floor = "0.02 deg"
[scan]
columns = 6
rows = 5
azimuth_span = "0.5 deg"
elevation_span = "0.4 deg"
dwell = "20 ms"
[scan.open_water]
columns = 3
rows = 3
repeats = 20
"""

GOAL = """
name = "Tank"
distances = ["1.5 m", "2.5 m"]
[interval]
nearest = "0.5 m"
farthest = "4 m"
[accuracy]
total_error = "3 mm"
[waters.base]
absorption = "0.1 1/m"
scattering = "0.25 1/m"
asymmetry = 0.95
refractive_index = 1.34
group_index = 1.38
backscatter_mueller = [0.85, -0.85, -0.7]
[waters]
attenuation = {low = "0.2 1/m", high = "0.6 1/m", distribution = "log-uniform"}
fluctuation = {low = "1 %", high = "5 %"}
[targets]
reflectance = {low = 0.1, high = 0.3}
mueller = [0.4, -0.4, -0.2]
[scan]
columns = 40
rows = 30
azimuth_span = "4 deg"
elevation_span = "3 deg"
longest = "4 min"
[[components.lasers]]
name = "green"
wavelength = "532 nm"
powers = ["10 mW", "30 mW"]
[components]
polarizations = ["VH", "VV"]
methods = ["open-water"]
[components.modulation]
frequencies = ["15 MHz", "34 MHz", "52 MHz", "75 MHz", "120 MHz"]
most = 2
[components.baseline]
values = ["6 cm", "20 cm"]
[components.radius]
values = ["1 cm", "2 cm"]
[components.field_of_view]
values = ["2 deg", "4 deg"]
[components.dwell]
values = ["30 ms", "60 ms", "120 ms"]
[detector]
optical_transmission = "30 %"
[lock_in]
time_constant = "5 ms"
phase_floor = "0.03 deg"
[effort]
draws = 8
refined = 2
"""


@pytest.fixture(scope="session")
def tank() -> Survey:
    """Return a survey of a plate at 2 m."""
    return Survey.from_text(SURVEY)


@pytest.fixture(scope="session")
def goal_text() -> str:
    """Return a goal file with a few of everything."""
    return GOAL


@pytest.fixture(scope="session")
def goal(goal_text: str) -> Goal:
    return Goal.from_text(goal_text)
