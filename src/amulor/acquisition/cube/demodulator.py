"""Calibration of the demodulator: offset, gain and angle of its two outputs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.acquisition.cube.calibrate import (
    mean_output,
    measured_on,
    refuse_open_shutter,
)
from amulor.acquisition.cube.calibration import Calibration, DemodulatorOutputs
from amulor.errors import CubeError

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Signals of different phases that determine amplitude, gain and angle with a test.
_FEWEST_SIGNALS = 5
#: Largest gap between neighboring phases, so that they cover a whole turn [rad].
_LARGEST_GAP = math.radians(120)
#: Largest output with a terminated input, relative to that of the signals [1].
_SILENT = 0.1


def from_terminated(
    terminated: xr.Dataset, signals: Sequence[xr.Dataset] = ()
) -> Calibration:
    r"""Calibrate offset, gain and angle of the demodulator outputs.

    Parameters
    ----------
    terminated : xarray.Dataset
        Cube of level `samples`, recorded with 50 ohm at the input of the demodulator.
    signals : sequence of xarray.Dataset
        Cubes of a signal of constant amplitude at the modulation frequency, at five or
        more phases over a whole turn. The phases need not be known.

    Returns
    -------
    Calibration
        Offset of each frequency, and with signals also the gain and the angle of the
        quadrature output.

    Raises
    ------
    CubeError
        If a cube was recorded with an open shutter or another calibration, the
        terminated input shows a signal, or the signals are too few or too similar.

    Notes
    -----
    The outputs of a signal of constant amplitude A are on an ellipse,
    :math:`x^2 + ((y - x \sin e) / \cos e)^2 = A^2`. Here x is the in-phase output and
    y the quadrature output divided by 1 + g, both without offset. Least squares
    determine A, g and e. If the outputs scatter about the ellipse by more than their
    errors, the uncertainties grow.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import acquisition, samples
    >>> cube = samples.cube("ladder").assign_attrs(shutter="closed")
    >>> def outputs(signal):
    ...     return cube.assign(
    ...         in_phase=0 * cube["in_phase"] + signal.real,
    ...         quadrature=0 * cube["quadrature"] + 1.02 * signal.imag,
    ...     )
    >>> turns = [outputs(np.exp(2j * np.pi * k / 8)) for k in range(8)]
    >>> calibration = acquisition.from_terminated(outputs(0j * 1), turns)
    >>> print(f"{calibration.demodulator[0].quadrature_gain:.3f}")
    0.020
    """
    silent, silent_error = _outputs(terminated, terminated)
    parts = [_outputs(cube, terminated) for cube in signals]
    frequencies = terminated["modulation_frequency"].values
    entries = []
    for number, frequency in enumerate(frequencies):
        offset, error = silent[number], silent_error[number]
        entry = DemodulatorOutputs(
            modulation_frequency=float(frequency),
            offset=(float(offset.real), float(offset.imag)),
            offset_uncertainty=float(error),
        )
        if parts:
            at = np.array([part[0][number] for part in parts])
            sigma = np.hypot([part[1][number] for part in parts], error)
            entry = entry.model_copy(
                update=_ellipse(at - offset, sigma, silent=abs(offset))
            )
        entries.append(entry)
    return Calibration(date=measured_on(terminated), demodulator=tuple(entries))


def _outputs(cube: xr.Dataset, first: xr.Dataset) -> tuple[Complex, Floats]:
    """Return the mean output over all channels with its standard error, by frequency.

    The dark output was subtracted from the samples. It contains the offset, too.
    """
    refuse_open_shutter(cube, first)
    mean, error = mean_output(cube)
    in_phase, quadrature, of_dark = (
        np.broadcast_to(cube.attrs.get(name, 0.0), mean.size).reshape(mean.shape)
        for name in ("dark_in_phase", "dark_quadrature", "dark_uncertainty")
    )
    total = mean + in_phase + 1j * quadrature
    square = error**2 + of_dark**2
    return total.mean(axis=1), np.sqrt(square.sum(axis=1)) / square.shape[1]


def _ellipse(signal: Complex, sigma: Floats, *, silent: float) -> dict[str, object]:
    """Fit gain and angle of the quadrature output to signals of one amplitude."""
    from scipy.optimize import least_squares

    phases = np.sort(np.angle(signal))
    gaps = np.diff(np.append(phases, phases[0] + 2 * np.pi))
    size = float(np.median(np.abs(signal)))
    if silent > _SILENT * size:
        raise CubeError(
            f"the terminated input shows {silent:.3g} V, and the signals "
            f"{size:.3g} V; put the cube with 50 ohm at the input first"
        )
    if signal.size < _FEWEST_SIGNALS or gaps.max() > _LARGEST_GAP:
        raise CubeError(
            f"{signal.size} signals with gaps of up to {np.degrees(gaps.max()):.0f} "
            f"degrees; needed are {_FEWEST_SIGNALS} or more over a whole turn, such as "
            "every 45 degrees"
        )

    def rest(values: Floats) -> Floats:
        amplitude, gain, angle = size * values[0], 1 + values[1], values[2]
        x = signal.real
        y = (signal.imag / gain - x * np.sin(angle)) / np.cos(angle)
        return np.asarray((np.hypot(x, y) - amplitude) / sigma)

    fit = least_squares(rest, [1.0, 0.0, 0.0], x_scale="jac")
    excess = max(2 * float(fit.cost) / (signal.size - 3), 1.0)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * excess
    return {
        "quadrature_gain": float(fit.x[1]),
        "quadrature_gain_uncertainty": math.sqrt(covariance[1, 1]),
        "quadrature_phase": float(fit.x[2]),
        "quadrature_phase_uncertainty": math.sqrt(covariance[2, 2]),
        "outputs": tuple((float(v.real), float(v.imag)) for v in signal),
    }
