"""Figures 1, 3 and 4 of the published study: the water signal of the long tank."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.constants import speed_of_light
from scipy.integrate import quad

from amulor.studies.ricci2010.figures import (
    depths,
    figure_01,
    figure_03,
    figure_04,
    low_pass,
)
from amulor.studies.ricci2010.parameters import varied
from amulor.studies.ricci2010.results import Check
from amulor.studies.ricci2010.scenes import water_sweeps
from amulor.studies.ricci2010.study import Study


@pytest.fixture(scope="module")
def study() -> Study:
    return Study(quick=True)


def _with(study: Study, **values: float) -> Study:
    parameters = study.parameters
    for name, value in values.items():
        parameters = varied(parameters, name, value)
    return study.with_parameters(parameters)


def _only(checks: list[Check], words: str) -> Check:
    (found,) = [check for check in checks if words in check.statement]
    return found


# Oracles that know nothing of the code ----------------------------------------------


def _amplitude(
    frequency: np.ndarray, *, loss: float, spread: float, baseline: float = 0.2
) -> np.ndarray:
    """Return the modulus of (46) by a sum over 200 000 depths, R 2 cm, 0.08 rad."""
    depth = (np.arange(200_000) + 0.5) * 2e-4
    area = 0.02**2 + (0.08 * depth) ** 2 + 2 / 3 * spread * depth**3
    weight = np.exp(-2 * loss * depth - baseline**2 / area) / area
    wave = 4 * np.pi * 1.34 / speed_of_light
    turned = [weight @ np.exp(1j * wave * f * depth) for f in frequency]
    return np.abs(turned) / weight.sum()


@pytest.mark.parametrize("turbidity", water_sweeps.TURBIDITIES)
def test_both_diffusion_curves_are_the_integral_46(study, turbidity) -> None:
    found = water_sweeps.sweep(study, turbidity)
    k, moment = {"low": (0.5, 0.05), "high": (1.0, 0.06)}[turbidity]
    g = found.water.phase_function.asymmetry
    # Share of Henyey-Greenstein below 90 degrees, in closed form.
    forward = (1 + g) / (2 * g) * (1 - (1 - g) / np.hypot(1, g))
    b = 0.7 * k
    for curve, loss, spread in (
        (found.simple, k, 0.0),
        (found.realistic, 0.3 * k + (1 - forward) * b, forward * b * moment),
    ):
        chosen = slice(None, None, 11)
        expected = _amplitude(found.frequency[chosen], loss=loss, spread=spread)
        # The midpoint rule in steps of 0.2 mm, a hundredth of the receiver.
        np.testing.assert_allclose(curve.amplitude[chosen], expected, atol=1e-5)
        level = _amplitude(np.array([curve.cut_off]), loss=loss, spread=spread)
        assert level[0] == pytest.approx(np.sqrt(0.5), abs=1e-5)


@pytest.mark.parametrize("turbidity", water_sweeps.TURBIDITIES)
def test_the_phase_function_has_the_second_moment_of_the_study(
    study, turbidity
) -> None:
    g = water_sweeps.water(study, turbidity).phase_function.asymmetry

    def weight(theta: float, power: int) -> float:
        bracket = 1 + g**2 - 2 * g * np.cos(theta)
        return theta**power * np.sin(theta) / bracket**1.5

    edges = [0.0, 1 - g, 0.3, np.pi / 2]
    above, below = (
        sum(quad(weight, *pair, args=(power,))[0] for pair in pairwise(edges))
        for power in (2, 0)
    )
    # Quadrature in three pieces, 1e-8 each.
    expected = study[f"second_moment_{turbidity}"]
    assert above / below == pytest.approx(expected, rel=1e-6)


def test_a_narrow_receiver_on_the_axis_sees_a_low_pass_of_first_order(study) -> None:
    # Eq. (49): the simple cut-off is v k / 2 pi, and (71) is the curve itself.
    found = water_sweeps.sweep(
        _with(study, long_baseline=0.0, acceptance=1e-4), "low"
    ).simple
    expected = speed_of_light / 1.34 * 0.5 / (2 * np.pi)
    # The acceptance is not 0: gamma / 2 k R is 0.005.
    assert found.cut_off == pytest.approx(expected, rel=1e-3)
    assert found.fitted == pytest.approx(expected, rel=1e-3)


def test_photons_and_small_angle_form_agree_within_the_errors(study) -> None:
    for turbidity in water_sweeps.TURBIDITIES:
        found = water_sweeps.sweep(study, turbidity)
        curve = found.monte_carlo
        assert 0.01 < curve.cut_off_error / curve.cut_off < 0.06
        apart = curve.cut_off - found.small_angle.cut_off
        # Runs to 0.3 % put the small-angle form 1 % high.
        assert abs(apart + 0.01 * curve.cut_off) < 4 * curve.cut_off_error


# What the figures say ---------------------------------------------------------------


def test_figure_1_keeps_what_the_text_says(study) -> None:
    checks = figure_01.checks(study)
    assert all(check.passed for check in checks)
    # What (46) gives over the family of numbers that fits the text: 1.2 to 1.7 m and
    # 2.4 to 4.2 m.
    assert 1.2 < depths.profile(study, "low").peak < 1.7
    nearer = _only(checks, "few meters, low turbidity, diffusion")
    assert nearer.value is not None
    assert 2.4 < nearer.value < 4.2


FAILS = (
    "photon transport computes",
    "diffusion form and a free fit of (71)",
    "the realistic diffusion form agrees with photon transport",
    "measurement: a free fit of (71) agrees",
    "measurement: a free fit of (71) coincides",
    "curves: a free fit of (71)",
    "curves: a fit of (71) to power",
)


@pytest.mark.parametrize("figure", [figure_03, figure_04])
def test_figures_3_and_4_fail_where_the_diffusion_form_does(study, figure) -> None:
    checks = figure.checks(study)
    failed = {check.statement for check in checks if not check.passed}
    words = list(FAILS)
    if figure is figure_04:
        words.append("measurement: a fit of (71) to power coincides")
    assert failed == {_only(checks, text).statement for text in words}
    ratio = _only(checks, "diffusion form agrees with photon transport").value
    assert ratio is not None
    # Decision 7: 1.57 to 1.66 against the small-angle form; the photons' error is 4 %.
    assert 1.4 < ratio < 1.9


def test_both_fits_of_71_are_those_of_the_closed_form(study) -> None:
    # (71) fitted by a dense search to the integral (46) that knows nothing of the code:
    # 0.96 and 0.95 of half power for the realistic water, 1.07 and 1.08 of the simple.
    for turbidity, moment, k in (("low", 0.05, 0.5), ("high", 0.06, 1.0)):
        found = water_sweeps.sweep(study, turbidity)
        g = found.water.phase_function.asymmetry
        forward = (1 + g) / (2 * g) * (1 - (1 - g) / np.hypot(1, g))
        b, chosen = 0.7 * k, slice(None, None, 5)
        f = found.frequency[chosen]
        amplitude = _amplitude(
            f, loss=0.3 * k + (1 - forward) * b, spread=forward * b * moment
        )
        corner = np.linspace(10e6, 40e6, 3001)[:, None]
        square = 1 / (1 + (f / corner) ** 2)
        power = np.sum((square - (amplitude / amplitude.max()) ** 2) ** 2, axis=1)
        shape = np.sqrt(square)
        level = shape @ amplitude / np.sum(shape**2, axis=1)
        free = np.sum((level[:, None] * shape - amplitude) ** 2, axis=1)
        # A fifth of the frequencies: the sums weigh the same range.
        assert found.realistic.of_power == pytest.approx(
            corner[np.argmin(power), 0], rel=0.01
        )
        assert found.realistic.fitted == pytest.approx(
            corner[np.argmin(free), 0], rel=0.02
        )
    assert found.realistic.of_power / found.simple.of_power == pytest.approx(
        1.08, abs=0.01
    )


def test_accordance_that_a_number_was_chosen_for_is_no_test(study) -> None:
    chosen = [check for check in figure_03.checks(study) if check.role == "set"]
    # The share of absorption makes both diffusion curves agree.
    assert [check.statement for check in chosen] == [
        "cut-offs of simple and realistic water agree, "
        "both computed by the diffusion form"
    ]


# The checks can fail, and can pass --------------------------------------------------


def test_a_receiver_on_the_axis_sees_the_water_right_at_the_instrument(study) -> None:
    checks = figure_01.checks(_with(study, long_baseline=0.0))
    assert not _only(checks, "directly at the instrument").passed
    assert not _only(checks, "maximum lies in the first meters, low").passed


def test_clear_water_is_seen_from_farther_than_a_few_metres(study) -> None:
    checks = figure_01.checks(_with(study, attenuation_low=0.05))
    assert not _only(checks, "few meters, low turbidity, diffusion").passed


def test_less_turbid_water_in_figure_4_is_noticed(study) -> None:
    checks = figure_04.checks(
        _with(study, attenuation_high=0.3, second_moment_high=0.04)
    )
    assert not _only(checks, "higher than in figure 3").passed
    assert not _only(checks, "second moment larger").passed


def test_checks_of_curves_follow_the_curves(study) -> None:
    found = water_sweeps.sweep(study, "low")
    # Were transport what the diffusion form says, it would agree with it.
    agreeing = replace(found, monte_carlo=found.realistic)
    checks = low_pass.sweep_checks(agreeing)
    assert _only(checks, "diffusion form agrees with photon transport").passed
    assert not _only(checks, "small-angle form agrees with photon transport").passed
    wrong = replace(
        found.simple,
        amplitude=1.02 * found.simple.amplitude,
        cut_off=1.3 * found.simple.cut_off,
        at_cut_off=0.6,
    )
    checks = low_pass.sweep_checks(replace(found, simple=wrong))
    for words in (
        "exceeds 1",
        "of half power",
        "agree, both computed by the diffusion form",
    ):
        first = next(check for check in checks if words in check.statement)
        assert not first.passed


def test_noise_moves_the_squares_alone(study) -> None:
    noisy = water_sweeps.sweep(_with(study, amplitude_noise=0.03), "low")
    quiet = water_sweeps.sweep(study, "low")
    assert noisy.monte_carlo.cut_off == quiet.monte_carlo.cut_off
    # The fit's error goes with the noise.
    ratio = (
        noisy.first_order.fit.cut_off_standard_error
        / quiet.first_order.fit.cut_off_standard_error
    )
    assert ratio == pytest.approx(3, rel=0.2)


# Looks ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("figure", "synthetic"),
    [(figure_01, False), (figure_03, True), (figure_04, True)],
)
def test_figures_have_units_and_say_what_is_synthetic(
    study, figure, synthetic: bool
) -> None:
    drawn = figure.draw(study)
    assert [axis.get_title(loc="left")[:3] for axis in drawn.axes] == ["(a)", "(b)"]
    for axis in drawn.axes:
        assert axis.get_xlabel().endswith("]")
    legend = [text.get_text() for text in drawn.axes[0].get_legend().get_texts()]
    assert any("synthetic" in text for text in legend) == synthetic
    assert ("SYNTHETIC" in figure.caption) == synthetic
