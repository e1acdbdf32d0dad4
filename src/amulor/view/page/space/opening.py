"""Opens a point cloud or a mesh for the page, whatever its format."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from amulor.cube import error_unknown
from amulor.errors import CubeError, FormatError
from amulor.io import read_cube
from amulor.view.page.space.e57 import read_e57
from amulor.view.page.space.laz import read_laz
from amulor.view.page.space.mesh import read_mesh
from amulor.view.page.space.ply import read_ply
from amulor.view.page.space.shape import Shape, checked, spread, thinned
from amulor.view.page.space.shown import Space
from amulor.view.page.space.text import read_text

#: Points that are drawn at most, and triangles [1].
MOST_POINTS = 4_000_000
MOST_TRIANGLES = 2_000_000
_TEXT = (".xyz", ".csv", ".txt", ".asc", ".pts")
_MESHES = (".stl", ".obj", ".off", ".glb")
#: Formats that say by themselves what a unit is.
_METRES = (".laz", ".las", ".e57", ".glb")
ENDINGS = (".ply", ".laz", ".las", ".e57", *_TEXT, *_MESHES)


def is_space(path: Path) -> bool:
    """Return whether a file is shown in space: by its ending, or a cloud in netCDF.

    Parameters
    ----------
    path : pathlib.Path
        Any file.

    Returns
    -------
    bool
        False also for what is no file at all: other readers explain it.
    """
    if path.is_dir():  # of a scan, whatever its name
        return False
    if path.suffix.lower() in ENDINGS:
        return True
    try:
        with h5py.File(path, "r") as file:
            level = file.attrs.get("level", b"")
            text = level.decode() if isinstance(level, bytes) else str(level)
            return text == "point_cloud"
    except OSError:
        return False


def opened(path: Path, *, unit: float | None = None) -> Space:
    """Open a point cloud or a mesh.

    Parameters
    ----------
    path : pathlib.Path
        PLY, LAZ, LAS, E57, text (.xyz, .csv, .txt, .asc, .pts), STL, OBJ, OFF, GLB, or
        netCDF of level `point_cloud`.
    unit : float, optional
        Metres of a unit of its coordinates [m]. Formats that are in metres take none;
        clouds are in metres unless told; meshes by other programs must be told.

    Returns
    -------
    Space
        What the page shows. Of more than 4 million points one of every so many is
        kept, and of a mesh with more than 2 million triangles the vertices.

    Raises
    ------
    FormatError
        If there is no such file, if it is damaged, or if its unit is not known.
    MissingExtraError
        If the package that reads the format is not installed.
    """
    if not path.is_file():
        raise FormatError(f"{path} does not exist; check the name and the folder")
    ending = path.suffix.lower()
    if unit is not None and (ending in _METRES or ending not in ENDINGS):
        raise FormatError(
            f"{path.name}: the format is in metres by itself; leave out --unit"
        )
    try:
        shape = _read(path, ending, unit)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read: {error.strerror or error}"
        ) from error
    shape = checked(shape, path.name)
    notes = []
    if shape.faces is not None and len(shape.faces) > MOST_TRIANGLES:
        notes.append(
            f"{len(shape.faces):,} triangles are more than are drawn "
            f"({MOST_TRIANGLES:,}): its vertices are shown instead."
        )
        shape = Shape(**{**vars(shape), "faces": None})
    if shape.faces is None and len(shape.position) > MOST_POINTS:
        shape = thinned(shape, spread(len(shape.position), MOST_POINTS))
    return Space(path.name, shape, notes=notes)


def _read(path: Path, ending: str, unit: float | None) -> Shape:
    if ending == ".ply":
        shape = read_ply(path, unit=unit or 1.0)
        own = any(line.startswith("axes:") for line in shape.statements)
        if own and unit is not None:
            raise FormatError(
                f"{path.name}: amulor wrote it, in metres; leave out --unit"
            )
        if shape.faces is not None and not own and unit is None:
            raise _without_unit(path)
        return shape
    if ending in (".laz", ".las"):
        return read_laz(path, most=MOST_POINTS)
    if ending == ".e57":
        return read_e57(path)
    if ending in _TEXT:
        return read_text(path, unit=unit or 1.0)
    if ending in _MESHES:
        if unit is None and ending not in _METRES:
            raise _without_unit(path)
        return read_mesh(path, unit=unit or 1.0)
    return _cloud(path)


def _without_unit(path: Path) -> FormatError:
    return FormatError(
        f"{path.name}: a mesh does not say what a unit of it is; state it, such as "
        "--unit mm"
    )


def _cloud(path: Path) -> Shape:
    """Return a point cloud of amulor's own format."""
    cloud = read_cube(path)
    if str(cloud.attrs.get("level")) != "point_cloud":
        raise CubeError(f"{path.name} is no point cloud")
    position = np.stack([cloud[axis].values for axis in "xyz"], axis=1).astype(float)
    names = {
        "slant_range_uncertainty": "uncertainty",
        "slant_range_common_uncertainty": "common",
        **{f"{axis}_uncertainty": f"sigma_{axis}" for axis in "xyz"},
        "intensity": "amplitude",
        "quality_flag": "flags",
    }
    words = error_unknown(cloud)
    return Shape(
        position=position,
        scalars={
            own: cloud[name].values.astype(float)
            for name, own in names.items()
            if name in cloud
        },
        up="-y" if cloud.attrs.get("frame", "instrument") == "instrument" else "z",
        statements=[
            f"{key}: {cloud.attrs[key]}"
            for key in ("frame_axes", "title", "history")
            if cloud.attrs.get(key)
        ]
        + ([f"uncertainty: {words}"] if words else []),
        total=len(position),
    )
