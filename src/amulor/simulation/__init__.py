"""From a survey to the cube that its instrument would record."""

from amulor.simulation.measurement import simulate

__all__ = ["simulate"]
