"""The echo of a diffuse surface against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.optics import target_echo
from amulor.optics.phase_functions.models import henyey_greenstein_function

WATER = henyey_greenstein_function(asymmetry=0.95)

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


SCENE = {
    "depth": 3.0,
    "baseline": 0.4,
    "receiver_radius": 0.03,
    "acceptance_angle": 0.08,
    "tilt": 0.05,
    "cross_tilt": -0.02,
    "standoff": 0.2,
}


def test_without_a_way_back_the_surface_is_where_it_is_stated() -> None:
    place, obliquity = target_echo._place(return_path=None, **SCENE)
    names = ("depth", "baseline", "tilt", "cross_tilt", "standoff")
    assert place == {name: SCENE[name] for name in names}
    assert obliquity == 1.0


def test_a_way_back_sets_distance_angle_and_obliquity() -> None:
    place, obliquity = target_echo._place(return_path=3.4, **SCENE)
    # The spot is 0.24 m and 0.064 m beside the axis, 3.6 m away.
    angle = np.arcsin(np.hypot(0.4 - 0.05 * 3.2, 0.02 * 3.2) / 3.6)
    assert set(place) == {"depth", "baseline", "standoff"}
    assert_allclose(place["depth"], 3.2)
    assert_allclose(place["baseline"], 3.6 * angle)
    assert_allclose(place["standoff"], 0.4)
    view = (0.08 * 3.6) ** 2
    assert_allclose(obliquity, np.cos(angle * view / (0.03**2 + view)))


def test_a_way_back_may_just_reach_the_axis() -> None:
    aside = {"depth": 2.0, "baseline": 0.5, "tilt": 0.0, "cross_tilt": 0.0}
    view = {"standoff": 0.0, "receiver_radius": 0.03, "acceptance_angle": 0.08}
    place, _ = target_echo._place(return_path=0.5, **aside, **view)
    assert_allclose(place["baseline"], 0.5 * np.pi / 2)
    text = (
        r"^return_path must be at least the distance of the spot from the receiver "
        r"axis \[m\], got 0\.499$"
    )
    with pytest.raises(ValueError, match=text):
        target_echo._place(return_path=0.499, **aside, **view)
    on_axis, obliquity = target_echo._place(
        return_path=0.0, **(aside | {"baseline": 0.0}), **view
    )
    assert on_axis["baseline"] == 0.0
    assert obliquity == 1.0


def test_an_echo_is_the_overlap_with_reflectance_obliquity_and_delay() -> None:
    found = target_echo._echo(
        np.array([2.0, 3.0]),
        modulation_frequency=50e6,
        optical_path=speed_of_light / 200e6,
        reflectance=0.5,
        cosine=np.array([1.0, 0.25]),
    )
    # A quarter of a period late.
    assert_allclose(found, 1j * np.array([1.0, 0.375]) / np.pi, atol=1e-12)


@pytest.mark.parametrize("return_path", [None, 3.4])
def test_in_clear_water_all_gaussian_models_have_one_echo(
    return_path: float | None,
) -> None:
    common = SCENE | {
        "optical_path": 8.4, "reflectance": 0.4, "cosine": 0.9, "absorption": 0.2,
        "return_path": return_path,
    }  # fmt: skip
    expected = target_echo.target_response(
        60e6,
        forward_scattering=0.0,
        diffuse_scattering=0.0,
        second_moment=0.0,
        **common,
    )
    water = {"scattering": 0.0, "phase_function": WATER, "split_angle": np.pi / 2}
    for model in (
        target_echo.small_angle_target_response,
        target_echo.closure_target_response,
    ):
        assert_allclose(model(60e6, **common, **water), expected, rtol=1e-9)
        # A beam adds its width to that of the receiver.
        wide = {"beam_radius": 0.04, "beam_divergence": 0.06}
        narrow = common | {"receiver_radius": 0.05, "acceptance_angle": 0.1}
        if return_path is None:
            one = model(60e6, **common, **wide, **water)
            other = model(60e6, **narrow, **water)
            taken = (0.03 * 0.08 / (0.05 * 0.1)) ** 2
            assert_allclose(one, taken * other, rtol=1e-9)


def test_a_sharp_receiver_that_sees_all_of_the_spot_has_the_lidar_equation() -> None:
    found = target_echo.sharp_receiver_target_response(
        60e6,
        depth=3.0,
        optical_path=8.4,
        reflectance=0.4,
        cosine=0.9,
        absorption=0.2,
        scattering=0.0,
        phase_function=WATER,
        split_angle=np.pi / 2,
        baseline=0.05,
        receiver_radius=0.03,
        acceptance_angle=0.08,
        tilt=0.01,
        cross_tilt=0.02,
        standoff=0.2,
    )
    area = np.pi * 0.03**2
    loss = np.exp(-2 * 0.2 * 3.0)
    turn = np.exp(2j * np.pi * 60e6 * 8.4 / speed_of_light)
    assert_allclose(found, 0.4 / np.pi * 0.9 * area / 3.2**2 * loss * turn, rtol=1e-9)
