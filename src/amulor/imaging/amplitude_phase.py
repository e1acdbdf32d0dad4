"""Test of the phases against the amplitude, at edges of reflectance within an image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.cube import QualityFlag
from amulor.cube.error import AMPLITUDE_PHASE, AMPLITUDE_PROBABILITY, LARGEST_CHANCE
from amulor.imaging.observation import Observation
from amulor.optics import ambiguity

Floats = NDArray[np.float64]

#: Quantiles of the amplitude that are tested as limits [1].
_LIMITS = np.linspace(0.1, 0.9, 9)
#: Pairs of neighbors on both sides of a limit from which on a mean is a good one.
_FEWEST_PAIRS = 10
#: Rows and columns from which on there are pairs with a pixel beyond both.
_FEWEST_PIXELS = 4
#: Four pairs have a pixel in common, which enlarges the variance of a sum by up to 2.5:
#: factor on the standard error [1].
_SHARED_PIXELS = 2.5**0.5
#: First quartile of the absolute value of a normal variable, over its standard
#: deviation, to which steps of half of the pairs hardly contribute [1].
_QUARTILE = 0.3186


@dataclass(frozen=True, kw_only=True)
class AmplitudePhase:
    """Phase step between darker and brighter neighbors, with its probability."""

    step: float
    """Most significant step of the phase, the same at all frequencies [rad]."""
    probability: float
    """Probability of so large a step by chance and stated errors [1]."""

    @property
    def is_real(self) -> bool:
        """Whether the step is significant."""
        return self.probability < LARGEST_CHANCE

    @property
    def attributes(self) -> dict[str, float]:
        """Attributes of a range image; with the step if it is significant."""
        values = {AMPLITUDE_PROBABILITY: self.probability}
        if self.is_real:
            values[AMPLITUDE_PHASE] = self.step
        return values


def amplitude_phase(
    observation: Observation, path: ambiguity.Path, *, weight: Floats
) -> AmplitudePhase | None:
    """Test whether the phases change at an amplitude; None if untestable.

    Only the part of the phases that no distance explains is tested: edges of
    reflectance and of depth may coincide. It needs two frequencies or more. The change
    is compared between neighboring pixels with a limit of the amplitude between them
    and the other neighbors, so that a smooth error of water or late light cancels.
    `weight` is that of the frequencies in the path.
    """
    if len(observation.frequency) < 2 or observation.lag is not None:
        return None
    valid = observation.usable & np.isfinite(path.length)
    valid &= ~path.left_out.any(axis=0)
    valid &= (observation.flag & QualityFlag.MIXED) == 0
    if min(valid.shape) < _FEWEST_PIXELS:
        return None
    pairs, beyond = _pairs(valid)
    amplitude = np.abs(observation.signal).reshape(len(observation.frequency), -1)
    if pairs.shape[1] < _FEWEST_PAIRS:
        return None
    level = np.log(amplitude[:, beyond]).mean(axis=0)
    # Order of a pair: the darker pixel first.
    pairs = np.where(level[0] > level[1], pairs[::-1], pairs)
    level = np.sort(level, axis=0)
    per_phase = observation.path_per_phase.ravel()
    # Deviations of an equal angle at all frequencies from one distance.
    pattern = 1 - (weight @ per_phase) / per_phase
    residual = (path.residual / observation.path_per_phase).reshape(per_phase.size, -1)
    random = observation.own_sigma.reshape(per_phase.size, -1)
    variance = (random[:, pairs] ** 2).sum(axis=1)
    parts = pattern[:, None] / variance
    size = (pattern[:, None] * parts).sum(axis=0)
    change = np.diff(residual[:, pairs], axis=1)[:, 0]
    turn = (parts * change).sum(axis=0) / size
    error = size**-0.5
    systematic = sum(
        (np.abs(parts) * np.diff(part[:, pairs], axis=1)[:, 0]).sum(axis=0) / size
        for part in _common(observation, per_phase.size)
    )
    good = np.isfinite(turn) & np.isfinite(error) & np.isfinite(systematic)
    turn, error, level = turn[good], error[good], level[:, good]
    systematic = np.broadcast_to(systematic, good.shape)[good]
    if turn.size < 2 * _FEWEST_PAIRS:
        return None
    size = np.abs(turn - np.median(turn)) / error
    spread = float(np.quantile(size, 0.25)) / _QUARTILE
    error = error * max(1.0, spread) * _SHARED_PIXELS
    steps = [
        _step(turn, error, systematic, (level[0] < limit) & (limit <= level[1]))
        for limit in np.quantile(level, _LIMITS)
    ]
    found = [step for step in steps if step is not None]
    if not found:
        return None
    step, significance = max(found, key=lambda values: abs(values[1]))
    chance = math.erfc(abs(significance) / math.sqrt(2))
    return AmplitudePhase(step=step, probability=min(1.0, len(found) * chance))


def _pairs(valid: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return flat indices of neighbors, and of the pixels beyond both, (2, pair).

    Noise may turn a pixel and change its amplitude at once. The amplitudes of the
    pixels beyond do not contain this noise.
    """
    number = np.arange(valid.size).reshape(valid.shape)
    inner, outer = [], []
    for values, mask in ((number, valid), (number.T, valid.T)):
        four = np.lib.stride_tricks.sliding_window_view(values, 4, axis=1)
        usable = np.lib.stride_tricks.sliding_window_view(mask, 4, axis=1).all(axis=-1)
        chosen = four[usable].T
        inner.append(chosen[1:3])
        outer.append(chosen[::3])
    return np.concatenate(inner, axis=1), np.concatenate(outer, axis=1)


def _common(observation: Observation, count: int) -> list[Floats]:
    """Return phase errors that pixels share, which depend on the amplitude [rad]."""
    shared = observation.shared_sigma(observation.usable)
    sizes = [np.abs(observation.shift)] + ([] if shared is None else [shared])
    return [np.broadcast_to(size, observation.signal.shape).reshape(count, -1)
            for size in sizes]  # fmt: skip


def _step(
    turn: Floats, error: Floats, systematic: Floats, across: NDArray[np.bool_]
) -> tuple[float, float] | None:
    """Return the mean step across a limit, and the step over its standard error."""
    if min(across.sum(), (~across).sum()) < _FEWEST_PAIRS:
        return None
    weight = error**-2.0
    means, shared, variances = [], [], []
    for part in (across, ~across):
        means.append(float(np.average(turn[part], weights=weight[part])))
        shared.append(float(np.average(systematic[part], weights=weight[part])))
        variances.append(1 / float(weight[part].sum()))
    step, bound = means[0] - means[1], shared[0] - shared[1]
    return step, step / math.sqrt(sum(variances) + bound**2)
