"""A simulated scan row by row, never in memory whole: the same bits as the whole."""

from __future__ import annotations

import numpy as np
import xarray as xr

from amulor._progress import listening
from amulor.cube import tiles
from amulor.errors import SurveyError
from amulor.simulation import lock_in, measurement
from amulor.simulation.models import DEFAULT_MODEL, SignalModel, UncertainModel
from amulor.simulation.row_noise import RowNoise
from amulor.survey import Survey
from amulor.survey.directions import scan_directions

__all__ = ["SimulatedRows"]


class SimulatedRows:
    """The rows of a scan that is simulated as they are asked for.

    Parameters
    ----------
    survey : Survey
        What is measured, and with what; of any size.
    rng : numpy.random.Generator or int
        Source of the noise, as in `amulor.simulate`.
    model : SignalModel
        Forward model, as there; one whose light of a beam does not depend on the beams
        that come with it.

    Raises
    ------
    SurveyError
        As `amulor.simulate`, and if the model takes the scan whole, as photons do.

    Notes
    -----
    The tiles are those of `amulor.simulate`, bit for bit: noise comes from the same
    numbers of the same generator, and the table of the light of water that columns look
    up is fitted once.
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
        """All that does not run over the rows."""
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
        """Return some rows.

        Parameters
        ----------
        begin, end : int
            The first one, and the one behind the last; quickest in their order.

        Returns
        -------
        xarray.Dataset
            Cube of level `samples`, with shots and truth.
        """
        setting = self._setting
        directions = scan_directions(setting.survey, rows=slice(begin, end))
        noise = self._noise.rows(begin, end)
        with listening(_nobody):
            samples, truth = measurement.measured(
                setting, directions, model=self._model, noise=noise
            )
        return measurement.joined(samples, self._shots, truth)

    def directions(self, begin: int, end: int) -> xr.Dataset:
        """Return azimuth and elevation of some rows."""
        rows = slice(begin, end)
        azimuth, elevation, _ = scan_directions(self._setting.survey, rows=rows)
        dimensions = ("row", "column")
        return xr.Dataset(
            coords={
                "azimuth": (dimensions, azimuth),
                "elevation": (dimensions, elevation),
            }
        )


def _nobody(step: str, share: float) -> None:
    """Take what a tile says it does; the file that it is for has a bar of its own."""
