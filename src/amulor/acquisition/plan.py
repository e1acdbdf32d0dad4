"""Plan of a scan: all samples in the order of acquisition."""

from __future__ import annotations

from collections.abc import (
    Collection,
    Container,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from amulor.acquisition.settings import Procedure
from amulor.errors import SurveyError
from amulor.survey import Survey
from amulor.survey.directions import open_water_directions, scan_directions

#: Kinds of samples.
SCAN, OPEN_WATER, DARK, SHUTTER = "scan", "open_water", "dark", "shutter"
#: Readings of the standing reference.
REFERENCE = "reference"
#: Column of a reading of the standing reference, by what follows: a row of the scan, or
#: a round of open-water shots with the number of their repeat as row.
BEFORE_ROW, BEFORE_SHOTS = 0, 1


class Key(NamedTuple):
    """Unique key of a sample of a scan."""

    kind: str
    """Kind of the sample: scan, open_water, dark, shutter or reference."""
    row: int
    """Row of the scan, or of the open-water grid [1]."""
    column: int
    """Column of the scan, or of the open-water grid [1]."""
    frequency: float
    """Commanded modulation frequency [Hz]."""
    polarization: str
    """Launched and analyzed polarization state, or "none"."""
    repeat: int
    """Number of the sample among all samples of its place and channel: 0 in the scan,
    higher for a retake [1]."""


@dataclass(frozen=True)
class Step:
    """One dwell: its direction and the samples acquired in it."""

    key: Key
    """Key of the first sample of the dwell."""
    azimuth: float
    """Azimuth, to the right [rad]."""
    elevation: float
    """Elevation, upwards [rad]."""
    others: tuple[Key, ...] = ()
    """Keys of the other samples of the dwell, which have other frequencies."""
    together: tuple[float, ...] = ()
    """All modulation frequencies of a dwell with several, also of samples that exist
    already [Hz]."""

    @property
    def keys(self) -> tuple[Key, ...]:
        """Keys of all samples of the dwell."""
        return (self.key, *self.others)

    @property
    def frequencies(self) -> tuple[float, ...]:
        """All modulation frequencies of this dwell [Hz]."""
        return self.together or (self.key.frequency,)

    def without(self, done: Container[Key]) -> Step | None:
        """Return the dwell with only its missing samples; None if it is complete.

        All modulation frequencies are kept, because light at one frequency must not
        depend on whether the sample at another one is missing.
        """
        remaining = [key for key in self.keys if key not in done]
        return (
            replace(self, key=remaining[0], others=tuple(remaining[1:]))
            if remaining
            else None
        )


class Comb(NamedTuple):
    """Frequencies and polarization of one dwell."""

    frequencies: tuple[float, ...]
    """Simultaneous modulation frequencies [Hz]."""
    polarization: str
    """Launched and analyzed polarization state, or "none"."""

    def step(
        self, kind: str, place: tuple[int, int], repeat: int, where: tuple[float, float]
    ) -> Step:
        """Return the dwell at a row, a column and a beam direction [rad]."""
        first, *others = (
            Key(kind, *place, frequency, self.polarization, repeat)
            for frequency in self.frequencies
        )
        together = self.frequencies if others else ()
        return Step(first, *where, tuple(others), together)


def steps(survey: Survey, procedure: Procedure) -> Iterator[Step]:
    """Yield all dwells of a scan."""
    count = procedure.references
    rows = _groups(survey, combs(survey, procedure))
    # Block 0 first; block k after the k-th of the equal parts of the scan.
    ends = [round(part * len(rows) / max(count - 1, 1)) for part in range(count)]
    yield from reference_block(survey, procedure, block=0)
    directions = scan_directions(survey)[:2]
    done = 0
    for block, end in enumerate(ends[1:] or [len(rows)], start=1):
        for group, row in rows[done:end]:
            for comb in group:
                yield from _reference(survey, comb, (row, BEFORE_ROW))
            yield from _row(survey, directions, group, row)
        done = end
        if block < count:
            yield from reference_block(survey, procedure, block=block)


def _groups(survey: Survey, every: list[Comb]) -> list[tuple[list[Comb], int]]:
    """Return the rows of a scan, each with the combs that are measured pixel by pixel.

    A vehicle does not come back: it measures all of them at a pixel before the next.
    """
    rows = range(_rows(survey))
    if survey.platform is not None:
        return [(every, row) for row in rows]
    return [([comb], row) for comb in every for row in rows]


def strips(steps: Iterable[Step], *, longest: int) -> Iterator[list[Step]]:
    """Group dwells into strips: row segments, each acquired in one motion."""
    strip: list[Step] = []
    for step in steps:
        if strip and not (len(strip) < longest and _goes_on(strip, step)):
            yield strip
            strip = []
        strip.append(step)
    if strip:
        yield strip


def _goes_on(strip: list[Step], step: Step) -> bool:
    last = strip[-1]
    if not step.key.kind == last.key.kind == SCAN or step.key.row != last.key.row:
        return False
    if step.frequencies != last.frequencies:
        return False
    if step.key.polarization != last.key.polarization:
        return False
    direction = step.key.column - last.key.column
    before = last.key.column - strip[-2].key.column if len(strip) > 1 else direction
    return abs(direction) == 1 and direction == before


def together(steps: Sequence[Step]) -> Step:
    """Join several dwells into one dwell with all of their samples."""
    first, *others = (key for step in steps for key in step.keys)
    return replace(steps[0], key=first, others=tuple(others))


def extra_reference(
    survey: Survey, procedure: Procedure, *, number: int
) -> Iterator[Step]:
    """Yield the dwells of an extra reference measurement after an interruption."""
    plan = survey.scan.open_water
    dark = procedure.references * procedure.dark_readings
    first = 0 if plan is None else plan.repeats
    for comb in combs(survey, procedure):
        yield from _at_rest(
            survey,
            comb,
            DARK,
            range(
                dark + number * procedure.dark_readings,
                dark + (number + 1) * procedure.dark_readings,
            ),
        )
    block = procedure.references + number
    for comb in combs(survey, procedure):
        yield from _at_rest(survey, comb, SHUTTER, _shutter_repeats(procedure, block))
    for comb in combs(survey, procedure):
        yield from _open_water(survey, comb, range(first + number, first + number + 1))


def retakes(
    survey: Survey, procedure: Procedure, *, spoiled: Collection[Key]
) -> Iterator[Step]:
    """Yield dwells that acquire spoiled samples of the scan again."""
    repeats = {key._replace(repeat=0): key.repeat for key in spoiled}
    for step in steps(survey, procedure):
        again = [
            key._replace(repeat=repeats[key] + 1) for key in step.keys if key in repeats
        ]
        if again:
            yield replace(step, key=again[0], others=tuple(again[1:]))


def reference_block(
    survey: Survey, procedure: Procedure, *, block: int
) -> Iterator[Step]:
    """Yield the dwells of one reference block.

    Dark readings, readings with the laser on and the shutter closed, open-water shots.
    """
    for comb in combs(survey, procedure):
        first = block * procedure.dark_readings
        repeats = range(first, first + procedure.dark_readings)
        yield from _at_rest(survey, comb, DARK, repeats)
    for comb in combs(survey, procedure):
        yield from _at_rest(survey, comb, SHUTTER, _shutter_repeats(procedure, block))
    plan = survey.scan.open_water
    for comb in combs(survey, procedure):
        total = 0 if plan is None else plan.repeats
        yield from _open_water(survey, comb, range(block, total, procedure.references))


def channels(survey: Survey) -> list[tuple[float, str]]:
    """Return modulation frequency [Hz] and polarization of every channel."""
    return [
        (frequency, pair)
        for pair in survey.instrument.polarizations
        for frequency in survey.instrument.modulation_frequencies
    ]


def combs(survey: Survey, procedure: Procedure) -> list[Comb]:
    """Return frequencies and polarization of each dwell at a pixel."""
    size = procedure.frequencies_at_once or 1
    frequencies = survey.instrument.modulation_frequencies
    depth = survey.instrument.modulation_depth * min(size, len(frequencies))
    if size > 1 and depth > 1 + 1e-9:
        raise SurveyError(
            f"{min(size, len(frequencies))} frequencies at once, each with a "
            f"modulation depth of {survey.instrument.modulation_depth:g}, would "
            f"modulate {depth:.3g} of the light; state the depth that each of them "
            f"has then (instrument.modulation_depth), at most "
            f"{survey.instrument.modulation_depth / depth:.3g}, or lower "
            "procedure.frequencies_at_once"
        )
    return [
        Comb(tuple(frequencies[first : first + size]), pair)
        for pair in survey.instrument.polarizations
        for first in range(0, len(frequencies), size)
    ]


def count(survey: Survey, procedure: Procedure) -> int:
    """Return the number of samples of a scan, including references [1]."""
    plan = survey.scan.open_water
    shots = 0 if plan is None else plan.rows * plan.columns * plan.repeats
    at_rest = procedure.dark_readings + (procedure.shutter_readings or 0)
    dark = procedure.references * at_rest
    pixels = survey.scan.rows * survey.scan.columns
    reference = survey.scan.reference
    if reference is not None:
        rounds = 0 if plan is None else plan.repeats
        pixels += reference.readings * (survey.scan.rows + rounds)
    return len(channels(survey)) * (pixels + shots + dark)


def open_water_grid(survey: Survey) -> Mapping[tuple[int, int], tuple[float, float]]:
    """Return the beam directions [rad] of the open-water grid, by row and column."""
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


def _reference(survey: Survey, comb: Comb, place: tuple[int, int]) -> Iterator[Step]:
    """Yield standing-reference readings before a row, or before a round of shots."""
    reference = survey.scan.reference
    if reference is None:
        return
    for repeat in range(reference.readings):
        where = (reference.azimuth, reference.elevation)
        yield comb.step(REFERENCE, place, repeat, where)


def _rows(survey: Survey) -> int:
    return survey.scan.rows


def _row(
    survey: Survey,
    directions: tuple[np.ndarray, ...],
    group: list[Comb],
    row: int,
) -> Iterator[Step]:
    azimuth, elevation = directions
    columns = range(survey.scan.columns)
    backwards = survey.scan.order == "serpentine" and row % 2 == 1
    for column in reversed(columns) if backwards else columns:
        where = (float(azimuth[row, column]), float(elevation[row, column]))
        for comb in group:
            yield comb.step(SCAN, (row, column), 0, where)


def _shutter_repeats(procedure: Procedure, block: int) -> range:
    readings = procedure.shutter_readings or 0
    return range(block * readings, (block + 1) * readings)


def _at_rest(survey: Survey, comb: Comb, kind: str, repeats: range) -> Iterator[Step]:
    for repeat in repeats:
        where = (survey.scan.azimuth, survey.scan.elevation)
        yield comb.step(kind, (0, 0), repeat, where)


def _open_water(survey: Survey, comb: Comb, repeats: range) -> Iterator[Step]:
    grid = open_water_grid(survey)
    # All directions in turn, repeatedly: the repeats of a direction are spread over
    # time.
    for repeat in repeats if grid else ():
        yield from _reference(survey, comb, (repeat, BEFORE_SHOTS))
        for place, where in grid.items():
            yield comb.step(OPEN_WATER, place, repeat, where)
