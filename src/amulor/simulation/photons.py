"""Photon transport as a forward model: simulated beams, and a fit to all others."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
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
    Technique,
    simulate,
)

__all__ = [
    "Light",
    "PhotonModel",
    "Place",
    "Setting",
    "basis_of",
    "chosen_beams",
    "fitted_ratio",
    "follow",
    "run",
    "way",
]


Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


def basis_of(points: Floats, *, smallest: Floats, degree: Any) -> tuple[Floats, int]:
    """Return orthonormal polynomials at the points, and the number of those to fit.

    Each axis has the stated degree at most, and a lower one if it spans little. The
    polynomials that follow have one degree more; they test the fit.
    """
    span = np.ptp(points, axis=0)
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    wide = span > smallest
    unit = np.where(wide, 2 * (points - middle) / np.where(wide, span, 1.0), 0.0)
    ratio = np.where(wide, span / smallest, 1.0)
    most = np.minimum(np.ceil(np.log(ratio) / np.log(3)).astype(int), degree)
    basis = np.empty((len(points), 0))
    fitted = 0
    for more in (0, 1):
        limit = most + more * wide
        values = [
            np.polynomial.legendre.legvander(column, high)
            for column, high in zip(unit.T, limit, strict=True)
        ]
        columns = [
            np.prod([v[:, k] for v, k in zip(values, powers, strict=True)], axis=0)
            for powers in itertools.product(*(range(high + 1) for high in limit))
            if sum(powers) <= limit.max()
        ]
        new = np.stack(columns, axis=1)
        new -= basis @ (basis.T @ new) / len(points)
        left, size, _ = np.linalg.svd(new, full_matrices=False)
        size /= math.sqrt(len(points))
        basis = np.hstack([basis, left[:, size > _SMALL] * math.sqrt(len(points))])
        fitted = fitted or basis.shape[1]
    return basis, fitted


def chosen_beams(basis: Floats, rng: np.random.Generator) -> Iterator[int]:
    """Yield the beams to simulate: the least certain of a fit and a random one in turn.

    The least certain has the largest variance of a fit to the beams so far.
    """
    candidates = rng.choice(len(basis), min(len(basis), _CANDIDATES), replace=False)
    functions = basis[candidates]
    information = 1e-3 * np.eye(basis.shape[1])
    for number in itertools.count():
        if number % 2 == 0:
            solved = np.linalg.solve(information, functions.T)
            selected = int(np.argmax(np.sum(functions.T * solved, axis=0)))
        else:
            selected = int(rng.integers(len(candidates)))
        information += np.outer(functions[selected], functions[selected])
        yield int(candidates[selected])


def fitted_ratio(
    basis: Floats, fitted: int, beams: list[int], ratio: Complex
) -> tuple[Complex, Floats]:
    """Return the fitted ratio at all beams and its standard error, (frequencies, n).

    The ratio of the simulated beams has the shape (runs, frequencies). The covariance
    of the coefficients follows from the residuals, each divided by one minus its
    leverage, without the assumption of equal errors (HC3). The mean square of what the
    polynomials of one degree more add, beyond its own noise, is added to all variances.
    """
    everything = basis[beams]
    functions = everything[:, :fitted]
    inverse = np.linalg.pinv(functions)
    leverage = np.sum(functions * inverse.T, axis=1)
    coefficient = inverse @ ratio
    residual = (ratio - functions @ coefficient) / (1 - leverage)[:, None]
    value = (basis[:, :fitted] @ coefficient).T
    spread = inverse[:, :, None] * abs(residual)
    covariance = np.einsum("irf,jrf->fij", spread, spread)
    variance = np.einsum(
        "ni,fij,nj->fn",
        basis[:, :fitted],
        covariance,
        basis[:, :fitted],
        optimize=True,
    )
    whole = np.linalg.pinv(everything)
    more = whole @ ratio
    noise = ratio - everything @ more
    freedom = len(beams) - everything.shape[1]
    mean_square = np.sum(abs(noise) ** 2, axis=0) / freedom
    added = np.sum(abs(more[:fitted] - coefficient) ** 2, axis=0)
    added += np.sum(abs(more[fitted:]) ** 2, axis=0)
    expected = mean_square * (np.sum(whole**2) - np.sum(inverse**2))
    missing = np.maximum(added - expected, 0.0)
    return value, np.sqrt(variance + missing[:, None])


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
    """Ratio of received to launched power at each frequency."""

    water: Complex
    """Ratio of received to launched power, scattered by water only, shape (n,) [1]."""
    target: Complex
    """Ratio of received to launched power, reflected by the target, shape (n,) [1]."""


def follow(
    setting: Setting, place: Place, frequency: Floats, *, histories: int, seed: int
) -> Light:
    """Simulate photons of one beam in a single batch, and return the received light."""
    tally = run(
        setting,
        place,
        frequency,
        histories=histories,
        seed=seed,
        technique=Technique(batch=histories),
        threads=1,
    )
    return Light(water=tally.water_signal, target=tally.target_signal)


def run(
    setting: Setting,
    place: Place,
    frequency: Floats,
    *,
    histories: int,
    seed: int,
    relative_error: float | None = None,
    technique: Technique | None = None,
    threads: int | None = None,
    progress: Callable[[Progress], None] | None = None,
    derivatives: Sequence[str] = (),
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
        technique=technique,
        threads=threads,
        progress=progress,
        derivatives=derivatives,
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


#: Ranges of baseline [m], tilt [rad], squared cross tilt [rad^2] and depth [m] with a
#: constant ratio, and the highest degrees of the polynomials beyond.
_LEAST = np.array([2e-3, 2e-3, 1e-4, 0.01])
_DEGREE = np.array([1, 2, 1, 3])
#: Root mean square over the beams below which a polynomial is left out.
_SMALL = 0.02
#: Most beams that are considered for a run.
_CANDIDATES = 2048
#: Runs of one beam with as many photons as `histories`, and fewest photons in a run.
_RUNS, _FEWEST = 64, 16384


@dataclass(frozen=True, kw_only=True)
class PhotonModel:
    """Photon transport with all orders of scattering: slow reference model.

    Photons are simulated for some beams of the survey, chosen as the runs go on. A
    polynomial is fitted to the ratio of their light to that of the small-angle model,
    eq. (29), and used for all beams. This ratio is a smooth function near 1. It
    includes late echoes and light scattered twice by large angles. The error of the fit
    is part of the samples' uncertainty. Neighboring beams have nearly the same error.

    Examples
    --------
    >>> from amulor.simulation import PhotonModel
    >>> model = PhotonModel(relative_error=0.01, histories=500_000, seed=7)
    >>> print(model.late_echo)
    present
    """

    relative_error: float = 0.005
    """Required relative standard error of the unmodulated received light, root mean
    square over the beams [1]."""
    histories: int = 2_000_000
    """Largest number of photons for each coefficient of the fit; the error is first
    tested after an eighth of them."""
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
            _apply(factor, selected, value, error)
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
                _apply(factor, selected, value, error)
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
    ) -> tuple[Complex, Floats]:
        """Return the ratio of photon-transport to small-angle light, and its error."""
        setting = _setting(survey, water, view)
        standoff = float(view.standoff.flat[0])
        bounded = bool(np.isfinite(points[:, 3]).all())
        axes = 4 if bounded else 3
        basis, fitted = basis_of(
            points[:, :axes], smallest=_LEAST[:axes], degree=_DEGREE[:axes]
        )
        photons = 8 * (max(self.histories // _RUNS, _FEWEST) // 8)
        least = max(_RUNS // 8, 3 * basis.shape[1])
        most = max(least, math.ceil(fitted * self.histories / photons))
        order = chosen_beams(basis, np.random.default_rng(self.seed))
        beams: list[int] = []
        lights: list[list[Complex]] = []
        wanted, error = least, math.inf
        while error > self.relative_error and len(beams) < most:
            new = list(itertools.islice(order, wanted - len(beams)))
            places = [
                Place(
                    baseline=float(points[beam, 0]),
                    tilt=float(points[beam, 1]),
                    cross_tilt=math.sqrt(max(float(points[beam, 2]), 0.0)),
                    standoff=standoff,
                    depth=float(points[beam, 3]) if bounded else math.inf,
                    reflectance=reflectance,
                )
                for beam in new
            ]
            runs = self._followed(setting, places, frequency, photons, len(beams))
            for place, run in zip(places, runs, strict=True):
                lights.append(
                    [
                        run.water,
                        run.target,
                        _small_angle(survey, water, view, place, frequency, "water"),
                        _small_angle(survey, water, view, place, frequency, "target")
                        if reflectance > 0
                        else np.zeros_like(run.water),
                    ]
                )
            beams += new
            columns = np.moveaxis(np.array(lights), 1, 0)
            water_light, echo, model_water, model_echo = columns
            whole = _ratio(water_light + echo, model_water + model_echo)
            _, errors = fitted_ratio(basis, fitted, beams, whole[:, :1])
            doubt = 1 / math.sqrt(2 * (len(beams) - fitted))
            error = float(np.sqrt(np.mean(errors**2))) * (1 + doubt)
            wanted = min(most, math.ceil(len(beams) * math.sqrt(2)))
        ratio = (
            _ratio(water_light, model_water)
            if light == "water"
            else _ratio(echo, model_echo)
        )
        return fitted_ratio(basis, fitted, beams, ratio)

    def _followed(
        self,
        setting: Setting,
        places: list[Place],
        frequency: Floats,
        histories: int,
        before: int,
    ) -> list[Light]:
        """Return the light of beams, simulated in parallel at the first call, cached.

        The number of runs before is part of the key, as each is a new one.
        """
        keys = [
            (setting, place, tuple(frequency), before + number)
            for number, place in enumerate(places)
        ]
        tell = _progress.tell if self.progress is None else self.progress
        missing = [key for key in keys if key not in self._known]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            runs = [
                pool.submit(
                    follow,
                    setting,
                    key[1],
                    frequency,
                    histories=histories,
                    seed=self.seed + 1000 * (len(self._known) + number),
                )
                for number, key in enumerate(missing)
            ]
            try:
                results = []
                for number, run in enumerate(runs):
                    results.append(run.result())
                    tell(
                        f"photons, beam {before + number + 1}",
                        (number + 1) / len(runs),
                    )
            finally:
                for run in runs:
                    run.cancel()
        self._known.update(zip(missing, results, strict=True))
        return [self._known[key] for key in keys]


def _ratio(simulated: Complex, expected: Complex) -> Complex:
    """Return a ratio of light; 1 where the small-angle model has none."""
    # Water without light by small angles stays dark.
    lit = expected != 0
    result: Complex = np.ones_like(simulated)
    np.divide(simulated, expected, out=result, where=lit)
    return result


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
    """Return water and receiver of a survey that the photon model simulates."""
    refuse_layers(water, model="the photon model")
    refuse_beam_and_edges(survey, model="the photon model")
    return setting_of(survey, water, view)


def setting_of(
    survey: Survey, water: WaterProperties, view: View, **widths: float
) -> Setting:
    """Return water, receiver and widths of the beam of a survey."""
    return Setting(
        absorption=water.absorption,
        scattering=water.forward_scattering + water.diffuse_scattering,
        phase_function=whole_phase_function(water),
        group_index=water.group_index,
        receiver_radius=survey.instrument.receiver.radius,
        acceptance_angle=view.acceptance,
        **widths,
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
