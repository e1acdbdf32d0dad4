"""Results of site commands as text and JSON: poses, clouds, changes, and motions."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor import _extras
from amulor.cli import main
from amulor.cli import site as commands
from amulor.cli._arguments import UsageError
from amulor.errors import CubeError, SurveyError
from amulor.platform import Mounting, Trajectory, read_mounting
from amulor.site import Site
from amulor.site.change import distances, moved
from amulor.site.change.distances import Region
from amulor.site.change.moved import Motion
from amulor.site.merging import cloud, pixels, tiles
from amulor.site.registration import register, result

Named = SimpleNamespace


def region(**changes: Any) -> Region:
    """Return a region of change with other numbers in each field."""
    fields: dict[str, Any] = {
        "members": np.array([1, 2]), "centre": np.array([1.25, -2.5, 0.125]),
        "reach": 0.3, "area": 0.0123, "area_uncertainty": 0.0012, "mean": 4.56e-3,
        "mean_uncertainty": 0.78e-3, "largest": 0.01, "volume": -5.6e-5,
        "volume_uncertainty": 0.9e-5, "lost": 0.0034,
    }  # fmt: skip
    return Region(**(fields | changes))


def motion(**changes: Any) -> Motion:
    """Return a motion by 3, 0 and -4 mm, and by half a degree about the north axis."""
    fields: dict[str, Any] = {
        "centre": np.array([1.0, 2.0, 3.0]), "shift": np.array([3e-3, 0.0, -4e-3]),
        "turn": np.array([0.0, np.radians(0.5), 0.0]),
        "covariance": np.diag([1.0, 4.0, 1.0, 9e-6, 4e-6, 1e-6]) * 1e-6,
        "loose": (), "points": 321, "misfit": 1.5,
    }  # fmt: skip
    return Motion(**(fields | changes))


def test_a_region_is_a_place_with_area_mean_and_volume() -> None:
    """Areas are in square and volumes in cubic centimeters."""
    assert commands.region_sentence(2, region(), {}) == (
        "3: at (1.250, -2.500, 0.125) m, 123 +- 12 cm2, mean +4.56 +- 0.78 mm, volume "
        "-56 +- 9 cm3, 34 cm2 there not compared"
    )


def test_a_moved_body_has_one_motion_for_all_of_its_regions() -> None:
    """Further regions name the first one; a reason takes the place of a motion."""
    same = motion()
    motions = {0: "too few points", 1: same, 3: same}
    first, second, other = (
        commands.region_sentence(number, region(), motions).splitlines()[1]
        for number in (1, 3, 0)
    )
    assert first == (
        "   its point (1.000, 2.000, 3.000) m moved by 5.00 +- 1.00 mm: (+3.00, +0.00, "
        "-4.00) mm; turned by 0.50 +- 0.00 deg about (+0.00, +1.00, +0.00)"
    )
    assert second == "   the same body as 2"
    assert other == "   no motion of an object: too few points"
    assert "\n" not in commands.region_sentence(2, region(), motions)


def test_motions_that_no_shape_shows_are_named() -> None:
    """A body that did not turn has no axis, and no division by zero."""
    free = motion(turn=np.zeros(3), loose=(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),))
    text = commands.region_sentence(0, region(), {0: free})
    assert "deg about (+0.00, +0.00, +0.00); not known: turn about (+0.00," in text
    assert "turned by 0.00 +- " in text


def test_a_region_in_json_has_si_units() -> None:
    """The uncertainty of a motion that no shape shows is null."""
    content = {
        "centre_m": pytest.approx([1.25, -2.5, 0.125]),
        "area_m2": 0.0123, "area_uncertainty_m2": 0.0012, "mean_m": 4.56e-3,
        "mean_uncertainty_m": 0.78e-3, "volume_m3": -5.6e-5,
        "volume_uncertainty_m3": 0.9e-5, "not_compared_m2": 0.0034,
    }  # fmt: skip
    assert commands._region(region(), 0, {}) == content
    same = motion(loose=(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),))
    motions = {0: "too few", 1: same, 2: same}
    assert commands._region(region(), 0, motions) == content | {"no_motion": "too few"}
    assert commands._region(region(), 2, motions) == content | {
        "same_body_as_region": 1
    }
    found = commands._region(region(), 1, motions)["motion"]
    assert found.pop("covariance") is same.covariance
    assert found == {
        "centre_m": pytest.approx([1.0, 2.0, 3.0]),
        "shift_m": pytest.approx([3e-3, 0.0, -4e-3]),
        "turn_rad": pytest.approx([0.0, np.radians(0.5), 0.0]),
        "uncertainty": [
            *(pytest.approx(v) for v in (1e-3, 2e-3, 1e-3, 3e-6, 2e-6)), None
        ],
        "distance_m": pytest.approx(5e-3),
        "distance_uncertainty_m": pytest.approx(1e-3),
        "angle_rad": pytest.approx(np.radians(0.5)),
        "angle_uncertainty_rad": pytest.approx(2e-6),
        "points": 321, "loose": same.loose,
    }  # fmt: skip


def epochs(*names: str) -> Any:
    """Return a site of visits, each with scans."""
    return Named(
        name="Harbor",
        epoch=[Named(name=name) for name in names],
        scan=[Named(name="a", file=Path("a.nc")), Named(name="b", file=Path("b.nc"))],
        scans_of=lambda epoch: [] if epoch == "empty" else [epoch],
        target=[1, 2, 3], control=[1, 2],
    )  # fmt: skip


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch, here: Path) -> list[Any]:
    """Return the calls of a comparison of six places, four of them comparable."""
    calls: list[Any] = []
    change = Named(
        value=np.array([1.0, np.nan, 2.0, 3.0, np.nan, 4.0]),
        significant=np.array([True, False, True, True, False, False]),
        false_alarms=0.05,
        uncertainty=np.array([1e-3, 9.0, 2e-3, 4e-3, np.nan, np.nan]),
    )
    monkeypatch.setattr(Site, "from_toml", lambda path: epochs("one", "two", "three"))
    monkeypatch.setattr(commands, "opened", lambda *words: calls.append(words))
    monkeypatch.setattr(
        commands, "changes_between", lambda merged, epochs: (change, (region(),), {})
    )
    monkeypatch.setattr(
        distances, "write_change",
        lambda change, path, overwrite: calls.append((path, overwrite)),
    )  # fmt: skip
    return calls


COMPARE = ["site", "compare", "site.toml", "--poses", "p.json", "-o", "c.csv"]


def test_a_comparison_counts_places_and_changes(compared, printed) -> None:
    """The median is that of the known uncertainties of compared places."""
    assert main(COMPARE) == 0
    assert printed() == [
        "one to three: 4 places compared, 3 changed (of these at most 5% by chance); "
        "median uncertainty 2.00 mm",
        "1: at (1.250, -2.500, 0.125) m, 123 +- 12 cm2, mean +4.56 +- 0.78 mm, volume "
        "-56 +- 9 cm3, 34 cm2 there not compared",
        "c.csv: 6 rows",
    ]
    assert compared == [(Path("site.toml"), Path("p.json")), (Path("c.csv"), False)]


def test_a_comparison_in_json_has_its_regions(compared, capsys) -> None:
    """The visits are those that are named."""
    words = ["--first", "two", "--second", "one", "--json", "--overwrite"]
    assert main([*COMPARE, *words]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content.pop("regions")[0]["area_m2"] == 0.0123
    assert content == {
        "epochs": ["two", "one"], "compared": 4, "significant": 3,
        "false_alarms": 0.05, "median_uncertainty_m": 2e-3,
    }  # fmt: skip
    assert compared[-1] == (Path("c.csv"), True)


@pytest.mark.usefixtures("compared")
def test_a_comparison_is_written_to_a_table_that_is_new(here, capsys) -> None:
    """The ending is checked, and an existing table is kept."""
    assert main([*COMPARE[:-1], "c.txt"]) == 2
    assert "--output c.txt: the ending says the format" in capsys.readouterr().err
    (here / "c.csv").touch()
    assert main(COMPARE) == 1
    assert "c.csv exists already" in capsys.readouterr().err


def test_two_epochs_are_needed_for_a_comparison() -> None:
    """Of several visits, the first and the last one are compared."""
    assert commands.epochs_of(epochs("one", "two"), None, None) == ("one", "two")
    with pytest.raises(UsageError, match="the site has one epoch, 'one'; a comparison"):
        commands.epochs_of(epochs("one"), None, None)


def test_changes_are_fitted_body_by_body(monkeypatch) -> None:
    """The reach of a body is enlarged by a half, between 5 cm and 1 m."""
    asked: list[Any] = []
    steps: list[Any] = []
    monkeypatch.setattr(distances, "change", lambda *_, epochs: ("change", epochs))
    monkeypatch.setattr(distances, "regions", lambda change: tuple("abcd"))
    monkeypatch.setattr(moved, "bodies", lambda places: ((0, 2), (1,), (3,)))
    reaches = {"ac": 0.2, "b": 0.01, "d": 0.9}
    monkeypatch.setattr(
        moved, "around", lambda places: ("".join(places), reaches["".join(places)])
    )

    def motion_of(*words: Any, epochs: Any, centre: str, reach: float) -> str:
        asked.append((centre, pytest.approx(reach)))
        return f"motion {centre}"

    monkeypatch.setattr(moved, "motion_of", motion_of)
    monkeypatch.setattr("amulor._progress.tell", lambda *words: steps.append(words))
    merged: Any = Named(site=epochs("one", "two"), registration=1, surfaces=2, cloud=3)
    change, places, motions = commands.changes_between(merged, ("one", "two"))
    assert change == ("change", ("one", "two"))
    assert places == tuple("abcd")
    assert motions == {0: "motion ac", 2: "motion ac", 1: "motion b", 3: "motion d"}
    assert asked == [("ac", 0.3), ("b", 0.05), ("d", 1.0)]
    assert [share for _, share in steps] == pytest.approx(
        [0.8, 0.8 + 0.1 / 3, 0.8 + 0.2 / 3]
    )
    merged.site = epochs("one", "empty")
    with pytest.raises(CubeError, match="epoch 'empty': no other data check the poses"):
        commands.changes_between(merged, ("one", "empty"))


def piece(
    confirmed: list[int], moving: list[bool], scan: list[int], **more: Any
) -> Any:
    """Return a piece of a merged cloud with uncertainties of 1, 2, 3, ... mm."""
    sigma = 1e-3 * (1 + np.arange(len(scan)))[:, None] * [1.0, 2.0, 3.0]
    return Named(
        position=np.zeros((len(scan), 3)), confirmed=np.array(confirmed),
        moving=np.array(moving), scan=np.array(scan), sigma=sigma,
        brightest=more.get("brightest", 0.0),
    )  # fmt: skip


@pytest.fixture
def merged(monkeypatch: pytest.MonkeyPatch, here: Path) -> list[Any]:
    """Return the calls of a merging of five points of two scans."""
    calls: list[Any] = []
    pieces = [
        piece([1, 0, 2], [False, True, True], [0, 1, 1]),
        piece([0, 1], [True, False], [1, 0]),
    ]
    site = Named(scan=[Named(name="a"), Named(name="b"), Named(name="c")])
    whole = Named(site=site, cloud=1, registration=2, surfaces=3, images=4)

    def opened(*words: Any, with_images: bool) -> Any:
        calls.append((*words, with_images))
        return whole

    def write_tiles(merged: Any, output: Any, *, size: float, overwrite: bool,
                    pieces: Any) -> list[Path]:  # fmt: skip
        calls.append((merged, output, size, overwrite, len(list(pieces))))
        return [Path("m/1.laz"), Path("m/2.laz")]

    monkeypatch.setattr(_extras, "require", lambda *words, **_: calls.append(words))
    monkeypatch.setattr(commands, "opened", opened)
    monkeypatch.setattr(pixels, "all_points", lambda *words: iter(pieces))
    monkeypatch.setattr(pixels, "scan_clouds", lambda *words: [words])
    monkeypatch.setattr(tiles, "write_tiles", write_tiles)
    monkeypatch.setattr(
        "amulor.io.write_e57_scans",
        lambda clouds, path, overwrite: calls.append((clouds, path, overwrite)),
    )
    return calls


MERGE = ["site", "merge", "site.toml", "--poses", "p.json", "-o"]
SITE, POSES = Path("site.toml"), Path("p.json")


def test_a_merged_cloud_counts_points_and_what_moved(merged, printed) -> None:
    """Medians of 1, 1, 2, 2, 3 mm; three of five points are confirmed."""
    assert main([*MERGE, "m", "--tile", "250 cm"]) == 0
    assert printed() == [
        "b: 3 points that other scans see through, marked",
        "m: 5 points in 2 files, 60% seen by several scans, median uncertainty 2.00, "
        "4.00, 6.00 mm",
    ]
    assert merged == [
        ("export",), (SITE, POSES, False), (1, Path("m"), 2.5, False, 2)
    ]  # fmt: skip


def test_a_merged_cloud_in_json_has_all_scans(merged, capsys) -> None:
    """A scan without moving points has none."""
    assert main([*MERGE, "m", "--json", "--overwrite"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "files": ["m/1.laz", "m/2.laz"], "points": 5,
        "moving_points": {"a": 0, "b": 3, "c": 0},
        "median_uncertainty_m": pytest.approx([2e-3, 4e-3, 6e-3]),
        "seen_by_several": 0.6,
    }  # fmt: skip
    assert merged[-1] == (1, Path("m"), 5.0, True, 2)


def test_one_file_of_all_scans_is_written_in_e57(merged, printed, here, capsys) -> None:
    """The points are counted for it, too; an existing file is kept."""
    assert main([*MERGE, "m.E57"]) == 0
    assert printed()[-1].startswith("m.E57: 5 points in 1 file, 60% seen by several")
    assert merged == [
        ("e57",), (SITE, POSES, True), ([(1, 2, 3, 4)], Path("m.E57"), False)
    ]  # fmt: skip
    (here / "m.e57").touch()
    assert main([*MERGE, "m.e57"]) == 1
    assert "m.e57 exists already" in capsys.readouterr().err


def test_of_averaged_scans_a_hundredth_tells_the_uncertainty() -> None:
    """All points are counted, and every hundredth is looked at."""
    count = 150
    many = piece([1] * count, [False] * count, [0] * count, brightest=1.0)
    counted = commands._Counted(iter([many]))
    assert len(list(counted)) == 1
    assert (counted.count, counted.confirmed, counted.moving) == (count, count, {})
    assert counted.median_uncertainty == pytest.approx([0.051, 0.102, 0.153])


def registration(**changes: Any) -> Any:
    """Return the poses of two scans, of which the second one may hide an error."""
    variances = {
        "pose a": np.array([9.0, 16.0, 0.0, 4e-6, 0.0, 0.0]) * 1e-6,
        "pose b": np.zeros(6),
    }
    fields: dict[str, Any] = {
        "poses": {
            "a": Named(position=np.array([1.0, 2.0, 3.0])),
            "b": Named(position=np.array([-1.5, 0.0, 0.25])),
        },
        "covariance_of": lambda name: np.diag(variances[name]),
        "undetected": {"b": Named(shift=0.0123)}, "fixed": "a",
        "scale": [Named(sentence="bar 1")], "remarks": ["R"],
        "unchecked": [Named(scan="b", sentence="U")],
        "disagreements": [
            {"scans": ("a", "b"), "shift": 0.00456, "turn": 0.00789, "score": 12.34,
             "trust": 0.07},
        ],
        "weaknesses": [
            Named(scan="b", shift=(0.0011, 0.0, -0.0022), turn=(0.001, -0.002, 0.0)),
        ],
        "contradictions": [], "patterns": [Named(p=1)], "reliability": [Named(r=1)],
        "pairs": [{"scans": ("a", "b"), "moved_pixels": [1, 2], "score": 1.5}],
        "settled": True,
    }  # fmt: skip
    return Named(**(fields | changes))


REGISTER = ["site", "register", "site.toml", "-o", "p.json"]


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch, here: Path) -> list[Any]:
    """Return a list with the result of the registration, and calls that write it."""
    found = [registration()]
    monkeypatch.setattr(_extras, "require", lambda *_, **__: None)
    monkeypatch.setattr(Site, "from_toml", lambda path: epochs("one"))
    monkeypatch.setattr(register, "register", lambda site: found[0])
    monkeypatch.setattr(register, "refined_lines", lambda site, result: iter(["line"]))
    monkeypatch.setattr(
        "amulor.site.registration.reliability.observation_groups",
        lambda lines: [Named(group=len(lines))],
    )
    monkeypatch.setattr(
        result, "write_registration",
        lambda result, path, overwrite: found.append((path, overwrite)),
    )  # fmt: skip
    monkeypatch.setattr(
        commands, "_write_lines",
        lambda lines, folder, overwrite: found.append((list(lines), folder, overwrite)),
    )  # fmt: skip
    return found


def test_a_registration_prints_poses_and_warnings(registered, printed) -> None:
    """Uncertainties are root sums of squares, in mm and mrad."""
    assert main(REGISTER) == 0
    lines = printed()
    assert lines[0] == "Poses"
    assert lines[1] == "scan east, m north, m up, m u, mm u, mrad +, mm"
    assert lines[2:] == [
        "a 1.0000 2.0000 3.0000 5.00 0.002 -",
        "b -1.5000 0.0000 0.2500 0.00 0.000 12.3",
        "+: largest shift by a drift or delay of one scan that no test detects",
        "the frame is that of a: nothing ties it to the world",
        "scale by bar 1",
        "warning: R",
        "warning: U",
        "warning: a on b contradicts all others by 4.56 mm, 7.890 mrad (chi-square "
        "12.3 per degree of freedom); it counts 7%. Look whether something moved, or "
        "the instrument did during a scan",
        "warning: b: only its start pose holds it along (1.1, 0.0, -2.2) mm with a "
        "turn of (1.00, -2.00, 0.00) mrad (one standard deviation); add targets, or a "
        "scan that sees relief",
        "p.json: poses of 2 scans",
    ]
    assert registered[1:] == [(Path("p.json"), False)]


def test_a_registration_that_is_sure_prints_no_warnings(registered, printed) -> None:
    """Without hidden errors and remarks the table and the file are all."""
    registered[0] = registration(
        undetected={}, fixed="", scale=[], remarks=[], unchecked=[], disagreements=[],
        weaknesses=[], settled=False,
    )  # fmt: skip
    assert main([*REGISTER, "--trajectories", "lines"]) == 0
    assert printed()[4:] == [
        "warning: the fit did not settle; the covariance may be too small",
        "p.json: poses of 2 scans",
    ]
    assert registered[2:] == [(["line"], Path("lines"), False)]


def test_a_registration_in_json_has_all_tests(registered, capsys) -> None:
    """Pixels that moved stay in the file alone."""
    assert main([*REGISTER, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["poses"] == {
        "a": {
            "position_m": [1.0, 2.0, 3.0],
            "uncertainty": pytest.approx([3e-3, 4e-3, 0.0, 2e-6, 0.0, 0.0]),
            "undetected": None,
        },
        "b": {
            "position_m": [-1.5, 0.0, 0.25], "uncertainty": [0.0] * 6,
            "undetected": {"shift": 0.0123},
        },
    }  # fmt: skip
    assert content["pairs"] == [{"scans": ["a", "b"], "score": 1.5}]
    assert content["network"] == [{"group": 1}]
    assert content["unchecked"] == [{"scan": "b", "sentence": "U"}]
    assert content["weaknesses"][0]["shift"] == [0.0011, 0.0, -0.0022]
    assert content["disagreements"][0]["trust"] == 0.07
    assert content["scale"] == [{"sentence": "bar 1"}]
    assert (content["patterns"], content["reliability"]) == ([{"p": 1}], [{"r": 1}])
    assert (content["remarks"], content["settled"]) == (["R"], True)
    assert content["contradictions"] == []


def test_a_registration_that_is_contradicted_ends_with_an_error(
    registered, capsys
) -> None:
    """The poses are written, the lines of vehicles are not."""
    registered[0] = registration(
        contradictions=[Named(sentence="C"), Named(sentence="D")]
    )
    assert main([*REGISTER, "--trajectories", "lines"]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "amulor: p.json: the poses are not good", "amulor: C", "amulor: D"
    ]  # fmt: skip
    assert registered[1:] == [(Path("p.json"), False)]


def test_an_existing_registration_is_kept(registered, here, capsys) -> None:
    """A site file, and each image of it, is no output."""
    for name in ("p.json", "a.nc"):
        (here / name).touch()
    assert main(REGISTER) == 1
    assert "p.json exists already" in capsys.readouterr().err
    assert main([*REGISTER, "--overwrite"]) == 0
    assert registered[1:] == [(Path("p.json"), True)]


def test_lines_are_written_with_trajectory_and_mounting(tmp_path) -> None:
    """Folders are made; files of an earlier run are kept unless they may go."""
    track = Trajectory.of_angles(
        time=np.arange(3.0), position=np.zeros((3, 3)), heading=0.0
    )
    mounting = Mounting(lever_arm=(0.5, 0.0, -0.25))
    folder = tmp_path / "new" / "lines"
    for overwrite in (False, True):
        lines = iter([("one", track, mounting), ("two", track, mounting)])
        commands._write_lines(lines, folder, overwrite=overwrite)
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["one.csv", "one.toml", "two.csv", "two.toml"]
    assert read_mounting(folder / "two.toml").lever_arm == (0.5, 0.0, -0.25)


@pytest.mark.parametrize("mistakes", [(), ("M", "N")])
def test_a_site_file_is_checked_with_its_files(
    monkeypatch, here, capsys, mistakes
) -> None:
    """Remarks are notes, mistakes are errors; the numbers are those of the site."""
    from amulor.site.check import Findings

    (here / "site.toml").touch()
    found = Findings(mistakes=mistakes, remarks=("R",), shapes={}, levels={})
    monkeypatch.setattr(Site, "from_toml", lambda path: epochs("one", "two"))
    monkeypatch.setattr("amulor.site.check.check", lambda site: found)
    assert main(["site", "check", "site.toml"]) == (1 if mistakes else 0)
    text = capsys.readouterr()
    good = "site.toml: Harbor: 2 scans of 2 epochs, 3 targets, 2 control points"
    assert text.out.splitlines() == ["note: R", *([] if mistakes else [good])]
    errors = [f"amulor: site.toml: {line}" for line in mistakes]
    assert text.err.splitlines() == errors
    assert main(["site", "check", "site.toml", "--json"]) == (1 if mistakes else 0)
    content = json.loads(capsys.readouterr().out)
    assert content["site"] == "Harbor"
    assert content["mistakes"] == list(mistakes)
    if mistakes:
        with pytest.raises(SurveyError):
            commands.check(Path("site.toml"))


def test_poses_of_all_scans_are_needed(monkeypatch) -> None:
    """The command that registers again is named with its files."""
    known = Named(poses={"a": 1}, contradictions=(), unchecked=())
    monkeypatch.setattr(Site, "from_toml", lambda path: epochs("one"))
    monkeypatch.setattr(result, "read_registration", lambda path: known)
    message = (
        "^p.json: has no pose of scan 'b'; register the site again: amulor site "
        "register site.toml -o p.json --overwrite$"
    )
    with pytest.raises(CubeError, match=message):
        commands.registered(SITE, POSES)
    known.poses["b"] = 2
    known.contradictions = (Named(sentence="C"),)
    for poses, name, again in (
        (POSES, "p.json", "p.json --overwrite"), (None, "site.toml", "poses.json")
    ):  # fmt: skip
        monkeypatch.setattr(register, "register", lambda site: known)
        monkeypatch.setattr(_extras, "require", lambda *_, **__: None)
        with pytest.raises(CubeError) as refused:
            commands.registered(SITE, poses)
        assert str(refused.value).splitlines() == [
            f"{name}: the poses are not good", "C",
            "mend the site file and register again: amulor site register site.toml -o "
            f"{again}",
        ]  # fmt: skip


@pytest.mark.parametrize("images", [False, True])
def test_images_of_a_merged_site_are_kept_on_request(monkeypatch, images) -> None:
    """Without them less memory is needed."""
    parts: list[Any] = []
    monkeypatch.setattr(commands, "registered", lambda *words: ("site", "poses"))
    monkeypatch.setattr(
        register, "surfaces_of", lambda site: ({"a": 1}, {"a": "image"})
    )
    monkeypatch.setattr(cloud, "merge", lambda *words: words)
    monkeypatch.setattr(commands, "release_memory", lambda: parts.append("released"))
    found = commands.opened(SITE, POSES, with_images=images)
    assert found.images == ({"a": "image"} if images else {})
    assert found.cloud == ("site", "poses", {"a": 1}, {"a": "image"})
    assert (found.site, found.registration, found.surfaces) == (
        "site", "poses", {"a": 1}
    )  # fmt: skip
    assert parts == ["released"] * 2
