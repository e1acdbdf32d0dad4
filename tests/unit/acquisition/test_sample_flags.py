"""Flags of samples, darkness, overloads and the choice of a scale."""

from __future__ import annotations

import math
from typing import Any

import pytest
from logged_devices import (
    FREQUENCY,
    reading,
    sampler,
    scripted,
    step,
    words,
)

from amulor.acquisition.devices import Devices
from amulor.acquisition.plan import (
    DARK,
    OPEN_WATER,
    SCAN,
    SHUTTER,
)
from amulor.acquisition.protocols import Overload
from amulor.acquisition.sampler import DarkLevel, SampleFlag
from amulor.errors import InstrumentError
from amulor.survey import Survey


def flags_of(small: Survey, devices: Devices, kind: str = SCAN, **settings: Any):
    made = sampler(small, devices, settings)
    return SampleFlag(made.take(step(kind), elapsed=0.0, segment=1)[0].flags)


def test_a_beam_off_its_direction_is_flagged(small, devices) -> None:
    for azimuth, elevation, flag in (
        (0.99e-4, -0.99e-4, SampleFlag.NONE), (1.01e-4, 0.0, SampleFlag.OFF_POSITION),
        (0.0, -1.01e-4, SampleFlag.OFF_POSITION),
    ):  # fmt: skip
        devices.scanner.answers["move"] = lambda a, e, timeout, off=(
            azimuth, elevation,
        ): (a + off[0], e + off[1])  # fmt: skip
        assert flags_of(small, devices) == flag


def test_a_frequency_off_by_more_than_a_thousandth_is_flagged(small, devices) -> None:
    for factor, flag in (
        (1 + 0.9e-3, SampleFlag.NONE), (1 + 1.1e-3, SampleFlag.OFF_FREQUENCY),
        (1 - 1.1e-3, SampleFlag.OFF_FREQUENCY),
    ):  # fmt: skip
        found = reading(modulation_frequency=FREQUENCY * factor)
        devices.lock_in.answers["read"] = lambda found=found: found
        assert flags_of(small, devices) == flag


def test_light_beyond_the_detector_is_an_overload(small, devices) -> None:
    survey = small.with_({"instrument.detector.saturation": "0.5 V"})
    for mean, flag in (
        (0.499, SampleFlag.NONE), (0.501, SampleFlag.OVERLOAD),
        (math.nan, SampleFlag.NONE),
    ):  # fmt: skip
        devices.lock_in.answers["read"] = lambda mean=mean: reading(mean=mean)
        assert flags_of(survey, devices) == flag
        (record,) = sampler(survey, devices).take(step(), elapsed=0, segment=1)
        assert record.mean == (None if math.isnan(mean) else mean)


def test_an_overload_that_is_gone_leaves_no_flag(small, devices, log) -> None:
    scripted(devices, reading(overload=Overload.INPUT), reading())
    assert flags_of(small, devices) == SampleFlag.NONE
    assert "lock_in.relieve" not in words(log)
    # One that stays makes room, and is read again after settling.
    scripted(devices, *[reading(overload=Overload.INPUT)] * 2, reading())
    devices.lock_in.answers["relieve"] = True
    del log[:]
    assert flags_of(small, devices) == SampleFlag.RESCALED
    assert ("lock_in.relieve", Overload.INPUT) in log
    assert words(log).count("lock_in.read") == 3
    # Without room it is flagged.
    devices.lock_in.answers["relieve"] = False
    scripted(devices, reading(overload=Overload.INPUT))
    del log[:]
    assert flags_of(small, devices) == SampleFlag.OVERLOAD
    assert words(log).count("lock_in.read") == 2


def test_a_lost_reference_is_tried_again_some_times(small, devices, log) -> None:
    lost = reading(unlocked=True)
    scripted(devices, lost, lost, reading())
    procedure = {"attempts": 2}
    assert flags_of(small, devices, procedure=procedure) == SampleFlag.REPEATED
    scripted(devices, lost, lost, lost, reading())
    with pytest.raises(InstrumentError) as caught:
        flags_of(small, devices, procedure=procedure)
    assert str(caught.value) == (
        "the lock-in has lost its reference in 3 samples in a row; check the reference "
        "and the modulation frequency"
    )


def test_overloads_in_a_row_end_the_scan(small, devices) -> None:
    made = sampler(small, devices, {"procedure": {"patience": 2}})
    bad, good = reading(overload=Overload.INPUT), reading()
    for found in (bad, bad, good, bad, bad):
        scripted(devices, found)
        made.take(step(), elapsed=0.0, segment=1)
    scripted(devices, bad)
    with pytest.raises(InstrumentError) as caught:
        made.take(step(), elapsed=0.0, segment=1)
    assert str(caught.value) == (
        "3 samples in a row are overloaded, at the coarsest scale; take light or gain "
        "away"
    )


def test_darkness_is_what_dark_readings_show(small, devices) -> None:
    made = sampler(small, devices)
    for kind, mean, expected in (
        # Without dark readings of its polarization nothing is dark.
        (SCAN, 0.1, 0), (DARK, 0.1, 0), (DARK, 0.1, 0), (SCAN, 0.1, 64),
        (OPEN_WATER, 0.101, 0), (OPEN_WATER, 0.1, 64), (SHUTTER, 0.1, 0),
        (DARK, 0.1, 0),
    ):  # fmt: skip
        scripted(devices, reading(mean=mean))
        (record,) = made.take(step(kind), elapsed=0.0, segment=1)
        assert record.flags == expected, (kind, mean)
    scripted(devices, reading(mean=0.1))
    assert made.take(step(SCAN, "VV"), elapsed=0.0, segment=1)[0].flags == 0
    # Overloaded dark readings are no level.
    other = sampler(small, devices)
    scripted(devices, reading(mean=0.1, overload=Overload.INPUT))
    other.take(step(DARK), elapsed=0.0, segment=1)
    scripted(devices, reading(mean=0.1))
    assert other.take(step(SCAN), elapsed=0.0, segment=1)[0].flags == 0


def test_a_level_is_exceeded_by_five_standard_errors() -> None:
    level = DarkLevel()
    assert not level.is_dark("VV", [0.0])
    level.add("VV", [1.0, 2.0, 3.0])
    # Standard deviation 1; a mean of two readings, and of three dark ones.
    limit = 2 + 5 * math.sqrt(1 / 2 + 1 / 3)
    assert level.is_dark("VV", [limit - 1.01, limit + 0.99])
    assert not level.is_dark("VV", [limit - 0.99, limit + 1.01])
    assert not level.is_dark("VV", [])
    assert not level.is_dark("VH", [0.0])
    single = DarkLevel()
    single.add("VV", [1.0])
    assert single.is_dark("VV", [1.0])
    assert not single.is_dark("VV", [1.0 + 1e-9])
    # The newest hundred count.
    level.add("VV", [5.0] * 100)
    assert level.is_dark("VV", [5.0])
    level.add("VV", [7.0] * 50)
    assert level.is_dark("VV", [6.0])


def test_samples_without_light_in_a_row_end_the_scan(small, devices) -> None:
    made = sampler(small, devices, {"procedure": {"darkness_patience": 2}})
    dark = int(SampleFlag.NO_LIGHT | SampleFlag.OFF_POSITION)
    for kind, flags in (
        (SCAN, dark), (SCAN, dark), (SCAN, 8), (SCAN, dark), (DARK, dark), (SCAN, dark)
    ):  # fmt: skip
        made.refuse_darkness(kind, flags)
    with pytest.raises(InstrumentError) as caught:
        made.refuse_darkness(OPEN_WATER, dark)
    assert str(caught.value) == (
        "3 samples in a row show no light: with the laser switched on the mean output "
        "of the detector is that of the dark readings; see that the interlock is "
        "closed, that nothing stands in the beam and that no other program drives the "
        "laser. If the light is too weak for that input, take "
        "lock_in.mean_output_input out of the devices file"
    )


def test_a_finer_scale_is_tried_after_twenty_calm_samples(small, devices, log) -> None:
    made = sampler(small, devices)
    devices.lock_in.answers["sharpen"] = True

    def tries(count: int) -> list[int]:
        found = []
        for number in range(count):
            del log[:]
            made.take(step(), elapsed=0.0, segment=1)
            if "lock_in.sharpen" in words(log):
                found.append(number)
                assert ("lock_in.sharpen", abs(0.5 - 1j)) in log
        return found

    assert tries(45) == [19, 39]
    # A new scale settles; without one the next sample tries again.
    devices.lock_in.answers["sharpen"] = False
    assert tries(20) == [14, 15, 16, 17, 18, 19]
    # Dark samples, and those without light, do not count.
    made = sampler(small, devices)
    for kind in [DARK] * 25 + [SCAN] * 18:
        scripted(devices, reading(mean=0.25 + (kind == SCAN)))
        made.take(step(kind), elapsed=0.0, segment=1)
    scripted(devices, reading(mean=0.25))
    made.take(step(SCAN), elapsed=0.0, segment=1)
    del log[:]
    scripted(devices, reading(mean=1.25))
    made.take(step(SCAN), elapsed=0.0, segment=1)
    assert "lock_in.sharpen" not in words(log)
    made.take(step(SCAN), elapsed=0.0, segment=1)
    assert "lock_in.sharpen" in words(log)


def test_a_rescaled_sample_is_not_calm(small, devices, log) -> None:
    made = sampler(small, devices)
    for _ in range(19):
        made.take(step(), elapsed=0.0, segment=1)
    devices.lock_in.answers["relieve"] = True
    scripted(devices, *[reading(overload=Overload.INPUT)] * 2, reading())
    made.take(step(), elapsed=0.0, segment=1)
    for _ in range(19):
        made.take(step(), elapsed=0.0, segment=1)
    assert "lock_in.sharpen" not in words(log)
    made.take(step(), elapsed=0.0, segment=1)
    assert "lock_in.sharpen" in words(log)
