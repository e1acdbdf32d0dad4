"""Compiled Stokes vectors along photon paths: axes, rotation, scattering, reflection.

The frame of light that travels along n is a parallel axis e, perpendicular to n; the
perpendicular axis is n x e. A scattering matrix enters as its elements m12, m22, m33,
m34 and m44 of eqs. (63) and (66), docs/theory/polarization.md; what is done with them
is described in docs/theory/photon-transport.md, "Polarisation". Compiled, since each
of these runs at each corner of each path, or for each pair of segments.
"""

from __future__ import annotations

import math

from amulor.transport._kernels.types import Array, Stokes, Turn, Vector, kernel

#: Columns of the polarization of a forward segment or touch: frame and Stokes vector.
FORWARD_COLUMNS = 7
#: Columns of that of an adjoint segment: frame and Mueller matrix, row by row.
ADJOINT_COLUMNS = 19


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product of two vectors."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel
def turned_frame(turn: Turn, n: Vector, e: Vector) -> Vector:
    """Return the polarization axis e rotated about the direction n."""
    p = cross(n, e)
    return (
        turn[0] * e[0] + turn[1] * p[0],
        turn[0] * e[1] + turn[1] * p[1],
        turn[0] * e[2] + turn[1] * p[2],
    )


@kernel
def any_frame(n: Vector) -> Vector:
    """Return an arbitrary polarization axis: a unit vector perpendicular to n."""
    sign = 1.0 if n[2] >= 0 else -1.0
    factor = -1.0 / (sign + n[2])
    return 1.0 + sign * n[0] * n[0] * factor, sign * n[0] * n[1] * factor, -sign * n[0]


@kernel
def projected_frame(n: Vector, right: Vector) -> Vector:
    """Return the polarization axis for direction n that is nearest to `right`."""
    c = cross(right, n)
    across = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
    if across < 1e-24:  # along that axis, where it has no part to the side
        return any_frame(n)
    norm = math.sqrt(across)
    x, y, z = cross(n, c)
    return x / norm, y / norm, z / norm


@kernel
def returning_frame(m: Vector) -> Vector:
    """Return the polarization axis of light that arrives at the receiver along m."""
    # Rotation that takes a = (0, 0, -1) to m: e - (e.m) (a + m) / (1 + a.m), as e.a=0.
    factor = m[0] / max(1.0 - m[2], 1e-300)
    return 1.0 - factor * m[0], -factor * m[1], -factor * (m[2] - 1.0)


@kernel
def deflected(
    n: Vector, e: Vector, drawn: float, turn: Turn, sign: float
) -> tuple[Vector, Vector]:
    """Return photon direction and polarization axis after a scattering event.

    drawn is sin^2(theta / 2), turn that of the axis e to the plane of scattering; the
    light travels along sign x n. The axis stays in that plane: cos e - sin n forward,
    and with n = -m the same for an adjoint path.
    """
    cosine = 1.0 - 2.0 * drawn
    sine = 2.0 * math.sqrt(drawn * (1.0 - drawn))
    f = turned_frame(turn, (sign * n[0], sign * n[1], sign * n[2]), e)
    x = cosine * n[0] + sine * f[0]
    y = cosine * n[1] + sine * f[1]
    z = cosine * n[2] + sine * f[2]
    norm = 1.0 / math.sqrt(x * x + y * y + z * z)
    after = (
        cosine * f[0] - sine * n[0],
        cosine * f[1] - sine * n[1],
        cosine * f[2] - sine * n[2],
    )
    return (x * norm, y * norm, z * norm), after


@kernel
def scattered(
    stokes: Stokes, turn: Turn, element: Array, table: int, cell: int
) -> Stokes:
    """Return the Stokes vector after a scattering event."""
    i, q, u, v = stokes
    turned_q, turned_u = turned_stokes(q, u, turn)
    return (
        i + element[table, cell, 0] * turned_q,
        element[table, cell, 0] * i + element[table, cell, 1] * turned_q,
        element[table, cell, 2] * turned_u + element[table, cell, 3] * v,
        element[table, cell, 4] * v - element[table, cell, 3] * turned_u,
    )


@kernel
def see_through(row: Array, turn: Turn, element: Array, table: int, cell: int) -> None:
    """Multiply an adjoint path's Mueller matrix by that of a scattering event.

    The light is scattered first and its frame then turned back, so the matrix is
    multiplied from the right: A L(-azimuth) M.
    """
    cos2 = turn[0] * turn[0] - turn[1] * turn[1]
    sin2 = 2.0 * turn[0] * turn[1]
    for k in range(4):
        at = 3 + 4 * k
        a0, a1, a2, a3 = row[at], row[at + 1], row[at + 2], row[at + 3]
        b1 = a1 * cos2 + a2 * sin2
        b2 = a2 * cos2 - a1 * sin2
        row[at] = a0 + b1 * element[table, cell, 0]
        row[at + 1] = a0 * element[table, cell, 0] + b1 * element[table, cell, 1]
        row[at + 2] = b2 * element[table, cell, 2] - a3 * element[table, cell, 3]
        row[at + 3] = b2 * element[table, cell, 3] + a3 * element[table, cell, 4]


@kernel
def between_frames(n: Vector, e: Vector, axis: Vector) -> Turn:
    """Return cosine and sine of the angle between two polarization axes around n."""
    p = cross(n, e)
    return (
        e[0] * axis[0] + e[1] * axis[1] + e[2] * axis[2],
        p[0] * axis[0] + p[1] * axis[1] + p[2] * axis[2],
    )


@kernel
def turned_stokes(q: float, u: float, turn: Turn) -> tuple[float, float]:
    """Return Stokes parameters Q and U relative to a rotated polarization axis."""
    cos2 = turn[0] * turn[0] - turn[1] * turn[1]
    sin2 = 2.0 * turn[0] * turn[1]
    return q * cos2 + u * sin2, u * cos2 - q * sin2


@kernel
def connected(
    n: Vector,
    light: Array,
    m: Vector,
    path_matrix: Array,
    element: Array,
    table: int,
    cell: int,
    out: Array,
) -> None:
    """Fill `out` with the received Stokes vector of light scattered from n to m.

    light holds frame and Stokes vector of the light along n, path_matrix frame and
    Mueller matrix from the light along m to the receiver.
    """
    e = (light[0], light[1], light[2])
    cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
    ax, ay, az = m[0] - cosine * n[0], m[1] - cosine * n[1], m[2] - cosine * n[2]
    norm = math.sqrt(ax * ax + ay * ay + az * az)
    if norm > 1e-12:
        ax, ay, az = ax / norm, ay / norm, az / norm
    else:
        ax, ay, az = e
        norm = 0.0
    turn = between_frames(n, e, (ax, ay, az))
    vector = (light[3], light[4], light[5], light[6])
    i, q, u, v = scattered(vector, turn, element, table, cell)
    # The parallel axis after the scattering, and from there to that of path_matrix.
    f = (
        cosine * ax - norm * n[0],
        cosine * ay - norm * n[1],
        cosine * az - norm * n[2],
    )
    turn = between_frames(m, f, (path_matrix[0], path_matrix[1], path_matrix[2]))
    q, u = turned_stokes(q, u, turn)
    received(path_matrix, (i, q, u, v), out)


@kernel
def received(path_matrix: Array, stokes: Stokes, out: Array) -> None:
    """Fill `out` with the product of an adjoint path's matrix and a Stokes vector."""
    for k in range(4):
        at = 3 + 4 * k
        out[k] = (
            path_matrix[at] * stokes[0]
            + path_matrix[at + 1] * stokes[1]
            + path_matrix[at + 2] * stokes[2]
            + path_matrix[at + 3] * stokes[3]
        )


@kernel
def reflected(
    n: Vector, light: Array, mueller: Array, right: Vector, m: Vector, frame: Vector
) -> Stokes:
    """Return the Stokes vector of light reflected by the target from n to m.

    The matrix of the surface leads from axes that lie as near as can be to the axis
    right, which belongs to the scene, before to after.
    """
    axis = (light[0], light[1], light[2])
    turn = between_frames(n, axis, projected_frame(n, right))
    q, u = turned_stokes(light[4], light[5], turn)
    i, v = light[3], light[6]
    out_i = (
        mueller[0, 0] * i + mueller[0, 1] * q + mueller[0, 2] * u + mueller[0, 3] * v
    )
    out_q = (
        mueller[1, 0] * i + mueller[1, 1] * q + mueller[1, 2] * u + mueller[1, 3] * v
    )
    out_u = (
        mueller[2, 0] * i + mueller[2, 1] * q + mueller[2, 2] * u + mueller[2, 3] * v
    )
    out_v = (
        mueller[3, 0] * i + mueller[3, 1] * q + mueller[3, 2] * u + mueller[3, 3] * v
    )
    turn = between_frames(m, projected_frame(m, right), frame)
    out_q, out_u = turned_stokes(out_q, out_u, turn)
    return out_i, out_q, out_u, out_v
