"""Clouds and meshes in a real browser: what is drawn, picked and measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import settled

from amulor import io
from amulor.imaging import point_cloud
from amulor.view import page
from amulor.view.page import space

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cloud(steps: page.Recording) -> Any:
    image = steps.channel().shown.around([], [])
    return point_cloud(image)


@pytest.fixture
def file(cloud: Any, tmp_path: Path) -> Path:
    path = tmp_path / "steps.ply"
    io.write_cloud(cloud, path)
    return path


def spot(tab: Any, place: np.ndarray) -> tuple[float, float]:
    """Return where a place of the file is seen, by a camera of our own [CSS pixel]."""
    camera = tab.evaluate(
        "() => { const c = amulor.views.camera; const f = c.frame(); return {...f, eye:"
        " c.eye(), centre: amulor.scene.centre, span: c.span(),"
        " ortho: c.orthographic, distance: c.distance}; }"
    )
    box = tab.locator("#space").bounding_box()
    away = place - np.array(camera["centre"]) - np.array(camera["eye"])
    right, up, forward = (np.array(camera[k]) for k in ("right", "up", "forward"))
    scale = box["height"] / camera["span"]
    if not camera["ortho"]:
        scale *= camera["distance"] / (away @ forward)
    return (
        box["x"] + box["width"] / 2 + scale * (away @ right),
        box["y"] + box["height"] / 2 - scale * (away @ up),
    )


def test_picks_give_the_point_of_the_file_and_lengths_their_bound(
    tab: Callable[..., Any], file: Path, cloud: Any
) -> None:
    with page.background(space.opened(file)) as address:
        tabbed = tab()
        shown = tabbed.open(address)
        # Of nothing, too, a list of terms begins with one (axe: definition-list).
        assert "Point at a point" in shown.inner_text("#readout")
        names = "[...document.getElementById('readout').children].map((e) => e.tagName)"
        assert shown.evaluate(names) == ["DT", "DD"]
        # Along the beams no point hides another one.
        shown.keyboard.press("f")
        settled(shown)
        shown.click("#tools [data-kind=distance]")
        points = np.stack([cloud[axis].values for axis in "xyz"], axis=1)
        pixels = [(4, 5), (18, 30)]
        picked = []
        for row, column in pixels:
            own = (cloud["row"].values == row) & (cloud["column"].values == column)
            (number,) = np.flatnonzero(own)
            picked.append(number)
            shown.mouse.click(*spot(shown, points[number]))
        found = shown.evaluate("amulor.measurements[0].found")
        one, other = (points[number] for number in picked)
        assert found["value"] == pytest.approx(np.linalg.norm(other - one), abs=2e-6)
        # The bound, worked out again: any correlation of the shared parts.
        along = (other - one) / np.linalg.norm(other - one)
        terms = []
        for number, place in zip(picked, (one, other), strict=True):
            cosine = along @ place / np.linalg.norm(place)
            total = cloud["slant_range_uncertainty"].values[number]
            common = cloud["slant_range_common_uncertainty"].values[number]
            terms.append((cosine**2 * (total**2 - common**2), cosine * common))
        (own_a, a), (own_b, b) = terms
        shared = max(a**2 + b**2, (a - b) ** 2)
        expected = np.sqrt(own_a + own_b + shared)
        assert found["bound"] == pytest.approx(expected, rel=1e-3)
        text = shown.inner_text("#measurements")
        assert "± at most" in text
        shown.click("#clear")
        shown.click("#undo")
        shown.reload()
        shown.wait_for_selector("html[data-complete=yes]")
        assert shown.inner_text("#measurements") == text
        shown.mouse.move(*spot(shown, points[picked[1]]))
        shown.keyboard.press("f")
        settled(shown)
        shown.mouse.click(*spot(shown, points[picked[1]]))
        place = shown.inner_text("#readout")
        assert f"{other[2]:.5f} m" in place
        assert tabbed.errors == []
        assert all(asked.startswith(address) for asked in tabbed.asked)


def test_a_mesh_is_drawn_picked_and_saved(
    tab: Callable[..., Any], tmp_path: Path
) -> None:
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((200.0, 100.0, 50.0))
    path = tmp_path / "box.stl"
    box.export(path)
    shown = space.opened(path, unit=1e-3)
    saved = tmp_path / "box.html"
    page.save_page(shown, saved)
    with page.background(shown) as address:
        for where in (address, saved.as_uri()):
            opened = tab()
            found = opened.open(where)
            found.keyboard.press("t")
            found.keyboard.press("o")
            settled(found)
            found.click("#tools [data-kind=distance]")
            # From above: right is x, up in the picture is y, and the lid is at 25 mm.
            corners = np.array([[-0.09, -0.04, 0.025], [0.09, -0.04, 0.025]])
            scale = found.evaluate("amulor.bar.metres / amulor.bar.pixels")
            scale *= (
                found.evaluate("document.querySelector('#space').width")
                / found.locator("#space").bounding_box()["width"]
            )
            area = found.locator("#space").bounding_box()
            for x, y, _ in corners:
                found.mouse.click(
                    area["x"] + area["width"] / 2 + x / scale,
                    area["y"] + area["height"] / 2 - y / scale,
                )
            value = found.evaluate("amulor.measurements[0].found.value")
            # Two clicks are whole pixels.
            assert value == pytest.approx(0.18, abs=1.5 * scale)
            pick = found.evaluate("amulor.measurements[0].picks[0].place")
            centre = found.evaluate("amulor.scene.centre")
            assert pick[2] + centre[2] == pytest.approx(0.025, abs=1e-6)
            assert found.evaluate("amulor.measurements[0].found.bound") is None
            assert "error not known" in found.inner_text("#measurements")
            assert opened.errors == []
        # A saved page asks nobody for anything.
        assert all(asked.startswith(("file:", "data:")) for asked in opened.asked)


def test_colours_keys_and_the_picture_as_a_file(
    tab: Callable[..., Any], file: Path, tmp_path: Path
) -> None:
    with page.background(space.opened(file)) as address:
        opened = tab()
        shown = opened.open(address)
        names = shown.locator("#colours button").all_inner_texts()
        assert names == ["Height", "Uncertainty", "Amplitude", "Flags"]
        layers = ["height", "uncertainty", "amplitude", "flags"]
        seen = {}
        for key, layer in zip("1234", layers, strict=True):
            shown.keyboard.press(key)
            shown.wait_for_selector(f"#space[data-layer={layer}]")
            seen[key] = shown.evaluate("document.querySelector('#space').toDataURL()")
        assert len(set(seen.values())) == 4
        # Up: height counts along another axis, and the view follows.
        shown.keyboard.press("1")
        low = shown.evaluate("amulor.limits[0]")
        shown.select_option("#up", "z")
        settled(shown)
        # z is the distance here: a wall at 1.5 m and a board at 1.44 m.
        assert low < 0 < 1.3 < shown.evaluate("amulor.limits[0]") < 1.5
        # By keyboard alone: what is in the middle is picked.
        shown.select_option("#up", "-y")
        shown.focus("#space")
        shown.keyboard.press("f")
        shown.keyboard.press("Enter")
        assert "uncertainty" in shown.inner_text("#readout")
        with shown.expect_download() as download:
            shown.click("#picture")
        picture = tmp_path / "view.png"
        download.value.save_as(picture)
        assert download.value.suggested_filename == "steps-view.png"
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert opened.errors == []


def test_a_printed_page_shows_the_cloud(tab: Callable[..., Any], file: Path) -> None:
    """Only scans have a sheet that is printed in place of the page."""
    with page.background(space.opened(file)) as address:
        shown = tab().open(address)
        settled(shown)
        shown.emulate_media(media="print")
        assert shown.locator("#space").is_visible()
