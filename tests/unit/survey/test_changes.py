"""A survey is changed in Python under the same rules that a file is read by."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from amulor.errors import SurveyError
from amulor.survey import OpenWater, Survey, Water
from amulor.survey.survey import changed


def test_a_change_is_what_the_file_with_it_says(plate: Survey, plate_text: str) -> None:
    for old, new, changes in (
        ('"0.255 1/m"', '"0.2 1/m"', {"water.absorption": 0.2}),
        ('"0.255 1/m"', '"0.2 1/m"', {"water.absorption": "0.2 1/m"}),
        ("reflectance = 0.1", "reflectance = 0.3", {"targets.0.reflectance": 0.3}),
        ('["39 MHz"]', '["39 MHz", "78 MHz"]',
         {"instrument.modulation_frequencies": ["39 MHz", 78e6]}),
        ("repeats = 8", "repeats = 9", {"scan.open_water.repeats": 9}),
        ("columns = 5\nrows = 3\nrepeats = 8", "",
         {"scan.open_water": OpenWater()}),
        ("refractive_index = 1.34\n", "", {"water.refractive_index": None}),
        ("columns = 12\nrows = 6", "columns = 7\nrows = 9",
         {"scan.columns": 7, "scan.rows": 9}),
    ):  # fmt: skip
        assert old in plate_text
        assert plate.with_(changes) == Survey.from_text(plate_text.replace(old, new))


@given(st.floats(1e-6, 100), st.floats(0, 100), st.integers(1, 500))
def test_any_allowed_number_comes_through_bit_by_bit(
    plate: Survey, absorption: float, scattering: float, columns: int
) -> None:
    found = plate.with_(
        {
            "water.absorption": absorption,
            "water.scattering": scattering,
            "scan.columns": columns,
        }
    )
    assert found.water.absorption == absorption
    assert found.water.scattering == scattering
    assert found.scan.columns == columns
    # Nothing else has moved, and the survey it came from has not either.
    back = {
        "water.absorption": plate.water.absorption,
        "water.scattering": plate.water.scattering,
        "scan.columns": plate.scan.columns,
    }
    assert found.with_(back) == plate


def test_a_new_source_of_the_group_index_replaces_the_old_one(plate: Survey) -> None:
    by_number = plate.with_({"calibration": {"group_index_uncertainty": 0.001}})
    probes = {
        "calibration.temperature_uncertainty": "0.5 degC",
        "calibration.salinity_uncertainty": 0.5,
    }
    by_probes = by_number.with_(probes)
    assert by_probes.calibration.group_index_uncertainty is None
    assert by_probes.calibration.temperature_uncertainty == 0.5
    name = "calibration.group_index_uncertainty"
    assert by_probes.with_({name: 0.001}) == by_number
    # Removal of what is not stated changes nothing; two sources at once are refused.
    assert by_number.with_(dict.fromkeys(probes)) == by_number
    with pytest.raises(SurveyError, match="stated twice"):
        by_number.with_({**probes, name: 0.002})


def test_a_whole_part_can_be_another_one(plate: Survey) -> None:
    water = Water(absorption=0.1, scattering=0.2, asymmetry=0.9)
    assert plate.with_({"water": water}).water == water
    assert plate.with_({"targets": []}).targets == ()
    two = plate.with_({"targets": [*plate.targets, plate.targets[0]]})
    assert two.targets == plate.targets * 2
    assert plate.with_({}) == plate


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"water.absorption": -1.0}, r"water\.absorption: found -1.*at least 0"),
        ({"water.absorption": "2 m"}, r"water\.absorption: .*1/m"),
        ({"water.absorbtion": 0.2}, r"water\.absorbtion: .*'absorption'"),
        ({"watter.absorption": 0.2}, r"watter is not there"),
        ({"water.absorption": None}, r"water\.absorption: is missing"),
        ({"targets.1.reflectance": 0.3}, r"targets\.1: found '1'.*from 0 to 0"),
        ({"targets.first": {}}, r"targets\.first: found 'first'"),
        ({"targets.0.reflectance": 1.2}, r"targets\.0\.reflectance: .*at most 1"),
        ({"instrument.window.distance": 0.3}, r"instrument\.window is not there"),
        ({"instrument.power.max": 0.3}, r"instrument\.power is no table"),
        ({"scan.dwell": "20 ms"}, "survey: .*five time constants"),
        ({"instrument.polarizations": ["VV", "VV"]}, "more than once"),
        (
            {"scan.open_water": None, "scan.open_water.repeats": 3},
            r"scan\.open_water\.repeats: is a part of scan\.open_water",
        ),
    ],
)
def test_a_wrong_change_is_refused_by_its_field(
    plate: Survey, changes: dict[str, object], words: str
) -> None:
    before = plate.to_toml()
    with pytest.raises(SurveyError, match=words):
        plate.with_(changes)
    assert plate.to_toml() == before


def test_all_mistakes_get_a_line(plate: Survey) -> None:
    with pytest.raises(SurveyError) as caught:
        plate.with_({"water.absorption": -1.0, "scan.columns": 0})
    assert len(str(caught.value).splitlines()) == 2


def test_a_mesh_must_be_there(plate: Survey, tmp_path: Path) -> None:
    mesh = {"kind": "mesh", "file": "wreck.stl", "reflectance": 0.1}
    position = ["0 m", "0 m", "1 m"]
    with pytest.raises(SurveyError, match=r"wreck\.stl"):
        plate.with_({"targets.0": {**mesh, "position": position}})
    file = tmp_path / "wreck.stl"
    file.write_text("solid\nendsolid\n")
    found = plate.with_({"targets.0": {**mesh, "position": position, "file": file}})
    assert found.targets[0].file == file.resolve()
    # What has been found is not looked for again in another folder.
    assert found.with_({"scan.rows": 2}).targets == found.targets


def test_model_copy_validates_too(plate: Survey) -> None:
    assert plate.water.model_copy(update={"absorption": 0.2}).absorption == 0.2
    with pytest.raises(ValidationError, match="absorption"):
        plate.water.model_copy(update={"absorption": -1.0})
    with pytest.raises(ValidationError, match="absorbtion"):
        plate.water.model_copy(update={"absorbtion": 1.0})
    short = plate.scan.model_copy(update={"dwell": 1e-3})
    with pytest.raises(ValidationError, match="five time"):
        plate.model_copy(update={"scan": short})


def test_the_content_that_is_changed_stays_as_it_is() -> None:
    content = {"a": {"b": (1, 2)}, "c": [{"d": 1}]}
    found = changed(content, {"a.b.1": 5, "c.0.d": 2}, name="survey")
    assert found == {"a": {"b": [1, 5]}, "c": [{"d": 2}]}
    assert content == {"a": {"b": (1, 2)}, "c": [{"d": 1}]}
