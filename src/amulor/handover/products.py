"""Products of a range image, such as meshes and drawings, written to files."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from amulor import imaging, io
from amulor.cube import DOUBTFUL, UNUSABLE, error_unknown
from amulor.errors import CubeError, FormatError
from amulor.handover import drawings, references
from amulor.handover.drawing_set import write_set
from amulor.handover.order import (
    ENDINGS,
    Order,
    in_millimetres,
    statements_of,
    write_mesh,
)
from amulor.imaging import products
from amulor.imaging.frame import Frame
from amulor.imaging.moving import MovingFrame
from amulor.io import drawings as formats
from amulor.view.sheet import colours_of, sheet


def hand_over(
    image: xr.Dataset,
    path: Path,
    order: Order,
    *,
    frame: Frame | MovingFrame | None = None,
    overwrite: bool = False,
) -> str:
    """Make one product of a range image, such as a mesh, and write it to a file."""
    ending = path.suffix.lower()
    if ending not in ENDINGS[order.product]:
        raise FormatError(
            f"{path}: a product {order.product} is written to "
            f"{', '.join(ENDINGS[order.product])}"
        )
    frame = frame or imaging.frame_of(image)
    if order.product == "cloud":
        return _cloud(image, path, frame, slim=order.slim, overwrite=overwrite)
    if isinstance(frame, MovingFrame):
        raise CubeError(
            f"a scan from a vehicle becomes a cloud, but no {order.product} so far; "
            "write a cloud, such as cloud.laz, and mesh or draw it with another program"
        )
    statements = statements_of(image, frame)
    title = order.title or str(image.attrs.get("title") or "scan")
    if order.product == "profile":
        product = drawings.profile(image, order, (title, statements))
        return product.write(path, overwrite=overwrite)
    surface = products.surface(image, frame=frame)
    if order.product == "mesh":
        write_mesh(image, path, surface, overwrite=overwrite)
        return f"{len(surface.position)} vertices, {len(surface.triangles)} triangles"
    if order.product == "deviation":
        return references.write_deviation(
            image, path, order, surface, (title, statements), overwrite=overwrite
        )
    if order.product == "drawings":
        return write_set(
            image, surface, path, order, (title, statements), overwrite=overwrite
        )
    plane = products.plane_of(frame, order.side)
    if order.product == "section":
        product = drawings.section(surface, plane, order, (title, statements))
        return product.write(path, overwrite=overwrite)
    scale = drawings.scale_of(order, surface, plane)
    raster = drawings.flagged_raster(image, surface, plane, order, scale)
    warning = drawings.grazing_warning(surface, plane)
    statements = [drawings.raster_statement(raster), *warning, *statements]
    if order.product == "contours":
        product = drawings.contours(raster, order, (title, statements))
        return product.write(path, overwrite=overwrite)
    if ending in (".tif", ".tiff"):
        bands = drawings.bands_of(raster, first=order.product)
        drawings.write_bands(raster, bands, path, statements, overwrite=overwrite)
    elif ending == ".png":
        pixels, limits, unit = colours_of(raster, order.show)
        statements.insert(
            0, f"{order.show} from {limits[0]:.4g} to {limits[1]:.4g} {unit}"
        )
        formats.write_picture(
            pixels,
            path,
            dots_per_metre=scale / raster.cell,
            texts={
                "Title": f"{title}, 1:{scale:g}",
                "Description": "\n".join(statements),
            },
            overwrite=overwrite,
        )
    else:
        lines = (
            ()
            if order.contours is None
            else products.contours(raster, interval=order.contours)
        )
        if lines:
            statements.insert(0, f"Contours every {(order.contours or 0) * 1e3:g} mm")
        show = "height" if order.product == "dem" else order.show
        if show == "relief":
            statements.insert(0, drawings.relief_statement(raster))
        block = drawings.block_of(plane, order, title, statements)
        figure = sheet(raster, block, scale=scale, show=show, contours=lines)
        drawings.save_sheet(figure, path, block, overwrite=overwrite)
    rows, columns = raster.height.shape
    return (
        f"{columns} x {rows} cells of {raster.cell * 1e3:.3g} mm, 1:{scale:g}, "
        f"standard uncertainty of heights {in_millimetres(raster.uncertainty)}"
        + "".join(f"; {text[0].lower()}{text[1:]}" for text in warning)
    )


def _cloud(
    image: xr.Dataset,
    path: Path,
    frame: Frame | MovingFrame,
    *,
    slim: bool,
    overwrite: bool,
) -> str:
    full = path.suffix.lower() == ".mcap"
    cloud = imaging.point_cloud(image, frame=frame, covariance=full)
    if path.suffix.lower() == ".nc":
        io.write_cube(cloud, path, overwrite=overwrite)
    else:
        io.write_cloud(cloud, path, slim=slim, overwrite=overwrite)
    marked = int(((cloud["quality_flag"].values & int(DOUBTFUL)) != 0).sum())
    doubt = f", {marked} of them doubtful" if marked else ""
    words = error_unknown(image)
    doubt += f": {words}" if words else ""
    if isinstance(frame, MovingFrame):
        usable = (image["quality_flag"].values & UNUSABLE) == 0
        missing = int((usable & ~frame.known).sum())
        doubt += f"; {missing} without a pose left out" if missing else ""
        if frame.unknown:
            doubt += f"; not in the uncertainties: {', '.join(frame.unknown)}"
    return f"{cloud.sizes['point']} points{doubt}"
