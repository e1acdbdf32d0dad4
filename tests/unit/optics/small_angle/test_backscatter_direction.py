"""Claims about how far from straight back the received light was scattered."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics import small_angle_diffusion
from amulor.optics.small_angle import backscatter_direction as direction

COLUMN = {
    "forward_scattering": 0.35,
    "second_moment": 0.05,
    "baseline": 0.2,
    "receiver_radius": 0.02,
    "acceptance_angle": 0.08,
}
LOSS = {"absorption": 0.15, "diffuse_scattering": 0.02}
columns = st.fixed_dictionaries(
    {
        "forward_scattering": st.floats(0, 2),
        "second_moment": st.floats(0, 0.1),
        "baseline": st.floats(0, 0.3),
        "receiver_radius": st.floats(0.005, 0.05),
        "acceptance_angle": st.floats(0.02, 0.15),
    }
)


def moments(depth, **change):
    return direction.backscatter_direction(depth, **(COLUMN | change))


def test_radiance_is_the_inverse_transform_of_source_and_layer():
    # One axis at a time: over kappa and p, eqs. (34) and (39) with 2 D and 2 k'.
    z, d, radius, gamma = 1.5, 0.35 * 0.05 / 4, 0.02, 0.08
    kappa = np.linspace(-700, 700, 1401)[:, None]
    p = np.linspace(-250, 250, 1001)[None, :]
    spread = p**2 * z + p * kappa * z**2 + kappa**2 * z**3 / 3
    width = radius**2 * kappa**2 + gamma**2 * (p + kappa * z) ** 2
    gaussian = np.exp(-width / 4 - 2 * d * spread)
    step = (kappa[1, 0] - kappa[0, 0]) * (p[0, 1] - p[0, 0]) / (2 * np.pi) ** 2

    def axis(offset, angle):
        return np.sum(gaussian * np.cos(kappa * offset + p * angle)) * step

    loss = np.exp(-2 * (0.15 + 0.02) * z)
    etendue = (np.pi * radius * gamma) ** 2
    for along, across in ((0.0, 0.0), (0.2, 0.0), (0.15, -0.1)):
        # Received light starts at rho_0 from the receiver's axis and turns to it.
        expected = etendue * loss * axis(0.2, along) * axis(0.0, across)
        found = direction.effective_radiance(
            along, cross_angle=across, depth=z, **COLUMN, **LOSS
        )
        assert_allclose(found, expected, rtol=1e-6)


def test_the_overlap_is_the_integral_of_the_radiance():
    angle = np.linspace(-1.2, 1.6, 561)
    radiance = direction.effective_radiance(
        angle[:, None], cross_angle=angle, depth=2.0, **COLUMN, **LOSS
    )
    whole = np.sum(radiance) * (angle[1] - angle[0]) ** 2
    expected = small_angle_diffusion.overlap(2.0, **COLUMN, **LOSS)
    # The sum over a grid of 17 points a standard deviation is exact for a Gaussian.
    assert_allclose(whole, expected, rtol=1e-9)


def test_without_scattering_light_turns_by_the_parallax():
    # gamma z >> R: to meet the receiver's axis, light turns by baseline over depth.
    mean, variance = moments(
        5.0, forward_scattering=0.0, receiver_radius=1e-4, acceptance_angle=0.1
    )
    assert_allclose(mean, 0.2 / 5.0, rtol=1e-6)
    # What is left is the aperture as seen from there: R^2 / 2 z^2.
    assert_allclose(variance, 1e-8 / 2 / 25, rtol=1e-6)


def test_at_the_instrument_only_the_acceptance_is_left():
    mean, variance = moments(0.0)
    assert mean == 0
    assert_allclose(variance, 0.08**2 / 2, rtol=1e-14)


@settings(deadline=None)
@given(columns, st.floats(0.1, 5), st.floats(0.5, 2))
def test_a_model_tank_has_the_same_angles(column, depth, scale):
    mean, variance = direction.backscatter_direction(depth, **column)
    small = column | {
        "forward_scattering": column["forward_scattering"] / scale,
        "baseline": column["baseline"] * scale,
        "receiver_radius": column["receiver_radius"] * scale,
    }
    again = direction.backscatter_direction(depth * scale, **small)
    assert_allclose(again[0], mean, rtol=1e-12, atol=1e-300)
    assert_allclose(again[1], variance, rtol=1e-12)


def test_a_flat_function_is_its_value_at_180_degrees():
    found = direction.mean_backscatter_vsf(
        [0.5, 1.5, 4.0], vsf=lambda angle: np.full(angle.shape, 2e-3), **COLUMN
    )
    assert_allclose(found, 2e-3, rtol=1e-12)


def _small(mean, variance):
    """Return whether the deviations are small angles; others are refused."""
    return abs(mean) + 4 * np.sqrt(variance) < np.pi / 2


@settings(deadline=None, max_examples=30)
@given(columns, st.floats(1.0, 4), st.floats(-3, 3))
def test_a_parabola_meets_its_mean_square_deviation(column, depth, curvature):
    mean, variance = direction.backscatter_direction(depth, **column)
    assume(_small(mean, variance))
    found = direction.mean_backscatter_vsf(
        depth, vsf=lambda t: 1 + curvature * (np.pi - t) ** 2, **column
    )
    # Two components of one variance, about a mean in one of them.
    assert_allclose(found, 1 + curvature * (mean**2 + 2 * variance), rtol=1e-10)


@settings(deadline=None, max_examples=30)
@given(columns, st.floats(1.0, 4), st.floats(0.05, 3))
def test_a_gaussian_peak_is_widened_by_the_spread(column, depth, share):
    mean, variance = direction.backscatter_direction(depth, **column)
    assume(_small(mean, variance))
    width = share**2 * variance
    found = direction.mean_backscatter_vsf(
        depth, vsf=lambda t: np.exp(-((np.pi - t) ** 2) / (2 * width)), **column
    )
    # A product of two Gaussians, integrated over both components.
    expected = np.exp(-(mean**2) / (2 * (variance + width))) / (1 + variance / width)
    assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_a_glory_is_smoothed_as_a_plain_sum_over_angles_says():
    def glory(angle):
        return 1e-3 * (1 + np.cos(20 * (np.pi - angle)) * np.exp(-3 * (np.pi - angle)))

    depth = 3.0
    found = direction.mean_backscatter_vsf(depth, vsf=glory, **COLUMN)
    angle = np.linspace(-0.9, 1.1, 2001)
    weight = direction.effective_radiance(
        angle[:, None], cross_angle=angle, depth=depth, **COLUMN, **LOSS
    )
    deviation = np.hypot(angle[:, None], angle)
    expected = np.sum(weight * glory(np.pi - deviation)) / np.sum(weight)
    # The cusp at 180 degrees costs the sum over a grid some digits.
    assert_allclose(found, expected, rtol=1e-4)
    assert abs(found - glory(np.array(np.pi))) > 1e-4  # or nothing was smoothed


def test_what_lies_beyond_small_angles_is_refused():
    with pytest.raises(ValueError, match=r"must be below pi/2 \[rad\], got"):
        direction.mean_backscatter_vsf(0.1, vsf=np.cos, **(COLUMN | {"baseline": 3.0}))
    with pytest.raises(ValueError, match="vsf must keep the shape"):
        direction.mean_backscatter_vsf(1.0, vsf=lambda angle: 1.0, **COLUMN)
    with pytest.raises(ValueError, match="depth must be finite and not negative"):
        moments(-1.0)
    with pytest.raises(ValueError, match="acceptance_angle must be finite and above 0"):
        moments(1.0, acceptance_angle=0.0)
