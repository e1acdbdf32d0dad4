"""Batches of photons are read from their files as they were computed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor.errors import MissingExtraError
from amulor.scale import batches
from amulor.transport._runs import Batch

BATCH = Batch(
    number=4,
    histories=512,
    signal=np.array([[1 + 2j, 3 - 4j]]),
    weight=np.array([[0.5, 0.25, 0.125]]),
    mass=np.array([[1.0, 2.0]]),
    edge=np.array([[3.0], [4.0]]),
    spacing=0.04,
    unseen=1e-3,
)


@dataclass(frozen=True, kw_only=True)
class Numbered:
    """Run whose batches differ by their number only."""

    keep: bool

    @property
    def stated(self) -> dict[str, Any]:
        return {"seed": 7}

    def __call__(self, number: int) -> Batch:
        batch = replace(BATCH, number=number, spacing=number / 100)
        return batch if self.keep else replace(batch, mass=None, edge=None)


def fields_of(batch: Batch) -> dict[str, Any]:
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(batch).items()
    }


@pytest.mark.parametrize("keep", [True, False])
def test_all_of_a_batch_is_kept_in_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, keep: bool
) -> None:
    run = Numbered(keep=keep)

    def in_order(
        client: object, folder: Path, work: Any, first: int, end: int
    ) -> Iterator[Path]:
        assert (client, folder, work.file) == ("client", tmp_path, "batch.npz")
        for number in range(first, end):
            assert work.made_of(number) == {"seed": 7, "batch": number}
            path = tmp_path / f"{number}.npz"
            path.write_bytes(b"of an earlier run")
            work.write(number, path)
            yield path

    monkeypatch.setattr(batches, "in_order", in_order)
    found = list(batches._batches("client", tmp_path, run, 3, 6))
    assert list(map(fields_of, found)) == [fields_of(run(n)) for n in (3, 4, 5)]
    assert [type(batch.histories) for batch in found] == [int] * 3


def test_equal_batches_have_equal_bytes(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.npz", "b.npz", "c.npz")]
    batches._write(BATCH, paths[0])
    batches._write(replace(BATCH, signal=BATCH.signal.copy()), paths[1])
    batches._write(replace(BATCH, unseen=2e-3), paths[2])
    first, again, other = (path.read_bytes() for path in paths)
    assert first == again != other


def test_a_spread_has_the_folder_and_the_client_of_its_cluster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []

    @contextmanager
    def cluster(scheduler: str, workers: int | None) -> Iterator[str]:
        asked.append((scheduler, workers))
        yield "client"

    monkeypatch.setattr(batches, "cluster_client", cluster)
    monkeypatch.setattr(
        batches, "in_order", lambda *words: asked.append(words) or iter(())
    )
    monkeypatch.chdir(tmp_path)
    run: Any = SimpleNamespace(stated={})
    with batches.spread_batches("run", scheduler="tcp://a:1", workers=3) as spread:
        assert list(spread(run, 0, 2)) == []
    with batches.spread_batches("run", scheduler="local"):
        pass
    work = batches._Batches(run=run)
    folder = tmp_path / "run"
    assert folder.is_dir()
    assert asked == [
        ("tcp://a:1", 3), ("client", folder, work, 0, 2), ("local", None),
    ]  # fmt: skip


def test_a_cluster_without_its_packages_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def require(*extras: str, purpose: str) -> None:
        raise MissingExtraError("dask", extra=",".join(extras), purpose=purpose)

    monkeypatch.setattr(batches, "require", require)
    with (
        pytest.raises(MissingExtraError, match=r"a cluster needs dask.*\[scale\]"),
        batches.spread_batches(tmp_path / "run", scheduler="local"),
    ):
        pass
    assert not (tmp_path / "run").exists()
