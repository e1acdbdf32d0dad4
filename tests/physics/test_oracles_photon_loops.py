"""The plain photon loops against tables, the deterministic solver and each other."""

from pathlib import Path

import numpy as np
import plain_photon_loops as loops
import plane_parallel
import plane_parallel_vector as vector
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parents[1]

ELLIPTICAL = (1.0, 0.48, 0.36, 0.8)
EVERYWHERE = {"radius": 1e6, "centre": 0.0, "acceptance": np.pi / 2}


def table(name):
    """Return the rows of a table of reference numbers."""
    return np.loadtxt(TESTS / "reference" / f"{name}.csv", delimiter=",")


def assert_within_errors(batches, expected):
    """Fail if the mean over the first axis is off by more than its own errors.

    4.5 standard errors, from 100 batches: one number in 50 000 by chance.
    """
    for part in (np.real, np.imag):
        values = part(batches)
        error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
        off = np.abs(values.mean(axis=0) - part(expected))
        assert np.all(off <= 4.5 * error + 1e-15), (
            off / np.maximum(error, 1e-15)
        ).max()


def modulations(case, wanted):
    """Return the frequencies of modulations omega / (v c), and the wavenumber of 1."""
    velocity = speed_of_light / case.group_index
    return np.asarray(wanted) * velocity * case.attenuation / (2 * np.pi)


def test_slab_loop_gives_the_modulated_slab_table():
    rows = table("slab_henyey_greenstein_modulated")
    tally = loops.slab(modulation=rows[:, 0], histories=200_000, seed=1)
    assert_within_errors(tally.reflected, rows[:, 1] + 1j * rows[:, 2])
    assert_within_errors(tally.transmitted, rows[:, 3] + 1j * rows[:, 4])


def test_chance_hits_on_an_endless_receiver_are_the_half_space_table():
    rows = table("half_space_isotropic_modulated")
    some = rows[np.isin(rows[:, 0], [0, 0.5, 1])]
    case = loops.Case(
        attenuation=2.5, albedo=0.9, asymmetry=0.0, half_space=True, **EVERYWHERE
    )
    tally = loops.chance_hits(
        case,
        histories=100_000,
        seed=2,
        frequencies=modulations(case, [0, 0.5, 1]),
    )
    assert_within_errors(tally.received, some[0, 1])
    assert_within_errors(tally.signal, some[:, 1] + 1j * some[:, 2])


def test_stokes_loop_gives_the_half_space_of_the_vector_solver():
    asymmetry = 0.3

    def mueller(angle):
        cosine = np.cos(angle)
        m11 = (1 - asymmetry**2) / (1 + asymmetry**2 - 2 * asymmetry * cosine) ** 1.5
        share = m11 / (1 + cosine**2)
        return vector.sphere_matrix(
            m11, -share * np.sin(angle) ** 2, 2 * cosine * share, 0 * share
        )

    case = loops.Case(albedo=0.9, asymmetry=asymmetry, half_space=True, **EVERYWHERE)
    tally = loops.chance_hits_stokes(
        case,
        histories=100_000,
        seed=3,
        launched=ELLIPTICAL,
        frequencies=modulations(case, [0, 0.5]),
    )
    for number, modulation in enumerate([0, 0.5]):
        field = plane_parallel.slab(
            vector.MuellerScatterers(mueller, azimuths=16),
            albedo=0.9,
            thickness=np.inf,
            modulation=modulation,
            nodes=8,
        )
        expected = field.reflected_total @ ELLIPTICAL
        # I and V do not depend on the axes, which differ between the two programs.
        for component in (0, 3):
            assert_within_errors(
                tally.signal[:, number, component], expected[component]
            )


@pytest.mark.parametrize("on_disc", [False, True])
@pytest.mark.parametrize("half_space", [False, True])
def test_local_estimate_agrees_with_chance_hits(on_disc, half_space):
    case = loops.Case(
        asymmetry=0.5,
        albedo=0.9,
        centre=0.5,
        radius=0.8,
        acceptance=0.7,
        half_space=half_space,
    )
    frequencies = np.linspace(0, 60e6, 3)
    plain = loops.chance_hits(case, histories=200_000, seed=4, frequencies=frequencies)
    estimate = loops.local_estimate(
        case,
        histories=100_000,
        seed=5,
        frequencies=frequencies,
        point_on_disc=on_disc,
    )
    # Both have 100 batches, so the difference of batches has the error of both.
    assert_within_errors(plain.signal - estimate.signal, 0.0)
    assert_within_errors(plain.received - estimate.received, 0.0)
    assert_allclose(plain.received, plain.signal[:, 0], rtol=1e-12)
    # 3 % of the light comes here: the comparison is one of a few per cent.
    assert plain.standard_error < 0.02 * plain.mean


def test_local_estimate_of_stokes_vectors_agrees_with_chance_hits():
    case = loops.Case(asymmetry=0.2, albedo=0.9, centre=0.8, radius=0.6, acceptance=0.7)
    arguments = {"launched": ELLIPTICAL, "frequencies": np.linspace(0, 60e6, 3)}
    plain = loops.chance_hits_stokes(case, histories=200_000, seed=6, **arguments)
    estimate = loops.local_estimate_stokes(case, histories=100_000, seed=7, **arguments)
    assert_within_errors(plain.signal - estimate.signal, 0.0)
    polarized = np.abs(estimate.mean[1:]) / estimate.standard_error[1:]
    # None of Q, U, V is lost in the noise here.
    assert np.all(polarized > 5)


def test_light_scattered_once_straight_back_is_mirrored():
    case = loops.Case(
        albedo=0.02, asymmetry=0.0, centre=0.0, radius=0.05, acceptance=0.02
    )
    tally = loops.local_estimate_stokes(
        case, histories=200_000, seed=8, launched=ELLIPTICAL
    )
    # diag(1, 1, -1, -1); a hundredth of what arrives was scattered more than once, and
    # 0.02 rad from straight back depolarizes nothing to 1e-3.
    found = tally.mean[1:] / tally.mean[0]
    assert_allclose(found, [0.48, -0.36, -0.8], rtol=0, atol=0.02)


def test_light_scattered_once_straight_back_has_the_closed_form():
    case = loops.Case(
        attenuation=1.5, albedo=0.01, asymmetry=0.4, radius=1e3, acceptance=0.02
    )
    frequencies = np.linspace(0, 100e6, 3)
    tally = loops.local_estimate(
        case, histories=400_000, seed=9, frequencies=frequencies
    )
    wavenumber = 2 * np.pi * frequencies * case.group_index / speed_of_light
    back = (1 - 0.4**2) / (4 * np.pi * (1 + 0.4) ** 3)
    solid_angle = 2 * np.pi * (1 - np.cos(0.02))
    expected = 0.015 * back * solid_angle / (2 * (1.5 - 1j * wavenumber))
    # Twice scattered light, of the size of the albedo, and 1.6 % of noise: the 4000
    # histories that scatter at all.
    found = tally.signal.mean(axis=0)
    assert np.all(np.abs(found - expected) < 0.06 * expected[0].real)


def test_natural_light_keeps_the_mirror_plane_of_the_receiver():
    case = loops.Case(asymmetry=0.3, centre=0.8, radius=0.4, acceptance=0.7)
    tally = loops.local_estimate_stokes(
        case, histories=100_000, seed=10, launched=(1, 0, 0, 0)
    )
    assert_within_errors(tally.received[:, 2:], 0.0)
    # Scattered through angles about the y axis: polarized along y.
    assert tally.mean[1] < -5 * tally.standard_error[1]


def test_same_seed_gives_the_same_numbers_and_another_seed_others():
    case = loops.Case(radius=1.0, acceptance=0.5)
    first, again, other = (
        loops.local_estimate(case, histories=1000, seed=seed) for seed in (1, 1, 2)
    )
    assert_array_equal(first.signal, again.signal)
    assert not np.array_equal(first.signal, other.signal)


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match="multiple of batches, 100, got 150"):
        loops.chance_hits(histories=150, seed=1)
    with pytest.raises(ValueError, match="evenly spaced"):
        loops.chance_hits(histories=100, seed=1, frequencies=[1e6, 2e6, 4e6])
    with pytest.raises(ValueError, match="intensity 1"):
        loops.chance_hits_stokes(histories=100, seed=1, launched=(1, 1, 1, 0))
