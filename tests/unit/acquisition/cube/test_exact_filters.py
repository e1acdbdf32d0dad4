"""Plates behind filters with given signals and leakage."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact_samples import TURN, samples
from numpy.testing import assert_allclose

from amulor.acquisition import (
    from_plates,
)
from amulor.acquisition.cube import calibrate
from amulor.acquisition.cube.calibration import Leakage
from amulor.errors import CubeError

FREQUENCIES = np.array([20e6, 50e6])
LEAK = np.array([[0.02 + 0.01j, -0.01j], [0.01, 0.03 - 0.02j]])
DENSITIES = (0.0, 1.0, 2.0, 0.5)


def behind_filters(leak: np.ndarray, *, walk: float = 0.0, distance: float = 0.7):
    """Return a plate behind filters, with leakage that has no way [V]."""
    return [
        samples(
            (
                10**-density
                * np.exp(1j * (TURN * distance + 0.3 - walk * density))[:, None]
                * np.array([1.0, 0.6])
                + leak
            )[..., None, None],
            level="target_signal",
            error=1e-6,
        )
        for density in DENSITIES
    ]


def test_filters_separate_leakage_from_phase() -> None:
    plates = behind_filters(LEAK, walk=0.05)
    result = from_plates(plates, distance=0.7, densities=DENSITIES)
    found = {
        (leak.modulation_frequency, leak.polarization): leak for leak in result.leakage
    }
    assert [*found] == [(f, pair) for f in (20e6, 50e6) for pair in ("VV", "VH")]
    for (i, j), value in np.ndenumerate(LEAK):
        leak = found[FREQUENCIES[i], ("VV", "VH")[j]]
        assert_allclose(leak.scan, [value.real, value.imag], atol=1e-7)
        assert leak.open_water == (0.0, 0.0)
        assert leak.open_water_uncertainty == 0.0
        assert 1e-7 < leak.scan_uncertainty < 3e-3
    for entry in result.frequencies:
        assert_allclose(entry.amplitudes, [0.01, 0.1, 10**-0.5, 1.0], rtol=1e-5)
        assert_allclose(
            entry.phases, 0.3 + 0.05 * np.array([-2, -1, -0.5, 0]), atol=1e-5
        )
    assert [each.density for each in result.filters] == [*DENSITIES]
    stated = [10**-density for density in DENSITIES]
    assert_allclose([each.transmission for each in result.filters], stated, rtol=1e-4)
    assert result.filters[0].uncertainty == 0
    assert result.gain_change == pytest.approx(0, abs=1e-4)
    assert result.gain_change_uncertainty is not None
    assert result.gain_amplitude == pytest.approx(1.0, rel=1e-4)


def test_the_errors_of_a_fit_of_filters_are_those_of_its_design() -> None:
    transmission = np.array([1.0, 0.1, 0.01, 0.3])
    turned = 2 * np.exp(0.4j)
    sigma = np.array([1e-3, 2e-3, 1e-3, 1e-3])
    size, phase, error, leak, leak_error = calibrate._fit_filters(
        transmission, transmission * turned, sigma
    )
    assert_allclose(size, 2 * transmission)
    assert_allclose(phase, 0.4)
    assert abs(leak) < 1e-9
    # In the axes of the light: along it amplitude and leakage, across it phase, walk
    # and leakage; along it 5 % of the transmission, too.
    along = np.hypot(sigma, 0.05 * 2 * transmission)
    own = np.stack([transmission, np.ones(4)], axis=1) * 2 / along[:, None]
    decades = np.log10(transmission)
    across = (
        np.stack([transmission, transmission * decades, np.ones(4)], axis=1)
        * 2 / sigma[:, None]
    )  # fmt: skip
    of_own, of_across = (np.linalg.inv(part.T @ part) for part in (own, across))
    expected = [
        math.sqrt(np.array([1, d]) @ of_across[:2, :2] @ np.array([1, d]))
        for d in decades
    ]
    assert_allclose(error, expected, rtol=1e-4)
    larger = max(of_own[1, 1], of_across[2, 2])
    assert leak_error == pytest.approx(2 * math.sqrt(larger), rel=1e-4)


def test_a_poor_fit_of_filters_has_larger_errors() -> None:
    transmission = np.array([1.0, 0.3, 0.1, 0.03])
    sigma = np.full(4, 1e-4)
    off = np.array([0, 1, -1, 1]) * 2e-3j
    good, poor = (
        calibrate._fit_filters(transmission, transmission + more, sigma)
        for more in (0, off)
    )
    # Four signals have eight outputs, and five unknowns.
    model = poor[0] * np.exp(1j * poor[1]) + poor[3]
    rest = transmission + off - model
    along = np.hypot(sigma, 0.05 * transmission)
    square = ((rest.real / along) ** 2 + (rest.imag / sigma) ** 2).sum()
    assert square / 3 > 10
    ratio = poor[4] / good[4]
    assert ratio == pytest.approx(math.sqrt(square / 3), rel=0.02)


def test_leakage_of_further_distances_is_turned_with_their_way() -> None:
    plates = behind_filters(LEAK)
    values = np.exp(1j * (TURN * 1.1 + 0.3))[:, None] * np.array([1.0, 0.6]) + LEAK
    plates.append(samples(values[..., None, None], level="target_signal", error=1e-6))
    result = from_plates(
        plates, distance=[0.7] * 4 + [1.1], densities=[*DENSITIES, 0.0]
    )
    assert result.group_index == pytest.approx(1.5, abs=1e-5)
    for entry in result.frequencies:
        assert_allclose(entry.phases, 0.3, atol=1e-5)
    assert len(result.filters) == 4


def test_a_channel_without_a_signal_has_no_leakage() -> None:
    plates = behind_filters(LEAK)
    plates[1]["in_phase"][1, 1] = np.nan
    result = from_plates(plates, distance=0.7, densities=DENSITIES)
    assert len(result.leakage) == 3
    assert [len(entry.phases) for entry in result.frequencies] == [4, 4]
    for plate in plates:
        plate["in_phase"][1] = np.nan
    with pytest.raises(CubeError) as caught:
        from_plates(plates, distance=0.7, densities=DENSITIES)
    assert str(caught.value) == (
        "no pixel in the middle of the scan shows a target at 50 MHz; let the plate "
        "fill the middle half of the scan"
    )


def test_further_leakage_adds_to_that_of_the_shutter() -> None:
    known = [
        Leakage(
            modulation_frequency=20e6,
            polarization=pair,
            scan=(1.0, 2.0),
            scan_uncertainty=0.3,
            open_water=(5.0, 6.0),
            open_water_uncertainty=0.7,
            change=0.1,
        )
        for pair in ("VV", "VH")
    ]
    result = calibrate._with_leakage(known, 20e6, "VV", 0.5 - 1j, 0.4)
    assert result[0] == known[1]
    more = {"scan": (1.5, 1.0), "scan_uncertainty": 0.5}
    assert result[1] == known[0].model_copy(update=more)
    assert len(result) == 2
    new = calibrate._with_leakage(known, 50e6, "VV", 0.5 - 1j, 0.4)
    assert new[:2] == known
    assert new[2] == Leakage(
        modulation_frequency=50e6,
        polarization="VV",
        scan=(0.5, -1.0),
        scan_uncertainty=0.4,
        open_water=(0.0, 0.0),
        open_water_uncertainty=0.0,
    )
