"""Pan-tilt heads by Pelco-D: the bytes of the protocol, the simulated head, a scan."""

from __future__ import annotations

import math
import os
import threading

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.drivers.pelco_d import PelcoHead, frame
from amulor.acquisition.links.lines import OctetLink
from amulor.acquisition.links.tcp import DeviceServer
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import ScannerSettings, Settings
from amulor.acquisition.simulated.pelco_head import SPEED, SimulatedPelcoHead
from amulor.errors import InstrumentError

HEAD = {"driver": "pelco_d", "address": "tcp://10.0.0.5:4001"}


class Wire:
    """Both directions of a line, one byte at a time, and what else is heard on it."""

    address = "a wire"

    def __init__(self, head: SimulatedPelcoHead | None, *, before: bytes = b"") -> None:
        self.head, self.before = head, before
        self.cutter = head.cutter() if head else None
        self.sent: list[bytes] = []
        self.left, self.reopened, self.broken = b"", 0, False

    def send(self, content: bytes) -> None:
        if self.broken:
            raise InstrumentError("the link is lost")
        self.sent.append(content)
        if self.head:
            for one in self.cutter.split(content):
                answers = b"".join(self.head.answer(one))
                self.left += self.before * bool(answers) + answers

    def receive(self, most: int) -> bytes:
        if not self.left:
            raise InstrumentError("nothing has come")
        found, self.left = self.left[:1], self.left[1:]
        return found

    def forget(self) -> None:
        self.left = b""

    def reopen(self) -> None:
        self.broken, self.reopened = False, self.reopened + 1

    def close(self) -> None:
        pass


@pytest.fixture
def bench(small, clock: VirtualClock):
    return simulated_bench(small, Settings(), scene=scene_light, clock=clock)


def test_frames_are_those_of_published_lists() -> None:
    # Common lists of commands, written out: stop, right at speed 32, preset 1.
    assert frame(1, 0x00).hex() == "ff010000000001"
    assert frame(1, 0x02, 0x2000).hex() == "ff010002200023"
    assert frame(1, 0x07, 0x0001).hex() == "ff010007000109"
    # The sum leaves out what goes beyond a byte: 2 + 0x4B + 0x8C + 0x9F = 0x178.
    assert frame(2, 0x4B, 0x8C9F).hex() == "ff02004b8c9f78"


def test_a_head_goes_where_it_is_sent(bench, clock) -> None:
    # Acknowledgements and what another head says come in between.
    noise = bytes.fromhex("ff 07 00 59 11 22 93 ff")
    wire = Wire(SimulatedPelcoHead(bench), before=noise)
    settings = ScannerSettings(**HEAD, azimuth_zero=10.0)
    head = PelcoHead(wire, settings, clock=clock)
    began = clock.now()
    across, up = head.move(math.radians(-25), math.radians(12), timeout=30.0)
    assert math.degrees(across) == pytest.approx(-25, abs=0.0101)
    assert math.degrees(up) == pytest.approx(12, abs=0.0101)
    # Pan -25 of a zero at 10 is 345 degrees; up is 348, since tilt counts down.
    assert frame(1, 0x4B, 34_500) in wire.sent
    assert frame(1, 0x4D, 34_800) in wire.sent
    assert math.degrees(bench.place("azimuth")) == pytest.approx(-15, abs=1e-3)
    assert math.degrees(bench.place("elevation")) == pytest.approx(12, abs=1e-3)
    # It waited for the longer way: 15 degrees of pan.
    took = clock.now() - began
    assert math.radians(15) / SPEED < took < math.radians(15) / SPEED + 0.2
    other = ScannerSettings(
        **HEAD, pan_tilt={"pan_counts": "left", "tilt_counts": "up"}
    )
    mirrored = PelcoHead(wire, other, clock=clock)
    assert np.degrees(mirrored.move(math.radians(5), 0.0, timeout=9.0)) == (
        pytest.approx([5, 0], abs=0.0101)
    )
    assert frame(1, 0x4B, 35_500) in wire.sent


def test_a_head_that_is_held_up_is_told(bench, clock) -> None:
    wire = Wire(SimulatedPelcoHead(bench))
    head = PelcoHead(wire, ScannerSettings(**HEAD), clock=clock)
    # Its limit stop is at 90 degrees.
    with pytest.raises(InstrumentError, match="stands at 270 degrees and was sent to"):
        head.move(0.0, math.radians(95), timeout=30.0)
    settings = ScannerSettings(
        **HEAD,
        pan_tilt={"lowest_tilt": -math.pi / 3, "highest_tilt": math.pi / 3},
    )
    head = PelcoHead(wire, settings, clock=clock)
    head.refuse_beyond_reach([-3.0, 3.0], [-1.0, 1.0])
    with pytest.raises(InstrumentError, match=r"goes from -60 to 60 degrees in tilt"):
        head.refuse_beyond_reach([0.0], [0.0, 1.1])
    bench.faults = type(bench.faults).parse(["stuck@0x9999"])
    head.move(0.0, math.radians(90), timeout=30.0)
    began = clock.now()
    with pytest.raises(InstrumentError, match="pan of the head at a wire stands at 0"):
        head.move(math.radians(40), math.radians(90), timeout=30.0)
    assert clock.now() - began < 5


def test_answers_that_are_none_are_told(bench, clock) -> None:
    with pytest.raises(InstrumentError, match="nothing has come"):
        PelcoHead(
            Wire(SimulatedPelcoHead(bench, 2)), ScannerSettings(**HEAD), clock=clock
        )

    class Says(Wire):
        def send(self, content: bytes) -> None:
            self.left = bytes.fromhex(self.text) * 12

    wire = Says(None)
    wire.text = "ff 01 00 59 10 00 6b"  # the sum is 6a
    with pytest.raises(InstrumentError, match="not the sum of those before"):
        PelcoHead(wire, ScannerSettings(**HEAD), clock=clock)
    wire.text = "ff 01 00 5b 10 00 6c"  # tilt, although pan was asked for
    with pytest.raises(InstrumentError, match="no head with the number 1 that tells"):
        PelcoHead(wire, ScannerSettings(**HEAD), clock=clock)


def test_a_head_is_stopped_over_a_new_link_if_need_be(bench, clock) -> None:
    wire = Wire(SimulatedPelcoHead(bench))
    head = PelcoHead(wire, ScannerSettings(**HEAD), clock=clock)
    bench.send({"azimuth": 1.0}, speed=SPEED)
    wire.broken = True
    head.make_safe()
    assert wire.reopened == 1
    clock.sleep(30.0)
    assert bench.place("azimuth") == 0.0


def test_steps_finer_than_the_head_has_are_refused() -> None:
    with pytest.raises(ValueError, match=r"counts in 0\.01 degrees"):
        Settings.model_validate(
            {
                "lock_in": {"driver": "sr844", "address": "a"},
                "laser": {"driver": "lock_in_output"},
                "scanner": HEAD,
                "launch": {"driver": "none"},
                "analyser": {"driver": "none"},
                "target": {"driver": "operator"},
            }
        )


def test_a_scan_by_a_head_over_a_network(small, folder, cube_of) -> None:
    base = Settings.model_validate(
        {"procedure": {"dark_readings": 1, "position_tolerance": math.radians(0.02)}}
    )
    with rehearse(small, base, scene=scene_light, speed=500) as rehearsal:
        head = SimulatedPelcoHead(rehearsal.bench, 3)
        with DeviceServer(head) as server:
            content = rehearsal.settings.model_dump(exclude_unset=True)
            content["scanner"] = {
                "driver": "pelco_d",
                "address": server.address,
                "pan_tilt": {"number": 3},
            }
            settings = Settings.model_validate(content)
            assert acquisition.acquire(small, folder, settings=settings).finished
        assert not rehearsal.bench.laser_on
        # The last that it was told is to stop; then it was asked whether it is there.
        assert head.frames[-2] == frame(3, 0)
    cube = cube_of(folder)
    assert not (cube["user_sample_flag"].values & SampleFlag.OFF_POSITION).any()
    step = math.radians(0.01)
    for angle in ("azimuth", "elevation"):
        off = (cube[angle] - cube[f"user_commanded_{angle}"]).values
        assert 0 < np.abs(off).max() <= 1.01 * step


def test_a_head_on_a_serial_port(bench, clock) -> None:
    pytest.importorskip("serial", reason="pyserial is not installed")
    pytest.importorskip("pyvisa_py", reason="PyVISA-py is not installed")
    pty = pytest.importorskip("pty", reason="there are no such terminals here")
    import tty

    far, near = pty.openpty()
    tty.setraw(near)
    simulated = SimulatedPelcoHead(bench)

    def serve() -> None:
        cutter = simulated.cutter()
        try:
            while part := os.read(far, 100):
                for one in cutter.split(part):
                    os.write(far, b"".join(simulated.answer(one)))
        except OSError:
            pass

    threading.Thread(target=serve, daemon=True).start()
    link = OctetLink(f"ASRL{os.ttyname(near)}::INSTR", timeout=60.0)
    head = PelcoHead(link, ScannerSettings(**HEAD), clock=clock)
    bench.send({"azimuth": 0.5}, speed=1e9)
    assert head._angle("pan", head._position("pan")) == pytest.approx(0.5, abs=2e-4)
    head.make_safe()
    head.close()
    os.close(near)
    os.close(far)


def test_a_serial_server_that_is_not_there() -> None:
    with pytest.raises(InstrumentError, match="no address of a link over TCP"):
        OctetLink("tcp://nowhere", timeout=0.2)
    with pytest.raises(InstrumentError, match="nothing can be reached"):
        OctetLink("tcp://127.0.0.1:1", timeout=0.2)
