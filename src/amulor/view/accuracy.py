"""Report sections on instrument, water, registration, accuracy and error budget."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from amulor.cube.schema import ALIKE_TERMS, SHARED_TERMS
from amulor.errors import AmulorError
from amulor.imaging import ErrorBudget, error_budget, frame_of
from amulor.imaging.budget import age_in_words
from amulor.imaging.measure import Checked
from amulor.imaging.observation import readable_survey
from amulor.survey import Survey, water_properties
from amulor.view.report import Heading, Paragraph, Part, Picture, Table
from amulor.view.style import COLOURS, new_figure, style

#: Share of the pixels within the second figure of an accuracy statement [%].
_MOST = 95.0


def instrument_and_water(images: Mapping[str, xr.Dataset]) -> list[Part]:
    """Tables of the instrument and the water of range images."""
    groups: dict[str, list[str]] = {}
    for name, image in images.items():
        groups.setdefault(str(image.attrs.get("survey", "")), []).append(name)
    parts: list[Part] = []
    for names in groups.values():
        survey = readable_survey(images[names[0]])
        if survey is None:
            continue
        of = f" of {', '.join(names)}" if len(groups) > 1 else ""
        parts += [
            Table(["instrument", ""], _instrument_rows(survey), f"The instrument{of}."),
            Table(["water", ""], _water_rows(survey), f"The water{of}."),
        ]
    return [Heading("Instrument and water"), *parts] if parts else []


def registration(images: Mapping[str, xr.Dataset]) -> list[Part]:
    """Table of instrument poses from the surveys of range images."""
    rows = []
    for name, image in images.items():
        survey = readable_survey(image)
        if survey is None or survey.pose is None:
            rows.append([name, "the instrument's own axes", "", "", "", ""])
            continue
        pose, frame = survey.pose, frame_of(image, axes="pose")
        rows.append(
            [
                name,
                pose.crs or "local frame",
                ", ".join(f"{v:.4g}" for v in pose.position),
                ", ".join(
                    f"{math.degrees(v):.3g}"
                    for v in (pose.heading, pose.pitch, pose.roll)
                ),
                _or_not_known(pose.position_uncertainty, 1e3, "mm"),
                "!not known: " + ", ".join(frame.unknown)
                if frame.unknown
                else "stated",
            ]
        )
    return [
        Heading("Registration"),
        Table(
            [
                "scan",
                "frame",
                "east, north, up [m]",
                "heading, pitch, roll [°]",
                "standard uncertainty of the position",
                "uncertainties",
            ],
            rows,
            "Place and attitude of the instrument, from the surveys. Coordinates in "
            "the instrument's axes are x right, y down, z forward.",
        ),
    ]


def accuracy_statement(
    images: Mapping[str, xr.Dataset], checks: Mapping[str, Sequence[Checked]]
) -> list[Part]:
    """Accuracy statement of range images in the terms of the GUM."""
    parts: list[Part] = [Heading("Accuracy")]
    rows = []
    statements: list[Part] = []
    for name, image in images.items():
        budget = error_budget(image)
        if budget.error_unknown:
            parts.append(Paragraph(f"{name}: {budget.error_unknown}."))
        if not math.isfinite(budget.combined):
            continue
        sigma = image["slant_range_uncertainty"].values
        sigma = sigma[np.isfinite(sigma)]
        # max() of NaN would be zero.
        noise = math.sqrt(float(np.maximum(budget.combined**2 - budget.common**2, 0.0)))
        rows.append(
            [
                name,
                _millimetres(noise),
                _millimetres(budget.common),
                f"{budget.combined * 1e3:.3g}",
                f"{budget.expanded * 1e3:.3g}",
                f"{np.percentile(sigma, _MOST) * 2e3:.3g}",
            ]
        )
        lengths = checks.get(name, ())
        statements.append(_statement(name, image, budget, lengths))
    if rows:
        parts += [
            Table(
                [
                    "scan",
                    "precision, 1σ [mm]",
                    "shared, 1σ [mm]",
                    "combined, 1σ [mm]",
                    "expanded, 95 % [mm]",
                    "95 % of pixels within [mm]",
                ],
                rows,
                "Accuracy of the slant range. Precision is the scatter of repeated "
                "pixels; the shared part is one and the same error of all pixels, "
                "which no averaging takes away and which cancels in differences where "
                "it is the same. 1σ is the standard uncertainty of the GUM (JCGM 100); "
                "95 % its double, as subsea metrology states it (IMCA S 019). Medians "
                "over the pixels; the last column is the expanded uncertainty that 95 "
                "of 100 pixels stay below.",
            ),
            *statements,
        ]
    return parts + _check_parts(checks)


def _statement(
    name: str, image: xr.Dataset, budget: ErrorBudget, checks: Sequence[Checked]
) -> Table:
    """Statement of accuracy in the form of an inspection report, as a table."""
    slant_range = image["slant_range"].values
    usable = slant_range[np.isfinite(slant_range)]
    near, far = np.percentile(usable, [5, 95])
    conditions = f"distances of {near:.3g} to {far:.3g} m (90 % of the pixels)"
    survey = readable_survey(image)
    if survey is not None:
        wavelength = survey.instrument.wavelength
        frequencies = ", ".join(
            f"{f / 1e6:g}" for f in survey.instrument.modulation_frequencies
        )
        conditions += f"; {wavelength * 1e9:g} nm, modulated at {frequencies} MHz"
    if image.attrs.get("simulated"):
        conditions += "; simulated data"
    index = float(image["geometry"].attrs["group_index"])
    calibration = None if survey is None else survey.calibration
    error = None if calibration is None else calibration.group_index_uncertainty
    doubt = "" if error is None else f" ± {error:.2g} (k = 1)"
    traceable = (
        "lengths rest on the modulation frequencies and on the group index "
        f"{index:.5g}{doubt} of the water"
    )
    if budget.calibrated:
        delay = f"delay calibrated on {budget.calibrated}{age_in_words(budget.age)}"
    else:
        delay = "no date of a delay calibration is stated"
    passed = sum(checked.verdict == "pass" for checked in checks)
    known = f"{passed} of {len(checks)} known lengths confirm it" if checks else ""
    missing = [term.name.replace("_", " ") for term in budget.unknown]
    missing.append("directions of the beams")
    return Table(
        ["item", "statement"],
        [
            ["measured quantity", "slant range of a single pixel"],
            ["expanded uncertainty", f"U = {budget.expanded * 1e3:.3g} mm (median)"],
            ["coverage", "coverage factor k = 2, level of confidence about 95 %"],
            ["method", "GUM (JCGM 100), error budget below"],
            ["conditions", conditions],
            ["traceability", f"{traceable}; {delay}"],
            ["verification", known or "no check distances"],
            ["not included", ", ".join(missing)],
        ],
        f"Statement of accuracy for {name}. Lengths between pixels and positions in a "
        "frame have other uncertainties: the first lose what both pixels share, the "
        "second add those of the pose.",
    )


def _check_parts(checks: Mapping[str, Sequence[Checked]]) -> list[Part]:
    """Table of measured check distances, with a summary."""
    rows, verdicts = [], []
    for name, checked_lengths in checks.items():
        for checked in checked_lengths:
            tolerance = checked.check.tolerance
            mark = "" if checked.verdict == "pass" else "!"
            rows.append(
                [
                    checked.check.name,
                    name,
                    f"{checked.check.expected * 1e3:.2f}",
                    f"{checked.measured.value * 1e3:.2f}",
                    f"{checked.deviation * 1e3:+.2f}",
                    f"{checked.expanded * 1e3:.2f}"
                    if math.isfinite(checked.expanded)
                    else "!not known",
                    "" if tolerance is None else f"{tolerance * 1e3:.2f}",
                    f"{mark}{checked.verdict}",
                ]
            )
            verdicts.append(checked)
    if not rows:
        return [Paragraph("No check distances were given.")]
    passed = sum(checked.verdict == "pass" for checked in verdicts)
    rms = math.sqrt(sum(checked.deviation**2 for checked in verdicts) / len(verdicts))
    return [
        Table(
            [
                "check distance",
                "scan",
                "known [mm]",
                "measured [mm]",
                "deviation [mm]",
                "expanded, 95 % [mm]",
                "tolerance [mm]",
                "verdict",
            ],
            rows,
            "Known lengths against measured ones. Under a tolerance a check passes if "
            "deviation and expanded uncertainty together stay within it, fails if the "
            "deviation exceeds it by more than the expanded uncertainty, and is "
            "undecided in between (JCGM 106); without one it passes if the deviation "
            "is within its expanded uncertainty. It is undecided where that is not "
            "known.",
        ),
        Paragraph(
            f"{passed} of {len(verdicts)} check distances pass; root mean square of "
            f"the deviations {rms * 1e3:.2g} mm."
        ),
    ]


def _instrument_rows(survey: Survey) -> list[list[str]]:
    instrument, scan = survey.instrument, survey.scan
    receiver, lock_in = instrument.receiver, instrument.lock_in
    frequencies = ", ".join(f"{f / 1e6:g}" for f in instrument.modulation_frequencies)
    rows = [
        ["wavelength", f"{instrument.wavelength * 1e9:g} nm"],
        ["power", f"{instrument.power * 1e3:g} mW"],
        ["modulation frequencies", f"{frequencies} MHz"],
        ["modulation depth", f"{instrument.modulation_depth:.0%}"],
        ["polarizations", ", ".join(str(p) for p in instrument.polarizations)],
        [
            "receiver at (right, down, forward)",
            ", ".join(f"{v * 1e3:g}" for v in receiver.position) + " mm",
        ],
        ["receiver radius", f"{receiver.radius * 1e3:g} mm"],
        ["acceptance (1/e half-width)", f"{math.degrees(receiver.acceptance):.2f}°"],
        ["time constant of the lock-in", f"{lock_in.time_constant * 1e3:g} ms"],
        ["phase floor", f"{math.degrees(lock_in.phase_floor):.3g}°"],
        ["scan", f"{scan.columns} x {scan.rows} pixels, {scan.dwell * 1e3:g} ms each"],
        [
            "field of the scan",
            f"{math.degrees(scan.azimuth_span):.2f}° x "
            f"{math.degrees(scan.elevation_span):.2f}°",
        ],
    ]
    calibration = survey.calibration
    if calibration is not None and calibration.date is not None:
        rows.append(["delay calibrated on", calibration.date.isoformat()])
    return rows


def _water_rows(survey: Survey) -> list[list[str]]:
    try:
        water = water_properties(survey)
    except AmulorError as error:
        return [["not known at this wavelength", str(error)]]
    attenuation = water.absorption + water.scattering
    return [
        ["absorption", f"{water.absorption:.4g} 1/m"],
        ["scattering", f"{water.scattering:.4g} 1/m"],
        ["attenuation", f"{attenuation:.4g} 1/m"],
        ["group index, which makes the meters", f"{water.group_index:.5g}"],
        ["refractive index", f"{water.refractive_index:.5g}"],
    ]


def _millimetres(value: float) -> str:
    return f"{value * 1e3:.3g}" if math.isfinite(value) else "not known"


def _or_not_known(value: float | None, factor: float, unit: str) -> str:
    return "not known" if value is None else f"{value * factor:.3g} {unit}"


#: Terms common to pixels of the whole scan or of a neighborhood.
_SHARED = {*ALIKE_TERMS, *SHARED_TERMS}


def error_budgets(images: Mapping[str, xr.Dataset]) -> list[Part]:
    """Report sections on the error budget of each range image."""
    parts: list[Part] = [Heading("Where the uncertainty comes from")]
    for name, image in images.items():
        budget = error_budget(image)
        if budget.lines and math.isfinite(budget.combined):
            parts += [
                Picture(
                    budget_figure({name: budget}),
                    _key(budget),
                ),
                _table(name, budget),
                Paragraph(_limits(budget)),
            ]
    return parts if len(parts) > 1 else []


def _key(budget: ErrorBudget) -> str:
    """Caption that explains the bars of an error-budget chart."""
    parts = ["Standard uncertainty of each term, median over the usable pixels."]
    if any(line.term.name in _SHARED for line in budget.lines):
        parts.append("Dark terms are shared by pixels; a mean does not reduce them.")
    if budget.unknown:
        parts.append("Hatched terms are unknown and not in the combined uncertainty.")
    return " ".join(parts)


def budget_figure(budgets: Mapping[str, ErrorBudget]) -> Figure:
    """Draw the error sources of error budgets as bars."""
    most = max(len(b.lines) + len(b.unknown) + 1 for b in budgets.values())
    with style():
        figure = new_figure(6.4 * len(budgets), 0.5 + 0.24 * most)
        panels = figure.subplots(1, len(budgets), squeeze=False)[0]
        for axis, (name, budget) in zip(panels, budgets.items(), strict=True):
            _bars(axis, budget)
            axis.set_title(name)
    return figure


def _bars(axis: Axes, budget: ErrorBudget) -> None:
    """Draw one bar for each error source, and one for all combined."""
    names = [line.term.name for line in budget.lines]
    names += [term.name for term in budget.unknown] + ["combined"]
    uncertainties = [line.uncertainty * 1e3 for line in budget.lines]
    colours = [
        COLOURS[0] if name in _SHARED else COLOURS[5]
        for name in names[: len(uncertainties)]
    ]
    place = list(range(len(names)))
    axis.barh(place[: len(uncertainties)], uncertainties, color=colours, height=0.7)
    for number, value in enumerate(uncertainties):
        axis.text(value, number, f" {value:.3g}", va="center", fontsize=7)
    unsaid = place[len(uncertainties) : -1]
    longest = budget.combined * 1e3
    axis.barh(
        unsaid, longest, color="none", edgecolor="#d9d9d9", hatch="////", height=0.7
    )
    for number in unsaid:
        axis.text(0, number, "  not known", va="center", fontsize=7)
    axis.barh(place[-1], longest, color=COLOURS[6], height=0.7)
    axis.text(longest, place[-1], f" {longest:.3g}", va="center", fontsize=7)
    axis.set_yticks(place, [name.replace("_", " ") for name in names])
    axis.invert_yaxis()
    axis.set_xlim(0, 1.12 * longest)
    axis.set_xlabel("standard uncertainty [mm]")


def _table(name: str, budget: ErrorBudget) -> Table:
    rows = [
        [
            line.term.name.replace("_", " "),
            line.term.meaning,
            line.term.kind,
            "" if line.samples is None else f"{line.samples} shots",
            f"{line.uncertainty * 1e3:.3g}",
            f"{line.share:.1%}",
        ]
        for line in budget.lines
    ]
    for term in budget.unknown:
        rows.append(
            [term.name.replace("_", " "), term.meaning, term.kind, "", "!not known", ""]
        )
    rows.append(
        ["combined", "all known terms", "", "", f"{budget.combined * 1e3:.3g}", ""]
    )
    rows.append(
        [
            "expanded, k = 2",
            "contains about 95 of 100 errors",
            "",
            "",
            f"{budget.expanded * 1e3:.3g}",
            "",
        ]
    )
    return Table(
        ["term", "source", "type", "data", "standard [mm]", "of variance"],
        rows,
        f"{name}: standard uncertainty of the slant range, medians over the usable "
        "pixels. Type A comes from the scatter of measurements, type B from other "
        "knowledge (GUM). The squares of the terms add up to the combined square.",
    )


def _limits(budget: ErrorBudget) -> str:
    """Sentences on shared errors, late light, calibration, tests and unknown errors."""
    sentences = []
    if math.isfinite(budget.common):
        sentences.append(
            f"All pixels share {budget.common * 1e3:.3g} mm of it; a mean over "
            "pixels does not reduce this part."
        )
    if math.isfinite(budget.late):
        sentences.append(
            f"Scattered light makes the echoes {budget.late * 1e3:.3g} mm late. It is "
            "subtracted."
        )
    elif budget.late_echo:
        sentences.append(f"Late light: {budget.late_echo}.")
    if budget.calibrated:
        old = age_in_words(budget.age)
        sentences.append(f"The delay was calibrated on {budget.calibrated}{old}.")
    sentences += [
        f"Instrument: {test.result}. Probable cause: {test.cause}. To do: "
        f"{test.measurement}."
        for test in budget.tests
    ]
    if budget.unknown:
        names = ", ".join(term.name.replace("_", " ") for term in budget.unknown)
        sentences.append(
            f"Not included, since their size is unknown: {names}. State them in the "
            "section [calibration] of the survey."
        )
    return " ".join(sentences)
