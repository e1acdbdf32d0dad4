"""Rules for messages whose clock steps, each on a few messages."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.platform import arrivals
from amulor.platform.arrivals import without_steps
from amulor.survey import Mounting


@given(
    values=st.lists(st.integers(-9, 9), min_size=1, max_size=12),
    reach=st.integers(1, 9),
)
def test_the_highest_before_and_after_are_those_of_a_window(
    values: list[int], reach: int
) -> None:
    before, after = arrivals._highest(np.array(values, dtype=float), reach)
    # An odd number of values, at least half as many as there are.
    wide = 2 * (min(reach, len(values)) // 2) + 1
    for place in range(len(values)):
        earlier = values[max(place - wide, 0) : place]
        assert before[place] == max(earlier, default=-np.inf)
        assert after[place] == max(values[place : place + wide])


def set_back(
    delay: list[float],
    *,
    stamps: list[float] | None = None,
    steps: list[float] | None = None,
    spacing: float = 1.0,
) -> list[int]:
    """Return the messages of another clock, of arrivals 1 s, or else, apart."""
    count = len(delay)
    time = spacing * np.arange(count)
    wrong = arrivals._set_back(
        time - delay if stamps is None else np.array(stamps),
        time,
        np.array(delay),
        interval=0.2,
        least=0.5,
        steps=np.array(steps or []),
    )
    return np.flatnonzero(wrong).tolist()


def test_three_equal_delays_in_a_row_are_another_clock() -> None:
    far = 1000.0
    # Stamps far from those of all others; arrivals so far apart that none is soon.
    assert set_back([0, 0, far, far, far, 0], spacing=100) == [2, 3, 4]
    for two in ([0, 0, far, far, 0, 0], [far, far, 0, 0], [0, 0, far, far]):
        assert set_back(two, spacing=100) == []
    # All late messages beside them have that clock, too.
    delays = [0, far - 9, far, far, far, far + 7, 0]
    assert set_back(delays, spacing=100) == [1, 2, 3, 4, 5]
    # Equal are delays within half of an interval.
    assert set_back([0, far, far + 0.09, far, 0], spacing=100) == [1, 2, 3]
    assert set_back([0, far, far + 0.11, far, 0], spacing=100) == []


def test_delays_of_up_to_the_least_step_are_usual() -> None:
    assert set_back([0, 0.5, 0.5, 0.5, 0], spacing=100) == []
    assert set_back([0, 0.51, 0.51, 0.51, 0], spacing=100) == [1, 2, 3]


def test_late_stamps_at_those_of_others_are_of_another_clock() -> None:
    # Half of an interval is 0.1 s; messages of time come at 0, 1, 2 and 5 s.
    for stamp, wrong in (
        (1.09, True),
        (1.91, True),
        (1.11, False),
        (1.89, False),
        (-0.09, True),
        (-0.11, False),
        (5.09, True),
        (5.11, False),
    ):
        found = set_back([0, 0, 0, 9, 0], stamps=[0, 1, 2, stamp, 5])
        assert found == ([3] if wrong else [])
    # A message of time is at the stamp of no other.
    assert set_back([0, 0, 0], stamps=[1, 1, 1]) == []
    # One message of time is not enough to compare with.
    assert set_back([0, 9], stamps=[1, 1]) == []


def test_late_messages_soon_after_a_step_may_have_the_clock_before_it() -> None:
    stamps = [0.0, 1000, 2000, 3000, 4000, 5000]
    late = [0.0, 300, 0, 700, 0, 900]
    # Arrivals are 30 s apart: the step at 45 s is less than 60 s before 90 s only.
    assert set_back(late, stamps=stamps, spacing=30, steps=[45]) == [3]
    assert set_back(late, stamps=stamps, spacing=30, steps=[88]) == [3]
    assert set_back(late, stamps=stamps, spacing=30, steps=[92]) == [5]
    assert set_back(late, stamps=stamps, spacing=30, steps=[45, 92]) == [3, 5]
    assert set_back(late, stamps=stamps, spacing=30) == []


def test_no_message_within_a_second_of_a_step_is_used() -> None:
    time = [0.0] * 9
    stamps = [100.0 * n for n in range(9)]
    found = set_back(time, stamps=stamps, spacing=0.5, steps=[2.0])
    assert found == [2, 3, 4, 5, 6]
    assert set_back(time, stamps=stamps, spacing=0.5, steps=[0.2, 3.9]) == [
        0, 1, 2, 6, 7, 8,
    ]  # fmt: skip


def test_late_messages_after_those_of_another_clock_are_doubtful() -> None:
    far = 1000.0
    delays = [0, far, far, far, 0, 50, 0, 70]
    stamps = [0.0, 1e4, 2e4, 3e4, 4e4, 5e4, 6e4, 7e4]
    # The last message of the other clock arrives at 45 s.
    assert set_back(delays, stamps=stamps, spacing=15) == [1, 2, 3, 5, 7]
    assert set_back(delays, stamps=stamps, spacing=20) == [1, 2, 3, 5]
    assert set_back(delays, stamps=stamps, spacing=31) == [1, 2, 3]
    assert set_back(delays, stamps=stamps, spacing=0.4) == [1, 2, 3, 5, 7]


def steps_of(times: list[float], levels: list[float]) -> list[str]:
    return arrivals._steps(np.array(times), np.array(levels), 0.1)


def test_steps_of_one_moment_are_one_step() -> None:
    assert steps_of([], [0.0]) == []
    assert steps_of([5.0, 70.12345], [0.0, 2.5, 1.25]) == [
        "navigation: the clock steps forward by 2.5 s, 5 s after the start",
        "navigation: the clock steps back by 1.25 s, 70.12 s after the start",
    ]
    assert steps_of([5.0, 6.0], [0.0, 9.0, 2.0]) == [
        "navigation: the clock steps forward by 2 s, 5 s after the start"
    ]
    assert len(steps_of([5.0, 6.1], [0.0, 9.0, 2.0])) == 2
    # There and back within a second is one wrong stamp.
    assert steps_of([5.0, 6.0], [0.0, 9.0, 0.1]) == [
        "navigation: a wrong time stamp, 5 s after the start"
    ]
    assert steps_of([5.0, 5.1, 8.0], [0.0, 9.0, -0.11, 4.0]) == [
        "navigation: the clock steps back by 0.11 s, 5 s after the start",
        "navigation: the clock steps forward by 4.11 s, 8 s after the start",
    ]


@pytest.mark.parametrize(
    ("level", "mounting", "doubtful"),
    [
        (10.49, {"clock_offset": 10.0}, False),
        (10.51, {"clock_offset": 10.0}, True),
        (9.49, {"clock_offset": 10.0}, True),
        (11.49, {"clock_offset": 10.0, "clock_uncertainty": 0.5}, False),
        (11.51, {"clock_offset": 10.0, "clock_uncertainty": 0.5}, True),
        (10.49, {"clock_offset": 10.0, "clock_uncertainty": 0.01}, False),
    ],
)
def test_an_offset_may_differ_by_half_a_second_or_three_errors(
    level: float, mounting: dict[str, float], doubtful: bool
) -> None:
    words = (
        f"navigation: time stamps minus arrivals are {level:g} s, but the mounting "
        "states a clock offset of 10 s; correct mounting.clock_offset before the export"
    )
    found = arrivals._doubtful(level, Mounting(**mounting))
    assert found == ([words] if doubtful else [])


def used(
    stamps: np.ndarray, time: np.ndarray, *, origin: float = 0.0, **mounting: float
) -> tuple[list[int], list[str]]:
    """Return the messages that are left out, and what is said of them."""
    mask, lines = without_steps(
        stamps, time, origin=origin, mounting=Mounting(**mounting)
    )
    assert mask.dtype == bool
    return np.flatnonzero(~mask).tolist(), lines


def test_no_message_and_one_message_are_without_steps() -> None:
    assert used(np.zeros(0), np.zeros(0)) == ([], [])
    assert used(np.array([3.0]), np.array([3.1])) == ([], [])


def test_arrivals_count_from_the_origin() -> None:
    time = np.arange(0.0, 20.0, 0.1)
    assert used(1.7e9 + time, time, origin=1.7e9) == ([], [])
    (line,) = used(1.7e9 + time, time, origin=1.7e9 - 3)[1]
    assert "minus arrivals are 3 s, but" in line


def test_steps_are_noticed_from_a_fiftieth_of_a_second() -> None:
    time = np.arange(0.0, 40.0, 1.0)
    for size, noticed in ((0.019, False), (0.021, True)):
        for sign in (1, -1):
            stamps = time + np.where(time >= 20, sign * size, 0.0)
            lines = used(stamps, time)[1]
            assert any("the clock steps" in line for line in lines) == noticed


def test_steps_are_noticed_from_five_usual_delays() -> None:
    time = np.arange(0.0, 60.0, 1.0)
    # Two of three messages are late by 10 ms.
    delay = np.where(np.arange(60) % 3, 0.01, 0.0)
    for size, noticed in ((0.049, False), (0.051, True)):
        stamps = time + np.where(time >= 30, size, 0.0)
        lines = used(stamps, time + delay)[1]
        assert any("the clock steps" in line for line in lines) == noticed


def test_usual_delays_are_those_from_the_earliest_of_21_messages() -> None:
    # One of 40 messages is in time: 21 of them have it within ten before or after.
    time = np.arange(0.0, 120.0)
    delay = np.where(np.arange(120) % 40, 0.01, 0.0)
    for size, noticed in ((0.03, False), (0.07, True)):
        stamps = time + np.where(time >= 60, size, 0.0)
        lines = used(stamps, time + delay)[1]
        assert any("the clock steps" in line for line in lines) == noticed


def late_for(seconds: int) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps and arrivals of messages that are ever later for a time."""
    time = np.arange(0.0, 300.0)
    late = (time >= 100) & (time < 100 + seconds)
    delay = np.where(late, 5 + 0.25 * (time - 100), 0.0)
    order = np.argsort(time + delay, kind="stable")
    return time[order], (time + delay)[order]


def test_messages_that_are_late_for_a_minute_are_used() -> None:
    # Of 78 late messages, 60 arrive before the next one that is in time.
    stamps, time = late_for(78)
    assert used(stamps, time) == (
        [], ["navigation: 19 messages out of order, up to 24.2 s late"],
    )  # fmt: skip
    missing, lines = used(*late_for(90))
    assert missing
    assert lines[0] == (
        "navigation: the clock steps back by 5 s, 105 s after the start"
    )


def test_of_two_clocks_the_one_with_the_stated_offset_is_used() -> None:
    time = np.arange(0.0, 40.0, 1.0)
    stamps = time + np.where(time >= 20, 100.0, 0.0)
    missing, lines = used(stamps, time)
    assert missing == list(range(19, 40))
    assert lines == [
        "navigation: the clock steps forward by 100 s, 20 s after the start",
        "navigation: 21 of 40 messages left out, whose clock differs",
    ]
    missing, lines = used(stamps, time, clock_offset=100.0)
    assert missing == list(range(22))
    assert lines[1] == "navigation: 22 of 40 messages left out, whose clock differs"
    # Halfway between the two, the nearer one is used and doubted.
    missing, lines = used(stamps, time, clock_offset=40.0)
    assert missing == list(range(19, 40))
    assert lines[-1].startswith("navigation: time stamps minus arrivals are 0 s, but")


def test_a_clock_that_comes_back_is_the_same_clock() -> None:
    time = np.arange(0.0, 90.0, 1.0)
    stamps = time + np.where((time >= 30) & (time < 60), 100.0, 0.0)
    for offset in (0.0, 3.0):
        missing, _ = used(stamps + offset, time, clock_offset=offset)
        assert missing == [*range(29, 62)]
    # With few messages, it is not.
    few = time + np.where((time >= 30) & (time < 81), 100.0, 0.0)
    assert used(few, time)[0] == [*range(29, 90)]


def test_a_message_of_another_clock_is_too_early() -> None:
    time = np.arange(0.0, 40.0, 1.0)
    stamps = time.copy()
    stamps[20:23] -= 7.0
    missing, lines = used(stamps, time)
    assert missing == [20, 21, 22]
    assert lines == [
        "navigation: time stamps of 3 messages are up to 7 s too early, the first 20 s "
        "after the start",
        "navigation: 3 of 40 messages left out, whose clock differs",
    ]
