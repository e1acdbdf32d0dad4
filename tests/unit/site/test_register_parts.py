"""Reports of a registration beside its poses, for poses written by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from amulor.site.registration import register
from amulor.site.registration.network import KnownPose, Layout, State, Ties
from amulor.site.registration.patterns import PatternTest
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.reliability import Reliability
from amulor.site.registration.result import Contradiction, Weakness
from amulor.site.registration.sight import Sight

CHANCE = 1e-5


def _pose(*position: float) -> ScanPose:
    return ScanPose(np.eye(3), np.array(position or (0.0, 0.0, 0.0)))


def _known(*sigma: float, pose: ScanPose | None = None) -> KnownPose:
    """Start pose with given standard uncertainties."""
    return KnownPose(
        pose=pose or _pose(), covariance=np.diag(np.square(sigma or [1e-3] * 6))
    )


def _site(*scans: tuple[str, str] | tuple[str, str, bool]) -> Any:
    """Site of scans with their visits; a third value says if a scan is trusted."""
    made = [
        SimpleNamespace(name=name, epoch=epoch, trusted=bool(rest and rest[0]))
        for name, epoch, *rest in scans
    ]
    visits = list(dict.fromkeys(scan.epoch for scan in made))
    return SimpleNamespace(
        scan=made,
        epoch=[SimpleNamespace(name=name) for name in visits],
        scans_of=lambda epoch: [scan for scan in made if scan.epoch == epoch],
    )


def _surface(distance: float, *, spacing: float = 0.02) -> Any:
    return SimpleNamespace(
        distance=np.array([distance, distance, np.nan]), spacing=spacing, motion=None
    )


def _alignment(**changes: Any) -> Any:
    """Alignment of the scans a and b without errors."""
    state = State({"a": _pose(), "b": _pose(1.0, 0.0, 0.0)}, {}, {"delay": 0.5})
    layout = Layout(state, "a")
    fields: dict[str, Any] = {
        "state": state, "layout": layout, "patterns": (), "pairs": (),
        "covariance": 0.04 * np.eye(layout.size),
        "inverse": 0.04 * np.eye(layout.size),
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


SITE = _site(("a", "one"), ("b", "one"))


def test_a_start_pose_is_contradicted_by_one_in_a_hundred_thousand() -> None:
    limit = math.sqrt(chi2.isf(CHANCE, 6))
    for factor, contradicted in ((0.999, False), (1.001, True)):
        off = limit * factor * 0.02
        turn = Rotation.from_rotvec([0.0, 0.0, 0.003]).as_matrix()
        start = ScanPose(turn, np.array([1.0, off, 0.0]))
        wide = [0.02] * 3 + [1.0, 2.0, 2.0]
        ties = Ties(
            start={"b": _known(*wide, pose=start), "a": _known(pose=_pose(9.0, 0, 0)),
                   "c": _known()},
            fixed="a",
        )  # fmt: skip
        found = register._contradictions(SITE, _alignment(), ties, ())
        assert len(found) == contradicted
        if contradicted:
            (line,) = found
            assert (line.scan, line.error) == ("b", "")
            assert line.shift == pytest.approx(off)
            assert line.turn == pytest.approx(0.003, rel=1e-6)
            assert line.stated_shift == pytest.approx(0.02 * 3**0.5)
            assert line.stated_turn == pytest.approx(3.0)
            assert line.score == pytest.approx(limit**2 * factor**2 / 6, rel=1e-4)


def test_a_shared_error_is_contradicted_beyond_its_fit() -> None:
    limit = math.sqrt(chi2.isf(CHANCE, 1))
    for covariance, inverse, spread in ((0.04, 0.04, 1.0), (0.5, 0.1, 1.3)):
        for factor in (0.999, 1.001, -1.001):
            alignment = _alignment()
            value = factor * limit * math.sqrt(spread)
            alignment.state.errors["delay"] = value
            size = alignment.layout.size
            alignment.covariance = covariance * np.eye(size)
            alignment.inverse = inverse * np.eye(size)
            found = register._contradictions(SITE, alignment, Ties(start={}), ())
            assert len(found) == (abs(factor) > 1)
            for line in found:
                assert (line.scan, line.error) == ("", "delay")
                assert line.score == pytest.approx(value**2 / spread)
                assert (line.shift, line.turn) == (0.0, 0.0)
                assert (line.stated_shift, line.stated_turn) == (0.0, 0.0)


def _line(observation: str, score: float) -> Reliability:
    return Reliability(
        observation=observation, part="north", residual=0.03, uncertainty=0.004,
        redundancy=0.5, score=score, detectable=0.02,
    )  # fmt: skip


def test_control_points_and_bars_are_contradicted_by_their_residuals() -> None:
    limit = norm.isf(CHANCE / 2)
    lines = (
        _line("control S1", 1.001 * limit), _line("bar S1 S2", -1.001 * limit),
        _line("control S3", 0.999 * limit), _line("start a", 2 * limit),
    )  # fmt: skip
    found = register._contradictions(SITE, _alignment(), Ties(start={}), lines)
    assert [line.error for line in found] == ["control S1, north", "bar S1 S2, north"]
    for line in found:
        assert (line.scan, line.shift, line.stated_shift) == ("", 0.03, 0.004)
        assert line.score == pytest.approx((1.001 * limit) ** 2)
        assert (line.turn, line.stated_turn) == (0.0, 0.0)


def test_patterns_and_scans_that_fit_no_other_are_contradictions() -> None:
    def test_of(pattern: str, score: float) -> PatternTest:
        return PatternTest(
            scan="b", pattern=pattern, size=-0.02, uncertainty=0.004, detectable=0.02,
            score=score,
        )  # fmt: skip

    patterns = (test_of("rows", -9.0), test_of("angle", 8.5), test_of("range", 2.0))

    def pair(source: str, target: str, misfit: float) -> Any:
        return SimpleNamespace(
            source=source, target=target, misfit=misfit, moved=np.zeros(0), used=100
        )

    site = _site(("a", "one"), ("b", "one"), ("c", "two"))
    pairs = (pair("a", "b", 80.0), pair("c", "a", 90.0))
    alignment = _alignment(patterns=patterns, pairs=pairs)
    pattern, surface = register._contradictions(site, alignment, Ties(start={}), ())
    assert (pattern.scan, pattern.error) == ("b", "rows")
    assert (pattern.shift, pattern.stated_shift) == (-0.02, 0.004)
    assert pattern.score == 81.0
    for line in (pattern, surface):
        assert (line.turn, line.stated_turn) == (0.0, 0.0)
    assert (surface.shift, surface.stated_shift) == (0.0, 0.0)
    assert pattern.alike == ("angle",)
    # Of the same visit; the later scan of the pair.
    assert (surface.scan, surface.error) == ("b", "surface")
    assert surface.score == 6400.0


def test_contradictions_begin_with_the_worst() -> None:
    lines = [
        Contradiction(
            scan="", error=str(score), shift=0.0, turn=0.0, stated_shift=0.0,
            stated_turn=0.0, score=score,
        )
        for score in (3.0, 9.0, 5.0)
    ]  # fmt: skip
    assert [line.score for line in register._worst_first(lines)] == [9.0, 5.0, 3.0]


def _sight(first: str, second: str, share: float, distance: float = 0.05) -> Sight:
    return Sight(
        scans=(first, second), shares=(share, share / 2), distance=distance,
        uncertainty=0.01,
    )  # fmt: skip


def test_the_scan_of_most_pairs_that_look_through_each_other_is_named() -> None:
    pairs = [_sight("a", "b", 0.1), _sight("c", "b", 0.3, 0.08), _sight("d", "e", 0.2)]
    result: Any = SimpleNamespace(
        poses={name: _pose(0.01 if name == "e" else 0.0, 0, 0) for name in "abcde"}
    )
    ties = Ties(start={name: _known() for name in "abcde"})
    found = list(register._seen_through(pairs, result, ties))
    assert [line.scan for line in found] == ["b", "e"]
    first, second = found
    assert first.peers == ("a", "c")
    # The numbers of the pair with the larger share.
    assert (first.shift, first.stated_shift, first.share) == (0.08, 0.01, 0.3)
    assert first.score == pytest.approx(64.0)
    assert first.error == "sight"
    assert {(line.turn, line.stated_turn) for line in found} == {(0.0, 0.0)}
    # Of two alike, the one farther from its start pose.
    assert second.peers == ("d",)
    assert second.share == 0.2
    mirrored = Sight(
        scans=("a", "b"), shares=(0.1, 0.4), distance=0.05, uncertainty=0.01
    )
    (line,) = register._seen_through([mirrored], result, Ties(start={}))
    assert line.share == 0.4


def _absence(**changes: Any) -> Any:
    fields = {"scan": "a", "peers": ("b", "c"), "share": 0.01, "distance": 0.06,
              "uncertainty": 0.02}  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


@pytest.mark.parametrize(
    ("reliefs", "share", "named"),
    [
        # Relief of the scan a, and of the others; the limit is 4, or half of theirs.
        ((3.9, 1.0), 0.01, True),
        ((4.1, 1.0), 0.01, False),
        ((4.1, 1.0), 0.021, True),
        ((4.9, 10.0), 0.01, True),
        ((5.1, 10.0), 0.01, False),
    ],
)
def test_points_absent_from_a_scan_contradict_it_without_common_relief(
    monkeypatch: pytest.MonkeyPatch,
    reliefs: tuple[float, float],
    share: float,
    named: bool,
) -> None:
    looked: list[list[str]] = []

    def looks_of(result: Any, surfaces: Any, scans: list[str]) -> str:
        looked.append(scans)
        return "looks"

    monkeypatch.setattr(register, "looks_of", looks_of)
    monkeypatch.setattr(register, "pairs_seen_through", lambda _: ())
    monkeypatch.setattr(register, "absent_points", lambda *_: [_absence(share=share)])
    own, other = reliefs
    result: Any = SimpleNamespace(
        poses={}, pairs=[
            {"source": "a", "target": "d", "relief": own},
            {"source": "e", "target": "a", "relief": 0.5},
            {"source": "b", "target": "c", "relief": other},
        ],
    )  # fmt: skip
    surfaces = {"a": _surface(1.0), "b": _surface(1.0), "c": _surface(1.0)}
    surfaces["c"].motion = object()
    found = list(
        register._sight_contradictions(
            _site(("a", "one"), ("b", "one"), ("c", "one")), result, Ties(start={}),
            surfaces,
        )
    )  # fmt: skip
    assert looked == [["a", "b"]]
    assert len(found) == named
    for line in found:
        assert (line.scan, line.error, line.peers) == ("a", "absent", ("b", "c"))
        assert (line.shift, line.stated_shift, line.share) == (0.06, 0.02, share)
        assert line.score == pytest.approx(9.0)
        assert (line.turn, line.stated_turn) == (0.0, 0.0)


def test_the_relief_of_a_scan_is_the_largest_of_its_pairs() -> None:
    result: Any = SimpleNamespace(
        pairs=[
            {"source": "a", "target": "b", "relief": 2.0},
            {"source": "c", "target": "a", "relief": 5.0},
            {"source": "b", "target": "c", "relief": 9.0},
        ]
    )
    assert register._relief("a", result) == 5.0
    assert register._relief("d", result) == 0.0


def _plate(name: str, height: float, *, side: int = 30) -> Any:
    """Uneven ground of 3 m, seen from above."""
    x, y = np.meshgrid(np.linspace(0, 3, side), np.linspace(0, 3, side))
    z = height + 0.2 * np.sin(3 * x) * np.cos(2 * y)
    return SimpleNamespace(
        name=name, position=np.stack([x, y, z], axis=-1),
        usable=np.ones(x.shape, dtype=bool), distance=np.full(x.shape, 2.0),
        spacing=0.1, motion=None,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("height", "sigma", "named"),
    [(0.5, 0.05, True), (0.5, 0.2, False), (0.05, 0.0, False), (0.1, 0.0, True)],
)
def test_groups_at_another_height_have_another_datum(
    height: float, sigma: float, named: bool
) -> None:
    surfaces = {
        "a": _plate("a", 0.0),
        "b": _plate("b", height),
        "c": _plate("c", height),
    }
    result: Any = SimpleNamespace(poses={name: _pose() for name in "abc"})
    small = 1e-9
    ties = Ties(
        start={name: _known(small, small, max(sigma, small), small, small, small)
               for name in "abc"}
    )  # fmt: skip
    found = list(register._other_datums([["a"], ["b", "c"]], result, ties, surfaces))
    assert len(found) == named
    for line in found:
        assert (line.scan, line.error, line.peers) == ("b", "datum", ("c",))
        assert line.shift == pytest.approx(height, abs=0.02)
        assert line.stated_shift == pytest.approx(math.hypot(sigma, sigma), abs=1e-6)
        assert line.share > 0.9
        assert (line.turn, line.stated_turn) == (0.0, 0.0)
        score = line.shift / max(math.hypot(sigma, sigma), 0.02)
        assert line.score == pytest.approx(score**2)


def test_points_of_a_scan_are_thinned_evenly() -> None:
    surface = _plate("a", 0.0, side=80)
    surface.usable[0] = False
    result: Any = SimpleNamespace(poses={"a": _pose(10.0, 0.0, 0.0)})
    found = register._some_placed(result, surface)
    assert len(found) == 3160
    assert_allclose(found[0], surface.position[1, 0] + np.array([10.0, 0, 0]))
    assert_allclose(found[1], surface.position[1, 2] + np.array([10.0, 0, 0]))


def test_the_height_of_a_group_is_that_of_its_surest_start_pose() -> None:
    surfaces = {"a": _surface(2.0), "b": _surface(3.0), "c": _surface(1.0)}
    ties = Ties(
        start={
            "a": _known(1, 1, 0.03, 0.01, 0.02, 1),
            "b": _known(1, 1, 0.04, 0.01, 0, 1),
        }
    )
    first = math.hypot(0.03, 2.0 * 0.02)
    second = math.hypot(0.04, 3.0 * 0.01)
    assert register._group_error(["a"], ties, surfaces) == pytest.approx(first)
    assert register._group_error(["b"], ties, surfaces) == pytest.approx(second)
    both = register._group_error(["a", "b", "c"], ties, surfaces)
    assert both == pytest.approx(min(first, second))
    assert register._group_error(["c"], ties, surfaces) == 0.0


def test_groups_are_connected_scans_the_largest_and_surest_first() -> None:
    site = _site(*((name, "one") for name in "abcdef"))
    surfaces = {name: _surface(1.0) for name in "abcdef"}
    ties = Ties(
        start={name: _known(1, 1, sigma, 0, 0, 1)
               for name, sigma in zip("abcdef", (5, 4, 3, 2, 1, 6), strict=True)}
    )  # fmt: skip
    tied = [("f", "b"), ("d", "c"), ("c", "f")]
    found = register._groups(site, tied, ties, surfaces)
    assert found == [["b", "c", "d", "f"], ["e"], ["a"]]


def _centre(target: str, scan: str) -> Any:
    return SimpleNamespace(target=target, scan=scan)


def test_common_targets_are_pairs_of_scans() -> None:
    ties = Ties(
        start={}, centres=[_centre("S", "a"), _centre("S", "b"), _centre("T", "c")]
    )
    assert register._common_targets(ties) == [
        ("a", "a"), ("a", "b"), ("b", "a"), ("b", "b"), ("c", "c"),
    ]  # fmt: skip


def test_visits_and_groups_without_a_tie_are_named() -> None:
    site = _site(("a", "one"), ("b", "one"), ("c", "two"), ("d", "three", True))
    groups = [["a", "c"], ["b"], ["d"]]
    found = list(register._untied(site, [("a", "c")], groups))
    assert found == [
        "visit 'three': no surface and no target ties its scans to another visit; only "
        "start poses and control points do, and change is compared no better than "
        "these are known",
        "d: no surface and no target ties them to the other scans; only start poses "
        "and control points do, which nothing checks",
    ]
    # Without any tie between visits the groups are not named beside them.
    apart = list(register._untied(site, [("a", "b")], [["a", "b"], ["c"], ["d"]]))
    assert [line.split(":")[0] for line in apart] == [
        "visit 'one'", "visit 'two'", "visit 'three'",
    ]  # fmt: skip
    single = _site(("a", "one"), ("b", "one", True), ("c", "one", True))
    alone = list(register._untied(single, [], [["a"], ["b", "c"]]))
    assert len(alone) == 1
    assert alone[0].startswith("b, c: no surface and no target ties them")


def _result(pairs: list[tuple[str, str, float]], **changes: Any) -> Any:
    fields: dict[str, Any] = {
        "pairs": [
            {"source": source, "target": target, "relief": relief}
            for source, target, relief in pairs
        ],
        "weaknesses": (),
    }
    return SimpleNamespace(**{**fields, **changes})


def _unchecked(result: Any, groups: list[list[str]], **changes: Any) -> dict[str, str]:
    """First words of the reasons by scan."""
    options: dict[str, Any] = {
        "site": _site(*((name, "one") for name in "abcd")), "targets": [],
        "ties": Ties(start={name: _known(*[0.1] * 6) for name in "abcd"}, fixed="a"),
    }  # fmt: skip
    options |= changes
    surfaces = {name: _surface(2.0) for name in "abcd"}
    found = register._unchecked(
        options["site"], groups, options["targets"], result, options["ties"], surfaces
    )
    return {line.scan: line.reason for line in found}


def test_scans_that_nothing_checks_are_named_with_the_reason() -> None:
    symmetrical = (
        "the overlap is too symmetrical: three planes fit any other corner, and no "
        "relief beside them is common to two scans"
    )
    untied = (
        "no surface and no target ties it to the other scans, so only start poses "
        "place it"
    )
    pairs = [("a", "b", 4.1), ("a", "c", 3.9)]
    groups = [["a", "b", "c"], ["d"]]
    found = _unchecked(_result(pairs), groups)
    assert found == {"c": symmetrical, "d": untied}
    # A common target, a weak direction or a control point checks it, or says more.
    assert "c" not in _unchecked(_result(pairs), groups, targets=[("b", "c")])
    weak = Weakness(scan="c", shift=(0, 0, 1.0), turn=(0, 0, 0))
    assert "c" not in _unchecked(_result(pairs, weaknesses=(weak,)), groups)
    point: Any = SimpleNamespace()
    start = {name: _known(*[0.1] * 6) for name in "abcd"}
    for scan in ("c", "d"):
        ties = Ties(
            start=start, centres=[_centre("S", scan)], control={"S": point}, fixed="a"
        )
        assert scan not in _unchecked(_result(pairs), groups, ties=ties)
        no_control = Ties(start=start, centres=[_centre("S", scan)], fixed="a")
        assert scan in _unchecked(_result(pairs), groups, ties=no_control)
    trusted = _site(("a", "one"), ("b", "one"), ("c", "one", True), ("d", "one", True))
    assert _unchecked(_result(pairs), groups, site=trusted) == {}
    # Without a fixed scan, the surest start pose defines where the site is.
    sure = {**start, "c": _known(*[0.05] * 6)}
    found = _unchecked(_result(pairs), groups, ties=Ties(start=sure))
    assert set(found) == {"a", "b", "d"}


@pytest.mark.parametrize(
    ("sigma", "surveyed"),
    # Half of the spacing of 20 mm, by position and by 2 m of lever.
    [
        ((0.009, 0.001, 0.002, 0, 0, 0), True),
        ((0.001, 0.002, 0.011, 0, 0, 0), False),
        ((0.001, 0.001, 0.001, 0, 0.0044, 0), True),
        ((0.001, 0.001, 0.001, 0.0046, 0, 0), False),
    ],
)
def test_a_start_pose_is_surveyed_within_half_a_spacing(
    sigma: tuple[float, ...], surveyed: bool
) -> None:
    surfaces = {"a": _surface(2.0)}
    ties = Ties(start={"a": _known(*sigma)})
    assert register._surveyed("a", ties, surfaces) is surveyed
    assert not register._surveyed("b", ties, surfaces)


def test_covariances_relative_to_a_prior_are_in_its_units() -> None:
    prior = np.diag([4.0, 9.0, 1.0])
    covariance = np.array([[1.0, 3.0, 0.0], [3.0, 9.0, 0.5], [0.0, 0.5, 2.0]])
    found = register._relative_to_prior(covariance, prior)
    scale = np.array([2.0, 3.0, 1.0])
    assert_allclose(found, covariance / np.outer(scale, scale))


def test_directions_that_only_start_poses_determine_are_weak(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A pose whose height the data improve little, and whose rest they determine."""
    sigma = np.array([0.1, 0.1, 0.1, 0.05, 0.05, 0.05])
    start = {"a": _known(*sigma), "b": _known(*sigma), "c": _known(*sigma)}

    def result(height: float, relative: float, turn: float = 1e-4) -> Any:
        posterior = np.diag(np.square([1e-4, 1e-4, height, turn, 1e-4, 1e-4]))
        near = np.diag(np.square([1e-4, 1e-4, relative, turn, 1e-4, 1e-4]))
        monkeypatch.setattr(
            register, "relative_covariance", lambda result, name, neighbor: near
        )
        return SimpleNamespace(
            poses={"a": _pose(), "b": _pose()}, places={"pose b": (0, 6)},
            pairs=[{"source": "a", "target": "b"}],
            covariance_of=lambda name: posterior,
        )  # fmt: skip

    def weak(made: Any, distance: float = 2.0, spacing: float = 0.02) -> Any:
        surfaces = {name: _surface(distance, spacing=spacing) for name in "abc"}
        return register._weak_directions(made, Ties(start=start, fixed="a"), surfaces)

    (found,) = weak(result(0.06, 0.06))
    assert found.scan == "b"
    assert_allclose(np.abs(found.shift), [0.0, 0.0, 0.06], atol=1e-12)
    assert_allclose(found.turn, 0.0, atol=1e-12)
    # Half of the start's uncertainty is the limit, of either covariance.
    assert weak(result(0.049, 0.06)) == ()
    assert weak(result(0.06, 0.049)) == ()
    # Displacements below half of the spacing do not matter.
    assert weak(result(0.06, 0.06), spacing=0.119) != ()
    assert weak(result(0.06, 0.06), spacing=0.121) == ()
    (turned,) = weak(result(1e-4, 1e-4, 0.03))
    assert_allclose(np.abs(turned.turn), [0.03, 0.0, 0.0], atol=1e-12)
    assert weak(result(1e-4, 1e-4, 0.03), spacing=0.119) != ()
    assert weak(result(1e-4, 1e-4, 0.03), spacing=0.121) == ()


@pytest.mark.parametrize("finding", ["contradictions", "remarks", "unchecked", None])
def test_scans_fit_that_register_without_any_finding(
    finding: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: dict[str, Any] = {"contradictions": (), "remarks": (), "unchecked": ()}
    if finding:
        found[finding] = ("one",)
    monkeypatch.setattr(register, "_registered", lambda *_: SimpleNamespace(**found))
    assert register._fits(_site(), {}, {}) == (finding is None)
