"""Ladder study: simulated scans in clear and milky water, with water rejection."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import _extras, imaging, io, pipeline, rejection
from amulor._progress import part
from amulor.imaging import metrics
from amulor.io.files import atomic_output
from amulor.simulation import simulate
from amulor.survey import Staircase, Survey
from amulor.view import (
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    figures,
    write_report,
)
from amulor.view.accuracy import error_budgets
from amulor.view.image_report import flag_sentence, interactive
from amulor.view.report import Part

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


WATERS = ("clear", "milk")
CHANNELS = ("VH", "VV")
STAGES = ("before", "after")
#: Pixels nearer than this to the edge of a tread are left out of the numbers: there
#: one tread hides the other from the receiver [m].
_MARGIN = 3e-3


@dataclass(frozen=True, kw_only=True)
class Case:
    """Range image of the ladder in one water and channel, before or after rejection."""

    water: str
    """Name of the water: "clear" or "milk"."""
    channel: str
    """Polarization channel, such as "VH"."""
    stage: str
    """Processing stage: "before" or "after" water rejection."""
    image: xr.Dataset
    """Range image."""
    steps: list[metrics.StepHeight]
    """Measured step heights."""
    true_steps: tuple[float, ...]
    """True step heights [m]."""
    bias: float
    """Mean error of the slant range on the treads [m]."""
    bias_uncertainty: float
    """Standard uncertainty of the mean error, common errors included [m]."""
    noise: float
    """Standard deviation of the slant range between rows, on the treads [m]."""
    stated: float
    """Root mean square of the stated uncertainty on the treads; NaN before [m]."""

    @property
    def name(self) -> str:
        """Name of the case for figures, from its channel and water."""
        return f"{self.channel} {self.water}"


def treads(survey: Survey) -> NDArray[np.intp]:
    """Return tread numbers of pixels, from 1 at the left; 0 near edges and outside."""
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
    """Compare a range image of the ladder with the true geometry."""
    stairs = survey.targets[0]
    assert isinstance(stairs, Staircase)
    number = treads(survey)
    error = image["slant_range"].values - image["truth_slant_range"].values
    error = np.where(number > 0, error, np.nan)[:, (number > 0).any(axis=0)]
    sigma = image["slant_range_uncertainty"].values[number > 0]
    noise = float(np.sqrt(np.nanmean(np.nanvar(error, axis=0, ddof=1))))
    shared = 0.0
    if stage == "after":
        common = image["slant_range_common_uncertainty"].values[number > 0]
        shared = float(np.sqrt(np.nanmean(common**2)))
    count = np.count_nonzero(np.isfinite(error))
    return Case(
        water=water,
        channel=channel,
        stage=stage,
        image=image,
        steps=metrics.step_heights(image, number),
        true_steps=stairs.step_heights,
        bias=float(np.nanmean(error)),
        bias_uncertainty=math.hypot(noise / math.sqrt(count), shared),
        noise=noise,
        stated=float(np.sqrt(np.mean(sigma[np.isfinite(sigma)] ** 2)))
        if np.isfinite(sigma).any()
        else math.nan,
    )


def summary(cases: list[Case]) -> list[dict[str, object]]:
    """Return the results of all cases as plain numbers and texts, for JSON."""
    return [
        {
            "water": case.water,
            "channel": case.channel,
            "stage": case.stage,
            "range_bias_m": case.bias,
            "range_bias_uncertainty_m": case.bias_uncertainty,
            "range_noise_m": case.noise,
            "range_uncertainty_m": _known(case.stated),
            "steps": [
                {
                    "true_m": true,
                    "height_m": step.height,
                    "uncertainty_m": _known(step.uncertainty),
                }
                for true, step in zip(case.true_steps, case.steps, strict=True)
            ],
        }
        for case in cases
    ]


def _known(value: float) -> float | None:
    """Return a number, or None for infinity and NaN."""
    return value if math.isfinite(value) else None


def write(
    path: Path,
    cases: list[Case],
    surveys: Mapping[str, str],
    samples: Mapping[str, xr.Dataset],
    *,
    overwrite: bool,
) -> None:
    """Write the report of the study as one HTML file."""
    names = list(dict.fromkeys(case.name for case in cases))
    images = {
        name: {case.stage: case.image for case in cases if case.name == name}
        for name in names
    }
    after = {name: stages["after"] for name, stages in images.items()}
    parts: list[Part] = [
        Paragraph(_result(cases)),
        Paragraph(
            "The target is a painted metal ladder, 1.5 m away under water: a first "
            "step of 40 mm, then three of 10 mm. A blue laser, modulated at 39 MHz, "
            "scans 100 by 40 pixels of 1 mm. The phase of the echo gives the distance. "
            "The water also scatters light back. This water signal is added to every "
            "sample and shortens the measured distance. Here it is measured once "
            "without the ladder and subtracted, in clear and in milky water. All data "
            "are simulated after Ricci et al. 2010; nothing here was measured."
        ),
        Table(
            ["term", "meaning"],
            [
                ["slant range", "distance along the laser beam to the surface"],
                ["tread", "flat surface of a step of the ladder"],
                ["VV, VH", "receiver behind a parallel, or a crossed, polarizer"],
                ["rejection", "subtraction of the water signal"],
                ["flag", "mark on a pixel whose range must not be trusted"],
                ["a ± b", "value and its standard uncertainty (k = 1)"],
            ],
            "Terms of this report. All lengths in tables are in millimeters.",
        ),
        Heading("Result"),
        _ranges_table(cases),
        _steps_table(cases),
        Heading("The ladder in space"),
        Picture(
            figures.surfaces(after),
            "Range images after rejection. Height is positive towards the instrument. "
            "In the dark gap the first step hides the ladder from the receiver.",
        ),
        *interactive(after),
        Heading("All 40 line profiles over each other"),
        Picture(
            figures.profiles(images),
            "Before rejection the treads seem too near, more so at the right where the "
            "beam is nearer to the receiver's axis. After rejection they are level. "
            "The scatter that remains in milk is the fluctuation of the water signal. "
            "Spikes beside the steps are pixels hidden from the receiver. Before "
            "rejection they show the distance of the water. After it they are left "
            "out, except a few that the receiver sees in part.",
        ),
    ]
    for water, cube in samples.items():
        parts += [
            Heading(f"Samples in {water} water"),
            Picture(
                figures.signal_images(cube),
                f"Amplitude and phase of the lock-in samples at 39 MHz in {water} "
                "water, as recorded.",
            ),
        ]
    for name, stages in images.items():
        parts += [
            Heading(f"Range, {name}"),
            Picture(
                figures.range_images(stages["before"], stages["after"]),
                flag_sentence(stages["after"]),
            ),
        ]
    last = names[-1]
    parts += error_budgets({last: after[last]})
    parts.append(Heading("The surveys used"))
    parts += [Listing(f"ladder_{water}.toml", text) for water, text in surveys.items()]
    first = next(iter(samples.values()))
    seeds = " and ".join(str(cube.attrs["seed"]) for cube in samples.values())
    versions = json.loads(first.attrs["software_versions"])
    software = ", ".join(f"{name} {version}" for name, version in versions.items())
    parts.append(Paragraph(f"Seeds of the noise: {seeds}. Made with {software}."))
    title = "Underwater ladder: four range images, before and after rejection"
    write_report(path, title, parts, overwrite=overwrite)


def _result(cases: list[Case]) -> str:
    """Format the main result of the study as a sentence."""
    before, after = cases[-2:]
    return (
        f"Result: in {'milky' if after.water == 'milk' else after.water} water the "
        f"ladder seems {abs(before.bias) * 1e3:.0f} mm too near. After subtraction of "
        f"the water signal the mean error is {mean_error(after)} mm ({after.channel})."
    )


def mean_error(case: Case) -> str:
    """Format the mean error of a case, with its standard uncertainty [mm]."""
    return f"{case.bias * 1e3:+.2f} ± {case.bias_uncertainty * 1e3:.2f}"


def _ranges_table(cases: list[Case]) -> Table:
    rows = []
    for name in dict.fromkeys(case.name for case in cases):
        before, after = (case for case in cases if case.name == name)
        rows.append(
            [
                name,
                mean_error(before),
                mean_error(after),
                f"{after.noise * 1e3:.2f}",
                f"{after.stated * 1e3:.2f}",
            ]
        )
    return Table(
        [
            "case",
            "error before",
            "error after",
            "noise",
            "stated noise",
        ],
        rows,
        "Slant range on the treads: mean error against the simulated truth, scatter of "
        "single pixels from row to row (noise), and the scatter that the range image "
        "states without knowledge of the truth (stated noise).",
    )


def _steps_table(cases: list[Case]) -> Table:
    true = cases[0].true_steps
    header = ["case", *(f"step of {height * 1e3:.0f} mm" for height in true)]
    rows = []
    for case in cases:
        cells = [f"{case.name}, {case.stage}"]
        for height, step in zip(true, case.steps, strict=True):
            has_uncertainty = math.isfinite(step.uncertainty)
            error = step.uncertainty if has_uncertainty else step.random
            off = abs(step.height - height) > 3 * error
            cells.append(
                f"{'!' if off else ''}{step.height * 1e3:.2f}"
                + (f" ± {step.uncertainty * 1e3:.2f}" if has_uncertainty else "")
            )
        rows.append(cells)
    return Table(
        header,
        rows,
        "Step heights. Before rejection the error by the water is unknown, and no "
        "uncertainty is stated. Marked values are wrong by more than three of their "
        "uncertainties; before rejection, of their noise.",
    )


#: Callback with the current step and the completed fraction of the work.
Progress = Callable[[str, float], None]

#: Packages that write point clouds of some formats.
_WRITERS = {"laz": "lazrs", "e57": "pye57"}


def survey_text(water: str) -> str:
    """Return the text of the survey file for clear water or milk."""
    folder = resources.files("amulor.survey") / "examples"
    return (folder / f"ladder_{water}.toml").read_text(encoding="utf-8")


def run(
    folder: Path,
    *,
    rng: np.random.Generator | int = 1,
    overwrite: bool = False,
    progress: Progress = lambda step, done: None,
) -> list[Case]:
    """Simulate and process all ladder scans; write cubes, images, clouds and a report.

    Point clouds are in PLY, and in LAZ and E57 where there is a package for these.
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
                    image = pipeline.run(stages[stage], polarization=channel)
                cases.append(
                    evaluate(survey, image, water=water, channel=channel, stage=stage)
                )
            _write_images(folder, cases[-1], overwrite=overwrite)
        surveys[water], samples[water] = text, measured
    progress("drawing the report", 0.8)
    with atomic_output(folder / "steps.json", overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(summary(cases), indent=2) + "\n")
    write(folder / "report.html", cases, surveys, samples, overwrite=overwrite)
    progress("done", 1.0)
    return cases


def output_names() -> list[str]:
    """Return the names of all output files of `run`."""
    names = ["report.html", "steps.json"]
    for water in WATERS:
        stem = f"ladder_{water}"
        names += [f"{stem}.toml", f"{stem}_samples.nc", f"{stem}_target_signal.nc"]
        for channel in CHANNELS:
            names.append(f"{stem}_{channel}_range.nc")
            names += [f"{stem}_{channel}.{suffix}" for suffix in _clouds()]
    return names


def left_out() -> dict[str, str]:
    """Return the unavailable point-cloud formats, with the missing packages."""
    return _extras.left_out(_WRITERS)


def _clouds() -> list[str]:
    return [suffix for suffix in ("ply", *_WRITERS) if suffix not in left_out()]


def _write_images(folder: Path, case: Case, *, overwrite: bool) -> None:
    stem = f"ladder_{case.water}_{case.channel}"
    io.write_cube(case.image, folder / f"{stem}_range.nc", overwrite=overwrite)
    cloud = imaging.point_cloud(case.image)
    for suffix in _clouds():
        io.write_cloud(cloud, folder / f"{stem}.{suffix}", overwrite=overwrite)
