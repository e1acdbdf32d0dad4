r"""Echo of a diffuse surface, attenuated by the water, in four models.

One function for each model of the water: a Lambertian plane returns
:math:`(\varrho / \pi) F(d) \exp(2 i \omega d / v)` with the overlap F of that model,
or, if the return path is stated, with F for the paths out and back.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.errors import AmulorWarning
from amulor.optics import small_angle, small_angle_closure, small_angle_diffusion
from amulor.optics._bounds import (
    broadcast,
    finite,
    not_negative,
    positive,
    require,
    within,
)
from amulor.optics.small_angle import sharp_receiver as small_angle_sharp_receiver
from amulor.optics.small_angle._columns import PhaseFunction
from amulor.optics.small_angle_closure.response import LARGEST_DEPARTURE

__all__ = [
    "closure_target_response",
    "sharp_receiver_target_response",
    "small_angle_target_response",
    "target_response",
]


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
    return_path: ArrayLike | None = None,
) -> NDArray[np.complex128]:
    r"""Return the echo of a diffuse surface by the small-angle diffusion model.

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, not negative [Hz].
    depth : array_like
        Water between instrument and surface, along the beam [m].
    optical_path : array_like
        Group index times length, out and back [m]; twice `depth` times the group index
        if emitter and receiver are together in the water.
    reflectance : array_like
        Fraction of the light that the surface sends back diffusely, 0 to 1 [1].
    cosine : array_like
        Cosine of the angle between the surface normal and the path to the receiver, 0
        to 1 [1].
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
    return_path : array_like, optional
        Length of the return path in water from surface to receiver [m]. By default it
        equals `depth`, whatever the baseline, as for small angles.

    Returns
    -------
    ndarray of complex
        Received power per launched power, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    See Also
    --------
    small_angle_target_response : Treats unscattered light separately.

    Notes
    -----
    A Lambertian plane returns :math:`(\varrho / \pi) F(d) \exp(2 i \omega d / v)`
    with the same :math:`F` as the water, eq. (43) of Ricci et al. 2010 [1]_, as
    rederived. The small-angle model holds for surfaces that face the instrument within
    about half a radian.

    For a given return path r, the aperture has the solid angle
    :math:`\Sigma_r \cos\alpha / r^2`, with the angle :math:`\alpha` between that path
    and the receiver's axis. The echo is then proportional to :math:`\cos\alpha_*\, F`.
    Attenuation and scattering in F are those of the depth :math:`(d + r) / 2`. The
    distance is :math:`\zeta = r +` standoff, and the offset :math:`\zeta \alpha`, where
    :math:`\zeta \sin\alpha` is the distance of the spot from the axis. The angle
    :math:`\alpha_* = \alpha \gamma^2 \zeta^2 / (R^2 + \gamma^2 \zeta^2)` is that at the
    part of the aperture that receives most. In clear water this is exact for an
    aperture that is small against the width of the view. Without r, the echo at a
    receiver with a baseline depends on the depth instead of the return path: 1.0 % too
    bright at 2 m and a baseline of 0.2 m, 16 % at 1 m and 0.4 m.

    The diffusion model spreads unscattered light like scattered light. For
    Henyey-Greenstein scattering with g = 0.95, split at 90 degrees, and a = 0.15 1/m, b
    = 0.35 1/m, the echo at 3.9 m is 0.22 to 0.28 of that of traced rays; split at 10
    degrees, it is 0.73 to 0.76.

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
    place, obliquity = _place(
        depth,
        return_path=return_path,
        baseline=baseline,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
    )
    overlap = small_angle_diffusion.overlap(
        absorption=absorption,
        forward_scattering=forward_scattering,
        diffuse_scattering=diffuse_scattering,
        second_moment=second_moment,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        **place,
    )
    return _echo(
        obliquity * overlap,
        modulation_frequency=modulation_frequency,
        optical_path=optical_path,
        reflectance=reflectance,
        cosine=cosine,
    )


def small_angle_target_response(
    modulation_frequency: ArrayLike,
    *,
    depth: ArrayLike,
    optical_path: ArrayLike,
    reflectance: ArrayLike,
    cosine: ArrayLike = 1.0,
    absorption: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
    return_path: ArrayLike | None = None,
) -> NDArray[np.complex128]:
    r"""Return the echo of a diffuse surface by the small-angle model.

    Parameters
    ----------
    modulation_frequency, depth, optical_path, reflectance, cosine : array_like
        As in `target_response`.
    absorption, scattering : array_like
        Coefficients a and b of the water, b forward and diffuse [1/m].
    phase_function : callable
        Phase function [1/sr], as in `small_angle.water_response`.
    split_angle : float
        Angle between the forward and the diffuse part, above 0 to pi [rad].
    baseline, receiver_radius : array_like
        Distance of emitter and receiver; 1/e half-width of the aperture [m].
    acceptance_angle : array_like
        1/e semi-angle of the receiver, in water [rad].
    beam_radius, beam_divergence, tilt, cross_tilt, standoff : array_like
        As in `small_angle.water_response` [m, rad, rad, rad, m].
    return_path : array_like, optional
        As in `target_response` [m].

    Returns
    -------
    ndarray of complex
        Received power per launched power, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range, or if the phase function cannot be
        used.

    See Also
    --------
    target_response : Faster, for light that was scattered many times.
    sharp_receiver_target_response : For a receiver with sharp edges.

    Notes
    -----
    :math:`(\varrho / \pi) F(d) \exp(2 i \omega d / v)` with F of eq. (29) of Ricci et
    al. 2010 [1]_, as rederived. Valid for surfaces that face the instrument within
    about half a radian, and scattering mostly below some 30 degrees. For
    Henyey-Greenstein scattering with g = 0.95, split at 90 degrees, a = 0.15 1/m, b =
    0.35 1/m and a plane at 3.9 m it has 1.02 to 1.03 times the echo of traced rays.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> echo = small_angle_target_response(
    ...     39e6, depth=3.9, optical_path=2 * 1.38 * 3.9, reflectance=0.8,
    ...     absorption=0.15, scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.95),
    ...     split_angle=np.pi / 2, baseline=0.07, receiver_radius=0.02,
    ...     acceptance_angle=0.08,
    ... )
    >>> print(f"{abs(echo):.2e}")
    2.53e-06
    """
    place, obliquity = _place(
        depth,
        return_path=return_path,
        baseline=baseline,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
    )
    overlap = small_angle.overlap(
        absorption=absorption,
        scattering=scattering,
        phase_function=phase_function,
        split_angle=split_angle,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        beam_radius=beam_radius,
        beam_divergence=beam_divergence,
        **place,
    )
    return _echo(
        obliquity * overlap,
        modulation_frequency=modulation_frequency,
        optical_path=optical_path,
        reflectance=reflectance,
        cosine=cosine,
    )


def closure_target_response(
    modulation_frequency: ArrayLike,
    *,
    depth: ArrayLike,
    optical_path: ArrayLike,
    reflectance: ArrayLike,
    cosine: ArrayLike = 1.0,
    absorption: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
    return_path: ArrayLike | None = None,
) -> NDArray[np.complex128]:
    r"""Return the echo of a diffuse surface by the small-angle closure.

    Parameters
    ----------
    modulation_frequency, depth, optical_path, reflectance, cosine : array_like
        As in `target_response`.
    absorption, scattering : array_like
        Coefficients a and b of the water, b forward and diffuse [1/m].
    phase_function : callable
        Phase function [1/sr], as in `small_angle.water_response`.
    split_angle : float
        Angle between the forward and the diffuse part, above 0 to pi [rad].
    baseline, receiver_radius : array_like
        Distance of emitter and receiver; 1/e half-width of the aperture [m].
    acceptance_angle : array_like
        1/e semi-angle of the receiver, in water [rad].
    beam_radius, beam_divergence, tilt, cross_tilt, standoff : array_like
        As in `small_angle.water_response` [m, rad, rad, rad, m].
    return_path : array_like, optional
        As in `target_response` [m].

    Returns
    -------
    ndarray of complex
        Received power per launched power, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range, or if the phase function cannot be
        used.

    Warns
    -----
    AmulorWarning
        If the closure does not hold for an echo.

    See Also
    --------
    small_angle_target_response : Exact model, slower.

    Notes
    -----
    :math:`(\varrho / \pi) F(d) \exp(2 i \omega d / v)` with F of
    `small_angle_closure.overlap`, the closure of eq. (29) of Ricci et al. 2010 [1]_, as
    rederived. Valid for surfaces that face the instrument within about half a radian.
    Where `small_angle_closure.departure` is at most 0.25 the echo is 0.7 to 1 of that
    of eq. (29); elsewhere it may be almost zero.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> echo = closure_target_response(
    ...     39e6, depth=3.9, optical_path=2 * 1.38 * 3.9, reflectance=0.8,
    ...     absorption=0.15, scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.95),
    ...     split_angle=np.pi / 2, baseline=0.07, receiver_radius=0.02,
    ...     acceptance_angle=0.08,
    ... )
    >>> print(f"{abs(echo):.2e}")
    2.17e-06
    """
    place, obliquity = _place(
        depth,
        return_path=return_path,
        baseline=baseline,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
    )
    column: dict[str, Any] = {
        "absorption": absorption,
        "scattering": scattering,
        "phase_function": phase_function,
        "split_angle": split_angle,
        "receiver_radius": receiver_radius,
        "acceptance_angle": acceptance_angle,
        "beam_radius": beam_radius,
        "beam_divergence": beam_divergence,
        **place,
    }
    overlap = small_angle_closure.overlap(**column)
    lit, off = np.broadcast_arrays(
        np.asarray(reflectance) > 0, small_angle_closure.departure(**column)
    )
    beyond = lit & (np.abs(off) > LARGEST_DEPARTURE)
    if beyond.any():
        warnings.warn(
            f"the closure does not hold for {beyond.sum()} of {lit.sum()} echoes: they "
            f"are off by more than {LARGEST_DEPARTURE:.0%}; use the small-angle model",
            AmulorWarning,
            stacklevel=2,
        )
    return _echo(
        obliquity * overlap,
        modulation_frequency=modulation_frequency,
        optical_path=optical_path,
        reflectance=reflectance,
        cosine=cosine,
    )


def sharp_receiver_target_response(
    modulation_frequency: ArrayLike,
    *,
    depth: ArrayLike,
    optical_path: ArrayLike,
    reflectance: ArrayLike,
    cosine: ArrayLike = 1.0,
    absorption: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
    return_path: ArrayLike | None = None,
) -> NDArray[np.complex128]:
    r"""Return the echo of a diffuse surface for a sharp aperture and field of view.

    Parameters
    ----------
    modulation_frequency, depth, optical_path, reflectance, cosine : array_like
        As in `target_response`.
    absorption, scattering : array_like
        Coefficients a and b of the water, b forward and diffuse [1/m].
    phase_function : callable
        Phase function [1/sr], as in `small_angle_sharp_receiver.water_response`.
    split_angle : float
        Angle between the forward and the diffuse part, above 0 to pi [rad].
    baseline, receiver_radius : array_like
        Distance of emitter and receiver; radius of the circular aperture [m].
    acceptance_angle : array_like
        Semi-angle of the receiver's acceptance cone, in water [rad].
    beam_radius, beam_divergence, tilt, cross_tilt, standoff : array_like
        As in `small_angle_sharp_receiver.water_response` [m, rad, rad, rad, m].
    return_path : array_like, optional
        As in `target_response` [m].

    Returns
    -------
    ndarray of complex
        Received power per launched power, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range, or if the phase function cannot be
        used.

    See Also
    --------
    small_angle_target_response : Faster, for a Gaussian receiver.

    Notes
    -----
    :math:`(\varrho / \pi) F(d) \exp(2 i \omega d / v)` with F of eq. (29) of Ricci et
    al. 2010 [1]_, as rederived, for a uniform disc and a uniform cone. If the receiver
    sees the whole spot, the echo in clear water is exactly that of the lidar equation,
    reflectance over pi times aperture over distance squared. For a Gaussian receiver it
    is so only approximately.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> echo = sharp_receiver_target_response(
    ...     39e6, depth=3.9, optical_path=2 * 1.38 * 3.9, reflectance=0.8,
    ...     absorption=0.15, scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.95),
    ...     split_angle=np.pi / 2, baseline=0.07, receiver_radius=0.02,
    ...     acceptance_angle=0.08,
    ... )
    >>> print(f"{abs(echo):.2e}")
    2.96e-06
    """
    place, obliquity = _place(
        depth,
        return_path=return_path,
        baseline=baseline,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
    )
    overlap = small_angle_sharp_receiver.overlap(
        absorption=absorption,
        scattering=scattering,
        phase_function=phase_function,
        split_angle=split_angle,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        beam_radius=beam_radius,
        beam_divergence=beam_divergence,
        **place,
    )
    return _echo(
        obliquity * overlap,
        modulation_frequency=modulation_frequency,
        optical_path=optical_path,
        reflectance=reflectance,
        cosine=cosine,
    )


def _place(
    depth: ArrayLike,
    *,
    return_path: ArrayLike | None,
    baseline: ArrayLike,
    tilt: ArrayLike,
    cross_tilt: ArrayLike,
    standoff: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
) -> tuple[dict[str, ArrayLike], NDArray[np.float64] | float]:
    """Return overlap arguments of a surface, and obliquity factor of its echo."""
    place: dict[str, ArrayLike] = {
        "depth": depth,
        "baseline": baseline,
        "tilt": tilt,
        "cross_tilt": cross_tilt,
        "standoff": standoff,
    }
    gap = not_negative(standoff, name="standoff", unit="m")
    if return_path is None:
        return place, 1.0
    back = not_negative(return_path, name="return_path", unit="m")
    out = not_negative(depth, name="depth", unit="m")
    broadcast(return_path=back, **place)
    aside = not_negative(baseline, name="baseline", unit="m") - finite(
        tilt, name="tilt", unit="rad"
    ) * (out + gap)
    across = finite(cross_tilt, name="cross_tilt", unit="rad") * (out + gap)
    offset, way = np.hypot(aside, across), back + gap
    require(
        back,
        offset <= way,
        name="return_path",
        rule="at least the distance of the spot from the receiver axis",
        unit="m",
    )
    angle = np.arcsin(offset / np.where(way > 0, way, 1.0))
    middle = (out + back) / 2
    surface_view: dict[str, ArrayLike] = {
        "depth": middle,
        "baseline": way * angle,
        "standoff": way - middle,
    }
    # Off the axis by less where the aperture is as wide as the view.
    aperture = positive(receiver_radius, name="receiver_radius", unit="m")
    width = positive(acceptance_angle, name="acceptance_angle", unit="rad") * way
    return surface_view, np.cos(angle * width**2 / (aperture**2 + width**2))


def _echo(
    overlap: NDArray[np.float64],
    *,
    modulation_frequency: ArrayLike,
    optical_path: ArrayLike,
    reflectance: ArrayLike,
    cosine: ArrayLike,
) -> NDArray[np.complex128]:
    """Return the echo of a Lambertian plane from the overlap F at its depth."""
    frequency = not_negative(
        modulation_frequency, name="modulation_frequency", unit="Hz"
    )
    path = not_negative(optical_path, name="optical_path", unit="m")
    lambert = within(reflectance, 0, 1, name="reflectance") / np.pi
    facing = within(cosine, 0, 1, name="cosine")
    broadcast(
        modulation_frequency=frequency,
        optical_path=path,
        reflectance=lambert,
        cosine=facing,
        depth=overlap,
    )
    delay = 2 * np.pi * frequency * path / speed_of_light
    return np.asarray(lambert * facing * overlap * np.exp(1j * delay))
