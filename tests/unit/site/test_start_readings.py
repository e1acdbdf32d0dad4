"""Tests of start poses: readings of them, gates, overlaps and heights."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

from amulor.site.description import StartPose
from amulor.site.registration import starts
from amulor.site.registration.starts import (
    StartFindings,
    height_above,
    part_met,
    start_findings,
)


def start(**changes: Any) -> StartPose:
    stated: dict[str, Any] = {
        "position": (1.0, 2.0, 3.0), "heading": 0.4, "pitch": -0.3, "roll": 0.1,
        "position_uncertainty": 0.05, "heading_uncertainty": 0.03,
        "level_uncertainty": 0.01,
    }  # fmt: skip
    return StartPose.model_validate(stated | changes)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("their third coordinate counts", {"position": (1, 2, -3)}),
        ("third coordinate and their pitch", {"position": (1, 2, -3), "pitch": 0.3}),
        ("their pitch counts downwards", {"pitch": 0.3}),
        ("east and north are swapped", {"position": (2, 1, 3)}),
        # East, counterclockwise: a quarter turn less the angle.
        ("counts from east", {"heading": math.pi / 2 - 0.4}),
        # 0.4 rad that were read as 0.4 degrees are 22.9 of the unit: 22.92 - 8 pi rad.
        (
            "their angles are radians",
            {
                "heading": 0.4 * 57.29577951 - 8 * math.pi,
                "pitch": -0.3 * 57.29577951 + 6 * math.pi,
                "roll": 0.1 * 57.29577951 - 2 * math.pi,
            },
        ),
        ("headings are radians", {"heading": 0.4 * 57.29577951 - 8 * math.pi}),
    ],
)
def test_each_reading_changes_what_it_says(
    words: str, expected: dict[str, Any]
) -> None:
    (changed,) = (to for text, to in starts._READINGS if words in text)
    found = changed(start())
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=1e-6), name


def gate(
    away: float, apart: float, position: float, turn: float, level: float
) -> float:
    cloud = np.zeros((50, 3))
    cloud[:, 0], cloud[:, 2] = apart * np.arange(50), 0.0
    cloud[:, 1] = np.sqrt(np.maximum(away**2 - cloud[:, 0] ** 2, 0.0))
    pose = start(
        position_uncertainty=position, heading_uncertainty=turn, level_uncertainty=level
    )
    return starts._gate(pose, cloud)


@pytest.mark.parametrize(
    ("position", "turn", "level", "expected"),
    [
        # Three standard deviations, between 50 mm and 300 mm.
        (0.03, 1e-6, 1e-6, 0.09),
        (1e-6, 0.03, 1e-6, 0.18),
        (1e-6, 1e-6, 0.03, 0.18),
        (0.01, 1e-6, 1e-6, 0.05),
        (0.2, 1e-6, 1e-6, 0.3),
    ],
)
def test_a_gate_has_the_size_of_the_errors_of_a_start_pose(
    position: float, turn: float, level: float, expected: float
) -> None:
    assert gate(2.0, 1e-4, position, turn, level) == pytest.approx(expected, rel=1e-6)


def test_a_gate_is_two_spacings_at_least() -> None:
    assert gate(0.0, 0.2, 0.03, 1e-6, 1e-6) == pytest.approx(0.4)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Callable[..., np.ndarray]:
    """Return a function that draws start poses: position, heading, pitch and roll."""
    given: list[dict[str, Any]] = []
    monkeypatch.setattr(starts, "_placed", lambda *words: given.append(words[2]))

    def draw(pose: StartPose) -> np.ndarray:
        list(starts._draws({"s": pose}, {"s": np.zeros((1, 3))}))
        names = ("heading", "pitch", "roll")
        return np.array(
            [[*one["position"], *(one[name] for name in names)] for one in given]
        )

    return draw


def test_draws_have_the_stated_errors(
    drawn: Callable[..., np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(drawn(start())) == 20
    monkeypatch.setattr(starts, "_DRAWS", 2000)
    values = drawn(start())[20:]
    expected = [0.05, 0.05, 0.05, 0.03, 0.01, 0.01]
    # The scatter of 2,000 draws has an error of 1.6 %.
    assert_allclose(values.std(axis=0), expected, rtol=0.07)
    off = (values.mean(axis=0) - [1, 2, 3, 0.4, -0.3, 0.1]) / expected
    assert np.abs(off).max() < 4 / np.sqrt(2000)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_draw_is_never_beyond_upright(
    drawn: Callable[..., np.ndarray], sign: float
) -> None:
    pitch = drawn(start(pitch=sign * math.pi / 2, level_uncertainty=0.5))[:, 4]
    assert np.abs(pitch).max() < math.pi / 2
    # Half of the draws would be beyond, and are upright.
    assert 4 <= int((sign * pitch > 1.57079).sum()) <= 16


def cloud_at(*heights: float) -> cKDTree:
    """Return one point for each height above the same place."""
    return cKDTree([[0.0, 0.0, height] for height in heights])


def test_a_share_is_of_points_within_the_larger_gate_of_any_other_scan() -> None:
    placed = {
        "a": cloud_at(0.0, 1.0, 2.0, 3.0, 4.0),
        "b": cloud_at(0.19),
        "c": cloud_at(2.05),
        "d": cloud_at(3.05),
    }
    gates = {"a": 0.1, "b": 0.2, "c": 0.05, "d": 0.01}

    def share(*others: str) -> float:
        return starts._share("a", list(others), placed, gates)

    assert share("b") == pytest.approx(0.2)
    assert share("b", "c") == pytest.approx(0.4)
    assert share("b", "c", "d") == pytest.approx(0.6)
    assert starts._share("a", ["b"], placed, gates | {"b": 0.18}) == 0.0


def test_the_agreement_is_of_the_smaller_overlap_of_each_scan() -> None:
    placed = {
        "a1": cloud_at(0.0, 1.0),
        "a2": cloud_at(0.0),
        "b1": cloud_at(0.0, 1.0, 5.0, 6.0),
    }
    gates = dict.fromkeys(placed, 0.1)
    visits = {"a": ["a1", "a2"], "b": ["b1"]}
    # With own and other visits: a1 1/2 and 1, a2 1 and 1; b1 has no other scan: 1/2.
    for scans, expected in (
        (["a1"], 0.5), (["a2"], 1.0), (["b1"], 0.5), (["a1", "a2", "b1"], 2 / 3)
    ):  # fmt: skip
        found = starts._agreement(visits, scans, placed, gates)
        assert found == pytest.approx(expected)


def plan(heights: np.ndarray, points: int, *, off: float = 0.0) -> np.ndarray:
    """Return some points at a height in each of a row of cells of 0.25 m."""
    x = 0.25 * np.repeat(np.arange(len(heights)), points) + 0.1
    z = np.repeat(heights, points) + off
    return np.stack([x, 0 * x + 0.1, z], axis=1)


def test_a_height_is_the_median_over_common_cells() -> None:
    heights = np.array([0.0, 1.0, -1.0, 0.5, 2.0, 0.0])
    off = np.array([3.0, 3.1, 2.9, 3.0, 3.0, 9.0])
    found = height_above(plan(heights + off, 5), plan(heights, 5))
    assert found == (pytest.approx(3.0), 6)
    below = height_above(plan(heights, 5), plan(heights + off, 5))
    assert below == (pytest.approx(-3.0), 6)


@pytest.mark.parametrize(
    ("cells", "points", "scatter", "is_clear"),
    [
        (6, 5, 0.0, True),
        (5, 5, 0.0, False),
        # A cell needs five points, and half of the cells lie within a fifth.
        (6, 4, 0.0, False),
        (6, 5, 0.19, True),
        (6, 5, 0.21, False),
    ],
)
def test_a_height_is_clear_by_cells_points_and_scatter(
    cells: int, points: int, scatter: float, is_clear: bool
) -> None:
    sign = np.where(np.arange(cells) % 2 == 0, 1.0, -1.0)
    above = plan(1 + scatter * sign, points)
    assert (height_above(above, plan(np.zeros(cells), points)) is not None) == is_clear


def test_cells_are_squares_of_a_quarter_of_a_meter_in_the_plan() -> None:
    # Five points in each of ten squares in one direction, and the same in the other.
    for axis in (0, 1):
        points = np.zeros((50, 3))
        points[:, axis] = np.repeat(np.arange(10) * 0.25 + 0.2, 5)
        points[:, 2] = 1.0
        assert height_above(points, points * [1, 1, 0]) == (pytest.approx(1.0), 10)


def test_points_are_met_within_three_decimeters() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    others = np.array([[0.0, 0.29, 0.0], [1.0, 0.31, 0.0]])
    assert part_met(points, others) == pytest.approx(1 / 3)


def bed(rng: np.random.Generator, count: int, *middle: float) -> np.ndarray:
    x, y = rng.uniform(-1.0, 1.0, (2, count)) + np.array(middle)[:, None]
    return np.stack([x, y, 0.2 * np.sin(2 * x) + 0.15 * np.cos(3 * y)], axis=1)


def site(poses: dict[str, tuple[str, StartPose]]) -> Any:
    """Return visits and scans with start poses, the visits in order."""
    scans = [
        SimpleNamespace(name=name, epoch=epoch, start=pose)
        for name, (epoch, pose) in poses.items()
    ]
    epochs = dict.fromkeys(epoch for epoch, _ in poses.values())
    return SimpleNamespace(
        scan=scans,
        epoch=[SimpleNamespace(name=name) for name in epochs],
        scans_of=lambda name: [scan for scan in scans if scan.epoch == name],
    )


def down(**changes: Any) -> StartPose:
    """Return a start that looks straight ahead to the north, 3 m above the bed."""
    return start(position=(0.0, 0.0, 3.0), heading=0.0, pitch=0.0, roll=0.0, **changes)


def seen(pose: StartPose, points: np.ndarray) -> np.ndarray:
    return starts.start_pose(pose).back(points)


def findings(
    stated: dict[str, StartPose], true: dict[str, StartPose], **places: Any
) -> StartFindings:
    """Return the findings for scans of 1,600 points, each of a visit of its own."""
    rng = np.random.default_rng(8)
    clouds = {
        name: seen(pose, bed(rng, 1600, *places.get(name, (0.0, 0.0))))
        for name, pose in true.items()
    }
    return start_findings(
        site({name: (f"of {name}", pose) for name, pose in stated.items()}), clouds
    )


def test_a_depth_in_place_of_a_height_is_corrected() -> None:
    true = {"a": down(), "b": down(), "c": down(position_uncertainty=0.06)}
    wrong = true["c"].model_copy(update={"position": (0.0, 0.0, -3.0)})
    found = findings(true | {"c": wrong}, true)
    (line,) = found.mistakes
    assert line.startswith(
        "visit 'of c': start poses of c bring 0% of their points onto other scans, and"
    )
    assert "if their third coordinate counts downwards" in line
    assert line.endswith(
        "; or state the uncertainty of these start poses as large as it is"
    )
    (poor,) = found.poor
    assert poor.startswith("visit 'of c': start poses of c bring 0%")
    assert "check [scan.start], or state the uncertainty" in poor
    assert list(found.corrected) == ["c"]
    assert found.corrected["c"].position == (0.0, 0.0, 3.0)
    assert found.remarks == ()


def test_right_starts_and_a_single_one_have_no_finding() -> None:
    true = {"a": down(), "b": down()}
    assert findings(true, true) == StartFindings(mistakes=(), remarks=())
    assert findings({"a": down()}, {"a": down()}) == StartFindings(
        mistakes=(), remarks=()
    )


def test_a_visit_in_another_datum_is_told_by_its_height() -> None:
    true = {"a": down(), "b": down(position_uncertainty=0.06)}
    for off, where in ((5.5, "above"), (-2.5, "below")):
        wrong = true["b"].model_copy(update={"position": (0.0, 0.0, 3.0 + off)})
        found = findings(true | {"b": wrong}, true)
        remark = found.remarks[0]
        assert remark.startswith("visit 'of b' meets no scan of another visit")
        assert f"it lies {abs(off):.2f} m {where} the others" in remark
        # 2 m x 2 m have 64 whole cells; at the rim some have few points.
        cells = re.search(r"in (\d+) common cells", remark)
        assert cells is not None
        assert 60 <= int(cells[1]) <= 81


def test_a_scan_that_lies_elsewhere_is_named() -> None:
    true = {"a": down(), "b": down(), "c": down(position_uncertainty=0.06)}
    found = findings(true, true, c=(40.0, 0.0))
    assert found.mistakes == ()
    assert "visit 'of c' meets no scan of another visit" in found.remarks[0]
    assert found.remarks[0].endswith("check [scan.start], or scan what both visits see")
    assert found.remarks[1:] == (
        "scan 'c' meets no other scan at its start pose; check [scan.start]",
    )
