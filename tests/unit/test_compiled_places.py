"""Folders and names of compiled code, without compiling."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from amulor import _compiled


class Place:
    """Stand-in for numba's place of compiled code beside the source."""

    located: Any = True

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        return cls() if cls.located else None

    def get_disambiguator(self) -> str:
        return "of numba"


class UserWide(Place):
    """Stand-in for numba's place in the folder of the user."""

    def __init__(self, py_func: Any = None, py_file: str = "") -> None:
        self._cache_path = "of the user"
        self.source = py_file

    def get_suitable_cache_subpath(self, py_file: str) -> str:
        return f"folder of {Path(py_file).name}"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a package whose loop is compiled from two files."""
    folder = tmp_path / "loops"
    (folder / "inner").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "inner" / "__init__.py").write_text("")
    (folder / "outer.py").write_text("from loops.inner.numbers import ONE\n")
    (folder / "inner" / "numbers.py").write_text("ONE = 1\n")
    (folder / "alone.py").write_text("import numba\n")
    _compiled._file.cache_clear()
    return folder


def test_the_name_of_stored_code_has_a_digest_of_all_of_its_sources(
    package: Path,
) -> None:
    fresh = _compiled._fresh(Place, package)
    function = SimpleNamespace(__qualname__="outer.<locals>.loop")
    found = fresh.from_function(function, str(package / "outer.py"))
    digest = hashlib.sha256()
    for name, text in (
        ("inner/numbers.py", "ONE = 1\n"),
        ("outer.py", "from loops.inner.numbers import ONE\n"),
    ):
        digest.update(name.encode() + b"\0" + hashlib.sha256(text.encode()).digest())
    expected = digest.hexdigest()[:16]
    assert found.get_disambiguator() == f"of numba.{expected}"
    assert found._function == "outer.outer.locals.loop-"


def test_code_of_other_packages_and_of_no_file_is_left_to_numba(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = _compiled._fresh(Place, package)
    function = SimpleNamespace(__qualname__="loop")
    elsewhere = tmp_path / "elsewhere.py"
    elsewhere.touch()
    assert fresh.from_function(function, str(elsewhere)) is None
    assert fresh.from_function(function, str(package / "typed.py")) is None
    assert fresh.from_function(function, str(package / "alone.py")) is not None
    monkeypatch.setattr(Place, "located", False)
    assert fresh.from_function(function, str(package / "alone.py")) is None


@pytest.mark.parametrize("name", ["CacheImpl", "_CacheImpl"])
def test_fresh_places_come_first_and_a_temporary_one_last_of_them(
    package: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    cache = SimpleNamespace(_locator_classes=[Place, UserWide])
    stand_in = SimpleNamespace(**{name: cache})
    monkeypatch.setattr(_compiled, "caching", stand_in)
    _compiled.keep_fresh(package)
    places = cache._locator_classes
    assert [place.__name__ for place in places] == [
        "Fresh", "Fresh", "Fresh", "Place", "UserWide",
    ]  # fmt: skip
    bases = [place.__mro__[1].__name__ for place in places[:3]]
    assert bases == ["Place", "UserWide", "LastResort"]
    monkeypatch.setattr(_compiled, "_temporary_folder", lambda: Path("/temporary"))
    last = places[2].__mro__[1](None, "/a/b/loop.py")
    assert last.source == "/a/b/loop.py"
    assert last._cache_path == str(Path("/temporary") / "folder of loop.py")


def test_numba_has_the_places_and_the_listener_of_the_package() -> None:
    cache: Any = _compiled.caching
    cache = getattr(cache, "CacheImpl", None) or cache._CacheImpl
    assert cache._locator_classes[0].__name__ == "Fresh"
    listeners: Any = _compiled.event._registered["numba:compile"]
    assert [
        listener
        for listener in listeners
        if type(listener).__name__ == _compiled._Compiling.__name__
    ]


def test_a_numba_without_places_stores_as_it_does(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for caching in (
        SimpleNamespace(),
        SimpleNamespace(CacheImpl=SimpleNamespace(_locator_classes=[])),
    ):
        monkeypatch.setattr(_compiled, "caching", caching)
        _compiled.keep_fresh(package)


WHY = "neither the package's folder nor one of the user can be written"
ANEW = (
    ": compiled code is not kept, each command compiles anew; set NUMBA_CACHE_DIR to a "
    "folder that lasts"
)


@pytest.fixture
def above(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def temporary() -> Path:
    return _compiled._temporary_folder.__wrapped__()


def test_a_folder_of_the_user_is_kept_and_told_of(
    above: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(_compiled, "_only_written_by", lambda user, path: True)
    path = above / f"amulor-compiled-{os.getuid()}"
    # Of a folder that is there already, nothing is said.
    for _ in range(2):
        assert temporary() == path
        assert caplog.messages == [
            f"amulor: {WHY}: compiled code is kept in {path} until that is emptied; "
            "set NUMBA_CACHE_DIR to a folder that lasts"
        ]


@pytest.mark.parametrize("fault", ["others", "file", "user"])
def test_otherwise_a_folder_ends_with_the_process(
    above: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    fault: str,
) -> None:
    ended: list[Any] = []
    monkeypatch.setattr(
        _compiled.atexit,
        "register",
        lambda *words, **named: ended.append((words, named)),
    )
    monkeypatch.setattr(
        _compiled, "_only_written_by", lambda user, path: fault != "others"
    )
    path = above / f"amulor-compiled-{os.getuid()}"
    if fault == "file":
        path.touch()
    if fault == "user":
        monkeypatch.delattr(os, "getuid")
    found = temporary()
    assert found.is_dir()
    assert found.parent == above
    assert found != path
    assert ended == [((_compiled.shutil.rmtree, found), {"ignore_errors": True})]
    shared = f", and others can write in {path}" if fault == "others" else ""
    assert caplog.messages == [f"amulor: {WHY}{shared}{ANEW}"]


def test_no_code_is_kept_among_somebodys_data(
    above: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(above)
    monkeypatch.setattr(_compiled, "_only_written_by", lambda user, path: True)
    asked: list[Path] = []
    made = Path.mkdir

    def mkdir(path: Path, **options: Any) -> None:
        asked.append(path)
        made(above / path.name, **options)

    monkeypatch.setattr(Path, "mkdir", mkdir)
    monkeypatch.setattr(os, "access", lambda path, mode: True)
    temporary()
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    temporary()
    assert [path.parent for path in asked] == [Path("/dev/shm"), above]


@pytest.mark.parametrize(
    ("text", "files"),
    [
        ("import loops.alone", ["alone.py"]),
        ("import loops.alone as other, numba", ["alone.py"]),
        ("import numba\nimport os.path", []),
        ("from loops.alone import one", ["alone.py"]),
        ("from loops import alone", ["__init__.py", "alone.py"]),
        ("from loops import (\n    alone,  # one, and\n    outer as o,\n)",
         ["__init__.py", "alone.py", "outer.py"]),
        ("from loops.inner import numbers", ["inner/__init__.py", "inner/numbers.py"]),
        ("from loops.inner.numbers import ONE", ["inner/numbers.py"]),
        ("from loops import name", ["__init__.py"]),
        ("from loops.none import name", []),
        ("import loops.none", []),
        ("def f():\n    import loops.alone", []),
        ("from loopsy import alone", []),
    ],
)  # fmt: skip
def test_files_of_the_package_are_found_by_their_imports(
    package: Path, text: str, files: list[str]
) -> None:
    found = _compiled._imported(text.encode(), package)
    names = sorted(path.relative_to(package).as_posix() for path in found)
    assert names == files


def test_a_name_is_followed_to_the_file_that_defines_it(package: Path) -> None:
    lazy = "if True:\n    from {} import {}\n"
    numbers = package / "inner" / "numbers.py"
    (package / "inner" / "__init__.py").write_text(
        lazy.format("loops.inner.numbers", "ONE as first, ONE")
    )
    (package / "__init__.py").write_text(lazy.format("loops.inner", "first as one"))
    for module, name, file in (
        ("loops", "one", numbers),
        ("loops.inner", "first", numbers),
        ("loops.inner", "ONE", numbers),
        ("loops.inner", "TWO", package / "inner" / "__init__.py"),
        ("loops", "first", package / "__init__.py"),
        ("loops", "inner", package / "inner" / "__init__.py"),
        ("loops", "alone", package / "alone.py"),
        ("loops.alone", "any", package / "alone.py"),
        ("loops.none", "any", None),
    ):
        assert _compiled._defined(module, name, package) == file
    # A package that takes a name from itself defines it.
    (package / "__init__.py").write_text("from loops import one\n")
    assert _compiled._defined("loops", "one", package) == package / "__init__.py"


def test_items_of_an_import_are_split_into_words() -> None:
    text = b"(\n    one,  # the first, or\n    two as other,\n)"
    assert _compiled._names(text) == [["one"], ["two", "as", "other"]]
    assert _compiled._names(b" one , two as x ") == [["one"], ["two", "as", "x"]]
    assert _compiled._names(b"(one,)") == [["one"]]


def test_a_digest_changes_with_the_name_the_text_and_a_new_import(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outer, numbers = package / "outer.py", package / "inner" / "numbers.py"
    first = _compiled.digest_of(outer, package)
    assert len(first) == 16
    # Without a new import the text is that of the first time.
    numbers.write_text("ONE = 2\n")
    assert _compiled.digest_of(outer, package) == first
    for name in ("loops.outer", "loops.inner.numbers"):
        module: Any = SimpleNamespace(__spec__=object())
        monkeypatch.setitem(sys.modules, name, module)
    assert _compiled.digest_of(outer, package) != first
    copy = package / "copy.py"
    copy.write_bytes(outer.read_bytes())
    assert _compiled.digest_of(copy, package) != _compiled.digest_of(outer, package)


def test_the_import_of_a_package_is_that_of_its_folder(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("loops", "loops.inner", "loops.inner.numbers"):
        module: Any = SimpleNamespace(__spec__=f"import of {name}")
        monkeypatch.setitem(sys.modules, name, module)
    for file, name in (
        ("__init__.py", "loops"),
        ("inner/__init__.py", "loops.inner"),
        ("inner/numbers.py", "loops.inner.numbers"),
    ):
        assert _compiled._import_of(package / file, package) == f"import of {name}"
    assert _compiled._import_of(package / "alone.py", package) is None
