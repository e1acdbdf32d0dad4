"""Runs of the trust study over scenes, methods and numbers of frequencies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from amulor.studies.trust.methods import METHODS, outcome
from amulor.studies.trust.scenes.catalogue import BY_NAME, SCENES
from amulor.studies.trust.table import Row, score


def run(
    scenes: Sequence[str] | None = None,
    methods: Sequence[str] | None = None,
    counts: Sequence[int] | None = None,
    *,
    seed: int = 1,
    done: Callable[[Row], None] | None = None,
) -> list[Row]:
    """Run the trust study, or a part of it."""
    rows = []
    for row in _rows(
        [scene.name for scene in SCENES] if scenes is None else scenes,
        list(METHODS) if methods is None else methods,
        counts,
        seed,
    ):
        rows.append(row)
        if done is not None:
            done(row)
    return rows


def _rows(
    scenes: Sequence[str], methods: Sequence[str], counts: Sequence[int] | None,
    seed: int,
) -> Iterator[Row]:  # fmt: skip
    for kind, names, available in (
        ("scene", scenes, BY_NAME),
        ("method", methods, METHODS),
    ):
        unknown = [name for name in names if name not in available]
        if unknown:
            raise ValueError(
                f"there is no {kind} {unknown[0]!r}; there are {', '.join(available)}"
            )
    for name in scenes:
        scene = BY_NAME[name]
        for count in scene.counts:
            if counts is not None and count not in counts:
                continue
            case = scene.make(count, seed)
            for method in methods:
                yield Row(
                    scene=name,
                    count=count,
                    method=method,
                    score=score(case, outcome(method, case)),
                )
