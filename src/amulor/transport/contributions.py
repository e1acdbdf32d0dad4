"""What groups of histories contribute, and whether one of them outweighs the error.

A run is an average of groups that are independent of each other. Its error is that of
their scatter, unless a few of them bring most of the light; then the next one of that
size would move the mean by more than the error that is stated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics.polarization import stokes as _stokes

__all__ = [
    "ANALYSERS",
    "LIGHT",
    "PathRecord",
    "analyser_vector",
    "outweighs",
    "sums_of",
    "together",
]


Array = NDArray[np.float64]

#: Kinds of light, in the order of the rows of the sums.
LIGHT = ("all", "water", "target")
#: Analysers, in the order of the columns; without Stokes vectors there is the first.
ANALYSERS = ("none", "H", "V", "P", "M", "R", "L")
#: Sum, sum of squares and largest of the contributions of the groups.
SUM, SQUARE, LARGEST = range(3)
#: Equal contributions that would scatter as much, fewest from which an error is known:
#: of fewer the large ones are likely to be missing yet, from sum and error alike.
_FEWEST = 30


def analyser_vector(name: str) -> Array:
    """Return what of I, Q, U and V an ideal analyser lets pass."""
    vector = _stokes.state(name)
    result: Array = vector if name == "none" else 0.5 * vector
    return result


def sums_of(weight: Array) -> Array:
    """Return sum, sum of squares and largest of contributions."""
    light = np.stack([weight.sum(axis=1), weight[:, 0], weight[:, 1]])
    if weight.shape[2] == 4:
        vectors = np.stack([analyser_vector(name) for name in ANALYSERS], axis=-1)
        passed = light @ vectors
    else:
        passed = light
    return np.stack(
        [
            passed.sum(axis=1),
            (passed**2).sum(axis=1),
            passed.max(axis=1, initial=0.0),
        ],
        axis=-1,
    )


def together(one: Array, other: Array) -> Array:
    """Return the sums of two sets of groups."""
    result = one + other
    result[..., LARGEST] = np.maximum(one[..., LARGEST], other[..., LARGEST])
    return result


def outweighs(sums: Array, *, groups: int, unseen: float = 0.0) -> bool:
    """Return whether one group moves the mean by more than a standard error."""
    if groups < 2:
        return False
    total, square, largest = (float(value) for value in sums)
    if (square - total**2 / groups) * _FEWEST > total**2:
        return True
    others = groups - 1
    mean = (total - largest) / others
    spread = max(square - largest**2 - others * mean**2, 0.0)
    # What rounding leaves of equal contributions is no tail.
    if largest - mean > math.sqrt(spread) + 1e-6 * largest:
        return True
    return unseen > math.sqrt(max(square - total**2 / groups, 0.0))


Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, kw_only=True)
class PathRecord:
    """Received light by the length of its path, for other frequencies later.

    Light of all lengths in a bin counts at its middle. A phasor that is summed over
    the bins is wrong by at most an eighth of the square of the phase across a bin
    times the unmodulated light: 3e-4 at the highest frequency of the run.

    Examples
    --------
    Light on a path of 3 m, half a wavelength at 50 MHz with a group index of 1: its
    phase is half a turn.

    >>> import numpy as np
    >>> from scipy.constants import speed_of_light
    >>> from amulor.transport import PathRecord
    >>> record = PathRecord(
    ...     length=np.array([speed_of_light / 100e6]), water=np.array([[1e-7]]),
    ...     target=np.array([[0.0]]), beyond=0.0,
    ... )
    >>> light = record.stokes([50e6], group_index=1.0)
    >>> print(f"{abs(np.angle(light[0, 0])) / np.pi:.3f} pi")
    1.000 pi
    """

    length: Array
    """Middle of each bin of path length, shape (bins,) [m]."""
    water: Array
    """Mean light in each bin that met water only, shape (bins, components) [1]."""
    target: Array
    """Mean light in each bin that met the target [1]."""
    beyond: float
    """Share of the unmodulated light with longer paths, which is not in the record
    [1]."""

    def stokes(
        self,
        modulation_frequency: ArrayLike,
        *,
        group_index: float,
        more_absorption: float = 0.0,
    ) -> Complex:
        r"""Return the light at other frequencies, or in water that absorbs more.

        Parameters
        ----------
        modulation_frequency : array_like
            Frequencies, not above those of the run, shape (n,) [Hz].
        group_index : float
            Group index of the run [1].
        more_absorption : float
            What to add to the absorption coefficient in all layers, not below 0: less
            absorption would need paths that the run has not followed [1/m].

        Returns
        -------
        ndarray
            Water and target together, shape (n, components) [1]. Without errors; the
            scatter is that of the run.

        Raises
        ------
        ValueError
            If the absorption added is below zero.

        Notes
        -----
        Eq. (9) of Ricci et al. 2010 (:doi:`10.1155/2010/958360`), as rebuilt: a path
        of length L counts :math:`e^{(i \omega / v - a) L}`.
        """
        if not more_absorption >= 0:
            raise ValueError(
                f"more_absorption must be at least 0 1/m, got {more_absorption!r} 1/m"
            )
        frequency = np.atleast_1d(np.asarray(modulation_frequency, dtype=np.float64))
        wave = (2j * np.pi * group_index / speed_of_light) * frequency - more_absorption
        phasor: Complex = np.exp(np.outer(wave, self.length).astype(np.complex128))
        result: Complex = phasor @ (self.water + self.target)
        return result
