"""Devices of other packages: a mistake in one is named, and no sample is lost."""

from __future__ import annotations

import math
import re
import sys
import tomllib
from pathlib import Path

import pytest

from amulor import acquisition
from amulor.acquisition.cube.build import shows_no_target
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.links.tcp import DeviceServer
from amulor.acquisition.plugins import GuardedDevice, Wiring
from amulor.acquisition.protocols import Overload, Reading
from amulor.acquisition.settings import Settings
from amulor.errors import InstrumentError
from amulor.survey import Survey

PROGRAM = """
import test_plugins as own

class Part:
    def __init__(self, wiring): pass
    def identity(self): return "a device of another package"
    def make_safe(self): pass
    def close(self): pass

class LockIn(Part):
    def prepare(self, *, time_constant): pass
    def set_frequency(self, frequency, *, timeout):
        self.frequency = frequency
        return frequency
    def read(self): return own.ANSWERS["read"](self.frequency)
    def relieve(self, overload): return False
    def sharpen(self, amplitude): return False
    def full_scale(self): return own.ANSWERS["full_scale"]()

class Scanner(Part):
    def move(self, azimuth, elevation, *, timeout):
        return own.ANSWERS["move"](azimuth, elevation)

class Laser(Part):
    def on(self): pass
    def off(self): pass
    def readings(self): return own.ANSWERS["readings"]()
"""
GROUPS = {"lock_ins": "LockIn", "scanners": "Scanner", "lasers": "Laser"}
#: What the devices answer, by method.
ANSWERS: dict = {}


def _reading(frequency: float, **changes) -> Reading:
    content = {"signal": 0.01 + 0.02j, "mean": math.nan, **changes}
    return Reading(modulation_frequency=frequency, **content)


def _broken(*_) -> None:
    raise OSError("wire gone")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    """Install a package with three devices; return a devices file that names them."""
    (tmp_path / "others_devices.py").write_text(PROGRAM)
    info = tmp_path / "others-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: others\nVersion: 1.0\n"
    )
    (info / "entry_points.txt").write_text(
        "".join(
            f"[amulor.{group}]\nmine = others_devices:{name}\n"
            for group, name in GROUPS.items()
        )
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "test_plugins", sys.modules[__name__])
    ANSWERS.clear()
    ANSWERS.update(
        read=_reading, full_scale=lambda: 1.0, move=lambda *goal: goal, readings=dict
    )
    return Settings.model_validate(
        {
            **{part: {"driver": "mine"} for part in ("lock_in", "scanner", "laser")},
            **{part: {"driver": "none"} for part in ("launch", "analyser", "target")},
            "procedure": {"dark_readings": 1},
        }
    )


@pytest.fixture
def water_is_known(small: Survey) -> Survey:
    """Return a survey without open-water shots, of one channel."""
    return small.with_(
        {
            "scan.open_water": None,
            "scan.columns": 2,
            "scan.rows": 1,
            "scan.dwell": "12 ms",
            "instrument.lock_in.time_constant": "1 ms",
            "instrument.modulation_frequencies": ["39 MHz"],
            "instrument.polarizations": ["VV"],
        }
    )


def test_a_scan_without_a_target_stage(installed, water_is_known, folder) -> None:
    assert acquisition.acquire(water_is_known, folder, settings=installed).finished
    with Journal.read(folder) as journal:
        keys = journal.keys()
    assert {key.kind for key in keys} == {"dark", "scan"}


def test_open_water_needs_a_stage_or_an_operator(installed, small, folder) -> None:
    with pytest.raises(InstrumentError, match=r"take scan\.open_water out"):
        acquisition.acquire(small, folder, settings=installed)


def test_an_operator_needs_a_terminal_before_the_first_reading(
    installed, small, folder, made
) -> None:
    settings = made(installed, target={"driver": "operator"})
    ANSWERS["read"] = lambda _: pytest.fail("a reading")
    with pytest.raises(InstrumentError, match="this is no terminal"):
        acquisition.acquire(small, folder, settings=settings)


@pytest.mark.parametrize(
    ("method", "answer", "text"),
    [
        ("read", _broken, r"lock_in 'mine' of others_devices:LockIn has failed in "
         r"read\(\): OSError: wire gone; check its cable"),
        ("read", lambda f: None, r"read\(\) .* None, needed is a Reading"),
        ("read", lambda f: _reading(f, signal=complex(math.nan, 0)),
         r"read\(\) .*LockIn has answered signal = \(nan\+0j\), needed is a finite"),
        ("read", lambda f: _reading(f, signal=complex(0, math.inf)), "signal = infj"),
        ("read", lambda f: _reading(f, signal="1"), "signal = '1', needed"),
        ("read", lambda f: _reading(f, mean=math.inf), "mean = inf"),
        ("read", lambda f: _reading(math.nan), "modulation_frequency = nan, needed"),
        ("read", lambda f: _reading(f, overload=99),
         "overload = 99, needed is a sum of the bits of Overload, at most 15"),
        ("full_scale", lambda: 0.0, r"full_scale\(\) .* 0, needed is a number above 0"),
        ("full_scale", lambda: None, r"full_scale\(\) .* None, needed is a number"),
        ("move", lambda *_: (math.nan, 0.0), r"move\(\) of the scanner 'mine' .* nan"),
        ("move", lambda *_: None, r"move\(\) .* None, needed is a sequence"),
        ("move", lambda *_: (0.0,), r"move\(\) .* 1 values, needed are 2"),
        ("move", _broken, r"scanner 'mine' of .* has failed in move\(\)"),
        ("readings", lambda: {"current": 1.0}, "current, possible are laser_current"),
        ("readings", lambda: {"laser_current": math.inf}, r"readings\(\) .* inf"),
    ],
)  # fmt: skip
def test_a_mistake_of_a_device_is_named_and_samples_are_counted(
    installed, water_is_known, folder, method, answer, text
) -> None:
    good, calls = ANSWERS[method], []

    def later(*arguments):
        calls.append(method)
        # The dark reading and the first pixel are good.
        return (good if len(calls) <= 2 else answer)(*arguments)

    ANSWERS[method] = later
    with pytest.raises(InstrumentError, match=text) as raised:
        acquisition.acquire(
            water_is_known.with_({"scan.dwell": "6 ms"}), folder, settings=installed
        )
    with Journal.read(folder) as journal:
        count = journal.count()
    assert f"{count} samples are kept in {folder}" in str(raised.value)
    assert "--resume" in str(raised.value)


def test_overload_bits_of_the_protocol_pass(installed, water_is_known, folder) -> None:
    ANSWERS["read"] = lambda f: _reading(f, overload=Overload.INPUT | Overload.MEAN)
    outcome = acquisition.acquire(water_is_known, folder, settings=installed)
    assert outcome.flagged == outcome.done


def test_a_scan_with_the_signal_of_open_water_is_noticed(
    installed, water_is_known, folder, made
) -> None:
    plan = {"columns": 1, "rows": 1, "repeats": 2}
    survey = water_is_known.with_({"scan.open_water": plan})
    settings = made(installed, target={"driver": "operator"})
    water = []
    for name, with_target in (("same", 0.01 + 0.02j), ("other", 0.5 + 0.02j)):

        def move(text, signal=with_target):
            water.append(text)
            out = "only water" in text
            value = 0.01 + 0.02j if out else signal
            ANSWERS["read"] = lambda f: _reading(f, signal=value)

        acquisition.acquire(survey, folder / name, settings=settings, ask=move)
        with Journal.read(folder / name) as journal:
            cube = acquisition.build(journal)
        assert shows_no_target(cube) == (name == "same")
    assert water


class Instrument:
    """The other end of the lock-in of the page: 3 mV and 4 mV rms, input overloaded."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def answer(self, line: str) -> list[str]:
        self.lines.append(line)
        answers = {"*IDN?": "Mine,1", "FREQ?": "3.9e7", "XY?": "3e-3,-4e-3"}
        answers["STAT?"] = "1"
        return [answers[line]] if line in answers else []


def test_the_lock_in_of_the_page_is_complete(clock) -> None:
    page = Path(__file__).parents[3] / "docs" / "how-to" / "add-an-instrument.md"
    blocks = re.findall(r"```py\n(.*?)```", page.read_text("utf-8"), flags=re.DOTALL)
    (program,) = (block for block in blocks if "class LockIn" in block)
    space: dict = {}
    exec(program, space)
    instrument = Instrument()
    with DeviceServer(instrument) as server:
        wiring = Wiring(address=server.address, timeout=5.0, clock=clock)
        device = GuardedDevice(space["LockIn"](wiring), "lock_in 'mine'")
        device.prepare(time_constant=0.01)
        assert device.set_frequency(39e6, timeout=5.0) == 39e6
        reading = device.read()
        device.make_safe()
        device.close()
    # Peak values, and a phase that rises with delay.
    assert reading.signal == pytest.approx(math.sqrt(2) * (3e-3 + 4e-3j))
    assert reading.overload == Overload.INPUT
    assert not reading.unlocked
    assert instrument.lines[:2] == ["TC 0.01", "FREQ 39000000"]
    (devices,) = (
        block
        for block in re.findall(
            r"```toml\n(.*?)```", page.read_text("utf-8"), flags=re.DOTALL
        )
        if "my_lock_in" in block
    )
    parts = tomllib.loads(devices)
    assert {"lock_in", "scanner", "laser", "launch", "analyser", "target"} == {*parts}
