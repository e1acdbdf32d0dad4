"""The ladder of Ricci et al. 2010, section 9: four pictures, before and after."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import _extras, imaging, io, rejection
from amulor.imaging import metrics
from amulor.io.files import atomic_output
from amulor.simulation import simulate
from amulor.survey import Staircase, Survey

#: Called with what is done now and the share of the work done before it.
Progress = Callable[[str, float], None]

WATERS = ("clear", "milk")
CHANNELS = ("VH", "VV")
STAGES = ("before", "after")
_CLOUDS = ("ply", "laz", "e57")
#: Pixels nearer than this to the edge of a tread are left out of the numbers: there
#: one tread hides the other from the receiver [m].
_MARGIN = 3e-3


@dataclass(frozen=True)
class Case:
    """One water and one channel, before or after rejection."""

    water: str
    """Which water."""
    channel: str
    """Which polarization pair."""
    stage: str
    """Before or after rejection."""
    image: xr.Dataset
    """Range image."""
    steps: list[metrics.StepHeight]
    """Measured heights of the steps."""
    true_steps: tuple[float, ...]
    """Heights of the steps as they are [m]."""
    bias: float
    """Mean error of the slant range on the treads [m]."""
    noise: float
    """Scatter of the slant range among the rows of each column, on the treads [m]."""
    stated: float
    """Root mean square of the uncertainty stated for the treads [m]."""

    @property
    def name(self) -> str:
        """Channel and water, as the figures call the case."""
        return f"{self.channel} {self.water}"


def survey_text(water: str) -> str:
    """Return the survey file of one of the two waters.

    Parameters
    ----------
    water : str
        "clear" or "milk".

    Returns
    -------
    str
        TOML.
    """
    folder = resources.files("amulor.survey") / "examples"
    return (folder / f"ladder_{water}.toml").read_text(encoding="utf-8")


def treads(survey: Survey) -> NDArray[np.intp]:
    """Return which tread each pixel looks at, counted 1, 2, ... from the left.

    Parameters
    ----------
    survey : Survey
        Its first target is a staircase that faces the emitter.

    Returns
    -------
    ndarray of int, shape (row, column)
        0 near the edges of the treads.
    """
    stairs = survey.targets[0]
    assert isinstance(stairs, Staircase)
    scan = survey.scan
    azimuth = np.linspace(-0.5, 0.5, scan.columns) * scan.azimuth_span
    depth = stairs.position[2] - np.concatenate([[0.0], np.cumsum(stairs.step_heights)])
    edges = (np.arange(len(depth) + 1) - len(depth) / 2) * stairs.tread_width
    number = np.zeros(scan.columns, dtype=np.intp)
    for i, distance in enumerate(depth):
        right = distance * np.tan(azimuth)
        number[(right > edges[i] + _MARGIN) & (right < edges[i + 1] - _MARGIN)] = i + 1
    return np.broadcast_to(number, (scan.rows, scan.columns))


def evaluate(
    survey: Survey, image: xr.Dataset, *, water: str, channel: str, stage: str
) -> Case:
    """Compare a range image of the ladder with the ladder.

    Parameters
    ----------
    survey : Survey
        What was simulated.
    image : xarray.Dataset
        Its range image, with the truth in it.
    water, channel, stage : str
        Which case it is.

    Returns
    -------
    Case
        Steps, bias and noise.
    """
    stairs = survey.targets[0]
    assert isinstance(stairs, Staircase)
    number = treads(survey)
    error = image["slant_range"].values - image["truth_slant_range"].values
    error = np.where(number > 0, error, np.nan)[:, (number > 0).any(axis=0)]
    sigma = image["slant_range_uncertainty"].values[number > 0]
    return Case(
        water=water,
        channel=channel,
        stage=stage,
        image=image,
        steps=metrics.step_heights(image, number),
        true_steps=stairs.step_heights,
        bias=float(np.nanmean(error)),
        noise=float(np.sqrt(np.nanmean(np.nanvar(error, axis=0, ddof=1)))),
        stated=float(np.sqrt(np.nanmean(sigma**2))),
    )


def run(
    folder: Path,
    *,
    seed: int = 1,
    overwrite: bool = False,
    progress: Progress = lambda step, share: None,
) -> list[Case]:
    """Scan the ladder in both waters and write all that comes of it.

    Parameters
    ----------
    folder : pathlib.Path
        Where surveys, cubes, range images, point clouds, `steps.json` and
        `report.html` go; made if it is not there.
    seed : int
        Seed of the noise.
    overwrite : bool
        Whether files that are there may be replaced.
    progress : callable, optional
        Called with a step and the share of the work done before it.

    Returns
    -------
    list of Case
        Two waters, two channels, before and after rejection.

    Raises
    ------
    FormatError
        If a file exists, or the folder cannot be written.
    MissingExtraError
        If the packages of the extras `scene` and `export` are not installed.
    """
    from amulor.studies import ladder_report

    _extras.require("scene", "export", purpose="the ladder")
    io.make_folder(folder)
    for name in output_names():
        io.check_output(folder / name, overwrite=overwrite)
    cases: list[Case] = []
    surveys, samples = {}, {}
    for done, water in enumerate(WATERS):
        start = 0.4 * done
        text = survey_text(water)
        survey = Survey.from_text(text, name=f"ladder_{water}.toml")
        with atomic_output(
            folder / f"ladder_{water}.toml", overwrite=overwrite
        ) as temporary:
            temporary.write_text(text, encoding="utf-8")
        progress(f"simulating the scan in {water} water", start)
        measured = simulate(survey, rng=seed + done)
        io.write_cube(
            measured, folder / f"ladder_{water}_samples.nc", overwrite=overwrite
        )
        progress(f"taking the water signal out, {water}", start + 0.15)
        stages = {
            "before": rejection.keep_water(measured),
            "after": rejection.open_water(measured),
        }
        io.write_cube(
            stages["after"],
            folder / f"ladder_{water}_target_signal.nc",
            overwrite=overwrite,
        )
        for number, channel in enumerate(CHANNELS):
            progress(
                f"range image and point cloud, {channel} {water}",
                start + 0.25 + 0.07 * number,
            )
            for stage in STAGES:
                image = imaging.range_image(stages[stage], polarization=channel)
                cases.append(
                    evaluate(survey, image, water=water, channel=channel, stage=stage)
                )
            _write_images(folder, cases[-1], overwrite=overwrite)
        surveys[water], samples[water] = text, measured
    progress("drawing the report", 0.8)
    with atomic_output(folder / "steps.json", overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(summary(cases), indent=2) + "\n")
    ladder_report.write(
        folder / "report.html", cases, surveys, samples, overwrite=overwrite
    )
    progress("done", 1.0)
    return cases


def output_names() -> list[str]:
    """Return the names of all files that `run` writes.

    Returns
    -------
    list of str
        Names in the folder.
    """
    names = ["report.html", "steps.json"]
    for water in WATERS:
        stem = f"ladder_{water}"
        names += [f"{stem}.toml", f"{stem}_samples.nc", f"{stem}_target_signal.nc"]
        for channel in CHANNELS:
            names.append(f"{stem}_{channel}_range.nc")
            names += [f"{stem}_{channel}.{suffix}" for suffix in _CLOUDS]
    return names


def summary(cases: list[Case]) -> list[dict[str, object]]:
    """Return the numbers of all cases for other programs.

    Parameters
    ----------
    cases : list of Case
        What `run` returns.

    Returns
    -------
    list of dict
        Lengths in metres.
    """
    return [
        {
            "water": case.water,
            "channel": case.channel,
            "stage": case.stage,
            "range_bias_m": case.bias,
            "range_noise_m": case.noise,
            "range_uncertainty_m": case.stated,
            "steps": [
                {
                    "true_m": true,
                    "height_m": step.height,
                    "uncertainty_m": step.uncertainty,
                }
                for true, step in zip(case.true_steps, case.steps, strict=True)
            ],
        }
        for case in cases
    ]


def _write_images(folder: Path, case: Case, *, overwrite: bool) -> None:
    stem = f"ladder_{case.water}_{case.channel}"
    io.write_cube(case.image, folder / f"{stem}_range.nc", overwrite=overwrite)
    cloud = imaging.point_cloud(case.image)
    rows, columns = case.image["quality_flag"].shape
    shape = (rows, columns)
    for suffix in _CLOUDS:
        io.write_cloud(
            cloud, folder / f"{stem}.{suffix}", shape=shape, overwrite=overwrite
        )
