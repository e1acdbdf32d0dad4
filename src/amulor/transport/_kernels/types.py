"""Compiler options and data types of the compiled loops of photon transport."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba

Loop = TypeVar("Loop", bound=Callable[..., Any])


class Compiler(Protocol):
    """Decorator that leaves the types of a loop unchanged."""

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
    """Layers of water across z, and their scattering angles."""

    edge: Array
    """Planes between the layers and at both ends, z rising, shape (layers + 1,) [m]."""
    attenuation: Array
    """c = a + b of each layer [1/m]."""
    albedo: Array
    """b / c of each layer [1]."""
    table: Integers
    """Index of the angle table of each layer."""
    urn: Array
    """Alias tables of the scattering angles, shape (tables, cells, 8)."""
    value: Array
    """Phase function p in each cell of the angle, shape (tables, cells) [1/sr]."""
    element: Array
    """Elements m12, m22, m33, m34 and m44 in each cell, shape (tables, cells, 5) [1].
    """


class Mesh(NamedTuple):
    """Triangles in a hierarchy of boxes; no boxes without a mesh."""

    box: Array
    """Lower and upper corner of each box, shape (boxes, 6) [m]."""
    link: Integers
    """For each box: next box after a miss, first triangle, number of triangles."""
    triangle: Array
    """Corner, two edges and unit normal of each triangle, shape (triangles, 12) [m]."""
    least: float
    """Least distance of a hit to a ray that starts on a triangle [m]."""


class Target(NamedTuple):
    """Surface that reflects by Lambert's law: a plane, a mesh, or none."""

    has_plane: bool
    """Whether the target is a plane."""
    normal: Array
    """Unit normal of the plane on its lit side."""
    height: float
    """Position of the plane along its normal [m]."""
    reflectance: float
    """Reflectance [1]."""
    mueller: Array
    """Mueller matrix over its first element."""
    right: Vector
    """Scene axis to the right, which the matrix refers to."""
    mesh: Mesh
    """Triangles of the mesh."""


class Beam(NamedTuple):
    """Source of the light."""

    centre: Array
    """Start of the beam [m]."""
    axis: Array
    """Unit vector along the beam."""
    across: Array
    """Parallel axis of the light, a unit vector perpendicular to the beam."""
    radius: float
    """Radius at which the irradiance falls to 1/e; 0 for a pencil [m]."""
    divergence: float
    """Angle at which its radiant intensity falls to 1/e [rad]."""
    stokes: Array
    """Stokes vector of the light."""


class Face(NamedTuple):
    """Receiver around the origin, which looks along +z."""

    radius: float
    """R [m]."""
    acceptance: float
    """Half angle gamma of the cone from which it receives [rad]."""
    gaussian: bool
    """Whether R and gamma are the 1/e widths of a Gaussian receiver."""


class Scene(NamedTuple):
    """Water, target and receiver, in the axes of the receiver."""

    beam: Beam
    face: Face
    water: Water
    target: Target


class Plan(NamedTuple):
    """Options of drawing and joining paths."""

    paths: int
    """Forward paths in a group."""
    partners: int
    """Adjoint paths joined with each of them."""
    stratified: bool
    """Whether first flights and directions of a group are spread evenly."""
    balanced: bool
    """Whether pairs are weighted by the balance heuristic."""
    direct: bool
    """Whether the last path to the receiver is a local estimate."""
    polarized: bool
    """Whether Stokes vectors are carried."""


class Record(NamedTuple):
    """Received light by part and path length."""

    mass: Array
    """Light of single path lengths, split among nodes, (parts, components, nodes) [1].
    """
    edge: Array
    """Steps of the light per path length, split likewise [1/m]."""
    beyond: Complex
    """Light of longer paths, shape (parts, components, frequencies) [1]."""
    wavenumber: Complex
    """i omega / v of each frequency [1/m]."""
    spacing: float
    """Path length between nodes [m]."""
    orders: int
    """Number of parts for orders of scattering; those of the target follow."""


class Ray(NamedTuple):
    """Position and direction of a path."""

    place: Vector
    """Coordinates x, y and z [m]."""
    direction: Vector
    """Unit vector n along the path."""
    axis: Vector
    """Unit vector across the path: parallel axis of polarized light."""


class Past(NamedTuple):
    """History of a path up to its last corner."""

    first: int
    """Row of the first segment."""
    layer: int
    """Layer of the corner."""
    length: float
    """Path length L [m]."""
    partition: float
    """Sum over its scatterings of 1 / w, the balance heuristic's denominator [m sr]."""
    front: float
    """Least height of the scatterings over the target's plane, adjoint paths [m]."""
    order: float
    """Number of scatterings."""
    touches: float
    """Number of reflections."""


class Walk(NamedTuple):
    """State of a path that is traced."""

    ray: Ray
    """Ray from the last corner."""
    past: Past
    """History up to that corner."""
    thickness: float
    """Optical thickness tau of the next flight [1]."""
    triangle: float
    """Index of the triangle on which the ray starts, or -1."""


class Kind(NamedTuple):
    """Kind of a traced path."""

    adjoint: bool
    """Whether the path starts at the receiver and runs against the light."""
    polarized: bool
    """Whether it carries a Stokes vector, or an adjoint path a Mueller matrix."""
    face: float
    """Radius of the face on which an adjoint path starts [m]."""
    scale: float
    """Factor of a pair with this adjoint path [sr]."""


class Paths(NamedTuple):
    """Corners of the paths of one kind in a group, row by row."""

    segment: Array
    """Straight segments, columns of `trace`."""
    light: Array
    """Frame, and Stokes vector or Mueller matrix, of the light on each segment."""
    touch: Array
    """Touches of the target, columns of `trace`."""
    touch_light: Array
    """Frame and Stokes vector of the light of each touch."""
    used: Integers
    """Number of segments and of touches."""


class Arrival(NamedTuple):
    """Work arrays for light at the receiver, so that no loop allocates."""

    light: Array
    """Stokes vector, or intensity."""
    path_matrix: Array
    """Frame and identity matrix of light that arrives unchanged."""
    total: Array
    """Sum of the light of a group, from water and target, (2, components)."""
