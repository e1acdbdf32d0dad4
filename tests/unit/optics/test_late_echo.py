"""Light scattered on its way makes an echo late: closed limits and traced photons."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor.optics import rays
from amulor.optics.late_echo import RELATIVE_UNCERTAINTY, _at_frequency, late_echo
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
    water = henyey_greenstein_function(asymmetry=0.97)
    fraction, moment = water.forward_split(0.3)
    late = late_echo(
        0.0,
        depth=[1.0, 2.0, 4.0],
        scattering=0.2,
        phase_function=water,
        split_angle=0.3,
        **SPOT | {"baseline": 0.0, "tilt": 0.0, "acceptance_angle": 100.0},
    )
    each_way = 0.2 * fraction * moment * np.array([1.0, 2.0, 4.0]) ** 2 / 4
    # The aperture of 2 cm adds R^2 / 4 z, and the view of 100 rad is not endless.
    aperture = 0.02**2 / 4 / np.array([1.0, 2.0, 4.0])
    np.testing.assert_allclose(late, each_way + aperture, rtol=1e-4)


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
    np.testing.assert_allclose(late, mean_square / (4 * depth), rtol=1e-9)


def test_delay_to_a_receiver_aside_is_that_of_the_rays_to_its_aperture():
    """Sums ways from one spot over an aperture, each with its share of the light."""
    depth, baseline, tilt, radius, acceptance = 2.0, 0.3, 0.12, 0.04, 0.07
    late = late_echo(
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


@pytest.mark.parametrize("rate", [0.0, 3.0])
def test_absorption_removes_more_of_the_longer_paths(rate: float) -> None:
    """Draws paths of three scatterings on average, each with a gamma distribution."""
    scatterings, mean_path, absorption, shape = 3.0, 0.2, 1.5, 0.1
    rng = np.random.default_rng(3)
    jumps = rng.poisson(scatterings, size=2_000_000)
    scale = mean_path / (scatterings * shape)
    path = np.zeros(jumps.size)
    path[jumps > 0] = rng.gamma(shape * jumps[jumps > 0], scale)
    light = np.exp(-absorption * path)
    if rate:
        expected = np.angle(np.sum(light * np.exp(1j * rate * path))) / rate
    else:
        expected = np.sum(light * path) / np.sum(light)
    found = _at_frequency(
        np.array(rate), np.array(mean_path), np.exp(-scatterings), np.array(absorption)
    )
    # Weighted paths scatter by about three times their mean: 0.2 % of 2,000,000.
    np.testing.assert_allclose(found, expected, rtol=0.01)
    assert found < 0.8 * mean_path


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
    ("scattering", "depth"), [(0.35, 1.6), (0.35, 3.2), (0.7, 2.4)]
)
def test_photons_of_three_waters_arrive_as_late(name, scattering, depth):
    check(name, scattering=scattering, depth=depth, histories=400_000)
