"""Single scattering in photon transport: phase function and Mueller matrix.

Equation numbers are those of R. Ricci et al., EURASIP J. Adv. Signal Process. 2010,
958360, doi:10.1155/2010/958360, as rederived.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics.phase_functions.models import rayleigh_phase
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.polarization.depolarization import realizability_defect
from amulor.optics.polarization.mueller import rayleigh
from amulor.transport._kernels import sampling as _cells

if TYPE_CHECKING:
    from amulor.optics.phase_functions.mie import Suspension

__all__ = ["ScatteringMatrix"]

#: How far the integral of a phase function may be from 1 before it is refused.
INTEGRAL_TOLERANCE = 2e-3
#: How far below zero the smallest eigenvalue of a coherency matrix may lie: tables
#: are printed with three or four digits.
REALIZABILITY_TOLERANCE = 2e-3


@dataclass(frozen=True, eq=False)
class ScatteringMatrix:
    r"""Reduced Mueller matrix of particle scattering, by scattering angle.

    .. math::

       p(\theta) \begin{pmatrix}
         1 & m_{12} & 0 & 0 \\ m_{12} & m_{22} & 0 & 0 \\
         0 & 0 & m_{33} & m_{34} \\ 0 & 0 & -m_{34} & m_{44}
       \end{pmatrix}

    eqs. (63) and (66), the form of randomly oriented particles with a plane of
    symmetry. The parallel axis lies in the scattering plane, and the convention is
    that of `amulor.optics.polarization.stokes`.

    Parameters
    ----------
    phase_function : PhaseFunction
        First element, with an integral of 1 over the sphere.
    angle : ndarray
        Angles of the elements, rising from 0 to pi, shape (n,) [rad].
    elements : ndarray
        Columns m12, m22, m33, m34 and m44 over the first element, shape (n, 5) [1].
        They are interpolated linearly in the angle.

    Raises
    ------
    ValueError
        If shapes or angles do not match, or a matrix is not physical.

    Examples
    --------
    >>> matrix = ScatteringMatrix.rayleigh()
    >>> print(matrix.elements_at(np.pi / 2).round(3) + 0.0)
    [-1.  1.  0.  0.  0.]
    """

    phase_function: PhaseFunction
    angle: NDArray[np.float64]
    elements: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Raise a ValueError for invalid angles or elements."""
        angle = np.asarray(self.angle, dtype=np.float64)
        elements = np.asarray(self.elements, dtype=np.float64)
        if angle.ndim != 1 or angle.size < 2 or elements.shape != (angle.size, 5):
            raise ValueError(
                "elements must have the shape (number of angles, 5) with at least two "
                f"angles, got {elements.shape} and {angle.shape}"
            )
        if (
            angle[0] != 0
            or abs(angle[-1] - np.pi) > 1e-9
            or not np.all(np.diff(angle) > 0)
        ):
            raise ValueError(
                "angle must rise from 0 to pi rad, got values from "
                f"{angle[0]:g} to {angle[-1]:g} rad"
            )
        if not np.all(np.isfinite(elements)):
            raise ValueError("elements must be finite numbers")
        defect = realizability_defect(_full(elements))
        worst = int(np.argmax(defect))
        if defect[worst] > REALIZABILITY_TOLERANCE:
            raise ValueError(
                "a scattering matrix cannot exist: at "
                f"{np.degrees(angle[worst]):.4g} deg the coherency matrix has an "
                f"eigenvalue of {-defect[worst]:.3g} of its trace, which must not "
                f"be below -{REALIZABILITY_TOLERANCE:g}"
            )

    @classmethod
    def rayleigh(cls, *, cells: int = 3600) -> ScatteringMatrix:
        """Return the scattering matrix of particles much smaller than the wavelength.

        Parameters
        ----------
        cells : int
            Number of equal angle steps of the table, at least 16.

        Returns
        -------
        ScatteringMatrix
            Scattering matrix without depolarization.
        """
        angle = np.linspace(0, np.pi, cells + 1)
        return cls(rayleigh_phase(), angle, _compact(rayleigh(angle)))

    @classmethod
    def spheres(cls, suspension: Suspension) -> ScatteringMatrix:
        """Return the scattering matrix of suspended spheres, from Mie theory.

        Parameters
        ----------
        suspension : Suspension
            As `amulor.optics.phase_functions.mie.size_distribution` returns it.

        Returns
        -------
        ScatteringMatrix
            Scattering matrix at the angles of the suspension.
        """
        matrix = suspension.mueller(suspension.angle)
        return cls(suspension.phase_function, suspension.angle, _compact(matrix))

    @classmethod
    def tabulated(
        cls, angle: ArrayLike, *, mueller: ArrayLike, phase_function: PhaseFunction
    ) -> ScatteringMatrix:
        """Return a scattering matrix from Mueller matrices at given angles.

        Parameters
        ----------
        angle : array_like
            Angles that rise from 0 to pi, shape (n,) [rad].
        mueller : array_like
            Mueller matrices over their first element, shape (n, 4, 4) [1].
        phase_function : PhaseFunction
            First element.

        Returns
        -------
        ScatteringMatrix
            Scattering matrix, interpolated linearly in the angle.

        Raises
        ------
        ValueError
            If an element that must be 0 or 1 for symmetric particles in random
            orientation is not, or as for the class.
        """
        matrix = np.asarray(mueller, dtype=np.float64)
        theta = np.asarray(angle, dtype=np.float64)
        if matrix.shape != (*theta.shape, 4, 4):
            raise ValueError(
                f"mueller must have the shape {(*theta.shape, 4, 4)}, "
                f"got {matrix.shape}"
            )
        elements = _compact(matrix)
        wrong = float(np.abs(matrix - _full(elements)).max())
        if not wrong <= REALIZABILITY_TOLERANCE:
            raise ValueError(
                "mueller must have the form of symmetric particles in random "
                "orientation (first element 1, m21 = m12, m43 = -m34, zeros off the "
                f"blocks), got an element that is off by {wrong:.3g}"
            )
        return cls(phase_function, theta, elements)

    def elements_at(self, angle: ArrayLike) -> NDArray[np.float64]:
        """Return the elements m12, m22, m33, m34 and m44 at scattering angles.

        Parameters
        ----------
        angle : array_like
            Scattering angle, 0 to pi [rad].

        Returns
        -------
        ndarray
            Elements over the first, shape of `angle` with a last axis (5,) [1].
        """
        theta = np.asarray(angle, dtype=np.float64)
        return np.stack(
            [np.interp(theta, self.angle, column) for column in self.elements.T],
            axis=-1,
        )


@dataclass(frozen=True, eq=False)
class AngleCells:
    """Phase function averaged over cells of angle, for random scattering angles.

    Within a cell the phase function is constant per solid angle, with the true mean.
    Random angles and tabulated values therefore have the same distribution. The width
    of a cell is 0.4 % of the scattering angle. Near 180 degrees it is 0.4 % of the
    difference to 180 degrees, but at least 0.12 mrad. This is a twentieth of a lobe of
    spheres of 40 um diameter.
    """

    phase_function: PhaseFunction

    @cached_property
    def edges(self) -> NDArray[np.float64]:
        """Cell edges as sin^2(angle / 2), shape (cells + 1,) [1]."""
        return cell_edges()

    @cached_property
    def middle(self) -> NDArray[np.float64]:
        """Scattering angle at the middle of each cell's solid angle [rad]."""
        return _angle(0.5 * (self.edges[:-1] + self.edges[1:]))

    @cached_property
    def _integrals(self) -> NDArray[np.float64]:
        """Solid-angle integral of the phase function over each cell [1]."""
        edges = self.edges
        integrals = 4 * np.pi * self._values.sum(axis=0) * np.diff(edges)
        # The innermost cell may contain a steep head.
        integrals[0] = self.phase_function.cumulative(_angle(edges)[1])
        if not np.all(np.isfinite(integrals)) or np.any(integrals < 0):
            raise ValueError(
                f"{self.phase_function.name} must be finite and not below zero"
            )
        result: NDArray[np.float64] = integrals
        return result

    @cached_property
    def integral(self) -> float:
        """Sphere integral of the phase function before normalization [1]."""
        total = float(self._integrals.sum())
        if abs(total - 1) > INTEGRAL_TOLERANCE:
            raise ValueError(
                f"{self.phase_function.name} must have an integral of 1 over the "
                f"sphere, got {total:.6g}; divide it by that"
            )
        return total

    @cached_property
    def probability(self) -> NDArray[np.float64]:
        """Probability of scattering into each cell [1]."""
        result: NDArray[np.float64] = self._integrals / self.integral
        return result

    @cached_property
    def value(self) -> NDArray[np.float64]:
        """Mean phase function in each cell [1/sr]."""
        solid_angle = 4 * np.pi * np.diff(self.edges)
        result: NDArray[np.float64] = self.probability / solid_angle
        return result

    @cached_property
    def _values(self) -> NDArray[np.float64]:
        """Phase function at each cell's Simpson nodes, times weight [1/sr]."""
        value = np.zeros(self.edges.size)
        value[1:] = self.phase_function(_angle(self.edges)[1:])
        middle = self.phase_function(self.middle)
        return np.stack([value[:-1], 4 * middle, value[1:]]) / 6

    def elements(self, matrix: ScatteringMatrix) -> NDArray[np.float64]:
        """Return mean scattering-matrix elements by cell, shape (cells, 5) [1].

        The elements are weighted by the phase function, so that a cell has the right
        mean of their product, also where both vary within it.
        """
        angle = _angle(self.edges)
        terms = self._values[..., np.newaxis].copy()
        terms[:, 0] = 1.0  # a steep head has most of its light at the lower end
        terms[1:, 0] = 0.0
        at = [matrix.elements_at(a) for a in (angle[:-1], self.middle, angle[1:])]
        total = terms.sum(axis=0)
        mean = np.sum(terms * np.stack(at), axis=0)
        result: NDArray[np.float64] = np.divide(
            mean, total, out=np.array(at[1]), where=total > 0
        )
        return result

    @cached_property
    def urn(self) -> NDArray[np.float64]:
        """Walker alias table for random scattering angles, shape (cells, 8).

        A row holds a threshold, and lower end, width and number first of its own
        cell, then of the partner.
        """
        threshold, partner = alias_table(self.probability)
        low, width = self.edges[:-1], np.diff(self.edges)
        cells = np.arange(low.size)
        columns = [threshold, low, width, cells, low[partner], width[partner], partner]
        return np.stack([*columns, np.zeros(low.size)], axis=-1)


def cell_edges() -> NDArray[np.float64]:
    """Return the edges of the angle cells as sin^2(angle / 2), from 0 to 1."""
    step = np.arange(_cells.PER_OCTAVE) / _cells.PER_OCTAVE

    def octaves(number: int) -> NDArray[np.float64]:
        low = 0.5 ** np.arange(number + 1, 1, -1)
        return np.concatenate([[0.0], (low[:, np.newaxis] * (1 + step)).ravel()])

    forward = octaves(_cells.FORWARD_OCTAVES)
    backward = 1 - octaves(_cells.BACKWARD_OCTAVES)[::-1]
    return np.concatenate([forward, [0.5], backward])


def alias_table(
    probability: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return thresholds and alias indices for Walker's method of random choice.

    A. J. Walker, ACM Trans. Math. Softw. 3, 253 (1977), in the form of M. D. Vose,
    IEEE Trans. Softw. Eng. 17, 972 (1991).
    """
    size = probability.size
    scaled = probability * size / probability.sum()
    threshold, partner = np.ones(size), np.arange(size)
    small = [int(k) for k in np.flatnonzero(scaled < 1)]
    large = [int(k) for k in np.flatnonzero(scaled >= 1)]
    while small and large:
        low, high = small.pop(), large[-1]
        threshold[low], partner[low] = scaled[low], high
        scaled[high] -= 1 - scaled[low]
        if scaled[high] < 1:
            small.append(large.pop())
    return threshold, partner


def _angle(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle for a given sin^2(angle / 2) [rad]."""
    result: NDArray[np.float64] = 2 * np.arctan2(np.sqrt(height), np.sqrt(1 - height))
    return result


def _compact(mueller: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the elements m12, m22, m33, m34 and m44 of Mueller matrices."""
    return np.stack(
        [
            mueller[..., 0, 1],
            mueller[..., 1, 1],
            mueller[..., 2, 2],
            mueller[..., 2, 3],
            mueller[..., 3, 3],
        ],
        axis=-1,
    )


def _full(elements: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Mueller matrices from the elements m12, m22, m33, m34 and m44."""
    matrix = np.zeros((*elements.shape[:-1], 4, 4))
    matrix[..., 0, 0] = 1
    matrix[..., 0, 1] = matrix[..., 1, 0] = elements[..., 0]
    matrix[..., 1, 1] = elements[..., 1]
    matrix[..., 2, 2] = elements[..., 2]
    matrix[..., 2, 3], matrix[..., 3, 2] = elements[..., 3], -elements[..., 3]
    matrix[..., 3, 3] = elements[..., 4]
    return matrix
