"""Writes docs/reference from the code: fields of surveys, variables of cubes."""

from __future__ import annotations

import typing
from pathlib import Path

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from amulor import survey
from amulor.cube import schema

FOLDER = Path(__file__).parent / "reference"
TABLES = {
    "(top)": survey.Survey,
    "[water]": survey.Water,
    '[[targets]], kind = "plate"': survey.Plate,
    '[[targets]], kind = "staircase"': survey.Staircase,
    '[[targets]], kind = "disc"': survey.Disc,
    '[[targets]], kind = "mesh"': survey.Mesh,
    "[instrument]": survey.Instrument,
    "[instrument.emitter]": survey.Emitter,
    "[instrument.receiver]": survey.Receiver,
    "[instrument.detector]": survey.Detector,
    "[instrument.lock_in]": survey.LockIn,
    "[instrument.window]": survey.Window,
    "[scan]": survey.Scan,
    "[scan.open_water]": survey.OpenWater,
    "[calibration]": survey.Calibration,
}


def survey_page() -> str:
    """Return the page on survey files."""
    parts = [
        "# The survey file",
        "",
        "One TOML file says what is known before anything is measured. Quantities are",
        'texts with a unit ("39 MHz", "20 cm"); shares may be plain numbers. Unknown',
        "fields are refused. `amulor survey check FILE` checks one; a JSON Schema for",
        "editors comes from `amulor survey schema`. Axes: right, down, forward, seen",
        "from the instrument. Made from the code by `docs/make_reference.py`.",
        "",
    ]
    for title, model in TABLES.items():
        parts += [f"## {title}", "", _first_line(model), ""]
        parts += ["| field | needed | default | meaning |", "| --- | --- | --- | --- |"]
        for name, field in model.model_fields.items():
            default = (
                ""
                if field.is_required()
                else _default(field.get_default(call_default_factory=True))
            )
            meaning = " ".join((field.description or "").split())
            needed = "yes" if field.is_required() else ""
            parts.append(f"| `{name}` | {needed} | {default} | {meaning} |")
        parts.append("")
    return "\n".join(parts)


def cube_page() -> str:
    """Return the page on measurement cubes."""
    parts = [
        "# The measurement cube",
        "",
        "An `xarray.Dataset`, in a file CF netCDF. The attribute `level` says how far",
        "it has come. Made from the code by `docs/make_reference.py`.",
        "",
    ]
    for level in schema.LEVELS.values():
        parts += [f"## {level.name}", ""]
        parts += _variables({**level.variables, **level.coordinates})
    parts += ["## Group `open_water`", ""]
    parts += _variables(schema.OPEN_WATER_VARIABLES)
    parts += ["## Flags", "", "| bit | name |", "| --- | --- |"]
    flags = schema.flag_attributes()
    for mask, name in zip(
        flags["flag_masks"], flags["flag_meanings"].split(), strict=True
    ):
        parts.append(f"| {mask} | `{name}` |")
    parts += ["", "## Attributes of `geometry`", ""]
    parts += ["| attribute | meaning |", "| --- | --- |"]
    for name, meaning in {
        **schema.GEOMETRY_ATTRIBUTES,
        **schema.WINDOW_ATTRIBUTES,
    }.items():
        parts.append(f"| `{name}` | {meaning} |")
    return "\n".join([*parts, ""])


def _variables(specs: dict[str, schema.Variable]) -> list[str]:
    rows = ["| name | over | unit | what | needed |", "| --- | --- | --- | --- | --- |"]
    for name, spec in specs.items():
        over = ", ".join(spec.dimensions)
        needed = "yes" if spec.required else ""
        rows.append(
            f"| `{name}` | {over} | {spec.units} | {spec.long_name} | {needed} |"
        )
    return [*rows, ""]


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").strip().splitlines()[0]


def _default(value: object) -> str:
    if value is PydanticUndefined or value is None:
        return ""
    if isinstance(value, BaseModel):
        return "see below"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        return ", ".join(_default(item) for item in value)
    return str(value)


PAGES: dict[str, typing.Callable[[], str]] = {
    "survey-file.md": survey_page,
    "cube.md": cube_page,
}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, page in PAGES.items():
        (FOLDER / name).write_text(page(), encoding="utf-8")
