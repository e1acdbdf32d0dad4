"""Saved views and annotations are kept whole, beside the data, and nowhere else."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from starlette.testclient import TestClient

from amulor import io
from amulor.errors import CubeError
from amulor.view import page
from amulor.view.page import space
from amulor.view.page.notes import Notes

TOKEN = "a-token-for-tests"
NOTE = {"name": "crack", "text": "on the rim", "channel": "VV", "row": 2, "column": 3}
VIEW = {
    "name": "front",
    "channel": "VV",
    "layer": "range",
    "limits": [1.4, 1.6],
    "camera": {
        "turn": 0.0,
        "rise": 0.1,
        "distance": 1.0,
        "target": [0.0, 0.0, 1.5],
        "orthographic": True,
    },
    "clip": {"low": [None, None, 1.4], "high": [None, None, None]},
}


def whole(**changed: Any) -> dict[str, Any]:
    return {"revision": 0, "annotations": [NOTE], "views": [VIEW], **changed}


@pytest.fixture
def opened(target: xr.Dataset, tmp_path: Path) -> page.Recording:
    path = tmp_path / "plate.nc"
    io.write_cube(target, path)
    return page.opened(path)


def test_notes_are_written_beside_the_data_and_read_again(
    opened: page.Recording, served: Callable[..., TestClient], tmp_path: Path
) -> None:
    client = served(opened)
    first = client.get(f"/{TOKEN}/notes").json()
    assert first == {
        "revision": 0,
        "annotations": [],
        "views": [],
        "file": "plate.nc.notes.json",
    }
    answer = client.post(f"/{TOKEN}/notes", json=whole())
    assert answer.json() == {"revision": 1}
    names = {entry.name for entry in tmp_path.iterdir()}
    assert names == {"plate.nc", "plate.nc.notes.json"}
    # Another server reads them, and a saved page contains them.
    again = served(page.opened(tmp_path / "plate.nc")).get(f"/{TOKEN}/notes").json()
    assert again["annotations"] == [NOTE]
    assert again["views"] == [VIEW]
    assert "on the rim" in page.saved_page(opened)


def test_notes_need_the_token_and_the_same_site(
    opened: page.Recording, served: Callable[..., TestClient], tmp_path: Path
) -> None:
    client = served(opened)
    assert client.post("/wrong/notes", json=whole()).status_code == 404
    evil = {"origin": "http://evil.example"}
    answer = client.post(f"/{TOKEN}/notes", json=whole(), headers=evil)
    assert answer.status_code == 403
    assert not (tmp_path / "plate.nc.notes.json").exists()


def test_a_change_of_an_older_revision_is_refused(tmp_path: Path) -> None:
    notes = Notes(tmp_path / "scan.nc")
    notes.write(whole())
    with pytest.raises(CubeError, match="another window"):
        notes.write(whole(annotations=[]))
    assert notes.read()["annotations"] == [NOTE]
    assert notes.write(whole(revision=1, views=[])) == {"revision": 2}


@pytest.mark.parametrize(
    "wrong",
    [
        {"file": "../../elsewhere.json"},
        {"annotations": [{**NOTE, "row": -1}]},
        {"annotations": [{**NOTE, "row": "2"}]},
        {"annotations": [{**NOTE, "text": "x" * 2001}]},
        {"annotations": [NOTE] * 201},
        {"views": [{**VIEW, "limits": [float("nan"), 1.0]}]},
        {"views": [{**VIEW, "script": "alert(1)"}]},
    ],
)
def test_anything_but_notes_is_refused(tmp_path: Path, wrong: dict[str, Any]) -> None:
    with pytest.raises(CubeError, match="notes"):
        Notes(tmp_path / "scan.nc").write(whole(**wrong))
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_notes_is_neither_shown_nor_replaced(tmp_path: Path) -> None:
    path = tmp_path / "scan.nc.notes.json"
    path.write_text(json.dumps({"mine": 1}), encoding="utf-8")
    notes = Notes(tmp_path / "scan.nc")
    for act in (notes.read, lambda: notes.write(whole())):
        with pytest.raises(CubeError, match="move it away"):
            act()
    assert json.loads(path.read_text(encoding="utf-8")) == {"mine": 1}


def test_data_in_memory_have_no_file_of_notes(client: TestClient) -> None:
    assert client.get(f"/{TOKEN}/notes").json()["file"] is None
    answer = client.post(f"/{TOKEN}/notes", json=whole())
    assert answer.status_code == 422
    assert "no data file" in answer.json()["error"]


def test_notes_on_a_cloud_have_a_place_and_no_pixel(
    served: Callable[..., TestClient], tmp_path: Path
) -> None:
    path = tmp_path / "points.xyz"
    path.write_text("0 0 1\n1 0 1\n0 1 1.5\n")
    note = {"name": "bolt", "text": "", "place": [0.0, 1.0, 1.5]}
    view = {key: VIEW[key] for key in ("name", "limits", "camera")}
    view |= {"layer": "height", "up": "z", "hidden": ["a1"]}
    client = served(space.opened(path))
    request = {"revision": 0, "annotations": [note], "views": [view]}
    assert client.post(f"/{TOKEN}/notes", json=request).json() == {"revision": 1}
    content = client.get(f"/{TOKEN}/notes").json()
    assert content == {**request, "revision": 1, "file": "points.xyz.notes.json"}
    answer = client.post(f"/{TOKEN}/notes", json=whole(revision=1))
    assert answer.status_code == 422
    assert "place" in answer.json()["error"]
