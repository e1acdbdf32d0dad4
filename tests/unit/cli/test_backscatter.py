"""`amulor backscatter` prints the published cut-offs and draws its picture."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from amulor.cli import backscatter, main
from amulor.simulation import transport

# The long tank, as rebuilt: k = 0.5 1/m, baseline 20 cm, parallel axes, n = 1.34.
TANK = """
name = "Long tank"
[water]
absorption = "0.15 1/m"
scattering = "0.35 1/m"
forward_fraction = 1.0
second_moment = "0.05 rad^2"
phase_function_at_180 = "0.001 1/sr"
refractive_index = 1.34
group_index = 1.34
[instrument]
phase_uncertainty = "0 deg"
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 1.0
modulation_frequencies = ["39 MHz"]
polarizations = ["none"]
[instrument.receiver]
position = ["20 cm", "0 m", "0 m"]
radius = "2 cm"
acceptance = "0.08 rad"
[scan]
columns = 1
rows = 1
azimuth_span = "0 deg"
elevation_span = "0 deg"
dwell = "100 ms"
"""


@pytest.fixture
def tank(tmp_path: Path) -> Path:
    path = tmp_path / "tank.toml"
    path.write_text(TANK)
    return path


def _json(words: list[str], capsys) -> dict:
    assert main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_cut_off_is_the_rebuilt_one(tank: Path, capsys) -> None:
    found = _json(["backscatter", str(tank), "--model", "diffusion"], capsys)
    # 19.0 MHz, to the digits printed.
    assert found["cut_off_hz"] / 1e6 == pytest.approx(19.0, abs=0.05)
    # The free fit of (71) lands 13 to 36 % below the half-power point.
    assert 0.6 < found["fitted_cut_off_hz"] / found["cut_off_hz"] < 0.9
    assert len(found["modulation_frequency_hz"]) == 200
    amplitude = np.array(found["relative_amplitude"])
    assert amplitude[0] == pytest.approx(1, abs=1e-3)
    assert (np.array(found["phase_rad"])[:20] > 0).all()


def test_the_group_index_moves_every_frequency_by_its_ratio(tank: Path, capsys) -> None:
    slow = _json(["backscatter", str(tank)], capsys)["cut_off_hz"]
    tank.write_text(TANK.replace("group_index = 1.34", "group_index = 1.38"))
    slower = _json(["backscatter", str(tank)], capsys)["cut_off_hz"]
    assert slower / slow == pytest.approx(1.34 / 1.38, rel=1e-9)


def test_the_default_has_the_cut_off_of_photons(tank: Path, capsys) -> None:
    # Photons in this water: 12.21 MHz (docs/gallery/ricci2010.md, figure 3).
    words = ["backscatter", str(tank), "--frequency", "1MHz:100MHz:30"]
    found = _json(words, capsys)
    assert found["model"] == "small-angle"
    assert found["cut_off_hz"] / 1e6 == pytest.approx(12.21, rel=0.03)
    # The closure is 5 % above (29) here, the paper's form half as high again.
    close = _json([*words, "--model", "closure"], capsys)
    assert close["cut_off_hz"] / found["cut_off_hz"] == pytest.approx(1.05, abs=0.02)
    paper = _json([*words, "--model", "diffusion"], capsys)
    assert 1.5 < paper["cut_off_hz"] / found["cut_off_hz"] < 1.65


def test_an_asymmetry_and_its_moments_say_the_same(tank: Path, capsys) -> None:
    words = ["backscatter", str(tank), "--frequency", "1MHz:100MHz:30"]
    moments = _json(words, capsys)["cut_off_hz"]
    # The Henyey-Greenstein function of this second moment, section 3.2 of the notes.
    tank.write_text(TANK.replace("[water]", "[water]\nasymmetry = 0.967"))
    assert _json(words, capsys)["cut_off_hz"] == pytest.approx(moments, rel=0.02)


def test_water_that_no_phase_function_has_is_refused(tank: Path, capsys) -> None:
    tank.write_text(TANK.replace("0.05 rad^2", "1.9 rad^2"))
    assert main(["backscatter", str(tank)]) == 1
    message = capsys.readouterr().err
    assert "second_moment must be" in message
    assert "diffusion model" in message
    assert main(["backscatter", str(tank), "--model", "diffusion"]) == 0


@pytest.mark.slow
def test_a_picture_is_drawn(tank: Path, tmp_path: Path, capsys) -> None:
    for name, start in (("a.png", b"\x89PNG"), ("b.svg", b"<?xml")):
        path = tmp_path / name
        words = ["backscatter", str(tank), "--plot", str(path)]
        assert main(words) == 0
        assert path.read_bytes().startswith(start)
        assert main(words) == 1
        assert "--overwrite" in capsys.readouterr().err
        assert main([*words, "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--frequency", "39"], "without a unit"),
        (["--frequency", "1MHz:2MHz"], "first, last and how many"),
        (["--frequency=-1 MHz"], "modulation_frequency"),
        (["--plot", "x.jpg"], ".png, .svg"),
        (["--error", "0%"], "above 0"),
    ],
)
def test_wrong_values_get_one_line(
    tank: Path, words: list[str], complaint: str, capsys
) -> None:
    assert main(["backscatter", str(tank), *words]) == 2
    message = capsys.readouterr().err
    assert complaint in message
    assert message.count("\n") == 1


def _with_asymmetry(path: Path, *, window: str = "") -> Path:
    text = TANK.replace("forward_fraction = 1.0\n", "asymmetry = 0.9\n")
    text = text.replace('second_moment = "0.05 rad^2"\n', "")
    text = text.replace('phase_function_at_180 = "0.001 1/sr"\n', "")
    path.write_text(text + window)
    return path


@pytest.mark.slow
def test_photons_agree_with_the_small_angle_model(tank: Path, capsys) -> None:
    words = ["backscatter", str(_with_asymmetry(tank)), "--frequency", "1MHz:60MHz:12"]
    photons = _json([*words, "--model", "montecarlo", "--error", "2 %"], capsys)
    formula = _json([*words, "--model", "small-angle"], capsys)
    light, error = (
        photons["power_share_unmodulated"],
        photons["power_share_unmodulated_uncertainty"],
    )
    assert error < 0.021 * light
    # The small-angle form is good to about a tenth in this water.
    assert light == pytest.approx(formula["power_share_unmodulated"], rel=0.12)
    assert photons["cut_off_hz"] == pytest.approx(
        formula["cut_off_hz"], abs=0.1 * formula["cut_off_hz"]
    )
    assert photons["cut_off_uncertainty_hz"] < 0.1 * photons["cut_off_hz"]
    assert len(photons["phase_uncertainty_rad"]) == 12
    assert sum(photons["share_by_scattering_order"]) == pytest.approx(1, abs=1e-9)
    assert not photons["heavy_tailed"]


@pytest.mark.slow
def test_photons_through_a_window_count_from_the_water(tank: Path, capsys) -> None:
    window = """
[instrument.window]
distance = "10 cm"
thickness = "2 cm"
"""
    words = ["--frequency", "1MHz,10MHz", "--model", "montecarlo", "--error", "3%"]
    words = ["backscatter", str(_with_asymmetry(tank, window=window)), *words]
    photons = _json(words, capsys)
    words[words.index("montecarlo")] = "small-angle"
    formula = _json(words, capsys)
    assert photons["phase_rad"] == pytest.approx(formula["phase_rad"], rel=0.08)


def test_photons_refuse_moments_that_no_phase_function_has(tank: Path, capsys) -> None:
    tank.write_text(TANK.replace("0.05 rad^2", "1.9 rad^2"))
    assert main(["backscatter", str(tank), "--model", "montecarlo"]) == 1
    error = capsys.readouterr().err
    assert "second_moment must be from" in error
    assert "got 1.9 rad^2" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("error", ["0%", "1 m", "little"])
def test_an_error_that_is_none_is_refused(tank: Path, error: str, capsys) -> None:
    words = ["backscatter", str(_with_asymmetry(tank)), "--model", "montecarlo"]
    assert main([*words, "--error", error]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_photons_that_were_interrupted_are_printed_and_no_success(
    tank: Path, capsys, monkeypatch
) -> None:
    # As Ctrl-C does after some batches, without a signal.
    real = transport.monte_carlo_response

    def run(survey, frequencies, **options):
        seen = []

        def progress(state) -> None:
            seen.append(state)
            if len(seen) > 3:
                raise KeyboardInterrupt

        return real(survey, frequencies, **{**options, "progress": progress})

    monkeypatch.setattr(transport, "monte_carlo_response", run)
    # What is told meanwhile is not asked here.
    monkeypatch.setattr("amulor.cli._output._SILENT", math.inf)
    words = ["backscatter", str(tank), "--model", "photons", "--frequency", "20MHz"]
    # A first run compiles the loops, and says so.
    assert main([*words, "--error", "0.01%"]) == 130
    capsys.readouterr()
    assert main([*words, "--error", "0.01%"]) == 130
    printed = capsys.readouterr()
    assert "Interrupted before the error was reached." in printed.out
    assert printed.err == "amulor: interrupted\n"


@pytest.mark.study
def test_the_closure_warns_of_a_narrow_receiver_in_one_line(
    tank: Path, tmp_path: Path, capsys
) -> None:
    def said(file: Path) -> str:
        assert main(["backscatter", str(file), "--model", "closure", "--json"]) == 0
        printed = capsys.readouterr()
        json.loads(printed.out)
        return printed.err

    assert "warning" not in said(tank)
    narrow = tmp_path / "narrow.toml"
    narrow.write_text(TANK.replace('"0.08 rad"', '"0.01 rad"'))
    line = said(narrow)
    assert line.count("warning: the closure does not hold in 1 of 1 columns") == 1
    assert line.count("\n") == 1
    assert line.endswith("use the small-angle model\n")


def test_a_receiver_without_light_is_refused(tank: Path, capsys, monkeypatch) -> None:
    dark = {"power_share_unmodulated": 0.0}
    monkeypatch.setattr(backscatter, "_formula", lambda *_, **__: dark)
    assert main(["backscatter", str(tank)]) == 1
    assert "gets no light from this water; check receiver" in capsys.readouterr().err
