r"""Fourier transforms of the small-angle model: water layer, beam and receiver.

Light at a depth z has a position :math:`\boldsymbol\rho` across the axis and a small
direction :math:`\mathbf n`; their conjugates are the spatial frequency
:math:`\boldsymbol\kappa` [1/m] and the frequency :math:`\mathbf p` of the direction
[1/rad], both along one axis here. Water multiplies by a transfer function. The two-way
path of single backscatter is equivalent to one path through a medium with twice the
coefficients, eqs. (21) and (23) of Ricci et al. 2010 [1]_, as rederived, so its
transfer function is the square.

References
----------
.. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
   :doi:`10.1155/2010/958360`.
.. [2] E. P. Zege, A. P. Ivanov and I. L. Katsev, Image Transfer Through a Scattering
   Medium, Springer (1991), :doi:`10.1007/978-3-642-75286-5`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import broadcast, finite, not_negative, positive
from amulor.optics.phase_functions.integrals import gauss_legendre
from amulor.optics.phase_functions.phase_function import PhaseFunction

__all__ = [
    "diffusion_layer_transfer",
    "effective_source_transform",
    "layer_transfer",
    "receiver_sensitivity",
]

Array = NDArray[np.float64]

_PANEL = 8.0  # width of the first panels of the frequency times the split angle [1]
_EVEN_PANELS = 128  # of this width


def layer_transfer(
    spatial_frequency: ArrayLike,
    *,
    direction_frequency: ArrayLike = 0.0,
    depth: ArrayLike,
    absorption: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
) -> Array:
    r"""Return the transfer function of a water layer, for any phase function.

    At zero `direction_frequency` this is the modulation transfer function of the water:
    the contrast of a stripe pattern behind the layer, times the transmission.

    Parameters
    ----------
    spatial_frequency : array_like
        Spatial frequency kappa across the axis, 2 pi over a period [1/m].
    direction_frequency : array_like
        Conjugate p of the direction, along the same axis [1/rad].
    depth : array_like
        Thickness z of the layer, not negative [m].
    absorption : array_like
        Absorption coefficient a, not negative [1/m].
    scattering : array_like
        Scattering coefficient b, forward and diffuse, not negative [1/m].
    phase_function : PhaseFunction
        Phase function; its forward part spreads the beam, other scattering is a loss.
    split_angle : float
        Angle between the forward and the diffuse part, above 1e-12 to pi [rad].

    Returns
    -------
    ndarray
        Transform of the radiance behind the layer over that of a source shifted by
        :math:`\mathbf p + \boldsymbol\kappa z`, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a depth or coefficient is negative, or the split angle out of range.

    Notes
    -----
    Eq. (20) of Ricci et al. 2010 (ref. [1] of this module), as rederived, the solution
    of eq. (19) (ref. [2]):

    .. math::

       \exp\Bigl[-k z + b_f \int_0^z \hat p_f(|p + \kappa s|) \, ds\Bigr].

    Its square is the exponential of eqs. (21) and (29), for the equivalent medium of
    eq. (23) has twice the coefficients. The transform of the phase function is computed
    once for all layers of a call and integrated as a Legendre series. For peaked phase
    functions of the sea, split at 90 degrees, the error was 1e-14 of the result where
    :math:`p + \kappa z` stays below 600 per radian and 3e-8 above; it is larger for a
    phase function that is not small at the split angle.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> stripes = 2 * np.pi / np.array([np.inf, 0.1, 0.01])
    >>> contrast = layer_transfer(
    ...     stripes, depth=1.5, absorption=0.15, scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.97), split_angle=1.5,
    ... )
    >>> print(np.round(contrast / contrast[0], 3))
    [1.    0.707 0.605]
    """
    kappa, p = _frequencies(spatial_frequency, direction_frequency)
    z = not_negative(depth, name="depth", unit="m")
    a = not_negative(absorption, name="absorption", unit="1/m")
    b = not_negative(scattering, name="scattering", unit="1/m")
    shape = broadcast(
        spatial_frequency=kappa,
        direction_frequency=p,
        depth=z,
        absorption=a,
        scattering=b,
    )
    kappa, p, z = (np.broadcast_to(value, shape) for value in (kappa, p, z))
    fraction, _ = phase_function.forward_split(split_angle)

    def transform(frequency: Array) -> Array:
        return phase_function.hankel(frequency, split_angle=split_angle)

    ends = p.ravel(), (p + kappa * z).ravel()
    mean = _mean_along(transform, *ends, split=float(split_angle))
    exponent = -(a + b) * z + fraction * b * z * mean.reshape(z.shape)
    return np.asarray(np.exp(exponent))


def diffusion_layer_transfer(
    spatial_frequency: ArrayLike,
    *,
    direction_frequency: ArrayLike = 0.0,
    depth: ArrayLike,
    absorption: ArrayLike,
    forward_scattering: ArrayLike,
    diffuse_scattering: ArrayLike,
    second_moment: ArrayLike,
) -> Array:
    r"""Return the transfer function of a water layer, for Gaussian angular spread.

    Parameters
    ----------
    spatial_frequency, direction_frequency, depth, absorption : array_like
        As in `layer_transfer`.
    forward_scattering, diffuse_scattering : array_like
        Parts b_f and b_d of the scattering coefficient, not negative [1/m].
    second_moment : array_like
        Second moment <theta^2> of the forward part, not negative [rad^2].

    Returns
    -------
    ndarray
        Transfer function, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a depth, coefficient or moment is negative.

    Notes
    -----
    Eq. (34) of Ricci et al. 2010 (ref. [1] of this module), as rederived, of a single
    medium; its solution of eq. (32), which follows from the expansion of eq. (31):

    .. math::

       \exp[-k' z - D (p^2 z + p \kappa z^2 + \kappa^2 z^3 / 3)], \quad
       D = b_f \langle\theta^2\rangle / 4 .

    It is `layer_transfer` for :math:`\hat p_f = 1 - q^2 \langle\theta^2\rangle / 4`:
    the first terms of a series. It is accurate for patterns that are wide against the
    spread by single scattering, but not for fine patterns, which unscattered light
    still transmits.

    Examples
    --------
    >>> contrast = diffusion_layer_transfer(
    ...     2 * np.pi, depth=1.5, absorption=0.0, forward_scattering=0.35,
    ...     diffuse_scattering=0.0, second_moment=0.045,
    ... )
    >>> print(f"{contrast:.4f}")
    0.8396
    """
    kappa, p = _frequencies(spatial_frequency, direction_frequency)
    z = not_negative(depth, name="depth", unit="m")
    a = not_negative(absorption, name="absorption", unit="1/m")
    b_f = not_negative(forward_scattering, name="forward_scattering", unit="1/m")
    b_d = not_negative(diffuse_scattering, name="diffuse_scattering", unit="1/m")
    moment = not_negative(second_moment, name="second_moment", unit="rad^2")
    broadcast(
        spatial_frequency=kappa,
        direction_frequency=p,
        depth=z,
        absorption=a,
        forward_scattering=b_f,
        diffuse_scattering=b_d,
        second_moment=moment,
    )
    spread = p**2 * z + p * kappa * z**2 + kappa**2 * z**3 / 3
    return np.asarray(np.exp(-(a + b_d) * z - b_f * moment / 4 * spread))


def receiver_sensitivity(
    offset: ArrayLike,
    *,
    angle: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
) -> Array:
    r"""Return the relative sensitivity of a Gaussian receiver to a ray.

    Parameters
    ----------
    offset : array_like
        Distance of the ray from the centre of the receiver [m].
    angle : array_like
        Angle of the ray to the axis of the receiver [rad].
    receiver_radius : array_like
        1/e radius R of the aperture, above zero [m].
    acceptance_angle : array_like
        1/e semi-angle gamma of the field of view, above zero [rad].

    Returns
    -------
    ndarray
        Fraction between 0 and 1, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a radius or an acceptance is not above zero.

    Notes
    -----
    Eq. (38) of Ricci et al. 2010 (ref. [1] of this module), as rederived,
    :math:`D = \exp(-\rho^2 / R^2 - n^2 / \gamma^2)`: the factor in front of it is 1
    with the area :math:`\Sigma_r = \pi R^2` and the solid angle
    :math:`\Omega_r = \pi \gamma^2`, which are its integrals. It is the D of the
    received power, eq. (5).

    Examples
    --------
    >>> taken = receiver_sensitivity(
    ...     0.0, angle=[0.0, 0.08], receiver_radius=0.02, acceptance_angle=0.08
    ... )
    >>> print(np.round(taken, 4))
    [1.     0.3679]
    """
    radius = positive(receiver_radius, name="receiver_radius", unit="m")
    gamma = positive(acceptance_angle, name="acceptance_angle", unit="rad")
    rho = finite(offset, name="offset", unit="m")
    n = finite(angle, name="angle", unit="rad")
    broadcast(offset=rho, angle=n, receiver_radius=radius, acceptance_angle=gamma)
    return np.asarray(np.exp(-((rho / radius) ** 2) - (n / gamma) ** 2))


def effective_source_transform(
    spatial_frequency: ArrayLike,
    *,
    direction_frequency: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
) -> NDArray[np.complex128]:
    r"""Return the combined Fourier transform of beam and receiver.

    Parameters
    ----------
    spatial_frequency : array_like
        Spatial frequency kappa along the baseline [1/m].
    direction_frequency : array_like
        Conjugate p of the direction along the baseline [1/rad].
    baseline : array_like
        Distance rho_0 of beam and receiver axis [m].
    receiver_radius, acceptance_angle : array_like
        As in `receiver_sensitivity` [m, rad].
    beam_radius : array_like
        1/e radius of the intensity of the Gaussian beam; 0 is the pencil of the paper
        [m].
    beam_divergence : array_like
        1/e semi-angle of the beam [rad].

    Returns
    -------
    ndarray of complex
        Transform, of the broadcast shape [m^2 sr].

    Raises
    ------
    ValueError
        If a radius or acceptance of the receiver is not above zero, or one of the
        beam is negative.

    Notes
    -----
    The correlation of eq. (22) of Ricci et al. 2010 (ref. [1] of this module), as
    rederived, is the product of eq. (28) of the transforms of the beam, eq. (37), and
    of the receiver, eq. (38); for the pencil beam eq. (39), here with a beam of
    radius w and divergence :math:`\delta`:

    .. math::

       \Sigma_r \Omega_r \exp[-(R^2 + w^2) \kappa^2 / 4
           - (\gamma^2 + \delta^2) p^2 / 4 + i \kappa \rho_0].

    With the square of `layer_transfer` it is the integrand of eq. (29), and with that
    of `diffusion_layer_transfer` that of eqs. (35)-(36) and (40).

    Examples
    --------
    >>> etendue = effective_source_transform(
    ...     0.0, direction_frequency=0.0, baseline=0.2, receiver_radius=0.02,
    ...     acceptance_angle=0.08,
    ... )
    >>> print(f"{etendue.real:.3e} m2 sr")
    2.527e-05 m2 sr
    """
    radius = positive(receiver_radius, name="receiver_radius", unit="m")
    gamma = positive(acceptance_angle, name="acceptance_angle", unit="rad")
    w = not_negative(beam_radius, name="beam_radius", unit="m")
    delta = not_negative(beam_divergence, name="beam_divergence", unit="rad")
    kappa, p = _frequencies(spatial_frequency, direction_frequency)
    rho = finite(baseline, name="baseline", unit="m")
    broadcast(
        spatial_frequency=kappa,
        direction_frequency=p,
        baseline=rho,
        receiver_radius=radius,
        acceptance_angle=gamma,
        beam_radius=w,
        beam_divergence=delta,
    )
    width = (radius**2 + w**2) * kappa**2 + (gamma**2 + delta**2) * p**2
    phase = kappa * rho
    etendue = (np.pi * radius * gamma) ** 2
    return np.asarray(etendue * np.exp(-width / 4 + 1j * phase))


def _frequencies(
    spatial_frequency: ArrayLike, direction_frequency: ArrayLike
) -> tuple[Array, Array]:
    """Return spatial and direction frequency as arrays, checked to be finite."""
    return (
        finite(spatial_frequency, name="spatial_frequency", unit="1/m"),
        finite(direction_frequency, name="direction_frequency", unit="1/rad"),
    )


def _mean_along(
    transform: Callable[[Array], Array], first: Array, last: Array, *, split: float
) -> Array:
    """Return mean values of an even transform between pairs of frequencies."""
    ends = np.concatenate([first, last])
    below = np.sign(ends) * _integral(transform, np.abs(ends), split=split)
    start, stop = np.split(below, 2)
    width = last - first
    # Over short ways the difference loses digits, and the middle is as good.
    short = np.abs(width) <= 1e-6 * np.maximum(np.abs(first), np.abs(last))
    short |= np.abs(width) * split <= 3e-5
    mean = (stop - start) / np.where(short, 1.0, width)
    if np.any(short):
        mean[short] = transform(np.abs(first + last)[short] / 2)
    return np.asarray(mean)


def _integral(
    transform: Callable[[Array], Array], frequency: Array, *, split: float
) -> Array:
    """Return the integral of a transform from 0 to each frequency."""
    # The end of the forward part at the split angle makes it oscillate with 2 pi /
    # split; first panels hold just over one oscillation, later ones half an octave.
    largest = max(float(np.max(frequency, initial=0.0)), _PANEL / split)
    even = _PANEL / split * np.arange(_EVEN_PANELS + 1)
    octaves = max(0, int(np.ceil(2 * np.log2(largest / even[-1]))))
    edges = np.concatenate([even, even[-1] * 2 ** (np.arange(1, octaves + 1) / 2)])
    edges = edges[: int(np.searchsorted(edges, largest)) + 1]
    node, weight = gauss_legendre(16)
    half = np.diff(edges)[:, None] / 2
    value = transform(edges[:-1, None] + half * (node + 1))
    # Legendre series of each panel, integrated term by term to each frequency.
    order = np.arange(node.size)
    series = value @ (legendre.legvander(node, 15) * weight[:, None] * (order + 0.5))
    sums = np.concatenate([[0.0], np.cumsum(2 * half[:, 0] * series[:, 0])])
    panel = np.minimum(np.searchsorted(edges, frequency, side="right"), len(half)) - 1
    place = (frequency - edges[panel]) / half[panel, 0] - 1
    powers = legendre.legvander(place, 16)
    terms = np.empty((place.size, 16))
    terms[:, 0] = place + 1
    terms[:, 1:] = (powers[:, 2:] - powers[:, :-2]) / (2 * order[1:] + 1)
    inside = half[panel, 0] * np.sum(series[panel] * terms, axis=1)
    return np.asarray(sums[panel] + inside)
