"""The ladder of Ricci et al. 2010, section 9: four pictures, before and after."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np

from amulor import _extras, imaging, io, rejection
from amulor._progress import part
from amulor.io.files import atomic_output
from amulor.simulation import simulate
from amulor.studies import ladder_report
from amulor.studies.ladder_case import (
    CHANNELS,
    STAGES,
    WATERS,
    Case,
    evaluate,
    summary,
)
from amulor.survey import Survey

__all__ = [
    "CHANNELS",
    "STAGES",
    "WATERS",
    "Case",
    "left_out",
    "output_names",
    "run",
    "summary",
    "survey_text",
]

#: Called with what is done now and the fraction of the work done before it.
Progress = Callable[[str, float], None]

#: Packages that write point clouds of some formats.
_WRITERS = {"laz": "lazrs", "e57": "pye57"}


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


def run(
    folder: Path,
    *,
    rng: np.random.Generator | int = 1,
    overwrite: bool = False,
    progress: Progress = lambda step, done: None,
) -> list[Case]:
    """Scan the ladder in both waters and write all that comes of it.

    Point clouds are in PLY, and in LAZ and E57 where there is a package for these.

    Parameters
    ----------
    folder : pathlib.Path
        Where surveys, cubes, range images, point clouds, `steps.json` and
        `report.html` go; made if it is not there.
    rng : numpy.random.Generator or int
        Source of the noise; a whole number is a seed: of the first water, and one more
        of each that follows.
    overwrite : bool
        Whether files that are there may be replaced.
    progress : callable, optional
        Called with a step and the fraction of the work done before it.

    Returns
    -------
    list of Case
        Two waters, two channels, before and after rejection.

    Raises
    ------
    FormatError
        If a file exists, or the folder cannot be written.
    """
    io.make_folder(folder)
    for name in output_names():
        io.check_output(folder / name, overwrite=overwrite)
    cases: list[Case] = []
    surveys, samples = {}, {}
    sources: list[np.random.Generator | int]
    if isinstance(rng, np.random.Generator):
        sources = [*rng.spawn(len(WATERS))]
    else:
        sources = [rng + number for number in range(len(WATERS))]
    for done, (water, source) in enumerate(zip(WATERS, sources, strict=True)):
        start = 0.4 * done
        text = survey_text(water)
        survey = Survey.from_text(text, name=f"ladder_{water}.toml")
        with atomic_output(
            folder / f"ladder_{water}.toml", overwrite=overwrite
        ) as temporary:
            temporary.write_text(text, encoding="utf-8")
        progress(f"simulating the scan in {water} water", start)
        with part(start, start + 0.15):
            measured = simulate(survey, rng=source)
        io.write_cube(
            measured, folder / f"ladder_{water}_samples.nc", overwrite=overwrite
        )
        progress(f"taking the water signal out, {water}", start + 0.15)
        with part(start + 0.15, start + 0.25):
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
            done_so_far = start + 0.25 + 0.07 * number
            progress(f"range image and point cloud, {channel} {water}", done_so_far)
            for stage in STAGES:
                with part(done_so_far, done_so_far + 0.07):
                    image = imaging.range_image(stages[stage], polarization=channel)
                image = imaging.flag_outliers(imaging.flag_mixed(image))
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
            names += [f"{stem}_{channel}.{suffix}" for suffix in _clouds()]
    return names


def left_out() -> dict[str, str]:
    """Return the formats of point clouds that cannot be written here.

    Returns
    -------
    dict of str to str
        Extra of the package that each format needs.
    """
    return _extras.left_out(_WRITERS)


def _clouds() -> list[str]:
    return [suffix for suffix in ("ply", *_WRITERS) if suffix not in left_out()]


def _write_images(folder: Path, case: Case, *, overwrite: bool) -> None:
    stem = f"ladder_{case.water}_{case.channel}"
    io.write_cube(case.image, folder / f"{stem}_range.nc", overwrite=overwrite)
    cloud = imaging.point_cloud(case.image)
    for suffix in _clouds():
        io.write_cloud(cloud, folder / f"{stem}.{suffix}", overwrite=overwrite)
