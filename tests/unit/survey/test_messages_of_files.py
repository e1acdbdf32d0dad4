"""Messages for errors in TOML files: field, value found, and what is needed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field

from amulor.errors import SurveyError
from amulor.survey import Survey, files, toml_file
from amulor.survey.quantity import Angle, Description, Fraction, Length, Voltage


class Round(Description):
    """Round part."""

    kind: Literal["round", "oval"]
    """Kind of part."""
    radius: Annotated[Length, Field(gt=0, le=2)]
    """Radius of the part,
    from its middle [m]."""


class Flat(Description):
    """Flat part."""

    kind: Literal["flat"]
    """Kind of part."""
    width: Annotated[Length, Field(ge=0.5, lt=9)]
    """Width of the part [m]."""


class Whole(Description):
    """Whole of several parts."""

    name: str
    """Name of the whole."""
    parts: Annotated[
        tuple[Annotated[Round | Flat, Field(discriminator="kind")], ...],
        Field(min_length=1),
    ] = ()
    """Parts of the whole."""
    pair: tuple[Length, Length] = (0.0, 0.0)
    """Two lengths of the whole [m]."""
    count: Annotated[int, Field(ge=1)] = 1
    """Number of wholes [1]."""
    factor: Annotated[float, Field(le=3, allow_inf_nan=False)] = 1.0
    """Factor of the whole [1]."""
    share: Annotated[Fraction, Field(le=1)] = 0.5
    """Share of the whole [1]."""
    code: Annotated[str, Field(pattern="^[a-z]+$")] = "a"
    """Code of the whole: letters."""


def refused(text: str, **words: str) -> list[str]:
    """Return the lines of a refusal."""
    fields = {"name": "w.toml", "what": "a whole"} | words
    with pytest.raises(SurveyError) as error:
        toml_file.described(text, Whole, error=SurveyError, **fields)  # type: ignore[arg-type]
    return str(error.value).splitlines()


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "name: is missing; needed is: Name of the whole."),
        ('name = "a"\nnme = 1',
         "nme: is no field of a whole; did you mean 'name'? allowed here: name, parts, "
         "pair, count, factor, share, code"),
        ('name = "a"\nxyz = 1',
         "xyz: is no field of a whole; allowed here: name, parts, pair, count, factor, "
         "share, code"),
        ('name = "a"\n[[parts]]\nkind = "round"\nradius = "1 m"\nwidth = 2',
         "parts.0.width: is no field of a whole; allowed here: kind, radius"),
        ('name = "a"\n[[parts]]\nkind = "flat"\nwidth = "1 m"\n[[parts]]\n'
         'kind = "oval"',
         "parts.1.radius: is missing; needed is: Radius of the part, from its middle "
         "[m]."),
        ('name = "a"\n[[parts]]\nkind = "square"',
         'parts.0: found {"kind": "square"}, but it must be a table with kind = one of '
         "round, oval, flat"),
        ('name = "a"\n[[parts]]\nwidth = "1 m"',
         'parts.0: found {"width": "1 m"}, but it must be a table with kind = one of '
         "round, oval, flat"),
        ('name = "a"\nparts = []', "parts: found [], but at least one is needed"),
        ('name = "a"\nparts = 3',
         "parts: found 3, but it must be a list, in square brackets"),
        ('name = "a"\nparts = [3]',
         "parts.0: found 3, but it must be a table of fields"),
        ('name = "a"\n[[parts]]\nkind = "round"\nradius = "0 m"',
         'parts.0.radius: found "0 m", but it must be above 0 m'),
        ('name = "a"\n[[parts]]\nkind = "round"\nradius = "201 cm"',
         'parts.0.radius: found "201 cm", but it must be at most 200 cm'),
        ('name = "a"\n[[parts]]\nkind = "flat"\nwidth = "9 m"',
         'parts.0.width: found "9 m", but it must be below 9 m'),
        ('name = "a"\n[[parts]]\nkind = "flat"\nwidth = "499 mm"',
         'parts.0.width: found "499 mm", but it must be at least 500 mm'),
        ('name = "a"\npair = ["1 m"]',
         "pair.1: is missing; needed are at least 2 values"),
        ('name = "a"\ncount = 0', "count: found 0, but it must be at least 1"),
        ('name = "a"\ncount = 1.5', "count: found 1.5, but it must be a whole number"),
        ('name = "a"\ncount = [1]', "count: found [1], but it must be a whole number"),
        ('name = "a"\nfactor = 3.5',
         "factor: found 3.5, but it must be at most 3 in SI units"),
        ('name = "a"\nfactor = 4', "factor: found 4, but it must be at most 3"),
        ('name = "a"\nfactor = nan', "factor: found NaN, but it must be finite"),
        ('name = "a"\nfactor = [1]', "factor: found [1], but it must be a number"),
        ("name = 3", "name: found 3, but it must be a text in quotation marks"),
        ('name = "a"\ncode = "A1"',
         'code: found "A1"; needed is: Code of the whole: letters.'),
        ('name = "a"\n[parts]\nx = 1',
         'parts: found {"x": 1}, but it must be a list, in square brackets'),
    ],
)  # fmt: skip
def test_each_mistake_has_field_value_and_remedy(text: str, line: str) -> None:
    """Limits have the unit of the value in the file."""
    assert refused(text) == [f"w.toml: {line}"]


def test_long_values_and_names_are_shortened() -> None:
    """Sixty characters of a value, a hundred of a field."""
    text = "x" * 58
    assert refused(f'name = "a"\ncount = "{text}"')[0].startswith(
        f'w.toml: count: found "{text}"'
    )
    (line,) = refused(f'name = "a"\ncode = "{"1" * 59}"')
    assert f'found "{"1" * 56}...;' in line
    (line,) = refused(f'name = "a"\n{"k" * 101} = 1')
    assert line.startswith(f"w.toml: {'k' * 100}...: is no field")
    (line,) = refused(f'name = "a"\n{"k" * 100} = 1')
    assert line.startswith(f"w.toml: {'k' * 100}: is no field")


def test_twenty_errors_are_printed_and_others_counted() -> None:
    """Equal lines are one."""
    fields = "\n".join(f"z{n} = 1" for n in range(20))
    assert len(refused(f'name = "a"\n{fields}')) == 20
    lines = refused(f'name = "a"\n{fields}\nz20 = 1\nz21 = 1')
    assert len(lines) == 21
    assert lines[-1] == "w.toml: 2 further errors are left out"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = ", r"^w\.toml: is no valid TOML: "),
        (
            "a = 1" + "0" * 5000,
            r"a whole number with more digits than any number of a ",
        ),
        (
            "a = " + "[" * 21 + "]" * 21,
            "is nested deeper than 20 levels, and no part of",
        ),
        (".".join("a" * 102) + " = 1", "is nested deeper than 20 levels"),
        ("[" + ".".join("a" * 102) + "]", "is nested deeper than 20 levels"),
    ],
)
def test_texts_that_are_no_files_are_refused(text: str, words: str) -> None:
    """The parser is not asked about names with a hundred points."""
    with pytest.raises(SurveyError, match=words):
        toml_file.described(
            text, Whole, name="w.toml", what="a whole", error=SurveyError
        )


def test_twenty_levels_are_as_deep_as_a_file_goes() -> None:
    """Nineteen brackets below a key are read, and then refused as no value."""
    (line,) = refused('name = "a"\ncount = ' + "[" * 18 + "]" * 18)
    assert "must be a whole number" in line
    assert "nested deeper" in refused('name = "a"\ncount = ' + "[" * 20 + "]" * 20)[0]
    # A line with an array of texts with many points is no key.
    points = '"' + "." * 101 + '"'
    text = f'name = "a"\ncode = [\n{points},\n]'
    assert "nested" not in refused(text)[0]


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    """A mark of UTF-8 at the begin is no part of the text."""
    with pytest.raises(SurveyError, match=r"gone\.toml: cannot be read \(No such file"):
        toml_file.text_of(tmp_path / "gone.toml", error=SurveyError)
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(SurveyError, match=r"a\.toml: is no valid TOML: "):
        toml_file.text_of(path, error=SurveyError)
    path.write_bytes(b'\xef\xbb\xbfname = "a"\nshare = 0.25\n')
    found = toml_file.read(path, Whole, what="a whole", error=SurveyError)
    assert (found.name, found.share) == ("a", 0.25)


def test_quantities_have_units_in_files_only() -> None:
    """In Python numbers are in SI units; a fraction needs none in a file either."""
    assert Whole(name="a", pair=(1, 2.5)).pair == (1.0, 2.5)
    assert refused('name = "a"\npair = [1.5, "2 m"]') == [
        "w.toml: pair.0: found 1.5, a number without a unit; needed is the length as "
        'text such as "20 cm"'
    ]
    for value in (True, [1], None):
        with pytest.raises(ValueError, match="needed is the length as text such as"):
            Whole(name="a", pair=(value, 1.0))  # type: ignore[arg-type]


class Large(Description):
    """Quantities that may be large."""

    angle: Angle = 0.0
    length: Length = 0.0
    voltage: Voltage = 0.0


@pytest.mark.parametrize(
    ("field", "largest", "beyond"),
    [
        ("angle", "1e4 rad", "1.01e4 rad"), ("length", "1e16 m", "1.01e16 m"),
        ("voltage", "-1e30 V", "-1.01e30 V"),
    ],
)  # fmt: skip
def test_texts_have_no_numbers_beyond_all_measure(field, largest, beyond) -> None:
    """The limit depends on the quantity, and holds for both signs."""
    content: dict[str, Any] = {field: largest}
    Large.model_validate(content)
    with pytest.raises(ValueError, match=f"no {field} is beyond "):
        Large.model_validate({field: beyond})


def test_a_schema_allows_the_texts_of_quantities() -> None:
    """A fraction is a text or a number, other quantities are texts."""
    properties = Large.model_json_schema()["properties"]
    assert properties["voltage"] == {
        "default": 0.0, "description": "voltage, a number with a unit",
        "examples": ["10 mV"], "title": "Voltage", "type": "string",
    }  # fmt: skip
    text, number = Whole.model_json_schema()["properties"]["share"]["anyOf"]
    assert (text["type"], number) == ("string", {"type": "number"})


class Named(Description):
    """Section that names a file."""

    file: Path

    def settled(self, folder: Path, *, where: str) -> Named:
        """Return a copy with the full path, and the place in its name."""
        return self.model_copy(update={"file": folder / f"{where} {self.file}"})


class Holder(Description):
    """Section with others below it."""

    one: Named | None = None
    many: tuple[Named | Flat, ...] = ()
    number: int = 3


def test_files_of_all_sections_are_settled_with_their_place() -> None:
    """Sections without files stay what they are."""
    flat = Flat(kind="flat", width=1.0)
    plain = Holder(many=(flat,))
    assert files.settled(plain, Path("f"), where="t") is plain
    holder = Holder(one=Named(file=Path("a")), many=(flat, Named(file=Path("b"))))
    found = files.settled(holder, Path("f"), where="t")
    assert found.one == Named(file=Path("f/t: one a"))
    assert found.many[0] is flat
    assert found.many[1] == Named(file=Path("f/t: many.1 b"))
    assert found.number == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "1, 1.1e15\n",
            r"line 1: found 1\.1e\+15; no angle and no share of light is b",
        ),
        ("1, 1\n-1.1e15, 1\n", r"line 2: found -1\.1e\+15; no angle"),
        ("1, 1e15\n", ""),
    ],
)
def test_a_table_has_no_numbers_beyond_all_measure(tmp_path, text, words) -> None:
    """The largest number of a line is named."""
    path = tmp_path / "t.csv"
    path.write_text(text)
    if not words:
        assert files.columns(path, count=2, where="x") == [[1.0], [1e15]]
        return
    with pytest.raises(SurveyError, match=words):
        files.columns(path, count=2, where="x")


def test_a_table_of_one_megabyte_is_read(tmp_path: Path) -> None:
    """One byte more is too much."""
    path = tmp_path / "t.csv"
    path.write_text("1,2\n" + "#" * 999_996)
    assert path.stat().st_size == 1_000_000
    assert files.columns(path, count=2, where="x") == [[1.0], [2.0]]
    path.write_text("1,2\n" + "#" * 999_997)
    with pytest.raises(SurveyError, match=r"t\.csv has more than 1 MB; needed is a te"):
        files.columns(path, count=2, where="x")


def test_a_section_is_validated_with_its_place() -> None:
    """The words are those of the check, or of the first problem."""
    with pytest.raises(SurveyError, match=r"^here: Field required$"):
        files.validated(Whole, {}, where="here")
    words = "^here: found .*needed is the length as text"
    with pytest.raises(SurveyError, match=words):
        files.validated(Whole, {"name": "a", "pair": (True, 1)}, where="here")
    assert files.validated(Whole, {"name": "a"}, where="here").count == 1


def test_a_survey_file_has_a_size_of_files(tmp_path: Path, plate_text: str) -> None:
    """A text of some kilobytes; the limit is stated in bytes."""
    from amulor.survey import survey

    limit = survey._SIZE_LIMIT
    path = tmp_path / "s.toml"
    start = f"{plate_text}\n# "
    path.write_text(start + "x" * (limit - len(start.encode())))
    assert path.stat().st_size == limit
    assert Survey.from_toml(path).scan.columns > 0
    path.write_text(start + "x" * (limit + 1 - len(start.encode())))
    with pytest.raises(
        SurveyError, match=f"has {limit + 1} bytes, more than any survey"
    ):
        Survey.from_toml(path)
