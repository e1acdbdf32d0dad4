"""Figure 10 of Ricci et al. 2010: lines over a flat plate, linear polarization."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures import panels
from amulor.studies.ricci2010.figures.panels import WIDE, letter, mark_synthetic
from amulor.studies.ricci2010.results import Check, holds, within
from amulor.studies.ricci2010.scenes import short_lines
from amulor.studies.ricci2010.scenes import short_lines as lines
from amulor.studies.ricci2010.study import Study
from amulor.view.style import new_figure, style

TITLE = "Phase along a line, linear polarization, four turbidities"
CAPTION = (
    "Advance of the phase along 80 pixels, 10 cm, of a flat painted plate in the "
    "short tank. The zero is the first pixel, where the receiver sees least water; at "
    "pixel 80 it sees the whole length of the beam. Light of the water returns early, "
    "so it shifts the phase upwards. Parallel (VV, filled) and crossed (VH, open) "
    "analyzer in (a) tap water and (b) to (d) with more and more milk. Marks are "
    "synthetic measurements: polarized Monte Carlo in Mie spheres of milk, with the "
    "phase error of the apparatus added. Each line is set to zero at its first pixel, "
    "so the error there shifts all its marks. Black: without noise. Dashed: VV after "
    "subtraction of open water. The rest comes from water behind the plate, which "
    "only the open-water signal contains. Reflectance and normal of the plate, "
    "particle size and the turbidities of (b) and (d) were chosen together. They make "
    "the effect of tap water small and the drift of VV as in the paper; all other "
    "results follow."
)

#: Where the paper speaks of each panel.
_AT = {
    step: f"section 9, on figure 10({panel})"
    for step, panel in zip(lines.TURBIDITIES, "abcd", strict=True)
}
#: Drifts of (d) that the text states [degrees].
_CROSSED, _PARALLEL = 3.0, 7.0


def checks(study: Study) -> list[Check]:
    """Return what the text says of figure 10."""
    drift = {step: lines.line(study, step, "VV").drift for step in lines.TURBIDITIES}
    crossed_share = lines.rejected_share(study, "d", ("VH", "VV"))
    crossed = short_lines.drifts(
        study,
        "(d) VH drifts by about 3 degrees",
        "d",
        "VH",
        low=2.5,
        high=3.5,
        place=_AT["d"],
    )
    return [
        short_lines.stays_flat(
            study, "(a) VV does not drift in tap water", "tap", "VV",
            place=_AT["tap"], role="set",
        ),
        short_lines.stays_flat(
            study, "(a) VH does not drift in tap water", "tap", "VH",
            place=_AT["tap"], role="set",
        ),
        short_lines.drifts(
            study, "(b) VV drifts by 1.3 degrees", "b", "VV",
            low=1.0, high=1.6, place=_AT["b"], role="set",
        ),
        short_lines.stays_flat(study, "(b) VH does not drift", "b", "VH", place=_AT["b"]
        ),
        within(
            "(c) VV drifts by more than in (b) and less than in (d)",
            drift["c"], drift["b"], drift["d"],
            place=_AT["c"], unit="deg",
            uncertainty=lines.line(study, "c", "VV").error,
        ),
        short_lines.stays_flat(study, "(c) VH does not drift", "c", "VH", place=_AT["c"]
        ),
        short_lines.drifts(
            study, "(d) VV drifts by about 7 degrees", "d", "VV",
            low=6.0, high=8.0, place=_AT["d"], role="set",
        ),
        replace(
            crossed,
            found=f"{crossed.found}; crossed is "
            f"{100 * crossed_share:.2g} % of the water's light, and "
            f"{100 * needed_crossed_share(study):.2g} % would be needed",
        ),
        _overlap(study),
        *(
            short_lines.is_straight(study, step, "VV", place=place)
            # The text says it of (b), and of (c) by analogy.
            for step, place in (("b", _AT["b"]), ("c", _AT["c"]), ("d", ""))
        ),
        holds(
            "optical thickness below 1 in (c) and above 1 in (d)",
            study["attenuation_c"] * study["short_distance"]
            < 1
            < study["attenuation_d"] * study["short_distance"],
            found=", ".join(
                f"{study[lines.TURBIDITIES[step]] * study['short_distance']:.2f}"
                for step in ("c", "d")
            ),
            wanted="below and above 1",
            place="section 9, on figures 10(c) and 10(d)",
            role="set",
        ),
    ]  # fmt: skip


def _overlap(study: Study) -> Check:
    """Return the check that the water counts least at pixel 1 and most at pixel 80."""
    ratios = [lines.water_over_plate(study, step, "VV") for step in ("b", "c", "d")]
    ends = [(int(np.argmin(r)) + 1, int(np.argmax(r)) + 1) for r in ratios]
    return holds(
        "the receiver sees least water at pixel 1 and most at pixel 80, in VV of (b) "
        "to (d)",
        all(end == (1, ratios[0].size) for end in ends),
        found="; ".join(
            f"{100 * r.min():.1f} % of the plate's light at {low}, {100 * r.max():.1f} "
            f"% at {high}"
            for r, (low, high) in zip(ratios, ends, strict=True)
        ),
        wanted="at pixels 1 and 80",
        place="section 9, on the first series",
        # The direction of the scan was drawn by it.
        role="set",
    )


def needed_crossed_share(study: Study) -> float:
    """Return the crossed share of the water's light that both drifts of (d) need."""
    m22 = study["m22_target"]
    ratio = _CROSSED / _PARALLEL * (1 - m22) / (1 + m22)
    return ratio / (1 + ratio)


def draw(study: Study) -> Figure:
    """Return figure 10."""
    with style():
        figure = new_figure(WIDE, 4.6)
        axes = figure.subplots(2, 2, sharex=True, sharey=True)
        for axis, step in zip(axes.flat, lines.TURBIDITIES, strict=True):
            panels.panel(study, axis, step, ("VV", "VH"), subtracted=True)
            axis.label_outer()
        letter(
            axes.flat,
            [panels.water_name(study, step) for step in lines.TURBIDITIES],
        )
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside upper center", ncols=4, columnspacing=1.2
        )
        mark_synthetic(figure)
    return figure
