"""`amulor profile`: range profile of a pixel, and the surfaces along its beam."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from amulor.cli._arguments import (
    UsageError,
    channel_of,
    check_ending,
    check_inputs,
    interval_of,
    row_and_column,
)
from amulor.cli._output import print_json, print_table


def profile(
    target: Path,
    /,
    *,
    pixel: str,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    polarization: str | None = None,
    nearest: str | None = None,
    farthest: str | None = None,
    most: int = 4,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Find the surfaces along the beam of one pixel, and draw its range profile.

    Parameters
    ----------
    target
        Target signal (netCDF) with three or more modulation frequencies.
    pixel
        Row and column of the pixel, both from 0, such as 20,50.
    output
        Figure to write (PNG or SVG).
    polarization
        Channel, such as VV; needed if the cube has several.
    nearest
        Nearest possible slant range, such as 0.5m. By default the start of the water.
    farthest
        Farthest possible slant range. By default the end of the unambiguous span.
    most
        Largest number of surfaces.
    overwrite
        Replace an existing figure.
    json
        Print the result as JSON, in SI units.
    """
    row, column = row_and_column(pixel)
    if most < 1:
        raise UsageError(f"--most must be 1 or more, got {most}")
    interval = interval_of(nearest, farthest)
    if output is not None:
        check_ending("--output", output, [".png", ".svg"])
    check_inputs(target)

    from dataclasses import asdict

    from amulor import io
    from amulor.imaging.beam_profile import beam_profile

    if output is not None:
        io.check_output(output, overwrite=overwrite, inputs=[target])
    beam = beam_profile(
        io.read_cube(target),
        row=row,
        column=column,
        polarization=channel_of(polarization),
        interval=interval,
        most=most,
    )
    title = f"{target.name}: row {row}, column {column}"
    if output is not None:
        from amulor.view.beam_profile import write_profile

        write_profile(output, beam, title=title, overwrite=overwrite)
    if json:
        print_json(asdict(beam))
        return
    print_table(
        title,
        ("surface", "range [m]", "uncertainty [mm]", "amplitude [V]"),
        [
            (
                f"{k}",
                f"{place:.4f}",
                f"{1e3 * error:.2g}",
                f"{size:.3g} +- {spread:.1g}",
            )
            for k, (place, error, size, spread) in enumerate(
                zip(
                    beam.surface,
                    beam.surface_uncertainty,
                    beam.amplitude,
                    beam.amplitude_uncertainty,
                    strict=True,
                ),
                start=1,
            )
        ],
    )
    print(f"Range resolution: {100 * beam.resolution:.3g} cm")
    print(f"Unambiguous span: {beam.unambiguous_span:.3g} m")
    print(f"Noise level of the profile: {beam.noise:.2g} V")
    print(f"Chi-square: {beam.misfit:.0f} with {beam.freedom} degrees of freedom")
    if beam.misfit > beam.freedom + 4 * (2 * beam.freedom) ** 0.5:
        print(
            "warning: the samples scatter about the surfaces by more than their "
            "errors; the uncertainties are too small"
        )
