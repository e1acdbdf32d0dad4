"""How the receiver looks at a scan: overlap of its view with the light."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.errors import CubeError, SurveyError
from amulor.optics import rays, small_angle_diffusion
from amulor.optics.late_echo import late_echo
from amulor.rejection.joint.overlap.directions import directions_of
from amulor.rejection.joint.overlap.scattered import Scattered
from amulor.rejection.joint.overlap.shape import Shape, hats
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.view import (
    beam_arguments,
    kernel_arguments,
    medium,
    seen_from_water,
    view,
)
from amulor.survey.waters.whole_function import whole_phase_function

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Depths behind which less than this fraction of the water signal is left [1].
_NOTHING_LEFT = 1e-7
#: Standard uncertainty of the logarithm of the scattering that a survey states [1].
_STATED = 0.7
#: Directions of the receiver whose arguments are kept.
_KEPT = 8


class Frame:
    """How the receiver looks at a scan: what tables of the water signal need.

    Parameters
    ----------
    survey : Survey
        Receiver and scan count, and the end of the water; the optical properties of
        the water do not, but for its indices.
    azimuth, elevation : ndarray
        Directions that will be asked for, of any shape [rad].
    modulation_frequency : ndarray
        Modulation frequencies [Hz].
    """

    def __init__(
        self,
        survey: Survey,
        azimuth: Floats,
        elevation: Floats,
        *,
        modulation_frequency: Floats,
    ) -> None:
        properties = water_properties(survey)
        self.survey = survey
        self.medium = medium(survey, properties)
        #: Phase per optical path, 2 pi f / c_0 [rad/m].
        self.phase_per_path = 2 * np.pi * modulation_frequency / speed_of_light
        end = survey.water.column_end
        self.end = np.inf if end is None else end
        self._properties = properties
        self._scattered = _scattered_light(survey, properties, self.medium)
        self._turned: dict[tuple[float, ...], dict[str, Any]] = {}
        shape = Shape(0.3, 0.02, 0.4, np.zeros(0), np.zeros(0))
        depth = np.linspace(0.02, 12.0, 240)
        #: Directions between which everything is interpolated.
        self.directions = directions_of(
            azimuth,
            elevation,
            lambda az, el: self._overlap(depth, shape, self._arguments(az, el)),
        )
        self._nodes = self._arguments(*self.directions.mesh)

    def _nodes_of(self, shape: Shape) -> dict[str, Any]:
        """Return the arguments at the nodes for a receiver turned as a shape says."""
        if not np.any(shape.turn):
            return self._nodes
        turn = tuple(float(value) for value in shape.turn)
        if turn not in self._turned:
            if len(self._turned) >= _KEPT:
                self._turned.clear()
            instrument = self.survey.instrument
            receiver = instrument.receiver.model_copy(
                update={
                    "azimuth": instrument.receiver.azimuth + turn[0],
                    "elevation": instrument.receiver.elevation + turn[1],
                }
            )
            turned = self.survey.model_copy(
                update={
                    "instrument": instrument.model_copy(update={"receiver": receiver})
                }
            )
            self._turned[turn] = self._arguments(*self.directions.mesh, turned)
        return self._turned[turn]

    def _arguments(
        self, azimuth: Floats, elevation: Floats, survey: Survey | None = None
    ) -> dict[str, Any]:
        """Return the arguments of the overlap, without those of the water."""
        survey = self.survey if survey is None else survey
        where = view(survey, azimuth, elevation, medium=self.medium)
        arguments = kernel_arguments(survey, self._properties, where)
        for name in (
            "absorption",
            "forward_scattering",
            "diffuse_scattering",
            "second_moment",
        ):
            del arguments[name]
        radius, angle = _widths(survey, self._properties, where.acceptance)
        return arguments | {"receiver_radius": radius, "acceptance_angle": angle}

    def optical_offset(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return the optical path before the water, out and back [m]."""
        where = view(self.survey, azimuth, elevation, medium=self.medium)
        return np.broadcast_to(where.optical_offset, azimuth.shape)

    def beam(self, azimuth: Floats, elevation: Floats) -> rays.Beam:
        """Return the beams of given directions."""
        return rays.enter_water(
            self.survey.instrument.emitter.position,
            rays.direction(azimuth, elevation),
            medium=self.medium,
        )

    @property
    def receiver(self) -> Floats:
        """Where the light is collected [m]."""
        return np.asarray(self.survey.instrument.receiver.position, dtype=float)

    def overlap(self, depth: Floats, shape: Shape) -> Floats:
        """Return the overlap at the nodes, (node, depth), without the correction."""
        return self._overlap(depth, shape, self._nodes_of(shape))

    def _overlap(self, depth: Floats, shape: Shape, where: dict[str, Any]) -> Floats:
        """Return the overlap of (direction, depth), without the correction.

        (29) of Ricci et al. 2010, as rebuilt, with the phase function of the survey's
        water, stretched to the spread of the shape. Where it has none, (43) for the
        light that was scattered and again, without spread, for the light that was not;
        together they have the spread of the model. Scattering without bounds leaves
        (43) itself.
        """
        straight = np.exp(-2 * shape.forward_scattering * depth)
        # The smallest number keeps the start of the water in range.
        bent = np.maximum(1 - straight, np.finfo(float).tiny)
        geometry = {name: np.asarray(v)[..., None] for name, v in where.items()}
        common = {"absorption": shape.reduced_attenuation, "diffuse_scattering": 0.0}

        def overlap(spread: Floats | float) -> Floats:
            return small_angle_diffusion.overlap(
                depth[None, :],
                forward_scattering=spread,
                second_moment=1.0,
                **common,
                **geometry,
            )

        light: Floats
        if self._scattered is not None:
            scattered = self._scattered.light(
                depth,
                forward_scattering=shape.forward_scattering,
                spread=shape.spread,
                offset=self._offset(where),
            )
            lost = np.exp(-2 * shape.reduced_attenuation * depth)
            light = straight * overlap(0.0) + lost * scattered
            return light
        spread = np.where(depth > 0, shape.spread / bent, 0.0)
        light = straight * overlap(0.0) + bent * overlap(spread)
        return light

    def _offset(self, where: dict[str, Any]) -> Floats:
        """Return how far aside the beams are, at the depths of scattered light [m]."""
        assert self._scattered is not None
        path = self._scattered.depth + np.asarray(where["standoff"])[:, None]
        along = where["baseline"][:, None] - where["tilt"][:, None] * path
        offset: Floats = np.hypot(along, where["cross_tilt"][:, None] * path)
        return offset

    def late_spread(self, depth: float, spread: float, error: float) -> float:
        """Return the spread whose mean detour is twice what an echo is late [rad^2/m].

        In the middle of the scan, by `optics.late_echo`, for water of the survey's
        phase function with a given spread, of some relative error: the mean of it and
        of the survey's, which counts as known to a factor of two. Where the survey has
        no phase function, the given spread.
        """
        light = self._scattered
        if light is None or not depth > 0:
            return spread
        azimuth, elevation = self.directions.middle
        where = self._arguments(np.array([azimuth]), np.array([elevation]))
        stated = self._properties.scattering
        found = spread / (light.moment * light.fraction)
        trust = _STATED**2 / (_STATED**2 + error**2)
        late = late_echo(
            0.0,
            depth=depth,
            scattering=found**trust * stated ** (1 - trust),
            phase_function=light.function,
            split_angle=light.split_angle,
            group_index=self.medium.group_index,
            **where,
        )
        seen = 8 * float(late[0]) / depth**2
        return seen if np.isfinite(seen) else spread

    def nothing_left(self, shape: Shape) -> float:
        """Return the depth that all but a trace of the water signal comes from [m]."""
        depth = np.geomspace(1e-2, 2e3, 1500)
        light = self.overlap(depth, shape).max(axis=0)
        left = np.cumsum((light * depth)[::-1])[::-1]
        if left[0] < SMALLEST_STRENGTH:
            raise unseen()
        return float(depth[np.argmax(left <= _NOTHING_LEFT * left[0])])

    def quantiles(self, shape: Shape, fraction: Floats) -> Floats:
        """Return the depths in front of which given fractions of the light arise."""
        depth = np.linspace(0, min(self.nothing_left(shape), self.end), 4000)
        light = self.overlap(depth, shape).mean(axis=0)
        total = np.cumsum(light)
        return np.asarray(np.interp(fraction, total / total[-1], depth))

    def middle(self, depth: Floats, shape: Shape) -> Floats:
        """Return the overlap in the middle of the scan, with the correction [sr]."""
        factor = np.exp(shape.correction @ hats(depth, shape.knots))
        overlap: Floats = self.directions.centre @ self.overlap(depth, shape) * factor
        return overlap


def _widths(
    survey: Survey, properties: WaterProperties, acceptance: float
) -> tuple[float, float]:
    """Return radius [m] and semi-angle [rad] of receiver and beam together."""
    beam = beam_arguments(survey, properties)
    return (
        float(np.hypot(survey.instrument.receiver.radius, beam.get("beam_radius", 0))),
        float(np.hypot(acceptance, beam.get("beam_divergence", 0))),
    )


def _scattered_light(
    survey: Survey, properties: WaterProperties, medium: rays.Medium
) -> Scattered | None:
    """Return the small-angle form for the survey's water, None where it has none."""
    if (
        properties.layers
        or properties.forward_scattering * properties.second_moment == 0
    ):
        return None
    # What is sent straight back does not count: the strength of the water is free.
    forward = replace(properties, backscatter_vsf=0.0)
    try:
        function = whole_phase_function(forward)
    except SurveyError:
        return None
    standoff, acceptance = seen_from_water(survey, medium)
    radius, angle = _widths(survey, properties, acceptance)
    return Scattered(
        function,
        properties.split_angle,
        radius=radius,
        angle=angle,
        standoff=standoff,
    )


#: A receiver that takes in less than this sees no beam [sr m].
SMALLEST_STRENGTH = 1e-100


def unseen() -> CubeError:
    """Return the error that says that no light comes back from any depth."""
    return CubeError(
        "the receiver does not see the beam at any depth, so there is no water "
        "signal to estimate; check position and axis of the receiver in the survey of "
        "the cube, or reject nothing (keep_water)"
    )


def frame_of(cube: xr.Dataset, azimuth: Floats, elevation: Floats) -> Frame:
    """Return the frame of a cube whose survey describes the receiver.

    Parameters
    ----------
    cube : xarray.Dataset
        With the attribute `survey`.
    azimuth, elevation : ndarray
        Directions that will be asked for [rad].

    Returns
    -------
    Frame
        What tables of the water signal need.

    Raises
    ------
    CubeError
        If the cube has no survey.
    """
    text = cube.attrs.get("survey")
    if not text:
        raise CubeError(
            "the cube has no attribute 'survey', from which the geometry of the "
            "receiver is taken; add the text of a survey file that describes the "
            "instrument, or use the open-water method"
        )
    survey = Survey.from_text(text, name="survey in the cube")
    return Frame(
        survey,
        azimuth,
        elevation,
        modulation_frequency=cube["modulation_frequency"].values,
    )
