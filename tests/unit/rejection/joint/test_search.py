"""The search for the most likely path, behind a water signal that is known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light
from scipy.stats import chi2

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint._kernels.bundles import Echo
from amulor.rejection.joint.samples import Pixels, phasors, weight
from amulor.rejection.joint.search import (
    Estimates,
    are_two,
    estimate,
    may_be_two,
    two_surfaces,
)
from amulor.rejection.joint.tables import Changes, Table

FREQUENCIES = np.array([12e6, 31e6, 57e6, 83e6, 104e6, 139e6])


def _scene(
    signal: np.ndarray,
    sigma: np.ndarray,
    water: np.ndarray,
    frequency: np.ndarray,
    *,
    shortest: float = 2.0,
    longest: float = 8.0,
    open_water: np.ndarray | None = None,
    missing: tuple[int, ...] = (),
) -> tuple[Pixels, Table]:
    """Return pixels, and a water signal that does not depend on its end.

    Unless open water is another one. Some frequencies may be missing.
    """
    variance = np.broadcast_to(sigma**2, signal.shape).copy()
    count = len(signal)
    pixels = Pixels(
        signal=signal,
        covariance=Covariance(variance, variance, np.zeros_like(variance)),
        usable=np.broadcast_to(
            ~np.isin(np.arange(frequency.size), missing), signal.shape
        ),
        interpolation=np.ones((count, 1)),
        offset=np.zeros(count),
        shortest=np.full(count, shortest),
        longest=np.full(count, longest),
        depths=np.broadcast_to(np.linspace(1, 3, 33), (count, 33)).copy(),
        trends=np.zeros((count, 0)),
    )
    value = np.broadcast_to(water, (1, 4, frequency.size)).astype(complex)
    value = value.copy()
    if open_water is not None:
        value[:, -1] = open_water
    table = Table(
        step=1.0,
        value=np.ascontiguousarray(value),
        slope=np.zeros_like(value),
        basis=np.ones((1, 1)),
        level=np.ones(1),
        strength=1.0,
        differentiated=lambda: Changes(
            np.zeros((0, 1, 4, 1), complex), np.ones((1, 1))
        ),
    )
    return pixels, table


def _solve(
    signal: np.ndarray,
    sigma: np.ndarray,
    water: np.ndarray,
    frequency: np.ndarray,
    *,
    fluctuation: float = 0.0,
    **others: Any,
) -> Estimates:
    """Return the estimate behind a water signal, with further arguments of a scene."""
    pixels, table = _scene(signal, sigma, water, frequency, **others)
    return estimate(
        pixels,
        weight(pixels),
        table,
        gain=np.ones((1, frequency.size), dtype=complex),
        transfer=np.ones(frequency.size, dtype=complex),
        phase_per_path=2 * np.pi * frequency / speed_of_light,
        fluctuation=fluctuation,
    )


paths = st.floats(3.0, 7.0)
amplitudes = st.floats(0.1, 10.0)
seeds = st.integers(0, 2**32 - 1)


def _draw(path: float, amplitude: float, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    wavenumber = 2 * np.pi * FREQUENCIES / speed_of_light
    water = rng.standard_normal(6) + 1j * rng.standard_normal(6)
    noise = rng.standard_normal((1, 1, 6)) + 1j * rng.standard_normal((1, 1, 6))
    sigma = np.array(0.01 * amplitude)
    signal = amplitude * np.exp(1j * wavenumber * path) + water + sigma * noise
    return signal, sigma, water


@settings(max_examples=40)
@given(paths, amplitudes, seeds)
def test_the_path_is_found_within_its_error(
    path: float, amplitude: float, seed: int
) -> None:
    found = _solve(*_draw(path, amplitude, seed), FREQUENCIES)
    wavenumber = 2 * np.pi * FREQUENCIES / speed_of_light
    # Six phases, each known to a hundredth: the textbook bound.
    bound = 0.01 / np.sqrt(np.sum(wavenumber**2))
    assert_allclose(found.information**-0.5, bound, rtol=0.1)
    assert abs(found.path[0] - path) < 6 * bound


@settings(max_examples=40)
@given(paths, amplitudes, seeds, st.floats(0.05, 20.0))
def test_amplitude_scale_moves_no_path(
    path: float, amplitude: float, seed: int, factor: float
) -> None:
    signal, sigma, water = _draw(path, amplitude, seed)
    one = _solve(signal, sigma, water, FREQUENCIES)
    two = _solve(factor * signal, factor * sigma, factor * water, FREQUENCIES)
    # The search stops at a thousandth of the standard error.
    assert_allclose(two.path, one.path, atol=2e-3 * one.information[0] ** -0.5)
    assert_allclose(two.amplitude, factor * one.amplitude, rtol=1e-4)
    assert_allclose(two.cost, one.cost, rtol=1e-4)


@settings(max_examples=40)
@given(paths, amplitudes, seeds, st.permutations(range(6)))
def test_the_order_of_the_frequencies_does_not_matter(
    path: float, amplitude: float, seed: int, order: list[int]
) -> None:
    signal, sigma, water = _draw(path, amplitude, seed)
    one = _solve(signal, sigma, water, FREQUENCIES)
    two = _solve(signal[..., order], sigma, water[order], FREQUENCIES[order])
    assert_allclose(two.path, one.path, atol=2e-3 * one.information[0] ** -0.5)
    assert_allclose(two.cost, one.cost, rtol=1e-4)


@settings(max_examples=40)
@given(paths, amplitudes, seeds, st.floats(-1.5, 20.0))
def test_a_common_delay_moves_the_path_by_itself(
    path: float, amplitude: float, seed: int, delay: float
) -> None:
    signal, sigma, water = _draw(path, amplitude, seed)
    turn = np.exp(2j * np.pi * FREQUENCIES / speed_of_light * delay)
    one = _solve(signal, sigma, water, FREQUENCIES)
    two = _solve(
        signal * turn,
        sigma,
        water * turn,
        FREQUENCIES,
        shortest=2.0 + delay,
        longest=8.0 + delay,
    )
    assert_allclose(two.path - delay, one.path, atol=2e-3 * one.information[0] ** -0.5)
    assert_allclose(two.cost, one.cost, rtol=1e-4)


@settings(max_examples=30)
@given(paths, seeds, st.floats(0.02, 0.35))
def test_the_interval_ends_where_the_misfit_has_risen_by_one(
    path: float, seed: int, noise: float
) -> None:
    signal, _, water = _draw(path, 1.0, seed)
    rng = np.random.default_rng(seed)
    errors = rng.standard_normal((2, 6))
    wavenumber = 2 * np.pi * FREQUENCIES / speed_of_light
    clean = np.exp(1j * wavenumber * path)
    signal = (clean + water + noise * (errors[0] + 1j * errors[1]))[None, None]
    found = _solve(signal, np.array(noise), water, FREQUENCIES)

    def rise(length: float) -> float:
        # The best amplitude in closed form.
        along = np.mean((signal[0, 0] - water) * np.exp(-1j * wavenumber * length)).real
        square = np.sum(np.abs(signal[0, 0] - water) ** 2)
        return float((square - 6 * max(along, 0.0) ** 2) / noise**2 - found.cost[0])

    sigma = float(found.information[0] ** -0.5)
    for end in (found.path - found.lower, found.path + found.upper):
        # A side that is a parabola to a tenth is taken as one, to a twentieth in width.
        assert rise(float(end[0])) == pytest.approx(1.0, abs=0.11)
    best = float(found.path[0])
    assert rise(best) == pytest.approx(0.0, abs=1e-4)
    assert rise(best + 0.3 * sigma) > 0
    assert rise(best - 0.3 * sigma) > 0


@settings(max_examples=25)
@given(paths, seeds, st.integers(0, 5), st.floats(2.0, 30.0))
def test_a_sample_that_disagrees_is_named_with_what_it_costs(
    path: float, seed: int, spoiled: int, size: float
) -> None:
    signal, sigma, water = _draw(path, 1.0, seed)
    turn = np.exp(2j * np.pi * np.random.default_rng(seed).random())
    signal[0, 0, spoiled] += size * sigma * turn
    # Near the truth, where the model is linear in the path.
    near = {"shortest": path - 0.5, "longest": path + 0.5}
    found = _solve(signal, sigma, water, FREQUENCIES, **near)
    without = [
        found.cost[0]
        - _solve(signal, sigma, water, FREQUENCIES, missing=(k,), **near).cost[0]
        for k in range(6)
    ]
    # Second derivatives of the echo: the path moves by 0.05 rad at most.
    assert found.outlying[0] == pytest.approx(max(without), rel=0.05, abs=0.05)
    assert found.next_outlying[0] == pytest.approx(
        sorted(without)[-2], rel=0.1, abs=0.1
    )
    best = int(np.argmax(without))
    if max(without) > 1.2 * sorted(without)[-2] + 0.2:
        assert found.which[0] == best
    if size > 15:
        # 15 standard errors stand out of all that noise of 1 makes of them.
        assert found.which[0] == spoiled


@settings(max_examples=25)
@given(paths, seeds, st.floats(0.005, 0.1))
def test_samples_weigh_as_the_water_before_the_target_fluctuates(
    path: float, seed: int, fluctuation: float
) -> None:
    signal, sigma, water = _draw(path, 1.0, seed)
    # Open water is a thousandth of it, as behind its cut-off.
    found = _solve(
        signal, sigma, water, FREQUENCIES, open_water=1e-3 * water,
        fluctuation=fluctuation,
    )  # fmt: skip
    wavenumber = 2 * np.pi * FREQUENCIES / speed_of_light
    echo = np.exp(1j * wavenumber * found.path[0])
    information = np.zeros((2, 2))
    for k in range(6):
        change = fluctuation * np.array([water[k].real, water[k].imag])
        covariance = sigma**2 * np.eye(2) + np.outer(change, change)
        slopes = np.array(
            [echo[k], 1j * wavenumber[k] * found.amplitude[0, 0] * echo[k]]
        )
        jacobian = np.stack([slopes.real, slopes.imag])
        information += jacobian.T @ np.linalg.solve(covariance, jacobian)
    exact = 1 / np.linalg.inv(information)[1, 1]
    assert_allclose(found.information[0], exact, rtol=1e-3)


@settings(deadline=None)
@given(
    path=st.floats(-50.0, 300.0),
    frequency=st.lists(st.floats(1e3, 3e9), min_size=1, max_size=9),
    transfer=st.complex_numbers(min_magnitude=0.1, max_magnitude=10),
)
def test_an_echo_turns_as_cosine_and_sine_say(
    path: float, frequency: list[float], transfer: complex
) -> None:
    rate = 2 * np.pi * np.array(frequency) / speed_of_light
    given = np.full(len(rate), transfer)
    echo = Echo(rate, np.stack([given.real, given.imag]))
    found = phasors(np.array([path]), echo).phasor[0]
    expected = np.exp(1j * rate * path) * transfer
    # One rounding of the phase itself is left to both.
    assert_allclose(found[0] + 1j * found[1], expected, rtol=1e-15, atol=1e-14)


@pytest.mark.parametrize("apart", [0.25, 0.6, 1.4])
@pytest.mark.parametrize("ratio", [0.4, 1.0, 2.5])
def test_two_surfaces_of_a_pixel_are_found_exactly_without_noise(
    apart: float, ratio: float
) -> None:
    wavenumber = 2 * np.pi * FREQUENCIES / speed_of_light
    near, far = np.array([4.0, 4.7]), np.array([4.0, 4.7]) + apart
    # Two channels see the surfaces in different shares.
    shares = np.array([[1.0, ratio], [0.5, 0.2 * ratio]])
    turns = np.exp(1j * np.stack([near, far], -1)[..., None] * wavenumber)
    signal = np.einsum("ck,nkf->ncf", shares, turns)
    rng = np.random.default_rng(3)
    water = rng.standard_normal(6) + 1j * rng.standard_normal(6)
    pixels, table = _scene(signal + water, np.array(1e-3), water, FREQUENCIES)
    shared: Any = SimpleNamespace(
        table=table, echo=0.0, fluctuation=0.0, noise_scale=1.0,
        strength=np.ones((2, 6), dtype=complex),
        water_signal=lambda light, _: light[:, None] * np.ones((2, 1)),
    )  # fmt: skip
    pair = two_surfaces(
        pixels, (near + far) / 2, shared,
        transfer=np.ones(6, dtype=complex), phase_per_path=wavenumber,
    )  # fmt: skip
    assert_allclose(pair.near, near, atol=1e-5)
    assert_allclose(pair.far, far, atol=1e-5)
    # Squares of errors of 1 mV, of signals of 1 V.
    assert np.all(pair.cost < 1e-3)


def _single(cost: float, *, channels: int = 2, frequencies: int = 4) -> Any:
    """Return the fit of one pixel to one surface, of all its outputs."""
    return SimpleNamespace(
        cost=np.array([cost]),
        used=np.array([2 * channels * frequencies]),
        amplitude=np.ones((1, channels)),
        influence=np.zeros((1, channels, frequencies), dtype=complex),
    )


@pytest.mark.parametrize(("factor", "asked"), [(0.999, False), (1.001, True)])
def test_a_pixel_that_one_surface_explains_is_not_tested_for_two(
    factor: float, asked: bool
) -> None:
    # 16 outputs less a path and two amplitudes; a chance of 1 in 1000.
    single = _single(factor * float(chi2.isf(1e-3, 13)))
    one, none = np.array([True]), np.array([False])
    assert may_be_two(single, one, none)[0] == asked
    assert may_be_two(single, one, one)[0]
    assert not may_be_two(single, none, one)[0]
    few = _single(1e6, frequencies=2)
    assert not may_be_two(few, one, one)[0]


@pytest.mark.parametrize(
    ("gain", "cost", "beyond", "two"),
    # The likelihood ratio has three more parameters, 1 in 10,000; two surfaces fit to
    # 1 in 10,000 of 10 degrees of freedom. One outlier costs 14, two surfaces cost 21.
    [
        (1.001, 5.0, 1e3, True),
        (0.999, 5.0, 1e3, False),
        (5.0, 0.999 * float(chi2.isf(1e-4, 10)), 1e3, True),
        (5.0, 1.001 * float(chi2.isf(1e-4, 10)), 1e3, False),
        (5.0, 5.0, 7.01, True),
        (5.0, 5.0, 6.99, False),
    ],
)
def test_two_surfaces_are_chosen_beyond_their_limits(
    gain: float, cost: float, beyond: float, two: bool
) -> None:
    single = _single(cost + gain * float(chi2.isf(1e-4, 3)))
    cleaned = _single(cost + beyond)
    pair: Any = SimpleNamespace(cost=np.array([cost]))
    assert are_two(pair, single, cleaned, np.array([1]))[0] == two


@pytest.mark.parametrize(("factor", "two"), [(0.999, True), (1.001, False)])
def test_two_surfaces_with_a_parameter_for_each_sample_have_one_degree_of_freedom(
    factor: float, two: bool
) -> None:
    # Six outputs; each of two surfaces has a path and two amplitudes.
    cost = factor * float(chi2.isf(1e-4, 1))
    single = _single(cost + 100, channels=2, frequencies=1)
    single.used[:] = 6
    pair: Any = SimpleNamespace(cost=np.array([cost]))
    assert are_two(pair, single, _single(cost + 1e3), np.array([1]))[0] == two
