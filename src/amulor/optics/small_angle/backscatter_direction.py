r"""Direction distribution of backscattered light, and backscatter averaged over it.

The model of the water signal uses the volume scattering function at 180 degrees for all
light. These functions return the actual distribution of the scattering angle, and the
mean scattering function over it, by the small-angle diffusion model.

References
----------
.. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
   :doi:`10.1155/2010/958360`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from amulor.optics import small_angle_diffusion
from amulor.optics._bounds import broadcast, finite, not_negative, positive, require
from amulor.optics.phase_functions.integrals import gauss_legendre

__all__ = ["backscatter_direction", "effective_radiance", "mean_backscatter_vsf"]

Array = NDArray[np.float64]

_PANELS = 64  # of the deviation, 16 angles each


def backscatter_direction(
    depth: ArrayLike,
    *,
    forward_scattering: ArrayLike,
    second_moment: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
) -> tuple[Array, Array]:
    r"""Return mean and variance of the scattering angle's deviation from 180 degrees.

    Parameters
    ----------
    depth : array_like
        Depth z of the backscattering, not negative [m].
    forward_scattering, second_moment, baseline, receiver_radius, acceptance_angle : \
    array_like
        As in `amulor.optics.small_angle_diffusion.overlap`.

    Returns
    -------
    mean : ndarray
        Mean deviation from 180 degrees, in the plane of the baseline, of the
        broadcast shape [rad].
    variance : ndarray
        Variance about the mean of each of the two components [rad^2].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    First and second moment of the radiance (24) of Ricci et al. 2010 (ref. [1] of this
    module), as rederived, in the diffusion model: position and direction are jointly
    Gaussian, with the variances :math:`A = R^2/2 + \gamma^2 z^2/2 + 4 D z^3/3` and
    :math:`C = \gamma^2/2 + 4 D z` and the covariance
    :math:`B = \gamma^2 z/2 + 2 D z^2`. On the axis the mean is :math:`\rho_0 B / A` and
    the variance :math:`C - B^2 / A`. If they are small against the angles over which
    the scattering function near 180 degrees changes, its value at 180 degrees may be
    used, eq. (26).

    Examples
    --------
    >>> mean, variance = backscatter_direction(
    ...     1.5, forward_scattering=0.35, second_moment=0.05, baseline=0.2,
    ...     receiver_radius=0.02, acceptance_angle=0.08,
    ... )
    >>> print(f"{np.degrees(mean):.1f} +- {np.degrees(np.sqrt(variance)):.1f} degrees")
    10.4 +- 4.9 degrees
    """
    radius = positive(receiver_radius, name="receiver_radius", unit="m")
    gamma = positive(acceptance_angle, name="acceptance_angle", unit="rad")
    z = not_negative(depth, name="depth", unit="m")
    b_f = not_negative(forward_scattering, name="forward_scattering", unit="1/m")
    moment = not_negative(second_moment, name="second_moment", unit="rad^2")
    rho = not_negative(baseline, name="baseline", unit="m")
    broadcast(
        depth=z,
        forward_scattering=b_f,
        second_moment=moment,
        baseline=rho,
        receiver_radius=radius,
        acceptance_angle=gamma,
    )
    d = b_f * moment / 4
    place = (radius**2 + gamma**2 * z**2) / 2 + 4 / 3 * d * z**3
    covariance = gamma**2 * z / 2 + 2 * d * z**2
    # C - B^2 / A without cancellation, over the common denominator.
    determinant = (
        (gamma * radius) ** 2 / 4
        + 2 * d * z * radius**2
        + 2 / 3 * d * z**3 * gamma**2
        + 4 / 3 * (d * z**2) ** 2
    )
    variance = np.asarray(determinant / place + 0 * rho)
    return np.asarray(rho * covariance / place), variance


def effective_radiance(
    angle: ArrayLike,
    *,
    cross_angle: ArrayLike = 0.0,
    depth: ArrayLike,
    absorption: ArrayLike,
    forward_scattering: ArrayLike,
    diffuse_scattering: ArrayLike,
    second_moment: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
) -> Array:
    r"""Return received light per solid angle at given deviations from 180 degrees.

    Parameters
    ----------
    angle : array_like
        Deviation from straight back in the plane of the baseline [rad].
    cross_angle : array_like
        Deviation across that plane [rad].
    depth, absorption, forward_scattering, diffuse_scattering, second_moment, \
    baseline, receiver_radius, acceptance_angle : array_like
        As in `amulor.optics.small_angle_diffusion.overlap`.

    Returns
    -------
    ndarray
        Radiance in the equivalent medium per launched power, of the broadcast shape;
        its integral over both angles is the overlap [sr/rad^2].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    :math:`L_{\rm eff}(z, 0, \boldsymbol\nu)`, eq. (24) of Ricci et al. 2010 (ref. [1]
    of this module), as rederived; by eq. (18) it is the correlation of the forward beam
    with the field of view over places and directions. A Gaussian with the moments of
    `backscatter_direction`, and eq. (27) is its integral.

    Examples
    --------
    >>> column = dict(
    ...     depth=1.5, absorption=0.15, forward_scattering=0.35,
    ...     diffuse_scattering=0.0, second_moment=0.05, baseline=0.2,
    ...     receiver_radius=0.02, acceptance_angle=0.08,
    ... )
    >>> straight, aside = effective_radiance([0.0, 0.18], **column)
    >>> print(f"{aside / straight:.0f}")
    9
    """
    total = small_angle_diffusion.overlap(
        depth,
        absorption=absorption,
        forward_scattering=forward_scattering,
        diffuse_scattering=diffuse_scattering,
        second_moment=second_moment,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
    )
    mean, variance = backscatter_direction(
        depth,
        forward_scattering=forward_scattering,
        second_moment=second_moment,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
    )
    nu = finite(angle, name="angle", unit="rad")
    across = finite(cross_angle, name="cross_angle", unit="rad")
    broadcast(angle=nu, cross_angle=across, depth=mean)
    along = nu - mean
    density = np.exp(-(along**2 + across**2) / (2 * variance)) / (2 * np.pi * variance)
    return np.asarray(total * density)


def mean_backscatter_vsf(
    depth: ArrayLike,
    *,
    vsf: Callable[[Array], ArrayLike],
    forward_scattering: ArrayLike,
    second_moment: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
) -> Array:
    r"""Return the volume scattering function averaged over light received from a depth.

    Parameters
    ----------
    depth : array_like
        Depth z, not negative [m].
    vsf : callable
        Volume scattering function [1/(m sr)] of an array of scattering angles, near
        pi [rad]; of the same shape.
    forward_scattering, second_moment, baseline, receiver_radius, acceptance_angle : \
    array_like
        As in `amulor.optics.small_angle_diffusion.overlap`.

    Returns
    -------
    ndarray
        Mean over the deviations from straight back, of the broadcast shape [1/(m sr)];
        a replacement for the value at 180 degrees.

    Raises
    ------
    ValueError
        If an argument is outside of its range, if the deviations reach a right angle,
        where the small-angle model has no meaning, or if `vsf` changes the shape.

    Notes
    -----
    The inner integral of eqs. (17) and (25) of Ricci et al. 2010 (ref. [1] of this
    module), as rederived, weighted with the radiance of eq. (24). Eq. (26) uses the
    value at 180 degrees instead, which is right for a flat function. Spheres have a
    glory there, and the Mie phase function of one size can change by a factor within a
    few degrees; this mean shows by how much. The deviation has a Rice distribution,
    which is summed at 1024 angles up to nine standard deviations: 1e-12 for a structure
    as fine as a twentieth of a standard deviation.

    Examples
    --------
    >>> taken = mean_backscatter_vsf(
    ...     [0.5, 1.5, 4.0], vsf=lambda angle: 1e-3 * (1 + (np.pi - angle) ** 2),
    ...     forward_scattering=0.35, second_moment=0.05, baseline=0.2,
    ...     receiver_radius=0.02, acceptance_angle=0.08,
    ... )
    >>> print(np.round(taken * 1e3, 3))
    [1.199 1.047 1.042]
    """
    mean, variance = backscatter_direction(
        depth,
        forward_scattering=forward_scattering,
        second_moment=second_moment,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
    )
    mean, variance = np.broadcast_arrays(mean, variance)
    reach = np.abs(mean) + 4 * np.sqrt(variance)
    require(
        reach,
        reach < np.pi / 2,
        name="the deviation from straight back (mean and four standard deviations)",
        rule="below pi/2",
        unit="rad",
        hint="the depth is too short for this baseline, or angles are not small",
    )
    deviation, weight = _rician_rule(np.abs(mean), np.sqrt(variance))
    value = np.asarray(vsf(np.pi - deviation), dtype=np.float64)
    if value.shape != deviation.shape:
        raise ValueError(
            f"vsf must keep the shape of the angles, {deviation.shape}, got "
            f"{value.shape}"
        )
    return np.asarray(np.sum(weight * value, axis=-1))


def _rician_rule(mean: Array, deviation: Array) -> tuple[Array, Array]:
    """Return quadrature angles and weights for means over a Rice distribution."""
    node, weight = gauss_legendre(16)
    low = np.maximum(mean - 9 * deviation, 0.0)
    width = np.minimum(mean + 9 * deviation, np.pi) - low
    place = (np.arange(_PANELS)[:, None] + (node + 1) / 2).reshape(-1) / _PANELS
    angle = low[..., None] + width[..., None] * place
    centre, sigma = mean[..., None], deviation[..., None]
    density = np.exp(-(((angle - centre) / sigma) ** 2) / 2)
    density *= angle / sigma**2 * special.ive(0, angle * centre / sigma**2)
    step = np.tile(weight / 2, _PANELS) * width[..., None] / _PANELS
    return angle, density * step
