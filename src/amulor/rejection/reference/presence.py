"""Target detection: test against open water, full or truncated at a depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.cube.tiles import Span
from amulor.rejection.covariance import Covariance, along, isotropic
from amulor.rejection.observation import Observation
from amulor.rejection.reference import column as columns
from amulor.rejection.reference.before_target import WaterBeforeTarget
from amulor.rejection.reference.shots import fluctuation_of
from amulor.survey import Survey, water_properties

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Empty water passes for a target with this probability, for normal errors [1].
SIZE = 1e-5
#: Relative standard deviation by which open water may depart from the shots [1].
DEPARTURE = 0.05
#: Steps of the depth at which the water may end, in a period of the highest frequency.
_PER_PERIOD = 12
#: Error of the model of a truncated column, relative to the open-water signal [1].
MODEL_ERROR = 0.02
#: Largest depth at which the water may end, in lengths of 1 / k' [1].
_DEEPEST = 8.0
#: Directions along each side of the scan at which truncated columns are computed.
_DIRECTIONS = 5
#: Angles that differ by less count as equal [rad].
_ONE = 1e-9
#: Pixels worked on at once: this bounds the memory.
_AT_ONCE = 8192


def shows_target(
    scan: Observation,
    water: WaterBeforeTarget,
    *,
    interval: tuple[float, float] | None,
    fit: CutColumns | None = None,
) -> tuple[NDArray[np.bool_], CutColumns | None, Floats]:
    """Detect targets; return mask, truncated columns and no-target probabilities.

    False where the samples agree with the open-water signal of the shots, within a few
    times `DEPARTURE`, or with a column truncated by a dark object (a shadow, a black
    surface). The truncated columns are `fit` if given, and None without a survey. The
    probabilities are p-values of chi-square for open water, NaN for a target.

    The hypothesis "no target" is tested before any column is added back: the
    smallest chi-square over the depths at which the water may end, with a common
    factor of the water that has the standard deviation `DEPARTURE`, against twice
    as many degrees of freedom as there are samples. If it is true, it is rejected
    in a fraction of at most `SIZE` of the pixels. Errors are those of the samples
    and of the reference, the fluctuation and the drift of the whole column.
    Truncated columns are computed from the survey, with the turbidity estimated
    from the shots; without a survey, only the full column is tested.
    """
    from scipy.special import chdtrc, chdtri

    open_water = water.to_the_end
    frequencies, channels, *shape = open_water.shape
    errors = scan.covariance + water.common + fluctuation_of(water.fits, open_water)
    saturated = scan.saturated
    turbidity = water.estimated_turbidity
    cut, span = fit, water.fit.shots.span
    if cut is None and turbidity is not None:
        cut = _cut_columns(
            turbidity.survey, scan.frequency, interval, span, paper=turbidity.paper
        )
    up = _places(scan.elevation, *span.elevation)
    across = _places(scan.azimuth, *span.azimuth)
    largest = None if cut is None else np.abs(cut.smooth).max(axis=(1, 2, 3))
    which = np.repeat(np.arange(frequencies), channels)

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        return values.reshape(frequencies * channels, -1)

    difference, column = flat(water.difference), flat(open_water)
    drift = flat(water.drift)
    parts = [flat(part) for part in (errors.in_phase, errors.quadrature, errors.cross)]
    model_error = (
        0.0 if turbidity is None else float(np.hypot(turbidity.shown, MODEL_ERROR))
    )
    has_target = np.zeros(difference.shape[1], dtype=bool)
    chance = np.full(has_target.size, np.nan)
    for first in range(0, has_target.size, _AT_ONCE):
        chosen = slice(first, first + _AT_ONCE)
        problem = _problem(
            difference[:, chosen],
            column[:, chosen],
            Covariance(*(part[:, chosen] for part in parts))
            + along(drift * column[:, chosen], 12**-0.5),
            which,
            None if saturated is None else flat(saturated)[:, chosen],
        )
        limit = chdtri(2 * np.arange(len(which) + 1), SIZE)[problem.count]
        lowest = problem.misfit(np.zeros((1, 1)))
        is_target = (lowest > limit) & (problem.count > 0)
        if cut is not None and largest is not None:
            open_to_doubt = is_target & ~(problem.surely_more_than(largest) > limit)
            some = np.flatnonzero(open_to_doubt)
            if some.size:
                few = _problem(
                    difference[:, first + some],
                    column[:, first + some],
                    Covariance(*(part[:, first + some] for part in parts))
                    + along(drift * column[:, first + some], 12**-0.5)
                    + isotropic(model_error * np.abs(column[:, first + some])),
                    which,
                    None if saturated is None else flat(saturated)[:, first + some],
                )
                lowest[some] = cut.lowest(few, up[first + some], across[first + some])
                is_target[some] = lowest[some] > limit[some]
        has_target[chosen] = is_target
        chance[chosen] = np.where(is_target, np.nan, chdtrc(2 * problem.count, lowest))
    return has_target.reshape(shape), cut, chance.reshape(shape)


def _problem(
    difference: Complex,
    water: Complex,
    errors: Covariance,
    frequency: NDArray[np.intp],
    saturated: NDArray[np.bool_] | None,
) -> _Problem:
    """Combine samples and inverse covariances, both 0 for unusable samples."""
    determinant = errors.in_phase * errors.quadrature - errors.cross**2
    use = np.isfinite(difference) & np.isfinite(water) & (determinant > 0)
    if saturated is not None:
        use &= ~saturated
    scale = np.divide(1.0, determinant, out=np.zeros(difference.shape), where=use)
    return _Problem(
        difference=np.where(use, difference, 0),
        water=np.where(use, water, 0),
        in_phase=scale * errors.quadrature,
        quadrature=scale * errors.in_phase,
        cross=-scale * errors.cross,
        frequency=frequency,
    )


@dataclass(frozen=True, kw_only=True)
class _Problem:
    """Samples of many pixels for the target test, arrays over (sample, pixel)."""

    difference: Complex
    """Samples less the open-water signal, 0 where a sample is unusable [V]."""
    water: Complex
    """Open-water signal, 0 where a sample is unusable [V]."""
    in_phase: Floats
    """Elements of the inverse covariances, 0 where a sample is unusable [1/V^2]."""
    quadrature: Floats
    cross: Floats
    frequency: NDArray[np.intp]
    """Index of the modulation frequency of each sample."""

    @property
    def count(self) -> NDArray[np.intp]:
        """Number of usable samples of each pixel."""
        return np.asarray((self.in_phase > 0).sum(axis=0))

    def misfit(self, fractions: Complex | Floats) -> Floats:
        """Return chi-square of open water with a fraction of the column removed.

        `fractions` are over (frequency, pixel), or one for all.
        """
        hidden = fractions if fractions.size == 1 else fractions[self.frequency]
        rest = self.difference + hidden * self.water
        front = self.water - hidden * self.water
        along_front = self._product(front, rest)
        power = self._product(front, front) + DEPARTURE**-2
        misfit: Floats = self._product(rest, rest) - along_front**2 / power
        return misfit

    def surely_more_than(self, fractions: Floats) -> Floats:
        """Return a lower bound of chi-square over removed fractions up to limits."""
        # The water in front of a cut may depart by five times the expected departure.
        allowed = fractions[self.frequency][:, None] + 5 * DEPARTURE
        free = np.maximum(np.abs(self.difference) - allowed * np.abs(self.water), 0.0)
        # The smallest eigenvalue of the inverse covariance.
        mean = (self.in_phase + self.quadrature) / 2
        spread = np.hypot((self.in_phase - self.quadrature) / 2, self.cross)
        total: Floats = np.sum((mean - spread) * free**2, axis=0)
        return total

    def _product(self, first: Complex, second: Complex) -> Floats:
        product = (
            self.in_phase * first.real * second.real
            + self.quadrature * first.imag * second.imag
            + self.cross * (first.real * second.imag + first.imag * second.real)
        )
        summed: Floats = product.sum(axis=0)
        return summed


@dataclass(frozen=True, kw_only=True)
class CutColumns:
    """Fractions of the open-water signal from beyond a depth, by direction."""

    smooth: Complex
    """Fractions divided by the phasor of their depth, shape (frequency, depth,
    elevation node, azimuth node) [1]."""
    depth: Floats
    """Depths of the nodes, evenly spaced [m]."""
    wavenumber: Floats
    """One-way phase per depth at each frequency [rad/m]."""

    def lowest(self, pixels: _Problem, up: Floats, across: Floats) -> Floats:
        """Return each pixel's smallest chi-square over the truncation depth.

        `up` and `across` are fractional node indices in elevation and azimuth.
        """
        i, u = _between(up, self.smooth.shape[2])
        j, v = _between(across, self.smooth.shape[3])
        last = self.smooth.shape[2] - 1, self.smooth.shape[3] - 1
        below, right = np.minimum(i + 1, last[0]), np.minimum(j + 1, last[1])
        smooth = (1 - u) * ((1 - v) * self.smooth[:, :, i, j])
        smooth += (1 - u) * (v * self.smooth[:, :, i, right])
        smooth += u * ((1 - v) * self.smooth[:, :, below, j])
        smooth += u * (v * self.smooth[:, :, below, right])
        pixel = np.arange(len(up))
        best = np.full(len(up), np.inf)
        place = np.zeros(len(up))

        def try_at(places: Floats) -> None:
            """Update the smallest chi-square for truncation between the depth nodes."""
            k, share = _between(places, smooth.shape[1])
            after = np.minimum(k + 1, smooth.shape[1] - 1)
            value = (1 - share) * smooth[:, k, pixel] + share * smooth[:, after, pixel]
            step = self.depth[1] - self.depth[0]
            turn = np.outer(2j * self.wavenumber, self.depth[0] + places * step)
            misfit = pixels.misfit(value * np.exp(turn))
            better = misfit < best
            best[better], place[better] = misfit[better], places[better]

        for node in range(smooth.shape[1]):
            try_at(np.full(len(up), float(node)))
        for width in (0.5, 0.125, 0.03125):
            centre = place.copy()
            for off in (-1.5, -1.0, -0.5, 0.5, 1.0, 1.5):
                try_at(np.clip(centre + off * width, 0.0, smooth.shape[1] - 1.0))
        return best


def _between(place: Floats, count: int) -> tuple[NDArray[np.intp], Floats]:
    first = np.clip(np.floor(place).astype(np.intp), 0, max(count - 2, 0))
    return first, place - first


def _cut_columns(
    survey: Survey,
    frequency: Floats,
    interval: tuple[float, float] | None,
    span: Span,
    *,
    paper: bool,
) -> CutColumns:
    """Compute the survey's table of open-water fractions from beyond each depth."""
    properties = water_properties(survey)
    nearest, farthest = (0.0, np.inf) if interval is None else interval
    loss = max(properties.reduced_attenuation, 1e-3)
    end = np.inf if survey.water.column_end is None else survey.water.column_end
    deepest = min(farthest, nearest + _DEEPEST / loss, end)
    period = speed_of_light / (2 * properties.group_index * frequency.max())
    count = int(np.ceil((deepest - nearest) / period * _PER_PERIOD)) + 2
    depth = np.linspace(nearest, max(deepest, nearest), count)
    elevation, azimuth = (_nodes(*ends) for ends in (span.elevation, span.azimuth))
    grid = np.meshgrid(depth, elevation, azimuth, indexing="ij")
    fractions = columns.fractions(
        survey,
        grid[2].ravel(),
        grid[1].ravel(),
        grid[0].ravel(),
        modulation_frequency=frequency,
        paper=paper,
    )
    wavenumber = 2 * np.pi * frequency * properties.group_index / speed_of_light
    turn = np.exp(-2j * np.outer(wavenumber, grid[0].ravel()))
    return CutColumns(
        smooth=(fractions * turn).reshape(frequency.size, *grid[0].shape),
        depth=depth,
        wavenumber=wavenumber,
    )


def _places(angle: Floats, low: float, high: float) -> Floats:
    """Convert the angles of pixels to fractional node indices [1]."""
    values = angle.ravel()
    if high - low < _ONE:
        return np.zeros(values.size)
    place: Floats = (values - low) / (high - low) * (_DIRECTIONS - 1)
    return place


def _nodes(low: float, high: float) -> Floats:
    """Return evenly spaced nodes over an interval, or one node if it is empty."""
    return np.linspace(low, high, _DIRECTIONS if high - low >= _ONE else 1)
