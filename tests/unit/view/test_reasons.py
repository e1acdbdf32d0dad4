"""Reasons of flags: the limit of each value, and words where no value is stored."""

from __future__ import annotations

import math
from typing import Any

import pytest

from amulor.cube import QualityFlag, WaterResidualCause
from amulor.cube.schema import TERMS
from amulor.errors import FormatError
from amulor.view import explanations

FLAG, CAUSE = QualityFlag, WaterResidualCause


def reasons_of(
    flag: QualityFlag, causes: WaterResidualCause | int = 0, *,
    attributes: dict[str, Any] | None = None, **values: float,
) -> list[explanations.Reason]:  # fmt: skip
    numbers = {"quality_flag": float(flag), "water_residual_cause": float(causes)}
    return list(explanations._reasons(numbers | values, attributes or {}))


@pytest.mark.parametrize(
    ("flag", "key", "beyond", "within", "limit", "unit"),
    [(FLAG.NO_TARGET, "no_target_probability", 1.1e-5, 0.9e-5, "> 1e-05", "1"),
     (FLAG.NO_TARGET, "joint_detection", 24.9, 25.1, "< 25", "1"),
     (FLAG.NO_TARGET, "signal_significance", 4.9, 5.1, "< 5", "1"),
     (FLAG.NO_TARGET, "open_phase", 0.31, 0.29, "> 0.3", "rad"),
     (FLAG.AMBIGUOUS, "joint_wrong_interval_probability", 3.1e-4, 2.9e-4, "> 0.0003",
      "1"),
     (FLAG.AMBIGUOUS, "ambiguous_interval_probability", 3.4e-4, 3.3e-4, "> 0.000335",
      "1"),
     (FLAG.AMBIGUOUS, "ambiguous_misfit_probability", 0.9e-4, 1.1e-4, "< 0.0001", "1"),
     (FLAG.MIXED, "clear_of_both", 3.6, 3.4, "> 3.5", "1"),
     (FLAG.OUTLIER, "stand_off", 2.6, 2.4, "> 2.5", "1"),
     (FLAG.MOVED, "moved_probability", 0.9e-4, 1.1e-4, "< 0.0001", "1")],
)  # fmt: skip
def test_a_flag_is_explained_by_a_value_beyond_its_limit(
    flag, key, beyond, within, limit, unit
) -> None:
    (reason,) = reasons_of(flag, **{key: beyond})
    assert (reason.flag, reason.cause) == (flag.name, "")
    assert (reason.value, reason.limit, reason.unit) == (beyond, limit, unit)
    assert reason.modulation_frequencies == ()
    (words,) = reasons_of(flag, **{key: within})
    assert (words.value, words.limit, words.unit) == (None, "", "")
    # Another flag is not explained by it.
    (other,) = reasons_of(FLAG.SATURATED, **{key: beyond})
    assert other.quantity == "overload reported with the sample"


@pytest.mark.parametrize(
    ("cause", "key", "limit", "unit"),
    [(CAUSE.PHASE_SHIFT, "residual_phase", "> 0.02", "rad"),
     (CAUSE.PHASE_SHIFT, "residual_phase_ratio", "> 1", "1"),
     (CAUSE.STRONG_COLUMN, "column_over_target", "> 0.3", "1"),
     (CAUSE.WATER_SHAPE, "water_shape_significance", "> 5", "1"),
     (CAUSE.WATER_SHAPE, "water_shape_probability", "> 0.001", "1"),
     (CAUSE.MODEL_MISFIT, "joint_misfit_probability", "< 0.0001", "1"),
     (CAUSE.MODEL_DEPARTURE, "joint_departure", "> 0.004", "m")],
)  # fmt: skip
def test_a_cause_of_residual_water_is_explained_by_any_value(
    cause, key, limit, unit
) -> None:
    values = {"phase_error": 0.02, "joint_departure_limit": 0.004, key: 0.77}
    (reason,) = reasons_of(FLAG.WATER_RESIDUAL, cause, **values)
    assert (reason.flag, reason.cause) == ("WATER_RESIDUAL", cause.name)
    assert (reason.value, reason.limit, reason.unit) == (0.77, limit, unit)
    (words,) = reasons_of(FLAG.WATER_RESIDUAL, cause, **{key: math.nan})
    assert (words.cause, words.value) == (cause.name, None)


def test_the_limit_of_another_interval_is_that_of_a_joint_estimate() -> None:
    (alone,) = reasons_of(FLAG.AMBIGUOUS, ambiguous_interval_probability=0.5)
    # A rise of chi-square by 16: exp(-8) to one.
    assert float(alone.limit[2:]) == pytest.approx(
        math.exp(-8) / (1 + math.exp(-8)), rel=2e-3
    )
    (joint,) = reasons_of(
        FLAG.AMBIGUOUS, ambiguous_interval_probability=0.5, joint_detection=99.0
    )
    assert joint.limit == "> 0.0003"


def test_an_angle_of_residual_water_stands_in_place_of_its_ratio() -> None:
    (reason,) = reasons_of(
        FLAG.WATER_RESIDUAL, CAUSE.PHASE_SHIFT, residual_phase=0.1,
        residual_phase_ratio=9.0,
    )  # fmt: skip
    assert reason.quantity == "phase shift by residual water"
    (one,) = reasons_of(FLAG.NO_TARGET, joint_detection=1.0, open_phase=1.0)
    assert one.limit == "< 25"


@pytest.mark.parametrize(("size", "told"), [(3.1e-3, True), (2.9e-3, False)])
def test_light_of_a_corner_is_compared_with_the_other_errors(size, told) -> None:
    # 5 mm in all, of which 3 mm and 4 mm, or 4 and 3.
    total = math.hypot(3e-3, size)
    found = reasons_of(
        FLAG.CORNER, slant_range_uncertainty=total, slant_range_uncertainty_corners=size
    )
    assert (found[0].limit == "> 0.003") == told
    assert (found[0].value == size) == told


def test_a_disagreement_of_channels_has_the_limit_of_its_cube() -> None:
    given = {"channel_disagreement_limit": [4.5, 3.5]}
    (reason,) = reasons_of(FLAG.OUTLIER, channel_disagreement=4.0, attributes=given)
    assert (reason.value, reason.limit) == (4.0, "> 3.5")
    (words,) = reasons_of(FLAG.OUTLIER, channel_disagreement=4.0)
    assert words.quantity == "sample contradicts the others of its pixel"


def test_values_without_a_limit_are_given_as_they_are() -> None:
    for flag in (FLAG.WATER_RESIDUAL, FLAG.NO_OPEN_WATER):
        (reason,) = reasons_of(flag, slant_range_bias=-0.002)
        assert (reason.value, reason.limit, reason.unit) == (-0.002, "", "m")
    spread, apart = reasons_of(FLAG.MIXED, range_spread=0.01, apart=0.3)
    assert (spread.value, apart.value) == (0.01, 0.3)
    assert (spread.unit, apart.unit) == ("m", "m")


@pytest.mark.parametrize(
    ("flag", "causes", "words"),
    [(FLAG.MISSING, 0, "no number in phase or in quadrature"),
     (FLAG.NO_TARGET, 0, "too few samples that can be used"),
     (FLAG.AMBIGUOUS, 0, "outside the interval, or alike within departures"),
     (FLAG.NO_OPEN_WATER, 0, "bias of the range by the water not known"),
     (FLAG.RELATIVE, 0, "no interval is stated"),
     (FLAG.MOVED, 0, "not stored: file of an older version"),
     (FLAG.WATER_RESIDUAL, CAUSE.WATER_CHANGED, "not stored"),
     (FLAG.WATER_RESIDUAL, CAUSE.INSTRUMENT, "not stored"),
     (FLAG.WATER_RESIDUAL, CAUSE.PHASE_SHIFT, "residual water signal not known")],
)  # fmt: skip
def test_a_flag_without_a_value_has_words(flag, causes, words) -> None:
    (reason,) = reasons_of(flag, causes)
    assert reason.quantity == words
    assert (reason.value, reason.limit, reason.unit) == (None, "", "")


def test_words_have_the_numbers_of_the_reference() -> None:
    given = {"open_water_change": [0.1234], "open_water_misfit": 2.0,
             "interval_unsettled": "two fit"}  # fmt: skip
    changed, relative = reasons_of(
        FLAG.WATER_RESIDUAL | FLAG.RELATIVE, CAUSE.WATER_CHANGED, attributes=given
    )
    assert changed.quantity == (
        "relative change of the water 0.12, departure of the shots from the model 2"
    )
    assert relative.quantity == "two fit"
    first, second = reasons_of(
        FLAG.WATER_RESIDUAL, CAUSE.STRONG_COLUMN | CAUSE.INSTRUMENT,
        column_over_target=0.5,
    )  # fmt: skip
    assert (first.cause, second.cause) == ("STRONG_COLUMN", "INSTRUMENT")


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.00123, "0.12 % of the"), (1e-3, "0.1 % of the"), (0.99e-3, "1 of 1,000"),
     (1 / 3456, "1 of 3,500"), (1 / 1.234e6, "1 of 1,200,000")],
)  # fmt: skip
def test_a_small_share_is_one_of_many(share: float, words: str) -> None:
    assert explanations._share(share) == words


def test_chances_are_those_of_the_normal_distribution() -> None:
    assert explanations._tail(0.0) == 0.5
    assert explanations._tail(1.959964) == pytest.approx(0.025, rel=1e-5)
    assert explanations._tail(-1.959964) == pytest.approx(0.975, rel=1e-5)

    def example(one: int, two: float = 2.5) -> None:
        """Has a default."""

    assert explanations.default_of(example, "two") == 2.5


def test_an_explanation_is_printed_with_labels() -> None:
    (found,) = explanations.find("term_delay")
    assert explanations.lines_of(found) == [
        f"     means: {found.meaning}",
        f"      test: {found.compared}",
        "    effect: A part of the standard uncertainty of the range.",
        "what to do: amulor info FILE and amulor report print its size.",
    ]
    meaning = TERMS["delay"].meaning
    assert found.meaning == f"{meaning[0].upper()}{meaning[1:]}."
    assert found.kind == "error term"
    assert explanations.hint(["no target", "mixed"]) == "amulor explain NO_TARGET"
    assert explanations.hint([]) == ""


def test_what_is_not_known_is_named_up_to_sixty_letters() -> None:
    with pytest.raises(FormatError) as refused:
        explanations.find("q" * 70)
    assert str(refused.value).startswith(f"nothing is known of '{'q' * 60}'; there are")
    # The nearest name alone.
    assert [one.name for one in explanations.find("mixxed")] == ["MIXED"]


def test_flags_say_whether_a_range_or_a_sample_is_used() -> None:
    of = explanations._consequence
    assert of("pixel", "MISSING") == "The pixel has no range."
    doubtful = "The pixel keeps its range, but the range is doubtful."
    assert of("pixel", "MIXED") == of("cause", "PHASE_SHIFT") == doubtful
    assert of("sample", "RESCALED") == "The sample is used."
    assert of("sample", "OVERLOAD") == (
        "The sample is not used; amulor acquire --resume --retake-flagged repeats it."
    )
