"""`amulor acquire`: runs a scan, with simulated devices unless others are named."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

if TYPE_CHECKING:
    from amulor.acquisition import Progress


def acquire(
    survey: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    devices: Path | None = None,
    resume: Annotated[bool, Parameter(negative="")] = False,
    calibration: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Run a scan and record its measurement cube.

    Parameters
    ----------
    survey
        Survey file (TOML).
    output
        Folder of the scan: journal.sqlite, survey.toml, devices.toml, and cube.nc
        when all is taken. Ctrl-C pauses and asks.
    devices
        Devices file (TOML); simulated devices if left out.
    resume
        Go on with the scan that is in the folder.
    calibration
        Calibration file (TOML) that "amulor devices calibrate" wrote.
    overwrite
        Replace cube.nc if it is there. A scan in the folder is never replaced.
    json
        Print the outcome for other programs.
    """
    from amulor import acquisition, io
    from amulor.acquisition.build import CUBE_NAME
    from amulor.acquisition.journal import FILE_NAME
    from amulor.cli._output import print_json
    from amulor.survey import Survey

    # A scan that is resumed may have the cube of its first part beside it.
    replace = overwrite or resume
    if output.is_dir() and not (output / FILE_NAME).exists():
        io.check_output(output / CUBE_NAME, overwrite=replace, inputs=[survey])
    described = Survey.from_toml(survey)
    settings = _settings(devices)
    known = None if calibration is None else _calibration(calibration)
    with _live(quiet=json) as screen, _Interrupts(screen) as control:
        outcome = acquisition.acquire(
            described,
            output,
            settings=settings,
            resume=resume,
            control=control,
            progress=screen.show,
            ask=screen.request if sys.stdin.isatty() else None,
        )
    found: dict[str, Any] = {
        "finished": outcome.finished,
        "done": outcome.done,
        "total": outcome.total,
        "flagged": outcome.flagged,
        "unsafe": outcome.unsafe,
    }
    for line in outcome.unsafe:
        print(f"amulor: {line}", file=sys.stderr)
    if outcome.finished:
        path = acquisition.recover(output, calibration=known, overwrite=replace)
        found["cube"] = str(path)
    if json:
        print_json(found)
    elif outcome.finished:
        print(f"{found['cube']}: {outcome.done} samples, {outcome.flagged} flagged")
    else:
        print(
            f"{output}: {outcome.done} of {outcome.total} samples; go on with: "
            f"amulor acquire {output / 'survey.toml'} -o {output} --devices "
            f"{output / 'devices.toml'} --resume"
        )
    if not outcome.finished:
        raise KeyboardInterrupt


def _settings(path: Path | None) -> Any:
    from amulor.acquisition import Settings

    return Settings() if path is None else Settings.from_toml(path)


def _calibration(path: Path) -> Any:
    from amulor.acquisition import Calibration

    return Calibration.from_toml(path)


class _Interrupts:
    """Ctrl-C asks between two samples; a second one, or a termination, ends at once."""

    def __init__(self, screen: _Screen) -> None:
        self._screen = screen
        self._wanted = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Interrupts:
        """Take over the signals, where that can be done."""
        if threading.current_thread() is threading.main_thread():
            self._before[signal.SIGINT] = signal.signal(signal.SIGINT, self._want)
            self._before[signal.SIGTERM] = signal.signal(signal.SIGTERM, self._end)
            if hasattr(signal, "SIGHUP"):
                self._before[signal.SIGHUP] = signal.signal(signal.SIGHUP, self._end)
        return self

    def __exit__(self, *_: object) -> None:
        """Give the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def pause_wanted(self) -> bool:
        """Return whether Ctrl-C was pressed."""
        return self._wanted

    def go_on(self) -> bool:
        """Ask whether the scan goes on; in a pipe it does not."""
        self._wanted = False
        if not sys.stdin.isatty():
            return False
        answer = self._screen.ask(
            "Paused: laser off, stage stopped. Go on with the scan? [Y/n] "
        )
        return answer.strip().lower() in ("", "y", "yes")

    def _want(self, number: int, frame: object) -> None:
        # In place of an answer, or a second time before the question: at once.
        if self._wanted or self._screen.asking:
            raise KeyboardInterrupt
        self._wanted = True

    def _end(self, number: int, frame: object) -> None:
        raise KeyboardInterrupt


class _Screen:
    """What a scan shows: nothing, unless there is a bar."""

    def __init__(self, bar: Any = None) -> None:
        self._bar = bar
        self._task = None if bar is None else bar.add_task("starting", total=None)
        self._shown = -1.0
        self.asking = False

    def show(self, now: Progress) -> None:
        """Show done, rate, time left and flagged, ten times a second."""
        moment = time.monotonic()
        if self._bar is None or (moment - self._shown < 0.1 and now.done < now.total):
            return
        self._shown = moment
        self._bar.update(
            self._task, completed=now.done, total=now.total, description=words(now)
        )

    def ask(self, text: str) -> str:
        """Ask something, with the bar out of the way, and return the answer."""
        # A live bar keeps back what does not end a line, such as a question.
        if self._bar is not None:
            self._bar.stop()
        self.asking = True
        try:
            return input(text)
        finally:
            self.asking = False
            if self._bar is not None:
                self._bar.start()

    def request(self, text: str) -> None:
        """Ask for something to be done."""
        self.ask(f"{text}; then press Enter. ")


@contextmanager
def _live(*, quiet: bool) -> Iterator[_Screen]:
    """Show a bar on a terminal, and nothing in a pipe."""
    if quiet or not sys.stderr.isatty():
        yield _Screen()
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (
        BarColumn(bar_width=24),
        TextColumn("{task.completed}/{task.total} {task.description}"),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        yield _Screen(bar)


def words(now: Progress) -> str:
    """Return rate, time left and flagged samples in one line.

    Parameters
    ----------
    now : Progress
        How far a scan has come.

    Returns
    -------
    str
        For a terminal.
    """
    minutes, seconds = divmod(round(now.left), 60)
    hours, minutes = divmod(minutes, 60)
    left = f"{hours}:{minutes:02}:{seconds:02}"
    return (
        f"{now.kind.replace('_', ' ')}, {now.rate:.0f}/s, {left} left, "
        f"{now.flagged} flagged"
    )
