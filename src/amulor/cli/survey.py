"""`amulor survey check` and `amulor survey schema`: check, and schema of surveys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from amulor.cli._arguments import check_inputs
from amulor.cli._output import print_json, print_next, progress_bar

if TYPE_CHECKING:
    from amulor.imaging.calibration_plan import CalibrationLine
    from amulor.rejection.reference.grid import Plan
    from amulor.simulation import Expectation
    from amulor.survey import Scan, Survey, WaterProperties


def check(
    file: Path, /, *, json: Annotated[bool, Parameter(negative="")] = False
) -> None:
    """Check a survey file.

    Parameters
    ----------
    file
        Survey file (TOML).
    json
        Print the survey in SI units, and the derived values, as JSON.
    """
    check_inputs(file)

    from amulor.survey import Survey

    survey = Survey.from_toml(file)

    from dataclasses import asdict

    from amulor.imaging.calibration_plan import calibration_plan, first_calibration
    from amulor.optics import ranging
    from amulor.rejection.channels import CROSS_POLARIZED
    from amulor.rejection.reference.grid import judge_plan
    from amulor.survey import water_properties
    from amulor.survey.directions import readings_in_turn
    from amulor.survey.properties import group_index_uncertainty
    from amulor.survey.reach import repetition, target_reach, unsettled_interval

    _open_meshes(survey)
    water = water_properties(survey)
    frequencies = survey.instrument.modulation_frequencies
    intervals = [
        float(ranging.ambiguity_interval(value, group_index=water.group_index))
        for value in frequencies
    ]
    reach = target_reach(survey)
    reason = unsettled_interval(survey, modulation_frequency=frequencies)
    with progress_bar(quiet=json) as advance:
        advance("what to expect", 0.0)
        plan = judge_plan(survey)
        expected, unknown = _expected(survey)
    middle = math.nan if reach is None else sum(reach) / 2
    errors = [] if reach is None else calibration_plan(survey, slant_range=middle)
    first = first_calibration(errors) if errors else None
    scan = survey.scan
    samples = len(frequencies) * len(survey.instrument.polarizations)
    seconds = scan.rows * scan.columns * scan.dwell * readings_in_turn(survey)
    platform = None if survey.platform is None else _footprint(survey, reach)
    if json:
        print_json(
            {
                "survey": survey.model_dump(mode="python", exclude_none=True),
                "water": _water(water)
                | {"group_index_uncertainty": group_index_uncertainty(survey)},
                "ambiguity_interval_m": intervals,
                "phases_repeat_after_m": repetition(
                    frequencies, group_index=water.group_index
                ),
                "target_reach_m": reach,
                "interval_unsettled": reason,
                "open_water_plan": None if plan is None else asdict(plan),
                "scan_time_s": seconds,
                "platform": platform,
                "expected": None if expected is None else asdict(expected),
                "instrument_errors": [asdict(line) for line in errors],
                "calibrate_first": None if first is None else first.how,
            }
        )
        return
    print(f"{file}: {survey.name}")
    print(
        f"  {scan.columns} x {scan.rows} pixels, {samples} samples each, "
        f"{seconds:.0f} s; {len(survey.targets)} targets"
    )
    if platform is not None:
        _print_platform(platform)
    _print_water(water)
    _warn_of_state(survey, water, reach)
    for value, interval in zip(frequencies, intervals, strict=True):
        print(f"  {value / 1e6:g} MHz: unambiguous over {interval:.3f} m")
    if reach is not None:
        print(f"  beams meet targets at {reach[0]:.4g} to {reach[1]:.4g} m")
    if expected is not None:
        dark = () if water.depolarization_known else CROSS_POLARIZED
        _print_expected(survey, expected, dark)
    elif unknown:
        print(f"  what to expect is not known: {unknown}")
    if errors:
        _print_errors(errors, first, middle)
    if plan is not None and not plan.holds:
        _warn_of_sparse_shots(scan, plan)
    if scan.open_water is None:
        print(
            "  note: no open-water reference measurement is planned; without one only "
            "joint (two or more frequencies), unmix (ratios known) and "
            "cross-polarized work: add [scan.open_water]"
        )
    if reason and survey.targets:
        print(
            f"  warning: {reason}; add a frequency, or state --nearest and --farthest "
            "in amulor image"
        )
    print_next(f"amulor simulate {file} -o samples.nc")


def _footprint(
    survey: Survey, reach: tuple[float, float] | None
) -> dict[str, float | str | None]:
    """Return distances of a scan from a vehicle: track, rows, readings, columns."""
    import numpy as np

    from amulor.survey.course import planned_spacing, planned_track
    from amulor.survey.directions import reading_windows

    platform = survey.platform
    assert platform is not None
    track, duration = planned_track(survey)
    speed = track / duration
    middle, length = reading_windows(survey)
    distance = math.nan if reach is None else sum(reach) / 2
    between_rows, between_columns = planned_spacing(survey, distance)
    return {
        "course": platform.course.kind,
        "speed_m_per_s": speed,
        "track_m": track,
        "between_rows_m": between_rows,
        "along_readings_m": speed * float(np.ptp(middle) + length),
        "between_columns_m": None if reach is None else between_columns,
    }


def _print_platform(platform: Mapping[str, Any]) -> None:
    """Print the distances of a scan from a vehicle."""
    print(
        f"  vehicle: {platform['course']}, {platform['speed_m_per_s']:.3g} m/s, track "
        f"of {platform['track_m']:.3g} m"
    )
    beside = platform["between_columns_m"]
    text = "" if beside is None else f", {1e3 * beside:.3g} mm between columns"
    print(f"    {1e3 * platform['between_rows_m']:.3g} mm between rows{text}")
    along = platform["along_readings_m"]
    print(f"    readings of a pixel along {1e3 * along:.3g} mm of the track")
    if along > platform["between_rows_m"] or along > (beside or math.inf):
        print(
            "    warning: the readings of a pixel are farther apart than neighboring "
            'pixels; shorten the dwell, or read at once (platform.readings = "at-once")'
        )


def _open_meshes(survey: Survey) -> None:
    """Read the mesh files of a survey, so that unreadable ones are reported."""
    from amulor.errors import MissingExtraError
    from amulor.simulation import scene
    from amulor.survey import Mesh

    for target in survey.targets:
        if isinstance(target, Mesh):
            with suppress(MissingExtraError):
                scene.triangles(target)


#: Signal over noise below which a channel is worth a warning [1].
_WEAK = 5.0


def _expected(survey: Survey) -> tuple[Expectation | None, str]:
    """Return the expected quality of samples, or why it is unknown."""
    from amulor.errors import AmulorError
    from amulor.simulation import expectation

    if not survey.targets:
        return None, ""
    try:
        return expectation(survey), ""
    except AmulorError as error:
        return None, str(error)


def _print_expected(
    survey: Survey, expected: Expectation, dark: tuple[str, ...]
) -> None:
    """Print the expected quality of samples, with warnings.

    The water signal of `dark` channels is unknown.
    """
    print(f"  {expected.hit:.0%} of the beams meet a target")
    for number, target in enumerate(survey.targets):
        if expected.hit_each[number] == 0:
            print(
                f"  warning: no beam meets targets.{number} ({target.kind}): "
                f"{_whereabouts(survey, target.position)}"
            )
    if not expected.hit:
        return
    for frequency, ratios, waters in zip(
        survey.instrument.modulation_frequencies,
        expected.signal_to_noise,
        expected.water_to_echo,
        strict=True,
    ):
        for channel, ratio, water in zip(
            survey.instrument.polarizations, ratios, waters, strict=True
        ):
            print(
                f"  {frequency / 1e6:g} MHz {channel}: echo over noise {ratio:.3g}, "
                f"water over echo {'not known' if channel in dark else f'{water:.2g}'}"
            )
            if ratio < _WEAK:
                print(
                    f"  warning: {channel} at {frequency / 1e6:g} MHz is mostly noise; "
                    "more power, a longer dwell or a nearer target"
                )
    if expected.saturated:
        print(
            f"  warning: {expected.saturated:.0%} of the samples overload the detector "
            f"({survey.instrument.detector.saturation:g} V); less power or gain"
        )


def _print_errors(
    lines: list[CalibrationLine], first: CalibrationLine | None, slant_range: float
) -> None:
    """Print the instrument's range errors, without and with each calibration."""
    print(f"  errors by the instrument at {slant_range:.3g} m (standard uncertainty):")
    for line in lines:
        now = "unknown" if line.now is None else f"{1e3 * line.now:.2g} mm"
        print(
            f"    {line.name}: {now}, calibrated {1e3 * line.calibrated:.2g} mm "
            f"({line.how})"
        )
    known = [line.now for line in lines if line.now is not None]
    total = f"{1e3 * math.hypot(*known):.2g} mm"
    if len(known) < len(lines):
        total = f"more than {total}"
    after = math.hypot(*(line.calibrated for line in lines))
    print(f"    total: {total}, all calibrated {1e3 * after:.2g} mm")
    if first is not None:
        print(f"    do first: {first.how} ({first.name})")


def _whereabouts(survey: Survey, position: tuple[float, float, float]) -> str:
    """Describe why no beam meets a target: behind, beside the scan, or hidden."""
    right, down, forward = (
        value - origin
        for value, origin in zip(
            position, survey.instrument.emitter.position, strict=True
        )
    )
    if forward <= 0:
        return f"it stands {-forward:.3g} m behind the instrument"
    scan = survey.scan
    directions = []
    for name, angle, middle, span in (
        ("azimuth", math.atan2(right, forward), scan.azimuth, scan.azimuth_span),
        ("elevation", math.atan2(-down, forward), scan.elevation, scan.elevation_span),
    ):
        low, high = middle - span / 2, middle + span / 2
        if not low <= angle <= high:
            directions.append(
                f"its center has {name} {math.degrees(angle):.3g} degrees, the scan "
                f"{math.degrees(low):.3g} to {math.degrees(high):.3g}"
            )
    return (
        "; ".join(directions) or "another target hides it, or it lies between two beams"
    )


def _water(water: WaterProperties) -> dict[str, Any]:
    """Return the water's optical properties at the wavelength, for JSON."""
    from dataclasses import fields

    function = water.phase_function
    values = {
        field.name: getattr(water, field.name)
        for field in fields(water)
        if field.name not in ("phase_function", "layers")
    }
    return {
        **values,
        "phase_function": None if function is None else function.description,
        "asymmetry": None if function is None else function.asymmetry,
        "backscatter_fraction": (
            None if function is None else function.backscatter_fraction
        ),
        "layers": [
            {
                "thickness": None if math.isinf(layer.thickness) else layer.thickness,
                "absorption": layer.absorption,
                "scattering": layer.scattering,
                "phase_function": layer.phase_function.description,
            }
            for layer in water.layers
        ],
    }


def _print_water(water: WaterProperties) -> None:
    """Print the water's optical properties at the wavelength."""
    print(
        f"  water: attenuation {water.attenuation:.4g} 1/m, group index "
        f"{water.group_index:.4f}; {water.source}"
    )
    print(
        f"    absorption {water.absorption:.4g} 1/m, scattering "
        f"{water.scattering:.4g} 1/m, at 180 degrees {water.backscatter_vsf:.3g} "
        "1/(m sr)"
    )
    function = water.phase_function
    if function is None:
        print(
            f"    phase function by moments: second moment {water.second_moment:.3g} "
            f"rad^2 below {math.degrees(water.split_angle):.3g} degrees"
        )
    else:
        print(f"    phase function: {function.description}")
        print(
            f"    asymmetry {function.asymmetry:.4f}, backscatter fraction "
            f"{function.backscatter_fraction:.4g}"
        )
    for number, layer in enumerate(water.layers, start=1):
        extent = (
            "from there on"
            if math.isinf(layer.thickness)
            else f"{layer.thickness:g} m thick"
        )
        print(
            f"    layer {number}: {extent}, absorption {layer.absorption:.4g} 1/m, "
            f"scattering {layer.scattering:.4g} 1/m, {layer.phase_function.name}"
        )


def _warn_of_state(
    survey: Survey, water: WaterProperties, reach: tuple[float, float] | None
) -> None:
    """Warn about missing water properties that affect the ranges or channels."""
    from amulor.rejection.channels import CROSS_POLARIZED
    from amulor.survey.properties import group_index_uncertainty

    description = survey.water
    missing = [
        name
        for name in ("salinity", "temperature")
        if getattr(description, name) is None
    ]
    error = group_index_uncertainty(survey)
    if missing and description.group_index is None and error is not None:
        distance = 1.0 if reach is None else reach[1]
        off = distance * error / water.group_index
        print(
            f"  warning: {' and '.join(missing)} of the water not stated: range "
            f"uncertain by {1e3 * off:.2g} mm at {distance:.3g} m (standard "
            f"uncertainty); state {' and '.join(f'water.{name}' for name in missing)}"
        )
    crossed = [
        pair for pair in survey.instrument.polarizations if pair in CROSS_POLARIZED
    ]
    if crossed and not water.depolarization_known:
        print(
            f"  warning: how much of the water signal {', '.join(crossed)} sees is not "
            "known: water stated by coefficients or layers keeps polarization here, "
            "waters of the sea lose a fifth of it; state water.backscatter_mueller"
        )


def _warn_of_sparse_shots(scan: Scan, plan: Plan) -> None:
    shots = scan.open_water
    assert shots is not None
    remedy = "no grid of shots is enough for so wide a scan: split it into parts"
    if plan.enough is not None:
        columns, rows = plan.enough
        remedy = f"plan at least {columns} x {rows} directions (scan.open_water)"
    wrong = (
        f"will be refused: {plan.refused}"
        if plan.refused
        else f"miss up to {plan.error:.1%} of the water signal between them"
    )
    print(
        f"  warning: {shots.columns} x {shots.rows} open-water shots {wrong}; {remedy}"
    )


def schema() -> None:
    """Print the JSON Schema of survey files."""
    from amulor.survey import json_schema

    print_json(json_schema())
