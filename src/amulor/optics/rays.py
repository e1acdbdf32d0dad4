"""Ray optics: refraction at a flat window, and optical paths to the receiver.

Coordinates are right, down, forward, a right-handed system seen from the instrument.
The window is a plane across the forward axis: the half space before it is air, the one
behind it water. Without a window all is water.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics._bounds import broadcast, finite, last_axes, require


@dataclass(frozen=True, kw_only=True)
class Medium:
    """Media along the light path: water, optionally with air and a window.

    Examples
    --------
    >>> from amulor.optics.rays import Medium
    >>> tank = Medium(
    ...     refractive_index=1.34, group_index=1.38, window_distance=0.1,
    ...     window_thickness=0.01, window_refractive_index=1.5, window_group_index=1.53,
    ... )
    >>> tank.window_thickness
    0.01
    """

    refractive_index: float
    """Phase index of the water [1]."""
    group_index: float
    """Group index of the water [1]."""
    window_distance: float | None = None
    """Forward coordinate of the window's near face; None without a window [m]."""
    window_thickness: float = 0.0
    """Thickness of the pane [m]."""
    window_refractive_index: float = 1.0
    """Phase index of the pane [1]."""
    window_group_index: float = 1.0
    """Group index of the pane [1]."""


@dataclass(frozen=True, kw_only=True)
class Beam:
    """Refracted laser beam in the water, with path lengths from emitter to water.

    Examples
    --------
    >>> from amulor.optics.rays import Medium, enter_water
    >>> water = Medium(refractive_index=1.34, group_index=1.38)
    >>> beam = enter_water([0, 0, 0], [0, 0, 1], medium=water)
    >>> print(beam.direction, beam.length_before)
    [0. 0. 1.] 0.0
    """

    entry: NDArray[np.float64]
    """Point at which the beam enters the water, last axis (3,) [m]."""
    direction: NDArray[np.float64]
    """Unit vector along the beam in the water, last axis (3,) [1]."""
    length_before: NDArray[np.float64]
    """Geometric path length before the water [m]."""
    optical_length_before: NDArray[np.float64]
    """Optical path length before the water, by group index [m]."""


def direction(azimuth: ArrayLike, elevation: ArrayLike) -> NDArray[np.float64]:
    """Return the unit vector (right, down, forward) for an azimuth and an elevation.

    Parameters
    ----------
    azimuth : array_like
        Angle to the right [rad].
    elevation : array_like
        Angle upwards [rad].

    Returns
    -------
    ndarray, last axis (3,)
        Components right, down, forward [1].

    Examples
    --------
    >>> direction(0.0, 0.0) + 0.0
    array([0., 0., 1.])
    """
    turn = finite(azimuth, name="azimuth", unit="rad")
    rise = finite(elevation, name="elevation", unit="rad")
    broadcast(azimuth=turn, elevation=rise)
    azimuth, elevation = np.broadcast_arrays(turn, rise)
    return np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ],
        axis=-1,
    )


def enter_water(position: ArrayLike, unit_vector: ArrayLike, *, medium: Medium) -> Beam:
    """Trace a beam from the emitter through the window into the water.

    Parameters
    ----------
    position : array_like, last axis (3,)
        Start of the beam, before the window if there is one [m].
    unit_vector : array_like, last axis (3,)
        Direction at the start, with a forward component above zero [1].
    medium : Medium
        Indices and window.

    Returns
    -------
    Beam
        The beam in the water, of the broadcast shape.

    Raises
    ------
    ValueError
        If there is a window and a beam starts behind it or does not point at it.

    Notes
    -----
    By Snell's law the index times the component of the vector along the window is
    constant.

    Examples
    --------
    Into a window at 30 degrees: sin 30 / 1.34 is the sine in the water.

    >>> import numpy as np
    >>> tank = Medium(
    ...     refractive_index=1.34, group_index=1.38, window_distance=0.1,
    ...     window_thickness=0.01, window_refractive_index=1.5, window_group_index=1.53,
    ... )
    >>> oblique = [np.sin(np.pi / 6), 0, np.cos(np.pi / 6)]
    >>> beam = enter_water([0, 0, 0], oblique, medium=tank)
    >>> print(f"{beam.direction[0]:.5f} {0.5 / 1.34:.5f}")
    0.37313 0.37313
    """
    start = last_axes(position, (3,), name="position", meaning="(x, y, z)")
    vector = last_axes(unit_vector, (3,), name="unit_vector", meaning="(x, y, z)")
    broadcast(position=start, unit_vector=vector)
    start, vector = np.broadcast_arrays(start, vector)
    if medium.window_distance is None:
        zero = np.zeros(start.shape[:-1])
        return Beam(
            entry=start.copy(),
            direction=vector.copy(),
            length_before=zero,
            optical_length_before=zero.copy(),
        )
    gap = medium.window_distance - start[..., 2]
    require(
        gap,
        ~(gap <= 0),
        name="window_distance - position",
        rule="above 0",
        unit="m",
        hint="with a window, beams must start before it",
    )
    require(
        vector[..., 2],
        ~(vector[..., 2] <= 0),
        name="forward part of unit_vector",
        rule="above 0",
        hint="with a window, beams must point forwards",
    )
    lateral = vector[..., :2]
    in_glass = lateral / medium.window_refractive_index
    in_water = lateral / medium.refractive_index
    forward_glass = np.sqrt(1 - np.sum(in_glass**2, axis=-1))
    forward_water = np.sqrt(1 - np.sum(in_water**2, axis=-1))
    air_length = gap / vector[..., 2]
    glass_length = medium.window_thickness / forward_glass
    entry = np.empty(start.shape)
    entry[..., :2] = (
        start[..., :2]
        + lateral * air_length[..., None]
        + in_glass * glass_length[..., None]
    )
    entry[..., 2] = medium.window_distance + medium.window_thickness
    return Beam(
        entry=entry,
        direction=np.concatenate([in_water, forward_water[..., None]], axis=-1),
        length_before=air_length + glass_length,
        optical_length_before=air_length + medium.window_group_index * glass_length,
    )


def return_length(
    point: ArrayLike, receiver: ArrayLike, *, medium: Medium
) -> NDArray[np.float64]:
    """Return the optical path length from a point to the receiver [m].

    Parameters
    ----------
    point : array_like, last axis (3,)
        Origin of the light, in the water [m].
    receiver : array_like, last axis (3,)
        Position of the receiver [m].
    medium : Medium
        Indices and window.

    Returns
    -------
    ndarray
        Length times group index, summed over the parts of the refracted path [m].

    Notes
    -----
    With a window the ray is found by Newton's method in the tangent of its angle in
    air: its lateral distance rises monotonically and without inflection, since all
    indices are above that of air, so that the iteration converges.

    Examples
    --------
    A way of 5 m times the group index:

    >>> water = Medium(refractive_index=1.34, group_index=1.38)
    >>> print(f"{return_length([0, 0, 4], [3, 0, 0], medium=water):.2f} m")
    6.90 m
    """
    water, before = _ways_back(point, receiver, medium)
    total: NDArray[np.float64] = medium.group_index * water + before
    return total


def return_distance(
    point: ArrayLike, receiver: ArrayLike, *, medium: Medium
) -> NDArray[np.float64]:
    """Return the geometric path length in water from a point to the receiver [m].

    Parameters
    ----------
    point, receiver : array_like, last axis (3,)
        As in `return_length` [m].
    medium : Medium
        Indices and window.

    Returns
    -------
    ndarray
        Length of the part of the refracted path in water [m].

    Examples
    --------
    >>> water = Medium(refractive_index=1.34, group_index=1.38)
    >>> print(f"{return_distance([0, 0, 4], [3, 0, 0], medium=water):.2f} m")
    5.00 m
    """
    return _ways_back(point, receiver, medium)[0]


def _ways_back(
    point: ArrayLike, receiver: ArrayLike, medium: Medium
) -> tuple[NDArray[np.float64], NDArray[np.float64] | float]:
    """Return path length in water, and optical length from window to receiver [m]."""
    source = last_axes(point, (3,), name="point", meaning="(x, y, z)")
    sink = last_axes(receiver, (3,), name="receiver", meaning="(x, y, z)")
    broadcast(point=source, receiver=sink)
    if medium.window_distance is None:
        return np.linalg.norm(source - sink, axis=-1), 0.0
    sideways = np.linalg.norm(source[..., :2] - sink[..., :2], axis=-1)
    air = medium.window_distance - sink[..., 2]
    glass = medium.window_thickness
    water = source[..., 2] - medium.window_distance - glass
    layers = (
        (np.broadcast_to(air, sideways.shape), 1.0, 1.0),
        (
            np.full(sideways.shape, glass),
            medium.window_refractive_index,
            medium.window_group_index,
        ),
        (water, medium.refractive_index, medium.group_index),
    )
    # The sine in air; the start is that of a straight line with scaled layers.
    scaled = sum(depth / index for depth, index, _ in layers)
    sine = sideways / np.hypot(sideways, scaled)
    for _ in range(_NEWTON_STEPS):
        covered = sum(
            depth * sine / np.sqrt(index**2 - sine**2) for depth, index, _ in layers
        )
        slope = sum(
            depth * index**2 / (index**2 - sine**2) ** 1.5 for depth, index, _ in layers
        )
        # In the tangent t of the angle in air, ds/dt = (1 - s^2)^1.5.
        tangent = sine / np.sqrt(1 - sine**2)
        tangent = tangent - (covered - sideways) / (slope * (1 - sine**2) ** 1.5)
        tangent = np.maximum(tangent, 0.0)
        sine = tangent / np.hypot(1.0, tangent)
    *before, wet = (
        depth * index / np.sqrt(index**2 - sine**2) for depth, index, _ in layers
    )
    optical = sum(
        length * group for length, (_, _, group) in zip(before, layers, strict=False)
    )
    return wet, optical


_NEWTON_STEPS = 8


def optical_path(
    slant_range: ArrayLike,
    beam: Beam,
    receiver: ArrayLike,
    *,
    medium: Medium,
) -> NDArray[np.float64]:
    """Return the two-way optical path to a point at a slant range on a beam [m].

    Parameters
    ----------
    slant_range : array_like
        Distance from the start of the beam along the (refracted) beam [m]. A distance
        before the water is replaced by that of the start of the water.
    beam : Beam
        The beam in the water, from `enter_water`.
    receiver : array_like, last axis (3,)
        Position of the receiver [m].
    medium : Medium
        Indices and window.

    Returns
    -------
    ndarray
        Group index times length, out along the beam and back to the receiver [m].

    See Also
    --------
    slant_range_of_path : The inverse.

    Examples
    --------
    4 m out, 5 m back to a receiver 3 m beside: (4 + 5) times the group index.

    >>> water = Medium(refractive_index=1.34, group_index=1.38)
    >>> beam = enter_water([0, 0, 0], [0, 0, 1], medium=water)
    >>> print(f"{optical_path(4.0, beam, [3.0, 0, 0], medium=water):.2f} m")
    12.42 m
    """
    distance = finite(slant_range, name="slant_range", unit="m")
    water = np.maximum(distance - beam.length_before, 0.0)
    point = beam.entry + water[..., None] * beam.direction
    back = return_length(point, receiver, medium=medium)
    path: NDArray[np.float64] = (
        beam.optical_length_before + medium.group_index * water + back
    )
    return path


def slant_range_of_path(
    optical_path: ArrayLike,
    beam: Beam,
    receiver: ArrayLike,
    *,
    medium: Medium,
) -> NDArray[np.float64]:
    r"""Return the slant range of a surface for a two-way optical path [m].

    Parameters
    ----------
    optical_path : array_like
        Group index times length, out along the beam and back to the receiver [m].
    beam : Beam
        The beam in the water, from `enter_water`.
    receiver : array_like, shape (3,)
        Position of the receiver [m].
    medium : Medium
        Indices and window.

    Returns
    -------
    ndarray
        Distance from the start of the beam along the (refracted) beam [m]; NaN if no
        point of the beam in the water has so short a path.

    Notes
    -----
    Without a window the point lies on an ellipsoid around emitter and receiver and the
    distance has a closed form: with the path :math:`L`, the baseline vector :math:`b`
    and the unit vector :math:`u`, :math:`s = (L^2 - b^2) / 2 (L - u \cdot b)`. With a
    window a secant iteration starts from the closed form for a straight path.

    Examples
    --------
    The way of `optical_path`, back:

    >>> water = Medium(refractive_index=1.34, group_index=1.38)
    >>> beam = enter_water([0, 0, 0], [0, 0, 1], medium=water)
    >>> path = 1.38 * (4.0 + 5.0)
    >>> print(f"{slant_range_of_path(path, beam, [3.0, 0, 0], medium=water):.2f} m")
    4.00 m
    """
    path = np.asarray(optical_path, dtype=float) - beam.optical_length_before
    sink = last_axes(receiver, (3,), name="receiver", meaning="(x, y, z)")
    broadcast(optical_path=path, receiver=sink[..., 0])
    baseline = sink - beam.entry
    along = np.sum(beam.direction * baseline, axis=-1)
    square = np.sum(baseline**2, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        if medium.window_distance is None:
            length = path / medium.group_index
            water = (length**2 - square) / (2 * (length - along))
            water = np.where(length >= np.sqrt(square), water, np.nan)
            return water + beam.length_before

        def excess(water: NDArray[np.float64]) -> NDArray[np.float64]:
            spot = beam.entry + water[..., None] * beam.direction
            back = return_length(spot, sink, medium=medium)
            return medium.group_index * water + back - path

        first = np.maximum(
            (path - beam.optical_length_before) / (2 * medium.group_index), 0.0
        )
        value = excess(first)
        # The path grows by close to two group indices for each metre of range.
        second = np.maximum(first - value / (2 * medium.group_index), 0.0)
        for _ in range(_SECANT_STEPS):
            next_value = excess(second)
            change = next_value - value
            step = np.where(change == 0, 0.0, next_value * (second - first) / change)
            first, value = second, next_value
            second = np.maximum(second - step, 0.0)
        reached = np.abs(excess(second)) < 1e-9 * np.maximum(np.abs(path), 1.0)
        return np.where(reached, second, np.nan) + beam.length_before


_SECANT_STEPS = 6


def path_limits(
    interval: tuple[float, float] | None,
    beam: Beam,
    receiver: ArrayLike,
    *,
    medium: Medium,
    modulation_frequency: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the shortest and longest two-way optical path for range limits [m].

    Parameters
    ----------
    interval : tuple of float, optional
        Nearest and farthest slant range [m]; by default from 0 to the unambiguous range
        of all frequencies together.
    beam : Beam
        The beam in the water, from `enter_water`.
    receiver : array_like, last axis (3,)
        Position of the receiver [m].
    medium : Medium
        Indices and window.
    modulation_frequency : array_like, shape (n,)
        Modulation frequencies, increasing [Hz].

    Returns
    -------
    tuple of two ndarrays
        Shortest and longest path, of the shape of the beams [m].

    Raises
    ------
    ValueError
        If the interval is empty.

    Notes
    -----
    The unambiguous range is that of the smallest among the frequencies and their
    differences. A range of 0 means the start of the water.

    Examples
    --------
    One frequency of 50 MHz settles a path of one wavelength, c / f:

    >>> water = Medium(refractive_index=1.34, group_index=1.38)
    >>> beam = enter_water([0, 0, 0], [0, 0, 1], medium=water)
    >>> nearest, farthest = path_limits(
    ...     None, beam, [0, 0, 0], medium=water, modulation_frequency=[50e6]
    ... )
    >>> print(f"{float(farthest):.3f} m")
    5.996 m
    """
    nearest, farthest = (0.0, np.inf) if interval is None else interval
    if not 0 <= nearest < farthest:
        raise ValueError(
            f"interval must run from at least 0 to a larger range [m], got {nearest:g} "
            f"to {farthest:g}"
        )

    def path_at(slant_range: float) -> NDArray[np.float64]:
        return optical_path(slant_range, beam, receiver, medium=medium)

    shortest = path_at(nearest)
    if interval is not None:
        return shortest, path_at(farthest)
    # One whole period of the path from its shortest on.
    frequency = np.asarray(modulation_frequency, dtype=float)
    smallest = np.min(np.append(np.diff(frequency), frequency[0]))
    return shortest, shortest + speed_of_light / smallest
