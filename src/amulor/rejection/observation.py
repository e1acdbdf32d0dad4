"""Access to the samples of a scan, with quantities cached after the first reading."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import tiles
from amulor.cube.error import may_contain
from amulor.cube.readings import lag_of, range_bend, range_motion, reading_weight
from amulor.rejection.covariance import Covariance
from amulor.survey import Survey

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Motions between readings: by the range rate, and by its change.
_MOTIONS = (range_motion, range_bend)


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Samples of some rows of a scan, or of its open-water shots."""

    cube: xr.Dataset
    """Cube of the rows, also the template of the result."""

    @cached_property
    def frequency(self) -> Floats:
        """Modulation frequencies [Hz]."""
        return np.asarray(self.cube["modulation_frequency"].values)

    @cached_property
    def polarizations(self) -> list[str]:
        """Names of the channels."""
        return [str(name) for name in self.cube["polarization"].values]

    @cached_property
    def signal(self) -> Complex:
        """Samples, in the dimensions of the cube [V]."""
        return np.asarray(self.cube.amulor.signal.values)

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance of the stated errors of the samples [V^2]."""
        cross = self.cube.get("in_phase_quadrature_covariance")
        in_phase = self.cube["in_phase_uncertainty"].values ** 2
        return Covariance(
            in_phase,
            self.cube["quadrature_uncertainty"].values ** 2,
            np.zeros_like(in_phase) if cross is None else cross.values,
        )

    @cached_property
    def common_covariance(self) -> Covariance | None:
        """Covariance of errors common to pixels or references; None if not stated."""
        if "common_covariance" not in self.cube:
            return None
        return Covariance(
            self.cube["common_in_phase_uncertainty"].values ** 2,
            self.cube["common_quadrature_uncertainty"].values ** 2,
            self.cube["common_covariance"].values,
        )

    @cached_property
    def saturated(self) -> NDArray[np.bool_] | None:
        """Mask of overloaded samples; None if not recorded."""
        if "saturated" not in self.cube:
            return None
        return np.asarray(self.cube["saturated"].values != 0)

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """Mask of samples with finite values and errors, without overload."""
        total = self.cube["in_phase"].values + self.cube["quadrature"].values
        for errors in vars(self.covariance).values():
            total += errors
        usable: NDArray[np.bool_] = np.isfinite(total)
        if self.saturated is not None:
            usable &= ~self.saturated
        return usable

    @cached_property
    def directions(self) -> tuple[Floats | None, Floats | None]:
        """Azimuth and elevation of pixels or references [rad]; None if not recorded."""
        azimuth, elevation = (
            self.cube[name].values.astype(float) if name in self.cube else None
            for name in ("azimuth", "elevation")
        )
        return azimuth, elevation

    @property
    def azimuth(self) -> Floats:
        """Azimuth of the pixels, (row, column) [rad]."""
        azimuth = self.directions[0]
        assert azimuth is not None
        return azimuth

    @property
    def elevation(self) -> Floats:
        """Elevation of the pixels, (row, column) [rad]."""
        elevation = self.directions[1]
        assert elevation is not None
        return elevation

    @cached_property
    def time(self) -> Floats | None:
        """Time of each pixel [s]; None if any is missing."""
        if "time" not in self.cube:
            return None
        time = self.cube["time"].values.astype(float)
        return time if np.isfinite(time).all() else None

    @property
    def reads_in_turn(self) -> bool:
        """Whether a vehicle moves between the readings of a pixel."""
        return lag_of(self.cube, self.survey) is not None

    @cached_property
    def motion(self) -> Floats | None:
        """Standard deviations of the optical paths of readings in turn [m].

        By the range rate, with a sign, and by its change, along the first axis, then in
        the dimensions of the samples; None for readings at once.
        """
        if "reading_time" not in self.cube.coords:
            return None
        lag = lag_of(self.cube, self.survey)
        if lag is None or self.survey is None:
            return None
        weight = reading_weight(self.frequency, len(self.polarizations))
        readings = lag.swapaxes(0, 1).reshape(-1, *lag.shape[2:])
        change = [part(readings, self.survey, weight) for part in _MOTIONS]
        group_index = float(self.cube["geometry"].attrs["group_index"])
        shape = 2, len(self.polarizations), len(self.frequency), *lag.shape[2:]
        return 2 * group_index * np.reshape(change, shape).swapaxes(1, 2)

    @cached_property
    def origin_z(self) -> Floats | None:
        """Forward position of a moving emitter [m]; None for an emitter at rest."""
        if "origin_z" not in self.cube.coords:
            return None
        return np.asarray(self.cube["origin_z"].values)

    @cached_property
    def survey(self) -> Survey | None:
        """Survey of the scan; None without one."""
        survey: Survey | None = self.cube.amulor.survey
        return survey

    @cached_property
    def shots(self) -> Observation | None:
        """Open-water shots; None without any."""
        shots = self.cube.amulor.open_water
        return None if shots is None else Observation(cube=shots)

    @property
    def has_late_light(self) -> bool:
        """Whether samples may contain late echoes; False if simulated without."""
        return may_contain(self.cube, "late_echo")

    def flat(self) -> FlatSamples:
        """Return the samples over (pixel or reference, channel, frequency)."""
        return FlatSamples(
            signal=_flat(self.signal),
            covariance=Covariance(*map(_flat, vars(self.covariance).values())),
            usable=_flat(self.usable),
            motion=None
            if self.motion is None
            else np.stack([_flat(part) for part in self.motion], axis=-1),
        )


def _flat(values: NDArray[Any]) -> NDArray[Any]:
    """Return values over (pixel, channel, frequency)."""
    wide = values.reshape(*values.shape[:2], -1)
    return np.ascontiguousarray(wide.transpose(2, 1, 0))


@dataclass(frozen=True, kw_only=True)
class FlatSamples:
    """Samples with their errors, arrays over (pixel, channel, frequency)."""

    signal: Complex
    """Samples [V]."""
    covariance: Covariance
    """Covariance of the stated errors [V^2]."""
    usable: NDArray[np.bool_]
    """Usable samples."""
    motion: Floats | None = None
    """Standard deviations of the optical paths by the range rate, with a sign, and by
    its change, along a last axis; None for readings at once [m]."""

    def part(self, index: NDArray[np.intp]) -> FlatSamples:
        """Return the samples of the pixels at an index."""
        return FlatSamples(
            signal=self.signal[index],
            covariance=self.covariance.part(index),
            usable=self.usable[index],
            motion=None if self.motion is None else self.motion[index],
        )


@dataclass(frozen=True, kw_only=True)
class ScanObservation:
    """A whole scan: its metadata, and its samples tile by tile."""

    source: tiles.Source
    """Rows of the cube."""

    @cached_property
    def head(self) -> Observation:
        """Metadata of the scan: frequencies, survey and open-water shots."""
        return Observation(cube=self.source.head)

    @cached_property
    def bands(self) -> list[tuple[int, int]]:
        """First row and end row of each tile."""
        return list(tiles.bands(self.source))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.source.rows

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self.source.columns

    def tile(self, begin: int, end: int) -> Observation:
        """Return the samples of the rows from `begin` to `end`."""
        return Observation(cube=self.source.tile(begin, end))


def observe_scan(cube: xr.Dataset) -> ScanObservation:
    """Return the observation of a scan in memory."""
    return ScanObservation(source=tiles.InMemory(cube))
