"""Progress of a scan: what is counted, the rate, the drift and the limits of advice."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from amulor.acquisition import plan
from amulor.acquisition.plan import Key
from amulor.acquisition.sampler import SampleFlag
from amulor.survey import Survey
from amulor.view.page.progress import (
    Change,
    Drift,
    Going,
    Progress,
    _plain,
    _two_sided,
    advice,
    drift_of,
)

GOOD: dict[str, Any] = {
    "running": True, "done": 1000, "scanned": 400, "open_water": 80, "dark": 20
}  # fmt: skip


@pytest.mark.parametrize(
    ("rate", "silent", "told"),
    # 20 times the usual interval, and 15 s at least.
    [(np.nan, 14.9, False), (np.nan, 15.1, True), (10.0, 14.9, False),
     (10.0, 15.1, True), (0.5, 39.9, False), (0.5, 40.1, True)],
)  # fmt: skip
def test_silence_is_told_after_twenty_intervals(rate, silent, told) -> None:
    words = f"no sample for {silent:.0f} s: see whether the instrument still runs"
    going = Going(**GOOD, rate=rate, silent=silent)
    assert advice(going) == ([words] if told else [])
    resting = Going(**{**GOOD, "running": False}, rate=rate, silent=silent)
    assert advice(resting) == []


@pytest.mark.parametrize(
    ("size", "chance", "told"),
    [(0.02, 0.9e-3, True), (-0.02, 0.9e-3, True), (0.0199, 0.0, False),
     (0.02, 1e-3, False)],
)  # fmt: skip
def test_a_drift_of_two_percent_is_told_if_it_is_sure(size, chance, told) -> None:
    change = Change(size=size, error=1e-3, chance=chance)
    assert bool(advice(Going(**GOOD, drift=Drift(newest=change)))) == told


@pytest.mark.parametrize(
    ("flag", "words"),
    [("overload",
      "overload the lock-in or the detector: less power, or a larger scale"),
     ("off position", "stand off the commanded direction: check the scanner"),
     ("off frequency", "are detected at another frequency than commanded"),
     ("no light", "are without light: check laser and shutter"),
     ("repeated", "lost the reference and were taken again: check its cable")],
)  # fmt: skip
def test_flags_of_one_percent_of_the_samples_are_told(flag: str, words: str) -> None:
    assert advice(Going(**GOOD, flagged={flag: 9})) == []
    told = advice(Going(**GOOD, flagged={flag: 10}))
    assert told == [f"1% of the samples {words}"]


def test_references_that_are_missing_are_told_once_the_scan_has_begun() -> None:
    nothing = {"done": 0, "open_water": 0, "dark": 0, "running": False}
    assert advice(Going(**{**GOOD, **nothing, "scanned": 0})) == []
    assert advice(Going(**{**GOOD, **nothing, "scanned": 1})) == [
        "no open-water shots so far: the water cannot be removed yet",
        "no dark readings: offsets of the instrument stay in the samples",
    ]
    stopped = Going(**GOOD, total=5000, resume="amulor x", reason="a cable")
    assert advice(stopped) == [
        "stopped (a cable) at 1,000 of 5,000 samples; resume with: amulor x"
    ]


def test_chances_are_those_of_students_t() -> None:
    # One degree of freedom: Cauchy. Two: 1 - t / sqrt(2 + t^2).
    assert _two_sided(-3.0, 3.0, 1.0) == pytest.approx(0.5)
    assert _two_sided(2.0, np.sqrt(2), 2.0) == pytest.approx(1 - np.sqrt(0.5))
    assert _two_sided(0.0, 0.0, 2.0) == 1.0
    assert _two_sided(1.0, 0.0, 2.0) == 0.0


def test_two_rounds_are_compared_by_a_paired_t_test() -> None:
    half = np.array([0.01, 0.03, 0.02, 0.05, 0.015])
    signal = 1 + np.stack([-half, half], axis=1)
    found = drift_of(signal, cluster=range(5), elapsed=[0.0, 9.0], rounds=4)
    known = stats.ttest_1samp(2 * half, 0.0)
    error = np.std(2 * half, ddof=1) / np.sqrt(5)
    for change in (found.total, found.newest):
        assert change.size == pytest.approx(2 * half.mean())
        assert change.error == pytest.approx(error)
        # Two contrasts at each of three later rounds.
        assert change.chance == pytest.approx(min(1.0, 6 * known.pvalue))
    assert found.change == pytest.approx([-half.mean(), half.mean()])
    assert found.error == pytest.approx([error / 2] * 2)
    assert found.elapsed == [0.0, 9.0]


def test_three_rounds_have_the_scatter_of_an_analysis_of_variance() -> None:
    deviation = np.random.default_rng(3).normal(scale=0.01, size=(4, 3))
    deviation -= deviation.mean(axis=1, keepdims=True)
    found = drift_of(1 + deviation, cluster=range(4), elapsed=[0, 1, 2], rounds=3)
    rounds = deviation.mean(axis=0)
    variance = np.sum((deviation - rounds) ** 2) / (2 * 3)
    assert found.change == pytest.approx(list(rounds))
    assert found.error == pytest.approx([np.sqrt(variance / 4 * 2 / 3)] * 3)
    # The last less the first, and the last less the mean of both earlier ones.
    for change, contrast in (
        (found.total, np.array([-1, 0, 1])), (found.newest, np.array([-0.5, -0.5, 1]))
    ):  # fmt: skip
        own = np.std(deviation @ contrast, ddof=1) / 2
        pooled = np.sqrt(contrast @ contrast * variance / 4)
        assert change.size == pytest.approx(rounds @ contrast)
        assert change.error == pytest.approx(max(own, pooled))
        chance = 4 * 2 * stats.t.sf(abs(change.size) / change.error, 6)
        assert change.chance == pytest.approx(min(1.0, chance))
    # Rounds without a time count by their number.
    same = drift_of(1 + deviation, cluster=range(4), elapsed=[5, 5, 5], rounds=3)
    assert same.total.size == pytest.approx(found.total.size)
    later = drift_of(1 + deviation, cluster=range(4), elapsed=[0, 1, 6], rounds=3)
    assert later.total.size != pytest.approx(found.total.size)


def test_three_directions_are_enough_for_a_scatter() -> None:
    signal = np.array([[1.0, 1.1], [1.0, 1.2], [1.0, 1.1]])
    assert drift_of(signal, cluster=range(3), elapsed=[0, 1], rounds=2) != Drift()
    assert drift_of(signal[:2], cluster=range(2), elapsed=[0, 1], rounds=2) == Drift()


class Clock:
    """Clock that stands until it is moved [s]."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


META = {"devices": "[procedure]\nreferences = 2\ndark_readings = 3\n"
        "shutter_readings = 4\n"}  # fmt: skip
FREQUENCY = 39e6


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def progress(plate: Survey, clock: Clock) -> Progress:
    """Return an empty progress of 12 x 6 pixels, 15 directions and 8 rounds."""
    return Progress(plate, META, clock=clock)


def record(signal: complex = 1.0, *, flags: int = 0, elapsed: float = 0.0) -> Any:
    return SimpleNamespace(
        in_phase=signal.real, quadrature=signal.imag, flags=flags, elapsed=elapsed
    )


def key(kind: str, row: int = 0, column: int = 0, *, repeat: int = 0,
        channel: str = "VV") -> Key:  # fmt: skip
    return Key(kind, row, column, FREQUENCY, channel, repeat)


def test_the_plan_is_counted_with_its_references(progress: Progress) -> None:
    # Two channels of 72 pixels, 120 shots, and twice three and four readings.
    assert progress.total == 2 * (72 + 120 + 2 * 7)
    assert progress.scanned == progress.seen == 0


@pytest.mark.parametrize(
    ("taken", "more"),
    [(key(plan.SCAN), 0), (key(plan.SCAN, repeat=1), 1),
     (key(plan.OPEN_WATER, repeat=7), 0), (key(plan.OPEN_WATER, repeat=8), 1),
     (key(plan.DARK, repeat=5), 0), (key(plan.DARK, repeat=6), 1),
     (key(plan.SHUTTER, repeat=7), 0), (key(plan.SHUTTER, repeat=8), 1),
     (key(plan.REFERENCE, 7, plan.BEFORE_SHOTS), 0),
     (key(plan.REFERENCE, 8, plan.BEFORE_SHOTS), 1),
     (key(plan.REFERENCE, 8, plan.BEFORE_ROW), 0)],
)  # fmt: skip
def test_samples_beyond_the_plan_add_to_the_total(progress, taken, more) -> None:
    total = progress.total
    row = progress.take(taken, record())
    assert progress.total == total + more
    assert row == (("VV", taken.row) if taken.kind == plan.SCAN else None)
    assert progress.seen == 1
    assert progress.scanned == (taken.kind == plan.SCAN)


def test_a_row_is_complete_with_its_last_pixel_and_free_of_the_dark_signal(
    progress: Progress,
) -> None:
    for column in range(12):
        assert not progress.is_complete("VH", 2)
        progress.take(key(plan.SCAN, 2, column, channel="VH"), record(column + 2j))
        row = progress.status([], resume=None)["row"]
        assert row == (2 if column == 11 else None)
    assert progress.is_complete("VH", 2)
    assert not progress.is_complete("VV", 2)
    assert_allclose(progress.row_signal("VH", 2), [np.arange(12) + 2j])
    for signal in (1.0, 3.0 + 2j):
        progress.take(key(plan.DARK, channel="VH"), record(signal))
    progress.take(key(plan.DARK, channel="VV"), record(50.0))
    for _ in range(2):
        assert_allclose(progress.row_signal("VH", 2), [np.arange(12) - 2 + 1j])


def test_flags_are_counted_by_name(progress: Progress) -> None:
    both = int(SampleFlag.OVERLOAD | SampleFlag.OFF_POSITION)
    progress.take(key(plan.SCAN), record(flags=both))
    progress.take(key(plan.DARK), record(flags=int(SampleFlag.OVERLOAD)))
    status = progress.status([], resume=None)
    assert status["flagged"] == {"overload": 2, "off position": 1}
    assert status["kind"] == "dark"
    assert status["state"] == "not begun"


OPEN = {"ended": None, "reason": None}


def test_the_rate_is_that_of_the_last_minute(progress: Progress, clock: Clock) -> None:
    def status() -> dict[str, Any]:
        return progress.status([OPEN], resume=None)

    first = status()
    assert (first["rate"], first["left"]) == (None, None)
    assert (first["state"], first["elapsed"]) == ("running", 0.0)
    # One sample in two seconds, then two a second.
    for step, count in ((2.0, 20), (0.5, 130)):
        for number in range(count):
            clock.now += step
            progress.take(key(plan.SCAN, 0, number % 12), record(elapsed=clock.now))
            found = status()
    assert found["rate"] == pytest.approx(2.0, rel=0.02)
    assert found["done"] == 150
    assert found["left"] == round((progress.total - 150) / found["rate"])
    assert found["elapsed"] == clock.now
    # A record of an earlier time does not turn the clock of the scan back.
    progress.take(key(plan.SCAN), record(elapsed=1.0))
    assert status()["elapsed"] == clock.now
    clock.now += 15.1
    assert "no sample for 15 s" in status()["advice"][0]
    finished = progress.status([{"ended": "x", "reason": "finished"}], resume="again")
    assert (finished["total"], finished["resume"]) == (151, None)


def test_shots_of_whole_rounds_tell_the_drift_without_the_dark_signal(
    progress: Progress, plate: Survey
) -> None:
    progress.take(key(plan.DARK), record(0.5))
    progress.take(key(plan.DARK, repeat=1), record(1.5))
    for repeat, size in ((1, 1.1), (0, 0.9)):
        for row in range(3):
            for column in range(5):
                for channel in ("VV", "VH"):
                    dark = 1.0 if channel == "VV" else 0.0
                    shot = key(plan.OPEN_WATER, row, column, repeat=repeat,
                               channel=channel)  # fmt: skip
                    progress.take(shot, record(dark + size, elapsed=30.0 * repeat))
                    if repeat == 1:
                        known = len(progress.drift().elapsed)
                        assert known == 0
    drift = progress.drift()
    # In the order of time, whatever was taken first.
    assert drift.elapsed == [0.0, 30.0]
    assert drift.change == pytest.approx([-0.1, 0.1])
    assert drift.total.size == pytest.approx(0.2)
    assert progress.drift() is drift
    progress.take(key(plan.DARK, repeat=2), record(0.4))
    assert progress.drift() is not drift


def test_numbers_for_the_page_have_no_infinity() -> None:
    found = _plain({"a": [1.0, np.inf], "b": (np.nan, {"c": 2})})
    assert found == {"a": [1.0, None], "b": [None, {"c": 2}]}
