"""The plan holds every sample once, in an order that spreads the references."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.acquisition import plan
from amulor.acquisition.settings import Procedure
from amulor.survey import OpenWater, Survey
from amulor.survey.directions import open_water_directions, scan_directions

SIZES = st.integers(1, 4)


@given(
    rows=SIZES, columns=SIZES, references=st.integers(1, 6), dark=st.integers(0, 3),
    repeats=SIZES, order=st.sampled_from(["raster", "serpentine"]),
)  # fmt: skip
def test_the_plan_is_the_whole_grid_and_nothing_twice(
    small: Survey, rows, columns, references, dark, repeats, order
) -> None:
    open_water = OpenWater(rows=2, columns=3, repeats=repeats)
    scan = small.scan.model_copy(
        update={
            "rows": rows, "columns": columns, "order": order, "open_water": open_water
        }
    )  # fmt: skip
    survey = small.model_copy(update={"scan": scan})
    procedure = Procedure(references=references, dark_readings=dark)
    steps = [*plan.steps(survey, procedure)]
    keys = [step.key for step in steps]
    assert len({*keys}) == len(keys) == plan.count(survey, procedure)
    found = {key for key in keys if key.kind == plan.SCAN}
    assert found == {
        plan.Key(plan.SCAN, row, column, 39e6, pair, 0)
        for row in range(rows)
        for column in range(columns)
        for pair in ("VV", "VH")
    }
    shots = {key for key in keys if key.kind == plan.OPEN_WATER}
    assert len(shots) == 2 * 3 * repeats * 2


def test_each_step_goes_where_the_simulation_of_the_survey_looks(small: Survey) -> None:
    steps = [*plan.steps(small, Procedure())]
    azimuth, elevation, _ = scan_directions(small)
    for step in steps:
        if step.key.kind == plan.SCAN:
            at = (step.key.row, step.key.column)
            assert (step.azimuth, step.elevation) == (azimuth[at], elevation[at])
    shots = {
        (step.azimuth, step.elevation)
        for step in steps
        if step.key.kind == plan.OPEN_WATER
    }
    assert shots == {*zip(*open_water_directions(small), strict=True)}


@pytest.mark.parametrize("references", [1, 2, 3, 4])
def test_references_stand_before_after_and_evenly_in_between(
    small: Survey, references: int
) -> None:
    procedure = Procedure(references=references, dark_readings=1)
    kinds = [step.key.kind for step in plan.steps(small, procedure)]
    blocks = 0
    scanned, at = 0, []
    for before, now in zip([plan.SCAN, *kinds], kinds, strict=False):
        if now == plan.DARK and (before == plan.SCAN):
            blocks += 1
            at.append(scanned)
        scanned += now == plan.SCAN
    assert blocks == references
    assert at[0] == 0
    if references > 1:
        assert at[-1] == scanned
        gaps = [after - before for before, after in itertools.pairwise(at)]
        # Rows are not split: the parts differ by a row at most.
        assert max(gaps) - min(gaps) <= small.scan.columns


def test_a_serpentine_scan_comes_back_on_every_second_row(small: Survey) -> None:
    scan = small.scan.model_copy(update={"order": "serpentine"})
    survey = small.model_copy(update={"scan": scan})
    steps = [
        step
        for step in plan.steps(survey, Procedure())
        if step.key.kind == plan.SCAN and step.key.polarization == "VV"
    ]
    columns = [step.key.column for step in steps]
    assert columns == [0, 1, 2, 3, 4, 4, 3, 2, 1, 0, 0, 1, 2, 3, 4]


def test_an_extra_reference_has_keys_of_its_own(small: Survey) -> None:
    procedure = Procedure(dark_readings=2)
    planned = {step.key for step in plan.steps(small, procedure)}
    extra = [
        step.key
        for number in range(3)
        for step in plan.extra_reference(small, procedure, number=number)
    ]
    assert len({*extra}) == len(extra)
    assert not planned & {*extra}
    # In each of three breaks: 2 channels of 2 dark readings and 6 shots.
    assert len(extra) == 3 * 2 * (2 + 6)


def test_an_extra_reference_goes_on_counting_after_the_planned_ones(small) -> None:
    # Two blocks of 3 dark readings and 4 rounds of shots come before it.
    scan = small.scan.model_copy(
        update={"open_water": OpenWater(rows=2, columns=3, repeats=4)}
    )
    survey = small.model_copy(update={"scan": scan})
    procedure = Procedure(references=2, dark_readings=3)
    for number in (0, 1):
        keys = [s.key for s in plan.extra_reference(survey, procedure, number=number)]
        dark = {key.repeat for key in keys if key.kind == plan.DARK}
        shots = {key.repeat for key in keys if key.kind == plan.OPEN_WATER}
        assert dark == {6 + 3 * number + reading for reading in range(3)}
        assert shots == {4 + number}
        # Two channels: three dark readings, and a shot in each of six directions.
        assert len(keys) == 2 * (3 + 6)


def test_spoiled_samples_alone_are_taken_again_under_the_next_number(small) -> None:
    keys = [step.key for step in plan.steps(small, Procedure())]
    scan = [key for key in keys if key.kind == plan.SCAN]
    spoiled = [scan[1], scan[4]._replace(repeat=2)]
    again = [s.key for s in plan.retakes(small, Procedure(), spoiled=spoiled)]
    assert again == [scan[1]._replace(repeat=1), scan[4]._replace(repeat=3)]
    step = next(plan.steps(small, Procedure()))
    assert step.without(set()) == step
    assert step.without(set(step.keys)) is None


def test_a_strip_goes_on_in_one_row_one_channel_and_one_direction(small) -> None:
    def step(row: int, column: int, pair: str = "VH", kind: str = plan.SCAN):
        key = plan.Key(kind, row, column, 39e6, pair, 0)
        return plan.Step(key, 0.0, 0.0)

    def lengths(*steps: plan.Step, longest: int = 9) -> list[int]:
        return [len(strip) for strip in plan.strips(steps, longest=longest)]

    assert lengths(*(step(0, k) for k in range(5))) == [5]
    assert lengths(*(step(0, k) for k in range(5)), longest=2) == [2, 2, 1]
    assert lengths(*(step(0, k) for k in (4, 3, 2))) == [3]
    # A gap, a turn, the next row, another channel, and references end a strip.
    assert lengths(*(step(0, k) for k in (0, 1, 3, 4))) == [2, 2]
    assert lengths(*(step(0, k) for k in (0, 1, 0))) == [2, 1]
    assert lengths(step(0, 1), step(1, 2)) == [1, 1]
    assert lengths(step(0, 1), step(0, 2, "VV")) == [1, 1]
    water = plan.OPEN_WATER
    assert lengths(step(0, 1, kind=water), step(0, 2, kind=water)) == [1, 1]
    assert lengths() == []
