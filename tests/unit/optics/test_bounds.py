"""Ranges of arguments: what is let in, what is rounded to an end, what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from amulor.optics import _bounds


def test_a_wavelength_that_is_rounded_past_the_end_is_the_end():
    beyond = 700 * 1e-9
    assert beyond > 700e-9
    found = _bounds.within(beyond, 400e-9, 700e-9, name="wavelength", unit="m")
    assert found == 700e-9


def test_matrix_elements_that_are_rounded_past_one_are_one():
    found = _bounds.within([-1 - 2e-16, 1 + 1e-15], -1, 1, name="m33")
    assert_array_equal(found, [-1.0, 1.0])


@pytest.mark.parametrize("value", [-1e-12, -1e-300, 1 + 1e-11, np.nan, np.inf])
def test_an_end_at_zero_has_no_room(value):
    with pytest.raises(ValueError, match="share must be from 0 to 1, got values"):
        _bounds.within([0.5, value], 0, 1, name="share")


@given(st.floats(-1e6, 1e6), st.floats(0, 1e6), st.floats(0, 1))
def test_what_is_inside_is_left_as_it_is(low, width, share):
    value = min(max(low + share * width, low), low + width)
    found = _bounds.within(value, low, low + width, name="depth", unit="m")
    assert found == value


@pytest.mark.parametrize("value", [-1e-300, np.nan, np.inf])
def test_not_negative_is_finite_as_well(value):
    with pytest.raises(ValueError, match=r"depth must be .* got values from .* m$"):
        _bounds.not_negative([1.0, value], name="depth", unit="m")
    with pytest.raises(ValueError, match="depth must be finite and above 0"):
        _bounds.positive([1.0, value], name="depth", unit="m")


def test_zero_is_not_negative_but_not_positive():
    assert _bounds.not_negative(0.0, name="depth", unit="m") == 0
    with pytest.raises(ValueError, match="above 0"):
        _bounds.positive(0.0, name="depth", unit="m")
