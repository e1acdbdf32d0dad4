r"""Mie scattering by spheres: efficiencies, phase function and Mueller matrix.

Efficiencies and the coefficients of the series come from the package miepython (extra
``mie``). Indices are :math:`n + ik` with :math:`k > 0` for absorption, amplitudes go
with :math:`e^{-i \omega t}`, as in `amulor.optics.polarization.stokes`; Wiscombe [2]_
and the amplitudes of miepython have both conjugated.

References
----------
.. [1] C. F. Bohren and D. R. Huffman, Absorption and Scattering of Light by Small
   Particles, Wiley (1983), chapter 4, :doi:`10.1002/9783527618156`.
.. [2] W. J. Wiscombe, Appl. Opt. 19, 1505 (1980), :doi:`10.1364/AO.19.001505`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import MissingExtraError
from amulor.optics._bounds import (
    checked_angle,
    not_negative,
    positive,
    require,
    within,
)
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import tabulated
from amulor.optics.polarization.mueller import particles

__all__ = ["Sphere", "Suspension", "amplitudes", "size_distribution", "sphere"]

LARGEST_SIZE_PARAMETER = 2e4
"""Largest size parameter; published tables for comparison end at 1e4 [1]."""


class Sphere(NamedTuple):
    """Mie efficiencies of a sphere: cross sections over its geometric cross section.

    Examples
    --------
    What is neither scattered nor passed is absorbed:

    >>> from amulor.optics.phase_functions.mie import Sphere
    >>> one = Sphere(extinction=2.1, scattering=2.0, backscattering=0.3, asymmetry=0.9)
    >>> print(f"{one.extinction - one.scattering:.1f}")
    0.1
    """

    extinction: float
    """Extinction efficiency [1]."""
    scattering: float
    """Scattering efficiency [1]."""
    backscattering: float
    """Radar efficiency: 4 pi times backscatter cross section per sr, over area [1]."""
    asymmetry: float
    """Mean cosine of the scattering angle [1]."""


def sphere(size_parameter: float, *, relative_index: complex) -> Sphere:
    r"""Return the Mie efficiencies of a sphere, and its mean scattering cosine.

    Parameters
    ----------
    size_parameter : float
        Circumference over the wavelength in the medium, above 0 to 2e4 [1].
    relative_index : complex
        Index :math:`n + ik` of the sphere over that of the medium, n above 0, k not
        negative [1].

    Returns
    -------
    Sphere
        Extinction, scattering and backscattering efficiency, asymmetry.

    Raises
    ------
    ValueError
        If an argument is outside of its range.
    MissingExtraError
        If miepython is not installed.

    Notes
    -----
    Refs. [1] and [2] of this module. The backscattering efficiency is
    :math:`|2 S_1(\pi) / x|^2`.

    Examples
    --------
    >>> droplet = sphere(100.0, relative_index=1.33 + 1e-5j)
    >>> print(f"{droplet.scattering:.6f} {droplet.asymmetry:.6f}")
    2.096594 0.868959
    """
    x, m = _checked_size(size_parameter), _checked_index(relative_index)
    values = _miepython().efficiencies_mx(m.conjugate(), x)
    return Sphere(*(float(value) for value in values))


def amplitudes(
    angle: ArrayLike, *, size_parameter: float, relative_index: complex
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    r"""Return the complex scattering amplitudes of one sphere.

    Parameters
    ----------
    angle : array_like
        Scattering angle, 0 to pi [rad].
    size_parameter : float
        Circumference over the wavelength in the medium, above 0 to 2e4 [1].
    relative_index : complex
        Index :math:`n + ik` of the sphere over that of the medium, n above 0, k not
        negative [1].

    Returns
    -------
    perpendicular : ndarray
        :math:`S_1`, for the field across the scattering plane, shape of `angle` [1].
    parallel : ndarray
        :math:`S_2`, for the field in the scattering plane, shape of `angle` [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.
    MissingExtraError
        If miepython is not installed.

    Notes
    -----
    Ref. [1], eq. (4.74), for :math:`e^{-i \omega t}`. The cross section per steradian
    is :math:`(|S_1|^2 + |S_2|^2) / 2 k^2` for unpolarized light.

    Examples
    --------
    >>> s1, s2 = amplitudes(0.0, size_parameter=1.0, relative_index=1.5 + 1j)
    >>> print(f"{s1:.4f} {s2:.4f}")
    0.5841-0.1905j 0.5841-0.1905j
    """
    theta = checked_angle(angle, name="angle")
    x, m = _checked_size(size_parameter), _checked_index(relative_index)
    s1, s2 = _amplitudes(np.cos(theta.ravel()), x=np.array([x]), m=m)
    return s1[0].reshape(theta.shape), s2[0].reshape(theta.shape)


@dataclass(frozen=True, eq=False, kw_only=True)
class Suspension:
    """Scattering properties of a suspension of spheres of many sizes.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics.phase_functions.mie import Suspension
    >>> angle = np.linspace(0, np.pi, 181)
    >>> nothing = np.zeros(181)
    >>> even = Suspension(  # isotropic, and depolarizing
    ...     scattering=0.5, extinction=0.6, asymmetry=0.0, angle=angle,
    ...     value=np.full(181, 1 / (4 * np.pi)), m12=nothing, m33=nothing, m34=nothing,
    ... )
    >>> print(f"{even.phase_function.integral:.3f}")
    1.000
    """

    scattering: float
    """Scattering coefficient b [1/m]."""
    extinction: float
    """Attenuation coefficient of the spheres, without the medium's absorption [1/m]."""
    asymmetry: float
    """Mean cosine of the scattering angle, from the Mie series [1]."""
    angle: NDArray[np.float64]
    """Angles of the tabulated phase function and matrix, from 0 to pi [rad]."""
    value: NDArray[np.float64]
    """Phase function at the tabulated angles, for unpolarized light [1/sr]."""
    m12: NDArray[np.float64]
    """Mueller element m12 = m21 over m11 [1]."""
    m33: NDArray[np.float64]
    """Mueller element m33 = m44 over m11 [1]."""
    m34: NDArray[np.float64]
    """Mueller element m34 = -m43 over m11 [1]."""

    @cached_property
    def phase_function(self) -> PhaseFunction:
        """Tabulated phase function; its `integral` should be close to 1."""
        return tabulated(self.angle, value=self.value, name="Mie suspension")

    def mueller(self, angle: ArrayLike) -> NDArray[np.float64]:
        r"""Return the reduced Mueller matrix at scattering angles, interpolated.

        Parameters
        ----------
        angle : array_like
            Scattering angle, 0 to pi [rad].

        Returns
        -------
        ndarray
            Mueller matrix over its first element, shape of `angle` with last axes
            (4, 4) [1]. The parallel axis lies in the scattering plane.

        Raises
        ------
        ValueError
            If an angle is outside of its range.

        Notes
        -----
        Ref. [1] of this module, eq. (4.77), in the convention of
        `amulor.optics.polarization.stokes`, where m34 has the other sign. At 180
        degrees it is diag(1, 1, -1, -1).
        """
        theta = checked_angle(angle, name="angle")
        m12, m33, m34 = (
            np.interp(theta, self.angle, element)
            for element in (self.m12, self.m33, self.m34)
        )
        return particles(m12=m12, m22=1.0, m33=m33, m34=m34, m44=m33)


def size_distribution(
    diameter: ArrayLike,
    *,
    number: ArrayLike,
    wavelength: float,
    particle_index: complex,
    medium_index: float,
    angle: ArrayLike | None = None,
) -> Suspension:
    r"""Return the scattering properties of a suspension of spheres of given sizes.

    Parameters
    ----------
    diameter : array_like
        Diameters of the spheres, above 0, 1-D or one [m].
    number : array_like
        Number of spheres of each diameter per volume, not negative, of the same shape;
        a continuous distribution times the steps of the diameter [1/m^3].
    wavelength : float
        Wavelength in vacuum [m].
    particle_index : complex
        Index :math:`n + ik` of the spheres, k not negative [1].
    medium_index : float
        Phase index of the medium, which does not absorb [1].
    angle : array_like, optional
        Angles of the table, rising from 0 to pi, 1-D [rad]. By default 32 angles for
        each lobe of the largest sphere, at least 721.

    Returns
    -------
    Suspension
        Coefficients, phase function and matrix.

    Raises
    ------
    ValueError
        If an argument is outside of its range.
    MissingExtraError
        If miepython is not installed.

    Notes
    -----
    Single scattering without correlation between the spheres, valid up to about 1 % of
    the volume. With the wavenumber k in the medium,

    .. math::

       b \, p = \sum N \frac{|S_1|^2 + |S_2|^2}{2 k^2}, \qquad
       b \, p \, (m_{33} - i m_{34}) = \sum N \frac{S_2 S_1^*}{k^2}.

    The table lies within 2e-3 of the scattering of the series, as its `integral`
    shows.

    Examples
    --------
    >>> beads = size_distribution(
    ...     1e-6,
    ...     number=1e12,
    ...     wavelength=532e-9,
    ...     particle_index=1.5979,
    ...     medium_index=1.3349,
    ... )
    >>> print(f"b = {beads.scattering:.3f} 1/m, g = {beads.asymmetry:.6f}")
    b = 2.513 1/m, g = 0.926112
    """
    sizes, counts = np.broadcast_arrays(
        np.atleast_1d(np.asarray(diameter, dtype=np.float64)),
        np.atleast_1d(np.asarray(number, dtype=np.float64)),
    )
    if sizes.ndim != 1 or np.shape(diameter) != np.shape(number):
        raise ValueError(
            "diameter and number must be of one shape, 1-D or one value; got shapes "
            f"{np.shape(diameter)} and {np.shape(number)}"
        )
    not_negative(counts, name="number", unit="1/m^3")
    most = counts.max()
    require(most, most > 0, name="the largest number", rule="above 0", unit="1/m^3")
    positive(sizes, name="diameter", unit="m")
    positive(wavelength, name="wavelength", unit="m")
    positive(medium_index, name="medium_index")
    optical_wavenumber = 2 * np.pi * medium_index / wavelength
    x = np.array([_checked_size(size) for size in optical_wavenumber * sizes / 2])
    index = complex(particle_index) / medium_index
    theta = _angles(angle, largest=float(x[counts > 0].max()))
    spheres = [sphere(float(size), relative_index=index) for size in x]
    extinction, scattering, _, asymmetry = np.array(spheres).T
    area = counts * np.pi * sizes**2 / 4
    total = float(area @ scattering)
    cosine = np.cos(theta)
    perpendicular, parallel, crossed = np.zeros((3, theta.size), dtype=np.complex128)
    step = max(1, 2_000_000 // theta.size)  # sizes at once, for the memory
    for first in range(0, x.size, step):
        part = slice(first, first + step)
        s1, s2 = _amplitudes(cosine, x=x[part], m=index)
        perpendicular += counts[part] @ np.abs(s1) ** 2
        parallel += counts[part] @ np.abs(s2) ** 2
        crossed += counts[part] @ (s2 * np.conj(s1))
    intensity = (parallel + perpendicular).real / 2
    return Suspension(
        scattering=total,
        extinction=float(area @ extinction),
        asymmetry=float(area @ (scattering * asymmetry)) / total,
        angle=theta,
        value=intensity / optical_wavenumber**2 / total,
        m12=(parallel - perpendicular).real / 2 / intensity,
        m33=crossed.real / intensity,
        m34=-crossed.imag / intensity,
    )


def _amplitudes(
    cosine: NDArray[np.float64], *, x: NDArray[np.float64], m: complex
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the scattering amplitudes S1 and S2 of spheres, shape (size, angle)."""
    package = _miepython()
    pairs = [package.coefficients(m.conjugate(), float(size)) for size in x]
    terms = max(len(electric) for electric, _ in pairs)
    a, b = np.zeros((2, x.size, terms), dtype=np.complex128)
    for row, (electric, magnetic) in enumerate(pairs):
        a[row, : len(electric)] = electric
        b[row, : len(magnetic)] = magnetic
    s1, s2 = np.zeros((2, x.size, cosine.size), dtype=np.complex128)
    # Angular functions pi_n and tau_n by eqs. (4.47) of Bohren and Huffman.
    before, now = np.zeros_like(cosine), np.ones_like(cosine)
    for n in range(1, terms + 1):
        slope = n * cosine * now - (n + 1) * before
        weight = (2 * n + 1) / (n * (n + 1))
        electric, magnetic = weight * a[:, n - 1, None], weight * b[:, n - 1, None]
        s1 += electric * now + magnetic * slope
        s2 += electric * slope + magnetic * now
        following = ((2 * n + 1) * cosine * now - (n + 1) * before) / n
        before, now = now, following
    return s1, s2


def _angles(angle: ArrayLike | None, *, largest: float) -> NDArray[np.float64]:
    """Return table angles, evenly spaced by default; ValueError unless from 0 to pi."""
    if angle is None:
        count = max(721, 1 + int(np.ceil(32 * largest)))
        return np.linspace(0, np.pi, count)
    theta = checked_angle(angle, name="angle")
    rising = theta.ndim == 1 and theta.size > 2 and np.all(np.diff(theta) > 0)
    if not rising or theta[0] != 0 or theta[-1] < np.pi - 1e-9:
        raise ValueError(
            "angle must be 1-D and rise from 0 to pi rad, got shape "
            f"{theta.shape} from {theta.flat[0]:g} to {theta.flat[-1]:g} rad"
        )
    return theta


def _checked_size(value: float) -> float:
    """Return a size parameter; ValueError if out of range."""
    hint = "it is the circumference over the wavelength in the medium"
    x = within(
        value, 0, LARGEST_SIZE_PARAMETER, name="size_parameter", above=True, hint=hint
    )
    return float(x)


def _checked_index(value: complex) -> complex:
    """Return a relative index n + ik; ValueError unless n > 0 and k >= 0."""
    m = complex(value)
    require(
        m,
        0 < m.real < np.inf and 0 <= m.imag < np.inf,
        name="relative_index",
        rule="n + ik with n above 0 and k not negative, both finite",
        hint="conjugate an index that is given as n - ik",
    )
    return m


def _miepython() -> Any:
    """Import miepython, the package that sums the Mie series."""
    try:
        return import_module("miepython")
    except ImportError as error:
        raise MissingExtraError(
            "miepython", extra="mie", purpose="Mie scattering"
        ) from error
