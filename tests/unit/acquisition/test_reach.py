"""A stage whose travel is too short refuses a scan before anything moves."""

from __future__ import annotations

import dataclasses
import math

import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.connect import connect
from amulor.errors import InstrumentError


class Limited:
    """A device that takes note of where it is asked to reach, and may refuse."""

    def __init__(self, device: object, *, refuses: bool = False) -> None:
        self._device, self._refuses = device, refuses
        self.asked: tuple[object, ...] | None = None

    def __getattr__(self, name: str) -> object:
        return getattr(self._device, name)

    def refuse_beyond_reach(self, *places: object) -> None:
        self.asked = places
        if self._refuses:
            raise InstrumentError("the axis goes from -1 to 1")


def test_all_directions_angles_and_places_are_asked_for(
    small, settings, folder
) -> None:
    plain = connect(small, settings, scene=scene_light)
    devices = dataclasses.replace(
        plain,
        scanner=Limited(plain.scanner),
        analyser=Limited(plain.analyser),
        target=Limited(plain.target),
    )
    acquisition.acquire(small, folder, settings=settings, devices=devices)
    azimuth, elevation = devices.scanner.asked
    half = small.scan.azimuth_span / 2, small.scan.elevation_span / 2
    assert azimuth == pytest.approx([-half[0], half[0]])
    assert elevation == pytest.approx([-half[1], half[1]])
    assert devices.analyser.asked == ([0.0, math.pi / 2],)
    assert devices.target.asked == ()


def test_a_scan_out_of_reach_is_refused_before_light_and_motion(
    small, settings, folder, safe
) -> None:
    plain = connect(small, settings, scene=scene_light)
    devices = dataclasses.replace(plain, scanner=Limited(plain.scanner, refuses=True))
    with pytest.raises(InstrumentError, match="from -1 to 1"):
        acquisition.acquire(small, folder, settings=settings, devices=devices)
    assert "on" not in plain.laser.log
    assert "move" not in plain.scanner.log
    assert safe(plain)


def test_a_target_that_stays_is_not_asked_where_it_could_go(
    small, settings, folder
) -> None:
    survey = small.with_({"scan.open_water": None})
    plain = connect(survey, settings, scene=scene_light)
    devices = dataclasses.replace(plain, target=Limited(plain.target, refuses=True))
    done = acquisition.acquire(survey, folder, settings=settings, devices=devices)
    assert done.finished
