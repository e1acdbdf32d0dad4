"""An HF2LI through the maker's own toolkit, whose table of nodes decides what there is.

The data server behind the toolkit is played by a double of `zhinst.core.ziDAQServer`,
in front of a bench. What it holds about an HF2LI is from its manual: levels that are
fractions of the range, converters that tell overloads, a clock of 210 MHz.
"""

from __future__ import annotations

import functools
import math
import re

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import LockInGate, simulated_bench
from amulor.acquisition.devices import Devices
from amulor.acquisition.drivers.zurich import ZurichLockIn
from amulor.acquisition.protocols import Overload
from amulor.acquisition.settings import LaserSettings, Settings
from amulor.acquisition.simulated.devices import (
    SimulatedMount,
    SimulatedScanner,
    SimulatedTargetStage,
)
from amulor.errors import InstrumentError
from amulor.simulation import simulate

toolkit = pytest.importorskip("zhinst.toolkit", reason="pip install 'amulor[zi]'")

#: The toolkit leaves the file with its list of nodes open.
pytestmark = pytest.mark.filterwarnings(
    "ignore:unclosed file:ResourceWarning",
    "ignore:Exception ignored in:pytest.PytestUnraisableExceptionWarning",
)
light = functools.cache(scene_light)
CLOCKBASE = 210e6
INPUT_MIXER_CHANNEL = 6
#: Fastest rate of the demodulators; others are this divided by powers of two [1/s].
FASTEST = CLOCKBASE / 456


class DataServer:
    """What the toolkit calls of `ziDAQServer`, for one HF2LI in front of a bench."""

    host, port = "lab", 8005

    def __init__(self, bench, options: str) -> None:
        self.bench = bench
        self.set_nodes: dict[str, float] = {}
        self.subscribed: set[str] = set()
        self.options = options
        self.full = False

    def listNodes(self, path: str, *args: object, **words: object) -> list[str]:
        """Return what an HF2LI has of what a lock-in needs; its server has no list
        with descriptions, that is the toolkit's."""
        mixer = [f"{one}/{n}" for one in ("enables", "amplitudes") for n in range(8)]
        counted = {
            "oscs": (6, ("freq",)),
            "demods": (
                6,
                ("adcselect", "order", "timeconstant", "rate", "enable", "trigger",
                 "oscselect", "harmonic", "freq", "phaseshift", "sinc", "sample"),
            ),
            "sigins": (2, ("range", "ac", "imp50", "diff")),
            "sigouts": (
                2,
                ("on", "add", "range", "offset", *mixer),
            ),
            "auxouts": (4, ("value", "outputselect", "demodselect", "scale", "offset")),
        }  # fmt: skip
        nodes = [
            f"/DEV18/{kind}/{number}/{name}"
            for kind, (count, names) in counted.items()
            for number in range(count)
            for name in names
        ]
        single = ("clockbase", "features/devtype", "features/options", "status/time",
                  "status/adc0min", "status/adc0max")  # fmt: skip
        return [*nodes, *(f"/DEV18/{name}" for name in single)]

    # -- strings and numbers

    def getString(self, path: str) -> str:
        return {
            "/zi/about/dataserver": "HF2DataServer",
            "/dev18/features/devtype": "HF2LI",
            "/dev18/features/options": self.options,
            "/zi/devices/connected": "dev18",
        }[path.lower()]

    def connectDevice(self, serial: str, interface: str) -> None:
        assert (serial, interface) == ("dev18", "USB")

    def getInt(self, path: str) -> int:
        node = path.lower().removeprefix("/dev18/")
        if node == "clockbase":
            return round(CLOCKBASE)
        if node in ("status/adc0max", "status/adc0min"):
            full = 127 if self.full else 40
            return full if node.endswith("max") else -full
        return int(self.set_nodes.get(node, 0))

    def getDouble(self, path: str) -> float:
        node = path.lower().removeprefix("/dev18/")
        if node == "status/time":
            return self.bench.clock.now()  # [s], in the toolkit's list of nodes
        if node == "auxouts/0/value":
            return self.aux()
        return float(self.set_nodes.get(node, 0.0))

    def set(self, path, value=None) -> None:
        for one, content in [(path, value)] if isinstance(path, str) else path:
            self.change(one.lower().removeprefix("/dev18/"), content)

    def change(self, node: str, value: float) -> None:
        if re.fullmatch(r"demods/\d/rate", node):
            value = FASTEST / 2 ** max(0, round(math.log2(FASTEST / value)))
        if re.fullmatch(r"sigouts/\d/amplitudes/\d", node):
            assert 0 <= value <= 1, "a level is a fraction of the range"
        self.set_nodes[node] = value
        if node == "demods/0/timeconstant":
            self.bench.set_time_constant(value)
        if node.startswith("auxouts/0"):
            self.bench.set_laser(self.aux() > 2.0)
        if node.startswith(("oscs/", "sigouts/0/")):
            driven = self.driven()
            wanted = [self.set_nodes.get(f"oscs/{place}/freq", 1e6) for place in driven]
            if wanted and wanted != self.bench.frequencies:
                self.bench.set_frequencies(wanted)
        self.restart()

    def aux(self) -> float:
        manual = self.set_nodes.get("auxouts/0/outputselect") == -1
        return float(self.set_nodes.get("auxouts/0/offset", 0.0)) if manual else 0.0

    def driven(self) -> list[int]:
        """Return the oscillators that the first output puts out."""
        if not self.set_nodes.get("sigouts/0/on"):
            return []
        if "MF" in self.options:
            return [n for n in range(6) if self.set_nodes.get(f"sigouts/0/enables/{n}")]
        channel = f"sigouts/0/enables/{INPUT_MIXER_CHANNEL}"
        return [0] if self.set_nodes.get(channel) else []

    # -- samples

    def shown(self, row: list[complex], place: int) -> complex:
        oscillator = int(self.set_nodes.get(f"demods/{place}/oscselect", 0))
        driven = self.driven()
        if oscillator not in driven:
            return 0j
        return row[driven.index(oscillator)] / math.sqrt(2)

    def sample(self, place: int, rows: list, times: np.ndarray, mean: float) -> dict:
        signal = np.array([self.shown(row, place) for row in rows])
        oscillator = int(self.set_nodes.get(f"demods/{place}/oscselect", 0))
        return {
            "timestamp": np.round(times * CLOCKBASE).astype(np.uint64),
            "x": signal.real,
            "y": -signal.imag,
            "frequency": np.full(
                len(rows), self.set_nodes.get(f"oscs/{oscillator}/freq", 1e6)
            ),
            "auxin0": np.full(len(rows), mean),
            "auxin1": np.zeros(len(rows)),
        }

    def getSample(self, path: str) -> dict:
        row, mean = self.bench.outputs()
        place = int(path.split("/")[3])
        return self.sample(place, [row], np.array([self.bench.clock.now()]), mean)

    def subscribe(self, path: str) -> None:
        self.subscribed.add(path.lower())
        self.restart()

    def restart(self, start: float | None = None) -> None:
        rate = self.set_nodes.get("demods/0/rate", 1e3)
        self.start = self.bench.clock.now() if start is None else start
        self.bench.start_trace(1 / rate, most=200_000, start=self.start)

    def poll(self, recording_time: float, timeout: int, *, flags: int, flat: bool):
        assert flat
        self.bench.clock.sleep(recording_time)
        rate = self.set_nodes["demods/0/rate"]
        rows = self.bench.trace()
        times = self.start + np.arange(len(rows)) / rate
        self.restart(self.start + len(rows) / rate)
        _, mean = self.bench.outputs()
        return {
            path: self.sample(int(path.split("/")[3]), rows, times, mean)
            for path in self.subscribed
            if rows and self.set_nodes.get(f"demods/{path.split('/')[3]}/enable")
        }


@pytest.fixture
def made(monkeypatch):
    """Return what connects devices with an HF2LI, through toolkit and double."""

    def make(survey, settings: Settings, options: str = "MF"):
        clock = VirtualClock()
        clock.sleep(1000.0)  # the instrument has been on for a while
        bench = simulated_bench(survey, settings, scene=light, clock=clock)
        server = DataServer(bench, options)
        monkeypatch.setattr(
            "zhinst.toolkit.session.core.ziDAQServer", lambda *address: server
        )
        lock_in = ZurichLockIn.connect(
            "hf2:lab:dev18", mean_output_input=1, modulation_amplitude=0.1, clock=clock
        )
        devices = Devices(
            laser=LockInGate(lock_in, LaserSettings(driver="lock_in_output")),
            lock_in=lock_in,
            scanner=SimulatedScanner(bench),
            launch=SimulatedMount(bench, "launch"),
            analyser=SimulatedMount(bench, "analyser"),
            target=SimulatedTargetStage(bench),
            clock=clock,
        )
        return devices, server

    return make


@pytest.mark.parametrize("readings", [None, "buffer"])
def test_an_hf2li_takes_a_scan_of_two_frequencies_at_once(
    made, small, folder, cube_of, readings
) -> None:
    survey = small.with_(
        {
            "instrument.modulation_frequencies": ["30 MHz", "41 MHz"],
            "instrument.modulation_depth": 0.4,
            "water.signal_fluctuation": "0 %",
        }
    )
    settings = Settings.model_validate(
        {
            "procedure": {
                "dark_readings": 2,
                "frequencies_at_once": 2,
                "readings": readings,
                "output_filter": "known",
            }
        }
    )
    devices, server = made(survey, settings)
    outcome = acquisition.acquire(survey, folder, settings=settings, devices=devices)
    assert outcome.finished
    assert not server.bench.laser_on
    assert server.set_nodes["sigouts/0/on"] == 0
    # Two levels of 0.1 V rms need 0.283 V peak: a range of 1 V, and fractions of it.
    assert server.set_nodes["sigouts/0/range"] == 1.0
    for place in (0, 1):
        level = server.set_nodes[f"sigouts/0/amplitudes/{place}"]
        assert level == pytest.approx(0.1 * math.sqrt(2))
    cube = cube_of(folder)
    assert "Zurich Instruments,HF2LI,dev18" in str(cube.attrs)
    truth = simulate(survey, rng=1)
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        pulls = ((cube[name] - expected) / cube[f"{name}_uncertainty"]).values
        assert abs(pulls.mean()) < 5 / np.sqrt(pulls.size)
        assert abs(pulls.std() - 1) < 5 / np.sqrt(2 * pulls.size)


def test_what_is_streamed_is_not_older_than_the_call(made, small) -> None:
    devices, server = made(small, Settings())
    lock_in, bench = devices.lock_in, server.bench
    lock_in.prepare(time_constant=0.01)
    lock_in.set_frequency(39e6, timeout=1.0)
    devices.laser.on()
    devices.clock.sleep(0.2)
    lit = np.abs(lock_in.record(0.05).signals).mean()
    # Minutes of light that nobody asked for wait in the server, then darkness.
    devices.clock.sleep(2.0)
    devices.laser.off()
    bench._tones[0].level = bench._tones[0].noise = 0j
    found = lock_in.record(0.05)
    assert np.abs(found.signals).max() < 0.3 * lit
    assert found.times[0] == 0.0
    # Ten rows a time constant, as near as powers of two come to that.
    assert 0.047 < found.times[-1] <= 0.05 + 1e-9


def test_a_full_converter_is_an_overload(made, small) -> None:
    devices, server = made(small, Settings())
    lock_in = devices.lock_in
    lock_in.prepare(time_constant=0.01)
    lock_in.set_frequency(39e6, timeout=1.0)
    assert lock_in.read().overload == Overload.NONE
    server.full = True
    assert lock_in.read().overload == Overload.INPUT


def test_an_hf2li_without_the_option_has_one_frequency(made, small) -> None:
    devices, server = made(small, Settings(), options="PID")
    lock_in = devices.lock_in
    lock_in.prepare(time_constant=0.01)
    assert lock_in.set_frequency(20e6, timeout=1.0) == 20e6
    # The mixer channel that the first oscillator drives without the option.
    assert server.set_nodes["sigouts/0/enables/6"] == 1
    with pytest.raises(InstrumentError, match="1 frequencies at once, asked for are 2"):
        lock_in.set_frequencies([20e6, 30e6], timeout=1.0)
