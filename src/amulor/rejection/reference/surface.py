"""A smooth surface through open-water shots, or through their ratio to a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance
from amulor.rejection.reference import interpolation
from amulor.rejection.reference.places import Places, design_of, places_of
from amulor.rejection.reference.scatter import fluctuation, relative_fluctuation

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A degree fits when its misfit is no larger than chance makes in 1 of 20 cases.
_SIGNIFICANCE = 0.05
#: The highest degree is refused where chance makes its misfit less often [1].
_REFUSED = 1e-3
#: A direction cannot be left out whose leverage is this near to 1 [1].
_ALONE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Surface:
    """A polynomial through shots, or through their ratio to a model."""

    powers: NDArray[np.intp]
    """Its exponents, shape (terms, 2)."""
    coefficients: Complex
    """Its coefficients [V], or [1] relative to a model."""
    spreads: list[Floats]
    """Covariances of the coefficients: in phase, quadrature, cross."""
    logarithm: tuple[Complex, complex] | None
    """The polynomial of the logarithms, and what they are relative to."""
    relative: Floats
    """Covariance of one sample, per squared signal [1]."""
    level: Complex
    """Water signal at the shots [V]."""
    left_out: float
    """Mean square of what directions are off when they are left out, in units of the
    errors of their means [1]."""
    excess: float
    """Mean square of what directions are off the surface, in units of what their
    errors explain, less 1; 0 where a degree fits [1]."""


def surface_of(
    shots: Complex,
    instrument: Covariance,
    places: Places,
    *,
    noise: Covariance,
    model: Complex | None = None,
) -> Surface:
    """Fit the shots of one channel.

    Parameters
    ----------
    shots : ndarray of complex, shape (n,)
        Samples without a target [V].
    instrument : Covariance
        Their stated errors.
    places : Places
        Their directions.
    noise : Covariance
        How they scatter about the means of their directions, from `noise_of`.
    model : ndarray of complex, shape (n,), optional
        Water signal of a model, in any unit, nowhere zero: the polynomial stands for
        the ratio to it.

    Returns
    -------
    Surface
        Of the degree that `amulor.rejection.reference.fit.fit` explains.
    """
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
        # Channels that see nothing at all have no error either: all shots alike.
        weight = np.ones(len(shots)) if variance.min() == 0 else 2 / variance
    # Few shots tell their own scatter badly: Student's variance instead of the normal.
    unsure = freedom / (freedom - 1)
    if model is not None:
        total, variance = total.turned(1 / model), variance / power
    parts = (total.in_phase, total.quadrature, total.cross)
    left_out, excess = _left_out(
        shots - level, noise.in_phase + noise.quadrature, design, gain, places
    )
    return Surface(
        powers=powers,
        coefficients=coefficients,
        spreads=[unsure * (gain * part) @ gain.T for part in parts],
        logarithm=_logarithmic(ratio, variance, places, powers),
        relative=relative * unsure,
        level=level,
        left_out=left_out,
        excess=0.0 if fits else excess,
    )


def noise_of(shots: Complex, instrument: Covariance, places: Places) -> Covariance:
    """Return how shots scatter about the means of their directions.

    Parameters
    ----------
    shots : ndarray of complex, shape (n,)
        Samples without a target [V].
    instrument : Covariance
        Their stated errors.
    places : Places
        Their directions.

    Returns
    -------
    Covariance
        Stated errors and a fluctuation in proportion to the signal; the stated errors
        alone where no direction was repeated [V^2].
    """
    mean = places.mean_of(shots)[places.group]
    relative = relative_fluctuation(
        shots, mean, instrument, freedom=len(shots) - len(places.size)
    )
    return instrument + fluctuation(relative, mean)


def _left_out(
    rest: Complex, variance: Floats, design: Floats, gain: Floats, places: Places
) -> tuple[float, float]:
    """Return how far directions are off a surface through all the others, and off it.

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
    """Return the polynomial of the logarithms, and what they are relative to."""
    if len(places.distinct) < max(2, len(powers)):
        return None
    found = interpolation.logarithms(ratio, variance, places.group)
    if found is None:
        return None
    design = design_of(places.distinct, powers)
    coefficients = np.linalg.lstsq(design, found[0], rcond=None)[0]
    return np.asarray(coefficients, dtype=np.complex128), found[1]


def _choose_degree(shots: Complex, places: Places, weight: Floats) -> tuple[int, bool]:
    """Return the degree, and whether its misfit may be chance."""
    from scipy.stats import f as f_distribution

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
        chance = float(
            f_distribution.sf(misfit / freedom / pure, 2 * freedom, 2 * repeats)
        )
        if chance > _SIGNIFICANCE:
            return min(degree + 1, highest), True
    return highest, chance > _REFUSED


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
    places = places_of(shot_direction)
    chosen = places.up_to(places.highest(repeats * len(shot_direction)))
    design = design_of(places.where, chosen)
    coefficients = np.linalg.lstsq(design, signal.T, rcond=None)[0]
    at_pixels = design_of(places.scaled(pixel_direction), chosen)
    return np.asarray((at_pixels @ coefficients).T)


def missed(signal: Complex, repeats: int, direction: Floats) -> float:
    """Return how far such a polynomial is off the directions that it leaves out.

    Parameters
    ----------
    signal : ndarray of complex, shape (k, n)
        Water signals without noise at directions that are all different [V].
    repeats : int
        Shots in each direction.
    direction : ndarray, shape (n, 2)
        Azimuth and elevation [rad].

    Returns
    -------
    float
        Largest miss in parts of the largest signal, infinite where a direction cannot
        be left out; 0 for a single direction [1].
    """
    if len(direction) == 1:
        return 0.0
    places = places_of(direction)
    design = design_of(
        places.where, places.up_to(places.highest(repeats * len(direction)))
    )
    hat = design @ np.linalg.pinv(design)
    rest = np.abs(signal - signal @ hat.T)
    largest = np.abs(signal).max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = (rest / np.maximum(1 - np.diag(hat), 0.0)).max(axis=1) / largest
    return float(np.nan_to_num(off, nan=np.inf).max())
