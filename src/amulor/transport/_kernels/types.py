"""Compiler options and data types of the compiled photon-transport loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba

Loop = TypeVar("Loop", bound=Callable[..., Any])


class Compiler(Protocol):
    """Type of a decorator that compiles a loop and preserves its function type."""

    def __call__(self, loop: Loop, /) -> Loop:
        """Return the compiled loop."""


# The types that come with numba do not know all of these options.
_njit: Any = numba.njit
_COMMON: dict[str, Any] = {"cache": True, "error_model": "numpy"}
#: Without an entry from Python, which would take a tenth of the time of compiling;
#: `py_func` is the uncompiled function.
_INTERNAL: dict[str, Any] = {
    **_COMMON,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}

#: Loops that make no array. Tests call them from Python, too.
kernel: Compiler = _njit(_nrt=False, **_COMMON)

#: The same for those that only other loops call.
inner: Compiler = _njit(_nrt=False, **_INTERNAL)

#: The same for steps that their caller takes in whole, as handing over all the arrays
#: would take longer than what they do.
step: Compiler = _njit(_nrt=False, forceinline=True, **_INTERNAL)

#: Loops that make arrays, called by other loops.
allocating: Compiler = _njit(**_INTERNAL)

#: Loops that Python calls, on several threads at once.
entry: Compiler = _njit(nogil=True, **_COMMON)

#: The same for those that make arrays.
allocating_entry: Compiler = _njit(nogil=True, **_COMMON)


Array: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Integers: TypeAlias = NDArray[np.int64]
#: State of the random numbers: four words.
States: TypeAlias = NDArray[np.uint64]
Vector: TypeAlias = tuple[float, float, float]
Stokes: TypeAlias = tuple[float, float, float, float]
#: Cosine and sine of an angle by which axes are turned.
Turn: TypeAlias = tuple[float, float]


class Water(NamedTuple):
    """Water layers across z: coefficients and scattering-angle tables."""

    edge: Array
    """Boundaries of the layers, z rising, shape (layers + 1,) [m]."""
    attenuation: Array
    """Attenuation coefficient c = a + b of each layer [1/m]."""
    albedo: Array
    """Single-scattering albedo b / c of each layer [1]."""
    table: Integers
    """Index of the scattering-angle table of each layer."""
    urn: Array
    """Alias tables for drawing scattering angles, shape (tables, cells, 8)."""
    value: Array
    """Phase function p in each angle cell, shape (tables, cells) [1/sr]."""
    element: Array
    """Elements m12, m22, m33, m34, m44, shape (tables, angle cells, 5) [1]."""
    score: Array
    """Derivative of ln(b p) to each parameter, shape (parameters, layers, cells)."""


class Mesh(NamedTuple):
    """Triangles of a mesh in a hierarchy of boxes; empty if the target is no mesh."""

    box: Array
    """Lower and upper corner of each box, shape (boxes, 6) [m]."""
    link: Integers
    """Next box after a miss, first triangle and triangle count of each box."""
    triangle: Array
    """Corner, two edges and unit normal of each triangle, shape (triangles, 12) [m]."""
    texture: Array
    """Reflectance of each triangle over that of the target [1]."""
    least: float
    """Smallest hit distance of a ray that starts on a triangle [m]."""


class Target(NamedTuple):
    """Target: a plane, a mesh, or none."""

    has_plane: bool
    """Whether the target is a plane."""
    normal: Array
    """Unit normal of the plane, on its illuminated side."""
    height: float
    """Position of the plane along its normal [m]."""
    reflectance: float
    """Diffuse reflectance [1]."""
    gloss: float
    """Fraction of the light that facets mirror [1]."""
    slope: float
    """Root mean square slope of the facets along one axis, above 0 [1]."""
    mueller: Array
    """Reduced Mueller matrix of diffuse light, m11 = 1."""
    right: Vector
    """Right-hand axis of the scene, reference of the Mueller matrix."""
    mesh: Mesh
    """Triangles of the mesh."""


class Beam(NamedTuple):
    """Laser beam of the source."""

    centre: Array
    """Center of the beam at its start [m]."""
    axis: Array
    """Unit vector along the beam."""
    across: Array
    """Polarization axis of the light, a unit vector perpendicular to the beam."""
    radius: float
    """Radius at which the irradiance falls to 1/e; 0 for a thin beam [m]."""
    divergence: float
    """Angle at which the radiant intensity falls to 1/e [rad]."""
    stokes: Array
    """Stokes vector of the launched light."""


class Face(NamedTuple):
    """Receiver face at the origin, with its axis along +z."""

    radius: float
    """Receiver radius R [m]."""
    acceptance: float
    """Half-angle gamma of the acceptance cone [rad]."""
    gaussian: bool
    """Whether R and gamma are the 1/e widths of a Gaussian receiver."""
    moved: bool = False
    """Whether the last five scores are those of the receiver's place, size and tilt."""


class Scene(NamedTuple):
    """Water, target, source and receiver, in the coordinates of the receiver."""

    beam: Beam
    face: Face
    water: Water
    target: Target


class Plan(NamedTuple):
    """Options for sampling and joining photon paths."""

    paths: int
    """Number of forward paths in a group."""
    partners: int
    """Number of adjoint paths in a group, joined with each of its forward paths."""
    block: int
    """Number of groups whose target reflections are joined together."""
    reflections: int
    """Number of reflections that an adjoint segment is joined with at most."""
    roulette: int
    """Number of scatterings beyond which paths end at random."""
    stratified: bool
    """Whether first flights and directions in a group are stratified."""
    balanced: bool
    """Whether pairs are weighted by the balance heuristic."""
    direct: bool
    """Whether the last path to the receiver is a local estimate."""
    polarized: bool
    """Whether Stokes vectors are computed."""


class Record(NamedTuple):
    """Received light by path length, and by scattering order or target part.

    Two more parts, water and target, follow for each score of the derivatives.
    """

    mass: Array
    """Light with single path lengths, shape (parts, components, nodes) [1]."""
    edge: Array
    """Steps of light per path length, shape (parts, components, nodes) [1/m]."""
    beyond: Complex
    """Light beyond the last node, shape (parts, components, frequencies) [1].

    With derivatives, light of water and target times its path length follows [m].
    """
    wavenumber: Complex
    """Imaginary wavenumber i omega / v of each frequency [1/m]."""
    spacing: float
    """Path-length spacing of the nodes [m]."""
    orders: int
    """Number of parts by scattering order; target parts follow."""


class Ray(NamedTuple):
    """Position, direction and polarization axis of a ray."""

    place: Vector
    """Coordinates x, y and z [m]."""
    direction: Vector
    """Unit vector n along the path."""
    axis: Vector
    """Polarization axis, a unit vector perpendicular to the path."""


class Past(NamedTuple):
    """State of a photon path at its last event: layer, length, weight terms, counts."""

    first: int
    """Row of the path's first segment."""
    layer: int
    """Water layer at the last event."""
    length: float
    """Path length L up to the last event [m]."""
    partition: float
    """Sum of 1 / w over scatterings, denominator of the balance heuristic [m sr]."""
    front: float
    """Least height of an adjoint path's scattering events above the target [m]."""
    order: float
    """Number of scattering events so far."""
    touches: float
    """Number of target reflections so far."""


class Walk(NamedTuple):
    """Photon path during tracing: current ray, last event, next optical thickness."""

    ray: Ray
    """Ray from the last scattering event or reflection."""
    past: Past
    """State of the path at its last event."""
    thickness: float
    """Optical thickness tau of the next flight [1]."""
    triangle: float
    """Index of the triangle at the start of the ray, or -1."""


class Kind(NamedTuple):
    """Kind of a photon path: forward or adjoint, with or without polarization."""

    adjoint: bool
    """Whether the path is adjoint: traced backward from the receiver."""
    polarized: bool
    """Whether the path has Stokes vectors (forward) or Mueller matrices (adjoint)."""
    face: float
    """Radius of the receiver face at the start of an adjoint path [m]."""
    scale: float
    """Weight of a path pair with this adjoint path [sr]."""
    group: int
    """Number of the path's group in the batch."""
    roulette: float
    """Number of scatterings beyond which the path ends at random."""


class Paths(NamedTuple):
    """Segments and target reflections of all paths of one kind in a block of groups."""

    segment: Array
    """Straight segments, with the columns defined in `trace`."""
    light: Array
    """Polarization axis and Stokes vector or Mueller matrix on each segment."""
    touch: Array
    """Target reflections, with the columns defined in `trace`."""
    touch_light: Array
    """Polarization axis and Stokes vector at each target reflection."""
    used: Integers
    """Number of used rows of segments and target reflections, and the current group's
    first rows.
    """


class Arrival(NamedTuple):
    """Work arrays for the light at the receiver, allocated once per batch."""

    light: Array
    """Received Stokes vector, or intensity."""
    path_matrix: Array
    """Polarization axis and identity matrix, for direct light to the receiver."""
    total: Array
    """Sum of a group's light from water and target, shape (2, components)."""
    score: Array
    """Scores of a pair of paths: derivatives of the logarithm of its light."""
    scaled: Array
    """Received light times a score."""
    fraction: Array
    """A fraction from 0 to 1 that moves on by the golden ratio."""
