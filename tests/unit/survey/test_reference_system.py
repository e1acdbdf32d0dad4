"""Numbers of EPSG are checked where a survey or a site is read."""

import sys

import pytest

from amulor.errors import MissingExtraError, SurveyError
from amulor.site.description import SiteFrame
from amulor.survey import Pose
from amulor.survey.scan import projected_code, read_pose

WRONG = {
    "EPSG:99999": "EPSG has no system 99999",
    "EPSG:4326": r"EPSG:4326 \(WGS 84\) is in units of degree; state a projected",
    "EPSG:2263": "in units of US survey foot",
    "EPSG:4978": "no projected system",
    "EPSG:5972": r'with heights; state its horizontal part, "EPSG:25832"',
    "EPSG:3857": "stretches lengths",
    "EPSG 25832": 'is no number of EPSG: write "EPSG:"',
    "25832": 'is no number of EPSG: write "EPSG:"',
}


@pytest.mark.parametrize("text", WRONG)
def test_a_survey_and_a_site_refuse_it_in_a_line(text, tmp_path) -> None:
    path = tmp_path / "pose.toml"
    path.write_text(f'[pose]\ncrs = "{text}"\n')
    with pytest.raises(SurveyError, match=WRONG[text]) as caught:
        read_pose(path)
    assert "crs" in str(caught.value)
    assert str(caught.value).count("\n") <= 1
    with pytest.raises(ValueError, match=WRONG[text]):
        SiteFrame(crs=text)


@pytest.mark.parametrize("text", ["EPSG:25832", "epsg:2056", "EPSG:3031"])
def test_projected_systems_in_metres_are_taken(text) -> None:
    assert Pose(crs=text).crs == SiteFrame(crs=text).crs == text
    assert projected_code(text) == int(text[5:])


def test_a_name_is_a_name() -> None:
    assert Pose(crs="grid of the harbour 2026").crs == "grid of the harbour 2026"
    assert projected_code("grid of the harbour 2026") is None


def test_without_pyproj_the_form_is_checked_and_no_file_is_written(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert Pose(crs="EPSG:4326").crs == "EPSG:4326"
    with pytest.raises(ValueError, match="is no number of EPSG"):
        Pose(crs="EPSG:432")
    with pytest.raises(MissingExtraError, match=r"pyproj.*amulor\[export\]"):
        projected_code("EPSG:4326")
