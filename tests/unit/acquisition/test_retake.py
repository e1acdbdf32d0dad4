"""Samples that were spoiled are taken again on request, each under a new key."""

from __future__ import annotations

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition import plan
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.sampler import SampleFlag


def test_spoiled_samples_are_taken_again_on_request_only(
    small, settings, folder, cube_of, made
) -> None:
    own = made(settings, simulation={"faults": ["saturation@30x3"]})
    acquisition.acquire(small, folder, settings=own, scene=scene_light)
    before = cube_of(folder)
    assert int(before["saturated"].sum()) == 3
    again = acquisition.acquire(
        small, folder, settings=settings, resume=True, scene=scene_light
    )
    assert again.done == plan.count(small, settings.procedure)
    told: list[plan.Key] = []
    outcome = acquisition.acquire(
        small, folder, settings=settings, resume=True, retake_flagged=True,
        acknowledged=told.append,
        scene=scene_light,
    )  # fmt: skip
    assert outcome.finished
    extra = [step.key for step in plan.extra_reference(small, own.procedure, number=0)]
    # The reference first: the light was off in between.
    assert told[: len(extra)] == extra
    taken = told[len(extra) :]
    where = {(key.row, key.column, key.polarization) for key in taken}
    flagged = (
        before["saturated"]
        .isel(modulation_frequency=0)
        .stack(one=("row", "column", "polarization"))
    )
    assert len(taken) == 3
    assert where == {
        (int(row), int(column), str(pair))
        for row, column, pair in flagged["one"].values[flagged.values != 0]
    }
    assert {(key.kind, key.repeat) for key in taken} == {(SCAN, 1)}
    after = cube_of(folder)
    assert not after["saturated"].any()
    np.testing.assert_array_equal(after["user_takes"], 1 + before["saturated"])
    # What was good is what it was; what was spoiled is still in the journal.
    for name in ("user_segment", "user_mean_output"):
        np.testing.assert_array_equal(
            after[name].where(before["saturated"] == 0),
            before[name].where(before["saturated"] == 0),
        )
    with Journal.read(folder) as journal:
        scan = [*journal.samples(SCAN)]
    assert len(scan) == 30 + 3
    assert sum(bool(record.flags & SampleFlag.OVERLOAD) for _, record in scan) == 3
    done = acquisition.acquire(
        small,
        folder,
        settings=settings,
        resume=True,
        retake_flagged=True,
        scene=scene_light,
    )
    assert done.done == outcome.done


def test_retakes_that_are_spoiled_or_broken_off_are_taken_once_more(
    small, settings, folder, Stop, cube_of, made
) -> None:
    own = made(settings, simulation={"faults": ["saturation@30x4"]})
    acquisition.acquire(small, folder, settings=own, scene=scene_light)
    extra = len([*plan.extra_reference(small, own.procedure, number=0)])
    # The first two retakes come after the reference and are spoiled again, then a stop.
    acquisition.acquire(
        small, folder, resume=True, retake_flagged=True,
        settings=made(settings, simulation={"faults": [f"saturation@{extra + 1}x2"]}),
        control=Stop(extra + 3, go_on=False),
        scene=scene_light,
    )  # fmt: skip
    told: list[plan.Key] = []
    acquisition.acquire(
        small, folder, settings=settings, resume=True, retake_flagged=True,
        acknowledged=told.append,
        scene=scene_light,
    )  # fmt: skip
    assert [key.repeat for key in told if key.kind == SCAN] == [2, 2, 1]
    cube = cube_of(folder)
    assert not cube["saturated"].any()
    takes, counts = np.unique(cube["user_takes"], return_counts=True)
    assert dict(zip(takes, counts, strict=True)) == {1: 26, 2: 2, 3: 2}


def test_what_is_missing_comes_before_what_was_spoiled(
    small, settings, folder, Stop, made
) -> None:
    own = made(settings, simulation={"faults": ["saturation@20x2"]})
    acquisition.acquire(
        small, folder, settings=own, control=Stop(30, go_on=False), scene=scene_light
    )
    told: list[plan.Key] = []
    outcome = acquisition.acquire(
        small, folder, settings=settings, resume=True, retake_flagged=True,
        acknowledged=told.append,
        scene=scene_light,
    )  # fmt: skip
    assert outcome.finished
    planned = [step.key for step in plan.steps(small, settings.procedure)]
    extra = len([*plan.extra_reference(small, own.procedure, number=0)])
    assert told[extra:-2] == planned[30:]
    assert [key.repeat for key in told[-2:]] == [1, 1]


def test_dark_readings_that_overloaded_are_left_out(
    small, settings, folder, made
) -> None:
    bright = made(settings, simulation={"faults": ["saturation@1"], "pickup": 1e-4})
    acquisition.acquire(small, folder, settings=bright, scene=scene_light)
    with Journal.read(folder) as journal:
        dark = [*journal.samples("dark")]
        cube = acquisition.build(journal)
    good = [
        complex(record.in_phase, record.quadrature)
        for key, record in dark
        if key.polarization == "VV" and not record.flags & SampleFlag.OVERLOAD
    ]
    assert len(good) == 3
    assert cube.attrs["dark_in_phase"][0] == pytest.approx(np.mean(good).real)
