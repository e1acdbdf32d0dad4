"""Backgrounds of scans: smooth signals with a fluctuation, windows, objections."""

from __future__ import annotations

import importlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.stats import chi2

from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance

#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.background")
ROWS, COLUMNS = 24, 36
FREQUENCY = np.array([20e6, 50e6, 80e6])
WAVE = 2 * np.pi * FREQUENCY * 1.38 / 299792458.0


def smooth(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the terms of a direction, and signals whose logarithm they make."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(
        np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLUMNS), indexing="ij"
    )
    terms = [np.ones_like(x), x, y, x**2, x * y, y**2]
    design = np.stack([term.ravel() for term in terms], axis=-1)
    parts = rng.standard_normal((2, 3, 6)) * [0, 0.5, 0.5, 0.2, 0.2, 0.2]
    exponent = parts[0] + 1j * parts[1]
    exponent[:, 0] = np.log([60.0, 40.0, 25.0])
    return design, np.exp(exponent @ design.T)


def samples(seed: int, fluctuation: float = 0.0) -> tuple[np.ndarray, ...]:
    """Return design, signals without noise, and samples with errors of 1."""
    rng = np.random.default_rng(seed + 50)
    design, water = smooth(seed)
    draws = rng.standard_normal((4, *water.shape))
    change = fluctuation * (draws[2] + 1j * draws[3]) * np.abs(water)
    return design, water, water + draws[0] + 1j * draws[1] + change


def window() -> np.ndarray:
    """Return the pixels of a window in the middle."""
    row, column = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    return (abs(row - 12) < 5) & (abs(column - 18) < 5)


@pytest.mark.parametrize("fluctuation", [0.0, 0.1])
def test_a_smooth_signal_is_found_from_a_window(fluctuation: float) -> None:
    design, water, measured = samples(1, fluctuation)
    found = module._fit(measured, design, window())
    # All but one in a thousand are background.
    assert found.pixels.mean() > 0.99
    # 864 pixels for six terms: a twelfth of an error.
    off = measured - found.rest - water
    error = np.sqrt(1 + fluctuation**2 * np.abs(water) ** 2)
    assert np.sqrt(np.mean((np.abs(off) / error) ** 2)) < 0.2
    assert found.fluctuation == pytest.approx(fluctuation, abs=0.006)
    expected = np.abs(found.rest) / np.sqrt(
        1 + found.fluctuation**2 * np.abs(water) ** 2
    )
    assert_allclose(found.significance, expected, rtol=0.1, atol=0.1)
    # Both outputs have the variance 1: the mean square is 2.
    assert np.mean(found.significance**2) == pytest.approx(2.0, rel=0.15)


def test_pixels_off_the_signal_lose_their_weight() -> None:
    design, water, measured = samples(2)
    target = np.zeros(ROWS * COLUMNS, dtype=bool)
    target[:200] = True
    measured = measured + 60 * target
    found = module._fit(measured, design, window())
    assert not found.pixels[target].any()
    assert found.pixels[~target].mean() > 0.99
    assert np.abs((measured - found.rest - water)[:, ~target]).mean() < 0.3
    # On both sides of a chance of one in a thousand.
    square = np.sum(found.significance**2, axis=0)
    limit = float(chi2.isf(1e-3, 6))
    near = np.abs(square / limit - 1) > 0.02
    np.testing.assert_array_equal(found.pixels[near], square[near] < limit)


def test_a_signal_of_zero_starts_at_one_standard_error() -> None:
    design, _, _ = samples(3)
    found = module._fit(np.zeros((2, len(design)), dtype=complex), design, window())
    assert np.isfinite(found.rest).all()
    assert found.pixels.all()


@pytest.mark.parametrize(
    ("size", "starts"),
    [(3, [0]), (4, [0]), (7, [0]), (8, [0, 4]), (12, [0, 4, 8]),
     (24, [0, 4, 8, 12, 16, 20]), (101, [0, 19, 38, 58, 77, 97])],
)  # fmt: skip
def test_windows_cover_a_scan_side_by_side(size: int, starts: list[int]) -> None:
    assert module._starts(size).tolist() == starts


def scan_of(**changed: Any) -> Any:
    geometry = xr.DataArray(
        0,
        attrs={
            "group_index": 1.38,
            "receiver_position": [0.3, 0.0, 0.1],
            "emitter_position": [0.0, 0.4, 0.1],
        },
    )
    values = {
        "frequency": FREQUENCY,
        "polarizations": ["VV", "VH"],
        "cube": {"geometry": geometry},
    }
    return SimpleNamespace(**values | changed)


def test_paths_are_tried_in_tenths_of_a_radian() -> None:
    found = module._paths(scan_of(), (1.0, 3.0))
    # From twice the nearest range to twice the farthest and the way aside.
    assert found[0] == 2.0
    assert 6.5 - 0.1 / WAVE[-1] < found[-1] < 6.5
    assert_allclose(np.diff(found), 0.1 / WAVE[-1])
    whole = module._paths(scan_of(), None)
    assert whole[0] == 0.0
    # From 0 to 20 MHz is the smallest of the steps.
    assert 2 * np.pi / WAVE[0] - 0.1 / WAVE[-1] <= whole[-1] < 2 * np.pi / WAVE[0]


def candidate(rest: np.ndarray, significance: np.ndarray | None = None) -> Any:
    size = np.abs(rest) if significance is None else significance
    return SimpleNamespace(
        rest=rest, significance=size, pixels=np.ones(rest.shape[1], dtype=bool),
        fluctuation=0.0,
    )  # fmt: skip


def echoes(seed: int, count: int, spread: float) -> np.ndarray:
    """Return echoes of ten errors in two channels, whose phases scatter."""
    rng = np.random.default_rng(seed)
    paths = rng.uniform(2.5, 6.0, count)
    turn = np.exp(1j * np.outer(np.repeat(WAVE, 2), paths))
    scatter = np.exp(1j * spread * rng.standard_normal((6, count)))
    return np.asarray(10 * turn * scatter)


def test_echoes_have_a_coherence_of_95_percent_or_no_water_is_seen() -> None:
    paths = module._paths(scan_of(), (1.0, 3.0))
    assert module._objection(candidate(echoes(1, 40, 0.0)), scan_of(), paths) == ""
    # exp(-s^2 / 2) of phases that scatter by s: 0.98 and 0.92, with six of them.
    assert module._objection(candidate(echoes(2, 300, 0.2)), scan_of(), paths) == ""
    wrong = module._objection(candidate(echoes(3, 300, 0.5)), scan_of(), paths)
    assert "are no echoes (coherence 0.9" in wrong
    assert "needed is 0.95" in wrong


@pytest.mark.parametrize(("count", "enough"), [(4, False), (5, True)])
def test_five_echoes_of_two_frequencies_are_needed(count: int, enough: bool) -> None:
    rest = np.zeros((6, 30), dtype=complex)
    rest[:, :count] = echoes(4, count, 0.0)
    paths = module._paths(scan_of(), (1.0, 3.0))
    said = module._objection(candidate(rest), scan_of(), paths)
    assert (said == "") == enough
    assert enough or said.startswith("nearly all pixels agree with one smooth signal")
    # Both channels of one frequency have one phase, which fits any distance.
    rest[2:] = 0.0
    assert module._objection(candidate(rest), scan_of(), paths) != ""


@pytest.mark.parametrize(("size", "counts"), [(4.001, True), (3.999, False)])
def test_samples_count_from_four_standard_errors_on(size: float, counts: bool) -> None:
    rest = echoes(5, 20, 0.0)
    paths = module._paths(scan_of(), (1.0, 3.0))
    part = candidate(rest, np.full(rest.shape, size))
    assert (module._objection(part, scan_of(), paths) == "") == counts


def found_by(monkeypatch: pytest.MonkeyPatch, parts: list[Any]) -> np.ndarray:
    """Return the background of 300 pixels, of candidates that are given."""
    monkeypatch.setattr(module, "_candidates", lambda *_: parts)
    monkeypatch.setattr(module, "_paths", lambda *_: np.zeros(1))
    monkeypatch.setattr(module, "_objection", lambda part, *_: part.reason)
    shape = 3, 1, 10, 30
    scan = scan_of(
        signal=np.ones(shape, dtype=complex), usable=np.ones(shape, dtype=bool)
    )
    return np.asarray(module.find_background(scan, None))


def part_of(count: int, fluctuation: float = 0.0, reason: str = "") -> Any:
    return SimpleNamespace(
        pixels=np.arange(300) < count, fluctuation=fluctuation, reason=reason
    )


def test_a_background_has_a_tenth_of_the_pixels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert found_by(monkeypatch, [part_of(30)]).sum() == 30
    with pytest.raises(CubeError, match="explains 30 of 300 pixels"):
        found_by(monkeypatch, [part_of(29)])
    # A fluctuation of 40 % is no smooth signal.
    assert found_by(monkeypatch, [part_of(40, 0.399)]).sum() == 40
    with pytest.raises(CubeError, match="no smooth water signal"):
        found_by(monkeypatch, [part_of(40, 0.401)])


def test_the_largest_of_the_steady_backgrounds_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Twice the fluctuation of the steadiest, and one percent.
    parts = [part_of(50, 0.02), part_of(80, 0.0499), part_of(120, 0.0501)]
    assert found_by(monkeypatch, parts).sum() == 80
    parts.append(part_of(200, 0.01, "edge"))
    assert found_by(monkeypatch, parts).sum() == 80
    with pytest.raises(CubeError, match=r"^wide; record open water"):
        found_by(monkeypatch, [part_of(50, 0.0, "small"), part_of(60, 0.0, "wide")])


def test_candidates_come_from_windows_that_no_other_explains() -> None:
    design, water, measured = samples(6)
    del design
    signal = (1e-3 * measured).reshape(3, 1, ROWS, COLUMNS)
    variance = np.full(signal.shape, 1e-6)
    y, x = np.meshgrid(
        np.linspace(-0.1, 0.1, ROWS), np.linspace(-0.2, 0.2, COLUMNS), indexing="ij"
    )
    scan = scan_of(
        signal=signal,
        covariance=Covariance(1.2 * variance, 0.8 * variance, 0 * variance),
        azimuth=x,
        elevation=y,
    )
    flat = np.arange(ROWS * COLUMNS)
    found = module._candidates(scan, flat)
    # One signal explains all: the other windows are left out.
    assert len(found) == 1
    assert found[0].pixels.mean() > 0.99
    assert np.abs(found[0].rest).std() < 1.0
    assert_allclose(1e3 * signal.reshape(3, -1) - found[0].rest, water, atol=1.5)
    # A second signal in the right third is found by windows of its own.
    signal[..., 24:] *= 1.5
    assert len(module._candidates(scan, flat)) >= 2
    # Half of the 4 x 4 pixels of a window must be usable.
    assert module._candidates(scan, flat[flat // COLUMNS < 2]) != []
    assert module._candidates(scan, flat[flat // COLUMNS < 1]) == []
