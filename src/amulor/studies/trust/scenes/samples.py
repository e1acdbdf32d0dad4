"""Scenes with disturbed samples: particles, spikes, mixed pixels, noise, drift."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.simulation import simulate
from amulor.studies.trust.case import Case, case_of
from amulor.studies.trust.scenes.models import around
from amulor.studies.trust.surveys import plate, survey

Complex = NDArray[np.complex128]

_TARGET = plate(2.6, lean=20)


def _measured(samples: xr.Dataset, prefix: str = "") -> Complex:
    signal: Complex = (
        samples[f"{prefix}in_phase"].values + 1j * samples[f"{prefix}quadrature"].values
    )
    return signal


def _with(samples: xr.Dataset, signal: Complex, prefix: str = "") -> xr.Dataset:
    """Return samples with replaced lock-in outputs and unchanged stated errors."""
    return samples.assign(
        {
            f"{prefix}in_phase": samples[f"{prefix}in_phase"].copy(data=signal.real),
            f"{prefix}quadrature": samples[f"{prefix}quadrature"].copy(
                data=signal.imag
            ),
        }
    )


def _true(samples: xr.Dataset, which: str) -> Complex:
    return _measured(samples, f"truth_{which}_")


def spikes(count: int, seed: int) -> Case:
    """Simulate a plate, and add spikes of 5 to 50 standard errors to some samples."""
    samples = simulate(survey(count, _TARGET), rng=seed)
    return case_of(with_spikes(samples, seed), interval=around(2.6))


def with_spikes(
    samples: xr.Dataset, seed: int, *, fraction: float = 0.03
) -> xr.Dataset:
    """Return samples with spikes of 5 to 50 standard errors in a fraction of them."""
    rng = np.random.default_rng(seed + 1000)
    signal = _measured(samples)
    hit = rng.random(signal.shape) < fraction
    noise = np.hypot(
        samples["in_phase_uncertainty"].values,
        samples["quadrature_uncertainty"].values,
    )
    size = noise * rng.uniform(5, 50, signal.shape)
    turn = np.exp(2j * np.pi * rng.random(signal.shape))
    return _with(samples, signal + np.where(hit, size * turn, 0))


def particles(count: int, seed: int) -> Case:
    """Simulate a plate, with a bright particle in front in some samples."""
    samples = simulate(survey(count, _TARGET), rng=seed)
    changed = with_particles(samples, seed, nearest=0.8, farthest=2.3)
    return case_of(changed, interval=around(2.6))


def with_particles(
    samples: xr.Dataset,
    seed: int,
    *,
    nearest: float,
    farthest: float,
    fraction: float = 0.04,
) -> xr.Dataset:
    """Return samples with a bright particle in front of the target in some of them.

    A particle is between the two distances [m] and sends back a tenth to half of the
    target's light. It moves on before the next sample, so each frequency and channel
    has other particles.
    """
    rng = np.random.default_rng(seed + 2000)
    signal = _measured(samples)
    echo = np.abs(_true(samples, "target"))
    distance = rng.uniform(nearest, farthest, signal.shape)
    frequency = samples["modulation_frequency"].values[:, None, None, None]
    turn = np.exp(4j * np.pi * frequency * 1.38 * distance / speed_of_light)
    hit = rng.random(signal.shape) < fraction
    add = echo * rng.uniform(0.1, 0.5, signal.shape) * turn
    return _with(samples, signal + np.where(hit, add, 0))


def mixed(count: int, seed: int, *, gap: float) -> Case:
    """Simulate two plates at different distances, with mixed pixels at the edge.

    Two columns see both, with 0.4 and 0.6 of the farther one.
    Only these are judged. Either surface counts as right.
    """
    near = simulate(survey(count, plate(2.4)), rng=seed)
    far = simulate(survey(count, plate(2.4 + gap)), rng=seed)
    columns = near.sizes["column"]
    share = np.zeros(columns)
    middle = columns // 2
    share[middle + 2 :] = 1
    share[middle : middle + 2] = (0.4, 0.6)
    change = sum(_true(far, part) - _true(near, part) for part in ("target", "water"))
    surfaces = np.stack([cube["truth_slant_range"].values for cube in (near, far)])
    surfaces[1, :, share == 0] = np.nan
    surfaces[0, :, share == 1] = np.nan
    judged = np.broadcast_to((share > 0) & (share < 1), surfaces.shape[1:]).copy()
    return case_of(
        _with(near, _measured(near) + share * change),
        interval=around(2.4),
        surfaces=surfaces,
        judged=judged,
    )


def late_instrument(count: int, seed: int, *, delay: float = 1e-10) -> Case:
    """Simulate a plate measured with an unknown instrument delay [s]."""
    samples = simulate(survey(count, _TARGET), rng=seed)
    frequency = samples["modulation_frequency"].values
    turn = np.exp(2j * np.pi * frequency * delay)
    samples = _with(samples, _measured(samples) * turn[:, None, None, None])
    shots = _measured(samples, "open_water_") * turn[:, None, None]
    return case_of(_with(samples, shots, "open_water_"), interval=around(2.6))


def understated_noise(count: int, seed: int, *, factor: float = 2.0) -> Case:
    """Simulate a plate, with all stated errors too small by a factor."""
    samples = simulate(survey(count, _TARGET), rng=seed)
    return case_of(with_understated_noise(samples, factor), interval=around(2.6))


def with_understated_noise(samples: xr.Dataset, factor: float) -> xr.Dataset:
    """Return samples whose stated errors are too small by a factor."""
    smaller = {}
    for name in samples.data_vars:
        if str(name).endswith("_uncertainty"):
            smaller[name] = samples[name].copy(data=samples[name].values / factor)
        elif str(name).endswith("covariance"):
            smaller[name] = samples[name].copy(data=samples[name].values / factor**2)
    return samples.assign(smaller)


def changed_water(count: int, seed: int, *, change: float = 0.05) -> Case:
    """Simulate a plate in water whose signal exceeds the open-water references."""
    samples = simulate(survey(count, _TARGET), rng=seed)
    signal = _measured(samples) + change * _true(samples, "water")
    return case_of(_with(samples, signal), interval=around(2.6))


def drift(count: int, seed: int, *, change: float) -> Case:
    """Simulate a plate in water whose signal drifts between open-water references."""
    samples = simulate(survey(count, _TARGET), rng=seed)
    return case_of(with_drift(samples, change, repeats=10), interval=around(2.6))


def with_drift(samples: xr.Dataset, change: float, *, repeats: int) -> xr.Dataset:
    """Return samples whose water signal grows by a fraction during the scan.

    Half of the repeats of each reference are recorded before the scan, half after it.
    """
    shots = samples.sizes["shot"]
    order = np.arange(shots).reshape(-1, repeats)
    before, after = order[:, : repeats // 2].ravel(), order[:, repeats // 2 :].ravel()
    samples = samples.isel(shot=np.concatenate([before, after]))
    factor = np.concatenate([np.ones(len(before)), np.full(len(after), 1 + change)])
    samples = _with(samples, _measured(samples, "open_water_") * factor, "open_water_")
    rows, columns = samples.sizes["row"], samples.sizes["column"]
    time = np.linspace(0, 1, rows * columns).reshape(rows, columns)
    signal = _measured(samples) + change * time * _true(samples, "water")
    return _with(samples, signal)
