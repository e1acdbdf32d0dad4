"""Fields of histogram files: limits, shapes, defaults, codes, gates and weights."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import FormatError
from amulor.io import Histograms, read_histograms
from amulor.io import histograms as fields_of
from amulor.io.dead_time import _at, ready_pulses

PATH = Path("scan.npz")
COUNTS = np.arange(24).reshape(2, 3, 4)


def saved(folder: Path, **fields: Any) -> Path:
    path = folder / "scan.npz"
    given = {"counts": COUNTS, "bin_width_s": 1e-9, **fields}
    np.savez(path, **{key: value for key, value in given.items() if value is not None})
    return path


def drawn(bins: int, *, start: float | None = None) -> Histograms:
    return Histograms(
        path=PATH, digest="", counts=np.ones((1, 1, 1, bins)), bin_width=2.0, labels=(),
        thickness=None, direct_counts=None, start=start,
    )  # fmt: skip


def test_a_plain_file_has_no_further_fields(tmp_path: Path) -> None:
    found = read_histograms(saved(tmp_path))
    assert_array_equal(found.counts, COUNTS[None])
    assert (found.bin_width, found.labels, found.name) == (1e-9, (), "scan.npz")
    assert found.thickness is found.direct_counts is found.counter is None
    assert found.reference is found.noise is found.start is found.water is None
    assert (found.coded, found.periodic) == (False, False)


def test_scenes_slabs_and_labels_keep_their_places(tmp_path: Path) -> None:
    scenes = np.stack([COUNTS, 2 * COUNTS])
    found = read_histograms(
        saved(tmp_path, counts=scenes, distance_label=[54.0, 78.5],
              water_counts=np.arange(4))
    )  # fmt: skip
    assert_array_equal(found.counts, scenes)
    assert found.labels == ("54", "78.5")
    assert_array_equal(found.water, np.arange(4))
    slabs = read_histograms(
        saved(tmp_path, counts=COUNTS[0], thickness_inch=[1.0, 2.0, 0.5],
              direct_counts=np.arange(4))
    )  # fmt: skip
    assert slabs.counts.shape == (1, 1, 3, 4)
    assert_allclose(slabs.thickness, [0.0254, 0.0508, 0.0127])
    assert_array_equal(slabs.direct_counts, np.arange(4))


@pytest.mark.parametrize(
    ("fields", "words"),
    [({"counts": COUNTS[0, 0]}, "field 'counts' has shape (4,); needed is (rows, "),
     ({"counts": COUNTS[..., :1]}, "has 1 bin per histogram, needed are at least 2"),
     ({"counts": COUNTS[:0]}, "has shape (0, 3, 4): no counts"),
     ({"counts": COUNTS + 0.5}, "holds float64 that are not all whole numbers"),
     ({"counts": COUNTS * np.nan}, "holds float64 that are not all whole numbers"),
     ({"counts": COUNTS > 3}, "holds bool that are not all whole numbers"),
     ({"counts": COUNTS - 1}, "holds -1, but a number of photons is not negative"),
     ({"counts": COUNTS + 10**15}, "holds 1e+15 photons in one bin, more than any"),
     ({"direct_counts": np.arange(3)}, "has shape (3,), needed is one histogram of 4"),
     ({"distance_label": [1, 2]}, "one label for each of the 1 scenes"),
     ({"counts": COUNTS[0]}, "'thickness_inch' is missing; 'counts' has 2 dimensions"),
     ({"counts": COUNTS[0], "thickness_inch": [1.0]}, "of shape (1,)"),
     ({"counts": COUNTS[0], "thickness_inch": [1, 2, 0]}, "above 0 inch, found 0"),
     ({"water_counts": np.arange(3)}, "'water_counts' has shape (3,), needed are 4"),
     ({"water_counts": [0, 1, 2, np.inf]}, "'water_counts' has shape (4,)")],
)  # fmt: skip
def test_fields_of_a_wrong_shape_or_size_are_named(tmp_path, fields, words) -> None:
    with pytest.raises(FormatError) as refused:
        read_histograms(saved(tmp_path, **fields))
    assert words in str(refused.value)


def test_whole_numbers_may_be_stored_as_any_number(tmp_path: Path) -> None:
    for kind in (float, np.float32, np.uint8, np.int16):
        found = read_histograms(saved(tmp_path, counts=COUNTS.astype(kind)))
        assert_array_equal(found.counts[0], COUNTS)
    most = np.full((1, 1, 2), 10**15)
    assert read_histograms(saved(tmp_path, counts=most)).counts.max() == 10**15
    turned = np.asfortranarray(COUNTS)
    assert_array_equal(
        read_histograms(saved(tmp_path, counts=turned)).counts[0], COUNTS
    )


@pytest.mark.parametrize(
    ("width", "read"), [(1e-15, True), (0.9e-15, False), (1e-3, True), (1.1e-3, False),
                        (0.0, False), ([1e-9, 1e-9], False), (np.nan, False)],
)  # fmt: skip
def test_a_bin_is_between_a_femtosecond_and_a_millisecond(
    tmp_path, width, read
) -> None:
    path = saved(tmp_path, bin_width_s=width)
    if read:
        assert read_histograms(path).bin_width == width
        return
    with pytest.raises(
        FormatError, match="needed is one time above 0 s, from 1e-15 to"
    ):
        read_histograms(path)


def test_a_counter_is_dead_until_the_next_pulse_unless_stated(tmp_path: Path) -> None:
    counter = read_histograms(saved(tmp_path, cycles=100)).counter
    assert counter is not None
    assert (counter.dead_time, counter.dead_time_uncertainty) == (math.inf, 0.0)
    assert counter.cycles.shape == (1, 2, 3)
    assert set(counter.cycles.ravel()) == {100}
    each = np.arange(1, 7).reshape(2, 3)
    stated = read_histograms(
        saved(tmp_path, cycles=each, dead_time_s=5e-9, dead_time_uncertainty_s=[1e-9])
    ).counter
    assert stated is not None
    assert_array_equal(stated.cycles[0], each)
    assert (stated.dead_time, stated.dead_time_uncertainty) == (5e-9, 1e-9)


@pytest.mark.parametrize(
    ("fields", "refused"),
    [({"cycles": 1}, False), ({"cycles": 0}, True), ({"cycles": 1.0}, True),
     ({"cycles": 9, "dead_time_s": 0.0}, True),
     ({"cycles": 9, "dead_time_s": 1.0, "dead_time_uncertainty_s": 0.99}, False),
     ({"cycles": 9, "dead_time_s": 1.0, "dead_time_uncertainty_s": 1.0}, True),
     ({"cycles": 9, "dead_time_s": 1.0, "dead_time_uncertainty_s": -0.1}, True)],
)  # fmt: skip
def test_a_dead_time_is_above_its_uncertainty(tmp_path, fields, refused) -> None:
    path = saved(tmp_path, **fields)
    if not refused:
        assert read_histograms(path).counter is not None
        return
    with pytest.raises(FormatError, match=r"'cycles' must hold|'dead_time_s' must be"):
        read_histograms(path)


def test_a_code_is_averaged_over_the_bins(tmp_path: Path) -> None:
    # Chips 1, 0, 2 of 1.5 ns: edges at 1.5, 3 and 4.5 ns, in bins of 1 ns.
    path = saved(
        tmp_path, counts=np.ones((1, 1, 6), int), code=[1, 0, 2], chip_s=1.5e-9
    )
    found = read_histograms(path)
    assert_allclose(found.reference, [1, 0.5, 0, 2, 1, 0], atol=1e-12)
    assert (found.coded, found.periodic) == (True, False)
    # Samples of a waveform are middles of their intervals.
    waves = tmp_path / "waves.npz"
    np.savez(waves, waveform=np.ones((1, 1, 4)), sample_interval_s=1e-9, noise_v=0.1,
             code=[1, 0, 2], chip_s=1.5e-9, start_s=1e-9)  # fmt: skip
    read = read_histograms(waves)
    # Means from 0.5 to 1.5, to 2.5, 3.5 and 4.5 ns.
    assert_allclose(read.reference, [1, 0, 1, 2], atol=1e-12)
    assert (read.start, read.noise, read.bin_width) == (1e-9, 0.1, 1e-9)


@pytest.mark.parametrize(("chip", "refused"), [(1.0009, False), (1.0011, True),
                                               (0.9989, True)])  # fmt: skip
def test_a_periodic_code_is_as_long_as_the_record(tmp_path, chip, refused) -> None:
    path = saved(tmp_path, code=[1, 0, 2, 1], chip_s=chip * 1e-9, periodic=1)
    if not refused:
        assert read_histograms(path).periodic
        return
    with pytest.raises(
        FormatError, match=r"a periodic code of .* needs a record of one"
    ):
        read_histograms(path)


def table(folder: Path, rows: list[tuple[float, ...]]) -> Path:
    path = folder / "waves.csv"
    lines = [",".join(f"{value!r}" for value in row) for row in rows]
    path.write_text("row, column,time_s,voltage_v,noise_v\n" + "\n".join(lines) + "\n")
    return path


def test_a_table_of_waveforms_is_sorted_by_pixel_and_time(tmp_path: Path) -> None:
    rows = [(row, column, 1e-9 * k + 5e-9, 100 * row + 10 * column + k, noise)
            for row in (1, 0) for column in (0, 2, 1)
            for k, noise in ((2, 4.0), (0, 3.0), (1, 0.0), (3, 0.0))]  # fmt: skip
    found = read_histograms(table(tmp_path, rows))
    expected = [[[100 * row + 10 * column + k for k in range(4)] for column in range(3)]
                for row in range(2)]  # fmt: skip
    assert_array_equal(found.counts, [expected])
    assert found.bin_width == pytest.approx(1e-9)
    assert found.start == pytest.approx(5e-9)
    # Root mean square of 4, 3, 0 and 0 V.
    assert found.noise == pytest.approx(2.5)
    assert found.thickness is found.direct_counts is found.reference is None


@pytest.mark.parametrize(("shift", "refused"), [(0.9e-3, False), (1.1e-3, True)])
def test_times_of_a_table_have_equal_steps(tmp_path, shift, refused) -> None:
    times = [0.0, 1e-9 * (1 + shift), 2e-9]
    path = table(tmp_path, [(0, 0, time, 1.0, 1.0) for time in times])
    if not refused:
        assert read_histograms(path).bin_width == pytest.approx(1e-9)
        return
    with pytest.raises(FormatError, match="no equal steps"):
        read_histograms(path)


@pytest.mark.parametrize(
    ("waveform", "words"),
    [(np.ones((2, 3)), "has shape (2, 3)"), (np.ones((2, 3, 1)), "has shape (2, 3, 1)"),
     (np.ones((0, 3, 4)), "has shape (0, 3, 4)")],
)  # fmt: skip
def test_a_waveform_has_rows_columns_and_two_samples(tmp_path, waveform, words) -> None:
    path = tmp_path / "waves.npz"
    np.savez(path, waveform=waveform, sample_interval_s=1e-9, noise_v=1.0)
    with pytest.raises(FormatError) as refused:
        read_histograms(path)
    assert words in str(refused.value)
    np.savez(path, waveform=np.ones((1, 1, 2)), sample_interval_s=1e-9, noise_v=0.0)
    with pytest.raises(FormatError, match="'noise_v' is not one number above 0"):
        read_histograms(path)


def test_a_gate_keeps_bins_whose_centers_are_inside() -> None:
    # Centers at 1, 3, 5, 7, 9.
    assert fields_of.within_gate(drawn(5), (2.0, 8.0)).tolist() == [0, 1, 1, 1, 0]
    assert fields_of.within_gate(drawn(5), (3.0, 7.5)).tolist() == [0, 0, 1, 1, 0]
    assert fields_of.within_gate(drawn(5), (2.5, 7.0)).tolist() == [0, 1, 1, 0, 0]
    later = drawn(5, start=4.0)
    assert fields_of.within_gate(later, (5.0, 9.0)).tolist() == [0, 1, 1, 0, 0]
    with pytest.raises(FormatError) as refused:
        fields_of.within_gate(drawn(5), (2.0, 4.0))
    assert str(refused.value) == (
        "scan.npz: the gate from 2 s to 4 s has 1 bins; the record is from 1 s to 9 s"
    )


def test_weights_turn_with_the_centers_of_the_bins() -> None:
    frequency = np.array([0.01, 0.03])
    turn = np.exp(2j * np.pi * np.outer(frequency, [1.0, 3, 5, 7, 9]))
    assert_allclose(fields_of.weights(drawn(5), frequency), turn)
    shifted = np.exp(2j * np.pi * np.outer(frequency, [3.5, 5.5, 7.5, 9.5, 11.5]))
    moved = fields_of.weights(drawn(5, start=4.0), frequency, time_of_emission=0.5)
    assert_allclose(moved, shifted)
    gated = fields_of.weights(drawn(5), frequency, gate=(2.0, 6.0))
    assert_allclose(gated, turn * [0, 1, 1, 0, 0])
    background = fields_of.weights(drawn(5), frequency, background_bins=(1, 3))
    # A constant background adds up to zero.
    assert_allclose(background.sum(axis=1), 0, atol=1e-12)
    assert_allclose(background[:, [0, 3, 4]], turn[:, [0, 3, 4]])
    mean = turn.sum(axis=1) / 2
    assert_allclose(background[:, 1:3], turn[:, 1:3] - mean[:, None])
    fields_of.weights(drawn(5), frequency, background_bins=(0, 5))


def coefficients() -> fields_of.Coefficients:
    return fields_of.Coefficients(
        signal=np.array([[1 + 2j, 3 - 1j]]), variance_in_phase=np.array([[4.0, 1.0]]),
        variance_quadrature=np.array([[9.0, 2.0]]), covariance=np.array([[1.5, -0.5]]),
    )  # fmt: skip


def test_a_factor_turns_signal_and_covariance() -> None:
    found = coefficients().times(np.array([2 - 3j]))
    assert_allclose(found.signal, (2 - 3j) * np.array([[1 + 2j, 3 - 1j]]))
    turn = np.array([[2.0, 3.0], [-3.0, 2.0]])
    for number, before in enumerate(([[4, 1.5], [1.5, 9]], [[1, -0.5], [-0.5, 2]])):
        after = turn @ np.array(before) @ turn.T
        assert found.variance_in_phase[0, number] == pytest.approx(after[0, 0])
        assert found.variance_quadrature[0, number] == pytest.approx(after[1, 1])
        assert found.covariance[0, number] == pytest.approx(after[0, 1])


def test_an_error_along_a_shift_adds_its_square() -> None:
    found = coefficients().with_error(np.array([[3 - 2j, 0.5j]]))
    assert_allclose(found.variance_in_phase, [[4 + 9, 1]])
    assert_allclose(found.variance_quadrature, [[9 + 4, 2.25]])
    assert_allclose(found.covariance, [[1.5 - 6, -0.5]])
    assert_allclose(found.signal, [[1 + 2j, 3 - 1j]])


def test_a_stated_variance_of_bins_replaces_that_of_photons() -> None:
    weight = np.array([[1.0, 1j], [2.0, 1 + 1j]])
    counts, variance = np.array([[3.0, 4.0]]), np.array([[0.5, 0.25]])
    found = fields_of.transform(counts, weight, variance)
    assert_allclose(found.signal[:, 0], [3 + 4j, 10 + 4j])
    assert_allclose(found.variance_in_phase[:, 0], [0.5, 2 + 0.25])
    assert_allclose(found.variance_quadrature[:, 0], [0.25, 0.25])
    assert_allclose(found.covariance[:, 0], [0, 0.25])


def test_ready_pulses_are_those_not_blocked_by_earlier_photons() -> None:
    counts, cycles = np.array([10, 20, 30, 0, 5]), np.array(1000)
    given = {"path": PATH, "period_bins": None}
    found = ready_pulses(counts, cycles, dead_bins=2.0, **given)
    assert_allclose(found, [1000, 990, 970, 950, 970])
    # Half of the bin before counts for a dead time of one bin and a half.
    found = ready_pulses(counts, cycles, dead_bins=1.5, **given)
    assert_allclose(found, [1000, 990, 1000 - 25, 1000 - 40, 1000 - 15])
    # Pulses every 6 bins: photons of the pulse before block for 8 bins, and those in
    # the last bins of the one before that.
    found = ready_pulses(counts, cycles, path=PATH, dead_bins=8.0, period_bins=6.0)
    own, before = np.array([0, 10, 30, 60, 60]), np.array([65, 65, 65, 55, 35])
    assert_allclose(found, 1000 - own - before - [5, 0, 0, 0, 0])
    with pytest.raises(FormatError, match="more photons than a counter with this dead"):
        ready_pulses(counts, np.array(60), dead_bins=np.inf, **given)
    # Each pulse may be detected once.
    assert ready_pulses(counts, np.array(65), dead_bins=np.inf, **given)[-1] == 5


def test_sums_are_interpolated_between_bins() -> None:
    total = np.array([0.0, 10, 30, 60])
    found = _at(total, np.array([-2.0, 0.0, 0.25, 2.5, 3.0, 7.0]))
    assert_allclose(found, [0, 0, 2.5, 45, 60, 60])
