"""Claims about the sum of target and water phasors."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics import interference, ranging

amplitudes = st.floats(1e-3, 1e3)
phases = st.floats(-20.0, 20.0)


def phasor(amplitude, phase):
    return amplitude * np.exp(1j * phase)


@settings(deadline=None)
@given(amplitudes, phases, amplitudes, phases)
def test_subtraction_gives_back_the_target(a, phi, w, chi):
    target, water = phasor(a, phi), phasor(w, chi)
    total = interference.total_signal(target, water)
    back = interference.target_signal(total, water)
    assert_allclose(back, target, rtol=0, atol=1e-15 * (a + w) * 4)  # rounding


@settings(deadline=None)
@given(amplitudes, phases, amplitudes, phases)
def test_amplitude_and_phase_form_is_the_sum_of_phasors(a, phi, w, chi):
    amplitude, phase = interference.total_amplitude_and_phase(
        a, target_phase=phi, water_amplitude=w, water_phase=chi
    )
    total = interference.total_signal(phasor(a, phi), phasor(w, chi))
    # Phases up to 20 rad are rounded to 4e-15.
    assert_allclose(phasor(amplitude, phase), total, rtol=0, atol=2e-14 * (a + w))
    assert abs(phase - phi) <= np.pi * (1 + 1e-15)


@settings(deadline=None)
@given(amplitudes, phases, amplitudes, phases)
def test_amplitude_and_phase_form_of_the_target_is_the_difference(a, phi, w, chi):
    amplitude, phase = interference.target_amplitude_and_phase(
        a, phase=phi, water_amplitude=w, water_phase=chi
    )
    target = interference.target_signal(phasor(a, phi), phasor(w, chi))
    assert_allclose(phasor(amplitude, phase), target, rtol=0, atol=2e-14 * (a + w))


@settings(deadline=None)
@given(amplitudes, st.floats(0.01, 20.0), phases)
def test_a_strong_water_in_phase_needs_the_four_quadrants(a, excess, phi):
    # The water alone is stronger than the sum: the target stands against it.
    amplitude, phase = interference.target_amplitude_and_phase(
        a, phase=phi, water_amplitude=a * (1 + excess), water_phase=phi
    )
    assert_allclose(amplitude, a * excess, rtol=1e-12)  # a difference of two
    # The principal value would leave the phase at phi.
    assert_allclose(abs(phase - phi), np.pi, rtol=1e-14)


def test_a_right_angle_is_pythagoras():
    amplitude, phase = interference.total_amplitude_and_phase(
        4.0, target_phase=np.pi / 2, water_amplitude=3.0, water_phase=0.0
    )
    assert_allclose(amplitude, 5.0, rtol=1e-15)
    # Water that comes earlier pulls the phase back: towards 0, not away from it.
    assert_allclose(phase, np.pi / 2 - np.arctan(3 / 4), rtol=1e-15)


def test_water_in_front_of_the_target_shortens_the_phase():
    near, far = ranging.phase([0.5, 1.5], modulation_frequency=39e6, group_index=1.38)
    error = interference.phase_error(phasor(1.0, far), phasor(0.1, near))
    assert error < 0
    # Eq. (51) with xi = 0.1 and psi = 2 omega (1 m) / v = 2.25597 rad, by hand.
    assert_allclose(error, -np.arctan2(0.1 * 0.774311, 1 - 0.1 * 0.632806), rtol=1e-5)


def test_a_weak_water_leaves_the_target_and_a_strong_one_takes_over():
    target, water = phasor(1.0, 0.7), phasor(1.0, -1.2)
    weak = interference.total_signal(target, 1e-9 * water)
    strong = interference.total_signal(1e-9 * target, water)
    # Eqs. (52) and (53): the other one is 1e-9 of it.
    assert_allclose(weak, target, rtol=2e-9)
    assert_allclose(strong, water, rtol=2e-9)


def test_phase_error_reaches_the_arcsine_bound_and_no_more():
    ratio = 0.125
    turn = np.linspace(-np.pi, np.pi, 20001)
    error = interference.phase_error(1.0, phasor(ratio, turn))
    # The maximum is flat: a step of 3e-4 rad misses it by 1e-8.
    assert_allclose(np.max(np.abs(error)), np.arcsin(ratio), rtol=1e-7)
    # 0.125 stands for the 7 degrees of the published drift.
    assert_allclose(np.degrees(np.arcsin(ratio)), 7.0, rtol=0, atol=0.2)


@settings(deadline=None)
@given(amplitudes, phases, st.floats(0.0, 0.999), phases)
def test_phase_error_stays_within_the_arcsine_of_the_ratio(a, phi, ratio, chi):
    error = interference.phase_error(phasor(a, phi), phasor(ratio * a, chi))
    assert abs(error) <= np.arcsin(ratio) + 1e-12  # steep near a ratio of 1


@settings(deadline=None)
@given(amplitudes, phases, amplitudes, phases, amplitudes, phases)
def test_a_common_gain_and_delay_change_no_figure_of_merit(a, phi, w, chi, gain, turn):
    target, water = phasor(a, phi), phasor(w, chi)
    total = target + water
    assume(abs(total) > 1e-6 * (a + w))
    common = phasor(gain, turn)
    # Where the phasors nearly cancel, rounding grows by up to 1e6.
    assert_allclose(
        interference.signal_to_optical_noise_ratio(common * total, common * water),
        interference.signal_to_optical_noise_ratio(total, water),
        rtol=1e-13,
    )
    assert_allclose(
        interference.contrast(common * total, common * water),
        interference.contrast(total, water),
        rtol=0,
        atol=1e-13,
    )
    turned = interference.phase_error(common * target, common * water)
    error = interference.phase_error(target, water)
    assert_allclose(np.exp(1j * turned), np.exp(1j * error), rtol=0, atol=1e-7)


@settings(deadline=None)
@given(amplitudes, phases, amplitudes, phases)
def test_contrast_is_negative_exactly_where_the_ratio_is_below_1(a, phi, w, chi):
    total, water = phasor(a, phi), phasor(w, chi)
    ratio = interference.signal_to_optical_noise_ratio(total, water)
    contrast = interference.contrast(total, water)
    assert_allclose(contrast, (ratio - 1) / (ratio + 1), rtol=0, atol=1e-15)
    assert (contrast < 0) == (ratio < 1)


def test_figures_of_merit_of_a_signal_three_times_the_water():
    ratio = interference.signal_to_optical_noise_ratio(3.0j, -1.0)
    contrast = interference.contrast(3.0j, -1.0)
    assert ratio == 3.0
    assert contrast == 0.5


@pytest.mark.parametrize(
    ("spacing", "distance"),
    # Published spacings of the maxima, and v / 2 spacing for a group index 1.380.
    [(25e6, 4.34), (33.5e6, 3.24), (43.4e6, 2.50)],
)
def test_maxima_of_the_amplitude_are_v_over_twice_the_separation_apart(
    spacing, distance
):
    frequency = np.arange(0.5e6, 146e6, 0.02e6)
    options = {"modulation_frequency": frequency, "group_index": 1.380}
    target = phasor(1.0, ranging.phase(distance + 1.0, **options))
    water = phasor(0.5, ranging.phase(1.0, **options))
    amplitude = np.abs(interference.total_signal(target, water))
    inner = amplitude[1:-1]
    top = (inner > amplitude[:-2]) & (inner >= amplitude[2:])
    periods = np.diff(frequency[1:-1][top])
    # Three digits of the distance, and the step of 0.02 MHz.
    assert_allclose(periods, spacing, rtol=0.003)


def test_signals_broadcast():
    target = np.ones((4, 1, 3), dtype=complex)
    water = 0.5j * np.ones((2, 3))
    for function in (
        interference.total_signal,
        interference.target_signal,
        interference.phase_error,
        interference.contrast,
        interference.signal_to_optical_noise_ratio,
    ):
        assert function(target, water).shape == (4, 2, 3)
    amplitude, phase = interference.total_amplitude_and_phase(
        np.ones((4, 1)), target_phase=0.0, water_amplitude=[1, 2], water_phase=0.3
    )
    assert amplitude.shape == phase.shape == (4, 2)


def test_missing_samples_stay_missing():
    total = np.array([1 + 1j, np.nan])
    assert_array_equal(np.isnan(interference.target_signal(total, 0.1)), [False, True])
    assert_array_equal(np.isnan(interference.contrast(total, 0.1)), [False, True])
    assert_array_equal(np.isnan(interference.phase_error(total, 0.1)), [False, True])


def test_figures_that_have_no_value_are_refused():
    with pytest.raises(ValueError, match="target_signal must be other than 0"):
        interference.phase_error([1.0, 0.0], 0.1)
    with pytest.raises(ValueError, match="water_signal must be other than 0"):
        interference.signal_to_optical_noise_ratio(1.0, 0.0)
    with pytest.raises(
        ValueError, match="must be other than 0, got 0; there is no light"
    ):
        interference.contrast(0.0, 0.0)


def test_negative_amplitudes_are_refused():
    with pytest.raises(
        ValueError, match=r"target_amplitude must be not negative, .*; add pi"
    ):
        interference.total_amplitude_and_phase(
            -1.0, target_phase=0.0, water_amplitude=1.0, water_phase=0.0
        )
    with pytest.raises(
        ValueError, match=r"water_amplitude must be not negative, .*; add pi"
    ):
        interference.target_amplitude_and_phase(
            1.0, phase=0.0, water_amplitude=-1.0, water_phase=0.0
        )
