"""The water signal from open-water shots: a smooth surface over the scan directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance
from amulor.rejection.reference import interpolation

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Highest degree of the polynomial over azimuth and elevation.
_HIGHEST_DEGREE = 4
#: A degree fits when its misfit is no larger than chance makes in 1 of 20 cases.
_SIGNIFICANCE = 0.05
#: Shots beyond the coefficients of the polynomial, to judge how much they scatter.
_FREEDOM = 4
#: A constant, and enough shots to judge it.
FEWEST_SHOTS = 1 + _FREEDOM
#: Pixels at which the polynomial is evaluated at once; this bounds the memory.
_AT_ONCE = 16_384


@dataclass(frozen=True)
class Drift:
    """Relative change of the water signal from the first to the last shot."""

    change: complex
    """Change, radial + 1j * tangential, per unit of the water signal [1]."""
    uncertainty: complex
    """Standard uncertainty of its two parts, likewise [1]."""
    chance: float
    """Probability that steady water shows as much [1]."""


#: What shots tell that cannot be compared with each other.
NO_DRIFT = Drift(0j, complex(np.inf, np.inf), 1.0)


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Water signal at each pixel, and how well it is known."""

    signal: Complex
    """Expected water signal [V]."""
    common: Covariance
    """Error of that expectation: the pixels share it."""
    relative: NDArray[np.float64]
    """(Radial, tangential) covariance of one sample, per squared signal [1]."""
    degree: int
    """Degree of the polynomial over the scan directions."""
    drift: Drift
    """What changed from the first shot to the last."""


def fit(
    shots: Complex,
    instrument: Covariance,
    shot_direction: Floats,
    pixel_direction: Floats,
) -> Reference:
    """Fit the open-water shots of one channel and evaluate the fit at the pixels.

    Parameters
    ----------
    shots : ndarray of complex, shape (n,)
        Samples without a target [V].
    instrument : Covariance
        Their stated errors.
    shot_direction : ndarray, shape (n, 2)
        Azimuth and elevation of the shots; all equal if they are not known [rad].
    pixel_direction : ndarray, shape (m, 2)
        Azimuth and elevation of the pixels [rad].

    Returns
    -------
    Reference
        Arrays over the m pixels.

    Raises
    ------
    ValueError
        If there are fewer than `FEWEST_SHOTS`.

    Notes
    -----
    Least squares of a polynomial, one degree above the lowest whose misfit, against
    the scatter of repeated shots, passes an F test: a misfit that the test does not
    see is as large as the error itself, and the next degree takes most of it. What
    the shots scatter beyond their stated error is a fluctuation of the water, taken as
    proportional to its signal. How far the polynomial may be off between the shots is
    told by a second one through their logarithms: the difference of the two counts as
    a standard error, see `interpolation.disagreement`.
    """
    if len(shots) < FEWEST_SHOTS:
        raise ValueError(f"a reference needs {FEWEST_SHOTS} shots, got {len(shots)}")
    centre, scale = _frame(shot_direction)
    where = (shot_direction - centre) / scale
    powers = _powers(where)
    weight = np.ones(len(shots))
    for _ in range(2):
        degree = _choose_degree(shots, where, powers, weight)
        chosen = powers[powers.sum(axis=1) <= degree]
        design = _design(where, chosen)
        gain = np.linalg.pinv(design * np.sqrt(weight)[:, None]) * np.sqrt(weight)
        coefficients = gain @ shots
        level = design @ coefficients
        relative = _relative_fluctuation(
            shots, level, instrument, freedom=len(shots) - len(chosen)
        )
        spread = fluctuation(relative, level)
        total = instrument + spread
        variance = total.in_phase + total.quadrature
        # Channels that see nothing at all have no error either: all shots alike.
        weight = np.ones(len(shots)) if variance.min() == 0 else 2 / variance
    # Few shots tell their own scatter badly: Student's variance instead of the normal.
    freedom = len(shots) - len(chosen)
    unsure = freedom / (freedom - 1)
    spreads = [
        unsure * (gain * part) @ gain.T
        for part in (total.in_phase, total.quadrature, total.cross)
    ]
    second = _logarithmic(shots, variance, where, chosen)
    along = np.zeros(len(chosen), dtype=complex) if second is None else second[0]
    # One product of real matrices for all: coefficients, logarithms, covariances.
    table = np.hstack(
        [
            coefficients.real[:, None],
            coefficients.imag[:, None],
            along.real[:, None],
            along.imag[:, None],
            *spreads,
        ]
    )
    signal = np.empty(len(pixel_direction), dtype=complex)
    common = [np.empty(len(pixel_direction)) for _ in spreads]
    for first in range(0, len(pixel_direction), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        at_pixels = _design((pixel_direction[part] - centre) / scale, chosen)
        product = at_pixels @ table
        signal[part] = product[:, 0] + 1j * product[:, 1]
        sides = product[:, 4:].reshape(len(at_pixels), len(spreads), -1)
        for k, values in enumerate(common):
            values[part] = np.einsum("ij,ij->i", sides[:, k], at_pixels)
        if second is not None:
            off = interpolation.disagreement(
                signal[part], product[:, 2] + 1j * product[:, 3], second[1]
            )
            common[0][part] += off.real**2
            common[1][part] += off.imag**2
            common[2][part] += off.real * off.imag
    return Reference(
        signal=signal,
        common=Covariance(*common),
        relative=relative * unsure,
        degree=int(degree),
        drift=_drift(shots, level, where),
    )


def noiseless(
    signal: Complex, repeats: int, shot_direction: Floats, pixel_direction: Floats
) -> Complex:
    """Return what the polynomial of the highest degree makes of shots without noise.

    Parameters
    ----------
    signal : ndarray of complex, shape (k, n)
        Water signals at the directions of the shots [V].
    repeats : int
        Shots in each direction.
    shot_direction : ndarray, shape (n, 2)
        Azimuth and elevation of the shots [rad].
    pixel_direction : ndarray, shape (m, 2)
        Azimuth and elevation of the pixels [rad].

    Returns
    -------
    ndarray of complex, shape (k, m)
        The polynomials at the pixels [V].
    """
    centre, scale = _frame(shot_direction)
    where = (shot_direction - centre) / scale
    powers = _powers(where)
    order = powers.sum(axis=1)
    shots = repeats * len(where)
    highest = max(d for d in range(int(order.max()) + 1) if _fits(order, d, shots))
    chosen = powers[order <= highest]
    coefficients = np.linalg.lstsq(_design(where, chosen), signal.T, rcond=None)[0]
    at_pixels = _design((pixel_direction - centre) / scale, chosen)
    return np.asarray((at_pixels @ coefficients).T)


def _logarithmic(
    shots: Complex, variance: Floats, where: Floats, powers: NDArray[np.intp]
) -> tuple[Complex, complex] | None:
    """Return the polynomial of the logarithms, and what they are relative to."""
    places, group = np.unique(np.round(where, 9), axis=0, return_inverse=True)
    if len(places) < max(2, len(powers)):
        return None
    found = interpolation.logarithms(shots, variance, group.ravel())
    if found is None:
        return None
    design = _design(places, powers)
    coefficients = np.linalg.lstsq(design, found[0], rcond=None)[0]
    return np.asarray(coefficients, dtype=np.complex128), found[1]


def _drift(shots: Complex, level: Complex, where: Floats) -> Drift:
    """Return how the shots of the same direction change with their order.

    A straight line over the order, each direction with a mean of its own: what the
    polynomial over the directions misses is no drift. Directions that are repeated
    first and last tell it well, repeats in a row badly, single shots not at all.
    """
    from scipy.stats import t as student

    _, group, size = np.unique(
        np.round(where, 9), axis=0, return_inverse=True, return_counts=True
    )
    group = group.ravel()

    def own_of(values: Floats) -> Floats:
        mean: Floats = np.bincount(group, values) / size
        return values - mean[group]

    freedom = len(shots) - len(size) - 1
    order = own_of(np.linspace(-0.5, 0.5, len(shots)))
    square = float(order @ order)
    if freedom < 1 or np.abs(level).min() == 0 or square < 1e-9 * len(shots):
        return NO_DRIFT
    relative = (shots - level) / level
    parts, errors, chances = [], [], []
    for values in (relative.real, relative.imag):
        slope = float(order @ values) / square
        rest = own_of(values) - slope * order
        error = float(np.sqrt(rest @ rest / freedom / square))
        parts.append(slope)
        errors.append(error)
        steady = 1.0 if slope == 0 else 0.0
        chances.append(
            2 * float(student.sf(abs(slope) / error, freedom)) if error > 0 else steady
        )
    # Either part may show it: the smaller chance of two.
    chance = min(1.0, 2 * min(chances))
    return Drift(complex(*parts), complex(*errors), chance)


def _frame(direction: Floats) -> tuple[Floats, Floats]:
    """Return centre and half span, so that the polynomial works on -1 to 1."""
    low, high = direction.min(axis=0), direction.max(axis=0)
    span = np.where(high > low, (high - low) / 2, 1.0)
    return (low + high) / 2, span


def _powers(where: Floats) -> NDArray[np.intp]:
    """Return the exponents that the directions can tell apart."""
    distinct = [len(np.unique(np.round(column, 9))) for column in where.T]
    return np.array(
        [
            (i, j)
            for i in range(min(distinct[0], _HIGHEST_DEGREE + 1))
            for j in range(min(distinct[1], _HIGHEST_DEGREE + 1))
            if i + j <= _HIGHEST_DEGREE
        ]
    )


def _design(where: Floats, powers: NDArray[np.intp]) -> Floats:
    # Powers by repeated products: a general power costs ten times as much.
    tables = []
    for axis, highest in zip(where.T, powers.max(axis=0), strict=True):
        table = np.ones((int(highest) + 1, len(axis)))
        for power in range(1, int(highest) + 1):
            table[power] = table[power - 1] * axis
        tables.append(table)
    columns: Floats = (tables[0][powers[:, 0]] * tables[1][powers[:, 1]]).T
    return np.ascontiguousarray(columns)


def _choose_degree(
    shots: Complex, where: Floats, powers: NDArray[np.intp], weight: Floats
) -> int:
    from scipy.stats import f as f_distribution

    _, group, size = np.unique(
        np.round(where, 9), axis=0, return_inverse=True, return_counts=True
    )
    group = group.ravel()
    groups = len(size)
    repeats = len(shots) - groups
    order = powers.sum(axis=1)
    highest = max(d for d in range(int(order.max()) + 1) if _fits(order, d, len(shots)))
    if repeats < 1 or groups == 1:
        return min(highest, 2) if groups > 1 else 0
    weight_of = np.bincount(group, weight)
    mean = (
        np.bincount(group, weight * shots.real)
        + 1j * np.bincount(group, weight * shots.imag)
    ) / weight_of
    pure = np.sum(weight * np.abs(shots - mean[group]) ** 2) / repeats
    for degree in range(highest + 1):
        design = _design(where, powers[powers.sum(axis=1) <= degree])
        freedom = groups - design.shape[1]
        if freedom < 1 or pure == 0:
            return degree
        root = np.sqrt(weight)
        coefficients = np.linalg.lstsq(
            design * root[:, None], shots * root, rcond=None
        )[0]
        misfit = np.sum(weight * np.abs(mean[group] - design @ coefficients) ** 2)
        # The two outputs double the degrees of freedom above and below the line.
        chance = f_distribution.sf(misfit / freedom / pure, 2 * freedom, 2 * repeats)
        if chance > _SIGNIFICANCE:
            return min(degree + 1, highest)
    return highest


def _fits(order: NDArray[np.intp], degree: int, shots: int) -> bool:
    return degree == 0 or shots - int(np.sum(order <= degree)) >= _FREEDOM


def _relative_fluctuation(
    shots: Complex, level: Complex, instrument: Covariance, *, freedom: int
) -> NDArray[np.float64]:
    """Return the covariance of (radial, tangential) changes per unit of water signal.

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
    stated = np.array([[radial, crossed], [crossed, tangential]]).sum(axis=2)
    excess = (parts @ parts.T * len(shots) / freedom - stated) / power
    values, vectors = np.linalg.eigh(excess)
    kept: NDArray[np.float64] = (vectors * np.maximum(values, 0)) @ vectors.T
    return kept


def fluctuation(relative: NDArray[np.float64], level: Complex) -> Covariance:
    """Turn a relative covariance into one of the outputs at a given water signal.

    Parameters
    ----------
    relative : ndarray, shape (2, 2)
        Covariance of radial and tangential changes per squared signal [1].
    level : ndarray of complex
        Water signal [V].

    Returns
    -------
    Covariance
        Arrays of the shape of the signal.
    """
    a, b = level.real, level.imag
    radial, crossed, tangential = relative[0, 0], relative[0, 1], relative[1, 1]
    return Covariance(
        radial * a**2 + tangential * b**2 - 2 * crossed * a * b,
        radial * b**2 + tangential * a**2 + 2 * crossed * a * b,
        (radial - tangential) * a * b + crossed * (a**2 - b**2),
    )
