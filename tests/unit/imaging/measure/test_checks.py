"""Known lengths pass, fail, or stay undecided by their own uncertainties."""

from __future__ import annotations

import exact_scenes as scenes
import pytest

from amulor.errors import CubeError, SurveyError
from amulor.imaging.measure import Check, compared, read_checks


@pytest.fixture(scope="module")
def ladder():
    return scenes.ladder(own=2e-4)


def relief(**others) -> Check:
    # From the first tread to the second: 40 mm by the scene.
    ends = {"first": (10, 6), "second": (10, 18)}
    return Check(name="step", kind="relief", **ends, **others)


def test_the_first_step_is_forty_millimetres(ladder) -> None:
    found = compared(ladder, relief(expected=0.04))
    assert found.measured.value == pytest.approx(0.04, abs=1e-12)
    # Two pixels of 0.2 mm, doubled; the beams are within 2 degrees of the axis.
    assert found.expanded == pytest.approx(2 * 2**0.5 * 2e-4, rel=2e-3)
    assert found.verdict == "pass"


@pytest.mark.parametrize(
    ("options", "verdict"),
    [
        # U = 0.566 mm of the two pixels; the known length is off by so much.
        ({"expected": 0.0405}, "pass"),
        ({"expected": 0.0406}, "fail"),
        ({"expected": 0.0406, "expected_uncertainty": 2e-4}, "pass"),
        ({"expected": 0.0395, "tolerance": 1.1e-3}, "pass"),
        ({"expected": 0.0395, "tolerance": 1.0e-3}, "undecided"),
        ({"expected": 0.0380, "tolerance": 1.5e-3}, "undecided"),
        ({"expected": 0.0380, "tolerance": 1.4e-3}, "fail"),
    ],
)
def test_verdicts_guard_both_sides(ladder, options, verdict) -> None:
    assert compared(ladder, relief(**options)).verdict == verdict


def test_a_file_is_read_and_its_mistakes_are_named(tmp_path) -> None:
    path = tmp_path / "checks.toml"
    path.write_text(
        '[[checks]]\nname = "bar"\nfirst = [1, 2]\nsecond = [3, 4]\n'
        'expected = "40 mm"\ntolerance = "1 mm"\nreach = 2\n'
    )
    (check,) = read_checks(path)
    assert (check.expected, check.tolerance, check.second) == (0.04, 1e-3, (3, 4))
    path.write_text('[[checks]]\nname = "bar"\nfirst = [1, 2]\nexpected = 40\n')
    with pytest.raises(SurveyError, match="without a unit") as caught:
        read_checks(path)
    assert "second" in str(caught.value)


def test_an_end_without_a_range_names_the_check(ladder) -> None:
    gone = relief(expected=0.04).model_copy(update={"second": (99, 1)})
    with pytest.raises(CubeError, match=r"check 'step': pixel \(99, 1\) is outside"):
        compared(ladder, gone)
