import subprocess
import sys

import pytest

from amulor import _lazy

PACKAGE = """
from amulor import _lazy

__all__ = ["inner", "ten", "there"]
there = 3
__getattr__, __dir__ = _lazy.attach(
    __name__, __all__, origin={"ten": "lazy_example.numbers"}
)
"""


@pytest.fixture
def lazy_example(tmp_path, monkeypatch):
    folder = tmp_path / "lazy_example"
    folder.mkdir()
    (folder / "__init__.py").write_text(PACKAGE)
    (folder / "inner.py").write_text("word = 'inside'\n")
    (folder / "numbers.py").write_text("ten = 10\n")
    monkeypatch.syspath_prepend(tmp_path)
    import lazy_example

    yield lazy_example
    for name in [name for name in sys.modules if name.startswith("lazy_example")]:
        del sys.modules[name]


def test_modules_and_names_come_when_they_are_used(lazy_example):
    assert "lazy_example.inner" not in sys.modules
    assert lazy_example.inner.word == "inside"
    assert "lazy_example.numbers" not in sys.modules
    assert lazy_example.ten == 10
    assert vars(lazy_example)["ten"] == 10  # the second use asks nobody
    assert lazy_example.there == 3


def test_only_public_names_are_shown_and_reached(lazy_example):
    shown = [name for name in dir(lazy_example) if not name.startswith("__")]
    assert shown == ["inner", "ten", "there"]
    assert {"__name__", "__all__", "__getattr__"} <= set(dir(lazy_example))
    with pytest.raises(AttributeError, match="'lazy_example' has no attribute 'numb"):
        lazy_example.numbers  # noqa: B018


def test_a_name_that_its_module_would_hide_is_refused():
    with pytest.raises(ValueError, match="would hide it"):
        _lazy.attach("lazy_example", ["ten"], origin={"ten": "lazy_example.ten"})


def test_an_origin_of_a_name_that_is_not_public_is_refused():
    with pytest.raises(ValueError, match="not in __all__"):
        _lazy.attach("lazy_example", [], origin={"ten": "lazy_example.numbers"})


def test_import_amulor_imports_no_package_beside_itself():
    text = "import sys, amulor; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=True
    ).stdout.split()
    # Editable installs load a finder of their own, and site loads .pth files.
    assert {"numpy", "scipy", "xarray", "pydantic", "numba"}.isdisjoint(loaded)
    assert [name for name in loaded if name.startswith("amulor.")] == ["amulor._lazy"]
