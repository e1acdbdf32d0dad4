"""The water command prints what the formulas give, and errors in one line."""

from __future__ import annotations

import json

import pytest

from amulor import cli
from amulor.optics.water import seawater

WORDS = ["water", "--wavelength", "405nm", "--temperature", "20", "--salinity", "35"]


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    summary = "Print the optical constants of pure fresh or sea water."
    monkeypatch.setitem(cli.COMMANDS, "water", ("water:water", summary))


def changed(name: str, value: str) -> list[str]:
    words = [*WORDS, "--frequency", "39MHz"]
    words[words.index(name) + 1] = value
    return words


def test_json_holds_the_published_values(capsys) -> None:
    assert cli.main([*WORDS, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    # Quan and Fry (1995) at 405 nm, 20 degC and 35, six decimals.
    assert found["refractive_index_air"] == pytest.approx(1.349455, abs=5.1e-7)
    assert found["refractive_index_vacuum"] == pytest.approx(
        1.349455 * 1.000283, abs=1e-6
    )
    assert found["group_index"] == pytest.approx(1.388, abs=5.1e-4)
    # Pope and Fry (1997), and WOPP v3 between its nodes 0.00248 and 0.00257.
    assert found["absorption_pope_fry_1997_per_m"] == pytest.approx(0.0053)
    assert found["absorption_mason_2016_per_m"] == pytest.approx(0.002525)
    assert found["absorption_default"] == "mason_2016"
    # Zhang, Hu and He (2009), from the authors' program.
    assert found["molecular_scattering_per_m"] == pytest.approx(0.006248, abs=5.1e-7)
    assert found["molecular_backscattering_per_m"] == pytest.approx(0.003124, abs=5e-7)
    # c / (2 n f).
    interval = 299792458 / (2 * found["group_index"] * 39e6)
    assert found["ambiguity_interval_m"] == pytest.approx(interval, rel=1e-12)
    assert found["wavelength_m"] == pytest.approx(405e-9)


def test_the_text_names_sources_default_and_units(capsys) -> None:
    assert cli.main(WORDS) == 0
    text = capsys.readouterr().out
    for part in (
        "405 nm, 20 degC, salinity 35",
        "to air, 1.34984 to vacuum",
        "Mason 2016",
        "the default",
        "0.00530 1/m (Pope and Fry 1997",
        "0.006248 1/m",
        "at 39 MHz",
    ):
        assert part in text
    assert max(map(len, text.splitlines())) <= 88


def test_another_frequency_gives_another_interval(capsys) -> None:
    intervals = []
    for frequency in ("39MHz", "78MHz"):
        assert cli.main([*changed("--frequency", frequency), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        intervals.append(found["ambiguity_interval_m"])
    assert intervals[0] == pytest.approx(2 * intervals[1], rel=1e-12)


def test_the_state_that_is_asked_for_is_the_one_that_is_used(capsys) -> None:
    words = ["water", "--wavelength", "532nm", "--temperature", "15"]
    words += ["--salinity", "38", "--json"]
    assert cli.main(words) == 0
    found = json.loads(capsys.readouterr().out)
    index = seawater.group_index(532e-9, temperature=15, salinity=38)
    assert found["group_index"] == pytest.approx(float(index), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        (
            "--wavelength",
            "399nm",
            "known from 400 nm to 700 nm",
        ),
        ("--wavelength", "399.8nm", "from 400 nm to 700 nm"),
        ("--wavelength", "700.2nm", "from 400 nm to 700 nm"),
        ("--wavelength", "405", 'the wavelength as text such as "405 nm"'),
        ("--wavelength", "405MHz", "not one of wavelength"),
        ("--temperature", "31", "temperature must be from 0 to 30 [degC]"),
        ("--salinity", "50", "salinity must be from 0 to 43"),
        ("--frequency", "0Hz", "modulation_frequency must be finite and above 0 [Hz]"),
    ],
)
def test_what_is_out_of_range_gets_one_line(name, value, text, capsys) -> None:
    assert cli.main(changed(name, value)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("amulor: ")
    assert captured.err.count("\n") == 1
    assert text in captured.err


@pytest.mark.parametrize("left_out", ["--wavelength", "--temperature", "--salinity"])
def test_what_has_to_be_said_is_asked_for(left_out, capsys) -> None:
    position = WORDS.index(left_out)
    assert cli.main(WORDS[:position] + WORDS[position + 2 :]) == 2
    assert left_out in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("--wavelength", "400nm"),
        ("--wavelength", "700nm"),
        ("--temperature", "0"),
        ("--temperature", "30"),
        ("--salinity", "0"),
        ("--salinity", "43"),
    ],
)
def test_the_ends_of_a_range_belong_to_it(name, value, capsys) -> None:
    assert cli.main(changed(name, value)) == 0
    assert capsys.readouterr().err == ""
