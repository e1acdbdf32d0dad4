"""A survey file is read strictly, and each mistake gets one line."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from amulor.errors import SurveyError
from amulor.studies.ladder import WATERS, survey_text
from amulor.survey import Survey, json_schema, water_properties


@pytest.mark.parametrize("water", WATERS)
def test_shipped_surveys_survive_a_round_trip(water: str) -> None:
    survey = Survey.from_text(survey_text(water))
    assert Survey.from_text(survey.to_toml()) == survey


def test_a_survey_holds_si_units(plate: Survey) -> None:
    assert plate.instrument.wavelength == pytest.approx(405e-9)
    assert plate.instrument.modulation_frequencies == (39e6,)
    assert plate.instrument.receiver.azimuth == pytest.approx(np.radians(-2.672))
    assert plate.scan.dwell == pytest.approx(0.125)


def test_a_survey_can_be_made_in_python_with_si_floats(plate: Survey) -> None:
    content = plate.model_dump(mode="python")
    assert Survey.model_validate(content) == plate


MISTAKES = [
    # what is replaced, by what, field, words that must be in the line
    ('absorption = "0.255', 'absorbtion = "0.255', "water.absorbtion", "'absorption'"),
    ('"0.255 1/m"', '"0.255 m"', "water.absorption", "1/m"),
    ('"0.255 1/m"', "0.255", "water.absorption", "without a unit"),
    ('"0.255 1/m"', '"-1 1/m"', "water.absorption", "at least 0"),
    ('"0.255 1/m"', "true", "water.absorption", "text such as"),
    ("reflectance = 0.1", "reflectance = 1.2", "targets.0.reflectance", "at most 1"),
    ('kind = "plate"', 'kind = "cube"', "targets.0", "plate, staircase, disc, mesh"),
    ('kind = "plate"', "", "targets.0", "plate, staircase, disc, mesh"),
    ('"VH"]', '"VX"]', "instrument.polarizations.1", "V, H, P, M, R, L"),
    ('"VH"]', '"VV"]', "instrument", "more than once"),
    ('["39 MHz"]', '["39 MHz", "20 MHz"]', "instrument", "must increase"),
    ('["39 MHz"]', "[]", "modulation_frequencies", "at least one"),
    ('["39 MHz"]', '"39 MHz"', "modulation_frequencies", "square brackets"),
    ("modulation_depth = 0.8", "modulation_depth = 2", "modulation_depth", "at most 1"),
    ('"405 nm"', '"405 um"', "instrument.wavelength", "must be at most 0.7 um"),
    ('"405 nm"', "405", "instrument.wavelength", 'such as "405 nm"'),
    ("depth = 0.8", 'depth = "150 %"', "modulation_depth", "must be at most 100 %"),
    ("columns = 12", "columns = 1.5", "scan.columns", "whole number"),
    ("columns = 12", "columns = 0", "scan.columns", "must be at least 1"),
    ("columns = 12", "columns = 1000000", "scan.columns", "at most 20000"),
    ('dwell = "125 ms"', 'dwell = "20 ms"', "survey", "five time constants"),
    ('dwell = "125 ms"', "", "scan.dwell", "is missing"),
    ("[scan]", '[scan]\nmoves = "all"', "scan.moves", "'beam' or 'both'"),
    ("forward_fraction = 1.0", "", "water", "forward_fraction"),
    (
        "[0.81, -0.81, -0.62]",
        "[0.81, -0.81, 0.62]",
        "backscatter_mueller",
        "eigenvalue",
    ),
    ('["7 cm", "0 m", "0 m"]', '["7 cm", "0 m"]', "receiver.position.2", "is missing"),
    ("[water]", "[[water]]", "water", "table of fields"),
    ('name = "Plate', "name = 3 #", "name", "text"),
    ("[water]", "[watter]", "watter", "'water'"),
    ("[scan]", "[scan", "", "TOML"),
]


@pytest.mark.parametrize(("old", "new", "field", "words"), MISTAKES)
def test_a_mistake_gets_one_line_with_file_field_and_remedy(
    plate_text: str, old: str, new: str, field: str, words: str
) -> None:
    assert old in plate_text
    with pytest.raises(SurveyError) as caught:
        Survey.from_text(plate_text.replace(old, new, 1), name="tank.toml")
    lines = str(caught.value).splitlines()
    assert all(line.startswith("tank.toml: ") for line in lines)
    assert any(field in line and words in line for line in lines), lines


def test_two_mistakes_get_two_lines(plate_text: str) -> None:
    text = plate_text.replace('"20 mW"', '"20 m"').replace('"30 cm"', '"30 kg"')
    with pytest.raises(SurveyError) as caught:
        Survey.from_text(text)
    lines = str(caught.value).splitlines()
    assert len(lines) == 3  # power, width and height
    assert sum("instrument.power" in line for line in lines) == 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "cannot be read"),
        (b"", "is missing"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "no text"),
        (b"x" * 2_000_000, "bytes"),
    ],
)
def test_a_file_that_is_no_survey_is_named(
    tmp_path: Path, content: bytes | None, words: str
) -> None:
    path = tmp_path / "survey.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SurveyError, match=words) as caught:
        Survey.from_toml(path)
    assert all(str(path) in line for line in str(caught.value).splitlines())


def test_a_window_must_stand_before_the_instrument(plate_text: str) -> None:
    text = plate_text + '[instrument.window]\ndistance = "-1 cm"\nthickness = "1 cm"\n'
    with pytest.raises(SurveyError, match=r"instrument.window.distance"):
        Survey.from_text(text)


def test_a_mesh_is_looked_for_beside_the_survey(
    plate_text: str, tmp_path: Path
) -> None:
    text = plate_text.replace('kind = "plate"', 'kind = "mesh"\nfile = "wreck.stl"')
    text = text.replace('width = "30 cm"\nheight = "30 cm"\n', "")
    path = tmp_path / "survey.toml"
    path.write_text(text)
    with pytest.raises(SurveyError, match=r"wreck\.stl"):
        Survey.from_toml(path)
    (tmp_path / "wreck.stl").write_text("")
    survey = Survey.from_toml(path)
    assert survey.targets[0].file == (tmp_path / "wreck.stl").resolve()


def test_the_json_schema_allows_what_is_shipped_and_names_units() -> None:
    schema = json_schema()
    assert ">>>" not in str(schema)
    json.dumps(schema)
    water = schema["$defs"]["Water"]
    assert water["additionalProperties"] is False
    assert "absorption" in water["required"]
    assert water["properties"]["absorption"]["examples"] == ["0.06 1/m"]
    assert "1/m" in water["properties"]["absorption"]["description"]


def test_stated_numbers_win_over_the_henyey_greenstein_form(plate: Survey) -> None:
    stated = water_properties(plate.with_({"water.asymmetry": 0.95}))
    assert stated.second_moment == 0.06
    assert stated.forward_scattering == pytest.approx(0.595)
    assert stated.diffuse_scattering == 0


def test_henyey_greenstein_gives_what_its_closed_forms_say(plate: Survey) -> None:
    g = 0.95
    parts = ("forward_fraction", "second_moment", "phase_function_at_180")
    changes = {f"water.{part}": None for part in parts}
    found = water_properties(plate.with_({**changes, "water.asymmetry": g}))
    # p(180) = (1 - g) / (4 pi (1 + g)^2), the form at cos = -1.
    at_180 = (1 - g**2) / (4 * np.pi * (1 + g) ** 3)
    assert found.backscatter_vsf == pytest.approx(0.595 * at_180, rel=1e-12)
    # Backscatter fraction (1-g)/(2g) [(1+g)/sqrt(1+g^2) - 1].
    backward = (1 - g) / (2 * g) * ((1 + g) / np.sqrt(1 + g**2) - 1)
    assert found.diffuse_scattering == pytest.approx(0.595 * backward, rel=1e-9)
    # Forward half, renormalised: 0.075 rad^2, to the digits printed.
    assert found.second_moment == pytest.approx(0.075, abs=5e-4)


def test_the_indices_follow_from_the_water_if_not_stated(plate: Survey) -> None:
    changes = {"water.refractive_index": None, "water.group_index": None}
    changes |= {"water.temperature": 20.0, "water.salinity": 0.0}
    found = water_properties(plate.with_(changes))
    # Fresh water at 20 degC and 405 nm: 1.3431 (vacuum) and 1.380.
    assert found.refractive_index == pytest.approx(1.34312, abs=2e-5)
    assert found.group_index == pytest.approx(1.380, abs=5e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = " + "[" * 50_000 + "]" * 50_000, "nested deeper than 20 levels"),
        ("a = " + "{b = " * 20_000 + "1" + "}" * 20_000, "nested deeper than 20"),
        (".".join(["a"] * 20_000) + " = 1", "nested deeper than 20 levels"),
        ("[" + ".".join(["a"] * 20_000) + "]", "nested deeper than 20 levels"),
        ("a = " + "[" * 30 + "]" * 30, "nested deeper than 20 levels"),
        ("columns = 1" + "0" * 5_000, "a whole number with more digits than any"),
        ("k" * 60_000 + " = 1", "k{100}\\.\\.\\.: is no field of a survey"),
    ],
    ids=["arrays", "tables", "keys", "header", "30 levels", "digits", "key"],
)
def test_texts_beyond_all_measure_get_one_line_at_once(text, message) -> None:
    start = time.process_time()
    with pytest.raises(SurveyError, match=message) as raised:
        Survey.from_text(text)
    assert time.process_time() - start < 1
    assert all(len(line) < 400 for line in str(raised.value).splitlines())


def test_long_lists_of_numbers_and_texts_with_dots_are_no_keys() -> None:
    numbers = ", ".join(f"{value / 100:.2f}" for value in range(300))
    with pytest.raises(SurveyError, match="a: is no field of a survey"):
        Survey.from_text(f"a = [{numbers}]\nb = [\n{numbers}\n]\nc = '{'.' * 300}'")


@pytest.mark.parametrize(
    ("count", "more"), [(19, None), (20, None), (21, 1), (900, 880)]
)
def test_twenty_errors_are_printed_and_the_others_counted(
    plate_text: str, count: int, more: int | None
) -> None:
    text = plate_text + "".join(f"\n[unknown{n}]" for n in range(count))
    with pytest.raises(SurveyError) as caught:
        Survey.from_text(text)
    lines = str(caught.value).splitlines()
    assert sum("is no field of a survey" in line for line in lines) == min(count, 20)
    further = [] if more is None else [f"survey: {more} further errors are left out"]
    assert lines[20:] == further


def test_a_file_may_have_as_many_bytes_as_the_limit(plate_text, tmp_path, monkeypatch):
    path = tmp_path / "plate.toml"
    path.write_text(plate_text)
    size = path.stat().st_size
    monkeypatch.setattr("amulor.survey.survey._SIZE_LIMIT", size)
    assert Survey.from_toml(path) == Survey.from_text(plate_text)
    monkeypatch.setattr("amulor.survey.survey._SIZE_LIMIT", size - 1)
    with pytest.raises(SurveyError, match=f"has {size} bytes"):
        Survey.from_toml(path)


def test_a_survey_that_is_none_is_refused_before_slow_imports(tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text("a = " + "[" * 50_000)
    code = (
        "import sys; from amulor.cli import main\n"
        "assert main(['survey', 'check', 'deep.toml']) == 1\n"
        "assert 'xarray' not in sys.modules, 'xarray was imported'"
    )
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "deep.toml: is nested deeper than 20 levels" in done.stderr
