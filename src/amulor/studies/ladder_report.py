"""The report of the ladder study: what a person would show a colleague."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import xarray as xr

from amulor.studies.ladder_case import Case
from amulor.view import (
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    figures,
    write_report,
)
from amulor.view.image_report import flag_sentence, interactive
from amulor.view.report import Part


def write(
    path: Path,
    cases: list[Case],
    surveys: Mapping[str, str],
    samples: Mapping[str, xr.Dataset],
    *,
    overwrite: bool,
) -> None:
    """Write the report of the study as one HTML file.

    Parameters
    ----------
    path : pathlib.Path
        File to write.
    cases : list of Case
        All waters, channels and stages.
    surveys : mapping of str to str
        Water to its survey file.
    samples : mapping of str to xarray.Dataset
        Water to its cube of samples.
    overwrite : bool
        Whether a file that is there may be replaced.
    """
    names = list(dict.fromkeys(case.name for case in cases))
    images = {
        name: {case.stage: case.image for case in cases if case.name == name}
        for name in names
    }
    after = {name: stages["after"] for name, stages in images.items()}
    parts: list[Part] = [
        Paragraph(
            "A painted metal ladder stands 1.5 m away under water: a first step of "
            "40 mm, then three of 10 mm. A blue laser, modulated at 39 MHz, scans 100 "
            "by 40 pixels of 1 mm; the phase of the echo is the distance. Light "
            "scattered back by the water is added to every sample and shortens the "
            "measured distance. Here it is measured once without the ladder and taken "
            "out, in clear and in milky water, behind a parallel (VV) and a crossed "
            "(VH) analyser. All data are simulated after Ricci et al. 2010; nothing "
            "here was measured."
        ),
        Heading("What came out"),
        _ranges_table(cases),
        _steps_table(cases),
        Heading("The ladder in space"),
        Picture(
            figures.surfaces(after),
            "Range images after rejection. Height is counted towards the instrument. "
            "The dark gap beside the first step is where it hides the ladder from the "
            "receiver.",
        ),
        *interactive(after),
        Heading("All 40 line profiles over each other"),
        Picture(
            figures.profiles(images),
            "Before rejection the water pulls the treads towards the instrument, more "
            "to the right where the beam runs nearer to the receiver's axis; after "
            "rejection they are level. What is left in milk is the water signal's own "
            "fluctuation. Spikes beside the steps are pixels hidden from the receiver: "
            "before rejection they show the water's own distance; after it they are "
            "left out, but for a few that the receiver sees in part.",
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
    parts.append(Heading("The surveys used"))
    parts += [Listing(f"ladder_{water}.toml", text) for water, text in surveys.items()]
    first = next(iter(samples.values()))
    seeds = " and ".join(str(cube.attrs["seed"]) for cube in samples.values())
    versions = json.loads(first.attrs["software_versions"])
    made = ", ".join(f"{name} {version}" for name, version in versions.items())
    parts.append(Paragraph(f"Seeds of the noise: {seeds}. Made with {made}."))
    title = "Underwater ladder: four range images, before and after rejection"
    write_report(path, title, parts, overwrite=overwrite)


def mean_error(case: Case) -> str:
    """Return the mean error of a case with its standard uncertainty [mm]."""
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
        "Slant range over the treads [mm]: mean error against the simulated truth with "
        "its standard uncertainty, scatter of single pixels from row to row, and the "
        "scatter that the range image states without knowing the truth.",
    )


def _steps_table(cases: list[Case]) -> Table:
    true = cases[0].true_steps
    header = ["case", *(f"step of {height * 1e3:.0f} mm" for height in true)]
    rows = []
    for case in cases:
        cells = [f"{case.name}, {case.stage}"]
        for height, step in zip(true, case.steps, strict=True):
            stated = math.isfinite(step.uncertainty)
            error = step.uncertainty if stated else step.random
            off = abs(step.height - height) > 3 * error
            cells.append(
                f"{'!' if off else ''}{step.height * 1e3:.2f}"
                + (f" ± {step.uncertainty * 1e3:.2f}" if stated else "")
            )
        rows.append(cells)
    return Table(
        header,
        rows,
        "Step heights [mm] with standard uncertainty. Before rejection the water has "
        "an unknown share in them, and none is stated. Marked values are wrong by more "
        "than three of their uncertainties; before rejection, of their noise.",
    )
