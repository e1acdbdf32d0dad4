"""Phasor lines of a scan and of its rows, by fits made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from spotted_scans import FREQUENCY, scan_of, spots

from amulor import rejection
from amulor.cube import QualityFlag, WaterResidualCause, tiles
from amulor.errors import CubeError
from amulor.rejection import covariance as covariances
from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.phasor_lines import (
    NoiseScale,
    PhasorLinesFit,
    _brightness_steps,
    _centers,
    _checked_window,
    _directions,
    _errors_of,
    _fit_scan,
    _fit_windows,
    _follow,
)
from amulor.rejection.smooth_water import Field, SmoothWater


def test_a_noise_scale_is_the_exponential_of_its_terms_at_least_one() -> None:
    azimuth, elevation = np.meshgrid(np.linspace(-1, 3, 5), np.linspace(0, 2, 3))
    terms = np.zeros((2, 1, 6))
    terms[0, 0] = [0.5, 0.2, 0.1, 0.3, -0.1, 0.05]
    terms[1, 0] = [-0.4, 0.9, 0.0, 0.0, 0.0, 0.0]
    scale = NoiseScale(field=Field.of(azimuth, elevation), terms=terms)
    x, y = (azimuth - 1) / 2, elevation - 1
    found = scale.at(azimuth, elevation)
    first = 0.5 + 0.2 * x + 0.1 * y + 0.3 * x**2 - 0.1 * x * y + 0.05 * y**2
    assert_allclose(found[0, 0], np.exp(np.maximum(first, 0)))
    assert_allclose(found[1, 0], np.exp(np.maximum(-0.4 + 0.9 * x, 0)))
    # A fluctuation adds to both outputs what it is beyond the stated variance.
    scan: Any = type("Scan", (), {})()
    scan.azimuth, scan.elevation = azimuth, elevation
    scan.covariance = Covariance(*(np.full((2, 1, 3, 5), v) for v in (1.0, 2.0, 0.5)))
    stated = np.array([0.25, 4.0]).reshape(2, 1, 1, 1)
    errors = _errors_of(scan, scale, stated)
    assert_allclose(errors.in_phase, 1.0 + (found - 1) * stated)
    assert_allclose(errors.quadrature, 2.0 + (found - 1) * stated)
    assert_allclose(errors.cross, 0.5)


def test_the_stated_variance_of_a_scan_is_the_harmonic_mean() -> None:
    rng = np.random.default_rng(5)
    shape = (2, 9, 9)
    error = np.where(np.arange(81).reshape(9, 9) % 2, 1e-3, 2e-3) * np.ones(shape)
    noise = error * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    signal = spots((9, 9), 3) * np.exp(1j * np.array([0.3, 0.9]))[:, None, None] + 0.1
    cube = scan_of(signal + noise, error=error)
    cube["in_phase"].values[0, 0, 0, 0] = np.nan
    fit = _fit_scan(Observation(cube=cube), 5)
    # 41 variances of 4e-6 with one lost, and 40 of 1e-6.
    first, second = 80 / (40 / 4 + 40) * 1e-6, 81 / (41 / 4 + 40) * 1e-6
    assert_allclose(fit.stated.ravel(), [first, second], rtol=1e-9)
    assert fit.stated.shape == (2, 1, 1, 1)
    assert not fit.has_edges
    assert fit.by_water.shape == (2, 1, 1, 1)
    assert fit.terms == ()
    flat = scan_of(0.3 * np.ones((2, 9, 9)) * np.exp(0.3j) + noise, error=error)
    words = (
        "the reflectance does not vary within 5 x 5 pixels, or by less than noise "
        "hides, so that no line gives the phase of the target; record open water "
        "(--method open-water), or use --method joint"
    )
    with pytest.raises(CubeError) as refusal:
        _fit_scan(Observation(cube=flat), 5)
    assert str(refusal.value) == words


def test_the_middle_of_each_window_is_its_direction() -> None:
    scan = Observation(cube=scan_of(np.ones((1, 7, 10), dtype=complex)))
    for window, half in ((5, 2), (7, 3)):
        azimuth, elevation = _centers(scan, window)
        assert azimuth.shape == (7 - 2 * half, 10 - 2 * half)
        assert_allclose(azimuth[0], 0.002 * np.arange(half, 10 - half))
        assert_allclose(elevation[:, 0], -0.002 * np.arange(half, 7 - half))


def noisy_scan(seed: int = 1, flat: int = 0) -> tuple[xr.Dataset, Observation]:
    rng = np.random.default_rng(seed)
    wave = 4 * np.pi * FREQUENCY * 1.38 / 299792458.0
    columns = np.arange(11)
    phase = wave[:, None, None] * (1.5 + 0.004 * columns)
    noise = 1e-3 * (
        rng.standard_normal((2, 10, 11)) + 1j * rng.standard_normal((2, 10, 11))
    )
    bright = spots((10, 11), 3)
    bright[:, :flat] = 0.8
    cube = scan_of(bright * np.exp(1j * phase) + 0.2 + noise)
    cube["in_phase"].values[1, 0, 4, 5] = np.nan
    return cube, Observation(cube=cube)


def fit_of(scan: Observation, **changed: Any) -> PhasorLinesFit:
    """Return a fit by hand: noise larger by 4, water without any signal."""
    field = Field.of(scan.azimuth, scan.elevation)
    none, twice = np.zeros((2, 1, 6)), np.zeros((2, 1, 6))
    twice[..., 0] = np.log(2.0)
    values: dict[str, Any] = {
        "fluctuation": NoiseScale(field=field, terms=twice),
        "stated": np.full((2, 1, 1, 1), 1e-6),
        "noise_scale": NoiseScale(field=field, terms=twice),
        "water": SmoothWater(
            field=field,
            terms=np.zeros((2, 1, 31)),
            covariance=np.zeros((2, 1, 31, 31)),
            misfit=np.ones((2, 1)),
        ),
        "by_water": np.zeros((2, 1, 1, 1), dtype=bool),
        "has_edges": False,
        "terms": ("counting", "fluctuation"),
    }
    assert none.shape == twice.shape
    return PhasorLinesFit(**values | changed)


def test_targets_by_windows_have_the_phase_and_error_of_their_line() -> None:
    cube, scan = noisy_scan(flat=6)
    result, _ = _follow(cube, window=5, fit=fit_of(scan))
    lines = _fit_windows(scan, scan.covariance.scaled(2.0), 5)
    lines.scale(np.full(lines.misfit.shape, 2.0))
    windows = _directions(lines, scan.frequency, 5)
    signal = scan.signal
    finite = np.isfinite(signal)
    found = result.amulor.signal.values
    assert_array_equal(np.isfinite(found), finite)
    expected = np.abs(signal) * np.exp(1j * windows.phase)
    assert_allclose(found[finite], expected[finite])
    water = result["water_in_phase"] + 1j * result["water_quadrature"]
    assert_allclose(water.values[finite], (signal - expected)[finite], atol=1e-9)
    # Along the line four times the stated variance, across it that of the phase; a
    # phase that no window gives is off by a radian.
    sure = windows.variance < 0.01
    assert 0.5 < sure.mean() < 1
    across = np.abs(signal) ** 2 * np.where(sure, windows.variance, 1.0)
    c, s = np.cos(windows.phase), np.sin(windows.phase)
    in_phase = result["in_phase_uncertainty"].values ** 2
    quadrature = result["quadrature_uncertainty"].values ** 2
    cross = result["in_phase_quadrature_covariance"].values
    expected_variance = c**2 * 4e-6 + s**2 * across
    assert_allclose(in_phase[finite], expected_variance[finite], rtol=1e-5)
    expected_variance = s**2 * 4e-6 + c**2 * across
    assert_allclose(quadrature[finite], expected_variance[finite], rtol=1e-5)
    expected_variance = c * s * (4e-6 - across)
    assert_allclose(cross[finite], expected_variance[finite], atol=1e-10)
    # Half of the variance of the samples is stated, a quarter of their total.
    counting, rest = (
        result[f"phase_uncertainty_{name}"].values for name in ("counting",
                                                                 "fluctuation")
    )  # fmt: skip
    ratio = (counting / rest)[finite & sure]
    assert_allclose(ratio, np.sqrt(0.25 / 0.75), rtol=1e-3)
    assert result.attrs["phasor_line_window"] == 5
    assert result.attrs["frequencies_share_errors"] == 0
    words = "reject, phasor lines in windows of 5 x 5 pixels"
    assert words in result.attrs["history"]
    cause = result["water_residual_cause"].values
    flag = result["quality_flag"].values
    detected = (flag & (QualityFlag.NO_TARGET | QualityFlag.MISSING)) == 0
    doubtful = windows.doubtful | _brightness_steps(scan, 5)
    assert_array_equal(cause != 0, np.broadcast_to(doubtful, cause.shape) & detected)
    assert flag[1, 0, 4, 5] == QualityFlag.MISSING


def test_a_scan_of_edges_is_doubtful_as_a_whole() -> None:
    cube, scan = noisy_scan()
    result, _ = _follow(cube, window=5, fit=fit_of(scan, has_edges=True))
    flag = result["quality_flag"].values
    detected = (flag & (QualityFlag.NO_TARGET | QualityFlag.MISSING)) == 0
    cause = result["water_residual_cause"].values
    assert detected.any()
    assert_array_equal(cause[detected], WaterResidualCause.MODEL_MISFIT)
    assert_array_equal(cause[~detected], 0)


def test_targets_by_water_are_samples_less_the_water() -> None:
    cube, scan = noisy_scan()
    terms = np.zeros((2, 1, 31))
    terms[..., 0], terms[..., 15] = 0.2, 0.03
    covariance = np.zeros((2, 1, 31, 31))
    covariance[..., 0, 0], covariance[..., 15, 15] = 1e-4, 4e-4
    field = Field.of(scan.azimuth, scan.elevation)
    water = SmoothWater(
        field=field, terms=terms, covariance=covariance, misfit=np.ones((2, 1))
    )
    fit = fit_of(
        scan,
        water=water,
        by_water=np.ones((2, 1, 1, 1), dtype=bool),
        has_edges=True,
        terms=("counting", "reference", "fluctuation"),
    )
    result, same = _follow(cube, window=5, fit=fit)
    finite = np.isfinite(scan.signal)
    target = scan.signal - (0.2 + 0.03j)
    assert_allclose(result.amulor.signal.values[finite], target[finite])
    assert "phasor_line_window" not in result.attrs
    assert set(same.terms) == {"counting", "fluctuation", "reference"}
    # Doubts of windows do not count.
    assert_array_equal(result["water_residual_cause"].values, 0)
    for name, variance in (("in_phase", 1e-4), ("quadrature", 4e-4)):
        found = result[f"common_{name}_uncertainty"].values ** 2
        assert_allclose(found[finite], variance, rtol=1e-5)
        # The noise grows by the error of the amplitude that divides it.
        side = np.exp(1j * np.angle(target))
        unsure = side.real**2 * 1e-4 + side.imag**2 * 4e-4
        unsure = np.minimum(unsure / np.abs(target) ** 2, 1.0)
        total = result[f"{name}_uncertainty"].values ** 2
        expected = 4e-6 * (1 + 3 * unsure) + variance
        assert_allclose(total[finite], expected[finite], rtol=1e-5)
    reference = covariances.phase_uncertainties(
        target, {"": Covariance(*(np.full(target.shape, v) for v in (1e-4, 4e-4, 0)))}
    )[""]
    found = result["phase_uncertainty_reference"].values
    assert_allclose(found[finite], reference[finite], rtol=1e-4)


def test_one_frequency_may_be_by_water_and_the_other_by_windows() -> None:
    cube, scan = noisy_scan()
    mixed = np.array([True, False]).reshape(2, 1, 1, 1)
    covariance = np.zeros((2, 1, 31, 31))
    covariance[..., 0, 0] = 1e-4
    water = SmoothWater(
        field=Field.of(scan.azimuth, scan.elevation),
        terms=np.zeros((2, 1, 31)),
        covariance=covariance,
        misfit=np.ones((2, 1)),
    )
    one = _follow(cube, window=5, fit=fit_of(scan, by_water=mixed, water=water))[0]
    two = _follow(cube, window=5, fit=fit_of(scan, by_water=mixed | True, water=water))[
        0
    ]
    none = _follow(
        cube, window=5, fit=fit_of(scan, by_water=mixed & False, water=water)
    )[0]
    for name in ("in_phase", "quadrature_uncertainty", "common_in_phase_uncertainty"):
        assert_allclose(one[name].values[0], two[name].values[0])
        assert_allclose(one[name].values[1], none[name].values[1])
    # The water is in the phases of windows: no error that pixels share.
    shared = none["common_in_phase_uncertainty"].values
    assert_allclose(shared[np.isfinite(scan.signal)], 0.0)
    assert (one["common_in_phase_uncertainty"].values[0] > 0).all()
    assert one.attrs["phasor_line_window"] == 5


@pytest.mark.parametrize("window", [3, 4, 6, 5.5, -5, 0])
def test_a_window_is_an_odd_number_of_at_least_five(window: float) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        _checked_window(window, 20, 20)
    words = f"window must be an odd number of pixels from 5 on, got {window:g}"
    assert str(refusal.value) == words


def test_a_window_may_be_as_large_as_the_scan() -> None:
    assert _checked_window(5.0, 5, 9) == 5
    assert isinstance(_checked_window(7.0, 9, 7), int)
    for rows, columns in ((4, 9), (9, 4)):
        with pytest.raises(CubeError) as refusal:
            _checked_window(5, rows, columns)
        assert str(refusal.value) == (
            f"the scan has {rows} x {columns} pixels, but phasor lines need windows of "
            "5 x 5; scan more rows and columns, or use another method"
        )


@pytest.mark.parametrize("window", [5, 7])
def test_each_row_is_that_of_the_whole_scan(window: int) -> None:
    cube, _ = noisy_scan()
    wide = xr.concat([cube, cube.isel(row=slice(0, 6))], "row", data_vars="minimal")
    whole = rejection.phasor_lines(wide, window=window)
    of = rejection.load("phasor-lines").fit(tiles.InMemory(wide), window=window)
    for first in (0, 7, 15):
        part = of(wide.isel(row=slice(first, first + 1)), first)
        assert part.sizes["row"] == 1
        for name in ("in_phase", "quadrature_uncertainty", "water_residual_cause"):
            expected = whole[name].values[:, :, first : first + 1]
            assert_allclose(part[name].values, expected, rtol=1e-6, atol=1e-12)
