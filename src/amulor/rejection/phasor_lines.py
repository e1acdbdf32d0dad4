"""Phasor-line method: neighbors of different reflectance give the target's phase."""

from __future__ import annotations

import functools
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import chdtrc, digamma, polygamma

from amulor import cube as cubes
from amulor.cube import WaterResidualCause, tiles
from amulor.errors import CubeError
from amulor.rejection import quality
from amulor.rejection.build import present_terms, target_cube
from amulor.rejection.covariance import Covariance
from amulor.rejection.methods import method
from amulor.rejection.observation import Observation
from amulor.rejection.smooth_water import (
    TERMS,
    Field,
    Offsets,
    SmoothWater,
    fit_smooth_water,
    quadratic,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest phase error of a direction: beyond, the reflectance does not vary [rad].
_LARGEST_ERROR = 0.1
#: Least number of samples beyond the unknowns of a window.
_LEAST_FREEDOM = 6
#: Steps of the fit; the phase of a window converges quadratically.
_STEPS = 5
#: Largest change of the phase in a step [rad].
_LARGEST_STEP = 0.5
#: Windows that are fitted at once; this bounds the memory.
_AT_ONCE = 8_192
#: Least variation of the reflectance that is not smooth, in parts of the signal [1].
_LEAST_CONTRAST = 0.05
#: Least width of a window [pixels].
_SMALLEST = 5
#: Number of terms of the noise scale, and least number of independent windows for it.
_SCALE_TERMS = ((6, 12.0), (3, 4.0), (1, 0.0))
#: Largest share of a single edge in the variation of the reflectance [1]. It may be the
#: edge of an object, with a change of the distance.
_EDGE = 0.6
#: Quantile of the amplitudes that bounds the expected water signal [1].
_STRONG = 0.95
#: Largest share of a single edge in a line from which the water is estimated [1].
_WATER_EDGE = 0.4
#: Largest uncertainty of the water signal along the targets, in parts of their median:
#: beyond, the phase is that of windows [1].
_SURE_WATER = 0.1
#: Least share of pixels with so sure a water signal [1].
_SURE_PIXELS = 0.8
#: Largest scatter of the lines about this water signal, over their variances [1].
_LARGEST_MISFIT = 2.0
#: Difference of the brightness of two sides of a window that is a step, in standard
#: errors [1].
_STEP = 5.0
#: Smallest divisor.
_TINY = 1e-300
#: Probability of a scatter below which the errors are enlarged by it [1].
_RARE = 0.05
#: Largest sum of the correlations of the residuals at different frequencies and
#: channels, in standard errors: noise is independent, an edge is the same in all [1].
_LARGEST_COHERENCE = 2.5
#: Least number of frequencies and channels with a line, if there are so many.
_FEWEST_LINES = 3
#: Share of windows that no edge of an object crosses, at least [1].
_MOST_EDGES = 0.5
#: Largest deviation of the windows that give the noise scale, step by step [1].
_LIMITS = (5.0, 4.0, 3.0, 2.5, 2.5, 2.5)


@dataclass(frozen=True, kw_only=True)
class NoiseScale:
    """Factor on the stated variances, a smooth function of the direction."""

    field: Field
    """Directions of the scan."""
    terms: Floats
    """Terms of the logarithm, over (modulation_frequency, polarization, term)."""

    def at(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return the factor, at least 1, over (frequency, channel, row, column)."""
        terms = self.field.terms(azimuth, elevation)
        logarithm = np.zeros((*self.terms.shape[:2], *azimuth.shape))
        for k in range(self.terms.shape[2]):
            logarithm += self.terms[:, :, k, None, None] * terms[..., k]
        return np.exp(np.maximum(logarithm, 0.0))


@dataclass(frozen=True, kw_only=True)
class PhasorLinesFit:
    """Scan-wide parameters of the phasor-line method."""

    fluctuation: NoiseScale
    """Variance of bright and dark samples alike, such as that of fluctuating water: 1
    more than its ratio to `stated`."""
    stated: Floats
    """Harmonic mean of the stated variances, over (modulation_frequency, polarization,
    1, 1) [V^2]."""
    noise_scale: NoiseScale
    """Factor on the sum of both variances."""
    water: SmoothWater
    """Water signal that the lines have in common."""
    by_water: NDArray[np.bool_]
    """Whether this water signal is subtracted, over (modulation_frequency,
    polarization, 1, 1). If not, the phase is that of windows."""
    has_edges: bool
    """Whether most windows cross an edge, so that none can be trusted."""
    terms: tuple[str, ...]
    """Names of the error terms that are not zero everywhere."""


@dataclass(frozen=True, kw_only=True)
class _Lines:
    """Lines through the samples of windows, arrays over windows."""

    phase: Floats
    """Terms of the phase of the target, as in `_surface`, on the last axis [rad]."""
    covariance: Floats
    """Covariance of these terms, on the last two axes, infinite where the reflectance
    does not vary [rad^2]."""
    misfit: Floats
    """Chi-square of the distances of the samples from the line [1]."""
    freedom: Floats
    """Degrees of freedom of the misfit [1]."""
    edge: Floats
    """Share of a single edge in the variation of the reflectance [1]."""
    offset: Floats
    """Water signal across the line in the middle of the window [V]."""
    offset_terms: Floats
    """Terms of the variance of the offset, on the last axis: a polynomial of the water
    signal along the line."""
    coherence: Floats
    """Sum of the correlations of the residuals with those of the other frequencies and
    channels, in standard errors [1]."""

    @property
    def smooth(self) -> NDArray[np.bool_]:
        """Mask of windows whose residuals are independent, as those of noise."""
        return np.asarray(self.coherence < _LARGEST_COHERENCE)

    def scale(self, factor: Floats) -> None:
        """Multiply the variances of the samples by a factor for each window."""
        self.misfit[:] /= factor
        self.covariance[:] *= factor[..., None, None]
        self.offset_terms[:] *= factor[..., None]


def _surface(window: int) -> Floats:
    """Return the terms of a quadratic surface at the samples of a window."""
    line = np.linspace(-1.0, 1.0, window)
    y, x = (part.ravel() for part in np.meshgrid(line, line, indexing="ij"))
    return quadratic(x, y)


@functools.cache
def _edges(window: int) -> Floats:
    """Return normalized steps across a window, without their smooth part.

    Straight edges in eight directions, and corners of objects.
    """
    surface = _surface(window)
    x, y = surface[:, 1], surface[:, 2]
    places = np.linspace(-1, 1, 2 * window - 1)[1::2]
    sides = [
        np.cos(angle) * x + np.sin(angle) * y > place * (1 + abs(np.sin(2 * angle)) / 3)
        for angle in np.arange(8) * np.pi / 8
        for place in places
    ]
    lines = [
        (sign * x > a, other * y > b)
        for a in places
        for b in places
        for sign in (-1, 1)
        for other in (-1, 1)
    ]
    sides += [first & second for first, second in lines]
    steps = np.array(
        [side for side in sides if 0 < side.sum() < side.size], dtype=float
    )
    steps -= steps @ np.linalg.pinv(surface).T @ surface.T
    sizes = np.linalg.norm(steps, axis=1)
    return np.asarray(steps[sizes > 0.1] / sizes[sizes > 0.1, None])


def _residuals(
    signal: Complex,
    errors: Covariance,
    usable: NDArray[np.bool_],
    phase: Floats,
    window: int,
) -> Floats:
    """Return the residuals across the lines over their errors, shape (window, sample).

    Quadratic functions for the water and for the distance are taken out.
    """
    surface = _surface(window)
    turn = np.exp(-1j * (phase @ surface.T))
    turned = signal * turn
    weight = np.sqrt(usable / errors.turned(turn).quadrature)
    whole = turned.real
    along = whole - np.average(whole, weights=weight**2, axis=1)[:, None]
    columns = weight[:, :, None] * np.concatenate(
        [np.broadcast_to(surface, (len(signal), *surface.shape)),
         along[:, :, None] * surface], axis=2,
    )  # fmt: skip
    basis = np.linalg.qr(columns)[0]
    rest = weight * turned.imag
    part = np.ascontiguousarray(basis.swapaxes(1, 2)) @ rest[:, :, None]
    return np.asarray(rest - (basis @ part)[:, :, 0])


def _coherence(residuals: Floats, freedom: Floats) -> Floats:
    """Return the sum of correlations between planes, in standard errors.

    Residuals are over (plane, window, sample), zero for planes without a line.
    """
    power = (residuals**2).sum(axis=2)
    products = ((residuals.sum(axis=0) ** 2).sum(axis=1) - power.sum(axis=0)) / 2
    squares = (power.sum(axis=0) ** 2 - (power**2).sum(axis=0)) / 2
    variance = squares / np.maximum(freedom, 1.0)
    # Correlations of few lines are small by chance too often to show a smooth surface.
    fewest = min(len(residuals), _FEWEST_LINES)
    untested = (power > 0).sum(axis=0) < fewest
    coherence = products / np.sqrt(np.maximum(variance, _TINY))
    return np.where(untested, np.inf, np.where(squares > 0, coherence, 0.0))


def _fit_lines(
    signal: Complex, errors: Covariance, usable: NDArray[np.bool_], window: int
) -> tuple[_Lines, Complex]:
    """Fit a line to each window, arrays over (window, sample); return also contrasts.

    Contrasts are the signals without their smooth part.
    """
    surface = _surface(window)
    freedom = usable.sum(axis=1) - 2.0 * TERMS
    enough = freedom >= _LEAST_FREEDOM
    usable = usable & enough[:, None]
    usable[~enough] = True  # arbitrary results, which are discarded below
    contrast = _contrast(signal, errors, usable, surface)
    phase = np.zeros((len(signal), TERMS))
    phase[:, 0] = np.angle((contrast**2).sum(axis=1)) / 2
    for _ in range(_STEPS):
        fit = _normal(signal, errors, usable, phase, surface)
        phase += np.clip(fit.change, -_LARGEST_STEP, _LARGEST_STEP)
    fit = _normal(signal, errors, usable, phase, surface)
    settled = np.abs(fit.change[:, 0]) ** 2 < 1e-4 * fit.covariance[:, 0, 0]
    along = (contrast * np.exp(-1j * phase[:, :1])).real
    largest = ((along @ _edges(window).T) ** 2).max(axis=1)
    edge = largest / np.maximum((along**2).sum(axis=1), _TINY)
    fit.covariance[~(enough & settled & (edge < _EDGE))] = np.inf
    lines = _Lines(
        phase=phase,
        covariance=fit.covariance,
        misfit=fit.misfit,
        freedom=freedom,
        edge=edge,
        offset=fit.offset,
        offset_terms=fit.offset_terms,
        coherence=np.zeros(len(signal)),
    )
    return lines, contrast


def _contrast(
    signal: Complex, errors: Covariance, usable: NDArray[np.bool_], surface: Floats
) -> Complex:
    """Return the signals over their errors, less a quadratic surface in the window."""
    weight = usable / np.sqrt(errors.in_phase + errors.quadrature)
    design = weight[:, :, None] * surface
    across = design.swapaxes(1, 2)
    right = across @ (weight * signal)[:, :, None]
    smooth = design @ np.linalg.solve(across @ design, right)
    return np.asarray(weight * signal - smooth[:, :, 0])


@dataclass(frozen=True)
class _Normal:
    """Step of the fit of the lines, over windows."""

    change: Floats
    """Change of the terms of the phase, last axis [rad]."""
    covariance: Floats
    """Covariance of these terms, infinite without contrast [rad^2]."""
    misfit: Floats
    """Chi-square of the distances from the line [1]."""
    offset: Floats
    """Water signal across the line in the middle of the window [V]."""
    offset_terms: Floats
    """Terms of the variance of the offset, as in `_Lines`."""


def _normal(
    signal: Complex,
    errors: Covariance,
    usable: NDArray[np.bool_],
    phase: Floats,
    surface: Floats,
) -> _Normal:
    """Return the step of the least-squares fit across the lines.

    The samples along the line, which multiply the phase, have noise. Its products are
    subtracted, so that noise does not pull the phase to its start.
    """
    turn = np.exp(-1j * (phase @ surface.T))
    turned, variance = signal * turn, errors.turned(turn)
    weight = usable / variance.quadrature
    whole, across = turned.real, turned.imag
    along = whole - np.average(whole, weights=weight, axis=1)[:, None]
    of_phase = along[:, :, None] * surface
    weighted = weight[:, :, None] * surface
    of_water = np.ascontiguousarray(weighted.swapaxes(1, 2))
    water = of_water @ surface
    solved = np.linalg.solve(water, of_water)
    share = weight * np.clip(1 - np.einsum("ij,nji->ni", surface, solved), 0, 1)
    # What the smooth part leaves of the columns and of the samples.
    left = of_phase - surface @ (solved @ of_phase)
    rest = across - (surface @ (solved @ across[:, :, None]))[:, :, 0]
    left_weighted = np.ascontiguousarray((weight[:, :, None] * left).swapaxes(1, 2))
    information = left_weighted @ left
    slope = (left_weighted @ rest[:, :, None])[:, :, 0]
    squares = (surface[:, :, None] * surface[:, None, :]).reshape(-1, TERMS**2)
    noise = ((share * variance.in_phase) @ squares).reshape(-1, TERMS, TERMS)
    slope = slope - (share * variance.cross) @ surface
    without_noise = information - noise
    positive = np.linalg.eigvalsh(without_noise)[:, 0] > 0
    power = (weight * np.abs(signal) ** 2).sum(axis=1)
    positive &= without_noise[:, 0, 0] > _LEAST_CONTRAST**2 * power
    without_noise[~positive] = np.eye(TERMS)
    inverse = np.linalg.inv(without_noise)
    covariance = inverse @ information @ inverse
    change = (inverse @ slope[:, :, None])[:, :, 0]
    change[~positive] = 0.0
    middle = solved[:, 0]
    # A turn of the line moves the offset by the amplitude of the target. That is the
    # signal along the line, less the water signal.
    lever = (middle * whole) @ surface
    with_lever = (covariance @ lever[:, :, None])[:, :, 0]
    noise_part = (middle**2 * variance.quadrature).sum(axis=1)
    terms = np.stack(
        [
            noise_part + (lever * with_lever).sum(axis=1),
            -2 * with_lever[:, 0],
            covariance[:, 0, 0],
        ],
        axis=1,
    )
    covariance[~positive] = np.inf
    return _Normal(
        change=change,
        covariance=covariance,
        misfit=(weight * rest**2).sum(axis=1),
        offset=(middle * across).sum(axis=1),
        offset_terms=terms,
    )


def _fit_windows(scan: Observation, errors: Covariance, window: int) -> _Lines:
    """Fit lines to all windows, arrays over (frequency, channel, row, column)."""
    signal, usable = scan.signal, scan.usable
    parts = [
        np.where(usable, part, fill)
        for part, fill in (
            (signal, 0.0),
            (errors.in_phase, 1.0),
            (errors.quadrature, 1.0),
            (errors.cross, 0.0),
        )
    ]
    views = [
        np.lib.stride_tricks.sliding_window_view(part, (window, window), axis=(2, 3))
        for part in (*parts, usable)
    ]
    rows, columns = views[0].shape[2:4]
    step = max(1, _AT_ONCE // columns)
    blocks = [
        _fit_block([view[:, :, first : first + step] for view in views], window)
        for first in range(0, rows, step)
    ]
    return _Lines(
        **{
            field.name: np.concatenate(
                [getattr(block, field.name) for block in blocks], axis=2
            )
            for field in fields(_Lines)
        }
    )


def _fit_block(views: list[NDArray[Any]], window: int) -> _Lines:
    """Fit lines to the windows of some rows, and direct them alike in all samples."""
    shape, planes = views[0].shape[:4], views[0].shape[:2]
    lines, contrasts, bright, residuals = [], [], [], []
    for plane in np.ndindex(planes):
        signal, in_phase, quadrature, cross, usable = (
            view[plane].reshape(-1, window**2) for view in views
        )
        errors = Covariance(in_phase, quadrature, cross)
        line, contrast = _fit_lines(signal, errors, usable, window)
        turn = np.exp(-1j * line.phase[:, :1])
        known = np.isfinite(line.covariance[:, 0, 0])
        rest = _residuals(signal, errors, usable, line.phase, window) * known[:, None]
        power = np.maximum((rest**2).sum(axis=1, keepdims=True), _TINY)
        residuals.append(rest / np.sqrt(power))
        lines.append(line)
        contrasts.append((contrast * turn).real * known[:, None])
        noise = np.sqrt((in_phase + quadrature).mean(axis=1))
        bright.append((signal * turn).real.mean(axis=1) / noise * known)
    along = np.stack(contrasts)
    strongest = (along**2).sum(axis=2).argmax(axis=0)
    reference = np.take_along_axis(along, strongest[None, :, None], axis=0)
    sense = np.where((along * reference).sum(axis=2) < 0, -1.0, 1.0)
    backward = (sense * np.stack(bright)).sum(axis=0) < 0
    opposite = (sense < 0) != backward
    turned = np.where(opposite, -1.0, 1.0)[:, :, None] * np.stack(residuals)
    coherence = _coherence(turned, lines[0].freedom)
    for line, where in zip(lines, opposite, strict=True):
        line.coherence[:] = coherence
        line.phase[where, 0] += np.pi
        line.offset[where] *= -1
        line.offset_terms[where, 1] *= -1
    return _Lines(
        **{
            field.name: values.reshape(*shape, *values.shape[2:])
            for field in fields(_Lines)
            for values in [np.stack([getattr(line, field.name) for line in lines])]
        }
    )


@dataclass(frozen=True, kw_only=True)
class _Directions:
    """Phase of the target at each sample, shape of the samples."""

    phase: Floats
    """Phase [rad]."""
    variance: Floats
    """Variance of the phase, infinite where the reflectance does not vary [rad^2]."""
    doubtful: NDArray[np.bool_]
    """Mask of pixels whose best window contradicts a line, shape (row, column)."""


def _directions(lines: _Lines, frequency: Floats, window: int) -> _Directions:
    """Take the phase of each pixel from the window that determines it best."""
    rows, columns = (size + window - 1 for size in lines.misfit.shape[2:])
    planes = lines.misfit.shape[:2]
    misfit, freedom = (
        np.where(np.isfinite(lines.covariance[..., 0, 0]), part, 0.0).sum(axis=(0, 1))
        for part in (lines.misfit, lines.freedom)
    )
    probability = chdtrc(np.maximum(freedom, 1.0), misfit)
    agrees = (probability > quality.PLAUSIBLE) & lines.smooth[0, 0]
    # Scatter that noise hardly makes is an error.
    birge = np.where(probability < _RARE, misfit / np.maximum(freedom, 1.0), 1.0)
    known = np.isfinite(lines.covariance[..., 0, 0])
    covariance = np.where(known[..., None, None], lines.covariance, 0.0)
    # Windows that cross the edge of an object are used where there are no others.
    weight = frequency[:, None, None, None] ** 2 * (1 - lines.edge) ** 4
    best = np.full((rows, columns), -np.inf)
    phase = np.zeros((*planes, rows, columns))
    variance = np.full((*planes, rows, columns), np.inf)
    doubtful = np.zeros((rows, columns), dtype=bool)
    for k, place in enumerate(_surface(window)):
        i, j = divmod(k, window)
        here = (slice(i, rows - window + 1 + i), slice(j, columns - window + 1 + j))
        error = np.zeros(lines.misfit.shape)
        for a, b in np.ndindex(TERMS, TERMS):
            error += covariance[..., a, b] * place[a] * place[b]
        error *= birge
        error[~known] = np.inf
        value = np.zeros(lines.misfit.shape)
        for a in range(TERMS):
            value += lines.phase[..., a] * place[a]
        score = (weight / error).sum(axis=(0, 1))
        # A window that contradicts a line counts only where there is no other.
        score = np.where(agrees, score, score * 1e-12)
        better = score > best[here]
        best[here][better] = score[better]
        doubtful[here][better] = ~agrees[better]
        for values, new in ((phase, value), (variance, error)):
            values[:, :, *here][:, :, better] = new[:, :, better]
    return _Directions(phase=phase, variance=variance, doubtful=doubtful)


def _brightness_steps(scan: Observation, window: int) -> NDArray[np.bool_]:
    """Return the mask of samples near a step of the brightness.

    Two sides of a window differ by more than the pattern on each side. The step may be
    the edge of an object.
    """
    surface = _surface(window)
    x, y = surface[:, 1], surface[:, 2]
    values, use = (
        np.lib.stride_tricks.sliding_window_view(part, (window, window), axis=(2, 3))
        for part in (np.where(scan.usable, np.abs(scan.signal), 0.0), scan.usable)
    )
    steps = np.zeros(values.shape[:4], dtype=bool)
    for across in (x, y, (x + y), (x - y)):
        means, squares, counts = [], [], []
        for side in (across > _TINY, across < -_TINY):
            weight = use * side.reshape(window, window)
            count = np.maximum(weight.sum(axis=(4, 5)), 1)
            mean = (values * weight).sum(axis=(4, 5)) / count
            rest = (values - mean[..., None, None]) * weight
            means.append(mean)
            squares.append((rest**2).sum(axis=(4, 5)))
            counts.append(count)
        freedom = np.maximum(counts[0] + counts[1] - 2, 1)
        variance = (squares[0] + squares[1]) / freedom
        variance *= 1 / counts[0] + 1 / counts[1]
        steps |= (means[0] - means[1]) ** 2 > _STEP**2 * variance
    half = window // 2
    whole = np.pad(steps, ((0, 0), (0, 0), (half, half), (half, half)), mode="edge")
    rows, columns = scan.signal.shape[2:]
    near = np.pad(whole, ((0, 0), (0, 0), (1, 1), (1, 1)), mode="edge")
    shifted = [
        near[:, :, i : i + rows, j : j + columns] for i in range(3) for j in range(3)
    ]
    return np.asarray(np.any(shifted, axis=0))


def _noise_scale(
    lines: _Lines, azimuth: Floats, elevation: Floats, window: int
) -> NoiseScale:
    """Fit the factor on the stated variances to the misfits of the windows.

    Windows across the edge of an object fit no line, and are left out step by step.
    """
    field = Field.of(azimuth, elevation)
    design = field.terms(azimuth, elevation)
    terms = np.zeros((*lines.misfit.shape[:2], TERMS))
    for plane in np.ndindex(lines.misfit.shape[:2]):
        good = np.isfinite(lines.covariance[plane][..., 0, 0])
        good &= (lines.misfit[plane] > 0) & lines.smooth[plane]
        # Windows overlap: so many are independent.
        number = good.sum() / window**2
        count = next(n for n, least in _SCALE_TERMS if number >= least)
        half_freedom = lines.freedom[plane][good] / 2
        logarithm = np.log(lines.misfit[plane][good] / 2) - digamma(half_freedom)
        deviation = np.sqrt(polygamma(1, half_freedom))
        columns = design[good][:, :count]
        use = logarithm < np.quantile(logarithm, _MOST_EDGES) + 1 if good.any() else []
        for limit in _LIMITS if good.any() else ():
            fitted = np.linalg.lstsq(columns[use], logarithm[use], rcond=None)[0]
            use = np.abs(logarithm - columns @ fitted) < limit * deviation
            terms[plane][:count] = fitted
    return NoiseScale(field=field, terms=terms)


def _fit_water(scan: Observation, lines: _Lines, window: int) -> SmoothWater:
    """Fit a smooth water signal to the offsets of lines without sign of an edge."""
    azimuth, elevation = _centers(scan, window)
    probability = chdtrc(np.maximum(lines.freedom, 1.0), lines.misfit)
    offsets, sizes = [], []
    for plane in np.ndindex(lines.misfit.shape[:2]):
        good = np.isfinite(lines.covariance[plane][..., 0, 0])
        good &= (probability[plane] > _RARE) & (lines.edge[plane] < _WATER_EDGE)
        good &= lines.smooth[plane]
        offsets.append(
            Offsets(
                phase=lines.phase[plane][..., 0],
                offset=lines.offset[plane],
                terms=lines.offset_terms[plane],
                good=good,
            )
        )
        bright = np.abs(scan.signal[plane][scan.usable[plane]])
        strong = np.quantile(bright, _STRONG) if bright.size else 1.0
        sizes.append(float(strong))
    return fit_smooth_water(
        offsets,
        sizes,
        azimuth=azimuth,
        elevation=elevation,
        planes=lines.misfit.shape[:2],
        window=window,
    )


def _errors_of(
    scan: Observation, fluctuation: NoiseScale, stated: Floats
) -> Covariance:
    """Return the errors of the samples by stated errors and fluctuation."""
    ratio = fluctuation.at(scan.azimuth, scan.elevation) - 1
    extra = ratio * stated
    return scan.covariance + Covariance(extra, extra, 0 * extra)


def _fit_scan(scan: Observation, window: int) -> PhasorLinesFit:
    """Fit noise and water to the lines of a scan."""
    errors, usable = scan.covariance, scan.usable
    weight = np.where(usable, 2 / (errors.in_phase + errors.quadrature), 0.0)
    count = np.maximum(usable.sum(axis=(2, 3), keepdims=True), 1)
    stated = count / np.maximum(weight.sum(axis=(2, 3), keepdims=True), _TINY)
    centers = _centers(scan, window)
    lines = _fit_windows(scan, errors, window)
    fluctuation = _noise_scale(lines, *centers, window)
    lines = _fit_windows(scan, _errors_of(scan, fluctuation, stated), window)
    noise_scale = _noise_scale(lines, *centers, window)
    lines.scale(noise_scale.at(*centers))
    if not (lines.covariance[..., 0, 0] < _LARGEST_ERROR**2).any():
        raise CubeError(
            f"the reflectance does not vary within {window} x {window} pixels, or by "
            "less than noise hides, so that no line gives the phase of the target; "
            "record open water (--method open-water), or use --method joint"
        )
    tested = np.isfinite(lines.coherence[0, 0])
    edges = ~lines.smooth[0, 0][tested]
    water = _fit_water(scan, lines, window)
    signal, unsure = water.before(scan.signal, scan.azimuth, scan.elevation)
    target = scan.signal - signal
    along = unsure.turned(np.exp(-1j * np.angle(target))).in_phase
    by_water = np.zeros(stated.shape, dtype=bool)
    for plane in np.ndindex(stated.shape[:2]):
        amplitude = np.abs(target[plane][usable[plane]])
        if amplitude.size:
            error = np.sqrt(along[plane][usable[plane]])
            sure = error < _SURE_WATER * np.median(amplitude)
            by_water[plane] = sure.mean() > _SURE_PIXELS
            by_water[plane] &= water.misfit[plane] < _LARGEST_MISFIT
    return PhasorLinesFit(
        fluctuation=fluctuation,
        stated=stated,
        noise_scale=noise_scale,
        water=water,
        by_water=by_water,
        has_edges=bool(edges.any() and edges.mean() > _MOST_EDGES),
        terms=(),
    )


def _centers(scan: Observation, window: int) -> tuple[Floats, Floats]:
    """Return azimuth and elevation of the centers of the windows [rad]."""
    inside = slice(window // 2, -(window // 2))
    return scan.azimuth[inside, inside], scan.elevation[inside, inside]


def _follow(
    cube: xr.Dataset, *, window: int, fit: PhasorLinesFit | None = None
) -> tuple[xr.Dataset, PhasorLinesFit]:
    """Follow the lines of a scan or, with `fit`, of rows; return also the fit."""
    scan = Observation(cube=cubes.checked(cube, "samples"))
    selected = None if fit is None else fit.terms
    fit = fit or _fit_scan(scan, window)
    errors = _errors_of(scan, fit.fluctuation, fit.stated)
    total = errors.scaled(fit.noise_scale.at(scan.azimuth, scan.elevation))
    water, common = fit.water.before(scan.signal, scan.azimuth, scan.elevation)
    target = scan.signal - water
    turn = np.exp(1j * np.angle(target))
    # The amplitude that divides the noise across the target is uncertain, too.
    unsure = common.turned(turn.conj()).in_phase
    unsure /= np.maximum(np.abs(target) ** 2, _TINY)
    noise = total.scaled(1 + 3 * np.minimum(unsure, 1.0))
    doubtful = np.zeros(scan.signal.shape, dtype=np.int8)
    if not fit.by_water.all():
        lines = _fit_windows(scan, errors, window)
        lines.scale(fit.noise_scale.at(*_centers(scan, window)))
        windows = _directions(lines, scan.frequency, window)
        line = np.exp(1j * windows.phase)
        sure = windows.variance < _LARGEST_ERROR**2
        across = np.abs(scan.signal) ** 2 * np.where(sure, windows.variance, 1.0)
        along = total.turned(line.conj()).in_phase
        of_line = Covariance(along, across, 0 * along).turned(line)
        target = np.where(fit.by_water, target, np.abs(scan.signal) * line)
        turn = np.where(fit.by_water, turn, line)
        noise = noise.where(fit.by_water, of_line)
        common = common.where(fit.by_water, common.scaled(0.0))
        misfit = windows.doubtful | _brightness_steps(scan, window)
        misfit = (misfit | fit.has_edges) & ~fit.by_water
        doubtful = np.where(misfit, WaterResidualCause.MODEL_MISFIT, 0).astype(np.int8)
    counting = scan.covariance.turned(turn.conj()).quadrature
    counting = counting / total.turned(turn.conj()).quadrature
    terms = present_terms(
        {
            "counting": noise.scaled(counting),
            "fluctuation": noise.scaled(1 - counting),
            "reference": common,
        },
        selected,
    )
    target = np.where(np.isfinite(scan.signal), target, np.nan)
    windowed: dict[str, Any] = {}
    if not fit.by_water.all():
        windowed["phasor_line_window"] = np.int32(window)
    result = target_cube(
        scan.cube,
        target,
        noise + common,
        common=common,
        water_signal=scan.signal - target,
        terms=terms,
        step=f"reject, phasor lines in windows of {window} x {window} pixels",
        frequencies_share_errors=np.int32(0),
        **windowed,
    )
    result = quality.add_water_residual(result, doubtful)
    return result, replace(fit, terms=tuple(terms))


def _checked_window(window: float, rows: int, columns: int) -> int:
    """Return the width of the windows; errors if it is odd or larger than the scan."""
    width = int(window)
    if width != window or width < _SMALLEST or not width % 2:
        raise ValueError(
            f"window must be an odd number of pixels from {_SMALLEST} on, got "
            f"{window:g}"
        )
    if min(rows, columns) < width:
        raise CubeError(
            f"the scan has {rows} x {columns} pixels, but phasor lines need windows of "
            f"{width} x {width}; scan more rows and columns, or use another method"
        )
    return width


def _fitter(source: tiles.Source, *, window: float = 5) -> tiles.OfRows:
    """Fit the method to a scan; rows are read with their neighbors."""
    width = _checked_window(window, source.rows, source.columns)
    sample = cubes.without_groups(tiles.sample_of(source), "truth")
    _, fit = _follow(sample, window=width)

    def of(rows: xr.Dataset, first: int) -> xr.Dataset:
        count = rows.sizes["row"]
        begin = max(0, first - width + 1)
        end = min(source.rows, first + count + width - 1)
        wide, _ = _follow(source.tile(begin, end), window=width, fit=fit)
        return wide.isel(row=slice(first - begin, first - begin + count))

    return of


@method("phasor-lines", fitter=_fitter)
def phasor_lines(cube: xr.Dataset, *, window: int = 5) -> xr.Dataset:
    r"""Estimate the phase of the target from neighbors of different reflectance.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`. Neither open-water shots nor a survey of the water is needed.
    window : int
        Width of the square windows in which a surface is taken as a plane and its
        reflectance must vary, odd [pixels].

    Returns
    -------
    xarray.Dataset
        Level `target_signal`:

        - If the targets of the scan have different phases, the lines give the water
          signal. It is subtracted from each pixel. Its error is common to all pixels.
        - Otherwise the phase is the direction of the line in the best window that
          contains the pixel, and the amplitude is that of the sample. Neighbors share
          windows, so their errors are correlated (`phasor_line_window`).
        - `NO_TARGET`: the signal is not significant, or no window with this pixel has
          enough contrast.
        - `WATER_RESIDUAL` with the cause `MODEL_MISFIT`, for phases of windows: the
          samples of all windows with this pixel contradict a line, their residuals are
          alike at several frequencies or channels, or the brightness has a step near
          the pixel, as at the edge of an object.

    Raises
    ------
    CubeError
        If the reflectance does not vary anywhere, or the scan is smaller than a window.
    ValueError
        If the window is even, or has fewer than five pixels.

    Notes
    -----
    Pixels of one distance and different reflectance a lie on a line in the plane of
    both outputs [1]_, :math:`S_i = W + a_i e^{i\varphi}`: a difference of two samples
    has the phase of the target, whatever the water signal W is. In a window W may
    change as a quadratic polynomial of row and column, and :math:`\varphi` linearly.
    The fit minimizes the squared distances from the line,

    .. math:: \sum_i \frac{\operatorname{Im}^2 [(S_i - W_i) e^{-i\varphi_i}]}
        {\sigma_i^2},

    with errors of both coordinates. Two samples give the phase with an error of
    :math:`\sqrt 2 a_1 / (a_1 - a_2)` times that of the brighter sample in known water.
    The line has two directions. In the right one, samples become brighter on average.
    This fails if the water signal exceeds that of the target with opposite phase.

    A step or a sharp curve of the surface within a window leaves residuals that are
    alike at all frequencies and channels. Those of noise are independent. The sum of
    their correlations must be below 2.5 standard errors. Windows that fail give neither
    the noise nor the water signal. If most windows fail, all pixels are flagged. One
    frequency of one channel has no such test.

    All lines of a direction contain the water signal. Lines of different directions
    intersect in it. The water signal is fitted to them as a polynomial of degree 4 of
    the direction, with errors of both offset and phase, and with less weight for lines
    that miss it. Its phase-dependent term is the water next to the target. The water
    signal is used if its uncertainty is at most a tenth of the target.

    References
    ----------
    .. [1] T. Muraji et al., Opt. Express 27, 18858 (2019), :doi:`10.1364/OE.27.018858`.

    Examples
    --------
    Random dark spots on the staircase of a sample scan. The water turns its phases.

    >>> import numpy as np
    >>> from amulor import rejection, samples
    >>> cube = samples.cube("ladder").isel(row=slice(14, 22), column=slice(30, 70))
    >>> spots = 0.7 * np.random.default_rng(1).integers(0, 2, cube["azimuth"].shape)
    >>> echo = cube["truth_target_in_phase"] + 1j * cube["truth_target_quadrature"]
    >>> for name in ("in_phase", "quadrature"):
    ...     cube[name] -= spots * cube[f"truth_target_{name}"]
    >>> for signal in (cube, rejection.phasor_lines(cube)):
    ...     turn = np.angle(signal.amulor.signal.values * echo.conj().values)
    ...     print(f"{1e3 * np.median(np.abs(turn)):.0f} mrad off")
    114 mrad off
    7 mrad off
    """
    source = tiles.InMemory(cube)
    width = _checked_window(window, source.rows, source.columns)
    return _follow(cube, window=width)[0]
