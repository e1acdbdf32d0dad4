"""Claims about photoelectrons, lock-in bandwidth and phase noise."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad

from amulor.optics import detection, ranging

times = st.floats(1e-6, 1e3)
variances = st.floats(1e-6, 1e3)
parts = st.floats(-1e3, 1e3)


def test_a_watt_gives_an_ampere_per_volt_of_photon_energy():
    # Photons of 1239.841984 nm carry 1 eV (CODATA 2018, exact to the digits).
    rate = detection.photoelectron_rate(
        1.0, wavelength=1239.841984e-9, quantum_efficiency=1.0
    )
    assert_allclose(rate * 1.602176634e-19, 1.0, rtol=1e-9)


def test_a_quarter_of_the_photons_of_one_picowatt_at_405_nm():
    # 405 nm is 3.061338 eV, so 1 pW is 2.038817e6 photons a second.
    rate = detection.photoelectron_rate(
        1e-12, wavelength=405e-9, quantum_efficiency=0.25
    )
    assert_allclose(rate, 2.038817e6 / 4, rtol=1e-6)


@settings(deadline=None)
@given(st.floats(0, 1), st.floats(2e-7, 1e-6), st.floats(0.01, 1), st.floats(1, 10))
def test_photoelectrons_depend_on_energy_over_photon_energy(power, length, share, k):
    rate = detection.photoelectron_rate(
        power, wavelength=length, quantum_efficiency=share
    )
    same = detection.photoelectron_rate(
        power * k, wavelength=length / k, quantum_efficiency=share
    )
    assert_allclose(same, rate, rtol=1e-14, atol=1e-300)


def test_effective_time_is_the_average_without_a_filter():
    time = detection.effective_integration_time(
        [0.1, 0.1, 0.1], time_constant=[0.0, 1e-20, 1e-9]
    )
    # T / (1 - tau / T) for tau << T: 1e-8 above T in the last one.
    assert_allclose(time, [0.1, 0.1, 0.1 * (1 + 1e-8)], rtol=1e-15)


def test_effective_time_of_a_single_reading_is_twice_the_time_constant():
    time = detection.effective_integration_time([0.0, 1e-12, 1e-6], time_constant=0.03)
    # 2 tau (1 + x/3) for x = T / tau << 1.
    expected = 0.06 * (1 + np.array([0.0, 1e-12, 1e-6]) / 0.03 / 3)
    # The next term is x^2 / 36, 3e-11 in the last one.
    assert_allclose(time, expected, rtol=4e-11)


@settings(deadline=None)
@given(times, times)
def test_effective_time_is_that_of_the_filtered_autocorrelation(duration, tau):
    assume(1e-6 < duration / tau < 300)
    # Var of the mean is 2/T^2 int (T - t) R dt with R = exp(-t/tau) / 2 tau.
    integral, _ = quad(
        lambda x: (1 - x) * np.exp(-x * duration / tau), 0, 1, epsabs=0, epsrel=1e-12
    )
    expected = tau / integral
    time = detection.effective_integration_time(duration, time_constant=tau)
    assert_allclose(time, expected, rtol=1e-11)  # of quad


def test_series_and_closed_form_of_the_effective_time_meet():
    below, above = np.nextafter(0.5, [0, 1])
    time = detection.effective_integration_time([below, above], time_constant=1.0)
    # The closed form loses one digit here: 1e-16 / (x^2 / 2) = 1e-15.
    assert_allclose(time[1], time[0], rtol=4e-15)


@settings(deadline=None)
@given(times, times, st.floats(1e-3, 1e3))
def test_effective_time_scales_and_stays_between_its_bounds(duration, tau, factor):
    time = detection.effective_integration_time(duration, time_constant=tau)
    assert max(duration, 2 * tau) * (1 - 1e-14) <= time <= duration + 2 * tau
    scaled = detection.effective_integration_time(
        factor * duration, time_constant=factor * tau
    )
    assert_allclose(scaled, factor * time, rtol=1e-13)


def test_effective_time_is_the_variance_of_a_simulated_lock_in():
    rng = np.random.default_rng(405)
    step, tau, duration, trials = 0.02, 1.0, 3.0, 4000
    count = round(duration / step)
    # White noise of unit two-sided density after the pole, in its exact recursion.
    keep = np.exp(-step / tau)
    state = rng.standard_normal(trials) / np.sqrt(2 * tau)
    total = np.zeros(trials)
    for _ in range(count):
        next_state = keep * state + np.sqrt(
            (1 - keep**2) / (2 * tau)
        ) * rng.standard_normal(trials)
        total += (state + next_state) / 2
        state = next_state
    variance = np.var(total / count, ddof=1)
    expected = 1 / detection.effective_integration_time(duration, time_constant=tau)
    # Variance of n draws: relative standard error sqrt(2 / n); the trapezoid adds 1e-5.
    assert_allclose(variance, expected, rtol=4 * np.sqrt(2 / trials))


def drawn_signals(rng, *, rate, depth, phase, time, trials, dark=0.0, gain=None):
    """Lock-in outputs of drawn photoelectrons, 2 / T sum gain exp(i omega t)."""
    mean = (rate * (1 + depth) + dark) * time
    trial = np.repeat(np.arange(trials), rng.poisson(mean, trials))
    angle = rng.uniform(0, 2 * np.pi, trial.size)
    level = rng.uniform(0, rate * (1 + depth) + dark, trial.size)
    kept = level < rate * (1 + depth * np.cos(angle - phase)) + dark
    trial, angle = trial[kept], angle[kept]
    weight = np.ones(angle.size) if gain is None else gain(rng, angle.size)
    in_phase = np.bincount(trial, weights=weight * np.cos(angle), minlength=trials)
    quadrature = np.bincount(trial, weights=weight * np.sin(angle), minlength=trials)
    return 2 / time * (in_phase + 1j * quadrature)


@pytest.mark.parametrize(
    "phase",
    [0.9, *(pytest.param(later, marks=pytest.mark.slow) for later in (0.0, 2.5))],
)
def test_quadrature_variance_is_that_of_drawn_photoelectrons(phase):
    trials = 4000
    signal = drawn_signals(
        np.random.default_rng(41),
        rate=1000.0,
        depth=0.8,
        phase=phase,
        time=0.5,
        trials=trials,
        dark=300.0,
    )
    variance = detection.quadrature_variance(
        1000.0, integration_time=0.5, dark_rate=300.0
    )
    # Relative standard error of a variance, sqrt(2 / n), and 1 / sqrt(n) of the
    # correlation; the peak amplitude is the rate times the depth.
    assert_allclose(np.var(signal.real), variance, rtol=4 * np.sqrt(2 / trials))
    assert_allclose(np.var(signal.imag), variance, rtol=4 * np.sqrt(2 / trials))
    covariance = np.cov(signal.real, signal.imag)[0, 1]
    assert abs(covariance) < 4 * variance / np.sqrt(trials)
    expected = 800.0 * np.exp(1j * phase)
    assert abs(signal.mean() - expected) < 4 * np.sqrt(2 * variance / trials)


def test_excess_noise_multiplies_the_variance():
    # Exponential gains of mean 1 have <g^2> = 2, so F = 2.
    trials = 4000
    signal = drawn_signals(
        np.random.default_rng(43),
        rate=1000.0,
        depth=0.8,
        phase=0.9,
        time=0.5,
        trials=trials,
        gain=lambda rng, size: rng.exponential(size=size),
    )
    variance = detection.quadrature_variance(
        1000.0, integration_time=0.5, excess_noise_factor=2.0
    )
    assert_allclose(np.var(signal.real), variance, rtol=4 * np.sqrt(2 / trials))


def test_phase_error_of_drawn_photoelectrons_is_first_order():
    trials, rate, depth, time = 4000, 500.0, 0.8, 1.0
    signal = drawn_signals(
        np.random.default_rng(47),
        rate=rate,
        depth=depth,
        phase=0.4,
        time=time,
        trials=trials,
    )
    variance = detection.quadrature_variance(rate, integration_time=time)
    expected = detection.phase_uncertainty(
        rate * depth * np.exp(0.4j),
        in_phase_variance=variance,
        quadrature_variance=variance,
    )
    # Standard error 1 / sqrt(2 n) and a second order of about 0.5 %.
    deviation = np.std(np.angle(signal))
    assert_allclose(deviation, expected, rtol=4 / np.sqrt(2 * trials))


@settings(deadline=None)
@given(
    st.floats(1e2, 1e9),
    st.floats(0.01, 1.0),
    st.floats(1e-3, 1e2),
    st.floats(0, 2 * np.pi),
)
def test_phase_error_of_shot_noise_is_sqrt_2_over_m_sqrt_n(rate, depth, time, phase):
    variance = detection.quadrature_variance(rate, integration_time=time)
    deviation = detection.phase_uncertainty(
        rate * depth * np.exp(1j * phase),
        in_phase_variance=variance,
        quadrature_variance=variance,
    )
    assert_allclose(deviation, np.sqrt(2) / (depth * np.sqrt(rate * time)), rtol=1e-13)
    options = {"modulation_frequency": 39e6, "group_index": 1.38}
    assert_allclose(
        ranging.slant_range_uncertainty(deviation, **options),
        ranging.photon_limited_uncertainty(
            rate * time, modulation_depth=depth, **options
        ),
        rtol=1e-13,
    )


def test_the_published_simulation_of_the_photon_limit_is_met():
    # A Monte Carlo gave 0.01420 rad against 0.01429 rad: m sqrt(N) is 98.97.
    variance = detection.quadrature_variance(98.97**2, integration_time=1.0)
    deviation = detection.phase_uncertainty(
        98.97**2, in_phase_variance=variance, quadrature_variance=variance
    )
    assert_allclose(deviation, 0.01429, rtol=0, atol=5e-6)


def test_uncertainties_along_the_axes_swap():
    options = {"in_phase_variance": 4.0, "quadrature_variance": 9.0}
    # Along the in-phase axis the quadrature noise turns and the other one stretches.
    assert detection.phase_uncertainty(100.0, **options) == 0.03
    assert detection.phase_uncertainty(100.0j, **options) == 0.02
    assert detection.amplitude_uncertainty(100.0, **options) == 2.0
    assert detection.amplitude_uncertainty(-100.0j, **options) == 3.0


def test_noise_that_is_correlated_along_the_signal_turns_nothing():
    # All noise lies along (1, 1): so does the first signal, and the other across it.
    options = {
        "in_phase_variance": 4.0,
        "quadrature_variance": 4.0,
        "covariance": 4.0,
    }
    signal = np.array([30 + 30j, 30 - 30j])
    phase = detection.phase_uncertainty(signal, **options)
    amplitude = detection.amplitude_uncertainty(signal, **options)
    # The whole deviation is sqrt(8), the modulus sqrt(1800): 1/15.
    assert_allclose(phase, [0, 1 / 15], rtol=1e-14, atol=1e-9)
    assert_allclose(amplitude, [np.sqrt(8), 0], rtol=1e-14, atol=1e-7)


def test_uncertainties_are_those_of_drawn_correlated_noise():
    trials = 20_000
    covariance = np.array([[4.0, 2.5], [2.5, 9.0]])
    signal = 80.0 - 60.0j
    noise = np.random.default_rng(53).multivariate_normal([0, 0], covariance, trials)
    drawn = signal + noise[:, 0] + 1j * noise[:, 1]
    options = {
        "in_phase_variance": 4.0,
        "quadrature_variance": 9.0,
        "covariance": 2.5,
    }
    # Standard error 1 / sqrt(2 n); the second order is 1e-3 of that.
    assert_allclose(
        np.angle(drawn / signal).std(),
        detection.phase_uncertainty(signal, **options),
        rtol=4 / np.sqrt(2 * trials),
    )
    assert_allclose(
        np.abs(drawn).std(),
        detection.amplitude_uncertainty(signal, **options),
        rtol=4 / np.sqrt(2 * trials),
    )


@settings(deadline=None)
@given(parts, parts, variances, variances, st.floats(-1, 1), st.floats(0, 2 * np.pi))
def test_uncertainties_turn_with_the_axes(i, q, first, second, correlation, angle):
    assume(abs(complex(i, q)) > 1e-3)
    shared = correlation * np.sqrt(first * second)
    matrix = np.array([[first, shared], [shared, second]])
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.array([[cosine, -sine], [sine, cosine]])
    turned = rotation @ matrix @ rotation.T
    assume(turned[0, 1] ** 2 <= turned[0, 0] * turned[1, 1])  # rounding only

    def both(signal, matrix):
        options = {
            "in_phase_variance": matrix[0, 0],
            "quadrature_variance": matrix[1, 1],
            "covariance": matrix[0, 1],
        }
        across = detection.phase_uncertainty(signal, **options) * abs(signal)
        return np.array([across, detection.amplitude_uncertainty(signal, **options)])

    here = both(complex(i, q), matrix)
    there = both(complex(i, q) * np.exp(1j * angle), turned)
    # Variances are rounded to 1e-15 of their sum, and the root is taken of it.
    assert_allclose(there**2, here**2, rtol=0, atol=1e-13 * (first + second))
    # Across and along take all of the noise.
    assert_allclose((here**2).sum(), first + second, rtol=1e-13)


def test_a_signal_of_zero_has_no_phase_and_the_largest_amplitude_noise():
    options = {
        "in_phase_variance": 2.0,
        "quadrature_variance": 2.0,
        "covariance": 1.0,
    }
    assert detection.phase_uncertainty(0.0, **options) == np.inf
    # Eigenvalues of [[2, 1], [1, 2]] are 1 and 3.
    assert_allclose(
        detection.amplitude_uncertainty(0.0, **options), np.sqrt(3), rtol=1e-15
    )


def test_missing_samples_stay_missing():
    signal = np.array([3 + 4j, np.nan])
    options = {"in_phase_variance": 1.0, "quadrature_variance": 1.0}
    for deviation in (
        detection.phase_uncertainty(signal, **options),
        detection.amplitude_uncertainty(signal, **options),
        detection.quadrature_variance([1.0, np.nan], integration_time=1.0),
        detection.photoelectron_rate(
            [1.0, np.nan], wavelength=4e-7, quantum_efficiency=0.2
        ),
    ):
        assert_array_equal(np.isnan(deviation), [False, True])


def test_arguments_broadcast():
    rate = detection.photoelectron_rate(
        np.ones((3, 1)), wavelength=[4e-7, 5e-7], quantum_efficiency=0.2
    )
    assert rate.shape == (3, 2)
    variance = detection.quadrature_variance(rate, integration_time=np.ones(2))
    assert variance.shape == (3, 2)
    time = detection.effective_integration_time(np.ones((3, 1)), time_constant=[0, 1])
    assert time.shape == (3, 2)
    for function in (detection.phase_uncertainty, detection.amplitude_uncertainty):
        deviation = function(
            np.ones((3, 1)), in_phase_variance=[1, 2], quadrature_variance=1.0
        )
        assert deviation.shape == (3, 2)


@pytest.mark.parametrize(
    ("power", "wavelength", "efficiency", "text"),
    [
        (-1.0, 4e-7, 0.2, "power must be not negative, .* got -1"),
        (1.0, 0.0, 0.2, "wavelength must be finite and above 0"),
        (1.0, 4e-7, 0.0, "quantum_efficiency must be above 0 and at most 1"),
        (1.0, 4e-7, 20.0, "quantum_efficiency must be above 0 and at most 1"),
    ],
)
def test_impossible_light_is_refused(power, wavelength, efficiency, text):
    with pytest.raises(ValueError, match=text):
        detection.photoelectron_rate(
            power, wavelength=wavelength, quantum_efficiency=efficiency
        )


@pytest.mark.parametrize(
    ("duration", "tau", "text"),
    [
        (-1.0, 0.1, "duration must be finite and not negative"),
        (1.0, -0.1, "time_constant must be finite and not negative"),
        (np.inf, 0.1, "duration must be finite"),
        (0.0, 0.0, r"duration \+ time_constant must be above 0"),
    ],
)
def test_impossible_times_are_refused(duration, tau, text):
    with pytest.raises(ValueError, match=text):
        detection.effective_integration_time(duration, time_constant=tau)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"photoelectron_rate": -1.0}, "photoelectron_rate must be not negative"),
        ({"integration_time": 0.0}, "integration_time must be finite and above 0"),
        (
            {"excess_noise_factor": 0.9},
            "excess_noise_factor must be finite and at least 1",
        ),
        ({"dark_rate": -1.0}, "dark_rate must be not negative"),
    ],
)
def test_impossible_noise_is_refused(options, text):
    good = {"photoelectron_rate": 1e3, "integration_time": 1.0}
    with pytest.raises(ValueError, match=text):
        detection.quadrature_variance(**(good | options))


def test_impossible_moments_are_refused():
    for function in (detection.phase_uncertainty, detection.amplitude_uncertainty):
        with pytest.raises(ValueError, match="in_phase_variance must be not negative"):
            function(1.0, in_phase_variance=-1.0, quadrature_variance=1.0)
        with pytest.raises(ValueError, match="do not belong to one random pair"):
            function(
                1.0, in_phase_variance=1.0, quadrature_variance=1.0, covariance=1.1
            )


@settings(deadline=None)
@given(st.floats(0.1, 100), st.floats(1e-6, 10))
def test_a_settled_sample_averages_what_the_dwell_leaves(ratio, tau):
    time = detection.settled_integration_time(ratio * tau, time_constant=tau)
    left = max(ratio - 5, 0.0) * tau
    # Between a plain average of what is left and that after a filter of two tau more.
    assert max(left, 2 * tau) * (1 - 1e-12) <= time <= (left + 2 * tau) * (1 + 1e-12)


def test_a_dwell_of_the_settling_alone_takes_one_reading():
    for dwell in (0.0, 0.03, 0.05):
        time = detection.settled_integration_time(dwell, time_constant=0.01)
        # One reading behind a one-pole filter: two time constants.
        assert_allclose(time, 0.02, rtol=1e-14)


@settings(deadline=None)
@given(st.floats(1e-14, 1e-9), st.floats(1e-3, 10), st.floats(0.01, 1), st.floats(0, 1))
def test_photon_noise_is_the_counting_variance_of_an_amplitude(volt, time, depth, size):
    # An amplitude A of light modulated by m belongs to A / (m k) photoelectrons/s.
    rate = size / (depth * volt)
    variance = volt**2 * detection.quadrature_variance(rate, integration_time=time)
    per_volt = detection.photon_noise(time, volt_per_photoelectron_rate=volt)
    assert_allclose(per_volt * size / depth, variance, rtol=1e-13, atol=1e-300)


@settings(deadline=None)
# The square of a phase of 1e-161 is 0 as a number.
@given(
    st.floats(1e-3, 1e3),
    st.floats(-4, 4).map(lambda phase: round(phase, 9)),
    st.floats(0, 0.5),
)
def test_a_phase_floor_is_all_phase_and_no_amplitude(size, phase, floor):
    signal = size * np.exp(1j * phase)
    in_phase, quadrature, covariance = detection.phase_floor_covariance(
        signal, phase_floor=floor
    )
    moments = {
        "in_phase_variance": in_phase,
        "quadrature_variance": quadrature,
        "covariance": covariance,
    }
    assert_allclose(
        detection.phase_uncertainty(signal, **moments), floor, rtol=1e-7, atol=1e-12
    )
    # What is left of a difference of two equal numbers: the root of 1e-16.
    along = detection.amplitude_uncertainty(signal, **moments)
    assert_allclose(along, 0.0, atol=1e-7 * size)


def test_a_phase_floor_spreads_drawn_signals_as_it_says():
    rng = np.random.default_rng(3)
    signal, floor, count = 3 - 4j, 0.01, 200_000
    drawn = signal * np.exp(1j * floor * rng.standard_normal(count))
    expected = detection.phase_floor_covariance(signal, phase_floor=floor)
    found = np.cov(drawn.real, drawn.imag)
    # A variance of n draws has the relative standard error sqrt(2 / n): 0.3 %; and
    # second order adds floor^2: 0.01 %.
    assert_allclose(found[[0, 1, 0], [0, 1, 1]], expected, rtol=0.02)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: detection.phase_floor_covariance(1j, phase_floor=-0.1), "phase_floor"),
        (
            lambda: detection.photon_noise(0.0, volt_per_photoelectron_rate=8e-12),
            "integration_time",
        ),
        (
            lambda: detection.photon_noise(1.0, volt_per_photoelectron_rate=0.0),
            "volt_per_photoelectron_rate",
        ),
        (
            lambda: detection.settled_integration_time(-1.0, time_constant=1.0),
            "dwell",
        ),
        (
            lambda: detection.settled_integration_time(1.0, time_constant=0.0),
            "time_constant",
        ),
    ],
)
def test_noise_formulas_refuse_what_is_out_of_range(call, words):
    with pytest.raises(ValueError, match=words):
        call()
