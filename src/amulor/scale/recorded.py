"""Import of recordings larger than memory: samples sorted on disk, read by rows."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amulor import _progress
from amulor import cube as cubes
from amulor._progress import tell
from amulor.cube import tiles
from amulor.io import recordings
from amulor.io.netcdf import row_writer
from amulor.io.recording_samples import (
    Places,
    Samples,
    at_temperature,
    groups,
    pixels,
    refuse_several,
    rounded_temperatures,
    samples_of,
)
from amulor.io.recording_table import RecordingMap, table_parts
from amulor.survey import Survey

__all__ = ["RecordedSummary", "import_file"]

Floats = NDArray[np.float64]
Scratch = NDArray[np.void]

#: Number of lines read at once.
_LINES = 2**16
#: Number of samples read back at once.
_SAMPLES = 2**18
_NUMBERS = (
    "mean", "frequency", "azimuth", "elevation", "row", "column", "temperature",
)  # fmt: skip
#: A sample on the disk; `pair` is an index of the polarizations as they were first met.
_SAMPLE = np.dtype(
    [
        ("signal", "c16"),
        *((name, "f8") for name in _NUMBERS),
        ("pair", "i4"),
        ("water", "?"),
    ]
)
#: A sample on the disk, with its place on the scan.
_PLACED = np.dtype([("sample", _SAMPLE), ("at", "i8", (4,))])


@dataclass(frozen=True, kw_only=True)
class RecordedSummary:
    """Size of an imported cube, and counts of flagged samples."""

    sizes: dict[str, int]
    """Lengths of the dimensions of the cube [1]."""
    marked: dict[str, int]
    """Number of samples with each flag [1]."""


def import_file(
    path: str | os.PathLike[str],
    described: RecordingMap,
    survey: Survey,
    output: str | os.PathLike[str],
    *,
    temperature: float | None = None,
    rows: int | None = None,
    overwrite: bool = False,
) -> RecordedSummary:
    """Import a recording of any size as a measurement cube, tile by tile.

    Until the file is complete, about 200 bytes per sample are stored beside it on disk.
    Open-water shots and the list of distinct frequencies are in memory.
    """
    path, output = Path(path), Path(output)
    with (
        row_writer(output, survey.scan.rows, overwrite=overwrite) as writer,
        tempfile.TemporaryDirectory(
            dir=output.parent, prefix=".amulor-"
        ) as folder_name,
    ):
        folder = Path(folder_name)
        with _progress.part(0.0, 0.5):
            pairs = _spilled(path, described, survey, folder, temperature)
            shared = _known(folder, pairs, temperature)
            recordings.refuse_no_scan(path, any_scan=shared.any_scan)
        planes = len(shared.frequencies) * len(shared.pairs)
        size = rows or max(1, tiles.SAMPLES_AT_ONCE // (survey.scan.columns * planes))
        recording = _sorted(path, described, survey, folder, shared, size)
        typical = _typical(recording, folder, size)
        marked: Counter[str] = Counter()
        sizes: dict[str, int] = {}
        for begin, end in _bands(survey, size):
            tell(f"row {begin:,} of {survey.scan.rows:,}", begin / survey.scan.rows)
            band = _band(recording, folder, size, (begin, end))
            tile = recordings.cube_of(
                recording, band, typical, mean=shared.mean, temperature=shared.warm
            )
            writer.put(tile, begin)
            counted = tile if begin == 0 else cubes.without_groups(tile)
            marked.update(recordings.marked(counted))
            sizes = sizes or {str(name): length for name, length in tile.sizes.items()}
    return RecordedSummary(
        sizes={**sizes, "row": survey.scan.rows}, marked=dict(marked)
    )


def _spilled(
    path: Path,
    described: RecordingMap,
    survey: Survey,
    folder: Path,
    temperature: float | None,
) -> list[str]:
    """Copy all samples to disk; return the polarizations in order of appearance."""
    pairs: dict[str, int] = {}
    rounded: Floats = np.zeros(0)
    ends: list[float] = []
    read = 0
    with (folder / "samples").open("wb") as file:
        for table in table_parts(path, described, _LINES):
            tell(f"reading, sample {read:,}", 0.0)
            read += len(table)
            samples = samples_of(table, described, survey)
            part = np.zeros(samples.signal.size, dtype=_SAMPLE)
            for name in ("signal", "water", *_NUMBERS):
                part[name] = getattr(samples, name)
            part["pair"] = [
                pairs.setdefault(str(pair), len(pairs)) for pair in samples.polarization
            ]
            file.write(part.tobytes())
            temperatures = samples.temperature[np.isfinite(samples.temperature)]
            if temperatures.size:
                rounded = np.union1d(rounded, rounded_temperatures(temperatures))
                ends += [float(temperatures.min()), float(temperatures.max())]
                if temperature is not None:
                    off = np.abs(temperatures - temperature)
                    ends.append(float(temperatures[np.argmin(off)]))
    refuse_several(path, rounded, np.array(ends), temperature)
    return list(pairs)


@dataclass(kw_only=True)
class _Known:
    """Axes and channels of a recording, and properties common to all samples."""

    temperature: float | None
    pairs: list[str] = field(default_factory=list)
    pair: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Index in `pairs` of each polarization."""
    values: Floats = field(default_factory=lambda: np.zeros(0))
    frequencies: Floats = field(default_factory=lambda: np.zeros(0))
    places: Places = "order"
    any_scan: bool = False
    mean: bool = False
    warm: bool = False

    def samples(self, folder: Path) -> Iterator[Scratch]:
        """Yield all samples at the selected temperature, in blocks."""
        for part in _read(folder / "samples", _SAMPLE):
            if self.temperature is None:
                yield part
            else:
                yield part[at_temperature(part["temperature"], self.temperature)]

    def frequency(self, part: Scratch) -> NDArray[np.intp]:
        """Return the index of each sample's frequency."""
        return groups(self.values)[np.searchsorted(self.values, part["frequency"])]


def _read(path: Path, dtype: np.dtype[np.void]) -> Iterator[Scratch]:
    with path.open("rb") as file:
        while len(part := np.fromfile(file, dtype, _SAMPLES)):
            yield part


def _known(folder: Path, pairs: list[str], temperature: float | None) -> _Known:
    shared = _Known(temperature=temperature)
    met: dict[int, None] = {}
    rows = angles = False
    for part in shared.samples(folder):
        shared.values = np.union1d(shared.values, part["frequency"])
        unique, first = np.unique(part["pair"], return_index=True)
        met.update(dict.fromkeys(int(pair) for pair in unique[np.argsort(first)]))
        target = part[~part["water"]]
        good = recordings.is_measured(target["signal"])
        shared.any_scan |= bool(len(target))
        shared.mean |= bool(np.isfinite(target["mean"][good]).any())
        shared.warm |= bool(np.isfinite(target["temperature"]).any())
        rows |= bool(np.isfinite(target["row"]).any())
        angles |= bool(np.isfinite(target["azimuth"]).any())
    shared.places = "rows" if rows else "angles" if angles else "order"
    shared.pairs = [pairs[number] for number in met]
    shared.pair = np.zeros(len(pairs), dtype=np.intp)
    shared.pair[list(met)] = np.arange(len(met))
    count = int(groups(shared.values)[-1]) + 1 if shared.values.size else 0
    total: Floats = np.zeros(count)
    number = np.zeros(count, dtype=np.intp)
    numbers = np.arange(count)
    for part in shared.samples(folder):
        # Sums continue from the part before, so that they equal the sums of a single
        # part.
        group = shared.frequency(part)
        weights = np.concatenate([total, part["frequency"]])
        total = np.asarray(np.bincount(np.concatenate([numbers, group]), weights))
        number += np.bincount(group, minlength=count)
    shared.frequencies = np.asarray(total / number)
    return shared


def _samples(part: Scratch, pairs: list[str]) -> Samples:
    return Samples(
        signal=np.ascontiguousarray(part["signal"]),
        polarization=np.array([pairs[0]] * len(part)),
        water=part["water"],
        **{name: np.ascontiguousarray(part[name]) for name in _NUMBERS},
    )


def _sorted(
    path: Path,
    described: RecordingMap,
    survey: Survey,
    folder: Path,
    shared: _Known,
    size: int,
) -> recordings.Recording:
    """Sort the samples into a file per tile; return axes and open-water shots."""
    before: dict[tuple[int, int], int] = {}
    scanned: set[tuple[int, int]] = set()
    shots: list[Scratch] = []
    for part in shared.samples(folder):
        shots.append(part[part["water"]])
        part = part[~part["water"]]
        if not len(part):
            continue
        channel = shared.frequency(part), shared.pair[part["pair"]]
        scanned |= set(zip(*map(np.ndarray.tolist, channel), strict=True))
        row, column = pixels(
            path, _samples(part, shared.pairs), channel, survey,
            known_by=shared.places, before=before,
        )  # fmt: skip
        placed = np.zeros(len(part), dtype=_PLACED)
        placed["sample"] = part
        placed["at"] = np.stack([*channel, row, column], axis=1)
        tile = row // size
        order = np.argsort(tile, kind="stable")
        borders = np.flatnonzero(np.diff(tile[order])) + 1
        for some in np.split(order, borders):
            with (folder / f"tile {tile[some[0]]}").open("ab") as file:
                file.write(placed[some].tobytes())
    (folder / "samples").unlink()
    part = np.concatenate(shots)
    channels = np.array(sorted(scanned))
    return recordings.Recording(
        path=path,
        survey=survey,
        described=described,
        frequencies=shared.frequencies,
        pairs=shared.pairs,
        shots=recordings.shots_of(
            path,
            _samples(part, shared.pairs),
            (shared.frequency(part), shared.pair[part["pair"]]),
            survey,
            described,
            names=(shared.frequencies, shared.pairs),
            scanned=(channels[:, 0], channels[:, 1]),
        ),
    )


def _bands(survey: Survey, size: int) -> Iterator[tuple[int, int]]:
    for begin in range(0, survey.scan.rows, size):
        yield begin, min(begin + size, survey.scan.rows)


def _band(
    recording: recordings.Recording, folder: Path, size: int, rows: tuple[int, int]
) -> recordings.Band:
    """Return the samples of some rows and of adjacent rows, from the sorted files."""
    begin, end = recordings.band_with_neighbours(recording.survey, rows)
    parts = [np.zeros(0, dtype=_PLACED)]
    for tile in range(begin // size, (end - 1) // size + 1):
        file = folder / f"tile {tile}"
        for part in _read(file, _PLACED) if file.exists() else ():
            row = part["at"][:, 2]
            parts.append(part[(row >= begin) & (row < end)])
    placed = np.concatenate(parts)
    at = tuple(np.ascontiguousarray(placed["at"][:, axis]) for axis in range(4))
    samples = _samples(placed["sample"], recording.pairs)
    return recordings.gathered_band(recording, samples, at, rows)


def _typical(recording: recordings.Recording, folder: Path, size: int) -> Floats:
    """Return the median smallest neighbor difference, by frequency and channel."""
    shape = len(recording.frequencies), len(recording.pairs)
    for rows in _bands(recording.survey, size):
        band = _band(recording, folder, size, rows)
        for at in np.ndindex(shape):
            near = band.nearest[at][band.inner]
            with (folder / f"near {at}").open("ab") as file:
                file.write(near[np.isfinite(near)].tobytes())
    result = np.full((*shape, 1, 1), np.nan)
    for at in np.ndindex(shape):
        result[at] = _median_of(folder / f"near {at}")
    return result


def _median_of(path: Path) -> float:
    """Return the median of a file of non-negative numbers, as numpy does."""
    count = path.stat().st_size // 8
    if not count:
        return np.nan
    low, high = (_ranked(path, rank) for rank in ((count - 1) // 2, count // 2))
    return float(np.mean([low, high]))


def _ranked(path: Path, rank: int) -> float:
    """Return the number at a rank of the sorted file, from 0, by radix selection."""
    value = 0
    for shift in (48, 32, 16, 0):
        counts = np.zeros(2**16, dtype=np.int64)
        with path.open("rb") as file:
            while len(part := np.fromfile(file, np.uint64, _SAMPLES)):
                high = part >> np.uint64(shift)
                if shift < 48:
                    high = high[high >> np.uint64(16) == np.uint64(value)]
                low = (high & np.uint64(0xFFFF)).astype(np.intp)
                counts += np.bincount(low, minlength=2**16)
        upto = np.cumsum(counts)
        digit = int(np.searchsorted(upto, rank, side="right"))
        rank -= int(upto[digit] - counts[digit])
        value = value << 16 | digit
    return float(np.array([value], dtype=np.uint64).view(np.float64)[0])
