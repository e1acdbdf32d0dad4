"""Runs every method that the data allow and says which one to trust."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import UNUSABLE, QualityFlag
from amulor.errors import AmulorError, CubeError
from amulor.optics import detection, ranging
from amulor.rejection.combined import combined
from amulor.rejection.covariance import covariance_of
from amulor.rejection.frequency import frequency
from amulor.rejection.joint.estimate import joint
from amulor.rejection.open_water import open_water
from amulor.rejection.polarization import cross_polarized, unmix

Floats = NDArray[np.float64]
Interval = tuple[float, float] | None

#: What the survey says about the water behind a target is taken as that sure [1].
_COLUMN_UNCERTAINTY = 0.2
#: A method must use this share of the pixels that the best one uses [1].
_USES_ENOUGH = 0.9
#: Errors closer than this count as equal: the simpler method wins [1].
_EQUAL = 0.05


@dataclass(frozen=True)
class Row:
    """What one method makes of one channel; not a number where nothing is usable."""

    method: str
    """Name of the method, as on the command line."""
    polarization: str
    """Channel, empty if the method could not run."""
    bias: float
    """Estimated shift of the slant range by water left in, root mean square [m];
    infinite if water is in and nothing tells how much."""
    noise: float
    """Median standard uncertainty of the slant range [m]."""
    usable: float
    """Share of the pixels that have a range [1]."""
    flagged: float
    """Share of the pixels that have any flag [1]."""
    recommended: bool
    """True for one row."""
    note: str
    """Why it is recommended, or why it could not run or should not be used."""

    @property
    def error(self) -> float:
        """Bias and noise together [m]."""
        return float(np.hypot(self.bias, self.noise))


@dataclass(frozen=True)
class Comparison:
    """All methods side by side."""

    rows: tuple[Row, ...]
    """Method by method, channel by channel, the simplest method first."""
    method: str
    """The recommended method."""
    polarization: str
    """Its best channel."""
    reason: str
    """Why."""


@dataclass(frozen=True)
class _Method:
    name: str
    run: Callable[[xr.Dataset, Interval], xr.Dataset]
    caution: Callable[[xr.Dataset, Interval], str] = field(default=lambda cube, i: "")


def _cross_polarized(cube: xr.Dataset, interval: Interval) -> xr.Dataset:
    if cube.amulor.open_water is not None:
        raise CubeError("not needed: there are open-water shots, so no water stays in")
    return cross_polarized(cube)


def _open_water(cube: xr.Dataset, interval: Interval) -> xr.Dataset:
    described = bool(cube.attrs.get("survey"))
    return open_water(
        cube,
        interval=interval,
        column_uncertainty=_COLUMN_UNCERTAINTY if described else None,
    )


def _repeats(cube: xr.Dataset, interval: Interval) -> str:
    """Return a warning if one frequency alone does not settle the interval."""
    alone = float(
        ranging.ambiguity_interval(
            float(cube["modulation_frequency"][0]),
            group_index=float(cube["geometry"].attrs["group_index"]),
        )
    )
    if interval is not None and interval[1] - interval[0] > alone:
        return f"repeats after {alone:.3g} m"
    return ""


#: The simplest first.
_METHODS = (
    _Method("cross-polarized", _cross_polarized),
    _Method("open-water", _open_water),
    _Method(
        "frequency",
        lambda cube, interval: frequency(cube, interval=interval),
        _repeats,
    ),
    _Method("polarization", lambda cube, interval: unmix(cube)),
    _Method("combined", lambda cube, interval: combined(cube, interval=interval)),
    _Method("joint", lambda cube, interval: joint(cube, interval=interval)),
)


def compare(cube: xr.Dataset, *, interval: Interval = None) -> Comparison:
    """Run every rejection method that the data allow and compare the outcomes.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Comparison
        One row for each method and channel; methods that cannot run have a row that
        says why. What a method says about its own errors is all that counts: no truth
        is read.

    Raises
    ------
    CubeError
        If no method can use a single pixel.

    Notes
    -----
    Recommended is the smallest error, bias and noise together, among the methods that
    use at least nine tenths of the pixels that the best of them uses. Of errors within
    a twentieth of each other the simpler method wins. A bias that nothing tells counts
    as infinite. Where the survey describes the water, open water is subtracted up to
    the target only, and what the survey says about the rest counts as sure to a fifth.
    """
    cubes.check(cube, "samples")
    rows: list[Row] = []
    for method in _METHODS:
        try:
            target = method.run(cube, interval)
            caution = method.caution(target, interval)
        except (AmulorError, ValueError) as error:
            rows.append(_absent(method.name, str(error)))
            continue
        rows += [
            _row(method.name, target.sel(polarization=[name]), caution)
            for name in target.amulor.polarizations
        ]
    best = _best(rows)
    if best is None:
        listed = "; ".join(f"{row.method}: {row.note or 'no pixel'}" for row in rows)
        raise CubeError(f"no method has a pixel that it can use ({listed})")
    reason = _reason(rows, best)
    final = tuple(
        row
        if k != best
        else Row(**{**row.__dict__, "recommended": True, "note": reason})
        for k, row in enumerate(rows)
    )
    return Comparison(final, rows[best].method, rows[best].polarization, reason)


def auto(
    cube: xr.Dataset,
    *,
    interval: Interval = None,
    comparison: Comparison | None = None,
) -> xr.Dataset:
    """Take the water signal out by the method that `compare` recommends.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].
    comparison : Comparison, optional
        From `compare`, if it was run before.

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with the recommended channel; the attributes
        `rejection_method` and `rejection_reason` say which method it was, and why.

    Raises
    ------
    CubeError
        As `compare`.
    """
    found = compare(cube, interval=interval) if comparison is None else comparison
    method = next(method for method in _METHODS if method.name == found.method)
    target = method.run(cube, interval).sel(polarization=[found.polarization])
    return target.assign_attrs(
        rejection_method=found.method, rejection_reason=found.reason
    )


def _absent(name: str, note: str) -> Row:
    nan = float("nan")
    return Row(name, "", nan, nan, 0.0, 1.0, False, note)


def _row(name: str, target: xr.Dataset, caution: str) -> Row:
    flags = target["quality_flag"].values[:, 0]
    flag = np.bitwise_or.reduce(flags, axis=0)
    usable = (flag & UNUSABLE) == 0
    channel = target.amulor.polarizations[0]
    shares = float(usable.mean()), float((flag != 0).mean())
    if not usable.any():
        nan = float("nan")
        note = caution or "no pixel shows a target"
        return Row(name, channel, nan, nan, *shares, False, note)
    noise, bias = _errors(target, usable)
    water_is_in = bool((flag[usable] & QualityFlag.NO_OPEN_WATER).any())
    left = float(np.sqrt(np.mean(bias**2)))
    if water_is_in or not np.isfinite(left):
        left = float("inf")
        caution = caution or "nothing tells how much water is left in"
    return Row(name, channel, left, float(np.median(noise)), *shares, False, caution)


def _errors(target: xr.Dataset, usable: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return uncertainty and estimated bias of the slant range of usable pixels [m]."""
    if "user_joint_uncertainty" in target:
        own = target["user_joint_uncertainty"].values[usable]
        return own[np.isfinite(own)], np.zeros(1)
    signal = target.amulor.signal.values[:, 0][:, usable]
    errors = covariance_of(target).part((slice(None), 0))
    to_range = ranging.range_per_phase(
        target["modulation_frequency"].values[:, None],
        group_index=float(target["geometry"].attrs["group_index"]),
    )
    sigma = to_range * detection.phase_uncertainty(
        signal,
        in_phase_variance=errors.in_phase[:, usable],
        quadrature_variance=errors.quadrature[:, usable],
        covariance=errors.cross[:, usable],
    )
    weight, noise = ranging.weights_and_uncertainty(sigma)
    bias = np.zeros(noise.shape)
    if "residual_in_phase" in target:
        left = (
            target["residual_in_phase"].values
            + 1j * target["residual_quadrature"].values
        )[:, 0][:, usable]
        turned = ranging.phase_shift(signal, residual=left)
        shift = to_range * np.where(left == 0, 0.0, turned)
        bias = np.sum(weight * shift, axis=0)
    return noise, bias


def _best(rows: list[Row]) -> int | None:
    """Return the row to recommend; None if no row has a usable pixel."""
    most = max((row.usable for row in rows), default=0.0)
    if most == 0:
        return None
    enough = [k for k, row in enumerate(rows) if row.usable >= _USES_ENOUGH * most]
    clear = [k for k in enough if not _is_ambiguous(rows[k])] or enough
    lowest = min(rows[k].error for k in clear)
    if not np.isfinite(lowest):
        return min(clear, key=lambda k: rows[k].noise)
    return next(k for k in clear if rows[k].error <= (1 + _EQUAL) * lowest)


def _is_ambiguous(row: Row) -> bool:
    return row.note.startswith("repeats")


def _reason(rows: list[Row], best: int) -> str:
    row = rows[best]
    if not np.isfinite(row.error):
        return (
            f"{row.method} {row.polarization}: nothing tells how much water is left, "
            "and no other method can run; record open-water shots"
        )
    text = (
        f"{row.method} {row.polarization}: error {_length(row.error)} (bias "
        f"{_length(row.bias)}, noise {_length(row.noise)}) with {row.usable:.0%} of "
        "the pixels"
    )
    others = [
        other
        for other in rows
        if other.method != row.method and np.isfinite(other.error)
    ]
    if others:
        next_one = min(others, key=lambda other: other.error)
        text += (
            f"; {next_one.method} {next_one.polarization} "
            f"{_length(next_one.error)} with {next_one.usable:.0%}"
        )
    if row.flagged > 0.5:
        text += f"; {row.flagged:.0%} of the pixels carry a flag, see there"
    return text


def _length(value: float) -> str:
    return f"{value * 1e3:.3g} mm"
