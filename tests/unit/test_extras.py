import re
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from amulor import _extras
from amulor.cli import main
from amulor.errors import MissingExtraError
from amulor.studies import ladder

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


@pytest.fixture
def bare(monkeypatch):
    """Take the packages of all extras away, as a base install would."""
    away = {name for modules in _extras.MODULES.values() for name in modules.values()}
    monkeypatch.setattr(
        _extras, "find_spec", lambda name: None if name in away else find_spec(name)
    )


def test_the_packages_are_those_that_pyproject_installs():
    stated = tomllib.loads(PROJECT.read_text())["project"]["optional-dependencies"]
    for extra, modules in _extras.MODULES.items():
        packages = {re.split(r"[<>=]", text)[0] for text in stated[extra]}
        assert packages == set(modules)


def test_what_is_installed_is_not_asked_for():
    _extras.require(*_extras.MODULES, purpose="the tests")


def test_all_that_is_missing_is_named_with_one_line_that_installs_it(bare):
    with pytest.raises(MissingExtraError) as caught:
        _extras.require("scene", "mie", purpose="drawing")
    assert str(caught.value).startswith("drawing needs trimesh, miepython")
    assert "pip install 'amulor[scene,mie]'" in str(caught.value)


def test_only_what_is_missing_is_named(monkeypatch):
    monkeypatch.setattr(
        _extras, "find_spec", lambda name: None if name == "lazrs" else find_spec(name)
    )
    with pytest.raises(MissingExtraError, match=r"laspy.lazrs.,.*'amulor.export.'"):
        _extras.require("scene", "export", purpose="the demo")


def test_only_a_page_that_is_served_needs_a_server(bare, capsys):
    assert main(["view", "none.nc"]) == 1
    assert "the page needs" in capsys.readouterr().err
    assert main(["view", "none.nc", "--save", "page.html"]) == 1
    assert "none.nc does not exist" in capsys.readouterr().err


def test_the_demo_writes_what_it_can_and_says_what_it_leaves_out(
    bare, tmp_path, monkeypatch, capsys
):
    bare_names = {Path(name).suffix for name in ladder.output_names()}
    assert ".ply" in bare_names
    with monkeypatch.context() as whole:
        whole.setattr(_extras, "find_spec", find_spec)
        assert ladder.left_out() == {}
        names = {Path(name).suffix for name in ladder.output_names()}
    assert names - bare_names == {".laz", ".e57"}
    monkeypatch.setattr(ladder, "run", lambda *_, **__: [])
    assert main(["demo", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "No LAZ files: pip install 'amulor[export]'" in said
    assert "No E57 files: pip install 'amulor[" in said


def test_a_page_is_saved_without_the_packages_of_the_server(bare, tmp_path, capsys):
    cloud, out = tmp_path / "cloud.xyz", tmp_path / "page.html"
    cloud.write_text("0 0 1\n0.1 0 1\n0 0.1 1\n")
    assert main(["view", str(cloud)]) == 1
    assert "amulor[view]" in capsys.readouterr().err
    assert main(["view", str(cloud), "--save", str(out)]) == 0
    assert "<html" in out.read_text()


@pytest.mark.parametrize(
    ("words", "extras"),
    [
        ("reproduce ricci2010 --quick -o out", "mie"),
        ("reproduce ricci2010 --quick --figure 11 -o out", "mie"),
    ],
)
def test_a_command_says_so_before_it_makes_a_folder(
    bare, words, extras, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 1
    message = capsys.readouterr().err
    assert f"pip install 'amulor[{extras}]'" in message
    assert message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
