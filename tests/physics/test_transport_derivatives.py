"""Derivatives of the received light against finite differences of light."""

from __future__ import annotations

import numpy as np
import photon_derivatives as plain
import pytest

from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.transport import (
    DiscReceiver,
    GaussianReceiver,
    Medium,
    PhaseFunctionChange,
    PlaneTarget,
    Source,
    simulate,
)

pytestmark = pytest.mark.study  # statistics of photons

VALUES = {"absorption": 0.2, "scattering": 0.8, "asymmetry": 0.8, "reflectance": 0.4}
STEPS = {"absorption": 0.1, "scattering": 0.15, "asymmetry": 0.03, "reflectance": 0.2}
FREQUENCY = [0.0, 30e6, 100e6]
RECEIVERS = {
    "disc": DiscReceiver(radius=0.05, acceptance_angle=0.1, position=(0.07, 0, 0)),
    "Gaussian": GaussianReceiver(
        radius=0.05, acceptance_angle=0.1, position=(0.07, 0, 0)
    ),
}


def parameters(asymmetry):
    """Return all parameters of a derivative, with the asymmetry of a phase function."""
    lower, upper = asymmetry - 0.001, asymmetry + 0.001
    change = PhaseFunctionChange(
        name="asymmetry",
        lower=henyey_greenstein_function(asymmetry=lower),
        upper=henyey_greenstein_function(asymmetry=upper),
        step=0.002,
    )
    return ("absorption", "scattering", change, "reflectance")


def run(receiver, values, seed, *, distance=1.5, frequency=FREQUENCY, derivatives=()):
    """Return a run with a plane target."""
    water = Medium.homogeneous(
        absorption=values["absorption"],
        scattering=values["scattering"],
        phase_function=henyey_greenstein_function(asymmetry=values["asymmetry"]),
        group_index=1.33,
    )
    target = PlaneTarget(position=(0, 0, distance), reflectance=values["reflectance"])
    return simulate(
        water, Source(), receiver, frequency, histories=200_000, seed=seed,
        target=target, derivatives=derivatives,
    )  # fmt: skip


def parts(value, covariance):
    """Return real and imaginary parts and their variances, without that at 0 Hz."""
    number = np.stack([value.real, value.imag], axis=-1).ravel()
    variance = np.diagonal(covariance, axis1=1, axis2=2).ravel()
    keep = np.ones(number.size, dtype=bool)
    keep[1] = False  # the quadrature at 0 Hz
    return number[keep], variance[keep]


def test_derivatives_are_the_slopes_of_independent_runs():
    distance = []
    for number, receiver in enumerate(RECEIVERS.values()):
        tally = run(receiver, VALUES, 1, derivatives=parameters(0.8))
        for k, (name, step) in enumerate(STEPS.items()):
            # Differences over a step and half of it: the error of fourth order stays.
            runs = [
                run(receiver, VALUES | {name: VALUES[name] + part * step}, seed)
                for seed, part in enumerate(
                    (1, -1, 0.5, -0.5), 10 * k + 50 * number + 2
                )
            ]
            factors = np.array([-1 / 6, 1 / 6, 4 / 3, -4 / 3]) / step
            for light in ("water", "target"):
                slope, covariance = tally.derivative(name, light)
                signals = [getattr(r, f"{light}_signal") for r in runs]
                errors = [getattr(r, f"{light}_covariance") for r in runs]
                expected = sum(f * s for f, s in zip(factors, signals, strict=True))
                covariance = covariance + sum(
                    f**2 * e for f, e in zip(factors, errors, strict=True)
                )
                value, variance = parts(slope - expected, covariance)
                distance.extend(value / np.sqrt(variance))
    distance = np.abs(distance)
    # 80 numbers, of which those of one run are correlated.
    assert distance.size == 80
    assert np.mean(distance < 2) > 0.88
    assert distance.max() < 4.5


MOVED = {
    "receiver_right": 0.006, "receiver_down": 0.006, "receiver_radius": 0.003,
    "receiver_tilt_right": 0.015, "receiver_tilt_down": 0.015, "range": 0.1,
}  # fmt: skip


def moved(seed, derivatives=(), **shift):
    """Return a run with a tilted target and a Gaussian receiver that is moved."""
    at = dict.fromkeys(MOVED, 0.0) | shift
    water = Medium.homogeneous(
        absorption=0.2, scattering=0.6, group_index=1.34,
        phase_function=henyey_greenstein_function(asymmetry=0.9),
    )  # fmt: skip
    right, down = at["receiver_tilt_right"] - 0.03, at["receiver_tilt_down"]
    receiver = GaussianReceiver(
        radius=0.03 + at["receiver_radius"], acceptance_angle=0.08,
        position=(0.07 + at["receiver_right"], at["receiver_down"], 0),
        direction=(np.sin(right), np.sin(down), np.cos(right)),
    )  # fmt: skip
    target = PlaneTarget(
        position=(0, 0, 2 + at["range"]), normal=(0.15, 0, -0.99), reflectance=0.3
    )
    return simulate(
        water, Source(), receiver, FREQUENCY, histories=200_000, seed=seed,
        target=target, derivatives=derivatives,
    )  # fmt: skip


def test_derivatives_to_receiver_and_range_are_slopes_of_independent_runs():
    tally = moved(1, tuple(MOVED))
    distance = []
    for k, (name, step) in enumerate(MOVED.items()):
        above = moved(10 * k + 11, **{name: step})
        below = moved(10 * k + 12, **{name: -step})
        for light in ("water", "target"):
            slope, covariance = tally.derivative(name, light)
            signals = [getattr(r, f"{light}_signal") for r in (above, below)]
            errors = [getattr(r, f"{light}_covariance") for r in (above, below)]
            expected = (signals[0] - signals[1]) / (2 * step)
            covariance = covariance + sum(errors) / (2 * step) ** 2
            value, variance = parts(slope - expected, covariance)
            distance.extend(value / np.sqrt(variance))
    distance = np.abs(distance)
    # 60 numbers, of which those of one run are correlated.
    assert distance.size == 60
    assert np.mean(distance < 2) > 0.85
    assert distance.max() < 4.5


def test_derivatives_are_those_of_a_plain_loop():
    case = plain.Case()
    receiver = GaussianReceiver(
        radius=case.radius,
        acceptance_angle=case.acceptance,
        position=(case.centre, 0, 0),
    )
    values = {name: getattr(case, name) for name in VALUES}
    tally = run(
        receiver, values, 1, distance=case.distance, frequency=[case.frequency],
        derivatives=parameters(case.asymmetry),
    )  # fmt: skip
    for name, step in STEPS.items():
        slopes, errors = plain.derivative(
            case, name, 0.2 * step, photons=200_000, events=10, seed=1
        )
        for light, expected, error in zip(
            ("water", "target"), slopes, errors, strict=True
        ):
            slope, covariance = tally.derivative(name, light)
            off = slope[0] - expected
            real = np.hypot(np.sqrt(covariance[0, 0, 0]), error.real)
            imaginary = np.hypot(np.sqrt(covariance[0, 1, 1]), error.imag)
            assert abs(off.real) <= 4 * real, (name, light)
            assert abs(off.imag) <= 4 * imaginary, (name, light)
