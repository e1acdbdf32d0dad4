"""Frequency response of slabs, from light pulses with and without a slab."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor.errors import FormatError
from amulor.io.histograms import (
    Histograms,
    checked_frequency,
    read_histograms,
    transform,
    weights,
)

__all__ = ["Slabs", "mean_delay", "read_slabs", "slab_response"]


#: Number of frequencies processed at a time, which limits the memory.
_TOGETHER = 64
#: A bin counts as dark if it exceeds the background by at most this many deviations.
_DARK = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Slabs:
    """Time histograms of light pulses through slabs, and without a slab.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import io
    >>> light = np.zeros((3, 400), dtype=int)
    >>> light[:, 40:60] = [[500], [200], [900]]
    >>> np.savez(
    ...     "slabs.npz",
    ...     counts=light[:2],
    ...     direct_counts=light[2],
    ...     thickness_inch=[0.5, 1.0],
    ...     bin_width_s=4e-12,
    ... )
    >>> slabs = io.read_slabs("slabs.npz")
    >>> slabs.counts.sum(axis=1)
    array([10000.,  4000., 18000.])
    """

    histograms: Histograms
    """Content of the file."""
    thickness: NDArray[np.float64]
    """Thickness of each slab [m]."""
    counts: NDArray[np.float64]
    """Counts minus their background, dimensions (slab or none, bin) [1]."""
    background: NDArray[np.float64]
    """Background subtracted from each bin, per histogram [1]."""


def read_slabs(path: str | os.PathLike[str]) -> Slabs:
    r"""Read the histograms of light through slabs and subtract their background.

    Parameters
    ----------
    path : path-like
        File in npz format with `counts` (slabs, bins), `thickness_inch` and
        `direct_counts`; see `amulor.io.histograms.read_histograms`.

    Returns
    -------
    Slabs
        Histograms without background; the last one is that without a slab.

    Raises
    ------
    FormatError
        If the file cannot be read or is of another kind, or if a histogram has no light
        above its background.

    Notes
    -----
    The background of a histogram is the median of its bins. This is right if nearly all
    bins are without light: with light in a third of them it is too high by 0.67 of the
    noise of a bin. The background is subtracted from all bins. Negative results are
    kept, since setting them to zero would count half of the noise as light.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import io
    >>> light = np.zeros((3, 400), dtype=int)
    >>> light[:, 40:60] = [[500], [200], [900]]
    >>> np.savez(
    ...     "slabs.npz",
    ...     counts=light[:2],
    ...     direct_counts=light[2],
    ...     thickness_inch=[0.5, 1.0],
    ...     bin_width_s=4e-12,
    ... )
    >>> slabs = io.read_slabs("slabs.npz")
    >>> slabs.thickness
    array([0.0127, 0.0254])
    """
    histograms = read_histograms(path)
    if histograms.counter is not None:
        raise FormatError(
            f"{histograms.path}: the dead time of slabs is not corrected; remove "
            "'cycles', and record fewer photons per pulse"
        )
    if histograms.thickness is None or histograms.direct_counts is None:
        missing = "thickness_inch" if histograms.thickness is None else "direct_counts"
        raise FormatError(
            f"{histograms.path}: field '{missing}' is missing or of no use here; "
            "needed are 'counts' (slabs, bins) with 'thickness_inch' and "
            "'direct_counts', the histogram without a slab"
        )
    observed = np.concatenate(
        [histograms.counts[0, 0], histograms.direct_counts[np.newaxis]]
    ).astype(float)
    background = np.median(observed, axis=1)
    counts = observed - background[:, np.newaxis]
    dark = np.flatnonzero(counts.sum(axis=1) <= 0)
    if dark.size:
        number = int(dark[0])
        field = "direct_counts" if number == len(observed) - 1 else f"counts[{number}]"
        raise FormatError(
            f"{histograms.path}: field '{field}' has no light above its median "
            f"{background[number]:g} per bin; record more bins without light"
        )
    return Slabs(
        histograms=histograms,
        thickness=histograms.thickness,
        counts=counts,
        background=background,
    )


def slab_response(slabs: Slabs, modulation_frequency: ArrayLike) -> xr.Dataset:
    r"""Attenuation and delay of intensity modulation by slabs of a medium.

    Parameters
    ----------
    slabs : Slabs
        Histograms from `read_slabs`.
    modulation_frequency : array_like
        Frequencies that increase, up to half a period per bin [Hz].

    Returns
    -------
    xarray.Dataset
        Variables `amplitude` [1] and `phase` [rad] over (thickness,
        modulation_frequency), and their `_uncertainty`. The phase is the delay
        behind the light without a slab, wrapped to -pi..pi.

    Raises
    ------
    FormatError
        If a frequency cannot be used.

    Notes
    -----
    :math:`H(f) = \frac{S(f) / S(0)}{D(f) / D(0)}` with the Fourier coefficients
    :math:`S` of the counts behind a slab and :math:`D` of those without it, so
    :math:`H(0) = 1`; bin width and pulse length cancel. A change :math:`\delta n_k` of
    a bin moves :math:`\ln H` by :math:`\delta n_k (g_k / S(f) - 1 / S(0))`: the
    uncertainties are the real part (amplitude) and the imaginary part (phase), with
    Poisson counts, first order, good while the amplitude is well above its
    uncertainty. The background b, a median of K bins, has the variance
    :math:`\pi b / 2 K + 1/12`, that of a Gaussian sample and of rounding to whole
    counts, and the covariance :math:`b / K` with each bin that holds no light.

    Examples
    --------
    >>> import tempfile
    >>> counts = np.zeros((2, 1000), dtype=int)
    >>> counts[0, 20:22] = counts[1, [20, 30]] = 500
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(
    ...         f"{folder}/slab.npz",
    ...         counts=counts[1:],
    ...         direct_counts=counts[0],
    ...         thickness_inch=[1],
    ...         bin_width_s=1e-10,
    ...     )
    ...     slabs = read_slabs(f"{folder}/slab.npz")
    >>> response = slab_response(slabs, 250e6)
    >>> print(f"{response['amplitude'].item():.3f}, {response['phase'].item():.3f} rad")
    0.709, 0.707 rad
    """
    frequency = checked_frequency(slabs.histograms, modulation_frequency)
    blocks = np.array_split(frequency, -(-frequency.size // _TOGETHER))
    parts = [_ratio(slabs, weights(slabs.histograms, block)) for block in blocks]
    ratio, along, across = (
        np.concatenate(part, axis=1) for part in zip(*parts, strict=True)
    )
    response = ratio[:-1] / ratio[-1]
    amplitude = np.abs(response)
    dimensions = ("thickness", "modulation_frequency")

    def variable(values: NDArray[Any], units: str, name: str) -> xr.Variable:
        return xr.Variable(dimensions, values, {"units": units, "long_name": name})

    return xr.Dataset(
        {
            "amplitude": variable(amplitude, "1", "modulation left behind the slab"),
            "amplitude_uncertainty": variable(
                amplitude * np.sqrt(along[:-1] + along[-1]),
                "1",
                "standard uncertainty of the amplitude",
            ),
            "phase": variable(np.angle(response), "rad", "delay by the slab, wrapped"),
            "phase_uncertainty": variable(
                np.sqrt(across[:-1] + across[-1]),
                "rad",
                "standard uncertainty of the phase",
            ),
        },
        {
            "thickness": (
                "thickness",
                slabs.thickness,
                {"units": "m", "long_name": "thickness of the slab"},
            ),
            "modulation_frequency": (
                "modulation_frequency",
                frequency,
                {"units": "Hz", "long_name": "frequency of the intensity modulation"},
            ),
        },
    )


def mean_delay(slabs: Slabs) -> NDArray[np.float64]:
    r"""Mean additional delay of light behind each slab [s].

    Parameters
    ----------
    slabs : Slabs
        Histograms from `read_slabs`.

    Returns
    -------
    ndarray
        Mean delay, shape (slabs,) [s].

    Notes
    -----
    :math:`\sum_k n_k t_k / \sum_k n_k` less that without a slab: the limit of
    :math:`\arg H(f) / 2 \pi f` towards :math:`f = 0`.

    Examples
    --------
    >>> import tempfile
    >>> counts = np.zeros((2, 1000), dtype=int)
    >>> counts[0, 20] = counts[1, 50] = 800
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(
    ...         f"{folder}/slab.npz",
    ...         counts=counts[1:],
    ...         direct_counts=counts[0],
    ...         thickness_inch=[1],
    ...         bin_width_s=1e-10,
    ...     )
    ...     slabs = read_slabs(f"{folder}/slab.npz")
    >>> print(f"{1e9 * mean_delay(slabs)[0]:.1f} ns")
    3.0 ns
    """
    histograms = slabs.histograms
    time = (np.arange(slabs.counts.shape[1]) + 0.5) * histograms.bin_width
    arrival = slabs.counts @ time / slabs.counts.sum(axis=1)
    return np.asarray(arrival[:-1] - arrival[-1])


def _ratio(
    slabs: Slabs, weight: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64]]:
    """Modulation ratio of each histogram; variances of its log modulus and phase."""
    level = slabs.background[:, np.newaxis]
    bins = weight.shape[1]
    # Less one, so that at low frequencies small numbers are added and not the
    # differences of large ones.
    turned = weight - 1
    sums = turned.sum(axis=1)
    observed = transform(slabs.counts + level, turned)
    total = observed.signal.T
    light = slabs.counts.sum(axis=1, keepdims=True)
    ratio = 1 + (total - level * sums) / light
    # The median has the noise of the bins without light.
    dark = (slabs.counts <= _DARK * np.sqrt(level)).astype(float)
    dark_bins = dark.sum(axis=1, keepdims=True)
    # Copies, because only unbroken arrays multiply fast.
    dark_real = (turned.real.copy() @ dark.T).T
    dark_imaginary = (turned.imag.copy() @ dark.T).T
    variances: list[NDArray[np.float64]] = []
    # One count in bin k adds Re or Im of weight / signal, less 1 / light to Re. The
    # square of that is multiplied out, so that no array over bins is needed.
    for inverse in (1 / ratio, -1j / ratio):
        a, b = inverse.real / light, -inverse.imag / light
        c = a - 1 / light if not variances else a
        independent = (
            a**2 * observed.variance_in_phase.T
            + b**2 * observed.variance_quadrature.T
            + 2 * a * b * observed.covariance.T
            + 2 * c * (a * total.real + b * total.imag)
            + c**2 * (light + bins * level)
        )
        # A background that is too high by one count moves all bins by minus one.
        common = a * sums.real + b * sums.imag + c * bins
        shared = a * dark_real + b * dark_imaginary + c * dark_bins
        of_median = np.pi * level / (2 * bins) + 1 / 12
        variance = (
            independent + common**2 * of_median - 2 * common * shared * level / bins
        )
        # Light in a single bin has no spread, and rounding can fall below that.
        variances.append(np.maximum(variance, 0))
    return ratio, variances[0], variances[1]
