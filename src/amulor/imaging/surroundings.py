"""Range error from scattered light of brighter or darker surroundings."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.cube.error import may_contain
from amulor.errors import SurveyError
from amulor.imaging.corners import echo_over_white
from amulor.imaging.observation import Observation
from amulor.optics import rays
from amulor.optics._surroundings import Surroundings
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.view import line_of_sight, view
from amulor.survey.waters.whole_function import gaussian_arguments

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Blocks of a scan, about.
_BLOCKS = 400
#: Directions along each side of the scan for which a white surface is computed.
_DIRECTIONS = 5
#: Blocks near a pixel, between which the light of the surroundings is interpolated.
_NEIGHBORS = 4
#: Repetitions of the deblurring of the amplitudes.
_REPEATS = 5
#: A place is on another surface if it is farther behind or before the beam's plane than
#: its distance from the beam, and by so many standard errors of the ranges [1].
_NOISE = 3.0
#: Radius of the planes through the ranges of blocks, and least radius of blocks that
#: determine a slope, over the distance [1].
_PLANE, _NARROW = 0.3, 0.02
#: A pixel differs from its surroundings from so many standard errors on, and from the
#: relative error of the brightness by the model on [1].
_DIFFERENT, _MODEL = 5.0, 0.03
#: Light of the surroundings counts from this part of the other range error on [1].
_MATTERS = 0.05


@dataclass(frozen=True, kw_only=True)
class SurroundingLight:
    """Scattered light of the surroundings in blocks of a scan."""

    direction: Floats
    """Beam directions in the water, shape (blocks, 3) [1]."""
    share: Complex
    """Share of the echo from surroundings of equal brightness, (frequency, block) [1].
    """
    light: Complex
    """Light of the surroundings over that of a white surface, (frequency, block) [1].
    """
    matters: bool = False
    """Whether a pixel of the scan has a relevant range error from this light."""


def surroundings_error(
    observation: Observation,
    slant_range: Floats,
    *,
    weight: Floats,
    slope: Floats,
    noise: Floats,
    fit: SurroundingLight | None = None,
) -> tuple[Floats | None, SurroundingLight | None]:
    """Range error from light of the surroundings (None if absent), and this light.

    The brightness of the surface follows from the amplitudes and the survey. None
    without a survey, in water that does not scatter, from a vehicle, and for samples
    that were simulated without such light (attribute `surroundings_light`).
    """
    channel, survey = observation.channel, observation.survey
    if survey is None or not may_contain(channel, "surroundings_light"):
        return None, None
    start = np.asarray(observation.geometry.emitter).reshape(-1, 3)
    if survey.platform is not None or np.ptp(start, axis=0).any():
        return None, None
    try:
        water = water_properties(survey)
        if water.scattering == 0:
            return None, None
        bright = echo_over_white(
            observation, survey, water, slant_range, directions=_DIRECTIONS
        )
        judged = fit is None
        if fit is None:
            fit = _surrounding_light(
                observation, slant_range, bright, noise, survey=survey, water=water
            )
    except SurveyError:
        return None, None
    if fit is None:
        return None, None
    error = np.zeros(slant_range.shape)
    valid = np.isfinite(bright) & np.isfinite(slant_range)
    near, part = _near(observation.geometry.beam.direction[valid], fit.direction)
    light = np.einsum("fpn,pn->fp", fit.light[:, near], part)
    share = np.einsum("fpn,pn->fp", fit.share[:, near], part)
    measured = bright[valid]
    # Brightness of the surface, of which the own echo is the rest of the share.
    surface = (measured - light[0].real) / (1 - share[0].real)
    turned = np.angle(np.maximum(surface, 0.0) * (1 - share) + light)
    per_phase = (weight * observation.path_per_phase.ravel())[:, None]
    shift = np.abs(slope[valid] * np.sum(per_phase * turned, axis=0))
    sigma = np.min(observation.sigma, axis=0)[valid]
    contrast = np.abs(1 - light[0].real / (measured * share[0].real))
    differs = contrast > np.hypot(_DIFFERENT * sigma, _MODEL)
    error[valid] = np.where(differs, shift, 0.0)
    if judged:
        fit = replace(fit, matters=bool(np.any(error > _MATTERS * noise)))
    return (error if fit.matters else None), fit


def _surrounding_light(
    observation: Observation,
    slant_range: Floats,
    bright: Floats,
    noise: Floats,
    *,
    survey: Survey,
    water: WaterProperties,
) -> SurroundingLight | None:
    """Deblur the amplitudes of a scan in blocks; return the light around each block."""
    beam = observation.geometry.beam
    rows, columns = slant_range.shape
    side = math.ceil(math.sqrt(rows * columns / _BLOCKS))
    block = np.arange(rows)[:, None] // side * math.ceil(columns / side)
    block = block + np.arange(columns) // side
    valid = np.isfinite(bright) & np.isfinite(slant_range) & np.isfinite(noise)
    if not valid.any():
        return None
    number, block = np.unique(block[valid], return_inverse=True)

    def mean(values: Floats) -> Floats:
        count = np.bincount(block)
        return np.asarray(np.bincount(block, weights=values[valid]) / count)

    azimuth, elevation = (
        mean(values)
        for values in (observation.geometry.azimuth, observation.geometry.elevation)
    )
    start = np.broadcast_to(
        np.asarray(observation.geometry.emitter).reshape(-1, 3)[0], (number.size, 3)
    )
    ahead = rays.enter_water(
        start, rays.direction(azimuth, elevation), medium=observation.geometry.medium
    )
    sight = line_of_sight(survey, azimuth, elevation)
    depth = mean(observation.geometry.depth(slant_range))
    surroundings = Surroundings(
        ahead.entry,
        ahead.direction,
        depth,
        sight_start=np.broadcast_to(sight.entry, ahead.entry.shape),
        sight=np.broadcast_to(sight.direction, ahead.entry.shape),
    )
    own, share = _weights(
        surroundings,
        gaussian_arguments(survey, water, view(survey, azimuth, elevation)),
        2 * math.pi * observation.frequency * water.group_index / speed_of_light,
        error=mean(noise),
    )
    measured = surface = mean(bright)
    blur = np.diag(1 - own[0].real) + share[0].real
    for _ in range(_REPEATS):
        surface = np.maximum(surface + measured - blur @ surface, 0.0)
    return SurroundingLight(
        direction=_mean_direction(beam.direction, valid, block),
        share=own,
        light=share @ surface,
    )


def _mean_direction(
    direction: Floats, valid: NDArray[np.bool_], block: NDArray[np.intp]
) -> Floats:
    """Return the mean beam direction of each block, shape (block, 3) [1]."""
    sums = [np.bincount(block, weights=part) for part in direction[valid].T]
    mean = np.stack(sums, axis=1)
    return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True))


def _weights(
    surroundings: Surroundings,
    arguments: dict[str, object],
    wavenumber: Floats,
    *,
    error: Floats,
) -> tuple[Complex, Complex]:
    """Return shares of the light from all surroundings, and from each block [1].

    Shapes (frequency, block) and (frequency, block, block). Places beyond the scan
    count as the nearest block, and places on other surfaces as the block itself.
    """
    from scipy.spatial import cKDTree

    count = surroundings.depth.size
    tree = cKDTree(surroundings.ahead)
    slope, same = _planes(surroundings, error)
    total, rings = surroundings.weights(arguments, wavenumber)
    matrix = np.zeros((wavenumber.size, count * count), dtype=complex)
    for aside, weight in rings:
        nearest = tree.query(surroundings.ways(aside)[1])[1]
        total += weight.sum(axis=1)
        farther = np.sum(aside * slope, axis=-1)
        weight = weight * np.exp(2j * wavenumber[:, None, None] * farther)
        weight *= same[np.arange(count), nearest]
        place = (np.arange(count) * count + nearest).ravel()
        for number, each in enumerate(weight.reshape(wavenumber.size, -1)):
            matrix[number] += np.bincount(place, each.real, count * count)
            matrix[number] += 1j * np.bincount(place, each.imag, count * count)
    shares = matrix.reshape(-1, count, count) / total[..., None]
    return shares.sum(axis=2), shares


def _planes(
    surroundings: Surroundings, error: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return slopes of the surface around each beam, and which blocks belong to it.

    Shapes (block, 3), a vector across the beam [1], and (block, block). The ranges of
    dark blocks are wrong, so planes are wider than these.
    """
    ahead, depth = surroundings.ahead, surroundings.depth[:, None]
    cosine = np.clip(ahead @ ahead.T, 0.1, 1.0)
    behind = depth.T * cosine - depth
    across = np.einsum("cik,jk->cij", surroundings.across, ahead) * depth.T
    distance = np.linalg.norm(across, axis=0)
    same = np.abs(behind) < distance + _NOISE * error[:, None]
    weight = same * np.exp(-((distance / (_PLANE * depth)) ** 2))
    terms = np.concatenate([np.ones_like(across[:1]), across])
    normal = np.einsum("aij,bij,ij->iab", terms, terms, weight)
    # A row of pixels has no slope across it.
    least = np.diag([1e-12, 1.0, 1.0]) * (_NARROW * depth[:, :, None]) ** 2
    right = np.einsum("aij,ij->ia", terms, weight * behind)[..., None]
    fitted = np.linalg.solve(normal + least, right)[:, 1:, 0]
    return np.einsum("ic,cik->ik", fitted, surroundings.across), same


def _near(direction: Floats, blocks: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Return the blocks nearest to each direction, and their parts of a mean [1]."""
    from scipy.spatial import cKDTree

    count = min(_NEIGHBORS, len(blocks))
    distance, number = cKDTree(blocks).query(direction, k=list(range(1, count + 1)))
    part = 1 / np.maximum(distance, 1e-9) ** 2
    return np.asarray(number), np.asarray(part / part.sum(axis=1, keepdims=True))
