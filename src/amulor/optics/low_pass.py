"""Low-pass behavior of the water signal: cut-off frequency and first-order fits.

`cut_off`, `cut_off_of_sweep` and `cut_off_of_narrow_receiver` return the frequency at
half power: of a response function, of a sweep, and in closed form. `fit` and
`fit_if_shown` fit a first-order low-pass with free level to measured amplitudes.
`fit_of_power` fits it to their squares, relative to the largest. For most receivers
these cut-offs differ, so state which one is meant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light
from scipy.optimize import brentq, least_squares

from amulor.optics._bounds import (
    at_least,
    broadcast,
    not_negative,
    one_axis,
    positive,
    require,
)

__all__ = [
    "LowPassFit",
    "cut_off",
    "cut_off_of_narrow_receiver",
    "cut_off_of_sweep",
    "first_order_response",
    "fit",
    "fit_if_shown",
    "fit_of_power",
]

_PER_SPAN = 1201  # samples over six decades, 1.2 % apart


def cut_off(
    response_function: Callable[[NDArray[np.float64]], Any],
    *,
    maximum_frequency: float = 1e9,
) -> float:
    r"""Return the frequency at which a response falls to half of its power at 0 Hz.

    Parameters
    ----------
    response_function : callable
        Takes an array of modulation frequencies [Hz] and returns the complex
        response or its amplitude, of the same shape, in any unit.
    maximum_frequency : float, optional
        Highest frequency to examine, above zero [Hz].

    Returns
    -------
    float
        Lowest frequency at which the modulus is :math:`1 / \sqrt 2` of its value
        at zero frequency [Hz].

    Raises
    ------
    ValueError
        If the response at zero frequency is zero, if a value is not finite, or if
        the modulus stays above the level up to the maximum frequency.

    Notes
    -----
    The half-power point of :math:`\Gamma(\omega)`, eq. (47) of Ricci et al. 2010 [1]_,
    as rederived: an amplitude ratio of :math:`1 / \sqrt 2`, since the optical power is
    what oscillates. For a response other than eq. (49) it is not the parameter of
    `fit`; both are worth reporting. The response is sampled in steps of 1.2 %, from a
    millionth of the maximum frequency on; a dip narrower than a step can be missed.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> corner = cut_off(lambda f: first_order_response(f, cut_off=18.8e6))
    >>> print(f"{corner / 1e6:.1f} MHz")
    18.8 MHz
    """
    positive(maximum_frequency, name="maximum_frequency", unit="Hz")

    def modulus(frequency: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.abs(response_function(frequency)), dtype=float)

    lowest = 1e-6 * maximum_frequency
    frequency = np.geomspace(lowest, maximum_frequency, _PER_SPAN)
    frequency = np.concatenate([[0.0], frequency])
    amplitude = modulus(frequency)
    if amplitude.shape != frequency.shape or not np.all(np.isfinite(amplitude)):
        raise ValueError(
            "response_function must return one finite value for each frequency, got "
            f"shape {amplitude.shape} for {frequency.shape}, "
            f"{np.count_nonzero(~np.isfinite(amplitude))} of them not finite"
        )
    if amplitude[0] == 0:
        raise ValueError(
            "the response at zero frequency must not be zero: a cut-off is relative "
            "to it"
        )
    level = amplitude[0] / np.sqrt(2)
    below = np.flatnonzero(amplitude <= level)
    if below.size == 0:
        raise ValueError(
            f"the response stays above 1/sqrt(2) of its value at zero frequency up to "
            f"{maximum_frequency:g} Hz, its lowest fraction is "
            f"{amplitude.min() / amplitude[0]:.3f}; raise maximum_frequency"
        )
    k = int(below[0])

    def excess(frequency: float) -> float:
        return float(modulus(np.array([frequency]))[0] / level - 1)

    a, b = float(frequency[k - 1]), float(frequency[k])
    return float(brentq(excess, a, b, xtol=1e-14 * b, rtol=1e-14))


def cut_off_of_sweep(modulation_frequency: ArrayLike, amplitude: ArrayLike) -> float:
    r"""Return the half-power frequency of a measured sweep [Hz].

    Parameters
    ----------
    modulation_frequency : array_like, shape (n,)
        Frequencies of the intensity modulation, rising from 0 [Hz].
    amplitude : array_like, shape (n,)
        Amplitude of the response at each, not negative [any unit].

    Returns
    -------
    float
        Frequency at which the amplitude is :math:`1 / \sqrt 2` of that at zero
        frequency, by linear interpolation; NaN if it does not fall so far [Hz].

    Raises
    ------
    ValueError
        If the shapes differ, the frequencies do not rise from 0, a value is negative
        or not finite, or the amplitude at zero frequency is zero.

    Notes
    -----
    As `cut_off`, for a response that was simulated or measured at some frequencies
    only: the half-power point of eq. (47) of Ricci et al. 2010 [1]_, as rederived.
    Linear interpolation causes a relative error of about
    :math:`(\Delta f / f_c)^2 / 8`.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> frequency = np.linspace(0, 138e6, 277)
    >>> sweep = abs(first_order_response(frequency, cut_off=18.8e6))
    >>> print(f"{cut_off_of_sweep(frequency, sweep) / 1e6:.1f} MHz")
    18.8 MHz
    """
    f = not_negative(modulation_frequency, name="modulation_frequency", unit="Hz")
    a = not_negative(amplitude, name="amplitude")
    one_axis(2, modulation_frequency=f, amplitude=a)
    rising = np.append(f[0] == 0, np.diff(f) > 0)
    rule = "rising from 0"
    require(f, rising, name="modulation_frequency", rule=rule, unit="Hz")
    positive(a[0], name="amplitude at zero frequency")
    level = a[0] / np.sqrt(2)
    below = np.flatnonzero(a < level)
    if below.size == 0:
        return float("nan")
    k = int(below[0])
    fraction = (a[k - 1] - level) / (a[k - 1] - a[k])
    return float(f[k - 1] + fraction * (f[k] - f[k - 1]))


@dataclass(frozen=True)
class LowPassFit:
    """Fit of a first-order low-pass to a measured frequency sweep.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics.low_pass import fit
    >>> frequency = np.linspace(5e6, 100e6, 20)
    >>> found = fit(frequency, 3.0 / np.sqrt(1 + (frequency / 20e6) ** 2))
    >>> print(f"{found.cut_off / 1e6:.2f} MHz, {found.amplitude_at_zero:.2f}")
    20.00 MHz, 3.00
    """

    cut_off: float
    """Fitted cut-off frequency f_c [Hz]."""
    cut_off_standard_error: float
    """Standard error of the cut-off, from the residuals of the fit [Hz]."""
    amplitude_at_zero: float
    """Amplitude at zero frequency: fitted by `fit`, the maximum for `fit_of_power`."""


def fit(modulation_frequency: ArrayLike, amplitude: ArrayLike) -> LowPassFit:
    r"""Fit a first-order low-pass to the amplitudes of a frequency sweep.

    Parameters
    ----------
    modulation_frequency : array_like, shape (n,)
        Frequencies of the intensity modulation, not negative [Hz].
    amplitude : array_like, shape (n,)
        Amplitude of the signal at each, not negative [any unit].

    Returns
    -------
    LowPassFit
        Cut-off, its standard error, and amplitude at zero frequency.

    Raises
    ------
    ValueError
        If the shapes differ, there are fewer than three different frequencies, a value
        is negative or not finite, or the amplitudes show no low-pass behavior.

    Notes
    -----
    Least squares, all points with equal weight, of
    :math:`A(f) = A(0) [1 + (f / f_c)^2]^{-1/2}`, eq. (71) of Ricci et al. 2010 [1]_, as
    rederived, with :math:`A(0)` and :math:`f_c` free. The standard error treats
    deviations from this form as independent noise. Fitted to the response of a receiver
    beside the laser, :math:`f_c` lies well below the half-power point (`cut_off`);
    `fit_of_power` lies near it.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> frequency = np.linspace(0.5e6, 138e6, 50)
    >>> sweep = 3.0 / np.sqrt(1 + (frequency / 20e6) ** 2)
    >>> result = fit(frequency, sweep)
    >>> print(f"{result.cut_off / 1e6:.2f} MHz, {result.amplitude_at_zero:.2f}")
    20.00 MHz, 3.00
    """
    f, a = _checked(modulation_frequency, amplitude)
    x, y = f / f.max(), a / a.max()

    def form(logarithm: Any) -> NDArray[np.float64]:
        return np.asarray(1 / np.sqrt(1 + (x / np.exp(logarithm)) ** 2))

    # For a given cut-off the best amplitude is linear; the best of a grid starts.
    grid = _grid(x)
    shapes = form(grid[:, None])
    best = shapes @ y / np.sum(shapes**2, axis=1)
    residual_sum = np.sum((y - best[:, None] * shapes) ** 2, axis=1)
    closest = _closest(residual_sum, f)

    def residual(parameter: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(parameter[0] * form(parameter[1]) - y)

    def jacobian(parameter: NDArray[np.float64]) -> NDArray[np.float64]:
        shape = form(parameter[1])
        return np.stack([shape, parameter[0] * shape * (1 - shape**2)], axis=1)

    result = least_squares(
        residual,
        [best[closest], grid[closest]],
        jac=jacobian,
        method="lm",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    variance = 2 * result.cost / max(f.size - 2, 1)
    covariance = variance * np.linalg.inv(result.jac.T @ result.jac)
    corner = float(f.max() * np.exp(result.x[1]))
    return LowPassFit(
        cut_off=corner,
        cut_off_standard_error=corner * float(np.sqrt(covariance[1, 1])),
        amplitude_at_zero=float(result.x[0] * a.max()),
    )


def fit_of_power(modulation_frequency: ArrayLike, amplitude: ArrayLike) -> LowPassFit:
    r"""Fit a first-order low-pass to the squared amplitudes of a frequency sweep.

    Parameters
    ----------
    modulation_frequency : array_like, shape (n,)
        Frequencies of the intensity modulation, not negative [Hz].
    amplitude : array_like, shape (n,)
        Amplitude of the signal at each, not negative [any unit].

    Returns
    -------
    LowPassFit
        Cut-off, its standard error, and the largest amplitude, used as that at zero
        frequency.

    Raises
    ------
    ValueError
        As for `fit`.

    Notes
    -----
    Least squares, all points with equal weight, of
    :math:`[A(f) / A_0]^2 = [1 + (f / f_c)^2]^{-1}`, the square of eq. (71) of Ricci et
    al. 2010 [1]_, as rederived, with :math:`f_c` free and :math:`A_0` the largest of
    the data: the paper normalizes measured sweeps to their maximum and defines the
    cut-off by power. The squares emphasize samples near half power, whereas `fit`
    emphasizes the long tail of small amplitudes. For a receiver beside the laser the
    result is within some 5 % of the half-power point (`cut_off`). The maximum of noisy
    data is biased upwards, which lowers the cut-off.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> frequency = np.linspace(0, 138e6, 50)
    >>> sweep = 3.0 / np.sqrt(1 + (frequency / 20e6) ** 2)
    >>> result = fit_of_power(frequency, sweep)
    >>> print(f"{result.cut_off / 1e6:.2f} MHz, {result.amplitude_at_zero:.2f}")
    20.00 MHz, 3.00
    """
    f, a = _checked(modulation_frequency, amplitude)
    x, y = f / f.max(), (a / a.max()) ** 2

    def form(logarithm: Any) -> NDArray[np.float64]:
        return np.asarray(1 / (1 + (x / np.exp(logarithm)) ** 2))

    grid = _grid(x)
    start = _closest(np.sum((y - form(grid[:, None])) ** 2, axis=1), f)
    # The level is held, so that a form can be closest to a sweep that rises.
    if np.sum((y - y.mean()) * form(grid[start])) <= 0:
        raise _not_shown(f)

    def slope(logarithm: NDArray[np.float64]) -> NDArray[np.float64]:
        shape = form(logarithm[0])
        return np.asarray((2 * shape * (1 - shape))[:, None])

    result = least_squares(
        lambda logarithm: np.asarray(form(logarithm[0]) - y),
        [grid[start]],
        jac=slope,
        method="lm",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    variance = 2 * result.cost / max(f.size - 1, 1)
    corner = float(f.max() * np.exp(result.x[0]))
    error = float(np.sqrt(variance / np.sum(result.jac**2)))
    return LowPassFit(
        cut_off=corner,
        cut_off_standard_error=corner * error,
        amplitude_at_zero=float(a.max()),
    )


def _checked(
    modulation_frequency: ArrayLike, amplitude: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return frequencies and amplitudes of a sweep, checked for at least 3 samples."""
    f = not_negative(modulation_frequency, name="modulation_frequency", unit="Hz")
    a = not_negative(amplitude, name="amplitude")
    one_axis(3, modulation_frequency=f, amplitude=a)
    if np.unique(f).size < 3:
        raise ValueError(
            "modulation_frequency must have at least 3 different values [Hz], got "
            f"{np.unique(f).size}"
        )
    require(a.max(), a.max() > 0, name="the largest amplitude", rule="above 0")
    return f, a


def _grid(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a search grid of ln(cut-off / highest frequency)."""
    return np.linspace(np.log(x[x > 0].min()) - 7, 7, 400)


def _closest(residual_sum: NDArray[np.float64], f: NDArray[np.float64]) -> int:
    """Return the index of the least sum of squares; ValueError at the grid's ends."""
    closest = int(np.argmin(residual_sum))
    if closest in (0, residual_sum.size - 1):
        raise _not_shown(f)
    return closest


def _not_shown(f: NDArray[np.float64]) -> ValueError:
    """Return the exception for a sweep that does not show low-pass behavior."""
    return ValueError(
        f"the amplitudes between {f.min():g} and {f.max():g} Hz do not show where "
        "they fall to 1/sqrt(2); a cut-off cannot be fitted to them"
    )


def fit_if_shown(
    modulation_frequency: ArrayLike, amplitude: ArrayLike
) -> LowPassFit | None:
    """Fit a first-order low-pass to a sweep; None if the cut-off lies outside of it.

    Parameters
    ----------
    modulation_frequency, amplitude : array_like, shape (n,)
        As in `fit` [Hz, any unit].

    Returns
    -------
    LowPassFit or None
        As from `fit`; None if `fit` raises an error, or if the cut-off is extrapolated
        beyond the lowest or the highest frequency.

    Notes
    -----
    Eq. (71) of Ricci et al. 2010 [1]_, as rederived.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> frequency = np.linspace(0.5e6, 10e6, 50)
    >>> sweep = abs(first_order_response(frequency, cut_off=20e6))
    >>> print(fit_if_shown(frequency, sweep))
    None
    """
    try:
        result = fit(modulation_frequency, amplitude)
    except ValueError:
        return None
    f = np.asarray(modulation_frequency, dtype=float)
    return result if f.min() < result.cut_off < f.max() else None


def first_order_response(
    modulation_frequency: ArrayLike, *, cut_off: ArrayLike
) -> NDArray[np.complex128]:
    r"""Return the normalized amplitude response of a first-order low-pass.

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, not negative [Hz].
    cut_off : array_like
        Cut-off frequency f_c, above zero [Hz].

    Returns
    -------
    ndarray of complex
        Response over its value at zero frequency, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a frequency is negative or a cut-off is not above zero.

    Notes
    -----
    :math:`1 / (1 - i f / f_c)`: its modulus is eqs. (49) and (71) of Ricci et al.
    2010 [1]_, as rederived, and its phase, a delay, is :math:`\arctan(f / f_c)`.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> response = first_order_response(20e6, cut_off=20e6)
    >>> print(f"{abs(response):.4f}, {np.degrees(np.angle(response)):.0f} degrees")
    0.7071, 45 degrees
    """
    frequency = not_negative(
        modulation_frequency, name="modulation_frequency", unit="Hz"
    )
    corner = positive(cut_off, name="cut_off", unit="Hz")
    broadcast(modulation_frequency=frequency, cut_off=corner)
    return np.asarray(1 / (1 - 1j * (frequency / corner)))


def cut_off_of_narrow_receiver(
    *, reduced_attenuation: ArrayLike, group_index: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the cut-off of the water signal for a narrow coaxial receiver [Hz].

    Parameters
    ----------
    reduced_attenuation : array_like
        Reduced attenuation coefficient k' = a + b_d, not negative [1/m].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray
        Cut-off frequency, of the broadcast shape [Hz].

    Raises
    ------
    ValueError
        If a coefficient is negative or not a number, or a group index is below 1.

    Notes
    -----
    :math:`f_c = v k' / 2 \pi`, eq. (49) of Ricci et al. 2010 [1]_, as rederived. The
    factor 2 of the two-way path occurs in loss and delay alike, and cancels.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> corner = cut_off_of_narrow_receiver(reduced_attenuation=1.0, group_index=1.34)
    >>> print(f"{corner / 1e6:.1f} MHz")
    35.6 MHz
    """
    loss = not_negative(reduced_attenuation, name="reduced_attenuation", unit="1/m")
    index = at_least(group_index, 1, name="group_index")
    broadcast(reduced_attenuation=loss, group_index=index)
    return np.asarray(speed_of_light / index * loss / (2 * np.pi))
