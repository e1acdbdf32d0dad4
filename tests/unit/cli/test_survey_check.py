"""The check of a survey prints what to expect, and warns of what will go wrong."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor import simulation
from amulor.cli import survey as commands
from amulor.errors import SurveyError
from amulor.simulation import Expectation
from amulor.survey import Survey, water_properties

Named = SimpleNamespace


def test_a_vehicle_has_distances_of_rows_columns_and_readings(printed) -> None:
    """Readings farther apart than columns, or than rows, are warned of."""
    platform = {
        "course": "line", "speed_m_per_s": 0.25, "track_m": 12.5,
        "between_rows_m": 0.02, "between_columns_m": 0.03, "along_readings_m": 0.015,
    }  # fmt: skip
    first = "vehicle: line, 0.25 m/s, track of 12.5 m"
    rows = "20 mm between rows, 30 mm between columns"
    warning = (
        "warning: the readings of a pixel are farther apart than neighboring pixels; "
        'shorten the dwell, or read at once (platform.readings = "at-once")'
    )
    commands._print_platform(platform)
    assert printed() == [first, rows, "readings of a pixel along 15 mm of the track"]
    commands._print_platform(platform | {"along_readings_m": 0.025})
    assert printed()[3:] == [warning]
    commands._print_platform(
        platform | {"along_readings_m": 0.025, "between_rows_m": 0.03}
    )
    assert len(printed()) == 3
    commands._print_platform(
        platform | {"along_readings_m": 0.035, "between_rows_m": 0.04}
    )
    assert printed()[3:] == [warning]
    # Without a target the distance of the columns is not known.
    commands._print_platform(platform | {"between_columns_m": None})
    assert printed() == [first, "20 mm between rows",
                         "readings of a pixel along 15 mm of the track"]  # fmt: skip


def expected(**changes: Any) -> Any:
    """Return the expected errors of two frequencies and channels."""
    fields: dict[str, Any] = {
        "hit": 0.75, "hit_each": (0.75,),
        "signal_to_noise": ((123.4, 5.0), (4.99, 40.0)),
        "water_to_echo": ((0.5, 0.25), (3.21, 0.125)), "saturated": 0.0,
    }  # fmt: skip
    return Expectation(**(fields | changes))


def instrument(survey: Survey) -> Survey:
    """Return the survey with two frequencies and two channels."""
    return survey.with_(
        {
            "instrument.modulation_frequencies": ["20 MHz", "40 MHz"],
            "instrument.polarizations": ["VV", "VH"],
        }
    )


def test_echoes_are_compared_with_noise_and_water(plate: Survey, printed) -> None:
    """A ratio below five is warned of; water of dark channels is not known."""
    commands._print_expected(instrument(plate), expected(), ("VH",))
    assert printed() == [
        "75% of the beams meet a target",
        "20 MHz VV: echo over noise 123, water over echo 0.5",
        "20 MHz VH: echo over noise 5, water over echo not known",
        "40 MHz VV: echo over noise 4.99, water over echo 3.2",
        "warning: VV at 40 MHz is mostly noise; more power, a longer dwell or a nearer "
        "target",
        "40 MHz VH: echo over noise 40, water over echo not known",
    ]


def test_a_scan_that_misses_its_targets_has_no_echo(plate: Survey, printed) -> None:
    """Each target that no beam meets is named."""
    aside = plate.with_({"targets.0.position": ["0 m", "0 m", "-1 m"]})
    commands._print_expected(
        instrument(aside), expected(hit=0.0, hit_each=(0.0,), saturated=0.5), ()
    )
    kind = plate.targets[0].kind
    assert printed() == [
        "0% of the beams meet a target",
        f"warning: no beam meets targets.0 ({kind}): it stands 1 m behind the "
        "instrument",
    ]


def test_overloads_of_the_detector_are_warned_of(plate: Survey, printed) -> None:
    """The voltage of saturation is that of the detector."""
    survey = instrument(plate).with_({"instrument.detector.saturation": "2.5 V"})
    commands._print_expected(survey, expected(saturated=0.125), ())
    assert printed()[-1] == (
        "warning: 12% of the samples overload the detector (2.5 V); less power or gain"
    )


def test_errors_of_the_instrument_are_summed_by_squares(printed) -> None:
    """Unknown errors make the sum a lower limit."""
    lines: Any = [
        Named(name="delay", now=3e-3, calibrated=0.3e-3, how="plate"),
        Named(name="gain", now=4e-3, calibrated=0.4e-3, how="demodulator"),
    ]
    commands._print_errors(lines, lines[1], 2.345)
    assert printed() == [
        "errors by the instrument at 2.35 m (standard uncertainty):",
        "delay: 3 mm, calibrated 0.3 mm (plate)",
        "gain: 4 mm, calibrated 0.4 mm (demodulator)",
        "total: 5 mm, all calibrated 0.5 mm",
        "do first: demodulator (gain)",
    ]
    lines.append(Named(name="drift", now=None, calibrated=1.2e-3, how="reference"))
    commands._print_errors(lines, None, 1.0)
    assert printed()[3:] == [
        "drift: unknown, calibrated 1.2 mm (reference)",
        "total: more than 5 mm, all calibrated 1.3 mm",
    ]


def water_of(**changes: Any) -> Any:
    """Return properties of a water with moments."""
    fields: dict[str, Any] = {
        "attenuation": 0.75, "group_index": 1.378, "source": "stated",
        "absorption": 0.25, "scattering": 0.5, "backscatter_vsf": 1.25e-3,
        "phase_function": None, "second_moment": 0.0625,
        "split_angle": math.radians(20), "layers": (), "depolarization_known": True,
    }  # fmt: skip
    return Named(**(fields | changes))


def test_a_water_is_printed_with_units(printed) -> None:
    """A water of layers has a line for each, the last one without an end."""
    function = Named(
        name="petzold", description="Petzold", asymmetry=0.92346,
        backscatter_fraction=0.018765,
    )  # fmt: skip
    commands._print_water(water_of())
    first = [
        "water: attenuation 0.75 1/m, group index 1.3780; stated",
        "absorption 0.25 1/m, scattering 0.5 1/m, at 180 degrees 0.00125 1/(m sr)",
    ]
    assert printed() == [
        *first,
        "phase function by moments: second moment 0.0625 rad^2 below 20 degrees",
    ]
    layers = tuple(
        Named(thickness=end, absorption=a, scattering=2 * a, phase_function=function)
        for end, a in ((1.5, 0.125), (math.inf, 0.25))
    )
    commands._print_water(water_of(phase_function=function, layers=layers))
    assert printed() == [
        *first,
        "phase function: Petzold",
        "asymmetry 0.9235, backscatter fraction 0.01877",
        "layer 1: 1.5 m thick, absorption 0.125 1/m, scattering 0.25 1/m, petzold",
        "layer 2: from there on, absorption 0.25 1/m, scattering 0.5 1/m, petzold",
    ]


def test_a_water_in_json_has_all_properties(plate: Survey) -> None:
    """Layers without an end, and waters without a whole function, have null."""
    content = commands._water(water_properties(plate))
    assert content["scattering"] == water_properties(plate).scattering
    assert (content["phase_function"], content["layers"]) == (None, [])
    assert (content["asymmetry"], content["backscatter_fraction"]) == (None, None)
    grains = [{"kind": "henyey-greenstein", "asymmetry": g} for g in (0.9, 0.8)]
    shared = {"absorption": "0.1 1/m", "scattering": "0.3 1/m"}
    layers = [
        {"thickness": "1 m", "phase_function": grains[0], **shared},
        {"phase_function": grains[1], **shared},
    ]
    layered = plate.with_(
        {"water": {"kind": "layers", "layers": layers}, "targets": []}
    )
    content = commands._water(water_properties(layered))
    assert [layer["thickness"] for layer in content["layers"]] == [1.0, None]
    first, second = content["layers"]
    for layer in (first, second):
        assert layer["absorption"] == pytest.approx(0.1)
        assert layer["scattering"] == pytest.approx(0.3)
    assert first["phase_function"] != second["phase_function"]
    whole = plate.with_({"water": {"phase_function": grains[0], **shared}})
    content = commands._water(water_properties(whole))
    assert content["asymmetry"] == pytest.approx(0.9, abs=1e-3)
    assert 0 < content["backscatter_fraction"] < 0.1


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ({"enough": (7, 5), "refused": "", "error": 0.123},
         "miss up to 12.3% of the water signal between them; plan at least 7 x 5 "
         "directions (scan.open_water)"),
        ({"enough": None, "refused": "too wide", "error": 0.1},
         "will be refused: too wide; no grid of shots is enough for so wide a scan: "
         "split it into parts"),
    ],
)  # fmt: skip
def test_sparse_shots_are_warned_of_with_a_remedy(printed, plan, words) -> None:
    """Columns come before rows."""
    scan: Any = Named(open_water=Named(columns=3, rows=2))
    commands._warn_of_sparse_shots(scan, Named(**plan))  # type: ignore[arg-type]
    assert printed() == [f"warning: 3 x 2 open-water shots {words}"]


@pytest.mark.parametrize(
    ("state", "reach", "words"),
    [
        ({}, (1.0, 2.0), "salinity and temperature of the water not stated"),
        ({"temperature": 10.0}, (1.0, 2.0), "salinity of the water not stated"),
        ({"salinity": 35.0}, None, "temperature of the water not stated"),
        ({"temperature": 10.0, "salinity": 35.0}, (1.0, 2.0), ""),
        ({"group_index": 1.34}, (1.0, 2.0), ""),
    ],
)
def test_a_state_that_is_not_given_makes_ranges_uncertain(
    plate: Survey, monkeypatch, printed, state, reach, words: str
) -> None:
    """An error of 0.003 of an index of 1.5 is 2 mm in a meter."""
    monkeypatch.setattr(
        "amulor.survey.properties.group_index_uncertainty", lambda survey: 0.003
    )
    fields = {"salinity": None, "temperature": None, "group_index": None} | state
    survey: Any = Named(
        water=Named(**fields), instrument=Named(polarizations=("VV", "VH"))
    )
    commands._warn_of_state(survey, water_of(group_index=1.5), reach)
    far = 1 if reach is None else 2
    missing = words.removesuffix(" of the water not stated")
    named = " and ".join(f"water.{name}" for name in missing.split(" and "))
    line = (
        f"warning: {words}: range uncertain by {2 * far} mm at {far} m (standard "
        f"uncertainty); state {named}"
    )
    assert printed() == ([line] if words else [])


def test_crossed_channels_of_water_by_coefficients_are_warned_of(
    plate: Survey, printed
) -> None:
    """Only channels that see turned polarization are named."""
    unknown = water_of(depolarization_known=False)
    survey_of_plate = plate.with_({"water.temperature": 10, "water.salinity": 35})
    commands._warn_of_state(
        survey_of_plate.with_({"instrument.polarizations": ["VV", "VH"]}), unknown, None
    )
    assert printed() == [
        "warning: how much of the water signal VH sees is not known: water stated by "
        "coefficients or layers keeps polarization here, waters of the sea lose a "
        "fifth of it; state water.backscatter_mueller"
    ]
    commands._warn_of_state(
        survey_of_plate.with_({"instrument.polarizations": ["VV"]}), unknown, None
    )
    assert printed() == []


def test_expectations_need_targets_and_may_be_unknown(
    plate: Survey, monkeypatch
) -> None:
    """The reason is that of the simulation."""

    assert commands._expected(plate.with_({"targets": []})) == (None, "")
    monkeypatch.setattr(simulation, "expectation", lambda survey: "good")
    assert commands._expected(plate) == ("good", "")

    def refuse(survey: Survey) -> None:
        raise SurveyError("no model")

    monkeypatch.setattr(simulation, "expectation", refuse)
    assert commands._expected(plate) == (None, "no model")


def test_a_check_prints_the_scan_and_its_warnings(
    plate: Survey, here, monkeypatch, printed
) -> None:
    """Each sample takes its dwell; ranges repeat after half a wavelength."""
    survey = instrument(plate).with_(
        {
            "scan.columns": 5, "scan.rows": 3, "scan.dwell": "100 ms",
            "scan.open_water": None, "water.group_index": 1.34, "targets": [],
        }
    )  # fmt: skip
    (here / "s.toml").write_text(survey.to_toml())
    commands.check(here / "s.toml")
    lines = printed()
    assert lines[0] == f"{here / 's.toml'}: {survey.name}"
    assert lines[1] == "5 x 3 pixels, 4 samples each, 6 s; 0 targets"
    # c / (2 n f).
    spans = [299792458 / (2 * 1.34 * value) for value in (20e6, 40e6)]
    for value, span in zip((20, 40), spans, strict=True):
        assert f"{value} MHz: unambiguous over {span:.3f} m" in lines
    assert lines[-1] == (
        "note: no open-water reference measurement is planned; without one only joint "
        "(two or more frequencies), unmix (ratios known) and cross-polarized work: add "
        "[scan.open_water]"
    )
    assert not any(line.startswith("beams meet") for line in lines)


def test_a_check_in_json_has_derived_values(plate: Survey, here, capsys) -> None:
    """Without a target there is no reach, no expectation and no error."""
    survey = instrument(plate).with_(
        {
            "scan.columns": 5, "scan.rows": 3, "scan.dwell": "100 ms",
            "scan.open_water": None, "water.group_index": 1.34, "targets": [],
        }
    )  # fmt: skip
    (here / "s.toml").write_text(survey.to_toml())
    commands.check(here / "s.toml", json=True)
    content = json.loads(capsys.readouterr().out)
    assert content["scan_time_s"] == pytest.approx(6.0)
    spans = [299792458 / (2 * 1.34 * value) for value in (20e6, 40e6)]
    assert content["ambiguity_interval_m"] == pytest.approx(spans)
    # Phases of 20 and 40 MHz repeat after the longer interval.
    assert content["phases_repeat_after_m"] == pytest.approx(spans[0])
    for name in ("target_reach_m", "open_water_plan", "platform", "expected",
                 "calibrate_first"):  # fmt: skip
        assert content[name] is None, name
    assert content["instrument_errors"] == []
    assert content["water"]["group_index"] == 1.34
    assert content["survey"]["scan"]["dwell"] == pytest.approx(0.1)


def test_a_check_of_a_plate_states_reach_and_errors(
    plate: Survey, here, monkeypatch, printed
) -> None:
    """The errors of the instrument are those in the middle of the reach."""
    plan = Named(holds=False, enough=(9, 9), refused="", error=0.25)
    monkeypatch.setattr(
        "amulor.rejection.reference.grid.judge_plan", lambda survey: plan
    )
    monkeypatch.setattr(commands, "_expected", lambda survey: (None, "no model"))
    (here / "s.toml").write_text(plate.to_toml())
    commands.check(here / "s.toml")
    lines = printed()
    (reach,) = [line for line in lines if line.startswith("beams meet targets at ")]
    low, high = (float(word) for word in reach.split()[4:7:2])
    assert low == pytest.approx(1.5, abs=0.01)
    assert low <= high < 1.51
    (errors,) = [line for line in lines if line.startswith("errors by the instrument")]
    assert float(errors.split()[5]) == pytest.approx((low + high) / 2, abs=0.01)
    assert any(line.startswith("do first: ") for line in lines)
    assert "what to expect is not known: no model" in lines
    assert any("miss up to 25.0% of the water signal" in line for line in lines)
    assert not any("no open-water" in line for line in lines)
    plan.holds = True
    commands.check(here / "s.toml")
    assert not any("miss up to" in line for line in printed())


def test_a_track_of_a_vehicle_has_distances(plate: Survey, monkeypatch) -> None:
    """At 2 m in 8 s, readings from 1 s to 3 s and 0.5 s long lie along 0.625 m."""
    survey: Any = Named(platform=Named(course=Named(kind="line")))
    monkeypatch.setattr("amulor.survey.course.planned_track", lambda survey: (2.0, 8.0))
    monkeypatch.setattr(
        "amulor.survey.course.planned_spacing",
        lambda survey, distance: (0.01, 0.02 * distance),
    )
    monkeypatch.setattr(
        "amulor.survey.directions.reading_windows",
        lambda survey: (np.array([1.0, 3.0, 2.0]), 0.5),
    )
    content = commands._footprint(survey, (1.0, 2.0))
    assert content == {
        "course": "line", "speed_m_per_s": 0.25, "track_m": 2.0,
        "between_rows_m": 0.01, "along_readings_m": pytest.approx(0.625),
        "between_columns_m": pytest.approx(0.03),
    }  # fmt: skip
    assert commands._footprint(survey, None)["between_columns_m"] is None
