"""`amulor calibrate platform`: patch test of an instrument on a vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from amulor.cli._arguments import UsageError, check_ending, check_inputs
from amulor.cli._output import print_json, print_next, print_table, progress_bar

if TYPE_CHECKING:
    from amulor.imaging.patch_test import PatchTest

_STEPS = """\
Overlapping lines show lever arm, boresight and clock of the instrument on its vehicle.
  1. Choose a rough place, such as stones or a wreck. A flat bed shows no shifts along
     itself.
  2. Measure the lever arm with a ruler. State it in rov.toml, with its uncertainty.
  3. Drive a line over the place, and the same line in the opposite direction.
  4. Drive a line across both, at another height and speed.
  5. On at least one line, let the vehicle roll and pitch by 5 degrees or more.
  6. Process each line: amulor reject, then amulor image
  7. amulor calibrate platform line-1.nc line-2.nc line-3.nc --trajectory track.csv \\
         --mounting rov.toml -o calibrated.toml
     If each line has its own trajectory, repeat --trajectory in the order of the lines.
  8. amulor export scan.nc --trajectory track.csv --mounting calibrated.toml \\
         -o cloud.laz
The command names the quantities that the lines do not determine, and a line to add."""

#: Units in which quantities are printed, and their factors.
_UNITS = [("mm", 1e3)] * 3 + [("deg", 180 / np.pi)] * 3 + [("ms", 1e3), ("ppm", 1e6)]


def platform(
    *lines: Path,
    trajectory: list[Path] | None = None,
    mounting: Path | None = None,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Estimate the mounting from overlapping lines; without lines, print the steps.

    Parameters
    ----------
    lines
        Range images (netCDF) of overlapping lines, from `amulor image`.
    trajectory
        Trajectory of all lines, from `amulor import trajectory`. If each line has one,
        repeat the option in the order of the lines.
    mounting
        TOML file with a section [mounting]: start values, with their uncertainties. By
        default the mounting of the survey.
    output
        File with the estimated mounting (TOML). Its plot is written beside it (PNG).
    overwrite
        Replace existing files.
    json
        Print the result as JSON.
    """
    if not lines:
        print(_STEPS)
        return
    if not trajectory:
        raise UsageError("--trajectory is missing: the poses of the vehicle")
    if output is None:
        raise UsageError("--output is missing; state it, such as -o calibrated.toml")
    check_ending("--output", output, [".toml"])
    check_inputs(*lines, *trajectory, mounting)

    from amulor import cube as cubes
    from amulor import imaging, io
    from amulor.io.files import atomic_output
    from amulor.io.trajectories import read_trajectory
    from amulor.platform import read_mounting
    from amulor.platform.mounting import mounting_text
    from amulor.view.patch_test import write_patch_test

    picture = output.with_suffix(".png")
    inputs = [*lines, *trajectory, *([] if mounting is None else [mounting])]
    for path in (output, picture):
        io.check_output(path, overwrite=overwrite, inputs=inputs)
    with progress_bar() as progress:
        progress("reading", 0.0)
        images = [io.read_cube(path) for path in lines]
        tracks = [read_trajectory(path) for path in trajectory]
        start = None if mounting is None else read_mounting(mounting)
        progress("comparing lines", 0.2)
        result = imaging.patch_test(images, trajectories=tracks, mounting=start)
    files = [f"#   {path.name} {cubes.digest(path)}" for path in inputs]
    text = "\n".join(["# By amulor calibrate platform, from:", *files, ""])
    with atomic_output(output, overwrite=overwrite) as temporary:
        temporary.write_text(text + mounting_text(result.mounting), encoding="utf-8")
    write_patch_test(picture, result, overwrite=overwrite)
    if json:
        print_json({"output": output, "plot": picture, **_content(result)})
        return
    print(
        f"{output}, {picture}: {result.points} points of {len(lines)} lines, scatter "
        f"{result.misfit:.2f} times the stated noise"
    )
    _print_quantities(result)
    print(
        f"  errors of the trajectory in one second: {1e3 * result.position_walk:.2g} "
        f"mm, {np.degrees(result.attitude_walk):.2g} deg"
    )
    for text in _advice(result):
        print(f"  {text}")
    print_next(
        f"amulor export scan.nc --trajectory {trajectory[0]} --mounting {output} "
        "-o cloud.laz"
    )


def _print_quantities(result: PatchTest) -> None:
    from amulor.imaging.patch_test import QUANTITIES

    rows = [
        [
            f"{name} [{unit}]",
            f"{factor * change:.3g}" if sigma else "",
            f"{factor * sigma:.2g}" if sigma else "not estimated",
            f"{factor * start:.2g}",
        ]
        for name, (unit, factor), change, sigma, start in zip(
            QUANTITIES, _UNITS, result.change, result.uncertainty,
            result.start_uncertainty, strict=True,
        )
    ]  # fmt: skip
    print_table("Mounting", ["", "change", "uncertainty", "before"], rows)


def _advice(result: PatchTest) -> list[str]:
    """Return a line of text for each quantity that the lines do not determine."""
    from amulor.imaging.patch_test import QUANTITIES

    texts = []
    for entry in result.undetermined:
        unit, factor = _UNITS[QUANTITIES.index(entry.quantity)]
        text = (
            f"{entry.quantity}: not determined by these lines "
            f"({factor * entry.uncertainty:.2g} {unit}, before "
            f"{factor * entry.start_uncertainty:.2g} {unit}); "
        )
        text += (
            f"add {entry.line} ({factor * entry.with_line:.2g} {unit})"
            if entry.line
            else "no further line helps much; measure it directly"
        )
        texts.append(text)
    return texts


def _content(result: PatchTest) -> dict[str, object]:
    """Return the result for JSON, in SI units."""
    from amulor.imaging.patch_test import QUANTITIES

    return {
        "mounting": result.mounting.model_dump(mode="python", exclude_none=True),
        "quantities": list(QUANTITIES),
        "change": result.change.tolist(),
        "covariance": result.covariance.tolist(),
        "start_uncertainty": result.start_uncertainty.tolist(),
        "undetermined": [vars(entry) for entry in result.undetermined],
        "points": result.points,
        "misfit": result.misfit,
        "position_walk": result.position_walk,
        "attitude_walk": result.attitude_walk,
    }
