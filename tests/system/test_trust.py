"""Trust: what a user may believe of scenes that the methods were not made for."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from amulor import imaging, io, rejection
from amulor.cli import main
from amulor.cube import QualityFlag
from amulor.simulation import simulate
from amulor.studies.trust.scenes import models
from amulor.studies.trust.study import run
from amulor.studies.trust.surveys import plate, survey

# Ambiguity --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.study)])
def test_a_target_beyond_the_repetition_of_the_phases_is_never_trusted(
    count: int,
) -> None:
    # 50 MHz repeat after 2.17 m and the plate stands at 3.0 m; 20 and 80 MHz repeat
    # after 5.43 m and it stands at 6.2 m. Nobody states an interval.
    methods = ["open-water 20 %", "polarization", "combined"]
    for row in run(["far" if count == 1 else "far two"], methods):
        assert row.score.pixels == 384
        assert row.score.trusted == 0, row


def test_the_same_pixels_are_right_once_the_interval_is_stated() -> None:
    case = models.far(1, 1)
    target = rejection.open_water(
        case.samples, interval=(2.2, 3.8), column_uncertainty=0.2
    )
    image = imaging.range_image(target, polarization="VV", interval=(2.2, 3.8))
    # Half a metre would be a wrong interval; noise and column are centimetres.
    assert np.nanmax(np.abs(image["slant_range"] - case.surfaces[0])) < 0.1
    assert (image["quality_flag"].values == 0).mean() > 0.9


@pytest.mark.slow
def test_commands_compare_the_interval_with_the_targets_of_the_survey(
    tmp_path: Path, capsys
) -> None:
    text = survey(1, plate(3.0), columns=6, rows=4).to_toml()
    (tmp_path / "far.toml").write_text(text)
    assert main(["survey", "check", str(tmp_path / "far.toml")]) == 0
    warned = " ".join(capsys.readouterr().out.split())
    # c / 2 n f with n = 1.38: 2.172 m; the corner beams lean by 2.5 degrees.
    assert "phases repeat after 2.172 m" in warned
    farthest = 3 / math.cos(math.radians(2)) / math.cos(math.radians(1.5))
    assert f"to {farthest:.4g} m away" in warned
    cube, signal, image = (tmp_path / f"{name}.nc" for name in ("cube", "signal", "i"))
    assert main(["simulate", str(tmp_path / "far.toml"), "-o", str(cube)]) == 0
    assert "need --nearest and --farthest" in capsys.readouterr().out
    options = ["--method", "open-water", "-o", str(signal)]
    assert main(["reject", str(cube), *options]) == 0
    chosen = ["image", str(signal), "--polarization", "VH", "-o"]
    assert main([*chosen, str(image)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "all pixels flagged" in said
    flags = io.read_cube(image)["quality_flag"].values
    assert ((flags & (QualityFlag.RELATIVE | QualityFlag.NO_TARGET)) != 0).all()
    assert main(["report", str(image), "-o", str(tmp_path / "r.html")]) == 0
    assert "off by whole intervals" in (tmp_path / "r.html").read_text()
    limits = ["--nearest", "2.2 m", "--farthest", "3.8 m", "--overwrite"]
    assert main([*chosen, str(image), *limits]) == 0
    found = io.read_cube(image)["slant_range"].values
    assert np.nanmedian(found) == pytest.approx(3.0, abs=0.05)


def test_survey_check_says_the_reach_and_the_repetition_as_json(
    tmp_path: Path, capsys
) -> None:
    file = tmp_path / "two.toml"
    file.write_text(survey(2, plate(2.0)).to_toml())
    assert main(["survey", "check", str(file), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["interval_unsettled"] == ""
    # 20 MHz is the smallest frequency and 60 MHz the difference.
    assert said["phases_repeat_after_m"] == pytest.approx(
        299792458.0 / (2 * 1.38 * 20e6)
    )
    assert said["target_reach_m"][0] == pytest.approx(2.0, rel=2e-3)


# Phantoms ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "count",
    [
        pytest.param(1, marks=pytest.mark.slow),
        2,
        pytest.param(4, marks=[pytest.mark.slow, pytest.mark.study]),
    ],
)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_empty_water_shows_no_target(count: int, seed: int) -> None:
    for row in run(["empty"], ["open-water 20 %", "combined"], [count], seed=seed):
        assert row.score.empty == 384
        # 1 in 100,000 is what is promised, of some 4,600 pixels in all.
        assert row.score.phantoms == 0, row


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_black_surface_ends_the_water_and_is_no_target(count: int) -> None:
    cube = simulate(survey(count, plate(2.6, lean=20)), rng=1)
    dark = cube.assign(
        {
            part: cube[part].copy(data=cube[part] - cube[f"truth_target_{part}"])
            for part in ("in_phase", "quadrature")
        }
    )
    target = rejection.open_water(dark, interval=(1.7, 3.5), column_uncertainty=0.2)
    flags = target["quality_flag"].values
    assert ((flags & QualityFlag.NO_TARGET) != 0).mean() > 0.999
    image = imaging.range_image(target, polarization="VV", interval=(1.7, 3.5))
    assert np.isnan(image["slant_range"]).all()


@pytest.mark.slow
def test_weak_targets_are_still_seen() -> None:
    # A plate of 1 % sends back less than the water in front of it.
    rows = run(["dark"], ["open-water 20 %", "combined"], [1, 4])
    assert all(row.score.trusted > 0.98 for row in rows), rows
    # 384 pixels: 1.1 % by chance, three of them.
    assert all(row.score.inside_95 > 0.917 for row in rows), rows


# Interpolation between the shots ----------------------------------------------------


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_three_rows_of_shots_on_a_tall_scan_state_what_they_cannot_know(
    count: int,
) -> None:
    # 9 x 3 shots on 9 x 19 degrees: the field of view falls off within half of that.
    for row in run(["tall"], ["open-water 20 %", "combined"], [count]):
        assert row.score.trusted > 0.9, row
        assert row.score.inside_95 > 0.93, row
        # Four of 448 pixels are, at two frequencies, and none beyond 4 sigma.
        assert row.score.far < 0.01, row
        assert row.score.worst < 4.2, row
        assert row.score.phantoms < 0.01, row


@pytest.mark.slow
def test_survey_check_asks_for_denser_shots_where_the_scan_is_wide(
    tmp_path: Path, capsys
) -> None:
    said = {}
    for name, options in {
        "small": {},
        "tall": {"wide": 9, "tall": 19},
        "sparse": {"wide": 19, "tall": 4, "shot_columns": 3},
        "flat": {"shot_rows": 1},
        "few": {"shot_rows": 1, "shot_columns": 2, "repeats": 2, "rows": 1},
    }.items():
        file = tmp_path / f"{name}.toml"
        file.write_text(survey(1, plate(1.5), **options).to_toml())
        assert main(["survey", "check", str(file)]) == 0
        said[name] = " ".join(capsys.readouterr().out.split())
    assert "open-water shots" not in said["small"]
    # A polynomial through them would miss 40 %: they are measured against a model.
    assert "open-water shots" not in said["tall"]
    assert "3 x 3 open-water shots miss up to" in said["sparse"]
    assert "plan at least" in said["sparse"]
    assert "9 x 1 open-water shots will be refused: they do not reach" in said["flat"]
    assert "they are 4, and 5 are needed" in said["few"]


# Spikes -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.study
def test_small_spikes_in_two_channels_are_seen_among_the_neighbours() -> None:
    # 2.2 and 2.0 % of the trusted were beyond 3.5 sigma, up to 10.
    for seed in (1, 2):
        (row,) = run(["spikes"], ["polarization"], [2], seed=seed)
        assert row.score.trusted > 0.88, row
        assert row.score.inside_95 > 0.96, row
        # Two of 384 pixels.
        assert row.score.far < 0.006, row


def test_a_spike_at_the_best_of_four_frequencies_is_told_by_the_other_channel() -> None:
    # 1.1 % of the trusted were beyond 3.5 sigma, up to 7 by open water.
    for row in run(["spikes"], ["open-water", "combined"], [4], seed=2):
        assert row.score.trusted > 0.95, row
        assert row.score.inside_95 > 0.93, row
        # One of 384 pixels.
        assert row.score.far < 0.003, row


# The column behind the target -------------------------------------------------------


@pytest.mark.parametrize(
    "scene",
    [
        "flat",
        *(
            pytest.param(name, marks=[pytest.mark.slow, pytest.mark.study])
            for name in ("a, b doubled", "coastal")
        ),
        pytest.param("a, b halved", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(
    "counts", [[2], pytest.param([1, 16], marks=pytest.mark.slow)], ids=str
)
def test_open_water_by_default_is_trusted_and_holds_whatever_the_survey_says(
    scene: str, counts: list[int]
) -> None:
    # Nothing was trusted by default; with a survey twice off, 12 sigma were.
    for row in run([scene], ["open-water", "combined"], counts):
        assert row.score.trusted > 0.95, row
        # 384 pixels, and an error that they share: three points of chance.
        assert row.score.inside_95 > 0.92, row
        assert row.score.inside_68 > 0.60, row
        assert row.score.worst < 4.2, row


@pytest.mark.slow
def test_water_of_another_model_is_in_the_error_of_the_column() -> None:
    # The whole phase function, where 95 % intervals held in 0 to 1 % of the pixels.
    for row in run(["small-angle 90"], ["open-water", "combined"], [2, 16]):
        assert row.score.trusted > 0.95, row
        assert row.score.inside_95 > 0.93, row
        assert row.score.worst < 3.8, row


@pytest.mark.slow
def test_dark_treads_and_risers_are_right_or_flagged() -> None:
    for row in run(["stairs"], ["open-water", "combined"], [2, 16]):
        assert row.score.trusted > 0.9, row
        assert row.score.inside_95 > 0.92, row
        assert row.score.worst < 4.2, row


# Mixed pixels -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "scene", ["mixed 2 cm", pytest.param("mixed 5 cm", marks=pytest.mark.slow)]
)
def test_pixels_that_see_two_plates_are_not_called_good(scene: str) -> None:
    # Two columns between the plates; all were trusted, 91 to 137 sigma off.
    for row in run([scene], ["open-water", "combined"], [16]):
        assert row.score.pixels == 32
        assert row.score.trusted == 0, row


@pytest.mark.slow
@pytest.mark.study
def test_one_frequency_of_two_noisy_channels_sees_two_plates_as_well() -> None:
    # Noise of 1.2 mm: 75 % of the pixels were trusted, 8 or 12 mm off.
    for row in run(["mixed 2 cm"], ["polarization"], [1]):
        assert row.score.pixels == 32
        assert row.score.trusted <= 0.1, row


@pytest.mark.parametrize(
    "scene", [pytest.param("flat", marks=pytest.mark.slow), "slope 75"]
)
def test_surfaces_without_an_edge_have_no_mixed_pixels(scene: str) -> None:
    for row in run([scene], ["open-water"], [16]):
        # Five sigma from both sides at once do not happen in 384 pixels; in one
        # image of ten there is an outlier by chance.
        assert row.score.trusted > 1 - 1.5 / 384, row


# What spoils samples, and water that is not that of the shots ------------------------


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param("change 5 %", marks=pytest.mark.slow),
        pytest.param("drift 3 %", marks=[pytest.mark.slow, pytest.mark.study]),
        "drift 10 %",
    ],
)
@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_water_that_changed_is_seen_through(scene: str, count: int) -> None:
    # 63 % of the intervals held with water 5 % stronger; drifts were refused.
    for row in run([scene], ["open-water", "combined"], [count]):
        assert row.score.trusted > 0.97, row
        # 384 pixels: 1.1 % by chance, three of them, and what all of them share.
        assert row.score.inside_95 > 0.91, row
        assert row.score.far == 0, row


@pytest.mark.parametrize(
    "scene", ["spikes", pytest.param("particles", marks=pytest.mark.slow)]
)
def test_a_phase_that_disagrees_costs_neither_the_pixel_nor_the_interval(
    scene: str,
) -> None:
    # Of 16 frequencies 3 to 4 % are spoiled: half of the pixels were given up, and in
    # combinations of channels three quarters.
    for row in run([scene], ["open-water", "combined"], [16]):
        assert row.score.trusted > 0.95, row
        assert row.score.inside_95 > 0.91, row
        assert row.score.worst < 5, row


@pytest.mark.study
def test_noise_that_is_twice_what_is_stated_is_noticed() -> None:
    # 71 to 75 % of the intervals held.
    for row in run(["noise"], ["open-water", "polarization"], [16]):
        assert row.score.trusted > 0.95, row
        assert row.score.inside_95 > 0.87, row


@pytest.mark.parametrize(
    "scene",
    [*(pytest.param(name, marks=pytest.mark.slow) for name in ("delay", "index")),
     "baseline"],
)  # fmt: skip
def test_what_no_data_can_show_is_covered_where_it_is_stated(scene: str) -> None:
    for row in run([f"{scene} stated"], ["combined"], [2]):
        assert row.score.trusted > 0.97, row
        # All pixels share the error: they are inside together.
        assert row.score.inside_95 > 0.99, row
        assert row.score.worst < 2.5, row


@pytest.mark.slow
def test_what_was_acquired_is_worth_what_was_simulated() -> None:
    # Stages that jitter by 20 microradians, dark readings, takes; the scan is broken
    # off in its middle and taken up again.
    for row in run(["acquired twice"], ["open-water", "combined"], [2]):
        assert row.score.trusted > 0.97, row
        assert row.score.inside_95 > 0.91, row
        assert row.score.worst < 4.5, row


@pytest.mark.parametrize(
    "scene",
    [
        "noise",
        pytest.param("wide", marks=pytest.mark.study),
        pytest.param("tall", marks=pytest.mark.study),
    ],
)
def test_understated_noise_and_wide_scans_hold_with_few_frequencies(scene: str) -> None:
    # 72 to 91 % and 57 to 98 %: no residual showed the noise, and 9 x 3 shots were
    # spanned by polynomials of the signal, which missed up to 40 % of it.
    for row in run([scene], ["open-water", "combined"], [1]):
        assert row.score.trusted > 0.98, row
        assert row.score.inside_95 > 0.92, row
        assert row.score.worst < 4.5, row


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize(
    "scene",
    ["wide", "noise", "tall", "wide paper's form"],
)
def test_the_same_with_two_and_four_frequencies(scene: str) -> None:
    for row in run([scene], ["open-water", "combined", "polarization"], [2, 4]):
        assert row.score.trusted > 0.95, row
        assert row.score.inside_95 > 0.92, row
        assert row.score.worst < 4.5, row


@pytest.mark.slow
def test_water_of_the_papers_form_is_put_back_by_that_form() -> None:
    # 85 and 82 % were inside: the column behind the target was that of another model,
    # four times as uncertain as by the one that the shots prefer.
    for row in run(["wide paper's form"], ["open-water", "combined"], [16]):
        assert row.score.trusted > 0.95, row
        assert row.score.inside_95 > 0.92, row
        assert row.score.worst < 4.2, row
        assert row.score.uncertainty < 0.15, row


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    ["photons c 0.25 1/m", "photons c 1 1/m"],
)
@pytest.mark.study
def test_intervals_hold_from_half_to_three_attenuation_lengths(scene: str) -> None:
    for row in run([scene], ["open-water", "combined", "polarization"], [2, 4]):
        assert row.score.trusted > 0.95, row
        assert row.score.inside_95 > 0.92, row
        assert row.score.worst < 4, row


@pytest.mark.study
@pytest.mark.parametrize(
    "function",
    [
        "petzold",
        pytest.param("fournier-forand", marks=pytest.mark.study),
        pytest.param("two-term", marks=pytest.mark.study),
    ],
)
def test_intervals_hold_the_surface_in_water_made_of_photons(function: str) -> None:
    # They held in 0 to 4 % of the trusted pixels, or none was trusted: late light was
    # in no error, and the column behind the target was the model's.
    methods = ["combined", "polarization"]
    for row in run([f"photons {function} grey"], methods, [2, 4, 16]):
        assert row.score.trusted > 0.95, row
        assert row.score.inside_95 > 0.92, row
        assert row.score.worst < 4, row
    for row in run([f"photons {function} grey"], ["open-water"], [1, 2, 4]):
        assert row.score.trusted > 0.6, row
        assert row.score.inside_95 > 0.95, row


# The whole study --------------------------------------------------------------------

#: Off by what no data can show, and the survey does not say so.
UNKNOWABLE = {"delay", "baseline", "index"}


@pytest.mark.study
@pytest.mark.parametrize("method", ["open-water", "combined", "polarization"])
@pytest.mark.parametrize("count", [1, 2, 4, 16])
def test_what_is_trusted_holds_in_every_scene(method: str, count: int) -> None:
    wrong = []
    for row in run(None, [method], [count]):
        score = row.score
        if row.scene in UNKNOWABLE or row.scene.startswith("mixed"):
            continue
        if score.empty and score.phantoms > 0:
            wrong.append(row)
        if score.trusted > 0 and (score.inside_95 < 0.87 or score.far > 0.05):
            wrong.append(row)
    assert not wrong, wrong
