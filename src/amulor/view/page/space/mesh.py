"""Reads meshes: STL, OBJ, OFF and GLB."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from amulor.errors import FormatError, MissingExtraError
from amulor.view.page.space.shape import Shape, Up


def read_mesh(path: Path, *, unit: float) -> Shape:
    """Read a mesh.

    Parameters
    ----------
    path : pathlib.Path
        STL, OBJ, OFF or GLB.
    unit : float
        Metres of a unit of its coordinates [m].

    Returns
    -------
    Shape
        Its triangles. Files that it names, such as textures, are not opened.

    Raises
    ------
    FormatError
        If it cannot be read, or holds no triangle.
    MissingExtraError
        If trimesh is not installed.
    """
    try:
        import trimesh
    except ImportError as error:
        raise MissingExtraError(
            "trimesh", extra="scene", purpose="reading meshes"
        ) from error
    # What it has to say of damage is in the error; its log would be more lines.
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    ending = path.suffix.lower().removeprefix(".")
    try:
        with path.open("rb") as file:
            mesh: Any = trimesh.load(
                file,
                file_type=ending,
                force="mesh",
                process=False,
                skip_materials=True,
            )
        vertices = np.array(mesh.vertices, dtype=float).reshape(-1, 3) * unit
        faces = np.array(mesh.faces, dtype=np.intp).reshape(-1, 3)
    except Exception as error:  # trimesh's readers raise whatever they meet
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"{path.name} cannot be read as a mesh: {reason}") from error
    if not len(faces):
        raise FormatError(f"{path.name} holds no triangle; it is empty or damaged")
    # The format of glTF says that y is up; others say nothing.
    up: Up = "y" if ending == "glb" else "z"
    return Shape(position=vertices, faces=faces, up=up, total=len(vertices))
