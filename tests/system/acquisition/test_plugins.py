"""Devices of other packages and of the devices file alone take part in a scan."""

from __future__ import annotations

import re
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import connect
from amulor.acquisition.drivers.chosen import lock_in_of
from amulor.acquisition.drivers.digitiser import DigitiserLockIn
from amulor.acquisition.drivers.scpi import ScpiLaser, ScpiSource
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.links.tcp import DeviceServer
from amulor.acquisition.plugins import Wiring, make, names
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.settings import Settings
from amulor.acquisition.settings.parts import LaserSettings, SourceSettings
from amulor.acquisition.simulated.bench import SCAN_SPEED, Bench
from amulor.acquisition.simulated.devices import SimulatedLaserDriver
from amulor.errors import InstrumentError
from amulor.simulation import simulate

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "add-an-instrument.md"
TURN = 0.0349


class Volts:
    """A voltage source with two outputs, on which mirrors hang."""

    def __init__(self, bench: Bench) -> None:
        self._bench, self._volts = bench, {"1": 0.0, "2": 0.0}

    def answer(self, line: str) -> list[str]:
        if line == "*IDN?":
            return ["Somebody,Volts,1,1"]
        asked = re.fullmatch(r"VOLT\? \(@(\d)\)", line)
        if asked:
            return [f"{self._volts[asked[1]]:.6f}"]
        told = re.fullmatch(r"VOLT (\S+),\(@(\d)\)", line)
        assert told is not None, line
        self._volts[told[2]] = float(told[1])
        name = {"1": "azimuth", "2": "elevation"}[told[2]]
        self._bench.send({name: float(told[1]) * TURN}, speed=SCAN_SPEED)
        return []


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Install the package of the page, and return its devices file."""
    text = PAGE.read_text("utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    declared, devices, *_ = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    (tmp_path / "galvos.py").write_text(program)
    info = tmp_path / "galvos-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: galvos\nVersion: 1.0\n"
    )
    points = tomllib.loads(declared)["project"]["entry-points"]
    lines = [
        f"[{group}]\n" + "\n".join(f"{name} = {where}" for name, where in own.items())
        for group, own in points.items()
    ]
    (info / "entry_points.txt").write_text("\n".join([*lines, ""]))
    monkeypatch.syspath_prepend(tmp_path)
    return devices


def test_a_scan_by_the_scanner_of_the_page(tiny, folder, installed) -> None:
    with (
        rehearse(tiny, Settings(), scene=scene_light, speed=500) as rehearsal,
        DeviceServer(Volts(rehearsal.bench)) as server,
    ):
        content = rehearsal.settings.model_dump(exclude_unset=True)
        content["scanner"] = tomllib.loads(installed)["scanner"]
        content["scanner"]["address"] = server.address
        settings = Settings.model_validate(content)
        outcome = acquisition.acquire(tiny, folder, settings=settings)
        # Half of 60 degrees is more than the mirrors take.
        wide = tiny.with_({"scan.azimuth_span": "60 deg"})
        with pytest.raises(InstrumentError, match="the mirrors take 10 V"):
            acquisition.acquire(wide, folder / "wide", settings=settings)
    assert outcome.finished
    with Journal.read(folder) as journal:
        cube = acquisition.build(journal)
        assert "Volts" in journal.meta()["identities"]
    for angle in ("azimuth", "elevation"):
        # Microvolts of the source.
        np.testing.assert_allclose(
            cube[angle], cube[f"user_commanded_{angle}"], atol=1e-6 * TURN
        )
    assert not rehearsal.bench.laser_on


@pytest.mark.parametrize("filter_", [None, "known"])
def test_a_lock_in_by_commands_of_the_page(tiny, folder, filter_) -> None:
    blocks = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    (text,) = (block for block in blocks if "[lock_in.scpi]" in block)
    tiny = tiny.with_(
        {
            "instrument.modulation_frequencies": ["3.9 MHz"],
            "water.signal_fluctuation": "0 %",
        }
    )
    wanted = Settings.model_validate(
        {"procedure": {"dark_readings": 3, "output_filter": filter_}}
    )
    with rehearse(
        tiny, wanted, scene=scene_light, speed=100, model="sr865a"
    ) as rehearsal:
        content = rehearsal.settings.model_dump(mode="json", exclude_unset=True)
        content |= tomllib.loads(text)
        content["lock_in"]["address"] = rehearsal.settings.lock_in.address
        settings = Settings.model_validate(content, context={"from_text": True})
        with pytest.raises(InstrumentError, match=r"has no 0\.02 s, which the survey"):
            acquisition.acquire(
                tiny.with_({"instrument.lock_in.time_constant": "20 ms",
                            "scan.dwell": "100 ms"}),
                folder / "other", settings=settings,
            )  # fmt: skip
        assert acquisition.acquire(tiny, folder / "a", settings=settings).finished
        assert not rehearsal.bench.laser_on
    with Journal.read(folder / "a") as journal:
        cube = acquisition.build(journal)
    truth = simulate(tiny, rng=1)
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        pulls = ((cube[name] - expected) / cube[f"{name}_uncertainty"]).values
        assert abs(pulls.mean()) < 5 / np.sqrt(pulls.size)
        assert abs(pulls.std() - 1) < 5 / np.sqrt(2 * pulls.size)
    # Scales became finer while nothing overloaded.
    assert cube["user_full_scale"].values.min() < 1


def test_a_digitiser_of_the_page_is_a_lock_in(tmp_path, monkeypatch) -> None:
    blocks = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    (text,) = (block for block in blocks if "[digitiser]" in block)
    info = tmp_path / "card-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: card\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[amulor.digitisers]\nmy_card = card:Card\n")
    (tmp_path / "card.py").write_text(
        "from amulor.acquisition.simulated.devices import SimulatedDigitiser\n"
        "class Card(SimulatedDigitiser):\n"
        "    def __init__(self, wiring):\n"
        "        super().__init__(None, memory=wiring.options['memory'])\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    others = {"driver": "pi_gcs", "address": "tcp://a:1"}
    settings = Settings.model_validate(
        {
            **tomllib.loads(text),
            "laser": {**others, "driver": "scpi", "scpi": {}},
            **dict.fromkeys(("scanner", "launch", "analyser", "target"), others),
        }
    )
    lock_in = lock_in_of(settings, VirtualClock())
    assert isinstance(lock_in, DigitiserLockIn)
    assert lock_in.full_scale() == 10.0
    content = settings.model_dump(mode="json", exclude_none=True)
    del content["digitiser"]
    with pytest.raises(ValueError, match="belong together; state both"):
        Settings.model_validate(content)


def test_what_no_package_offers_is_told_by_name(installed) -> None:
    assert names("scanner") == ["galvos"]
    with pytest.raises(ValueError, match=r"no scanner 'galvo'; there are .*galvos"):
        Settings.model_validate({"scanner": {"driver": "galvo"}})
    wiring = Wiring(address=None, timeout=1.0, clock=VirtualClock())
    with pytest.raises(InstrumentError, match="no installed package offers the laser"):
        make("laser", "galvos", wiring)
    with pytest.raises(InstrumentError, match=r"scanner\.address is needed"):
        make("scanner", "galvos", wiring)


def test_a_device_that_lacks_something_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "half-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: half\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[amulor.lasers]\nhalf = half:Half\nbroken = half:missing\n"
    )
    (tmp_path / "half.py").write_text(
        "class Half:\n    def __init__(self, wiring): pass\n    def on(self): pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    wiring = Wiring(address=None, timeout=1.0, clock=VirtualClock())
    with pytest.raises(InstrumentError, match="has no identity, make_safe, close, off"):
        make("laser", "half", wiring)
    with pytest.raises(InstrumentError, match="cannot be made: AttributeError"):
        make("laser", "broken", wiring)


class Script:
    """The other end of a conversation: what is said, and the answers to questions."""

    address = "a script"

    def __init__(self, **answers: str) -> None:
        self.said: list[str] = []
        self.answers = {"*IDN?": "Somebody,Something,1,1", **answers}
        self.lost = False

    def send(self, line: str) -> None:
        if self.lost:
            raise InstrumentError("the link is lost")
        self.said.append(line)

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        self.send(line)
        return [self.answers[line]]

    def reopen(self) -> None:
        self.lost = False

    def close(self) -> None:
        pass


def page_settings() -> Settings:
    """Return the second devices file of the page, completed."""
    text = PAGE.read_text("utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    (devices,) = (block for block in blocks if "[source.scpi]" in block)
    content = tomllib.loads(devices)
    content |= {
        "scanner": {"driver": "pi_gcs", "address": "tcp://127.0.0.1:1"},
        "launch": {"driver": "none"},
        "analyser": {"driver": "none"},
        "target": {"driver": "operator"},
    }
    return Settings.model_validate(content, context={"from_text": True})


def test_a_generator_is_told_what_the_devices_file_states() -> None:
    own = page_settings().source
    link = Script(**{"SYST:ERR?": '+0,"No error"', "FREQ?": "+3.900000E+07"})
    clock = VirtualClock()
    source = ScpiSource(link, own, clock=clock)
    assert source.set_frequency(39e6, timeout=5.0) == 39e6
    assert clock.now() == pytest.approx(0.01)
    assert link.said == [
        "*IDN?", "OUTP OFF", "FUNC SIN", "OUTP:LOAD 50", "VOLT 0.5 VRMS", "SYST:ERR?",
        "FREQ 39000000", "OUTP ON", "SYST:ERR?", "FREQ?",
    ]  # fmt: skip
    link.answers["FREQ?"] = "2E7"
    with pytest.raises(InstrumentError, match="was set to"):
        source.set_frequency(39e6, timeout=5.0)
    link.answers["SYST:ERR?"] = '-222,"Data out of range"'
    with pytest.raises(InstrumentError, match="Data out of range"):
        source.set_frequency(39e9, timeout=5.0)
    link.lost = True
    source.make_safe()
    assert link.said[-2:] == ["OUTP OFF", "*IDN?"]


def test_a_laser_driver_is_watched_and_read_back() -> None:
    link = Script(**{"INP:ILOCK?": "1", "OUTP?": "0"})
    laser = ScpiLaser(link, page_settings().laser)
    laser.on()
    # The answer shows that the command was executed before the next sample.
    assert link.said[-3:] == ["INP:ILOCK?", "OUTP ON", "OUTP?"]
    link.answers["INP:ILOCK?"] = "0"
    with pytest.raises(InstrumentError, match="interlock of the laser is open"):
        laser.check()
    with pytest.raises(InstrumentError, match="interlock of the laser is open"):
        laser.on()
    link.lost = True
    laser.make_safe()
    link.answers["OUTP?"] = "1"
    with pytest.raises(InstrumentError, match="it may be on"):
        laser.make_safe()


def test_what_is_left_out_of_a_light_part_is_asked_for() -> None:
    with pytest.raises(ValueError, match=r"laser\.scpi is needed"):
        LaserSettings(driver="scpi", address="tcp://h:1")
    with pytest.raises(ValueError, match=r"source\.amplitude is needed"):
        SourceSettings(driver="scpi", address="tcp://h:1")
    with pytest.raises(ValueError, match="add the part source"):
        Settings.model_validate({"lock_in": {"reference": "external"}})


def test_a_generator_and_a_laser_driver_in_a_scan(tiny, folder) -> None:
    class Generator:
        """Modulates the laser of the bench, and lets its light out."""

        def __init__(self, bench: Bench) -> None:
            self.bench, self.lines = bench, []

        def answer(self, line: str) -> list[str]:
            self.lines.append(line)
            if line.startswith("OUTP O"):
                time.sleep(0.05)  # 25 s of the scan
                self.bench.set_laser(line.endswith("ON"))
            if line.startswith("FREQ "):
                self.bench.set_frequency(float(line.split()[1]))
            answers = {
                "*IDN?": "Somebody,Generator,1,1",
                "SYST:ERR?": "+0",
                "FREQ?": f"{self.bench.frequency:.9E}",
                "OUTP?": str(int(self.bench.laser_on)),
            }
            return [answers[line]] if line in answers else []

    with rehearse(tiny, Settings(), scene=scene_light, speed=500) as rehearsal:
        generator = Generator(rehearsal.bench)
        with DeviceServer(generator) as server:
            content = rehearsal.settings.model_dump(exclude_unset=True)
            content["laser"] = {"driver": "scpi", "address": server.address, "scpi": {}}
            content["source"] = {
                "driver": "scpi", "address": server.address, "amplitude": 0.5,
                "scpi": {"on": [], "off": []},
            }  # fmt: skip
            content["lock_in"]["reference"] = "external"
            outcome = acquisition.acquire(
                tiny, folder, settings=Settings.model_validate(content)
            )
        said = rehearsal.lock_in.lines
    assert outcome.finished
    assert "FMOD 0" in said
    assert not any(line.startswith("FREQ ") for line in said)
    assert "FREQ 39000000" in generator.lines
    assert not rehearsal.bench.laser_on


@pytest.mark.parametrize("model", [None, "sr844", "sr865a"])
def test_an_open_interlock_ends_a_scan_within_one_sample(tiny, folder, model) -> None:
    told: list = []
    begin = 25
    fault = {"simulation": {"faults": [f"interlock@{begin}x100000"]}}
    if model == "sr865a":
        tiny = tiny.with_({"instrument.modulation_frequencies": ["3.9 MHz"]})

    def run(settings: Settings) -> None:
        with pytest.raises(InstrumentError, match="laser is open"):
            acquisition.acquire(
                tiny, folder, settings=settings, scene=scene_light,
                acknowledged=told.append,
            )  # fmt: skip

    if model is None:
        run(Settings.model_validate(fault))
    else:
        watched = Settings.model_validate({**fault, "laser": {"interlock_input": 2}})
        with rehearse(
            tiny, watched, scene=scene_light, speed=500, model=model
        ) as rehearsal:
            run(rehearsal.settings)
            assert not rehearsal.bench.laser_on
    # One reading a sample: the 25th is the first without light, and is not kept.
    assert len(told) == begin - 1
    with Journal.read(folder) as journal:
        assert journal.count() == begin - 1
        assert not any(record.flags for _, record in journal.samples("scan"))


def test_a_lock_in_without_outputs_cannot_be_the_gate(tiny, monkeypatch) -> None:
    with rehearse(tiny, Settings(), scene=scene_light) as rehearsal:
        monkeypatch.delattr("amulor.acquisition.drivers.stanford.Stanford.set_output")
        with pytest.raises(InstrumentError, match="has no 'set_output'"):
            connect(tiny, rehearsal.settings)


# -- laser diode drivers ---------------------------------------------------------------


def _with_driver(rehearsal, server) -> Settings:
    """Return a devices file with the laser diode driver of the page."""
    blocks = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    (text,) = (block for block in blocks if "MEAS:CURR?" in block)
    content = rehearsal.settings.model_dump(mode="json", exclude_unset=True)
    content["laser"] = {**tomllib.loads(text)["laser"], "address": server.address}
    return Settings.model_validate(content, context={"from_text": True})


def test_current_and_temperature_of_the_diode_are_in_every_sample(tiny, folder) -> None:
    with (
        rehearse(tiny, Settings(), scene=scene_light, speed=500) as rehearsal,
        DeviceServer(SimulatedLaserDriver(rehearsal.bench)) as server,
    ):
        settings = _with_driver(rehearsal, server)
        assert acquisition.acquire(tiny, folder, settings=settings).finished
        assert not rehearsal.bench.laser_on
    with Journal.read(folder) as journal:
        dark = [record for _, record in journal.samples("dark")]
        lit = [record for _, record in journal.samples("scan")]
        cube = acquisition.build(journal)
    assert {record.laser_current for record in dark} == {0.0}
    assert {record.laser_current for record in lit} == {0.075}
    assert {record.laser_temperature for record in dark} == {25.0}
    assert all(25.0 <= record.laser_temperature <= 25.5 for record in lit)
    assert cube["user_laser_current"].attrs["units"] == "A"
    np.testing.assert_array_equal(cube["user_laser_current"], 0.075)


def test_a_diode_driver_tells_an_interlock_and_an_error(tiny, folder) -> None:
    wanted = Settings.model_validate({"simulation": {"faults": ["interlock@25x9999"]}})
    with (
        rehearse(tiny, wanted, scene=scene_light, speed=500) as rehearsal,
        DeviceServer(SimulatedLaserDriver(rehearsal.bench)) as server,
    ):
        settings = _with_driver(rehearsal, server)
        told: list = []
        with pytest.raises(InstrumentError, match="interlock of the laser is open"):
            acquisition.acquire(
                tiny, folder, settings=settings, acknowledged=told.append
            )
        assert not rehearsal.bench.laser_on
    assert told
    with Journal.read(folder) as journal:
        assert journal.count() == len(told)
    words = settings.laser.scpi
    assert words is not None
    link = Script(**{
        words.interlock: "1", words.error: "-221,conflict", "OUTP?": "0",
        words.current: "9.9E37 A",
    })  # fmt: skip
    laser = ScpiLaser(link, settings.laser)
    with pytest.raises(InstrumentError, match="refused to be switched on: -221"):
        laser.on()
    with pytest.raises(InstrumentError, match=r"'9\.9E37 A', needed is a number"):
        laser.readings()
