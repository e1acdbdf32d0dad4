"""Scale of a site and group index by a bar: a bar left out, and closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from amulor.site.registration import network
from amulor.site.registration.absolute import ScaleTest, WaterIndex, scale_tests
from amulor.site.registration.network import (
    Centre,
    KnownDistance,
    KnownPoint,
    KnownPose,
    Layout,
    State,
    Ties,
)
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.result import (
    Registration,
    read_registration,
    write_registration,
)
from amulor.view import site_report
from amulor.view.sheet import error_ellipse, separate

KEY = "group_index: water"
INDEX, RELATIVE = 1.36, 5e-4
WATERS = {KEY: WaterIndex(value=INDEX, relative_uncertainty=RELATIVE)}
NOISE = 2e-4
PLACES = {"A": np.array([-0.9, 0.2, 2.4]), "B": np.array([0.8, -0.3, 2.1])}
LENGTH = float(np.linalg.norm(PLACES["A"] - PLACES["B"]))
POSE = ScanPose(np.eye(3), np.zeros(3))


def drawn(rng: np.random.Generator, *, scale: float, sigma: float = 1e-4) -> Ties:
    """Observations of one scan whose ranges are too long by a factor."""
    return Ties(
        start={"s": KnownPose(pose=POSE, covariance=np.diag([0.01] * 3 + [1e-3] * 3))},
        centres=[
            Centre(
                target=name, scan="s", covariance=NOISE**2 * np.eye(3),
                shared={KEY: RELATIVE * place},
                position=place * (1 + scale) + NOISE * rng.normal(size=3),
            )
            for name, place in PLACES.items()
        ],
        bars=[
            KnownDistance(
                ends=("A", "B"), length=LENGTH + sigma * rng.normal(), sigma=sigma
            )
        ],
    )  # fmt: skip


def adjusted(ties: Ties) -> tuple[State, np.ndarray, Layout]:
    state = State({"s": POSE}, dict(PLACES), {KEY: 0.0})
    for _ in range(5):
        state = network.step(state, [], ties, []).state
    spread, _, layout = network.covariance(state, [], ties, [], {})
    return state, spread, layout


def scale_by_bar(ties: Ties) -> ScaleTest:
    (test,) = scale_tests(*adjusted(ties), ties, WATERS)
    return test


def test_the_length_is_that_of_an_adjustment_without_the_bar() -> None:
    ties = drawn(np.random.default_rng(1), scale=8e-4)
    test = scale_by_bar(ties)
    state, spread, layout = adjusted(replace(ties, bars=()))
    between = state.points["A"] - state.points["B"]
    unit = between / np.linalg.norm(between)
    slope = np.concatenate([unit, -unit])
    at = layout.columns("point", ("A", "B"), 3)
    assert test.measured == pytest.approx(np.linalg.norm(between), abs=2e-7)
    assert test.measured_uncertainty == pytest.approx(
        np.sqrt(slope @ spread[np.ix_(at, at)] @ slope), rel=1e-3
    )
    bar = ties.bars[0]
    both = np.hypot(test.measured_uncertainty, bar.sigma)
    assert test.scale == pytest.approx(test.measured / bar.length, rel=1e-12)
    assert test.score == pytest.approx((test.measured - bar.length) / both, rel=1e-9)


def test_the_group_index_is_the_factor_of_both_lengths() -> None:
    ties = drawn(np.random.default_rng(2), scale=8e-4)
    test = scale_by_bar(ties)
    ends = [centre.position for centre in ties.centres]
    raw = float(np.linalg.norm(ends[0] - ends[1]))
    # A range is proportional to 1 / n: the longer length asks for the larger index.
    assert test.group_index == pytest.approx(
        INDEX * raw / ties.bars[0].length, abs=1e-6
    )
    error = np.hypot(ties.bars[0].sigma, np.sqrt(2) * NOISE) / LENGTH
    assert test.group_index_uncertainty == pytest.approx(INDEX * error, rel=2e-3)
    assert test.stated_index == INDEX
    assert test.stated_index_uncertainty == pytest.approx(INDEX * RELATIVE)


def test_scores_and_indices_of_drawn_bars_have_the_stated_errors() -> None:
    rng = np.random.default_rng(3)
    scores, pulls = [], []
    for _ in range(150):
        scale = RELATIVE * rng.normal()
        test = scale_by_bar(drawn(rng, scale=scale))
        assert test.group_index is not None
        assert test.group_index_uncertainty is not None
        scores.append(test.score)
        true = INDEX * (1 + scale)
        pulls.append((test.group_index - true) / test.group_index_uncertainty)
    for values in (scores, pulls):
        # The mean of 150 draws has the error 0.08, their scatter 0.06.
        assert abs(np.mean(values)) < 0.3
        assert np.std(values) == pytest.approx(1, abs=0.2)


def test_control_points_leave_little_of_the_length_to_the_index() -> None:
    rng = np.random.default_rng(4)
    ties = replace(
        drawn(rng, scale=8e-4),
        control={
            name: KnownPoint(position=place, sigma=np.full(3, 1e-6))
            for name, place in PLACES.items()
        },
    )
    test = scale_by_bar(ties)
    assert test.measured == pytest.approx(LENGTH, abs=4e-6)
    index, uncertainty = test.group_index, test.group_index_uncertainty
    # Either no index follows, or one with an error far above the stated one.
    assert index is None or (uncertainty or 0) > 100 * INDEX * RELATIVE


def test_a_bar_between_targets_that_nothing_measures_has_no_test() -> None:
    ties = drawn(np.random.default_rng(5), scale=0.0)
    loose = replace(
        ties,
        centres=[
            replace(centre, covariance=1e4 * np.eye(3)) for centre in ties.centres
        ],
    )
    assert scale_tests(*adjusted(loose), loose, WATERS) == ()


def test_a_site_without_bars_has_no_test() -> None:
    ties = replace(drawn(np.random.default_rng(6), scale=0.0), bars=())
    assert scale_tests(*adjusted(ties), ties, WATERS) == ()


def test_the_scale_is_in_the_file_the_report_and_in_words(tmp_path: Path) -> None:
    test = scale_by_bar(drawn(np.random.default_rng(7), scale=8e-4))
    result = Registration(
        site="dock", poses={}, points={}, errors={}, places={},
        covariance=np.zeros((0, 0)), pairs=(), disagreements=(), weaknesses=(),
        contradictions=(), remarks=(), settled=True, scale=(test,),
    )  # fmt: skip
    write_registration(result, tmp_path / "poses.json")
    assert read_registration(tmp_path / "poses.json").scale == (test,)
    index = f"{test.group_index:.5f} +- {test.group_index_uncertainty:.5f}"
    scale = f"{test.scale:.6f} +- {test.scale_uncertainty:.6f}"
    assert index in test.sentence
    assert scale in test.sentence
    registration: Any = SimpleNamespace(scale=(test,))
    (row,) = site_report._scale(registration).rows
    assert index.replace("+-", "±") in row
    assert scale.replace("+-", "±") in row


def test_labels_of_close_stations_overlap_neither_each_other_nor_ellipses() -> None:
    figure = Figure(figsize=(4, 4), layout="constrained")
    axes = figure.subplots()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    labels, ellipses = [], []
    for name, place in {"a1": (0.5, 0.5), "b1": (0.52, 0.5), "c1": (0.5, 0.53)}.items():
        labels.append(
            axes.annotate(
                name, place, xytext=(8, 8), textcoords="offset points",
                ha="center", va="center",
            )
        )  # fmt: skip
        ellipse = error_ellipse(place, np.diag([4e-4, 1e-4]), factor=1, colour="k")
        ellipses.append(axes.add_patch(ellipse))
    separate(axes, labels, ellipses)
    figure.draw_without_rendering()
    boxes = [label.get_window_extent() for label in labels]
    others = [ellipse.get_window_extent() for ellipse in ellipses]
    for number, box in enumerate(boxes):
        assert box.count_overlaps(boxes[number + 1 :] + others) == 0
