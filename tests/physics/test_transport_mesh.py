"""Targets of triangles against planes, closed forms and a plain loop of chance hits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bouncing_photons import chance_hits
from numpy.polynomial.legendre import leggauss
from scipy.constants import speed_of_light

from amulor.optics.phase_functions.models import henyey_greenstein_function, isotropic
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

SIGMAS = 4.0  # one in 16,000 comparisons of a right result is beyond
INDEX = 1.33
FREQUENCY = np.array([0.0, 20e6, 60e6])


def water(absorption, scattering, phase_function):
    """Return water without bounds."""
    return Medium.homogeneous(
        absorption=absorption,
        scattering=scattering,
        phase_function=phase_function,
        group_index=INDEX,
    )


def plates(rectangles, reflectance, mueller=None):
    """Return a mesh of rectangles, given as centre and two half sides."""
    vertices, faces = [], []
    for centre, one, two in np.array(rectangles, dtype=float):
        k = len(vertices)
        vertices += [
            centre - one - two, centre + one - two, centre + one + two,
            centre - one + two,
        ]  # fmt: skip
        faces += [[k, k + 1, k + 2], [k, k + 2, k + 3]]
    return MeshTarget(
        vertices=vertices, faces=faces, reflectance=reflectance, mueller=mueller
    )


def big_plate(position, normal, reflectance, mueller=None):
    """Return a square of 400 m instead of a plane."""
    normal = np.array(normal) / np.linalg.norm(normal)
    one = np.cross(normal, [0.3, 0.9, 0.1])
    one /= np.linalg.norm(one)
    two = np.cross(normal, one)
    return plates([(position, 200 * one, 200 * two)], reflectance, mueller)


def distance(one, covariance_one, other, covariance_other):
    """Return the difference of complex numbers in their standard errors."""
    difference = np.asarray(one) - np.asarray(other)
    pair = np.stack([difference.real, difference.imag], axis=-1)
    covariance = covariance_one + covariance_other
    error = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    return np.abs(pair) / (error + 1e-12 * np.abs(one)[..., np.newaxis] + 1e-300)


def assert_agree(one, other):
    """Compare light of water and target of two runs by their standard errors."""
    for kind in ("water", "target"):
        found = [getattr(run, f"{kind}_signal") for run in (one, other)]
        error = [getattr(run, f"{kind}_covariance") for run in (one, other)]
        off = distance(found[0], error[0], found[1], error[1])
        assert np.all(off <= SIGMAS), (kind, off)


# One plate to be lit, and one that hides much of it and of the water.
SCENE = np.array(
    [
        ((0.0, 0, 1.2), (0.8, 0, 0.2), (0, 0.8, 0)),
        ((0.6, 0.1, 0.4), (0.5, 0, 0.1), (0, 0.5, 0)),
    ]
)
UPRIGHT = np.eye(3)
OBLIQUE = (np.sin(0.7), 0.2, -np.cos(0.7))


@pytest.mark.parametrize("normal", [(0, 0, -1), OBLIQUE], ids=["facing", "oblique"])
@pytest.mark.parametrize(
    "direct",
    [True, pytest.param(False, marks=pytest.mark.slow)],
    ids=["local estimate", "shifted"],
)
def test_two_large_triangles_are_a_plane(normal, direct):
    medium = water(0.2, 0.6, henyey_greenstein_function(asymmetry=0.9))
    receiver = DiscReceiver(radius=0.06, acceptance_angle=0.15, position=(0.1, 0, 0))
    runs = [
        simulate(
            medium, Source(), receiver, FREQUENCY, histories=200_000, seed=seed,
            target=target, technique=Technique(direct=direct),
        )
        for seed, target in (
            (1, PlaneTarget(position=(0, 0, 2.0), normal=normal, reflectance=0.5)),
            (2, big_plate((0, 0, 2.0), normal, 0.5)),
        )
    ]  # fmt: skip
    assert_agree(*runs)
    assert max(run.relative_error[0] for run in runs) < 0.012
    assert abs(runs[0].target_signal[0]) > abs(runs[0].water_signal[0])


def test_two_large_triangles_reflect_stokes_vectors_as_a_plane():
    matrix = np.diag([1.0, 0.8, -0.8, -0.7])
    receiver = GaussianReceiver(radius=0.06, acceptance_angle=0.2, position=(0.1, 0, 0))
    runs = [
        simulate(
            water(0.2, 0.4, ScatteringMatrix.rayleigh()),
            Source(polarization=(1, 0.6, 0.5, 0.5)), receiver, FREQUENCY,
            histories=200_000, seed=seed, target=target,
        )
        for seed, target in (
            (3, PlaneTarget(
                position=(0, 0, 1.0), normal=OBLIQUE, reflectance=0.5, mueller=matrix
            )),
            (4, big_plate((0, 0, 1.0), OBLIQUE, 0.5, matrix)),
        )
    ]  # fmt: skip
    for part, accuracy in (("target", 0.01), ("target, scattered", 0.06)):
        (one, error_one), (other, error_other) = (run.part(part) for run in runs)
        off = distance(one, error_one, other, error_other)
        assert np.all(off <= SIGMAS), off
        assert np.sqrt(error_other[0, 0, 0, 0]) < accuracy * abs(other[0, 0])
    polarized = runs[1].part("target")[0][:, 0].real
    assert np.all(np.abs(polarized[1:]) > 0.2 * polarized[0])


def test_a_plate_that_hides_half_of_the_face_leaves_the_integral_over_the_rest():
    # A pencil meets the farther plate at (0, 0, 3). The nearer one, half way, has its
    # edge at x = 0.035 m: from there the half of the face beyond x = 0.07 m is hidden.
    far = ((0, 0, 3.0), (5, 0, 0), (0, 5, 0))
    near = ((2.035, 0, 1.5), (2, 0, 0), (0, 5, 0))
    receiver = DiscReceiver(
        radius=0.05, acceptance_angle=np.radians(4), position=(0.07, 0, 0)
    )
    node, weight = leggauss(32)
    r, angle = np.meshgrid(0.025 * (node + 1), np.pi / 2 * node + np.pi)
    area = np.outer(np.pi / 2 * weight, 0.025 * weight) * r
    way = np.sqrt((0.07 + r * np.cos(angle)) ** 2 + (r * np.sin(angle)) ** 2 + 9)
    wave = 0.2 - 2j * np.pi * FREQUENCY[:, None, None] * INDEX / speed_of_light
    expected = 0.6 / np.pi * np.sum(
        area * 9 / way**4 * np.exp(-wave * (3 + way)), axis=(1, 2)
    )  # fmt: skip
    for direct, histories in ((True, 40_000), (False, 400_000)):
        tally = simulate(
            water(0.2, 0.0, isotropic()), Source(), receiver, FREQUENCY,
            histories=histories, seed=5, target=plates([far, near], 0.6),
            technique=Technique(direct=direct),
        )  # fmt: skip
        found, covariance = tally.part("target")
        off = distance(found[0], covariance[0], expected, 0.0)
        assert np.sqrt(covariance[0, 0, 0, 0]) < 0.02 * abs(found[0, 0])
        assert np.all(off <= SIGMAS), off
        assert np.all(tally.water_signal == 0)


def assert_chance_hits_agree(tally, light):
    """Compare the light without and with a touch to that of the plain loop."""
    size = light.shape[1]
    for kind, values in zip(("water", "target"), light, strict=True):
        mean = values.mean(axis=0)
        pair = np.stack([values.real, values.imag], axis=-1) - np.stack(
            [mean.real, mean.imag], axis=-1
        )
        covariance = np.einsum("hfi,hfj->fij", pair, pair) / size**2
        off = distance(
            getattr(tally, f"{kind}_signal"), getattr(tally, f"{kind}_covariance"),
            mean, covariance,
        )  # fmt: skip
        assert np.all(off <= SIGMAS), (kind, off)


BOXES = {
    "alike": ({"reflectance": 0.9}, 0.0, 0.7),
    "walls of a tank": ({"reflectance": (0.9, 0.2, 0.6, 0.0, 0.8)}, 0.4, 0.7),
    "glossy": (
        {"reflectance": (0.4, 0.2, 0.4, 0.1, 0.3), "gloss": 0.5, "slope": 0.3}, 0.2, 0.7
    ),
    "glossy, narrow": (
        {"reflectance": (0.4, 0.2, 0.4, 0.1, 0.3), "gloss": 0.5, "slope": 0.3}, 0.2, 0.3
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", BOXES)
def test_light_from_an_open_box_is_that_of_a_plain_loop_over_bounces(case):
    # Five walls, open towards the receiver; a slant beam meets the right one first.
    box = [
        ((0.4, 0, 1.5), (0, 0.4, 0), (0, 0, 0.5)),
        ((-0.4, 0, 1.5), (0, 0.4, 0), (0, 0, 0.5)),
        ((0, 0.4, 1.5), (0.4, 0, 0), (0, 0, 0.5)),
        ((0, -0.4, 1.5), (0.4, 0, 0), (0, 0, 0.5)),
        ((0, 0, 2.0), (0.4, 0, 0), (0, 0.4, 0)),
    ]
    surface, scattering, acceptance = BOXES[case]
    place = {
        "position": (0, 0, 0), "direction": (0.4, 0.1, 1.6), "receiver": (0.1, 0),
        "radius": 0.5, "acceptance": acceptance, "seed": 6,
    }  # fmt: skip
    light = chance_hits(
        box, FREQUENCY, absorption=0.1, scattering=scattering, index=INDEX,
        case=place, histories=300_000, **surface,
    )  # fmt: skip
    each = np.broadcast_to(surface["reflectance"], 5)
    target = replace(
        plates(box, each.max()), texture=np.repeat(each, 2) / each.max(),
        gloss=surface.get("gloss", 0.0), rms_slope=surface.get("slope", 0.0),
    )  # fmt: skip
    tally = simulate(
        water(0.1, scattering, isotropic()), Source(direction=place["direction"]),
        DiscReceiver(radius=0.5, acceptance_angle=acceptance, position=(0.1, 0, 0)),
        FREQUENCY, histories=150_000, seed=7, target=target,
    )  # fmt: skip
    assert tally.relative_error[0] < 0.015
    once = abs(tally.part("target")[0][0, 0])
    assert once < 0.8 * abs(tally.signal[0])  # the rest met more than one wall
    assert_chance_hits_agree(tally, light)


@pytest.mark.parametrize(
    "acceptance",
    [0.8, pytest.param(0.34, marks=pytest.mark.slow)],
    ids=["wide", "narrow"],
)
def test_plates_in_scattering_water_hide_and_reflect_as_in_a_plain_loop(acceptance):
    case = {
        "position": (0, 0, 0), "direction": (0, 0, 1), "receiver": (0.4, 0),
        "radius": 0.4, "acceptance": acceptance, "seed": 8,
    }  # fmt: skip
    light = chance_hits(
        SCENE, FREQUENCY, reflectance=0.7, absorption=0.3, scattering=1.0, index=INDEX,
        case=case, histories=400_000,
    )  # fmt: skip
    receiver = DiscReceiver(
        radius=0.4, acceptance_angle=acceptance, position=(0.4, 0, 0)
    )
    runs = [
        simulate(
            water(0.3, 1.0, isotropic()), Source(), receiver, FREQUENCY,
            histories=100_000, seed=9, target=target,
            technique=Technique(direct=direct),
        )
        for target, direct in (
            (plates(SCENE[:1], 0.7), False),
            (plates(SCENE, 0.7), False),
            (plates(SCENE, 0.7), True),
        )[: 2 if acceptance > 0.35 else 3]  # wider, a local estimate has a heavy tail
    ]  # fmt: skip
    for tally in runs[1:]:
        assert tally.relative_error[0] < 0.01
        assert_chance_hits_agree(tally, light)
        for kind in ("water_signal", "target_signal"):  # what the second plate hides
            one, other = (getattr(run, kind)[0] for run in (tally, runs[0]))
            assert abs(one) < 0.9 * abs(other)


#: Joins all pairs: a sample of them would depend on rounding.
ALL_PAIRS = Technique(reflections=10**9)


def in_scene(
    target, medium=None, *, position=(0.0, 0, 0), axes=UPRIGHT, technique=ALL_PAIRS
):
    """Simulate a narrow receiver before two plates, one before the other."""
    return simulate(
        medium or water(0.3, 1.0, henyey_greenstein_function(asymmetry=0.8)),
        Source(position=position, direction=axes[2]),
        DiscReceiver(
            radius=0.1, acceptance_angle=0.2, direction=axes[2],
            position=np.array(position) + 0.3 * axes[0],
        ),
        FREQUENCY, histories=20_000, seed=11, target=target, technique=technique,
    )  # fmt: skip


def test_a_whole_scene_may_be_turned_and_moved():
    forward = np.array([0.2, 0.5, -0.6])
    forward /= np.linalg.norm(forward)
    right = np.array([1.0, 0, 0]) - forward[0] * forward
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])
    position = np.array([1.0, -2.0, 3.0])
    moved = SCENE @ axes
    moved[:, 0] += position
    straight = in_scene(plates(SCENE, 0.7))
    turned = in_scene(plates(moved, 0.7), position=position, axes=axes)
    # The same random numbers in turned axes: rounding is all that differs.
    np.testing.assert_allclose(turned.signal, straight.signal, rtol=1e-6)


def test_the_order_and_number_of_triangles_do_not_matter():
    whole = plates(SCENE, 0.7)
    corner = whole.corners[::-1, [0, 2, 1]]
    middle = 0.5 * (corner + np.roll(corner, -1, axis=1))
    smaller = np.concatenate(
        [np.stack([corner[:, k], middle[:, k], middle[:, k - 1]], 1) for k in range(3)]
        + [middle]
    )
    parts = MeshTarget(
        vertices=smaller.reshape(-1, 3),
        faces=np.arange(3 * len(smaller)).reshape(-1, 3),
        reflectance=0.7,
    )
    np.testing.assert_allclose(
        in_scene(parts).signal, in_scene(whole).signal, rtol=1e-6
    )


@pytest.mark.parametrize("kind", ["plane", "mesh"])
def test_a_target_in_equal_layers_is_one_in_homogeneous_water(kind):
    function = henyey_greenstein_function(asymmetry=0.8)

    def layer(thickness=np.inf):
        return Layer(
            absorption=0.3, scattering=1.0, phase_function=function, thickness=thickness
        )

    layered = Medium.layered(
        [layer(0.3), layer(0.5), layer()], group_index=INDEX, top=0.0
    )
    half = Medium.layered([layer()], group_index=INDEX, top=0.0)
    target = plates(SCENE, 0.7)
    if kind == "plane":
        target = PlaneTarget(position=(0, 0, 1.2), normal=OBLIQUE, reflectance=0.7)
    runs = [
        in_scene(target, medium, technique=replace(ALL_PAIRS, direct=False))
        for medium in (layered, half)
    ]
    assert_agree(*runs)
    if kind == "plane":
        # The same paths, cut where they go from layer to layer. Light of a range of
        # lengths below 0.05 of a bin is put at one length, which is off by 1e-4 of it.
        np.testing.assert_allclose(runs[0].signal, runs[1].signal, rtol=1e-4)


@pytest.mark.study
def test_light_around_a_plate_is_within_its_error_or_flagged():
    # A receiver that looks past a lit plate at the water behind it: light of the plate
    # comes by a second scattering only, from some ten of 3750 groups. Unflagged runs
    # lay beyond 4 standard errors in 30 %.
    clear = water(0.15, 0.35, henyey_greenstein_function(asymmetry=0.95))
    plate = plates([((0, 0, 1.0), (0.15, 0, 0), (0, 0.15, 0))], 0.3)
    towards = np.array([0.1, 0, 2.0]) - np.array([0.4, 0, 0])
    receiver = GaussianReceiver(
        position=(0.4, 0, 0),
        direction=towards / np.linalg.norm(towards),
        radius=0.02,
        acceptance_angle=0.08,
    )

    def run(histories, seed):
        return simulate(
            clear,
            Source(),
            receiver,
            [0.0],
            histories=histories,
            seed=seed,
            target=plate,
        )

    truth = run(2_000_000, 999)
    assert truth.relative_error_of("target")[0] < 0.1
    for histories in (30_000, 240_000):
        off, flagged = {"water": [], "target": []}, {"water": 0, "target": 0}
        for seed in range(12):
            found = run(histories, seed)
            for kind in off:
                if found.heavy_tail_of(kind):
                    flagged[kind] += 1
                    continue
                one, other = (
                    (
                        getattr(each, f"{kind}_signal"),
                        getattr(each, f"{kind}_covariance"),
                    )
                    for each in (found, truth)
                )
                off[kind].append(distance(*one, *other)[0, 0])
        assert max([0.0, *off["water"], *off["target"]]) < SIGMAS
        # What is known is not flagged for that.
        assert histories < 100_000 or flagged["water"] == 0
        assert histories > 100_000 or flagged["target"] >= 10


@pytest.mark.slow
def test_a_small_plate_close_by_is_not_known_before_its_rare_light_has_come():
    # Of 48 runs these three miss up to a fourth of the light of a plate of 10 cm. They
    # lie 4 to 7 standard errors off: few contributions, but alike.
    clear = water(0.15, 0.35, henyey_greenstein_function(asymmetry=0.95))
    towards = np.array([-0.4 / 2.86, 0, 1.0])
    receiver = GaussianReceiver(
        position=(0.4, 0, 0),
        direction=towards / np.linalg.norm(towards),
        radius=0.02,
        acceptance_angle=0.2,
    )

    def run(histories, seed, half, distance):
        plate = plates([((0, 0, distance), (half, 0, 0), (0, half, 0))], 0.3)
        return simulate(
            clear, Source(), receiver, [0.0], histories=histories, seed=seed,
            target=plate,
        )  # fmt: skip

    truth = run(1_000_000, 999, 0.05, 0.8)
    assert truth.relative_error_of("target")[0] < 0.04
    off = []
    for seed in (4, 28, 36):
        found = run(30_000, seed, 0.05, 0.8)
        assert found.heavy_tail_of("target")
        assert not found.heavy_tail_of("water")
        off.append(
            distance(
                found.target_signal, found.target_covariance,
                truth.target_signal, truth.target_covariance,
            )[0, 0]
        )  # fmt: skip
    assert min(off) > 3.5
    # A large one is known from as many.
    assert not run(30_000, 0, 1.0, 2.0).heavy_tailed
