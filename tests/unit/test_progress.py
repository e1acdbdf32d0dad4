"""Work says how far it is, once and rising, to whoever listens."""

from __future__ import annotations

from collections.abc import Callable
from threading import Thread

import pytest
import xarray as xr

from amulor import _progress, imaging, rejection
from amulor.cli._output import _Log, progress_bar
from amulor.simulation import simulate
from amulor.survey import Survey


def _told(work: Callable[[], object]) -> list[tuple[str, float]]:
    said: list[tuple[str, float]] = []
    with _progress.listening(lambda step, share: said.append((step, share))):
        work()
    return said


def test_parts_of_parts_are_shares_of_the_whole() -> None:
    def work() -> None:
        _progress.tell("first", 0.0)
        with _progress.part(0.5, 1.0):
            _progress.tell("second", 0.5)
            with _progress.part(0.5, 0.75):
                _progress.tell("third", 1.0)
        with _progress.part(0.9, 1.0), _progress.part(0.2, 0.4):
            _progress.tell("fourth", 0.5)
        _progress.tell("last", 1.0)

    assert _told(work) == [
        ("first", 0.0),
        ("second", 0.75),
        ("third", 0.875),
        # 0.3 of the last tenth.
        ("fourth", pytest.approx(0.93)),
        ("last", 1.0),
    ]


def test_a_delay_is_told_from_any_thread_and_then_the_step_again() -> None:
    said: list[tuple[str, float]] = []
    others: list[str] = []

    def elsewhere(step: str) -> None:
        thread = Thread(target=_progress.aside, args=(step,))
        thread.start()
        thread.join()

    with _progress.listening(lambda step, share: others.append(step)):
        with _progress.listening(lambda step, share: said.append((step, share))):
            _progress.tell("fitting", 0.25)
            elsewhere("compiling")
            elsewhere("")
            _progress.aside("compiling again")
        # The share stays where it was.
        assert said == [
            ("fitting", 0.25), ("compiling", 0.25), ("fitting", 0.25),
            ("compiling again", 0.25),
        ]  # fmt: skip
        assert others == []
        # The inner listener is gone; the outer one hears of other threads.
        elsewhere("compiling")
        assert others == ["compiling"]
    elsewhere("to nobody")
    assert (len(said), len(others)) == (4, 1)


def test_what_is_done_again_does_not_go_back() -> None:
    def work() -> None:
        _progress.tell("errors", 0.6)
        _progress.tell("errors of the other channel", 0.2)

    assert [share for _, share in _told(work)] == [0.6, 0.6]


def test_nobody_has_to_listen_and_nobody_listens_for_longer_than_asked() -> None:
    said = _told(lambda: None)
    with _progress.part(0.0, 0.5):
        _progress.tell("to nobody", 0.0)
    assert said == []


def test_a_problem_ends_the_listening() -> None:
    said: list[str] = []
    with (
        pytest.raises(ZeroDivisionError),
        _progress.listening(lambda step, share: said.append(step)),
        _progress.part(0.0, 0.1),
    ):
        raise ZeroDivisionError
    _progress.tell("afterwards", 0.0)
    assert said == []


@pytest.mark.parametrize(
    "method",
    [
        "open_water",
        pytest.param("combined", marks=pytest.mark.slow),
        pytest.param("joint", marks=pytest.mark.slow),
        pytest.param("auto", marks=[pytest.mark.slow, pytest.mark.study]),
    ],
)
def test_the_steps_of_a_scan_rise(method: str, plate_text: str) -> None:
    cubes: list[xr.Dataset] = []
    text = plate_text.replace('["39 MHz"]', '["39 MHz", "60 MHz"]')
    survey = Survey.from_text(text)

    def work() -> None:
        with _progress.part(0.0, 0.3):
            cubes.append(simulate(survey, rng=1))
        with _progress.part(0.3, 0.8):
            cubes.append(getattr(rejection, method)(cubes[-1]))
        with _progress.part(0.8, 1.0):
            name = cubes[-1].amulor.polarizations[0]
            imaging.range_image(cubes[-1], polarization=name)

    said = _told(work)
    steps, shares = zip(*said, strict=True)
    assert list(shares) == sorted(shares)
    assert shares[0] == 0.0
    assert shares[-1] <= 1.0
    # Rejection is where the time goes: it is never one step.
    assert sum(0.3 <= share < 0.8 for share in shares) > 1
    assert len(set(steps)) > 5


def test_a_log_is_silent_about_what_is_soon_done_and_says_each_long_step_once() -> None:
    now = [0.0]
    log = _Log(lambda: now[0])
    lines = []
    log.advance("reading", 0.0)
    for tenth in range(700):
        now[0] = tenth / 10
        if now[0] == 1.0:
            log.advance("water", 0.25)
        if now[0] == 62.5:
            log.advance("errors", 0.9)
        line = log.line()
        if line:
            lines.append(line)
    assert lines == [
        "amulor: 2 s, 25% done, water",
        "amulor: 32 s, 25% done, water",
        "amulor: 62 s, 25% done, water",
        "amulor: 69 s, 90% done, errors",
    ]


def test_quick_work_in_a_pipe_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar() as advance:
        advance("something", 0.5)
        _progress.tell("something else", 0.7)
    assert capsys.readouterr() == ("", "")
