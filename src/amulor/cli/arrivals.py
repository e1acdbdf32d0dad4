"""`amulor import arrivals`: range image by the arrival of a known pulse or code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def arrivals(
    file: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    group_index: float,
    scene: int | None = None,
    gate: str | None = None,
    neighbors: int = 0,
    repetition: str | None = None,
    scan_side: str | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Compute a range image from the arrival of a known pulse or code in records.

    Parameters
    ----------
    file
        Histograms or waveforms (npz, csv, ptu) with a recorded pulse or a code.
    output
        File to write (netCDF).
    group_index
        Group index of the medium, such as 1.34 for water or 1 for air.
    scene
        Index of the scene, from 0, if the file has several.
    gate
        First and last time of the light that is used, such as "10ns,40ns".
    neighbors
        Pixels on each side whose photons select the place of the echo, for histograms
        with few counts.
    repetition
        Repetition frequency of the laser, such as "10 MHz"; needed to correct a dead
        time that the file states.
    scan_side
        Side of the scanned square, such as "60 cm".
    overwrite
        Replace an existing file.
    """
    from amulor import io
    from amulor.cli._arguments import (
        UsageError,
        check_cube_output,
        gate_of,
        quantity_of,
        refusing,
    )
    from amulor.cli._output import print_next

    if neighbors < 0:
        raise UsageError(f"--neighbors must not be negative, got {neighbors}")
    side = (
        None if scan_side is None else quantity_of("--scan-side", scan_side, "length")
    )
    pulses = (
        None
        if repetition is None
        else quantity_of("--repetition", repetition, "frequency")
    )
    times = gate_of(gate)
    check_cube_output(output, overwrite=overwrite, inputs=[file])
    with refusing():
        image = io.read_arrivals(
            file,
            scene=scene,
            gate=times,
            neighbors=neighbors,
            repetition_frequency=pulses,
            scan_side=side,
            group_index=group_index,
        )
    io.write_cube(image, output, overwrite=overwrite)
    usable = image["slant_range"].notnull()
    words = f"{output}: range image, {float(usable.mean()):.1%} of the pixels usable"
    if usable.any():
        median = float(image["slant_range_uncertainty"].median())
        words += f", median uncertainty {1e3 * median:.2f} mm"
    print(f"{words}, largest side lobe {float(image.attrs['side_lobe']):.2g}")
    print_next(f"amulor view {output}")
