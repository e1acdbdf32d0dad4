"""Depth, time and frequency are three views of one integral."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light
from scipy.integrate import quad

from amulor.optics import small_angle_diffusion
from amulor.optics.small_angle_diffusion import impulse_response as water_column

WATER = {
    "absorption": 0.15,
    "forward_scattering": 0.35,
    "diffuse_scattering": 0.0,
    "second_moment": 0.05,
    "baseline": 0.2,
    "receiver_radius": 0.02,
    "acceptance_angle": 0.08,
}
FULL = WATER | {"backscatter_vsf": 3.5e-4, "group_index": 1.34}


@pytest.mark.parametrize("end", [np.inf, 3.0])
def test_the_fourier_transform_of_the_impulse_response_is_the_frequency_response(
    end: float,
) -> None:
    # A period of 2 us holds 220 m of water: what is left there is exp(-66).
    count, period = 2**16, 2e-6
    step = period / count
    time = (np.arange(count) + 0.5) * step
    response = water_column.impulse_response(time, end=end, **FULL)
    # numpy's forward transform has exp(-i w t); ours counts delay as positive phase.
    frequency = np.fft.rfftfreq(count, step)
    spectrum = np.conj(np.fft.rfft(response)) * step
    spectrum = spectrum * np.exp(2j * np.pi * frequency * step / 2)
    low = frequency < 200e6
    expected = small_angle_diffusion.water_response(frequency[low], end=end, **FULL)
    # Midpoint sums of a smooth curve; the cut end costs up to half a step.
    tolerance = 1e-9 if end == np.inf else 2e-4
    assert_allclose(spectrum[low], expected, rtol=0, atol=tolerance * abs(expected[0]))


def test_nothing_comes_before_the_pulse_or_after_the_end() -> None:
    time = np.array([-1e-9, 0.0, 10e-9, 30e-9])
    found = water_column.impulse_response(time, end=2.0, **FULL)
    # 30 ns are 3.36 m, beyond the end at 2 m.
    assert found[0] == 0
    assert found[3] == 0
    assert found[2] > 0


def test_the_echo_of_a_depth_comes_after_its_way_there_and_back_at_group_speed() -> (
    None
):
    slow = water_column.impulse_response(1e-8, **(FULL | {"group_index": 1.38}))
    depth = speed_of_light / 1.38 * 1e-8 / 2
    expected = 3.5e-4 * small_angle_diffusion.overlap(depth, **WATER)
    assert_allclose(slow, expected * speed_of_light / 1.38 / 2, rtol=1e-12)


@given(st.floats(0.01, 0.99))
def test_the_share_above_the_maximum_distance_is_the_share(share: float) -> None:
    depth = water_column.maximum_distance(share, **WATER)

    def integrand(z: float) -> float:
        return float(small_angle_diffusion.overlap(z, **WATER))

    part = quad(integrand, 0, depth, epsabs=0, epsrel=1e-11, limit=200)[0]
    rest = quad(integrand, depth, 150, epsabs=0, epsrel=1e-11, limit=400)[0]
    assert part / (part + rest) == pytest.approx(share, abs=1e-8)


def test_without_spread_and_baseline_the_maximum_distance_has_a_closed_form() -> None:
    # Wide aperture, tiny acceptance: F is exp(-2 k z), so z_max = -ln(1 - p) / 2k.
    column = WATER | {
        "forward_scattering": 0.0,
        "baseline": 0.0,
        "receiver_radius": 100.0,
        "acceptance_angle": 1e-3,
    }
    found = water_column.maximum_distance(0.9, **column)
    # S = R^2 + gamma^2 z^2 changes by 1e-9 over the column.
    assert found == pytest.approx(-np.log(0.1) / (2 * 0.15), rel=1e-7)


def test_half_of_the_signal_comes_from_nearer_in_water_that_ends() -> None:
    open_water = water_column.maximum_distance(0.5, **WATER)
    ended = water_column.maximum_distance(0.5, end=2.0, **WATER)
    assert ended < open_water
    assert water_column.maximum_distance(0.999, end=2.0, **WATER) < 2.0


@pytest.mark.parametrize("share", [0.0, 1.0, -0.1, np.nan])
def test_a_share_out_of_range_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match="above 0 and below 1"):
        water_column.maximum_distance(share, **WATER)


def test_a_receiver_that_sees_nothing_is_named() -> None:
    dark = WATER | {"baseline": 5.0, "acceptance_angle": 1e-4, "second_moment": 0.0}
    with pytest.raises(ValueError, match="no light from this water"):
        water_column.maximum_distance(0.5, **dark)
