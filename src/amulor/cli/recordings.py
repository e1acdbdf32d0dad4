"""`amulor import recordings`: import of recordings from other software."""

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
    tile_rows: int | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Convert a recording of other software to a measurement cube.

    Parameters
    ----------
    file
        Recorded samples (CSV or HDF5): amplitude and phase, or X and Y.
    survey
        Survey file (TOML) with the instrument and the scan.
    columns
        Column map (TOML), which assigns columns to quantities.
    output
        File to write (netCDF).
    temperature
        Temperature to import [degC], if the recording has several.
    tile_rows
        Import this many rows at a time, with bounded memory. Scans of more than 2.1
        million samples are always imported by rows.
    overwrite
        Replace an existing file.
    """
    from amulor.cli._arguments import check_cube_output, check_tile_rows
    from amulor.cli._output import print_next, progress_bar
    from amulor.cube.tiles import is_large
    from amulor.io.recording_table import RecordingMap
    from amulor.io.recordings import marked, read_recordings
    from amulor.survey import Survey
    from amulor.survey.directions import samples_of

    check_cube_output(output, overwrite=overwrite, inputs=[file, survey, columns])
    check_tile_rows(tile_rows)
    described = RecordingMap.from_toml(columns)
    planned = Survey.from_toml(survey)
    if tile_rows is not None or is_large(8 * samples_of(planned)):
        # Imported here, because only this import needs processing by rows.
        from amulor.scale.recorded import import_file

        with progress_bar():
            summary = import_file(
                file, described, planned, output, temperature=temperature,
                rows=tile_rows, overwrite=overwrite,
            )  # fmt: skip
        sizes, counts = summary.sizes, summary.marked
    else:
        from amulor import io

        cube = read_recordings(file, described, planned, temperature=temperature)
        io.write_cube(cube, output, overwrite=overwrite)
        sizes, counts = {str(k): v for k, v in cube.sizes.items()}, marked(cube)
    words = ", ".join(f"{count} {word}" for word, count in counts.items())
    print(
        f"{output}: {sizes['row']} x {sizes['column']} pixels at "
        f"{sizes['modulation_frequency']} frequencies in "
        f"{sizes['polarization']} polarizations; marked: {words or 'none'}"
    )
    print_next(f"amulor reject {output} --method auto -o target.nc")
