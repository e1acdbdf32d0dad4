"""A scan as a bluesky plan for a RunEngine, with one event document per sample."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import importlib
import json
import threading
import time
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

from amulor.acquisition.devices import Devices
from amulor.acquisition.journal.documents import data_keys, data_of
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import Key
from amulor.acquisition.run import Outcome, Progress, acquire
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.scene import Scene
from amulor.errors import InstrumentError, MissingExtraError
from amulor.survey import Survey

#: Time without a request after which the laser is switched off [s].
_PATIENCE = 10.0


def scan(
    survey: Survey,
    folder: Path,
    *,
    settings: Settings | None = None,
    resume: bool = False,
    retake_flagged: bool = False,
    devices: Devices | None = None,
    scene: Scene | None = None,
    ask: Callable[[str], None] | None = None,
    md: Mapping[str, Any] | None = None,
) -> Generator[Any, Any, int]:
    """Run a scan as a bluesky plan; write samples to a journal and to documents.

    Notes
    -----
    A sample is in the journal before its event is emitted. A pause of the RunEngine
    makes all devices safe, and so does every end of the plan. After a
    pause the reference measurement is repeated, as after any interruption. The streams
    are `dark`, `open_water` and `scan`.

    Examples
    --------
    ``RE(scan(survey, Path("scan"), settings=settings), callback)``
    """
    try:
        stubs: Any = importlib.import_module("bluesky.plan_stubs")
        preprocessors: Any = importlib.import_module("bluesky.preprocessors")
    except ImportError:
        raise MissingExtraError(
            "bluesky", extra="bluesky", purpose="a scan as a plan"
        ) from None
    device = ScanDevice(
        survey, folder, settings=settings, resume=resume,
        retake_flagged=retake_flagged, devices=devices, scene=scene, ask=ask,
    )  # fmt: skip

    def events() -> Generator[Any, Any, int]:
        number = 0
        while True:
            yield from stubs.checkpoint()
            yield from stubs.abs_set(device, number + 1, wait=True)
            if device.finished_before(number + 1):
                return number
            number += 1
            yield from stubs.create(name=device.stream)
            yield from stubs.read(device)
            yield from stubs.save()

    def staged() -> Generator[Any, Any, int]:
        yield from stubs.stage(device, wait=True)
        about = {**device.about(), **(md or {})}
        count: int = yield from preprocessors.run_wrapper(events(), md=about)
        return count

    def unstaged() -> Generator[Any, Any, None]:
        yield from stubs.unstage(device, wait=True)

    count: int = yield from preprocessors.finalize_wrapper(staged(), unstaged)
    return count


class ScanDevice:
    """Bluesky device of a scan; setting it to n acquires samples up to number n.

    It is staged (devices are connected), set and read sample by sample, stopped (laser
    off, devices safe; the next set continues) and unstaged (the scan ends).

    The scan runs by `acquire` in a separate thread that waits between two dwells.
    Values read are those of the journal. Setting a number twice, as a RunEngine does
    after a pause, does not acquire again.
    """

    name = "amulor"
    parent = None
    #: `set` waits for each sample before the next one is requested.
    in_step = True

    def __init__(
        self,
        survey: Survey,
        folder: Path,
        *,
        settings: Settings | None = None,
        resume: bool = False,
        retake_flagged: bool = False,
        devices: Devices | None = None,
        scene: Scene | None = None,
        ask: Callable[[str], None] | None = None,
        patience: float = _PATIENCE,
    ) -> None:
        if settings is not None and settings.procedure.mode == "continuous":
            raise InstrumentError(
                "a plan waits for each sample before the next one, and the beam cannot "
                'move on without stops; take procedure.mode = "continuous" out of the '
                "devices file, or run the scan by 'amulor acquire'"
            )
        self._folder, self._resume, self._patience = folder, resume, patience
        self._run: Callable[[], Outcome] = lambda: acquire(
            survey, folder, settings=settings, resume=resume,
            retake_flagged=retake_flagged, devices=devices, scene=scene, ask=ask,
            control=self, progress=self._note_samples,
        )  # fmt: skip
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._requested = self._acquired = self._current = 0
        self._samples: dict[int, tuple[Key, Record, float]] = {}
        self._waiting: list[tuple[int, _Status]] = []
        self._ready, self._over = _Status(), _Status()
        #: Whether a pause or the end is requested, and whether it has begun.
        self._pause_requested = self._end_requested = self._paused = self._ended = False
        self._error: BaseException | None = None
        self._outcome: Outcome | None = None
        self._journal: Journal | None = None
        self._last = 0

    # -- called by a RunEngine ---------------------------------------------------------

    def stage(self) -> Any:
        """Connect the devices; the status is done once sampling can start."""
        if self._thread is not None:
            raise InstrumentError(
                "this scan was staged before; make another one, with resume=True"
            )
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()
        # A program that ends leaves no light on.
        atexit.register(self._end)
        return self._ready

    def set(self, number: int) -> Any:
        """Acquire samples up to a number, counted from the start of this run [1]."""
        status = _Status()
        with self._changed:
            self._pause_requested = False
            self._requested = max(self._requested, number)
            self._current = number
            for old in [old for old in self._samples if old < number]:
                del self._samples[old]
            self._waiting.append((number, status))
            self._changed.notify_all()
        self._resolve_waiting()
        return status

    def read(self) -> dict[str, Any]:
        """Return the quantities of the current sample, each with its time stamp."""
        key, record, moment = self._samples[self._current]
        return {
            name: {"value": value, "timestamp": moment}
            for name, value in data_of(key, record).items()
        }

    def describe(self) -> dict[str, Any]:
        """Return the description of each quantity of a sample."""
        return data_keys()

    @property
    def hints(self) -> dict[str, Any]:
        """Names of the quantities that bluesky plots."""
        return {"fields": ["in_phase", "quadrature"]}

    @property
    def stream(self) -> str:
        """Name of the current sample's event stream: its kind, such as scan or dark."""
        return self._samples[self._current][0].kind

    def finished_before(self, number: int) -> bool:
        """Return whether the scan ended with fewer samples than this number [1]."""
        return self._ended and self._acquired < number

    async def stop(self, success: bool = True) -> None:
        """Make all devices safe once the present dwell ends."""
        with self._changed:
            self._pause_requested = True
            self._changed.notify_all()
        if self._thread is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._wait_for_pause)

    def unstage(self) -> Any:
        """End the scan; the status is done once all devices are safe and released."""
        with self._changed:
            self._end_requested = True
            self._changed.notify_all()
        if self._thread is None:
            self._over.resolve(None)
        return self._over

    def about(self) -> dict[str, Any]:
        """Return the metadata of the scan for the start document."""
        with Journal.read(self._folder) as journal:
            meta = journal.meta()
        return {
            "plan_name": "amulor_scan",
            "detectors": ["lock_in"],
            "motors": ["azimuth", "elevation"],
            "survey": meta["survey"],
            "identities": json.loads(meta["identities"]),
            "folder": str(self._folder),
            "resumed": self._resume,
        }

    # -- called by the scan, in its thread ---------------------------------------------

    def pause_wanted(self) -> bool:
        """Wait for the next sample request; True for a pause, an end or a timeout."""
        self._ready.resolve(None)
        with self._changed:
            requested = self._changed.wait_for(
                lambda: (
                    self._end_requested
                    or self._pause_requested
                    or self._requested > self._acquired
                ),
                timeout=self._patience,
            )
            return not requested or self._end_requested or self._pause_requested

    def go_on(self) -> bool:
        """Wait for the next request during a pause; False if it ends the scan."""
        with self._changed:
            self._paused = True
            self._changed.notify_all()
            self._changed.wait_for(
                lambda: (
                    self._end_requested
                    or (not self._pause_requested and self._requested > self._acquired)
                )
            )
            self._paused = False
            return not self._end_requested

    def _note_samples(self, _: Progress) -> None:
        """Read new samples from the journal, and record them for bluesky."""
        if self._journal is None:
            self._journal = Journal.read(self._folder)
        moment = time.time()
        new = self._journal.newer(self._last)
        with self._changed:
            for number, key, record in new:
                self._acquired += 1
                self._samples[self._acquired] = (key, record, moment)
                self._last = number
        self._resolve_waiting()

    def _work(self) -> None:
        try:
            if self._resume and (self._folder / FILE_NAME).is_file():
                with Journal.read(self._folder) as journal:
                    self._last = journal.count()
            self._outcome = self._run()
        except BaseException as error:
            self._error = error
        finally:
            if self._journal is not None:
                self._journal.close()
            with self._changed:
                self._ended = True
                self._changed.notify_all()
            self._resolve_waiting()
            self._ready.resolve(self._error)
            self._over.resolve(self._unsafe_error())
            with contextlib.suppress(RuntimeError):  # a program that ends
                atexit.unregister(self._end)

    # -- between the two ---------------------------------------------------------------

    def _resolve_waiting(self) -> None:
        """Resolve each status whose sample is written or can no longer be acquired."""
        with self._changed:
            due = [
                pair
                for pair in self._waiting
                if self._ended or pair[0] <= self._acquired
            ]
            self._waiting = [pair for pair in self._waiting if pair not in due]
        for number, status in due:
            status.resolve(None if number <= self._acquired else self._error)

    def _unsafe_error(self) -> InstrumentError | None:
        """Return an error with the devices that could not be made safe, if any."""
        unsafe = [] if self._outcome is None else self._outcome.unsafe
        return InstrumentError("; ".join(unsafe)) if unsafe else None

    def _wait_for_pause(self) -> None:
        with self._changed:
            self._changed.wait_for(
                lambda: self._paused or self._ended or not self._pause_requested
            )

    def _end(self) -> None:
        self.unstage()
        if self._thread is not None:
            self._thread.join()


class _Status:
    """Status of an action for bluesky; may be resolved from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._callbacks: list[Callable[[Any], None]] = []
        self._error: BaseException | None = None

    def resolve(self, error: BaseException | None) -> None:
        """Mark the action as done, unless it was done before."""
        with self._lock:
            if self._over.is_set():
                return
            self._error = error
            self._over.set()
            callbacks = [*self._callbacks]
        for callback in callbacks:
            callback(self)

    def add_callback(self, callback: Callable[[Any], None]) -> None:
        """Call a function when the action is done, or now if it is already done."""
        with self._lock:
            if not self._over.is_set():
                self._callbacks.append(callback)
                return
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return the exception of the action, waiting for up to `timeout` [s]."""
        self._over.wait(timeout)
        return self._error

    @property
    def done(self) -> bool:
        """Whether the action is done."""
        return self._over.is_set()

    @property
    def success(self) -> bool:
        """Whether the action is done without an exception."""
        return self._over.is_set() and self._error is None
