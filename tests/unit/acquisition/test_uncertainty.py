"""Averaged readings behind a one-pole filter: exact sums, limits, monotony."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.acquisition.cube.samples import Samples, counting_variance
from amulor.acquisition.settings import Procedure
from amulor.acquisition.uncertainty import (
    edge_error,
    reading_variance,
    readings_of,
    variance_ratio,
)
from amulor.optics import detection
from amulor.survey import Survey


@given(number=st.integers(1, 40), spacing=st.floats(1e-3, 20))
def test_the_share_is_the_mean_of_the_correlation_matrix(number, spacing) -> None:
    index = np.arange(number)
    correlation = np.exp(-spacing * np.abs(index[:, None] - index))
    # The closed form divides by (1 - r)^2, which loses 1e-16 / spacing^2.
    assert_allclose(
        variance_ratio(number, spacing=spacing), correlation.mean(), rtol=1e-9
    )


def test_far_apart_readings_are_independent_and_one_is_one() -> None:
    assert_allclose(variance_ratio([1, 4, 25], spacing=50.0), [1, 1 / 4, 1 / 25])


def test_dense_readings_average_like_the_filter_output_itself() -> None:
    # 4001 readings over 4 time constants against the continuous mean.
    duration = 4.0
    time = detection.effective_integration_time(duration, time_constant=1.0)
    single = detection.effective_integration_time(0.0, time_constant=1.0)
    assert_allclose(
        variance_ratio(4001, spacing=duration / 4000), single / time, rtol=1e-3
    )


@given(number=st.integers(1, 1000), spacing=st.floats(0.01, 10))
def test_one_more_reading_never_hurts(number, spacing) -> None:
    more = variance_ratio(number + 1, spacing=spacing)
    assert more < variance_ratio(number, spacing=spacing)


@pytest.mark.parametrize(
    ("readings", "spacing", "what"), [(0, 1.0, "readings"), (3, 0.0, "spacing")]
)
def test_what_is_no_average_is_refused(readings, spacing, what) -> None:
    with pytest.raises(ValueError, match=f"{what} must be"):
        variance_ratio(readings, spacing=spacing)


def test_a_reading_counts_photoelectrons_over_two_time_constants(small: Survey) -> None:
    # 2 F (r + d) / T with F = 1.2, no dark counts, T = 20 ms, times (8e-12 V s)^2.
    found = reading_variance(small, rate=1e6, time_constant=0.01)
    assert_allclose(found, (8e-12) ** 2 * 2 * 1.2 * 1e6 / 0.02, rtol=1e-12)


@pytest.mark.parametrize(
    ("dwell", "number"), [(0.05, 1), (0.0599, 1), (0.06, 2), (0.125, 8)]
)
def test_the_rest_of_a_dwell_is_filled_with_readings(small, dwell, number) -> None:
    scan = small.scan.model_copy(update={"dwell": dwell})
    survey = small.model_copy(update={"scan": scan})
    assert readings_of(survey, settling=5.0) == number


def one_sample(survey: Survey, *, mean: float, amplitude: float) -> Samples:
    samples = Samples(survey, 1, 1)
    samples["mean"][:], samples["raw_amplitude"][:] = mean, amplitude
    return samples


def test_light_is_what_the_mean_output_shows_beyond_dark_counts(small: Survey) -> None:
    survey = small.with_({"instrument.detector.dark_rate": "3e5 1/s"})
    # As above, for light of 1e6 and of 0 photoelectrons a second; below the dark counts
    # there is none.
    for rate, light in ((1e6, 1e6), (0.0, 0.0), (-1e5, 0.0)):
        samples = one_sample(survey, mean=8e-12 * (rate + 3e5), amplitude=1e-9)
        found = counting_variance(samples, survey, Procedure())
        expected = (8e-12) ** 2 * 2 * 1.2 * (light + 3e5) / 0.02
        assert_allclose(found, expected, rtol=1e-9)


def test_a_moving_beam_saw_at_least_the_light_that_was_modulated(small: Survey) -> None:
    moving = Procedure.model_validate(
        {"mode": "continuous", "output_filter": "known", "readings": "buffer"}
    )
    dark, unknown, bright = (
        counting_variance(one_sample(small, mean=mean, amplitude=1e-5), small, moving)
        for mean in (0.0, float("nan"), 1.0)
    )
    assert_allclose(dark, unknown)
    assert (dark < bright).all()
    # Standing still the mean output is that of the sample, and counts.
    still = counting_variance(
        one_sample(small, mean=0.0, amplitude=1e-5), small, Procedure()
    )
    assert (still < unknown).all()


def test_the_error_of_a_step_needs_four_readings() -> None:
    # Inputs of 0, 1 and 2 V, each for 0.1 s, behind a filter of 1 s.
    output = [0.0]
    for value in (0.0, 1.0, 2.0):
        output.append(value + (output[-1] - value) * np.exp(-0.1))
    times = 0.1 * np.arange(4)
    # A step of 2 V over the interval in the middle, of three.
    expected = 2 * 0.1 / 2 / 30**0.5 / 3
    found = edge_error(output, times, time_constant=1.0)
    assert found == pytest.approx(expected)
    assert edge_error(output[:3], times[:3], time_constant=1.0) == 0.0
