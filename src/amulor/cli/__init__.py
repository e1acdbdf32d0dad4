"""Command line: parsing of options, calls of public functions, printed results."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

#: Command, location of its function, and its line in the help. Functions are imported
#: when called, so that `amulor --help` answers at once.
COMMANDS = {
    "demo": (
        "demo:demo",
        "Simulate scans of a ladder in clear and milky water; write a report.",
    ),
    "warm-up": (
        "warm_up:warm_up",
        "Compile the numerical code for this computer, so that commands start faster.",
    ),
    "samples": (
        "samples:samples",
        "List the sample data, or write a sample to try other commands.",
    ),
    "survey check": ("survey:check", "Check a survey file."),
    "survey schema": ("survey:schema", "Print the JSON Schema of survey files."),
    "design": (
        "design:design",
        "Recommend an instrument for a goal; write its survey.",
    ),
    "survey presets": (
        "presets:presets",
        "List the published instruments that are available as surveys.",
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
        "Fit the water of a cube: attenuation, angular spread, cut-off frequency.",
    ),
    "simulate": (
        "simulate:simulate",
        "Simulate a survey; write its measurement cube.",
    ),
    "acquire": ("acquire:acquire", "Run a scan and record its measurement cube."),
    "recover": (
        "acquire:recover",
        "Write the cube of an interrupted scan from its journal.",
    ),
    "devices simulate": (
        "devices:simulate",
        "Serve simulated devices on the network until Ctrl-C.",
    ),
    "calibrate leakage": (
        "calibrate:leakage",
        "Measure leakage with a closed shutter; without cubes, print the steps.",
    ),
    "calibrate demodulator": (
        "calibrate:demodulator",
        "Measure errors of the demodulator outputs; without cubes, print the steps.",
    ),
    "calibrate polarizer": (
        "calibrate:polarizer",
        "Measure gain and cross-talk of channels; without cubes, print the steps.",
    ),
    "calibrate reference": (
        "calibrate:reference",
        "Record the phase of a standing reference; without a cube, print the steps.",
    ),
    "calibrate temperature": (
        "calibrate:temperature",
        "Measure the phase against temperature; without cubes, print the steps.",
    ),
    "calibrate plate": (
        "calibrate:plate",
        "Measure phase zero with plates at distances; without cubes, print the steps.",
    ),
    "calibrate platform": (
        "patch_test:platform",
        "Estimate the mounting from overlapping lines; without lines, print the steps.",
    ),
    "import transients": (
        "transients:transients",
        "Convert single-photon histograms or waveforms to a measurement cube.",
    ),
    "import arrivals": (
        "arrivals:arrivals",
        "Compute a range image from the arrival of a known pulse or code in records.",
    ),
    "import recordings": (
        "recordings:recordings",
        "Convert a recording of other software to a measurement cube.",
    ),
    "import trajectory": (
        "trajectory:trajectory",
        "Convert the navigation log of a vehicle to a trajectory, and draw it.",
    ),
    "info": ("info:info", "Print the contents of a file."),
    "explain": (
        "explain:explain",
        "Explain a flag, a message, or the flags of one pixel of a file.",
    ),
    "profile": (
        "profile:profile",
        "Find the surfaces along the beam of one pixel, and draw its range profile.",
    ),
    "reject": ("reject:reject", "Subtract the water signal from a measurement cube."),
    "image": ("image:image", "Compute a range image from a target signal."),
    "export": (
        "export:export",
        "Write a range image as a cloud, mesh, drawing, section or comparison.",
    ),
    "view": (
        "view:view",
        "Show a file or scan in a browser: maps, 3D, measurements with uncertainties.",
    ),
    "watch": (
        "watch:watch",
        "Show a running scan in the terminal: picture, rate, drift, advice.",
    ),
    "site check": ("site:check", "Check a site file and the files it names."),
    "run": (
        "run:run",
        "Process all scans of a site to range images and clouds, here or on a cluster.",
    ),
    "site register": (
        "site:register",
        "Register all scans of a site in one frame.",
    ),
    "site merge": (
        "site:merge",
        "Merge all scans of a site into LAZ tiles, or an E57 file of all scans.",
    ),
    "site compare": (
        "site:compare",
        "Compare two visits to a site: change, significance, volumes, motions.",
    ),
    "site report": (
        "site:report",
        "Write a site report in one HTML file: plan, poses, errors, change.",
    ),
    "site drawings": (
        "site:drawings",
        "Draw the plan of a site, sections across scans, and detail sheets.",
    ),
    "site schema": ("site:schema", "Print the JSON Schema of site files."),
    "archive": (
        "archive:archive",
        "Write the archive folder of a project, or check one.",
    ),
    "report": ("report:report", "Write a report of range images in one HTML file."),
    "benchmark": (
        "benchmark:benchmark",
        "Compare the rejection methods on public scenes with known ranges.",
    ),
    "reproduce ricci2010": (
        "reproduce:ricci2010",
        "Redraw the figures of Ricci et al. 2010 and check their statements.",
    ),
}
#: Commands by the task of the user, in the order of `amulor --help`.
TOPICS = {
    "measure": (
        "calibrate demodulator", "calibrate leakage", "calibrate polarizer",
        "calibrate reference", "calibrate temperature", "calibrate plate",
        "acquire", "watch", "recover", "devices simulate",
        "import transients", "import arrivals", "import recordings",
        "import trajectory", "calibrate platform",
    ),
    "simulate": (
        "survey check", "survey schema", "simulate", "backscatter", "water",
        "water fit",
    ),
    "reject and image": ("reject", "image"),
    "look": ("view", "profile", "info", "explain"),
    "deliver": ("report", "export", "archive"),
    "design": ("design", "survey presets", "survey preset"),
    "many scans": (
        "run", "site check", "site register", "site merge", "site compare",
        "site report", "site drawings", "site schema",
    ),
    "learn": ("demo", "samples", "benchmark", "reproduce ricci2010", "warm-up"),
}  # fmt: skip
#: An example of each command, and the usual next one.
EXAMPLES = {
    "calibrate leakage": (
        "amulor calibrate leakage closed/cube.nc -o leakage.toml",
        "amulor recover",
    ),
    "calibrate demodulator": (
        "amulor calibrate demodulator silent.nc turn-1.nc turn-2.nc turn-3.nc "
        "turn-4.nc turn-5.nc -o demodulator.toml",
        "amulor calibrate leakage",
    ),
    "calibrate polarizer": (
        "amulor calibrate polarizer a0.nc a30.nc a60.nc a90.nc a120.nc a150.nc "
        "--angles 0,30,60,90,120,150 -o channels.toml",
        "amulor calibrate plate",
    ),
    "calibrate reference": (
        "amulor calibrate reference plate-1/cube.nc -o reference.toml",
        "amulor calibrate plate",
    ),
    "calibrate temperature": (
        "amulor calibrate temperature run-10.nc run-20.nc run-30.nc "
        "-o temperature.toml",
        "amulor calibrate plate",
    ),
    "calibrate platform": (
        "amulor calibrate platform line-1.nc line-2.nc line-3.nc "
        "--trajectory track.csv --mounting rov.toml -o calibrated.toml",
        "amulor export --mounting calibrated.toml",
    ),
    "calibrate plate": (
        'amulor calibrate plate plate.nc --distance "1.5 m" '
        '--distance-uncertainty "1 mm" -o calibration.toml',
        "amulor recover",
    ),
    "acquire": (
        "amulor acquire tank.toml --devices devices.toml -o scan",
        "amulor watch scan, then amulor reject",
    ),
    "watch": ("amulor watch scan", "amulor reject"),
    "recover": ("amulor recover scan -o cube.nc", "amulor reject"),
    "devices simulate": (
        "amulor devices simulate tank.toml -o devices.toml",
        "amulor acquire",
    ),
    "import transients": (
        "amulor import transients letter.npz --frequency 100MHz -o samples.nc",
        "amulor reject",
    ),
    "import arrivals": (
        "amulor import arrivals coded.npz --group-index 1.34 -o image.nc",
        "amulor view, amulor report or amulor export",
    ),
    "import recordings": (
        "amulor import recordings scan.csv --survey tank.toml --columns columns.toml "
        "-o samples.nc",
        "amulor reject",
    ),
    "import trajectory": (
        "amulor import trajectory rov.csv --columns columns.toml -o track.csv",
        "amulor export",
    ),
    "survey check": ("amulor survey check tank.toml", "amulor simulate"),
    "survey schema": ("amulor survey schema > survey.json", "amulor survey check"),
    "simulate": ("amulor simulate tank.toml -o samples.nc", "amulor reject"),
    "backscatter": ("amulor backscatter tank.toml --plot", ""),
    "water": ('amulor water --wavelength "405 nm" --temperature 15 --salinity 35', ""),
    "water fit": ("amulor water fit samples.nc", "amulor reject"),
    "reject": (
        "amulor reject samples.nc --method auto -o target.nc",
        "amulor image, or amulor view",
    ),
    "image": (
        "amulor image target.nc --polarization VV -o image.nc",
        "amulor view, amulor report or amulor export",
    ),
    "view": ("amulor view target.nc", "amulor report or amulor export"),
    "info": ("amulor info image.nc", "amulor explain"),
    "explain": ("amulor explain MIXED", ""),
    "profile": ("amulor profile target.nc --pixel 20,50 -o profile.png", ""),
    "report": ("amulor report image.nc -o report.html", "amulor archive"),
    "export": ("amulor export image.nc -o cloud.laz", "amulor archive"),
    "archive": ("amulor archive project.toml -o archive", ""),
    "design": ("amulor design goal.toml -o survey.toml", "amulor simulate"),
    "survey presets": ("amulor survey presets", "amulor survey preset"),
    "survey preset": (
        "amulor survey preset amulor-2010 -o survey.toml",
        "amulor survey check",
    ),
    "run": ("amulor run site.toml -o results", "amulor site register"),
    "site check": ("amulor site check site.toml", "amulor run"),
    "site register": (
        "amulor site register site.toml -o poses.json",
        "amulor site merge",
    ),
    "site merge": (
        "amulor site merge site.toml --poses poses.json -o cloud.e57",
        "amulor site compare",
    ),
    "site compare": (
        "amulor site compare site.toml --poses poses.json -o change.csv",
        "amulor site report",
    ),
    "site report": (
        "amulor site report site.toml --poses poses.json -o site.html",
        "amulor site drawings",
    ),
    "site drawings": (
        "amulor site drawings site.toml --poses poses.json -o site.pdf",
        "amulor archive",
    ),
    "site schema": ("amulor site schema > site.json", "amulor site check"),
    "demo": ("amulor demo", "amulor samples"),
    "samples": ("amulor samples ladder", "amulor reject"),
    "benchmark": ("amulor benchmark --quick -o benchmark", ""),
    "reproduce ricci2010": ("amulor reproduce ricci2010 --quick", ""),
    "warm-up": ("amulor warm-up", ""),
}
#: Earlier names of commands, which are not in the help.
_ALIASES = {"devices calibrate": "calibrate plate"}
_GROUPS = {
    "survey": "Check survey files, and write those of published instruments.",
    "site": "Register many scans in one frame, and compare visits.",
    "import": "Import data of other instruments.",
    "calibrate": "Calibrate an instrument, and its mounting on a vehicle.",
    "devices": "Simulate instruments.",
    "reproduce": "Redraw and check published figures.",
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
        Exit code: 0 for success, 1 for an error in files or data, 2 for wrong use, 130
        for an interrupt, 128 plus the signal number for another signal.
    """
    # At the end, the interpreter looks through all objects for garbage, for a second.
    atexit.register(gc.freeze)
    words = _with_negative(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _answer(words)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader closed the pipe; the rest of the buffer must not cause an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        return _complain(f"cannot print: {error.strerror or error}")
    except MemoryError:
        return _complain("memory ran out; take fewer pixels, channels or frequencies")


def _with_negative(words: Sequence[str]) -> list[str]:
    """Attach negative numbers to their option, so that -5 is not read as an option."""
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
    lines = []
    for topic, names in TOPICS.items():
        lines += ["", f"{topic[0].upper()}{topic[1:]}"]
        lines += [f"  {name:<{width}}{COMMANDS[name][1]}" for name in names]
    return "\n".join(
        [
            "Underwater amplitude-modulated laser radar: from a survey to a 3D image.",
            "",
            "Usage: amulor COMMAND [OPTIONS]     amulor COMMAND --help     "
            "amulor --version",
            *lines,
        ]
    )


def _help_of(name: str) -> str:
    """Return the help of a command: summary, example, and the usual next command."""
    example, following = EXAMPLES[name]
    lines = [COMMANDS[name][1], f"Example: {example}"]
    return "\n\n".join([*lines, f"Next: {following}"] if following else lines)


def _run(words: list[str]) -> int:
    import logging
    from importlib import import_module

    from cyclopts import App, CycloptsError, Parameter

    from amulor.cli._arguments import UsageError
    from amulor.errors import AmulorError

    # matplotlib's advice about its settings folder, if no home is writable.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    app = App(
        name="amulor",
        help=_help().splitlines()[0],
        version_flags=[],
        default_parameter=Parameter(negative_iterable=()),
        suppress_keyboard_interrupt=False,
    )
    groups = {
        name: App(name=name, help=text, version_flags=[])
        for name, text in _GROUPS.items()
    }
    for group in groups.values():
        app.command(group)
    for name, (target, _) in COMMANDS.items():
        first, _, subcommand = name.partition(" ")
        if name in groups:  # a command by itself that has commands below it, too
            module, _, function = target.partition(":")
            imported = import_module(f"amulor.cli.{module}")
            groups[name].default(getattr(imported, function))
            groups[name].help = _help_of(name)
            continue
        place, command_name = (
            (groups[first], subcommand) if subcommand else (app, first)
        )
        # The text is that of the function, which is not imported for the list.
        place.command(f"amulor.cli.{target}", name=command_name, help=_help_of(name))
    for name, command in _ALIASES.items():
        first, _, subcommand = name.partition(" ")
        function = f"amulor.cli.{COMMANDS[command][0]}"
        groups[first].command(function, name=subcommand, show=False)
    try:
        with _ended_in_order():
            app(
                words,
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
    except CycloptsError as error:
        from amulor.cli._wrong_use import message

        example, _ = EXAMPLES.get(" ".join(error.command_chain or ()), ("", ""))
        _complain(message(error, example))
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
    """Request to end the program, sent by a signal of the operating system."""

    def __init__(self, number: int) -> None:
        self.signal = signal.Signals(number)


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Raise an exception on a termination signal, so that partial files are removed.

    The first SIGTERM or SIGHUP does so; further ones are ignored meanwhile. Signals
    that the program was started to ignore, as by nohup, stay ignored. Commands that
    drive devices use other handlers.
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
