"""Comparison of the rejection methods by their errors, and the recommendation."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor._progress import part, tell
from amulor.cube import UNUSABLE, QualityFlag, WaterResidualCause, tiles
from amulor.cube.error import JOINT_OUTLIERS, flags_of_pixels
from amulor.errors import AmulorError, CubeError
from amulor.optics import ambiguity, ranging
from amulor.rejection.channels import CROSS_POLARIZED, PARTNERS
from amulor.rejection.expected_errors import (
    errors_of,
    instrument_error,
    repeated_path,
)
from amulor.rejection.methods import Method, compared_methods, load, method

Floats = NDArray[np.float64]
Interval = tuple[float, float] | None

#: A method must use this fraction of the pixels that the best one uses [1].
_USES_ENOUGH = 0.9
#: Trusted fraction of pixels below which a method has a caution [1].
_HARDLY_ANY = 0.03
#: A joint estimation that trusts fewer pixels is tried without the shots [1].
_FEW = 0.8
#: Ranges of two methods disagree where they differ by more of their errors [1].
_DISAGREE = 4.0
#: Pixels that two methods must both trust to be compared.
_FEWEST_PIXELS = 10
#: Errors closer than this count as equal: the simpler method wins [1].
_EQUAL = 0.05
#: Largest error of a method that is preferred for its smaller noise, over the smallest
#: error of all methods [1].
_LARGER = 2.0
#: Ratio of the standard deviation to the median absolute deviation [1].
_OF_MEDIAN = 1.4826
_CONTRADICTION = "no water explains the open-water shots and the scan together, so "
_CORNERS = (
    "corners reflect light twice (scan a plate in the same water to see whether the "
    "contradiction ends), or "
)
_INSTRUMENT = (
    "the instrument has an error: signal without light (leakage), a phase that depends "
    "on the amplitude, or a receiver elsewhere than the survey says; block the "
    "receiver with the laser on to see leakage, and calibrate the phase "
    "against amplitude"
)


class Caution(enum.StrEnum):
    """Reason to avoid a row of a comparison, or to use it with care.

    Examples
    --------
    >>> from amulor.rejection import Caution
    >>> Caution("no pixel").name
    'NO_PIXEL'
    """

    NONE = "none"
    """No caution."""
    NOT_RUN = "not run"
    """The method refused the data; the note says why."""
    AMBIGUOUS = "ambiguous"
    """The interval exceeds the ambiguity interval of the single frequency."""
    NO_PIXEL = "no pixel"
    """No pixel has a detected target."""
    LONE_PIXELS = "lone pixels"
    """Trusted pixels are few and isolated, as expected from noise."""
    BIAS_UNKNOWN = "bias unknown"
    """Water signal remains, and its amount is unknown."""
    INSTRUMENT = "instrument"
    """An instrument error makes shots and scan inconsistent."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Expected errors of one method in one channel; NaN where no pixel is usable.

    Examples
    --------
    Bias and noise add in quadrature, 3, 4, 5:

    >>> from amulor.rejection import Row
    >>> row = Row(
    ...     method="open-water", polarization="VV", bias=3e-4, noise=4e-4,
    ...     usable=1.0, flagged=0.1, trusted=0.9,
    ... )
    >>> print(f"{1e3 * row.error:.1f} mm")
    0.5 mm
    """

    method: str
    """Method name, as used on the command line."""
    polarization: str
    """Channel, empty if the method could not run."""
    bias: float
    """Estimated root-mean-square range error from residual water [m]; infinite if
    water remains and its amount is unknown."""
    noise: float
    """Median standard uncertainty of the slant range [m]."""
    usable: float
    """Fraction of pixels with a range [1]."""
    flagged: float
    """Fraction of pixels with at least one flag [1]."""
    trusted: float
    """Fraction of pixels with an unflagged range, consistent frequencies, and at least
    one such neighbor [1]."""
    caution: Caution = Caution.NONE
    """Reason against this row, considered by the recommendation."""
    recommended: bool = False
    """Whether this is the recommended row."""
    note: str = ""
    """Reason for the recommendation, or explanation of the caution."""
    instrument: float = 0.0
    """Range error from instrument phase errors, stated or typical [m]."""

    @property
    def error(self) -> float:
        """Root sum of squares of bias, noise and the instrument's error [m]."""
        return math.hypot(self.bias, self.noise, self.instrument)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Expected errors of all rejection methods, and the recommended method.

    Examples
    --------
    `compare` returns one; a table of it takes a line:

    >>> from amulor.rejection import Comparison, Row
    >>> row = Row(
    ...     method="open-water", polarization="VV", bias=3e-4, noise=4e-4,
    ...     usable=1.0, flagged=0.1, trusted=0.9, recommended=True,
    ... )
    >>> found = Comparison(
    ...     rows=(row,), method="open-water", polarization="VV", reason="smallest error"
    ... )
    >>> [f"{one.method}: {1e3 * one.error:.1f} mm" for one in found.rows]
    ['open-water: 0.5 mm']
    """

    rows: tuple[Row, ...]
    """Rows by method and channel, the simplest method first."""
    method: str
    """The recommended method."""
    polarization: str
    """Best channel of the recommended method."""
    reason: str
    """Reason for the recommendation."""
    disagreement: float = 0.0
    """Largest median range difference from another method beyond both methods' errors;
    0 if none [m]."""


def _repeat_distance(cube: xr.Dataset) -> float:
    """Return the ambiguity interval of a cube with one frequency [m]."""
    return float(
        ranging.ambiguity_interval(
            float(cube["modulation_frequency"][0]),
            group_index=float(cube["geometry"].attrs["group_index"]),
        )
    )


def _shots_are_doubted(cube: xr.Dataset, rows: list[Row]) -> bool:
    """Return whether few pixels that show a target by the shots are trusted, too.

    Pixels in which the shots show open water speak for the shots.
    """
    ran = [row for row in rows if row.polarization]
    doubted = all(row.trusted < _FEW * row.usable for row in ran)
    return bool(ran) and cube.amulor.open_water is not None and doubted


@dataclass(frozen=True, kw_only=True)
class _Trial:
    """Result of one method in one channel."""

    row: Row
    """Row of the comparison."""
    path: Floats | None = None
    """Optical paths, NaN in untrusted pixels [m]."""
    own_noise: float = math.nan
    """Median range uncertainty without errors common to all pixels [m]."""
    repeat: float = math.nan
    """Interval of paths after which the phases of its frequencies repeat [m]."""
    target: xr.Dataset | None = None
    """Target signal of a scan of at most `tiles.SAMPLE` pixels."""


def compare(cube: xr.Dataset, *, interval: Interval = None) -> Comparison:
    """Run every applicable rejection method and compare their errors.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Comparison
        One row for each method and channel. Methods that cannot run have a row with the
        reason. Only the errors that the methods state are compared, never the truth of
        a simulation.

    Raises
    ------
    CubeError
        If no method can use a single pixel.

    Notes
    -----
    The recommended method has the smallest error, bias and noise together, among the
    methods that trust at least nine tenths as many pixels as the best one. A trusted
    pixel has no flag, its frequencies agree, its beam meets one surface, and a neighbor
    is trusted, too. Of errors within a twentieth of each other the simpler method wins.
    An unknown bias counts as infinite.

    The ranges of a method with up to twice this error may agree with those of the first
    choice. Then both have the same common error, and the method with less noise is
    recommended. The systematic difference counts as noise.

    If the joint estimation trusts few of the pixels in which the shots show a target,
    and these show no error of the instrument, it is tried without shots as well. If the
    ranges of another method differ by more than four times both errors, the comparison
    states the difference.
    """
    return _compared(cube, interval)[0]


def _compared(
    cube: xr.Dataset, interval: Interval
) -> tuple[Comparison, xr.Dataset | None]:
    """Compare all methods; return also the target signal of the recommended one."""
    cube = cubes.checked(cube, "samples")
    methods, broken = compared_methods()
    candidates = [candidate for candidate in methods if candidate.refine is None]
    trials = [_Trial(row=_not_run(name, str(error))) for name, error in broken.items()]
    for number, candidate in enumerate(candidates):
        with part(number / len(candidates), (number + 1) / len(candidates)):
            outcomes = _rows(candidate, cube, interval)
            doubted = _shots_are_doubted(cube, [trial.row for trial in outcomes])
            # What is wrong with the instrument is wrong without the shots, too.
            if (
                candidate.distrusts_open_water
                and doubted
                and not any(trial.row.caution is Caution.INSTRUMENT for trial in trials)
            ):
                outcomes += _rows(candidate.without_open_water(), cube, interval)
        trials += outcomes
    rows = [trial.row for trial in trials]
    contradiction = next(
        (row.note for row in rows if row.caution is Caution.INSTRUMENT), ""
    )
    if contradiction:
        # The channels of the scan are wrong, too, beside the shots. A range profile
        # explains and tests several surfaces, which others take for a contradiction.
        touched = [
            candidate.name
            for candidate in candidates
            if candidate.needs.open_water or candidate.needs.channel_pair
        ]
        rows = [
            replace(row, caution=Caution.INSTRUMENT, trusted=0.0, note=contradiction)
            if row.method in touched and row.caution is not Caution.NOT_RUN
            else row
            for row in rows
        ]
    trials = [replace(t, row=r) for t, r in zip(trials, rows, strict=True)]
    best, steadier = _best(rows), None
    if best is not None:
        steadier = _steadier(trials, best, cube)
    if best is None and contradiction:
        raise CubeError(f"no method can be trusted: {contradiction}")
    if best is None and any(row.caution is Caution.LONE_PIXELS for row in rows):
        raise CubeError(
            "no method sees a target: single pixels pass for one here and there, and "
            "none of them has a neighbor, as in noise; aim at the target, go nearer, "
            "or raise power or dwell"
        )
    if best is None and any(row.caution is Caution.NO_PIXEL for row in rows):
        raise CubeError(
            "no method has a pixel that it can use: none shows a target, all is open "
            "water as the shots have it; aim at the target, or raise power or dwell"
        )
    if best is None:
        raise CubeError(_refusal(cube, rows))
    agreement = ""
    if steadier is not None:
        first, best = rows[best], steadier.index
        agreement = (
            f"; its ranges agree with {first.method} {first.polarization} "
            f"({_length(first.error)}) within {_length(steadier.difference)}, and have "
            "less noise"
        )
    remarks = {candidate.name: candidate.remark for candidate in methods}
    remark = remarks.get(rows[best].method, "")
    for candidate in methods:
        if candidate.refine is None or not np.isfinite(rows[best].error):
            continue
        refined = _refined(candidate, trials[best], cube, interval)
        trials.append(refined)
        rows.append(refined.row)
        if _steadier([trials[best], refined], 0, cube) is not None:
            before = _length(trials[best].own_noise)
            best = len(rows) - 1
            remark = (
                f"{candidate.remark} (noise of a pixel {_length(refined.own_noise)} "
                f"instead of {before})"
            )
    reason = _reason(rows, best, has_shots=cube.amulor.open_water is not None)
    reason += agreement + (f"; {remark}" if remark else "")
    other, disagreement = _disagreement(trials, best, cube)
    if other is not None:
        reason += (
            f"; {other.method} {other.polarization} differs by {_length(disagreement)}"
            ", more than both errors explain: leakage, a phase that depends on the "
            "amplitude, or water of another kind before the target; the difference "
            "counts as an error"
        )
    rows[best] = replace(rows[best], recommended=True, note=reason)
    comparison = Comparison(
        rows=tuple(rows),
        method=rows[best].method,
        polarization=rows[best].polarization,
        reason=reason,
        disagreement=disagreement,
    )
    return comparison, trials[best].target


@method("auto", fitter=lambda source, **options: _fit_auto(source, **options))
def auto(
    cube: xr.Dataset,
    *,
    interval: Interval = None,
    comparison: Comparison | None = None,
) -> xr.Dataset:
    """Remove the water signal by the method that `compare` recommends.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].
    comparison : Comparison, optional
        Result of `compare`, if it was run before.

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with the recommended channel. The attributes
        `rejection_method` and `rejection_reason` state the method and the reason for
        it.

    Raises
    ------
    CubeError
        As in `compare`.

    Examples
    --------
    Without open water the crossed channel is what is left; here that was found before:

    >>> from amulor import cube as cubes, rejection, samples
    >>> row = rejection.Row(
    ...     method="cross-polarized", polarization="VH", bias=1e-3, noise=1e-3,
    ...     usable=1.0, flagged=1.0, trusted=0.0, recommended=True,
    ... )
    >>> found = rejection.Comparison(
    ...     rows=(row,), method="cross-polarized", polarization="VH", reason="no shots",
    ... )
    >>> bare = cubes.without_groups(samples.cube("ladder"))
    >>> target = rejection.auto(bare, comparison=found)
    >>> target.amulor.polarizations, target.attrs["rejection_reason"]
    (['VH'], 'no shots')
    """
    target, compared = None, 0.0
    if comparison is None:
        compared = 0.8
        with part(0.0, compared):
            comparison, target = _compared(cube, interval)
    if target is None:
        tell(f"taking the water out by {comparison.method}", compared)
        with part(compared, 1.0):
            target = load(comparison.method)(cube, interval=interval)
    return _of_comparison(target, comparison)


def _fit_auto(
    source: tiles.Source,
    *,
    interval: Interval = None,
    comparison: Comparison | None = None,
) -> tiles.OfRows:
    """Fit the recommended method; without `comparison`, compare a sample first."""
    if comparison is None:
        sample = cubes.without_groups(tiles.sample_of(source), "truth")
        comparison = compare(sample, interval=interval)
    of = load(comparison.method).fit(source, interval=interval)
    return lambda rows, first: _of_comparison(of(rows, first), comparison)


def _of_comparison(target: xr.Dataset, comparison: Comparison) -> xr.Dataset:
    """Select the recommended channel of a target signal; record method and reason."""
    attributes: dict[str, Any] = {
        "rejection_method": comparison.method,
        "rejection_reason": comparison.reason,
    }
    if comparison.disagreement > 0:
        attributes["method_disagreement_m"] = comparison.disagreement
    return target.sel(polarization=[comparison.polarization]).assign_attrs(attributes)


def _rows(method: Method, cube: xr.Dataset, interval: Interval) -> list[_Trial]:
    """Run a method; return one trial per channel, or the reason why it cannot run."""
    tell(f"trying {method.name}", 0.0)
    if method.needs.open_water is False and cube.amulor.open_water is not None:
        note = "not needed: there are open-water shots, so no water stays in"
        return [_Trial(row=_not_run(method.name, note))]
    if method.unsuited is not None and (note := method.unsuited(cube, interval)):
        return [_Trial(row=_not_run(method.name, note))]
    try:
        target = method(cube, interval=interval)
    except (AmulorError, ValueError) as error:
        return [_Trial(row=_not_run(method.name, str(error)))]
    trials = [
        _row(method, target.sel(polarization=[name]), interval)
        for name in target.amulor.polarizations
    ]
    if cube["azimuth"].size > tiles.SAMPLE:
        return trials
    return [replace(trial, target=target) for trial in trials]


def _refined(
    method: Method, first: _Trial, cube: xr.Dataset, interval: Interval
) -> _Trial:
    """Evaluate a method that improves the target signal of the best one."""
    base = first.row.method
    if method.unsuited is not None and (note := method.unsuited(cube, interval)):
        return _Trial(row=_not_run(method.name, note))
    target = first.target
    if target is None:
        target = load(base)(cube, interval=interval)
    target = cast("Callable[..., xr.Dataset]", method.refine)(target)
    channel = target.sel(polarization=[first.row.polarization])
    return replace(_row(method.of(base), channel, interval), target=target)


def _refusal(cube: xr.Dataset, rows: list[Row]) -> str:
    """Return the error message for a cube in which no method has a usable pixel."""
    channels = cube.amulor.polarizations
    frequency = cube["modulation_frequency"].values
    lacks_all = (
        cube.amulor.open_water is None
        and not set(channels) & set(CROSS_POLARIZED)
        and len(frequency) == 1
    )
    if lacks_all and all(row.caution is Caution.NOT_RUN for row in rows):
        crossed = [PARTNERS[name] for name in channels if name in PARTNERS]
        return (
            "no method can tell the target from the water in this cube\n"
            f"  found: channel {', '.join(channels)} at {frequency[0] / 1e6:g} MHz, "
            "no open-water shots\n"
            "  needed: open-water shots, a cross-polarized channel "
            f"({', '.join(crossed) or 'VH'}), or several modulation frequencies\n"
            "  record one of these and run auto again; amulor reject --method NAME "
            "says what a single method needs"
        )
    methods: dict[str, list[str]] = {}
    for row in rows:
        methods.setdefault(row.note or "no pixel", []).append(row.method)
    listed = "".join(
        f"\n  {', '.join(dict.fromkeys(names))}: {note}"
        for note, names in methods.items()
    )
    return f"no method has a pixel that it can use{listed}"


def _not_run(name: str, reason: str) -> Row:
    return Row(
        method=name,
        polarization="",
        bias=float("nan"),
        noise=float("nan"),
        usable=0.0,
        flagged=1.0,
        trusted=0.0,
        caution=Caution.NOT_RUN,
        note=reason,
    )


def _row(method: Method, target: xr.Dataset, interval: Interval) -> _Trial:
    """Evaluate a method in one channel: errors, trusted pixels and cautions."""
    is_joint = "joint_slant_range_uncertainty" in target
    flag, excluded = flags_of_pixels(
        target["quality_flag"].values[:, 0],
        most_outliers=JOINT_OUTLIERS if is_joint else ambiguity.BREAKDOWN,
    )
    usable = (flag & UNUSABLE) == 0
    caution, note, in_corners = Caution.NONE, "", False
    bias, noise, own_noise = math.nan, math.nan, math.nan
    agree = np.zeros(usable.shape, dtype=bool)
    path = np.full(usable.shape, np.nan)
    if usable.any():
        errors = errors_of(target, usable, excluded, interval=interval)
        noises, biases = errors.noise, errors.bias
        in_corners = errors.corner_light
        agree[usable], path[usable] = errors.agree, errors.path
        flag = flag.copy()
        flag[usable] |= np.where(errors.mixed, np.int16(QualityFlag.MIXED), 0)
        flag[usable] |= np.where(errors.in_corner, np.int16(QualityFlag.CORNER), 0)
        water_is_in = bool((flag[usable] & QualityFlag.NO_OPEN_WATER).any())
        # A few pixels with unknown bias have a flag, and are counted there.
        clear = flag[usable] == 0
        counted = clear if clear.any() else np.ones(clear.shape, dtype=bool)
        bias = float(np.sqrt(np.mean(biases[counted] ** 2)))
        counted &= ~np.isnan(noises)
        if counted.any():
            noise = float(np.median(noises[counted]))
            own_noise = float(np.median(errors.own_noise[counted]))
        if water_is_in or not np.isfinite(bias):
            bias = float("inf")
            caution = Caution.BIAS_UNKNOWN
            note = "nothing tells how much water is left in"
    else:
        caution, note = Caution.NO_PIXEL, "no pixel shows a target"
    causes = target.get("water_residual_cause", np.int8(0))
    if np.any(np.asarray(causes) & WaterResidualCause.INSTRUMENT):
        caution = Caution.INSTRUMENT
        note = f"{_CONTRADICTION}{_CORNERS if in_corners else ''}{_INSTRUMENT}"
    if method.keeps_one_frequency and interval is not None:
        repeat = _repeat_distance(target)
        if interval[1] - interval[0] > repeat:
            caution, note = Caution.AMBIGUOUS, f"repeats after {repeat:.3g} m"
    sound = agree & (flag == 0)
    trusted = sound & _has_neighbor(sound)
    if any(
        mask.any() and not (mask & _has_neighbor(mask)).any()
        for mask in (usable, sound)
    ):
        caution, note = Caution.LONE_PIXELS, "no pixel that it trusts has a neighbor"
    row = Row(
        method=method.name,
        polarization=target.amulor.polarizations[0],
        bias=bias,
        noise=noise,
        instrument=instrument_error(target),
        usable=float(usable.mean()),
        flagged=float((flag != 0).mean()),
        trusted=float(trusted.mean()),
        caution=caution,
        note=note,
    )
    return _Trial(
        row=row,
        path=np.where(trusted, path, np.nan),
        own_noise=own_noise,
        repeat=repeated_path(target["modulation_frequency"].values),
    )


def _has_neighbor(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask of pixels with a `mask` pixel among the eight neighbors.

    The pixel of a scan with a single one counts as having a neighbor.
    """
    if mask.size == 1:
        return np.ones(mask.shape, dtype=bool)
    padded = np.pad(mask.astype(int), 1)
    rows, columns = mask.shape
    around = sum(
        padded[down : down + rows, right : right + columns]
        for down in range(3)
        for right in range(3)
    )
    return np.asarray(around > mask)


@dataclass(frozen=True)
class _Steadier:
    """Method that agrees with the first choice and has less noise."""

    index: int
    """Index of its row."""
    difference: float
    """Systematic difference from the first choice [m]."""


def _steadier(trials: list[_Trial], best: int, cube: xr.Dataset) -> _Steadier | None:
    """Return the method that agrees with the best and has the least noise, if any.

    Methods whose ranges agree have the same common error, whatever they state of it.
    """
    first = trials[best]
    if not np.isfinite(first.row.error):
        return None
    group_index = float(cube["geometry"].attrs["group_index"])
    least = first.own_noise / (1 + _EQUAL)
    chosen = None
    for index, trial in enumerate(trials):
        row = trial.row
        if (
            index == best
            or row.caution is not Caution.NONE
            or row.trusted < _USES_ENOUGH * first.row.trusted
            or not row.error <= _LARGER * first.row.error
        ):
            continue
        differences = _differences(trial, first) / (2 * group_index)
        if differences.size < _FEWEST_PIXELS:
            continue
        middle = float(np.median(differences))
        spread = _OF_MEDIAN * float(np.median(np.abs(differences - middle)))
        # Noise of the first choice scatters the differences as well.
        rest = max(spread**2 - first.own_noise**2, 0.0)
        difference = math.sqrt(middle**2 + rest)
        if (noise := math.hypot(trial.own_noise, difference)) < least:
            least, chosen = noise, _Steadier(index, difference)
    return chosen


def _differences(trial: _Trial, other: _Trial) -> Floats:
    """Return differences of optical paths, less whole intervals [m].

    The intervals are those of the trial whose phases repeat earlier.
    """
    if trial.path is None or other.path is None:
        return np.zeros(0)
    differences = trial.path - other.path
    differences = differences[np.isfinite(differences)]
    repeat = min(trial.repeat, other.repeat)
    return np.asarray(differences - repeat * np.round(differences / repeat))


def _disagreement(
    trials: list[_Trial], best: int, cube: xr.Dataset
) -> tuple[Row | None, float]:
    """Return the row that differs most in range from the best, and difference [m].

    And the median difference, less whole intervals after which phases repeat [m].
    """
    chosen = trials[best]
    group_index = float(cube["geometry"].attrs["group_index"])
    other, largest = None, 0.0
    for trial in trials:
        row = trial.row
        if trial is chosen or row.caution is not Caution.NONE:
            continue
        differences = _differences(trial, chosen)
        if differences.size < _FEWEST_PIXELS:
            continue
        difference = abs(float(np.median(differences))) / (2 * group_index)
        # A difference beyond the noise shows an error of the instrument.
        parts = (row, chosen.row)
        error = math.hypot(*(value for r in parts for value in (r.bias, r.noise)))
        if difference > max(_DISAGREE * error, largest):
            other, largest = row, difference
    return other, largest


def _best(rows: list[Row]) -> int | None:
    """Return the index of the row to recommend; None if no row has a usable pixel."""
    wrong = (Caution.LONE_PIXELS, Caution.INSTRUMENT)
    sound = [row.caution not in wrong for row in rows]
    # Flagged pixels are no argument, unless no method has any others.
    counted = [row.trusted for row in rows]
    if not any(counted):
        counted = [row.usable * fit for row, fit in zip(rows, sound, strict=True)]
    if not any(counted):
        return None
    enough = [k for k, n in enumerate(counted) if n >= _USES_ENOUGH * max(counted)]
    clear = [k for k in enough if rows[k].caution is not Caution.AMBIGUOUS] or enough
    lowest = min(rows[k].error for k in clear)
    if not np.isfinite(lowest):
        return min(clear, key=lambda k: rows[k].noise)
    return next(k for k in clear if rows[k].error <= (1 + _EQUAL) * lowest)


def _reason(rows: list[Row], best: int, *, has_shots: bool) -> str:
    row = rows[best]
    if not np.isfinite(row.error):
        remedy = (
            "the notes of the other methods say why"
            if has_shots
            else "record open-water shots"
        )
        return (
            f"{row.method} {row.polarization}: nothing tells how much water is left, "
            f"and no other method can run; {remedy}"
        )
    text = (
        f"{row.method} {row.polarization}: error {_length(row.error)} (bias "
        f"{_length(row.bias)}, noise {_length(row.noise)}) with {row.trusted:.0%} of "
        "the pixels trusted"
    )
    others = [
        other
        for other in rows
        if other.method != row.method and np.isfinite(other.error)
    ]
    if others:
        second = min(others, key=lambda other: other.error)
        text += (
            f"; {second.method} {second.polarization} "
            f"{_length(second.error)} with {second.trusted:.0%}"
        )
    if 0 < row.trusted < _HARDLY_ANY:
        text += "; hardly any pixel is trusted: right only where little is in view"
    if row.flagged > 0.5:
        text += f"; {row.flagged:.0%} of the pixels carry a flag, see there"
    return text


def _length(value: float) -> str:
    return f"{value * 1e3:.3g} mm"
