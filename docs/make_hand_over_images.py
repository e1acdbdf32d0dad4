"""Draws docs/images/hand-over and site: sheets of docs/how-to/hand-over.md and site.md.

Needs the Chromium of the system, which shows the SVG files.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib import image as pictures

from amulor.cli import main

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "how-to" / "hand-over.md"
FOLDER = ROOT / "docs" / "images" / "hand-over"
SITE = ROOT / "docs" / "images" / "site"
#: Part of the section with the amphora that moved [pixel].
AMPHORA = (395, 175, 550, 305)
#: Picture, the file that a command writes, and its size on screen.
PICTURES = {
    "amphora": ("amphora.svg", (820, 1150)),
    "ladder": ("ladder_heights.svg", (1150, 820)),
    "section": ("section.svg", (1150, 820)),
    "deviation": ("deviation.svg", (820, 1150)),
    "profile": ("profile.svg", (820, 1150)),
}


def commands() -> list[str]:
    """Return the commands of the page that make drawings, and what they need."""
    text = re.sub(r"\\\n *", "", PAGE.read_text("utf-8"))
    lines = re.findall(r"^\$ amulor (.+)$", text, flags=re.MULTILINE)
    needless = "archive", "report"
    return [
        line
        for line in lines
        if not line.startswith(needless) and "--project" not in line
    ]


def draw(browser: str) -> None:
    """Run the commands and take a picture of each drawing."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(ROOT / "examples" / "amphora", folder / "examples" / "amphora")
        with contextlib.chdir(folder):
            for line in commands():
                if main(line.split()) != 0:
                    sys.exit(f"failed: {line}")
        FOLDER.mkdir(parents=True, exist_ok=True)
        for picture, (file, size) in PICTURES.items():
            shot(browser, folder / file, size, FOLDER / f"{picture}.png")


def draw_site(browser: str) -> None:
    """Draw the wreck of the page on sites, and take pictures of plan and section."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        script = ROOT / "examples" / "wreck" / "make_site.py"
        words = [sys.executable, script.name, str(folder), "--rows", "75"]
        subprocess.run(words, cwd=script.parent, check=True)
        output = folder / "wreck.pdf"
        words = ["site", "drawings", str(folder / "site.toml"), "-o", str(output)]
        if main(words) != 0:
            sys.exit("the drawings of the site failed")
        SITE.mkdir(parents=True, exist_ok=True)
        shot(browser, folder / "wreck_plan.svg", (1150, 1600), SITE / "plan.png")
        svg = folder / "wreck_section_B.svg"
        shot(browser, svg, (1150, 820), SITE / "section.png", zoom=2)
        shot(browser, svg, (1150, 820), SITE / "detail.png", zoom=6, part=AMPHORA)


def shot(
    browser: str,
    svg: Path,
    size: tuple[int, int],
    picture: Path,
    *,
    zoom: int = 1,
    part: tuple[int, int, int, int] | None = None,
) -> None:
    """Write a picture of an SVG file, or a part of it, in a window of a size [pixel].

    The part is its left, upper, right and lower edge [pixel of the window].
    """
    target = svg.with_suffix(".shot.png")
    subprocess.run(
        [
            *(browser, "--headless", "--no-sandbox", "--hide-scrollbars"),
            f"--force-device-scale-factor={zoom}",
            f"--screenshot={target}",
            f"--window-size={size[0]},{size[1]}",
            svg.as_uri(),
        ],
        check=True,
        capture_output=True,
    )
    if part is None:
        _cropped(target, picture)
        return
    left, top, right, bottom = (zoom * edge for edge in part)
    pictures.imsave(picture, pictures.imread(target)[top:bottom, left:right])


def _cropped(source: Path, target: Path) -> None:
    """Write a picture without its empty rim."""
    pixels = pictures.imread(source)
    ink = np.any(pixels[..., :3] < 0.98, axis=-1)
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    top, left = max(rows[0] - 12, 0), max(columns[0] - 12, 0)
    pictures.imsave(target, pixels[top : rows[-1] + 12, left : columns[-1] + 12])


if __name__ == "__main__":
    found = shutil.which("chromium")
    if found is None:
        sys.exit("needs chromium")
    draw(found)
    draw_site(found)
