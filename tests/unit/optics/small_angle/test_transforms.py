"""Claims about layers of water, beam and receiver in Fourier space."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import j0

from amulor.optics import small_angle, small_angle_diffusion
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.tables import petzold
from amulor.optics.small_angle import transforms

SPLIT = np.pi / 2
PEAKED = henyey_greenstein_function(asymmetry=0.95)
HARBOUR = petzold("NUC 2040")
WATER = {
    "absorption": 0.15,
    "scattering": 0.6,
    "phase_function": PEAKED,
    "split_angle": SPLIT,
}
RECEIVER = {"receiver_radius": 0.05, "acceptance_angle": 0.08}
frequencies = st.floats(-100, 100)


def layer(kappa, p=0.0, z=1.5, **change):
    return transforms.layer_transfer(
        kappa, direction_frequency=p, depth=z, **(WATER | change)
    )


def diffusion(kappa, p=0.0, z=1.5):
    return transforms.diffusion_layer_transfer(
        kappa,
        direction_frequency=p,
        depth=z,
        absorption=0.15,
        forward_scattering=0.35,
        diffuse_scattering=0.02,
        second_moment=0.05,
    )


# ------------------------------------------------------------- layers of water


@pytest.mark.parametrize(("kappa", "p"), [(20.0, 0.0), (-30.0, 12.0), (3.0, 4.0)])
def test_a_layer_is_a_plain_integral_over_henyey_greenstein(kappa, p):
    g, z = 0.95, 1.5

    def density(angle):  # eq. (70), times the ring
        value = (1 - g**2) / (4 * np.pi) / (1 + g**2 - 2 * g * np.cos(angle)) ** 1.5
        return 2 * np.pi * value * np.sin(angle)

    options = {"epsabs": 0, "epsrel": 1e-10, "limit": 400}

    def forward(q):
        return sum(
            quad(lambda t: density(t) * j0(q * t), low, high, **options)[0]
            for low, high in ((0, 0.05), (0.05, 0.3), (0.3, SPLIT))
        )

    points = [-p / kappa] if 0 < -p / kappa < z else None
    spread = quad(
        lambda s: forward(abs(p + kappa * s)), 0, z, points=points, epsrel=1e-9
    )[0]
    expected = np.exp(-(0.15 + 0.6) * z + 0.6 * spread)
    assert_allclose(layer(kappa, p, z), expected, rtol=1e-8)  # that of the quadrature


@pytest.mark.parametrize("phase_function", [PEAKED, HARBOUR])
def test_wide_beams_lose_only_what_is_not_scattered_forward(phase_function):
    share, _ = phase_function.forward_split(SPLIT)
    found = layer(0.0, phase_function=phase_function)
    expected = np.exp(-(0.15 + 0.6 * (1 - share)) * 1.5)
    assert_allclose(found, expected, rtol=1e-12)


def test_the_finest_stripes_are_carried_by_unscattered_light_alone():
    # The transform of Henyey-Greenstein falls as exp(-(1 - g) q), here far below 1/q.
    found = layer(3e3, z=1.0, phase_function=henyey_greenstein_function(asymmetry=0.8))
    # What is left: 0.6 times the mean of the transform over 0..3000, about
    # 1 / (3000 * 0.2) = 2e-3.
    assert_allclose(found, np.exp(-0.75), rtol=3e-3)
    assert found > np.exp(-0.75)


def test_coarse_stripes_are_spread_as_by_diffusion():
    share, moment = PEAKED.forward_split(SPLIT)
    kappa = np.array([0.02, 0.04])
    exact = np.log(layer(kappa) / layer(0.0))
    gaussian = transforms.diffusion_layer_transfer(
        kappa,
        depth=1.5,
        absorption=0.15,
        forward_scattering=0.6 * share,
        diffuse_scattering=0.6 * (1 - share),
        second_moment=moment,
    )
    # Next term: q^4 <theta^4> / 64 over q^2 <theta^2> / 4, below 1e-3 here.
    assert_allclose(exact, np.log(gaussian / layer(0.0)), rtol=1e-3)


def test_diffusion_spreads_with_the_cube_of_the_depth():
    # Variance 2 D z^3 / 3 of the place: exp(-kappa^2 D z^3 / 3), D = 0.35 * 0.05 / 4.
    contrast = diffusion(2.0, z=[1.0, 2.0]) / diffusion(0.0, z=[1.0, 2.0])
    assert_allclose(np.log(contrast), [-4 * 0.004375 / 3, -32 * 0.004375 / 3])


@settings(deadline=None, max_examples=12)
@given(frequencies, frequencies, st.floats(0, 2), st.floats(0, 2))
def test_two_layers_do_what_one_of_both_depths_does(kappa, p, first, second):
    for transfer, tolerance in ((layer, 1e-9), (diffusion, 1e-11)):
        together = transfer(kappa, p, first + second)
        apart = transfer(kappa, p, first) * transfer(kappa, p + kappa * first, second)
        # Exponents of up to 1e4 are rounded in the diffusion form.
        assert_allclose(together, apart, rtol=tolerance, atol=1e-300)


@settings(deadline=None, max_examples=12)
@example(1e-10, 0.0, 1.0)  # a difference of integrals has no digits left here
@given(frequencies, frequencies, st.floats(0, 4))
def test_water_never_sharpens(kappa, p, z):
    assert layer(kappa, p, z) <= layer(0.0, 0.0, z) * (1 + 1e-12)
    assert_allclose(layer(-kappa, -p, z), layer(kappa, p, z), rtol=1e-12)


# ----------------------------------------------------------- means over frequencies


@pytest.mark.parametrize("split", [2.0, 0.5])
def test_integral_of_a_transform_is_its_own_at_each_frequency(split):
    # Panels end at 8 / split, at 128 times that, and at half octaves beyond.
    end = 8 / split
    frequency = np.array([0.0, 0.3, 0.999, 1.0, 1.7, 64.5, 127.9, 128.0]) * end
    found = transforms._integral(lambda u: np.cos(u * split), frequency, split=split)
    assert_allclose(found, np.sin(frequency * split) / split, atol=1e-10 / split)
    frequency = np.array([500.0, 20.0, 128 * np.sqrt(2), 1e4]) * end
    scale = 300 * end
    found = transforms._integral(lambda u: np.exp(-u / scale), frequency, split=split)
    assert_allclose(found, scale * (1 - np.exp(-frequency / scale)), rtol=1e-10)


def test_a_transform_is_evaluated_up_to_the_largest_frequency_only():
    shapes, largest = [], []

    def transform(u):
        shapes.append(u.shape)
        largest.append(u.max())
        return np.ones_like(u)

    for frequency, panels, end in (
        (0.0, 1, 4), (3.9, 1, 4), (4.1, 2, 8), (512.0, 128, 512), (600.0, 129, 725),
        (800.0, 130, 1024),
    ):  # fmt: skip
        transforms._integral(transform, np.array([frequency]), split=2.0)
        assert shapes[-1] == (panels, 16)
        assert 0.99 * end < largest[-1] < end * (1 + 1e-3)
    transforms._integral(transform, np.zeros(0), split=2.0)
    assert shapes[-1] == (1, 16)


@pytest.mark.parametrize(
    ("first", "last"),
    [(0.0, 3.0), (2.0, 5.0), (5.0, 2.0), (-2.0, 5.0), (-3.0, -1.0), (1.0, 1.001)],
)
def test_mean_of_a_transform_along_a_way_of_frequencies(first, last):
    found = transforms._mean_along(
        np.cos, np.array([first]), np.array([last]), split=1.0
    )
    expected = (np.sin(last) - np.sin(first)) / (last - first)
    assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("first", "width"), [(1.0, 0.0), (1.0, 1e-9), (1e3, 5e-4), (-0.5, 2e-5), (0, 1e-7)]
)
def test_mean_of_a_transform_over_a_short_way_is_that_of_its_middle(first, width):
    found = transforms._mean_along(
        np.cos, np.array([first]), np.array([first + width]), split=1.0
    )
    assert_allclose(found, np.cos(first + width / 2), rtol=1e-14)


# ------------------------------------------------------------- beam and receiver


def test_the_receiver_takes_in_its_area_and_solid_angle():
    def flat(rho):
        return (
            2
            * np.pi
            * rho
            * transforms.receiver_sensitivity(rho, angle=0.0, **RECEIVER)
        )

    def wide(angle):
        return (
            2
            * np.pi
            * angle
            * transforms.receiver_sensitivity(0.0, angle=angle, **RECEIVER)
        )

    # pi R^2 and pi gamma^2, and 1/e at R and at gamma.
    assert_allclose(quad(flat, 0, 0.5)[0], np.pi * 0.05**2, rtol=1e-9)
    assert_allclose(quad(wide, 0, 0.8)[0], np.pi * 0.08**2, rtol=1e-9)
    edge = transforms.receiver_sensitivity(0.05, angle=0.08, **RECEIVER)
    assert_allclose(edge, np.exp(-2), rtol=1e-14)


@settings(deadline=None, max_examples=30)
@given(st.floats(0, 6), st.floats(0.01, 0.1), st.floats(0.01, 0.2))
def test_sensitivity_is_the_transform_back(share, radius, gamma):
    # One axis of the place; the others integrate to sqrt(pi) R and pi gamma^2.
    rho = share * radius
    kappa = np.linspace(-14 / radius, 14 / radius, 401)
    source = transforms.effective_source_transform(
        kappa,
        direction_frequency=0.0,
        baseline=rho,
        receiver_radius=radius,
        acceptance_angle=gamma,
    )
    back = np.sum(source).real * (kappa[1] - kappa[0]) / (2 * np.pi)
    one = transforms.receiver_sensitivity(
        rho, angle=0.0, receiver_radius=radius, acceptance_angle=gamma
    )
    whole = np.pi**1.5 * radius * gamma**2
    # The sum over a Gaussian is exact within its period, 90 radii; exp(-49) is cut.
    assert_allclose(back, whole * one, rtol=0, atol=1e-12 * whole)


def ring(value, kappa, baseline):
    """Return the overlap: (1 / 2 pi) integral of kappa J0 times a transform."""
    step = kappa[1] - kappa[0]
    weight = np.full(kappa.size, 2.0)  # Simpson
    weight[1::2], weight[[0, -1]] = 4.0, 1.0
    integrand = kappa * j0(kappa * baseline) * value
    return np.sum(weight * integrand) * step / 3 / (2 * np.pi)


@pytest.mark.parametrize("z", [0.8, 2.5])
def test_source_times_layer_squared_is_the_overlap_of_both_models(z):
    baseline = 0.15
    kappa = np.linspace(0, 14 / 0.05, 4801)  # exp(-49) of the aperture is left
    source = transforms.effective_source_transform(
        kappa, direction_frequency=kappa * z, baseline=0.0, **RECEIVER
    ).real
    water = WATER | {"phase_function": henyey_greenstein_function(asymmetry=0.97)}
    found = ring(source * layer(kappa, z=z, **water) ** 2, kappa, baseline)
    expected = small_angle.overlap(z, baseline=baseline, **water, **RECEIVER)
    # The promise of that model is 1e-6 of the light on the axis.
    axis = small_angle.overlap(z, baseline=0.0, **water, **RECEIVER)
    assert_allclose(found, expected, rtol=0, atol=1e-6 * axis)
    spread = diffusion(kappa, z=z) ** 2
    found = ring(source * spread, kappa, baseline)
    expected = small_angle_diffusion.overlap(
        z,
        absorption=0.15,
        forward_scattering=0.35,
        diffuse_scattering=0.02,
        second_moment=0.05,
        baseline=baseline,
        **RECEIVER,
    )
    # A closed form, eq. (43); Simpson's rule leaves 3e-9 with these steps.
    assert_allclose(found, expected, rtol=1e-8)


def test_the_width_of_the_beam_adds_to_that_of_the_receiver():
    wide = transforms.effective_source_transform(
        30.0,
        direction_frequency=10.0,
        baseline=0.1,
        receiver_radius=0.03,
        acceptance_angle=0.06,
        beam_radius=0.04,
        beam_divergence=0.08,
    )
    # 3-4-5: the same as a receiver of 0.05 and 0.1 but for what it takes in.
    one = transforms.effective_source_transform(
        30.0,
        direction_frequency=10.0,
        baseline=0.1,
        receiver_radius=0.05,
        acceptance_angle=0.1,
    )
    assert_allclose(wide, one * (0.6 * 0.6) ** 2, rtol=1e-13)


# ------------------------------------------------------------- shapes and refusals


def test_arguments_broadcast():
    assert layer(np.zeros((3, 1)), np.ones(2)).shape == (3, 2)
    assert diffusion(np.zeros((3, 1)), np.ones(2)).shape == (3, 2)
    source = transforms.effective_source_transform(
        np.zeros((3, 1)), direction_frequency=np.ones(2), baseline=0.1, **RECEIVER
    )
    assert source.shape == (3, 2)


def test_what_is_no_water_or_receiver_is_refused():
    with pytest.raises(ValueError, match="depth must be finite and not negative"):
        layer(1.0, z=-1.0)
    with pytest.raises(ValueError, match="scattering must be finite and not negative"):
        layer(1.0, scattering=-0.5)
    with pytest.raises(ValueError, match="split_angle must be"):
        layer(1.0, split_angle=0.0)
    with pytest.raises(ValueError, match="receiver_radius must be finite and above 0"):
        transforms.receiver_sensitivity(
            0.0, angle=0.0, receiver_radius=0.0, acceptance_angle=0.1
        )
    with pytest.raises(ValueError, match="beam_radius must be finite and not negative"):
        transforms.effective_source_transform(
            1.0, direction_frequency=0.0, baseline=0.0, beam_radius=-1e-3, **RECEIVER
        )
