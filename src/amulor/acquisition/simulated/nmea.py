"""Simulated navigation that sends NMEA 0183 sentences to its clients."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
from scipy.spatial.transform import Rotation

from amulor.acquisition.settings.parts import PoseFrame
from amulor.acquisition.simulated.bench import Bench
from amulor.acquisition.simulated.scene import Vehicle
from amulor.io.navigation_logs import nmea_sentence
from amulor.io.trajectories import geographic
from amulor.platform.messages import Messages, messages_of

#: Wait between two looks for new poses [s].
_POLL = 0.01
#: Time from a date (ZDA) to the next [s].
_DATE_AGAIN = 1.0


class SimulatedNmea:
    """Navigation of the vehicle of a bench, whose course begins with the first client.

    Its clock is that of the computer, with offset and drift of the simulated vehicle.
    """

    def __init__(self, bench: Bench, vehicle: Vehicle, frame: PoseFrame) -> None:
        self._bench, self._vehicle, self._frame = bench, vehicle, frame
        self._lock = threading.Lock()
        self._begun: float | None = None

    def answer(self, line: str) -> list[str | bytes]:
        """Answer nothing: sentences are sent without a request."""
        return []

    def stream(self) -> Iterator[str]:
        """Yield sentences from now on, without an end."""
        with self._lock:
            if self._begun is None:
                self._begun = time.time()
                self._bench.scan_start = self._bench.clock.now()
            begun = self._begun
        start = self._bench.scan_start
        sent = self._bench.clock.now() - start
        dated = -np.inf
        while True:
            now = self._bench.clock.now() - start
            lines = [line for _, line in self._vehicle.messages(sent, now)]
            if lines and now - dated >= _DATE_AGAIN:
                dated = now
                moment = datetime.fromtimestamp(begun + now, UTC)
                day = f"{moment:%d,%m,%Y}"
                yield nmea_sentence(f"GPZDA,{_clock(moment)},{day},00,00")
            frame = self._frame
            yield from sentences(
                messages_of(
                    lines, clock="unix", crs=frame.crs, crs_offset=frame.crs_offset
                ),
                origin=begun,
            )
            sent = now
            self._bench.clock.sleep(_POLL)


def sentences(poses: Messages, *, origin: float) -> list[str]:
    """Return poses as sentences GGA, GST and PASHR; `origin` is their time 0 [s]."""
    if not poses.time.size:
        return []
    place = poses.position + poses.crs_offset
    longitude, latitude, convergence = geographic(place[:, :2], poses.crs)
    turn = Rotation.from_quat(poses.attitude).as_matrix()
    right, down, ahead = (turn[:, :, axis] for axis in range(3))
    heading = np.degrees(np.arctan2(ahead[:, 0], ahead[:, 1]) + convergence) % 360
    pitch = np.degrees(np.arcsin(np.clip(ahead[:, 2], -1.0, 1.0)))
    roll = np.degrees(np.arctan2(-right[:, 2], -down[:, 2]))
    sigma = np.sqrt(np.einsum("nii->ni", poses.covariance))
    level = np.degrees(np.hypot(sigma[:, 3], sigma[:, 4]) / np.sqrt(2))
    result = []
    for at, stamp in enumerate(poses.time):
        clock = _clock(datetime.fromtimestamp(origin + stamp, UTC))
        north, east = _minutes(latitude[at], "NS", 2), _minutes(longitude[at], "EW", 3)
        spread = ",".join(f"{value:.6f}" for value in sigma[at, [1, 0, 2]])
        angles = f"{heading[at]:.7f},T,{roll[at]:.7f},{pitch[at]:.7f},0.0"
        errors = f"{level[at]:.7f},{level[at]:.7f},{np.degrees(sigma[at, 5]):.7f}"
        result += [
            nmea_sentence(content)
            for content in (
                f"GPGGA,{clock},{north},{east},4,12,0.8,{place[at, 2]:.6f},M,0.0,M,,",
                f"GPGST,{clock},,,,,{spread}",
                f"PASHR,{clock},{angles},{errors},2,1",
            )
        ]
    return result


def _clock(moment: datetime) -> str:
    """Return the time of a day, as in a sentence."""
    return f"{moment:%H%M%S.%f}"


def _minutes(angle: float, signs: str, digits: int) -> str:
    """Return an angle [deg] as degrees and minutes, with the letter of its sign."""
    degrees, rest = divmod(abs(angle), 1.0)
    letter = signs[int(angle < 0)]
    return f"{int(degrees):0{digits}d}{60 * rest:012.9f},{letter}"
