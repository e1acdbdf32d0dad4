"""Least squares of tones in a record: exact noise, limits, clocks, hazard limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.acquisition import demodulation
from amulor.acquisition.demodulation import clock_offset, demodulate
from amulor.acquisition.laser_safety import (
    APERTURE,
    hazard,
    permissible_irradiance,
    pupil_irradiance,
)


def test_noise_is_that_of_the_bins_beside_a_tone() -> None:
    count = 400
    number = np.arange(count)

    def wave(place: int, size: float) -> np.ndarray:
        return size * np.cos(2 * np.pi * place * number / count)

    # A tone at bin 100: bins 83 to 98 and 102 to 117 count, 32 of them.
    for place, counts in (
        (82, False), (83, True), (98, True), (99, False), (101, False), (102, True),
        (117, True), (118, False),
    ):  # fmt: skip
        found = demodulation._noise_beside(wave(place, 0.3), np.array([0.25]))
        # A wave of amplitude a has the mean square a^2 / 2 in each quadrature.
        expected = math.sqrt(0.3**2 / 2 / 32) if counts else 0.0
        assert found == pytest.approx([expected], abs=1e-12), place
    # Undersampled tones are at their alias; bins beside another tone do not count.
    for cycles in (0.75, 1.25, 3.75):
        found = demodulation._noise_beside(wave(110, 0.3), np.array([cycles]))
        assert found == pytest.approx([math.sqrt(0.09 / 2 / 32)])
    two = demodulation._noise_beside(wave(104, 0.3), np.array([0.25, 0.2625]))
    # Bin 104 is one beside bin 105; 29 of 32 are left at both sides.
    assert_allclose(two, 0, atol=1e-12)
    beside = demodulation._noise_beside(wave(102, 0.3), np.array([0.25, 0.2625]))
    assert beside[0] == pytest.approx(math.sqrt(0.09 / 2 / 29))
    # Neither the mean nor the highest bin counts.
    low = demodulation._noise_beside(np.ones(count), np.array([5 / count]))
    assert low == pytest.approx([0], abs=1e-12)
    high = demodulation._noise_beside((-1.0) ** number, np.array([0.49]))
    assert high == pytest.approx([0], abs=1e-12)
    # A record too short for any such bin has the mean of all but the first.
    short = demodulation._noise_beside(
        np.cos(np.pi * np.arange(4) / 2), np.array([0.25])
    )
    assert short == pytest.approx([math.sqrt(0.5 / 2)])


def test_a_record_has_four_samples_for_each_unknown() -> None:
    time = np.arange(12)
    found = demodulate(np.cos(time), sample_rate=1.0, frequencies=[1 / (2 * np.pi)])
    assert found.signals[0] == pytest.approx(1)
    for record, shape in ((np.zeros(11), "(11,)"), (np.zeros((2, 12)), "(2, 12)")):
        with pytest.raises(ValueError, match="need a record of at least 12") as caught:
            demodulate(record, sample_rate=1.0, frequencies=[0.1])
        assert str(caught.value) == (
            "1 frequencies need a record of at least 12 samples, got an array of shape "
            f"{shape}"
        )


def test_blocks_of_a_record_are_joined_with_their_phase(monkeypatch) -> None:
    monkeypatch.setattr(demodulation, "_BLOCK", 7)
    time = np.arange(40) / 10.0
    record = 0.5 + 0.3 * np.cos(2 * np.pi * 1.37 * time - 0.8)
    kept = record.copy()
    found = demodulate(record, sample_rate=10.0, frequencies=[1.37])
    assert found.signals[0] == pytest.approx(0.3 * np.exp(0.8j))
    assert found.offset == pytest.approx(0.5)
    assert found.spreads[0] < 1e-12
    assert record.tolist() == kept.tolist()


def test_tones_that_cannot_be_told_apart_are_refused() -> None:
    with pytest.raises(ValueError, match="do not tell") as caught:
        demodulate(np.zeros(40), sample_rate=1e7, frequencies=[2e6, 8e6])
    assert str(caught.value) == (
        "40 samples at 1e+07 1/s do not tell the frequencies 2, 8 MHz apart: they lie "
        "too close, or alias onto one another; take a longer record or another rate"
    )


@pytest.mark.parametrize("count", [1001, 4096, 20_000])
def test_a_clock_is_found_by_the_turn_between_two_halves(count) -> None:
    rate, offset = 1e6, 5e-5
    time = np.arange(count) / rate
    record = sum(
        size * np.cos(2 * np.pi * f * (1 + offset) * time - 0.3)
        for f, size in ((123_456.0, 1.0), (98_765.0, 0.1))
    )
    found = clock_offset(record, sample_rate=rate, frequencies=[123_456.0, 98_765.0])
    # The fit has the nominal frequencies: an error of second order is left.
    assert found == pytest.approx(offset, rel=1.5e-3)
    # Tones of which one is wrong count by the square of amplitude times frequency.
    mixed = np.cos(2 * np.pi * 123_456.0 * time) + 0.1 * np.cos(
        2 * np.pi * 98_765.0 * (1 + offset) * time
    )
    found = clock_offset(mixed, sample_rate=rate, frequencies=[123_456.0, 98_765.0])
    weight = np.array([123_456.0**2, (0.1 * 98_765.0) ** 2])
    assert found == pytest.approx(offset * weight[1] / weight.sum(), rel=0.1)


def test_limits_change_at_ten_and_a_hundred_seconds() -> None:
    limit = permissible_irradiance
    assert limit(500e-9, exposure=9.99) == pytest.approx(18 * 9.99**-0.25)
    assert limit(650e-9, exposure=10.0) == limit(600e-9, exposure=3e4) == 10.0
    # Blue light below 600 nm: 100 J/m^2 up to 100 s, then 1 W/m^2.
    assert limit(440e-9, exposure=50.0) == pytest.approx(2.0)
    assert limit(440e-9, exposure=100.0) == limit(440e-9, exposure=3e4) == 1.0
    assert limit(460e-9, exposure=200.0) == pytest.approx(10**0.2)
    assert limit(599e-9, exposure=200.0) == 10.0
    for wavelength in (400e-9, 700e-9):
        limit(wavelength, exposure=1.0)
    for wavelength in (399.9e-9, 700.1e-9):
        with pytest.raises(ValueError, match="between 400 nm and 700 nm"):
            limit(wavelength, exposure=1.0)
    for exposure in (18e-6, 3e4):
        limit(500e-9, exposure=exposure)
    for exposure in (17.9e-6, 3.01e4):
        with pytest.raises(ValueError, match="between 18 us and 30000 s"):
            limit(500e-9, exposure=exposure)


def test_a_pupil_gets_its_part_of_a_gaussian_beam() -> None:
    area = math.pi / 4 * APERTURE**2
    found = pupil_irradiance(2.0, diameter=2 * APERTURE)
    assert found == pytest.approx(2.0 * (1 - math.exp(-0.25)) / area)
    assert pupil_irradiance(0.0, diameter=1.0) == 0
    with pytest.raises(ValueError, match="diameter above 0"):
        pupil_irradiance(1.0, diameter=0.0)


def test_hazards_follow_from_growth_and_absorption(plate) -> None:
    survey = plate.with_(
        {
            "water.absorption": "0.2 1/m",
            "instrument.modulation_frequencies": ["200 kHz", "39 MHz"],
        }
    )
    found = hazard(
        survey, beam_diameter=3e-3, divergence=2e-3, laser_class="3R", exposure=10.0
    )
    # Blue light of 405 nm: 100 J/m^2 in 10 s.
    assert found.permissible_irradiance == pytest.approx(10.0)
    assert found.irradiance == pupil_irradiance(0.02, diameter=3e-3)
    assert found.class_power == 5e-3
    assert found.exceeds_class
    for distance, growth, absorption in (
        (found.distance_in_air, 2e-3, 0.0), (found.distance_in_water, 2e-3 / 1.34, 0.2)
    ):  # fmt: skip
        power = 0.02 * math.exp(-absorption * distance)
        there = pupil_irradiance(power, diameter=3e-3 + growth * distance)
        assert there == pytest.approx(10.0, rel=2e-4)
        assert there <= 10.0
    slow = survey.with_({"instrument.modulation_frequencies": ["199 kHz", "39 MHz"]})
    with pytest.raises(ValueError, match="a modulation of 199000 Hz is so slow"):
        hazard(slow, beam_diameter=3e-3, divergence=2e-3, laser_class="3R")
    limits = [
        hazard(survey, beam_diameter=3e-3, divergence=0.0, laser_class=kind).class_power
        for kind in ("2", "3B", "4")
    ]
    assert limits == [1e-3, 0.5, math.inf]
    far = hazard(survey, beam_diameter=3e-3, divergence=1e-12, laser_class="4")
    assert far.distance_in_air == math.inf
