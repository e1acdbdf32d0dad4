"""Range profile of a stepped-frequency measurement, and surfaces along a beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light
from scipy.special import ndtr

from amulor.optics._bounds import at_least, positive

__all__ = ["Surfaces", "range_profile", "resolution", "surfaces", "unambiguous_span"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Places of a search per resolution.
_OVERSAMPLING = 8
#: Least part of an echo that other surfaces do not explain, for a search [1].
_LEAST_PART = 0.02
#: Steps of the fit of surfaces, and of its step size.
_STEPS, _HALVINGS = 60, 12
#: Change of the ranges at which the fit ends, in parts of the resolution [1].
_SETTLED = 1e-7


def resolution(*, modulation_frequency: ArrayLike, group_index: float) -> float:
    r"""Return the range resolution of a set of modulation frequencies [m].

    Parameters
    ----------
    modulation_frequency : array_like, shape (n,)
        At least two frequencies [Hz].
    group_index : float
        Group index of the water [1].

    Returns
    -------
    float
        :math:`v / 2 B` with the group velocity v and the bandwidth B [m].

    Raises
    ------
    ValueError
        If there are fewer than two different frequencies.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics import range_profile
    >>> sweep = np.arange(100e6, 1e9 + 1, 10e6)
    >>> width = range_profile.resolution(modulation_frequency=sweep, group_index=1.38)
    >>> print(f"{100 * width:.0f} cm")
    12 cm
    """
    frequency, index = _checked(modulation_frequency, group_index)
    return float(speed_of_light / index / (2 * np.ptp(frequency)))


def unambiguous_span(*, modulation_frequency: ArrayLike, group_index: float) -> float:
    r"""Return the range after which the profile of a regular sweep repeats [m].

    Parameters
    ----------
    modulation_frequency : array_like, shape (n,)
        At least two frequencies [Hz].
    group_index : float
        Group index of the water [1].

    Returns
    -------
    float
        :math:`v / 2 \Delta f` with the smallest frequency difference [m]. An irregular
        set of frequencies repeats later or never.

    Raises
    ------
    ValueError
        If there are fewer than two different frequencies.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics import range_profile
    >>> sweep = np.arange(100e6, 1e9 + 1, 10e6)
    >>> span = range_profile.unambiguous_span(
    ...     modulation_frequency=sweep, group_index=1.38
    ... )
    >>> print(f"{span:.1f} m")
    10.9 m
    """
    frequency, index = _checked(modulation_frequency, group_index)
    difference = np.diff(np.unique(frequency)).min()
    return float(speed_of_light / index / (2 * difference))


def range_profile(
    signal: ArrayLike,
    *,
    standard_uncertainty: ArrayLike,
    modulation_frequency: ArrayLike,
    group_index: float,
    slant_range: ArrayLike,
    weight: ArrayLike | None = None,
) -> tuple[Complex, Floats]:
    r"""Return the range profile of stepped-frequency samples, and its uncertainty.

    Parameters
    ----------
    signal : array_like of complex, shape (n, ...)
        Samples at n frequencies [any unit].
    standard_uncertainty : array_like, shape (n, ...)
        Standard uncertainty of each output, in phase and quadrature [any unit].
    modulation_frequency : array_like, shape (n,)
        At least two frequencies, in any spacing [Hz].
    group_index : float
        Group index of the water [1].
    slant_range : array_like, shape (m,)
        Slant ranges of the profile [m].
    weight : array_like, shape (n,), optional
        Weights of the frequencies, such as ``numpy.hanning(n)`` against side lobes. By
        default all are 1 [1].

    Returns
    -------
    profile : ndarray of complex, shape (m, ...)
        Profile. A surface has its amplitude there, with phase zero [that unit].
    uncertainty : ndarray, shape (...)
        Standard uncertainty of real and imaginary part of the profile [that unit].

    Raises
    ------
    ValueError
        If shapes differ, there are fewer than two frequencies, or weights do not have a
        positive sum.

    Notes
    -----
    .. math:: h(z) = \sum_k w_k S(f_k) e^{-4 \pi i f_k z / v} \Big/ \sum_k w_k

    with the group velocity v. The product of matrices takes frequencies in any spacing.
    Frequency-domain reflectometry in water: [1]_.

    References
    ----------
    .. [1] D. W. Illig et al., "Statistical backscatter suppression technique for a
       wideband hybrid lidar-radar ranging system" (2014).

    Examples
    --------
    Two surfaces in a sweep from 100 MHz to 1 GHz:

    >>> import numpy as np
    >>> from amulor.optics import range_profile, ranging
    >>> sweep = np.arange(100e6, 1e9 + 1, 10e6)
    >>> phase = ranging.phase(
    ...     [[1.5], [2.0]], modulation_frequency=sweep, group_index=1.38
    ... )
    >>> signal = np.array([0.2, 1.0]) @ np.exp(1j * phase)
    >>> profile, error = range_profile.range_profile(
    ...     signal,
    ...     standard_uncertainty=np.full(sweep.size, 0.05),
    ...     modulation_frequency=sweep,
    ...     group_index=1.38,
    ...     slant_range=[1.5, 2.0],
    ...     weight=np.hanning(sweep.size),
    ... )
    >>> print(profile.real.round(2), f"+- {error:.4f}")
    [0.2 1. ] +- 0.0065
    """
    frequency, index = _checked(modulation_frequency, group_index)
    values, errors = _samples(signal, standard_uncertainty, frequency)
    weights = np.ones(frequency.size) if weight is None else np.asarray(weight, float)
    if weights.shape != frequency.shape or not weights.sum() > 0:
        raise ValueError(
            f"weight must have the shape {frequency.shape} and a positive sum, got "
            f"shape {weights.shape} and sum {weights.sum():g}"
        )
    weights = weights / weights.sum()
    wave = 4 * np.pi * frequency * index / speed_of_light
    place = np.atleast_1d(np.asarray(slant_range, float))
    turn = weights * np.exp(-1j * np.outer(place, wave))
    variance = np.tensordot(weights**2, errors**2, axes=1)
    return np.tensordot(turn, values, axes=1), np.sqrt(variance)


@dataclass(frozen=True, kw_only=True)
class Surfaces:
    """Surfaces along a beam, from the nearest to the farthest.

    Examples
    --------
    The distance between two surfaces, with the covariance of both:

    >>> import numpy as np
    >>> from amulor.optics.range_profile import Surfaces
    >>> pair = Surfaces(
    ...     slant_range=np.array([1.88, 2.0]),
    ...     amplitude=np.array([0.3, 1.0]),
    ...     covariance=np.diag([9e-8, 4e-8, 1e-4, 1e-4]),
    ...     misfit=90.0,
    ...     probability=np.array([0.0, 0.0, 0.4]),
    ... )
    >>> error = np.sqrt([1, -1] @ pair.covariance[:2, :2] @ [1, -1])
    >>> print(f"{1e3 * np.diff(pair.slant_range)[0]:.1f} +- {1e3 * error:.1f} mm")
    120.0 +- 0.4 mm
    """

    slant_range: Floats
    """Slant ranges, shape (k,) [m]."""
    amplitude: Floats
    """Amplitudes of the echoes, shape (k,) [V]."""
    covariance: Floats
    """Covariance of all slant ranges, then all amplitudes, shape (2 k, 2 k)."""
    misfit: float
    """Chi-square of the samples about the surfaces [1]."""
    probability: Floats
    """Probability of each accepted surface by noise alone, then of the rejected
    candidate that ended the search, in the order of the search [1]."""

    @property
    def uncertainty(self) -> Floats:
        """Standard uncertainties of the slant ranges, shape (k,) [m]."""
        count = self.slant_range.size
        return np.sqrt(np.diag(self.covariance)[:count])


def surfaces(
    signal: ArrayLike,
    *,
    standard_uncertainty: ArrayLike,
    modulation_frequency: ArrayLike,
    group_index: float,
    interval: tuple[float, float],
    water_signal: ArrayLike | None = None,
    most: int = 4,
    error_rate: float = 0.01,
) -> Surfaces:
    r"""Estimate number, ranges and amplitudes of the surfaces along a beam.

    Parameters
    ----------
    signal : array_like of complex, shape (n,)
        Samples at n frequencies [any unit].
    standard_uncertainty : array_like, shape (n,)
        Standard uncertainty of each output, in phase and quadrature [any unit].
    modulation_frequency : array_like, shape (n,)
        At least two frequencies, in any spacing [Hz].
    group_index : float
        Group index of the water [1].
    interval : tuple of float
        Nearest and farthest slant range that are possible [m].
    water_signal : array_like of complex, shape (n,), optional
        Water signal up to a factor, which is estimated [any unit].
    most : int
        Largest number of surfaces.
    error_rate : float
        Probability of one surface too many due to noise [1].

    Returns
    -------
    Surfaces
        Surfaces with the covariance of their estimates.

    Raises
    ------
    ValueError
        If shapes differ or an argument is out of range.

    Notes
    -----
    Model :math:`S(f_k) = \sum_j a_j e^{4 \pi i f_k z_j / v} + c W(f_k)` with
    :math:`a_j > 0`, fitted by maximum likelihood. The covariance is the Cramér-Rao
    bound at the estimate. Surfaces are added one at a time. The candidate has the
    largest normalized correlation u with the residual. The accepted surfaces, their
    shifts and the water signal are projected out of both. Noise alone exceeds u in the
    interval with a probability of at most

    .. math:: \Phi(-u) + \frac{\kappa}{2 \pi} e^{-u^2 / 2}

    where :math:`\kappa` is the length of the curve of normalized echoes [1]_ [2]_. The
    search ends at the first candidate whose probability exceeds `error_rate`. Sparse
    reflections as a model of several returns: [3]_.

    References
    ----------
    .. [1] H. Hotelling, Am. J. Math. 61, 440 (1939), :doi:`10.2307/2371512`.
    .. [2] R. B. Davies, Biometrika 64, 247 (1977), :doi:`10.1093/biomet/64.2.247`.
    .. [3] D. Freedman et al., "SRA: Fast Removal of General Multipath for ToF Sensors",
       arXiv:1403.5919 (2014).

    Examples
    --------
    A net 12 cm in front of a wall, from 100 MHz to 1 GHz:

    >>> import numpy as np
    >>> from amulor.optics import range_profile, ranging
    >>> sweep = np.arange(100e6, 1e9 + 1, 20e6)
    >>> phase = ranging.phase(
    ...     [[1.88], [2.0]], modulation_frequency=sweep, group_index=1.38
    ... )
    >>> noise = np.random.default_rng(1).normal(0, 0.05, (2, sweep.size))
    >>> estimate = range_profile.surfaces(
    ...     np.array([0.3, 1.0]) @ np.exp(1j * phase) + noise[0] + 1j * noise[1],
    ...     standard_uncertainty=np.full(sweep.size, 0.05),
    ...     modulation_frequency=sweep,
    ...     group_index=1.38,
    ...     interval=(0.5, 4.0),
    ... )
    >>> for distance, error in zip(estimate.slant_range, estimate.uncertainty):
    ...     print(f"{distance:.4f} +- {error:.4f} m")
    1.8805 +- 0.0008 m
    1.9998 +- 0.0002 m
    """
    frequency, index = _checked(modulation_frequency, group_index)
    values, errors = _samples(signal, standard_uncertainty, frequency)
    nearest, farthest = interval
    if values.ndim != 1 or not 0 <= nearest < farthest < np.inf or most < 1:
        raise ValueError(
            "surfaces need one sample a frequency, an interval of two increasing, "
            f"finite slant ranges and most >= 1; got signal of shape {values.shape}, "
            f"interval {interval} m and most = {most}"
        )
    beam = _Beam(
        data=_stacked(np.asarray(values / errors, complex)),
        wave=4 * np.pi * frequency * index / speed_of_light,
        error=errors,
        fixed=np.zeros((2 * frequency.size, 0))
        if water_signal is None
        else _stacked(np.asarray(np.asarray(water_signal) / errors, complex))[:, None],
    )
    step = resolution(modulation_frequency=frequency, group_index=index) / _OVERSAMPLING
    grid = np.linspace(nearest, farthest, 2 + int((farthest - nearest) / step))
    dictionary = beam.echo(grid)
    fit, probabilities = beam.fit(np.zeros(0)), []
    while True:
        place, probability = beam.candidate(fit, grid, dictionary)
        probabilities.append(probability)
        if probability > error_rate or fit.place.size == most:
            break
        starts = [np.append(fit.place, place)]
        for k in range(fit.place.size):
            pair = fit.place[k] + np.array([-1.0, 1.0]) * 2 * step
            starts.append(np.append(np.delete(fit.place, k), pair))
        refined = [
            beam.fit(np.clip(start, nearest, farthest), step=step) for start in starts
        ]
        positive_fits = [part for part in refined if (part.amplitude > 0).all()]
        best = min(positive_fits, key=lambda part: part.misfit, default=fit)
        if best.place.size == fit.place.size:
            break
        fit = best
    order = np.argsort(fit.place)
    both = np.concatenate([order, order.size + order])
    return Surfaces(
        slant_range=fit.place[order],
        amplitude=fit.amplitude[order],
        covariance=beam.covariance(fit)[np.ix_(both, both)],
        misfit=fit.misfit,
        probability=np.array(probabilities),
    )


@dataclass(frozen=True)
class _Fit:
    """Surfaces at places, with amplitudes fitted to the samples."""

    place: Floats
    """Slant ranges [m]."""
    amplitude: Floats
    """Amplitudes [V]."""
    rest: Floats
    """Residuals in standard errors."""

    @property
    def misfit(self) -> float:
        """Chi-square [1]."""
        return float(self.rest @ self.rest)


@dataclass(frozen=True)
class _Beam:
    """Samples of a beam in standard errors, real parts before imaginary parts."""

    data: Floats
    """Samples."""
    wave: Floats
    """Phase per slant range at each frequency [rad/m]."""
    error: Floats
    """Standard uncertainties of the outputs [V]."""
    fixed: Floats
    """Water signal as a column, or no column."""

    def echo(self, place: Floats) -> Floats:
        """Return echoes of unit amplitude as columns."""
        turn = np.exp(1j * np.outer(self.wave, place)) / self.error[:, None]
        return _stacked(turn)

    def slope(self, place: Floats) -> Floats:
        """Return derivatives of these echoes with respect to the place."""
        turn = np.exp(1j * np.outer(self.wave, place)) / self.error[:, None]
        return _stacked(1j * self.wave[:, None] * turn)

    def at(self, place: Floats) -> _Fit:
        """Fit amplitudes to the samples."""
        columns = np.concatenate([self.echo(place), self.fixed], axis=1)
        terms = np.linalg.lstsq(columns, self.data, rcond=None)[0]
        return _Fit(place, terms[: place.size], self.data - columns @ terms)

    def fit(self, place: Floats, *, step: float = 0.0) -> _Fit:
        """Fit places and amplitudes from a start (variable projection)."""
        best = self.at(place)
        for _ in range(_STEPS if place.size else 0):
            basis = self.basis(np.concatenate([self.echo(best.place), self.fixed], 1))
            slope = self.slope(best.place) * best.amplitude
            slope -= basis @ (basis.T @ slope)
            move = np.linalg.lstsq(slope, best.rest, rcond=1e-9)[0]
            move = np.clip(move, -step, step)
            for _ in range(_HALVINGS):
                trial = self.at(best.place + move)
                if trial.misfit < best.misfit:
                    break
                move = move / 2
            else:
                break
            best = trial
            if np.abs(move).max() < _SETTLED * step:
                break
        return best

    @staticmethod
    def basis(columns: Floats) -> Floats:
        """Return an orthonormal basis of columns."""
        return np.linalg.qr(columns)[0] if columns.shape[1] else columns

    def candidate(
        self, fit: _Fit, grid: Floats, dictionary: Floats
    ) -> tuple[float, float]:
        """Return the place of a further surface, and its probability by noise."""
        tangent = [self.echo(fit.place), self.slope(fit.place), self.fixed]
        basis = self.basis(np.concatenate(tangent, axis=1))
        rest = dictionary - basis @ (basis.T @ dictionary)
        size = np.linalg.norm(rest, axis=0)
        use = size > _LEAST_PART * np.linalg.norm(dictionary, axis=0)
        if not use.any():
            return float(grid[0]), 1.0
        unit = rest[:, use] / size[use]
        score = unit.T @ fit.rest
        chords = np.linalg.norm(np.diff(unit, axis=1), axis=0)
        length = float((2 * np.arcsin(np.minimum(chords / 2, 1.0))).sum())
        top = float(score.max())
        probability = ndtr(-top) + length / (2 * np.pi) * np.exp(-(top**2) / 2)
        return float(grid[use][score.argmax()]), float(min(probability, 1.0))

    def covariance(self, fit: _Fit) -> Floats:
        """Return the covariance of places and amplitudes."""
        slope = self.slope(fit.place) * fit.amplitude
        columns = np.concatenate([slope, self.echo(fit.place), self.fixed], axis=1)
        count = 2 * fit.place.size
        if not count:
            return np.zeros((0, 0))
        return np.linalg.inv(columns.T @ columns)[:count, :count]


def fewest(most: int) -> int:
    """Return the number of frequencies that determine surfaces and water, and a test.

    Each frequency has two outputs. Each surface has a place and an amplitude, and the
    water a factor. Three or four outputs remain for the test of the model.
    """
    return most + 2


def _stacked(values: NDArray[np.complex128]) -> Floats:
    """Return real parts before imaginary parts."""
    return np.concatenate([values.real, values.imag])


def _checked(
    modulation_frequency: ArrayLike, group_index: float
) -> tuple[Floats, float]:
    """Return frequencies and group index; ValueError if out of range."""
    frequency = positive(modulation_frequency, name="modulation_frequency", unit="Hz")
    index = float(at_least(group_index, 1, name="group_index"))
    if frequency.ndim != 1 or np.unique(frequency).size < 2:
        raise ValueError(
            "modulation_frequency must be a list of at least two different "
            f"frequencies, got shape {frequency.shape}"
        )
    return frequency, index


def _samples(
    signal: ArrayLike, standard_uncertainty: ArrayLike, frequency: Floats
) -> tuple[Complex, Floats]:
    """Return samples and uncertainties; ValueError if shapes or sizes are wrong."""
    values = np.asarray(signal, dtype=complex)
    errors = positive(standard_uncertainty, name="standard_uncertainty", unit="V")
    if values.shape != errors.shape or values.shape[:1] != frequency.shape:
        raise ValueError(
            "signal and standard_uncertainty must have one row for each of the "
            f"{frequency.size} frequencies, got shapes {values.shape} and "
            f"{errors.shape}"
        )
    return values, errors
