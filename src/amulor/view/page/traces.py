"""Signals of a running scan over time, for the plots of the browser page."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition.cube.samples import Samples, counting_variance
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import Key
from amulor.acquisition.settings import Procedure
from amulor.errors import CubeError
from amulor.survey import Survey

#: Largest number of samples of a frequency and channel over time [1].
MOST_SAMPLES = 1000


class Traces:
    """Samples of each frequency and channel over time, evenly thinned."""

    def __init__(self, survey: Survey, procedure: Procedure) -> None:
        self._survey, self._procedure = survey, procedure
        self._samples: dict[tuple[float, str], list[tuple[Key, Record]]] = {}
        self._counts: Counter[tuple[float, str]] = Counter()

    def take(self, key: Key, record: Record) -> None:
        """Add a sample; if there are too many, keep every second one."""
        channel = key.frequency, key.polarization
        number = self._counts[channel]
        self._counts[channel] += 1
        samples = self._samples.setdefault(channel, [])
        if number % self._stride(channel) == 0:
            samples.append((key, record))
        if len(samples) > MOST_SAMPLES:
            self._samples[channel] = samples[::2]

    def _stride(self, channel: tuple[float, str]) -> int:
        """Return the number of samples of which one is kept [1]."""
        stride = 1
        while self._counts[channel] > MOST_SAMPLES * stride:
            stride *= 2
        return stride

    def over_time(self, channel: str, frequency: int) -> dict[str, Any]:
        """Return the samples of a channel at a frequency of the survey, as recorded."""
        instrument = self._survey.instrument
        values = instrument.modulation_frequencies
        if channel not in instrument.polarizations or not 0 <= frequency < len(values):
            raise CubeError(
                f"the scan has no channel {channel[:40]!r} with a frequency number "
                f"{frequency}"
            )
        at = values[frequency], channel
        # Another thread may add samples meanwhile.
        kept = list(self._samples.get(at, []))
        samples = Samples(self._survey, 1, max(len(kept), 1))
        for number, (key, record) in enumerate(kept):
            samples.put(key, record, 0, number)
        variance = counting_variance(samples, self._survey, self._procedure)
        place = (frequency, instrument.polarizations.index(channel), 0)
        # Without a sample, the only place is empty.
        signal = samples["signal"][place][: len(kept)]
        numbers = {
            "elapsed": samples["elapsed"][place],
            "amplitude": np.abs(signal),
            "phase": np.angle(signal),
            "noise": np.sqrt(variance[place]),
            "mean": samples["mean"][place],
        }
        return {
            "frequencies": [float(value) for value in values],
            "samples": self._counts[at],
            "kind": [key.kind for key, _ in kept],
            **{name: _listed(some[: len(kept)]) for name, some in numbers.items()},
        }


def _listed(values: NDArray[np.float64]) -> list[float | None]:
    """Values for JSON, with None for missing ones."""
    return [float(value) if np.isfinite(value) else None for value in values]
