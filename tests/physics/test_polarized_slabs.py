"""Polarized radiance of plane slabs against three published tables, in two ways."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plane_parallel
import plane_parallel_vector as vector
import pytest
from numpy.testing import assert_allclose
from scipy.special import eval_jacobi, eval_legendre

from amulor.optics.phase_functions.tables import tabulated
from amulor.transport import (
    Layer,
    Medium,
    ScatteringMatrix,
    reflection_and_transmission,
)

REFERENCE = Path(__file__).parents[1] / "reference"
ROWS = np.loadtxt(REFERENCE / "polarized_slabs.csv", delimiter=",")
#: Thickness, albedo, cosine of the incidence and largest printed error, by case.
CASES = {
    1: (0.5, 1.0, 0.2, 4e-8),
    2: (0.3262, 1.0, 0.5, 6e-7),
    3: (1.0, 0.973527, 0.6, 6e-6),
}
SIGMAS = 4.0


def spheroids(angle: np.ndarray) -> np.ndarray:
    """Return the scattering matrix times 4 pi, from the published coefficients."""
    x = np.cos(angle)
    matrix = np.zeros((*angle.shape, 4, 4))
    for row in np.loadtxt(REFERENCE / "polarized_spheroids.csv", delimiter=","):
        order, a1, a2, a3, a4, b1, b2 = int(row[0]), *row[1:]
        matrix[..., 0, 0] += a1 * eval_legendre(order, x)
        matrix[..., 3, 3] += a4 * eval_legendre(order, x)
        if order < 2:
            continue
        factor = np.sqrt((order + 2) * (order + 1) * order * (order - 1)) / 4
        across = factor * (1 - x**2) * eval_jacobi(order - 2, 2, 2, x)
        across *= 1 / (order * (order - 1))
        same = (a2 + a3) * ((1 + x) / 2) ** 2 * eval_jacobi(order - 2, 0, 4, x)
        other = (a2 - a3) * ((1 - x) / 2) ** 2 * eval_jacobi(order - 2, 4, 0, x)
        matrix[..., 1, 1] += (same + other) / 2
        matrix[..., 2, 2] += (same - other) / 2
        matrix[..., 0, 1] -= b1 * across
        matrix[..., 2, 3] -= b2 * across
    matrix[..., 1, 0], matrix[..., 3, 2] = matrix[..., 0, 1], -matrix[..., 2, 3]
    return matrix


def rows_of(case: int) -> np.ndarray:
    return ROWS[ROWS[:, 0] == case][:, 1:]


@pytest.mark.parametrize("case", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_deterministic_solver_has_the_printed_radiance(case):
    thickness, albedo, incidence, error = CASES[case]
    angle = np.linspace(0, np.pi, 721)
    scatterers = (
        vector.tabulated(angle, spheroids(angle), azimuths=32)
        if case == 3
        else vector.rayleigh()
    )
    rows = rows_of(case)
    cosines = np.unique(rows[:, 1])
    field = plane_parallel.slab(
        scatterers,
        albedo=albedo,
        thickness=thickness,
        incidence=incidence,
        cosines=cosines,
        orders=12 if case == 3 else 3,
        nodes=16 if case == 3 else 24,
    )
    for side, cosine, degrees, *expected in rows:
        radiance = (
            field.reflected_radiance if side > 0 else field.transmitted_radiance
        )([1, 0, 0, 0], azimuth=np.radians(degrees))
        found = np.pi * radiance[np.searchsorted(cosines, cosine), 0, :3]
        printed = np.isfinite(expected)
        assert_allclose(
            np.real(found)[printed], np.array(expected)[printed], rtol=0, atol=error
        )


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_photons_have_the_printed_radiance(case):
    thickness, albedo, incidence, _ = CASES[case]
    rows = rows_of(case)
    matrix = ScatteringMatrix.rayleigh()
    if case == 3:
        angle = np.linspace(0, np.pi, 3601)
        full = spheroids(angle)
        first = full[:, 0, 0]
        function = tabulated(angle, value=first / (4 * np.pi))
        matrix = ScatteringMatrix.tabulated(
            angle, mueller=full / first[:, None, None], phase_function=function
        )
    layer = Layer(
        absorption=1 - albedo,
        scattering=albedo,
        phase_function=matrix,
        thickness=thickness,
    )
    polar = np.where(rows[:, 0] > 0, np.pi, 0) - rows[:, 0] * np.arccos(rows[:, 1])
    tally = reflection_and_transmission(
        Medium.layered([layer], group_index=1.0),
        [0.0],
        histories=200_000,
        seed=case,
        incidence=np.arccos(incidence),
        outward=np.stack([polar, np.radians(rows[:, 2])], axis=-1),
    )
    worst = []
    for number, (_, cosine, _, *expected) in enumerate(rows, 1):
        found, covariance = tally.part(f"direction {number}")
        # Radiant intensity over the power to radiance over the flux pi.
        scale = np.pi * incidence / cosine
        error = np.sqrt(covariance[:3, 0, 0, 0]) * scale
        printed = np.isfinite(expected)
        away = (found[:3, 0].real * scale - expected)[printed]
        worst.append(np.max(np.abs(away) / (error[printed] + 1e-6)))
        assert np.all(error < 0.02 * expected[0])
    assert max(worst) < SIGMAS, worst
