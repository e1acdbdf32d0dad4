"""Sentences of a simulated navigation, and the devices file of a rehearsal."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shared_light import scene_light

from amulor.acquisition import rehearsal
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.settings import Settings
from amulor.acquisition.settings.parts import PoseFrame
from amulor.acquisition.simulated import nmea
from amulor.acquisition.simulated.nmea import SimulatedNmea, sentences
from amulor.errors import SurveyError
from amulor.io.navigation_logs import nmea_sentence
from amulor.io.trajectories import geographic
from amulor.platform import pose_line
from amulor.platform.messages import messages_of

#: Vehicle axes (right, down, forward) of a level vehicle that heads north.
LEVEL = np.array([-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
CRS, OFFSET = "EPSG:32632", (500e3, 5.3e6, 7.0)


def turned(heading: float) -> list[float]:
    """Return the attitude of a level vehicle with a heading [rad]."""
    half = -heading / 2
    x, y, z, w = LEVEL
    sine, cosine = math.sin(half), math.cos(half)
    # A turn about the vertical, then the level attitude.
    return [
        cosine * x - sine * y, cosine * y + sine * x, cosine * z + sine * w,
        cosine * w - sine * z,
    ]  # fmt: skip


def line(time: float, *, heading: float = 0.0, east: float = 0.0) -> str:
    sigma = np.array([0.01, 0.02, 0.03, 0.001, 0.002, 0.004])
    return pose_line(
        time=time,
        position=[east, 3.0, -8.0],
        attitude=turned(heading),
        covariance=np.diag(sigma**2),
    )


def fields(text: str) -> list[str]:
    return text.partition("*")[0].strip().split(",")


def poses(*lines: str) -> Any:
    return messages_of([*lines], clock="unix", crs=CRS, crs_offset=OFFSET)


def test_a_pose_is_a_position_its_error_and_an_attitude() -> None:
    origin = datetime(2026, 5, 1, 23, 59, 59, 500_000, tzinfo=UTC).timestamp()
    found = sentences(poses(line(0.25, heading=math.radians(30))), origin=origin)
    place, error, attitude = map(fields, found)
    clock = "235959.750000"
    longitude, latitude, _ = geographic(np.array([[500e3, 5.3e6 + 3]]), CRS)
    assert longitude[0] == pytest.approx(9.0)
    degrees, minutes = divmod(latitude[0] * 60, 60)
    assert place[:2] == ["$GPGGA", clock]
    assert place[2] == f"{int(degrees):02d}{minutes:012.9f}"
    assert place[3] == "N"
    assert float(place[4]) == pytest.approx(900.0, abs=1e-6)
    assert place[5:] == ["E", "4", "12", "0.8", "-1.000000", "M", "0.0", "M", "", ""]
    # Latitude, longitude, height.
    assert error == [
        "$GPGST", clock, "", "", "", "", "0.020000", "0.010000", "0.030000"
    ]  # fmt: skip
    assert attitude[:2] == ["$PASHR", clock]
    assert float(attitude[2]) == pytest.approx(30, abs=1e-6)
    assert attitude[3] == "T"
    assert [float(text) for text in attitude[4:6]] == pytest.approx([0, 0], abs=1e-6)
    level = math.degrees(math.hypot(0.001, 0.002) / math.sqrt(2))
    numbers = [float(text) for text in attitude[6:10]]
    assert numbers == pytest.approx([0.0, level, level, math.degrees(0.004)], abs=1e-6)
    assert attitude[10:] == ["2", "1"]
    assert sentences(poses(), origin=0.0) == []
    assert len(sentences(poses(line(0.0), line(1.0)), origin=0.0)) == 6


def test_attitudes_have_their_signs() -> None:
    # Columns of a rotation: right, down and forward in east, north and up.
    def angles(heading: float, pitch: float, roll: float) -> list[float]:
        # Level, heading north: right is east, down is down, forward is north.
        axes = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
        own = Rotation.from_euler("zxy", [roll, pitch, 0.0], degrees=True)
        about = Rotation.from_euler("z", -heading, degrees=True)
        attitude = about * Rotation.from_matrix(axes) * own
        text = pose_line(
            time=0.0, position=[0, 0, 0], attitude=attitude.as_quat(),
            covariance=np.zeros((6, 6)),
        )  # fmt: skip
        shown = fields(sentences(poses(text), origin=0.0)[2])
        return [float(shown[2]), float(shown[5]), float(shown[4])]

    assert angles(350, 0, 0) == pytest.approx([350, 0, 0], abs=1e-6)
    # Forward up is a positive pitch, right down a positive roll.
    assert angles(40, 10, 0) == pytest.approx([40, 10, 0], abs=1e-6)
    assert angles(40, 0, 20) == pytest.approx([40, 0, 20], abs=1e-6)


@pytest.mark.parametrize(
    ("angle", "text"),
    [
        (9.5, "00930.000000000,E"), (-9.25, "00915.000000000,W"),
        (0.0, "00000.000000000,E"), (120.1, "12006.000000000,E"),
    ],
)  # fmt: skip
def test_angles_are_degrees_and_minutes(angle, text) -> None:
    assert nmea._minutes(angle, "EW", 3) == text


def test_a_stream_has_the_date_once_a_second(monkeypatch) -> None:
    class Vehicle:
        def messages(self, begin: float, end: float) -> list[tuple[float, str]]:
            asked.append((begin, end))
            return [(begin, line(begin))] if end > begin else []

    asked: list[tuple[float, float]] = []
    clock = VirtualClock()
    clock.sleep(50.0)
    bench = SimpleNamespace(clock=clock, scan_start=0.0)
    begun = datetime(2026, 5, 2, 1, 2, 3, tzinfo=UTC).timestamp()
    monkeypatch.setattr(nmea.time, "time", lambda: begun)
    frame = PoseFrame(crs=CRS, crs_offset=OFFSET)
    device = SimulatedNmea(bench, Vehicle(), frame)
    assert device.answer("anything") == []
    stream = device.stream()
    first = next(stream)
    assert bench.scan_start == 50.0
    assert first == nmea_sentence("GPZDA,010203.010000,02,05,2026,00,00")
    kinds = [fields(next(stream))[0] for _ in range(3)]
    assert kinds == ["$GPGGA", "$GPGST", "$PASHR"]
    following = [fields(next(stream)) for _ in range(3 * 120)]
    dates = [words[1] for words in following if words[0] == "$GPZDA"]
    # The sums of a hundred steps may be just below a second.
    assert dates in (["010204.010000"], ["010204.020000"])
    assert asked[0] == (0.0, 0.0)
    assert asked[1] == (0.0, pytest.approx(0.01))
    assert asked[2] == (pytest.approx(0.01), pytest.approx(0.02))
    # The course began with the first client.
    clock.sleep(5.0)
    other = device.stream()
    next(other)
    assert bench.scan_start == 50.0
    assert asked[-1][0] == pytest.approx(clock.now() - 0.01 - 50.0)


def test_the_frame_of_sentences_is_that_of_file_survey_or_a_default(small) -> None:
    find = rehearsal._frame
    default = find(small, Settings())
    assert (default.crs, default.crs_offset) == ("EPSG:32632", (500e3, 4.883e6, 0.0))
    placed = small.with_({"pose": {"crs": "EPSG:25833", "crs_offset": [1.0, 2.0, 3.0]}})
    found = find(placed, Settings())
    assert (found.crs, found.crs_offset) == ("EPSG:25833", (1.0, 2.0, 3.0))
    unplaced = small.with_({"pose": {}})
    assert find(unplaced, Settings()).crs == "EPSG:32632"


def test_a_rehearsal_has_the_devices_file_of_its_simulators(small) -> None:
    base = Settings.model_validate(
        {"scanner": {"azimuth_zero": 2.0}, "procedure": {"settling": 7.0}}
    )
    frame = PoseFrame(crs=CRS, crs_offset=OFFSET)
    addresses = {"lock_in": "tcp://a:1", "stages": "tcp://a:2"}
    made = rehearsal._addressed(base, "sr844", addresses, frame, 3.0)
    assert made.lock_in.driver == "sr844"
    assert made.lock_in.address == "tcp://a:1"
    assert made.lock_in.mean_output_input == 1
    assert made.lock_in.modulation_amplitude is None
    assert made.scanner.azimuth_zero == 2.0
    for part in (made.scanner, made.launch, made.analyser, made.target):
        assert (part.driver, part.address) == ("pi_gcs", "tcp://a:2")
    assert made.analyser.axis == "4"
    laser = made.laser
    assert (laser.driver, laser.output, laser.on_voltage) == ("lock_in_output", 1, 5.0)
    assert laser.interlock_input == 2
    assert made.procedure.settling == 7.0
    assert made.procedure.clock_speed == 3.0
    assert made.navigation is None
    other = rehearsal._addressed(
        base, "sr865a", {**addresses, "navigation": "tcp://a:3"}, frame, 1.0
    )
    assert other.lock_in.modulation_amplitude == 0.5
    assert other.navigation.address == "tcp://a:3"
    assert (other.navigation.driver, other.navigation.crs) == ("nmea", CRS)
    assert other.navigation.crs_offset == OFFSET


def test_a_rehearsal_is_refused_before_a_port_is_open(small) -> None:
    course = {"kind": "line", "start": [0, 0, -8], "speed": 0.5}
    moving = small.with_({"platform": {"course": course}})
    with (
        pytest.raises(SurveyError) as caught,
        rehearse(moving, scene=scene_light, speed=2.0),
    ):
        pass
    assert str(caught.value) == (
        "platform: the sentences of its navigation have the time of day, so that "
        "simulated devices on the network run at speed 1, got 2"
    )
    for ports in ((-1, 0, 0), (0, 65_536, 0), (0, 0, -1)):
        with (
            pytest.raises(ValueError, match="ports must be") as wrong,
            rehearse(small, scene=scene_light, ports=ports),
        ):
            pass
        assert str(wrong.value) == (
            "ports must be from 1 to 65535, or 0 for any free one, got "
            f"{', '.join(map(str, ports))}"
        )
    with rehearse(small, scene=scene_light, model="sr865a") as found:
        assert found.lock_in.model == "SR865A"
        assert found.settings.lock_in.driver == "sr865a"
        assert found.settings.navigation is None
        assert found.stages.bench is found.bench
