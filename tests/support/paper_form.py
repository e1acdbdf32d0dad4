"""Scans simulated with the form of the paper: another model that has to hold."""

from __future__ import annotations

from functools import partial

import pytest

from amulor import simulation
from amulor.simulation import DiffusionModel
from amulor.studies.trust.scenes import knowledge, models, samples

#: As `amulor.simulate`, by the diffusion form (46): another model than the one that
#: rejection takes by default.
simulate = partial(simulation.simulate, model=DiffusionModel())


def follow_paper_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the scenes of the trust study follow the same form, for a test."""
    for scenes in (knowledge, models, samples):
        monkeypatch.setattr(scenes, "simulate", simulate)
