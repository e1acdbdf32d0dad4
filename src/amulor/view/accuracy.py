"""What a report says of instrument, water, registration and accuracy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from amulor.errors import AmulorError
from amulor.imaging import error_budget, frame_of
from amulor.imaging.measure import Checked
from amulor.imaging.observation import readable_survey
from amulor.survey import Survey, water_properties
from amulor.view.report import Heading, Paragraph, Part, Table

#: Share of the pixels within the second figure of an accuracy statement [%].
_MOST = 95.0


def instrument_and_water(images: Mapping[str, xr.Dataset]) -> list[Part]:
    """Return tables of the instrument and the water of range images."""
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
    """Return where the instrument stood, as the surveys of range images say."""
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
                _shown(pose.position_uncertainty, 1e3, "mm"),
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
    """Return how accurate range images are, in the terms of the GUM."""
    parts: list[Part] = [Heading("Accuracy")]
    rows = []
    said = []
    for name, image in images.items():
        budget = error_budget(image)
        if budget.error_unknown:
            parts.append(Paragraph(f"{name}: {budget.error_unknown}."))
        if not math.isfinite(budget.combined):
            continue
        sigma = image["slant_range_uncertainty"].values
        sigma = sigma[np.isfinite(sigma)]
        # max() of a number that is none would be zero.
        own = math.sqrt(float(np.maximum(budget.combined**2 - budget.common**2, 0.0)))
        rows.append(
            [
                name,
                _millimetres(own),
                _millimetres(budget.common),
                f"{budget.combined * 1e3:.3g}",
                f"{budget.expanded * 1e3:.3g}",
                f"{np.percentile(sigma, _MOST) * 2e3:.3g}",
            ]
        )
        missing = ", ".join(term.name.replace("_", " ") for term in budget.unknown)
        said.append(
            f"{name}: the slant range of a single pixel has the expanded uncertainty "
            f"U = {budget.expanded * 1e3:.3g} mm (median; coverage factor k = 2, level "
            "of confidence about 95 %)."
            + (
                f" Not in it, since nobody stated them: {missing}."
                if missing
                else " All terms of the budget are stated."
            )
        )
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
            *(Paragraph(text) for text in said),
        ]
    return parts + _check_parts(checks)


def _check_parts(checks: Mapping[str, Sequence[Checked]]) -> list[Part]:
    """Return the table of check distances and what it amounts to."""
    rows, verdicts = [], []
    for name, found in checks.items():
        for one in found:
            tolerance = one.check.tolerance
            mark = "" if one.verdict == "pass" else "!"
            rows.append(
                [
                    one.check.name,
                    name,
                    f"{one.check.expected * 1e3:.2f}",
                    f"{one.measured.value * 1e3:.2f}",
                    f"{one.deviation * 1e3:+.2f}",
                    f"{one.expanded * 1e3:.2f}"
                    if math.isfinite(one.expanded)
                    else "!not known",
                    "" if tolerance is None else f"{tolerance * 1e3:.2f}",
                    f"{mark}{one.verdict}",
                ]
            )
            verdicts.append(one)
    if not rows:
        return [Paragraph("No check distances were given.")]
    passed = sum(one.verdict == "pass" for one in verdicts)
    rms = math.sqrt(sum(one.deviation**2 for one in verdicts) / len(verdicts))
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
        ["group index, which makes the metres", f"{water.group_index:.5g}"],
        ["refractive index", f"{water.refractive_index:.5g}"],
    ]


def _millimetres(value: float) -> str:
    return f"{value * 1e3:.3g}" if math.isfinite(value) else "not known"


def _shown(value: float | None, factor: float, unit: str) -> str:
    return "not known" if value is None else f"{value * factor:.3g} {unit}"
