"""Overlap of receiver view and laser light: geometry, shape, scattered light."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev, legendre
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.special import j0

from amulor.errors import CubeError, SurveyError
from amulor.optics import rays, small_angle_diffusion
from amulor.optics._geometry import Geometry
from amulor.optics.late_echo import late_echo
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.observation import Observation
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.view import (
    kernel_arguments,
    medium_of,
    seen_from_water,
    view,
    widths_together,
)
from amulor.survey.waters.whole_function import whole_phase_function

Floats = NDArray[np.float64]

#: Largest error of the interpolation over the scan, over the largest overlap [1].
_MISSED = 1e-4
#: Steps of the degree over one angle, and the largest number of nodes.
_FIRST, _ANGLE_STEP, MOST = 2, 2, 400
#: Test places of the interpolation between the ends of an angle, from -1 to 1 [1].
_TRIED = np.array([-0.83, -0.31, 0.12, 0.57, 0.94])
#: Angles that differ by less are equal [rad].
_ONE = 1e-9


@dataclass(frozen=True)
class Directions:
    """Chebyshev nodes over azimuth and elevation."""

    azimuth: Floats
    """Nodes of azimuth [rad]."""
    elevation: Floats
    """Nodes of elevation [rad]."""
    middle: tuple[float, float]
    """Direction of the scan's middle [rad]."""

    @property
    def mesh(self) -> tuple[Floats, Floats]:
        """Azimuth and elevation of all nodes, as flat arrays [rad]."""
        nodes = np.meshgrid(self.azimuth, self.elevation, indexing="ij")
        return nodes[0].ravel(), nodes[1].ravel()

    def interpolation(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return the interpolation weights of the nodes, (direction, node) [1]."""
        parts = [
            _lagrange(node, place)
            for node, place in ((self.azimuth, azimuth), (self.elevation, elevation))
        ]
        product: Floats = np.einsum("ni,nj->nij", *parts).reshape(len(azimuth), -1)
        return product

    @property
    def centre(self) -> Floats:
        """Interpolation weights of the nodes at the middle of the scan, (node,) [1]."""
        place = (np.array([angle]) for angle in self.middle)
        nodes: Floats = self.interpolation(*place)[0]
        return nodes


def directions_of(
    azimuth: Floats, elevation: Floats, overlap: Callable[[Floats, Floats], Floats]
) -> Directions:
    """Return the fewest nodes that interpolate the overlap accurately over a scan."""
    box = [
        (float(np.min(values)), float(np.max(values)))
        for values in (azimuth, elevation)
    ]
    middle = (0.5 * sum(box[0]), 0.5 * sum(box[1]))
    at = np.stack(np.meshgrid(_TRIED, _TRIED), axis=-1).reshape(-1, 2)
    test = [
        middle[axis] + 0.5 * (high - low) * at[:, axis]
        for axis, (low, high) in enumerate(box)
    ]
    exact = overlap(*test)

    def interpolation_error(degrees: tuple[int, int]) -> tuple[float, Directions]:
        axes = [
            _chebyshev(*ends, degree) for ends, degree in zip(box, degrees, strict=True)
        ]
        directions = Directions(axes[0], axes[1], middle)
        interpolated = directions.interpolation(*test) @ overlap(*directions.mesh)
        error = interpolated - exact
        largest, level = float(np.max(np.abs(error))), float(np.max(exact))
        if largest == 0:
            return 0.0, directions
        return (largest / level if level > 0 else np.inf), directions

    degrees = (_FIRST, _FIRST)
    error, directions = interpolation_error(degrees)
    while error > _MISSED:
        candidates = [
            (degrees[0] + _ANGLE_STEP, degrees[1]),
            (degrees[0], degrees[1] + _ANGLE_STEP),
        ]
        results = [(*interpolation_error(pair), pair) for pair in candidates]
        error, directions, degrees = min(results, key=lambda result: result[0])
        if directions.azimuth.size * directions.elevation.size > MOST:
            raise CubeError(
                "the water signal changes too quickly over the scan to be tabulated "
                f"({error:.1g} of it is missed between {MOST} directions); split the "
                "scan into smaller ones"
            )
    return directions


def _chebyshev(low: float, high: float, degree: int) -> Floats:
    """Return the Chebyshev nodes between two angles, or one node for equal angles."""
    count = degree + 1 if high - low > _ONE else 1
    node = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    nodes: Floats = 0.5 * (low + high) + 0.5 * (high - low) * node
    return nodes


def _lagrange(node: Floats, place: Floats) -> Floats:
    """Return the Lagrange polynomials at some angles, (angle, node) [1]."""
    part = np.ones((len(place), len(node)))
    for j in range(len(node)):
        for k in range(len(node)):
            if k != j:
                part[:, j] *= (place - node[k]) / (node[j] - node[k])
    return part


#: Correlation length of departures of the overlap, in knots [1].
_CORRELATION = 2.0


@dataclass(frozen=True)
class Shape:
    """Parameters of the shape of the water signal, shared by all pixels of a scan."""

    reduced_attenuation: float
    """Reduced attenuation coefficient k' = a + b_d [1/m]."""
    spread: float
    """Growth b_f <theta^2> of the light's mean square angle, which scales the survey's
    phase function [rad^2/m]."""
    forward_scattering: float
    """Forward scattering coefficient b_f [1/m]."""
    correction: Floats
    """Departure of the overlap from the model, in prior standard deviations [1]."""
    knots: Floats
    """Knots in depth of the piecewise linear log departure [m]."""
    turn: Floats = field(default_factory=lambda: np.zeros(0))
    """Deviation of the receiver axis from the survey, in azimuth and elevation; empty
    if the survey's axis counts as exact [rad]."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return COEFFICIENTS + len(self.turn) + len(self.knots)

    def moved(self, step: Floats) -> Shape:
        """Return the shape after a step of its parameters."""
        loss, spread, forward = np.exp(step[:COEFFICIENTS])
        smooth = COEFFICIENTS + len(self.turn)
        return Shape(
            float(self.reduced_attenuation * loss),
            float(self.spread * spread),
            float(self.forward_scattering * forward),
            self.correction + step[smooth:],
            self.knots,
            self.turn + step[COEFFICIENTS:smooth],
        )


#: Coefficients of a shape, whose logarithms are estimated.
COEFFICIENTS = 3


def hats(depth: Floats, knots: Floats) -> Floats:
    """Return basis functions of a smooth model departure, (knot, depth) [1].

    Between the knots they are linear. With normal coefficients their sum is a normal
    process of variance 1, correlated over `_CORRELATION` knots.
    """
    number = np.arange(len(knots))
    covariance = np.exp(-(((number[:, None] - number) / _CORRELATION) ** 2) / 2)
    covariance += 1e-6 * np.eye(len(knots))
    values = np.linalg.cholesky(covariance) if len(knots) else covariance
    return np.array([np.interp(depth, knots, row) for row in values.T]).reshape(
        len(knots), depth.size
    )


#: Steps of asinh(z / length) between the nodes of depth, and the farthest node [m].
_STEP, _FARTHEST = 0.04, 2.2e3
#: Edges of panels of the spatial frequency, times the width of the view, with nodes
#: each, and the turn of the oscillations that one panel follows [rad].
_PANELS = np.array([0, 0.02, 0.06, 0.15, 0.4, 0.9, 1.8, 3.2, 5.0, 7.0, 10.0])
_NODES, _PHASE = 10, 18.0
#: Widths of the view beyond which no scattered light is counted [1].
_ASIDE = 20.0
#: Terms of the series over ln(1 + q) for each unit of it, and as many more.
_PER_UNIT, _FEWEST = 9, 8
#: Cells of the table of lost light for each unit of ln x, and its range of x [1/rad].
_CELLS, _LOWEST, _HIGHEST = 8, 0.02, 3e3


class Scattered:
    """Overlap of forward-scattered light, by the small-angle model, eq. (29)."""

    def __init__(
        self,
        function: PhaseFunction,
        split_angle: float,
        *,
        radius: float,
        angle: float,
        standoff: float,
    ) -> None:
        self.function, self.split_angle = function, split_angle
        #: Fraction of the forward part, and its mean square angle as it is [rad^2].
        self.fraction, self.moment = function.forward_split(split_angle)
        self._lost = _lost(function, split_angle)
        self._length = max(0.5 * radius / angle, 1e-3)
        count = int(np.ceil(np.arcsinh(_FARTHEST / self._length) / _STEP))
        depth = self._length * np.sinh(_STEP * np.arange(1, count + 1))
        #: Nodes of depth [m].
        self.depth: Floats = depth
        self._path = depth + standoff
        self._area = radius**2 + (angle * self._path) ** 2
        self._peak = np.pi * (radius * angle) ** 2
        self._low, self._high = np.empty(0), np.empty(0)
        self._known: tuple[float, float, Floats] | None = None

    def light(
        self, depth: Floats, *, forward_scattering: float, spread: float, offset: Floats
    ) -> Floats:
        """Return the overlap of scattered light without reduced attenuation [sr]."""
        aside = np.log1p(offset**2 / self._area)
        self._reach(aside)
        terms = self._terms(forward_scattering, spread)
        at_nodes = np.empty(offset.shape)
        place = (2 * aside - self._low - self._high) / (self._high - self._low)
        kernels.along(np.clip(place, -1, 1), terms, at_nodes)
        at_nodes[offset > _ASIDE * np.sqrt(self._area)] = 0.0
        out = np.empty((len(offset), depth.size))
        node_place = np.arcsinh(depth / self._length) / _STEP
        # Nothing is scattered before the water begins.
        from_start = np.concatenate([np.zeros((len(offset), 1)), at_nodes], axis=1)
        kernels.between(from_start, node_place, out)
        return np.maximum(out, 0.0)

    def _terms(self, forward_scattering: float, spread: float) -> Floats:
        """Return Chebyshev series of scattered light over beam offset, by depth."""
        cached = self._known
        if cached is not None and cached[:2] == (forward_scattering, spread):
            return cached[2]
        stretch = 0.5 * np.log(spread / (forward_scattering * self.moment))
        thickness = 2 * forward_scattering * self.depth
        terms = np.empty(self._rule.shape[:2])
        kernels.series(
            thickness, self._place, stretch * _CELLS, self._lost, self._rule, terms
        )
        self._known = forward_scattering, spread, terms
        return terms

    def _reach(self, aside: Floats) -> None:
        """Extend the quadrature rule to larger offsets if necessary."""
        low, high = aside.min(axis=0), aside.max(axis=0)
        if self._low.size and np.all((low >= self._low) & (high <= self._high)):
            return
        spare = 0.1 + 0.5 * (high - low)
        if self._low.size:
            low, high = np.minimum(low, self._low), np.maximum(high, self._high)
        largest = np.log1p(_ASIDE**2)
        self._low = np.clip(low - spare, 0, largest - 0.1)
        self._high = np.minimum(high + spare, largest)
        self._make_rule()

    def _make_rule(self) -> None:
        """Set the quadrature nodes of spatial frequency, with weights for each term."""
        width = self._high - self._low
        count = _FEWEST + int(np.ceil(_PER_UNIT * width.max()))
        place = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        aside = self._low[:, None] + 0.5 * width[:, None] * (place + 1)
        # In widths of the view.
        offset = np.sqrt(np.expm1(aside))
        rate, weight = _frequencies(float(offset.max()))
        self._place = (
            np.log(rate * (self.depth / np.sqrt(self._area))[:, None] / _LOWEST)
            * _CELLS
        )
        weight = 0.5 * weight * rate * np.exp(-(rate**2) / 4)
        value = j0(offset[:, :, None] * rate) * weight
        value *= (self._peak / self._area)[:, None, None]
        series = chebyshev.chebvander(place, count - 1) * 2 / count
        series[:, 0] /= 2
        self._rule = np.ascontiguousarray(series.T @ value)
        self._known = None


def _frequencies(aside: float) -> tuple[Floats, Floats]:
    """Return quadrature nodes and weights of spatial frequency times view width.

    `aside` is the largest offset of a beam, in widths of the view.
    """
    edges = [np.zeros(1)]
    for low, high in itertools.pairwise(_PANELS):
        parts = max(int(np.ceil((high - low) * aside / _PHASE)), 1)
        edges.append(np.linspace(low, high, parts + 1)[1:])
    edge = np.concatenate(edges)
    node, weight = legendre.leggauss(_NODES)
    half = 0.5 * np.diff(edge)[:, None]
    rate = edge[:-1, None] + half * (node + 1)
    return rate.ravel(), (half * weight).ravel()


@lru_cache(maxsize=8)
def _lost(function: PhaseFunction, split_angle: float) -> Floats:
    """Return ln of the mean of 1 - H (Hankel transform) up to x, at steps of ln x."""
    count = int(np.ceil(np.log(_HIGHEST / _LOWEST) * _CELLS)) + 1
    edge = _LOWEST * np.exp(np.arange(count) / _CELLS)
    node, weight = legendre.leggauss(2)
    half = 0.5 * np.diff(edge)[:, None]
    x = edge[:-1, None] + half * (node + 1)
    flat = function.hankel(x.ravel(), split_angle=split_angle).reshape(x.shape)
    part = ((1 - flat) * weight * half).sum(axis=1)
    # In front of the first node it grows with the square.
    start = (1 - flat[0, 0]) * edge[0] ** 3 / x[0, 0] ** 2 / 3
    total = start + np.append(0.0, np.cumsum(part))
    logarithm: Floats = np.log(total / edge)
    return logarithm


Complex = NDArray[np.complex128]

#: Negligible fraction of the water signal [1].
_NOTHING_LEFT = 1e-7
#: Standard uncertainty of the logarithm of the scattering that a survey states [1].
_STATED = 0.7
#: Directions of the receiver whose arguments are cached.
_KEPT = 8


class Frame:
    """Receiver geometry over a scan, the basis of the water-signal tables."""

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
        self.medium = medium_of(survey)
        self.frequency = modulation_frequency
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
        """Return overlap arguments at the nodes, for a fitted receiver direction."""
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
            turned_survey = self.survey.model_copy(
                update={
                    "instrument": instrument.model_copy(update={"receiver": receiver})
                }
            )
            self._turned[turn] = self._arguments(*self.directions.mesh, turned_survey)
        return self._turned[turn]

    def _arguments(
        self, azimuth: Floats, elevation: Floats, survey: Survey | None = None
    ) -> dict[str, Any]:
        """Return the overlap's geometry arguments, without water properties."""
        survey = self.survey if survey is None else survey
        receiver_view = view(survey, azimuth, elevation)
        arguments = kernel_arguments(survey, self._properties, receiver_view)
        for name in (
            "absorption",
            "forward_scattering",
            "diffuse_scattering",
            "second_moment",
        ):
            del arguments[name]
        radius, angle = widths_together(
            survey, self._properties, receiver_view.acceptance
        )
        return arguments | {"receiver_radius": radius, "acceptance_angle": angle}

    def optical_offset(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return the round-trip optical path before the water [m]."""
        receiver_view = view(self.survey, azimuth, elevation)
        return np.broadcast_to(receiver_view.optical_offset, azimuth.shape)

    def geometry(self, azimuth: Floats, elevation: Floats) -> Geometry:
        """Return the geometry of beams in given directions."""
        instrument = self.survey.instrument
        return Geometry(
            azimuth=azimuth,
            elevation=elevation,
            emitter=np.asarray(instrument.emitter.position, dtype=float),
            receiver=np.asarray(instrument.receiver.position, dtype=float),
            medium=self.medium,
        )

    def overlap(self, depth: Floats, shape: Shape) -> Floats:
        """Overlap at direction nodes, without correction, (node, depth) [sr]."""
        return self._overlap(depth, shape, self._nodes_of(shape))

    def _overlap(
        self, depth: Floats, shape: Shape, arguments: dict[str, Any]
    ) -> Floats:
        """Return the overlap without correction, (direction, depth) [sr].

        (29) of Ricci et al. 2010, as rederived, with the phase function of the survey's
        water, stretched to the spread of the shape. Where it has none, (43) for the
        light that was scattered and again, without spread, for the light that was not;
        together they have the spread of the model. Scattering without bounds leaves
        (43) itself.
        """
        unscattered_share = np.exp(-2 * shape.forward_scattering * depth)
        # The smallest number keeps the start of the water in range.
        scattered_share = np.maximum(1 - unscattered_share, np.finfo(float).tiny)
        geometry = {name: np.asarray(v)[..., None] for name, v in arguments.items()}
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
                offset=self._offset(arguments),
            )
            lost = np.exp(-2 * shape.reduced_attenuation * depth)
            light = unscattered_share * overlap(0.0) + lost * scattered
            return light
        spread = np.where(depth > 0, shape.spread / scattered_share, 0.0)
        light = unscattered_share * overlap(0.0) + scattered_share * overlap(spread)
        return light

    def _offset(self, arguments: dict[str, Any]) -> Floats:
        """Return beam offsets from the receiver axis at scattered-light depths [m]."""
        assert self._scattered is not None
        path = self._scattered.depth + np.asarray(arguments["standoff"])[:, None]
        along = arguments["baseline"][:, None] - arguments["tilt"][:, None] * path
        offset: Floats = np.hypot(along, arguments["cross_tilt"][:, None] * path)
        return offset

    def late_spread(self, depth: float, spread: float, error: float) -> float:
        """Return the angular spread that explains the delay of late echoes [rad^2/m].

        In the middle of the scan, by `optics.late_echo`, for water of the survey's
        phase function with a given spread, of some relative error: the mean of it and
        of the survey's, which counts as known to a factor of two. Where the survey has
        no phase function, the given spread.
        """
        light = self._scattered
        if light is None or not depth > 0:
            return spread
        azimuth, elevation = self.directions.middle
        arguments = self._arguments(np.array([azimuth]), np.array([elevation]))
        stated_scattering = self._properties.scattering
        fitted_scattering = spread / (light.moment * light.fraction)
        trust = _STATED**2 / (_STATED**2 + error**2)
        late = late_echo(
            0.0,
            depth=depth,
            scattering=fitted_scattering**trust * stated_scattering ** (1 - trust),
            phase_function=light.function,
            split_angle=light.split_angle,
            group_index=self.medium.group_index,
            **arguments,
        )
        late_spread = 8 * float(late[0]) / depth**2
        return late_spread if np.isfinite(late_spread) else spread

    def nothing_left(self, shape: Shape) -> float:
        """Return the depth beyond which the water signal is negligible [m]."""
        depth = np.geomspace(1e-2, 2e3, 1500)
        light = self.overlap(depth, shape).max(axis=0)
        remaining = np.cumsum((light * depth)[::-1])[::-1]
        if remaining[0] < SMALLEST_STRENGTH:
            raise unseen_beam()
        return float(depth[np.argmax(remaining <= _NOTHING_LEFT * remaining[0])])

    def quantiles(self, shape: Shape, fraction: Floats) -> Floats:
        """Return depths at which the cumulative overlap reaches `fraction` [m]."""
        depth = np.linspace(0, min(self.nothing_left(shape), self.end), 4000)
        light = self.overlap(depth, shape).mean(axis=0)
        total = np.cumsum(light)
        return np.asarray(np.interp(fraction, total / total[-1], depth))

    def middle(self, depth: Floats, shape: Shape) -> Floats:
        """Return the overlap in the middle of the scan, with its correction [sr]."""
        factor = np.exp(shape.correction @ hats(depth, shape.knots))
        overlap: Floats = self.directions.centre @ self.overlap(depth, shape) * factor
        return overlap


def _scattered_light(
    survey: Survey, properties: WaterProperties, medium: rays.Medium
) -> Scattered | None:
    """Return the scattered-light overlap for the survey's water; None if unknown."""
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
    radius, angle = widths_together(survey, properties, acceptance)
    return Scattered(
        function,
        properties.split_angle,
        radius=radius,
        angle=angle,
        standoff=standoff,
    )


#: Strength below which the receiver's view misses the beam [sr m].
SMALLEST_STRENGTH = 1e-100


def unseen_beam() -> CubeError:
    """Return the exception for a receiver whose view misses the beam at all depths."""
    return CubeError(
        "the receiver does not see the beam at any depth, so there is no water "
        "signal to estimate; check position and axis of the receiver in the survey of "
        "the cube, or reject nothing (keep_water)"
    )


def frame_of(scan: Observation, azimuth: Floats, elevation: Floats) -> Frame:
    """Return the receiver geometry of a scan; CubeError if its survey lacks one."""
    if scan.survey is None:
        raise CubeError(
            "the cube has no attribute 'survey', from which the geometry of the "
            "receiver is taken; add the text of a survey file that describes the "
            "instrument, or use the open-water method"
        )
    return Frame(scan.survey, azimuth, elevation, modulation_frequency=scan.frequency)
