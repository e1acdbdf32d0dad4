"""Processing steps of a scan: samples, target signal, range image, point cloud.

A step works on a cube in one piece or on some rows at a time. In one piece, statistics
of a scan come from all pixels; by rows from a sample of them
(`amulor.cube.tiles.sample_of`), which has all pixels of a scan of up to 65,536.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor import imaging, io
from amulor._progress import part, tell
from amulor.cube import DOUBTFUL, UNUSABLE, tiles
from amulor.errors import CubeError
from amulor.imaging.frame import Frame
from amulor.imaging.outliers import fitted_outliers
from amulor.imaging.range_image import fitted_range_image
from amulor.imaging.selection import to_leave_out, without
from amulor.io.netcdf import is_large, open_rows, row_writer, tile_rows

if TYPE_CHECKING:
    from amulor.rejection import Comparison

__all__ = ["run"]

AnyPath = str | os.PathLike[str]
#: Rows above and below a tile that flags of edges and outliers depend on: seven, and
#: one more for a line that ends at the rim.
HALO = 8
#: Rows of a tile, in halos at least, so that few rows are processed twice.
_HALOS = 4
#: Default number of pixels converted to points at once.
_PIXELS = 2**17


@dataclass(frozen=True, kw_only=True)
class TiledStep:
    """Processing step of a scan, which runs on a whole cube or by tiles of rows."""

    level: str
    """Level of the cube that the step needs as input."""
    whole: Callable[[xr.Dataset], xr.Dataset]
    """Function that runs the step on a cube in one piece."""
    fit: Callable[[tiles.Source], tiles.OfRows]
    """Function that fits the step to a scan, for processing by rows."""
    halo: int = 0
    """Rows above and below a tile that its pixels depend on."""
    of: TiledStep | None = None
    """Step whose result is the input; None for the scan itself."""
    how: dict[str, Any] = field(default_factory=dict)
    """Name and arguments of the step, for the record of a run."""

    def __call__(self, cube: xr.Dataset) -> xr.Dataset:
        """Run the step on a whole cube."""
        if self.of is None:
            return self.whole(cube)
        with part(0.0, 0.7):
            cube = self.of(cube)
        with part(0.7, 1.0):
            return self.whole(cube)


def reject_step(method: str, **options: Any) -> TiledStep:
    """Return the processing step in which a method rejects the water signal."""
    from amulor import rejection  # images and clouds load faster without it

    chosen = rejection.load(method)
    return TiledStep(
        level="samples",
        whole=partial(chosen, **options),
        fit=partial(chosen.fit, **options),
        how={"step": "reject", "method": method, **options},
    )


def image_step(**options: Any) -> TiledStep:
    """Return the processing step from target signal to flagged range image."""
    ranges = TiledStep(
        level="target_signal",
        whole=lambda cube: fitted_range_image(cube, **options)[0],
        fit=partial(tiles.fit_on_sample, fitted_range_image, **options),
    )
    return TiledStep(
        level="target_signal",
        whole=lambda image: _flagged(image)[0],
        fit=partial(tiles.fit_on_sample, _flagged, needs_span=False),
        halo=HALO,
        of=ranges,
        how={"step": "image", **options},
    )


def _flagged(
    image: xr.Dataset, *, fit: tuple[float, ...] | None = None
) -> tuple[xr.Dataset, tuple[float, ...]]:
    """Return the range image with edges and outliers flagged, and the thresholds."""
    tell("edges and outliers", 0.0)
    return fitted_outliers(imaging.flag_mixed(image), fit=fit)


def steps_from(
    level: str,
    *,
    method: str | None = None,
    polarization: str | None = None,
    interval: tuple[float, float] | None = None,
    **options: Any,
) -> dict[str, TiledStep]:
    """Return the processing steps from a level up to the range image."""
    steps: dict[str, TiledStep] = {}
    if level == "samples":
        if method is None:
            raise CubeError("samples become a range image by a rejection method only")
        steps["target_signal"] = reject_step(method, interval=interval, **options)
    if level != "range_image":
        steps["range_image"] = image_step(interval=interval, polarization=polarization)
    return steps


def run(
    cube: xr.Dataset,
    *,
    method: str | None = None,
    polarization: str | None = None,
    interval: tuple[float, float] | None = None,
    **options: Any,
) -> xr.Dataset:
    """Process a cube up to the range image with flagged edges and outliers.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, `target_signal` or `range_image`; a range image is returned
        unchanged.
    method : str, optional
        Rejection method, a name from `amulor.rejection.names`; needed for samples.
    polarization : str, optional
        Channel of the image; needed if there are several.
    interval : tuple of float, optional
        Nearest and farthest possible slant range [m].
    **options
        Further options of the method.

    Returns
    -------
    xarray.Dataset
        Level `range_image`.

    Raises
    ------
    AmulorError, ValueError
        As `amulor.rejection.reject` and `amulor.imaging.range_image`.

    Examples
    --------
    >>> from amulor import pipeline, samples
    >>> cube = samples.cube("ladder").isel(row=slice(10, 20), shot=slice(0, None, 4))
    >>> image = pipeline.run(cube, method="open-water", polarization="VH")
    >>> for line in image.attrs["history"].splitlines():
    ...     print(line.split(": ")[1])
    simulate
    reject, open water, column behind the target put back
    image, channel VH
    mixed pixels marked
    outliers flagged
    """
    steps = steps_from(
        str(cube.attrs.get("level", "")),
        method=method,
        polarization=polarization,
        interval=interval,
        **options,
    )
    for number, step in enumerate(steps.values()):
        with part(number / len(steps), (number + 1) / len(steps)):
            cube = step(cube)
    return cube if steps else cubes.checked(cube, "range_image")


class Prepared:
    """Processing step that was fitted to a scan and can process any rows."""

    def __init__(self, step: TiledStep, source: tiles.Source, rows: int) -> None:
        self.rows, self.halo = rows, step.halo
        self._before = None if step.of is None else Prepared(step.of, source, rows)
        self.treat = step.fit(self.input(source))

    def input(self, source: tiles.Source) -> tiles.Source:
        """Return the input rows of the step, after the step before it."""
        if self._before is None:
            return source
        return _Kept(Made(self._before, source), self.rows)


class Made(tiles.Derived):
    """Row source with the results of a processing step."""

    def __init__(self, prepared: Prepared, source: tiles.Source) -> None:
        super().__init__(prepared.input(source))
        self._prepared = prepared

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return processed rows, whose values do not depend on the tile size."""
        halo = self._prepared.halo
        first = max(begin - halo, 0)
        wide = self._source.tile(first, min(end + halo, self.rows))
        treated = self._prepared.treat(wide, first)
        return treated.isel(row=slice(begin - first, end - first))


class _Kept(tiles.Derived):
    """Row source that caches its last tile, whose rows the next tile needs."""

    def __init__(self, source: tiles.Source, rows: int) -> None:
        super().__init__(source)
        self._at_once = rows
        self._begin, self._end = 0, 0
        self._last: xr.Dataset | None = None

    @property
    def head(self) -> xr.Dataset:
        """Variables and coordinates without row dimension, and the attributes."""
        return self._source.head

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return rows; fastest if the tiles are read in ascending order."""
        joined = tiles.Whole(end - begin, self.columns)
        new = begin
        if self._last is not None and self._begin <= begin < self._end:
            new = min(self._end, end)
            shared = slice(begin - self._begin, new - self._begin)
            joined.put(self._last.isel(row=shared), 0)
        for first in range(new, end, self._at_once):
            last = min(first + self._at_once, end)
            joined.put(self._source.tile(first, last), first - begin)
        self._begin, self._end, self._last = begin, end, joined.made()
        return self._last


def window(step: TiledStep, source: tiles.Source, rows: int | None = None) -> int:
    """Return the number of rows in a tile of a processing step."""
    if rows is not None:
        return rows
    few = tile_rows(source)
    return few * max(1, -(-_HALOS * step.halo // few))


def run_step(
    step: TiledStep, source: tiles.Source, *, rows: int | None = None
) -> Iterator[tuple[int, xr.Dataset]]:
    """Run a step: whole if the cube is in memory and `rows` is None, else by tiles."""
    if rows is not None and rows < 1:
        raise ValueError(f"a tile has 1 row at least, got {rows}")
    if rows is None and isinstance(source, tiles.InMemory):
        yield 0, step(source.cube)
        return
    tell("scan-wide statistics", 0.0)
    prepared = Prepared(step, source, tile_rows(source) if rows is None else rows)
    source_rows = Made(prepared, source)
    for begin, end in tiles.bands(source, window(step, source, rows)):
        tell(f"row {begin:,} of {source.rows:,}", begin / source.rows)
        yield begin, source_rows.tile(begin, end)


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Counts of samples and flags in the result of a processing step."""

    head: xr.Dataset
    """Variables and attributes without the dimension row."""
    count: int
    """Number of samples of a target signal, or pixels of a range image [1]."""
    usable: int
    """Number of finite samples or pixels [1]."""
    flagged: int
    """Number of flagged samples or pixels [1]."""
    doubtful: int
    """Number of samples or pixels that are finite and flagged [1]."""
    flags: dict[str, int]
    """Number of samples or pixels with each flag [1]."""
    whole: xr.Dataset | None
    """Result of the step, if processed in one piece."""
    comparison: Comparison | None = None
    """Comparison of all methods, for the method "auto"."""


@contextmanager
def opened(
    path: AnyPath, rows: int | None = None, *, level: str
) -> Iterator[tiles.Source]:
    """Open a cube: in memory, or by rows if it is large or a tile size is set."""
    if rows is None and not is_large(path):
        tell(f"reading {path}", 0.0)
        yield tiles.InMemory(cubes.checked(io.read_cube(path), level, name=str(path)))
    else:
        with open_rows(path) as source:
            cubes.check(source.tile(0, 1), level, name=str(path))
            yield source


def run_file(
    step: TiledStep,
    source: AnyPath,
    output: AnyPath,
    *,
    rows: int | None = None,
    overwrite: bool = False,
) -> Summary:
    """Run a step from file to file; by rows if large or if a tile size is set."""
    with opened(source, rows, level=step.level) as cube:
        return _written(step, cube, output, rows, overwrite=overwrite)


def _written(
    step: TiledStep,
    source: tiles.Source,
    output: AnyPath,
    rows: int | None,
    *,
    overwrite: bool,
) -> Summary:
    """Run a step, write its result, and count samples and flags."""
    flags: Counter[str] = Counter()
    count = usable = flagged = doubtful = 0
    head: xr.Dataset | None = None
    with row_writer(output, source.rows, overwrite=overwrite) as writer:
        for begin, tile in run_step(step, source, rows=rows):
            writer.put(tile, begin)
            signal = "in_phase" if "in_phase" in tile else "slant_range"
            number = np.isfinite(tile[signal].values)
            flag = tile["quality_flag"].values != 0
            count, usable = count + number.size, usable + int(number.sum())
            flagged += int(flag.sum())
            doubtful += int((flag & number).sum())
            flags.update(cubes.flag_counts(tile))
            head = tiles.InMemory(tile).head if head is None else head
    assert head is not None
    return Summary(
        head=head,
        count=count,
        usable=usable,
        flagged=flagged,
        doubtful=doubtful,
        flags=dict(flags),
        whole=tile if tile.sizes["row"] == source.rows else None,
    )


def reject_file(
    source: AnyPath,
    output: AnyPath,
    method: str,
    *,
    open_water: AnyPath | None = None,
    rows: int | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Summary:
    """Reject the water signal in a file of samples, by any installed method."""
    from amulor import rejection

    with opened(source, rows, level="samples") as cube:
        if open_water is not None:
            shots = io.read_cube(open_water)
            joined = partial(rejection.with_open_water, reference=shots)
            if isinstance(cube, tiles.InMemory):
                cube = tiles.InMemory(joined(cube.cube))
            else:
                cube = tiles.Changed(cube, joined)
        comparison, compared = None, 0.0
        if "comparison" in rejection.load(method).options:
            compared = 0.6
            with part(0.0, compared):
                comparison = rejection.compare(
                    _judged(cube, rows), interval=options.get("interval")
                )
            options["comparison"] = comparison
        with part(compared, 1.0):
            step = reject_step(method, **options)
            summary = _written(step, cube, output, rows, overwrite=overwrite)
    return replace(summary, comparison=comparison)


def _judged(source: tiles.Source, rows: int | None) -> xr.Dataset:
    """Return the cube for comparing methods; in work by rows, only a sample of it."""
    if rows is None and isinstance(source, tiles.InMemory):
        return source.cube
    return cubes.without_groups(tiles.sample_of(source), "truth")


def image_file(
    source: AnyPath,
    output: AnyPath,
    *,
    rows: int | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Summary:
    """Make the range image of a file with a target signal."""
    step = image_step(**options)
    return run_file(step, source, output, rows=rows, overwrite=overwrite)


@dataclass(frozen=True)
class Selection:
    """Criteria that exclude pixels, for `amulor.imaging.leave_out`."""

    good_only: bool = False
    """Whether all flagged pixels are excluded."""
    largest_uncertainty: float | None = None
    """Largest uncertainty of a pixel [m]."""
    mixed: bool = False
    """Whether mixed pixels and outliers are excluded."""


@dataclass(frozen=True)
class CloudSummary:
    """Counts of all points and of doubtful points in a cloud written by rows."""

    points: int
    """Number of points [1]."""
    doubtful: int
    """Number of points whose range is flagged as doubtful [1]."""
    error_unknown: str = ""
    """Reason why the error of the ranges is unknown; empty for a known error."""


def cloud_file(
    source: AnyPath,
    output: AnyPath,
    *,
    frame: Frame | None = None,
    selection: Selection | None = None,
    rows: int | None = None,
    slim: bool = False,
    overwrite: bool = False,
) -> CloudSummary:
    """Write the point cloud of a range image, tile by tile."""
    chosen = selection or Selection()
    full = os.fspath(output).lower().endswith(".mcap")
    with open_rows(source) as image:
        cubes.checked(image.tile(0, 1), "range_image")
        few = max(1, _PIXELS // image.columns)
        size = min(tile_rows(image), few) if rows is None else rows
        with part(0.0, 0.2):
            summary, counts = _counted(image, chosen, size)

        def parts() -> Iterator[xr.Dataset]:
            for begin, end in tiles.bands(image, size):
                tell(f"row {begin:,} of {image.rows:,}", 0.2 + 0.8 * begin / image.rows)
                tile = image.tile(begin, end)
                tile = without(tile, to_leave_out(tile, **vars(chosen))[0], counts)
                cloud = imaging.point_cloud(tile, frame=frame, covariance=full)
                row = cloud["row"]
                yield cloud.assign(row=row.copy(data=row.values + np.int32(begin)))

        shape = image.rows, image.columns
        io.write_cloud_parts(
            parts, summary.points, output, shape=shape, slim=slim, overwrite=overwrite
        )
    return summary


def _counted(
    image: tiles.Source, selection: Selection, size: int
) -> tuple[CloudSummary, dict[str, int]]:
    """Count the points of a cloud, and the excluded pixels by reason."""
    counts: Counter[str] = Counter()
    points = doubtful = 0
    words = ""
    for begin, end in tiles.bands(image, size):
        tell(f"counting, row {begin:,} of {image.rows:,}", begin / image.rows)
        tile = image.tile(begin, end)
        words = words or cubes.error_unknown(tile)
        excluded, reasons = to_leave_out(tile, **vars(selection))
        # Reasons that exclude no pixel stay in the list.
        for reason, number in reasons.items():
            counts[reason] += number
        flag = tile["quality_flag"].values
        usable = ((flag & UNUSABLE) == 0) & ~excluded
        points += int(usable.sum())
        doubtful += int((usable & ((flag & int(DOUBTFUL)) != 0)).sum())
    return CloudSummary(points, doubtful, words), dict(counts)
