"""Docstrings of public names: what numpydoc can judge, and an example for each."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from typing import Any, get_origin

import pytest

LISTING = Path(__file__).parents[1] / "reference" / "public_surface.txt"
#: Public objects without an example, and why.
WITHOUT_EXAMPLE = {
    **{
        f"amulor.imaging.{name}": f"{maker}'s example makes one"
        for name, maker in {
            "measure.Checked": "compared",
            "measure.Fit": "plane",
            "measure.Measurement": "distance",
            "measure.Points": "points_of",
            "measure.Revolution": "revolution",
            "products.Contour": "contours",
            "products.Deviation": "deviation",
            "products.Plane": "plane_of",
            "products.Raster": "raster",
            "products.Section": "section",
            "products.Surface": "surface",
        }.items()
    },
    **{
        f"amulor.imaging.measure.{name}": "plane's example, with another shape"
        for name in ("circle", "sphere")
    },
    "amulor.rejection.ChannelChoice": "choose_channel's example makes one",
    "amulor.rejection.FrequencyChoice": "choose_frequency's example makes one",
    "amulor.rejection.WaterFit": "water_fit's example makes one",
    "amulor.rejection.combined": "takes seconds; the gallery's rejection of each kind",
    "amulor.rejection.compare": "takes seconds; docs/how-to/reject.md has its table",
    "amulor.rejection.joint": "takes seconds; the gallery's rejection of each kind",
    "amulor.view.figures.write_response_curves": "writes that of response_curves",
    "amulor.view.image_report.write": "draws for a second; amulor report",
    "amulor.simulation.SceneLight": "scene_light's example makes one",
    "amulor.rejection.split_scattering": "water_fit's example goes on with it",
}
#: What is held: https://numpydoc.readthedocs.io/en/latest/validation.html. Unknown or
#: missing parameters, their order, types and descriptions; returned types; a docstring.
CODES = {"GL08", "PR01", "PR02", "PR03", "PR04", "PR07", "PR08", "RT02", "RT04", "SS02"}


def _listed() -> dict[str, str]:
    return dict(line.split()[:2] for line in LISTING.read_text().splitlines())


def _loaded(name: str) -> Any:
    module, _, last = name.rpartition(".")
    one = getattr(importlib.import_module(module), last)
    # A module that was imported by its path hides the function of the same name.
    return getattr(one, last) if inspect.ismodule(one) else one


def _joined(text: str) -> str:
    """Return a docstring as the site shows it: without continued lines."""
    return re.sub(r"\\\n\s*", "", text)


def _objects() -> dict[str, Any]:
    kinds = ("class", "function", "error")
    found = {name: _loaded(name) for name, kind in _listed().items() if kind in kinds}
    # Names of types, such as `imaging.Axes`, have no docstring of their own.
    return {name: one for name, one in found.items() if get_origin(one) is None}


def test_every_public_object_has_an_example() -> None:
    without = {
        name
        for name, one in _objects().items()
        if ">>> " not in (inspect.getdoc(one) or "")
    }
    assert without == set(WITHOUT_EXAMPLE)


def test_first_lines_hold_no_substitution_of_docutils() -> None:
    """The site reads bars, as of |s|, as a name that it shall replace."""
    first = {
        name: re.sub(
            r"``?.*?``?|:math:", "", (inspect.getdoc(one) or "").partition("\n")[0]
        )
        for name, one in _objects().items()
    }
    assert not [name for name, line in first.items() if line.count("|") > 1]


@pytest.mark.slow
def test_numpydoc_finds_no_fault_in_public_docstrings() -> None:
    validate = pytest.importorskip("numpydoc.validate")
    docscrape = pytest.importorskip("numpydoc.docscrape")

    class Shown(validate.Validator):  # type: ignore[misc, name-defined]
        """What a docstring is on the site."""

        def __init__(self, one: Any) -> None:
            text = _joined(inspect.getdoc(one) or "")
            super().__init__(docscrape.get_doc_object(one, doc=text))
            self.raw_doc = f"\n{text}\n"
            self.clean_doc = text

    faults = []
    for name, one in _objects().items():
        found = validate.validate(one, validator_cls=lambda obj_name: Shown(obj_name))
        faults += [
            f"{name}: {code} {text}"
            for code, text in found["errors"]
            if code in CODES and not (code == "PR01" and inspect.isclass(one))
        ]
    assert not faults, "\n".join(faults)
