"""Polarization-channel pairs, and separation of target and water by channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance

#: Channels in which backscatter of spheres is dark. A mirror-like return preserves V
#: and H, but swaps +45 with -45 degrees and right with left, in its own axes.
CROSS_POLARIZED = ("VH", "HV", "PP", "MM", "RR", "LL")
#: Channels in which it is bright.
CO_POLARIZED = ("VV", "HH", "PM", "MP", "RL", "LR")
PARTNERS = dict(zip(CO_POLARIZED, CROSS_POLARIZED, strict=True))


def pair_of(cube: xr.Dataset) -> tuple[str, str]:
    """Return the names of a co-polarized channel and its cross-polarized partner."""
    present = cube.amulor.polarizations
    for co, cross in PARTNERS.items():
        if co in present and cross in present:
            return co, cross
    listed = ", ".join("+".join(pair) for pair in PARTNERS.items())
    raise CubeError(
        f"the cube has the channels {', '.join(present)}, but unmixing needs one of "
        f"the pairs {listed}; record both analyser positions"
    )


Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Samples of one channel that are solved for at once; this bounds the memory.
_AT_ONCE = 65_536


@dataclass(frozen=True)
class Unmixed:
    """Target signal estimated from several channels, with covariance and gain."""

    target: Complex
    """Target signal, shape (...) [V]."""
    independent: Covariance
    """Covariance of the target signal due to independent channel errors [V^2]."""
    gain: Floats
    """Jacobian of the target's outputs (in phase, quadrature) by channel outputs,
    shape (2, channels, 2, ...) [1]."""

    def error_of(self, channels: list[Covariance]) -> Covariance:
        """Return the target-signal covariance due to errors of each channel."""
        parts = [
            _propagated(self.gain[:, c], errors) for c, errors in enumerate(channels)
        ]
        total = parts[0]
        for part in parts[1:]:
            total = total + part
        return total

    def error_of_water(
        self, weights: list[Floats | float], errors: Covariance
    ) -> Covariance:
        """Return the target-signal covariance due to a shared water-signal error."""
        gain = sum(self.gain[:, c] * weight for c, weight in enumerate(weights))
        return _propagated(np.asarray(gain), errors)

    def shift_by(self, channels: list[Complex]) -> Complex:
        """Return the change of the target signal for given changes of the channels."""
        moved = np.zeros((2, *self.target.shape))
        for c, change in enumerate(channels):
            moved += self.gain[:, c, 0] * change.real + self.gain[:, c, 1] * change.imag
        return np.asarray(moved[0] + 1j * moved[1])


def unmix(
    signals: list[Complex],
    errors: list[Covariance],
    *,
    target_weights: list[Floats | float],
    water_weights: list[Floats | float],
    water_prior: Covariance | None,
) -> Unmixed:
    r"""Return the best linear unbiased estimate of the target signal.

    Generalised least squares of :math:`y_c = t_c T + w_c W` on the in-phase and
    quadrature outputs of all channels. Water with a prior of the covariance P adds
    :math:`w_c w_{c'} P` to the covariance of the channels, so that weights run from
    the inverse variances (P = 0, water already taken out) to those of unmixing.
    """
    shape = signals[0].shape
    count = signals[0].size
    flat = np.stack([signal.ravel() for signal in signals], axis=1)
    covariance = [
        Covariance(*(np.broadcast_to(part, shape).ravel() for part in _parts(error)))
        for error in errors
    ]
    prior = (
        None
        if water_prior is None
        else Covariance(
            *(np.broadcast_to(part, shape).ravel() for part in _parts(water_prior))
        )
    )
    weights = [
        np.stack([np.broadcast_to(w, shape).ravel() for w in side], axis=1)
        for side in (target_weights, water_weights)
    ]
    target = np.empty(count, dtype=complex)
    covariances = np.empty((count, 3))
    gain = np.empty((count, 2, len(signals), 2))
    for first in range(0, count, _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        target[part], covariances[part], gain[part] = _solve(
            flat[part],
            [error.part(part) for error in covariance],
            weights[0][part],
            weights[1][part],
            None if prior is None else prior.part(part),
        )
    return Unmixed(
        target.reshape(shape),
        Covariance(*(column.reshape(shape) for column in covariances.T)),
        np.moveaxis(gain, 0, -1).reshape(2, len(signals), 2, *shape),
    )


def _solve(
    signal: Complex,
    errors: list[Covariance],
    target_weight: Floats,
    water_weight: Floats,
    prior: Covariance | None,
) -> tuple[Complex, Floats, Floats]:
    """Return target signals, covariances as three columns, and channel gains."""
    count, channels = signal.shape
    blocks = np.zeros((count, channels, 2, channels, 2))
    for c, error in enumerate(errors):
        blocks[:, c, :, c, :] = _square(error)
    columns = [target_weight]
    if prior is None:
        columns.append(water_weight)
    else:
        outer = water_weight[:, :, None] * water_weight[:, None, :]
        blocks += np.einsum("ncd,nij->ncidj", outer, _square(prior))
    matrix = blocks.reshape(count, 2 * channels, 2 * channels)
    finite = np.isfinite(matrix).all(axis=(1, 2))
    good = np.asarray(finite & np.isfinite(signal).all(axis=1))
    # Errors of zero would make the matrix singular: far below any other they do not.
    scale = np.einsum("nii->n", matrix)
    floor = np.where(good & (scale > 0), _TINY * np.nan_to_num(scale), 1.0)
    matrix[~good] = np.eye(2 * channels)
    matrix += floor[:, None, None] * np.eye(2 * channels)
    # Unknowns: (in phase, quadrature) of the target, then of the water.
    design = np.concatenate(
        [np.einsum("nc,ij->ncij", w, np.eye(2)) for w in columns], axis=3
    ).reshape(count, 2 * channels, 2 * len(columns))
    weighted = np.linalg.solve(matrix, design).transpose(0, 2, 1)
    inverse = np.linalg.inv(weighted @ design)
    gain = (inverse @ weighted)[:, :2]
    outputs = np.stack([signal.real, signal.imag], axis=2).reshape(count, -1)
    outputs = np.where(good[:, None], outputs, 0.0)
    value = np.einsum("nij,nj->ni", gain, outputs)
    target = np.where(good, value[:, 0] + 1j * value[:, 1], np.nan + 0j)
    covariance = np.stack(
        [inverse[:, 0, 0], inverse[:, 1, 1], inverse[:, 0, 1]], axis=1
    )
    covariance[~good] = np.nan
    return target, covariance, gain.reshape(count, 2, channels, 2)


#: Smallest variance relative to the sum of all in a pixel [1].
_TINY = 1e-14


def _parts(covariance: Covariance) -> tuple[Floats, Floats, Floats]:
    return covariance.in_phase, covariance.quadrature, covariance.cross


def _square(covariance: Covariance) -> Floats:
    """Return the covariances as matrices, shape (n, 2, 2)."""
    a, b, c = _parts(covariance)
    return np.stack([np.stack([a, c], axis=-1), np.stack([c, b], axis=-1)], axis=-1)


def _propagated(gain: Floats, errors: Covariance) -> Covariance:
    """Return the covariance of errors after multiplication by a (2, 2, ...) matrix."""
    a, b, c = _parts(errors)
    (p, q), (r, s) = gain
    return Covariance(
        p**2 * a + q**2 * b + 2 * p * q * c,
        r**2 * a + s**2 * b + 2 * r * s * c,
        p * r * a + q * s * b + (p * s + q * r) * c,
    )
