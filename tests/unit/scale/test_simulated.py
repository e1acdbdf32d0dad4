"""Counts of a scan that is simulated by rows are those of all tiles."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
import xarray as xr

from amulor import _progress
from amulor.scale import simulated
from amulor.simulation.models import DEFAULT_MODEL

#: Index of the target that each beam of a scan of five rows meets, or -1.
TARGET = np.array([[-1, 0], [1, 0], [-1, -1], [-1, 2], [0, -1]])
#: Flag of each sample of two frequencies.
SATURATED = np.array([[[0, 1], [2, 0], [0, 0], [0, 0], [0, 3]], np.zeros((5, 2))])


class Rows:
    """Stand-in for a simulated scan of five rows and two columns."""

    made: ClassVar[list[tuple[Any, ...]]] = []

    def __init__(self, survey: Any, *, rng: Any, model: Any) -> None:
        self.made.append((survey, rng, model))
        self.rows, self.columns = TARGET.shape
        self.head = SimpleNamespace(sizes={"modulation_frequency": 2})

    def tile(self, begin: int, end: int) -> xr.Dataset:
        channels = ("modulation_frequency", "row", "column")
        return xr.Dataset(
            {
                "truth_target": (("row", "column"), TARGET[begin:end]),
                "saturated": (channels, SATURATED[:, begin:end]),
            }
        )


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    listed: list[tuple[Any, ...]] = []

    @contextmanager
    def row_writer(path: Path, rows: int, *, overwrite: bool) -> Iterator[Any]:
        listed.append((path, rows, overwrite))
        yield SimpleNamespace(
            put=lambda tile, row: listed.append((row, tile.sizes["row"]))
        )

    monkeypatch.setattr(simulated, "row_writer", row_writer)
    monkeypatch.setattr(simulated, "SimulatedRows", Rows)
    monkeypatch.setattr(Rows, "made", [])
    return listed


def test_beams_that_hit_and_saturated_samples_are_shares_of_all(
    written: list[tuple[Any, ...]],
) -> None:
    survey: Any = "survey"
    told: list[tuple[str, float]] = []
    with _progress.listening(lambda step, share: told.append((step, share))):
        found = simulated.simulate_file(survey, Path("a.nc"), rng=3, rows=2)
    assert found.sizes == {"modulation_frequency": 2, "row": 5, "column": 2}
    assert found.hit == 5 / 10
    assert found.saturated == 3 / 20
    assert written == [(Path("a.nc"), 5, False), (0, 2), (2, 2), (4, 1)]
    assert Rows.made == [("survey", 3, DEFAULT_MODEL)]
    assert told == [
        ("what all rows share", 0), ("row 0 of 5", 0), ("row 2 of 5", 0.4),
        ("row 4 of 5", 0.8),
    ]  # fmt: skip


def test_tiles_have_the_rows_of_blocks_of_the_file_unless_stated(
    written: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulated, "tile_rows", lambda source: source.rows - 1)
    survey, model = "survey", "model"
    simulated.simulate_file(
        survey, "a.nc", rng=1, model=model, overwrite=True,
    )  # fmt: skip
    assert written == [("a.nc", 5, True), (0, 4), (4, 1)]
    assert Rows.made == [("survey", 1, "model")]
