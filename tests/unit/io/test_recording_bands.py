"""Averages, flags, breakdowns and directions of the pixels of a recording."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.errors import FormatError
from amulor.io import recordings as bands
from amulor.io.recording_samples import Samples, nearest_distance


def samples_of(signal: list[complex], **fields: Any) -> Samples:
    count = len(signal)
    nothing = np.full(count, np.nan)
    given = {
        "mean": nothing, "frequency": nothing, "polarization": np.full(count, "VV"),
        "azimuth": nothing, "elevation": nothing, "row": nothing, "column": nothing,
        "temperature": nothing, "water": np.zeros(count, bool), **fields,
    }  # fmt: skip
    return Samples(signal=np.array(signal, complex), **given)


def places(*columns: int) -> tuple[np.ndarray, ...]:
    """Indices of one channel and row, and of the given columns."""
    nothing = np.zeros(len(columns), int)
    return nothing, nothing, nothing, np.array(columns)


def test_a_measurement_is_finite_not_zero_and_below_a_megavolt() -> None:
    found = bands.is_measured(np.array([1j, 0, np.nan, 0.99e6, 1.01e6, np.inf]))
    assert found.tolist() == [True, False, False, True, False, False]


def test_samples_of_a_pixel_are_averaged_with_flags() -> None:
    samples = samples_of(
        [1 + 2j, 3 + 6j, 0, np.nan, 5 + 1j], mean=np.array([1.0, 3, 9, 9, np.nan]),
        temperature=np.array([10.0, 20, 30, np.nan, np.nan]),
    )  # fmt: skip
    found = bands._gathered(samples, places(0, 0, 0, 1, 2), (1, 1, 1, 4))
    assert_allclose(found.signal[0, 0, 0], [2 + 4j, np.nan, 5 + 1j, np.nan])
    # Of measured samples the mean output, of all the temperature.
    assert_allclose(found.mean[0, 0, 0], [2, np.nan, np.nan, np.nan])
    assert_allclose(found.temperature[0, 0, 0], [20, np.nan, np.nan, np.nan])
    assert found.takes[0, 0, 0].tolist() == [2, 0, 1, 0]
    assert found.flag[0, 0, 0].tolist() == [1, 4, 0, 0]
    assert (found.takes.dtype, found.flag.dtype) == (np.int32, np.int16)
    part = found.rows(slice(0, 0))
    assert part.signal.shape == (1, 1, 0, 4)


def test_directions_are_means_over_channels_or_as_planned() -> None:
    planned = np.array([[0.1, 0.2, 0.3]])
    angle = np.array([1.0, 3.0, np.nan, 5.0])
    found = bands._direction(angle, places(0, 0, 1, 2), planned)
    assert_allclose(found, [[2.0, 0.2, 5.0]])


@pytest.mark.parametrize(
    ("rows", "wide"), [((0, 2), (0, 3)), ((2, 4), (1, 5)), ((4, 6), (3, 6))]
)
def test_a_band_has_its_neighbors(rows, wide) -> None:
    survey: Any = SimpleNamespace(scan=SimpleNamespace(rows=6))
    assert bands.band_with_neighbours(survey, rows) == wide


def test_a_stated_uncertainty_falls_with_the_root_of_the_samples() -> None:
    described: Any = SimpleNamespace(constants=SimpleNamespace(uncertainty=0.6))
    means: Any = SimpleNamespace(takes=np.array([0, 1, 4, 9]))
    survey: Any = None
    found = bands._uncertainty(described, survey, means)
    assert_allclose(found, [0.6, 0.6, 0.3, 0.2])


def test_noise_is_that_of_the_light_or_of_the_amplitude(monkeypatch) -> None:
    rates = []

    def variance(survey: Any, *, rate: np.ndarray, integration_time: float) -> Any:
        rates.append(rate)
        return np.full(rate.shape, 16.0 * integration_time)

    monkeypatch.setattr(bands, "counting_variance", variance)
    monkeypatch.setattr(bands, "integration_time", lambda survey: 4.0)
    detector = SimpleNamespace(volt_per_photoelectron_rate=0.01, dark_rate=100.0)
    survey: Any = SimpleNamespace(
        instrument=SimpleNamespace(detector=detector, modulation_depth=0.5)
    )
    described: Any = SimpleNamespace(constants=SimpleNamespace(uncertainty=None))
    means: Any = SimpleNamespace(
        takes=np.array([1, 4, 1, 1]), mean=np.array([3.0, np.nan, 0.5, np.nan]),
        signal=np.array([3 + 4j, 3 + 4j, 1, np.nan]),
    )  # fmt: skip
    found = bands._uncertainty(described, survey, means)
    # Photoelectrons above the dark rate; without a mean output those of 5 V at half
    # modulation.
    assert_allclose(rates[0], [200, 1000, 0, 0])
    assert_allclose(found, [8, 4, 8, 8])


def band_of(signal: np.ndarray, uncertainty: float) -> Any:
    whole = signal[None, None].astype(complex)
    return SimpleNamespace(
        means=SimpleNamespace(signal=whole), nearest=nearest_distance(whole),
        uncertainty=np.full(whole.shape, uncertainty),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("off", "uncertainty", "broken"),
    # 12 typical differences of 0.1 V, or 8 uncertainties.
    [(1.19, 0.01, False), (1.21, 0.01, True), (1.59, 0.2, False), (1.61, 0.2, True)],
)
def test_a_breakdown_is_far_from_all_neighbors(off, uncertainty, broken) -> None:
    signal = np.zeros((3, 3))
    signal[1, 1] = off
    found = bands._breakdowns(band_of(signal, uncertainty), np.full((1, 1, 1, 1), 0.1))
    assert found[0, 0, 1, 1] == broken
    assert found.sum() == broken


@pytest.mark.parametrize(("off", "broken"), [(5.9, False), (6.1, True)])
def test_a_breakdown_is_far_from_mixtures_of_neighbors(off, broken) -> None:
    # Neighbors differ by 3 V along the other axis: twice that is not explained.
    signal = np.zeros((3, 3), complex)
    signal[:, 2] = 3j
    signal[1, 1] = off + 1.5j
    found = bands._breakdowns(band_of(signal, 1e-3), np.full((1, 1, 1, 1), 1e-3))
    assert found[0, 0, 1, 1] == broken


def test_marks_are_counted_by_their_names() -> None:
    flag = xr.Variable(("x",), np.array([1, 2, 2, 0, 5]), {
        "flag_masks": np.array([1, 2, 4]),
        "flag_meanings": "zero_output breakdown no_number",
    })  # fmt: skip
    cube = xr.Dataset({"user_sample_flag": flag})
    assert bands.marked(cube) == {"zero output": 2, "breakdown": 2, "no number": 1}
    cube["open_water_in_phase"] = ("shot", np.array([1.0, np.nan, np.nan]))
    assert bands.marked(cube)["open-water references without a usable number"] == 2


def test_a_shot_far_from_the_median_is_left_out(monkeypatch) -> None:
    monkeypatch.setattr(bands, "_uncertainty", lambda *_: np.full((1, 1, 1, 6), 1e-3))
    survey: Any = SimpleNamespace(
        instrument=SimpleNamespace(lock_in=SimpleNamespace(phase_floor=0.0))
    )
    described: Any = SimpleNamespace(constants=SimpleNamespace(uncertainty=None))
    # Off the median of 10 by 0, 0.1, 0.1, 0.1, 1.1 and 1.3; typically by 0.1.
    signal = [10.0, 10.1j * 0 + 10.1, 9.9, 10.1, 8.9, 11.4]
    angle = np.linspace(0.0, 0.5, 6)
    samples = samples_of(signal, azimuth=angle)
    channel = np.zeros(6, int), np.zeros(6, int)
    found = bands._shots(samples, channel, survey, described)
    middle = np.median(signal)
    typical = np.median(np.abs(np.array(signal) - middle))
    kept = np.abs(np.array(signal) - middle) <= 12 * typical
    values = found["in_phase"].values.ravel()
    assert_allclose(values, np.where(kept, signal, np.nan))
    assert_allclose(found["azimuth"], angle)
    assert "elevation" not in found


def test_shots_are_of_all_channels_of_the_scan() -> None:
    names = np.array([40e6, 60e6]), ["VV", "VH"]
    shots = samples_of([1.0, np.nan], water=np.ones(2, bool))
    anything: Any = None
    given = {"names": names, "survey": anything, "described": anything}
    zero, one = np.zeros(1, int), np.ones(1, int)
    none = bands.shots_of("f", samples_of([]), (zero[:0], zero[:0]),
                          scanned=(zero, zero), **given)  # fmt: skip
    assert none is None
    with pytest.raises(FormatError, match=r"^f: the scan has 60 MHz VH, of which"):
        bands.shots_of("f", shots, (zero[[0, 0]], zero[[0, 0]]), scanned=(one, one),
                       **given)  # fmt: skip
    channel = np.array([0, 1]), np.array([0, 1])
    with pytest.raises(FormatError, match=r"^f: no open-water shot at 60 MHz VH is a"):
        bands.shots_of("f", shots, channel, scanned=(zero, zero), **given)
    bands.refuse_no_scan("f", any_scan=True)
    with pytest.raises(
        FormatError, match=r"^f: holds open-water shots and no sample of"
    ):
        bands.refuse_no_scan("f", any_scan=False)
