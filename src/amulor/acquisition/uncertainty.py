"""Uncertainty of a sample from shot noise, output filter and averaging."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import detection
from amulor.survey import Survey
from amulor.survey.counting import counting_variance


def reading_variance(
    survey: Survey, *, rate: ArrayLike, time_constant: float
) -> NDArray[np.float64]:
    """Return the shot-noise variance per quadrature [V^2] of one settled reading."""
    time = detection.effective_integration_time(0.0, time_constant=time_constant)
    return counting_variance(survey, rate=rate, integration_time=float(time))


def variance_ratio(readings: ArrayLike, *, spacing: ArrayLike) -> NDArray[np.float64]:
    r"""Return the variance ratio of a mean of readings to a single reading [1].

    Notes
    -----
    White noise behind a one-pole filter has the correlation :math:`r = e^{-s}` between
    successive readings. The mean of n readings therefore has the variance ratio

    .. math:: \frac{1}{n} \left[ 1 + 2 \sum_{k=1}^{n-1} (1 - k / n) r^k \right]
        = \frac{1}{n} \left[ \frac{1 + r}{1 - r}
          - \frac{2 r (1 - r^n)}{n (1 - r)^2} \right].

    Examples
    --------
    >>> print(f"{variance_ratio(8, spacing=1.0):.4f}")
    0.2417
    """
    number = np.asarray(readings, dtype=float)
    if np.any(number < 1):
        raise ValueError(f"readings must be at least 1, got {np.min(number):g}")
    length = np.asarray(spacing, dtype=float)
    if not np.all(length > 0):
        raise ValueError(
            f"spacing must be above 0 time constants, got {np.min(length):g}"
        )
    decay = np.exp(-length)
    gain = -np.expm1(-length)
    slow = (1 + decay) / gain
    ends = 2 * decay * (1 - decay**number) / (number * gain**2)
    fraction: NDArray[np.float64] = np.asarray((slow - ends) / number)
    return fraction


def intervals_of(survey: Survey) -> int:
    """Return the number of intervals of a dwell, each at most a time constant."""
    parts = survey.scan.dwell / survey.instrument.lock_in.time_constant
    return max(1, int(np.ceil(parts - 1e-9)))


def filtered_input(
    outputs: ArrayLike, times: ArrayLike, *, time_constant: float
) -> complex:
    r"""Return the mean input of a one-pole filter, computed from its outputs.

    Notes
    -----
    A constant input u moves the output from :math:`y_{k-1}` to
    :math:`u + (y_{k-1} - u) r` with :math:`r = e^{-\Delta t / T}`, so that

    .. math:: u_k = \frac{y_k - r_k y_{k-1}}{1 - r_k}.

    White noise gives independent errors of the :math:`u_k`.

    Examples
    --------
    A filter that decays from 5 V to an input of 1 V:

    >>> import numpy as np
    >>> t = np.array([0.0, 0.4, 1.0])
    >>> u = filtered_input(1 + 4 * np.exp(-t), t, time_constant=1.0)
    >>> print(f"{u.real:.6f} V")
    1.000000 V
    """
    output = np.asarray(outputs, dtype=complex)
    passed = np.diff(np.asarray(times, dtype=float))
    if output.size < 2 or passed.size != output.size - 1 or not np.all(passed > 0):
        raise ValueError(
            f"needed are outputs at two rising moments at least, got {output.size} "
            f"outputs and steps of {passed.tolist()} s"
        )
    decay = np.exp(-passed / time_constant)
    return complex(np.mean((output[1:] - decay * output[:-1]) / (1 - decay)))


def edge_error(outputs: ArrayLike, times: ArrayLike, *, time_constant: float) -> float:
    r"""Return the error of `filtered_input` due to input steps between readings.

    Notes
    -----
    A filter weights late input in an interval :math:`\Delta t` more than early input.
    An input that steps by :math:`\delta` after a part x of it comes out
    wrong by :math:`\delta \, x (1 - x) \, \Delta t / 2 T` of that interval; over all
    x, :math:`x (1 - x)` is :math:`1 / \sqrt{30}`. The step of an interval is taken from
    the inputs of the one before and the one after it. Good for
    :math:`\Delta t \le T / 2`.

    Examples
    --------
    A filter of 1 s, read every 0.1 s, with an input of 2 V from 0.3 s on:

    >>> import numpy as np
    >>> t = np.linspace(0, 1, 11)
    >>> y = np.where(t < 0.3, 0.0, 2 * (1 - np.exp(-(t - 0.3))))
    >>> print(f"{1e3 * edge_error(y, t, time_constant=1.0):.2f} mV")
    2.58 mV
    """
    output = np.asarray(outputs, dtype=complex)
    moments = np.asarray(times, dtype=float)
    if output.size < 4:
        return 0.0
    spacing = float(moments[-1] - moments[0]) / (moments.size - 1)
    decay = np.exp(-spacing / time_constant)
    entered = (output[1:] - decay * output[:-1]) / (1 - decay)
    change = np.abs(entered[2:] - entered[:-2])
    weight = spacing / (2 * time_constant) / np.sqrt(30) / entered.size
    return float(weight * np.sqrt(np.sum(change**2)))


def input_variance_ratio(
    intervals: ArrayLike, *, spacing: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the variance ratio of `filtered_input` to a settled output [1].

    Notes
    -----
    A settled output integrates the input over two time constants. The inputs of n
    intervals integrate over :math:`2 n T \tanh(s / 2)`, which for intervals of one time
    constant is 0.92 of their duration.

    Examples
    --------
    >>> print(f"{2 / input_variance_ratio(1, spacing=1.0):.3f}")
    0.924
    """
    number = np.asarray(intervals, dtype=float)
    length = np.asarray(spacing, dtype=float)
    if np.any(number < 1) or not np.all(length > 0):
        raise ValueError(
            f"intervals must be at least 1 and spacing above 0, got {np.min(number):g} "
            f"and {np.min(length):g}"
        )
    return np.asarray(1 / (number * np.tanh(length / 2)))


def readings_of(survey: Survey, *, settling: float) -> int:
    """Return the number of settled readings per dwell, a time constant apart."""
    constant = survey.instrument.lock_in.time_constant
    # A dwell of exactly so many time constants must not lose one to rounding.
    remaining = survey.scan.dwell / constant - settling
    return max(1, 1 + int(np.floor(remaining + 1e-9)))
