"""Comparison of a scan with a reference: a mesh, or an earlier scan."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor import imaging, io
from amulor.errors import CubeError, FormatError, MissingExtraError
from amulor.handover import drawings
from amulor.handover.order import Order, Unit, write_mesh
from amulor.imaging import products
from amulor.imaging.frame import Frame
from amulor.io import drawings as formats
from amulor.io.shapes import vertices_of
from amulor.survey.target import METRES
from amulor.view.sheet import sheet

Floats = NDArray[np.float64]
Said = tuple[str, list[str]]

#: Largest cell of a map of deviations on paper [m].
_CELL = 2.5e-4
#: File endings of readable meshes.
MESHES = (".ply", ".stl", ".obj", ".off", ".glb")


def write_deviation(
    image: xr.Dataset,
    path: Path,
    order: Order,
    surface: products.Surface,
    remarks: Said,
    *,
    overwrite: bool,
) -> str:
    """Compare a scan with a reference; write a table, a map or a mesh of deviations."""
    deviation = compare(surface, order)
    name = order.against.name if order.against else ""
    title, statements = described(deviation, remarks, name, PLACE_KNOWN)
    ending = path.suffix.lower()
    if ending == ".csv":
        _write_table(deviation, path, [title, *statements], overwrite=overwrite)
    elif ending == ".ply":
        write_mesh(
            image,
            path,
            surface,
            scalars={
                "scalar_deviation": (deviation.value, "deviation [m]"),
                "scalar_deviation_uncertainty": (
                    deviation.uncertainty,
                    "its standard uncertainty [m]",
                ),
                "scalar_significant": (
                    deviation.significant.astype(float),
                    "1 where it is significant [1]",
                ),
            },
            overwrite=overwrite,
        )
    else:
        _write_map(deviation, path, order, (title, statements), overwrite=overwrite)
    return summary_of(deviation)


PLACE_KNOWN = "The reference's own place counts as known"


def described(
    deviation: products.Deviation, remarks: Said, name: str, place: str
) -> Said:
    """Return title and statements of a comparison with the reference `name`."""
    return (
        f"{remarks[0]}: deviation",
        [
            f"Deviation along the normal of {name}, positive towards the instrument",
            f"{summary_of(deviation)}; of the significant pixels 5 % are so by chance "
            "(Benjamini and Hochberg)",
            place,
            *remarks[1],
        ],
    )


def compare(surface: products.Surface, order: Order) -> products.Deviation:
    """Compute the deviations of a scan from the reference that an order names."""
    assert order.against is not None
    against = _reference(order.against, order.unit)
    return against(surface, farthest=order.farthest)


def comparison(
    path: Path, *, unit: Unit
) -> Callable[[xr.Dataset], tuple[products.Deviation, str]]:
    """Read a reference once, and return the function that compares images with it."""
    against = _reference(path, unit)

    def compared(image: xr.Dataset) -> tuple[products.Deviation, str]:
        deviation = against(products.surface(image, frame=_posed(image, path)))
        _, statements = described(deviation, ("", []), path.name, PLACE_KNOWN)
        return deviation, ". ".join(statements[:2])

    return compared


def _posed(image: xr.Dataset, path: Path) -> Frame:
    """Frame of a comparison: by pose with another scan, of the instrument otherwise."""
    if path.suffix.lower() == ".nc":
        with contextlib.suppress(CubeError):
            return imaging.frame_of(image, axes="pose")
    return imaging.frame_of(image)


def _reference(path: Path, unit: Unit) -> Callable[..., products.Deviation]:
    """Read a mesh or an earlier scan; return its comparison with a surface."""
    if path.suffix.lower() != ".nc":
        vertices, faces = read_mesh(path, unit=METRES[unit])
        return partial(products.deviation, vertices=vertices, faces=faces)
    earlier = io.read_cube(path)

    def compared(
        surface: products.Surface, *, farthest: float | None = None
    ) -> products.Deviation:
        frame = _frame_of(earlier, surface.frame)
        reference = products.surface(earlier, frame=frame)
        return products.deviation(
            surface,
            reference.position,
            reference.triangles,
            own=reference.own,
            shared=reference.shared,
            reference=frame,
            farthest=farthest,
        )

    return compared


def _frame_of(earlier: xr.Dataset, frame: Frame) -> Frame:
    """Return the frame of an earlier scan; with this scan's pose if it states none."""
    try:
        return imaging.frame_of(earlier, axes=frame.name)
    except CubeError:
        return imaging.frame_of(earlier, axes=frame.name, pose=frame.pose)


def read_mesh(path: Path, *, unit: float) -> tuple[Floats, NDArray[np.intp]]:
    """Read the vertices [m] and triangles of a mesh file."""
    try:
        import trimesh
    except ImportError as error:
        raise MissingExtraError(
            "trimesh", extra="scene", purpose="reading meshes"
        ) from error
    if path.suffix.lower() not in MESHES:
        raise FormatError(
            f"{path}: a reference is a mesh ({', '.join(MESHES)}) or a range image "
            "(.nc)"
        )
    if not path.is_file():
        raise FormatError(f"{path} does not exist; check the name and the folder")
    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False)
        vertices = vertices_of(mesh) * unit
        faces = np.asarray(mesh.faces, dtype=np.intp).reshape(-1, 3)
        corner = vertices[faces]
    except Exception as error:  # trimesh's readers raise many kinds
        raise FormatError(
            f"{path} cannot be read as a mesh: {' '.join(str(error).split())}"
        ) from error
    if not np.all(np.isfinite(corner)):
        raise FormatError(f"{path} has triangles with corners that are not finite")
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    faces = faces[np.any(area != 0, axis=1)] if len(faces) else faces
    if not len(faces):
        raise FormatError(
            f"{path} holds no triangle to compare with; a point cloud has no surface"
        )
    return vertices, faces


def summary_of(deviation: products.Deviation) -> str:
    """Summarize the deviations of a comparison in a sentence."""
    share = deviation.significant.sum() / deviation.compared
    finite = math.isfinite(deviation.mean_uncertainty)
    error = f"{deviation.mean_uncertainty * 1e3:.2g} mm" if finite else "not known"
    return (
        f"{deviation.compared} pixels compared: mean {deviation.mean * 1e3:+.3g} mm, "
        f"standard uncertainty {error}; spread "
        f"{deviation.spread * 1e3:.3g} mm; {share:.1%} significant"
    )


def _write_table(
    deviation: products.Deviation, path: Path, statements: list[str], *, overwrite: bool
) -> None:
    valid = np.isfinite(deviation.value)
    surface = deviation.surface
    rows, columns = np.divmod(surface.pixel[valid], surface.shape[1])
    place = surface.position[valid]
    formats.write_table(
        {
            "row": rows,
            "column": columns,
            **{f"{axis} [m]": place[:, n] for n, axis in enumerate("xyz")},
            "deviation [m]": deviation.value[valid],
            "standard_uncertainty [m]": deviation.uncertainty[valid],
            "own_part [m]": deviation.own[valid],
            "significant": deviation.significant[valid],
        },
        path,
        statements=statements,
        overwrite=overwrite,
    )


def _write_map(
    deviation: products.Deviation,
    path: Path,
    order: Order,
    statements: Said,
    *,
    overwrite: bool,
) -> None:
    """Write deviations as a raster map, in a GeoTIFF or on a drawing sheet."""
    if path.suffix.lower() in (".tif", ".tiff"):
        raster, _ = _raster(deviation, order)
        value, sigma, sure = (raster.layers[n] for n in ("value", "sigma", "sure"))
        bands = [
            formats.Band(name="deviation", unit="m", values=value),
            formats.Band(name="its standard uncertainty", unit="m", values=sigma),
            formats.Band(name="share that is significant", unit="1", values=sure),
        ]
        drawings.write_bands(raster, bands, path, statements[1], overwrite=overwrite)
        return
    figure, block = deviation_sheet(deviation, order, statements)
    drawings.save_sheet(figure, path, block, overwrite=overwrite)


def deviation_sheet(
    deviation: products.Deviation, order: Order, statements: Said
) -> tuple[Figure, formats.TitleBlock]:
    """Draw deviations, colored where significant; return sheet and title block."""
    raster, scale = _raster(deviation, order, fine=True)
    value, sure = raster.layers["value"], raster.layers["sure"]
    shown = np.where(sure >= 0.5, value, np.nan)
    note = "Colored where the deviation is significant, gray elsewhere"
    if not np.isfinite(shown).any():
        shown, note = value, "No deviation is significant: what is shown is chance"
    block = drawings.block_of(
        raster.plane, order, statements[0], [note, *statements[1]]
    )
    return sheet(raster, block, scale=scale, show="deviation", values=shown), block


def _raster(
    deviation: products.Deviation, order: Order, *, fine: bool = False
) -> tuple[products.Raster, float]:
    """Return deviations, uncertainties and significance as a raster, and the scale."""
    surface = deviation.surface
    plane = products.plane_of(surface.frame, order.side)
    scale = drawings.scale_of(order, surface, plane)
    sure = np.where(np.isfinite(deviation.value), deviation.significant, np.nan)
    layers = {
        "value": deviation.value,
        "sigma": deviation.uncertainty,
        "sure": sure,
    }
    cell = drawings.cell_of(order, surface, scale)
    if fine and order.cell is None:
        cell = min(cell, scale * _CELL)
    return products.raster(surface, plane, cell=cell, layers=layers), scale
