"""Scenes with one instrument error, added to simulated samples.

The effects are written here in their simplest form, on lock-in outputs, and share no
code with the `[instrument.errors]` of the simulation: each judges the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

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
    """Simulated samples and open-water shots, without the scene's instrument errors."""

    def __init__(self, count: int, seed: int) -> None:
        self.count, self.seed = count, seed
        self.survey = survey(count, _TARGET)
        cube = simulate(self.survey, rng=seed)
        # Half of the repeats in each direction are recorded after the scan.
        repeats = self.survey.scan.open_water.repeats  # type: ignore[union-attr]
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


#: Outputs of scan, shape (frequency, channel, row, column), and shots, (frequency,
#: channel, shot), with an effect in them [V].
Effect = Callable[[Recorded], tuple[Complex, Complex]]


def nothing(recorded: Recorded) -> tuple[Complex, Complex]:
    """Return scan and shots unchanged, as recorded by a perfect instrument."""
    return recorded.scan, recorded.shots


def leakage(size: float, *, delay: float | None = None) -> Effect:
    """Return a function that adds electrical leakage, equal in both channels.

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
    """Return a function that adds a phase error per decade of amplitude [degrees]."""

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
    """Return a function that adds a phase step above the median amplitude [degrees]."""

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


def with_effect(
    count: int, seed: int, *, effect: Effect, calibrated: bool = True
) -> Case:
    """Simulate a tilted plate at 2.6 m, with an instrument error in its samples."""
    recorded = Recorded(count, seed)
    scan, shots = effect(recorded)
    case = case_of(
        _with(_with(recorded.cube, scan), shots, _SHOTS), interval=around(_DISTANCE)
    )
    believed = case.samples.amulor.survey
    # The user does not know how good the instrument is.
    instrument = believed.instrument.model_copy(update={"phase_uncertainty": None})
    believed = believed.model_copy(update={"instrument": instrument})
    if calibrated:
        believed = believed.with_({"calibration": CALIBRATION})
    return replace(case, samples=case.samples.assign_attrs(survey=believed.to_toml()))


def _outputs(cube: xr.Dataset, prefix: str = "") -> Complex:
    signal: Complex = (
        cube[f"{prefix}in_phase"].values + 1j * cube[f"{prefix}quadrature"].values
    )
    return signal


def _with(cube: xr.Dataset, signal: Complex, prefix: str = "") -> xr.Dataset:
    """Return a cube with replaced lock-in outputs and unchanged stated errors."""
    parts = {"in_phase": signal.real, "quadrature": signal.imag}
    return cube.assign(
        {
            f"{prefix}{name}": cube[f"{prefix}{name}"].copy(data=values)
            for name, values in parts.items()
        }
    )
