"""The drawing set of a site has its sheets, details and files."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from plane_visits import SCANS, SITE, Known, visit

from amulor.errors import FormatError
from amulor.handover import drawings, site_drawings
from amulor.handover.drawing_set import Page
from amulor.handover.site_drawings import SiteOrder, _Visit, write_site_drawings


@pytest.mark.parametrize(
    ("window", "found"),
    [
        ((0.1, 0.9, 0.1, 0.9), False),
        ((1.9, 2.1, 0.9, 1.1), True),
        ((1.9, 2.1, 0.1, 0.9), False),
        ((0.9, 1.9, 0.9, 1.1), False),
        # Middles of cells on the edge are inside.
        ((2.0, 3.0, 1.0, 1.0), True),
        ((1.0, 2.0, 0.0, 1.0), True),
    ],
)
def test_a_window_with_a_height_has_a_surface(window, found) -> None:
    """The only height lies at (2, 1)."""
    height = np.full((3, 4), np.nan)
    height[1, 2] = 0.0
    raster: Any = SimpleNamespace(
        rows=np.array([2.0, 1.0, 0.0]), columns=np.arange(4.0), height=height
    )
    assert site_drawings._has_surface(raster, window) is found


def test_details_are_as_few_as_fit_a3(monkeypatch) -> None:
    """Rows of details go from north to south, columns from west to east."""
    monkeypatch.setattr(site_drawings, "largest_on_a3", lambda: (0.4, 0.25))
    tiles = site_drawings._tiles
    # 4 by 2.5 m at 1:10.
    assert tiles(10.0, 20.0, (0.0, 4.0, 0.0, 2.5)) == []
    assert tiles(10.0, 20.0, (0.0, 6.0, 1.0, 3.0)) == [
        (0.0, 3.0, 1.0, 3.0), (3.0, 6.0, 1.0, 3.0)
    ]  # fmt: skip
    assert tiles(10.0, 20.0, (1.0, 4.0, 0.0, 6.0)) == [
        (1.0, 4.0, 4.0, 6.0), (1.0, 4.0, 2.0, 4.0), (1.0, 4.0, 0.0, 2.0)
    ]  # fmt: skip
    assert tiles(10.0, 10.0, (0.0, 6.0, 1.0, 3.0)) == []
    assert tiles(11.0, 10.0, (0.0, 6.0, 1.0, 3.0)) == []
    assert tiles(None, 10.0, (0.0, 6.0, 1.0, 3.0)) == []


class Written:
    """Recorder of the files of a site's drawings, none of which is written."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[Any] = []
        self.steps: list[tuple[str, float]] = []
        self.bands: dict[str, Any] = {}

        def page(kind: str) -> Any:
            def made(visit: Any, block: Any, *words: Any, **more: Any) -> Page:
                self.calls.append((kind, block.title, words, more))
                return Page(figure=Figure(), block=block, summary="sum")

            return made

        for kind in ("plan", "uncertainty", "section"):
            monkeypatch.setattr(_Visit, kind, page(kind))
        monkeypatch.setattr(
            _Visit, "heights", lambda visit, scale, window: Part(scale, window)
        )
        monkeypatch.setattr(site_drawings, "contour_interval", self._interval)
        monkeypatch.setattr(drawings, "bands_of", lambda raster, first: first)
        monkeypatch.setattr(drawings, "write_bands", self._bands)
        monkeypatch.setattr(site_drawings, "write_pages", self._pages)
        monkeypatch.setattr(
            site_drawings, "tell", lambda *words: self.steps.append(words)
        )

    def _interval(self, raster: Any, *, levels: int) -> float:
        assert (raster, levels) == ("coarse", 16)
        return 0.123

    def _bands(self, *words: Any, overwrite: bool) -> None:
        self.bands = {"words": words, "overwrite": overwrite}

    def _pages(
        self, pages: Any, path: Path, title: str, *, overwrite: bool
    ) -> list[str]:
        return [f"{title}: {', '.join(pages)}"]


class Part:
    """Heights of a part that are not computed."""

    fine, coarse = "fine", "coarse"

    def __init__(self, scale: float, window: Any) -> None:
        self.scale, self.window = scale, window


def write(order: SiteOrder, path: Path = Path("s.pdf")) -> str:
    """Write the drawings of the site."""
    registration: Any = Known()
    return write_site_drawings(SITE, registration, SCANS, path, order)


def test_a_set_of_one_sheet_has_plan_map_and_sections(monkeypatch) -> None:
    """Without a scale, the plan has that of the overview."""
    written = Written(monkeypatch)
    assert write(SiteOrder()).splitlines() == [
        "4 sheets",
        "  s_plan.tif: heights as GeoTIFF",
        "Harbor: plan, uncertainty, section_A, section_B",
    ]
    overview = visit().overview_scale()
    plan, uncertainty, *sections = written.calls
    (whole, interval), more = plan[2:]
    assert (whole.scale, whole.window) == (overview, visit().bounds)
    assert interval == 0.123
    assert list(more["cuts"]) == ["A", "B"]
    assert more["details"] == {}
    assert uncertainty[1:] == ("Harbor: uncertainty", (whole,), {})
    assert sections == [
        ("section", "Harbor: section A", ("A",), {}),
        ("section", "Harbor: section B", ("B",), {}),
    ]
    assert written.bands["words"][:3] == ("fine", "dem", Path("s_plan.tif"))
    assert written.bands["overwrite"] is False
    assert written.steps[-1] == ("drawing sections", 0.5)
    # A smaller scale than that of the overview is that of the plan.
    write(SiteOrder(scale=2 * overview, contours=0.02, title="Deck"))
    kind, title, (whole, interval), more = written.calls[4]
    assert (kind, title) == ("plan", "Deck: plan")
    assert (whole.scale, interval) == (2 * overview, 0.02)


def test_details_have_a_surface_and_the_stated_scale(monkeypatch) -> None:
    """The plan of details keeps the scale of the overview, and frames each of them."""
    written = Written(monkeypatch)
    tiles = [(0.0, 3.0, 0.0, 2.0), (50.0, 51.0, 0.0, 2.0), (3.0, 5.5, 0.0, 2.0)]
    monkeypatch.setattr(site_drawings, "_tiles", lambda *_: tiles)
    said = write(SiteOrder(scale=3.0, title="Deck"))
    assert said.splitlines()[0] == "6 sheets"
    assert said.splitlines()[2] == (
        "Deck: plan, uncertainty, section_A, section_B, detail_1, detail_2"
    )
    whole = written.calls[0][2][0]
    assert whole.scale == visit().overview_scale()
    assert written.calls[0][3]["details"] == {"1": tiles[0], "2": tiles[2]}
    parts = [(call[1], call[2][0]) for call in written.calls[-2:]]
    assert [(title, part.scale, part.window) for title, part in parts] == [
        ("Deck: detail 1", 3.0, tiles[0]), ("Deck: detail 2", 3.0, tiles[2])
    ]  # fmt: skip
    assert [call[2][1] for call in written.calls[-2:]] == [0.123, 0.123]
    assert written.steps[-2:] == [
        ("drawing details", pytest.approx(0.6)),
        ("drawing details", pytest.approx(0.75)),
    ]


def test_no_file_of_a_site_is_replaced_unasked(monkeypatch, tmp_path) -> None:
    """The file of heights is checked with the sheets, before they are drawn."""
    written = Written(monkeypatch)
    for name in ("s_plan.tif", "s_uncertainty.svg", "s_section_B.dxf"):
        (tmp_path / name).touch()
        with pytest.raises(FormatError, match=f"{name} exists already"):
            write(SiteOrder(), tmp_path / "s.pdf")
        (tmp_path / name).unlink()
    assert written.calls == []
