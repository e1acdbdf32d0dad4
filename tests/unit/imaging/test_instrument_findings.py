"""Failed tests of an instrument: limits, numbers and words of each."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.stats import chi2, norm

from amulor.cube import QualityFlag, WaterResidualCause
from amulor.imaging.instrument_tests import (
    FrequencyPhase,
    _deviations,
    _has_corner_light,
    _is_delay,
    frequency_phase,
    instrument_tests,
)

LEAKAGE = (
    "block the receiver with the laser on (leakage), and calibrate the phase against "
    "the amplitude"
)
WATER = "other water before the target than in the references"
AMPLITUDE = "leakage, a phase that depends on the amplitude"
SHARED = (
    "harmonics, reflections in a cable, an error of the demodulator, a scale change, "
    "or frequencies without a calibration of their phase"
)


def _failed(
    variables: dict[str, Any] | None = None, **attributes: Any
) -> list[tuple[Any, ...]]:
    """Names, results, chances, causes and measurements of the failed tests."""
    coords = {"modulation_frequency": [30e6, 80e6]}
    cube = xr.Dataset(variables or {}, coords=coords, attrs=attributes)
    return [
        (test.name, test.result, test.probability, test.cause, test.measurement)
        for test in instrument_tests(cube)
    ]


def test_a_change_of_the_water_beyond_2_percent_is_named() -> None:
    # 3.8906 standard errors have the probability of 1e-4.
    for error in (0.0, 0.015):
        limit = norm.isf(0.5e-4) * np.hypot(0.02, error)
        stated = {"open_water_change_uncertainty": error} if error else {}
        assert _failed(open_water_change=0.999 * limit, **stated) == []
        (found,) = _failed(open_water_change=-1.001 * limit, **stated)
        assert found == (
            "water",
            f"the water differs by {-limit:+.0%} from the references",
            pytest.approx(1e-4, rel=0.02),
            f"{WATER}, {AMPLITUDE}, or phase errors of single frequencies, as by "
            "harmonics, reflections in a cable or the demodulator",
            f"record references again; {LEAKAGE}",
        )
    one = xr.Dataset(
        coords={"modulation_frequency": [30e6]}, attrs={"open_water_change": 0.5}
    )
    (single,) = instrument_tests(one)
    assert single.cause.endswith(", or a delay between the channels")


def test_phases_between_channels_are_delays_or_depend_on_the_echo() -> None:
    chance = {"channel_phase_probability": 1e-9}
    (found,) = _failed(channel_phase_rad=np.array([3e-3, 1e-3]), **chance)
    assert found == (
        "channels", "the channels differ by 3 mrad", 1e-9, f"{AMPLITUDE}, or {WATER}",
        LEAKAGE,
    )  # fmt: skip
    (delay,) = _failed(channel_phase_rad=np.array([3e-3, 8e-3]), **chance)
    assert delay[3:] == (
        "a delay between the channels",
        "measure the delay of each channel with a plate",
    )


@pytest.mark.parametrize(
    ("phase", "delay"),
    [
        ((3e-3, 8e-3), True),
        # The slope is that of least squares; the rest of the first is 1.54 and 1.85.
        ((4.75e-3, 8e-3), True),
        ((5.1e-3, 8e-3), False),
        ((8e-3,), False),
        ((3e-3, 8e-3, 9e-3), False),
    ],
)
def test_a_delay_explains_phases_in_proportion(
    phase: tuple[float, ...], delay: bool
) -> None:
    cube = xr.Dataset(coords={"modulation_frequency": [30e6, 80e6]})
    assert _is_delay(np.array(phase), cube) is delay


@pytest.mark.parametrize(
    ("attributes", "cause"),
    [
        ({}, f"{AMPLITUDE}, {WATER}, {SHARED}"),
        ({"channel_phase_probability": 0.5}, SHARED),
    ],
)
def test_frequencies_of_different_distances_are_named(
    attributes: dict[str, Any], cause: str
) -> None:
    (found,) = _failed(
        frequency_phase_rad=np.array([2e-3, -5e-3]), frequency_phase_probability=1e-7,
        **attributes,
    )  # fmt: skip
    assert found == (
        "frequencies",
        "the frequencies differ from one distance by up to 5 mrad",
        1e-7,
        cause,
        f"{LEAKAGE}; calibrate the phase of each frequency with a plate",
    )


def test_other_findings_have_their_numbers() -> None:
    (step,) = _failed(amplitude_phase_rad=-4e-3, amplitude_phase_probability=1e-6)
    assert step[:3] == (
        "amplitude",
        "the phases of brighter pixels differ from those of darker neighbors by -4 "
        "mrad",
        1e-6,
    )
    (drift,) = _failed(instrument_drift_delay_s=np.array([2e-12, -7e-12, 1e-12]))
    assert drift[:3] == (
        "drift",
        "the delay of the references changed by -7 ps",
        pytest.approx(6e-9),
    )
    (methods,) = _failed(method_disagreement_m=3e-3)
    assert methods == (
        "methods", "two rejection methods differ by 3 mm", 6.4e-5,
        f"{AMPLITUDE}, or {WATER}", LEAKAGE,
    )  # fmt: skip
    assert _failed(output_step_ratio=1.0, output_step_volt=2e-6) == []
    (resolution,) = _failed(output_step_ratio=1.5, output_step_volt=2e-6)
    assert resolution[:3] == (
        "resolution",
        "the outputs have steps of 2 uV, with an error of 1.5 times the stated noise",
        None,
    )
    (share,) = _failed(uncalibrated_share=0.025)
    assert share[:3] == (
        "calibration",
        "2.5% of the samples are beyond the calibrated amplitudes",
        None,
    )
    assert _failed(uncalibrated_share=0.0) == []
    instrument, change = (
        (("row",), np.array([0, int(cause)]))
        for cause in (WaterResidualCause.INSTRUMENT, WaterResidualCause.WATER_CHANGED)
    )
    (references,) = _failed({"water_residual_cause": instrument})
    assert references[0] == "references"
    assert references[1] == "no water explains the references and the scan"
    assert _failed({"water_residual_cause": change}) == []


def _with_corners(corners: float, count: int, **attributes: Any) -> xr.Dataset:
    """Image of 100 pixels, of which some have an error by light of corners."""
    light = np.where(np.arange(100) < count, corners, 0.0)
    total = np.sqrt(light**2 + 3e-3**2 + 4e-3**2)
    return xr.Dataset(
        {
            "slant_range_uncertainty_corners": ("p", light),
            "slant_range_uncertainty_instrument": ("p", np.full(100, 4e-3)),
            "slant_range_uncertainty": ("p", total),
        },
        attrs={"method_disagreement_m": 3e-3, "instrument_drift_delay_s": 1e-11}
        | attributes,
    )


def test_light_of_corners_is_named_first_where_it_exceeds_other_errors() -> None:
    for corners, count, lit in (
        (3.1e-3, 3, True),
        (2.9e-3, 3, False),
        (3.1e-3, 2, False),
    ):
        image = _with_corners(corners, count)
        assert _has_corner_light(image) is lit
        drift, methods = instrument_tests(image)
        assert drift.cause.startswith("drift of the instrument")
        assert methods.cause.startswith("light that corners reflect twice, or ") is lit
        words = "scan a plate in the same water; "
        assert methods.measurement.startswith(words) is lit
        assert methods.measurement.endswith(LEAKAGE)
    assert not _has_corner_light(xr.Dataset())


SHAPE = (4, 6)
PER_PHASE = np.array([2.0, 1.0, 0.5])


def _observed(**changes: Any) -> Any:
    fields: dict[str, Any] = {
        "frequency": np.array([20e6, 40e6, 80e6]), "lag": None,
        "channel": xr.Dataset(), "usable": np.ones(SHAPE, dtype=bool),
        "flag": np.zeros(SHAPE, dtype=np.int16),
        "signal": np.ones((3, *SHAPE), dtype=complex),
        "path_per_phase": PER_PHASE[:, None, None],
        "own_sigma": np.array([1e-3, 2e-3, 3e-3])[:, None, None] * np.ones((3, *SHAPE)),
        "shift": np.zeros((3, *SHAPE)), "shared_sigma": lambda _: None,
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


def _path(phase: np.ndarray, **changes: Any) -> Any:
    """Path whose phases deviate by angles, the same in all pixels."""
    residual = (PER_PHASE * phase)[:, None, None] * np.ones((3, *SHAPE))
    fields: dict[str, Any] = {
        "length": np.ones(SHAPE), "residual": residual,
        "left_out": np.zeros((3, *SHAPE), dtype=bool),
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


PHASE = np.array([2e-3, -3e-3, 1e-3])


def _expected(error: np.ndarray) -> tuple[np.ndarray, float]:
    """Deviations from the best common path, and their chance."""
    length = PHASE * PER_PHASE
    weight = 1 / (error * PER_PHASE) ** 2
    length = length - (weight @ length) / weight.sum()
    return length / PER_PHASE, float(chi2.sf(weight @ length**2, 2))


def test_deviations_are_from_the_best_common_path() -> None:
    valid = np.ones(SHAPE, dtype=bool)
    # The median of n values has 1.25 times the error of their mean.
    error = np.sqrt(np.pi / 2) * np.array([1e-3, 2e-3, 3e-3]) / np.sqrt(24)
    phase, chance = _expected(error)
    found = _deviations(_observed(), _path(PHASE), valid)
    assert found is not None
    assert_allclose(found.phase, phase, rtol=1e-5)
    assert found.probability == pytest.approx(chance, rel=1e-3)
    assert found.size == pytest.approx(np.linalg.norm(phase))
    twice = _deviations(_observed(), _path(PHASE), valid, tests=2)
    assert twice is not None
    assert twice.probability == pytest.approx(min(1.0, 2 * chance), rel=1e-3)
    # Shared errors and residual water count for each frequency.
    shared, shift = np.full((3, *SHAPE), 2e-3), np.full((3, *SHAPE), -1.5e-3)
    unsure = _deviations(
        _observed(shared_sigma=lambda _: shared, shift=shift), _path(PHASE), valid
    )
    assert unsure is not None
    phase, chance = _expected(np.sqrt(error**2 + 2.5e-3**2))
    assert_allclose(unsure.phase, phase, rtol=1e-5)
    assert unsure.probability == pytest.approx(chance, rel=1e-3)


def test_few_pixels_and_unknown_errors_tell_nothing() -> None:
    valid = np.zeros(SHAPE, dtype=bool)
    valid.ravel()[:9] = True
    assert _deviations(_observed(), _path(PHASE), valid) is None
    valid.ravel()[9] = True
    assert _deviations(_observed(), _path(PHASE), valid) is not None
    everywhere = np.ones(SHAPE, dtype=bool)
    nothing = np.full((3, *SHAPE), np.nan)
    assert _deviations(_observed(shift=nothing), _path(PHASE), everywhere) is None
    exact = _observed(own_sigma=np.zeros((3, *SHAPE)))
    assert _deviations(exact, _path(PHASE), everywhere) is None


@pytest.mark.parametrize(
    ("changes", "of_path"),
    [
        ({"frequency": np.array([20e6])}, {}),
        ({"lag": np.zeros(3)}, {}),
        ({"usable": np.zeros(SHAPE, dtype=bool)}, {}),
        ({"flag": np.full(SHAPE, QualityFlag.MIXED, dtype=np.int16)}, {}),
        ({}, {"length": np.full(SHAPE, np.nan)}),
        ({}, {"left_out": np.ones((3, *SHAPE), dtype=bool)}),
    ],
)
def test_some_scans_have_no_test_of_the_frequencies(
    changes: dict[str, Any], of_path: dict[str, Any]
) -> None:
    assert frequency_phase(_observed(**changes), _path(PHASE, **of_path)) is None
    assert frequency_phase(_observed(), _path(PHASE)) is not None


def test_the_larger_deviations_of_bright_or_dark_pixels_count() -> None:
    bright = np.arange(6) > 2
    signal = np.where(bright, 3.0, 1.0) * np.ones((3, *SHAPE), dtype=complex)
    path = _path(PHASE)
    path.residual[:] = path.residual * np.where(bright, 4.0, 0.5)
    found = frequency_phase(_observed(signal=signal), path)
    assert found is not None
    assert found.is_real
    error = np.array([1e-3, 2e-3, 3e-3])
    assert_allclose(found.phase, 4 * _expected(error)[0], atol=1e-12)
    dark = frequency_phase(_observed(signal=1 / signal), path)
    assert dark is not None
    assert_allclose(dark.phase, found.phase)


def test_a_result_that_the_method_stored_is_taken() -> None:
    stored = xr.Dataset(
        attrs={"frequency_phase_rad": [1.0, 2.0, 3.0],
               "frequency_phase_probability": 1e-8}
    )  # fmt: skip
    found = frequency_phase(_observed(channel=stored), _path(PHASE))
    assert found is not None
    assert_allclose(found.phase, [1.0, 2.0, 3.0])
    assert found.probability == 1e-8
    for chance, real in ((0.99e-4, True), (1e-4, False)):
        made = FrequencyPhase(phase=PHASE, probability=chance)
        assert made.is_real is real
        assert ("frequency_phase_rad" in made.attributes) is real
        assert made.attributes["frequency_phase_probability"] == chance
