"""The campaign of mutations: what it leaves out, and the share that it prints."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

TOOL = Path(__file__).parents[2] / "tools" / "mutate.py"


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(TOOL.parent)
    spec = importlib.util.spec_from_file_location("mutate_tool", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutate_tool"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["mutate_tool"]


@pytest.fixture
def source(tool: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tool, "PACKAGE", tmp_path)
    file = tmp_path / "part.py"
    file.write_text("def doubled(x):\n    return x * 2\n")
    return file


def test_a_change_is_known_by_its_line_wherever_that_stands(
    tool: ModuleType, source: Path
) -> None:
    keys = {one.key for one in tool.mutants_of(source)}
    assert keys == {
        ("part.py", "return x * 2", "return x * 2 -> None"),
        ("part.py", "return x * 2", "x * 2 -> x / 2"),
        ("part.py", "return x * 2", "2 -> 3"),
    }
    source.write_text("# First.\n\n" + source.read_text())
    assert {one.key for one in tool.mutants_of(source)} == keys
    source.write_text(source.read_text().replace("x * 2", "x * 2 + 1"))
    assert not keys & {one.key for one in tool.mutants_of(source)}


def test_a_change_replaces_what_it_says(tool: ModuleType, source: Path) -> None:
    texts = {one.said: one.source for one in tool.mutants_of(source)}
    assert texts["2 -> 3"] == "def doubled(x):\n    return x * 3\n"


def test_declarations_are_left_to_the_type_checker(
    tool: ModuleType, source: Path
) -> None:
    source.write_text(
        "@dataclass(frozen=True)\nclass Part:\n    size: int = 1\n\n"
        "    @cached(True)\n    def doubled(self: Part[2]) -> Literal[3]:\n"
        "        raise ValueError(f'{4}')\n"
    )
    assert {one.said for one in tool.mutants_of(source)} == {
        "1 -> 2", "True -> False", "without raise ValueError(f'{4}')"
    }  # fmt: skip


def test_where_there_is_no_test_not_all_of_them_are_run(
    tool: ModuleType, tmp_path: Path
) -> None:
    # Any run of tests ends after this time, and would count as hanging.
    assert not tool._fails([], tmp_path, longest=0.01)
    assert tool._fails(["tests/unit/test_mutate.py"], tmp_path, longest=0.01)


def test_each_equivalent_change_is_one_that_the_tool_makes(tool: ModuleType) -> None:
    for (name, code, change), reason in tool.equivalents().items():
        found = {one.key for one in tool.mutants_of(tool.PACKAGE / name)}
        assert (name, code, change) in found
        assert len(reason.split()) > 2


def test_the_share_is_of_the_changes_that_are_not_equivalent(tool: ModuleType) -> None:
    # Clopper and Pearson: without a miss in n the lower bound is 0.025^(1/n).
    said = tool.summary(12, 10, 2)
    assert f"10 of 10 changes that are not equivalent were caught: {1.0:.1%}" in said
    assert f"within {0.025**0.1:.1%} and {1.0:.1%}" in said
    assert "2 of 12 drawn are equivalent" in said
    # Tabulated: 9 of 10 lie between 0.5550 and 0.9975.
    assert "90.0%, 95 % within 55.5% and 99.7%" in tool.summary(10, 9, 0)
    assert tool.summary(3, 0, 3) == "all 3 changes are equivalent"


def test_the_nearest_tests_come_first_and_none_comes_twice(tool: ModuleType) -> None:
    stages = tool.tests_of(tool.PACKAGE / "io" / "ply.py")
    files = [file for stage in stages for file in stage]
    assert "ply" in Path(files[0]).stem
    assert len(files) == len(set(files))
    root = TOOL.parents[1]
    room = (root / "tests" / "unit" / "io").rglob("test_*.py")
    assert {str(path.relative_to(root)) for path in room} <= set(files)


def test_tests_that_import_a_module_beside_others_are_run_for_it(
    tool: ModuleType,
) -> None:
    # It says: from amulor.optics import small_angle, target_echo.
    stages = tool.tests_of(tool.PACKAGE / "optics" / "target_echo.py")
    files = {file for stage in stages for file in stage}
    assert "tests/physics/test_small_angle_target_echo.py" in files
