"""What a simulated instrument looks at: light that somebody else has worked out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from amulor.survey import Survey


class LightByDirection(Protocol):
    """Noiseless light in known directions, without the detector's dark counts."""

    @property
    def azimuth(self) -> NDArray[np.float64]:
        """Direction of each place to the right, shape (place,) [rad]."""

    @property
    def elevation(self) -> NDArray[np.float64]:
        """Direction of each place upwards, shape (place,) [rad]."""

    @property
    def target(self) -> NDArray[np.complex128]:
        """Peak signal of the target, (frequency, polarization, place) [V]."""

    @property
    def water(self) -> NDArray[np.complex128]:
        """Peak signal of the water, of the same shape [V]."""

    @property
    def target_rate(self) -> NDArray[np.float64]:
        """Photoelectrons by the target's light, of the same shape [1/s]."""

    @property
    def water_rate(self) -> NDArray[np.float64]:
        """Photoelectrons by the water's light, of the same shape [1/s]."""


class SceneLight(Protocol):
    """What an instrument sees with the target in the beam, and without."""

    @property
    def with_target(self) -> LightByDirection:
        """In the directions of the scan."""

    @property
    def open_water(self) -> LightByDirection:
        """In the directions of the open-water shots and of the scan."""


#: Works out the light of a survey; `amulor.simulation.scene_light` is one. Simulated
#: devices are given it from outside: nothing of `amulor.acquisition` knows how light
#: is simulated.
Scene = Callable[[Survey], SceneLight]
