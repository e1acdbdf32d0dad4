"""Leakage of 1 and 3 % of the echo, measured behind a shutter: `auto` holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from amulor.acquisition import Calibration, calibrated, from_shutter
from amulor.studies.trust.case import Case
from amulor.studies.trust.methods import outcome
from amulor.studies.trust.scenes.instrument import (
    Effect,
    Recorded,
    leakage,
    with_effect,
)

#: Noise of a reading with the shutter closed, over the echo.
NOISE = 1e-3


def closed(count: int, seed: int, effect: Effect, *, gain: float) -> xr.Dataset:
    """Return a recording of the leakage alone, times a gain, with noise."""
    recorded = Recorded(count, seed)
    scan, shots = effect(recorded)
    rng = np.random.default_rng(seed + 100)
    changed = {}
    for prefix, light, clean in (
        ("", scan, recorded.scan),
        ("open_water_", shots, recorded.shots),
    ):
        sigma = NOISE * recorded.echo.reshape(count, 1, *[1] * (light.ndim - 2))
        noise = sigma * rng.standard_normal((2, *light.shape))
        leak = gain * (light - clean) + noise[0] + 1j * noise[1]
        error = np.broadcast_to(sigma, light.shape)
        values = {
            "in_phase": leak.real,
            "quadrature": leak.imag,
            "in_phase_uncertainty": error,
            "quadrature_uncertainty": error,
            "in_phase_quadrature_covariance": np.zeros(light.shape),
        }
        for name, array in values.items():
            if f"{prefix}{name}" in recorded.cube:
                variable = recorded.cube[f"{prefix}{name}"]
                changed[f"{prefix}{name}"] = variable.copy(data=array)
    return recorded.cube.assign(changed).assign_attrs(shutter="closed")


def trusted(case: Case, calibration: Calibration) -> tuple[float, float, float]:
    """Return the share of trusted pixels, that of held 95 % intervals, the worst."""
    samples = calibrated(case.samples, calibration)
    image = outcome("auto", replace(case, samples=samples)).image
    if image is None:
        return 0.0, 1.0, 0.0
    valid = case.judged & (image["quality_flag"].values == 0)
    if not valid.any():
        return 0.0, 1.0, 0.0
    off = np.abs(image["slant_range"].values - case.surfaces[0])
    score = (off / image["slant_range_uncertainty"].values)[valid]
    share = float(valid.sum() / case.judged.sum())
    return share, float(np.mean(score < 1.96)), float(score.max())


@pytest.mark.study
@pytest.mark.parametrize("delay", [None, 2e-9], ids=["scan only", "one delay"])
@pytest.mark.parametrize("size", [0.01, 0.03])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_measured_leakage_leaves_most_pixels_trusted_and_right(
    count: int, size: float, delay: float | None
) -> None:
    effect = leakage(size, delay=delay)
    calibration = from_shutter([closed(count, 1, effect, gain=1.0)])
    case = with_effect(count, 1, effect=effect)
    share, held, worst = trusted(case, calibration)
    assert share >= 0.8
    assert held >= 0.92
    assert worst < 3.5


@pytest.mark.study
@pytest.mark.parametrize("gain", [0.7, 1.3])
@pytest.mark.parametrize("size", [0.01, 0.03])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_wrongly_measured_leakage_is_flagged_or_within_the_error(
    count: int, size: float, gain: float
) -> None:
    effect = leakage(size)
    calibration = from_shutter([closed(count, 1, effect, gain=gain)])
    case = with_effect(count, 1, effect=effect)
    _, held, worst = trusted(case, calibration)
    assert held >= 0.92
    assert worst < 3.5
