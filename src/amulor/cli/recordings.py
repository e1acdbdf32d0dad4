"""`amulor import recordings`: what other software recorded becomes a cube."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def recordings(
    file: Path,
    /,
    *,
    survey: Path,
    columns: Path,
    output: Annotated[Path, Parameter(alias="-o")],
    temperature: float | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Turn a recording of other software into a measurement cube.

    Parameters
    ----------
    file
        Amplitude and phase, or X and Y, of each sample (CSV or HDF5).
    survey
        Survey file (TOML): instrument and scan.
    columns
        Column map (TOML): which column means what.
    output
        File to write (netCDF).
    temperature
        Which temperature, in degC, where the recording holds several.
    overwrite
        Replace a file that is there.
    """
    from amulor import io
    from amulor.cli._arguments import check_cube_output
    from amulor.io.recording_map import RecordingMap
    from amulor.io.recordings import read_recordings
    from amulor.survey import Survey

    check_cube_output(output, overwrite=overwrite, inputs=[file, survey, columns])
    described = RecordingMap.from_toml(columns)
    cube = read_recordings(
        file,
        described,
        Survey.from_toml(survey),
        temperature=temperature,
    )
    io.write_cube(cube, output, overwrite=overwrite)
    flag = cube["user_sample_flag"].values
    marked = ", ".join(
        f"{int((flag & mask != 0).sum())} {word.replace('_', ' ')}"
        for mask, word in zip(
            cube["user_sample_flag"].attrs["flag_masks"],
            cube["user_sample_flag"].attrs["flag_meanings"].split(),
            strict=True,
        )
        if (flag & mask != 0).any()
    )
    print(
        f"{output}: {cube.sizes['row']} x {cube.sizes['column']} pixels at "
        f"{cube.sizes['modulation_frequency']} frequencies in "
        f"{cube.sizes['polarization']} polarizations; marked: {marked or 'none'}"
    )
