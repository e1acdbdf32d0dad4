"""Target reflections joined by place, against a plain loop over all pairs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from amulor.transport._kernels import contributions, reflections, trace
from amulor.transport._kernels.types import (
    Arrival,
    Face,
    Mesh,
    Paths,
    Plan,
    Record,
    Scene,
    Target,
)
from amulor.transport._runs import random_state

GROUPS, FACE, SCALE, REFLECTANCE = 5, 0.3, 0.02, 0.4
NORMALS = {"across": (0.0, 0.0, -1.0), "tilted": (0.6, 0.0, -0.8), "no plane": None}
PLAN = Plan(
    paths=4, partners=4, block=GROUPS, reflections=1000, stratified=True, balanced=True,
    roulette=16, direct=False, polarized=False,
)  # fmt: skip


@pytest.fixture(autouse=True)
def uncompiled(monkeypatch):
    """Run the loops as Python; random numbers stay compiled, as words overflow."""
    for module in (reflections, contributions):
        for name, loop in list(vars(module).items()):
            if hasattr(loop, "py_func") and not loop.__module__.endswith("sampling"):
                monkeypatch.setattr(module, name, loop.py_func)


def target_of(normal):
    """Return a plane through (0, 0, 2), or a target without plane and triangles."""
    mesh = Mesh(
        np.empty((0, 6)), np.empty((0, 3), np.int64), np.empty((0, 12)), np.empty(0),
        0.0,
    )  # fmt: skip
    vector = np.array(normal or (0.0, 0.0, -1.0))
    return Target(
        normal is not None, vector, 2.0 * vector[2], REFLECTANCE, 0.0, 1.0,
        np.eye(4), (1.0, 0.0, 0.0), mesh,
    )  # fmt: skip


def paths_of(kind, rng, touches=60, segments=80):
    """Return reflections on a target and adjoint segments around it."""
    place = rng.normal((0.0, 0.0, 2.0), 0.7, (touches, 3))
    normal = NORMALS[kind]
    if normal is not None:
        place[:, 2] = 2.0 - (place[:, :2] @ normal[:2]) / normal[2]
    touch = np.zeros((touches, trace.TOUCH_COLUMNS))
    touch[:, :3] = place
    touch[:, trace.TOUCH_LENGTH] = rng.uniform(2.0, 4.0, touches)
    touch[:, trace.TOUCH_ORDER] = rng.integers(0, 2, touches)
    touch[:, trace.NORMAL_X : trace.NORMAL_Z + 1] = normal or (0.0, 0.0, -1.0)
    touch[:, trace.TRIANGLE], touch[:, trace.REFLECTANCE] = -1.0, REFLECTANCE
    touch[:, trace.TOUCH_GROUP] = rng.integers(0, GROUPS, touches)
    n = rng.normal((0.0, 0.0, 1.0), 0.4, (segments, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    middle = rng.uniform((-1.5, -1.5, 0.5), (1.5, 1.5, 3.5), (segments, 3))
    segment = np.zeros((segments, trace.SEGMENT_COLUMNS))
    slope = n[:, :2] / n[:, 2:]
    segment[:, [trace.X, trace.Y]] = middle[:, :2] - slope * middle[:, 2:]
    segment[:, [trace.SLOPE_X, trace.SLOPE_Y]] = slope
    segment[:, trace.PER_Z] = 1.0 / n[:, 2]
    segment[:, trace.Z_LOW] = middle[:, 2] - 1.0
    segment[:, trace.Z_HIGH] = middle[:, 2] + 1.0
    segment[:, trace.NX : trace.NZ + 1] = n
    segment[:, trace.FRONT] = rng.uniform(-2.5, 1.0, segments)
    segment[:, trace.ORDER] = rng.integers(0, 3, segments)
    segment[:, trace.FACE], segment[:, trace.SCALE] = FACE, SCALE
    segment[:, trace.GROUP] = rng.integers(0, GROUPS, segments)
    none = np.zeros((1, 1))
    return (
        Paths(np.empty((0, trace.SEGMENT_COLUMNS)), none, touch, none,
              np.array([0, touches, 0, 0])),
        Paths(segment, none, np.empty((0, trace.TOUCH_COLUMNS)), none,
              np.array([segments, 0, 0, 0])),
    )  # fmt: skip


def joined(kind, forward, adjoint, plan=PLAN, seed=0):
    """Return total light, light of each group, and the record of a block."""
    record = Record(
        np.zeros((3, 1, 4096)), np.zeros((3, 1, 4096)), np.zeros((3, 1, 1), complex),
        np.zeros(1, complex), 0.02, 1,
    )  # fmt: skip
    arrival = Arrival(
        np.zeros(1),
        np.zeros(19),
        np.zeros((2, 1)),
        np.zeros(0),
        np.zeros(1),
        np.zeros(1),
    )
    weight = np.zeros((GROUPS, 2, 1))
    scene = Scene(None, Face(FACE, 0.1, False), None, target_of(NORMALS[kind]))
    reflections.join_touches(
        random_state(seed, 0), forward, adjoint, scene, plan, record, arrival, weight,
    )  # fmt: skip
    return arrival.total[1, 0], weight[:, 1, 0], record


def plain(kind, forward, adjoint):
    """Return the light of each pair: reflections by segments, from each pair alone."""
    light = np.zeros((len(forward.touch), len(adjoint.segment)))
    normal = NORMALS[kind]
    for i, touch in enumerate(forward.touch):
        for j, segment in enumerate(adjoint.segment):
            way = segment[trace.NX : trace.NZ + 1]
            start = np.array([segment[trace.X], segment[trace.Y], 0.0])
            place = touch[:3]
            on_line = start + way * (place[2] / way[2])
            shift = place - on_line
            cosine = -way @ np.array(normal or (0.0, 0.0, -1.0))
            hidden = (
                normal is not None
                and segment[trace.ORDER] > 0
                and np.dot(normal, shift) + segment[trace.FRONT] < 2.0 * normal[2]
            )
            if (
                segment[trace.Z_LOW] < place[2] <= segment[trace.Z_HIGH]
                and np.hypot(*shift[:2]) <= FACE
                and cosine > 0
                and not hidden
            ):
                light[i, j] = (
                    SCALE / GROUPS * REFLECTANCE / math.pi * cosine / abs(way[2])
                )
    return light


@pytest.mark.parametrize("kind", NORMALS)
def test_all_pairs_that_meet_are_joined_once(kind):
    for seed in range(2):
        forward, adjoint = paths_of(kind, np.random.default_rng(seed))
        total, weight, record = joined(kind, forward, adjoint)
        light = plain(kind, forward, adjoint)
        assert np.count_nonzero(light) > 20
        assert total == pytest.approx(light.sum(), rel=1e-12)
        assert record.mass.sum() == pytest.approx(light.sum(), rel=1e-9)
        from_source = np.bincount(
            forward.touch[:, trace.TOUCH_GROUP].astype(int), light.sum(1), GROUPS
        )
        to_receiver = np.bincount(
            adjoint.segment[:, trace.GROUP].astype(int), light.sum(0), GROUPS
        )
        expected = from_source + to_receiver - light.sum() / GROUPS
        np.testing.assert_allclose(weight, expected, rtol=1e-9)


@pytest.mark.parametrize("kind", NORMALS)
def test_a_sample_of_the_pairs_has_the_mean_of_all(kind):
    forward, adjoint = paths_of(kind, np.random.default_rng(1), 40, 30)
    light = plain(kind, forward, adjoint).sum()
    plan = PLAN._replace(reflections=3)
    totals = np.array(
        [joined(kind, forward, adjoint, plan, seed)[0] for seed in range(80)]
    )
    error = totals.std(ddof=1) / math.sqrt(len(totals))
    assert error > 0.001 * light  # pairs were left out
    assert abs(totals.mean() - light) < 4 * error


def test_reflections_of_one_point_are_all_found():
    forward, adjoint = paths_of("across", np.random.default_rng(2), 7, 40)
    forward.touch[:, :3] = (0.2, -0.1, 2.0)
    for x, slope, at in ((trace.X, trace.SLOPE_X, 0.1), (trace.Y, trace.SLOPE_Y, 0.0)):
        adjoint.segment[:, x] = at - 2.0 * adjoint.segment[:, slope]
    adjoint.segment[:, trace.ORDER] = 0
    total, _, _ = joined("across", forward, adjoint)
    light = plain("across", forward, adjoint).sum()
    assert light > 0
    assert total == pytest.approx(light, rel=1e-12)
