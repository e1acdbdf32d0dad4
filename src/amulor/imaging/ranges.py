"""Slant ranges of one channel before delay, geometry and late light are counted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import UNUSABLE, QualityFlag
from amulor.cube.error import JOINT_OUTLIERS, flags_of_pixels
from amulor.cube.schema import PHASE_PREFIX, SHARED_TERMS, SIGNAL_TERMS
from amulor.imaging.geometry import beams_of, medium_of, receivers_of
from amulor.optics import ambiguity, detection, ranging, rays

Floats = NDArray[np.float64]

#: Step of the optical path for the derivative of the slant range [m].
_DIFFERENCE = 1e-5
#: A range may lie this many standard errors outside the interval: it was measured.
_SLACK = 2.0


@dataclass(frozen=True, kw_only=True)
class RangesFit:
    """Statistics of a scan that its ranges need."""

    weight: Floats
    """Weight of each frequency in the ranges of most pixels, 1 in all [1]."""
    has_rest: bool = False
    """Whether some error belongs to none of the terms that are stored."""


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Slant ranges and their errors, arrays over (row, column)."""

    slant_range: Floats
    """Distance from the emitter along the beam [m]."""
    path: Floats
    """Two-way optical path [m]."""
    slope: Floats
    """Derivative of the slant range by the path [1]."""
    flag: NDArray[np.int16]
    """Quality flags."""
    weight: Floats
    """Weight of each frequency, shape (frequencies,), 1 in all [1]."""
    total: Floats
    """Combined standard uncertainty of the slant range [m]."""
    terms: dict[str, Floats]
    """Standard uncertainty of the slant range by its terms [m]."""
    common: Floats | None
    """Part of all of these that the pixels share; None if not known [m]."""
    others: dict[str, Floats] = field(default_factory=dict)
    """Further variables of the image."""

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Where there is a range."""
        return np.asarray((self.flag & UNUSABLE) == 0)


def ranges_of_path(
    one: xr.Dataset, path: ambiguity.Path, *, fit: RangesFit | None = None
) -> tuple[Ranges, RangesFit]:
    """Ranges that belong to optical paths, their errors, and the statistics used."""
    frequency = one["modulation_frequency"].values
    flag, sigma, shift = phase_errors(one)
    usable = (flag & UNUSABLE) == 0
    # The optical path, out and back, is twice the range at a group index of 1.
    to_path = 2 * ranging.range_per_phase(frequency[:, None, None], group_index=1.0)
    slant_range, slope = _ranges_and_slopes(one, path.length)
    settled = path.settled & np.isfinite(slant_range) & np.isfinite(slope)
    flag[usable & ~settled] |= QualityFlag.AMBIGUOUS
    usable = (flag & UNUSABLE) == 0
    per_phase = path.weight * to_path
    variance = path.uncertainty**2
    together = None
    if "common_covariance" in one:
        shared = _phase_uncertainty(one, one.amulor.signal.values, usable, "common_")
        # Errors that pixels share may be shared by the frequencies as well: a wrong
        # depolarization ratio is. Added as such, they make an upper limit. References
        # are measured anew at each frequency.
        apart = np.sum((per_phase * shared) ** 2, axis=0)
        together = apart
        if one.attrs.get("frequencies_share_errors", 1):
            together = np.sum(per_phase * shared, axis=0) ** 2
        variance = variance - apart + together
    total = slope * np.sqrt(variance)
    others = {}
    if "residual_in_phase" in one:
        others["slant_range_bias"] = slope * np.sum(per_phase * shift, axis=0)
    if frequency.size > 1:
        others["slant_range_wrong_interval"] = path.wrong
    terms, rest = _terms(
        one, per_phase, total, None if together is None else slope**2 * together
    )
    if fit is None:
        fit = RangesFit(
            weight=weight_of(frequency, sigma, usable),
            has_rest=rest is not None and bool(np.any(rest > 0)),
        )
    if rest is not None and fit.has_rest:
        terms["signal"] = np.sqrt(rest)
    ranges = Ranges(
        slant_range=slant_range,
        path=path.length,
        slope=slope,
        flag=flag,
        weight=fit.weight,
        total=total,
        terms=terms,
        common=None if together is None else slope * np.sqrt(together),
        others=others,
    )
    return ranges, fit


def ranges_of_joint(
    one: xr.Dataset,
    *,
    interval: tuple[float, float] | None,
    fit: RangesFit | None = None,
) -> tuple[Ranges, RangesFit]:
    """Ranges that the joint estimation found, and the statistics used."""
    found = {
        name: one[f"joint_{name}"].values
        for name in (
            "slant_range",
            "slant_range_uncertainty",
            "slant_range_common_uncertainty",
            "slant_range_bound",
            "wrong_interval_probability",
        )
    }
    distance, total = found["slant_range"], found["slant_range_uncertainty"]
    common = found["slant_range_common_uncertainty"]
    flag, sigma, _ = phase_errors(one, most_outliers=JOINT_OUTLIERS)
    usable = (flag & UNUSABLE) == 0
    settled = np.isfinite(distance) & np.isfinite(total)
    if interval is not None:
        with np.errstate(invalid="ignore"):
            settled &= distance >= interval[0] - _SLACK * total
            settled &= distance <= interval[1] + _SLACK * total
    flag[usable & ~settled] |= QualityFlag.AMBIGUOUS
    beam = beams_of(one)
    path = rays.optical_path(
        np.where(np.isfinite(distance), distance, beam.length_before + 1.0),
        beam,
        receivers_of(one),
        medium=medium_of(one),
    )
    _, slope = _ranges_and_slopes(one, path)
    with np.errstate(invalid="ignore"):
        own = np.sqrt(np.maximum(total**2 - common**2, 0.0))
    if fit is None:
        frequency = one["modulation_frequency"].values
        fit = RangesFit(weight=weight_of(frequency, sigma, (flag & UNUSABLE) == 0))
    ranges = Ranges(
        slant_range=distance,
        path=path,
        slope=slope,
        flag=flag,
        weight=fit.weight,
        total=total,
        terms={"signal": own, "water_model": common},
        common=common,
        others={
            "slant_range_wrong_interval": found["wrong_interval_probability"],
            "slant_range_bound": found["slant_range_bound"],
        },
    )
    return ranges, fit


def first_ranges(one: xr.Dataset, path: ambiguity.Path) -> Floats:
    """Return the slant ranges of optical paths, not a number where there is none."""
    return rays.slant_range_of_path(
        path.length, beams_of(one), receivers_of(one), medium=medium_of(one)
    )


def _ranges_and_slopes(one: xr.Dataset, path: Floats) -> tuple[Floats, Floats]:
    """Return slant ranges and their derivative by the path."""
    medium, beam, receiver = medium_of(one), beams_of(one), receivers_of(one)

    def to_range(length: Floats) -> Floats:
        return rays.slant_range_of_path(length, beam, receiver, medium=medium)

    slant_range = to_range(path)
    return slant_range, (to_range(path + _DIFFERENCE) - slant_range) / _DIFFERENCE


def weight_of(frequency: Floats, sigma: Floats, usable: NDArray[np.bool_]) -> Floats:
    """Return how much each frequency counts in the ranges of most pixels."""
    if not usable.any():
        return np.full(frequency.size, 1 / frequency.size)
    error = np.maximum(np.median(sigma[:, usable], axis=1), 1e-9)
    precision = (frequency / error) ** 2
    return np.asarray(precision / precision.sum())


def _terms(
    one: xr.Dataset, per_phase: Floats, total: Floats, together: Floats | None
) -> tuple[dict[str, Floats], Floats | None]:
    """Return the terms of a known total, in the proportion of their squares.

    Terms that pixels and perhaps frequencies share divide what is `together`. Variance
    that no term explains comes second [m^2]; None where no term is stored.
    """
    own: dict[str, Floats] = {}
    for name in SIGNAL_TERMS:
        if f"{PHASE_PREFIX}{name}" in one:
            phase = one[f"{PHASE_PREFIX}{name}"].values
            own[name] = np.sum((per_phase * phase) ** 2, axis=0)
    if not own:
        return {"signal": total}, None
    groups = [list(own)]
    amounts = [total**2]
    if together is not None:
        shared = [name for name in own if name in SHARED_TERMS]
        groups = [[name for name in own if name not in shared], shared]
        amounts = [np.maximum(total**2 - together, 0.0), together]
    terms: dict[str, Floats] = {}
    rest = np.zeros(total.shape)
    for names, amount in zip(groups, amounts, strict=True):
        whole = np.sum([own[name] for name in names], axis=0, initial=0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(whole > 0, amount / whole, 0.0)
        rest += np.where(whole > 0, 0.0, amount)
        terms |= {name: np.sqrt(own[name] * scale) for name in names}
    return {name: terms[name] for name in own}, rest


def phase_errors(
    one: xr.Dataset, *, most_outliers: float = ambiguity.BREAKDOWN
) -> tuple[NDArray[np.int16], Floats, Floats]:
    """Return flags, phase errors and phase shifts by water of one channel."""
    signal = one.amulor.signal.values
    each = one["quality_flag"].values
    flag, left_out = flags_of_pixels(each, most_outliers=most_outliers)
    sigma = _phase_uncertainty(one, signal, (flag & UNUSABLE) == 0, "")
    sigma = np.where(left_out, np.inf, sigma)
    return flag, sigma, _phase_left_in(one, signal)


def own_phase_errors(one: xr.Dataset) -> Floats:
    """Return the phase error of each sample without what the pixels share."""
    flag, sigma, _ = phase_errors(one)
    if "common_covariance" not in one:
        return sigma
    usable = (flag & UNUSABLE) == 0
    shared = _phase_uncertainty(one, one.amulor.signal.values, usable, "common_")
    return np.sqrt(np.maximum(sigma**2 - shared**2, 0.0))


def _phase_left_in(cube: xr.Dataset, signal: NDArray[np.complex128]) -> Floats:
    """Return the phase shift by water left in, NaN where it is not known."""
    if "residual_in_phase" in cube:
        left = (
            cube["residual_in_phase"].values + 1j * cube["residual_quadrature"].values
        )
        return ranging.phase_shift(signal, residual=left)
    taken_out = (cube["quality_flag"].values & QualityFlag.NO_OPEN_WATER) == 0
    return np.where(taken_out, 0.0, np.nan)


def _phase_uncertainty(
    cube: xr.Dataset,
    signal: NDArray[np.complex128],
    usable: NDArray[np.bool_],
    prefix: str,
) -> Floats:
    """Return the phase error from the errors of the outputs, infinite if unusable."""
    in_phase = cube[f"{prefix}in_phase_uncertainty"].values ** 2
    quadrature = cube[f"{prefix}quadrature_uncertainty"].values ** 2
    if prefix:
        cross = cube[f"{prefix}covariance"].values
    else:
        cross = cube.amulor.covariance.values
    good = np.broadcast_to(usable, signal.shape)
    return detection.phase_uncertainty(
        np.where(good, signal, 1.0),
        in_phase_variance=np.where(good, in_phase, 1.0),
        quadrature_variance=np.where(good, quadrature, 1.0),
        covariance=np.where(good, cross, 0.0),
    )
