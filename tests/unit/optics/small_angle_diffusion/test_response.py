"""Water signal of the diffusion model: closed forms, limits, invariances, refusals."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light
from scipy.integrate import quad
from scipy.special import exp1, j0

from amulor.optics.small_angle_diffusion import (
    narrow_receiver_response,
    overlap,
    water_response,
    water_tail,
)

WATER = {
    "absorption": 0.15,
    "forward_scattering": 0.35,
    "diffuse_scattering": 0.05,
    "second_moment": 0.05,
}
RECEIVER = {"baseline": 0.2, "receiver_radius": 0.02, "acceptance_angle": 0.08}
LIGHT = {"backscatter_vsf": 1e-3, "group_index": 1.34}
COLUMN = WATER | RECEIVER | LIGHT
SWEEP = np.linspace(0.5e6, 138e6, 40)

columns = st.fixed_dictionaries(
    {
        "absorption": st.floats(0.02, 2.0),
        "forward_scattering": st.floats(0.0, 5.0),
        "diffuse_scattering": st.floats(0.0, 3.0),
        "second_moment": st.floats(0.0, 0.3),
        "baseline": st.floats(0.0, 0.5),
        "receiver_radius": st.floats(1e-3, 0.05),
        "acceptance_angle": st.floats(0.02, 0.2),
        "tilt": st.floats(-0.05, 0.3),
        "cross_tilt": st.floats(-0.05, 0.05),
        "standoff": st.floats(0.0, 1.0),
        "backscatter_vsf": st.floats(1e-5, 1e-2),
        "group_index": st.floats(1.33, 1.39),
    }
)
frequencies = st.floats(0.0, 1e9)
drawn = settings(deadline=None, max_examples=60)


# ---------------------------------------------------------------- overlap


def test_overlap_is_the_fourier_integral_it_was_derived_from():
    # Eq. (40), in polar form: an integral over the spatial frequency kappa.
    depth, loss, offset = 2.0, 0.2, 0.2
    area = 0.02**2 + (0.08 * depth) ** 2 + 2 / 3 * 0.35 * 0.05 * depth**3

    def integrand(kappa):
        return kappa * np.exp(-area * kappa**2 / 4) * j0(kappa * offset)

    flux = np.pi * 0.02**2 * np.pi * 0.08**2 / (2 * np.pi)
    expected = flux * np.exp(-2 * loss * depth) * quad(integrand, 0, 200)[0]
    # quad reaches 1e-10 here.
    assert_allclose(overlap(depth, **WATER, **RECEIVER), expected, rtol=1e-9)


def test_overlap_far_away_is_the_lidar_equation():
    clear = {"absorption": 0.1, "diffuse_scattering": 0.0, "second_moment": 0.0}
    far = overlap(
        40.0,
        **clear,
        forward_scattering=0.0,
        baseline=0.0,
        receiver_radius=0.01,
        acceptance_angle=0.1,
    )
    # R^2 is (0.01 / 4)^2 = 6e-6 of gamma^2 z^2.
    assert_allclose(far, np.pi * 0.01**2 / 40**2 * np.exp(-2 * 0.1 * 40), rtol=1e-5)


def test_overlap_close_by_is_the_solid_angle_of_the_receiver():
    close = overlap(0.01, **WATER, **RECEIVER | {"baseline": 0.0})
    # gamma z is 8e-4 of R = 0.02, squared 1.6e-3; the loss is written out.
    expected = np.pi * 0.08**2 * np.exp(-2 * 0.2 * 0.01)
    assert_allclose(close, expected, rtol=2e-3)


@given(depth=st.floats(0.0, 10.0), tilt=st.floats(-0.2, 0.2))
@drawn
def test_a_tilt_moves_the_beam_by_tilt_times_depth(depth, tilt):
    tilted = overlap(depth, **WATER, **RECEIVER, tilt=tilt)
    moved = abs(0.2 - tilt * depth)
    # Rounding of an exponent of at most 100.
    assert_allclose(
        tilted, overlap(depth, **WATER, **RECEIVER | {"baseline": moved}), rtol=1e-12
    )


def test_a_positive_tilt_leads_towards_the_receiver():
    depth = 2.0
    parallel, towards, away = overlap(
        depth, **WATER, **RECEIVER, tilt=np.array([0.0, 0.1, -0.1])
    )
    assert towards > parallel > away
    on_axis = overlap(depth, **WATER, **RECEIVER | {"baseline": 0.0})
    assert_allclose(towards, on_axis, rtol=1e-14)  # it meets the axis there


@given(angle=st.floats(0, 2 * np.pi), depth=st.floats(0.0, 10.0))
@drawn
def test_without_baseline_only_the_size_of_the_tilt_counts(angle, depth):
    coaxial = WATER | RECEIVER | {"baseline": 0.0}
    turned = overlap(
        depth, **coaxial, tilt=0.05 * np.cos(angle), cross_tilt=0.05 * np.sin(angle)
    )
    assert_allclose(turned, overlap(depth, **coaxial, tilt=0.05), rtol=1e-12)


def test_a_standoff_acts_like_water_without_losses_in_front():
    clear = WATER | {"second_moment": 0.0}
    behind = overlap(1.5, **clear, **RECEIVER, tilt=0.03, standoff=0.5)
    without = overlap(2.0, **clear, **RECEIVER, tilt=0.03)
    assert_allclose(behind, without * np.exp(2 * 0.2 * 0.5), rtol=1e-13)


def test_overlap_broadcasts_over_everything():
    result = overlap(
        np.ones((4, 1, 1)),
        **WATER | {"absorption": np.ones((3, 1))},
        **RECEIVER,
        tilt=np.zeros(2),
    )
    assert result.shape == (4, 3, 2)


# ------------------------------------------------------- shapes and refusals


def test_result_has_the_shape_of_the_frequency():
    assert water_response(1e7, **COLUMN).shape == ()
    assert water_response(1e7, **COLUMN).dtype == complex
    assert isinstance(water_response(1e7, **COLUMN), np.ndarray)
    assert water_response(np.ones((2, 3)), **COLUMN).shape == (2, 3)
    assert water_response([], **COLUMN).shape == (0,)
    assert water_tail(np.ones((2, 3)), **COLUMN, end=1.0).shape == (2, 3)
    assert (
        narrow_receiver_response(
            1e7, **LIGHT, absorption=1.0, diffuse_scattering=0.0, acceptance_angle=0.01
        ).shape
        == ()
    )


def test_broadcast_equals_a_loop():
    rng = np.random.default_rng(1)
    frequency = rng.uniform(0, 2e8, (3, 1, 1, 1))
    many = COLUMN | {
        "absorption": rng.uniform(0.05, 0.5, (2, 1, 1)),
        "backscatter_vsf": rng.uniform(1e-4, 1e-3, 4),
        "group_index": rng.uniform(1.33, 1.38, (5, 1)),
        "tilt": rng.uniform(0, 0.1, (5, 4)),
        "end": rng.uniform(1, 5, (2, 1, 4)),
    }
    result = water_response(frequency, **many)
    assert result.shape == (3, 2, 5, 4)
    arrays = np.broadcast_arrays(frequency, *many.values())
    for index in np.ndindex(result.shape):
        scalars = [float(array[index]) for array in arrays]
        single = water_response(scalars[0], **dict(zip(many, scalars[1:], strict=True)))
        # The frequencies of a batch share sums, in another order of rounding.
        assert_allclose(result[index], single, rtol=1e-12)


def test_frequencies_that_differ_by_pixel_are_kept_apart():
    frequency = np.array([[3e7, 1e7, 2e7], [0.0, 5e8, 4e7]])
    tilt = np.array([[0.0], [0.05]])
    result = water_response(frequency, **COLUMN, tilt=tilt)
    for i in range(2):
        expected = water_response(frequency[i], **COLUMN, tilt=tilt[i, 0])
        assert_allclose(result[i], expected, rtol=1e-12)


def test_order_of_frequencies_does_not_matter():
    shuffled = np.random.default_rng(2).permutation(SWEEP)
    expected = dict(zip(SWEEP, water_response(SWEEP, **COLUMN), strict=True))
    result = water_response(shuffled, **COLUMN)
    assert_array_equal(result, [expected[frequency] for frequency in shuffled])


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("modulation_frequency", -1.0, "modulation_frequency must be finite and not"),
        (
            "modulation_frequency",
            [1.0, np.nan],
            r"modulation_frequency .* \[Hz\], got nan at index \(1,\)$",
        ),
        ("modulation_frequency", np.inf, "modulation_frequency must be finite"),
        (
            "absorption",
            -0.1,
            r"absorption must be finite and not negative \[1/m\], got -0\.1$",
        ),
        ("absorption", [0.1, -0.1], r"\[1/m\], got -0\.1 at index \(1,\)"),
        ("forward_scattering", np.inf, "forward_scattering must be finite"),
        ("diffuse_scattering", -1.0, "diffuse_scattering"),
        ("second_moment", -1.0, r"second_moment .* \[rad\^2\]"),
        ("backscatter_vsf", -1.0, r"backscatter_vsf .* \[1/\(m sr\)\]"),
        ("group_index", 0.99, "group_index must be finite and at least 1, got 0.99"),
        ("baseline", -0.1, "baseline"),
        ("receiver_radius", 0.0, "receiver_radius must be finite and above 0"),
        ("acceptance_angle", 0.0, "acceptance_angle must be finite and above 0"),
        ("tilt", np.inf, r"tilt must be finite \[rad\], got inf"),
        ("cross_tilt", np.nan, "cross_tilt"),
        ("standoff", -1.0, "standoff"),
        ("end", -1.0, "end must be not negative, .* got -1"),
        ("end", np.nan, "end must be not negative, .* got nan"),
    ],
)
@pytest.mark.parametrize("function", [water_response, water_tail])
def test_values_out_of_range_are_refused_by_name(function, name, value, text):
    arguments = {"modulation_frequency": 1e7} | COLUMN | {name: value}
    with pytest.raises(ValueError, match=text):
        function(**arguments)


def test_a_depth_in_front_of_the_water_is_refused():
    with pytest.raises(ValueError, match="depth must be finite and not negative"):
        overlap([1.0, -1.0], **WATER, **RECEIVER)


def test_the_narrow_limit_needs_losses():
    with pytest.raises(ValueError, match=r"must be above 0 \[1/m\]"):
        narrow_receiver_response(
            1e7, **LIGHT, absorption=0.0, diffuse_scattering=0.0, acceptance_angle=0.01
        )


def test_a_column_beyond_double_precision_is_an_error_not_a_number():
    # Beam and receiver cross at 2 m, within 1e-14 m.
    pencil = {
        "second_moment": 0.0,
        "receiver_radius": 1e-15,
        "acceptance_angle": 1e-15,
        "tilt": 0.1,
    }
    with pytest.raises(ArithmeticError, match="1 of 2 water columns"):
        water_response(1e7, **COLUMN | pencil, end=[1.0, 3.0])


def test_light_below_the_smallest_number_is_zero():
    # The beam never comes within 900 receiver widths: exp(-8e5) is left.
    dark = COLUMN | {
        "second_moment": 0.0,
        "baseline": 1.0,
        "receiver_radius": 1e-3,
        "acceptance_angle": 1e-5,
    }
    assert_array_equal(water_response(SWEEP, **dark, end=10.0), 0.0)


def test_no_water_gives_no_signal():
    assert_array_equal(water_response(SWEEP, **COLUMN, end=0.0), 0.0)
    assert_array_equal(water_tail(SWEEP, **COLUMN), 0.0)
    assert_array_equal(water_response(SWEEP, **COLUMN | {"backscatter_vsf": 0.0}), 0.0)


# ------------------------------------------------- closed forms and limits


@pytest.mark.parametrize("loss", [0.02, 0.3, 4.0])
@pytest.mark.parametrize(("radius", "acceptance"), [(0.02, 0.08), (0.001, 0.1)])
def test_coaxial_clear_water_is_an_exponential_integral(loss, radius, acceptance):
    # With rho_0 = 0 and no spread, F / (pi gamma^2) = exp(-2 k' z) / (1 + (z/q)^2)
    # with q = R / gamma; partial fractions leave two exponential integrals.
    frequency = np.array([0.0, 1e6, 3e7, 2e8, 1e9])
    q = radius / acceptance
    x = q * (2 * loss - 4j * np.pi * frequency * 1.34 / speed_of_light)
    closed = (np.exp(-1j * x) * exp1(-1j * x) - np.exp(1j * x) * exp1(1j * x)) / 2j
    result = water_response(
        frequency,
        absorption=loss,
        forward_scattering=0.0,
        diffuse_scattering=0.0,
        second_moment=0.0,
        baseline=0.0,
        receiver_radius=radius,
        acceptance_angle=acceptance,
        **LIGHT,
    )
    expected = 1e-3 * np.pi * acceptance**2 * q * closed
    # The bar of the package; exp1 keeps 1e-14.
    assert_allclose(result, expected, rtol=0, atol=1e-12 * abs(expected[0]))


def test_water_without_losses_has_a_finite_response():
    # rho_0 = 0 and k' = 0: the transform of 1 / (R^2 + gamma^2 z^2), whose real
    # part is pi exp(-w R / gamma) / (2 R gamma).
    frequency = np.array([0.0, 1e6, 1e7, 1e8, 1e9])
    result = water_response(
        frequency,
        **LIGHT,
        absorption=0.0,
        forward_scattering=1.0,
        diffuse_scattering=0.0,
        second_moment=0.0,
        baseline=0.0,
        receiver_radius=0.02,
        acceptance_angle=0.08,
    )
    phase_per_depth = 4 * np.pi * frequency * 1.34 / speed_of_light
    expected = 1e-3 * np.pi**2 / 2 * 0.02 * 0.08 * np.exp(-phase_per_depth * 0.25)
    assert_allclose(result.real, expected, rtol=0, atol=1e-12 * expected[0])
    assert result[0].imag == 0


def test_narrow_coaxial_receiver_reaches_the_closed_limit():
    narrow = {"absorption": 0.5, "diffuse_scattering": 0.5, "acceptance_angle": 1e-5}
    frequency = np.linspace(0, 300e6, 31)
    limit = narrow_receiver_response(frequency, **narrow, **LIGHT)
    result = water_response(
        frequency,
        **narrow,
        **LIGHT,
        forward_scattering=0.0,
        second_moment=0.0,
        baseline=0.0,
        receiver_radius=0.05,
    )
    # Next order: 2 (gamma / (2 k' R))^2 = 2e-8.
    assert_allclose(result, limit, rtol=3e-8)


def test_narrow_limit_has_the_modulus_and_phase_of_a_first_order_low_pass():
    corner = speed_of_light / 1.34 * 0.8 / (2 * np.pi)
    zero, at_corner = narrow_receiver_response(
        [0.0, corner],
        absorption=0.3,
        diffuse_scattering=0.5,
        acceptance_angle=0.01,
        **LIGHT,
    )
    assert_allclose(zero, 1e-3 * np.pi * 0.01**2 / (2 * 0.8), rtol=1e-14)
    assert_allclose(abs(at_corner), zero.real / np.sqrt(2), rtol=1e-14)
    assert_allclose(np.angle(at_corner), np.pi / 4, rtol=1e-14)


def test_a_thin_layer_echoes_with_the_delay_of_its_depth():
    depth, thin = 3.0, 1e-4
    layer = water_response(SWEEP, **COLUMN, end=depth + thin)
    layer = layer - water_response(SWEEP, **COLUMN, end=depth)
    delay = 4 * np.pi * SWEEP * (depth + thin / 2) * 1.34 / speed_of_light
    wrapped = np.angle(layer * np.exp(-1j * delay))
    # The layer is a 1e-4 part of the column: subtraction leaves about 1e-11.
    assert_allclose(wrapped, 0, atol=1e-8)
    middle = overlap(depth + thin / 2, **WATER, **RECEIVER) * 1e-3 * thin
    assert_allclose(np.abs(layer), middle, rtol=1e-6)


def test_a_column_that_ends_later_has_the_larger_phase():
    end = np.array([1.0, 2.0, 4.0, 8.0])
    phase = np.angle(water_response(5e6, **COLUMN, end=end))
    assert np.all(np.diff(phase) > 0)
    assert phase[0] > 0


# --------------------------------------------------------------- invariances


@given(column=columns, frequency=frequencies)
@drawn
def test_modulation_never_raises_the_signal_and_starts_in_phase(column, frequency):
    zero, other = water_response([0.0, frequency], **column)
    assert zero.imag == 0
    assert zero.real > 0
    assert abs(other) <= zero.real * (1 + 1e-12)


@given(column=columns, frequency=frequencies, end=st.floats(0.0, 20.0))
@drawn
def test_column_and_tail_add_up_to_open_water(column, frequency, end):
    column_part = water_response([0.0, frequency], **column, end=end)
    tail = water_tail([0.0, frequency], **column, end=end)
    whole = water_response([0.0, frequency], **column)
    assert_allclose(column_part + tail, whole, rtol=0, atol=2e-12 * whole[0].real)


@given(column=columns, frequency=frequencies, scale=st.floats(0.1, 10.0))
@drawn
def test_a_model_tank_responds_like_the_sea(column, frequency, scale):
    # Lengths times s, coefficients and frequency over s: nothing in (46) changes.
    model = dict(column)
    for name in ("baseline", "receiver_radius", "standoff"):
        model[name] *= scale
    for name in (
        "absorption",
        "forward_scattering",
        "diffuse_scattering",
        "backscatter_vsf",
    ):
        model[name] /= scale
    full = water_response([0.0, frequency], **column, end=5.0)
    small = water_response([0.0, frequency / scale], **model, end=5.0 * scale)
    assert_allclose(small, full, rtol=0, atol=2e-12 * abs(full[0]))


@given(column=columns, frequency=frequencies)
@drawn
def test_side_of_the_cross_tilt_does_not_matter(column, frequency):
    mirrored = column | {"cross_tilt": -column["cross_tilt"]}
    assert_array_equal(
        water_response(frequency, **mirrored), water_response(frequency, **column)
    )


@given(column=columns, near=st.floats(0.0, 10.0), far=st.floats(0.0, 10.0))
@drawn
def test_more_water_gives_more_light(column, near, far):
    assume(near < far)
    short, long = water_response(0.0, **column, end=np.array([near, far]))
    assert short.real <= long.real * (1 + 1e-12)
