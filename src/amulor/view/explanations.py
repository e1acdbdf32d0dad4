"""Explanations of flags and warnings, and the values behind a pixel's flags."""

from __future__ import annotations

import difflib
import inspect
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor.cube import (
    DOUBTFUL,
    ERROR_UNKNOWN,
    UNUSABLE,
    QualityFlag,
    WaterResidualCause,
)
from amulor.cube.schema import TERMS, flag_words
from amulor.errors import CubeError, FormatError
from amulor.imaging import edges, outliers
from amulor.io.netcdf import open_rows
from amulor.optics import ambiguity, ranging
from amulor.rejection import quality, subtraction
from amulor.rejection.covariance import isotropic
from amulor.rejection.joint import cube as joint
from amulor.rejection.joint.scatter import DETECTION
from amulor.rejection.observation import Observation
from amulor.rejection.reference import presence

#: Kinds of names, by the tables of amulor/cube/flags.toml.
_KINDS = {
    "pixel": "pixel flag",
    "cause": "water residual cause",
    "sample": "sample flag",
    "warning": "warning",
}


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """Explanation of a flag, a warning or a term of the error budget."""

    name: str
    """Name in files, pages and messages, in capitals with underscores."""
    kind: str
    """Kind of the name: flag, warning or error term."""
    meaning: str
    """Meaning of the flag, warning or error term."""
    compared: str
    """Quantity that is compared, and the limit that sets the flag."""
    chance: str
    """Rate of false alarms from noise alone, if known."""
    consequence: str
    """Consequence for the slant range or the sample."""
    remedy: str
    """Remedy for the operator."""


def explanations() -> dict[str, Explanation]:
    """All explanations by name, with the flags of pixels first."""
    limits, texts = _limits(), ("meaning", "compared", "chance", "remedy")
    by_name = {
        name: Explanation(
            name=name,
            kind=kind,
            consequence=words.get("consequence") or _consequence(table, name),
            **{text: words.get(text, "").format_map(limits) for text in texts},
        )
        for table, kind in _KINDS.items()
        for name, words in flag_words()[table].items()
    }
    return by_name | {explanation.name: explanation for explanation in _terms()}


def find(words: str) -> list[Explanation]:
    """Explanations for a name or a message; those of a similar name if none matches."""
    by_name = explanations()
    plain = re.sub(r"[^a-z]+", "_", words.lower()).strip("_")
    if plain.upper() in by_name:
        return [by_name[plain.upper()]]
    # Messages first, because they contain names of other explanations.
    matches = [
        by_name[name]
        for table in ("warning", "pixel")
        for name, words in flag_words()[table].items()
        if "message" in words and re.search(words["message"], plain)
    ]
    if not matches:
        padded = f"_{plain}_"
        matches = [
            explanation
            for name, explanation in by_name.items()
            if f"_{name.lower()}_" in padded
        ]
    if not matches:
        close = difflib.get_close_matches(plain, [name.lower() for name in by_name], 1)
        matches = [by_name[name.upper()] for name in close]
    if not matches:
        raise FormatError(
            f"nothing is known of {words[:60]!r}; there are {', '.join(by_name)}"
        )
    return matches


def _limits() -> dict[str, Any]:
    """Limits and false-alarm rates that replace placeholders in explanations."""
    from amulor.cube import readings
    from amulor.imaging import edges, outliers
    from amulor.optics import ambiguity
    from amulor.rejection import quality, subtraction
    from amulor.rejection.joint import cube as joint
    from amulor.rejection.reference import before_target
    from amulor.view.page import progress

    mixed = default_of(edges.flag_mixed, "significance")
    alone = default_of(outliers.flag_outliers, "significance")
    share = SimpleNamespace(
        no_target=_share(math.exp(-(quality.DETECTION_THRESHOLD**2) / 2)),
        disagreement=_share(ambiguity.DISAGREEMENT),
        misfit=_share(joint.DISAGREEMENT),
        mixed=_share(_tail(mixed)),
        alone=_share(_tail(alone)),
        drift=_share(progress.CHANCE),
    )
    return {
        "quality": quality,
        "subtraction": subtraction,
        "before_target": before_target,
        "ambiguity": ambiguity,
        "joint": joint,
        "outliers": outliers,
        "readings": readings,
        "progress": progress,
        "mixed": mixed,
        "alone": alone,
        "share": share,
    }


def _consequence(table: str, name: str) -> str:
    """Effect of a flag on the use of a pixel or sample, in words."""
    if table == "sample":
        from amulor.acquisition.sampler import SPOILED, SampleFlag

        spoiled = "is not used; amulor acquire --resume --retake-flagged repeats it"
        return f"The sample {spoiled if SampleFlag[name] & SPOILED else 'is used'}."
    flag = QualityFlag.WATER_RESIDUAL if table == "cause" else QualityFlag[name]
    if flag & UNUSABLE:
        return "The pixel has no range."
    if flag & ERROR_UNKNOWN:
        return (
            "All pixels keep their ranges, but the errors of the ranges are unknown. "
            "No file states an uncertainty. All pixels count as doubtful."
        )
    assert flag & DOUBTFUL, flag
    return "The pixel keeps its range, but the range is doubtful."


def _terms() -> list[Explanation]:
    types = {
        "A": "Type A: from repeated measurements.",
        "B": "Type B: stated, or computed from stated values.",
        "A, B": "Type A and B: from repeated measurements and from stated values.",
    }
    return [
        Explanation(
            name=f"TERM_{name.upper()}",
            kind="error term",
            meaning=f"{term.meaning[0].upper()}{term.meaning[1:]}.",
            compared=types[term.kind],
            chance="",
            consequence="A part of the standard uncertainty of the range.",
            remedy="amulor info FILE and amulor report print its size.",
        )
        for name, term in TERMS.items()
    ]


def lines_of(explanation: Explanation) -> list[str]:
    """Explanation as lines of text, each with a label."""
    parts: Iterable[tuple[str, str]] = (
        ("means", explanation.meaning),
        ("test", explanation.compared),
        ("by chance", explanation.chance),
        ("effect", explanation.consequence),
        ("what to do", explanation.remedy),
    )
    return [f"{label:>10}: {text}" for label, text in parts if text]


def hint(names: Iterable[str]) -> str:
    """Command that explains the first of the given flags, for use in a message."""
    first = next(iter(names), "")
    name = first.upper().replace(" ", "_")
    return f"amulor explain {name}" if name else ""


def default_of(function: object, name: str) -> float:
    """Default value of a function's argument, quoted as a limit in explanations."""
    value = inspect.signature(function).parameters[name].default  # type: ignore[arg-type]
    return float(value)


def _tail(sigma: float) -> float:
    """Probability that a normal error exceeds a number of standard deviations [1]."""
    return 0.5 * math.erfc(sigma / math.sqrt(2))


def _share(share: float) -> str:
    """Small fraction in words, to stand before a noun, such as "2 % of the"."""
    if share >= 1e-3:
        return f"{share * 100:.2g} % of the"
    return f"1 of {float(f'{1 / share:.2g}'):,.0f}"


#: Rows and columns around a pixel of an image on which its flags depend.
_AROUND = 12
_NO_FLAGS = (
    "no flags of pixels; name a target signal (amulor reject) or a range image "
    "(amulor image)"
)


@dataclass(frozen=True, kw_only=True)
class Reason:
    """Flag of a pixel, with the measured value and the condition that sets the flag."""

    flag: str
    """Name of the flag."""
    cause: str
    """Cause of the flag WATER_RESIDUAL; empty for other flags."""
    modulation_frequencies: tuple[float, ...] = ()
    """Frequencies of the samples; empty for the whole pixel [Hz]."""
    quantity: str
    """Quantity compared with a limit, or a statement where there is no number."""
    value: float | None = None
    """Measured value; None without one."""
    limit: str = ""
    """Condition on the value that sets the flag, such as "> 0.3"."""
    unit: str = ""
    """Unit of value and limit."""


def reasons(path: Path, row: int, column: int) -> dict[str, list[Reason]]:
    """Return the reasons for the flags of a pixel, by polarization channel."""
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
    """Yield the reasons for the flags of a channel, each once with its frequencies."""
    cube = tile.isel(polarization=[channel])
    frequencies = cube["modulation_frequency"].values
    at: dict[Reason, tuple[float, ...]] = {}
    for number, frequency in enumerate(frequencies):
        samples = cube.isel(modulation_frequency=[number])
        for reason in _reasons(_numbers_of(samples) | _phases(samples), cube.attrs):
            at[reason] = (*at.get(reason, ()), float(frequency))
    for reason, some in at.items():
        alone = len(some) < len(frequencies) or len(frequencies) == 1
        yield replace(reason, modulation_frequencies=some if alone else ())


def _of_image(tile: xr.Dataset, row: int, column: int) -> Iterator[Reason]:
    """Yield the reasons for the flags of one pixel of a range image."""
    numbers = _numbers_of(tile.isel(row=[row], column=[column]))
    numbers["clear_of_both"] = float(edges.clear_of_both(tile)[row, column])
    numbers["stand_off"] = float(outliers.stand_off(tile)[row, column])
    yield from _reasons(numbers, tile.attrs)


def _numbers_of(part: xr.Dataset) -> dict[str, float]:
    """Single-valued variables of a sample or pixel, by name."""
    numbers = {
        str(name): float(variable.item())
        for name, variable in part.data_vars.items()
        if variable.size == 1
    }
    near, far = "joint_nearer_surface", "joint_farther_surface"
    if near in numbers:
        numbers["apart"] = numbers[far] - numbers[near]
    return numbers


def _phases(sample: xr.Dataset) -> dict[str, float]:
    """Phase errors of a sample by noise, by residual water, and by both [rad]."""
    observation = Observation(cube=sample)
    signal, errors = observation.signal, observation.covariance
    measured = np.isfinite(signal)
    phases = {"phase_error": quality.phase_error(signal, errors, measured).item()}
    if "residual_in_phase" in sample:
        parts = (
            sample[f"residual_{part}"].values for part in ("in_phase", "quadrature")
        )
        in_phase, quadrature = parts
        residual = in_phase + 1j * quadrature
        shift = ranging.phase_shift(signal, residual=residual)
        phases["residual_phase"] = float(np.abs(shift).item())
        errors = errors + isotropic(math.sqrt(2) * np.nan_to_num(np.abs(residual)))
    phases["open_phase"] = quality.phase_error(signal, errors, measured).item()
    return phases


@dataclass(frozen=True)
class _Test:
    """Test of a measured value against the limit beyond which a flag is set."""

    flag: QualityFlag | WaterResidualCause
    key: str
    quantity: str
    relation: str = ""
    limit: float = math.nan
    unit: str = "1"

    def of(self, flag: QualityFlag, causes: WaterResidualCause) -> bool:
        """Whether this test explains a flag that has the given causes."""
        if isinstance(self.flag, WaterResidualCause):
            return flag == QualityFlag.WATER_RESIDUAL and self.flag in causes
        return self.flag == flag

    def given_by(self, value: float) -> bool:
        """Whether a value sets the flag; for a cause or no limit, any number does."""
        if not self.relation or isinstance(self.flag, WaterResidualCause):
            return not math.isnan(value)
        return value < self.limit if self.relation == "<" else value >= self.limit


def _tests(numbers: Mapping[str, float], attributes: Mapping[Any, Any]) -> list[_Test]:
    """All tests that set flags, with the limits that apply to a sample or pixel."""
    flag, cause = QualityFlag, WaterResidualCause
    channels = np.atleast_1d(attributes.get("channel_disagreement_limit", math.nan))
    margin = math.exp(-ambiguity.MARGIN / 2)
    wrong = joint.WRONG if "joint_detection" in numbers else margin / (1 + margin)
    phase = numbers.get("phase_error", math.nan)
    corner = "slant_range_uncertainty_corners"
    total, light = (
        numbers.get(key, 0.0) for key in ("slant_range_uncertainty", corner)
    )
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
              numbers.get("joint_departure_limit", math.nan), "m"),
        _Test(flag.WATER_RESIDUAL, "slant_range_bias",
              "estimated bias of the range", unit="m"),
        _Test(flag.NO_OPEN_WATER, "slant_range_bias",
              "estimated bias of the range", unit="m"),
        _Test(flag.MIXED, "clear_of_both",
              "off both surfaces around it, in standard errors", ">",
              default_of(edges.flag_mixed, "significance")),
        _Test(flag.MIXED, "range_spread",
              "standard deviation of the range in the beam", unit="m"),
        _Test(flag.MIXED, "apart", "distance of the two surfaces", unit="m"),
        _Test(flag.OUTLIER, "channel_disagreement",
              "phase off another channel, in units of its scatter", ">",
              float(channels.min())),
        _Test(flag.OUTLIER, "stand_off", "off its neighbors, in standard errors", ">",
              outliers.LEAST),
        _Test(flag.MOVED, "moved_probability", "chance of so different readings", "<",
              ambiguity.DISAGREEMENT),
        _Test(flag.CORNER, corner, "range error by light of the corner", ">",
              math.sqrt(max(total**2 - light**2, 0.0)), "m"),
    ]  # fmt: skip


def _reasons(
    numbers: dict[str, float], attributes: Mapping[Any, Any]
) -> Iterator[Reason]:
    """Yield reasons for each flag: values beyond limits, or a text if there is none."""
    flags = QualityFlag(int(numbers["quality_flag"]))
    causes = WaterResidualCause(int(numbers.get("water_residual_cause", 0)))
    if "residual_phase" in numbers:  # the angle is clearer than its ratio
        numbers.pop("residual_phase_ratio", None)
    if "joint_detection" in numbers:  # which looks for a target in all samples together
        numbers.pop("open_phase", None)
    tests = _tests(numbers, attributes)
    for flag in (bit for bit in QualityFlag if bit & flags):
        # Flags and causes have equal bits, so their names distinguish them.
        of_water = flag == QualityFlag.WATER_RESIDUAL and causes
        unexplained = [str(bit.name) for bit in (causes if of_water else flag)]
        for test in tests:
            value = numbers.get(test.key, math.nan)
            if test.of(flag, causes) and test.given_by(value):
                name = str(test.flag.name)
                unexplained = [bit for bit in unexplained if bit != name]
                yield Reason(
                    flag=str(flag.name),
                    cause="" if name == flag.name else name,
                    quantity=test.quantity,
                    value=value,
                    limit=f"{test.relation} {test.limit:.3g}" if test.relation else "",
                    unit=test.unit,
                )
        for name in unexplained:
            yield Reason(
                flag=str(flag.name),
                cause="" if name == flag.name else name,
                quantity=_words(name, attributes),
            )


def _words(name: str, attributes: Mapping[Any, Any]) -> str:
    """Text for a flag or cause whose measured value is not in the file."""
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
