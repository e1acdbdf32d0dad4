"""Figure of the range profile of a pixel: noise level, water and surfaces."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from amulor.imaging.beam_profile import BeamProfile
from amulor.io.files import atomic_output
from amulor.view.style import COLOURS, MISSING_COLOUR, new_figure, style


def write_profile(
    path: Path, beam: BeamProfile, *, title: str, overwrite: bool = False
) -> None:
    """Write the figure of a range profile as PNG or SVG."""
    kind = path.suffix.lower().removeprefix(".")
    with style(), atomic_output(path, overwrite=overwrite) as temporary:
        draw(beam, title=title).savefig(temporary, format=kind, dpi=160)


def draw(beam: BeamProfile, *, title: str) -> Figure:
    """Draw profile and water signal over the slant range, and mark surfaces."""
    with style():
        figure = new_figure(7.2, 3.0)
        axis = figure.add_subplot()
        axis.axhspan(0, beam.noise, color=MISSING_COLOUR, lw=0, label="noise level")
        axis.plot(
            beam.slant_range, beam.profile, label="target signal", color=COLOURS[0]
        )
        if beam.water is not None:
            axis.plot(
                beam.slant_range, beam.water, "--", label="subtracted water signal",
                color=COLOURS[2],
            )  # fmt: skip
        for number, (place, error, height, spread) in enumerate(
            zip(
                beam.surface, beam.surface_uncertainty,
                beam.amplitude, beam.amplitude_uncertainty, strict=True,
            ),
            start=1,
        ):  # fmt: skip
            axis.errorbar(
                place, height, xerr=2 * error, yerr=2 * spread, fmt="v", capsize=2,
                color=COLOURS[1],
                label=f"{number}: {place:.4f} m ± {1e3 * error:.2g} mm",
            )  # fmt: skip
            axis.annotate(
                f"{number}", (place, height), xytext=(0, 6),
                textcoords="offset points", ha="center",
            )  # fmt: skip
        axis.set_xlabel("slant range [m]")
        axis.set_ylabel("amplitude [V]")
        axis.set_title(title)
        axis.set_yscale("log")
        axis.set_ylim(beam.noise / 3, 4 * max(beam.profile.max(), beam.noise))
        axis.margins(x=0)
        axis.grid(True)
        figure.legend(loc="outside right upper")
    return figure
