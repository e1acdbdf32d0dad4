"""The page on screens of several sizes: nothing cut off, all points in view."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from pages import settled

from amulor import handover
from amulor.view import page

pytestmark = pytest.mark.slow

#: Words that their place is too narrow for, and what reaches beyond the screen.
CUT = """() => {
  const cut = [...document.querySelectorAll('.tabs span, #readout dd, #readout dt, .tools button, .mini, header button')]
    .filter((one) => one.offsetParent && one.scrollWidth > one.clientWidth + 1)
    .map((one) => one.textContent);
  const out = [...document.querySelectorAll('header *, aside .card, .bar *, #readout dd')]
    .filter((one) => one.offsetParent && one.getBoundingClientRect().right > innerWidth + 1)
    .map((one) => one.textContent.slice(0, 30));
  return [...cut, ...out, ...(document.documentElement.scrollWidth > innerWidth ? ['page'] : [])];
}"""  # noqa: E501
#: Parts of the canvas that the points reach to, by a projection of our own.
REACH = """() => {
  const { scene, views } = amulor;
  const camera = views.cloud.camera;
  const { right, up, forward } = camera.frame();
  const eye = camera.eye();
  const canvas = views.cloud.canvas;
  const aspect = canvas.clientWidth / canvas.clientHeight;
  let reach = 0;
  for (let row = 0; row < scene.rows; row += 1) {
    for (let column = 0; column < scene.columns; column += 1) {
      const place = scene.point(row, column);
      if (!place) continue;
      const away = place.map((part, k) => part - eye[k]);
      const [x, y, z] = [right, up, forward].map((axis) => axis.reduce((s, a, k) => s + a * away[k], 0));
      const half = z * camera.span() / camera.distance / 2;
      reach = Math.max(reach, Math.abs(y) / half, Math.abs(x) / half / aspect);
    }
  }
  return reach;
}"""  # noqa: E501


@pytest.mark.parametrize(
    ("size", "touch"),
    [((1024, 720), False), ((390, 844), True), ((820, 1180), True)],
    ids=["1024", "phone", "tablet"],
)
def test_nothing_is_cut_off_and_all_points_are_in_view(
    tab: Callable[..., Any],
    steps: page.Recording,
    size: tuple[int, int],
    touch: bool,
) -> None:
    wide, high = size
    with page.background(steps, products=handover.PageProducts()) as address:
        opened = tab(
            viewport={"width": wide, "height": high}, is_mobile=touch, has_touch=touch
        )
        shown = opened.open(address)
        assert shown.evaluate(CUT) == []
        # A narrow window has one view at a time.
        if not shown.is_visible("#cloud"):
            shown.click("#views [data-view=cloud]")
            settled(shown)
            assert shown.evaluate(CUT) == []
        # The farthest points are left aside; the rest nearly fills the view.
        assert 0.7 < shown.evaluate(REACH) < 1.05
        shown.click("#front")
        settled(shown)
        assert 0.7 < shown.evaluate(REACH) < 1.05
        assert opened.errors == []


def test_the_map_has_a_scale_and_a_finger_scrolls_the_page(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        opened = tab(
            viewport={"width": 420, "height": 860}, is_mobile=True, has_touch=True
        )
        shown = opened.open(address)
        bar, axes, typical = shown.evaluate(
            "[amulor.views.map.bar, amulor.views.map.axes, amulor.scene.typical]"
        )
        # 40 columns over 8 degrees fill the width; beams diverge by so much at the
        # median range, which the bar names.
        across = typical * math.radians(8)
        wide = axes["ends"]["right"] - axes["ends"]["left"]
        assert bar["pixels"] / bar["metres"] == pytest.approx(wide / across, rel=0.03)
        # The pixel is at the lower end of the screen, whatever is scrolled to.
        box = shown.locator("#pixel-card").bounding_box()
        assert box["y"] + box["height"] == pytest.approx(860, abs=1)
        action = "getComputedStyle(document.getElementById('map')).touchAction"
        assert shown.evaluate(action) == "pan-y"
        shown.locator("#tools button[data-kind=plane]").dispatch_event("click")
        assert shown.evaluate(action) == "none"
        shown.locator("#tools button[data-kind=plane]").dispatch_event("click")
        assert shown.evaluate(action) == "pan-y"
        assert opened.errors == []


def test_the_axes_of_the_map_are_lengths_at_the_median_range(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        opened = tab()
        shown = opened.open(address)
        for zoomed in (False, True):
            if zoomed:
                shown.focus("#map")
                for _ in range(6):
                    shown.keyboard.press("+")
                settled(shown)
            axes, typical, spots = shown.evaluate(
                "[amulor.views.map.axes, amulor.scene.typical, [[0, 0], [23, 39]].map("
                "(pixel) => amulor.views.map.spot(amulor.scene, pixel))]"
            )
            for at, span in ((0, 8.0), (1, 4.8)):
                side = axes["sides"][at]
                assert side["label"].startswith(("across [mm]", "down [mm]")[at])
                # Ticks on the line from the first to the last pixel of the scan.
                length = typical * math.radians(span)
                scale = (spots[1][at] - spots[0][at]) / length
                assert len(side["ticks"]) >= 2
                for tick in side["ticks"]:
                    place = spots[0][at] + tick["value"] * scale
                    assert tick["at"] == pytest.approx(place, abs=0.01 * scale * length)
                    assert float(tick["text"]) == pytest.approx(1e3 * tick["value"])
            assert axes["sides"][0]["label"].endswith(f"at {typical:.2f} m")
        assert opened.errors == []
