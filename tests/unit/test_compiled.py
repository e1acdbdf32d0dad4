"""Compiled code on disk is never that of other sources, for all who run the package."""

from __future__ import annotations

import ast
import ctypes
import importlib
import os
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

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


def _called_without_a_home(folder: Path, above: Path) -> tuple[list[float], str]:
    """Return what `called` does, and messages, where only one folder can be written."""
    folder.chmod(0o555)
    done = subprocess.run(
        [sys.executable, "-c", CALL],
        cwd=folder.parent,
        env={
            **{key: os.environ[key] for key in ("PATH",) if key in os.environ},
            "HOME": str(folder),
            "TMPDIR": str(above),
            "PYTHONDONTWRITEBYTECODE": "1",
        },
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=_without_rights_of_root,
    )
    return [float(number) for number in done.stdout.split()], done.stderr


def _without_rights_of_root() -> None:
    """Let root write only where modes of folders allow it: drop CAP_DAC_OVERRIDE."""
    if os.getuid() == 0 and ctypes.CDLL(None).prctl(24, 1, 0, 0, 0) != 0:
        raise OSError("the capability cannot be dropped")


@pytest.mark.slow
def test_loops_are_stored_in_a_temporary_folder_where_nothing_else_can_be_written(
    loops: Path, tmp_path: Path
) -> None:
    above = tmp_path / "temporary"
    above.mkdir()
    result, message = _called_without_a_home(loops, above)
    assert result == [8.0, 2.0, 0, 0]
    stored = above / f"amulor-compiled-{os.getuid()}"
    assert message.count("\n") == 1
    assert f"compiled code is kept in {stored}" in message
    assert stat.S_IMODE(stored.stat().st_mode) == 0o700
    assert _called_without_a_home(loops, above) == ([8.0, 2.0, 1, 1], "")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["open", "link", "file"])
def test_compiled_code_is_not_taken_from_a_place_where_others_can_write(
    loops: Path, tmp_path: Path, kind: str
) -> None:
    above = tmp_path / "temporary"
    above.mkdir()
    _called_without_a_home(loops, above)  # code that could be loaded
    stored = above / f"amulor-compiled-{os.getuid()}"
    if kind == "open":
        stored.chmod(0o777)
    else:
        stored.rename(tmp_path / "elsewhere")
        if kind == "link":
            stored.symlink_to(tmp_path / "elsewhere")
        else:
            stored.touch()
    result, message = _called_without_a_home(loops, above)
    assert result == [8.0, 2.0, 0, 0]
    assert "each command compiles anew" in message
    assert message.count("\n") == 1
    assert [path.name for path in above.iterdir()] == [stored.name]


def test_a_folder_of_another_user_or_below_an_open_one_is_not_trusted(
    tmp_path: Path,
) -> None:
    user, stored = os.getuid(), tmp_path / "above" / "stored"
    stored.mkdir(parents=True, mode=0o700)
    assert _compiled._only_written_by(user, stored)
    assert not _compiled._only_written_by(user + 1, stored)
    stored.parent.chmod(0o777)  # whoever can write there can put another in its place
    assert not _compiled._only_written_by(user, stored)
    stored.parent.chmod(0o1777)
    assert _compiled._only_written_by(user, stored)


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


def _module_file(module: str, package: Path) -> Path | None:
    place = package.parent.joinpath(*module.split("."))
    found = (place.with_suffix(".py"), place / "__init__.py")
    return next((path for path in found if path.is_file()), None)


def _defined_in(module: str, name: str, package: Path) -> Path | None:
    """Return the file a name comes from, through packages that import it lazily."""
    file = _module_file(f"{module}.{name}", package)
    if file is not None:
        return file
    file = _module_file(module, package)
    if file is None or file.name != "__init__.py":
        return file
    # What a package imports for types is what it imports when it is asked for.
    for origin, original, bound in _imports(file, package, anywhere=True):
        if bound == name and (origin, original) != (module, name):
            return _defined_in(origin, original, package) if original else file
    return file


def _imports(
    file: Path, package: Path, *, anywhere: bool = False
) -> list[tuple[str, str, str]]:
    """Return module, name in it and name here of all that a file imports."""
    tree = ast.parse(file.read_bytes())
    folder = file.parent.relative_to(package.parent).parts
    found = []
    for node in ast.walk(tree) if anywhere else _run_at_import(tree):
        if isinstance(node, ast.Import):
            found += [(one.name, "", one.asname or one.name) for one in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = folder[: len(folder) + 1 - node.level] if node.level else ()
            origin = ".".join([*above, *([node.module] if node.module else [])])
            found += [(origin, one.name, one.asname or one.name) for one in node.names]
    return [one for one in found if one[0].split(".")[0] == package.name]


def _run_at_import(tree: ast.AST) -> list[ast.AST]:
    """Return statements that run with an import: none in functions or for types."""
    found: list[ast.AST] = []
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        found += [node, *_run_at_import(node)]
    return found


def _behind(file: Path, package: Path) -> set[Path]:
    """Return a file and all of the package whose names it takes, by their syntax."""
    found, waiting = {file}, [file]
    while waiting:
        for module, name, _ in _imports(waiting.pop(), package):
            source = (
                _defined_in(module, name, package)
                if name
                else _module_file(module, package)
            )
            if source is not None and source not in found:
                found.add(source)
                waiting.append(source)
    return found


def _covered(file: Path, package: Path) -> set[Path]:
    """Return the files whose change is a change of the digest of one."""
    _compiled._digests.clear()
    _compiled._read.clear()
    _compiled.digest_of(file, package)
    covered = set(_compiled._read)
    _compiled._digests.clear()
    return covered


def test_all_that_a_file_with_loops_imports_is_part_of_its_digest() -> None:
    files = [Path(str(module.__file__)) for module in _modules()]
    assert len(files) > 20
    missing = {
        file.relative_to(ROOT).as_posix(): sorted(
            path.relative_to(ROOT).as_posix()
            for path in _behind(file, ROOT) - _covered(file, ROOT)
        )
        for file in files
    }
    assert {file: names for file, names in missing.items() if names} == {}
    # The digest does not read relative imports: none may come behind a loop.
    behind = set().union(*(_behind(file, ROOT) for file in files))
    assert not [
        path
        for path in behind
        for node in ast.walk(ast.parse(path.read_bytes()))
        if isinstance(node, ast.ImportFrom) and node.level
    ]


@pytest.mark.parametrize(
    "imported",
    [
        "from shelf import ADDED",
        "from shelf import ADDED as other",
        "from shelf import (\n    ADDED,  # a number\n)",
        "from shelf.inner import ADDED",
        "from shelf.inner import numbers",
        "from shelf.inner import numbers as other",
        "import shelf.inner.numbers",
        "import shelf.inner.numbers as other",
        "from shelf._named import ADDED",
    ],
)
def test_a_number_is_in_the_digest_by_whichever_way_it_is_imported(
    tmp_path: Path, imported: str
) -> None:
    shelf = tmp_path / "shelf"
    lazy = (
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from {} import {}\n"
    )
    texts = {
        "__init__": lazy.format("shelf.inner", "ADDED"),
        "inner/__init__": lazy.format("shelf.inner.numbers", "ADDED"),
        "inner/numbers": "ADDED = 1.0\n",
        "_named": "from shelf import ADDED\n",
        "loop": imported + "\n",
    }
    for name, text in texts.items():
        path = shelf / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    number = shelf / "inner" / "numbers.py"
    assert number in _behind(shelf / "loop.py", shelf)
    digests = []
    for value in ("1.0", "2.0"):
        number.write_text(f"ADDED = {value}\n")
        _compiled._digests.clear()
        _compiled._read.clear()
        digests.append(_compiled.digest_of(shelf / "loop.py", shelf))
    assert digests[0] != digests[1]


def test_no_file_of_the_package_takes_its_loops_from_numba_itself() -> None:
    text = {path: path.read_text("utf-8") for path in ROOT.rglob("*.py")}
    assert [
        path.relative_to(ROOT).as_posix()
        for path, words in text.items()
        if "numba.njit(" in words and "from amulor._compiled import numba" not in words
    ] == []
    assert not [path for path, words in text.items() if "from numba import" in words]


def test_code_of_a_former_source_is_removed(tmp_path: Path) -> None:
    stored = tmp_path / "stored"
    stored.mkdir()
    former = stored / "loop.one-3.0000.py311.nbi"
    others = [
        stored / "loop.two-3.0000.py311.nbi",
        stored / "loop.one-3.1111.py311.nbc",
    ]
    for path in (former, *others):
        path.touch()

    class Place:
        def ensure_cache_path(self) -> None:
            """Make the folder, as numba does."""

        def get_cache_path(self) -> str:
            return str(stored)

    place = _compiled._fresh(Place, tmp_path)()
    place.ensure_cache_path()
    assert former.exists()
    place._function, place._digest = "loop.one-", "1111"
    place.ensure_cache_path()
    assert not former.exists()
    assert all(path.exists() for path in others)


def test_a_folder_of_its_own_serves_where_others_can_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(_compiled.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(_compiled, "_only_written_by", lambda *_: False)
    place = _compiled._temporary_folder.__wrapped__()
    assert place.is_dir()
    assert place.parent == tmp_path
    assert place.name != f"amulor-compiled-{os.getuid()}"
    assert "others can write in" in caplog.text
    monkeypatch.setattr(_compiled, "_only_written_by", lambda *_: True)
    kept = _compiled._temporary_folder.__wrapped__()
    assert kept == tmp_path / f"amulor-compiled-{os.getuid()}"
    assert stat.S_IMODE(kept.stat().st_mode) == 0o700


def test_a_temporary_folder_is_told_of_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(_compiled.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(_compiled, "_only_written_by", lambda *_: True)
    found = [_compiled._temporary_folder.__wrapped__() for _ in range(2)]
    assert found[0] == found[1]
    (said,) = caplog.messages
    assert f"compiled code is kept in {found[0]} until that is emptied" in said
    # One that ends with the process is told of each time.
    monkeypatch.setattr(_compiled, "_only_written_by", lambda *_: False)
    for _ in range(2):
        _compiled._temporary_folder.__wrapped__()
    assert [text for text in caplog.messages if "each command compiles anew" in text]
    assert len(caplog.messages) == 3


@pytest.mark.parametrize(
    ("kind", "owner", "mode", "above_owner", "above_mode", "is_safe"),
    [
        (stat.S_IFDIR, 7, 0o700, 0, 0o755, True),
        (stat.S_IFDIR, 7, 0o700, 7, 0o755, True),
        (stat.S_IFDIR, 7, 0o700, 0, 0o1777, True),
        # A link, another owner, a mode for others, and places that others can change.
        (stat.S_IFLNK, 7, 0o700, 0, 0o755, False),
        (stat.S_IFDIR, 8, 0o700, 0, 0o755, False),
        (stat.S_IFDIR, 0, 0o700, 0, 0o755, False),
        (stat.S_IFDIR, 7, 0o701, 0, 0o755, False),
        (stat.S_IFDIR, 7, 0o600, 0, 0o755, False),
        (stat.S_IFDIR, 7, 0o700, 1, 0o755, False),
        (stat.S_IFDIR, 7, 0o700, 8, 0o755, False),
        (stat.S_IFDIR, 7, 0o700, 0, 0o775, False),
        (stat.S_IFDIR, 7, 0o700, 0, 0o757, False),
        (stat.S_IFDIR, 7, 0o700, 8, 0o1755, False),
    ],
)
def test_a_folder_is_safe_if_none_but_its_user_and_root_can_change_it(
    kind: int, owner: int, mode: int, above_owner: int, above_mode: int, is_safe: bool
) -> None:
    def place(user: int, flags: int) -> Any:
        return lambda: SimpleNamespace(st_uid=user, st_mode=flags)

    above = SimpleNamespace(stat=place(above_owner, stat.S_IFDIR | above_mode))
    folder: Any = SimpleNamespace(lstat=place(owner, kind | mode), parent=above)
    assert _compiled._only_written_by(7, folder) is is_safe


def test_compiling_tells_how_many_loops_are_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said: list[str] = []
    monkeypatch.setattr(_compiled._progress, "aside", said.append)
    compiled: dict[str, list[int]] = {"outer": [], "inner": []}
    loops = [SimpleNamespace(overloads=overloads) for overloads in compiled.values()]
    monkeypatch.setattr(_compiled, "loops_behind", lambda loop: loops)
    listener = _compiled._Compiling()
    event = SimpleNamespace(data={"dispatcher": loops[0]})
    listener.on_start(event)
    listener.on_start(event)
    listener.on_end(event)
    assert len(said) == 2
    compiled["inner"].append(1)
    listener.on_start(event)
    listener.on_end(event)
    listener.on_end(event)
    words = "compiling for this computer, once: "
    assert said == [f"{words}{n} left" for n in ("2 loops", "2 loops", "1 loop")] + [""]
    # Another signature of loops that have one.
    compiled["outer"].append(1)
    listener.on_start(event)
    assert said[-1] == f"{words}1 loop left"


def test_loops_behind_a_loop_are_those_that_it_calls() -> None:
    names: dict[str, Any] = {"numba": _compiled.numba}
    text = """
@numba.njit
def first(x):
    return x

@numba.njit
def second(x):
    return first(x) + abs(x)

@numba.njit
def third(x):
    return second(x) + first(x)
"""
    exec(text, names)
    found = _compiled.loops_behind(names["third"])
    assert [loop.py_func.__name__ for loop in found] == ["third", "second", "first"]
    assert _compiled.loops_behind(names["first"]) == [names["first"]]
