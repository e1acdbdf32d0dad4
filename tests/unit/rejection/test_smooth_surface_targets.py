"""Targets of smooth surfaces: samples that take part, turned signals, and windows."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor import rejection
from amulor.cube import QualityFlag, tiles
from amulor.rejection.smooth_surface import Smoothing

Make = Callable[..., xr.Dataset]
#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.smooth_surface")
SHAPE = (2, 1, 5, 6)


@pytest.fixture
def target(by_hand: Make) -> xr.Dataset:
    """Return a target signal with errors that differ and are correlated."""
    cube = by_hand(frequency=[20e6, 50e6], channels={"VV": (1.0, 1.0)}, shape=SHAPE[2:])
    found = rejection.open_water(cube)
    rng = np.random.default_rng(2)
    total = rng.uniform(2e-3, 4e-3, (2, *SHAPE))
    common = rng.uniform(5e-4, 1e-3, (2, *SHAPE))
    for k, name in enumerate(("in_phase", "quadrature")):
        found[f"{name}_uncertainty"].values[:] = total[k]
        found[f"common_{name}_uncertainty"].values[:] = common[k]
    found["in_phase_quadrature_covariance"].values[:] = 0.4 * total[0] * total[1]
    found["common_covariance"].values[:] = 0.2 * common[0] * common[1]
    found["quality_flag"].values[:] = 0
    return found


def turned(cube: xr.Dataset, prefix: str, cross: str, angle: np.ndarray) -> Any:
    """Return variances and covariance after a turn, by matrices."""
    a, b = (
        cube[f"{prefix}{n}_uncertainty"].values ** 2 for n in ("in_phase", "quadrature")
    )
    square = np.array([[a, cube[cross].values], [cube[cross].values, b]])
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    found = np.einsum("ik...,kl...,jl...->ij...", turn, square, turn)
    return found[0, 0], found[1, 1], found[0, 1]


def test_phases_turn_signal_and_errors(
    target: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, Any] = {}
    phase = np.linspace(-0.5, 0.5, 60).reshape(SHAPE)
    gain = np.linspace(0, 1, 30).reshape(SHAPE[2:])

    def smoothing(signal: Any, variance: Any, **options: Any) -> Smoothing:
        given.update(options, signal=signal, variance=variance)
        return Smoothing(phase=phase, gain=gain)

    monkeypatch.setattr(module, "smoothing", smoothing)
    flags = target["quality_flag"].values
    flags[0, 0, 0, 0] = QualityFlag.NO_TARGET
    flags[0, 0, 0, 1] = QualityFlag.OUTLIER
    flags[0, 0, 0, 2] = QualityFlag.SATURATED
    flags[0, 0, 0, 3] = QualityFlag.WATER_RESIDUAL
    target["in_phase"].values[1, 0, 4, 4] = np.nan
    for name in ("in_phase", "quadrature"):
        target[name].values[1, 0, 4, 3] = 0.0
    found = module._with_prior(target, 7)
    signal = target.amulor.signal.values
    assert_array_equal(given["signal"], signal)
    assert given["window"] == 7
    assert_array_equal(given["modulation_frequency"], [20e6, 50e6])
    # Independent errors across the signal, over its size.
    first, second = (
        turned(target, prefix, cross, -np.angle(np.where(np.isfinite(signal), signal,
                                                         1.0)))
        for prefix, cross in (("", "in_phase_quadrature_covariance"),
                              ("common_", "common_covariance"))
    )  # fmt: skip
    used = np.isfinite(signal) & (np.abs(signal) > 0)
    used[0, 0, 0, :3] = False
    assert used[0, 0, 0, 3]
    variance = given["variance"]
    assert np.isinf(variance[~used]).all()
    size = np.abs(signal[used])
    expected = (first[1] - second[1])[used] / size**2
    assert_allclose(variance[used], expected, rtol=1e-6)
    assert_allclose(found.amulor.signal.values, signal * np.exp(1j * phase))
    for prefix, cross in (("", "in_phase_quadrature_covariance"),
                          ("common_", "common_covariance")):  # fmt: skip
        in_phase, quadrature, both = turned(target, prefix, cross, phase)
        name = f"{prefix}in_phase_uncertainty"
        assert_allclose(found[name].values, np.sqrt(in_phase), rtol=1e-6)
        name = f"{prefix}quadrature_uncertainty"
        assert_allclose(found[name].values, np.sqrt(quadrature), rtol=1e-6)
        assert_allclose(found[cross].values, both, atol=1e-12)
    assert_array_equal(found["smoothing_gain"].values, gain)
    assert found["smoothing_gain"].dims == ("row", "column")
    assert found["smoothing_gain"].attrs["units"] == "1"
    assert "smooth surface in windows of 7 x 7" in found.attrs["history"]
    for name in ("quality_flag", "water_in_phase"):
        xr.testing.assert_equal(found[name], target[name])


def test_a_target_without_shared_errors_has_independent_ones(
    target: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []

    def smoothing(signal: Any, variance: Any, **options: Any) -> Smoothing:
        given.append(variance)
        return Smoothing(phase=np.zeros(SHAPE), gain=np.zeros(SHAPE[2:]))

    monkeypatch.setattr(module, "smoothing", smoothing)
    bare = target.drop_vars([n for n in target.variables if "common" in str(n)])
    found = module._with_prior(bare, 5)
    signal = target.amulor.signal.values
    cross = "in_phase_quadrature_covariance"
    expected = turned(target, "", cross, -np.angle(signal))[1] / np.abs(signal) ** 2
    assert_allclose(given[0], expected, rtol=1e-6)
    assert not [name for name in found.data_vars if "common" in str(name)]


def test_ranges_of_a_joint_estimation_are_moved_with_their_intervals(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: dict[str, Any] = {}
    phase = 1e-3 * np.array([[0.01, -0.02], [0.03, 0.0]])

    def smoothing(signal: Any, variance: Any, **options: Any) -> Smoothing:
        given.update(options, signal=signal, variance=variance)
        return Smoothing(phase=phase[None, None], gain=np.full((2, 2), 0.5))

    monkeypatch.setattr(module, "smoothing", smoothing)
    distance = np.array([[1.0, 2.0], [3.0, np.nan]])
    parts = {
        "": distance,
        "_uncertainty": np.array([[0.05, 0.02], [0.03, 0.03]]),
        "_common_uncertainty": np.array([[0.03, 0.02], [0.01, 0.01]]),
        "_lower": distance - 0.1,
        "_upper": distance + 0.3,
    }
    target = xr.Dataset(
        {f"joint_slant_range{n}": (("row", "column"), v) for n, v in parts.items()}
    )
    found = module._with_prior(target, 9)
    # A milliradian for a metre; the second pixel has no error of its own.
    expected = np.exp(1e-3j * np.array([[1.0, np.nan], [3.0, np.nan]]))
    assert_allclose(given["signal"][0, 0], expected)
    variance = given["variance"][0, 0]
    assert_allclose(variance[:, 0], 1e-6 * np.array([0.04**2, 0.03**2 - 0.01**2]))
    assert np.isinf(variance[:, 1]).all()
    assert given["window"] == 9
    assert_array_equal(given["modulation_frequency"], [1.0])
    moved = np.array([[0.01, -0.02], [0.03, 0.0]])
    for end in ("", "_lower", "_upper"):
        name = f"joint_slant_range{end}"
        assert_allclose(found[name].values, target[name].values + moved)
    for end in ("_uncertainty", "_common_uncertainty"):
        name = f"joint_slant_range{end}"
        xr.testing.assert_equal(found[name], target[name])
    assert_array_equal(found["smoothing_gain"].values, 0.5)


@pytest.mark.parametrize("window", [3, 4, 6, 11, 5.5])
def test_a_window_is_odd_and_from_five_to_nine(window: float) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        module._checked(window, "open-water")
    words = f"window must be an odd number of pixels from 5 to 9, got {window:g}"
    assert str(refusal.value) == words


def test_windows_and_bases_up_to_their_limits_are_accepted() -> None:
    assert module._checked(5.0, "open-water") == 5
    assert module._checked(9, "joint") == 9
    for base in ("auto", "smooth-surface"):
        with pytest.raises(ValueError) as refusal:  # noqa: PT011
            module._checked(5, base)
        words = f"base must be a method for single pixels, got {base!r}"
        assert str(refusal.value) == words


@pytest.mark.parametrize(
    ("rows", "columns", "words"),
    [
        (5, 5, ""),
        (4, 9, "the scan has 4 x 9 pixels, and a window of neighbors 5 x 5"),
        (9, 4, "the scan has 9 x 4 pixels, and a window of neighbors 5 x 5"),
    ],
)
def test_a_small_scan_has_no_window(rows: int, columns: int, words: str) -> None:
    cube = SimpleNamespace(sizes={"row": rows, "column": columns})
    assert module._unsuited(cube, None) == words


@pytest.mark.parametrize("window", [5, 7])
def test_rows_are_read_with_half_a_window_of_neighbors(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch, window: int
) -> None:
    cube = by_hand(frequency=[20e6, 50e6], channels={"VV": (1.0, 1.0)}, shape=(12, 6))
    read: list[tuple[int, int]] = []
    source = tiles.InMemory(cube)

    class Rows:
        rows, columns, head = source.rows, source.columns, source.head

        def tile(self, begin: int, end: int) -> xr.Dataset:
            read.append((begin, end))
            return source.tile(begin, end)

    base = SimpleNamespace(
        fit=lambda source, **options: lambda rows, first: rows, refine=None
    )
    monkeypatch.setattr(module, "load", lambda name: base)
    monkeypatch.setattr(module, "_with_prior", lambda target, width: target)
    of = module._fitter(Rows(), window=window)
    half = window // 2
    for first, count in ((0, 2), (5, 3), (10, 2)):
        rows = of(cube.isel(row=slice(first, first + count)), first)
        xr.testing.assert_equal(rows, cube.isel(row=slice(first, first + count)))
        expected = max(0, first - half), min(12, first + count + half)
        assert read[-1] == expected
