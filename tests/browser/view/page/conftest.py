"""A browser, and pages that it may look at; both skip where there is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import skips
from pages import settled

from amulor import rejection
from amulor.simulation import simulate
from amulor.survey import Survey
from amulor.view import page

#: Since Chromium 138 a page without a GPU draws only with the first two.
FLAGS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
    "--disable-background-networking",
    "--disable-quic",
    # The processor draws the page itself in less time than SwiftShader does.
    "--disable-gpu-compositing",
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return a Chromium with software graphics; tests after it may run event loops."""
    path = skips.need_browser()
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=path, args=[*FLAGS])
        yield found
        found.close()


class Tab:
    """A page in the browser, what it complained of, and what it asked for."""

    def __init__(self, browser: Any, **options: Any) -> None:
        self.page = browser.new_page(**options)
        # A busy machine is no failure of the page.
        self.page.set_default_timeout(90_000)
        self.errors: list[str] = []
        self.asked: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on(
            "console",
            lambda said: (
                self.errors.append(said.text) if said.type == "error" else None
            ),
        )
        self.page.on("request", lambda request: self.asked.append(request.url))

    def open(self, address: str) -> Any:
        """Open an address and wait until all of it is drawn."""
        self.page.goto(address)
        self.page.wait_for_selector("html[data-complete=yes]", timeout=60_000)
        settled(self.page)
        return self.page


@pytest.fixture
def tab(browser: Any) -> Iterator[Callable[..., Tab]]:
    """Return what opens tabs; they are closed at the end."""
    made: list[Tab] = []

    def new(**options: Any) -> Tab:
        made.append(
            Tab(browser, **{"viewport": {"width": 1440, "height": 900}, **options})
        )
        return made[-1]

    yield new
    for one in made:
        one.page.close()


@pytest.fixture(scope="session")
def steps() -> page.Recording:
    """Return a board 60 mm before a wall in clear water, 24 x 40 pixels."""
    survey = Survey.from_text(STEPS)
    return page.recording_of(
        rejection.open_water(simulate(survey, rng=3)), name="steps.nc"
    )


STEPS = """
name = "Board before a wall"
[water]
absorption = "0.05 1/m"
scattering = "0.05 1/m"
forward_fraction = 1.0
second_moment = "0.06 rad^2"
phase_function_at_180 = "0.001 1/sr"
refractive_index = 1.34
group_index = 1.36
signal_fluctuation = "1 %"
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "1.5 m"]
width = "60 cm"
height = "60 cm"
reflectance = 0.1
[[targets]]
kind = "plate"
position = ["-15 cm", "0 m", "1.44 m"]
width = "30 cm"
height = "60 cm"
reflectance = 0.1
[instrument]
phase_uncertainty = "0 deg"
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = ["60 MHz", "90 MHz"]
polarizations = ["none"]
[instrument.receiver]
position = ["7 cm", "0 m", "0 m"]
azimuth = "-2.672 deg"
radius = "2 cm"
acceptance = "0.3 rad"
[instrument.detector]
optical_transmission = "10 %"
[instrument.lock_in]
time_constant = "10 ms"
phase_floor = "0.03 deg"
[scan]
columns = 40
rows = 24
azimuth_span = "8 deg"
elevation_span = "4.8 deg"
dwell = "125 ms"
[scan.open_water]
columns = 5
rows = 3
repeats = 8
"""
