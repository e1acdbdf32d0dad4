"""Each example of the page on survey files, and each shipped survey, is run."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from amulor.cli import main
from amulor.errors import SurveyError
from amulor.simulation import simulate
from amulor.simulation.transport import monte_carlo_response
from amulor.survey import Survey, water_properties

ROOT = Path(__file__).parents[2]
FILES = ROOT / "examples" / "surveys"
PAGE = (ROOT / "docs" / "reference" / "survey-file.md").read_text(encoding="utf-8")
SECTIONS = {
    title: tomllib.loads(text)
    for title, text in re.findall(
        r"^## (.+?)$\n.*?^```toml\n(.*?)^```$", PAGE, re.M | re.S
    )
}
WHOLE, *PARTS = SECTIONS
SHIPPED = [
    pytest.param(path, marks=pytest.mark.slow if path.stem == "harbour" else [])
    for path in sorted(FILES.glob("*.toml"))
]


def merged(part: dict[str, Any]) -> dict[str, Any]:
    """Return the first example with one part of it replaced."""
    content = dict(SECTIONS[WHOLE])
    for name, value in part.items():
        if name == "instrument":
            value = {**content["instrument"], **value}
        content[name] = value
    return content


def survey_of(title: str) -> Survey:
    part = {} if title == WHOLE else SECTIONS[title]
    return Survey.from_text(tomli_w.dumps(merged(part)), name=title, folder=FILES)


def test_every_water_phase_function_target_and_surface_has_an_example() -> None:
    from amulor.survey import json_schema

    kinds = {
        definition["properties"]["kind"]["const"]
        for definition in json_schema()["$defs"].values()
        if "const" in definition.get("properties", {}).get("kind", {})
    }
    assert len(kinds) > 15
    text = "\n".join(tomli_w.dumps(section) for section in SECTIONS.values())
    for kind in kinds:
        assert f'kind = "{kind}"' in text, kind


@pytest.mark.parametrize("title", SECTIONS)
def test_an_example_of_the_page_is_a_survey_whose_water_is_known(title: str) -> None:
    if "milk" in title or "spheres" in title:
        pytest.importorskip("miepython")
    survey = survey_of(title)
    water = water_properties(survey)
    assert water.attenuation > 0
    assert water.source
    assert Survey.from_text(survey.to_toml()) == survey


@pytest.mark.slow
@pytest.mark.parametrize("title", SECTIONS)
def test_an_example_of_the_page_can_be_simulated(title: str) -> None:
    survey = survey_of(title).with_({"scan.columns": 9, "scan.rows": 1})
    if water_properties(survey).layers:
        with pytest.raises(SurveyError, match="uniform water only"):
            simulate(survey, rng=1)
        ahead = survey.with_({"instrument.receiver.azimuth": 0.0})
        tally = monte_carlo_response(ahead, [0.0, 39e6], relative_error=0.3)
        assert 0 < abs(tally.signal[1]) < abs(tally.signal[0])
        return
    cube = simulate(survey, rng=1)
    truth = cube.amulor.truth
    for name in ("target", "water"):
        light = np.hypot(truth[f"{name}_in_phase"], truth[f"{name}_quadrature"])
        assert np.all(np.isfinite(light))
        assert light.max() > 0


@pytest.mark.parametrize("path", SHIPPED)
def test_a_shipped_survey_is_checked_and_says_what_its_water_is(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["survey", "check", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["water"]["scattering"] > 0
    assert found["water"]["phase_function"]
    assert main(["survey", "check", str(path)]) == 0
    text = capsys.readouterr().out
    assert found["water"]["source"] in text
    assert "asymmetry" in text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["harbour", "open_ocean"])
def test_a_shipped_survey_can_be_simulated(name: str) -> None:
    survey = Survey.from_toml(FILES / f"{name}.toml")
    small = survey.with_({"scan.columns": 8, "scan.rows": 6, "scan.open_water": None})
    cube = simulate(small, rng=1)
    met = cube.amulor.truth["target"].values
    assert set(np.unique(met)) == set(range(len(survey.targets)))


def test_the_check_shows_layers_and_moments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["survey", "check", str(FILES / "two_layers.toml")]) == 0
    text = capsys.readouterr().out
    assert "layer 1: 1.2 m thick, absorption 0.05 1/m, scattering 0.08 1/m" in text
    assert "layer 2: from there on, absorption 0.12 1/m" in text


@pytest.mark.slow
def test_the_check_of_water_by_moments_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tank.toml"
    path.write_text(survey_of("[water], by moments").to_toml())
    assert main(["survey", "check", str(path)]) == 0
    text = capsys.readouterr().out
    assert "by moments: second moment 0.06 rad^2 below 90 degrees" in text
    assert main(["survey", "check", str(path), "--json"]) == 0
    water = json.loads(capsys.readouterr().out)["water"]
    assert water["phase_function"] is None
    assert water["scattering"] == 0.595
