"""Commands parse, call and print; mistakes get one line and the right exit code."""

from __future__ import annotations

import importlib
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import xarray as xr

from amulor import io
from amulor.cli import COMMANDS, EXAMPLES, TOPICS, main, survey
from amulor.cli._output import print_table, progress_bar
from amulor.cube import tiles
from amulor.studies.ladder import survey_text
from amulor.survey import Survey
from amulor.survey.properties import water_properties

RECORDINGS = ["import", "recordings", "none.csv"]
PLATE = ["calibrate", "plate", "a.nc", "--distance", "1 m", "-o", "x.toml"]
TRANSIENTS = ["import", "transients", "none.npz", "--frequency", "9MHz", "-o", "b.nc"]
ARRIVALS = ["import", "arrivals", "none.npz", "--group-index", "1", "-o", "b.nc"]
UNMIX = ["reject", "none.nc", "--method", "polarization", "-o", "b.nc"]
COLUMN = ["reject", "none.nc", "--method", "open-water", "-o", "b.nc"]
RATIOS = ["--target-ratio", "0.2", "--water-ratio", "0.1"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, plate_text: str) -> Path:
    """Return a folder in which the whole chain of commands has run."""
    folder = tmp_path_factory.mktemp("chain")
    (folder / "tank.toml").write_text(plate_text)
    for words in (
        "simulate tank.toml -o samples.nc --seed 4",
        "reject samples.nc --method open-water -o target.nc",
        "image target.nc --polarization VH -o range.nc",
        "export range.nc -o cloud.ply",
        "export range.nc -o cloud.laz",
        "export range.nc -o cloud.e57",
        "export range.nc -o cloud.nc",
        "report range.nc -o report.html",
    ):
        arguments = [
            str(folder / word) if "." in word else word for word in words.split()
        ]
        assert main(arguments) == 0, words
    return folder


def test_the_chain_of_commands_leaves_every_level(folder: Path) -> None:
    levels = {
        name: io.read_cube(folder / f"{name}.nc").attrs["level"]
        for name in ("samples", "target", "range", "cloud")
    }
    assert levels == {
        "samples": "samples",
        "target": "target_signal",
        "range": "range_image",
        "cloud": "point_cloud",
    }
    history = io.read_cube(folder / "cloud.nc").attrs["history"].splitlines()
    for line, step in zip(
        history,
        ("simulate", "reject", "image", "mixed", "outliers", "point cloud"),
        strict=True,
    ):
        assert step in line
    assert "data:image/png" in (folder / "report.html").read_text()


def test_help_answers_without_importing_what_it_does_not_need() -> None:
    code = (
        "import sys; from amulor.cli import main; main(['--help']);"
        "print('cyclopts' in sys.modules, 'numpy' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "False False"
    for name in COMMANDS:
        assert name in done.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_exists_and_says_what_the_help_says(name: str, capsys) -> None:
    target, summary = COMMANDS[name]
    module, function = target.split(":")
    found = getattr(importlib.import_module(f"amulor.cli.{module}"), function)
    assert (inspect.getdoc(found) or "").splitlines()[0] == summary
    assert main([*name.split(), "--help"]) == 0
    assert name.split()[-1] in capsys.readouterr().out


def test_each_command_has_one_topic() -> None:
    listed = [name for names in TOPICS.values() for name in names]
    assert sorted(listed) == sorted(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_a_command_has_the_options_that_it_needs(name, capsys) -> None:
    example, following = EXAMPLES[name]
    assert example.startswith(f"amulor {name}")
    assert main([*name.split(), "--help"]) == 0
    page = capsys.readouterr().out
    options = set(re.findall(r" (--?[a-z-]+)", example))
    assert options <= set(re.findall(r"(?<= )--?[a-z-]+", page))
    usage = " ".join(page.partition("\n\n")[0].split())
    needed = set(re.findall(r"--[a-z-]+(?= [A-Z])", usage.partition("[OPTIONS]")[0]))
    assert needed <= {{"-o": "--output"}.get(option, option) for option in options}
    assert "--empty-" not in page
    assert "[default: ()]" not in page
    for command in re.findall(r"amulor ([a-z-]+)", following):
        assert command in {each.partition(" ")[0] for each in COMMANDS}


@pytest.mark.parametrize("group", sorted({n.split()[0] for n in COMMANDS if " " in n}))
def test_the_help_of_a_group_says_what_each_command_does(group: str, capsys) -> None:
    assert main([group, "--help"]) == 0
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for name, (_, summary) in COMMANDS.items():
        if name.startswith(f"{group} "):
            assert f"{name.split()[1]} {summary}" in said


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_describes_every_parameter(name: str, capsys) -> None:
    target, _ = COMMANDS[name]
    module, function = target.split(":")
    found = getattr(importlib.import_module(f"amulor.cli.{module}"), function)
    assert main([*name.split(), "--help"]) == 0
    # The page is cut into columns; words in order are what can be looked for.
    page = " ".join(re.sub(r"[│╭╮╰╯─]", " ", capsys.readouterr().out).split())
    lines = (inspect.getdoc(found) or "").splitlines()
    for parameter in inspect.signature(found).parameters:
        described = lines[lines.index(parameter) + 1].split()
        assert " ".join(described[:2]) in page, parameter


@pytest.mark.parametrize(
    "name", ["simulate", "reject", "image", "import recordings", "export", "report"]
)
def test_the_help_states_the_size_above_which_work_goes_by_rows(name: str) -> None:
    module, function = COMMANDS[name][0].split(":")
    found = getattr(importlib.import_module(f"amulor.cli.{module}"), function)
    text = " ".join((inspect.getdoc(found) or "").split())
    # Files are measured in bytes of float64.
    words = f"more than {tiles.LARGE / 8e6:.1f} million (samples|pixels)"
    assert re.search(words, text)


def test_a_table_keeps_brackets_and_whole_words(capsys) -> None:
    path = "/data/[2026]/" + 90 * "x"
    print_table("Error [mm]", ["case [deg]", "n"], [["[/red]", ":smile:"], [path, "1"]])
    out = capsys.readouterr().out
    for text in ("Error [mm]", "case [deg]", "[/red]", ":smile:", path):
        assert text in out


def test_a_bar_keeps_brackets(monkeypatch, capsys) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with progress_bar() as advance:
        advance("reading /data/[2026]/[/x].nc", 0.5)
    assert "/data/[2026]/[/x].nc" in re.sub(
        r"\x1b\[[\d;?]*\w", "", capsys.readouterr().err
    )


def test_the_program_starts_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "amulor", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    from amulor import __version__

    assert done.stdout.strip() == __version__


def test_a_survey_is_checked_and_described(folder: Path, capsys) -> None:
    assert main(["survey", "check", str(folder / "tank.toml")]) == 0
    out = capsys.readouterr().out
    # Interval c / (2 n f) with the group index 1.38.
    assert "39 MHz: unambiguous over 2.785 m" in out
    assert main(["survey", "check", str(folder / "tank.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["water"]["group_index"] == 1.38
    assert found["scan_time_s"] == pytest.approx(12 * 6 * 2 * 0.125)


def test_a_check_names_what_the_water_does_not_state(
    plate_text: str, tmp_path: Path, capsys
) -> None:
    file = tmp_path / "tank.toml"
    bare = plate_text.replace("group_index = 1.38\n", "")
    bare = bare.replace("backscatter_mueller = [0.81, -0.81, -0.62]\n", "")
    file.write_text(bare, "utf-8")
    assert main(["survey", "check", str(file)]) == 0
    out = capsys.readouterr().out
    # Fresh water to 40 is 0.0089 of the index at 405 nm and 15 degC (Quan and Fry), 0
    # to 30 degC 0.0028, each over root 12: 0.0027 of 1.385, of 1.5 m.
    assert (
        "salinity and temperature of the water not stated: range uncertain by 2.9 mm "
        "at 1.5 m (standard uncertainty); state water.salinity and water.temperature"
    ) in out
    assert "how much of the water signal VH sees is not known" in out
    assert "VH: echo over noise" in out
    assert out.count("water over echo not known") == 1
    stated = 'salinity = 0\ntemperature = "20 degC"\n'
    stated += "backscatter_mueller = [0.81, -0.81, -0.62]\nsignal_fluctuation"
    file.write_text(bare.replace("signal_fluctuation", stated), "utf-8")
    assert main(["survey", "check", str(file)]) == 0
    out = capsys.readouterr().out
    assert "not stated" not in out
    assert "not known" not in out


def test_the_schema_of_surveys_is_json(capsys) -> None:
    assert main(["survey", "schema"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "amulor survey"


def test_info_tells_what_a_file_holds(folder: Path, capsys) -> None:
    assert main(["info", str(folder / "samples.nc"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["level"] == "samples"
    assert found["simulated"] is True
    assert found["modulation_frequencies_hz"] == [39e6]
    assert found["polarizations"] == ["VV", "VH"]
    assert main(["info", str(folder / "range.nc")]) == 0
    out = capsys.readouterr().out
    assert "range.nc: range image" in out
    assert "simulated" in out
    assert "6 rows, 12 columns" in out
    assert "channel: VH" in out
    assert "modulation: 39 MHz" in out
    image = io.read_cube(folder / "range.nc")
    median = float(image["slant_range"].median())
    assert f"slant range: median {median:.4f} m" in out
    assert "{" not in out
    # What is flagged, how often, and in which words.
    assert (
        main(
            [
                "reject",
                str(folder / "samples.nc"),
                "--method",
                "none",
                "-o",
                str(folder / "wet.nc"),
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "commonest flag: no_open_water (100.0%)" in said
    assert "what to do: Take open-water reference measurements" in said
    assert main(["info", str(folder / "wet.nc")]) == 0
    out = capsys.readouterr().out
    assert "flag no_open_water, 144 (100.0%): " in out
    assert "amulor explain NO_OPEN_WATER" in out


def test_a_command_names_the_usual_next_one_on_a_terminal_only(
    folder: Path, monkeypatch, capsys
) -> None:
    words = ["survey", "check", str(folder / "tank.toml")]
    assert main(words) == 0
    assert "next:" not in capsys.readouterr().out
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main(words) == 0
    assert f"next: amulor simulate {words[-1]}" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    assert "next:" not in capsys.readouterr().out


def test_a_plan_without_open_water_is_noted(
    tmp_path: Path, plate_text: str, capsys
) -> None:
    for text, noted in (
        (plate_text, False),
        (plate_text.partition("[scan.open_water]")[0], True),
    ):
        path = tmp_path / "tank.toml"
        path.write_text(text)
        assert main(["survey", "check", str(path)]) == 0
        said = "no open-water reference measurement is planned"
        assert (said in capsys.readouterr().out) == noted


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["reject"], "CUBE"),
        (["reject", "a.nc", "--method", "magic", "-o", "b.nc"], '"magic"'),
        (["simulate", "a.toml", "-o", "b.nc", "--seed", "one"], "found 'one'"),
        (["swim"], 'command "swim"'),
        (["survey", "czech"], 'command "czech"'),
        (["--verbose"], '"--verbose"'),
        (["info"], "FILE"),
        (["info", "a.nc", "b.nc"], "too many arguments: b.nc"),
        (["report", "-o", "x.html"], "IMAGES"),
        (
            ["calibrate", "plate", "a.nc", "-o", "x.toml"],
            "--distance is missing; state it, such as",
        ),
        (
            ["calibrate", "plate", "a.nc", "--distance", "1 m"],
            "--output is missing; state a file",
        ),
        (
            ["calibrate", "plate", "a.nc", "--distance", "1", "-o", "x.toml"],
            "a number without a unit; needed is the length",
        ),
        ([*PLATE, "--densities", "0;1"], "needed are numbers with commas"),
        ([*PLATE, "--densities", "-1"], "-1: optical densities are from 0 to 10"),
        (["calibrate", "leakage", "a.nc"], "--output is missing; state a file"),
        (["calibrate", "leakage", "a.nc", "-o", "x.png"], "use one of .toml"),
        (
            ["acquire", "a.toml", "-o", "b", "--shutter-closed", "--calibration", "c"],
            "measures the leakage; leave --calibration out",
        ),
        (
            ["devices", "simulate", "a.toml", "-o", "b.toml", "--lock-in", "mine"],
            '"mine"',
        ),
        (
            [
                "water",
                "--wavelength",
                "405nm",
                "--temperature",
                "warm",
                "--salinity",
                "0",
            ],
            "found 'warm', needed is",
        ),
        (["benchmark", "--scenes", "nowhere"], "there is no scene 'nowhere'"),
        (["reproduce", "ricci2010", "--figure", "one"], "found 'one'"),
        (
            ["reproduce", "ricci2010", "--figure", "2"],
            "figures 1 and 3 to 15 are redrawn",
        ),
        (
            ["acquire", "a.toml", "-o", "scan", "--retake-flagged"],
            "needs a scan to go on with: --resume",
        ),
        (["warm-up", "all"], "too many arguments: all"),
        (
            ["backscatter", "a.toml", "--frequency", "39"],
            "'39', a number without a unit; needed is the frequency",
        ),
        (["backscatter", "a.toml", "--plot", "x.jpg"], "use one of .png, .svg"),
        (
            ["view", "a", "--against", "b.nc", "--unit", "mm", "--save", "c.html"],
            "scans are in meters",
        ),
        (
            ["backscatter", "a.toml", "--scheduler", "local", "--batches", "b"],
            "goes with --model photons",
        ),
        (
            ["reproduce", "ricci2010", "--quick", "--scheduler", "local"],
            "--quick and --no-sensitivity leave out",
        ),
        (
            ["reproduce", "ricci2010", "--no-sensitivity", "--scheduler", "local"],
            "--quick and --no-sensitivity leave out",
        ),
        (
            ["backscatter", "a.toml", "--model", "photons", "--scheduler", "local"],
            "--scheduler and --batches go together",
        ),
        (
            ["backscatter", "a.toml", "--model", "photons", "--batches", "b"],
            "--scheduler and --batches go together",
        ),
        (
            ["import", "transients", "a.npz", "--frequency", "1 m", "-o", "b.nc"],
            "unit 'm' is not one of frequency",
        ),
        ([*TRANSIENTS, "--scan-side", "60"], "needed is the length"),
        ([*TRANSIENTS, "--gate", "9 ns"], "two increasing times"),
        ([*ARRIVALS, "--gate", "9 ns, 3 ns"], "two increasing times"),
        ([*ARRIVALS, "--neighbors", "-1"], "must not be negative"),
        (["export", "a.nc", "-o", "b.obj"], "use one of .ply"),
        (["simulate", "a.toml", "-o", "b.csv"], "use one of .nc"),
        (["reject", "a.nc", "--method", "auto", "-o", "b.txt"], "use one of .nc"),
        ([*UNMIX, "--option", "loud"], "must be \"name=value\", got 'loud'"),
        (["image", "a.nc", "-o", "b.png"], "use one of .nc"),
        (["recover", "scan", "-o", "b"], "use one of .nc"),
        (["design", "a.toml"], "needed is --output survey.toml, or --interactive"),
        (["design", "a.toml", "-o", "b.nc"], "use one of .toml"),
        (
            ["design", "a.toml", "-o", "b.toml", "--runner-up", "b.toml"],
            "name the same file",
        ),
        (["site", "check"], "SITE"),
        (["site", "register", "a.toml", "-o", "b.txt"], "use one of .json"),
        (
            ["site", "merge", "a.toml", "--poses", "p.json", "-o", "b", "--tile", "5"],
            "'5', a number without a unit",
        ),
        (
            ["site", "compare", "a.toml", "--poses", "p.json", "-o", "b.txt"],
            "use one of .csv",
        ),
        (
            ["site", "report", "a.toml", "--poses", "p.json", "-o", "b.pdf"],
            "use one of .html",
        ),
        (["run", "a.toml"], "--output"),
        (["archive"], "name a project file and the folder"),
        (["archive", "a.toml"], "name a project file and the folder"),
        (
            ["archive", "a.toml", "--check", "folder"],
            "--check looks at an archive; give no project",
        ),
        (["view", "a.nc", "--port", "70000"], "Must be < 65536"),
        (["watch", "scan", "--every", "0 s"], "needed is a time above 0, found 0 s"),
        (["explain", "MIXED", "--loud"], "--loud"),
        (["samples", "ladders"], "no sample data 'ladders'; there are ladder"),
        (["view", "a.nc", "--save", "b.png"], "use one of .html"),
        (["view", "a.nc", "--farthest", "1 m"], "must be given together"),
        (["image", "a.nc", "-o", "b.nc", "--nearest", "1 m"], "must be given together"),
        (
            ["image", "a.nc", "-o", "b.nc", "--nearest", "2 m", "--farthest", "1 m"],
            "got 2 to 1 m",
        ),
        (
            [*UNMIX, *RATIOS, "--water-fluctuation", "5 m"],
            "unit 'm' is not one of fraction",
        ),
        (
            [
                "reject",
                "a.nc",
                "--method",
                "frequency",
                "-o",
                "b.nc",
                "--frequency",
                "39",
            ],
            "a number without a unit",
        ),
        (
            [*COLUMN, "--column-uncertainty", "much"],
            "'much', which is no number with a unit",
        ),
        (
            ["backscatter", "none.toml", "--frequency", "-5MHz"],
            "at least 0 Hz, got -5e+06 Hz",
        ),
        (
            ["image", "a.nc", "-o", "b.nc", "--nearest", "-.5 m", "--farthest", "1 m"],
            "got -0.5 to 1 m",
        ),
        ([*PLATE, "--densities", "nan"], "nan: needed are finite numbers"),
        (
            ["design", "a.toml", "--interactive", "--runner-up", "b.toml"],
            "--runner-up goes with --output",
        ),
        (
            ["report", "a.nc", "-o", "b.html", "--check", "1,2 3,4 4mm 1mm 1mm"],
            "too many words, or a negative number",
        ),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, list) else "",
)
def test_wrong_use_ends_with_2_and_one_line(
    words: list[str], named: str, capsys
) -> None:
    # The files do not exist: what the words alone say is looked at before.
    assert named in _fails(words, capsys, code=2, lines=1)


@pytest.mark.parametrize(
    "words",
    [
        ["survey", "check", "none.toml"],
        ["survey", "preset", "nonesuch", "-o", "b.toml"],
        ["simulate", "none.toml", "-o", "b.nc"],
        ["backscatter", "none.toml"],
        ["design", "none.toml", "-o", "b.toml"],
        ["acquire", "none.toml", "-o", "scan"],
        ["recover", "none"],
        ["devices", "simulate", "none.toml", "-o", "b.toml"],
        ["calibrate", "demodulator", "none.nc", "-o", "b.toml"],
        ["calibrate", "polarizer", "none.nc", "--angles", "0", "-o", "b.toml"],
        ["calibrate", "leakage", "none.nc", "-o", "b.toml"],
        ["calibrate", "reference", "none.nc", "-o", "b.toml"],
        ["calibrate", "platform", "none.nc", "--trajectory", "t.csv", "-o", "b.toml"],
        ["calibrate", "temperature", "none.nc", "-o", "b.toml"],
        ["calibrate", "plate", "none.nc", "--distance", "1 m", "-o", "b.toml"],
        ["devices", "calibrate", "none.nc", "--distance", "1 m", "-o", "b.toml"],
        TRANSIENTS,
        ARRIVALS,
        [*RECORDINGS, "--survey", "none.toml", "--columns", "none.toml", "-o", "b.nc"],
        ["import", "trajectory", "none.csv", "-o", "b.csv"],
        ["info", "none.nc"],
        ["water", "fit", "none.nc"],
        [*UNMIX, *RATIOS],
        COLUMN,
        ["image", "none.nc", "-o", "b.nc"],
        ["export", "none.nc", "-o", "b.ply"],
        ["site", "check", "none.toml"],
        ["site", "register", "none.toml", "-o", "b.json"],
        ["site", "merge", "none.toml", "--poses", "p.json", "-o", "b"],
        ["site", "drawings", "none.toml", "-o", "b.pdf"],
        ["run", "none.toml", "-o", "folder"],
        ["archive", "none.toml", "-o", "folder"],
        ["archive", "--check", "none"],
        ["view", "none.nc"],
        ["watch", "none"],
        ["benchmark", "--scenes", "none.toml"],
        ["profile", "none.nc", "--pixel", "1,1"],
        ["explain", "nonesuch"],
        ["samples", "ladder", "-o", "no/where"],
        ["view", "none", "--save", "b.html"],
        ["report", "none.nc", "-o", "b.html"],
        ["demo", "-o", "no/where"],
        ["reproduce", "ricci2010", "--quick", "--figure", "1", "-o", "no/where"],
    ],
    ids=" ".join,
)
def test_a_file_that_is_not_there_ends_with_1_and_one_line(
    words: list[str], tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    message = _fails(words, capsys, lines=1)
    assert "none" in message or "no/where" in message
    assert list(tmp_path.iterdir()) == []


def test_every_command_was_asked_wrongly() -> None:
    """Compare the commands of the two tests above with all that there are."""
    asked = set()
    for test in (
        test_wrong_use_ends_with_2_and_one_line,
        test_a_file_that_is_not_there_ends_with_1_and_one_line,
    ):
        for case in test.pytestmark[0].args[1]:
            words = case[0] if isinstance(case, tuple) else case
            asked |= {words[0], " ".join(words[:2])}
    take_nothing = {"survey schema", "survey presets", "site schema"}
    assert set(COMMANDS) - asked == take_nothing


def _fails(words: list[str], capsys, *, code: int = 1, lines: int | None = None) -> str:
    assert main(words) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("amulor: ")
    assert "Traceback" not in captured.err
    assert lines is None or captured.err.count("\n") == lines
    return captured.err


def test_an_output_that_exists_is_kept_unless_overwritten(folder: Path, capsys) -> None:
    words = ["simulate", str(folder / "tank.toml"), "-o", str(folder / "samples.nc")]
    before = (folder / "samples.nc").read_bytes()
    message = _fails(words, capsys)
    assert "--overwrite" in message
    assert "samples.nc" in message
    assert message.count("\n") == 1
    assert (folder / "samples.nc").read_bytes() == before
    assert main([*words, "--overwrite", "--seed", "4"]) == 0


@pytest.mark.parametrize(
    "words",
    [
        ["image", "samples.nc", "-o", "new.nc"],
        ["export", "target.nc", "-o", "new.ply"],
        ["reject", "range.nc", "--method", "open-water", "-o", "new.nc"],
        ["report", "samples.nc", "-o", "new.html"],
    ],
)
def test_a_cube_of_another_level_names_the_remedy(
    folder: Path, words: list[str], capsys
) -> None:
    full = [str(folder / word) if "." in word else word for word in words]
    message = _fails(full, capsys)
    assert "needed" in message
    assert not (folder / words[-1]).exists()


def test_a_channel_is_accepted_in_lower_case(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "image.nc"
    words = ["image", str(folder / "target.nc"), "--polarization", "vh"]
    assert main([*words, "-o", str(output)]) == 0
    assert io.read_cube(output).attrs["polarization"] == "VH"


def test_a_range_image_needs_a_channel_and_both_limits(folder: Path, capsys) -> None:
    words = ["image", str(folder / "target.nc"), "-o", str(folder / "new.nc")]
    assert "--polarization" in _fails(words, capsys)
    limit = [*words, "--polarization", "VV", "--nearest", "1 m"]
    assert "together" in _fails(limit, capsys, code=2)
    unit = [*limit, "--farthest", "2 s"]
    assert "not one of length" in _fails(unit, capsys, code=2)
    empty = [*limit, "--farthest", "0.5 m"]
    assert "interval must run" in _fails(empty, capsys, code=2)


def test_unmixing_takes_stated_ratios(folder: Path, capsys) -> None:
    words = ["reject", str(folder / "samples.nc"), "--method", "polarization"]
    words += ["-o", str(folder / "unmixed.nc")]
    both = [*words, "--target-ratio", "0.2", "--water-ratio", "0.2"]
    assert "cannot tell them apart" in _fails(both, capsys, code=2)
    assert main([*words, "--target-ratio", "0.242", "--water-ratio", "0.105"]) == 0


def test_without_open_water_only_methods_that_need_none_are_named(
    tmp_path: Path, plate_text: str, capsys
) -> None:
    dry = tmp_path / "dry.toml"
    dry.write_text(plate_text.partition("[scan.open_water]")[0])
    cube = str(tmp_path / "dry.nc")
    assert main(["simulate", str(dry), "-o", cube]) == 0
    capsys.readouterr()
    target = str(tmp_path / "target.nc")
    err = _fails(["reject", cube, "--method", "polarization", "-o", target], capsys)
    assert "polarization with both ratios stated" in err
    assert "polarimetric" not in err
    # One of those that are named, and it runs.
    assert "cross-polarized" in err
    words = ["reject", cube, "--method", "cross-polarized", "-o", target]
    assert main(words) == 0
    capsys.readouterr()
    assert main(["reject", cube, "--method", "auto", "-o", f"{target}.nc"]) == 0
    notes = re.findall(r"^[a-z][a-z -]*.*?: (.*)$", capsys.readouterr().out, re.M)
    assert len(notes) == len(set(notes))


def test_a_survey_with_two_mistakes_prints_two_lines(folder: Path, capsys) -> None:
    text = survey_text("clear").replace('"20 mW"', '"20 m"').replace("rows = 40", "")
    path = folder / "typo.toml"
    path.write_text(text)
    message = _fails(["survey", "check", str(path)], capsys)
    assert message.count("\n") == 2
    assert all(str(path) in line for line in message.splitlines())


def test_an_interrupt_ends_with_130(monkeypatch, folder: Path, capsys) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(xr, "open_dataset", interrupt)
    monkeypatch.setattr("amulor.io.read_cube", interrupt)
    assert main(["info", str(folder / "samples.nc")]) == 130
    assert "interrupted" in capsys.readouterr().err


@pytest.mark.parametrize("seed", ["-1", "9223372036854775808", "one"])
def test_a_seed_that_cannot_be_kept_is_wrong_use(
    folder: Path, seed: str, tmp_path: Path, capsys
) -> None:
    words = ["simulate", str(folder / "tank.toml"), "-o", str(tmp_path / "x.nc")]
    assert main([*words, f"--seed={seed}"]) == 2
    assert not (tmp_path / "x.nc").exists()


def test_an_input_is_never_replaced(folder: Path, capsys) -> None:
    survey = folder / "tank.toml"
    before = survey.read_bytes()
    message = _fails(
        ["simulate", str(survey), "-o", str(survey), "--overwrite"], capsys
    )
    assert "is what is read" in message
    assert survey.read_bytes() == before
    image = str(folder / "range.nc")
    _fails(["report", image, "-o", image, "--overwrite"], capsys)


def test_an_output_that_cannot_be_is_refused_before_the_work(
    folder: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    def work(*_: object, **__: object) -> None:
        raise AssertionError("the work was begun")

    monkeypatch.setattr("amulor.simulation.simulate", work)
    words = ["simulate", str(folder / "tank.toml")]
    assert "no folder" in _fails([*words, "-o", str(tmp_path / "no" / "x.nc")], capsys)
    assert "--overwrite" in _fails([*words, "-o", str(folder / "samples.nc")], capsys)


def test_the_demo_looks_at_all_its_outputs_first(tmp_path: Path, capsys) -> None:
    (tmp_path / "report.html").write_text("mine")
    assert "report.html" in _fails(["demo", "-o", str(tmp_path)], capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.slow
def test_images_of_one_name_from_two_folders_are_both_drawn(
    folder: Path, tmp_path: Path, capsys
) -> None:
    other = tmp_path / "range.nc"
    other.write_bytes((folder / "range.nc").read_bytes())
    page = tmp_path / "both.html"
    assert main(["report", str(folder / "range.nc"), str(other), "-o", str(page)]) == 0
    assert f"2: {tmp_path.name}/range" in page.read_text()
    assert "2 range images" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("columns", "rows"),
    [
        pytest.param(12, 1, marks=pytest.mark.slow),
        (1, 6),
        pytest.param(1, 1, marks=pytest.mark.slow),
    ],
)
def test_a_line_or_a_point_goes_through_the_chain(
    plate_text: str, tmp_path: Path, columns: int, rows: int, capsys
) -> None:
    text = plate_text.replace("columns = 12", f"columns = {columns}")
    (tmp_path / "line.toml").write_text(text.replace("rows = 6", f"rows = {rows}"))
    for words in (
        "simulate line.toml -o a.nc",
        "reject a.nc --method open-water -o b.nc",
        "image b.nc --polarization VV -o c.nc",
        "export c.nc -o d.e57",
        "report c.nc -o e.html",
    ):
        full = [str(tmp_path / w) if "." in w else w for w in words.split()]
        assert main(full) == 0, words


@pytest.mark.slow
def test_an_empty_scene_is_said_in_words(
    plate_text: str, tmp_path: Path, capsys
) -> None:
    (tmp_path / "t.toml").write_text(plate_text.replace('"1.5 m"', '"-1.5 m"'))
    for words in (
        "simulate t.toml -o a.nc",
        "reject a.nc --method open-water -o b.nc",
        "image b.nc --polarization VV -o c.nc",
        "report c.nc -o e.html",
    ):
        full = [str(tmp_path / w) if "." in w else w for w in words.split()]
        assert main(full) == 0, words
    assert "without a usable pixel" in capsys.readouterr().out
    assert "nan" not in (tmp_path / "e.html").read_text().split("</table>")[0]


def test_a_closed_pipe_and_a_full_disk_make_no_traceback() -> None:
    for tail, code in (("| true", None), ("> /dev/full", 1)):
        done = subprocess.run(
            ["bash", "-c", f"{sys.executable} -m amulor --help {tail}"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert "Traceback" not in done.stderr
        assert "Exception" not in done.stderr
        assert code is None or done.returncode == code


@pytest.mark.parametrize("saturation", ["1 V", "5 mV", "1 uV"])
def test_a_simulation_states_the_shares_of_its_cube(
    saturation: str, tmp_path: Path, plate_text: str, capsys
) -> None:
    survey, output = tmp_path / "tank.toml", tmp_path / "samples.nc"
    # A narrow plate: some beams pass it.
    detector = "[instrument.detector]"
    text = plate_text.replace(detector, f'{detector}\nsaturation = "{saturation}"')
    survey.write_text(text.replace('width = "30 cm"', 'width = "5 cm"'))
    assert main(["simulate", str(survey), "-o", str(output)]) == 0
    cube = io.read_cube(output)
    hit = float((cube.amulor.truth["target"] >= 0).mean())
    overload = float((cube["saturated"] == 1).mean())
    assert 0.1 < hit < 0.9
    assert (overload > 0) == (saturation != "1 V")
    assert (
        f"{hit:.1%} of the beams meet a target, {overload:.1%} of the samples overload"
        in capsys.readouterr().out
    )


def test_a_check_without_a_target_states_the_error_of_a_metre(
    plate: Survey, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = plate.with_({"water.group_index": None})
    water = water_properties(bare)
    for reach, expected in ((None, "2 mm at 1 m "), ((0.5, 4.0), "7.8 mm at 4 m ")):
        survey._warn_of_state(bare, water, reach)
        # 2.9 mm of 1.5 m, as above.
        assert f"range uncertain by {expected}" in capsys.readouterr().out
