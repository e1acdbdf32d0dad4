"""The page shows the deviation of a scan from a mesh or from another scan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
import xarray as xr
from starlette.testclient import TestClient

from amulor import acquisition, handover, imaging, io, simulation
from amulor.cli import main
from amulor.survey import Survey
from amulor.view import page

TOKEN = "a-token-for-tests"
#: The plate stands here, and the right half of the wall of the tests behind it [m].
PLATE, BEHIND = 1.5, 0.1


@pytest.fixture(scope="module")
def image(target: xr.Dataset) -> xr.Dataset:
    return imaging.range_image(target, polarization="VH")


@pytest.fixture
def wall(tmp_path: Path) -> Path:
    """Write a mesh in millimetres: the plate's plane, its right half further away."""
    far = PLATE + BEHIND
    corners = [(x, y, PLATE) for x in (-1, 0) for y in (-1, 1)]
    corners += [(x, y, far) for x in (0, 1) for y in (-1, 1)]
    faces = [[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]]
    path = tmp_path / "wall.stl"
    trimesh.Trimesh(1e3 * np.array(corners), faces).export(path)
    return path


def shown(image: xr.Dataset, reference: Path) -> page.Recording:
    recording = page.recording_of(image, name="plate.nc")
    recording.against = handover.comparison(reference, unit="mm")
    return recording


def maps(client: TestClient, shape: tuple[int, int]) -> dict[str, np.ndarray]:
    found = {}
    for name in ("deviation", "significant", "deviation_uncertainty"):
        answer = client.get(f"/{TOKEN}/layer/VH/{name}")
        found[name] = np.frombuffer(answer.content, "<f4").reshape(shape)
    return found


def test_a_shifted_half_deviates_significantly(
    served: Callable[..., TestClient], image: xr.Dataset, wall: Path
) -> None:
    client = served(shown(image, wall))
    scene = client.get(f"/{TOKEN}/scene").json()
    kinds = {layer["name"]: (layer["kind"], layer["unit"]) for layer in scene["layers"]}
    assert kinds["deviation"] == kinds["significant"] == ("signed", "m")
    assert kinds["deviation_uncertainty"] == ("error", "m")
    assert scene["notes"][0].startswith("Deviation along the normal of wall.stl")
    found = maps(client, image["slant_range"].shape)
    right = np.arange(image.sizes["column"]) >= image.sizes["column"] // 2
    # The plate is before the wall's right half, so there it is nearer.
    expected = np.where(right, BEHIND, 0.0)
    known = np.isfinite(found["deviation"])
    assert known.mean() > 0.9
    off = (found["deviation"] - expected) / found["deviation_uncertainty"]
    assert np.abs(off[known]).max() < 5
    significant = np.isfinite(found["significant"])
    assert significant[:, right][known[:, right]].all()
    assert significant[:, ~right].mean() < 0.2
    np.testing.assert_array_equal(
        found["significant"][significant], found["deviation"][significant]
    )


def test_a_scan_does_not_deviate_from_itself(
    served: Callable[..., TestClient], image: xr.Dataset, tmp_path: Path
) -> None:
    io.write_cube(image, tmp_path / "earlier.nc")
    found = maps(
        served(shown(image, tmp_path / "earlier.nc")), image["slant_range"].shape
    )
    assert np.nanmax(np.abs(found["deviation"])) < 1e-9
    assert not np.isfinite(found["significant"]).any()
    # Two equal errors, along the normal: the cosine of its angle with the beam counts.
    one = image["slant_range_uncertainty"].values
    known = np.isfinite(found["deviation"])
    ratio = found["deviation_uncertainty"][known] / one[known]
    assert np.median(ratio) == pytest.approx(np.sqrt(2), rel=0.02)
    assert ratio.max() < 1.0001 * np.sqrt(2)


def test_a_reference_elsewhere_is_a_note(
    served: Callable[..., TestClient], image: xr.Dataset, tmp_path: Path
) -> None:
    path = tmp_path / "elsewhere.stl"
    trimesh.Trimesh([[9e3, 0, 0], [9e3, 1, 0], [9e3, 0, 1]], [[0, 1, 2]]).export(path)
    scene = served(shown(image, path)).get(f"/{TOKEN}/scene").json()
    assert "deviation" not in {layer["name"] for layer in scene["layers"]}
    assert "no pixel lies near the reference" in scene["notes"][0]


@pytest.mark.slow
def test_running_scans_have_deviations(
    plate: Survey, wall: Path, tmp_path: Path
) -> None:
    survey = plate.with_(
        {
            "scan.columns": 6,
            "scan.rows": 4,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 3},
        }
    )
    acquisition.acquire(survey, tmp_path / "scan", scene=simulation.scene_light)
    live = page.Live(tmp_path / "scan")
    live.against = handover.comparison(wall, unit="mm")
    live.look()
    found = live.recording.layer("VH", "deviation", 1)
    # Larger than the uncertainty of a short dwell; the wall's right half is behind.
    assert np.nanmedian(found[:, 3:]) == pytest.approx(BEHIND, abs=0.03)
    assert np.nanmedian(found[:, :3]) == pytest.approx(0, abs=0.03)
    live.stop()


def test_saved_pages_contain_deviations(
    image: xr.Dataset, wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    io.write_cube(image, tmp_path / "plate.nc")
    saved = tmp_path / "page.html"
    command = ["view", str(tmp_path / "plate.nc"), "--against", str(wall)]
    assert main([*command, "--unit", "mm", "--save", str(saved)]) == 0
    assert "one page" in capsys.readouterr().out
    assert 'data-name="layer/VH/significant"' in saved.read_text(encoding="utf-8")
