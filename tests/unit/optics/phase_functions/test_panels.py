"""Integrals over panels of angles, by hand for few panels of a constant or a power."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import j0

from amulor.optics.phase_functions import integrals
from amulor.optics.phase_functions.integrals import Panels, gauss_legendre

EDGES = np.array([0.1, 0.5, 2.0, np.pi])


def constant(head_exponent: float = 0.0) -> Panels:
    """Return panels of light that is scattered alike into all angles."""
    return Panels(lambda angle: 0 * angle + 1 / (4 * np.pi), EDGES, head_exponent)


@pytest.mark.parametrize("head_exponent", [0.0, 1.0, 1.5])
def test_share_below_an_angle_adds_the_head_and_the_panels(
    head_exponent: float,
) -> None:
    panels = constant(head_exponent)
    # Below the first edge a power of the angle, on a plane.
    head = 2 * np.pi / (4 * np.pi) * 0.1**2 / (2 - head_exponent)
    angle = np.array([[0.02, 0.1, 0.3], [0.5, 1.1, 3.0], [2.0, np.pi, 0.07]])
    below = head * (np.minimum(angle, 0.1) / 0.1) ** (2 - head_exponent)
    beyond = (np.cos(0.1) - np.cos(np.maximum(angle, 0.1))) / 2
    assert_allclose(panels.cumulative(angle), below + beyond, rtol=1e-12)
    assert_allclose(panels._innermost(), head, rtol=1e-14)


@pytest.mark.parametrize(
    ("low", "high"),
    [(0.0, np.pi), (0.0, 0.8), (0.3, 2.5), (0.1, 0.5), (0.6, 0.7), (0.05, 1.0)],
)
def test_mean_of_a_weight_is_its_integral_between_two_angles(
    low: float, high: float
) -> None:
    found = constant().mean(np.cos, low=low, high=high)
    start = max(low, 0.1)
    expected = (np.sin(high) ** 2 - np.sin(start) ** 2) / 4
    if low < 0.1:
        # The head is taken as a whole, at its end.
        expected += np.cos(0.1) * 0.1**2 / 4
    assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("split", [0.4, 0.5, 1.3, np.pi])
@pytest.mark.parametrize("head_exponent", [0.0, 1.0])
def test_transform_of_few_panels_is_a_sum_over_angles(
    split: float, head_exponent: float
) -> None:
    panels = constant(head_exponent)
    frequency = np.array([[0.0, 0.004], [3.0, 9.0]])
    found = panels.hankel(frequency, split_angle=split)
    node, weight = np.polynomial.legendre.leggauss(200)
    angle = 0.1 + (split - 0.1) * (node + 1) / 2
    share = np.sin(angle) / 2 * weight * (split - 0.1) / 2
    expected = j0(frequency[..., None] * angle) @ share
    # J0 of the head to the second order: 1 - (q t)^2 / 4.
    head = 0.1**2 / 2 / (2 - head_exponent)
    fourth = 0.1**4 / 2 / (4 - head_exponent) / 4
    expected += head - frequency**2 * fourth
    assert_allclose(found, expected, atol=1e-9)


def test_narrow_and_wide_panels_have_one_transform() -> None:
    def light(angle):
        return np.exp(-3 * angle)

    peak = np.geomspace(1e-6, 0.2, 30)
    edges = np.concatenate([peak, [0.21, 0.22, 0.235, 0.5, 1.0, np.pi]])
    frequency = np.array([0.0, 2.0, 70.0, 900.0])
    found = Panels(light, edges, 0.0).hankel(frequency, split_angle=0.9)
    node, weight = np.polynomial.legendre.leggauss(600)
    angle = 0.9 * (node + 1) / 2
    share = 2 * np.pi * light(angle) * np.sin(angle) * weight * 0.45
    expected = j0(frequency[:, None] * angle) @ share
    assert_allclose(found, expected, atol=1e-10)


def test_many_frequencies_are_worked_out_in_parts() -> None:
    panels = Panels(lambda angle: np.exp(-angle), np.linspace(0.05, np.pi, 400), 0.0)
    frequency = np.linspace(0, 30, 1301)
    found = panels.hankel(frequency, split_angle=3.0)
    for part in (slice(0, 3), slice(498, 504), slice(1299, 1301)):
        alone = panels.hankel(frequency[part], split_angle=3.0)
        assert_allclose(found[part], alone, rtol=1e-12)


def test_slow_and_fast_oscillations_of_one_panel_agree() -> None:
    node, weight = gauss_legendre(16)
    # A panel from 1 to 3, with a light that has the values of a polynomial.
    angle = (2 + node)[None]
    fraction = (1 + angle**3) * weight
    # Panels of half a width of 1 are slow up to 1.5.
    frequency = np.array([0.3, 1.499, 1.501, 4.5])
    found = integrals._oscillating(frequency, angle, fraction)
    dense, share = np.polynomial.legendre.leggauss(200)
    expected = j0(frequency[:, None] * (2 + dense)) @ (share * (1 + (2 + dense) ** 3))
    assert_allclose(found, expected, atol=1e-7)


def test_nodes_of_gauss_are_shared_and_cannot_be_changed() -> None:
    node, weight = gauss_legendre(5)
    assert_allclose(weight @ node**8, 2 / 9, rtol=1e-13)
    assert gauss_legendre(5)[0] is node
    for part in (node, weight):
        with pytest.raises(ValueError, match="read-only"):
            part[0] = 1.0
