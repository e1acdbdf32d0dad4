"""Draws docs/images/view: pictures of the page for docs/how-to/view.md.

    python docs/make_view_images.py [NAME ...]

Needs playwright and the Chromium of the system. Without names, all pictures are drawn.
`watch.png` is a picture of a terminal and stays.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from playwright.sync_api import sync_playwright

from amulor import (
    Survey,
    acquisition,
    handover,
    imaging,
    io,
    rejection,
    samples,
    simulation,
)
from amulor.cli import main
from amulor.cli.site import changes_between, opened
from amulor.imaging.observation import readable_survey
from amulor.view import page
from amulor.view.page import space
from amulor.view.page.sites import site_space

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "images" / "view"
SIZE = {"width": 1440, "height": 900}
#: Since Chromium 138 a page without a GPU draws only with the first two.
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
#: Part of the scan after which its picture is taken [1].
SHARE = 0.36

Content = Iterator[tuple[Any, dict[str, Any]]]


@contextmanager
def file(folder: Path) -> Content:
    """Target signal of a ladder in milky water."""
    target = rejection.open_water(samples.cube("ladder"))
    yield page.recording_of(target, name="ladder_milk_target_signal.nc"), {}


def measured(shown: Any) -> None:
    """Measure a distance by keyboard."""
    shown.click("#tools button[data-kind=distance]")
    shown.focus("#map")
    for key, times in (("ArrowLeft", 14), ("Enter", 1), ("ArrowRight", 28)):
        for _ in range(times):
            shown.keyboard.press(key)
    shown.keyboard.press("Enter")
    shown.wait_for_selector("#measurements li")


@contextmanager
def products(folder: Path) -> Content:
    """Range image of the ladder with the dialog of products."""
    with file(folder) as (recording, _):
        yield recording, {"products": handover.PageProducts()}


@contextmanager
def cloud(folder: Path) -> Content:
    """Point cloud of the ladder."""
    target = rejection.open_water(samples.cube("ladder"))
    image = imaging.range_image(target, polarization="VH")
    path = folder / "ladder_milk_VH.laz"
    io.write_cloud(imaging.point_cloud(image), path)
    yield space.opened(path), {}


@contextmanager
def mesh(folder: Path) -> Content:
    """Mesh of the amphora."""
    path = ROOT / "examples" / "amphora" / "amphora.ply"
    yield space.opened(path, unit=1.0), {}


@contextmanager
def deviation(folder: Path) -> Content:
    """Amphora against a model whose belly is dented by 4 mm."""
    example = ROOT / "examples" / "amphora"
    survey = Survey.from_toml(example / "amphora.toml")
    target = rejection.open_water(simulation.simulate(survey, rng=1))
    model = trimesh.load(example / "amphora.ply", process=False)
    place = np.asarray(model.vertices, dtype=float)
    away = np.linalg.norm(place - place[np.argmin(place[:, 2])], axis=1)
    place[:, 2] += 4e-3 * np.exp(-((away / 0.03) ** 2) / 2)
    model.vertices = place
    model.export(folder / "model.ply")
    recording = page.recording_of(imaging.range_image(target), name="amphora.nc")
    recording.against = handover.comparison(folder / "model.ply", unit="m")
    yield recording, {}


@contextmanager
def site(folder: Path) -> Content:
    """Wreck with two visits, between which an amphora moved."""
    script = ROOT / "examples" / "wreck" / "make_site.py"
    subprocess.run(
        [sys.executable, script.name, str(folder), "--rows", "120"],
        cwd=script.parent,
        check=True,
    )
    path, poses = folder / "site.toml", folder / "poses.json"
    if main(["site", "register", str(path), "-o", str(poses)]) != 0:
        sys.exit("the registration of the site failed")
    merged = opened(path, poses)
    change, *_ = changes_between(merged, ("2025", "2026"))
    yield site_space(merged.cloud, merged.registration, change=change), {}


def scan(folder: Path) -> Content:
    """Scan of the ladder, slow on its way until the picture is taken."""
    survey = readable_survey(samples.cube("ladder"))
    assert survey is not None
    return running(folder, survey, SHARE)


def vehicle(folder: Path) -> Content:
    """Scan of the amphora from a vehicle that is too fast."""
    example = ROOT / "examples" / "vehicle"
    survey = Survey.from_toml(example / "record.toml")
    settings = acquisition.Settings.from_toml(example / "devices.toml")
    return running(folder, survey, 0.7, settings=settings)


@contextmanager
def running(folder: Path, survey: Survey, share: float, **more: Any) -> Content:
    """Scan that is slow after a share of its samples, until the picture is taken."""
    reached, go_on = threading.Event(), threading.Event()

    def watched(now: acquisition.Progress) -> None:
        if now.done > share * now.total:
            reached.set()
            go_on.wait(0.15)

    thread = threading.Thread(
        target=acquisition.acquire,
        args=(survey, folder / "scan"),
        kwargs={"scene": simulation.scene_light, "progress": watched, **more},
    )
    thread.start()
    reached.wait(600)
    live = page.Live(folder / "scan")
    live.look()
    try:
        yield live, {}
    finally:
        go_on.set()
        live.stop()
        thread.join()


def key(*keys: str) -> Callable[[Any], None]:
    """Return a function that presses keys."""

    def press(shown: Any) -> None:
        for one in keys:
            shown.keyboard.press(one)

    return press


def upright(shown: Any) -> None:
    """Let the amphora stand upright."""
    shown.select_option("#up", "-y")


def significant(shown: Any) -> None:
    """Show significant deviations only."""
    shown.click("#tabs button[data-layer=significant]")


def ordered(shown: Any) -> None:
    """Open the dialog of products at the orthoimage."""
    shown.keyboard.press("x")
    shown.select_option("#product-kind", "orthoimage")


def traced(shown: Any) -> None:
    """Wait for the signals over time."""
    shown.wait_for_selector("html[data-traced]", state="attached")


def covered(shown: Any) -> None:
    """Wait for the lines that the vehicle has measured."""
    shown.wait_for_selector("html[data-lines]", state="attached")


#: Content of each picture, and what is done before it is taken.
PICTURES: dict[str, tuple[Any, Callable[[Any], None]]] = {
    "file": (file, measured),
    "products": (products, ordered),
    "cloud": (cloud, key()),
    "mesh": (mesh, upright),
    "deviation": (deviation, significant),
    "site": (site, key("t")),
    "scan": (scan, traced),
    "vehicle": (vehicle, covered),
}


def draw(browser: Any, name: str) -> None:
    """Open one content in the browser, and take its picture."""
    content, act = PICTURES[name]
    with (
        tempfile.TemporaryDirectory() as folder,
        content(Path(folder)) as (shown, options),
        page.background(shown, **options) as address,
    ):
        tab = browser.new_page(viewport=SIZE)
        tab.goto(address)
        tab.wait_for_selector("html[data-complete=yes]", timeout=120_000)
        act(tab)
        tab.wait_for_timeout(3000)
        tab.screenshot(path=FOLDER / f"{name}.png")
        tab.close()


if __name__ == "__main__":
    path = shutil.which("chromium")
    if path is None:
        sys.exit("needs chromium")
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=path, args=FLAGS)
        for name in sys.argv[1:] or PICTURES:
            draw(chromium, name)
        chromium.close()
