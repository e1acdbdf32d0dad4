"""`amulor calibrate`: protocol, file, plot and numbers of each calibration."""

from __future__ import annotations

import json
import math
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor import io, rejection
from amulor.acquisition import Calibration
from amulor.cli import COMMANDS, calibrate, main
from amulor.simulation import simulate
from amulor.survey import Survey


@pytest.fixture(scope="module")
def clear(plate: Survey) -> Survey:
    return plate.with_(
        {
            "water.absorption": "0.02 1/m",
            "water.scattering": "0.001 1/m",
            "water.signal_fluctuation": 0.0,
            "instrument.modulation_frequencies": ["20 MHz", "50 MHz"],
            "scan.rows": 6,
            "scan.columns": 6,
            "scan.open_water": None,
        }
    )


@pytest.fixture
def here(clear: Survey, tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    samples = simulate(clear, rng=1)
    marked = {"shutter": "closed", "time_coverage_start": "2026-05-01T10:00:00Z"}
    io.write_cube(samples.assign_attrs(marked), Path("closed.nc"))
    for name, distance in (("near", 1.5), ("far", 2.0)):
        moved = clear.with_({"targets.0.position.2": distance})
        target = rejection.keep_water(simulate(moved, rng=2))
        io.write_cube(target, Path(f"{name}.nc"))
    return tmp_path


def run(words: str) -> None:
    assert main(shlex.split(words)) == 0, words


@pytest.mark.parametrize(
    "name",
    ["demodulator", "leakage", "polarizer", "reference", "temperature", "plate"],
)
def test_without_files_the_steps_are_printed(name: str, capsys) -> None:
    run(f"calibrate {name}")
    printed = capsys.readouterr().out
    steps = re.findall(r"^  (\d)\.", printed, re.MULTILINE)
    assert [*map(int, steps)] == [*range(1, len(steps) + 1)]
    # Each command in the steps exists, with the options that the step gives it.
    for line in re.findall(r"amulor (.+)", printed.replace("\\\n", " ")):
        words = shlex.split(line)
        pair = " ".join(words[:2])
        command = pair if pair in COMMANDS else words[0]
        assert command in COMMANDS, line
        run(f"{command} --help")
        page = capsys.readouterr().out
        for option in re.findall(r" (--[a-z-]+)", line):
            assert option in page, (command, option)


def test_leakage_has_a_file_with_date_and_digest_and_a_plot(here, capsys) -> None:
    run("calibrate leakage closed.nc -o leakage.toml")
    printed = capsys.readouterr().out
    calibration = Calibration.from_toml("leakage.toml")
    assert calibration.date.isoformat() == "2026-05-01"
    assert calibration.inputs == (cubes.digest(Path("closed.nc")),)
    assert cubes.digest(Path("leakage.toml")) in printed
    assert Path("leakage.png").read_bytes().startswith(b"\x89PNG")
    assert "50 MHz VH" in printed
    run("calibrate leakage closed.nc -o leakage.toml --overwrite --json")
    values = json.loads(capsys.readouterr().out)
    assert values["date"] == "2026-05-01"
    assert len(values["leakage"]) == 4
    assert main(shlex.split("calibrate leakage closed.nc -o leakage.toml")) == 1
    assert "exists already" in capsys.readouterr().err


def test_a_plate_has_a_file_with_phases_and_a_group_index(here, capsys) -> None:
    run(
        'calibrate plate near.nc far.nc --distance "1.5 m, 2.0 m" '
        '--distance-uncertainty "1 mm" -o phases.toml'
    )
    printed = capsys.readouterr().out
    calibration = Calibration.from_toml("phases.toml")
    # The simulated instrument has no delay; noise leaves some mrad.
    for entry in calibration.frequencies:
        assert_allclose(entry.phases, 0, atol=5e-3)
    assert "group index by the distances: 1.3" in printed
    # 1 mm over the root of two, there and back at the index 1.38: 6.5 ps.
    assert "uncertainty of the delay: 6.5 ps" in printed
    assert Path("phases.png").exists()
    run("calibrate plate near.nc --distance 1.5m -o one.toml")
    assert "state --distance-uncertainty" in capsys.readouterr().out


def test_new_leakage_keeps_the_phases_of_a_file(here) -> None:
    run("calibrate plate near.nc --distance 1.5m -o phases.toml")
    run("calibrate leakage closed.nc --calibration phases.toml -o both.toml")
    both, phases = (
        Calibration.from_toml(name) for name in ("both.toml", "phases.toml")
    )
    assert both.frequencies == phases.frequencies
    assert len(both.leakage) == 4
    digests = [cubes.digest(Path(name)) for name in ("closed.nc", "phases.toml")]
    assert [*both.inputs] == digests


def test_the_demodulator_has_a_file_and_leakage_keeps_it(here, capsys) -> None:
    silent = io.read_cube("closed.nc")
    names = []
    for turn in range(6):
        # A signal of 1 V whose quadrature output is 2 % too large.
        phase = math.radians(60 * turn)
        zero = 0 * silent["in_phase"]
        cube = silent.assign(
            in_phase=zero + math.cos(phase),
            quadrature=(zero + 1.02 * math.sin(phase)).assign_attrs(zero.attrs),
        )
        names.append(f"turn-{turn}.nc")
        io.write_cube(cube, Path(names[-1]))
    zero = silent.assign(in_phase=zero, quadrature=zero)
    io.write_cube(zero, Path("silent.nc"))
    run(f"calibrate demodulator silent.nc {' '.join(names)} -o mixer.toml")
    printed = capsys.readouterr().out
    assert re.search(r"50 MHz .*\+2\.000", printed)
    assert Path("mixer.png").read_bytes().startswith(b"\x89PNG")
    run("calibrate leakage closed.nc --calibration mixer.toml -o both.toml")
    both, mixer = (Calibration.from_toml(name) for name in ("both.toml", "mixer.toml"))
    assert both.demodulator == mixer.demodulator
    assert len(both.leakage) == 4


def test_the_polarizer_has_a_file_that_plates_keep(here, capsys) -> None:
    samples = io.read_cube("closed.nc")
    angles = range(0, 180, 30)
    for angle in angles:
        # Analyzers that pass 1 % of orthogonal light.
        first = math.cos(math.radians(angle)) ** 2
        factor = np.array([first, 1 - first]) * 0.99 + 0.01
        light = {
            name: samples[name].copy(
                data=samples[name].values[:, [0, 0]] * factor[:, None, None]
            )
            for name in ("in_phase", "quadrature")
        }
        io.write_cube(samples.assign(light), Path(f"a{angle}.nc"))
    files = " ".join(f"a{angle}.nc" for angle in angles)
    run(
        f"calibrate polarizer {files} --angles {','.join(map(str, angles))} "
        "-o channels.toml"
    )
    printed = capsys.readouterr().out
    assert re.search(r"50 MHz VH\W+1\.0", printed)
    assert Path("channels.png").read_bytes().startswith(b"\x89PNG")
    calibration = Calibration.from_toml("channels.toml")
    assert_allclose([e.crosstalk for e in calibration.channels], 0.01, rtol=1e-3)
    run("calibrate leakage closed.nc --calibration channels.toml -o both.toml")
    assert Calibration.from_toml("both.toml").channels == calibration.channels
    assert main(shlex.split(f"calibrate polarizer {files} -o b.toml")) == 2
    assert "--angles is missing" in capsys.readouterr().err


def test_cubes_with_light_are_refused_in_one_line(here, capsys) -> None:
    samples = io.read_cube("closed.nc")
    io.write_cube(samples.assign_attrs(shutter="open"), Path("open.nc"))
    assert main(shlex.split("calibrate leakage open.nc -o leakage.toml")) == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "--shutter-closed" in message
    assert not Path("leakage.toml").exists()


def test_the_steps_name_the_shutter_of_the_devices_file() -> None:
    assert "[shutter]" in calibrate._LEAKAGE_STEPS
