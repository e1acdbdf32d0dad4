"""Depolarization ratios for which the differences of two channels are single echoes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.rejection.observation import Observation

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels from which the ratio of the water is estimated, at most.
MOST_PIXELS = 800
#: Candidates of the ratio of the water [1].
_CANDIDATES = np.arange(0.0, 0.96, 0.02)
#: Candidates nearer to the ratio of the target cancel its echo, and are left out [1].
_CANCELED = 0.005
#: Step of the search of a path, in radians of the highest frequency.
_STEP = 0.4
#: Steps of the fit of ratios, and of the fit of amplitude and path of a pixel.
_STEPS, _NEWTON = 12, 4
#: Standard uncertainty of the delay between crossed and parallel light of water [s].
_LATER = 0.5e-9
#: Largest ratio of strongest and weakest signal of the water for the prior [1].
_LARGEST_LOSS = 10.0
#: Groups of pixels whose scatter gives an uncertainty.
_PARTS = 8
#: Differences of neighbors over their noise, from which they are significant [1].
_SIGNIFICANT = 20.0
#: Standard errors beyond which differences between targets are significant [1].
_SURE = 4.0
#: Part of a difference across the echo over that along it, as of a change of distance.
_STEEP = 0.3
#: Smallest variance [1].
_TINY = 1e-12


@dataclass(frozen=True, kw_only=True)
class Echo:
    """Single echo fitted to the difference of the channels, arrays over pixels."""

    model: Complex
    """Echo at each frequency, (pixel, frequency) [V]."""
    turn: Complex
    """Phase factors of the echo."""
    amplitude: Floats
    """Amplitude, above zero [V]."""
    misfit: Floats
    """Sum of squared residuals over their variances [1]."""


def fitted(
    difference: Complex,
    variance: Floats,
    wave: Floats,
    path: tuple[float, float],
    gain: Complex,
) -> Echo:
    """Fit an echo of positive amplitude to differences, (pixel, frequency)."""
    weight = 1 / variance
    grid = np.arange(path[0], path[1] + _STEP / wave.max(), _STEP / wave.max())
    size = (weight * np.abs(gain) ** 2).sum(axis=1)
    turned = weight * difference * gain.conj()
    across = (turned @ np.exp(-1j * np.outer(wave, grid))).real
    place = grid[across.argmax(axis=1)]
    for _ in range(_NEWTON):
        parts = turned * np.exp(-1j * place[:, None] * wave)
        slope = (parts.imag * wave).sum(axis=1)
        curvature = (parts.real * wave**2).sum(axis=1)
        step = np.divide(
            slope, curvature, out=np.zeros_like(slope), where=curvature > 0
        )
        limit = _STEP / wave.max()
        place = place + np.clip(step, -limit, limit)
    turn = np.exp(1j * place[:, None] * wave) * gain
    amplitude = (weight * difference * turn.conj()).real.sum(axis=1) / size
    amplitude = np.maximum(amplitude, 0.0)
    model = amplitude[:, None] * turn
    misfit = (weight * np.abs(difference - model) ** 2).sum(axis=1)
    return Echo(model=model, turn=turn, amplitude=amplitude, misfit=misfit)


@dataclass(frozen=True, kw_only=True)
class RatioFit:
    """Scan-wide ratios of cross-polarized to co-polarized signal."""

    water: Complex
    """Ratio of the water at each frequency [1]."""
    covariance: Floats
    """Covariance of its real parts, its imaginary parts, and both parts of the ratio of
    the target, (2 n + 2, 2 n + 2) [1]."""
    gain: Complex
    """Gain of the echo at each frequency [1]."""
    unsteady: Floats
    """Fluctuation of the water signal at each frequency [V]."""
    fluctuation: float
    """The same, relative to the water signal [1]."""
    scale: float
    """Median misfit of the pixels over its expectation, at least 1 [1]."""
    target: TargetRatio
    """Ratio of the targets."""
    terms: tuple[str, ...] = ()
    """Names of the error terms that are not zero everywhere."""


@dataclass(frozen=True, kw_only=True)
class TargetRatio:
    """Ratio of the targets, with an imaginary part that grows with frequency.

    The imaginary part is that of a delay of the crossed echo.
    """

    real: float
    """Real part [1]."""
    imaginary: float = 0.0
    """Imaginary part at the highest frequency [1]."""
    uncertainty: tuple[float, float]
    """Standard uncertainties of both parts [1]."""
    tested: bool
    """Whether neighboring pixels give an estimate."""
    contradicted: bool = False
    """Whether their estimate contradicts the stated value."""

    def at(self, frequency: Floats) -> Complex:
        """Return the ratio at frequencies of the scan."""
        return np.asarray(self.real + 1j * self.imaginary * frequency / frequency.max())


@dataclass(frozen=True)
class Pair:
    """Samples of both channels, over (pixel, frequency), with their variances."""

    co: Complex
    cross: Complex
    of_co: Floats
    of_cross: Floats

    def part(self, index: Any) -> Pair:
        """Return the samples at an index."""
        return Pair(*(values[index] for values in vars(self).values()))

    def difference(
        self, ratio: Complex | float, unsteady: Floats | float = 0.0
    ) -> tuple[Complex, Floats]:
        """Return the weighted difference of the channels, and its variance.

        `unsteady` is the change of the water signal between both channels [V].
        """
        variance = self.of_cross + np.abs(ratio) ** 2 * (self.of_co + unsteady**2)
        return self.cross - ratio * self.co, variance


def pair_of_samples(first: Observation, second: Observation) -> Pair:
    """Return the samples of both channels; variances are means of both outputs."""

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        return values[:, 0].reshape(len(values), -1).T

    variances = [
        flat((part.covariance.in_phase + part.covariance.quadrature) / 2)
        for part in (first, second)
    ]
    return Pair(flat(first.signal), flat(second.signal), *variances)


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Prior of the ratio of the water and the gain of the echo."""

    water: Complex | None
    """Expected ratio at each frequency; None if nothing is stated [1]."""
    uncertainty: float
    """Standard uncertainty that all frequencies share [1]."""
    spread: float
    """Standard deviation of the crossed water signal between frequencies, relative to
    its largest value [1]."""
    gain: float
    """Standard deviation of the gain of the echo between frequencies [1]."""
    fluctuation: float
    """Relative fluctuation of the water signal from sample to sample [1]."""

    def covariance(
        self, water: Complex, haze: Floats, frequency: Floats, target: TargetRatio
    ) -> Floats:
        """Return the covariance of ratios and gains, and of the ratio of the target.

        The spread is relative to the strongest signal of the water.
        """
        count = frequency.size
        size = np.abs(water)
        loss = np.minimum(haze.max() / np.maximum(haze, _TINY), _LARGEST_LOSS)
        own = np.diag((self.spread * size * loss) ** 2)
        # Crossed light is later: a delay turns the ratio in proportion to frequency.
        turn = 2 * np.pi * frequency * _LATER * size
        total = self.gain**2 * np.eye(4 * count + 2)
        total[:count, :count] = own + self.uncertainty**2
        total[count : 2 * count, count : 2 * count] = own + np.outer(turn, turn)
        total[-2:, -2:] = np.diag(np.square(target.uncertainty) + _TINY)
        return total


def fit_ratio(
    pair: Pair,
    wave: Floats,
    frequency: Floats,
    path: tuple[float, float],
    prior: Prior,
    target: TargetRatio,
    patch: NDArray[np.intp],
) -> RatioFit:
    """Fit the water ratio at which the differences of all pixels are single echoes.

    `patch` is the number of the patch of each pixel. Departures that pixels of a patch
    share enlarge the errors of the ratios.
    """
    gain = np.ones(frequency.size, dtype=complex)
    expected = prior.water
    if expected is None:
        candidates = _CANDIDATES[np.abs(_CANDIDATES - target.real) > _CANCELED]
        chances = [
            float(
                np.sum(
                    np.minimum(misfit_of(pair, ratio, wave, path, gain), 1e3)
                    + np.log(pair.difference(ratio)[1]).sum(axis=1)
                )
            )
            for ratio in candidates
        ]
        expected = np.full(
            frequency.size, candidates[int(np.argmin(chances))], dtype=complex
        )
    expected = np.asarray(expected, dtype=complex)
    middle = np.concatenate(
        [
            expected.real,
            expected.imag,
            gain.real,
            gain.imag,
            [target.real, target.imaginary],
        ]
    )
    state, scale, together = middle.copy(), 1.0, 1.0
    kept = np.ones(len(pair.co), dtype=bool)
    count = frequency.size
    covariance = np.eye(middle.size)
    ramp = frequency / frequency.max()
    unsteady = np.zeros(count)
    for step in range(_STEPS):
        water = state[:count] + 1j * state[count : 2 * count]
        gain = state[2 * count : 3 * count] + 1j * state[3 * count : 4 * count]
        used = pair.part(kept)
        difference, variance = used.difference(water, unsteady)
        apart = state[-2] + 1j * ramp * state[-1] - water
        contrast = gain * apart
        echo = fitted(difference, variance, wave, path, contrast)
        rest = difference - echo.model
        plain = echo.model / apart
        # The mean over the pixels has no noise that would count as information.
        haze = np.broadcast_to((used.co - plain).mean(axis=0), plain.shape)
        signal = np.abs(haze[0])
        unsteady = prior.fluctuation * signal
        size = np.full(count, max(abs(water[signal.argmax()]), 0.01))
        precision = np.linalg.inv(prior.covariance(size, signal, frequency, target))
        effects = (
            haze,
            1j * haze,
            echo.model,
            1j * echo.model,
            np.stack([plain, 1j * ramp * plain], axis=2),
        )
        normal, slopes = _normal(effects, echo, rest, variance, wave, patch[kept])
        inflation = scale * together
        covariance = np.linalg.inv(normal / inflation + precision)
        slope = slopes.sum(axis=0) / inflation
        state = state + covariance @ (slope + precision @ (middle - state))
        freedom = 2 * count - 2
        misfit = misfit_of(pair, water, wave, path, contrast, unsteady) / freedom
        if step >= 3:
            scale = max(1.0, float(np.median(misfit)))
            kept = misfit < 9 * scale
            scattered = np.einsum("gi,ij,gj->", slopes, covariance, slopes)
            expected_scatter = scale * np.sum(normal * covariance)
            together = max(1.0, float(scattered / expected_scatter))
    chosen = [*range(2 * count), -2, -1]
    return RatioFit(
        water=state[:count] + 1j * state[count : 2 * count],
        covariance=covariance[np.ix_(chosen, chosen)],
        gain=state[2 * count : 3 * count] + 1j * state[3 * count : 4 * count],
        unsteady=unsteady,
        fluctuation=prior.fluctuation,
        scale=scale,
        target=replace(
            target,
            real=float(state[-2]),
            imaginary=float(state[-1]),
            uncertainty=(
                float(np.sqrt(covariance[-2, -2])),
                float(np.sqrt(covariance[-1, -1])),
            ),
        ),
    )


def misfit_of(
    pair: Pair,
    ratio: Any,
    wave: Floats,
    path: tuple[float, float],
    gain: Complex,
    unsteady: Floats | float = 0.0,
) -> Floats:
    """Return the squared residuals of single echoes over their variances."""
    difference, variance = pair.difference(ratio, unsteady)
    return fitted(difference, variance, wave, path, gain).misfit


def _normal(
    effects: tuple[Complex, ...],
    echo: Echo,
    rest: Complex,
    variance: Floats,
    wave: Floats,
    patch: NDArray[np.intp],
) -> tuple[Floats, Floats]:
    """Return normal equations of ratios and gains, amplitude and path eliminated.

    Their right sides are those of each patch.
    """
    count = wave.size
    error = np.sqrt(variance)
    own = np.stack([echo.turn, 1j * wave * echo.turn], axis=2) / error[..., None]
    outputs = rest / error
    # Real basis of amplitude and path, (pixel, frequency, direction).
    basis, _ = np.linalg.qr(np.concatenate([own.real, own.imag], axis=1))
    turned = basis[:, :count] - 1j * basis[:, count:]
    each = np.stack(effects[:-1], axis=2) / error[..., None]
    shared = effects[-1] / error[..., None]

    def apart(values: Complex) -> Floats:
        """Return the products with the basis, by frequency."""
        return np.asarray((turned[..., :, None] * values[..., None, :]).real)

    alone, common = apart(each), apart(shared).sum(axis=1)
    # Columns in the order of the parameters: effects by frequency, then the shared.
    alone = alone.transpose(0, 2, 3, 1).reshape(len(rest), 2, -1)
    inner = np.concatenate([alone, common], axis=2)
    size = inner.shape[2]
    normal = np.zeros((size, size))
    place = np.arange(size - 2).reshape(-1, count)
    for first, one in enumerate(place):
        for second, other in enumerate(place):
            product = (each[..., first].conj() * each[..., second]).real.sum(axis=0)
            normal[one, other] = product
        crossed = (each[..., first].conj()[..., None] * shared).real.sum(axis=0)
        normal[one, -2:] = crossed
        normal[-2:, one] = crossed.T
    normal[-2:, -2:] = np.einsum("pfa,pfb->ab", shared.conj(), shared).real
    flat = inner.reshape(-1, size)
    normal -= flat.T @ flat
    slope = np.concatenate(
        [
            (each.conj() * outputs[..., None])
            .real.transpose(0, 2, 1)
            .reshape(len(rest), -1),
            (shared.conj() * outputs[..., None]).real.sum(axis=1),
        ],
        axis=1,
    )
    along = (turned * outputs[..., None]).real.sum(axis=1)
    slope -= np.einsum("pd,pdk->pk", along, inner)
    slopes = np.zeros((patch.max() + 1, size))
    np.add.at(slopes, patch, slope)
    return normal, slopes


def target_ratio_of_neighbors(
    first: Observation,
    second: Observation,
    *,
    fluctuation: float = 0.0,
    empty: NDArray[np.bool_] | None = None,
) -> TargetRatio | None:
    """Return the target ratio by second differences along rows.

    Neighbors have nearly the same water signal, so that differences show the target
    alone. Where the distance changes, the water in front of the target does, too. It
    also changes beside pixels without a target, `empty`. None if the reflectance does
    not vary enough, compared with the noise and the relative fluctuation of the water
    signal.
    """
    if first.signal.shape[3] < 3:
        return None

    def curved(values: NDArray[Any], middle: float) -> NDArray[Any]:
        return np.asarray(
            values[..., 2:] + middle * values[..., 1:-1] + values[..., :-2]
        )

    co, cross = (curved(part.signal[:, 0], -2.0) for part in (first, second))
    variances = [
        curved((part.covariance.in_phase + part.covariance.quadrature)[:, 0], 4.0)
        for part in (first, second)
    ]
    usable = first.usable[:, 0] & second.usable[:, 0]
    if empty is not None:
        usable = usable & ~empty
    three = (usable[..., 2:] & usable[..., 1:-1] & usable[..., :-2]).all(axis=0)
    # A difference in phase with the echo is one of reflectance.
    highest = int(first.frequency.argmax())
    middle = curved(second.signal[:, 0], 1.0)[highest]
    turned = co[highest] * np.exp(-1j * np.angle(middle))
    noise = np.sqrt(variances[0][highest])
    steady = np.abs(turned.imag) < np.maximum(_STEEP * np.abs(turned.real), 2 * noise)
    three = three & steady
    co, cross = co[:, three], cross[:, three]
    of_co, of_cross = (values[:, three] for values in variances)
    usual = np.nanmedian(np.abs(first.signal[:, 0]), axis=(1, 2))
    changes = of_co + 6 * (fluctuation * usual[:, None]) ** 2
    parts = np.arange(co.shape[1]) * _PARTS // max(co.shape[1], 1)
    if np.unique(parts).size < _PARTS:
        return None
    ratio = 0.0
    for _ in range(3):
        weight = 1 / (of_cross + ratio**2 * of_co)
        tops = weight * (co.conj() * cross)
        bottoms = weight * (np.abs(co) ** 2 - of_co)
        top, bottom = (
            np.array([values[:, parts == k].sum() for k in range(_PARTS)])
            for values in (tops, bottoms)
        )
        total = float(bottom.sum())
        chance = float(np.sum((weight * changes) ** 2)) ** 0.5
        if total < _SIGNIFICANT * chance:
            return None
        ratio = float(top.real.sum()) / total
    ramp = (first.frequency / first.frequency.max())[:, None]
    crossed, squares = (
        np.array([values[:, parts == k].sum() for k in range(_PARTS)])
        for values in (ramp * tops.imag, ramp**2 * bottoms)
    )
    later = float(crossed.sum() / squares.sum())
    errors = [
        float(np.sqrt(_PARTS / (_PARTS - 1) * np.sum(rest**2)) / np.sum(size))
        for rest, size in (
            (top.real - ratio * bottom, bottom),
            (crossed - later * squares, squares),
        )
    ]
    # Different targets in one scan.
    rest = weight * np.abs(cross - (ratio + 1j * later * ramp) * co) ** 2
    excess = float(rest.sum()) - rest.size
    if excess > _SURE * math.sqrt(2 * rest.size):
        errors[0] = math.hypot(errors[0], math.sqrt(excess / total))
    return TargetRatio(
        real=ratio, imaginary=later, uncertainty=(errors[0], errors[1]), tested=True
    )


def of_open_water(co: Observation, cross: Observation) -> tuple[float, float]:
    """Return the ratio and the relative fluctuation of open water."""
    both = co.usable[:, 0] & cross.usable[:, 0]
    a, b = (np.where(both, part.signal[:, 0], 0.0) for part in (co, cross))
    count = np.maximum(both.sum(axis=1), 2)
    mean = a.sum(axis=1) / count
    power = np.abs(mean) ** 2
    if not power.sum() > 0:
        raise CubeError("the open-water shots have no number in both channels")
    ratio = float((mean.conj() * b.sum(axis=1) / count).real.sum() / power.sum())
    noise = (co.covariance.in_phase + co.covariance.quadrature)[:, 0]
    scatter = np.where(both, np.abs(a - mean[:, None]) ** 2 - noise, 0.0)
    excess = float(scatter.sum(axis=1).sum() / (count * power).sum())
    return ratio, math.sqrt(max(excess, 0.0))
