"""Scans that a vehicle carries: poses in the journal, trajectory and flags."""

import functools
import json
import socket
import sqlite3
import threading
import time
from datetime import datetime

import moving_pass
import numpy as np
import pytest

from amulor import acquisition, imaging, io, rejection, simulation
from amulor.acquisition import plan
from amulor.acquisition.clock import RealClock
from amulor.acquisition.connect import connect, lead_time
from amulor.acquisition.cube.build import trajectory_path
from amulor.acquisition.drivers.nmea import NmeaNavigation
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.navigation import recorded_trajectory
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import NavigationSettings, Settings
from amulor.errors import FormatError, InstrumentError, SurveyError
from amulor.io.navigation_logs import nmea_sentence
from amulor.io.trajectories import read_trajectory

#: Mounting angles (heading, pitch, roll) and lever arm of the instrument.
ANGLES, ARM = (0.0, -np.pi / 2, 0.0), (0.1, 0.2, 0.3)
COURSE = {"kind": "line", "start": [0.0, 0.0, -8.0], "heading": 0.0, "speed": 0.5}
#: A steep plate, along which the range changes by about 0.4 m per metre.
PLATE = {"position": np.array([0.0, 0.0, 2.0]), "angles": (0.4, 0.0, 0.0)}

light = functools.cache(
    functools.partial(simulation.scene_light, model=simulation.ClosureModel())
)


@pytest.fixture
def moving(plate):
    """A line scanner of 4 columns that a vehicle carries over a steep plate."""
    return plate.with_(
        {
            "targets": [
                {
                    "kind": "plate", "position": PLATE["position"].tolist(),
                    "rotation": list(PLATE["angles"]), "reflectance": 0.5,
                    "width": 30.0, "height": 30.0,
                }
            ],
            "water.signal_fluctuation": 0.0,
            "instrument.phase_uncertainty": 0.0,
            "instrument.lock_in.phase_floor": 0.0,
            "instrument.power": 0.02,
            "instrument.polarizations": ["VV"],
            "instrument.modulation_frequencies": [39e6, 78e6],
            "instrument.modulation_depth": 0.4,
            "instrument.lock_in.time_constant": 4e-3,
            "scan.columns": 4,
            "scan.rows": 3,
            "scan.azimuth_span": 0.02,
            "scan.elevation_span": 0.0,
            "scan.dwell": 0.02,
            "scan.open_water": {"columns": 2, "rows": 1, "repeats": 3},
            "pose": {"position": [0.0, 0.0, -8.0], "pitch": -np.pi / 2},
            "platform": {
                "course": COURSE,
                "navigation": {"interval": 0.05},
                "mounting": {"lever_arm": list(ARM), "pitch": -np.pi / 2},
            },
        }
    )  # fmt: skip


def _scan(survey, folder, **procedure):
    procedure = {"dark_readings": 2, **procedure}
    settings = Settings.model_validate({"procedure": procedure})
    outcome = acquisition.acquire(
        survey, folder / "scan", settings=settings, scene=light
    )
    assert outcome.finished
    return settings


def _true_ranges(survey, settings, cube):
    """Range of each reading by code that shares nothing with the product [m]."""
    scene = moving_pass.attitude(0.0, -np.pi / 2, 0.0)
    normal = scene @ moving_pass.plane_of(PLATE["position"], PLATE["angles"])[:, 2]
    center = np.array([0.0, 0.0, -8.0]) + scene @ PLATE["position"]
    lead = lead_time(survey, settings)
    time = cube["reading_time"].values
    result = np.empty(time.shape)
    mounting = {"angles": ANGLES, "lever_arm": ARM}
    for index in np.ndindex(time.shape):
        origin, turn = moving_pass.instrument_at(
            COURSE, mounting, np.zeros(3), time[index] - lead
        )
        beam = moving_pass.beam_of(
            float(cube["azimuth"].values[index[2:]]),
            float(cube["elevation"].values[index[2:]]),
        )
        result[index] = moving_pass.distance_to_plane(
            origin, turn @ beam, center, normal
        )
    return result


CONTINUOUS = {"mode": "continuous", "output_filter": "known", "readings": "buffer"}


@pytest.mark.parametrize("procedure", [{}, CONTINUOUS], ids=["stops", "continuous"])
def test_ranges_are_those_at_the_recorded_times(moving, folder, procedure):
    """The range changes by 0.2 m/s: 1 ms of error in time is 0.2 mm."""
    settings = _scan(moving, folder, frequencies_at_once=2, **procedure)
    cube = io.read_cube(acquisition.recover(folder / "scan"))
    image = imaging.range_image(rejection.open_water(cube), interval=(0.5, 3.0))
    true = _true_ranges(moving, settings, cube)[0, 0]
    assert np.ptp(true) > 0.05
    error = image["slant_range"].values - true
    # Half a time constant of error in time would be 0.4 mm.
    assert np.abs(error).max() < 3e-4
    # Points of the recorded trajectory lie on the plate.
    track = read_trajectory(trajectory_path(folder / "scan" / "cube.nc"))
    cloud = imaging.point_cloud(
        image, frame=imaging.moving_frame(image, trajectory=track)
    )
    points = np.stack([cloud[axis].values for axis in "xyz"], axis=-1)
    scene = moving_pass.attitude(0.0, -np.pi / 2, 0.0)
    normal = scene @ moving_pass.plane_of(PLATE["position"], PLATE["angles"])[:, 2]
    center = np.array([0.0, 0.0, -8.0]) + scene @ PLATE["position"]
    assert np.abs((points - center) @ normal).max() < 1e-3


def test_a_vehicle_that_is_too_fast_is_told_so(moving, folder):
    """Rows of 4 x 20 ms are planned; the way back of the beam makes them longer."""
    wide = {"platform.readings": "at-once", "scan.azimuth_span": 0.1}
    _scan(moving.with_(wide), folder, frequencies_at_once=2)
    lines = []
    cube = io.read_cube(acquisition.recover(folder / "scan", told=lines.append))
    row = float(np.diff(cube["reading_time"].values[0, 0].mean(axis=-1)).mean())
    (line,) = lines
    assert line.startswith(
        f"too fast: {1e3 * 0.5 * row:.3g} mm between lines, 40 wanted; drive "
        f"{row / 0.08:.2g} times slower"
    )


def test_readings_in_turn_follow_one_another_at_each_pixel(moving, folder):
    _scan(moving, folder)
    with Journal.read(folder / "scan") as journal:
        keys = [key for key, _ in journal.samples(plan.SCAN)]
        cube = acquisition.build(journal)
    assert [key.frequency for key in keys] == [39e6, 78e6] * 12
    assert [key.column for key in keys[:8]] == [0, 0, 1, 1, 2, 2, 3, 3]
    middle = cube["reading_time"].values[:, 0]
    assert np.all(middle[1] - middle[0] > 0.02)
    assert np.all(np.diff(middle[0].ravel()) > 0.04)


def test_the_journal_has_every_pose_until_after_the_last_reading(moving, folder):
    _scan(moving, folder, frequencies_at_once=2)
    with Journal.read(folder / "scan") as journal:
        messages = journal.messages()
        last = max(
            record.begin + record.duration for _, record in journal.samples(plan.SCAN)
        )
        assert journal.damage() == []
        recorded = recorded_trajectory(journal, moving)
    arrivals = np.array([arrival for _, arrival, _ in messages])
    np.testing.assert_allclose(np.diff(arrivals), 0.05, atol=1e-9)
    assert arrivals[0] < 0.05
    assert arrivals[-1] > last + 0.1
    assert recorded.lines == ()
    assert recorded.known(np.array([0.1, last, np.nan, 1e4])).tolist() == [
        True, True, False, False,
    ]  # fmt: skip


class Changed:
    """Source of poses that leaves out messages."""

    def __init__(self, source, begin, end):
        self._source, self._begin, self._end = source, begin, end

    def __getattr__(self, name):
        return getattr(self._source, name)

    def messages(self):
        return [
            (arrival, line)
            for arrival, line in self._source.messages()
            if not self._begin <= arrival < self._end
        ]


def test_readings_in_a_gap_of_the_poses_are_flagged(moving, folder):
    settings = Settings.model_validate(
        {"procedure": {"dark_readings": 2, "frequencies_at_once": 2}}
    )
    devices = connect(moving, settings, scene=light)
    begin = lead_time(moving, settings) + 0.15
    source = Changed(devices.navigation, begin, begin + 0.3)
    object.__setattr__(devices, "navigation", source)
    acquisition.acquire(moving, folder / "scan", settings=settings, devices=devices)
    lines = []
    cube = io.read_cube(acquisition.recover(folder / "scan", told=lines.append))
    middle = cube["reading_time"].values
    flagged = cube["user_sample_flag"].values & SampleFlag.NO_POSE != 0
    # The last pose before the gap is at most 0.05 s old, the first after it, too.
    end = begin + 0.3
    assert flagged[(middle > begin) & (middle < end)].all()
    assert not flagged[(middle < begin - 0.05) | (middle > end + 0.05)].any()
    assert 0 < flagged.sum() < flagged.size
    assert any("gap longer than" in line for line in lines)
    assert any(
        f"{flagged.sum()} of {flagged.size} samples have no pose" in line
        for line in lines
    )
    image = imaging.range_image(rejection.open_water(cube), interval=(0.5, 3.0))
    track = read_trajectory(trajectory_path(folder / "scan" / "cube.nc"))
    known = imaging.moving_frame(image, trajectory=track).known
    np.testing.assert_array_equal(known, ~flagged[0, 0])


def test_a_damaged_message_is_described_and_left_out(moving, folder):
    _scan(moving, folder, frequencies_at_once=2)
    with sqlite3.connect(folder / "scan" / FILE_NAME) as connection:
        connection.execute("UPDATE navigation SET line = '1,2' WHERE number = 4")
        connection.execute("DELETE FROM navigation WHERE number = 6")
    with Journal.read(folder / "scan") as journal:
        numbers = [number for number, _, _ in journal.messages()]
        assert journal.damage() == [
            "navigation message 4: its checksum is that of another message",
            "navigation message 6: not there",
        ]
    assert 3 in numbers
    assert not {4, 6} & {*numbers}


def test_a_journal_without_the_table_of_poses_is_read_and_resumed(small, folder):
    """As those of older versions."""
    settings = Settings.model_validate({"procedure": {"dark_readings": 2}})
    acquisition.acquire(small, folder / "scan", settings=settings, scene=light)
    with sqlite3.connect(folder / "scan" / FILE_NAME) as connection:
        connection.execute("DROP TABLE navigation")
    with Journal.read(folder / "scan") as journal:
        assert journal.messages() == []
        assert acquisition.build(journal)["in_phase"].notnull().all()
    with Journal.resume(folder / "scan", meta={}) as journal:
        journal.commit_together([], [(1.5, "a line")])
        assert journal.messages() == [(1, 1.5, "a line")]


def test_what_does_not_fit_a_vehicle_is_refused(moving, small, folder):
    at_once = moving.with_({"platform.readings": "at-once"})
    settings = Settings()
    with pytest.raises(SurveyError, match="frequencies_at_once = 2"):
        acquisition.acquire(at_once, folder / "a", settings=settings, scene=light)
    with pytest.raises(SurveyError, match="cannot be acquired again"):
        acquisition.acquire(
            moving, folder / "b", scene=light, resume=True, retake_flagged=True
        )
    source = {"navigation": {"address": "tcp://127.0.0.1:9", "crs": "EPSG:32632"}}
    parts = {
        "lock_in": {"driver": "sr844", "address": "tcp://127.0.0.1:9"},
        "scanner": {"driver": "pi_gcs", "address": "tcp://127.0.0.1:9"},
        "launch": {"driver": "none"}, "analyser": {"driver": "none"},
        "laser": {"driver": "lock_in_output"}, "target": {"driver": "none"},
    }  # fmt: skip
    with pytest.raises(SurveyError, match="has a part navigation"):
        acquisition.acquire(
            small, folder / "c", settings=Settings.model_validate({**parts, **source})
        )


# -- NMEA 0183 -------------------------------------------------------------------------


def _epoch(second):
    """Sentences of a vehicle that drives north at 0.5 m/s past 44.285 N, 8.565 E."""
    stamp = f"1020{second:05.2f}"
    minutes = 17.1 + 0.5 * second / 1852
    return [
        nmea_sentence(
            f"GPGGA,{stamp},44{minutes:010.7f},N,00833.9000000,E,4,12,0.8,-8.0,M,48.0,M,,"
        ),
        nmea_sentence(f"PASHR,{stamp},0.0,T,0.0,0.0,0.0,0.05,0.05,0.1,2,1"),
    ]


@pytest.fixture
def receiver():
    """Return a function that makes a receiver for an address."""
    pytest.importorskip("pynmeagps")
    made = []

    def make(address, **more):
        settings = NavigationSettings(address=address, crs="EPSG:32632", **more)
        made.append(NmeaNavigation(settings, clock=RealClock()))
        return made[-1]

    yield make
    for source in made:
        source.close()


def _received(source, count):
    lines, end = [], time.monotonic() + 5
    while len(lines) < count and time.monotonic() < end:
        lines += source.messages()
        time.sleep(0.005)
    return lines


def test_a_growing_file_is_followed_from_its_end(receiver, tmp_path):
    path = tmp_path / "rov.nmea"
    path.write_text("".join(_epoch(1)))
    source = receiver(f"file:{path}")
    with path.open("a", buffering=1) as file:
        threading.Timer(0.05, file.write, ["".join(_epoch(2))]).start()
        before = time.monotonic()
        source.begin()
        lines = _received(source, 2)
    assert [line + "\r\n" for _, line in lines] == _epoch(2)
    assert all(before < arrival <= time.monotonic() for arrival, _ in lines)


def test_a_lost_link_is_opened_again_and_no_sentence_is_joined(receiver, monkeypatch):
    monkeypatch.setattr("amulor.acquisition.drivers.nmea._AGAIN", 0.01)
    first, second = _epoch(1), _epoch(2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = receiver(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        begun = threading.Thread(target=source.begin)
        begun.start()
        link, _ = server.accept()
        link.sendall((first[0] + first[1][:20]).encode())
        begun.join()
        link.close()
        link, _ = server.accept()
        link.sendall("".join(second).encode())
        lines = [line + "\r\n" for _, line in _received(source, 3)]
        link.close()
    assert lines == [first[0], *second]


def test_sentences_before_the_scan_do_not_arrive_late(receiver):
    """Between connection and begin, other devices are opened and settle."""
    first, second = _epoch(1), _epoch(2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = receiver(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        link, _ = server.accept()
        link.sendall("".join(first).encode())
        while len(source._arrived) < 2:
            time.sleep(0.005)
        threading.Timer(0.05, link.sendall, ["".join(second).encode()]).start()
        source.begin()
        lines = [line + "\r\n" for _, line in _received(source, 2)]
        link.close()
    assert lines == second


def test_a_silent_source_stops_the_scan_before_it_begins(receiver):
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = receiver(f"tcp://127.0.0.1:{server.getsockname()[1]}", timeout="50 ms")
        with pytest.raises(InstrumentError, match="no sentence from tcp:"):
            source.begin()


def test_a_file_that_is_missing_is_named(receiver, tmp_path):
    with pytest.raises(InstrumentError, match="start the program that writes it"):
        receiver(f"file:{tmp_path / 'rov.nmea'}")


def test_an_arrival_that_is_no_number_is_refused(folder):
    with Journal.create(folder, meta={}) as journal:
        with pytest.raises(FormatError, match="the arrival of 'a line' is nan s"):
            journal.commit_together([], [(np.nan, "a line")])
        assert journal.messages() == []


def _started(folder):
    """Return the Unix time of the start of a scan [s]."""
    with Journal.read(folder) as journal:
        return datetime.fromisoformat(journal.segments()[0]["started"]).timestamp()


@pytest.mark.slow
def test_a_scan_from_a_vehicle_over_the_network(moving, folder):
    """A vehicle that drifts over a steep plate: all points must lie on the plate."""
    pytest.importorskip("pynmeagps")
    survey = moving.with_(
        {
            "instrument.modulation_frequencies": [39e6],
            "instrument.lock_in.time_constant": 3e-3,
            "platform.course": {"kind": "hover", "start": [0.0, 0.0, -8.0]},
            "platform.disturbance": {"current": [0.0, 0.03, 0.0]},
            "scan.rows": 2,
        }
    )
    few = Settings.model_validate({"procedure": {"dark_readings": 2}})
    with rehearse(survey, few, scene=light) as rehearsal:
        acquisition.acquire(survey, folder, settings=rehearsal.settings)
    cube = io.read_cube(acquisition.recover(folder))
    track = read_trajectory(trajectory_path(folder / "cube.nc"))
    assert track.crs == rehearsal.settings.navigation.crs == "EPSG:32632"
    image = imaging.range_image(rejection.open_water(cube), interval=(1.0, 3.0))
    cloud = imaging.point_cloud(
        image, frame=imaging.moving_frame(image, trajectory=track)
    )
    points = np.stack([cloud[axis].values for axis in "xyz"], axis=-1)
    assert len(points) == 8
    # It drifts by 0.03 m/s during 8 pixels, more than the points may be off.
    moved = track.at(cube["reading_time"].values.ravel()[[0, -1]] + _started(folder))
    assert np.ptp(moved.position[:, 1]) > 3e-3
    scene = moving_pass.attitude(0.0, -np.pi / 2, 0.0)
    normal = scene @ moving_pass.plane_of(PLATE["position"], PLATE["angles"])[:, 2]
    center = np.array([0.0, 0.0, -8.0]) + scene @ PLATE["position"]
    assert np.abs((points - center) @ normal).max() < 1.5e-3


def test_a_vehicle_on_the_network_has_the_time_of_day(moving):
    with (
        pytest.raises(SurveyError, match="run at speed 1, got 10"),
        rehearse(moving, scene=light, speed=10),
    ):
        pass


def test_sentences_of_a_journal_make_a_trajectory(moving, folder):
    """The sentences state 0.5 m/s to the north; grid north is 0.3 degrees away."""
    pytest.importorskip("pynmeagps")
    source = {"driver": "nmea", "address": "ASRL1", "crs": "EPSG:32632"}
    meta = {
        "survey": moving.to_toml(),
        "devices": "[navigation]\n"
        + "\n".join(f'{name} = "{text}"' for name, text in source.items()),
        "identities": json.dumps({"navigation": "NMEA 0183"}),
    }
    with Journal.create(folder, meta=meta) as journal:
        journal.begin_segment()
        begun = journal.segments()[0]["started"]
        messages = [(0.0, nmea_sentence(
            "GPZDA,102000.00," + ",".join(reversed(begun[:10].split("-"))) + ",00,00"
        ))]  # fmt: skip
        for number in range(1, 40):
            for sentence in _epoch(number / 2):
                messages.append((number / 2, sentence.strip()))
        messages.insert(9, (2.0, "noise"))
        journal.commit_together([], messages)
        recorded = recorded_trajectory(journal, moving)
    track = recorded.trajectory
    assert track.time.size == 39
    moved = track.position[-1] - track.position[0]
    # The scale of the projection is 0.9998 here; a nautical mile is a minute within
    # 0.3 % at this latitude.
    assert np.hypot(*moved[:2]) == pytest.approx(0.5 * 19, rel=5e-3)
    assert any("without a sentence" in line for line in recorded.lines)
    # The clock of this computer is not that of the sentences.
    assert any("correct mounting.clock_offset" in line for line in recorded.lines)


def test_the_lead_is_made_of_readings_motions_and_locking(plate):
    frequencies = ["20 MHz", "50 MHz", "80 MHz"]
    survey = plate.with_({"instrument.modulation_frequencies": frequencies})
    settings = Settings.model_validate({"procedure": {"dark_readings": 2}})
    # In each of 6 channels 2 dark readings, and 15 directions with half of the 8
    # repeats: the others follow the scan. A dwell first waits for the lock-in.
    readings = 6 * (2 + 15 * 4)
    dwell = 0.125 + settings.procedure.settling * 0.01
    way = abs(settings.target.position_out - settings.target.position_in)
    lead = lead_time(survey, settings)
    # Out and back at 0.2 m/s; the lock-in locks within 50 ms.
    assert lead == pytest.approx(readings * dwell + 2 * way / 0.2 + 6 * 0.05)
    still = survey.with_({"scan.open_water": None})
    assert lead_time(still, settings) == pytest.approx(6 * 2 * dwell + 6 * 0.05)
