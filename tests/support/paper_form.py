"""Scans simulated with the form of the paper, for tests of what fits that form."""

from __future__ import annotations

from functools import partial

import pytest

from amulor import simulation
from amulor.simulation import DiffusionModel
from amulor.studies.trust.scenes import knowledge, models, samples

#: As `amulor.simulate`, by the diffusion form (46), which joint estimation fits: what
#: it says of its own model is asked of scans that follow it.
simulate = partial(simulation.simulate, model=DiffusionModel())


def follow_paper_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the scenes of the trust study follow the same form, for a test."""
    for scenes in (knowledge, models, samples):
        monkeypatch.setattr(scenes, "simulate", simulate)
