"""Water that is stronger than its shots is told by phases that disagree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amulor.rejection.covariance import Covariance
from amulor.rejection.quality import channels_disagree, phase_error
from amulor.rejection.reference.before_target import DEPARTURE, strength_of

SPEED = 299792458.0
SHAPE = (12, 20)


def _marked(*of: Any, **known: Any) -> np.ndarray:
    """Return the samples of channels that disagree."""
    return channels_disagree(*of, **known)[0]


def _scan(
    seed: int, *, frequency: np.ndarray, channels: list[float], change: float
) -> tuple[np.ndarray, np.ndarray, Covariance, Covariance, np.ndarray]:
    """Return what is left of a wall when its water is understated by `change`."""
    rng = np.random.default_rng(seed)
    path = 5.0 + 0.2 * rng.random(SHAPE)
    turn = 2j * np.pi * frequency[:, None, None, None] / SPEED
    target = np.array(channels)[:, None, None] * np.exp(turn * path)
    # Water from before the target, as much of it in every channel.
    water = 0.4 * np.exp(turn * 2.0) / (1 + frequency[:, None, None, None] / 40e6)
    water = np.broadcast_to(water, target.shape)
    noise = 1e-3
    left = target + change * water
    left = left + noise * rng.standard_normal(left.shape)
    left = left + 1j * noise * rng.standard_normal(left.shape)
    own = np.full(left.shape, noise**2)
    none = np.zeros(left.shape)
    return (
        left,
        water,
        Covariance(own, own, none),
        Covariance(none, none, none),
        path + 0.01,
    )


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**32 - 1),
    change=st.floats(-0.1, 0.1),
    case=st.sampled_from(
        [
            (np.array([50e6]), [1.0, 0.3]),
            (np.array([20e6, 80e6]), [1.0]),
            (np.array([20e6, 50e6, 80e6]), [1.0, 0.3]),
        ]
    ),
)
def test_the_change_is_found_within_its_own_error(
    seed: int, change: float, case: tuple[np.ndarray, list[float]]
) -> None:
    frequency, channels = case
    left, water, own, common, path = _scan(
        seed, frequency=frequency, channels=channels, change=change
    )
    found = strength_of(
        left, water, own, common, modulation_frequency=frequency, path=path
    )
    # First order in the change: of a tenth a hundredth is of second order.
    assert abs(found.change - change) < 5 * found.uncertainty + change**2
    assert found.uncertainty < 0.006


@pytest.mark.parametrize("change", [-0.15, 0.2])
def test_two_channels_confirm_a_large_change_at_two_frequencies(change: float) -> None:
    frequency = np.array([20e6, 80e6])
    left, water, own, common, path = _scan(
        3, frequency=frequency, channels=[1.0, 0.8], change=change
    )
    found = strength_of(
        left, water, own, common, modulation_frequency=frequency, path=path
    )
    # Second order in the change.
    assert found.change == pytest.approx(change, abs=change**2)
    assert found.phases is None


def test_a_phase_error_of_one_frequency_is_no_change_of_the_water() -> None:
    frequency = np.array([20e6, 80e6])
    left, water, own, common, path = _scan(
        4, frequency=frequency, channels=[1.0, 0.8], change=0.0
    )
    turned = left * np.exp(1j * np.array([0.05, 0.0]))[:, None, None, None]
    found = strength_of(
        turned, water, own, common, modulation_frequency=frequency, path=path
    )
    assert (found.change, found.uncertainty) == (0.0, DEPARTURE)
    assert found.phases is not None
    assert found.phases.probability < 1e-4
    # One distance has a phase in proportion to the frequency: 4 to 1.
    first, second = found.phases.phase
    assert first - second / 4 == pytest.approx(0.05, rel=0.05)
    # A single channel has no third phase that could tell it from a change.
    alone = strength_of(
        turned[:, :1],
        water[:, :1],
        *(
            Covariance(*(values[:, :1] for values in vars(errors).values()))
            for errors in (own, common)
        ),
        modulation_frequency=frequency,
        path=path,
    )
    assert alone.is_untested
    assert alone.phases is None


def test_one_sample_a_pixel_tells_nothing() -> None:
    frequency = np.array([50e6])
    left, water, own, common, path = _scan(
        1, frequency=frequency, channels=[1.0], change=0.08
    )
    found = strength_of(
        left, water, own, common, modulation_frequency=frequency, path=path
    )
    assert (found.change, found.uncertainty) == (0.0, DEPARTURE)


def test_errors_that_pixels_share_do_not_average_out() -> None:
    frequency = np.array([20e6, 80e6])
    left, water, own, _, path = _scan(
        1, frequency=frequency, channels=[1.0], change=0.0
    )
    size = np.full(left.shape, (0.01) ** 2)
    shared = Covariance(size, size, np.zeros(size.shape))
    found = strength_of(
        left, water, own, shared, modulation_frequency=frequency, path=path
    )
    # A hundredth of the target, of water that is 0.27 of it at 20 MHz.
    assert found.uncertainty > 0.01


def test_spikes_do_not_move_the_change() -> None:
    frequency = np.array([20e6, 50e6, 80e6])
    left, water, own, common, path = _scan(
        2, frequency=frequency, channels=[1.0], change=0.05
    )
    rng = np.random.default_rng(5)
    left[rng.random(left.shape) < 0.03] *= 1.5j
    found = strength_of(
        left, water, own, common, modulation_frequency=frequency, path=path
    )
    assert found.change == pytest.approx(0.05, abs=0.004)


def test_channels_see_one_distance() -> None:
    frequency = np.array([50e6])
    left, _, own, _, _ = _scan(1, frequency=frequency, channels=[1.0, 0.3], change=0)
    assert not _marked(left, own).any()
    left[0, 1, 4, 7] *= np.exp(0.1j)
    marked = _marked(left, own)
    assert marked[0, :, 4, 7].all()
    assert marked.sum() == 2
    # What half of the pixels have in common is no spike.
    left[0, 1, :6] *= np.exp(0.1j)
    assert not _marked(left, own).any()


def test_small_disagreement_counts_where_there_is_much_of_it() -> None:
    rng = np.random.default_rng(3)
    frequency = np.array([20e6, 50e6, 80e6])

    def scan(seed: int) -> tuple[np.ndarray, Covariance]:
        return _scan(seed, frequency=frequency, channels=[1.0, 0.3], change=0)[::2][:2]

    # In a tenth of the scans that are all right there is one.
    assert sum(_marked(*scan(seed)).any() for seed in range(30)) <= 8
    left, own = scan(4)
    # Of the difference, 3.5 millirad each: three or four and a half of them.
    hit = rng.random(left[:, 1].shape) < 0.06
    left[:, 1] *= np.exp(1j * np.where(hit, 0.0145, 0.0))
    found = _marked(left, own)
    assert (found[:, 0] == found[:, 1]).all()
    # By four standard errors alone half of them.
    assert found[:, 0][hit].mean() > 0.75
    assert found[:, 0][~hit].mean() < 0.01


def test_what_water_leaves_is_no_reason_to_doubt_a_target() -> None:
    frequency = np.array([50e6])
    shown = np.ones(SHAPE, dtype=bool)
    shown[:, 14:] = False
    doubted = doubted_shown = 0
    for seed in range(20):
        left, _, own, _, _ = _scan(
            seed, frequency=frequency, channels=[1.0, 0.3], change=0
        )
        # What is left there turns by a few standard errors in a third of the pixels.
        odd = np.random.default_rng(seed).random(SHAPE) < 0.3
        left[0, 1] *= np.exp(1j * np.where(~shown & odd, 0.02, 0.0))
        doubted += _marked(left, own)[..., shown].any()
        found = _marked(left, own, shown=shown)
        assert not found[..., ~shown].any()
        doubted_shown += found[..., shown].any()
    assert doubted >= 10
    assert doubted_shown <= 5


def test_a_difference_that_all_pixels_have_is_no_outlier() -> None:
    frequency = np.array([20e6, 50e6, 80e6])
    left, _, own, _, _ = _scan(5, frequency=frequency, channels=[1.0, 0.3], change=0)
    left[:, 1] *= np.exp(0.01j)  # three standard errors of the difference
    left[1, 1, 3, 5] *= np.exp(0.1j)
    found = _marked(left, own)
    assert found[1, :, 3, 5].all()
    assert found.sum() <= 4


def test_the_phase_error_of_no_signal_is_a_number() -> None:
    signal = np.array([0j, 2.0, 2.0])
    each = np.full(3, 1e-4)
    error = phase_error(
        signal, Covariance(each, each, 0 * each), np.array([True, True, False])
    )
    # 10 mV of error across 2 V are 5 mrad; the others are not read.
    assert error[1] == pytest.approx(5e-3, rel=1e-3)
    assert np.isfinite(error).all()
