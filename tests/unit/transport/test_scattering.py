"""Scattering matrices by angle, and their means over cells of angle."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.optics.phase_functions.models import isotropic, rayleigh_phase
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.transport import ScatteringMatrix
from amulor.transport._kernels import sampling
from amulor.transport.scattering import AngleCells, _angle, alias_table, cell_edges


class Shaped(PhaseFunction):
    """Isotropic scattering times a function of the angle."""

    shape = staticmethod(np.ones_like)

    def __call__(self, angle):
        return self.shape(np.asarray(angle)) * super().__call__(angle)


class Scaled(Shaped):
    """The same with all fractions multiplied."""

    factor = 1.0

    def __call__(self, angle):
        return self.factor * super().__call__(angle)

    def cumulative(self, angle):
        return self.factor * super().cumulative(angle)


def shaped(shape):
    """Return a phase function that is isotropic times a shape."""
    found = Shaped(name="drawn", panels=isotropic().panels)
    object.__setattr__(found, "shape", shape)
    return found


def scaled(factor):
    found = Scaled(name="measured", panels=isotropic().panels)
    object.__setattr__(found, "factor", factor)
    return found


def linear():
    """Return a matrix whose m12 is the angle over ten and m34 its rest."""
    angle = np.array([0.0, np.pi])
    elements = np.array([[0, 1, 0.6, 0.1, 0.6], [np.pi / 10, 1, 0.6, 0, 0.6]])
    return ScatteringMatrix(isotropic(), angle, elements)


def test_elements_are_interpolated_between_their_angles():
    matrix = linear()
    found = matrix.elements_at([[0.0, 1.0], [2.0, np.pi]])
    assert found.shape == (2, 2, 5)
    assert_allclose(found[..., 0], [[0, 0.1], [0.2, np.pi / 10]])
    assert_allclose(found[0, 1, 1:], [1, 0.6, 0.1 * (1 - 1 / np.pi), 0.6])


def test_a_matrix_of_small_particles_is_that_of_rayleigh():
    matrix = ScatteringMatrix.rayleigh(cells=16)
    assert matrix.angle.shape == (17,)
    assert matrix.angle[-1] == pytest.approx(np.pi)
    cosine = np.cos(matrix.angle)
    m12 = -(1 - cosine**2) / (1 + cosine**2)
    m33 = 2 * cosine / (1 + cosine**2)
    expected = np.stack([m12, 1 + 0 * m12, m33, 0 * m12, m33], axis=-1)
    assert_allclose(matrix.elements, expected, atol=1e-15)
    assert matrix.phase_function(0.0) == pytest.approx(rayleigh_phase()(0.0))
    assert ScatteringMatrix.rayleigh().angle.size == 3601


def test_a_table_of_mueller_matrices_gives_each_element_its_column():
    full = np.zeros((2, 4, 4))
    full[:, 0, 0], full[:, 1, 1], full[:, 2, 2], full[:, 3, 3] = 1, 0.9, 0.7, 0.6
    full[:, 0, 1] = full[:, 1, 0] = 0.05
    full[:, 2, 3], full[:, 3, 2] = 0.1, -0.1
    made = ScatteringMatrix.tabulated(
        [0.0, np.pi], mueller=full, phase_function=isotropic()
    )
    assert made.elements.tolist() == [[0.05, 0.9, 0.7, 0.1, 0.6]] * 2
    # The form holds to the digits in print, here and not beyond.
    for off, allowed in ((0.0019, True), (0.0021, False)):
        full[:, 0, 2] = off
        if allowed:
            ScatteringMatrix.tabulated(
                [0.0, np.pi], mueller=full, phase_function=isotropic()
            )
        else:
            with pytest.raises(ValueError, match=r"element that is off by 0\.0021"):
                ScatteringMatrix.tabulated(
                    [0.0, np.pi], mueller=full, phase_function=isotropic()
                )
    with pytest.raises(ValueError, match=r"shape \(2, 4, 4\), got \(2, 4, 3\)"):
        ScatteringMatrix.tabulated(
            [0.0, np.pi], mueller=full[..., :3], phase_function=isotropic()
        )


@pytest.mark.parametrize(
    "angle",
    [[0.1, np.pi], [0.0, np.pi - 1e-3], [0.0, 1.0, 1.0, np.pi], [[0.0, np.pi]], [0.0]],
)
def test_angles_rise_from_0_to_pi(angle):
    angle = np.array(angle)
    elements = np.tile([0.0, 1, 1, 0, 1], (angle.size, 1))
    with pytest.raises(ValueError, match=r"angle must rise|with at least two angles"):
        ScatteringMatrix(isotropic(), angle, elements)


def test_angles_end_at_pi_within_rounding():
    angle = np.array([0.0, np.pi - 0.9e-9])
    elements = np.array([[0.0, 1, 1, 0, 1]] * 2)
    assert ScatteringMatrix(isotropic(), angle, elements).angle is angle
    with pytest.raises(ValueError, match="angle must rise from 0 to pi"):
        ScatteringMatrix(isotropic(), np.array([0.0, np.pi - 2e-9]), elements)


def test_cells_halve_towards_both_ends():
    edges = cell_edges()
    per, forward, backward = (
        sampling.PER_OCTAVE, sampling.FORWARD_OCTAVES, sampling.BACKWARD_OCTAVES
    )  # fmt: skip
    # The uppermost octave below 1/2 is [1/4, 1/2), in even steps; its mirror image too.
    half = int(np.flatnonzero(edges == 0.5)[0])
    assert half == forward * per + 1
    assert edges.size - half == backward * per + 2
    low = 0.25 * (1 + np.arange(per) / per)
    assert edges[half - per : half].tolist() == low.tolist()
    assert_allclose(edges[half + 1 : half + 1 + per], 1 - low[::-1], rtol=1e-15)
    assert edges[1] == 0.5 ** (forward + 1)
    assert edges[-2] == 1 - 0.5 ** (backward + 1)


def test_the_angle_of_a_height_is_that_of_half_a_chord():
    angle = np.array([0.0, 1e-6, 0.3, 2.0, np.pi])
    assert_allclose(_angle(np.sin(angle / 2) ** 2), angle, rtol=1e-12)


def test_the_middle_of_a_cell_halves_its_solid_angle():
    cells = AngleCells(isotropic())
    height = np.sin(cells.middle / 2) ** 2
    edges = cells.edges
    assert_allclose(height - edges[:-1], edges[1:] - height, atol=1e-15)
    assert_allclose(cells.value, 0.25 / np.pi, rtol=1e-9)
    assert_allclose(cells.probability, np.diff(edges), rtol=1e-9)
    assert cells.integral == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("factor", [0.9981, 1.0019, 0.9979, 1.0021])
def test_an_integral_may_be_off_by_two_parts_in_a_thousand(factor):
    cells = AngleCells(scaled(factor))
    if abs(factor - 1) < 0.002:
        assert cells.integral == pytest.approx(factor)
        assert cells.probability.sum() == pytest.approx(1)
    else:
        with pytest.raises(ValueError, match=f"over the sphere, got {factor:g}; div"):
            _ = cells.integral


def test_a_phase_function_may_be_zero_and_not_below():
    def missing(angle):
        return np.where(angle > 3.11, 0.0, 1.0)

    cells = AngleCells(shaped(missing))
    assert cells.value[-1] == 0
    for wrong in (-1.0, np.nan, np.inf):
        broken = AngleCells(
            shaped(lambda angle, value=wrong: np.where(angle > 3.1, value, 1.0))
        )
        with pytest.raises(ValueError, match="drawn must be finite and not below zero"):
            _ = broken.probability


def test_elements_of_a_cell_are_means_by_their_light():
    # Light that grows with the angle: Simpson's weights 1, 4, 1 times the light.
    cells = AngleCells(shaped(lambda angle: 1e-3 + angle))
    found = cells.elements(linear())[:, 0]
    low, middle, high = _angle(cells.edges[:-1]), cells.middle, _angle(cells.edges[1:])
    weights = [1e-3 + low, 4 * (1e-3 + middle), 1e-3 + high]
    expected = (weights[0] * low + weights[1] * middle + weights[2] * high) / 10
    expected /= sum(weights)
    assert_allclose(found[1:], expected[1:], rtol=1e-9)
    # The innermost cell may hold a steep head, so it has the elements at its low end.
    assert found[0] == 0
    assert cells.elements(linear())[0].tolist() == [0, 1, 0.6, 0.1, 0.6]


def test_a_cell_without_light_has_the_elements_at_its_middle():
    cells = AngleCells(shaped(lambda angle: np.where(angle > 2.0, 0.0, 1.0)))
    found = cells.elements(linear())
    dark = _angle(cells.edges[:-1]) > 2.0
    assert dark.sum() > 100
    assert_allclose(found[dark, 0], cells.middle[dark] / 10, rtol=1e-12)


def test_a_row_of_the_urn_has_its_cell_and_its_partner():
    cells = AngleCells(rayleigh_phase())
    urn = cells.urn
    threshold, partner = alias_table(cells.probability)
    edges = cells.edges
    assert urn.shape == (edges.size - 1, 8)
    assert_allclose(urn[:, 0], threshold)
    assert_allclose(urn[:, 1], edges[:-1])
    assert_allclose(urn[:, 2], edges[1:] - edges[:-1])
    assert urn[:, 3].tolist() == list(range(edges.size - 1))
    assert_allclose(urn[:, 4], edges[:-1][partner])
    assert_allclose(urn[:, 5], np.diff(edges)[partner])
    assert_allclose(urn[:, 6], partner)
    assert not urn[:, 7].any()


def test_an_alias_table_of_three_shares_by_hand():
    threshold, partner = alias_table(np.array([0.5, 0.1, 0.4]))
    # Scaled to 1.5, 0.3, 1.2: 0.7 of the last go to the small one, 0.5 to the last.
    assert_allclose(threshold, [1, 0.3, 0.5])
    assert partner.tolist() == [0, 2, 0]
    even, own = alias_table(np.array([2.0, 2.0]))
    assert even.tolist() == [1, 1]
    assert own.tolist() == [0, 1]
