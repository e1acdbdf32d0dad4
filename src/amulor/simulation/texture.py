"""Mesh files, and how bright their vertices or their image say that a place is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import MissingExtraError, SurveyError
from amulor.survey import Mesh

Floats = NDArray[np.float64]
_CHANNELS = {"red": [0], "green": [1], "blue": [2], "mean": [0, 1, 2]}


def load(target: Mesh) -> Any:
    """Read a mesh file.

    Parameters
    ----------
    target : Mesh
        Description from a survey.

    Returns
    -------
    trimesh.Trimesh
        With at least one triangle that has an area.

    Raises
    ------
    SurveyError
        If it cannot be read or holds no surface.
    MissingExtraError
        If the extra `scene` is not installed.
    """
    try:
        import trimesh
    except ImportError:
        raise MissingExtraError(
            "trimesh", extra="scene", purpose=f"{target.file.name}, a mesh,"
        ) from None
    # Merging vertices of one place would merge their colours, too.
    options: dict[str, Any] = {} if target.texture is None else {"process": False}
    if not target.file.is_file():
        raise SurveyError(
            f"{target.file}: there is no such file; a mesh is needed to simulate what "
            "stands in the water"
        )
    try:
        loaded: Any = trimesh.load(target.file, force="mesh", **options)
        corners = np.asarray(loaded.triangles, dtype=float)
    # Readers of four formats raise errors of many kinds on a damaged file.
    except Exception:
        raise SurveyError(
            f"{target.file}: cannot be read as a mesh; it is damaged, or no STL, PLY, "
            "OBJ or GLB file"
        ) from None
    if len(corners) == 0 or not np.all(np.isfinite(corners)):
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
    """Return which triangles have an area.

    Parameters
    ----------
    corners : ndarray, shape (n, 3, 3)
        Corners of each triangle [m].

    Returns
    -------
    ndarray, shape (n,)
        True where the three are not on one line.
    """
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    whole: NDArray[np.bool_] = np.linalg.norm(across, axis=1) > 0
    return whole


def barycentric(corners: Floats, point: Floats) -> Floats:
    """Return the shares of the corners of triangles in points on them.

    Parameters
    ----------
    corners : ndarray, shape (n, 3, 3)
        Corners of each triangle [m].
    point : ndarray, shape (n, 3)
        A point on each [m].

    Returns
    -------
    ndarray, shape (n, 3)
        Shares from 0 to 1 that add up to 1 [1].
    """
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    way = point - corners[:, 0]
    a, b, c = (
        np.sum(x * y, axis=1) for x, y in ((one, one), (one, other), (other, other))
    )
    u, v = np.sum(way * one, axis=1), np.sum(way * other, axis=1)
    area = a * c - b * b
    second, third = (c * u - b * v) / area, (a * v - b * u) / area
    shares = np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))


class Texture:
    """How bright a mesh is, by the colours of its vertices or by an image.

    Parameters
    ----------
    target : Mesh
        Description from a survey, with a texture.

    Raises
    ------
    SurveyError
        If its file has none of this kind.
    """

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
                    f"{target.file}: has no colours of vertices; export them, or leave "
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

    def __call__(self, triangle: NDArray[np.intp], share: Floats) -> Floats:
        """Return the brightness of points.

        Parameters
        ----------
        triangle : ndarray, shape (n,)
            Which triangle of the mesh each lies on.
        share : ndarray, shape (n, 3)
            Shares of its corners [1].

        Returns
        -------
        ndarray, shape (n,)
            From 0 to 1 [1].
        """
        corners = np.asarray(self._values)[self._faces[triangle]]
        value = np.einsum("nc,nck->nk", share, corners)
        if self._image is not None:
            from trimesh.visual.color import uv_to_interpolated_color

            value = np.asarray(
                uv_to_interpolated_color(value, self._image.convert("RGBA")),
                dtype=float,
            )
        bright: Floats = value[:, self._channel].mean(axis=1) / 255
        return bright
