"""Deviations from a reference have maps, numbers and profiles in the page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pages import drawn, settled, until

from amulor import handover
from amulor.view import page

pytestmark = pytest.mark.slow

#: Distance of the board from its reference, a wall behind it [m].
STEP = 0.06


@pytest.fixture
def compared(steps: page.Recording, tmp_path: Path) -> page.Recording:
    """Compare the board before a wall with the wall alone."""
    corners = [(x, y, 1.5) for x in (-1, 1) for y in (-1, 1)]
    path = tmp_path / "wall.stl"
    trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]]).export(path)
    image = steps.channel().shown.whole()
    recording = page.recording_of(image, name="steps.nc")
    recording.against = handover.comparison(path, unit="m")
    return recording


def read(opened: Any) -> None:
    shown = opened.page
    for name in ("deviation", "significant"):
        shown.click(f"#tabs button[data-layer={name}]")
        until(shown, f"amulor.layerName === '{name}'")
        shown.evaluate("amulor.cursor = [12, 8]")
        settled(shown)
        # The board is in color, on one scale; the wall is pale, then gray.
        assert shown.inner_text("#unit") == "mm"
        limit = shown.evaluate("amulor.limits[1]")
        assert limit == pytest.approx(STEP, rel=0.05)
    shown.evaluate("amulor.cursor = null")
    settled(shown)
    picture = drawn(shown, "map")[..., :3]
    colors = picture.reshape(-1, 3)
    red = (colors[:, 0] > 100) & (colors[:, 1] < 60) & (colors[:, 2] < 80)
    assert 0.1 < np.mean(red) < 0.5
    shown.focus("#map")
    for _ in range(4):
        shown.keyboard.press("ArrowLeft")
    settled(shown)
    text = shown.inner_text("#readout")
    assert "deviation" in text
    assert "significant" in text
    assert opened.errors == []


def test_the_board_deviates_from_the_wall(
    tab: Callable[..., Any], compared: page.Recording, tmp_path: Path
) -> None:
    with page.background(compared) as address:
        opened = tab()
        opened.open(address)
        read(opened)
    page.save_page(compared, tmp_path / "page.html")
    opened = tab(viewport={"width": 420, "height": 900})
    opened.open((tmp_path / "page.html").as_uri())
    read(opened)
