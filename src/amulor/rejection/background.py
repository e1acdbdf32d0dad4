"""Background method: pixels without a target are the reference of the others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.special import gammainccinv

from amulor import cube as cubes
from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.rejection.methods import Needs, method
from amulor.rejection.observation import Observation
from amulor.rejection.open_water import OpenWaterFit, subtract
from amulor.rejection.reference.attach import pixels_as_shots
from amulor.rejection.smooth_water import Field

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

#: Width of the windows from which a search starts [pixels].
_WINDOW = 4
#: Most windows along rows and along columns.
_STARTS = 6
#: Deviation of a pixel without weight, step by step, in standard errors [1].
_LIMITS = (12.0, 8.0, 6.0, 4.0, 3.0, 3.0, 3.0, 3.0)
#: Probability of a larger deviation of a pixel of the background [1].
_RARE = 1e-3
#: Least share and number of pixels of the background.
_LEAST_SHARE, _FEWEST = 0.1, 20
#: Fewest pixels with a target, from which the test of the background follows.
_FEWEST_ECHOES = 5
#: Least coherence of the frequencies of an echo in the median [1].
_COHERENT = 0.95
#: Deviation from which a sample takes part in this test, in standard errors [1].
_SIGNIFICANT = 4.0
#: Most echoes of this test.
_MOST_ECHOES = 400
#: Step of the paths that are tried, as phase of the highest frequency [rad].
_STEP = 0.1
#: Largest fluctuation of a background: factor on the smallest of all candidates, and a
#: fluctuation that is small anyway [1].
_MORE, _STEADY = 2.0, 0.01
#: Fluctuation from which on a set of pixels is no smooth signal [1].
_UNSTEADY = 0.4
#: Expected sizes of the terms of the logarithm of a water signal [1].
_EXPECTED = np.array([10.0, 2.0, 2.0, 1.0, 1.0, 1.0])
#: Largest logarithm of a signal in standard errors [1].
_LARGEST = 30.0


@dataclass(frozen=True, kw_only=True)
class Background:
    """Pixels in which one smooth signal explains all samples."""

    pixels: Mask
    """Mask of the pixels, over (pixel)."""
    fluctuation: float
    """Median of the relative scatter beyond the stated errors [1]."""
    rest: Complex
    """Samples less the smooth signal, over (sample, pixel), in stated errors [1]."""
    significance: Floats
    """Modulus of the rest in standard errors, over (sample, pixel) [1]."""


@dataclass(frozen=True, kw_only=True)
class BackgroundFit:
    """Scan-wide parameters of the background method."""

    shots: xr.Dataset
    """Pixels of the background, as open-water shots."""
    open_water: OpenWaterFit
    """Scan-wide parameters of the open-water method with these shots."""


def _subtract(
    cube: xr.Dataset,
    *,
    fit: BackgroundFit | None = None,
    span: tiles.Span | None = None,
    interval: tuple[float, float] | None = None,
    **options: Any,
) -> tuple[xr.Dataset, BackgroundFit]:
    """Subtract the background of a scan, or with `fit` from rows; return the fit."""
    bare = cubes.without_groups(cubes.checked(cube, "samples"), "open_water")
    if fit is None:
        pixels = find_background(Observation(cube=bare), interval)
        shots = pixels_as_shots(bare, pixels)
    else:
        shots = fit.shots
    result, of_open_water = subtract(
        cubes.attach(bare, shots, "open_water"),
        fit=None if fit is None else fit.open_water,
        span=span,
        interval=interval,
        **options,
    )
    result = result.assign_attrs(background_pixels=np.int32(shots.sizes["shot"]))
    return cubes.note(result, "reference from pixels without a target"), BackgroundFit(
        shots=shots, open_water=of_open_water
    )


@method(
    "background",
    needs=Needs(open_water=False),
    simplicity=2,
    fitter=partial(tiles.fit_on_sample, _subtract),
)
def background(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    column_uncertainty: float | None = None,
    put_back: bool = True,
) -> xr.Dataset:
    r"""Subtract the water signal that pixels without a target show.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with two or more modulation frequencies. In at least a tenth of
        the pixels the beam must meet no target. These pixels must surround the others.
        Open-water shots are ignored.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].
    column_uncertainty : float, optional
        As in `amulor.rejection.open_water` [1].
    put_back : bool
        As in `amulor.rejection.open_water`.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`, with the variables, attributes and flags of
        `amulor.rejection.open_water`. `background_pixels` is the number of pixels that
        are the reference. They have the flag `NO_TARGET`.

    Raises
    ------
    CubeError
        If the cube has one modulation frequency, if no smooth signal explains a tenth
        of the pixels, if all pixels agree with it, if differences from it are no
        echoes, or if its pixels do not surround the others.
    ValueError
        As from `amulor.rejection.open_water`.

    Notes
    -----
    The exponential of a quadratic function of the direction is fitted to the samples of
    each frequency and channel. The fit is iteratively reweighted least squares, from
    starts all over the scan. Pixels with a target are outliers and lose their weight,
    as in the estimate of fog of a camera [1]_.

    A set of pixels passes if the differences of the other pixels from it are echoes,
    with a phase in proportion to the frequency. Differences from a surface are not:
    they have the phase of the water less that of the surface. Of the sets that pass,
    the largest counts that does not fluctuate more than others. The open-water method
    takes the pixels of this set as its shots, with their errors. Its flags also hold:
    a background that no water of the survey explains flags all pixels.

    References
    ----------
    .. [1] Y. Fujimura, M. Sonogashira and M. Iiyama, "Defogging Kinect: simultaneous
       estimation of object region and depth in foggy scenes" (2019),
       `arXiv:1904.00558 <https://arxiv.org/abs/1904.00558>`_.

    Examples
    --------
    A small plate in turbid water, without shots:

    >>> import numpy as np
    >>> import amulor
    >>> from amulor import cube as cubes, rejection
    >>> survey = amulor.Survey.preset("amulor-2010").with_(
    ...     {
    ...         "water.scattering": "1 1/m",
    ...         "instrument.modulation_frequencies": ["20 MHz", "80 MHz", "140 MHz"],
    ...         "scan.rows": 16,
    ...         "scan.columns": 24,
    ...         "scan.azimuth_span": "10 deg",
    ...         "scan.elevation_span": "6 deg",
    ...     }
    ... )
    >>> scan = cubes.without_groups(amulor.simulate(survey, rng=1), "open_water")
    >>> target = rejection.background(scan, interval=(0.5, 2.5))
    >>> print(f"{target.attrs['background_pixels'] / scan['azimuth'].size:.2f}")
    0.90
    """
    return _subtract(
        cube,
        interval=interval,
        column_uncertainty=column_uncertainty,
        put_back=put_back,
    )[0]


def find_background(scan: Observation, interval: tuple[float, float] | None) -> Mask:
    """Return the pixels without a target, over (row, column); CubeError if none."""
    if np.unique(scan.frequency).size < 2:
        raise CubeError(
            "the cube has one modulation frequency, at which a background of water and "
            "one of a surface look alike; the method background needs two or more"
        )
    shape = scan.signal.shape[2:]
    usable = scan.usable.all(axis=(0, 1)).ravel()
    needed = max(_FEWEST, int(np.ceil(_LEAST_SHARE * usable.sum())))
    flat = np.flatnonzero(usable)
    found = [
        candidate
        for candidate in _candidates(scan, flat)
        if candidate.pixels.sum() >= needed and candidate.fluctuation < _UNSTEADY
    ]
    if not found:
        raise CubeError(
            f"no smooth water signal explains {needed} of {flat.size} pixels; the "
            "background of a scan needs pixels that meet no target: record open water"
        )
    paths = _paths(scan, interval)
    reasons = [_objection(candidate, scan, paths) for candidate in found]
    passed = [c for c, reason in zip(found, reasons, strict=True) if not reason]
    if not passed:
        largest = max(range(len(found)), key=lambda k: found[k].pixels.sum())
        raise CubeError(f"{reasons[largest]}; record open water, or use another method")
    # A fit across the edge of a target passes for a water that fluctuates more.
    steady = _MORE * min(c.fluctuation for c in passed) + _STEADY
    chosen = max(
        (c for c in passed if c.fluctuation <= steady), key=lambda c: c.pixels.sum()
    )
    mask = np.zeros(usable.size, dtype=bool)
    mask[flat[chosen.pixels]] = True
    return mask.reshape(shape)


def _candidates(scan: Observation, flat: NDArray[np.intp]) -> list[Background]:
    """Fit smooth signals to the usable pixels, from windows all over the scan."""
    rows, columns = scan.signal.shape[2:]
    samples = scan.signal.reshape(-1, rows * columns)[:, flat]
    errors = scan.covariance
    sigma = np.sqrt(
        np.median(
            ((errors.in_phase + errors.quadrature) / 2).reshape(len(samples), -1)[
                :, flat
            ],
            axis=1,
        )
    )
    field = Field.of(scan.azimuth, scan.elevation)
    design = field.terms(scan.azimuth.ravel()[flat], scan.elevation.ravel()[flat])
    row, column = np.divmod(flat, columns)
    found: list[Background] = []
    for top in _starts(rows):
        for left in _starts(columns):
            window = (row >= top) & (row < top + _WINDOW)
            window &= (column >= left) & (column < left + _WINDOW)
            if window.sum() < _WINDOW**2 // 2:
                continue
            if any(other.pixels[window].mean() > 0.9 for other in found):
                continue
            found.append(_fit(samples / sigma[:, None], design, window))
    return found


def _starts(size: int) -> NDArray[np.intp]:
    """Return the first rows or columns of the windows."""
    count = min(_STARTS, max(size // _WINDOW, 1))
    return np.linspace(0, max(size - _WINDOW, 0), count).astype(np.intp)


def _fit(samples: Complex, design: Floats, window: Mask) -> Background:
    """Fit a smooth signal by reweighting; the samples are in standard errors."""
    middle = np.mean(samples[:, window], axis=1)
    terms = np.zeros((len(samples), design.shape[1]), dtype=complex)
    terms[:, 0] = np.log(np.where(middle == 0, 1.0, middle))
    weight = window.astype(float)
    count = 2 * len(samples)
    for limit in (np.inf, *_LIMITS):
        water = _signal(terms, design)
        rest = samples - water
        power = np.abs(water) ** 2
        total = (weight * power).sum(axis=1)
        excess = (weight * (np.abs(rest) ** 2 / 2 - 1)).sum(axis=1)
        fluctuation = np.maximum(excess / np.maximum(total, 1.0), 0.0)
        variance = 1 + fluctuation[:, None] * power
        square = (np.abs(rest) ** 2 / variance).sum(axis=0) / count
        if np.isfinite(limit):
            weight = np.clip(1 - square / limit**2, 0, 1) ** 2
        gain = weight * power / variance
        normal = np.einsum("kp,pi,pj->kij", gain, design, design, optimize=True)
        normal += np.diag(_EXPECTED**-2)
        slope = (weight * water.conj() * rest / variance) @ design
        slope -= terms * np.append(0.0, _EXPECTED[1:] ** -2)
        terms = terms + np.linalg.solve(normal, slope[..., None])[..., 0]
    rest = samples - _signal(terms, design)
    square = (np.abs(rest) ** 2 / variance).sum(axis=0) / count
    return Background(
        pixels=square < 2 * gammainccinv(count / 2, _RARE) / count,
        fluctuation=float(np.sqrt(np.median(fluctuation))),
        rest=rest,
        significance=np.abs(rest) / np.sqrt(variance),
    )


def _signal(terms: Complex, design: Floats) -> Complex:
    """Return the exponential function of polynomials, over (sample, pixel)."""
    exponent = terms @ design.T
    return np.exp(np.clip(exponent.real, -_LARGEST, _LARGEST) + 1j * exponent.imag)


def _paths(scan: Observation, interval: tuple[float, float] | None) -> Floats:
    """Return the geometric paths at which the echo may be [m]."""
    geometry = scan.cube["geometry"].attrs
    wave = _wavenumber(scan)
    if interval is None:
        steps = np.diff(np.concatenate([[0.0], np.sort(wave)]))
        low, high = 0.0, float(2 * np.pi / steps[steps > 0].min())
    else:
        aside = np.subtract(geometry["receiver_position"], geometry["emitter_position"])
        low, high = 2 * interval[0], 2 * interval[1] + float(np.linalg.norm(aside))
    return np.arange(low, high, _STEP / wave.max())


def _wavenumber(scan: Observation) -> Floats:
    """Return the wavenumbers of the modulation in water [rad/m]."""
    index = float(scan.cube["geometry"].attrs["group_index"])
    return np.asarray(2 * np.pi * scan.frequency * index / speed_of_light)


def _objection(candidate: Background, scan: Observation, paths: Floats) -> str:
    """Return why a set of pixels is no background of water; empty if it is one."""
    strong = candidate.significance > _SIGNIFICANT
    channels = len(scan.polarizations)
    # An echo of one frequency has a phase that fits any distance.
    of_frequency = strong.reshape(-1, channels, strong.shape[1]).any(axis=1)
    (echoes,) = np.nonzero(of_frequency.sum(axis=0) >= 2)
    if echoes.size < _FEWEST_ECHOES:
        return (
            "nearly all pixels agree with one smooth signal: there is no target, or a "
            "surface without an edge"
        )
    echoes = echoes[:: -(-echoes.size // _MOST_ECHOES)]
    part = np.where(strong, candidate.rest, 0.0)[:, echoes]
    phasor = part / np.maximum(np.abs(part), np.finfo(float).tiny)
    wave = np.repeat(_wavenumber(scan), channels)
    turned = np.exp(-1j * np.outer(paths, wave))
    best = (turned @ phasor).real.max(axis=0) / strong[:, echoes].sum(axis=0)
    coherence = float(np.median(best))
    if coherence < _COHERENT:
        return (
            "differences of the other pixels from the smooth part of the scan are no "
            f"echoes (coherence {coherence:.2f}, needed is {_COHERENT:g}), so this "
            "part is no open water"
        )
    return ""
