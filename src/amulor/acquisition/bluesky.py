"""A scan as a plan of bluesky: a RunEngine runs it, and documents come with samples."""

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

#: How long light stays on while nobody asks for the next sample [s].
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
    """Run a scan as a plan of bluesky, into the journal of a folder and as documents.

    Notes
    -----
    A sample is in the journal before its event is emitted. A pause of the RunEngine
    makes all devices safe, and whatever way the plan ends they are safe then. After a
    pause the reference is taken again, as after any break. The streams are `dark`,
    `open_water` and `scan`.

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
        found: int = yield from preprocessors.run_wrapper(events(), md=about)
        return found

    def unstaged() -> Generator[Any, Any, None]:
        yield from stubs.unstage(device, wait=True)

    found: int = yield from preprocessors.finalize_wrapper(staged(), unstaged)
    return found


class ScanDevice:
    """A scan behind the protocols of bluesky: set to n, it has taken n samples.

    It is staged (devices are connected), set and read sample by sample, stopped (light
    off, all safe; the next set goes on) and unstaged (the scan ends where it is).

    The scan is `acquire`, in a thread of its own that waits between two dwells. What is
    read is what the journal holds. To be set to a number twice, as a RunEngine does
    after a pause, takes nothing twice.
    """

    name = "amulor"
    parent = None
    #: `set` waits for each sample before the next one is asked for.
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
            control=self, progress=self._taken_one,
        )  # fmt: skip
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._wanted = self._taken = self._current = 0
        self._samples: dict[int, tuple[Key, Record, float]] = {}
        self._waiting: list[tuple[int, _Status]] = []
        self._ready, self._over = _Status(), _Status()
        #: Whether somebody wants it to rest or to end, and whether it rests or has.
        self._to_rest = self._to_end = self._rests = self._ended = False
        self._error: BaseException | None = None
        self._outcome: Outcome | None = None
        self._journal: Journal | None = None
        self._last = 0

    # -- what a RunEngine calls --------------------------------------------------------

    def stage(self) -> Any:
        """Connect the devices; done when the first sample can be taken."""
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
        """Take samples until there are so many in this run [1]."""
        status = _Status()
        with self._changed:
            self._to_rest = False
            self._wanted = max(self._wanted, number)
            self._current = number
            for old in [old for old in self._samples if old < number]:
                del self._samples[old]
            self._waiting.append((number, status))
            self._changed.notify_all()
        self._settle()
        return status

    def read(self) -> dict[str, Any]:
        """Return the sample that it was set to."""
        key, record, moment = self._samples[self._current]
        return {
            name: {"value": value, "timestamp": moment}
            for name, value in data_of(key, record).items()
        }

    def describe(self) -> dict[str, Any]:
        """Return what a sample consists of."""
        return data_keys()

    @property
    def hints(self) -> dict[str, Any]:
        """What is worth a plot."""
        return {"fields": ["in_phase", "quadrature"]}

    @property
    def stream(self) -> str:
        """Stream of the sample that it was set to: dark, open_water or scan."""
        return self._samples[self._current][0].kind

    def finished_before(self, number: int) -> bool:
        """Return whether the scan has ended with fewer samples than these [1]."""
        return self._ended and self._taken < number

    async def stop(self, success: bool = True) -> None:
        """Make all devices safe after the dwell that is taken now."""
        with self._changed:
            self._to_rest = True
            self._changed.notify_all()
        if self._thread is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._wait_for_rest)

    def unstage(self) -> Any:
        """End the scan where it is; done when all devices are safe and let go of."""
        with self._changed:
            self._to_end = True
            self._changed.notify_all()
        if self._thread is None:
            self._over.resolve(None)
        return self._over

    def about(self) -> dict[str, Any]:
        """Return what the start document is to say of the scan."""
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

    # -- what the scan calls, in its thread --------------------------------------------

    def pause_wanted(self) -> bool:
        """Wait until a sample is asked for; True if none is for a while."""
        self._ready.resolve(None)
        with self._changed:
            asked = self._changed.wait_for(
                lambda: self._to_end or self._to_rest or self._wanted > self._taken,
                timeout=self._patience,
            )
            return not asked or self._to_end or self._to_rest

    def go_on(self) -> bool:
        """Wait, with all devices safe, until a sample is asked for, or for the end."""
        with self._changed:
            self._rests = True
            self._changed.notify_all()
            self._changed.wait_for(
                lambda: (
                    self._to_end or (not self._to_rest and self._wanted > self._taken)
                )
            )
            self._rests = False
            return not self._to_end

    def _taken_one(self, _: Progress) -> None:
        """Note the samples of the dwell that was committed last."""
        if self._journal is None:
            self._journal = Journal.read(self._folder)
        moment = time.time()
        new = self._journal.newer(self._last)
        with self._changed:
            for number, key, record in new:
                self._taken += 1
                self._samples[self._taken] = (key, record, moment)
                self._last = number
        self._settle()

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
            self._settle()
            self._ready.resolve(self._error)
            self._over.resolve(self._left_unsafe())
            with contextlib.suppress(RuntimeError):  # a program that ends
                atexit.unregister(self._end)

    # -- between the two ---------------------------------------------------------------

    def _settle(self) -> None:
        """Tell those that wait for samples which are there now, or never will be."""
        with self._changed:
            done = [
                pair for pair in self._waiting if self._ended or pair[0] <= self._taken
            ]
            self._waiting = [pair for pair in self._waiting if pair not in done]
        for number, status in done:
            status.resolve(None if number <= self._taken else self._error)

    def _left_unsafe(self) -> InstrumentError | None:
        """Return what is to be said of devices that could not be made safe."""
        unsafe = [] if self._outcome is None else self._outcome.unsafe
        return InstrumentError("; ".join(unsafe)) if unsafe else None

    def _wait_for_rest(self) -> None:
        with self._changed:
            self._changed.wait_for(
                lambda: self._rests or self._ended or not self._to_rest
            )

    def _end(self) -> None:
        self.unstage()
        if self._thread is not None:
            self._thread.join()


class _Status:
    """Whether something is done, as bluesky asks for it; from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._callbacks: list[Callable[[Any], None]] = []
        self._error: BaseException | None = None

    def resolve(self, error: BaseException | None) -> None:
        """Be done, unless it was so before."""
        with self._lock:
            if self._over.is_set():
                return
            self._error = error
            self._over.set()
            callbacks = [*self._callbacks]
        for callback in callbacks:
            callback(self)

    def add_callback(self, callback: Callable[[Any], None]) -> None:
        """Call something when it is done, or now."""
        with self._lock:
            if not self._over.is_set():
                self._callbacks.append(callback)
                return
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return what went wrong, None if nothing did or it is not done [s]."""
        self._over.wait(timeout)
        return self._error

    @property
    def done(self) -> bool:
        """Whether it is done."""
        return self._over.is_set()

    @property
    def success(self) -> bool:
        """Whether it is done, and nothing went wrong."""
        return self._over.is_set() and self._error is None
