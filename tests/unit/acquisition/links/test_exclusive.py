"""A device is driven by one scan at a time, whatever folders they write to."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.connect import connect
from amulor.acquisition.links import exclusive
from amulor.acquisition.rehearsal import rehearse
from amulor.errors import InstrumentError


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
        ("GPIB0::8::INSTR", "GPIB::8"),
        ("tcp://127.0.0.1:5000", "tcp://localhost:5000"),
        ("tcp://127.0.0.1:5000", "TCP://LocalHost:5000"),
        ("tcp://[::1]:5000", "TCPIP::127.0.0.1::5000::SOCKET"),
        ("TCPIP::10.0.0.5::INSTR", "TCPIP0::10.0.0.5::inst0::INSTR"),
        ("TCPIP::10.0.0.5::INSTR", "tcpip::10.0.0.5"),
        ("TCPIP::10.0.0.5::INSTR", "TCPIP::10.0.0.5::hislip0,4880::INSTR"),
        ("TCPIP::10.0.0.5::INSTR", "tcp://10.0.0.5:5025"),
        ("localhost:dev2006", "127.0.0.1:DEV2006"),
        ("USB0::0xB506::0x2000::002765::INSTR", "USB::46342::8192::002765::0::INSTR"),
        ("ASRL3::INSTR", "asrlCOM3::instr"),
        ("ASRL/dev/null::INSTR", "ASRL/dev/../dev/null::INSTR"),
    ],
)
def test_one_device_has_one_lock_however_it_is_written(first, second) -> None:
    lock = exclusive.hold(first)
    with pytest.raises(InstrumentError, match="driven by another scan"):
        exclusive.hold(second)
    lock.release()
    exclusive.hold(second).release()


def test_a_link_to_a_serial_port_is_the_port(tmp_path) -> None:
    link = tmp_path / "by-id"
    link.symlink_to("/dev/null")
    lock = exclusive.hold("ASRL/dev/null::INSTR")
    with pytest.raises(InstrumentError, match="driven by another scan"):
        exclusive.hold(f"ASRL{link}::INSTR")
    lock.release()


def test_an_alias_of_the_visa_library_is_its_resource(monkeypatch) -> None:
    class Manager:
        def resource_info(self, name):
            assert name == "my_lock_in"
            return SimpleNamespace(resource_name="GPIB0::8::INSTR")

    monkeypatch.setitem(sys.modules, "pyvisa", SimpleNamespace(ResourceManager=Manager))
    lock = exclusive.hold("my_lock_in")
    with pytest.raises(InstrumentError, match="driven by another scan"):
        exclusive.hold("GPIB::8::INSTR")
    lock.release()


def test_parts_of_one_file_may_share_a_device_by_two_addresses() -> None:
    lock = exclusive.hold("tcp://127.0.0.1:5000", "tcp://localhost:5000")
    with pytest.raises(InstrumentError, match="driven by another scan"):
        exclusive.hold("tcp://localhost:5000")
    lock.release()
    exclusive.hold("tcp://localhost:5000").release()


def test_a_refused_scan_keeps_no_lock() -> None:
    lock = exclusive.hold("GPIB0::8::INSTR")
    with pytest.raises(InstrumentError, match="driven by another scan"):
        exclusive.hold("GPIB0::7::INSTR", "GPIB0::8::INSTR")
    exclusive.hold("GPIB0::7::INSTR").release()
    lock.release()


def test_other_devices_are_free() -> None:
    locks = [
        exclusive.hold(address)
        for address in (
            "GPIB0::8::INSTR",
            "GPIB1::8::INSTR",
            "GPIB0::9::INSTR",
            "tcp://127.0.0.1:5000",
            "tcp://127.0.0.1:5001",
            "tcp://127.0.0.1:5025",
            "tcp://10.0.0.5:4001",
            "tcp://10.0.0.5:4002",
            "TCPIP::10.0.0.5::gpib0,8::INSTR",
            "TCPIP::10.0.0.5::INSTR",
            "localhost:dev2006",
            "localhost:dev2007",
            "ASRL3::INSTR",
            "ASRL4::INSTR",
        )
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
