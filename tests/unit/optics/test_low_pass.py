"""Cut-off, free fit and first-order form: closed forms, statistics, refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light
from scipy.optimize import curve_fit

from amulor.optics.low_pass import (
    LowPassFit,
    cut_off,
    cut_off_of_narrow_receiver,
    cut_off_of_sweep,
    first_order_response,
    fit,
    fit_if_shown,
    fit_of_power,
)

SWEEP = np.linspace(0.5e6, 138e6, 276)
drawn = settings(deadline=None, max_examples=50)
corners = st.floats(1e5, 5e8)


# --------------------------------------------------------------- first order


def test_cut_off_of_a_narrow_receiver_is_35_6_mhz_per_reduced_attenuation():
    # Section on eq. (49): 35.6 MHz times k' in 1/m for an index of 1.34.
    found = cut_off_of_narrow_receiver(
        reduced_attenuation=np.array([0.1, 0.5, 1.0]), group_index=1.34
    )
    assert_allclose(found / 1e6, [3.56, 17.80, 35.61], atol=0.005)


@given(corner=corners, ratio=st.floats(0, 100))
@drawn
def test_first_order_response_has_the_modulus_of_71_and_an_arctangent_phase(
    corner, ratio
):
    response = first_order_response(ratio * corner, cut_off=corner)
    assert_allclose(abs(response), (1 + ratio**2) ** -0.5, rtol=1e-12)
    assert_allclose(np.angle(response), np.arctan(ratio), rtol=1e-12)


def test_first_order_response_falls_as_the_reciprocal_far_above():
    assert_allclose(abs(first_order_response(1e9, cut_off=1e3)), 1e-6, rtol=1e-11)


# ------------------------------------------------------------------- cut-off


@given(corner=corners)
@drawn
def test_cut_off_finds_the_corner_of_a_first_order_low_pass(corner):
    found = cut_off(lambda f: first_order_response(f, cut_off=corner))
    # The slope of the modulus there is -1/(2 sqrt2 f_c): rounding times 3.
    assert_allclose(found, corner, rtol=1e-13)


def test_cut_off_of_a_slab_is_that_of_a_sinc():
    # Even light from a slab of thickness L: |sinc(2 f L / v)|, and sinc(x) is
    # 1/sqrt2 at x = 0.442946.
    thickness, velocity = 2.0, speed_of_light / 1.34
    found = cut_off(lambda f: np.sinc(2 * f * thickness / velocity))
    assert_allclose(found, 0.4429464 * velocity / (2 * thickness), rtol=2e-7)


def test_cut_off_is_the_first_of_several_crossings():
    # 0.6 + 0.4 cos falls to 1/sqrt2 again and again; first at cos x = 0.267767.
    period = 25e6
    found = cut_off(lambda f: 0.6 + 0.4 * np.cos(2 * np.pi * f / period))
    angle = np.arccos((2**-0.5 - 0.6) / 0.4)
    assert_allclose(found, angle / (2 * np.pi) * period, rtol=1e-12)


@given(corner=corners, unit=st.floats(1e-200, 1e200))
@drawn
def test_cut_off_knows_no_unit_of_amplitude(corner, unit):
    found = cut_off(lambda f: unit * first_order_response(f, cut_off=corner))
    assert_allclose(found, corner, rtol=1e-12)


def test_cut_off_below_the_first_sample_is_found():
    found = cut_off(lambda f: first_order_response(f, cut_off=20.0))
    assert_allclose(found, 20.0, rtol=1e-9)


def test_cut_off_above_the_maximum_is_refused():
    with pytest.raises(ValueError, match=r"lowest fraction is 0\.995; raise"):
        cut_off(lambda f: first_order_response(f, cut_off=1e9), maximum_frequency=1e8)


@pytest.mark.parametrize(
    ("response", "text"),
    [
        (lambda f: 0.0 * f, "zero frequency must not be zero"),
        (lambda f: np.where(f > 1e6, np.nan, 1.0), "finite value for each frequency"),
        (lambda f: 1.0, r"got shape \(\)"),
    ],
)
def test_responses_without_a_meaning_are_refused(response, text):
    with pytest.raises(ValueError, match=text):
        cut_off(response)


@pytest.mark.parametrize("maximum", [0.0, -1.0, np.inf, np.nan])
def test_the_maximum_frequency_must_be_a_frequency(maximum):
    with pytest.raises(ValueError, match="maximum_frequency must be finite and above"):
        cut_off(lambda f: 1 / (1 + f), maximum_frequency=maximum)


# ----------------------------------------------------------------- free fit


@given(corner=st.floats(1e6, 5e8), zero=st.floats(1e-9, 1e9))
@drawn
def test_fit_returns_what_the_data_were_made_with(corner, zero):
    result = fit(SWEEP, zero / np.sqrt(1 + (SWEEP / corner) ** 2))
    assert isinstance(result, LowPassFit)
    # Rounding of the data; the cut-off weighs (f_c / 138 MHz)^2 = 13 times less.
    assert_allclose(result.cut_off, corner, rtol=1e-10)
    assert_allclose(result.amplitude_at_zero, zero, rtol=1e-10)
    assert result.cut_off_standard_error < 1e-8 * corner


def test_standard_error_is_the_scatter_of_repeated_fits():
    rng = np.random.default_rng(71)
    clean = 2.0 / np.sqrt(1 + (SWEEP / 20e6) ** 2)
    results = [
        fit(SWEEP, clean + 0.02 * rng.normal(size=SWEEP.size)) for _ in range(300)
    ]
    found = np.array([result.cut_off for result in results])
    stated = np.mean([result.cut_off_standard_error for result in results])
    # 300 repeats know a standard deviation to 1/sqrt(600) = 4 %; four of these.
    assert_allclose(found.std(ddof=1), stated, rtol=0.16)
    assert abs(found.mean() - 20e6) < 4 * stated / np.sqrt(300)


@given(scale=st.floats(0.01, 100.0))
@drawn
def test_fit_scales_with_the_unit_of_frequency(scale):
    amplitude = np.exp(-SWEEP / 40e6)
    plain = fit(SWEEP, amplitude)
    scaled = fit(scale * SWEEP, amplitude)
    assert_allclose(scaled.cut_off, scale * plain.cut_off, rtol=1e-7)
    assert_allclose(
        scaled.cut_off_standard_error, scale * plain.cut_off_standard_error, rtol=1e-6
    )


def test_result_of_a_fit_cannot_be_changed():
    result = fit(SWEEP, 1 / np.sqrt(1 + (SWEEP / 2e7) ** 2))
    with pytest.raises(AttributeError):
        result.cut_off = 1.0


@pytest.mark.parametrize(
    ("frequency", "amplitude", "text"),
    [
        ([1.0, 2.0], [1.0, 0.5], "at least 3 long"),
        ([1.0, 1.0, 2.0], [1.0, 1.0, 0.5], "at least 3 different values"),
        ([1.0, 2.0, 3.0], [1.0, 0.5], r"got \(3,\) and \(2,\)"),
        ([1.0, 2.0, -3.0], [1.0, 0.5, 0.2], "modulation_frequency must be finite"),
        ([1.0, 2.0, 3.0], [1.0, np.nan, 0.2], "amplitude must be finite"),
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0], "the largest amplitude must be above 0"),
        ([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], "do not show where they fall"),
        ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], "do not show where they fall"),
    ],
)
@pytest.mark.parametrize("form", [fit, fit_of_power])
def test_data_that_fix_no_cut_off_are_refused(form, frequency, amplitude, text):
    with pytest.raises(ValueError, match=text):
        form(frequency, amplitude)


def test_values_out_of_range_are_refused_by_name():
    with pytest.raises(ValueError, match="modulation_frequency must be finite and not"):
        first_order_response(-1.0, cut_off=1e6)
    with pytest.raises(
        ValueError, match=r"cut_off must be finite and above 0 \[Hz\], got 0"
    ):
        first_order_response(1e6, cut_off=0.0)
    with pytest.raises(ValueError, match="reduced_attenuation must be finite and not"):
        cut_off_of_narrow_receiver(reduced_attenuation=-1.0, group_index=1.34)
    with pytest.raises(ValueError, match=r"group_index .* at least 1, got 0\.9"):
        cut_off_of_narrow_receiver(reduced_attenuation=1.0, group_index=0.9)


# ------------------------------------------------------------------ sampled sweeps


def test_a_sampled_sweep_crosses_on_the_straight_line_between_neighbours():
    # From 1 at 10 MHz to 0 at 20 MHz the level 1/sqrt 2 lies at 20 - 10/sqrt 2 MHz.
    corner = cut_off_of_sweep([0.0, 1e7, 2e7, 3e7], [1.0, 1.0, 0.0, 0.0])
    assert_allclose(corner, 2e7 - 1e7 / np.sqrt(2), rtol=1e-14)


@settings(deadline=None)
@given(st.floats(1e6, 1e8), st.floats(0.1, 1e3))
def test_a_finely_sampled_sweep_has_the_cut_off_of_its_response(corner, scale):
    frequency = np.linspace(0, 3 * corner, 1500)
    sweep = scale * np.abs(first_order_response(frequency, cut_off=corner))
    # A chord of 1/500 of the cut-off errs by 1/8 of its square times the curvature.
    assert_allclose(cut_off_of_sweep(frequency, sweep), corner, rtol=1e-6)


def test_a_sweep_that_stays_above_the_level_has_no_cut_off():
    assert np.isnan(cut_off_of_sweep([0.0, 1e6], [1.0, 0.8]))
    with pytest.raises(ValueError, match=r"modulation_frequency must be rising from 0"):
        cut_off_of_sweep([1.0, 2.0], [1.0, 0.5])
    with pytest.raises(ValueError, match="amplitude at zero frequency must be finite"):
        cut_off_of_sweep([0.0, 2.0], [0.0, 0.5])


@pytest.mark.parametrize(("last", "shown"), [(1e7, False), (4e7, True)])
def test_a_fit_is_shown_where_the_sweep_reaches_beyond_the_cut_off(last, shown):
    frequency = np.linspace(1e6, last, 50)
    sweep = np.abs(first_order_response(frequency, cut_off=2e7))
    result = fit_if_shown(frequency, sweep)
    assert (result is not None) == shown
    if result is not None:
        assert_allclose(result.cut_off, 2e7, rtol=1e-9)


def test_data_that_fix_no_cut_off_show_none():
    assert fit_if_shown([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]) is None
    assert fit_if_shown([1.0, 2.0], [1.0, 2.0]) is None


# ---------------------------------------------------------------- fit of power


@given(corner=st.floats(2e6, 2e8), unit=st.floats(1e-9, 1e9))
@drawn
def test_fit_of_power_returns_what_the_data_were_made_with(corner, unit):
    frequency = np.concatenate([[0.0], SWEEP])
    found = fit_of_power(frequency, unit / np.sqrt(1 + (frequency / corner) ** 2))
    assert_allclose(found.cut_off, corner, rtol=1e-9)
    assert_allclose(found.amplitude_at_zero, unit, rtol=1e-12)


def test_fit_of_power_finds_the_root_of_its_own_condition():
    # Three points of no low-pass. With t = (f / f_c)^2 the sum of (s - 1 / (1 + t))^2
    # is least where the sum of (s - 1 / (1 + t)) t / (1 + t)^2 is 0.
    frequency, square = np.array([0.0, 10e6, 40e6]), np.array([1.0, 0.5, 0.3])
    found = fit_of_power(frequency, 7.0 * np.sqrt(square))
    turned = (frequency / found.cut_off) ** 2
    condition = np.sum((square - 1 / (1 + turned)) * turned / (1 + turned) ** 2)
    assert abs(condition) < 1e-9
    grid = np.geomspace(1e6, 1e9, 20_001)[:, None]
    squares = np.sum((square - 1 / (1 + (frequency / grid) ** 2)) ** 2, axis=1)
    assert_allclose(found.cut_off, grid[np.argmin(squares), 0], rtol=1e-3)


def test_fit_of_power_takes_the_maximum_of_the_data_as_the_level():
    corner = 20e6
    sweep = 1 / np.sqrt(1 + (SWEEP / corner) ** 2)
    # A first sample 10 % too high lowers all others: the free fit hardly minds it.
    high = np.concatenate([[1.1], sweep])
    frequency = np.concatenate([[0.0], SWEEP])
    assert fit_of_power(frequency, high).amplitude_at_zero == 1.1
    assert fit_of_power(frequency, high).cut_off < 0.95 * corner
    assert abs(fit(frequency, high).cut_off / corner - 1) < 0.02


def test_standard_error_of_the_fit_of_power_is_the_scatter_of_repeated_fits():
    rng = np.random.default_rng(3)
    frequency = np.concatenate([[0.0], SWEEP])
    square = 1 / (1 + (frequency / 20e6) ** 2)
    results = []
    for _ in range(300):
        noise = rng.normal(0.0, 0.01, frequency.size)
        # The level is held: the largest of noisy data would be another one each time.
        noise[0], noise[1:] = 0.0, np.minimum(noise[1:], 1 - square[1:])
        results.append(fit_of_power(frequency, np.sqrt(np.abs(square + noise))))
    spread = np.std([result.cut_off for result in results])
    stated = np.mean([result.cut_off_standard_error for result in results])
    # 300 fits: a standard deviation is found within 4 %.
    assert_allclose(stated, spread, rtol=0.15)


FEW = np.array([1.0, 8.0, 20.0, 45.0, 90.0]) * 1e6
AMPLITUDE = np.array([1.95, 1.9, 1.42, 0.83, 0.47])


def test_fit_and_its_error_are_those_of_a_library_for_five_amplitudes():
    def form(frequency, corner, scale):
        return scale / np.sqrt(1 + (frequency / corner) ** 2)

    start = 2e7, 2.0
    best, covariance = curve_fit(form, FEW, AMPLITUDE, p0=start, xtol=1e-14)
    found = fit(FEW, AMPLITUDE)
    assert_allclose([found.cut_off, found.amplitude_at_zero], best, rtol=1e-6)
    error = np.sqrt(covariance[0, 0])
    assert_allclose(found.cut_off_standard_error, error, rtol=1e-4)


def test_fit_of_power_and_its_error_are_those_of_a_library():
    def form(frequency, corner):
        return 1 / (1 + (frequency / corner) ** 2)

    power = (AMPLITUDE / AMPLITUDE.max()) ** 2
    best, covariance = curve_fit(form, FEW, power, p0=2e7, xtol=1e-14)
    found = fit_of_power(FEW, AMPLITUDE)
    assert_allclose(found.cut_off, best[0], rtol=1e-6)
    error = np.sqrt(covariance[0, 0])
    assert_allclose(found.cut_off_standard_error, error, rtol=1e-4)
    assert found.amplitude_at_zero == 1.95


@pytest.mark.parametrize(
    ("corner", "shown"), [(0.8e6, False), (1.1e6, True), (85e6, True), (99e6, False)]
)
def test_a_cut_off_is_shown_between_the_frequencies_of_a_sweep(corner, shown):
    amplitude = 3 / np.sqrt(1 + (FEW / corner) ** 2)
    found = fit_if_shown(FEW, amplitude)
    assert (found is not None) == shown
    if found is not None:
        assert_allclose(found.cut_off, corner, rtol=1e-6)


@pytest.mark.parametrize("corner", [3e3, 2.4e7, 9.9e8])
def test_cut_off_is_found_from_a_millionth_of_the_maximum_on(corner):
    def response(frequency):
        return 5 / (1 - 1j * frequency / corner)

    assert_allclose(cut_off(response), corner, rtol=1e-12)
