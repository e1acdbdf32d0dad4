"""Tables of the water signal of light that decays: integrals in closed form."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import CubeError
from amulor.rejection.joint import tables
from amulor.rejection.joint.overlap import Shape
from amulor.rejection.joint.tables import from_pairs, table_of, to_pairs

INDEX = 1.25
RATE = np.array([0.4, 1.0, 2.0])
#: Phase per depth, out and back [rad/m].
WAVE = 2 * INDEX * RATE
SIZES = np.array([1.0, 0.6, 0.3])
CENTRE = np.array([0.5, 0.3, 0.2])
LOSS = 0.25
SHAPE = Shape(LOSS, 0.05, 0.7, np.zeros(0), np.zeros(0))


def frame(*, far: float = 30.0, end: float = np.inf, size: float = 1.0) -> Any:
    """Return a frame of three directions, whose light decays with depth."""

    def overlap(depth: np.ndarray, shape: Shape) -> np.ndarray:
        # The third direction follows the spread as well.
        sizes = size * SIZES * np.array([1.0, 1.0, shape.spread / 0.05])
        light: np.ndarray = sizes[:, None] * np.exp(
            -2 * shape.reduced_attenuation * depth
        )
        return light

    return SimpleNamespace(
        phase_per_path=RATE,
        medium=SimpleNamespace(group_index=INDEX),
        nothing_left=lambda shape: far,
        end=end,
        overlap=overlap,
        directions=SimpleNamespace(centre=CENTRE),
    )


def integral(depth: Any, loss: float = LOSS) -> Any:
    """Return the integral of exp(-2 k z + i w z) up to a depth, (..., frequency)."""
    pole = -2 * loss + 1j * WAVE
    return (np.exp(pole * np.asarray(depth)[..., None]) - 1) / pole


def strength(loss: float = LOSS, far: float = 30.0) -> float:
    """Return open water at frequency 0 in the middle of the scan."""
    return float(CENTRE @ SIZES * (1 - np.exp(-2 * loss * far)) / (2 * loss))


#: A twentieth of a period of the highest frequency, out and back.
STEP = 2 * np.pi / 2.0 / (2 * INDEX) / 20


def test_a_table_is_the_running_integral_of_the_light() -> None:
    found = table_of(frame(), SHAPE, deepest=3.0)
    assert found.step == pytest.approx(STEP)
    count = int(np.ceil(3.0 / STEP))
    assert found.value.shape[1:] == (count + 2, 3)
    # One profile over depth in all directions has one component.
    assert found.basis.shape == (3, 1)
    assert found.strength == pytest.approx(strength(), rel=1e-6)
    assert CENTRE @ (found.basis @ found.level) == pytest.approx(1.0)
    assert_allclose(found.basis @ found.level, SIZES / (CENTRE @ SIZES))
    value = np.einsum("dc,cnf->dnf", found.basis, found.value)
    depth = STEP * np.arange(count + 1)
    expected = SIZES[:, None, None] * integral(depth) / strength()
    assert_allclose(value[:, :-1], expected, atol=1e-9)
    # The last node has all of the water.
    expected = SIZES[:, None] * integral(30.0) / strength()
    assert_allclose(value[:, -1], expected, atol=1e-6)
    slope = np.einsum("dc,cnf->dnf", found.basis, found.slope)
    light = np.exp((-2 * LOSS + 1j * WAVE) * depth[:, None])
    expected = SIZES[:, None, None] * light / strength()
    assert_allclose(slope[:, :-1], expected, atol=1e-12)
    assert_array_equal(slope[:, -1], 0.0)
    arrays = found.arrays
    assert_allclose(from_pairs(arrays.value), found.value)
    assert_allclose(from_pairs(arrays.slope), found.slope)


@pytest.mark.parametrize(
    ("deepest", "far", "end", "count"),
    [
        (3.0, 30.0, np.inf, int(np.ceil(3.0 / STEP))),
        (3.0, 30.0, 2.0, int(np.ceil(2.0 / STEP))),
        (3.0, 1.5, np.inf, int(np.ceil(1.5 / STEP))),
        # Eight cells at least.
        (0.1, 30.0, np.inf, 8),
        (9.5 * STEP, 30.0, np.inf, 10),
    ],
)
def test_a_table_ends_with_targets_or_water(
    deepest: float, far: float, end: float, count: int
) -> None:
    found = table_of(frame(far=far, end=end), SHAPE, deepest=deepest)
    assert found.value.shape[1] == count + 2
    whole = max(min(far, end), count * STEP)
    assert found.strength == pytest.approx(strength(far=whole), rel=1e-6)


@pytest.mark.parametrize(("cells", "refused"), [(6000, False), (6001, True)])
def test_a_table_of_too_many_depths_is_refused(cells: int, refused: bool) -> None:
    deep = frame(far=1e4)
    deepest = (cells - 0.5) * STEP
    if not refused:
        assert table_of(deep, SHAPE, deepest=deepest).value.shape[1] == 6002
        return
    with pytest.raises(CubeError) as refusal:
        table_of(deep, SHAPE, deepest=deepest)
    assert str(refusal.value) == (
        f"the water signal reaches {deepest:.3g} m, which is 6001 steps of "
        f"{STEP * 1e3:.2g} mm at the highest frequency; narrow the interval of slant "
        "ranges, or leave the highest frequencies out"
    )


def test_a_beam_that_is_not_seen_has_no_table() -> None:
    with pytest.raises(CubeError, match="the receiver does not see the beam at any"):
        table_of(frame(size=1e-101), SHAPE, deepest=3.0)
    assert table_of(frame(size=1e-98), SHAPE, deepest=3.0).strength > 1e-100


def test_derivatives_are_those_of_the_table_at_unit_strength() -> None:
    knots = np.array([1.0, 2.0, 4.0])
    shape = Shape(LOSS, 0.05, 0.7, np.array([0.1, -0.2, 0.05]), knots)
    found = table_of(frame(), shape, deepest=3.0)
    changes = found.changes
    assert found.changes is changes
    assert changes.value.shape[0] == shape.size == 6

    def value(moved: Shape) -> np.ndarray:
        table = table_of(frame(), moved, deepest=3.0)
        return np.einsum("dc,cnf->dnf", table.basis, table.value)

    for k in range(shape.size):
        step = np.zeros(shape.size)
        step[k] = 1e-4
        expected = (value(shape.moved(step)) - value(shape.moved(-step))) / 2e-4
        got = np.einsum("dc,cnf->dnf", changes.basis, changes.value[k])
        assert_allclose(got, expected, atol=2e-4 * np.abs(value(shape)).max())


def test_light_below_the_smallest_part_of_the_largest_is_none() -> None:
    light = np.array([[1.0, 2.0, 3e-30], [1.9e-30, 2.1e-30, 0.0]])
    given: Any = SimpleNamespace(overlap=lambda depth, shape: light.copy())
    found = tables._light(given, np.array([0.0, 1.0, 2.0]), SHAPE)
    expected = light.copy()
    expected[1, 0] = 0.0
    assert_array_equal(found, expected)
    shape = Shape(0.3, 0.1, 0.5, np.array([0.5, -0.5]), np.array([0.0, 2.0]))
    corrected = tables._light(given, np.array([0.0, 1.0, 2.0]), shape)
    factor = np.exp(shape.correction @ tables.hats(np.array([0.0, 1.0, 2.0]),
                                                   shape.knots))  # fmt: skip
    assert_allclose(corrected[0], light[0] * factor)


def test_components_below_a_hundred_thousandth_are_left_out() -> None:
    rng = np.random.default_rng(1)
    # Every fourth depth counts; the others are quadrature points beside it.
    profiles = np.zeros((3, 40))
    profiles[:, ::4] = np.linalg.qr(rng.standard_normal((10, 3)))[0].T
    for size, count in ((1.2e-5, 2), (0.8e-5, 1)):
        first = np.outer([1.0, 2.0, 0.5], profiles[0])
        second = size * np.linalg.norm([1.0, 2.0, 0.5])
        light = first + second * np.outer([0.5, 0.0, -1.0] / np.sqrt(1.25), profiles[1])
        basis = tables._components(light)
        assert basis.shape == (3, count)
        assert_allclose(basis.T @ basis, np.eye(count), atol=1e-12)
    # Derivatives count by their own size, and none by zero.
    more = tables._components(first, (1e9 * np.outer([0, 0, 1.0], profiles[2]),
                                      np.zeros((3, 40))))  # fmt: skip
    assert more.shape == (3, 2)


def test_complex_numbers_are_pairs_before_the_last_axis() -> None:
    values = np.arange(6).reshape(2, 3) + 1j * np.arange(6, 12).reshape(2, 3)
    pairs = to_pairs(values)
    assert pairs.shape == (2, 2, 3)
    assert_array_equal(pairs[:, 0], values.real)
    assert_array_equal(pairs[:, 1], values.imag)
    assert pairs.flags["C_CONTIGUOUS"]
    assert_array_equal(from_pairs(pairs), values)
