"""Reliability of observations by W. Baarda, against closed forms of small networks."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.site.registration import network
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
from amulor.site.registration.reliability import (
    Reliability,
    group_of,
    non_centrality,
    observation_groups,
    reliabilities,
)

#: Standard uncertainties of control points and of a bar between two of them [m].
SIGMA, BAR = 2e-3, 1e-3
#: A chance of 0.1 % on both sides, and a power of 80 %: 3.29053 + 0.84162.
POWER = 4.13215


def adjusted(ties: Ties, state: State) -> tuple[State, np.ndarray, Layout]:
    for _ in range(4):
        state = network.step(state, [], ties, []).state
    spread, _, layout = network.covariance(state, [], ties, [], {})
    return state, spread, layout


def lines_of(ties: Ties, state: State) -> dict[tuple[str, str], Reliability]:
    return {
        (line.observation, line.part): line
        for line in reliabilities(*adjusted(ties, state), ties)
    }


def test_the_standardized_error_that_a_test_detects_is_tabulated() -> None:
    assert non_centrality(1e-3) == pytest.approx(POWER, abs=1e-4)
    # 1.95996 + 0.84162.
    assert non_centrality(0.05) == pytest.approx(2.80158, abs=1e-4)


def test_a_bar_between_control_points_has_the_reliability_of_a_difference() -> None:
    places = {"A": np.zeros(3), "B": np.array([2.0, 0.0, 0.0])}
    off = 4e-3
    ties = Ties(
        start={},
        control={
            name: KnownPoint(position=place, sigma=np.full(3, SIGMA))
            for name, place in places.items()
        },
        bars=[KnownDistance(ends=("A", "B"), length=2.0 - off, sigma=BAR)],
    )
    lines = lines_of(ties, State({}, dict(places), {}))
    # The length by control points has a variance of 2 x 4, the bar of 1 mm^2.
    both = (2 * SIGMA**2 + BAR**2) ** 0.5
    bar = lines["bar A B", "length"]
    assert bar.redundancy == pytest.approx(BAR**2 / both**2)
    assert bar.residual == pytest.approx(off * BAR**2 / both**2, rel=1e-4)
    assert bar.uncertainty == pytest.approx(BAR)
    assert bar.score == pytest.approx(off / both, rel=1e-4)
    assert bar.detectable == pytest.approx(POWER * both, rel=1e-4)
    assert (bar.external_scan, bar.external) == ("", 0.0)
    east = lines["control B", "east"]
    assert east.redundancy == pytest.approx(SIGMA**2 / both**2)
    assert east.residual == pytest.approx(-off * SIGMA**2 / both**2, rel=1e-4)
    assert east.detectable == pytest.approx(POWER * both, rel=1e-4)
    assert lines["control A", "east"].residual == pytest.approx(-east.residual)
    # Nothing checks the other coordinates.
    for part in ("north", "up"):
        other = lines["control B", part]
        assert other.redundancy == pytest.approx(0.0, abs=1e-9)
        assert other.detectable is None
        assert other.external is None
        assert other.score == 0.0


def test_a_start_pose_is_checked_by_targets_and_moves_its_scan() -> None:
    rng = np.random.default_rng(3)
    places = {name: rng.normal([0, 0, 3.0], 1.0) for name in "ABCDEF"}
    home = ScanPose(np.eye(3), np.zeros(3))
    prior = np.diag([SIGMA**2] * 3 + [1e-4] * 3)
    ties = Ties(
        start={"s": KnownPose(pose=home, covariance=prior)},
        centres=[
            Centre(target=name, scan="s", position=place, shared={},
                   covariance=1e-6 * np.eye(3))
            for name, place in places.items()
        ],
        control={
            name: KnownPoint(position=place, sigma=np.full(3, 1e-6))
            for name, place in places.items()
        },
    )  # fmt: skip
    state, spread, layout = adjusted(ties, State({"s": home}, dict(places), {}))
    lines = {
        (line.observation, line.part): line
        for line in reliabilities(state, spread, layout, ties)
    }
    start = lines["start s", "up"]
    # Its part in its own estimate is the posterior over the prior variance.
    at = layout.at["pose", "s"]
    weights = np.linalg.inv(prior)
    assert start.redundancy == pytest.approx(
        1 - spread[at, at][2, 2] * weights[2, 2], rel=1e-6
    )
    assert start.residual == pytest.approx(0.0, abs=1e-12)
    # An error that is not detected changes the pose by its part.
    assert start.detectable is not None
    assert start.external == pytest.approx(
        np.linalg.norm(spread[at, at][:3, 2]) / SIGMA**2 * start.detectable, rel=1e-6
    )
    assert start.external_scan == "s"
    assert lines["start s", "about up"].uncertainty == pytest.approx(0.01)
    assert ("target A in s", "north") in lines


def test_an_estimated_error_is_an_observation_of_zero() -> None:
    ties = Ties(start={})
    state = State({}, {}, {"delay": 0.7})
    layout = Layout(state, None)
    # Others measure it as well as its statement does.
    (line,) = reliabilities(state, np.array([[0.5]]), layout, ties)
    assert (line.observation, line.part) == ("error delay", "")
    assert (line.residual, line.uncertainty) == (0.7, 1.0)
    assert line.redundancy == pytest.approx(0.5)
    assert line.score == pytest.approx(0.7 / 0.5**0.5)
    assert line.detectable == pytest.approx(POWER / 0.5**0.5, rel=1e-4)


def test_noise_of_surfaces_that_is_larger_than_the_normal_matrix_says_counts() -> None:
    ties, state = Ties(start={}), State({}, {}, {"delay": 0.7})
    layout = Layout(state, None)
    (line,) = reliabilities(
        state, np.array([[0.4]]), layout, ties, inverse=np.array([[0.25]])
    )
    # Q = 1 - 2 x 0.25 + 0.4 = 0.9, and R = 0.75.
    assert line.redundancy == pytest.approx(0.75)
    assert line.score == pytest.approx(0.7 / 0.9**0.5)
    assert line.detectable == pytest.approx(POWER * 0.9**0.5 / 0.75, rel=1e-4)


def made(
    observation: str, part: str, score: float, **changes: float | None
) -> Reliability:
    fields: dict[str, float | None] = {
        "residual": 1e-3, "uncertainty": 1e-3, "redundancy": 0.5, "detectable": 5e-3,
        "external": 2e-3,
    }  # fmt: skip
    return Reliability(
        observation=observation, part=part, score=score, **(fields | changes)
    )  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("observation", "part", "group"),
    [
        ("start a", "east", ("start positions", "m")),
        ("start a", "about up", ("start attitudes", "rad")),
        ("target A in a", "up", ("targets in scans", "m")),
        ("control A", "north", ("control points", "m")),
        ("bar A B", "length", ("scale bars", "m")),
        ("error delay: i", "", ("shared errors", "1")),
    ],
)
def test_observations_have_a_group_and_a_unit(
    observation: str, part: str, group: tuple[str, str]
) -> None:
    assert group_of(made(observation, part, 0.0)) == group


def test_a_group_has_its_worst_and_its_largest_values() -> None:
    lines = [
        made("start a", "east", 1.0, redundancy=0.2, detectable=9e-3),
        made("start b", "up", -3.0, redundancy=0.6, external=7e-3),
        made("start c", "up", 0.0, redundancy=0.1, detectable=None, external=None),
        made("error delay: i", "", 2.0),
    ]
    positions, errors = observation_groups(lines)
    assert (positions.group, positions.unit) == ("start positions", "m")
    assert (positions.count, positions.unchecked) == (3, 1)
    assert positions.redundancy == pytest.approx(0.3)
    assert positions.largest_score == -3.0
    assert positions.largest_of == "start b, up"
    assert (positions.detectable, positions.external) == (9e-3, 7e-3)
    assert errors.largest_of == "error delay: i"
    # One of 1,000 networks of four normal values, on both sides: 1 - 1.25e-4.
    assert_allclose([positions.limit, errors.limit], 3.6623, atol=1e-3)
    (none,) = observation_groups([made("bar A B", "length", 0.0, detectable=None)])
    assert none.detectable is None
    assert observation_groups([]) == ()
