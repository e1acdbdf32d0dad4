"""Instrument, water and targets of a survey, and the geometry of its beams."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import rays
from amulor.simulation.scene import Hits, Scene, aperture_points
from amulor.simulation.second_reflection import second_reflection
from amulor.simulation.texture_blur import texture_change
from amulor.simulation.vehicle import Placed, Standing, VehicleMotion
from amulor.survey import Survey, WaterProperties, counting, surface, water_properties
from amulor.survey.directions import Floats, scan_directions
from amulor.survey.view import View, line_of_sight, medium_of, view


@dataclass(frozen=True)
class Setup:
    """Instrument, water and targets of a survey, with derived quantities cached."""

    survey: Survey
    """Simulated survey."""
    motion: VehicleMotion | None = None
    """Motion of the vehicle that carries the instrument; None if it stands still."""

    @cached_property
    def water(self) -> WaterProperties:
        """Optical properties of the water."""
        return water_properties(self.survey)

    @cached_property
    def medium(self) -> rays.Medium:
        """Refractive indices of water and window."""
        return medium_of(self.survey)

    @cached_property
    def scene(self) -> Scene:
        """Targets as triangles."""
        return Scene(self.survey.targets)

    @cached_property
    def full_rate(self) -> float:
        """Photoelectron rate if all launched light returned to the receiver [1/s]."""
        return counting.full_rate(self.survey)

    @cached_property
    def daylight_rate(self) -> Floats:
        """Photoelectron rate of daylight behind each analyzer [1/s]."""
        return counting.background_rate(self.survey)

    @cached_property
    def volt_per_power(self) -> float:
        """Peak lock-in amplitude if all launched light returned to the receiver [V]."""
        instrument = self.survey.instrument
        return (
            instrument.modulation_depth
            * instrument.detector.volt_per_photoelectron_rate
            * self.full_rate
        )


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Geometry of a scan and its targets, arrays over (row, column)."""

    azimuth: Floats
    """Azimuth of the beam, positive to the right [rad]."""
    elevation: Floats
    """Elevation of the beam, positive upwards [rad]."""
    time: Floats
    """Time from the start of the scan to the start of a pixel [s]."""
    view: View
    """View of the receiver for each beam."""
    point: Floats
    """Point on the target in the targets' axes, NaN without a target, last axis (3,)
    [m]."""
    target: NDArray[np.intp]
    """Number of the target that the beam hits, -1 for none."""
    slant_range: Floats
    """Distance from the emitter along the beam, infinite without a target [m]."""
    depth: Floats
    """Beam length in the water, infinite without a target [m]."""
    optical_path: Floats
    """Round-trip optical path, 0 without a target [m]."""
    return_path: Floats
    """Path length in water from the target to the receiver, infinite without a target
    [m]."""
    cosine: Floats
    """Cosine of the angle between surface normal and receiver, times the visible share
    of the aperture [1]."""
    brightness: Floats
    """Radiance of the lit point towards the receiver, relative to a Lambertian surface
    with the target's reflectance, from BRDF and texture [1]."""
    surroundings: NDArray[np.complex128] | None
    """Change of `brightness` by scattered light from the surroundings of a texture,
    shape (frequency, row, column) with 0 Hz first; None without a texture [1]."""
    twice: NDArray[np.complex128] | None
    """Light reflected by two surfaces, over that of a white surface that faces the
    receiver, shape (frequency, row, column) with 0 Hz first; None if left out [1]."""


def trace(
    setup: Setup,
    *,
    directions: tuple[Floats, Floats, Floats] | None = None,
    lag: float = 0.0,
) -> Geometry:
    """Trace every beam of a scan to the first target that it hits, if any.

    A moving instrument is where it was a time `lag` after the start of the pixel [s].
    Another surface between the target and the receiver hides the echo in part: seven
    points stand for the receiver's aperture. With a window, that way is taken as
    straight, which is wrong by less than a pixel where the way back is steep.
    """
    survey, medium, scene = setup.survey, setup.medium, setup.scene
    instrument = survey.instrument
    azimuth, elevation, time = directions or scan_directions(survey)
    beam = rays.enter_water(
        instrument.emitter.position,
        rays.direction(azimuth, elevation),
        medium=medium,
    )
    place = Standing()
    if setup.motion is not None:
        place = Placed(*setup.motion.in_scene(time.ravel() + lag))
    met_in_scene = scene.cast(
        place.points(beam.entry.reshape(-1, 3)),
        place.directions(beam.direction.reshape(-1, 3)),
    )
    _refuse_targets_behind_the_water(survey, met_in_scene)
    receiver = np.asarray(instrument.receiver.position)
    points, weights = aperture_points(receiver, radius=instrument.receiver.radius)
    apertures = [place.points(point) for point in points]
    fraction = scene.visible_fraction(met_in_scene, apertures, weights)
    hits = place.in_instrument(met_in_scene)
    met = hits.target >= 0
    to_receiver = receiver - hits.point[met]
    cosine = np.zeros(met.size)
    cosine[met] = np.maximum(
        np.sum(to_receiver * hits.normal[met], axis=1)
        / np.linalg.norm(to_receiver, axis=1),
        0.0,
    )
    path = np.zeros(met.size)
    path[met] = (
        beam.optical_length_before.ravel()[met]
        + medium.group_index * hits.distance[met]
        + rays.return_length(hits.point[met], receiver, medium=medium)
    )
    return_path = np.full(met.size, np.inf)
    return_path[met] = rays.return_distance(hits.point[met], receiver, medium=medium)
    shape, seen = azimuth.shape, view(survey, azimuth, elevation)
    texture = scene.texture(met_in_scene)
    change = texture_change(
        survey,
        setup.water,
        scene,
        hits,
        texture,
        beam=beam,
        sight=line_of_sight(survey, azimuth, elevation),
        view=seen,
        place=place,
    )
    bright = _brightness(survey, texture, hits, beam, receiver)
    surroundings = None
    if change is not None:
        # Any BRDF is linear in the texture.
        matte = _brightness(survey, texture + 1, hits, beam, receiver) - bright
        surroundings = (matte * change).reshape(-1, *shape)
    twice = None
    if survey.scan.second_reflection:
        twice = second_reflection(
            survey,
            scene,
            met_in_scene,
            place.points(receiver),
            water=setup.water,
            group_index=medium.group_index,
        ).reshape(-1, *shape)
    return Geometry(
        azimuth=azimuth,
        elevation=elevation,
        time=time,
        view=seen,
        point=met_in_scene.point.reshape(*shape, 3),
        target=hits.target.reshape(shape),
        slant_range=hits.distance.reshape(shape) + beam.length_before,
        depth=hits.distance.reshape(shape),
        optical_path=path.reshape(shape),
        return_path=return_path.reshape(shape),
        cosine=(cosine * fraction).reshape(shape),
        brightness=bright.reshape(shape),
        surroundings=surroundings,
        twice=twice,
    )


def _brightness(
    survey: Survey, texture: Floats, hits: Hits, beam: rays.Beam, receiver: Floats
) -> Floats:
    """Return the radiance to the receiver over that of a Lambertian target [1]."""
    bright = texture.copy()
    ray = -beam.direction.reshape(-1, 3)
    for number, target in enumerate(survey.targets):
        indices = np.flatnonzero(hits.target == number)
        if target.surface is None or not indices.size:
            continue
        normal, point = hits.normal[indices], hits.point[indices]
        to_receiver = receiver - point
        to_receiver = to_receiver / np.linalg.norm(to_receiver, axis=1, keepdims=True)
        slopes = [np.sum(side * normal, axis=1) for side in (ray[indices], to_receiver)]
        flat = [
            side - slope[:, None] * normal
            for side, slope in zip((ray[indices], to_receiver), slopes, strict=True)
        ]
        length = np.linalg.norm(flat[0], axis=1) * np.linalg.norm(flat[1], axis=1)
        # At right angles to the surface there is no azimuth; any will do.
        turn = np.sum(flat[0] * flat[1], axis=1) / np.where(length > 0, length, 1.0)
        angles = [np.arccos(np.clip(slope, 0.0, 1.0)) for slope in slopes]
        # A receiver behind the surface receives no light, for any BRDF.
        bright[indices] = surface.brightness(
            target.surface,
            reflectance=target.reflectance,
            texture=texture[indices],
            incidence=angles[0],
            leaving=angles[1],
            azimuth=np.arccos(np.clip(np.where(length > 0, turn, 1.0), -1.0, 1.0)),
        )
    return bright


def _refuse_targets_behind_the_water(survey: Survey, hits: Hits) -> None:
    end = survey.water.column_end
    if end is None:
        return
    behind = np.isfinite(hits.distance) & (hits.distance > end)
    if behind.any():
        number = int(hits.target[behind][0])
        raise SurveyError(
            f"targets.{number}: a beam meets it after {hits.distance[behind][0]:.4g} m "
            f"of water, but water.column_end is {end:g} m; move the target, or the end"
        )
