"""Batches of photons are at work together, in order, none long before its turn."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from amulor.transport._runs import _in_order


@pytest.mark.parametrize("workers", [2, 3])
def test_as_many_batches_as_workers_are_at_work_at_once(workers: int) -> None:
    together = threading.Barrier(workers)

    def batch(number: int) -> Any:
        # Breaks, with an error, unless all workers come.
        together.wait(timeout=20)
        return number

    count = 4 * workers
    assert list(_in_order(batch, 3, 3 + count, workers)) == list(range(3, 3 + count))


def test_no_batch_begins_long_before_it_is_due() -> None:
    begun = []

    def batch(number: int) -> Any:
        begun.append(number)
        return number

    following = _in_order(batch, 0, 1000, 2)
    assert [next(following) for _ in range(5)] == [0, 1, 2, 3, 4]
    # Two at work and two that wait for each that was taken.
    assert max(begun) < 5 + 4
    following.close()
    assert max(begun) < 5 + 4
