"""The theory pages: their examples run, and print what the text says."""

from __future__ import annotations

import importlib
import re
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scripts import script

# The page on the water signal compares the closure where it does not hold, too.
pytestmark = pytest.mark.filterwarnings("ignore::amulor.errors.AmulorWarning")

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "theory").glob("*.md"))
TEXTS = {page.stem: page.read_text("utf-8") for page in PAGES}
WITH_EXAMPLES = [name for name, text in TEXTS.items() if "```python" in text]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
LONG = ("photon-transport", "joint-estimation", "water-signal")
MATH = re.compile(r"^\$\$\n(.*?)^\$\$$|\$([^$\n]+)\$", flags=re.DOTALL | re.MULTILINE)


def _script(name: str) -> ModuleType:
    """Return a script out of docs."""
    return script(f"docs/{name}.py")


outputs = _script("make_theory_outputs")


def _marked(name: str) -> object:
    """Return the name of a page, marked where its examples take long."""
    marks = [pytest.mark.slow] if name in LONG else []
    if name == "photon-transport":  # half a minute; all its numbers are photons
        marks = [pytest.mark.slow, pytest.mark.study]
    return pytest.param(name, marks=marks)


@cache
def _ran(name: str) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Return what came of a page, run once, its examples one after the other."""
    return outputs.run(TEXTS[name], name=name)


@pytest.mark.parametrize("name", [_marked(name) for name in WITH_EXAMPLES])
def test_examples_print_what_the_page_shows(name: str) -> None:
    found = _ran(name)[1]
    assert found
    for shown, printed in found:
        assert printed == shown


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_every_output_on_a_page_stands_right_below_its_example(name: str) -> None:
    languages = [language for language, _ in FENCE.findall(TEXTS[name])]
    assert set(languages) == {"python", "text"}
    examples = outputs.EXAMPLE.findall(TEXTS[name])
    assert len(examples) == languages.count("python")
    assert sum(bool(shown) for _, shown in examples) == languages.count("text")


def test_outputs_are_written_below_their_examples_and_nothing_else_changes() -> None:
    page = (
        "# Page\n\n```python\nx = 2\n```\n\nText.\n\n```python\nprint(x)\n```\n\n"
        "```text\n3\n```\n\n```python\nprint(x + 2)\n```\nEnd.\n"
    )
    made = outputs.rewritten(page, name="page")
    assert made == page.replace("3\n", "2\n").replace(
        "```\nEnd", "```\n\n```text\n4\n```\nEnd"
    )
    assert outputs.rewritten(made, name="page") == made


def _prose(text: str) -> str:
    """Return what is left of a page without code, formulas and references."""
    text = text.partition("## References")[0]
    for pattern in (FENCE, MATH, re.compile(r"`[^`]*`")):
        text = pattern.sub(" ", text)
    text = re.sub(r"\]\([^)]*\)", "]", text)  # where links lead
    text = re.sub(r"^#.*$", " ", text, flags=re.MULTILINE)
    text = re.sub(r"\(\d+\)|\[\d\]", " ", text)  # numbers of equations, references
    return re.sub(r"1/m|NUC 2040|section\s+8", " ", text)


def _numbers(text: str) -> set[float]:
    return {float(number) for number in re.findall(r"(?<![\w.])\d+(?:\.\d+)?", text)}


# Facts of definition that no example needs to print: right angles, one and two.
DEFINITIONS = {0.0, 1.0, 2.0, 90.0, 180.0}


def _shown(text: str) -> set[float]:
    """Return the numbers in the examples of a page, and what they may be told as."""
    blocks = " ".join(body for _, body in FENCE.findall(text))
    shown = _numbers(re.sub(r"[-+=(,]", " ", blocks)) | DEFINITIONS
    # A ratio of 1.62 may be told as 62 %, and 20e-3 rad as 20 mrad.
    shown |= {round(100 * (value - 1), 6) for value in shown if 1 < value < 2}
    return shown | {
        float(number) for number in re.findall(r"(\d+(?:\.\d+)?)e-?\d", blocks)
    }


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_numbers_in_the_text_stand_in_an_example_beside_it(name: str) -> None:
    assert _numbers(_prose(TEXTS[name])) - _shown(TEXTS[name]) == set()


def test_the_decision_on_the_split_angle_quotes_the_page() -> None:
    text = (ROOT / "docs" / "decisions" / "0007-split-angle.md").read_text("utf-8")
    text = re.sub(r"^Date: .*$", "", text, flags=re.MULTILINE)
    assert _numbers(_prose(text)) - _shown(TEXTS["water-signal"]) == set()


def test_the_pages_walk_through_all_seventy_two_equations() -> None:
    tags = [
        int(tag)
        for text in TEXTS.values()
        for tag in re.findall(r"\\tag\{(\d+)\}", text)
    ]
    assert sorted(tags) == list(range(1, 73))


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_named_functions_exist(name: str) -> None:
    named = set(re.findall(r"`(amulor\.optics\.[\w.]+)`", TEXTS[name]))
    assert named
    for dotted in named:
        try:
            importlib.import_module(dotted)
        except ModuleNotFoundError:
            module, _, function = dotted.rpartition(".")
            assert callable(getattr(importlib.import_module(module), function)), dotted


@pytest.mark.parametrize("name", TEXTS)
def test_markdown_leaves_the_formulas_alone(name: str) -> None:
    text = FENCE.sub(" ", TEXTS[name])
    assert "$" not in MATH.sub(" ", text)
    for formula in ("".join(groups) for groups in MATH.findall(text)):
        # Markdown takes \, \; \{ and the like for escapes, and < for a tag.
        assert not re.search(r"\\[^A-Za-z]", formula), formula
        assert "<" not in formula, formula
        assert "operatorname" not in formula, formula  # refused by GitHub
        assert formula.count("{") == formula.count("}"), formula


def _anchors(text: str) -> set[str]:
    """Return the anchors that GitHub makes of headings."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub(" ", text), flags=re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in headings
    }


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_to_sections(name: str) -> None:
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)#([^)]*)\)", TEXTS[name]):
        page = TEXTS[name] if not target else (PAGES[0].parent / target).read_text()
        assert anchor in _anchors(page), anchor


def test_the_pictures_on_the_pages_are_those_that_are_drawn() -> None:
    shown = {
        image
        for text in TEXTS.values()
        for image in re.findall(r"images/(theory-[\w-]+)\.png", text)
    }
    drawn = set(_script("make_theory_images").FIGURES)
    stored = {path.stem for path in (ROOT / "docs" / "images").glob("theory-*")}
    assert shown == drawn == stored


@pytest.mark.slow
def test_the_figure_of_ratios_shows_the_numbers_of_the_table() -> None:
    matplotlib.use("agg")
    found = _ran("water-signal")[0]["found"]
    figure = _script("make_theory_images").model_ratio(np.array([0.5]))
    for column, water in enumerate(("HG", "harbour")):
        for axis, ratio in (
            (figure.axes[column], lambda row: row["still"]),
            (
                figure.axes[2 + column],
                lambda row: row["diffusion"] / row["small_angle"],
            ),
        ):
            lines = {line.get_label(): line.get_ydata() for line in axis.get_lines()}
            for split in (90, 10):
                for baseline in (0.07, 0.20):
                    drawn = lines[f"split {split}°, baseline {baseline:.2f} m"]
                    expected = ratio(found[water, baseline, split, 0.5])
                    # One calculation, done twice: only rounding may differ.
                    assert_allclose(drawn, [expected], rtol=1e-9)


@pytest.fixture(scope="module")
def models() -> tuple[ModuleType, dict[Any, Any], dict[str, Any]]:
    script = _script("make_model_images")
    return script, script.kept(), script.compared()


@pytest.mark.slow
def test_the_tables_of_the_models_are_those_of_the_kept_photons(models) -> None:
    script, photons, found = models
    assert script.summary(photons, found) in TEXTS["models"]
    assert script.table(photons, found) in TEXTS["models-details"]


@pytest.mark.slow
def test_the_default_is_within_five_percent_of_photons_but_where_the_page_says(
    models,
) -> None:
    script, photons, found = models
    default = found["small-angle (29)"]
    for (water, attenuation), true in photons.items():
        # Behind four attenuation lengths the page names the exception.
        most = 0.05 if attenuation <= 1 else 0.12
        for quantity in script.QUANTITIES:
            error = abs(true[f"{quantity}_error"] / true[quantity])
            ratio = default[water, attenuation][quantity] / true[quantity]
            assert abs(ratio - 1) < most + 2 * error, (water, attenuation, quantity)
            # Photons that know nothing would confirm everything.
            assert error < (0.02 if attenuation <= 1 else 0.045)


@pytest.mark.slow
def test_the_closure_is_nearer_to_photons_than_the_papers_form(models) -> None:
    script, photons, found = models
    for key, true in photons.items():
        for quantity in script.QUANTITIES:
            close, paper = (
                abs(np.log(found[model][key][quantity] / true[quantity]))
                for model in ("closure", "diffusion, 90°")
            )
            assert close < max(
                paper, 2 * abs(true[f"{quantity}_error"] / true[quantity])
            )


@pytest.mark.slow
def test_the_figure_of_the_models_shows_the_numbers_of_the_table(models) -> None:
    matplotlib.use("agg")
    script, photons, found = models
    figure = script.drawn(photons, found)
    waters = list(script.waters())
    for place, axis in enumerate(figure.axes):
        quantity = list(script.QUANTITIES)[place // len(waters)]
        water = waters[place % len(waters)]
        lines = {line.get_label(): line.get_ydata() for line in axis.get_lines()}
        for model, values in found.items():
            expected = [
                values[water, k][quantity] / photons[water, k][quantity]
                for k in script.ATTENUATIONS
            ]
            assert_allclose(lines[model], expected, rtol=1e-9)
