"""Exponents of delayed light against plain sums over angles and distances."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light
from scipy.integrate import cumulative_simpson, simpson
from scipy.special import j0, j1

from amulor.optics import _delayed_light as delayed
from amulor.optics import late_echo as late
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.tables import petzold

WATER = henyey_greenstein_function(asymmetry=0.8)
SPLIT, RATE = 1.0, -0.4 + 3j
#: Steps of the logarithmic grid: kappa from 2^(7/7) on, distance up to 2^(7/7).
LOW, HIGH, NEAR, FAR = 7, 14, -70, 7


def transforms(kappa: float, distance: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return transform less the forward part, its slope and curvature, by a sum."""
    node, weight = np.polynomial.legendre.leggauss(600)
    angle = SPLIT * (node + 1) / 2
    share = 2 * np.pi * WATER(angle) * np.sin(angle) * weight * SPLIT / 2
    longer = np.exp(RATE * distance[:, None] * (1 / np.cos(angle) - 1))
    turn = kappa * distance[:, None] * np.tan(angle)
    y = np.maximum(kappa * distance, 1e-12)
    first = (longer * j1(turn)) @ (share * angle)
    return (
        (longer * j0(turn)) @ share - share.sum(),
        -first,
        first / y - (longer * j0(turn)) @ (share * angle**2),
        -first / y,
    )


def test_light_of_one_scattering_is_its_sum_over_angles() -> None:
    value, slope, curl, bend = delayed._damped(
        WATER, SPLIT, RATE, (LOW, HIGH, NEAR, FAR)
    )
    steps = [0, 40, 70, 77]
    distance = 2.0 ** ((NEAR + np.array(steps)) / 7)
    for column in (0, 7):
        expected = transforms(2.0 ** ((LOW + column) / 7), distance)
        found = [part[steps, column] for part in (value, slope, bend, curl)]
        for part, own in zip(expected, found, strict=True):
            assert_allclose(own, part, rtol=1e-4, atol=1e-7)


def test_exponents_are_the_integrals_of_one_two_and_three_scatterings() -> None:
    fields = delayed.exponents(WATER, SPLIT, RATE, (LOW, HIGH, NEAR, FAR))
    assert fields.shape == (6, HIGH - LOW + 1, FAR - NEAR + 1)
    for column, step in ((0, 77), (7, 77), (3, 70)):
        end = 2.0 ** ((NEAR + step) / 7)
        x = np.linspace(0, end, 601)
        one, slope, bend, curl = transforms(2.0 ** ((LOW + column) / 7), x)

        def over(part, x=x):
            return simpson(part, x=x)

        def up_to(part, x=x):
            whole = cumulative_simpson(part.real, x=x, initial=0)
            return whole + 1j * cumulative_simpson(part.imag, x=x, initial=0)

        # Integral of min(x, x') q'(x') over x', up to the end of the water.
        total = up_to(slope)
        reach = up_to(x * slope) + x * (total[-1] - total)
        pairs = RATE**2 / 2 * sum(over(q * up_to(x**2 * q)) for q in (bend, curl))
        pairs -= RATE * over(slope * up_to(x * slope))
        expected = [
            over(one),
            pairs,
            RATE**2 / 2 * over(bend * reach**2),
            over(x * slope),
            -RATE * over(bend * x * reach),
            over(bend * x**2) / 2,
        ]
        assert_allclose(fields[:, column, step], expected, rtol=2e-3)


def test_exponents_between_the_grid_are_those_of_the_grid() -> None:
    kappa = 2.0 ** (np.array([[9, 12], [14, 8]]) / 7)
    depth = 2.0 ** (np.array([3, 7]) / 7)
    found = delayed.at_places(WATER, SPLIT, RATE, kappa, depth, float(kappa.max()))
    table = delayed.exponents(WATER, SPLIT, RATE, (LOW, HIGH, NEAR, FAR))
    for row, step in enumerate((3 - NEAR, 7 - NEAR)):
        for k in range(2):
            column = round(7 * np.log2(kappa[row, k])) - LOW
            expected = table[:, column, step]
            assert_allclose(found[:, row, k], expected, rtol=5e-3)
    # Light of the coarsest stripes is that of none.
    coarse = delayed.at_places(
        WATER, SPLIT, RATE, np.array([[1e-4, 1e-3]]), np.array([1.0]), 10.0
    )
    assert_allclose(coarse[:, 0, 0], coarse[:, 0, 1], rtol=1e-12)


@pytest.mark.parametrize("split", [0.4, 1.2, 2.5])
@pytest.mark.parametrize("water", [WATER, petzold("HAOCE 11")])
def test_angles_hold_the_light_up_to_a_right_angle(water, split: float) -> None:
    angle, share, width = delayed._angles(water, split)
    top = min(split, np.pi / 2)
    assert np.all((angle > 0) & (angle < top))
    inner, outer = water.panels.cumulative(np.array([1e-5, top]))
    assert_allclose(share.sum(), outer - inner, rtol=1e-6)
    fraction, moment = water.forward_split(top)
    assert_allclose(np.sum(share * angle**2), fraction * moment, rtol=1e-5)
    # Panels of 16 nodes, or of 4 if narrow, whose width counts four times.
    assert_allclose(np.sum(width / 16), top - 1e-5, rtol=1e-9)
    narrow = width < 4 * 0.02 * angle
    assert np.all(width[~narrow] <= 0.03 * (1 + 1e-12))
    assert np.all(width <= 0.12 * (1 + 1e-12))


def test_panels_with_many_oscillations_cancel_out() -> None:
    found = delayed._resolved(np.array([0.0, 10.0, 20.0, 40.0]))
    assert_allclose(found, np.exp([0, -(2.0**-6), -1, -64]), rtol=1e-12)


def test_integral_begins_at_zero_in_proportion() -> None:
    x = 2.0 ** (np.arange(-70, 15) / 7)
    integrand = np.stack([x, x**3 * 1j], axis=1)
    found = delayed._integral(x, integrand)
    assert_allclose(
        found, np.stack([x**2 / 2, 1j * x**4 / 4], axis=1), rtol=1e-3, atol=1e-12
    )


def test_steps_of_a_grid_are_seven_an_octave() -> None:
    assert delayed._step(2.0, up=True) == delayed._step(2.0, up=False) == 7
    assert (delayed._step(3.0, up=False), delayed._step(3.0, up=True)) == (11, 12)
    assert (delayed._step(0.3, up=False), delayed._step(0.3, up=True)) == (-13, -12)


# ------------------------------------------------------------ starts of a Gaussian


def test_directions_of_a_start_are_integrated_with_their_longer_way() -> None:
    kappa, spread, way = np.array([[0.0, 3.0, 9.0]]), np.array([0.2]), np.array([1.5])
    rate, nothing = -0.5 + 4j, np.zeros((1, 3), complex)
    found, _ = delayed.gaussian_start(rate, kappa, spread, way, (nothing, nothing))
    theta = np.linspace(-2, 2, 4001)
    light = np.exp(-((theta / 0.2) ** 2) + rate * 1.5 * theta**2 / 2)
    across = simpson(light, x=theta)
    along = [simpson(light * np.cos(k * 1.5 * theta), x=theta) for k in (0.0, 3.0, 9.0)]
    expected = across * np.array(along) / (np.pi * 0.2**2)
    assert_allclose(np.exp(found[0]), expected, rtol=1e-8)


def test_scattering_shifts_a_start_by_its_slope() -> None:
    # By hand: turned 3 / 2, slope -1.
    found, tilt = delayed.gaussian_start(
        -2.0,
        np.array([[3.0]]),
        np.array([0.5]),
        np.array([2.0]),
        (np.array([[0.5 + 0j]]), np.array([[0.25 + 0j]])),
    )
    assert_allclose(found, -0.25 - 1.5 - np.log(1.5), rtol=1e-12)
    assert_allclose(tilt, 0.5 - 0.5 - 1.0, rtol=1e-12)


def disc_mean(function) -> complex:
    """Return the mean over a disc of directions with the semi-angle 0.3."""
    node, weight = np.polynomial.legendre.leggauss(60)
    radius = 0.3 * (node + 1) / 2
    turn = 2 * np.pi * np.arange(80) / 80
    x, y = (np.outer(radius, part(turn)) for part in (np.cos, np.sin))
    rings = function(x, y).mean(axis=1)
    return complex(np.sum(rings * radius * weight) * 0.3 / (0.3**2))


def test_directions_of_a_sharp_start_are_a_disc_with_its_longer_way() -> None:
    rate, kappa, way = -0.2 + 0.6j, 4.0, 1.5
    linear = np.array([[0.3 - 0.1j]])
    cone, turned = late._sharp_start(
        rate, np.array([[kappa]]), np.array([0.3]), np.array([way]), linear
    )
    frequency = kappa * way - rate * linear[0, 0]

    def wave(x, _, f=frequency):
        return np.exp(1j * f * x)

    def longer(x, y):
        return wave(x, y) * (1 + rate * way * (x**2 + y**2) / 2)

    assert_allclose(cone[0, 0], disc_mean(longer), rtol=1e-9)
    step = 1e-4
    slope = (
        disc_mean(lambda x, y: wave(x, y, frequency + step))
        - disc_mean(lambda x, y: wave(x, y, frequency - step))
    ) / (2 * step)
    expected = linear[0, 0] * cone[0, 0] + way * slope
    assert_allclose(turned[0, 0], expected, rtol=1e-6)


# ---------------------------------------------------------------------- clear water


def mean_of_clear_water(wavenumber: float, *, baseline: float, tilt: float) -> complex:
    """Return light of one axis across the beam, with the phase of both ways.

    Sums over the place and direction of a beam at its start, and over the aperture.
    """
    depth, way, view = 2.0, 2.0 + 0.4, 0.09
    across = np.linspace(-5, 5, 41)
    start, turn, aperture = np.meshgrid(
        0.05 * across, 0.03 * across, 0.04 * across, indexing="ij"
    )
    spot = start + turn * depth
    angle = (baseline + aperture - spot) / way
    light = np.exp(-((start / 0.05) ** 2) - (turn / 0.03) ** 2 - (aperture / 0.04) ** 2)
    light *= np.exp(-(((angle - tilt) / view) ** 2))
    longer = depth * turn**2 / 2 + way * angle**2 / 2
    return complex(np.sum(light * np.exp(1j * wavenumber * longer)))


# A tilt is of the first order in its phase.
@pytest.mark.parametrize(
    ("frequency", "baseline", "tilt", "cross", "allowed"),
    [
        (1e6, 0.0, 0.0, 0.0, 1e-5),
        (1.5e9, 0.0, 0.0, 0.0, 1e-5),
        (1e6, 0.3, 0.1, 0.0, 1e-5),
        (3e8, 0.3, 0.1, 0.0, 2e-3),
        (1e6, 0.2, 0.0, -0.05, 1e-4),
        (1e6, 0.2, 0.03, 0.08, 1e-4),
    ],
)
def test_echo_of_clear_water_is_a_sum_over_rays(
    frequency: float, baseline: float, tilt: float, cross: float, allowed: float
) -> None:
    found = late.late_echo(
        frequency, depth=2.0, scattering=0.0, phase_function=WATER, group_index=1.38,
        baseline=baseline, receiver_radius=0.04, acceptance_angle=0.09,
        beam_radius=0.05, beam_divergence=0.03, tilt=tilt, cross_tilt=cross,
        standoff=0.4,
    )  # fmt: skip
    wavenumber = 2 * np.pi * frequency * 1.38 / speed_of_light
    light = mean_of_clear_water(wavenumber, baseline=baseline, tilt=tilt)
    light *= mean_of_clear_water(wavenumber, baseline=0.0, tilt=cross)
    straight = wavenumber * baseline**2 / (2 * 2.4)
    turn = np.angle(light * np.exp(-1j * straight))
    assert_allclose(found, turn / (2 * wavenumber), rtol=allowed)


def test_response_has_the_phase_of_the_delay_and_is_one_at_rest() -> None:
    scene = {
        "depth": [2.0, 3.0], "scattering": 0.6, "phase_function": WATER,
        "group_index": 1.38, "baseline": 0.1, "receiver_radius": 0.02,
        "acceptance_angle": 0.08, "tilt": 0.05, "absorption": 0.1,
    }  # fmt: skip
    still = late.response(0.0, sharp=False, split_angle=np.pi / 2, **scene)
    assert_allclose(still, 1.0, atol=1e-4)
    found = late.response(2e8, sharp=False, split_angle=np.pi / 2, **scene)
    wavenumber = 2 * np.pi * 2e8 * 1.38 / speed_of_light
    expected = 2 * wavenumber * late.late_echo(2e8, **scene)
    assert_allclose(np.angle(found), expected, rtol=1e-9)
    # Late light with different phases is less light.
    assert np.all(np.abs(found) < 1)
    assert np.abs(found[1]) < np.abs(found[0])


def test_delay_of_the_series_is_divided_by_its_excess() -> None:
    lateness = late._Lateness.of(
        1e8, sharp=False, phase_function=WATER, split_angle=SPLIT, group_index=1.38,
        depth=2.0, scattering=[0.5, 2.0], baseline=0.0, receiver_radius=0.02,
        acceptance_angle=0.08,
    )  # fmt: skip
    found = lateness.excess(np.array([0.8, -1.0]))
    # The phase is that of both ways: sqrt(b z k L) with k L = 0.4.
    assert_allclose(found, [1 + 0.045 * np.sqrt(0.5 * 2 * 0.4), 1.0], rtol=1e-12)
    assert_allclose(lateness.wavenumber, 2 * np.pi * 1e8 * 1.38 / speed_of_light)
    assert_allclose(lateness.loss, 0.0)


class Known(late._Lateness):
    """Echo whose phase is known before it is wrapped."""

    def turns(self, wavenumber, where):
        whole = np.array(LENGTHS)[where] * wavenumber
        # The last echo has no sense any more at high wavenumbers.
        whole = np.where((where == 3) & (wavenumber > 1.5), 2.0, whole)
        return (whole + np.pi) % (2 * np.pi) - np.pi + 0j


#: Lengths per phase of four echoes.
LENGTHS = [0.5, 4.0, 1.2, 3.5]


def test_phases_of_several_turns_are_followed_from_low_frequencies() -> None:
    wavenumber = np.array([1.0, 1.9, 5.0, 2.0])
    flat = {"scattering": np.ones(4), "depth": np.ones(4)}
    echo = Known(
        phase_function=WATER, split_angle=SPLIT, sharp=False, shape=(4,),
        wavenumber=wavenumber, loss=np.zeros(4), flat=flat,
    )  # fmt: skip
    slow = np.array(LENGTHS)
    found = echo.unwrapped(wavenumber, np.arange(4), slow)
    # Where the phase is no continuation, it is twice that of half the frequency.
    assert_allclose(found, [0.5, 7.6, 6.0, 7.0], rtol=1e-12)
    # Other echoes are not looked at.
    found = echo.unwrapped(wavenumber[[2, 0]], np.array([2, 0]), slow[[2, 0]])
    assert_allclose(found, [6.0, 0.5], rtol=1e-12)


def test_echoes_at_once_are_what_each_is_alone(monkeypatch) -> None:
    monkeypatch.setattr(late, "_AT_ONCE", 3)
    scene = {
        "scattering": 0.6, "phase_function": WATER, "group_index": 1.38,
        "baseline": 0.1, "receiver_radius": 0.02, "acceptance_angle": 0.08,
    }  # fmt: skip
    depth = 1.0 + 0.2 * np.arange(7)
    found = late.late_echo([[5e7], [2e8]], depth=depth, **scene)
    assert found.shape == (2, 7)
    for row, frequency in enumerate((5e7, 2e8)):
        alone = late.late_echo(frequency, depth=depth[4], **scene)
        assert_allclose(found[row, 4], alone, rtol=2e-3)


@pytest.mark.parametrize(
    ("formula", "seen", "dark"),
    [
        # Beyond aperture, view and two radii of the beam: 0.02 + 0.1 + 0.02 m.
        (late.sharp_receiver_late_echo, 0.139, 0.141),
        # Where a Gaussian of 0.1025 m is 1e-9: 4.55 widths.
        (late.late_echo, 0.44, 0.48),
    ],
)
def test_a_receiver_that_sees_no_light_knows_no_delay(formula, seen, dark) -> None:
    options = {
        "depth": 1.5, "standoff": 0.5, "scattering": 0.0, "phase_function": WATER,
        "group_index": 1.38, "receiver_radius": 0.02, "acceptance_angle": 0.05,
        "beam_radius": 0.01,
    }  # fmt: skip
    found = formula(1e6, baseline=[seen, dark], **options)
    assert_array_equal(np.isfinite(found), [True, False])
    # A tilt brings the view back to the spot.
    turned = formula(1e6, baseline=[seen, dark], tilt=0.1, **options)
    assert np.all(np.isfinite(turned))
