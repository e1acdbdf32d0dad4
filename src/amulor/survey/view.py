"""Geometry of the receiver relative to the beams, as input of the signal models."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import rays, reflection
from amulor.survey.properties import WaterProperties, indices
from amulor.survey.survey import Survey

Floats = NDArray[np.float64]
#: Largest angle between axis and beam for which small-angle models are valid [1].
_SMALLEST_COSINE = 0.5


@dataclass(frozen=True, kw_only=True)
class View:
    """Geometry of the receiver relative to each beam, arrays over the beams."""

    baseline: Floats
    """Distance between receiver and beam at depth zero [m]."""
    tilt: Floats
    """Inclination of the beam relative to the receiver's axis, along the baseline:
    decrease of their distance per length of the beam [rad]."""
    cross_tilt: Floats
    """Inclination of the beam relative to the receiver's axis, across the baseline
    [rad]."""
    standoff: Floats
    """Air and glass before the water, as an optically equivalent depth of water [m]."""
    optical_offset: Floats
    """Round-trip optical path at depth zero [m]."""
    acceptance: float
    """1/e half-width of the field of view, in the water [rad]."""
    transmission: Floats
    """Transmission of the window's faces for both passes; 1 without reflection losses
    [1]."""


def medium_of(survey: Survey) -> rays.Medium:
    """Return the media that the light of a survey passes: air, window, water."""
    window = survey.instrument.window
    phase_index, group_index = indices(survey)
    if window is None:
        return rays.Medium(refractive_index=phase_index, group_index=group_index)
    return rays.Medium(
        refractive_index=phase_index,
        group_index=group_index,
        window_distance=window.distance,
        window_thickness=window.thickness,
        window_refractive_index=window.refractive_index,
        window_group_index=window.group_index,
    )


def seen_from_water(survey: Survey, medium: rays.Medium) -> tuple[float, float]:
    """Return the receiver's standoff as water depth [m], acceptance in water [rad]."""
    receiver = survey.instrument.receiver
    if medium.window_distance is None:
        return 0.0, receiver.acceptance
    reduced = (
        medium.window_distance
        - receiver.position[2]
        + medium.window_thickness / medium.window_refractive_index
    )
    index = medium.refractive_index
    return index * reduced, receiver.acceptance / index


def angle_of_view(survey: Survey) -> float:
    """Return the field of view about the beam; infinite if only the beam moves [rad].

    A receiver that does not move sees all surfaces of the scan.
    """
    if survey.scan.moves != "both":
        return math.inf
    return float(view(survey, np.zeros(1), np.zeros(1)).acceptance)


def view(survey: Survey, azimuth: Floats, elevation: Floats) -> View:
    """Return the geometry of the receiver relative to beams of given directions.

    The signal models are small-angle models. They compute the delay of the water signal
    as twice the depth, although the way back to a receiver beside the beam is longer.
    The phase error at 39 MHz is 0.3 degrees for a baseline of 7 cm, 1.2 degrees for
    20 cm. The amplitude of the water signal from 2 m is 1 % too large for a baseline of
    20 cm. The echo of a target is computed with its actual way back.
    """
    medium = medium_of(survey)
    standoff, acceptance = seen_from_water(survey, medium)
    axis = _axis(survey, azimuth, elevation)
    beam = rays.enter_water(
        survey.instrument.emitter.position,
        rays.direction(azimuth, elevation),
        medium=medium,
    )
    sight = line_of_sight(survey, azimuth, elevation)
    along = np.sum(beam.direction * sight.direction, axis=-1)
    if np.min(along) < _SMALLEST_COSINE:
        angle = np.degrees(np.arccos(np.clip(np.min(along), -1, 1)))
        raise SurveyError(
            f"instrument.receiver: its axis stands {angle:.0f} degrees off a beam of "
            "the scan, but the signal models hold for small angles only; aim the "
            "receiver at the scan (azimuth, elevation)"
        )
    # Displacement across the axis per length along the beam: the sine of their angle.
    inclination = beam.direction - along[..., None] * sight.direction
    # Start of the water, across the receiver's axis.
    offset = sight.entry - beam.entry
    before = (
        beam.optical_length_before
        + sight.optical_length_before
        - medium.group_index * np.sum(offset * sight.direction, axis=-1)
    )
    offset = offset - np.sum(offset * sight.direction, axis=-1)[..., None] * (
        sight.direction
    )
    # The offset applies at the water's edge; the model counts it from the start.
    offset = offset + inclination * standoff
    baseline = np.linalg.norm(offset, axis=-1)
    safe = np.where(baseline > 0, baseline, 1.0)[..., None]
    tilt = np.sum(inclination * offset / safe, axis=-1)
    total = np.sum(inclination**2, axis=-1)
    cross = np.sqrt(np.maximum(total - tilt**2, 0.0))
    depths = np.full(azimuth.shape, standoff)
    return View(
        baseline=baseline,
        tilt=tilt,
        cross_tilt=cross,
        standoff=depths,
        optical_offset=before,
        acceptance=acceptance,
        transmission=_transmission(
            survey, medium, rays.direction(azimuth, elevation), axis
        ),
    )


def line_of_sight(survey: Survey, azimuth: Floats, elevation: Floats) -> rays.Beam:
    """Return the receiver's axis in the water, for beams of given directions."""
    return rays.enter_water(
        survey.instrument.receiver.position,
        _axis(survey, azimuth, elevation),
        medium=medium_of(survey),
    )


def _axis(survey: Survey, azimuth: Floats, elevation: Floats) -> Floats:
    """Return the direction of the receiver's axis before the water [1]."""
    receiver, scan = survey.instrument.receiver, survey.scan
    if scan.moves == "both":
        return rays.direction(
            receiver.azimuth + azimuth - scan.azimuth,
            receiver.elevation + elevation - scan.elevation,
        )
    return rays.direction(
        receiver.azimuth + 0 * azimuth, receiver.elevation + 0 * elevation
    )


def _transmission(
    survey: Survey, medium: rays.Medium, launched: Floats, axis: Floats
) -> Floats:
    """Return the window's two-way transmission, for launched and received light [1].

    Light reflected twice within the pane, less than a thousandth, is neglected.
    """
    transmission = np.ones(launched.shape[:-1])
    window = survey.instrument.window
    if window is None or not window.reflection_loss:
        return transmission
    for direction in (launched, axis):
        ahead = np.clip(direction[..., 2], 0.0, 1.0)
        inside = np.sqrt(1 - (1 - ahead**2) / window.refractive_index**2)
        transmission = transmission * reflection.fresnel_transmission(
            ahead,
            refractive_index=1.0,
            refractive_index_behind=window.refractive_index,
        )
        transmission = transmission * reflection.fresnel_transmission(
            inside,
            refractive_index=window.refractive_index,
            refractive_index_behind=medium.refractive_index,
        )
    return transmission


def kernel_arguments(
    survey: Survey, water: WaterProperties, view: View
) -> dict[str, Any]:
    """Return keyword arguments for the functions of target and water signal."""
    return {
        "absorption": water.absorption,
        "forward_scattering": water.forward_scattering,
        "diffuse_scattering": water.diffuse_scattering,
        "second_moment": water.second_moment,
        "baseline": view.baseline,
        "receiver_radius": survey.instrument.receiver.radius,
        "acceptance_angle": view.acceptance,
        "tilt": view.tilt,
        "cross_tilt": view.cross_tilt,
        "standoff": view.standoff,
    }


def beam_arguments(survey: Survey, water: WaterProperties) -> dict[str, float]:
    """Return radius and divergence of the beam as keyword arguments, if stated."""
    emitter = survey.instrument.emitter
    arguments = {}
    if emitter.beam_radius:
        arguments["beam_radius"] = emitter.beam_radius
    if emitter.beam_divergence:
        bent = 1.0 if survey.instrument.window is None else water.refractive_index
        arguments["beam_divergence"] = emitter.beam_divergence / bent
    return arguments


def widths_together(
    survey: Survey, water: WaterProperties, acceptance: float
) -> tuple[float, float]:
    """Return the combined radius [m] and semi-angle [rad] of receiver and beam."""
    beam = beam_arguments(survey, water)
    return (
        float(np.hypot(survey.instrument.receiver.radius, beam.get("beam_radius", 0))),
        float(np.hypot(acceptance, beam.get("beam_divergence", 0))),
    )


def has_sharp_receiver(survey: Survey) -> bool:
    """Return whether aperture and field of view of the receiver have sharp edges."""
    return survey.instrument.receiver.edge == "sharp"


def refuse_layers(water: WaterProperties, *, model: str) -> None:
    """Raise if the water has layers and the model assumes uniform water."""
    if water.layers:
        raise SurveyError(
            f"water.layers: {model} knows uniform water only; `amulor backscatter "
            "--model photons` follows layers; elsewhere state one water"
        )


def refuse_beam_and_edges(survey: Survey, *, model: str) -> None:
    """Raise if a model cannot treat the beam width or sharp receiver edges."""
    emitter = survey.instrument.emitter
    unsupported = [
        name
        for name, present in (
            ("emitter.beam_radius", emitter.beam_radius),
            ("emitter.beam_divergence", emitter.beam_divergence),
            ('receiver.edge = "sharp"', has_sharp_receiver(survey)),
        )
        if present
    ]
    if unsupported:
        raise SurveyError(
            f"instrument: {model} knows thin beams and Gaussian receivers only, found "
            f"{', '.join(unsupported)}; use the small-angle model, or leave them out"
        )


def geometry_attributes(survey: Survey) -> dict[str, Any]:
    """Return refractive indices, window and positions as cube attributes."""
    medium = medium_of(survey)
    attributes: dict[str, Any] = {
        "group_index": medium.group_index,
        "refractive_index": medium.refractive_index,
        "emitter_position": np.array(survey.instrument.emitter.position),
        "receiver_position": np.array(survey.instrument.receiver.position),
    }
    if medium.window_distance is not None:
        attributes |= {
            "window_distance": medium.window_distance,
            "window_thickness": medium.window_thickness,
            "window_refractive_index": medium.window_refractive_index,
            "window_group_index": medium.window_group_index,
        }
    return attributes
