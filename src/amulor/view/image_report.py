"""Report on range images: maps, numbers, flags and processing history."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor._progress import tell
from amulor.imaging import error_budget
from amulor.imaging.measure import Check, compared
from amulor.imaging.selection import Whole
from amulor.view import figures
from amulor.view.accuracy import (
    accuracy_statement,
    error_budgets,
    instrument_and_water,
    registration,
)
from amulor.view.explanations import hint
from amulor.view.report import (
    Heading,
    Interactive,
    Listing,
    Paragraph,
    Part,
    Picture,
    Table,
    write_report,
)


def write(
    path: str | Path,
    images: Mapping[str, xr.Dataset],
    *,
    checks: Sequence[Check] = (),
    wholes: Mapping[str, Whole] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a report on range images as one self-contained HTML file.

    Parameters
    ----------
    path : str or pathlib.Path
        File to write.
    images : mapping of str to xarray.Dataset
        Range images (level `range_image`) by name.
    checks : sequence of Check
        Known lengths to measure in each image.
    wholes : mapping of str to Whole, optional
        Counts and check distances over all pixels, for images that are thinned
        (`amulor.imaging.selection.thinned`).
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    CubeError
        If a cube is no range image, or an end of a check distance has no range.
    FormatError
        If the file exists, or cannot be written.
    """
    for name, image in images.items():
        cubes.check(image, "range_image", name=name)
    tell("measuring check distances", 0.0)
    statistics = wholes or {}
    measured = {
        name: list(statistics[name].checks)
        if name in statistics
        else [compared(image, check) for check in checks]
        for name, image in images.items()
    }
    name, first = next(iter(images.items()))
    sentence = flag_sentence(first, statistics.get(name))
    parts: list[Part] = [
        Paragraph(f"{_origin(images)} {_result(name, first, statistics.get(name))}"),
        Picture(figures.image_overview(first), f"{name}. {sentence}"),
        _numbers(images, statistics),
    ]
    parts += [
        Paragraph(_thinning(name, image_statistics))
        for name, image_statistics in statistics.items()
        if image_statistics.step > 1
    ]
    parts += accuracy_statement(images, measured)
    tell("working out the error budget", 0.1)
    parts += error_budgets(images)
    parts += instrument_and_water(images)
    parts += registration(images)
    others = list(images.items())[1:]
    for number, (name, image) in enumerate(others):
        tell(f"drawing {name}", 0.2 + 0.4 * number / len(images))
        parts += [
            Heading(name),
            Picture(
                figures.image_overview(image),
                flag_sentence(image, statistics.get(name)),
            ),
        ]
    # A surface needs two rows, two columns and a finite range.
    drawable = {name: image for name, image in images.items() if _is_surface(image)}
    tell("drawing profiles and surfaces", 0.6)
    if drawable:
        staged = {name: {"range image": image} for name, image in drawable.items()}
        parts += [
            Heading("Line profiles"),
            Picture(
                figures.profiles(staged),
                "All rows of each image over each other; of many rows the median, and "
                "the bands that hold 68 and 95 of 100 of them.",
            ),
            Heading("In space"),
            Picture(
                figures.surfaces(drawable), "Height is counted towards the instrument."
            ),
            *interactive(drawable),
        ]
    parts.append(Heading("Annex: origin of the data", new_page=True))
    for name, image in images.items():
        history = _without_folders(str(image.attrs.get("history", "")))
        parts.append(Listing(f"history of {name}", history))
        if image.attrs.get("survey"):
            survey = _without_folders(str(image.attrs["survey"]))
            parts.append(Listing(f"survey of {name}", survey))
    tell("writing", 0.9)
    title = str(first.attrs.get("title") or "Range images")
    write_report(path, title, parts, overwrite=overwrite)


def flag_sentence(image: xr.Dataset, whole: Whole | None = None) -> str:
    """Sentence that states how many pixels of a range image are flagged.

    Parameters
    ----------
    image : xarray.Dataset
        Range image with `quality_flag`.
    whole : Whole, optional
        Counts over all pixels, if the image is thinned.

    Returns
    -------
    str
        Sentence for a caption.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> from amulor.view.image_report import flag_sentence
    >>> print(flag_sentence(image)[27:68])
    Flags, of 4000 pixels: 4000 no open water
    """
    counted = cubes.flag_counts(image) if whole is None else whole.flags
    counts = [
        f"{count} {meaning.replace('_', ' ')}" for meaning, count in counted.items()
    ]
    listed = "; ".join(counts) if counts else "none"
    pixels = image["quality_flag"].size if whole is None else whole.rows * whole.columns
    words = cubes.error_unknown(image)
    error = f" {words[0].upper()}{words[1:]}." if words else ""
    hints = f" What they mean: {hint(counted)}." if counts else ""
    return (
        f"Gray pixels hold no range. Flags, of {pixels} pixels: {listed}.{hints}{error}"
    )


#: A whole path in quotation marks, on a Unix or a Windows computer.
_PATH = re.compile(r"""(["'])(?:/|[A-Za-z]:[\\/]|\\\\)[^"'\n]*[\\/]([^"'\\/\n]+)\1""")


def _without_folders(text: str) -> str:
    """Text in which file paths are reduced to file names, for privacy."""
    return _PATH.sub(r"\1\2\1", text)


def interactive(images: Mapping[str, xr.Dataset]) -> list[Part]:
    """Report sections that show range images as interactive 3D pages.

    Parameters
    ----------
    images : mapping of str to xarray.Dataset
        Range images by name.

    Returns
    -------
    list of Part
        One page per image; a sentence for an image that is too large for a report.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> from amulor.view.image_report import interactive
    >>> (part,) = interactive({"ladder": image})
    >>> part.title[:23]
    'ladder: drag to turn it'
    """
    from amulor.view import page

    parts: list[Part] = []
    for name, image in images.items():
        if image["slant_range"].size > _LARGEST_IN_REPORT:
            parts.append(
                Paragraph(
                    f"{name} is too large to be turned here: amulor view shows it."
                )
            )
            continue
        html = page.saved_page(page.recording_of(image, name=name))
        parts.append(
            Interactive(
                f"{name}: drag to turn it, pick two points to measure their distance "
                "with its uncertainty.",
                html,
            )
        )
    return parts


#: Largest image that a report contains as an interactive page [pixel].
_LARGEST_IN_REPORT = 400_000


def _is_surface(image: xr.Dataset) -> bool:
    slant_range = image["slant_range"].values
    return min(slant_range.shape) > 1 and bool(np.isfinite(slant_range).sum() > 3)


def _origin(images: Mapping[str, xr.Dataset]) -> str:
    simulated = [name for name, cube in images.items() if cube.attrs.get("simulated")]
    if not simulated:
        return "Measured data."
    if len(simulated) == len(images):
        return "Simulated data; nothing here was measured."
    return f"Measured data, but for {', '.join(simulated)}, which are simulated."


def _result(name: str, image: xr.Dataset, whole: Whole | None) -> str:
    """Sentence with the usable pixels and the expanded uncertainty of an image."""
    usable = float(np.isfinite(image["slant_range"].values).mean())
    if whole is not None:
        usable = whole.usable / (whole.rows * whole.columns)
    budget = error_budget(image)
    error = "is not known"
    if math.isfinite(budget.combined):
        error = f"is U = {budget.expanded * 1e3:.3g} mm (median, k = 2)"
    return (
        f"{name}: {usable:.1%} of the pixels have a range, and the expanded "
        f"uncertainty of a range {error}."
    )


def _thinning(name: str, whole: Whole) -> str:
    return (
        f"{name} has {whole.columns} x {whole.rows} pixels: one row and column of "
        f"every {whole.step} is drawn, and medians, percentiles and the error budget "
        "are of those. Shares of usable pixels, flags and check distances are of all."
    )


def _numbers(images: Mapping[str, xr.Dataset], wholes: Mapping[str, Whole]) -> Table:
    rows = []
    for name, image in images.items():
        slant_range = image["slant_range"].values
        usable = float(np.isfinite(slant_range).mean())
        if name in wholes:
            whole = wholes[name]
            usable = whole.usable / (whole.rows * whole.columns)
        sigma = image["slant_range_uncertainty"].values
        unknown = "!unknown" if cubes.error_unknown(image) else "none"
        bias = image.get("slant_range_bias")
        rows.append(
            [
                name,
                f"{image.attrs.get('polarization', '')}",
                f"{usable:.1%}",
                _median(slant_range, ".4f"),
                _median(sigma * 1e3, ".2f", none=unknown),
                "unknown" if bias is None else _median(bias.values * 1e3, "+.2f"),
            ]
        )
    return Table(
        [
            "image",
            "channel",
            "usable",
            "range [m]",
            "uncertainty [mm]",
            "bias [mm]",
        ],
        rows,
        "Medians over the usable pixels. The uncertainty is the combined standard "
        "uncertainty of all terms that are known; the bias is what water signal left "
        "in is expected to add, and is not taken off.",
    )


def _median(values: NDArray[np.float64], form: str, *, none: str = "none") -> str:
    finite = values[np.isfinite(values)]
    return format(float(np.median(finite)), form) if finite.size else none
