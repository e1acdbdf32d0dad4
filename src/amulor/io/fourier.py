"""Takes Fourier coefficients of photon histograms, with their counting noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import FormatError
from amulor.io.histograms import Histograms

#: Values that one step of the transform holds, about 16 MiB of float64.
BLOCK = 2**21


def checked_frequency(
    histograms: Histograms, modulation_frequency: ArrayLike
) -> NDArray[np.float64]:
    """Return modulation frequencies that the bins of the histograms can resolve.

    Parameters
    ----------
    histograms : Histograms
        Where the bins come from.
    modulation_frequency : array_like
        One frequency or several that increase [Hz].

    Returns
    -------
    ndarray
        The frequencies, shape (frequencies,) [Hz].

    Raises
    ------
    FormatError
        If one is not above zero, or is above one half per bin width, where a bin
        is half a period long and takes a third off the amplitude, or if they do
        not increase.
    """
    path = histograms.path
    try:
        frequency = np.atleast_1d(np.asarray(modulation_frequency, dtype=float))
    except (TypeError, ValueError) as error:
        raise FormatError(
            f"{path}: modulation_frequency {modulation_frequency!r} is not a list of "
            "numbers; state frequencies in Hz"
        ) from error
    if frequency.ndim != 1 or frequency.size == 0:
        raise FormatError(
            f"{path}: modulation_frequency has shape {frequency.shape}; state a list "
            "of at least one frequency in Hz"
        )
    wrong = frequency[~(np.isfinite(frequency) & (frequency > 0))]
    if wrong.size:
        raise FormatError(
            f"{path}: modulation_frequency must be finite and above 0 Hz, found "
            f"{wrong[0]:g} Hz; take it off the list"
        )
    highest = 0.5 / histograms.bin_width
    if frequency.max() > highest:
        raise FormatError(
            f"{path}: modulation_frequency {frequency.max():g} Hz is too high for "
            f"bin_width_s {histograms.bin_width:g} s; stay at or below {highest:g} Hz, "
            "half a period per bin"
        )
    if np.any(np.diff(frequency) <= 0):
        raise FormatError(
            f"{path}: modulation_frequency must increase; sort the list and drop what "
            "stands there twice"
        )
    return frequency


def weights(
    histograms: Histograms,
    frequency: NDArray[np.float64],
    *,
    time_of_emission: float = 0.0,
    background_bins: tuple[int, int] | None = None,
) -> NDArray[np.complex128]:
    r"""Return what each count of a bin adds to the signal at each frequency.

    Parameters
    ----------
    histograms : Histograms
        Where the bins come from.
    frequency : ndarray
        Modulation frequencies, see `checked_frequency` [Hz].
    time_of_emission : float
        When the light left, on the clock on which bin 0 starts at zero [s].
    background_bins : tuple of int, optional
        First bin, and the one after the last, in which no light of the source
        falls. Their mean count is then taken off each bin.

    Returns
    -------
    ndarray
        Weights, shape (frequencies, bins) [1].

    Raises
    ------
    FormatError
        If the background bins are not bins of the file.

    Notes
    -----
    :math:`g_k = e^{2 \pi i f t_k}` with :math:`t_k` the centre of bin k. With a
    background it is :math:`g_k - [k \in B] \sum_j g_j / |B|`: taking a mean off is
    linear in the counts, so the counting noise of the background needs no term of
    its own.
    """
    bins = histograms.counts.shape[-1]
    time = (np.arange(bins) + 0.5) * histograms.bin_width - time_of_emission
    weight: NDArray[np.complex128] = np.exp(2j * np.pi * np.outer(frequency, time))
    if background_bins is not None:
        first, end = background_bins
        if not 0 <= first < end <= bins:
            raise FormatError(
                f"{histograms.path}: background_bins ({first}, {end}) are not bins of "
                f"'counts'; state 0 <= first < end <= {bins}"
            )
        weight[:, first:end] -= weight.sum(axis=1, keepdims=True) / (end - first)
    return weight


@dataclass(frozen=True, kw_only=True, eq=False)
class Coefficients:
    """Weighted sums of counts, with the covariance that counting photons gives."""

    signal: NDArray[np.complex128]
    """Sum of counts and weights, shape (frequencies, ...) [1]."""
    variance_in_phase: NDArray[np.float64]
    """Variance of its real part [1]."""
    variance_quadrature: NDArray[np.float64]
    """Variance of its imaginary part [1]."""
    covariance: NDArray[np.float64]
    """Covariance of the two [1]."""


def transform(counts: NDArray[Any], weight: NDArray[np.complex128]) -> Coefficients:
    r"""Return the weighted sums of histograms and their Poisson covariance.

    Parameters
    ----------
    counts : ndarray
        Photons per bin, shape (..., bins) [1].
    weight : ndarray
        What a count adds, shape (frequencies, bins) [1].

    Returns
    -------
    Coefficients
        Of shape (frequencies, ...).

    Notes
    -----
    With counts :math:`n_k` that are Poisson and independent, the signal
    :math:`\sum_k n_k g_k` has the variances :math:`\sum_k n_k (\Re g_k)^2` and
    :math:`\sum_k n_k (\Im g_k)^2` and the covariance
    :math:`\sum_k n_k \Re g_k \Im g_k`; the observed counts stand for their means,
    which leaves the estimates unbiased. Done as matrix products over blocks of
    histograms and frequencies, so that memory stays bounded.

    Examples
    --------
    >>> found = transform(np.array([3, 4]), np.array([[1.0, 1j]]))
    >>> print(found.signal[0], found.variance_in_phase[0], found.covariance[0])
    (3+4j) 3.0 0.0
    """
    frequencies, bins = weight.shape
    flat = counts.reshape(-1, bins)
    sums = np.empty((5, frequencies, flat.shape[0]))
    rows = max(1, BLOCK // bins)
    step = max(1, BLOCK // (5 * bins))
    for start in range(0, frequencies, step):
        part = slice(start, start + step)
        real, imaginary = weight[part].real, weight[part].imag
        matrix = np.concatenate(
            [real, imaginary, real**2, imaginary**2, real * imaginary]
        )
        for row in range(0, flat.shape[0], rows):
            block = flat[row : row + rows].astype(float)
            product = (matrix @ block.T).reshape(5, -1, block.shape[0])
            sums[:, part, row : row + rows] = product
    sums = sums.reshape(5, frequencies, *counts.shape[:-1])
    return Coefficients(
        signal=sums[0] + 1j * sums[1],
        variance_in_phase=sums[2],
        variance_quadrature=sums[3],
        covariance=sums[4],
    )
