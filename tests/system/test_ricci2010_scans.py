"""Figures 5, 6, 13, 14 and 15 of the published study: what their checks are worth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from amulor.studies.ricci2010.figures import (
    figure_05,
    figure_06,
    figure_13,
    figure_14,
    figure_15,
    panels,
)
from amulor.studies.ricci2010.parameters import varied
from amulor.studies.ricci2010.results import Check, PaperFigure, Statements
from amulor.studies.ricci2010.scenes import disc_scans, ladder_scans
from amulor.studies.ricci2010.study import Study
from amulor.view.style import style

# Parts of the published study: what a change elsewhere does not need.
pytestmark = pytest.mark.slow

FIGURES = (figure_05, figure_06, figure_13, figure_14, figure_15)
#: Metres per second in vacuum, the paper's index, and its frequency [Hz].
VELOCITY, FREQUENCY = 299_792_458 / 1.34, 39e6


@pytest.fixture(scope="module")
def study() -> Study:
    return Study(quick=True)


def with_numbers(study: Study, **numbers: float) -> Study:
    changed = study.parameters
    for name, value in numbers.items():
        changed = varied(changed, name, value)
    return study.with_parameters(changed)


def failed(checks: list[Check]) -> set[str]:
    return {check.statement for check in checks if not check.passed}


#: What honest physics does not meet with the numbers of the study.
FAILURES: dict[PaperFigure, set[str]] = {
    figure_05: {
        "the modulation frequency is above the cut-off of water that ends with the tank"
    },
    # 39 MHz is twice the cut-off of thin water.
    figure_06: {
        "the modulation frequency is just above the cut-off "
        "(modulation frequency divided by cut-off)"
    },
    figure_13: {"(c) VH, milk: steps are right within the stated 2 mm (largest error)"},
    figure_14: set(),
    # The water left in moves the disc nearer, so that it seems smaller.
    figure_15: {
        "VH, the polarizers alone: diameter of the disc",
        "VV, the polarizers alone: diameter of the disc",
        "VV, the polarizers alone: central hole",
    },
}


@pytest.mark.parametrize("figure", FIGURES)
def test_the_statements_hold_but_for_those_that_are_known_to_fail(
    study: Study, figure: PaperFigure
) -> None:
    found = figure.checks(study)
    assert failed(found) == FAILURES[figure]
    assert len({check.statement for check in found}) == len(found)


def test_only_thin_water_and_the_errors_behind_the_noise_are_no_test(
    study: Study,
) -> None:
    fixed = [c.statement for f in FIGURES for c in f.checks(study) if c.role == "set"]
    assert fixed == [
        "the water up to the ladder is optically thin (optical thickness)",
        "(a) VH, clear water: range error of a pixel",
        "(c) VH, milk: range error of a pixel",
        "(d) VV, milk: range error of a pixel",
    ]


# Numbers that do not come from here --------------------------------------------------


def test_steps_turn_the_phase_as_far_as_the_speed_of_light_says(study: Study) -> None:
    per_metre = 360 * 2 * FREQUENCY / VELOCITY
    assert 0.01 * per_metre == pytest.approx(1.2552, abs=1e-4)
    for height in (0.01, 0.04):
        found = math.degrees(ladder_scans.phase_step(study, height))
        assert found == pytest.approx(height * per_metre, rel=1e-12)


def test_crossed_in_clear_water_the_phase_floor_is_all_the_noise(study: Study) -> None:
    scan = study.once(ladder_scans.polarized_clear)
    found = scan.steps(scan.subtracted["VH"])
    floor = 0.06 / 360 * VELOCITY / (2 * FREQUENCY)
    # 2900 pixels: 1.3 % by chance; shot noise and water add less than 2 %.
    assert found.noise == pytest.approx(floor, rel=0.05)
    assert found.pixels == found.wanted > 2500


def test_no_error_exceeds_what_two_phasors_allow(study: Study) -> None:
    # For less water than target the phase is off by at most arcsin of their ratio.
    for scan_of in (ladder_scans.polarized_clear, ladder_scans.polarized_milk):
        scan = study.once(scan_of)
        for channel, ratio in scan.water_ratio.items():
            most = math.asin(ratio) * VELOCITY / (4 * math.pi * FREQUENCY)
            found = scan.steps(scan.raw[channel])
            # The ratio is a mean over the ladder; noise adds in quadrature.
            assert found.error < 1.1 * math.hypot(most, 2 * found.noise)


def test_polarizers_pass_the_published_shares_of_the_ladder(study: Study) -> None:
    # Painted metal with m22 = 0.61: 80.5 % parallel, 19.5 % crossed.
    water = {0.81: (0.905, 0.095), 0.95: (0.975, 0.025)}
    for scan_of, (parallel, crossed) in zip(
        (ladder_scans.polarized_milk, ladder_scans.polarized_clear),
        water.values(),
        strict=True,
    ):
        ratio = study.once(scan_of).water_ratio
        expected = (crossed / 0.195) / (parallel / 0.805)
        assert ratio["VH"] / ratio["VV"] == pytest.approx(expected, rel=1e-6)


def test_outlines_of_a_drawn_disc_are_its_own(study: Study) -> None:
    scan = study.once(disc_scans.bent_disc)
    image = scan.subtracted["VH"]
    across = 1.5 * np.tan(image["azimuth"].values)
    up = 1.5 * np.tan(image["elevation"].values)

    def disc(x: float, y: float, diameter: float) -> np.ndarray:
        return np.hypot(across - x, up - y) < diameter / 2

    drawn = disc(0, 0, 0.06) & ~disc(0.001, 0.002, 0.02) & ~disc(-0.02, 0, 0.005)
    image = image.assign(intensity=image["intensity"].copy(data=0.2 + 0.7 * drawn))
    flat = image.where(image["quality_flag"] < 0)  # no ranges: the stated distance
    flat["quality_flag"] = image["quality_flag"].copy(
        data=np.full(image["quality_flag"].shape, 4, dtype=np.int16)
    )
    flat["intensity"] = image["intensity"]
    found = disc_scans.outlines(flat, distance=1.5)
    assert found.rim is not None
    assert found.central_hole is not None
    assert len(found.small_holes) == 1
    for outline, true in (
        (found.rim, 0.06),
        (found.central_hole, 0.02),
        (found.small_holes[0], 0.005),
    ):
        assert abs(outline.diameter - true) < 3 * outline.uncertainty
        # Half a pixel: an error bar that covers everything would prove nothing.
        assert outline.uncertainty < 0.5e-3


# What must make a check fail ----------------------------------------------------------


def test_another_ladder_does_not_pass_for_this_one(study: Study) -> None:
    scan = study.once(ladder_scans.polarized_clear)
    steps = scan.steps(scan.subtracted["VH"])
    other = with_numbers(study, other_steps=0.0105)
    rows = Statements("", "", {"steps": {"statement": "steps"}})
    assert ladder_scans.steps_agree(study, rows, "steps", steps).passed
    assert not ladder_scans.steps_agree(other, rows, "steps", steps).passed
    assert "(a) VH, clear water: phase of the first step" in failed(
        figure_13.checks(with_numbers(study, first_step=0.044))
    )


@pytest.mark.study
def test_without_backscatter_polarizers_and_subtraction_gain_nothing(
    study: Study,
) -> None:
    clean = with_numbers(
        study, scan_backscatter=1e-12, maalox_backscatter=1e-12, long_backscatter=1e-12
    )
    assert {
        "(c) VH, milk: range error of a pixel",
        "(d) VV, milk: range error of a pixel",
        "the range error grows from (a) to (d)",
    } <= failed(figure_13.checks(clean))
    contrast = (
        "contrast of disc and surrounding water higher in VH, open water subtracted"
    )
    assert contrast in failed(figure_15.checks(clean))
    # And the frequency alone then gives the steps in the long tank.
    left = failed(figure_06.checks(clean))
    assert "the ladder is reproduced without subtraction" not in left


def test_water_of_the_sweeps_would_not_be_thin_and_would_flatten_the_ladder(
    study: Study,
) -> None:
    # Section 8 has an optical thickness above 1: at 1 1/m the water outshines a grey
    # ladder at 3.7 m, and its steps nearly vanish.
    thick = with_numbers(study, ladder_attenuation=1.0)
    assert {
        "the water up to the ladder is optically thin (optical thickness)",
        "the ladder is reproduced without subtraction",
    } <= failed(figure_06.checks(thick))


def test_a_lower_frequency_is_not_above_the_cut_off(study: Study) -> None:
    slow = with_numbers(study, frequency=15e6)
    assert any("above the cut-off" in text for text in failed(figure_05.checks(slow)))
    assert any("above the cut-off" in text for text in failed(figure_06.checks(slow)))


def test_water_that_depolarizes_like_the_paint_leaves_no_better_channel(
    study: Study,
) -> None:
    alike = with_numbers(study, maalox_m22=0.61)
    names = failed(figure_15.checks(alike))
    assert (
        "contrast of disc and surrounding water higher in VH, the polarizers alone"
        in names
    )


# Drawing ------------------------------------------------------------------------------


def test_a_surface_stands_in_space_where_the_target_stands(study: Study) -> None:
    scan = study.once(ladder_scans.polarized_clear)
    image = scan.subtracted["VH"]
    relief = panels.relief(image, origin=scan.farthest(image))
    heights = [float(np.nanmean(relief.near[scan.treads == i])) for i in range(1, 6)]
    # 580 pixels of 0.5 mm each leave 0.02 mm; the water behind the steps, which is
    # subtracted although it is not there, and the lean of the scan stay below 0.2 mm.
    assert heights == pytest.approx([0, 40, 50, 60, 70], abs=0.2)
    # Treads are 2 cm wide, from -5 to 5 cm.
    assert relief.right[scan.treads == 5].min() == pytest.approx(33, abs=1.1)
    # What is hidden by a step has no height.
    assert np.isnan(relief.near).sum() > 20


def test_a_median_surface_keeps_steps_and_loses_spikes() -> None:
    rng = np.random.default_rng(1)
    column, row = np.meshgrid(np.arange(60.0), np.arange(40.0))
    step = np.where(column < 30, 0.0, 40.0)
    near = step + rng.normal(0.0, 2.0, step.shape)
    spike = rng.random(step.shape) < 0.02
    near[spike] += 600.0
    near[:, 50] = np.nan
    place = column.copy()
    place[spike] += 15.0
    found, scatter = panels.median(panels.Relief(place, row, near))
    # 25 pixels: the median of normal noise scatters by 1.25 of the mean, 0.25 of each.
    inner = np.abs(column - 29.5) > 3
    off = (found.near - step)[inner & np.isfinite(near)]
    assert off.std() < 0.4 * 2.0
    assert np.abs(off).max() < 3.0
    # Within three columns of a step it stands where it stood, half of its height.
    assert np.all((found.near > 20)[:, 31:50])
    assert np.all((found.near < 20)[:, :29])
    assert scatter == pytest.approx(2.0, rel=0.1)
    assert np.array_equal(np.isnan(found.near), np.isnan(near))
    assert np.abs(found.right - column)[np.isfinite(near)].max() < 1.6


def test_high_meshes_are_cut_into_strips_of_the_same_surface() -> None:
    quad = np.array([[0, 0, 0], [1, 0, 39], [1, 1, 39], [0, 1, 0]], dtype=float)
    flat = quad * [1, 1, 0]
    strips, mesh = panels._in_strips(np.stack([quad, flat]))
    assert mesh.tolist() == [0] * 10 + [1]
    assert np.ptp(strips[:10, :, 2], axis=1) == pytest.approx(3.9)
    assert strips[0, 0].tolist() == [0, 0, 0]
    assert strips[9, 2].tolist() == [1, 1, 39]
    assert np.array_equal(strips[10], flat)


@pytest.mark.parametrize("figure", [figure_06, figure_13])
def test_figures_are_drawn_and_say_that_they_are_synthetic(
    study: Study, figure: PaperFigure
) -> None:
    with style():
        drawn = figure.draw(study)
        drawn.canvas.draw()
    texts = [text.get_text() for text in drawn.texts]
    assert any("synthetic" in text for text in texts)
    assert "synthetic" in figure.caption.lower()
