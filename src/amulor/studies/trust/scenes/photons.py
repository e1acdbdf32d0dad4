"""Scenes whose light was followed photon by photon: all orders of scattering."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.optics import rays
from amulor.optics.phase_functions.models import fournier_forand, two_term
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import petzold
from amulor.optics.polarization import mueller
from amulor.simulation import lock_in, simulate
from amulor.simulation.geometry import Setup
from amulor.simulation.lock_in import Light
from amulor.studies.trust.case import Case, Floats, case_of, lateness
from amulor.studies.trust.surveys import FREQUENCIES, plate, scaled, survey
from amulor.survey import Survey, water_properties
from amulor.survey.mueller import matrix
from amulor.transport import GaussianReceiver, Medium, PlaneTarget, Source
from amulor.transport import simulate as follow_photons

Complex = NDArray[np.complex128]

#: Distances of the plate, three columns of the scan for each [m].
DISTANCES = np.array([1.6, 1.8, 2.0, 2.2, 2.5, 2.8, 3.0, 3.2])
#: Phase functions of the water, a = 0.15 and b = 0.35 1/m where nothing else is said.
PHASE_FUNCTIONS: dict[str, Callable[[], PhaseFunction]] = {
    "petzold": lambda: petzold("HAOCE 11"),
    "fournier-forand": lambda: fournier_forand(relative_index=1.1, slope=3.5835),
    "two-term": lambda: two_term(
        forward_asymmetry=0.9, backward_asymmetry=-0.4, forward_weight=0.97
    ),
}
#: All frequencies that the scenes take, 0 for the mean light [Hz].
_ALL = np.unique([0.0, *(f for listed in FREQUENCIES.values() for f in listed)])
_COLUMNS_EACH = 3
#: Near and far in turn, so that no plate looks like the edge between its neighbours.
_ORDER = np.array([0, 7, 1, 6, 2, 5, 3, 4])


@dataclass(frozen=True, kw_only=True)
class Photons:
    """Received per launched light."""

    open_water: Complex
    """Shape (frequencies of `_ALL`,)."""
    water: Complex
    """Up to the plate, shape (frequencies, distances)."""
    echo: Complex
    """Of the plate, shape (frequencies, distances)."""


@functools.lru_cache(maxsize=8)
def photons(
    name: str, histories: int, reflectance: float, turbidity: float = 1.0
) -> Photons:
    """Return echo and water signal against the distance of a plate."""
    made = _survey(1, reflectance=0.1, turbidity=turbidity)
    seen, water = made.instrument.receiver, water_properties(made)
    receiver = GaussianReceiver(
        position=np.array(seen.position),
        direction=rays.direction(seen.azimuth, seen.elevation),
        radius=seen.radius,
        acceptance_angle=seen.acceptance,
    )
    medium = Medium.homogeneous(
        absorption=water.absorption,
        scattering=water.scattering,
        phase_function=PHASE_FUNCTIONS[name](),
        group_index=1.38,
    )
    empty = follow_photons(
        medium, Source(), receiver, _ALL, histories=4 * histories, seed=99
    )
    tallies = [
        follow_photons(
            medium,
            Source(),
            receiver,
            _ALL,
            histories=histories,
            seed=10 * k + 1,
            target=PlaneTarget(position=(0, 0, distance), reflectance=reflectance),
        )
        for k, distance in enumerate(DISTANCES)
    ]
    return Photons(
        open_water=empty.signal,
        water=np.array([tally.water_signal for tally in tallies]).T,
        echo=np.array([tally.target_signal for tally in tallies]).T,
    )


def photon_water(
    count: int,
    seed: int,
    *,
    function: str,
    reflectance: float = 0.1,
    turbidity: float = 1.0,
    histories: int = 400_000,
) -> Case:
    """Return plates at eight distances under a fixed beam, in water made of photons."""
    made = _survey(count, reflectance=reflectance, turbidity=turbidity)
    light = photons(function, histories, reflectance, turbidity)
    frequency = np.array(made.instrument.modulation_frequencies)
    # Frequencies that went through a text differ in the last bit.
    chosen = np.abs(_ALL - frequency[:, None]).argmin(axis=1)
    column = np.repeat(_ORDER, _COLUMNS_EACH)
    shape = (made.scan.rows, len(column))
    paint = made.targets[0].mueller
    haze = water_properties(made).backscatter_mueller
    target = _light(made, light.echo[:, column], chosen, paint, shape)
    water = _light(made, light.water[:, column], chosen, haze, shape)
    frame = simulate(made, rng=seed)
    number = frame.sizes["shot"]
    empty = _light(made, light.open_water[:, None], chosen, haze, (number,))
    dark = Light(np.zeros_like(empty.modulated), np.zeros_like(empty.mean))
    rng, setup = np.random.default_rng(seed), Setup(made)
    samples = _with_samples(frame, "", lock_in.sample(setup, target, water, rng=rng))
    samples = _with_samples(
        samples, "open_water_", lock_in.sample(setup, dark, empty, rng=rng)
    )
    # Out straight ahead, back to the receiver beside the emitter.
    aside = np.linalg.norm(made.instrument.receiver.position)
    path = 1.38 * (DISTANCES + np.hypot(DISTANCES, aside))
    late = lateness(
        light.echo[chosen],
        path,
        modulation_frequency=frequency,
        group_index=1.38,
    )
    wide = np.ones((shape[0], 1))
    return case_of(
        cubes.note(samples, "light from photon transport").assign_attrs(
            late_echo="present"
        ),
        interval=(1.2, 3.3),
        surfaces=(wide * DISTANCES[column])[None],
        late=wide * late[column],
    )


def _survey(count: int, *, reflectance: float, turbidity: float) -> Survey:
    return survey(
        count,
        plate(2.5, reflectance=reflectance),
        water=scaled("tank", turbidity),
        wide=0,
        tall=0,
        shot_columns=1,
        shot_rows=1,
        repeats=60,
        columns=_COLUMNS_EACH * len(DISTANCES),
    )


def _light(
    made: Survey,
    response: Complex,
    chosen: NDArray[np.intp],
    stated: object,
    shape: tuple[int, ...],
) -> Light:
    """Return what the analysers pass of a response, shape (frequencies, columns)."""
    passed = [
        float(mueller.detected_fraction(matrix(stated), pair=pair))
        for pair in made.instrument.polarizations
    ]
    each = np.array(passed).reshape(1, -1, *[1] * len(shape))
    columns = response.reshape(len(response), 1, *[1] * (len(shape) - 1), -1)
    whole = (len(chosen), len(passed), *shape)
    return Light(
        np.broadcast_to(columns[chosen] * each, whole).copy(),
        np.broadcast_to(np.maximum(columns[:1].real, 0.0) * each, whole).copy(),
    )


def _with_samples(
    cube: xr.Dataset, prefix: str, samples: lock_in.Samples
) -> xr.Dataset:
    """Return a cube with other lock-in outputs."""
    values: dict[str, Floats] = {
        "in_phase": samples.signal.real,
        "quadrature": samples.signal.imag,
        "in_phase_uncertainty": np.sqrt(samples.in_phase_variance),
        "quadrature_uncertainty": np.sqrt(samples.quadrature_variance),
        "in_phase_quadrature_covariance": samples.covariance,
    }
    return cube.assign(
        {
            f"{prefix}{name}": cube[f"{prefix}{name}"].copy(data=data)
            for name, data in values.items()
        }
    )
