"""A round object gets its axis, diameters and half-profile in the page."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pages import drag, settled

from amulor import rejection, samples
from amulor.view import page

pytestmark = pytest.mark.slow


def test_the_amphora_has_the_diameter_of_its_model(tab: Callable[..., Any]) -> None:
    target = rejection.open_water(samples.cube("amphora"), interval=(1.2, 1.8))
    recording = page.recording_of(target, name="a.nc", interval=(1.2, 1.8))
    with page.background(recording) as address:
        opened = tab()
        shown = opened.open(address)
        shown.click("#tools button[data-kind=profile]")
        drag(shown, (6, 4), (76, 44))
        shown.wait_for_selector("#measurements li")
        settled(shown)
        found = shown.evaluate("amulor.measurements[0].found")
        lines = {line["label"]: line for line in found["lines"]}
        # The largest diameter of examples/amphora/amphora.ply is 145.8 mm.
        widest = lines["largest diameter"]
        assert widest["value"] == pytest.approx(0.1458, abs=1.5e-3)
        assert 0 < widest["uncertainty"] < 1e-3
        assert lines["rim diameter"]["value"] < widest["value"]
        assert found["left_out"] > 10
        # The amphora stands upright.
        assert lines["tilt of the axis"]["value"] < math.radians(5)
        # The drawing is that of a profile with as many heights as radii.
        profile = found["profile"]
        assert np.all(np.diff(profile["height"]) > 0)
        assert 2 * max(profile["radius"]) == pytest.approx(widest["value"])
        entry = shown.locator("#measurements li").first
        assert entry.locator("canvas.half").count() == 1
        assert "rim diameter" in entry.inner_text()
        label = entry.locator("canvas.half").get_attribute("aria-label")
        assert label is not None
        assert "largest diameter" in label
        assert opened.errors == []
