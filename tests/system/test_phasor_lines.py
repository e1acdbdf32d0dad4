"""Phasor lines on plates whose light comes from photon transport."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr

from amulor import rejection
from amulor.errors import CubeError
from amulor.optics import detection, rays
from amulor.simulation import lock_in, simulate
from amulor.simulation.geometry import Setup
from amulor.simulation.lock_in import Light
from amulor.studies.trust.scenes.photons import PHASE_FUNCTIONS
from amulor.studies.trust.surveys import FREQUENCIES, plate, scaled, survey
from amulor.survey import Survey, water_properties
from amulor.transport import GaussianReceiver, Medium, PlaneTarget, Source
from amulor.transport import simulate as follow_photons

#: Distance of the plate [m], and reflectances of its random pattern.
DISTANCE, BRIGHT, DARK = 2.2, 0.3, 0.1


def planned(count: int, turbidity: float) -> Survey:
    """Return the survey of a fixed beam, 16 x 16 samples of a plate."""
    return survey(
        count,
        plate(DISTANCE, reflectance=BRIGHT),
        water=scaled("tank", turbidity),
        wide=0,
        tall=0,
        shot_columns=1,
        shot_rows=1,
        rows=16,
        columns=16,
        pairs=("VV",),
    )


@functools.cache
def light(function: str, turbidity: float) -> tuple[dict[float, complex], ...]:
    """Return echo and water signal of the bright plate, by frequency."""
    scan = planned(1, turbidity)
    view, water = scan.instrument.receiver, water_properties(scan)
    frequency = np.unique([0.0, *FREQUENCIES[1], *FREQUENCIES[2], *FREQUENCIES[4]])
    tally = follow_photons(
        Medium.homogeneous(
            absorption=water.absorption,
            scattering=water.scattering,
            phase_function=PHASE_FUNCTIONS[function](),
            group_index=1.38,
        ),
        Source(),
        GaussianReceiver(
            position=np.array(view.position),
            direction=rays.direction(view.azimuth, view.elevation),
            radius=view.radius,
            acceptance_angle=view.acceptance,
        ),
        frequency,
        histories=200_000,
        seed=7,
        target=PlaneTarget(position=(0, 0, DISTANCE), reflectance=BRIGHT),
    )
    return tuple(
        dict(zip(frequency, signal, strict=True))
        for signal in (tally.target_signal, tally.water_signal)
    )


@dataclass(frozen=True)
class Scene:
    """Samples of a patterned plate, and the true parts of their signal."""

    samples: xr.Dataset
    target: np.ndarray
    water: np.ndarray


def scene(
    count: int,
    seed: int,
    *,
    function: str = "petzold",
    turbidity: float = 1.0,
    dark: float = DARK,
) -> Scene:
    """Sample a plate of random bright and dark pixels through the simulated lock-in."""
    scan = planned(count, turbidity)
    rng = np.random.default_rng(seed)
    pattern = np.where(rng.random((16, 16)) < 0.5, 1.0, dark / BRIGHT)
    frequency = FREQUENCIES[count]
    parts = []
    for part, shape in zip(
        light(function, turbidity), (pattern, np.ones((16, 16))), strict=True
    ):
        modulated = np.array([part[value] for value in frequency])
        parts.append(
            Light(
                modulated[:, None, None, None] * shape,
                np.full((1, 1, 1, 1), max(part[0.0].real, 0.0)) * shape,
            )
        )
    frame = simulate(scan, rng=seed)
    noisy = lock_in.sample(Setup(scan), *parts, rng=rng)
    clean = [lock_in.expected_signal(Setup(scan), part) for part in parts]
    values = {
        "in_phase": noisy.signal.real,
        "quadrature": noisy.signal.imag,
        "in_phase_uncertainty": np.sqrt(noisy.in_phase_variance),
        "quadrature_uncertainty": np.sqrt(noisy.quadrature_variance),
        "in_phase_quadrature_covariance": noisy.covariance,
    }
    cube = frame.assign(
        {name: frame[name].copy(data=value) for name, value in values.items()}
    )
    return Scene(cube, *clean)


def scores(count: int, *, seeds: int, **changed: object) -> tuple[float, ...]:
    """Return coverage, trusted share, and noise over that with known water.

    The last two are of bright samples and of all.
    """
    inside, trusted, own, known, bright = [], [], [], [], []
    for seed in range(seeds):
        made = scene(count, seed, **changed)
        found = rejection.phasor_lines(made.samples)
        good = found["quality_flag"].values == 0
        error = np.angle(found.amulor.signal.values / made.target)
        stated = detection.phase_uncertainty(
            found.amulor.signal.values,
            in_phase_variance=found["in_phase_uncertainty"].values ** 2,
            quadrature_variance=found["quadrature_uncertainty"].values ** 2,
            covariance=found["in_phase_quadrature_covariance"].values,
        )
        less_water = made.samples.amulor.signal.values - made.water
        inside.append((np.abs(error) < 1.96 * stated)[good])
        trusted.append(good.mean())
        own.append(error[good] ** 2)
        known.append(np.angle(less_water / made.target)[good] ** 2)
        power = np.abs(made.target)
        bright.append((power > power.mean())[good])
    # Errors of frequencies differ, so each ratio is one of root mean squares.
    squares, others, lit = (np.concatenate(part) for part in (own, known, bright))
    return (
        float(np.concatenate(inside).mean()),
        float(np.mean(trusted)),
        float(np.sqrt(squares.mean() / others[lit].mean())),
        float(np.sqrt(squares.mean() / others.mean())),
    )


@pytest.mark.parametrize("count", [1, 2, 4])
def test_noise_and_coverage_with_light_from_photon_transport(count: int) -> None:
    inside, trusted, of_bright, of_all = scores(count, seeds=6, turbidity=2.0)
    # Two samples of 0.3 and 0.1 alone: sqrt(2) 0.3 / (0.3 - 0.1) = 2.1.
    assert of_all < of_bright < 2.2
    # 6 scans of 256 samples; windows of 25 samples are shared.
    assert 0.93 < inside < 0.985
    assert trusted > 0.95


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "turbidity"),
    [("petzold", 4.0), ("fournier-forand", 1.0), ("two-term", 2.0)],
)
@pytest.mark.parametrize("count", [1, 2, 4])
def test_other_waters(count: int, function: str, turbidity: float) -> None:
    inside, trusted, of_bright, _ = scores(
        count, seeds=6, function=function, turbidity=turbidity
    )
    assert of_bright < 2.2
    assert 0.92 < inside < 0.985
    assert trusted > 0.95


def test_one_reflectance_in_photon_water_is_refused() -> None:
    for count in (1, 4):
        with pytest.raises(CubeError, match="the reflectance does not vary"):
            rejection.phasor_lines(scene(count, 1, turbidity=2.0, dark=BRIGHT).samples)
