"""A RunEngine runs a scan, and devices of ophyd-async take one."""

from __future__ import annotations

import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.clock import RealClock, VirtualClock
from amulor.acquisition.connect import connect, simulated_bench
from amulor.acquisition.devices import Devices
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.devices import SimulatedTargetStage
from amulor.errors import InstrumentError
from amulor.simulation import simulate

bluesky = pytest.importorskip("bluesky", reason="pip install 'amulor[bluesky]'")
pytest.importorskip("ophyd_async", reason="pip install 'amulor[bluesky]'")

import event_model  # noqa: E402
import ophyd_bench  # noqa: E402
from bluesky.preprocessors import plan_mutator  # noqa: E402
from bluesky.utils import FailedStatus, RunEngineInterrupted  # noqa: E402

from amulor.acquisition.bluesky import ScanDevice, scan  # noqa: E402
from amulor.acquisition.drivers.ophyd_async import (  # noqa: E402
    OphydLaser,
    OphydLockIn,
    OphydScanner,
)
from amulor.acquisition.links.ophyd_device import (  # noqa: E402
    AsyncLoop,
    OphydDevice,
)

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "add-an-instrument.md"
ONE_FREQUENCY = {
    "instrument.polarizations": ["none"],
    "water.signal_fluctuation": "0 %",
}


@pytest.fixture
def engine():
    found = bluesky.RunEngine(context_managers=[])
    yield found
    if found.state != "idle":
        found.abort()
    found.loop.call_soon_threadsafe(found.loop.stop)
    found._th.join()
    found.loop.close()


@pytest.fixture
def documents(engine) -> list:
    """Return a list that gets every document of the engine, checked by its schema."""
    found: list = []

    def keep(name: str, document: dict) -> None:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(
            document
        )
        found.append((name, dict(document)))

    engine.subscribe(keep)
    return found


def events(documents: list) -> list[tuple]:
    """Return kind, place and in-phase output of each event, in order.

    One that comes twice around a pause has its number again, and replaces the first.
    """
    kinds = {
        document["uid"]: document["name"]
        for name, document in documents
        if name == "descriptor"
    }
    found = {
        (document["descriptor"], document["seq_num"]): (
            kinds[document["descriptor"]],
            *_told(document["data"]),
        )
        for name, document in documents
        if name == "event"
    }
    return [*found.values()]


def _told(data: dict) -> tuple:
    names = ("row", "column", "frequency", "polarization", "repeat", "in_phase")
    return tuple(data[name] for name in names)


def journalled(folder: Path) -> list[tuple]:
    """Return the same of the journal."""
    with Journal.read(folder) as journal:
        return [
            (key.kind, *key[1:], record.in_phase) for _, key, record in journal.newer(0)
        ]


# -- the scan as a plan ----------------------------------------------------------------


def test_a_plan_emits_what_the_journal_holds(tiny, folder, few, engine, documents):
    result = engine(
        scan(tiny, folder, settings=few, scene=scene_light, md={"who": "somebody"})
    )
    found = events(documents)
    assert found == journalled(folder)
    assert {kind for kind, *_ in found} == {"dark", "open_water", "scan"}
    start, stop = documents[0][1], documents[-1][1]
    assert start["who"] == "somebody"
    assert "amulor simulator" in start["identities"]["lock_in"]
    assert (stop["exit_status"], sum(stop["num_events"].values())) == (
        "success",
        len(found),
    )
    assert result == (start["uid"],)
    assert acquisition.recover(folder).exists()


def paused(plan, *places: tuple[str, int]):
    """Return a plan with a pause before the n-th message of a kind, for each place."""
    seen: dict[str, int] = {}

    def change(message):
        seen[message.command] = seen.get(message.command, 0) + 1
        if (message.command, seen[message.command]) not in places:
            return None, None

        def first_a_pause():
            yield bluesky.Msg("pause", None, defer=False)
            return (yield message)

        return first_a_pause(), None

    return plan_mutator(plan, change)


def test_a_pause_puts_the_light_out_and_loses_no_event(
    tiny, folder, few, engine, documents
):
    devices = connect(tiny, few, scene=scene_light)
    # While a dwell is taken, before its event, before the next one.
    places = (("wait", 8), ("save", 20), ("checkpoint", 30))
    plan = scan(tiny, folder, settings=few, devices=devices)
    with pytest.raises(RunEngineInterrupted):
        engine(paused(plan, *places))
    pauses = 1
    while engine.state == "paused":
        assert not devices.laser.bench.laser_on
        try:
            engine.resume()
        except RunEngineInterrupted:
            pauses += 1
    assert pauses == len(places)
    assert events(documents) == journalled(folder)
    with Journal.read(folder) as journal:
        reasons = [part["reason"] for part in journal.segments()]
    assert reasons == ["paused"] * len(places) + ["finished"]
    assert documents[-1][1]["exit_status"] == "success"


@pytest.mark.parametrize(
    "way",
    ["abort", *(pytest.param(way, marks=pytest.mark.slow) for way in ("stop", "halt"))],
)
def test_a_run_that_is_given_up_leaves_all_safe_and_can_be_gone_on_with(
    tiny, folder, few, engine, documents, way
):
    devices = connect(tiny, few, scene=scene_light)
    plan = scan(tiny, folder, settings=few, devices=devices)
    with pytest.raises(RunEngineInterrupted):
        engine(paused(plan, ("wait", 20)))
    getattr(engine, way)()
    assert devices.laser.log[-1] == "off"
    assert not devices.laser.bench.laser_on
    first = events(documents)
    wanted = "success" if way == "stop" else "abort"
    assert documents[-1][1]["exit_status"] == wanted
    # One wait was for the devices; the dwell that was being taken has no event.
    kept = journalled(folder)
    assert len(first) == 18
    assert first == kept[:18]
    engine(scan(tiny, folder, settings=few, scene=scene_light, resume=True))
    whole = journalled(folder)
    assert events(documents) == first + whole[len(kept) :]
    assert acquisition.recover(folder).exists()


def test_a_scan_that_fails_ends_the_run(tiny, folder, engine, documents):
    broken = Settings.model_validate(
        {
            "procedure": {"dark_readings": 2},
            "simulation": {"faults": ["interlock@9x99999"]},
        }
    )
    with pytest.raises(FailedStatus) as caught:
        engine(scan(tiny, folder, settings=broken, scene=scene_light))
    assert "laser is open" in str(caught.value.__cause__)
    assert documents[-1][1]["exit_status"] == "fail"
    assert events(documents) == journalled(folder)
    # Before the run: a folder that holds a scan already.
    with pytest.raises(FailedStatus) as caught:
        engine(scan(tiny, folder, settings=broken, scene=scene_light))
    assert "holds a scan already" in str(caught.value.__cause__)


def test_light_goes_out_while_nobody_asks_for_a_sample(tiny, folder, few):
    devices = connect(tiny, few, scene=scene_light)
    device = ScanDevice(tiny, folder, settings=few, devices=devices, patience=0.2)
    assert device.stage().exception(timeout=240) is None
    assert device.set(10).exception(timeout=240) is None
    with device._changed:
        assert device._changed.wait_for(lambda: device._paused, timeout=240)
    # It was on for the last of them, and nothing but the wait put it out.
    assert [*devices.laser.log][-2:] == ["on", "off"]
    assert not devices.laser.bench.laser_on
    # It goes on as if nothing had been, and ends where it is.
    assert device.set(11).exception(timeout=240) is None
    assert device.unstage().exception(timeout=240) is None
    assert len(journalled(folder)) >= 11
    assert not devices.laser.bench.laser_on
    with pytest.raises(InstrumentError, match="was staged before"):
        device.stage()


LEAVES = """
import sys
from pathlib import Path
from amulor import Survey
from amulor.acquisition import Settings
from amulor.acquisition.bluesky import ScanDevice
from amulor.acquisition.connect import connect
from amulor.simulation import scene_light

survey, settings = Survey.from_toml(sys.argv[1]), Settings()
devices = connect(survey, settings, scene=scene_light)
bench, set_laser = devices.laser.bench, devices.laser.bench.set_laser
bench.set_laser = lambda on: (print("light", on, flush=True), set_laser(on))
device = ScanDevice(survey, Path(sys.argv[2]), settings=settings, devices=devices)
device.stage().exception(240)
assert device.set(20).exception(240) is None
"""


@pytest.mark.slow
def test_a_program_that_just_ends_leaves_no_light_on(tiny, folder) -> None:
    (folder / "tiny.toml").write_text(tiny.to_toml())
    words = [sys.executable, "-c", LEAVES, str(folder / "tiny.toml"), str(folder / "s")]
    found = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert found.returncode == 0, found.stderr
    assert "light True" in found.stdout
    assert found.stdout.splitlines()[-1] == "light False"
    with Journal.read(folder / "s") as journal:
        assert journal.segments()[-1]["ended"] is not None
        assert journal.count() == 20


# -- devices of ophyd-async ------------------------------------------------------------


def page_settings(**procedure: object) -> Settings:
    """Return the devices file of the page, with devices of the tests."""
    import re

    blocks = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL)
    (text,) = (block for block in blocks if '"ophyd_async"' in block)
    content = tomllib.loads(text.replace("my_beamline.devices", "ophyd_bench"))
    content |= {
        "launch": {"driver": "none"},
        "analyser": {"driver": "none"},
        "target": {"driver": "operator"},
        "procedure": {"dark_readings": 3, **procedure},
    }
    return Settings.model_validate(content, context={"from_text": True})


@pytest.mark.parametrize(
    "filter_", [pytest.param(None, marks=pytest.mark.slow), "known"]
)
def test_a_scan_by_devices_of_ophyd_async(tiny, folder, monkeypatch, filter_):
    survey = tiny.with_(ONE_FREQUENCY)
    settings = page_settings(output_filter=filter_, clock_speed=20)
    clock = RealClock(20)
    bench = simulated_bench(survey, settings, scene=scene_light, clock=clock)
    monkeypatch.setattr(ophyd_bench, "BENCH", [bench])
    where = {"out": 0.2, "in": 0.0}

    def ask(text: str) -> None:
        assert not bench.laser_on
        bench.send({"target": where["out" if "out" in text else "in"]}, speed=1e9)

    outcome = acquisition.acquire(survey, folder, settings=settings, ask=ask)
    assert outcome.finished
    assert not outcome.unsafe
    assert not bench.laser_on
    with Journal.read(folder) as journal:
        identities = journal.meta()["identities"]
        cube = acquisition.build(journal)
    assert "serial 7" in identities
    assert "pan, tilt of ophyd-async ophyd_bench:Head" in identities
    truth = simulate(survey, rng=1)
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        pulls = ((cube[name] - expected) / cube[f"{name}_uncertainty"]).values
        assert abs(pulls.mean()) < 5 / np.sqrt(pulls.size)
        assert abs(pulls.std() - 1) < 5 / np.sqrt(2 * pulls.size)
    for angle in ("azimuth", "elevation"):
        # The bench misses by 2 urad.
        np.testing.assert_allclose(
            cube[angle], cube[f"user_commanded_{angle}"], atol=1.2e-5
        )
    # Farther than the axes go: refused before the first move.
    wide = survey.with_({"scan.azimuth_span": "85 deg"})
    with pytest.raises(InstrumentError, match=r"take pan to .*beyond 40 deg"):
        acquisition.acquire(wide, folder / "wide", settings=settings, ask=ask)


def test_devices_of_the_engine_take_a_scan_as_its_plan(
    tiny, folder, monkeypatch, engine, documents
):
    """Both directions at once: they live in the loop of the engine, and it waits."""
    survey = tiny.with_(ONE_FREQUENCY)
    settings = page_settings()
    clock = VirtualClock()
    bench = simulated_bench(survey, settings, scene=scene_light, clock=clock)
    monkeypatch.setattr(ophyd_bench, "BENCH", [bench])
    loop = AsyncLoop(engine.loop)

    async def made() -> tuple:
        # What turns at once needs no clock that runs by itself.
        head = ophyd_bench.Head(speed=float("inf"), name="head")
        detection = ophyd_bench.Detection(name="detection")
        await head.connect()
        await detection.connect()
        return head, detection

    head, detection = (
        OphydDevice(device, loop=loop, timeout=5.0)
        for device in loop.run(made, timeout=5.0)
    )
    options = settings.lock_in.options
    devices = Devices(
        laser=OphydLaser(detection, settings.laser.options),
        lock_in=OphydLockIn(detection, options, clock=clock),
        scanner=OphydScanner(head, settings.scanner, azimuth="pan", elevation="tilt"),
        launch=None,
        analyser=None,
        target=SimulatedTargetStage(bench),
        clock=clock,
    )
    engine(scan(survey, folder, settings=settings, devices=devices))
    assert events(documents) == journalled(folder)
    assert not bench.laser_on
    assert head.device.pan.stops == head.device.tilt.stops >= 1
    # The interlock is asked in every sample with light.
    detection.device.show_closed(False)
    with pytest.raises(InstrumentError, match=r"closed of .* is False"):
        devices.laser.on()
    assert not bench.laser_on


def test_what_fails_is_told_and_left_safe(monkeypatch, tiny):
    settings = page_settings()
    clock = VirtualClock()
    bench = simulated_bench(
        tiny.with_(ONE_FREQUENCY), settings, scene=scene_light, clock=clock
    )
    monkeypatch.setattr(ophyd_bench, "BENCH", [bench])

    def changed(part: str, **options: object) -> Settings:
        content = settings.model_dump(exclude_unset=True)
        content[part]["options"] = {**content[part]["options"], **options}
        return Settings.model_validate(content)

    for part, options, text in (
        ("lock_in", {"x": "z"}, "has no 'z'"),
        ("lock_in", {"what": 1}, "has what that is not known"),
        ("scanner", {"azimuth": "name"}, "cannot be set and located"),
        ("scanner", {"class": "ophyd_bench:Nothing"}, "has no 'Nothing'"),
        ("scanner", {"class": "not_there:Head"}, "cannot be imported"),
        ("laser", {"arguments": {"colour": 1}}, "cannot be connected: TypeError"),
    ):
        before = set(threading.enumerate())
        with pytest.raises(InstrumentError, match=text):
            connect(tiny, changed(part, **options), ask=print)
        # No loop of a device that is not there goes on.
        assert set(threading.enumerate()) <= before
    devices = connect(tiny, settings, ask=print)
    # One scan at a time, although there is no address.
    with pytest.raises(InstrumentError, match="driven by another scan"):
        connect(tiny, settings, ask=print)
    # What sticks is told when the time is over, and can be stopped.
    bench.faults = type(bench.faults).parse(["stuck@0x9999"])
    with pytest.raises(InstrumentError, match=r"not done within 0\.2 s"):
        devices.scanner.move(0.1, 0.1, timeout=0.2)
    devices.laser.on()
    assert devices.make_safe() == []
    assert not bench.laser_on
    devices.close()
