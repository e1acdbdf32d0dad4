"""Samples of a journal as arrays, and their dark output."""

from __future__ import annotations

import json
import operator
import tomllib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from amulor.acquisition import plan
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import QUANTITIES, Record
from amulor.acquisition.plan import Key
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Procedure
from amulor.acquisition.uncertainty import (
    input_variance_ratio,
    reading_variance,
    variance_ratio,
)
from amulor.cube.phase_drift import PhaseDrift
from amulor.errors import FormatError
from amulor.survey import Survey

Floats = NDArray[np.float64]

#: Signal without a measurement: both parts are NaN.
MISSING = complex(np.nan, np.nan)


#: One sample: recorded quantities, signal and amplitude before any correction, number
#: of takes and number of the newest take.
_SAMPLE = np.dtype(
    [
        *((name, quantity.kind) for name, quantity in QUANTITIES.items()),
        ("signal", np.complex128),
        ("raw_amplitude", np.float64),
        ("takes", np.int32),
        ("newest", np.int64),
    ]
)
_NAMES = tuple(QUANTITIES)
_RECORDED = operator.attrgetter(*_NAMES)
_EMPTY = (
    *(quantity.absent for quantity in QUANTITIES.values()),
    MISSING,
    np.nan,
    0,
    -1,
)


class Samples:
    """Samples of one kind, shape (frequency, polarization, row, column)."""

    def __init__(self, survey: Survey, first: int, second: int) -> None:
        instrument = survey.instrument
        self._frequency = {
            value: number
            for number, value in enumerate(instrument.modulation_frequencies)
        }
        self._pair = {
            pair: number for number, pair in enumerate(instrument.polarizations)
        }
        shape = (len(self._frequency), len(self._pair), first, second)
        self.values = np.full(shape, np.array(_EMPTY, dtype=_SAMPLE))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return one quantity of all samples, as a writable view."""
        return self.values[name]

    def fill(self, journal: Journal, kind: str) -> None:
        """Insert all samples of one kind, each at its row and column."""
        for key, record in journal.samples(kind):
            self.put(key, record, key.row, key.column)

    def put(self, key: Key, record: Record, first: int, second: int) -> None:
        """Insert one sample; a repeated acquisition replaces an earlier one."""
        at = (
            self._frequency[key.frequency],
            self._pair[key.polarization],
            first,
            second,
        )
        place = self.values[at]
        takes = place["takes"] + 1
        if key.repeat < place["newest"]:
            self.values["takes"][at] = takes
            return
        signal = complex(record.in_phase, record.quadrature)
        recorded = (np.nan if value is None else value for value in _RECORDED(record))
        self.values[at] = (*recorded, signal, abs(signal), takes, key.repeat)


def read_back_frequencies(samples: Samples, survey: Survey) -> Floats:
    """Return the median read-back frequencies [Hz], else the commanded frequencies."""
    commanded = np.array(survey.instrument.modulation_frequencies)
    frequency = commanded.copy()
    for number, values in enumerate(samples["modulation_frequency"]):
        finite = values[np.isfinite(values)]
        if finite.size:
            frequency[number] = np.median(finite)
    return frequency if np.all(np.diff(frequency) > 0) else commanded


def identities_of(journal: Journal) -> dict[str, str]:
    """Return the identities of the devices that a journal records."""
    text = entry(journal, "identities")
    try:
        identities = json.loads(text)
        return {str(name): str(identity) for name, identity in identities.items()}
    except (ValueError, AttributeError) as error:
        raise FormatError(
            f"the identities of the devices in the journal of {journal.folder} are "
            "damaged; take a copy of the folder before anything else"
        ) from error


def procedure_of(journal: Journal) -> Procedure:
    """Return the acquisition procedure that a journal records."""
    try:
        content = tomllib.loads(entry(journal, "devices")).get("procedure", {})
        # Only the procedure: packages with drivers of other devices may be missing now.
        return Procedure.model_validate(content, context={"from_text": True})
    except (tomllib.TOMLDecodeError, ValidationError) as error:
        raise FormatError(
            f"the devices in the journal of {journal.folder} are damaged "
            f"({str(error).splitlines()[0]}); see devices.toml in that folder"
        ) from error


def entry(journal: Journal, name: str) -> str:
    """Return a metadata entry of a scan from its journal."""
    entries = journal.meta()
    if name not in entries:
        raise FormatError(
            f"the journal of {journal.folder} says nothing about {name}; it is "
            "damaged, take a copy of the folder before anything else"
        )
    return entries[name]


def dark_output(
    survey: Survey, journal: Journal
) -> tuple[NDArray[np.complex128], Floats]:
    """Return the mean dark output of each channel [V], and its variance [V^2]."""
    recorded = [*journal.samples(plan.DARK)]
    # Place by count, not by number: numbers of a short scan can be high.
    numbers: dict[tuple[float, str], int] = {}
    places = []
    for key, _ in recorded:
        channel = key.frequency, key.polarization
        places.append(numbers.setdefault(channel, 0))
        numbers[channel] += 1
    number = max(numbers.values(), default=0)
    channels = (
        len(survey.instrument.modulation_frequencies),
        len(survey.instrument.polarizations),
    )
    if number == 0:
        return np.zeros(channels, dtype=complex), np.zeros(channels)
    samples = Samples(survey, 1, number)
    for (key, record), place in zip(recorded, places, strict=True):
        if not record.flags & SampleFlag.OVERLOAD:
            samples.put(key, record, 0, place)
    count = np.isfinite(samples["signal"]).sum(axis=(2, 3))
    divisor = np.maximum(count, 1)
    mean = np.nansum(samples["signal"], axis=(2, 3)) / divisor
    variance = counting_variance(samples, survey, procedure_of(journal))
    mean_variance = np.nanmean(variance) if count.any() else 0.0
    return mean, np.where(count > 0, mean_variance / divisor, 0.0)


def phase_drift(
    survey: Survey, journal: Journal, dark: tuple[NDArray[np.complex128], Floats]
) -> PhaseDrift | None:
    """Return the phase drift by standing-reference readings; None if there are none."""
    reference = survey.scan.reference
    recorded = [*journal.samples(plan.REFERENCE)]
    if reference is None or not recorded:
        return None
    places = sorted({(key.column, key.row) for key, _ in recorded})
    number = {place: at for at, place in enumerate(places)}
    samples = Samples(survey, len(places), reference.readings)
    for key, record in recorded:
        if not record.flags & (SampleFlag.OVERLOAD | SampleFlag.NO_LIGHT):
            samples.put(key, record, number[key.column, key.row], key.repeat)
    signal = samples["signal"] - dark[0][:, :, None, None]
    valid = np.isfinite(signal)
    count = np.maximum(valid.sum(axis=-1), 1)
    variance = counting_variance(samples, survey, procedure_of(journal))

    def mean(values: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(np.where(valid, values, 0).sum(axis=-1) / count)

    time, whole = mean(samples["elapsed"]), valid.any(axis=-1)
    return PhaseDrift.of(
        np.where(whole, mean(signal), MISSING),
        variance=mean(variance) / count,
        # A missing reading has the time of another one.
        time=np.where(whole, time, time.max(axis=-1, keepdims=True)),
    )


def counting_variance(samples: Samples, survey: Survey, procedure: Procedure) -> Floats:
    """Return each sample's noise variance: measured, else computed shot noise [V^2]."""
    detector = survey.instrument.detector
    volt = detector.volt_per_photoelectron_rate
    lower = samples["raw_amplitude"] / (survey.instrument.modulation_depth * volt)
    # A mean output below the dark level is noise without light.
    from_mean = np.maximum(samples["mean"] / volt - detector.dark_rate, 0.0)
    rate = np.where(np.isfinite(samples["mean"]), from_mean, lower)
    if procedure.mode == "continuous":
        # The mean output is read once or twice a pixel, maybe across an edge: the light
        # is at least the modulated part.
        rate = np.fmax(rate, lower)
    variance = reading_variance(
        survey,
        rate=np.nan_to_num(rate),
        time_constant=survey.instrument.lock_in.time_constant,
    )
    constant = survey.instrument.lock_in.time_constant
    if procedure.output_filter == "known":
        length = survey.scan.dwell / samples["readings"] / constant
        recorded_length = samples["interval"] / constant
        length = np.where(np.isfinite(recorded_length), recorded_length, length)
        ratio = input_variance_ratio(samples["readings"], spacing=length)
    else:
        length = np.where(
            np.isfinite(samples["interval"]), samples["interval"] / constant, 1
        )
        ratio = variance_ratio(samples["readings"], spacing=length)
    # Noise estimated from a record is more accurate than expected counting noise.
    noise = np.where(
        np.isfinite(samples["spread"]), samples["spread"] ** 2, variance * ratio
    )
    return np.asarray(noise + np.nan_to_num(samples["edge"]) ** 2)
