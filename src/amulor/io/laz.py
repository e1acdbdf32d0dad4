"""Writes point clouds as LAS and LAZ files."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import provenance
from amulor.errors import CubeError, FormatError, MissingExtraError
from amulor.io._cloud import checked_cloud, doubtful, provenance_lines
from amulor.io.files import atomic_output

#: Step of the coordinates in the file [m]: the rounding, half of it, is far below the
#: range precision of any instrument.
SCALE = 1e-6
# Coordinates are 32-bit steps from an offset.
_LARGEST = np.iinfo(np.int32).max
_BRIGHTEST = np.iinfo(np.uint16).max
# Name, type, variable, and description of at most 32 bytes, where the unit goes.
_EXTRA = (
    ("amplitude", np.float64, "intensity", "amplitude of the signal [V]"),
    (
        "slant_range_uncertainty",
        np.float64,
        "slant_range_uncertainty",
        "standard uncertainty [m]",
    ),
    (
        "common_uncertainty",
        np.float64,
        "slant_range_common_uncertainty",
        "part that points share [m]",
    ),
    ("sigma_x", np.float64, "x_uncertainty", "standard uncertainty of x [m]"),
    ("sigma_y", np.float64, "y_uncertainty", "standard uncertainty of y [m]"),
    ("sigma_z", np.float64, "z_uncertainty", "standard uncertainty of z [m]"),
    ("quality_flag", np.uint16, "quality_flag", "amulor flag bits, 0: good [1]"),
    ("row", np.uint32, "row", "row of the scan [1]"),
    ("column", np.uint32, "column", "column of the scan [1]"),
)


def write_laz(
    cloud: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a point cloud to a LAS 1.4 file, compressed unless its suffix is `.las`.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to make, by custom with the suffix `.laz`.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        If the cube is no point cloud, is empty, or has points without a position or
        with a negative intensity.
    FormatError
        If the cloud is too wide for the format, if the file exists and `overwrite`
        is not set, or if it cannot be written.
    MissingExtraError
        If laspy is not installed.

    Notes
    -----
    Point format 6. Coordinates are rounded to 1e-6 m, which limits the cloud to
    4294 m along each axis. `intensity` is the amplitude in parts of the largest one,
    which is 65535; the amplitude itself and the other variables are extra dimensions
    with their units in the description. Points whose range is doubtful are withheld,
    which readers leave out or mark. Provenance and axes stand in an extended record of
    the user "amulor".

    Examples
    --------
    >>> import laspy
    >>> from amulor import imaging, io, rejection, samples
    >>> image = imaging.range_image(
    ...     rejection.cross_polarized(samples.cube("ladder"))
    ... )
    >>> cloud = imaging.point_cloud(image)
    >>> io.write_laz(cloud, "ladder.laz")
    >>> laspy.read("ladder.laz").header.point_count == cloud.sizes["point"]
    True
    """
    laspy = _laspy()
    name = f"the cloud for {path}"
    cloud = checked_cloud(cloud, name=name)
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.global_encoding.wkt = True  # asked for by this point format, even if unused
    header.system_identifier = "amulor"
    header.generating_software = f"amulor {provenance.software_versions()['amulor']}"
    kept = [entry for entry in _EXTRA if entry[2] in cloud]
    header.add_extra_dims(
        [laspy.ExtraBytesParams(key, kind, about) for key, kind, _, about in kept]
    )
    header.scales = np.full(3, SCALE)
    header.offsets = np.array([_offset(cloud[axis].values) for axis in "xyz"])
    points = laspy.LasData(header)
    for axis, offset in zip("xyz", header.offsets, strict=True):
        points[axis.upper()] = _steps(cloud[axis].values, offset, axis=axis, name=name)
    points["intensity"] = _brightness(cloud["intensity"].values, name=name)
    points["return_number"] = np.ones(cloud.sizes["point"], dtype=np.uint8)
    points["number_of_returns"] = np.ones(cloud.sizes["point"], dtype=np.uint8)
    points["withheld"] = doubtful(cloud).astype(np.uint8)
    for key, kind, variable, _ in kept:
        points[key] = cloud[variable].values.astype(kind)
    text = "\n".join(provenance_lines(cloud))
    record = laspy.VLR("amulor", 1, "provenance", text.encode())
    points.evlrs = laspy.vlrs.vlrlist.VLRList([record])
    path = Path(path)
    with atomic_output(path, overwrite=overwrite) as temporary:
        content = io.BytesIO()
        points.write(content, do_compress=path.suffix.lower() != ".las")
        temporary.write_bytes(content.getvalue())


def _laspy() -> Any:
    try:
        import laspy
        import lazrs  # noqa: F401  laspy compresses with it
    except ImportError as error:
        raise MissingExtraError(
            "laspy[lazrs]", extra="export", purpose="writing LAS and LAZ files"
        ) from error
    return laspy


def _offset(values: NDArray[np.float64]) -> float:
    # Whole metres, which the file holds exactly; adding zero makes -0 a plain 0.
    return float(np.round((np.min(values) + np.max(values)) / 2)) + 0.0


def _steps(
    values: NDArray[np.float64], offset: float, *, axis: str, name: str
) -> NDArray[np.int32]:
    steps = np.round((values - offset) / SCALE)
    if np.max(np.abs(steps)) > _LARGEST:
        raise FormatError(
            f"{name}: '{axis}' goes from {np.min(values):g} m to {np.max(values):g} m, "
            f"but a LAS file in steps of {SCALE:g} m holds {2 * _LARGEST * SCALE:.0f} "
            "m; write a PLY or an E57 file, or leave out the far points"
        )
    return steps.astype(np.int32)


def _brightness(values: NDArray[np.float64], *, name: str) -> NDArray[np.uint16]:
    if np.min(values) < 0:
        raise CubeError(
            f"{name}: 'intensity' must not be below 0 V, found {np.min(values):g} V; "
            "it is an amplitude"
        )
    largest = float(np.max(values)) or 1.0
    return np.round(values / largest * _BRIGHTEST).astype(np.uint16)
