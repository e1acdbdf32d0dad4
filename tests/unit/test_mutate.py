"""The campaign of mutations: what it leaves out, and the share that it prints."""

from __future__ import annotations

import csv
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from scripts import script

TOOL = Path(__file__).parents[2] / "tools" / "mutate.py"


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(TOOL.parent)
    return script("tools/mutate.py")


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


def test_appearance_progress_and_caches_are_not_tried(
    tool: ModuleType, source: Path
) -> None:
    source.write_text(
        "@lru_cache(maxsize=1)\ndef drawn(x):\n    with part(0.5, 1.0):\n"
        "        axis.plot(x, lw=2, labelpad=-3)\n    return bar(x, width=4)\n"
    )
    mutants = tool.mutants_of(source)
    assert {one.said for one in mutants if one.unseen} == {
        "1 -> 2", "0.5 -> 0.55", "1.0 -> 1.1", "2 -> 3", "3 -> 4", "-3 -> 3"
    }  # fmt: skip
    assert "4 -> 5" in {one.said for one in mutants}


def test_changes_that_alter_nothing_by_their_kind_are_not_tried(
    tool: ModuleType, source: Path
) -> None:
    source.write_text(
        "_AT_ONCE = 4096\n\n\ndef part(values, flag):\n    tell('half', share)\n"
        "    if flag:\n        return None\n    if flag:\n        return False\n"
        "    pairs = zip(values, flag, strict=True)\n"
        "    return values.reshape(len(values), -1)\n"
    )
    assert {one.said for one in tool.mutants_of(source) if one.unseen} == {
        "4096 -> 4097", "without tell('half', share)", "return None -> None",
        "return False -> None", "1 -> 2", "True -> False",
    }  # fmt: skip
    # A length of 1 in place of the one that is left is a change, and so is True.
    tried = {one.said for one in tool.mutants_of(source) if not one.unseen}
    assert tried == {
        "-1 -> 1", "False -> True",
        "return values.reshape(len(values), -1) -> None",
    }  # fmt: skip


def test_seeds_repetitions_and_tiny_guards_are_not_tried(
    tool: ModuleType, source: Path
) -> None:
    source.write_text(
        "_TOGETHER = 64\n\n\n@njit(cache=True)\ndef part(x):\n"
        "    for _ in range(5):\n        y = np.maximum(x, 1e-300) / max(x, 1e-10)\n"
        "    return solve(y, xtol=1e-12, max_nfev=6, seed=7, rng=default_rng(8))\n"
    )
    assert {
        one.said.partition(" ")[0] for one in tool.mutants_of(source) if one.unseen
    } == {"64", "True", "5", "1e-300", "1e-10", "1e-12", "6", "7", "8"}
    # One more of so many points that stand for all; of 12 arrows each is seen.
    source.write_text(
        "_PLANES, _SOME = 300, 1500\n\n\ndef part(x):\n"
        "    y = x[:: max(len(x) // _SOME, 1)]\n"
        "    return y[:: max(len(y) // 2000, 1)], x[:: len(x) // 12]\n"
    )
    assert {one.said for one in tool.mutants_of(source) if one.unseen} == {
        "1500 -> 1501", "2000 -> 2001"
    }  # fmt: skip
    # A limit of a result, a default, and an iteration that ends early are tried.
    source.write_text(
        "_TOGETHER = 3.5\n\n\ndef part(x, seed=7):\n    for n in range(5):\n"
        "        x = max(x, 1e-3)\n    for _ in range(2):\n"
        "        x = near(x, rtol=1e-4)\n"
    )
    tried = [one.said for one in tool.mutants_of(source) if not one.unseen]
    assert {said.partition(" ")[0] for said in tried} >= {
        "3.5", "7", "5", "0.001", "2", "0.0001"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("x < 1", "x <= 1"), ("x > 0.0", "x >= 0.0"), ("len(x) >= y", "len(x) > y"),
        ("x.size <= y", "x.size < y"), ("x == y", "x != y"), ("x < 0.5", "x > 0.5"),
        ("x >= y", "x <= y"), ("x is y", "x is not y"),
    ],
)  # fmt: skip
def test_limits_of_real_numbers_are_turned_round(
    tool: ModuleType, source: Path, old: str, new: str
) -> None:
    source.write_text(f"def part(x, y):\n    assert {old}\n")
    assert f"{old} -> {new}" in {one.said for one in tool.mutants_of(source)}


def test_near_and_fast_tests_come_first(tool: ModuleType) -> None:
    tests = {
        "tests/far.py::test_a": 0.1, "tests/near.py::test_slow": 3.0,
        "tests/near.py::test_fast": 0.2, "tests/other.py": 0.05,
    }  # fmt: skip
    assert tool.ordered(tests, [["tests/near.py"]]) == [
        "tests/near.py::test_fast",
        "tests/other.py",
        "tests/far.py::test_a",
        # Long tests wait until all short ones have had their turn.
        "tests/near.py::test_slow",
    ]


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


def test_the_share_of_a_stratified_sample_is_weighted(tool: ModuleType) -> None:
    # 0.9 of 300 changes and 0.5 of 100: 0.8. Variances with (k + 1) of (n + 2): 19 of
    # 22 and 6 of 12, over 20 and 10; 1.96 standard deviations of the sum are 0.136.
    said = tool.weighted({"io": (18, 20), "cube": (5, 10)}, {"io": 300, "cube": 100})
    first, second = 19 / 22 * 3 / 22 / 20, 0.25 / 10
    spread = 1.96 * (0.75**2 * first + 0.25**2 * second) ** 0.5
    assert f"{0.8:.1%}, 95 % within {0.8 - spread:.1%} and {0.8 + spread:.1%}" in said
    # A folder of which nothing was tried has no weight.
    alone = tool.weighted({"io": (18, 20), "cube": (0, 0)}, {"io": 300, "cube": 100})
    assert "90.0%" in alone


def changes(names: Iterable[object]) -> list[SimpleNamespace]:
    """Return changes of lines with these names."""
    return [SimpleNamespace(key=(str(name), "", "")) for name in names]


def test_a_sample_has_each_folder_early_and_eight_changes_of_it(
    tool: ModuleType,
) -> None:
    folders = {
        "large": changes(range(900)),
        "small": changes(range(1000, 1100)),
        "tiny": changes(range(2000, 2005)),
    }
    drawn = tool.sampled(folders, 100, 1)
    ids = [id(one) for one in drawn]
    assert len(set(ids)) == len(drawn)
    of = {name: {id(one) for one in found} for name, found in folders.items()}
    counts = {name: len(found & set(ids)) for name, found in of.items()}
    # Roots 30, 10 and 2.2: 71, 24 and 5 of 100, of which the tiny folder has no 8.
    assert counts == {"large": 71, "small": 24, "tiny": 5}
    assert drawn == tool.sampled(folders, 100, 1)
    assert drawn != tool.sampled(folders, 100, 2)
    assert all(found & set(ids[:30]) for found in of.values())


def test_a_line_that_changes_alters_no_draw_of_other_lines(tool: ModuleType) -> None:
    before = {"io": changes(range(400)), "cube": changes(range(1000, 1400))}
    after = {"io": changes(["new", *range(1, 400)]), "cube": before["cube"]}
    old, new = (
        [one.key[0] for one in tool.sampled(folders, 100, 7)]
        for folders in (before, after)
    )
    assert [name for name in old if name >= "1000"] == [
        name for name in new if name >= "1000" and name != "new"
    ]
    assert len(set(old) ^ set(new)) <= 2


def test_the_same_change_at_two_places_of_a_file_is_drawn_twice_by_chance(
    tool: ModuleType,
) -> None:
    # Places of the same name would otherwise be neighbors in each sample.
    twice = {"io": changes([*range(200), *range(200)])}
    names = [one.key[0] for one in tool.sampled(twice, 100, 3)]
    pairs = len(names) - len(set(names))
    # 100 of 400 places: each of 200 names twice with a chance of 100/400 * 99/399.
    assert abs(pairs - 200 * 100 / 400 * 99 / 399) < 4 * 12.4**0.5


def test_the_table_has_a_figure_for_each_folder(tool: ModuleType) -> None:
    rows = [{"file": "io/ply.py", "result": "caught"}] * 9
    rows += [{"file": "io/ply.py", "result": "survived"}]
    rows += [{"file": "units.py", "result": "equivalent"}]
    said = tool.table(rows, {"io": 100, ".": 10, "cube": 10})
    # Tabulated: 9 of 10 lie between 0.5550 and 0.9975.
    assert "| io | 9 | 10 | 90% | 55% to 100% |" in said
    assert "| . |" not in said
    assert "cube" not in said
    assert "| all | 9 | 10 | 90% | 55% to 100% |" in said


def test_shares_are_written_for_each_folder_and_all(
    tool: ModuleType, tmp_path: Path
) -> None:
    rows = [{"file": "io/ply.py", "result": "caught"}] * 9
    rows += [{"file": "units.py", "result": "survived"}]
    tool._write_shares(tmp_path / "shares.csv", rows, {"io": 100, ".": 10})
    head, *lines = (tmp_path / "shares.csv").read_text().splitlines()
    assert head == "folder,caught,tried,share_%,low_%,high_%"
    # Tabulated: none of 1 lies below 0.975, and 9 of 9 above 0.6637.
    assert lines == [".,0,1,0,0,98", "io,9,9,100,66,100", "all,9,10,90,55,100"]


PART = '''"""Doubles numbers."""


def doubled(x):
    if x > 5:
        raise ValueError("above 5")
    return x * 2


def tripled(x):
    while x < 0:
        x += 1
    return x * 3
'''
TESTS = """from amulor.part import doubled, tripled


def test_doubled():
    assert doubled(3) == 6
    assert tripled(-1) == 0
    assert tripled(2) == 6


def test_broken():
    raise AssertionError
"""
LONG = """import time

from amulor.part import doubled


def test_long():
    assert doubled(0) == 0
    while time.process_time() < 2.5:
        pass


def test_short():
    assert doubled(2) == 4
"""


@pytest.mark.slow
def test_a_campaign_finds_what_tests_notice_and_continues(tmp_path: Path) -> None:
    for folder in ("tools", "src/amulor", "tests/unit"):
        (tmp_path / folder).mkdir(parents=True)
    for name in ("mutate.py", "covering.py", "switched.py"):
        shutil.copy(TOOL.with_name(name), tmp_path / "tools")
    (tmp_path / "tools" / "equivalent_mutants.toml").write_text("mutant = []\n")
    (tmp_path / "pyproject.toml").write_text(
        "[tool.pytest.ini_options]\nmarkers = ['slow', 'study']\n"
    )
    (tmp_path / "src" / "amulor" / "__init__.py").touch()
    (tmp_path / "src" / "amulor" / "part.py").write_text(PART)
    (tmp_path / "tests" / "unit" / "test_part.py").write_text(TESTS)
    broken = tmp_path / "tests" / "unit" / "test_broken.py"
    broken.write_text("import part_of_nothing\nfrom amulor import part\n")
    words = [sys.executable, str(tmp_path / "tools" / "mutate.py"), "--jobs", "1"]
    words += ["--budget", "2", "--sample", "30"]
    # Without time, a campaign ends after its first change.
    short = [*words, "--minutes", "0", "--results", str(tmp_path / "short.csv")]
    subprocess.run(short, capture_output=True, check=True, timeout=200)
    assert len((tmp_path / "short.csv").read_text().splitlines()) == 2
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    lines = (tmp_path / "tools" / "mutations.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines))
    found = {row["change"]: row["result"] for row in rows}
    survived = {change for change, result in found.items() if result == "survived"}
    # No test tries 5 and numbers above it.
    assert survived == {
        "without raise ValueError('above 5')", "5 -> 6", "x > 5 -> x >= 5"
    }  # fmt: skip
    by = {row["change"]: row["by"] for row in rows}
    assert by["without x += 1"] == "hang"
    assert by["x * 2 -> x / 2"] == "tests/unit/test_part.py::test_doubled"
    assert (tmp_path / "src" / "amulor" / "part.py").read_text() == PART
    again = subprocess.run(words, capture_output=True, text=True, check=True)
    assert again.stdout.splitlines()[1:] == done.stdout.splitlines()[len(rows) + 1 :]
    # With the tests of each change, and all changes behind switches, it is the same.
    words += ["--covering", str(tmp_path / "tests.json")]
    subprocess.run([*words, "--cover", "tests"], cwd=tmp_path, check=True)
    words += ["--results", str(tmp_path / "covered.csv")]
    subprocess.run(words, capture_output=True, check=True)
    with (tmp_path / "covered.csv").open(newline="") as file:
        covered = {row["change"]: row for row in csv.DictReader(file)}
    assert {change: row["result"] for change, row in covered.items()} == found
    assert {change: row["by"] for change, row in covered.items()} == by


@pytest.mark.slow
def test_a_test_that_uses_up_the_budget_is_left_out(tool: ModuleType, tmp_path) -> None:
    package, tests = tmp_path / "src" / "amulor", tmp_path / "tests"
    for folder in (package, tests):
        folder.mkdir(parents=True)
    (tmp_path / "pyproject.toml").write_text(
        "[tool.pytest.ini_options]\nmarkers = ['slow', 'study']\n"
    )
    (package / "__init__.py").touch()
    (package / "part.py").write_text(PART)
    (tests / "test_part.py").write_text(LONG)
    program = f"""import sys
from pathlib import Path
sys.path.insert(0, {str(TOOL.parent)!r})
import mutate
mutate.ROOT, mutate.PACKAGE = Path.cwd(), Path.cwd() / "src" / "amulor"
(one,) = [
    mutant
    for mutant in mutate.mutants_of(mutate.PACKAGE / "part.py")
    if mutant.said == "x * 2 -> x / 2"
]
worker = mutate.Worker(Path.cwd() / "copy", budget=2, tests={{}})
outcome = worker.outcome(one)
print(outcome.by, outcome.seconds < 2)
"""
    words = [sys.executable, "-c", program]
    done = subprocess.run(
        words, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "tests/test_part.py::test_short True\n"


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
