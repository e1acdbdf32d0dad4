"""Mirrors on voltages: where they point, how well that is known, what is refused."""

from __future__ import annotations

import re
import sys
import tomllib
import types
from pathlib import Path

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.connect import connect
from amulor.acquisition.devices import Devices
from amulor.acquisition.drivers.analog import (
    AnalogScanner,
    LabjackOutputs,
    LockInOutputs,
    Mirror,
    NidaqOutputs,
    outputs_of,
)
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.settings import Settings
from amulor.acquisition.settings.parts import AnalogSettings, MirrorSettings
from amulor.acquisition.simulated.bench import SCAN_SPEED
from amulor.errors import InstrumentError

PAGE = Path(__file__).parents[4] / "docs" / "how-to" / "add-an-instrument.md"
VOLTS = np.linspace(-4, 4, 9)


def true_angle(volts: float) -> float:
    """Return where a mirror of these tests points: not quite in proportion."""
    return 0.035 * volts + 2e-4 * volts**2 + 0.002


def mirror(output: str, noise: float, seed: int = 1, volts=VOLTS) -> dict:
    """Return a calibration with errors of reading."""
    rng = np.random.default_rng(seed)
    angles = [true_angle(v) + noise * rng.standard_normal() for v in volts]
    return {"output": output, "volts": [*map(float, volts)], "angles": angles}


def analog(noise: float = 2e-5, outputs: str = "lock_in", names=("2", "3")):
    """Return settings of two mirrors."""
    return AnalogSettings.model_validate(
        {
            "outputs": outputs,
            "settling": 0.05,
            "azimuth": mirror(names[0], noise, 1),
            "elevation": mirror(names[1], noise, 2),
        }
    )


class Galvos:
    """A lock-in whose outputs turn the mirrors of a bench, in steps of a millivolt."""

    def __init__(self, bench) -> None:
        self.bench, self.put_out = bench, {}

    def identity(self) -> str:
        return "a lock-in"

    def set_output(self, number: int, voltage: float) -> float:
        self.put_out[number] = round(voltage, 3)
        goal = {2: "azimuth", 3: "elevation"}[number]
        self.bench.send({goal: true_angle(round(voltage, 3))}, speed=SCAN_SPEED)
        return round(voltage, 3)


def test_a_fit_finds_the_law_and_states_what_it_does_not_know() -> None:
    pulls, stated = [], []
    for seed in range(200):
        found = Mirror(MirrorSettings.model_validate(mirror("1", 1e-4, seed)))
        stated.append(found.spread**2)
        pulls.append((found.angle(1.3) - true_angle(1.3)) / 1e-4)
        assert found.angle(found.volts(0.05)) == pytest.approx(0.05, abs=1e-12)
    # Six degrees of freedom, 200 times: 4.1 % of the variance.
    assert np.mean(stated) == pytest.approx(1e-8, rel=5 * 0.041)
    # A curve through nine points is known better than each of them.
    assert np.std(pulls) < 0.6


def test_a_scan_by_mirrors_knows_where_they_point(small, settings, folder) -> None:
    devices = connect(small, settings, scene=scene_light)
    bench = devices.lock_in.bench
    scanner = AnalogScanner(
        outputs_of(analog(), lock_in=Galvos(bench), address=None),
        analog(), clock=devices.clock, tolerance=1e-4,
    )  # fmt: skip
    assert "angles known to" in scanner.identity()
    moved = Devices(**{**vars(devices), "scanner": scanner})
    seen = {}
    commit = Journal.commit

    def note(journal, key, record):
        seen[key] = (bench.place("azimuth"), bench.place("elevation"))
        commit(journal, key, record)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Journal, "commit", note)
        outcome = acquisition.acquire(small, folder, settings=settings, devices=moved)
    assert (outcome.finished, outcome.flagged) == (True, 0)
    with Journal.read(folder) as journal:
        taken = [*journal.samples(SCAN)]
    error = np.array(
        [np.subtract((r.azimuth, r.elevation), seen[key]) for key, r in taken]
    )
    # The bench misses by 2 urad itself; the fit by less than a reading of 20 urad.
    assert np.abs(error).max() < 3 * scanner.spread
    asked = [(r.commanded_azimuth, r.commanded_elevation) for _, r in taken]
    stands = [(r.azimuth, r.elevation) for _, r in taken]
    # Half a millivolt is 18 urad.
    assert np.abs(np.subtract(asked, stands)).max() < 2.1e-5


def test_what_lies_beyond_the_voltages_is_refused_before_the_first_move(
    small, settings, folder
) -> None:
    wide = small.with_({"scan.azimuth_span": "20 deg"})
    devices = connect(wide, settings, scene=scene_light)
    galvos = Galvos(devices.lock_in.bench)
    scanner = AnalogScanner(
        LockInOutputs(galvos), analog(), clock=devices.clock, tolerance=1e-4
    )
    with pytest.raises(InstrumentError, match=r"output 2 turns the beam from -0\.1"):
        acquisition.acquire(
            wide, folder, settings=settings,
            devices=Devices(**{**vars(devices), "scanner": scanner}),
        )  # fmt: skip
    assert galvos.put_out == {}


def test_calibrations_that_say_too_little_are_refused(clock) -> None:
    with pytest.raises(InstrumentError, match=r"scatter by 0\.001.*position_tol"):
        AnalogScanner(
            LockInOutputs(Galvos(None)), analog(1e-3), clock=clock, tolerance=1e-4
        )
    turns_back = mirror("1", 0.0)
    turns_back["angles"] = [v**2 for v in turns_back["volts"]]
    with pytest.raises(InstrumentError, match="turn back within its voltages"):
        Mirror(MirrorSettings.model_validate(turns_back))
    for wrong, text in (
        ({"volts": [0.0, 1.0, 1.0]}, "volts must rise"),
        ({"volts": [0.0, 1.0, 2.0, 3.0]}, "an angle for each voltage"),
    ):
        with pytest.raises(ValueError, match=text):
            MirrorSettings.model_validate(
                {"output": "1", "volts": [0, 1, 2], "angles": [0, 1, 2], **wrong}
            )


def test_the_mirrors_of_the_page_and_the_laser_have_outputs_of_their_own() -> None:
    blocks = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    (text,) = (block for block in blocks if "[scanner.analog]" in block)
    others = {"driver": "none"}
    content = {
        **tomllib.loads(text),
        "lock_in": {
            "driver": "sr865a", "address": "tcp://a:1", "modulation_amplitude": "1 V",
        },
        "laser": {"driver": "lock_in_output", "output": 1},
        "launch": others, "analyser": others, "target": {"driver": "operator"},
    }  # fmt: skip
    settings = Settings.model_validate(content, context={"from_text": True})
    own = settings.scanner.analog
    assert own is not None
    scanner = AnalogScanner(
        LockInOutputs(Galvos(None)), own, clock=None,
        tolerance=settings.procedure.position_tolerance,
    )  # fmt: skip
    scanner.refuse_beyond_reach([-0.17, 0.17], [0.1])
    content["laser"]["output"] = 3
    with pytest.raises(ValueError, match="outputs of their own among 1, 2, 3, 4"):
        Settings.model_validate(content, context={"from_text": True})


class Fake(types.ModuleType):
    """What the two packages are called by; no hardware stands behind it."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.said: list[tuple] = []
        self.ao_channels = self
        self.broken = False

    def __getattr__(self, name: str):
        def call(*args, **named):
            self.said.append((name, args, named))
            if self.broken:
                raise RuntimeError("DaqError -200220")
            if name == "eReadName":
                wrote = [a[2] for n, a, _ in self.said if n == "eWriteName"]
                return 470012345.0 if args[1] == "SERIAL_NUMBER" else wrote[-1]
            return self if name == "Task" else 7

        if name.startswith("__"):
            raise AttributeError(name)
        return call


def test_a_card_of_ni_gets_its_limits_and_both_voltages_at_once(monkeypatch) -> None:
    package = Fake("nidaqmx")
    monkeypatch.setitem(sys.modules, "nidaqmx", package)
    own = analog(outputs="nidaqmx", names=("Dev1/ao0", "Dev1/ao1"))
    outputs = outputs_of(own, lock_in=None, address=None)
    assert isinstance(outputs, NidaqOutputs)
    assert outputs.set({"Dev1/ao1": 2.0, "Dev1/ao0": 1.0})["Dev1/ao1"] == 2.0
    outputs.close()
    outputs.close()
    limits = {"min_val": -4.0, "max_val": 4.0}
    assert package.said == [
        ("Task", (), {}),
        ("add_ao_voltage_chan", ("Dev1/ao0",), limits),
        ("add_ao_voltage_chan", ("Dev1/ao1",), limits),
        ("write", ([1.0, 2.0],), {"auto_start": True}),
        ("close", (), {}),
    ]
    package.broken = True
    with pytest.raises(InstrumentError, match=r"nidaqmx has failed.*DaqError -200220"):
        outputs_of(own, lock_in=None, address=None)


def test_a_labjack_is_set_and_read_back_by_name(monkeypatch) -> None:
    package = Fake("labjack.ljm")
    monkeypatch.setitem(sys.modules, "labjack", types.ModuleType("labjack"))
    monkeypatch.setitem(sys.modules, "labjack.ljm", package)
    outputs = LabjackOutputs("470012345")
    assert outputs.identity() == "LabJack 470012345"
    assert outputs.set({"DAC0": 1.25}) == {"DAC0": 1.25}
    outputs.close()
    assert [entry[:2] for entry in package.said] == [
        ("openS", ("ANY", "ANY", "470012345")),
        ("eReadName", (7, "SERIAL_NUMBER")),
        ("eWriteName", (7, "DAC0", 1.25)),
        ("eReadName", (7, "DAC0")),
        ("close", (7,)),
    ]
    monkeypatch.setitem(sys.modules, "labjack.ljm", None)
    with pytest.raises(InstrumentError, match="pip install labjack-ljm"):
        LabjackOutputs(None)
