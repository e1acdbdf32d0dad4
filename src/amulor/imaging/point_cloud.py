"""Point cloud from a range image."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import UNUSABLE
from amulor.imaging.frame import Frame, frame_of
from amulor.imaging.moving import MovingFrame
from amulor.imaging.observation import geometry_of
from amulor.platform import InstrumentPoses
from amulor.platform.attitude import PAIRS


def point_cloud(
    image: xr.Dataset,
    *,
    frame: Frame | MovingFrame | None = None,
    covariance: bool = False,
) -> xr.Dataset:
    r"""Convert the usable pixels of a range image into points in space.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    frame : Frame or MovingFrame, optional
        Axes of the points, from `frame_of` or `moving_frame`; by default x right, y
        down, z forward in the axes of the instrument, in which the emitter is at its
        `emitter_position`.
    covariance : bool
        Whether the cloud has the covariances of the coordinates of each point.

    Returns
    -------
    xarray.Dataset
        Level `point_cloud`. `row` and `column` are the pixel of each point. The
        attribute `scan_shape` is the number of rows and columns of the scan. The
        attribute `frame_matrix` (16 numbers, row by row) transforms from the
        instrument's axes to those of the points; a moving instrument has none. It has
        `middle_pose` instead, the same matrix for the middle of the scan, and
        `reading_spread`, the largest distance that it moves during the readings of a
        point [m]. Points lie on the beam as refracted by the window.

    Notes
    -----
    The uncertainty of x is :math:`u_x^2 = d_x^2 u_r^2 + \sum_k s_{kx}^2`, and likewise
    for y and z. Here d is the direction of the beam, :math:`u_r` the standard
    uncertainty of the slant range, and s are shifts by the stated errors of the pose. A
    moving instrument adds the errors of its trajectory and of its motion.
    Beam directions are assumed to be exact. The errors of a point's three coordinates
    all result from its range error, so they are fully correlated.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> cloud = imaging.point_cloud(image)
    >>> xyz = np.stack([cloud[axis].values for axis in "xyz"])
    >>> ranges = np.linalg.norm(xyz, axis=0)  # the emitter is the origin
    >>> print(f"{ranges.min():.2f} to {ranges.max():.2f} m")
    0.74 to 1.49 m
    """
    image = cubes.checked(image, "range_image")
    frame = frame or frame_of(image)
    flag = image["quality_flag"].values
    usable = (flag & UNUSABLE) == 0
    if isinstance(frame, MovingFrame):
        usable = usable & frame.known
    row, column = np.nonzero(usable)
    placed = frame.at(row, column)
    geometry = geometry_of(image)
    position = geometry.position(image["slant_range"].values)
    points = placed.place(position[row, column])
    along = placed.turn(
        np.broadcast_to(geometry.beam.direction, position.shape)[row, column]
    )
    sigma = image["slant_range_uncertainty"].values[row, column]
    variance = (along * sigma[:, None]) ** 2
    variance += placed.variance(points, along)
    cloud = cubes.build(
        "point_cloud",
        {
            "x": points[:, 0],
            "y": points[:, 1],
            "z": points[:, 2],
            "intensity": image["intensity"].values[row, column],
            "slant_range_uncertainty": sigma,
            **_common(image, row, column),
            **{
                f"{axis}_uncertainty": np.sqrt(variance[:, number])
                for number, axis in enumerate("xyz")
            },
            **(_covariances(placed, points, along, sigma) if covariance else {}),
            "quality_flag": flag[row, column],
            **_time(placed),
            "row": row.astype(np.int32),
            "column": column.astype(np.int32),
        },
        {},
        geometry=image.amulor.geometry,
        attributes={
            **image.attrs,
            "level": "point_cloud",
            "scan_shape": np.array(flag.shape, dtype=np.int32),
            "frame": frame.name,
            "frame_axes": frame.axes,
            **(
                {"frame_matrix": frame.matrix.ravel()}
                if isinstance(frame, Frame)
                else {
                    "reading_spread": _spread(frame, row, column),
                    "trajectory_clock": frame.clock,
                    "middle_pose": frame.matrix.ravel(),
                }
            ),
            "crs": frame.crs,
            "crs_offset": np.array(frame.crs_offset),
            "pose_unknown": ", ".join(frame.unknown),
        },
    )
    for axis, meaning in zip("xyz", frame.meanings, strict=True):
        cloud[axis].attrs["long_name"] = meaning
    return cubes.note(cloud, "point cloud")


def _covariances(
    placed: Frame | InstrumentPoses,
    points: NDArray[np.float64],
    along: NDArray[np.float64],
    sigma: NDArray[np.float64],
) -> dict[str, NDArray[np.float64]]:
    """Return the covariances of x and y, x and z, y and z of each point [m^2]."""
    by_pose = placed.cross_covariance(points, along)
    values = {}
    for number, (first, second) in enumerate(PAIRS):
        by_range = along[:, first] * along[:, second] * sigma**2
        name = f"{'xyz'[first]}{'xyz'[second]}_covariance"
        values[name] = by_range + by_pose[:, number]
    return values


def _time(placed: Frame | InstrumentPoses) -> dict[str, NDArray[np.float64]]:
    """Return the times of the points of a moving instrument [s]."""
    return {} if isinstance(placed, Frame) else {"time": placed.vehicle.time}


def _spread(
    frame: MovingFrame, row: NDArray[np.intp], column: NDArray[np.intp]
) -> float:
    """Return the largest distance moved during the readings of a point [m]."""
    return float(np.max(frame.spread[row, column], initial=0.0))


def _common(
    image: xr.Dataset, row: NDArray[np.intp], column: NDArray[np.intp]
) -> dict[str, NDArray[np.float64]]:
    """Range uncertainty common to all points, by name; empty if the image has none."""
    name = "slant_range_common_uncertainty"
    return {name: image[name].values[row, column]} if name in image else {}
