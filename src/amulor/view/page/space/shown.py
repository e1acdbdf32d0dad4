"""A point cloud or a mesh as the page gets it: numbers to draw, and words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amulor.errors import CubeError
from amulor.view.page.layers import flag_words
from amulor.view.page.space.shape import Shape

#: Points by which the distance of neighbours is judged [1].
_SOME = 100_000

#: Label, unit and kind of colours of the numbers that the page has words for.
_WORDS = {
    "uncertainty": ("Uncertainty", "m", "error"),
    "amplitude": ("Amplitude", "V", "amplitude"),
    "intensity": ("Intensity", "", "amplitude"),
    "flags": ("Flags", "", "flags"),
    "deviation": ("Deviation", "m", "signed"),
    "deviation_uncertainty": ("Uncertainty of it", "m", "error"),
}
_HIDDEN = ("common", "sigma_x", "sigma_y", "sigma_z", "row", "column")
_LENGTHS = ("common", "sigma_x", "sigma_y", "sigma_z")


class Space:
    """A point cloud or a mesh that the page shows.

    Parameters
    ----------
    name : str
        Name of the file.
    shape : Shape
        What it holds.
    notes : sequence of str
        What the page says of it.
    """

    def __init__(self, name: str, shape: Shape, *, notes: Sequence[str] = ()) -> None:
        self.name = name
        low, high = (_ends(shape.position, side) for side in (np.nanmin, np.nanmax))
        #: Numbers travel in 32 bits, as differences from this place [m].
        self.centre = np.round((low + high) / 2, 3)
        self.size = high - low
        order = np.arange(len(shape.position))
        if shape.faces is None:
            # Any first part of them stands for all, so that a picture that moves
            # draws fewer.
            order = np.random.default_rng(2).permutation(order)
        self.total = shape.total or len(shape.position)
        self.faces = shape.faces
        self.position = (shape.position[order] - self.centre).astype("<f4")
        self.colour = None if shape.colour is None else shape.colour[order]
        self.scalars = {
            name: _single(values[order])
            for name, values in shape.scalars.items()
            if np.isfinite(values).any()
        }
        self.up = shape.up
        self._statements = [line for line in shape.statements if line.strip()]
        self._notes = list(notes)
        self._beams = shape.up == "-y"
        own = {"sigma_x", "sigma_y", "sigma_z"}
        if "uncertainty" not in self.scalars and own <= set(self.scalars):
            parts = [self.scalars[name] for name in sorted(own)]
            self.scalars["uncertainty"] = np.sqrt(sum(p**2 for p in parts))

    @property
    def layers(self) -> list[dict[str, str]]:
        """Names, labels, units and kinds of the numbers of its points."""
        found = []
        for name in self.scalars:
            plain = name.replace("_", " ").capitalize()
            of_length = "m" if name in _LENGTHS else ""
            label, unit, kind = _WORDS.get(name, (plain, of_length, "range"))
            if name in _HIDDEN:
                kind = "hidden"
            found.append({"name": name, "label": label, "unit": unit, "kind": kind})
        order = ["uncertainty", "amplitude", "intensity"]
        found.sort(key=lambda one: (
            order.index(one["name"]) if one["name"] in order else len(order)
        ))  # fmt: skip
        return found

    def values(self, name: str) -> bytes:
        """Return numbers as they travel.

        Parameters
        ----------
        name : str
            "position", "faces", "colour", or the name of a layer.

        Returns
        -------
        bytes
            Floats of 32 bits, whole numbers of 32 bits, or bytes; little end.

        Raises
        ------
        CubeError
            If there is no such thing.
        """
        if name == "position":
            return self.position.tobytes()
        if name == "faces" and self.faces is not None:
            return np.ascontiguousarray(self.faces, "<u4").tobytes()
        if name == "colour" and self.colour is not None:
            return np.ascontiguousarray(self.colour, "u1").tobytes()
        if name in self.scalars:
            return np.ascontiguousarray(self.scalars[name], "<f4").tobytes()
        raise CubeError(f"{self.name} has no numbers {name[:40]!r}")

    def describe(self) -> dict[str, Any]:
        """Return all that the page needs to know before it asks for numbers."""
        count = len(self.position)
        return {
            "name": self.name,
            "title": self._said("title") or self.name,
            "simulated": any(line.startswith("simulated") for line in self._statements),
            "mesh": self.faces is not None,
            "points": count,
            "total": self.total,
            "triangles": 0 if self.faces is None else len(self.faces),
            "colour": self.colour is not None,
            "centre": self.centre.tolist(),
            "size": self.size.tolist(),
            "rounding": float(np.max(self.size)) * 2.0**-25,
            "spacing": self._spacing(),
            "up": self.up,
            "beams": self._beams,
            "layers": self.layers,
            "flags": flag_words(),
            "notes": self._all_notes(),
        }

    def _said(self, key: str) -> str:
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
                f"{math.ceil(self.total / count)}.",
            )
        unknown = any("error unknown" in line for line in self._statements)
        if "uncertainty" not in self.scalars and not unknown:
            notes.append(
                "The file has no uncertainties, so lengths have none here; PLY, LAZ "
                "and text that amulor exports have them."
            )
        wanted = ("axes", "reference system", "uncertainty", "not shown")
        notes += [
            f"{line[0].upper()}{line[1:]}."
            for line in self._statements
            if line.startswith(wanted)
        ]
        return notes

    def _spacing(self) -> float:
        """Return how far neighbours are apart [m], so that dots close a surface."""
        points = self.position[np.isfinite(self.position).all(axis=1)]
        some = points[:: max(1, len(points) // _SOME)].astype(float)
        if len(some) < 2:
            return float(np.max(self.size)) or 1e-3
        asked = some[:: max(1, len(some) // 2000)]
        away = cKDTree(some).query(asked, k=2)[0][:, 1]
        # Of a surface a part of the points is as much wider apart as its root.
        near = float(np.median(away)) * math.sqrt(len(some) / len(points))
        return near or float(np.max(self.size)) / 1000 or 1e-3


def _single(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return numbers as they travel; what is too large for that is missing."""
    with np.errstate(over="ignore"):
        single = values.astype("<f4")
    single[~np.isfinite(single)] = np.nan
    return single


def _ends(position: NDArray[np.float64], side: Any) -> NDArray[np.float64]:
    ends: NDArray[np.float64] = side(
        np.where(np.isfinite(position), position, np.nan), axis=0
    )
    return ends
