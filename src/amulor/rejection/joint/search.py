"""Maximum-likelihood path of each pixel, for one or two surfaces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels import bundles
from amulor.rejection.joint._kernels import search as kernels
from amulor.rejection.joint._kernels.compiled import spread
from amulor.rejection.joint.normal import foreground, water_at
from amulor.rejection.joint.priors import Shared, whitened_columns
from amulor.rejection.joint.samples import (
    Pixels,
    echo_of,
    grid_of,
    phasors,
    places,
    samples,
    weight,
)
from amulor.rejection.joint.tables import Table, from_pairs, to_pairs

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class Estimates:
    """Most likely path of each pixel, with amplitudes, misfit and uncertainty."""

    path: Floats
    """Round-trip optical path; NaN if the path limits are empty [m]."""
    amplitude: Floats
    """Target amplitude in each channel, (pixel, channel) [V]."""
    cost: Floats
    """Chi-square at the most likely path [1]."""
    empty_cost: Floats
    """Chi-square of open water without a target [1]."""
    explained: Floats
    """Decrease of chi-square by a target, with equal sample covariance [1]."""
    information: Floats
    """Inverse variance of the path, for a known water signal [1/m^2]."""
    lower: Floats
    """Decrease of the path at which chi-square rises by 1 [m]."""
    upper: Floats
    """Increase of the path at which chi-square rises by 1 [m]."""
    wrong: Floats
    """Probability that the path lies in another ambiguity interval [1]."""
    outlying: Floats
    """Decrease of chi-square without the most outlying sample [1]."""
    next_outlying: Floats
    """Decrease of chi-square without the second most outlying sample [1]."""
    used: NDArray[np.intp]
    """Number of usable lock-in outputs, two per sample."""
    which: NDArray[np.intp]
    """Index of the most outlying sample, counted over channels and frequencies."""
    influence: Complex
    """Path shift per signal change, (pixel, channel, frequency) [m/V]: the shift is the
    real part of change times conjugate influence."""
    rate: Floats
    """Change of the path from reading to reading, in prior standard deviations [1]."""


def estimate(
    pixels: Pixels,
    weights: Floats,
    table: Table,
    *,
    gain: Complex,
    transfer: Complex,
    phase_per_path: Floats,
    fluctuation: float = 0.0,
    front: Complex | None = None,
    start: Floats | None = None,
) -> Estimates:
    """Return the most likely path of each pixel for a given water signal."""
    count, channels, frequencies = pixels.signal.shape
    echo = echo_of(transfer, phase_per_path)
    path = grid_of(pixels, phase_per_path) if count else np.arange(2.0)
    out = bundles.Solutions(
        **{name: np.empty(count) for name in _SCALARS},
        used=np.empty(count, dtype=np.intp),
        which=np.empty(count, dtype=np.intp),
        amplitude=np.empty((count, channels)),
        influence=np.empty((count, channels, 2, frequencies)),
    )
    spread(
        kernels.estimate,
        count,
        samples(pixels, weights),
        places(pixels, table),
        bundles.Model(
            table.arrays,
            echo,
            to_pairs(gain),
            fluctuation,
            to_pairs(np.zeros_like(gain) if front is None else front),
            table.level,
        ),
        phasors(path, echo),
        np.full(count, np.nan) if start is None else start,
        out,
    )
    return Estimates(
        **out._asdict() | {"influence": from_pairs(out.influence)}, rate=np.zeros(count)
    )


#: Scalar results of a pixel.
_SCALARS = (
    "path", "cost", "empty_cost", "explained", "information", "lower", "upper",
    "wrong", "outlying", "next_outlying",
)  # fmt: skip


def without_foreground(
    pixels: Pixels, table: Table, *, strength: Complex, phase_per_path: Floats
) -> Pixels:
    """Subtract the water-signal departure in front of all targets from samples."""
    if not np.any(strength):
        return pixels
    light = foreground(pixels, table, phase_per_path)[:, None] * strength
    return replace(pixels, signal=np.where(pixels.usable, pixels.signal - light, 0.0))


Bools = NDArray[np.bool_]

#: Fewest frequencies for a distinction of two surfaces from one [1].
FEWEST = 3
#: P-value of one surface below which two are tested, as in pixels with outliers [1].
ASKED = 1e-3
#: A second surface is real beyond this p-value of the likelihood ratio [1].
REAL = 1e-4
#: Penalties of model selection, in chi-square: for a parameter and the choice of the
#: pixel (a surface); for the choice of a sample and two parameters (an outlier) [1].
_PARAMETER, _SURFACE, _SAMPLE = 5.0, 6.0, 14.0
#: Differences of the two paths from which the search starts, over the length in which
#: the phase of the highest frequency turns by 1 rad [1].
_APART = (0.2, 0.8, 2.5, 6.0)
_STEPS = 12
#: Dampings of a step at first, least and most [1].
_DAMPING, _LEAST, _MOST = 1e-2, 1e-6, 1e6
#: Pixels of a block, which limits the memory.
_AT_ONCE = 512
_TINY = 1e-12


@dataclass(frozen=True)
class Pair:
    """Two-surface fits of pixels."""

    cost: Floats
    """Sum of squared errors in units of their standard deviation [1]."""
    near: Floats
    """Optical path to the nearer surface [m]."""
    far: Floats
    """Optical path to the farther surface [m]."""


def two_surfaces(
    pixels: Pixels,
    path: Floats,
    shared: Shared,
    *,
    transfer: Complex,
    phase_per_path: Floats,
) -> Pair:
    """Fit two surfaces to each pixel.

    Levenberg's and Marquardt's steps on both paths, with the amplitudes of both in
    each channel fitted anew at every step, none below zero. The water ends at the
    nearer surface.
    """
    parts = [
        _pair(
            pixels.part(slice(begin, begin + _AT_ONCE)),
            path[begin : begin + _AT_ONCE],
            shared,
            transfer * (1 + shared.echo),
            phase_per_path,
        )
        for begin in range(0, max(len(pixels), 1), _AT_ONCE)
    ]
    return Pair(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("cost", "near", "far")
        )
    )


def may_be_two(estimates: Estimates, detected: Bools, left_out: Bools) -> Bools:
    """Return the mask of pixels to be tested for two surfaces."""
    from scipy.stats import chi2

    if estimates.influence.shape[2] < FEWEST:
        return np.zeros(len(detected), dtype=bool)
    freedom = np.maximum(estimates.used - 1 - estimates.amplitude.shape[1], 1)
    poor = chi2.sf(estimates.cost, freedom) < ASKED
    return np.asarray(detected & (poor | left_out))


def are_two(
    pair: Pair, single: Estimates, cleaned: Estimates, number_left_out: NDArray[np.intp]
) -> Bools:
    """Test pixels for two surfaces, against a single surface and against outliers."""
    from scipy.stats import chi2

    channels = single.amplitude.shape[1]
    extra = channels + 1
    freedom = np.maximum(single.used - 2 * extra, 1)
    is_real = single.cost - pair.cost > chi2.isf(REAL, extra)
    fits = chi2.sf(pair.cost, freedom) > REAL
    two = pair.cost + _SURFACE + _PARAMETER * extra
    spoiled = cleaned.cost + _SAMPLE * number_left_out
    return np.asarray(is_real & fits & (two < spoiled))


def _pair(
    pixels: Pixels, path: Floats, shared: Shared, transfer: Complex, rate: Floats
) -> Pair:
    """Return the best two-surface fit of each pixel in a block."""
    best = Pair(np.full(len(path), np.inf), path.copy(), path.copy())
    if not len(pixels):
        return best
    front = foreground(pixels, shared.table, rate)
    deviation = None
    if shared.fluctuation > 0:
        _, water, _ = water_at(pixels, path, shared.table, rate)
        deviation = shared.fluctuation * shared.water_signal(water, front)
    inverse = weight(pixels, deviation, shared.noise_scale)
    for apart in _APART:
        half = 0.5 * apart / rate.max()
        ends = np.stack([path - half, path + half], axis=1)
        cost, ends = _descend(pixels, ends, inverse, front, shared, transfer, rate)
        better = cost < best.cost
        best = Pair(
            np.where(better, cost, best.cost),
            np.where(better, ends.min(axis=1), best.near),
            np.where(better, ends.max(axis=1), best.far),
        )
    return best


def _descend(
    pixels: Pixels,
    ends: Floats,
    inverse: Floats,
    front: Complex,
    shared: Shared,
    transfer: Complex,
    rate: Floats,
) -> tuple[Floats, Floats]:
    """Minimize each pixel's chi-square over two paths; return minimum and paths."""
    damping = np.full(len(ends), _DAMPING)
    cost, step_of = _linearised(pixels, ends, inverse, front, shared, transfer, rate)
    farthest = 0.5 / rate.max()
    for _ in range(_STEPS):
        move = np.clip(step_of(damping), -farthest, farthest)
        trial = np.clip(ends + move, pixels.shortest[:, None], pixels.longest[:, None])
        new, new_step = _linearised(
            pixels, trial, inverse, front, shared, transfer, rate
        )
        better = new < cost
        ends = np.where(better[:, None], trial, ends)
        damping = np.clip(np.where(better, damping / 10, damping * 10), _LEAST, _MOST)
        cost = np.where(better, new, cost)
        step_of = new_step.select(better, step_of)
    return cost, ends


@dataclass(frozen=True)
class _Step:
    """Normal equations of two paths, with the amplitudes eliminated."""

    matrix: Floats
    """Information matrix, (pixel, 2, 2)."""
    vector: Floats
    """Negative half gradient of chi-square, (pixel, 2)."""

    def __call__(self, damping: Floats) -> Floats:
        """Return the damped step of both paths [m]."""
        diagonal = np.einsum("nii->ni", self.matrix)
        damped = self.matrix + np.einsum(
            "ni,ij->nij", damping[:, None] * diagonal + _TINY, np.eye(2)
        )
        step: Floats = np.linalg.solve(damped, self.vector[..., None])[..., 0]
        return step

    def select(self, selected: Bools, others: _Step) -> _Step:
        """Merge both equations: selected pixels from `self`, the rest from `others`."""
        return _Step(
            np.where(selected[:, None, None], self.matrix, others.matrix),
            np.where(selected[:, None], self.vector, others.vector),
        )


def _linearised(
    pixels: Pixels,
    ends: Floats,
    inverse: Floats,
    front: Complex,
    shared: Shared,
    transfer: Complex,
    rate: Floats,
) -> tuple[Floats, _Step]:
    """Return chi-square with the best amplitudes, and normal equations of the paths."""
    count, channels, frequencies = pixels.signal.shape
    near = ends.argmin(axis=1)
    _, water, slope = water_at(pixels, ends.min(axis=1), shared.table, rate)
    signal = np.where(
        pixels.usable, pixels.signal - shared.water_signal(water, front), 0
    )
    echo = np.exp(1j * ends[:, None, :] * rate[:, None]) * transfer[:, None]
    columns = np.broadcast_to(echo[:, None], (count, channels, frequencies, 2))
    outputs = 2 * frequencies

    def by_channel(values: Complex) -> Floats:
        """Whiten columns by the errors, shape (pixel, channel, output, column)."""
        wide = whitened_columns(inverse, values)
        return wide.reshape(count, channels, outputs, values.shape[-1])

    echoes = by_channel(columns)
    residual = by_channel(signal[..., None])[..., 0]
    gram = np.einsum("ncok,ncol->nckl", echoes, echoes)
    along = np.einsum("ncok,nco->nck", echoes, residual)
    amplitude = _non_negative(gram, along)
    residual = residual - np.einsum("ncok,nck->nco", echoes, amplitude)
    by_path = 1j * rate[:, None] * columns * amplitude[:, :, None, :]
    by_end = np.zeros((count, channels, frequencies, 2), dtype=complex)
    rows = np.arange(count)
    by_end[rows, :, :, near] = shared.strength[:, None] * slope[:, None]
    paths = by_channel(by_path + by_end)
    # Amplitudes fixed at zero have no columns.
    free = (amplitude > 0).astype(float)
    mixed = np.einsum("ncok,ncol->nckl", echoes * free[:, :, None, :], paths)
    gram = gram * free[..., None] * free[..., None, :]
    size = np.einsum("nckk->nck", gram)
    gram = gram + np.einsum("nck,kl->nckl", 1e-9 * size + (free == 0), np.eye(2))
    solved = np.linalg.solve(gram, mixed)
    matrix = np.einsum("ncok,ncol->nkl", paths, paths)
    matrix = matrix - np.einsum("nckl,nckm->nlm", mixed, solved)
    vector = np.einsum("ncok,nco->nk", paths, residual)
    return np.einsum("nco,nco->n", residual, residual), _Step(matrix, vector)


def _non_negative(gram: Floats, along: Floats) -> Floats:
    """Return two amplitudes by non-negative least squares, (..., 2)."""
    a, b, d = gram[..., 0, 0], gram[..., 0, 1], gram[..., 1, 1]
    u, v = along[..., 0], along[..., 1]
    determinant = a * d - b * b
    regular = determinant > _TINY * a * d
    safe = np.where(regular, determinant, 1.0)
    first, second = (d * u - b * v) / safe, (a * v - b * u) / safe
    first_only = np.where(a > 0, np.maximum(u, 0) / np.where(a > 0, a, 1.0), 0.0)
    second_only = np.where(d > 0, np.maximum(v, 0) / np.where(d > 0, d, 1.0), 0.0)
    both_positive = regular & (first > 0) & (second > 0)
    first_is_better = first_only * u >= second_only * v
    return np.stack(
        [
            np.where(both_positive, first, np.where(first_is_better, first_only, 0.0)),
            np.where(
                both_positive, second, np.where(first_is_better, 0.0, second_only)
            ),
        ],
        axis=-1,
    )
