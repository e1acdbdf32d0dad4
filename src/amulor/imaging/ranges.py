"""Slant ranges of one channel, before late-light correction and calibration errors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import UNUSABLE, QualityFlag
from amulor.cube.schema import PHASE_PREFIX, SHARED_TERMS, SIGNAL_TERMS
from amulor.imaging.observation import Observation
from amulor.optics import ambiguity

Floats = NDArray[np.float64]

#: A range may lie this many standard errors outside the interval: it was measured.
_SLACK = 2.0


@dataclass(frozen=True, kw_only=True)
class RangesFit:
    """Scan-wide statistics for the estimate of slant ranges."""

    weight: Floats
    """Weights of the frequencies for a typical pixel, normalized to a sum of 1 [1]."""
    has_rest: bool = False
    """Whether the range error exceeds the sum of the stored error terms."""


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Slant ranges and their errors, arrays over (row, column)."""

    slant_range: Floats
    """Distance from the emitter along the beam [m]."""
    path: Floats
    """Round-trip optical path [m]."""
    slope: Floats
    """Derivative of the slant range with respect to the optical path [1]."""
    flag: NDArray[np.int16]
    """Quality flags."""
    weight: Floats
    """Weights of the frequencies, with a sum of 1, shape (frequencies,) [1]."""
    total: Floats
    """Combined standard uncertainty of the slant range [m]."""
    terms: dict[str, Floats]
    """Standard uncertainty of the slant range by error term [m]."""
    common: Floats | None
    """Part of the uncertainty shared by pixels; None if unknown [m]."""
    others: dict[str, Floats] = field(default_factory=dict)
    """Additional variables of the image, NaN without a range."""
    tests: dict[str, Floats] = field(default_factory=dict)
    """Test statistics behind the flags."""

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Mask of pixels with a range."""
        return np.asarray((self.flag & UNUSABLE) == 0)


def ranges_of_path(
    observation: Observation, path: ambiguity.Path, *, fit: RangesFit | None = None
) -> tuple[Ranges, RangesFit]:
    """Slant ranges from optical paths, with errors, and the statistics used."""
    frequency, channel = observation.frequency, observation.channel
    slant_range, slope = observation.geometry.slant_range_and_slope(path.length)
    settled = path.settled & np.isfinite(slant_range) & np.isfinite(slope)
    flag = _with_unsettled(observation, settled)
    moved = _moved(observation, path)
    flag[np.isfinite(moved)] |= QualityFlag.MOVED
    usable = (flag & UNUSABLE) == 0
    per_phase = path.weight * observation.path_per_phase
    variance = path.uncertainty**2
    together = None
    shared = observation.shared_sigma(usable)
    if shared is not None:
        # Errors that pixels share may be shared by the frequencies as well: a wrong
        # depolarization ratio is. Added as such, they make an upper limit. References
        # are measured anew at each frequency.
        apart = np.sum((per_phase * shared) ** 2, axis=0)
        together = apart
        if channel.attrs.get("frequencies_share_errors", 1):
            together = np.sum(per_phase * shared, axis=0) ** 2
        variance = variance - apart + together
    total = slope * np.sqrt(variance)
    further = {}
    if "residual_in_phase" in channel:
        further["slant_range_bias"] = slope * np.sum(
            per_phase * observation.shift, axis=0
        )
    tests = {}
    if frequency.size > 1:
        further["slant_range_wrong_interval"] = path.wrong
        tests = _tests_of(flag, path)
        if observation.lag is not None:
            tests["moved_probability"] = moved
    terms, unassigned = _terms(
        channel, per_phase, total, None if together is None else slope**2 * together
    )
    if fit is None:
        fit = RangesFit(
            weight=weight_of(frequency, observation.sigma, usable),
            has_rest=unassigned is not None and bool(np.any(unassigned > 0)),
        )
    if unassigned is not None and fit.has_rest:
        terms["signal"] = np.sqrt(unassigned)
    ranges = Ranges(
        slant_range=slant_range,
        path=path.length,
        slope=slope,
        flag=flag,
        weight=fit.weight,
        total=total,
        terms=terms,
        common=None if together is None else slope * np.sqrt(together),
        others=further,
        tests=tests,
    )
    return ranges, fit


def ranges_of_joint(
    observation: Observation,
    *,
    interval: tuple[float, float] | None,
    fit: RangesFit | None = None,
) -> tuple[Ranges, RangesFit]:
    """Slant ranges from a joint estimation, and the statistics used."""
    estimate = {
        name: observation.channel[f"joint_{name}"].values
        for name in (
            "slant_range",
            "slant_range_uncertainty",
            "slant_range_common_uncertainty",
            "slant_range_bound",
            "wrong_interval_probability",
        )
    }
    distance, total = estimate["slant_range"], estimate["slant_range_uncertainty"]
    common = estimate["slant_range_common_uncertainty"]
    settled = np.isfinite(distance) & np.isfinite(total)
    if interval is not None:
        with np.errstate(invalid="ignore"):
            settled &= distance >= interval[0] - _SLACK * total
            settled &= distance <= interval[1] + _SLACK * total
    flag = _with_unsettled(observation, settled)
    geometry = observation.geometry
    path = geometry.optical_path(
        np.where(np.isfinite(distance), distance, geometry.beam.length_before + 1.0)
    )
    _, slope = geometry.slant_range_and_slope(path)
    with np.errstate(invalid="ignore"):
        noise = np.sqrt(np.maximum(total**2 - common**2, 0.0))
    if fit is None:
        usable = (flag & UNUSABLE) == 0
        fit = RangesFit(
            weight=weight_of(observation.frequency, observation.sigma, usable)
        )
    tests = {
        "ambiguous_interval_probability": np.where(
            (flag & QualityFlag.AMBIGUOUS) != 0,
            estimate["wrong_interval_probability"],
            np.nan,
        )
    }
    if observation.lag is not None:
        moved = (flag & QualityFlag.MOVED) != 0
        chance = observation.channel["joint_misfit_probability"].values
        # Outlying readings are at most that probable.
        chance = np.minimum(chance, ambiguity.DISAGREEMENT)
        tests["moved_probability"] = np.where(moved, chance, np.nan)
    ranges = Ranges(
        slant_range=distance,
        path=path,
        slope=slope,
        flag=flag,
        weight=fit.weight,
        total=total,
        terms={"signal": noise, "water_model": common},
        common=common,
        others={
            "slant_range_wrong_interval": estimate["wrong_interval_probability"],
            "slant_range_bound": estimate["slant_range_bound"],
        },
        tests=tests,
    )
    return ranges, fit


def _with_unsettled(
    observation: Observation, settled: NDArray[np.bool_]
) -> NDArray[np.int16]:
    """Quality flags, with `AMBIGUOUS` added for pixels without a unique range."""
    flag = observation.flag.copy()
    flag[observation.usable & ~settled] |= QualityFlag.AMBIGUOUS
    return flag


def _moved(observation: Observation, path: ambiguity.Path) -> Floats:
    """P-values of readings from a vehicle that contradict each other, else NaN."""
    from scipy.special import chdtrc

    if observation.lag is None:
        return np.full(path.length.shape, np.nan)
    freedom = (~path.left_out).sum(axis=0) - 1
    probability = np.where(
        freedom > 0, chdtrc(np.maximum(freedom, 1), path.strain), 1.0
    )
    # Readings are left out because they contradict the others, or meet no target.
    contradict = path.left_out.any(axis=0)
    probability = np.where(
        contradict, np.minimum(probability, ambiguity.DISAGREEMENT), probability
    )
    moved = observation.usable & (probability <= ambiguity.DISAGREEMENT)
    return np.where(moved, probability, np.nan)


def _tests_of(flag: NDArray[np.int16], path: ambiguity.Path) -> dict[str, Floats]:
    """Test statistics of the ambiguity resolution, for ambiguous pixels."""
    from scipy.special import chdtrc

    ambiguous = (flag & QualityFlag.AMBIGUOUS) != 0
    freedom = (~path.left_out).sum(axis=0) - 1
    misfit = chdtrc(np.maximum(freedom, 1), path.strain)
    return {
        "ambiguous_interval_probability": np.where(ambiguous, path.wrong, np.nan),
        "ambiguous_misfit_probability": np.where(
            ambiguous & (freedom > 0), misfit, np.nan
        ),
    }


def weight_of(frequency: Floats, sigma: Floats, usable: NDArray[np.bool_]) -> Floats:
    """Weights of the frequencies for a typical pixel, normalized to a sum of 1 [1]."""
    if not usable.any():
        return np.full(frequency.size, 1 / frequency.size)
    error = np.maximum(np.median(sigma[:, usable], axis=1), 1e-9)
    precision = (frequency / error) ** 2
    return np.asarray(precision / precision.sum())


def _terms(
    channel: xr.Dataset, per_phase: Floats, total: Floats, together: Floats | None
) -> tuple[dict[str, Floats], Floats | None]:
    """Error terms scaled to a total; return also the variance without a term.

    Terms that pixels and perhaps frequencies share divide what is `together`. Variance
    that no term explains comes second [m^2]; None where no term is stored.
    """
    variances: dict[str, Floats] = {}
    for name in SIGNAL_TERMS:
        if f"{PHASE_PREFIX}{name}" in channel:
            phase = channel[f"{PHASE_PREFIX}{name}"].values
            variances[name] = np.sum((per_phase * phase) ** 2, axis=0)
    if not variances:
        return {"signal": total}, None
    groups = [list(variances)]
    amounts = [total**2]
    if together is not None:
        shared = [name for name in variances if name in SHARED_TERMS]
        groups = [[name for name in variances if name not in shared], shared]
        amounts = [np.maximum(total**2 - together, 0.0), together]
    terms: dict[str, Floats] = {}
    unassigned = np.zeros(total.shape)
    for names, amount in zip(groups, amounts, strict=True):
        group_sum = np.sum([variances[name] for name in names], axis=0, initial=0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(group_sum > 0, amount / group_sum, 0.0)
        unassigned += np.where(group_sum > 0, 0.0, amount)
        terms |= {name: np.sqrt(variances[name] * scale) for name in names}
    return {name: terms[name] for name in variances}, unassigned
