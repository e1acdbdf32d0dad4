"""From a survey to the measurement cube that its instrument would record."""

from __future__ import annotations

import numbers
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube
from amulor._progress import part, tell
from amulor.optics.rays import Medium
from amulor.simulation import geometry as geometry_of
from amulor.simulation import lock_in, signal
from amulor.simulation.models import DEFAULT_MODEL, SignalModel
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.counting import photon_noise_volt
from amulor.survey.directions import open_water_directions
from amulor.survey.view import geometry_attributes
from amulor.survey.view import medium as medium_of
from amulor.survey.view import view as view_of


def simulate(
    survey: Survey,
    *,
    rng: np.random.Generator | int,
    model: SignalModel = DEFAULT_MODEL,
) -> xr.Dataset:
    """Simulate a survey, the open-water shots included.

    Parameters
    ----------
    survey : Survey
        What is measured, and with what.
    rng : numpy.random.Generator or int
        Source of the noise; a whole number is a seed and is written into the cube.
    model : SignalModel
        Forward model of target and water light: `SmallAngleModel()` with the whole
        phase function, its fast `ClosureModel()`, `DiffusionModel()`, the form of
        the paper, or a `PhotonModel`, which follows photons.

    Returns
    -------
    xarray.Dataset
        Cube of level `samples`, with the groups `open_water` (if planned) and `truth`.

    Raises
    ------
    SurveyError
        If the water's indices cannot be computed, a mesh cannot be read, or the model
        needs more of the water than the survey says.
    MissingExtraError
        If there are targets and the extra `scene` is not installed.

    Notes
    -----
    Target and water signal share the kernel (43) or (29) of Ricci et al. 2010, as
    rebuilt; the column ends at the target. Reflections at a window are left out.

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
    seed = int(rng) if isinstance(rng, numbers.Integral) else None
    generator = np.random.default_rng(rng)
    water = water_properties(survey)
    tell("following the beams to the targets", 0.0)
    geometry = geometry_of.trace(survey, water)
    tell(f"light of the targets, {model.title}", 0.1)
    with part(0.1, 0.3):
        target = signal.target_light(survey, water, geometry, model=model)
    tell(f"light of the water, {model.title}", 0.3)
    with part(0.3, 0.7):
        column = signal.water_light(
            survey, water, geometry.view, end=geometry.depth, model=model
        )
    tell("noise of detector and lock-in", 0.7)
    samples = lock_in.sample(survey, target, column, rng=generator)
    medium = medium_of(survey, water)
    measured = cube.build(
        "samples",
        {**_outputs(samples), "saturated": samples.saturated},
        {
            "modulation_frequency": np.array(survey.instrument.modulation_frequencies),
            "polarization": list(survey.instrument.polarizations),
            "azimuth": geometry.azimuth,
            "elevation": geometry.elevation,
            "time": geometry.time,
        },
        geometry=geometry_attributes(survey, medium),
        attributes=cube.attributes(
            "samples",
            title=survey.name,
            source=f"simulation by amulor, {model.title}",
            simulated=np.int32(1),
            late_echo=model.late_echo,
            seed=seed,
            survey=survey.to_toml(),
            input_digests=f"survey {cube.digest(survey.to_toml())}",
            modulation_depth=survey.instrument.modulation_depth,
            photon_noise_volt=photon_noise_volt(survey),
        ),
    )
    if survey.scan.open_water is not None:
        tell("open-water shots", 0.8)
        measured = cube.attach(
            measured, _open_water(survey, water, medium, generator, model), "open_water"
        )
    truth = _truth(survey, geometry, target, column)
    return cube.note(cube.attach(measured, truth, "truth"), "simulate")


def _outputs(samples: lock_in.Samples) -> dict[str, NDArray[Any]]:
    return {
        "in_phase": samples.signal.real,
        "quadrature": samples.signal.imag,
        "in_phase_uncertainty": np.sqrt(samples.in_phase_variance),
        "quadrature_uncertainty": np.sqrt(samples.quadrature_variance),
        "in_phase_quadrature_covariance": samples.covariance,
    }


def _open_water(
    survey: Survey,
    water: WaterProperties,
    medium: Medium,
    rng: np.random.Generator,
    model: SignalModel,
) -> xr.Dataset:
    azimuth, elevation = open_water_directions(survey)
    view = view_of(survey, azimuth, elevation, medium=medium)
    light = signal.water_light(survey, water, view, model=model)
    dark = signal.Light(np.zeros_like(light.modulated), np.zeros_like(light.mean))
    shots = lock_in.sample(survey, dark, light, rng=rng)
    return cube.open_water(
        {**_outputs(shots), "azimuth": azimuth, "elevation": elevation}
    )


def _truth(
    survey: Survey,
    geometry: geometry_of.Geometry,
    target: signal.Light,
    water: signal.Light,
) -> xr.Dataset:
    sample = ("modulation_frequency", "polarization", "row", "column")
    pixel = ("row", "column")
    echo = lock_in.expected_signal(survey, target)
    column = lock_in.expected_signal(survey, water)
    met = geometry.target >= 0
    slant_range = np.where(met, geometry.slant_range, np.nan)

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
        }
    )
