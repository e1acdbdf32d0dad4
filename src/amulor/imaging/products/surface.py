"""Surface of a range image as triangles, and the drawing plane: elevation or plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from amulor import cube as cubes
from amulor.cube import UNUSABLE, QualityFlag
from amulor.errors import CubeError
from amulor.imaging.common import own_variance
from amulor.imaging.frame import Frame, frame_of
from amulor.imaging.observation import geometry_of

Floats = NDArray[np.float64]
Side = Literal["front", "top"]


@dataclass(frozen=True, kw_only=True)
class Plane:
    """Drawing plane: its axes in a coordinate frame, and their names."""

    side: Side
    """Side from which the drawing is viewed."""
    axes: Floats
    """Unit vectors right, up and towards the viewer, as rows, shape (3, 3) [1]."""
    names: tuple[str, str, str]
    """Names of the three coordinates of the drawing."""


def plane_of(frame: Frame, side: Side = "front") -> Plane:
    """Drawing plane of an elevation or a plan.

    Parameters
    ----------
    frame : Frame
        Frame of the points.
    side : str
        "front": the elevation that the instrument sees; with a pose, level and towards
        its heading. "top": the plan, from above.

    Returns
    -------
    Plane
        Axes of the drawing plane. Heights are positive towards the viewer, from the
        frame's origin.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> surface = imaging.products.surface(image)
    >>> imaging.products.plane_of(surface.frame).names
    ('right', 'up', 'nearer')
    """
    if side == "top":
        if frame.name == "instrument":
            rows = [(1, 0, 0), (0, 0, 1), (0, -1, 0)]
            return _plane(side, rows, ("right", "forward", "up"))
        rows = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
        names = ("east", "north", "up") if frame.name == "pose" else ("x", "y", "z")
        return _plane(side, rows, names)
    names = ("right", "up", "nearer")
    if frame.name == "instrument":
        return _plane(side, [(1, 0, 0), (0, -1, 0), (0, 0, -1)], names)
    heading = 0.0 if frame.pose is None else frame.pose.heading
    right = (np.cos(heading), -np.sin(heading), 0.0)
    nearer = (-np.sin(heading), -np.cos(heading), 0.0)
    return _plane(side, [right, (0, 0, 1), nearer], names)


def _plane(
    side: Side, rows: Sequence[tuple[float, float, float]], names: tuple[str, str, str]
) -> Plane:
    return Plane(side=side, axes=np.array(rows, dtype=float), names=names)


#: Angle between beam and normal beyond which two pixels belong to two surfaces.
STEEPEST = np.radians(80)
#: Least ratio of a range step between pixels to its noise [1].
_SURE = 3.5
#: Normals are means over so many pixels in each direction [1].
_SMOOTHED = 5


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Surface of a range image: usable pixels as vertices of triangles."""

    position: Floats
    """Vertex positions in the frame, shape (n, 3) [m]."""
    direction: Floats
    """Displacement of each vertex per unit of range, shape (n, 3) [1]."""
    normal: Floats
    """Unit normals towards the instrument, averaged over neighbors; NaN for a vertex
    without triangle, shape (n, 3) [1]."""
    own: Floats
    """Standard uncertainty of the range from noise of the pixel, shape (n,) [m]."""
    shared: Floats
    """Range uncertainty common to all pixels, shape (n,) [m]."""
    amplitude: Floats
    """Amplitude of the target signal, shape (n,) [V]."""
    pixel: NDArray[np.intp]
    """Number of each vertex's pixel, counted row by row, shape (n,) [1]."""
    triangles: NDArray[np.intp]
    """Vertex numbers, counter-clockwise seen from the instrument, shape (m, 3)."""
    shape: tuple[int, int]
    """Rows and columns of the scan."""
    frame: Frame
    """Coordinate frame of the positions."""
    attributes: dict[str, object]
    """Attributes of the range image."""

    @property
    def spacing(self) -> float:
        """Median distance between neighboring vertices [m]."""
        corner = self.position[self.triangles]
        sides = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=-1)
        # The longest side is the diagonal between pixels.
        return float(np.median(np.sort(sides, axis=1)[:, :2]))


def surface(
    image: xr.Dataset,
    *,
    frame: Frame | None = None,
    steepest: float = STEEPEST,
) -> Surface:
    r"""Connect the pixels of a range image into a triangulated surface.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`. Mixed pixels and outliers are omitted, as they lie off any
        surface.
    frame : Frame, optional
        Axes of the vertices; the instrument's by default.
    steepest : float
        Largest angle between beam and surface normal at which neighbors are connected,
        below pi / 2 [rad].

    Returns
    -------
    Surface
        Vertices and triangles.

    Raises
    ------
    CubeError
        If no three neighboring pixels have a range.
    ValueError
        If the angle is not between 0 and pi / 2.

    Notes
    -----
    No triangle connects neighbors whose ranges differ by more than the distance across
    the beams times tan(steepest), and by more than 3.5 standard uncertainties of the
    difference by their noise. The second condition avoids holes by noise.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> surface = imaging.products.surface(image)
    >>> surface.position.shape, surface.triangles.shape
    ((4000, 3), (5576, 3))
    """
    image = cubes.checked(image, "range_image")
    if not 0 < steepest < np.pi / 2:
        raise ValueError(
            f"steepest must lie between 0 and 90 degrees, got {np.degrees(steepest):g}"
        )
    frame = frame or frame_of(image)
    geometry = geometry_of(image)
    distance = image["slant_range"].values
    flag = image["quality_flag"].values.astype(np.int64)
    hanging = int(UNUSABLE | QualityFlag.MIXED | QualityFlag.OUTLIER)
    usable = ((flag & hanging) == 0) & np.isfinite(distance)
    direction = np.broadcast_to(geometry.beam.direction, (*distance.shape, 3))
    inside = geometry.position(distance)
    place = frame.place(inside)
    variance = own_variance(image)
    corners = _triangles(usable, distance, direction, variance, np.tan(steepest))
    if not len(corners):
        raise CubeError(
            "no three neighboring pixels of the range image have a range, so there is "
            "no surface to draw; look at its quality flags"
        )
    corners = _facing(corners, inside, direction)
    turned = frame.turn(direction)
    normal = _normals(place, corners)
    total = image["slant_range_uncertainty"].values
    number = np.full(distance.size, -1)
    number[np.flatnonzero(usable)] = np.arange(int(usable.sum()))
    return Surface(
        position=place[usable],
        direction=turned[usable],
        normal=normal[usable],
        own=np.sqrt(variance[usable]),
        shared=np.sqrt(np.maximum(total**2 - variance, 0.0))[usable],
        amplitude=image["intensity"].values[usable],
        pixel=np.flatnonzero(usable),
        triangles=number[corners],
        shape=(distance.shape[0], distance.shape[1]),
        frame=frame,
        attributes={str(key): value for key, value in image.attrs.items()},
    )


def _triangles(
    usable: NDArray[np.bool_],
    distance: Floats,
    direction: Floats,
    variance: Floats,
    steepness: float,
) -> NDArray[np.intp]:
    """Triangles between neighboring pixels: each square of four is split in two."""
    numbers = np.arange(usable.size).reshape(usable.shape)
    a, b = numbers[:-1, :-1], numbers[:-1, 1:]
    c, d = numbers[1:, :-1], numbers[1:, 1:]
    halves = [(a, c, b), (b, c, d), (a, c, d), (a, d, b)]
    flat_range, flat_usable = distance.ravel(), usable.ravel()
    flat_direction, flat_variance = direction.reshape(-1, 3), variance.ravel()

    def joined(first: NDArray[np.intp], second: NDArray[np.intp]) -> NDArray[np.bool_]:
        pair_usable = flat_usable[first] & flat_usable[second]
        step = np.abs(flat_range[first] - flat_range[second])
        apart = np.linalg.norm(flat_direction[first] - flat_direction[second], axis=-1)
        across = apart * np.minimum(flat_range[first], flat_range[second])
        noise = np.sqrt(flat_variance[first] + flat_variance[second])
        return np.asarray(
            pair_usable & ~((step > steepness * across) & (step > _SURE * noise))
        )

    complete = [joined(i, j) & joined(j, k) & joined(k, i) for i, j, k in halves]
    # The diagonal with more of the square; the shorter one for complete squares.
    falling = complete[2].astype(int) + complete[3]
    rising = complete[0].astype(int) + complete[1]
    with np.errstate(invalid="ignore"):
        level = np.abs(flat_range[a] - flat_range[d]) < np.abs(
            flat_range[b] - flat_range[c]
        )
    take_falling = (falling > rising) | ((falling == rising) & level)
    chosen = []
    for number, corner in enumerate(halves):
        use = complete[number] & (take_falling if number > 1 else ~take_falling)
        chosen.append(np.stack([pixel[use] for pixel in corner], axis=1))
    return np.concatenate(chosen)


def _facing(
    triangles: NDArray[np.intp], place: Floats, direction: Floats
) -> NDArray[np.intp]:
    """Triangles with vertices ordered counter-clockwise, seen from the instrument."""
    corner = place.reshape(-1, 3)[triangles]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    away = np.einsum("ij,ij->i", area, direction.reshape(-1, 3)[triangles[:, 0]]) > 0
    return np.where(away[:, None], triangles[:, ::-1], triangles)


def _normals(place: Floats, triangles: NDArray[np.intp]) -> Floats:
    """Mean normals of the triangles around every pixel."""
    corner = place.reshape(-1, 3)[triangles]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros((place.shape[0] * place.shape[1], 3))
    for side in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(
                triangles[:, side], area[:, axis], minlength=len(total)
            )
    touched = np.any(total != 0, axis=1)
    around = total.reshape(place.shape)
    mean: Floats = np.stack(
        [
            ndimage.uniform_filter(around[..., i], _SMOOTHED, mode="nearest")
            for i in range(3)
        ],
        axis=-1,
    ).reshape(-1, 3)
    length = np.linalg.norm(mean, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = mean / length[:, None]
    unit[~touched | (length == 0)] = np.nan
    return np.asarray(unit.reshape(place.shape))
