"""Every sample of a scan, in the order in which it is taken."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from amulor.acquisition.settings import Procedure
from amulor.survey import Survey
from amulor.survey.directions import open_water_directions, scan_directions

#: What a sample is of.
SCAN, OPEN_WATER, DARK = "scan", "open_water", "dark"


class Key(NamedTuple):
    """What tells one sample from every other one of a scan."""

    kind: str
    """SCAN, OPEN_WATER or DARK."""
    row: int
    """Row of the scan, or of the open-water grid [1]."""
    column: int
    """Column of the scan, or of the open-water grid [1]."""
    frequency: float
    """Commanded modulation frequency [Hz]."""
    polarization: str
    """Launched and analysed state, or "none"."""
    repeat: int
    """Number of the sample among those of the same place and channel; of the scan
    itself 0, more if it was taken again [1]."""


@dataclass(frozen=True)
class Step:
    """One sample: its key and the direction that it is taken in."""

    key: Key
    azimuth: float
    """To the right [rad]."""
    elevation: float
    """Upwards [rad]."""


def steps(survey: Survey, procedure: Procedure) -> Iterator[Step]:
    """Yield every planned sample.

    Parameters
    ----------
    survey : Survey
        Scan, frequencies and channels.
    procedure : Procedure
        How references are spread.

    Yields
    ------
    Step
        Reference blocks (dark, then open water, channel by channel) stand before the
        scan, after it, and at row boundaries in between. The scan is taken channel by
        channel, since a mount turns more slowly than the beam.
    """
    count = procedure.references
    rows = [
        (channel, row) for channel in channels(survey) for row in range(_rows(survey))
    ]
    # Block 0 first; block k after the k-th of the equal parts of the scan.
    ends = [round(part * len(rows) / max(count - 1, 1)) for part in range(count)]
    yield from reference_block(survey, procedure, block=0)
    directions = scan_directions(survey)[:2]
    done = 0
    for block, end in enumerate(ends[1:] or [len(rows)], start=1):
        for channel, row in rows[done:end]:
            yield from _row(survey, directions, channel, row)
        done = end
        if block < count:
            yield from reference_block(survey, procedure, block=block)


def extra_reference(
    survey: Survey, procedure: Procedure, *, number: int
) -> Iterator[Step]:
    """Yield the reference that is taken once more after a break.

    Parameters
    ----------
    survey : Survey
        Scan, frequencies and channels.
    procedure : Procedure
        How many dark readings make a block.
    number : int
        How many breaks there were before, counted from 0 [1].

    Yields
    ------
    Step
        One dark block and one open-water shot in each direction and channel, with
        repeat numbers that follow the planned ones.
    """
    plan = survey.scan.open_water
    dark = procedure.references * procedure.dark_readings
    first = 0 if plan is None else plan.repeats
    for channel in channels(survey):
        yield from _dark(
            survey,
            channel,
            range(
                dark + number * procedure.dark_readings,
                dark + (number + 1) * procedure.dark_readings,
            ),
        )
    for channel in channels(survey):
        yield from _open_water(
            survey, channel, range(first + number, first + number + 1)
        )


def retakes(
    survey: Survey, procedure: Procedure, *, spoiled: Collection[Key]
) -> Iterator[Step]:
    """Yield once more the samples of the scan that were spoiled.

    Parameters
    ----------
    survey : Survey
        Scan, frequencies and channels.
    procedure : Procedure
        How references are spread.
    spoiled : collection of Key
        The newest take of each.

    Yields
    ------
    Step
        In the order of the scan, with the repeat number after that of the take that
        was spoiled: the key is a new one.
    """
    repeats = {key._replace(repeat=0): key.repeat for key in spoiled}
    for step in steps(survey, procedure):
        if step.key in repeats:
            yield replace(step, key=step.key._replace(repeat=repeats[step.key] + 1))


def reference_block(
    survey: Survey, procedure: Procedure, *, block: int
) -> Iterator[Step]:
    """Yield the dark readings and open-water shots of one block.

    Parameters
    ----------
    survey : Survey
        Scan, frequencies and channels.
    procedure : Procedure
        How references are spread.
    block : int
        Number of the block, counted from 0 [1].

    Yields
    ------
    Step
        All dark readings before the first shot, so that the target moves once.
    """
    for channel in channels(survey):
        first = block * procedure.dark_readings
        repeats = range(first, first + procedure.dark_readings)
        yield from _dark(survey, channel, repeats)
    plan = survey.scan.open_water
    for channel in channels(survey):
        total = 0 if plan is None else plan.repeats
        yield from _open_water(
            survey, channel, range(block, total, procedure.references)
        )


def channels(survey: Survey) -> list[tuple[float, str]]:
    """Return modulation frequency [Hz] and polarization of every channel.

    Parameters
    ----------
    survey : Survey
        Its instrument counts.

    Returns
    -------
    list of tuple
        In the order of the scan: the polarization changes last.
    """
    return [
        (frequency, pair)
        for pair in survey.instrument.polarizations
        for frequency in survey.instrument.modulation_frequencies
    ]


def count(survey: Survey, procedure: Procedure) -> int:
    """Return how many samples a scan has, references included.

    Parameters
    ----------
    survey : Survey
        Scan, frequencies and channels.
    procedure : Procedure
        How references are spread.

    Returns
    -------
    int
        Number of planned steps [1].
    """
    plan = survey.scan.open_water
    shots = 0 if plan is None else plan.rows * plan.columns * plan.repeats
    dark = procedure.references * procedure.dark_readings
    pixels = survey.scan.rows * survey.scan.columns
    return len(channels(survey)) * (pixels + shots + dark)


def open_water_grid(survey: Survey) -> Mapping[tuple[int, int], tuple[float, float]]:
    """Return the direction of every place of the open-water grid.

    Parameters
    ----------
    survey : Survey
        Its open-water plan counts.

    Returns
    -------
    mapping
        (row, column) to azimuth and elevation [rad]; empty without a plan.
    """
    plan = survey.scan.open_water
    if plan is None:
        return {}
    azimuth, elevation = open_water_directions(survey)
    shape = (plan.rows, plan.columns, plan.repeats)
    across, up = azimuth.reshape(shape)[..., 0], elevation.reshape(shape)[..., 0]
    return {
        (row, column): (float(across[row, column]), float(up[row, column]))
        for row, column in np.ndindex(plan.rows, plan.columns)
    }


def _rows(survey: Survey) -> int:
    return survey.scan.rows


def _row(
    survey: Survey,
    directions: tuple[np.ndarray, ...],
    channel: tuple[float, str],
    row: int,
) -> Iterator[Step]:
    azimuth, elevation = directions
    columns = range(survey.scan.columns)
    backwards = survey.scan.order == "serpentine" and row % 2 == 1
    for column in reversed(columns) if backwards else columns:
        yield Step(
            Key(SCAN, row, column, *channel, 0),
            float(azimuth[row, column]),
            float(elevation[row, column]),
        )


def _dark(survey: Survey, channel: tuple[float, str], repeats: range) -> Iterator[Step]:
    for repeat in repeats:
        yield Step(
            Key(DARK, 0, 0, *channel, repeat),
            survey.scan.azimuth,
            survey.scan.elevation,
        )


def _open_water(
    survey: Survey, channel: tuple[float, str], repeats: range
) -> Iterator[Step]:
    grid = open_water_grid(survey)
    # Round the directions again and again: the repeats of one are spread over time.
    for repeat in repeats:
        for (row, column), (azimuth, elevation) in grid.items():
            yield Step(
                Key(OPEN_WATER, row, column, *channel, repeat), azimuth, elevation
            )
