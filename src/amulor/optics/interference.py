r"""Interference of target and water signal: their complex sum and its contrast.

The signals are complex, in phase + i quadrature = amplitude * exp(+i phase), with
the phase the delay behind the reference. Equation numbers are those of R. Ricci et
al., EURASIP J. Adv. Signal Process. 2010, 958360, doi:10.1155/2010/958360, as
rederived.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import broadcast, measured, require

__all__ = [
    "contrast",
    "phase_error",
    "signal_to_optical_noise_ratio",
    "target_amplitude_and_phase",
    "target_signal",
    "total_amplitude_and_phase",
    "total_signal",
]


def total_signal(
    target_signal: ArrayLike, water_signal: ArrayLike
) -> NDArray[np.complex128]:
    r"""Return the complex sum of target signal and water signal.

    Parameters
    ----------
    target_signal : array_like
        Complex signal of the target alone, any unit.
    water_signal : array_like
        Complex signal of the water alone, same unit.

    Returns
    -------
    ndarray
        Sum of the two phasors, of the broadcast shape, same unit.

    Notes
    -----
    Eq. (50) of Ricci et al. 2010, as rederived,
    :math:`A e^{i\varphi} = A_t e^{i\varphi_t} + A_w e^{i\varphi_w}`.

    Examples
    --------
    >>> print(total_signal(1.0 + 0.5j, -0.25 + 0.25j))
    (0.75+0.75j)
    """
    target = np.asarray(target_signal, dtype=np.complex128)
    water = np.asarray(water_signal, dtype=np.complex128)
    broadcast(target_signal=target, water_signal=water)
    return target + water


def target_signal(signal: ArrayLike, water_signal: ArrayLike) -> NDArray[np.complex128]:
    r"""Return the target signal after subtraction of the water signal.

    Parameters
    ----------
    signal : array_like
        Complex signal of target and water together, any unit.
    water_signal : array_like
        Complex signal of the water alone, same unit.

    Returns
    -------
    ndarray
        Difference of the two phasors, of the broadcast shape, same unit.

    Notes
    -----
    Eqs. (55)-(57) of Ricci et al. 2010, as rederived, are this difference in
    amplitude and phase (`target_amplitude_and_phase`).

    Examples
    --------
    >>> print(target_signal(0.75 + 0.75j, -0.25 + 0.25j))
    (1+0.5j)
    """
    total = np.asarray(signal, dtype=np.complex128)
    water = np.asarray(water_signal, dtype=np.complex128)
    broadcast(signal=total, water_signal=water)
    return total - water


def phase_error(
    target_signal: ArrayLike, water_signal: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the phase error of the target signal caused by the water signal [rad].

    Parameters
    ----------
    target_signal : array_like
        Complex signal of the target alone, not zero, any unit.
    water_signal : array_like
        Complex signal of the water alone, same unit.

    Returns
    -------
    ndarray
        Phase of the sum less phase of the target, wrapped to -pi..pi, of the
        broadcast shape [rad]. Negative where the target seems too near.

    Raises
    ------
    ValueError
        If a target signal is zero, which has no phase.

    Notes
    -----
    :math:`\varphi - \varphi_t = \arg(1 + A_w e^{i\varphi_w} / A_t e^{i\varphi_t})`
    from eq. (50) of Ricci et al. 2010, as rederived. For :math:`A_w < A_t` it
    stays within :math:`\pm\arcsin(A_w / A_t)`. Where the two cancel the phase of
    the sum, and with it the value returned, has no meaning.

    Examples
    --------
    >>> print(f"{phase_error(1.0, -0.125j):.4f} rad")
    -0.1244 rad
    """
    target = np.asarray(target_signal, dtype=np.complex128)
    require(
        target,
        target != 0,
        name="target_signal",
        rule="other than 0",
        hint="without a target echo there is no phase to be in error; leave it out",
    )
    total = total_signal(target, water_signal)
    error: NDArray[np.float64] = np.angle(total * np.exp(-1j * np.angle(target)))
    return error


def signal_to_optical_noise_ratio(
    signal: ArrayLike, water_signal: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the ratio of signal modulus to water-signal modulus [1].

    Parameters
    ----------
    signal : array_like
        Complex signal, of target and water together for eq. (54) or of the
        target alone for eq. (58), any unit.
    water_signal : array_like
        Complex signal of the water alone, not zero, same unit.

    Returns
    -------
    ndarray
        Ratio of the moduli, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a water signal is zero.

    Notes
    -----
    Eqs. (54) and (58) of Ricci et al. 2010, as rederived,
    :math:`\mathrm{SNR} = A / A_w`. The noise meant is the light scattered by the
    water, not the random current noise of eq. (2).

    Examples
    --------
    >>> print(f"{signal_to_optical_noise_ratio(3.0 + 4.0j, 2.0j):.2f}")
    2.50
    """
    total, water = _moduli(signal, water_signal)
    require(
        water,
        water != 0,
        name="water_signal",
        rule="other than 0",
        hint="the ratio has no limit without water; use contrast, which is 1 there",
    )
    return total / water


def contrast(signal: ArrayLike, water_signal: ArrayLike) -> NDArray[np.float64]:
    r"""Return the contrast of a signal with that of the water, eq. (54) or (58).

    Parameters
    ----------
    signal : array_like
        Complex signal, of target and water together for eq. (54) or of the
        target alone for eq. (58), any unit.
    water_signal : array_like
        Complex signal of the water alone, same unit.

    Returns
    -------
    ndarray
        Contrast between -1 and 1, of the broadcast shape [1]. Negative where the
        signal is weaker than that of the water alone.

    Raises
    ------
    ValueError
        If both signals are zero.

    Notes
    -----
    Eqs. (54) and (58) of Ricci et al. 2010, as rederived,
    :math:`C = (A - A_w) / (A + A_w)`, which is
    :math:`(\mathrm{SNR} - 1) / (\mathrm{SNR} + 1)`.

    Examples
    --------
    >>> print(f"{contrast(3.0 + 4.0j, 2.0j):.4f}")
    0.4286
    """
    total, water = _moduli(signal, water_signal)
    require(
        total + water,
        total + water != 0,
        name="|signal| + |water_signal|",
        rule="other than 0",
        hint="there is no light to tell apart; leave it out",
    )
    ratio: NDArray[np.float64] = (total - water) / (total + water)
    return ratio


def total_amplitude_and_phase(
    target_amplitude: ArrayLike,
    *,
    target_phase: ArrayLike,
    water_amplitude: ArrayLike,
    water_phase: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return amplitude and phase of the sum of target and water signal.

    Parameters
    ----------
    target_amplitude : array_like
        Amplitude of the target alone, not negative, any unit.
    target_phase : array_like
        Phase delay of the target alone [rad].
    water_amplitude : array_like
        Amplitude of the water alone, not negative, same unit.
    water_phase : array_like
        Phase delay of the water alone [rad].

    Returns
    -------
    amplitude : ndarray
        Amplitude of the sum, of the broadcast shape, same unit.
    phase : ndarray
        Phase delay of the sum, within pi of `target_phase`, not wrapped [rad].

    Raises
    ------
    ValueError
        If an amplitude is negative.

    Notes
    -----
    Eq. (51) of Ricci et al. 2010, as rederived, with :math:`\xi = A_w / A_t` and
    :math:`\psi = \varphi_t - \varphi_w`:

    .. math::

       A &= A_t \sqrt{1 + \xi^2 + 2 \xi \cos\psi}, \\
       \varphi &= \varphi_t
           - \operatorname{atan2}(\xi \sin\psi, 1 + \xi \cos\psi).

    Its limits are eq. (52), :math:`A_t, \varphi_t` for :math:`\xi \ll 1`, and eq. (53),
    :math:`A_w, \varphi_w` for :math:`\xi \gg 1`. Computed with :math:`A_t` multiplied
    through, so :math:`A_t = 0` is allowed.

    Examples
    --------
    >>> amplitude, phase = total_amplitude_and_phase(
    ...     1.0, target_phase=2.0, water_amplitude=0.5, water_phase=2.0 - np.pi / 2
    ... )
    >>> print(f"{amplitude:.4f}, {phase:.4f} rad")
    1.1180, 1.5364 rad
    """
    target = _amplitude(target_amplitude, name="target_amplitude")
    water = _amplitude(water_amplitude, name="water_amplitude")
    phase = np.asarray(target_phase, dtype=np.float64)
    behind = np.asarray(water_phase, dtype=np.float64)
    broadcast(
        target_amplitude=target,
        target_phase=phase,
        water_amplitude=water,
        water_phase=behind,
    )
    psi = phase - behind
    across = water * np.sin(psi)
    along = target + water * np.cos(psi)
    return np.hypot(along, across), phase - np.arctan2(across, along)


def target_amplitude_and_phase(
    amplitude: ArrayLike,
    *,
    phase: ArrayLike,
    water_amplitude: ArrayLike,
    water_phase: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return amplitude and phase of a signal after subtraction of the water signal.

    Parameters
    ----------
    amplitude : array_like
        Amplitude of target and water together, not negative, any unit.
    phase : array_like
        Phase delay of target and water together [rad].
    water_amplitude : array_like
        Amplitude of the water alone, not negative, same unit.
    water_phase : array_like
        Phase delay of the water alone [rad].

    Returns
    -------
    target_amplitude : ndarray
        Amplitude of the target alone, of the broadcast shape, same unit.
    target_phase : ndarray
        Phase delay of the target alone, within pi of `phase`, not wrapped [rad].

    Raises
    ------
    ValueError
        If an amplitude is negative.

    Notes
    -----
    Eqs. (55)-(57) of Ricci et al. 2010, as rederived, with
    :math:`\xi' = A_w / A` and :math:`\psi' = \varphi - \varphi_w`:

    .. math::

       A_t &= A \sqrt{1 + \xi'^2 - 2 \xi' \cos\psi'}, \\
       \varphi_t &= \varphi
           + \operatorname{atan2}(\xi' \sin\psi', 1 - \xi' \cos\psi').

    The four-quadrant arctangent matters: :math:`1 - \xi' \cos\psi'` is negative
    whenever the water is stronger than the sum and nearly in phase with it.

    Examples
    --------
    >>> amplitude, phase = target_amplitude_and_phase(
    ...     1.0, phase=0.5, water_amplitude=3.0, water_phase=0.5
    ... )
    >>> print(f"{amplitude:.1f}, {phase - 0.5:.4f} rad")
    2.0, 3.1416 rad
    """
    total = _amplitude(amplitude, name="amplitude")
    water = _amplitude(water_amplitude, name="water_amplitude")
    delay = np.asarray(phase, dtype=np.float64)
    behind = np.asarray(water_phase, dtype=np.float64)
    broadcast(amplitude=total, phase=delay, water_amplitude=water, water_phase=behind)
    psi = delay - behind
    across = water * np.sin(psi)
    along = total - water * np.cos(psi)
    return np.hypot(along, across), delay + np.arctan2(across, along)


def _amplitude(value: ArrayLike, *, name: str) -> NDArray[np.float64]:
    """Return an amplitude as an array; ValueError if negative."""
    return measured(value, name=name, hint="add pi to the phase instead")


def _moduli(
    signal: ArrayLike, water_signal: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the moduli of a signal and of the water signal."""
    total = np.abs(np.asarray(signal, dtype=np.complex128))
    water = np.abs(np.asarray(water_signal, dtype=np.complex128))
    broadcast(signal=total, water_signal=water)
    return total, water
