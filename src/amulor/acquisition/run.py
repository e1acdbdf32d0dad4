"""Acquisition run: devices, journal, progress, pauses and resuming."""

from __future__ import annotations

import contextlib
import datetime
import itertools
import json
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from amulor import cube
from amulor.acquisition import plan
from amulor.acquisition.connect import connect
from amulor.acquisition.devices import Devices, digest
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import Key, Step
from amulor.acquisition.sampler import SPOILED, Sampler
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.scene import Scene
from amulor.errors import AmulorError, InstrumentError, SurveyError
from amulor.io.files import atomic_output, make_folder
from amulor.optics.polarization import stokes
from amulor.survey import Survey
from amulor.survey.directions import open_water_directions, scan_directions

#: Running mean of the commit time beyond which commits run in a thread [s].
SLOW = 0.3e-3
#: Weight of the newest commit in that average [1].
_WEIGHT = 0.1


class Keeper:
    """Writer of samples to a journal, in a thread if the disk is slow."""

    def __init__(
        self, journal: Journal, notify: Callable[[Step, int], None], *, at_once: bool
    ) -> None:
        self._journal, self._notify, self._at_once = journal, notify, at_once
        self._thread: ThreadPoolExecutor | None = None
        self._pending: tuple[Future[None], Step, int] | None = None
        self._took = 0.0

    def __enter__(self) -> Keeper:
        """Return the writer."""
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for the present commit."""
        if self._thread is not None:
            self._thread.shutdown()

    def keep(
        self,
        step: Step,
        records: Sequence[Record],
        messages: Sequence[tuple[float, str]] = (),
    ) -> None:
        """Write the samples of a dwell, after all earlier dwells are written."""
        samples = [*zip(step.keys, records, strict=True)]
        self.settle()
        if self._at_once or self._took < SLOW:
            self._commit(samples, messages)
            self._notify(step, len(samples))
            return
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "journal")
        future = self._thread.submit(self._commit, samples, messages)
        self._pending = (future, step, len(samples))

    def settle(self) -> None:
        """Wait until all samples are in the journal, and report progress."""
        if self._pending is None:
            return
        future, step, count = self._pending
        try:
            future.result()
        finally:
            # An interrupted wait is not over; it goes on with the next call.
            if future.done():
                self._pending = None
        self._notify(step, count)

    def _commit(
        self,
        samples: list[tuple[Key, Record]],
        messages: Sequence[tuple[float, str]],
    ) -> None:
        start = time.perf_counter()
        self._journal.commit_together(samples, messages)
        passed = time.perf_counter() - start
        self._took += _WEIGHT * (passed - self._took)


def refuse_beyond_reach(survey: Survey, settings: Settings, devices: Devices) -> None:
    """Raise if a direction of the scan is beyond the travel range of a stage."""
    azimuth, elevation = (angle.ravel() for angle in scan_directions(survey)[:2])
    if survey.scan.open_water is not None:
        shots = open_water_directions(survey)
        azimuth = np.concatenate([azimuth, shots[0]])
        elevation = np.concatenate([elevation, shots[1]])
    reference = survey.scan.reference
    if reference is not None:
        azimuth = np.append(azimuth, reference.azimuth)
        elevation = np.append(elevation, reference.elevation)
    ask = getattr(devices.scanner, "refuse_beyond_reach", None)
    if ask is not None:
        ends = (
            [float(angle.min()), float(angle.max())] for angle in (azimuth, elevation)
        )
        ask(*ends)
    pairs = [stokes.pair_states(pair) for pair in survey.instrument.polarizations]
    for place, name in enumerate(("launch", "analyser")):
        angles = getattr(settings, name).angles
        needed = [angles[pair[place]] for pair in pairs if pair[place] in angles]
        ask = getattr(getattr(devices, name), "refuse_beyond_reach", None)
        if ask is not None and needed:
            ask(needed)
    ask = getattr(devices.target, "refuse_beyond_reach", None)
    if ask is not None and survey.scan.open_water is not None:
        ask()


def refuse_unlike_vehicle(survey: Survey, settings: Settings, *, retake: bool) -> None:
    """Raise if procedure or devices do not fit the motion of the platform."""
    platform = survey.platform
    if platform is None:
        if settings.navigation is not None:
            raise SurveyError(
                "platform: is missing, but the devices file has a part navigation; "
                "state course and mounting in [platform], or take the part out"
            )
        return
    count = len(plan.combs(survey, settings.procedure))
    if platform.readings == "at-once" and count > 1:
        raise SurveyError(
            f'platform.readings: is "at-once", but {count} readings of a pixel follow '
            "one another by the devices file; state procedure.frequencies_at_once = "
            f"{len(survey.instrument.modulation_frequencies)} there and one "
            'polarization here, or platform.readings = "in-turn"'
        )
    if retake:
        raise SurveyError(
            "platform: the vehicle has moved on, so that samples cannot be acquired "
            "again; leave out --retake-flagged"
        )


#: Longest wait for poses after the last sample [s], number of messages, and step.
_LAST_POSES, _ENOUGH, _STEP = 2.0, 9, 0.05
#: Longest strip of a row, which a loss of power discards [s]; least number of pixels.
_LONGEST_ROW, _SHORTEST_ROW = 20.0, 4
SURVEY_NAME = "survey.toml"
DEVICES_NAME = "devices.toml"


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a scan.

    Examples
    --------
    >>> from amulor.acquisition import Progress
    >>> now = Progress(
    ...     done=120, total=400, rate=4.0, left=280 / 4.0, flagged=3, kind="scan"
    ... )
    >>> now.left
    70.0
    """

    done: int
    """Number of samples in the journal [1]."""
    total: int
    """Number of samples of the complete scan, with references [1]."""
    rate: float
    """Samples per second of real time since the start or the last pause [1/s]."""
    left: float
    """Remaining time at the present rate [s]."""
    flagged: int
    """Number of flagged samples in this run [1]."""
    kind: str
    """Kind of the present samples."""


class Control(Protocol):
    """Interface for pausing or ending a scan between two samples.

    Examples
    --------
    >>> class Never:
    ...     def pause_wanted(self) -> bool:
    ...         return False
    ...
    ...     def go_on(self) -> bool:
    ...         return True
    >>> from amulor.acquisition import Control
    >>> control: Control = Never()
    >>> control.pause_wanted()
    False
    """

    def pause_wanted(self) -> bool:
        """Return whether the scan must pause now."""

    def go_on(self) -> bool:
        """Wait during a pause, with all devices safe; False ends the scan."""


class _Unattended:
    def pause_wanted(self) -> bool:
        return False

    def go_on(self) -> bool:
        return True


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of an acquisition run.

    Examples
    --------
    >>> from amulor.acquisition import Outcome
    >>> outcome = Outcome(finished=False, done=120, total=400, flagged=3, unsafe=[])
    >>> print(f"{outcome.done / outcome.total:.0%} done")
    30% done
    """

    finished: bool
    """Whether every planned sample is in the journal."""
    done: int
    """Number of samples in the journal [1]."""
    total: int
    """Number of samples of the complete scan, with references [1]."""
    flagged: int
    """Number of flagged samples in this run [1]."""
    unsafe: list[str]
    """Devices that could not be made safe, with the reason."""


def acquire(
    survey: Survey,
    folder: Path,
    *,
    settings: Settings | None = None,
    resume: bool = False,
    retake_flagged: bool = False,
    devices: Devices | None = None,
    scene: Scene | None = None,
    control: Control | None = None,
    progress: Callable[[Progress], None] = lambda now: None,
    acknowledged: Callable[[Key], None] = lambda key: None,
    ask: Callable[[str], None] | None = None,
    shutter_closed: bool = False,
) -> Outcome:
    """Acquire a scan, or resume one, and write it to the journal of a folder.

    Parameters
    ----------
    survey : Survey
        Description of the scan.
    folder : pathlib.Path
        Folder of the scan; created if it does not exist.
    settings : Settings, optional
        Devices and procedure; by default simulated devices in this program.
    resume : bool
        Whether the scan in the folder is continued.
    retake_flagged : bool
        Whether overloaded and misplaced samples of earlier runs are acquired again,
        after all missing ones. Each take has a separate key; the cube gets the last.
    devices : Devices, optional
        Connected devices, instead of those that the settings name. They are made safe
        but not closed.
    scene : callable, optional
        Light of the simulated devices, such as `amulor.simulation.scene_light`; other
        devices do not need it.
    control : Control, optional
        Interface for pausing or ending the scan; by default none.
    progress : callable
        Function called after each sample.
    acknowledged : callable
        Function called with the key of each sample once it survives a loss of power.
    ask : callable, optional
        Function that shows a request to an operator and returns when it is fulfilled.
    shutter_closed : bool
        Whether the shutter in front of the detector is closed during the whole scan, so
        that its samples are the leakage with the laser on. A shutter without a driver
        is closed by hand before. A resumed scan continues as it began.

    Returns
    -------
    Outcome
        Result; `finished` is False only if `control` ended the scan, or if a device
        could not be made safe in a pause.

    Raises
    ------
    FormatError
        If the folder cannot be used, for example because its disk is full.
    SurveyError, InstrumentError
        If a scan is resumed with another survey or other devices; if a device fails.
        What was acknowledged is kept, and all devices have been made safe.

    Examples
    --------
    >>> from amulor import Survey, acquisition, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...         "scan.open_water": None,
    ...     }
    ... )
    >>> import tempfile
    >>> from pathlib import Path
    >>> def scene(survey):
    ...     return simulation.scene_light(survey, model=simulation.ClosureModel())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     outcome = acquisition.acquire(survey, Path(folder) / "scan", scene=scene)
    >>> outcome.finished, outcome.unsafe
    (True, [])
    """
    settings = settings or Settings()
    # Refused before anything is touched.
    plan.combs(survey, settings.procedure)
    refuse_unlike_vehicle(survey, settings, retake=retake_flagged)
    start = {
        "survey": survey.to_toml(),
        "survey_digest": cube.digest(survey.to_toml()),
    }
    if shutter_closed:
        start["shutter"] = "closed"
    with contextlib.ExitStack() as stack:
        # The folder is locked first: a running scan of this folder uses the devices,
        # and a refused scan must not switch off its laser.
        if resume:
            journal = stack.enter_context(Journal.resume(folder, meta=start))
            part = len(journal.segments())
            began_closed = journal.meta().get("shutter") == "closed"
            if shutter_closed and not began_closed:
                raise InstrumentError(
                    "the scan began with an open shutter and cannot go on with a "
                    "closed one; record the leakage in another folder"
                )
            shutter_closed = began_closed
        else:
            make_folder(folder)
            claim = Journal.claim(folder)
            stack.callback(claim.close)
            part = 0
        elapsed = journal.last_elapsed() if resume else 0.0
        if devices is None:
            devices = connect(
                survey,
                settings,
                scene=scene,
                part=part,
                elapsed=elapsed,
                ask=ask,
                shutter_closed=shutter_closed,
            )
            stack.callback(devices.close)
        with _left_safe(devices):
            identities = devices.identities()
            meta = {
                **start,
                "devices": settings.to_toml(),
                "instrument_digest": digest(settings, identities),
                "identities": json.dumps(identities),
            }
            if resume:
                journal.refuse_another(meta)
            else:
                journal = Journal.create(folder, meta=meta, claim=claim)
                stack.enter_context(journal)
            _keep_copies(journal)
            refuse_beyond_reach(survey, settings, devices)
            run = _Run(
                survey,
                settings,
                devices,
                journal,
                retake=retake_flagged,
                shutter_closed=shutter_closed,
            )
            return run.go(control or _Unattended(), progress, acknowledged)


def _in_step(control: Control) -> bool:
    """Return whether a control object requests samples one by one."""
    return bool(getattr(control, "in_step", False))


def resume_command(folder: Path) -> str:
    """Return the command that resumes the scan of a folder."""
    words = ["amulor", "acquire", str(folder / SURVEY_NAME), "-o", str(folder)]
    return shlex.join([*words, "--resume"])


@contextlib.contextmanager
def _left_safe(devices: Devices) -> Iterator[None]:
    """Make devices safe after an exception; add the unsafe ones to its message."""
    try:
        yield
    except BaseException as error:
        # Again, in case the first call was interrupted or missing.
        unsafe = "; ".join(devices.make_safe())
        if unsafe and isinstance(error, AmulorError):
            raise type(error)(f"{unsafe}; {error}") from error
        if unsafe:
            error.add_note(unsafe)
        raise


class _Run:
    def __init__(
        self,
        survey: Survey,
        settings: Settings,
        devices: Devices,
        journal: Journal,
        *,
        retake: bool,
        shutter_closed: bool,
    ) -> None:
        self._survey, self._settings = survey, settings
        self._devices, self._journal = devices, journal
        self._sampler = Sampler(
            survey, settings, devices, shutter_closed=shutter_closed
        )
        self._done = journal.keys()
        self._retakes = [*self._to_be_retaken()] if retake else []
        self._flagged = 0
        self._elapsed = journal.last_elapsed()
        self._clock_start = devices.clock.now()
        self._begin_to_count()

    def go(
        self,
        control: Control,
        progress: Callable[[Progress], None],
        acknowledged: Callable[[Key], None],
    ) -> Outcome:
        missing = self._missing()
        navigation, begun = self._devices.navigation, False
        while missing:
            if not begun:
                # The segment has the date of this moment.
                self._clock_start = self._devices.clock.now()
                self._elapsed = max(self._elapsed, self._passed())
            segment = self._journal.begin_segment()
            if not begun and navigation is not None:
                navigation.begin()
            begun = True
            unsafe = self._part(segment, missing, control, progress, acknowledged)
            self._sampler.forget()
            missing = self._missing()
            if missing and (unsafe or not control.go_on()):
                break
        else:
            unsafe = self._devices.make_safe()
        return Outcome(
            finished=not missing,
            done=len(self._done),
            total=len(self._done) + sum(len(step.keys) for step in missing),
            flagged=self._flagged,
            unsafe=unsafe,
        )

    def _part(
        self,
        segment: int,
        missing: list[Step],
        control: Control,
        progress: Callable[[Progress], None],
        acknowledged: Callable[[Key], None],
    ) -> list[str]:
        """Acquire missing samples until a pause; return devices that are not safe."""
        reason, total = "stopped", 0

        def note(step: Step, count: int) -> None:
            self._done.update(step.keys)
            self._taken += count
            for key in step.keys:
                acknowledged(key)
            progress(self._progress(step, total))

        with Keeper(self._journal, note, at_once=_in_step(control)) as keeper:
            try:
                try:
                    steps = [*self._again(segment), *missing]
                    self._sampler.prepare()
                    self._begin_to_count()
                    total = len(self._done) + sum(len(step.keys) for step in steps)
                    for strip in self._strips(steps):
                        if control.pause_wanted():
                            reason = "paused"
                            break
                        self._take(strip, segment, keeper)
                    keeper.settle()
                    reason = reason if reason == "paused" else "finished"
                except AmulorError as error:
                    reason = str(error)
                    raise
                except BaseException as error:
                    reason = f"interrupted by {type(error).__name__}"
                    raise
                finally:
                    unsafe = self._end(segment, reason, keeper)
            except AmulorError as error:
                raise type(error)(self._with_next_step(error)) from error
        return unsafe

    def _missing(self) -> list[Step]:
        planned = plan.steps(self._survey, self._settings.procedure)
        all_steps = itertools.chain(planned, self._retakes)
        return [
            remaining for step in all_steps if (remaining := step.without(self._done))
        ]

    def _to_be_retaken(self) -> Iterator[Step]:
        """Yield dwells that repeat the samples whose newest acquisition was spoiled."""
        newest = {
            key._replace(repeat=0): (key, record.flags)
            for key, record in self._journal.samples(plan.SCAN)
        }
        return plan.retakes(
            self._survey,
            self._settings.procedure,
            spoiled=[key for key, flags in newest.values() if flags & SPOILED],
        )

    def _begin_to_count(self) -> None:
        """Restart the estimate of the sampling rate after a pause."""
        self._started = time.monotonic()
        self._taken = 0

    def _again(self, segment: int) -> Iterator[Step]:
        """Yield dwells that repeat the reference measurements after an interruption."""
        if any(key.kind == plan.SCAN for key in self._done):
            yield from plan.extra_reference(
                self._survey, self._settings.procedure, number=segment - 2
            )

    def _strips(self, steps: list[Step]) -> Iterator[list[Step]]:
        """Yield single dwells; in continuous mode, strips of a row."""
        longest = 1
        if self._settings.procedure.mode == "continuous":
            longest = max(int(_LONGEST_ROW / self._survey.scan.dwell), _SHORTEST_ROW)
        return plan.strips(steps, longest=longest)

    def _take(self, strip: list[Step], segment: int, keeper: Keeper) -> None:
        elapsed = self._elapsed + self._devices.clock.now() - self._clock_start
        kind = strip[0].key.kind
        if self._settings.procedure.mode == "continuous" and kind == plan.SCAN:
            dwells = self._sampler.sweep(strip, elapsed=elapsed, segment=segment)
        else:
            (step,) = strip
            dwells = [self._sampler.take(step, elapsed=elapsed, segment=segment)]
        records = [record for part in dwells for record in part]
        keeper.keep(plan.together(strip), records, self._messages())
        self._flagged += sum(bool(record.flags) for record in records)
        for part in dwells:
            self._sampler.refuse_darkness(kind, part[0].flags)

    def _passed(self) -> float:
        """Return the time since the start of a resumed scan on a real vehicle [s].

        The clock of its navigation went on during the break.
        """
        parts = self._journal.segments()
        if self._settings.simulated or self._settings.navigation is None or not parts:
            return 0.0
        start = datetime.datetime.fromisoformat(parts[0]["started"])
        return (datetime.datetime.now(datetime.UTC) - start).total_seconds()

    def _messages(self) -> list[tuple[float, str]]:
        """Return the new messages of the navigation, timed by the scan."""
        navigation = self._devices.navigation
        if navigation is None:
            return []
        start = self._clock_start - self._elapsed
        return [(arrival - start, line) for arrival, line in navigation.messages()]

    def _last_messages(self) -> list[tuple[float, str]]:
        """Wait for the poses after the last sample, and return them."""
        messages = self._messages()
        if self._devices.navigation is None:
            return messages
        end = self._devices.clock.now() + _LAST_POSES
        last = self._elapsed + self._devices.clock.now() - self._clock_start
        while self._devices.clock.now() < end:
            if sum(arrival > last for arrival, _ in messages) >= _ENOUGH:
                break
            self._devices.clock.sleep(_STEP)
            messages += self._messages()
        return messages

    def _progress(self, step: Step, total: int) -> Progress:
        rate = self._taken / max(time.monotonic() - self._started, 1e-9)
        done = len(self._done)
        remaining = (total - done) / rate
        return Progress(
            done=done,
            total=total,
            rate=rate,
            left=remaining,
            flagged=self._flagged,
            kind=step.key.kind,
        )

    def _end(self, segment: int, reason: str, keeper: Keeper) -> list[str]:
        # Light off before anything that could fail, such as a full disk.
        unsafe = self._devices.make_safe()
        with contextlib.suppress(AmulorError):
            keeper.settle()
        with contextlib.suppress(AmulorError):
            messages = (
                self._last_messages() if reason == "finished" else self._messages()
            )
            if messages:
                self._journal.commit_together([], messages)
        with contextlib.suppress(AmulorError):
            self._journal.end_segment(segment, "; ".join([reason, *unsafe]))
        return unsafe

    def _with_next_step(self, error: AmulorError) -> str:
        folder = self._journal.folder
        return (
            f"{error}; {len(self._done)} samples are kept in {folder}. Mend it, then "
            f"go on with: {resume_command(folder)}"
        )


def _keep_copies(journal: Journal) -> None:
    """Copy survey and devices file to the folder of a journal, if missing."""
    meta = journal.meta()
    for name, key in ((SURVEY_NAME, "survey"), (DEVICES_NAME, "devices")):
        path = journal.folder / name
        if not path.exists():
            with atomic_output(path) as temporary:
                temporary.write_text(meta[key], encoding="utf-8")
