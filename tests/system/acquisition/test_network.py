"""Scans end to end: embedded devices, and simulated ones over the network."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from shared_light import scene_light

from amulor import acquisition, imaging, io, rejection
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.errors import InstrumentError
from amulor.simulation import simulate
from amulor.survey import Survey


def range_noise(
    survey: Survey, ideal: xr.Dataset
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the noise of ranges by the phase floor, and by water that fluctuates [m].

    Signals turn by the floor as a whole; of the water's change what is square to the
    target's phasor turns it. Counting adds 0.1 mm, 1 % of the variance here.
    """
    at = {"polarization": "VH", "modulation_frequency": 39e6}
    target, water = (
        (ideal[f"truth_{of}_in_phase"] + 1j * ideal[f"truth_{of}_quadrature"])
        .sel(at)
        .values
        for of in ("target", "water")
    )
    ratio = water / target
    floor = survey.instrument.lock_in.phase_floor * np.abs(1 + ratio.real)
    fluctuation = survey.water.signal_fluctuation * np.abs(ratio.imag)
    # Light goes there and back at the speed of light over the group index of the file.
    length = 299_792_458 / 1.38 / (4 * np.pi * 39e6)
    return length * floor, length * fluctuation


def test_an_acquired_cube_is_the_simulated_one_within_noise(
    plate, folder, ranges
) -> None:
    acquisition.acquire(plate, folder, scene=scene_light)
    acquired = io.read_cube(acquisition.recover(folder))
    ideal = simulate(plate, rng=2)
    for name, coordinate in ideal.coords.items():
        assert acquired[name].shape == coordinate.shape
    for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
        # The variance follows from the noisy mean output here, from truth there.
        np.testing.assert_allclose(acquired[name], ideal[name], rtol=0.15)
    difference = ranges(acquired) - ideal["truth_slant_range"].values
    still, moving = range_noise(plate, ideal)
    pulls = difference / np.hypot(still, moving)
    assert abs(pulls.std() - 1) < 4 / np.sqrt(2 * pulls.size)
    # The water of every pixel is that of its own moment less the mean of the shots.
    shots = ideal.sizes["shot"]
    mean = np.hypot(still.mean(), moving.mean()) / np.sqrt(pulls.size)
    assert abs(difference.mean()) < 4 * np.hypot(mean, moving.mean() / np.sqrt(shots))
    assert acquired.attrs["simulated"] == 1


@pytest.mark.parametrize(
    "model", [pytest.param("sr844", marks=pytest.mark.slow), "sr865a"]
)
def test_a_scan_over_the_network_gives_the_same_ranges(
    survey, folder, model, few
) -> None:
    if model == "sr865a":  # it ends at 4 MHz
        survey = survey.with_({"instrument.modulation_frequencies": ["3.9 MHz"]})
    with rehearse(survey, few, model=model, speed=500, scene=scene_light) as rehearsal:
        outcome = acquisition.acquire(survey, folder, settings=rehearsal.settings)
        assert outcome.finished
        assert not rehearsal.bench.laser_on
        # Output 1 of the panel.
        word, code = {"sr844": ("AUXO", 1), "sr865a": ("AUXV", 0)}[model]
        gates = [line for line in rehearsal.lock_in.lines if line.startswith(word)]
        assert gates[-1] == f"{word} {code},0.000;{word}? {code}"
        assert "HLT" in rehearsal.stages.lines[-6:]
    cube = io.read_cube(acquisition.recover(folder))
    assert model.upper() in cube.attrs["source"]
    assert cube.attrs["simulated"] == 1
    image = imaging.range_image(rejection.open_water(cube).sel(polarization=["VH"]))
    error = image["slant_range"] / simulate(survey, rng=1)["truth_slant_range"] - 1
    # A tenth of the frequency is ten times the range error of 2 mm.
    assert float(np.abs(error).mean()) < (0.003 if model == "sr844" else 0.03)


def test_the_frequency_that_an_instrument_rounds_to_makes_the_ranges(
    survey, folder, few, ranges
) -> None:
    # Three digits: 10.4 MHz, 0.47 % off, a range of 1.5 m off by 7 mm.
    # In clear and steady water nothing else is off by as much.
    survey = survey.with_(
        {
            "instrument.modulation_frequencies": ["10.449 MHz"],
            "water.scattering": "0.1 1/m",
            "water.signal_fluctuation": "1 %",
        }
    )
    with rehearse(survey, few, speed=500, scene=scene_light) as rehearsal:
        acquisition.acquire(survey, folder, settings=rehearsal.settings)
    with Journal.read(folder) as journal:
        cube = acquisition.build(journal)
    assert cube["modulation_frequency"].values.tolist() == [10.4e6]
    assert (cube["user_modulation_frequency"] == 10.4e6).all()
    assert (cube["user_sample_flag"].values & SampleFlag.OFF_FREQUENCY).all()
    assert Survey.from_text(cube.attrs["survey"]) == survey
    forward = np.cos(cube["azimuth"].values) * np.cos(cube["elevation"].values)
    error = ranges(cube) * forward - 1.5
    # A phase floor of 1 mrad is 2.2 mm a pixel, 0.4 mm in the mean of 32.
    assert abs(error.mean()) < 2e-3


def test_two_frequencies_that_would_be_one_are_refused(survey, folder, few) -> None:
    both = {"instrument.modulation_frequencies": ["39.06 MHz", "39.07 MHz"]}
    survey = survey.with_(both)
    with (
        rehearse(survey, few, speed=1000, scene=scene_light) as rehearsal,
        pytest.raises(
            InstrumentError, match=r"39\.1 MHz of both 39\.06 and 39\.07 MHz"
        ),
    ):
        acquisition.acquire(survey, folder, settings=rehearsal.settings)


@pytest.mark.slow
def test_the_same_scan_goes_over_pyvisa(survey, folder, few, ranges) -> None:
    pytest.importorskip("pyvisa_py", reason="PyVISA-py is not installed")
    with rehearse(survey, few, speed=1000, scene=scene_light) as rehearsal:
        content = rehearsal.settings.model_dump(exclude_unset=True)
        for part in content.values():
            if part.get("address"):
                host, port = part["address"].removeprefix("tcp://").split(":")
                part["address"] = f"TCPIP::{host}::{port}::SOCKET"
        settings = Settings.model_validate(content)
        assert acquisition.acquire(
            survey, folder, settings=settings, scene=scene_light
        ).finished
    assert ranges(io.read_cube(acquisition.recover(folder))).shape == (4, 8)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("lost-link@40", "closed the link|has not answered"),
        ("timeout@40", "has not answered"),
        ("unlock@40x99", "lost its reference"),
        ("overload@40x999", "in a row are overloaded"),
        ("stuck@40x999", "not on target"),
    ],
)
def test_faults_over_the_network_leave_the_laser_off(
    tiny, folder, fault, message
) -> None:
    # Whoever is silent is waited for; all others may be slow on a busy machine.
    patience = 3.0 if fault.startswith("timeout") else 60.0
    base = Settings.model_validate(
        {
            "lock_in": {"timeout": patience},
            "scanner": {"timeout": patience, "move_timeout": 1.0},
            "procedure": {"dark_readings": 2, "patience": 3},
            "simulation": {"faults": [fault]},
        }
    )
    with rehearse(tiny, base, speed=1000, scene=scene_light) as rehearsal:
        with pytest.raises(InstrumentError, match=message) as caught:
            acquisition.acquire(tiny, folder, settings=rehearsal.settings)
        assert not rehearsal.bench.laser_on
        gates = [line for line in rehearsal.lock_in.lines if line.startswith("AUXO")]
        assert gates[-1] == "AUXO 1,0.000;AUXO? 1"
        assert "HLT" in rehearsal.stages.lines[-12:]
    assert "--resume" in str(caught.value)


def test_a_scan_over_a_lost_link_is_gone_on_with(tiny, folder, few) -> None:
    lost = Settings.model_validate(
        {"procedure": {"dark_readings": 2}, "simulation": {"faults": ["lost-link@42"]}}
    )
    with (
        rehearse(tiny, lost, speed=1000, scene=scene_light) as first,
        pytest.raises(InstrumentError),
    ):
        acquisition.acquire(tiny, folder, settings=first.settings)
    # Mended: another port, no fault, the same instrument.
    with rehearse(tiny, few, speed=1000, scene=scene_light) as second:
        settings = second.settings
        assert acquisition.acquire(
            tiny, folder, settings=settings, resume=True, scene=scene_light
        ).finished
    cube = io.read_cube(acquisition.recover(folder))
    assert {*cube["user_segment"].values.ravel()} == {1, 2}
    assert len(json.loads(cube.attrs["segments"])) == 2
