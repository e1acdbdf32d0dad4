"""Draws each model of the water beside photon transport: figure and table of a page.

    python docs/make_model_images.py             # from the photons that are kept
    python docs/make_model_images.py --photons   # follows them anew, some minutes

Photons are kept as numbers with standard errors in docs/theory/models-photons.csv.
"""

from __future__ import annotations

import csv
import re
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.constants import speed_of_light

from amulor.errors import AmulorWarning
from amulor.optics import (
    low_pass,
    small_angle,
    small_angle_closure,
    small_angle_diffusion,
    target_echo,
)
from amulor.optics.phase_functions.models import (
    fournier_forand,
    henyey_greenstein_function,
    two_term,
)
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import petzold
from amulor.simulation.transport import half_power
from amulor.transport import GaussianReceiver, Medium, PlaneTarget, Source, simulate
from amulor.view.report import png
from amulor.view.style import COLOURS, new_figure, style

HERE = Path(__file__).parent
KEPT = HERE / "theory" / "models-photons.csv"
PAGES = [HERE / "theory" / f"{name}.md" for name in ("models", "models-details")]
PICTURE = HERE / "images" / "models-photons.png"
VALIDITY = HERE / "images" / "closure-validity.png"

ATTENUATIONS = (0.1, 0.3, 1.0, 2.0)  # [1/m]
ABSORBED = 0.3  # of the attenuation
INDEX = 1.34
BASELINE, DISTANCE, REFLECTANCE, FREQUENCY = 0.20, 2.0, 0.1, 39e6
RECEIVER = {"receiver_radius": 0.02, "acceptance_angle": 0.08}
SWEEP = np.linspace(0.0, 160e6, 161)
HISTORIES = 400_000
QUANTITIES = {
    "cut_off": "cut-off",
    "echo": "echo",
    "ratio": "water over echo",
    "shift": "range shift [mm]",
}


def waters() -> dict[str, PhaseFunction]:
    """Return the phase functions."""
    return {
        "Henyey-Greenstein 0.95": henyey_greenstein_function(asymmetry=0.95),
        "Petzold, harbour": petzold("NUC 2040"),
        "Fournier-Forand": fournier_forand(relative_index=1.1, slope=3.5835),
        "two-term": two_term(
            forward_asymmetry=0.9, backward_asymmetry=-0.4, forward_weight=0.97
        ),
    }


# ------------------------------------------------------------------- the photons


def follow(function: PhaseFunction, attenuation: float, seed: int) -> dict[str, float]:
    """Return what photons say of one water, each number with its standard error."""
    medium = Medium.homogeneous(
        absorption=ABSORBED * attenuation,
        scattering=(1 - ABSORBED) * attenuation,
        phase_function=function,
        group_index=INDEX,
    )
    receiver = GaussianReceiver(
        radius=RECEIVER["receiver_radius"],
        acceptance_angle=RECEIVER["acceptance_angle"],
        position=(BASELINE, 0.0, 0.0),
        direction=(-BASELINE, 0.0, DISTANCE),
    )
    empty = simulate(medium, Source(), receiver, SWEEP, histories=HISTORIES, seed=seed)
    cut_off, cut_off_error = half_power(empty)
    plate = PlaneTarget(position=(0, 0, DISTANCE), reflectance=REFLECTANCE)
    scene = simulate(
        medium,
        Source(),
        receiver,
        [0.0, FREQUENCY],
        histories=HISTORIES * (5 if attenuation > 1.5 else 1),
        seed=seed,
        target=plate,
    )
    parts = [name.startswith("target") for name in scene.parts]
    target = scene.batches[:, np.array(parts), 0, 1].sum(axis=1)
    water = scene.batches[:, ~np.array(parts), 0, 1].sum(axis=1)
    weight = scene.histories_of / scene.histories
    t, w = weight @ target, weight @ water

    def error(change: Any) -> float:
        return float(np.sqrt(scene.covariance_of(change.real)[0, 0]))

    # To first order: changes of logarithms, batch by batch.
    dt, dw = target / t, water / w
    sum_ = (target + water) / (t + w)
    metre = speed_of_light / (4 * np.pi * FREQUENCY * INDEX)
    back = np.hypot(DISTANCE, BASELINE)
    straight = np.exp(
        2j * np.pi * FREQUENCY * INDEX * (DISTANCE + back) / speed_of_light
    )
    return {
        "cut_off": cut_off,
        "cut_off_error": cut_off_error,
        "echo": float(abs(t)),
        "echo_error": float(abs(t)) * error(dt),
        "ratio": float(abs(w / t)),
        "ratio_error": float(abs(w / t)) * error(dw - dt),
        "shift": float(np.angle(1 + w / t)) * metre,
        "shift_error": error(-1j * (sum_ - dt)) * metre,
        "late": float(np.angle(t / straight)) * metre,
        "late_error": error(-1j * dt) * metre,
    }


def keep() -> None:
    """Follow all photons anew and write what they say."""
    rows = []
    for number, (name, function) in enumerate(waters().items()):
        for place, attenuation in enumerate(ATTENUATIONS):
            found = follow(function, attenuation, seed=100 * number + place + 1)
            rows.append({"water": name, "attenuation": attenuation, **found})
            print(name, attenuation, flush=True)
    with KEPT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow(
                {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()}
            )


def kept() -> dict[tuple[str, float], dict[str, float]]:
    """Return the photons that are kept, by water and attenuation."""
    with KEPT.open(encoding="utf-8") as file:
        return {
            (row.pop("water"), float(row["attenuation"])): {
                name: float(value) for name, value in row.items()
            }
            for row in csv.DictReader(file)
        }


# -------------------------------------------------------------------- the models


def models(function: PhaseFunction, attenuation: float) -> dict[str, tuple[Any, Any]]:
    """Return water response and echo of each model."""
    absorption = ABSORBED * attenuation
    scattering = (1 - ABSORBED) * attenuation
    # The receiver looks at the spot; the offset across its own axis is shorter.
    back = np.hypot(DISTANCE, BASELINE)
    view = {
        **RECEIVER,
        "baseline": BASELINE * DISTANCE / back,
        "tilt": BASELINE / back,
    }
    plate = {
        "depth": DISTANCE,
        # The models count the way of the water straight, as here.
        "optical_path": 2 * DISTANCE * INDEX,
        "reflectance": REFLECTANCE,
        "return_path": back,
        "cosine": DISTANCE / back,
    }
    whole = {
        "absorption": absorption,
        "scattering": scattering,
        "phase_function": function,
        "split_angle": np.pi / 2,
        **view,
    }
    found = {
        "small-angle (29)": (
            partial(small_angle.water_response, group_index=INDEX, **whole),
            partial(target_echo.small_angle_target_response, **plate, **whole),
        ),
        "closure": (
            partial(small_angle_closure.water_response, group_index=INDEX, **whole),
            partial(target_echo.closure_target_response, **plate, **whole),
        ),
    }
    for degrees in (15, 90):
        share, moment = function.forward_split(np.radians(degrees))
        parts = {
            "absorption": absorption,
            "forward_scattering": share * scattering,
            "diffuse_scattering": (1 - share) * scattering,
            "second_moment": moment,
            **view,
        }
        found[f"diffusion, {degrees}°"] = (
            partial(
                small_angle_diffusion.water_response,
                backscatter_vsf=scattering * function.at_180,
                group_index=INDEX,
                **parts,
            ),
            partial(target_echo.target_response, **plate, **parts),
        )
    return found


def said(response: Callable[..., Any], echo: Callable[..., Any]) -> dict[str, float]:
    """Return what a model says of the same quantities."""
    t = complex(echo(FREQUENCY))
    w = complex(response(FREQUENCY, end=DISTANCE))
    metre = speed_of_light / (4 * np.pi * FREQUENCY * INDEX)
    return {
        "cut_off": float(low_pass.cut_off(response, maximum_frequency=3e8)),
        "echo": abs(t),
        "ratio": abs(w / t),
        "shift": float(np.angle(1 + w / t)) * metre,
    }


def compared() -> dict[str, dict[tuple[str, float], dict[str, float]]]:
    """Return what all models say, by model, water and attenuation."""
    result: dict[str, dict[tuple[str, float], dict[str, float]]] = {}
    with warnings.catch_warnings():
        # Where the closure does not hold is what the page shows.
        warnings.simplefilter("ignore", AmulorWarning)
        for name, function in waters().items():
            for attenuation in ATTENUATIONS:
                for model, pair in models(function, attenuation).items():
                    result.setdefault(model, {})[name, attenuation] = said(*pair)
    return result


def drawn(photons: dict[Any, Any], found: dict[str, Any]) -> Figure:
    """Draw each quantity of each model against attenuation, over that of photons."""
    colours = dict(
        zip(found, ("black", COLOURS[2], COLOURS[0], COLOURS[1]), strict=True)
    )
    marks = dict(zip(found, ("o-", "s--", "^-.", "v:"), strict=True))
    k = np.array(ATTENUATIONS)
    with style():
        figure = new_figure(7.4, 7.6)
        panels = figure.subplots(4, 4, sharex=True, sharey="row")
        for column, water in enumerate(waters()):
            for row, quantity in enumerate(QUANTITIES):
                axis = panels[row, column]
                seen = [photons[water, each] for each in ATTENUATIONS]
                true = np.array([each[quantity] for each in seen])
                error = 2 * np.array([each[f"{quantity}_error"] for each in seen])
                wide = error / abs(true)
                axis.fill_between(
                    k,
                    1 - wide,
                    1 + wide,
                    color="#bbbbbb",
                    lw=0,
                    label="photons, two standard errors",
                )
                axis.axhline(1, color="#777777", lw=0.8)
                for model, values in found.items():
                    y = np.array([values[water, each][quantity] for each in k])
                    axis.plot(
                        k,
                        y / true,
                        marks[model],
                        color=colours[model],
                        ms=3.5,
                        lw=1.1,
                        label=model,
                    )
                axis.set_xscale("log")
                axis.set_yscale("log")
                ticks = {
                    "cut_off": (1, 1.2, 1.5),
                    "echo": (0.2, 0.5, 1),
                    "ratio": (1, 2, 5),
                    "shift": (1, 2, 4),
                }[quantity]
                axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
                axis.minorticks_off()
                axis.set_xticks(k, [f"{each:g}" for each in k])
                axis.grid(True)
                if column == 0:
                    name = QUANTITIES[quantity].removesuffix(" [mm]")
                    axis.set_ylabel(f"{name},\nmodel / photons")
                if row == 0:
                    axis.set_title(water)
                if row == 3:
                    axis.set_xlabel("attenuation k [1/m]")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def table(photons: dict[Any, Any], found: dict[str, Any]) -> str:
    """Return the same as a table of a page."""
    lines = [
        "| water | k [1/m] | quantity | photons | " + " | ".join(found) + " |",
        "| --- " * (4 + len(found)) + "|",
    ]
    for water in waters():
        for attenuation in ATTENUATIONS:
            seen = photons[water, attenuation]
            for quantity in QUANTITIES:
                value, error = seen[quantity], seen[f"{quantity}_error"]
                if quantity == "shift":
                    shown = f"{value * 1e3:.2f} ± {error * 1e3:.2f} mm"
                    cells = [
                        f"{values[water, attenuation][quantity] * 1e3:.2f} mm"
                        for values in found.values()
                    ]
                else:
                    scale, unit = {
                        "cut_off": (1e6, " MHz"),
                        "echo": (1, ""),
                        "ratio": (1, ""),
                    }[quantity]
                    shown = f"{value / scale:.3g}{unit} ± {100 * error / value:.1f} %"
                    cells = [
                        f"{values[water, attenuation][quantity] / value:.3f}"
                        for values in found.values()
                    ]
                name = QUANTITIES[quantity].removesuffix(" [mm]")
                lines.append(
                    f"| {water} | {attenuation:g} | {name} | {shown} | "
                    + " | ".join(cells)
                    + " |"
                )
    return "\n".join(lines)


def summary(photons: dict[Any, Any], found: dict[str, Any]) -> str:
    """Return the range of each ratio over all waters, for each model."""
    names = [name.removesuffix(" [mm]") for name in QUANTITIES.values()]
    lines = ["| model | " + " | ".join(names) + " |", "| --- " * 5 + "|"]
    for model, values in found.items():
        cells = []
        for quantity in QUANTITIES:
            each = [values[key][quantity] / photons[key][quantity] for key in photons]
            cells.append(f"{min(each):.2f} to {max(each):.2f}")
        lines.append(f"| {model} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


# ------------------------------------------------------- where the closure holds

ACCEPTANCES = (0.005, 0.01, 0.02, 0.03, 0.05, 0.08, 0.1)  # [rad]
BASELINES = (0.0, 0.1, 0.2, 0.4)  # [m]
DEPTH = 2.0  # [m]


def validity() -> list[dict[str, float]]:
    """Return closure over (29) for receivers that look ahead, and what it says."""
    function = waters()["Henyey-Greenstein 0.95"]
    rows = []
    for attenuation in (0.3, 1.0):
        for baseline in BASELINES:
            for acceptance in ACCEPTANCES:
                column: dict[str, Any] = {
                    "absorption": ABSORBED * attenuation,
                    "scattering": (1 - ABSORBED) * attenuation,
                    "phase_function": function,
                    "split_angle": np.pi / 2,
                    "receiver_radius": RECEIVER["receiver_radius"],
                    "acceptance_angle": acceptance,
                    "baseline": baseline,
                }
                forms = small_angle_closure, small_angle
                echo = [form.overlap(DEPTH, **column) for form in forms]
                with warnings.catch_warnings(record=True) as warned:
                    warnings.simplefilter("always", AmulorWarning)
                    corner = [
                        low_pass.cut_off(
                            partial(form.water_response, group_index=INDEX, **column),
                            maximum_frequency=1e9,
                        )
                        for form in forms
                    ]
                off = float(small_angle_closure.departure(DEPTH, **column))
                rows.append(
                    {
                        "attenuation": attenuation,
                        "baseline": baseline,
                        "acceptance": acceptance,
                        "echo": float(echo[0] / echo[1]),
                        "echo_holds": abs(off) <= 0.25,
                        "cut_off": float(corner[0] / corner[1]),
                        "cut_off_holds": not warned,
                    }
                )
    return rows


def validity_drawn(rows: list[dict[str, float]]) -> Figure:
    """Draw closure over (29) against the acceptance: filled where it holds."""
    with style():
        figure = new_figure(7.4, 5.2)
        panels = figure.subplots(2, 2, sharex=True, sharey="row")
        for column, attenuation in enumerate((0.3, 1.0)):
            for row, quantity in enumerate(("echo", "cut_off")):
                axis = panels[row, column]
                axis.axhline(1, color="#777777", lw=0.8)
                for number, baseline in enumerate(BASELINES):
                    own = [
                        each
                        for each in rows
                        if (each["attenuation"], each["baseline"])
                        == (attenuation, baseline)
                    ]
                    x = np.array([1e3 * each["acceptance"] for each in own])
                    y = np.array([each[quantity] for each in own])
                    holds = np.array([each[f"{quantity}_holds"] for each in own])
                    colour = COLOURS[number]
                    axis.plot(x, y, color=colour, lw=0.8)
                    axis.plot(
                        x[~holds], y[~holds], "o", color=colour, mfc="white", ms=5
                    )
                    axis.plot(
                        x[holds],
                        y[holds],
                        "o",
                        color=colour,
                        ms=5,
                        label=f"baseline {100 * baseline:g} cm",
                    )
                axis.set_xscale("log")
                axis.set_xticks(
                    [5, 10, 20, 30, 50, 100], ["5", "10", "20", "30", "50", "100"]
                )
                axis.minorticks_off()
                axis.grid(True)
                if row == 0:
                    axis.set_title(f"attenuation {attenuation:g} 1/m")
                else:
                    axis.set_xlabel("acceptance [mrad]")
        panels[0, 0].set_ylabel("echo at 2 m,\nclosure / (29)")
        panels[1, 0].set_ylabel("cut-off,\nclosure / (29)")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def validity_table(rows: list[dict[str, float]]) -> str:
    """Return the range of both ratios where the closure holds and where it warns."""
    lines = [
        "| closure divided by (29) | without a warning | with a warning |",
        "| --- | --- | --- |",
    ]
    for quantity, name in (("echo", "echo at 2 m"), ("cut_off", "cut-off")):
        cells = []
        for holds in (True, False):
            own = [
                each[quantity] for each in rows if each[f"{quantity}_holds"] == holds
            ]
            cells.append(f"{min(own):.2f} to {max(own):.2f} ({len(own)} receivers)")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Draw the figures and write the tables of the page."""
    if "--photons" in sys.argv[1:]:
        keep()
    rows = validity()
    VALIDITY.write_bytes(png(validity_drawn(rows), dots_per_inch=150))
    photons, found = kept(), compared()
    PICTURE.write_bytes(png(drawn(photons, found), dots_per_inch=150))
    tables = {
        "summary": summary(photons, found),
        "table": table(photons, found),
        "validity": validity_table(rows),
    }
    for path in PAGES:
        page = re.sub(
            r"<!-- (\w+) -->\n.*?<!-- end -->",
            lambda match: f"<!-- {match[1]} -->\n{tables[match[1]]}\n<!-- end -->",
            path.read_text(encoding="utf-8"),
            flags=re.DOTALL,
        )
        path.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
