"""Live view of a running scan, from the growing journal of the scan."""

from __future__ import annotations

import contextlib
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import acquisition
from amulor import cube as cubes
from amulor.acquisition.cube.samples import procedure_of
from amulor.acquisition.journal.file import in_use
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.run import resume_command
from amulor.cube import QualityFlag
from amulor.errors import AmulorError
from amulor.imaging.observation import geometry_of
from amulor.optics import ambiguity
from amulor.survey import Survey
from amulor.survey.directions import scan_directions
from amulor.survey.view import geometry_attributes
from amulor.view.page.coverage import Coverage
from amulor.view.page.progress import Progress
from amulor.view.page.recording import Comparison, Recording, recording_of
from amulor.view.page.traces import Traces

#: Equal for all frequencies, so that the highest frequency has the most weight [rad].
_PHASE_ERROR = 0.02


def quick_layers(
    row: xr.Dataset, signal: NDArray[np.complex128], ending: str
) -> dict[str, NDArray[np.float64]]:
    """Range, and amplitude at the first frequency, of a newly measured row.

    Slant ranges are computed as by `amulor.imaging.range_image`, but with equal phase
    errors at all frequencies, and without the late-light correction.
    """
    frequency = np.atleast_1d(row["modulation_frequency"].values)
    geometry = geometry_of(row)
    shortest, longest = geometry.path_limits(None, frequency)
    valid = np.isfinite(signal).all(axis=0)
    filled = np.where(valid, signal, 1.0)[:, None]
    path = ambiguity.optical_path(
        np.angle(filled),
        np.full(filled.shape, _PHASE_ERROR),
        modulation_frequency=frequency,
        shortest=shortest,
        longest=longest,
        doubt=1.0,
    )
    ranges = geometry.slant_range(path.length)[0]
    amplitude = np.abs(filled[0, 0])
    return {
        f"range{ending}": np.where(valid, ranges, np.nan),
        f"amplitude{ending}": np.where(valid, amplitude, np.nan),
    }


#: Interval of reading the journal [s].
POLL = 0.2
#: All pixels are recomputed after this time, or later if it takes long [s].
_AGAIN = 2.0
#: Largest fraction of the time for recomputation [1].
_SHARE = 0.15

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rows:
    """Newly measured row of a channel, sent to the page ahead of recomputation."""

    version: int
    channel: str
    row: int
    layers: dict[str, Floats]


class Live:
    """Live view of the folder of a running scan."""

    def __init__(
        self, folder: Path, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.folder = folder
        self.name = folder.resolve().name
        with Journal.read(folder) as journal:
            meta = journal.meta()
            procedure = procedure_of(journal)
        self._survey = Survey.from_text(meta["survey"], name="the survey of the scan")
        self._progress = Progress(self._survey, meta, clock=clock)
        self.traces = Traces(self._survey, procedure)
        #: Track and coverage of a scan from a vehicle; None if the instrument stands.
        self.coverage: Coverage | None = None
        if self._survey.platform is not None:
            self.coverage = Coverage(self._survey)
        self._clock = clock
        self._lock = threading.Lock()
        #: The journal is read by one thread at a time.
        self._reading = threading.Lock()
        self._changed: set[tuple[str, int]] = set()
        self._rows: dict[tuple[str, int], Rows] = {}
        self._version = self.pictures = 0
        self._worked_out_at, self._took = -np.inf, 0.0
        self._known = -1
        self._last = 0
        self._journal: Journal | None = None
        self.recording: Recording = blank(self._survey, self.name)
        self.status: dict[str, Any] = {}
        #: Comparison with a reference, of which the page shows the deviations.
        self.against: Comparison | None = None
        self.row_time = 0.0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def polarizations(self) -> list[str]:
        """Names of the measured channels."""
        return list(self._survey.instrument.polarizations)

    def start(self) -> None:
        """Start a thread that reads the journal at intervals."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Stop the thread and close the journal."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(10)
        with self._reading:
            self._close()

    def _run(self) -> None:
        while not self._stop.is_set():
            self.look()
            self._stop.wait(POLL)

    def look(self) -> None:
        """Read new samples from the journal; put errors into the status."""
        with self._reading:
            try:
                self._look()
            except (AmulorError, ValueError, LookupError, OSError) as error:
                # The page reports any error, and the next attempt follows.
                self._close()
                with self._lock:
                    self.status = {**self.status, "error": str(error)}

    def _close(self) -> None:
        if self._journal is not None:
            self._journal.close()
            self._journal = None

    def _look(self) -> None:
        if self._journal is None:
            self._journal = Journal.read(self.folder)
        fresh = self._journal.newer(self._last)
        for number, key, record in fresh:
            self._last = number
            self.traces.take(key, record)
            if self.coverage is not None:
                self.coverage.take(key, record)
            place = self._progress.take(key, record)
            if place is not None:
                self._changed.add(place)
        begun = time.perf_counter()
        rows = self._patched()
        if rows:
            self.row_time = (time.perf_counter() - begun) / len(rows)
        # Queried before the segments: a writer ends its segment, then releases the
        # lock.
        resume = None if in_use(self.folder) else resume_command(self.folder)
        segments = self._journal.segments()
        status = self._progress.status(segments, resume=resume)
        if self.coverage is not None:
            self.coverage.look(self._journal, self._ranges, version=self.pictures)
            status["coverage"] = self.coverage.version
            if status["state"] == "running":
                status["advice"] = [*self.coverage.advice, *status["advice"]]
        with self._lock:
            self._rows.update({(row.channel, row.row): row for row in rows})
            self.status = status
        self._maybe_all()

    def _ranges(self) -> Floats:
        """Slant ranges of the first channel, with the water in where it is not out."""
        channel = self.polarizations[0]
        ranges = self.now(channel, "range")
        return np.where(np.isfinite(ranges), ranges, self.now(channel, "range_before"))

    def _patched(self) -> list[Rows]:
        """Newly completed rows, raw and corrected with the last water estimate."""
        rows = []
        for channel, row in sorted(self._changed):
            if not self._progress.is_complete(channel, row):
                continue
            self._changed.discard((channel, row))
            layers = self._quick(channel, row)
            if layers:
                self._version += 1
                rows.append(Rows(self._version, channel, row, layers))
        return rows

    def _quick(self, channel: str, row: int) -> dict[str, Floats]:
        """Range and amplitude of a row: raw, and corrected with the water estimate."""
        row_cube = self.recording.one_row(channel, row)
        if row_cube is None:
            return {}
        measured = self._progress.row_signal(channel, row)
        layers = quick_layers(row_cube, measured, "_before")
        if "water_in_phase" in row_cube:
            water = (
                row_cube["water_in_phase"].values
                + 1j * row_cube["water_quadrature"].values
            )
            layers |= quick_layers(row_cube, measured - water[:, 0], "")
        return layers

    def _maybe_all(self) -> None:
        """Recompute all pixels if samples are new and enough time has passed."""
        now = self._clock()
        pause = max(_AGAIN, self._took / _SHARE)
        finished = self.status.get("state") != "running"
        if self._progress.scanned == 0 or self._progress.seen == self._known:
            return
        if not finished and now - self._worked_out_at < pause:
            return
        samples_seen = self._progress.seen
        begun = self._clock()
        assert self._journal is not None
        with contextlib.suppress(AmulorError), warnings.catch_warnings():
            # A scan that has just begun has means over no samples.
            warnings.simplefilter("ignore", RuntimeWarning)
            cube = acquisition.build(self._journal)
            picture = recording_of(cube, name=self.name)
            picture.against = self.against
            for channel in picture.channels:
                picture.channel(channel)
            with self._lock:
                self.recording = picture
                self.pictures += 1
                self._rows.clear()
        self._known = samples_seen
        self._worked_out_at = self._clock()
        self._took = self._worked_out_at - begun

    def snapshot(self, version: int) -> tuple[int, dict[str, Any], list[Rows]]:
        """Return number of recomputations, status, and rows newer than a version."""
        with self._lock:
            rows = [row for row in self._rows.values() if row.version > version]
            return self.pictures, dict(self.status), sorted(rows, key=_by_version)

    def now(self, channel: str, name: str) -> Floats:
        """Return a map including rows measured after the last recomputation."""
        with self._lock:
            recording, rows = self.recording, list(self._rows.values())
        values = np.full(recording.channel().shown.shape, np.nan)
        if channel in recording.channels and name in recording.layers(channel):
            values[:] = recording.layer(channel, name, 1)
        for row in rows:
            if row.channel == channel and name in row.layers:
                values[row.row] = row.layers[name]
        return values


def _by_version(row: Rows) -> int:
    return row.version


def blank(survey: Survey, name: str) -> Recording:
    """Return the page content of a scan in which no pixel is measured."""
    azimuth, elevation, _ = scan_directions(survey)
    nothing = np.full(azimuth.shape, np.nan)
    image = cubes.build(
        "range_image",
        {
            "slant_range": nothing,
            "slant_range_uncertainty": nothing.copy(),
            "intensity": nothing.copy(),
            "quality_flag": np.full(
                azimuth.shape, int(QualityFlag.MISSING), dtype=np.int16
            ),
        },
        {"azimuth": azimuth, "elevation": elevation},
        geometry=geometry_attributes(survey),
        attributes=cubes.attributes(
            "range_image",
            title=survey.name,
            source="a scan that has not begun",
            polarization=survey.instrument.polarizations[0],
            modulation_frequencies=np.array(survey.instrument.modulation_frequencies),
        ),
    )
    return Recording(
        name, image=image, notes=["Nothing of the target is measured yet."]
    )
