"""Scenes acquired sample by sample with the simulated bench and a journal."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from amulor import acquisition
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings import Settings
from amulor.optics import rays
from amulor.simulation import scene_light
from amulor.studies.trust.case import Case, case_of
from amulor.studies.trust.scenes.models import around
from amulor.studies.trust.surveys import plate, survey

_DISTANCE, _LEAN = 2.6, 20.0


class _BrokenOff:
    """Acquisition control that interrupts a scan after a given number of samples."""

    def __init__(self, samples: int) -> None:
        self._remaining = samples

    def pause_wanted(self) -> bool:
        self._remaining -= 1
        return self._remaining == 0

    def go_on(self) -> bool:
        return False


def plate_scanned(count: int, seed: int, *, broken: bool = False) -> Case:
    """Acquire a tilted plate with the simulated bench, optionally interrupted."""
    planned = survey(count, plate(_DISTANCE, lean=_LEAN))
    content = {
        "procedure": {"dark_readings": 2, "position_tolerance": "1 mrad"},
        "simulation": {"position_error": "2e-5 rad", "seed": seed},
    }
    settings = Settings.model_validate(content, context={"from_text": True})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "scan"
        if broken:
            half = planned.scan.rows * planned.scan.columns * count
            acquisition.acquire(
                planned, folder, settings=settings, scene=scene_light,
                control=_BrokenOff(half),
            )  # fmt: skip
        acquisition.acquire(
            planned, folder, settings=settings, scene=scene_light, resume=broken
        )
        with Journal.read(folder) as journal:
            samples = acquisition.build(journal)
    beams = rays.direction(samples["azimuth"].values, samples["elevation"].values)
    lean = np.radians(_LEAN)
    normal = np.array([np.sin(lean), 0.0, np.cos(lean)])
    slant = _DISTANCE * normal[2] / (beams @ normal)
    return case_of(samples, interval=around(_DISTANCE), surfaces=slant[None])
