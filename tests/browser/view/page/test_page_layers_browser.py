"""Maps of the page show what is there: no light on numbers, no rounding in color."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import drawn, settled, until

from amulor import rejection, samples
from amulor.imaging.common import own_variance
from amulor.imaging.edges import reached, steps
from amulor.view import page

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ladder() -> page.Recording:
    target = rejection.open_water(samples.cube("ladder"))
    return page.recording_of(target, name="ladder.nc")


def layer(shown: Any, number: int) -> None:
    """Show a map by its key, without the pointer on it."""
    name = shown.evaluate(f"amulor.tabs[{number - 1}]")
    shown.keyboard.press(str(number))
    until(shown, f"amulor.layerName === '{name}'")
    shown.evaluate("amulor.cursor = null")
    settled(shown)


def values(shown: Any, name: str) -> np.ndarray:
    found = shown.evaluate(f"[...amulor.scene.maps.get('{name}').values]")
    return np.array(found, dtype=float)


def test_light_falls_on_ranges_alone(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    one = tab()
    with page.background(steps) as address:
        shown = one.open(address)
        for number, changes in ((1, True), (2, False), (3, False)):
            layer(shown, number)
            pictures = []
            for on in ("true", "false"):
                shown.evaluate(f"document.getElementById('light').checked = {on}")
                shown.evaluate("document.getElementById('light-rise').value = 10")
                shown.evaluate("window.dispatchEvent(new Event('resize'))")
                layer(shown, number)
                pictures.append([drawn(shown, "map"), drawn(shown, "cloud")])
            for lit, plain in zip(*pictures, strict=True):
                assert (lit != plain).any() == changes, number
            assert shown.is_disabled("#light") != changes
        assert one.errors == []


def test_rounding_has_no_color(tab: Callable[..., Any], ladder: page.Recording) -> None:
    one = tab()
    with page.background(ladder) as address:
        shown = one.open(address)
        layer(shown, 4)
        bias, error = values(shown, "bias"), values(shown, "uncertainty")
        assert shown.evaluate("amulor.layerName") == "bias"
        assert 0 < np.nanmax(np.abs(bias)) < 1e-12
        # The scale is of the size of errors, and its middle is white.
        limit = shown.evaluate("amulor.limits[1]")
        assert limit == pytest.approx(np.nanmedian(error) / 100, rel=1e-3)
        assert shown.inner_text("#unit") == "µm: 0 within rounding"
        picture = drawn(shown, "map")[..., :3]
        height = picture.shape[0] // 2
        saturation = np.ptp(picture[height - 20 : height + 20], axis=-1)
        assert saturation.max() < 30
        assert one.errors == []


def test_with_the_water_in_the_raw_range_is_stated_and_the_cloud_in_view(
    tab: Callable[..., Any], ladder: page.Recording
) -> None:
    one = tab()
    with page.background(ladder) as address:
        shown = one.open(address)
        row, column = shown.evaluate("amulor.cursor")
        corrected = shown.inner_text("#readout dd.big")
        assert "±" in corrected
        shown.keyboard.press("w")
        until(shown, "amulor.layerName === 'range_before'")
        settled(shown)
        raw = shown.evaluate(f"amulor.scene.value('range_before', {row}, {column})")
        said = shown.inner_text("#readout dd.big")
        assert said == f"{raw * 1e3:.1f} mm, water in"
        assert corrected in shown.inner_text("#readout")
        place = shown.evaluate(
            f"amulor.scene.point({row}, {column}, 'range_before')[2]"
        )
        assert f"{place * 1e3:.1f} mm" in shown.inner_text("#readout")
        inside = shown.evaluate("""() => {
          const { scene, views } = amulor;
          const { matrix: m } = views.cloud;
          const inside = [];
          for (let row = 0; row < scene.rows; row += 3) {
            for (let column = 0; column < scene.columns; column += 1) {
              if (!Number.isFinite(scene.value("range", row, column))) continue;
              const p = scene.point(row, column, "range_before");
              const on = (k) => m[k] * p[0] + m[k+4] * p[1] + m[k+8] * p[2] + m[k+12];
              inside.push(Math.abs(on(0) / on(3)) < 1 && Math.abs(on(1) / on(3)) < 1);
            }
          }
          return inside;
        }""")
        assert np.mean(inside) > 0.97
        shown.keyboard.press("w")
        until(shown, "amulor.layerName === 'range'")
        assert shown.inner_text("#readout dd.big") == corrected
        assert one.errors == []


def test_means_of_the_page_do_not_cross_steps_and_are_those_of_the_library(
    tab: Callable[..., Any], ladder: page.Recording
) -> None:
    one = tab()
    with page.background(ladder) as address:
        shown = one.open(address)
        shown.evaluate("""() => {
          const reach = document.getElementById("reach");
          reach.value = "6";
          reach.dispatchEvent(new Event("input"));
        }""")
        smooth = shown.evaluate("[...amulor.scene.maps.get('range').smooth]")
        means = np.array(smooth, dtype=float).reshape(40, 100)
        image = ladder.channel("VV").shown.whole()
        ranges = image["slant_range"].values
        edges = steps(ranges, own_variance(image))
        for pixel in ((3, 4), (20, 16), (20, 22), (12, 57), (39, 99)):
            part = reached(*edges, pixel, 6) & np.isfinite(ranges)
            assert means[pixel] == pytest.approx(ranges[part].mean(), abs=2e-7)
        # The wall is at 1.5 m, the first board 40 mm before it, gap at 18 and 19.
        noise = np.nanmedian(image["slant_range_uncertainty"].values)
        assert np.all(np.abs(means[:, 10:17] - 1.5) < noise)
        assert np.all(np.abs(means[:, 21:28] - 1.46) < noise)
        assert one.errors == []


def typed(shown: Any, field: str, text: str) -> None:
    """Type a limit over the one in a field, by keyboard."""
    shown.focus(field)
    shown.keyboard.press("Control+a")
    shown.keyboard.type(text)
    shown.keyboard.press("Enter")
    settled(shown)


def test_typed_limits_color_the_map_and_outlive_reload_and_saving(
    tab: Callable[..., Any], steps: page.Recording, tmp_path: Path
) -> None:
    one = tab()
    with page.background(steps) as address:
        shown = one.open(address)
        automatic = shown.evaluate("amulor.limits")
        typed(shown, "#low", "1.2")
        typed(shown, "#high", "1.45")
        assert shown.evaluate("amulor.limits") == [1.2, 1.45]
        # The wall, at 1.5 m, is beyond the scale now: all of it has the last color.
        shown.uncheck("#light")
        settled(shown)
        x, y = shown.evaluate("amulor.views.map.spot(amulor.scene, [2, 38])")
        # The last color of viridis (matplotlib).
        assert drawn(shown, "map")[int(y), int(x), :3] == pytest.approx(
            [253, 231, 37], abs=2
        )
        with shown.expect_download() as download:
            shown.click("#save")
        saved = tmp_path / "page.html"
        download.value.save_as(saved)
        # Arrow keys step to round numbers; each step is kept.
        shown.focus("#high")
        shown.keyboard.press("ArrowUp")
        settled(shown)
        stepped = shown.evaluate("amulor.limits[1]")
        assert 1.45 < stepped < 1.46
        shown.reload()
        shown.wait_for_selector("html[data-complete=yes]")
        assert shown.evaluate("amulor.limits") == [1.2, stepped]
        shown.click("#auto")
        assert shown.evaluate("amulor.limits") == automatic
        assert "limits" not in shown.url
        shown = one.open(saved.as_uri())
        assert shown.evaluate("amulor.limits") == [1.2, 1.45]
        assert shown.input_value("#low").startswith("1.2")
        assert one.errors == []


def test_a_wrong_limit_is_explained_and_changes_nothing(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    one = tab()
    with page.background(steps) as address:
        shown = one.open(address)
        before = shown.evaluate("amulor.limits")
        typed(shown, "#low", "9")
        said = shown.inner_text("#limits-note")
        assert said.startswith("9.0000 m is not below 1.5")
        assert shown.get_attribute("#low", "aria-invalid") == "true"
        assert shown.evaluate("amulor.limits") == before
        typed(shown, "#high", "-")
        assert "Type a number in m, such as" in shown.inner_text("#limits-note")
        # Escape discards what was typed, with its message.
        shown.keyboard.press("Escape")
        assert shown.inner_text("#limits-note") == ""
        assert float(shown.input_value("#high")) == pytest.approx(before[1], abs=1e-3)
        # A signed scale keeps 0 in its middle.
        shown.focus("#map")
        layer(shown, 4)
        typed(shown, "#low", "-7")
        low, high = shown.evaluate("amulor.limits")
        assert low == -high != 0
        assert one.errors == []
