"""Figures 10 to 12 of Ricci et al. 2010: phase along a plate behind polarizers."""

from __future__ import annotations

import textwrap
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from amulor.studies.ricci2010.figures.panels import (
    SYNTHETIC,
    WIDE,
    letter,
    mark_synthetic,
    styled,
)
from amulor.studies.ricci2010.results import Check, statements
from amulor.studies.ricci2010.scenes import short_lines as lines
from amulor.studies.ricci2010.scenes import trade_off
from amulor.studies.ricci2010.scenes.milk import PIXELS
from amulor.studies.ricci2010.scenes.short_lines import TURBIDITIES
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure

#: Drifts of VH and VV in (d) of figure 10 that the text states [degrees].
_CROSSED, _PARALLEL = 3.0, 7.0
#: The former as it is read, to half a degree [degrees].
_CROSSED_LIMITS = (2.5, 3.5)
#: Set-ups with less drift than this are named together [degrees].
_CROWDED = 0.45
#: Colour of each pair.
_COLOUR = {"VV": COLOURS[0], "VH": COLOURS[1], "RL": COLOURS[2], "RR": COLOURS[3]}


def linear_checks(study: Study) -> list[Check]:
    """Compare the phase along the plate with the paper, for linear polarization."""
    rows = statements(10)

    def drift(name: str) -> Check:
        return lines.drift_check(study, rows, name)

    before, middle, after = (lines.line(study, step, "VV") for step in "bcd")
    crossed = drift("d_VH")
    share = lines.rejected_share(study, "d", ("VH", "VV"))
    note = (
        f"; {100 * share:.2g} % of the water's light is cross-polarized, and "
        f"{100 * needed_crossed_share(study):.2g} % would be needed"
    )
    thin, thick = (
        study[TURBIDITIES[step]] * study["short_distance"] for step in ("c", "d")
    )
    return [
        *(drift(name) for name in ("tap_VV", "tap_VH", "b_VV", "b_VH")),
        rows.within(
            "c_VV", middle.drift, before.drift, after.drift, uncertainty=middle.error
        ),
        drift("c_VH"),
        drift("d_VV"),
        replace(crossed, found=crossed.found + note),
        _overlap(study),
        *(lines.straight_check(study, rows, step, "VV") for step in "bcd"),
        rows.holds("thickness", thin < 1 < thick, f"{thin:.2f}, {thick:.2f}"),
    ]


def _overlap(study: Study) -> Check:
    """Check that the water-to-plate ratio is least at pixel 1, largest at pixel 80."""
    ratios = [lines.water_over_plate(study, step, "VV") for step in ("b", "c", "d")]
    ends = [(int(np.argmin(r)) + 1, int(np.argmax(r)) + 1) for r in ratios]
    return statements(10).holds(
        "overlap",
        all(end == (1, ratios[0].size) for end in ends),
        "; ".join(
            f"{100 * r.min():.1f} % of the plate's light at {low}, {100 * r.max():.1f} "
            f"% at {high}"
            for r, (low, high) in zip(ratios, ends, strict=True)
        ),
    )


def needed_crossed_share(study: Study) -> float:
    """Return the cross-polarized fraction of water light required by panel (d) [1]."""
    m22 = study["m22_target"]
    ratio = _CROSSED / _PARALLEL * (1 - m22) / (1 + m22)
    return ratio / (1 + ratio)


def circular_checks(study: Study) -> list[Check]:
    """Compare the phase along the plate with the paper, for circular polarization."""
    rows = statements(11)
    apart, error = lines.difference(study, "tap", ("RL", "RR"))
    turbid = lines.line(study, "d", "RR")
    return [
        rows.within("tap", apart, -lines.FLAT, lines.FLAT, uncertainty=error),
        *(
            lines.drift_check(study, rows, name)
            for name in ("b_RL", "c_RL", "d_RL", "b_RR", "c_RR", "d_RR")
        ),
        rows.within("less", turbid.drift, uncertainty=turbid.error),
    ]


def crossed_checks(study: Study) -> list[Check]:
    """Check the paper's statement that the phase of RR drifts less than that of VH."""
    margin, error = lines.difference(study, "d", ("VH", "RR"))
    crossed, circular = (
        abs(lines.line(study, "d", pair).drift) for pair in ("VH", "RR")
    )
    shares = [
        lines.rejected_share(study, "d", pairs)
        for pairs in (("RR", "RL"), ("VH", "VV"))
    ]
    check = statements(12).within(
        "less",
        margin,
        low=lines.FLAT,
        uncertainty=error,
        note=f" (VH {crossed:.2f}, RR {circular:.2f} deg); the share of the water's "
        f"light in RR is {shares[0] / shares[1]:.2g} times that in VH, "
        f"and less than {echo_ratio(study):.2g} times would be needed",
    )
    return [lines.surely(check, margin - lines.SURE * error >= lines.FLAT)]


def echo_ratio(study: Study) -> float:
    """Return the ratio of the plate's echo behind RR to its echo behind VH.

    For exact backscattering by randomly oriented particles, reciprocity implies
    m44 = 1 - 2 m22. The water's ratio is then 2, at any order of scattering. The
    plate's ratio reaches 2 at m44 = -0.22, the upper end of physical values, and is
    lower elsewhere.
    """
    return (1 + study["m44_target"]) / (1 - study["m22_target"])


def draw_linear(study: Study) -> Figure:
    """Draw the phase along the plate for linear polarization, in all four waters."""
    return _draw_waters(study, ("VV", "VH"))


def draw_circular(study: Study) -> Figure:
    """Draw the phase along the plate for circular polarization, in all four waters."""
    return _draw_waters(study, ("RL", "RR"))


@styled
def _draw_waters(study: Study, pairs: tuple[str, str]) -> Figure:
    """Draw the phase along the plate for two polarizer pairs, in all four waters."""
    figure = new_figure(WIDE, 4.6)
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for axis, step in zip(axes.flat, TURBIDITIES, strict=True):
        _draw_lines(study, axis, step, pairs, subtracted=True)
        axis.label_outer()
    letter(axes.flat, [_water_name(study, step) for step in TURBIDITIES])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=4, columnspacing=1.2
    )
    mark_synthetic(figure)
    return figure


@styled
def draw_crossed(study: Study) -> Figure:
    """Draw phases along the plate for VH and RR, and phase drifts in other set-ups."""
    figure = new_figure(WIDE, 3.6)
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
    _draw_lines(study, left, "d", ("VH", "RR"), subtracted=False)
    left.legend(loc="upper left")
    left.set_ylim(-1.6, 3.4)
    _draw_trade_off(study, right)
    letter((left, right), ("the line", "other milk, other tanks: VV at 7 degrees"))
    mark_synthetic(figure)
    return figure


def _draw_lines(
    study: Study, axis: Axes, step: str, pairs: tuple[str, str], *, subtracted: bool
) -> None:
    """Draw the phase along a line of pixels for two polarizer pairs in one water."""
    pixel = np.arange(1, PIXELS + 1)
    for pair, filled in zip(pairs, (True, False), strict=True):
        result = lines.line(study, step, pair)
        axis.plot(
            pixel,
            result.measured,
            "o" if filled else "s",
            color=_COLOUR[pair],
            markersize=2.4,
            markerfacecolor=_COLOUR[pair] if filled else "white",
            markeredgewidth=0.5,
            label=f"{pair}, {SYNTHETIC}",
            zorder=2,
        )
        axis.plot(
            pixel, result.phase, color="black", linewidth=0.8, zorder=3,
            label=None if filled else "model, without noise",
        )  # fmt: skip
    if subtracted:
        axis.plot(
            pixel,
            lines.corrected(study, step, pairs[0]),
            "--",
            color="#555555",
            linewidth=0.8,
            label=f"{pairs[0]} less open water",
            zorder=3,
        )
    axis.set(xlim=(0, PIXELS + 1), xlabel="pixel", ylabel="phase advance [degree]")
    axis.xaxis.set_major_locator(FixedLocator([1, 20, 40, 60, 80]))
    axis.grid(axis="y")


def _water_name(study: Study, step: str) -> str:
    """Return the panel title for one water."""
    attenuation = study[TURBIDITIES[step]]
    thickness = attenuation * study["short_distance"]
    name = "tap water" if step == "tap" else "with milk"
    return f"{name}, {attenuation:.2f} 1/m (optical thickness {thickness:.2g})"


def _draw_trade_off(study: Study, axis: Axes) -> None:
    """Plot the RR phase drift against the VH drift, for all set-ups and the paper."""
    low, high = _CROSSED_LIMITS
    axis.fill_between(
        [low, high],
        [lines.FLAT, lines.FLAT],
        [low - lines.FLAT, high - lines.FLAT],
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
    labeled: set[str] = set()
    crowd: list[trade_off.Drifts] = []
    for result in study.once(trade_off.drifts):
        group = result.set_up.group
        possible = result.reflectance <= 1
        axis.errorbar(
            result.crossed,
            result.same,
            xerr=result.crossed_error,
            yerr=result.same_error,
            fmt="o",
            ms=4,
            lw=0.7,
            color=colour[group],
            mfc=colour[group] if possible else "white",
            label=None if group in labeled else group,
        )
        labeled.add(group)
        if max(result.crossed, result.same) < _CROWDED:
            crowd.append(result)
            continue
        axis.annotate(
            f"{result.set_up.label}, {result.reflectance:.2g}",
            (result.crossed, result.same),
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
