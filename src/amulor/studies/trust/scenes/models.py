"""Scenes simulated by forward models: various scans, targets and waters."""

from __future__ import annotations

import functools

import numpy as np
import xarray as xr

from amulor.simulation import PhotonModel, simulate
from amulor.simulation.models import (
    DEFAULT_MODEL,
    DiffusionModel,
    SignalModel,
    SmallAngleModel,
)
from amulor.studies.trust.case import Case, case_of
from amulor.studies.trust.surveys import corner, plate, stairs, survey


def around(distance: float) -> tuple[float, float]:
    """Return the interval within 0.9 m of a distance, but not below 0.3 m [m]."""
    return max(0.3, distance - 0.9), distance + 0.9


def flat(count: int, seed: int) -> Case:
    """Simulate a plate at 2.6 m, tilted by 20 degrees, with a correct survey."""
    planned = survey(count, plate(2.6, lean=20))
    return case_of(simulate(planned, rng=seed), interval=around(2.6))


def sloped(count: int, seed: int, *, lean: float) -> Case:
    """Simulate a plate at 2.6 m, tilted by `lean` degrees."""
    planned = survey(count, plate(2.6, lean=lean, size=3))
    return case_of(simulate(planned, rng=seed), interval=around(2.6))


def dark(count: int, seed: int) -> Case:
    """Simulate a plate at 2.6 m with a reflectance of 1 %."""
    planned = survey(count, plate(2.6, lean=20, reflectance=0.01))
    return case_of(simulate(planned, rng=seed), interval=around(2.6))


def far(count: int, seed: int) -> Case:
    """Simulate a plate beyond the ambiguity interval, without stated range limits."""
    planned = survey(count, plate(3.0, lean=10))
    return case_of(simulate(planned, rng=seed), interval=None)


def far_two(count: int, seed: int) -> Case:
    """Simulate a plate at 6.2 m, beyond the ambiguity interval of 20 and 80 MHz."""
    planned = survey(
        count,
        plate(6.2, lean=10, reflectance=0.3, size=4),
        water={
            "absorption": 0.06,
            "scattering": 0.05,
            "forward_fraction": 0.9,
            "second_moment": 0.03,
            "phase_function_at_180": 0.003,
        },
        azimuth=-1.8,
    )
    return case_of(simulate(planned, rng=seed), interval=None)


def tall(count: int, seed: int) -> Case:
    """Simulate a plate scanned over 9 x 19 degrees; 9 x 3 open-water references."""
    planned = survey(
        count,
        plate(2.6, size=0.8, reflectance=0.3),
        frequencies=(10e6, 50e6) if count == 2 else None,
        wide=9,
        tall=19,
        columns=16,
        rows=32,
    )
    return case_of(simulate(planned, rng=seed), interval=around(2.6))


def wide(count: int, seed: int, *, model: SignalModel = DEFAULT_MODEL) -> Case:
    """Simulate a plate scanned over 19 x 4 degrees; 9 x 3 open-water references."""
    planned = survey(count, plate(2.6, reflectance=0.2), wide=19, tall=4)
    return case_of(simulate(planned, rng=seed, model=model), interval=around(2.6))


def wide_photons(count: int, seed: int) -> Case:
    """Simulate the plate of scene `wide`, with light from photon transport."""
    return wide(count, seed, model=PhotonModel(relative_error=0.01))


def staircase(count: int, seed: int) -> Case:
    """Simulate a staircase with a reflectance of 3 % in the water of the test tank."""
    planned = survey(count, stairs(2.4, reflectance=0.03))
    return case_of(simulate(planned, rng=seed), interval=around(2.4))


def inside_corner(count: int, seed: int) -> Case:
    """Simulate an inside corner at 2.6 m whose walls of 40 % illuminate each other."""
    walls = corner(2.6, reflectance=0.4, right=-0.03)
    planned = survey(count, *walls, wide=8, tall=6).with_(
        {"scan.second_reflection": True}
    )
    return case_of(simulate(planned, rng=seed), interval=around(2.5))


def coastal(count: int, seed: int) -> Case:
    """Simulate a plate in Petzold's coastal water, at 1.4 attenuation lengths."""
    planned = survey(count, plate(3.5, lean=15), water="coastal", azimuth=-3.3)
    return case_of(simulate(planned, rng=seed), interval=around(3.5))


def harbour(count: int, seed: int) -> Case:
    """Simulate a plate in Petzold's harbor water, at 3.3 attenuation lengths."""
    planned = survey(count, plate(1.5, lean=15), water="harbour", azimuth=-7)
    return case_of(simulate(planned, rng=seed), interval=around(1.5))


def circular(count: int, seed: int) -> Case:
    """Simulate a plate in tank water, measured with circular polarization."""
    planned = survey(count, plate(2.6, lean=20), pairs=("RR", "RL"))
    return case_of(simulate(planned, rng=seed), interval=around(2.6))


def moving(count: int, seed: int) -> Case:
    """Simulate a sloping sea bed below a line scanner on a vehicle that rolls."""
    bed = plate(2.6, lean=15, size=4)
    planned = survey(count, bed, wide=19, tall=0, rows=20, columns=20)
    course = {"kind": "line", "start": [0, -0.1, -5], "heading": 0, "speed": 0.2}
    planned = planned.with_(
        {
            "instrument.modulation_depth": 0.8 / count,
            "scan.moves": "both",
            "scan.dwell": 2.5e-3,
            "instrument.lock_in.time_constant": 2e-4,
            "pose": {"position": [0, 0, -5], "heading": 0, "pitch": -np.pi / 2},
            "platform": {
                "readings": "at-once",
                "course": course,
                "disturbance": {"position": 5e-3, "roll": 0.02, "period": 3},
                "navigation": {"position_uncertainty": 0.01},
                "mounting": {"pitch": -np.pi / 2},
            },
        }
    )
    return case_of(simulate(planned, rng=seed), interval=around(2.6))


def empty(count: int, seed: int) -> Case:
    """Simulate water without a target, with a correct survey."""
    return case_of(simulate(survey(count), rng=seed), interval=around(2.6))


_SMALL_ANGLE_WATER = {
    "absorption": 0.15,
    "scattering": 0.35,
    "asymmetry": 0.95,
}


def small_angle(count: int, seed: int, *, split: float) -> Case:
    """Simulate a plate by the small-angle model, with the full phase function."""
    samples = _small_angle(count, seed, split, plate(2.6, lean=20))
    return case_of(samples, interval=around(2.6))


def small_angle_empty(count: int, seed: int) -> Case:
    """Simulate water without a target, by the small-angle model."""
    return case_of(_small_angle(count, seed, 90.0), interval=around(2.6))


@functools.lru_cache(maxsize=2)
def _small_angle(count: int, seed: int, split: float, *targets: str) -> xr.Dataset:
    planned = survey(
        count, *targets, water=_SMALL_ANGLE_WATER | {"split_angle": split},
        columns=16, rows=12,
    )  # fmt: skip
    return simulate(planned, rng=seed, model=SmallAngleModel())


def paper_form(count: int, seed: int) -> Case:
    """Simulate a plate by the diffusion model of Ricci et al., at 2.6 m."""
    planned = survey(count, plate(2.6, lean=20))
    cube = simulate(planned, rng=seed, model=DiffusionModel())
    return case_of(cube, interval=around(2.6))


def paper_form_empty(count: int, seed: int) -> Case:
    """Simulate water without a target, by the diffusion model of Ricci et al."""
    cube = simulate(survey(count), rng=seed, model=DiffusionModel())
    return case_of(cube, interval=around(2.6))
