"""`amulor import transients`: import of single-photon histograms."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

#: Fraction of an echo in the medium above which a warning is printed [1].
_OVERLAP = 0.03


def transients(
    file: Path,
    /,
    *,
    frequency: str,
    output: Annotated[Path, Parameter(alias="-o")],
    scene: int | None = None,
    scan_side: str | None = None,
    repetition: str | None = None,
    gate: str | None = None,
    medium: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Convert single-photon histograms or waveforms to a measurement cube.

    Parameters
    ----------
    file
        Histograms (npz) with counts and bin_width_s, or waveforms (npz, csv).
    frequency
        Modulation frequencies: a list such as "50MHz,100MHz", or first, last and number
        such as "10MHz:400MHz:40".
    output
        File to write (netCDF).
    scene
        Index of the scene, from 0, if the file has several.
    scan_side
        Side of the scanned square, such as "60 cm".
    repetition
        Repetition frequency of the laser, such as "10 MHz"; needed to correct a dead
        time that the file states.
    gate
        First and last time of the light that is used, such as "10ns,40ns".
    medium
        Estimate the water signal from all scenes of the file, and store it in place of
        open-water shots, for "amulor reject".
    overwrite
        Replace an existing file.
    """
    import numpy as np

    from amulor import cube as cubes
    from amulor import io
    from amulor.cli._arguments import (
        check_cube_output,
        frequencies_of,
        gate_of,
        quantity_of,
        refusing,
    )
    from amulor.io.transients import medium_from_minimum, read_transients

    frequencies = frequencies_of("--frequency", frequency)
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
    overlap = 0.0
    with refusing():
        cube = read_transients(
            file,
            frequencies,
            scene=scene,
            scan_side=side,
            repetition_frequency=pulses,
            gate=times,
        )
        if medium:
            shots = medium_from_minimum(file, frequencies)
            overlap = float(np.max(shots.attrs["echo_overlap"]))
            cube = cubes.attach(cube, shots, "open_water")
    io.write_cube(cube, output, overwrite=overwrite)
    print(
        f"{output}: {cube.sizes['row']} x {cube.sizes['column']} pixels at "
        f"{cube.sizes['modulation_frequency']} frequencies"
    )
    if overlap > _OVERLAP:
        print(
            f"note: the echoes of the scenes overlap in time; {overlap:.0%} of the "
            "weakest one is taken for the medium, so ranges of the scenes come out too "
            "far apart; the stated errors hold it; record scenes farther apart, or the "
            "medium alone"
        )
    from amulor.cli._output import print_next

    print_next(f"amulor reject {output} --method auto -o target.nc")
