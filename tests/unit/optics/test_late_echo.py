"""Light scattered on its way makes an echo late: closed limits and traced photons."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from late_photons import late_range
from scipy.constants import speed_of_light

from amulor.optics import rays
from amulor.optics._delayed_light import exponents
from amulor.optics.late_echo import (
    RELATIVE_UNCERTAINTY,
    late_echo,
    sharp_receiver_late_echo,
)
from amulor.optics.phase_functions.models import (
    fournier_forand,
    henyey_greenstein_function,
)
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import petzold
from amulor.transport import GaussianReceiver, Medium, PlaneTarget, Source, simulate

SPOT: dict[str, Any] = {
    "group_index": 1.38,
    "baseline": 0.2,
    "receiver_radius": 0.02,
    "acceptance_angle": 0.08,
    "tilt": np.tan(np.radians(4)),
}
FUNCTIONS: dict[str, PhaseFunction] = {
    "petzold": petzold("HAOCE 11"),
    "fournier-forand": fournier_forand(relative_index=1.1, slope=3.5835),
    "henyey-greenstein": henyey_greenstein_function(asymmetry=0.95),
}


def test_receiver_that_sees_all_of_a_plane_sees_half_the_mean_square_angle():
    water = henyey_greenstein_function(asymmetry=0.9999)
    fraction, moment = water.forward_split(0.01)
    depth = np.array([1.0, 2.0, 4.0])
    late = late_echo(
        0.0,
        depth=depth,
        scattering=20.0,
        phase_function=water,
        split_angle=0.01,
        **SPOT
        | {
            "baseline": 0.0,
            "tilt": 0.0,
            "acceptance_angle": 3.0,
            "receiver_radius": 0.002,
        },
    )
    # The aperture adds R^2 / 4 z, and the view of 3 rad is not endless.
    expected = 20 * fraction * moment * depth**2 / 4 + 0.002**2 / 4 / depth
    np.testing.assert_allclose(late, expected, rtol=2e-3)


def test_clear_water_leaves_the_delay_of_the_aperture():
    depth, radius, acceptance = 1.5, 0.05, 0.06
    late = late_echo(
        [0.0, 1e9],
        depth=depth,
        scattering=0.0,
        phase_function=FUNCTIONS["petzold"],
        **SPOT
        | {
            "baseline": 0.0,
            "tilt": 0.0,
            "receiver_radius": radius,
            "acceptance_angle": acceptance,
        },
    )
    mean_square = 1 / (radius**-2 + (acceptance * depth) ** -2)
    # Integral of both Gaussians with the phase k r^2 / 2 z of the way to a point.
    wavenumber = 2 * np.pi * 1e9 * 1.38 / speed_of_light
    phase = np.arctan(wavenumber * mean_square / (2 * depth))
    expected = [mean_square / (4 * depth), phase / (2 * wavenumber)]
    np.testing.assert_allclose(late, expected, rtol=1e-6)


#: Depth, baseline, tilt, radius and acceptance of a receiver beside the beam.
ASIDE = 2.0, 0.3, 0.12, 0.04, 0.07


def late_aside(formula):
    """Return the late light of a receiver beside the beam in clear water."""
    depth, baseline, tilt, radius, acceptance = ASIDE
    return formula(
        0.0,
        depth=depth,
        scattering=0.0,
        phase_function=FUNCTIONS["petzold"],
        group_index=1.38,
        baseline=baseline,
        receiver_radius=radius,
        acceptance_angle=acceptance,
        tilt=tilt,
    )


def test_delay_to_a_receiver_aside_is_that_of_the_rays_to_its_aperture():
    """Sums ways from one spot over an aperture, each with its share of the light."""
    depth, baseline, tilt, radius, acceptance = ASIDE
    late = late_aside(late_echo)
    across = np.linspace(-6, 6, 241) * radius
    x, y = np.meshgrid(across, across)
    angle_x, angle_y = -(baseline + x) / depth + tilt, -y / depth
    share = np.exp(-(x**2 + y**2) / radius**2)
    share *= np.exp(-(angle_x**2 + angle_y**2) / acceptance**2)
    way = ((baseline + x) ** 2 + y**2) / (2 * depth)
    mean = np.sum(share * way) / np.sum(share) - baseline**2 / (2 * depth)
    np.testing.assert_allclose(late, mean / 2, rtol=1e-6)


def test_air_before_the_water_delays_no_more_than_water_would():
    arguments = {"scattering": 0.35, "phase_function": FUNCTIONS["petzold"], **SPOT}
    wet = late_echo(50e6, depth=2.0, **arguments | {"baseline": 0.0, "tilt": 0.0})
    dry = late_echo(
        50e6, depth=1.5, standoff=0.5, **arguments | {"baseline": 0.0, "tilt": 0.0}
    )
    assert 0.3 * wet < dry < wet


def test_a_higher_frequency_sees_less_of_the_late_light():
    late = late_echo(
        [0.0, 50e6, 400e6, 2e9],
        depth=3.2,
        scattering=0.5,
        phase_function=FUNCTIONS["henyey-greenstein"],
        **SPOT,
    )
    assert np.all(np.diff(late) < 0)
    np.testing.assert_allclose(late[1], late[0], rtol=0.03)


@pytest.mark.parametrize("absorption", [0.0, 3.0])
@pytest.mark.parametrize("wavenumber", [0.5, 2.0, 4.0])
def test_many_small_scatterings_delay_as_a_random_walk_of_directions(
    wavenumber: float, absorption: float
) -> None:
    """Compares with 1 / cosh, the mean over all walks of R. H. Cameron, W. T. Martin.

    Bull. Am. Math. Soc. 51, 73 (1945), in two dimensions; all light counts.
    """
    water = henyey_greenstein_function(asymmetry=0.99)
    depth, scattering = 2.0, 2000.0
    _, moment = water.forward_split(0.01)
    rate = 1j * wavenumber - absorption
    scattered = scattering * water.forward_split(0.01)[0] * moment / 2
    low, high = (round(7 * np.log2(value)) for value in (0.01, 1.0))
    far = round(7 * np.log2(depth))
    table = exponents(water, 0.01, rate, (low, high, far - 45, far))
    found = table[0] * scattering + table[1] * scattering**2 + table[2] * scattering**3
    expected = -np.log(np.cosh(2 ** (far / 7) * np.sqrt(-rate * scattered)))
    # The series ends before the third power of the first term.
    allowed = 1e-3 * np.abs(expected) + 0.2 * np.abs(expected) ** 3
    assert np.abs(expected) > 0.01
    assert np.abs(found[0, -1] - expected) < allowed


@pytest.mark.parametrize("formula", [late_echo, sharp_receiver_late_echo])
@pytest.mark.parametrize("scale", [0.37, 2.9])
def test_a_larger_scene_in_clearer_water_delays_in_proportion(formula, scale) -> None:
    scene = {
        "depth": 2.0, "scattering": 1.2, "absorption": 0.3, "group_index": 1.38,
        "baseline": 0.2, "receiver_radius": 0.02, "beam_radius": 0.003,
        "standoff": 0.1,
    }  # fmt: skip
    angles = {"acceptance_angle": 0.05, "tilt": 0.1, "beam_divergence": 0.002}
    scaled = {
        name: value / scale if name in ("scattering", "absorption") else value * scale
        for name, value in scene.items()
        if name != "group_index"
    } | {"group_index": 1.38}
    water = FUNCTIONS["fournier-forand"]
    here = formula([0.0, 2e8], phase_function=water, **scene, **angles)
    there = formula([0.0, 2e8 / scale], phase_function=water, **scaled, **angles)
    # Grids of both lie elsewhere: the rest is the error of the tables.
    np.testing.assert_allclose(there, scale * here, rtol=3e-3)


def test_sharp_view_in_clear_water_delays_as_its_rays():
    """Sums ways from the spot over a disc, each if its angle lies in the cone."""
    depth, baseline, tilt, radius, acceptance = ASIDE
    late = late_aside(sharp_receiver_late_echo)
    across = np.linspace(-1, 1, 2001) * radius
    x, y = np.meshgrid(across, across)
    angle_x, angle_y = -(baseline + x) / depth + tilt, -y / depth
    light = np.hypot(x, y) <= radius
    light &= np.hypot(angle_x, angle_y) <= acceptance
    way = ((baseline + x) ** 2 + y**2) / (2 * depth)
    mean = np.mean(way[light]) - baseline**2 / (2 * depth)
    # Edges softened by 5 % of the view of 15 cm lie 8 cm aside of the spot.
    np.testing.assert_allclose(late, mean / 2, rtol=0.08)


def test_delay_stays_finite_and_grows_where_the_series_no_longer_holds():
    late = late_echo(
        [[50e6], [500e6], [2e9]],
        depth=10.0,
        scattering=[0.5, 1.0, 2.0, 4.0],
        absorption=0.2,
        phase_function=FUNCTIONS["henyey-greenstein"],
        **SPOT,
    )
    assert np.all(late > 0)
    assert np.all(np.diff(late, axis=0) <= 0)


def test_a_receiver_that_looks_elsewhere_knows_no_delay():
    late = late_echo(
        50e6,
        depth=2.0,
        scattering=0.0,
        phase_function=FUNCTIONS["petzold"],
        **SPOT | {"baseline": 3.0, "tilt": 0.0},
    )
    assert np.isnan(late)


def test_refuses_what_cannot_be():
    arguments = {"scattering": 0.3, "phase_function": FUNCTIONS["petzold"], **SPOT}
    with pytest.raises(ValueError, match="depth"):
        late_echo(50e6, depth=0.0, **arguments)
    with pytest.raises(ValueError, match="scattering"):
        late_echo(50e6, depth=1.0, **arguments | {"scattering": -0.1})


def traced(
    water: PhaseFunction,
    *,
    scattering: float,
    depth: float,
    frequency: float,
    histories: int,
) -> tuple[float, float]:
    """Return the delay of traced photons as a slant range, and its standard error."""
    receiver = GaussianReceiver(
        position=(0.2, 0, 0),
        direction=rays.direction(np.radians(-4), 0.0),
        radius=0.02,
        acceptance_angle=0.08,
    )
    medium = Medium.homogeneous(
        absorption=0.15, scattering=scattering, phase_function=water, group_index=1.38
    )
    # A dark surface: light that it sends to and fro is another effect.
    tally = simulate(
        medium,
        Source(),
        receiver,
        np.array([frequency]),
        histories=histories,
        seed=3,
        target=PlaneTarget(position=(0, 0, depth), reflectance=0.1),
        threads=1,
    )
    own = np.array([part.startswith("target") for part in tally.parts])
    path = 1.38 * (depth + np.hypot(depth, 0.2))
    turn = np.exp(-2j * np.pi * frequency * path / speed_of_light)
    each = tally.batches[:, own].sum(axis=1)[:, 0, 0] * turn
    weight = tally.histories_of / tally.histories
    mean = weight @ each
    scale = speed_of_light / (4 * np.pi * frequency * 1.38)
    error = np.sqrt(np.sum((weight * (each / mean).imag) ** 2)) * scale
    return float(np.angle(mean) * scale), float(error)


def check(name: str, *, scattering: float, depth: float, histories: int) -> None:
    """Assert that theory and photons agree within error and stated uncertainty."""
    found, error = traced(
        FUNCTIONS[name],
        scattering=scattering,
        depth=depth,
        frequency=50e6,
        histories=histories,
    )
    theory = late_echo(
        50e6,
        depth=depth,
        scattering=scattering,
        phase_function=FUNCTIONS[name],
        absorption=0.15,
        **SPOT,
    )
    assert error < 0.1 * found
    allowed = np.hypot(2.5 * error, 1.5 * RELATIVE_UNCERTAINTY * theory)
    assert abs(theory - found) < allowed, (theory, found, error)


def test_photons_arrive_as_late():
    check("petzold", scattering=1.0, depth=1.6, histories=150_000)


@pytest.mark.slow
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize(
    ("scattering", "depth"),
    [
        pytest.param(0.35, 1.6, marks=pytest.mark.study),
        pytest.param(0.35, 3.2, marks=pytest.mark.study),
        (0.7, 2.4),
    ],
)
def test_photons_of_three_waters_arrive_as_late(name, scattering, depth):
    check(name, scattering=scattering, depth=depth, histories=400_000)


def compare(
    name: str, lengths: float, *, photons: int, rtol: float, **receiver: Any
) -> None:
    """Compare with two-way photons at 50, 200 and 500 MHz, depth 2.5 m."""
    water, depth = FUNCTIONS[name], 2.5
    angle = np.concatenate([[0.0], np.geomspace(1e-7, np.pi, 100_000)])
    scattering, absorption = 0.75 * lengths / depth, 0.25 * lengths / depth
    frequency = np.array([50e6, 200e6, 500e6])
    expected, error = late_range(
        2 * np.pi * frequency * 1.38 / speed_of_light,
        depth=depth,
        scattering=scattering,
        absorption=absorption,
        angle=angle,
        cumulative=np.asarray(water.cumulative(angle)),
        receiver_radius=0.02,
        photons=photons,
        **receiver,
    )
    aside, sharp = receiver.pop("aside", 0.0), receiver.pop("sharp", False)
    formula = sharp_receiver_late_echo if sharp else late_echo
    found = formula(
        frequency,
        depth=depth,
        scattering=scattering,
        absorption=absorption,
        phase_function=water,
        group_index=1.38,
        baseline=aside,
        tilt=aside / depth,
        receiver_radius=0.02,
        **receiver,
    )
    assert np.all(error < 0.04 * expected)
    assert np.all(np.abs(found - expected) < rtol * expected + 3 * error)


def test_scattered_photons_of_three_attenuation_lengths_arrive_as_late():
    compare("henyey-greenstein", 3, photons=40_000, rtol=0.02, acceptance_angle=0.08)


@pytest.mark.study
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("lengths", [1, 3, 6, 9])
@pytest.mark.parametrize(
    "receiver",
    [
        {"acceptance_angle": 0.02},
        {"acceptance_angle": 0.02, "sharp": True},
        {"acceptance_angle": 0.08, "aside": 0.2},
        {"acceptance_angle": 0.08, "aside": 0.2, "sharp": True},
    ],
)
def test_delay_agrees_with_photons_up_to_nine_attenuation_lengths(
    name, lengths, receiver
):
    compare(name, lengths, photons=200_000, rtol=0.05, **receiver)
