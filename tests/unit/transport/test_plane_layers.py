"""Plane layers: what the compiled loop gets, directions, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.phase_functions.models import isotropic
from amulor.transport import (
    Layer,
    Medium,
    ScatteringMatrix,
    reflection_and_transmission,
    slab,
)
from amulor.transport._kernels import slab as slab_kernels
from amulor.transport._runs import random_state


@pytest.fixture
def slab_loop(monkeypatch):
    """Return the calls of the compiled loop of plane layers."""
    calls = []
    monkeypatch.setattr(
        slab_kernels, "run_slab", lambda *arguments: calls.append(arguments)
    )
    return calls


def layered(function=None):
    layer = Layer(
        absorption=0.1, scattering=0.9, phase_function=function or isotropic(),
        thickness=2.0,
    )  # fmt: skip
    return Medium.layered([layer], group_index=1.38, top=-1.0)


def reflect(medium=None, **options):
    values = {"histories": 1280, "seed": 5, "threads": 1} | options
    return reflection_and_transmission(medium or layered(), [0.0, 1e7], **values)


def test_light_falls_straight_on_flat_faces_by_default(slab_loop):
    tally = reflect()
    state, size, light, water_tables, record = slab_loop[2]
    assert_array_equal(state, random_state(5, 2))
    assert (size, len(slab_loop), tally.histories) == (10, 128, 1280)
    assert_allclose(light.incidence, [0, 0, 1])
    assert light.stokes.tolist() == [1, 0, 0, 0]
    assert light.near == (1, 0, -1)
    assert light.far == (1, 0, 1)
    assert (light.outward.shape, light.radius.shape) == ((0, 7), (0,))
    assert not light.polarized
    assert water_tables.edge.tolist() == [-1, 1]
    assert record.orders == 0
    assert tally.parts == ("reflected", "transmitted")
    assert (tally.groups, tally.contribution, tally.seed) == (0, (0, 0, 0), 5)
    assert tally.contributions is None
    assert tally.batches.shape == (128, 2, 1, 2)


def test_a_slab_has_two_faces_directions_and_discs(slab_loop):
    tally = reflect(
        layered(ScatteringMatrix.rayleigh(cells=64)), histories=1281, incidence=0.4,
        polarization="H", index_ratio=(1.2, 1.1), outward=[(0.3, 0.1), (3.0, 0.2)],
        discs=[0.5, 1.5],
    )  # fmt: skip
    _, size, light, _, _ = slab_loop[0]
    assert size == 11
    assert tally.next_batch == 117  # of 11 photons: 1,287
    assert_allclose(light.incidence, [np.sin(0.4), 0, np.cos(0.4)])
    assert light.stokes.tolist() == [1, 1, 0, 0]
    assert light.near == (1.2, 0, -1)
    assert light.far == (1.1, 0, 1)
    assert light.radius.tolist() == [0.5, 1.5]
    assert light.polarized
    assert tally.parts == (
        "reflected", "transmitted", "direction 1", "direction 2", "disc 1", "disc 2"
    )  # fmt: skip
    assert tally.batches.shape[1:] == (6, 4, 2)
    rough = reflect(index_ratio=1.3, rms_slope=0.2)
    assert rough.polarized is False
    assert slab_loop[-1][2].near == (1.3, 0.2, -1)
    assert slab_loop[-1][2].far == (1.3, 0, 1)


def test_a_slab_begins_without_light(monkeypatch):
    monkeypatch.setattr(slab, "conduct", lambda run, frame, limits: frame)
    frame = reflect(discs=[0.5])
    assert frame.batches.shape == (0, 3, 1, 2)
    assert frame.histories_of.size == 0
    assert (frame.groups, frame.contribution) == (0, (0, 0, 0))
    assert (frame.next_batch, frame.seconds, frame.batch_size) == (0, 0, 10)
    assert frame.phase_function_integral == pytest.approx((1.0,))


def test_one_call_of_a_long_slab_has_half_a_million_photons(slab_loop):
    reflect(histories=128 * 2**20)
    assert {call[1] for call in slab_loop} == {2**19}


def test_slabs_at_their_limits_are_accepted(slab_loop):
    # Cosines of polar angles beyond a millionth, and both poles.
    outward = [(0.0, 0), (np.pi, 0), (np.pi / 2 - 1.05e-6, 0)]
    reflect(histories=1, outward=outward)
    reflect(histories=1, index_ratio=(1.1, 1.0), rms_slope=0.99)
    for wrong, message in (
        ({"outward": [(np.pi / 2 - 0.95e-6, 0)]}, "polar angles"),
        ({"outward": [(-0.1, 0)]}, "polar angles"),
        ({"outward": [(3.2, 0)]}, "polar angles"),
        ({"outward": [(0.1, 0, 0)]}, "pairs of polar angle"),
        ({"index_ratio": (1.1, 1.1, 1.1)}, "one or two numbers"),
        ({"index_ratio": np.inf}, "one or two numbers"),
        ({"discs": [np.inf]}, "discs must be"),
        ({"discs": [[0.1]]}, "discs must be"),
        ({"discs": 0.1}, "discs must be"),
        ({"incidence": -0.1}, "incidence must be"),
        ({"rms_slope": -0.1, "index_ratio": 1.2}, "rms_slope must be"),
        ({"polarization": (1, 0, 0, 0.5)}, "polarized light needs"),
    ):
        with pytest.raises(ValueError, match=message):
            reflect(**wrong)


def test_each_number_of_a_slab_has_a_digest_of_its_own(slab_loop):
    changes = [
        {}, {"incidence": 0.1}, {"outward": [(0.1, 0)]}, {"outward": [(0.1, 0.1)]},
        {"index_ratio": 1.1}, {"index_ratio": (1.1, 1)}, {"index_ratio": (1, 1.1)},
        {"index_ratio": 1.1, "rms_slope": 0.1}, {"discs": [1.0]}, {"discs": [2.0]},
        {"medium": Medium.layered(layered().layers, group_index=1.3, top=-1.0)},
        {"medium": Medium.layered(layered().layers, group_index=1.38)},
    ]  # fmt: skip
    digests = {reflect(histories=1, **change).problem for change in changes}
    assert len(digests) == len(changes)
    matrix = ScatteringMatrix.rayleigh(cells=64)
    polarized = {
        reflect(layered(matrix), histories=1, polarization=name).problem
        for name in ("none", "H")
    }
    assert len(polarized | digests) == len(changes) + 2


def test_directions_outside_are_refracted_by_the_face_that_they_leave():
    polar, azimuth = np.array([0.5, 2.5]), np.array([0.3, -0.4])
    found = slab._axes(np.stack([polar, azimuth], axis=-1), near=1.2, far=1.5)
    for row, angle, turn, index in zip(found, polar, azimuth, (1.5, 1.2), strict=True):
        outside = min(angle, np.pi - angle)
        inside = np.arcsin(np.sin(outside) / index)  # Snell
        theta = inside if angle < np.pi / 2 else np.pi - inside
        way = np.array(
            [np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)]
        )
        assert_allclose(row[:3], way)
        # The axis in the plane of incidence: the direction turned by a right angle.
        along = np.array(
            [np.cos(theta) * np.cos(turn), np.cos(theta) * np.sin(turn), -np.sin(theta)]
        )
        assert_allclose(row[3:6], along)
        # n^2 cos(inside) dOmega(inside) = cos(outside) dOmega(outside).
        solid = np.cos(outside) / (index**2 * np.cos(inside))
        assert row[6] == pytest.approx(solid)
