"""Sensitivity of each check to the input numbers, at both ends of their ranges."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from typing import Any

from amulor._extras import require
from amulor.errors import AmulorError
from amulor.io.files import atomic_output, make_folder
from amulor.studies.ricci2010.parameters import Parameter, varied
from amulor.studies.ricci2010.results import Change, Check, Dependence
from amulor.studies.ricci2010.study import Study

Checks = Callable[[Study], list[Check]]


def sensitivity(
    study: Study,
    figures: Mapping[int, Checks],
    *,
    workers: int = 1,
    scheduler: str | None = None,
    folder: Path | None = None,
    progress: Callable[[str, float], None] = lambda step, done: None,
) -> tuple[Dependence, ...]:
    """Repeat all checks with each uncertain input number at both ends of its range.

    One number at a time; numbers that a figure does not read are left alone. The
    noise is the same in all, so that a flip is the number's doing.
    """
    read, before = {}, {}
    for number, checks in figures.items():
        progress(f"what figure {number} reads", 0.0)
        read[number], before[number] = study.read_by(checks)
    ends = [
        _End(parameter.name, value, shown)
        for parameter in study.parameters.values()
        if parameter.limits is not None and parameter.shown_limits is not None
        for value, shown in zip(parameter.limits, parameter.shown_limits, strict=True)
        if value != parameter.value
    ]
    tasks = [
        (end, number, len(before[number]))
        for end in ends
        for number in figures
        if end.name in read[number]
    ]
    changes: dict[tuple[int, int], list[Change]] = {}
    if scheduler is None or folder is None:
        worked = _worked(study, figures, tasks, workers)
    else:
        worked = _on_cluster(study, figures, tasks, scheduler, folder)
    for done, (task, outcomes) in enumerate(worked):
        end, number, _ = task
        progress(f"varied {end.name}, figure {number}", (done + 1) / len(tasks))
        for place, (result, text, passed) in enumerate(outcomes):
            changes.setdefault((number, place), []).append(
                Change(
                    parameter=end.name,
                    shown=end.shown,
                    found=text,
                    passed=passed,
                    value=result,
                )
            )
    order = {name: place for place, name in enumerate(study.parameters)}
    return tuple(
        Dependence(
            number,
            check,
            tuple(
                sorted(
                    changes.get((number, place), ()), key=lambda c: order[c.parameter]
                )
            ),
        )
        for number in figures
        for place, check in enumerate(before[number])
    )


@dataclass(frozen=True)
class _End:
    """Upper or lower end of an input number's range."""

    name: str
    value: float
    shown: str


_Task = tuple[_End, int, int]
_Outcome = tuple[float | None, str, bool]


def _worked(
    study: Study, figures: Mapping[int, Checks], tasks: list[_Task], workers: int
) -> Iterator[tuple[_Task, list[_Outcome]]]:
    """Yield tasks with their outcomes, computed by a number of processes."""
    together = _by_end(tasks)
    if workers == 1:
        for group in together:
            for task in group:
                yield task, _outcome(study, figures, task)
        return
    spawn = get_context("spawn")
    running = set(active_children())
    with ProcessPoolExecutor(
        min(workers, len(together) or 1), spawn, initializer=_begin
    ) as pool:
        parameters = tuple(study.parameters.values())
        futures = [
            pool.submit(
                _outcomes_in_worker,
                parameters,
                study.quick,
                study.seed,
                dict(figures),
                group,
            )
            for group in together
        ]
        try:
            for group, outcomes in zip(together, futures, strict=True):
                yield from zip(group, outcomes.result(), strict=True)
        except BaseException:
            # Leaving the pool would wait for all that is at work.
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(active_children()) - running:
                process.kill()
            raise


def _by_end(tasks: list[_Task]) -> list[list[_Task]]:
    """Group tasks by input number and end of range."""
    return [list(group) for _, group in groupby(tasks, key=lambda task: task[0])]


def _on_cluster(
    study: Study,
    figures: Mapping[int, Checks],
    tasks: list[_Task],
    scheduler: str,
    folder: Path,
) -> Iterator[tuple[_Task, list[_Outcome]]]:
    """Yield tasks with their outcomes, from files written by cluster workers."""
    require("scale", purpose="a cluster")
    from amulor.scale.tasks import cluster_client, in_order

    together = _by_end(tasks)
    work = _Ends(
        parameters=tuple(study.parameters.values()),
        quick=study.quick,
        seed=study.seed,
        figures=dict(figures),
        together=together,
    )
    make_folder(folder)
    with cluster_client(scheduler, None) as client:
        paths = in_order(client, folder.resolve(), work, 0, len(together))
        for group, path in zip(together, paths, strict=True):
            outcomes = json.loads(path.read_text("utf-8"))
            yield from zip(group, ([*map(tuple, o)] for o in outcomes), strict=True)


@dataclass(frozen=True, kw_only=True)
class _Ends:
    """Files of check outcomes, one for each end of each input number's range."""

    parameters: tuple[Parameter, ...]
    quick: bool
    seed: int
    figures: dict[int, Checks]
    together: list[list[_Task]]
    file: str = "end.json"

    def made_of(self, number: int) -> dict[str, Any]:
        """Return all inputs that determine the outcomes at an end of range, by name."""
        return {
            "parameters": {entry.name: entry.value for entry in self.parameters},
            "quick": self.quick,
            "seed": self.seed,
            "end": [
                [end.name, end.value, figure, _name(self.figures[figure]), count]
                for end, figure, count in self.together[number]
            ],
        }

    def write(self, number: int, path: Path) -> None:
        """Write the outcomes at one end of a range to a file."""
        group = self.together[number]
        outcomes = _outcomes_in_worker(
            self.parameters, self.quick, self.seed, self.figures, group
        )
        plain = [
            [
                (None if v is None else float(v), text, bool(ok))
                for v, text, ok in outcome
            ]
            for outcome in outcomes
        ]
        with atomic_output(path, overwrite=True) as temporary:
            temporary.write_text(json.dumps(plain) + "\n", "utf-8")


def _name(function: Any) -> str:
    """Return the qualified name of a function."""
    return f"{function.__module__}.{function.__qualname__}"


def _begin() -> None:
    """Set up a worker process to end with its parent and to ignore Ctrl-C.

    A run of photons would take an interrupt for the wish to go on with the photons it
    has.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: BaseProcess) -> None:
    """Wait until a process ends, then exit."""
    parent.join()
    os._exit(1)


def _outcomes_in_worker(
    parameters: tuple[Parameter, ...],
    quick: bool,
    seed: int,
    figures: Mapping[int, Checks],
    tasks: list[_Task],
) -> list[list[_Outcome]]:
    """Compute the outcomes of tasks in a worker process."""
    study = _study_here(parameters, quick, seed)
    return [_outcome(study, figures, task) for task in tasks]


@cache
def _study_here(parameters: tuple[Parameter, ...], quick: bool, seed: int) -> Study:
    """Return the cached study common to all tasks of a process."""
    return Study({entry.name: entry for entry in parameters}, quick=quick, rng=seed)


def _outcome(
    study: Study, figures: Mapping[int, Checks], task: _Task
) -> list[_Outcome]:
    end, number, count = task
    changed = study.with_parameters(varied(study.parameters, end.name, end.value))
    return _outcomes(figures[number], changed, count)


def _outcomes(checks: Checks, study: Study, count: int) -> list[_Outcome]:
    """Return value, text and outcome of each check; all fail after an error."""
    try:
        result = checks(study)
    except (AmulorError, ValueError) as problem:
        return [(None, f"cannot be computed: {problem}", False)] * count
    if len(result) != count:
        raise RuntimeError(f"{len(result)} checks where there were {count}")
    return [(check.value, check.found, check.passed) for check in result]
