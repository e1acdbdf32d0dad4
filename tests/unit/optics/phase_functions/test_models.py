"""Claims about phase functions as objects, and the integrals that they rest on."""

import itertools
import pickle

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import special
from scipy.integrate import quad

from amulor.optics import phase_functions
from amulor.optics.phase_functions.integrals import INNERMOST_ANGLE, Panels
from amulor.optics.phase_functions.models import (
    fournier_forand,
    henyey_greenstein_function,
    isotropic,
    rayleigh_phase,
    two_term,
)
from amulor.optics.phase_functions.phase_function import PhaseFunction

MODELS = {
    "isotropic": isotropic(),
    "rayleigh": rayleigh_phase(depolarization=0.039),
    "henyey_greenstein": henyey_greenstein_function(asymmetry=0.97),
    "steep": henyey_greenstein_function(asymmetry=0.999999),
    "backward": henyey_greenstein_function(asymmetry=-0.9),
    "two_term": two_term(
        forward_asymmetry=0.95, backward_asymmetry=-0.5, forward_weight=0.96
    ),
    "fournier_forand": fournier_forand(relative_index=1.1, slope=3.5835),
}
models = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
splits = st.floats(0.01, np.pi)


def planar(shape, *, head_exponent=0.0):
    """Return a function whose p sin(angle) is shape(angle) times the angle."""

    def value(angle):
        return shape(angle) * angle / np.sin(np.minimum(angle, 3.0))

    edges = np.append(np.geomspace(INNERMOST_ANGLE, 3.0, 42), np.pi)
    return PhaseFunction(name="planar", panels=Panels(value, edges, head_exponent))


def test_transform_of_a_uniform_disc_is_the_airy_pattern():
    k = np.concatenate([[0.0], np.geomspace(0.1, 1e5, 60)])
    disc = planar(np.ones_like)
    found = disc.hankel(k, split_angle=1.2)
    expected = np.ones_like(k)
    expected[1:] = 2 * special.j1(1.2 * k[1:]) / (1.2 * k[1:])
    # Promised: 1e-10.
    assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert found[0] == pytest.approx(1, abs=1e-15)


def test_transform_of_a_gauss_function_is_one():
    width = 0.003
    lobe = planar(lambda angle: np.exp(-((angle / width) ** 2) / 2))
    k = np.geomspace(1.0, 1e5, 40)
    # Beyond the split of 100 widths there is nothing.
    found = lobe.hankel(k, split_angle=0.3)
    assert_allclose(found, np.exp(-((k * width) ** 2) / 2), rtol=0, atol=1e-10)


@pytest.mark.parametrize("exponent", [0.7, 1.2, 1.6, 1.95])
def test_transform_of_a_power_law_is_hypergeometric(exponent):
    # int t^(1-s) J0(kt) = S^(2-s) / (2-s) 1F2(1 - s/2; 1, 2 - s/2; -k^2 S^2 / 4).
    peak = planar(lambda angle: angle**-exponent, head_exponent=exponent)
    k, split = np.geomspace(0.3, 1e5, 12), 1.5
    expected = [
        float(
            mpmath.hyp1f2(
                1 - exponent / 2, 1, 2 - exponent / 2, -((x * split) ** 2) / 4
            )
        )
        for x in k
    ]
    assert_allclose(peak.hankel(k, split_angle=split), expected, rtol=0, atol=1e-10)


def test_transform_of_the_steepest_peak_is_an_exponential():
    # For g -> 1, p -> (1 - g) / (2 pi ((1 - g)^2 + angle^2)^(3/2)), transform
    # exp(-(1 - g) k) but for what lies beyond the split, 1e-6 of the whole.
    k = np.geomspace(1e3, 1e7, 9)
    found = MODELS["steep"].hankel(k, split_angle=1.5)
    assert_allclose(found, np.exp(-1e-6 * k), rtol=0, atol=2e-6)


@models
@settings(deadline=None, max_examples=8)
@given(splits, st.floats(0, 30))
def test_transform_is_the_integral_by_another_rule(model, split, k):
    def ring(log_angle, wave):
        angle = min(np.exp(log_angle), np.pi)
        weight = float(model(angle)) * np.sin(angle) * angle
        return weight * special.j0(k * angle) if wave else weight

    edges = np.log([1e-30, 1e-18, 1e-12, 1e-8, 1e-6, 1e-4, 1e-2, 0.1, 1.0, np.pi])
    edges = np.append(edges[edges < np.log(split)], np.log(split))

    def integral(wave):
        return sum(
            quad(ring, a, b, args=(wave,), epsabs=1e-12, epsrel=1e-11, limit=200)[0]
            for a, b in itertools.pairwise(edges)
        )

    expected = integral(True) / integral(False)
    found = model.hankel(k, split_angle=split)
    # Promised: 1e-10, by quad as well on each of nine pieces; below 1e-30 rad lies
    # 1e-17 of the Fournier-Forand function.
    assert_allclose(found, expected, rtol=0, atol=1e-9)


@models
def test_transform_starts_with_the_second_moment(model):
    _, moment = model.forward_split(np.pi / 2)
    k = 1e-2
    # Next term: k^4 <angle^4> / 64, below 1e-8 * 6 / 64.
    found = model.hankel(k, split_angle=np.pi / 2)
    assert_allclose(1 - found, k**2 * moment / 4, rtol=0, atol=1e-9)


@models
@settings(deadline=None, max_examples=20)
@given(st.floats(-8, 0))
def test_closed_cumulative_is_the_integral(model, decade):
    angle = np.array([np.pi * 10**decade])
    # A peak of width 1e-6 has its 1 - g rounded to 1e-10.
    assert_allclose(
        model.cumulative(angle), model.panels.cumulative(angle), rtol=0, atol=1e-10
    )


@models
def test_the_whole_is_1_and_the_closed_asymmetry_is_the_mean_cosine(model):
    assert_allclose(model.panels.mean(np.ones_like), 1, rtol=1e-10)
    assert_allclose(model.panels.mean(np.cos), model.asymmetry, rtol=0, atol=1e-10)


@models
@settings(deadline=None, max_examples=8)
@given(splits)
def test_forward_split_is_that_of_the_adaptive_rule(model, split):
    found = model.forward_split(split)
    expected = phase_functions.forward_split(model, split_angle=split)
    # 1e-9 is what the adaptive rule promises; below 1e-18 rad lies 1e-8 of the
    # Fournier-Forand function.
    assert_allclose(found, expected, rtol=3e-8)


def test_forward_split_of_henyey_greenstein_is_its_closed_form():
    share, moment = MODELS["henyey_greenstein"].forward_split(np.pi / 2)
    options = {"asymmetry": 0.97, "split_angle": np.pi / 2}
    assert_allclose(
        moment, phase_functions.henyey_greenstein_second_moment(**options), rtol=1e-11
    )
    expected = phase_functions.henyey_greenstein_forward_fraction(**options)
    assert_allclose(share, expected, rtol=1e-14)


def test_backscatter_fractions_and_values_straight_back_are_closed():
    assert isotropic().backscatter_fraction == pytest.approx(0.5, abs=1e-15)
    assert rayleigh_phase().backscatter_fraction == pytest.approx(0.5, abs=1e-15)
    assert_allclose(rayleigh_phase().at_180, 3 / (8 * np.pi), rtol=1e-14)
    g = 0.97
    expected = phase_functions.henyey_greenstein_backscatter_fraction(asymmetry=g)
    model = henyey_greenstein_function(asymmetry=g)
    assert_allclose(model.backscatter_fraction, expected, rtol=0, atol=1e-15)
    assert_allclose(model.at_180, (1 - g) / (4 * np.pi * (1 + g) ** 2), rtol=1e-13)


@given(st.floats(-0.9, 0.99), st.floats(-0.9, 0.9), st.floats(0, 1))
def test_two_terms_add_by_their_weights(first, second, weight):
    model = two_term(
        forward_asymmetry=first, backward_asymmetry=second, forward_weight=weight
    )
    one = henyey_greenstein_function(asymmetry=first)
    other = henyey_greenstein_function(asymmetry=second)
    for question in ("asymmetry", "backscatter_fraction", "at_180"):
        expected = weight * getattr(one, question)
        expected += (1 - weight) * getattr(other, question)
        assert_allclose(getattr(model, question), expected, rtol=1e-12, atol=1e-14)


@models
def test_angles_drawn_from_the_table_have_the_cumulative_within_its_error(model):
    table = model.sampling_table(512)
    share = (np.arange(20_000) + 0.5) / 20_000
    angle = table.angle(share)
    off = np.abs(model.cumulative(angle) - share).max()
    # The stated error is the largest at 15 points a cell, 1/30 of the cell away at
    # most from the worst place of a parabola.
    assert off <= 1.02 * table.error + 1e-12
    # A cell holds 1/256 of the scattering; a quarter of that is the worst parabola.
    assert table.error < 1e-3
    # |mean of cos| moves by twice the distance of the cumulatives; the midpoint rule
    # over 20 000 shares adds 1e-4.
    assert_allclose(np.cos(angle).mean(), model.asymmetry, atol=2 * table.error + 1e-4)
    assert np.all(np.diff(angle) >= 0)


def test_a_finer_table_is_a_better_one_and_isotropic_is_exact():
    model = MODELS["fournier_forand"]
    coarse, fine = model.sampling_table(128), model.sampling_table(1024)
    # Second order in the size of a cell: 64 times better; 30 leaves room.
    assert fine.error < coarse.error / 30
    assert isotropic().sampling_table(16).error < 1e-15
    angle = isotropic().sampling_table(16).angle([0.0, 0.25, 0.5, 1.0])
    assert_allclose(angle, [0, np.pi / 3, np.pi / 2, np.pi], rtol=0, atol=1e-14)


def test_a_head_too_steep_for_the_table_shows_in_its_error():
    # Near the slope 3 a quarter of the scattering lies below 1e-12 rad.
    table = fournier_forand(relative_index=1.02, slope=3.05).sampling_table(256)
    assert table.error > 0.1


@models
def test_models_can_be_pickled(model):
    copy = pickle.loads(pickle.dumps(model))
    assert copy(1.0) == model(1.0)
    assert copy.asymmetry == model.asymmetry


def test_shapes_are_kept():
    model = MODELS["fournier_forand"]
    grid = np.full((2, 3), 0.1)
    assert model(grid).shape == model.cumulative(grid).shape == (2, 3)
    assert model.panels.cumulative(grid).shape == (2, 3)
    assert model.hankel(grid, split_angle=1.0).shape == (2, 3)
    assert model.hankel(3.0, split_angle=1.0).shape == ()
    assert model.hankel([], split_angle=1.0).shape == (0,)


def test_what_cannot_be_asked_is_refused():
    model = MODELS["fournier_forand"]
    with pytest.raises(ValueError, match="infinite at 0"):
        model(0.0)
    with pytest.raises(ValueError, match="angle must be from 0 to pi"):
        model.cumulative(4.0)
    with pytest.raises(ValueError, match="direction_frequency must be from 0 to"):
        model.hankel(-1.0, split_angle=1.0)
    with pytest.raises(
        ValueError, match="split_angle must be above 1e-12 and at most pi"
    ):
        model.hankel(1.0, split_angle=0.0)
    with pytest.raises(ValueError, match="split_angle must be above 1e-12"):
        model.forward_split(1e-13)
    with pytest.raises(ValueError, match="size must be at least 16"):
        model.sampling_table(4)
    with pytest.raises(ValueError, match="fraction must be from 0 to 1"):
        isotropic().sampling_table(16).angle(1.1)
    with pytest.raises(ValueError, match="asymmetry must be from"):
        henyey_greenstein_function(asymmetry=0.9999999)
    with pytest.raises(ValueError, match="forward_weight must be from 0 to 1"):
        two_term(forward_asymmetry=0.9, backward_asymmetry=0.0, forward_weight=1.5)
    with pytest.raises(ValueError, match="slope must be above 3"):
        fournier_forand(relative_index=1.1, slope=2.0)
    with pytest.raises(ValueError, match="depolarization must be from 0 to 1"):
        rayleigh_phase(depolarization=2.0)
    empty = planar(lambda angle: np.where(angle > 1, 1.0, 0.0))
    with pytest.raises(ValueError, match="scatter something below"):
        empty.forward_split(0.5)
    with pytest.raises(ValueError, match="scatter something below"):
        empty.hankel(1.0, split_angle=0.5)
