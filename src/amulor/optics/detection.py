r"""Detection of modulated light: photoelectrons, lock-in bandwidth, phase noise.

A signal is in phase + i quadrature = amplitude * exp(+i phase), with PEAK amplitudes:
a photoelectron rate r [1 + m cos(omega t - phase)] has the amplitude m r.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import Planck, speed_of_light

from amulor.optics._bounds import (
    at_least,
    broadcast,
    measured,
    not_negative,
    positive,
    require,
    within,
)

__all__ = [
    "amplitude_uncertainty",
    "effective_integration_time",
    "phase_floor_covariance",
    "phase_uncertainty",
    "photoelectron_rate",
    "photon_noise",
    "quadrature_variance",
    "settled_integration_time",
    "speckle_contrast",
]

#: Standard error of a median over that of the mean, of normal deviates [1].
ERROR_OF_MEDIAN = 1.2533


def photoelectron_rate(
    power: ArrayLike, *, wavelength: ArrayLike, quantum_efficiency: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the photoelectron rate for an optical power [1/s].

    Parameters
    ----------
    power : array_like
        Optical power on the photocathode, not negative [W].
    wavelength : array_like
        Wavelength in vacuum, above zero [m].
    quantum_efficiency : array_like
        Photoelectrons per photon, above 0 and at most 1 [1].

    Returns
    -------
    ndarray
        Mean rate, of the broadcast shape [1/s].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    :math:`\eta P \lambda / h c`.

    Examples
    --------
    >>> rate = photoelectron_rate(1e-12, wavelength=405e-9, quantum_efficiency=0.25)
    >>> print(f"{rate:.3g} 1/s")
    5.1e+05 1/s
    """
    light = measured(power, name="power", unit="W")
    vacuum = positive(wavelength, name="wavelength", unit="m")
    efficiency = within(
        quantum_efficiency,
        0,
        1,
        name="quantum_efficiency",
        above=True,
        hint="20 % is 0.2",
    )
    broadcast(power=light, wavelength=vacuum, quantum_efficiency=efficiency)
    rate: NDArray[np.float64] = efficiency * light * vacuum / (Planck * speed_of_light)
    return rate


def effective_integration_time(
    duration: ArrayLike, *, time_constant: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the white-noise integration time of an averaged lock-in output [s].

    Parameters
    ----------
    duration : array_like
        Time T over which the settled output is averaged, not negative [s]. Zero means a
        single reading.
    time_constant : array_like
        Time constant of the one-pole output filter, not negative [s]. Zero means no
        filter.

    Returns
    -------
    ndarray
        Length of a plain average of the unfiltered signal with the same variance,
        of the broadcast shape [s].

    Raises
    ------
    ValueError
        If a time is negative, or if both are zero.

    Notes
    -----
    White noise after a one-pole filter has the autocorrelation
    :math:`e^{-|t|/\tau} / 2\tau`; its mean over T has the variance of a plain mean
    over

    .. math::

       T_e = \frac{T}{1 - (\tau / T) (1 - e^{-T/\tau})},

    which is :math:`T` for :math:`\tau \ll T` and :math:`2\tau`, the inverse of the
    two-sided noise bandwidth, for :math:`T \ll \tau`. The filter must have settled
    on the signal, some time constants, before the average begins.

    Examples
    --------
    >>> print(f"{effective_integration_time(0.1, time_constant=0.03):.4f} s")
    0.1407 s
    """
    mean = not_negative(duration, name="duration", unit="s")
    tau = not_negative(time_constant, name="time_constant", unit="s")
    broadcast(duration=mean, time_constant=tau)
    mean, tau = np.broadcast_arrays(mean, tau)
    require(
        mean + tau,
        (mean > 0) | (tau > 0),
        name="duration + time_constant",
        rule="above 0",
        unit="s",
        hint="an instantaneous reading without a filter has unlimited noise",
    )
    filtered = tau > mean * 1e-15
    x = mean / np.where(filtered, tau, 1.0)
    small = x < 0.5
    # (x - 1 + exp(-x)) / x^2, by its series where the difference would cancel.
    series = np.zeros_like(x)
    for order in range(14, -1, -1):
        series = (1 - np.where(small, x, 0.0) * series) / (order + 2)
    large = np.where(small, 1.0, x)
    ratio = np.where(small, series, (large + np.expm1(-large)) / large**2)
    return np.where(filtered, tau / ratio, mean)


def settled_integration_time(
    dwell: ArrayLike, *, time_constant: ArrayLike, settling: float = 5.0
) -> NDArray[np.float64]:
    r"""Return the white-noise integration time of a lock-in sample after settling [s].

    Parameters
    ----------
    dwell : array_like
        Time spent on the sample, settling included, not negative [s].
    time_constant : array_like
        Time constant of the one-pole output filter, above zero [s].
    settling : float
        Wait before the average begins, in time constants, not negative [1].

    Returns
    -------
    ndarray
        Effective integration time after settling, of the broadcast shape [s]. A dwell
        shorter than the settling still gives one reading.

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    `effective_integration_time` of :math:`\max(T_d - s \tau, 0)`.

    Examples
    --------
    >>> print(f"{settled_integration_time(0.125, time_constant=0.01):.4f} s")
    0.0865 s
    """
    total = not_negative(dwell, name="dwell", unit="s")
    constant = positive(time_constant, name="time_constant", unit="s")
    wait = not_negative(settling, name="settling", unit="time constants")
    broadcast(dwell=total, time_constant=constant, settling=wait)
    averaging = np.maximum(total - wait * constant, 0.0)
    return effective_integration_time(averaging, time_constant=constant)


def quadrature_variance(
    photoelectron_rate: ArrayLike,
    *,
    integration_time: ArrayLike,
    excess_noise_factor: ArrayLike = 1.0,
    dark_rate: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    r"""Return the shot-noise variance of each lock-in quadrature [1/s^2].

    Parameters
    ----------
    photoelectron_rate : array_like
        Mean rate r of photoelectrons from all light on the detector, modulated or
        not, not negative [1/s].
    integration_time : array_like
        Integration time T of white noise, above zero [s]; see
        `effective_integration_time`.
    excess_noise_factor : array_like
        Excess noise factor F of the multiplication, at least 1 [1].
    dark_rate : array_like
        Mean rate of dark counts, not negative [1/s].

    Returns
    -------
    ndarray
        Variance of either of the two PEAK amplitudes, which are not correlated,
        of the broadcast shape [1/s^2].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    :math:`2 F (r + d) / T`: the in-phase amplitude is estimated by
    :math:`(2 / T) \sum_i \cos\omega t_i` over the times of the photoelectrons, each
    of which adds :math:`\langle\cos^2\rangle = 1/2`. T must hold many periods of
    the modulation. With the amplitude :math:`m r` the phase error is
    :math:`\sqrt{2} / m \sqrt{N}`, the photon limit of eq. (2) of Ricci et al. 2010,
    as rederived.

    Examples
    --------
    >>> variance = quadrature_variance(1e6, integration_time=0.1)
    >>> print(f"{np.sqrt(variance):.0f} photoelectrons/s")
    4472 photoelectrons/s
    """
    rate = measured(photoelectron_rate, name="photoelectron_rate", unit="1/s")
    dark = measured(dark_rate, name="dark_rate", unit="1/s")
    time = positive(integration_time, name="integration_time", unit="s")
    excess = at_least(excess_noise_factor, 1, name="excess_noise_factor")
    broadcast(
        photoelectron_rate=rate,
        dark_rate=dark,
        integration_time=time,
        excess_noise_factor=excess,
    )
    return 2 * excess * (rate + dark) / time


def photon_noise(
    integration_time: ArrayLike, *, volt_per_photoelectron_rate: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the photon-noise variance of a detector output, per volt of mean output.

    Parameters
    ----------
    integration_time : array_like
        Integration time T of white noise, above zero [s].
    volt_per_photoelectron_rate : array_like
        Output k per rate of photoelectrons, above zero [V s].

    Returns
    -------
    ndarray
        Voltage V such that light of the peak amplitude A and the modulation depth m has
        the photon-noise variance :math:`V A / m` in either output, of the broadcast
        shape [V].

    Raises
    ------
    ValueError
        If an argument is not above zero.

    Notes
    -----
    :math:`V = 2 k / T`: the light that belongs to A releases :math:`r = A / (m k)`
    photoelectrons per second, of which `quadrature_variance` makes
    :math:`2 k^2 r / T` without excess noise and dark counts.

    Examples
    --------
    >>> volt = photon_noise(0.1, volt_per_photoelectron_rate=8e-12)
    >>> print(f"{volt:.1e} V")
    1.6e-10 V
    """
    time = positive(integration_time, name="integration_time", unit="s")
    volt = positive(
        volt_per_photoelectron_rate, name="volt_per_photoelectron_rate", unit="V s"
    )
    broadcast(integration_time=time, volt_per_photoelectron_rate=volt)
    return np.asarray(volt * quadrature_variance(1.0, integration_time=time))


def speckle_contrast(speckle_cells: ArrayLike) -> NDArray[np.float64]:
    r"""Return the relative intensity fluctuation due to speckle of a rough surface [1].

    Parameters
    ----------
    speckle_cells : array_like
        Number M of speckles that the aperture collects, at least 1 [1].

    Returns
    -------
    ndarray
        Standard deviation over mean of the received power, of the same shape [1].

    Raises
    ------
    ValueError
        If there is less than one speckle.

    Notes
    -----
    :math:`1 / \sqrt M`, J. W. Goodman, Speckle Phenomena in Optics (2007), chapter 4:
    the power of M speckles is gamma distributed. An illuminated spot of area S at
    distance d causes speckles of an area of about :math:`(\lambda d)^2 / S`.

    Examples
    --------
    >>> print(f"{speckle_contrast(400):.2f}")
    0.05
    """
    cells = at_least(speckle_cells, 1, name="speckle_cells")
    return np.asarray(1 / np.sqrt(cells))


def phase_floor_covariance(
    signal: ArrayLike, *, phase_floor: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    r"""Return variances and covariance of a signal due to a random phase error.

    Parameters
    ----------
    signal : array_like
        Complex signal, in phase + i quadrature, any unit.
    phase_floor : array_like
        Standard deviation of the phase error, finite and not negative [rad].

    Returns
    -------
    in_phase_variance, quadrature_variance : ndarray
        Variances of the two parts, of the broadcast shape [unit^2].
    covariance : ndarray
        Covariance of the two [unit^2].

    Raises
    ------
    ValueError
        If the phase floor is negative or not finite.

    Notes
    -----
    First order in the error :math:`\sigma`, which moves the signal along its circle:

    .. math::

       \sigma_I^2 = \sigma^2 Q^2, \qquad \sigma_Q^2 = \sigma^2 I^2, \qquad
       \sigma_{IQ} = -\sigma^2 I Q.

    `phase_uncertainty` of these is :math:`\sigma`, `amplitude_uncertainty` zero.
    Holds for :math:`\sigma` well below 1 rad.

    Examples
    --------
    >>> in_phase, quadrature, shared = phase_floor_covariance(3 + 4j, phase_floor=0.1)
    >>> print(f"{in_phase:.2f} {quadrature:.2f} {shared:.2f}")
    0.16 0.09 -0.12
    """
    phasor = np.asarray(signal, dtype=np.complex128)
    along = not_negative(phase_floor, name="phase_floor", unit="rad") ** 2
    broadcast(signal=phasor, phase_floor=along)
    return (
        np.asarray(along * phasor.imag**2),
        np.asarray(along * phasor.real**2),
        np.asarray(-along * phasor.real * phasor.imag),
    )


def phase_uncertainty(
    signal: ArrayLike,
    *,
    in_phase_variance: ArrayLike,
    quadrature_variance: ArrayLike,
    covariance: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    r"""Return the standard deviation of the phase of a noisy signal [rad].

    Parameters
    ----------
    signal : array_like
        Complex signal, in phase + i quadrature, any unit.
    in_phase_variance : array_like
        Variance of the in-phase part, not negative [unit^2].
    quadrature_variance : array_like
        Variance of the quadrature part, not negative [unit^2].
    covariance : array_like
        Covariance of the two [unit^2].

    Returns
    -------
    ndarray
        Standard deviation, of the broadcast shape [rad]. Infinite where the signal
        is zero and has no phase.

    Raises
    ------
    ValueError
        If a variance is negative or the covariance exceeds what the variances
        allow.

    Notes
    -----
    First order in the noise, for :math:`I` in phase and :math:`Q` in quadrature:

    .. math::

       \sigma_\varphi^2
           = \frac{Q^2 \sigma_I^2 + I^2 \sigma_Q^2 - 2 I Q \sigma_{IQ}}
                  {(I^2 + Q^2)^2}.

    Holds while the result is well below 1 rad; beyond, the wrapped phase scatters less
    than this.

    Examples
    --------
    >>> deviation = phase_uncertainty(
    ...     100j, in_phase_variance=4.0, quadrature_variance=9.0
    ... )
    >>> print(f"{deviation:.2f} rad")
    0.02 rad
    """
    phasor, *moments = _checked_moments(
        signal, in_phase_variance, quadrature_variance, covariance
    )
    in_phase, quadrature, shared = moments
    amplitude = np.abs(phasor)
    dark = amplitude == 0
    scale = np.where(dark, 1.0, amplitude)
    cosine, sine = phasor.real / scale, phasor.imag / scale
    across = sine**2 * in_phase + cosine**2 * quadrature - 2 * cosine * sine * shared
    deviation = np.sqrt(np.maximum(across, 0.0))  # rounding below zero only
    return np.where(dark, np.inf, deviation / scale)


def amplitude_uncertainty(
    signal: ArrayLike,
    *,
    in_phase_variance: ArrayLike,
    quadrature_variance: ArrayLike,
    covariance: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    r"""Return the standard deviation of the amplitude of a noisy signal.

    Parameters
    ----------
    signal : array_like
        Complex signal, in phase + i quadrature, any unit.
    in_phase_variance : array_like
        Variance of the in-phase part, not negative [unit^2].
    quadrature_variance : array_like
        Variance of the quadrature part, not negative [unit^2].
    covariance : array_like
        Covariance of the two [unit^2].

    Returns
    -------
    ndarray
        Standard deviation, of the broadcast shape [unit of the signal]. For a zero
        signal, the largest value over all directions.

    Raises
    ------
    ValueError
        If a variance is negative or the covariance exceeds what the variances
        allow.

    Notes
    -----
    First order in the noise, for :math:`I` in phase and :math:`Q` in quadrature:

    .. math::

       \sigma_A^2
           = \frac{I^2 \sigma_I^2 + Q^2 \sigma_Q^2 + 2 I Q \sigma_{IQ}}
                  {I^2 + Q^2}.

    Examples
    --------
    >>> deviation = amplitude_uncertainty(
    ...     100j, in_phase_variance=4.0, quadrature_variance=9.0
    ... )
    >>> print(f"{deviation:.1f}")
    3.0
    """
    phasor, *moments = _checked_moments(
        signal, in_phase_variance, quadrature_variance, covariance
    )
    in_phase, quadrature, shared = moments
    amplitude = np.abs(phasor)
    dark = amplitude == 0
    scale = np.where(dark, 1.0, amplitude)
    cosine, sine = phasor.real / scale, phasor.imag / scale
    along = cosine**2 * in_phase + sine**2 * quadrature + 2 * cosine * sine * shared
    largest = (in_phase + quadrature) / 2 + np.hypot(
        (in_phase - quadrature) / 2, shared
    )
    return np.sqrt(np.where(dark, largest, np.maximum(along, 0.0)))


def _checked_moments(
    signal: ArrayLike,
    in_phase_variance: ArrayLike,
    quadrature_variance: ArrayLike,
    covariance: ArrayLike,
) -> tuple[
    NDArray[np.complex128],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]:
    """Return signal, variances and covariance as arrays, checked for consistency."""
    phasor = np.asarray(signal, dtype=np.complex128)
    in_phase = measured(in_phase_variance, name="in_phase_variance")
    quadrature = measured(quadrature_variance, name="quadrature_variance")
    shared = np.asarray(covariance, dtype=np.float64)
    broadcast(
        signal=phasor,
        in_phase_variance=in_phase,
        quadrature_variance=quadrature,
        covariance=shared,
    )
    too_large = shared**2 > in_phase * quadrature * (1 + 1e-9)
    require(
        np.broadcast_to(shared, too_large.shape),
        ~too_large,
        name="covariance",
        rule="at most the root of the product of the variances",
        hint="the three do not belong to one random pair",
    )
    return phasor, in_phase, quadrature, shared
