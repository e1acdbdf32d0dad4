"""Parts of the subtraction of late light: frequencies, limits, possible waters."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor import rejection
from amulor.cube.tiles import Span
from amulor.imaging import late_light as module
from amulor.imaging.late_light import LateFit, dispersion, late_light
from amulor.imaging.observation import Observation, observe
from amulor.optics import ranging
from amulor.optics.late_echo import late_echo
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.simulation import simulate
from amulor.survey import Survey
from amulor.survey.view import view

FREQUENCY = np.array([39e6, 120e6])
WEIGHT = np.array([0.3, 0.7])
HAZE = 'phase_function = { kind = "henyey-greenstein", asymmetry = 0.95 }\n'
MOMENTS = 'forward_fraction = 1.0\nsecond_moment = "0.06 rad^2"\n'


def _described(plate_text: str, water: str = MOMENTS) -> Survey:
    assert MOMENTS in plate_text
    return Survey.from_text(plate_text.replace(MOMENTS, water)).with_(
        {
            "instrument.modulation_frequencies": FREQUENCY.tolist(),
            "instrument.polarizations": ["VH"],
            "scan.columns": 4,
            "scan.rows": 3,
        }
    )


def _observed(described: Survey) -> Observation:
    cube = rejection.keep_water(simulate(described, rng=2))
    measured = cube.assign_attrs(simulated=np.int32(0), late_echo="present")
    return observe(measured.isel(polarization=0))


def _delays(described: Survey, observation: Observation, depth: np.ndarray) -> Any:
    """Delays of a Henyey-Greenstein function of 0.95, without a table."""
    look = view(described, observation.geometry.azimuth, observation.geometry.elevation)
    return np.stack(
        [
            late_echo(
                frequency,
                depth=depth,
                scattering=described.water.scattering,
                phase_function=henyey_greenstein_function(asymmetry=0.95),
                group_index=1.38,
                baseline=look.baseline,
                receiver_radius=described.instrument.receiver.radius,
                acceptance_angle=look.acceptance,
                tilt=look.tilt,
                cross_tilt=look.cross_tilt,
            )
            for frequency in FREQUENCY
        ]
    )


#: Ranges of three rows and four columns that differ in both directions [m].
RANGES = 1.3 + 0.2 * np.arange(3.0)[:, None] + 0.05 * np.arange(4.0)


@pytest.fixture(scope="module")
def haze(plate_text: str) -> tuple[Survey, Observation]:
    described = _described(plate_text, "asymmetry = 0.95\n")
    return described, _observed(described)


@pytest.fixture(scope="module")
def exact(haze: tuple[Survey, Observation]) -> np.ndarray:
    return _delays(*haze, RANGES)


def test_the_delay_is_the_mean_over_the_frequencies(
    haze: tuple[Survey, Observation], exact: np.ndarray
) -> None:
    light, used = late_light(haze[1], RANGES, weight=WEIGHT)
    mean = 0.3 * exact[0] + 0.7 * exact[1]
    # The table of a few directions is good for a hundredth.
    assert_allclose(light.late, 0.75 * mean, rtol=8e-3)
    assert light.uncertainty is not None
    spread = 0.5 / math.sqrt(12) / 0.75
    assert_allclose(light.uncertainty, np.hypot(0.05, spread) * light.late, rtol=1e-9)
    assert light.note == "taken off"
    assert used.depth == pytest.approx((RANGES.min(), RANGES.max()))
    assert used.in_view
    assert used.span is not None
    edge = haze[1].geometry.azimuth.max()
    assert used.span.azimuth == pytest.approx((-edge, edge))


def test_pixels_without_a_range_have_no_delay(
    haze: tuple[Survey, Observation],
) -> None:
    whole, used = late_light(haze[1], RANGES, weight=WEIGHT)
    ranges = RANGES.copy()
    ranges[0, 1], ranges[2, 2] = np.nan, np.nan
    light, _ = late_light(haze[1], ranges, weight=WEIGHT)
    missing = np.isnan(ranges)
    assert light.uncertainty is not None
    assert (light.late[missing] == 0).all()
    assert (light.uncertainty[missing] == 0).all()
    assert_allclose(light.late[~missing], whole.late[~missing], rtol=1e-4)
    nothing, empty = late_light(haze[1], np.full((3, 4), np.nan), weight=WEIGHT)
    assert nothing.note == "not known: no pixel has a range"
    assert nothing.uncertainty is None
    assert_array_equal(nothing.late, np.zeros((3, 4)))
    assert empty == LateFit()
    assert used != empty


def test_ranges_beyond_a_sample_of_the_scan_have_the_delay_of_its_limit(
    haze: tuple[Survey, Observation],
) -> None:
    _, used = late_light(haze[1], RANGES, weight=WEIGHT)
    near = replace(used, depth=(1.4, 1.6))
    light, same = late_light(haze[1], RANGES, weight=WEIGHT, fit=near)
    assert same == near
    whole, _ = late_light(haze[1], RANGES, weight=WEIGHT)
    inside = (RANGES >= 1.4) & (RANGES <= 1.6)
    assert_allclose(light.late[inside], whole.late[inside], rtol=2e-3)
    # Over the square of the distance, which is nearly even.
    assert_allclose(light.late, whole.late, rtol=0.05)


def test_echoes_past_the_receiver_leave_the_delay_unknown(
    haze: tuple[Survey, Observation],
) -> None:
    _, used = late_light(haze[1], RANGES, weight=WEIGHT)
    past = replace(used, in_view=False)
    light, same = late_light(haze[1], RANGES, weight=WEIGHT, fit=past)
    assert same is past
    assert light.uncertainty is None
    assert light.note == "not known: the receiver looks past some of the echoes"
    assert_array_equal(light.late, np.zeros((3, 4)))


def test_without_a_survey_or_light_nothing_is_taken_off(
    haze: tuple[Survey, Observation],
) -> None:
    light, used = late_light(replace(haze[1], survey=None), RANGES, weight=WEIGHT)
    assert light.note == "not known: no survey describes the water"
    assert light.uncertainty is None
    assert used == LateFit()
    channel = haze[1].channel.assign_attrs(late_echo="absent")
    light, used = late_light(replace(haze[1], channel=channel), RANGES, weight=WEIGHT)
    assert light.note == "absent from this simulation"
    assert_array_equal(light.late, np.zeros((3, 4)))
    assert_array_equal(light.uncertainty, np.zeros((3, 4)))
    assert used == LateFit()


def test_frequencies_are_delayed_about_their_mean(
    haze: tuple[Survey, Observation], exact: np.ndarray
) -> None:
    ranges = RANGES.copy()
    ranges[1, 1] = np.nan
    values, used = dispersion(haze[1], ranges, weight=WEIGHT)
    assert values is not None
    turn, error = values
    apart = exact - (0.3 * exact[0] + 0.7 * exact[1])
    per_range = ranging.phase_per_range(FREQUENCY[:, None, None], group_index=1.38)
    # A rectangle between the whole and half of the delay.
    expected = np.where(np.isnan(ranges), 0.0, 0.75 * per_range * apart)
    # Delays differ by a few thousandths, which the table holds to a tenth.
    assert_allclose(turn, expected, rtol=0.11, atol=1e-7)
    assert_allclose(error, np.hypot(0.3, 1 / 3) * np.abs(turn), rtol=1e-9)
    again, same = dispersion(haze[1], ranges, weight=WEIGHT, fit=used)
    assert same is used
    assert again is not None
    assert_allclose(again[0], turn)


def test_dispersion_needs_two_frequencies_a_survey_and_light(
    haze: tuple[Survey, Observation],
) -> None:
    observation = haze[1]
    channel = observation.channel.assign_attrs(late_echo="absent")
    for one, weight in (
        (observation, np.ones(1)),
        (replace(observation, survey=None), WEIGHT),
        (replace(observation, channel=channel), WEIGHT),
    ):
        assert dispersion(one, RANGES, weight=weight) == (None, LateFit())
    nothing, used = dispersion(observation, np.full((3, 4), np.nan), weight=WEIGHT)
    assert nothing is None
    assert used == LateFit()


def test_a_stated_henyey_greenstein_function_leaves_half_of_the_delay(
    plate_text: str, haze: tuple[Survey, Observation]
) -> None:
    stated = _observed(_described(plate_text, HAZE))
    light, _ = late_light(stated, RANGES, weight=WEIGHT)
    same, _ = late_light(haze[1], RANGES, weight=WEIGHT)
    assert_allclose(light.late, same.late, rtol=1e-6)
    assert_allclose(light.uncertainty, same.uncertainty, rtol=1e-6)


def test_the_span_of_a_part_is_that_of_the_scan(
    haze: tuple[Survey, Observation],
) -> None:
    span = Span(azimuth=(-0.2, 0.1), elevation=(-0.1, 0.3))
    part = replace(haze[1], span=span)
    ranges = RANGES.copy()
    ranges[0, 0] = -1.0
    fit = module._fit(part, ranges)
    assert fit.span == span
    assert fit.depth == pytest.approx((1.35, RANGES.max()))


def test_directions_reach_a_little_beyond_the_scan() -> None:
    angles = module._spread(0.1, 0.3)
    assert len(angles) == 5
    assert_allclose(angles, np.linspace(0.1, 0.3, 5), atol=2e-6)
    assert angles[0] < 0.1 - 1e-6
    assert angles[-1] > 0.3 + 1e-6
    same = module._spread(0.2, 0.2)
    assert same[0] < 0.2 < same[-1]


def _water(**changes: Any) -> SimpleNamespace:
    values = {
        "scattering": 0.6,
        "forward_scattering": 0.5,
        "phase_function": None,
        "second_moment": 0.06,
        "split_angle": math.pi / 2,
    }
    return SimpleNamespace(**{**values, **changes})


def test_possible_waters_are_between_natural_ones_and_that_of_the_moments() -> None:
    clear = module._phase_functions(_water(scattering=0.0))
    assert [entry[1:] for entry in clear] == [(0.0, math.pi / 2)]
    assert clear[0][0] is module._function(0.90)
    stated = henyey_greenstein_function(asymmetry=0.7)
    assert module._phase_functions(_water(phase_function=stated)) == (
        (stated, 0.6, math.pi / 2),
    )
    waters = module._phase_functions(_water())
    assert [entry[1:] for entry in waters[:2]] == [(0.6, math.pi / 2)] * 2
    assert waters[0][0] is module._function(0.90)
    assert waters[1][0] is module._function(0.98)
    function, scattering, split = waters[2]
    assert split == math.pi / 2
    fraction, moment = function.forward_split(math.pi / 2)[:2]
    assert scattering == pytest.approx(0.5 / fraction)
    assert moment == pytest.approx(0.06, rel=1e-3)
    # Without forward light, or with a moment of no such function, two are left.
    assert len(module._phase_functions(_water(forward_scattering=0.0))) == 2
    assert len(module._phase_functions(_water(second_moment=2.0))) == 2


@pytest.mark.parametrize(
    ("asymmetry", "valid"),
    [(0.59, False), (0.61, True), (0.9985, True), (0.9995, False)],
)
def test_asymmetries_of_moments_have_limits(asymmetry: float, valid: bool) -> None:
    moment = henyey_greenstein_function(asymmetry=asymmetry).forward_split(math.pi / 2)
    found = module._asymmetry(moment[1], math.pi / 2)
    assert (found is not None) is valid
    if found is not None:
        assert found == pytest.approx(asymmetry, abs=1e-3)


def test_a_survey_of_impossible_angles_states_the_reason(plate_text: str) -> None:
    observation = _observed(_described(plate_text, "asymmetry = 0.3\n"))
    light, used = late_light(observation, RANGES, weight=WEIGHT)
    assert light.note.startswith("not known: ")
    assert "small angles do not describe" in light.note
    assert light.uncertainty is None
    assert used.depth == pytest.approx((RANGES.min(), RANGES.max()))
    assert dispersion(observation, RANGES, weight=WEIGHT)[0] is None


@pytest.mark.parametrize(
    ("attributes", "uncertainty", "relative"),
    [
        ({}, None, 0.05),
        ({}, 0.2, math.hypot(0.05, 0.2)),
        ({"phasor_line_window": 5}, None, math.hypot(0.05, 0.4)),
        ({"phasor_line_window": 5}, 0.2, math.hypot(0.05, 0.2, 0.4)),
    ],
)
def test_uncertainties_of_the_water_and_of_spots_add(
    haze: tuple[Survey, Observation],
    attributes: dict[str, int],
    uncertainty: float | None,
    relative: float,
) -> None:
    described = haze[0]
    if uncertainty is not None:
        described = described.with_(
            {"calibration": {"scattering_uncertainty": uncertainty}}
        )
    channel: xr.Dataset = haze[1].channel.assign_attrs(attributes)
    observation = replace(haze[1], survey=described, channel=channel)
    light, _ = late_light(observation, RANGES, weight=WEIGHT)
    spread = 0.5 / math.sqrt(12) / 0.75
    assert_allclose(
        light.uncertainty, math.hypot(relative, spread) * light.late, rtol=1e-9
    )
