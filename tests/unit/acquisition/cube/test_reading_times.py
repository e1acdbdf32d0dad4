"""Times of readings: from the clock of the scan to journal, cube and range image."""

import functools

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition, imaging, io, rejection
from amulor.acquisition import plan
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.settings import Settings
from amulor.survey import Survey

light = functools.cache(scene_light)
DWELL, CONSTANT = 0.05, 0.01


def _scan(survey: Survey, folder, **procedure):
    settings = Settings.model_validate({"procedure": {"dark_readings": 2, **procedure}})
    acquisition.acquire(survey, folder / "scan", settings=settings, scene=light)
    with Journal.read(folder / "scan") as journal:
        records = list(journal.samples(plan.SCAN))
        return acquisition.build(journal), records


@pytest.fixture
def two(plate: Survey) -> Survey:
    """Two frequencies and two channels."""
    return plate.with_(
        {
            "instrument.modulation_frequencies": ["20 MHz", "39 MHz"],
            "instrument.lock_in.time_constant": "10 ms",
            "scan.columns": 4,
            "scan.rows": 2,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 2, "rows": 2, "repeats": 3},
        }
    )


def test_readings_in_turn_have_windows_that_do_not_overlap(two, folder):
    cube, records = _scan(two, folder)
    time, duration = cube["reading_time"].values, cube["reading_duration"].values
    assert time.shape == (2, len(two.instrument.polarizations), 2, 4)
    begin, end = time - duration / 2, time + duration / 2
    order = np.argsort(begin, axis=None)
    later, earlier = begin.ravel()[order][1:], end.ravel()[order][:-1]
    assert np.all(later >= earlier - 1e-9)
    # The first reading ends after settling and at most a dwell of readings.
    assert np.all(duration > 0)
    assert np.all(duration <= DWELL + 1e-9)
    for key, record in records:
        at = (key.frequency == 39e6, two.instrument.polarizations.index(
            key.polarization), key.row, key.column)  # fmt: skip
        place = tuple(int(index) for index in at)
        assert record.begin >= record.elapsed
        assert time[place] == pytest.approx(record.begin + record.duration / 2)


def test_the_first_reading_follows_settling(two, folder):
    """After five time constants the first reading is taken, a mean over two before."""
    _, records = _scan(two, folder)
    waits = [record.begin - record.elapsed for _, record in records]
    assert min(waits) >= 5 * CONSTANT - 2 * CONSTANT - 1e-9


def test_the_image_has_the_readings_of_its_channel(two, folder):
    cube, _ = _scan(two, folder)
    target = rejection.open_water(cube)
    pair = two.instrument.polarizations[1]
    image = imaging.range_image(target, polarization=pair, interval=(0.5, 4.0))
    np.testing.assert_array_equal(
        image["reading_time"].values, cube["reading_time"].values[:, 1]
    )
    assert image["reading_weight"].values.sum() == pytest.approx(1.0)
    # The range follows the higher frequency more closely.
    assert image["reading_weight"].values[1] > image["reading_weight"].values[0]


def test_files_of_images_have_the_readings(two, folder, tmp_path):
    cube, _ = _scan(two, folder)
    pair = two.instrument.polarizations[1]
    image = imaging.range_image(
        rejection.open_water(cube), polarization=pair, interval=(0.5, 4.0)
    )
    io.write_cube(image, tmp_path / "range.nc")
    again = io.read_cube(tmp_path / "range.nc")
    for name in ("reading_time", "reading_duration", "reading_weight"):
        np.testing.assert_array_equal(again[name].values, image[name].values)


def test_frequencies_at_once_share_their_window(two, folder):
    half = two.with_({"instrument.modulation_depth": 0.5})
    cube, _ = _scan(half, folder, frequencies_at_once=2)
    time = cube["reading_time"].values
    np.testing.assert_array_equal(time[0], time[1])
    assert not np.any(time[:, 0] == time[:, 1])
    pair = two.instrument.polarizations[1]
    image = imaging.range_image(
        rejection.open_water(cube), polarization=pair, interval=(0.5, 4.0)
    )
    # Readings at the same time count as a single reading.
    np.testing.assert_array_equal(image["reading_time"].values[0], time[0, 1])


def test_journals_without_windows_make_cubes_without_them(two, folder, monkeypatch):
    """Journals of earlier versions have no such columns."""
    monkeypatch.setattr(
        "amulor.acquisition.sampler.Record",
        lambda **values: Record(**{**values, "begin": None, "duration": None}),
    )
    cube, _ = _scan(two, folder)
    assert "reading_time" not in cube.coords
    assert np.all(np.isfinite(cube["time"].values))
