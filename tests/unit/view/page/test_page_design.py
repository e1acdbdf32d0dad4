"""The page with sliders: what its server answers, and how fast."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from starlette.testclient import TestClient

from amulor.design import evaluate
from amulor.survey import Survey
from amulor.view.design.explorer import Asked, Explorer

TOKEN = "a-token-for-tests"


@pytest.fixture(scope="module")
def explorer() -> Explorer:
    return Explorer(
        Survey.preset("amulor-2010"),
        asked=[
            Asked(distance=1.5, attenuation=0.06, accuracy=1e-3),
            Asked(distance=5.0, attenuation=0.9, accuracy=1e-3),
        ],
    )


@pytest.fixture
def dragged(served: Callable[..., TestClient], explorer: Explorer) -> TestClient:
    return served(explorer)


def _ask(client: TestClient, path: str, **wanted: object) -> object:
    answer = client.post(f"/{TOKEN}/{path}", json=wanted)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_the_page_and_its_sliders_begin_at_the_survey(
    dragged: TestClient, explorer: Explorer
) -> None:
    page = dragged.get(f"/{TOKEN}/")
    assert 'src="static/design.js"' in page.text
    assert "http" not in page.text.replace("http-equiv", "")
    scene = dragged.get(f"/{TOKEN}/scene").json()
    stated = {one["name"]: one["value"] for one in scene["sliders"]}
    assert stated == pytest.approx(
        {"power": 0.02, "frequency": 39e6, "baseline": 0.07, "radius": 0.02,
         "field_of_view": 0.08, "dwell": 0.125, "reflectance": 0.1}
    )  # fmt: skip
    assert all(one["low"] < one["value"] < one["high"] for one in scene["sliders"])
    assert len(scene["distance"]) * len(scene["attenuation"]) > 1000
    assert scene["waters"][0]["name"] == scene["water"] == "own"


def test_a_map_is_what_evaluate_says_of_the_same_survey(
    dragged: TestClient, explorer: Explorer
) -> None:
    settings = {"power": 0.005, "baseline": 0.12, "radius": 0.01}
    found = _ask(dragged, "map", settings=settings, water="II")
    # The same written down as a survey and evaluated at places of the map.
    text = dragged.post(
        f"/{TOKEN}/survey", json={"settings": settings, "water": "II"}
    ).content.decode()
    survey = Survey.from_text(text)
    assert survey.instrument.power == 0.005
    assert survey.instrument.receiver.position[0] == pytest.approx(0.12)
    distance, attenuation = explorer.distance, explorer.attenuation
    error = np.array(found["error"]).reshape(len(attenuation), len(distance))
    own = evaluate(survey, distance=distance, attenuation=attenuation)
    own = own["total_error"].transpose("attenuation", "distance") * 1e3
    # Baselines move along the line between emitter and receiver; the aim stays.
    near = error < 50
    assert np.median(abs(error / own.values - 1)[near]) < 0.02


def test_frequencies_keep_their_proportions(explorer: Explorer) -> None:
    survey = Survey.preset("amulor-2010-long")
    text = Explorer(survey).as_survey({"frequency": 276e6})
    moved = Survey.from_text(text).instrument.modulation_frequencies
    assert moved == pytest.approx((20e6, 78e6, 276e6))


def test_what_is_asked_for_is_met_or_not(dragged: TestClient) -> None:
    first, second = _ask(dragged, "met", settings={}, water="own")
    assert first["met"]
    assert first["text"].startswith("1.5 m, 0.06 1/m: 0.48")
    assert not second["met"]
    # Beyond 2.87 m the phases of 39 MHz repeat.
    assert "ambiguous" in second["text"]


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({"settings": {"colour": 1.0}}, "no slider 'colour'"),
        ({"settings": {"power": "much"}}, "must be a number"),
        ({"settings": {"power": -1.0}}, "must be above 0"),
        ({"settings": [], "water": "own"}, "must be an object"),
        ({"water": "beer"}, "no water 'beer'"),
    ],
)
def test_a_wrong_wish_is_answered_in_words(
    dragged: TestClient, wanted: dict[str, object], words: str
) -> None:
    answer = dragged.post(f"/{TOKEN}/map", json=wanted)
    assert answer.status_code == 422
    assert words in answer.json()["error"]


def test_a_map_takes_less_than_ten_times_as_long_as_four_of_its_places(
    explorer: Explorer,
) -> None:
    corners = Explorer(explorer.survey, asked=explorer.asked)
    corners.distance = corners.distance[[0, -1]]
    corners.attenuation = corners.attenuation[[0, -1]]
    taken: dict[Explorer, list[float]] = {explorer: [], corners: []}
    for step in range(6):
        for shown, times in taken.items():
            begun = time.process_time()
            shown.map({"baseline": 0.07 + 0.002 * step, "radius": 0.02 + 1e-4 * step})
            times.append(time.process_time() - begun)
    # A map has 264 times as many places; computed one after another, they would show.
    assert min(taken[explorer]) < 10 * min(taken[corners])
