"""Flags that tell which pixels of a target signal can be trusted."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import QualityFlag
from amulor.optics import detection
from amulor.rejection.reference import Covariance

#: A target is seen when its signal stands this many standard errors off zero.
DETECTION_THRESHOLD = 5.0
#: And when its phase is known to this; beyond, a first-order error means nothing [rad].
LARGEST_PHASE_ERROR = 0.3


def flags(
    samples: xr.Dataset,
    target_signal: NDArray[np.complex128],
    uncertainty: Covariance,
    *,
    residual: NDArray[np.complex128] | None = None,
    water_is_in: bool = False,
) -> NDArray[np.int16]:
    """Return the quality flag of every sample.

    Parameters
    ----------
    samples : xarray.Dataset
        What was measured; missing samples are not numbers.
    target_signal : ndarray of complex
        What is left for the target [V].
    uncertainty : Covariance
        Its errors.
    residual : ndarray of complex, optional
        Water signal that is estimated to be left in [V]; where it is not a number,
        it is not known, and flagged as if it were large.
    water_is_in : bool
        True if no water signal was taken out at all.

    Returns
    -------
    ndarray of int16
        Sums of `QualityFlag`, of the shape of the target signal.
    """
    flag = np.zeros(target_signal.shape, dtype=np.int16)
    missing = ~np.isfinite(target_signal)
    if "saturated" in samples:
        flag[samples["saturated"].values != 0] |= QualityFlag.SATURATED
    # Water that is left in must not pass for a target: it counts as an error too.
    known = np.zeros_like(target_signal) if residual is None else residual
    left = np.nan_to_num(np.abs(known) ** 2)
    blurred = Covariance(
        uncertainty.in_phase + left, uncertainty.quadrature + left, uncertainty.cross
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        far = blurred.mahalanobis(target_signal) >= DETECTION_THRESHOLD**2
    seen = far & ~missing
    phase = _phase_error(target_signal, blurred, seen)
    # An error that lies along one direction can leave the strength sure and the phase
    # open.
    seen &= phase < LARGEST_PHASE_ERROR
    flag[~seen & ~missing] |= QualityFlag.NO_TARGET
    if water_is_in:
        flag |= QualityFlag.NO_OPEN_WATER
    if residual is not None:
        own = _phase_error(target_signal, uncertainty, seen)
        with np.errstate(invalid="ignore", divide="ignore"):
            shift = np.abs(np.angle(target_signal / (target_signal - residual)))
        flag[seen & ~(shift <= own)] |= QualityFlag.WATER_RESIDUAL
    flag[missing] = QualityFlag.MISSING
    return flag


def _phase_error(
    signal: NDArray[np.complex128], uncertainty: Covariance, seen: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the phase error where a signal is seen; elsewhere it means nothing."""
    return detection.phase_uncertainty(
        np.where(seen, signal, 1.0),
        in_phase_variance=np.where(seen, uncertainty.in_phase, 1.0),
        quadrature_variance=np.where(seen, uncertainty.quadrature, 1.0),
        covariance=np.where(seen, uncertainty.cross, 0.0),
    )
