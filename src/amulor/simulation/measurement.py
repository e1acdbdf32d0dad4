"""Simulation of a survey: the measurement cube that its instrument would record."""

from __future__ import annotations

import numbers
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube
from amulor._progress import part, tell
from amulor.cube import tiles
from amulor.errors import SurveyError
from amulor.simulation import geometry as geometry_of
from amulor.simulation import lock_in
from amulor.simulation.gradient import with_gradient
from amulor.simulation.instrument_errors import Chain
from amulor.simulation.models import DEFAULT_MODEL, FittedModel, SignalModel
from amulor.simulation.standing_reference import ReferenceReadings
from amulor.simulation.texture_blur import has_texture
from amulor.simulation.vehicle import VehicleMotion
from amulor.survey import Survey
from amulor.survey.counting import photon_noise_volt
from amulor.survey.directions import (
    Floats,
    open_water_directions,
    reading_windows,
    readings_in_turn,
    refuse_scans_beyond_memory,
    scan_directions,
)
from amulor.survey.view import geometry_attributes
from amulor.survey.view import view as view_of


def simulate(
    survey: Survey,
    *,
    rng: np.random.Generator | int,
    model: SignalModel = DEFAULT_MODEL,
) -> xr.Dataset:
    """Simulate the scan and the open-water references of a survey.

    Parameters
    ----------
    survey : Survey
        Water, targets, instrument and scan.
    rng : numpy.random.Generator or int
        Random generator of the noise, or a seed, which is stored in the cube.
    model : SignalModel
        Forward model of target and water light: `SmallAngleModel()` with the whole
        phase function (default), its fast approximation `ClosureModel()`, the paper's
        `DiffusionModel()`, or a `PhotonModel` with photon transport.

    Returns
    -------
    xarray.Dataset
        Cube of level `samples`, with the groups `open_water` (if planned) and `truth`.

    Raises
    ------
    SurveyError
        If the water's indices cannot be computed, a mesh cannot be read, or the survey
        lacks a property of the water that the model needs.
    MissingExtraError
        If there are targets and the extra `scene` is not installed.

    Notes
    -----
    Target and water signal use the same model, eq. (43) or (29) of Ricci et al. 2010.
    The water column ends at the target. Reflections at a window are neglected.

    Examples
    --------
    >>> from amulor import Survey, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...         "scan.azimuth_span": "2 deg",
    ...         "scan.elevation_span": "1 deg",
    ...     }
    ... )
    >>> cube = simulation.simulate(survey, rng=1, model=simulation.ClosureModel())
    >>> print(cube["truth_slant_range"].values.round(4))  # 1.5 m over the cosines
    [[1.5003 1.5001 1.5003]
     [1.5003 1.5001 1.5003]]
    """
    refuse_scans_beyond_memory(survey)
    generator = np.random.default_rng(rng)
    setting = Setting.of(survey, rng=rng, model=model)
    samples, truth = measured(
        setting, scan_directions(survey), model=fit(setting), noise=generator
    )
    tell("open-water shots", 0.8)
    return joined(samples, open_water(setting, rng=generator), truth)


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Inputs of a simulation, common to all rows of the scan."""

    setup: geometry_of.Setup
    """Instrument, water and targets."""
    model: SignalModel
    """Forward model."""
    seed: int | None
    """Seed of the noise, if given."""
    chain: Chain | None
    """Signal chain with instrument errors, if any are in the survey."""
    reference: ReferenceReadings | None
    """Readings of the standing reference, if the survey has one."""
    light_setup: geometry_of.Setup
    """Setup at the frequencies of the computed light."""
    geometry: dict[str, Any]
    """Positions and indices of the instrument, as cube attributes."""
    attributes: dict[str, Any]
    """Attributes of the cube."""

    @classmethod
    def of(
        cls, survey: Survey, *, rng: np.random.Generator | int, model: SignalModel
    ) -> Setting:
        """Return the inputs for the simulation of a survey; see `simulate`."""
        model = with_gradient(model, survey)
        moves = survey.platform is not None
        motion = VehicleMotion.of(survey, rng) if moves else None
        setup = geometry_of.Setup(survey, motion)
        chain = Chain.of(setup, rng)
        seed = int(rng) if isinstance(rng, numbers.Integral) else None
        text = survey.to_toml()
        if chain is not None and moves:
            _refuse_harmonics_in_turn(setup, chain)
        reference = ReferenceReadings.of(survey, chain, rng)
        return cls(
            setup=setup,
            chain=chain,
            reference=reference,
            light_setup=setup if chain is None else chain.light_setup,
            model=model,
            seed=seed,
            geometry=geometry_attributes(survey),
            attributes=cube.attributes(
                "samples",
                title=survey.name,
                source=f"simulation by amulor, {model.title}",
                simulated=np.int32(1),
                late_echo=model.late_echo,
                corner_light=_presence(survey.scan.second_reflection),
                surroundings_light=_presence(bool(has_texture(survey).any())),
                seed=seed,
                survey=text,
                input_digests=f"survey {cube.digest(text)}",
                modulation_depth=survey.instrument.modulation_depth,
                photon_noise_volt=photon_noise_volt(survey),
                **({} if reference is None else reference.attributes),
            ),
        )


def _presence(present: bool | None) -> str:
    return "present" if present else "absent"


def fit(setting: Setting) -> SignalModel:
    """Return the forward model, fitted once for the whole scan if it supports a fit.

    The fit uses all pixels of a scan of up to `tiles.SAMPLE` pixels, else as many that
    are spread over the scan from edge to edge.
    """
    survey, model = setting.setup.survey, setting.model
    scan = survey.scan
    if not isinstance(model, FittedModel):
        return model
    is_small = scan.rows * scan.columns <= tiles.SAMPLE
    sample = {} if is_small else _spread(scan.rows, scan.columns)
    geometry = geometry_of.trace(
        setting.setup, directions=scan_directions(survey, **sample)
    )
    end = survey.water.column_end
    farthest = np.inf if end is None else end
    # Later readings of a moving instrument may meet farther targets.
    if is_small and setting.setup.motion is None:
        farthest = min(farthest, float(geometry.depth.max()))
    return lock_in.fitted(
        model,
        setting.light_setup,
        geometry.view,
        end=geometry.depth,
        farthest=farthest,
    )


def _spread(rows: int, columns: int) -> dict[str, NDArray[np.intp]]:
    """Return evenly spaced rows and columns, including the first and the last."""
    high = min(rows, max(int(tiles.SAMPLE**0.5), tiles.SAMPLE // columns))
    wide = min(columns, tiles.SAMPLE // high)
    return {
        "rows": np.linspace(0, rows - 1, high).astype(np.intp),
        "columns": np.linspace(0, columns - 1, wide).astype(np.intp),
    }


def _refuse_harmonics_in_turn(setup: geometry_of.Setup, chain: Chain) -> None:
    """Raise if readings in turn from a vehicle need light at harmonics.

    Light at a harmonic belongs to the reading of its fundamental.
    """
    if chain.errors.harmonic is not None and readings_in_turn(setup.survey) > 1:
        raise SurveyError(
            "instrument.errors.harmonic: is not simulated for readings in turn from a "
            'moving platform; state platform.readings = "at-once", or leave it out'
        )


def _readings(
    setting: Setting, directions: tuple[Floats, Floats, Floats], *, model: SignalModel
) -> tuple[list[geometry_of.Geometry], lock_in.Light, lock_in.Light]:
    """Return geometry and light of all readings, each from where it was taken.

    An instrument that stands still, or reads all frequencies and channels of a pixel at
    once, has one geometry, else one for each frequency and channel.
    """
    survey = setting.setup.survey
    middle, _ = reading_windows(survey)
    if setting.setup.motion is None or readings_in_turn(survey) == 1:
        lag = float(middle[0, 0])
        geometry, target, water = _light(setting, directions, model=model, lag=lag)
        return [geometry], target, water
    geometries: list[geometry_of.Geometry] = []
    parts: list[list[lock_in.Light]] = []
    for place in np.ndindex(middle.shape):
        share = len(parts) / middle.size
        with part(share, share + 1 / middle.size):
            geometry, *light = _light(
                setting, directions, model=model, lag=float(middle[place])
            )
        geometries.append(geometry)
        parts.append([source.reading(*place) for source in light])
    target, water = (
        lock_in.Light.of_readings(lights, middle.shape)
        for lights in zip(*parts, strict=True)
    )
    return geometries, target, water


def _light(
    setting: Setting,
    directions: tuple[Floats, Floats, Floats],
    *,
    model: SignalModel,
    lag: float,
) -> tuple[geometry_of.Geometry, lock_in.Light, lock_in.Light]:
    """Return the geometry of beams, and the light received from targets and water."""
    setup = setting.light_setup
    tell("following the beams to the targets", 0.0)
    geometry = geometry_of.trace(setup, directions=directions, lag=lag)
    tell(f"light of the targets, {model.title}", 0.1)
    with part(0.1, 0.3):
        target = lock_in.target_light(setup, geometry, model=model)
    tell(f"light of the water, {model.title}", 0.3)
    with part(0.3, 0.7):
        column = lock_in.water_light(
            setup, geometry.view, end=geometry.depth, model=model
        )
    return geometry, target, column


def measured(
    setting: Setting,
    directions: tuple[Floats, Floats, Floats],
    *,
    model: SignalModel,
    noise: lock_in.Noise,
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return samples and true values of a range of rows."""
    setup, chain = setting.setup, setting.chain
    instrument = setup.survey.instrument
    azimuth, elevation, time = directions
    if chain is None:
        geometries, target, column = _readings(setting, directions, model=model)
        tell("noise of detector and lock-in", 0.7)
        samples = lock_in.sample(setup, target, column, rng=noise)
    else:
        true = chain.pointed(directions)
        geometries, target, column = _readings(setting, true, model=model)
        tell("noise and errors of the instrument", 0.7)
        samples = chain.scan_samples(target, column, time, azimuth=true[0], rng=noise)
        target, column = chain.fundamental(target), chain.fundamental(column)
    if setting.reference is not None:
        signal = setting.reference.scan(samples.signal, time)
        samples = replace(samples, signal=signal)
    built = cube.build(
        "samples",
        {**_outputs(samples), "saturated": samples.saturated},
        {
            "modulation_frequency": np.array(instrument.modulation_frequencies),
            "polarization": list(instrument.polarizations),
            "azimuth": azimuth,
            "elevation": elevation,
            "time": time,
            **_windows(setup, time),
        },
        geometry=setting.geometry,
        attributes=setting.attributes,
    )
    return built, _truth(setup, geometries, target, column)


def _windows(setup: geometry_of.Setup, time: Floats) -> dict[str, Floats]:
    """Return times and windows of the readings from a vehicle [s]."""
    if setup.motion is None:
        return {}
    middle, length = reading_windows(setup.survey)
    moments = time + middle[:, :, None, None]
    return {
        "reading_time": moments,
        "reading_duration": np.full(moments.shape, length),
    }


def joined(
    samples: xr.Dataset, shots: xr.Dataset | None, truth: xr.Dataset
) -> xr.Dataset:
    """Return samples, open-water references and true values as one cube."""
    if shots is not None:
        samples = cube.attach(samples, shots, "open_water")
    return cube.note(cube.attach(samples, truth, "truth"), "simulate")


def _outputs(samples: lock_in.Samples) -> dict[str, NDArray[Any]]:
    return {
        "in_phase": samples.signal.real,
        "quadrature": samples.signal.imag,
        "in_phase_uncertainty": np.sqrt(samples.in_phase_variance),
        "quadrature_uncertainty": np.sqrt(samples.quadrature_variance),
        "in_phase_quadrature_covariance": samples.covariance,
    }


def open_water(setting: Setting, *, rng: np.random.Generator) -> xr.Dataset | None:
    """Return the open-water references of a scan; None if the survey plans none."""
    survey = setting.setup.survey
    if survey.scan.open_water is None:
        return None
    chain = setting.chain
    azimuth, elevation = open_water_directions(survey)
    if chain is not None:
        azimuth, elevation = chain.shots(azimuth, elevation)
    view = view_of(survey, azimuth, elevation)
    light = lock_in.water_light(setting.light_setup, view, model=setting.model)
    if chain is None:
        dark = lock_in.Light(np.zeros_like(light.modulated), np.zeros_like(light.mean))
        shots = lock_in.sample(setting.setup, dark, light, rng=rng)
    else:
        shots = chain.shot_samples(light, rng=rng)
    if setting.reference is not None:
        shots = replace(shots, signal=setting.reference.shots(shots.signal))
    return cube.open_water(
        {**_outputs(shots), "azimuth": azimuth, "elevation": elevation}
    )


def _truth(
    setup: geometry_of.Setup,
    geometries: list[geometry_of.Geometry],
    target: lock_in.Light,
    water: lock_in.Light,
) -> xr.Dataset:
    sample = ("modulation_frequency", "polarization", "row", "column")
    pixel = ("row", "column")
    echo = lock_in.expected_signal(setup, target)
    column = lock_in.expected_signal(setup, water)
    geometry = geometries[0]
    ranges = np.array(
        [np.where(part.target >= 0, part.slant_range, np.nan) for part in geometries]
    )
    slant_range = ranges[0] if len(ranges) == 1 else ranges.mean(axis=0)

    def volts(values: NDArray[np.float64], name: str) -> xr.Variable:
        return xr.Variable(sample, values, {"long_name": name, "units": "V"})

    return xr.Dataset(
        {
            "slant_range": xr.Variable(
                pixel,
                slant_range,
                {"long_name": "distance from the emitter along the beam", "units": "m"},
            ),
            "target": xr.Variable(
                pixel,
                geometry.target.astype(np.int32),
                {"long_name": "number of the target met, -1 for none", "units": "1"},
            ),
            "target_in_phase": volts(echo.real, "target signal, in phase"),
            "target_quadrature": volts(echo.imag, "target signal, quadrature"),
            "water_in_phase": volts(column.real, "water signal, in phase"),
            "water_quadrature": volts(column.imag, "water signal, quadrature"),
            **_moving_truth(setup, geometries, ranges),
        }
    )


def _moving_truth(
    setup: geometry_of.Setup, geometries: list[geometry_of.Geometry], ranges: Floats
) -> dict[str, xr.Variable]:
    """Return true ranges of readings from a vehicle, and the mean points in the site.

    A pixel has no point if one of its readings meets no target.
    """
    if setup.motion is None:
        return {}
    instrument = setup.survey.instrument
    plane = len(instrument.modulation_frequencies), len(instrument.polarizations)
    shape = (*plane, *ranges.shape[1:])
    # One geometry stands for all readings at once.
    every = np.broadcast_to(ranges, (plane[0] * plane[1], *ranges.shape[1:]))
    mean = np.mean([part.point for part in geometries], axis=0)
    points = setup.motion.in_site(mean)
    names = {"east": "to the east", "north": "to the north", "up": "upwards"}
    return {
        "reading_slant_range": xr.Variable(
            ("modulation_frequency", "polarization", "row", "column"),
            every.reshape(shape),
            {"long_name": "distance along the beam at each reading", "units": "m"},
        ),
        **{
            name: xr.Variable(
                ("row", "column"),
                points[..., axis],
                {"long_name": f"mean position of the readings {words}", "units": "m"},
            )
            for axis, (name, words) in enumerate(names.items())
        },
    }
