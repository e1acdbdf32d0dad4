"""Steps over the rows of a scan: what all pixels share is decided once, then tiles."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import xarray as xr

from amulor._progress import tell
from amulor.cube import tiles
from amulor.io.netcdf import tile_rows

__all__ = ["Made", "Prepared", "TiledStep", "run_step", "window"]

#: Rows of a tile, in halos at least: so those that are worked on twice are few.
_HALOS = 4


@dataclass(frozen=True, kw_only=True)
class TiledStep:
    """A step that works on any rows of a scan once it knows what all of them share."""

    prepare: Callable[[tiles.Source], tiles.OfRows]
    """From the scan to what treats rows of it."""
    halo: int = 0
    """Rows above and below a tile that its pixels look at."""
    of: TiledStep | None = None
    """The step on whose result it works; None if on the scan itself."""


class Prepared:
    """A step that knows what all rows of a scan share."""

    def __init__(self, step: TiledStep, source: tiles.Source, rows: int) -> None:
        self.rows, self.halo = rows, step.halo
        self._before = None if step.of is None else Prepared(step.of, source, rows)
        self.treat = step.prepare(self.input(source))

    def input(self, source: tiles.Source) -> tiles.Source:
        """Return the rows that are treated: of the scan, or of the step before."""
        if self._before is None:
            return source
        return _Kept(Made(self._before, source), self.rows)


class Made(tiles.Derived):
    """The rows that a step makes of a scan."""

    def __init__(self, prepared: Prepared, source: tiles.Source) -> None:
        super().__init__(prepared.input(source))
        self._prepared = prepared

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return some rows; the same for whatever tiles."""
        halo = self._prepared.halo
        first = max(begin - halo, 0)
        wide = self._source.tile(first, min(end + halo, self.rows))
        made = self._prepared.treat(wide, first)
        return made.isel(row=slice(begin - first, end - first))


class _Kept(tiles.Derived):
    """Rows of which the last tile is kept: its end is the halo of the next one."""

    def __init__(self, source: tiles.Source, rows: int) -> None:
        super().__init__(source)
        self._at_once = rows
        self._begin, self._end = 0, 0
        self._last: xr.Dataset | None = None

    @property
    def head(self) -> xr.Dataset:
        """All that does not run over the rows."""
        return self._source.head

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return some rows; quickest in their order."""
        joined = tiles.Whole(end - begin, self.columns)
        new = begin
        if self._last is not None and self._begin <= begin < self._end:
            new = min(self._end, end)
            part = slice(begin - self._begin, new - self._begin)
            joined.put(self._last.isel(row=part), 0)
        for first in range(new, end, self._at_once):
            last = min(first + self._at_once, end)
            joined.put(self._source.tile(first, last), first - begin)
        self._begin, self._end, self._last = begin, end, joined.made()
        return self._last


def window(step: TiledStep, source: tiles.Source, rows: int | None = None) -> int:
    """Return how many rows a step makes at once."""
    if rows is not None:
        return rows
    few = tile_rows(source)
    return few * max(1, -(-_HALOS * step.halo // few))


def run_step(
    step: TiledStep, source: tiles.Source, *, rows: int | None = None
) -> Iterator[tuple[int, xr.Dataset]]:
    """Run a step tile by tile."""
    if rows is not None and rows < 1:
        raise ValueError(f"a tile has 1 row at least, got {rows}")
    tell("what all pixels share", 0.0)
    prepared = Prepared(step, source, tile_rows(source) if rows is None else rows)
    made = Made(prepared, source)
    for begin, end in tiles.bands(source, window(step, source, rows)):
        tell(f"row {begin:,} of {source.rows:,}", begin / source.rows)
        yield begin, made.tile(begin, end)
