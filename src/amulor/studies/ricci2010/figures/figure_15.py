"""Figure 15 of Ricci et al. 2010: a bent disc with holes, crossed and parallel."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures.panels import (
    WIDE,
    canvas,
    draw_surface,
    letter,
    mark_synthetic,
    masked,
    median,
    relief,
    styled,
)
from amulor.studies.ricci2010.results import Check, holds, within
from amulor.studies.ricci2010.scenes.disc_scans import (
    DiscScan,
    Outline,
    Outlines,
    bent_disc,
    bright,
    outlines,
)
from amulor.studies.ricci2010.study import Study

TITLE = "A bent disc with holes"
CAPTION = (
    "A bent disc with a central hole and four small holes in water with Maalox. One "
    "synthetic scan behind polarizers alone, as in the paper, true to scale. (a) and "
    "(b) crossed, (c) and (d) parallel, each seen from the front and along the disc. "
    "Heights are counted from the rim, after a shift that corrects the effect of the "
    "water; the titles state the shift. Each point is the median of five by five "
    "pixels that are brighter than halfway between disc and water. The titles also "
    "state the scatter of a pixel about it. The scattering of this water is unknown, "
    "so its turbidity is assumed within a wide range. The bend and the circle of the "
    "small holes are assumed as well."
)
#: Heights that are drawn [mm], and the directions from which [degree].
_LIMITS = (-29.0, 44.0)
_SIDES = {"from the front": (58, -62), "along the disc": (16, -90)}
#: Heights of the darkest and the lightest colour [mm].
_SHADES = (-24.0, 32.0)


def checks(study: Study) -> list[Check]:
    """Return what the paper says of the figure, beside what was found."""
    scan = study.once(bent_disc)
    result: list[Check] = []
    for stage, images in (
        ("the polarizers alone", scan.raw),
        ("open water subtracted", scan.subtracted),
    ):
        for channel, image in images.items():
            seen = outlines(image, distance=study["short_distance"])
            result += _outlines(study, scan, f"{channel}, {stage}", seen)
    for stage, images, place in (
        ("the polarizers alone", scan.raw, "section 9, on figure 15"),
        ("open water subtracted", scan.subtracted, ""),
    ):
        crossed, parallel = (scan.contrast(images[name]) for name in ("VH", "VV"))
        difference = crossed.value - parallel.value
        error = math.hypot(crossed.uncertainty, parallel.uncertainty)
        result.append(
            holds(
                f"contrast of disc and surround better in VH, {stage}",
                difference > 2 * error,
                found=f"{crossed.value:.4f} against {parallel.value:.4f}, "
                f"± {error:.2g}",
                wanted="larger by 2 standard errors",
                place=place,
            )
        )
        rms = {name: scan.error(image)[0] * 1e3 for name, image in images.items()}
        result.append(
            holds(
                f"range error (rms) on the disc better in VH, {stage}",
                rms["VH"] < rms["VV"],
                found=f"{rms['VH']:.2g} against {rms['VV']:.2g} mm",
                wanted="smaller",
                place=place,
            )
        )
    return result


def _outlines(
    study: Study, scan: DiscScan, name_of: str, seen: Outlines
) -> list[Check]:
    """Return the checks of three diameters, one pixel either way."""
    small = seen.small_holes[:4]
    mean = None
    if len(small) == 4:
        mean = Outline(
            float(np.mean([hole.diameter for hole in small])),
            math.sqrt(sum(hole.uncertainty**2 for hole in small)) / 4,
        )
    return [
        within(
            f"{name_of}: {name}",
            math.nan if outline is None else outline.diameter * 1e3,
            (true - scan.pitch) * 1e3,
            (true + scan.pitch) * 1e3,
            place="",
            unit="mm",
            uncertainty=None if outline is None else outline.uncertainty * 1e3,
        )
        for name, outline, true in (
            ("diameter of the disc", seen.rim, study["disc_diameter"]),
            ("central hole", seen.central_hole, study["disc_central_hole"]),
            ("small holes, mean of four", mean, study["disc_holes"]),
        )
    ] + [
        holds(
            f"{name_of}: all four small holes are seen, and no other",
            len(seen.small_holes) == 4,
            found=str(len(seen.small_holes)),
            wanted="4",
            place="",
        )
    ]


@styled
def draw(study: Study) -> Figure:
    """Draw the figure."""
    scan = study.once(bent_disc)
    figure, cells = canvas(WIDE, 5.6, rows=2, columns=len(_SIDES))
    rim = study["short_distance"] + _sag(study)
    axes: list[Axes] = []
    titles: list[str] = []
    for channel, image in scan.raw.items():
        moved = scan.moved(image)
        surface, scatter = median(
            masked(relief(image, origin=rim - moved), bright(image))
        )
        for side, (high, around) in _SIDES.items():
            axes.append(
                draw_surface(
                    figure,
                    cells[len(axes)],
                    surface,
                    limits=_LIMITS,
                    shades=_SHADES,
                    elevation=high,
                    azimuth=around,
                    zoom=1.15,
                )
            )
            titles.append(
                f"{channel}, {side}: {moved * 1e3:.0f} mm nearer, a pixel ± "
                f"{scatter:.1f} mm"
            )
    letter(axes, titles)
    mark_synthetic(figure)
    return figure


def _sag(study: Study) -> float:
    """Return how far the middle stands before the rim [m]."""
    bend, half = study["disc_bend"], study["disc_diameter"] / 2
    return bend - math.sqrt(bend**2 - half**2)
