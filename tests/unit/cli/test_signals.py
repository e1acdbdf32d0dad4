"""A program that is told to end leaves nothing half written."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

#: Rows of a scan that takes minutes.
LARGE = ("columns = 12\nrows = 6", "columns = 2000\nrows = 3000")


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no SIGHUP")
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["nohup", pytest.param("SIGHUP", marks=pytest.mark.study)]
)
def test_a_program_that_is_told_to_end_takes_away_what_is_unfinished(
    tmp_path: Path, plate_text: str, name: str
) -> None:
    survey, output = tmp_path / "survey.toml", tmp_path / "samples.nc"
    assert LARGE[0] in plate_text
    survey.write_text(plate_text.replace(*LARGE))
    output.write_text("what was there")
    words = [sys.executable, "-m", "amulor", "simulate", str(survey)]
    with subprocess.Popen(
        [*words, "-o", str(output), "--tile-rows", "20", "--overwrite"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=_no_hang_up if name == "nohup" else None,
    ) as process:  # fmt: skip
        try:
            assert process.stderr is not None
            end = time.monotonic() + 120
            while not list(tmp_path.glob(".amulor-*")):
                assert process.poll() is None
                assert time.monotonic() < end
                time.sleep(0.02)
            if name == "nohup":
                process.send_signal(signal.SIGHUP)
                time.sleep(0.5)
                assert process.poll() is None
            number = signal.SIGHUP if name == "SIGHUP" else signal.SIGTERM
            process.send_signal(number)
            assert process.wait(timeout=120) == 128 + number
            assert process.stderr.read().splitlines()[-1] == (
                f"amulor: ended by {signal.Signals(number).name}"
            )
        finally:
            process.kill()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "samples.nc",
        "survey.toml",
    ]
    assert output.read_text() == "what was there"


def _no_hang_up() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
