"""Scenes with one instrument error, added to simulated samples.

The effects are written here in their simplest form, on lock-in outputs, and share no
code with the `[instrument.errors]` of the simulation: each judges the other.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.simulation import simulate
from amulor.studies.trust.case import Case, Floats, case_of
from amulor.studies.trust.scenes.models import around
from amulor.studies.trust.surveys import FREQUENCIES, plate, survey

Complex = NDArray[np.complex128]

#: What a careful user states of the instrument: 1.26 mm that all pixels share.
CALIBRATION = {
    "delay_uncertainty": "0.01 ns",
    "receiver_position_uncertainty": "1 mm",
    "direction_uncertainty": "0.05 deg",
    "group_index_uncertainty": 2e-4,
}
_DISTANCE, _LEAN = 2.6, 20.0
_TARGET = plate(_DISTANCE, lean=_LEAN)
_SHOTS = "open_water_"


class Recorded:
    """Simulated samples and open-water references, without instrument errors."""

    def __init__(
        self, count: int, seed: int, *, cube: xr.Dataset | None = None
    ) -> None:
        self.count, self.seed = count, seed
        if cube is None:
            cube = simulate(survey(count, _TARGET), rng=seed)
        self.survey = cube.amulor.survey
        # Half of the repeats in each direction are recorded after the scan.
        repeats = self.survey.scan.open_water.repeats
        order = np.arange(cube.sizes["shot"]).reshape(-1, repeats)
        first, second = order[:, : repeats // 2].ravel(), order[:, repeats // 2 :]
        self.cube = cube.isel(shot=np.concatenate([first, second.ravel()]))
        self.late_shots = np.repeat([0.0, 1.0], [first.size, second.size])
        pixels = cube.sizes["row"] * cube.sizes["column"]
        self.scan_time = np.linspace(0, 1, pixels).reshape(cube.sizes["row"], -1)
        self.frequency = cube["modulation_frequency"].values
        self.scan = _outputs(self.cube)
        self.shots = _outputs(self.cube, _SHOTS)

    def truth(self, which: str) -> Complex:
        """Return the noiseless signal of target or water in the scan [V]."""
        return _outputs(self.cube, f"truth_{which}_")

    @property
    def echo(self) -> Floats:
        """Median target amplitude in the first channel, shape (frequency, 1) [V]."""
        size: Floats = np.median(np.abs(self.truth("target")[:, :1]), axis=(2, 3))
        return size


#: Cases of a table differ by their effect only.
_recorded = lru_cache(maxsize=1)(Recorded)

#: Outputs of scan, shape (frequency, channel, row, column), and shots, (frequency,
#: channel, shot), with an effect in them [V].
Effect = Callable[[Recorded], tuple[Complex, Complex]]


def nothing(recorded: Recorded) -> tuple[Complex, Complex]:
    """Return scan and open-water references unchanged, as for a perfect instrument."""
    return recorded.scan, recorded.shots


def leakage(size: float, *, delay: float | None = None) -> Effect:
    """Return a function that adds leakage to the scan; to references only with `delay`.

    Its size is a fraction of the median echo of the first channel.
    Without a delay it has one phase, 0.13 of a turn, and only the scan has it; with a
    delay [s] the shots have it, too.
    """

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        turns = 0.13 if delay is None else recorded.frequency[:, None] * delay
        leak = size * recorded.echo * np.exp(2j * np.pi * np.asarray(turns))
        shots = recorded.shots if delay is None else recorded.shots + leak[:, :, None]
        return recorded.scan + leak[:, :, None, None], shots

    return effect


def walk(degrees: float) -> Effect:
    """Return a function that adds a phase error [degrees] per decade of amplitude."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        def walked(signal: Complex) -> Complex:
            axes = [1] * (signal.ndim - 2)
            decades = np.log10(np.abs(signal) / recorded.echo.reshape(-1, 1, *axes))
            return np.asarray(signal * np.exp(1j * np.radians(degrees) * decades))

        return walked(recorded.scan), walked(recorded.shots)

    return effect


def aliased_harmonic(size: float) -> Effect:
    """Return a function that adds the light's third harmonic, aliased to the first."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        triple = tuple(3 * value for value in FREQUENCIES[recorded.count])
        planned = survey(recorded.count, _TARGET, frequencies=triple)
        cube = simulate(planned, rng=recorded.seed)
        light = _outputs(cube, "truth_target_") + _outputs(cube, "truth_water_")
        # Shots of one direction differ by chance only: their mean has no noise.
        repeats = planned.scan.open_water.repeats  # type: ignore[union-attr]
        shots = _outputs(cube, _SHOTS)
        mean = shots.reshape(*shots.shape[:2], -1, repeats).mean(axis=-1)
        half = np.repeat(mean, repeats // 2, axis=-1)
        return (
            recorded.scan + size * light.conj(),
            recorded.shots + size * np.concatenate([half, half], axis=-1).conj(),
        )

    return effect


def turbid_layer(thickness: float, *, factor: float = 2.0) -> Effect:
    """Return a function that adds a turbid layer of given thickness [m] to the scan."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        near = plate(_DISTANCE - thickness, lean=_LEAN)
        cube = simulate(survey(recorded.count, near), rng=recorded.seed)
        layer = recorded.truth("water") - _outputs(cube, "truth_water_")
        return recorded.scan + (factor - 1) * layer, recorded.shots

    return effect


#: Distances at which slices of water with a gradient begin [m].
_SLICES = (0.4, 0.7, 1.0, 1.4, 1.8, 2.2, 2.6, 3.2, 4.0, 6.0)


@lru_cache(maxsize=1)
def _columns(count: int, seed: int) -> tuple[Complex, ...]:
    """Return the water in front of plates at the limits of the slices [V]."""
    return tuple(
        _outputs(
            simulate(survey(count, plate(end, size=4.0)), rng=seed), "truth_water_"
        )
        for end in _SLICES
    )


def gradient(change: float) -> Effect:
    """Return a function for water whose backscatter changes per meter, by a fraction.

    Scan and references contain the same water. Its attenuation does not change.
    """

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        columns = _columns(recorded.count, recorded.seed)
        slices = np.diff(np.stack([0 * columns[0], *columns]), axis=0)
        middle = np.array(_SLICES) - np.diff([0.0, *_SLICES]) / 2
        more = change * middle.reshape(-1, 1, 1, 1, 1) * slices
        seen = np.array(_SLICES) <= _DISTANCE
        scan = recorded.scan + more[seen].sum(axis=0)
        # References have the same part of more light as the middle of the scan.
        part = (more.sum(axis=0) / columns[-1]).mean(axis=(2, 3))
        mean = recorded.shots.mean(axis=-1)
        return scan, recorded.shots + (part * mean)[..., None]

    return effect


def drift(*, degrees: float = 0.0, delay: float = 0.0) -> Effect:
    """Return a function that adds a linear drift of phase [degrees] or delay [s]."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        phase = np.radians(degrees) + 2 * np.pi * recorded.frequency * delay
        turn = phase[:, None, None, None] * recorded.scan_time
        late = phase[:, None, None] * recorded.late_shots
        return recorded.scan * np.exp(1j * turn), recorded.shots * np.exp(1j * late)

    return effect


def compression(fraction: float) -> Effect:
    """Return a function that reduces the gain by a fraction at the median amplitude."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        def pressed(signal: Complex) -> Complex:
            axes = [1] * (signal.ndim - 2)
            size = np.abs(signal) / recorded.echo.reshape(-1, 1, *axes)
            return np.asarray(signal * (1 - fraction * size))

        return pressed(recorded.scan), pressed(recorded.shots)

    return effect


def scale_change(degrees: float) -> Effect:
    """Return a function that shifts the phase [degrees] above the median amplitude."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        limit = np.median(np.abs(recorded.scan), axis=(2, 3))
        turn = np.exp(1j * np.radians(degrees))
        high = np.abs(recorded.scan) > limit[:, :, None, None]
        shots = np.abs(recorded.shots) > limit[:, :, None]
        return (
            np.where(high, turn, 1) * recorded.scan,
            np.where(shots, turn, 1) * recorded.shots,
        )

    return effect


def window(size: float, *, delay: float = 0.5e-9) -> Effect:
    """Return a function that adds the window's reflection to the first channel."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        turns = recorded.frequency[:, None] * delay
        light = size * recorded.echo * np.exp(2j * np.pi * turns)
        scan, shots = recorded.scan.copy(), recorded.shots.copy()
        scan[:, 0] += light[:, :, None]
        shots[:, 0] += light
        return scan, shots

    return effect


def offset(size: float) -> Effect:
    """Return a function that adds a fraction of the echo to the in-phase output."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        added = size * recorded.echo[:, :, None]
        return recorded.scan + added[..., None], recorded.shots + added

    return effect


def growing_leakage(size: float) -> Effect:
    """Return a function that adds leakage, growing from zero during the scan."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        leak = size * recorded.echo * np.exp(2j * np.pi * 0.13)
        scan = recorded.scan + leak[:, :, None, None] * recorded.scan_time
        return scan, recorded.shots + leak[:, :, None] * recorded.late_shots

    return effect


def turned(factor: Callable[[Floats], Complex], *, channels: slice) -> Effect:
    """Return a function that multiplies channels by a frequency-dependent gain."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        gain = factor(recorded.frequency)
        scan, shots = recorded.scan.copy(), recorded.shots.copy()
        scan[:, channels] *= gain[:, None, None, None]
        shots[:, channels] *= gain[:, None, None]
        return scan, shots

    return effect


def reflection(size: float, *, delay: float = 10e-9) -> Effect:
    """Return a function that adds a cable reflection of the signal."""
    return turned(
        lambda frequency: 1 + size * np.exp(2j * np.pi * frequency * delay),
        channels=slice(None),
    )


def _ripple(frequency: Floats) -> Floats:
    """Return a pattern over frequency, with a mean square of about 1."""
    return np.resize([1.0, -1.2, 0.7, -0.9, 1.1], frequency.size)


def gain_ripple(size: float) -> Effect:
    """Return a function that adds a gain ripple over frequency."""
    return turned(
        lambda frequency: (1 + size * _ripple(frequency)).astype(complex),
        channels=slice(None),
    )


def phase_ripple(degrees: float) -> Effect:
    """Return a function that adds a phase ripple over frequency."""
    return turned(
        lambda frequency: np.exp(1j * np.radians(degrees) * _ripple(frequency)),
        channels=slice(None),
    )


def channel_delay(delay: float) -> Effect:
    """Return a function that delays the second channel [s]."""
    return turned(
        lambda frequency: np.exp(2j * np.pi * frequency * delay), channels=slice(1, 2)
    )


def power_loss(fraction: float) -> Effect:
    """Return a function that reduces the power after the open-water references."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        return (1 - fraction) * recorded.scan, recorded.shots

    return effect


def quadrature(*, gain: float = 0.0, degrees: float = 0.0) -> Effect:
    """Return a function that changes gain and angle of the quadrature output."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        angle = np.radians(degrees)

        def output(signal: Complex) -> Complex:
            turned = np.cos(angle) * signal.imag + np.sin(angle) * signal.real
            return np.asarray(signal.real + 1j * (1 + gain) * turned)

        return output(recorded.scan), output(recorded.shots)

    return effect


def excess_noise(size: float) -> Effect:
    """Return a function that adds white noise, as a multiple of the stated noise."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        rng = np.random.default_rng(recorded.seed + 1000)

        def noisy(signal: Complex, prefix: str = "") -> Complex:
            sigma = recorded.cube[f"{prefix}in_phase_uncertainty"].values
            normal = rng.normal(size=(2, *signal.shape))
            return np.asarray(signal + size * sigma * (normal[0] + 1j * normal[1]))

        return noisy(recorded.scan), noisy(recorded.shots, _SHOTS)

    return effect


def resolution(size: float) -> Effect:
    """Return a function that rounds outputs to steps of a fraction of the echo."""

    def effect(recorded: Recorded) -> tuple[Complex, Complex]:
        def rounded(signal: Complex) -> Complex:
            step = size * recorded.echo.reshape(-1, *[1] * (signal.ndim - 1))
            counted = np.round(signal.real / step) + 1j * np.round(signal.imag / step)
            return np.asarray(step * counted)

        return rounded(recorded.scan), rounded(recorded.shots)

    return effect


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Kind of instrument error, with its typical size and its cause in words."""

    title: str
    """Description of the error at its typical size."""
    of_size: Callable[[float], Effect]
    """Function that returns the effect for a multiple of the typical size."""
    causes: tuple[str, ...] = ()
    """Words that identify a correct suggestion of the cause; any of them suffices."""
    is_phase: bool = True
    """Whether a phase calibration reveals the error."""
    remaining: float = 1.0
    """Fraction that remains after the correction by a calibration [1]."""
    demodulator: Literal["analog"] | None = None
    """Kind of demodulator in the survey; None for a digital one, which cannot have the
    error of the others."""


#: Part of an error that remains after a calibration corrects it [1].
_REST = 0.1

#: Kinds of instrument errors by name; "perfect" has none.
KINDS: dict[str, Kind] = {
    "perfect": Kind(title="no error", of_size=lambda _: nothing, is_phase=False),
    "leakage, scan": Kind(
        title="leakage of 1 % of the echo, in the scan only",
        of_size=lambda size: leakage(0.01 * size),
        remaining=_REST,
        causes=("leakage",),
    ),
    "leakage, delay": Kind(
        title="leakage of 1 % of the echo, 2 ns late, in scan and references",
        of_size=lambda size: leakage(0.01 * size, delay=2e-9),
        remaining=_REST,
        causes=("leakage",),
    ),
    "leakage, growing": Kind(
        title="leakage that grows from 0 to 1 % of the echo",
        of_size=lambda size: growing_leakage(0.01 * size),
        remaining=_REST,
        causes=("leakage", "drift"),
    ),
    "window": Kind(
        title="light of a window, 1 % of the echo, in one channel",
        of_size=lambda size: window(0.01 * size),
        causes=("leakage",),
    ),
    "offset": Kind(
        title="offset of the in-phase output, 0.5 % of the echo",
        of_size=lambda size: offset(0.005 * size),
        remaining=_REST,
        causes=("leakage", "offset"),
    ),
    "walk": Kind(
        title="phase that depends on the amplitude, 2 degrees for a factor of 10",
        of_size=lambda size: walk(2.0 * size),
        remaining=_REST,
        causes=("depends on the amplitude",),
    ),
    "harmonic": Kind(
        title="third harmonic of the light, 1 %",
        of_size=lambda size: aliased_harmonic(0.01 * size),
        causes=("harmonic",),
    ),
    "layer": Kind(
        title="water twice as strong in the last 0.4 m, in the scan only",
        of_size=lambda size: turbid_layer(0.4, factor=1 + size),
        causes=("other water",),
        is_phase=False,
    ),
    "gradient": Kind(
        title="backscatter of the water 10 % larger with each meter",
        of_size=lambda size: gradient(0.1 * size),
        causes=("other water", "changes with the distance"),
        is_phase=False,
    ),
    "phase drift": Kind(
        title="drift of the phase by 1 degree",
        of_size=lambda size: drift(degrees=size),
        causes=("drift",),
    ),
    "delay drift": Kind(
        title="drift of the delay by 30 ps",
        of_size=lambda size: drift(delay=30e-12 * size),
        causes=("drift",),
    ),
    "compression": Kind(
        title="gain 5 % lower at the amplitude of the echo",
        of_size=lambda size: compression(0.05 * size),
        causes=("depends on the amplitude",),
    ),
    "scale change": Kind(
        title="phase 0.5 degrees larger above the median amplitude",
        of_size=lambda size: scale_change(0.5 * size),
        causes=("depends on the amplitude",),
    ),
    "cable": Kind(
        title="reflection of 1 % in a cable of 1 m",
        of_size=lambda size: reflection(0.01 * size),
        remaining=_REST,
        causes=("cable",),
    ),
    "gain ripple": Kind(
        title="gain that differs by 3 % between the frequencies",
        of_size=lambda size: gain_ripple(0.03 * size),
        causes=("gain",),
        is_phase=False,
    ),
    "phase ripple": Kind(
        title="phase that differs by 0.3 degrees between the frequencies",
        of_size=lambda size: phase_ripple(0.3 * size),
        remaining=_REST,
        causes=("cable",),
    ),
    "channel delay": Kind(
        title="second channel 10 ps late",
        of_size=lambda size: channel_delay(10e-12 * size),
        remaining=_REST,
        causes=("delay between the channels",),
    ),
    "power loss": Kind(
        title="power 2 % lower after the references",
        of_size=lambda size: power_loss(0.02 * size),
        causes=("power",),
        is_phase=False,
    ),
    "quadrature gain": Kind(
        title="quadrature output 1 % too large",
        of_size=lambda size: quadrature(gain=0.01 * size),
        remaining=_REST,
        demodulator="analog",
        causes=("demodulator",),
    ),
    "quadrature angle": Kind(
        title="quadrature output turned by 1 degree",
        of_size=lambda size: quadrature(degrees=size),
        remaining=_REST,
        demodulator="analog",
        causes=("demodulator",),
    ),
    "noise": Kind(
        title="additional noise, 0.3 times the stated noise",
        of_size=lambda size: excess_noise(0.3 * size),
        causes=("noise",),
        is_phase=False,
    ),
    "resolution": Kind(
        title="outputs rounded to 0.3 % of the echo",
        of_size=lambda size: resolution(0.003 * size),
        causes=("resolution", "noise"),
        is_phase=False,
    ),
}

#: Statements of the survey: no calibration, the right phase error, a third of it.
STATES = ("uncalibrated", "calibrated", "wrong")
#: Least phase uncertainty that a calibration states [rad], and the largest of a survey.
_LEAST_PHASE, _LARGEST_PHASE = np.radians(0.05), 0.5
_WRONG = 1 / 3


#: Phases of a plate at different distances, which a calibration averages.
_PHASES = 8


def phase_error(recorded: Recorded, effect: Effect) -> float:
    """Return the rms phase error of the echo in the first channel [rad].

    Pixels and frequencies count alike. The larger of two errors: of a plate in clear
    water at several distances, and of the scan after subtraction of the references.
    """
    echo = recorded.truth("target")
    bench = []
    for phase in 2 * np.pi * np.arange(_PHASES) / _PHASES:
        plate = copy(recorded)
        plate.scan = echo * np.exp(1j * phase)
        bench.append(np.angle(effect(plate)[0] / plate.scan)[:, 0])
    scan, shots = effect(recorded)
    water = (shots - recorded.shots)[:, 0].mean(axis=-1)
    added = (scan - recorded.scan)[:, 0] - water[:, None, None]
    subtracted = np.angle(1 + added / echo[:, 0])
    return max(float(np.sqrt(np.mean(np.square(e)))) for e in (bench, subtracted))


def with_effect(
    count: int,
    seed: int,
    *,
    effect: Effect,
    calibrated: bool = True,
    phase_uncertainty: float | None = None,
) -> Case:
    """Simulate a tilted plate at 2.6 m, with an instrument error in its samples."""
    recorded = Recorded(count, seed)
    return _case(
        recorded,
        *effect(recorded),
        calibrated=calibrated,
        phase_uncertainty=phase_uncertainty,
    )


def case(kind: str, size: float, count: int, state: str, seed: int) -> Case:
    """Simulate an instrument error, with a correct, a wrong or no calibration."""
    recorded, effect = _recorded(count, seed), KINDS[kind]
    if state == "uncalibrated":
        return _case(
            recorded,
            *effect.of_size(size)(recorded),
            calibrated=False,
            demodulator=effect.demodulator,
        )
    share = 1.0 if state == "calibrated" else _WRONG
    # A wrong calibration leaves more than it states.
    rest = min(1.0, effect.remaining / share)
    left = effect.of_size(rest * size)
    error = phase_error(recorded, left) if effect.is_phase else 0.0
    stated = min(float(np.hypot(share * error, _LEAST_PHASE)), _LARGEST_PHASE)
    return _case(recorded, *left(recorded), phase_uncertainty=stated)


def _case(
    recorded: Recorded,
    scan: Complex,
    shots: Complex,
    *,
    calibrated: bool = True,
    phase_uncertainty: float | None = None,
    demodulator: Literal["analog"] | None = None,
) -> Case:
    case = case_of(with_outputs(recorded.cube, scan, shots), interval=around(_DISTANCE))
    believed = case.samples.amulor.survey
    instrument = believed.instrument.model_copy(
        update={
            "phase_uncertainty": phase_uncertainty,
            "lock_in": believed.instrument.lock_in.model_copy(
                update={"demodulator": demodulator}
            ),
        }
    )
    believed = believed.model_copy(update={"instrument": instrument})
    if calibrated:
        believed = believed.with_({"calibration": CALIBRATION})
    return replace(case, samples=case.samples.assign_attrs(survey=believed.to_toml()))


def _outputs(cube: xr.Dataset, prefix: str = "") -> Complex:
    signal: Complex = (
        cube[f"{prefix}in_phase"].values + 1j * cube[f"{prefix}quadrature"].values
    )
    return signal


def with_outputs(cube: xr.Dataset, scan: Complex, shots: Complex) -> xr.Dataset:
    """Return a cube with replaced lock-in outputs of scan and references."""
    return _with(_with(cube, scan), shots, _SHOTS)


def _with(cube: xr.Dataset, signal: Complex, prefix: str = "") -> xr.Dataset:
    """Return a cube with replaced lock-in outputs and unchanged stated errors."""
    parts = {"in_phase": signal.real, "quadrature": signal.imag}
    return cube.assign(
        {
            f"{prefix}{name}": cube[f"{prefix}{name}"].copy(data=values)
            for name, values in parts.items()
        }
    )
