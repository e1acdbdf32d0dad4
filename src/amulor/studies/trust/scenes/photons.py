"""Scenes with light from photon transport, all scattering orders included."""

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
#: Phase functions of the water, with a = 0.15 and b = 0.35 1/m by default.
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
    """Ratio of received to launched light from water and plate, by photon transport."""

    open_water: Complex
    """Open-water signal, shape (frequencies of `_ALL`,)."""
    water: Complex
    """Water signal in front of the plate, shape (frequencies, distances)."""
    echo: Complex
    """Echo of the plate, shape (frequencies, distances)."""


@functools.lru_cache(maxsize=8)
def photons(
    name: str, histories: int, reflectance: float, turbidity: float = 1.0
) -> Photons:
    """Simulate echo and water signal for plates at a series of distances."""
    planned = _survey(1, reflectance=0.1, turbidity=turbidity)
    view, water = planned.instrument.receiver, water_properties(planned)
    receiver = GaussianReceiver(
        position=np.array(view.position),
        direction=rays.direction(view.azimuth, view.elevation),
        radius=view.radius,
        acceptance_angle=view.acceptance,
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
    """Simulate plates at eight distances in a fixed beam, by photon transport."""
    planned = _survey(count, reflectance=reflectance, turbidity=turbidity)
    light = photons(function, histories, reflectance, turbidity)
    frequency = np.array(planned.instrument.modulation_frequencies)
    # Frequencies that went through a text differ in the last bit.
    chosen = np.abs(_ALL - frequency[:, None]).argmin(axis=1)
    column = np.repeat(_ORDER, _COLUMNS_EACH)
    shape = (planned.scan.rows, len(column))
    paint = planned.targets[0].mueller
    haze = water_properties(planned).backscatter_mueller
    target = _light(planned, light.echo[:, column], chosen, paint, shape)
    water = _light(planned, light.water[:, column], chosen, haze, shape)
    frame = simulate(planned, rng=seed)
    number = frame.sizes["shot"]
    empty = _light(planned, light.open_water[:, None], chosen, haze, (number,))
    dark = Light(np.zeros_like(empty.modulated), np.zeros_like(empty.mean))
    rng, setup = np.random.default_rng(seed), Setup(planned)
    samples = with_samples(frame, "", lock_in.sample(setup, target, water, rng=rng))
    samples = with_samples(
        samples, "open_water_", lock_in.sample(setup, dark, empty, rng=rng)
    )
    # Out straight ahead, back to the receiver beside the emitter.
    aside = np.linalg.norm(planned.instrument.receiver.position)
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
    planned: Survey,
    response: Complex,
    chosen: NDArray[np.intp],
    scatterer: object,
    shape: tuple[int, ...],
) -> Light:
    """Return light behind the analyzers, shape (frequency, channel, ..., column)."""
    passed = [
        float(mueller.detected_fraction(matrix(scatterer), pair=pair))
        for pair in planned.instrument.polarizations
    ]
    fractions = np.array(passed).reshape(1, -1, *[1] * len(shape))
    columns = response.reshape(len(response), 1, *[1] * (len(shape) - 1), -1)
    size = (len(chosen), len(passed), *shape)
    return Light(
        np.broadcast_to(columns[chosen] * fractions, size).copy(),
        np.broadcast_to(np.maximum(columns[:1].real, 0.0) * fractions, size).copy(),
    )


def with_samples(cube: xr.Dataset, prefix: str, samples: lock_in.Samples) -> xr.Dataset:
    """Return a cube with replaced lock-in outputs and stated errors."""
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
