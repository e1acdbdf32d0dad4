"""Phase functions as objects, from formulas or tables.

`amulor.optics.phase_functions.models` creates them from formulas,
`amulor.optics.phase_functions.tables` from tables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import (
    checked_angle,
    checked_split_angle,
    require,
    within,
)
from amulor.optics.phase_functions.integrals import (
    INNERMOST_ANGLE,
    LARGEST_DIRECTION_FREQUENCY,
    Panels,
)

__all__ = ["PhaseFunction", "SamplingTable"]


@dataclass(frozen=True, eq=False)
class SamplingTable:
    """Table of the inverse cumulative phase function, for random angles.

    Both arrays rise, so the inverse is monotone. Between two nodes the phase function
    is assumed to be constant, which keeps the fraction of each cell exact.

    Examples
    --------
    >>> import numpy as np
    >>> ends = np.array([0.0, 1.0])  # isotropic scattering: half goes beyond 90 degrees
    >>> table = SamplingTable(ends, ends, error=0.0)
    >>> print(f"{np.degrees(table.angle(0.5)):.0f} degrees")
    90 degrees
    """

    cumulative: NDArray[np.float64]
    """Fraction of the scattering below each node, from 0 to 1 [1]."""
    half_chord_squared: NDArray[np.float64]
    """sin^2(angle / 2) of each node, from 0 to 1 [1]."""
    error: float
    """Largest interpolation error, from 15 points inside each cell [1]."""

    def angle(self, fraction: ArrayLike) -> NDArray[np.float64]:
        r"""Return the angle below which a given fraction of scattering lies [rad].

        Parameters
        ----------
        fraction : array_like
            Fraction, 0 to 1; uniform random numbers give random scattering angles [1].

        Returns
        -------
        ndarray
            Scattering angle, shape of `fraction` [rad].

        Raises
        ------
        ValueError
            If a fraction is outside of 0 to 1.

        Notes
        -----
        :math:`\sin^2(\theta/2)` is interpolated linearly in the fraction.

        Examples
        --------
        >>> ends = np.array([0.0, 1.0])  # that of isotropic scattering
        >>> print(f"{SamplingTable(ends, ends, error=0.0).angle(0.5):.4f} rad")
        1.5708 rad
        """
        below = within(fraction, 0, 1, name="fraction")
        height = np.interp(below, self.cumulative, self.half_chord_squared)
        angle: NDArray[np.float64] = 2 * np.arcsin(np.sqrt(height))
        return angle


@dataclass(frozen=True, eq=False, kw_only=True)
class PhaseFunction:
    r"""Scattered power per solid angle, with an integral of 1 over the sphere.

    A call returns its value. Integrals use closed forms if available, else
    `amulor.optics.phase_functions.integrals.Panels`.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> function = henyey_greenstein_function(asymmetry=0.9)
    >>> print(f"{float(function(np.pi)):.5f} 1/sr")  # (1 - g) / (4 pi (1 + g)^2)
    0.00220 1/sr
    """

    name: str
    """Name of the phase function, with its parameters."""
    panels: Panels = field(repr=False)
    """Phase function by intervals of angle in which it is smooth."""
    head_angle: float = 0.0
    """Angle below which a power law replaces missing data; 0 if none [rad]."""
    integral: float = 1.0
    """Sphere integral before normalization: 1, or for a volume scattering
    function the scattering coefficient [1/m].
    """
    closed_cumulative: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = (
        field(default=None, repr=False)
    )
    """Closed form of `cumulative`, if available."""
    closed_asymmetry: float | None = field(default=None, repr=False)
    """Closed form of `asymmetry`, if available [1]."""

    def __call__(self, angle: ArrayLike) -> NDArray[np.float64]:
        """Return the phase function at scattering angles [1/sr].

        Parameters
        ----------
        angle : array_like
            Scattering angle, 0 to pi; above 0 where the head is a power law that is
            infinite at 0 [rad].

        Returns
        -------
        ndarray
            Phase function, shape of `angle` [1/sr].

        Raises
        ------
        ValueError
            If an angle is outside of its range.
        """
        theta = checked_angle(angle, name="angle")
        if self.head_exponent > 0 and np.any(theta == 0):
            hint = f"{self.name} is infinite at 0"
            require(
                theta, theta > 0, name="angle", rule="above 0", unit="rad", hint=hint
            )
        return self.panels.value(theta)

    @property
    def head_exponent(self) -> float:
        r"""Exponent s of the small-angle law :math:`\theta^{-s}`; 0 if none [1]."""
        return self.panels.head_exponent

    @property
    def description(self) -> str:
        """Name, with the fraction of scattering below the smallest measured angle."""
        if self.head_angle == 0:
            return self.name
        fraction = float(self.cumulative(self.head_angle))
        return (
            f"{self.name}; below {np.degrees(self.head_angle):.3g} deg, where "
            f"{100 * fraction:.2g} % of the scattering lies, a power law with the "
            f"exponent {-self.head_exponent:.4g}, without data"
        )

    def cumulative(self, angle: ArrayLike) -> NDArray[np.float64]:
        """Return the fraction of the scattering below given angles.

        Parameters
        ----------
        angle : array_like
            Scattering angle, 0 to pi [rad].

        Returns
        -------
        ndarray
            Fraction between 0 and 1, shape of `angle` [1]. Error 1e-10 if there is no
            closed form.

        Raises
        ------
        ValueError
            If an angle is outside of its range.
        """
        theta = checked_angle(angle, name="angle")
        if self.closed_cumulative is not None:
            return self.closed_cumulative(theta)
        return self.panels.cumulative(theta)

    @cached_property
    def asymmetry(self) -> float:
        """Mean cosine of the scattering angle [1]."""
        if self.closed_asymmetry is not None:
            return self.closed_asymmetry
        return 1 - 2 * self.panels.mean(lambda angle: np.sin(angle / 2) ** 2)

    @cached_property
    def backscatter_fraction(self) -> float:
        """Fraction of the scattering beyond 90 degrees [1]."""
        return float(1 - self.cumulative(np.pi / 2))

    @cached_property
    def at_180(self) -> float:
        """Phase function at a scattering angle of 180 degrees [1/sr]."""
        return float(self(np.pi))

    def forward_split(self, split_angle: float) -> tuple[float, float]:
        r"""Return the fraction and second moment of scattering below a split angle.

        Parameters
        ----------
        split_angle : float
            Angle between the forward and the diffuse part, above 1e-12 to pi [rad].

        Returns
        -------
        forward_fraction : float
            Fraction of the scattering below the split angle [1].
        second_moment : float
            Mean square scattering angle below the split angle, sin-weighted and
            renormalised [rad^2].

        Raises
        ------
        ValueError
            If the split angle is outside of its range, or no scattering lies below it.

        Notes
        -----
        Eqs. (10) and (33) of Ricci et al. 2010 (:doi:`10.1155/2010/958360`), as
        rederived.
        """
        split = _split(split_angle)
        fraction = self.panels.mean(np.ones_like, high=split)
        if not fraction > 0:
            raise ValueError(
                f"{self.name} must scatter something below {split:g} rad, got nothing"
            )
        moment = self.panels.mean(np.square, high=split)
        return float(self.cumulative(split)), moment / fraction

    def hankel(
        self, direction_frequency: ArrayLike, *, split_angle: float
    ) -> NDArray[np.float64]:
        r"""Return the Hankel transform of the forward scattering, 1 at frequency 0.

        Parameters
        ----------
        direction_frequency : array_like
            Conjugate q of the angle, from 0 to 1e9 [1/rad].
        split_angle : float
            Angle between the forward and the diffuse part, above 1e-12 to pi [rad].

        Returns
        -------
        ndarray
            Transform, 1 at q = 0, shape of `direction_frequency` [1]. Error 1e-10.

        Raises
        ------
        ValueError
            If an argument is outside of its range, or the forward part is zero.

        Notes
        -----
        The forward part is renormalised on the sphere, and its weight in the plane of
        small angles is that on the sphere, :math:`\sin\theta \, d\theta` in place of
        :math:`\theta \, d\theta`,

        .. math::

           \hat p(k) = \int_0^{\theta_s} p \, J_0(k\theta) \sin\theta \, d\theta
               \Big/ \int_0^{\theta_s} p \sin\theta \, d\theta,

        so that :math:`\hat p = 1 - k^2 \langle\theta^2\rangle / 4` for small k with
        the second moment of `forward_split`.
        """
        split = _split(split_angle)
        q = within(
            direction_frequency,
            0,
            LARGEST_DIRECTION_FREQUENCY,
            name="direction_frequency",
            unit="1/rad",
        )
        fraction = self.panels.mean(np.ones_like, high=split)
        if not fraction > 0:
            raise ValueError(
                f"{self.name} must scatter something below {split:g} rad, got nothing"
            )
        return self.panels.hankel(q, split_angle=split) / fraction

    def sampling_table(self, size: int) -> SamplingTable:
        """Return a table for drawing random scattering angles.

        Parameters
        ----------
        size : int
            Number of cells, at least 16.

        Returns
        -------
        SamplingTable
            Nodes closer together where the scattering is, and evenly over the decades
            of the angle; none lies between 0 and 1e-12 rad, which shows in the
            error of a phase function with a very steep head.

        Raises
        ------
        ValueError
            If the size is below 16.
        """
        if size < 16:
            raise ValueError(f"size must be at least 16 cells, got {size}")
        # Half of the nodes by fraction, half by decades above a fraction of 1e-6.
        dense = np.geomspace(INNERMOST_ANGLE, np.pi, 4096)
        dense[-1] = np.pi
        fraction = np.maximum.accumulate(self.cumulative(dense))
        start = min(int(np.searchsorted(fraction, 1e-6)), dense.size // 2)
        decades = np.log(dense[start:] / dense[start])
        measure = (fraction[start:] - fraction[start]) / (
            fraction[-1] - fraction[start]
        )
        measure = (measure + decades / decades[-1]) / 2
        logs = np.interp(np.linspace(0, 1, size), measure, np.log(dense[start:]))
        angle = np.concatenate([[0.0], np.minimum(np.exp(logs), np.pi)])
        angle[-1] = np.pi
        height = np.sin(angle / 2) ** 2
        cumulative = np.maximum.accumulate(self.cumulative(angle))
        cumulative[0], cumulative[-1] = 0.0, 1.0
        np.minimum(cumulative, 1.0, out=cumulative)
        part = np.arange(1, 16)[:, np.newaxis] / 16
        # Squares of the parts, as the peak lies at the lower end of a cell.
        inside = height[:-1] + part**2 * np.diff(height)
        drawn = cumulative[:-1] + part**2 * np.diff(cumulative)
        true = self.cumulative(2 * np.arcsin(np.sqrt(inside)))
        return SamplingTable(cumulative, height, float(np.abs(drawn - true).max()))


def _split(value: float) -> float:
    """Return a split angle; ValueError if too close to 0 or above pi."""
    return float(checked_split_angle(value, above=INNERMOST_ANGLE))
