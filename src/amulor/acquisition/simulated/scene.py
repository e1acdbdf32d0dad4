"""Signals of the scene in front of a simulated instrument, by direction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from amulor.optics.polarization import stokes
from amulor.survey import Survey


class LightByDirection(Protocol):
    """Noiseless detector signals by beam direction, without dark counts."""

    @property
    def azimuth(self) -> NDArray[np.float64]:
        """Azimuth of each beam direction, to the right, shape (place,) [rad]."""

    @property
    def elevation(self) -> NDArray[np.float64]:
        """Elevation of each beam direction, upwards, shape (place,) [rad]."""

    @property
    def target(self) -> NDArray[np.complex128]:
        """Peak signal of the target, (frequency, polarization, place) [V]."""

    @property
    def water(self) -> NDArray[np.complex128]:
        """Peak signal of the water, (frequency, polarization, place) [V]."""

    @property
    def target_rate(self) -> NDArray[np.float64]:
        """Photoelectron rate of the target, (frequency, polarization, place) [1/s]."""

    @property
    def water_rate(self) -> NDArray[np.float64]:
        """Photoelectron rate of the water, (frequency, polarization, place) [1/s]."""


class Vehicle(Protocol):
    """Simulated vehicle: light of a scan, and measured poses.

    Times count from the start of the scan [s].
    """

    def light(self, time: float, direction: int) -> LightByDirection:
        """Return the light in one direction of the scan, with a single place."""

    def messages(self, begin: float, end: float) -> list[tuple[float, str]]:
        """Return time and text of the poses from one time until before another."""


class SceneLight(Protocol):
    """Detector signals with the target in the beam, and in open water."""

    @property
    def with_target(self) -> LightByDirection:
        """Signals with the target, in the directions of the scan."""

    @property
    def open_water(self) -> LightByDirection:
        """Signals without the target, in the directions of references and scan."""

    @property
    def vehicle(self) -> Callable[[int, float], Vehicle] | None:
        """Vehicle for a seed and the time at which its course starts [s].

        None if the instrument stands still.
        """


#: Function for the light of a survey, such as `amulor.simulation.scene_light`; passed
#: in from outside, since `amulor.acquisition` does not import the simulation.
Scene = Callable[[Survey], SceneLight]


#: Directions nearer to each other than this count as one [rad].
_SAME = 1e-5


@dataclass
class Tone:
    """Signal and filter state of one modulation frequency."""

    frequency: float
    scan: Places
    open_water: Places
    channel: int
    """Index of the frequency in the light [1]."""
    level: complex = 0j
    noise: complex = 0j
    input: complex = 0j


class Places:
    """Signals of a scene by beam direction, with nearest-neighbor search."""

    def __init__(self, light: LightByDirection) -> None:
        self.light = light
        self._direction = light.azimuth + 1j * light.elevation
        # Places looked up before, by the direction in steps of `_SAME`.
        self._cache: dict[tuple[int, int], int] = {}

    def nearest(self, azimuth: float, elevation: float) -> int:
        """Return the index of the scene direction nearest to a beam direction [rad]."""
        key = (round(azimuth / _SAME), round(elevation / _SAME))
        number = self._cache.get(key)
        if number is None:
            away = np.abs(self._direction - complex(azimuth, elevation))
            number = self._cache[key] = int(np.argmin(away))
        return number

    def passed(self, start: complex, end: complex) -> list[tuple[float, int]]:
        """Return path fraction and index of each new nearest direction along a path."""
        towards, path = self._direction - start, end - start
        level = np.abs(towards) ** 2
        slope = -2 * (towards.real * path.real + towards.imag * path.imag)
        least = 1e-12 * max(float(np.abs(slope).max(initial=0.0)), 1e-300)
        part, number = 0.0, int(np.argmin(level))
        crossings: list[tuple[float, int]] = []
        while True:
            fall = slope[number] - slope
            nearer = np.flatnonzero(fall > least)
            if nearer.size == 0:
                return crossings
            when = (level[nearer] - level[number]) / fall[nearer]
            first = float(when.min())
            if first >= 1:
                return crossings
            together = nearer[when <= first + 1e-12]
            part = max(part, first)
            number = int(together[np.argmin(slope[together])])
            crossings.append((part, number))


def mount_angles(
    survey: Survey, launch: Mapping[str, float], analyser: Mapping[str, float]
) -> list[complex]:
    """Return mount angles [rad] of each pair, launch + 1j * analyzer; 1000 if unset."""
    pairs = []
    for pair in survey.instrument.polarizations:
        launched, analysed = stokes.pair_states(pair)
        pairs.append(complex(launch.get(launched, 1e3), analyser.get(analysed, 1e3)))
    return pairs
