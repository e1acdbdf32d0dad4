r"""Modulated light over time: launched power, received power, attenuation.

A complex response is received over launched power at a modulation frequency. These
functions convert it to the power at a detector over time.

References
----------
.. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
   :doi:`10.1155/2010/958360`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics._bounds import (
    at_least,
    broadcast,
    finite,
    not_negative,
    require,
    within,
)

__all__ = ["complex_attenuation", "launched_power", "received_power"]


def launched_power(
    time: ArrayLike,
    *,
    mean_power: ArrayLike,
    modulation_depth: ArrayLike,
    modulation_frequency: ArrayLike,
) -> NDArray[np.float64]:
    r"""Return the power of an intensity-modulated laser over time [W].

    Parameters
    ----------
    time : array_like
        Time since a maximum of the modulation [s].
    mean_power : array_like
        Mean power, not negative [W].
    modulation_depth : array_like
        Depth m of the modulation, 0 to 1 [1].
    modulation_frequency : array_like
        Frequency of the modulation, not negative [Hz].

    Returns
    -------
    ndarray
        Power, of the broadcast shape [W].

    Raises
    ------
    ValueError
        If a power or a frequency is negative, or a depth outside of its range.

    Notes
    -----
    Eq. (4) of Ricci et al. 2010 (ref. [1] of this module), as rederived,
    :math:`P(t) = P_0 (1 + m \cos\omega t)`.

    Examples
    --------
    >>> power = launched_power(
    ...     [0.0, 5e-9, 10e-9], mean_power=20e-3, modulation_depth=0.8,
    ...     modulation_frequency=50e6,
    ... )
    >>> print(np.round(power * 1e3, 6))
    [36. 20.  4.]
    """
    return received_power(
        time,
        mean_response=1.0,
        response=1.0,
        mean_power=mean_power,
        modulation_depth=modulation_depth,
        modulation_frequency=modulation_frequency,
    )


def received_power(
    time: ArrayLike,
    *,
    mean_response: ArrayLike,
    response: ArrayLike,
    mean_power: ArrayLike,
    modulation_depth: ArrayLike,
    modulation_frequency: ArrayLike,
) -> NDArray[np.float64]:
    r"""Return the power received over time from water or target [W].

    Parameters
    ----------
    time : array_like
        Time since a maximum of the launched modulation [s].
    mean_response : array_like
        Response at zero frequency, not negative [1].
    response : array_like
        Complex response at the modulation frequency, received over launched power; of
        water, a target, or the sum of both [1].
    mean_power : array_like
        Mean launched power, not negative [W].
    modulation_depth : array_like
        Depth m of the launched modulation, 0 to 1 [1].
    modulation_frequency : array_like
        Frequency of the modulation, not negative [Hz].

    Returns
    -------
    ndarray
        Power, of the broadcast shape [W].

    Raises
    ------
    ValueError
        If a power, a mean response or a frequency is negative, a depth outside of its
        range, or a response larger than that at zero frequency, so that the power
        would be negative at times.

    Notes
    -----
    Eq. (45) of Ricci et al. 2010 (ref. [1] of this module), as rederived,

    .. math::

       P_r(t) = P_0 \{\Gamma(0) + m \, \Gamma(\omega)
           \cos[\omega t - \varphi(\omega)]\},

    with :math:`\Gamma` and :math:`\varphi` modulus and phase of the response, eqs.
    (47) and (48); its mean is eq. (44). The phase is a delay: the larger it is, the
    later the maximum.

    Examples
    --------
    >>> power = received_power(
    ...     [0.0, 5e-9], mean_response=2e-6, response=1e-6j, mean_power=20e-3,
    ...     modulation_depth=1.0, modulation_frequency=50e6,
    ... )
    >>> print(np.round(power * 1e9, 6))
    [40. 60.]
    """
    moment = finite(time, name="time", unit="s")
    depth = within(modulation_depth, 0, 1, name="modulation_depth")
    mean = not_negative(mean_response, name="mean_response", unit="")
    power = not_negative(mean_power, name="mean_power", unit="W")
    frequency = not_negative(
        modulation_frequency, name="modulation_frequency", unit="Hz"
    )
    signal = np.asarray(response, dtype=np.complex128)
    broadcast(
        time=moment,
        mean_response=mean,
        response=signal,
        mean_power=power,
        modulation_depth=depth,
        modulation_frequency=frequency,
    )
    # Integration leaves the bound |response| <= response at zero with rounding.
    too_large = ~(np.abs(signal) <= mean * (1 + 1e-9))
    require(
        np.broadcast_to(np.abs(signal), too_large.shape),
        ~too_large,
        name="response",
        rule="finite and at most mean_response in modulus",
        hint="as of all responses to light",
    )
    turn = 2 * np.pi * frequency * moment
    swing = np.real(signal * np.exp(-1j * turn))
    received: NDArray[np.float64] = power * (mean + depth * swing)
    return received


def complex_attenuation(
    attenuation: ArrayLike,
    *,
    modulation_frequency: ArrayLike,
    group_index: ArrayLike,
) -> NDArray[np.complex128]:
    r"""Return the complex attenuation coefficient of modulated light [1/m].

    Parameters
    ----------
    attenuation : array_like
        Attenuation coefficient k = a + b, or reduced attenuation, not negative [1/m].
    modulation_frequency : array_like
        Frequency of the intensity modulation, not negative [Hz].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray of complex
        :math:`k - i \omega n_g / c`, of the broadcast shape [1/m]; over a path L the
        signal changes by the factor exp of -L times this coefficient, so the phase
        grows with the path.

    Raises
    ------
    ValueError
        If a coefficient or a frequency is negative, or a group index is below 1.

    Notes
    -----
    This coefficient eliminates the time from the transport equation, eqs. (7) and (9)
    of Ricci et al. 2010 (ref. [1] of this module), as rederived and conjugated. Any
    steady solution becomes that for modulated light if this coefficient replaces k and
    the scattering coefficient b is unchanged. The albedo, b over this coefficient, is
    then complex and smaller.

    Examples
    --------
    >>> k = complex_attenuation(0.5, modulation_frequency=39e6, group_index=1.38)
    >>> print(f"{k:.3f} 1/m")
    0.500-1.128j 1/m
    """
    k = not_negative(attenuation, name="attenuation", unit="1/m")
    frequency = not_negative(
        modulation_frequency, name="modulation_frequency", unit="Hz"
    )
    index = at_least(group_index, 1, name="group_index")
    broadcast(attenuation=k, modulation_frequency=frequency, group_index=index)
    return np.asarray(k - 2j * np.pi * frequency * index / speed_of_light)
