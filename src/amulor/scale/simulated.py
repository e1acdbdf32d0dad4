"""Simulation of scans larger than memory, tile by tile."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from amulor._progress import tell
from amulor.cube import tiles
from amulor.io.netcdf import row_writer, tile_rows
from amulor.simulation.by_rows import SimulatedRows
from amulor.simulation.models import DEFAULT_MODEL, SignalModel
from amulor.survey import Survey

__all__ = ["SimulatedSummary", "simulate_file"]


@dataclass(frozen=True, kw_only=True)
class SimulatedSummary:
    """Size of a simulated cube, fractions of hitting beams and saturated samples."""

    sizes: dict[str, int]
    """Lengths of the dimensions of the cube [1]."""
    hit: float
    """Fraction of the beams that meet a target [1]."""
    saturated: float
    """Fraction of the samples that overload the detector [1]."""


def simulate_file(
    survey: Survey,
    output: str | os.PathLike[str],
    *,
    rng: np.random.Generator | int,
    model: SignalModel = DEFAULT_MODEL,
    rows: int | None = None,
    overwrite: bool = False,
) -> SimulatedSummary:
    """Simulate a survey of any size into a file, tile by tile."""
    tell("what all rows share", 0.0)
    source = SimulatedRows(survey, rng=rng, model=model)
    size = tile_rows(source) if rows is None else rows
    sizes: dict[str, int] = {}
    hit = saturated = samples = 0
    with row_writer(output, source.rows, overwrite=overwrite) as writer:
        for begin, end in tiles.bands(source, size):
            tell(f"row {begin:,} of {source.rows:,}", begin / source.rows)
            tile = source.tile(begin, end)
            writer.put(tile, begin)
            hit += int((tile["truth_target"].values >= 0).sum())
            saturated += int((tile["saturated"].values != 0).sum())
            samples += tile["saturated"].size
            sizes = sizes or {str(name): length for name, length in tile.sizes.items()}
    return SimulatedSummary(
        sizes={**sizes, "row": source.rows},
        hit=hit / (source.rows * source.columns),
        saturated=saturated / samples,
    )
