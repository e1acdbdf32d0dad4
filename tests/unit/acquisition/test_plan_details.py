"""Dwells of a plan one by one: kinds, numbers, directions and frequencies."""

from __future__ import annotations

import pytest

from amulor.acquisition import plan
from amulor.acquisition.plan import (
    DARK,
    OPEN_WATER,
    REFERENCE,
    SCAN,
    SHUTTER,
    Comb,
    Key,
    Step,
)
from amulor.acquisition.settings import Procedure
from amulor.errors import SurveyError
from amulor.survey import Survey
from amulor.survey.directions import open_water_directions


@pytest.fixture
def three(small: Survey) -> Survey:
    """Return three frequencies, two rows of two columns and 2 x 3 shots twice."""
    return small.with_(
        {
            "instrument.modulation_frequencies": ["20 MHz", "30 MHz", "39 MHz"],
            "instrument.modulation_depth": 0.4,
            "scan.rows": 2,
            "scan.columns": 2,
            "scan.azimuth": 0.2,
            "scan.elevation": -0.1,
        }
    )


def test_a_comb_is_one_dwell_of_several_frequencies() -> None:
    step = Comb((20e6, 39e6), "VH").step(SCAN, (1, 2), 3, (0.1, 0.2))
    assert step.keys == (
        Key(SCAN, 1, 2, 20e6, "VH", 3), Key(SCAN, 1, 2, 39e6, "VH", 3)
    )  # fmt: skip
    assert (step.azimuth, step.elevation) == (0.1, 0.2)
    assert step.frequencies == (20e6, 39e6)
    # What is missing of it is read under the same light.
    rest = step.without({step.key})
    assert rest is not None
    assert rest.keys == step.keys[1:]
    assert rest.frequencies == (20e6, 39e6)
    assert rest.without({*rest.keys}) is None
    single = Comb((20e6,), "VH").step(SCAN, (1, 2), 3, (0.1, 0.2))
    assert single.frequencies == (20e6,)
    assert (single.together, single.others) == ((), ())


def test_combs_have_as_many_frequencies_as_the_light_allows(three: Survey) -> None:
    two = plan.combs(three, Procedure(frequencies_at_once=2))
    assert two == [
        Comb(frequencies, pair)
        for pair in ("VV", "VH")
        for frequencies in ((20e6, 30e6), (39e6,))
    ]
    assert len(plan.combs(three, Procedure())) == 6
    with pytest.raises(SurveyError) as caught:
        plan.combs(three, Procedure(frequencies_at_once=5))
    assert str(caught.value) == (
        "3 frequencies at once, each with a modulation depth of 0.4, would modulate "
        "1.2 of the light; state the depth that each of them has then "
        "(instrument.modulation_depth), at most 0.333, or lower "
        "procedure.frequencies_at_once"
    )
    third = three.with_({"instrument.modulation_depth": 1 / 3})
    assert len(plan.combs(third, Procedure(frequencies_at_once=3))) == 2
    assert plan.channels(three) == [
        (frequency, pair) for pair in ("VV", "VH") for frequency in (20e6, 30e6, 39e6)
    ]


def test_a_reference_block_is_dark_then_shut_then_open(three: Survey) -> None:
    procedure = Procedure(references=2, dark_readings=2, shutter_readings=3)
    at_rest = (0.2, -0.1)
    for block in (0, 1):
        steps = [*plan.reference_block(three, procedure, block=block)]
        kinds = [step.key.kind for step in steps]
        assert kinds == [DARK] * 12 + [SHUTTER] * 18 + [OPEN_WATER] * 36
        dark, shut, shots = steps[:12], steps[12:30], steps[30:]
        first = [(step.key.polarization, step.key.frequency) for step in dark[::2]]
        assert first == [(pair, f) for f, pair in plan.channels(three)]
        assert [step.key.repeat for step in dark[:2]] == [2 * block, 2 * block + 1]
        assert [step.key.repeat for step in shut[:3]] == [
            3 * block + k for k in range(3)
        ]
        assert {step.key[1:3] for step in (*dark, *shut)} == {(0, 0)}
        assert {(step.azimuth, step.elevation) for step in (*dark, *shut)} == {at_rest}
        # Two repeats of all places are divided among two blocks.
        assert {step.key.repeat for step in shots} == {block}
        assert [step.key[1:3] for step in shots[:6]] == [
            (row, column) for row in range(2) for column in range(3)
        ]
    none = [*plan.reference_block(three, Procedure(dark_readings=1), block=0)]
    assert SHUTTER not in {step.key.kind for step in none}


def test_places_of_open_water_are_those_of_the_survey(three: Survey) -> None:
    azimuth, elevation = open_water_directions(three)
    grid = plan.open_water_grid(three)
    assert [*grid] == [(row, column) for row in range(2) for column in range(3)]
    assert [*grid.values()] == [*zip(azimuth[::2], elevation[::2], strict=True)]
    assert plan.open_water_grid(three.with_({"scan.open_water": None})) == {}


def test_a_plan_begins_and_ends_with_references(three: Survey) -> None:
    procedure = Procedure(references=3, dark_readings=1)
    steps = [*plan.steps(three, procedure)]
    blocks, before = [], None
    for step in steps:
        if step.key.kind != before:
            blocks.append([step.key.kind, 0])
        blocks[-1][1] += 1
        before = step.key.kind
    # Twelve rows of six channels are divided in two; the repeats by block 0 and 1.
    assert blocks == [
        [DARK, 6], [OPEN_WATER, 36], [SCAN, 12], [DARK, 6], [OPEN_WATER, 36],
        [SCAN, 12], [DARK, 6],
    ]  # fmt: skip
    assert len(steps) == plan.count(three, procedure)
    one = [step.key.kind for step in plan.steps(three, Procedure(references=1))]
    assert one[-1] == SCAN
    assert one.count(SCAN) == 24


def test_counts_are_those_of_all_kinds(three: Survey) -> None:
    procedure = Procedure(references=3, dark_readings=2, shutter_readings=4)
    assert plan.count(three, procedure) == 6 * (4 + 12 + 3 * 6)
    without = three.with_({"scan.open_water": None})
    assert plan.count(without, Procedure(dark_readings=0)) == 6 * 4
    reference = {"azimuth": 0.3, "elevation": 0.1, "amplitude": 0.02, "readings": 5}
    referenced = three.with_({"scan.reference": reference})
    # Before two rows and two rounds of shots, five readings each.
    assert plan.count(referenced, Procedure(dark_readings=0)) == 6 * (4 + 12 + 5 * 4)
    alone = without.with_({"scan.reference": reference})
    assert plan.count(alone, Procedure(dark_readings=0)) == 6 * (4 + 5 * 2)


def test_the_reference_is_read_before_rows_and_rounds(three: Survey) -> None:
    reference = {"azimuth": 0.3, "elevation": 0.1, "amplitude": 0.02, "readings": 2}
    survey = three.with_({"scan.reference": reference})
    steps = [*plan.steps(survey, Procedure(dark_readings=0))]
    found = [step for step in steps if step.key.kind == REFERENCE]
    assert {(step.azimuth, step.elevation) for step in found} == {(0.3, 0.1)}
    assert [step.key.repeat for step in found[:4]] == [0, 1, 0, 1]
    assert {step.key[1:3] for step in found} == {(0, 0), (1, 0), (0, 1), (1, 1)}
    assert len(found) == 6 * 2 * 4
    first = next(k for k, step in enumerate(steps) if step.key.kind == SCAN)
    before = steps[first - 1].key
    assert (before.row, before.column) == (0, plan.BEFORE_ROW)
    assert steps[0].key.column == plan.BEFORE_SHOTS


def test_a_vehicle_measures_all_channels_of_a_pixel(three: Survey) -> None:
    course = {"kind": "line", "start": [0, 0, -8], "speed": 0.5}
    moving = three.with_({"platform": {"course": course}, "scan.open_water": None})
    steps = [
        step for step in plan.steps(moving, Procedure(dark_readings=0))
        if step.key.kind == SCAN
    ]  # fmt: skip
    assert [step.key[1:3] for step in steps] == [
        (row, column) for row in range(2) for column in range(2) for _ in range(6)
    ]
    still = [
        step.key for step in plan.steps(three, Procedure(dark_readings=0))
        if step.key.kind == SCAN
    ]  # fmt: skip
    assert [at.frequency for at in still[:5]] == [20e6] * 4 + [30e6]


def test_an_extra_reference_follows_the_planned_numbers(three: Survey) -> None:
    procedure = Procedure(references=2, dark_readings=2, shutter_readings=3)
    steps = [*plan.extra_reference(three, procedure, number=1)]
    numbers = {
        kind: sorted({step.key.repeat for step in steps if step.key.kind == kind})
        for kind in (DARK, SHUTTER, OPEN_WATER)
    }
    assert numbers == {DARK: [6, 7], SHUTTER: [9, 10, 11], OPEN_WATER: [3]}
    assert len(steps) == 6 * (2 + 3 + 6)


def test_strips_and_retakes_keep_frequencies_apart(three: Survey) -> None:
    first, second = (
        Step(Key(SCAN, 0, k, frequency, "VV", 0), 0.1 * k, 0.2)
        for k, frequency in enumerate((20e6, 39e6))
    )
    assert [*plan.strips([first, second], longest=9)] == [[first], [second]]
    joined = plan.together([first, second])
    assert joined.keys == (first.key, second.key)
    assert joined.azimuth == 0.0
    comb = Procedure(frequencies_at_once=2)
    spoiled = [Key(SCAN, 1, 0, 30e6, "VV", 4)]
    (again,) = plan.retakes(three, comb, spoiled=spoiled)
    assert again.keys == (Key(SCAN, 1, 0, 30e6, "VV", 5),)
    assert again.frequencies == (20e6, 30e6)
