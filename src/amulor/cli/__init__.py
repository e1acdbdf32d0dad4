"""The command line: parse, call one public function, print a short result."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

#: Command, where it lives, and its line in the help. The functions are imported when
#: they are called, so that `amulor --help` answers at once.
COMMANDS = {
    "demo": ("demo:demo", "Scan a ladder in clear and milky water; write a report."),
    "warm-up": (
        "warm_up:warm_up",
        "Compile all loops for this computer, so that no later command waits for it.",
    ),
    "samples": (
        "samples:samples",
        "List sample data, or write some of them to try the other commands on.",
    ),
    "survey check": ("survey:check", "Check a survey file."),
    "survey schema": ("survey:schema", "Print the JSON Schema of survey files."),
    "design": (
        "design:design",
        "Recommend an instrument for a goal; write its survey.",
    ),
    "survey presets": (
        "presets:presets",
        "List published instruments that ship as surveys.",
    ),
    "survey preset": (
        "presets:preset",
        "Write the survey file of a published instrument.",
    ),
    "backscatter": (
        "backscatter:backscatter",
        "Compute the water signal against modulation frequency.",
    ),
    "water": (
        "water:water",
        "Print the optical constants of pure fresh or sea water.",
    ),
    "water fit": (
        "water:fit",
        "Fit the water of a cube: attenuation, spread of the light, cut-off.",
    ),
    "simulate": ("simulate:simulate", "Simulate a survey into a measurement cube."),
    "acquire": ("acquire:acquire", "Run a scan and record its measurement cube."),
    "recover": ("acquire:recover", "Make the cube of a scan from its journal."),
    "devices simulate": (
        "devices:simulate",
        "Serve simulated devices on the network until Ctrl-C.",
    ),
    "devices calibrate": (
        "devices:calibrate",
        "Find phase zero from a plate at a known distance.",
    ),
    "import transients": (
        "transients:transients",
        "Turn single-photon histograms into a measurement cube.",
    ),
    "import recordings": (
        "recordings:recordings",
        "Turn a recording of other software into a measurement cube.",
    ),
    "info": ("info:info", "Say what a file holds."),
    "explain": (
        "explain:explain",
        "Say what a flag or a message means, or why a pixel of a file is flagged.",
    ),
    "reject": ("reject:reject", "Take the water signal out of a measurement cube."),
    "image": ("image:image", "Turn a target signal into a range image."),
    "export": (
        "export:export",
        "Write a range image as a cloud, mesh, drawing, section or comparison.",
    ),
    "view": (
        "view:view",
        "Show a file or scan in the browser: maps, 3D, measuring with errors.",
    ),
    "watch": (
        "watch:watch",
        "Watch a scan in the terminal: picture, rate, drift, what to do.",
    ),
    "site check": ("site:check", "Check a site file and the files it names."),
    "run": (
        "run:run",
        "Take all scans of a site to range images and clouds, here or on a cluster.",
    ),
    "site register": (
        "site:register",
        "Bring all scans of a site into one frame.",
    ),
    "site merge": (
        "site:merge",
        "Merge all scans of a site into LAZ tiles, or an E57 file of all scans.",
    ),
    "site compare": (
        "site:compare",
        "Compare two visits to a site: change, significance, volumes, what moved.",
    ),
    "site report": (
        "site:report",
        "Draw a site into one HTML file: plan, poses, errors, change.",
    ),
    "site schema": ("site:schema", "Print the JSON Schema of site files."),
    "archive": (
        "archive:archive",
        "Write the archive folder of a project, or check one.",
    ),
    "report": ("report:report", "Draw range images into one HTML file."),
    "reproduce ricci2010": (
        "reproduce:ricci2010",
        "Redraw the figures of Ricci et al. 2010 and check their statements.",
    ),
}
_GROUPS = {
    "survey": "Look at survey files.",
    "site": "Put many scans into one frame, and see what changed between visits.",
    "import": "Bring in data of other instruments.",
    "devices": "Rehearse and calibrate instruments.",
    "reproduce": "Published figures, redrawn and checked.",
    "water": "Optical constants of pure water, and the fit of measured water.",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words of the command line without the program; `sys.argv` by default.

    Returns
    -------
    int
        0 done; 1 something is wrong with files or data; 2 wrong use; 130 interrupted;
        128 and its number if ended by another signal.
    """
    words = _with_negative(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _answer(words)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader has seen enough; what is still in the buffer must not complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        return _complain(f"cannot print: {error.strerror or error}")
    except MemoryError:
        return _complain("memory ran out; take fewer pixels, channels or frequencies")


def _with_negative(words: Sequence[str]) -> list[str]:
    """Join negative numbers to their options: "--frequency -5MHz" is no option -5."""
    tied: list[str] = []
    for word in words:
        below = word[:1] == "-" and word[1:].lstrip(".")[:1].isdigit()
        if below and tied and tied[-1].startswith("--") and "=" not in tied[-1]:
            tied[-1] += f"={word}"
        else:
            tied.append(word)
    return tied


def _answer(words: list[str]) -> int:
    if words in ([], ["--help"], ["-h"]):
        print(_help())
        return 0
    if words == ["--version"]:
        from amulor import __version__

        print(__version__)
        return 0
    return _run(words)


def _help() -> str:
    width = max(map(len, COMMANDS)) + 2
    lines = [f"  {name:<{width}}{text}" for name, (_, text) in COMMANDS.items()]
    return "\n".join(
        [
            "Underwater amplitude-modulated laser radar: from a survey to a 3D image.",
            "",
            "Usage: amulor COMMAND [OPTIONS]     amulor COMMAND --help     "
            "amulor --version",
            "",
            *lines,
        ]
    )


def _run(words: list[str]) -> int:
    import logging
    from importlib import import_module

    from cyclopts import App, CycloptsError

    from amulor.cli._arguments import UsageError
    from amulor.errors import AmulorError

    # Advice about its own settings folder, where no home can be written.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    app = App(
        name="amulor",
        help=_help().splitlines()[0],
        version_flags=[],
        suppress_keyboard_interrupt=False,
    )
    groups = {
        name: App(name=name, help=text, version_flags=[])
        for name, text in _GROUPS.items()
    }
    for group in groups.values():
        app.command(group)
    for name, (target, summary) in COMMANDS.items():
        first, _, subcommand = name.partition(" ")
        if name in groups:  # a command by itself that has commands below it, too
            module, _, function = target.partition(":")
            imported = import_module(f"amulor.cli.{module}")
            groups[name].default(getattr(imported, function))
            continue
        place, command_name = (
            (groups[first], subcommand) if subcommand else (app, first)
        )
        # The text is that of the function, which is not imported for the list.
        place.command(f"amulor.cli.{target}", name=command_name, help=summary)
    try:
        with _ended_in_order():
            app(
                words,
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
    except CycloptsError as error:
        _complain(" ".join(str(error).split()))
        return 2
    except UsageError as error:
        _complain(str(error))
        return 2
    except AmulorError as error:
        return _complain(str(error))
    except _Ended as end:
        print(f"amulor: ended by {end.signal.name}", file=sys.stderr)
        return 128 + end.signal
    except KeyboardInterrupt:
        print("amulor: interrupted", file=sys.stderr)
        return 130
    return 0


class _Ended(KeyboardInterrupt):
    """Request by a signal to end the program."""

    def __init__(self, number: int) -> None:
        self.signal = signal.Signals(number)


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Remove half-written files if a signal ends the program.

    The first SIGTERM or SIGHUP does so, the next ones do not disturb it. What the
    program was started to ignore, as by nohup, stays ignored. Commands that drive
    devices have handlers of their own meanwhile.
    """
    handled: list[int] = []

    def end(number: int, _: object) -> None:
        for handled_signal in handled:
            signal.signal(handled_signal, signal.SIG_IGN)
        raise _Ended(number)

    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                handled.append(number)
                signal.signal(number, end)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)


def _complain(text: str) -> int:
    for line in text.splitlines():
        print(f"amulor: {line}", file=sys.stderr)
    return 1
