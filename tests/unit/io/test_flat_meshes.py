"""Vertices with two coordinates are refused by every reader of meshes."""

from __future__ import annotations

from pathlib import Path

import pytest

from amulor.errors import AmulorError
from amulor.handover import references
from amulor.io import shapes
from amulor.simulation import scene
from amulor.survey import Mesh

THREE = ["v 0 0 0", "v 1 0 0", "v 0 1 0"]


def target(path: Path) -> None:
    known = {"kind": "mesh", "file": path, "reflectance": 0.3, "unit": "m"}
    scene.triangles(Mesh.model_validate({**known, "position": (0.0, 0.0, 1.0)}))


READERS = {
    "target": target,
    "reference": lambda path: references.read_mesh(path, unit=1.0),
    "shown": lambda path: shapes.read_mesh(path, unit=1.0),
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
# Six numbers in twos would pass for two points in threes.
@pytest.mark.parametrize("flat", [["v 0 0", "v 1 0", "v 0 1"], ["v 0", "v 1", "v 2"]])
def test_a_mesh_without_three_coordinates_is_refused(tmp_path, read, flat) -> None:
    for name, vertices in (("whole.obj", THREE), ("flat.obj", flat)):
        (tmp_path / name).write_text("\n".join([*vertices, "f 1 2 3"]))
    read(tmp_path / "whole.obj")
    with pytest.raises(AmulorError, match=r"flat\.obj.* (mesh|triangles)") as raised:
        read(tmp_path / "flat.obj")
    assert "\n" not in str(raised.value)
