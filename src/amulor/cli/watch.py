"""`amulor watch`: a running scan in the terminal."""

from __future__ import annotations

import sys
import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from amulor.cli._arguments import UsageError, channel_of

if TYPE_CHECKING:
    from rich.console import RenderableType

    from amulor.view.page import Live

#: Interval of reading the journal [s].
_POLL = 0.5


def watch(
    folder: Path,
    /,
    *,
    polarization: str | None = None,
    show: Literal["range", "amplitude", "uncertainty"] = "range",
    every: str = "10 s",
    once: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Show a running scan in the terminal: picture, rate, drift, advice.

    Parameters
    ----------
    folder
        Folder of a scan, which "amulor acquire" wrote. The scan may be running or
        finished; it is only read.
    polarization
        Channel to show, such as VH; by default the first.
    show
        Map to show.
    every
        Time between two lines if the output is no terminal, such as "1 min".
    once
        Show the present state, and exit.
    """
    from amulor.cli._arguments import quantity_of
    from amulor.view.page import Live

    pause = quantity_of("--every", every, "time")
    if not pause > 0:
        raise UsageError(f"--every: needed is a time above 0, found {every}")
    live = Live(folder)
    try:
        live.look()
        channel = _channel(live, channel_of(polarization))
        if sys.stdout.isatty():
            _on_screen(live, channel, show, once=once)
        else:
            _in_lines(live, channel, pause, once=once)
    except KeyboardInterrupt:
        # Ctrl-C ends the display; the scan continues.
        return
    finally:
        live.stop()


def _channel(live: Live, chosen: str | None) -> str:
    names = live.polarizations
    if chosen is None:
        return names[0]
    if chosen not in names:
        raise UsageError(
            f"--polarization: the scan has no channel {chosen!r}, only "
            f"{', '.join(names)}"
        )
    return chosen


def _ended(live: Live) -> bool:
    return "error" not in live.status and live.status.get("state") == "finished"


def _on_screen(live: Live, channel: str, show: str, *, once: bool) -> None:
    """Draw the running scan until it is finished or interrupted by Ctrl-C."""
    from rich.console import Console
    from rich.live import Live as Screen

    from amulor.view import terminal

    console = Console()
    plain = console.color_system is None

    def drawn() -> RenderableType:
        return terminal.screen(
            live,
            channel=channel,
            layer=show,
            size=(console.width, console.height),
            plain=plain,
            now=datetime.now(),
        )

    if once:
        console.print(drawn())
        return
    with Screen(drawn(), console=console, auto_refresh=False) as screen:
        while not _ended(live):
            time.sleep(_POLL)
            live.look()
            screen.update(drawn(), refresh=True)


def _in_lines(live: Live, channel: str, pause: float, *, once: bool) -> None:
    """Print a status line of the running scan at intervals, and new advice."""
    from amulor.view import terminal

    printed: list[str] = []
    written = -float("inf")
    while True:
        ended = _ended(live)
        fresh = [line for line in _advice(live) if line not in printed]
        if ended or once or fresh or time.monotonic() - written >= pause:
            now = datetime.now()
            ratio = terminal.signal_to_noise(live, channel)
            line = terminal.going(live.status, ratio=ratio, now=now)
            print(f"{now:%H:%M:%S} {line}", flush=True)
            for advice in fresh:
                print(f"{now:%H:%M:%S} note: {advice}", flush=True)
            printed, written = _advice(live), time.monotonic()
        if ended or once:
            return
        time.sleep(_POLL)
        live.look()


def _advice(live: Live) -> list[str]:
    """Return advice on a running scan, and read errors, as lines of text."""
    lines = [str(line) for line in live.status.get("advice", [])]
    return [*lines, str(live.status["error"])] if "error" in live.status else lines
