"""Simulation of a scan row by row, with noise identical to a full simulation.

A random generator fills plane after plane of (row, column). Its state is copied at the
start of each plane; the rows of a plane continue from this copy.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor._progress import listening
from amulor.cube import tiles
from amulor.errors import SurveyError
from amulor.simulation import lock_in, measurement
from amulor.simulation.models import DEFAULT_MODEL, SignalModel, UncertainModel
from amulor.survey import Survey
from amulor.survey.directions import scan_directions

__all__ = ["RowNoise", "SimulatedRows"]


Floats = NDArray[np.float64]
#: Numbers of a block that is drawn and discarded.
_AT_ONCE = 2**20


@dataclass(kw_only=True)
class _Plane:
    """Random generator of one (row, column) array: start, current state, draw count."""

    start: np.random.Generator
    now: np.random.Generator
    drawn: int


class RowNoise:
    """Random generator for a range of rows, with the numbers of the full scan."""

    def __init__(
        self,
        rng: np.random.Generator,
        draws: Sequence[tuple[str, int]],
        *,
        shape: tuple[int, int],
        gamma: float | None = None,
    ) -> None:
        self._draws, self._shape = list(draws), shape
        self._gamma = 1.0 if gamma is None else gamma
        self._planes: list[list[_Plane]] = []
        self._rows, self._next = slice(0, 0), 0
        for method, count in self._draws:
            planes = []
            for _ in range(count):
                begin = copy.deepcopy(rng)
                planes.append(_Plane(start=begin, now=copy.deepcopy(begin), drawn=0))
                self._skip(rng, method, shape[0] * shape[1])
            self._planes.append(planes)

    def rows(self, begin: int, end: int) -> RowNoise:
        """Return this generator, set to a range of rows."""
        self._rows, self._next = slice(begin, end), 0
        return self

    def standard_normal(self, size: tuple[int, ...], /) -> Floats:
        """Return standard normal deviates; see `amulor.simulation.lock_in.Noise`."""
        return self._numbers("standard_normal", size)

    def gamma(self, shape: float, scale: float, /, size: tuple[int, ...]) -> Floats:
        """Return gamma deviates; see `amulor.simulation.lock_in.Noise`."""
        if shape != self._gamma:
            raise RuntimeError(f"gamma({shape:g}) is asked for, not {self._gamma:g}")
        return self._numbers("gamma", size, scale)

    def _numbers(
        self, method: str, size: tuple[int, ...], scale: float = 1.0
    ) -> Floats:
        number, self._next = self._next, self._next + 1
        planes = self._planes[number] if number < len(self._planes) else []
        height = self._rows.stop - self._rows.start
        shape = (height, self._shape[1])
        if not planes or self._draws[number][0] != method or size[-2:] != shape:
            raise RuntimeError(
                f"draw {number + 1} of a scan is {method} of shape {size}, which is "
                f"none of {self._draws}: let lock_in.draws say what is drawn"
            )
        out: Floats = np.empty(size)
        flat = out.reshape(-1, height * self._shape[1])
        first = self._rows.start * self._shape[1]
        for plane, values in zip(planes, flat, strict=True):
            if plane.drawn > first:
                plane.now, plane.drawn = copy.deepcopy(plane.start), 0
            self._skip(plane.now, method, first - plane.drawn)
            values[:] = (
                plane.now.standard_normal(values.size)
                if method == "standard_normal"
                else plane.now.gamma(self._gamma, scale, size=values.size)
            )
            plane.drawn = first + values.size
        return out

    def _skip(self, rng: np.random.Generator, method: str, count: int) -> None:
        """Advance a generator by drawing and discarding numbers."""
        unwanted: Floats = np.empty(min(count, _AT_ONCE))
        for first in range(0, count, _AT_ONCE):
            part = unwanted[: min(count - first, _AT_ONCE)]
            if method == "standard_normal":
                rng.standard_normal(out=part)
            else:
                rng.standard_gamma(self._gamma, out=part)


class SimulatedRows:
    """Cube of a scan, simulated on demand in tiles of rows.

    The tiles equal those of `amulor.simulate`, bit for bit. The noise has the same
    random numbers, and the table of the light of the water is fitted once.
    """

    def __init__(
        self,
        survey: Survey,
        *,
        rng: np.random.Generator | int,
        model: SignalModel = DEFAULT_MODEL,
    ) -> None:
        if isinstance(model, UncertainModel):
            raise SurveyError(
                f"{model.title} needs the whole scan in memory: choose the small-angle "
                "model to simulate by rows, or a smaller scan"
            )
        generator = np.random.default_rng(rng)
        self._scan = survey.scan
        self._setting = measurement.Setting.of(survey, rng=rng, model=model)
        with listening(_nobody):
            self._model = measurement.fit(self._setting)
            self._noise = RowNoise(
                generator,
                lock_in.draws(survey),
                shape=(self._scan.rows, self._scan.columns),
                gamma=survey.instrument.receiver.speckle_cells,
            )
            self._shots = measurement.open_water(self._setting, rng=generator)
        self._head: xr.Dataset | None = None

    @property
    def head(self) -> xr.Dataset:
        """Part of the cube that is independent of the row."""
        if self._head is None:
            self._head = tiles.InMemory(self.tile(0, 1)).head
        return self._head

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self._scan.rows

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self._scan.columns

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return the cube of a range of rows."""
        setting = self._setting
        directions = scan_directions(setting.setup.survey, rows=slice(begin, end))
        noise = self._noise.rows(begin, end)
        with listening(_nobody):
            samples, truth = measurement.measured(
                setting, directions, model=self._model, noise=noise
            )
        return measurement.joined(samples, self._shots, truth)

    def directions(self, begin: int, end: int) -> xr.Dataset:
        """Return azimuth and elevation of a range of rows."""
        rows = slice(begin, end)
        azimuth, elevation, _ = scan_directions(self._setting.setup.survey, rows=rows)
        dimensions = ("row", "column")
        return xr.Dataset(
            coords={
                "azimuth": (dimensions, azimuth),
                "elevation": (dimensions, elevation),
            }
        )


def _nobody(step: str, share: float) -> None:
    """Ignore the progress of a tile, since the whole file has a progress bar."""
