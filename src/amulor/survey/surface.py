"""Reflection by target surfaces: Lambertian, Oren-Nayar, glossy, or tabulated."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from amulor.errors import SurveyError
from amulor.optics import reflection
from amulor.survey import files
from amulor.survey.quantity import Angle, Description, Fraction

Floats = NDArray[np.float64]
_Slant = Annotated[Angle, Field(ge=0, le=math.pi / 2)]


class Lambertian(Description):
    """Lambertian surface: matte, with equal radiance in all directions.

    Examples
    --------
    >>> from amulor.survey import Lambertian, Survey
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {"targets.0.surface": Lambertian(kind="lambertian")}
    ... )
    >>> survey.targets[0].surface.kind
    'lambertian'
    """

    kind: Literal["lambertian"]
    """Kind of surface."""


class OrenNayar(Description):
    """Oren-Nayar surface: rough and matte, made of Lambertian facets.

    Examples
    --------
    >>> from amulor.survey import OrenNayar
    >>> round(OrenNayar(kind="oren-nayar", roughness="20 deg").roughness, 4)
    0.3491
    """

    kind: Literal["oren-nayar"]
    """Kind of surface."""
    roughness: Annotated[Angle, Field(ge=0, le=1)]
    """Standard deviation of the slope angle of the facets [rad]."""


class Glossy(Description):
    """Glossy surface: Lambertian, with facets on top that mirror a part of the light.

    Examples
    --------
    >>> from amulor.survey import Glossy
    >>> Glossy(kind="glossy", gloss="4 %", rms_slope=0.1).gloss
    0.04
    """

    kind: Literal["glossy"]
    """Kind of surface."""
    gloss: Annotated[Fraction, Field(gt=0, le=1)]
    """Fraction of the light that meets a mirroring facet; with `reflectance` at most 1
    [1]."""
    rms_slope: Annotated[float, Field(ge=0.02, le=0.5)]
    """Root mean square slope of the facets along one axis: the width of the highlight
    [1]. Scattered light, which dims a highlight in turbid water, is computed as that of
    a matte target with the brightness of the highlight."""


class TabulatedSurface(Description):
    """Surface with a tabulated BRDF, interpolated linearly.

    Examples
    --------
    >>> from amulor.survey import TabulatedSurface
    >>> glossy = TabulatedSurface(
    ...     kind="tabulated",
    ...     incidence=("0 deg", "40 deg", "90 deg"),
    ...     reflection=("0 deg", "90 deg"),
    ...     azimuth=("0 deg",),
    ...     values=(0.4, 0.2, 0.3, 0.2, 0.2, 0.2),
    ... )
    >>> len(glossy.values)
    6
    """

    kind: Literal["tabulated"]
    """Kind of surface."""
    file: Path | None = None
    """Text file with four columns: angle of incidence, angle of reflection and azimuth
    in degrees, and BRDF in 1/sr. An azimuth of 0 is the direction straight back. The
    table contains every combination of angles once. amulor multiplies the BRDF by
    `reflectance`. The path is relative to the survey file. amulor reads the table with
    the survey and stores it in the survey."""
    incidence: tuple[_Slant, ...] | None = None
    """Angles of incidence, increasing from 0, instead of a file [rad]."""
    reflection: tuple[_Slant, ...] | None = None
    """Angles of reflection, increasing from 0 [rad]."""
    azimuth: tuple[Annotated[Angle, Field(ge=0, le=math.pi)], ...] | None = None
    """Azimuths from 0 to 180 degrees, increasing; a single azimuth applies to all
    directions [rad]."""
    values: tuple[Annotated[float, Field(ge=0)], ...] | None = None
    """BRDF for every incidence, reflection and azimuth; the azimuth varies fastest
    [1/sr]."""

    @model_validator(mode="after")
    def _is_one_table(self) -> Self:
        axes = (self.incidence, self.reflection, self.azimuth)
        missing = [part is None for part in (*axes, self.values)]
        if any(missing) != all(missing) or all(missing) == (self.file is None):
            raise ValueError(
                "a tabulated surface needs a file, or incidence, reflection, azimuth "
                "and values"
            )
        if self.file is not None or self.values is None:
            return self
        sizes = [len(axis or ()) for axis in axes]
        if math.prod(sizes) != len(self.values):
            raise ValueError(
                f"found {len(self.values)} values for {sizes[0]} incidences, "
                f"{sizes[1]} reflections and {sizes[2]} azimuths; needed are "
                f"{math.prod(sizes)}"
            )
        for name, axis in zip(("incidence", "reflection"), axes, strict=False):
            if len(axis or ()) < 2:
                raise ValueError(f"{name} needs at least two angles")
        for axis in axes:
            if any(b <= a for a, b in pairwise(axis or ())):
                raise ValueError(
                    "angles of a tabulated surface must rise; found "
                    f"{', '.join(f'{math.degrees(a):g}' for a in axis or ())} deg"
                )
        most = _largest_reflectance(axes[0], axes[1], axes[2], self.values)
        if most > 1.001:
            raise ValueError(
                f"the table sends back {most:.3g} times the light that it gets; a BRDF "
                "is in 1/sr, that of a white Lambertian surface 1 / pi = 0.318"
            )
        return self

    def settled(self, folder: Path, *, where: str) -> Self:
        """Return a copy that contains the table read from its file."""
        if self.file is None:
            return self
        columns = files.columns(folder / self.file, count=4, where=where)
        axes = [sorted(set(column)) for column in columns[:3]]
        rows = dict(zip(zip(*columns[:3], strict=True), columns[3], strict=True))
        grid = [(i, r, a) for i in axes[0] for r in axes[1] for a in axes[2]]
        if len(rows) != len(columns[3]) or set(rows) != set(grid):
            raise SurveyError(
                f"{where}.file: {self.file} must hold every combination of its "
                f"{len(axes[0])} incidences, {len(axes[1])} reflections and "
                f"{len(axes[2])} azimuths once"
            )
        content: dict[str, Any] = {
            name: tuple(f"{angle!r} deg" for angle in axis)
            for name, axis in zip(
                ("incidence", "reflection", "azimuth"), axes, strict=True
            )
        }
        content |= {"kind": self.kind, "values": tuple(rows[at] for at in grid)}
        return files.validated(type(self), content, where=where)


def _largest_reflectance(
    incidence: Any, leaving: Any, azimuth: Any, values: Any
) -> float:
    """Return the largest reflectance over the angles of incidence of a table [1]."""
    slant, turn = np.asarray(leaving), np.asarray(azimuth)
    table = np.reshape(values, (len(incidence), slant.size, turn.size))
    around = (
        2 * math.pi * table[..., 0]
        if turn.size == 1
        else 2 * np.trapezoid(table, turn, axis=-1)
    )
    # The BRDF is interpolated linearly over the angle; the cosine is not linear.
    fine = np.linspace(slant[0], slant[-1], 200)
    weight = np.cos(fine) * np.sin(fine)
    shares = [
        np.trapezoid(np.interp(fine, slant, row) * weight, fine) for row in around
    ]
    return float(np.max(shares))


SurfaceStated = Annotated[
    Lambertian | OrenNayar | Glossy | TabulatedSurface, Field(discriminator="kind")
]


def brightness(
    surface: SurfaceStated | None,
    *,
    reflectance: float,
    texture: Floats,
    incidence: Floats,
    leaving: Floats,
    azimuth: Floats,
) -> Floats:
    """Return the BRDF of a surface over that of a Lambertian surface [1].

    The texture multiplies the BRDF, without the light that facets mirror.
    """
    if isinstance(surface, OrenNayar):
        ratio = reflection.oren_nayar(
            incidence=incidence,
            reflection=leaving,
            azimuth=azimuth,
            roughness=surface.roughness,
            reflectance=reflectance,
        )
        return np.asarray(texture * ratio * np.pi / reflectance)
    if isinstance(surface, Glossy):
        facets = reflection.mirror_facets(
            incidence=incidence,
            reflection=leaving,
            azimuth=azimuth,
            rms_slope=surface.rms_slope,
        )
        return np.asarray(texture + surface.gloss * np.pi * facets / reflectance)
    if isinstance(surface, TabulatedSurface):
        return texture * np.pi * _interpolated(surface, incidence, leaving, azimuth)
    return texture


def _interpolated(
    table: TabulatedSurface, incidence: Floats, leaving: Floats, azimuth: Floats
) -> Floats:
    from scipy.interpolate import RegularGridInterpolator

    axes = [table.incidence, table.reflection, table.azimuth]
    if table.values is None or any(axis is None for axis in axes):
        raise SurveyError(
            "surface.file: has not been read; make the survey with Survey.from_toml or "
            "Survey.from_text, or state incidence, reflection, azimuth and values"
        )
    grid = [np.asarray(axis, dtype=np.float64) for axis in axes]
    values = np.reshape(table.values, [axis.size for axis in grid])
    places = [incidence, leaving, azimuth]
    if grid[2].size == 1:
        grid, places, values = grid[:2], places[:2], values[..., 0]
    names = ("incidence", "reflection", "azimuth")
    for name, axis, angle in zip(names, grid, places, strict=False):
        outside = (angle < axis[0] - 1e-9) | (angle > axis[-1] + 1e-9)
        if outside.any():
            worst = math.degrees(float(angle[outside].flat[0]))
            raise SurveyError(
                f"surface: its table has {name} from {math.degrees(axis[0]):g} to "
                f"{math.degrees(axis[-1]):g} deg, but a beam meets the target at "
                f"{worst:.3g} deg; extend the table"
            )
    inside = [
        np.clip(angle, axis[0], axis[-1])
        for axis, angle in zip(grid, places, strict=True)
    ]
    value = RegularGridInterpolator(grid, values)(np.stack(inside, axis=-1))
    return np.asarray(value)
