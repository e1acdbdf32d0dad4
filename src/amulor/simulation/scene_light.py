"""Noiseless light of a survey in all directions, for simulated devices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.simulation import geometry, lock_in
from amulor.simulation.lock_in import expected_signal
from amulor.simulation.models import DEFAULT_MODEL, SignalModel
from amulor.survey import Survey
from amulor.survey.directions import open_water_directions
from amulor.survey.view import view

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class LightByDirection:
    """Noiseless light in known directions, without the detector's dark counts."""

    azimuth: Floats
    """Direction of each place to the right, shape (place,) [rad]."""
    elevation: Floats
    """Direction of each place upwards, shape (place,) [rad]."""
    target: NDArray[np.complex128]
    """Peak signal of the target, shape (frequency, polarization, place) [V]."""
    water: NDArray[np.complex128]
    """Peak signal of the water, of the same shape [V]."""
    target_rate: Floats
    """Photoelectrons by the target's light, of the same shape [1/s]."""
    water_rate: Floats
    """Photoelectrons by the water's light, of the same shape [1/s]."""


@dataclass(frozen=True)
class SceneLight:
    """Noiseless light of a survey with its targets in the water, and without.

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
    >>> light = simulation.scene_light(survey, model=simulation.ClosureModel())
    >>> type(light).__name__
    'SceneLight'
    """

    with_target: LightByDirection
    """Light in the directions of the scan."""
    open_water: LightByDirection
    """Light in the directions of the open-water shots and of the scan."""


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
        Forward model; the small-angle form with the whole phase function by default.

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
    scanned = geometry.trace(setup)
    with_target = _by_direction(
        setup,
        (scanned.azimuth, scanned.elevation),
        lock_in.target_light(setup, scanned, model=model),
        lock_in.water_light(setup, scanned.view, end=scanned.depth, model=model),
    )
    azimuth, elevation = scanned.azimuth.ravel(), scanned.elevation.ravel()
    if survey.scan.open_water is not None:
        grid = np.unique(np.stack(open_water_directions(survey)), axis=1)
        azimuth = np.concatenate([grid[0], azimuth])
        elevation = np.concatenate([grid[1], elevation])
    shots = view(survey, azimuth, elevation)
    light = lock_in.water_light(setup, shots, model=model)
    none = lock_in.Light(np.zeros_like(light.modulated), np.zeros_like(light.mean))
    return SceneLight(
        with_target, _by_direction(setup, (azimuth, elevation), none, light)
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
