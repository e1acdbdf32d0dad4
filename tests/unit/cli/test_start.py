"""A mistyped file name is told before anything slow is imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

#: Each of these takes a fifth of a second or more to import.
SLOW = ("numba", "scipy.stats", "pandas", "xarray", "matplotlib", "pydantic")
COMMANDS = (
    "info missing.nc",
    "image missing.nc -o image.nc",
    "reject missing.nc --method joint -o target.nc",
    "export missing.nc -o cloud.ply",
    "report missing.nc -o report.html",
    "view missing.nc",
    "water fit missing.nc",
    "backscatter missing.toml",
    "survey check missing.toml",
    "simulate missing.toml -o cube.nc",
    "design missing.toml -o survey.toml",
    "site check missing.toml",
)
SAY = f"""
import sys
from amulor.cli import main
for words in {COMMANDS}:
    code = main(words.split())
    print(code, *[name for name in {SLOW} if name in sys.modules])
"""


def test_a_file_that_is_not_there_is_named_at_once(tmp_path: Path) -> None:
    # One process for all: an import by any command stays, and shows from there on.
    done = subprocess.run(
        [sys.executable, "-c", SAY],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == ["1"] * len(COMMANDS)
    messages = done.stderr.splitlines()
    for words, message in zip(COMMANDS, messages, strict=True):
        assert message.startswith("amulor: missing."), words
        assert message.endswith(" does not exist; check the name and the folder")


def test_rejection_and_its_flags_go_without_statistics_and_figures() -> None:
    # scipy.stats takes 0.4 s, and scipy.special has the few functions that are needed;
    # matplotlib takes 0.3 s, and `info`, `reject` and `image` explain flags without it.
    say = (
        "import sys, amulor.rejection.compare, amulor.view.explanations;"
        "print(*({'scipy.stats', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", say], capture_output=True, text=True, check=True
    )
    assert done.stdout == "\n"


@pytest.mark.skipif(sys.platform == "win32", reason="permissions of another kind")
@pytest.mark.parametrize("command", ["", "main(['samples']); "])
def test_a_command_keeps_advice_of_matplotlib_back(command: str) -> None:
    code = f"from amulor.cli import main; {command}import matplotlib; "
    nowhere = dict.fromkeys(("HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME"), "/proc/none")
    kept = {k: v for k, v in os.environ.items() if k != "MPLCONFIGDIR"}
    done = subprocess.run(
        [sys.executable, "-c", f"{code}matplotlib.get_configdir()"],
        env=kept | nowhere,
        capture_output=True,
        text=True,
        check=True,
    )
    assert ("MPLCONFIGDIR" in done.stderr) is not bool(command)


def test_the_end_of_a_command_looks_for_no_garbage() -> None:
    # The interpreter would look through all objects of all packages for a second.
    say = (
        "import atexit, gc; atexit.register(lambda: print(gc.get_freeze_count() > 0));"
        "from amulor.cli import main; main(['samples'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", say], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "True"
