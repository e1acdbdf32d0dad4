"""Devices files are read strictly, and say what is wrong in one line each."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from amulor.acquisition import settings
from amulor.acquisition.clock import RealClock
from amulor.acquisition.devices import digest
from amulor.acquisition.settings import Settings
from amulor.errors import InstrumentError

REAL = """
[lock_in]
driver = "sr844"
address = "GPIB0::8::INSTR"
mean_output_input = 1
[scanner]
driver = "pi_gcs"
address = "tcp://10.0.0.5:50000"
angle_per_unit = "2 deg"
[launch]
driver = "none"
[analyser]
driver = "pi_gcs"
address = "tcp://10.0.0.5:50000"
axis = "3"
angles = { V = "1.5 deg", H = "91.5 deg" }
[laser]
driver = "lock_in_output"
warm_up = "2 s"
[target]
driver = "operator"
[procedure]
references = 5
"""


def read(tmp_path: Path, text: str) -> Settings:
    path = tmp_path / "devices.toml"
    path.write_text(text)
    return Settings.from_toml(path)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    settings = read(tmp_path, REAL)
    assert settings.analyser.angles["H"] == pytest.approx(1.597, abs=1e-3)
    assert settings.scanner.angle_per_unit == pytest.approx(0.0349, abs=1e-4)
    assert read(tmp_path, settings.to_toml()) == settings
    assert read(tmp_path, "") == Settings()


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('address = "GPIB0::8::INSTR"', "", r"lock_in\.address is needed"),
        ("references = 5", "refernces = 5", "did you mean 'references'"),
        ("references = 5", "references = 0", "references"),
        ('driver = "sr844"', 'driver = "sr830"', "driver"),
        ('warm_up = "2 s"', "warm_up = 2", "without a unit"),
        ('driver = "operator"', 'driver = "simulated"', "set every driver"),
        ("angles = { V", "angles = { X", "angles"),
        ('angle_per_unit = "2 deg"', 'angle_per_unit = "0 deg"', "not 0"),
        ("[procedure]", '[simulation]\nfaults = ["fire@3"]\n[procedure]', "faults"),
        ("[launch]", "[launch", "no valid TOML"),
        ("references = 5", "refernces = 5", "is no field of a devices file"),
        ('axis = "3"', 'axis = "a b"', "needed is: Axis of the controller"),
        (
            "mean_output_input = 1",
            "mean_output_input = 3",
            r"lock_in: the driver 'sr844' has auxiliary inputs 1 to 2.*= 3",
        ),
        (
            'driver = "sr844"',
            'driver = "sr865a"',
            r"lock_in\.modulation_amplitude is needed",
        ),
        (
            "mean_output_input = 1",
            'modulation_amplitude = "0.5 V"',
            "'sr844' cannot set lock_in.modulation_amplitude",
        ),
        (
            'warm_up = "2 s"',
            "output = 3",
            "'sr844' has auxiliary outputs 1 to 2.*laser.output = 3",
        ),
    ],
)
def test_a_mistake_is_named(tmp_path: Path, old: str, new: str, text: str) -> None:
    assert old in REAL
    with pytest.raises(InstrumentError, match=text):
        read(tmp_path, REAL.replace(old, new))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InstrumentError, match="cannot be read"):
        Settings.from_toml(tmp_path / "none.toml")


def test_the_digest_knows_the_instrument_and_not_its_place(tmp_path: Path) -> None:
    settings, who = read(tmp_path, REAL), {"lock_in": "SR844"}
    same = REAL.replace("GPIB0::8::INSTR", "GPIB0::9::INSTR").replace("10.0.0.5", "a")
    assert digest(read(tmp_path, same), who) == digest(settings, who)
    # Nor does it matter how much is put up with before a scan stops.
    patient = REAL + "patience = 500\nattempts = 9\n"
    assert digest(read(tmp_path, patient), who) == digest(settings, who)
    for other in (
        REAL.replace('"91.5 deg"', '"90 deg"'),
        REAL.replace("references = 5", "references = 6"),
        REAL.replace('"2 deg"', '"1 deg"'),
    ):
        assert digest(read(tmp_path, other), who) != digest(settings, who)
    assert digest(settings, {"lock_in": "SR844 s/n 2"}) != digest(settings, who)


def test_the_devices_file_of_the_manual_is_one(tmp_path: Path) -> None:
    folder = Path(__file__).parents[3] / "docs" / "how-to"
    pages = [folder / name for name in ("first-light.md", "fast-scans.md")]
    text = "\n".join(page.read_text("utf-8") for page in pages)
    blocks = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (whole,) = (block for block in blocks if block.startswith("[lock_in]"))
    # The others are parts of one, which a file of simulated devices can have, too.
    for block in blocks:
        if block != whole:
            assert read(tmp_path, block).procedure.readings == "buffer"
    settings = read(tmp_path, whole)
    assert settings.lock_in.driver == "sr844"
    assert not settings.simulated


def test_the_digest_is_of_the_settings_that_say_something() -> None:
    mute = Settings.model_validate(
        {"lock_in": {"options": None}, "laser": {"interlock_input": None}}
    )
    assert digest(mute, {}) == digest(Settings(), {})
    watched = Settings.model_validate({"laser": {"interlock_input": 2}})
    assert digest(watched, {}) != digest(Settings(), {})


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("simulation", "speed", 1e-12),
        ("simulation", "speed", 5e-324),
        ("procedure", "clock_speed", 1e-12),
        ("simulation", "cable_delay", "1e300 s"),
        ("simulation", "pickup", "1e300 V"),
        ("simulation", "phase_drift", "1e300 rad"),
        ("simulation", "phase_walk", "1e300 rad"),
        ("simulation", "position_error", "-1 rad"),
        ("simulation", "position_error", "1e300 rad"),
        ("scanner", "angle_per_unit", "1e-300 rad"),
        ("scanner", "angle_per_unit", "1e300 rad"),
        ("procedure", "run_up", "1e9 s"),
    ],
)
def test_numbers_that_no_device_has_are_refused_by_name(
    tmp_path, part, name, value
) -> None:
    shown = f'"{value}"' if isinstance(value, str) else repr(value)
    path = tmp_path / "devices.toml"
    path.write_text(f"[{part}]\n{name} = {shown}\n")
    with pytest.raises(InstrumentError, match=rf"{part}(\.{name})?") as caught:
        Settings.from_toml(path)
    assert len(str(caught.value).splitlines()) <= 2


def test_only_an_sr865a_has_input_ranges_and_only_its_own(tmp_path) -> None:
    def stated(value: str, driver: str = "sr865a") -> str:
        words = f'driver = "{driver}"\ninput_range = "{value}"\n'
        words += 'modulation_amplitude = "0.5 V"\n' * (driver == "sr865a")
        return REAL.replace('driver = "sr844"\n', words)

    found = read(tmp_path, stated("30 mV"))
    assert found.lock_in.input_range == pytest.approx(0.03)
    assert digest(found, {}) != digest(read(tmp_path, stated("0.3 V")), {})
    for wrong, message in (
        (stated("50 mV"), r"0\.05 V, an SR865A has 1 V, 300 mV"),
        (stated("1 V", "sr844"), "'sr844' cannot set lock_in.input_range"),
    ):
        with pytest.raises(InstrumentError, match=message):
            read(tmp_path, wrong)


def test_a_clock_that_seems_to_stand_is_refused() -> None:
    for speed in (0.0, 1e-12, -1.0, float("nan"), 1e7):
        with pytest.raises(ValueError, match="speed must be above 0"):
            RealClock(speed)


def test_the_package_lists_its_public_names_only() -> None:
    assert dir(settings) == sorted(settings.__all__)
    assert "Settings" in dir(settings)
