"""Range error from light reflected twice in concave corners of the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.cube.error import may_contain
from amulor.cube.tiles import Span, span_of
from amulor.errors import SurveyError
from amulor.imaging.observation import Observation
from amulor.optics import target_echo
from amulor.survey import Survey, WaterProperties, counting, water_properties
from amulor.survey.view import angle_of_view, view
from amulor.survey.waters.whole_function import whole_function_arguments

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Patches of a scan, about.
_PATCHES = 400
#: Least width of a patch, in pixels.
_NARROWEST = 3
#: Largest standard error of the tilt of a patch, from the noise of its pixels [rad].
_TILT = 0.15
#: A patch is flat if it deviates from its plane by less than this part of its width,
#: or by so many standard errors of its pixels [1].
_FLAT, _NOISE = 0.05, 2.0
#: Patches near a pixel; the largest shift by their orientations counts.
_NEIGHBORS = 4
#: Least cosine of the angle between a surface and the direction to the receiver [1].
_GRAZING = 0.05
#: Light that is reflected twice counts from this part of a range error on [1].
_MATTERS = 0.05
#: Share of a painted echo that a channel passes, in the absence of a better number; and
#: of light that is reflected twice, which has no polarization left [1].
_PASSED = {True: 0.75, False: 0.25}
_UNPOLARIZED = 0.5
#: Depolarization of the water over that of a surface, unless better known.
_WATER_TO_SURFACE = 0.5
#: Light of corners is a probable cause from this share of the pixels on [1].
_CORNER_SHARE = 0.02
#: Shift of joint estimates over that of one channel, in simulated corners [1].
_JOINT = 2.0
#: Depths at which the echo of a white surface is computed.
_DEPTHS = 5
#: Angle by which directions reach beyond those of the scan [rad].
_MARGIN = 1e-6
#: Pixels that are computed at once.
_AT_ONCE = 4096


@dataclass(frozen=True, kw_only=True)
class Patches:
    """Flat surface patches of a scan, as light sources for other patches."""

    position: Floats
    """Centers, shape (patches, 3) [m]."""
    normal: Floats
    """Unit normals toward the instrument, shape (patches, 3) [1]."""
    area: Floats
    """Areas, shape (patches,) [m^2]."""
    brightness: Floats
    """Reflectance times the cosine toward the receiver, shape (patches,) [1]."""
    concerned: NDArray[np.bool_]
    """Mask of patches with a relevant range error from other patches."""


def corner_ratio(
    position: Floats,
    normal: Floats,
    patches: Patches,
    *,
    receiver: Floats,
    modulation_frequency: Floats,
    group_index: float,
    attenuation: float = 0.0,
    acceptance: float = math.inf,
) -> Complex:
    r"""Return the ratio of doubly to singly reflected light, by frequency and point.

    A Lambertian patch Q of area A, at the distance r from the lit point P, adds

    .. math:: \frac{\varrho_Q \cos\theta_Q}{\pi \cos\theta_P}
        \frac{\cos\theta_{PQ} \cos\theta_{QP} A}{r^2 + A / \pi}
        \left(\frac{z_P}{z_Q}\right)^2 \exp (i \omega / v - k) (r + z_Q - z_P) .

    The form factor with :math:`A / \pi` is that of a disk on the axis, and is finite
    where patches touch.
    """
    way = patches.position[None] - position[:, None]
    distance = np.maximum(np.linalg.norm(way, axis=2), 1e-9)
    leaving = np.einsum("pqi,pi->pq", way, normal) / distance
    arriving = -np.einsum("pqi,qi->pq", way, patches.normal) / distance
    form = np.maximum(leaving, 0.0) * np.maximum(arriving, 0.0) * patches.area
    form /= distance**2 + patches.area / math.pi
    back, direct = receiver - patches.position, receiver - position
    back_length, direct_length = (np.linalg.norm(v, axis=1) for v in (back, direct))
    facing = np.einsum("pi,pi->p", direct, normal) / direct_length
    size = form * patches.brightness / (math.pi * np.maximum(facing, _GRAZING)[:, None])
    size *= (direct_length[:, None] / back_length) ** 2
    longer = distance + back_length - direct_length[:, None]
    size *= np.exp(-attenuation * longer)
    if math.isfinite(acceptance):
        aside = np.einsum(
            "pi,qi->pq", direct / direct_length[:, None], back / back_length[:, None]
        )
        size *= np.exp(-((np.arccos(np.clip(aside, -1, 1)) / acceptance) ** 2))
    per_path = 2 * math.pi * modulation_frequency * group_index / speed_of_light
    return np.stack([np.sum(size * np.exp(1j * k * longer), axis=1) for k in per_path])


def corner_error(
    observation: Observation,
    slant_range: Floats,
    *,
    weight: Floats,
    slope: Floats,
    noise: Floats,
    fit: Patches | None = None,
) -> tuple[Floats | None, Patches | None]:
    """Range error from doubly reflected light (None if absent), and surface patches.

    None without a survey, and for simulated samples without such light (attribute
    `corner_light`). The reflectance of a patch comes from its
    amplitude and the survey, and is at most 1.
    """
    channel, survey = observation.channel, observation.survey
    if survey is None or not may_contain(channel, "corner_light"):
        return None, None
    position = observation.geometry.position(slant_range)
    name = str(channel["polarization"].item())
    passed = 1.0 if name == "none" else _PASSED[name in ("VV", "HH", "RL", "LR")]
    # Light that is reflected twice is unpolarized, and passes crossed analyzers better.
    boost = 1.0 if name == "none" else max(1.0, _UNPOLARIZED / passed)
    boost *= _leverage(observation)
    receiver = np.asarray(observation.geometry.receiver, dtype=float).reshape(-1, 3)[0]
    try:
        water = water_properties(survey)
        if fit is None:
            fit = _patches(
                observation, slant_range, position, noise, receiver=receiver,
                brightness=echo_over_white(observation, survey, water, slant_range)
                / passed,
            )  # fmt: skip
    except SurveyError:
        return None, None
    if not fit.area.size:
        return None, fit
    patches = fit
    group_index = float(observation.geometry.medium.group_index)
    acceptance = angle_of_view(survey)
    per_phase = (weight * observation.path_per_phase.ravel())[:, None]

    def path_error(position: Floats, normal: Floats) -> Floats:
        ratio = corner_ratio(
            position,
            normal,
            patches,
            receiver=receiver,
            modulation_frequency=observation.frequency,
            group_index=group_index,
            attenuation=water.reduced_attenuation,
            acceptance=acceptance,
        )
        return np.asarray(np.sum(per_phase * np.angle(1 + boost * ratio), axis=0))

    error = np.zeros(slant_range.shape)
    valid = np.isfinite(position).all(axis=-1)
    near = _nearest(position[valid], fit.position)
    if not fit.concerned.size:
        limit = _MATTERS * float(np.median(noise[valid])) if valid.any() else math.inf
        shift = np.median(slope[valid]) * path_error(fit.position, fit.normal)
        fit = replace(fit, concerned=np.abs(shift) > limit)
    rows, columns = np.nonzero(valid)
    for neighbor in near.T:
        chosen = np.flatnonzero(fit.concerned[neighbor])
        for first in range(0, chosen.size, _AT_ONCE):
            part = chosen[first : first + _AT_ONCE]
            place = rows[part], columns[part]
            shift = path_error(position[place], fit.normal[neighbor[part]])
            error[place] = np.maximum(error[place], np.abs(slope[place] * shift))
    return (error if fit.concerned.any() else None), fit


def is_corner_light(corners: Floats, rest: Floats) -> bool:
    """Return whether the error by light of corners exceeds the rest in some pixels."""
    return bool(np.mean(corners > rest) > _CORNER_SHARE)


def _leverage(observation: Observation) -> float:
    """Return the factor on the shift by two channels, which separated the water.

    The method `polarization` separates the echo by its depolarization ratio, which
    unpolarized light does not have. Joint estimation finds the water by both channels.
    At one frequency, other methods estimate a change of the water from the phase
    between two channels. Unpolarized light changes it.
    """
    attributes = observation.channel.attrs
    parallel, crossed = (_UNPOLARIZED / _PASSED[equal] for equal in (True, False))
    if {"target_ratio", "water_ratio"} <= set(attributes):
        target, water = (float(attributes[f"{n}_ratio"]) for n in ("target", "water"))
        return _UNPOLARIZED * (1 + target) * (1 - water) / abs(target - water)
    if "joint_misfit" in attributes:
        return _JOINT
    estimated = {"open_water_change", "channel_phase_probability"} <= set(attributes)
    if observation.frequency.size > 1 or not estimated:
        return 1.0
    return parallel + (crossed - parallel) / (1 - _WATER_TO_SURFACE)


def echo_over_white(
    observation: Observation,
    survey: Survey,
    water: WaterProperties,
    slant_range: Floats,
    *,
    directions: int = 1,
) -> Floats:
    """Return the echo relative to that of a white surface facing the receiver [1].

    With several directions along each side of the scan, the field of view of a
    receiver that does not move is taken into account.
    """
    from scipy.interpolate import RegularGridInterpolator

    geometry = observation.geometry
    depth = geometry.depth(slant_range)
    usable = np.isfinite(depth) & (depth > 0)
    if not usable.any():
        return np.full(depth.shape, np.nan)
    span = observation.span or span_of(observation.channel)
    sides = [
        np.array([np.mean(angle)])
        if directions == 1
        else np.linspace(low - _MARGIN, high + _MARGIN, directions)
        for angle, (low, high) in (
            (geometry.azimuth, span.azimuth),
            (geometry.elevation, span.elevation),
        )
    ]
    seen = view(survey, *np.meshgrid(*sides, [0.0], indexing="ij")[:2])
    ends = float(depth[usable].min()), float(depth[usable].max())
    depths = np.geomspace(ends[0] * 0.999, ends[1] * 1.001, _DEPTHS)
    white = target_echo.small_angle_target_response(
        observation.frequency[0],
        depth=depths,
        optical_path=2 * depths,
        reflectance=1.0,
        **whole_function_arguments(survey, water, seen),
    )
    instrument = survey.instrument
    volt = (
        instrument.modulation_depth
        * instrument.detector.volt_per_photoelectron_rate
        * counting.full_rate(survey)
        * float(seen.transmission.mean())
    )
    logarithm = np.log(np.abs(white))
    places = np.log(np.where(usable, depth, ends[0]))
    if directions == 1:
        values = np.interp(places, np.log(depths), logarithm.ravel())
    else:
        values = RegularGridInterpolator(
            (*sides, np.log(depths)), logarithm, method="cubic"
        )(np.stack([geometry.azimuth, geometry.elevation, places], axis=-1))
    bright = np.abs(observation.signal[0]) / (volt * np.exp(values))
    return np.asarray(np.where(usable, bright, np.nan))


def _patches(
    observation: Observation,
    slant_range: Floats,
    position: Floats,
    noise: Floats,
    *,
    receiver: Floats,
    brightness: Floats,
) -> Patches:
    """Divide a scan into blocks of pixels; return the flat ones as surface patches."""
    rows, columns = slant_range.shape
    side = _side(observation, slant_range, noise)
    scale = _coverage(observation)
    found: list[tuple[Floats, Floats, float, float]] = []
    for row in range(0, rows, side):
        for column in range(0, columns, side):
            block = slice(row, row + side), slice(column, column + side)
            patch = _plane(position[block], noise[block], brightness[block])
            if patch is not None:
                found.append(patch)
    normals = np.array([patch[1] for patch in found]).reshape(-1, 3)
    centers = np.array([patch[0] for patch in found]).reshape(-1, 3)
    away = np.einsum("pi,pi->p", normals, receiver - centers) < 0
    normals[away] *= -1
    back = receiver - centers
    facing = np.einsum("pi,pi->p", normals, back) / np.linalg.norm(back, axis=1)
    return Patches(
        position=centers,
        normal=normals,
        area=scale * np.array([patch[2] for patch in found]),
        # A surface reflects no more light than it receives.
        brightness=np.minimum(np.array([patch[3] for patch in found]), facing),
        concerned=np.zeros(0, dtype=bool),
    )


def _plane(
    position: Floats, noise: Floats, brightness: Floats
) -> tuple[Floats, Floats, float, float] | None:
    """Center, normal, area and brightness of a block; None if it is not flat."""
    valid = np.isfinite(position).all(axis=-1)
    if valid.sum() < max(4, valid.size / 2):
        return None
    row, column = np.nonzero(valid)
    plane = np.stack([np.ones(row.size), row, column], axis=1)
    points = position[valid]
    fit, _, rank, _ = np.linalg.lstsq(plane, points, rcond=None)
    across = np.cross(fit[1], fit[2])
    size = float(np.linalg.norm(across))
    if rank < 3 or size <= 0:
        return None
    normal = across / size
    rest = float(np.std((points - plane @ fit) @ normal))
    width = math.sqrt(valid.sum() * size)
    if rest > max(_FLAT * width, _NOISE * float(np.median(noise[valid]))):
        return None
    bright = float(np.median(brightness[valid]))
    return points.mean(axis=0), normal, valid.sum() * size, bright


def _side(observation: Observation, slant_range: Floats, noise: Floats) -> int:
    """Return the width of patches, in pixels."""
    rows, columns = (int(size) for size in slant_range.shape)
    side = max(_NARROWEST, math.ceil(math.sqrt(rows * columns / _PATCHES)))
    step = math.sqrt(math.prod(_steps(observation)))
    ratio = noise / np.where(slant_range > 0, slant_range, np.nan)
    if step > 0 and np.isfinite(ratio).any():
        # The tilt of `side` pixels across has an error of sqrt(12) noise / side^2.
        tilt = math.sqrt(12) * float(np.nanmedian(ratio)) / step
        side = max(side, math.ceil(math.sqrt(tilt / _TILT)))
    return min(side, max(_NARROWEST, min(rows, columns) // 3))


def _steps(observation: Observation) -> tuple[float, float]:
    """Return the angles between neighbors of a row and of a column; 0 for one [rad]."""
    azimuth, elevation = observation.geometry.azimuth, observation.geometry.elevation
    across, down = np.diff(azimuth, axis=1), np.diff(elevation, axis=0)
    return tuple(  # type: ignore[return-value]
        float(np.median(np.abs(part))) if part.size else 0.0 for part in (across, down)
    )


def _coverage(observation: Observation) -> float:
    """Ratio of the solid angle of the whole scan to that of the pixels, at least 1."""
    span: Span | None = observation.span
    geometry = observation.geometry
    if span is None or min(geometry.azimuth.shape) < 2:
        return 1.0
    steps = _steps(observation)
    if min(steps) <= 0:
        return 1.0
    angles = zip((span.azimuth, span.elevation), steps, strict=True)
    counts = [(high - low) / step + 1 for (low, high), step in angles]
    return max(1.0, counts[0] * counts[1] / geometry.azimuth.size)


def _nearest(position: Floats, centers: Floats) -> NDArray[np.intp]:
    """Return the indices of the patches nearest to each point, (point, neighbor)."""
    from scipy.spatial import cKDTree

    count = min(_NEIGHBORS, len(centers))
    if not len(position):
        return np.zeros((0, count), dtype=np.intp)
    numbers = cKDTree(centers).query(position, k=list(range(1, count + 1)))[1]
    return np.asarray(numbers, dtype=np.intp)
