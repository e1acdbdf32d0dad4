"""`amulor recover`: makes the cube of a scan from its journal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def recover(
    folder: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    calibration: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Make the cube of a scan from its journal.

    Parameters
    ----------
    folder
        Folder that "amulor acquire" was given; the scan may be unfinished or going on.
    output
        File to write (netCDF); cube.nc in the folder by default.
    calibration
        Calibration file (TOML) that "amulor devices calibrate" wrote.
    overwrite
        Replace a file that is there.
    """
    from amulor import acquisition, io
    from amulor.cli._arguments import CUBE_ENDINGS, check_ending

    if output is not None:
        check_ending("--output", output, CUBE_ENDINGS)
    known = None
    if calibration is not None:
        known = acquisition.Calibration.from_toml(calibration)
    path = acquisition.recover(
        folder, output=output, calibration=known, overwrite=overwrite
    )
    missing = int(io.read_cube(path)["in_phase"].isnull().sum())
    print(f"{path}: {missing} samples missing")
