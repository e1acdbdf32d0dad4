"""The page on handing over: each of its commands runs, and what it says holds."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest
import trimesh

from amulor.cli import main
from amulor.handover.archive import missing_of

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "hand-over.md"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which all commands of the page have run."""
    folder = tmp_path_factory.mktemp("hand-over")
    shutil.copytree(ROOT / "examples" / "amphora", folder / "examples" / "amphora")
    text = re.sub(r" \\\n +", " ", PAGE.read_text("utf-8"))
    blocks = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    (project,) = [block for block in blocks if "[project]" in block]
    (folder / "project.toml").write_text(project)
    commands = re.findall(r"^\$ amulor (.+)$", text, flags=re.MULTILINE)
    assert len(commands) == 26
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in commands:
            words = [
                quoted or plain
                for quoted, plain in re.findall(r'"([^"]*)"|(\S+)', command)
            ]
            assert main(words) == 0, command
        (checks,) = [block for block in blocks if "[[checks]]" in block]
        Path("checks.toml").write_text(checks)
        words = (
            "report demo/ladder_clear_VH_range.nc -o checks.html --checks checks.toml"
        )
        assert main(words.split()) == 0
    return folder


def read_csv(path: Path) -> list[dict[str, str]]:
    lines = [x for x in path.read_text().splitlines() if not x.startswith("#")]
    return list(csv.DictReader(lines))


def test_the_drawing_at_1_to_10_is_a_sheet_of_a4(folder: Path) -> None:
    found = re.search(
        rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", (folder / "ladder.pdf").read_bytes()
    )
    assert found is not None
    size = [float(value) / 72 * 25.4 for value in found.groups()]
    assert size == pytest.approx([297, 210], abs=0.1)


def test_the_steps_of_the_section_are_forty_and_ten_millimetres(folder: Path) -> None:
    rows = read_csv(folder / "section.csv")
    right = np.array([float(row["right [m]"]) for row in rows])
    height = np.array([float(row["nearer [m]"]) for row in rows])
    sigma = np.array([float(row["standard_uncertainty [m]"]) for row in rows])
    # Five treads of 20 mm about the middle, without their rims.
    inner = [np.abs(right - place) < 8e-3 for place in (-0.04, -0.02, 0, 0.02, 0.04)]
    means = np.array([height[tread].mean() for tread in inner])
    # A point is the mean of two pixels at most; neighbours share one of them.
    error = np.sqrt([2 * np.sum(sigma[t] ** 2) / np.sum(t) ** 2 for t in inner])
    steps, doubt = np.diff(means), np.hypot(error[1:], error[:-1])
    assert np.all(np.abs(steps - [0.04, 0.01, 0.01, 0.01]) < 4 * doubt)
    assert doubt.max() < 5e-4


def test_the_mesh_is_an_amphora_within_its_errors(folder: Path) -> None:
    mesh = trimesh.load(folder / "amphora_mesh.ply", process=False)
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    # The widest place of the profile: 73 mm of radius, 16 cm above the toe, 1.5 m away.
    belly = np.abs(mesh.vertices[:, 1] - (0.15 - 0.16)) < 4e-3
    front = belly & (np.abs(mesh.vertices[:, 0]) < 0.05)
    radius = np.hypot(mesh.vertices[front, 0], mesh.vertices[front, 2] - 1.5)
    sigma = raw["scalar_slant_range_uncertainty"][front]
    assert front.sum() > 30
    # 48 flat sides have 0.16 mm less radius in the middle; the profile falls by 0.1.
    assert np.all(np.abs(radius - 0.0728) < 4 * sigma + 4e-4)
    assert 1e-4 < np.median(sigma) < 5e-4


def test_deviations_from_the_model_are_those_of_the_stated_errors(folder: Path) -> None:
    rows = read_csv(folder / "deviation.csv")
    value = np.array([float(row["deviation [m]"]) for row in rows])
    sigma = np.array([float(row["standard_uncertainty [m]"]) for row in rows])
    own = np.array([float(row["own_part [m]"]) for row in rows])
    assert len(rows) > 2000
    assert abs(value.mean()) < 3 * np.sqrt(np.median(sigma**2 - own**2))
    # What is left about the mean is noise of single pixels.
    spread = 1.4826 * np.median(np.abs(value - np.median(value)) / own)
    assert spread == pytest.approx(1.0, abs=0.12)
    assert "% significant" in (folder / "deviation.csv").read_text()


def test_clouds_have_their_axes_and_sigmas(folder: Path) -> None:
    found = laspy.read(folder / "amphora.laz")
    # 30 cm high, z up; the toe is below.
    assert np.ptp(found.z) == pytest.approx(0.3, abs=0.01)
    low = found.xyz[np.asarray(found.z) < -0.13]
    assert np.abs(low[:, 0]).max() < 0.02
    names = list(found.point_format.extra_dimension_names)
    assert {"sigma_x", "sigma_y", "sigma_z"} <= set(names)


def test_the_check_distances_of_the_page_pass(folder: Path) -> None:
    for name in ("report.html", "checks.html"):
        text = (folder / name).read_text().split("srcdoc")[0]
        assert "1 of 1 check distances pass" in text


def test_the_archive_is_whole(folder: Path) -> None:
    assert missing_of(folder / "Harbour") == []
    raw = folder / "Harbour" / "raw" / "scan1" / "amphora_samples.nc"
    assert raw.read_bytes() == (folder / "amphora_samples.nc").read_bytes()


def test_what_the_page_shows_of_the_output_is_what_is_printed(folder: Path) -> None:
    shown = re.search(
        r"^deviation\.csv: (\d+) pixels.*", PAGE.read_text(), re.MULTILINE
    )
    assert shown is not None
    assert int(shown[1]) == pytest.approx(
        len(read_csv(folder / "deviation.csv")), rel=0.02
    )
