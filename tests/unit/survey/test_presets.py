"""Published instruments: each says where each number is from, and each works."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from amulor import imaging, rejection
from amulor.cli import main
from amulor.errors import SurveyError
from amulor.optics import ranging
from amulor.simulation import simulate
from amulor.survey import Survey, presets, water_properties

#: What the sources print; by hand from the paper's text and from the abstracts.
PRINTED = {
    "amulor-2010": {
        "wavelength": 405e-9,
        "power": 20e-3,
        "modulation_frequencies": (39e6,),
        "polarizations": ("VV", "VH"),
    },
    "amulor-2010-long": {"wavelength": 405e-9, "power": 20e-3},
    "bartolini-2005": {"wavelength": 405e-9, "modulation_frequencies": (36.7e6,)},
    "green-2021": {"wavelength": 532e-9, "power": 2.56},
}


def test_every_preset_has_printed_numbers_to_be_compared_with() -> None:
    assert presets.names() == sorted(PRINTED)


@pytest.mark.parametrize("name", PRINTED)
def test_a_preset_has_the_numbers_that_its_source_prints(name: str) -> None:
    instrument = Survey.preset(name).instrument
    for field, value in PRINTED[name].items():
        assert getattr(instrument, field) == pytest.approx(value), field


@pytest.mark.parametrize("name", PRINTED)
def test_every_number_of_a_preset_says_where_it_is_from(name: str) -> None:
    found = presets.preset(name)
    stated = [
        line
        for line in found.text.splitlines()
        if re.match(r"\w+ *=", line) and not line.startswith(("name", 'kind = "plate"'))
    ]
    bare = [
        line
        for line in stated
        if not re.search(r" # \[(published|deduced|assumed)\] *\S*", line)
    ]
    assert not bare
    assert sum(found.counts.values()) == len(stated)
    assert re.fullmatch(r"10\.\d{4,}/\S+", found.doi)
    assert tomllib.loads(found.text)["name"]


@pytest.mark.parametrize("name", PRINTED)
def test_the_receiver_of_a_preset_is_aimed_at_its_target(name: str) -> None:
    survey = Survey.preset(name)
    receiver, target = survey.instrument.receiver, survey.targets[0]
    right, _, forward = np.subtract(target.position, receiver.position)
    assert receiver.azimuth == pytest.approx(np.arctan2(right, forward), abs=2e-5)


@pytest.mark.study
@pytest.mark.parametrize("name", PRINTED)
def test_a_preset_simulates_rejects_and_images_its_target(name: str) -> None:
    whole = Survey.preset(name)
    # The published numbers are of the noise, so no error of the phases is assumed.
    survey = whole.with_(
        {
            "scan.columns": 12,
            "scan.rows": 8,
            "scan.open_water.repeats": 12,
            "instrument.phase_uncertainty": "0 deg",
        }
    )
    samples = simulate(survey, rng=3)
    target = rejection.open_water(samples)
    channel = survey.instrument.polarizations[-1]
    # One interval of the highest frequency is settled by where the target stands.
    distance = survey.targets[0].position[2]
    index = water_properties(survey).group_index
    lowest = survey.instrument.modulation_frequencies[0]
    reach = float(ranging.ambiguity_interval(lowest, group_index=index))
    image = imaging.range_image(
        target, polarization=channel, interval=(0.1, min(reach, 2 * distance))
    )
    azimuth, elevation = image["azimuth"].values, image["elevation"].values
    truth = distance / (np.cos(azimuth) * np.cos(elevation))
    error = image["slant_range"].values - truth
    sigma = image["slant_range_uncertainty"].values
    assert np.all(np.isfinite(error))
    # Of 96 normal errors the largest is below 4.5 but once in 1500 draws.
    assert np.abs(error / sigma).max() < 4.5
    # What its source says that it can do: 0.5 mm (2010, VH), "submillimetre" (2005),
    # better than 12 cm without rejection (2021), milk at several metres.
    stated = {
        "amulor-2010": 0.6e-3,
        "bartolini-2005": 1e-3,
        "green-2021": 0.12,
        "amulor-2010-long": 10e-3,
    }
    assert np.median(sigma) < stated[name]
    assert np.sqrt(np.mean(error**2)) < 1.2 * stated[name]


def test_a_preset_that_does_not_exist_names_those_that_do() -> None:
    with pytest.raises(SurveyError, match="there are amulor-2010, amulor-2010-long"):
        Survey.preset("amulor-2011")


def test_the_open_sea_is_not_part_of_a_preset() -> None:
    """Another water than that of the source goes in by name, and works."""
    sea = {"kind": "jerlov", "type": "II", "source": "williamson-hollins-2022"}
    survey = Survey.preset("green-2021").with_({"water": sea})
    assert water_properties(survey).absorption > 0


def test_the_listing_prints_name_title_and_source_of_each_preset(capsys) -> None:
    assert main(["survey", "presets"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in presets.names():
        entry = presets.preset(name)
        at = lines.index(f"{name}: {entry.title}")
        assert lines[at + 1] == f"  {entry.use}"
        assert lines[at + 2] == f"  {entry.source}, doi:{entry.doi}"
        counts = [int(n) for n in re.findall(r"\d+", lines[at + 3])]
        assert counts == [*entry.counts.values()]
