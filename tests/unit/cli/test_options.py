"""Options of commands become numbers in SI units, or are refused at their limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from amulor.cli import main
from amulor.cli._arguments import (
    UsageError,
    channel_of,
    check_tile_rows,
    frequencies_of,
    interval_of,
)
from amulor.cli.calibrate import _numbers
from amulor.cli.export import line_of, scale_of
from amulor.cli.info import _chance, _counted, _print_ranges
from amulor.cli.report import _check_of
from amulor.cli.survey import _whereabouts


def test_a_check_is_a_length_between_two_pixels() -> None:
    check = _check_of("20,10 21,60 40mm 1mm", 2)
    assert (check.name, check.first, check.second) == ("check 3", (20, 10), (21, 60))
    assert (check.expected, check.tolerance) == (0.04, 0.001)
    # Two points may be the same.
    same = _check_of("0,0 0,0 0mm", 0)
    assert (same.expected, same.tolerance) == (0.0, None)
    for text, words in (
        ("1,2 3,4 -1mm", "a length of 0 m or more and a tolerance above 0 m"),
        ("1,2 3,4 1mm 0mm", "a length of 0 m or more and a tolerance above 0 m"),
        ("1,2 3,-4 1mm", "a negative number"),
        ("1,2 3 1mm", "ROW,COLUMN ROW,COLUMN LENGTH"),
        ("1,2 3,4", "ROW,COLUMN ROW,COLUMN LENGTH"),
        ("1,2 3,4 1", "a number without a unit; needed is the length"),
    ):
        with pytest.raises(UsageError, match=words):
            _check_of(text, 0)


def test_an_interval_begins_at_0_m_or_beyond() -> None:
    assert interval_of(None, None) is None
    assert interval_of("0 m", "2 m") == (0.0, 2.0)
    for ends in (("-1 mm", "2 m"), ("2 m", "2 m"), ("3 m", "2 m")):
        with pytest.raises(UsageError, match="from at least 0 m to a larger range"):
            interval_of(*ends)


def test_frequencies_are_a_list_or_a_range() -> None:
    assert frequencies_of("--frequency", "39MHz, 40 MHz") == [39e6, 40e6]
    assert frequencies_of("--frequency", "0 MHz") == [0.0]
    with pytest.raises(UsageError, match="at least 0 Hz, got -1 Hz"):
        frequencies_of("--frequency", "-1 Hz")


def test_a_line_has_two_ends() -> None:
    assert line_of("-6cm, 0m, 6cm,1 mm") == (-0.06, 0.0, 0.06, 0.001)
    assert line_of("1m,1m,1m,2m") == (1, 1, 1, 2)
    with pytest.raises(UsageError, match="both ends are the same"):
        line_of("1m,2m,100cm,2m")
    with pytest.raises(UsageError, match="state four lengths"):
        line_of("1m,2m,1m")


def test_a_scale_is_a_ratio() -> None:
    assert scale_of("--scale", "1:20") == 20
    assert scale_of("--scale", " 1 : 2.5") == 2.5
    for text in ("20", "1:0", "2:1", "-1:2", "1:x", "1:inf"):
        with pytest.raises(UsageError, match=f"--scale.*{text}"):
            scale_of("--scale", text)


def test_densities_are_finite_numbers() -> None:
    assert _numbers("--densities", "0, 0.5,1") == [0.0, 0.5, 1.0]
    with pytest.raises(UsageError, match="needed are numbers with commas"):
        _numbers("--densities", "0,")


def test_a_tile_has_a_row_and_a_channel_upper_case_letters() -> None:
    check_tile_rows(None)
    check_tile_rows(1)
    with pytest.raises(UsageError, match="0"):
        check_tile_rows(0)
    assert channel_of(None) is None
    assert channel_of("vh") == "VH"
    assert channel_of("none") == "none"


def test_a_target_that_no_beam_meets_is_named_with_its_direction(plate) -> None:
    # The scan goes to 1.905 degrees on either side; the tangent is 0.03326.
    assert "another target hides it" in _whereabouts(plate, (0.0332, 0.0, 1.0))
    aside = _whereabouts(plate, (0.0333, 0.0, 1.0))
    assert "its center has azimuth 1.91 degrees, the scan -1.91 to 1.91" in aside
    # Down is a negative elevation; 0.765 degrees are 13.35 mm at 1 m.
    assert "another target hides it" in _whereabouts(plate, (0.0, 0.0133, 1.0))
    low = _whereabouts(plate, (0.0, math.tan(math.radians(0.8)), 1.0))
    assert "its center has elevation -0.8 degrees, the scan -0.765 to 0.765" in low
    assert "0.5 m behind the instrument" in _whereabouts(plate, (0.0, 0.0, -0.5))


def test_ranges_are_printed_as_quantiles_of_the_pixels_that_have_one(capsys) -> None:
    values = np.concatenate([np.linspace(1, 2, 101), [np.nan, np.nan]])
    _print_ranges(values)
    assert "median 1.5000 m, 1.0100 to 1.9900 m" in (text := capsys.readouterr().out)
    assert "101 of 103 hold a range" in text
    _print_ranges(np.full(4, np.nan))
    assert capsys.readouterr().out == "  slant range: 0 of 4 hold a range\n"


def test_dimensions_are_counted_in_words() -> None:
    sizes = {"modulation_frequency": 2, "polarization": 2, "row": 3, "shot": 5}
    assert _counted(sizes) == [("row", 3), ("open-water shot", 5)]
    assert (_chance(None), _chance(0.04)) == ("", " (chance below 0.04)")


#: Command without its inputs, option, values within its bounds, values beyond them.
BOUNDS = [
    (
        ["simulate", "none.toml", "-o", "b.nc"],
        "--error",
        ["0.001", "0.999"],
        ["0", "1"],
    ),
    (["backscatter", "none.toml"], "--error", ["0.001", "2"], ["0", "-0.1"]),
    (["profile", "none.nc", "--pixel", "1,2"], "--most", ["1", "5"], ["0", "-1"]),
    (
        ["run", "none.toml", "-o", "b", "--scheduler", "local"],
        "--workers",
        ["1", "2"],
        ["0", "-1"],
    ),
    (["run", "none.toml", "-o", "b"], "--tile-rows", ["1"], ["0"]),
    (["watch", "none"], "--every", ["1 ms", "1 h"], ["0 s", "-1 s"]),
    (
        ["calibrate", "plate", "none.nc", "--distance", "1 m", "-o", "b.toml"],
        "--densities",
        ["0", "10"],
        ["-0.001", "10.001"],
    ),
    (["image", "none.nc", "-o", "b.nc"], "--tile-rows", ["1"], ["0"]),
]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([*words, option, value], code)
        for words, option, *sides in BOUNDS
        for code, values in zip((1, 2), sides, strict=True)
        for value in values
    ],
    ids=lambda value: " ".join(value[-2:]) if isinstance(value, list) else "",
)
def test_a_number_is_accepted_up_to_its_bounds(
    words: list[str],
    expected: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch,
    tmp_path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == expected
    # Within its bounds, the number is no problem, but the missing input is one.
    message = capsys.readouterr().err
    assert ("none" in message) == (expected == 1), message
    assert expected == 1 or words[-2] in message


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("reject a.nc", "reject: --method is missing. Example: amulor reject "),
        (
            "reject a.nc --methd auto",
            "--method is missing; did you mean --method instead of --methd? Example: ",
        ),
        ("reject a.nc --method auto -o", "--output needs a value. Example: "),
        ("reject a.nc b.nc --method auto -o t.nc", "too many arguments: b.nc. Example"),
        ("site register", "site register: SITE is missing. Example: amulor site "),
        ("image t.nc -o i.nc --frequency 3", "Unknown option: --frequency. Example: "),
        ("view x.nc --port ten", "view: --port: found 'ten', needed is a whole number"),
        (
            "water --wavelength 405nm --temperature warm",
            "--temperature: found 'warm', needed is a number",
        ),
    ],
)
def test_wrong_words_are_answered_with_an_example(words, expected, capsys) -> None:
    assert main(words.split()) == 2
    answer = capsys.readouterr().err
    assert expected in answer
    assert answer.count("\n") == 1
