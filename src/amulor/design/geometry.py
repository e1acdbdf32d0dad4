"""Geometry of an instrument: emitter, receiver and optical paths."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import rays
from amulor.survey import Survey
from amulor.survey.view import View, medium_of, view

__all__ = ["Place", "aim_of", "place_of", "with_receiver"]

Floats = NDArray[np.float64]

#: Step of the distance for the derivative of the path [m].
_STEP = 1e-4


@dataclass(frozen=True, kw_only=True)
class Place:
    """Geometry of the receiver relative to the middle beam of a scan."""

    view: View
    """Receiver's view of the beam, arrays of length one."""
    depth: Floats
    """Part of each slant range that lies in water, shape (distance,) [m]."""
    path: Floats
    """Two-way optical path, shape (distance,) [m]."""
    back: Floats
    """Return path length in water to the receiver, shape (distance,) [m]."""
    slope: Floats
    """Derivative of the slant range by the optical path, shape (distance,) [1]."""
    cosine: Floats
    """Cosine of the angle between beam and return path, shape (distance,) [1]."""
    per_acceptance: float
    """Ratio of the acceptance angle in water to the receiver's [1]."""


def place_of(survey: Survey, distance: Floats) -> Place:
    """Return the geometry at increasing slant ranges; SurveyError before the water."""
    crossed = medium_of(survey)
    azimuth, elevation = np.array(survey.scan.azimuth), np.array(survey.scan.elevation)
    instrument = survey.instrument
    receiver_view = view(survey, azimuth, elevation)
    beam = rays.enter_water(
        instrument.emitter.position, rays.direction(azimuth, elevation), medium=crossed
    )
    before = float(beam.length_before)
    depth = distance - before
    if depth[0] <= 0:
        raise SurveyError(
            f"distance: {distance[0]:g} m lies before the water, which begins at "
            f"{before:g} m"
        )
    receiver = np.asarray(instrument.receiver.position)
    path, further = (
        rays.optical_path(distance + step, beam, receiver, medium=crossed)
        for step in (0.0, _STEP)
    )
    point = beam.entry + depth[:, None] * beam.direction
    way = receiver - point
    length = np.linalg.norm(way, axis=1)
    return Place(
        view=receiver_view,
        depth=depth,
        path=path,
        back=rays.return_distance(point, receiver, medium=crossed),
        slope=_STEP / (further - path),
        cosine=-(way @ beam.direction) / length,
        per_acceptance=receiver_view.acceptance / instrument.receiver.acceptance,
    )


def aim_of(survey: Survey) -> float:
    """Distance at which the receiver's axis is nearest to the beam [m]."""
    receiver_view = view(
        survey, np.array(survey.scan.azimuth), np.array(survey.scan.elevation)
    )
    tilt, baseline = float(receiver_view.tilt), float(receiver_view.baseline)
    if baseline <= 0 or tilt <= 1e-9:
        return math.inf
    return baseline / tilt - float(receiver_view.standoff)


def with_receiver(survey: Survey, *, baseline: float, aim: float) -> Survey:
    """Survey with a new baseline; the receiver axis meets the beam at `aim`."""
    instrument = survey.instrument
    start = np.asarray(instrument.emitter.position)
    side = np.asarray(instrument.receiver.position) - start
    length = float(np.linalg.norm(side))
    side = side / length if length > 0 else np.array([1.0, 0.0, 0.0])
    position = start + baseline * side
    azimuth, elevation = survey.scan.azimuth, survey.scan.elevation
    if math.isfinite(aim) and baseline > 0:
        crossed = medium_of(survey)
        beam = rays.enter_water(
            start, rays.direction(azimuth, elevation), medium=crossed
        )
        point = beam.entry + (aim - beam.length_before) * beam.direction
        way = _towards(point, position, crossed)
        azimuth = math.atan2(way[0], way[2])
        elevation = -math.asin(way[1] / float(np.linalg.norm(way)))
    receiver = instrument.receiver.model_copy(
        update={
            "position": tuple(map(float, position)),
            "azimuth": azimuth,
            "elevation": elevation,
        }
    )
    return survey.model_copy(
        update={"instrument": instrument.model_copy(update={"receiver": receiver})}
    )


def _towards(point: Floats, start: Floats, crossed: rays.Medium) -> Floats:
    """Emission direction of a ray to a point in the water."""
    way = point - start
    if crossed.window_distance is None:
        return np.asarray(way)
    aimed = point
    for _ in range(20):
        way = aimed - start
        ray = rays.enter_water(start, way / np.linalg.norm(way), medium=crossed)
        ahead = (point[2] - ray.entry[2]) / ray.direction[2]
        missed = point - (ray.entry + ahead * ray.direction)
        if float(np.linalg.norm(missed)) < 1e-9:
            break
        # A place aside moves the ray by more than itself as it bends: half of it.
        aimed = aimed + 0.5 * missed
    return np.asarray(way)
