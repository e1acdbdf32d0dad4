"""Glossy targets: closed forms, reciprocity, energy, polarization."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.optics.phase_functions.models import isotropic
from amulor.optics.reflection import mirror_facets
from amulor.transport import (
    DiscReceiver,
    Medium,
    PlaneTarget,
    ScatteringMatrix,
    Source,
    simulate,
)
from amulor.transport._kernels.sampling import uniform
from amulor.transport._kernels.surfaces import mirror_direction, mirrored
from amulor.transport._runs import random_state

UPWARDS = (0.0, 0.0, 1.0)


def clear(function=None):
    """Return water that absorbs only."""
    return Medium.homogeneous(
        absorption=0.2, scattering=0.0, phase_function=function or isotropic(),
        group_index=1.33,
    )  # fmt: skip


@pytest.mark.parametrize("direct", [0.3, 0.6], ids=["local estimate", "joined"])
@pytest.mark.parametrize("tilt", [0.0, 0.2, -0.5])
def test_a_glossy_plane_in_clear_water_reflects_as_its_formula_says(tilt, direct):
    normal = np.array([np.sin(tilt), 0, -np.cos(tilt)])
    tally = simulate(
        clear(), Source(),
        DiscReceiver(radius=0.2, acceptance_angle=direct, position=(0.3, 0, 0)),
        [0.0], histories=40_000, seed=1,
        target=PlaneTarget(
            position=(0, 0, 2), normal=normal, reflectance=0.1, gloss=0.6, rms_slope=0.2
        ),
    )  # fmt: skip
    # Midpoints of equal areas of the face.
    away = 0.2 * np.sqrt((np.arange(60)[:, None] + 0.5) / 60)
    turn = 2 * np.pi * (np.arange(60) + 0.5) / 60
    way = np.stack(
        [0.3 + away * np.cos(turn), away * np.sin(turn), np.full((60, 60), -2.0)], -1
    )
    length = np.linalg.norm(way, axis=-1)
    back = way / length[..., None]
    leaving, arriving = back @ normal, np.cos(tilt)
    # Parts of both directions in the plane of the target.
    flat = back - leaving[..., None] * normal
    ahead = np.array([0, 0, -1.0]) - arriving * normal
    sizes = np.linalg.norm(flat, axis=-1) * np.linalg.norm(ahead)
    turned = np.arccos(np.clip(flat @ ahead / np.maximum(sizes, 1e-12), -1, 1))
    brdf = 0.1 / np.pi + 0.6 * mirror_facets(
        incidence=np.full((60, 60), abs(tilt)), reflection=np.arccos(leaving),
        azimuth=turned, rms_slope=0.2,
    )  # fmt: skip
    light = brdf * leaving * -back[..., 2] / length**2 * np.exp(-0.2 * (2 + length))
    expected = np.pi * 0.2**2 * light.mean()
    error = tally.relative_error[0] * expected
    assert abs(tally.signal[0].real - expected) < 4 * error + 2e-3 * expected
    assert error < (0.02 if direct < 0.35 else 0.06) * expected


@numba.njit
def _mirrored_cosines(state, count, slope, cosines):
    """Send diffuse light to facets; fill the cosines before and after, 0 if hidden."""
    for k in range(count):
        up = np.sqrt(uniform(state))
        n = (np.sqrt(1 - up * up), 0.0, -up)
        goes, m = mirror_direction(state, n, (0.0, 0.0, 1.0), slope)
        cosines[k, 0], cosines[k, 1] = up, m[2] if goes else 0.0


@pytest.mark.parametrize("slope", [0.1, 0.5])
def test_facets_mirror_as_much_light_there_as_back_and_as_the_formula(slope):
    count = 200_000
    cosines = np.empty((count, 2))
    _mirrored_cosines(random_state(3, 0), count, slope, cosines)
    goes = cosines[:, 1] > 0
    edges = np.linspace(0, 1, 7)
    counts = np.histogram2d(*cosines[goes].T, bins=(edges, edges))[0]
    # cos d(cos) of diffuse light on both sides: the formula by bins.
    node, weight = np.polynomial.legendre.leggauss(24)
    middle = (edges[:-1, None] + edges[1:, None]) / 2 + node / 12
    cosine, weight = middle.ravel(), np.tile(weight / 12, 6) * 2
    turn = np.pi * (np.arange(400) + 0.5) / 400
    brdf = mirror_facets(
        incidence=np.arccos(cosine)[:, None, None],
        reflection=np.arccos(cosine)[:, None], azimuth=turn, rms_slope=slope,
    ).mean(axis=-1)  # fmt: skip
    share = 2 * np.pi * brdf * np.outer(cosine * weight, cosine * weight) / 2
    expected = count * share.reshape(6, 24, 6, 24).sum(axis=(1, 3))
    for other in (counts.T, expected):
        variance = counts + (other if other is not expected else 0)
        keep = (counts > 50) & (counts != other)
        assert np.all(np.abs(counts - other)[keep] < 4 * np.sqrt(variance[keep]))
    assert goes.mean() == pytest.approx(expected.sum() / count, abs=0.005)


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(
    lambda v: np.linalg.norm(v) > 0.1
)


@given(directions, directions, st.tuples(*[st.floats(-1, 1)] * 4))
def test_a_facet_mirrors_fields(before, after, field):
    # A perfect conductor turns a field E into 2 (E h) h - E.
    n, m = (np.array(v) / np.linalg.norm(v) for v in (before, after))
    if np.linalg.norm(m - n) < 1e-3 or np.linalg.norm(m + n) < 1e-3:
        return
    facet = (m - n) / np.linalg.norm(m - n)

    def frame_of(way):
        e = np.cross(way, (0.31, -0.72, 0.62))
        return e / np.linalg.norm(e)

    def stokes(vector, way):
        e = frame_of(way)
        along, across = vector @ e, vector @ np.cross(way, e)
        cross = along * np.conj(across)
        intensity = abs(along) ** 2 + abs(across) ** 2
        return np.array(
            [intensity, 2 * abs(along) ** 2 - intensity, 2 * cross.real, 2 * cross.imag]
        )

    e = frame_of(n)
    vector = (field[0] + 1j * field[1]) * e + (field[2] + 1j * field[3]) * np.cross(
        n, e
    )
    light = np.concatenate([e, stokes(vector, n)])
    image = 2 * (vector @ facet) * facet - vector
    found = mirrored(tuple(n), light, tuple(m), tuple(frame_of(m)))
    np.testing.assert_allclose(found, stokes(image, m), atol=1e-9)


def test_a_mirroring_plane_turns_round_the_handedness_of_light():
    tally = simulate(
        clear(ScatteringMatrix.rayleigh()), Source(polarization="R"),
        DiscReceiver(radius=0.05, acceptance_angle=0.1, position=(0.1, 0, 0)),
        [0.0], histories=8_000, seed=2,
        target=PlaneTarget(
            position=(0, 0, 2), reflectance=0.0, gloss=0.5, rms_slope=0.1
        ),
    )  # fmt: skip
    left, right = (abs(tally.detected(name)[0][0]) for name in ("L", "R"))
    assert left == pytest.approx(abs(tally.signal[0]), rel=1e-3)
    assert right < 1e-3 * left
