"""Figures 5, 6, 13, 14 and 15 of Ricci et al. 2010: scans of ladder and disc."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures.panels import (
    SYNTHETIC,
    WIDE,
    Relief,
    draw_surfaces,
    letter,
    mark_synthetic,
    masked,
    median,
    relief,
    styled,
)
from amulor.studies.ricci2010.results import Check, Role, statements
from amulor.studies.ricci2010.scenes.disc_scans import (
    DiscScan,
    Outline,
    Outlines,
    bent_disc,
    bright,
    outlines,
)
from amulor.studies.ricci2010.scenes.ladder_scans import (
    PANELS,
    LadderScan,
    Steps,
    cut_off,
    phase_step,
    polarized_milk,
    steps_agree,
    steps_are_faithful,
    unpolarized_clear,
    unpolarized_turbid,
)
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure

#: Views of figures 5 and 15, each with elevation and azimuth [degree].
_LADDER_SIDES = {
    "from the left": (30, -120),
    "from the right": (30, -60),
    "along the treads": (6, -90),
}
_DISC_SIDES = {"from the front": (58, -62), "along the disc": (16, -90)}
#: Heights of the darkest and the lightest colour [mm].
_LADDER_SHADES, _DISC_SHADES = (-12.0, 82.0), (-24.0, 32.0)
#: Heights that figure 13 shows [mm].
_LIMITS = (-30.0, 130.0)
#: Fraction of the lines that must have a range in a column for its mean [1].
_VALID = 0.9
#: Range error that the text states for each panel of figure 13: the limits are these
#: over and times 1.5, in (b) between those of (a) and (c) [mm].
_ERRORS: tuple[tuple[float, float, Role], ...] = (
    (0.5 / 1.5, 0.5 * 1.5, "set"),
    (0.5, 2.0, "test"),
    (2 / 1.5, 2 * 1.5, "set"),
    (10 / 1.5, 10 * 1.5, "set"),
)


def clear_checks(study: Study) -> list[Check]:
    """Compare the ladder scan in clear water with the text of the paper."""
    rows = statements(5)
    scan = study.once(unpolarized_clear)
    megahertz = study["frequency"] / 1e6
    tank = cut_off(scan.survey, end=study["short_length"])
    steps = scan.steps(scan.stated["none"])
    subtracted = scan.steps(scan.subtracted["none"])
    return [
        rows.within("cut_off", cut_off(scan.survey) / 1e6, high=megahertz),
        rows.within("tank_end", tank / 1e6, high=megahertz),
        steps_are_faithful(study, rows, "faithful", steps),
        steps_agree(study, rows, "frequency", steps),
        steps_agree(study, rows, "subtracted", subtracted),
    ]


@styled
def draw_clear(study: Study) -> Figure:
    """Draw the ladder scan in clear water from three sides."""
    scan = study.once(unpolarized_clear)
    surface, scatter = median(
        relief(scan.stated["none"], origin=study["short_distance"])
    )
    figure = draw_surfaces(
        2.7,
        [
            (side, surface, {"elevation": high, "azimuth": around})
            for side, (high, around) in _LADDER_SIDES.items()
        ],
        rows=1,
        limits=(-5.0, 75.0),
        shades=_LADDER_SHADES,
        zoom=1.1,
    )
    figure.suptitle(f"a pixel ± {scatter:.1f} mm", fontsize=7)
    return figure


def turbid_checks(study: Study) -> list[Check]:
    """Compare the ladder scans in turbid water with the text of the paper."""
    rows = statements(6)
    scan, clear = study.once(unpolarized_turbid), study.once(unpolarized_clear)
    raw, subtracted, clear_raw, clear_subtracted = (
        of.steps(images["none"])
        for of in (scan, clear)
        for images in (of.raw, of.subtracted)
    )
    thickness = study["ladder_attenuation"] * study["turbid_distance"]
    return [
        rows.within("cut_off", study["frequency"] / cut_off(scan.survey)),
        steps_are_faithful(study, rows, "faithful", raw),
        rows.within("thin", thickness),
        rows.within("rougher", raw.noise / clear_raw.noise),
        steps_agree(study, rows, "subtracted", subtracted),
        *[
            rows.holds(
                name,
                turbid.error > other.error,
                f"{turbid.error * 1e3:.3g} against {other.error * 1e3:.3g} mm",
            )
            for name, turbid, other in (
                ("error_raw", raw, clear_raw),
                ("error_subtracted", subtracted, clear_subtracted),
            )
        ],
    ]


def draw_turbid(study: Study) -> Figure:
    """Draw the ladder scan in turbid water, before and after water subtraction."""
    scan = study.once(unpolarized_turbid)
    panels = [
        ("frequency alone", scan, scan.raw["none"]),
        ("open water subtracted", scan, scan.subtracted["none"]),
    ]
    return _draw_ladders(panels, 3.3, rows=1, limits=(-15.0, 85.0))


def _draw_ladders(
    panels: list[tuple[str, LadderScan, Any]],
    height: float,
    *,
    rows: int,
    limits: tuple[float, float],
) -> Figure:
    """Draw range images of the ladder as surfaces above the farthest tread."""
    views = []
    for title, scan, image in panels:
        surface, scatter = median(relief(image, origin=scan.farthest(image)))
        views.append(
            (f"{title}: a pixel ± {scatter:.1f} mm", surface, {"azimuth": -115})
        )
    return draw_surfaces(
        height, views, rows=rows, limits=limits, shades=_LADDER_SHADES, zoom=1.15
    )


def profile_checks(study: Study) -> list[Check]:
    """Compare the ladder profiles with the text of the paper."""
    rows = statements(13)
    result: list[Check] = []
    noises: list[float] = []
    for panel, (title, scan_of, channel), (low, high, role) in zip(
        "abcd", PANELS, _ERRORS, strict=True
    ):
        scan = study.once(scan_of)
        steps = scan.steps(scan.raw[channel])
        words = {"panel": panel, "title": title}
        if scan_of is PANELS[0][1]:
            result += _phases(study, steps, words)
        noise = steps.noise * 1e3
        noises.append(noise)
        error = noise / math.sqrt(2 * max(steps.pixels, 1))
        result.append(
            rows.within(
                "error", noise, low, high, uncertainty=error, role=role, **words
            )
        )
    return [
        *result,
        *_in_milk(study),
        rows.holds(
            "grows",
            noises[0] <= noises[1] < noises[2] < noises[3],
            ", ".join(f"{noise:.2g}" for noise in noises) + " mm",
        ),
        *(
            steps_agree(
                study,
                rows,
                "subtracted",
                study.once(scan_of).steps(study.once(scan_of).subtracted[channel]),
                panel=panel,
                title=title,
            )
            for panel, (title, scan_of, channel) in zip("abcd", PANELS, strict=True)
        ),
    ]


def _in_milk(study: Study) -> list[Check]:
    """Check the step heights in milk, with water rejection by polarizers only."""
    rows = statements(13)
    scan = study.once(polarized_milk)
    crossed, parallel = (scan.off(scan.raw[name]) * 1e3 for name in ("VH", "VV"))
    steps = scan.steps(scan.raw["VH"])
    worst = float(crossed[np.argmax(np.abs(crossed))])
    error = float(steps.uncertainties.max()) * 1e3
    return [
        rows.within("well", float(steps.heights.min() / steps.noise)),
        rows.within("right", worst, uncertainty=error),
        rows.holds(
            "degraded",
            np.abs(parallel).max() - abs(worst) > 2.0,
            f"{parallel[np.argmax(np.abs(parallel))]:+.1f} against {worst:+.1f} mm",
        ),
    ]


def _phases(study: Study, steps: Steps, words: dict[str, str]) -> list[Check]:
    """Check the phase steps between treads of the ladder, with a tolerance of 5 %."""
    rows = statements(13)
    # Neighbouring steps share a tread, which makes their mean better than this.
    error = math.sqrt(float(np.sum(steps.uncertainties[1:] ** 2))) / 3
    return [
        rows.within(
            name,
            math.degrees(phase_step(study, height)),
            0.95 * true,
            1.05 * true,
            uncertainty=math.degrees(phase_step(study, uncertainty)),
            **words,
        )
        for name, height, uncertainty, true in (
            ("phase_first", steps.heights[0], steps.uncertainties[0], 5.0),
            ("phase_others", float(np.mean(steps.heights[1:])), error, 1.25),
        )
    ]


@styled
def draw_profiles(study: Study) -> Figure:
    """Draw the superposed height profiles of all scan lines."""
    figure = new_figure(WIDE, 4.3)
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for axis, (_, scan_of, channel) in zip(axes.flat, PANELS, strict=True):
        scan = study.once(scan_of)
        surfaces: dict[str, Relief] = {}
        for name, images in (("raw", scan.raw), ("subtracted", scan.subtracted)):
            image = images[channel]
            surfaces[name] = relief(image, origin=scan.farthest(image))
        closest = surfaces["raw"].near
        shown = (closest > _LIMITS[0]) & (closest < _LIMITS[1])
        lines = axis.plot(
            surfaces["raw"].right.T,
            np.where(shown, closest, np.nan).T,
            color=COLOURS[0],
            lw=0.5,
            alpha=0.35,
            zorder=2,
        )
        lines[0].set_label(f"{SYNTHETIC}, {len(lines)} lines, polarizers alone")
        valid = np.isfinite(surfaces["subtracted"].near)
        drawn_columns = valid.mean(axis=0) > _VALID
        mean = np.full(drawn_columns.size, np.nan)
        mean[drawn_columns] = np.nanmean(
            surfaces["subtracted"].near[:, drawn_columns], axis=0
        )
        axis.plot(
            np.mean(surfaces["subtracted"].right, axis=0),
            mean,
            color=COLOURS[1],
            lw=1.2,
            ls=(0, (3, 1.5)),
            label="their mean, open water subtracted",
            zorder=4,
        )
        edges, heights = _ladder(study)
        axis.stairs(
            heights,
            edges,
            baseline=None,
            color=COLOURS[6],
            lw=0.9,
            label="ladder",
            zorder=3,
        )
        axis.set_ylim(*_LIMITS)
        axis.set_xlim(edges[0], edges[-1])
        axis.grid(lw=0.3)
    letter(axes.flat, [title for title, *_ in PANELS])
    for axis in axes[-1]:
        axis.set_xlabel("right [mm]")
    for axis in axes[:, 0]:
        axis.set_ylabel("nearer [mm]")
    drawn = axes[0, 0].get_legend_handles_labels()
    legend = figure.legend(*drawn, loc="outside upper center", ncols=3)
    legend.get_lines()[0].set(alpha=1.0, linewidth=1.2)
    mark_synthetic(figure)
    return figure


def _ladder(study: Study) -> tuple[list[float], list[float]]:
    """Return the true edges and heights of the ladder's treads [mm]."""
    steps = [study["first_step"], *[study["other_steps"]] * 3]
    heights = np.concatenate([[0.0], np.cumsum(steps)]) * 1e3
    width = study["tread_width"] * 1e3
    edges = (np.arange(heights.size + 1) - heights.size / 2) * width
    return list(edges), list(heights)


def surface_checks(study: Study) -> list[Check]:
    """Compare the ladder surfaces with the text of the paper."""
    rows = statements(14)
    milk = study.once(polarized_milk)
    crossed, parallel = (
        float(milk.steps(milk.raw[name]).heights.sum()) * 1e3 for name in ("VH", "VV")
    )
    true = (study["first_step"] + 3 * study["other_steps"]) * 1e3
    result = [
        rows.holds(
            "smoothed",
            parallel < crossed <= true,
            f"{crossed:.1f} and {parallel:.1f} of {true:.0f} mm",
        )
    ]
    for stage in ("raw", "subtracted"):
        errors = []
        for _, scan_of, channel in PANELS:
            scan = study.once(scan_of)
            errors.append(scan.steps(getattr(scan, stage)[channel]).error * 1e3)
        result.append(
            rows.holds(
                stage,
                errors[0] <= errors[1] < errors[2] < errors[3],
                ", ".join(f"{error:.2g}" for error in errors) + " mm",
            )
        )
    return result


def draw_surfaces_of_ladder(study: Study) -> Figure:
    """Draw the ladder scans of figure 13 as surfaces."""
    panels = [
        (title, study.once(scan_of), study.once(scan_of).raw[channel])
        for title, scan_of, channel in PANELS
    ]
    return _draw_ladders(panels, 5.8, rows=2, limits=(-25.0, 122.0))


def disc_checks(study: Study) -> list[Check]:
    """Compare the disc scan with the text of the paper."""
    rows = statements(15)
    scan = study.once(bent_disc)
    stages = (
        ("the polarizers alone", scan.raw, "section 9, on figure 15"),
        ("open water subtracted", scan.subtracted, ""),
    )
    result: list[Check] = []
    for stage, images, _ in stages:
        for channel, image in images.items():
            measured = outlines(image, distance=study["short_distance"])
            words = {"channel": channel, "stage": stage}
            result += _outline_checks(study, scan, measured, words)
    for stage, images, place in stages:
        crossed, parallel = (scan.contrast(images[name]) for name in ("VH", "VV"))
        difference = crossed.value - parallel.value
        error = math.hypot(crossed.uncertainty, parallel.uncertainty)
        rms = {name: scan.error(image)[0] * 1e3 for name, image in images.items()}
        result += [
            rows.holds(
                "contrast",
                difference > 2 * error,
                f"{crossed.value:.4f} against {parallel.value:.4f}, ± {error:.2g}",
                stage=stage,
                place=place,
            ),
            rows.holds(
                "error",
                rms["VH"] < rms["VV"],
                f"{rms['VH']:.2g} against {rms['VV']:.2g} mm",
                stage=stage,
                place=place,
            ),
        ]
    return result


def _outline_checks(
    study: Study, scan: DiscScan, measured: Outlines, words: dict[str, str]
) -> list[Check]:
    """Check diameters of disc and holes to within a pixel, and the number of holes."""
    rows = statements(15)
    small = measured.small_holes[:4]
    mean = None
    if len(small) == 4:
        mean = Outline(
            float(np.mean([hole.diameter for hole in small])),
            math.sqrt(sum(hole.uncertainty**2 for hole in small)) / 4,
        )
    count = len(measured.small_holes)
    return [
        rows.within(
            "diameter",
            math.nan if outline is None else outline.diameter * 1e3,
            (true - scan.pitch) * 1e3,
            (true + scan.pitch) * 1e3,
            uncertainty=None if outline is None else outline.uncertainty * 1e3,
            outline=name,
            **words,
        )
        for name, outline, true in (
            ("diameter of the disc", measured.rim, study["disc_diameter"]),
            ("central hole", measured.central_hole, study["disc_central_hole"]),
            ("small holes, mean of four", mean, study["disc_holes"]),
        )
    ] + [rows.holds("holes", count == 4, str(count), **words)]


def draw_disc(study: Study) -> Figure:
    """Draw the disc from the front and from the side, cross- and co-polarized."""
    scan = study.once(bent_disc)
    bend, half = study["disc_bend"], study["disc_diameter"] / 2
    # The middle stands before the rim.
    rim = study["short_distance"] + bend - math.sqrt(bend**2 - half**2)
    views: list[tuple[str, Relief, dict[str, float]]] = []
    for channel, image in scan.raw.items():
        moved = scan.moved(image)
        surface, scatter = median(
            masked(relief(image, origin=rim - moved), bright(image))
        )
        views += [
            (
                f"{channel}, {side}: {moved * 1e3:.0f} mm nearer, a pixel ± "
                f"{scatter:.1f} mm",
                surface,
                {"elevation": high, "azimuth": around},
            )
            for side, (high, around) in _DISC_SIDES.items()
        ]
    return draw_surfaces(
        5.6, views, rows=2, limits=(-29.0, 44.0), shades=_DISC_SHADES, zoom=1.15
    )
