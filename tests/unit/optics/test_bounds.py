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
    end = _bounds.within(beyond, 400e-9, 700e-9, name="wavelength", unit="m")
    assert end == 700e-9


def test_matrix_elements_that_are_rounded_past_one_are_one():
    ends = _bounds.within([-1 - 2e-16, 1 + 1e-15], -1, 1, name="m33")
    assert_array_equal(ends, [-1.0, 1.0])


@pytest.mark.parametrize("value", [-1e-12, -1e-300, 1 + 1e-11, np.nan, np.inf])
def test_an_end_at_zero_has_no_room(value):
    text = rf"^fraction must be from 0 to 1, got {value:g} at index \(1,\)$"
    with pytest.raises(ValueError, match=text.replace("+", r"\+")):
        _bounds.within([0.5, value], 0, 1, name="fraction")


def test_an_end_that_is_refused_has_no_room_either():
    options = {"name": "slope", "above": True, "below": True}
    assert _bounds.within(np.nextafter(3.0, 4.0), 3, 5, **options) > 3
    for end in (3.0, 5.0):
        with pytest.raises(ValueError, match="slope must be above 3 and below 5, got"):
            _bounds.within(end, 3, 5, **options)


@given(st.floats(-1e6, 1e6), st.floats(0, 1e6), st.floats(0, 1))
def test_what_is_inside_is_left_as_it_is(low, width, fraction):
    value = min(max(low + fraction * width, low), low + width)
    same = _bounds.within(value, low, low + width, name="depth", unit="m")
    assert same == value


# ------------------------------------------------- NaN, infinity and sign, each check

# Which of these each check lets in.
VALUES = {"nan": np.nan, "inf": np.inf, "-inf": -np.inf, "-1": -1.0, "0": 0.0, "2": 2.0}
CHECKS = {
    "finite": ("finite", {"-1", "0", "2"}),
    "not_negative": ("finite and not negative", {"0", "2"}),
    "positive": ("finite and above 0", {"2"}),
    "reach": ("not negative, inf if there is no end", {"0", "2", "inf"}),
    "measured": ("not negative, NaN where it is missing", {"0", "2", "inf", "nan"}),
    "above_zero": ("above 0, NaN where it is missing", {"2", "inf", "nan"}),
}


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("value", VALUES)
def test_each_check_refuses_what_it_says_in_one_wording(check, value):
    function, (rule, allowed) = getattr(_bounds, check), CHECKS[check]
    number = VALUES[value]
    if value in allowed:
        assert_array_equal(function([2.0, number], name="x", unit="m"), [2.0, number])
        return
    with pytest.raises(ValueError, match="must be") as scalar:
        function(number, name="x", unit="m")
    assert str(scalar.value) == f"x must be {rule} [m], got {value}"
    with pytest.raises(ValueError, match="must be") as array:
        function([[2.0, 2.0], [number, -1.0]], name="x", unit="m")
    assert str(array.value) == f"x must be {rule} [m], got {value} at index (1, 0)"


def test_a_hint_follows_what_was_given():
    with pytest.raises(
        ValueError, match=r"^n must be finite and at least 1, got 0\.9; "
    ):
        _bounds.at_least(0.9, 1, name="n", hint="water has about 1.38")


def test_what_is_empty_is_let_in():
    assert _bounds.positive([], name="depth", unit="m").shape == (0,)


# ---------------------------------------------------------------------------- shapes


def test_shapes_that_do_not_broadcast_are_named():
    assert _bounds.broadcast(depth=np.zeros((2, 1)), tilt=np.zeros(3), end=1.0) == (
        2,
        3,
    )
    text = r"^arguments must .* broadcast, got depth \(2,\), tilt \(3,\)$"
    with pytest.raises(ValueError, match=text):
        _bounds.broadcast(depth=np.zeros(2), tilt=np.zeros(3), end=1.0)


def test_columns_of_other_lengths_are_named():
    text = (
        r"^angle and value must be 1-D, of one length, at least 2 long, got \(3,\) and"
    )
    for value in (np.zeros(2), np.zeros((3, 1)), 0.0):
        with pytest.raises(ValueError, match=text):
            _bounds.one_axis(2, angle=np.zeros(3), value=value)
    with pytest.raises(
        ValueError, match=r"angle must be 1-D, at least 2 long, got \(1,"
    ):
        _bounds.one_axis(2, angle=np.zeros(1))


@pytest.mark.parametrize("shape", [(), (4,), (4, 3), (2, 3, 4)])
def test_last_axes_of_another_length_are_refused(shape):
    text = r"^mueller must have last axes \(4, 4\), got \("
    with pytest.raises(ValueError, match=text):
        _bounds.last_axes(np.zeros(shape), (4, 4), name="mueller")
