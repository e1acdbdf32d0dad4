"""Tables, sentences and bars of the accuracy of range images have the given numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose

from amulor.cube.schema import TERMS
from amulor.imaging import ErrorBudget
from amulor.imaging.budget import BudgetLine
from amulor.survey import Survey
from amulor.view import accuracy, image_report
from amulor.view.report import Heading, Interactive, Paragraph, Picture, Table
from amulor.view.style import COLOURS

BUDGET = ErrorBudget(
    lines=(
        BudgetLine(term=TERMS["counting"], uncertainty=3e-4, share=0.36, samples=None),
        BudgetLine(term=TERMS["delay"], uncertainty=4e-4, share=0.64, samples=12),
    ),
    combined=5e-4, common=4e-4, unknown=(TERMS["group_index"],), late_echo="",
    late=math.nan, calibrated="2026-05-01", age=3.0, error_unknown="",
)  # fmt: skip


@pytest.fixture
def image() -> xr.Dataset:
    """Return a wall of 5 x 20 pixels with uncertainties of 0.01 to 1 mm."""
    image = scenes.plane((0, 0, 1), 1.5, rows=5, columns=20).copy(deep=True)
    image["slant_range_uncertainty"].values[:] = 1e-5 * np.arange(1, 101).reshape(5, 20)
    image["slant_range"].values[:] = 1 + 0.01 * np.arange(100).reshape(5, 20)
    return image.assign_attrs(survey="", polarization="VH")


@pytest.fixture
def budgets(monkeypatch: pytest.MonkeyPatch) -> dict[str, ErrorBudget]:
    """Return the budget that every image is given; tests may replace it."""
    given = {"all": BUDGET}
    monkeypatch.setattr(accuracy, "error_budget", lambda image: given["all"])
    return given


def check(name: str, deviation: float, expanded: float, verdict: str,
          tolerance: float | None = None) -> Any:  # fmt: skip
    return SimpleNamespace(
        check=SimpleNamespace(name=name, expected=0.04, tolerance=tolerance),
        measured=SimpleNamespace(value=0.04 + deviation), deviation=deviation,
        expanded=expanded, verdict=verdict,
    )  # fmt: skip


CHECKS = [
    check("bar", 3e-4, 1e-3, "pass", 2e-3), check("step", -4e-4, math.nan, "undecided"),
]  # fmt: skip


def test_the_accuracy_of_a_scan_is_stated_in_numbers(image, budgets) -> None:
    heading, table, statement, checks, summary = accuracy.accuracy_statement(
        {"wall": image}, {"wall": CHECKS}
    )
    assert isinstance(heading, Heading)
    # 0.3 mm is left of 0.5 mm without the shared 0.4 mm; the 95th percentile of 0.01 to
    # 1 mm is 0.9505 mm, doubled.
    assert table.rows == [["wall", "0.3", "0.4", "0.5", "1", "1.9"]]
    rows = dict(statement.rows)
    assert rows["expanded uncertainty"] == "U = 1 mm (median)"
    # The 5th and the 95th percentile of 1 to 1.99 m.
    assert rows["conditions"].startswith("distances of 1.05 to 1.94 m (90 % of the")
    assert rows["traceability"].endswith(
        "delay calibrated on 2026-05-01, 3 days before the scan"
    )
    assert rows["verification"] == "1 of 2 known lengths confirm it"
    assert rows["not included"] == "group index, directions of the beams"
    assert checks.rows == [
        ["bar", "wall", "40.00", "40.30", "+0.30", "1.00", "2.00", "pass"],
        ["step", "wall", "40.00", "39.60", "-0.40", "!not known", "", "!undecided"],
    ]
    assert summary.text == (
        "1 of 2 check distances pass; root mean square of the deviations 0.35 mm."
    )


def test_what_is_not_known_of_an_accuracy_is_said(image, budgets) -> None:
    budgets["all"] = replace(BUDGET, common=math.nan, calibrated="")
    _, table, statement, none = accuracy.accuracy_statement({"wall": image}, {})
    assert table.rows[0][1:3] == ["not known", "not known"]
    rows = dict(statement.rows)
    assert rows["traceability"].endswith("no date of a delay calibration is stated")
    assert rows["verification"] == "no check distances"
    assert none.text == "No check distances were given."
    unknown = replace(BUDGET, combined=math.nan, error_unknown="the water is unknown")
    budgets["all"] = unknown
    _, said, none = accuracy.accuracy_statement({"wall": image}, {})
    assert said.text == "wall: the water is unknown."
    # A shared part above the whole leaves no noise.
    budgets["all"] = replace(BUDGET, common=6e-4)
    _, table, *_ = accuracy.accuracy_statement({"wall": image}, {})
    assert table.rows[0][1] == "0"


def test_conditions_name_the_light_and_the_error_of_the_group_index(
    image, budgets, plate_text
) -> None:
    text = plate_text + "[calibration]\ngroup_index_uncertainty = 0.00123\n"
    simulated = image.assign_attrs(survey=text, simulated=1)
    _, _, statement, _ = accuracy.accuracy_statement({"wall": simulated}, {})
    rows = dict(statement.rows)
    assert rows["conditions"].endswith("; 405 nm, modulated at 39 MHz; simulated data")
    assert "± 0.0012 (k = 1) of the water" in rows["traceability"]


def test_bars_of_a_budget_have_the_size_of_their_terms(budgets) -> None:
    other = replace(BUDGET, unknown=(), lines=BUDGET.lines[:1])
    figure = accuracy.budget_figure({"one": BUDGET, "two": other})
    assert_allclose(figure.get_size_inches(), [12.8, 0.5 + 0.24 * 4])
    axis, second = figure.axes
    assert [a.get_title("left") or a.get_title() for a in figure.axes] == ["one", "two"]
    bars = axis.patches
    assert [bar.get_width() for bar in bars] == pytest.approx([0.3, 0.4, 0.5, 0.5])
    middles = [bar.get_y() + bar.get_height() / 2 for bar in bars]
    assert middles == pytest.approx([0, 1, 2, 3])
    assert {round(bar.get_height(), 9) for bar in bars} == {0.7}
    colors = [to_hex(bar.get_facecolor()) for bar in (bars[0], bars[1], bars[3])]
    assert colors == [COLOURS[n].lower() for n in (5, 0, 6)]
    assert bars[2].get_hatch() == "////"
    assert [(t.get_text(), *t.get_position()) for t in axis.texts] == [
        (" 0.3", pytest.approx(0.3), 0), (" 0.4", pytest.approx(0.4), 1),
        ("  not known", 0, 2), (" 0.5", pytest.approx(0.5), 3),
    ]  # fmt: skip
    names = [text.get_text() for text in axis.get_yticklabels()]
    assert names == ["counting", "delay", "group index", "combined"]
    assert axis.yaxis_inverted()
    assert axis.get_xlim() == pytest.approx((0, 0.56))
    assert axis.get_xlabel() == "standard uncertainty [mm]"
    assert [bar.get_width() for bar in second.patches] == pytest.approx([0.3, 0.5])


def test_a_budget_is_a_picture_a_table_and_sentences(image, budgets) -> None:
    heading, picture, table, text = accuracy.error_budgets({"wall": image})
    assert heading.text == "Where the uncertainty comes from"
    assert picture.caption == (
        "Standard uncertainty of each term, median over the usable pixels. Dark terms "
        "are shared by pixels; a mean does not reduce them. Hatched terms are unknown "
        "and not in the combined uncertainty."
    )
    meanings = [TERMS[name].meaning for name in ("counting", "delay", "group_index")]
    kinds = [TERMS[name].kind for name in ("counting", "delay", "group_index")]
    assert table.rows == [
        ["counting", meanings[0], kinds[0], "", "0.3", "36.0%"],
        ["delay", meanings[1], kinds[1], "12 shots", "0.4", "64.0%"],
        ["group index", meanings[2], kinds[2], "", "!not known", ""],
        ["combined", "all known terms", "", "", "0.5", ""],
        ["expanded, k = 2", "contains about 95 of 100 errors", "", "", "1", ""],
    ]
    assert text.text == (
        "All pixels share 0.4 mm of it; a mean over pixels does not reduce this part. "
        "The delay was calibrated on 2026-05-01, 3 days before the scan. Not included, "
        "since their size is unknown: group index. State them in the section "
        "[calibration] of the survey."
    )
    for other in (replace(BUDGET, lines=()), replace(BUDGET, combined=math.nan)):
        budgets["all"] = other
        assert accuracy.error_budgets({"wall": image}) == []


def test_late_light_and_tests_of_the_instrument_are_told() -> None:
    test: Any = SimpleNamespace(result="it drifts", cause="heat", measurement="wait")
    late = replace(BUDGET, late=2e-3, common=math.nan, calibrated="", unknown=(),
                   tests=(test,))  # fmt: skip
    assert accuracy._limits(late) == (
        "Scattered light makes the echoes 2 mm late. It is subtracted. Instrument: it "
        "drifts. Probable cause: heat. To do: wait."
    )
    reason = replace(late, late=math.nan, late_echo="no pulse", tests=())
    assert accuracy._limits(reason) == "Late light: no pulse."
    assert accuracy._limits(replace(reason, late_echo="")) == ""


def test_the_instrument_and_the_water_are_listed(
    plate: Survey, plate_text: str
) -> None:
    rows = dict(accuracy._instrument_rows(plate))
    assert rows == {
        "wavelength": "405 nm", "power": "20 mW", "modulation frequencies": "39 MHz",
        "modulation depth": "80%", "polarizations": "VV, VH",
        "receiver at (right, down, forward)": "70, 0, 0 mm", "receiver radius": "20 mm",
        "acceptance (1/e half-width)": "4.58°", "time constant of the lock-in": "10 ms",
        "phase floor": "0.06°", "scan": "12 x 6 pixels, 125 ms each",
        "field of the scan": "3.81° x 1.53°",
    }  # fmt: skip
    dated = Survey.from_text(
        plate_text + '[calibration]\ndate = 2026-05-01\ndelay_uncertainty = "0.1 ns"\n'
    )
    assert accuracy._instrument_rows(dated)[-1] == ["delay calibrated on", "2026-05-01"]
    assert accuracy._water_rows(plate) == [
        ["absorption", "0.255 1/m"], ["scattering", "0.595 1/m"],
        ["attenuation", "0.85 1/m"], ["group index, which makes the meters", "1.38"],
        ["refractive index", "1.34"],
    ]  # fmt: skip


def test_images_of_one_survey_have_one_table(image, plate_text) -> None:
    other = plate_text.replace("20 mW", "30 mW")
    texts = {"a": plate_text, "b": other, "c": plate_text}
    of = {name: image.assign_attrs(survey=text) for name, text in texts.items()}
    heading, *tables = accuracy.instrument_and_water(of)
    assert heading.text == "Instrument and water"
    assert [table.caption for table in tables] == [
        "The instrument of a, c.", "The water of a, c.", "The instrument of b.",
        "The water of b.",
    ]  # fmt: skip
    assert [dict(table.rows)["power"] for table in tables[::2]] == ["20 mW", "30 mW"]
    single = accuracy.instrument_and_water({"a": of["a"]})
    assert [part.caption for part in single[1:]] == ["The instrument.", "The water."]
    assert accuracy.instrument_and_water({"x": image}) == []


def test_a_pose_is_registered_with_its_frame(image, plate_text) -> None:
    pose = (
        '[pose]\nheading = "30 deg"\npitch = "-5 deg"\nroll = "2 deg"\n'
        'position = ["1 m", "2 m", "-9 m"]\n'
    )
    placed = image.assign_attrs(survey=plate_text + pose)
    known = image.assign_attrs(
        survey=plate_text + pose + 'crs = "EPSG:32632"\nposition_uncertainty = "2 cm"\n'
    )
    heading, table = accuracy.registration({"a": placed, "b": known, "c": image})
    assert heading.text == "Registration"
    first, second, third = table.rows
    assert first[:5] == ["a", "local frame", "1, 2, -9", "30, -5, 2", "not known"]
    assert first[5].startswith("!not known: ")
    assert second[1:5] == ["EPSG:32632", "1, 2, -9", "30, -5, 2", "20 mm"]
    assert third == ["c", "the instrument's own axes", "", "", "", ""]


def test_a_table_of_images_has_medians_over_usable_pixels(image) -> None:
    image["slant_range"].values[0, :10] = np.nan
    bias = image.assign(slant_range_bias=image["slant_range"] * 0 + 2e-3)
    whole: Any = SimpleNamespace(usable=30, rows=10, columns=12, step=2)
    table = image_report._numbers({"a": image, "b": bias}, {"b": whole})
    assert table.rows == [
        ["a", "VH", "90.0%", "1.5450", "0.51", "unknown"],
        ["b", "VH", "25.0%", "1.5450", "0.51", "+2.00"],
    ]
    nothing = image.copy(deep=True)
    nothing["slant_range"].values[:] = np.nan
    nothing["slant_range_uncertainty"].values[:] = np.nan
    (row,) = image_report._numbers({"n": nothing}, {}).rows
    assert row[2:5] == ["0.0%", "none", "none"]
    assert image_report._median(np.array([np.nan, 3.0, 1.0]), ".1f") == "2.0"


def test_the_first_sentence_states_share_and_uncertainty(image, monkeypatch) -> None:
    monkeypatch.setattr(image_report, "error_budget", lambda image: BUDGET)
    image["slant_range"].values[0, :10] = np.nan
    assert image_report._result("wall", image, None) == (
        "wall: 90.0% of the pixels have a range, and the expanded uncertainty of a "
        "range is U = 1 mm (median, k = 2)."
    )
    whole: Any = SimpleNamespace(usable=30, rows=10, columns=12, step=2)
    unknown = replace(BUDGET, combined=math.nan)
    monkeypatch.setattr(image_report, "error_budget", lambda image: unknown)
    assert image_report._result("wall", image, whole) == (
        "wall: 25.0% of the pixels have a range, and the expanded uncertainty of a "
        "range is not known."
    )
    assert image_report._thinning("wall", whole).startswith(
        "wall has 12 x 10 pixels: one row and column of every 2 is drawn"
    )


@pytest.mark.parametrize(
    ("simulated", "words"),
    [((0, 0), "Measured data."), ((1, 1), "Simulated data; nothing here was measured."),
     ((0, 1), "Measured data, but for b, which are simulated.")],
)  # fmt: skip
def test_simulated_data_are_named(image, simulated, words) -> None:
    images = {name: image.assign_attrs(simulated=value)
              for name, value in zip("ab", simulated, strict=True)}  # fmt: skip
    assert image_report._origin(images) == words


def test_a_surface_needs_two_rows_two_columns_and_four_ranges(image) -> None:
    assert image_report._is_surface(image)
    assert not image_report._is_surface(image.isel(row=[0]))
    assert not image_report._is_surface(image.isel(column=[0]))
    values = image["slant_range"].values
    values[:] = np.nan
    values[0, :3] = 1.0
    assert not image_report._is_surface(image)
    values[1, 0] = 1.0
    assert image_report._is_surface(image)


def test_flags_are_counted_in_a_sentence(image) -> None:
    flags = image["quality_flag"].values
    flags[:] = 0
    assert image_report.flag_sentence(image) == (
        "Gray pixels hold no range. Flags, of 100 pixels: none."
    )
    whole: Any = SimpleNamespace(
        rows=3, columns=4, flags={"no_target": 2, "mixed": 1}, step=1, usable=1
    )
    assert image_report.flag_sentence(image, whole) == (
        "Gray pixels hold no range. Flags, of 12 pixels: 2 no target; 1 mixed. What "
        "they mean: amulor explain NO_TARGET."
    )


@pytest.mark.parametrize(("limit", "kind"), [(99, Paragraph), (100, Interactive)])
def test_a_large_image_is_no_interactive_page(image, monkeypatch, limit, kind) -> None:
    monkeypatch.setattr(image_report, "_LARGEST_IN_REPORT", limit)
    (part,) = image_report.interactive({"wall": image})
    assert isinstance(part, kind)


def test_paths_are_reduced_to_names() -> None:
    text = "read '/home/me/a.nc', \"C:\\me\\b.nc\", '\\\\srv\\x\\c.nc', 'd.nc', 1/2"
    assert image_report._without_folders(text) == (
        "read 'a.nc', \"b.nc\", 'c.nc', 'd.nc', 1/2"
    )


def test_a_report_of_images_has_its_parts_in_order(image, monkeypatch) -> None:
    taken: dict[str, Any] = {}
    monkeypatch.setattr(
        image_report, "write_report",
        lambda path, title, parts, *, overwrite: taken.update(
            title=title, parts=parts, overwrite=overwrite),
    )  # fmt: skip
    monkeypatch.setattr(image_report, "interactive", lambda images: [])
    line = image.isel(row=[0])
    given = {"wall": image.assign_attrs(title="Tank", survey="name = 1"), "line": line}
    whole: Any = SimpleNamespace(usable=30, rows=10, columns=12, step=2, flags={},
                                 checks=())  # fmt: skip
    image_report.write("r.html", given, wholes={"line": whole})
    assert (taken["title"], taken["overwrite"]) == ("Tank", False)
    kinds = [type(part).__name__ for part in taken["parts"]]
    assert kinds[:5] == ["Paragraph", "Picture", "Table", "Paragraph", "Heading"]
    headings = [p for p in taken["parts"] if isinstance(p, Heading)]
    assert [part.text for part in headings][-4:] == [
        "line",
        "Line profiles",
        "In space",
        "Annex: origin of the data",
    ]
    assert headings[-1].new_page
    assert [p.title for p in taken["parts"] if hasattr(p, "title")] == [
        "history of wall", "survey of wall", "history of line",
    ]  # fmt: skip
    profiles = next(p for p in taken["parts"][-8:] if isinstance(p, Picture))
    assert len(profiles.figure.axes) == 1
    image_report.write("r.html", {"line": line.assign_attrs(title="")}, overwrite=True)
    assert (taken["title"], taken["overwrite"]) == ("Range images", True)
    assert "Line profiles" not in [getattr(p, "text", "") for p in taken["parts"]]
    assert any(isinstance(part, Table) for part in taken["parts"])
