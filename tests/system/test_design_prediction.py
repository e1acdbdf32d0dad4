"""Predicted standard uncertainties against simulated scans through rejection."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import amulor
from amulor.design import evaluate

TEXT = """
name = "Plate"
[water]
absorption = "{absorption} 1/m"
scattering = "{scattering} 1/m"
asymmetry = 0.95
refractive_index = 1.34
group_index = 1.38
signal_fluctuation = {fluctuation}
backscatter_mueller = [0.85, -0.85, -0.7]
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "{distance} m"]
width = "60 cm"
height = "60 cm"
reflectance = 0.2
mueller = [0.4, -0.4, -0.2]
[instrument]
phase_uncertainty = "0 deg"
wavelength = "532 nm"
power = "{power} mW"
modulation_depth = 0.8
modulation_frequencies = [{frequencies}]
polarizations = [{polarizations}]
[instrument.receiver]
position = ["10 cm", "0 m", "0 m"]
azimuth = "{azimuth} rad"
radius = "2 cm"
acceptance = "0.06 rad"
[instrument.detector]
optical_transmission = "30 %"
dark_rate = "{dark} kHz"
saturation = "100 V"
[instrument.lock_in]
time_constant = "1 ms"
phase_floor = "{floor} deg"
[scan]
columns = 12
rows = 10
azimuth_span = "0.5 deg"
elevation_span = "0.4 deg"
dwell = "{dwell} ms"
[scan.open_water]
columns = 3
rows = 3
repeats = 20
{more}
"""
BASE: dict[str, Any] = {
    "absorption": 0.05, "scattering": 0.1, "fluctuation": 0.0, "distance": 2.0,
    "power": 20, "frequencies": '"39 MHz"', "polarizations": '"VH"', "dark": 1,
    "floor": 0.02, "dwell": 20, "more": "", "method": "open-water",
}  # fmt: skip
PAIR = '"VV", "VH"'
DAY = '[daylight]\nradiance = "0.02 W/m^2/sr/nm"\nbandwidth = "3 nm"'
TONES = '"20 MHz", "45 MHz", "80 MHz", "120 MHz"'
#: What each instrument has of its own; each has another term that binds.
INSTRUMENTS: dict[str, dict[str, Any]] = {
    "clear": {},
    "shot noise": {"floor": 0.0, "distance": 3.0, "power": 2, "dwell": 10},
    "dark counts": {"floor": 0.0, "distance": 3.0, "power": 5, "dark": 20000},
    "daylight": {"floor": 0.0, "distance": 2.5, "power": 5, "more": DAY},
    "phase floor": {
        "floor": 0.2, "absorption": 0.1, "scattering": 0.2, "distance": 1.8,
        "frequencies": '"60 MHz"', "polarizations": '"VV"',
    },
    "fluctuating milk": {
        "absorption": 0.15, "scattering": 0.45, "fluctuation": 0.1, "distance": 1.5,
    },
    "two frequencies": {
        "absorption": 0.1, "scattering": 0.3, "fluctuation": 0.05, "distance": 2.5,
        "frequencies": '"30 MHz", "110 MHz"',
    },
    "unmixed": {
        "method": "polarization", "polarizations": PAIR, "absorption": 0.1,
        "scattering": 0.2, "fluctuation": 0.03,
    },
    "combined": {
        "method": "combined", "polarizations": PAIR, "absorption": 0.1,
        "scattering": 0.2, "fluctuation": 0.03,
    },
    "water kept": {"method": "none", "absorption": 0.03, "scattering": 0.05},
    "joint": {
        "method": "joint", "absorption": 0.1, "scattering": 0.2, "frequencies": TONES,
    },
}  # fmt: skip
#: Cross- over co-polarized light of target and water, (1 - m22) / (1 + m22).
RATIOS = {"target_ratio": 0.6 / 1.4, "water_ratio": 0.15 / 1.85}


def _reject(
    method: str, interval: tuple[float, float]
) -> Callable[[xr.Dataset], xr.Dataset]:
    rejection = amulor.rejection
    return {
        "open-water": lambda cube: rejection.open_water(cube, interval=interval),
        "polarization": lambda cube: rejection.polarization(cube, **RATIOS),
        "combined": lambda cube: rejection.combined(
            cube, interval=interval, target_ratio=RATIOS["target_ratio"]
        ),
        "none": rejection.keep_water,
        "joint": lambda cube: rejection.joint(cube, interval=interval),
    }[method]


def _compared(name: str, scans: int) -> tuple[float, float, float, float, int]:
    """Return predicted and achieved noise, predicted and achieved bias, and counts."""
    stated = {**BASE, **INSTRUMENTS[name]}
    distance = stated["distance"]
    survey = amulor.Survey.from_text(TEXT.format(**stated, azimuth=-0.1 / distance))
    # One frequency repeats after some 2.8 m; the interval holds no second one.
    interval = (distance - 0.6, distance + 0.6)
    found = evaluate(
        survey,
        distance=distance,
        method=stated["method"],
        interval=interval,
        late_light=False,
        **({} if stated["method"] == "none" else {"water_change": 0.0}),
    )
    reject = _reject(stated["method"], interval)
    ranges = []
    for seed in range(scans):
        cube = amulor.simulate(survey, rng=seed)
        target = reject(cube)
        channel = str(target["polarization"].values[0])
        image = amulor.imaging.range_image(
            target, polarization=channel, interval=interval
        )
        ranges.append(image["slant_range"].values)
    each = np.array(ranges)
    assert np.isfinite(each).all()
    truth = cube.amulor.truth["slant_range"].values
    achieved = float(np.sqrt(each.var(axis=0, ddof=1).mean()))
    return (
        float(found["standard_uncertainty"]),
        achieved,
        float(found["residual_bias"]),
        float((each - truth).mean()),
        each.size,
    )


def _agrees(name: str, scans: int) -> None:
    predicted, achieved, left, bias, count = _compared(name, scans)
    ratio = achieved / predicted
    print(f"{name}: {achieved * 1e3:.4f} mm of {predicted * 1e3:.4f} mm, {ratio:.3f}")
    # 10 % is what is promised; the scatter of the ratio itself is 1 / sqrt(2 n), with
    # one degree of freedom less for each pixel.
    spread = (2 * count * (scans - 1) / scans) ** -0.5
    assert abs(ratio - 1) < 0.1 + 2 * spread, name
    # What stays in the ranges on average is no more than stated, but for its noise and
    # for the reference, which the pixels of a scan share.
    assert abs(bias) < 1.3 * left + 3 * achieved / scans**0.5, name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["shot noise", "water kept"])
def test_noise_of_simulated_scans_is_as_predicted(name: str) -> None:
    _agrees(name, scans=5)


@pytest.mark.study
@pytest.mark.parametrize("name", INSTRUMENTS)
def test_a_thousand_simulated_ranges_scatter_as_predicted(name: str) -> None:
    _agrees(name, scans=10)
