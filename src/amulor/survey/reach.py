"""Range limits of a survey's targets, and ambiguity of their phases."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import SurveyError
from amulor.optics import ranging, rays
from amulor.survey.course import planned_instrument
from amulor.survey.directions import readings_in_turn
from amulor.survey.properties import water_properties
from amulor.survey.survey import Survey
from amulor.survey.target import METRES, Disc, Mesh, Plate, Staircase
from amulor.survey.view import medium_of

Floats = NDArray[np.float64]

#: Number of traced beams along each side of the scan.
_BEAMS = 65
#: Number of places of a vehicle along its course.
_PLACES = 33


def target_reach(survey: Survey) -> tuple[float, float] | None:
    """Return the smallest and largest slant range of targets that the beams meet [m].

    Boxes enclose every target: a flat box for a plate, one box for each tread of a
    staircase, a box as deep as the curvature of a disc, a bounding box for a mesh. The
    limits are those of the beams in these boxes. The result may be too wide for a mesh,
    and too narrow only for objects between two of 65 x 65 beams. A vehicle is placed
    along its planned course, without disturbances.
    """
    boxes: list[tuple[Floats, Floats, Floats, Floats]] = []
    for target in survey.targets:
        shapes = _boxes(target)
        if shapes is None:
            return None
        turn = _rotation(target.rotation)
        boxes += [
            (turn, np.asarray(target.position), low, high) for low, high in shapes
        ]
    if not boxes:
        return None
    ranges = [
        beam.length_before[..., None] + _crossing(beam, *box)
        for beam in _placed_beams(survey)
        for box in boxes
    ]
    met = np.concatenate([values.ravel() for values in ranges])
    met = met[np.isfinite(met)]
    return (float(met.min()), float(met.max())) if met.size else None


def unsettled_interval(
    survey: Survey | None, *, modulation_frequency: ArrayLike
) -> str:
    """Return the reason why ranges of targets may be ambiguous; empty if they are not.

    Phases repeat with the ambiguity interval of the smallest frequency, or of the
    smallest difference between two. The right repetition must be known, either from
    stated limits of the slant range or from the targets of the survey.
    """
    if survey is None:
        return "nothing says how far the targets are"
    try:
        reach = target_reach(survey)
        water = water_properties(survey)
    except SurveyError as error:
        return f"nothing says how far the targets are ({error})"
    if reach is None:
        return "the survey does not say how far the targets are"
    period = repetition(modulation_frequency, group_index=water.group_index)
    if reach[1] < period:
        return ""
    return (
        f"the phases repeat after {period:.4g} m, and the targets of the survey are "
        f"{reach[0]:.4g} to {reach[1]:.4g} m away"
    )


def repetition(modulation_frequency: ArrayLike, *, group_index: float) -> float:
    """Return the range interval after which all phases repeat [m]."""
    frequency = np.atleast_1d(np.asarray(modulation_frequency, dtype=float))
    smallest = np.min(np.append(np.diff(frequency), frequency[0]))
    return float(ranging.ambiguity_interval(smallest, group_index=group_index))


def _beams(survey: Survey) -> rays.Beam:
    """Return beams evenly distributed over the scan, including its edges."""
    scan = survey.scan
    across = np.linspace(-0.5, 0.5, min(scan.columns, _BEAMS))
    down = np.linspace(0.5, -0.5, min(scan.rows, _BEAMS))
    azimuth, elevation = np.meshgrid(
        scan.azimuth
        + (across if scan.columns > 1 else np.zeros(1)) * scan.azimuth_span,
        scan.elevation + (down if scan.rows > 1 else np.zeros(1)) * scan.elevation_span,
    )
    return rays.enter_water(
        survey.instrument.emitter.position,
        rays.direction(azimuth, elevation),
        medium=medium_of(survey),
    )


def _placed_beams(survey: Survey) -> Iterator[rays.Beam]:
    """Yield the beams of a scan in the targets' axes, for each place of a vehicle."""
    beam = _beams(survey)
    if survey.platform is None:
        yield beam
        return
    scan = survey.scan
    end = scan.rows * scan.columns * scan.dwell * readings_in_turn(survey)
    poses = planned_instrument(survey, np.linspace(0.0, end, _PLACES))
    for origin, turn in zip(*poses, strict=True):
        yield replace(
            beam, entry=origin + beam.entry @ turn.T, direction=beam.direction @ turn.T
        )


def _crossing(
    beam: rays.Beam, turn: Floats, position: Floats, low: Floats, high: Floats
) -> Floats:
    """Return the distances at which beams enter and leave a box, NaN for a miss [m]."""
    start = (beam.entry - position) @ turn
    direction = beam.direction @ turn
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - start) / direction, (high - start) / direction
    # A beam parallel to a pair of faces is between them everywhere or nowhere.
    inside = (start >= low) & (start <= high)
    along = direction == 0
    near = np.where(along, np.where(inside, -np.inf, np.inf), np.fmin(first, second))
    far = np.where(along, np.where(inside, np.inf, -np.inf), np.fmax(first, second))
    enter, leave = near.max(axis=-1), far.min(axis=-1)
    hit = (leave >= enter) & (leave >= 0)
    ends = np.stack([np.maximum(enter, 0.0), leave], axis=-1)
    return np.where(hit[..., None], ends, np.nan)


def _rotation(angles: tuple[float, float, float]) -> Floats:
    """Return the rotation matrix about the axes right, down, forward, in this order."""
    rotation = np.eye(3)
    for axis, angle in enumerate(angles):
        c, s = math.cos(angle), math.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[i, i] = step[j, j] = c
        step[i, j], step[j, i] = -s, s
        rotation = step @ rotation
    return rotation


def _boxes(
    target: Plate | Staircase | Disc | Mesh,
) -> list[tuple[Floats, Floats]] | None:
    """Return the corners of boxes around a target, in its axes [m]; None if unknown."""
    if isinstance(target, Plate):
        half = np.array([target.width / 2, target.height / 2, 0.0])
        return [(-half, half)]
    if isinstance(target, Staircase):
        return _treads(target)
    if isinstance(target, Disc):
        radius = target.diameter / 2
        bend = target.curvature_radius
        depth = 0.0 if bend is None else bend - math.sqrt(bend**2 - radius**2)
        return [(np.array([-radius, -radius, 0.0]), np.array([radius, radius, depth]))]
    return _mesh(target)


def _treads(target: Staircase) -> list[tuple[Floats, Floats]]:
    levels = -np.concatenate([[0.0], np.cumsum(target.step_heights)])
    left_edges = (np.arange(len(levels)) - len(levels) / 2) * target.tread_width
    half = target.height / 2
    return [
        (
            np.array([edge, -half, level]),
            np.array([edge + target.tread_width, half, level]),
        )
        for edge, level in zip(left_edges, levels, strict=True)
    ]


def _mesh(target: Mesh) -> list[tuple[Floats, Floats]] | None:
    try:
        import trimesh

        loaded: Any = trimesh.load(target.file, force="mesh")
        corners = np.asarray(loaded.vertices)
    # Without the extra, or with the file elsewhere, the shape is unknown here; readers
    # of four formats raise many kinds of errors.
    except Exception:
        return None
    if corners.shape[1:] != (3,) or not (len(corners) and np.isfinite(corners).all()):
        return None
    metres = METRES[target.unit]
    return [(corners.min(axis=0) * metres, corners.max(axis=0) * metres)]
