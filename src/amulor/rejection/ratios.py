"""Depolarization ratios of water and targets, estimated from the measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.rejection.channels import pair_of
from amulor.rejection.observation import Observation
from amulor.rejection.open_water import open_water
from amulor.rejection.reference.shots import with_measured_noise
from amulor.rejection.reference.surface import FEWEST_SHOTS
from amulor.survey.properties import TYPICAL_CHANNEL_GAIN, TYPICAL_CROSSTALK

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Ratio:
    """Depolarization ratio: cross-polarized over co-polarized signal.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> ratio = rejection.water_ratio(samples.cube("ladder"))
    >>> print(f"{ratio.value:.3f} from {ratio.source}")
    0.099 from 540 open-water shots
    """

    value: float
    """Value of the ratio [1]."""
    uncertainty: float
    """Standard uncertainty; for targets, the spread over the scan included [1]."""
    source: str
    """Measurements from which the ratio was estimated."""
    across: Floats | None = None
    """Ratio of the cross-polarized signal in quadrature to the co-polarized one, at
    each frequency; 0 where noise explains it, None if not estimated [1]."""


def possible(ratio: Ratio, *, name: str) -> float:
    """Clip a ratio to the interval from 0 to 1; CubeError if significantly outside."""
    nearest = min(max(ratio.value, 0.0), 1.0)
    # An estimate that is not a number is not possible either.
    if not abs(ratio.value - nearest) <= _BY_CHANCE * ratio.uncertainty:
        raise CubeError(
            f"{name} must lie between 0 and 1, but {ratio.source} give "
            f"{ratio.value:.4g} +- {ratio.uncertainty:.2g}, more than "
            f"{_BY_CHANCE:g} standard uncertainties beyond; look whether the channels "
            f"have the right names and gains, or state {name} (command line: "
            f"--{name.replace('_', '-')})"
        )
    return nearest


def stated_uncertainty(cube: xr.Dataset, ratio: float, uncertainty: float) -> float:
    """Return the uncertainty of a stated ratio, with cross-talk and gain of channels.

    Estimated ratios contain both. A survey that states its phase uncertainty, and no
    calibration of the channels, has perfect ones.
    """
    survey = cube.amulor.survey
    crosstalk, gain = 0.0, 0.0
    if "channel_crosstalk_uncertainty" in cube.attrs:
        crosstalk = float(cube.attrs["channel_crosstalk_uncertainty"])
        gain = float(np.max(cube.attrs["channel_gain_uncertainty"]))
    elif survey is not None and survey.instrument.phase_uncertainty is None:
        crosstalk, gain = TYPICAL_CROSSTALK, TYPICAL_CHANNEL_GAIN
    # (r + x) / (1 + y r) to first order in the cross-talk of both channels.
    of_crosstalk = crosstalk * np.hypot(1, ratio**2)
    return float(np.linalg.norm([uncertainty, of_crosstalk, ratio * gain]))


#: Standard uncertainties by which noise may carry a ratio beyond 0 or 1 [1].
_BY_CHANCE = 4.0


def water_ratio(cube: xr.Dataset, *, water_only: ArrayLike | None = None) -> Ratio:
    r"""Estimate the depolarization ratio of the water.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with a co-polarized channel and its partner.
    water_only : array_like of bool, shape (row, column), optional
        Pixels in which the beam meets no target. The open-water shots are used by
        default.

    Returns
    -------
    Ratio
        Ratio for all frequencies.

    Raises
    ------
    CubeError
        If there are neither shots nor pixels of water alone, or too few.

    Notes
    -----
    At each frequency the cross-polarized signal is fitted to the mean co-polarized
    signal by least squares. The ratio is the mean over frequencies, weighted by the
    scatter of the samples. This scatter includes the noise of the instrument and the
    fluctuation of the water in both channels.

    Examples
    --------
    The water was made with m22 = 0.82, and (1 - 0.82) / (1 + 0.82) = 0.099:

    >>> from amulor import rejection, samples
    >>> ratio = rejection.water_ratio(samples.cube("ladder"))
    >>> print(f"{ratio.value:.4f} ± {ratio.uncertainty:.4f}, true {0.18 / 1.82:.4f}")
    0.0992 ± 0.0009, true 0.0989
    """
    scan, _ = with_measured_noise(Observation(cube=cubes.checked(cube, "samples")))
    cube = scan.cube
    co, cross = pair_of(cube)
    if water_only is not None:
        mask = np.asarray(water_only, dtype=bool)
        if mask.shape != cube["azimuth"].shape:
            raise CubeError(
                f"water_only has the shape {mask.shape}, the scan "
                f"{cube['azimuth'].shape}; they must agree"
            )
        signal = scan.signal[..., mask]
        source = f"{int(mask.sum())} pixels of water alone"
        needed = "pixels of water alone"
    else:
        if scan.shots is None:
            raise CubeError(
                "nothing tells the depolarization ratio of the water: the cube has no "
                "open-water shots; name pixels without a target (water_only), or state "
                "water_ratio (command line: --water-ratio)"
            )
        signal = scan.shots.signal
        source = f"{signal.shape[-1]} open-water shots"
        needed = "open-water shots"
    order = cube.amulor.polarizations
    first, second = signal[:, order.index(co)], signal[:, order.index(cross)]
    both = np.isfinite(first) & np.isfinite(second)
    if both.sum(axis=1).min() < FEWEST_SHOTS:
        raise CubeError(
            f"the depolarization ratio of the water needs {FEWEST_SHOTS} {needed} with "
            f"numbers in {co} and {cross}, found {int(both.sum(axis=1).min())}; record "
            "more"
        )
    empty = ~np.any(np.where(both, first, 0), axis=1)
    if empty.any():
        raise CubeError(
            f"the water in {co} is 0 V in all {needed} at "
            f"{scan.frequency[empty][0] / 1e6:g} MHz, below the resolution of the "
            "demodulator; choose a more sensitive range, or state water_ratio (command "
            "line: --water-ratio)"
        )
    values, errors, across = np.transpose(
        [_line(a[use], b[use]) for a, b, use in zip(first, second, both, strict=True)]
    )
    return Ratio(*_weighted_mean(values, errors), source, across)


def target_ratio(
    cube: xr.Dataset, *, interval: tuple[float, float] | None = None
) -> Ratio:
    r"""Estimate the depolarization ratio of the targets.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with a co-polarized channel, its partner and open-water shots.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Ratio
        Ratio for all pixels. If pixels differ by more than their errors, the
        uncertainty includes their differences. It also includes a phase between the
        channels.

    Raises
    ------
    CubeError
        If there are no open-water shots, or no pixel shows a target in both channels.

    Notes
    -----
    Open water is subtracted in each channel. With the remaining signals,
    :math:`r = \sum w\, \mathrm{Re}(T_a^* T_b) / \sum w (|T_a|^2 - \sigma_a^2)`:
    subtracting the variance removes the bias by noise in the denominator. The error of
    the reference, which all pixels share, is propagated with unknown sign.

    Examples
    --------
    The ladder was made with m22 = 0.61, and (1 - 0.61) / (1 + 0.61) = 0.242:

    >>> from amulor import rejection, samples
    >>> cube = samples.cube("ladder").isel(row=[18], shot=slice(0, None, 4))
    >>> ratio = rejection.target_ratio(cube)
    >>> print(f"{ratio.value:.3f} ± {ratio.uncertainty:.3f}, true {0.39 / 1.61:.3f}")
    0.242 ± 0.001, true 0.242
    """
    cube = cubes.checked(cube, "samples")
    pair_of(cube)
    return ratio_of(open_water(cube, interval=interval))


def ratio_of(target: xr.Dataset) -> Ratio:
    """Estimate the targets' depolarization ratio after open-water subtraction."""
    co, cross = pair_of(target)
    pair = first, second = [
        Observation(cube=target.sel(polarization=name)) for name in (co, cross)
    ]
    flags = first.cube["quality_flag"].values | second.cube["quality_flag"].values
    usable = (flags & cubes.UNUSABLE) == 0
    if usable.sum() < FEWEST_SHOTS:
        raise CubeError(
            f"{int(usable.sum())} samples show a target in both {co} and {cross} after "
            f"open-water subtraction, needed are {FEWEST_SHOTS} to estimate its "
            "depolarization ratio; state target_ratio (command line: --target-ratio)"
        )
    a, b = (part.signal[usable] for part in pair)
    noise = [_mean_variance(part, usable) for part in pair]
    value = 0.0
    for _ in range(3):
        weight = 1 / np.maximum(noise[1] + value**2 * noise[0], np.finfo(float).tiny)
        bottom = float(np.sum(weight * (np.abs(a) ** 2 - 2 * noise[0])))
        value = float(np.sum(weight * (a.conj() * b).real)) / bottom
    # Target and channels have one phase: a part across it is leakage, or a channel of
    # another gain, which may be as large along it.
    across = weight * (a.conj() * b).imag
    askew = abs(float(np.sum(across))) / bottom
    deviation = (a.conj() * (b - value * a)).real
    random = np.sqrt(float(np.sum((weight * deviation) ** 2))) / bottom
    relative = deviation / np.abs(a) ** 2
    expected = (noise[1] + value**2 * noise[0]) / np.abs(a) ** 2
    strength = weight * np.abs(a) ** 2 / np.sum(weight * np.abs(a) ** 2)
    spread = np.sqrt(max(float(np.sum(strength * (relative**2 - expected))), 0.0))
    # Noise causes a spread, too; only the excess is due to the targets.
    chance = float(np.sum(strength**2 * 2 * expected**2)) ** 0.25
    spread = spread if spread > 2 * chance else 0.0
    shared = [np.sqrt(_common_variance(part, usable) / np.abs(a) ** 2) for part in pair]
    common = np.hypot(
        float(np.sum(strength * shared[1])), value * float(np.sum(strength * shared[0]))
    )
    askew = askew if askew > _BY_CHANCE * np.hypot(random, common) else 0.0
    place = np.nonzero(usable)[0]

    def by_frequency(values: Floats) -> Floats:
        total = np.zeros(len(usable))
        np.add.at(total, place, values)
        return total

    bottoms = by_frequency(weight * (np.abs(a) ** 2 - 2 * noise[0]))
    bottoms = np.where(bottoms > 0, bottoms, np.inf)
    chances = np.sqrt(by_frequency((weight * (a.conj() * b).imag) ** 2)) / bottoms
    parts = by_frequency(across) / bottoms
    chances = np.hypot(chances, common)
    count = int(usable.any(axis=0).sum())
    return Ratio(
        value,
        float(np.sqrt(random**2 + spread**2 + common**2 + askew**2)),
        f"{count} pixels that show a target",
        np.where(np.abs(parts) > _BY_CHANCE * chances, parts, 0.0),
    )


def _line(first: Complex, second: Complex) -> tuple[float, float, float]:
    """Fit a channel to another: slope, its standard error, and part in quadrature."""
    mean = first.mean()
    turn = mean / abs(mean)
    a, b = (first / turn).real, (second / turn).real
    value = b.mean() / a.mean()
    # Both channels follow the directions alike, so their difference does not.
    rest = b - value * a
    random = float(rest.std(ddof=1) / np.sqrt(len(rest)) / abs(mean))
    # Only leakage is in quadrature to the water; see `ratio_of`.
    askew = float((second / turn).imag.mean()) / abs(mean)
    askew = askew if abs(askew) > _BY_CHANCE * random else 0.0
    return float(value), float(np.hypot(random, askew)), askew


def _weighted_mean(values: Floats, errors: Floats) -> tuple[float, float]:
    """Return the weighted mean, and its uncertainty, enlarged for discordant values."""
    if not np.all(errors > 0):
        return float(values.mean()), float(errors.max())
    weight = errors**-2.0
    mean = float(np.sum(weight * values) / weight.sum())
    scatter = float(np.sum(weight * (values - mean) ** 2)) / max(len(values) - 1, 1)
    return mean, float(np.sqrt(max(scatter, 1.0) / weight.sum()))


def _mean_variance(part: Observation, usable: NDArray[np.bool_]) -> Floats:
    """Return the mean variance of both lock-in outputs, without common errors."""
    covariance = part.covariance
    mean = (covariance.in_phase + covariance.quadrature)[usable] / 2
    noise: Floats = np.maximum(mean - _common_variance(part, usable), 0.0)
    return noise


def _common_variance(part: Observation, usable: NDArray[np.bool_]) -> Floats:
    common = part.common_covariance
    assert common is not None
    mean: Floats = (common.in_phase + common.quadrature)[usable] / 2
    return mean
