"""`amulor reproduce` in a pipe: a line for each step, and an end at Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


def _started(folder: Path, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "amulor", "reproduce", "ricci2010", *words]
    return subprocess.Popen(
        [*command, "--output", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def _children(process: int) -> list[int]:
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            status = (folder / "stat").read_text()
        except OSError:
            continue
        # Number, name in brackets, state, parent.
        if int(status.rpartition(")")[2].split()[1]) == process:
            found.append(int(folder.name))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc")
@pytest.mark.parametrize(
    "word", ["figure 1", pytest.param("varied", marks=pytest.mark.study)]
)
def test_ctrl_c_ends_the_command_and_its_workers(tmp_path: Path, word: str) -> None:
    with _started(tmp_path / "out", "--figure", "1") as process:
        try:
            assert process.stderr is not None
            while word not in process.stderr.readline():
                assert process.poll() is None
            workers = _children(process.pid)
            assert workers or word == "figure 1"
            begun = time.monotonic()
            # To the command alone: its workers must hear of it from there.
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=60) == 130
            # It ends by itself; a busy machine needs a while.
            assert time.monotonic() - begun < 30
            assert process.stderr.read().endswith("amulor: interrupted\n")
        finally:
            process.kill()
    time.sleep(0.5)
    assert [worker for worker in workers if _running(worker)] == []
    assert list((tmp_path / "out").iterdir()) == []


def _running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{process}/stat").read_text()
    return stat.rpartition(")")[2].split()[0] != "Z"
