"""Install amulor with the oldest versions that pyproject.toml allows, and test it.

Run with ``make oldest``, or ``python3.11 tools/oldest.py FOLDER [PYTEST ARGUMENTS]``.
The folder gets a virtual environment. Every requirement that pyproject.toml states is
held at its lower bound; what these need in turn is the newest that goes with them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Old packages warn of what newer ones, which they were not made for, leave behind.
QUIET = [
    "-Wignore::DeprecationWarning",
    "-Wignore::PendingDeprecationWarning",
    "-Wignore::FutureWarning",
    "-Wignore:numpy.ndarray size changed:RuntimeWarning",
    "-Wignore:Converting non-nanosecond precision datetime:UserWarning",
]
#: Programs of a developer, which no test imports.
_PROGRAMS = ("ruff", "mypy", "import-linter", "pre-commit", "build")


def requirements() -> list[str]:
    """Return every requirement that names a package beside amulor and programs."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    del extras["docs"]  # no test builds the site
    del extras["zi"]  # no test reaches the package: it speaks to real instruments only
    stated = [
        *project["dependencies"],
        *(one for each in extras.values() for one in each),
    ]
    return sorted(
        {one for one in stated if not one.startswith(("amulor[", *_PROGRAMS))}
    )


def lower_bound(requirement: str) -> str:
    """Return the requirement at its lower bound: "numpy>=1.26,<3" is "numpy==1.26"."""
    marker = requirement.partition(";")
    name, bound, rest = marker[0].partition(">=")
    if not bound:
        raise ValueError(f"{requirement!r} in pyproject.toml needs a lower bound, >=")
    version = rest.split(",")[0].strip()
    return f"{name.strip()}=={version}{marker[1]}{marker[2]}"


def main() -> int:
    """Install, then run the tests with the arguments given; return their exit code."""
    if sys.version_info[:2] != (3, 11):
        print("tools/oldest.py: the bounds are those of Python 3.11; call it with that")
        return 2
    folder = Path(sys.argv[1]).resolve()
    python = folder / "bin" / "python"
    wanted = "\n".join(map(lower_bound, requirements())) + "\n"
    held = folder / "oldest.txt"
    if not held.exists() or held.read_text() != wanted:
        venv.create(folder, with_pip=True, clear=True)
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        # In one go, so that what the oldest versions need in turn goes with all.
        subprocess.run([*pip, *wanted.split("\n")[:-1]], check=True)
        subprocess.run([*pip, "--no-deps", "--editable", ROOT], check=True)
        held.write_text(wanted)
    print(wanted, end="", flush=True)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "numba")}
    words = [python, "-m", "pytest", *QUIET, *sys.argv[2:]]
    return subprocess.run(words, cwd=ROOT, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
