"""Simulated readings of a standing reference, and correction of the phase drift."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from amulor.cube.phase_drift import Complex, Floats, PhaseDrift
from amulor.simulation.instrument_errors import Chain
from amulor.survey import Survey
from amulor.survey.counting import reference_variance
from amulor.survey.directions import readings_in_turn


@dataclass(frozen=True, kw_only=True)
class ReferenceReadings:
    """Phase drift measured at a standing reference, for the correction of samples."""

    drift: PhaseDrift
    """Phase drift of the instrument."""
    chain: Chain | None
    """Signal chain with instrument errors, if any are in the survey."""
    attributes: dict[str, Any]
    """Attributes of the corrected cube."""

    @classmethod
    def of(
        cls, survey: Survey, chain: Chain | None, rng: np.random.Generator | int
    ) -> ReferenceReadings | None:
        """Simulate readings of the standing reference; None if the survey has none.

        Readings are before each row, and before each round of open-water references.
        The noise is that of photon counting. `rng` stays unchanged.
        """
        reference = survey.scan.reference
        if reference is None:
            return None
        scan, instrument = survey.scan, survey.instrument
        channels = len(instrument.modulation_frequencies), len(instrument.polarizations)
        row = (
            np.arange(scan.rows) * scan.columns * scan.dwell * readings_in_turn(survey)
        )
        time = np.asarray(row, dtype=float)
        if chain is not None:
            plan = scan.open_water
            size = 1 if plan is None else plan.rows * plan.columns
            time = np.concatenate([chain.scan_start + row, chain.shot_times[::size]])
        variance = reference_variance(survey)
        generator = np.random.default_rng(rng).spawn(2)[1]
        shape = (*channels, time.size)
        noise = generator.standard_normal((2, *shape)) * np.sqrt(variance)
        signal = np.full(shape, complex(reference.amplitude))
        if chain is not None:
            signal = chain.reference_samples(signal, time)
        drift = PhaseDrift.of(
            signal + noise[0] + 1j * noise[1], variance=variance, time=time
        )
        frequency = np.array(instrument.modulation_frequencies)
        return cls(drift=drift, chain=chain, attributes=drift.attributes(frequency))

    def scan(self, signal: Complex, time: Floats) -> Complex:
        """Return scan samples corrected for phase drift, by pixel start time [V]."""
        start = 0.0 if self.chain is None else self.chain.scan_start
        return self.drift.corrected(signal, start + time)

    def shots(self, signal: Complex) -> Complex:
        """Return open-water references corrected for the phase drift [V]."""
        if self.chain is None:
            return signal
        return self.drift.corrected(signal, self.chain.shot_times)
