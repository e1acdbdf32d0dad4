"""Samples of a journal, their dark output and their noise, from given records."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from given_journals import journal_of, key, record
from numpy.testing import assert_allclose

from amulor.acquisition.cube import samples as journal_samples
from amulor.acquisition.cube.calibrate import shutter_leakage
from amulor.acquisition.cube.samples import Samples, counting_variance
from amulor.acquisition.plan import DARK, OPEN_WATER, REFERENCE, SCAN, SHUTTER
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Procedure
from amulor.cube.phase_drift import PhaseDrift
from amulor.errors import FormatError
from amulor.survey import Survey

#: Variance of a reading for each photoelectron a second: 2 F / T, F = 1.2, T = 20 ms,
#: times (8e-12 V s)^2.
NOISE = (8e-12) ** 2 * 2 * 1.2 / 0.02
OVERLOAD = int(SampleFlag.OVERLOAD)


@pytest.fixture
def two(small: Survey) -> Survey:
    """Return two frequencies, and dark counts."""
    return small.with_(
        {
            "instrument.modulation_frequencies": ["20 MHz", "39 MHz"],
            "instrument.detector.dark_rate": "1e6 1/s",
        }
    )


def test_a_sample_has_its_place_and_the_newest_take(two: Survey) -> None:
    samples = Samples(two, 3, 5)
    assert samples.values.shape == (2, 2, 3, 5)
    at = key(SCAN, 2, 4, "VH", frequency=39e6)
    for repeat, value in ((1, 3 + 4j), (2, 6 - 8j), (0, 1.0), (2, 5j)):
        samples.put(at._replace(repeat=repeat), record(value, mean=0.5), 2, 4)
    place = samples.values[1, 1, 2, 4]
    assert place["signal"] == 5j
    assert place["raw_amplitude"] == 5
    assert place["mean"] == 0.5
    assert place["takes"] == 4
    assert place["newest"] == 2
    assert math.isnan(place["launch"])
    samples.put(at._replace(repeat=1), record(1.0), 2, 4)
    assert samples["takes"][1, 1, 2, 4] == 5
    assert samples["signal"][1, 1, 2, 4] == 5j
    # Others are missing.
    samples.values[1, 1, 2, 4] = samples.values[0, 0, 0, 0]
    assert np.isnan(samples["signal"]).all()
    assert np.isnan(samples["signal"].imag).all()
    assert np.isnan(samples["raw_amplitude"]).all()
    assert (samples["takes"] == 0).all()
    assert (samples["newest"] == -1).all()
    assert (samples["readings"] == 1).all()


def test_all_samples_of_a_kind_are_filled_in(two: Survey, folder) -> None:
    entries = [
        (key(SCAN, 1, 3, "VH"), record(1j)),
        (key(OPEN_WATER, 1, 2, "VH"), record(7j)),
        (key(SCAN, 2, 0, "VV", frequency=20e6), record(2j)),
    ]
    samples = Samples(two, 3, 5)
    with journal_of(folder, two, entries) as journal:
        samples.fill(journal, SCAN)
    signal = samples["signal"]
    assert np.isfinite(signal).sum() == 2
    assert signal[1, 1, 1, 3] == 1j
    assert signal[0, 0, 2, 0] == 2j


def test_frequencies_are_the_medians_of_those_read_back(two: Survey) -> None:
    samples = Samples(two, 1, 3)
    for column, frequency in enumerate((20.1e6, 20.2e6, 20.4e6)):
        samples["modulation_frequency"][0, 0, 0, column] = frequency
    found = journal_samples.read_back_frequencies(samples, two)
    assert found.tolist() == [20.2e6, 39e6]
    # Frequencies that do not increase are those of the survey.
    for other in (20.2e6, 19e6):
        samples["modulation_frequency"][1] = other
        found = journal_samples.read_back_frequencies(samples, two)
        assert found.tolist() == [20e6, 39e6]


def one(survey: Survey, **quantities: Any) -> Samples:
    samples = Samples(survey, 1, 1)
    for name, value in quantities.items():
        samples[name][:] = value
    return samples


def test_noise_is_that_of_the_mean_output_or_of_the_amplitude(two: Survey) -> None:
    still = Procedure()
    # Modulated light of 1e-6 V at a depth of 0.8: 156,250 photoelectrons a second.
    lower = 1e-6 / (0.8 * 8e-12)
    for mean, rate in ((8e-12 * 5e6, 4e6), (8e-12 * 1e5, 0.0), (np.nan, lower)):
        found = counting_variance(one(two, mean=mean, raw_amplitude=1e-6), two, still)
        assert_allclose(found, NOISE * (rate + 1e6))
    # Neither is known: dark counts are left.
    assert_allclose(counting_variance(one(two), two, still), NOISE * 1e6)


def test_noise_falls_with_the_readings_of_a_dwell(two: Survey) -> None:
    quantities = {"mean": 8e-12 * 5e6, "readings": 3}
    settled = counting_variance(one(two, **quantities), two, Procedure())
    lags = np.abs(np.subtract.outer(np.arange(3), np.arange(3)))
    assert_allclose(settled, NOISE * 5e6 * np.exp(-lags.astype(float)).mean())
    # Readings 5 ms apart, half of a time constant.
    near = counting_variance(one(two, **quantities, interval=5e-3), two, Procedure())
    assert_allclose(near, NOISE * 5e6 * np.exp(-0.5 * lags).mean())
    known = Procedure(output_filter="known")
    # The dwell of 50 ms has three intervals, unless the record says 5 ms.
    for interval, length in ((np.nan, 5 / 3), (5e-3, 0.5)):
        samples = one(two, **quantities, interval=interval)
        expected = NOISE * 5e6 / (3 * math.tanh(length / 2))
        assert_allclose(counting_variance(samples, two, known), expected)


def test_a_measured_noise_replaces_that_of_counting(two: Survey) -> None:
    samples = one(two, mean=8e-12 * 5e6, spread=3e-6, edge=4e-6)
    assert_allclose(counting_variance(samples, two, Procedure()), 25e-12)
    samples = one(two, mean=8e-12 * 5e6, edge=4e-6)
    expected = NOISE * 5e6 + 16e-12
    assert_allclose(counting_variance(samples, two, Procedure()), expected)


def test_light_at_an_edge_is_the_brighter_of_two_measures(two: Survey) -> None:
    moving = Procedure(mode="continuous", output_filter="known", readings="buffer")
    lower = 1e-6 / (0.8 * 8e-12)
    for mean, rate in ((8e-12 * 5e6, 4e6), (8e-12 * 1e6, lower), (np.nan, lower)):
        samples = one(two, mean=mean, raw_amplitude=1e-6, interval=0.01)
        expected = NOISE * (rate + 1e6) / math.tanh(0.5)
        assert_allclose(counting_variance(samples, two, moving), expected)


def test_the_dark_output_is_the_mean_of_each_channel(two: Survey, folder) -> None:
    dark = 8e-12 * 1e6
    entries = [
        # Numbers of a short scan can be high, and differ by channel.
        (key(DARK, pair="VV", repeat=7), record(1 + 1j, mean=dark)),
        (key(DARK, pair="VV", repeat=9), record(3 + 2j, mean=dark)),
        (key(DARK, pair="VV", repeat=11), record(50, mean=dark, flags=OVERLOAD)),
        (key(DARK, pair="VH", repeat=7), record(4j, mean=dark)),
        (key(DARK, pair="VH", frequency=20e6), record(9, flags=OVERLOAD)),
    ]
    with journal_of(folder, two, entries) as journal:
        mean, variance = journal_samples.dark_output(two, journal)
    assert_allclose(mean, [[0, 0], [2 + 1.5j, 4j]])
    assert_allclose(variance, NOISE * 1e6 * np.array([[0, 0], [1 / 2, 1]]))


def test_the_dark_output_has_the_noise_of_its_readings(two: Survey, folder) -> None:
    entries = [
        (key(DARK, pair=pair, frequency=frequency, repeat=repeat),
         record(1, mean=8e-12 * 5e6))
        for pair in ("VV", "VH")
        for frequency in (20e6, 39e6)
        for repeat in (0, 1)
    ]  # fmt: skip
    with journal_of(folder, two, entries) as journal:
        _, variance = journal_samples.dark_output(two, journal)
    assert_allclose(variance, NOISE * 5e6 / 2)


def test_without_dark_readings_there_is_no_dark_output(two: Survey, folder) -> None:
    with journal_of(folder / "a", two, []) as journal:
        mean, variance = journal_samples.dark_output(two, journal)
    assert mean.tolist() == variance.tolist() == [[0, 0], [0, 0]]
    spoiled = [(key(DARK), record(9, flags=OVERLOAD))]
    with journal_of(folder / "b", two, spoiled) as journal:
        mean, variance = journal_samples.dark_output(two, journal)
    assert mean.tolist() == variance.tolist() == [[0, 0], [0, 0]]


def test_readings_of_the_reference_are_means_in_order(
    two: Survey, folder, monkeypatch
) -> None:
    survey = two.with_(
        {
            "scan.reference": {
                "azimuth": "12 deg",
                "elevation": "0 deg",
                "amplitude": "20 mV",
                "readings": 2,
            }
        }
    )
    given: dict[str, Any] = {}
    monkeypatch.setattr(
        PhaseDrift, "of", lambda signal, **more: given.update(more, signal=signal)
    )
    mean = 8e-12 * 5e6
    spoiled = int(SampleFlag.NO_LIGHT)
    entries = [
        # Column 0 is before a row, column 1 before shots: row 2, then the shots.
        (key(REFERENCE, 0, 1), record(5j, mean=mean, elapsed=9.0)),
        (key(REFERENCE, 2, 0), record(2, mean=mean, elapsed=4.0)),
        (key(REFERENCE, 2, 0, repeat=1), record(4, mean=mean, elapsed=6.0)),
        (key(REFERENCE, 1, 0), record(1, mean=mean, elapsed=2.0)),
        (key(REFERENCE, 1, 0, repeat=1), record(7, flags=spoiled, elapsed=3.0)),
        (key(REFERENCE, 0, 0), record(7, flags=OVERLOAD, elapsed=1.0)),
    ]
    with journal_of(folder, survey, entries) as journal:
        dark = np.array([[0, 0], [1j, 0]]), np.zeros((2, 2))
        journal_samples.phase_drift(survey, journal, dark)
    assert_allclose(given["signal"][1, 0], [np.nan, 1 - 1j, 3 - 1j, 4j])
    assert np.isnan(given["signal"][0]).all()
    assert_allclose(given["variance"][1, 0, 1:], NOISE * 5e6 * np.array([1, 0.5, 1]))
    # The missing one has the time of the latest.
    assert_allclose(given["time"][1, 0], [9, 2, 5, 9])
    with journal_of(folder / "b", two, entries) as journal:
        assert journal_samples.phase_drift(two, journal, dark) is None
    with journal_of(folder / "c", survey, []) as journal:
        assert journal_samples.phase_drift(survey, journal, dark) is None


def test_leakage_is_the_mean_of_whole_blocks(small: Survey, folder) -> None:
    """Blocks 0, 2 and 3 of two readings; the third one lacks a channel."""
    entries = [
        (key(SHUTTER, pair=pair, repeat=repeat), record(value, mean=8e-12 * 5e6))
        for pair, factor in (("VV", 1.0), ("VH", 2j))
        for repeat, value in ((0, factor), (1, 3 * factor), (4, 4 * factor))
    ]
    entries.append((key(SHUTTER, repeat=5), record(50, flags=OVERLOAD)))
    entries.append((key(SHUTTER, repeat=6), record(70)))
    procedure = "[shutter]\n[procedure]\nshutter_readings = 2"
    dark = np.array([[0.5, 0.0]]), np.array([[1e-14, 4e-14]])
    with journal_of(folder, small, entries, devices=procedure) as journal:
        first, second = shutter_leakage(small, journal, dark, np.array([39.01e6]))
    assert first.modulation_frequency == second.modulation_frequency == 39.01e6
    assert (first.polarization, second.polarization) == ("VV", "VH")
    # Means of 2 and 4 in two blocks, less the dark output.
    assert_allclose(first.scan, (2.5, 0))
    assert_allclose(second.scan, (0, 6))
    assert first.open_water == first.scan
    assert (first.change, second.change) == (pytest.approx(2), pytest.approx(4))
    # Two readings scatter by 2 about their mean: variance 2 / 2 of each output, by two.
    for leak, size, more in ((first, 1, 1e-14), (second, 2, 4e-14)):
        blocks = [size**2 * 2 / 2 / 2 + more, NOISE * 5e6 + more]
        statistical = math.sqrt(sum(blocks)) / 2
        expected = math.hypot(statistical, 2 * size / math.sqrt(12))
        assert leak.scan_uncertainty == pytest.approx(expected)


def test_leakage_needs_a_block_of_all_channels(small: Survey, folder) -> None:
    dark = np.zeros((1, 2), dtype=complex), np.zeros((1, 2))
    for name, entries in (("a", []), ("b", [(key(SHUTTER), record(1))])):
        with journal_of(folder / name, small, entries) as journal:
            assert shutter_leakage(small, journal, dark, np.array([39e6])) == ()


def test_what_a_journal_does_not_say_is_named(small: Survey, folder) -> None:
    with journal_of(folder / "a", small, [], identities={"laser": 5}) as journal:
        assert journal_samples.identities_of(journal) == {"laser": "5"}
        assert journal_samples.procedure_of(journal) == Procedure()
        with pytest.raises(FormatError) as caught:
            journal_samples.entry(journal, "weather")
        assert str(caught.value) == (
            f"the journal of {folder / 'a'} says nothing about weather; it is damaged, "
            "take a copy of the folder before anything else"
        )
    for name, text in (("b", [1]), ("c", "text")):
        with journal_of(folder / name, small, [], identities=text) as journal:
            with pytest.raises(FormatError) as caught:
                journal_samples.identities_of(journal)
            assert str(caught.value) == (
                f"the identities of the devices in the journal of {folder / name} are "
                "damaged; take a copy of the folder before anything else"
            )
    devices = '[procedure]\nsettling = 7\n[lock_in]\ndriver = "of no package"'
    with journal_of(folder / "d", small, [], devices=devices) as journal:
        assert journal_samples.procedure_of(journal).settling == 7
    for name, text, problem in (
        ("e", "[procedure", "Expected ']' at the end of a table declaration"),
        ("f", "[procedure]\nsettling = -1", "1 validation error for Procedure"),
        # In a file each quantity has its unit.
        ("g", "[procedure]\nposition_tolerance = 1", "1 validation error for Proc"),
    ):
        with journal_of(folder / name, small, [], devices=text) as journal:
            with pytest.raises(FormatError) as caught:
                journal_samples.procedure_of(journal)
            assert str(caught.value).startswith(
                f"the devices in the journal of {folder / name} are damaged ({problem}"
            )
            assert str(caught.value).endswith("); see devices.toml in that folder")
