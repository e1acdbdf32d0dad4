"""Steady water raises no alarm, water that changed does, at the rates that are stated.

Scans are draws of what the estimator gets: shots of the demonstration's plan (27
directions, two blocks of ten rounds, VV and VH) and of others.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from amulor import acquisition, simulation
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings import Settings
from amulor.survey import Survey
from amulor.view.page.progress import (
    CHANCE,
    WORTH_A_REFERENCE,
    Drift,
    Progress,
    drift_of,
)

#: Two blocks of ten rounds each, 18 minutes apart [s].
BLOCKS = np.concatenate([3.3 * np.arange(10), 1070 + 3.3 * np.arange(10)])
#: Five blocks of one round each [s].
EVENLY = 300.0 * np.arange(5)


def drawn(
    rng: np.random.Generator,
    elapsed: NDArray[np.float64],
    *,
    fluctuation: float,
    true: NDArray[np.float64] | float = 1.0,
    directions: int = 27,
) -> NDArray[np.complex128]:
    """Return shots of two channels, the water a tenth as bright in the second."""
    level = np.repeat([2.6e-3, 2.6e-4], directions)[:, np.newaxis]
    level = level * rng.uniform(0.8, 1.2, level.shape)
    phase = np.exp(1j * rng.uniform(0, 2 * np.pi, level.shape))
    size = (2 * directions, elapsed.size)
    noise = 1e-6 * (rng.standard_normal(size) + 1j * rng.standard_normal(size))
    return phase * level * true * (1 + fluctuation * rng.standard_normal(size)) + noise


def looks(signal: NDArray[np.complex128], elapsed: NDArray[np.float64]) -> list[Drift]:
    """Return what the page knows after each round."""
    rounds = elapsed.size
    return [
        drift_of(
            signal[:, :count],
            cluster=np.arange(len(signal)),
            elapsed=elapsed[:count],
            rounds=rounds,
        )
        for count in range(2, rounds + 1)
    ]


def alarms(drifts: list[Drift]) -> list[bool]:
    return [
        any(
            abs(change.size) >= WORTH_A_REFERENCE and change.chance < CHANCE
            for change in (drift.total, drift.newest)
        )
        for drift in drifts
    ]


@pytest.mark.parametrize(
    ("elapsed", "fluctuation", "directions"),
    [
        (BLOCKS, 0.137, 27),
        pytest.param(EVENLY, 0.137, 6, marks=pytest.mark.slow),
        pytest.param(EVENLY[:2], 0.05, 4, marks=pytest.mark.slow),
    ],
)
def test_a_thousand_scans_in_steady_water_raise_no_alarm(
    elapsed: NDArray[np.float64], fluctuation: float, directions: int
) -> None:
    rng = np.random.default_rng(20)
    scans, raised, rounds = 1000, 0, 0
    unlikely = {"total": 0, "newest": 0}
    tests = 2 * (elapsed.size - 1)
    for _ in range(scans):
        signal = drawn(rng, elapsed, fluctuation=fluctuation, directions=directions)
        found = looks(signal, elapsed)
        rounds += len(found)
        raised += sum(alarms(found))
        for name in unlikely:
            # One look at each scan: independent draws.
            unlikely[name] += getattr(found[-1], name).chance < 0.02 * tests
    assert raised / rounds < 0.001
    # The chance that is stated bounds what happens: 2 % of scans, and four standard
    # deviations of that count; where it is far below, the error would be too large.
    for count in unlikely.values():
        assert 2 <= count <= 0.02 * scans + 4 * (0.02 * scans) ** 0.5


@pytest.mark.parametrize(
    ("elapsed", "fluctuation", "true", "share"),
    [
        # A tenth of the water between the blocks, under fluctuations of 13.7 %.
        (BLOCKS, 0.137, 1 + 0.1 * BLOCKS / BLOCKS[-1], 0.9),
        # 3 % on the way through a scan in calm water.
        (EVENLY, 0.01, 1 - 0.03 * EVENLY / EVENLY[-1], 0.99),
        # Sediment just before the last round.
        (EVENLY, 0.01, np.where(EVENLY[-1] > EVENLY, 1, 1.03), 0.99),
    ],
    ids=["between blocks", "slowly", "suddenly"],
)
def test_water_that_changed_is_noticed(
    elapsed: NDArray[np.float64],
    fluctuation: float,
    true: NDArray[np.float64],
    share: float,
) -> None:
    rng = np.random.default_rng(21)
    noticed = [
        alarms(looks(drawn(rng, elapsed, fluctuation=fluctuation, true=true), elapsed))[
            -1
        ]
        for _ in range(200)
    ]
    assert np.mean(noticed) >= share


def test_changes_are_what_was_put_in() -> None:
    """Two directions twice as bright as the others, and no noise at all."""
    true = np.array([0.9, 1.0, 1.0, 1.1])
    level = np.array([1, 2, 2, 1])[:, np.newaxis] * np.exp(0.3j)
    signal = level * true
    found = drift_of(
        signal, cluster=[1, 2, 3, 4], elapsed=[0.0, 1.0, 2.0, 3.0], rounds=4
    )
    assert_allclose(found.change, true - 1, atol=1e-15)
    # Least squares by hand: sum (t - 1.5) y / sum (t - 1.5)^2 = 0.3 / 5 a round.
    assert found.total.size == pytest.approx(3 * 0.3 / 5)
    assert found.newest.size == pytest.approx(1.1 - 2.9 / 3)
    assert found.total.error < 1e-12


def test_one_shot_that_is_far_off_is_no_change_of_the_water() -> None:
    rng = np.random.default_rng(22)
    for _ in range(50):
        signal = drawn(rng, BLOCKS, fluctuation=0.002)
        signal[rng.integers(27), -1] *= 3
        assert not any(alarms(looks(signal, BLOCKS)))


def test_frequencies_that_fluctuate_together_count_once() -> None:
    """Sixteen copies of a series say no more than it alone."""
    rng = np.random.default_rng(23)
    signal = drawn(rng, EVENLY, fluctuation=0.05)
    places = np.arange(len(signal))
    one = drift_of(signal, cluster=places, elapsed=EVENLY, rounds=5)
    many = drift_of(
        np.tile(signal, (16, 1)), cluster=np.tile(places, 16), elapsed=EVENLY, rounds=5
    )
    assert many.total.size == pytest.approx(one.total.size)
    assert many.total.error == pytest.approx(one.total.error)
    assert many.total.chance == pytest.approx(one.total.chance)


def test_too_little_says_nothing() -> None:
    few = np.ones((2, 5)) + 0j
    assert drift_of(few, cluster=[0, 1], elapsed=EVENLY, rounds=5) == Drift()
    once = np.ones((9, 1)) + 0j
    assert drift_of(once, cluster=np.arange(9), elapsed=[0.0], rounds=5) == Drift()
    dark = np.zeros((9, 5), complex)
    assert drift_of(dark, cluster=np.arange(9), elapsed=EVENLY, rounds=5) == Drift()


@pytest.mark.slow
def test_scans_of_simulated_devices_raise_an_alarm_only_if_the_water_drifts(
    plate: Survey, tmp_path: Path
) -> None:
    """The chain from the devices to the journal adds nothing that looks like drift."""
    survey = plate.with_(
        {
            "water.signal_fluctuation": "13.7 %",
            "instrument.polarizations": ["VV"],
            "scan.columns": 2,
            "scan.rows": 2,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 4, "rows": 3, "repeats": 8},
        }
    )
    light = simulation.scene_light(survey)
    found: dict[float, list[bool]] = {0.0: [], -0.04: []}
    # The scans last 9 s: the water loses a third, or nothing.
    for seed, drift in [*((seed, 0.0) for seed in range(12)), (1, -0.04), (2, -0.04)]:
        folder = tmp_path / f"{seed}{drift}"
        words = {"simulation": {"seed": seed, "water_drift": drift}}
        acquisition.acquire(
            survey,
            folder,
            settings=Settings.model_validate(words),
            scene=lambda of: light,
        )
        with Journal.read(folder) as journal:
            progress = Progress(survey, journal.meta(), clock=lambda: 0.0)
            seen = []
            for _, key, record in journal.newer(0):
                progress.take(key, record)
                seen.append(progress.drift())
        found[drift].append(any(alarms(seen)))
    assert found == {0.0: [False] * 12, -0.04: [True] * 2}
