"""The echo of a diffuse surface against closed forms."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.optics import target_echo

CLEAR = {
    "absorption": 0.0,
    "forward_scattering": 0.0,
    "diffuse_scattering": 0.0,
    "second_moment": 0.0,
    "baseline": 0.0,
    "receiver_radius": 0.01,
}


def test_far_away_the_echo_is_the_lidar_equation() -> None:
    # Without water every receiver of area A sees reflectance / pi * A / d^2 of the
    # launched power once its field of view is full.
    d, area = 50.0, np.pi * 0.01**2
    found = target_echo.target_response(
        0.0,
        depth=d,
        optical_path=2 * d,
        reflectance=0.8,
        acceptance_angle=0.08,
        **CLEAR,
    )
    # Overfilled aperture: R^2 / (gamma d)^2 = 6e-6 is what the limit leaves out.
    assert_allclose(found.real, 0.8 / np.pi * area / d**2, rtol=1e-5)
    assert found.imag == 0


@given(st.floats(1e5, 1e9), st.floats(0.5, 20.0))
def test_a_later_echo_has_a_larger_phase_by_the_group_path(f: float, d: float) -> None:
    optical = 2 * 1.38 * d
    found = target_echo.target_response(
        f,
        depth=d,
        optical_path=optical,
        reflectance=0.5,
        acceptance_angle=0.05,
        **CLEAR,
    )
    expected = np.exp(2j * np.pi * f * optical / speed_of_light)
    assert_allclose(found / abs(found), expected, rtol=1e-9)


@given(st.floats(0.01, 2.0), st.floats(0.1, 5.0))
def test_absorption_counts_both_ways(absorption: float, d: float) -> None:
    arguments = {"depth": d, "optical_path": 0.0, "reflectance": 0.5}
    clear = target_echo.target_response(
        0.0, acceptance_angle=0.05, **arguments, **CLEAR
    )
    murky = target_echo.target_response(
        0.0,
        acceptance_angle=0.05,
        **arguments,
        **(CLEAR | {"absorption": absorption}),
    )
    assert_allclose(murky / clear, np.exp(-2 * absorption * d), rtol=1e-12)
