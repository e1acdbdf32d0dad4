"""A transport problem in the coordinates of its receiver, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from layered_water import EVEN, PEAKED, TILTED, layers, plate
from numpy.testing import assert_allclose

from amulor.transport import (
    DiscReceiver,
    GaussianReceiver,
    Layer,
    Medium,
    MeshTarget,
    ScatteringMatrix,
    Source,
)
from amulor.transport._checks import axes_of
from amulor.transport._problem import Problem, water_tables

DISC = DiscReceiver(radius=0.05, acceptance_angle=0.1)


def water(**changes):
    values = {"absorption": 0.2, "scattering": 0.8, "phase_function": PEAKED} | changes
    return Medium.homogeneous(group_index=1.33, **values)


def problem(**changes):
    parts = {
        "medium": water(),
        "source": Source(),
        "receiver": DISC,
        "target": None,
    } | changes
    return Problem(**parts)


def test_tables_of_the_water_are_shared_by_layers_of_one_function():
    kinds = [(0.2, 0.4, PEAKED), (0.3, 0.1, EVEN), (0.0, 0.0, PEAKED), (1.0, 0.5, EVEN)]
    stack = tuple(
        Layer(absorption=a, scattering=b, phase_function=p, thickness=1.0)
        for a, b, p in kinds
    )
    edges = np.arange(5.0)
    tables = water_tables(stack, edges)
    assert tables.edge is edges
    assert tables.table.tolist() == [0, 1, 0, 1]
    assert tables.table.dtype == np.int64
    assert_allclose(tables.attenuation, [0.6, 0.4, 0.0, 1.5])
    assert_allclose(tables.albedo, [2 / 3, 0.25, 0.0, 1 / 3])
    assert len(tables.urn) == len(tables.value) == len(tables.element) == 2
    assert not tables.element.any()
    # Isotropic scattering has 1 / 4 pi in each cell, that of the other is peaked.
    assert_allclose(tables.value[1], 0.25 / np.pi, rtol=1e-9)
    assert tables.value[0, 0] > 100 * tables.value[0, -1]
    assert tables.score.shape == (0, 4, tables.value.shape[1])


def test_elements_of_a_matrix_are_those_of_its_layer():
    matrix = ScatteringMatrix.rayleigh()
    layer = Layer(absorption=0.1, scattering=0.1, phase_function=matrix)
    element = water_tables((layer,), np.array([-np.inf, np.inf])).element[0]
    # Rayleigh: m12 from 0 to -1 at a right angle, m33 from 1 to -1.
    assert_allclose(element[0], [0, 1, 1, 0, 1], atol=1e-4)
    assert_allclose(element[-1], [0, 1, -1, 0, -1], atol=1e-4)
    assert element[:, 0].min() == pytest.approx(-1, abs=1e-3)


def test_a_problem_is_turned_into_the_axes_of_its_receiver():
    axes = axes_of(TILTED, name="direction")
    place = np.array([0.3, -0.2, 0.5])
    receiver = GaussianReceiver(
        radius=0.04, acceptance_angle=0.2, position=place, direction=3 * TILTED
    )
    source = Source(
        position=(0.1, 0.2, -0.4), direction=(0, 0.6, 0.8), radius=0.01,
        divergence=0.02, polarization=(1, 0.1, 0.2, 0.3),
    )  # fmt: skip
    target = plate(
        position=(0, 1, 3), normal=(0.6, 0, -0.8), reflectance=0.3, gloss=0.2,
        rms_slope=0.1, mueller=np.diag([1, 0.5, 0.25, 0.125]),
    )  # fmt: skip
    matrix = ScatteringMatrix.rayleigh(cells=64)
    found = problem(
        medium=water(phase_function=matrix), source=source, receiver=receiver,
        target=target,
    )  # fmt: skip
    beam, face, surface = found.beam, found.face, found.surface
    assert_allclose(beam.centre, axes @ (np.array([0.1, 0.2, -0.4]) - place))
    assert_allclose(beam.axis, axes @ (0, 0.6, 0.8), atol=1e-15)
    assert_allclose(beam.across, axes @ (1, 0, 0), atol=1e-15)
    assert (beam.radius, beam.divergence) == (0.01, 0.02)
    assert beam.stokes.tolist() == [1, 0.1, 0.2, 0.3]
    assert face[:3] == (0.04, 0.2, True)
    assert not DISC_PROBLEM.face.gaussian
    assert surface.has_plane
    assert_allclose(surface.normal, axes @ (0.6, 0, -0.8), atol=1e-15)
    height = np.array([0.6, 0, -0.8]) @ (np.array([0, 1, 3]) - place)
    assert surface.height == pytest.approx(height)
    assert (surface.reflectance, surface.gloss, surface.slope) == (0.3, 0.2, 0.1)
    assert np.diagonal(surface.mueller).tolist() == [1, 0.5, 0.25, 0.125]
    assert_allclose(surface.right, axes[:, 0], atol=1e-15)
    assert len(surface.mesh.triangle) == 0
    for one, other in zip(found.scene, (beam, found.face, found.water, surface),
                          strict=True):  # fmt: skip
        assert one is other


DISC_PROBLEM = problem()


def test_without_a_target_nothing_reflects():
    surface = DISC_PROBLEM.surface
    assert not surface.has_plane
    assert (surface.reflectance, surface.gloss) == (0, 0)
    assert (surface.normal.tolist(), surface.height) == ([0, 0, -1], 0)
    assert not surface.mueller.any()
    assert len(surface.mesh.triangle) == 0
    assert problem(target=plate()).surface.slope == 1  # no facets to divide by


def test_triangles_keep_their_texture_in_the_axes_of_the_receiver():
    texture = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    x = np.array([3.0, -1, 2, -3, 0.5])
    corner = np.zeros((5, 3, 3))
    corner[:, :, 0] = x[:, None] + [0, 0.1, 0]
    corner[:, :, 1] = [0, 0, 0.1]
    corner[:, :, 2] = 2.0
    mesh = MeshTarget(
        vertices=corner.reshape(-1, 3), faces=np.arange(15).reshape(5, 3),
        reflectance=0.6, texture=texture,
    )  # fmt: skip
    place = np.array([0.2, 0.0, 0.5])
    receiver = DiscReceiver(radius=0.05, acceptance_angle=0.1, position=place)
    surface = problem(receiver=receiver, target=mesh).surface
    assert not surface.has_plane
    found = dict(zip(surface.mesh.triangle[:, 0] + 0.2, surface.mesh.texture,
                     strict=True))  # fmt: skip
    assert sorted(found) == pytest.approx(sorted(x))
    for value, factor in zip(x, texture, strict=True):
        assert found[min(found, key=lambda k, v=value: abs(k - v))] == factor
    assert_allclose(surface.mesh.triangle[:, 2], 1.5)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_layers_are_in_the_order_in_which_the_receiver_looks(direction):
    medium = layers(1.0, 2.0, 4.0)  # from -1 m to 6 m
    receiver = DiscReceiver(
        radius=0.05, acceptance_angle=0.1, position=(0, 0, 0.5),
        direction=(0, 0, direction),
    )  # fmt: skip
    found = problem(medium=medium, receiver=receiver, source=Source(position=(1, 0, 0)))
    steps = np.array([-1.5, -0.5, 1.5, 5.5])
    if direction > 0:
        assert found.layers == medium.layers
        assert_allclose(found.edges, steps)
        assert_allclose(found.water.attenuation, [0.6, 0, 0.4])
    else:
        assert found.layers == medium.layers[::-1]
        assert_allclose(found.edges, -steps[::-1])
        assert_allclose(found.water.attenuation, [0.4, 0, 0.6])
    assert found.water.edge.tolist() == found.edges.tolist()
    assert np.isinf(DISC_PROBLEM.edges).tolist() == [True, True]


def test_each_number_of_a_problem_has_a_digest_of_its_own():
    def disc(**changes):
        values = {"radius": 0.05, "acceptance_angle": 0.1} | changes
        return {"receiver": DiscReceiver(**values)}

    changes = [
        {},
        {"medium": water(absorption=0.21)},
        {"medium": water(absorption=0.25, scattering=1.0)},
        {"medium": water(phase_function=EVEN)},
        {"medium": Medium(layers=water().layers, group_index=1.34)},
        {"medium": layers(2.0)},
        {"medium": layers(3.0)},
        {"medium": layers(1.0, 2.0)},
        {"source": Source(position=(0, 0.1, 0))},
        {"source": Source(direction=(0, 0.1, 1))},
        {"source": Source(radius=0.01)},
        {"source": Source(divergence=0.01)},
        disc(radius=0.06),
        disc(acceptance_angle=0.2),
        disc(position=(0, 0, 0.1)),
        {"receiver": GaussianReceiver(radius=0.05, acceptance_angle=0.1)},
        {"target": plate()},
        {"target": plate(position=(0, 0, 3))},
        {"target": plate(normal=(0, 0.1, -1))},
        {"target": plate(reflectance=0.4)},
        {"target": plate(gloss=0.1, rms_slope=0.1)},
        {"target": plate(gloss=0.1, rms_slope=0.2)},
        {"target": plate(mueller=np.diag([1, 0.5, 0.5, 0.5]))},
    ]
    digests = [problem(**change).digest for change in changes]
    assert len(set(digests)) == len(changes)
    assert problem().digest == digests[0]
    rayleigh = ScatteringMatrix.rayleigh(cells=64)
    same = water(phase_function=rayleigh.phase_function)
    assert (
        problem(medium=same).digest
        != problem(medium=water(phase_function=rayleigh)).digest
    )


def test_a_receiver_may_lean_only_in_water_without_layers():
    leaning = DiscReceiver(
        radius=0.05, acceptance_angle=0.1, direction=(0, np.sin(0.2), np.cos(0.2))
    )
    assert problem(receiver=leaning).axes[2, 1] == pytest.approx(np.sin(0.2))
    with pytest.raises(ValueError, match=r"got a tilt of 11\.46 deg"):
        problem(receiver=leaning, medium=layers(2.0))


@pytest.mark.parametrize("depth", [-1.0, 0.5, 2.0])
def test_source_and_receiver_may_be_anywhere_in_the_layers(depth):
    place = (0, 0, depth)
    receiver = DiscReceiver(radius=0.05, acceptance_angle=0.1, position=place)
    medium = layers(1.0, 2.0)
    made = problem(medium=medium, source=Source(position=place), receiver=receiver)
    assert made.beam.centre[2] == 0


def test_source_and_receiver_must_be_in_the_layers():
    medium = layers(1.0, 2.0)
    for depth in (-1.1, 2.1):
        there = (0, 0, depth)
        far = DiscReceiver(radius=0.05, acceptance_angle=0.1, position=there)
        with pytest.raises(ValueError, match=f"source .*-1 to 2 m .*got {depth:g} m"):
            problem(medium=medium, source=Source(position=there))
        with pytest.raises(ValueError, match=f"receiver .*-1 to 2 m .*got {depth:g} m"):
            problem(medium=medium, receiver=far)


def seen(receiver, **source):
    """Return whether a receiver at the origin sees a source 3 m ahead."""
    values = {"position": (0, 0, 3), "direction": (0, 0, -1)} | source
    try:
        problem(receiver=receiver, source=Source(**values))
    except ValueError:
        return True
    return False


@pytest.mark.parametrize(
    ("kind", "source", "radii"),
    [
        # A beam beside the face: its half metre against the sum of all widths.
        (DiscReceiver, {}, (0.49, 0.51)),
        (GaussianReceiver, {}, (0.16, 0.17)),
        (DiscReceiver, {"radius": 0.1}, (0.19, 0.21)),
        (DiscReceiver, {"divergence": 0.05}, (0.04, 0.05)),  # 3 tan 0.15 = 0.453
    ],
)
def test_a_beam_beside_the_face_is_seen_within_all_widths(kind, source, radii):
    found = [
        seen(kind(radius=radius, acceptance_angle=0.3), position=(0.3, 0.4, 3),
             **source)
        for radius in radii
    ]  # fmt: skip
    assert found == [False, True]


@pytest.mark.parametrize(
    ("kind", "source", "angles"),
    [
        # A slope of 0.2 is an angle of 0.1974 rad.
        (DiscReceiver, {}, (0.196, 0.199)),
        (GaussianReceiver, {}, (0.065, 0.067)),
        (DiscReceiver, {"divergence": 0.01}, (0.166, 0.169)),
    ],
)
def test_a_beam_at_an_angle_is_seen_within_all_widths(kind, source, angles):
    found = [
        seen(kind(radius=0.05, acceptance_angle=angle), position=(0.6, 0, 3),
             direction=(-0.2, 0, -1), **source)
        for angle in angles
    ]  # fmt: skip
    assert found == [False, True]


def test_a_beam_is_seen_from_its_front_only():
    wide = DiscReceiver(radius=0.5, acceptance_angle=1.0)
    for source in (
        {"position": (0.1, 0, 0)},
        {"position": (0.1, 0, -1)},
        {"direction": (0, 1, 0)},
        {"direction": (0, 0, 1)},
    ):
        assert not seen(wide, **source)


def test_a_receiver_may_touch_the_plane_of_its_target_with_its_edge():
    def made(radius):
        receiver = DiscReceiver(radius=radius, acceptance_angle=0.1)
        side = plate(position=(0.125, 0, 0), normal=(-1, 0, 0))
        return problem(receiver=receiver, target=side)

    assert made(0.125).surface.height == -0.125
    with pytest.raises(ValueError, match=r"is 0\.125 m in front, its edge 0\.13 m"):
        made(0.13)
    on = plate(position=(0, 0, 0), normal=(0, 0.6, -0.8))
    with pytest.raises(ValueError, match="source must be in front of the target"):
        problem(target=on)


def test_a_source_stands_off_a_mesh_by_a_billionth_of_its_reach():
    # The far corner is 12 m ahead of the receiver: 12 nm.
    corners = [[-1.0, -1, 2], [1, -1, 2], [0, 1, 2]]
    mesh = MeshTarget(vertices=corners, faces=[[0, 1, 2]], reflectance=0.5)
    receiver = DiscReceiver(radius=0.05, acceptance_angle=0.1, position=(0, 0, -10))
    source = Source(position=(0, 0, 2 - 13e-9))
    assert problem(receiver=receiver, source=source, target=mesh).target is mesh
    for gap in (0.0, 11e-9):
        with pytest.raises(ValueError, match="source must not lie on the target"):
            problem(receiver=receiver, source=Source(position=(0, 0, 2 - gap)),
                    target=mesh)  # fmt: skip
