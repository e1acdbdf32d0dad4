"""Noiseless light of a survey for simulated devices; expected statistics of a scan."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.platform import pose_line
from amulor.simulation import geometry, lock_in
from amulor.simulation.lock_in import expected_signal
from amulor.simulation.measurement import Setting, fit
from amulor.simulation.models import DEFAULT_MODEL, SignalModel
from amulor.simulation.vehicle import VehicleMotion
from amulor.survey import Survey
from amulor.survey.course import planned_speed
from amulor.survey.directions import open_water_directions, scan_directions
from amulor.survey.view import view

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class LightByDirection:
    """Noiseless light in given directions, without the detector's dark counts."""

    azimuth: Floats
    """Azimuth of each direction, positive to the right, shape (place,) [rad]."""
    elevation: Floats
    """Elevation of each direction, positive upwards, shape (place,) [rad]."""
    target: NDArray[np.complex128]
    """Peak amplitude of the target signal, shape (frequency, polarization, place)
    [V]."""
    water: NDArray[np.complex128]
    """Peak amplitude of the water signal, of equal shape [V]."""
    target_rate: Floats
    """Photoelectron rate of the target's light, of equal shape [1/s]."""
    water_rate: Floats
    """Photoelectron rate of the water's light, of equal shape [1/s]."""


@dataclass(frozen=True)
class SceneLight:
    """Noiseless light of a survey, with and without the targets."""

    with_target: LightByDirection
    """Light in the directions of the scan."""
    open_water: LightByDirection
    """Light in the directions of the open-water shots and of the scan."""
    vehicle: Callable[[int, float], MovingLight] | None = None
    """Light from a vehicle, for a seed and the start of its course by the time of the
    scan [s]; None if the instrument stands still."""


#: Largest motion between two times at which light is computed [m], and their largest
#: distance as a part of the period of oscillations [1].
_NEXT, _PART = 3e-3, 1 / 200
#: Rows of directions at a time whose light is remembered.
_MOST_ROWS = 64
#: Longest scan over the planned duration [1], and an addition [s].
_LONGER, _LATER = 4.0, 600.0


class MovingLight:
    """Light and measured poses of a simulated vehicle, by the time of a scan.

    The light is computed at times between which the vehicle moves by 3 mm at most, for
    a row of directions at once, and interpolated.
    """

    def __init__(
        self, survey: Survey, model: SignalModel, seed: int, start: float
    ) -> None:
        assert survey.platform is not None
        motion = VehicleMotion.of(survey, seed)
        scan = survey.scan
        self._setup = geometry.Setup(survey, motion)
        self._model, self._start = model, start
        self._directions = scan_directions(survey)[:2]
        self._columns = scan.columns
        wave = survey.platform.disturbance
        self._step = min(
            motion.planned_duration / scan.rows,
            _NEXT / max(planned_speed(survey.platform), 1e-6),
            wave.period * _PART,
        )
        self._rows: dict[tuple[int, int], NDArray[np.complex128]] = {}
        duration = _LONGER * motion.planned_duration + _LATER
        self._track = motion.measured(lead=start, duration=duration)
        # Arrivals by the clock of the scan, which has neither offset nor drift.
        mounting = motion.mounting
        stamps = self._track.time - mounting.clock_offset
        self._arrivals = stamps / (1 + mounting.clock_drift)

    def light(self, time: float, direction: int) -> LightByDirection:
        """Return the light in one direction of the scan, with a single place."""
        row, column = divmod(direction, self._columns)
        number, share = divmod(time / self._step, 1.0)
        before, after = (self._row(row, int(number) + step) for step in (0, 1))
        place = slice(column, column + 1)
        light = (1 - share) * before[..., place] + share * after[..., place]
        azimuth, elevation = (angle[row, place] for angle in self._directions)
        return LightByDirection(
            azimuth=azimuth,
            elevation=elevation,
            target=light[0],
            water=light[1],
            target_rate=light[2].real,
            water_rate=light[3].real,
        )

    def _row(self, row: int, number: int) -> NDArray[np.complex128]:
        """Return signals and rates in a row's directions at a multiple of the step."""
        key = (row, number)
        if key not in self._rows:
            while len(self._rows) >= _MOST_ROWS:
                del self._rows[next(iter(self._rows))]
            azimuth, elevation = (angle[[row]] for angle in self._directions)
            time = np.full(azimuth.shape, number * self._step - self._start)
            light = _with_target(self._setup, self._model, (azimuth, elevation, time))
            self._rows[key] = np.stack(
                [light.target, light.water, light.target_rate, light.water_rate]
            )
        return self._rows[key]

    def messages(self, begin: float, end: float) -> list[tuple[float, str]]:
        """Return time and text of the poses from one time until before another."""
        track = self._track
        low, high = np.searchsorted(self._arrivals, [begin, end])
        return [
            (
                float(self._arrivals[index]),
                pose_line(
                    time=float(track.time[index]),
                    position=track.position[index],
                    attitude=track.attitude[index],
                    covariance=track.covariance[index],
                ),
            )
            for index in range(low, high)
        ]


def scene_light(
    survey: Survey,
    *,
    model: SignalModel = DEFAULT_MODEL,
) -> SceneLight:
    """Return the noiseless light of a survey, for simulated devices.

    Parameters
    ----------
    survey : Survey
        Water, targets, instrument and scan.
    model : SignalModel
        Forward model, by default the small-angle model with the whole phase function.

    Returns
    -------
    SceneLight
        The argument `scene` of `amulor.acquisition.acquire`.

    Raises
    ------
    SurveyError
        As `amulor.simulate`.
    MissingExtraError
        If there are targets and the extra `scene` is not installed.

    Examples
    --------
    >>> from amulor import Survey
    >>> from amulor.simulation import ClosureModel
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...     }
    ... )
    >>> light = scene_light(survey, model=ClosureModel())
    >>> light.with_target.target.shape  # frequency, polarization, place
    (1, 1, 6)
    """
    setup = geometry.Setup(survey)
    azimuth, elevation = (angle.ravel() for angle in scan_directions(survey)[:2])
    with_target = None
    if survey.platform is None:
        with_target = _with_target(setup, model, None)
    if survey.scan.open_water is not None:
        grid = np.unique(np.stack(open_water_directions(survey)), axis=1)
        azimuth = np.concatenate([grid[0], azimuth])
        elevation = np.concatenate([grid[1], elevation])
    shots = view(survey, azimuth, elevation)
    light = lock_in.water_light(setup, shots, model=model)
    none = lock_in.Light(np.zeros_like(light.modulated), np.zeros_like(light.mean))
    water = _by_direction(setup, (azimuth, elevation), none, light)
    if with_target is not None:
        return SceneLight(with_target, water)
    scanned = scan_directions(survey)[:2]
    return SceneLight(
        # Directions of the scan; the light follows from the time, too.
        replace(water, azimuth=scanned[0].ravel(), elevation=scanned[1].ravel()),
        water,
        functools.partial(MovingLight, survey, _fitted(survey, model)),
    )


def _fitted(survey: Survey, model: SignalModel) -> SignalModel:
    """Return the model, fitted to the whole course if it supports a fit."""
    # Simulated devices have no errors of the survey.
    perfect = survey.with_({"instrument.errors": None})
    return fit(Setting.of(perfect, rng=0, model=model))


def _with_target(
    setup: geometry.Setup,
    model: SignalModel,
    directions: tuple[Floats, Floats, Floats] | None,
) -> LightByDirection:
    """Return the light of water and targets in directions at their times."""
    scanned = geometry.trace(setup, directions=directions)
    return _by_direction(
        setup,
        (scanned.azimuth, scanned.elevation),
        lock_in.target_light(setup, scanned, model=model),
        lock_in.water_light(setup, scanned.view, end=scanned.depth, model=model),
    )


def _by_direction(
    setup: geometry.Setup,
    direction: tuple[Floats, Floats],
    target: lock_in.Light,
    water: lock_in.Light,
) -> LightByDirection:
    def rate(light: lock_in.Light) -> Floats:
        # Fully modulated light gives the depth times the mean output.
        instrument = setup.survey.instrument
        wholly = lock_in.Light(light.mean.astype(complex), light.mean)
        volts = expected_signal(setup, wholly).real
        volt = instrument.detector.volt_per_photoelectron_rate
        return volts / (instrument.modulation_depth * volt)

    def flat(values: NDArray) -> NDArray:  # type: ignore[type-arg]
        return values.reshape(*values.shape[:2], -1)

    return LightByDirection(
        azimuth=direction[0].ravel(),
        elevation=direction[1].ravel(),
        target=flat(expected_signal(setup, target)),
        water=flat(expected_signal(setup, water)),
        target_rate=flat(rate(target)),
        water_rate=flat(rate(water)),
    )


#: Most beams along each side of the scan.
_BEAMS = 25


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """Expected statistics of a scan's samples; medians are NaN if no target is hit.

    Examples
    --------
    >>> from amulor import Survey, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...     }
    ... )
    >>> found = expectation(survey, model=simulation.ClosureModel())
    >>> found.hit, found.saturated
    (1.0, 0.0)
    """

    hit: float
    """Fraction of the beams that hit a target [1]."""
    hit_each: tuple[float, ...]
    """Fraction of the beams that hit each target of the survey [1]."""
    saturated: float
    """Fraction of the samples that saturate the detector [1]."""
    signal_to_noise: Floats
    """Median signal-to-noise ratio of the target signal, shape (modulation_frequency,
    polarization) [1]."""
    water_to_echo: Floats
    """Median ratio of the water signal in front of the target to the target signal, of
    equal shape [1]."""


def expectation(survey: Survey, *, model: SignalModel = DEFAULT_MODEL) -> Expectation:
    """Estimate statistics of a scan's samples from a grid of at most 25 x 25 beams.

    Parameters
    ----------
    survey : Survey
        Water, targets, instrument and scan.
    model : SignalModel
        Forward model, by default the small-angle model with the whole phase function.

    Returns
    -------
    Expectation
        Statistics of at most 25 x 25 beams, evenly spaced over the scan.

    Raises
    ------
    SurveyError
        As `amulor.simulate`.
    MissingExtraError
        If there are targets and the extra `scene` is not installed.

    Notes
    -----
    The uncertainty is that of a single sample: photon noise, dark counts, daylight and
    the phase floor. The fluctuation of the water is no noise of the instrument and is
    excluded.

    Examples
    --------
    >>> from amulor import Survey
    >>> from amulor.simulation import ClosureModel
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...     }
    ... )
    >>> found = expectation(survey, model=ClosureModel())
    >>> found.hit, bool(found.signal_to_noise[0, 0] > 100)
    (1.0, True)
    """
    scan = survey.scan
    setup, directions = geometry.Setup(survey), None
    if survey.platform is None:
        coarse = {
            "scan.columns": min(scan.columns, _BEAMS),
            "scan.rows": min(scan.rows, _BEAMS),
        }
        setup = geometry.Setup(survey.with_(coarse))
    else:
        # Fewer pixels would take less time, in which the vehicle would go less far.
        setup = geometry.Setup(survey, VehicleMotion.of(survey, 0))
        directions = scan_directions(
            survey,
            rows=_spread(scan.rows),
            columns=_spread(scan.columns),
        )
    scanned = geometry.trace(setup, directions=directions)
    echo = lock_in.target_light(setup, scanned, model=model)
    column = lock_in.water_light(setup, scanned.view, end=scanned.depth, model=model)
    samples = lock_in.sample(setup, echo, column, rng=np.random.default_rng(0))
    noise = np.sqrt((samples.in_phase_variance + samples.quadrature_variance) / 2)
    size = np.abs(lock_in.expected_signal(setup, echo))
    behind = np.abs(lock_in.expected_signal(setup, column))
    met = scanned.target >= 0
    number = range(len(survey.targets))
    return Expectation(
        hit=float(met.mean()),
        hit_each=tuple(float((scanned.target == index).mean()) for index in number),
        saturated=float((samples.saturated != 0).mean()),
        signal_to_noise=_median(size / noise, met),
        water_to_echo=_median(
            np.divide(behind, size, out=np.full(size.shape, np.inf), where=size > 0),
            met,
        ),
    )


def _spread(count: int) -> NDArray[np.intp]:
    """Return evenly spaced rows or columns, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, _BEAMS).round().astype(np.intp))


def _median(values: Floats, met: NDArray[np.bool_]) -> Floats:
    """Return the median over the beams that hit a target; NaN if none does."""
    if not met.any():
        return np.full(values.shape[:2], np.nan)
    return np.asarray(np.median(values[:, :, met], axis=-1))
