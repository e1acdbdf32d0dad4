"""What is described before anything is measured: one TOML file, strictly checked."""

from amulor.survey.calibration import Calibration
from amulor.survey.instrument import (
    Detector,
    Emitter,
    Instrument,
    LockIn,
    Receiver,
    Window,
)
from amulor.survey.properties import WaterProperties, water_properties
from amulor.survey.scan import OpenWater, Scan
from amulor.survey.survey import Survey, json_schema
from amulor.survey.target import Disc, Mesh, Plate, Staircase
from amulor.survey.water import Water

__all__ = [
    "Calibration",
    "Detector",
    "Disc",
    "Emitter",
    "Instrument",
    "LockIn",
    "Mesh",
    "OpenWater",
    "Plate",
    "Receiver",
    "Scan",
    "Staircase",
    "Survey",
    "Water",
    "WaterProperties",
    "Window",
    "json_schema",
    "water_properties",
]
