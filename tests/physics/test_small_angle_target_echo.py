"""Echo of a diffuse plane in small-angle form: quadrature, closed limits, layers."""

from functools import partial

import numpy as np
import pytest
import sharp_receiver_2d
import water_response_2d
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.optics import small_angle, target_echo
from amulor.optics.phase_functions import (
    forward_split,
    henyey_greenstein,
    henyey_greenstein_forward_fraction,
    models,
)
from amulor.optics.small_angle import sharp_receiver as small_angle_sharp_receiver
from amulor.transport import (
    DiscReceiver,
    GaussianReceiver,
    Medium,
    PlaneTarget,
    Source,
    simulate,
)

SPLIT = np.pi / 2
PEAKED = partial(henyey_greenstein, asymmetry=0.95)
SCATTERER = {"phase_function": PEAKED, "split_angle": SPLIT}
WATER = {"absorption": 0.15, "scattering": 0.35}
VIEW = {"receiver_radius": 0.02, "acceptance_angle": 0.08}
FORMS = {
    "Gaussian": (small_angle, target_echo.small_angle_target_response),
    "sharp": (small_angle_sharp_receiver, target_echo.sharp_receiver_target_response),
}
ECHOES = [pytest.param(echo, id=name) for name, (_, echo) in FORMS.items()]


def plain_overlap(name, depth, column):
    """Return F(z) by plain quadrature, none of it by the package."""
    if name == "Gaussian":
        fraction, integrated = water_response_2d.integrated_transform(
            PEAKED, SPLIT, 200.0
        )
        value = water_response_2d.overlap(
            np.array([depth]), integrated, fraction=fraction, **column
        )[0]
        return np.pi * (0.02 * 0.08) ** 2 * value
    fraction, mean = sharp_receiver_2d.mean_transform(PEAKED, SPLIT)
    return sharp_receiver_2d.unscattered(depth, column) + sharp_receiver_2d.collected(
        depth, column, fraction, mean, SPLIT
    )


# ------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("baseline", [0.20, pytest.param(0.07, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FORMS)
def test_the_echo_agrees_with_plain_quadrature(name, baseline):
    column = WATER | VIEW | {"baseline": baseline}
    path, frequency = 2 * 1.38 * 3.9, 39e6
    found = FORMS[name][1](
        frequency,
        depth=3.9,
        optical_path=path,
        reflectance=0.8,
        cosine=0.9,
        **column,
        **SCATTERER,
    )
    # 39 MHz, 10.764 m: 1.4003 turns.
    turn = np.exp(2j * np.pi * frequency * path / speed_of_light)
    expected = 0.8 * 0.9 / np.pi * plain_overlap(name, 3.9, column) * turn
    # The plain sharp quadrature cuts its integral at 1e-6 of the value.
    assert_allclose(found, expected, rtol=1e-8 if name == "Gaussian" else 3e-6)


@pytest.mark.parametrize(
    ("baseline", "expected"), [(0.07, 0.22 / 1.02), (0.20, 0.28 / 1.03)]
)
def test_the_diffusion_form_leaves_a_quarter_of_it_with_the_usual_split(
    baseline, expected
):
    # Traced rays: small-angle form 1.02 and 1.03, diffusion form 0.22 and 0.28 of them,
    # each known within 0.01 (the theory page traces them).
    fraction, moment = forward_split(PEAKED, split_angle=SPLIT)
    common = {"depth": 3.9, "optical_path": 0.0, "reflectance": 0.8}
    whole = target_echo.small_angle_target_response(
        0.0, **common, **WATER, **VIEW, **SCATTERER, baseline=baseline
    )
    diffusion = target_echo.target_response(
        0.0,
        absorption=0.15,
        forward_scattering=0.35 * fraction,
        diffuse_scattering=0.35 * (1 - fraction),
        second_moment=moment,
        **common,
        **VIEW,
        baseline=baseline,
    )
    assert_allclose(abs(diffusion / whole), expected, rtol=0, atol=0.012)


# -------------------------------------------------------------------- closed limits


@given(
    distance=st.floats(5.0, 20.0),
    radius=st.floats(0.002, 0.05),
    baseline=st.floats(0.0, 0.2),
    absorption=st.floats(0.0, 1.0),
)
def test_sharp_receiver_that_sees_the_spot_obeys_the_lidar_equation(
    distance, radius, baseline, absorption
):
    # The view has a radius of 0.4 m or more, aperture and baseline less than that.
    found = target_echo.sharp_receiver_target_response(
        0.0,
        depth=distance,
        optical_path=0.0,
        reflectance=0.5,
        absorption=absorption,
        scattering=0.0,
        baseline=baseline,
        receiver_radius=radius,
        acceptance_angle=0.08,
        **SCATTERER,
    )
    expected = 0.5 * radius**2 / distance**2 * np.exp(-2 * absorption * distance)
    assert_allclose(found, expected, rtol=1e-11)


@given(
    depth=st.floats(0.1, 10.0),
    absorption=st.floats(0.0, 1.0),
    baseline=st.floats(0.0, 0.3),
    tilt=st.floats(-0.1, 0.1),
)
def test_in_clear_water_a_gaussian_receiver_has_the_echo_of_the_closed_form(
    depth, absorption, baseline, tilt
):
    found = target_echo.small_angle_target_response(
        20e6,
        depth=depth,
        optical_path=2.7 * depth,
        reflectance=0.3,
        absorption=absorption,
        scattering=0.0,
        baseline=baseline,
        tilt=tilt,
        **VIEW,
        **SCATTERER,
    )
    # Eq. (43) without forward scattering, written out.
    area = 0.02**2 + (0.08 * depth) ** 2
    apart = baseline - tilt * depth
    light = 0.02**2 * 0.08**2 / area * np.exp(-2 * absorption * depth - apart**2 / area)
    turn = np.exp(2j * np.pi * 20e6 * 2.7 * depth / speed_of_light)
    assert_allclose(found, 0.3 * light * turn, rtol=1e-11)


@pytest.mark.parametrize("echo", ECHOES)
def test_an_endless_aperture_loses_only_what_leaves_the_forward_cone(echo):
    share = float(henyey_greenstein_forward_fraction(asymmetry=0.95, split_angle=SPLIT))
    found = echo(
        0.0,
        depth=3.0,
        optical_path=0.0,
        reflectance=0.5,
        baseline=0.2,
        receiver_radius=1e5,
        acceptance_angle=1e-3,
        **WATER,
        **SCATTERER,
    )
    # Light spreads by metres, 1e-5 of the aperture.
    reduced = 0.15 + 0.35 * (1 - share)
    assert_allclose(found, 0.5 * 1e-3**2 * np.exp(-2 * reduced * 3.0), rtol=1e-7)


# ---------------------------------------------------------------------- invariances

columns = st.fixed_dictionaries(
    {
        "absorption": st.floats(0.02, 1.0),
        "scattering": st.floats(0.0, 2.0),
        "baseline": st.floats(0.0, 0.2),
        "tilt": st.floats(-0.05, 0.05),
        "beam_radius": st.floats(0.002, 0.02),
        "beam_divergence": st.floats(0.001, 0.02),
    }
)


@pytest.mark.parametrize("name", FORMS)
@settings(max_examples=8)
@given(column=columns, near=st.floats(1.0, 4.0), frequency=st.floats(0, 1e8))
def test_faint_planes_one_behind_the_other_send_back_what_a_layer_of_water_does(
    name, column, near, frequency
):
    # A plane of reflectance pi beta dz is a layer dz of water with beta at 180 degrees.
    form, echo = FORMS[name]
    node, weight = np.polynomial.legendre.leggauss(20)
    far, beta = near + 0.5, 1e-3
    depth = near + 0.25 * (node + 1)
    planes = echo(
        frequency,
        depth=depth,
        optical_path=2 * 1.34 * depth,
        reflectance=np.pi * beta,
        **column,
        **VIEW,
        **SCATTERER,
    )
    water = partial(
        form.water_response,
        backscatter_vsf=beta,
        group_index=1.34,
        **column,
        **VIEW,
        **SCATTERER,
    )
    layer = water(frequency, end=far) - water(frequency, end=near)
    # What the responses promise, 1e-6 of the whole column.
    atol = 2e-6 * abs(water(0.0)) + 1e-25
    assert_allclose(np.sum(0.25 * weight * planes), layer, rtol=0, atol=atol)


@settings(max_examples=25)
@given(column=columns, depth=st.floats(0.5, 6.0))
def test_beam_and_receiver_may_change_places(column, depth):
    swapped = column | {
        "beam_radius": VIEW["receiver_radius"],
        "beam_divergence": VIEW["acceptance_angle"],
    }
    other = {
        "receiver_radius": column["beam_radius"],
        "acceptance_angle": column["beam_divergence"],
    }
    common = {"depth": depth, "optical_path": 3.0 * depth, "reflectance": 0.4}
    one, two = (
        target_echo.small_angle_target_response(
            30e6, **common, **water, **view, **SCATTERER
        )
        / (view["receiver_radius"] * view["acceptance_angle"]) ** 2
        for water, view in ((column, VIEW), (swapped, other))
    )
    # What the sum over wavenumbers rounds, of the light on the axis.
    axis = 1 / (VIEW["receiver_radius"] ** 2 + (VIEW["acceptance_angle"] * depth) ** 2)
    assert_allclose(one, two, rtol=1e-9, atol=1e-11 * axis)


# --------------------------------------------------------------------------- refusals


@pytest.mark.parametrize("echo", ECHOES)
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"reflectance": 1.2}, "reflectance must be from 0 to 1"),
        ({"cosine": -0.2}, "cosine must be from 0 to 1"),
        ({"optical_path": np.nan}, "optical_path must be finite"),
        ({"depth": -1.0}, "depth must be finite and not negative"),
        ({"scattering": -0.1}, "scattering must be finite and not negative"),
    ],
)
def test_what_cannot_be_is_refused(echo, wrong, words):
    arguments = {"depth": 2.0, "optical_path": 5.0, "reflectance": 0.5} | WATER | VIEW
    arguments |= SCATTERER | {"baseline": 0.1}
    with pytest.raises(ValueError, match=words):
        echo(39e6, **(arguments | wrong))


def test_a_beam_is_thin_parallel_and_straight_where_nothing_else_is_said() -> None:
    # All of the spot is seen in water that only absorbs: the lidar equation.
    depth, radius, absorption = 2.0, 0.02, 0.15
    found = target_echo.sharp_receiver_target_response(
        0.0, depth=depth, optical_path=2 * depth, reflectance=0.8,
        absorption=absorption, scattering=1e-9,
        phase_function=models.henyey_greenstein_function(asymmetry=0.95),
        split_angle=np.pi / 2, baseline=0.0, receiver_radius=radius,
        acceptance_angle=0.08,
    )  # fmt: skip
    lidar = 0.8 * (radius / depth) ** 2 * np.exp(-2 * absorption * depth)
    np.testing.assert_allclose(found, lidar, rtol=1e-3)


# --------------------------------------------------------------- a receiver aside


def looking(baseline, distance, aim):
    """Return a receiver aside by hand: axis, and what it is to the echo."""
    position = np.array([baseline, 0.0, 0.0])
    axis = np.array([-baseline, 0.0, aim]) if np.isfinite(aim) else np.array([0, 0, 1])
    axis = axis / np.linalg.norm(axis)
    across = position - (position @ axis) * axis
    length = np.linalg.norm(across)
    # The beam runs straight ahead; what of it leads across the axis.
    sideways = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    back = np.hypot(baseline, distance)
    return axis, {
        "depth": distance,
        "return_path": back,
        "cosine": distance / back,
        "baseline": length,
        "tilt": sideways @ across / length if length else 0.0,
    }


@settings(max_examples=40)
@given(
    baseline=st.floats(0.0, 0.5),
    distance=st.floats(1.0, 6.0),
    absorption=st.floats(0.0, 0.5),
    lean=st.floats(-0.5, 0.5),
)
def test_a_receiver_aside_sees_a_plate_by_the_way_back(
    baseline, distance, absorption, lean
):
    # Aimed at the spot, all of which it sees: the lidar equation, written out.
    _, view = looking(baseline, distance, distance)
    back = np.hypot(baseline, distance)
    normal = np.array([np.sin(lean), 0.0, -np.cos(lean)])
    cosine = abs(normal @ np.array([baseline, 0.0, -distance])) / back
    found = target_echo.sharp_receiver_target_response(
        0.0,
        optical_path=0.0,
        reflectance=0.5,
        absorption=absorption,
        scattering=0.0,
        receiver_radius=0.01,
        acceptance_angle=0.08,
        **(view | {"cosine": cosine}),
        **SCATTERER,
    )
    expected = 0.5 * cosine * 0.01**2 / back**2
    assert_allclose(
        found, expected * np.exp(-absorption * (distance + back)), rtol=1e-9
    )


@given(aside=st.floats(0.0, 0.12), distance=st.floats(1.0, 4.0))
def test_off_the_axis_a_narrow_aperture_counts_angle_and_obliquity(aside, distance):
    # A receiver that looks ahead: exp(-angle^2 / gamma^2) cos(angle) / way squared.
    angle = np.arctan2(aside, distance)
    back = np.hypot(aside, distance)
    found = target_echo.small_angle_target_response(
        0.0,
        depth=distance,
        return_path=back,
        optical_path=0.0,
        reflectance=0.3,
        absorption=0.1,
        scattering=0.0,
        baseline=aside,
        receiver_radius=1e-5,
        acceptance_angle=0.08,
        **SCATTERER,
    )
    expected = 0.3 * 1e-5**2 / back**2 * np.cos(angle) * np.exp(-((angle / 0.08) ** 2))
    assert_allclose(found, expected * np.exp(-0.1 * (distance + back)), rtol=1e-6)


@pytest.mark.parametrize("name", FORMS)
@settings(max_examples=8)
@given(column=columns, depth=st.floats(1.0, 4.0))
def test_a_way_back_along_the_beam_changes_nothing(name, column, depth):
    column = column | {"baseline": 0.0, "tilt": 0.0}
    echo = FORMS[name][1]
    common = {"depth": depth, "optical_path": 0.0, "reflectance": 0.4}
    one = echo(0.0, **common, **column, **VIEW, **SCATTERER)
    other = echo(0.0, return_path=depth, **common, **column, **VIEW, **SCATTERER)
    assert_allclose(other, one, rtol=1e-12)


@pytest.mark.parametrize(
    ("receiver", "name", "baseline", "distance", "aim", "attenuation"),
    [
        (GaussianReceiver, "Gaussian", 0.4, 1.0, 1.0, 1e-3),
        (DiscReceiver, "sharp", 0.4, 1.0, 1.0, 0.3),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                (DiscReceiver, "sharp", 0.2, 2.0, 2.0, 1e-3),
                (DiscReceiver, "sharp", 0.4, 1.0, 1.0, 1e-3),
                (DiscReceiver, "sharp", 0.07, 1.0, np.inf, 1e-3),
                (GaussianReceiver, "Gaussian", 0.4, 1.0, 1.0, 0.3),
            )
        ),
    ],
)
def test_photons_bring_what_the_way_back_says(
    receiver, name, baseline, distance, aim, attenuation
):
    function = models.henyey_greenstein_function(asymmetry=0.95)
    axis, view = looking(baseline, distance, aim)
    water = {"absorption": 0.3 * attenuation, "scattering": 0.7 * attenuation}
    tally = simulate(
        Medium.homogeneous(phase_function=function, group_index=1.34, **water),
        Source(),
        receiver(
            radius=0.02,
            acceptance_angle=0.08,
            position=(baseline, 0.0, 0.0),
            direction=axis,
        ),
        [0.0],
        histories=150_000,
        seed=3,
        target=PlaneTarget(position=(0.0, 0.0, distance), reflectance=0.1),
    )
    found = FORMS[name][1](
        0.0,
        optical_path=0.0,
        reflectance=0.1,
        phase_function=function,
        split_angle=SPLIT,
        **water,
        **VIEW,
        **view,
    )
    error = np.sqrt(tally.target_covariance[0, 0, 0])
    # Small angles leave out some per mille of light that is scattered on its way.
    allowed = 4 * error + (5e-4 + 0.01 * attenuation) * found.real
    assert abs(found.real - tally.target_signal[0].real) < allowed


def test_a_way_back_shorter_than_the_distance_from_the_axis_is_refused():
    with pytest.raises(ValueError, match="return_path must be at least the distance"):
        target_echo.small_angle_target_response(
            0.0, depth=1.0, return_path=0.1, optical_path=0.0, reflectance=0.5,
            baseline=0.3, **WATER, **VIEW, **SCATTERER,
        )  # fmt: skip
