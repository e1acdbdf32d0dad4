"""Planes through neighbors against weighted least squares, pixel by pixel."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.rejection.smooth_surface import Smoothing, smoothing

FREQUENCY = np.array([20e6, 70e6, 100e6])
WAVE = FREQUENCY / 100e6


def by_least_squares(
    signal: np.ndarray, variance: np.ndarray, window: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return phases and gains by one least-squares problem after the other."""
    planes = signal.reshape(-1, *signal.shape[2:])
    errors = variance.reshape(planes.shape)
    wave = np.repeat(WAVE, signal.shape[1])
    known = np.isfinite(planes) & (errors > 0) & (errors < 1 / 9)
    phase, gain = np.zeros(planes.shape), np.zeros(planes.shape[1:])
    half = window // 2
    for row, column in np.ndindex(gain.shape):
        here = known[:, row, column]
        place, shift, spread, first, turns = [], [], [], [], []
        for i, j in itertools.product(range(-half, half + 1), repeat=2):
            y, x = row + i, column + j
            if (i, j) == (0, 0) or not (0 <= y < len(gain) and 0 <= x < len(gain.T)):
                continue
            both = here & known[:, y, x]
            if not both.any():
                continue
            turn = np.angle(planes[both, y, x] / planes[both, row, column])
            noise = np.stack([errors[both, y, x], errors[both, row, column]])
            # The range, as phase at the highest frequency, by weighted means.
            part = wave[both] / noise.sum(axis=0)
            part /= (part * wave[both]).sum()
            off = np.full(len(wave), (part * turn).sum()) * wave
            off[both] = turn
            parts = (part**2 * noise).sum(axis=1)
            place.append([1.0, i / half, j / half])
            shift.append((part * turn).sum())
            spread.append(parts[0])
            first.append(shift[-1] / np.sqrt(parts.sum()))
            turns.append(off)
        if len(place) < 4:
            continue
        design, z, v = np.array(place), np.array(shift), np.array(spread)
        deviation = np.array(first)
        for _ in range(4):
            kept = np.clip(1 - (deviation / 4) ** 2, 0, 1) ** 2
            root = np.sqrt(kept / v)
            solution = np.linalg.pinv(design * root[:, None]) * root
            rest = z - design @ (solution @ z)
            deviation = rest / np.sqrt(v)
        inside = kept > 0
        freedom = kept.sum() - 3
        if freedom < 5:
            continue
        weight = solution[0]
        of_plane = np.sum((weight**2 * v)[inside])
        own = 1 / np.sum(wave[here] ** 2 / errors[here, row, column])
        # Mean square of the residuals beyond noise, and half its standard error.
        square = np.sum(kept * rest**2 / v)
        beyond = max(square - freedom, 0) + 0.5 * np.sqrt(2 * freedom)
        departure = 2.75 * beyond / freedom * np.sum(kept * v) / kept.sum()
        departure = max(departure, (weight @ z) ** 2 - own - of_plane)
        gain[row, column] = own / (own + of_plane + departure)
        phase[here, row, column] = gain[row, column] * (weight @ np.array(turns))[here]
    return phase.reshape(signal.shape), gain


def smoothed(signal: np.ndarray, variance: np.ndarray, window: int) -> Smoothing:
    return smoothing(signal, variance, modulation_frequency=FREQUENCY, window=window)


@pytest.mark.parametrize("window", [5, 7])
@pytest.mark.parametrize("rough", [0.0, 0.02])
def test_planes_are_those_of_weighted_least_squares(window: int, rough: float) -> None:
    rng = np.random.default_rng(window)
    shape = (3, 2, 8, 9)
    variance = rng.uniform(1e-4, 9e-4, shape)
    row, column = np.mgrid[:8, :9]
    surface = 0.03 * row - 0.05 * column + 0.15 * (column > 5)
    surface = surface + rough * rng.standard_normal(surface.shape)
    phase = WAVE[:, None, None, None] * surface
    phase = phase + np.sqrt(variance) * rng.standard_normal(shape)
    signal = rng.uniform(0.5, 2, shape) * np.exp(1j * phase)
    # Samples that are lost, have no error, or an amplitude below three errors.
    signal[0, 0, 2, 3] = np.nan
    signal[:, :, 6, 6] = np.nan
    variance[1, 1, 4, 4], variance[2, 0, 5, 1] = 0.0, 1 / 9.0001
    variance[2, 1, 5, 1], variance[0, 1, 1, 1] = 1 / 8.9999, np.inf
    found = smoothed(signal, variance, window)
    expected, gain = by_least_squares(signal, variance, window)
    assert_allclose(found.gain, gain, atol=2e-7)
    assert_allclose(found.phase, expected, atol=2e-8)
    assert found.gain[6, 6] == 0
    assert np.count_nonzero(gain) > 30


def test_a_pixel_needs_five_neighbors_beyond_a_plane() -> None:
    for count, has_plane in ((8, False), (9, True)):
        # Of a scan only the first row and some of the second are known.
        signal = np.full((3, 1, 5, 5), np.nan, dtype=complex)
        signal.reshape(3, -1)[:, :count] = 1.0
        gain = smoothed(signal, np.full(signal.shape, 1e-4), 5).gain
        # All others are neighbors of the middle of the first row.
        assert (gain[0, 2] > 0) == has_plane
