"""Scans simulated with the form of the paper, for tests of what fits that form."""

from __future__ import annotations

from functools import partial

from amulor import simulation
from amulor.simulation import DiffusionModel

#: As `amulor.simulate`, by the diffusion form (46), which joint estimation fits: what
#: it says of its own model is asked of scans that follow it.
simulate = partial(simulation.simulate, model=DiffusionModel())
