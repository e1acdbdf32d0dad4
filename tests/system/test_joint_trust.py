"""Trust in the joint estimation, on scenes of the trust study."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from paper_form import follow_paper_form
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import imaging, rejection, simulate
from amulor.cube import QualityFlag
from amulor.studies.trust.scenes import models, samples
from amulor.studies.trust.scenes.knowledge import believing
from amulor.studies.trust.study import run
from amulor.studies.trust.surveys import plate, scaled, survey
from amulor.studies.trust.table import Score


def holds(score: Score, *, trusted: float) -> bool:
    """Return whether so many pixels are trusted, and their intervals hold.

    A scene has 384 pixels: 68 and 95 % are known to 2.4 and 1.1 points by chance, and
    three of these are allowed. One of 1,000 scenes has more than two pixels beyond
    3.5 sigma by chance.
    """
    return (
        score.trusted >= trusted
        and score.inside_68 > 0.68 - 0.072
        and score.inside_95 > 0.95 - 0.033
        and score.far <= 2.5 / 384
        and not score.phantoms > 0
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene", ["wide", pytest.param("tall", marks=pytest.mark.study)]
)
def test_large_scans_are_followed(scene: str) -> None:
    # Scans of 9 x 19 and 19 x 4 degrees were refused.
    for row in run([scene], ["joint, no shots"], [2, 4]):
        assert holds(row.score, trusted=0.99), row


@pytest.mark.slow
def test_water_that_fluctuates_more_than_open_water_widens_the_interval() -> None:
    # In harbour water the 95 % interval held in 89 %: the water before the target
    # weighed as open water does, whose ends interfere at high frequencies.
    for row in run(["harbour"], ["joint, no shots"], [2, 16]):
        assert holds(row.score, trusted=0.98), row


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene", ["flat", "wide", pytest.param("tall", marks=pytest.mark.study)]
)
def test_water_of_the_form_of_the_paper_is_followed(
    scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    follow_paper_form(monkeypatch)
    for row in run([scene], ["joint, no shots"], [4]):
        assert holds(row.score, trusted=0.99), row


@pytest.mark.parametrize("shots", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "function",
    [
        'kind = "petzold", station = "HAOCE 11"',
        pytest.param(
            'kind = "two-term", forward_asymmetry = 0.9, backward_asymmetry = -0.4, '
            "forward_weight = 0.97",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_survey_may_name_another_phase_function(function: str, shots: bool) -> None:
    # By the diffusion form none was trusted, up to 7 mm off and 0.8 stated.
    water = {
        "absorption": 0.15,
        "scattering": 0.35,
        "phase_function": f"{{{function}}}",
    }
    # Where the water counts most.
    target = plate(2.6, lean=20, reflectance=0.02)
    cube = simulate(survey(4, target, water=water), rng=1)
    surfaces = cube.amulor.truth["slant_range"].values
    believed = believing(cube, survey(4, target))
    hidden = "truth_" if shots else ("truth_", "open_water_")
    names = [n for n in believed.data_vars if str(n).startswith(hidden)]
    found = rejection.joint(believed.drop_vars(names), interval=(1.7, 3.5))
    good = (found["quality_flag"].values == 0).all(axis=(0, 1))
    assert good.mean() > 0.99
    error = found["joint_slant_range"].values - surfaces
    z = np.abs(error / found["joint_slant_range_uncertainty"].values)[good]
    # 384 pixels: standard errors of 2.4 and 1.1 points, three of each.
    assert np.mean(z < 1) == pytest.approx(0.683, abs=0.072)
    assert np.mean(z < 1.96) == pytest.approx(0.95, abs=0.034)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_absorption_and_scattering_of_the_survey_do_not_count(factor: float) -> None:
    name = "a, b doubled" if factor > 1 else "a, b halved"
    for row in run([name], ["joint"], [2, 16]):
        assert holds(row.score, trusted=0.99), row


@pytest.mark.study
@pytest.mark.parametrize("scene", ["spikes", "particles"])
def test_spoiled_samples_cost_no_trust(scene: str) -> None:
    # 42 to 90 % were trusted, with intervals up to ten times too wide.
    for row in run([scene], ["joint", "joint, no shots"], [2, 16]):
        assert holds(row.score, trusted=0.93), row
    plain = run(["flat"], ["joint, no shots"], [16])[0].score
    # Three or four per cent of the samples are gone; spikes take one per cent of the
    # precision, particles, which pull what all pixels share, sixteen.
    assert row.score.uncertainty < 1.2 * plain.uncertainty


@pytest.mark.slow
def test_water_that_drifts_during_the_scan_is_followed() -> None:
    # After a drift of 10 % none was trusted without shots, 2 mm off.
    case = samples.drift(4, 1, change=0.10)
    shots = [n for n in case.samples.data_vars if str(n).startswith("open_water_")]
    # A receiver that may look elsewhere sees water of other strength in other rows.
    found = rejection.joint(
        case.samples.drop_vars(shots),
        interval=case.interval,
        receiver_direction_uncertainty=0.0,
    )
    # The strength goes from 1 to 1.1 times that of the first pixel, 1.05 on average.
    assert found.attrs["joint_water_drift"] == pytest.approx(0.1 / 1.05, abs=0.01)
    assert 0.001 < found.attrs["joint_water_drift_uncertainty"] < 0.01
    # With its direction open 0.13 is found for 0.095, and said to be that uncertain.
    found = rejection.joint(case.samples.drop_vars(shots), interval=case.interval)
    drift, error = (
        found.attrs[f"joint_water_drift{end}"] for end in ("", "_uncertainty")
    )
    assert 0.01 < error < 0.04
    assert abs(drift - 0.1 / 1.05) < 2.5 * error
    row = run(["drift 10 %"], ["joint"], [4])[0]
    assert holds(row.score, trusted=0.99), row


def test_a_sample_that_is_left_out_is_flagged_and_its_pixel_is_not() -> None:
    case = samples.spikes(4, 1)
    found = rejection.joint(case.samples, interval=case.interval)
    flag = found["quality_flag"].values
    outlying = (flag & QualityFlag.OUTLIER) != 0
    whole = outlying.all(axis=(0, 1))
    # 3 % of the samples are spikes, of which the smallest drown.
    assert 0.02 < outlying[:, :, ~whole].mean() < 0.035
    error = np.abs(found["joint_slant_range"].values - case.surfaces[0])
    some = outlying.any(axis=(0, 1)) & ~whole
    off = error / found["joint_slant_range_uncertainty"].values
    assert some.sum() > 50
    assert off[some].max() < 4.5


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 16])
def test_two_surfaces_in_one_beam_are_told_from_one(count: int) -> None:
    case = samples.mixed(count, 1, gap=0.08)
    found = rejection.joint(case.samples, interval=case.interval)
    flag = np.bitwise_and.reduce(found["quality_flag"].values, axis=(0, 1))
    two = (flag & QualityFlag.MIXED) != 0
    assert two[case.judged].mean() > 0.99
    # By chance one in 10,000.
    assert two[~case.judged].mean() < 0.01
    for name, surface in (("nearer", 0), ("farther", 1)):
        where = found[f"joint_{name}_surface"].values[case.judged]
        # Half the gap at most: which is which is settled.
        error = where - case.surfaces[surface][case.judged]
        assert abs(np.median(error)) < 0.02
        assert np.quantile(np.abs(error), 0.9) < 0.04


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_late_light_counts_once_where_the_shape_of_the_water_shows(count: int) -> None:
    case = models.flat(count, 1)
    # As measured: nobody says that the light is not late.
    measured = case.samples.assign_attrs(simulated=0)
    measured.attrs.pop("late_echo", None)
    stated = []
    for part in (0.5, 0.0):
        found = rejection.joint(
            measured, interval=case.interval, late_echo_uncertainty=part
        )
        image = imaging.range_image(found, polarization="VV", interval=case.interval)
        assert image.attrs["late_echo_correction"] == "taken off"
        stated.append(image["slant_range_uncertainty"].values)
    if count == 2:
        # Two frequencies cannot show another shape: both uncertainties are kept.
        assert (stated[0] > 1.5 * stated[1]).all()
    else:
        # The delay that the image takes off has its own uncertainty, and no other.
        assert_allclose(stated[0], stated[1], rtol=0.02)


def _with_shots_of(cube: xr.Dataset, factor: float) -> xr.Dataset:
    """Return samples whose shots are of water of other absorption and scattering."""
    water = scaled("tank", factor)
    other = simulate(survey(4, plate(2.6, lean=20), water=water), rng=6)
    shots = {n: other[n] for n in other.data_vars if str(n).startswith("open_water_")}
    return cubes.without_groups(cube, "truth").assign(shots)


@pytest.mark.study
@pytest.mark.parametrize(
    ("late", "trusted"),
    [pytest.param(0.0, 0.97, marks=pytest.mark.study), (0.022, 0.0)],
)
def test_shots_of_other_water_do_not_hide_an_echo_that_is_late(
    late: float, trusted: float
) -> None:
    # All were trusted, 22 mm off and 1.9 stated: shots of other water let the water of
    # the model depart, and what departs then was allowed ten times more.
    cube = simulate(survey(4, plate(2.6, lean=20)), rng=1)
    truth = cube.amulor.truth
    rate = 2 * np.pi * cube["modulation_frequency"].values / speed_of_light
    # Light of one pulse comes back with an exponential tail of this mean, which is no
    # delay alone; the survey knows of none.
    spread = 1 / (1 - 1j * rate * 2 * 1.38 * late)
    target = truth["target_in_phase"].values + 1j * truth["target_quadrature"].values
    change = (spread[:, None, None, None] - 1) * target
    cube["in_phase"].values[...] += change.real
    cube["quadrature"].values[...] += change.imag
    found = rejection.joint(_with_shots_of(cube, 0.5), interval=(1.7, 3.5))
    good = (found["quality_flag"].values == 0).all(axis=(0, 1))
    off = found["joint_slant_range"].values - truth["slant_range"].values
    off = off / found["joint_slant_range_uncertainty"].values
    if late:
        assert good.mean() == trusted
        assert np.abs(np.median(off)) > 5
    else:
        assert good.mean() > trusted
        assert (np.abs(off[good]) < 1.96).mean() > 0.95 - 0.034
