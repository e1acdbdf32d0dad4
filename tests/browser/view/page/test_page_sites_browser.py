"""A site in the browser: scans are shown and hidden, change has its colors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import drawn_sites
import numpy as np
import pytest
import skips
from pages import drawn, settled, until

from amulor.cli.site import changes_between, opened
from amulor.view import page
from amulor.view.page.sites import site_space
from amulor.view.page.space import Space

pytestmark = pytest.mark.slow

#: Violations of accessibility that axe finds.
_AXE = """async () => (await axe.run(document)).violations.map(
  ({ id, nodes }) => `${id} ${nodes[0].target}`)"""
SHOWN = """amulor.scene.position
  .reduce((sum, value) => sum + (Number.isFinite(value) ? 1 : 0), 0) / 3"""


@pytest.fixture(scope="module")
def shown_site(tmp_path_factory: pytest.TempPathFactory) -> Space:
    folder = tmp_path_factory.mktemp("site")
    site = drawn_sites.bumped_site(folder, rows=50, height=0.02, middle=(0.1, 0.05))
    merged = opened(site, folder / "poses.json")
    change, *_ = changes_between(merged, ("one", "two"))
    pairs = tuple(
        {
            "source": f"a{n}",
            "target": "a1",
            "points": 1000 * n,
            "moved_points": n,
            "misfit": 0.9 + 0.3 * n,
            "median_distance_m": 4e-4 * n,
            "trust": 1.0,
            "loose": [],
        }
        for n in (2, 3, 4)
    )
    registration = replace(merged.registration, pairs=pairs)
    return site_space(merged.cloud, registration, change=change)


def look(opened_tab: Any, points: int) -> None:
    shown = opened_tab.page
    assert shown.locator("#scans input").count() == 8
    assert shown.evaluate(SHOWN) == points
    # The bump is in the color of a large change.
    assert shown.get_attribute("#space", "data-layer") == "change"
    colors = drawn(shown, "space")[..., :3].reshape(-1, 3)
    assert ((colors[:, 0] > 90) & (colors[:, 1] < 50)).sum() > 20
    by_name = {scan["name"]: scan for scan in shown.evaluate("amulor.scene.scans")}
    shown.locator("#scans").scroll_into_view_if_needed()
    shown.click("#visits button:nth-child(2)")
    of_first = sum(s["points"] for s in by_name.values() if s["visit"] == "one")
    until(shown, f"{SHOWN} === {of_first}")
    shown.uncheck("#scans input[name=a1]")
    until(shown, f"{SHOWN} === {of_first - by_name['a1']['points']}")
    # Hidden points are not picked.
    shown.focus("#space")
    shown.keyboard.press("Enter")
    settled(shown)
    text = shown.inner_text("#readout")
    assert "visit one" in text
    assert "a1" not in text
    shown.locator("#scans").scroll_into_view_if_needed()
    shown.click("#visits button:first-child")
    until(shown, f"{SHOWN} === {points}")
    assert shown.locator("#scans input:checked").count() == 8
    rows = shown.locator("#pairs tbody tr").all_inner_texts()
    pairs = shown.evaluate("amulor.scene.pairs")
    assert len(rows) == len(pairs) == 3
    for row, pair in zip(rows, pairs, strict=True):
        assert row.startswith(f"{pair['source']} on {pair['target']}")
        assert f"{pair['distance'] * 1e3:.2f}" in row
        assert f"{pair['misfit']:.2f}" in row
    # A saved view keeps which scans are hidden.
    shown.uncheck("#scans input[name=a1]")
    shown.click("#view-save")
    shown.check("#scans input[name=a1]")
    shown.click("#book .view:last-of-type button:first-child")
    until(shown, f"{SHOWN} === {points - by_name['a1']['points']}")
    assert not shown.is_checked("#scans input[name=a1]")
    assert opened_tab.errors == []


def test_scans_are_shown_and_hidden(
    tab: Callable[..., Any], shown_site: Space, tmp_path: Path
) -> None:
    points = len(shown_site.position)
    with page.background(shown_site) as address:
        opened_tab = tab()
        opened_tab.open(address)
        look(opened_tab, points)
    page.save_page(shown_site, tmp_path / "site.html")
    opened_tab = tab(viewport={"width": 420, "height": 900})
    opened_tab.open((tmp_path / "site.html").as_uri())
    look(opened_tab, points)


def test_axe_finds_nothing(
    tab: Callable[..., Any], shown_site: Space, tmp_path: Path
) -> None:
    axe = skips.need_axe().read_text(encoding="utf-8")
    page.save_page(shown_site, tmp_path / "site.html")
    for width in (1440, 420):
        opened_tab = tab(viewport={"width": width, "height": 900})
        shown = opened_tab.open((tmp_path / "site.html").as_uri())
        shown.evaluate(axe)
        for _ in range(3):
            settled(shown)
            assert shown.evaluate(_AXE) == []
            shown.click("#theme")
        assert np.isfinite(shown.evaluate("amulor.limits[1]"))
