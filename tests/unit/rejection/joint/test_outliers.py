"""Samples that disagree are left out, up to a third; a wrong model is not hidden so."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint.samples import Pixels, weight
from amulor.rejection.joint.scatter import (
    Cleaned,
    disagrees,
    outlier_candidates,
    without_outliers,
)
from amulor.rejection.joint.search import Estimates, estimate
from amulor.rejection.joint.tables import Changes, Table

FREQUENCIES = np.array([12e6, 31e6, 57e6, 83e6, 104e6, 139e6])
RATE = 2 * np.pi * FREQUENCIES / speed_of_light
NOISE, PATH, COUNT = 0.01, 5.0, 400
EVERY = np.ones((1, 6), dtype=bool)


def drawn(seed: int) -> np.ndarray:
    """Return samples of targets at one path, without water."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((2, COUNT, 1, 6))
    return np.exp(1j * RATE * PATH) + NOISE * (noise[0] + 1j * noise[1])


def spoiled(number: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return samples of which so many are 8 to 40 sigma off, and which."""
    rng = np.random.default_rng(seed + 1)
    which = rng.permuted(np.tile(np.arange(6) < number, (COUNT, 1)), axis=1)[:, None]
    size = NOISE * rng.uniform(8, 40, which.shape)
    turn = np.exp(2j * np.pi * rng.random(which.shape))
    return drawn(seed) + np.where(which, size * turn, 0), which


def pixels_of(signal: np.ndarray) -> Pixels:
    """Return samples with their errors."""
    variance = np.full(signal.shape, NOISE**2)
    count = len(signal)
    return Pixels(
        signal=signal,
        covariance=Covariance(variance, variance, np.zeros_like(variance)),
        usable=np.ones(signal.shape, dtype=bool),
        interpolation=np.ones((count, 1)),
        offset=np.zeros(count),
        shortest=np.full(count, PATH - 1),
        longest=np.full(count, PATH + 1),
        depths=np.broadcast_to(np.linspace(1, 3, 33), (count, 33)).copy(),
        trends=np.zeros((count, 0)),
    )


def solved(pixels: Pixels) -> Estimates:
    """Return their paths, behind no water."""
    nothing = np.zeros((1, 4, 6), dtype=complex)
    table = Table(
        step=1.0,
        value=nothing,
        slope=nothing,
        basis=np.ones((1, 1)),
        level=np.ones(1),
        strength=1.0,
        differentiated=lambda: Changes(
            np.zeros((0, 1, 4, 1), complex), np.ones((1, 1))
        ),
    )
    return estimate(
        pixels,
        weight(pixels),
        table,
        gain=np.ones((1, 6), dtype=complex),
        transfer=np.ones(6, dtype=complex),
        phase_per_path=RATE,
    )


def cleaned(signal: np.ndarray, allowed: np.ndarray = EVERY) -> Cleaned:
    """Return what is left of samples."""
    pixels = pixels_of(signal)
    return without_outliers(pixels, solved(pixels), partial(solved), allowed, 1.0)


def test_good_samples_are_left_alone() -> None:
    found = solved(pixels_of(drawn(3)))
    # One in a thousand: 400 pixels hold more than three by chance in 0.1 %.
    assert disagrees(found).sum() <= 3
    kept = cleaned(drawn(3))
    assert (kept.pixels.usable.sum(axis=(1, 2)) < 6).sum() <= 3


@pytest.mark.parametrize("number", [1, 2])
def test_spoiled_samples_are_found_and_the_rest_is_right(number: int) -> None:
    signal, which = spoiled(number, 5)
    kept = cleaned(signal)
    exact = (kept.pixels.usable == ~which).all(axis=(1, 2))
    settled = ~kept.unsettled
    # A spike that happens to point along the echo turns no phase and stays, since the
    # amplitude follows it; two that point the same way in phase look like a delay.
    assert (exact & settled).mean() > (0.95 if number == 1 else 0.8)
    error = (kept.estimates.path - PATH) * np.sqrt(kept.estimates.information)
    # Of 300 and more pixels: 3.5 standard errors of the fraction inside.
    assert np.mean(np.abs(error[settled]) < 1.96) > 0.95 - 3.5 * np.sqrt(0.05 / 300)


def test_beyond_a_third_it_stays_open_which_are_wrong() -> None:
    signal, _ = spoiled(3, 7)
    kept = cleaned(signal)
    assert ((~kept.pixels.usable).sum(axis=(1, 2)) <= 2).all()
    error = np.abs(kept.estimates.path - PATH) * np.sqrt(kept.estimates.information)
    wrong = error > 3.5
    assert wrong.mean() > 0.2
    assert (kept.unsettled | disagrees(kept.estimates))[wrong].mean() > 0.9


def test_a_frequency_that_is_wrong_everywhere_is_the_models_fault() -> None:
    signal = drawn(9)
    signal[:, 0, 3] += 20 * NOISE
    found = solved(pixels_of(signal))
    allowed = outlier_candidates(found, (1, 6), 1.0)
    assert allowed.tolist() == [[True, True, True, False, True, True]]
    kept = cleaned(signal, allowed)
    assert kept.pixels.usable[:, 0, 3].all()


def test_pixels_that_see_two_surfaces_get_their_samples_back() -> None:
    signal, _ = spoiled(1, 11)
    pixels = pixels_of(signal)
    whole = solved(pixels)
    kept = without_outliers(pixels, whole, partial(solved), EVERY, 1.0)
    some = np.array([1, 4])
    restored = kept.restored(pixels, whole, some)
    assert restored.pixels.usable[some].all()
    assert (restored.estimates.path[some] == whole.path[some]).all()
    others = np.setdiff1d(np.arange(COUNT), some)
    assert (restored.estimates.path[others] == kept.estimates.path[others]).all()
