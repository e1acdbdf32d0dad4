"""Stokes vectors along a path in compiled loops: frames, rotations, scattering.

The frame of light that travels along n is a parallel axis e, perpendicular to n; the
perpendicular axis is n x e. A scattering matrix enters as its elements m12, m22, m33,
m34 and m44. Equations: docs/theory, "Photon transport".
"""

from __future__ import annotations

import math

from numba import njit

from amulor.transport._kernels.types import Array, Stokes, Vector

#: Columns of the polarization of a forward segment or touch: frame and Stokes vector.
FORWARD_COLUMNS = 7
#: Columns of that of an adjoint segment: frame and Mueller matrix, row by row.
ADJOINT_COLUMNS = 19


@njit(cache=True, error_model="numpy")
def cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> Vector:
    """Return the product of two vectors that is perpendicular to both."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(cache=True, error_model="numpy")
def turned_frame(
    cos_azimuth: float,
    sin_azimuth: float,
    nx: float,
    ny: float,
    nz: float,
    ex: float,
    ey: float,
    ez: float,
) -> Vector:
    """Return the parallel axis turned about n, towards the perpendicular one."""
    px, py, pz = cross(nx, ny, nz, ex, ey, ez)
    return (
        cos_azimuth * ex + sin_azimuth * px,
        cos_azimuth * ey + sin_azimuth * py,
        cos_azimuth * ez + sin_azimuth * pz,
    )


@njit(cache=True, error_model="numpy")
def projected_frame(nx: float, ny: float, nz: float) -> Vector:
    """Return the part of the axis (1, 0, 0) perpendicular to n, made a unit vector."""
    across = ny * ny + nz * nz
    if across < 1e-24:  # along that axis, where it has no part to the side
        return 0.0, 1.0, 0.0
    norm = math.sqrt(across)
    return across / norm, -nx * ny / norm, -nx * nz / norm


@njit(cache=True, error_model="numpy")
def returning_frame(mx: float, my: float, mz: float) -> Vector:
    """Return (1, 0, 0), turned the short way with the direction (0, 0, -1) to m."""
    # Rotation that takes a = (0, 0, -1) to m: e - (e.m) (a + m) / (1 + a.m), as e.a=0.
    factor = mx / max(1.0 - mz, 1e-300)
    return 1.0 - factor * mx, -factor * my, -factor * (mz - 1.0)


@njit(cache=True, error_model="numpy")
def scattered(
    q: float,
    u: float,
    v: float,
    intensity: float,
    cos_azimuth: float,
    sin_azimuth: float,
    element: Array,
    table: int,
    cell: int,
) -> Stokes:
    """Return the Stokes vector after a turn of the frame and a scattering."""
    cos2 = cos_azimuth * cos_azimuth - sin_azimuth * sin_azimuth
    sin2 = 2.0 * cos_azimuth * sin_azimuth
    turned_q = q * cos2 + u * sin2
    turned_u = u * cos2 - q * sin2
    return (
        intensity + element[table, cell, 0] * turned_q,
        element[table, cell, 0] * intensity + element[table, cell, 1] * turned_q,
        element[table, cell, 2] * turned_u + element[table, cell, 3] * v,
        element[table, cell, 4] * v - element[table, cell, 3] * turned_u,
    )


@njit(cache=True, error_model="numpy")
def seen_through(
    row: Array,
    column: int,
    cos_azimuth: float,
    sin_azimuth: float,
    element: Array,
    table: int,
    cell: int,
    out: Array,
) -> None:
    """Fill out[column:] with the matrix in row[column:] after one more scattering.

    The light is scattered first and its frame then turned back, so the matrix is
    multiplied from the right: A L(-azimuth) M.
    """
    cos2 = cos_azimuth * cos_azimuth - sin_azimuth * sin_azimuth
    sin2 = 2.0 * cos_azimuth * sin_azimuth
    for k in range(4):
        at = column + 4 * k
        a0, a1, a2, a3 = row[at], row[at + 1], row[at + 2], row[at + 3]
        b1 = a1 * cos2 + a2 * sin2
        b2 = a2 * cos2 - a1 * sin2
        out[at] = a0 + b1 * element[table, cell, 0]
        out[at + 1] = a0 * element[table, cell, 0] + b1 * element[table, cell, 1]
        out[at + 2] = b2 * element[table, cell, 2] - a3 * element[table, cell, 3]
        out[at + 3] = b2 * element[table, cell, 3] + a3 * element[table, cell, 4]


@njit(cache=True, error_model="numpy")
def between_frames(
    nx: float,
    ny: float,
    nz: float,
    ex: float,
    ey: float,
    ez: float,
    tx: float,
    ty: float,
    tz: float,
) -> tuple[float, float]:
    """Return cosine and sine of the turn from one frame to another of direction n."""
    px, py, pz = cross(nx, ny, nz, ex, ey, ez)
    return ex * tx + ey * ty + ez * tz, px * tx + py * ty + pz * tz


@njit(cache=True, error_model="numpy")
def turned_stokes(
    q: float, u: float, cos_azimuth: float, sin_azimuth: float
) -> tuple[float, float]:
    """Return Q and U in a frame turned towards the perpendicular axis."""
    cos2 = cos_azimuth * cos_azimuth - sin_azimuth * sin_azimuth
    sin2 = 2.0 * cos_azimuth * sin_azimuth
    return q * cos2 + u * sin2, u * cos2 - q * sin2


@njit(cache=True, error_model="numpy")
def connected(
    nx: float,
    ny: float,
    nz: float,
    light: Array,
    mx: float,
    my: float,
    mz: float,
    seen: Array,
    element: Array,
    table: int,
    cell: int,
    out: Array,
) -> None:
    """Fill out with the Stokes vector that arrives by a scattering from n to m.

    light holds frame and Stokes vector of the light along n, seen holds frame and
    Mueller matrix from the light along m to the receiver.
    """
    ex, ey, ez = light[0], light[1], light[2]
    cosine = nx * mx + ny * my + nz * mz
    ax, ay, az = mx - cosine * nx, my - cosine * ny, mz - cosine * nz
    norm = math.sqrt(ax * ax + ay * ay + az * az)
    if norm > 1e-12:
        ax, ay, az = ax / norm, ay / norm, az / norm
    else:
        ax, ay, az = ex, ey, ez
        norm = 0.0
    cos1, sin1 = between_frames(nx, ny, nz, ex, ey, ez, ax, ay, az)
    stokes_i, stokes_q, stokes_u, stokes_v = scattered(
        light[4], light[5], light[6], light[3], cos1, sin1, element, table, cell
    )
    # The parallel axis after the scattering, and from there to the frame of seen.
    fx = cosine * ax - norm * nx
    fy = cosine * ay - norm * ny
    fz = cosine * az - norm * nz
    cos2, sin2 = between_frames(mx, my, mz, fx, fy, fz, seen[0], seen[1], seen[2])
    stokes_q, stokes_u = turned_stokes(stokes_q, stokes_u, cos2, sin2)
    received(seen, stokes_i, stokes_q, stokes_u, stokes_v, out)


@njit(cache=True, error_model="numpy")
def received(
    seen: Array,
    stokes_i: float,
    stokes_q: float,
    stokes_u: float,
    stokes_v: float,
    out: Array,
) -> None:
    """Fill out with the product of the matrix in seen and a Stokes vector."""
    for k in range(4):
        at = 3 + 4 * k
        out[k] = (
            seen[at] * stokes_i
            + seen[at + 1] * stokes_q
            + seen[at + 2] * stokes_u
            + seen[at + 3] * stokes_v
        )


@njit(cache=True, error_model="numpy")
def reflected(
    nx: float,
    ny: float,
    nz: float,
    light: Array,
    mueller: Array,
    mx: float,
    my: float,
    mz: float,
    frame: Array,
) -> Stokes:
    """Return the Stokes vector reflected from n to m, in a given frame of m.

    The matrix of the surface leads from axes that lie as near as can be to
    (1, 0, 0), before to after.
    """
    tx, ty, tz = projected_frame(nx, ny, nz)
    cos1, sin1 = between_frames(nx, ny, nz, light[0], light[1], light[2], tx, ty, tz)
    q, u = turned_stokes(light[4], light[5], cos1, sin1)
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
    tx, ty, tz = projected_frame(mx, my, mz)
    cos2, sin2 = between_frames(mx, my, mz, tx, ty, tz, frame[0], frame[1], frame[2])
    out_q, out_u = turned_stokes(out_q, out_u, cos2, sin2)
    return out_i, out_q, out_u, out_v
