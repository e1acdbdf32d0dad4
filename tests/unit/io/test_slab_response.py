"""Response of slabs against closed forms, and its uncertainty against scatter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import FormatError
from amulor.io.slab_response import mean_delay, read_slabs, slab_response

WIDTH = 8e-12
FREQUENCY = np.array([50e6, 200e6, 1e9])
BINS = 2000


def saved(folder, **fields):
    path = folder / "slabs.npz"
    np.savez(path, **({"thickness_inch": [1], "bin_width_s": WIDTH} | fields))
    return path


def pulse(*places):
    counts = np.zeros(BINS, dtype=np.int64)
    counts[list(places)] = 10**6
    return counts


def values_of(response):
    return response["amplitude"].values, response["phase"].values


def test_a_slab_that_only_delays_turns_the_phase_and_keeps_the_amplitude(tmp_path):
    path = saved(tmp_path, counts=[3 * pulse(140)], direct_counts=pulse(100))
    slabs = read_slabs(path)
    amplitude, phase = values_of(slab_response(slabs, FREQUENCY))
    assert_allclose(amplitude, 1, rtol=1e-12)
    delay = 40 * WIDTH
    assert_allclose(phase[0], 2 * np.pi * FREQUENCY * delay, rtol=1e-10)
    assert_allclose(mean_delay(slabs), delay, rtol=1e-10)


def test_an_exponential_tail_is_a_first_order_low_pass(tmp_path):
    # A geometric sequence q**k has the transform (1 - q) / (1 - q exp(i w)).
    ratio = 0.98
    tail = np.zeros(BINS)
    tail[100:1000] = np.round(1e15 * ratio ** np.arange(900))
    path = saved(tmp_path, counts=[tail], direct_counts=pulse(100))
    amplitude, phase = values_of(slab_response(read_slabs(path), FREQUENCY))
    turn = np.exp(2j * np.pi * FREQUENCY * WIDTH)
    expected = (1 - ratio) / (1 - ratio * turn)
    # The tail is cut after 900 bins, where 0.98**900 = 1.3e-8 is left.
    assert_allclose(amplitude[0] * np.exp(1j * phase[0]), expected, atol=1e-7)


@settings(deadline=None, max_examples=10)
@given(background=st.integers(0, 10_000), exposure=st.integers(1, 1000))
def test_background_and_exposure_do_not_matter(tmp_path_factory, background, exposure):
    folder = tmp_path_factory.mktemp("slabs")
    slab, direct = pulse(100, 140, 180), pulse(100)
    clean = read_slabs(saved(folder, counts=[slab], direct_counts=direct))
    other = read_slabs(
        saved(folder, counts=[exposure * slab + background], direct_counts=direct + 7)
    )
    found, expected = (
        values_of(slab_response(each, FREQUENCY)) for each in (other, clean)
    )
    assert_allclose(found, expected, rtol=1e-9)


def test_the_background_is_the_median_and_counts_below_it_stay_negative(tmp_path):
    counts = np.random.default_rng(3).poisson(50, size=(2, BINS))
    counts[:, 100:200] += 5000
    slabs = read_slabs(saved(tmp_path, counts=counts[:1], direct_counts=counts[1]))
    assert_array_equal(slabs.counts, counts - np.median(counts, axis=1, keepdims=True))
    assert np.count_nonzero(slabs.counts < 0) > BINS / 2
    assert_array_equal(slabs.background, np.median(counts, axis=1))
    assert_allclose(slabs.thickness, [0.0254])


def test_stated_uncertainty_is_the_scatter_of_repeated_counts(tmp_path):
    # With 8000 dark counts per bin the rounding of the median, 1/12, is nothing beside
    # its variance, 8000 pi / 2 / 2000 = 6.3.
    repeats = 1500
    generator = np.random.default_rng(4)
    time = np.arange(BINS)
    light = 3e4 * np.exp(-np.maximum(time - 100, 0) / 20) * (time >= 100)
    direct = 1e15 * np.exp(-0.5 * ((time - 100) / 3) ** 2)
    path = saved(
        tmp_path,
        counts=generator.poisson(light + 8000, size=(repeats, BINS)),
        thickness_inch=np.arange(1, repeats + 1),
        # So bright that what all repeats share does not count.
        direct_counts=np.round(direct),
    )
    response = slab_response(read_slabs(path), FREQUENCY)
    # A sample variance of nearly Gaussian values strays by sqrt(2 / n); bins with
    # little light that pass for dark ones add some percent.
    tolerance = 4 * np.sqrt(2 / repeats) + 0.05
    for name in ("amplitude", "phase"):
        scatter = response[name].var("thickness", ddof=1).values
        stated = (response[f"{name}_uncertainty"] ** 2).mean("thickness").values
        assert_allclose(scatter / stated, 1, rtol=0, atol=tolerance)


def test_files_without_slabs_or_without_the_direct_light_are_refused(tmp_path):
    path = saved(tmp_path, counts=[pulse(100)])
    with pytest.raises(FormatError, match=r"slabs\.npz: field 'direct_counts'"):
        read_slabs(path)
    path = saved(tmp_path, counts=pulse(100).reshape(2, 2, -1))
    with pytest.raises(FormatError, match=r"slabs\.npz: field 'thickness_inch'"):
        read_slabs(path)


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"counts": [np.full(BINS, 7)], "direct_counts": pulse(5)}, r"counts\[0\]"),
        ({"counts": [pulse(5)], "direct_counts": np.full(BINS, 7)}, "direct_counts"),
    ],
)
def test_a_histogram_without_light_is_refused(tmp_path, fields, word):
    path = saved(tmp_path, **fields)
    with pytest.raises(FormatError, match=rf"slabs\.npz: field '{word}' has no light"):
        read_slabs(path)


def test_a_frequency_out_of_range_is_refused(tmp_path):
    slabs = read_slabs(saved(tmp_path, counts=[pulse(9)], direct_counts=pulse(5)))
    with pytest.raises(FormatError, match=r"slabs\.npz: modulation_frequency"):
        slab_response(slabs, 0.0)
