"""Point clouds and meshes for the browser page: read, thinned and described."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amulor.cube import error_unknown
from amulor.errors import CubeError, FormatError
from amulor.io import read_cube
from amulor.io.e57 import read_e57
from amulor.io.laz import read_laz, read_laz_box
from amulor.io.ply import read_ply
from amulor.io.shapes import Shape, checked, read_mesh, spread, thinned
from amulor.io.text_cloud import read_text
from amulor.view.page.layers import flag_words

__all__ = ["ENDINGS", "Space", "is_space", "opened"]

#: Largest number of drawn points, and of drawn triangles [1].
MOST_POINTS = 4_000_000
MOST_TRIANGLES = 2_000_000
#: Largest number of further points of a part that is looked at closely [1].
MOST_CLOSER = 1_000_000
_TEXT = (".xyz", ".csv", ".txt", ".asc", ".pts")
_MESHES = (".stl", ".obj", ".off", ".glb")
#: Formats that define the unit of length.
_METRES = (".laz", ".las", ".e57", ".glb")
ENDINGS = (".ply", ".laz", ".las", ".e57", *_TEXT, *_MESHES)

#: Number of points that determine the typical distance of neighbors [1].
_SOME = 100_000

#: Label, unit and kind of colors of the numbers that the page has words for.
_WORDS = {
    "uncertainty": ("Uncertainty", "m", "error"),
    "amplitude": ("Amplitude", "V", "amplitude"),
    "intensity": ("Intensity", "", "amplitude"),
    "flags": ("Flags", "", "flags"),
    "deviation": ("Deviation", "m", "signed"),
    "deviation_uncertainty": ("Uncertainty of it", "m", "error"),
    "overlap": ("Scans at a place", "", "range"),
    "change": ("Change", "m", "signed"),
    "change_significant": ("Significant", "m", "signed"),
    "change_uncertainty": ("Change ±", "m", "error"),
}
_HIDDEN = ("common", "sigma_x", "sigma_y", "sigma_z", "row", "column", "scan")
_LENGTHS = ("common", "sigma_x", "sigma_y", "sigma_z")


def is_space(path: Path) -> bool:
    """Whether a file is a cloud or mesh, by its ending or its netCDF level."""
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
    """Open a point cloud or a mesh for the browser page."""
    if not path.is_file():
        raise FormatError(f"{path} does not exist; check the name and the folder")
    ending = path.suffix.lower()
    if unit is not None and (ending in _METRES or ending not in ENDINGS):
        raise FormatError(
            f"{path.name}: the format is in meters by itself; leave out --unit"
        )
    try:
        shape = _read(path, ending, unit)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read: {error.strerror or error}"
        ) from error
    thin = shape
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
    space = Space(path.name, shape, notes=notes)
    space.path = path
    if thin.ends is not None:
        space.within = lambda box: read_laz_box(path, thin, box, most=MOST_CLOSER)
    return space


def _read(path: Path, ending: str, unit: float | None) -> Shape:
    if ending == ".ply":
        shape = read_ply(path, unit=unit or 1.0)
        from_amulor = any(line.startswith("axes:") for line in shape.statements)
        if from_amulor and unit is not None:
            raise FormatError(
                f"{path.name}: amulor wrote it, in meters; leave out --unit"
            )
        if shape.faces is not None and not from_amulor and unit is None:
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
    """Point cloud from a netCDF file of amulor."""
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
            variable: cloud[name].values.astype(float)
            for name, variable in names.items()
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


class Space:
    """Point cloud or mesh shown on the page."""

    def __init__(
        self,
        name: str,
        shape: Shape,
        *,
        notes: Sequence[str] = (),
        scans: Sequence[dict[str, Any]] = (),
        pairs: Sequence[dict[str, Any]] = (),
    ) -> None:
        self.name = name
        #: File of the cloud, or of the site; annotations are kept beside it.
        self.path: Path | None = None
        #: Function that reads further points in a box, shape (2, 3) [m], of a cloud of
        #: which only a part is shown; None if the file has none.
        self.within: Callable[[NDArray[np.float64]], Shape] | None = None
        #: Scans of a site, which the page shows and hides; the number of each point's
        #: scan is in the column "scan".
        self.scans = list(scans)
        #: Residuals of overlapping scans of a site.
        self.pairs = list(pairs)
        low: NDArray[np.float64] = np.nanmin(shape.position, axis=0)
        high: NDArray[np.float64] = np.nanmax(shape.position, axis=0)
        #: Numbers travel in 32 bits, as differences from this place [m].
        self.centre = np.round((low + high) / 2, 3)
        self.size = high - low
        order = np.arange(len(shape.position))
        if shape.faces is None:
            # The first part of the points, of any size, represents all, so that a
            # moving view draws fewer.
            order = np.random.default_rng(2).permutation(order)
        self.total = shape.total or len(shape.position)
        self.faces = shape.faces
        self.position = (shape.position[order] - self.centre).astype("<f4")
        self.colour = None if shape.colour is None else shape.colour[order]
        self.scalars = {
            name: values[order]
            for name, values in _scalars_of(shape).items()
            if np.isfinite(values).any()
        }
        self.up = shape.up
        self._statements = [line for line in shape.statements if line.strip()]
        self._notes = list(notes)
        self._beams = shape.up == "-y"

    @property
    def layers(self) -> list[dict[str, str]]:
        """Names, labels, units and color scales of the values that points have."""
        entries = []
        for name in self.scalars:
            plain = name.replace("_", " ").capitalize()
            of_length = "m" if name in _LENGTHS else ""
            label, unit, kind = _WORDS.get(name, (plain, of_length, "range"))
            if name in _HIDDEN:
                kind = "hidden"
            entries.append({"name": name, "label": label, "unit": unit, "kind": kind})
        order = ["uncertainty", "amplitude", "intensity"]
        entries.sort(key=lambda entry: (
            order.index(entry["name"]) if entry["name"] in order else len(order)
        ))  # fmt: skip
        return entries

    def values(self, name: str) -> bytes:
        """Positions, triangles or values of the points, as bytes for the page."""
        if name == "position":
            return self.position.tobytes()
        if name == "faces" and self.faces is not None:
            return np.ascontiguousarray(self.faces, "<u4").tobytes()
        if name == "colour" and self.colour is not None:
            return np.ascontiguousarray(self.colour, "u1").tobytes()
        if name in self.scalars:
            return np.ascontiguousarray(self.scalars[name], "<f4").tobytes()
        raise CubeError(f"{self.name} has no numbers {name[:40]!r}")

    def closer(self, low: Sequence[float], high: Sequence[float]) -> bytes:
        """Further points in a box, from the center of all points [m].

        The bytes are the number of points, their positions, their values in the order
        of `layers`, and their colors.
        """
        if self.within is None:
            raise CubeError(f"{self.name} is shown whole; it has no further points")
        box = np.array([low, high]) + self.centre
        shape = self.within(box)
        count = len(shape.position)
        absent = np.full(count, np.nan, dtype="<f4")
        scalars = _scalars_of(shape)
        colour = np.zeros((count, 3), "u1") if shape.colour is None else shape.colour
        return b"".join(
            [
                np.uint32(count).astype("<u4").tobytes(),
                (shape.position - self.centre).astype("<f4").tobytes(),
                *(
                    scalars.get(entry["name"], absent).tobytes()
                    for entry in self.layers
                ),
                *([] if self.colour is None else [colour.astype("u1").tobytes()]),
            ]
        )

    def describe(self) -> dict[str, Any]:
        """Return the description of the cloud, which the page needs before its data."""
        count = len(self.position)
        return {
            "name": self.name,
            "title": self._statement("title") or self.name,
            "simulated": any(line.startswith("simulated") for line in self._statements),
            "mesh": self.faces is not None,
            "points": count,
            "total": self.total,
            "closer": self.within is not None,
            "triangles": 0 if self.faces is None else len(self.faces),
            "colour": self.colour is not None,
            "centre": self.centre.tolist(),
            "size": self.size.tolist(),
            "rounding": float(np.max(self.size)) * 2.0**-25,
            "spacing": self._spacing(),
            "up": self.up,
            "beams": self._beams,
            "layers": self.layers,
            "scans": self.scans,
            "pairs": self.pairs,
            "flags": flag_words(),
            "notes": self._all_notes(),
        }

    def _statement(self, key: str) -> str:
        for line in self._statements:
            if line.startswith(f"{key}:"):
                return line.partition(":")[2].strip()
        return ""

    def _all_notes(self) -> list[str]:
        notes = list(self._notes)
        count = len(self.position)
        if count < self.total and self.faces is None:
            notes.insert(
                0,
                f"{count:,} of {self.total:,} points are drawn, one of every "
                f"{math.ceil(self.total / count)}."
                + (" A closer view loads more points." if self.within else ""),
            )
        unknown = any("error unknown" in line for line in self._statements)
        if "uncertainty" not in self.scalars and not unknown:
            notes.append(
                "The file has no uncertainties, so lengths have none here; PLY, LAZ "
                "and text that amulor exports have them."
            )
        prefixes = (
            "axes", "reference system", "uncertainty", "not shown", "registration",
            "change",
        )  # fmt: skip
        notes += [
            f"{line[0].upper()}{line[1:]}."
            for line in self._statements
            if line.startswith(prefixes)
        ]
        return notes

    def _spacing(self) -> float:
        """Typical distance [m] between neighboring points, for the size of dots."""
        points = self.position[np.isfinite(self.position).all(axis=1)]
        some = points[:: max(1, len(points) // _SOME)].astype(float)
        if len(some) < 2:
            return float(np.max(self.size)) or 1e-3
        sample = some[:: max(1, len(some) // 2000)]
        away = cKDTree(some).query(sample, k=2)[0][:, 1]
        # On a surface, the spacing of a subset grows with the root of the reduction.
        near = float(np.median(away)) * math.sqrt(len(some) / len(points))
        return near or float(np.max(self.size)) / 1000 or 1e-3


def _scalars_of(shape: Shape) -> dict[str, NDArray[np.float32]]:
    """Values of points in 32 bits, the uncertainty of their place among them."""
    scalars = {name: _single(values) for name, values in shape.scalars.items()}
    names = ("sigma_x", "sigma_y", "sigma_z")
    if "uncertainty" not in scalars and set(names) <= set(scalars):
        scalars["uncertainty"] = np.sqrt(sum(scalars[name] ** 2 for name in names))
    return scalars


def _single(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Values converted to 32 bits; values that are too large become NaN."""
    with np.errstate(over="ignore"):
        single = values.astype("<f4")
    single[~np.isfinite(single)] = np.nan
    return single
