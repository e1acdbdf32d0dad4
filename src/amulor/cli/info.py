"""`amulor info`: contents of a file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from amulor.cli._arguments import check_inputs
from amulor.cli._output import print_json


def info(
    file: Path, /, *, json: Annotated[bool, Parameter(negative="")] = False
) -> None:
    """Print the contents of a file.

    Parameters
    ----------
    file
        Cube of any level (netCDF).
    json
        Print the contents as JSON.
    """
    check_inputs(file)

    from amulor import cube as cubes
    from amulor import io

    cube = io.read_cube(file)
    level = str(cube.attrs["level"])
    content: dict[str, Any] = {
        "file": str(file),
        "level": level,
        "title": cube.attrs.get("title", ""),
        "sizes": {str(name): size for name, size in cube.sizes.items()},
        "modulation_frequencies_hz": (
            cube["modulation_frequency"].values.tolist()
            if "modulation_frequency" in cube.coords
            else []
        ),
        "polarizations": (
            [str(value) for value in cube["polarization"].values]
            if "polarization" in cube.coords
            else []
        ),
        "simulated": bool(cube.attrs.get("simulated", 0)),
        "flags": cubes.flag_counts(cube),
        "uncertainty": _uncertainty(cube) if level == "range_image" else {},
        "history": str(cube.attrs.get("history", "")).splitlines(),
    }
    if json:
        print_json(content)
        return
    _print(cube, content)


def _print(cube: Any, content: dict[str, Any]) -> None:
    """Print the contents of a file, with the most important items first."""
    from amulor.view.explanations import explanations, hint

    title = f' "{content["title"]}"' if content["title"] else ""
    origin = "simulated" if content["simulated"] else "measured"
    print(f"{content['file']}: {content['level'].replace('_', ' ')}{title}, {origin}")
    sizes = content["sizes"]
    print(f"  {', '.join(f'{size} {name}s' for name, size in _counted(sizes))}")
    channels = content["polarizations"] or [cube.attrs.get("polarization", "")]
    frequencies = content["modulation_frequencies_hz"] or np.atleast_1d(
        cube.attrs.get("modulation_frequencies", [])
    )
    if any(channels):
        print(f"  channel: {', '.join(map(str, channels))}")
    if len(frequencies):
        shown = ", ".join(f"{frequency / 1e6:g}" for frequency in frequencies)
        print(f"  modulation: {shown} MHz")
    if "slant_range" in cube:
        _print_ranges(cube["slant_range"].values)
    counts = content["flags"]
    if "quality_flag" in cube:
        total = cube["quality_flag"].size
        for name, count in sorted(counts.items(), key=lambda item: -item[1]):
            explanation = explanations().get(name.upper())
            meaning = "" if explanation is None else f": {explanation.meaning}"
            print(f"  flag {name}, {count} ({count / total:.1%}){meaning}")
        advice = f"what to do: {hint(counts)}" if counts else "flags: none"
        print(f"  {advice}")
    for line in _lines(content["uncertainty"]):
        print(f"  uncertainty: {line}")
    for line in content["history"]:
        print(f"  history: {line}")


def _counted(sizes: dict[str, int]) -> list[tuple[str, int]]:
    """Return names and sizes of dimensions other than frequency and polarization."""
    listed = ("modulation_frequency", "polarization")
    words = {"shot": "open-water shot"}
    return [
        (words.get(name, name), size)
        for name, size in sizes.items()
        if name not in listed
    ]


def _print_ranges(values: Any) -> None:
    """Print median and 1 to 99 % limits of the slant ranges, and their number."""
    finite = values[np.isfinite(values)]
    share = f"{finite.size} of {values.size} hold a range"
    if not finite.size:
        print(f"  slant range: {share}")
        return
    low, middle, high = np.percentile(finite, [1, 50, 99])
    print(
        f"  slant range: median {middle:.4f} m, {low:.4f} to {high:.4f} m "
        f"(1 to 99 % of the pixels); {share}"
    )


def _uncertainty(image: Any) -> dict[str, Any]:
    """Return the error budget of a range image as a dictionary for JSON."""
    from dataclasses import asdict

    from amulor.imaging.budget import COVERAGE_FACTOR, error_budget

    budget = error_budget(image)
    return {
        "error_unknown": budget.error_unknown,
        "combined_m": budget.combined,
        "common_m": budget.common,
        "expanded_m": budget.expanded,
        "coverage_factor": COVERAGE_FACTOR,
        "terms": {
            line.term.name: {
                "standard_uncertainty_m": line.uncertainty,
                "share_of_variance": line.share,
                "type": line.term.kind,
                "measurements": line.samples,
            }
            for line in budget.lines
        },
        "unknown": [term.name for term in budget.unknown],
        "late_echo": budget.late_echo,
        "late_echo_taken_off_m": budget.late,
        "delay_calibrated": budget.calibrated,
        "delay_calibration_age_days": budget.age,
        "instrument_tests": [asdict(test) for test in budget.tests],
    }


def _chance(probability: float | None) -> str:
    """Return text for the limit of a probability; empty without a probability."""
    return "" if probability is None else f" (chance below {probability:.1g})"


def _lines(budget: dict[str, Any]) -> list[str]:
    """Return the error budget as lines of text."""
    if not budget:
        return []
    unknown = [budget["error_unknown"]] if budget["error_unknown"] else []
    if not math.isfinite(budget["combined_m"]):
        return unknown
    lines = [
        *unknown,
        f"{budget['combined_m'] * 1e3:.3g} mm combined standard uncertainty (median), "
        f"{budget['expanded_m'] * 1e3:.3g} mm with k = {budget['coverage_factor']:g}",
    ]
    if math.isfinite(budget["common_m"]):
        lines.append(f"{budget['common_m'] * 1e3:.3g} mm of it shared by all pixels")
    for name, term in budget["terms"].items():
        number = term["measurements"]
        origin = "" if number is None else f", from {number} shots"
        lines.append(
            f"{term['standard_uncertainty_m'] * 1e3:.3g} mm {name} "
            f"({term['share_of_variance']:.0%} of the variance, type {term['type']}"
            f"{origin})"
        )
    if budget["unknown"]:
        lines.append(f"not known, and not in it: {', '.join(budget['unknown'])}")
    if math.isfinite(budget["late_echo_taken_off_m"]):
        late = f"{budget['late_echo_taken_off_m'] * 1e3:.3g} mm"
        lines.append(f"late echo: {late} {budget['late_echo']}")
    elif budget["late_echo"]:
        lines.append(f"late echo: {budget['late_echo']}")
    if budget["delay_calibrated"]:
        from amulor.imaging.budget import age_in_words

        age = budget["delay_calibration_age_days"]
        day = budget["delay_calibrated"]
        lines.append(f"delay calibrated on {day}{age_in_words(age)}")
    lines += [
        f"{test['result']}{_chance(test['probability'])}: {test['cause']}; to do: "
        f"{test['measurement']}"
        for test in budget["instrument_tests"]
    ]
    return lines
