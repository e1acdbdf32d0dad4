"""Samples of a recording in order of time: channel, direction and pixel of each."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError
from amulor.io.recording_table import RecordingMap, Table
from amulor.optics.polarization import stokes
from amulor.survey import Survey
from amulor.survey.directions import scan_directions

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Places = Literal["rows", "angles", "order"]

#: Factor from rms to peak amplitudes [1].
_PEAK = 2**0.5
#: Largest condition number of the equations of raw frames [1].
_LARGEST_CONDITION = 1e3
#: Frequencies that differ by less count as one [1]; temperatures, in degC.
_SAME_FREQUENCY, _SAME_TEMPERATURE = 1e-6, 0.05
#: Largest difference of temperatures within a scan [degC].
_SPREAD = 1.0
#: Largest distance of a sample from the grid of the scan, in steps [1].
_OFF_GRID = 0.5


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Lock-in samples in the order of the recording."""

    signal: Complex
    mean: Floats
    frequency: Floats
    polarization: NDArray[np.str_]
    azimuth: Floats
    elevation: Floats
    row: Floats
    column: Floats
    temperature: Floats
    water: NDArray[np.bool_]

    def part(self, chosen: NDArray[np.bool_]) -> Samples:
        """Return the samples that a mask selects."""
        return Samples(**{name: value[chosen] for name, value in vars(self).items()})


def samples_of(table: Table, described: RecordingMap, survey: Survey) -> Samples:
    """Return the samples of a table in SI units, as peak amplitudes."""
    columns, constants = described.columns, described.constants
    count = len(table)

    def numbers(name: str | None, otherwise: float = np.nan) -> Floats:
        if name is None:
            return np.full(count, otherwise)
        return table.numbers(name, decimal=described.table.decimal)

    def outputs(name: str | None) -> Floats:
        # Infinite outputs are no measurement either, and their products would warn.
        values = numbers(name)
        return np.where(np.isfinite(values), values, np.nan)

    repeats = 1
    if columns.phases is not None:
        signal, mean, frequency = _of_frames(described, outputs)
        repeats = len(columns.phases)
    else:
        if columns.in_phase is not None:
            signal = outputs(columns.in_phase) + 1j * outputs(columns.quadrature)
        else:
            turn = np.exp(
                1j * constants.radians(constants.phase_unit) * outputs(columns.phase)
            )
            signal = outputs(columns.amplitude) * turn
        signal = signal * constants.scale
        signal = signal * (_PEAK if constants.root_mean_square else 1.0)
        if constants.phase_falls_with_delay:
            signal = signal.conj()
        only = survey.instrument.modulation_frequencies
        frequency = numbers(
            columns.frequency,
            constants.frequency or (only[0] if len(only) == 1 else np.nan),
        )
        mean = numbers(columns.mean)
        if not np.all(frequency > 0):
            number = int(np.argmin(frequency > 0))
            raise FormatError(
                f"{table.place(number)}: the modulation frequency is not known; state "
                "columns.frequency or constants.frequency in the map"
            )
    angle = constants.radians(constants.angle_unit)
    water = np.zeros(count, dtype=bool)
    if columns.what is not None:
        water = table.texts(columns.what) == constants.open_water
    return Samples(
        signal=np.asarray(signal, dtype=complex),
        mean=mean,
        frequency=frequency,
        polarization=np.tile(_polarizations(table, described, survey), repeats),
        azimuth=np.tile(angle * numbers(columns.azimuth), repeats),
        elevation=np.tile(angle * numbers(columns.elevation), repeats),
        row=np.tile(numbers(columns.row), repeats),
        column=np.tile(numbers(columns.column), repeats),
        temperature=np.tile(numbers(columns.temperature), repeats),
        water=np.tile(water, repeats),
    )


def _of_frames(
    described: RecordingMap, outputs: Callable[[str], Floats]
) -> tuple[Complex, Floats, Floats]:
    """Return signal, mean output and frequency of raw frames, one block a frequency.

    Least squares of frames B + a cos(phase + step) with the steps of the reference. B
    is the mean output only if it is that of light: differences of two taps have none.
    """
    constants, lists = described.constants, described.columns.phases
    assert lists is not None
    assert constants.frequencies is not None
    signals, means, frequencies = [], [], []
    for names, frequency in zip(lists, constants.frequencies, strict=True):
        if constants.phase_steps is None:
            step = 2 * np.pi * np.arange(len(names)) / len(names)
        else:
            unit = constants.radians(constants.phase_unit)
            step = unit * np.asarray(constants.phase_steps)
        design = np.stack([np.ones_like(step), np.cos(step), -np.sin(step)], axis=1)
        if np.linalg.cond(design) > _LARGEST_CONDITION:
            raise FormatError(
                "constants.phase_steps do not determine the phase; needed are three or "
                "more different phases of the reference"
            )
        frames = constants.scale * np.stack([outputs(name) for name in names])
        offset, in_phase, quadrature = np.linalg.pinv(design) @ frames
        signals.append(in_phase + 1j * quadrature)
        is_light = offset >= np.hypot(in_phase, quadrature)
        means.append(np.where(is_light, offset, np.nan))
        frequencies.append(np.full(offset.size, frequency))
    return np.concatenate(signals), np.concatenate(means), np.concatenate(frequencies)


def _polarizations(
    table: Table, described: RecordingMap, survey: Survey
) -> NDArray[np.str_]:
    name, constant = described.columns.polarization, described.constants.polarization
    only = survey.instrument.polarizations
    if name is not None:
        pairs = table.texts(name)
    elif constant is not None or len(only) == 1:
        pairs = np.full(len(table), constant or only[0])
    else:
        raise FormatError(
            "the polarization of the samples is not known: the survey has "
            f"{', '.join(only)}; state columns.polarization or constants.polarization"
        )
    for number, pair in enumerate(pairs):
        if re.fullmatch(stokes.PAIR_PATTERN, str(pair)) is None:
            raise FormatError(
                f"{table.place(number)}: the polarization is {str(pair)!r}, needed is "
                '"none" or two of the letters V, H, P, M, R, L'
            )
    return pairs


def of_one_temperature(
    path: Path, samples: Samples, temperature: float | None
) -> Samples:
    """Return the samples at one temperature; raise if a choice is needed."""
    measured = samples.temperature[np.isfinite(samples.temperature)]
    refuse_several(path, rounded_temperatures(measured), measured, temperature)
    if temperature is None:
        return samples
    return samples.part(at_temperature(samples.temperature, temperature))


def rounded_temperatures(temperatures: Floats) -> Floats:
    """Distinct temperatures, rounded for messages [degC]."""
    step = 2 * _SAME_TEMPERATURE
    return np.asarray(np.unique(np.round(temperatures / step)) * 2 * _SAME_TEMPERATURE)


def at_temperature(values: Floats, temperature: float) -> NDArray[np.bool_]:
    """Mask of samples within 0.5 degC of a temperature."""
    return np.asarray(np.abs(values - temperature) <= _SPREAD / 2)


def refuse_several(
    path: Path, rounded: Floats, temperatures: Floats, temperature: float | None
) -> None:
    """Raise if a temperature must be chosen, or if the chosen one has no samples.

    `temperatures` must contain the smallest, the largest and the one nearest to the
    chosen temperature; others may be missing.
    """
    listed = ", ".join(f"{value:g}" for value in rounded)
    if temperature is None:
        if temperatures.size and np.ptp(temperatures) > _SPREAD:
            raise FormatError(
                f"{path}: was recorded at several temperatures ({listed} degC); choose "
                "one (--temperature), and import the others into cubes of their own"
            )
    elif not at_temperature(temperatures, temperature).any():
        raise FormatError(
            f"{path}: holds no sample at {temperature:g} degC; there are "
            f"{listed or 'none with a temperature'}"
        )


def distinct(values: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Distinct frequencies, increasing, and the index of each sample's frequency."""
    ordered, place = np.unique(values, return_inverse=True)
    group = groups(ordered)[place]
    means = np.bincount(group, values) / np.bincount(group)
    return np.asarray(means), group


def groups(ordered: Floats) -> NDArray[np.intp]:
    """Group index of each frequency in increasing order; equal ones share a group."""
    border = np.diff(ordered) > _SAME_FREQUENCY * ordered[:-1]
    return np.concatenate([[0], np.cumsum(border)]).astype(np.intp)


def places_known_by(samples: Samples) -> Places:
    """Source of the pixel of each sample: row numbers, angles, or only the order."""
    if np.isfinite(samples.row).any():
        return "rows"
    return "angles" if np.isfinite(samples.azimuth).any() else "order"


def pixels(
    path: Path,
    samples: Samples,
    channel: tuple[NDArray[np.intp], NDArray[np.intp]],
    survey: Survey,
    *,
    known_by: Places | None = None,
    before: dict[tuple[int, int], int] | None = None,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of each sample: as recorded, from angles, or from its order.

    If the samples are a part of a recording, `known_by` is that of the whole recording,
    and `before` is as for `turn`.
    """
    rows, columns = survey.scan.rows, survey.scan.columns
    known_by = known_by or places_known_by(samples)
    if known_by == "rows":
        row, column = samples.row, samples.column
    elif known_by == "angles":
        all_rows, first_column = slice(0, rows), np.zeros(1, dtype=np.intp)
        _, elevation, _ = scan_directions(survey, rows=all_rows, columns=first_column)
        azimuth, _, _ = scan_directions(survey, rows=first_column)
        row = _steps(samples.elevation, elevation[:, 0])
        column = _steps(samples.azimuth, azimuth[0])
    else:
        order = turn(channel, before)
        row, column = order // columns, order % columns
        if survey.scan.order == "serpentine":
            column = np.where(row % 2 == 1, columns - 1 - column, column)
    near = np.abs(row - np.round(row)) <= _OFF_GRID
    near &= np.abs(column - np.round(column)) <= _OFF_GRID
    row, column = np.round(row), np.round(column)
    inside = near & (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    if not inside.all():
        number = int(np.argmin(inside))
        raise FormatError(
            f"{path}: {(~inside).sum()} of {inside.size} samples of the scan lie "
            f"between or beyond its {rows} x {columns} pixels, the first one at row "
            f"{row[number]:g}, column {column[number]:g}; check [scan] of the survey "
            "and constants.angle_unit"
        )
    return row.astype(np.intp), column.astype(np.intp)


def _steps(angle: Floats, grid: Floats) -> Floats:
    """Fractional index of each angle on an evenly spaced grid, counted from 0."""
    if len(grid) == 1:
        return np.zeros(len(angle))
    return np.asarray((angle - grid[0]) / (grid[-1] - grid[0]) * (len(grid) - 1))


def turn(
    channel: tuple[NDArray[np.intp], NDArray[np.intp]],
    before: dict[tuple[int, int], int] | None = None,
) -> NDArray[np.float64]:
    """Count, for each sample, the earlier samples of the same channel.

    `before` has the numbers of samples before these, and is updated.
    """
    counted = {} if before is None else before
    result = np.empty(len(channel[0]))
    for number, key in enumerate(zip(*map(np.ndarray.tolist, channel), strict=True)):
        result[number] = counted.setdefault(key, 0)
        counted[key] += 1
    return result


def around(signal: Complex) -> list[Complex]:
    """Signals of the eight neighbors of each pixel; NaN beyond the edge of the scan."""
    wide = np.pad(
        signal, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=complex(np.nan)
    )
    rows, columns = signal.shape[2:]
    return [
        wide[:, :, down : down + rows, right : right + columns]
        for down, right in itertools.product(range(3), repeat=2)
        if (down, right) != (1, 1)
    ]


def nearest_distance(signal: Complex) -> Floats:
    """Smallest difference of each signal from a neighbor; NaN without neighbors [V]."""
    nearest = np.full(signal.shape, np.inf)
    for neighbor in around(signal):
        nearest = np.fmin(nearest, np.abs(signal - neighbor))
    nearest[~np.isfinite(signal) | ~np.isfinite(nearest)] = np.nan
    return nearest


def median_of(nearest: Floats) -> float:
    """Median of the finite values; NaN if there are none [V]."""
    finite = nearest[np.isfinite(nearest)]
    return float(np.median(finite)) if finite.size else np.nan


def off_mixtures(signal: Complex, beside: Complex) -> tuple[Floats, Floats]:
    """Least signal distance from mixtures of neighbors; largest between neighbors [V].

    A beam on an edge measures a mixture of both sides. The first axis of `beside` has
    the neighbors of each sample, NaN where there are none.
    """
    off, spread = np.full(signal.shape, np.inf), np.zeros(signal.shape)
    for first, second in itertools.combinations_with_replacement(beside, 2):
        span = second - first
        length = np.abs(span)
        along = ((signal - first) * span.conj()).real
        share = np.clip(along / np.where(length > 0, length, 1) ** 2, 0, 1)
        off = np.fmin(off, np.abs(signal - first - share * span))
        spread = np.fmax(spread, length)
    return off, spread
