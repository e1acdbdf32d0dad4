"""Links over PyVISA and over a plain socket answer, time out and come back alike."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest
from shared_light import scene_light

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import connect, open_link, simulated_bench
from amulor.acquisition.links.lines import Link
from amulor.acquisition.links.tcp import DeviceServer, LinkLostError
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.pi import SimulatedPiController
from amulor.errors import InstrumentError, MissingExtraError


class Echo:
    """Answers every question by itself, but for a few words."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def answer(self, line: str) -> list[str]:
        self.lines.append(line)
        if line == "mute?":
            return []
        if line == "hang up":
            raise LinkLostError
        if line == "two?":
            return ["first ", "second"]
        return [line] if line.endswith("?") else []


@contextlib.contextmanager
def linked(kind: str, *, timeout: float) -> Iterator[tuple[Any, Echo]]:
    """Return a link of a kind to an echo, and the echo."""
    if kind == "visa":
        pytest.importorskip("pyvisa_py", reason="PyVISA-py is not installed")
    echo = Echo()
    with DeviceServer(echo) as server:
        address = server.address if kind == "tcp" else server.visa_name
        found = open_link(address, timeout=timeout)
        yield found, echo
        found.close()
        found.close()


@pytest.fixture(params=["tcp", "visa"])
def link(request):
    """Return a link that waits long, also where the machine is busy."""
    with linked(request.param, timeout=60.0) as found:
        yield found


def test_questions_are_answered_in_order(link) -> None:
    found, echo = link
    found.send("a word")
    assert found.ask("one?") == ["one?"]
    assert found.ask("MOV\ntwo?\nthree?", answers=3) == ["first", "second", "three?"]
    assert echo.lines == ["a word", "one?", "MOV", "two?", "three?"]


@pytest.mark.parametrize("kind", ["tcp", "visa"])
def test_silence_is_an_error_after_the_stated_time(kind) -> None:
    with linked(kind, timeout=0.3) as (found, _):
        start = time.monotonic()
        with pytest.raises(InstrumentError, match=r"answered 'mute\?' within 0.3 s"):
            found.ask("mute?")
        # Not before; how much later is for the machine to say.
        assert 0.25 < time.monotonic() - start < 60


@pytest.mark.parametrize("kind", ["tcp", "visa"])
def test_a_lost_link_is_an_error_and_can_be_opened_again(kind) -> None:
    # PyVISA-py does not see that the other end is gone, and waits.
    with linked(kind, timeout=0.3) as (found, _):
        with pytest.raises(InstrumentError, match="check cable and power"):
            found.ask("hang up")
        found._timeout = 60.0
        found.reopen()
        assert found.ask("one?") == ["one?"]


def test_a_closed_link_is_not_used(link) -> None:
    found, _ = link
    found.close()
    with pytest.raises(InstrumentError, match="is closed"):
        found.send("a word")


@pytest.mark.parametrize("kind", ["tcp", "visa"])
def test_nobody_at_an_address_is_an_error(kind) -> None:
    if kind == "visa":
        pytest.importorskip("pyvisa_py", reason="PyVISA-py is not installed")
    with DeviceServer(Echo()) as server:
        gone = server.address if kind == "tcp" else server.visa_name
    # PyVISA-py opens a socket that nobody answers without a word; the first question
    # tells.
    with pytest.raises(InstrumentError, match=r"check (address|cable)"):
        open_link(gone, timeout=2.0).ask("*IDN?")


@pytest.mark.parametrize("address", ["tcp://nowhere", "tcp://:5", "tcp://a:b"])
def test_what_is_no_address_is_told(address) -> None:
    with pytest.raises(InstrumentError, match="needed is tcp://host:port"):
        open_link(address, timeout=0.3)


def test_pyvisa_is_asked_for_by_its_extra(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvisa", None)
    with pytest.raises(MissingExtraError, match=r"amulor\[acquire\]"):
        Link.open("GPIB0::8::INSTR", timeout=1.0)


def test_simulated_stages_survive_nonsense(small) -> None:
    settings = Settings()
    bench = simulated_bench(small, settings, clock=VirtualClock(), scene=scene_light)
    stages = SimulatedPiController(bench, settings)
    for line in ("", "MOV 1 far", "MOV 1", "MOV", "POS? 77", "jump"):
        assert stages.answer(line) == []
        assert stages.answer("ERR?") == [stages_error(line)]
    assert stages.answer("POS? 1") == ["1=0.0000000"]


def stages_error(line: str) -> str:
    """Return the code that the manual gives: none, syntax, axis, or command."""
    return {"": "0", "POS? 77": "15", "jump": "2"}.get(line, "1")


def test_a_rehearsal_is_wired_as_its_simulators_are(small) -> None:
    own = Settings.model_validate({"laser": {"output": 3, "on_voltage": 1.0}})
    with rehearse(small, own, scene=scene_light) as rehearsal:
        devices = connect(small, rehearsal.settings)
        devices.laser.on()
        assert rehearsal.bench.laser_on
        devices.laser.off()
        assert not rehearsal.bench.laser_on
        # What no output and no value is called is an error of execution.
        for line in ("AUXO 9,x", "AUXO? 9", "SNAP? 77"):
            assert rehearsal.lock_in.answer(line) == []
            assert rehearsal.lock_in.answer("*ESR?") == ["16"]
        devices.close()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ({"speed": 0.0}, "speed must be above 0"),
        ({"speed": float("inf")}, "speed must be above 0"),
        ({"ports": (99999, 0, 0)}, "ports must be from 1 to 65535"),
    ],
)
def test_a_rehearsal_that_cannot_be_is_refused(small, words, text) -> None:
    with (
        pytest.raises(ValueError, match=text),
        rehearse(small, **words, scene=scene_light),
    ):
        pass


def test_simulated_devices_without_a_scene_are_refused(small, settings) -> None:
    with pytest.raises(InstrumentError, match=r"scene=amulor\.simulation\.scene_light"):
        connect(small, settings)
