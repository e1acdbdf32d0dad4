"""Which tests run a line, from data of coverage.py that are made by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from coverage import CoverageData

TOOLS = Path(__file__).parents[2] / "tools"
#: Lines 1 to 11.
SOURCE = """_TURNS = 3
LIMIT = 2.5


def wound(
    x,
):
    if x > LIMIT:
        x = LIMIT
    return x * _TURNS
"""


@pytest.fixture
def covering(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(TOOLS)
    from covering import Covering

    package = tmp_path / "part"
    package.mkdir()
    (package / "coil.py").write_text(SOURCE)
    (package / "user.py").write_text("from part.coil import LIMIT\n\nprint(LIMIT)\n")
    data = CoverageData(str(tmp_path / "data"))
    ran = {
        "tests/test_a.py::test_small[1]|run": ("coil", [8, 10]),
        "tests/test_a.py::test_small[2]|run": ("coil", [8, 10]),
        "tests/test_a.py::test_large|run": ("coil", [8, 9, 10]),
        "tests/test_b.py::test_first|setup": ("coil", [10]),
        "tests/test_b.py::test_first|run": ("coil", [10]),
        "tests/test_c.py::test_user|run": ("user", [3]),
        "src/part/coil.py::part.coil.wound|run": ("coil", [8, 9, 10]),
    }
    for context, (name, lines) in ran.items():
        data.set_context(context)
        # The run was of another copy.
        data.add_lines({f"/elsewhere/src/part/{name}.py": lines})
    data.write()
    return Covering(tmp_path / "data", package), package


def test_cases_of_a_test_count_once_and_files_whose_fixture_ran_the_line_whole(
    covering: Any,
) -> None:
    found, package = covering
    coil = package / "coil.py"
    assert found.tests(coil, 9) == ["tests/test_a.py::test_large"]
    assert found.tests(coil, 10) == [
        "tests/test_a.py::test_large",
        "tests/test_a.py::test_small",
        "tests/test_b.py",
    ]


def test_the_head_of_a_condition_is_not_its_body_and_that_of_a_function_is(
    covering: Any,
) -> None:
    found, package = covering
    coil = package / "coil.py"
    assert len(found.tests(coil, 8)) == 2
    assert len(found.tests(coil, 6)) == 3


def test_a_constant_is_run_by_who_names_it_and_a_public_one_in_all_modules(
    covering: Any,
) -> None:
    found, package = covering
    coil = package / "coil.py"
    assert found.tests(coil, 1) == found.tests(coil, 10)
    assert set(found.tests(coil, 2)) == {
        "tests/test_a.py::test_large",
        "tests/test_a.py::test_small",
        "tests/test_c.py::test_user",
    }


def test_a_module_that_no_test_imports_has_no_tests(covering: Any) -> None:
    found, package = covering
    (package / "new.py").write_text("x = 1\n\n\ndef f():\n    return 2\n")
    assert found.tests(package / "new.py", 5) == []


def test_data_that_are_missing_are_asked_for(tmp_path: Path, covering: Any) -> None:
    found, package = covering
    with pytest.raises(FileNotFoundError, match="--cov-context=test"):
        type(found)(tmp_path / "none", package)
