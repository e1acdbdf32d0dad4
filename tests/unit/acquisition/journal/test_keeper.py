"""Samples are committed while the next is taken, and told when they are safe."""

from __future__ import annotations

import threading
import time

import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.connect import connect
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import Key
from amulor.acquisition.settings import Settings
from amulor.errors import AmulorError, FormatError

MAIN = threading.main_thread().name


@pytest.mark.parametrize(
    ("slow", "where"),
    [(0.0, {"journal_0"}), (0.3e-3, {"journal_0", MAIN}), (1e9, {MAIN})],
    ids=["beside the next", "as the disk is", "at once"],
)
def test_samples_are_told_after_they_are_written_whenever_that_is(
    small, settings, folder, monkeypatch, slow, where
) -> None:
    """Commits beside the next dwell keep order, and nothing is told too early."""
    monkeypatch.setattr("amulor.acquisition.run.SLOW", slow)
    threads, told, there = set(), [], []
    commit = Journal.commit_together

    def slowly(journal: Journal, samples, messages) -> None:
        threads.add(threading.current_thread().name)
        time.sleep(1e-3)
        commit(journal, samples, messages)

    def acknowledged(key: Key) -> None:
        told.append(key)
        if len(told) % 10 == 0:
            with Journal.read(folder) as journal:
                there.append({*told} <= journal.keys())

    monkeypatch.setattr(Journal, "commit_together", slowly)
    outcome = acquisition.acquire(
        small, folder, settings=settings, scene=scene_light, acknowledged=acknowledged
    )
    assert outcome.finished
    assert len(there) > 3
    assert all(there)
    assert threads == where
    with Journal.read(folder) as journal:
        assert [key for _, key, _ in journal.newer(0)] == told


@pytest.mark.parametrize("fails", [7, None], ids=["the disk", "the laser"])
def test_a_failure_beside_the_next_dwell_loses_nothing_that_was_told(
    small, settings, folder, monkeypatch, fails
) -> None:
    monkeypatch.setattr("amulor.acquisition.run.SLOW", 0.0)
    commit, told, count = Journal.commit_together, [], 0

    def sometimes(journal: Journal, samples, messages) -> None:
        nonlocal count
        count += 1
        time.sleep(5e-3)
        if count == fails:
            raise FormatError("no room; free some space")
        commit(journal, samples, messages)

    monkeypatch.setattr(Journal, "commit_together", sometimes)
    if fails is None:
        content = settings.model_dump(exclude_unset=True)
        content["simulation"] = {"faults": ["interlock@20x9999"]}
        settings = Settings.model_validate(content)
    devices = connect(small, settings, scene=scene_light)
    with pytest.raises(AmulorError, match=r"--resume") as caught:
        acquisition.acquire(
            small, folder, settings=settings, devices=devices,
            acknowledged=told.append,
        )  # fmt: skip
    assert devices.laser.log[-1] == "off"
    kept = 19 if fails is None else fails - 1
    assert f"{kept} samples are kept" in str(caught.value)
    with Journal.read(folder) as journal:
        assert [key for _, key, _ in journal.newer(0)] == told
        assert len(told) == kept
        assert journal.segments()[-1]["reason"]
