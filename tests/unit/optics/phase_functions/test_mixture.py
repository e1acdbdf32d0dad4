"""Claims about mixtures of scatterers, and about Fournier-Forand by backscatter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics.phase_functions.mixture import (
    fournier_forand_with_backscatter,
    mixture,
)
from amulor.optics.phase_functions.models import (
    fournier_forand,
    henyey_greenstein_function,
    rayleigh_phase,
)
from amulor.optics.phase_functions.tables import petzold

PARTS = [
    rayleigh_phase(depolarization=0.039),
    henyey_greenstein_function(asymmetry=0.95),
    petzold("average_particle"),
]
amounts = st.lists(st.floats(0.01, 3.0), min_size=3, max_size=3)


@given(amounts=amounts, angle=st.floats(0.001, np.pi))
def test_a_mixture_scatters_what_its_parts_scatter(amounts, angle):
    mixed = mixture(PARTS, scattering=amounts)
    total = sum(amounts)
    for question in (
        lambda p: p(angle),
        lambda p: p.cumulative(angle),
        lambda p: p.asymmetry,
        lambda p: p.backscatter_fraction,
    ):
        parts = sum(b * question(p) for b, p in zip(amounts, PARTS, strict=True))
        assert_allclose(question(mixed), parts / total, rtol=1e-9)


def test_forward_part_and_transform_are_means_too():
    amounts = np.array([0.2, 1.0, 0.5])
    mixed, split = mixture(PARTS, scattering=amounts), 0.6
    q = np.array([0.0, 1.0, 30.0, 1e4])
    fractions, moments = np.array([p.forward_split(split) for p in PARTS]).T
    held = amounts * fractions
    found = mixed.forward_split(split)
    assert_allclose(found[0], held.sum() / amounts.sum(), rtol=1e-9)
    assert_allclose(found[1], held @ moments / held.sum(), rtol=1e-9)
    each = np.array([p.hankel(q, split_angle=split) for p in PARTS])
    # The transforms have an error of 1e-10 of their value at 0.
    assert_allclose(
        mixed.hankel(q, split_angle=split), held @ each / held.sum(), rtol=0, atol=1e-8
    )


def test_what_scatters_nothing_is_left_out():
    assert mixture(PARTS, scattering=[0.0, 2.0, 0.0]) is PARTS[1]


@pytest.mark.parametrize("scattering", [[1.0, 2.0], [0.0, 0.0, 0.0], [-1.0, 1.0, 1.0]])
def test_amounts_that_cannot_be_are_refused(scattering):
    with pytest.raises(ValueError, match="scattering"):
        mixture(PARTS, scattering=scattering)


def test_the_line_of_mobley_2002_meets_the_published_pair():
    # Index 1.10 and slope 3.5835 stand for the 0.0183 of Petzold's average particle.
    published = fournier_forand(relative_index=1.10, slope=3.5835)
    angle = np.radians([1.0, 10.0, 90.0, 180.0])
    assert_allclose(
        fournier_forand_with_backscatter(0.0183)(angle), published(angle), rtol=2e-3
    )


@given(fraction=st.floats(3e-4, 0.2))
def test_it_has_the_backscatter_fraction_that_is_asked_for(fraction):
    function = fournier_forand_with_backscatter(fraction)
    assert function.backscatter_fraction == pytest.approx(fraction, rel=1e-6)
    # By quadrature, not by the closed form that it was found with; what the form
    # leaves out of 1 forwards is in it, too.
    beyond = function.panels.mean(np.ones_like, low=np.pi / 2)
    assert beyond == pytest.approx(fraction, rel=1e-3)
