"""The record of path lengths against direct sums of phasors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.constants import speed_of_light

from amulor.transport._kernels import contributions as kernels
from amulor.transport._kernels.types import Record as Deposits
from amulor.transport._runs import Record
from amulor.transport.tally import Tally

NODES, SPACING = 64, 0.1
#: Phases per node at which phasors are formed [rad].
STEPS = np.array([0.0, 0.01, 0.03, 0.05])
WAVENUMBER = 1j * STEPS / SPACING


def empty(parts=1, components=1):
    return Deposits(
        mass=np.zeros((parts, components, NODES)),
        edge=np.zeros((parts, components, NODES)),
        beyond=np.zeros((parts, components, STEPS.size), dtype=complex),
        wavenumber=WAVENUMBER,
        spacing=SPACING,
        orders=parts,
    )


def transformed(record):
    out = record.beyond.copy()
    kernels.transform(record.mass, record.edge, WAVENUMBER, SPACING, out)
    return out


def spread(low, high):
    """Return the mean of exp(q L) over lengths from low to high."""
    node, weight = np.polynomial.legendre.leggauss(40)
    length = 0.5 * (low + high) + 0.5 * (high - low) * node
    return np.exp(np.outer(WAVENUMBER, length)) @ weight / 2


@given(st.floats(0, NODES - 3.5))
def test_a_deposit_keeps_sum_and_three_moments(place):
    array = np.zeros((1, 1, NODES))
    kernels.add_at(array, 0, place, 0, 2.5)
    node = np.arange(NODES) - place
    # Lagrange's cubic is exact for polynomials up to the third degree.
    moments = [float(array[0, 0] @ node**k) for k in range(4)]
    np.testing.assert_allclose(moments, [2.5, 0, 0, 0], rtol=0, atol=1e-10)
    assert np.count_nonzero(array) <= 4


@given(st.floats(0, (NODES - 3.01) * SPACING))
def test_light_of_one_length_comes_out_within_the_cubic_error(length):
    record = empty()
    kernels.add_point(record, 0, length, np.array([3.0]))
    found = transformed(record)[0, 0]
    error = np.abs(found / 3.0 - np.exp(WAVENUMBER * length))
    # |(x+1) x (x-1) (x-2)| / 4! is at most 9/384 = 3/128 between the inner nodes, and
    # 1/24 between the outer ones, which are only used before the first node.
    bound = (3 / 128 if length >= SPACING else 1 / 24) * STEPS**4
    assert np.all(error <= bound * (1 + 1e-6) + 1e-13)


def test_the_bound_of_the_cubic_error_is_reached():
    # At 0.05 rad per node and half way between two nodes it is 1.5e-7 of the light.
    record = empty()
    length = 20.5 * SPACING
    kernels.add_point(record, 0, length, np.ones(1))
    found = transformed(record)[0, 0]
    error = np.abs(found - np.exp(WAVENUMBER * length))
    assert error[-1] == pytest.approx(3 / 128 * 0.05**4, rel=1e-2)


@settings(max_examples=60)
@given(st.floats(SPACING, (NODES - 4) * SPACING), st.floats(0, 1), st.floats(0.01, 50))
def test_spread_light_comes_out_within_the_same_error(high, fraction, amount):
    low = SPACING + fraction * (high - SPACING)
    record = empty()
    kernels.add_range(record, 0, low, high, np.array([amount]))
    found = transformed(record)[0, 0] / amount
    # Less than a twentieth of a node wide it counts at its middle: 0.05^2 / 24 more.
    narrow = STEPS**2 * 0.05**2 / 24
    # An edge has the error of a point over q times the width.
    width = np.maximum((high - low) / SPACING, 0.05)
    bound = 3 / 128 * STEPS**4 + narrow + 2 * 3 / 128 * STEPS**3 / width
    assert np.all(np.abs(found - spread(low, high)) <= bound + 1e-9)


@pytest.mark.parametrize(("low", "high"), [(6.15, 6.15), (6.0, 9.0), (200.0, 260.0)])
def test_light_beyond_the_record_is_exact(low, high):
    record = empty(parts=2, components=4)
    light = np.array([2.0, -1.0, 0.5, 0.25])
    kernels.add_range(record, 1, low, high, light)
    assert not record.mass.any()
    assert not record.edge.any()
    expected = np.outer(light, spread(low, high))
    np.testing.assert_allclose(record.beyond[1], expected, rtol=0, atol=1e-12)
    assert not record.beyond[0].any()


def test_a_sum_of_all_kinds_is_the_direct_sum():
    rng = np.random.default_rng(1)
    record = empty(parts=3, components=4)
    expected = np.zeros((3, 4, STEPS.size), dtype=complex)
    total = 0.0
    for _ in range(400):
        part, light = rng.integers(3), rng.normal(size=4)
        low, width = rng.uniform(0.1, 8.0), rng.choice([0.0, 1e-3, 0.3, 2.0])
        kernels.add_range(record, part, low, low + width, light)
        expected[part] += np.outer(light, spread(low, low + width))
        total += np.abs(light).sum()
    found = transformed(record)
    # Edges of a spread over three nodes: 2 x 3/128 x 0.05^3 / 3 = 2e-6 of the light.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6 * total)
    assert np.all(np.abs(expected) > 1e-3)


def test_uncompiled_kernels_fill_the_same_record():
    light = np.array([0.7, -0.2])
    compiled, plain = empty(2, 2), empty(2, 2)
    for record, how in ((compiled, "jit"), (plain, "py")):
        for low, high in ((0.02, 0.02), (1.3, 1.302), (0.5, 3.3), (5.0, 7.0)):
            add = kernels.add_range if how == "jit" else kernels.add_range.py_func
            add(record, 1, low, high, light)
        transform = kernels.transform if how == "jit" else kernels.transform.py_func
        transform(record.mass, record.edge, WAVENUMBER, SPACING, record.beyond)
    for one, other in zip(compiled[:3], plain[:3], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)


def frame(frequency):
    return Tally(
        modulation_frequency=frequency, parts=("water", "target"),
        batches=np.empty((0, 2, 1, frequency.size), complex),
        histories_of=np.empty(0, dtype=np.int64), groups=0,
        contribution=(0.0, 0.0, 0.0), seed=0, next_batch=0, batch_size=1, problem="",
        seconds=0.0,
    )  # fmt: skip


@pytest.mark.parametrize("highest", [0.0, 1e6, 200e6, 5e9])
def test_the_step_follows_the_highest_frequency_and_the_water(highest):
    frequency = np.array([0.0, highest])
    record = Record.empty(np.array([1.0, 0.2]), 1.33, frequency, frame(frequency))
    phase = 2 * np.pi * highest * 1.33 / speed_of_light * record.spacing
    assert phase <= 0.05 * (1 + 1e-12)
    assert record.spacing <= 0.05 * (1 + 1e-12)  # in lengths of 1 / 1.0 1/m
    reach = record.spacing * record.mass.shape[2]
    # 30 lengths of the clearest water, unless that takes more than 16384 nodes.
    assert reach >= 149 or record.mass.shape[2] == 16384
