"""Figure 1 of Ricci et al. 2010: contribution of each depth to the water signal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from amulor.optics import small_angle, small_angle_diffusion
from amulor.studies.ricci2010.figures.panels import WIDE, letter
from amulor.studies.ricci2010.results import Check, statements
from amulor.studies.ricci2010.scenes.water_sweeps import (
    TURBIDITIES,
    Turbidity,
    receiver,
    water,
)
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure, style

Floats = NDArray[np.float64]
#: Number of depths of the integrand.
_DEPTHS = 2501


@dataclass(frozen=True)
class Profile:
    """Contribution of each depth to the water signal at one turbidity."""

    depth: Floats
    """Depths, up to the end of the tank [m]."""
    diffusion: Floats
    """Overlap F(z) by the diffusion model [sr]."""
    small_angle: Floats
    """Overlap F(z) by the small-angle model [sr]."""

    @property
    def peak(self) -> float:
        """Depth of the maximum overlap, by the diffusion model [m]."""
        return float(self.depth[np.argmax(self.diffusion)])

    @property
    def maxima(self) -> int:
        """Number of overlap maxima, by the diffusion model."""
        slope = np.sign(np.diff(self.diffusion))
        return int(np.count_nonzero(np.diff(slope[slope != 0]) < 0))

    def fraction(self, integrand: Floats) -> Floats:
        """Return the cumulative fraction of an overlap's integral at each depth [1]."""
        area: Floats = cumulative_trapezoid(integrand, self.depth, initial=0.0)
        fraction: Floats = area / area[-1]
        return fraction

    def reach(self, integrand: Floats) -> float:
        """Return the depth at which an overlap reaches 90 % of its integral [m]."""
        return float(np.interp(0.9, self.fraction(integrand), self.depth))


def profile(study: Study, turbidity: Turbidity) -> Profile:
    """Return the depth profile of the water signal at a turbidity."""
    return study.once(_PROFILE[turbidity])


def checks(study: Study) -> list[Check]:
    """Compare the depth profiles with the text of the paper."""
    rows = statements(1)
    profiles = {t: profile(study, t) for t in TURBIDITIES}
    both = list(profiles.values())
    start = max(float(p.diffusion[0] / p.diffusion.max()) for p in both)
    result = [
        rows.within("positive", min(float(p.diffusion.min()) for p in both) * 1e6),
        rows.within("instrument", start),
        rows.within("maxima", max(both, key=lambda p: abs(p.maxima - 1)).maxima),
    ]
    for name, p in profiles.items():
        result += [
            rows.within("peak", p.peak, turbidity=name),
            rows.within("diffusion", p.reach(p.diffusion), turbidity=name),
            rows.within("small_angle", p.reach(p.small_angle), turbidity=name),
        ]
    return result


def draw(study: Study) -> Figure:
    """Draw the depth profiles and their cumulative fractions."""
    with style():
        figure = new_figure(WIDE, 2.7)
        overlap, share = figure.subplots(1, 2)
        for turbidity, colour in zip(TURBIDITIES, COLOURS, strict=False):
            p = profile(study, turbidity)
            attenuation = study[f"attenuation_{turbidity}"]
            for integrand, form, dashes in (
                (p.diffusion, "diffusion", "-"),
                (p.small_angle, "small-angle", "--"),
            ):
                label = f"{attenuation:.1f} m⁻¹, {form} form"
                look = {"color": colour, "ls": dashes}
                overlap.plot(p.depth, integrand * 1e6, label=label, **look)
                share.plot(p.depth, 100 * p.fraction(integrand), **look)
                reach = p.reach(integrand)
                share.plot(reach, 90, "o", ms=3.5, color=colour)
        share.axhline(90, color="#999999", lw=0.6, zorder=0)
        overlap.set_ylabel("integrand F(z) [µsr]")
        share.set_ylabel("share from nearer than z [%]")
        overlap.set_ylim(bottom=0)
        share.set_ylim(0, 101)
        overlap.legend(title="attenuation", title_fontsize=7)
        letter(
            (overlap, share),
            ("integrand of the water signal", "share of the signal"),
        )
        for axis in (overlap, share):
            axis.set_xlim(0, 8)
            axis.set_xlabel("depth z [m]")
            axis.grid(True)
    return figure


def _profile(study: Study, *, turbidity: Turbidity) -> Profile:
    medium, place = water(study, turbidity), receiver(study)
    depth = np.linspace(0.0, study["long_length"], _DEPTHS)
    return Profile(
        depth=depth,
        diffusion=small_angle_diffusion.overlap(depth, **medium.realistic, **place),
        small_angle=small_angle.overlap(
            depth,
            absorption=medium.absorption,
            scattering=medium.scattering,
            phase_function=medium.phase_function,
            split_angle=medium.split_angle,
            **place,
        ),
    )


# The study remembers results by function, so each turbidity has its own.
_PROFILE = {t: partial(_profile, turbidity=t) for t in TURBIDITIES}
