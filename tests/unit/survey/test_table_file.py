"""Tables that a survey names: read once, and each mistake in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from amulor.errors import SurveyError
from amulor.survey import Survey, Tabulated, TabulatedSurface, files
from amulor.survey.surface import _largest_reflectance, brightness
from amulor.survey.waters.phase_function import phase_function


def test_commas_spaces_and_notes_are_read(tmp_path: Path) -> None:
    file = tmp_path / "table.txt"
    file.write_text("# angle, value\n0.1, 5e2\n\n 10\t3 # a note\n180,0.1\n")
    assert files.columns(file, count=2, where="x") == [
        [0.1, 10.0, 180.0],
        [500.0, 3.0, 0.1],
    ]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, r"none\.csv cannot be read \(No such file"),
        (b"", "holds no numbers"),
        (b"# nothing\n", "holds no numbers"),
        (b"1, 2\n1, 2, 3\n", r"line 2: found '1, 2, 3'; needed is a text of 2 columns"),
        (b"1, two\n", "line 1: found '1, two'"),
        (b"1, nan\n", "line 1"),
        (b"\x89PNG\xff\xfe", "is no text"),
        (b"1, 2\n" * 250_000, "more than 1 MB"),
    ],
)
def test_a_file_that_is_no_table_is_named(
    tmp_path: Path, content: bytes | None, words: str
) -> None:
    file = tmp_path / "none.csv"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(SurveyError, match=words) as caught:
        files.columns(file, count=2, where="tank.toml: water")
    assert str(caught.value).startswith("tank.toml: water: ")
    assert "\n" not in str(caught.value)


def test_a_table_that_is_no_phase_function_is_refused_where_it_is_named(
    plate_text: str, tmp_path: Path
) -> None:
    (tmp_path / "short.csv").write_text("1, 2\n90, 1\n")
    before, _, rest = plate_text.partition("[water]")
    text = (
        f'{before}[water]\nabsorption = "1 1/m"\nscattering = "1 1/m"\n'
        'phase_function = {kind = "tabulated", file = "short.csv"}\n'
        f"{rest[rest.index('[[targets]]') :]}"
    )
    with pytest.raises(
        SurveyError, match=r"tank: water\.phase_function: .*180 degrees"
    ):
        Survey.from_text(text, name="tank", folder=tmp_path)


def test_what_was_not_read_says_so() -> None:
    with pytest.raises(SurveyError, match=r"has not been read; .*from_toml"):
        phase_function(Tabulated(kind="tabulated", file=Path("a.csv")))
    angle = np.zeros(1)
    with pytest.raises(SurveyError, match=r"has not been read; .*from_toml"):
        brightness(
            TabulatedSurface(kind="tabulated", file=Path("a.csv")),
            reflectance=1.0,
            texture=np.ones(1),
            incidence=angle,
            leaving=angle,
            azimuth=angle,
        )


def test_a_white_surface_of_lambert_reflects_all_light() -> None:
    # Of 1/pi in all directions, by its own closed form: 1. Unequal numbers of angles.
    incidence, leaving = [0.0, 0.5, 1.0], np.linspace(0.0, np.pi / 2, 5)
    for turns in ([0.0], np.linspace(0.0, np.pi, 4)):
        values = np.full((3, 5, len(turns)), 1 / np.pi)
        # One incidence reflects more than the others.
        values[1] *= 1.5
        found = _largest_reflectance(incidence, leaving, turns, values.ravel())
        assert found == pytest.approx(1.5, rel=1e-4)
