"""Report of an instrument design: recommendation, reasons, alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from amulor.design.candidates import (
    Parameters,
    middle,
    spreads_of,
    survey_of,
    water_scale,
)
from amulor.design.confirm import Confirmation
from amulor.design.evaluate import evaluate
from amulor.design.goal import Goal
from amulor.design.recommend import Choice, Recommendation
from amulor.design.requirements import lines_texts, parameters_text, written
from amulor.design.sensitivity import Sensitivity
from amulor.design.trade import Trade, Turn
from amulor.survey import water_properties
from amulor.view.design import figures
from amulor.view.report import (
    Heading,
    Listing,
    Paragraph,
    Part,
    Picture,
    Table,
    write_report,
)

__all__ = ["Reasons", "error_of", "figures_of", "waters_of", "write"]

#: Places of the map along distance and attenuation.
_SHAPE = (72, 44)


@dataclass(frozen=True, kw_only=True)
class Reasons:
    """Analyses that explain why an instrument is recommended."""

    trade: Trade
    """Trade-off with other dwell times and frequencies."""
    sensitivity: Sensitivity | None
    """Sensitivity of the range error; None without uncertain inputs."""
    turns: Sequence[Turn] = ()
    """Values of each assumption at which the runner-up becomes the best."""
    confirmations: Sequence[Confirmation] = ()
    """Results of simulated scans and photon transport; empty if not requested."""


def error_of(goal: Goal, chosen: Parameters) -> xr.Dataset:
    """Range errors of an instrument over distance and attenuation."""
    survey = survey_of(goal, chosen)
    middles = {
        name: middle(spread)
        for name, spread in spreads_of(goal).items()
        if name not in ("attenuation", "absorption", "scattering")
    }
    clear, murky = waters_of(goal, chosen)
    far = min(goal.limits[1], 2 * goal.asked[-1])
    return evaluate(
        survey,
        distance=np.linspace(
            max(goal.asked[0] / 2, goal.limits[0], 0.05), far, _SHAPE[0]
        ),
        attenuation=np.geomspace(clear / 3, murky * 3, _SHAPE[1]),
        method=chosen.method,
        interval=goal.limits,
        wrong_interval=goal.accuracy.wrong_interval,
        **{**goal.assumed, **middles},
    )


def waters_of(goal: Goal, chosen: Parameters) -> tuple[float, float]:
    """Smallest and largest attenuation coefficient among the goal's waters [1/m]."""
    attenuation_range = goal.waters.attenuation
    if attenuation_range is None:
        attenuation = water_properties(survey_of(goal, chosen)).attenuation
        return attenuation, attenuation
    scale = water_scale(goal, chosen).get("attenuation", 1.0)
    return attenuation_range.low * scale, attenuation_range.high * scale


def figures_of(recommendation: Recommendation, reasons: Reasons) -> dict[str, Figure]:
    """Figures in the report on a recommended instrument."""
    goal = recommendation.goal
    drawings = {"map": _map(goal, recommendation.best, "Recommended")}
    if recommendation.runner_up is not None:
        drawings["runner-up-map"] = _map(goal, recommendation.runner_up, "Runner-up")
    drawings["fronts"] = figures.fronts(
        reasons.trade.error,
        scan_time=reasons.trade.scan_time,
        top_frequency=reasons.trade.top_frequency,
        best=reasons.trade.best,
        target=goal.accuracy.total_error,
    )
    if reasons.sensitivity is not None:
        drawings["sensitivity"] = figures.sensitivity_bars(
            [number.label for number in reasons.sensitivity.numbers],
            reasons.sensitivity.total,
            reasons.sensitivity.total_error,
        )
    return drawings


def _map(goal: Goal, choice: Choice, title: str) -> Figure:
    clear, murky = waters_of(goal, choice.parameters)
    ends = sorted({clear, murky})
    places = [(distance, water) for distance in goal.asked for water in ends]
    megahertz = ", ".join(f"{f / 1e6:.4g}" for f in choice.parameters.frequencies)
    chosen = choice.parameters
    return figures.error_map(
        error_of(goal, chosen),
        asked=places,
        title=f"{title}: {chosen.laser}, {megahertz} MHz, {chosen.polarization} by "
        f"{chosen.method}",
    )


def write(
    path: str | Path,
    recommendation: Recommendation,
    reasons: Reasons,
    *,
    overwrite: bool = False,
) -> None:
    """Write the report of an instrument design as one self-contained HTML file."""
    drawings = figures_of(recommendation, reasons)
    parts: list[Part] = [*_answer(recommendation), *_edges(recommendation)]
    parts += [
        Heading("Components"),
        _components(recommendation),
        Heading("Requirements"),
        _requirements(recommendation.best),
        Heading("Where it works"),
        Picture(
            drawings["map"],
            "Total error of one pixel, noise and bias together, in median conditions. "
            "Rings stand where it is asked for, in the clearest and the most turbid "
            "water. Where it is hatched no range is to be trusted.",
        ),
    ]
    if "runner-up-map" in drawings:
        parts.append(Picture(drawings["runner-up-map"], "The same for the runner-up."))
    parts += [
        Heading("Trade-off of time, frequency and error"),
        Picture(
            drawings["fronts"],
            "The recommended instrument with other dwells and frequencies, whatever "
            "they cost. At the knee more begins to buy little.",
        ),
    ]
    judged = recommendation.looked_at
    parts += _measure(reasons.sensitivity, drawings)
    parts += _turns(recommendation, reasons.turns)
    parts += _confirmed(reasons.confirmations)
    parts += [
        Heading("Basis of the results"),
        Paragraph(
            f"{judged:,} instruments were judged by the total error of one "
            "pixel that the asked share of waters and targets keeps within, from the "
            "small-angle model with the whole phase function and from the noise of "
            "laser, detector and lock-in. Eye safety, prices and limits of components "
            "are inputs as the goal states them, and no certificate."
        ),
        Listing("Survey of the recommended instrument", recommendation.best.survey),
    ]
    if recommendation.runner_up is not None:
        parts.append(
            Listing("Survey of the runner-up", recommendation.runner_up.survey)
        )
    write_report(path, recommendation.goal.name, parts, overwrite=overwrite)


def _answer(recommendation: Recommendation) -> list[Part]:
    best, goal = recommendation.best, recommendation.goal
    reached = (
        f"{best.error * 1e3:.3g} mm at {best.worst_distance:.3g} m in "
        f"{goal.accuracy.share:.0%} of the waters and targets, with "
        f"{goal.accuracy.total_error * 1e3:.3g} mm asked for"
    )
    if recommendation.impossible:
        return [
            Paragraph(
                f"No instrument of these components does it. The nearest one is "
                f"{parameters_text(best.parameters)}: {reached}."
            ),
            *(
                Paragraph(f"Requirement to relax: {conflict.text}.")
                for conflict in recommendation.impossible
            ),
        ]
    cost = f", for {best.cost:,.0f}" if best.cost else ""
    return [
        Paragraph(
            f"Build this: {parameters_text(best.parameters)}. It reaches {reached}, "
            f"in {best.scan_time / 60:.3g} min a scan{cost}; what binds is "
            f"{best.binding.replace('_', ' ')}."
        )
    ]


def _edges(recommendation: Recommendation) -> list[Part]:
    return [Paragraph(f"At an edge: {bound.text}.") for bound in recommendation.bounds]


def _components(recommendation: Recommendation) -> Table:
    choices = [("recommended", recommendation.best)]
    if recommendation.runner_up is not None:
        choices.append(("runner-up", recommendation.runner_up))
    rows: list[list[str]] = []
    names = {
        "laser": "laser",
        "power": "mean power",
        "frequencies": "modulation",
        "polarization": "channels",
        "method": "water removed by",
        "baseline": "baseline",
        "radius": "receiver radius (1/e)",
        "field_of_view": "field of view, half (1/e)",
        "dwell": "dwell for a sample",
    }
    for name, label in names.items():
        rows.append(
            [label, *(_written(choice.parameters, name) for _, choice in choices)]
        )
    more: list[tuple[str, Any]] = [
        ("error at the worst distance", lambda choice: f"{choice.error * 1e3:.3g} mm"),
        ("share of waters and targets", lambda choice: f"{choice.share:.0%}"),
        ("binds", lambda choice: choice.binding.replace("_", " ")),
        ("time of a scan", lambda choice: f"{choice.scan_time / 60:.3g} min"),
        ("cost", lambda choice: f"{choice.cost:,.0f}" if choice.cost else "not stated"),
    ]
    rows += [[label, *(text(choice) for _, choice in choices)] for label, text in more]
    driven = [
        lines_texts(choice.lines, choice.parameters)
        for _, choice in choices
        if choice.lines is not None
    ]
    for label in driven[0] if driven else ():
        rows.append([label, *(texts[label] for texts in driven)])
    return Table(
        ["", *(title for title, _ in choices)],
        rows,
        "The runner-up is the best instrument with another laser, scheme, method or "
        "number of frequencies.",
    )


def _written(chosen: Parameters, name: str) -> str:
    value = getattr(chosen, name)
    if name == "frequencies":
        return ", ".join(f"{f / 1e6:.4g}" for f in value) + " MHz"
    return value if isinstance(value, str) else written(name, value)


#: Margins above this have no practical difference [1].
_AMPLE = 1000


def _requirements(choice: Choice) -> Table:
    rows = []
    for one in choice.requirements:
        name = one.name.partition(" at ")[0]
        state = "met" if one.met else "!missed"
        margin = f"{one.margin:.3g}" if one.margin < _AMPLE else f"above {_AMPLE}"
        rows.append(
            [
                one.name,
                state,
                written(name, one.value),
                written(name, one.limit),
                margin,
                one.binding.replace("_", " "),
            ]
        )
    return Table(
        ["requirement", "", "reached", "allowed", "margin", "binds"],
        rows,
        "Margin is what is allowed over what is reached; below 1 it is missed.",
    )


def _measure(
    sensitivity: Sensitivity | None, drawings: dict[str, Figure]
) -> list[Part]:
    if sensitivity is None:
        return []
    largest = sensitivity.largest
    return [
        Heading("Measurements before a purchase"),
        Paragraph(
            f"The error depends most on: {largest.label}. All together change it by a "
            f"factor of {np.exp(sensitivity.spread):.2f} (one standard deviation)."
        ),
        Picture(
            drawings["sensitivity"],
            "Total Sobol indices with standard errors: the share of the variance of "
            "the logarithm of the error that goes with each number. Ranges are those "
            "of the goal; numbers that it assumes were varied by a factor of two.",
        ),
    ]


def _turns(recommendation: Recommendation, turns: Sequence[Turn]) -> list[Part]:
    if recommendation.runner_up is None or not turns:
        return []
    rows = [
        [
            turn.label,
            f"{turn.value:.3g} {turn.unit}"
            if turn.unit != "1"
            else f"{turn.value:.3g}",
            "not within a factor of 10" if turn.turns_at is None else _at(turn),
            "" if turn.factor is None else f"{turn.factor:.3g}",
        ]
        for turn in turns
    ]
    return [
        Heading("Assumptions that would change the answer"),
        Table(
            ["assumption", "as stated", "the runner-up wins at", "factor"],
            rows,
            "One assumption is changed at a time; of ranges the middle is shown, and "
            "they move as a whole.",
        ),
    ]


def _at(turn: Turn) -> str:
    return f"{turn.turns_at:.3g} {'' if turn.unit == '1' else turn.unit}".strip()


def _confirmed(confirmations: Sequence[Confirmation]) -> list[Part]:
    if not confirmations:
        return []
    parts: list[Part] = [Heading("Confirmed by scans and photons")]
    parts += [
        Paragraph(f"{line}.")
        for confirmation in confirmations
        for line in confirmation.said
    ]
    rows = []
    for confirmation in confirmations:
        scans, photons = confirmation.scans, confirmation.photons
        mark = "" if scans.holds else "!"
        row = [
            confirmation.name,
            f"{scans.distance:.3g} m",
            f"{scans.predicted * 1e3:.3g}",
            f"{scans.achieved * 1e3:.3g}",
            f"{mark}{scans.ratio:.3f} ± {scans.ratio_error:.3f}",
            f"{scans.offset * 1e3:+.3f} ± {scans.offset_error * 1e3:.3f}",
        ]
        if photons is None:
            rows.append([*row, "", "", "", "", ""])
            continue
        top = int(np.argmax(photons.frequency))
        shift, rough = photons.shift[top] * 1e3, photons.shift_error[top] * 1e3
        rows.append(
            [
                *row,
                f"{photons.echo[top]:.3f} ± {photons.echo_error[top]:.3f}",
                f"{photons.water[top]:.3f} ± {photons.water_error[top]:.3f}",
                f"{shift:.2f} ± {rough:.2f}",
                f"{confirmation.late * 1e3:.2f}",
                f"{photons.range_bound * 1e3:.3g}"
                if np.isfinite(photons.range_bound)
                else "",
            ]
        )
    header = ["instrument", "at", "predicted [mm]", "achieved [mm]", "ratio"]
    header += ["offset [mm]", "echo", "water", "late by [mm]", "stated [mm]"]
    header += ["bound [mm]"]
    ranges = confirmations[0].scans.ranges
    caption = (
        f"{ranges} simulated ranges of each, through the chosen way to "
        "take the water out; the ratio is to be 0.9 to 1.1. Echo and water before the "
        "target by photon transport over those of the model, at the highest frequency; "
        "how late the echo is, of which imaging takes three quarters off, and what is "
        "stated as the uncertainty of that. The bound is that of Cramér and Rao for "
        "the range of one sample in known water, by derivatives of the photons' light."
    )
    return [*parts, Table(header, rows, caption)]
