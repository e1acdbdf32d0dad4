"""Acquisition of a measurement cube with an instrument, real or simulated."""

from amulor.acquisition.cube.build import build, recover
from amulor.acquisition.cube.calibrate import (
    from_plates,
    from_reference,
    from_shutter,
    from_temperatures,
)
from amulor.acquisition.cube.calibration import Calibration, calibrated
from amulor.acquisition.cube.demodulator import from_terminated
from amulor.acquisition.cube.polarizer import from_polarizer
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.run import Control, Outcome, Progress, acquire
from amulor.acquisition.settings import Settings

__all__ = [
    "Calibration",
    "Control",
    "Journal",
    "Outcome",
    "Progress",
    "Settings",
    "acquire",
    "build",
    "calibrated",
    "from_plates",
    "from_polarizer",
    "from_reference",
    "from_shutter",
    "from_temperatures",
    "from_terminated",
    "recover",
]
