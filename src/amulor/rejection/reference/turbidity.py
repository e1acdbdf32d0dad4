"""The turbidity that the open water itself tells, for the column behind a target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.rejection.covariance import Covariance
from amulor.rejection.reference.model import water_signal
from amulor.survey import Survey, water_properties
from amulor.survey.properties import by_coefficients
from amulor.survey.view import medium, view

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Factors of a and b that are tried, in even steps of the logarithm [1].
_FACTORS = np.geomspace(0.25, 4.0, 49)
#: Every which of them is tried first.
_COARSE = 6
#: Directions of the scan whose open water is compared with the model.
_DIRECTIONS = 9
#: What the model may be off by where too few frequencies could show it, in parts of
#: the open water, by the number of frequencies [1].
_UNSEEN = {1: 0.05, 2: 0.01, 3: 0.005}

#: A small-angle form that misses more than this of the open water is doubted [1], and
#: the diffusion form taken where it leaves less than this part of the square [1].
_WRONG, _BETTER = 0.02, 0.25


@dataclass(frozen=True, kw_only=True)
class Turbidity:
    """The survey's water as the shots correct it, and how sure that is."""

    survey: Survey
    """The survey with a and b times a factor."""
    factor: float
    """The factor [1]."""
    uncertainty: float
    """Standard uncertainty of its logarithm [1]."""
    steeper: Survey
    """The survey with the factor one standard uncertainty larger."""
    misfit: float
    """Root mean square departure of the model from the open water, which chance does
    not explain, or what could not be seen, in parts of the open water [1]."""
    shown: float
    """The part of it that the shots do show [1]."""
    paper: bool = False
    """Whether the diffusion form of the paper is the model, and not the small-angle
    form."""


def turbidity_of(
    cube: xr.Dataset, survey: Survey, open_water: Complex, errors: Covariance
) -> Turbidity:
    r"""Return the factor of a and b with which the model fits the open water best.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`; its frequencies and directions count.
    survey : Survey
        Water and instrument as the user describes them.
    open_water : ndarray, shape (modulation_frequency, polarization, row, column)
        Open-water signal at the pixels, from the shots [V].
    errors : Covariance
        Errors of that, of the same shape.

    Returns
    -------
    Turbidity
        With factors between a quarter and four.

    Notes
    -----
    Open water of the survey by `model.water_signal`, times a factor for
    each channel above zero, against the shots: the phases tell how deep the light
    comes from, at one frequency already, and the amplitudes how that is spread. The
    uncertainty of the factor is where chi-square rises by one, or by what it has for
    each degree of freedom where that is more. Where the small-angle form misses more
    than 2 % of the open water and the diffusion form of the paper leaves less than half
    of that, the latter is the model. What is left in spite of the best factor is the
    model's own error.
    """
    directions = _spread(cube["azimuth"].size)
    frequencies, channels = open_water.shape[:2]

    def some(values: NDArray[np.generic]) -> NDArray[np.generic]:
        return values.reshape(frequencies, channels, -1)[..., directions]

    seen: Complex = some(open_water)  # type: ignore[assignment]
    variance = np.asarray(some(errors.in_phase + errors.quadrature), dtype=float) / 2
    # Shots without any error still need weights.
    floor = (1e-6 * np.abs(seen).max(initial=0.0)) ** 2 + np.finfo(float).tiny
    weight = 1 / np.maximum(variance, floor)
    places = [
        cube[name].values.ravel()[directions] for name in ("azimuth", "elevation")
    ]
    frequency = cube["modulation_frequency"].values

    def minimum(*, paper: bool) -> tuple[float, float, float]:
        """Return the place, value and curvature of the smallest chi-square."""
        square = _around_the_lowest(
            lambda factor: _chi_square(
                _model(scaled(survey, factor), places, frequency, paper=paper),
                seen,
                weight,
            )
        )
        return _minimum(square)

    step = float(np.log(_FACTORS[1] / _FACTORS[0]))
    place, lowest, curvature = minimum(paper=False)
    power = float(np.sum(weight * np.abs(seen) ** 2))
    paper = False
    if lowest > _WRONG**2 * power:
        other = minimum(paper=True)
        if other[1] < _BETTER * lowest:
            (place, lowest, curvature), paper = other, True
    factor = float(_FACTORS[0] * np.exp(place * step))
    # The two outputs of a sample count twice; directions share their shots.
    freedom = max(2 * frequencies * channels - channels - 1, 1)
    scale = max(lowest / len(directions) / freedom, 1.0)
    width = step * float(np.sqrt(2 * scale * len(directions) / max(curvature, 1e-12)))
    uncertainty = min(width, float(np.log(4.0)))
    if not 0.5 < place < len(_FACTORS) - 1.5:
        # The best factor lies beyond those that were tried.
        uncertainty = max(uncertainty, float(np.log(2.0)))
    explained = len(directions) * freedom
    left = max(lowest - explained, 0.0) / power if power > 0 else 1.0
    misfit = float(np.hypot(np.sqrt(left), _UNSEEN.get(frequencies, 0.0)))
    return Turbidity(
        survey=scaled(survey, factor),
        factor=factor,
        uncertainty=uncertainty,
        steeper=scaled(survey, factor * float(np.exp(uncertainty))),
        misfit=min(misfit, 1.0),
        shown=min(float(np.sqrt(left)), 1.0),
        paper=paper,
    )


def scaled(survey: Survey, factor: float) -> Survey:
    """Return a survey with absorption and scattering times a factor.

    Parameters
    ----------
    survey : Survey
        What is described.
    factor : float
        Above 0 [1].

    Returns
    -------
    Survey
        The same, in water of another turbidity.
    """
    return by_coefficients(survey, factor=factor)


def _spread(count: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, min(_DIRECTIONS, count)).astype(np.intp))


def _model(
    survey: Survey, places: list[Floats], frequency: Floats, *, paper: bool
) -> Complex:
    """Return open water over (frequency, direction), in any unit."""
    water = water_properties(survey)
    where = view(survey, *places, medium=medium(survey, water))
    response = water_signal(
        survey, *places, modulation_frequency=frequency, paper=paper
    )
    turn = 2j * np.pi * frequency[:, None] * where.optical_offset / speed_of_light
    return np.asarray(response * np.exp(turn))


def _chi_square(model: Complex, seen: Complex, weight: Floats) -> float:
    """Return the chi-square with the best strength of each channel."""
    total = 0.0
    for channel in range(seen.shape[1]):
        own, w = seen[:, channel], weight[:, channel]
        power = float(np.sum(w * np.abs(model) ** 2))
        product = float(np.sum(w * (model.conj() * own).real))
        strength = max(product / power, 0.0) if power > 0 else 0.0
        total += float(np.sum(w * np.abs(own - strength * model) ** 2))
    return total


def _around_the_lowest(chi_square: Callable[[float], float]) -> Floats:
    """Return chi-squares of `_FACTORS` at and beside the lowest, infinite elsewhere.

    Each sixth factor first, then halfway, then neighbours until none is lower.
    """
    found = np.full(len(_FACTORS), np.inf)
    last = len(_FACTORS) - 1
    waiting = set(range(0, last + 1, _COARSE))
    while waiting:
        for k in waiting:
            found[k] = chi_square(float(_FACTORS[k]))
        known = np.isfinite(found).sum() > last // _COARSE + 1
        best = int(np.clip(found.argmin(), 1, last - 1))
        reach = 1 if known else _COARSE // 2
        around = {max(best - reach, 0), best, min(best + reach, last)}
        waiting = {k for k in around if np.isinf(found[k])}
    return found


def _minimum(square: Floats) -> tuple[float, float, float]:
    """Return place, value and second difference of a minimum among even nodes."""
    k = int(np.clip(np.argmin(square), 1, len(square) - 2))
    before, middle, after = square[k - 1 : k + 2]
    curvature = float(before - 2 * middle + after)
    if curvature <= 0:
        return float(np.argmin(square)), float(square.min()), 0.0
    off = float(np.clip((before - after) / (2 * curvature), -1.0, 1.0))
    lowest = float(middle - curvature * off**2 / 2)
    return k + off, max(lowest, 0.0), curvature
