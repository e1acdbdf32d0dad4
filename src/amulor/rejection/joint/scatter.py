"""Target and outlier detection, and sample scatter between pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint.normal import Fitted, modelled, path_derivatives
from amulor.rejection.joint.priors import Shared, whitened, whitened_columns
from amulor.rejection.joint.samples import Pixels, weight
from amulor.rejection.joint.search import Estimates

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Least decrease of chi-square by a target, relative to water alone [1].
DETECTION = 25.0
#: P-value below which a pixel is excluded from the shared parameters [1].
_OUTLIER = 1e-6
#: Fluctuations over the scale of the noise that are tried first [1].
_RATIOS = (0.0, 2e-3, 5e-3, 0.01, 0.02, 0.04, 0.08, 0.16, 0.4, 1.0)
_LAST = len(_RATIOS) - 1
_GOLDEN, _SECTIONS = 0.618, 7
#: Least significant fluctuation, in twice the logarithm of the likelihood ratio [1].
_REAL = 9.0
#: Largest number of pixels in the estimate, and least number for differences [1].
_JUDGED, _FEWEST_NEIGHBORS = 384, 12
#: Number of pixels in a block of similar distances [1].
_ALIKE = 24
_TINY = 1e-300


def is_detected(estimates: Estimates) -> NDArray[np.bool_]:
    """Return the mask of pixels with a target."""
    better = estimates.explained >= DETECTION
    is_positive = (estimates.amplitude > 0).any(axis=1)
    return np.asarray(np.isfinite(estimates.path) & better & is_positive)


def are_inliers(estimates: Estimates) -> NDArray[np.bool_]:
    """Return the mask of pixels whose chi-square is not improbably large.

    The reference is the median misfit: a model that is wrong for all pixels makes none
    of them an outlier.
    """
    from scipy.stats import chi2

    if not len(estimates.path):
        return np.ones(0, dtype=bool)
    cost, freedom = _misfit(estimates)
    is_inlier: NDArray[np.bool_] = (
        chi2.sf(cost / typical_misfit(estimates), freedom) > _OUTLIER
    )
    return is_inlier


def typical_misfit(estimates: Estimates) -> float:
    """Return the ratio of median chi-square to its expected median, at least 1."""
    from scipy.stats import chi2

    if not len(estimates.path):
        return 1.0
    cost, freedom = _misfit(estimates)
    return max(float(np.median(cost / chi2.median(freedom))), 1.0)


def _misfit(estimates: Estimates) -> tuple[Floats, NDArray[np.intp]]:
    """Return chi-square of each pixel and its degrees of freedom."""
    detected = is_detected(estimates)
    cost = np.where(detected, estimates.cost, estimates.empty_cost)
    parameters = detected * (1 + estimates.amplitude.shape[1])
    return cost, np.maximum(estimates.used - parameters, 1)


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """Sample scatter between pixels: noise scale and water fluctuation."""

    noise_scale: float
    """Factor on the stated errors, 1 or more [1]."""
    fluctuation: float
    """Relative random change of the water signal from sample to sample [1]."""


def scatter_of(
    state: Shared,
    groups: list[Fitted],
    *,
    transfer: Complex,
    phase_per_path: Floats,
    neighbors: bool = True,
) -> Scatter:
    r"""Estimate noise scale and water fluctuation from the scatter between pixels.

    The covariance of the samples is :math:`s^2 C + \phi^2 w w^T`, with the stated
    covariance C and the water signal w. Restricted maximum likelihood estimates the
    scale s and the fluctuation :math:`\phi`, with paths and amplitudes projected out.
    The sum of squares is that of differences between pixels at similar distances.
    Errors of the model are equal in both pixels and cancel; random errors do not.
    """
    parts = [
        _residuals_of(
            state, group, neighbors, transfer=transfer, phase_per_path=phase_per_path
        )
        for group in groups
    ]

    def cost(ratio: float) -> tuple[float, float]:
        """Return minus twice the log likelihood, and the squared scale."""
        square, freedom, volume = np.sum([part.sums(ratio) for part in parts], axis=0)
        scale = max(square / max(freedom, 1), 1.0)
        return float(freedom * np.log(scale) + square / scale + volume), float(scale)

    costs = [cost(ratio)[0] for ratio in _RATIOS]
    k = int(np.argmin(costs))
    if costs[0] - costs[k] < _REAL:
        return Scatter(
            noise_scale=_significant_scale(cost(0.0)[1], parts), fluctuation=0.0
        )
    low, high = (np.log(_RATIOS[max(min(j, _LAST), 1)]) for j in (k - 1, k + 1))
    for _ in range(_SECTIONS):
        inner = (high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        if cost(np.exp(inner[0]))[0] < cost(np.exp(inner[1]))[0]:
            high = inner[1]
        else:
            low = inner[0]
    ratio = float(np.exp(0.5 * (low + high)))
    scale = _significant_scale(cost(ratio)[1], parts)
    return Scatter(noise_scale=scale, fluctuation=min(ratio * scale, 1.0))


def _significant_scale(square: float, parts: list[_Residuals]) -> float:
    """Return the noise scale; 1 if it is not significantly above 1."""
    freedom = sum(part.freedom for part in parts)
    # Adjacent differences share a pixel, which increases the variance by 3/2.
    chance = 3 * np.sqrt(3 / max(freedom, 1))
    return float(np.sqrt(square)) if square > 1 + chance else 1.0


@dataclass(frozen=True, kw_only=True)
class _Residuals:
    """Residuals of a group of pixels, sorted by distance."""

    pixels: Pixels
    """Samples."""
    residual: Complex
    """Samples less the model [V]."""
    water_signal: Complex
    """Water signal [V]."""
    derivatives: Complex
    """Derivatives by amplitudes and path, (pixel, channel, frequency, parameter)."""
    freedom: int
    """Usable outputs less the pixel parameters."""
    neighbors: bool
    """Whether only differences between neighboring pixels count as random."""

    def sums(self, ratio: float) -> tuple[float, float, float]:
        """Return sum of squared differences, degrees of freedom, and log determinants.

        For a fluctuation of `ratio` times the scale of the noise.
        """
        deviation = ratio * self.water_signal if ratio > 0 else None
        weights = weight(self.pixels, deviation)
        count = len(self.pixels)
        residual = whitened(weights, self.residual).reshape(count, -1)
        determinant = weights[..., 0, :] * weights[..., 2, :] - weights[..., 1, :] ** 2
        volume = -float(np.sum(np.log(determinant[determinant > 0])))
        if self.derivatives.shape[-1]:
            columns = whitened_columns(weights, self.derivatives)
            transposed = np.swapaxes(columns, 1, 2)
            gram = transposed @ columns
            size = np.sqrt(np.maximum(np.einsum("nii->ni", gram), _TINY))
            gram /= size[:, :, None] * size[:, None, :]
            gram += 1e-9 * np.eye(gram.shape[1])
            along = (transposed @ residual[..., None])[..., 0] / size
            best = np.linalg.solve(gram, along[..., None])[..., 0] / size
            residual = residual - (columns @ best[..., None])[..., 0]
            volume += float(
                np.sum(np.linalg.slogdet(gram)[1] + 2 * np.log(size).sum(1))
            )
        if not self.neighbors or count < _FEWEST_NEIGHBORS:
            return float(np.sum(residual**2)), self.freedom, volume
        # Differences need two usable samples.
        usable = np.repeat(self.pixels.usable.reshape(count, -1), 2, axis=1)
        usable_pair = usable[1:] & usable[:-1]
        square = 0.5 * float(
            np.sum(np.where(usable_pair, np.diff(residual, axis=0), 0.0) ** 2)
        )
        share = float(np.sum(usable_pair)) / max(float(np.sum(usable)), 1.0)
        return square / max(share, 1e-9), self.freedom, volume


def _mixed(order: NDArray[np.intp], is_target: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return pixel indices sorted by distance, shuffled among similar distances.

    Open water is at one distance. A drift through the scan counts as random.
    """
    rng = np.random.default_rng(0)
    targets, open_water = order[is_target[order]], order[~is_target[order]]
    blocks = np.array_split(targets, max(len(targets) // _ALIKE, 1))
    return np.concatenate(
        [*(rng.permutation(block) for block in blocks), rng.permutation(open_water)]
    )


def _residuals_of(
    state: Shared,
    group: Fitted,
    neighbors: bool,
    *,
    transfer: Complex,
    phase_per_path: Floats,
) -> _Residuals:
    """Return the residuals for a subset of the pixels in a group."""
    model = modelled(state, group, transfer=transfer, phase_per_path=phase_per_path)
    pixels = group.pixels
    count, channels, frequencies = pixels.signal.shape
    is_target = np.isfinite(group.path)
    sample = np.linspace(0, count - 1, min(count, _JUDGED)).astype(np.intp)
    key = np.where(is_target, group.path, pixels.longest.max() + np.arange(count))
    order = _mixed(sample[np.argsort(key[sample], kind="stable")], is_target)
    parameters = channels + 1 + (pixels.motion is not None)
    derivatives = np.zeros((count, channels, frequencies, 0), dtype=complex)
    if is_target.any():
        derivatives = np.zeros(
            (count, channels, frequencies, parameters), dtype=complex
        )
        echo = model.echo * (1 + state.echo)
        for c in range(channels):
            derivatives[:, c, :, c] = echo
        by_path = path_derivatives(state, group, model, phase_per_path)
        derivatives[..., channels] = by_path
        if pixels.motion is not None:
            derivatives[..., channels + 1] = pixels.motion[..., 0] * by_path
        derivatives[~is_target] = 0
    used = 2 * int(pixels.usable[order].sum())
    return _Residuals(
        pixels=pixels.part(order),
        residual=model.residual[order],
        water_signal=model.water_signal[order],
        derivatives=derivatives[order],
        freedom=used - parameters * int(is_target[order].sum()),
        neighbors=neighbors,
    )


Bools = NDArray[np.bool_]

#: Probability that a good pixel loses a sample [1].
CHANCE = 1e-3
#: Largest share of outliers among the samples of a pixel, the breakdown point [1].
BREAKDOWN = 1 / 3
#: Chi-square difference between two candidates below which the outlier is uncertain
#: [1].
MARGIN = 9.0
#: Limits above which the model is wrong at a frequency and channel, not the pixels. The
#: share of pixels that disagree exceeds the first, or their number exceeds a multiple
#: of the median over frequencies and channels by a number of standard errors [1].
_MANY, _TIMES, _CHANCES = 0.15, 3.0, 4.0


@dataclass(frozen=True)
class Cleaned:
    """Pixels without outlying samples."""

    pixels: Pixels
    """Samples, with outliers marked unusable."""
    estimates: Estimates
    """Estimates without the outliers."""
    unsettled: Bools
    """Pixels with uncertain outliers."""

    def restored(
        self, pixels: Pixels, estimates: Estimates, index: NDArray[np.intp]
    ) -> Cleaned:
        """Return a copy with all samples of selected pixels restored."""
        if not len(index):
            return self
        usable, unsettled = self.pixels.usable.copy(), self.unsettled.copy()
        usable[index], unsettled[index] = pixels.usable[index], False
        results = {}
        for f in fields(estimates):
            results[f.name] = getattr(self.estimates, f.name).copy()
            results[f.name][index] = getattr(estimates, f.name)[index]
        signal = np.where(usable, pixels.signal, 0.0)
        return Cleaned(
            replace(pixels, usable=usable, signal=signal),
            Estimates(**results),
            unsettled,
        )


def part_of(estimates: Estimates, index: NDArray[np.intp]) -> Estimates:
    """Return the estimates of selected pixels."""
    return Estimates(
        **{f.name: getattr(estimates, f.name)[index] for f in fields(estimates)}
    )


def disagrees(estimates: Estimates, typical: float = 1.0) -> Bools:
    """Return the mask of pixels whose most outlying sample is significant."""
    samples = np.maximum(estimates.used / 2, 1)
    return np.asarray(estimates.outlying > 2 * typical * np.log(samples / CHANCE))


def outlier_candidates(
    estimates: Estimates, shape: tuple[int, int], typical: float
) -> Bools:
    """Return the samples eligible as outliers: those that disagree in few pixels."""
    wrong = estimates.which[disagrees(estimates, typical)]
    count = np.bincount(wrong, minlength=shape[0] * shape[1])
    usual = float(np.median(count))
    limit = _TIMES * usual + _CHANCES * np.sqrt(usual + 1)
    pixels = len(estimates.path)
    is_rare = count <= min(limit, max(_MANY * pixels, 1))
    return np.asarray(is_rare.reshape(shape))


def without_outliers(
    pixels: Pixels,
    estimates: Estimates,
    estimate_again: Callable[[Pixels], Estimates],
    allowed: Bools,
    typical: float,
) -> Cleaned:
    """Remove outlying samples from pixels, and estimate again.

    The frequencies are measured one after the other, so a spike, a particle or a fish
    disturbs a single sample. Each step removes the sample whose removal decreases
    chi-square most, and repeats the estimation, including the ambiguity interval. The
    likelihood assumes independent normal errors, some of them with a nonzero mean. The
    outliers are uncertain in two cases: the odds of another sample in the last step
    are at least 1 to 90, or more than a third of the samples are outliers.
    """
    frequencies = allowed.shape[1]
    usable = pixels.usable
    results = {f.name: getattr(estimates, f.name) for f in fields(estimates)}
    limit = np.floor(BREAKDOWN * estimates.used / 2).astype(int)
    removed = np.zeros(len(pixels), dtype=int)
    margin = np.full(len(pixels), np.inf)
    permitted = allowed.ravel()

    def disagreeing(which: NDArray[np.intp], current: Estimates) -> NDArray[np.intp]:
        return which[disagrees(current, typical) & permitted[current.which]]

    indices = np.arange(len(pixels))
    wrong = disagreeing(indices, estimates)
    stuck = np.zeros(len(pixels), dtype=bool)
    while len(wrong):
        stuck[wrong[removed[wrong] >= limit[wrong]]] = True
        wrong = wrong[removed[wrong] < limit[wrong]]
        if not len(wrong):
            break
        if usable is pixels.usable:
            usable = usable.copy()
            results = {name: values.copy() for name, values in results.items()}
        channel, frequency = np.divmod(results["which"][wrong], frequencies)
        usable[wrong, channel, frequency] = False
        removed[wrong] += 1
        margin[wrong] = results["outlying"][wrong] - results["next_outlying"][wrong]
        part = pixels.part(wrong)
        current = estimate_again(
            replace(
                part,
                usable=usable[wrong],
                signal=np.where(usable[wrong], part.signal, 0.0),
            )
        )
        for name, values in results.items():
            values[wrong] = getattr(current, name)
        wrong = disagreeing(wrong, current)
    if usable is not pixels.usable:
        pixels = replace(
            pixels, usable=usable, signal=np.where(usable, pixels.signal, 0.0)
        )
        estimates = Estimates(**results)
    return Cleaned(
        pixels, estimates, stuck | ((removed > 0) & (margin < MARGIN * typical))
    )
