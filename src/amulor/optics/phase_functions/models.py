r"""Phase functions from formulas: isotropic, Rayleigh, Henyey-Greenstein and others.

>>> water = fournier_forand(relative_index=1.1, slope=3.5835)
>>> print(f"{water.backscatter_fraction:.4f}, {water.at_180:.2e} 1/sr")
0.0183, 2.86e-03 1/sr
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from amulor.optics._bounds import within
from amulor.optics.phase_functions import fournier_forand as _formula
from amulor.optics.phase_functions import rayleigh as rayleigh_scattering
from amulor.optics.phase_functions.henyey_greenstein import (
    henyey_greenstein as _henyey_greenstein,
)
from amulor.optics.phase_functions.henyey_greenstein import (
    henyey_greenstein_cumulative,
)
from amulor.optics.phase_functions.integrals import INNERMOST_ANGLE, Panels
from amulor.optics.phase_functions.phase_function import PhaseFunction

__all__ = [
    "fournier_forand",
    "henyey_greenstein_function",
    "isotropic",
    "rayleigh_phase",
    "two_term",
]


def isotropic() -> PhaseFunction:
    """Return the isotropic phase function.

    Returns
    -------
    PhaseFunction
        1 / 4 pi [1/sr].

    Notes
    -----
    Eq. (70) of Ricci et al. 2010 (:doi:`10.1155/2010/958360`) with an asymmetry of 0.

    Examples
    --------
    >>> print(f"{isotropic().backscatter_fraction:.1f}")
    0.5
    """
    value = partial(_henyey_greenstein, asymmetry=0.0)
    cumulative = partial(henyey_greenstein_cumulative, asymmetry=0.0)
    return _closed("isotropic", value, cumulative, 0.0)


def rayleigh_phase(*, depolarization: float = 0.0) -> PhaseFunction:
    """Return the Rayleigh phase function for unpolarized light.

    Parameters
    ----------
    depolarization : float
        Depolarization ratio of unpolarized light at 90 degrees, 0 to 1; 0.039 for
        pure water [1].

    Returns
    -------
    PhaseFunction
        By `amulor.optics.phase_functions.rayleigh.rayleigh_phase_value`.

    Raises
    ------
    ValueError
        If the depolarization ratio is outside of its range.

    Examples
    --------
    >>> print(f"{rayleigh_phase(depolarization=0.039).at_180:.4f} 1/sr")
    0.1171 1/sr
    """
    ratio = float(depolarization)
    # Refuses what is out of range.
    rayleigh_scattering.rayleigh_phase_value(0.0, depolarization=ratio)
    value = partial(rayleigh_scattering.rayleigh_phase_value, depolarization=ratio)
    cumulative = partial(
        rayleigh_scattering.rayleigh_phase_cumulative, depolarization=ratio
    )
    return _closed(f"Rayleigh, depolarization {ratio:g}", value, cumulative, 0.0)


def henyey_greenstein_function(*, asymmetry: float) -> PhaseFunction:
    """Return the Henyey-Greenstein phase function of a given mean cosine.

    Parameters
    ----------
    asymmetry : float
        Mean cosine g, from -0.9999 to 0.999999, the range of the integrals [1].

    Returns
    -------
    PhaseFunction
        By `amulor.optics.phase_functions.henyey_greenstein`.

    Raises
    ------
    ValueError
        If the asymmetry is outside of its range.

    Examples
    --------
    >>> fraction, moment = henyey_greenstein_function(asymmetry=0.97).forward_split(
    ...     np.pi / 2
    ... )
    >>> print(f"{fraction:.4f}, {moment:.3f} rad^2")
    0.9936, 0.045 rad^2
    """
    g = _asymmetry(asymmetry, name="asymmetry")
    value = partial(_henyey_greenstein, asymmetry=g)
    cumulative = partial(henyey_greenstein_cumulative, asymmetry=g)
    return _closed(f"Henyey-Greenstein, asymmetry {g:g}", value, cumulative, g)


def two_term(
    *, forward_asymmetry: float, backward_asymmetry: float, forward_weight: float
) -> PhaseFunction:
    r"""Return the weighted sum of two Henyey-Greenstein phase functions.

    Parameters
    ----------
    forward_asymmetry : float
        Mean cosine of the first term, from -0.9999 to 0.999999 [1].
    backward_asymmetry : float
        Mean cosine of the second term, same range, mostly negative [1].
    forward_weight : float
        Weight w of the first term, 0 to 1 [1].

    Returns
    -------
    PhaseFunction
        :math:`w \, p(\theta; g_1) + (1 - w) \, p(\theta; g_2)`.

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    V. I. Haltrin, Appl. Opt. 41, 1022 (2002), :doi:`10.1364/AO.41.001022`, gives
    weights and asymmetries for sea water.

    Examples
    --------
    >>> p = two_term(
    ...     forward_asymmetry=0.95, backward_asymmetry=-0.4, forward_weight=0.97
    ... )
    >>> print(f"{p.asymmetry:.4f}")
    0.9095
    """
    first = _asymmetry(forward_asymmetry, name="forward_asymmetry")
    second = _asymmetry(backward_asymmetry, name="backward_asymmetry")
    weight = float(within(forward_weight, 0, 1, name="forward_weight"))

    def sum_of(
        formula: Callable[..., NDArray[np.float64]],
    ) -> partial[NDArray[np.float64]]:
        return partial(_two_terms, formula, first=first, second=second, weight=weight)

    return _closed(
        f"two-term Henyey-Greenstein, asymmetries {first:g} and {second:g}, "
        f"weight {weight:g}",
        sum_of(_henyey_greenstein),
        sum_of(henyey_greenstein_cumulative),
        weight * first + (1 - weight) * second,
    )


def fournier_forand(*, relative_index: float, slope: float) -> PhaseFunction:
    """Return the Fournier-Forand phase function of a relative index and size slope.

    Parameters
    ----------
    relative_index : float
        Real index of the particles over that of water, above 1 to 1.5 [1].
    slope : float
        Slope of the size distribution, above 3 and below 5 [1].

    Returns
    -------
    PhaseFunction
        By `amulor.optics.phase_functions.fournier_forand.fournier_forand_phase`.

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Examples
    --------
    >>> water = fournier_forand(relative_index=1.1, slope=3.5835)
    >>> print(f"{water.asymmetry:.3f}")
    0.930
    """
    index, mu = float(relative_index), float(slope)
    value = partial(_formula.fournier_forand_phase, relative_index=index, slope=mu)
    cumulative = partial(
        _formula.fournier_forand_cumulative, relative_index=index, slope=mu
    )
    name = f"Fournier-Forand, relative index {index:g}, slope {mu:g}"
    # Refuses what is out of range.
    _formula.fournier_forand_backscatter_fraction(relative_index=index, slope=mu)
    # Number ~ r^-mu makes p ~ angle^(mu - 5) in the peak.
    return _closed(name, value, cumulative, None, head_exponent=5 - mu)


def _closed(
    name: str,
    value: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    cumulative: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    asymmetry: float | None,
    *,
    head_exponent: float = 0.0,
) -> PhaseFunction:
    """Return a phase function from formulas, with panels that narrow to 0 and pi."""
    forward = np.geomspace(INNERMOST_ANGLE, np.pi / 2, 42)
    backward = np.pi - np.geomspace(1e-7, np.pi / 2, 25)[-2::-1]
    panels = Panels(value, np.concatenate([forward, backward, [np.pi]]), head_exponent)
    return PhaseFunction(
        name=name,
        panels=panels,
        closed_cumulative=cumulative,
        closed_asymmetry=asymmetry,
    )


def _two_terms(
    formula: Callable[..., NDArray[np.float64]],
    angle: NDArray[np.float64],
    *,
    first: float,
    second: float,
    weight: float,
) -> NDArray[np.float64]:
    """Return the weighted sum of a Henyey-Greenstein formula at two asymmetries."""
    second_term = (1 - weight) * formula(angle, asymmetry=second)
    return weight * formula(angle, asymmetry=first) + second_term


def _asymmetry(value: float, *, name: str) -> float:
    """Return a mean cosine; ValueError if too close to -1 or 1."""
    return float(within(value, -0.9999, 0.999999, name=name))
