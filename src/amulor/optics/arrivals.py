"""Arrival times of echoes in digitized records and in photon counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import uniform_filter
from scipy.special import ndtr

from amulor.optics._bounds import not_negative, positive

__all__ = ["Arrivals", "matched_filter", "photon_arrivals", "side_lobe", "time_bound"]

Floats = NDArray[np.float64]

#: Steps of the search per inverse bandwidth of the pulse.
_OVERSAMPLING = 3.0
#: Least part of a pulse in the gate [1].
_INSIDE = 0.5
#: Least part of an echo that the first echo does not explain, in a second search [1].
_LEAST_PART = 0.5
#: Largest correlation of two echoes of photons in a second search [1].
_ALIKE = 0.4
#: Steps of Newton's method for the share of an echo.
_STEPS = 12
#: Places of the fine search, and its half width in standard errors.
_PLACES, _REACH = 61, 6.0
#: Half width of the window around the arrival at the neighbors, in pulse widths [1].
_WINDOW = 4.0
#: Smallest probability density of a photon, relative to that of the background [1].
_TINY = 1e-9


@dataclass(frozen=True, kw_only=True)
class Arrivals:
    """Arrival times of the strongest echo in each record, with errors and tests.

    Examples
    --------
    Accept echoes that noise does not explain, and convert them to ranges in water:

    >>> import numpy as np
    >>> from amulor.optics.arrivals import Arrivals
    >>> pair = Arrivals(
    ...     time=np.array([20e-9, 31e-9]),
    ...     uncertainty=np.array([0.1e-9, 2e-9]),
    ...     amplitude=np.array([1.0, 0.2]),
    ...     amplitude_uncertainty=np.array([0.1, 0.1]),
    ...     probability=np.array([1e-9, 0.4]),
    ...     elsewhere=np.array([0.0, 0.7]),
    ...     second=np.array([0.5, 0.5]),
    ... )
    >>> pair.time[pair.probability < 1e-3] * 299792458 / 1.34 / 2
    array([2.23725715])
    """

    time: Floats
    """Delay of the echo behind the pulse as recorded; NaN without photons [s]."""
    uncertainty: Floats
    """Standard uncertainty of the delay [s]."""
    amplitude: Floats
    """Size of the echo: number of photons, or factor of the pulse [1]."""
    amplitude_uncertainty: Floats
    """Standard uncertainty of the amplitude [1]."""
    probability: Floats
    """Probability of an echo of this size by noise alone, anywhere in the gate [1]."""
    elsewhere: Floats
    """Probability that the echo is at another place of the gate [1]."""
    second: Floats
    """Probability by noise alone of what remains beside the echo [1]."""


def time_bound(
    pulse: ArrayLike, *, sample_interval: float, noise: float, amplitude: float = 1.0
) -> float:
    r"""Return the Cramér-Rao bound of the delay of a digitized pulse [s].

    Parameters
    ----------
    pulse : array_like, shape (n,)
        Samples of the pulse [any unit].
    sample_interval : float
        Time between samples [s].
    noise : float
        Standard deviation of a sample [that unit].
    amplitude : float
        Factor of the pulse in the record [1].

    Returns
    -------
    float
        Standard uncertainty [s].

    Raises
    ------
    ValueError
        If an argument is not above zero, or the pulse is constant.

    Notes
    -----
    :math:`\sigma_t = \sigma / (a \sqrt{\sum_k \dot p_k^2})` with noise :math:`\sigma`,
    for white noise [1]_.

    References
    ----------
    .. [1] S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory
       (1993), section 3.11.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics import arrivals
    >>> time = np.arange(-10e-9, 10e-9, 0.1e-9)
    >>> bound = arrivals.time_bound(
    ...     np.exp(-0.5 * (time / 1e-9) ** 2), sample_interval=0.1e-9, noise=0.05
    ... )
    >>> print(f"{1e12 * bound:.1f} ps")
    16.8 ps
    """
    interval = float(positive(sample_interval, name="sample_interval", unit="s"))
    size = float(positive(noise, name="noise")) / float(
        positive(amplitude, name="amplitude")
    )
    values = np.asarray(pulse, dtype=float)
    slope = CubicSpline(np.arange(values.size), values)(np.arange(values.size), 1)
    steepness = float(np.sqrt(slope @ slope))
    if not steepness > 0:
        raise ValueError("pulse must not be constant; a constant has no arrival time")
    return size * interval / steepness


def side_lobe(pulse: ArrayLike, *, periodic: bool = False) -> float:
    """Return the largest side lobe of a matched filter, relative to its peak [1].

    Parameters
    ----------
    pulse : array_like, shape (n,)
        Samples of the pulse or of the code [any unit].
    periodic : bool
        Whether the pulse repeats without a pause.

    Returns
    -------
    float
        Largest modulus of the autocorrelation outside of the main peak, which ends at
        its first minimum or zero.

    Raises
    ------
    ValueError
        If the pulse has fewer than three samples, or is zero.

    Notes
    -----
    The mean is subtracted from a periodic pulse, since `matched_filter` estimates a
    constant. A periodic maximal-length sequence of N chips has side lobes of
    :math:`1 / N` [1]_, and of :math:`1 / (N - 1)` without its mean.

    References
    ----------
    .. [1] S. W. Golomb, Shift Register Sequences (1967).

    Examples
    --------
    A code of 127 chips, sent once and without a pause:

    >>> from scipy.signal import max_len_seq
    >>> from amulor.optics import arrivals
    >>> code = max_len_seq(7)[0]
    >>> print(f"{arrivals.side_lobe(code):.2f}")
    0.50
    >>> print(f"{arrivals.side_lobe(code, periodic=True):.4f} = 1/126")
    0.0079 = 1/126
    """
    values = np.asarray(pulse, dtype=float)
    if values.ndim != 1 or values.size < 3 or not np.any(values):
        raise ValueError(
            f"pulse must be at least three samples, not all zero, got {values.shape}"
        )
    if periodic:
        values = values - values.mean()
        spectrum = np.abs(np.fft.fft(values)) ** 2
        lags = np.fft.ifft(spectrum).real[: values.size // 2 + 1]
    else:
        lags = np.correlate(values, values, mode="full")[values.size - 1 :]
    lags = lags / lags[0]
    turn = (np.diff(lags) >= -1e-12) | (lags[:-1] <= 0)
    turn[0] &= lags[0] <= 0
    first = int(np.argmax(turn)) if turn.any() else lags.size - 1
    return float(np.abs(lags[first:]).max())


@dataclass(frozen=True)
class _Search:
    """Echoes at the places of a search, in the samples of the gate."""

    inside: NDArray[np.bool_]
    """Samples in the gate."""
    place: Floats
    """Delays of the search, in samples."""
    echo_at: Callable[[Floats], Floats]
    """Function that returns echoes at delays, shape (samples of the gate, delays)."""
    width: float
    """Inverse bandwidth of the pulse, in samples."""


def _search(
    pulse: Floats, *, gate: tuple[float, float], photons: bool, periodic: bool
) -> _Search:
    """Return the search for a pulse; ValueError if the gate has no place for it."""
    count = pulse.size
    middle = np.arange(count) + 0.5
    inside = (middle > gate[0]) & (middle < gate[1])
    edges = np.flatnonzero(inside)
    # The integral is interpolated, so that counts of bins are conserved.
    total = np.concatenate([[0.0], np.cumsum(pulse)])
    if periodic:
        total = np.concatenate([total[:-1] - total[-1], total, total[1:] + total[-1]])
        knots = np.arange(-count, 2 * count + 1)
    else:
        knots = np.arange(count + 1)
    integral = (PchipInterpolator if photons else CubicSpline)(knots, total)

    def echo_at(delay: Floats) -> Floats:
        start = edges[:, None] - np.atleast_1d(delay)
        if periodic:
            start = np.mod(start, count)
            ends = start + 1
        else:
            start, ends = (np.clip(edge, 0, count) for edge in (start, start + 1))
        values = np.asarray(integral(ends) - integral(start))
        return np.maximum(values, 0.0) if photons else values

    slope = np.diff(pulse, append=pulse[:1] if periodic else pulse[-1:])
    power = float(pulse @ pulse)
    steepness = float(np.sqrt(slope @ slope / max(power, 1e-300)))
    if edges.size < 4 or not steepness > 0:
        raise ValueError(
            f"the gate has {edges.size} samples, and the pulse must not be constant; "
            "needed are at least 4 samples"
        )
    width = 1 / steepness
    step = width / _OVERSAMPLING
    if periodic:
        place = np.arange(0.0, count, step)
    else:
        place = np.arange(edges[0] - count, edges[-1] + 1, step)
        light = np.abs(echo_at(place)).sum(axis=0)
        place = place[light > _INSIDE * np.abs(pulse).sum()]
    if place.size < 2:
        raise ValueError("the gate is shorter than the pulse; needed is a longer gate")
    return _Search(inside, place, echo_at, width)


def _length(columns: Floats) -> float:
    """Return the length of the curve of normalized columns [1]."""
    chords = np.linalg.norm(np.diff(columns, axis=1), axis=0)
    return float((2 * np.arcsin(np.minimum(chords / 2, 1.0))).sum())


def _chance(score: ArrayLike, length: float) -> Floats:
    """Return the probability that noise exceeds scores along a curve of this length."""
    score = np.asarray(score, float)
    bound = ndtr(-score) + length / (2 * np.pi) * np.exp(-(score**2) / 2)
    return np.asarray(np.minimum(bound, 1.0))


def _ends(gate: tuple[float, float] | None, step: float) -> tuple[float, float]:
    """Return the ends of the gate in samples."""
    if gate is None:
        return -np.inf, np.inf
    if not gate[0] < gate[1]:
        raise ValueError(
            f"gate must be two increasing times, got {gate[0]:g} s and {gate[1]:g} s"
        )
    return gate[0] / step, gate[1] / step


def matched_filter(
    record: ArrayLike,
    *,
    pulse: ArrayLike,
    noise: float,
    sample_interval: float,
    gate: tuple[float, float] | None = None,
    water: ArrayLike | None = None,
    periodic: bool = False,
) -> Arrivals:
    r"""Estimate the arrival of a known pulse or code in digitized records.

    Parameters
    ----------
    record : array_like, shape (..., n)
        Samples [any unit].
    pulse : array_like, shape (n,)
        Recorded pulse, code or gate profile on the same time axis [that unit].
    noise : float
        Standard deviation of a sample, independent between samples [that unit].
    sample_interval : float
        Time between samples [s].
    gate : tuple of float, optional
        First and last time of the samples that are used, from the start of the record
        [s].
    water : array_like, shape (n,), optional
        Record without a target, up to a factor, which is estimated [that unit].
    periodic : bool
        Whether pulse and record are one period of a signal without a pause.

    Returns
    -------
    Arrivals
        Delays and amplitudes, each of shape (...), with errors and tests.

    Raises
    ------
    ValueError
        If shapes differ, a number is not above zero, or the gate is too short.

    Notes
    -----
    Least squares of :math:`y_k = a\,p(t_k - \tau) + c + d\,w_k` with :math:`a > 0`. For
    each delay the constant c and the water w are projected out. The delay maximizes the
    score u, the normalized correlation. The delay is the mean over its likelihood
    :math:`e^{u^2/2}`, and the uncertainty its standard deviation, in the limit of
    small noise the Cramér-Rao bound (`time_bound`). Noise exceeds u in the gate with a
    probability of at most :math:`\Phi(-u) + \kappa e^{-u^2/2} / 2 \pi`, with the length
    :math:`\kappa` of the curve of normalized echoes [1]_. The same test with the
    residuals gives the probability of a second echo. Water that is not subtracted
    is such a second echo.

    References
    ----------
    .. [1] R. B. Davies, Biometrika 64, 247 (1977), :doi:`10.1093/biomet/64.2.247`.

    Examples
    --------
    A code of 63 chips, 2 ns each, 12 ns late and below the noise:

    >>> import numpy as np
    >>> from scipy.signal import max_len_seq
    >>> from amulor.optics import arrivals
    >>> code = np.zeros(600)
    >>> code[:252] = np.repeat(max_len_seq(6)[0], 4)  # 0.5 ns per sample
    >>> noise = np.random.default_rng(1).standard_normal(600)
    >>> found = arrivals.matched_filter(
    ...     0.8 * np.roll(code, 24) + noise, pulse=code, noise=1, sample_interval=0.5e-9
    ... )
    >>> print(f"{1e9 * found.time:.2f} +- {1e9 * found.uncertainty:.2f} ns")
    11.99 +- 0.13 ns
    """
    step = float(positive(sample_interval, name="sample_interval", unit="s"))
    sigma = float(positive(noise, name="noise"))
    values, shape = _records(record, pulse)
    wave = np.asarray(pulse, float)
    search = _search(wave, gate=_ends(gate, step), photons=False, periodic=periodic)
    fixed = _fixed(search, water, wave.size)
    data = values[:, search.inside].T / sigma
    data = data - fixed @ (fixed.T @ data)

    def normalized(delay: Floats) -> tuple[Floats, Floats]:
        columns = search.echo_at(delay) / sigma
        columns = columns - fixed @ (fixed.T @ columns)
        size = np.linalg.norm(columns, axis=0)
        return columns / np.maximum(size, 1e-300), size

    def scored(own: Floats, delay: Floats) -> Floats:
        return np.asarray(normalized(delay)[0].T @ own)

    columns, _ = normalized(search.place)
    scores = columns.T @ data
    best = scores.argmax(axis=0)
    result = {name: np.full(values.shape[0], np.nan) for name in _NAMES}
    length = _length(columns)
    result["probability"] = _chance(scores.max(axis=0), length)
    for k in range(values.shape[0]):
        top = max(float(scores[best[k], k]), 1.0)
        # The bound, from the curvature of the normalized echo.
        near = search.place[best[k]] + search.width * np.array([-0.1, 0.1])
        pair, _ = normalized(near)
        turn = float(np.linalg.norm(np.diff(pair, axis=1))) / (0.2 * search.width)
        spread = min(1 / (top * turn), search.width)
        half = _REACH * spread + search.width / _OVERSAMPLING
        fine, score = _finely(
            partial(scored, data[:, k]), search.place[best[k]], half, spread
        )
        place, error = _mean(fine, score)
        unit, size = normalized(np.array([place]))
        ahead, _ = normalized(np.array([place + 0.1 * search.width]))
        tangent = ahead - unit
        tangent = tangent - unit * (unit.T @ tangent)
        tangent /= np.linalg.norm(tangent)
        used = np.concatenate([unit, tangent], axis=1)
        left = data[:, k] - unit[:, 0] * (unit[:, 0] @ data[:, k])
        overlap = used.T @ columns
        norm = np.sqrt(np.maximum(1 - (overlap**2).sum(axis=0), 0.0))
        far = norm > _LEAST_PART
        rest = (columns.T @ left - overlap.T @ (used.T @ left))[far] / norm[far]
        highest = np.abs(rest).max(initial=0.0)
        result["second"][k] = min(2 * float(_chance(highest, length)), 1.0)
        result["time"][k], result["uncertainty"][k] = place * step, error * step
        result["amplitude"][k] = (unit[:, 0] @ data[:, k]) / size[0]
        result["amplitude_uncertainty"][k] = 1 / size[0]
        result["elsewhere"][k] = _elsewhere(
            search.place,
            np.maximum(scores[:, k], 0),
            place,
            half,
            period=wave.size if periodic else np.inf,
        )
    return Arrivals(**{name: part.reshape(shape) for name, part in result.items()})


_NAMES = (
    "time",
    "uncertainty",
    "amplitude",
    "amplitude_uncertainty",
    "probability",
    "elsewhere",
    "second",
)


def _records(record: ArrayLike, pulse: ArrayLike) -> tuple[Floats, tuple[int, ...]]:
    """Return records as rows, and the shape of the results."""
    values, wave = np.asarray(record, float), np.asarray(pulse, float)
    if wave.ndim != 1 or values.shape[-1:] != wave.shape:
        raise ValueError(
            "record and pulse must have the same samples on the last axis, got shapes "
            f"{values.shape} and {wave.shape}"
        )
    return values.reshape(-1, wave.size), values.shape[:-1]


def _fixed(search: _Search, water: ArrayLike | None, count: int) -> Floats:
    """Return an orthonormal basis of a constant and of the water, in the gate."""
    columns = [np.ones(int(search.inside.sum()))]
    if water is not None:
        shape = np.asarray(water, float)
        if shape.shape != (count,):
            raise ValueError(
                f"water must have {count} samples, as pulse, got shape {shape.shape}"
            )
        columns.append(shape[search.inside])
    return np.linalg.qr(np.array(columns).T)[0]


def _finely(
    score_at: Callable[[Floats], Floats], middle: float, half: float, spread: float
) -> tuple[Floats, Floats]:
    """Return delays about the best one, at most a spread apart, and their scores."""
    while True:
        offset, step = np.linspace(-half, half, _PLACES, retstep=True)
        fine = middle + offset
        score = score_at(fine)
        if not step > spread:
            return fine, score
        middle, half = fine[score.argmax()], max(_REACH * spread, 2 * step)


def _mean(place: Floats, score: Floats) -> tuple[float, float]:
    """Return mean and standard deviation over the likelihood of scores."""
    half = 0.5 * np.maximum(score, 0.0) ** 2
    weight = np.exp(half - half.max())
    weight /= weight.sum()
    middle = float(weight @ place)
    return middle, float(np.sqrt(weight @ (place - middle) ** 2))


def _elsewhere(
    place: Floats, score: Floats, middle: float, half: float, *, period: float
) -> float:
    """Return the part of the likelihood outside of the main peak."""
    power = 0.5 * score**2
    weight = np.exp(power - power.max())
    distance = np.abs(place - middle)
    distance = np.minimum(distance, period - distance)
    return float(weight[distance > half].sum() / weight.sum())


def photon_arrivals(
    counts: ArrayLike,
    *,
    pulse: ArrayLike,
    bin_width: float,
    gate: tuple[float, float] | None = None,
    water: ArrayLike | None = None,
    exposure: ArrayLike | None = None,
    neighbors: int = 0,
) -> Arrivals:
    r"""Estimate arrival times of an echo from single photons in a background.

    Parameters
    ----------
    counts : array_like of int, shape (rows, columns, n)
        Photons per time bin [1].
    pulse : array_like, shape (n,)
        Recorded pulse of the instrument on the same bins [any unit].
    bin_width : float
        Length of a bin [s].
    gate : tuple of float, optional
        First and last time of the bins that are used, from the start of bin 0 [s].
    water : array_like, shape (n,), optional
        Histogram without a target, up to a factor, which is estimated [any unit].
    exposure : array_like, shape (rows, columns, n), optional
        Share of the laser pulses for which the counter was ready, for each bin (dead
        time) [1].
    neighbors : int
        Pixels on each side whose photons select the place of the echo [1].

    Returns
    -------
    Arrivals
        Delays and numbers of photons, shape (rows, columns), with errors and tests.

    Raises
    ------
    ValueError
        If shapes differ, a number is out of range, or the gate is too short.

    Notes
    -----
    Photons are independent, with a probability per bin of

    .. math:: r_k \left[s\,p(t_k - \tau) + (1 - s) q_k\right]

    up to a norm, with the exposure r, the share s of the echo, and the background q, a
    constant and the water. The share maximizes the likelihood at each delay. For a
    counter that detects the first photon of each laser pulse, this is the likelihood
    with censored photons. `probability` is that of the likelihood ratio, with the same
    bound as in `matched_filter`.

    With `neighbors` the photons of :math:`(2 m + 1)^2` pixels give share and place. The
    delay of the pixel is then searched within four pulse widths of this place, with its
    own photons. Pixels with few photons need this step, which assumes that neighbors
    have similar distances (first-photon imaging, [1]_). `elsewhere` then is the
    probability of the photons of the pixel outside of the window, near 1 at edges.

    The delay is the mean over the likelihood, and the uncertainty its standard
    deviation. Without a background it is the pulse width divided by the root of the
    number of photons.

    References
    ----------
    .. [1] A. Kirmani et al., Science 343, 58 (2014), :doi:`10.1126/science.1246775`.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics import arrivals
    >>> bins = np.arange(400)
    >>> pulse = np.exp(-0.5 * ((bins - 20) / 4) ** 2)
    >>> echo = np.exp(-0.5 * ((bins - 220) / 4) ** 2)
    >>> mean = 25 * echo / echo.sum() + 25 / 400
    >>> counts = np.random.default_rng(1).poisson(mean)[None, None]
    >>> found = arrivals.photon_arrivals(counts, pulse=pulse, bin_width=50e-12)
    >>> time, error = 1e9 * found.time[0, 0], 1e9 * found.uncertainty[0, 0]
    >>> print(f"{time:.2f} +- {error:.2f} ns")
    9.95 +- 0.05 ns
    """
    step = float(positive(bin_width, name="bin_width", unit="s"))
    not_negative(counts, name="counts")
    number = np.asarray(counts, float)
    if number.ndim != 3 or neighbors < 0:
        raise ValueError(
            "counts must have the dimensions rows, columns, bins, and neighbors must "
            f"not be negative, got shape {number.shape} and {neighbors}"
        )
    wave = np.asarray(pulse, float)
    _records(number, wave)
    ready = np.ones(number.shape) if exposure is None else np.asarray(exposure, float)
    if ready.shape != number.shape:
        raise ValueError(
            f"exposure must have the shape of counts, {number.shape}, got {ready.shape}"
        )
    search = _search(wave, gate=_ends(gate, step), photons=True, periodic=False)
    inside = search.inside
    background = [np.ones(int(inside.sum()))]
    if water is not None:
        _fixed(search, water, wave.size)  # checks the shape
        background.append(np.maximum(np.asarray(water, float)[inside], 0.0))
    number, ready = number[..., inside], ready[..., inside]
    size = 2 * neighbors + 1

    def pooled(values: Floats) -> Floats:
        return np.asarray(
            uniform_filter(values, (size, size, 1), mode="constant") * size**2
        )

    many = np.rint(pooled(number)) if neighbors else number
    share = pooled(ready) / pooled(np.ones(ready.shape)) if neighbors else ready
    result = {name: np.full(number.shape[:2], np.nan) for name in _NAMES}
    result["probability"][:] = result["elsewhere"][:] = result["second"][:] = 1.0
    result["amplitude"][:] = 0.0
    echoes = search.echo_at(search.place)
    for pixel in np.ndindex(number.shape[:2]):
        if number[pixel].sum() == 0:
            continue
        beam = _Photons(search, echoes, many[pixel], share[pixel], background)
        for name, value in beam.arrival(
            number[pixel], ready[pixel], alone=not neighbors
        ).items():
            result[name][pixel] = value
    result["time"] *= step
    result["uncertainty"] *= step
    return Arrivals(**result)


class _Photons:
    """Photons in the gate, with the echoes that may explain them."""

    def __init__(
        self,
        search: _Search,
        echoes: Floats,
        counts: Floats,
        ready: Floats,
        background: list[Floats],
    ) -> None:
        self.search, self.counts, self.ready = search, counts, ready
        self.parts = [_norm(part * ready) for part in background]
        self.mix = np.ones(len(self.parts)) / len(self.parts)
        self.echoes = _norm(echoes * ready[:, None])

    def arrival(self, own: Floats, ready: Floats, *, alone: bool) -> dict[str, float]:
        """Return the arrival of the photons of one pixel, in bins, and its tests."""
        self.mix = self._mixed([])
        null = self._background()
        gain, share = self._gains(self.counts, self.echoes, null)
        best = int(gain.argmax())
        # The first fit of the background had to explain the echo, too.
        self.mix = self._mixed([self.echoes[:, best]])
        null = self._background()
        gain, share = self._gains(self.counts, self.echoes, null)
        best = int(gain.argmax())
        part = float(share[best])
        length = self._length(null)
        start = self._place(
            self.counts, self.ready, null, part, self.search.place[best], alone=True
        )[0]
        echo = self._echo(start, self.ready)
        first = part * echo + (1 - part) * null
        apart = self._apart(first, echo)
        second = 1.0
        if apart.any():
            after, _ = self._gains(self.counts, self.echoes[:, apart], first)
            second = float(_chance(np.sqrt(2 * after.max()), length))
        place, error, elsewhere = self._place(
            own, ready, null, part, start, alone=alone
        )
        size, spread = self._size(own, ready, null, place)
        return {
            "time": place,
            "uncertainty": error,
            "amplitude": size,
            "amplitude_uncertainty": spread,
            "probability": float(_chance(np.sqrt(2 * gain[best]), length)),
            "elsewhere": elsewhere,
            "second": second,
        }

    def _echo(self, place: float, ready: Floats) -> Floats:
        """Return the echo at a place, with the sum 1."""
        return _norm(self.search.echo_at(np.array([place]))[:, 0] * ready)

    def _size(
        self, own: Floats, ready: Floats, null: Floats, place: float
    ) -> tuple[float, float]:
        """Return the number of photons of the echo, and its uncertainty."""
        echo = self._echo(place, ready)
        part = float(self._gains(own, echo[:, None], null)[1][0])
        total, some = float(own.sum()), own > 0
        mean = total * (part * echo + (1 - part) * null)[some]
        known = float(own[some] @ (echo[some] / np.maximum(mean, 1e-300)) ** 2)
        return part * total, 1 / np.sqrt(max(known, 1e-300))

    def _background(self) -> Floats:
        return np.asarray(
            np.maximum(np.tensordot(self.mix, self.parts, axes=1), 1e-300)
        )

    def _mixed(self, echoes: list[Floats]) -> Floats:
        """Return shares of the parts of the background, by expectation maximization."""
        parts = np.array([*self.parts, *echoes])
        if len(self.parts) == 1:
            return np.ones(1)
        weight = np.ones(len(parts)) / len(parts)
        for _ in range(100):
            total = np.maximum(weight @ parts, 1e-300)
            weight = weight * (parts @ (self.counts / total))
            weight /= max(weight.sum(), 1e-300)
        shares = weight[: len(self.parts)]
        return np.asarray(shares / max(shares.sum(), 1e-300))

    @staticmethod
    def _gains(counts: Floats, echoes: Floats, null: Floats) -> tuple[Floats, Floats]:
        """Return the gain of likelihood by an echo at each place, and its share."""
        some = counts > 0
        number, ratio = counts[some, None], echoes[some] / null[some, None] - 1
        share = np.full(echoes.shape[1], 0.3)
        for _ in range(_STEPS):
            slope = ratio / (1 + share * ratio)
            move = (number * slope).sum(axis=0) / (number * slope**2).sum(axis=0)
            # Newton's method returns slowly from a share near one.
            share = np.clip(share + np.minimum(move, 0.5 * (1 - share)), 0.0, 0.9999)
        gain = (number * np.log1p(share * ratio)).sum(axis=0)
        better = gain > 0
        return np.where(better, gain, 0.0), np.where(better, share, 0.0)

    def _length(self, null: Floats) -> float:
        """Return the length of the curve of echoes, without the background."""
        error = np.sqrt(np.maximum(null, _TINY / null.size))
        basis = np.linalg.qr(np.array(self.parts).T / error[:, None])[0]
        columns = self.echoes / error[:, None]
        columns = columns - basis @ (basis.T @ columns)
        return _length(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))

    def _apart(self, mean: Floats, echo: Floats) -> NDArray[np.bool_]:
        """Return the places whose echoes differ from the first one."""
        error = np.sqrt(np.maximum(mean, _TINY / mean.size))
        columns, first = self.echoes / error[:, None], echo / error
        alike = first @ columns / np.linalg.norm(columns, axis=0)
        return np.asarray(np.abs(alike) < _ALIKE * np.linalg.norm(first))

    def _place(
        self,
        own: Floats,
        ready: Floats,
        null: Floats,
        part: float,
        start: float,
        *,
        alone: bool,
    ) -> tuple[float, float, float]:
        """Return place and error from the photons of the pixel itself."""
        width = self.search.width
        narrow = width / np.sqrt(max(part * float(own.sum()), 1.0))
        half = _WINDOW * width
        if alone:
            half = min(half, _REACH * narrow + width / _OVERSAMPLING)
        fine, power = _finely(
            lambda delay: self._power(
                own, ready, null, part, self.search.echo_at(delay)
            ),
            start,
            half,
            narrow,
        )
        coarse = self._power(own, ready, null, part, None)
        highest = max(power.max(), coarse.max())
        main = np.exp(power - highest).sum() * (fine[1] - fine[0])
        far = np.abs(self.search.place - start) > half
        step = self.search.place[1] - self.search.place[0]
        other = np.exp(coarse[far] - highest).sum() * step
        weight = np.exp(power - power.max())
        weight /= weight.sum()
        middle = float(weight @ fine)
        spread = float(np.sqrt(weight @ (fine - middle) ** 2))
        return middle, spread, float(other / max(other + main, 1e-300))

    def _power(
        self,
        own: Floats,
        ready: Floats,
        null: Floats,
        part: float,
        echoes: Floats | None,
    ) -> Floats:
        """Return log likelihoods of the photons of the pixel."""
        shapes = self.echoes if echoes is None else _norm(echoes * ready[:, None])
        some = own > 0
        mean = part * shapes[some] + (1 - part) * null[some, None]
        return np.asarray(own[some] @ np.log(np.maximum(mean, _TINY / null.size)))


def _norm(shapes: Floats) -> Floats:
    """Return shapes with the sum 1 over the first axis."""
    return np.asarray(shapes / np.maximum(shapes.sum(axis=0), 1e-300))
