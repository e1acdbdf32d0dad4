"""Words of the command line, exit codes, and the help of each command."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from amulor import cli
from amulor.cli import _arguments, _output, main
from amulor.cli._arguments import UsageError
from amulor.errors import AmulorWarning, CubeError, FormatError

Named: Any = SimpleNamespace


@pytest.mark.parametrize(
    ("words", "tied"),
    [
        (["--line", "-5cm,1cm"], ["--line=-5cm,1cm"]),
        (["--at", "-.5"], ["--at=-.5"]),
        (["--at", "-..5"], ["--at=-..5"]),
        (["--at", "5"], ["--at", "5"]),
        # Another value, an option with its value, or an option of one letter.
        (["--line=1", "-5"], ["--line=1", "-5"]),
        (["file", "-5"], ["file", "-5"]),
        (["-o", "-5"], ["-o", "-5"]),
        (["--flag", "-o"], ["--flag", "-o"]),
        (["--flag", "--5"], ["--flag", "--5"]),
        (["-5", "-6"], ["-5", "-6"]),
        (["--flag", "-", ""], ["--flag", "-", ""]),
        (["--a", "-1", "-2"], ["--a=-1", "-2"]),
        ([], []),
    ],
)
def test_a_negative_number_belongs_to_the_option_before_it(words, tied) -> None:
    """A number is no option, though it begins with a minus."""
    assert cli._with_negative(words) == tied


@pytest.mark.parametrize("words", [[], ["-h"], ["--help"]])
def test_the_help_lists_all_commands_by_topic(words, capsys) -> None:
    """Names stand in a column that is two wider than the longest of them."""
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == (
        "Underwater amplitude-modulated laser radar: from a survey to a 3D image."
    )
    assert lines[1] == ""
    assert lines[2] == (
        "Usage: amulor COMMAND [OPTIONS]     amulor COMMAND --help     amulor --version"
    )
    assert lines[3:6] == [
        "",
        "Measure",
        "  calibrate demodulator  Measure errors of the demodulator outputs; without "
        "cubes, print the steps.",
    ]
    listed = [line[2:].split("  ")[0] for line in lines[5:] if line.startswith("  ")]
    assert sorted(listed) == sorted(cli.COMMANDS)
    assert lines[-1] == (
        "  warm-up                Compile the numerical code for this computer, so "
        "that commands start faster."
    )


def test_the_help_of_a_command_has_its_example_and_the_next_one() -> None:
    """Some commands have no usual next one."""
    assert cli._help_of("reject") == (
        "Subtract the water signal from a measurement cube.\n\nExample: amulor reject "
        "samples.nc --method auto -o target.nc\n\nNext: amulor image, or amulor view"
    )
    assert cli._help_of("warm-up") == (
        "Compile the numerical code for this computer, so that commands start faster."
        "\n\nExample: amulor warm-up"
    )


def test_the_version_is_printed(capsys) -> None:
    """Alone, and not as an option of a command."""
    from amulor import __version__

    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"{__version__}\n"
    assert main(["info", "--version"]) == 2


def test_an_earlier_name_of_a_command_runs_it(capsys) -> None:
    """`calibrate plate` was once `devices calibrate`; the help does not show it."""
    assert main(["calibrate", "plate"]) == 0
    steps = capsys.readouterr().out
    assert main(["devices", "calibrate"]) == 0
    assert capsys.readouterr().out == steps
    assert main(["devices", "--help"]) == 0
    text = capsys.readouterr().out
    assert "simulate" in text
    assert "calibrate" not in text


def test_a_group_may_be_a_command_itself(capsys) -> None:
    """`water` prints constants, and has the command `fit` below it."""
    words = ["--wavelength", "405nm", "--temperature", "15", "--salinity", "0"]
    assert main(["water", *words]) == 0
    assert capsys.readouterr().out.startswith("Pure water, 405 nm, 15 degC, salinity 0")
    assert main(["water", "--help"]) == 0
    text = capsys.readouterr().out
    assert "Example: amulor water --wavelength" in text
    assert "fit" in text


@pytest.mark.parametrize(
    ("error", "code", "lines"),
    [
        (CubeError("one\ntwo"), 1, ["amulor: one", "amulor: two"]),
        (UsageError("wrong"), 2, ["amulor: wrong"]),
        (KeyboardInterrupt(), 130, ["amulor: interrupted"]),
        (cli._Ended(signal.SIGTERM), 143, ["amulor: ended by SIGTERM"]),
        (OSError(28, "No space left"), 1, ["amulor: cannot print: No space left"]),
        (OSError("odd"), 1, ["amulor: cannot print: odd"]),
        (MemoryError(), 1, ["amulor: memory ran out; take fewer pixels, channels or "
                            "frequencies"]),
    ],
)  # fmt: skip
def test_errors_have_lines_and_exit_codes(
    monkeypatch, capsys, error: BaseException, code: int, lines: list[str]
) -> None:
    """Each line of a message has the name of the program before it."""

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("amulor.cli.samples.samples", fail)
    monkeypatch.setattr("amulor.samples.samples", fail)
    assert main(["samples"]) == code
    assert capsys.readouterr().err.splitlines() == lines


def test_a_closed_pipe_ends_with_1_and_no_words(monkeypatch) -> None:
    """The rest of the buffer goes nowhere."""
    turned: list[tuple[int, int]] = []

    def fail(words: list[str]) -> int:
        raise BrokenPipeError

    monkeypatch.setattr(cli, "_answer", fail)
    monkeypatch.setattr(sys, "stdout", Named(fileno=lambda: 77))
    monkeypatch.setattr(os, "dup2", lambda old, new: turned.append((old, new)))
    assert main(["samples"]) == 1
    ((null, out),) = turned
    assert out == 77
    assert os.stat(null).st_rdev == os.stat(os.devnull).st_rdev
    os.close(null)


def test_the_words_are_those_of_the_program_by_default(monkeypatch, capsys) -> None:
    """The name of the program is none of them; garbage is frozen at the end."""
    registered: list[Any] = []
    monkeypatch.setattr(sys, "argv", ["amulor", "samples", "--output"])
    monkeypatch.setattr(atexit, "register", registered.append)
    assert main() == 2
    assert "samples: --output needs a value" in capsys.readouterr().err
    assert registered == [gc.freeze]


def test_a_first_signal_ends_the_work_and_further_ones_are_ignored() -> None:
    """Handlers of before come back after the work."""
    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, signal.SIG_DFL) for number in numbers]

    def work() -> None:
        with cli._ended_in_order():
            os.kill(os.getpid(), signal.SIGHUP)
            signal.sigtimedwait([], 0.5)

    def longer_work() -> None:
        with cli._ended_in_order():
            # A program that ignores one of them goes on doing so.
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            handler = signal.getsignal(signal.SIGTERM)
            assert callable(handler)
            try:
                handler(signal.SIGTERM, None)
            finally:
                assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN

    try:
        with pytest.raises(cli._Ended) as ended:
            work()
        assert ended.value.signal is signal.SIGHUP
        assert [signal.getsignal(n) for n in numbers] == [signal.SIG_DFL] * 2
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        with pytest.raises(cli._Ended):
            longer_work()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def test_warnings_of_one_kind_are_printed_once(capsys) -> None:
    """The kind is what stands before the colon; other warnings are shown as usual."""
    shown: list[str] = []

    def work() -> None:
        with _output.warnings_as_notes():
            for text in ("narrow: 1", "narrow: 2", "wide: 3"):
                warnings.warn(text, AmulorWarning, stacklevel=1)
            warnings.warn("other", UserWarning, stacklevel=1)
            raise CubeError

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_, **__: shown.append(str(message))
        with pytest.raises(CubeError):
            work()
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["warning: narrow: 1", "warning: wide: 3"]
    assert shown == ["other"]


def test_json_has_numbers_texts_and_null(capsys) -> None:
    """Arrays are lists, paths are texts, and what is not a number is null."""
    import numpy as np

    _output.print_json(
        {
            "array": np.array([[1.5, np.nan], [np.inf, 2.0]]), "path": Path("a/b"),
            "pair": (1, "x"), "number": np.float64(0.25), "flag": np.bool_(True),
            "nothing": None, "nan": float("nan"), "count": np.int16(3),
        }
    )  # fmt: skip
    text = capsys.readouterr().out
    import json

    assert json.loads(text) == {
        "array": [[1.5, None], [None, 2.0]], "path": "a/b", "pair": [1, "x"],
        "number": 0.25, "flag": True, "nothing": None, "nan": None, "count": 3,
    }  # fmt: skip
    assert text.splitlines()[1].startswith('  "array"')


def test_the_commonest_flag_is_printed_with_its_share(capsys) -> None:
    """Advice is given if nearly all values have it."""
    _output.print_flags({}, 10)
    assert capsys.readouterr().out == ""
    _output.print_flags({"mixed": 30, "outlier": 90, "saturated": 1}, 100)
    (line,) = capsys.readouterr().out.splitlines()
    assert line == (
        "commonest flag: outlier (90.0%); what it means: amulor explain OUTLIER"
    )
    _output.print_flags({"mixed": 3, "outlier": 91}, 100)
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("commonest flag: outlier (91.0%)")
    assert second.startswith("what to do: ")
    _output.print_flags({"unheard of": 10}, 10)
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_a_page_announces_its_address(monkeypatch, capsys) -> None:
    """A browser opens on request only."""
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    _output.announcing("scan: ", browser=False)("http://x")
    assert capsys.readouterr().out == "scan: http://x\nCtrl-C stops it.\n"
    assert opened == []
    _output.announcing(browser=True)("http://y")
    assert capsys.readouterr().out == "http://y\nCtrl-C stops it.\n"
    assert opened == ["http://y"]


def test_a_table_in_a_pipe_is_as_wide_as_needed(capsys) -> None:
    """The first column begins at the left, all others end at the right."""
    long = "x" * 300
    _output.print_table("Title", ["name", "a"], [["n", long], ["longer", "1"]])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].strip() == "Title"
    cells = [line.strip("│").split("│") for line in lines if line.startswith("│")]
    assert cells[0][0] == " n      "
    assert cells[1] == [" longer ", f" {'1':>300} "]


@pytest.mark.parametrize("terminal", [True, False])
def test_the_next_command_is_printed_on_a_terminal(monkeypatch, terminal) -> None:
    """In a pipe, programs read the results alone."""
    lines: list[str] = []
    out = Named(isatty=lambda: terminal, write=lines.append, flush=lambda: None)
    monkeypatch.setattr(sys, "stdout", out)
    _output.print_next("amulor view")
    assert "".join(lines) == ("next: amulor view\n" if terminal else "")


def test_two_pixels_are_a_row_and_a_column() -> None:
    """Another error may be raised in place of that of wrong use."""
    assert _arguments.row_and_column("20,5") == (20, 5)
    for text in ("20", "20,5,1", "a,b", "1.5,2", ""):
        with pytest.raises(UsageError, match="is no row and column; state"):
            _arguments.row_and_column(text)
    with pytest.raises(FormatError):
        _arguments.row_and_column("x", error=FormatError)


@pytest.mark.parametrize(
    ("text", "gate"),
    [(None, None), ("10ns,40ns", (10e-9, 40e-9)), ("0s, 1us", (0.0, 1e-6))],
)
def test_a_gate_is_two_increasing_times(text, gate) -> None:
    """Equal times, one time and three times are refused."""
    found = _arguments.gate_of(text)
    assert found == (None if gate is None else pytest.approx(gate))
    for wrong in ("10ns", "10ns,10ns", "2ns,1ns", "1ns,2ns,3ns"):
        with pytest.raises(UsageError, match="two increasing times, such as"):
            _arguments.gate_of(wrong)


@pytest.mark.parametrize(("option", "line"), [("--x", "--x: bad"), ("", "bad")])
def test_an_option_is_named_before_its_problem(option: str, line: str) -> None:
    """Without an option the message is that of the formula."""
    with pytest.raises(UsageError, match=f"^{line}$"), _arguments.refusing(option):
        raise ValueError("bad")


def test_quantities_of_options_have_units() -> None:
    """Another quantity, or a frequency below 0 Hz, is refused."""
    assert _arguments.quantity_of("--x", "25 mm", "length") == pytest.approx(0.025)
    with pytest.raises(UsageError, match=r"^--x: "):
        _arguments.quantity_of("--x", "25 V", "length")
    with pytest.raises(UsageError, match=r"^--f: .*at least 0 Hz, got -2e\+06 Hz$"):
        _arguments.frequencies_of("--f", "1 MHz, -2 MHz")


def test_inputs_exist_and_declare_what_they_can_hold(here, monkeypatch) -> None:
    """Cubes and LAS files are looked into; a missing option is no input."""
    looked: list[Any] = []
    monkeypatch.setattr(_arguments, "check_small", lambda p: looked.append(("nc", p)))
    monkeypatch.setattr(_arguments, "check_counts", lambda p: looked.append(("las", p)))
    names = ("a.NC", "b.nc4", "c.las", "d.LAZ", "e.toml")
    for name in names:
        Path(name).touch()
    _arguments.check_inputs(None, *map(Path, names))
    assert looked == [
        ("nc", Path("a.NC")), ("nc", Path("b.nc4")),
        ("las", Path("c.las")), ("las", Path("d.LAZ")),
    ]  # fmt: skip
    message = r"^gone\.nc does not exist; check the name and the folder$"
    with pytest.raises(FormatError, match=message):
        _arguments.check_inputs(Path("e.toml"), Path("gone.nc"))


def test_an_output_cube_has_its_ending_and_its_inputs(here) -> None:
    """Inputs are looked for if the ending is right, and are never replaced."""
    Path("there.nc").touch()
    check = _arguments.check_cube_output
    check(Path("new.nc"), overwrite=False, inputs=[Path("there.nc")])
    with pytest.raises(FormatError, match=r"gone\.nc does not exist"):
        check(Path("new.nc"), overwrite=False, inputs=[Path("gone.nc")])
    with pytest.raises(UsageError, match=r"--output new\.txt: the ending"):
        check(Path("new.txt"), overwrite=False, inputs=[Path("gone.nc")])
    with pytest.raises(FormatError, match=r"there\.nc exists already"):
        check(Path("there.nc"), overwrite=False, inputs=[])
    check(Path("there.nc"), overwrite=True, inputs=[])
    with pytest.raises(FormatError, match=r"there\.nc"):
        check(Path("there.nc"), overwrite=True, inputs=[Path("there.nc")])
