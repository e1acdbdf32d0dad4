"""Simulation of instrument errors in the order of the signal chain.

Formulas, signs and typical sizes: docs/theory/instrument-errors.md. Random numbers come
from generators of their own, one for each row, so that samples without errors keep
theirs and a scan by rows is that of the whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics.polarization import mueller
from amulor.simulation import lock_in
from amulor.simulation.geometry import Setup
from amulor.simulation.lock_in import Light
from amulor.survey import InstrumentErrors, Survey
from amulor.survey.directions import Floats, readings_in_turn
from amulor.survey.instrument_errors import Bubbles, Crosstalk, OpticalLeakage, Part
from amulor.survey.mueller import matrix
from amulor.survey.properties import water_properties

__all__ = ["Chain"]

Complex = NDArray[np.complex128]
Directions = tuple[Floats, Floats, Floats]
_Draw = Callable[[], Floats]

#: Purposes of random numbers, each with separate generators.
(
    _POINTING, _WHITE, _PINK, _WHITE_SHOTS, _WHITE_REFERENCE, _BUBBLES, _BUBBLES_SHOTS,
) = range(7)  # fmt: skip
#: Number of tones that represent pink noise.
_TONES = 64
#: Orders of harmonics that four samples a period turn into the conjugate.
_CONJUGATE = (3, 7)


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Signal chain of an instrument, with the instrument errors in the survey."""

    setup: Setup
    """Setup of the survey, instrument errors included."""
    errors: InstrumentErrors
    """Errors of the instrument."""
    entropy: int
    """Seed of the random errors."""

    @classmethod
    def of(cls, setup: Setup, rng: np.random.Generator | int) -> Chain | None:
        """Return the signal chain of a setup; None for a survey without errors."""
        errors = setup.survey.instrument.errors
        if errors is None:
            return None
        generator = np.random.default_rng(rng).spawn(1)[0]
        return cls(setup=setup, errors=errors, entropy=int(generator.integers(2**63)))

    @property
    def survey(self) -> Survey:
        """Survey with the instrument errors."""
        return self.setup.survey

    @property
    def frequencies(self) -> Floats:
        """True modulation frequencies [Hz]."""
        nominal = np.array(self.survey.instrument.modulation_frequencies)
        clock = self.errors.clock
        return nominal if clock is None else nominal * (1 + clock.frequency_error)

    @property
    def light_setup(self) -> Setup:
        """Setup at all frequencies that affect the outputs, including harmonics."""
        if self.errors.clock is None and self.errors.harmonic is None:
            return self.setup
        frequencies = {
            "instrument.modulation_frequencies": self._light_frequencies.tolist()
        }
        return replace(self.setup, survey=self.survey.with_(frequencies))

    @property
    def _light_frequencies(self) -> Floats:
        harmonic = self.errors.harmonic
        frequencies = self.frequencies
        if harmonic is None:
            return frequencies
        return np.unique(np.concatenate([frequencies, harmonic.order * frequencies]))

    def fundamental(self, light: Light) -> Light:
        """Return the light at the modulation frequencies, without harmonics."""
        return self._at(light, self.frequencies)

    def _at(self, light: Light, frequency: Floats) -> Light:
        chosen = np.searchsorted(self._light_frequencies, frequency)
        variance = light.variance
        return Light(
            light.modulated[chosen],
            light.mean[chosen],
            variance if np.ndim(variance) == 0 else np.asarray(variance)[chosen],
        )

    def pointed(self, directions: Directions) -> Directions:
        """Return the true beam directions for recorded directions."""
        pointing = self.errors.pointing
        if pointing is None:
            return directions
        azimuth, elevation, time = directions
        rows, scan = self._rows(time), self.survey.scan
        noise = pointing.jitter * self._normal(_POINTING, rows, (2, scan.columns))
        backward = (rows % 2 == 1) & (scan.order == "serpentine")
        lag = np.where(backward, -0.5, 0.5)[:, None] * pointing.backlash
        return azimuth + noise[0] + lag, elevation + noise[1], time

    def shots(self, azimuth: Floats, elevation: Floats) -> tuple[Floats, Floats]:
        """Return the directions of open-water references, in rounds if errors drift.

        With drift, the shots run in rounds over all directions: half of the rounds
        before the scan, half after it.
        """
        plan = self.survey.scan.open_water
        if plan is None or not self._drifts:
            return azimuth, elevation
        order = np.arange(azimuth.size).reshape(-1, plan.repeats).T.ravel()
        return azimuth[order], elevation[order]

    @property
    def _drifts(self) -> bool:
        crosstalk, noise = self.errors.crosstalk, self.errors.noise
        return (
            self.errors.drift is not None
            or (crosstalk is not None and crosstalk.change != 0)
            or (noise is not None and noise.pink > 0)
        )

    def scan_samples(
        self,
        target: Light,
        water: Light,
        time: Floats,
        *,
        azimuth: Floats,
        rng: lock_in.Noise,
    ) -> lock_in.Samples:
        """Draw lock-in samples of scan rows for given start times of the pixels."""
        rows = self._rows(time)
        bubbles = [
            self._bubbles(
                [_BUBBLES, int(row)],
                Light(water.modulated[:, :, k], water.mean[:, :, k]),
                part="scan",
            )
            for k, row in enumerate(rows)
        ]
        target, water = self._behind_plume(target, water, azimuth)
        water = water + Light(
            np.stack([light.modulated for light in bubbles], axis=2),
            np.stack([light.mean for light in bubbles], axis=2),
        )
        shape = (2, *self._plane, self.survey.scan.columns)
        return self._samples(
            target,
            water,
            time=self.scan_start + time,
            part="scan",
            # (2, frequency, channel, row, column)
            white=lambda: self._normal(_WHITE, rows, shape, axis=3),
            rng=rng,
        )

    def shot_samples(self, water: Light, *, rng: lock_in.Noise) -> lock_in.Samples:
        """Draw lock-in samples of open-water references, in the order of recording."""
        count = water.mean.shape[-1]
        generator = np.random.default_rng([self.entropy, _WHITE_SHOTS])
        water = water + self._bubbles([_BUBBLES_SHOTS], water, part="open_water")
        return self._samples(
            Light(np.zeros_like(water.modulated), np.zeros_like(water.mean)),
            water,
            time=self.shot_times,
            part="open_water",
            white=lambda: generator.standard_normal((2, *self._plane, count)),
            rng=rng,
        )

    def reference_samples(self, signal: Complex, time: Floats) -> Complex:
        """Return lock-in outputs at given times for a standing-reference signal."""
        drift, course = self.errors.drift, self._course(time)
        if drift is not None:
            power = (1 + drift.power * course) * (1 + drift.modulation_depth * course)
            signal = signal * power
        generator = np.random.default_rng([self.entropy, _WHITE_REFERENCE])
        received = self._received(signal, time, part="scan")
        return self._demodulated(
            received, time, lambda: generator.standard_normal((2, *signal.shape))
        )

    @property
    def scan_start(self) -> float:
        """Start time of the scan after the first open-water references [s]."""
        return self._step * self._shots_before

    @property
    def shot_times(self) -> Floats:
        """Times of the open-water references, in the order of recording [s]."""
        scan = self.survey.scan
        plan = scan.open_water
        count = 0 if plan is None else plan.rows * plan.columns * plan.repeats
        place = np.arange(count)
        after = place >= self._shots_before
        place = np.where(after, place + scan.rows * scan.columns, place)
        return np.asarray(self._step * place, dtype=float)

    @property
    def _plane(self) -> tuple[int, int]:
        instrument = self.survey.instrument
        return len(instrument.modulation_frequencies), len(instrument.polarizations)

    @property
    def _step(self) -> float:
        """Duration of all samples of a pixel [s]."""
        return self.survey.scan.dwell * readings_in_turn(self.survey)

    @property
    def _shots_before(self) -> int:
        plan = self.survey.scan.open_water
        if plan is None:
            return 0
        rounds = (plan.repeats + 1) // 2 if self._drifts else plan.repeats
        return plan.rows * plan.columns * rounds

    @property
    def _duration(self) -> float:
        """Time between the first and the last sample [s]."""
        scan = self.survey.scan
        plan = scan.open_water
        shots = 0 if plan is None else plan.rows * plan.columns * plan.repeats
        return self._step * max(scan.rows * scan.columns + shots - 1, 1)

    def _rows(self, time: Floats) -> NDArray[np.intp]:
        """Return row numbers for given start times of the pixels."""
        row = time.min(axis=-1) / (self._step * self.survey.scan.columns)
        return np.asarray(np.rint(row).astype(np.intp))

    def _normal(
        self,
        purpose: int,
        rows: NDArray[np.intp],
        shape: tuple[int, ...],
        *,
        axis: int = 1,
    ) -> Floats:
        """Return reproducible normal deviates of each row, stacked along an axis."""
        generators = [
            np.random.default_rng([self.entropy, purpose, int(row)]) for row in rows
        ]
        return np.stack(
            [generator.standard_normal(shape) for generator in generators], axis=axis
        )

    def _course(self, time: Floats) -> Floats:
        """Return the drift at given times as a fraction of the total drift [1]."""
        drift = self.errors.drift
        settling = None if drift is None else drift.settling_time
        if settling is None:
            return time / self._duration
        total = np.expm1(-self._duration / settling)
        return np.asarray(np.expm1(-time / settling) / total)

    def _samples(
        self, target: Light, water: Light, *, time: Floats, part: Part, white: _Draw,
        rng: lock_in.Noise,
    ) -> lock_in.Samples:  # fmt: skip
        errors = self.errors
        course = self._course(time)
        drift = errors.drift
        if drift is not None:
            power = 1 + drift.power * course
            depth = 1 + drift.modulation_depth * course
            target, water = (
                _scaled(light, modulated=power * depth, mean=power)
                for light in (target, water)
            )
        samples = lock_in.sample(
            self.setup,
            self.fundamental(target),
            self.fundamental(water),
            rng=rng,
            detect=partial(self._detected, part=part),
        )
        signal = samples.signal
        if errors.harmonic is not None:
            order = errors.harmonic.order
            light = self._at(target + water, order * self.frequencies)
            overtone = lock_in.expected_signal(self.setup, light)
            if order in _CONJUGATE:
                overtone = overtone.conj()
            signal = signal + errors.harmonic.fraction * overtone
        signal = self._received(signal, time, part=part)
        return replace(samples, signal=self._demodulated(signal, time, white))

    def _behind_plume(
        self, target: Light, water: Light, azimuth: Floats
    ) -> tuple[Light, Light]:
        """Return the light of target and water with a plume across the scan.

        The plume weakens the echo. Most light of the water comes from in front of it.
        """
        plume = self.errors.plume
        if plume is None:
            return target, water
        profile = np.ones(azimuth.shape)
        if plume.width is not None:
            profile = np.exp(-(((azimuth - plume.azimuth) / plume.width) ** 2) / 2)
        passed = np.exp(-2 * plume.optical_thickness * profile)
        mean = plume.fraction * profile * water.mean
        added = Light(mean * self._turn(plume.distance, mean.ndim), mean)
        return _scaled(target, modulated=passed, mean=passed), water + added

    def _bubbles(self, key: list[int], water: Light, *, part: Part) -> Light:
        """Return the light of bubbles in samples of a row or of the references [1]."""
        bubbles = self.errors.bubbles
        modulated = np.zeros(water.mean.shape, dtype=complex)
        mean = np.zeros(water.mean.shape)
        if bubbles is None or not _has(bubbles, part):
            return Light(modulated, mean)
        generator = np.random.default_rng([self.entropy, *key])
        count = generator.poisson(bubbles.number, mean.shape)
        for number in range(int(count.max())):
            distance = generator.uniform(bubbles.nearest, bubbles.farthest, mean.shape)
            light = bubbles.fraction * (bubbles.nearest / distance) ** 2 * water.mean
            light = np.where(count > number, light, 0.0)
            mean += light
            modulated += light * self._turn(distance, mean.ndim)
        return Light(modulated, mean)

    def _turn(self, distance: Floats | float, axes: int) -> Complex:
        """Return the phase factor of light from a distance, (frequency, ...) [1]."""
        frequency = self._light_frequencies.reshape(-1, *[1] * (axes - 1))
        index = water_properties(self.survey).group_index
        turns = 2 * frequency * index * distance / speed_of_light
        return np.asarray(np.exp(2j * np.pi * turns))

    def _detected(self, light: Light, *, part: Part) -> Light:
        """Return the detected light, with leakage, dead time and after-pulses."""
        leakage, counter = self.errors.optical_leakage, self.errors.counting
        axes = [1] * (light.mean.ndim - 2)
        turn = 2j * np.pi * self.frequencies.reshape(-1, 1, *axes)
        if leakage is not None and _has(leakage, part):
            leak = leakage.fraction * self._passed(leakage).reshape(1, -1, *axes)
            light = light + Light(
                leak * np.exp(turn * leakage.delay) + np.zeros(light.mean.shape),
                leak + np.zeros(light.mean.shape),
            )
        if counter is None:
            return light
        rate = self.setup.full_rate * light.mean
        rate += self.survey.instrument.detector.dark_rate
        rate += self.setup.daylight_rate.reshape(-1, *axes)
        live = 1 / (1 + rate * counter.dead_time)
        late = counter.after_pulse_probability
        after = 1 + late / (1 - turn * counter.after_pulse_delay)
        return _scaled(light, modulated=live**2 * after, mean=live * (1 + late))

    def _passed(self, leakage: OpticalLeakage) -> Floats:
        """Return the fraction of leakage light that passes each analyzer [1]."""
        polarized = 1 - leakage.depolarization
        state = matrix((polarized, polarized, polarized))
        return np.array(
            [
                float(mueller.detected_fraction(state, pair=pair))
                for pair in self.survey.instrument.polarizations
            ]
        )

    def _received(self, signal: Complex, time: Floats, *, part: Part) -> Complex:
        """Return the signal after amplifiers and cables, at the demodulator."""
        errors, axes = self.errors, [1] * (signal.ndim - 2)
        turn = 2j * np.pi * self.frequencies.reshape(-1, 1, *axes)
        if errors.compression is not None:
            compression = errors.compression
            loss = compression.fraction * np.abs(signal) / compression.amplitude
            signal = signal * np.maximum(1 - loss, 0)
        if errors.walk is not None:
            size = np.where(signal == 0, errors.walk.amplitude, np.abs(signal))
            decades = np.log10(size / errors.walk.amplitude)
            signal = signal * np.exp(1j * errors.walk.phase_per_decade * decades)
        if errors.reflection is not None:
            reflection = np.exp(turn * errors.reflection.delay)
            signal = signal * (1 + errors.reflection.coefficient * reflection)
        if errors.crosstalk is not None and _has(errors.crosstalk, part):
            stray = errors.crosstalk
            size = np.broadcast_to(stray.amplitude, len(self.frequencies))
            size = size.reshape(-1, 1, *axes) * (
                1 + stray.change * time / self._duration
            )
            signal = signal + size * np.exp(1j * stray.phase + turn * stray.delay)
        if errors.drift is not None:
            phase = 1j * errors.drift.phase + turn * errors.drift.delay
            signal = signal * np.exp(phase * self._course(time))
        if errors.temperature is not None:
            warm = errors.temperature
            phase = 1j * warm.phase_per_degree + turn * warm.delay_per_degree
            signal = signal * np.exp(phase * (warm.temperature - warm.reference))
        return signal

    def _demodulated(self, signal: Complex, time: Floats, white: _Draw) -> Complex:
        """Return the demodulator's outputs with their errors and noise, complex [V]."""
        scale, outputs = self.errors.scale_change, self.errors.demodulator
        noise = self.errors.noise
        if scale is not None:
            factor = (1 + scale.gain) * np.exp(1j * scale.phase)
            signal = np.where(np.abs(signal) > scale.above, factor * signal, signal)
        if outputs is not None:
            angle = outputs.quadrature_phase
            quadrature = signal.imag * np.cos(angle) + signal.real * np.sin(angle)
            signal = (
                signal.real
                + outputs.in_phase_offset
                + 1j * (1 + outputs.quadrature_gain) * quadrature
                + 1j * outputs.quadrature_offset
            )
        if noise is not None:
            noises = noise.white * white() + noise.pink * self._pink(time)
            signal = signal + noises[0] + 1j * noises[1]
        if outputs is not None and outputs.resolution > 0:
            step = outputs.resolution
            signal = step * (
                np.rint(signal.real / step) + 1j * np.rint(signal.imag / step)
            )
        return signal

    def _pink(self, time: Floats) -> Floats:
        """Return pink noise of variance 1 at given times, for both quadratures.

        A sum of tones of equal power whose frequencies are even in the logarithm.
        """
        generator = np.random.default_rng([self.entropy, _PINK])
        shape = (2, *self._plane, _TONES)
        lowest, highest = 1 / self._duration, 1 / (2 * self._step)
        share = (np.arange(_TONES) + generator.random(shape)) / _TONES
        tone = lowest * max(highest / lowest, 1.0) ** share
        start = 2 * np.pi * generator.random(shape)
        axes = [1] * time.ndim
        total = np.zeros((*shape[:-1], *time.shape))
        for k in range(_TONES):
            phase = 2 * np.pi * tone[..., k].reshape(*shape[:-1], *axes) * time
            total += np.cos(phase + start[..., k].reshape(*shape[:-1], *axes))
        return np.asarray(total * np.sqrt(2 / _TONES))


def _has(error: Bubbles | Crosstalk | OpticalLeakage, part: Part) -> bool:
    return error.part in ("all", part)


def _scaled(light: Light, *, modulated: Floats | Complex, mean: Floats) -> Light:
    is_exact = np.ndim(light.variance) == 0
    return Light(
        light.modulated * modulated,
        light.mean * mean,
        light.variance if is_exact else light.variance * np.abs(modulated) ** 2,
    )
