"""Polynomial fits of open-water references over direction, with their scatter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Highest degree of the polynomial over azimuth and elevation.
HIGHEST_DEGREE = 4
#: Shots beyond the coefficients of the polynomial, to judge how much they scatter.
FREEDOM = 4
#: A constant, and enough shots to judge it.
FEWEST_SHOTS = 1 + FREEDOM


@dataclass(frozen=True, kw_only=True)
class Places:
    """Directions of open-water references, scaled to -1 to 1, with repeats grouped."""

    centre: Floats
    """Middle of azimuth and elevation [rad]."""
    scale: Floats
    """Half spans of azimuth and elevation, 1 for a span of zero [rad]."""
    where: Floats
    """Scaled direction of every shot, shape (n, 2) [1]."""
    distinct: Floats
    """Scaled distinct directions, shape (groups, 2) [1]."""
    group: NDArray[np.intp]
    """Index of the distinct direction of every shot."""
    size: NDArray[np.intp]
    """Number of shots in every distinct direction."""
    powers: NDArray[np.intp]
    """Exponents of the polynomial terms determined by the directions, shape (terms,
    2)."""

    def scaled(self, direction: Floats) -> Floats:
        """Scale directions with the center and span of the references."""
        return np.asarray((direction - self.centre) / self.scale)

    def sum_of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the sums over the references of each direction."""
        if not np.iscomplexobj(values):
            return np.asarray(np.bincount(self.group, values))
        real, imaginary = (self.sum_of(part) for part in (values.real, values.imag))
        return np.asarray(real + 1j * imaginary)

    def mean_of(self, values: Complex) -> Complex:
        """Return the means over the references of each direction."""
        return np.asarray(self.sum_of(values) / self.size)

    def up_to(self, degree: int) -> NDArray[np.intp]:
        """Return the exponents of the polynomial terms up to a degree."""
        return np.asarray(self.powers[self.powers.sum(axis=1) <= degree])

    def highest(self, shots: int) -> int:
        """Return the highest degree with enough degrees of freedom for the scatter."""
        order = self.powers.sum(axis=1)
        return max(
            d
            for d in range(int(order.max()) + 1)
            if d == 0 or shots - int(np.sum(order <= d)) >= FREEDOM
        )


def places_of(direction: Floats) -> Places:
    """Return the scaled directions of references, cached for the channels of a cube."""
    return _cached_places(np.ascontiguousarray(direction).tobytes())


@lru_cache(maxsize=8)
def _cached_places(directions: bytes) -> Places:
    direction = np.frombuffer(directions).reshape(-1, 2)
    low, high = direction.min(axis=0), direction.max(axis=0)
    centre, scale = (low + high) / 2, np.where(high > low, (high - low) / 2, 1.0)
    where = (direction - centre) / scale
    distinct, group, size = np.unique(
        np.round(where, 9), axis=0, return_inverse=True, return_counts=True
    )
    count = [len(np.unique(np.round(column, 9))) for column in where.T]
    powers = np.array(
        [
            (i, j)
            for i in range(min(count[0], HIGHEST_DEGREE + 1))
            for j in range(min(count[1], HIGHEST_DEGREE + 1))
            if i + j <= HIGHEST_DEGREE
        ]
    )
    return Places(
        centre=centre,
        scale=scale,
        where=where,
        distinct=distinct,
        group=group.ravel(),
        size=size,
        powers=powers,
    )


def design_of(where: Floats, powers: NDArray[np.intp]) -> Floats:
    """Return the monomials at directions, shape (n, terms)."""
    # Powers by repeated products: a general power costs ten times as much.
    tables = []
    for axis, highest in zip(where.T, powers.max(axis=0), strict=True):
        table = np.ones((int(highest) + 1, len(axis)))
        for power in range(1, int(highest) + 1):
            table[power] = table[power - 1] * axis
        tables.append(table)
    columns: Floats = (tables[0][powers[:, 0]] * tables[1][powers[:, 1]]).T
    return np.ascontiguousarray(columns)


def relative_fluctuation(
    shots: Complex, level: Complex, instrument: Covariance, *, freedom: int
) -> NDArray[np.float64]:
    """Return the covariance of radial and tangential fluctuations of references.

    The stated instrument error is taken off; what is left is made a covariance again
    where chance drove it below zero. No water signal has no fluctuation.
    """
    size = np.abs(level)
    power = float(np.sum(size**2))
    if freedom < 1 or power == 0:
        return np.zeros((2, 2))
    turn = np.where(size > 0, level, 1) / np.where(size > 0, size, 1)
    rest = (shots - level) / turn
    c, s = turn.real, turn.imag
    radial = c**2 * instrument.in_phase + s**2 * instrument.quadrature
    radial = radial + 2 * c * s * instrument.cross
    tangential = s**2 * instrument.in_phase + c**2 * instrument.quadrature
    tangential = tangential - 2 * c * s * instrument.cross
    crossed = c * s * (instrument.quadrature - instrument.in_phase)
    crossed = crossed + (c**2 - s**2) * instrument.cross
    parts = np.stack([rest.real, rest.imag])
    nominal = np.array([[radial, crossed], [crossed, tangential]]).sum(axis=2)
    excess = (parts @ parts.T * len(shots) / freedom - nominal) / power
    values, vectors = np.linalg.eigh(excess)
    clipped: NDArray[np.float64] = (vectors * np.maximum(values, 0)) @ vectors.T
    return clipped


def fluctuation(relative: NDArray[np.float64], level: Complex) -> Covariance:
    """Return the output covariance of a relative fluctuation of a water signal."""
    a, b = level.real, level.imag
    radial, crossed, tangential = relative[0, 0], relative[0, 1], relative[1, 1]
    return Covariance(
        radial * a**2 + tangential * b**2 - 2 * crossed * a * b,
        radial * b**2 + tangential * a**2 + 2 * crossed * a * b,
        (radial - tangential) * a * b + crossed * (a**2 - b**2),
    )


#: The error of the first surface over its distance from the second, where that is
#: large. Unscattered light stands as a peak on the rest, so that the logarithm is no
#: polynomial either [1].
_BEYOND = 3.0
#: Distance from which on it is large, in parts of the signal [1].
_LARGE = 0.02
#: Least significance of a signal for a logarithm, in standard errors.
_SURE = 5.0


def logarithms(
    shots: Complex, variance: Floats, group: NDArray[np.intp]
) -> tuple[Complex, complex] | None:
    r"""Return ln of mean signals over a reference, and reference; None if undefined."""
    count = np.bincount(group)
    mean = (
        np.bincount(group, shots.real) + 1j * np.bincount(group, shots.imag)
    ) / count
    error = np.sqrt(np.bincount(group, variance)) / count
    if np.any(np.abs(mean) < _SURE * error) or np.any(mean == 0):
        return None
    middle = complex(mean.sum())
    if middle == 0:
        return None
    middle *= float(np.abs(mean).max()) / abs(middle)
    ratio = mean / middle
    if np.any(ratio.real <= 0):
        return None
    return np.log(ratio), middle


def disagreement(signal: Complex, logarithm: Complex, middle: complex) -> Complex:
    r"""Estimate the interpolation error from two surfaces fitted to the references.

    What a receiver with a Gaussian field of view sees falls off as a Gaussian of the
    direction, whose logarithm is a polynomial of the second degree, and which is none
    itself. Where the shots are dense enough both surfaces agree; where three rows
    stand for nineteen degrees their difference is of the size of the error of the
    interpolation, and up to three times less where light that was not scattered makes
    a peak.
    """
    # Beyond the shots a polynomial may run away: no farther than ten times the signal.
    bounded = np.minimum(logarithm.real, np.log(10.0)) + 1j * logarithm.imag
    difference: Complex = middle * np.exp(bounded) - signal
    size, amplitude = np.abs(difference), np.abs(signal)
    large = np.divide(
        size, _LARGE * amplitude, out=np.ones(size.shape), where=amplitude > 0
    )
    return np.asarray(difference * (1 + (_BEYOND - 1) * np.minimum(large, 1.0)))


#: A degree fits when its misfit is no larger than chance makes in 1 of 20 cases.
_SIGNIFICANCE = 0.05
#: The highest degree is refused where chance makes its misfit less often [1].
_REFUSED = 1e-3
#: A direction cannot be left out whose leverage is this near to 1 [1].
_ALONE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Polynomial fit of open-water references, or of their ratio to a model."""

    powers: NDArray[np.intp]
    """Exponents of the terms, shape (terms, 2)."""
    coefficients: Complex
    """Coefficients [V], relative to a model [1]."""
    spreads: list[Floats]
    """Covariances of the coefficients: in phase, quadrature, cross."""
    logarithm: tuple[Complex, complex] | None
    """Polynomial of the log signals, and the reference value."""
    relative: Floats
    """Covariance of the relative fluctuation (radial, tangential) [1]."""
    level: Complex
    """Water signal at the shots [V]."""
    cross_validation: float
    """Mean square cross-validation error, in units of the errors of the direction
    means [1]."""
    excess: float
    """Excess of the mean square residual over expectation, relative; 0 for a sufficient
    degree [1]."""


def surface_of(
    shots: Complex,
    instrument: Covariance,
    places: Places,
    *,
    noise: Covariance,
    model: Complex | None = None,
) -> Surface:
    """Fit a polynomial to the open-water references of one channel."""
    ratio = shots if model is None else shots / model
    power: Floats = np.ones(len(shots)) if model is None else np.abs(model) ** 2
    weight = np.ones(len(shots))
    for _ in range(2):
        degree, fits = _choose_degree(ratio, places, weight * power)
        powers = places.up_to(degree)
        design = design_of(places.where, powers)
        root = np.sqrt(weight * power)
        gain = np.asarray(np.linalg.pinv(design * root[:, None]) * root, dtype=float)
        coefficients = gain @ ratio
        level = design @ coefficients
        level = level if model is None else level * model
        freedom = len(shots) - len(powers)
        relative = relative_fluctuation(shots, level, instrument, freedom=freedom)
        total = instrument + fluctuation(relative, level)
        variance = total.in_phase + total.quadrature
        # Channels without any signal have no error either: all shots are equal.
        weight = np.ones(len(shots)) if variance.min() == 0 else 2 / variance
    # The scatter of few shots is uncertain: Student's variance, not the normal.
    unsure = freedom / (freedom - 1)
    if model is not None:
        total, variance = total.turned(1 / model), variance / power
    spreads = [
        unsure * (gain * part) @ gain.T
        for part in (total.in_phase, total.quadrature, total.cross)
    ]
    variances = noise.in_phase + noise.quadrature
    cross_validation, excess = _cross_validation(
        shots - level, variances, design, gain, places
    )
    while degree > 0 and _is_saturated(design, gain, places):
        # As many coefficients as directions foretell none: fewer of them do.
        degree -= 1
        design = design_of(places.where, places.up_to(degree))
        gain = np.asarray(np.linalg.pinv(design * root[:, None]) * root, dtype=float)
        rest = ratio - design @ (gain @ ratio)
        rest = rest if model is None else rest * model
        cross_validation, _ = _cross_validation(rest, variances, design, gain, places)
    return Surface(
        powers=powers,
        coefficients=coefficients,
        spreads=spreads,
        logarithm=_logarithmic(ratio, variance, places, powers),
        relative=relative * unsure,
        level=level,
        cross_validation=cross_validation,
        excess=0.0 if fits else excess,
    )


def noise_of(shots: Complex, instrument: Covariance, places: Places) -> Covariance:
    """Return the covariance of references about the mean of each direction."""
    mean = places.mean_of(shots)[places.group]
    relative = relative_fluctuation(
        shots, mean, instrument, freedom=len(shots) - len(places.size)
    )
    return instrument + fluctuation(relative, mean)


def _is_saturated(design: Floats, gain: Floats, places: Places) -> bool:
    """Return whether the polynomial passes exactly through one of the directions."""
    leverage = places.sum_of(np.einsum("ij,ji->i", design, gain))
    return bool(1 - leverage.max() <= _ALONE) and len(places.size) > 1


def _cross_validation(
    rest: Complex, variance: Floats, design: Floats, gain: Floats, places: Places
) -> tuple[float, float]:
    """Return cross-validation error and residual excess of a polynomial fit.

    Shots of one direction have one weight, so that leaving them out divides the rest of
    their mean by one less their leverage.
    """
    leverage = places.sum_of(np.einsum("ij,ji->i", design, gain))
    off = np.abs(places.mean_of(rest)) ** 2
    expected = places.sum_of(variance) / places.size**2
    alone = np.maximum(1 - leverage, _ALONE)
    if expected.min() <= 0:
        return float(np.sum(off / alone**2)), 0.0
    freedom = max(float(alone.sum()), _ALONE)
    excess = float(np.sum(off / expected)) / freedom - 1
    return float(np.mean(off / alone**2 / expected)), max(excess, 0.0)


def _logarithmic(
    ratio: Complex, variance: Floats, places: Places, powers: NDArray[np.intp]
) -> tuple[Complex, complex] | None:
    """Return polynomial of ln of the signal, and reference value; None if undefined."""
    if len(places.distinct) < max(2, len(powers)):
        return None
    means = logarithms(ratio, variance, places.group)
    if means is None:
        return None
    design = design_of(places.distinct, powers)
    coefficients = np.linalg.lstsq(design, means[0], rcond=None)[0]
    return np.asarray(coefficients, dtype=np.complex128), means[1]


def _choose_degree(shots: Complex, places: Places, weight: Floats) -> tuple[int, bool]:
    """Choose the degree by an F test; return also whether the fit is acceptable."""
    from scipy.special import fdtrc

    group, groups = places.group, len(places.size)
    repeats = len(shots) - groups
    highest = places.highest(len(shots))
    if repeats < 1 or groups == 1:
        return (min(highest, 2) if groups > 1 else 0), True
    mean = places.sum_of(weight * shots) / places.sum_of(weight)
    pure = np.sum(weight * np.abs(shots - mean[group]) ** 2) / repeats
    root = np.sqrt(weight)
    for degree in range(highest + 1):
        design = design_of(places.where, places.up_to(degree))
        freedom = groups - design.shape[1]
        if freedom < 1 or pure == 0:
            return degree, True
        coefficients = np.linalg.lstsq(
            design * root[:, None], shots * root, rcond=None
        )[0]
        misfit = np.sum(weight * np.abs(mean[group] - design @ coefficients) ** 2)
        # The two outputs double the degrees of freedom above and below the line.
        chance = float(fdtrc(2 * freedom, 2 * repeats, misfit / freedom / pure))
        if chance > _SIGNIFICANCE:
            return min(degree + 1, highest), True
    return highest, chance > _REFUSED


def noiseless(
    signal: Complex,
    repeats: int,
    shot_direction: Floats,
    pixel_direction: Floats,
    *,
    model: tuple[Complex, Complex] | None = None,
    degrees: list[int] | None = None,
) -> Complex:
    """Interpolate noiseless references to the pixels by a polynomial."""
    scaled = places_of(shot_direction).scaled(pixel_direction)
    result = np.empty((len(signal), len(pixel_direction)), dtype=complex)
    for k, values in enumerate(signal):
        at_shots = np.ones(len(values)) if model is None else model[0][k]
        degree = HIGHEST_DEGREE if degrees is None else degrees[k]
        design, powers = _polynomials(repeats, shot_direction, degree)
        coefficients = _gain(design, np.abs(at_shots)) @ (values / at_shots)
        result[k] = design_of(scaled, powers) @ coefficients
        if model is not None:
            result[k] *= model[1][k]
    return result


def cross_validation_errors(
    signal: Complex,
    repeats: int,
    direction: Floats,
    *,
    model: Complex | None = None,
    degrees: list[int] | None = None,
) -> Floats:
    """Return the polynomial's leave-one-out error at each direction."""
    if len(direction) == 1:
        return np.zeros(signal.shape)
    off = np.empty(signal.shape)
    for k, values in enumerate(signal):
        at_shots = np.ones(len(values)) if model is None else model[k]
        ratio = values / at_shots
        degree = HIGHEST_DEGREE if degrees is None else degrees[k]
        while True:
            design, _ = _polynomials(repeats, direction, degree)
            hat = design @ _gain(design, np.abs(at_shots))
            alone = 1 - np.diag(hat)
            if degree == 0 or alone.min() > _ALONE:
                break
            degree -= 1
        off[k] = np.abs(ratio - hat @ ratio) / alone * np.abs(at_shots)
    return off


def expected_degrees(
    signal: Complex,
    error: Floats,
    repeats: int,
    direction: Floats,
    *,
    model: Complex | None = None,
) -> list[int]:
    """Predict the polynomial degree chosen for planned references, by frequency."""
    from scipy.special import fdtri

    count = len(direction)
    highest = places_of(direction).highest(repeats * count)
    chosen = []
    for k, values in enumerate(signal):
        at_shots = np.ones(count) if model is None else model[k]
        ratio, weight = values / at_shots, np.abs(at_shots) / error[k]
        degree = 0
        while degree < highest:
            design, powers = _polynomials(repeats, direction, degree)
            freedom = count - len(powers)
            if freedom < 1 or repeats < 2:
                break
            rest = ratio - design @ (_gain(design, weight) @ ratio)
            misfit = repeats * np.sum(np.abs(weight * rest) ** 2) / freedom
            most = fdtri(2 * freedom, 2 * count * (repeats - 1), 1 - _SIGNIFICANCE)
            degree += 1
            if 1 + misfit <= most:
                break
        chosen.append(degree)
    return chosen


def _polynomials(
    repeats: int, direction: Floats, degree: int
) -> tuple[Floats, NDArray[np.intp]]:
    """Return the monomials up to a degree at directions, and their exponents."""
    places = places_of(direction)
    powers = places.up_to(min(degree, places.highest(repeats * len(direction))))
    return design_of(places.where, powers), powers


def _gain(design: Floats, weight: Floats) -> Floats:
    """Return the weighted least-squares solution matrix, (terms, n)."""
    gain = np.linalg.pinv(design * weight[:, None]) * weight
    return np.asarray(gain, dtype=float)
