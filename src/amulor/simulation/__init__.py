"""From a survey to the cube that its instrument would record."""

from amulor.simulation.measurement import simulate
from amulor.simulation.models import (
    ClosureModel,
    DiffusionModel,
    SignalModel,
    SmallAngleModel,
)
from amulor.simulation.photons import PhotonModel
from amulor.simulation.scene_light import SceneLight, scene_light

__all__ = [
    "ClosureModel",
    "DiffusionModel",
    "PhotonModel",
    "SceneLight",
    "SignalModel",
    "SmallAngleModel",
    "scene_light",
    "simulate",
]
