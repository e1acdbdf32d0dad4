"""Modulation phase and slant range: conversion, ambiguity interval, precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics._bounds import (
    above_zero,
    at_least,
    broadcast,
    measured,
    positive,
    within,
)

__all__ = [
    "ambiguity_interval",
    "phase",
    "phase_per_range",
    "phase_shift",
    "photon_limited_uncertainty",
    "range_per_phase",
    "slant_range",
    "slant_range_uncertainty",
    "weights_and_uncertainty",
]


def phase(
    slant_range: ArrayLike, *, modulation_frequency: ArrayLike, group_index: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the modulation phase delay of an echo from a slant range [rad].

    Parameters
    ----------
    slant_range : array_like
        Distance along the line of sight, not negative [m].
    modulation_frequency : array_like
        Frequency of the intensity modulation, above zero [Hz].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray
        Delay of the echo behind the reference, unwrapped, of the broadcast
        shape [rad]. It grows with the distance.

    Raises
    ------
    ValueError
        If a distance is negative, a modulation frequency is not above zero or
        a group index is below 1.

    Notes
    -----
    Eq. (72) of Ricci et al. 2010 [1]_, as rederived,
    :math:`\Delta\varphi = 4 \pi f_m L / v` with the group velocity
    :math:`v = c / n_g`; light travels the distance twice.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> delay = phase(0.01, modulation_frequency=39e6, group_index=1.34)
    >>> print(f"{np.degrees(delay):.3f} degrees")
    1.255 degrees
    """
    distance = measured(slant_range, name="slant_range", unit="m")
    frequency, velocity = _frequency(modulation_frequency), _velocity(group_index)
    broadcast(
        slant_range=distance, modulation_frequency=frequency, group_index=velocity
    )
    return 4 * np.pi * frequency * distance / velocity


def slant_range(
    phase: ArrayLike, *, modulation_frequency: ArrayLike, group_index: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the slant range for a modulation phase delay [m].

    Parameters
    ----------
    phase : array_like
        Delay of the echo behind the reference, unwrapped [rad].
    modulation_frequency : array_like
        Frequency of the intensity modulation, above zero [Hz].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1]. With
        the phase index every distance would come out about 3 % too long at
        405 nm.

    Returns
    -------
    ndarray
        Distance along the line of sight, of the broadcast shape [m].

    Raises
    ------
    ValueError
        If a modulation frequency is not above zero or a group index is below 1.

    Notes
    -----
    Eq. (1) of Ricci et al. 2010 [1]_, as rederived,
    :math:`L = v \Delta\varphi / 4 \pi f_m`, with the group velocity
    :math:`v = c / n_g`. Unambiguous up to :math:`v / 2 f_m`
    (`ambiguity_interval`).

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> distance = slant_range(np.pi, modulation_frequency=50e6, group_index=1.38)
    >>> print(f"{distance:.4f} m")
    1.0862 m
    """
    frequency, velocity = _frequency(modulation_frequency), _velocity(group_index)
    delay = np.asarray(phase, dtype=np.float64)
    broadcast(phase=delay, modulation_frequency=frequency, group_index=velocity)
    return velocity * delay / (4 * np.pi * frequency)


def ambiguity_interval(
    modulation_frequency: ArrayLike, *, group_index: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the range interval after which the modulation phase repeats [m].

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, above zero [Hz].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray
        Difference of two distances with the same wrapped phase [m].

    Raises
    ------
    ValueError
        If a modulation frequency is not above zero or a group index is below 1.

    Notes
    -----
    :math:`v / 2 f_m`, eq. (1) of Ricci et al. 2010 [1]_, as rederived, at a
    phase of :math:`2 \pi`.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> print(f"{ambiguity_interval(39e6, group_index=1.34):.2f} m")
    2.87 m
    """
    frequency, velocity = _frequency(modulation_frequency), _velocity(group_index)
    broadcast(modulation_frequency=frequency, group_index=velocity)
    return velocity / (2 * frequency)


def slant_range_uncertainty(
    phase_uncertainty: ArrayLike,
    *,
    modulation_frequency: ArrayLike,
    group_index: ArrayLike,
) -> NDArray[np.float64]:
    r"""Return the standard uncertainty of a slant range due to that of the phase [m].

    Parameters
    ----------
    phase_uncertainty : array_like
        Standard deviation of the phase, not negative [rad].
    modulation_frequency : array_like
        Frequency of the intensity modulation, above zero [Hz].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray
        Standard deviation of the distance, of the broadcast shape [m].

    Raises
    ------
    ValueError
        If an uncertainty is negative, a modulation frequency is not above zero
        or a group index is below 1.

    Notes
    -----
    Eq. (1) of Ricci et al. 2010 [1]_, as rederived, is linear in the phase, so
    :math:`\sigma_d = v \sigma_\varphi / 4 \pi f_m`. The uncertainties of the
    modulation frequency and of the group index are not part of it.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> deviation = slant_range_uncertainty(
    ...     np.radians(0.25), modulation_frequency=39e6, group_index=1.34
    ... )
    >>> print(f"{1e3 * deviation:.2f} mm")
    1.99 mm
    """
    deviation = measured(phase_uncertainty, name="phase_uncertainty", unit="rad")
    frequency, velocity = _frequency(modulation_frequency), _velocity(group_index)
    broadcast(
        phase_uncertainty=deviation,
        modulation_frequency=frequency,
        group_index=velocity,
    )
    return velocity * deviation / (4 * np.pi * frequency)


def phase_per_range(
    modulation_frequency: ArrayLike, *, group_index: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the phase delay per unit of slant range [rad/m].

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, above zero [Hz].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray
        Derivative of the phase with respect to the distance along the line of sight,
        of the broadcast shape [rad/m].

    Raises
    ------
    ValueError
        If a modulation frequency is not above zero or a group index is below 1.

    Notes
    -----
    :math:`4 \pi f_m n_g / c`, the derivative of eq. (72) of Ricci et al. 2010, as
    rederived; light travels the distance twice.

    Examples
    --------
    >>> print(f"{phase_per_range(39e6, group_index=1.34):.4f} rad/m")
    2.1906 rad/m
    """
    frequency, index = _frequency(modulation_frequency), _group_index(group_index)
    broadcast(modulation_frequency=frequency, group_index=index)
    per_range: NDArray[np.float64] = 4 * np.pi * frequency * index / speed_of_light
    return per_range


def range_per_phase(
    modulation_frequency: ArrayLike, *, group_index: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the slant range per unit of phase delay [m/rad].

    It converts phase errors to errors of the slant range, including their sign, for
    each frequency. Twice the value at a group index of 1 is the two-way optical path
    that belongs to a phase, whatever media the light crosses.

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, above zero [Hz].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray
        Derivative of the distance along the line of sight with respect to the phase,
        of the broadcast shape [m/rad].

    Raises
    ------
    ValueError
        If a modulation frequency is not above zero or a group index is below 1.

    Notes
    -----
    :math:`c / 4 \pi f_m n_g`, the derivative of eq. (1) of Ricci et al. 2010, as
    rederived.

    Examples
    --------
    >>> print(f"{range_per_phase(39e6, group_index=1.34) * 1e3:.1f} mm/rad")
    456.5 mm/rad
    """
    frequency, index = _frequency(modulation_frequency), _group_index(group_index)
    broadcast(modulation_frequency=frequency, group_index=index)
    per_phase: NDArray[np.float64] = speed_of_light / (4 * np.pi * frequency * index)
    return per_phase


def phase_shift(signal: ArrayLike, *, residual: ArrayLike) -> NDArray[np.float64]:
    r"""Return the phase error of a signal due to a residual water signal [rad].

    Parameters
    ----------
    signal : array_like
        Complex signal that includes the residual, any unit.
    residual : array_like
        Complex signal that does not belong to the target, such as the residual water
        signal after rejection, same unit.

    Returns
    -------
    ndarray
        Phase with the residual less phase without it, wrapped to -pi..pi, of the
        broadcast shape [rad]; times `range_per_phase` the shift of the slant range.
        Zero, to rounding, for a zero residual; NaN if one of the two is NaN, or both
        are zero.

    Notes
    -----
    :math:`\arg(S / (S - R))` of the signal S and the residual R: what
    `amulor.optics.interference.phase_error` is for a known target signal, here for a
    known total.

    Examples
    --------
    >>> print(f"{phase_shift(1.0 - 0.125j, residual=-0.125j):.4f} rad")
    -0.1244 rad
    """
    total = np.asarray(signal, dtype=np.complex128)
    remaining = np.asarray(residual, dtype=np.complex128)
    broadcast(signal=total, residual=remaining)
    with np.errstate(invalid="ignore", divide="ignore"):
        corrected = total - remaining
        shift: NDArray[np.float64] = np.asarray(np.angle(total / corrected))
    return shift


def weights_and_uncertainty(
    standard_uncertainty: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return inverse-variance weights, and the uncertainty of the weighted mean.

    Parameters
    ----------
    standard_uncertainty : array_like, shape (n, ...)
        Standard uncertainty of each of n ranges of one target, such as one for each
        modulation frequency, not negative [any unit].

    Returns
    -------
    weights : ndarray, shape (n, ...)
        Weight of each, with the sum 1 along the first axis [1].
    uncertainty : ndarray, shape (...)
        Standard uncertainty of the weighted mean [that unit].

    Notes
    -----
    :math:`w_i = \sigma_i^{-2} / \sum_j \sigma_j^{-2}` and
    :math:`\sigma = (\sum_j \sigma_j^{-2})^{-1/2}`; a range without any error counts
    as one with an error of 1e-150.

    Examples
    --------
    >>> weights, uncertainty = weights_and_uncertainty([3.0, 4.0])
    >>> print(weights, uncertainty)
    [0.64 0.36] 2.4
    """
    deviation = np.asarray(standard_uncertainty, dtype=np.float64)
    precision = np.maximum(deviation, 1e-150) ** -2.0
    total = precision.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return precision / total, total**-0.5


def photon_limited_uncertainty(
    photoelectrons: ArrayLike,
    *,
    modulation_depth: ArrayLike,
    modulation_frequency: ArrayLike,
    group_index: ArrayLike,
) -> NDArray[np.float64]:
    r"""Return the photon-limited standard uncertainty of a slant range [m].

    Parameters
    ----------
    photoelectrons : array_like
        Mean number N of photoelectrons, modulated and not, that are detected in
        the integration time, above zero [1].
    modulation_depth : array_like
        Modulation depth m of the detected light, above 0 and at most 1 [1].
    modulation_frequency : array_like
        Frequency of the intensity modulation, above zero [Hz].
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].

    Returns
    -------
    ndarray
        Standard deviation of the distance, of the broadcast shape [m].

    Raises
    ------
    ValueError
        If one of the arguments is outside of the range given above.

    Notes
    -----
    Eq. (2) of Ricci et al. 2010 [1]_, as rederived,

    .. math:: \sigma_d = \frac{v}{4 \pi f_m} \frac{\kappa_0}{m \, \mathrm{SNR}},

    with :math:`\kappa_0 = \sqrt 2`, which belongs to the current
    signal-to-noise ratio :math:`\mathrm{SNR} = \sqrt N`. Texts that define the
    ratio with another noise bandwidth have another :math:`\kappa_0`. The
    phase part is first order in :math:`1 / m \sqrt N` and holds where that is
    well below 1; excess noise of the detector and dark counts are not part of
    it (see `amulor.optics.detection`).

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> deviation = photon_limited_uncertainty(
    ...     1e6, modulation_depth=0.8, modulation_frequency=39e6, group_index=1.38
    ... )
    >>> print(f"{1e3 * deviation:.2f} mm")
    0.78 mm
    """
    count = above_zero(photoelectrons, name="photoelectrons")
    depth = within(modulation_depth, 0, 1, name="modulation_depth", above=True)
    broadcast(photoelectrons=count, modulation_depth=depth)
    phase_uncertainty = np.sqrt(2) / (depth * np.sqrt(count))
    return slant_range_uncertainty(
        phase_uncertainty,
        modulation_frequency=modulation_frequency,
        group_index=group_index,
    )


def _frequency(modulation_frequency: ArrayLike) -> NDArray[np.float64]:
    """Return the modulation frequency as an array; ValueError unless above zero."""
    return positive(modulation_frequency, name="modulation_frequency", unit="Hz")


def _velocity(group_index: ArrayLike) -> NDArray[np.float64]:
    """Return the group velocity for a group index of at least 1 [m/s]."""
    velocity: NDArray[np.float64] = speed_of_light / _group_index(group_index)
    return velocity


def _group_index(group_index: ArrayLike) -> NDArray[np.float64]:
    """Return the group index as an array; ValueError if below 1."""
    return at_least(group_index, 1, name="group_index", hint="water has about 1.38")
