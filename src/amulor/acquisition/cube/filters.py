"""Transmissions of neutral filters and gain of the receiver, by signals of a plate."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition.cube.calibration import NeutralFilter

Floats = NDArray[np.float64]


def measured_filters(
    density: Floats, amplitude: Floats, error: Floats, *, leakage: float = 0.0
) -> tuple[tuple[NeutralFilter, ...], tuple[float, float] | None]:
    r"""Return the transmission of each filter, and the change of the gain with error.

    Amplitudes are those of the echo, without leakage, and their errors, shape (filter,
    signal) [V]. All signals (frequencies and channels) pass the same filters. The
    logarithm of an amplitude over that of the first filter is that of the transmission,
    plus k times the difference of the amplitudes. Signals of different strength
    determine k, and thus the change at the largest amplitude; None if they are equal.
    `leakage` is the error of the subtracted leakage relative to the brightest signal,
    which changes all transmissions by equal amounts.
    """
    usable = np.isfinite(amplitude).all(axis=0) & (amplitude > 0).all(axis=0)
    amplitude, error = amplitude[:, usable], error[:, usable]
    filters, signals = len(density) - 1, amplitude.shape[1]
    ratio = np.log(amplitude[1:] / amplitude[0])
    relative = error / amplitude
    sigma = np.hypot(relative[1:], relative[0]).ravel()
    largest = amplitude.max()
    design = np.zeros((filters * signals, filters + 1))
    design[np.arange(filters * signals), np.repeat(np.arange(filters), signals)] = 1.0
    design[:, -1] = ((amplitude[1:] - amplitude[0]) / largest).ravel()
    bent = signals > 1 and float(np.ptp(amplitude[0])) > _LEAST_SPREAD * largest
    if not bent:
        design = design[:, :-1]
    weighted = design / sigma[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    values = covariance @ weighted.T @ (ratio.ravel() / sigma)
    rest = ratio.ravel() / sigma - weighted @ values
    freedom = ratio.size - values.size
    excess = max(float(rest @ rest) / freedom, 1.0) if freedom else 1.0
    uncertainty = np.sqrt(np.diag(covariance) * excess)
    first = 10.0 ** -float(density[0])
    table = [NeutralFilter(density=float(density[0]), transmission=first)]
    for number in range(filters):
        transmission = first * math.exp(values[number])
        table.append(
            NeutralFilter(
                density=float(density[number + 1]),
                transmission=transmission,
                uncertainty=math.hypot(
                    transmission * float(uncertainty[number]), leakage * first
                ),
            )
        )
    gain = (math.expm1(values[-1]), float(uncertainty[-1])) if bent else None
    return tuple(table), gain


#: Least difference of the amplitudes, relative to the largest, that shows the gain [1].
_LEAST_SPREAD = 0.1
