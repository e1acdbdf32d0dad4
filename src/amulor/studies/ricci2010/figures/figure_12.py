"""Figure 12 of Ricci et al. 2010: crossed linear and same circular at most milk."""

from __future__ import annotations

import textwrap
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures import panels
from amulor.studies.ricci2010.figures.panels import WIDE, letter, mark_synthetic
from amulor.studies.ricci2010.results import Check, within
from amulor.studies.ricci2010.scenes import short_lines, trade_off
from amulor.studies.ricci2010.scenes import short_lines as lines
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure, style

TITLE = "Crossed linear against same circular polarization"
CAPTION = (
    "(a) Advance of the phase along a line at the highest turbidity of figures 10 and "
    "11: crossed linear (VH, filled) and same circular (RR, open) polarization. Marks "
    "are synthetic measurements: polarized Monte Carlo in Mie spheres of milk, with "
    "the phase error of the apparatus added. Black: without noise. (b) Drifts of VH "
    "and RR without noise at the same turbidity with other particles and other tanks, "
    "with standard errors where they are visible. The reflectance of the plate makes "
    "VV drift by 7 degrees. It is printed beside each row; open circles need more "
    "than 1. Shaded: the statement of the text on both."
)

#: Drift of VH in figure 10(d) that the text states, read to half a degree [degrees].
_CROSSED = (2.5, 3.5)
#: Set-ups with less drift than this are named together [degrees].
_CROWDED = 0.45


def checks(study: Study) -> list[Check]:
    """Return what the text says of figure 12."""
    margin, error = lines.difference(study, "d", ("VH", "RR"))
    crossed, same = (abs(lines.line(study, "d", pair).drift) for pair in ("VH", "RR"))
    check = within(
        "RR drifts by less than VH, by more than the phase error",
        margin,
        short_lines.FLAT,
        np.inf,
        place="section 9, on figures 11(d) and 12",
        unit="deg",
        uncertainty=error,
    )
    kept = [
        lines.rejected_share(study, "d", pairs)
        for pairs in (("RR", "RL"), ("VH", "VV"))
    ]
    result = (
        f"{check.found} (VH {crossed:.2f}, RR {same:.2f} deg); the water passes "
        f"{kept[0] / kept[1]:.2g} times as much light of the same hand as crossed, "
        f"and less than {echo_ratio(study):.2g} times would be needed"
    )
    sure = margin - short_lines.SURE * error >= short_lines.FLAT
    return [short_lines.surely(replace(check, found=result), sure)]


def echo_ratio(study: Study) -> float:
    """Return the echo of the plate behind RR over that behind VH.

    In light exactly back from particles without order reciprocity makes
    m44 = 1 - 2 m22, so that the ratio of the water is 2 there, at any order of
    scattering. The ratio of the plate reaches 2 where m44 is -0.22, the upper end of
    what can exist, and is lower elsewhere.
    """
    return (1 + study["m44_target"]) / (1 - study["m22_target"])


def draw(study: Study) -> Figure:
    """Return figure 12, and beside it what other set-ups would give."""
    with style():
        figure = new_figure(WIDE, 3.6)
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
        panels.panel(study, left, "d", ("VH", "RR"), subtracted=False)
        left.legend(loc="upper left")
        left.set_ylim(-1.6, 3.4)
        _draw_trade_off(study, right)
        letter((left, right), ("the line", "other milk, other tanks: VV at 7 degrees"))
        mark_synthetic(figure)
    return figure


def _draw_trade_off(study: Study, axis: Axes) -> None:
    """Draw what each set-up makes of VH and RR, and what the text states."""
    low, high = _CROSSED
    axis.fill_between(
        [low, high],
        [short_lines.FLAT, short_lines.FLAT],
        [low - short_lines.FLAT, high - short_lines.FLAT],
        color=COLOURS[2],
        alpha=0.25,
        lw=0,
        label="what the text states",
    )
    ends = np.linspace(0.0, 4.0, 81)
    axis.plot(ends, ends, color="#777777", lw=0.8, label="RR as VH")
    axis.plot(
        ends,
        2 / echo_ratio(study) * ends,
        "--",
        color="#777777",
        lw=0.8,
        label="water straight back, this plate",
    )
    groups = dict.fromkeys(set_up.group for set_up in trade_off.SET_UPS)
    colour = dict(zip(groups, (COLOURS[0], COLOURS[1], COLOURS[3]), strict=True))
    named: set[str] = set()
    crowd: list[trade_off.Drifts] = []
    for found in study.once(trade_off.drifts):
        group = found.set_up.group
        possible = found.reflectance <= 1
        axis.errorbar(
            found.crossed,
            found.same,
            xerr=found.crossed_error,
            yerr=found.same_error,
            fmt="o",
            ms=4,
            lw=0.7,
            color=colour[group],
            mfc=colour[group] if possible else "white",
            label=None if group in named else group,
        )
        named.add(group)
        if max(found.crossed, found.same) < _CROWDED:
            crowd.append(found)
            continue
        axis.annotate(
            f"{found.set_up.label}, {found.reflectance:.2g}",
            (found.crossed, found.same),
            xytext=(5, -7),
            textcoords="offset points",
            fontsize=5.5,
        )
    if crowd:
        near = "; ".join(f"{d.set_up.label}, {d.reflectance:.2g}" for d in crowd)
        axis.text(
            -0.6,
            -0.85,
            textwrap.fill(f"near 0: {near}", 66),
            fontsize=5.5,
            va="bottom",
        )
    axis.set(xlabel="drift of VH [degree]", ylabel="drift of RR [degree]")
    axis.set_xlim(-0.7, 4.0)
    axis.set_yscale("symlog", linthresh=1.0, linscale=0.7)
    axis.set_ylim(-0.9, 25)
    axis.set_yticks([0, 1, 3, 10, 20], ["0", "1", "3", "10", "20"])
    axis.grid(True)
    axis.legend(loc="upper left", fontsize=6)
