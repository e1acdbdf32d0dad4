"""Numbers of a survey file that no instrument has are refused, with the reason."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor import units
from amulor.errors import SurveyError
from amulor.simulation import simulate
from amulor.survey import Survey
from amulor.survey.limits import LIMITS, beyond

SLIPS = {
    "receiver far off": ('["7 cm",', '["70 m",', "at most 20.0 m: emitter and"),
    "scattering": ('"0.595 1/m"', '"6e12 1/m"', "at most 1000.0 1/m: undiluted milk"),
    "absorption": ('"0.255 1/m"', '"1e12 1/m"', "at most 1000.0 1/m"),
    "power": ('power = "20 mW"', 'power = "20 kW"', "at most 100.0 W: modulated"),
    "millihertz": ('["39 MHz"]', '["39 mHz"]', "at least 1000.0 Hz: below, phases"),
    "dwell": ('dwell = "125 ms"', 'dwell = "2 h"', "at most 3600.0 s"),
}


def _file(text: str, folder: Path) -> Path:
    path = folder / "survey.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", SLIPS)
def test_a_slip_in_a_file_is_refused_with_the_reason(
    name: str, plate_text: str, tmp_path: Path
) -> None:
    old, new, said = SLIPS[name]
    changed = plate_text.replace(old, new, 1)
    assert changed != plate_text
    with pytest.raises(SurveyError, match=said) as refused:
        Survey.from_toml(_file(changed, tmp_path))
    message = str(refused.value)
    assert message.count("\n") == 0
    assert "survey.toml: " in message


def test_each_slip_gets_its_line(plate_text: str, tmp_path: Path) -> None:
    text = plate_text.replace('["39 MHz"]', '["39 mHz", "50 MHz"]')
    text = text.replace('dwell = "125 ms"', 'dwell = "2 h"')
    with pytest.raises(SurveyError) as refused:
        Survey.from_toml(_file(text, tmp_path))
    first, second = str(refused.value).splitlines()
    assert "instrument.modulation_frequencies.0: found" in first
    assert "scan.dwell: found" in second


def test_python_may_go_to_the_limits_of_the_formulas(plate: Survey) -> None:
    wild = plate.with_({"instrument.power": "1e9 W", "water.scattering": "1e4 1/m"})
    assert wild.instrument.power == 1e9
    # And what was simulated from it is read back.
    assert Survey.from_text(wild.to_toml()) == wild


@pytest.mark.parametrize("field", ["columns", "rows"])
def test_true_is_no_number_of_pixels(
    field: str, plate_text: str, tmp_path: Path
) -> None:
    lines = [
        f"{field} = true" if line.startswith(f"{field} =") else line
        for line in plate_text.splitlines()
    ]
    with pytest.raises(SurveyError, match="found true; needed is a whole number"):
        Survey.from_toml(_file("\n".join(lines), tmp_path))


@given(
    path=st.sampled_from(sorted(LIMITS)),
    value=st.floats(allow_nan=False, allow_infinity=False),
)
def test_what_is_beyond_is_told_and_nothing_else(path: str, value: float) -> None:
    limit = LIMITS[path]
    content: object = value
    for part in reversed(path.split(".")):
        content = [content] if part == "*" else {part: content}
    found = list(beyond(content))
    small = limit.least is not None and abs(value) < limit.least
    assert len(found) == (abs(value) > limit.most or small)
    for where, said in found:
        assert where == path.replace("*", "0")
        assert limit.reason in said
        assert units.write(value, limit.quantity) in said


def test_every_limit_is_of_a_field_that_there_is() -> None:
    """A field that is renamed must not lose its limit without a word."""
    from amulor.survey import json_schema

    text = str(json_schema())
    for path in LIMITS:
        name = [part for part in path.split(".") if part != "*"][-1]
        assert f"'{name}'" in text, path


@pytest.mark.parametrize("name", ["a" * 300 + ".stl", "a\\u0000.stl"])
def test_names_that_no_file_can_have_get_one_line(plate_text: str, name: str) -> None:
    mesh = f'kind = "mesh"\nfile = "{name}"\n'
    text = plate_text.replace('kind = "plate"\n', mesh)
    text = text.replace('width = "30 cm"\nheight = "30 cm"\n', "")
    with pytest.raises(SurveyError, match="is no name that a file can have") as found:
        Survey.from_text(text)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("old", "new"),
    [('"-2.672 deg"', '"1e300 deg"'), ('"7 cm", "0 m"', '"7 cm", "1e20 m"'),
     ('"20 mW"', '"1e30 W"'), ('"0.595 1/m"', '"6e199 1/m"')],
)  # fmt: skip
def test_numbers_beyond_all_measure_are_refused(
    plate_text: str, old: str, new: str
) -> None:
    assert old in plate_text
    with pytest.raises(SurveyError, match=r"no [a-z ]+ is beyond"):
        Survey.from_text(plate_text.replace(old, new))


def test_a_cube_goes_without_the_mesh_that_it_was_made_of(plate_text: str) -> None:
    mesh = 'kind = "mesh"\nfile = "/elsewhere/amphora.stl"\nunit = "m"\n'
    text = plate_text.replace('kind = "plate"\n', mesh)
    text = text.replace('width = "30 cm"\nheight = "30 cm"\n', "")
    # What the survey says of instrument and scan is to be had; a scene is not.
    found = Survey.from_text(text)
    assert found.scan.columns > 0
    with pytest.raises(SurveyError, match=r"amphora\.stl: there is no such file") as no:
        simulate(found, rng=1)
    assert "\n" not in str(no.value)


#: Smallest and largest number of each field, None for no limit; as on paper, in SI.
STATED = {
    "water.absorption": (None, 1e3),
    "water.scattering": (None, 1e3),
    "water.cdom_absorption": (None, 1e3),
    "water.column_end": (None, 1e3),
    "targets.*.position.*": (None, 1e3),
    "targets.*.width": (None, 1e3),
    "instrument.emitter.position.*": (None, 20.0),
    "instrument.receiver.position.*": (None, 20.0),
    "instrument.receiver.radius": (1e-5, 1.0),
    "instrument.window.distance": (None, 20.0),
    "instrument.window.thickness": (None, 1.0),
    "instrument.power": (1e-9, 100.0),
    "instrument.modulation_frequencies.*": (1e3, 1e10),
    "instrument.detector.dark_rate": (None, 1e15),
    "instrument.detector.saturation": (1e-6, 1e4),
    "instrument.lock_in.time_constant": (1e-8, 1e3),
    "scan.dwell": (1e-7, 3600.0),
}


@pytest.mark.parametrize("path", STATED)
def test_a_limit_holds_at_its_number_and_not_beyond(path: str) -> None:
    least, most = STATED[path]
    limit = LIMITS[path]
    assert limit.broken(most) == limit.broken(-most) == ""
    assert "it must be at most" in limit.broken(1.001 * most)
    if least is None:
        assert limit.broken(1e-300) == ""
    else:
        assert limit.broken(least) == ""
        assert "it must be at least" in limit.broken(0.999 * least)
