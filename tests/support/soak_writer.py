"""Runs a scan in a process of its own, and says which samples are safe and how long.

`python soak_writer.py SURVEY FOLDER ACKNOWLEDGED SPEED KILLED FAULT...`: goes on with
the scan if there is one. Into ACKNOWLEDGED goes a line for each sample: its key and the
seconds since the one before. After KILLED samples the process kills itself somewhere
within the time of a sample; 0 is never.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import threading
import time
from pathlib import Path

from amulor import acquisition
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.plan import Key
from amulor.acquisition.settings import Settings
from amulor.errors import AmulorError
from amulor.simulation import scene_light
from amulor.survey import Survey


def main(
    survey: str, folder: str, acknowledged: str, speed: str, killed: str, *faults: str
) -> int:
    settings = Settings.model_validate(
        {
            "procedure": {"dark_readings": 2},
            "simulation": {"speed": float(speed), "faults": list(faults)},
        }
    )
    before = time.monotonic()
    left = int(killed)
    with open(acknowledged, "a", encoding="utf-8", buffering=1) as file:

        def tell(key: Key) -> None:
            nonlocal before, left
            now = time.monotonic()
            file.write(f"{tuple(key)!r}\t{now - before:.6f}\n")
            left -= 1
            if left == 0:
                moment = random.random() * (now - before)
                end = os.getpid(), signal.SIGKILL
                threading.Timer(moment, os.kill, end).start()
            before = now

        try:
            acquisition.acquire(
                Survey.from_toml(survey),
                Path(folder),
                settings=settings,
                resume=(Path(folder) / FILE_NAME).exists(),
                scene=scene_light,
                acknowledged=tell,
            )
        except AmulorError as error:
            print(f"broken off: {error}", flush=True)
            return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
