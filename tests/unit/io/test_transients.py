"""Histogram files become cubes: coefficients, their noise, coordinates, refusals."""

import cmath
import io
import math
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor import cube as cubes
from amulor.errors import FormatError
from amulor.io import (
    Histograms,
    medium_from_minimum,
    read_histograms,
    read_transients,
)
from amulor.io import histograms as fourier

WIDTH = 16e-12
FREQUENCY = np.array([50e6, 100e6, 1e9])
RNG = np.random.default_rng(20100958360)
SCAN = RNG.poisson(30, size=(3, 4, 50))


def saved(folder, name="scan.npz", **fields):
    path = Path(folder) / name
    np.savez_compressed(path, **({"counts": SCAN, "bin_width_s": WIDTH} | fields))
    return path


def signal_of(cube):
    return cube.amulor.signal.isel(polarization=0).values


# Coefficients


def test_a_single_photon_has_the_phase_of_the_centre_of_its_bin(tmp_path):
    counts = np.zeros((1, 1, 40), dtype=int)
    counts[0, 0, 7] = 1
    cube = read_transients(saved(tmp_path, counts=counts), FREQUENCY)
    assert_allclose(cube.amulor.amplitude.values.ravel(), 1, rtol=1e-12)
    delay = 2 * np.pi * FREQUENCY * 7.5 * WIDTH
    assert_allclose(cube.amulor.phase.values.ravel(), delay, rtol=1e-12)


def test_a_scene_without_a_photon_is_refused_and_one_photon_is_enough(tmp_path):
    counts = np.zeros((2, 2, 3, 40), dtype=int)
    counts[1, 1, 2, 7] = 1
    path = saved(tmp_path, counts=counts)
    with pytest.raises(FormatError, match="scene 0 holds no photon in any of its 6"):
        read_transients(path, FREQUENCY, scene=0)
    cube = read_transients(path, FREQUENCY, scene=1)
    assert cube["in_phase"].notnull().sum() == FREQUENCY.size


def test_signal_and_covariance_are_the_plain_sums_over_bins(tmp_path):
    cube = read_transients(saved(tmp_path), FREQUENCY)
    for (row, column), histogram in zip(
        np.ndindex(3, 4), SCAN.reshape(-1, 50), strict=True
    ):
        for number, frequency in enumerate(FREQUENCY):
            place = {
                "modulation_frequency": number, "polarization": 0,
                "row": row, "column": column,
            }  # fmt: skip
            turns = [
                cmath.exp(2j * math.pi * frequency * (k + 0.5) * WIDTH)
                for k in range(50)
            ]
            pairs = list(zip(histogram.tolist(), turns, strict=True))
            found = cube.isel(place)
            assert_allclose(
                complex(found["in_phase"], found["quadrature"]),
                sum(n * g for n, g in pairs),
                rtol=1e-12,
            )
            assert_allclose(
                [
                    found["in_phase_uncertainty"] ** 2,
                    found["quadrature_uncertainty"] ** 2,
                    found["in_phase_quadrature_covariance"],
                ],
                [
                    sum(n * g.real**2 for n, g in pairs),
                    sum(n * g.imag**2 for n, g in pairs),
                    sum(n * g.real * g.imag for n, g in pairs),
                ],
                rtol=1e-12,
            )


def test_bins_damp_a_gaussian_pulse_by_the_sinc_of_the_bin_width(tmp_path):
    # 1e14 photons: rounding to whole counts is a relative error below 1e-12.
    edges = np.arange(401) * WIDTH
    centre, spread = 3.21e-9, 100e-12
    share = [
        0.5 * math.erf((edge - centre) / (spread * math.sqrt(2))) for edge in edges
    ]
    counts = np.round(1e14 * np.diff(share)).astype(np.int64).reshape(1, 1, -1)
    signal = signal_of(read_transients(saved(tmp_path, counts=counts), FREQUENCY))
    omega = 2 * np.pi * FREQUENCY
    expected = 1e14 * np.exp(1j * omega * centre - (omega * spread) ** 2 / 2)
    damping = np.sin(omega * WIDTH / 2) / (omega * WIDTH / 2)
    assert_allclose(signal.ravel(), expected * damping, rtol=1e-11)
    # The size that the docstring states, at 1 GHz.
    assert_allclose(1 - damping[-1], 4.2e-4, atol=5e-6)


def coefficients(counts, frequency, **options):
    histograms = Histograms(
        path=Path("drawn.npz"), digest="", counts=counts, bin_width=WIDTH, labels=(),
        thickness=None, direct_counts=None,
    )  # fmt: skip
    frequency = fourier.checked_frequency(histograms, frequency)
    return fourier.transform(counts, fourier.weights(histograms, frequency, **options))


@settings(deadline=None)
@given(
    shift=st.integers(0, 20),
    counts=st.lists(st.integers(0, 2**32), min_size=30, max_size=30),
    frequency=st.floats(1e6, 3e10),
)
def test_a_later_pulse_turns_the_phase_forwards(shift, counts, frequency):
    early = np.array([[*counts, *[0] * 20]])
    first = coefficients(early, frequency)
    second = coefficients(np.roll(early, shift, axis=-1), frequency)
    turn = np.exp(2j * np.pi * frequency * shift * WIDTH)
    assert_allclose(
        second.signal, first.signal * turn, rtol=0, atol=1e-12 * (1 + early.sum())
    )


@settings(deadline=None)
@given(start=st.floats(-1e-8, 1e-8))
def test_the_time_of_emission_only_turns_the_phase(start):
    plain = coefficients(SCAN, FREQUENCY)
    moved = coefficients(SCAN, FREQUENCY, time_of_emission=start)
    turn = np.exp(-2j * np.pi * FREQUENCY * start)[:, None, None]
    assert_allclose(moved.signal, plain.signal * turn, atol=1e-9, rtol=0)
    # Every photon adds 1 to the sum of the two variances, whatever its phase.
    for each in (plain, moved):
        total = each.variance_in_phase + each.variance_quadrature
        assert_allclose(total, np.broadcast_to(SCAN.sum(axis=-1), total.shape))


def test_blocks_give_what_one_product_gives(tmp_path, monkeypatch):
    histograms = read_histograms(saved(tmp_path))
    weight = fourier.weights(histograms, FREQUENCY)
    whole = fourier.transform(SCAN, weight)
    monkeypatch.setattr(fourier, "BLOCK", 70)
    parts = fourier.transform(SCAN, weight)
    assert_allclose(parts.signal, whole.signal, rtol=1e-13)
    assert_allclose(parts.covariance, whole.covariance, atol=1e-10)
    assert_allclose(parts.variance_in_phase, whole.variance_in_phase, rtol=1e-13)
    assert_allclose(parts.variance_quadrature, whole.variance_quadrature, rtol=1e-13)


# Noise


def assert_states_the_scatter(values, variance, *, kurtosis_factor=2.0):
    """Compare a sample variance with the stated one, within 4 standard errors.

    A sample variance of n nearly Gaussian values strays by sqrt(2 / n) of itself.
    """
    scatter = np.var(values, ddof=1, axis=-1)
    error = np.sqrt(kurtosis_factor / values.shape[-1])
    assert_allclose(scatter / variance, 1, rtol=0, atol=4 * error)


@pytest.mark.parametrize("background_bins", [None, (0, 12)])
def test_stated_covariance_is_the_scatter_of_repeated_counts(tmp_path, background_bins):
    repeats = 10_000
    mean = 5 + 200 * np.exp(-0.5 * ((np.arange(60) - 25) / 4) ** 2)
    counts = np.random.default_rng(1).poisson(mean, size=(1, repeats, 60))
    cube = read_transients(
        saved(tmp_path, counts=counts), [300e6, 2e9], background_bins=background_bins
    )
    signal = signal_of(cube)[:, 0, :]
    one = cube.isel(polarization=0, row=0)
    in_phase = (one["in_phase_uncertainty"].values ** 2).mean(axis=-1)
    quadrature = (one["quadrature_uncertainty"].values ** 2).mean(axis=-1)
    cross = one["in_phase_quadrature_covariance"].values.mean(axis=-1)
    assert_states_the_scatter(signal.real, in_phase)
    assert_states_the_scatter(signal.imag, quadrature)
    centred = signal - signal.mean(axis=-1, keepdims=True)
    product = centred.real * centred.imag
    error = product.std(axis=-1) / np.sqrt(repeats)
    assert np.all(np.abs(product.mean(axis=-1) - cross) < 4 * error)
    # With 2 GHz over 60 bins of 16 ps the two outputs are far from independent.
    assert np.all(np.abs(cross) > 10 * error)


def test_the_background_of_named_bins_is_taken_off_every_bin(tmp_path):
    light = np.zeros((1, 1, 60), dtype=int)
    light[0, 0, 30:40] = 1000
    clean = read_transients(saved(tmp_path, counts=light), FREQUENCY)
    lifted = read_transients(
        saved(tmp_path, counts=light + 77), FREQUENCY, background_bins=(5, 25)
    )
    assert_allclose(signal_of(lifted), signal_of(clean), rtol=1e-12)
    assert np.all(lifted["in_phase_uncertainty"] > clean["in_phase_uncertainty"])


def test_a_pixel_without_a_photon_is_not_a_number(tmp_path):
    counts = SCAN.copy()
    counts[1, 2] = 0
    cube = read_transients(saved(tmp_path, counts=counts), FREQUENCY)
    dark = np.isnan(cube["in_phase"].isel(modulation_frequency=0, polarization=0))
    assert_array_equal(np.argwhere(dark.values), [[1, 2]])
    assert np.isnan(cube["quadrature_uncertainty"].isel(row=1, column=2)).all()


# The cube


def test_every_kind_of_file_keeps_the_schema(tmp_path):
    scenes = saved(
        tmp_path, "scenes.npz", counts=np.stack([SCAN, SCAN]), distance_label=[54, 78]
    )
    slabs = saved(
        tmp_path, "slabs.npz", counts=SCAN[0], thickness_inch=[1, 2, 3, 4],
        direct_counts=SCAN[0, 0],
    )  # fmt: skip
    floats = saved(tmp_path, "floats.npz", counts=SCAN.astype(float))
    columns_first = saved(tmp_path, "order.npz", counts=np.asfortranarray(SCAN))
    expected = read_transients(saved(tmp_path), FREQUENCY)
    for cube in (
        expected,
        read_transients(scenes, FREQUENCY, scene=1),
        read_transients(floats, FREQUENCY),
        read_transients(columns_first, FREQUENCY),
        read_transients(slabs, FREQUENCY),
    ):
        cubes.check(cube, "samples")
        assert cube.attrs["simulated"] == 0
        shape = (cube.sizes["row"], cube.sizes["column"])
        assert shape in [(3, 4), (1, 4)]
        if shape == (3, 4):
            assert_array_equal(cube["in_phase"], expected["in_phase"])
    assert_allclose(cube["user_thickness"], [0.0254, 0.0508, 0.0762, 0.1016])
    assert_array_equal(signal_of(cube)[:, 0], signal_of(expected)[:, 0])


def test_a_scene_is_chosen_by_its_number(tmp_path):
    counts = np.stack([SCAN, 2 * SCAN])
    path = saved(tmp_path, counts=counts, distance_label=[54, 78])
    first, second = (read_transients(path, FREQUENCY, scene=n) for n in (0, 1))
    assert_allclose(signal_of(second), 2 * signal_of(first), rtol=1e-12)
    assert (first.attrs["scene_label"], second.attrs["scene_label"]) == ("54", "78")


def test_beams_of_a_confocal_scan_are_parallel_and_start_over_the_square(tmp_path):
    path = saved(tmp_path)
    cube = read_transients(path, FREQUENCY, scan_side=0.6)
    assert_array_equal(cube["azimuth"], np.zeros((3, 4)))
    assert_array_equal(cube["elevation"], np.zeros((3, 4)))
    assert_allclose(cube["origin_x"].isel(row=1), [-0.3, -0.1, 0.1, 0.3])
    assert_allclose(cube["origin_y"].isel(column=1), [-0.3, 0.0, 0.3], atol=1e-16)
    turned = read_transients(path, FREQUENCY, scan_side=0.6, first_axis="right")
    assert_array_equal(turned["origin_x"], cube["origin_y"])
    assert_array_equal(turned["origin_y"], cube["origin_x"])
    assert "origin_x" not in read_transients(path, FREQUENCY).coords


def test_the_cube_says_what_it_was_made_from(tmp_path):
    path = saved(tmp_path)
    attributes = read_transients(path, FREQUENCY).attrs
    assert attributes["input_digests"] == f"scan.npz {cubes.digest(path)}"
    assert attributes["bin_width"] == WIDTH
    assert "import transients scan.npz" in attributes["history"]
    assert "license" not in attributes


def test_frequencies_between_the_harmonics_of_the_source_are_named(tmp_path):
    path = saved(tmp_path)
    cube = read_transients(path, [10e6, 36.7e6, 50e6], repetition_frequency=10e6)
    assert_array_equal(cube.attrs["frequencies_between_harmonics"], [36.7e6])
    cube = read_transients(path, [10e6, 50e6], repetition_frequency=10e6)
    assert "frequencies_between_harmonics" not in cube.attrs


# The medium


def test_the_minimum_finds_a_medium_that_one_scene_always_shows(tmp_path):
    medium = RNG.integers(1, 50, size=(3, 4, 60))
    scenes = np.stack([medium, medium])
    scenes[0, ..., 10:20] += 300
    scenes[1, ..., 35:50] += 300
    shots = medium_from_minimum(saved(tmp_path, counts=scenes), FREQUENCY)
    alone = read_transients(saved(tmp_path, "alone.npz", counts=medium), FREQUENCY)
    found = (shots["in_phase"] + 1j * shots["quadrature"]).values[:, 0]
    assert_allclose(found, signal_of(alone).reshape(3, 12), rtol=1e-12)
    cube = read_transients(saved(tmp_path, counts=scenes), FREQUENCY, scene=0)
    cubes.check(cubes.attach(cube, shots, "open_water"))


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), scenes=st.integers(2, 4))
def test_shots_add_up_to_the_minimum_of_the_summed_scenes(
    tmp_path_factory, seed, scenes
):
    counts = np.random.default_rng(seed).poisson(3, size=(scenes, 2, 3, 20))
    counts[..., 0] += 1
    folder = tmp_path_factory.mktemp("minimum")
    shots = medium_from_minimum(saved(folder, counts=counts), FREQUENCY)
    smallest = counts.sum(axis=(1, 2)).min(axis=0).reshape(1, 1, -1)
    total = read_transients(
        saved(folder, "minimum.npz", counts=smallest), FREQUENCY
    ).isel(row=0, column=0)
    for name in ("in_phase", "quadrature"):
        assert_allclose(shots[name].sum("shot"), total[name], atol=1e-9)
        # Equal variances, so that no shot weighs more; together that of the counts.
        variance = shots[f"{name}_uncertainty"] ** 2
        assert_allclose(variance.sum("shot"), total[f"{name}_uncertainty"] ** 2)
        assert_allclose(variance.std("shot"), 0, atol=1e-12)


def test_the_minimum_of_two_noisy_scenes_is_low_by_what_is_stated():
    # The stated bias, sqrt(mean / pi), holds for nearly Gaussian counts.
    mean, repeats = 3000.0, 40_000
    pairs = np.random.default_rng(2).poisson(mean, size=(2, repeats))
    low = mean - pairs.min(axis=0)
    assert abs(low.mean() - np.sqrt(mean / np.pi)) < 4 * low.std() / np.sqrt(repeats)


def test_one_scene_alone_does_not_show_the_medium(tmp_path):
    with pytest.raises(FormatError, match=r"has 1 scene, but .* needs at least 2"):
        medium_from_minimum(saved(tmp_path), FREQUENCY)


# Refusals


def assert_one_line(error, path, *words):
    text = str(error.value)
    assert "\n" not in text
    for word in (Path(path).name, *words):
        assert word in text


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"counts": SCAN + 0.5}, ("'counts'", "whole")),
        ({"counts": np.full((2, 2, 9), np.nan)}, ("'counts'", "whole")),
        ({"counts": SCAN > 3}, ("'counts'", "whole")),
        ({"counts": SCAN - 1000}, ("'counts'", "not negative")),
        ({"counts": SCAN[0, 0]}, ("'counts'", "(50,)", "(rows, columns, bins)")),
        ({"counts": SCAN[None, None]}, ("'counts'", "(1, 1, 3, 4, 50)")),
        ({"counts": SCAN[:, :, :1]}, ("'counts'", "1 bin", "at least 2")),
        ({"counts": SCAN[:0]}, ("'counts'", "no counts")),
        ({"counts": SCAN[0]}, ("'thickness_inch'", "missing")),
        ({"counts": SCAN[0], "thickness_inch": [1, 2]}, ("'thickness_inch'", "(2,)")),
        (
            {"counts": SCAN[0], "thickness_inch": [0, 1, 2, 3]},
            ("'thickness_inch'", "above 0"),
        ),
        ({"counts": np.array(["a", "b"])}, ("'counts'", "<U1", "numbers")),
        ({"bin_width_s": 0.0}, ("'bin_width_s'", "above 0 s")),
        ({"bin_width_s": np.nan}, ("'bin_width_s'", "above 0 s")),
        ({"bin_width_s": [WIDTH, WIDTH]}, ("'bin_width_s'", "one time")),
        ({"distance_label": [1, 2]}, ("'distance_label'", "(2,)", "1 scenes")),
        ({"direct_counts": SCAN[0, 0, :9]}, ("'direct_counts'", "50 bins")),
    ],
)
def test_a_field_that_cannot_be_used_is_named(tmp_path, fields, words):
    path = saved(tmp_path, **fields)
    with pytest.raises(FormatError) as error:
        read_transients(path, FREQUENCY)
    assert_one_line(error, path, *words)


@pytest.mark.parametrize("missing", ["counts", "bin_width_s"])
def test_a_missing_field_is_named(tmp_path, missing):
    fields = {"counts": SCAN, "bin_width_s": WIDTH}
    del fields[missing]
    path = tmp_path / "part.npz"
    np.savez(path, **fields)
    with pytest.raises(FormatError) as error:
        read_transients(path, FREQUENCY)
    assert_one_line(error, path, f"'{missing}' is missing", "needed is an npz file")


@pytest.mark.parametrize(
    ("frequency", "words"),
    [
        (0.0, "above 0 Hz"),
        ([-1e6, 1e6], "above 0 Hz"),
        (np.nan, "finite"),
        ([100e6, 50e6], "sort"),
        ([50e6, 50e6], "twice"),
        (32e9, "3.125e+10 Hz"),
        ([], "at least one"),
        ([[1e6, 2e6]], "(1, 2)"),
        ("fast", "'fast'"),
    ],
)
def test_a_frequency_that_cannot_be_used_is_named(tmp_path, frequency, words):
    path = saved(tmp_path)
    with pytest.raises(FormatError) as error:
        read_transients(path, frequency)
    assert_one_line(error, path, "modulation_frequency", words)


def test_the_highest_frequency_is_where_a_bin_is_half_a_period(tmp_path):
    # There the bins damp by sin(pi/2)/(pi/2) = 0.64, and add up with turning sign:
    # exp(i pi (k + 1/2)) = i (-1)^k.
    cube = read_transients(saved(tmp_path), 0.5 / WIDTH)
    assert cube["modulation_frequency"].item() == 0.5 / WIDTH
    expected = 1j * (SCAN[..., ::2].sum(axis=-1) - SCAN[..., 1::2].sum(axis=-1))
    assert_allclose(signal_of(cube)[0], expected, rtol=0, atol=1e-10)
    with pytest.raises(FormatError, match="is too high"):
        read_transients(saved(tmp_path), np.nextafter(0.5 / WIDTH, np.inf))


def test_a_scene_has_to_be_chosen_among_several(tmp_path):
    path = saved(tmp_path, counts=np.stack([SCAN, SCAN]), distance_label=[54, 78])
    for scene in (None, 2, -1):
        with pytest.raises(FormatError) as error:
            read_transients(path, FREQUENCY, scene=scene)
        assert_one_line(error, path, "2 scenes (54, 78)", "0 to 1")


def test_background_bins_have_to_be_bins_of_the_file(tmp_path):
    path = saved(tmp_path)
    for bins in ((0, 51), (-1, 3), (7, 7)):
        with pytest.raises(FormatError) as error:
            read_transients(path, FREQUENCY, background_bins=bins)
        assert_one_line(error, path, "background_bins", "<= 50")


@pytest.mark.parametrize(
    "arguments",
    [
        {"scan_side": 0.0},
        {"first_axis": "left"},
        {"group_index": 0.9},
        {"refractive_index": np.inf},
        {"repetition_frequency": -1.0},
        {"repetition_frequency": 0.0},
        {"repetition_frequency": np.inf},
    ],
)
def test_arguments_out_of_range_are_refused(tmp_path, arguments):
    (name,) = arguments
    with pytest.raises(ValueError, match=name):
        read_transients(saved(tmp_path), FREQUENCY, **arguments)


def test_files_that_are_no_npz_are_refused(tmp_path):
    text = tmp_path / "text.npz"
    text.write_text("bin,counts\n0,1\n")
    single = tmp_path / "single.npy"
    np.save(single, SCAN)
    empty = tmp_path / "empty.npz"
    empty.touch()
    foreign = tmp_path / "foreign.npz"
    with zipfile.ZipFile(foreign, "w") as archive:
        archive.writestr("counts.npy", b"not an array")
        archive.writestr("bin_width_s.npy", b"")
    for path in (text, single, empty, foreign, tmp_path / "none.npz", tmp_path):
        with pytest.raises(FormatError) as error:
            read_transients(path, FREQUENCY)
        assert_one_line(error, path)


class Bomb:
    """Unpickling this would make a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_pickled_objects_are_refused_and_not_loaded(tmp_path):
    trace = tmp_path / "trace"
    path = tmp_path / "bomb.npz"
    np.savez(path, counts=np.array([Bomb(trace)], dtype=object), bin_width_s=WIDTH)
    with pytest.raises(FormatError) as error:
        read_transients(path, FREQUENCY)
    assert_one_line(error, path, "'counts'", "Python objects", "without pickle")
    assert not trace.exists()


def test_an_array_that_claims_to_be_huge_is_refused_at_once(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<u2", "fortran_order": False, "shape": (2**40, 2**10, 9)}
    )
    path = tmp_path / "huge.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("counts.npy", header.getvalue() + bytes(100))
    with pytest.raises(FormatError) as error:
        read_transients(path, FREQUENCY)
    assert_one_line(error, path, "'counts' is damaged")


INTACT = io.BytesIO()
np.savez_compressed(INTACT, counts=SCAN, bin_width_s=WIDTH)


@settings(deadline=None, max_examples=200)
@given(data=st.data())
def test_damage_anywhere_is_refused_or_without_effect(tmp_path_factory, data):
    content = bytearray(INTACT.getvalue())
    kind = data.draw(st.sampled_from(["cut", "flip"]))
    place = data.draw(st.integers(0, len(content) - 1))
    if kind == "cut":
        del content[place:]
    else:
        content[place] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path_factory.mktemp("damage") / "damaged.npz"
    path.write_bytes(content)
    refused = None
    try:
        histograms = read_histograms(path)
    except FormatError as error:
        refused = str(error)
    if refused is None:
        assert kind == "flip"
        assert_array_equal(histograms.counts[0], SCAN)
        assert histograms.bin_width == WIDTH
    else:
        assert "\n" not in refused
        assert "damaged.npz" in refused
