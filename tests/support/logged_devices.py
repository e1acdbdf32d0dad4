"""Devices that log each call and answer by what is set, and a sampler of them."""

from __future__ import annotations

from typing import Any

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.devices import Devices
from amulor.acquisition.plan import SCAN, Key, Step
from amulor.acquisition.protocols import Reading
from amulor.acquisition.sampler import Sampler
from amulor.acquisition.settings import Settings
from amulor.survey import Survey

FREQUENCY = 39e6


class Logged:
    """A device that logs each call, and answers by what is set."""

    def __init__(self, name: str, log: list[Any], **answers: Any) -> None:
        self._name, self._log, self.answers = name, log, answers

    def identity(self) -> str:
        return self._name

    def __getattr__(self, word: str) -> Any:
        if word not in self.answers:
            raise AttributeError(word)
        answer = self.answers[word]

        def call(*given: Any, **more: Any) -> Any:
            self._log.append((f"{self._name}.{word}", *given, *more.values()))
            return answer(*given, **more) if callable(answer) else answer

        return call


class LoggedClock(VirtualClock):
    """A clock that logs its waits."""

    def __init__(self, log: list[Any]) -> None:
        super().__init__()
        self._log = log

    def sleep(self, duration: float) -> None:
        self._log.append(("sleep", round(duration, 9)))
        super().sleep(duration)


def reading(signal: complex = 0.5 - 1j, **more: Any) -> Reading:
    known = {"mean": 0.25, "modulation_frequency": FREQUENCY}
    return Reading(signal=signal, **{**known, **more})


def logged_devices(log: list[Any]) -> Devices:
    """Return devices that do at once what they are told."""
    return Devices(
        laser=Logged("laser", log, on=None, off=None, check=None),
        lock_in=Logged(
            "lock_in", log, read=lambda: reading(), full_scale=2.0, sharpen=False,
            relieve=False, set_frequency=lambda f, timeout: f, prepare=None,
        ),
        scanner=Logged("scanner", log, move=lambda a, e, timeout: (a, e)),
        launch=Logged("launch", log, rotate=lambda angle, timeout: angle + 1e-3),
        analyser=Logged("analyser", log, rotate=lambda angle, timeout: angle),
        target=Logged("target", log, bring_in=0.01, take_out=0.21),
        clock=LoggedClock(log),
    )  # fmt: skip


def sampler(small: Survey, devices: Devices, settings: Any = None, **more: Any):
    content = Settings.model_validate(settings or {})
    return Sampler(small, content, devices, **more)


def step(kind: str = SCAN, pair: str = "VH", row: int = 1, column: int = 2) -> Step:
    return Step(Key(kind, row, column, FREQUENCY, pair, 0), 0.1, -0.2)


def words(log: list[Any]) -> list[str]:
    return [entry[0] for entry in log]


def scripted(devices: Devices, *readings: Reading) -> None:
    left = [*readings]
    devices.lock_in.answers["read"] = lambda: left.pop(0) if len(left) > 1 else left[0]
