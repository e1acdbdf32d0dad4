"""From a survey to the cube that its instrument would record."""

from amulor.simulation.measurement import simulate
from amulor.simulation.models import DiffusionModel, SignalModel, SmallAngleModel

__all__ = ["DiffusionModel", "SignalModel", "SmallAngleModel", "simulate"]
