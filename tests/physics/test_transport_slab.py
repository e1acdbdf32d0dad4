"""Plane layers against published tables and an independent deterministic solver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plane_parallel
import plane_parallel_vector
import pytest
from scipy.constants import speed_of_light

from amulor.optics.phase_functions.models import henyey_greenstein_function, isotropic
from amulor.transport import (
    Layer,
    Medium,
    ScatteringMatrix,
    reflection_and_transmission,
)

REFERENCE = Path(__file__).parents[1] / "reference"
#: Largest deviation in standard errors; of some 150 comparisons in this file one in
#: 16,000 would be above 4.
SIGMAS = 4.0


def slab(albedo, thickness, phase_function):
    """Return one layer of attenuation 1 1/m in a medium of group index 1."""
    layer = Layer(
        absorption=1 - albedo,
        scattering=albedo,
        phase_function=phase_function,
        thickness=thickness,
    )
    return Medium.layered([layer], group_index=1.0)


def frequency(modulation):
    """Return the frequency for omega / (v c) = modulation at c = 1 1/m."""
    return np.asarray(modulation) * speed_of_light / (2 * np.pi)


def assert_within(found, covariance, expected):
    """Compare real and imaginary parts by their own standard errors."""
    error = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    difference = np.asarray(found) - np.asarray(expected)
    pair = np.stack([difference.real, difference.imag], axis=-1)
    assert np.all(np.abs(pair) <= SIGMAS * error + 1e-12), pair / (error + 1e-300)


@pytest.mark.slow
def test_modulated_reflection_and_transmission_of_the_mcml_slab():
    # van de Hulst's slab at six modulation frequencies, discrete ordinates N = 64.
    table = np.loadtxt(
        REFERENCE / "slab_henyey_greenstein_modulated.csv", delimiter=","
    )
    modulation, reflected = table[:, 0], table[:, 1] + 1j * table[:, 2]
    transmitted = table[:, 3] + 1j * table[:, 4]
    medium = slab(0.9, 2.0, henyey_greenstein_function(asymmetry=0.75))
    tally = reflection_and_transmission(
        medium, frequency(modulation), histories=1_000_000, seed=11
    )
    found, covariance = tally.part("reflected")
    # 0.3 % of the reflected light, itself known within some 6 %: a wrong free path or
    # phase would show.
    assert np.sqrt(covariance[0, 0, 0, 0]) < 3.6e-3 * abs(reflected[0])
    assert_within(found[0], covariance[0], reflected)
    found, covariance = tally.part("transmitted")
    assert_within(found[0], covariance[0], transmitted)


def test_half_space_follows_the_h_function_with_a_complex_albedo():
    table = np.loadtxt(REFERENCE / "half_space_isotropic_modulated.csv", delimiter=",")
    modulation, expected = table[:, 0], table[:, 1] + 1j * table[:, 2]
    medium = slab(0.9, np.inf, isotropic())
    tally = reflection_and_transmission(
        medium, frequency(modulation), histories=400_000, seed=12
    )
    found, covariance = tally.part("reflected")
    assert_within(found[0], covariance[0], expected)


def test_stokes_fluxes_of_the_modulated_rayleigh_slab():
    # Natural light for I and Q, circular light for V; a negative R_V is the flip of
    # helicity.
    table = np.loadtxt(REFERENCE / "rayleigh_slab_modulated.csv", delimiter=",")
    names = ("R_I", "R_Q", "R_V", "T_I", "T_V")
    medium = slab(0.9, 1.0, ScatteringMatrix.rayleigh())
    modulation = table[:, 0]

    def column(name):
        first = 1 + 2 * names.index(name)
        return table[:, first] + 1j * table[:, first + 1]

    natural = reflection_and_transmission(
        medium, frequency(modulation), histories=600_000, seed=13
    )
    found, covariance = natural.part("reflected")
    assert_within(found[0], covariance[0], column("R_I"))
    assert_within(found[1], covariance[1], column("R_Q"))
    circular = reflection_and_transmission(
        medium, frequency(modulation), histories=600_000, seed=14, polarization="R"
    )
    found, covariance = circular.part("reflected")
    assert found[3, 0].real < -0.1
    assert_within(found[3], covariance[3], column("R_V"))
    found, covariance = circular.part("transmitted")
    assert_within(found[3], covariance[3], column("T_V"))


def test_oblique_rayleigh_slab_has_the_published_i_q_and_u():
    # Natraj, Li, Yung 2009, tau 0.5, mu0 0.2, over black; their first axis lies across
    # the meridian plane, so Q and U have the other sign.
    table = np.loadtxt(REFERENCE / "natraj_2009_rayleigh.csv", delimiter=",")
    black = table[table[:, 0] == 0][:, 1:]
    medium = slab(1.0, 0.5, ScatteringMatrix.rayleigh())
    outward = np.stack([np.pi - np.arccos(black[:, 0]), np.radians(black[:, 1])], -1)
    tally = reflection_and_transmission(
        medium, [0.0], histories=400_000, seed=15, incidence=np.arccos(0.2),
        outward=outward,
    )  # fmt: skip
    for k, row in enumerate(black):
        found, covariance = tally.part(f"direction {k + 1}")
        scale = 0.2 * np.pi / row[0]  # radiance per irradiance of pi
        error = np.sqrt(covariance[:3, 0, 0, 0]) * scale
        expected = np.array([1, -1, -1]) * row[2:]
        difference = found[:3, 0].real * scale - expected
        assert np.all(np.abs(difference) <= SIGMAS * error + 1e-7), difference / error
        # U is of the size of I, so a wrong sign is hundreds of errors off.
        assert np.all(error < 5e-3 * row[2] + 1e-5)


@pytest.mark.parametrize(
    "polarization", ["P", pytest.param("L", marks=pytest.mark.slow)]
)
def test_polarized_oblique_light_agrees_with_the_deterministic_solver(polarization):
    stokes = {"P": (1, 0, 1, 0), "L": (1, 0, 0, -1)}[polarization]
    field = plane_parallel.slab(
        plane_parallel_vector.rayleigh(), albedo=0.8, thickness=0.7, incidence=0.6,
        modulation=0.4, cosines=(0.3, 0.8), orders=3, nodes=24,
    )  # fmt: skip
    azimuth = np.radians([20.0, 130.0])
    expected = field.reflected_radiance(stokes, azimuth=azimuth)
    outward = [(np.pi - np.arccos(mu), phi) for mu in (0.3, 0.8) for phi in azimuth]
    medium = slab(0.8, 0.7, ScatteringMatrix.rayleigh())
    tally = reflection_and_transmission(
        medium, frequency([0.4]), histories=300_000, seed=16,
        incidence=np.arccos(0.6), polarization=polarization, outward=outward,
    )  # fmt: skip
    for k in range(4):
        found, covariance = tally.part(f"direction {k + 1}")
        mu = (0.3, 0.8)[k // 2]
        # Radiant intensity per light is radiance x mu per irradiance x mu0 of a plane.
        wanted = expected[k // 2, k % 2] * mu / 0.6
        assert_within(found[:, 0], covariance[:, 0], wanted)


def test_a_dark_layer_in_front_only_dims_and_delays():
    # Each direction loses exp(-a t (1 / mu0 + 1 / mu)) and gains that much path.
    function = henyey_greenstein_function(asymmetry=0.6)
    water = Layer(
        absorption=0.1, scattering=0.9, phase_function=function, thickness=1.4
    )
    dark = Layer(absorption=0.5, scattering=0.0, phase_function=function, thickness=0.8)
    x = frequency([0.0, 0.7])
    ways = [(np.pi - np.arccos(0.4), 0.3), (np.pi - np.arccos(0.9), 0.0)]
    plain, dimmed = (
        reflection_and_transmission(
            Medium.layered(layers, group_index=1.0), x, histories=100_000, seed=seed,
            outward=ways,
        )
        for layers, seed in (([water], 19), ([dark, water], 20))
    )  # fmt: skip
    for k, mu in enumerate((0.4, 0.9)):
        path = 0.8 * (1 + 1 / mu)
        change = np.exp(-0.5 * path + 1j * np.array([0.0, 0.7]) * path)
        a, covariance_a = plain.part(f"direction {k + 1}")
        b, covariance_b = dimmed.part(f"direction {k + 1}")
        spread = np.trace(covariance_a[0], axis1=-2, axis2=-1) * np.abs(change) ** 2
        # A turned covariance is bounded by its trace.
        bound = spread[:, None, None] * np.eye(2) + covariance_b[0]
        assert_within(b[0], bound, a[0] * change)


def test_two_halves_are_one_slab():
    whole = slab(0.9, 1.4, henyey_greenstein_function(asymmetry=0.6))
    function = henyey_greenstein_function(asymmetry=0.6)
    parts = [
        Layer(absorption=0.1, scattering=0.9, phase_function=function, thickness=t)
        for t in (0.3, 0.5, 0.6)
    ]
    layered = Medium.layered(parts, group_index=1.0)
    x = frequency([0.0, 0.7])
    one = reflection_and_transmission(whole, x, histories=300_000, seed=17)
    three = reflection_and_transmission(layered, x, histories=300_000, seed=18)
    for name in ("reflected", "transmitted"):
        a, covariance_a = one.part(name)
        b, covariance_b = three.part(name)
        assert_within(a[0], covariance_a[0] + covariance_b[0], b[0])


def reflectance_of_a_face(outside, index):
    """Fresnel reflectance of unpolarized light, in sines and tangents of the angles."""
    inside = np.arcsin(np.sin(outside) / index)
    less, more = outside - inside, outside + inside
    across = np.sin(less) / np.sin(more)
    along = np.tan(less) / np.tan(more)
    return (across**2 + along**2) / 2


def test_half_space_that_reflects_inside_has_the_published_albedo():
    # Giovanelli 1955: 0.2600 with the specular light; another code gives 0.25994.
    tally = reflection_and_transmission(
        slab(0.9, np.inf, isotropic()), [0.0], histories=600_000, seed=19,
        index_ratio=1.5,
    )  # fmt: skip
    found, covariance = tally.part("reflected")
    error = np.sqrt(covariance[0, 0, 0, 0])
    assert error < 8e-4
    assert abs(found[0, 0].real - 0.25994) < SIGMAS * error + 4e-4


@pytest.mark.parametrize("incidence", [0.3, 1.2])
def test_a_clear_slab_has_the_sum_of_all_reflections_between_its_faces(incidence):
    # Each crossing multiplies by t, and each later echo by r^2 t^2.
    index, modulation = 1.4, 0.7
    tally = reflection_and_transmission(
        slab(0.0, 1.0, isotropic()), frequency([0.0, modulation]),
        histories=200_000, seed=20, incidence=incidence, index_ratio=index,
    )  # fmt: skip
    face = reflectance_of_a_face(incidence, index)
    way = 1 / np.sqrt(1 - (np.sin(incidence) / index) ** 2)
    passed = np.exp((1j * np.array([0.0, modulation]) - 1) * way)
    echoes = 1 / (1 - (face * passed) ** 2)
    found, covariance = tally.part("transmitted")
    assert_within(found[0], covariance[0], (1 - face) ** 2 * passed * echoes)
    found, covariance = tally.part("reflected")
    back = face + (1 - face) ** 2 * face * passed**2 * echoes
    assert_within(found[0], covariance[0], back)


def test_no_light_is_lost_between_reflecting_faces():
    tally = reflection_and_transmission(
        slab(1.0, 3.0, henyey_greenstein_function(asymmetry=0.6)), [0.0],
        histories=20_000, seed=21, index_ratio=1.33, discs=[1.0, 2.0, 1e6],
    )  # fmt: skip
    reflected, transmitted, *discs = (
        tally.part(name)[0][0, 0].real for name in tally.parts
    )
    assert reflected + transmitted == pytest.approx(1, abs=1e-12)
    assert 0 < discs[0] < discs[1] < discs[2]
    assert discs[2] == pytest.approx(transmitted, abs=1e-12)


@pytest.mark.parametrize("radius", [1.5, 6.0])
def test_discs_hold_the_light_that_diffusion_brings_there(radius):
    # Twelve mean free paths thick and without absorption: the images of a source in
    # the depth of one path, mirrored at planes where the diffuse light would vanish.
    depth, beyond = 12.0, 0.7104
    tally = reflection_and_transmission(
        slab(1.0, depth, isotropic()), [0.0], histories=100_000, seed=22,
        discs=[radius],
    )  # fmt: skip
    order = np.arange(-60, 61)
    period = 2 * (depth + 2 * beyond)

    def inside(height):
        return 1 - 1 / np.sqrt(1 + (radius / height) ** 2)

    source = depth - (order * period + 1)
    image = depth - (order * period - 2 * beyond - 1)
    # A source of one photon sends the share of a half-sphere through the disc.
    share = (np.sign(source) * inside(source) - np.sign(image) * inside(image)).sum()
    found, covariance = tally.part("disc 1")
    error = np.sqrt(covariance[0, 0, 0, 0])
    # Diffusion itself is good to a few percent at this thickness.
    assert abs(found[0, 0].real - share / 2) < SIGMAS * error + 0.03 * share / 2
    assert error < 0.05 * share
