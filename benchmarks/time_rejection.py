"""Time of open-water subtraction for one million pixels.

Run with ``python benchmarks/time_rejection.py``. It prints the time of the whole
method, and the time of the correction for the water that the target hides: from the
table, and by integration for each pixel.
"""

from __future__ import annotations

import time

import numpy as np

from amulor import rejection
from amulor.rejection.reference import column as columns
from amulor.simulation import simulate
from amulor.survey import Survey

SURVEY = """
name = "Plate in milky water"
[water]
absorption = "0.255 1/m"
scattering = "0.595 1/m"
forward_fraction = 1.0
second_moment = "0.06 rad^2"
phase_function_at_180 = "0.001 1/sr"
refractive_index = 1.34
group_index = 1.38
backscatter_mueller = [0.81, -0.81, -0.62]
signal_fluctuation = "5 %"
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "1.5 m"]
width = "1 m"
height = "1 m"
reflectance = 0.1
[instrument]
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = ["39 MHz"]
polarizations = ["VV", "VH"]
[instrument.receiver]
position = ["7 cm", "0 m", "0 m"]
azimuth = "-2.672 deg"
radius = "2 cm"
acceptance = "0.08 rad"
[instrument.detector]
optical_transmission = "10 %"
[instrument.lock_in]
time_constant = "10 ms"
phase_floor = "0.06 deg"
[scan]
columns = {columns}
rows = {rows}
azimuth_span = "3.81 deg"
elevation_span = "1.53 deg"
dwell = "125 ms"
[scan.open_water]
columns = 5
rows = 3
repeats = 8
"""


def scene(columns, rows):
    """Return the samples of a small plate scan, two channels, with open water."""
    survey = Survey.from_text(SURVEY.format(columns=columns, rows=rows))
    return simulate(survey, rng=1)


def enlarged(cube, times):
    """Return a cube with its rows repeated, so that large ones need no simulation."""
    rows = np.tile(np.arange(cube.sizes["row"]), times)
    return cube.isel(row=rows)


def column(pixels):
    """Return seconds of the shares by table and by integration, and their error."""
    survey = Survey.from_text(SURVEY.format(columns=2, rows=2))
    rng = np.random.default_rng(2)
    azimuth = np.radians(rng.uniform(-1.9, 1.9, pixels))
    elevation = np.radians(rng.uniform(-0.75, 0.75, pixels))
    depth = rng.uniform(1.4, 1.6, pixels)
    frequency = np.array([39e6])
    begin = time.perf_counter()
    table = columns.fractions(
        survey, azimuth, elevation, depth, modulation_frequency=frequency
    )
    middle = time.perf_counter()
    few = slice(0, 20_000)
    exact = columns.integrated(
        survey,
        np.stack([azimuth[few], elevation[few], depth[few]]),
        frequency,
    )
    end = time.perf_counter()
    return (
        middle - begin,
        (end - middle) * pixels / 20_000,
        float(np.abs(table[:, few] - exact).max()),
    )


def whole(cube):
    """Return the seconds of the whole method."""
    begin = time.perf_counter()
    rejection.open_water(cube)
    return time.perf_counter() - begin


def main(columns=1000, rows=50, times=20):
    """Print all figures and return them."""
    small = scene(columns, rows)
    whole(small.isel(row=slice(0, 2)))
    table, integrated, error = column(columns * rows * times)
    large = enlarged(small, times)
    total = whole(large)
    pixels = large.sizes["row"] * large.sizes["column"]
    print(
        f"column behind the target, {pixels:,} pixels: {table:.2f} s by table, "
        f"{integrated:.1f} s by integration, difference at most {error:.1e}"
    )
    print(f"open_water, {pixels:,} pixels, two channels: {total:.1f} s")
    return table, integrated, error, total


def remember():
    """Measure, print, and add the figures to the history."""
    import history

    table, integrated, _, total = main()
    figures = {
        "column_by_table_s": table,
        "column_by_integration_s": integrated,
        "open_water_of_a_million_pixels_s": total,
    }
    history.append("time_rejection", figures)


if __name__ == "__main__":
    remember()
