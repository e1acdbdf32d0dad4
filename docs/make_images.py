"""Draws the pictures of the README and of docs from runs of the product itself."""

from __future__ import annotations

import contextlib
import re
import runpy
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

import amulor
from amulor import Survey, imaging, io, rejection, simulation
from amulor.imaging.beam_profile import beam_profile
from amulor.io.trajectories import (
    TrajectoryMap,
    read_trajectory,
    trajectory_from_table,
)
from amulor.platform import read_mounting
from amulor.studies import ladder
from amulor.studies.ladder import Case
from amulor.view import figures
from amulor.view.beam_profile import write_profile
from amulor.view.patch_test import write_patch_test
from amulor.view.report import png
from amulor.view.style import COLOURS, new_figure, style
from amulor.view.trajectory import write_figure

FOLDER = Path(__file__).parent / "images"
#: What the landing page shows: the channel and water that the water signal moves most.
SHOWN = "VV milk"
#: Plate of which two simulated scans make a net before a wall.
NET = """
name = "Net before a wall"
[water]
absorption = "0.1 1/m"
scattering = "0.8 1/m"
forward_fraction = 0.98
second_moment = "0.005 rad^2"
phase_function_at_180 = "0.003 1/sr"
refractive_index = 1.34
group_index = 1.38
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "{distance} m"]
reflectance = 0.05
width = "1 m"
height = "1 m"
[instrument]
phase_uncertainty = "0 deg"
wavelength = "405 nm"
power = "3 uW"
modulation_depth = 1.0
modulation_frequencies = {frequencies}
polarizations = ["none"]
[instrument.receiver]
position = ["3 cm", "0 m", "0 m"]
radius = "2 cm"
acceptance = "0.08 rad"
[scan]
columns = 3
rows = 3
azimuth_span = "2 deg"
elevation_span = "2 deg"
dwell = "100 ms"
[scan.open_water]
columns = 3
rows = 3
"""


def before_and_after(
    images: Sequence[xr.Dataset], titles: Sequence[str], limits: tuple[float, float]
) -> Figure:
    """Draw distance across a scan, recorded and corrected, with the true one [mm]."""
    with style():
        drawn = new_figure(5.6, 2.9)
        panels = drawn.subplots(1, 2, sharex=True, sharey=True)
        # In the shadow of a step the receiver sees water only.
        shaded = images[-1]["slant_range"].isnull().any("row").values
        for colour, panel, image, title in zip(
            COLOURS[1::-1], panels, images, titles, strict=True
        ):
            across, true = _across(image, "truth_slant_range")
            _, measured = _across(image, "slant_range")
            measured[:, shaded] = np.nan
            low, middle, high = np.quantile(measured, [0.025, 0.5, 0.975], axis=0)
            panel.fill_between(across, low, high, color=colour, alpha=0.25, linewidth=0)
            panel.plot(across, middle, color=colour, linewidth=1.4)
            truth = np.median(true, axis=0)
            panel.plot(across, truth, color="black", linewidth=0.9, linestyle="--")
            panel.set_xlabel("across the scan [mm]")
            panel.set_title(title)
        panels[0].set_ylabel("distance [mm]")
        panels[0].set_ylim(*limits)
    return drawn


def milk(cases: Sequence[Case]) -> Figure:
    """Draw the ladder in milk, in the channel that the water moves most."""
    before, after = (case for case in cases if case.name == SHOWN)
    return before_and_after(
        [before.image, after.image],
        [
            f"as recorded: {-before.bias * 1e3:.0f} mm too near",
            f"corrected: right, {after.bias * 1e3:+.1f} "
            f"± {after.bias_uncertainty * 1e3:.1f} mm",
        ],
        (1530, 1330),
    )


def plate() -> Figure:
    """Draw the plate of the tutorial."""
    page = (FOLDER.parent / "tutorial.md").read_text("utf-8")
    survey = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)[0]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tank.toml"
        file.write_text(survey, "utf-8")
        samples = amulor.simulate(amulor.Survey.from_toml(file), rng=1)
    images = [
        amulor.imaging.range_image(
            amulor.rejection.reject(samples, method=method), polarization="VV"
        )
        for method in ("none", "open-water")
    ]
    return before_and_after(
        images,
        [
            f"{name}: {float(image['slant_range'].median()):.3f} m (median)"
            for name, image in zip(("before.nc", "after.nc"), images, strict=True)
        ],
        (1510, 1450),
    )


def _across(
    image: xr.Dataset, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place across the beam, and distance along the axis of the scan [mm]."""
    azimuth, elevation = image["azimuth"], image["elevation"]
    distance = image[name] * np.cos(azimuth) * np.cos(elevation) * 1e3
    place = np.tan(azimuth).median("row") * float(np.nanmedian(distance))
    return place.values, distance.values


def vehicle_pass(survey: Survey) -> Figure:
    """Draw points of a simulated scan from a vehicle, and errors of their height."""
    cube = amulor.simulate(survey, rng=1)
    image = imaging.range_image(rejection.open_water(cube))
    track = simulation.measured_trajectory(survey, rng=1)
    frame = imaging.moving_frame(image, trajectory=track)
    cloud = imaging.point_cloud(image, frame=frame)
    place = cloud["row"].values, cloud["column"].values
    error = cloud["z"].values - image["truth_up"].values[place]
    with style():
        drawn = new_figure(7.2, 3.4)
        panels = drawn.subplots(1, 2, sharex=True, sharey=True)
        for panel, values, label, options in zip(
            panels,
            (cloud["z"].values, 1e3 * (error - np.nanmedian(error))),
            ("height [m]", "error of the height [mm]"),
            ({}, {"cmap": "RdBu", "vmin": -2, "vmax": 2}),
            strict=True,
        ):
            points = panel.scatter(
                cloud["x"] - 431, cloud["y"] - 88, c=values, s=0.8, **options
            )
            drawn.colorbar(points, ax=panel, label=label)
            panel.set_aspect("equal")
            panel.set_xlabel("east - 431 m [m]")
        panels[0].set_ylabel("north - 88 m [m]")
    return drawn


def patch_test(script: Path, picture: Path) -> None:
    """Simulate the lines of the example, and draw their patch test."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        runpy.run_path(str(script), run_name="__main__")
        names = [f"line-{number}" for number in range(1, 5)]
        result = imaging.patch_test(
            [io.read_cube(f"{name}.nc") for name in names],
            trajectories=[read_trajectory(f"{name}.csv") for name in names],
            mounting=read_mounting("rov.toml"),
        )
        write_patch_test(picture, result, overwrite=True)


def range_profile(picture: Path) -> None:
    """Simulate a net before a wall, and draw the range profile of a pixel."""
    frequencies = [f"{frequency} MHz" for frequency in range(100, 1001, 20)]
    scan, net = (
        amulor.simulate(
            Survey.from_text(NET.format(distance=distance, frequencies=frequencies)),
            rng=1,
        )
        for distance in (2.0, 1.8)
    )
    for part in ("in_phase", "quadrature"):
        scan[part].values += 0.3 * net[f"truth_target_{part}"].values
    beam = beam_profile(
        rejection.open_water(scan), row=1, column=1, interval=(0.5, 3.5)
    )
    write_profile(picture, beam, title="target.nc: row 1, column 1", overwrite=True)


def main() -> None:
    """Run the demo with its own seed and draw its figures."""
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        cases = ladder.run(Path(folder), rng=1)
    images: dict[str, dict[str, object]] = {}
    for case in cases:
        images.setdefault(case.name, {})[case.stage] = case.image
    after = {name: stages["after"] for name, stages in images.items()}
    for name, figure in (
        ("ladder-milk", milk(cases)),
        ("tutorial-plate", plate()),
        ("ladder-profiles", figures.profiles(images)),
        ("ladder-surfaces", figures.surfaces(after)),
    ):
        (FOLDER / f"{name}.png").write_bytes(png(figure, dots_per_inch=130))
    example = Path(__file__).parents[1] / "examples" / "vehicle"
    described = TrajectoryMap.from_toml(example / "columns.toml")
    track = trajectory_from_table(example / "rov.csv", described)
    write_figure(FOLDER / "vehicle" / "track.png", track, overwrite=True)
    figure = vehicle_pass(Survey.from_toml(example / "amphora.toml"))
    (FOLDER / "vehicle" / "amphora.png").write_bytes(png(figure, dots_per_inch=130))
    patch_test(example / "make_lines.py", FOLDER / "vehicle" / "patch.png")
    range_profile(FOLDER / "range-profile.png")


if __name__ == "__main__":
    main()
