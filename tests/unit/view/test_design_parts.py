"""Sentences and tables of a design report, its figures, and sliders of its page."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from amulor.errors import SurveyError
from amulor.survey import Survey
from amulor.view.design import explorer as pages
from amulor.view.design import figures, report
from amulor.view.design.explorer import Asked, Explorer
from amulor.view.report import Heading, Paragraph, Picture, Table
from amulor.view.style import COLOURS


def found(*, regions: bool = True, wide: bool = True) -> xr.Dataset:
    """Errors of 1 mm per square meter, doubtful at the edges."""
    distance = np.linspace(0.5, 5, 10)
    attenuation = np.geomspace(0.1, 2.0 if wide else 0.7, 4)
    clear, near = np.meshgrid(attenuation, distance, indexing="ij")
    values = {
        "total_error": 1e-3 * near**2, "ambiguous": regions & (near > 4),
        "saturated": regions & (near < 0.8), "model_not_valid": regions & (clear > 0.5),
    }  # fmt: skip
    return xr.Dataset(
        {name: (("attenuation", "distance"), one) for name, one in values.items()},
        coords={"attenuation": attenuation, "distance": distance},
    )


def titles(figure: Figure) -> list[str]:
    return [axis.get_title("left") or axis.get_title() for axis in figure.axes]


def test_an_error_map_has_its_scale_labels_and_places() -> None:
    figure = figures.error_map(found(), asked=[(2.0, 0.4), (3.0, 0.2)], title="plate")
    assert_allclose(figure.get_size_inches(), [5.6, 3.9])
    axes, bar = figure.axes
    assert titles(figure)[0] == "plate"
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "distance [m]",
        "attenuation [1/m]",
    )
    assert bar.get_ylabel() == "total error [mm]"
    mesh = next(part for part in axes.collections if part.get_array() is not None
                and part.get_array().shape == (4, 10))  # fmt: skip
    assert_allclose(mesh.get_array(), np.tile(np.linspace(0.5, 5, 10) ** 2, (4, 1)))
    assert mesh.get_clim() == (0.1, 100)
    assert mesh.get_cmap().name == "cividis"
    assert mesh.get_rasterized()
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.5, 5.0), pytest.approx((0.1, 2.0)))
    assert axes.get_yscale() == "log"
    (rings,) = axes.lines
    assert_allclose(rings.get_xydata(), [[2.0, 0.4], [3.0, 0.2]])
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert words == ["asked for", *(label for _, label, _ in figures.REGIONS)]
    hatched = [part for part in axes.collections
               if isinstance(part, QuadContourSet) and part.filled]  # fmt: skip
    assert [part.hatches for part in hatched] == [["///"], ["..."], ["xxx"]]
    assert all(list(part.levels) == [0.5, 1.5] for part in hatched)
    lines = next(part for part in axes.collections
                 if isinstance(part, QuadContourSet) and not part.filled)  # fmt: skip
    assert_allclose(np.exp(lines.levels), [1, 3, 10])
    assert {text.get_text() for text in axes.texts} <= {"1 mm", "3 mm", "10 mm"}
    assert lines.get_path_effects()
    ticks = axes.yaxis.get_major_formatter()
    assert (ticks(0.5), ticks(2.0)) == ("0.5", "2")
    assert bar.yaxis.get_major_formatter()(10.0) == "10"


def test_a_narrow_map_is_linear_and_holes_are_bounded() -> None:
    narrow = found(regions=False, wide=False)
    narrow["total_error"].values[:] = 2e-3
    narrow["total_error"].values[0, 0] = np.inf
    figure = figures.error_map(narrow)
    (axes, _) = figure.axes
    assert axes.get_yscale() == "linear"
    assert axes.get_legend() is None
    assert len(axes.lines) == 0
    mesh = axes.collections[0]
    assert np.isnan(np.ma.filled(mesh.get_array().astype(float), np.nan)[0, 0])
    # No line of an error that is not met.
    assert not any(isinstance(part, QuadContourSet) for part in axes.collections)


def test_error_maps_side_by_side_share_a_scale_and_a_legend() -> None:
    figure = figures.error_maps(
        {"one": found(regions=False), "two": found()}, asked=[(2.0, 0.4)]
    )
    assert_allclose(figure.get_size_inches(), [6.2, 3.1])
    assert titles(figure)[:2] == ["one", "two"]
    first, second, bar = figure.axes
    assert first.get_ylabel() == "attenuation [1/m]"
    assert second.get_ylabel() == ""
    assert {axis.get_xlabel() for axis in (first, second)} == {"distance [m]"}
    assert bar.get_ylabel() == "total error [mm]"
    assert bar.yaxis.get_major_formatter()(0.5) == "0.5"
    (legend,) = figure.legends
    words = [text.get_text() for text in legend.get_texts()]
    assert words == ["asked for", *(label for _, label, _ in figures.REGIONS)]
    assert [len(axis.lines) for axis in (first, second)] == [1, 1]
    plain = figures.error_maps({"one": found(regions=False)})
    assert plain.legends == []


def test_fronts_have_both_costs_their_limits_and_what_is_asked_for() -> None:
    time = np.geomspace(60, 6000, 21)
    error = np.maximum(0.06 / time, 1e-4) - 1e-9 * time / 60
    error = np.r_[error, np.nan]
    time = np.r_[time, 60.0]
    given = {"scan_time": time, "top_frequency": 1e10 / time, "best": 4}
    figure = figures.fronts(error, target=1e-3, **given)
    assert_allclose(figure.get_size_inches(), [7.0, 3.0])
    first, second = figure.axes
    assert first.get_xlabel() == "time of a scan [min]"
    assert second.get_xlabel() == "highest frequency [MHz]"
    assert (first.get_ylabel(), second.get_ylabel()) == ("total error [mm]", "")
    for axis, cost in ((first, time / 60), (second, 1e4 / time)):
        lines = {line.get_label(): line for line in axis.lines}
        dots = lines["candidates"].get_xydata()
        assert_allclose(dots, np.stack([cost, 1e3 * error], axis=1)[:-1])
        assert lines["candidates"].get_rasterized()
        assert lines["best that there is"].get_drawstyle() == "steps-post"
        assert_allclose(lines["recommended"].get_xydata(), [[cost[4], 1e3 * error[4]]])
        (level,) = [line for line in axis.lines if line.get_linestyle() == "--"]
        assert_allclose(level.get_ydata(), 1.0)
        assert [(t.get_text(), t.xy) for t in axis.texts] == [("asked for", (1, 1.0))]
        assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")
        assert axis.xaxis.get_major_formatter()(20.0) == "20"
        assert any(line.get_visible() for line in axis.get_xgridlines())
        low = 1e3 * np.nanmin(error)
        high = 1e3 * np.nanmax(error)
        assert axis.get_ylim() == pytest.approx((low / 1.6, min(1.6 * high, 3e3 * low)))
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["candidates", "best that there is", "knee", "recommended"]
    bare = figures.fronts(error, **given)
    assert not bare.axes[0].texts
    wild = figures.fronts(np.r_[error[:-1], 1e3], **given)
    assert wild.axes[0].get_ylim()[1] == pytest.approx(3e3 * low)


@pytest.mark.parametrize(("error", "right"), [(0.02, 1.0), (0.5, 1.05 * 1.2)])
def test_bars_of_shares_have_errors_and_room(error: float, right: float) -> None:
    figure = figures.sensitivity_bars(["a", "b", "c"], [0.2, 0.7, 0.1], [0.1, error, 0])
    assert_allclose(figure.get_size_inches(), [5.6, 0.7 + 0.24 * 3])
    (axes,) = figure.axes
    assert axes.get_xlim() == pytest.approx((0, right))
    bars = axes.containers[0][2][0].get_segments()
    ends = [[0.1, 0.1], [0.1, 0.3], [0.7 - error, 0.7 + error]]
    assert_allclose([part[:, 0] for part in bars], ends, atol=1e-12)
    assert [text.get_text() for text in axes.get_yticklabels()] == ["c", "a", "b"]
    assert axes.get_xlabel().startswith("share of the variance of the error")
    assert {to_hex(bar.get_facecolor()) for bar in axes.patches} == {COLOURS[5].lower()}
    assert any(line.get_visible() for line in axes.get_xgridlines())
    assert not any(line.get_visible() for line in axes.get_ygridlines())
    assert axes.get_axisbelow() is True


def choice(**fields: Any) -> Any:
    given = {
        "parameters": None, "error": 2.5e-3, "worst_distance": 3.0, "share": 0.9,
        "cost": 12345.0, "scan_time": 150.0, "binding": "shot_noise", "lines": None,
        "requirements": (), **fields,
    }  # fmt: skip
    return SimpleNamespace(**given)


def recommendation(**fields: Any) -> Any:
    accuracy = SimpleNamespace(share=0.9, total_error=3e-3)
    given = {
        "best": choice(), "goal": SimpleNamespace(accuracy=accuracy), "bounds": (),
        "impossible": (), "runner_up": None, **fields,
    }  # fmt: skip
    return SimpleNamespace(**given)


def test_the_answer_states_error_time_and_cost(monkeypatch) -> None:
    monkeypatch.setattr(report, "parameters_text", lambda parameters: "a blue laser")
    (build,) = report._answer(recommendation())
    assert build.text == (
        "Build this: a blue laser. It reaches 2.5 mm at 3 m in 90% of the waters and "
        "targets, with 3 mm asked for, in 2.5 min a scan, for 12,345; what binds is "
        "shot noise."
    )
    (free,) = report._answer(recommendation(best=choice(cost=0.0)))
    assert "a scan; what binds" in free.text
    conflicts = [SimpleNamespace(text="time"), SimpleNamespace(text="power")]
    none, *relax = report._answer(recommendation(impossible=conflicts))
    assert none.text == (
        "No instrument of these components does it. The nearest one is a blue laser: "
        "2.5 mm at 3 m in 90% of the waters and targets, with 3 mm asked for."
    )
    assert [part.text for part in relax] == [
        "Requirement to relax: time.", "Requirement to relax: power.",
    ]  # fmt: skip
    bound = SimpleNamespace(text="the power is the largest")
    (edge,) = report._edges(recommendation(bounds=[bound]))
    assert edge.text == "At an edge: the power is the largest."


def test_components_are_listed_beside_the_runner_up(monkeypatch) -> None:
    monkeypatch.setattr(report, "_written", lambda chosen, name: f"{chosen} {name}")
    lines = {"recommended": {"speed": "1 m/s"}, "other": {"speed": "2 m/s"}}
    monkeypatch.setattr(report, "lines_texts", lambda lines, parameters: lines)
    best = choice(parameters="A", lines=lines["recommended"])
    other = choice(parameters="B", cost=0.0, lines=lines["other"], scan_time=60.0)
    table = report._components(recommendation(best=best, runner_up=other))
    assert table.header == ["", "recommended", "runner-up"]
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["laser"] == ["A laser", "B laser"]
    assert rows["error at the worst distance"] == ["2.5 mm", "2.5 mm"]
    assert rows["share of waters and targets"] == ["90%", "90%"]
    assert rows["binds"] == ["shot noise", "shot noise"]
    assert rows["time of a scan"] == ["2.5 min", "1 min"]
    assert rows["cost"] == ["12,345", "not stated"]
    assert rows["speed"] == ["1 m/s", "2 m/s"]
    assert len(table.rows) == 9 + 5 + 1
    alone = report._components(recommendation(best=choice(parameters="A")))
    assert alone.header == ["", "recommended"]
    assert len(alone.rows) == 14


def test_parameters_are_written_with_their_units() -> None:
    chosen: Any = SimpleNamespace(frequencies=(20e6, 39.5e6), laser="blue")
    assert report._written(chosen, "frequencies") == "20, 39.5 MHz"
    assert report._written(chosen, "laser") == "blue"


def test_measurements_and_assumptions_have_their_numbers() -> None:
    assert report._measure(None, {}) == []
    sensitivity: Any = SimpleNamespace(
        largest=SimpleNamespace(label="attenuation"), spread=math.log(1.5)
    )
    heading, text, picture = report._measure(sensitivity, {"sensitivity": Figure()})
    assert isinstance(heading, Heading)
    assert isinstance(picture, Picture)
    assert text.text == (
        "The error depends most on: attenuation. All together change it by a factor of "
        "1.50 (one standard deviation)."
    )
    turn: Any = SimpleNamespace(label="power", value=0.0123, unit="W", turns_at=0.5,
                                factor=2.345)  # fmt: skip
    plain: Any = SimpleNamespace(label="depth", value=0.5, unit="1", turns_at=0.25,
                                 factor=None)  # fmt: skip
    never: Any = SimpleNamespace(label="dark", value=3.0, unit="1/s", turns_at=None,
                                 factor=None)  # fmt: skip
    _, table = report._turns(recommendation(runner_up=choice()), [turn, plain, never])
    assert table.rows == [
        ["power", "0.0123 W", "0.5 W", "2.35"], ["depth", "0.5", "0.25", ""],
        ["dark", "3 1/s", "not within a factor of 10", ""],
    ]  # fmt: skip
    assert report._turns(recommendation(), [turn]) == []
    assert report._turns(recommendation(runner_up=choice()), []) == []


def test_requirements_are_met_or_missed(monkeypatch) -> None:
    monkeypatch.setattr(report, "written", lambda name, value: f"{name}={value:g}")
    one: Any = SimpleNamespace(
        name="total error at 2 m", met=True, value=1.0, limit=2.0, margin=1000.0,
        binding="a_b",
    )  # fmt: skip
    other: Any = SimpleNamespace(name="time", met=False, value=3.0, limit=2.0,
                                 margin=0.6667, binding="c")  # fmt: skip
    table = report._requirements(choice(requirements=[one, other]))
    assert table.rows == [
        ["total error at 2 m", "met", "total error=1", "total error=2", "above 1000",
         "a b"],
        ["time", "!missed", "time=3", "time=2", "0.667", "c"],
    ]  # fmt: skip


def test_scans_and_photons_are_compared_with_the_prediction() -> None:
    scans: Any = SimpleNamespace(
        distance=1.5, predicted=2e-3, achieved=2.5e-3, ratio=1.25, ratio_error=0.02,
        offset=-1e-5, offset_error=2e-5, holds=False, ranges=1728,
    )  # fmt: skip
    photons: Any = SimpleNamespace(
        frequency=np.array([1e6, 3e6, 2e6]), shift=np.array([1.0, 2e-3, 3.0]),
        shift_error=np.array([1.0, 1e-4, 3.0]), echo=np.array([9, 0.5, 9]),
        echo_error=np.array([9, 0.01, 9]), water=np.array([9, 1.5, 9]),
        water_error=np.array([9, 0.03, 9]), range_bound=1.23e-3,
    )  # fmt: skip
    first: Any = SimpleNamespace(name="best", scans=scans, photons=photons, late=1e-3,
                                 said=("it holds", "or not"))  # fmt: skip
    good = SimpleNamespace(**{**vars(scans), "holds": True})
    second: Any = SimpleNamespace(name="other", scans=good, photons=None, late=0.0,
                                  said=())  # fmt: skip
    heading, *texts, table = report._confirmed([first, second])
    assert isinstance(heading, Heading)
    assert [part.text for part in texts if isinstance(part, Paragraph)] == [
        "it holds.", "or not.",
    ]  # fmt: skip
    assert isinstance(table, Table)
    ends = ["1.5 m", "2", "2.5"]
    assert table.rows == [
        ["best", *ends, "!1.250 ± 0.020", "-0.010 ± 0.020", "0.500 ± 0.010",
         "1.500 ± 0.030", "2.00 ± 0.10", "1.00", "1.23"],
        ["other", *ends, "1.250 ± 0.020", "-0.010 ± 0.020", "", "", "", "", ""],
    ]  # fmt: skip
    assert table.caption.startswith("1728 simulated ranges of each")
    photons.range_bound = np.inf
    assert report._confirmed([first])[-1].rows[0][-1] == ""
    assert report._confirmed([]) == []


def test_the_waters_of_a_goal_are_scaled(monkeypatch, plate: Survey) -> None:
    monkeypatch.setattr(
        report, "water_scale", lambda goal, chosen: {"attenuation": 2.0}
    )
    monkeypatch.setattr(report, "survey_of", lambda goal, chosen: plate)
    waters = SimpleNamespace(attenuation=SimpleNamespace(low=0.1, high=0.4))
    goal: Any = SimpleNamespace(waters=waters)
    assert report.waters_of(goal, None) == (0.2, 0.8)
    waters.attenuation = None
    # Absorption and scattering of the survey.
    assert report.waters_of(goal, None) == pytest.approx((0.85, 0.85))


@pytest.fixture(scope="module")
def sliders(plate: Survey) -> Explorer:
    return Explorer(plate)


def test_a_map_without_wishes_has_the_usual_limits(sliders: Explorer) -> None:
    assert (len(sliders.distance), len(sliders.attenuation)) == (44, 24)
    assert (sliders.distance[0], sliders.distance[-1]) == (0.5, 10)
    # A quarter and four times the attenuation of the survey.
    ends = sliders.attenuation[[0, -1]]
    assert_allclose(ends, [0.85 / 4, 0.85 * 4])
    assert_allclose(np.diff(np.log(sliders.attenuation)), np.log(16) / 23)
    assert_allclose(np.diff(sliders.distance), 9.5 / 43)


def test_a_map_has_room_around_what_is_asked_for(plate: Survey) -> None:
    asked = [Asked(distance=1.0, attenuation=0.5, accuracy=1e-3),
             Asked(distance=3.0, attenuation=0.1, accuracy=1e-3)]  # fmt: skip
    wished = Explorer(plate, asked=asked)
    assert_allclose(wished.distance[[0, -1]], [0.5, 6])
    assert_allclose(wished.attenuation[[0, -1]], [0.025, 2])
    stated = Explorer(plate, distances=(2, 4), attenuations=(0.3, 0.6))
    assert_allclose(stated.distance[[0, -1]], [2, 4])
    assert_allclose(stated.attenuation[[0, -1]], [0.3, 0.6])
    assert wished.describe()["asked"] == [[1.0, 0.5], [3.0, 0.1]]


def test_sliders_have_units_spans_and_limits(sliders: Explorer) -> None:
    drawn = {one["name"]: one for one in sliders.describe()["sliders"]}
    assert {name: (one["factor"] * one["value"], one["unit"])
            for name, one in drawn.items()} == {
        "power": (pytest.approx(20), "mW"), "frequency": (pytest.approx(39), "MHz"),
        "baseline": (pytest.approx(7), "cm"), "radius": (pytest.approx(20), "mm"),
        "field_of_view": (pytest.approx(np.degrees(0.08)), "deg"),
        "dwell": (pytest.approx(125), "ms"), "reflectance": (pytest.approx(10), "%"),
    }  # fmt: skip
    assert {name: (one["low"], one["high"]) for name, one in drawn.items()} == {
        "power": pytest.approx((0.02 / 30, 0.6)),
        "frequency": pytest.approx((3.9e6, 39e7)),
        "baseline": pytest.approx((0.07 / 8, 0.56)),
        "radius": pytest.approx((4e-3, 0.1)),
        "field_of_view": pytest.approx((0.01, 0.4)),
        "dwell": pytest.approx((0.125 / 30, 3.75)),
        "reflectance": pytest.approx((5e-3, 1.0)),
    }  # fmt: skip
    assert {one["scale"] for one in drawn.values()} == {"log"}
    limits = {name: (s.least, s.most) for name, s in pages._SLIDERS.items()}
    assert limits == {
        "power": (0.0, math.inf), "frequency": (1e6, 2e9), "baseline": (5e-3, 2.0),
        "radius": (1e-3, 0.3), "field_of_view": (1e-3, 0.4), "dwell": (1e-6, 60.0),
        "reflectance": (0.005, 1.0),
    }  # fmt: skip


def test_the_page_names_light_regions_and_waters(sliders: Explorer) -> None:
    scene = sliders.describe()
    assert scene["title"] == "Plate in a small tank"
    assert scene["subtitle"] == "405 nm · VV+VH · water removed by open-water"
    assert [region["bit"] for region in scene["regions"]] == [1, 2, 4]
    assert scene["contours"] == [1.0, 3.0, 10.0]
    assert not any("_" in term for term in scene["terms"])
    assert scene["waters"][0] == {"name": "own", "label": "as in the survey"}


def test_settings_that_stay_are_none(sliders: Explorer) -> None:
    _, axes = sliders._instrument({"power": 0.02 * (1 + 0.9e-6), "dwell": 0.25}, "own")
    assert axes == {"dwell": 0.25}
    changed = {"power": 0.02 * (1 + 1.1e-6), "frequency": 78e6}
    _, axes = sliders._instrument(changed, "own")
    assert axes.pop("frequencies") == [[pytest.approx(78e6)]]
    assert axes == {"power": changed["power"]}
    for wrong in (math.nan, math.inf, "1"):
        with pytest.raises(SurveyError, match=r"^power must be a number, found"):
            sliders._instrument({"power": wrong}, "own")


def test_a_survey_is_written_with_the_settings(sliders: Explorer) -> None:
    settings = {"dwell": 0.03, "reflectance": 0.4, "frequency": 78e6, "power": 0.05,
                "radius": 0.01, "field_of_view": 0.1}  # fmt: skip
    made = Survey.from_text(sliders.as_survey(settings))
    assert made.scan.dwell == pytest.approx(0.03)
    # A sixth of the dwell.
    assert made.instrument.lock_in.time_constant == pytest.approx(0.005)
    assert [target.reflectance for target in made.targets] == [0.4]
    assert made.instrument.modulation_frequencies == pytest.approx((78e6,))
    assert made.instrument.power == pytest.approx(0.05)
    receiver = made.instrument.receiver
    assert (receiver.radius, receiver.acceptance) == pytest.approx((0.01, 0.1))
    longer = Survey.from_text(sliders.as_survey({"dwell": 0.5}))
    assert longer.instrument.lock_in.time_constant == pytest.approx(0.01)


def test_verdicts_are_those_of_places(plate: Survey, monkeypatch) -> None:
    values = {"total_error": [1e-3, 1.1e-3, 0.5e-3], "binding_term": [0, 1, 0]}
    values |= {name: [False, False, name == "ambiguous"]
               for name, _, _ in figures.REGIONS}  # fmt: skip
    errors = xr.Dataset({name: ("place", np.array(of)) for name, of in values.items()})
    monkeypatch.setattr(pages, "evaluate", lambda survey, **common: errors)
    asked = [Asked(distance=d, attenuation=0.123, accuracy=1e-3) for d in (1, 2, 3)]
    met, missed, doubtful = Explorer(plate, asked=asked).met({})
    first, second = (term.replace("_", " ") for term in pages.TERMS[:2])
    assert met == {"text": f"1 m, 0.12 1/m: 1 of 1 mm; binds: {first}", "met": True}
    assert missed == {"text": f"2 m, 0.12 1/m: 1.1 of 1 mm; binds: {second}",
                      "met": False}  # fmt: skip
    assert doubtful == {"text": "3 m, 0.12 1/m: 0.5 of 1 mm; ambiguous", "met": False}
    assert Explorer(plate).met({}) == []
