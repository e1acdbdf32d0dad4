"""Rejection of the water signal: methods that estimate the target signal of samples.

A method takes a cube of level `samples` and returns one of level `target_signal`;
`compare` runs them all, `auto` the best of them. `water_fit` estimates the
optical properties of the water instead, from its open-water shots.
"""

from amulor.rejection.background import background
from amulor.rejection.combined import combined
from amulor.rejection.compare import Caution, Comparison, Row, auto, compare
from amulor.rejection.frequency import FrequencyChoice, choose_frequency, frequency
from amulor.rejection.joint.estimate import joint
from amulor.rejection.joint.water_fit import (
    ScatteringSplit,
    WaterFit,
    split_scattering,
    water_fit,
)
from amulor.rejection.methods import Method, Needs, load, method, names, reject
from amulor.rejection.open_water import open_water
from amulor.rejection.phasor_lines import phasor_lines
from amulor.rejection.polarization import (
    ChannelChoice,
    choose_channel,
    co_polarized,
    cross_polarized,
    keep_water,
    polarization,
)
from amulor.rejection.polarization_difference import polarization_difference
from amulor.rejection.range_profile import range_profile
from amulor.rejection.ratios import Ratio, target_ratio, water_ratio
from amulor.rejection.reference.attach import with_open_water
from amulor.rejection.smooth_surface import smooth_surface
from amulor.rejection.stokes import stokes_vectors, unmix_stokes

#: Name of the method `polarization` in version 0.1.0.
unmix = polarization

__all__ = [
    "Caution",
    "ChannelChoice",
    "Comparison",
    "FrequencyChoice",
    "Method",
    "Needs",
    "Ratio",
    "Row",
    "ScatteringSplit",
    "WaterFit",
    "auto",
    "background",
    "choose_channel",
    "choose_frequency",
    "co_polarized",
    "combined",
    "compare",
    "cross_polarized",
    "frequency",
    "joint",
    "keep_water",
    "load",
    "method",
    "names",
    "open_water",
    "phasor_lines",
    "polarization",
    "polarization_difference",
    "range_profile",
    "reject",
    "smooth_surface",
    "split_scattering",
    "stokes_vectors",
    "target_ratio",
    "unmix_stokes",
    "water_fit",
    "water_ratio",
    "with_open_water",
]


def __dir__() -> list[str]:
    """List the public names, without the modules that define them."""
    return sorted(__all__)
