"""Rules of the devices file: what each driver needs, and what it cannot have."""

from __future__ import annotations

import math
from typing import Any

import pytest
from device_files import LINKED, device_sections
from pydantic import ValidationError

from amulor.acquisition.settings import (
    LaserSettings,
    LockInSettings,
    NavigationSettings,
    Procedure,
    ScannerSettings,
    Settings,
    TargetSettings,
)
from amulor.acquisition.settings.devices_file import MountSettings
from amulor.acquisition.settings.parts import PanTiltSettings, SourceSettings

OPHYD = {"driver": "ophyd_async", "options": {"class": "a:B"}}
SCPI = {
    "driver": "scpi", **LINKED,
    "scpi": {"time_constant": "TC {value}", "read": "SNAP? 0,1", "scales": ["1 V"]},
}  # fmt: skip
SR865A = {"driver": "sr865a", **LINKED, "modulation_amplitude": "0.5 V"}


def scpi(**changes: Any) -> dict[str, Any]:
    return {**SCPI, "scpi": {**SCPI["scpi"], **changes}}


@pytest.mark.parametrize(
    ("kind", "content", "text"),
    [
        (ScannerSettings, {"driver": "pi_gcs", **LINKED}, None),
        (ScannerSettings, {"driver": "pi_gcs"}, "scanner.address"),
        (ScannerSettings, {"driver": "pelco_d"}, "scanner.address"),
        (ScannerSettings, {"driver": "analog"}, "scanner.analog"),
        (ScannerSettings, OPHYD, None),
        (ScannerSettings, {"driver": "ophyd_async"}, "scanner.options"),
        (ScannerSettings, {"angle_per_unit": 1.1e-9}, None),
        (ScannerSettings, {"angle_per_unit": -1.1e-9}, None),
        (
            ScannerSettings, {"angle_per_unit": 0.9e-9},
            "scanner.angle_per_unit, not 0 but 1e-09 rad at least,",
        ),
        (ScannerSettings, {"park_azimuth": 0.0, "park_elevation": 0.1}, None),
        (
            ScannerSettings, {"park_azimuth": 0.0},
            "both or none of scanner.park_azimuth and scanner.park_elevation",
        ),
        (MountSettings, {"driver": "none"}, None),
        (MountSettings, {"driver": "pi_gcs"}, "address of a mount"),
        (TargetSettings, {"driver": "operator"}, None),
        (TargetSettings, {"driver": "pi_gcs"}, "target.address"),
        (LaserSettings, {"driver": "lock_in_output"}, None),
        (LaserSettings, {"driver": "scpi", "scpi": {}}, "laser.address"),
        (LaserSettings, {"driver": "scpi", **LINKED}, "laser.scpi"),
        (LaserSettings, {"driver": "scpi", "scpi": {}, **LINKED}, None),
        (LaserSettings, {"driver": "ophyd_async"}, "laser.options"),
        (SourceSettings, {"driver": "scpi", "amplitude": "1 V"}, "source.address"),
        (SourceSettings, {"driver": "scpi", **LINKED}, "source.amplitude"),
        (SourceSettings, {"driver": "scpi", "amplitude": "1 V", **LINKED}, None),
        (NavigationSettings, {**LINKED, "crs": "EPSG:32632"}, None),
        (NavigationSettings, {"crs": "EPSG:32632"}, "navigation.address"),
        (NavigationSettings, LINKED, "navigation.crs"),
        (
            NavigationSettings, {**LINKED, "crs": "EPSG:32632", "clock": "relative"},
            'navigation.clock = "unix"',
        ),
        *[
            (LockInSettings, {**SR865A, "address": None, "driver": driver},
             "lock_in.address")
            for driver in ("sr865a", "zurich")
        ],
        (LockInSettings, {"driver": "sr844"}, "lock_in.address"),
        (LockInSettings, {"driver": "scpi", **LINKED}, "lock_in.scpi"),
        (LockInSettings, {**SCPI, "address": None}, "lock_in.address"),
        (LockInSettings, SCPI, None),
        (LockInSettings, {"driver": "ophyd_async"}, "lock_in.options"),
        (LockInSettings, {"driver": "digitiser"}, None),
        (
            LockInSettings, scpi(time_constant="TC {code}"),
            "lock_in.scpi.time_constants",
        ),
        (
            LockInSettings,
            scpi(time_constant="TC {code}", time_constants=["1 ms"]), None,
        ),
        (
            LockInSettings, scpi(output="AUXV"),
            "both or none of lock_in.scpi.output and output_read",
        ),
        (LockInSettings, scpi(output="AUXV", output_read="AUXV?"), None),
        *[
            (LockInSettings, scpi(**{bits: 4}), "lock_in.scpi.status")
            for bits in ("input_overload", "output_overload", "unlocked")
        ],
        (LockInSettings, scpi(unlocked=4, status="LIAS?"), None),
        (PanTiltSettings, {"lowest_pan": -1.0, "highest_pan": 1.0}, None),
        (
            PanTiltSettings, {"lowest_pan": -1.0},
            "both or none of scanner.pan_tilt.lowest_pan and highest_pan",
        ),
        (
            PanTiltSettings, {"highest_tilt": 1.0},
            "both or none of scanner.pan_tilt.lowest_tilt and highest_tilt",
        ),
    ],
)  # fmt: skip
def test_a_driver_needs_its_settings(kind, content, text) -> None:
    if text is None:
        kind.model_validate(content)
        return
    with pytest.raises(ValidationError) as caught:
        kind.model_validate(content)
    (error,) = caught.value.errors()
    assert error["msg"] == f"Value error, {text} is needed; state it"


@pytest.mark.parametrize(
    ("kind", "content", "text"),
    [
        (
            LockInSettings, {"driver": "sr865a", **LINKED},
            "lock_in.modulation_amplitude is needed: what the modulation input of the "
            'laser takes, such as "0.5 V"',
        ),
        (
            LockInSettings,
            {"driver": "sr844", **LINKED, "modulation_amplitude": "1 V"},
            "the driver 'sr844' cannot set lock_in.modulation_amplitude; take it out",
        ),
        (
            LockInSettings, {"driver": "sr844", **LINKED, "input_range": "1 V"},
            "the driver 'sr844' cannot set lock_in.input_range; take it out",
        ),
        (
            LockInSettings, {**SR865A, "input_range": "0.2 V"},
            "lock_in.input_range is 0.2 V, an SR865A has 1 V, 300 mV, 100 mV, 30 mV "
            "and 10 mV; state one of them",
        ),
        (
            LockInSettings, {"driver": "digitiser", "mean_output_input": 1},
            "the driver 'digitiser' has no auxiliary inputs; take "
            "lock_in.mean_output_input out",
        ),
        (
            LockInSettings, {"driver": "sr844", **LINKED, "mean_output_input": 3},
            "the driver 'sr844' has auxiliary inputs 1 to 2, stated is "
            "mean_output_input = 3; wire another one",
        ),
        (
            PanTiltSettings, {"lowest_tilt": 0.1, "highest_tilt": 0.1},
            f"lowest_tilt ({math.degrees(0.1):g} deg) must be less than highest_tilt "
            f"({math.degrees(0.1):g} deg)",
        ),
        (
            Procedure, {"mode": "continuous", "output_filter": "known"},
            'mode = "continuous" takes off what the filter holds of the pixel before, '
            'from a record without gaps; set output_filter = "known" and readings = '
            '"buffer" beside it',
        ),
        (
            Procedure, {"mode": "continuous", "readings": "buffer"},
            'mode = "continuous" takes off what the filter holds of the pixel before, '
            'from a record without gaps; set output_filter = "known" and readings = '
            '"buffer" beside it',
        ),
        (
            Procedure,
            {"mode": "continuous", "readings": "buffer", "output_filter": "known",
             "settled_by": "samples"},
            "settled_by is 'samples', but with mode = \"continuous\" nothing settles; "
            "leave settled_by out",
        ),
        (
            Procedure, {"run_up": "10 ms"},
            'run_up is that of mode = "continuous"; state both, or take it out',
        ),
    ],
)  # fmt: skip
def test_what_a_driver_or_procedure_cannot_have_is_said(kind, content, text) -> None:
    with pytest.raises(ValidationError) as caught:
        kind.model_validate(content)
    (error,) = caught.value.errors()
    assert error["msg"] == f"Value error, {text}"


@pytest.mark.parametrize(
    ("driver", "number"), [("sr844", 2), ("sr865a", 4), ("zurich", 2), ("scpi", 4)]
)
def test_the_last_input_of_a_lock_in_can_be_wired(driver, number) -> None:
    content = {"sr844": {"driver": "sr844", **LINKED}, "scpi": SCPI}.get(
        driver, {**SR865A, "driver": driver}
    )
    found = LockInSettings.model_validate({**content, "mean_output_input": number})
    assert found.mean_output_input == number
    for value in (1.0, 0.3, 0.1, 0.03, 0.01):
        LockInSettings.model_validate({**SR865A, "input_range": value})


OWN = "laser and shutter need outputs of their own among 1 to {last} of the lock-in, "


@pytest.mark.parametrize(
    ("parts", "text"),
    [
        ({}, None),
        ({"laser": {"driver": "lock_in_output", "output": 2}}, None),
        (
            {"laser": {"driver": "lock_in_output", "output": 3}},
            "the lock-in 'sr844' has auxiliary outputs 1 to 2, stated is laser.output "
            "= 3; wire another one",
        ),
        ({"shutter": {"driver": "lock_in_output", "output": 2}}, None),
        ({"shutter": {"driver": "operator"}}, None),
        (
            {"shutter": {"driver": "lock_in_output", "output": 1}},
            OWN.format(last=2) + "stated is shutter.output = 1",
        ),
        (
            {"shutter": {"driver": "lock_in_output", "output": 3}},
            OWN.format(last=2) + "stated is shutter.output = 3",
        ),
        (
            {
                "lock_in": SR865A,
                "shutter": {"driver": "lock_in_output", "output": 4},
            },
            None,
        ),
        (
            {"shutter": {"driver": "simulated"}},
            "shutter simulated, lock_in, scanner, laser not: embedded simulated "
            "devices see one scene together and cannot work beside others; set every "
            'driver, mounts without a motor to "none"',
        ),
        (
            {"analyser": {}, "launch": {}},
            "launch, analyser simulated, lock_in, scanner, laser not: embedded "
            "simulated devices see one scene together and cannot work beside others; "
            'set every driver, mounts without a motor to "none"',
        ),
        (
            {"procedure": {"shutter_readings": 1}},
            "shutter is needed; state it",
        ),
        ({"procedure": {"shutter_readings": 0}}, None),
    ],
)  # fmt: skip
def test_parts_of_a_devices_file_fit_together(parts, text) -> None:
    content = device_sections(**parts)
    if text is None:
        assert not Settings.model_validate(content).simulated
        return
    with pytest.raises(ValidationError) as caught:
        Settings.model_validate(content)
    (error,) = caught.value.errors()
    assert error["msg"] == f"Value error, {text}"


def test_a_shutter_is_read_five_times_unless_stated() -> None:
    for procedure, readings in (({}, 5), ({"shutter_readings": 2}, 2)):
        content = {"shutter": {}, "procedure": procedure}
        assert Settings.model_validate(content).procedure.shutter_readings == readings
    for procedure, readings in ((Procedure(settling=7), 5),
                                (Procedure(shutter_readings=3), 3)):  # fmt: skip
        found = Settings.model_validate({"shutter": {}, "procedure": procedure})
        assert found.procedure.shutter_readings == readings
        assert found.procedure.settling == procedure.settling
    assert Settings().simulated
    with pytest.raises(ValidationError):
        Settings.model_validate({"shutter": {}, "procedure": 5})
