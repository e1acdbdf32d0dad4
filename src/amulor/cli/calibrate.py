"""`amulor calibrate`: errors of an instrument, measured at a bench."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from amulor.cli._arguments import UsageError, check_ending, check_inputs
from amulor.cli._output import print_json, print_next, print_table

if TYPE_CHECKING:
    import xarray as xr

    from amulor.acquisition import Calibration

_LEAKAGE_STEPS = """\
Leakage is the output with the laser on and no light from the water.
  1. Switch the instrument on, and wait until it is as warm as in a scan.
  2. Close the shutter in front of the detector, or put the cap on. Leave the laser on.
  3. amulor acquire tank.toml --devices devices.toml -o closed-1 --shutter-closed
  4. Open the shutter, and acquire the scan.
  5. Close the shutter, and repeat step 3 with -o closed-2.
  6. amulor calibrate leakage closed-1/cube.nc closed-2/cube.nc -o leakage.toml
  7. amulor recover scan --calibration leakage.toml --overwrite
If the devices file has a section [shutter], acquire takes these readings itself."""
_PLATE_STEPS = """\
A plate at known distances shows the phase zero at each modulation frequency.
  1. Measure the leakage first: amulor calibrate leakage
  2. Put a plate at right angles to the beam. It fills the middle half of the scan.
     Measure its distance along the beam, and the uncertainty of this distance.
  3. amulor acquire plate.toml --devices devices.toml -o plate-1 \\
         --calibration leakage.toml
  4. amulor reject plate-1/cube.nc --method open-water -o plate-1.nc
  5. Repeat steps 3 and 4 at other distances. They show the error by frequency and
     the group index.
  6. At one distance, repeat steps 3 and 4 through at least three neutral filters in
     front of the detector. They show the dependence of the phase on the amplitude.
  7. amulor calibrate plate plate-1.nc plate-2.nc --distance "1.5 m, 2.5 m" \\
         --distance-uncertainty "1 mm" -o calibration.toml
     With filters, add the optical density of each cube: --densities 0,0.5,1,1.5
  8. amulor recover scan --calibration calibration.toml --overwrite"""

_DEMODULATOR_STEPS = """\
The outputs of the demodulator have an offset, unequal gains, and an angle that is not
exactly 90 degrees.
  1. Switch the demodulator on, and wait until it is as warm as in a scan.
  2. Disconnect the detector. Connect 50 ohm to the input of the demodulator.
  3. amulor acquire tank.toml --devices devices.toml -o silent --shutter-closed
  4. Connect the modulation signal of the laser to the input, through an attenuator.
     The outputs are about as large as those of the echo, and their amplitude does not
     change in the further steps.
  5. amulor acquire tank.toml --devices devices.toml -o turn-1 --shutter-closed
  6. Turn the phase of the reference signal, or change the cable, and repeat step 5. At
     least five recordings cover a whole turn at each frequency, such as every 45
     degrees. The phases need not be known.
  7. amulor calibrate demodulator silent/cube.nc turn-1/cube.nc turn-2/cube.nc ... \\
         -o demodulator.toml
     With silent/cube.nc alone, only the offset is measured.
  8. amulor calibrate leakage closed/cube.nc --calibration demodulator.toml \\
         -o leakage.toml
Apply the file to all plates and scans. Dark readings contain the offset already; it is
subtracted only from scans without dark readings and leakage."""

_POLARIZER_STEPS = """\
A turned polarizer shows the gain, the phase and the cross-talk of two channels.
  1. Put a white plate in front of the instrument, in air or clear water.
  2. Mount a polarizer with a scale in front of the receiver. Its extinction is better
     than that of the analyzers. It does not stand in the beam of the laser.
  3. Measure the leakage first: amulor calibrate leakage
  4. Turn the polarizer to 0 degrees, and acquire the plate:
     amulor acquire plate.toml --devices devices.toml -o angle-0 \\
         --calibration leakage.toml
  5. Repeat step 4 at 30, 60, 90, 120 and 150 degrees.
  6. amulor calibrate polarizer angle-0/cube.nc angle-30/cube.nc angle-60/cube.nc \\
         angle-90/cube.nc angle-120/cube.nc angle-150/cube.nc \\
         --angles 0,30,60,90,120,150 -o channels.toml
  7. Go on with: amulor calibrate plate
     Acquire its plates with --calibration channels.toml
The zero of the scale does not matter. The polarization of the laser is not measured."""

_REFERENCE_STEPS = """\
The phase of a standing reference shows the drift of the instrument before each row.
  1. Mount a small target, or the end of a fiber that returns light, beside the scan.
     The beam can reach it, and its optical path does not change. Its echo is about as
     strong as that of the target.
  2. State its direction and amplitude in the section [scan.reference] of each survey.
  3. Acquire the plate of the phase calibration with this section:
     amulor acquire plate.toml --devices devices.toml -o plate-1 \\
         --calibration leakage.toml
  4. amulor calibrate reference plate-1/cube.nc --calibration leakage.toml \\
         -o reference.toml
  5. amulor recover plate-1 --calibration reference.toml --overwrite
  6. Go on with step 4 of: amulor calibrate plate
     Acquire further plates with --calibration reference.toml
Later scans are corrected to the phase of this day, so that drift since then, by age or
temperature, does not change their ranges."""

_TEMPERATURE_STEPS = """\
Phases depend on the temperature of the instrument: cables, laser and detector.
  1. Fix a plate at right angles to the beam. Only the temperature of the instrument may
     change; in a tank, the temperature of the water stays constant.
  2. Warm or cool the instrument, and wait until its temperature is constant.
  3. State the temperature in the section [scan] of a copy of the survey, such as
     instrument_temperature = "15 degC", and acquire the plate:
     amulor acquire plate-15.toml --devices devices.toml -o run-15 \\
         --calibration leakage.toml
  4. amulor reject run-15/cube.nc --method open-water -o run-15.nc
  5. Repeat steps 2 to 4 at two or more other temperatures. Span those of the scans.
  6. amulor calibrate temperature run-15.nc run-20.nc run-25.nc -o temperature.toml
  7. Go on with: amulor calibrate plate
     Acquire its plates with --calibration temperature.toml
State instrument_temperature in the survey of each later scan. Without it, the error
contains the effect of all temperatures of the run."""


def leakage(
    *cubes: Path,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    calibration: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Measure leakage with a closed shutter; without cubes, print the steps.

    Parameters
    ----------
    cubes
        Cubes (netCDF) of "amulor acquire --shutter-closed", in the order of recording.
    output
        Calibration file to write (TOML). Its plot is written beside it (PNG).
    calibration
        Calibration file whose phases are copied to the output (TOML).
    overwrite
        Replace existing files.
    json
        Print the result as JSON.
    """
    if not cubes:
        print(_LEAKAGE_STEPS)
        return
    from amulor import acquisition

    _measure(
        cubes, output, acquisition.from_shutter, replaced="leakage",
        calibration=calibration, overwrite=overwrite, json=json,
    )  # fmt: skip


def demodulator(
    *cubes: Path,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    calibration: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Measure errors of the demodulator outputs; without cubes, print the steps.

    Parameters
    ----------
    cubes
        Cube (netCDF) with 50 ohm at the input. Then, cubes of a signal of constant
        amplitude at five or more phases, all of "amulor acquire --shutter-closed".
    output
        Calibration file to write (TOML). Its plot is written beside it (PNG).
    calibration
        Calibration file whose other parts are copied to the output (TOML).
    overwrite
        Replace existing files.
    json
        Print the result as JSON.
    """
    if not cubes:
        print(_DEMODULATOR_STEPS)
        return
    from amulor import acquisition

    _measure(
        cubes, output, lambda scans: acquisition.from_terminated(scans[0], scans[1:]),
        replaced="demodulator", calibration=calibration, overwrite=overwrite, json=json,
    )  # fmt: skip


def polarizer(
    *cubes: Path,
    angles: str | None = None,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Measure gain and cross-talk of channels; without cubes, print the steps.

    Parameters
    ----------
    cubes
        Cubes (netCDF) of a plate behind a turned polarizer, with two orthogonal
        channels such as VV and VH.
    angles
        Angle of the polarizer in each cube in degrees, such as "0,30,60,90,120,150".
    output
        Calibration file to write (TOML). Its plot is written beside it (PNG).
    overwrite
        Replace existing files.
    json
        Print the result as JSON.
    """
    if not cubes:
        print(_POLARIZER_STEPS)
        return
    from amulor import acquisition

    if angles is None:
        raise UsageError("--angles is missing; state it, such as --angles 0,30,60,90")
    values = [math.radians(value) for value in _numbers("--angles", angles)]
    _measure(
        cubes, output, lambda scans: acquisition.from_polarizer(scans, angles=values),
        overwrite=overwrite, json=json,
    )  # fmt: skip


def reference(
    *cubes: Path,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    calibration: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Record the phase of a standing reference; without a cube, print the steps.

    Parameters
    ----------
    cubes
        Cube (netCDF) of the plate of a phase calibration, with [scan.reference].
    output
        Calibration file to write (TOML). Its plot is written beside it (PNG).
    calibration
        Calibration file whose other parts are copied to the output (TOML).
    overwrite
        Replace existing files.
    json
        Print the result as JSON.
    """
    if not cubes:
        print(_REFERENCE_STEPS)
        return
    if len(cubes) > 1:
        raise UsageError(f"{len(cubes)} cubes: one is needed, of one plate")
    from amulor import acquisition

    _measure(
        cubes, output, lambda scans: acquisition.from_reference(scans[0]),
        replaced="reference", calibration=calibration, overwrite=overwrite, json=json,
    )  # fmt: skip


def temperature(
    *cubes: Path,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    calibration: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Measure the phase against temperature; without cubes, print the steps.

    Parameters
    ----------
    cubes
        Target signals of a fixed plate, from "amulor reject" (netCDF), at three or more
        temperatures that their surveys state.
    output
        Calibration file to write (TOML). Its plot is written beside it (PNG).
    calibration
        Calibration file whose leakage is copied to the output (TOML).
    overwrite
        Replace existing files.
    json
        Print the result as JSON.
    """
    if not cubes:
        print(_TEMPERATURE_STEPS)
        return
    from amulor import acquisition

    _measure(
        cubes, output, acquisition.from_temperatures,
        replaced="temperature", calibration=calibration, overwrite=overwrite, json=json,
    )  # fmt: skip


def plate(
    *cubes: Path,
    distance: str | None = None,
    distance_uncertainty: str | None = None,
    densities: str | None = None,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Measure phase zero with plates at distances; without cubes, print the steps.

    Parameters
    ----------
    cubes
        Target signals of a plate, from "amulor reject" (netCDF). They differ by the
        distance of the plate or by the density of a neutral filter.
    distance
        Forward coordinate of the plate: one for all cubes, such as "1.5 m", or one for
        each in their order, such as "1.5 m, 2.5 m".
    distance_uncertainty
        Standard uncertainty of each distance, such as "1 mm".
    densities
        Optical density of the filter of each cube, such as "0,0.5,1,1.5".
    output
        Calibration file to write (TOML). Its plot is written beside it (PNG).
    overwrite
        Replace existing files.
    json
        Print the result as JSON.
    """
    if not cubes:
        print(_PLATE_STEPS)
        return
    from amulor import acquisition
    from amulor.cli._arguments import quantity_of

    if distance is None:
        raise UsageError('--distance is missing; state it, such as --distance "1.5 m"')
    lengths = [
        quantity_of("--distance", text, "length") for text in distance.split(",")
    ]
    uncertainty = (
        None
        if distance_uncertainty is None
        else quantity_of("--distance-uncertainty", distance_uncertainty, "length")
    )
    values = None if densities is None else _numbers("--densities", densities)
    if values is not None and not all(0 <= value <= 10 for value in values):
        raise UsageError(f"--densities {densities}: optical densities are from 0 to 10")

    def measure(plates: Sequence[xr.Dataset]) -> Calibration:
        return acquisition.from_plates(
            plates,
            distance=lengths[0] if len(lengths) == 1 else lengths,
            distance_uncertainty=uncertainty,
            densities=values,
        )

    _measure(cubes, output, measure, overwrite=overwrite, json=json)


def _numbers(option: str, text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise UsageError(
            f"{option} {text}: needed are numbers with commas, such as 0,0.5,1"
        ) from None
    if not all(map(math.isfinite, values)):
        raise UsageError(f"{option} {text}: needed are finite numbers")
    return values


def _measure(
    cubes: Sequence[Path],
    output: Path | None,
    measure: Callable[[Sequence[xr.Dataset]], Calibration],
    *,
    replaced: str = "",
    calibration: Path | None = None,
    overwrite: bool,
    json: bool,
) -> None:
    """Read cubes, calibrate, write file and plot, print the result.

    All of an earlier `calibration` is kept but the part `replaced`.
    """
    if output is None:
        raise UsageError("--output is missing; state a file, such as -o leakage.toml")
    check_ending("--output", output, [".toml"])
    check_inputs(*cubes, calibration)

    from amulor import acquisition, io
    from amulor import cube as package
    from amulor.cli._arguments import refusing
    from amulor.io.files import atomic_output
    from amulor.view.calibration import write_calibration

    picture = output.with_suffix(".png")
    inputs = [*cubes, *([] if calibration is None else [calibration])]
    for path in (output, picture):
        io.check_output(path, overwrite=overwrite, inputs=inputs)
    with refusing():
        result = measure([io.read_cube(path) for path in cubes])
    if calibration is not None:
        earlier = acquisition.Calibration.from_toml(calibration)
        if replaced == "temperature" and earlier.frequencies:
            raise UsageError(
                f"{calibration} has phases of a plate, which refer to another "
                "temperature; calibrate the temperature first, and then the plate"
            )
        update = {"date": result.date, replaced: getattr(result, replaced)}
        update["reference_temperature"] = (
            result.reference_temperature or earlier.reference_temperature
        )
        result = earlier.model_copy(update=update)
    digests = tuple(package.digest(path) for path in inputs)
    result = result.model_copy(update={"inputs": digests})
    with atomic_output(output, overwrite=overwrite) as temporary:
        temporary.write_text(result.to_toml(), encoding="utf-8")
    write_calibration(picture, result, overwrite=overwrite)
    if json:
        print_json(
            {"output": output, "digest": package.digest(output), "plot": picture}
            | result.model_dump(mode="python")
            | {"date": None if result.date is None else result.date.isoformat()}
        )
        return
    day = "" if result.date is None else f"measured on {result.date}, "
    print(f"{output}: {day}{package.digest(output)}")
    print(f"{picture}: plot")
    _print_leakage(result)
    _print_demodulator(result)
    _print_channels(result)
    _print_reference(result)
    _print_temperature(result)
    _print_phases(result)
    print_next(f"amulor recover scan --calibration {output} --overwrite")


def _print_leakage(calibration: Calibration) -> None:
    if not calibration.leakage:
        return
    rows = [
        [
            f"{leak.modulation_frequency / 1e6:g} MHz {leak.polarization}",
            f"{1e6 * math.hypot(*leak.scan):.3g}",
            f"{1e6 * leak.scan_uncertainty:.2g}",
            f"{1e6 * math.hypot(*leak.open_water):.3g}",
            f"{1e6 * leak.open_water_uncertainty:.2g}",
            "" if leak.change is None else f"{1e6 * leak.change:.2g}",
        ]
        for leak in calibration.leakage
    ]
    header = ["", "scan", "u(scan)", "references", "u(references)", "change"]
    print_table("Leakage [uV]", header, rows)


def _print_demodulator(calibration: Calibration) -> None:
    if not calibration.demodulator:
        return
    rows = []
    for entry in calibration.demodulator:
        of_gain = entry.quadrature_gain_uncertainty
        of_phase = entry.quadrature_phase_uncertainty
        unknown = of_gain is None or of_phase is None
        rows.append(
            [
                f"{entry.modulation_frequency / 1e6:g} MHz",
                f"{1e6 * entry.offset[0]:+.3g} {1e6 * entry.offset[1]:+.3g}",
                f"{1e6 * entry.offset_uncertainty:.2g}",
                "unknown" if unknown else f"{100 * entry.quadrature_gain:+.3f}",
                "" if of_gain is None else f"{100 * of_gain:.3f}",
                "" if unknown else f"{math.degrees(entry.quadrature_phase):+.3f}",
                "" if of_phase is None else f"{math.degrees(of_phase):.3f}",
            ]
        )
    header = ["", "offset [uV]", "u", "gain [%]", "u", "angle [deg]", "u"]
    print_table("Demodulator outputs", header, rows)


def _print_channels(calibration: Calibration) -> None:
    if not calibration.channels:
        return
    rows = []
    for entry in calibration.channels:
        size, phase = math.hypot(*entry.gain), math.atan2(*entry.gain[::-1])
        rows.append(
            [
                f"{entry.modulation_frequency / 1e6:g} MHz {entry.polarization}",
                f"{100 * entry.crosstalk:.3f}",
                f"{100 * entry.crosstalk_uncertainty:.3f}",
                f"{size:.4f}",
                f"{entry.gain_uncertainty:.4f}",
                f"{1e3 * phase:+.2f}",
                f"{1e3 * entry.gain_uncertainty / size:.2f}",
            ]
        )
    header = ["", "cross-talk [%]", "u", "gain", "u", "phase [mrad]", "u"]
    print_table("Channels", header, rows)


def _print_reference(calibration: Calibration) -> None:
    if not calibration.reference:
        return
    rows = [
        [
            f"{entry.modulation_frequency / 1e6:g} MHz {entry.polarization}",
            f"{entry.phase:+.4f}",
            f"{entry.uncertainty:.5f}",
            f"{max(entry.changes) - min(entry.changes):.4f}",
        ]
        for entry in calibration.reference
    ]
    header = ["", "phase", "u(phase)", "change"]
    print_table("Standing reference [rad]", header, rows)


def _print_temperature(calibration: Calibration) -> None:
    if not calibration.temperature:
        return
    rows = []
    for entry in calibration.temperature:
        delay = entry.phase_per_degree / (2 * math.pi * entry.modulation_frequency)
        rows.append(
            [
                f"{entry.modulation_frequency / 1e6:g} MHz",
                f"{1e3 * entry.phase_per_degree:+.3f}",
                f"{1e3 * entry.uncertainty:.3f}",
                f"{1e12 * delay:+.2f}",
            ]
        )
    header = ["", "phase", "u(phase)", "delay [ps]"]
    print_table("Change per degree [mrad]", header, rows)
    print(f"phases refer to {calibration.reference_temperature:.1f} degC")


def _print_phases(calibration: Calibration) -> None:
    if not calibration.frequencies:
        return
    rows = []
    for entry in calibration.frequencies:
        errors = entry.phase_uncertainties or (math.nan,) * len(entry.phases)
        for amplitude, phase, error in zip(
            entry.amplitudes, entry.phases, errors, strict=True
        ):
            rows.append(
                [
                    f"{entry.modulation_frequency / 1e6:g} MHz",
                    f"{1e3 * amplitude:.3g}",
                    f"{phase:+.4f}",
                    f"{error:.4f}",
                ]
            )
    print_table("Phase zero [rad]", ["", "at [mV]", "phase", "u(phase)"], rows)
    delay = calibration.delay_uncertainty
    if delay is None:
        print("uncertainty of the delay unknown: state --distance-uncertainty")
    else:
        print(f"uncertainty of the delay: {1e12 * delay:.2g} ps")
    if calibration.filters:
        cells = [
            [f"{f.density:g}", f"{f.transmission:.4g}", f"{f.uncertainty:.2g}"]
            for f in calibration.filters
        ]
        print_table("Filters", ["density", "transmission", "u"], cells)
    gain, of_gain = calibration.gain_change, calibration.gain_change_uncertainty
    if gain is not None and of_gain is not None:
        print(
            f"change of the gain at the largest amplitude: {100 * gain:+.2g} +- "
            f"{100 * of_gain:.2g} %"
        )
    index, of_index = calibration.group_index, calibration.group_index_uncertainty
    if index is not None:
        known = "" if of_index is None else f" +- {of_index:.2g}"
        print(f"group index by the distances: {index:.4f}{known} (not applied)")
