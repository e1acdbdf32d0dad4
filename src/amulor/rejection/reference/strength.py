"""How much stronger the water is than its reference, told by phases that disagree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics import detection
from amulor.rejection.covariance import Covariance

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative standard deviation by which water departs from its reference unseen [1].
DEPARTURE = 0.02
#: A phase this uncertain tells nothing [rad].
_BLURRED = 0.2
#: Phases farther off than this many standard errors are spikes [1].
_SPIKE = 5.0
#: Pixels that are enough, however large the scan.
_ENOUGH = 20_000
#: An estimate this many times its expected size widens what is expected [1].
_SURPRISE = 3.0


@dataclass(frozen=True, kw_only=True)
class Strength:
    """Relative change of the water in front of the target against its reference."""

    change: float
    """Estimate: the water is 1 + change times what the reference says [1]."""
    uncertainty: float
    """Standard uncertainty of the estimate [1]."""


def strength_of(
    target: Complex,
    water_signal: Complex,
    own: Covariance,
    common: Covariance,
    *,
    modulation_frequency: Floats,
    path: Floats,
) -> Strength:
    r"""Return by how much the water of a scan is stronger than its reference.

    Parameters
    ----------
    target : ndarray, shape (modulation_frequency, polarization, row, column)
        What subtraction left [V].
    water_signal : ndarray of the same shape
        The water in front of the target that was subtracted [V].
    own, common : Covariance
        Errors of the difference that are of each sample alone, and that the pixels
        share [V^2].
    modulation_frequency : ndarray, shape (modulation_frequency,)
        Modulation frequencies [Hz].
    path : ndarray, shape (row, column)
        Optical path out and back, roughly; NaN where it is not known. One frequency
        needs none [m].

    Returns
    -------
    Strength
        Zero, uncertain by `DEPARTURE`, where nothing can tell.

    Notes
    -----
    All channels and frequencies of a pixel see one path L. Water stronger by c turns
    their phases by :math:`c\, \mathrm{Im}(W / T)`, each by another angle, so that

    .. math:: \varphi = 2 \pi f L / c_0 + c\, \mathrm{Im}(W / T) .

    Least squares over all samples, the path of each pixel free and c one number for the
    scan. One frequency in one channel tells nothing. Errors that the pixels share do
    not average out. The result is weighed against what is expected beforehand,
    :math:`0 \pm 2 \%`, unless it is clearly larger. Of a large scan 20,000 pixels
    spread over it count.
    """
    frequency = modulation_frequency.reshape(-1, 1, 1)
    if len(frequency) == 1:
        # Any path will do that has the phase of all channels together.
        phase = np.angle(np.nansum(target[0], axis=0))
        path = phase * speed_of_light / (2 * np.pi * modulation_frequency[0])
    pixels = np.flatnonzero(np.isfinite(path))
    if pixels.size > _ENOUGH:
        pixels = pixels[np.linspace(0, pixels.size - 1, _ENOUGH).astype(np.intp)]
    target, water_signal = (_at(values, pixels) for values in (target, water_signal))
    own, common = (
        Covariance(*(_at(values, pixels) for values in vars(errors).values()))
        for errors in (own, common)
    )
    path = path.ravel()[pixels]
    wavenumber = 2 * np.pi * frequency / speed_of_light
    seen = np.isfinite(target) & np.isfinite(water_signal) & (target != 0)
    safe = np.where(seen, target, 1.0)
    sigma, shared = (
        detection.phase_uncertainty(
            safe,
            in_phase_variance=np.where(seen, errors.in_phase, 1.0),
            quadrature_variance=np.where(seen, errors.quadrature, 1.0),
            covariance=np.where(seen, errors.cross, 0.0),
        )
        for errors in (own, common)
    )
    total = np.hypot(sigma, shared)
    seen &= (total < _BLURRED) & (sigma > 0)
    phase = np.angle(safe * np.exp(-1j * wavenumber * path))
    turn = np.where(seen, (water_signal / safe).imag, 0.0)
    weight = np.divide(1.0, total**2, out=np.zeros(total.shape), where=seen)
    fit = _fit(phase, turn, wavenumber, weight)
    if fit is not None:
        off = phase - wavenumber * fit.path - fit.change * turn
        weight = np.where(np.abs(off) < _SPIKE * total, weight, 0.0)
        fit = _fit(phase, turn, wavenumber, weight)
    if fit is None:
        return Strength(change=0.0, uncertainty=DEPARTURE)
    # Own errors average out over the pixels, shared ones add up.
    by_own = np.sum((fit.gain * sigma) ** 2)
    by_shared = np.sum(np.sum(np.abs(fit.gain * shared), axis=2) ** 2)
    variance = float(by_own + by_shared)
    expected = DEPARTURE**2
    if fit.change**2 > _SURPRISE**2 * (expected + variance):
        expected = fit.change**2 - variance
    return Strength(
        change=fit.change * expected / (expected + variance),
        uncertainty=float(np.sqrt(expected * variance / (expected + variance))),
    )


def _at(values: NDArray[Any], pixels: NDArray[np.intp]) -> NDArray[Any]:
    """Return some pixels of samples, shape (frequency, channel, pixel)."""
    return values.reshape(*values.shape[:2], -1)[:, :, pixels]


@dataclass(frozen=True, kw_only=True)
class _Fit:
    change: float
    path: Floats
    """Correction of the path of each pixel [m]."""
    gain: Floats
    """Change of the estimate with each phase [1/rad]."""


def _fit(
    phase: Floats, turn: Floats, wavenumber: Floats, weight: Floats
) -> _Fit | None:
    """Return the least squares of one change and one path a pixel."""

    def summed(values: Floats) -> Floats:
        total: Floats = np.sum(weight * values, axis=(0, 1))
        return total

    square = summed(wavenumber**2 + 0 * turn)
    known = square > 0
    inverse = np.divide(1.0, square, out=np.zeros(square.shape), where=known)
    mean_turn = summed(wavenumber * turn) * inverse
    across = turn - wavenumber * mean_turn
    information = float(np.sum(weight * across * turn))
    if information <= 0 or not np.isfinite(information):
        return None
    gain = weight * across / information
    change = float(np.sum(gain * phase))
    path = (summed(wavenumber * phase) * inverse) - change * mean_turn
    return _Fit(change=change, path=path, gain=gain)
