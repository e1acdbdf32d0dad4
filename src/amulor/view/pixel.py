"""Flags of one pixel with the numbers behind each: measured value, limit, unit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor.cube import QualityFlag, WaterResidualCause
from amulor.errors import CubeError, FormatError
from amulor.imaging import edges, outliers
from amulor.io.netcdf import open_rows
from amulor.optics import ambiguity, ranging
from amulor.rejection import quality, subtraction
from amulor.rejection.covariance import covariance_of, isotropic
from amulor.rejection.joint import cube as joint
from amulor.rejection.joint.scatter import DETECTION
from amulor.rejection.reference import presence
from amulor.view.explanations import default_of

#: Rows and columns around a pixel of an image on which its flags depend.
_AROUND = 12
_NO_FLAGS = (
    "no flags of pixels; name a target signal (amulor reject) or a range image "
    "(amulor image)"
)


@dataclass(frozen=True, kw_only=True)
class Reason:
    """One flag of a pixel, and a number that it rests on."""

    flag: str
    """Name of the flag."""
    cause: str
    """Name of the cause of WATER_RESIDUAL; empty of other flags."""
    modulation_frequencies: tuple[float, ...] = ()
    """Of the samples [Hz]; empty for all of the pixel."""
    quantity: str
    """What is compared with a limit, or what is known instead of a number."""
    value: float | None = None
    """Measured value; None without one."""
    limit: str = ""
    """Relation to the limit that gives the flag, such as "> 0.3"."""
    unit: str = ""
    """Unit of both."""


def reasons(path: Path, row: int, column: int) -> dict[str, list[Reason]]:
    """Return the flags of a pixel of a file with their numbers, channel by channel."""
    if path.suffix.lower() not in (".nc", ".nc4"):
        raise FormatError(f"{path} has {_NO_FLAGS}")
    with open_rows(path, check_digest=False) as rows:
        level = str(rows.head.attrs.get("level"))
        if level not in ("target_signal", "range_image"):
            raise CubeError(f"{path}: is of level {level}, which has {_NO_FLAGS}")
        for name, place, size in (
            ("row", row, rows.rows),
            ("column", column, rows.columns),
        ):
            if not 0 <= place < size:
                raise CubeError(
                    f"{path}: {name} {place} is outside the scan; needed is a {name} "
                    f"from 0 to {size - 1}"
                )
        around = 0 if level == "target_signal" else _AROUND
        first, left = max(row - around, 0), max(column - around, 0)
        tile = rows.tile(first, min(row + around + 1, rows.rows))
    tile = tile.isel(column=slice(left, column + around + 1))
    cubes.check(tile, level, name=str(path))
    if level == "range_image":
        channel = str(tile.attrs["polarization"])
        return {channel: list(_of_image(tile, row - first, column - left))}
    return {
        channel: list(_of_samples(tile, number))
        for number, channel in enumerate(tile.amulor.polarizations)
    }


def _of_samples(tile: xr.Dataset, channel: int) -> Iterator[Reason]:
    """Yield what flags the samples of a channel, alike ones of all frequencies once."""
    cube = tile.isel(polarization=[channel])
    frequencies = cube["modulation_frequency"].values
    at: dict[Reason, tuple[float, ...]] = {}
    for number, frequency in enumerate(frequencies):
        one = cube.isel(modulation_frequency=[number])
        for reason in _found(_known(one) | _phases(one), cube.attrs):
            at[reason] = (*at.get(reason, ()), float(frequency))
    for reason, some in at.items():
        alone = len(some) < len(frequencies) or len(frequencies) == 1
        yield replace(reason, modulation_frequencies=some if alone else ())


def _of_image(tile: xr.Dataset, row: int, column: int) -> Iterator[Reason]:
    """Yield what flags a pixel of a range image."""
    known = _known(tile.isel(row=[row], column=[column]))
    known["clear_of_both"] = float(edges.clear_of_both(tile)[row, column])
    known["stand_off"] = float(outliers.stand_off(tile)[row, column])
    yield from _found(known, tile.attrs)


def _known(one: xr.Dataset) -> dict[str, float]:
    """Return the numbers of a single sample or pixel."""
    numbers = {
        str(name): float(variable.item())
        for name, variable in one.data_vars.items()
        if variable.size == 1
    }
    near, far = "joint_nearer_surface", "joint_farther_surface"
    if near in numbers:
        numbers["apart"] = numbers[far] - numbers[near]
    return numbers


def _phases(sample: xr.Dataset) -> dict[str, float]:
    """Return phase errors of a sample, and its shift by residual water [rad]."""
    signal = sample.amulor.signal.values
    errors = covariance_of(sample)
    seen = np.isfinite(signal)
    phases = {"phase_error": quality.phase_error(signal, errors, seen).item()}
    if "residual_in_phase" in sample:
        parts = (
            sample[f"residual_{part}"].values for part in ("in_phase", "quadrature")
        )
        in_phase, quadrature = parts
        residual = in_phase + 1j * quadrature
        shift = ranging.phase_shift(signal, residual=residual)
        phases["residual_phase"] = float(np.abs(shift).item())
        errors = errors + isotropic(math.sqrt(2) * np.nan_to_num(np.abs(residual)))
    phases["open_phase"] = quality.phase_error(signal, errors, seen).item()
    return phases


@dataclass(frozen=True)
class _Test:
    """A number behind a flag, and the limit beyond which it gives the flag."""

    flag: QualityFlag | WaterResidualCause
    key: str
    quantity: str
    relation: str = ""
    limit: float = math.nan
    unit: str = "1"

    def of(self, flag: QualityFlag, causes: WaterResidualCause) -> bool:
        """Whether it is a test behind a flag, which has these causes."""
        if isinstance(self.flag, WaterResidualCause):
            return flag == QualityFlag.WATER_RESIDUAL and self.flag in causes
        return self.flag == flag

    def given_by(self, value: float) -> bool:
        """Whether the value is what gives the flag; a cause is stored as such."""
        if not self.relation or isinstance(self.flag, WaterResidualCause):
            return not math.isnan(value)
        return value < self.limit if self.relation == "<" else value >= self.limit


def _tests(known: Mapping[str, float], attributes: Mapping[Any, Any]) -> list[_Test]:
    """Return all tests, with the limits of a sample or pixel."""
    flag, cause = QualityFlag, WaterResidualCause
    channels = np.atleast_1d(attributes.get("channel_disagreement_limit", math.nan))
    margin = math.exp(-ambiguity.MARGIN / 2)
    wrong = joint.WRONG if "joint_detection" in known else margin / (1 + margin)
    phase = known.get("phase_error", math.nan)
    return [
        _Test(flag.NO_TARGET, "no_target_probability",
              "chance of so large a chi-square without a target", ">", presence.SIZE),
        _Test(flag.NO_TARGET, "joint_detection",
              "fall of chi-square by a target", "<", DETECTION),
        _Test(flag.NO_TARGET, "signal_significance",
              "target signal off zero, in standard errors", "<",
              quality.DETECTION_THRESHOLD),
        _Test(flag.NO_TARGET, "open_phase", "standard uncertainty of the phase", ">",
              quality.LARGEST_PHASE_ERROR, "rad"),
        _Test(flag.AMBIGUOUS, "joint_wrong_interval_probability",
              "probability of another interval", ">", joint.WRONG),
        _Test(flag.AMBIGUOUS, "ambiguous_interval_probability",
              "probability of another interval", ">", wrong),
        _Test(flag.AMBIGUOUS, "ambiguous_misfit_probability",
              "chance of phases that disagree so much", "<", ambiguity.DISAGREEMENT),
        _Test(cause.PHASE_SHIFT, "residual_phase", "phase shift by residual water", ">",
              phase, "rad"),
        _Test(cause.PHASE_SHIFT, "residual_phase_ratio",
              "phase shift by residual water over the phase error", ">", 1.0),
        _Test(cause.STRONG_COLUMN, "column_over_target",
              "water signal behind the target over target signal", ">",
              subtraction.TOO_STRONG),
        _Test(cause.WATER_SHAPE, "water_shape_significance",
              "signal of the shape of the water, in standard errors", ">",
              quality.DETECTION_THRESHOLD),
        _Test(cause.WATER_SHAPE, "water_shape_probability",
              "chance of so large a rest besides it", ">", quality.PLAUSIBLE),
        _Test(cause.MODEL_MISFIT, "joint_misfit_probability",
              "chance of so large a misfit to the model", "<", joint.DISAGREEMENT),
        _Test(cause.MODEL_DEPARTURE, "joint_departure",
              "shift of the range by departures from the model", ">",
              known.get("joint_departure_limit", math.nan), "m"),
        _Test(flag.WATER_RESIDUAL, "slant_range_bias",
              "estimated bias of the range", unit="m"),
        _Test(flag.NO_OPEN_WATER, "slant_range_bias",
              "estimated bias of the range", unit="m"),
        _Test(flag.MIXED, "clear_of_both",
              "off both surfaces around it, in standard errors", ">",
              default_of(edges.flag_mixed, "significance")),
        _Test(flag.MIXED, "apart", "distance of the two surfaces", unit="m"),
        _Test(flag.OUTLIER, "channel_disagreement",
              "phase off another channel, in units of its scatter", ">",
              float(channels.min())),
        _Test(flag.OUTLIER, "stand_off", "off its neighbours, in standard errors", ">",
              outliers.LEAST),
    ]  # fmt: skip


def _found(known: dict[str, float], attributes: Mapping[Any, Any]) -> Iterator[Reason]:
    """Yield a reason for each number beyond its limit, and one a flag at least."""
    flags = QualityFlag(int(known["quality_flag"]))
    causes = WaterResidualCause(int(known.get("water_residual_cause", 0)))
    if "residual_phase" in known:  # the angle says more than its ratio
        known.pop("residual_phase_ratio", None)
    if "joint_detection" in known:  # which looks for a target in all samples together
        known.pop("open_phase", None)
    tests = _tests(known, attributes)
    for flag in (each for each in QualityFlag if each & flags):
        # Bits of flags and causes are alike as numbers: told apart by their names.
        of_water = flag == QualityFlag.WATER_RESIDUAL and causes
        left = [str(each.name) for each in (causes if of_water else flag)]
        for test in tests:
            value = known.get(test.key, math.nan)
            if test.of(flag, causes) and test.given_by(value):
                name = str(test.flag.name)
                left = [each for each in left if each != name]
                yield Reason(
                    flag=str(flag.name),
                    cause="" if name == flag.name else name,
                    quantity=test.quantity,
                    value=value,
                    limit=f"{test.relation} {test.limit:.3g}" if test.relation else "",
                    unit=test.unit,
                )
        for name in left:
            yield Reason(
                flag=str(flag.name),
                cause="" if name == flag.name else name,
                quantity=_words(name, attributes),
            )


def _words(name: str, attributes: Mapping[Any, Any]) -> str:
    """Return what is known of a flag or cause that no number of the file explains."""
    if name == "RELATIVE":
        return str(attributes.get("interval_unsettled", "no interval is stated"))
    numbers = (
        f"{label} {float(np.squeeze(attributes[key])):.2g}"
        for label, key in (
            ("relative change of the water", "open_water_change"),
            ("departure of the shots from the model", "open_water_misfit"),
        )
        if key in attributes
    )
    of_water = ", ".join(numbers) or "not stored"
    return {
        "WATER_CHANGED": of_water,
        "INSTRUMENT": of_water,
        "MISSING": "no number in phase or in quadrature",
        "NO_TARGET": "too few samples that can be used",
        "SATURATED": "overload reported with the sample",
        "AMBIGUOUS": "outside the interval, or alike within departures",
        "NO_OPEN_WATER": "bias of the range by the water not known",
        "OUTLIER": "sample contradicts the others of its pixel",
        "PHASE_SHIFT": "residual water signal not known",
    }.get(name, "not stored: file of an older version")
