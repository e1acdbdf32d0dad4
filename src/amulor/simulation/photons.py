"""Photon transport as a forward model: selected beams, interpolated to all others."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor import _progress
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.simulation.models import Error, SmallAngleModel
from amulor.survey import Survey, WaterProperties
from amulor.survey.view import View, refuse_beam_and_edges, refuse_layers
from amulor.survey.waters.whole_function import whole_phase_function
from amulor.transport import (
    GaussianReceiver,
    Layer,
    Medium,
    PlaneTarget,
    Progress,
    Source,
    Tally,
    simulate,
)

__all__ = [
    "Axis",
    "Grid",
    "Light",
    "PhotonModel",
    "Place",
    "Setting",
    "follow",
    "grid_of",
    "run",
    "way",
]


Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """Interpolation nodes along a single quantity."""

    nodes: Floats

    def weights(self, value: Floats) -> Floats:
        """Return Lagrange weights of the nodes at given values, shape (n, nodes)."""
        apart = self.nodes[:, None] - self.nodes
        out = np.ones((value.size, self.nodes.size))
        for i, j in itertools.permutations(range(self.nodes.size), 2):
            out[:, i] *= (value - self.nodes[j]) / apart[i, j]
        return out


@dataclass(frozen=True)
class Grid:
    """Interpolation grid: all combinations of the nodes of its axes."""

    axes: tuple[Axis, ...]

    @property
    def places(self) -> Floats:
        """Grid points, shape (places, axes)."""
        nodes = np.meshgrid(*(axis.nodes for axis in self.axes), indexing="ij")
        return np.stack([values.ravel() for values in nodes], axis=1)

    def weights(self, points: Floats) -> Floats:
        """Return interpolation weights of the grid points, shape (n, places) [1]."""
        out = np.ones((len(points), 1))
        for axis, values in zip(self.axes, points.T, strict=True):
            part = axis.weights(np.ascontiguousarray(values))
            out = (out[:, :, None] * part[:, None, :]).reshape(len(points), -1)
        return out

    def between(self, count: int) -> Floats:
        """Return test points between the nodes, shape (count, axes)."""
        places = []
        for number in range(count):
            place = []
            for position, axis in enumerate(self.axes):
                if axis.nodes.size == 1:
                    place.append(axis.nodes[0])
                    continue
                # Halfway between two nodes, other nodes for each axis and number.
                index = (number + position) % (axis.nodes.size - 1)
                place.append((axis.nodes[index] + axis.nodes[index + 1]) / 2)
            places.append(place)
        return np.array(places)


def grid_of(
    values: Floats, *, smallest: Floats, largest_count: NDArray[np.intp]
) -> Grid:
    """Return an interpolation grid that spans the given points."""
    axes = []
    for low, high, small, limit in zip(
        values.min(axis=0), values.max(axis=0), smallest, largest_count, strict=True
    ):
        span = high - low
        if span <= small:
            axes.append(Axis(np.array([(low + high) / 2])))
            continue
        count = int(np.clip(1 + np.ceil(np.log(span / small) / np.log(3)), 2, limit))
        turn = np.cos(np.pi * np.arange(count) / (count - 1))
        axes.append(Axis((low + high) / 2 - span / 2 * turn))
    return Grid(tuple(axes))


@dataclass(frozen=True, kw_only=True)
class Place:
    """Beam for photon transport: receiver geometry and target surface."""

    baseline: float
    """Distance between receiver and beam at depth zero [m]."""
    tilt: float
    """Inclination of the beam relative to the receiver's axis, along the baseline
    [rad]."""
    cross_tilt: float
    """Inclination of the beam relative to the receiver's axis, across the baseline
    [rad]."""
    standoff: float
    """Optical equivalent of air and glass before the water, as a depth of water [m]."""
    depth: float
    """Depth of the target surface along the beam; infinite in open water [m]."""
    reflectance: float
    """Reflectance of the target surface [1]."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Water, receiver and beam widths of a survey, common to all beams."""

    absorption: float
    """Absorption coefficient [1/m]."""
    scattering: float
    """Scattering coefficient [1/m]."""
    phase_function: PhaseFunction
    """Phase function of the water."""
    group_index: float
    """Group index of the water [1]."""
    receiver_radius: float
    """1/e half-width of the aperture [m]."""
    acceptance_angle: float
    """1/e half-width of the receiver's field of view, in the water [rad]."""
    beam_radius: float = 0.0
    """1/e half-width of the beam at its start [m]."""
    beam_divergence: float = 0.0
    """1/e semi-angle of the beam in the water [rad]."""


@dataclass(frozen=True, kw_only=True)
class Light:
    """Ratio of received to launched power at each frequency, with standard error."""

    water: Complex
    """Ratio of received to launched power, scattered by water only, shape (n,) [1]."""
    water_error: Floats
    """Standard error of `water`, real and imaginary part combined [1]."""
    target: Complex
    """Ratio of received to launched power, reflected by the target, shape (n,) [1]."""
    target_error: Floats
    """Standard error of `target`, real and imaginary part combined [1]."""


def follow(
    setting: Setting,
    place: Place,
    frequency: Floats,
    *,
    relative_error: float,
    histories: int,
    seed: int,
    progress: Callable[[Progress], None] | None = None,
) -> Light:
    """Simulate photons of one beam, and return the received light."""
    tally = run(
        setting,
        place,
        frequency,
        relative_error=relative_error,
        histories=histories,
        seed=seed,
        progress=progress,
    )
    return Light(
        water=tally.water_signal,
        water_error=_error(tally.water_covariance),
        target=tally.target_signal,
        target_error=_error(tally.target_covariance),
    )


def run(
    setting: Setting,
    place: Place,
    frequency: Floats,
    *,
    relative_error: float,
    histories: int,
    seed: int,
    progress: Callable[[Progress], None] | None = None,
) -> Tally:
    """Simulate photons of one beam, and return the tally."""
    layer = Layer(
        absorption=setting.absorption,
        scattering=setting.scattering,
        phase_function=setting.phase_function,
    )
    gap = place.standoff
    if gap > 0:
        clear = Layer(
            absorption=0.0,
            scattering=0.0,
            phase_function=setting.phase_function,
            thickness=gap,
        )
        medium = Medium.layered([clear, layer], group_index=setting.group_index)
    else:
        medium = Medium(layers=(layer,), group_index=setting.group_index)
    start, direction, point = ends(place)
    target = None
    if np.isfinite(place.depth):
        target = PlaneTarget(
            position=point,
            normal=-direction,
            reflectance=place.reflectance,
        )
    tally = simulate(
        medium,
        Source(
            position=start,
            direction=direction,
            radius=setting.beam_radius,
            divergence=setting.beam_divergence,
        ),
        GaussianReceiver(
            position=(place.baseline, 0.0, 0.0),
            radius=setting.receiver_radius,
            acceptance_angle=setting.acceptance_angle,
        ),
        frequency,
        histories=histories,
        seed=seed,
        target=target,
        relative_error=relative_error,
        progress=progress,
    )
    if tally.interrupted:
        raise KeyboardInterrupt
    return tally.delayed(-gap, group_index=setting.group_index) if gap else tally


def ends(place: Place) -> tuple[Floats, Floats, Floats]:
    """Return start, direction and end of a beam in water (the start in open water)."""
    across = np.array([place.tilt, place.cross_tilt])
    direction = np.append(across, np.sqrt(1.0 - across @ across))
    start = place.standoff * np.append(across, 1.0)
    depth = place.depth if np.isfinite(place.depth) else 0.0
    return start, direction, start + depth * direction


def way(place: Place) -> float:
    """Return the path length in water, to the surface and back to the receiver [m]."""
    _, _, point = ends(place)
    return_length = np.linalg.norm(point - np.array([place.baseline, 0.0, 0.0]))
    return place.depth + float(return_length) - place.standoff


def _error(covariance: Floats) -> Floats:
    """Return the standard error, root sum of squares of real and imaginary part."""
    return np.asarray(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1)))


#: Range of baseline [m], tilt [rad], squared cross tilt [rad^2] and depth [m] that
#: needs a single node only, and the most nodes of each.
_LEAST = np.array([2e-3, 2e-3, 1e-4, 0.01])
_MOST = np.array([2, 3, 2, 4])
#: Places between the nodes, for the error of the interpolation.
_CHECKS = 3


@dataclass(frozen=True, kw_only=True)
class Factor:
    """Ratio of photon-transport light to small-angle light, interpolated over beams."""

    grid: Grid
    """Beams of photon transport: baseline, tilt, squared cross tilt, depth."""
    value: Complex
    """Ratio at each frequency and grid point, shape (frequencies, places) [1]."""
    error: Floats
    """Standard error of each ratio [1]."""
    between: Floats
    """Standard error of the interpolation, shape (frequencies,) [1]."""

    def at(self, points: Floats) -> tuple[Complex, Floats]:
        """Return the ratio for beams and its standard error, shape (frequencies, n)."""
        weight = self.grid.weights(points)
        variance = (self.error**2) @ (weight**2).T
        return self.value @ weight.T, np.sqrt(variance + self.between[:, None] ** 2)


@dataclass(frozen=True, kw_only=True)
class PhotonModel:
    """Photon transport with all orders of scattering: slow reference model.

    Photons are simulated for a few beams and depths of the survey. For all others the
    ratio of their light to that of the small-angle model, eq. (29), is interpolated.
    This ratio is a smooth function near 1. It includes late echoes and light scattered
    twice by large angles. The errors of photon transport and of the interpolation,
    tested between the nodes, are part of the samples' uncertainty.

    Examples
    --------
    >>> from amulor.simulation import PhotonModel
    >>> model = PhotonModel(relative_error=0.01, histories=500_000, seed=7)
    >>> print(model.late_echo)
    present
    """

    relative_error: float = 0.005
    """Required relative standard error of a beam's unmodulated received light [1]."""
    histories: int = 2_000_000
    """Largest number of photons for one beam; the error is first tested after an eighth
    of them."""
    seed: int = 1
    """Seed of the photons' random numbers."""
    progress: Callable[[str, float], None] | None = field(
        default=None, compare=False, repr=False
    )
    """Callback with the current step and the completed fraction of the work."""
    title: str = "photon transport, all orders of scattering"
    """Name of the model for cube attributes."""
    late_echo: str = "present"
    """Late light is "present", from scattered photons."""
    _known: dict[Any, Any] = field(
        default_factory=dict, init=False, compare=False, repr=False
    )

    def __post_init__(self) -> None:
        """Raise a ValueError unless the relative error is between 0 and 1."""
        if not 0 < self.relative_error < 1:
            raise ValueError(
                f"relative_error must be above 0 and below 1, got {self.relative_error}"
            )

    def echo(
        self,
        modulation_frequency: Floats,
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return target echo power over launched power; see `SignalModel`."""
        return self.echo_with_error(
            modulation_frequency, survey=survey, water=water, view=view, surface=surface
        )[0]

    def echo_with_error(
        self,
        modulation_frequency: Floats,
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> tuple[Complex, Error]:
        """Return `echo` with its standard error; see `UncertainModel`."""
        plain = SmallAngleModel().echo(
            modulation_frequency, survey=survey, water=water, view=view, surface=surface
        )
        value, error = np.array(plain), np.zeros(plain.shape)
        frequency = modulation_frequency.ravel()
        share = np.broadcast_to(surface["reflectance"], view.tilt.shape)
        for reflectance in np.unique(share[share > 0]):
            selected = share == reflectance
            points = _places(view, surface["depth"])[selected.ravel()]
            factor = self._factor(
                survey, water, view, points, frequency, float(reflectance), "target"
            )
            _apply(factor.at(points), selected, value, error)
        return value, error

    def column(
        self,
        modulation_frequency: Floats,
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return water backscatter power over launched power; see `SignalModel`."""
        return self.column_with_error(
            modulation_frequency, survey=survey, water=water, view=view, end=end
        )[0]

    def column_with_error(
        self,
        modulation_frequency: Floats,
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> tuple[Complex, Error]:
        """Return `column` with its standard error; see `UncertainModel`."""
        shape = view.tilt.shape
        axes = (-1,) + (1,) * (modulation_frequency.ndim - 1)
        frequency = modulation_frequency.ravel()
        stop = np.broadcast_to(np.asarray(end, dtype=float), shape)
        plain = SmallAngleModel().column(
            modulation_frequency.reshape(axes),
            survey=survey,
            water=water,
            view=view,
            end=stop,
        )
        value, error = np.array(plain), np.zeros(plain.shape)
        far = np.inf if survey.water.column_end is None else survey.water.column_end
        bounded = np.isfinite(stop)
        # Before targets; before the far end of the water; in open water.
        for selected, reflectance in (
            (bounded & (stop < far), _brightness(survey)),
            (bounded & (stop >= far), 0.0),
            (~bounded, 0.0),
        ):
            if selected.any():
                points = _places(view, stop)[selected.ravel()]
                factor = self._factor(
                    survey, water, view, points, frequency, reflectance, "water"
                )
                places = points[:, : len(factor.grid.axes)]
                _apply(factor.at(places), selected, value, error)
        return value, error

    # --------------------------------------------------------------- the photons

    def _factor(
        self,
        survey: Survey,
        water: WaterProperties,
        view: View,
        points: Floats,
        frequency: Floats,
        reflectance: float,
        light: str,
    ) -> Factor:
        """Return the interpolated ratio of photon-transport to small-angle light."""
        setting = _setting(survey, water, view)
        standoff = float(view.standoff.flat[0])
        bounded = bool(np.isfinite(points[:, 3]).all())
        axes = 4 if bounded else 3
        grid = grid_of(
            points[:, :axes], smallest=_LEAST[:axes], largest_count=_MOST[:axes]
        )
        spots = np.concatenate([grid.places, grid.between(_CHECKS)])
        ratios, errors = [], []
        for number, spot in enumerate(spots):
            place = Place(
                baseline=float(spot[0]),
                tilt=float(spot[1]),
                cross_tilt=math.sqrt(max(float(spot[2]), 0.0)),
                standoff=standoff,
                depth=float(spot[3]) if bounded else math.inf,
                reflectance=reflectance,
            )
            result = self._followed(setting, place, frequency, (number, len(spots)))
            expected = _small_angle(survey, water, view, place, frequency, light)
            simulated, standard_error = (
                (result.water, result.water_error)
                if light == "water"
                else (result.target, result.target_error)
            )
            # Water without light by small angles stays dark.
            lit = expected != 0
            safe = np.where(lit, expected, 1.0)
            ratios.append(np.where(lit, simulated / safe, 1.0))
            errors.append(np.where(lit, standard_error / abs(safe), 0.0))
        nodes = len(grid.places)
        value, error = np.array(ratios).T, np.array(errors).T
        factor = Factor(
            grid=grid,
            value=value[:, :nodes],
            error=error[:, :nodes],
            between=np.zeros(len(frequency)),
        )
        guess, guess_error = factor.at(spots[nodes:])
        # The error of the interpolation is the excess over the errors of the photons.
        miss = (
            abs(guess - value[:, nodes:]) ** 2 - guess_error**2 - error[:, nodes:] ** 2
        )
        between = np.sqrt(np.maximum(miss.mean(axis=1), 0.0))
        return Factor(
            grid=grid, value=factor.value, error=factor.error, between=between
        )

    def _followed(
        self,
        setting: Setting,
        place: Place,
        frequency: Floats,
        count: tuple[int, int],
    ) -> Light:
        """Return the light of one beam, simulated at the first call and cached."""
        key = (setting, place, tuple(frequency))
        if key not in self._known:
            self._known[key] = follow(
                setting,
                place,
                frequency,
                relative_error=self.relative_error,
                histories=self.histories,
                seed=self.seed + 1000 * len(self._known),
                progress=self._reported(count),
            )
        light: Light = self._known[key]
        return light

    def _reported(self, count: tuple[int, int]) -> Callable[[Progress], None]:
        """Return a progress callback for the photons of one of several beams."""
        tell = _progress.tell if self.progress is None else self.progress
        number, places = count

        def report(state: Progress) -> None:
            part = min(1.0, (self.relative_error / state.relative_error) ** 2)
            tell(
                f"photons, place {number + 1} of {places}, {state.histories:,}",
                (number + part) / places,
            )

        return report


def _apply(
    factor: tuple[Complex, Floats],
    selected: NDArray[np.bool_],
    value: Complex,
    error: Floats,
) -> None:
    """Multiply the small-angle light of selected beams by ratios; store the error."""
    between = [1] * (value.ndim - 1 - selected.ndim)
    ratio, standard_error = factor
    error[..., selected] = abs(value[..., selected]) * standard_error.reshape(
        len(value), *between, -1
    )
    value[..., selected] *= ratio.reshape(len(value), *between, -1)


def _places(view: View, depth: Any) -> Floats:
    """Return baseline, tilt, squared cross tilt and depth of each beam, (n, 4)."""
    shape = view.tilt.shape
    parts = (view.baseline, view.tilt, view.cross_tilt**2, np.asarray(depth, float))
    return np.stack([np.broadcast_to(part, shape).ravel() for part in parts], axis=1)


def _brightness(survey: Survey) -> float:
    """Return the reflectance of the first target; 0 for a survey without targets."""
    return float(survey.targets[0].reflectance) if survey.targets else 0.0


def _setting(survey: Survey, water: WaterProperties, view: View) -> Setting:
    """Return water, receiver and beam widths of a survey, for photon transport."""
    refuse_layers(water, model="the photon model")
    refuse_beam_and_edges(survey, model="the photon model")
    return Setting(
        absorption=water.absorption,
        scattering=water.forward_scattering + water.diffuse_scattering,
        phase_function=whole_phase_function(water),
        group_index=water.group_index,
        receiver_radius=survey.instrument.receiver.radius,
        acceptance_angle=view.acceptance,
    )


def _small_angle(
    survey: Survey,
    water: WaterProperties,
    view: View,
    place: Place,
    frequency: Floats,
    light: str,
) -> Complex:
    """Return target or water light of one beam by the small-angle model."""
    beam_view = View(
        baseline=np.array([place.baseline]),
        transmission=np.ones(1),
        tilt=np.array([place.tilt]),
        cross_tilt=np.array([place.cross_tilt]),
        standoff=np.array([place.standoff]),
        optical_offset=np.zeros(1),
        acceptance=view.acceptance,
    )
    common: dict[str, Any] = {"survey": survey, "water": water, "view": beam_view}
    model, f = SmallAngleModel(), frequency[:, None]
    if light == "water":
        return model.column(f, end=np.array([place.depth]), **common)[:, 0]
    length = way(place)
    # The cosine is that of the way back and the plane across the beam.
    _, direction, point = ends(place)
    to_receiver = np.array([place.baseline, 0.0, 0.0]) - point
    surface = {
        "depth": np.array([place.depth]),
        "optical_path": np.array([water.group_index * length]),
        "return_path": np.array([length - place.depth]),
        "reflectance": np.array([place.reflectance]),
        "cosine": np.array(
            [float(-direction @ to_receiver / np.linalg.norm(to_receiver))]
        ),
    }
    return model.echo(f, surface=surface, **common)[:, 0]
