"""Programs of other people drive the simulated instruments, as they would real ones."""

from __future__ import annotations

import contextlib
import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.rehearsal import Rehearsal, rehearse
from amulor.acquisition.settings import Settings
from amulor.simulation import simulate
from amulor.survey import Survey

# What these packages do when they are imported is not ours to judge.
pytestmark = pytest.mark.filterwarnings("ignore")


def client(name: str) -> ModuleType:
    """Return a package of others, or skip the test that needs it."""
    return pytest.importorskip(name, reason=f"pip install --group clients: {name}")


@contextlib.contextmanager
def served(tiny: Survey, model: Any) -> Iterator[Rehearsal]:
    """Serve a lock-in that sees a plate, and stages."""
    survey = tiny.with_({"instrument.modulation_frequencies": ["500 kHz"]})
    with rehearse(survey, Settings(), scene=scene_light, model=model, speed=200) as r:
        yield r


def place(address: str) -> tuple[str, int]:
    """Return host and port of an address."""
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    return host, int(port)


@pytest.fixture
def sr865a(tiny: Survey) -> Iterator[Rehearsal]:
    """Return a simulated SR865A in front of a plate."""
    with served(tiny, "sr865a") as rehearsal:
        yield rehearsal


def adapter(rehearsal: Rehearsal) -> Any:
    """Return a link of pymeasure to the simulated lock-in."""
    host, port = place(rehearsal.settings.lock_in.address or "")
    return client("pymeasure.adapters").VISAAdapter(
        f"TCPIP::{host}::{port}::SOCKET", visa_library="@py", timeout=60_000,
        read_termination="\n", write_termination="\n",
    )  # fmt: skip


@contextlib.contextmanager
def pymeasure_sr860(rehearsal: Rehearsal) -> Iterator[Any]:
    """Return an SR860 of pymeasure."""
    srs = client("pymeasure.instruments.srs")
    link = adapter(rehearsal)
    try:
        yield srs.SR860(link)
    finally:
        link.close()


@contextlib.contextmanager
def makers_sr865a(rehearsal: Rehearsal) -> Iterator[Any]:
    """Return an SR865A of the maker's own package."""
    device = client("srsinst.sr860").SR865A()
    # Not by its own `connect`: that waits for the greeting of a telnet port.
    client("srsgui").Instrument.connect(
        device, "tcpip", *place(rehearsal.settings.lock_in.address or "")
    )
    device.comm.set_timeout(60)
    try:
        yield device
    finally:
        device.disconnect()


def test_pymeasure_configures_an_sr860(sr865a: Rehearsal) -> None:
    with pymeasure_sr860(sr865a) as device:
        assert device.ask("*IDN?").split(",")[1] == "SR865A"
        device.frequency = 5e5
        for name, value in {
            "time_constant": 0.03, "sensitivity": 0.1, "input_range": "300M",
            "reference_source": "INT", "input_coupling": "AC", "input_shields": "Float",
            "input_signal": "VOLT", "input_voltage_mode": "A", "harmonic": 1,
            "filter_synchronous": "Off", "sine_voltage": 0.25, "phase": 12.5,
            "aux_out_2": 1.25, "dcmode": "COM", "reference_triggermode": "SIN",
            "frequencypreset1": 5e4, "parameter_DAT3": 4,
        }.items():  # fmt: skip
            setattr(device, name, value)
            assert getattr(device, name) == value, name
        assert device.frequency == device.internalfrequency == 5e5
        # 6 dB per octave: a quarter of the inverse time constant.
        assert device.get_noise_bandwidth == pytest.approx(1 / (4 * 0.03))
        assert int(device.ask("*ESR?")) == 0


def light(rehearsal: Rehearsal) -> None:
    """Let light out, and let the filter settle."""
    rehearsal.bench.set_laser(True)
    rehearsal.bench.clock.sleep(1.0)


def test_pymeasure_reads_an_sr860_in_all_forms(sr865a: Rehearsal) -> None:
    with pymeasure_sr860(sr865a) as device:
        device.frequency, device.time_constant = 5e5, 0.01
        # What was sent has been done when a question after it is answered.
        assert device.time_constant == 0.01
        light(sr865a)
        signal, mean = sr865a.bench.output()
        # In volts rms, the phase falling with delay; 30 standard deviations of noise.
        noise = 30 * sr865a.bench.noise
        expected = signal.conjugate() / math.sqrt(2)
        assert abs(complex(device.x, device.y) - expected) < noise
        assert device.magnitude == pytest.approx(abs(expected), abs=noise)
        assert device.theta == pytest.approx(
            math.degrees(np.angle(expected)), abs=math.degrees(noise / abs(expected))
        )
        assert device.aux_in_1 == pytest.approx(mean, rel=1e-6)
        assert device.aux_in_3 == 0
        for codes in (
            ("X", "Y"),
            ("THeta", "IN1", "FInt"),
            (0, 1, 15),
            ("R", "XNOise"),
        ):
            assert len(device.snap(*codes)) == len(codes)
        assert device.snap("IN1", "FInt") == [pytest.approx(mean), 5e5]
        assert device.snap("SAMp", "PHAse") == [1e-9, 0]
        four = device.snap_all()
        assert math.hypot(*four[:2]) == pytest.approx(four[2])
        # The phase is that of the reference: what it is turned by comes off.
        device.phase = device.theta
        assert abs(device.theta) < math.degrees(noise / abs(expected))


def test_the_makers_package_configures_and_reads_an_sr865a(sr865a: Rehearsal) -> None:
    with makers_sr865a(sr865a) as device:
        assert device.check_id()[0] == "SR865A"
        device.ref.frequency, device.signal.time_constant = 5e5, 0.01
        device.signal.voltage_sensitivity = 0.2
        device.ref.reference_source = "internal"
        device.ref.sine_out_amplitude = 0.5
        assert device.ref.frequency == device.ref.internal_frequency == 5e5
        assert device.signal.time_constant == 0.01
        assert device.signal.voltage_sensitivity == 0.2
        assert device.ref.sine_out_amplitude == 0.5
        # Its output 0 is the first one of the panel: the laser's gate.
        device.aux.output[0] = 5.0
        assert device.aux.output[0] == 5.0
        assert sr865a.bench.laser_on
        sr865a.bench.clock.sleep(1.0)
        x, y = device.data.get_values("X", "Y")
        assert math.hypot(x, y) == pytest.approx(
            device.data.value["R"], abs=30 * sr865a.bench.noise
        )
        assert len(device.data.get_channel_values()) == 4
        assert device.aux.input[0] == pytest.approx(sr865a.bench.output()[1])
        device.aux.output[0] = 0.0
        # A command is not answered: what came before a question has been done by then.
        assert device.aux.output[0] == 0.0
        assert not sr865a.bench.laser_on


def test_the_makers_package_reads_the_status_of_an_sr865a(sr865a: Rehearsal) -> None:
    with makers_sr865a(sr865a) as device:
        device.comm.send("*CLS")
        assert device.status.get_status_text() == "OK"
        # A new frequency unlocks, and that latches: bit 3, told once.
        device.ref.frequency = 5e5
        assert device.ref.frequency == 5e5
        sr865a.bench.clock.sleep(1.0)
        assert device.status.lock_in_bit["UNLK"]
        assert device.status.lock_in == 0
        # What is no command is bit 5, what is no value bit 4 of the events.
        device.comm.send("NOSUCH 1")
        device.comm.send("OFLT 99")
        assert device.status.event == 32 + 16
        assert device.status.event == 0
        # An event that is waited for shows in the status byte until it was read.
        device.status.event_enable = 32
        device.comm.send("NOSUCH 1")
        assert device.status.serial_poll == 32
        assert device.status.event_bit["CMD"]
        assert device.status.serial_poll == 0


def test_pymeasure_reads_an_sr844_by_what_it_shares_with_an_sr830(
    tiny: Survey,
) -> None:
    srs = client("pymeasure.instruments.srs")
    with served(tiny, "sr844") as rehearsal:
        link = adapter(rehearsal)
        try:
            device = srs.SR830(link)
            device.write("FREQ 500000")
            device.write("OFLT 4")
            device.write("SENS 14")
            assert device.ask("*ESR?").strip() == "0"
            light(rehearsal)
            signal, mean = rehearsal.bench.output()
            expected = signal.conjugate() / math.sqrt(2)
            noise = 30 * rehearsal.bench.noise
            assert device.frequency == 5e5
            assert abs(complex(device.x, device.y) - expected) < noise
            # R in volts is 3, in dBm 4; 1 mW in 50 ohm is 0.224 V.
            assert device.magnitude == pytest.approx(abs(expected), abs=noise)
            assert 10 ** (float(device.ask("OUTP? 4")) / 20) * 0.2236 == pytest.approx(
                abs(expected), rel=0.02
            )
            assert abs(complex(*device.xy) - expected) < noise
            six = [float(v) for v in device.ask("SNAP? 1,2,3,5,6,8").split(",")]
            assert six[4:] == [pytest.approx(mean), 5e5]
            assert float(device.ask("AUXI? 1")) == pytest.approx(mean)
            # One value is none of the forms of SNAP?, nor are seven.
            device.write("SNAP? 1")
            assert device.ask("*ESR? 4").strip() == "1"
        finally:
            link.close()


@pytest.fixture
def stages(tiny: Survey) -> Iterator[tuple[Any, Rehearsal]]:
    """Return a simulated controller as PIPython sees it."""
    gateway = client("pipython.pidevice.interfaces.pisocket")
    messages = client("pipython.pidevice.gcsmessages")
    commands = client("pipython.pidevice.gcscommands")
    with served(tiny, "sr844") as rehearsal:
        link = gateway.PISocket(*place(rehearsal.settings.scanner.address or ""))
        device = commands.GCSCommands(messages.GCSMessages(link))
        try:
            yield device, rehearsal
        finally:
            # A later link would otherwise ask this one who it is.
            link.unregister_connection_status_changed_callback(
                device.connection_status_changed
            )
            link.close()


def test_pipython_starts_and_moves_the_stages(stages: tuple[Any, Rehearsal]) -> None:
    device, rehearsal = stages
    tools = client("pipython.pitools")
    assert "Physik Instrumente" in device.qIDN()
    tools.startup(device, refmodes="FRF")
    axes = device.axes
    assert axes == ["1", "2", "3", "4", "5"]
    assert all(device.qSVO().values())
    assert all(device.qFRF().values())
    assert device.IsControllerReady()
    low, high = device.qTMN(), device.qTMX()
    device.MOV({"1": high["1"] / 9, "2": low["2"] / 9})
    tools.waitontarget(device, axes=["1", "2"], timeout=120)
    assert not any(device.IsMoving().values())
    # What the scanner misses by is 2 urad, 1e-4 degrees.
    assert device.qPOS("1")["1"] == pytest.approx(high["1"] / 9, abs=1e-3)
    assert math.degrees(rehearsal.bench.place("elevation")) == pytest.approx(
        low["2"] / 9, abs=1e-3
    )
    device.MVR("5", 2.5)
    tools.waitontarget(device, axes="5", timeout=120)
    assert device.qPOS("5")["5"] == pytest.approx(2.5)
    assert device.qMOV("5")["5"] == pytest.approx(2.5)


def test_pipython_is_told_errors_as_the_manual_says(
    stages: tuple[Any, Rehearsal],
) -> None:
    device, rehearsal = stages
    error = client("pipython.pidevice.gcserror")
    for code, words in (
        (error.E7_PI_CNTR_POS_OUT_OF_LIMITS, "MOV 1 1000"),
        (error.E15_PI_CNTR_INVALID_AXIS_IDENTIFIER, "MOV 9 0"),
        (error.E2_PI_CNTR_UNKNOWN_COMMAND, "JMP 1"),
        (error.E1_PI_CNTR_PARAM_SYNTAX, "MOV 1 far"),
    ):
        with pytest.raises(error.GCSError) as raised:
            device.send(words)
        assert raised.value.val == code
    device.SVO("1", False)
    with pytest.raises(error.GCSError) as raised:
        device.MOV("1", 0.1)
    assert raised.value.val == error.E5_PI_CNTR_MOVE_WITHOUT_REF_OR_NO_SERVO
    device.SVO("1", True)
    # Slowly, so that it can be stopped on the way.
    device.VEL("5", 0.001)
    device.MOV("5", 100)
    assert device.IsMoving("5")["5"]
    device.StopAll(noraise=True)
    assert not device.IsMoving("5")["5"]
    assert not device.qONT("5")["5"] or device.qPOS("5")["5"] < 1
    assert not rehearsal.bench.laser_on


# -- pymeasure as a device -------------------------------------------------------------


def test_an_instrument_of_pymeasure_takes_a_scan(tiny, folder) -> None:
    client("pymeasure.instruments.srs")
    page = Path(__file__).parents[3] / "docs" / "how-to" / "add-an-instrument.md"
    blocks = re.findall(r"```toml\n(.*?)```", page.read_text("utf-8"), flags=re.DOTALL)
    (text,) = (block for block in blocks if 'driver = "pymeasure"' in block)
    tiny = tiny.with_(
        {
            "instrument.modulation_frequencies": ["500 kHz"],
            "water.signal_fluctuation": "0 %",
        }
    )
    wanted = Settings.model_validate({"procedure": {"dark_readings": 3}})
    with rehearse(
        tiny, wanted, scene=scene_light, model="sr865a", speed=30
    ) as rehearsal:
        host, port = place(rehearsal.settings.lock_in.address or "")
        content = rehearsal.settings.model_dump(mode="json", exclude_unset=True)
        content["lock_in"] = tomllib.loads(text)["lock_in"]
        content["lock_in"]["address"] = f"TCPIP::{host}::{port}::SOCKET"
        del content["laser"]["interlock_input"]  # pymeasure reads no auxiliary input
        settings = Settings.model_validate(content, context={"from_text": True})
        outcome = acquisition.acquire(tiny, folder, settings=settings)
        assert not rehearsal.bench.laser_on
    assert outcome.finished
    with Journal.read(folder) as journal:
        cube = acquisition.build(journal)
    truth = simulate(tiny, rng=1)
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        pulls = ((cube[name] - expected) / cube[f"{name}_uncertainty"]).values
        assert abs(pulls.mean()) < 5 / np.sqrt(pulls.size)
        assert abs(pulls.std() - 1) < 5 / np.sqrt(2 * pulls.size)
