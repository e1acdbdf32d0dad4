"""Readings with a closed shutter: leakage is measured, subtracted and stated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition import plan
from amulor.acquisition.connect import LockInShutter, OperatorShutter, connect
from amulor.acquisition.cube.calibration import Calibration
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings, ShutterSettings
from amulor.errors import InstrumentError
from amulor.survey import Survey

#: Crosstalk of the bench, in phase [V].
LEAK = 5e-5


@pytest.fixture(scope="module")
def noisy(small: Survey) -> Survey:
    """Return the small survey with a detector that is noisy in darkness."""
    return small.with_({"instrument.detector.dark_rate": "1e8 1/s"})


def with_shutter(settings: Settings, made, **simulation: object) -> Settings:
    return made(
        settings,
        shutter={"driver": "simulated"},
        procedure={"shutter_readings": 4},
        simulation=simulation,
    )


def test_a_shutter_is_read_before_and_after_the_scan(
    noisy, settings, made, folder, cube_of
) -> None:
    leaking = with_shutter(settings, made, leakage=LEAK)
    acquisition.acquire(noisy, folder / "a", settings=leaking, scene=scene_light)
    kinds = []
    with Journal.read(folder / "a") as journal:
        entries = [
            (record.elapsed, kind, key, record)
            for kind in (plan.DARK, plan.SHUTTER, plan.OPEN_WATER, plan.SCAN)
            for key, record in journal.samples(kind)
        ]
    for _, kind, _, record in sorted(entries, key=lambda entry: entry[0]):
        kinds += [kind] if kinds[-1:] != [kind] else []
        assert not record.flags & SampleFlag.NO_LIGHT
    block = [plan.DARK, plan.SHUTTER, plan.OPEN_WATER]
    assert kinds == [*block, plan.SCAN, *block]
    closed = [record for _, kind, _, record in entries if kind == plan.SHUTTER]
    # Two channels, two times, four readings.
    assert len(closed) == 16
    cube = cube_of(folder / "a")
    calibration = Calibration.from_text(cube.attrs["calibration"])
    for leak in calibration.leakage:
        expected = np.array([LEAK, 0.0])
        error = max(leak.scan_uncertainty, 1e-12)
        assert np.all(np.abs(np.array(leak.scan) - expected) < 5 * error)
        assert leak.scan == leak.open_water
        assert leak.change is not None
    # The same seed without crosstalk, and without readings of the shutter.
    clean = with_shutter(settings, made)
    acquisition.acquire(noisy, folder / "b", settings=clean, scene=scene_light)
    other = cube_of(folder / "b")
    difference = float(np.abs(cube["in_phase"] - other["in_phase"]).max())
    assert difference < 0.1 * LEAK
    volt = cube.attrs["leakage_uncertainty_volt"]
    assert difference < 5 * float(np.max(volt))


def test_readings_of_a_scan_replace_the_leakage_of_a_file(
    small, settings, made, folder
) -> None:
    leaking = with_shutter(settings, made, leakage=LEAK)
    acquisition.acquire(small, folder, settings=leaking, scene=scene_light)
    with Journal.read(folder) as journal:
        cube = acquisition.build(journal)
        before = Calibration.from_text(cube.attrs["calibration"])
        old = before.model_copy(
            update={
                "leakage": tuple(
                    leak.model_copy(update={"scan": (1.0, 1.0)})
                    for leak in before.leakage
                )
            }
        )
        again = acquisition.build(journal, calibration=old)
    assert again.attrs["calibration"] == cube.attrs["calibration"]
    assert_allclose(again["in_phase"], cube["in_phase"])


def test_a_scan_with_a_closed_shutter_is_the_leakage(
    noisy, settings, made, folder, cube_of
) -> None:
    leaking = made(settings, simulation={"leakage": LEAK})
    outcome = acquisition.acquire(
        noisy, folder, settings=leaking, scene=scene_light, shutter_closed=True
    )
    assert outcome.finished
    assert outcome.flagged == 0
    cube = cube_of(folder)
    assert cube.attrs["shutter"] == "closed"
    calibration = acquisition.from_shutter([cube])
    for leak in calibration.leakage:
        for part in ("scan", "open_water"):
            error = getattr(leak, f"{part}_uncertainty")
            off = np.array(getattr(leak, part)) - [LEAK, 0.0]
            assert np.all(np.abs(off) < 5 * error)
            assert error < 0.1 * LEAK


def test_a_closed_scan_is_resumed_closed(small, settings, made, folder, Stop) -> None:
    leaking = made(settings, simulation={"leakage": LEAK})
    first = acquisition.acquire(
        small, folder, settings=leaking, scene=scene_light, shutter_closed=True,
        control=Stop(20, go_on=False),
    )  # fmt: skip
    assert not first.finished
    acquisition.acquire(small, folder, settings=leaking, scene=scene_light, resume=True)
    with Journal.read(folder) as journal:
        cube = acquisition.build(journal)
    assert cube.attrs["shutter"] == "closed"
    assert float(np.abs(cube["in_phase"]).max()) < 3 * LEAK


def test_an_open_scan_does_not_go_on_closed(small, settings, folder, Stop) -> None:
    acquisition.acquire(
        small, folder, settings=settings, scene=scene_light,
        control=Stop(20, go_on=False),
    )  # fmt: skip
    with pytest.raises(InstrumentError, match="began with an open shutter"):
        acquisition.acquire(
            small, folder, settings=settings, scene=scene_light, resume=True,
            shutter_closed=True,
        )  # fmt: skip


def test_a_shutter_is_closed_in_the_end(small, settings, made, folder, safe) -> None:
    own = with_shutter(settings, made)
    devices = connect(small, own, scene=scene_light)
    acquisition.acquire(small, folder, settings=own, devices=devices)
    assert safe(devices)
    assert devices.shutter.bench.shutter_closed


class Outputs:
    """A lock-in with an output that stays at 0 V if it is stuck."""

    def __init__(self, *, stuck: bool) -> None:
        self.stuck, self.set = stuck, []

    def identity(self) -> str:
        return "a lock-in"

    def set_output(self, number: int, voltage: float) -> float:
        self.set.append((number, voltage))
        return 0.0 if self.stuck else voltage


def test_an_output_of_the_lock_in_moves_the_shutter(clock) -> None:
    part = ShutterSettings(driver="lock_in_output", output=3, move_time=0.5)
    lock_in = Outputs(stuck=False)
    shutter = LockInShutter(lock_in, part, clock)
    begun = clock.now()
    shutter.open()
    shutter.shut()
    shutter.make_safe()
    assert lock_in.set == [(3, 5.0), (3, 0.0), (3, 0.0)]
    assert_allclose(clock.now() - begun, 1.5)
    assert shutter.identity() == "output 3 of a lock-in"
    with pytest.raises(InstrumentError, match="at 0 V and not at 5 V"):
        LockInShutter(Outputs(stuck=True), part, clock).open()


def test_an_operator_is_asked_to_move_the_shutter() -> None:
    asked: list[str] = []
    shutter = OperatorShutter(asked.append)
    shutter.shut()
    shutter.open()
    shutter.make_safe()
    assert [text.split()[0] for text in asked] == ["Close", "Open"]


def test_a_shutter_is_read_by_itself_and_needs_an_output_of_its_own() -> None:
    own = Settings.model_validate({"shutter": {}})
    assert own.procedure.shutter_readings == 5
    assert Settings().procedure.shutter_readings is None
    text = own.to_toml()
    assert "shutter_readings = 5" in text
    wired = {
        "lock_in": {"driver": "sr844", "address": "tcp://127.0.0.1:1"},
        "scanner": {"driver": "pi_gcs", "address": "tcp://127.0.0.1:1"},
        "launch": {"driver": "none"},
        "analyser": {"driver": "none"},
        "target": {"driver": "none"},
        "laser": {"driver": "lock_in_output", "output": 2},
        "shutter": {"driver": "lock_in_output", "output": 2},
    }
    with pytest.raises(ValueError, match="outputs of their own"):
        Settings.model_validate(wired)
    wired["shutter"] = {"driver": "lock_in_output", "output": 1}
    assert Settings.model_validate(wired).shutter.output == 1
    with pytest.raises(ValueError, match="shutter is needed"):
        Settings.model_validate({"procedure": {"shutter_readings": 5}})
