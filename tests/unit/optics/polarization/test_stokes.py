"""Claims about Stokes vectors and the convention for U and V."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.polarization import stokes

parts = st.floats(-10.0, 10.0)
fields = st.tuples(parts, parts, parts, parts).filter(
    lambda f: f[0] ** 2 + f[1] ** 2 + f[2] ** 2 + f[3] ** 2 > 1e-2
)


def field_of(f):
    return complex(f[0], f[1]), complex(f[2], f[3])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("H", [1, 1, 0, 0]),
        ("V", [1, -1, 0, 0]),
        ("P", [1, 0, 1, 0]),
        ("M", [1, 0, -1, 0]),
        ("R", [1, 0, 0, 1]),
        ("L", [1, 0, 0, -1]),
        ("none", [1, 0, 0, 0]),
    ],
)
def test_named_states_are_those_of_the_convention(name, expected):
    assert_array_equal(stokes.state(name), expected)


def test_a_state_that_was_changed_does_not_change_the_next_one():
    stokes.state("R")[3] = 7.0
    assert_array_equal(stokes.state("R"), [1, 0, 0, 1])


@pytest.mark.parametrize(
    ("parallel", "perpendicular", "name"),
    [
        (1.0, 0.0, "H"),
        (0.0, 1.0, "V"),
        (np.sqrt(0.5), np.sqrt(0.5), "P"),
        (np.sqrt(0.5), -np.sqrt(0.5), "M"),
        (np.sqrt(0.5), -1j * np.sqrt(0.5), "R"),
        (np.sqrt(0.5), 1j * np.sqrt(0.5), "L"),
    ],
)
def test_fields_give_the_named_states(parallel, perpendicular, name):
    vector = stokes.from_field(parallel, perpendicular)
    assert_allclose(vector, stokes.state(name), rtol=0, atol=1e-15)  # rounding


def test_the_field_of_right_circular_light_turns_clockwise_for_the_receiver():
    # Real field in time of the amplitudes that give V > 0, with exp(-i omega t). The
    # receiver looks at the source; parallel is to the right and perpendicular up, for
    # their cross product is the direction of travel, towards the receiver.
    parallel, perpendicular = 1.0, -1.0j
    assert stokes.from_field(parallel, perpendicular)[3] > 0
    turn = np.exp(-1j * np.linspace(0, 2 * np.pi, 33))
    right, up = (parallel * turn).real, (perpendicular * turn).real
    anticlockwise = right[:-1] * up[1:] - up[:-1] * right[1:]
    assert np.all(anticlockwise < 0)


def test_u_is_positive_where_the_field_lies_between_the_positive_axes():
    angle = np.radians(30.0)
    vector = stokes.from_field(np.cos(angle), np.sin(angle))
    # I = 1, Q = cos 60, U = sin 60 degrees.
    assert_allclose(vector, [1, 0.5, np.sqrt(0.75), 0], rtol=0, atol=1e-15)
    assert_allclose(stokes.polarization_angle(vector), angle, rtol=1e-15)


@settings(deadline=None)
@given(fields)
def test_a_field_is_fully_polarized(f):
    vector = stokes.from_field(*field_of(f))
    assert_allclose(stokes.degree_of_polarization(vector), 1, rtol=1e-14)


@settings(deadline=None)
@given(fields, st.floats(0, 2 * np.pi))
def test_a_common_phase_changes_nothing(f, phase):
    parallel, perpendicular = field_of(f)
    turn = np.exp(1j * phase)
    vector = stokes.from_field(parallel, perpendicular)
    turned = stokes.from_field(turn * parallel, turn * perpendicular)
    assert_allclose(turned, vector, rtol=0, atol=1e-14 * vector[0])


@settings(deadline=None)
@given(st.floats(-np.pi / 2 * 0.999, np.pi / 2), st.floats(-0.78, 0.78))
def test_angles_of_the_ellipse_come_back(azimuth, ellipticity):
    # An ellipse with half-axes cos and sin of the ellipticity; right circular turns
    # clockwise, so the perpendicular part is behind by -i before the ellipse is turned.
    major, minor = np.cos(ellipticity), -1j * np.sin(ellipticity)
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    vector = stokes.from_field(
        cosine * major - sine * minor, sine * major + cosine * minor
    )
    # Near circular, 0.78 of 0.7854, the azimuth loses two digits.
    difference = stokes.polarization_angle(vector) - azimuth
    assert_allclose(np.sin(difference), 0, rtol=0, atol=1e-12)
    assert_allclose(stokes.ellipticity_angle(vector), ellipticity, rtol=0, atol=1e-13)


def test_sixty_one_percent_stays_polarized_off_the_painted_target():
    # Eq. (68) as rebuilt: (1, 1, 0, 0) comes back as (1, 0.61, 0, 0).
    vector = [1.0, 0.61, 0.0, 0.0]
    assert stokes.degree_of_polarization(vector) == 0.61
    assert stokes.degree_of_linear_polarization(vector) == 0.61
    assert stokes.degree_of_circular_polarization(vector) == 0.0


def test_degrees_of_a_worked_example():
    # sqrt(0.6^2 + 0.8^2) = 1 and sqrt(1 + 0.75^2) = 1.25, of an intensity of 2.
    vector = [2.0, 0.6, -0.8, -0.75]
    assert_allclose(stokes.degree_of_linear_polarization(vector), 0.5, rtol=1e-15)
    assert_allclose(stokes.degree_of_polarization(vector), 0.625, rtol=1e-15)
    assert_allclose(stokes.degree_of_circular_polarization(vector), -0.375, rtol=1e-15)


@settings(deadline=None)
@given(st.floats(0.1, 10), parts, parts, parts)
def test_degrees_add_as_squares(i, q, u, v):
    vector = [i, q, u, v]
    whole = stokes.degree_of_polarization(vector) ** 2
    linear = stokes.degree_of_linear_polarization(vector) ** 2
    circular = stokes.degree_of_circular_polarization(vector) ** 2
    assert_allclose(linear + circular, whole, rtol=1e-13, atol=1e-300)


def test_arguments_broadcast():
    vectors = np.ones((2, 3, 4))
    assert stokes.degree_of_polarization(vectors).shape == (2, 3)
    assert stokes.ellipticity_angle(vectors).shape == (2, 3)
    assert stokes.from_field(np.ones((2, 1)), np.ones(3)).shape == (2, 3, 4)


@pytest.mark.parametrize("name", ["X", "h", "", "HV"])
def test_an_unknown_state_is_refused(name):
    with pytest.raises(
        ValueError, match=r"must be one of 'H', 'V', 'P', 'M', 'R', 'L'"
    ):
        stokes.state(name)


def test_what_is_no_stokes_vector_is_refused():
    with pytest.raises(
        ValueError, match=r"last axes \(4,\) \(I, Q, U, V\), got \(3,\)"
    ):
        stokes.degree_of_polarization([1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=r"I of stokes must be above 0, .* got 0"):
        stokes.degree_of_polarization([[1.0, 0, 0, 0], [0.0, 0, 0, 0]])
