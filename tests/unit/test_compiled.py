"""Compiled code on disk is never that of other sources, for all who run the package."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import pytest
from numba.core.dispatcher import Dispatcher

import amulor
from amulor import _compiled

ROOT = Path(amulor.__file__).parent
FILES = {
    "__init__": "from pathlib import Path\nfrom amulor import _compiled\n"
    "_compiled.keep_fresh(Path(__file__).parent)\n",
    "numbers": "ADDED = 1.0\n",
    "inner": "import numba\nfrom loops.numbers import ADDED\n\n\n"
    "@numba.njit(cache=True)\ndef inner(x):\n    return x + ADDED\n",
    "outer": "import numba\nfrom loops import (\n    inner as other,  # one\n"
    ")\n\ninner = other.inner\n\n\n"
    "@numba.njit(cache=True)\ndef outer(x):\n    return 2.0 * inner(x)\n",
    "alone": "import numba\n\n\n@numba.njit(cache=True)\ndef alone(x):\n"
    "    return x - 1.0\n",
}
CALL = (
    "from loops.outer import outer; from loops.alone import alone;"
    "print(outer(3.0), alone(3.0),"
    " sum(outer.stats.cache_hits.values()), sum(alone.stats.cache_hits.values()))"
)


@pytest.fixture
def loops(tmp_path: Path) -> Path:
    """Return a small package, one of whose loops calls one of another file."""
    folder = tmp_path / "loops"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / f"{name}.py").write_text(text)
    return folder


def called(folder: Path, *, stored: Path | str = "") -> list[float]:
    """Return what a new process gets of outer(3) and alone(3), and what was stored."""
    done = subprocess.run(
        [sys.executable, "-c", CALL],
        cwd=folder.parent,
        # Bytecode goes by times and sizes, which `change` leaves as they are.
        env={
            **os.environ,
            "NUMBA_CACHE_DIR": str(stored),
            "PYTHONDONTWRITEBYTECODE": "1",
        },
        capture_output=True,
        text=True,
        check=True,
    )
    return [float(number) for number in done.stdout.split()]


def change(file: Path, old: str, new: str) -> None:
    """Change a source and let it look as old as it was."""
    before = file.stat()
    file.write_text(file.read_text().replace(old, new))
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))


@pytest.mark.slow
def test_a_loop_is_compiled_anew_when_what_it_was_compiled_from_has_changed(
    loops: Path,
) -> None:
    assert called(loops) == [8.0, 2.0, 0, 0]
    assert called(loops) == [8.0, 2.0, 1, 1]
    change(loops / "inner.py", "x + ADDED", "x - ADDED")
    assert called(loops) == [4.0, 2.0, 0, 1]
    # A number of a third file, which holds no loop.
    change(loops / "numbers.py", "1.0", "2.0")
    assert called(loops) == [2.0, 2.0, 0, 1]
    # Of the former sources nothing is left behind.
    stored = sorted(path.name for path in (loops / "__pycache__").glob("*.nb[ic]"))
    assert [name.partition("-")[0] for name in stored] == [
        "alone.alone", "alone.alone", "inner.inner", "inner.inner",
        "outer.outer", "outer.outer",
    ]  # fmt: skip


@pytest.mark.slow
def test_processes_before_and_after_a_change_do_not_take_each_others_code(
    loops: Path, tmp_path: Path
) -> None:
    # Both copies store under the same names: the folder is a digest of their path.
    other = tmp_path / "changed"
    stored = tmp_path / "stored"
    original = loops.rename(tmp_path / "original")
    other.mkdir()
    for file in original.glob("*.py"):
        (other / file.name).write_text(
            file.read_text().replace("ADDED = 1", "ADDED = 5")
        )
    for _ in range(2):
        for source, result in ((original, 8.0), (other, 16.0)):
            now = source.rename(loops)
            with ThreadPoolExecutor(2) as pool:
                got = list(pool.map(lambda _: called(loops, stored=stored), range(2)))
            now.rename(source)
            assert [one[0] for one in got] == [result, result]


@pytest.mark.slow
def test_loops_are_stored_elsewhere_where_their_folder_cannot_be_written(
    loops: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A file in the place of the folder: root could write into one without permission.
    (loops / "__pycache__").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert called(loops) == [8.0, 2.0, 0, 0]
    assert called(loops) == [8.0, 2.0, 1, 1]
    change(loops / "numbers.py", "1.0", "2.0")
    assert called(loops) == [10.0, 2.0, 0, 1]


def test_a_digest_is_of_the_sources_that_were_imported(
    loops: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(loops.parent)
    monkeypatch.setattr(_compiled, "_digests", {})
    numbers = importlib.import_module("loops.numbers")
    try:
        first = _compiled.digest_of(loops / "inner.py", loops)
        # Changed on disk, but what is compiled now comes of what is in memory.
        change(loops / "numbers.py", "1.0", "2.0")
        assert _compiled.digest_of(loops / "inner.py", loops) == first
        _compiled._digests.clear()
        assert _compiled.digest_of(loops / "inner.py", loops) == first
        importlib.reload(numbers)
        _compiled._digests.clear()
        assert _compiled.digest_of(loops / "inner.py", loops) != first
    finally:
        for name in [name for name in sys.modules if name.split(".")[0] == "loops"]:
            del sys.modules[name]


def _modules() -> list[ModuleType]:
    """Return all modules of the package that hold compiled loops."""
    files = [
        path for path in ROOT.rglob("*.py") if "_compiled import" in path.read_text()
    ]
    folders = {path.parent for path in files if path.parent.name == "_kernels"}
    files += [path for folder in folders for path in folder.glob("[!_]*.py")]
    names = {path.relative_to(ROOT.parent).with_suffix("").parts for path in files}
    return [importlib.import_module(".".join(parts)) for parts in sorted(names)]


def test_what_a_loop_of_the_package_calls_is_in_a_file_that_its_digest_covers() -> None:
    loops = 0
    for module in _modules():
        assert module.__file__ is not None
        covered, waiting = set(), [Path(module.__file__)]
        while waiting:
            covered.add(waiting[-1])
            new = _compiled._imported(waiting.pop().read_bytes(), ROOT)
            waiting += [path for path in new if path not in covered]
        for loop in vars(module).values():
            if not isinstance(loop, Dispatcher):
                continue
            loops += 1
            for name in loop.py_func.__code__.co_names:
                callee = loop.py_func.__globals__.get(name)
                if isinstance(callee, Dispatcher):
                    file = Path(callee.py_func.__code__.co_filename)
                    assert file in covered, f"{module.__name__}: {name}"
    assert loops > 100


def test_no_file_of_the_package_takes_its_loops_from_numba_itself() -> None:
    text = {path: path.read_text("utf-8") for path in ROOT.rglob("*.py")}
    assert [
        path.relative_to(ROOT).as_posix()
        for path, words in text.items()
        if "numba.njit(" in words and "from amulor._compiled import numba" not in words
    ] == []
    assert not [path for path, words in text.items() if "from numba import" in words]
