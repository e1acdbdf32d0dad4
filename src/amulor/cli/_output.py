"""Output of commands: tables, JSON and progress."""

from __future__ import annotations

import json
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from amulor import _progress

#: Time after which work prints its step in a pipe [s], ...
_SILENT = 2.0
#: ... and after which it prints an unchanged step again [s].
_AGAIN = 30.0
#: Fraction of flagged values above which a command gives advice [1].
_NEARLY_ALL = 0.9


def print_json(value: Any) -> None:
    """Print a value as JSON on standard output.

    Parameters
    ----------
    value : object
        Numbers, texts, paths, lists and tables; not-a-number becomes null.
    """
    print(json.dumps(_plain(value), indent=2, allow_nan=False))


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Print each kind of warning about the validity of results once, as one line."""
    from amulor.errors import AmulorWarning

    first: dict[str, str] = {}
    shown = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
        if issubclass(category, AmulorWarning):
            first.setdefault(str(message).partition(":")[0], str(message))
        else:
            shown(message, category, *where)

    with warnings.catch_warnings():
        warnings.simplefilter("always", AmulorWarning)
        warnings.showwarning = show  # type: ignore[assignment]
        try:
            yield
        finally:
            for text in first.values():
                print(f"warning: {text}", file=sys.stderr)


def print_table(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    """Print a table on standard output.

    Parameters
    ----------
    title : str
        Title of the table.
    header : sequence of str
        Titles of the columns.
    rows : sequence of sequences of str
        Cells.
    """
    from rich.console import Console, JustifyMethod
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for number, cell in enumerate(header):
        justify: JustifyMethod = "right" if number else "left"
        table.add_column(cell, justify=justify, overflow="fold")
    for row in rows:
        table.add_row(*row)
    # Without markup, "[mm]" is a unit. In a pipe, a table is as wide as needed.
    width = None if sys.stdout.isatty() else 1000
    Console(markup=False, emoji=False, width=width).print(table)


def print_next(command: str) -> None:
    """Print the command that usually follows, on a terminal only."""
    if sys.stdout.isatty():
        print(f"next: {command}")


def print_flags(counts: Mapping[str, int], total: int) -> None:
    """Print the most frequent flag, and advice if over 90 % of the values have it."""
    if not counts:
        return
    from amulor.view.explanations import explanations, hint

    name = max(counts, key=lambda flag: counts[flag])
    share = counts[name] / total
    print(f"commonest flag: {name} ({share:.1%}); what it means: {hint([name])}")
    if share > _NEARLY_ALL:
        explanation = explanations().get(name.upper())
        if explanation is not None:
            print(f"what to do: {explanation.remedy}")


def announcing(name: str = "", *, browser: bool) -> Callable[[str], None]:
    """Return a function that prints a page's address and may open a browser."""

    def announce(address: str) -> None:
        print(f"{name}{address}\nCtrl-C stops it.", flush=True)
        if browser:
            import webbrowser

            webbrowser.open(address)

    return announce


@contextmanager
def progress_bar(*, quiet: bool = False) -> Iterator[Callable[[str, float], None]]:
    """Show the progress of the block: a bar on a terminal, lines in a pipe.

    Parameters
    ----------
    quiet : bool
        Whether nothing is shown.

    Yields
    ------
    callable
        Function that takes the present step and the completed fraction of the work.

    Notes
    -----
    Lines go to standard error: the first after two seconds, then one for each new step.
    At least two seconds, and a tenth of the elapsed time, lie between two lines. A long
    step is printed again every half minute. Compilation is printed at once, as one
    step.
    """
    if quiet:
        yield lambda step, share: None
        return
    shown = _bar() if sys.stderr.isatty() else _lines()
    with shown as advance, _progress.listening(advance):
        yield advance


@contextmanager
def _lines() -> Iterator[_progress.Listener]:
    """Print progress as lines; print nothing for short computations."""
    log = _Log(time.monotonic)
    ended = threading.Event()

    def write() -> None:
        while not ended.wait(0.25):
            line = log.line()
            if line:
                print(line, file=sys.stderr, flush=True)

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    try:
        yield log.advance
    finally:
        ended.set()
        writer.join()


class _Log:
    """Progress log that writes fewer lines the longer the work takes."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._begun = self._written_at = clock()
        self._now = ("", 0.0)
        self._written = ""
        self._compiling_written = False

    def advance(self, step: str, share: float) -> None:
        """Update the current step and the completed fraction of the work."""
        self._now = (step, share)

    def line(self) -> str:
        """Return a progress line if one is due, else an empty text."""
        moment = self._clock()
        step, share = self._now
        # The longer it takes, the fewer lines.
        pause = max(_SILENT, (moment - self._begun) / 10)
        compiling = step.startswith(_progress.COMPILING)
        if step == self._written or (compiling and self._compiling_written):
            pause = max(_AGAIN, pause)
        elif compiling:
            pause = 0.0
        if not step or moment - self._written_at < pause:
            return ""
        self._written_at, self._written = moment, step
        self._compiling_written |= compiling
        return f"amulor: {moment - self._begun:.0f} s, {share:.0%} done, {step}"


@contextmanager
def _bar() -> Iterator[_progress.Listener]:
    """Show a bar that disappears after the work."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    columns = (
        BarColumn(bar_width=24),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda step, share: bar.update(task, description=step, completed=share)


def _plain(value: Any) -> Any:
    import math
    from pathlib import PurePath

    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
