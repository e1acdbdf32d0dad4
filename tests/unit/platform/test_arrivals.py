"""Clocks of navigation sources: steps, late and repeated messages, broken links."""

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest

from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.navigation import recorded_trajectory
from amulor.platform import pose_line
from amulor.platform.arrivals import without_steps
from amulor.survey import Mounting

#: Length of a recording, interval of its messages [s], and their position error [m].
LENGTH, INTERVAL, ERROR = 60.0, 0.1, 5e-3


def _place(time):
    """True position of a vehicle that meanders at some 0.5 m/s."""
    time = np.asarray(time, dtype=float)
    return np.stack(
        [0.5 * time, 0.3 * np.sin(0.4 * time), -8 + 0.1 * np.cos(0.3 * time)], -1
    )


def _drawn(rng, noise):
    """Stamps, arrivals and lines of a source with drawn faults, by arrival."""
    time = np.arange(0.0, LENGTH, INTERVAL)
    stamp, kept = time.copy(), np.ones(time.size, dtype=bool)
    arrival = time + rng.exponential(4e-3, time.size)
    for _ in range(rng.integers(0, 3)):  # clock steps of 0.1 to 30 s
        size = rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1.5)
        stamp[time >= rng.uniform(5, LENGTH - 5)] += size
    if rng.random() < 0.5:  # a link that breaks, and then delivers in order
        begin, length = rng.uniform(0, LENGTH - 10), rng.uniform(0.5, 10)
        held = (arrival >= begin) & (arrival < begin + length)
        arrival[held] = begin + length + 1e-3 * np.arange(held.sum())
        arrival = np.maximum.accumulate(arrival)
    if rng.random() < 0.5:  # late packets
        late = rng.random(time.size) < 0.02
        arrival[late] += rng.uniform(0.05, 3, late.sum())
    for _ in range(rng.integers(0, 3)):  # dropouts
        begin = rng.uniform(0, LENGTH)
        kept &= ~((time >= begin) & (time < begin + rng.uniform(0.2, 8)))
    measured = _place(time) + rng.normal(0, noise, (time.size, 3))
    rows = []
    for number in np.flatnonzero(kept):
        line = pose_line(
            time=stamp[number],
            position=measured[number],
            attitude=[0, 0, 0, 1],
            covariance=np.eye(6) * ERROR**2,
        )
        rows.append((arrival[number], line))
        if rng.random() < 0.01:  # repeated
            rows.append((arrival[number] + rng.uniform(0, 0.3), line))
        if rng.random() < 0.005:  # cut off
            rows.append((arrival[number], line[: rng.integers(1, 60)]))
    return sorted(rows, key=lambda row: row[0])


def _recorded(rows, survey):
    meta = {
        "survey": survey.to_toml(),
        "devices": "[procedure]",
        "identities": json.dumps({"navigation": "a vehicle"}),
    }
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None))
    try:
        with Journal.create(folder, meta=meta) as journal:
            journal.begin_segment()
            journal.commit_together([], rows)
            return recorded_trajectory(journal, survey)
    finally:
        shutil.rmtree(folder)


@pytest.fixture
def carried(plate):
    """A survey of an instrument on a vehicle."""
    course = {"kind": "hover", "start": ["0 m", "0 m", "-8 m"]}
    return plate.with_({"platform": {"course": course}})


def _check(seed, survey, *, noise=0.0, limit=3.5):
    """Return the share of times with a pose; no pose may be wrong in silence.

    Without noise of the positions, errors are those of the clock and of interpolation.
    """
    rows = _drawn(np.random.default_rng([42, seed]), noise)
    recorded = _recorded(rows, survey)
    time = np.arange(0.05, LENGTH, 0.037)
    known = recorded.known(time)
    if known.any():
        poses = recorded.trajectory.at(time[known])
        error = poses.position - _place(time[known])
        sigma = np.sqrt(np.einsum("nii->ni", poses.covariance)[:, :3])
        # A step of 0.1 s gives ten.
        assert np.abs(error / sigma).max() < limit, (seed, recorded.lines)
    return known.mean()


def test_drawn_faults_of_a_source_give_no_wrong_pose(carried):
    assert np.mean([_check(seed, carried) for seed in range(3)]) > 0.3


@pytest.mark.study
def test_a_thousand_drawn_sources_give_no_wrong_pose(carried):
    assert np.mean([_check(seed, carried) for seed in range(1000)]) > 0.6


@pytest.mark.study
def test_errors_of_a_thousand_drawn_sources_are_those_stated(carried):
    """Of five million normal errors, the largest is some 5.1 standard deviations."""
    for seed in range(1000):
        _check(seed, carried, noise=ERROR, limit=6)


def _steady(stamps, arrivals, **mounting):
    return without_steps(
        np.array(stamps), np.array(arrivals), origin=0.0, mounting=Mounting(**mounting)
    )


TIME = np.arange(0.0, 20.0, 0.1)


@pytest.mark.parametrize("size", [0.1, 2.5, -0.1, -2.5])
def test_a_step_is_measured_and_the_stated_clock_is_used(size):
    stepped = TIME + np.where(TIME >= 8.05, size, 0.0)
    mask, lines = _steady(stepped, TIME)
    way = "forward" if size > 0 else "back"
    assert lines[0] == (
        f"navigation: the clock steps {way} by {abs(size):g} s, 8.1 s after the start"
    )
    np.testing.assert_array_equal(mask, TIME < 7.05)
    mask, _ = _steady(stepped, TIME, clock_offset=size)
    np.testing.assert_array_equal(mask, TIME > 9.15)


def test_messages_of_a_broken_link_are_used():
    """Those of 5 to 9 s arrive together, after them."""
    arrival = np.where((TIME > 5) & (TIME < 9), 9.0 + 1e-4 * TIME, TIME)
    mask, lines = _steady(TIME, arrival)
    assert mask.all()
    assert lines == []


def test_a_clock_that_is_set_back_for_a_while_is_left_out():
    back = (TIME > 5.05) & (TIME < 9.05)
    mask, lines = _steady(TIME - np.where(back, 1.3, 0.0), TIME)
    assert not mask[back].any()
    assert mask[TIME < 4].all()
    assert mask[TIME > 9.15].all()
    assert any("40 messages are up to 1.3 s too early" in line for line in lines)


def test_one_wrong_time_stamp_is_left_out():
    stamp = TIME.copy()
    stamp[100] += 86400.0
    mask, lines = _steady(stamp, TIME)
    assert not mask[100]
    assert mask[np.abs(TIME - 10) > 1.15].all()
    assert lines[0] == "navigation: a wrong time stamp, 10 s after the start"


def test_another_clock_offset_than_the_stated_one_is_described():
    mask, lines = _steady(TIME + 3600.0, TIME)
    assert mask.all()
    (line,) = lines
    assert "are 3600 s, but the mounting states a clock offset of 0 s" in line
    assert _steady(TIME + 3600.0, TIME, clock_offset="1 hour")[1] == []
