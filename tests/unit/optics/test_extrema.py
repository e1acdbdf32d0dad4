"""Turning points of sweeps, and the published spacings of their maxima."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics import extrema, interference, small_angle_diffusion, target_echo


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


def test_ripple_is_that_of_its_definition() -> None:
    assert extrema.ripple([1.0, 3.0, 2.0]) == 1.0
    with pytest.raises(ValueError, match="above 0"):
        extrema.ripple([-1.0, 1.0])


@pytest.mark.parametrize(
    ("frequency", "value", "words"),
    [
        ([1.0, 2.0], [1.0, 2.0], "at least 3"),
        ([1.0, 2.0, 3.0], [1.0, 2.0], "of one length"),
        ([1.0, 3.0, 2.0], [1.0, 2.0, 3.0], "must increase"),
    ],
)
def test_what_is_no_sweep_is_refused(
    frequency: list[float], value: list[float], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        extrema.find(frequency, value)
