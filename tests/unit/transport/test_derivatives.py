"""Derivatives of the received light, from the scores of its paths."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.constants import speed_of_light

from amulor.optics.phase_functions.models import henyey_greenstein_function, isotropic
from amulor.transport import (
    DiscReceiver,
    GaussianReceiver,
    Layer,
    Medium,
    PhaseFunctionChange,
    PlaneTarget,
    Source,
    simulate,
)
from amulor.transport._kernels import contributions, trace
from amulor.transport._runs import Record

INDEX = 1.33
FREQUENCY = np.array([0.0, 40e6, 120e6])
WAVE = 2j * np.pi * FREQUENCY * INDEX / speed_of_light
PLATE = PlaneTarget(position=(0, 0, 1.2), reflectance=0.6)
DISC = DiscReceiver(radius=0.05, acceptance_angle=0.15, position=(0.07, 0, 0))


def change(asymmetry, step=1e-3):
    """Return the change of a Henyey-Greenstein function with its asymmetry."""
    lower, upper = asymmetry - step / 2, asymmetry + step / 2
    return PhaseFunctionChange(
        name="asymmetry",
        lower=henyey_greenstein_function(asymmetry=lower),
        upper=henyey_greenstein_function(asymmetry=upper),
        step=step,
    )


def run(absorption, scattering, function, **options):
    """Return a run in water without bounds."""
    medium = Medium.homogeneous(
        absorption=absorption,
        scattering=scattering,
        phase_function=function,
        group_index=INDEX,
    )
    chosen = {"histories": 4000, "seed": 1, "receiver": DISC} | options
    receiver = chosen.pop("receiver")
    return simulate(medium, Source(), receiver, FREQUENCY, **chosen)


def test_light_times_length_is_the_integral():
    # Light of 2 at one length, and of 3 spread evenly over a range, on both sides of
    # the last node (511 steps of 0.01 m).
    for point, low, high in ((1.234, 0.5, 0.9), (7.5, 6.0, 6.4), (3.0, 2.0, 2.0001)):
        record = Record(
            mass=np.zeros((12, 1, 512)), edge=np.zeros((12, 1, 512)),
            beyond=np.zeros((14, 1, 3), complex), wavenumber=WAVE, spacing=0.01,
            parts=12,
        )  # fmt: skip
        arrays = record.arrays(10)
        contributions.add_point(arrays, 11, point, np.array([2.0]))
        contributions.add_range(arrays, 4, low, high, np.array([3.0]))
        water, target = record._lengths()
        node, weight = leggauss(40)
        length = 0.5 * (low + high) + 0.5 * (high - low) * node
        mean = np.exp(np.outer(WAVE, length)) @ (length * weight) / 2
        np.testing.assert_allclose(water[0], 3 * mean, rtol=2e-6)
        np.testing.assert_allclose(
            target[0], 2 * point * np.exp(WAVE * point), rtol=2e-6
        )


def test_a_plate_in_dark_water_is_the_integral_over_the_face():
    tally = run(
        0.4, 0.0, isotropic(), target=PLATE, derivatives=("absorption", "reflectance")
    )
    # Lambert's law over the face of the receiver, all of it within the acceptance.
    node, weight = leggauss(16)
    r, angle = np.meshgrid(0.025 * (node + 1), np.pi * (node + 1))
    area = np.outer(np.pi * weight, 0.025 * weight) * r
    way = np.sqrt((0.07 + r * np.cos(angle)) ** 2 + (r * np.sin(angle)) ** 2 + 1.44)
    phasor = np.exp((WAVE[:, None, None] - 0.4) * (1.2 + way))
    light = 0.6 / np.pi * area * 1.44 / way**4 * phasor
    expected = {
        "absorption": -np.sum(light * (1.2 + way), axis=(1, 2)),
        "reflectance": np.sum(light, axis=(1, 2)) / 0.6,
    }
    for name, value in expected.items():
        slope, covariance = tally.derivative(name, "target")
        error = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        assert np.all(error < 0.01 * np.abs(value))
        assert np.all(np.abs(slope - value) < 4 * error + 1e-5 * np.abs(value))
        assert np.all(tally.derivative(name, "water")[0] == 0)
        np.testing.assert_array_equal(tally.derivative(name)[0], slope)


RECEIVER = {
    "receiver_right": 0.05, "receiver_down": 0.01, "receiver_radius": 0.03,
    "receiver_tilt_right": 0.0, "receiver_tilt_down": 0.0, "range": 1.2,
}  # fmt: skip


def eye(values=RECEIVER):
    """Return a Gaussian receiver at a place."""
    return GaussianReceiver(
        radius=values["receiver_radius"], acceptance_angle=0.06,
        position=(values["receiver_right"], values["receiver_down"], 0),
    )  # fmt: skip


def seen_plate(values, absorption):
    """Return the light of a tilted plate in dark water, by an integral over the face.

    The sensitivity is exp(-s^2 / R^2 - theta^2 / gamma^2), with theta about an axis
    that is tilted while the face is not.
    """
    node, weight = leggauss(80)
    x, y = np.meshgrid(0.15 * node, 0.15 * node)
    area = 0.15**2 * np.outer(weight, weight)
    distance, normal = values["range"], np.array([0.28, 0.0, -0.96])
    way = np.stack(
        [
            -values["receiver_right"] - x,
            -values["receiver_down"] - y,
            np.full(x.shape, distance),
        ]
    )
    length = np.linalg.norm(way, axis=0)
    right, down = values["receiver_tilt_right"], values["receiver_tilt_down"]
    axis = np.array([np.sin(right), np.sin(down), 1.0])
    axis[2] = np.sqrt(1 - axis[0] ** 2 - axis[1] ** 2)
    angle = np.arccos(np.tensordot(axis, way, 1) / length)
    leaving = -np.tensordot(normal, way, 1) / length
    sensitivity = np.exp(
        -(x**2 + y**2) / values["receiver_radius"] ** 2 - (angle / 0.06) ** 2
    )
    light = 0.6 / np.pi * leaving * way[2] / length**3 * area * sensitivity
    phasor = np.exp((WAVE[:, None, None] - absorption) * (distance + length))
    return np.sum(light * phasor, axis=(1, 2))


def test_a_plate_has_the_derivatives_of_the_integral_over_a_gaussian_face():
    target = PlaneTarget(position=(0, 0, 1.2), normal=(0.28, 0, -0.96), reflectance=0.6)
    tally = run(
        0.4, 0.0, isotropic(), target=target, receiver=eye(), histories=40_000,
        derivatives=tuple(RECEIVER),
    )  # fmt: skip
    light = seen_plate(RECEIVER, 0.4)
    error = np.sqrt(np.trace(tally.target_covariance, axis1=1, axis2=2))
    assert np.all(np.abs(tally.target_signal - light) < 4 * error)
    for name, value in RECEIVER.items():
        above, below = (
            seen_plate(RECEIVER | {name: value + sign * 1e-4}, 0.4) for sign in (1, -1)
        )
        expected = (above - below) / 2e-4
        slope, covariance = tally.derivative(name, "target")
        error = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        scale = np.abs(light) / (1.2 if name == "range" else 0.06)
        assert np.all(error < 0.1 * scale), name
        assert np.all(np.abs(slope - expected) < 4 * error), name


def test_bounds_are_those_of_the_integral_over_the_face():
    target = PlaneTarget(position=(0, 0, 1.2), normal=(0.28, 0, -0.96), reflectance=0.6)
    names = ("range", "reflectance", "absorption")
    tally = run(
        0.4, 0.0, isotropic(), target=target, receiver=eye(), histories=20_000,
        derivatives=("receiver_right", *names),
    )  # fmt: skip
    light = seen_plate(RECEIVER, 0.4)
    near, far = (seen_plate(RECEIVER | {"range": 1.2 + s}, 0.4) for s in (-1e-4, 1e-4))
    less, more = (seen_plate(RECEIVER, 0.4 + step) for step in (-1e-4, 1e-4))
    slopes = np.stack([(far - near) / 2e-4, light / 0.6, (more - less) / 2e-4])
    # Noise of 2 % of the light, and half of it in the quadrature.
    sigma = 0.02 * np.abs(light)[:, np.newaxis] * np.array([1.0, 0.5])
    noise = sigma[..., np.newaxis] ** 2 * np.eye(2)
    scaled = np.stack([slopes.real / sigma[:, 0], slopes.imag / sigma[:, 1]], axis=-1)
    information = np.einsum("kfi,lfi->kl", scaled, scaled)
    for count in (1, 2):
        expected = np.sqrt(np.diagonal(np.linalg.inv(information[:count, :count])))
        bound, error = tally.bounds(noise, names[:count])
        assert np.all(error < 0.05 * expected)
        assert np.all(np.abs(bound - expected) < 4 * error)
    # All light has nearly the same way: reflectance and absorption act alike.
    with pytest.raises(ValueError, match="does not determine the parameters"):
        tally.bounds(noise[:1], names)
    with pytest.raises(ValueError, match=r"the derivatives are .*; got albedo"):
        tally.bounds(noise, ("albedo",))
    short = run(
        0.4, 0.0, isotropic(), target=target, histories=64, derivatives=("absorption",)
    )
    with pytest.raises(ValueError, match="at least 16 batches, got 8"):
        short.bounds(noise)


def test_thin_water_has_the_derivatives_of_a_shifted_and_tilted_receiver():
    # A point on the beam at the depth z is x + z tilt away from the axis; of the face,
    # an area of pi R^2 z^2 gamma^2 / (R^2 + z^2 gamma^2) sees it, times
    # exp(-(x + z tilt)^2 / (R^2 + z^2 gamma^2)).
    values = {
        "receiver_right": 0.03, "receiver_radius": 0.02, "receiver_tilt_right": 0.0
    }  # fmt: skip
    gamma, backwards = 0.04, henyey_greenstein_function(asymmetry=0.3).at_180
    node, weight = leggauss(60)

    def single(values):
        radius, total = values["receiver_radius"], 0j
        for low, high in pairwise(np.geomspace(0.02, 80.0, 16)):
            z = 0.5 * (low + high) + 0.5 * (high - low) * node
            both = radius**2 + (z * gamma) ** 2
            off = values["receiver_right"] + z * values["receiver_tilt_right"]
            area = np.pi * (radius * z * gamma) ** 2 / both * np.exp(-(off**2) / both)
            light = 0.002 * backwards * area / z**2
            phasor = np.exp(2 * np.outer(WAVE - 0.402, z))
            total = total + phasor @ (light * weight) * 0.5 * (high - low)
        return total

    receiver = GaussianReceiver(
        radius=0.02, acceptance_angle=gamma, position=(0.03, 0, 0)
    )
    tally = run(
        0.4, 0.002, henyey_greenstein_function(asymmetry=0.3), receiver=receiver,
        histories=40_000, derivatives=(*values, "receiver_down"),
    )  # fmt: skip
    light = np.abs(single(values))
    for name, value in values.items():
        above, below = (
            single(values | {name: value + sign * 1e-4}) for sign in (1, -1)
        )
        expected = (above - below) / 2e-4
        slope, covariance = tally.derivative(name)
        error = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        assert np.all(error < 0.1 * light[0] / 0.02), name
        # Twice scattered light and angles that are not small: some percent.
        assert np.all(np.abs(slope - expected) < 4 * error + 0.03 * np.abs(expected))
    slope, covariance = tally.derivative("receiver_down")
    error = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    assert np.all(np.abs(slope) < 4 * error)


def single_scattering(absorption, scattering, asymmetry):
    """Return singly scattered light of a coaxial, narrow Gaussian receiver.

    At the depth z the part z^2 gamma^2 / (R^2 + z^2 gamma^2) of the face's area pi R^2
    sees a point on the axis.
    """
    radius, acceptance = 0.02, 0.04
    attenuation = absorption + scattering
    backwards = henyey_greenstein_function(asymmetry=asymmetry).at_180
    node, weight = leggauss(60)
    total = np.zeros(3, dtype=complex)
    edges = np.geomspace(1e-3, 80.0, 12)
    for low, high in pairwise(edges):
        z = 0.5 * (low + high) + 0.5 * (high - low) * node
        seen = 1 / (1 / radius**2 + 1 / (z * acceptance) ** 2)
        light = scattering * backwards * np.pi * seen / z**2
        phasor = np.exp(2 * np.outer(WAVE - attenuation, z))
        total += phasor @ (light * weight) * 0.5 * (high - low)
    return total


def test_thin_water_has_the_derivatives_of_single_scattering():
    # Twice scattered light is of the order of b over a, half a percent.
    values = {"absorption": 0.4, "scattering": 0.002, "asymmetry": 0.5}
    receiver = GaussianReceiver(radius=0.02, acceptance_angle=0.04)
    tally = run(
        0.4, 0.002, henyey_greenstein_function(asymmetry=0.5), receiver=receiver,
        histories=24_000, derivatives=("absorption", "scattering", change(0.5)),
    )  # fmt: skip
    for name, value in values.items():
        step = 1e-3 * value
        above, below = (
            single_scattering(**values | {name: value + sign * step})
            for sign in (1, -1)
        )
        expected = (above - below) / (2 * step)
        slope, covariance = tally.derivative(name)
        error = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        assert np.all(error < 0.15 * np.abs(expected))
        assert np.all(np.abs(slope - expected) < 4 * error + 0.02 * np.abs(expected))


def test_absorption_is_the_slope_of_the_same_paths_with_more_of_it():
    function = henyey_greenstein_function(asymmetry=0.8)
    tally = run(
        0.3, 0.6, function, target=PLATE, derivatives=("absorption",), keep_record=True
    )
    signal, first, second = (
        tally.record.stokes(FREQUENCY, group_index=INDEX, more_absorption=more)[:, 0]
        for more in (0.0, 1e-3, 2e-3)
    )
    expected = (4 * first - 3 * signal - second) / 2e-3
    slope, _ = tally.derivative("absorption")
    np.testing.assert_allclose(slope, expected, rtol=3e-3)


def test_derivatives_leave_the_light_as_it_is():
    function = henyey_greenstein_function(asymmetry=0.8)
    plain = run(0.3, 0.6, function, target=PLATE)
    tally = run(
        0.3, 0.6, function, target=PLATE,
        derivatives=(change(0.8), "scattering", "reflectance"),
    )  # fmt: skip
    assert tally.derivatives == ("asymmetry", "scattering", "reflectance")
    np.testing.assert_array_equal(tally.batches, plain.batches)
    np.testing.assert_array_equal(tally.contributions, plain.contributions)
    assert plain.derivatives == ()
    alone = run(0.3, 0.6, function, target=PLATE, derivatives=("scattering",))
    for light in ("all", "water", "target"):
        np.testing.assert_allclose(
            alone.derivative("scattering", light)[0],
            tally.derivative("scattering", light)[0],
        )


def test_the_weight_of_a_long_path_is_the_inverse_of_its_survival():
    survival = 1.0
    for order in range(200):
        weight = trace.order_weight.py_func(float(order), 16)
        assert weight == pytest.approx(1 / survival)
        if order >= 16:  # as a path goes on from this scattering to the next
            survival *= order / (order + 1)


def test_derivatives_are_resumed_merged_and_delayed_with_the_light():
    function = henyey_greenstein_function(asymmetry=0.8)
    names = ("scattering", "reflectance")
    half = run(0.3, 0.6, function, target=PLATE, histories=2048, derivatives=names)
    whole = run(
        0.3, 0.6, function, target=PLATE, histories=3072, derivatives=names, resume=half
    )
    other = run(
        0.3, 0.6, function, target=PLATE, histories=4096, derivatives=names, seed=2
    )
    np.testing.assert_array_equal(
        whole.derivative_batches[: half.next_batch], half.derivative_batches
    )
    both = whole.merged(other)
    share = whole.histories / both.histories
    for name in names:
        expected = share * whole.derivative(name)[0]
        expected += (1 - share) * other.derivative(name)[0]
        np.testing.assert_allclose(both.derivative(name)[0], expected, rtol=1e-12)
        np.testing.assert_allclose(
            whole.delayed(0.5, group_index=INDEX).derivative(name)[0],
            whole.derivative(name)[0] * np.exp(0.5 * WAVE),
        )
    with pytest.raises(ValueError, match="same problem"):
        whole.merged(run(0.3, 0.6, function, target=PLATE, seed=3))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"derivatives": ("albedo",)}, "or a PhaseFunctionChange, got 'albedo'"),
        ({"derivatives": ("absorption",) * 2}, "derivatives must have different names"),
        ({"derivatives": ("reflectance",)}, "needs a target"),
        ({"derivatives": ("scattering",), "scattering": 0.0}, "layers that all"),
        (
            {
                "derivatives": ("reflectance",),
                "target": PlaneTarget(
                    position=(0, 0, 1), reflectance=0.2, gloss=0.1, rms_slope=0.1
                ),
            },
            r"reflectance needs a target without gloss, got a gloss of 0\.1",
        ),
        (
            {"derivatives": ("receiver_tilt_down",)},
            "derivative to receiver_tilt_down needs a GaussianReceiver",
        ),
        (
            {"derivatives": ("range",), "receiver": eye()},
            "derivative to range needs a PlaneTarget in water without layers",
        ),
        (
            {
                "derivatives": ("range",),
                "target": PLATE,
                "receiver": GaussianReceiver(
                    radius=0.02, acceptance_angle=0.1, position=(0.07, 0, 0.1)
                ),
            },
            "needs a beam without width .* got a radius of 0 m, -0.1 m before",
        ),
    ],
)
def test_a_parameter_that_has_no_derivative_is_refused(options, message):
    options = {"scattering": 0.6} | options
    with pytest.raises(ValueError, match=message):
        run(0.3, options.pop("scattering"), isotropic(), **options)


def test_layers_of_several_phase_functions_have_no_common_change():
    layers = [
        Layer(absorption=0.2, scattering=0.5, phase_function=p, thickness=1.0)
        for p in (isotropic(), henyey_greenstein_function(asymmetry=0.5))
    ]
    with pytest.raises(ValueError, match="in all layers, got 2"):
        simulate(
            Medium.layered(layers, group_index=INDEX), Source(), DISC, FREQUENCY,
            histories=8, seed=1, derivatives=(change(0.5),),
        )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "step", "message"),
    [("asymmetry", 0.0, "step must be"), ("scattering", 0.1, "name must not be")],
)
def test_a_change_needs_a_name_and_a_step(name, step, message):
    with pytest.raises(ValueError, match=message):
        PhaseFunctionChange(name=name, lower=isotropic(), upper=isotropic(), step=step)


def test_a_missing_derivative_or_light_is_named():
    tally = run(0.3, 0.6, isotropic(), derivatives=("absorption",))
    with pytest.raises(ValueError, match="the derivatives are 'absorption'"):
        tally.derivative("scattering")
    with pytest.raises(
        ValueError, match="one of 'all', 'water', 'target'; got 'order 1'"
    ):
        tally.derivative("absorption", "order 1")
    with pytest.raises(ValueError, match="the same derivatives"):
        run(0.3, 0.6, isotropic(), resume=tally, histories=8000)
