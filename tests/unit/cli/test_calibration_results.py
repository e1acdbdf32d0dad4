"""Results of calibrations: tables of each part, files, and their digests."""

from __future__ import annotations

import datetime
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from amulor import acquisition, io
from amulor import cube as cubes
from amulor.acquisition import Calibration
from amulor.cli import calibrate, main
from amulor.cli._arguments import UsageError

Named: Any = SimpleNamespace


def test_leakage_is_printed_in_microvolts(printed) -> None:
    """Amplitudes of both outputs; a change that is unknown is empty."""
    leaks = [
        Named(modulation_frequency=39e6, polarization="VV", scan=(3e-6, -4e-6),
              scan_uncertainty=0.12e-6, open_water=(6e-6, 8e-6),
              open_water_uncertainty=0.34e-6, change=0.56e-6),
        Named(modulation_frequency=40e6, polarization="VH", scan=(0.0, 1e-6),
              scan_uncertainty=0.1e-6, open_water=(2e-6, 0.0),
              open_water_uncertainty=0.2e-6, change=None),
    ]  # fmt: skip
    calibrate._print_leakage(Named(leakage=leaks))
    assert printed() == [
        "Leakage [uV]",
        "scan u(scan) references u(references) change",
        "39 MHz VV 5 0.12 10 0.34 0.56",
        "40 MHz VH 1 0.1 2 0.2",
    ]
    calibrate._print_leakage(Named(leakage=()))
    assert printed() == []


def test_outputs_of_a_demodulator_are_printed_with_angles(printed) -> None:
    """Gain and angle are unknown if either of them has no uncertainty."""
    full: dict[str, Any] = {
        "modulation_frequency": 39e6, "offset": (1.5e-6, -2.5e-6),
        "offset_uncertainty": 0.21e-6, "quadrature_gain": 0.0123,
        "quadrature_gain_uncertainty": 0.0045, "quadrature_phase": math.radians(-1.25),
        "quadrature_phase_uncertainty": math.radians(0.5),
    }  # fmt: skip
    entries = [
        Named(**full),
        Named(**full | {"quadrature_gain_uncertainty": None}),
        Named(**full | {"quadrature_phase_uncertainty": None}),
    ]
    calibrate._print_demodulator(Named(demodulator=entries))
    assert printed() == [
        "Demodulator outputs",
        "offset [uV] u gain [%] u angle [deg] u",
        "39 MHz +1.5 -2.5 0.21 +1.230 0.450 -1.250 0.500",
        "39 MHz +1.5 -2.5 0.21 unknown 0.500",
        "39 MHz +1.5 -2.5 0.21 unknown 0.450",
    ]
    calibrate._print_demodulator(Named(demodulator=()))
    assert printed() == []


def test_channels_are_printed_with_gain_and_phase(printed) -> None:
    """A gain of 1.2 and 1.6 j is 2 at 0.9273 rad; its error is relative to it."""
    entry = Named(
        modulation_frequency=39e6, polarization="VH", crosstalk=0.0123,
        crosstalk_uncertainty=0.0045, gain=(1.2, 1.6), gain_uncertainty=0.003,
    )  # fmt: skip
    calibrate._print_channels(Named(channels=[entry]))
    assert printed() == [
        "Channels",
        "cross-talk [%] u gain u phase [mrad] u",
        "39 MHz VH 1.230 0.450 2.0000 0.0030 +927.30 1.50",
    ]
    calibrate._print_channels(Named(channels=()))
    assert printed() == []


def test_a_standing_reference_is_printed_with_its_change(printed) -> None:
    """The change is the span of all readings."""
    entry = Named(
        modulation_frequency=39e6, polarization="VV", phase=0.1234,
        uncertainty=0.00056, changes=(0.01, -0.02, 0.005),
    )  # fmt: skip
    calibrate._print_reference(Named(reference=[entry]))
    assert printed() == [
        "Standing reference [rad]",
        "phase u(phase) change",
        "39 MHz VV +0.1234 0.00056 0.0300",
    ]
    calibrate._print_reference(Named(reference=()))
    assert printed() == []


def test_a_gain_change_needs_its_uncertainty(printed) -> None:
    """A change of the gain without an error is not printed."""
    made = Named(
        frequencies=[
            Named(modulation_frequency=39e6, amplitudes=(1e-3,), phases=(0.5,),
                  phase_uncertainties=(0.01,)),
        ],
        delay_uncertainty=None, filters=(), gain_change=0.01,
        gain_change_uncertainty=None, group_index=None, group_index_uncertainty=None,
    )  # fmt: skip
    calibrate._print_phases(made)
    assert printed() == [
        "Phase zero [rad]",
        "at [mV] phase u(phase)",
        "39 MHz 1 +0.5000 0.0100",
        "uncertainty of the delay unknown: state --distance-uncertainty",
    ]


LEAK = {
    "modulation_frequency": 39e6, "polarization": "VV", "scan": (3e-6, 4e-6),
    "scan_uncertainty": 1e-7, "open_water": (6e-6, 8e-6),
    "open_water_uncertainty": 1e-7,
}  # fmt: skip
PHASE = {"modulation_frequency": 39e6, "amplitudes": (1e-3,), "phases": (0.5,)}
DAY = datetime.date(2026, 5, 1)


def measured(**changes: Any) -> Calibration:
    """Return a calibration with leakage."""
    return Calibration.model_validate({"date": DAY, "leakage": [LEAK]} | changes)


@pytest.fixture
def bench(here: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with two cubes, in which plots are not drawn."""
    for name in ("a.nc", "b.nc"):
        (here / name).write_text(name)
    monkeypatch.setattr(calibrate, "check_inputs", lambda *_: None)
    monkeypatch.setattr(io, "read_cube", lambda path: path.name)
    monkeypatch.setattr(
        "amulor.view.calibration.write_calibration",
        lambda path, result, overwrite: path.write_text(str(result.date)),
    )
    return here


def test_a_measurement_is_written_with_its_inputs(bench, printed) -> None:
    """Digests are those of the cubes; the plot lies beside the file."""
    cubes_read: list[Any] = []
    calibrate._measure(
        (Path("a.nc"), Path("b.nc")), Path("c.toml"),
        lambda scans: cubes_read.extend(scans) or measured(),  # type: ignore[func-returns-value]
        overwrite=False, json=False,
    )  # fmt: skip
    assert cubes_read == ["a.nc", "b.nc"]
    written = Calibration.from_toml(Path("c.toml"))
    inputs = [cubes.digest(Path(name)) for name in ("a.nc", "b.nc")]
    assert list(written.inputs) == inputs
    assert (bench / "c.png").read_text() == "2026-05-01"
    lines = printed()
    assert lines[:3] == [
        f"c.toml: measured on 2026-05-01, {cubes.digest(Path('c.toml'))}",
        "c.png: plot",
        "Leakage [uV]",
    ]


def test_a_measurement_in_json_has_digest_and_date(bench, capsys) -> None:
    """A calibration without a day has null."""
    for date, text in ((DAY, "2026-05-01"), (None, None)):
        calibrate._measure(
            (Path("a.nc"),), Path("c.toml"),
            lambda scans, date=date: measured(date=date),
            overwrite=True, json=True,
        )  # fmt: skip
        content = json.loads(capsys.readouterr().out)
        assert (content["output"], content["plot"]) == ("c.toml", "c.png")
        assert content["digest"] == cubes.digest(Path("c.toml"))
        assert content["date"] == text
        assert content["leakage"][0]["scan"] == [3e-6, 4e-6]


def test_parts_of_an_earlier_calibration_are_kept(bench) -> None:
    """The part that is measured is replaced, and the file is an input, too."""
    earlier = measured(date=datetime.date(2025, 1, 1), frequencies=[PHASE])
    Path("old.toml").write_text(earlier.to_toml())
    leak = LEAK | {"polarization": "VH"}
    calibrate._measure(
        (Path("a.nc"),), Path("c.toml"), lambda scans: measured(leakage=[leak]),
        replaced="leakage", calibration=Path("old.toml"), overwrite=False, json=False,
    )  # fmt: skip
    written = Calibration.from_toml(Path("c.toml"))
    assert [entry.polarization for entry in written.leakage] == ["VH"]
    assert written.frequencies == earlier.frequencies
    assert written.date == DAY
    assert written.inputs == tuple(
        cubes.digest(Path(name)) for name in ("a.nc", "old.toml")
    )
    with pytest.raises(UsageError, match=r"^old\.toml has phases of a plate"):
        calibrate._measure(
            (Path("a.nc"),), Path("d.toml"), lambda scans: measured(),
            replaced="temperature", calibration=Path("old.toml"), overwrite=False,
            json=False,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("replaced", "new", "kept"), [("leakage", None, 12.5), ("temperature", 15.0, 15.0)]
)
def test_the_temperature_of_the_phases_is_the_newer_one(
    bench, replaced, new, kept
) -> None:
    """A measurement without a temperature keeps that of the earlier file."""
    entry = {
        "modulation_frequency": 39e6, "phase_per_degree": 1e-3, "uncertainty": 1e-4,
        "temperatures": (10.0, 15.0), "phases": (0.1, 0.105),
    }  # fmt: skip
    stated = {"temperature": [entry], "reference_temperature": 12.5}
    Path("old.toml").write_text(measured(**stated).to_toml())
    found = (
        measured()
        if new is None
        else measured(**stated | {"reference_temperature": new})
    )
    calibrate._measure(
        (Path("a.nc"),), Path("c.toml"), lambda scans: found, replaced=replaced,
        calibration=Path("old.toml"), overwrite=False, json=False,
    )  # fmt: skip
    assert Calibration.from_toml(Path("c.toml")).reference_temperature == kept


@pytest.mark.parametrize("name", ["c.toml", "c.png"])
def test_file_and_plot_of_a_calibration_are_kept(bench, name) -> None:
    """Neither is replaced unasked."""
    (bench / name).write_text("mine")
    words = ["calibrate", "leakage", "a.nc", "-o", "c.toml"]
    assert main(words) == 1
    assert (bench / name).read_text() == "mine"


def test_numbers_that_a_formula_refuses_are_wrong_use(bench, capsys) -> None:
    """The message is that of the formula, without a file."""

    def refuse(scans: Any) -> Calibration:
        raise ValueError("angles are too few")

    with pytest.raises(UsageError, match="angles are too few"):
        calibrate._measure(
            (Path("a.nc"),), Path("c.toml"), refuse, overwrite=False, json=False
        )
    assert not Path("c.toml").exists()


@pytest.mark.parametrize(
    ("command", "function", "replaced"),
    [
        ("leakage", "from_shutter", "leakage"),
        ("demodulator", "from_terminated", "demodulator"),
        ("reference", "from_reference", "reference"),
        ("temperature", "from_temperatures", "temperature"),
    ],
)
def test_each_command_measures_its_part(
    monkeypatch, command, function, replaced
) -> None:
    """An earlier calibration is completed by the part of the command."""
    asked: list[Any] = []

    def measure(cubes: Any, output: Any, measure: Any, **more: Any) -> None:
        asked.append((cubes, output, measure(["a", "b"]), more))

    monkeypatch.setattr(calibrate, "_measure", measure)
    monkeypatch.setattr(acquisition, function, lambda *scans: scans)
    words = {
        "output": Path("c.toml"), "calibration": Path("old.toml"), "overwrite": True,
        "json": True,
    }  # fmt: skip
    getattr(calibrate, command)(Path("a.nc"), **words)
    ((cubes_given, output, scans, more),) = asked
    assert (cubes_given, output) == ((Path("a.nc"),), Path("c.toml"))
    expected = {"demodulator": ("a", ["b"]), "reference": ("a",)}
    assert scans == expected.get(command, (["a", "b"],))
    assert more == {
        "replaced": replaced, "calibration": Path("old.toml"), "overwrite": True,
        "json": True,
    }  # fmt: skip


def test_plates_have_distances_and_densities(monkeypatch) -> None:
    """One distance is that of all cubes; several are in the order of the cubes."""
    asked: list[Any] = []
    monkeypatch.setattr(
        calibrate, "_measure",
        lambda cubes, output, measure, **more: asked.append((measure("p"), more)),
    )  # fmt: skip
    monkeypatch.setattr(
        acquisition, "from_plates", lambda plates, **more: (plates, more)
    )
    calibrate.plate(Path("a.nc"), distance="150 cm", overwrite=True)
    calibrate.plate(
        Path("a.nc"), Path("b.nc"), distance="1.5 m, 2.5 m", densities="0,0.5",
        distance_uncertainty="2 mm", json=True,
    )  # fmt: skip
    assert asked == [
        (("p", {"distance": 1.5, "distance_uncertainty": None, "densities": None}),
         {"overwrite": True, "json": False}),
        (("p", {"distance": [1.5, 2.5], "distance_uncertainty": 2e-3,
                "densities": [0.0, 0.5]}),
         {"overwrite": False, "json": True}),
    ]  # fmt: skip


def test_angles_of_a_polarizer_are_in_degrees(monkeypatch) -> None:
    """The formula takes radians."""
    asked: list[Any] = []
    monkeypatch.setattr(
        calibrate, "_measure",
        lambda cubes, output, measure, **more: asked.append((measure("p"), more)),
    )  # fmt: skip
    monkeypatch.setattr(
        acquisition, "from_polarizer", lambda scans, angles: (scans, angles)
    )
    calibrate.polarizer(Path("a.nc"), angles="0,30,-90", overwrite=True, json=True)
    (((scans, angles), more),) = asked
    assert scans == "p"
    assert angles == pytest.approx([0.0, math.pi / 6, -math.pi / 2])
    assert more == {"overwrite": True, "json": True}


@pytest.mark.parametrize(
    "command",
    ["leakage", "demodulator", "polarizer", "reference", "temperature", "plate"],
)
def test_the_steps_are_printed_without_cubes(capsys, command) -> None:
    """The last step names the command itself, or the next one."""
    assert main(["calibrate", command]) == 0
    text = capsys.readouterr().out
    assert f"amulor calibrate {command}" in text
    assert text.splitlines()[1].startswith(("  1. ", "exactly"))


def test_a_reference_is_that_of_one_plate(capsys) -> None:
    """Two cubes are too many."""
    assert main(["calibrate", "reference", "a.nc", "b.nc", "-o", "c.toml"]) == 2
    message = "amulor: 2 cubes: one is needed, of one plate\n"
    assert capsys.readouterr().err == message
