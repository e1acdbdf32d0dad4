"""`amulor export`: from a range image to a point cloud file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def export(
    image: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write a range image as a point cloud.

    Parameters
    ----------
    image
        Range image (netCDF), from `amulor image`.
    output
        File to write; its ending says the format: .ply, .laz, .las, .e57 or .nc.
    overwrite
        Replace a file that is there.
    """
    from amulor import imaging, io
    from amulor.cli._arguments import check_ending

    check_ending("--output", output, [*io.CLOUD_SUFFIXES, ".nc"])
    io.check_output(output, overwrite=overwrite, inputs=[image])
    cloud = imaging.point_cloud(io.read_cube(image))
    if output.suffix.lower() == ".nc":
        io.write_cube(cloud, output, overwrite=overwrite)
    else:
        io.write_cloud(cloud, output, overwrite=overwrite)
    print(f"{output}: {cloud.sizes['point']} points")
