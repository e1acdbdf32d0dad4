"""The page in a real browser shows, picks and measures what the cube holds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import click, drag, drawn, place, settled, until

from amulor import imaging, rejection, samples
from amulor.view import page
from amulor.view.page.pictures import MemoryPicture

pytestmark = pytest.mark.slow


def image_of(recording: page.Recording) -> Any:
    picture = recording.channel().shown
    assert isinstance(picture, MemoryPicture)
    return picture.image


def relief(
    tab_page: Any, first: tuple[int, int], second: tuple[int, int]
) -> dict[str, float]:
    """Measure how far the second stands nearer, means of 5 x 5 pixels, first of all."""
    tab_page.select_option("#average", "2")
    tab_page.click("#tools button[data-kind=depth]")
    click(tab_page, first)
    click(tab_page, second)
    tab_page.wait_for_selector("#measurements li")
    found: dict[str, float] = tab_page.evaluate("amulor.measurements[0].found.lines[0]")
    return found


def test_the_map_shows_the_scene_and_nothing_leaves_the_host(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    one = tab()
    with page.background(steps) as address:
        shown = one.open(address)
        shown.evaluate("amulor.cursor = null; document.getElementById('light').click()")
        settled(shown)
        colours = drawn(shown, "map")
        image = image_of(steps)
        viridis_green = colours[..., 1]
        # The board, the left half, lies 60 mm nearer: dark; the wall is bright.
        for part, name in ((0.3, "board"), (0.7, "wall")):
            column = int(part * colours.shape[1])
            row = colours.shape[0] // 2
            patch = viridis_green[row - 20 : row + 20, column - 20 : column + 20]
            assert (patch.mean() > 140) == (name == "wall"), (name, patch.mean())
        assert np.isfinite(image["slant_range"].values).mean() > 0.9
        # Points in space: most of them in two groups of colours, not one flat colour.
        cloud = drawn(shown, "cloud")
        ground = cloud[5, 5]
        points = (np.abs(cloud - ground).sum(axis=-1) > 60).mean()
        assert 0.05 < points < 0.9
        for name in ("profile", "histogram", "spectrum", "bar"):
            assert drawn(shown, name)[..., 3].any(), name
        assert {url.split("/")[2] for url in one.asked if "://" in url} == {
            address.split("/")[2]
        }
        assert one.errors == []


def test_a_pick_is_the_pixel_and_the_range_of_the_cube(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        shown = tab().open(address)
        image = image_of(steps)
        for pixel in ((3, 4), (20, 33)):
            click(shown, pixel)
            assert shown.evaluate("amulor.cursor") == list(pixel)
            value = shown.evaluate("amulor.scene.value('range', ...amulor.cursor)")
            assert value == np.float32(image["slant_range"].values[pixel])
            text = shown.inner_text("#readout")
            assert f"{image['slant_range'].values[pixel] * 1e3:.0f}"[:3] in text
        # In space, seen from the front: what is seen at a point's place is that point.
        shown.click("#front")
        settled(shown)
        spot = shown.evaluate("""() => {
          const view = amulor.views.cloud;
          const p = amulor.scene.point(12, 30);
          const m = view.camera.matrix(view.canvas.width / view.canvas.height);
          const w = m[3]*p[0] + m[7]*p[1] + m[11]*p[2] + m[15];
          const x = (m[0]*p[0] + m[4]*p[1] + m[8]*p[2] + m[12]) / w;
          const y = (m[1]*p[0] + m[5]*p[1] + m[9]*p[2] + m[13]) / w;
          const box = view.canvas.getBoundingClientRect();
          return [box.left + (0.5 + x / 2) * box.width,
                  box.top + (0.5 - y / 2) * box.height];
        }""")
        shown.mouse.click(*spot)
        assert shown.evaluate("amulor.pinned") == [12, 30]


def test_relief_between_board_and_wall_is_60_mm_within_its_stated_error(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        shown = tab().open(address)
        found = relief(shown, (12, 32), (12, 8))
        assert 0 < found["uncertainty"] < 0.005
        assert abs(found["value"] - 0.060) < 3 * found["uncertainty"]
        image = image_of(steps)
        expected = imaging.measure.height(
            image, (12, 32), (12, 8), axis=(0, 0, -1), reach=2
        )
        assert found["value"] == expected.value
        # A region for a plane is dragged.
        shown.click("#tools button[data-kind=plane]")
        drag(shown, (2, 25), (20, 37))
        shown.wait_for_selector("#measurements li:nth-child(2)")
        lines = shown.evaluate("amulor.measurements[1].found.lines")
        offset = next(line for line in lines if line["label"] == "offset")
        assert abs(abs(offset["value"]) - 1.5) < 3 * offset["uncertainty"] + 0.002
        text = shown.evaluate("import('./static/tools.js').then(m => m.asText(amulor))")
        assert "group index 1.36" in text
        assert "relief" in text


def test_the_first_board_of_the_ladder_is_40_mm_before_its_wall(
    tab: Callable[..., Any],
) -> None:
    target = rejection.open_water(samples.cube("ladder"))
    with page.background(page.recording_of(target, name="ladder.nc")) as address:
        found = relief(tab().open(address), (20, 8), (20, 30))
        # Means of 25 pixels of milky water, 5 to 7 mm each.
        assert 0.0005 < found["uncertainty"] < 0.003
        assert abs(found["value"] - 0.040) < 3 * found["uncertainty"]


def test_a_saved_page_opens_alone_and_measures_as_the_library_does(
    tab: Callable[..., Any], steps: page.Recording, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    page.save_page(steps, path)
    one = tab()
    shown = one.open(path.as_uri())
    for name in ("uncertainty", "common"):
        assert shown.evaluate(f"amulor.scene.maps.has('{name}')")
    image = image_of(steps)
    rng = np.random.default_rng(1)
    usable = np.argwhere(np.isfinite(image["slant_range"].values))
    shown.evaluate("""() => Promise.all(amulor.scene.layers.map(
        (layer) => amulor.scene.load(layer.name)))""")
    for _ in range(6):
        pair = [tuple(map(int, usable[at])) for at in rng.integers(0, len(usable), 2)]
        for kind in ("distance", "height"):
            found = shown.evaluate(
                f"(pair) => import('page/geometry.js').then("
                f"(m) => m.{kind}(amulor.scene, pair))",
                [list(pixel) for pixel in pair],
            )
            expected = getattr(imaging.measure, kind)(image, *pair)
            line = found["lines"][0]
            assert line["value"] == pytest.approx(expected.value, abs=5e-6)
            # Beams between nodes are turned by up to 2 um over 1.5 m, times some mm.
            assert line["uncertainty"] == pytest.approx(
                expected.uncertainty, rel=1e-3, abs=1e-7
            )
            assert found["random"] == pytest.approx(expected.random, rel=1e-3, abs=1e-7)
    shown.click("#tools button[data-kind=distance]")
    click(shown, (12, 32))
    click(shown, (12, 8))
    shown.wait_for_selector("#measurements li")
    assert shown.is_enabled("#tools button[data-kind=profile]")
    assert drawn(shown, "map")[..., :3].std() > 20
    assert [url for url in one.asked if not url.startswith(("file:", "data:"))] == []
    assert one.errors == []


def test_keys_switch_and_themes_work(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    one = tab(viewport={"width": 1024, "height": 768}, color_scheme="dark")
    with page.background(steps) as address:
        shown = one.open(address)
        assert shown.evaluate("document.documentElement.dataset.theme") == "dark"
        assert shown.evaluate(
            "document.documentElement.scrollWidth <= window.innerWidth"
        )
        after = drawn(shown, "map")
        shown.keyboard.press("w")
        settled(shown)
        assert shown.evaluate("amulor.layerName") == "range_before"
        assert (drawn(shown, "map") != after).any()
        shown.keyboard.press("w")
        shown.focus("#map")
        before = shown.evaluate("amulor.cursor")
        shown.keyboard.press("ArrowDown")
        shown.keyboard.press("ArrowRight")
        assert shown.evaluate("amulor.cursor") == [before[0] + 1, before[1] + 1]
        # High contrast follows dark and lasts over a reload.
        name = "document.documentElement.dataset.theme"
        shown.keyboard.press("d")
        assert shown.evaluate(name) == "contrast"
        settled(shown)
        corner = drawn(shown, "map")[0, 0, :3].tolist()
        assert corner == [255, 255, 255]
        words = shown.get_attribute("#theme", "aria-label")
        assert words == "Theme: high contrast. Next: light (D)"
        shown.reload()
        shown.wait_for_selector("html[data-complete=yes]")
        assert shown.evaluate(name) == "contrast"
        for key, name in (("2", "amplitude"), ("3", "uncertainty"), ("1", "range")):
            shown.keyboard.press(key)
            until(shown, f"amulor.layerName === '{name}'")
        shown.keyboard.press("o")
        settled(shown)
        # A scale bar in orthographic views only, and as long as it says.
        bar = shown.evaluate(
            "[amulor.views.cloud.bar.metres, amulor.views.cloud.bar.pixels,"
            "amulor.views.cloud.camera.span() / amulor.views.cloud.canvas.height]"
        )
        assert bar[0] == pytest.approx(bar[1] * bar[2], rel=1e-6)
        assert one.errors == []


def test_touch_pans_and_picks(tab: Callable[..., Any], steps: page.Recording) -> None:
    one = tab(viewport={"width": 820, "height": 1100}, has_touch=True)
    with page.background(steps) as address:
        shown = one.open(address)
        shown.locator("#map").scroll_into_view_if_needed()
        spot = place(shown, (6, 9))
        shown.touchscreen.tap(spot["x"], spot["y"])
        until(shown, "amulor.pinned !== null")
        assert shown.evaluate("amulor.pinned") == [6, 9]
        assert one.errors == []


def test_a_server_that_is_gone_and_a_map_that_is_broken_give_messages(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    one = tab()
    with page.background(steps) as address:
        one.page.route("**/layer/*/range", lambda route: route.fulfill(body=b"1234"))
        one.page.goto(address)
        one.page.wait_for_selector("#message:not([hidden])", timeout=60_000)
        assert "has 1 numbers instead of 960" in one.page.inner_text("#message")
        one.page.unroute("**/layer/*/range")
        shown = one.open(address)
        shown.click("#tools button[data-kind=distance]")
        click(shown, (12, 32))
    click(shown, (12, 8))
    shown.wait_for_selector("#hint.wrong", timeout=30_000)
    assert "does not answer" in shown.inner_text("#hint")


#: Counts the draw calls of each canvas.
_WATCH = """() => {
  window.drawn = { map: 0, cloud: 0 };
  for (const [name, key] of [["drawMap", "map"], ["drawCloud", "cloud"]]) {
    const draw = amulor.renderer[name].bind(amulor.renderer);
    amulor.renderer[name] = (context, parts) => {
      if (!parts.pick) window.drawn[key] += 1;
      return draw(context, parts);
    };
  }
}"""
_OVER = """(name) => {
  const over = document.querySelector(`#${name} + .over`);
  const { data } = over.getContext("2d").getImageData(0, 0, over.width, over.height);
  let first = -1;
  for (let k = 3; k < data.length && first < 0; k += 4) if (data[k]) first = k;
  return first;
}"""


def test_the_pointer_moves_on_a_layer_of_its_own(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        shown = tab().open(address)
        shown.evaluate(_WATCH)
        before = {name: drawn(shown, name) for name in ("map", "cloud", "histogram")}
        seen = []
        for pixel in ((3, 4), (20, 33)):
            spot = place(shown, pixel)
            shown.mouse.move(spot["x"], spot["y"])
            settled(shown)
            assert shown.evaluate("amulor.cursor") == list(pixel)
            seen.append([shown.evaluate(_OVER, name) for name in ("map", "cloud")])
        # The mark of either view has moved.
        assert all(one != other and one > 0 for one, other in zip(*seen, strict=True))
        assert shown.evaluate("window.drawn") == {"map": 0, "cloud": 0}
        for name, picture in before.items():
            assert (drawn(shown, name) == picture).all(), name
        shown.keyboard.press("2")
        settled(shown)
        assert shown.evaluate("window.drawn.map") > 0


#: Where the middle between two pixels is on the canvas, seen from the right.
BETWEEN = """([first, second]) => {
  const { scene, views } = amulor;
  const { matrix, canvas } = views.cloud;
  const [a, b] = [scene.point(...first), scene.point(...second)];
  const middle = [0, 1, 2].map((k) => (a[k] + b[k]) / 2);
  const [x, y, , w] = [0, 1, 2, 3].map((row) => matrix[12 + row]
    + middle.reduce((sum, part, k) => sum + matrix[4 * k + row] * part, 0));
  return [(0.5 + x / w / 2) * canvas.width, (0.5 - y / w / 2) * canvas.height];
}"""


def test_the_surface_ends_where_the_range_steps(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        opened = tab()
        shown = opened.open(address)
        shown.evaluate(
            "Object.assign(amulor.views.cloud.camera, { turn: 0.8, rise: 0 })"
        )
        shown.keyboard.press("Escape")
        settled(shown)

        def colour(first: tuple[int, int], second: tuple[int, int]) -> list[int]:
            spot = shown.evaluate(BETWEEN, [list(first), list(second)])
            return drawn(shown, "cloud")[round(spot[1]), round(spot[0]), :3].tolist()

        ground = drawn(shown, "cloud")[2, 2, :3].tolist()
        # Column 19 is the last of the board, 20 the first of the wall behind it.
        assert colour((6, 19), (6, 20)) == ground
        assert colour((6, 30), (6, 31)) != ground
        assert colour((6, 8), (7, 8)) != ground
        surface = drawn(shown, "cloud")
        shown.click("#points")
        settled(shown)
        assert shown.get_attribute("#points", "aria-pressed") == "true"
        assert (drawn(shown, "cloud") != surface).any()
        assert opened.errors == []


def test_turning_draws_the_view_in_space_alone(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    one = tab()
    with page.background(steps) as address:
        shown = one.open(address)
        before = drawn(shown, "cloud")
        shown.evaluate("""() => {
          const { renderer } = amulor;
          const draw = renderer.drawMap.bind(renderer);
          window.maps = 0;
          renderer.drawMap = (...all) => { window.maps += 1; draw(...all); };
        }""")
        box = shown.locator("#cloud").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        shown.mouse.move(x, y)
        settled(shown)
        shown.evaluate("maps = 0")
        shown.mouse.down()
        shown.mouse.move(x + 80, y + 20, steps=5)
        shown.mouse.up()
        settled(shown)
        assert shown.evaluate("maps") == 0
        assert (drawn(shown, "cloud") != before).any()
        assert one.errors == []
