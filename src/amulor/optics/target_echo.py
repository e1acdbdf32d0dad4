"""The echo of a diffuse surface through the same water as the water signal."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics import small_angle_diffusion

__all__ = ["target_response"]


def target_response(
    modulation_frequency: ArrayLike,
    *,
    depth: ArrayLike,
    optical_path: ArrayLike,
    reflectance: ArrayLike,
    cosine: ArrayLike = 1.0,
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
) -> NDArray[np.complex128]:
    r"""Return the received modulation of a diffuse surface per launched power.

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation [Hz].
    depth : array_like
        Water between instrument and surface, along the beam [m].
    optical_path : array_like
        Group index times length, out and back [m]; twice `depth` times the group
        index where emitter and receiver stand together in the water.
    reflectance : array_like
        Share of the light that the surface sends back diffusely [1].
    cosine : array_like
        Cosine between the normal of the surface and the way to the receiver [1].
    absorption, forward_scattering, diffuse_scattering : array_like
        Coefficients a, b_f, b_d of the water [1/m].
    second_moment : array_like
        Mean square angle of forward scattering [rad^2].
    baseline, receiver_radius : array_like
        Distance of emitter and receiver; 1/e half-width of the aperture [m].
    acceptance_angle, tilt, cross_tilt : array_like
        As in `small_angle_diffusion.overlap` [rad].
    standoff : array_like
        As in `small_angle_diffusion.overlap` [m].

    Returns
    -------
    ndarray of complex
        Received power per launched power, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a property of the water or the receiver is out of range.

    Notes
    -----
    A Lambertian plane returns :math:`(\varrho / \pi) F(d) \exp(2 i \omega d / v)`
    with the same :math:`F` as the water, eq. (43) of Ricci et al. 2010 [1]_, as
    rebuilt. The small-angle model holds for surfaces that face the instrument within
    about half a radian.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> echo = target_response(
    ...     39e6, depth=1.5, optical_path=2 * 1.38 * 1.5, reflectance=0.1,
    ...     absorption=0.15, forward_scattering=0.35, diffuse_scattering=0.0,
    ...     second_moment=0.05, baseline=0.07, receiver_radius=0.02,
    ...     acceptance_angle=0.08,
    ... )
    >>> print(f"{abs(echo):.1e}")
    2.8e-06
    """
    shape_of_light = small_angle_diffusion.overlap(
        depth,
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
    frequency = np.asarray(modulation_frequency, dtype=float)
    delay = (
        2 * np.pi * frequency * np.asarray(optical_path, dtype=float) / speed_of_light
    )
    lambert = np.asarray(reflectance, dtype=float) / np.pi * np.asarray(cosine)
    echo: NDArray[np.complex128] = lambert * shape_of_light * np.exp(1j * delay)
    return echo
