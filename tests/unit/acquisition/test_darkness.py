"""Darkness is told from light, flagged, kept out of the cube, and ends a scan."""

from __future__ import annotations

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.connect import connect
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import DARK, OPEN_WATER, SCAN
from amulor.acquisition.sampler import DarkLevel, SampleFlag
from amulor.errors import InstrumentError


def test_light_is_told_from_darkness_by_the_spread_of_dark_readings() -> None:
    rng = np.random.default_rng(5)
    wrong = missed = 0
    trials = 2000
    for _ in range(trials):
        level = DarkLevel()
        level.add("VH", 1e-3 + 1e-4 * rng.standard_normal(20))
        missed += not level.is_dark("VH", 1e-3 + 1e-4 * rng.standard_normal(4))
        # Ten standard errors of the difference: s (1 / 4 + 1 / 20)^(1/2) = 0.055 mV.
        lit = 1e-3 + 5.5e-4 + 1e-4 * rng.standard_normal(4)
        wrong += level.is_dark("VH", lit)
    # Five standard errors, of a spread that 20 readings give to 16 %: one in 20,000.
    assert missed <= 2
    assert wrong <= 2


def test_of_what_was_not_measured_nothing_is_said() -> None:
    level = DarkLevel()
    assert not level.is_dark("VV", [0.0])
    level.add("VH", [0.0, 0.0])
    assert not level.is_dark("VV", [0.0])
    assert not level.is_dark("VH", [])
    assert level.is_dark("VH", [0.0])
    assert not level.is_dark("VH", [1e-9])


def test_a_level_follows_the_room() -> None:
    level = DarkLevel()
    level.add("none", [0.0] * 200)
    assert not level.is_dark("none", [1e-3])
    level.add("none", [1e-3] * 200)
    assert level.is_dark("none", [1e-3])


def test_a_scan_without_light_stops_after_a_few_samples_and_keeps_them_apart(
    small, settings, folder, made, safe, cube_of
) -> None:
    own = made(settings, simulation={"faults": ["darkness@30x9999"]})
    devices = connect(small, own, scene=scene_light)
    with pytest.raises(InstrumentError, match=r"no light.*interlock.*--resume"):
        acquisition.acquire(small, folder, settings=own, devices=devices)
    assert safe(devices)
    with Journal.read(folder) as journal:
        flags = [
            record.flags
            for kind in (OPEN_WATER, SCAN)
            for _, record in journal.samples(kind)
        ]
        dark = [record.flags for _, record in journal.samples(DARK)]
    assert sum(bool(flag & SampleFlag.NO_LIGHT) for flag in flags) == 4
    assert not any(dark)
    # Mended: the scan goes on, and what was dark is taken once more.
    done = acquisition.acquire(
        small, folder, settings=settings, resume=True, retake_flagged=True,
        scene=scene_light,
    )  # fmt: skip
    assert done.finished
    cube = cube_of(folder)
    assert np.isfinite(cube["in_phase"]).all()
    assert not (cube["user_sample_flag"] & SampleFlag.NO_LIGHT).any()


def test_dark_readings_hold_nothing_of_the_echo(small, settings, folder) -> None:
    quiet = small.with_({"instrument.detector.dark_rate": "0 1/s"})
    acquisition.acquire(quiet, folder, settings=settings, scene=scene_light)
    with Journal.read(folder) as journal:
        largest = {
            kind: max(
                abs(complex(record.in_phase, record.quadrature))
                for _, record in journal.samples(kind)
            )
            for kind in (DARK, SCAN)
        }
    # exp(-15) of the echo, and noise of light that decays alike; exp(-5) is 7e-3.
    assert largest[DARK] < 1e-6 * largest[SCAN]


def test_a_moment_of_darkness_is_no_number_in_the_cube(
    small, settings, folder, made, cube_of
) -> None:
    own = made(settings, simulation={"faults": ["darkness@30x2"]})
    outcome = acquisition.acquire(small, folder, settings=own, scene=scene_light)
    assert outcome.finished
    assert outcome.flagged == 2
    cube = cube_of(folder)
    dark = (cube["user_sample_flag"].values & SampleFlag.NO_LIGHT) != 0
    assert dark.sum() == 2
    for name in ("in_phase", "quadrature"):
        np.testing.assert_array_equal(np.isnan(cube[name].values), dark)
    meanings = cube["user_sample_flag"].attrs["flag_meanings"].split()
    masks = cube["user_sample_flag"].attrs["flag_masks"]
    assert dict(zip(meanings, masks, strict=True))["no_light"] == 64
    assert dict(zip(meanings, masks, strict=True))["uncalibrated"] == 32


def test_a_laser_that_is_never_out_is_darkness_too(small, settings, folder) -> None:
    # The gate drives another output: the light is the same, on or "off".
    devices = connect(small, settings, scene=scene_light)
    devices.laser.on = devices.laser.off = lambda: devices.lock_in.bench.set_laser(True)
    with pytest.raises(InstrumentError, match="no other program drives the laser"):
        acquisition.acquire(small, folder, settings=settings, devices=devices)


def test_open_water_shots_without_light_are_no_reference(
    small, settings, folder, made, cube_of
) -> None:
    # Two dark readings for each of two channels, then shots.
    own = made(settings, simulation={"faults": ["darkness@6x2"]})
    acquisition.acquire(small, folder, settings=own, scene=scene_light)
    shots = cube_of(folder).amulor.open_water
    assert int(np.isnan(shots["in_phase"]).sum()) == 2
