"""Turning points of sweeps, their published spacings, and what explains these."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light
from scipy.integrate import quad

from amulor.optics import (
    extrema,
    interference,
    low_pass,
    small_angle_diffusion,
    target_echo,
)
from amulor.optics.extrema import _vertex


@given(st.floats(5e6, 60e6), st.floats(-np.pi, np.pi))
def test_a_cosine_turns_every_half_period(period: float, phase: float) -> None:
    frequency = np.linspace(0, 150e6, 3001)
    found = extrema.find(frequency, np.cos(2 * np.pi * frequency / period + phase))
    # Maxima where the argument is a multiple of 2 pi; samples 0.05 MHz apart.
    order = found.maxima / period + phase / (2 * np.pi)
    assert_allclose(order, np.round(order), atol=1e-4)
    assert_allclose(found.separations, period, rtol=1e-4)


def test_uneven_samples_of_a_parabola_give_its_vertex() -> None:
    frequency = np.array([0.0, 1.0, 4.0, 5.0])
    found = extrema.find(frequency, -((frequency - 3.2) ** 2))
    assert_allclose(found.maxima, [3.2])
    assert found.minima.size == 0


def test_a_slope_has_no_extrema() -> None:
    found = extrema.find([1.0, 2.0, 3.0], [1.0, 2.0, 2.0])
    assert found.maxima.size == 0
    assert found.minima.size == 0


# The three experiments of section 8 as rebuilt: k = 0.5, 1.0, 0.5 1/m, white target at
# 3.9, 3.9 and 5.6 m, n = 1.34, baseline 0.20 m, all attenuation in k'.
@pytest.mark.parametrize(
    ("k", "distance", "mean_ratio", "low", "high"),
    [(1.0, 3.9, 0.6, 35.7, 38.6), (0.5, 5.6, 0.6, 23.6, 26.2)],
    ids=["experiment 2", "experiment 3"],
)
def test_maxima_are_spaced_as_in_the_published_experiments(
    k: float, distance: float, mean_ratio: float, low: float, high: float
) -> None:
    frequency = np.linspace(0.5e6, 146e6, 1456)
    column = {
        "absorption": 0.3 * k,
        "forward_scattering": 0.7 * k,
        "diffuse_scattering": 0.0,
        "second_moment": 0.05 if k == 0.5 else 0.06,
        "baseline": 0.2,
        "receiver_radius": 0.02,
        "acceptance_angle": 0.08,
    }
    water = small_angle_diffusion.water_response(
        frequency, backscatter_vsf=1.0, group_index=1.34, end=distance, **column
    )
    target = target_echo.target_response(
        frequency,
        depth=distance,
        optical_path=2 * 1.34 * distance,
        reflectance=0.8,
        **column,
    )
    # The scale that sets the sweep mean of A_w / A_t, as the parameter set says.
    water = water * mean_ratio / np.mean(abs(water / target))
    amplitude = abs(interference.total_signal(target, water))
    found = extrema.find(frequency, amplitude)
    assert found.separations.size >= 3
    spacing = found.separations / 1e6
    # Two units about the rebuilt range, which other choices of model give.
    assert spacing.min() > low - 2
    assert spacing.max() < high + 2
    assert extrema.ripple(amplitude) > 1


# ------------------------------------------------------------ group depth, separation

COLUMN = {
    "absorption": 0.15,
    "forward_scattering": 0.35,
    "diffuse_scattering": 0.0,
    "second_moment": 0.05,
    "baseline": 0.2,
    "receiver_radius": 0.02,
    "acceptance_angle": 0.08,
}


@given(st.floats(0.0, 10.0), st.floats(1e-9, 1e3), st.floats(-np.pi, np.pi))
def test_one_plane_of_water_has_its_own_depth_whatever_its_size_and_phase(
    depth: float, size: float, phase: float
) -> None:
    frequency = np.append(np.linspace(0.5e6, 50e6, 100), [51e6, 53e6, 54e6])
    turn = 4 * np.pi * frequency * 1.38 / speed_of_light * depth
    found = extrema.group_depth(
        frequency, size * np.exp(1j * (turn + phase)), group_index=1.38
    )
    # The smallest step of the phase is 0.03 rad a metre; it is known to 1e-15 or so.
    assert_allclose(found, depth, rtol=0, atol=1e-11)


def test_group_depth_of_a_first_order_low_pass_is_that_of_its_arctangent() -> None:
    frequency, corner = np.linspace(0, 150e6, 1501), 17.8e6
    signal = low_pass.first_order_response(frequency, cut_off=corner)
    found = extrema.group_depth(frequency, signal, group_index=1.34)
    scale = speed_of_light / 1.34 / (4 * np.pi * corner)
    expected = scale / (1 + (frequency / corner) ** 2)
    # Steps of 0.1 MHz: (0.1 / 17.8)^2 / 3 of the third derivative, 2 at most, and
    # twice that at the ends.
    assert_allclose(found, expected, rtol=0, atol=5e-5 * scale)


def test_group_depth_at_zero_frequency_is_the_mean_depth_of_the_signal() -> None:
    frequency = np.array([0.0, 1e4, 2e4])
    signal = small_angle_diffusion.water_response(
        frequency, backscatter_vsf=1e-3, group_index=1.34, **COLUMN
    )

    def moment(order: int) -> float:
        def integrand(z: float) -> float:
            return float(z**order * small_angle_diffusion.overlap(z, **COLUMN))

        return float(quad(integrand, 0, 40, epsrel=1e-10, limit=200)[0])

    found = extrema.group_depth(frequency, signal, group_index=1.34)[0]
    # The phase is odd in the frequency: what is left out is (2 pi f z / v)^2, 1e-6.
    assert_allclose(found, moment(1) / moment(0), rtol=1e-5)


def test_group_depth_of_the_tank_is_what_the_published_spacings_imply() -> None:
    # Deduced from the extrema of section 8: 1.2-1.5 m near 35 MHz, 0.8-1.05 m near
    # 110 MHz, over the waters with k from 0.5 to 1.0 1/m.
    frequency = np.linspace(0.5e6, 146e6, 1456)
    signal = small_angle_diffusion.water_response(
        frequency, backscatter_vsf=1e-3, group_index=1.34, end=5.6, **COLUMN
    )
    depth = extrema.group_depth(frequency, signal, group_index=1.34)
    assert 1.2 < depth[np.argmin(abs(frequency - 35e6))] < 1.5
    assert 0.8 < depth[np.argmin(abs(frequency - 110e6))] < 1.05


@given(st.floats(0.2, 1.5), st.floats(2.5, 8.0), st.floats(0.1, 0.9))
def test_maxima_of_two_planes_are_spaced_by_the_way_between_them(
    water_depth: float, distance: float, ratio: float
) -> None:
    frequency = np.linspace(0, 300e6, 6001)
    turn = 4j * np.pi * frequency * 1.34 / speed_of_light
    water = ratio * np.exp(turn * water_depth)
    found = extrema.find(frequency, abs(np.exp(turn * distance) + water))
    depth = extrema.group_depth(frequency, water, group_index=1.34).mean()
    expected = extrema.separation(distance, group_depth=depth, group_index=1.34)
    # Samples are 0.05 MHz apart; the parabola through three is good to 1e-3 of that.
    assert_allclose(found.separations, expected, rtol=1e-4)


def test_separation_without_water_is_half_a_wavelength_of_the_modulation() -> None:
    # v / 2 d for n = 1.34: 28.68 MHz at 3.9 m.
    found = extrema.separation([3.9, 7.8], group_depth=0.0, group_index=1.34)
    assert_allclose(found, [28.6826e6, 14.3413e6], rtol=1e-5)


@pytest.mark.parametrize(
    ("signal", "words"),
    [
        ([1.0, 0.0, 1.0], "zero has no phase"),
        ([1.0, np.nan, 1.0], "zero has no phase"),
        ([1.0, 1j, -1.0], "0.25 of a turn; sample"),
        ([1.0, 1.0], "water_signal must be 1-D"),
    ],
)
def test_signals_without_a_group_depth_are_refused(
    signal: list[complex], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        extrema.group_depth([0.0, 1e6, 2e6], signal, group_index=1.34)


def test_targets_in_front_of_the_group_depth_are_refused() -> None:
    with pytest.raises(
        ValueError, match=r"distance - group_depth must be above 0 \[m\], got -0\.5"
    ):
        extrema.separation(1.0, group_depth=1.5, group_index=1.34)
    for wrong in (0.9, np.nan):
        with pytest.raises(
            ValueError, match="group_index must be finite and at least 1"
        ):
            extrema.separation(2.0, group_depth=1.0, group_index=wrong)
        with pytest.raises(
            ValueError, match="group_index must be finite and at least 1"
        ):
            extrema.group_depth([0, 1e6, 2e6], [1, 1, 1], group_index=wrong)


def test_ripple_is_that_of_its_definition() -> None:
    assert extrema.ripple([1.0, 3.0, 2.0]) == 1.0
    with pytest.raises(ValueError, match="above 0"):
        extrema.ripple([-1.0, 1.0])


@pytest.mark.parametrize(
    ("frequency", "value", "words"),
    [
        ([1.0, 2.0], [1.0, 2.0], "at least 3"),
        ([1.0, 2.0, 3.0], [1.0, 2.0], "of one length"),
        ([1.0, 3.0, 2.0], [1.0, 2.0, 3.0], "modulation_frequency must be rising"),
    ],
)
def test_what_is_no_sweep_is_refused(
    frequency: list[float], value: list[float], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        extrema.find(frequency, value)


def test_the_vertex_of_a_parabola_through_uneven_samples() -> None:
    frequency = np.array([10e6, 14e6, 15e6, 21e6, 30e6])
    for vertex, sign in ((14.3e6, 1), (20e6, -1)):
        values = 5 + sign * 2e-13 * (frequency - vertex) ** 2
        assert_allclose(_vertex(frequency, values, np.array([1, 2, 3])), vertex)
