"""A device is driven by one scan at a time, whatever folders they write to."""

from __future__ import annotations

import subprocess
import sys

import pytest

from amulor import acquisition
from amulor.acquisition.connect import connect
from amulor.acquisition.links import exclusive
from amulor.acquisition.rehearsal import rehearse
from amulor.errors import InstrumentError
from amulor.simulation import scene_light


@pytest.fixture(autouse=True)
def own_locks(tmp_path, monkeypatch):
    """Let locks be in a folder of their own."""
    monkeypatch.setattr(exclusive, "lock_folder", lambda: tmp_path / "locks")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("tcp://10.0.0.5:50000", "tcp://10.0.0.5:50000"),
        ("tcp://10.0.0.5:50000", "TCPIP0::10.0.0.5::50000::SOCKET"),
        ("TCPIP::10.0.0.5::50000::SOCKET", "tcpip0::10.0.0.5::50000::socket"),
        ("GPIB0::8::INSTR", "gpib::8::INSTR"),
    ],
)
def test_one_device_has_one_lock_however_it_is_written(first, second) -> None:
    lock = exclusive.hold(first)
    with pytest.raises(InstrumentError, match="driven by another scan"):
        exclusive.hold(second)
    lock.release()
    exclusive.hold(second).release()


def test_other_devices_are_free() -> None:
    locks = [
        exclusive.hold(address)
        for address in ("GPIB0::8::INSTR", "GPIB1::8::INSTR", "GPIB0::9::INSTR")
    ]
    for lock in locks:
        lock.release()


KILLED = """
import os, signal, sys
from pathlib import Path
from amulor.acquisition.links import exclusive

exclusive.lock_folder = lambda: Path(sys.argv[1])
lock = exclusive.hold("GPIB0::8::INSTR")
print("held", flush=True)
sys.stdin.read()
"""


@pytest.mark.slow
def test_the_lock_of_a_killed_program_is_gone(tmp_path) -> None:
    other = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path / "locks")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with other:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(InstrumentError, match="driven by another scan"):
            exclusive.hold("GPIB0::8::INSTR")
        other.kill()
    exclusive.hold("GPIB0::8::INSTR").release()


def test_a_lock_that_cannot_be_made_says_so(tmp_path) -> None:
    (tmp_path / "locks").write_text("a file, and no folder")
    with pytest.raises(InstrumentError, match=r"cannot be locked.*permissions"):
        exclusive.hold("GPIB0::8::INSTR")


def test_a_second_scan_in_another_folder_touches_no_device(
    small, settings, folder
) -> None:
    with rehearse(small, settings, speed=1000, scene=scene_light) as rehearsal:
        devices = connect(small, rehearsal.settings)
        devices.laser.on()
        said = len(rehearsal.lock_in.lines), len(rehearsal.stages.lines)
        with pytest.raises(InstrumentError, match="driven by another scan"):
            acquisition.acquire(small, folder / "b", settings=rehearsal.settings)
        assert rehearsal.bench.laser_on
        assert (len(rehearsal.lock_in.lines), len(rehearsal.stages.lines)) == said
        devices.make_safe()
        devices.close()
        # Then it may.
        connect(small, rehearsal.settings).close()


def test_a_scan_that_fails_to_connect_lets_go(small, settings) -> None:
    with rehearse(small, settings, speed=1000, scene=scene_light) as rehearsal:
        content = rehearsal.settings.model_dump(exclude_unset=True)
        content["scanner"]["azimuth_axis"] = "9"
        wrong = type(settings).model_validate(content)
        with pytest.raises(InstrumentError):
            connect(small, wrong)
        connect(small, rehearsal.settings).close()
