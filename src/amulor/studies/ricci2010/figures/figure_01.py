"""Figure 1 of Ricci et al. 2010: from what depth the water signal comes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from amulor.optics import small_angle, small_angle_diffusion
from amulor.studies.ricci2010.figures.panels import WIDE, letter
from amulor.studies.ricci2010.results import Check, within
from amulor.studies.ricci2010.scenes.water_sweeps import (
    TURBIDITIES,
    Turbidity,
    receiver,
    water,
)
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure, style

TITLE = "Where the water signal comes from"
CAPTION = (
    "The water of the long tank at both turbidities, without modulation. (a) Light "
    "that a layer of water at a depth returns. Solid: the integrand F of the "
    "diffusion form (46). Dashed: the small-angle form, which includes unscattered "
    "light. At short distances the beam is outside of the field of view; farther out, "
    "losses and distance reduce the light. (b) Fraction of the water signal that "
    "comes from depths up to the one on the axis; dots mark 90 %. Attenuation, "
    "absorption, second moment of the scattering and acceptance are deduced or "
    "assumed. Nothing here is measured."
)

Floats = NDArray[np.float64]
#: Depths at which the integrand is taken.
_DEPTHS = 2501
#: Where the paper says that only the first few metres count.
_FEW_METRES = "section 3, end, on figure 1"


@dataclass(frozen=True)
class Profile:
    """Integrand of the water signal at one turbidity."""

    depth: Floats
    """Depths, to the end of the tank [m]."""
    diffusion: Floats
    """F(z) of the diffusion form [sr]."""
    small_angle: Floats
    """F(z) of the small-angle form [sr]."""

    @property
    def peak(self) -> float:
        """Depth of the largest value of the diffusion form [m]."""
        return float(self.depth[np.argmax(self.diffusion)])

    @property
    def maxima(self) -> int:
        """Number of maxima of the diffusion form."""
        slope = np.sign(np.diff(self.diffusion))
        return int(np.count_nonzero(np.diff(slope[slope != 0]) < 0))

    def fraction(self, integrand: Floats) -> Floats:
        """Return how much of an integrand lies nearer than each depth."""
        area: Floats = cumulative_trapezoid(integrand, self.depth, initial=0.0)
        fraction: Floats = area / area[-1]
        return fraction

    def reach(self, integrand: Floats) -> float:
        """Return within what depth nine tenths of an integrand lie."""
        return float(np.interp(0.9, self.fraction(integrand), self.depth))


def profile(study: Study, turbidity: Turbidity) -> Profile:
    """Return the integrand of the water signal."""
    return study.once(_PROFILE[turbidity])


def checks(study: Study) -> list[Check]:
    """Compare with what the text says of the figure."""
    profiles = {t: profile(study, t) for t in TURBIDITIES}
    both = list(profiles.values())
    result = [
        within(
            "the integrand is nowhere negative",
            min(float(p.diffusion.min()) for p in both) * 1e6,
            0.0,
            np.inf,
            place="",
            unit="µsr",
        ),
        within(
            "nothing is seen right at the instrument: integrand at 0 m over its peak",
            max(float(p.diffusion[0] / p.diffusion.max()) for p in both),
            0.0,
            1e-6,
            place="",
        ),
        within(
            "the integrand has one maximum, at both turbidities",
            max(both, key=lambda p: abs(p.maxima - 1)).maxima,
            1,
            1,
            place="",
        ),
    ]
    for turbidity, p in profiles.items():
        result.append(
            # The acceptance was chosen so that the overlap begins there.
            within(
                f"the maximum lies in the first metres, {turbidity} turbidity",
                p.peak,
                0.5,
                3.0,
                place=_FEW_METRES,
                unit="m",
                role="set",
            )
        )
        # The paper speaks of (46).
        for name, integrand, place in (
            ("diffusion", p.diffusion, _FEW_METRES),
            ("small-angle", p.small_angle, ""),
        ):
            result.append(
                within(
                    f"90 % of the water signal comes from a few metres, {turbidity} "
                    f"turbidity, {name} form",
                    p.reach(integrand),
                    0.0,
                    5.0,
                    place=place,
                    unit="m",
                )
            )
    return result


def draw(study: Study) -> Figure:
    """Draw integrand and share."""
    with style():
        figure = new_figure(WIDE, 2.7)
        left, right = figure.subplots(1, 2)
        for turbidity, colour in zip(TURBIDITIES, COLOURS, strict=False):
            p = profile(study, turbidity)
            attenuation = study[f"attenuation_{turbidity}"]
            for integrand, form, dashes in (
                (p.diffusion, "diffusion", "-"),
                (p.small_angle, "small-angle", "--"),
            ):
                label = f"{attenuation:.1f} m⁻¹, {form} form"
                look = {"color": colour, "ls": dashes}
                left.plot(p.depth, integrand * 1e6, label=label, **look)
                right.plot(p.depth, 100 * p.fraction(integrand), **look)
                reach = p.reach(integrand)
                right.plot(reach, 90, "o", ms=3.5, color=colour)
        right.axhline(90, color="#999999", lw=0.6, zorder=0)
        left.set_ylabel("integrand F(z) [µsr]")
        right.set_ylabel("share from nearer than z [%]")
        left.set_ylim(bottom=0)
        right.set_ylim(0, 101)
        left.legend(title="attenuation", title_fontsize=7)
        letter((left, right), ("integrand of the water signal", "share of the signal"))
        for axis in (left, right):
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
