"""Reflectance of the paper's white plate, assuming that milk made the water turbid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from amulor.optics.phase_functions.tables import tabulated
from amulor.studies.ricci2010.scenes.interference_sweeps import (
    EXPERIMENTS,
    FIRST,
    LAST,
    TURBIDITY,
)
from amulor.studies.ricci2010.scenes.milk import ANGLES, milk
from amulor.studies.ricci2010.scenes.water_sweeps import receiver
from amulor.studies.ricci2010.study import Study
from amulor.transport import (
    GaussianReceiver,
    Medium,
    PlaneTarget,
    Source,
    Tally,
    simulate,
)

Complex = NDArray[np.complex128]

#: Frequencies of the mean: water over echo is smooth.
_FREQUENCIES = np.linspace(FIRST, LAST, 12)
#: Paths from the source: little of experiment 2 comes back from the plate.
_HISTORIES = {1: 400_000, 2: 3_200_000, 3: 1_600_000}
#: A quick study takes so many fewer.
_FEWER = 32
#: Parts of the photons that are left out in turn to find the error.
_PARTS = 16


@dataclass(frozen=True)
class Reflectance:
    """Plate reflectance deduced from the paper's ratio of water signal to echo."""

    number: int
    """Number of the experiment."""
    value: float
    """Plate reflectance [1]."""
    error: float
    """Standard error, from photon transport [1]."""


def reflectances(study: Study) -> tuple[Reflectance, ...]:
    """Return the plate reflectance deduced from each experiment for milky water."""
    return tuple(study.once(_OF[number]) for number in EXPERIMENTS)


def _reflectance(study: Study, *, number: int) -> Reflectance:
    spheres, place = study.once(milk), receiver(study)
    tally = simulate(
        Medium.homogeneous(
            absorption=study["milk_absorption"],
            scattering=study[f"attenuation_{TURBIDITY[number]}"]
            - study["milk_absorption"],
            phase_function=tabulated(ANGLES, value=spheres.value, name="milk"),
            group_index=study["index"],
        ),
        Source(),
        GaussianReceiver(
            position=(place["baseline"], 0.0, 0.0),
            radius=place["receiver_radius"],
            acceptance_angle=place["acceptance_angle"],
        ),
        _FREQUENCIES,
        histories=_HISTORIES[number] // (_FEWER if study.quick else 1),
        seed=int(study.rng(f"white plate, experiment {number}").integers(2**31)),
        target=PlaneTarget(
            position=(0.0, 0.0, study[f"distance_{number}"]), reflectance=1.0
        ),
    )
    water, plate = (_batches(tally, name) for name in ("water", "target"))

    def mean(chosen: NDArray[np.bool_]) -> float:
        light, echo = (x[chosen].mean(axis=0) for x in (water, plate))
        ratio = float(np.mean(np.abs(light) / np.abs(echo)))
        return ratio / study[f"mean_ratio_{number}"]

    part = np.arange(water.shape[0]) % _PARTS
    left_out = [mean(part != k) for k in range(_PARTS)]
    return Reflectance(
        number,
        mean(part >= 0),
        math.sqrt((_PARTS - 1) * float(np.var(left_out))),
    )


def _batches(tally: Tally, name: str) -> Complex:
    """Return the light of tally parts selected by name, (batches, frequencies)."""
    chosen = [k for k, part in enumerate(tally.parts) if part.startswith(name)]
    light: Complex = tally.batches[:, chosen, 0].sum(axis=1)
    return light


# The study remembers results by function, so each experiment has its own.
_OF = {number: partial(_reflectance, number=number) for number in EXPERIMENTS}
