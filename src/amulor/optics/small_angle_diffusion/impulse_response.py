"""Distribution of the water signal over time and depth, by the diffusion model."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light
from scipy.optimize import brentq

from amulor.optics._bounds import broadcast, finite, within
from amulor.optics._water_column import checked
from amulor.optics.small_angle_diffusion import response as model

__all__ = ["impulse_response", "maximum_distance"]


def impulse_response(
    time: ArrayLike,
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
) -> NDArray[np.float64]:
    r"""Return the impulse response of the water signal: power per pulse energy [1/s].

    Parameters
    ----------
    time : array_like
        Time since the pulse entered the water [s].
    absorption, forward_scattering, diffuse_scattering : array_like
        Coefficients a, b_f, b_d of the water [1/m].
    second_moment : array_like
        Mean square angle of forward scattering [rad^2].
    backscatter_vsf : array_like
        Volume scattering function at 180 degrees [1/(m sr)].
    group_index : array_like
        Group index of the water [1].
    baseline, receiver_radius : array_like
        As in `small_angle_diffusion.overlap` [m].
    acceptance_angle, tilt, cross_tilt : array_like
        As in `small_angle_diffusion.overlap` [rad].
    standoff : array_like
        As in `small_angle_diffusion.overlap` [m].
    end : array_like
        Depth of the end of the water [m].

    Returns
    -------
    ndarray
        Received power per launched energy, of the broadcast shape [1/s].

    Raises
    ------
    ValueError
        If a property of the water or the receiver is out of range.

    Notes
    -----
    Light from the depth :math:`z` comes at :math:`t = 2 z / v`, so
    :math:`h(t) = \beta_\pi F(v t / 2) \, v / 2`; the integral over
    :math:`h(t) e^{i \omega t}` is eq. (46) of Ricci et al. 2010 [1]_, as rederived, and
    eq. (8) transforms it to time.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> water = dict(absorption=0.15, forward_scattering=0.35, diffuse_scattering=0.0,
    ...     second_moment=0.05, backscatter_vsf=3.5e-4, group_index=1.34, baseline=0.2,
    ...     receiver_radius=0.02, acceptance_angle=0.08)
    >>> time = np.linspace(0, 60e-9, 601)
    >>> response = impulse_response(time, **water)
    >>> print(f"{time[np.argmax(response)] * 1e9:.1f} ns")
    11.4 ns
    """
    moment = finite(time, name="time", unit="s")
    index = np.asarray(checked("group_index", group_index))
    vsf = np.asarray(checked("backscatter_vsf", backscatter_vsf))
    last = np.asarray(checked("end", end))
    broadcast(time=moment, group_index=index, backscatter_vsf=vsf, end=last)
    speed = speed_of_light / index
    depth = speed * moment / 2
    inside = (depth >= 0) & (depth <= last)
    profile = model.overlap(
        np.where(inside, depth, 0.0),
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
    broadcast(backscatter_vsf=vsf, depth=profile)
    response: NDArray[np.float64] = np.where(inside, vsf * profile * speed / 2, 0.0)
    return response


def maximum_distance(fraction: float, **water: Any) -> float:
    """Return the depth within which a fraction of the water signal arises [m].

    Parameters
    ----------
    fraction : float
        Fraction of the mean (unmodulated) signal, above 0 and below 1 [1].
    **water
        Properties of one water column, as `small_angle_diffusion.water_response` takes
        them; `backscatter_vsf` and `group_index` cancel and may be left out.

    Returns
    -------
    float
        Depth z_max [m].

    Raises
    ------
    ValueError
        If the fraction is out of range, or a property of the water.

    Notes
    -----
    The integrand is eq. (43) of Ricci et al. 2010, as rederived; it is never below
    zero, so the depth is unique.

    Examples
    --------
    >>> water = dict(absorption=0.15, forward_scattering=0.35, diffuse_scattering=0.0,
    ...     second_moment=0.05, baseline=0.2, receiver_radius=0.02,
    ...     acceptance_angle=0.08)
    >>> print(f"{maximum_distance(0.9, **water):.2f} m")
    3.12 m
    """
    within(fraction, 0, 1, name="fraction", above=True, below=True)
    column = {"backscatter_vsf": 1.0, "group_index": 1.0, **water}
    total = float(model.water_response(0.0, **column).real)
    if total == 0:
        raise ValueError(
            "the receiver gets no light from this water: baseline too wide, or "
            "acceptance_angle too small"
        )

    def excess(depth: float) -> float:
        part = model.water_response(0.0, **(column | {"end": depth}))
        return float(part.real) / total - fraction

    farthest = 1.0
    end = float(column.get("end", np.inf))
    while farthest < end and excess(farthest) < 0:
        farthest *= 2
    return float(brentq(excess, 0.0, min(farthest, end), xtol=1e-9, rtol=1e-12))
