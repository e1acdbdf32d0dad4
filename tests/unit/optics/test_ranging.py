"""Claims about phase, slant range, ambiguity interval and range precision."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.optics import ranging
from amulor.optics.water import seawater

TABLE = Path(__file__).parents[2] / "reference" / "phase_of_a_step.csv"

distances = st.floats(1e-3, 50.0)
frequencies = st.floats(1e5, 1e9)
indices = st.floats(1.0, 1.6)


def test_phase_of_a_step_matches_the_published_degrees():
    distance, index, degrees = np.loadtxt(TABLE, delimiter=",", unpack=True)
    phase = ranging.phase(distance, modulation_frequency=39e6, group_index=index)
    # Half of the last digit given.
    assert_allclose(np.degrees(phase), degrees, rtol=0, atol=5.1e-4)


def test_slant_range_of_a_published_phase_is_the_step():
    distance, index, degrees = np.loadtxt(TABLE, delimiter=",", unpack=True)
    steps = ranging.slant_range(
        np.radians(degrees), modulation_frequency=39e6, group_index=index
    )
    # Half of the last digit of the phase, 5e-4 degrees, is 4 um.
    assert_allclose(steps, distance, rtol=0, atol=4.1e-6)


def test_one_centimetre_in_water_at_405_nm_takes_the_group_index():
    group = seawater.group_index(405e-9, temperature=20, salinity=0)
    phase = np.degrees(
        ranging.phase(0.01, modulation_frequency=39e6, group_index=group)
    )
    # 1.293 degrees is published for 1.380; the phase index 1.343 gives 1.258.
    assert_allclose(phase, 1.293, rtol=0, atol=1e-3)


def test_a_phase_of_two_pi_is_half_a_modulation_wavelength():
    # In vacuum at c/2 = 149 896 229 Hz the light goes 1 m there and 1 m back.
    distance = ranging.slant_range(
        2 * np.pi, modulation_frequency=speed_of_light / 2, group_index=1.0
    )
    assert_allclose(distance, 1.0, rtol=1e-15)


def test_ambiguity_interval_at_39_mhz_is_2_87_m():
    interval = ranging.ambiguity_interval(39e6, group_index=1.34)
    assert_allclose(interval, 2.87, rtol=0, atol=0.005)  # printed digits


@settings(deadline=None)
@given(distances, frequencies, indices)
def test_slant_range_undoes_phase(distance, frequency, index):
    phase = ranging.phase(distance, modulation_frequency=frequency, group_index=index)
    back = ranging.slant_range(phase, modulation_frequency=frequency, group_index=index)
    assert_allclose(back, distance, rtol=1e-14)  # five roundings


@settings(deadline=None)
@given(distances, frequencies, indices)
def test_one_ambiguity_interval_further_is_one_turn_more(distance, frequency, index):
    interval = ranging.ambiguity_interval(frequency, group_index=index)
    near, far = ranging.phase(
        [distance, distance + interval],
        modulation_frequency=frequency,
        group_index=index,
    )
    # The difference loses digits where the phase is many turns.
    assert_allclose(far - near, 2 * np.pi, rtol=0, atol=1e-14 * (1 + far))


@settings(deadline=None)
@given(distances, frequencies, indices, st.floats(0.1, 10.0))
def test_phase_depends_on_the_product_of_distance_frequency_and_index(
    distance, frequency, index, factor
):
    phase = ranging.phase(distance, modulation_frequency=frequency, group_index=index)
    same = ranging.phase(
        distance * factor, modulation_frequency=frequency / factor, group_index=index
    )
    assert_allclose(same, phase, rtol=1e-14)  # rounding only


def test_a_quarter_degree_at_39_mhz_is_two_millimetres():
    deviation = ranging.slant_range_uncertainty(
        np.radians(0.25), modulation_frequency=39e6, group_index=1.34
    )
    # 2 mm are 0.251 degrees (published to three decimals).
    assert_allclose(deviation, 2e-3 * 0.25 / 0.251, rtol=2.1e-3)


@settings(deadline=None)
@given(frequencies, indices, st.floats(1e-6, 1e-2))
def test_uncertainty_is_what_a_shift_of_the_phase_does(frequency, index, shift):
    options = {"modulation_frequency": frequency, "group_index": index}
    low, high = ranging.slant_range([1.0, 1.0 + shift], **options)
    deviation = ranging.slant_range_uncertainty(shift, **options)
    # The difference of two numbers near 1 keeps 1e-16 / shift.
    assert_allclose(high - low, deviation, rtol=1e-9)


def test_photon_limit_is_sqrt_2_over_m_sqrt_n_radians():
    # m sqrt(N) = 100: 0.014142 rad, v / (4 pi f) = 0.38062 m at 50 MHz and n = 1.2535.
    deviation = ranging.photon_limited_uncertainty(
        40_000, modulation_depth=0.5, modulation_frequency=50e6, group_index=1.2535
    )
    expected = 0.0141421356 * speed_of_light / (4 * np.pi * 50e6 * 1.2535)
    assert_allclose(deviation, expected, rtol=1e-8)  # digits of the first factor


def test_photon_limit_agrees_with_the_phases_of_drawn_photons():
    rng = np.random.default_rng(2010)
    photons, depth, trials = 1000, 0.7, 3000
    # A Poisson process with the density 1 + m cos(x), thinned out of an even one.
    trial = np.repeat(np.arange(trials), rng.poisson(photons * (1 + depth), trials))
    angle = rng.uniform(0, 2 * np.pi, trial.size)
    kept = rng.uniform(0, 1 + depth, trial.size) < 1 + depth * np.cos(angle)
    trial, angle = trial[kept], angle[kept]
    sums = np.bincount(trial, weights=np.sin(angle), minlength=trials)
    along = np.bincount(trial, weights=np.cos(angle), minlength=trials)
    phase = np.arctan2(sums, along)
    deviation = ranging.slant_range_uncertainty(
        phase.std(), modulation_frequency=39e6, group_index=1.38
    )
    expected = ranging.photon_limited_uncertainty(
        photons, modulation_depth=depth, modulation_frequency=39e6, group_index=1.38
    )
    # A standard deviation of n draws has a relative standard error of 1 / sqrt(2 n);
    # second order in 1 / m sqrt(N) adds some 0.4 %.
    assert_allclose(deviation, expected, rtol=4 / np.sqrt(2 * trials))


@settings(deadline=None)
@given(st.floats(10, 1e9), st.floats(0.01, 1.0), frequencies, indices)
def test_four_times_the_photons_halve_the_uncertainty(count, depth, frequency, index):
    options = {
        "modulation_depth": depth,
        "modulation_frequency": frequency,
        "group_index": index,
    }
    one, four = ranging.photon_limited_uncertainty([count, 4 * count], **options)
    assert_allclose(four, one / 2, rtol=1e-14)  # rounding only


def test_arguments_broadcast():
    phase = ranging.phase(
        np.ones((3, 1)), modulation_frequency=[1e6, 2e6], group_index=1.4
    )
    assert phase.shape == (3, 2)
    assert_allclose(phase[:, 1], 2 * phase[:, 0], rtol=1e-15)


@pytest.mark.parametrize("frequency", [0.0, -1e6, np.nan])
def test_a_modulation_frequency_that_is_not_above_zero_is_refused(frequency):
    with pytest.raises(
        ValueError, match=r"frequency must be finite and above 0 \[Hz\]"
    ):
        ranging.slant_range(1.0, modulation_frequency=frequency, group_index=1.38)


@pytest.mark.parametrize("index", [0.0, 0.99, np.nan])
def test_a_group_index_below_1_is_refused(index):
    with pytest.raises(ValueError, match=r"group_index must be finite and at least 1"):
        ranging.ambiguity_interval(1e6, group_index=index)


def test_negative_distances_and_deviations_are_refused():
    options = {"modulation_frequency": 1e6, "group_index": 1.38}
    with pytest.raises(
        ValueError, match=r"slant_range .* \[m\], got -1 at index \(1,\)"
    ):
        ranging.phase([2.0, -1.0], **options)
    with pytest.raises(ValueError, match=r"uncertainty .* \[rad\], got -0\.1$"):
        ranging.slant_range_uncertainty(-0.1, **options)


@pytest.mark.parametrize(
    ("count", "depth", "text"),
    [
        (0.0, 0.5, "photoelectrons must be above 0"),
        (100.0, 0.0, "modulation_depth must be above 0 and at most 1"),
        (100.0, 1.1, "modulation_depth must be above 0 and at most 1"),
    ],
)
def test_a_photon_limit_without_light_or_modulation_is_refused(count, depth, text):
    with pytest.raises(ValueError, match=text):
        ranging.photon_limited_uncertainty(
            count, modulation_depth=depth, modulation_frequency=1e6, group_index=1.38
        )
