"""Targets: shape, position, reflectance, Mueller matrix."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.errors import SurveyError
from amulor.survey.mueller import SURFACES, ReducedMueller
from amulor.survey.quantity import (
    Count,
    Description,
    Fraction,
    Length,
    Position,
    Rotation,
)
from amulor.survey.surface import Glossy, SurfaceStated

#: Painted metal; m22 is published, m33 follows from symmetry, m44 is assumed.
PAINTED_METAL = SURFACES["painted-metal"]


#: Meters of the units that coordinates of a mesh may have [m].
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}


class _Target(Description):
    position: Position
    """Center of the target (right, down, forward) in the instrument's axes [m]."""
    rotation: Rotation = (0.0, 0.0, 0.0)
    """Rotation about the axes right, down, forward, in this order [rad]."""
    reflectance: Annotated[Fraction, Field(gt=0, le=1)]
    """Diffuse reflectance of the surface [1]."""
    mueller: ReducedMueller = PAINTED_METAL
    """Reduced Mueller matrix of the surface at 180 degrees, or "painted-metal",
    "smooth-metal" or "ideal-depolarizer" [1]."""
    surface: SurfaceStated | None = None
    """Distribution of the reflected light over directions; Lambert's law by default."""

    @model_validator(mode="after")
    def _reflects_no_more_than_arrives(self) -> Self:
        surface = self.surface
        if isinstance(surface, Glossy) and surface.gloss + self.reflectance > 1:
            raise ValueError(
                f"surface.gloss ({surface.gloss:g}) and reflectance "
                f"({self.reflectance:g}) together must not exceed 1"
            )
        return self


class Plate(_Target):
    """Flat rectangle; without rotation, it faces the instrument.

    Examples
    --------
    >>> from amulor.survey import Plate, Survey
    >>> plate = Plate(
    ...     kind="plate",
    ...     position=("0 m", "0 m", "1.5 m"),
    ...     reflectance=0.4,
    ...     width="60 cm",
    ...     height="40 cm",
    ... )
    >>> survey = Survey.preset("amulor-2010").with_({"targets": [plate]})
    >>> survey.targets[0].width
    0.6
    """

    kind: Literal["plate"]
    """Kind of shape."""
    width: Annotated[Length, Field(gt=0)]
    """Extent to the right [m]."""
    height: Annotated[Length, Field(gt=0)]
    """Extent downwards [m]."""


class Staircase(_Target):
    """Staircase: flat treads side by side, each nearer than its left neighbor.

    The first tread lies in the plane of `position`.

    Examples
    --------
    >>> from amulor.survey import Staircase
    >>> stairs = Staircase(
    ...     kind="staircase",
    ...     position=("0 m", "0 m", "1.5 m"),
    ...     reflectance=0.4,
    ...     tread_width="4 cm",
    ...     step_heights=("1 mm", "2 mm", "5 mm"),
    ...     height="10 cm",
    ... )
    >>> stairs.step_heights
    (0.001, 0.002, 0.005)
    """

    kind: Literal["staircase"]
    """Kind of shape."""
    tread_width: Annotated[Length, Field(gt=0)]
    """Extent of each tread to the right [m]."""
    step_heights: Annotated[
        tuple[Annotated[Length, Field(gt=0)], ...], Field(min_length=1)
    ]
    """Height of each step towards the instrument, left to right [m]."""
    height: Annotated[Length, Field(gt=0)]
    """Extent of the treads downwards [m]."""


class Disc(_Target):
    """Disc with holes, flat or curved.

    Examples
    --------
    >>> from amulor.survey import Disc
    >>> disc = Disc(
    ...     kind="disc",
    ...     position=("0 m", "0 m", "1.5 m"),
    ...     reflectance="20 %",
    ...     diameter="20 cm",
    ...     hole_count=6,
    ...     hole_diameter="1 cm",
    ...     hole_circle="14 cm",
    ... )
    >>> disc.diameter, disc.hole_circle
    (0.2, 0.14)
    """

    kind: Literal["disc"]
    """Kind of shape."""
    diameter: Annotated[Length, Field(gt=0)]
    """Outer diameter [m]."""
    central_hole: Annotated[Length, Field(ge=0)] = 0.0
    """Diameter of the central hole; 0 for no hole [m]."""
    hole_count: Annotated[Count, Field(ge=0, le=100)] = 0
    """Number of small holes, evenly spaced around the middle [1]."""
    hole_diameter: Annotated[Length, Field(ge=0)] = 0.0
    """Diameter of each small hole [m]."""
    hole_circle: Annotated[Length, Field(ge=0)] = 0.0
    """Diameter of the circle on which the small holes lie [m]."""
    curvature_radius: Annotated[Length, Field(gt=0)] | None = None
    """Radius of curvature of a disc bent about a vertical axis; flat by default [m].
    The middle of a bent disc is nearest to the instrument."""

    @model_validator(mode="after")
    def _holes_fit(self) -> Self:
        if self.central_hole >= self.diameter:
            raise ValueError(
                f"central_hole ({self.central_hole:g} m) must be smaller than diameter "
                f"({self.diameter:g} m)"
            )
        if self.hole_count:
            inner = (self.hole_circle - self.hole_diameter) / 2
            outer = (self.hole_circle + self.hole_diameter) / 2
            if self.hole_diameter <= 0:
                raise ValueError("hole_diameter must be above 0 m when hole_count is")
            if inner <= self.central_hole / 2 or outer >= self.diameter / 2:
                raise ValueError(
                    f"the small holes reach from {inner:g} to {outer:g} m off the "
                    f"middle, but must stay between the central hole "
                    f"({self.central_hole / 2:g} m) and the rim "
                    f"({self.diameter / 2:g} m)"
                )
        if self.curvature_radius is not None and (
            self.curvature_radius <= self.diameter / 2
        ):
            raise ValueError(
                f"curvature_radius ({self.curvature_radius:g} m) must exceed half the "
                f"diameter ({self.diameter / 2:g} m)"
            )
        return self


class Mesh(_Target):
    """Target surface from a mesh file: STL, PLY, OBJ or GLB.

    Examples
    --------
    >>> from amulor.survey import Mesh
    >>> Mesh(
    ...     kind="mesh",
    ...     file="amphora.ply",
    ...     unit="mm",
    ...     position=("0 m", "0 m", "2 m"),
    ...     reflectance=0.3,
    ... ).unit
    'mm'
    """

    kind: Literal["mesh"]
    """Kind of shape."""
    file: Path
    """Mesh file, relative to the survey file."""
    unit: Literal["m", "cm", "mm", "inch"] = "m"
    """Unit of the coordinates in the file. GLB files are in meters by definition. A
    mesh more than 50 m across needs a stated unit."""
    texture: Literal["vertex-colours", "image"] | None = None
    """Source of the brightness in the file: colors of the vertices, or an image with
    texture coordinates. A value of 255 means `reflectance`, and 0 means black. The
    brightness is uniform by default. Turbid water blurs a texture, but not the edge to
    another target."""
    texture_channel: Literal["mean", "red", "green", "blue"] | None = None
    """Color channel of the texture that gives the reflectance at the laser wavelength;
    the mean of all channels by default."""

    @model_validator(mode="after")
    def _glb_is_in_metres(self) -> Self:
        if self.file.suffix.lower() == ".glb" and self.unit != "m":
            raise ValueError(
                f"unit is {self.unit!r}, but coordinates of a GLB file are meters by "
                "definition; leave unit out, or export the mesh as PLY, OBJ or STL"
            )
        return self

    @model_validator(mode="after")
    def _channel_is_of_a_texture(self) -> Self:
        if self.texture_channel is not None and self.texture is None:
            raise ValueError(
                f"texture_channel is {self.texture_channel!r}, but texture is missing: "
                'state texture = "vertex-colours" or "image"'
            )
        return self

    def settled(self, folder: Path, *, where: str) -> Self:
        """Return a copy with the full path of its file.

        A full path is checked only when the mesh is read, because cubes that name a
        mesh are copied to computers without it.
        """
        file = (folder / self.file).resolve()
        if not file.is_file() and not self.file.is_absolute():
            raise SurveyError(
                f"{where}.file: found {str(self.file)!r}, but there is no such file in "
                f"{folder.resolve()}"
            )
        return self.model_copy(update={"file": file})


Target = Annotated[Plate | Staircase | Disc | Mesh, Field(discriminator="kind")]
