"""Predicted errors: closed forms, other ways to the same numbers, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.constants import Planck, speed_of_light

from amulor.design import TERMS, evaluate, geometry
from amulor.design._kernels import _amplified, assess, astray
from amulor.design.axes import AXES, arranged
from amulor.design.light import case_of, lit
from amulor.design.numbers import _repetition
from amulor.errors import SurveyError
from amulor.optics import ambiguity
from amulor.simulation import SmallAngleModel, expectation
from amulor.survey import Survey, water_properties
from amulor.survey.view import view

RANDOM = ("shot", "dark", "daylight", "phase_floor", "fluctuation", "reference")


def test_one_frequency_in_clear_water_has_the_photon_limit(tank: Survey) -> None:
    clear = tank.with_(
        {
            "water.scattering": 0.0,
            "water.absorption": 0.01,
            "water.asymmetry": None,
            "instrument.polarizations": ["none"],
            "instrument.detector.dark_rate": 0.0,
            "instrument.lock_in.phase_floor": 0.0,
        }
    )
    frequency, distance = 60e6, 3.0
    found = evaluate(
        clear, distance=distance, frequency=frequency, baseline=0.0, method="none"
    )
    # All by hand: a Gaussian receiver on the axis, Lambert's law, Poisson statistics.
    overlap = np.pi * (0.02 * 0.06) ** 2 / (0.02**2 + (0.06 * distance) ** 2)
    light = 0.2 / np.pi * overlap * np.exp(-2 * 0.01 * distance)
    rate = 0.02 * 0.3 * 0.25 * 532e-9 / (Planck * speed_of_light) * light
    settled = 0.02 - 5e-3
    time = settled / (1 - 1e-3 / settled * (1 - np.exp(-settled / 1e-3)))
    sigma = np.sqrt(2 * 1.2 / (rate * time)) / 0.8
    expected = speed_of_light / (4 * np.pi * frequency * 1.38) * sigma
    # The overlap goes through a spline, see `amulor.design.light`.
    assert_allclose(found["standard_uncertainty"], expected, rtol=1e-3)
    assert_allclose(found["shot"], expected, rtol=1e-3)
    # Rounding of a picometre's millionth is left, by the order of the sums.
    assert abs(found["residual_bias"]) < 1e-15


def test_the_random_terms_add_up_and_water_and_footprint_are_the_bias(
    tank: Survey,
) -> None:
    found = evaluate(
        tank,
        distance=[1.5, 2.5],
        frequencies=[[39e6], [30e6, 90e6]],
        polarization=["VH", "VV+VH"],
        method=["none", "open-water"],
        fluctuation=0.05,
        slope=0.3,
    )
    assert found["total_error"].dims == (
        "method", "polarization", "distance", "frequency_set",
    )  # fmt: skip
    square = sum(found[name] ** 2 for name in RANDOM)
    assert_allclose(found["standard_uncertainty"] ** 2, square, rtol=1e-12)
    bias = np.hypot(found["water_left_in"], found["footprint"])
    assert_allclose(found["residual_bias"], bias, rtol=1e-12)
    total = np.hypot(found["standard_uncertainty"], found["residual_bias"])
    assert_allclose(found["total_error"], total, rtol=1e-12)
    assert found["binding_term"].attrs["flag_meanings"].split() == list(TERMS)


def test_light_and_noise_are_those_of_the_simulation(tank: Survey) -> None:
    one = tank.with_(
        {"scan.columns": 1, "scan.rows": 1, "instrument.lock_in.phase_floor": 0.0}
    )
    expected = expectation(one)
    found = evaluate(one, distance=2.0, method="none", late_light=False)
    # Of the echo alone: what is kept also holds water, which is put off by method.
    clean = evaluate(one, distance=2.0, late_light=False)
    own = float(np.hypot(clean["shot"], clean["dark"]))
    scale = speed_of_light / (4 * np.pi * 39e6 * 1.38)
    # The baseline of 10 cm makes the slope of range by path 1 part in 3000 different.
    assert_allclose(own, scale / expected.signal_to_noise.item(), rtol=3e-3)
    # The shift by the water that is kept: from the model itself, by hand.
    water = water_properties(one)
    seen = view(one, np.zeros(1), np.zeros(1))
    common = {"survey": one, "water": water, "view": seen}
    surface = {
        "depth": np.full(1, 2.0),
        "optical_path": np.full(1, 1.38 * (2.0 + np.hypot(2.0, 0.1))),
        "return_path": np.full(1, np.hypot(2.0, 0.1)),
        "reflectance": 0.2,
        "cosine": 2.0 / np.hypot(2.0, 0.1),
    }
    frequency = np.array([[39e6]])
    model = SmallAngleModel()
    echo = 0.3 * model.echo(frequency, surface=surface, **common)
    column = 0.075 * model.column(frequency, end=np.full(1, 2.0), **common)
    shift = np.abs(np.angle(1 + column / echo)) * scale
    assert_allclose(found["water_left_in"], shift.item(), rtol=5e-3)


def test_a_window_and_a_sharp_receiver_are_those_of_the_simulation(
    tank: Survey,
) -> None:
    window = {"distance": 0.05, "thickness": 0.01, "reflection_loss": True}
    one = tank.with_(
        {
            "scan.columns": 1,
            "scan.rows": 1,
            "instrument.lock_in.phase_floor": 0.0,
            "instrument.window": window,
            "instrument.receiver.edge": "sharp",
            "instrument.receiver.azimuth": -0.066,
        }
    )
    found = evaluate(one, distance=2.0, late_light=False)
    scale = speed_of_light / (4 * np.pi * 39e6 * 1.38)
    own = float(np.hypot(found["shot"], found["dark"]))
    # Sharp edges leave kinks in the overlap, through which the spline goes.
    expected = scale / expectation(one).signal_to_noise.item()
    assert_allclose(own, expected, rtol=0.02)


def test_wrong_intervals_are_as_frequent_as_picked_by_imaging() -> None:
    frequency, sigma, distance = np.array([100e6, 130e6]), 0.22, 2.0
    to_range = speed_of_light / (4 * np.pi * frequency)
    predicted, _ = astray(to_range, np.full(2, sigma**2), 0.0, distance, 0.0, 4.99)
    rng = np.random.default_rng(5)
    count = 20_000
    path = 2 * distance
    phase = 2 * np.pi * frequency[:, None] * path / speed_of_light
    phase = phase + sigma * rng.standard_normal((2, count))
    picked = ambiguity.optical_path(
        phase,
        np.full((2, count), sigma),
        modulation_frequency=frequency,
        shortest=np.zeros(count),
        longest=np.full(count, 2 * 4.99),
    )
    wrong = np.abs(picked.length - path) > 0.5 * speed_of_light / frequency[1]
    share = wrong.mean()
    error = np.sqrt(share * (1 - share) / count)
    assert 0.005 < share < 0.5
    # The sum over all wrong intervals is an upper limit, nearly reached by a few.
    assert share - 3 * error < predicted < 1.25 * share + 3 * error


def test_the_compiled_loop_is_the_one_that_is_written(
    tank: Survey, monkeypatch
) -> None:
    kept = []

    def watched(method, points, light, scratch, out) -> None:
        assess(method, points, light, scratch, out)
        again = np.empty_like(out)
        assess.py_func(method, points, light, scratch, again)
        kept.append((out.copy(), again))

    monkeypatch.setattr("amulor.design.numbers.assess", watched)
    evaluate(
        tank,
        distance=[1.0, 2.0],
        frequencies=[[20e6, 60e6]],
        polarization="VV+VH",
        method=["none", "frequency", "open-water", "polarization", "combined", "joint"],
    )
    assert len(kept) == 6
    for compiled, written in kept:
        assert_allclose(compiled, written, rtol=1e-9)


def test_arrays_with_dimensions_of_their_own_are_kept_together(tank: Survey) -> None:
    draws = {
        "attenuation": xr.DataArray([0.2, 0.5], dims="draw"),
        "reflectance": xr.DataArray([0.1, 0.3], dims="draw"),
    }
    found = evaluate(tank, distance=[1.0, 2.0], **draws)
    assert dict(found.sizes) == {"distance": 2, "draw": 2}
    alone = evaluate(tank, distance=2.0, attenuation=0.5, reflectance=0.3)
    assert_allclose(
        found["total_error"].sel(distance=2.0, draw=1), alone["total_error"], rtol=1e-3
    )


def test_ranges_beyond_the_repetition_are_ambiguous_and_too_much_light_saturates(
    tank: Survey,
) -> None:
    found = evaluate(tank, distance=[1.0, 3.0], power=[1e-3, 100.0])
    # c / (2 n f) = 2.785 m.
    assert found["ambiguous"].values.tolist() == [[0, 0], [1, 1]]
    assert found["saturated"].values[0].tolist() == [0, 1]
    two = evaluate(tank, distance=3.0, frequencies=[[39e6, 50e6]])
    assert two["ambiguous"] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"distnce": 1.0}, "is no axis of a design"),
        ({"power": -1.0}, "must be above 0"),
        ({"reflectance": [0.5, 2.0]}, "found 2 1"),
        ({"attenuation": 1.0, "absorption": 0.1}, "sum of absorption and scattering"),
        ({"frequency": 1e6, "frequencies": [[1e6]]}, "not both"),
        ({"method": "polarization"}, "needs a co-polarized channel"),
        ({"method": "magic"}, "must be one of"),
        ({"polarization": "VX"}, "polarization:"),
        ({"radiance": 1.0}, "needs the bandwidth"),
        ({"power": np.ones((2, 2))}, "dimensions without names"),
    ],
)
def test_what_cannot_be_evaluated_is_said(arguments, said, tank: Survey) -> None:
    with pytest.raises(SurveyError, match=said):
        evaluate(tank, **arguments)


#: Least and largest value of each axis, in SI units, and whether the least is allowed:
#: a share is from 0 to 1, an element of a Mueller matrix from -1 to 1, a slope and a
#: field of view below those for which the small-angle forms hold.
LIMITS = {
    "distance": (0.0, np.inf, False),
    "attenuation": (0.0, np.inf, False),
    "absorption": (0.0, np.inf, True),
    "scattering": (0.0, np.inf, True),
    "reflectance": (0.0, 1.0, False),
    "target_m22": (-1.0, 1.0, True),
    "water_m22": (-1.0, 1.0, True),
    "slope": (0.0, 1.5, True),
    "texture": (0.0, np.inf, True),
    "power": (0.0, np.inf, False),
    "modulation_depth": (0.0, 1.0, False),
    "frequency": (0.0, np.inf, False),
    "baseline": (0.0, np.inf, True),
    "aim": (0.0, np.inf, False),
    "radius": (0.0, np.inf, False),
    "field_of_view": (0.0, 0.5, False),
    "dwell": (0.0, np.inf, False),
    "speed": (0.0, np.inf, True),
    "phase_floor": (0.0, np.inf, True),
    "dark_rate": (0.0, np.inf, True),
    "radiance": (0.0, np.inf, True),
    "fluctuation": (0.0, 1.0, True),
    "water_change": (0.0, 1.0, True),
    "column_uncertainty": (0.0, 1.0, True),
    "ratio_uncertainty": (0.0, 1.0, True),
    "departure": (0.0, 1.0, True),
}


def test_each_axis_has_its_limits_on_both_sides() -> None:
    assert set(LIMITS) == set(AXES)
    for name, (least, most, allowed) in LIMITS.items():
        good = [least + 1e-9, min(most, 1e12), *([least] if allowed else [])]
        wrong = [least - 1e-9, np.nan, *([] if allowed else [least])]
        if np.isfinite(most):
            wrong.append(most + 1e-9)
        # A receiver parallel to the beam aims at infinity.
        (good if name == "aim" else wrong).append(np.inf)
        arranged({name: good}, None)
        for value in wrong:
            with pytest.raises(SurveyError, match=f"{name}: found {value:g} "):
                arranged({name: [value]}, None)


def test_ranges_repeat_at_the_smallest_frequency_or_difference() -> None:
    # c / (2 n f): 1 m at 108.56 MHz in water of group index 1.38.
    tone = speed_of_light / (2 * 1.38 * 1.0)
    sets = np.array([[tone, 2 * tone], [np.nan, 2.5 * tone]])
    assert_allclose(_repetition(sets, 1.38), [1.0, 2.0], rtol=1e-12)


def test_elements_of_mueller_matrices_as_axes_are_those_of_a_survey(tank) -> None:
    options = {"polarization": ["VV", "VH"], "distance": [1.0, 2.0]}
    stated = evaluate(tank, **options)
    same = evaluate(tank, target_m22=0.4, water_m22=0.85, **options)
    assert_allclose(same["total_error"], stated["total_error"], rtol=1e-9)
    white = tank.with_({"targets.0.mueller": "ideal-depolarizer"})
    none = evaluate(tank, target_m22=0.0, **options)
    assert_allclose(
        none["total_error"], evaluate(white, **options)["total_error"], rtol=1e-9
    )
    assert np.all(abs(none["total_error"] / stated["total_error"] - 1) > 0.01)


def test_an_analyzer_passes_half_of_the_daylight(tank) -> None:
    lit = tank.with_(
        {
            "daylight": {"radiance": "0.01 W/m^2/sr/nm", "bandwidth": "3 nm"},
            "targets.0.mueller": "ideal-depolarizer",
        }
    )
    bare, behind = (
        float(evaluate(lit, polarization=pair, method="none")["daylight"])
        for pair in ("none", "VH")
    )
    # Half of the noise's square, and half of the echo of an ideal depolarizer.
    assert behind / bare == pytest.approx(np.sqrt(0.5) / 0.5, rel=0.01)


def test_open_water_of_a_narrow_view_is_that_of_the_simulation(tank: Survey) -> None:
    """The view begins in front of the crossing; behind it, light cancels at 200 MHz."""
    frequency = np.array([39e6, 120e6, 200e6])
    narrow = geometry.with_receiver(
        tank.with_(
            {
                "scan.columns": 1,
                "scan.rows": 1,
                "instrument.receiver.acceptance": 0.02,
                "instrument.modulation_frequencies": frequency.tolist(),
            }
        ),
        baseline=0.15,
        aim=3.7,
    )
    water = water_properties(narrow)
    found = lit(
        case_of(narrow, water), {"distance": np.array([3.7])}, frequency, joint=False
    ).light.water[0, 0]
    seen = view(narrow, np.zeros((1, 1)), np.zeros((1, 1)))
    model, common = SmallAngleModel(), {"survey": narrow, "water": water, "view": seen}
    before, all_of_it = (
        model.column(
            frequency[:, None, None], end=np.full((1, 1), end), **common
        ).ravel()
        for end in (3.7, 60.0)
    )
    # In parts of the water before the target, which is the larger one.
    assert_allclose(abs(found[0] / before - 1), 0.0, atol=0.004)
    assert_allclose(abs(found[1] - all_of_it) / abs(before), 0.0, atol=0.004)
    assert abs(all_of_it[2] / before[2]) < 0.3


def test_water_before_the_target_has_the_noise_of_its_multiple() -> None:
    assert _amplified(1 + 1j, 2 - 2j) == pytest.approx(0.25)
    assert _amplified(1j, 1.0) == pytest.approx(1.0)
    assert _amplified(3j, 1.0) == pytest.approx(81.0)
