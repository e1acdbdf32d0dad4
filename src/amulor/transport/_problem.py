"""Transport problem in receiver coordinates, as arguments of the compiled loops."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.transport._checks import axes_of, place, unit_vector
from amulor.transport._kernels import sampling as _cells
from amulor.transport._kernels.types import Beam, Face, Scene, Water
from amulor.transport._kernels.types import Target as Surface
from amulor.transport.medium import Layer, Medium
from amulor.transport.mesh import MeshTarget, distance_to_triangles
from amulor.transport.ray_caster import RELATIVE_GAP, hierarchy
from amulor.transport.receiver import (
    GaussianReceiver,
    PlaneTarget,
    Receiver,
    Source,
)
from amulor.transport.scattering import AngleCells, ScatteringMatrix

__all__ = ["Problem", "cells_of", "digest_of", "integrals_of", "water_tables"]


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Medium, source, receiver and target of a transport problem, checked together."""

    medium: Medium
    source: Source
    receiver: Receiver
    target: PlaneTarget | MeshTarget | None

    def __post_init__(self) -> None:
        """Raise a ValueError for inconsistent medium, source, receiver or target."""
        axis = self.axes[2]
        if not self.medium.unbounded and abs(abs(axis[2]) - 1) > 1e-9:
            tilt = math.degrees(math.acos(abs(axis[2])))
            raise ValueError(
                "in layered or bounded water the receiver must look along the forward "
                f"axis, across the layers; got a tilt of {tilt:.4g} deg"
            )
        edges = self.medium.edges
        for name, part in (("source", self.source), ("receiver", self.receiver)):
            depth = float(place(part.position, name="position")[2])
            if not edges[0] <= depth <= edges[-1]:
                raise ValueError(
                    f"the {name} must be in the water, from {edges[0]:g} to "
                    f"{edges[-1]:g} m forward, got {depth:g} m"
                )
        if not self.medium.polarized and np.any(self.source.stokes[1:] != 0):
            raise ValueError(
                "polarized light needs a medium with a ScatteringMatrix, got one with "
                "a phase function only"
            )
        self._refuse_in_view()
        if isinstance(self.target, PlaneTarget):
            self._refuse_behind(self.target)
        elif self.target is not None:
            self._refuse_inside(self.target)

    def _refuse_in_view(self) -> None:
        """Raise a ValueError if unscattered source light falls on the receiver.

        A width of 1/e counts threefold: what is left out is below e^-9 of the light.
        """
        beam, face = self.beam, self.face
        if beam.centre[2] <= 0 or beam.axis[2] >= 0:
            return
        way = -beam.centre[2] / beam.axis[2]
        off = float(np.linalg.norm((beam.centre + way * beam.axis)[:2]))
        angle = math.acos(min(1.0, -float(beam.axis[2])))
        wide = 3.0 if face.gaussian else 1.0
        spread = math.tan(3 * beam.divergence)
        within = wide * face.radius + 3 * beam.radius + way * spread
        if off <= within and angle <= wide * face.acceptance + 3 * beam.divergence:
            raise ValueError(
                "the receiver must not see the source: the beam's axis falls "
                f"{off:.3g} m from the middle of its face, {math.degrees(angle):.3g} "
                "deg to its axis, and light that arrives unscattered is not followed; "
                "turn or move one of them, and add that light in closed form"
            )

    def _refuse_behind(self, target: PlaneTarget) -> None:
        """Raise a ValueError if receiver or source is not in front of the target."""
        normal = unit_vector(target.normal, name="normal")
        point = place(target.position, name="position")
        source = float((place(self.source.position, name="position") - point) @ normal)
        centre = float(
            (place(self.receiver.position, name="position") - point) @ normal
        )
        tilt = float(np.linalg.norm(np.cross(normal, self.axes[2])))
        for name, distance in (("source", source), ("centre of the receiver", centre)):
            if distance <= 0:
                raise ValueError(
                    f"the {name} must be in front of the target, on the side of its "
                    f"normal, got {distance:.4g} m"
                )
        if centre - self.receiver.radius * tilt < 0:
            raise ValueError(
                "the receiver's face must not reach into the target: its centre is "
                f"{centre:.4g} m in front, its edge {self.receiver.radius * tilt:.4g} "
                "m behind that"
            )

    def _refuse_inside(self, target: MeshTarget) -> None:
        """Raise a ValueError if receiver or source is inside a mesh, or touches it."""
        source = place(self.source.position, name="position")
        centre = place(self.receiver.position, name="position")
        parts = (("source", source), ("centre of the receiver", centre))
        for name, point in parts:
            depth = target.depth_inside(point)
            if depth > 0:
                raise ValueError(
                    f"the {name} must be outside of the target, which is closed there, "
                    f"got one {depth:.4g} m under its surface"
                )
            distance = distance_to_triangles(point, target.corners)
            if distance <= RELATIVE_GAP * np.abs(target.corners - centre).max():
                raise ValueError(
                    f"the {name} must not lie on the target, got a distance of "
                    f"{distance:.3g} m"
                )
        reach = target.reach_into(centre, self.axes[2], self.receiver.radius)
        if reach > 0:
            raise ValueError(
                "the receiver's face must not reach into the target, got a triangle "
                f"{reach:.4g} m inside of its rim"
            )

    @cached_property
    def axes(self) -> Array:
        """Right, down and forward unit vectors of the receiver, as rows."""
        direction = unit_vector(self.receiver.direction, name="direction")
        return axes_of(direction, name="direction of the receiver")

    @cached_property
    def layers(self) -> tuple[Layer, ...]:
        """Water layers, in order along the receiver axis."""
        return self.medium.layers if self.axes[2, 2] >= 0 else self.medium.layers[::-1]

    @cached_property
    def edges(self) -> Array:
        """Boundaries of the water layers along the receiver axis [m]."""
        edges = np.array(self.medium.edges)
        if self.medium.unbounded:
            return edges
        depth = place(self.receiver.position, name="position")[2]
        sign = 1.0 if self.axes[2, 2] >= 0 else -1.0
        return np.sort(sign * (edges - depth))

    def _turned(self, position: Array) -> Array:
        """Convert positions to receiver coordinates (right, down, forward) [m]."""
        offset = position - place(self.receiver.position, name="position")
        result: Array = offset @ self.axes.T
        return result

    @cached_property
    def water(self) -> Water:
        """Water layers as an argument of the compiled loops."""
        return water_tables(self.layers, self.edges)

    @cached_property
    def beam(self) -> Beam:
        """Source as an argument of the compiled loops."""
        direction = unit_vector(self.source.direction, name="direction")
        axes = axes_of(direction, name="direction of the source")
        return Beam(
            centre=self._turned(place(self.source.position, name="position")),
            axis=np.ascontiguousarray(self.axes @ direction),
            across=np.ascontiguousarray(self.axes @ axes[0]),
            radius=float(self.source.radius),
            divergence=float(self.source.divergence),
            stokes=self.source.stokes,
        )

    @cached_property
    def face(self) -> Face:
        """Receiver face as an argument of the compiled loops."""
        return Face(
            radius=float(self.receiver.radius),
            acceptance=float(self.receiver.acceptance_angle),
            gaussian=isinstance(self.receiver, GaussianReceiver),
        )

    @cached_property
    def surface(self) -> Surface:
        """Target as an argument of the compiled loops; empty if there is none."""
        target = self.target
        plane = isinstance(target, PlaneTarget)
        right = [float(component) for component in self.axes[:, 0]]
        normal, height = np.array([0.0, 0.0, -1.0]), 0.0
        corners = np.empty((0, 3, 3))
        if isinstance(target, PlaneTarget):
            normal = np.ascontiguousarray(
                self.axes @ unit_vector(target.normal, name="normal")
            )
            point = self._turned(place(target.position, name="position"))
            height = float(normal @ point)
        elif target is not None:
            corners = self._turned(target.corners)
        mesh, number = hierarchy(corners)
        if isinstance(target, MeshTarget) and target.texture is not None:
            factor = np.array(target.texture, dtype=np.float64)
            mesh = mesh._replace(texture=factor[number])
        return Surface(
            has_plane=plane,
            normal=normal,
            height=height,
            reflectance=0.0 if target is None else float(target.reflectance),
            gloss=0.0 if target is None else float(target.gloss),
            slope=1.0 if target is None else float(target.rms_slope) or 1.0,
            mueller=np.zeros((4, 4)) if target is None else target.matrix,
            right=(right[0], right[1], right[2]),
            mesh=mesh,
        )

    @property
    def joined_touch(self) -> float:
        """Largest light of a target reflection joined with an adjoint path [1].

        Omega times the BRDF for a target that faces source and receiver; 0 where no
        path of light from the target is scattered on its way.
        """
        if self.target is None or not np.any(self.water.albedo > 0):
            return 0.0
        solid = math.sin(self.face.acceptance) ** 2
        surface = self.surface
        return solid * (surface.reflectance + surface.gloss / (8 * surface.slope**2))

    @cached_property
    def scene(self) -> Scene:
        """Water, source, target and receiver as an argument of the compiled loops."""
        return Scene(
            beam=self.beam, face=self.face, water=self.water, target=self.surface
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256 digest of the numbers that define the problem."""
        return digest_of(
            *self.water[:7],
            *self.beam[:5],
            *self.face[:3],
            *self.surface[:8],
            *self.surface.mesh[:4],
            self.source.stokes,
            self.medium.group_index,
            self.medium.polarized,
        )


def digest_of(*parts: Any) -> str:
    """Return the SHA-256 digest of numbers and arrays."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def water_tables(layers: tuple[Layer, ...], edges: Array) -> Water:
    """Return the layer boundaries, coefficients and angle tables of the water."""
    functions: list[Any] = []
    table = []
    for layer in layers:
        if not any(layer.phase_function is function for function in functions):
            functions.append(layer.phase_function)
        table.append(
            next(
                k
                for k, function in enumerate(functions)
                if function is layer.phase_function
            )
        )
    shape = (len(functions), _cells.SIZE)
    urn, value = np.empty((*shape, 8)), np.empty(shape)
    element = np.zeros((*shape, 5))
    for k, function in enumerate(functions):
        urn[k], value[k], element[k] = _angle_tables(function)
    attenuation = np.array([layer.attenuation for layer in layers])
    scattering = np.array([layer.scattering for layer in layers])
    return Water(
        edge=edges,
        attenuation=attenuation,
        albedo=np.divide(
            scattering,
            attenuation,
            out=np.zeros_like(scattering),
            where=attenuation > 0,
        ),
        table=np.array(table, dtype=np.int64),
        urn=urn,
        value=value,
        element=element,
        score=np.zeros((0, attenuation.size, _cells.SIZE)),
    )


@lru_cache(maxsize=8)
def cells_of(function: Any) -> AngleCells:
    """Return the angle cells of a phase function or scattering matrix; cached."""
    matrix = isinstance(function, ScatteringMatrix)
    return AngleCells(function.phase_function if matrix else function)


@lru_cache(maxsize=8)
def _angle_tables(function: Any) -> tuple[Array, Array, Array]:
    """Return alias table, phase function and matrix elements by angle cell."""
    cells = cells_of(function)
    element = np.zeros((_cells.SIZE, 5))
    if isinstance(function, ScatteringMatrix):
        element[:] = cells.elements(function)
    return cells.urn, cells.value, element


def integrals_of(layers: tuple[Layer, ...]) -> tuple[float, ...]:
    """Return each layer's phase-function integral, before normalization [1]."""
    return tuple(cells_of(layer.phase_function).integral for layer in layers)
