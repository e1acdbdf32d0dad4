"""A skip without a listed reason fails the run; a listed one does not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import skips

TESTS = Path(__file__).parents[1]
CASES = """
import pytest, skips
def test_good(): pass
def test_listed(): pytest.skip("this numba has no layer tbb")
def test_browser(): skips.need_browser()
def test_axe(monkeypatch):
    monkeypatch.setattr(skips, "_AXE", skips._AXE / "not there")
    skips.need_axe()
"""
MODULE = "import pytest\npytest.importorskip('no_such_package')\n"


def outcome(folder: Path, text: str, *words: str, **variables: str) -> tuple[int, str]:
    (folder / "test_case.py").write_text(text)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "conftest", "-p", "no:cacheprovider",
         "-n", "0", "-c", TESTS.parent / "pyproject.toml", *words, folder],
        capture_output=True,
        text=True,
        check=False,
        env={
            **{k: v for k, v in os.environ.items() if not k.startswith("PYTEST_XDIST")},
            "PYTHONPATH": f"{TESTS}{os.pathsep}{TESTS / 'support'}",
            "PATH": str(folder),
            **variables,
        },
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("processes", ["0", pytest.param("1", marks=pytest.mark.slow)])
def test_a_missing_browser_fails_the_run_and_is_named(tmp_path, processes) -> None:
    code, text = outcome(tmp_path, CASES, "-n", processes)
    assert code == 1
    assert "1 passed, 3 skipped" in text
    listed = text.partition("skips.py does not list")[2]
    assert "test_case.py::test_browser: there is no browser" in listed
    assert "AMULOR_WITHOUT=browser" in listed
    assert "test_case.py::test_axe: there is no axe-core" in listed
    assert "AMULOR_WITHOUT=npm" in listed
    assert "test_case.py::test_listed" not in listed


def test_a_run_without_a_browser_and_npm_on_purpose_passes(tmp_path) -> None:
    code, text = outcome(tmp_path, CASES, AMULOR_WITHOUT="browser,npm")
    assert code == 0
    assert "1 passed, 3 skipped" in text


def test_a_file_that_is_skipped_as_a_whole_fails_the_run(tmp_path) -> None:
    (tmp_path / "test_other.py").write_text("def test_good(): pass")
    code, text = outcome(tmp_path, MODULE)
    assert code == 1
    assert "could not import 'no_such_package'" in text


@pytest.mark.parametrize("name", skips.BROWSERS)
def test_a_browser_is_found_by_any_of_its_names(tmp_path, monkeypatch, name) -> None:
    program = tmp_path / (f"{name}.exe" if os.name == "nt" else name)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert skips.browser() == str(program)
