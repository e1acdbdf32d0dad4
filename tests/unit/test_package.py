"""Wheel and sdist hold every file that the program reads, and no other."""

import tomllib
from pathlib import Path

from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
_METADATA = WheelBuilder(str(ROOT)).metadata.core


#: What `make docs` makes.
MADE = tuple(
    line for line in (ROOT / ".gitignore").read_text().split() if line[:5] == "docs/"
)


def _there(*folders: str) -> set[str]:
    found = {
        path.relative_to(ROOT).as_posix()
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    return {name for name in found if not name.startswith(MADE)}


def test_the_wheel_holds_the_package_with_its_data() -> None:
    files = WheelBuilder(str(ROOT)).recurse_included_files()
    held = {f"src/{file.distribution_path}" for file in files}
    assert held == _there("src") - {"src/conftest.py"}
    assert "src/amulor/survey/examples/ladder_milk.toml" in held
    assert "src/amulor/optics/data/NOTICE-jerlov.txt" in held
    assert "src/amulor/py.typed" in held


def test_the_sdist_holds_what_builds_tests_and_documents() -> None:
    files = SdistBuilder(str(ROOT)).recurse_included_files()
    held = {file.distribution_path for file in files}
    assert held >= _there("src", "tests", "docs", "examples", "benchmarks", "tools")
    assert held >= {
        "CHANGELOG.md",
        "CITATION.cff",
        "CONTRIBUTING.md",
        "LICENSE",
        "Makefile",
        "NOTICE",
        "README.md",
        "SECURITY.md",
        "constraints.txt",
    }


def test_the_notice_names_each_table_of_others() -> None:
    notice = (ROOT / "NOTICE").read_text()
    folders = ("src/amulor/optics/data", "src/amulor/samples/data/foam")
    tables = {
        name for name in _there(*folders) if Path(name).suffix in {".csv", ".npz"}
    }
    assert len(tables) == 16
    assert {name for name in tables if Path(name).name not in notice} == set()
    assert "designs developed\n  by Cynthia Brewer (http://colorbrewer.org/)" in notice


def test_licences_of_others_go_with_the_wheel() -> None:
    licences = {path.as_posix() for path in map(Path, _METADATA.license_files)}
    wanted = {
        name
        for name in _there("src")
        if Path(name).suffix == ".txt" and ("LICENSE" in name or "NOTICE" in name)
    }
    assert licences == {"LICENSE", "NOTICE"} | wanted
    assert len(wanted) == 5
    names = ("Apache-2.0", "MIT", "OFL-1.1", "OGL-UK-3.0", "LicenseRef-ColorBrewer")
    assert set(names) == set(str(_METADATA.license_expression).split(" AND "))


def test_what_developers_need_is_no_extra() -> None:
    assert not {"test", "lint", "docs", "dev", "clients"} & set(
        _METADATA.optional_dependencies
    )


def test_constraints_have_a_version_for_each_package_and_no_address() -> None:
    text = (ROOT / "constraints.txt").read_text()
    versions: dict[str, list[str]] = {}
    for line in text.splitlines():
        name, _, version = line.partition(" ;")[0].partition("==")
        versions.setdefault(name, []).append(version)
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]
    stated = [
        *_METADATA.dependencies,
        *(text for extra in _METADATA.optional_dependencies.values() for text in extra),
        *(text for group in groups.values() for text in group if isinstance(text, str)),
    ]
    for requirement in map(Requirement, stated):
        if requirement.name != "amulor":
            name = canonicalize_name(requirement.name)
            assert all(requirement.specifier.contains(v) for v in versions[name]), name
    assert "://" not in text
