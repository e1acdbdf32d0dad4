"""Daylight, reflection at the window and speckle: off, and by their closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import Planck, speed_of_light

from amulor.errors import SurveyError
from amulor.simulation import DiffusionModel, scene_light, simulate
from amulor.survey import Survey

RADIANCE = 2e7  # W/(m^2 sr m)
DAYLIGHT = {
    "radiance": RADIANCE,
    "bandwidth": 3e-9,
    "depth": 5.0,
    "diffuse_attenuation": 0.2,
}
MODEL = DiffusionModel()


@pytest.fixture(scope="module")
def small(plate: Survey) -> Survey:
    return plate.with_(
        {
            "scan.columns": 40,
            "scan.rows": 25,
            "scan.open_water": None,
            "water.signal_fluctuation": 0.0,
            "instrument.lock_in.phase_floor": 0.0,
        }
    )


def truth(survey: Survey, name: str) -> np.ndarray:
    found = simulate(survey, rng=1, model=MODEL).amulor.truth
    return (found[f"{name}_in_phase"] + 1j * found[f"{name}_quadrature"]).values


def variance(cube) -> np.ndarray:
    return (cube["in_phase_uncertainty"] ** 2).values


def test_daylight_adds_its_shot_noise_and_no_signal(small):
    lit = small.with_({"daylight": DAYLIGHT})
    assert_array_equal(truth(lit, "target"), truth(small, "target"))
    dark, bright = (simulate(s, rng=2, model=MODEL) for s in (small, lit))
    photons = 0.25 * 405e-9 / (Planck * speed_of_light)
    area, cone = np.pi * 0.02**2, np.pi * 0.08**2
    radiance = RADIANCE * np.exp(-0.2 * 5.0)
    # T of the optics 0.1; half passes an analyser.
    rate = photons * 0.1 * radiance * 3e-9 * area * cone / 2
    volt, excess, time = 8e-12, 1.2, 0.0865
    expected = volt**2 * 2 * excess * rate / time
    found = variance(bright) - variance(dark)
    assert_allclose(found, expected, rtol=1e-3)
    assert expected > 0.1 * variance(dark).mean()
    # And the samples scatter as they say, by the error of a standard deviation.
    signal = (bright["in_phase"] + 1j * bright["quadrature"]).values
    expected_signal = truth(small, "target") + truth(small, "water")
    pull = (signal - expected_signal).real / bright["in_phase_uncertainty"].values
    assert pull.std() == pytest.approx(1, abs=5 / np.sqrt(2 * pull.size))


def test_daylight_can_saturate_the_detector(small):
    blinding = small.with_({"daylight": {**DAYLIGHT, "radiance": 1e14}})
    assert not simulate(small, rng=1, model=MODEL)["saturated"].any()
    assert simulate(blinding, rng=1, model=MODEL)["saturated"].all()


def test_light_without_an_analyser_takes_all_of_the_daylight(small):
    open_eye = small.with_({"instrument.polarizations": ["none"]})
    gains = [
        (
            variance(simulate(s.with_({"daylight": DAYLIGHT}), rng=2, model=MODEL))
            - variance(simulate(s, rng=2, model=MODEL))
        ).mean()
        for s in (small, open_eye)
    ]
    assert gains[1] == pytest.approx(2 * gains[0], rel=1e-3)


def test_a_window_takes_what_fresnel_says_from_target_and_water(small):
    window = {"distance": 0.05, "thickness": 0.01, "refractive_index": 1.47}
    ahead = small.with_(
        {
            "instrument.window": window,
            "instrument.receiver.azimuth": 0.0,
            "scan.columns": 1,
            "scan.rows": 1,
            "targets.0.position": (0.0, 0.0, 1.0),
        }
    )
    lossy = ahead.with_({"instrument.window.reflection_loss": True})
    # 4 n / (n + 1)^2 into the glass, and the same for the step from 1.47 to 1.34.
    glass = 4 * 1.47 / 2.47**2
    water = 4 * 1.47 * 1.34 / (1.47 + 1.34) ** 2
    for name in ("target", "water"):
        share = truth(lossy, name) / truth(ahead, name)
        assert_allclose(share, (glass * water) ** 2, rtol=1e-9)
    without = ahead.with_({"instrument.window.reflection_loss": False})
    assert_array_equal(truth(without, "target"), truth(ahead, "target"))
    light = [scene_light(s, model=MODEL).with_target.water for s in (lossy, ahead)]
    assert_allclose(light[0] / light[1], (glass * water) ** 2, rtol=1e-9)


def test_speckle_varies_the_echo_by_one_over_the_root_of_its_cells(small):
    cells = 16.0
    survey = small.with_(
        {
            "instrument.receiver.speckle_cells": cells,
            "instrument.modulation_frequencies": [20e6, 39e6],
            # Light enough that counting noise is far below the speckle.
            "instrument.power": 10.0,
        }
    )
    cube = simulate(survey, rng=3, model=MODEL)
    signal = (cube["in_phase"] + 1j * cube["quadrature"]).values
    power = ((signal - truth(survey, "water")) / truth(survey, "target")).real
    count = power[0].size
    contrast = power[0].std() / power[0].mean()
    # Gamma distributed: the relative error of its deviation is sqrt((2 + 6 / M) / 4n).
    error = np.sqrt((2 + 6 / cells) / (4 * count))
    assert contrast == pytest.approx(1 / np.sqrt(cells), rel=5 * error)
    assert power[0].mean() == pytest.approx(1, abs=5 / np.sqrt(cells * count))
    # One pattern for all frequencies, another behind each analyser.
    assert np.corrcoef(power[0].ravel(), power[1].ravel())[0, 1] > 0.99
    between = np.corrcoef(power[0, 0].ravel(), power[0, 1].ravel())[0, 1]
    assert abs(between) < 5 / np.sqrt(power[0, 0].size)


def test_without_speckle_the_random_numbers_are_as_they_were(small):
    calm = small.with_({"instrument.receiver.speckle_cells": None})
    one, other = (simulate(s, rng=4, model=MODEL)["in_phase"] for s in (small, calm))
    assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("instrument.receiver.speckle_cells", 0.5),
        ("daylight", {"radiance": "1 W/m^2", "bandwidth": "1 nm"}),
        ("daylight", {"radiance": -1.0, "bandwidth": "1 nm"}),
    ],
)
def test_what_cannot_be_is_refused(small, path, value):
    with pytest.raises(SurveyError, match=path):
        small.with_({path: value})
