"""`amulor acquire` and `amulor recover`: acquisition of a scan, and its cube."""

from __future__ import annotations

import contextlib
import os
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
    retake_flagged: Annotated[bool, Parameter(negative="")] = False,
    calibration: Path | None = None,
    shutter_closed: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Run a scan and record its measurement cube.

    Parameters
    ----------
    survey
        Survey file (TOML).
    output
        Folder of the scan. It gets journal.sqlite, survey.toml and devices.toml, and
        cube.nc when the scan is complete. Ctrl-C pauses the scan and asks whether to
        continue.
    devices
        Devices file (TOML). By default the devices are simulated; with --resume they
        are those of the scan.
    resume
        Resume the interrupted scan in the folder.
    retake_flagged
        With --resume: acquire overloaded samples and samples with a wrong position once
        more, after the missing ones. The cube gets the last take of each sample.
    calibration
        Calibration file (TOML), from "amulor calibrate". With --resume the default is
        the calibration in cube.nc, if there is one.
    shutter_closed
        Measure the leakage: the laser is on, and the shutter in front of the detector
        is closed during the whole scan. A shutter without a driver is closed by hand.
    overwrite
        Replace an existing cube.nc, and its calibration. An existing scan is never
        replaced.
    json
        Print the result as JSON.
    """
    from amulor import acquisition, io, simulation
    from amulor.acquisition.cube.build import (
        CUBE_NAME,
        shows_no_target,
        trajectory_path,
    )
    from amulor.acquisition.journal.file import FILE_NAME
    from amulor.acquisition.run import DEVICES_NAME, resume_command
    from amulor.cli._arguments import UsageError
    from amulor.cli._output import print_json, print_next
    from amulor.errors import InstrumentError
    from amulor.survey import Survey

    if retake_flagged and not resume:
        raise UsageError("--retake-flagged needs a scan to go on with: --resume")
    if shutter_closed and calibration is not None:
        raise UsageError(
            "--shutter-closed measures the leakage; leave --calibration out"
        )
    # A scan that is resumed may have the cube of its first part beside it.
    replace = overwrite or resume
    if output.is_dir() and not (output / FILE_NAME).exists():
        io.check_output(output / CUBE_NAME, overwrite=replace, inputs=[survey])
    described = Survey.from_toml(survey)
    if devices is None and resume and (output / DEVICES_NAME).exists():
        devices = output / DEVICES_NAME
    settings = _settings(devices)
    delays = None if calibration is None else _calibration(calibration)
    if delays is None and resume and not overwrite:
        delays = _calibration_of(output / CUBE_NAME)
    try:
        with _live(quiet=json) as screen, _Interrupts(screen) as control:
            outcome = acquisition.acquire(
                described,
                output,
                settings=settings,
                resume=resume,
                retake_flagged=retake_flagged,
                scene=simulation.scene_light,
                control=control,
                progress=screen.show,
                ask=screen.request if sys.stdin.isatty() else None,
                shutter_closed=shutter_closed,
            )
    except KeyboardInterrupt as interrupt:
        for note in getattr(interrupt, "__notes__", ()):
            print(f"amulor: {note}", file=sys.stderr)
        if (output / FILE_NAME).exists():
            print(f"{output}: go on with: {resume_command(output)}", file=sys.stderr)
        raise
    closed = False
    summary: dict[str, Any] = {
        "finished": outcome.finished,
        "done": outcome.done,
        "total": outcome.total,
        "flagged": outcome.flagged,
        "unsafe": outcome.unsafe,
    }
    if outcome.finished:
        path = acquisition.recover(
            output, calibration=delays, overwrite=replace, told=_told
        )
        summary["cube"] = str(path)
        if described.platform is not None and trajectory_path(path).exists():
            summary["trajectory"] = str(trajectory_path(path))
        cube = io.read_cube(path)
        closed = cube.attrs.get("shutter") == "closed"
        if not closed and shows_no_target(cube):
            _told(
                f"{path}: no sample differs from the open-water shots by more than 5 "
                "standard errors: the target was not in the beam, its echo is too "
                "weak, or the driver of the lock-in does not read the instrument; "
                "'amulor reject' will find no target"
            )
    if json:
        print_json(summary)
    elif outcome.finished:
        print(
            f"{summary['cube']}: {outcome.done} samples, {outcome.flagged} flagged in "
            "this run"
        )
        if "trajectory" in summary:
            print(f"{summary['trajectory']}: for amulor export --trajectory")
        print_next(
            f"amulor calibrate leakage {summary['cube']} -o leakage.toml"
            if closed
            else f"amulor reject {summary['cube']} --method auto -o target.nc"
        )
    else:
        print(
            f"{output}: {outcome.done} of {outcome.total} samples; go on with: "
            f"{resume_command(output)}"
        )
    if outcome.unsafe:
        raise InstrumentError("\n".join(outcome.unsafe))
    if not outcome.finished:
        raise KeyboardInterrupt


def _settings(path: Path | None) -> Any:
    from amulor.acquisition import Settings

    return Settings() if path is None else Settings.from_toml(path)


def _calibration(path: Path) -> Any:
    from amulor.acquisition import Calibration

    return Calibration.from_toml(path)


def _calibration_of(path: Path) -> Any:
    """Return the calibration stored in a cube file; None without one."""
    from amulor import io
    from amulor.acquisition import Calibration

    if not path.exists():
        return None
    text = io.read_cube(path).attrs.get("calibration")
    return None if text is None else Calibration.from_text(text, name=str(path))


def recover(
    folder: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    calibration: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write the cube of an interrupted scan from its journal.

    Parameters
    ----------
    folder
        Folder of the scan, which "amulor acquire" wrote. The scan may be unfinished, or
        running.
    output
        File to write (netCDF); by default cube.nc in the folder.
    calibration
        Calibration file (TOML), from "amulor calibrate".
    overwrite
        Replace an existing file.
    """
    from amulor import acquisition, io
    from amulor.cli._arguments import CUBE_ENDINGS, check_ending
    from amulor.errors import FormatError

    if output is not None:
        check_ending("--output", output, CUBE_ENDINGS)
    delays = None
    if calibration is not None:
        delays = acquisition.Calibration.from_toml(calibration)
    damage: list[str] = []

    def damaged(line: str) -> None:
        damage.append(line)
        _told(line)

    path = acquisition.recover(
        folder, output=output, calibration=delays, overwrite=overwrite, told=_told,
        damaged=damaged,
    )  # fmt: skip
    missing = int(io.read_cube(path)["in_phase"].isnull().sum())
    print(f"{path}: {missing} samples missing")
    from amulor.cli._output import print_next

    print_next(f"amulor reject {path} --method auto -o target.nc")
    if damage:
        raise FormatError(
            f"{folder}: the journal is damaged at the places named above; the rest is "
            f"in {path}"
        )


def _told(line: str) -> None:
    print(f"amulor: {line}", file=sys.stderr)


class _Interrupts:
    """Handler of signals: Ctrl-C pauses the scan, a second one or SIGTERM ends it.

    While devices are then made safe, every signal but SIGKILL is ignored. Signals that
    the program was started to ignore, as by nohup, stay ignored, except SIGTERM.
    """

    #: Ctrl-Z, too: a stopped program would leave the laser on.
    _ASK = ("SIGINT", "SIGTSTP")
    _END = ("SIGTERM", "SIGHUP", "SIGQUIT")

    def __init__(self, screen: _Screen) -> None:
        self._screen = screen
        self._wanted = False
        self._leaving = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Interrupts:
        """Install the signal handlers, in the main thread."""
        if threading.current_thread() is threading.main_thread():
            for names, handler in ((self._ASK, self._want), (self._END, self._end)):
                for name in names:
                    if not hasattr(signal, name):
                        continue
                    number = getattr(signal, name)
                    ignored = signal.getsignal(number) is signal.SIG_IGN
                    if not ignored or name == "SIGTERM":
                        self._before[number] = signal.signal(number, handler)
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the signal handlers."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def pause_wanted(self) -> bool:
        """Return whether a signal requests a pause or the end of the scan."""
        return self._wanted or self._leaving

    def go_on(self) -> bool:
        """Ask whether to continue the scan; without a terminal, end it."""
        self._wanted = False
        if self._leaving or not sys.stdin.isatty():
            return False
        answer = self._screen.ask(
            "Paused: laser off, stage stopped. Go on with the scan? [Y/n] "
        )
        return answer.strip().lower() in ("", "y", "yes")

    def _want(self, number: int, frame: object) -> None:
        # Ctrl-C instead of an answer, or a second one before the question, ends the
        # scan.
        if self._wanted or self._screen.asking or self._leaving:
            self._end(number, frame)
        self._wanted = True

    def _end(self, number: int, frame: object) -> None:
        if self._leaving:
            with contextlib.suppress(OSError):
                os.write(2, b"\namulor: devices are being made safe\n")
            return
        self._leaving = True
        raise KeyboardInterrupt


class _Screen:
    """Display of a running scan; without a terminal it shows nothing."""

    def __init__(self, bar: Any = None) -> None:
        self._bar = bar
        self._task = None if bar is None else bar.add_task("starting", total=None)
        self._shown = -1.0
        self.asking = False

    def show(self, now: Progress) -> None:
        """Show counts, rate, remaining time and flags, at most ten times a second."""
        moment = time.monotonic()
        if self._bar is None or (moment - self._shown < 0.1 and now.done < now.total):
            return
        self._shown = moment
        self._bar.update(
            self._task, completed=now.done, total=now.total, description=words(now)
        )

    def ask(self, text: str) -> str:
        """Ask the operator a question, and return the answer."""
        # A live bar holds back text without a line end, such as a question.
        if self._bar is not None:
            self._bar.stop()
        self.asking = True
        # Not with `input`, which would write the question to standard output, maybe a
        # file.
        print(text, end="", file=sys.stderr, flush=True)
        try:
            return input()
        except EOFError:  # Ctrl-D, or the terminal is gone
            raise KeyboardInterrupt from None
        finally:
            self.asking = False
            if self._bar is not None:
                self._bar.start()

    def request(self, text: str) -> None:
        """Ask the operator for an action."""
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
        TextColumn("{task.completed}/{task.total} {task.description}", markup=False),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        yield _Screen(bar)


def words(now: Progress) -> str:
    """Return rate, remaining time and flagged samples of a scan as one line.

    Parameters
    ----------
    now : Progress
        Progress of a scan.

    Returns
    -------
    str
        For a terminal.
    """
    minutes, seconds = divmod(round(now.left), 60)
    hours, minutes = divmod(minutes, 60)
    remaining = f"{hours}:{minutes:02}:{seconds:02}"
    return (
        f"{now.kind.replace('_', ' ')}, {now.rate:.0f}/s, {remaining} left, "
        f"{now.flagged} flagged"
    )
