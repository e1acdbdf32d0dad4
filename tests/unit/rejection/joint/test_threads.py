"""Threads: they change no result, and two callers at once do not harm each other."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest
import xarray as xr

from amulor.rejection import joint
from amulor.rejection.joint._kernels.compiled import FEWEST, spread

INTERVAL = (0.8, 4.0)


@pytest.mark.parametrize(("count", "fewest"), [(1, 1), (7, 2), (1000, 3), (0, 5)])
def test_every_element_is_treated_once(
    count: int, fewest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 3)
    times = np.zeros(count, dtype=int)

    def treat(begin: int, end: int, step: int) -> None:
        times[begin:end] += step

    spread(treat, count, 1, fewest=fewest)
    assert (times == 1).all()


def test_few_pixels_take_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 4)
    seen: set[int] = set()

    def treat(begin: int, end: int) -> None:
        seen.add(threading.get_ident())

    spread(treat, 199, fewest=100)
    assert seen == {threading.get_ident()}
    seen.clear()
    spread(treat, 200, fewest=100)
    assert threading.get_ident() not in seen


def test_an_error_in_a_thread_reaches_the_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)

    def fail(begin: int, end: int) -> None:
        if begin > 50:
            raise ArithmeticError("one part fails")

    with pytest.raises(ArithmeticError, match="one part fails"):
        spread(fail, 100, fewest=1)


def test_callers_at_once_share_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    lock, now, most = threading.Lock(), 0, 0

    def treat(begin: int, end: int) -> None:
        nonlocal now, most
        with lock:
            now += 1
            most = max(most, now)
        time.sleep(2e-3)
        with lock:
            now -= 1

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: spread(treat, 32, fewest=1), range(4)))
    assert most == 2


@pytest.mark.slow
def test_threads_change_no_result(
    samples: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 72 pixels are worth one thread, 1,152 are worth two.
    wide = xr.concat([samples] * 16, dim="row", data_vars="minimal")
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 1)
    one = joint(wide, interval=INTERVAL)
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    two = joint(wide, interval=INTERVAL)
    xr.testing.assert_equal(one, two)
    assert one["joint_slant_range"].size > 2 * FEWEST


@pytest.mark.slow
def test_two_threads_may_estimate_at_once(samples: xr.Dataset) -> None:
    alone = joint(samples, interval=INTERVAL)
    with ThreadPoolExecutor(2) as pool:
        both = list(
            pool.map(lambda cube: joint(cube, interval=INTERVAL), [samples] * 2)
        )
    for one in both:
        xr.testing.assert_equal(one, alone)
