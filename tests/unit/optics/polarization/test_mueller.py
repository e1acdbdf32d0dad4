"""Claims about Mueller matrices of targets and particles, and analyser readings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.polarization import depolarization, mueller, stokes

angles = st.floats(-np.pi, np.pi)
seeds = st.integers(0, 2**32 - 1)


def random_jones(seed, count=1):
    rng = np.random.default_rng(seed)
    shape = (count, 2, 2)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.mark.parametrize(
    ("pair", "expected"),
    # Eqs. (68) and (69) as rebuilt: 80.5 %, 19.5 %, (1 + m44)/2 with m44 = -0.46.
    [
        ("VV", 0.805),
        ("VH", 0.195),
        ("HH", 0.805),
        ("HV", 0.195),
        ("RR", 0.27),
        ("LL", 0.27),
        ("RL", 0.73),
        ("LR", 0.73),
        ("PP", 0.195),
        ("PM", 0.805),
        ("none", 1.0),
    ],
)
def test_painted_metal_reads_the_published_shares(pair, expected):
    share = mueller.detected_fraction(mueller.painted_metal(), pair=pair)
    assert_allclose(share, expected, rtol=1e-14)


@pytest.mark.parametrize(("m44", "expected"), [(-0.22, 0.39), (-0.61, 0.195)])
def test_same_helicity_share_follows_m44(m44, expected):
    matrix = mueller.painted_metal(m44=m44)
    share = mueller.detected_fraction(matrix, pair="RR")
    assert_allclose(share, expected, rtol=1e-14)


def test_painted_metal_keeps_61_percent_linear_polarization():
    out = mueller.apply(mueller.painted_metal(), stokes.state("H"))
    assert_allclose(out, [1, 0.61, 0, 0], rtol=1e-15)


def test_painted_metal_is_realizable_up_to_m44_of_minus_0_22():
    m44 = np.array([-1.0, -0.61, -0.46, -0.22, -0.21, -0.10, 0.46])
    defect = depolarization.realizability_defect(mueller.diagonal(0.61, -0.61, m44))
    # Smallest eigenvalue (1 - m22 + m33 - m44) / 4 = (-0.22 - m44) / 4.
    assert_allclose(defect, [0, 0, 0, 0, 0.0025, 0.03, 0.17], rtol=0, atol=1e-15)
    possible = depolarization.is_realizable(mueller.diagonal(0.61, -0.61, m44))
    assert_array_equal(possible, [True] * 4 + [False] * 3)


def test_a_mirror_flips_helicity_and_diagonals_but_keeps_horizontal_and_vertical():
    shares = {
        pair: mueller.detected_fraction(mueller.ideal_backscatter(), pair=pair)
        for pair in ("HH", "VV", "VH", "PP", "PM", "RR", "RL", "LR")
    }
    assert shares == {
        "HH": 1,
        "VV": 1,
        "VH": 0,
        "PP": 0,
        "PM": 1,
        "RR": 0,
        "RL": 1,
        "LR": 1,
    }


def test_a_mirror_is_the_jones_matrix_that_turns_the_perpendicular_axis_round(
    mueller_of,
):
    matrix = mueller_of(np.diag([1.0, -1.0]))
    assert_allclose(matrix, mueller.ideal_backscatter(), rtol=0, atol=1e-15)


def test_an_ideal_depolarizer_gives_every_analyser_half():
    for pair in ("HH", "HV", "PM", "RR", "LR"):
        share = mueller.detected_fraction(mueller.ideal_depolarizer(), pair=pair)
        assert share == 0.5
    assert depolarization.depolarization_index(mueller.ideal_depolarizer()) == 0
    assert depolarization.depolarization_effect(mueller.ideal_depolarizer()) == 0


@settings(deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=16, max_size=16), st.sampled_from("HVPMRL"))
def test_two_crossed_analysers_share_all_the_light(elements, launched):
    matrix = np.reshape(elements, (4, 4))
    power = mueller.apply(matrix, stokes.state(launched))[0]
    for one, other in ("HV", "PM", "RL"):
        shares = [
            mueller.detected_fraction(matrix, pair=launched + second)
            for second in (one, other)
        ]
        assert_allclose(sum(shares), power, rtol=0, atol=1e-14)


def test_rayleigh_at_90_degrees_is_polarized_across_the_scattering_plane():
    out = mueller.apply(mueller.rayleigh(np.pi / 2), stokes.state("none"))
    # m12 = -1: all of it is perpendicular, Q < 0.
    assert_allclose(out, [1, -1, 0, 0], rtol=0, atol=1e-15)


def test_rayleigh_backscatter_is_the_ideal_one_and_forward_is_nothing():
    matrix = mueller.rayleigh([0.0, np.pi])
    assert_allclose(matrix[0], np.eye(4), rtol=0, atol=1e-15)
    assert_allclose(matrix[1], np.diag([1, 1, -1, -1]), rtol=0, atol=1e-15)


@settings(deadline=None)
@given(st.floats(0, np.pi))
def test_rayleigh_is_a_dipole(mueller_of, angle):
    # A dipole radiates its parallel part as the cosine of the angle.
    matrix = mueller_of(np.diag([np.cos(angle), 1.0]))
    assert_allclose(mueller.rayleigh(angle), matrix / matrix[0, 0], rtol=0, atol=1e-14)


@settings(deadline=None)
@given(st.floats(0, np.pi))
def test_rayleigh_does_not_depolarize(angle):
    matrix = mueller.rayleigh(angle)
    assert_allclose(depolarization.depolarization_index(matrix), 1, rtol=1e-14)
    assert depolarization.is_realizable(matrix)


@settings(deadline=None)
@given(seeds)
def test_no_jones_matrix_depolarizes_and_each_is_realizable(mueller_of, seed):
    matrix = mueller_of(random_jones(seed)[0])
    assert_allclose(depolarization.depolarization_index(matrix), 1, rtol=1e-12)
    # Three eigenvalues are zero, up to rounding.
    assert depolarization.realizability_defect(matrix) < 1e-12
    values = np.linalg.eigvalsh(depolarization.coherency_matrix(matrix))
    assert_allclose(values[:3], 0, rtol=0, atol=1e-12 * values[3])


@settings(deadline=None, max_examples=50)
@given(seeds, st.integers(2, 5))
def test_mixtures_are_realizable_and_depolarize(mueller_of, seed, count):
    matrix = sum(mueller_of(jones) for jones in random_jones(seed, count))
    assert depolarization.is_realizable(matrix)
    assert depolarization.depolarization_index(matrix) < 1


def test_turning_helicity_without_turning_diagonals_is_not_realizable():
    # diag(1, 1, 1, -1): eigenvalues 1/2 three times, and -1/2.
    matrix = mueller.diagonal(1, 1, -1)
    assert_allclose(depolarization.realizability_defect(matrix), 0.5, rtol=1e-14)
    assert not depolarization.is_realizable(matrix)
    assert depolarization.is_realizable(matrix, tolerance=0.51)


@settings(deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_defect_of_a_diagonal_matrix_is_its_closed_form(a, b, c):
    least = min(1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c) / 4
    defect = depolarization.realizability_defect(mueller.diagonal(a, b, c))
    assert_allclose(defect, max(0.0, -least), rtol=0, atol=1e-14)


def test_trace_of_the_coherency_matrix_is_m11():
    matrix = 3.0 * mueller.painted_metal()
    coherency = depolarization.coherency_matrix(matrix)
    assert_allclose(np.trace(coherency), 3.0, rtol=1e-15)
    assert_allclose(coherency, coherency.conj().T, rtol=0, atol=1e-15)


def test_depolarization_figures_of_painted_metal():
    matrix = mueller.painted_metal()
    # sqrt((2 * 0.61^2 + 0.46^2) / 3) and (0.61 + 0.61 + 0.46) / 3.
    expected = np.sqrt((2 * 0.3721 + 0.2116) / 3)
    assert_allclose(depolarization.depolarization_index(matrix), expected, rtol=1e-14)
    assert_allclose(depolarization.depolarization_effect(matrix), 0.56, rtol=1e-14)


@settings(deadline=None)
@given(seeds, st.floats(1e-3, 1e3), angles)
def test_figures_depend_on_the_reduced_matrix_alone(mueller_of, seed, factor, angle):
    matrix = sum(mueller_of(jones) for jones in random_jones(seed, 2))
    scaled = factor * matrix
    assert_allclose(
        depolarization.depolarization_index(scaled),
        depolarization.depolarization_index(matrix),
    )
    assert_allclose(
        depolarization.depolarization_effect(scaled),
        depolarization.depolarization_effect(matrix),
    )
    # The index does not depend on the axes either.
    assert_allclose(
        depolarization.depolarization_index(mueller.rotated(matrix, angle=angle)),
        depolarization.depolarization_index(matrix),
        rtol=1e-13,
    )


def test_arguments_broadcast():
    matrices = mueller.diagonal(np.ones((3, 1)), -1.0, [-1.0, -0.5])
    assert matrices.shape == (3, 2, 4, 4)
    assert mueller.apply(matrices, np.ones((2, 4))).shape == (3, 2, 4)
    assert mueller.detected_fraction(matrices, pair="RL").shape == (3, 2)
    assert mueller.detected_fraction(matrices, pair="none").shape == (3, 2)
    assert depolarization.depolarization_index(matrices).shape == (3, 2)
    assert depolarization.is_realizable(matrices).shape == (3, 2)
    assert mueller.rayleigh(np.zeros((5, 2))).shape == (5, 2, 4, 4)


def test_the_share_without_polarizers_is_a_copy():
    matrix = np.eye(4)
    share = mueller.detected_fraction(matrix, pair="none")
    matrix[0, 0] = 5.0
    assert share == 1.0


@pytest.mark.parametrize("pair", ["", "V", "VX", "vv", "VHH", "None"])
def test_an_unknown_pair_is_refused(pair):
    with pytest.raises(ValueError, match="pair must be 'none' or two letters"):
        mueller.detected_fraction(np.eye(4), pair=pair)


@pytest.mark.parametrize("m44", [-1.01, -0.21, 0.46, np.nan])
def test_a_painted_metal_that_cannot_exist_is_refused(m44):
    with pytest.raises(ValueError, match=r"m44 must be from -1 to -0\.22"):
        mueller.painted_metal(m44=m44)


def test_what_is_no_mueller_matrix_is_refused():
    with pytest.raises(ValueError, match=r"last axes \(4, 4\), got \(4, 3\)"):
        mueller.apply(np.ones((4, 3)), np.ones(4))
    with pytest.raises(
        ValueError, match=r"last axes \(4,\) \(I, Q, U, V\), got \(3,\)"
    ):
        mueller.apply(np.eye(4), np.ones(3))
    with pytest.raises(ValueError, match=r"m11 of mueller must be above 0, .* got 0"):
        depolarization.depolarization_index(np.zeros((4, 4)))


def test_arguments_outside_of_their_range_are_refused():
    with pytest.raises(ValueError, match="m33 must be from -1 to 1"):
        mueller.diagonal(1.0, -1.5, 0.0)
    with pytest.raises(ValueError, match="m34 must be from -1 to 1"):
        mueller.particles(m12=0.0, m22=1.0, m33=1.0, m34=1.1, m44=1.0)
    with pytest.raises(ValueError, match="angle must be from 0 to pi"):
        mueller.rayleigh(180.0)
    with pytest.raises(ValueError, match="tolerance must be finite and not negative"):
        depolarization.is_realizable(np.eye(4), tolerance=-1.0)


@settings(deadline=None)
@given(st.floats(0, np.pi))
def test_particles_hold_the_matrix_of_a_jones_matrix_that_is_diagonal(
    mueller_of, angle
):
    # A sphere: amplitudes S2 in the scattering plane and S1 across it.
    s1, s2 = np.exp(0.3j) * np.cos(angle / 3), np.exp(1.1j) * np.cos(angle)
    matrix = mueller_of(np.diag([s2, s1]))
    reduced = matrix / matrix[0, 0]
    made = mueller.particles(
        m12=np.clip(reduced[0, 1], -1, 1),
        m22=1.0,
        m33=reduced[2, 2],
        m34=reduced[2, 3],
        m44=reduced[3, 3],
    )
    assert_allclose(made, reduced, rtol=0, atol=1e-14)


@settings(deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_a_lower_m22_alone_makes_the_mueller_matrix_depolarize(m12, m22, m33):
    matrix = mueller.particles(m12=m12, m22=m22, m33=m33, m34=0.0, m44=m33)
    # Gil and Bernabeu's index from the elements, eq. (61).
    expected = np.sqrt((2 * m12**2 + m22**2 + 2 * m33**2) / 3)
    assert_allclose(depolarization.depolarization_index(matrix), expected, atol=1e-15)
