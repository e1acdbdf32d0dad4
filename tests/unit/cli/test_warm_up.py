"""Compiling: who waits is told once, and `amulor warm-up` leaves no command waiting."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from amulor._compiled import loops_behind
from amulor.cli._output import _Log
from amulor.optics.small_angle import _kernels as _many_kernels
from amulor.studies import ladder

#: Loops that no command calls.
LEFT_OUT = {
    "amulor.transport._kernels.slab": {
        "way_out", "meridian", "cross_layers", "add_exit", "add_discs", "fill_block",
        "product", "add_directions", "follow_depth", "follow_photon",
        "follow_photons", "run_slab",
    },
    "amulor.transport._kernels.interfaces": {
        "fresnel", "passed", "next_level", "in_plane", "apply_element",
        "cross_interface",
    },
    "amulor.transport._kernels.sampling": {"fill_uniform"},
    "amulor.optics.small_angle._kernels": {"spread"},
}  # fmt: skip
LOOPS = """
import importlib
from pathlib import Path
import amulor
from amulor._compiled import Dispatcher, loops_behind
from amulor.cli import main

assert main(["warm-up"]) == 0
root = Path(amulor.__file__).parent
names = [
    ".".join(("amulor", *path.relative_to(root).with_suffix("").parts))
    for path in root.rglob("*.py")
    if path.parent.name == "_kernels" or "_compiled import numba" in path.read_text()
]
names = [name.removesuffix(".__init__") for name in names if "_compiled" not in name]
every = {
    loop
    for name in names
    for loop in vars(importlib.import_module(name)).values()
    if isinstance(loop, Dispatcher)
}
ready = {each for loop in every if loop.overloads for each in loops_behind(loop)}
print(len(every))
for loop in every - ready:
    print(loop.py_func.__module__, loop.py_func.__name__)
"""


def _run(folder: Path, stored: Path) -> tuple[str, str]:
    """Return what a small command prints whose compiled loops are in a folder."""
    (folder / "ladder.toml").write_text(ladder.survey_text("milk"), "utf-8")
    words = ["backscatter", "ladder.toml", "--model", "diffusion"]
    done = subprocess.run(
        [sys.executable, "-m", "amulor", *words, "--frequency", "20MHz"],
        cwd=folder,
        env={**os.environ, "NUMBA_CACHE_DIR": str(stored)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout, done.stderr


@pytest.mark.slow
def test_compiling_is_said_once_and_not_when_it_was_done_before(tmp_path: Path) -> None:
    first, message = _run(tmp_path, tmp_path / "stored")
    said = [line for line in message.splitlines() if "compiling" in line]
    assert len(said) == 1
    assert "compiling for this computer, once: " in said[0]
    assert said[0].split(": ")[-1].split(" ", 1)[1] in ("loops left", "loop left")
    second, message = _run(tmp_path, tmp_path / "stored")
    assert "compiling" not in message
    assert second == first


@pytest.mark.slow
def test_warming_up_compiles_all_loops_that_commands_call() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOOPS], capture_output=True, text=True, check=True
    )
    ready, every, *missing = done.stdout.splitlines()
    found: dict[str, set[str]] = {}
    for line in missing:
        module, name = line.split()
        found.setdefault(module, set()).add(name)
    assert found == LEFT_OUT
    count = int(every) - len(missing)
    assert ready.startswith(f"{count} compiled loops are ready in {os.sep}")


def test_the_loops_behind_one_are_those_that_it_calls_however_deep() -> None:
    names = {loop.py_func.__name__ for loop in loops_behind(_many_kernels.add_columns)}
    panels = {"add_panel", "expand", "_add_slow", "_add_fast", "_turns", "sine_cosine"}
    assert names == {"add_columns", "separation", "_shortened", "polynomial", *panels}


def test_a_log_says_at_once_that_it_compiles_and_then_each_half_minute() -> None:
    now = [0.0]
    log = _Log(lambda: now[0])
    lines = []
    for tenth in range(400):
        now[0] = tenth / 10
        if now[0] < 35:
            left = 200 - tenth // 2
            log.advance(f"compiling for this computer, once: {left} loops left", 0.1)
        else:
            log.advance("errors", 0.9)
        line = log.line()
        if line:
            lines.append(line)
    assert lines == [
        "amulor: 0 s, 10% done, compiling for this computer, once: 200 loops left",
        "amulor: 30 s, 10% done, compiling for this computer, once: 50 loops left",
        "amulor: 35 s, 90% done, errors",
    ]
