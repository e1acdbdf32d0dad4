"""Reports carry pages that can be turned, apart from the report itself."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from amulor import imaging
from amulor.view import Interactive, image_report, write_report
from amulor.view.page.layers import unpacked


@pytest.mark.slow
def test_a_report_carries_the_page_of_each_image(
    target: xr.Dataset, tmp_path: Path
) -> None:
    images = {
        name: imaging.range_image(target, polarization=name) for name in ("VV", "VH")
    }
    path = tmp_path / "report.html"
    image_report.write(path, images)
    text = path.read_text()
    frames = re.findall(r'<iframe [^>]*srcdoc="([^"]*)"', text)
    assert len(frames) == 2
    # The picture for paper is still there.
    assert "Height is counted towards the instrument" in text
    for name, frame in zip(images, frames, strict=True):
        page = html.unescape(frame)
        start = page.index(f'data-name="layer/{name}/range"')
        data = page[page.index(">", start) + 1 : page.index("</script>", start)]
        np.testing.assert_array_equal(
            np.frombuffer(unpacked(data, width=4), "<f4").reshape(6, 12),
            images[name]["slant_range"].values.astype(np.float32),
        )


def test_a_page_in_a_report_is_shut_in(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    evil = '"></iframe><script>alert(1)</script>'
    write_report(path, "title", [Interactive(evil, evil)])
    text = path.read_text()
    assert "<script>" not in text
    assert 'sandbox="allow-scripts allow-downloads"' in text


def test_large_images_are_left_to_the_server(
    target: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = imaging.range_image(target, polarization="VV")
    parts = image_report.interactive({"small": image})
    assert isinstance(parts[0], Interactive)
    monkeypatch.setattr(image_report, "_LARGEST_IN_REPORT", 10)
    (part,) = image_report.interactive({"large": image})
    assert "amulor view shows it" in part.text


@pytest.mark.slow
def test_saving_needs_no_package_of_the_extra() -> None:
    program = (
        "import sys; from amulor.view import page; page.saved_page; page.recording_of; "
        "assert not {'uvicorn', 'starlette', 'websockets'} & {*sys.modules}"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
