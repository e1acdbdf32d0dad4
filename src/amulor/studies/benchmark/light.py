"""Light of the benchmark scenes by photon transport, kept in a table.

`python -m amulor.studies.benchmark.light` computes the table again. It takes about half
an hour on two cores. A scene reads the table only.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics import rays, small_angle
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import petzold
from amulor.transport import (
    ErrorGoal,
    GaussianReceiver,
    Medium,
    PlaneTarget,
    Source,
    Tally,
    simulate,
)

Complex = NDArray[np.complex128]

TABLE = Path(__file__).with_name("light.npz")
#: Receiver of all tables: distance beside the laser [m], direction [rad], aperture
#: radius [m], acceptance angle [rad].
BASELINE, AZIMUTH, RADIUS, ACCEPTANCE = 0.2, np.radians(-4.0), 0.02, 0.08
GROUP_INDEX = 1.38
REFLECTANCE = 0.1
#: Glossy surfaces of the tables: part of the light that mirroring facets reflect, rms
#: slope of the facets [1].
GLOSS, SLOPE = 0.04, 0.1
#: Sets of modulation frequencies by name [Hz].
FREQUENCIES: dict[str, tuple[float, ...]] = {
    "one": (50e6,),
    "two": (20e6, 80e6),
    "four": (10e6, 35e6, 80e6, 146e6),
    "sixteen": tuple(5e6 + 9.4e6 * k for k in range(16)),
    "sweep": tuple(100e6 + 30e6 * k for k in range(31)),
}
#: Frequencies of the table, 0 for the mean light [Hz].
ALL = np.unique([0.0, *(f for some in FREQUENCIES.values() for f in some)])
#: Distances of a plate in the table, relative to that of the scene [m], ...
_NODES = np.array([-0.12, 0.0, 0.10])
#: ... and in the scenes, interpolated.
OFFSETS = np.array([-0.12, 0.0, 0.01, 0.03, 0.06, 0.10, 0.12])
#: Relative error at which a run stops [1], and its longest time [s].
_ERROR, _TIME, _HISTORIES = 1e-3, 30.0, 20_000_000


#: Largest error of photon transport of open water [1], and highest frequency [Hz], for
#: which a scene takes it.
_PRECISE, _HIGHEST = 2e-3, 150e6


@dataclass(frozen=True, kw_only=True)
class TableWater:
    """Water of a table: coefficients, phase function, distances of the scenes."""

    absorption: float
    """Absorption coefficient a [1/m]."""
    scattering: float
    """Scattering coefficient b [1/m]."""
    phase_function: Callable[[], PhaseFunction]
    """Function that returns the phase function."""
    distances: tuple[float, ...]
    """Distances of the scenes [m]."""
    stated: dict[str, Any]
    """Fields of the survey that state the phase function, or its asymmetry."""
    glossy: tuple[float, ...] = ()
    """Distances of the scenes with glossy surfaces [m]."""


#: Waters of Petzold 1972 with their coefficients, and milk of two concentrations.
WATERS: dict[str, TableWater] = {
    "clear": TableWater(
        absorption=0.114,
        scattering=0.037,
        phase_function=lambda: petzold("AUTEC 8"),
        stated={"asymmetry": 0.871},
        distances=(6.6,),
    ),
    "coastal": TableWater(
        absorption=0.179,
        scattering=0.219,
        phase_function=lambda: petzold("HAOCE 11"),
        stated={"asymmetry": 0.947},
        distances=(2.5, 5.0),
        glossy=(2.5,),
    ),
    "harbour": TableWater(
        absorption=0.366,
        scattering=1.824,
        phase_function=lambda: petzold("NUC 2040"),
        stated={"phase_function": {"kind": "petzold", "station": "NUC 2040"}},
        distances=(0.91, 1.37, 2.28, 3.2, 4.1),
        glossy=(2.28,),
    ),
    "milk": TableWater(
        absorption=0.05,
        scattering=0.8,
        phase_function=lambda: henyey_greenstein_function(asymmetry=0.9),
        stated={"asymmetry": 0.9},
        distances=(1.5,),
    ),
    "strong milk": TableWater(
        absorption=0.05,
        scattering=2.65,
        phase_function=lambda: henyey_greenstein_function(asymmetry=0.9),
        stated={"asymmetry": 0.9},
        distances=(1.5,),
    ),
}


@dataclass(frozen=True, kw_only=True)
class Light:
    """Ratio of received to launched light at the frequencies `ALL`."""

    open_water: Complex
    """Open-water signal, shape (frequencies,) [1]."""
    water: Complex
    """Water signal in front of a plate, shape (frequencies, offsets) [1]."""
    echo: Complex
    """Echo of a plate of `REFLECTANCE`, shape (frequencies, offsets) [1]."""
    error: NDArray[np.float64]
    """Relative errors by photon statistics: open water, water, echo, at 0 Hz [1]."""


def compute(water: TableWater, distance: float, *, error: float = _ERROR) -> Light:
    """Compute the light of a scene by photon transport, at the nodes of the table."""
    plates = _plates(distance, reflectance=REFLECTANCE)
    empty, *tallies = _tallies(water, [None, *plates], error=error)
    return Light(
        open_water=empty.signal,
        water=np.array([tally.water_signal for tally in tallies]).T,
        echo=np.array([tally.target_signal for tally in tallies]).T,
        error=np.array(
            [
                float(empty.relative_error[0]),
                max(float(t.relative_error_of("water")[0]) for t in tallies),
                max(float(t.relative_error_of("target")[0]) for t in tallies),
            ]
        ),
    )


def compute_facets(
    water: TableWater, distance: float, *, error: float = _ERROR
) -> Complex:
    """Compute the echo of mirroring facets alone, shape (frequencies, nodes) [1]."""
    plates = _plates(distance, reflectance=0.0, gloss=GLOSS, rms_slope=SLOPE)
    tallies = _tallies(water, plates, error=error)
    return np.array([tally.target_signal for tally in tallies]).T


def _plates(distance: float, **surface: float) -> list[PlaneTarget]:
    """Return plates at the nodes of the table."""
    return [PlaneTarget(position=(0, 0, distance + step), **surface) for step in _NODES]


def _tallies(
    water: TableWater, targets: Sequence[PlaneTarget | None], *, error: float
) -> list[Tally]:
    """Simulate the light of each target; of the open water where there is none."""
    receiver = GaussianReceiver(
        position=np.array([BASELINE, 0.0, 0.0]),
        direction=rays.direction(AZIMUTH, 0.0),
        radius=RADIUS,
        acceptance_angle=ACCEPTANCE,
    )
    medium = Medium.homogeneous(
        absorption=water.absorption,
        scattering=water.scattering,
        phase_function=water.phase_function(),
        group_index=GROUP_INDEX,
    )
    return [
        simulate(
            medium,
            Source(),
            receiver,
            ALL,
            histories=_HISTORIES,
            seed=1,
            target=target,
            relative_error=ErrorGoal(
                relative_error=error, light="water" if target is None else "target"
            ),
            longest_time=_TIME,
        )
        for target in targets
    ]


def key(water: str, distance: float) -> str:
    """Return the name of a scene's light in the table, such as "harbour 2.28 m"."""
    return f"{water} {distance:g} m"


@lru_cache(maxsize=1)
def _table() -> dict[str, NDArray[np.generic]]:
    with np.load(TABLE) as file:
        return dict(file)


@lru_cache(maxsize=4)
def read(water: str, distance: float, *, highest: float) -> Light:
    """Return the light of a scene at `OFFSETS`, for frequencies up to the highest [Hz].

    The echo is that of photon transport. So is the open water, where its photon noise
    is small. Otherwise it is that of the small-angle form, scaled to the mean light of
    photon transport. Photon noise of two runs would differ between scan and open water.
    So the water behind the plate is always that of the form. The transport of the water
    in front of a plate is a check of it.
    """
    table, name = _table(), key(water, distance)
    open_water, echo, error = (
        np.asarray(table[f"{name} {part}"]) for part in ("open_water", "echo", "error")
    )
    form = _form(water, distance) * open_water[0].real
    if error[0] > _PRECISE or highest > _HIGHEST:
        open_water = form[:, -1]
    return Light(
        open_water=open_water,
        water=open_water[:, None] - form[:, -1:] + form[:, :-1],
        echo=_between(echo, distance),
        error=error,
    )


@lru_cache(maxsize=4)
def read_facets(water: str, distance: float) -> Complex:
    """Return the echo of mirroring facets alone at `OFFSETS`."""
    return _between(np.asarray(_table()[f"{key(water, distance)} facets"]), distance)


def _form(water: str, distance: float) -> Complex:
    """Return the small-angle form of the water before distances, and of open water.

    Its shape is (frequencies, offsets and infinity), relative to the mean open water.
    """
    described = WATERS[water]
    column = small_angle.water_response(
        ALL[:, None],
        absorption=described.absorption,
        scattering=described.scattering,
        phase_function=described.phase_function(),
        split_angle=np.pi / 2,
        group_index=GROUP_INDEX,
        baseline=BASELINE,
        receiver_radius=RADIUS,
        acceptance_angle=ACCEPTANCE,
        tilt=-AZIMUTH,
        end=np.append(distance + OFFSETS, np.inf),
    )
    return np.asarray(column / column[0, -1].real)


def _between(values: Complex, distance: float) -> Complex:
    """Interpolate echoes at the nodes by parabolas of logarithm and delay."""

    def turn(offset: NDArray[np.float64]) -> Complex:
        place = distance + offset
        path = GROUP_INDEX * (place + np.hypot(place, BASELINE))
        return np.asarray(np.exp(2j * np.pi * ALL[:, None] * path / speed_of_light))

    smooth = np.log(values / turn(_NODES))
    # Logarithms have phases modulo one turn.
    smooth.imag = np.unwrap(smooth.imag, axis=1)
    return np.asarray(np.exp(smooth @ lagrange(OFFSETS)) * turn(OFFSETS))


def lagrange(offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return weights of the nodes in a parabola, shape (nodes, offsets) [1]."""
    weights = np.ones((_NODES.size, offset.size))
    for k, node in enumerate(_NODES):
        for other in np.delete(_NODES, k):
            weights[k] *= (offset - other) / (node - other)
    return weights


def digest(water: str, distance: float, *, glossy: bool) -> str:
    """Return the first digits of the SHA-256 digest of a scene's light."""
    table, content = _table(), hashlib.sha256()
    for part in ("open_water", "echo", *(("facets",) if glossy else ())):
        content.update(table[f"{key(water, distance)} {part}"].tobytes())
    return content.hexdigest()[:12]


def main() -> None:
    """Compute what the table lacks, and write it after each distance."""
    table = dict(_table()) if TABLE.exists() else {}
    for name, water in WATERS.items():
        for distance in water.distances:
            label = key(name, distance)
            if f"{label} echo" not in table:
                light = compute(water, distance)
                table |= {f"{label} {part}": v for part, v in vars(light).items()}
                print(label, light.error, flush=True)
            if distance in water.glossy and f"{label} facets" not in table:
                table[f"{label} facets"] = compute_facets(water, distance)
            np.savez_compressed(TABLE, **table)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
