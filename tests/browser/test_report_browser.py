"""A report on a phone: what explains a wide table stays in view."""

from __future__ import annotations

from pathlib import Path

import pytest
import skips

from amulor.view import Table, write_report


def test_the_caption_of_a_wide_table_is_whole_on_a_phone(tmp_path: Path) -> None:
    chromium = skips.need_browser()
    playwright = pytest.importorskip("playwright.sync_api")
    path = tmp_path / "report.html"
    row = [f"{number}.123456 mm" for number in range(12)]
    write_report(path, "Wide", [Table(row, [row], "What the numbers are. " * 9)])
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=chromium, args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 420, "height": 900})
        page.goto(path.as_uri())
        table = page.eval_on_selector(".table", "box => box.scrollWidth")
        caption = page.eval_on_selector(
            "caption", "it => it.getBoundingClientRect().right"
        )
        browser.close()
    assert table > 420
    assert caption <= 420
