r"""Phase functions of mixtures: several kinds of particles, and the water.

>>> from amulor.optics.phase_functions.models import isotropic, rayleigh_phase
>>> both = mixture([isotropic(), rayleigh_phase()], scattering=[1.0, 3.0])
>>> print(f"{both.at_180:.4f} 1/sr")
0.1094 1/sr
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import not_negative, require, within
from amulor.optics.phase_functions.fournier_forand import (
    fournier_forand_backscatter_fraction,
)
from amulor.optics.phase_functions.integrals import Panels
from amulor.optics.phase_functions.models import fournier_forand
from amulor.optics.phase_functions.phase_function import PhaseFunction

__all__ = ["fournier_forand_with_backscatter", "mixture"]

#: Slopes between which the particles of the sea lie, wide enough for any of them.
_SLOPES = (3.05, 4.9)


def mixture(
    functions: Sequence[PhaseFunction], *, scattering: ArrayLike, name: str = ""
) -> PhaseFunction:
    r"""Return the phase function of a mixture, weighted by scattering coefficients.

    Parameters
    ----------
    functions : sequence of PhaseFunction
        Phase function of each kind of scatterer.
    scattering : array_like
        Scattering coefficient of each kind, not negative, their sum above 0 [1/m].
    name : str
        Name of the mixture, by default from the names of its parts.

    Returns
    -------
    PhaseFunction
        Mean of the functions, weighted with the scattering.

    Raises
    ------
    ValueError
        If the numbers of functions and coefficients differ, or nothing scatters.

    Notes
    -----
    :math:`p = \sum_i b_i p_i / \sum_i b_i`. Its integrals are the same means of the
    integrals of its parts.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> parts = [henyey_greenstein_function(asymmetry=g) for g in (0.9, 0.3)]
    >>> print(f"{mixture(parts, scattering=[2.0, 1.0]).asymmetry:.2f}")
    0.70
    """
    amounts = not_negative(scattering, name="scattering", unit="1/m")
    if amounts.shape != (len(functions),):
        raise ValueError(
            f"scattering must hold one coefficient for each of {len(functions)} phase "
            f"functions, got shape {amounts.shape}"
        )
    total = amounts.sum()
    require(total, total > 0, name="sum of scattering", rule="above 0", unit="1/m")
    parts = [
        (float(amount / total), function)
        for amount, function in zip(amounts, functions, strict=True)
        if amount > 0
    ]
    if len(parts) == 1:
        return parts[0][1]
    heads = [function.head_exponent for _, function in parts]
    edges = np.unique(np.concatenate([function.panels.edges for _, function in parts]))
    listed = ", ".join(f"{weight:.3g} of {function.name}" for weight, function in parts)
    return PhaseFunction(
        name=name or listed,
        panels=Panels(partial(_value, parts=parts), edges, max(heads)),
        head_angle=max(function.head_angle for _, function in parts),
        closed_cumulative=partial(_cumulative, parts=parts),
        closed_asymmetry=sum(weight * function.asymmetry for weight, function in parts),
    )


def fournier_forand_with_backscatter(backscatter_fraction: float) -> PhaseFunction:
    r"""Return the Fournier-Forand phase function with a given backscatter fraction.

    Parameters
    ----------
    backscatter_fraction : float
        Backscattering over scattering of the particles, 0.0003 to 0.2 [1].

    Returns
    -------
    PhaseFunction
        Phase function with index and slope on the line of the notes.

    Raises
    ------
    ValueError
        If the fraction is outside of its range.

    Notes
    -----
    C. D. Mobley, L. K. Sundman and E. Boss, Appl. Opt. 41, 1035 (2002),
    :doi:`10.1364/AO.41.001035`, couple relative index and slope by
    :math:`n = 1.01 + 0.1542 (\mu - 3)`. They find that the fraction then determines the
    light field.

    Examples
    --------
    >>> print(fournier_forand_with_backscatter(0.0183).name)
    Fournier-Forand, relative index 1.09996, slope 3.58342
    """
    fraction = float(
        within(backscatter_fraction, 3e-4, 0.2, name="backscatter_fraction")
    )

    def excess(slope: float) -> float:
        backscatter = fournier_forand_backscatter_fraction(
            relative_index=_index(slope), slope=slope
        )
        return backscatter - fraction

    from scipy.optimize import brentq  # a fifth of the start of `amulor image`

    slope = float(brentq(excess, *_SLOPES, xtol=1e-12))
    return fournier_forand(relative_index=_index(slope), slope=slope)


def _index(slope: float) -> float:
    """Return the particles' relative index assumed for a slope of the sizes [1]."""
    return 1.01 + 0.1542 * (slope - 3)


def _value(
    angle: NDArray[np.float64], *, parts: list[tuple[float, PhaseFunction]]
) -> NDArray[np.float64]:
    total = np.zeros(angle.shape)
    for weight, function in parts:
        total += weight * function.panels.value(angle)
    return total


def _cumulative(
    angle: NDArray[np.float64], *, parts: list[tuple[float, PhaseFunction]]
) -> NDArray[np.float64]:
    total = np.zeros(angle.shape)
    for weight, function in parts:
        total += weight * function.cumulative(angle)
    return total
