"""A scan of 100 x 40 pixels over TCP: its rate, and its cube when it is interrupted."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from shared_light import scene_light

from amulor import acquisition, io
from amulor.acquisition import plan
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.settings import Settings
from amulor.cli import main
from amulor.simulation import simulate
from amulor.survey import Survey

RUN = [sys.executable, "-m", "amulor"]


@contextmanager
def served(survey: Path, devices: Path) -> Iterator[None]:
    """Serve simulated devices in a program of their own."""
    words = ["devices", "simulate", str(survey), "-o", str(devices), "--speed", "1000"]
    serving = subprocess.Popen([*RUN, *words], stdout=subprocess.PIPE)
    try:
        assert serving.stdout is not None
        for _ in range(3):
            serving.stdout.readline()
        yield
    finally:
        serving.send_signal(signal.SIGTERM)
        serving.communicate(timeout=120)


@pytest.mark.study
def test_a_full_scan_over_the_network_is_fast_and_survives_interruptions(
    sized, folder, terminal, ranges, monkeypatch
) -> None:
    monkeypatch.chdir(folder)
    Path("tank.toml").write_text(sized(columns=100, rows=40).to_toml())
    survey = Survey.from_toml("tank.toml")
    with served(Path("tank.toml"), Path("devices.toml")):
        settings = Settings.from_toml("devices.toml")
        rates, fastest = [], []
        for number in range(3):
            times = [time.monotonic()]
            outcome = acquisition.acquire(
                survey, folder / str(number), settings=settings,
                acknowledged=lambda _, times=times: times.append(time.monotonic()),
                scene=scene_light,
            )  # fmt: skip
            rates.append(outcome.done / (time.monotonic() - times[0]))
            fastest.append(1000 / np.subtract(times[1000:], times[:-1000]).min())
        shown = interrupted(folder, terminal)
        assert main(["acquire", "broken/survey.toml", "-o", "broken", "--resume"]) == 0
    print("samples per second, the whole scan:", [round(rate) for rate in rates])
    print("the fastest thousand on end:", [round(rate) for rate in fastest])
    print("shown on the terminal while going on:", shown)
    # Samples: 4000 pixels in each of two polarizations, and the references.
    assert outcome.done == 8000 + 2 * (15 * 2 + 10)
    # Others may use the processors for a while; a thousand on end are no accident.
    assert max(fastest) > 1000
    planned = {step.key for step in plan.steps(survey, settings.procedure)}
    extra = {
        step.key
        for number in range(2)
        for step in plan.extra_reference(survey, settings.procedure, number=number)
    }
    assert keys(folder / "0") == planned
    assert keys(folder / "broken") == planned | extra
    whole = io.read_cube(acquisition.recover(folder / "0"))
    broken = io.read_cube(folder / "broken" / "cube.nc")
    segments = json.loads(broken.attrs["segments"])
    assert [part["reason"] for part in segments] == ["paused", "paused", "finished"]
    assert {*broken["user_segment"].values.ravel()} == {1, 2, 3}
    ideal = simulate(survey, rng=1)
    pulls = np.stack(
        [pull(whole, broken, ideal, name) for name in ("in_phase", "quadrature")]
    )
    print(
        f"pulls: mean {pulls.mean():+.4f}, deviation {pulls.std():.4f}, the largest "
        f"{np.abs(pulls).max():.2f} of {pulls.size}"
    )
    assert pulls.size == sum(key.kind == SCAN for key in planned) * 2
    # 16 000 pulls: five times 0.008 for the mean, five times 0.006 for the deviation,
    # which is 0.993 since five time constants let 1 - exp(-5) of a change through.
    assert abs(pulls.mean()) < 0.04
    assert 0.96 < pulls.std() < 1.03
    # Beyond 5.5 is one of 16 000 normal values in 1600 such tests.
    assert np.abs(pulls).max() < 5.5
    truth = ideal["truth_slant_range"].values
    for cube in (whole, broken):
        assert abs((ranges(cube) - truth).mean()) < 2e-3


def keys(folder: Path) -> set[plan.Key]:
    """Return the keys of a journal, none of them there twice."""
    with Journal.read(folder) as journal:
        found = journal.keys()
        assert journal.count() == len(found)
    return found


def pull(
    first: xr.Dataset, second: xr.Dataset, ideal: xr.Dataset, name: str
) -> np.ndarray:
    """Return the difference of two cubes over what it may be by chance."""
    # Beside the stated error, the water fluctuates by 5 % of its signal.
    variance = (
        first[f"{name}_uncertainty"].values ** 2
        + second[f"{name}_uncertainty"].values ** 2
        + 2 * (0.05 * ideal[f"truth_water_{name}"].values) ** 2
    )
    return (first[name].values - second[name].values) / np.sqrt(variance)


def interrupted(folder: Path, terminal) -> list[int]:
    """Scan on a terminal, press Ctrl-C and go on, press it again and end.

    Returns the rates that were shown.
    """
    place = folder / "broken"
    words = ["acquire", "tank.toml", "-o", "broken", "--devices", "devices.toml"]
    running = subprocess.Popen(
        [*RUN, *words], stdin=terminal.near, stdout=terminal.near,
        stderr=terminal.near, start_new_session=True,
    )  # fmt: skip
    terminal.begun()

    def has(samples: int) -> Callable[[], bool]:
        def reached() -> bool:
            if not (place / FILE_NAME).exists():
                return False
            with Journal.read(place) as journal:
                return journal.count() >= samples

        return reached

    try:
        for samples, answer in ((2500, b"y\n"), (5500, b"n\n")):
            terminal.read_until(has(samples))
            running.send_signal(signal.SIGINT)
            terminal.wait_for(b"Go on with the scan? [Y/n]")
            terminal.type(answer)
        terminal.wait_for(b"--resume")
        assert running.wait(timeout=240) == 130
    finally:
        running.kill()
        running.wait()
    found = [int(rate) for rate in re.findall(rb", (\d+)/s, ", terminal.text)]
    return found[:: max(1, len(found) // 8)]
