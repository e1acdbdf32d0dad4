"""Faces of plane layers: Fresnel's formulas, polarization, rough surfaces."""

from __future__ import annotations

import layer_with_faces
import numba
import numpy as np
import pytest

from amulor.optics.phase_functions.models import isotropic
from amulor.transport import (
    Layer,
    Medium,
    ScatteringMatrix,
    reflection_and_transmission,
)
from amulor.transport._kernels.interfaces import Interface, cross_interface
from amulor.transport._kernels.sampling import uniform
from amulor.transport._runs import random_state

#: Largest deviation in standard errors; of some 200 comparisons in this file one in
#: 16,000 would be above 4.
SIGMAS = 4.0


def slab(albedo, thickness):
    """Return a layer of Rayleigh scatterers, of attenuation 1 1/m."""
    layer = Layer(
        absorption=1 - albedo,
        scattering=albedo,
        phase_function=ScatteringMatrix.rayleigh(),
        thickness=thickness,
    )
    return Medium.layered([layer], group_index=1.0)


def field_ratios(angle, index):
    """Return Fresnel's field ratios along and across the plane, in sines and tangents.

    Light comes from outside; with the axes of the page on polarization both have the
    same sign at small angles.
    """
    inside = np.arcsin(np.sin(angle) / index)
    less, more = angle - inside, angle + inside
    return np.tan(less) / np.tan(more), -np.sin(less) / np.sin(more)


def test_no_light_in_the_plane_of_incidence_is_reflected_at_brewsters_angle():
    index = 1.34
    tally = reflection_and_transmission(
        slab(0.0, np.inf), [0.0], histories=20_000, seed=1, polarization="H",
        incidence=np.arctan(index), index_ratio=index,
    )  # fmt: skip
    assert tally.part("reflected")[0][0, 0].real == 0.0


@pytest.mark.parametrize("incidence", [0.5, 1.3])
def test_a_clear_slab_passes_the_echoes_of_both_polarizations(incidence):
    # The matrix of all echoes is T A / (1 - R^2 A^2) T, element by element.
    index, stokes = 1.4, np.array([1.0, 0.4, 0.5, -0.6])
    tally = reflection_and_transmission(
        slab(0.0, 0.6), [0.0], histories=200_000, seed=2, polarization=stokes,
        incidence=incidence, index_ratio=index,
    )  # fmt: skip
    along, across = field_ratios(incidence, index)
    left = np.exp(-0.6 / np.sqrt(1 - (np.sin(incidence) / index) ** 2))
    passed = np.array([1 - along**2, 1 - across**2])
    ratio = np.array([along**2, across**2])
    direct = passed**2 * left / (1 - (ratio * left) ** 2)
    crossed = np.prod(passed) * left / (1 - (along * across * left) ** 2)
    both = 0.5 * (1 + stokes[1]) * direct[0], 0.5 * (1 - stokes[1]) * direct[1]
    expected = [
        both[0] + both[1], both[0] - both[1], crossed * stokes[2], crossed * stokes[3]
    ]  # fmt: skip
    found, covariance = tally.part("transmitted")
    error = np.sqrt(covariance[:, 0, 0, 0])
    assert np.all(np.abs(found[:, 0].real - expected) < SIGMAS * error), (
        found[:, 0].real - expected
    ) / error
    assert np.all(error < 2e-3)


CASES = {
    "a surface above": ({"near": 1.34}, 0.9, (1, 0.5, 0.3, 0.6)),
    "a plate": ({"near": 1.5, "far": 1.3}, 0.4, (1, -0.3, 0.6, -0.5)),
    "total reflection": ({"near": 1.8, "far": 1.8}, 1.2, (1, 0.2, -0.7, 0.5)),
    "waves": ({"near": 1.34, "slope": 0.15}, 0.7, (1, 0.5, 0.3, 0.6)),
    "steep waves at a low sun": (
        {"near": 1.34, "far": 1.2, "slope": 0.25}, 1.2, (1, -0.5, 0.3, 0.6)
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.study if case.startswith("steep") else ())
        for case in CASES
    ],
)
def test_scattered_light_agrees_with_coherency_matrices(case):
    faces, incidence, stokes = CASES[case]
    layer = layer_with_faces.Layer(albedo=0.9, thickness=1.5, **faces)
    photons = 40_000
    side, _, vector, _ = layer_with_faces.light(
        layer, incidence=incidence, stokes=stokes, photons=photons, seed=3
    )
    tally = reflection_and_transmission(
        slab(0.9, 1.5), [0.0], histories=300_000, seed=4, polarization=stokes,
        incidence=incidence, index_ratio=(layer.near, layer.far),
        rms_slope=layer.slope,
    )  # fmt: skip
    for k, name in enumerate(("reflected", "transmitted")):
        found, covariance = tally.part(name)
        light = vector * (side == k)[:, np.newaxis]
        mean = light.sum(axis=0) / photons
        variance = ((light**2).sum(axis=0) / photons - mean**2) / photons
        error = np.sqrt(variance + covariance[:, 0, 0, 0])
        difference = found[:, 0].real - mean
        assert np.all(np.abs(difference) < SIGMAS * error), difference / error
        assert np.all(error < 6e-3)


@pytest.mark.parametrize("polarization", ["none", (1, 0.5, 0.3, 0.6)])
def test_radiant_intensities_add_up_to_the_scattered_light(polarization):
    # Gauss nodes in the cosine, and five azimuths, as Rayleigh light has two waves.
    index, incidence, albedo, thickness = (1.4, 1.2), 0.6, 0.9, 0.8
    node, weight = np.polynomial.legendre.leggauss(8)
    cosine = np.concatenate([-(node + 1) / 2, (node + 1) / 2])
    weight = np.concatenate([weight, weight]) / 2 * 2 * np.pi / 5
    azimuth = 0.3 + 2 * np.pi * np.arange(5) / 5
    outward = [(np.arccos(mu), phi) for mu in cosine for phi in azimuth]
    tally = reflection_and_transmission(
        slab(albedo, thickness), [0.0], histories=20_000, seed=5,
        polarization=polarization, incidence=incidence, index_ratio=index,
        outward=outward,
    )  # fmt: skip
    clear = reflection_and_transmission(
        slab(0.0, thickness), [0.0], histories=400_000, seed=6,
        polarization=polarization, incidence=incidence, index_ratio=index,
    )  # fmt: skip
    light = np.array(
        [tally.part(f"direction {k + 1}")[0][:, 0].real for k in range(len(outward))]
    )
    summed = np.einsum("kas,k->ks", light.reshape(16, 5, 4), weight)
    for name, side in (("reflected", cosine < 0), ("transmitted", cosine > 0)):
        found, covariance = tally.part(name)
        direct, direct_covariance = clear.part(name)
        scattered = found[:, 0].real - direct[:, 0].real
        variance = covariance[:, 0, 0, 0] + direct_covariance[:, 0, 0, 0]
        error = np.sqrt(variance) + 1e-4
        difference = summed[side].sum(axis=0) - scattered
        assert np.all(np.abs(difference) < SIGMAS * error), difference / error
        assert scattered[0] > 0.1


def test_no_light_is_lost_at_a_rough_surface():
    layer = Layer(
        absorption=0.0, scattering=1.0, phase_function=isotropic(), thickness=1.0
    )
    tally = reflection_and_transmission(
        Medium.layered([layer], group_index=1.0), [0.0], histories=20_000, seed=7,
        incidence=1.4, index_ratio=(1.34, 1.0), rms_slope=0.3,
    )  # fmt: skip
    total = sum(tally.part(name)[0][0, 0].real for name in tally.parts)
    assert total == pytest.approx(1, abs=1e-12)


@numba.njit
def _at_a_rough_face(state, count, inside, interface, cosines):
    """Send diffuse light to a face; fill the cosines before and after, below 0 inside.

    Diffuse light is even in the square of the sine.
    """
    now = np.zeros(7)
    for k in range(count):
        square = uniform(state)
        azimuth = 2 * np.pi * uniform(state)
        sine = np.sqrt(square)
        z = np.sqrt(1 - square) * (-1.0 if inside else 1.0)
        n = (sine * np.cos(azimuth), sine * np.sin(azimuth), z)
        stays, m = cross_interface(state, n, now, False, inside, interface)
        cosines[k, 0] = abs(z)
        cosines[k, 1] = -abs(m[2]) if stays else abs(m[2])


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_paths_through_a_rough_surface_are_reciprocal(slope):
    # Of diffuse light, as much goes from one bin of directions to another as back; n^2
    # times as much inside.
    index, count, edges = 1.34, 400_000, np.linspace(0, 1, 5)
    interface = Interface(ratio=index, slope=slope, outward=-1.0)
    counts = {}
    for inside in (False, True):
        cosines = np.empty((count, 2))
        _at_a_rough_face(
            random_state(8, int(inside)), count, inside, interface, cosines
        )
        ends = np.concatenate([-edges[:0:-1], edges])
        counts[inside] = np.histogram2d(*cosines.T, bins=(edges, ends))[0]
    # Columns: the light that ends inside, from -1 to 0, and outside, from 0 to 1.
    into = counts[False][:, 3::-1]
    out = counts[True][:, 4:].T * index**2
    outside, inside = counts[False][:, 4:], counts[True][:, 3::-1]
    pairs = [(into, out, index**4), (outside, outside.T, 1.0), (inside, inside.T, 1.0)]
    for one, other, factor in pairs:
        variance = one + other * np.sqrt(factor)
        keep = variance > 50
        deviation = (one - other)[keep] / np.sqrt(variance[keep])
        assert np.all(np.abs(deviation) < SIGMAS), deviation
