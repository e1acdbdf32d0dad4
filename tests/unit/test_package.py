"""Wheel and sdist hold every file that the program reads, and no other."""

from pathlib import Path

from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).parents[2]


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
    }
