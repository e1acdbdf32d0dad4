"""Photon transport by Monte Carlo: multiple scattering, polarization, modulation."""

from amulor.transport._derivatives import PhaseFunctionChange
from amulor.transport.medium import Layer, Medium
from amulor.transport.mesh import MeshTarget
from amulor.transport.monte_carlo import ErrorGoal, Progress, Technique, simulate
from amulor.transport.receiver import (
    DiscReceiver,
    GaussianReceiver,
    PlaneTarget,
    Source,
)
from amulor.transport.scattering import ScatteringMatrix
from amulor.transport.slab import reflection_and_transmission
from amulor.transport.tally import PathRecord, Tally

__all__ = [
    "DiscReceiver",
    "ErrorGoal",
    "GaussianReceiver",
    "Layer",
    "Medium",
    "MeshTarget",
    "PathRecord",
    "PhaseFunctionChange",
    "PlaneTarget",
    "Progress",
    "ScatteringMatrix",
    "Source",
    "Tally",
    "Technique",
    "reflection_and_transmission",
    "simulate",
]
