"""Conversion of two-way optical paths to slant ranges, for many beams at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from amulor.optics import rays

Floats = NDArray[np.float64]

#: Step of the optical path for the derivative of the slant range [m].
_DIFFERENCE = 1e-5


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Laser beams, receiver positions, and refractive indices of water and window."""

    azimuth: Floats
    """Azimuth of each beam at the emitter, before it enters the water [rad]."""
    elevation: Floats
    """Elevation of each beam at the emitter, before it enters the water [rad]."""
    emitter: Floats
    """Start points of the beams, last axis (3,) [m]."""
    receiver: Floats
    """Positions of the receivers, last axis (3,) [m]."""
    medium: rays.Medium
    """Refractive indices of water and window, and position of the window."""

    @cached_property
    def beam(self) -> rays.Beam:
        """Laser beams refracted into the water."""
        return rays.enter_water(
            self.emitter,
            rays.direction(self.azimuth, self.elevation),
            medium=self.medium,
        )

    def depth(self, slant_range: Floats) -> Floats:
        """Length of each slant range within the water [m]."""
        return slant_range - self.beam.length_before

    def position(self, slant_range: Floats) -> Floats:
        """Points on beams at slant ranges, in instrument axes, shape (..., 3) [m]."""
        water = self.depth(slant_range)[..., None]
        return np.asarray(self.beam.entry + water * self.beam.direction)

    def path_limits(
        self, interval: tuple[float, float] | None, frequency: Floats
    ) -> tuple[Floats, Floats]:
        """Shortest and longest two-way optical path for given range limits [m]."""
        return rays.path_limits(
            interval,
            self.beam,
            self.receiver,
            medium=self.medium,
            modulation_frequency=frequency,
        )

    def optical_path(self, slant_range: Floats) -> Floats:
        """Two-way optical paths for given slant ranges [m]."""
        return rays.optical_path(
            slant_range, self.beam, self.receiver, medium=self.medium
        )

    def slant_range(self, path: Floats) -> Floats:
        """Slant ranges for optical paths, NaN for impossible paths [m]."""
        return rays.slant_range_of_path(
            path, self.beam, self.receiver, medium=self.medium
        )

    def slant_range_and_slope(self, path: Floats) -> tuple[Floats, Floats]:
        """Slant ranges for optical paths [m], and their derivatives by path [1]."""
        slant_range = self.slant_range(path)
        farther = self.slant_range(path + _DIFFERENCE)
        return slant_range, (farther - slant_range) / _DIFFERENCE

    def error_by_index(self, path: Floats, uncertainty: float) -> Floats:
        """Range error caused by the uncertainty of the water's group index [m]."""
        step = max(uncertainty, 1e-6)
        ends = [
            rays.slant_range_of_path(
                path,
                self.beam,
                self.receiver,
                medium=replace(
                    self.medium, group_index=self.medium.group_index + side * step
                ),
            )
            for side in (1, -1)
        ]
        return np.abs(ends[0] - ends[1]) / (2 * step) * uncertainty

    def error_by_place(
        self, path: Floats, place: float, turn: float, *, axes: int = 3
    ) -> Floats:
        """Range error due to errors of receiver position and beam direction [m]."""
        total = np.zeros(path.shape)
        if place > 0:
            for axis in np.eye(3)[:axes]:
                ends = [
                    rays.slant_range_of_path(
                        path,
                        self.beam,
                        self.receiver + side * place * axis,
                        medium=self.medium,
                    )
                    for side in (1, -1)
                ]
                total = total + ((ends[0] - ends[1]) / 2) ** 2
        if turn > 0:
            for name in ("azimuth", "elevation"):
                angle = getattr(self, name)
                ends = [
                    replace(self, **{name: angle + side * turn}).slant_range(path)
                    for side in (1, -1)
                ]
                total = total + ((ends[0] - ends[1]) / 2) ** 2
        return np.sqrt(total)
