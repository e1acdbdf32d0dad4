"""Tests of the instrument by the phases of a scan, and their words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.constants import speed_of_light
from scipy.stats import chi2

from amulor import acquisition, imaging, rejection, samples
from amulor import cube as cubes
from amulor.imaging.budget import with_deviations
from amulor.imaging.instrument_tests import instrument_tests

FREQUENCY = np.array([10e6, 35e6, 80e6, 146e6])
SHAPE = (8, 10)


def _target(
    turn: np.ndarray,
    *,
    noise: float = 1e-3,
    shared: float = 0.0,
    seed: int = 1,
    pixels: np.ndarray | float = 1.0,
) -> xr.Dataset:
    """Target signal of a wall at 1.2 m in air, each frequency turned by an angle.

    `pixels` are factors of the signal of each pixel.
    """
    rng = np.random.default_rng(seed)
    phase = 4 * np.pi * FREQUENCY * 1.2 / speed_of_light + turn
    shape = (4, 1, *SHAPE)
    signal = np.exp(1j * phase)[:, None, None, None] * pixels + noise * (
        rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    )
    total = np.full(shape, np.hypot(noise, shared))
    return cubes.build(
        "target_signal",
        {
            "in_phase": signal.real,
            "quadrature": signal.imag,
            "in_phase_uncertainty": total,
            "quadrature_uncertainty": total,
            "common_in_phase_uncertainty": np.full(shape, shared),
            "common_quadrature_uncertainty": np.full(shape, shared),
            "common_covariance": np.zeros(shape),
            "water_in_phase": np.zeros(shape),
            "water_quadrature": np.zeros(shape),
            "quality_flag": np.zeros(shape, dtype=np.int16),
        },
        {
            "modulation_frequency": FREQUENCY,
            "polarization": ["none"],
            "azimuth": np.zeros(SHAPE),
            "elevation": np.zeros(SHAPE),
        },
        geometry={
            "group_index": 1.0,
            "refractive_index": 1.0,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("target_signal", title="wall", source="by hand"),
    )


def _image(turn: np.ndarray, **options: Any) -> xr.Dataset:
    return imaging.range_image(_target(turn, **options), interval=(0.5, 2.0))


def test_the_chance_is_that_of_the_chi_square_about_one_delay() -> None:
    turn = np.array([0.004, -0.003, 0.002, 0.005])
    # Errors of 2 mrad that all pixels share; their noise has averaged out nearly.
    image = _image(turn, noise=1e-6, shared=2e-3)
    weight = FREQUENCY**2
    delay = np.sum(weight * turn / FREQUENCY) / np.sum(weight)
    rest = turn - FREQUENCY * delay
    expected = chi2.sf(np.sum((rest / 2e-3) ** 2), df=3)
    assert image.attrs["frequency_phase_probability"] == pytest.approx(
        expected, rel=0.02
    )


def test_a_delay_is_no_contradiction_and_a_constant_phase_is() -> None:
    delay = _image(2 * np.pi * FREQUENCY * 20e-12)
    assert delay.attrs["frequency_phase_probability"] > 1e-3
    assert instrument_tests(delay) == ()
    constant = _image(np.full(4, 0.005))
    assert constant.attrs["frequency_phase_probability"] < 1e-4
    (failed,) = instrument_tests(constant)
    assert failed.name == "frequencies"
    assert "frequencies differ" in failed.result
    # Without a comparison of channels, leakage is as likely as an error of both.
    assert "demodulator" in failed.cause
    assert "leakage" in failed.cause
    assert "plate" in failed.measurement
    # Errors that the channels share are no leakage.
    (failed,) = instrument_tests(constant.assign_attrs(channel_phase_probability=0.3))
    assert "demodulator" in failed.cause
    assert "leakage" not in failed.cause
    (failed, _) = instrument_tests(
        constant.assign_attrs(channel_phase_rad=0.02, channel_phase_probability=1e-9)
    )[::-1]
    assert "leakage" in failed.cause


def test_chance_is_uniform_for_phases_that_agree() -> None:
    chances = [
        _image(np.zeros(4), seed=seed).attrs["frequency_phase_probability"]
        for seed in range(40)
    ]
    assert min(chances) > 1e-4
    # 40 values: the mean of a uniform distribution is known to 0.046.
    assert np.mean(chances) == pytest.approx(0.5, abs=0.2)


def test_phases_of_the_brighter_pixels_count_where_they_deviate_most() -> None:
    # A smooth brightness has no edges at which neighbors differ.
    pixels = np.linspace(0.8, 1.2, SHAPE[1]) * np.ones(SHAPE)
    turn = 0.006
    turned = pixels * np.exp(1j * turn * (pixels > 1.0))
    image = _image(np.zeros(4), pixels=turned, noise=3e-3)
    weight = FREQUENCY**2
    rest = turn * (1 - FREQUENCY * np.sum(FREQUENCY) / np.sum(weight))
    phases = image.attrs["frequency_phase_rad"]
    assert phases == pytest.approx(rest, abs=0.2 * turn)
    # The true distance is 1.2 m.
    error = np.abs(image["slant_range"].values - 1.2)
    assert np.isfinite(error).all()
    assert np.all(error < 1.96 * image["slant_range_uncertainty"].values)
    assert error.max() > 1e-3
    # Without the turn, none of two halves of 80 pixels deviates.
    assert "frequency_phase_rad" not in _image(np.zeros(4), pixels=pixels).attrs


def test_two_frequencies_have_one_degree_of_freedom() -> None:
    turn = np.array([0.0, 0.004, -0.002, 0.0])
    target = _target(turn, noise=1e-6, shared=2e-3)
    image = imaging.range_image(
        target.isel(modulation_frequency=[1, 2]), interval=(0.5, 2.0)
    )
    # Distances as phases of the first frequency, with independent errors.
    ratio = FREQUENCY[1] / FREQUENCY[2]
    difference = (turn[1] - ratio * turn[2]) / np.hypot(2e-3, ratio * 2e-3)
    assert image.attrs["frequency_phase_probability"] == pytest.approx(
        chi2.sf(difference**2, df=1), rel=0.02
    )
    alone = imaging.range_image(
        target.isel(modulation_frequency=[1]), interval=(0.5, 2.0)
    )
    assert "frequency_phase_probability" not in alone.attrs


def test_few_deviations_count_with_the_factor_of_student() -> None:
    # Tables of Student's t: 4.303 for two degrees of freedom, 2.776 for four.
    two = with_deviations(np.full(2, 0.01), np.array([0.02, 0.0]))
    assert two == pytest.approx(4.303 / 1.96 * np.sqrt((1e-4 + 4e-4) / 2), rel=1e-3)
    four = with_deviations(np.zeros(4), np.full(4, 0.01))
    assert four == pytest.approx(2.776 / 1.96 * 0.01, rel=1e-3)
    # A larger statement of the survey remains.
    assert with_deviations(np.full(2, 0.5), np.zeros(2)) == pytest.approx(
        4.303 / 1.96 * 0.5 / np.sqrt(2), rel=1e-3
    )


def test_frequencies_that_contradict_each_other_widen_the_range_error() -> None:
    rng = np.random.default_rng(7)
    turns = 0.02 * rng.standard_normal((60, 4))
    # A pixel alone is too noisy to show the contradiction.
    images = [_image(turn, noise=0.01) for turn in turns]
    images = [image for image in images if "frequency_phase_rad" in image.attrs]
    assert len(images) > 50
    error = [float(image["slant_range"].median()) - 1.2 for image in images]
    common = [
        float(image["slant_range_common_uncertainty"].median()) for image in images
    ]
    # The stated error adds the turns with one sign; these are independent. Equal noise
    # at all frequencies: each moves the range in proportion to its frequency.
    smaller = np.linalg.norm(FREQUENCY) / np.sum(FREQUENCY)
    # 50 normal errors: their standard deviation is known to 10 %.
    expected = smaller * np.sqrt(np.mean(np.square(common)))
    assert np.sqrt(np.mean(np.square(error))) == pytest.approx(expected, rel=0.3)
    agreeing = _image(np.zeros(4), noise=0.01)
    assert "slant_range_uncertainty_instrument" not in agreeing


def test_errors_that_turn_all_frequencies_the_same_way_do_not_average_out() -> None:
    # Phases by other water before the target: of one sign, and large at the
    # frequencies that determine the range.
    turn = np.array([0.0, 0.008, 0.022, 0.018])
    image = _image(turn, noise=0.003)
    # Equal noise at all frequencies: the range weighs them by their squares.
    weight = FREQUENCY**2 / np.sum(FREQUENCY**2)
    range_per_phase = speed_of_light / (4 * np.pi * FREQUENCY)
    rest = turn - np.sum(weight * range_per_phase * turn) / range_per_phase
    size = 2.776 / 1.96 * np.sqrt(np.sum(rest**2) / 4)
    stated = float(image["slant_range_uncertainty_instrument"].median())
    assert stated == pytest.approx(np.sum(weight * range_per_phase) * size, rel=0.1)


def test_a_phase_in_proportion_to_the_frequency_is_a_delay_between_channels() -> None:
    attributes = {
        "channel_phase_probability": 1e-9,
        "modulation_frequencies": FREQUENCY,
    }
    # 10 ps, and the same size at all frequencies.
    delay, leakage = (
        instrument_tests(xr.Dataset(attrs=attributes | {"channel_phase_rad": phase}))[0]
        for phase in (2 * np.pi * FREQUENCY * 10e-12, np.full(4, 0.009))
    )
    assert "delay between the channels" in delay.cause
    assert "leakage" not in delay.cause
    assert "leakage" in leakage.cause


@pytest.mark.parametrize(
    ("change", "uncertainty", "fails"),
    [(0.05, 0.001, False), (0.12, 0.001, True), (-0.4, 0.15, False), (-2, 0.2, True)],
)
def test_an_unusual_change_of_the_water_is_named(
    change: float, uncertainty: float, fails: bool
) -> None:
    attributes = {
        "open_water_change": change,
        "open_water_change_uncertainty": uncertainty,
    }
    failed = instrument_tests(xr.Dataset(attrs=attributes))
    assert bool(failed) == fails
    if fails:
        assert failed[0].name == "water"
        assert "other water" in failed[0].cause
        assert failed[0].probability is not None


def test_references_that_no_water_explains_are_named() -> None:
    cause = xr.DataArray(np.full((2, 3), 64, dtype=np.int8), dims=("row", "column"))
    (failed,) = instrument_tests(xr.Dataset({"water_residual_cause": cause}))
    assert failed.name == "references"
    assert failed.probability is None
    assert "leakage" in failed.cause
    assert instrument_tests(xr.Dataset({"water_residual_cause": cause - 32})) == ()


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        (
            {"channel_phase_rad": 0.0305, "channel_phase_probability": 1e-9},
            "30.5 mrad",
        ),
        ({"instrument_drift_delay_s": [3e-12, -3e-11]}, "-30 ps"),
        ({"method_disagreement_m": 0.0046}, "4.6 mm"),
    ],
)
def test_failed_tests_of_rejection_have_cause_and_measurement(
    attributes: dict[str, float], words: str
) -> None:
    (failed,) = instrument_tests(xr.Dataset(attrs=attributes))
    assert words in failed.result
    assert failed.probability < 1e-4
    assert failed.cause
    assert failed.measurement


def test_samples_beyond_the_calibrated_amplitudes_are_named_in_the_image() -> None:
    cube = samples.cube("ladder").isel(row=[18, 19], shot=slice(0, None, 4))
    amplitude = np.abs(cube.amulor.signal.values)
    low, middle = np.quantile(amplitude, [0.0, 0.5])
    table = acquisition.Calibration.from_text(
        "[[frequencies]]\nmodulation_frequency = '39 MHz'\n"
        f"amplitudes = ['{low / 2:g} V', '{middle:g} V']\n"
        "phases = ['0 rad', '0.1 rad']"
    )
    calibrated = acquisition.calibrated(cube, table)
    # Half of the samples are stronger than the median.
    assert calibrated.attrs["uncalibrated_share"] == pytest.approx(0.5, abs=0.01)
    strong = amplitude > 1.2 * middle
    errors, before = (
        c["quadrature_uncertainty"].values + c["in_phase_uncertainty"].values
        for c in (calibrated, cube)
    )
    assert strong.any()
    assert (errors[strong] > before[strong]).all()
    image = imaging.range_image(rejection.cross_polarized(calibrated))
    (failed,) = instrument_tests(image)
    assert failed.name == "calibration"
    assert "50" in failed.result
    assert "filters" in failed.measurement


def test_a_measurement_without_any_calibration_is_named() -> None:
    image = imaging.range_image(rejection.cross_polarized(samples.cube("ladder")))
    assert instrument_tests(image) == ()
    measured = image.assign_attrs(simulated=0)
    survey = image.amulor.survey
    instrument = survey.instrument.model_copy(update={"phase_uncertainty": None})
    unstated = survey.model_copy(update={"instrument": instrument})
    (failed,) = instrument_tests(measured.assign_attrs(survey=unstated.to_toml()))
    assert failed.name == "calibration"
    # Six times the typical error, at one frequency.
    assert "; 3 degrees" in failed.cause
    instrument = survey.instrument.model_copy(update={"phase_uncertainty": 0.01})
    stated = survey.model_copy(update={"instrument": instrument})
    assert instrument_tests(measured.assign_attrs(survey=stated.to_toml())) == ()
    calibrated = measured.assign_attrs(survey=unstated.to_toml(), calibration="a table")
    assert instrument_tests(calibrated) == ()


#: Reflectances of stripes two pixels wide, whose edges lie within pairs of neighbors.
STRIPES = np.where((np.arange(10) + 1) // 2 % 2, 1.0, 0.25) * np.ones(SHAPE)


def test_a_phase_that_depends_on_the_amplitude_shows_at_edges_of_reflectance() -> None:
    degrees = 0.5
    walk = np.exp(1j * np.radians(degrees) * np.log10(STRIPES))
    image = imaging.range_image(
        _target(np.zeros(4), pixels=STRIPES * walk, noise=3e-4), interval=(0.5, 2.0)
    )
    # Bright pixels less dark pixels, four times darker.
    expected = np.radians(degrees) * np.log10(4)
    # Pairs beside an edge count as across it, too, so that the step is a lower bound.
    assert 0.4 * expected < image.attrs["amplitude_phase_rad"] < 1.05 * expected
    assert image.attrs["amplitude_phase_probability"] < 1e-6
    tests = {test.name: test for test in instrument_tests(image)}
    assert "mrad" in tests["amplitude"].result
    assert "depends on the amplitude" in tests["amplitude"].cause
    assert "filters" in tests["amplitude"].measurement
    # Errors of dark and bright pixels differ by the walk; either may be right.
    plain = imaging.range_image(
        _target(np.zeros(4), pixels=STRIPES, noise=3e-4), interval=(0.5, 2.0)
    )
    error = image["slant_range"] - plain["slant_range"]
    interval = 1.96 * image["slant_range_uncertainty"]
    assert np.isfinite(error).mean() > 0.5
    assert (np.abs(error) < interval).sum() == np.isfinite(error).sum()
    assert "amplitude_phase_rad" not in plain.attrs


def test_edges_of_depth_and_smooth_phases_are_no_step_at_an_amplitude() -> None:
    # Bright stripes are 5 cm nearer, so that each frequency turns by its own angle.
    nearer = 4 * np.pi * FREQUENCY * 0.05 / speed_of_light
    stripes = STRIPES * np.exp(
        -1j * nearer[:, None, None, None] * (STRIPES.max() == STRIPES)
    )
    # A smooth change of the phases across the image, as by late light.
    smooth = np.exp(0.02j * np.linspace(0, 1, 10)) * STRIPES
    for pixels in (stripes, smooth):
        image = imaging.range_image(
            _target(np.zeros(4), pixels=pixels), interval=(0.5, 2.0)
        )
        assert image.attrs["amplitude_phase_probability"] > 1e-3


def test_errors_that_pixels_share_are_no_step_at_an_amplitude() -> None:
    """Water left in the scan turns dark pixels more; its stated error explains that."""
    left = 0.004 * np.exp(2j * np.pi * np.array([0.1, 0.4, 0.7, 0.9]))
    pixels = STRIPES + left[:, None, None, None]
    for shared, real in ((0.004, False), (0.0, True)):
        target = _target(np.zeros(4), pixels=pixels, shared=shared, noise=1e-4)
        image = imaging.range_image(target, interval=(0.5, 2.0))
        assert ("amplitude_phase_rad" in image.attrs) is real


@pytest.mark.slow
def test_perfect_scans_never_fail_the_test_of_the_amplitude() -> None:
    """300 scans with stripes, with grains, and with a smooth amplitude."""
    chances = []
    for seed in range(300):
        rng = np.random.default_rng([7, seed])
        pixels = (
            STRIPES,
            np.exp(rng.normal(0, 0.5, SHAPE)),
            np.linspace(1, 0.7, 10) * np.ones(SHAPE),
        )[seed % 3]
        target = _target(np.zeros(4), seed=seed, pixels=pixels)
        if seed % 2:
            target = target.isel(modulation_frequency=[1, 3])
        image = imaging.range_image(target, interval=(0.5, 2.0))
        chances.append(image.attrs["amplitude_phase_probability"])
    # Shared pixels and several limits make the chances too large, never too small.
    assert np.mean(np.array(chances) < 0.01) < 0.01
    assert min(chances) > 1e-4
