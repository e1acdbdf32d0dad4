"""Whether the stages can go wherever a scan will send them, before the first move."""

from __future__ import annotations

import numpy as np

from amulor.acquisition.devices import Devices
from amulor.acquisition.settings import Settings
from amulor.optics.polarization import stokes
from amulor.survey import Survey
from amulor.survey.directions import open_water_directions, scan_directions


def refuse_beyond_reach(survey: Survey, settings: Settings, devices: Devices) -> None:
    """Raise if a stage that knows its travel cannot go where the scan needs it.

    Parameters
    ----------
    survey : Survey
        Its directions and polarizations count.
    settings : Settings
        Its angles of the mounts count.
    devices : Devices
        Those with a method `refuse_beyond_reach` are asked.

    Raises
    ------
    InstrumentError
        Of the first one whose travel is too short.
    """
    azimuth, elevation = (angle.ravel() for angle in scan_directions(survey)[:2])
    if survey.scan.open_water is not None:
        shots = open_water_directions(survey)
        azimuth = np.concatenate([azimuth, shots[0]])
        elevation = np.concatenate([elevation, shots[1]])
    ask = getattr(devices.scanner, "refuse_beyond_reach", None)
    if ask is not None:
        ends = (
            [float(angle.min()), float(angle.max())] for angle in (azimuth, elevation)
        )
        ask(*ends)
    pairs = [stokes.pair_states(pair) for pair in survey.instrument.polarizations]
    for place, name in enumerate(("launch", "analyser")):
        angles = getattr(settings, name).angles
        needed = [angles[pair[place]] for pair in pairs if pair[place] in angles]
        ask = getattr(getattr(devices, name), "refuse_beyond_reach", None)
        if ask is not None and needed:
            ask(needed)
    ask = getattr(devices.target, "refuse_beyond_reach", None)
    if ask is not None and survey.scan.open_water is not None:
        ask()
