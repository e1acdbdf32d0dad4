"""What each modulation frequency of a simulated instrument sees, place by place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from amulor.acquisition.simulated.scene import LightByDirection
from amulor.optics.polarization import stokes
from amulor.survey import Survey

#: Directions nearer to each other than this count as one [rad].
_SAME = 1e-5


@dataclass
class Tone:
    """One modulation frequency: the light at it, and the filter behind its mixer."""

    frequency: float
    scan: Places
    open_water: Places
    channel: int
    """Its place in that light [1]."""
    level: complex = 0j
    noise: complex = 0j
    input: complex = 0j


class Places:
    """Light of one arrangement, and the place that is nearest to a direction."""

    def __init__(self, light: LightByDirection) -> None:
        self.light = light
        self._direction = light.azimuth + 1j * light.elevation
        # Places looked up before, by the direction in steps of `_SAME`.
        self._known: dict[tuple[int, int], int] = {}

    def nearest(self, azimuth: float, elevation: float) -> int:
        """Return the number of the place nearest to a direction [rad]."""
        key = (round(azimuth / _SAME), round(elevation / _SAME))
        number = self._known.get(key)
        if number is None:
            away = np.abs(self._direction - complex(azimuth, elevation))
            number = self._known[key] = int(np.argmin(away))
        return number


def mount_angles(
    survey: Survey, launch: Mapping[str, float], analyser: Mapping[str, float]
) -> list[complex]:
    """Return launch + 1j * analyser angle of each pair, far off if not stated [rad]."""
    pairs = []
    for pair in survey.instrument.polarizations:
        launched, analysed = stokes.pair_states(pair)
        pairs.append(complex(launch.get(launched, 1e3), analyser.get(analysed, 1e3)))
    return pairs
