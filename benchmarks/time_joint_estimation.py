"""Pixels per second of the joint estimation, and a loop of scipy.optimize beside it.

Run with ``python benchmarks/time_joint_estimation.py``. One run prints all figures: the
whole method on a scan, the compiled solver alone, and `scipy.optimize.least_squares`
for some of the same pixels, with the same model, to the same optimum. The loop is timed
twice: from the middle of the right ambiguity interval, which nobody would tell it, and
from as many starts as it takes to find that interval.
"""

from __future__ import annotations

import resource
import time

import history
import numpy as np
from scipy.optimize import least_squares

from amulor.rejection.joint import (
    normal as joint_normal,
)
from amulor.rejection.joint import (
    samples as joint_samples,
)
from amulor.rejection.joint import (
    search as joint_search,
)
from amulor.rejection.joint import (
    shared as joint_shared,
)
from amulor.rejection.joint.estimate import joint
from amulor.rejection.joint.overlap import frame_of
from amulor.rejection.joint.priors import clock_of, trends_of
from amulor.rejection.observation import observe_scan
from amulor.simulation import simulate
from amulor.survey import Survey

SURVEY = """
name = "Inclined plate in a long tank"
[water]
absorption = "0.15 1/m"
scattering = "0.35 1/m"
forward_fraction = 0.95
second_moment = "0.05 rad^2"
phase_function_at_180 = "0.003 1/sr"
refractive_index = 1.34
group_index = 1.38
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "3.9 m"]
rotation = ["0 deg", "20 deg", "0 deg"]
width = "2 m"
height = "2 m"
reflectance = 0.1
[instrument]
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = [{frequencies}]
polarizations = ["VV"]
[instrument.receiver]
position = ["20 cm", "0 m", "0 m"]
azimuth = "-2.9 deg"
radius = "2 cm"
acceptance = "0.08 rad"
[instrument.detector]
optical_transmission = "10 %"
saturation = "100 V"
[instrument.lock_in]
time_constant = "10 ms"
phase_floor = "0.25 deg"
[scan]
columns = {columns}
rows = {rows}
azimuth_span = "4 deg"
elevation_span = "3 deg"
dwell = "125 ms"
"""
FREQUENCIES = np.linspace(5e6, 146e6, 16)
INTERVAL = (1.0, 8.0)
#: How often the whole method gets 100,000 pixels at once.
WHOLE = (1, 10)


def scene(columns, rows):
    """Return samples of a plate in turbid water, 16 frequencies."""
    listed = ", ".join(f'"{f / 1e6:.4f} MHz"' for f in FREQUENCIES)
    text = SURVEY.format(frequencies=listed, columns=columns, rows=rows)
    return simulate(Survey.from_text(text), rng=1)


class Problem:
    """One scan, with the water signal settled."""

    def __init__(self, columns=100, rows=60):
        self.cube = scene(columns, rows)
        scan = observe_scan(self.cube)
        pixels = scan.tile(0, scan.rows)
        azimuth, elevation = pixels.azimuth.ravel(), pixels.elevation.ravel()
        self.frame = frame_of(scan.head, azimuth, elevation)
        self.pixels = joint_samples.pixels_of(
            self.frame,
            pixels.flat(),
            azimuth,
            elevation,
            interval=INTERVAL,
            trends=trends_of(pixels, clock_of(scan)),
        )
        self.transfer = np.ones(FREQUENCIES.size, dtype=complex)
        some = self.pixels.part(np.linspace(0, len(self.pixels) - 1, 256).astype(int))
        self.shared = joint_shared.fit(
            self.frame,
            some,
            None,
            transfer=self.transfer,
            deepest=float(some.depths.max()),
        )

    def solve(self):
        """Return the estimates of all pixels by the compiled solver."""
        return joint_search.estimate(
            self.pixels,
            joint_samples.weight(self.pixels),
            self.shared.table,
            gain=self.shared.gain,
            transfer=self.transfer * (1 + self.shared.echo),
            phase_per_path=self.frame.phase_per_path,
        )

    def residual(self, number):
        """Return the function that scipy minimises for one pixel."""
        pixel = self.pixels.part(np.array([number]))
        weights = joint_samples.weight(pixel)[0, 0]
        root = np.sqrt(weights[0])
        slant = weights[1] / root
        rest = np.sqrt(weights[2] - slant**2)
        full = self.transfer * (1 + self.shared.echo)

        def function(parameter):
            path = np.array([parameter[1]])
            _, water, _ = joint_normal.water_at(
                pixel, path, self.shared.table, self.frame.phase_per_path
            )
            echo = np.exp(1j * path[0] * self.frame.phase_per_path) * full
            left = pixel.signal[0, 0] - self.shared.gain[0] * water[0]
            left = left - self.scale * parameter[0] * echo
            return np.concatenate(
                [root * left.real + slant * left.imag, rest * left.imag]
            )

        return function

    @property
    def scale(self):
        """Return the size of the samples [V]."""
        return float(np.median(np.abs(self.pixels.signal)))


def whole_method(repeats):
    """Return pixels, time [s] and growth of memory [B] of the method on a scan."""
    strip = scene(500, 200)
    lines = np.tile(np.arange(200), repeats)
    names = [name for name in strip.data_vars if str(name).startswith("truth_")]
    cube = strip.drop_vars(names).isel(row=lines)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.perf_counter()
    joint(cube, interval=INTERVAL)
    taken = time.perf_counter() - begin
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return cube["azimuth"].size, taken, (after - before) * 1024


def scipy_loop(problem, numbers, starts):
    """Return the best paths by least_squares and the time for each pixel [s]."""
    paths = []
    begin = time.perf_counter()
    for k, number in enumerate(numbers):
        function = problem.residual(number)
        best = min(
            (
                least_squares(function, [1.0, start], xtol=1e-12, x_scale=[1.0, 0.1])
                for start in starts[k]
            ),
            key=lambda result: result.cost,
        )
        paths.append(best.x[1])
    return np.array(paths), (time.perf_counter() - begin) / len(numbers)


def main():
    """Print the figures."""
    problem = Problem()
    problem.solve()  # the first call compiles or loads the kernel
    best = np.inf
    for _ in range(5):
        begin = time.perf_counter()
        found = problem.solve()
        best = min(best, time.perf_counter() - begin)
    each = best / len(problem.pixels)
    numbers = np.linspace(0, len(problem.pixels) - 1, 12).astype(int)
    period = 2 * np.pi / problem.frame.phase_per_path.max()
    near = [[found.path[n] + 0.02 * period] for n in numbers]
    first, last = problem.pixels.shortest.min(), problem.pixels.longest.max()
    every = [np.arange(first, last, period / 2)] * len(numbers)
    guided, seconds = scipy_loop(problem, numbers, near)
    blind, longer = scipy_loop(problem, numbers, every)
    print(f"16 frequencies, slant ranges from {INTERVAL[0]:g} to {INTERVAL[1]:g} m")
    print(f"compiled solver           {1 / each:10.0f} pixels/s")
    figures = {"solver_pixels_per_s": 1 / each}
    for repeats in WHOLE:
        size, seconds_taken, memory = whole_method(repeats)
        print(
            f"whole method, {size:9d} {size / seconds_taken:10.0f} pixels/s"
            f"   {seconds_taken:.1f} s, {memory / size:.0f} bytes/pixel at most"
        )
        figures[f"whole_method_of_{size}_pixels_per_s"] = size / seconds_taken
    print(f"least_squares, told where {1 / seconds:10.1f} pixels/s", end="")
    print(f"   solver faster {seconds / each:6.0f} times")
    print(f"least_squares, all starts {1 / longer:10.1f} pixels/s", end="")
    print(f"   solver faster {longer / each:6.0f} times")
    apart = max(
        np.max(np.abs(guided - found.path[numbers])),
        np.max(np.abs(blind - found.path[numbers])),
    )
    print(f"largest difference of the optical paths {apart * 1e6:.2g} um")
    figures["least_squares_told_where_over_solver"] = seconds / each
    figures["least_squares_all_starts_over_solver"] = longer / each
    history.append("time_joint_estimation", figures)


if __name__ == "__main__":
    main()
