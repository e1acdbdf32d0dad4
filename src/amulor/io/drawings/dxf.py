"""Writes line drawings as DXF files for programs of draughtsmen."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from amulor.errors import MissingExtraError
from amulor.io.drawings.lines import Drawing, checked, sides
from amulor.io.files import atomic_output

#: Letters of labels and statements in the drawing [m].
_LETTERS = 0.002
#: Colours of layers by number, after the seven plain ones of the format.
_COLOURS = (7, 5, 1, 3, 6, 30, 4)
_METRES = 6


def write_dxf(
    drawing: Drawing, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a line drawing to a DXF file, in metres.

    Parameters
    ----------
    drawing : Drawing
        Its lines; heights of contours become elevations of their polylines.
    path : path-like
        File to make, by custom with the suffix `.dxf`.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If there is no line, if the file exists and `overwrite` is not set, or if it
        cannot be written.
    MissingExtraError
        If ezdxf is not installed.

    Notes
    -----
    AutoCAD 2010 format, light-weight polylines, a layer for each kind of line. The
    outline of the band of two standard uncertainties is on the layer "uncertainty";
    statements stand as text on the layer "notes" below the drawing.
    """
    ezdxf = _ezdxf()
    drawing = checked(drawing, name=str(path))
    document = ezdxf.new("R2010", units=_METRES)
    document.header["$MEASUREMENT"] = 1
    names = (*drawing.layers, "uncertainty", "notes")
    for number, name in enumerate(names):
        document.layers.add(name, color=_COLOURS[number % len(_COLOURS)])
    space = document.modelspace()
    for line in drawing.lines:
        space.add_lwpolyline(
            np.asarray(line.points, dtype=float).tolist(),
            dxfattribs={"layer": line.layer, "elevation": line.elevation},
        )
        outline = sides(line)
        if outline is not None:
            space.add_lwpolyline(
                outline.tolist(), close=True, dxfattribs={"layer": "uncertainty"}
            )
        if line.label:
            middle = line.points[len(line.points) // 2]
            text = space.add_text(
                line.label, height=_LETTERS, dxfattribs={"layer": line.layer}
            )
            text.set_placement((float(middle[0]), float(middle[1])))
    left, _, low, _ = drawing.limits
    for number, statement in enumerate((drawing.title, *drawing.statements)):
        text = space.add_text(
            _one_line(statement), height=_LETTERS, dxfattribs={"layer": "notes"}
        )
        text.set_placement((left, low - (number + 3) * 1.6 * _LETTERS))
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        document.saveas(temporary)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _ezdxf() -> Any:
    try:
        import ezdxf
    except ImportError as error:
        raise MissingExtraError(
            "ezdxf", extra="export", purpose="writing DXF files"
        ) from error
    return ezdxf
