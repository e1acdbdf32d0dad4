"""Water signal and overlap by the small-angle diffusion model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics import _bounds
from amulor.optics._bounds import broadcast, require
from amulor.optics._quadrature import RULE
from amulor.optics._water_column import (
    Receiver,
    checked,
    phase_per_depth,
    refuse_behind_receiver,
)
from amulor.optics.small_angle_diffusion import _kernels

__all__ = [
    "narrow_receiver_response",
    "overlap",
    "water_response",
    "water_tail",
]


# Column length below which the signal is 0 in double precision [m].
_SMALLEST_LENGTH = 1e-250


@dataclass(frozen=True, kw_only=True)
class _Column(Receiver):
    """Checked water and receiver arguments of the diffusion model."""

    absorption: Any
    forward_scattering: Any
    diffuse_scattering: Any
    second_moment: Any

    @property
    def reduced_attenuation(self) -> Any:
        """Reduced one-way attenuation k' = a + b_d [1/m]."""
        return self.absorption + self.diffuse_scattering

    @property
    def spreading(self) -> Any:
        """Factor (2/3) b_f <theta^2> of z^3 in the squared width, eq. (43) [1/m]."""
        return 2 / 3 * self.forward_scattering * self.second_moment


def _light_of(
    column: _Column,
    *,
    modulation_frequency: ArrayLike,
    group_index: ArrayLike,
    backscatter_vsf: ArrayLike,
    start: ArrayLike,
    end: ArrayLike,
) -> NDArray[np.complex128]:
    """Return the water signal of eq. (46) between two depths."""
    refuse_behind_receiver(column.standoff)
    phases = phase_per_depth(modulation_frequency, group_index=group_index)
    vsf = checked("backscatter_vsf", backscatter_vsf)
    # For the caller, both limits are the end of the water.
    start, end = checked("end", start), checked("end", end)
    try:
        return _integral(column, phases, vsf, start, end)
    except ValueError:
        # Names the arguments that do not broadcast.
        _bounds.broadcast(
            modulation_frequency=phases,
            **column.named(),
            backscatter_vsf=vsf,
            end=end if np.ndim(end) else start,
        )
        raise


def _integral(
    column: _Column,
    phase_per_depth: NDArray[np.float64],
    vsf: Any,
    start: Any,
    end: Any,
) -> NDArray[np.complex128]:
    radius, acceptance = column.receiver_radius, column.acceptance_angle
    factor = np.pi * vsf * (radius * acceptance) ** 2
    geometry = _kernels.Geometry(
        reduced_attenuation=column.reduced_attenuation,
        spreading=column.spreading,
        baseline=column.baseline,
        receiver_radius=radius,
        acceptance_angle=acceptance,
        tilt=column.tilt,
        cross_tilt=column.cross_tilt,
        standoff=column.standoff,
        start=start * (start > _SMALLEST_LENGTH),
        end=end * (end > _SMALLEST_LENGTH),
    )
    if set(map(type, geometry)) == {float}:
        result = _integrals(np.array([geometry]), phase_per_depth.reshape(1, -1))
        return np.asarray(factor * result.reshape(phase_per_depth.shape))
    inner = np.broadcast_shapes(*(np.shape(value) for value in geometry))
    table = np.empty((*inner, len(geometry)))
    for i, value in enumerate(geometry):
        table[..., i] = value
    rows = table.reshape(-1, len(geometry))
    # Axes along which the water changes come first; along the others a column is
    # laid out in panels once for all frequencies.
    shape = np.broadcast_shapes(phase_per_depth.shape, inner)
    inner = (1,) * (len(shape) - len(inner)) + inner
    first = [axis for axis, size in enumerate(inner) if size != 1]
    axes = first + [axis for axis, size in enumerate(inner) if size == 1]
    outer = (1,) * (len(shape) - phase_per_depth.ndim) + phase_per_depth.shape
    if any(outer[axis] != 1 for axis in first):
        phases = np.broadcast_to(phase_per_depth, shape).transpose(axes)
        phases = phases.reshape(len(rows), -1)
    else:
        phases = phase_per_depth.reshape(outer).transpose(axes).reshape(1, -1)
    result = _integrals(rows, phases).reshape([shape[axis] for axis in axes])
    return np.asarray(factor * result.transpose(np.argsort(axes)))


def _integrals(
    rows: NDArray[np.float64], phase_per_depth: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return depth integrals of exp(i w z) times the overlap, for w in any order."""
    out = np.empty((len(rows), phase_per_depth.shape[1]), dtype=complex)
    # Copied, since a view may be read-only, for which the kernel is compiled again.
    phases = np.array(phase_per_depth, order="C")
    unresolved = _kernels.water_column(rows, phases, RULE, out)
    if unresolved < 0:
        order = np.argsort(phase_per_depth, axis=1)
        rising = np.take_along_axis(phase_per_depth, order, axis=1)
        back = np.argsort(order, axis=1)
        return np.take_along_axis(_integrals(rows, rising), back, axis=1)
    if unresolved > 0:
        raise ArithmeticError(
            f"{unresolved} of {len(rows)} water columns cannot be integrated in double "
            "precision; receiver_radius or acceptance_angle may be far too small"
        )
    return out


def water_response(
    modulation_frequency: ArrayLike,
    *,
    absorption: ArrayLike,
    forward_scattering: ArrayLike,
    diffuse_scattering: ArrayLike,
    second_moment: ArrayLike,
    backscatter_vsf: ArrayLike,
    group_index: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
    end: ArrayLike = np.inf,
) -> NDArray[np.complex128]:
    r"""Return the water signal from depths between the instrument and a given depth.

    All arguments are broadcast against each other.

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, not negative [Hz].
    absorption : array_like
        Absorption coefficient a [1/m].
    forward_scattering : array_like
        Forward part b_f of the scattering coefficient [1/m].
    diffuse_scattering : array_like
        Other part b_d of the scattering coefficient, of the same split [1/m].
    second_moment : array_like
        Second moment <theta^2> of the forward part of the phase function [rad^2].
    backscatter_vsf : array_like
        Volume scattering function beta_pi at 180 degrees [1/(m sr)].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].
    baseline : array_like
        Distance rho_0 of laser beam and receiver axis at the instrument [m].
    receiver_radius : array_like
        1/e radius R of the receiver aperture [m].
    acceptance_angle : array_like
        1/e semi-angle gamma of the receiver, in water [rad].
    tilt : array_like, optional
        Inclination of the beam against the receiver axis in the plane of the
        baseline, in water, positive towards the receiver [rad].
    cross_tilt : array_like, optional
        Inclination across the plane of the baseline, in water [rad].
    standoff : array_like, optional
        Path in front of the water, as the depth of water in which light spreads
        equally, without attenuation and delay: air behind a flat window counts with its
        length times the phase index of the water [m].
    end : array_like, optional
        Depth of the end of the water, or of a target [m]; open water if infinite.

    Returns
    -------
    ndarray of complex
        Received per launched power, of the broadcast shape [1]. The phase is the delay
        of the echo relative to light returned at the start of the water.

    Raises
    ------
    ValueError
        If an argument is outside its range or, except for `end`, not finite.
    ArithmeticError
        If the integral cannot be resolved in double precision.

    See Also
    --------
    water_tail : Water signal from behind the end.
    overlap : The integrand.
    amulor.optics.phase_functions.integrals.forward_split : Arguments for a split angle.
    amulor.optics.small_angle.water_response : Slower, keeps unscattered light.

    Notes
    -----
    Eq. (46) of Ricci et al. 2010 [1]_, as rederived, conjugated so that a later echo
    has the larger phase, :math:`\beta_\pi \int_0^{end} F(z) \exp(2 i \omega z n_g /
    c)\, dz`. The integral exists for every allowed water, also without losses,
    because F(z) falls at least with the square of the depth.

    The split between forward and diffuse scattering determines the accuracy of the
    model, as it spreads all light by the second moment, including unscattered light.
    Compared with the small-angle model split at 90 degrees, for attenuations from 0.1
    to 2 1/m and phase functions of natural water, a split of 90 degrees makes the
    cut-off 57 to 83 % too high, and the echo of a plane at 3.9 m a quarter as strong.
    With 10 to 20 degrees the cut-off is 5 to 26 % too high up to 0.5 1/m.

    F(z) is written as Legendre series over a few panels laid out about its maxima, and
    each term is integrated in closed form, so the cost hardly depends on the frequency.
    The error is below 1e-12 of the response at zero frequency for baselines up to 0.5
    m, apertures from 1 mm and acceptances from 1 mrad. If the receiver's view meets the
    beam so far out that less than exp(-700) of the light remains, the response is
    exactly zero.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> response = water_response(
    ...     [0.0, 18.85e6], absorption=0.0, forward_scattering=0.0,
    ...     diffuse_scattering=0.5, second_moment=0.0, backscatter_vsf=1e-3,
    ...     group_index=1.34, baseline=0.2, receiver_radius=0.02,
    ...     acceptance_angle=0.08,
    ... )
    >>> print(f"{abs(response[1] / response[0]):.3f}")
    0.707
    """
    column = _Column(
        absorption=absorption,
        forward_scattering=forward_scattering,
        diffuse_scattering=diffuse_scattering,
        second_moment=second_moment,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
    )
    return _light_of(
        column,
        modulation_frequency=modulation_frequency,
        group_index=group_index,
        backscatter_vsf=backscatter_vsf,
        start=0.0,
        end=end,
    )


def overlap(
    depth: ArrayLike,
    *,
    absorption: ArrayLike,
    forward_scattering: ArrayLike,
    diffuse_scattering: ArrayLike,
    second_moment: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    r"""Return the overlap F(z) of beam and receiver at a depth [sr].

    Parameters
    ----------
    depth : array_like
        Depth z in the water along the receiver axis, not negative [m].
    absorption, forward_scattering, diffuse_scattering, second_moment, baseline, \
    receiver_radius, acceptance_angle, tilt, cross_tilt, standoff : array_like
        As in `water_response`.

    Returns
    -------
    ndarray
        F(z), of the broadcast shape; times the volume scattering function at 180
        degrees and a step of depth it is received over launched power [sr].

    Raises
    ------
    ValueError
        If an argument is not finite or outside its range.

    Notes
    -----
    Eq. (43) of Ricci et al. 2010 [1]_, as rederived, with the beam tilted by
    :math:`\mathbf n_0` and with :math:`\zeta = z +` standoff,

    .. math:: F(z) = \frac{\pi R^2 \gamma^2}{S(z)} \exp\Bigl[-2 (a + b_d) z
       - \frac{|\boldsymbol\rho_0 - \mathbf n_0 \zeta|^2}{S(z)}\Bigr], \quad
       S(z) = R^2 + \gamma^2 \zeta^2 + \tfrac23 b_f \langle\theta^2\rangle z^3 .

    Valid for small angles. Unscattered light is spread like scattered light.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> taken = overlap(
    ...     1.5, absorption=0.15, forward_scattering=0.35, diffuse_scattering=0.0,
    ...     second_moment=0.05, baseline=0.2, receiver_radius=0.02,
    ...     acceptance_angle=0.08,
    ... )
    >>> print(f"{taken:.2e} sr")
    4.52e-05 sr
    """
    z = checked("depth", depth)
    column = _Column(
        absorption=absorption,
        forward_scattering=forward_scattering,
        diffuse_scattering=diffuse_scattering,
        second_moment=second_moment,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
    )
    try:
        return _overlap(z, column)
    except ValueError:
        # Names the arguments that do not broadcast.
        broadcast(depth=z, **column.named())
        raise


def _overlap(z: Any, column: _Column) -> NDArray[np.float64]:
    """Return the overlap F(z) of beam and receiver, eq. (43) [sr]."""
    path = z + column.standoff
    refuse_behind_receiver(column.standoff, z)
    area = column.receiver_radius**2 + (column.acceptance_angle * path) ** 2
    area = area + column.spreading * z**3
    offset = (column.baseline - column.tilt * path) ** 2
    offset = offset + (column.cross_tilt * path) ** 2
    loss = 2 * column.reduced_attenuation * z + offset / area
    etendue = np.pi * (column.receiver_radius * column.acceptance_angle) ** 2
    return np.asarray(etendue / area * np.exp(-loss))


def water_tail(
    modulation_frequency: ArrayLike,
    *,
    absorption: ArrayLike,
    forward_scattering: ArrayLike,
    diffuse_scattering: ArrayLike,
    second_moment: ArrayLike,
    backscatter_vsf: ArrayLike,
    group_index: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
    end: ArrayLike = np.inf,
) -> NDArray[np.complex128]:
    r"""Return the water signal from depths beyond a given depth.

    This is the excess of the open-water signal over that of a scene in which a target
    ends the water.

    Parameters
    ----------
    modulation_frequency, absorption, forward_scattering, diffuse_scattering, \
    second_moment, backscatter_vsf, group_index, baseline, receiver_radius, \
    acceptance_angle, tilt, cross_tilt, standoff : array_like
        As in `water_response`.
    end : array_like, optional
        Depth at which the water begins to contribute [m].

    Returns
    -------
    ndarray of complex
        Received per launched power, of the broadcast shape [1], with the phase of
        `water_response`. It is integrated from `end` on, not subtracted: its
        error is below 1e-12 of its own value at zero frequency.

    Raises
    ------
    ValueError
        If an argument is outside its range or, except for `end`, not finite.
    ArithmeticError
        If the integral cannot be resolved in double precision.

    Notes
    -----
    Eq. (46) of Ricci et al. 2010 [1]_, as rederived and conjugated, from `end` to
    infinity.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> water = dict(
    ...     absorption=0.0, forward_scattering=0.0, diffuse_scattering=0.5,
    ...     second_moment=0.0, backscatter_vsf=1e-3, group_index=1.34,
    ...     baseline=0.2, receiver_radius=0.02, acceptance_angle=0.08,
    ... )
    >>> fraction = water_tail(0.0, end=3.7, **water) / water_response(0.0, **water)
    >>> print(f"{fraction.real:.3f}")
    0.069
    """
    column = _Column(
        absorption=absorption,
        forward_scattering=forward_scattering,
        diffuse_scattering=diffuse_scattering,
        second_moment=second_moment,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
    )
    return _light_of(
        column,
        modulation_frequency=modulation_frequency,
        group_index=group_index,
        backscatter_vsf=backscatter_vsf,
        start=end,
        end=np.inf,
    )


def narrow_receiver_response(
    modulation_frequency: ArrayLike,
    *,
    absorption: ArrayLike,
    diffuse_scattering: ArrayLike,
    backscatter_vsf: ArrayLike,
    group_index: ArrayLike,
    acceptance_angle: ArrayLike,
) -> NDArray[np.complex128]:
    r"""Return the open-water signal of a coaxial receiver with very small acceptance.

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, not negative [Hz].
    absorption : array_like
        Absorption coefficient a [1/m].
    diffuse_scattering : array_like
        Scattering coefficient b_d beyond the forward part [1/m].
    backscatter_vsf : array_like
        Volume scattering function beta_pi at 180 degrees [1/(m sr)].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].
    acceptance_angle : array_like
        1/e semi-angle gamma of the receiver, in water [rad].

    Returns
    -------
    ndarray of complex
        Received per launched power, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is not finite or outside its range, or if absorption and
        diffuse scattering are both zero.

    Notes
    -----
    Eq. (49) of Ricci et al. 2010 [1]_, as rederived and conjugated,
    :math:`\beta_\pi \pi \gamma^2 / 2 (k' - i \omega n_g / c)` with
    :math:`k' = a + b_d`: the limit of `water_response` for baseline 0, no forward
    scattering and :math:`\gamma \ll 2 k' R`. It does not depend on the aperture.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> response = narrow_receiver_response(
    ...     [0.0, 17.8e6], absorption=0.15, diffuse_scattering=0.35,
    ...     backscatter_vsf=1e-3, group_index=1.34, acceptance_angle=1e-3,
    ... )
    >>> print(f"{abs(response[1] / response[0]):.3f}")
    0.707
    """
    f = checked("modulation_frequency", modulation_frequency)
    n_g = checked("group_index", group_index)
    a = checked("absorption", absorption)
    b_d = checked("diffuse_scattering", diffuse_scattering)
    vsf = checked("backscatter_vsf", backscatter_vsf)
    acceptance = checked("acceptance_angle", acceptance_angle)
    broadcast(
        modulation_frequency=f,
        group_index=n_g,
        absorption=a,
        diffuse_scattering=b_d,
        backscatter_vsf=vsf,
        acceptance_angle=acceptance,
    )
    loss = np.asarray(a + b_d)
    require(
        loss,
        loss > 0,
        name="absorption + diffuse_scattering",
        rule="above 0",
        unit="1/m",
        hint="this limit needs a loss",
    )
    rate = loss - 2j * np.pi / speed_of_light * f * n_g
    return np.asarray(np.pi / 2 * vsf * acceptance**2 / rate)
