"""Signals of a scan over time come as recorded, evenly thinned, with their noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from amulor import acquisition, simulation
from amulor.acquisition.cube.samples import Samples
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import Key
from amulor.acquisition.settings import Procedure
from amulor.errors import CubeError
from amulor.survey import Survey
from amulor.view.page.live import Live
from amulor.view.page.traces import MOST_SAMPLES, Traces

TOKEN = "a-token-for-tests"
KEY = Key("scan", 0, 0, 39e6, "VV", 0)
RECORD = Record(
    in_phase=3e-3,
    quadrature=4e-3,
    mean=0.02,
    readings=1,
    full_scale=1.0,
    flags=0,
    commanded_azimuth=0.0,
    commanded_elevation=0.0,
    azimuth=0.0,
    elevation=0.0,
    modulation_frequency=39e6,
    elapsed=0.0,
    segment=1,
    spread=1e-5,
)


def traces(plate: Survey) -> Traces:
    return Traces(plate, Procedure())


def test_values_are_those_of_the_samples(plate: Survey) -> None:
    shown = traces(plate)
    shown.take(KEY, RECORD)
    dark = replace(RECORD, elapsed=2.0, in_phase=0.0, quadrature=0.0, mean=None)
    shown.take(KEY._replace(kind="dark"), dark)
    found = shown.over_time("VV", 0)
    assert found["kind"] == ["scan", "dark"]
    assert found["elapsed"] == [0.0, 2.0]
    # A triangle with sides of 3, 4 and 5.
    assert found["amplitude"] == pytest.approx([5e-3, 0.0])
    assert found["phase"][0] == pytest.approx(math.atan2(4, 3))
    assert found["noise"] == pytest.approx([1e-5, 1e-5])
    assert found["mean"] == [0.02, None]
    assert shown.over_time("VH", 0)["elapsed"] == []


def test_a_sample_that_arrives_while_the_others_are_read_waits_for_the_next_answer(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = traces(plate)
    shown.take(KEY, RECORD)

    class Growing(Samples):
        def __init__(self, *size: Any) -> None:
            super().__init__(*size)
            shown.take(KEY._replace(column=1), replace(RECORD, elapsed=1.0))

    monkeypatch.setattr("amulor.view.page.traces.Samples", Growing)
    assert shown.over_time("VV", 0)["elapsed"] == [0.0]
    assert shown.over_time("VV", 0)["elapsed"] == [0.0, 1.0]


def test_long_scans_are_thinned_evenly(plate: Survey) -> None:
    shown = traces(plate)
    count = 5 * MOST_SAMPLES + 3
    for number in range(count):
        shown.take(KEY._replace(column=number), replace(RECORD, elapsed=float(number)))
    found = shown.over_time("VV", 0)
    assert found["samples"] == count
    assert MOST_SAMPLES / 2 <= len(found["elapsed"]) <= MOST_SAMPLES
    assert found["elapsed"][0] == 0.0
    assert set(np.diff(found["elapsed"])) == {8.0}


def test_another_channel_or_frequency_is_refused(plate: Survey) -> None:
    for channel, frequency in (("RR", 0), ("VV", 1)):
        with pytest.raises(CubeError, match="no channel"):
            traces(plate).over_time(channel, frequency)


def test_the_server_sends_those_of_the_journal(
    plate: Survey, served: Callable[..., TestClient], tmp_path: Path
) -> None:
    survey = plate.with_(
        {
            "scan.columns": 4,
            "scan.rows": 2,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 2},
        }
    )
    acquisition.acquire(survey, tmp_path / "scan", scene=simulation.scene_light)
    live = Live(tmp_path / "scan")
    live.look()
    client = served(live)
    found = client.get(f"/{TOKEN}/traces/VH/0").json()
    with Journal.read(tmp_path / "scan") as journal:
        records = [
            (key.kind, record)
            for _, key, record in journal.newer(0)
            if key.polarization == "VH"
        ]
    assert found["kind"] == [kind for kind, _ in records]
    signals = [math.hypot(one.in_phase, one.quadrature) for _, one in records]
    assert found["amplitude"] == pytest.approx(signals)
    assert found["mean"] == pytest.approx([one.mean for _, one in records])
    assert min(found["noise"]) >= 0
    assert client.get(f"/{TOKEN}/traces/none/0").status_code == 422
    live.stop()


def test_files_have_no_signals_over_time(client: TestClient) -> None:
    answer = client.get(f"/{TOKEN}/traces/VV/0")
    assert answer.status_code == 422
    assert "running scan" in answer.json()["error"]
