"""Compares a scan with a mesh or an earlier scan, and writes what differs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import imaging, io
from amulor.errors import CubeError, FormatError, MissingExtraError
from amulor.handover import drawings
from amulor.handover.order import Order, write_mesh
from amulor.imaging import products
from amulor.imaging.frame import Frame
from amulor.io import drawings as formats
from amulor.survey.target import METRES
from amulor.view.sheet import Sheet, sheet

Floats = NDArray[np.float64]
Said = tuple[str, list[str]]

#: Endings of meshes that are read.
MESHES = (".ply", ".stl", ".obj", ".off", ".glb")


def write_deviation(
    image: xr.Dataset,
    path: Path,
    order: Order,
    surface: products.Surface,
    said: Said,
    *,
    overwrite: bool,
) -> str:
    """Compare a scan with a reference and write table, map or mesh."""
    found = compare(surface, order)
    summary = summary_of(found)
    statements = [
        f"Deviation along the normal of {order.against.name if order.against else ''}, "
        "positive towards the instrument",
        f"{summary}; of the significant pixels 5 % are so by chance (Benjamini and "
        "Hochberg)",
        "The reference's own place counts as known",
        *said[1],
    ]
    title = f"{said[0]}: deviation"
    ending = path.suffix.lower()
    if ending == ".csv":
        _write_table(found, path, [title, *statements], overwrite=overwrite)
    elif ending == ".ply":
        write_mesh(
            image,
            path,
            surface,
            scalars={
                "scalar_deviation": (found.value, "deviation [m]"),
                "scalar_deviation_uncertainty": (
                    found.uncertainty,
                    "its standard uncertainty [m]",
                ),
                "scalar_significant": (
                    found.significant.astype(float),
                    "1 where it is significant [1]",
                ),
            },
            overwrite=overwrite,
        )
    else:
        _write_map(found, path, order, (title, statements), overwrite=overwrite)
    return summary


def compare(surface: products.Surface, order: Order) -> products.Deviation:
    """Return how a scan deviates from the reference of an order."""
    assert order.against is not None
    if order.against.suffix.lower() == ".nc":
        earlier = io.read_cube(order.against)
        frame = _frame_of(earlier, surface.frame)
        other = products.surface(earlier, frame=frame)
        return products.deviation(
            surface,
            other.position,
            other.triangles,
            own=other.own,
            shared=other.shared,
            reference=frame,
            farthest=order.farthest,
        )
    vertices, faces = read_mesh(order.against, unit=METRES[order.unit])
    return products.deviation(surface, vertices, faces, farthest=order.farthest)


def _frame_of(earlier: xr.Dataset, frame: Frame) -> Frame:
    """Return where an earlier scan stood: as it states, else at the same place."""
    try:
        return imaging.frame_of(earlier, axes=frame.name)
    except CubeError:
        return imaging.frame_of(earlier, axes=frame.name, pose=frame.pose)


def read_mesh(path: Path, *, unit: float) -> tuple[Floats, NDArray[np.intp]]:
    """Read the triangles of a mesh file."""
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
        vertices = np.asarray(mesh.vertices, dtype=float) * unit
        faces = np.asarray(mesh.faces, dtype=np.intp).reshape(-1, 3)
        corner = vertices[faces]
    except Exception as error:  # trimesh's readers raise whatever they meet
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


def summary_of(found: products.Deviation) -> str:
    """Return the numbers of a comparison in a sentence."""
    share = found.significant.sum() / found.compared
    known = math.isfinite(found.mean_uncertainty)
    error = f"{found.mean_uncertainty * 1e3:.2g} mm" if known else "not known"
    return (
        f"{found.compared} pixels compared: mean {found.mean * 1e3:+.3g} mm, standard "
        f"uncertainty {error}; spread "
        f"{found.spread * 1e3:.3g} mm; {share:.1%} significant"
    )


def _write_table(
    found: products.Deviation, path: Path, said: list[str], *, overwrite: bool
) -> None:
    there = np.isfinite(found.value)
    surface = found.surface
    rows, columns = np.divmod(surface.pixel[there], surface.shape[1])
    place = surface.position[there]
    formats.write_table(
        {
            "row": rows,
            "column": columns,
            **{f"{axis} [m]": place[:, n] for n, axis in enumerate("xyz")},
            "deviation [m]": found.value[there],
            "standard_uncertainty [m]": found.uncertainty[there],
            "own_part [m]": found.own[there],
            "significant": found.significant[there],
        },
        path,
        statements=said,
        overwrite=overwrite,
    )


def _write_map(
    found: products.Deviation,
    path: Path,
    order: Order,
    said: Said,
    *,
    overwrite: bool,
) -> None:
    """Write deviations as a raster: the pixel whose middle is nearest to each cell."""
    surface = found.surface
    plane = products.plane_of(surface.frame, order.side)
    raster = products.raster(
        surface,
        plane,
        cell=drawings.cell_of(order, surface),
        layers={
            "value": found.value,
            "sigma": found.uncertainty,
            "sure": np.where(np.isfinite(found.value), found.significant, np.nan),
        },
    )
    value, sigma, sure = (raster.layers[name] for name in ("value", "sigma", "sure"))
    if path.suffix.lower() in (".tif", ".tiff"):
        bands = [
            formats.Band(name="deviation", unit="m", values=value),
            formats.Band(name="its standard uncertainty", unit="m", values=sigma),
            formats.Band(name="share that is significant", unit="1", values=sure),
        ]
        drawings.write_bands(raster, bands, path, said[1], overwrite=overwrite)
        return
    shown = np.where(sure >= 0.5, value, np.nan)
    note = "Coloured where the deviation is significant, grey elsewhere"
    if not np.isfinite(shown).any():
        shown, note = value, "No deviation is significant: what is shown is chance"
    about = Sheet(title=said[0], scale=order.scale, statements=[note, *said[1]])
    drawings.save_sheet(
        sheet(raster, about, show="deviation", values=shown),
        path,
        overwrite=overwrite,
    )
