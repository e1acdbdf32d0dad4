"""Fits of demodulator, polarizer and filters to exact numbers, with their errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact_samples import samples
from numpy.testing import assert_allclose

from amulor.acquisition import from_polarizer, from_terminated
from amulor.acquisition.cube import demodulator, polarizer
from amulor.acquisition.cube.filters import measured_filters
from amulor.errors import CubeError

GAIN, ANGLE, SIZE = 0.25, 0.3, 2.0
PHASES = np.array([0.1, 1.3, 2.4, 3.5, 4.4, 5.6])


def skewed(phases: np.ndarray) -> np.ndarray:
    """Return the outputs of a demodulator for one amplitude."""
    angle = np.sin(phases) * math.cos(ANGLE) + np.cos(phases) * math.sin(ANGLE)
    return SIZE * (np.cos(phases) + 1j * (1 + GAIN) * angle)


def test_an_ellipse_has_its_gain_and_angle_with_errors() -> None:
    sigma = np.array([1.0, 2, 1, 1, 3, 1]) * 1e-3
    fit = demodulator._ellipse(skewed(PHASES), sigma, silent=0.0)
    assert fit["quadrature_gain"] == pytest.approx(GAIN)
    assert fit["quadrature_phase"] == pytest.approx(ANGLE)
    assert_allclose(fit["outputs"], [(v.real, v.imag) for v in skewed(PHASES)])
    # The modulus changes by dA, by -A sin^2 dg / (1 + g) and by
    # A sin (sin tan e - cos / cos e ...) de: here by small differences.
    step = 1e-6

    def modulus(gain: float, angle: float) -> np.ndarray:
        signal = skewed(PHASES)
        y = (signal.imag / (1 + gain) - signal.real * math.sin(angle)) / math.cos(angle)
        return np.hypot(signal.real, y)

    design = np.stack(
        [
            np.ones(6),
            (modulus(GAIN + step, ANGLE) - modulus(GAIN - step, ANGLE)) / (2 * step),
            (modulus(GAIN, ANGLE + step) - modulus(GAIN, ANGLE - step)) / (2 * step),
        ],
        axis=1,
    )
    weighted = design / sigma[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    for name, place in (("gain", 1), ("phase", 2)):
        expected = math.sqrt(covariance[place, place])
        assert fit[f"quadrature_{name}_uncertainty"] == pytest.approx(
            expected, rel=1e-3
        )
    # A scatter of many errors enlarges them: by its reduced chi-square of 6 - 3.
    off = np.array([1, -1, 1, 1, -1, 1]) * 0.05
    signal = skewed(PHASES) * (1 + off)
    poor = demodulator._ellipse(signal, sigma, silent=0.0)
    gain, angle = poor["quadrature_gain"], poor["quadrature_phase"]
    y = (signal.imag / (1 + gain) - signal.real * math.sin(angle)) / math.cos(angle)
    size = np.hypot(signal.real, y)
    mean = np.average(size, weights=sigma**-2.0)
    excess = (((size - mean) / sigma) ** 2).sum() / 3
    ratio = poor["quadrature_gain_uncertainty"] / fit["quadrature_gain_uncertainty"]
    assert ratio == pytest.approx(math.sqrt(excess), rel=0.15)


def test_signals_are_five_with_gaps_of_at_most_120_degrees() -> None:
    def of(degrees: list[float], silent: float = 0.0) -> dict[str, object]:
        return demodulator._ellipse(
            skewed_by(np.radians(degrees)), np.full(len(degrees), 1e-3), silent=silent
        )

    def skewed_by(phases: np.ndarray) -> np.ndarray:
        return np.exp(1j * phases)

    assert of([0, 119, 180, 240, 300])["quadrature_gain"] == pytest.approx(0, abs=1e-9)
    assert of([-60, 59, 100, 150, 200], silent=0.099)
    for degrees, text in (
        ([0, 121, 180, 240, 300], "5 signals with gaps of up to 121 degrees"),
        ([10, 20, 100, 180, 240], "5 signals with gaps of up to 130 degrees"),
        ([0, 90, 180, 270], "4 signals with gaps of up to 90 degrees"),
    ):
        with pytest.raises(CubeError) as caught:
            of(degrees)
        assert str(caught.value) == (
            f"{text}; needed are 5 or more over a whole turn, such as every 45 degrees"
        )
    with pytest.raises(CubeError) as caught:
        of([0, 119, 180, 240, 300], silent=0.101)
    assert str(caught.value) == (
        "the terminated input shows 0.101 V, and the signals 1 V; put the cube with 50 "
        "ohm at the input first"
    )


def closed(signal: object, error: float = 1e-3, **attributes: object):
    return samples(
        np.asarray(signal) * np.ones((2, 2, 1, 2)),
        error=error, shutter="closed", **attributes,
    )  # fmt: skip


def test_the_offset_is_the_mean_over_channels_with_the_dark_output() -> None:
    value = np.array([[1.0, 3j], [2 + 2j, 4.0]])[..., None, None]
    cube = closed(
        value,
        dark_in_phase=np.array([0.1, 0.2, 0.3, 0.4]),
        dark_quadrature=np.array([1.0, 2.0, 3.0, 5.0]),
        dark_uncertainty=np.array([1e-3, 2e-3, 0.0, 3e-3]),
        time_coverage_start="2026-05-02T00:00:00Z",
    )
    result = from_terminated(cube)
    assert str(result.date) == "2026-05-02"
    first, second = result.demodulator
    assert (first.modulation_frequency, second.modulation_frequency) == (20e6, 50e6)
    assert_allclose(first.offset, [(1 + 0.1 + 0.2) / 2, (3 + 1 + 2) / 2])
    assert_allclose(second.offset, [(6 + 0.3 + 0.4) / 2, (2 + 3 + 5) / 2])
    # Two samples of 1 mV in each channel, and the dark outputs; half of their sum.
    expected = [math.sqrt(1 + 1 + 4) / 2, math.sqrt(1 + 0 + 9) / 2]
    found = [entry.offset_uncertainty for entry in result.demodulator]
    assert_allclose(found, np.array(expected) * 1e-3)
    assert first.quadrature_gain == 0
    assert first.quadrature_gain_uncertainty is None
    assert first.outputs == ()


def test_signals_are_fitted_without_the_offset() -> None:
    offset = 0.05 - 0.02j
    signals = [closed(value + offset, 1e-4) for value in skewed(PHASES)]
    result = from_terminated(closed(offset, 1e-3), signals)
    for entry in result.demodulator:
        assert entry.quadrature_gain == pytest.approx(GAIN)
        assert entry.quadrature_phase == pytest.approx(ANGLE)
        shown = [complex(*output) for output in entry.outputs]
        assert_allclose(shown, skewed(PHASES))
        # The error of the offset is ten times that of the signals.
        of_both = math.hypot(1e-3, 1e-4) / 2
        alone = demodulator._ellipse(skewed(PHASES), np.full(6, of_both), silent=0)
        assert entry.quadrature_gain_uncertainty == pytest.approx(
            alone["quadrature_gain_uncertainty"], rel=1e-3
        )


ZERO, AXIS, PASSED, CROSSED = 0.4, 0.07, 0.003, 0.02
GAINS = np.array([1.1 * np.exp(0.2j), 0.9 * np.exp(-0.5j)])
ANGLES = np.radians([0, 25, 50, 80, 105, 130, 155])


def share(angle: np.ndarray) -> np.ndarray:
    """Return the share of the first channel, by Malus' law, for both frequencies."""
    first, second = np.cos(angle - ZERO) ** 2, np.sin(angle - ZERO - AXIS) ** 2
    one = (first + PASSED * (1 - first))[:, None]
    other = GAINS * (second + CROSSED * (1 - second))[:, None]
    return one / (one + other)


def test_a_polarizer_shows_gains_and_crosstalk_with_their_errors() -> None:
    sigma = np.full((7, 2), 1e-3)
    sigma[:, 1] = 2e-3
    fit = polarizer._fit(ANGLES, share(ANGLES), sigma)
    own = math.cos(AXIS) ** 2 + CROSSED * math.sin(AXIS) ** 2
    other = math.sin(AXIS) ** 2 + CROSSED * math.cos(AXIS) ** 2
    assert_allclose(fit.gain, GAINS * own, rtol=1e-6)
    assert_allclose(fit.crosstalk, (PASSED, other / own), rtol=1e-5)

    def model(values: np.ndarray) -> np.ndarray:
        zero, axis, passed, crossed, a, b, c, d = values
        first, second = np.cos(ANGLES - zero) ** 2, np.sin(ANGLES - zero - axis) ** 2
        one = (first + passed * (1 - first))[:, None]
        light = (second + crossed * (1 - second))[:, None]
        both = one / (one + np.array([a + 1j * c, b + 1j * d]) * light)
        return np.concatenate(
            [(both / sigma).real.ravel(), (both / sigma).imag.ravel()]
        )

    truth = np.array([ZERO, AXIS, PASSED, CROSSED, *GAINS.real, *GAINS.imag])
    step = 1e-6
    design = np.stack(
        [
            (model(truth + row) - model(truth - row)) / (2 * step)
            for row in step * np.eye(8)
        ],
        axis=1,
    )
    covariance = np.linalg.inv(design.T @ design)
    error = np.sqrt(np.diag(covariance))
    of_gain = np.maximum(error[4:6], error[6:8]) * own
    assert_allclose(fit.gain_uncertainty, of_gain, rtol=1e-3)
    slope = np.array([math.sin(2 * AXIS), math.cos(AXIS) ** 2])
    of_other = math.sqrt(slope @ covariance[np.ix_([1, 3], [1, 3])] @ slope)
    assert_allclose(fit.crosstalk_uncertainty, (error[2], of_other / own), rtol=1e-3)
    # What the fit leaves of a scatter enlarges the errors: 28 outputs, 8 unknowns.
    rng = np.random.default_rng(0)
    noise = 2e-3 * (rng.standard_normal((7, 2)) + 1j * rng.standard_normal((7, 2)))
    poor = polarizer._fit(ANGLES, share(ANGLES) + noise, sigma / 10)
    scatter = 10 * np.concatenate([(noise / sigma).real, (noise / sigma).imag]).ravel()
    left = scatter - design @ np.linalg.lstsq(design, scatter)[0]
    ratio = poor.gain_uncertainty / fit.gain_uncertainty
    assert_allclose(ratio, math.sqrt(left @ left / 20) / 10, rtol=0.05)


def test_the_share_of_a_channel_is_that_of_all_pixels() -> None:
    first = np.array([1 + 1j, 2.0, 3j, complex(np.nan, 0)])
    second = np.array([1j, 1 - 1j, 2.0, 1.0])
    signal = np.stack([np.stack([first, second]), np.stack([second, first])])
    cube = samples(signal[:, :, None, :])
    found, error = polarizer._shares(cube)
    use = slice(0, 3)
    total = (first + second)[use]
    # Equal noise of both: the line of least distances in the plane of both channels.
    left, sizes, _ = np.linalg.svd(np.stack([first[use], second[use]]))
    power = (sizes[0] ** 2 - sizes[1] ** 2) * abs(left[:, 0].sum()) ** 2
    for k, part in enumerate((first[use], second[use])):
        expected = left[k, 0] / left[:, 0].sum()
        assert found[k] == pytest.approx(expected)
        rest = (np.abs(part - expected * total) ** 2).sum()
        # Each of two components, of three pixels less one.
        assert error[k] == pytest.approx(math.sqrt(rest / (2 * 2) / power))
    # Without known errors of a channel both count as equal.
    for unknown in (np.nan, 0.0):
        less = cube.copy(deep=True)
        less["in_phase_uncertainty"][0, 1] = unknown
        less["quadrature_uncertainty"][0, 1] = unknown
        assert_allclose(polarizer._shares(less)[0], found)
    two = samples(signal[:, :, None, 2:])
    with pytest.raises(CubeError) as caught:
        polarizer._shares(two)
    assert str(caught.value) == (
        "a cube through the polarizer has fewer than two pixels with both channels"
    )
    polarizer._shares(samples(signal[:, :, None, :2]))


def test_angles_of_a_polarizer_have_gaps_of_at_most_60_degrees() -> None:
    polarizer._refuse_angles(np.radians([0, 60, 90, 120, 150]))
    polarizer._refuse_angles(np.radians([10, 250, 130, 100, 40, 160]))
    for degrees, text in (
        ([0, 61, 90, 120, 150], "5 angles in half a turn, with gaps of up to 61"),
        ([0, 30, 60, 90, 119], "5 angles in half a turn, with gaps of up to 61"),
        ([0, 50, 90, 130], "4 angles in half a turn, with gaps of up to 50"),
        ([0, 50, 90, 130, 180], "4 angles in half a turn, with gaps of up to 50"),
        ([5], "1 angles in half a turn, with gaps of up to 180"),
        ([], "0 angles in half a turn, with gaps of up to 180"),
    ):
        with pytest.raises(CubeError) as caught:
            polarizer._refuse_angles(np.radians(degrees))
        assert str(caught.value) == (
            f"the polarizer has {text} degrees; needed are 5 or more with gaps of at "
            "most 60, such as every 30"
        )


def through(angle: float, **more: object):
    """Return samples behind a polarizer: light of another strength in each pixel."""
    light = np.array([1.0, 2j, 0.5 - 1j])
    one = share(np.array([angle]))[0]
    signal = np.stack([one, 1 - one], axis=1)[:, :, None, None] * light
    return samples(signal, **more)


def test_entries_of_a_polarizer_are_by_frequency_and_channel() -> None:
    cubes = [through(angle) for angle in ANGLES]
    cubes[0] = cubes[0].assign_attrs(time_coverage_start="2026-05-03T00:00:00Z")
    result = from_polarizer(cubes, angles=ANGLES)
    assert str(result.date) == "2026-05-03"
    places = [(e.modulation_frequency, e.polarization) for e in result.channels]
    assert places == [(f, pair) for f in (20e6, 50e6) for pair in ("VV", "VH")]
    own = math.cos(AXIS) ** 2 + CROSSED * math.sin(AXIS) ** 2
    other = math.sin(AXIS) ** 2 + CROSSED * math.cos(AXIS) ** 2
    gains = [complex(*entry.gain) for entry in result.channels]
    assert_allclose(gains, [1, GAINS[0] * own, 1, GAINS[1] * own], rtol=1e-6)
    crosstalk = [entry.crosstalk for entry in result.channels]
    assert_allclose(crosstalk, [PASSED, other / own] * 2, rtol=1e-4)
    assert [e.gain_uncertainty == 0 for e in result.channels] == [True, False] * 2
    swapped = [cube.isel(polarization=[1, 0]) for cube in cubes]
    assert len(from_polarizer(swapped, angles=ANGLES).channels) == 4
    with pytest.raises(CubeError, match="needed are two with orthogonal linear"):
        from_polarizer(
            [through(angle, channels=("VV", "VP")) for angle in ANGLES], angles=ANGLES
        )
    for odd in (
        through(0.0, frequencies=(20e6, 51e6)), through(0.0, channels=("VV", "VM"))
    ):  # fmt: skip
        with pytest.raises(CubeError) as caught:
            from_polarizer([*cubes[:6], odd], angles=ANGLES)
        assert str(caught.value) == (
            "the cubes through the polarizer differ in frequencies or channels; record "
            "all of them with one survey"
        )


DENSITY = np.array([0.5, 1.0, 1.5])


def test_transmissions_are_weighted_means_of_all_signals() -> None:
    light = np.array([[1.0, 0.99], [0.3, 0.31], [0.1, 0.1]])
    error = np.array([[0.01, 0.02], [0.01, 0.01], [0.001, 0.003]])
    filters, gain = measured_filters(DENSITY, light, error, leakage=0.01)
    assert gain is None
    first = 10**-0.5
    assert [one.density for one in filters] == [0.5, 1.0, 1.5]
    assert filters[0].transmission == pytest.approx(first)
    assert filters[0].uncertainty == 0
    ratio = np.log(light[1:] / light[0])
    sigma = np.sqrt((error[1:] / light[1:]) ** 2 + (error[0] / light[0]) ** 2)
    mean = np.average(ratio, axis=1, weights=sigma**-2)
    chi = (((ratio - mean[:, None]) / sigma) ** 2).sum() / 2
    own = np.sqrt(1 / (sigma**-2).sum(axis=1)) * math.sqrt(max(chi, 1))
    for one, logarithm, part in zip(filters[1:], mean, own, strict=True):
        assert one.transmission == pytest.approx(first * math.exp(logarithm))
        expected = math.hypot(one.transmission * part, 0.01 * first)
        assert one.uncertainty == pytest.approx(expected)


def test_a_scatter_beyond_the_errors_enlarges_them() -> None:
    light = np.array([[1.0, 1.0], [0.3, 0.36], [0.1, 0.1]])
    error = np.full(light.shape, 1e-3)
    filters, _ = measured_filters(DENSITY, light, error)
    ratio, relative = np.log(light[1:]), error / light
    sigma = np.hypot(relative[1:], relative[0])
    mean = np.average(ratio, axis=1, weights=sigma**-2)
    # Four ratios, two transmissions.
    chi = (((ratio - mean[:, None]) / sigma) ** 2).sum() / 2
    assert chi > 100
    for one, part in zip(filters[1:], sigma, strict=True):
        alone = 1 / math.sqrt((part**-2).sum())
        expected = one.transmission * alone * math.sqrt(chi)
        assert one.uncertainty == pytest.approx(expected)


@pytest.mark.parametrize(("weaker", "shown"), [(0.89, True), (0.91, False)])
def test_strengths_that_differ_by_a_tenth_show_the_gain(weaker, shown) -> None:
    light = np.array([1.0, 0.3, 0.1])[:, None] * np.array([1.0, weaker])
    # The logarithm of the gain is proportional to the output.
    amplitude = light.copy()
    for _ in range(60):
        amplitude = light * np.exp(-0.1 * amplitude)
    filters, gain = measured_filters(DENSITY, amplitude, np.full((3, 2), 1e-6))
    assert (gain is not None) == shown
    if gain is None:
        return
    largest = amplitude.max()
    assert gain[0] == pytest.approx(math.expm1(-0.1 * largest), rel=1e-6)
    stated = [10**-0.5 * 10**0 * part for part in (1.0, 0.3, 0.1)]
    assert_allclose([one.transmission for one in filters], stated, rtol=1e-6)


def test_the_error_of_the_gain_is_that_of_the_fit() -> None:
    light = np.array([1.0, 0.2])[:, None] * np.array([1.0, 0.5, 0.25])
    error = np.array([[1e-3, 2e-3, 1e-3], [1e-3, 1e-3, 2e-3]])
    _, gain = measured_filters(DENSITY[:2], light, error)
    assert gain is not None
    sigma = np.hypot(*(error / light))
    design = np.stack([np.ones(3), light[1] - light[0]], axis=1) / sigma[:, None]
    covariance = np.linalg.inv(design.T @ design)
    assert gain == pytest.approx((0.0, math.sqrt(covariance[1, 1])), abs=1e-12)
    # With as many signals as unknowns there is no scatter.
    _, gain = measured_filters(DENSITY[:2], light[:, :2], error[:, :2])
    assert gain is not None
    assert math.isfinite(gain[1])
