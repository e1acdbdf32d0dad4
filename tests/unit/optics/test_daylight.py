"""Claims about daylight and speckle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.optics.daylight import daylight_radiance, daylight_rate
from amulor.optics.detection import speckle_contrast


def test_the_rate_is_photons_counted_by_hand():
    # One milliwatt of 1 um light holds 1e-3 / 1.98645e-19 J = 5.0341e15 photons/s.
    rate = daylight_rate(
        2e6,
        wavelength=1e-6,
        bandwidth=1e-9,
        receiver_area=0.5,
        solid_angle=1.0,
        transmission=1.0,
        quantum_efficiency=1.0,
    )
    assert rate == pytest.approx(5.0341e15, rel=1e-4)


@given(
    scale=st.floats(0.1, 10.0),
    name=st.sampled_from(
        ["bandwidth", "receiver_area", "solid_angle", "wavelength", "radiance"]
    ),
)
def test_the_rate_grows_with_each_factor_alike(scale, name):
    usual = {
        "radiance": 1e7,
        "wavelength": 5e-7,
        "bandwidth": 1e-9,
        "receiver_area": 1e-3,
        "solid_angle": 0.02,
    }

    def rate(values):
        values = dict(values)
        return daylight_rate(
            values.pop("radiance"), transmission=0.5, quantum_efficiency=0.2, **values
        )

    more = rate({**usual, name: usual[name] * scale})
    assert more == pytest.approx(scale * rate(usual))


@given(depth=st.floats(0.0, 50.0), step=st.floats(0.0, 20.0))
def test_daylight_falls_by_e_over_an_attenuation_length(depth, step):
    here, below = daylight_radiance(
        3.0, depth=[depth, depth + step], diffuse_attenuation=0.1
    )
    assert below == pytest.approx(here * np.exp(-0.1 * step))
    assert daylight_radiance(3.0, depth=10.0, diffuse_attenuation=0.1) == pytest.approx(
        3 / np.e
    )


def test_speckle_has_the_contrast_of_exponential_light_over_m():
    assert speckle_contrast(1) == 1
    assert speckle_contrast(100) == pytest.approx(0.1)
    # The sum of M independent exponential powers, as fully developed speckle has.
    drawn = np.random.default_rng(1).exponential(size=(20_000, 25)).sum(axis=1)
    found = drawn.std() / drawn.mean()
    # Its own error is contrast / sqrt(2 n).
    assert found == pytest.approx(float(speckle_contrast(25)), rel=5 / np.sqrt(40_000))
