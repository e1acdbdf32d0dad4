"""Sites of an independent generator: good starts are kept, wrong ones are named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import underwater_sites as oracle
from drawn_sites import DrawnSite, drawn_site, one_visit, written
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from scripts import script

from amulor import cli
from amulor.site.registration.pair import compared
from amulor.site.registration.patterns import (
    PatternTest,
    patterns_alike,
    unfit_scan,
)
from amulor.site.registration.pose import ScanPose, start_pose
from amulor.site.registration.register import register, surface_of
from amulor.site.registration.result import Contradiction, Registration


def registered(drawn: DrawnSite) -> Registration:
    return register(drawn.site, surfaces=drawn.surfaces, images=drawn.images)


def test_the_generator_and_the_package_mean_the_same_pose() -> None:
    station = oracle.Station((1.0, 2.0, 3.0), 0.7, -0.4, 0.2)
    drawn = one_visit("bed", 1, position=1e-9, angle=1e-9, rows=30)
    for scan in drawn.site.scan[1:]:
        assert scan.start is not None
        pose = start_pose(scan.start)
        true = drawn.stations[scan.name]
        assert_allclose(pose.rotation, true.matrix, atol=1e-7)
        assert_allclose(pose.position, true.place, atol=1e-7)
    # Forward: north turned clockwise by the heading, then up by the pitch.
    east, north = np.sin(0.7) * np.cos(-0.4), np.cos(0.7) * np.cos(-0.4)
    assert_allclose(station.matrix[:, 2], [east, north, np.sin(-0.4)])


def test_points_of_a_plane_lie_on_the_patches_of_other_scans(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Without errors; 5 um and a slope over the rows by directions linear in the pixels.
    monkeypatch.setattr(oracle, "measured", lambda distance, *_, **__: distance)
    drawn = one_visit("plane", 3, rows=42)
    poses = {
        name: ScanPose(station.matrix, np.array(station.place))
        for name, station in drawn.stations.items()
    }
    for source, target in (("a1", "a2"), ("a2", "a3"), ("a1", "a4")):
        pair = compared(
            drawn.surfaces[source], drawn.surfaces[target],
            (poses[source], poses[target]), gate=None, errors={},
        )  # fmt: skip
        assert pair is not None
        assert np.abs(pair.distance[pair.weight > 0]).max() < 2e-6


def test_rays_end_on_the_surface_and_pass_none() -> None:
    rng = np.random.default_rng(2)
    scene, station = oracle.amphorae(rng), oracle.ring(1, rng)[0]
    beams = oracle.grid(20, 26)[2]
    distance = oracle.cast(scene, station, beams)
    assert np.isfinite(distance).all()
    for part in np.linspace(0.05, 0.98, 12):
        on_the_way = station.place + (part * distance)[..., None] * (
            beams @ station.matrix.T
        )
        assert (scene(on_the_way.reshape(-1, 3)) > 0).all()
    end = station.place + distance[..., None] * (beams @ station.matrix.T)
    assert np.abs(scene(end.reshape(-1, 3))).max() < 1e-9


def test_an_honest_start_is_not_thrown_away_for_another_amphora() -> None:
    # Of two amphorae side by side; with points matched up to a metre away, scan a3
    # came 1.06 m and 0.22 rad off a start that is good to 5 cm and 3 degrees.
    drawn = one_visit("amphorae", 2, rows=63)
    found = registered(drawn)
    assert found.contradictions == ()
    assert max(shift for shift, _ in drawn.wrong(found).values()) < 0.03


@pytest.mark.slow
def test_a_start_far_beyond_its_stated_error_is_named() -> None:
    drawn = one_visit("bed", 3, position=0.01, angle=0.005, rows=48)
    assert registered(drawn).contradictions == ()
    scans = list(drawn.site.scan)
    start = scans[2].start
    assert start is not None
    east, north, up = start.position
    wrong = start.model_copy(update={"position": (east, north, up + 0.12)})
    scans[2] = scans[2].model_copy(update={"start": wrong})
    moved = replace(drawn, site=drawn.site.model_copy(update={"scan": tuple(scans)}))
    found = registered(moved)
    assert found.contradictions[0].scan == "a3"
    assert found.contradictions[0].shift == pytest.approx(0.12, abs=0.04)
    assert "scan 'a3' stands" in found.contradictions[0].sentence
    # It is found at its place all the same, and nothing of the others is off.
    assert moved.wrong(found)["a3"][0] < 0.02


@pytest.mark.slow
def test_a_delay_that_nobody_stated_is_named() -> None:
    drawn = one_visit(
        "bed", 4, position=0.01, angle=0.005, rows=48,
        spoiled={"a2": lambda distance: distance + 0.06},
    )  # fmt: skip
    found = registered(drawn)
    assert found.contradictions
    named = {one.scan for one in found.contradictions}
    errors = {one.error.partition(":")[0] for one in found.contradictions}
    assert "a2" in named or errors & {"group_index", "delay"}


def test_poses_that_contradict_their_starts_are_not_handed_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn = one_visit(
        "bed", 3, position=0.1, angle=0.005, stated=(0.004, 0.005), rows=48
    )
    site, poses = str(written(drawn, tmp_path)), str(tmp_path / "poses.json")
    assert cli.main(["site", "register", site, "-o", poses]) == 1
    said = capsys.readouterr()
    assert "poses of 4 scans" in said.out
    assert "scan 'a3' stands" in said.err
    content = json.loads(Path(poses).read_text())
    assert content["good"] is False
    assert {one["scan"] for one in content["contradictions"]} & {"a2", "a3", "a4"}
    merged = str(tmp_path / "all.e57")
    assert cli.main(["site", "merge", site, "--poses", poses, "-o", merged]) == 1
    assert "the poses are not good" in capsys.readouterr().err
    assert not Path(merged).exists()


def islands(count: int, folder: Path) -> Path:
    """Site of scans of a bed, of which the last stands 20 m away."""
    rng = np.random.default_rng(6)
    bed, places = oracle.bed(rng), oracle.ring(count, rng)
    stations = {f"a{k + 1}": place for k, place in enumerate(places)}
    east, north, up = places[-1].place
    stations[f"a{count}"] = replace(places[-1], place=(east + 20, north, up))
    starts = {
        name: oracle.start_of(place, rng, position=0.01, angle=0.005)
        for name, place in stations.items()
    }
    drawn = drawn_site({"one": bed}, {"one": stations}, starts, rng, rows=48)
    return written(drawn, folder)


def test_a_scan_that_nothing_checks_is_left_out_unless_trusted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site, poses = islands(3, tmp_path), str(tmp_path / "poses.json")
    register = ["site", "register", str(site), "-o", poses, "--overwrite"]
    merged = str(tmp_path / "all.e57")
    merge = ["site", "merge", str(site), "--poses", poses, "-o", merged, "--overwrite"]
    merge += ["--json"]
    assert cli.main(register) == 0
    content = json.loads(Path(poses).read_text())
    assert [item["scan"] for item in content["unchecked"]] == ["a3"]
    assert "warning: a3: no surface and no target ties it" in capsys.readouterr().out
    assert cli.main(merge) == 0
    said = capsys.readouterr()
    assert "a3: no surface" in said.err
    few = json.loads(said.out)["points"]
    page = tmp_path / "site.html"
    assert (
        cli.main(["site", "report", str(site), "--poses", poses, "-o", str(page)]) == 0
    )
    assert "Left out is a3: no surface" in page.read_text()
    capsys.readouterr()
    text = site.read_text().replace('file = "a3.nc"', 'file = "a3.nc"\ntrusted = true')
    site.write_text(text)
    assert cli.main(merge) == 0
    # Each scan has nearly as many points as each other.
    assert json.loads(capsys.readouterr().out)["points"] == pytest.approx(
        1.5 * few, rel=0.1
    )
    assert cli.main(register) == 0
    assert json.loads(Path(poses).read_text())["unchecked"] == []


def test_two_scans_that_do_not_check_each_other_are_not_merged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site, poses = str(islands(2, tmp_path)), str(tmp_path / "poses.json")
    assert cli.main(["site", "register", site, "-o", poses]) == 0
    merged = str(tmp_path / "all.e57")
    assert cli.main(["site", "merge", site, "--poses", poses, "-o", merged]) == 1
    assert "no two scans are checked by each other" in capsys.readouterr().err
    assert not Path(merged).exists()


def test_a_plane_settles_and_leaves_three_directions_of_each_scan_to_its_start() -> (
    None
):
    drawn = one_visit("plane", 3, rows=36)
    found = registered(drawn)
    assert found.settled
    assert found.contradictions == ()
    # Two shifts along the plane and the turn about its normal; a1 is surveyed.
    assert sorted(one.scan for one in found.weaknesses) == (
        ["a2"] * 3 + ["a3"] * 3 + ["a4"] * 3
    )
    for name in ("a2", "a3", "a4"):
        spread = found.covariance_of(f"pose {name}")
        # The start states 3 degrees of heading, and of the roll about an axis that
        # points downwards.
        assert 1 < np.sqrt(spread[5, 5]) / np.radians(3) < 1.5
        off, turn = drawn.wrong(found)[name]
        assert off < 4 * np.sqrt(np.trace(spread[:3, :3]))
        assert turn < 4 * np.sqrt(np.trace(spread[3:, 3:]))


def ramp(distance: np.ndarray) -> np.ndarray:
    return distance + 0.005 * np.linspace(-1, 1, distance.shape[0])[:, None]


def test_a_drift_that_poses_absorb_is_named_with_its_scan_and_size() -> None:
    # 5 mm at either end moves the pose by 8 mm, and the misfit stays 1.
    drawn = one_visit("bed", 2, rows=48, spoiled={"a2": ramp})
    found = registered(drawn)
    assert max(pair["misfit"] for pair in found.pairs) < 1.3
    (named,) = [one for one in found.contradictions if one.scan]
    assert (named.scan, named.error) == ("a2", "rows")
    assert abs(named.shift - 0.005) < 4 * named.stated_shift
    assert "scan 'a2': its ranges change from the first row to the last" in (
        named.sentence
    )
    # A drift that is stated is estimated, and the pose is right within its error.
    scans = tuple(
        scan.model_copy(update={"drift": 0.005}) if scan.name == "a2" else scan
        for scan in drawn.site.scan
    )
    site = drawn.site.model_copy(update={"scan": scans})
    surfaces = {s.name: surface_of(site, s, drawn.images[s.name]) for s in scans}
    other = register(site, surfaces=surfaces, images=drawn.images)
    assert other.contradictions == ()
    assert 0.005 * other.errors["drift: a2"] == pytest.approx(0.005, abs=0.0015)
    off, _ = drawn.wrong(other)["a2"]
    assert off < 0.5 * drawn.wrong(found)["a2"][0]


def test_a_drift_is_stated_for_all_scans_but_those_that_state_their_own() -> None:
    drawn = one_visit("bed", 2, rows=36)
    scans = tuple(
        scan.model_copy(update={"drift": 0.0}) if scan.name == "a1" else scan
        for scan in drawn.site.scan
    )
    settings = drawn.site.registration.model_copy(update={"drift": 0.005})
    site = drawn.site.model_copy(update={"scan": scans, "registration": settings})
    shared = {s.name: surface_of(site, s, drawn.images[s.name]).shared for s in scans}
    for name, errors in shared.items():
        stated = [key for key in errors.keys if key.startswith("drift")]
        assert stated == ([] if name == "a1" else [f"drift: {name}"])
    of_rows = shared["a2"].shapes[shared["a2"].keys.index("drift: a2")][:, 20]
    assert of_rows[[0, -1]] == pytest.approx([-0.005, 0.005])


def test_a_delay_of_one_scan_is_named() -> None:
    drawn = one_visit("bed", 2, rows=48, spoiled={"a2": lambda d: d + 0.02})
    found = registered(drawn)
    assert [one.scan for one in found.contradictions if one.scan] == ["a2"]


@pytest.mark.parametrize(
    "seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 3)), 7]
)
def test_a_scan_with_wrong_ranges_is_named(seed: int) -> None:
    # Of seed 7 scan a2 once came to a pose 45 cm off, with misfits of 80 and 139.
    drawn = one_visit(
        "corner", seed, position=0.3, angle=np.radians(10), rows=42,
        spoiled={"a2": lambda distance: distance + 0.05},
    )  # fmt: skip
    named = [one for one in registered(drawn).contradictions if one.scan]
    assert {one.scan for one in named} == {"a2"}
    assert all("'a2': its ranges change" in one.sentence for one in named)


def pair_of(scans: str, used: int, excluded: int, misfit: float) -> SimpleNamespace:
    return SimpleNamespace(
        source=scans[0], target=scans[1], used=used, moved=np.arange(excluded),
        misfit=misfit,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("excluded", "misfit", "others", "named"),
    [
        (40, 1.7, 1.0, ("b", 1.7)),
        # A body moved: all other points fit.
        (40, 1.0, 1.0, None),
        # The noise is larger than stated, in this scan or in all.
        (0, 1.7, 1.0, None),
        (40, 1.7, 1.7, None),
        # A wrong pose.
        (0, 80.0, 1.0, ("b", 80.0)),
    ],
)
def test_a_scan_fits_no_other_if_points_stand_off_and_the_rest_scatters(
    excluded: int, misfit: float, others: float, named: tuple[str, float] | None
) -> None:
    pairs = [pair_of(scans, 60, excluded, misfit) for scans in ("ab", "bc")]
    pairs += [pair_of("ac", 100, 0, others)]
    assert unfit_scan(pairs, "abc") == named  # type: ignore[arg-type]
    # One pair with a small misfit tells nothing of either scan.
    single = named if misfit > 10 else None
    assert unfit_scan(pairs[:1], "abc") == single  # type: ignore[arg-type]


def of_size(pattern: str, size: float, distance: np.ndarray) -> np.ndarray:
    rows, columns = (np.linspace(-1, 1, count) for count in distance.shape)
    shapes = {
        "constant": np.ones(distance.shape),
        "rows": rows[:, None] + 0 * columns,
        "rows, bent": 1 - 2 * rows[:, None] ** 2 + 0 * columns,
        "columns": 0 * rows[:, None] + columns,
        "columns, bent": 0 * rows[:, None] + 1 - 2 * columns**2,
    }
    return distance + size * shapes[pattern]


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("bed", 2),
        pytest.param("wall", 3, marks=pytest.mark.slow),
        pytest.param("amphorae", 2, marks=pytest.mark.slow),
    ],
)
def test_an_undetected_error_moves_a_pose_as_far_as_stated(
    kind: str, seed: int
) -> None:
    drawn = one_visit(kind, seed, rows=48, position=0.01, angle=0.01)
    found = registered(drawn)
    stated = found.undetected["a3"]
    (test,) = (
        test for test in found.patterns
        if (test.scan, test.pattern) == (stated.scan, stated.pattern)
    )  # fmt: skip
    # The error itself, in the ranges of the scan: poses are fitted anew.
    spoiled = {stated.scan: lambda d: of_size(stated.pattern, test.detectable, d)}
    other = registered(
        one_visit(kind, seed, rows=48, position=0.01, angle=0.01, spoiled=spoiled)
    )
    moved = other.poses["a3"].position - found.poses["a3"].position
    assert np.linalg.norm(moved) == pytest.approx(stated.shift, rel=0.25)


@pytest.mark.parametrize(
    "seeds", [(11, 12), pytest.param((11, 12, 13, 14), marks=pytest.mark.slow)]
)
def test_scores_of_patterns_are_standard_normal_and_sizes_are_detectable(
    seeds: tuple[int, ...],
) -> None:
    scores = []
    for seed in seeds:
        found = registered(one_visit("bed", seed, rows=36))
        assert found.contradictions == ()
        scores += [test.score for test in found.patterns]
        # Seven patterns of four scans.
        assert len(found.patterns) == 28
        for test in found.patterns:
            # 3.89 and 0.84 are the quantiles of 1e-4, both sides, and of 80 percent.
            assert test.detectable == pytest.approx(4.732 * test.uncertainty, rel=1e-3)
    # 56 or 112 numbers, of which those of one site hang together: 1 +- 0.3 or 0.2.
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.4)


@pytest.mark.slow
def test_the_rows_of_a_plane_do_not_seem_to_drift() -> None:
    # Patterns at the places of noisy points hang together with the noise: then the mean
    # of these scores is -1, of four scans in 11 sites.
    scores = [
        test.score
        for seed in range(21, 26)
        for test in registered(one_visit("plane", seed, rows=42)).patterns
        if test.pattern == "rows"
    ]
    assert len(scores) == 20
    # Of 20 standard normal numbers, four standard errors of the mean are 0.9.
    assert abs(np.mean(scores)) < 0.7


@pytest.mark.parametrize("seed", [2, pytest.param(6, marks=pytest.mark.slow)])
def test_a_large_but_not_significant_delay_widens_the_covariance(seed: int) -> None:
    drawn = one_visit(
        "amphorae", seed, rows=42, position=0.02, angle=0.02,
        spoiled={"a2": lambda distance: distance + 0.02},
    )  # fmt: skip
    found = registered(drawn)
    assert found.contradictions == ()
    pose, true = found.poses["a2"], drawn.stations["a2"]
    turn = Rotation.from_matrix(pose.rotation @ true.matrix.T).as_rotvec()
    off = np.concatenate([pose.position - true.place, turn])
    # Chi-square of six degrees of freedom, 93 and 68 of each without the delay in the
    # covariance.
    assert off @ np.linalg.solve(found.covariance_of("pose a2"), off) < chi2.isf(
        1e-3, 6
    )
    # The scan by itself is not good to a part of what the delay moves.
    sigma = np.sqrt(np.trace(found.covariance_of("pose a2")[:3, :3]))
    assert sigma > 0.3 * np.linalg.norm(off[:3])


def test_a_delay_beside_a_stronger_test_of_another_scan_widens_the_covariance() -> None:
    # The delay of 20 mm is that of a2 (3.4 standard errors); the rows of a1 have 3.8.
    # Without the delay in the covariance, chi-square of a2 is above 216 and its error
    # is 0.1 m and 0.28 rad.
    campaign = script("benchmarks/measure_sites.py")
    scanned, words = campaign.drawn(259)
    assert (words["kind"], words["spoiler"]) == ("plane", "delay")
    drawn = scanned()
    found = registered(drawn)
    assert found.contradictions == ()
    strong = [test for test in found.patterns if abs(test.score) > 2.5]
    assert max(strong, key=lambda test: abs(test.score)).scan == "a1"
    assert "a2" in {test.scan for test in strong}
    for name, pose in found.poses.items():
        true = drawn.stations[name]
        turn = Rotation.from_matrix(pose.rotation @ true.matrix.T).as_rotvec()
        off = np.concatenate([pose.position - true.place, turn])
        square = off @ np.linalg.solve(found.covariance_of(f"pose {name}"), off)
        assert square < chi2.isf(1e-3, 6)


def test_patterns_that_explain_a_scan_as_well_are_named_with_the_strongest() -> None:
    # Of 30 drawn sites with a wrong delay, 16 named the angle of incidence alone.
    def line(scan: str, pattern: str, score: float) -> PatternTest:
        return PatternTest(
            scan=scan, pattern=pattern, size=1e-3 * score, uncertainty=1e-3,
            detectable=5e-3, score=score,
        )  # fmt: skip

    tests = [
        line("a1", "constant", -9.9), line("a2", "constant", 9.8),
        line("a2", "rows", -9.0), line("a2", "columns", 8.0), line("a2", "angle", 10.0),
    ]  # fmt: skip
    alike = patterns_alike(tests, tests[-1])
    assert alike == ("constant", "rows")
    contradiction = Contradiction(
        scan="a2", error="angle", shift=0.01, turn=0.0, stated_shift=0.001,
        stated_turn=0.0, score=100.0, alike=alike[:1],
    )  # fmt: skip
    assert contradiction.sentence.startswith(
        "scan 'a2': its ranges change with the angle of incidence or by one amount, by "
        "10.0 +- 1.0 mm (10.0 standard uncertainties) beside those of its neighbors"
    )


@pytest.mark.parametrize("visits", [("one", "one"), ("one", "two")])
def test_scans_of_a_visit_without_stated_water_share_the_error_of_its_index(
    visits: tuple[str, str],
) -> None:
    drawn = one_visit("plane", 1, rows=30)
    keys = []
    for scan, visit in zip(drawn.site.scan[:2], visits, strict=True):
        unstated = scan.model_copy(update={"water": None, "epoch": visit})
        surface = surface_of(drawn.site, unstated, drawn.images[scan.name])
        keys.append({key for key in surface.shared.keys if "group_index" in key})
    assert len(keys[0]) == len(keys[1]) == 1
    assert (keys[0] == keys[1]) == (visits[0] == visits[1])


def test_parts_of_a_campaign_add_their_rows_to_the_table(tmp_path: Path) -> None:
    campaign = script("benchmarks/measure_sites.py")
    table, columns = tmp_path / "squares.csv", ("site", "square", "version")

    def go_on(*options: str) -> None:
        parsed = campaign.measuring_options(None).parse_args(options)
        measure = lambda number: {"site": number, "square": number**2}  # noqa: E731
        campaign.go_on(table, columns, measure, parsed, "new")

    for part in ("0/2", "1/2"):
        go_on("9", "--first", "1", "--until", "6", "--part", part)
    odd = campaign.rows_of(tmp_path / "squares_part1.csv")
    assert [row["site"] for row in odd] == ["1", "3", "5"]
    assert not table.exists()
    go_on("--merge")
    assert [row["square"] for row in campaign.rows_of(table)] == [
        "1", "4", "9", "16", "25"
    ]  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["squares.csv"]


def test_sites_near_the_limit_count_as_often_as_the_generator_draws_errors() -> None:
    campaign = script("benchmarks/measure_sites.py")

    def row(spoiler: str, outcome: str, inside: int, score: float) -> dict[str, str]:
        return {
            "spoiler": spoiler, "stated": "1.0", "outcome": outcome,
            "score": f"{score}", "components": "18", "within_1": f"{inside}",
            "within_2": "18",
        }  # fmt: skip

    rows = [row("quiet", "good", 12, 1.5), row("fish", "good", 12, 2.5)]
    rows += [row("near", "good", 6, 1.0), row("near", "contradicted", 0, 9.0)]
    # Half of the sites have no error, and a quarter has a delay or drift. So the quiet
    # site counts 1/4, and that near the limit 1/8: (12 / 4 + 6 / 8) / (18 * 3 / 8).
    lines = campaign.classes(rows).splitlines()
    assert lines[2].startswith("| below 2 | 1 | 1 | 55.6 +- ")
    assert lines[3].startswith("| 2 to 3 | 1 | 0 | 66.7 +- 0.0 % | 100.0 +- 0.0 % |")
    assert lines[4] == "| above 3 | 0 | 0 |  |  |"
