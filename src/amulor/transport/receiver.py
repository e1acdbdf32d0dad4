"""Laser source, receivers and plane target of a transport problem."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics.polarization import stokes as _stokes
from amulor.optics.polarization.depolarization import realizability_defect
from amulor.transport._checks import (
    above,
    at_least,
    at_most,
    axes_of,
    place,
    unit_vector,
)
from amulor.transport.scattering import REALIZABILITY_TOLERANCE

__all__ = ["DiscReceiver", "GaussianReceiver", "PlaneTarget", "Source"]

_ORIGIN = (0.0, 0.0, 0.0)
_FORWARD = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Source:
    """Laser beam, infinitely thin or with Gaussian profile and divergence.

    Raises
    ------
    ValueError
        If a width is below zero, the divergence above 0.5 rad, the direction is zero or
        along the axis to the right, or the polarization is not physical.

    Examples
    --------
    A vertical polarization, against the axis to the right:

    >>> from amulor.transport import Source
    >>> print(Source(polarization="V", radius=1e-3).stokes + 0.0)
    [ 1. -1.  0.  0.]
    """

    position: ArrayLike = _ORIGIN
    """Center of the beam at its start: right, down, forward [m]."""
    direction: ArrayLike = _FORWARD
    """Direction of the beam, a vector of any length."""
    polarization: str | ArrayLike = "none"
    """Polarization state, by name as in `optics.polarization.stokes.state`, or as a
    Stokes vector with an intensity of 1. Its parallel axis is the part of "right"
    perpendicular to the direction."""
    radius: float = 0.0
    """Radius at which the irradiance falls to 1/e; 0 for a thin beam [m]."""
    divergence: float = 0.0
    """Half-angle at which the radiant intensity falls to 1/e [rad]."""
    stokes: NDArray[np.float64] = field(init=False, repr=False)
    """Stokes vector of the launched light."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid beam or polarization."""
        place(self.position, name="position")
        axes_of(unit_vector(self.direction, name="direction"), name="direction")
        at_least(self.radius, 0.0, name="radius", unit="m")
        at_least(self.divergence, 0.0, name="divergence", unit="rad")
        if self.divergence > 0.5:
            raise ValueError(
                f"divergence must not exceed 0.5 rad, got {self.divergence:g} rad"
            )
        if isinstance(self.polarization, str):
            vector = _stokes.state(self.polarization)
        else:
            vector = np.array(self.polarization, dtype=np.float64)
        if vector.shape != (4,) or not abs(vector[0] - 1) < 1e-12:
            raise ValueError(
                "polarization must be a Stokes vector of four numbers with an "
                f"intensity of 1, got {self.polarization!r}"
            )
        degree = float(np.linalg.norm(vector[1:]))
        if not degree <= 1 + 1e-9:
            raise ValueError(
                f"polarization must not have a degree above 1, got {degree:.6g}"
            )
        object.__setattr__(self, "stokes", vector)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Receiver:
    """Base class of receivers: position, axis and size."""

    radius: float
    """Radius of the receiver face [m]."""
    acceptance_angle: float
    """Half-angle of the acceptance cone, up to pi / 2 [rad]."""
    position: ArrayLike = _ORIGIN
    """Center of the receiver face: right, down, forward [m]."""
    direction: ArrayLike = _FORWARD
    """Viewing direction, a vector of any length."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid size, position or direction."""
        above(self.radius, 0.0, name="radius", unit="m")
        at_most(self.acceptance_angle, np.pi / 2, name="acceptance_angle", unit="rad")
        place(self.position, name="position")
        axes_of(unit_vector(self.direction, name="direction"), name="direction")


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscReceiver(_Receiver):
    """Round receiver with a sharp aperture and a sharp acceptance cone.

    With an acceptance of pi / 2 it receives all light that falls on its front.

    Examples
    --------
    >>> from amulor.transport import DiscReceiver
    >>> disc = DiscReceiver(radius=0.05, acceptance_angle=0.035, position=(0.07, 0, 0))
    >>> print(disc.position)
    (0.07, 0, 0)
    """


@dataclass(frozen=True, eq=False, kw_only=True)
class GaussianReceiver(_Receiver):
    r"""Receiver with Gaussian aperture and acceptance, eq. (38) of Ricci et al. 2010.

    It receives the fraction :math:`\exp(-s^2/R^2 - \theta^2/\gamma^2)` of the light
    that falls on it at a distance s from its centre, under an angle to its axis.

    Examples
    --------
    >>> from amulor.transport import GaussianReceiver
    >>> eye = GaussianReceiver(
    ...     radius=0.02, acceptance_angle=0.08, position=(0.07, 0, 0)
    ... )
    >>> eye.acceptance_angle
    0.08
    """


#: Range of the rms slope of the facets of a glossy target.
_SLOPES = (0.02, 0.5)


def reflection_matrix(
    reflectance: float, mueller: ArrayLike | None, gloss: float, rms_slope: float
) -> NDArray[np.float64]:
    """Return a surface's reduced Mueller matrix; ValueError if not physical."""
    if not 0 <= reflectance <= 1:
        raise ValueError(f"reflectance must be from 0 to 1, got {reflectance!r}")
    if not 0 <= gloss <= 1 - reflectance:
        raise ValueError(
            "gloss must be from 0 to 1, and with the reflectance not above 1, got "
            f"{gloss!r} and {reflectance!r}"
        )
    if gloss > 0 and not _SLOPES[0] <= rms_slope <= _SLOPES[1]:
        raise ValueError(
            f"rms_slope of a glossy target must be from {_SLOPES[0]:g} to "
            f"{_SLOPES[1]:g}, got {rms_slope!r}"
        )
    elements = np.diag([1.0, 0, 0, 0]) if mueller is None else mueller
    matrix = np.array(elements, dtype=np.float64)
    if matrix.shape != (4, 4) or abs(matrix[0, 0] - 1) > 1e-12:
        raise ValueError(
            "mueller must have the shape (4, 4) and a first element of 1; put the "
            "reflected fraction into reflectance"
        )
    if not np.all(np.isfinite(matrix)):
        raise ValueError("mueller must hold finite numbers")
    defect = float(realizability_defect(matrix))
    if defect > REALIZABILITY_TOLERANCE:
        raise ValueError(
            "mueller cannot exist: its coherency matrix has an eigenvalue of "
            f"{-defect:.3g} of its trace"
        )
    return matrix


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaneTarget:
    """Infinite plane as a target, Lambertian or glossy.

    Raises
    ------
    ValueError
        If reflectance or gloss is out of range, the normal is zero, or the matrix is
        not physical.

    Examples
    --------
    >>> from amulor.transport import PlaneTarget
    >>> plate = PlaneTarget(position=(0, 0, 2.0), reflectance=0.2)
    >>> print(plate.matrix[0, 0])
    1.0
    """

    position: ArrayLike
    """A point on the plane: right, down, forward [m]."""
    normal: ArrayLike = (0.0, 0.0, -1.0)
    """Normal on the illuminated side, a vector of any length."""
    reflectance: float
    """Diffuse reflectance [1]."""
    mueller: ArrayLike | None = None
    """Matrix of diffuse light over its first element, an ideal depolarizer if not
    given. It leads from the part of the scene's axis to the right that is perpendicular
    to the light before the reflection to that after it, wherever the receiver looks."""
    gloss: float = 0.0
    """Fraction of the light that falls on facets which mirror it, up to 1 less the
    reflectance [1]."""
    rms_slope: float = 0.0
    """Root mean square slope of these facets along one axis, 0.02 to 0.5 [1]."""
    matrix: NDArray[np.float64] = field(init=False, repr=False)
    """Reduced Mueller matrix, shape (4, 4)."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid plane, reflectance or matrix."""
        place(self.position, name="position")
        unit_vector(self.normal, name="normal")
        matrix = reflection_matrix(
            self.reflectance, self.mueller, self.gloss, self.rms_slope
        )
        object.__setattr__(self, "matrix", matrix)


Receiver = DiscReceiver | GaussianReceiver
