"""Small-angle form: shapes, what is refused, what is kept, and the compiled loops."""

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics import small_angle
from amulor.optics._quadrature import bessel
from amulor.optics.phase_functions import henyey_greenstein
from amulor.optics.small_angle import _kernels as _small_angle_kernels
from amulor.optics.small_angle._columns import table

PEAKED = partial(henyey_greenstein, asymmetry=0.95)
WATER = {
    "absorption": 0.2,
    "scattering": 0.6,
    "phase_function": PEAKED,
    "split_angle": np.pi / 2,
}
INSTRUMENT = {"baseline": 0.1, "receiver_radius": 0.02, "acceptance_angle": 0.08}
ALL = WATER | INSTRUMENT | {"group_index": 1.34}


def test_shape_is_that_of_the_frequencies():
    assert small_angle.water_response(1e7, **ALL).shape == ()
    assert small_angle.water_response([1e7, 2e7], **ALL).shape == (2,)
    assert small_angle.water_response(np.zeros((2, 0)), **ALL).shape == (2, 0)


def test_arguments_broadcast_as_if_called_one_by_one():
    frequency = np.array([3e7, 1e6, 9e7])
    baseline = np.array([[0.07], [0.2]])
    end = np.array([[[1.0]], [[np.inf]]])
    arguments = ALL | {"baseline": baseline, "end": end}
    found = small_angle.water_response(frequency, **arguments)
    assert found.shape == (2, 2, 3)
    for i in range(2):
        for j in range(2):
            for k in range(3):
                one = ALL | {"baseline": baseline[j, 0], "end": end[i, 0, 0]}
                expected = small_angle.water_response(frequency[k], **one)
                # Sums are taken in another order.
                assert_allclose(found[i, j, k], expected, rtol=1e-10)


def test_overlap_broadcasts_depth_against_the_water():
    depth = np.array([0.0, 1.0, 3.0])
    scattering = np.array([[0.0], [0.5]])
    arguments = WATER | INSTRUMENT | {"scattering": scattering}
    found = small_angle.overlap(depth, **arguments)
    assert found.shape == (2, 3)
    one = WATER | INSTRUMENT | {"scattering": 0.5}
    assert_array_equal(found[1, 1], small_angle.overlap(1.0, **one))


def test_backscatter_is_that_of_the_phase_function_unless_given():
    vsf = 0.6 * henyey_greenstein(np.pi, asymmetry=0.95)
    default = small_angle.water_response(2e7, **ALL)
    given = small_angle.water_response(2e7, **ALL, backscatter_vsf=vsf)
    assert_allclose(default, given, rtol=1e-12)
    twice = small_angle.water_response(2e7, **ALL, backscatter_vsf=2 * vsf)
    assert_allclose(twice, 2 * given, rtol=1e-14)


def test_later_echo_has_larger_phase():
    near = small_angle.water_response(5e6, **ALL, end=1.5)
    far = small_angle.water_response(5e6, **ALL, end=4.0)
    assert 0 < np.angle(near) < np.angle(far) < np.pi


def test_water_of_no_depth_sends_nothing():
    assert small_angle.water_response(1e7, **ALL, end=0.0) == 0


def test_water_that_the_receiver_cannot_see_is_dark_and_settles():
    dark = small_angle.water_response(0.0, **ALL | {"baseline": 0.5}, end=1e-3)
    bright = small_angle.water_response(0.0, **ALL | {"baseline": 0.0}, end=1e-3)
    # What is left is rounding of the light on the axis.
    assert abs(dark) < 1e-9 * bright.real


class Unhashable:
    """Phase function that cannot be told from others."""

    __hash__ = None

    def __call__(self, angle):
        return PEAKED(angle)


def test_phase_function_that_cannot_be_kept_gives_the_same():
    other = small_angle.water_response(1e7, **ALL | {"phase_function": Unhashable()})
    assert_array_equal(other, small_angle.water_response(1e7, **ALL))


def test_table_of_a_phase_function_is_worked_out_once():
    assert table(PEAKED, 1.0) is table(PEAKED, 1.0)
    assert table(PEAKED, 1.0) is not table(PEAKED, 1.1)


def test_phase_function_scaled_within_its_tolerance_gives_the_same():
    def rounded(angle):
        return 1.01 * PEAKED(angle)

    scaled = ALL | {"phase_function": rounded, "backscatter_vsf": 1e-3}
    expected = small_angle.water_response(1e7, **ALL | {"backscatter_vsf": 1e-3})
    # Tables of measured phase functions are accepted up to 2 % off; shares count.
    assert_allclose(small_angle.water_response(1e7, **scaled), expected, rtol=1e-9)


def test_phase_function_with_a_kink_is_followed():
    def cone(angle):
        # Linear down to 0 at 0.2 rad, over 4 pi of nothing else than a floor.
        return np.maximum(1 - angle / 0.2, 0.0) * 23.0 + 0.003

    grid = (np.arange(400_000) + 0.5) * (np.pi / 400_000)
    density = 2 * np.pi * np.sin(grid) * cone(grid) * (np.pi / 400_000)
    whole = density.sum()

    def scaled(angle):
        return cone(angle) / whole

    kept = table(scaled, np.pi / 2)
    forward = grid < np.pi / 2
    weight = density[forward] / density[forward].sum()
    # The first cell starts at <theta^2> / 12; midpoint rule of 400 000 steps.
    second = np.sum(weight * grid[forward] ** 2)
    start = np.polynomial.polynomial.polyval(-1.0, kept.cells[0])
    assert_allclose(start, second / 12, rtol=1e-8)


class WithTransform:
    """Phase function with a transform of its own."""

    def __init__(self, factor):
        self.factor = factor

    def __call__(self, angle):
        return PEAKED(angle)

    def hankel(self, direction_frequency, *, split_angle):
        return self.factor * np.exp(-((0.05 * direction_frequency) ** 2))


def test_transform_that_is_not_renormalised_is_refused():
    with pytest.raises(ValueError, match=r"must be 1 at frequency 0, got 0\.9"):
        small_angle.water_response(1e7, **ALL | {"phase_function": WithTransform(0.9)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"absorption": -0.1}, "absorption must be finite and not negative"),
        ({"scattering": np.nan}, "scattering must be finite and not negative"),
        ({"receiver_radius": 0.0}, "receiver_radius must be finite and above 0"),
        ({"acceptance_angle": [0.1, 0.0]}, r"above 0 \[rad\], got 0 at index \(1,\)"),
        ({"beam_radius": -1e-3}, "beam_radius must be finite and not negative"),
        ({"beam_divergence": -1e-3}, "beam_divergence must be finite and not negative"),
        ({"tilt": np.inf}, "tilt must be finite"),
        ({"group_index": 0.9}, "group_index must be finite and at least 1, got 0.9"),
        ({"end": -1.0}, "end must be not negative, .* got -1"),
        ({"backscatter_vsf": -1.0}, "backscatter_vsf must be finite and not negative"),
        ({"split_angle": 0.0}, "split_angle must be above 0 and at most pi"),
        ({"phase_function": np.ones_like}, "must integrate to 1 over the sphere"),
    ],
)
def test_arguments_out_of_range_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        small_angle.water_response(1e7, **ALL | change)


def test_negative_frequency_and_depth_are_refused():
    with pytest.raises(ValueError, match="modulation_frequency must be finite"):
        small_angle.water_response(-1.0, **ALL)
    with pytest.raises(ValueError, match="depth must be finite and not negative"):
        small_angle.overlap(-1.0, **WATER, **INSTRUMENT)


def test_compiled_loop_is_the_loop_as_written():
    depth = np.array([0.5, 4.0, 30.0])
    look = np.column_stack([depth, *np.tile([0.1, 0.01, 0.02, 0.0], (3, 1)).T])
    kept = table(PEAKED, np.pi / 2)
    water = _small_angle_kernels.Water(
        loss=0.4,
        forward=1.2,
        split_angle=np.pi / 2,
        baseline=0.1,
        tilt=0.01,
        cross_tilt=0.02,
        standoff=0.0,
        radius_squared=4e-4,
        angle_squared=6.4e-3,
    )
    node, weight = np.polynomial.legendre.leggauss(16)
    rule = np.stack([(node + 1) / 2, weight / 2])
    compiled, written = np.empty(3), np.empty(3)
    arguments = (look, water, kept.cells, bessel(), rule)
    _small_angle_kernels.scattered(*arguments, compiled)
    _small_angle_kernels.scattered.py_func(*arguments, written)
    # Contracted multiplications round once less.
    assert_allclose(compiled, written, rtol=1e-12)
