"""The narrow receiver against closed forms, plain loops and invariances."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import plain_photon_loops
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.constants import speed_of_light

from amulor.optics import small_angle_diffusion
from amulor.optics.phase_functions.mie import size_distribution
from amulor.optics.phase_functions.models import henyey_greenstein_function, isotropic
from amulor.optics.polarization import stokes
from amulor.transport import (
    DiscReceiver,
    GaussianReceiver,
    Layer,
    Medium,
    MeshTarget,
    PlaneTarget,
    ScatteringMatrix,
    Source,
    Technique,
    simulate,
)

# Statistics of photons: part of a study, not what a change elsewhere needs.
pytestmark = pytest.mark.slow

SIGMAS = 4.0  # one in 16,000 comparisons of a right result is beyond
INDEX = 1.33
FREQUENCY = np.array([0.0, 20e6, 60e6])
DISC = DiscReceiver(
    radius=0.05, acceptance_angle=np.radians(2), position=(0.07, 0.0, 0.0)
)


def water(absorption, scattering, phase_function):
    """Return water without bounds."""
    return Medium.homogeneous(
        absorption=absorption,
        scattering=scattering,
        phase_function=phase_function,
        group_index=INDEX,
    )


def sigmas(found, covariance, expected):
    """Return the distance of complex numbers in their own standard errors."""
    difference = np.asarray(found) - np.asarray(expected)
    pair = np.stack([difference.real, difference.imag], axis=-1)
    error = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    return np.abs(pair) / (error + 1e-12 * np.abs(found)[..., np.newaxis] + 1e-300)


def assert_agree(one, other):
    """Compare the signals of two runs by their standard errors."""
    distance = sigmas(one.signal, one.covariance + other.covariance, other.signal)
    assert np.all(distance <= SIGMAS), distance


def single_scattering(phase_function, attenuation, scattering):
    """Return singly scattered light of a pencil on the axis, by quadrature.

    Sum over the face of DISC and, from each of its points, over the depths that lie
    within the acceptance: no indicator is left in an integral.
    """
    wave = attenuation - 2j * np.pi * FREQUENCY * INDEX / speed_of_light
    node, weight = leggauss(48)
    total = np.zeros(FREQUENCY.size, dtype=complex)
    for r, wr in zip(0.025 * (node + 1), 0.025 * weight, strict=True):
        for angle, wa in zip(np.pi * (node + 1), np.pi * weight, strict=True):
            x, y = 0.07 + r * np.cos(angle), r * np.sin(angle)
            off = np.hypot(x, y)
            start = off / np.tan(np.radians(2))
            # Depths from start to 30 attenuation lengths on, in logarithms.
            edges = np.geomspace(start, start + 30 / attenuation, 9)
            for low, high in pairwise(edges):
                z = 0.5 * (low + high) + 0.5 * (high - low) * node
                way = np.hypot(z, off)
                theta = np.pi - np.arctan2(off, z)
                density = scattering * phase_function(theta) * z / way**3
                phasor = np.exp(-np.outer(wave, z + way))
                part = phasor @ (density * weight) * 0.5 * (high - low)
                total += part * r * wr * wa
    return total


@pytest.mark.study
def test_long_paths_that_end_by_roulette_leave_the_light():
    medium = water(0.02, 0.98, henyey_greenstein_function(asymmetry=0.7))
    receiver = DiscReceiver(radius=0.2, acceptance_angle=0.7, position=(0.1, 0, 0))
    target = PlaneTarget(position=(0, 0, 2.0), reflectance=0.5)
    one, other = (
        simulate(
            medium, Source(), receiver, FREQUENCY, histories=histories, seed=seed,
            target=target, technique=Technique(roulette=roulette),
        )
        for histories, seed, roulette in ((20_000, 1, 4), (8000, 2, 100_000))
    )  # fmt: skip
    assert_agree(one, other)
    for name in ("water, order 6", "water, order 10 and above", "target, scattered"):
        light, covariance = one.part(name)
        expected, error = other.part(name)
        assert np.sqrt(covariance[0, 0, 0, 0]) < 0.2 * abs(light[0, 0])
        distance = sigmas(light[0], covariance[0] + error[0], expected[0])
        assert np.all(distance <= SIGMAS), (name, distance)


@pytest.mark.parametrize("direct", [True, False])
def test_first_order_is_the_closed_form(direct):
    function = henyey_greenstein_function(asymmetry=0.8)
    tally = simulate(
        water(0.3, 0.5, function), Source(), DISC, FREQUENCY, histories=800_000,
        seed=1, technique=Technique(direct=direct),
    )  # fmt: skip
    found, covariance = tally.part("water, order 1")
    assert np.sqrt(covariance[0, 0, 0, 0]) < 6e-3 * abs(found[0, 0])
    expected = single_scattering(function, 0.8, 0.5)
    distance = sigmas(found[0], covariance[0], expected)
    assert np.all(distance <= SIGMAS), distance


def test_first_order_goes_over_into_the_small_angle_form():
    # Coaxial, far and narrow: what is left of the angles is of the order of the
    # acceptance squared, 0.16 %, and of the radius over the depth squared.
    receiver = GaussianReceiver(radius=0.02, acceptance_angle=0.04)
    tally = simulate(
        water(0.3, 0.2, isotropic()), Source(), receiver, FREQUENCY,
        histories=400_000, seed=2,
    )  # fmt: skip
    expected = small_angle_diffusion.water_response(
        FREQUENCY, absorption=0.5, forward_scattering=0.0, diffuse_scattering=0.0,
        second_moment=0.0, backscatter_vsf=0.2 / (4 * np.pi), group_index=INDEX,
        baseline=0.0, receiver_radius=0.02, acceptance_angle=0.04,
    )  # fmt: skip
    found, covariance = tally.part("water, order 1")
    error = np.sqrt(np.trace(covariance[0], axis1=-2, axis2=-1))
    assert np.all(error < 6e-3 * np.abs(expected))
    assert np.all(np.abs(found[0] - expected) < 4e-3 * np.abs(expected) + 4 * error)


def test_diffuse_target_in_dark_water_is_the_integral_over_the_face():
    # A pencil, a Lambertian plane 3 m away and water that only absorbs.
    target = PlaneTarget(position=(0, 0, 3.0), reflectance=0.6)
    receiver = DiscReceiver(
        radius=0.05, acceptance_angle=np.radians(4), position=(0.07, 0, 0)
    )
    tally = simulate(
        water(0.2, 0.0, isotropic()), Source(), receiver, FREQUENCY,
        histories=40_000, seed=3, target=target,
    )  # fmt: skip
    node, weight = leggauss(32)
    r, angle = np.meshgrid(0.025 * (node + 1), np.pi * (node + 1))
    area = np.outer(np.pi * weight, 0.025 * weight) * r
    way = np.sqrt((0.07 + r * np.cos(angle)) ** 2 + (r * np.sin(angle)) ** 2 + 9)
    wave = 0.2 - 2j * np.pi * FREQUENCY[:, None, None] * INDEX / speed_of_light
    expected = 0.6 / np.pi * np.sum(
        area * 9 / way**4 * np.exp(-wave * (3 + way)), axis=(1, 2)
    )  # fmt: skip
    distance = sigmas(tally.signal, tally.covariance, expected)
    assert tally.relative_error[0] < 0.02
    assert np.all(distance <= SIGMAS), distance
    assert np.all(np.abs(tally.water_signal) == 0)


def test_target_joined_through_shifted_paths_is_the_same():
    target = PlaneTarget(position=(0, 0, 2.0), reflectance=0.5)
    medium = water(0.2, 0.6, henyey_greenstein_function(asymmetry=0.9))
    receiver = DiscReceiver(radius=0.06, acceptance_angle=0.1, position=(0.1, 0, 0))
    runs = [
        simulate(
            medium, Source(), receiver, FREQUENCY, histories=200_000, seed=seed,
            target=target, technique=technique,
        )
        for seed, technique in (
            (4, None),
            (5, Technique(direct=False)),
            (6, Technique(paths=1, partners=1, stratified=False)),
        )
    ]  # fmt: skip
    for other in runs[1:]:
        assert_agree(runs[0], other)
        difference = runs[0].target_signal - other.target_signal
        error = np.sqrt(
            np.trace(
                runs[0].target_covariance + other.target_covariance, axis1=1, axis2=2
            )
        )
        assert np.all(np.abs(difference) < SIGMAS * error)
    assert abs(runs[0].target_signal[0]) > 3 * abs(runs[0].water_signal[0])


@pytest.mark.study
def test_a_far_target_whose_light_the_run_has_missed_is_flagged():
    # At 16 attenuation lengths the light of the target comes by paths scattered both
    # ways, which most runs of this size do not meet at all: what they have met is less
    # than a thousandth of the light, with an error that looks like 25 percent.
    medium = water(0.2, 0.8, henyey_greenstein_function(asymmetry=0.95))

    def runs(distance, number):
        target = PlaneTarget(position=(0, 0, distance), reflectance=0.3)
        return [
            simulate(
                medium, Source(), DISC, [0.0], histories=40_000, seed=seed,
                target=target,
            )
            for seed in range(number)
        ]  # fmt: skip

    far = runs(16.0, 16)
    light = np.array([tally.target_signal[0].real for tally in far])
    stated = np.array([tally.relative_error_of("target")[0] for tally in far])
    mean = light.mean()  # of 16 runs: far from exact, but of the right size
    assert np.any((light < 1e-3 * mean) & (stated < 0.3))
    assert all(tally.heavy_tail_of("target") for tally in far)
    assert all(tally.heavy_tailed for tally in far)
    # The light of the water outshines all of it, and has an error that holds.
    assert not any(tally.heavy_tail_of("water") for tally in far)
    assert not any(tally.heavy_tailed for tally in runs(1.5, 3))


def test_an_oblique_plane_far_in_dark_water_follows_its_cosine():
    # Light falls on a plane tilted by 40 degrees: radiance falls with the irradiance.
    angle = np.radians(40)
    normal = (np.sin(angle), 0.0, -np.cos(angle))
    receiver = DiscReceiver(radius=0.02, acceptance_angle=0.1)
    signals = [
        simulate(
            water(0.1, 0.0, isotropic()), Source(), receiver, [0.0], seed=7,
            histories=20_000,
            target=PlaneTarget(position=(0, 0, 3.0), normal=n, reflectance=0.5),
        )
        for n in ((0, 0, -1), normal)
    ]  # fmt: skip
    ratio = signals[1].signal[0].real / signals[0].signal[0].real
    # The face is 0.02 m wide at 3 m: the cosine is that of the axis within 1e-4.
    assert ratio == pytest.approx(np.cos(angle), rel=2e-3)


@pytest.mark.parametrize(
    "technique",
    [
        Technique(balanced=False),
        Technique(stratified=False),
        Technique(direct=False),
        Technique(paths=1, partners=1),
        Technique(paths=3, partners=17),
    ],
    ids=["unbalanced", "unstratified", "shifted only", "single", "uneven"],
)
def test_no_trick_moves_the_mean(peaked_runs, technique):
    medium, reference = peaked_runs
    other = simulate(
        medium, Source(), DISC, FREQUENCY, histories=150_000, seed=21,
        technique=technique,
    )  # fmt: skip
    assert_agree(reference, other)


@pytest.fixture(scope="module")
def peaked_runs():
    medium = water(0.2, 0.8, henyey_greenstein_function(asymmetry=0.95))
    return medium, simulate(
        medium, Source(), DISC, FREQUENCY, histories=600_000, seed=20
    )


def test_the_reference_case_has_the_published_light_and_cut_off(peaked_runs):
    _, tally = peaked_runs
    # 3.703e-7 +- 0.75 % by local estimates, and response over that at zero frequency.
    error = np.hypot(0.0075 * 3.703e-7, np.sqrt(tally.covariance[0, 0, 0]))
    assert abs(tally.signal[0] - 3.703e-7) < SIGMAS * error
    assert tally.relative_error[0] < 3e-3
    assert abs(tally.signal[1] / tally.signal[0]) == pytest.approx(0.745, abs=0.01)
    assert not tally.heavy_tailed


def test_wide_receiver_equals_chance_hits():
    # The plain loop counts photons that hit a disc of 0.5 m, whatever their angle.
    case = plain_photon_loops.Case(acceptance=np.pi / 2, radius=0.5, centre=0.07)
    plain = plain_photon_loops.chance_hits(case, histories=4_000_000, seed=5)
    medium = water(0.2, 0.8, henyey_greenstein_function(asymmetry=0.95))
    receiver = DiscReceiver(
        radius=0.5, acceptance_angle=np.pi / 2, position=(0.07, 0, 0)
    )
    tally = simulate(medium, Source(), receiver, [0.0], histories=200_000, seed=6)
    signal = plain.mean
    error = np.hypot(plain.standard_error, tally.relative_error[0] * signal)
    assert error < 0.012 * signal
    assert abs(tally.signal[0].real - signal) < SIGMAS * error


@pytest.mark.slow
def test_swapping_source_and_receiver_keeps_the_light():
    # P / (R gamma)^2 of the receiver = P / (w delta)^2 with the roles swapped; the
    # angles enter with their squares, 0.2 %.
    medium = water(0.2, 0.8, henyey_greenstein_function(asymmetry=0.9))
    ahead = simulate(
        medium, Source(radius=0.03, divergence=0.04),
        GaussianReceiver(radius=0.02, acceptance_angle=0.05, position=(0.1, 0, 0)),
        FREQUENCY, histories=600_000, seed=8,
    )  # fmt: skip
    back = simulate(
        medium, Source(radius=0.02, divergence=0.05),
        GaussianReceiver(radius=0.03, acceptance_angle=0.04, position=(0.1, 0, 0)),
        FREQUENCY, histories=600_000, seed=9,
    )  # fmt: skip
    one, other = ahead.signal / (0.02 * 0.05) ** 2, back.signal / (0.03 * 0.04) ** 2
    error = np.hypot(
        ahead.relative_error * np.abs(one), back.relative_error * np.abs(other)
    )
    assert np.all(error < 0.06 * np.abs(one))
    assert error[0] < 0.01 * abs(one[0])
    assert np.all(np.abs(one - other) < 3e-3 * np.abs(one) + SIGMAS * error)


def test_a_pair_turned_in_space_sees_the_same_water():
    medium = water(0.3, 0.7, henyey_greenstein_function(asymmetry=0.8))
    straight = simulate(medium, Source(), DISC, FREQUENCY, histories=200_000, seed=30)
    axis = np.array([0.2, 0.5, -0.6])
    axis /= np.linalg.norm(axis)
    right = np.array([1.0, 0, 0]) - axis[0] * axis
    right /= np.linalg.norm(right)
    turned = simulate(
        medium, Source(position=(1, 2, 3), direction=axis),
        DiscReceiver(
            radius=0.05, acceptance_angle=np.radians(2),
            position=np.array([1, 2, 3]) + 0.07 * right, direction=axis,
        ),
        FREQUENCY, histories=200_000, seed=30,
    )  # fmt: skip
    # The same random numbers in turned axes: rounding is all that differs.
    np.testing.assert_allclose(turned.signal, straight.signal, rtol=1e-5)


def test_equal_layers_are_homogeneous_water():
    function = henyey_greenstein_function(asymmetry=0.8)
    parts = [
        Layer(absorption=0.3, scattering=0.7, phase_function=function, thickness=t)
        for t in (0.7, 1.1)
    ]
    last = Layer(absorption=0.3, scattering=0.7, phase_function=function)
    layered = Medium.layered([*parts, last], group_index=INDEX, top=0.0)
    half = Medium.layered([last], group_index=INDEX, top=0.0)
    one = simulate(layered, Source(), DISC, FREQUENCY, histories=200_000, seed=31)
    other = simulate(half, Source(), DISC, FREQUENCY, histories=200_000, seed=32)
    assert_agree(one, other)
    # Looked at from the other side, with the layers in the other order.
    down = Medium.layered(
        [last_of(function, 50.0), *parts[::-1]], group_index=INDEX, top=-51.8
    )
    mirrored = simulate(
        down, Source(direction=(0, 0, -1)),
        DiscReceiver(
            radius=0.05, acceptance_angle=np.radians(2), position=(0.07, 0, 0),
            direction=(0, 0, -1),
        ),
        FREQUENCY, histories=200_000, seed=33,
    )  # fmt: skip
    assert_agree(one, mirrored)


def last_of(function, thickness):
    """Return a layer thick enough to be endless."""
    return Layer(
        absorption=0.3, scattering=0.7, phase_function=function, thickness=thickness
    )


def test_single_backscatter_of_small_spheres_keeps_h_and_flips_the_helicity():
    # Coaxial and narrow: reduced matrix diag(1, 1, -1, -1) for the first order.
    medium = water(0.5, 0.1, ScatteringMatrix.rayleigh())
    receiver = DiscReceiver(radius=0.02, acceptance_angle=0.02)
    signs = {"H": (1, 1.0), "V": (1, -1.0), "P": (2, -1.0), "R": (3, -1.0)}
    for launched, (component, sign) in signs.items():
        tally = simulate(
            medium, Source(polarization=launched), receiver, [0.0],
            histories=20_000, seed=40,
        )  # fmt: skip
        found, _ = tally.part("water, order 1")
        # Angles of up to 0.02 rad change the ratio by their square.
        assert found[component, 0].real / found[0, 0].real == pytest.approx(
            sign, abs=1e-3
        )


@pytest.mark.slow
def test_polarized_reciprocity():
    # Launched a, analysed b equals launched b', analysed a' with the places swapped,
    # where linear states keep their name and right and left change places.
    medium = water(0.3, 0.7, ScatteringMatrix.rayleigh())
    shape = {"radius": 0.03, "acceptance_angle": 0.1, "position": (0.15, 0, 0)}
    source = {"radius": 0.03, "divergence": 0.1}
    for (launched, analysed), (back_launched, back_analysed) in (
        (("H", "V"), ("V", "H")),
        (("R", "H"), ("H", "L")),
    ):
        ahead = simulate(
            medium, Source(polarization=launched, **source),
            GaussianReceiver(**shape), [0.0, 40e6], histories=300_000, seed=50,
        )  # fmt: skip
        back = simulate(
            medium, Source(polarization=back_launched, **source),
            GaussianReceiver(**shape), [0.0, 40e6], histories=300_000, seed=51,
        )  # fmt: skip
        one, covariance_one = ahead.detected(analysed)
        other, covariance_other = back.detected(back_analysed)
        error = np.sqrt(np.trace(covariance_one + covariance_other, axis1=1, axis2=2))
        assert np.all(np.abs(one - other) < SIGMAS * error + 5e-3 * np.abs(one))
        assert np.all(error < 0.1 * np.abs(one))


@pytest.mark.slow
def test_depolarization_grows_with_the_optical_thickness():
    receiver = DiscReceiver(radius=0.05, acceptance_angle=0.1, position=(0.07, 0, 0))
    degrees = []
    for scattering in (0.02, 1.5, 5.0):
        tally = simulate(
            water(0.15, scattering, ScatteringMatrix.rayleigh()),
            Source(polarization="H"), receiver, [0.0], histories=60_000, seed=60,
        )  # fmt: skip
        stokes = tally.stokes[0].real
        degrees.append(np.hypot(stokes[1], stokes[2]) / stokes[0])
    assert degrees[0] > 0.97
    assert degrees[0] > degrees[1] + 0.05
    assert degrees[1] > degrees[2] + 0.2


def test_polarized_transport_of_natural_light_by_a_diagonal_matrix_is_scalar():
    # With m12 = 0 the intensity knows nothing of the rest: the same random numbers
    # give the same light to the last digits.
    function = henyey_greenstein_function(asymmetry=0.9)
    angle = np.linspace(0, np.pi, 19)
    mueller = np.zeros((19, 4, 4))
    mueller[:] = np.diag([1.0, 0.9, 0.9, 0.8])
    matrix = ScatteringMatrix.tabulated(angle, mueller=mueller, phase_function=function)
    scalar = simulate(
        water(0.2, 0.8, function), Source(), DISC, FREQUENCY, histories=40_000, seed=70
    )
    full = simulate(
        water(0.2, 0.8, matrix), Source(), DISC, FREQUENCY, histories=40_000, seed=70
    )
    # The path turns about another axis of the frame, so only the law is the same.
    assert_agree(scalar, full)


@pytest.mark.study
def test_brute_force_on_a_wide_receiver_within_three_per_mille():
    case = plain_photon_loops.Case(acceptance=np.pi / 2, radius=0.5, centre=0.07)
    plain = plain_photon_loops.chance_hits(case, histories=60_000_000, seed=7)
    medium = water(0.2, 0.8, henyey_greenstein_function(asymmetry=0.95))
    receiver = DiscReceiver(
        radius=0.5, acceptance_angle=np.pi / 2, position=(0.07, 0, 0)
    )
    tally = simulate(medium, Source(), receiver, [0.0], histories=4_000_000, seed=8)
    signal = plain.mean
    error = np.hypot(plain.standard_error, tally.relative_error[0] * signal)
    assert error < 0.003 * signal
    assert abs(tally.signal[0].real - signal) < 3 * error


@pytest.mark.study
@pytest.mark.parametrize(
    "acceptance", [np.radians(2), np.pi / 2], ids=["narrow", "wide"]
)
def test_error_bars_hold_over_independent_seeds(acceptance):
    medium = water(0.2, 0.8, henyey_greenstein_function(asymmetry=0.95))
    receiver = DiscReceiver(
        radius=0.05, acceptance_angle=acceptance, position=(0.07, 0, 0)
    )
    truth = simulate(medium, Source(), receiver, FREQUENCY, histories=8_000_000, seed=1)
    score = []
    for seed in range(100, 300):
        tally = simulate(
            medium, Source(), receiver, FREQUENCY, histories=16_000, seed=seed
        )
        error = np.sqrt(np.diagonal(tally.covariance, axis1=1, axis2=2))
        difference = tally.signal - truth.signal
        score.append(
            np.stack([difference.real, difference.imag], -1) / (error + 1e-300)
        )
    score = np.array(score)[:, [0, 1, 1, 2, 2], [0, 0, 1, 0, 1]]
    # 200 seeds: a standard deviation of 1 is found within 5 %, a mean within 0.07.
    assert np.all(np.abs(score.mean(axis=0)) < 0.25)
    assert np.all(np.abs(score.std(axis=0) - 1) < 0.16)
    inside = np.mean(np.abs(score) < 1, axis=0)
    assert np.all(np.abs(inside - 0.683) < 0.11)


def test_one_run_serves_water_that_absorbs_more():
    function = henyey_greenstein_function(asymmetry=0.8)
    clear = simulate(
        water(0.1, 0.5, function), Source(), DISC, FREQUENCY, histories=300_000,
        seed=80, keep_record=True,
    )  # fmt: skip
    dark = simulate(
        water(0.25, 0.5, function), Source(), DISC, FREQUENCY, histories=300_000,
        seed=81,
    )  # fmt: skip
    found = clear.record.stokes(FREQUENCY, group_index=INDEX, more_absorption=0.15)
    # Path lengths count as that of their bin: 3e-4 at the highest frequency.
    error = clear.relative_error * np.abs(clear.signal) + dark.relative_error * np.abs(
        dark.signal
    )
    assert error[0] < 0.03 * abs(dark.signal[0])
    assert np.all(np.abs(found[:, 0] - dark.signal) < SIGMAS * error)
    assert abs(dark.signal[0]) < 0.7 * abs(clear.signal[0])


@pytest.mark.parametrize("shape", ["plane", "mesh"])
@pytest.mark.parametrize("launched", ["H", "P", "R"])
def test_what_a_target_does_to_polarization_does_not_turn_with_the_receiver(
    launched, shape
):
    # The light of a small spot, seen under 10 degrees: its matrix acts in the scene's
    # axes, so the degrees of polarization are those of the matrix times the light.
    matrix = np.diag([1.0, 0.6, -0.2, -0.3])
    target = PlaneTarget(position=(0, 0, 2), reflectance=0.5, mueller=matrix)
    if shape == "mesh":
        target = MeshTarget(
            vertices=[[-9, -9, 2], [9, -9, 2], [0, 9, 2]], faces=[[0, 1, 2]],
            reflectance=0.5, mueller=matrix,
        )  # fmt: skip
    expected = matrix @ stokes.state(launched)
    tan = np.tan(np.radians(40)) / np.sqrt(2)
    for direction in ((0, 0, 1), (tan, tan, 1), (-tan, tan, 1), (tan, -tan, 1)):
        tally = simulate(
            water(0.2, 0.0, ScatteringMatrix.rayleigh()),
            Source(polarization=launched),
            DiscReceiver(
                radius=0.01, acceptance_angle=1.0, position=(0.35, 0, 0),
                direction=direction,
            ),
            [0.0], histories=2000, seed=4, target=target,
            technique=Technique(direct=True),
        )  # fmt: skip
        light = tally.stokes[0].real
        assert light[0] > 0
        linear = np.hypot(light[1], light[2]) / light[0]
        # The face is 0.01 m wide at 2 m: angles change by 0.3 degrees over it.
        assert linear == pytest.approx(np.hypot(*expected[1:3]), abs=2e-3)
        assert light[3] / light[0] == pytest.approx(expected[3], abs=2e-3)


@pytest.mark.parametrize("diameter", [3e-6, 10e-6, 20e-6, 40e-6])
def test_light_straight_back_from_large_spheres_is_the_quadrature(diameter):
    # Coaxial pencil of circular light: the face sees scattering angles within 8.7 mrad
    # of 180 degrees, where a sphere of 40 um has lobes of 4 mrad.
    pytest.importorskip("miepython")
    suspension = size_distribution(
        np.array([diameter]), number=np.array([1e8]), wavelength=405e-9,
        particle_index=1.59, medium_index=1.34,
    )  # fmt: skip
    radius, acceptance = 0.01, 8.7e-3
    tally = simulate(
        water(0.5, 0.1, ScatteringMatrix.spheres(suspension)),
        Source(polarization="R"),
        DiscReceiver(radius=radius, acceptance_angle=acceptance), [0.0],
        histories=60_000, seed=50,
    )  # fmt: skip
    # Over rings of the face, and for each over the depths from which it is seen, by
    # the angle delta to the axis: z = r / tan delta.
    node, weight = leggauss(400)
    expected = np.zeros(2)
    for r, wr in zip(radius / 2 * (node + 1), radius / 2 * weight, strict=True):
        farthest = 40.0
        low = np.arctan2(r, farthest)
        half = 0.5 * (acceptance - low)
        if half <= 0:
            continue
        delta = low + half * (node + 1)
        z, way = r / np.tan(delta), r / np.sin(delta)
        theta = np.pi - delta
        matrix = suspension.mueller(theta)
        density = 0.1 * suspension.phase_function(theta) * np.exp(-0.6 * (z + way))
        # dz = r d(delta) / sin^2, and z / way^3 r dr is the solid angle of the ring.
        kernel = density * z / way**3 * r / np.sin(delta) ** 2
        ring = 2 * np.pi * r * wr * half
        expected[0] += ring * (kernel @ weight)
        expected[1] += ring * (kernel * matrix[:, 3, 3] @ weight)
    found, covariance = tally.part("water, order 1")
    error = np.sqrt(covariance[0, 0, 0, 0])
    assert error < 0.01 * expected[0]
    assert abs(found[0, 0].real - expected[0]) < SIGMAS * error + 1e-3 * expected[0]
    # The same paths carry both, so their ratio is surer than either of them.
    ratio = found[3, 0].real / found[0, 0].real
    assert ratio == pytest.approx(expected[1] / expected[0], abs=0.02)


def test_spheres_far_below_the_wavelength_are_rayleigh_scatterers():
    pytest.importorskip("miepython")
    suspension = size_distribution(
        np.array([8e-9]), number=np.array([1e20]), wavelength=405e-9,
        particle_index=1.5, medium_index=1.34,
    )  # fmt: skip
    receiver = DiscReceiver(radius=0.05, acceptance_angle=0.2, position=(0.07, 0, 0))
    runs = [
        simulate(
            water(0.3, 0.7, matrix), Source(polarization=(1, 0.6, 0, 0.8)), receiver,
            [0.0], histories=150_000, seed=seed,
        )
        for seed, matrix in (
            (82, ScatteringMatrix.rayleigh()),
            (83, ScatteringMatrix.spheres(suspension)),
        )
    ]  # fmt: skip
    assert_agree(*runs)
    for analyser in ("H", "P", "R", "L"):
        one, covariance_one = runs[0].detected(analyser)
        other, covariance_other = runs[1].detected(analyser)
        error = np.sqrt(covariance_one[0, 0, 0] + covariance_other[0, 0, 0])
        assert error < 0.05 * abs(runs[0].signal[0])
        assert abs(one[0] - other[0]) < SIGMAS * error
