"""Frames and Stokes vectors along paths, against Mueller matrices of the optics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from amulor.optics.polarization import mueller, stokes
from amulor.transport._kernels import polarization as kernels
from amulor.transport._kernels.slab import meridian

#: Vectors of several drawn numbers take long to draw.
FEW = settings(max_examples=40)
RIGHT = (1.0, 0.0, 0.0)
ANGLES = st.floats(-np.pi, np.pi)
ELEMENTS = st.tuples(*[st.floats(-1, 1)] * 5)


def turn(angle):
    """Return the matrix of axes turned by an angle: Q' = Q cos 2a + U sin 2a."""
    cosine, sine = np.cos(2 * angle), np.sin(2 * angle)
    matrix = np.eye(4)
    matrix[1:3, 1:3] = [[cosine, sine], [-sine, cosine]]
    return matrix


def full(element):
    """Return the Mueller matrix of five elements."""
    names = ("m12", "m22", "m33", "m34", "m44")
    return mueller.particles(**dict(zip(names, element, strict=True)))


def table(elements):
    """Return elements as the kernels take them: one table, one cell for each."""
    return np.array(elements, dtype=float)[np.newaxis]


def scattered(vector, azimuth, element, cell=0):
    i, q, u, v = vector
    return np.array(
        kernels.scattered(
            (i, q, u, v), (np.cos(azimuth), np.sin(azimuth)), element, 0, cell
        )
    )


@FEW
@given(ELEMENTS, ANGLES, st.sampled_from("HVPMRL"))
def test_scattering_is_the_turned_matrix_of_the_optics(element, azimuth, launched):
    vector = stokes.state(launched)
    found = scattered(vector, azimuth, table([element]))
    # rotated() also turns the axes back, so that is undone.
    expected = turn(azimuth) @ mueller.rotated(full(element), angle=azimuth) @ vector
    np.testing.assert_allclose(found, expected, atol=1e-14)
    back = kernels.turned_stokes(
        found[1], found[2], (np.cos(azimuth), -np.sin(azimuth))
    )
    straight = mueller.rotated(full(element), angle=azimuth) @ vector
    np.testing.assert_allclose(back, straight[1:3], atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2, 2.5, np.pi])
def test_small_particles_scatter_as_rayleigh_says(angle):
    matrix = mueller.rayleigh(angle)
    element = [matrix[0, 1], matrix[1, 1], matrix[2, 2], matrix[2, 3], matrix[3, 3]]
    for name in "HVPMRL":
        found = scattered(stokes.state(name), 0.0, table([element]))
        np.testing.assert_allclose(found, matrix @ stokes.state(name), atol=1e-15)
    # At 90 degrees natural light comes out linear across the plane of scattering.
    natural = scattered(stokes.state("none"), 0.7, table([element]))
    cosine = np.cos(angle)
    assert natural[1] == pytest.approx(-(1 - cosine**2) / (1 + cosine**2), abs=1e-14)


@FEW
@given(st.lists(st.floats(-1, 1), min_size=16, max_size=16), ELEMENTS, ANGLES)
def test_a_further_scattering_multiplies_the_adjoint_matrix(values, element, azimuth):
    before = np.array(values).reshape(4, 4)
    out = np.concatenate([np.zeros(3), values])
    turned = (np.cos(azimuth), np.sin(azimuth))
    kernels.see_through(out, turned, table([element]), 0, 0)
    expected = before @ turn(-azimuth) @ full(element)
    np.testing.assert_allclose(out[3:].reshape(4, 4), expected, atol=1e-14)


unit = st.builds(
    lambda h, a: np.array(
        [np.sqrt(1 - h * h) * np.cos(a), np.sqrt(1 - h * h) * np.sin(a), h]
    ),
    st.floats(-0.999, 0.999),
    ANGLES,
).filter(lambda n: abs(n[0]) < 1 - 1e-6)  # the axis that frames are counted from


@FEW
@given(unit)
def test_frames_are_unit_vectors_across_the_direction(direction):
    frames = [
        kernels.projected_frame(tuple(direction), RIGHT),
        meridian(tuple(direction)),
    ]
    if direction[2] < 0:  # light that arrives at the receiver comes against its axis
        frames.append(kernels.returning_frame(tuple(direction)))
    for frame in np.array(frames):
        assert np.linalg.norm(frame) == pytest.approx(1, abs=1e-9)
        assert frame @ direction == pytest.approx(0, abs=1e-9)


@FEW
@given(unit, unit)
def test_a_projected_frame_is_the_part_of_its_axis_across_the_light(direction, right):
    axis = np.array(kernels.projected_frame(tuple(direction), tuple(right)))
    part = right - (right @ direction) * direction
    size = np.linalg.norm(part)
    if size > 1e-6:
        np.testing.assert_allclose(axis, part / size, rtol=0, atol=1e-9)
    along = np.array(kernels.projected_frame(tuple(direction), tuple(direction)))
    for frame in (axis, along):
        assert np.linalg.norm(frame) == pytest.approx(1, abs=1e-9)
        assert frame @ direction == pytest.approx(0, abs=1e-9)


@FEW
@given(st.floats(0, np.pi / 2), ANGLES)
def test_the_returning_frame_is_turned_the_short_way(tilt, azimuth):
    across = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    rotation = Rotation.from_rotvec(tilt * across)
    direction = rotation.apply([0, 0, -1])
    found = kernels.returning_frame(tuple(direction))
    np.testing.assert_allclose(found, rotation.apply([1, 0, 0]), atol=1e-12)


def test_the_meridian_points_to_larger_angles():
    for theta in (1e-3, 1.0, 3.0):
        direction = (np.sin(theta) * 0.6, np.sin(theta) * 0.8, np.cos(theta))
        expected = (np.cos(theta) * 0.6, np.cos(theta) * 0.8, -np.sin(theta))
        np.testing.assert_allclose(meridian(tuple(direction)), expected, atol=1e-12)
    assert meridian((0.0, 0.0, -1.0)) == (-1.0, 0.0, 0.0)


@FEW
@given(unit, ANGLES, ANGLES)
def test_turning_twice_is_turning_by_the_sum(direction, first, second):
    n = tuple(direction)
    e = kernels.projected_frame(n, RIGHT)
    once = kernels.turned_frame((np.cos(first), np.sin(first)), n, e)
    twice = kernels.turned_frame((np.cos(second), np.sin(second)), n, once)
    total = first + second
    expected = kernels.turned_frame((np.cos(total), np.sin(total)), n, e)
    np.testing.assert_allclose(twice, expected, atol=1e-9)
    found = kernels.between_frames(n, e, twice)
    np.testing.assert_allclose(found, (np.cos(total), np.sin(total)), atol=1e-9)


class Path:
    """Directions of a path that is scattered, and the frames at both ends."""

    def __init__(self, seed, number=4):
        rng = np.random.default_rng(seed)
        self.direction = Rotation.random(number + 1, rng=rng).apply([0, 0, 1])
        self.first = np.array(kernels.projected_frame(tuple(self.direction[0]), RIGHT))
        self.last = np.array(kernels.projected_frame(tuple(self.direction[-1]), RIGHT))
        self.elements = rng.uniform(-1, 1, (number, 5))
        self.stokes = np.array([1.0, *rng.uniform(-0.5, 0.5, 3)])

    def rotated(self, rotation):
        other = Path.__new__(Path)
        other.__dict__ = dict(self.__dict__)
        for name in ("direction", "first", "last"):
            setattr(other, name, rotation.apply(getattr(self, name)))
        return other

    def plane(self, k):
        """Return cosine and sine of scattering k, and the axis n goes towards."""
        n, m = self.direction[k], self.direction[k + 1]
        across = m - (n @ m) * n
        sine = np.linalg.norm(across)
        return n @ m, sine, across / sine

    def expected(self):
        """Return what arrives, by full matrices."""
        vector, e = self.stokes, self.first
        for k, element in enumerate(self.elements):
            n = self.direction[k]
            cosine, sine, axis = self.plane(k)
            azimuth = np.arctan2(np.cross(n, e) @ axis, e @ axis)
            vector = full(element) @ turn(azimuth) @ vector
            e = cosine * axis - sine * n
        n = self.direction[-1]
        azimuth = np.arctan2(np.cross(n, e) @ self.last, e @ self.last)
        return turn(azimuth) @ vector

    def forward(self, number):
        """Return frame and Stokes vector after some scatterings, by the kernels."""
        e, vector = self.first, self.stokes
        for k in range(number):
            n = self.direction[k]
            cosine, sine, axis = self.plane(k)
            turned = kernels.between_frames(tuple(n), tuple(e), tuple(axis))
            elements = table(self.elements)
            vector = kernels.scattered(tuple(vector), turned, elements, 0, k)
            f = np.array(kernels.turned_frame(turned, tuple(n), tuple(e)))
            e = cosine * f - sine * n
        return np.array([*e, *vector])

    def adjoint(self, number):
        """Return frame and matrix of a path against the light, by the kernels."""
        now = np.array([*self.last, *np.eye(4).ravel()])
        total = len(self.elements)
        for k in range(total - 1, total - 1 - number, -1):
            light, n, m = (
                self.direction[k + 1],
                -self.direction[k + 1],
                -self.direction[k],
            )
            cosine = n @ m
            sine = np.sqrt(1 - cosine**2)
            axis = (m - cosine * n) / sine
            frame = tuple(now[:3])
            turned = kernels.between_frames(tuple(light), frame, tuple(axis))
            kernels.see_through(now, turned, table(self.elements), 0, k)
            f = np.array(kernels.turned_frame(turned, tuple(light), frame))
            now[:3] = cosine * f - sine * n
        return now


@pytest.mark.parametrize("seed", range(5))
def test_a_chain_joined_anywhere_is_the_same_product_of_matrices(seed):
    path = Path(seed)
    total = len(path.elements)
    for joint in range(total):
        out = np.zeros(4)
        kernels.connected(
            tuple(path.direction[joint]),
            path.forward(joint),
            tuple(path.direction[joint + 1]),
            path.adjoint(total - 1 - joint),
            table(path.elements),
            0,
            joint,
            out,
        )
        np.testing.assert_allclose(out, path.expected(), rtol=0, atol=1e-11)


@pytest.mark.parametrize("seed", range(3))
def test_the_adjoint_matrix_of_a_whole_path_is_that_of_the_light(seed):
    path = Path(seed)
    seen = path.adjoint(len(path.elements))
    n = path.direction[0]
    azimuth = np.arctan2(np.cross(n, path.first) @ seen[:3], path.first @ seen[:3])
    out = np.zeros(4)
    kernels.received(seen, tuple(turn(azimuth) @ path.stokes), out)
    np.testing.assert_allclose(out, path.expected(), rtol=0, atol=1e-11)


@FEW
@given(st.integers(0, 2**32), st.integers(0, 2**32))
def test_a_path_turned_in_space_scatters_alike(seed, how):
    path = Path(seed)
    turned = path.rotated(Rotation.random(rng=np.random.default_rng(how)))
    number = len(path.elements)
    np.testing.assert_allclose(
        turned.forward(number)[3:], path.forward(number)[3:], atol=1e-9
    )
    np.testing.assert_allclose(
        turned.adjoint(number)[3:], path.adjoint(number)[3:], atol=1e-9
    )


@FEW
@given(ANGLES, ANGLES, st.sampled_from("HVPMRL"))
def test_a_mirror_reflects_as_its_matrix_from_any_frame(before, after, launched):
    surface = mueller.ideal_backscatter()
    n, m = np.array([0.0, 0, 1]), np.array([0.0, 0, -1])
    axis = kernels.turned_frame((np.cos(before), np.sin(before)), tuple(n), RIGHT)
    light = np.array([*axis, *stokes.state(launched)])
    frame = kernels.turned_frame((np.cos(after), np.sin(after)), tuple(m), RIGHT)
    found = kernels.reflected(tuple(n), light, surface, RIGHT, tuple(m), frame)
    expected = turn(after) @ surface @ turn(-before) @ stokes.state(launched)
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_uncompiled_kernels_give_the_same_vectors():
    path = Path(9)
    forward, adjoint = path.forward(2), path.adjoint(1)
    compiled, plain = np.zeros(4), np.zeros(4)
    for function, out in (
        (kernels.connected, compiled),
        (kernels.connected.py_func, plain),
    ):
        function(
            tuple(path.direction[2]), forward, tuple(path.direction[3]), adjoint,
            table(path.elements), 0, 2, out,
        )  # fmt: skip
    np.testing.assert_allclose(compiled, plain, rtol=1e-12, atol=1e-14)
