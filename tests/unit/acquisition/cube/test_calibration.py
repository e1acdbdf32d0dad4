"""Phase zero and phase against amplitude come out as they were put in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared_light import scene_light

from amulor import acquisition, imaging, io, rejection
from amulor.acquisition.cube.calibrate import from_plates
from amulor.acquisition.cube.calibration import (
    Calibration,
    FrequencyCalibration,
    phase_correction,
)
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings import Settings
from amulor.errors import CubeError, FormatError
from amulor.survey import OpenWater, Survey

TABLE = Calibration(
    frequencies=(
        FrequencyCalibration(
            modulation_frequency=39e6, amplitudes=(1e-3, 1e-1), phases=(0.2, 0.4)
        ),
    )
)


@pytest.fixture(scope="module")
def clear(small: Survey) -> Survey:
    """Return clear calm water, where a plate is all there is."""
    water = small.water.model_copy(
        update={"scattering": 0.02, "absorption": 0.02, "signal_fluctuation": 0.0}
    )
    shots = OpenWater(columns=3, rows=3, repeats=3)
    scan = small.scan.model_copy(update={"rows": 6, "columns": 6, "open_water": shots})
    return small.model_copy(update={"water": water, "scan": scan})


def recorded(survey: Survey, folder: Path, **simulation: object):
    settings = Settings.model_validate(
        {"procedure": {"dark_readings": 10}, "simulation": simulation}
    )
    acquisition.acquire(survey, folder, settings=settings, scene=scene_light)
    with Journal.read(folder) as journal:
        return folder, rejection.open_water(acquisition.build(journal))


@pytest.mark.study
def test_a_delay_in_the_cable_is_found_and_taken_off(clear, folder) -> None:
    place, plate = recorded(clear, folder / "a", cable_delay=3e-9, pickup=1e-5)
    calibration = from_plates([plate], distance=1.5)
    (one,) = calibration.frequencies
    # 2 pi f t; the plate's phase is known to some 1e-3 rad by the phase floor of
    # 0.06 degrees in 16 pixels.
    assert_allclose(one.phases[0], 2 * math.pi * 39e6 * 3e-9, atol=2e-3)
    path = acquisition.recover(place, calibration=calibration, overwrite=True)
    cube = io.read_cube(path)
    assert (
        Calibration.from_toml(written(place, cube.attrs["calibration"])) == calibration
    )
    image = imaging.range_image(rejection.open_water(cube).sel(polarization=["VH"]))
    # Range error of 1e-3 rad at 39 MHz and group index 1.38: 0.4 mm; the plate is flat.
    slant = image["slant_range"] * np.cos(image["azimuth"]) * np.cos(image["elevation"])
    assert_allclose(float(slant.mean()), 1.5, atol=2e-3)


def written(folder: Path, text: str) -> Path:
    path = folder / "calibration.toml"
    path.write_text(text)
    return path


@pytest.mark.slow
def test_phase_against_amplitude_is_found_with_filters(clear, folder) -> None:
    plates = []
    for number, power in enumerate((1.0, 0.3, 0.1)):
        instrument = clear.instrument.model_copy(
            update={"power": clear.instrument.power * power}
        )
        survey = clear.model_copy(update={"instrument": instrument})
        plates.append(recorded(survey, folder / str(number), phase_walk=0.1)[1])
    (one,) = from_plates(plates, distance=1.5).frequencies
    slope = np.polyfit(np.log10(one.amplitudes), one.phases, 1)[0]
    # The walk acts on plate and water together, the amplitude here is the plate's.
    assert_allclose(slope, 0.1, atol=0.01)
    assert_allclose(np.array(one.amplitudes) / one.amplitudes[0], [1, 3, 10], rtol=0.02)


def test_the_correction_is_linear_in_the_logarithm_of_the_amplitude() -> None:
    found, known = phase_correction(
        TABLE, np.array([1e-3, 1e-2, 1e-1]), modulation_frequency=39e6
    )
    assert_allclose(found, [0.2, 0.3, 0.4])
    assert known.all()


def test_an_amplitude_that_was_not_calibrated_is_told_apart() -> None:
    found, known = phase_correction(
        TABLE, np.array([1e-4, 1e-2, 1.0, np.nan]), modulation_frequency=39e6
    )
    assert known.tolist() == [False, True, False, False]
    assert_allclose(found[:3], [0.2, 0.3, 0.4])


def test_an_uncalibrated_frequency_is_refused() -> None:
    with pytest.raises(FormatError, match="no 40 MHz"):
        phase_correction(TABLE, np.ones(1), modulation_frequency=40e6)


@pytest.mark.slow
def test_a_calibrated_plate_is_no_calibration(clear, folder) -> None:
    place, _ = recorded(clear, folder / "b")
    wide = Calibration(
        frequencies=(
            FrequencyCalibration(
                modulation_frequency=39e6, amplitudes=(1e-3,), phases=(0.1,)
            ),
        )
    )
    with Journal.read(place) as journal:
        plate = rejection.open_water(acquisition.build(journal, calibration=wide))
    with pytest.raises(CubeError, match="has a calibration already"):
        from_plates([plate], distance=1.5)
    with pytest.raises(ValueError, match="above 0 m"):
        from_plates([plate], distance=-1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[frequencies]]\namplitudes=['1 mV']\nphases=['0.1 rad']", "modulation_freq"),
        (
            "[[frequencies]]\nmodulation_frequency='1 MHz'\n"
            "amplitudes=['1 mV','1 mV']\nphases=['0.1 rad','0.1 rad']",
            "must increase",
        ),
        (
            "[[frequencies]]\nmodulation_frequency='1 MHz'\namplitudes=['1 mV']\n"
            "phases=[]",
            "each amplitude needs its phase",
        ),
        (
            "[[frequencies]]\nmodulation_frequency='1 MHz'\namplitudes=['1 mV']\n"
            "phase=['0.1 rad']",
            r"0\.phase: is no field of a calibration; did you mean 'phases'",
        ),
        ("frequencies = []", "at least one is needed"),
        ("nonsense", "no valid TOML"),
    ],
)
def test_a_wrong_calibration_file_is_named(tmp_path, text, message) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text(text)
    with pytest.raises(FormatError, match=message):
        Calibration.from_toml(path)


def test_a_list_of_wrong_items_is_not_called_empty(tmp_path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text("[[frequencies]]\nmodulation_frequency = 1\nphases = ['0 rad']")
    with pytest.raises(FormatError) as caught:
        Calibration.from_toml(path)
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert "frequencies.0.modulation_frequency: " in lines[0]
    assert "frequencies.0.amplitudes: is missing" in lines[1]


def test_a_frequency_is_known_by_what_is_read_back() -> None:
    two = Calibration(
        frequencies=tuple(
            FrequencyCalibration(
                modulation_frequency=frequency, amplitudes=(1.0,), phases=(phase,)
            )
            for frequency, phase in ((39e6, 0.1), (39.02e6, 0.2))
        )
    )
    # The last digits of a counter move; the nearest one counts.
    for read, phase in ((39.0001e6, 0.1), (39.019e6, 0.2), (39.05e6, 0.2)):
        found, _ = phase_correction(two, np.ones(1), modulation_frequency=read)
        assert_allclose(found, phase)
    with pytest.raises(FormatError, match=r"no 39\.1 MHz"):
        phase_correction(two, np.ones(1), modulation_frequency=39.1e6)
