"""`amulor export`: clouds, meshes, drawings and comparisons of a range image."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter, validators

from amulor.cli._arguments import (
    UsageError,
    check_ending,
    check_inputs,
    quantity_of,
    refusing,
)
from amulor.cli._output import print_next, progress_bar

if TYPE_CHECKING:
    import xarray as xr

    from amulor.handover import Order
    from amulor.imaging import Frame, MovingFrame

Product = Literal[
    "cloud",
    "mesh",
    "orthoimage",
    "dem",
    "contours",
    "section",
    "profile",
    "deviation",
    "drawings",
]

#: Endings of clouds.
_CLOUDS = (".ply", ".xyz", ".csv", ".laz", ".las", ".e57", ".mcap", ".nc")


def export(
    image: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    product: Product | None = None,
    good_only: Annotated[bool, Parameter(negative="")] = False,
    largest_uncertainty: str | None = None,
    without_mixed: Annotated[bool, Parameter(negative="")] = False,
    axes: Literal["instrument", "z-up", "pose"] = "instrument",
    pose: Path | None = None,
    trajectory: Path | None = None,
    mounting: Path | None = None,
    line_number: Annotated[
        int | None, Parameter(validator=validators.Number(gte=0, lte=65535))
    ] = None,
    slim: Annotated[bool, Parameter(negative="")] = False,
    seen_from: Literal["front", "top"] = "front",
    scale: str | None = None,
    exaggeration: Annotated[
        float, Parameter(validator=validators.Number(gte=0.1, lte=100))
    ] = 1.0,
    dpi: Annotated[float, Parameter(validator=validators.Number(gte=10, lte=2400))] = (
        300
    ),
    cell: str | None = None,
    show: Literal["amplitude", "height", "relief", "uncertainty"] = "amplitude",
    contours: str | None = None,
    line: str | None = None,
    against: Path | None = None,
    unit: Literal["m", "cm", "mm", "inch"] = "m",
    farthest: str | None = None,
    title: str = "",
    project: Path | None = None,
    sheet: str = "",
    tile_rows: int | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write a range image as a cloud, mesh, drawing, section or comparison.

    Parameters
    ----------
    image
        Range image (netCDF), from `amulor image`.
    output
        File to write. Its ending selects the format: .ply, .laz, .las, .e57, .xyz,
        .csv, .mcap (ROS 2) or .nc for a cloud, .tif for heights, .png, .pdf or .svg for
        an orthoimage, .dxf for lines.
    product
        Kind of product, if the ending and the other options allow several. A mesh is a
        .ply file; a section, or the half-profile of a round object such as a pot, is
        .dxf, .svg, .pdf or .csv; a deviation is a map, a table or a mesh. "drawings" is
        the drawing set of an object: elevation, section, half-profile and deviation in
        one .pdf file, each also as .svg, lines as .dxf.
    good_only
        Exclude all points that have a quality flag.
    largest_uncertainty
        Exclude points with a larger standard uncertainty, such as "2 mm".
    without_mixed
        Exclude mixed pixels and outliers from a cloud; surfaces never contain them.
    axes
        Coordinate axes. "instrument": x right, y down, z forward. "z-up": x right, y
        forward, z up. "pose": east, north, up.
    pose
        TOML file with a section [pose]; by default the pose of the survey.
    trajectory
        Trajectory of the vehicle that carried the instrument, from `amulor import
        trajectory`, for a cloud in axes east, north, up.
    mounting
        TOML file with a section [mounting]: lever arm, boresight and clock offset of
        the instrument on the vehicle. By default the mounting of the survey.
    line_number
        Number of the survey line, which a LAS or LAZ file states for each point.
    slim
        Write 18 bytes of extra dimensions per point to a LAS or LAZ file, for programs
        that reject more: amplitude, uncertainties of the coordinates, and flags.
    seen_from
        View of a drawing: from the front (elevation), or from the top (plan).
    scale
        Scale of a drawing, such as 1:20. By default the largest of 1:1, 1:2, 1:5, 1:10,
        ... at which the object fits a sheet of A4.
    exaggeration
        Exaggeration of the heights of a section on paper. A DXF file has none.
    dpi
        Resolution of an orthoimage on paper, in dots per inch.
    cell
        Size of a raster cell, such as "2 mm". By default a printed dot for an
        orthoimage, else about the spacing of the pixels.
    show
        Quantity that an orthoimage shows.
    contours
        Interval of contour lines, such as "5 mm".
    line
        Section line in drawing coordinates (right, up) of both ends, such as
        "--line=-6cm,0m,6cm,0m".
    against
        Reference to compare with: a mesh (.ply, .stl, .obj, .off, .glb) in the chosen
        axes, or the range image (.nc) of an earlier scan from the same place.
    unit
        Unit of length of the reference mesh.
    farthest
        Largest deviation that belongs to the object, such as "2 cm"; larger ones are
        excluded.
    title
        Title of a drawing; by default that of the range image.
    project
        Project file (TOML), as `amulor archive` reads it. Its section [project] fills
        the title block of a drawing.
    sheet
        Number of the sheet in the title block, such as "3 of 7".
    tile_rows
        Write a cloud in tiles of this many rows, with bounded memory. Clouds of more
        than 2.1 million pixels are always written in tiles.
    overwrite
        Replace an existing file.
    """
    # Errors in options are reported first; checks of lengths need the image.
    options = line, against, cell, contours, farthest, product, largest_uncertainty
    if output.suffix.lower() in _CLOUDS and not any(options):
        check_inputs(image, pose, trajectory, mounting)

    import numpy as np

    from amulor import handover, io
    from amulor.imaging import MovingFrame
    from amulor.io.netcdf import is_large

    check_ending("--output", output, _endings(product))
    if product is None:
        product = handover.product_of(
            output, line=line, against=against, contours=contours
        )
        check_ending("--output", output, handover.ENDINGS[product])
    order = _order(
        product,
        lengths={"--cell": cell, "--contours": contours, "--farthest": farthest},
        line=line,
        options={
            "side": seen_from,
            "show": show,
            "scale": None if scale is None else scale_of("--scale", scale),
            "exaggeration": exaggeration,
            "dots_per_inch": dpi,
            "against": against,
            "unit": unit,
            "slim": slim,
            "title": title,
            "fields": title_fields(project, sheet),
        },
    )
    largest = (
        None
        if largest_uncertainty is None
        else quantity_of("--largest-uncertainty", largest_uncertainty, "length")
    )
    given = image, pose, against, project, trajectory, mounting
    inputs = [path for path in given if path is not None]
    io.check_output(output, overwrite=overwrite, inputs=inputs)
    by_rows = product == "cloud"
    if tile_rows is not None and not (by_rows and tile_rows >= 1):
        raise UsageError(
            f"--tile-rows {tile_rows}: state 1 row or more, and a cloud: other "
            "products need the whole image"
        )
    laz = output.suffix.lower() in (".laz", ".las")
    if (slim or line_number is not None) and not laz:
        raise UsageError("--slim and --line-number need a .laz or .las file")
    if line_number is not None and trajectory is None:
        raise UsageError("--line-number needs --trajectory")
    if mounting is not None and trajectory is None:
        raise UsageError("--mounting needs --trajectory, the poses of the vehicle")
    if trajectory is not None and (pose is not None or tile_rows is not None):
        raise UsageError(
            "--trajectory excludes --pose and --tile-rows: every pixel has a pose of "
            "its own, and the scan is read as a whole"
        )
    if by_rows and trajectory is None and (tile_rows is not None or is_large(image)):
        _by_rows(
            image, output, tile_rows, axes, pose, largest, good_only, without_mixed,
            slim=slim, overwrite=overwrite,
        )  # fmt: skip
        return
    with progress_bar() as progress:
        progress("reading", 0.0)
        cube = io.read_cube(image)
        frame, cube = _chosen(
            cube, axes, pose, largest, good_only, without_mixed,
            moved=None if trajectory is None else (trajectory, mounting),
        )  # fmt: skip
        if line_number is not None:
            cube = cube.assign_attrs(line_number=line_number)
        progress(f"making the {product}", 0.2)
        statements = handover.hand_over(
            cube, output, order, frame=frame, overwrite=overwrite
        )
    print(f"{output}: {statements}")
    if isinstance(frame, MovingFrame):
        spread = float(np.nanmax(frame.spread))
        print(f"readings of a point: taken along up to {1e3 * spread:.3g} mm of track")
    if product == "cloud" and output.suffix.lower() != ".mcap":
        print_next(f"amulor view {output}")


def _by_rows(
    image: Path,
    output: Path,
    rows: int | None,
    axes: Literal["instrument", "z-up", "pose"],
    pose: Path | None,
    largest: float | None,
    good_only: bool,
    without_mixed: bool,
    *,
    slim: bool,
    overwrite: bool,
) -> None:
    """Write a cloud tile by tile, and print its summary."""
    from amulor.imaging import Frame
    from amulor.io.netcdf import open_rows
    from amulor.pipeline import Selection, cloud_file

    selection = Selection(good_only, largest, without_mixed)
    with progress_bar():
        with open_rows(image) as source:
            first = source.tile(0, 1)
        frame, _ = _chosen(first, axes, pose, None, False, False)
        assert isinstance(frame, Frame)
        with refusing("--largest-uncertainty"):
            summary = cloud_file(
                image, output, frame=frame, selection=selection, rows=rows, slim=slim,
                overwrite=overwrite,
            )  # fmt: skip
    doubt = f", {summary.doubtful} of them doubtful" if summary.doubtful else ""
    doubt += f": {summary.error_unknown}" if summary.error_unknown else ""
    print(f"{output}: {summary.points} points{doubt}")
    if output.suffix.lower() != ".mcap":
        print_next(f"amulor view {output}")


def scale_of(option: str, text: str) -> float:
    """Parse the scale of a drawing, such as 1:20; return the denominator.

    Parameters
    ----------
    option : str
        Name of the option.
    text : str
        Scale, such as "1:20".

    Returns
    -------
    float
        Length on the object over length on paper [1].

    Raises
    ------
    UsageError
        If the text is not a scale, or the number is not above 0.
    """
    match = re.fullmatch(r"\s*1\s*:\s*(\d+(?:\.\d+)?)\s*", text)
    if not match or not float(match[1]) > 0:
        raise UsageError(f"{option} {text!r}: write a scale such as 1:20")
    return float(match[1])


def _endings(product: str | None) -> list[str]:
    """Return the file endings that a product may have."""
    from amulor.handover import ENDINGS

    products = [name for name in ENDINGS if product in (None, name)]
    return list(dict.fromkeys(ending for name in products for ending in ENDINGS[name]))


def _order(
    product: Product,
    *,
    lengths: dict[str, str | None],
    line: str | None,
    options: dict[str, object],
) -> Order:
    """Return the product settings from the options of the command, in SI units."""
    from amulor.handover import Order

    parsed = {}
    for option, text in lengths.items():
        value = None if text is None else quantity_of(option, text, "length")
        if value is not None and not value > 0:
            raise UsageError(f"{option} {text}: must be above 0 m")
        parsed[option.removeprefix("--")] = value
    needed = {
        "section": ("--line", line),
        "deviation": ("--against", options["against"]),
        "contours": ("--contours", lengths["--contours"]),
    }
    if product in needed and needed[product][1] is None:
        raise UsageError(f"a product {product} needs {needed[product][0]}")
    return Order(
        product=product,
        line=None if line is None else line_of(line),
        **parsed,  # type: ignore[arg-type]
        **options,  # type: ignore[arg-type]
    )


def line_of(text: str) -> tuple[float, float, float, float]:
    """Parse the ends of a section line from the option --line [m]."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 4:
        raise UsageError(
            f"--line {text!r}: state four lengths, right and up of both ends, such as "
            '"--line=-6cm,0m,6cm,0m"'
        )
    a, b, c, d = (quantity_of("--line", part, "length") for part in parts)
    if (a, b) == (c, d):
        raise UsageError(f"--line {text!r}: both ends are the same")
    return a, b, c, d


def title_fields(project: Path | None, sheet: str) -> dict[str, str]:
    """Return the texts of the title block of a drawing."""
    fields = {"sheet": sheet} if sheet else {}
    if project is None:
        return fields
    from amulor.handover.archive import read_title_fields

    return read_title_fields(project) | fields


def _chosen(
    cube: xr.Dataset,
    axes: Literal["instrument", "z-up", "pose"],
    pose: Path | None,
    largest: float | None,
    good_only: bool,
    without_mixed: bool,
    *,
    moved: tuple[Path, Path | None] | None = None,
) -> tuple[Frame | MovingFrame, xr.Dataset]:
    """Return the frame for the points, and the image without excluded pixels."""
    from amulor import cube as cubes
    from amulor import imaging, survey

    cube = cubes.checked(cube, "range_image")
    frame: Frame | MovingFrame
    if moved is None:
        external = None if pose is None else survey.read_pose(pose)
        chosen = "pose" if pose is not None else axes
        frame = imaging.frame_of(cube, axes=chosen, pose=external)
    else:
        from amulor.io.trajectories import read_trajectory
        from amulor.platform import read_mounting

        frame = imaging.moving_frame(
            cube,
            trajectory=read_trajectory(moved[0]),
            mounting=None if moved[1] is None else read_mounting(moved[1]),
        )
    with refusing("--largest-uncertainty"):
        cube = imaging.leave_out(
            cube,
            good_only=good_only,
            largest_uncertainty=largest,
            mixed=without_mixed,
        )
    return frame, cube
