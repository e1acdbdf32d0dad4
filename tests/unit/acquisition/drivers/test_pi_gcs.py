"""Stages as conversations: the lines sent and the lines answered."""

from __future__ import annotations

import math

import pytest
from numpy.testing import assert_allclose

from amulor.acquisition import clock as clock_module
from amulor.acquisition.clock import RealClock
from amulor.acquisition.drivers.pi_gcs import (
    PiController,
    PiMount,
    PiScanner,
    PiTargetStage,
)
from amulor.acquisition.settings import ScannerSettings, TargetSettings
from amulor.errors import InstrumentError

IDN = ("*IDN?", ["(c)2015 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC, 1, 1.0"])
ENABLE = [("SVO 1 1 2 1", []), ("ERR?", ["0"]), ("FRF? 1 2", ["1=1 ", "2=1"])]
#: A halt, and the answer that nothing moves any more.
HALT = [("HLT", []), ("ERR?", ["10"]), ("\x05", ["0"])]


@pytest.fixture
def controller(script, clock):
    """Return a controller with two enabled axes and the script behind it."""
    link = script(IDN, *ENABLE)
    found = PiController(link, clock=clock)
    found.enable(["1", "2"])
    assert not link.turns
    return found, link


def test_a_move_waits_until_both_axes_are_on_target(controller, clock) -> None:
    stage, link = controller
    link.extend(
        ("MOV 1 1.5000000 2 -0.2500000", []),
        ("ONT? 1 2\nPOS? 1 2", ["1=0 ", "2=1", "1=0", "2=0"]),
        ("ONT? 1 2\nPOS? 1 2", ["1=1 ", "2=1", "1=1.5001 ", "2=-0.2499"]),
    )
    assert stage.move({"1": 1.5, "2": -0.25}, timeout=1.0) == [1.5001, -0.2499]
    assert clock.now() > 0


def test_a_move_that_never_ends_is_given_up(controller) -> None:
    stage, link = controller
    # Looks after 0, 0.2, 0.6, 1.4 and 3 ms, and every 2 ms from then on.
    link.extend(
        ("MOV 1 5.0000000", []),
        *[("ONT? 1\nPOS? 1", ["1=0", "1=0"])] * 54,
        ("ERR?", ["0"]),
    )
    with pytest.raises(InstrumentError, match=r"not on target 0\.1 s after MOV"):
        stage.move({"1": 5.0}, timeout=0.1)


def test_a_refused_move_is_told_by_its_error(controller) -> None:
    stage, link = controller
    # Out of limits the controller does not move at all and stays "on target".
    link.extend(
        ("MOV 1 999.0000000", []),
        ("ONT? 1\nPOS? 1", ["1=1", "1=0.0"]),
        ("ERR?", ["7"]),
    )
    with pytest.raises(InstrumentError, match="error 7"):
        stage.move({"1": 999.0}, timeout=1.0)


def test_an_axis_that_is_lost_is_not_moved(script, clock) -> None:
    link = script(IDN, ("SVO 3 1", []), ("ERR?", ["0"]), ("FRF? 3", ["3=0"]))
    with pytest.raises(InstrumentError, match=r"reference it \(FRF 3\)"):
        PiMount(PiController(link, clock=clock), "3")
    assert not link.turns


def test_angles_are_turned_into_the_units_of_the_axes(script, clock) -> None:
    settings = ScannerSettings(
        driver="pi_gcs", address="x", angle_per_unit=-0.002, azimuth_zero=10.0
    )
    link = script(IDN, *ENABLE)
    scanner = PiScanner(PiController(link, clock=clock), settings)
    link.extend(
        ("MOV 1 5.0000000 2 -2.0000000", []),
        ("ONT? 1 2\nPOS? 1 2", ["1=1 ", "2=1", "1=5.001 ", "2=-2.001"]),
    )
    azimuth, elevation = scanner.move(0.01, 0.004, timeout=1.0)
    assert_allclose([azimuth, elevation], [0.009998, 0.004002], atol=1e-12)
    link.extend(*HALT)
    scanner.make_safe()
    assert not link.turns


def test_a_scanner_is_parked_where_it_is_to_be_left(script, clock) -> None:
    settings = ScannerSettings(
        driver="pi_gcs", address="x", angle_per_unit=1.0, park_azimuth=0.5,
        park_elevation=-1.0,
    )  # fmt: skip
    link = script(IDN, *ENABLE)
    scanner = PiScanner(PiController(link, clock=clock), settings)
    link.extend(
        *HALT, ("MOV 1 0.5000000 2 -1.0000000", []),
        ("ONT? 1 2\nPOS? 1 2", ["1=1 ", "2=1", "1=0.5 ", "2=-1.0"]),
    )  # fmt: skip
    scanner.make_safe()
    assert not link.turns


def test_a_mount_counts_in_degrees_and_a_target_in_millimetres(script, clock) -> None:
    link = script(
        IDN, ("SVO 3 1", []), ("ERR?", ["0"]), ("FRF? 3", ["3=1"]),
        ("MOV 3 90.0000000", []), ("ONT? 3\nPOS? 3", ["3=1", "3=90.001"]),
        ("SVO 5 1", []), ("ERR?", ["0"]), ("FRF? 5", ["5=1"]),
        ("MOV 5 200.0000000", []), ("ONT? 5\nPOS? 5", ["5=1", "5=200"]),
        ("MOV 5 0.0000000", []), ("ONT? 5\nPOS? 5", ["5=1", "5=0"]),
    )  # fmt: skip
    stage = PiController(link, clock=clock)
    found = PiMount(stage, "3").rotate(math.pi / 2, timeout=1.0)
    assert_allclose(found, math.radians(90.001))
    target = PiTargetStage(stage, TargetSettings(driver="pi_gcs", address="x"))
    target.take_out(timeout=1.0)
    target.bring_in(timeout=1.0)
    assert not link.turns


def test_garbled_positions_are_no_positions(controller) -> None:
    stage, link = controller
    link.extend(("MOV 1 1.0000000", []), ("ONT? 1\nPOS? 1", ["1=1", "2=1.0"]))
    with pytest.raises(InstrumentError, match="needed is a value for each of 1"):
        stage.move({"1": 1.0}, timeout=1.0)


def test_a_stop_is_tried_over_a_new_link(script, clock) -> None:
    class Lost(script):
        def send(self, line: str) -> None:
            if not self.reopened:
                raise InstrumentError("the link is lost")
            super().send(line)

    link = Lost(IDN, *HALT)
    PiController(link, clock=clock).stop()
    assert link.reopened == 1
    assert not link.turns


def test_what_does_not_come_to_rest_is_stopped_abruptly(controller, clock) -> None:
    stage, link = controller
    link.extend(
        ("HLT", []), ("ERR?", ["10"]), *[("\x05", ["2"])] * 1001,
        ("STP", []), ("ERR?", ["10"]),
    )  # fmt: skip
    stage.stop()
    assert not link.turns
    assert clock.now() == pytest.approx(2.0, abs=0.01)
    # A controller that knows no HLT, and one whose answer is none.
    link.extend(("HLT", []), ("ERR?", ["2"]), ("STP", []), ("ERR?", ["10"]))
    stage.stop()
    link.extend(*HALT[:2], ("\x05", ["?"]), ("STP", []), ("ERR?", ["10"]))
    stage.stop()
    assert not link.turns


def test_another_instrument_is_not_moved(script, clock) -> None:
    link = script(("*IDN?", ["Stanford_Research_Systems,SR844,s/n1,ver1"]))
    with pytest.raises(InstrumentError, match="needed is a controller of Physik"):
        PiController(link, clock=clock)


def test_a_scan_beyond_the_travel_is_refused_before_a_move(script, clock) -> None:
    settings = ScannerSettings(
        driver="pi_gcs", address="x", angle_per_unit=0.01, azimuth_zero=2.0
    )
    link = script(IDN, *ENABLE)
    scanner = PiScanner(PiController(link, clock=clock), settings)
    travel = [("TMN? 1 2", ["1=-5 ", "2=-5"]), ("TMX? 1 2", ["1=5 ", "2=5"])]
    link.extend(*travel)
    scanner.refuse_beyond_reach([-0.07, 0.03], [-0.05, 0.05])
    link.extend(*travel)
    with pytest.raises(InstrumentError, match=r"axis 1 .* -5 to 5, .* -5 to 5\.1 "):
        scanner.refuse_beyond_reach([-0.07, 0.031], [-0.05, 0.05])
    assert not link.turns


def test_where_it_is_parked_belongs_to_the_travel(script, clock) -> None:
    settings = ScannerSettings(
        driver="pi_gcs", address="x", angle_per_unit=0.01, park_azimuth=0.0,
        park_elevation=-0.2,
    )  # fmt: skip
    link = script(IDN, *ENABLE)
    scanner = PiScanner(PiController(link, clock=clock), settings)
    link.extend(("TMN? 1 2", ["1=-5 ", "2=-5"]), ("TMX? 1 2", ["1=5 ", "2=5"]))
    with pytest.raises(InstrumentError, match=r"axis 2 .* needs -20 to 1 "):
        scanner.refuse_beyond_reach([0.0], [0.01])


@pytest.mark.parametrize("kind", ["mount", "target"])
def test_a_place_that_was_not_reached_is_no_place(script, clock, kind) -> None:
    link = script(IDN, ("SVO 5 1", []), ("ERR?", ["0"]), ("FRF? 5", ["5=1"]))
    stage = PiController(link, clock=clock)
    if kind == "mount":
        mount = PiMount(stage, "5")
        link.extend(("MOV 5 90.0000000", []), ("ONT? 5\nPOS? 5", ["5=1", "5=89"]))
        link.extend(("ERR?", ["0"]))
        with pytest.raises(InstrumentError, match="at 89 and was sent to 90"):
            mount.rotate(math.pi / 2, timeout=1.0)
    else:
        target = PiTargetStage(stage, TargetSettings(driver="pi_gcs", address="x"))
        link.extend(("MOV 5 200.0000000", []), ("ONT? 5\nPOS? 5", ["5=1", "5=190"]))
        link.extend(("ERR?", ["0"]))
        with pytest.raises(InstrumentError, match="at 190 and was sent to 200"):
            target.take_out(timeout=1.0)
    assert not link.turns


class Wall:
    """A wall clock that goes on when it is told, however busy the machine is."""

    def __init__(self) -> None:
        self.shown = 0.0

    def monotonic(self) -> float:
        return self.shown

    def sleep(self, duration: float) -> None:
        self.shown += duration


def test_a_fast_clock_leaves_time_for_the_wire(script, monkeypatch) -> None:
    wall = Wall()
    monkeypatch.setattr(clock_module, "time", wall)
    # At a thousand times the speed 30 s are 30 ms, less than a slow answer may take.
    fast = RealClock(1000.0)

    class Slow(script):
        def ask(self, line: str, *, answers: int = 1) -> list[str]:
            wall.sleep(0.05)
            return super().ask(line, answers=answers)

    link = Slow(IDN, ("MOV 1 1.0000000", []))
    link.extend(
        *[("ONT? 1\nPOS? 1", ["1=0", "1=0"])] * 4, ("ONT? 1\nPOS? 1", ["1=1", "1=1"])
    )
    assert PiController(link, clock=fast).move({"1": 1.0}, timeout=30.0) == [1.0]
    # But not for ever: two seconds on the wall are over after 40 answers.
    link = Slow(IDN, ("MOV 1 1.0000000", []))
    link.extend(*[("ONT? 1\nPOS? 1", ["1=0", "1=0"])] * 50)
    link.turns.insert(42, ("ERR?", ["0"]))
    with pytest.raises(InstrumentError, match="not on target 30 s after MOV"):
        PiController(link, clock=fast).move({"1": 1.0}, timeout=30.0)
    assert len(link.turns) == 10
