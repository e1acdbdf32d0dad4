"""Writes docs/reference from the code: surveys, cubes, flags, sample data."""

from __future__ import annotations

import math
import re
import typing
from pathlib import Path

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from amulor import samples, survey
from amulor.cube import schema
from amulor.design.evaluate import WATERS, reach
from amulor.survey import instrument_errors, presets
from amulor.survey.water import WaterState
from amulor.view import explanations

FOLDER = Path(__file__).parent / "reference"
EXAMPLES = FOLDER / "examples"

#: Title of a table, what it stands for, and the example that follows it.
TABLES: list[tuple[str, type[BaseModel], str | None]] = [
    ("(top)", survey.Survey, "survey"),
    ("[water]", survey.Water, "water-coefficients"),
    ("[water], by moments", survey.Water, "water-moments"),
    ('[water], kind = "jerlov"', survey.JerlovWater, "water-jerlov"),
    ('[water], kind = "petzold"', survey.PetzoldWater, "water-petzold"),
    ('[water], kind = "pure"', survey.PureWater, "water-pure"),
    ('[water], kind = "case-1"', survey.Case1Water, "water-case-1"),
    ('[water], kind = "milk"', survey.MilkWater, "water-milk"),
    ('[water], kind = "milk", measured', survey.MilkWater, "water-milk-measured"),
    ('[water], kind = "spheres"', survey.SphereWater, "water-spheres"),
    ('[water], kind = "layers"', survey.LayeredWater, "water-layers"),
    ("[[water.layers]]", survey.WaterLayer, None),
    (
        'phase_function, kind = "henyey-greenstein"',
        survey.HenyeyGreenstein,
        "phase-henyey-greenstein",
    ),
    ('phase_function, kind = "two-term"', survey.TwoTerm, "phase-two-term"),
    (
        'phase_function, kind = "fournier-forand"',
        survey.FournierForand,
        "phase-fournier-forand",
    ),
    ('phase_function, kind = "petzold"', survey.Petzold, "phase-petzold"),
    ('phase_function, kind = "rayleigh"', survey.Rayleigh, "phase-rayleigh"),
    ('phase_function, kind = "tabulated"', survey.Tabulated, "phase-tabulated"),
    ('[[targets]], kind = "plate"', survey.Plate, "target-plate"),
    ('[[targets]], kind = "staircase"', survey.Staircase, "target-staircase"),
    ('[[targets]], kind = "disc"', survey.Disc, "target-disc"),
    ('[[targets]], kind = "mesh"', survey.Mesh, "target-mesh"),
    ('surface, kind = "lambertian"', survey.Lambertian, "surface-lambertian"),
    ('surface, kind = "oren-nayar"', survey.OrenNayar, "surface-oren-nayar"),
    ('surface, kind = "glossy"', survey.Glossy, "surface-glossy"),
    ('surface, kind = "tabulated"', survey.TabulatedSurface, "surface-tabulated"),
    ("[instrument]", survey.Instrument, None),
    ("[instrument.emitter]", survey.Emitter, "emitter"),
    ("[instrument.receiver]", survey.Receiver, "receiver"),
    ("[instrument.detector]", survey.Detector, None),
    ("[instrument.lock_in]", survey.LockIn, None),
    ("[instrument.window]", survey.Window, "window"),
    ("[instrument.errors]", survey.InstrumentErrors, "instrument-errors"),
    *(
        (f"[instrument.errors.{name}]", getattr(instrument_errors, model), None)
        for name, model in {
            "pointing": "Pointing",
            "clock": "Clock",
            "plume": "Plume",
            "gradient": "Gradient",
            "bubbles": "Bubbles",
            "drift": "Drift",
            "optical_leakage": "OpticalLeakage",
            "counting": "Counting",
            "harmonic": "Harmonic",
            "compression": "Compression",
            "walk": "Walk",
            "reflection": "Reflection",
            "crosstalk": "Crosstalk",
            "temperature": "TemperatureError",
            "scale_change": "ScaleChange",
            "demodulator": "Demodulator",
            "noise": "OutputNoise",
        }.items()
    ),
    ("[daylight]", survey.Daylight, "daylight"),
    ("[scan]", survey.Scan, None),
    ("[scan.open_water]", survey.OpenWater, None),
    ("[scan.reference]", survey.StandingReference, None),
    ("[calibration]", survey.Calibration, None),
    ("[pose]", survey.Pose, "pose"),
    ("[platform]", survey.Platform, "platform"),
    ('[platform.course], kind = "line"', survey.LineCourse, "course_line"),
    ('[platform.course], kind = "lawn-mower"', survey.LawnMowerCourse, None),
    ('[platform.course], kind = "orbit"', survey.OrbitCourse, "course_orbit"),
    ('[platform.course], kind = "hover"', survey.HoverCourse, "course_hover"),
    ("[platform.disturbance]", survey.Disturbance, None),
    ("[platform.navigation]", survey.Navigation, None),
    ("[platform.mounting]", survey.Mounting, None),
]


def survey_page() -> str:
    """Return the page on survey files."""
    parts = [(EXAMPLES / "introduction.txt").read_text(encoding="utf-8")]
    shown: set[type[BaseModel]] = set()
    for title, model, example in TABLES:
        parts += [f"## {title}", ""]
        if model not in shown:
            parts += [_first_line(model), "", *_fields(model), ""]
        shown.add(model)
        if example is not None:
            text = (EXAMPLES / f"{example}.toml").read_text(encoding="utf-8")
            parts += ["```toml", text.rstrip("\n"), "```", ""]
    return "\n".join(parts)


def _fields(model: type[BaseModel]) -> list[str]:
    """Return the rows on the fields of a table; of waters, on what is their own."""
    rows = ["| field | needed | default | meaning |", "| --- | --- | --- | --- |"]
    fields = model.model_fields
    common = WaterState.model_fields if issubclass(model, WaterState) else {}
    whole = model in (survey.Water, WaterState)
    for name in sorted(fields, key=lambda name: name in common):
        field = fields[name]
        if name in common and not whole and field.default == common[name].default:
            continue
        default = (
            ""
            if field.is_required()
            else _default(field.get_default(call_default_factory=True))
        )
        meaning = " ".join((field.description or "").split())
        needed = "yes" if field.is_required() else ""
        rows.append(f"| `{name}` | {needed} | {default} | {meaning} |")
    if issubclass(model, WaterState) and not whole:
        rows += [
            "",
            "Further fields, common to all kinds of water: "
            + ", ".join(f"`{n}`" for n in common)
            + ".",
        ]
    return rows


def cube_page() -> str:
    """Return the page on measurement cubes."""
    parts = [
        "# The measurement cube",
        "",
        "A measurement cube contains the results of a scan. In Python it is an",
        "`xarray.Dataset`, on the disk a netCDF file with CF conventions. The",
        "attribute `level` states the processing step: `samples`, `target_signal`",
        "(after removal of the water signal), `range_image` or `point_cloud`. Each",
        "section below lists the variables of one level. Signals are peak amplitudes",
        "in volts, not rms. A delayed echo has a positive phase: the complex signal",
        "is the in-phase output plus i times the quadrature output. The last column",
        "of a table marks",
        "required variables. `docs/make_reference.py` generates this page.",
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
    parts += ["", "## Attributes on errors of the instrument", ""]
    parts += ["| attribute | meaning |", "| --- | --- |"]
    for name, meaning in schema.INSTRUMENT_ATTRIBUTES.items():
        parts.append(f"| `{name}` | {meaning} |")
    return "\n".join([*parts, ""])


def flags_page() -> str:
    """Return the page on flags, warnings and terms of the error budget."""
    parts = [
        "# Flags, warnings, error terms",
        "",
        "A flag marks a pixel or a sample whose result is missing or doubtful. A",
        "pixel is one direction of the scan. A sample is one reading of the lock-in:",
        "one pixel at one modulation frequency in one channel (pair of polarizations).",
        "An open-water reference is a measurement of the same water without a target.",
        "",
        "This page states the test, the rate of false alarms, the effect and the",
        "remedy of every flag and warning. `amulor explain NAME` prints the same text.",
        "NAME may also be a printed message. `amulor explain FILE --pixel ROW,COLUMN`",
        "prints the flags of one pixel of a target signal or a range image, with",
        "the measured value, the limit and the remedy for each channel. Rows and",
        "columns count from 0.",
        "",
        "A file with flags also contains the measured values of the tests, such as",
        "`no_target_probability` and `water_residual_cause` ([cube files](cube.md)).",
        "`docs/make_reference.py` generates this page with the limits that the code",
        "uses.",
        "",
    ]
    kind = ""
    for one in explanations.explanations().values():
        if one.kind == "error term":
            continue
        if one.kind != kind:
            kind = one.kind
            parts += [f"## {kind[0].upper()}{kind[1:]}s", ""]
        parts += [f"### {one.name}", "", _with_code(one.meaning), ""]
        rows = (
            ("Test", one.compared),
            ("By chance", one.chance),
            ("Effect", one.consequence),
            ("What to do", one.remedy),
        )
        parts += [f"- *{label}:* {_with_code(text)}" for label, text in rows if text]
        parts.append("")
    parts += [
        "## Error terms",
        "",
        "Each term is a part of the standard uncertainty of the range.",
        "`amulor info FILE` and `amulor report` print its size. Type A comes from",
        "repeated measurements, type B from stated values",
        "([error budget](../theory/error-budget.md)).",
        "",
        "| term | `amulor explain` | meaning | type |",
        "| --- | --- | --- | --- |",
    ]
    parts += [
        f"| `{name}` | `TERM_{name.upper()}` | {term.meaning} | {term.kind} |"
        for name, term in schema.TERMS.items()
    ]
    parts.append("")
    return "\n".join(parts)


#: Options, with the command before them. Outside of code, two hyphens become a dash.
_OPTIONS = re.compile(
    r"(?:amulor(?: [a-z]+)+ )?--[a-z-]+(?:(?<=--method) [a-z-]+)?(?: --[a-z-]+)*"
)


def _with_code(text: str) -> str:
    """Set commands and options of a text in code."""
    return _OPTIONS.sub(r"`\g<0>`", text)


def samples_page() -> str:
    """Return the page on sample data."""
    parts = [
        "# Sample data",
        "",
        "The package contains measurement cubes and recordings of other authors, so a",
        "first test needs no download. VV and VH are channels: the first letter is the",
        "launched polarization, the second the analyzed one, both vertical (V) or",
        "horizontal (H).",
        "`amulor samples` lists the samples. `amulor samples NAME -o FOLDER` writes",
        "the files of a sample. In Python, `amulor.samples.copy(NAME, FOLDER)` writes",
        'the files, and `amulor.samples.cube("ladder")` reads a cube directly.',
        "`tools/make_samples.py` generates the cubes.",
        "",
    ]
    for name, one in samples.samples().items():
        parts += [f"## `{name}`", "", f"{one.title}. The sample shows {one.shows}.", ""]
        parts += [
            f"- *Files:* {', '.join(f'`{file}`' for file in one.files)}, "
            f"{one.size / 1e3:.0f} kB",
            f"- *Origin:* {one.origin}",
            f"- *License:* {one.licence}",
            "",
        ]
        if one.commands:
            commands = [f"$ {command}" for command in one.commands]
            parts += ["```console", *commands, "```", ""]
    return "\n".join(parts)


def _variables(specs: dict[str, schema.Variable]) -> list[str]:
    rows = [
        "| name | dimensions | unit | meaning | needed |",
        "| --- | --- | --- | --- | --- |",
    ]
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


def reach_table() -> str:
    """Return the table of what each published instrument sees where."""
    names = presets.names()
    found = {
        name: [
            reach(survey.Survey.preset(name), accuracy=3e-3, water=water)
            for water in WATERS
        ]
        for name in names
    }
    violet, green = found["amulor-2010"], found["green-2021"]
    lines = [
        "| water | attenuation at 405, 532 nm | "
        + " | ".join(f"`{name}`" for name in names)
        + " |",
        "| --- " * (2 + len(names)) + "|",
    ]
    for number, first in enumerate(violet):
        water = first.water.split(",")[0]
        attenuation = f"{first.attenuation:.2g}, {green[number].attenuation:.2g} 1/m"
        cells = [_reached(found[name][number].farthest) for name in names]
        lines.append(f"| {water} | {attenuation} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _reached(farthest: float | None) -> str:
    if farthest is None:
        return "nowhere"
    return "> 60 m" if math.isinf(farthest) else f"{farthest:.2g} m"


PAGES: dict[str, typing.Callable[[], str]] = {
    "survey-file.md": survey_page,
    "cube.md": cube_page,
    "flags.md": flags_page,
    "samples.md": samples_page,
    "presets-where.md": reach_table,
}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, page in PAGES.items():
        (FOLDER / name).write_text(page(), encoding="utf-8")
