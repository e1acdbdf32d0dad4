"""Targets of a survey as triangles: mesh files, textures, ray casting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import MissingExtraError, SurveyError
from amulor.survey import Disc, Mesh, Plate, Staircase
from amulor.survey.target import METRES
from amulor.transport.ray_caster import RayCaster

Floats = NDArray[np.float64]
_CHANNELS = {"red": [0], "green": [1], "blue": [2], "mean": [0, 1, 2]}


def load(target: Mesh) -> Any:
    """Read the mesh file of a target."""
    try:
        import trimesh
    except ImportError:
        raise MissingExtraError(
            "trimesh", extra="scene", purpose=f"{target.file.name}, a mesh,"
        ) from None
    # Merging vertices at the same point would merge their colors, too.
    options: dict[str, Any] = {} if target.texture is None else {"process": False}
    if not target.file.is_file():
        raise SurveyError(
            f"{target.file}: there is no such file; a mesh is needed to simulate what "
            "stands in the water"
        )
    try:
        loaded: Any = trimesh.load(target.file, force="mesh", **options)
        corners = np.asarray(loaded.triangles, dtype=float)
    # Readers of four formats raise many kinds of errors on a damaged file.
    except Exception:
        raise SurveyError(
            f"{target.file}: cannot be read as a mesh; it is damaged, or no STL, PLY, "
            "OBJ or GLB file"
        ) from None
    if corners.shape[1:] != (3, 3) or not (len(corners) and np.isfinite(corners).all()):
        raise SurveyError(
            f"{target.file}: holds no triangles with finite corners; export the "
            "surface as a triangle mesh"
        )
    if not solid(corners).any():
        raise SurveyError(
            f"{target.file}: holds {len(corners)} triangles and none with an area; "
            "export the surface as a triangle mesh"
        )
    return loaded


def solid(corners: Floats) -> NDArray[np.bool_]:
    """Return a mask of triangles with nonzero area."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    has_area: NDArray[np.bool_] = np.linalg.norm(across, axis=1) > 0
    return has_area


def barycentric(corners: Floats, point: Floats) -> Floats:
    """Return the barycentric coordinates of points on triangles [1]."""
    first_edge, second_edge = (
        corners[:, 1] - corners[:, 0],
        corners[:, 2] - corners[:, 0],
    )
    offset = point - corners[:, 0]
    a, b, c = (
        np.sum(x * y, axis=1)
        for x, y in (
            (first_edge, first_edge),
            (first_edge, second_edge),
            (second_edge, second_edge),
        )
    )
    u, v = np.sum(offset * first_edge, axis=1), np.sum(offset * second_edge, axis=1)
    area = a * c - b * b
    second, third = (c * u - b * v) / area, (a * v - b * u) / area
    shares = np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))


class Texture:
    """Texture of a mesh: brightness from vertex colors or an image."""

    def __init__(self, target: Mesh) -> None:
        self._channel = _CHANNELS[target.texture_channel or "mean"]
        loaded = load(target)
        self._faces = np.asarray(loaded.faces)[solid(np.asarray(loaded.triangles))]
        kind = getattr(loaded.visual, "kind", None)
        self._image: Any = None
        self._values: Any
        if target.texture == "vertex-colours":
            if kind not in ("vertex", "face"):
                raise SurveyError(
                    f"{target.file}: has no colors of vertices; export them, or leave "
                    "out texture"
                )
            self._values = np.asarray(loaded.visual.vertex_colors, dtype=float)
            return
        material = getattr(loaded.visual, "material", None)
        self._image = getattr(material, "baseColorTexture", None) or getattr(
            material, "image", None
        )
        self._values = getattr(loaded.visual, "uv", None)
        if self._image is None or self._values is None:
            raise SurveyError(
                f"{target.file}: has no image with coordinates (or the image lies not "
                "beside it); export them, or leave out texture"
            )
        self._image = self._image.convert("RGBA")

    def __call__(self, triangle: NDArray[np.intp], share: Floats) -> Floats:
        """Return the brightness of points on triangles."""
        corners = np.asarray(self._values)[self._faces[triangle]]
        value = np.einsum("nc,nck->nk", share, corners)
        if self._image is not None:
            from trimesh.visual.color import uv_to_interpolated_color

            value = np.asarray(
                uv_to_interpolated_color(value, self._image), dtype=float
            )
        bright: Floats = value[:, self._channel].mean(axis=1) / 255
        return bright


_RAYS_AT_ONCE = 500_000
#: Extent of a mesh without a unit beyond which its unit is in doubt [m].
_ACROSS = 50.0


@dataclass(frozen=True, kw_only=True)
class Hits:
    """First hits of rays on the targets; `target` is -1 for a miss."""

    target: NDArray[np.intp]
    """Number of the target hit first, -1 for none."""
    distance: NDArray[np.float64]
    """Distance along the ray, infinite for a miss [m]."""
    point: NDArray[np.float64]
    """Point of the hit, last axis (3,) [m]."""
    normal: NDArray[np.float64]
    """Unit normal of the surface, towards the start of the ray, last axis (3,) [1]."""
    triangle: NDArray[np.intp]
    """Number of the triangle hit, -1 for none."""


class Scene:
    """Scene: all targets of a survey as one set of triangles."""

    def __init__(self, targets: tuple[Plate | Staircase | Disc | Mesh, ...]) -> None:
        pieces = [triangles(target) for target in targets]
        self._targets = targets
        self._textures: dict[int, Texture] = {}
        self._first = np.concatenate([[0], np.cumsum([len(p) for p in pieces])])
        self._corners = (
            np.concatenate(pieces) if pieces else np.empty((0, 3, 3), dtype=float)
        )
        self._owner = np.repeat(np.arange(len(pieces)), [len(p) for p in pieces])
        self._caster = RayCaster(self._corners)

    def cast(self, start: NDArray[Any], direction: NDArray[Any]) -> Hits:
        """Return the first surface hit by each ray."""
        count = len(start)
        target = np.full(count, -1)
        met = np.full(count, -1)
        distance = np.full(count, np.inf)
        point = np.full((count, 3), np.nan)
        normal = np.full((count, 3), np.nan)
        for first in range(0, count, _RAYS_AT_ONCE):
            part = slice(first, first + _RAYS_AT_ONCE)
            triangle = self._caster.first(start[part], direction[part])
            hit = np.flatnonzero(triangle >= 0)
            rows = first + hit
            corner = self._corners[triangle[hit]]
            across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            ray = direction[rows]
            # The ray caster returns the triangle; its plane gives the point.
            slope = np.einsum("ij,ij->i", across, ray)
            gap = np.einsum("ij,ij->i", across, corner[:, 0] - start[rows])
            distance[rows] = gap / slope
            point[rows] = start[rows] + distance[rows, None] * ray
            normal[rows] = -across * np.sign(slope)[:, None]
            target[rows] = self._owner[triangle[hit]]
            met[rows] = triangle[hit]
        return Hits(
            target=target,
            distance=distance,
            point=point,
            normal=normal,
            triangle=met,
        )

    def texture(self, hits: Hits) -> NDArray[np.float64]:
        """Return the texture's brightness at each hit; 1 without a texture [1]."""
        bright = np.ones(len(hits.target))
        for number, target in enumerate(self._targets):
            indices = np.flatnonzero(hits.target == number)
            if (
                not isinstance(target, Mesh)
                or target.texture is None
                or not indices.size
            ):
                continue
            triangle = hits.triangle[indices]
            share = barycentric(self._corners[triangle], hits.point[indices])
            if number not in self._textures:
                self._textures[number] = Texture(target)
            texture = self._textures[number]
            bright[indices] = texture(triangle - self._first[number], share)
        return bright

    def visible_fraction(
        self, hits: Hits, aperture: Sequence[Floats] | Floats, weight: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Return the visible fraction of the aperture from each hit; 0 for a miss.

        `aperture` are points for all hits, shape (points, 3), or points for each hit,
        shape (points, hits, 3).
        """
        fraction = np.zeros(len(hits.target))
        met = np.flatnonzero(hits.target >= 0)
        start, triangle = hits.point[met], hits.triangle[met]
        for spot, part in zip(aperture, weight, strict=True):
            end = np.broadcast_to(spot, hits.point.shape)[met]
            faces = np.einsum("ij,ij->i", hits.normal[met], end - start) > 0
            fraction[met] += part * (faces & self._caster.free(start, end, triangle))
        return fraction


def aperture_points(
    position: NDArray[Any], *, radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return quadrature points and weights of a Gaussian aperture.

    The centre with weight 1/2 and six points at sqrt(2) radii with 1/12 each: exact
    for the Gaussian mean of every polynomial up to the fifth degree.
    """
    angle = np.arange(6) * math.pi / 3
    ring = (
        math.sqrt(2) * radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    )
    points = np.concatenate([np.zeros((1, 3)), ring]) + np.asarray(
        position, dtype=float
    )
    return points, np.array([0.5, *[1 / 12] * 6])


def triangles(target: Plate | Staircase | Disc | Mesh) -> NDArray[np.float64]:
    """Return the triangles of a target in the axes of the instrument."""
    from scipy.spatial.transform import Rotation

    shape = {Plate: _plate, Staircase: _staircase, Disc: _disc, Mesh: _mesh}[
        type(target)
    ](target)  # type: ignore[operator]
    rotated = Rotation.from_euler("xyz", target.rotation).apply(shape.reshape(-1, 3))
    placed: NDArray[np.float64] = (rotated + target.position).reshape(-1, 3, 3)
    return placed


def _rectangle(
    left: float, right: float, height: float, forward: tuple[float, float]
) -> NDArray[np.float64]:
    """Return a rectangle as two triangles, from the positions of its vertical edges."""
    top, bottom = -height / 2, height / 2
    a = (left, top, forward[0])
    b = (right, top, forward[1])
    c = (right, bottom, forward[1])
    d = (left, bottom, forward[0])
    return np.array([[a, b, c], [a, c, d]])


def _plate(target: Plate) -> NDArray[np.float64]:
    half = target.width / 2
    return _rectangle(-half, half, target.height, (0.0, 0.0))


def _staircase(target: Staircase) -> NDArray[np.float64]:
    levels = -np.concatenate([[0.0], np.cumsum(target.step_heights)])
    edges = (np.arange(len(levels) + 1) - len(levels) / 2) * target.tread_width
    treads = [
        _rectangle(edges[i], edges[i + 1], target.height, (level, level))
        for i, level in enumerate(levels)
    ]
    risers = [
        _rectangle(
            edges[i + 1], edges[i + 1], target.height, (levels[i], levels[i + 1])
        )
        for i in range(len(levels) - 1)
    ]
    return np.concatenate(treads + risers)


def _disc(target: Disc) -> NDArray[np.float64]:
    """Return a fine triangle mesh of a disc, with its holes and its curvature."""
    from scipy.spatial import Delaunay

    outer = target.diameter / 2
    holes = [(0.0, 0.0, target.central_hole / 2)]
    for number in range(target.hole_count):
        angle = 2 * math.pi * number / target.hole_count
        ring = target.hole_circle / 2
        holes.append(
            (ring * math.cos(angle), ring * math.sin(angle), target.hole_diameter / 2)
        )
    holes = [hole for hole in holes if hole[2] > 0]
    spacing = target.diameter / 150
    axis = np.arange(-outer, outer + spacing, spacing)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    # A net point that almost touches a rim would make slivers there.
    keep = np.linalg.norm(grid, axis=1) < outer - spacing / 2
    for x, y, radius in holes:
        keep &= np.linalg.norm(grid - (x, y), axis=1) > radius + spacing / 2
    circles = [(0.0, 0.0, outer), *holes]
    rims = [_circle(x, y, radius, spacing) for x, y, radius in circles]
    points = np.concatenate([grid[keep], *rims])
    net = Delaunay(points).simplices
    centre = points[net].mean(axis=1)
    solid = np.linalg.norm(centre, axis=1) < outer
    for x, y, radius in holes:
        solid &= np.linalg.norm(centre - (x, y), axis=1) > radius * math.cos(
            math.pi / _CIRCLE_MINIMUM
        )
    forward = np.zeros(len(points))
    if target.curvature_radius is not None:
        bend = target.curvature_radius
        forward = bend - np.sqrt(bend**2 - points[:, 0] ** 2)
    placed: NDArray[np.float64] = np.column_stack([points, forward])[net[solid]]
    return placed


_CIRCLE_MINIMUM = 48


def _circle(x: float, y: float, radius: float, spacing: float) -> NDArray[np.float64]:
    count = max(_CIRCLE_MINIMUM, math.ceil(2 * math.pi * radius / spacing))
    angle = 2 * math.pi * np.arange(count) / count
    return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)])


def _mesh(target: Mesh) -> NDArray[np.float64]:
    loaded = load(target)
    corners = np.asarray(loaded.triangles, dtype=float)
    solid_corners: NDArray[np.float64] = corners[solid(corners)] * METRES[target.unit]
    across = float(np.ptp(solid_corners.reshape(-1, 3), axis=0).max())
    if "unit" not in target.model_fields_set and across > _ACROSS:
        raise SurveyError(
            f"{target.file}: is {across:.3g} m across if its coordinates are meters, "
            'more than a scan takes in; state unit = "mm" or what it is, also if it is '
            '"m"'
        )
    return solid_corners
