"""A simulated wreck of nine scans and two visits, by the commands of the page on it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm
from site_scenes import make_site, scanning

from amulor.cli import main

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "site.md"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which all commands of the page have run."""
    folder = tmp_path_factory.mktemp("site")
    make_site.make(folder / "wreck", rows=75)
    commands = re.findall(
        r"^\$ amulor (.+)$",
        re.sub(r" \\\n +", " ", PAGE.read_text("utf-8")),
        flags=re.MULTILINE,
    )
    assert len(commands) == 7
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in commands:
            words = [
                quoted or plain
                for quoted, plain in re.findall(r'"([^"]*)"|(\S+)', command)
            ]
            if words[1] == "compare":
                words += ["--json"]
            with (folder / f"{words[1]}.txt").open("w") as out:
                patch.setattr("sys.stdout", out)
                assert main(words) == 0, command
    return folder / "wreck"


@pytest.fixture(scope="module")
def poses(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "poses.json").read_text()))


def true_pose(name: str) -> tuple[np.ndarray, np.ndarray]:
    places = dict(one for visit in make_site.STATIONS.values() for one in visit)
    return scanning.looking(places[name], make_site.LOOK_AT)


def test_all_poses_are_within_what_is_stated(poses: dict[str, Any]) -> None:
    covariance = np.array(poses["covariance"])
    assert poses["settled"]
    assert poses["disagreements"] == []
    scores = []
    for name in poses["poses"]:
        matrix = np.array(poses["poses"][name]["matrix"])
        rotation, place = true_pose(name)
        turn = Rotation.from_matrix(matrix[:3, :3] @ rotation.T).as_rotvec()
        off = np.concatenate([matrix[:3, 3] - place, turn])
        at = slice(*poses["places"][f"pose {name}"])
        scores.append(off @ np.linalg.solve(covariance[at, at], off))
    # Chi-square of six degrees of freedom; the nine share the place of the site.
    assert max(scores) < 25
    assert np.mean(scores) < 14


def test_standardized_residuals_have_the_variance_one(poses: dict[str, Any]) -> None:
    scores = [
        line["score"] for line in poses["reliability"] if line["detectable"] is not None
    ]
    assert len(scores) > 60
    # With the covariance as the inverse normal matrix, a target had 46.
    assert np.abs(scores).max() < norm.isf(1e-3 / 2 / len(scores))
    # More than 60 numbers, of which those of one scan hang together.
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1, abs=0.35)
    targets = next(g for g in poses["network"] if g["group"] == "targets in scans")
    assert (targets["count"], targets["unchecked"]) == (6, 0)


def test_what_moved_does_not_pull_the_scans_along(poses: dict[str, Any]) -> None:
    # When what moved by less than noise counted, chi-square was 93 for 48 numbers.
    names = list(poses["poses"])
    off, common = [], []
    for name in names:
        matrix = np.array(poses["poses"][name]["matrix"])
        rotation, place = true_pose(name)
        turn = Rotation.from_matrix(matrix[:3, :3] @ rotation.T).as_rotvec()
        off += [*(matrix[:3, 3] - place), *turn]
        # The whole site may stand and turn anywhere.
        carried = np.eye(6)
        carried[:3, 3:] = np.cross(np.eye(3), place).T
        common.append(carried)
    at = np.concatenate([np.arange(*poses["places"][f"pose {name}"]) for name in names])
    root = np.linalg.inv(
        np.linalg.cholesky(np.array(poses["covariance"])[np.ix_(at, at)])
    )
    score, free = root @ np.array(off), root @ np.concatenate(common)
    left = score - free @ np.linalg.lstsq(free, score)[0]
    assert left @ left < chi2.isf(1e-3, len(off) - 6)


def test_the_moved_amphora_is_found_and_nothing_else(folder: Path) -> None:
    found = json.loads((folder.parent / "compare.txt").read_text())
    assert found["compared"] > 1000
    (region,) = found["regions"]
    motion = region["motion"]
    shift, sigma = np.array(motion["shift_m"]), np.array(motion["uncertainty"][:3])
    true = make_site.MOVED
    assert np.all(np.abs(shift - true) < 4 * sigma)
    assert 0.2e-3 < motion["distance_uncertainty_m"] < 2e-3
    assert motion["distance_m"] == pytest.approx(
        np.linalg.norm(true), abs=4 * motion["distance_uncertainty_m"]
    )
    # It lay as before: nothing of a round body drags its turn along.
    assert np.linalg.norm(motion["turn_rad"]) < 0.03
    # Of what is called changed, 5 in 100 may be so by chance; here off the amphora.
    rows = np.genfromtxt(folder / "change.csv", delimiter=",", names=True)
    away = np.hypot(
        rows["x_m"] - make_site.AMPHORA[0], rows["y_m"] - make_site.AMPHORA[1]
    )
    false = (rows["significant"] == 1) & (away > 0.5)
    sure = int((rows["significant"] == 1).sum())
    assert sure > 20
    assert false.sum() <= 0.05 * sure + 4 * np.sqrt(0.05 * sure)
    # And what is left elsewhere is chance.
    score = (rows["change_m"] / rows["standard_uncertainty_m"])[away > 0.5]
    assert score.std() == pytest.approx(1, abs=0.15)


def test_tiles_hold_points_with_errors_in_one_offset(folder: Path) -> None:
    index = json.loads((folder / "tiles" / "tiles.json").read_text())
    offsets, total, fish = set(), 0, {}
    for name, tile in index["tiles"].items():
        points = laspy.read(folder / "tiles" / name)
        offsets.add(tuple(points.header.offsets))
        assert len(points) == tile["points"]
        total += len(points)
        west, south = tile["west_south_m"]
        assert np.all((points.x >= west - 1e-4) & (points.x <= west + 2 + 1e-4))
        assert np.all((points.y >= south - 1e-4) & (points.y <= south + 2 + 1e-4))
        sigma = np.array(points["sigma_x"])
        assert np.all((sigma > 0) & (sigma < 0.05))
        for number in np.unique(points.point_source_id[points["moving"] == 1]):
            scan = index["scans"][number - 1]
            kept = (points.point_source_id == number) & (points["moving"] == 1)
            fish.setdefault(scan, []).append(points.xyz[kept])
            assert np.all(points.withheld[kept] == 1)
    assert offsets == {tuple(index["offset_m"])}
    assert total > 40_000
    # The fish swims through scan b2 alone, 0.75 m above the sea bed.
    assert set(fish) == {"b2"}
    seen = np.concatenate(fish["b2"])
    assert len(seen) > 20
    assert np.all(np.abs(seen - [0.1, 0.1, 0.75]) < 0.2)


def test_the_e57_file_has_all_scans_and_their_poses(
    folder: Path, poses: dict[str, Any]
) -> None:
    pye57 = pytest.importorskip("pye57")

    file = pye57.E57(str(folder / "all.e57"))
    assert file.scan_count == 9
    names = [file.get_header(k)["name"].value() for k in range(9)]
    assert names == list(poses["poses"])
    matrix = np.array(poses["poses"]["b2"]["matrix"])
    at = names.index("b2")
    assert np.abs(file.get_header(at).translation - matrix[:3, 3]).max() < 1e-9
    assert np.abs(file.get_header(at).rotation_matrix - matrix[:3, :3]).max() < 1e-9


def test_the_report_draws_the_site(folder: Path) -> None:
    text = (folder / "site.html").read_text()
    # Plan, ellipses, points, change, and the maps and histograms of residuals.
    assert text.count("data:image/png") == 6
    # Network: nine start poses of six components, and the errors that scans share.
    assert ">start positions</td><td>27</td>" in text
    assert ">start attitudes</td><td>27</td>" in text
    assert "moved by" in text
    assert "of which at most 5%" in text


def test_the_site_file_of_the_page_is_one(folder: Path) -> None:
    from amulor.site import Site

    (block,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert Site.from_text(block, folder=folder).scan[0].start is not None


@pytest.mark.study
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("seed", [2, 3])
def test_the_large_wreck(tmp_path: Path, seed: int) -> None:
    site = make_site.make(tmp_path, rows=180, seed=seed)
    still = make_site.make(tmp_path / "still", rows=180, seed=seed, moved=False)
    found = {}
    for name, path in (("moved", site), ("still", still)):
        poses = str(path.parent / "poses.json")
        assert main(["site", "register", str(path), "-o", poses]) == 0
        table = path.parent / "change.csv"
        words = ["site", "compare", str(path), "--poses", poses, "-o", str(table)]
        assert main(words) == 0
        found[name] = np.genfromtxt(table, delimiter=",", names=True)
    # Where nothing changed, Benjamini and Hochberg call something in 5 of 100 sites;
    # points of one place are called together.
    assert found["still"]["significant"].mean() < 2e-3
    rows = found["moved"]
    away = np.hypot(
        rows["x_m"] - make_site.AMPHORA[0], rows["y_m"] - make_site.AMPHORA[1]
    )
    changed = rows["significant"] == 1
    assert changed.sum() > 100
    assert (changed & (away > 0.5)).sum() <= 0.05 * changed.sum()


@pytest.mark.study
@pytest.mark.parametrize("seed", [2, 4, 8, 11])
def test_a_round_body_does_not_turn_about_its_axis(
    seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Seed 4 turned by 24 degrees when each pair of scans left out what it did not hold.
    site, poses = str(make_site.make(tmp_path, rows=70, seed=seed)), tmp_path / "p.json"
    assert main(["site", "register", site, "-o", str(poses)]) == 0
    capsys.readouterr()
    words = ["site", "compare", site, "--poses", str(poses), "--json"]
    assert main([*words, "-o", str(tmp_path / "change.csv")]) == 0
    (region,) = json.loads(capsys.readouterr().out)["regions"]
    motion = region["motion"]
    assert np.linalg.norm(motion["turn_rad"]) < 0.03
    assert motion["distance_m"] == pytest.approx(
        np.linalg.norm(make_site.MOVED), abs=4 * motion["distance_uncertainty_m"]
    )
