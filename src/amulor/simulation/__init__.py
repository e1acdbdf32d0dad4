"""Simulation of a survey: the measurement cube that its instrument would record."""

from typing import TYPE_CHECKING

from amulor import _lazy
from amulor.simulation.measurement import simulate
from amulor.simulation.models import (
    ClosureModel,
    DiffusionModel,
    SignalModel,
    SmallAngleModel,
)
from amulor.simulation.scene_light import (
    Expectation,
    SceneLight,
    expectation,
    scene_light,
)
from amulor.simulation.vehicle import measured_trajectory

if TYPE_CHECKING:
    from amulor.simulation.photons import PhotonModel

__all__ = [
    "ClosureModel",
    "DiffusionModel",
    "Expectation",
    "PhotonModel",
    "SceneLight",
    "SignalModel",
    "SmallAngleModel",
    "expectation",
    "measured_trajectory",
    "scene_light",
    "simulate",
]

if not TYPE_CHECKING:
    # Photon transport is loaded by those who follow photons.
    __getattr__, __dir__ = _lazy.attach(
        __name__, __all__, origin={"PhotonModel": "amulor.simulation.photons"}
    )
