"""From samples to the signal of the target: one method a file."""

from amulor.rejection.channels.analysers import stokes_vectors, unmix_stokes
from amulor.rejection.channels.ratios import Ratio, target_ratio, water_ratio
from amulor.rejection.combined import combined
from amulor.rejection.compare import Caution, Comparison, Row, auto, compare
from amulor.rejection.frequency import FrequencyChoice, choose_frequency, frequency
from amulor.rejection.joint.estimate import joint
from amulor.rejection.open_water import open_water
from amulor.rejection.polarization import (
    ChannelChoice,
    choose_channel,
    co_polarized,
    cross_polarized,
    keep_water,
    unmix,
)
from amulor.rejection.reference.attach import with_open_water

__all__ = [
    "Caution",
    "ChannelChoice",
    "Comparison",
    "FrequencyChoice",
    "Ratio",
    "Row",
    "auto",
    "choose_channel",
    "choose_frequency",
    "co_polarized",
    "combined",
    "compare",
    "cross_polarized",
    "frequency",
    "joint",
    "keep_water",
    "open_water",
    "stokes_vectors",
    "target_ratio",
    "unmix",
    "unmix_stokes",
    "water_ratio",
    "with_open_water",
]
