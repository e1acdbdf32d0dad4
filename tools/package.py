"""Build wheel and sdist, and use the wheel as somebody who has nothing else.

Run with ``make package``. The wheel goes into a fresh virtual environment, first
without extras: help, a survey check, a formula, every public name and the demo work
there; the demo says which formats it leaves out.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
#: Tracked files that are of no use without the repository.
_LEFT_OUT = (".ci/", ".github/", ".pre-commit-config.yaml")


def call(*words: object, code: int = 0, folder: Path | None = None) -> str:
    """Run a command, refuse another exit code than this, and return what it printed."""
    print(f"$ {' '.join(map(str, words))}".splitlines()[0][:88], flush=True)
    done = subprocess.run(
        list(map(str, words)),
        cwd=folder,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode != code:
        raise SystemExit(f"{done.stdout}\nexit {done.returncode}, needed is {code}")
    return done.stdout


def tracked() -> set[str]:
    """Return the files of the repository that an sdist must hold."""
    listed = call("git", "ls-files", folder=ROOT).splitlines()
    return {name for name in listed if not name.startswith(_LEFT_OUT)}


def compare(what: str, held: set[str], wanted: set[str]) -> None:
    """Refuse a distribution that lacks a file, or has one that git does not track."""
    for text, names in (("lacks", wanted - held), ("has too much:", held - wanted)):
        if names:
            raise SystemExit(f"the {what} {text} {', '.join(sorted(names))}")
    print(f"{what}: {len(held)} files, as tracked")


def build() -> Path:
    """Build both, compare their files with the repository, and return the wheel."""
    for old in DIST.glob("amulor-*"):
        old.unlink()
    call(sys.executable, "-m", "build", "--outdir", DIST, ROOT)
    (sdist,), (wheel,) = DIST.glob("amulor-*.tar.gz"), DIST.glob("amulor-*.whl")
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    compare("sdist", held - {"PKG-INFO"}, tracked())
    held = {
        name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("amulor/")
    }
    compare(
        "wheel",
        held,
        {name[4:] for name in tracked() if name.startswith("src/amulor/")},
    )
    return wheel


def use(wheel: Path, folder: Path) -> None:
    """Use the wheel without extras."""
    home = folder / "venv"
    venv.create(home, with_pip=True)
    pip = [home / "bin" / "pip", "install", "--quiet", "--disable-pip-version-check"]
    amulor, python = home / "bin" / "amulor", home / "bin" / "python"
    call(*pip, wheel)
    assert "Usage: amulor" in call(amulor, "--help", folder=folder)
    where = "from importlib.resources import files; print(files('amulor.survey'))"
    example = Path(call(python, "-c", where, folder=folder).strip()) / "examples"
    survey = example / "ladder_milk.toml"
    assert "unambiguous" in call(amulor, "survey", "check", survey, folder=folder)
    assert "Cut-off" in call(amulor, "backscatter", survey, folder=folder)
    listing = (ROOT / "tests" / "reference" / "public_surface.txt").read_text()
    reach = "import sys, amulor\nfor name in sys.argv[1:]: eval(name)"
    names = [line.split()[0] for line in listing.splitlines()]
    call(python, "-c", reach, *names, folder=folder)
    said = call(amulor, "demo", "-o", "out", folder=folder)
    assert "No LAZ files: pip install 'amulor[export]'" in said, said
    print(said, end="")
    assert (folder / "out" / "report.html").stat().st_size > 0


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        use(build(), Path(temporary))
