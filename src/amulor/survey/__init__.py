"""Survey files in TOML: water, targets, instrument and scan, strictly validated."""

from amulor.survey.calibration import Calibration
from amulor.survey.instrument import (
    Daylight,
    Detector,
    Emitter,
    Instrument,
    LockIn,
    Receiver,
    Window,
)
from amulor.survey.instrument_errors import InstrumentErrors
from amulor.survey.platform import (
    Disturbance,
    HoverCourse,
    LawnMowerCourse,
    LineCourse,
    Mounting,
    Navigation,
    OrbitCourse,
    Platform,
)
from amulor.survey.properties import WaterProperties, water_properties
from amulor.survey.scan import OpenWater, Pose, Scan, StandingReference, read_pose
from amulor.survey.surface import Glossy, Lambertian, OrenNayar, TabulatedSurface
from amulor.survey.survey import Survey, json_schema
from amulor.survey.target import Disc, Mesh, Plate, Staircase
from amulor.survey.water import Water
from amulor.survey.waters.named import (
    Case1Water,
    JerlovWater,
    LayeredWater,
    MilkWater,
    PetzoldWater,
    PureWater,
    SphereWater,
    WaterLayer,
)
from amulor.survey.waters.phase_function import (
    FournierForand,
    HenyeyGreenstein,
    Petzold,
    Rayleigh,
    Tabulated,
    TwoTerm,
)

__all__ = [
    "Calibration",
    "Case1Water",
    "Daylight",
    "Detector",
    "Disc",
    "Disturbance",
    "Emitter",
    "FournierForand",
    "Glossy",
    "HenyeyGreenstein",
    "HoverCourse",
    "Instrument",
    "InstrumentErrors",
    "JerlovWater",
    "Lambertian",
    "LawnMowerCourse",
    "LayeredWater",
    "LineCourse",
    "LockIn",
    "Mesh",
    "MilkWater",
    "Mounting",
    "Navigation",
    "OpenWater",
    "OrbitCourse",
    "OrenNayar",
    "Petzold",
    "PetzoldWater",
    "Plate",
    "Platform",
    "Pose",
    "PureWater",
    "Rayleigh",
    "Receiver",
    "Scan",
    "SphereWater",
    "Staircase",
    "StandingReference",
    "Survey",
    "Tabulated",
    "TabulatedSurface",
    "TwoTerm",
    "Water",
    "WaterLayer",
    "WaterProperties",
    "Window",
    "json_schema",
    "read_pose",
    "water_properties",
]
