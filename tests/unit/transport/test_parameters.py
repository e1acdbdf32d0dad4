"""Scores of the parameters of derivatives, and how the rows of a run are made."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.optics.phase_functions.models import henyey_greenstein_function, isotropic
from amulor.transport import (
    DiscReceiver,
    GaussianReceiver,
    Layer,
    Medium,
    PhaseFunctionChange,
    PlaneTarget,
    Source,
)
from amulor.transport._derivatives import Derivatives
from amulor.transport._kernels.sampling import SIZE
from amulor.transport._problem import Problem, cells_of

EYE = GaussianReceiver(radius=0.02, acceptance_angle=0.1)
PLATE = PlaneTarget(position=(0, 0, 2), reflectance=0.5)
RECEIVER = (
    "receiver_right", "receiver_down", "receiver_radius", "receiver_tilt_right",
    "receiver_tilt_down",
)  # fmt: skip
WAVE = np.array([0.0, 0.7j])


def water(**changes):
    values = {
        "absorption": 0.3, "scattering": 0.5, "phase_function": isotropic(),
        "group_index": 1.33,
    }  # fmt: skip
    return Medium.homogeneous(**(values | changes))


def problem(**changes):
    parts = {
        "medium": water(),
        "source": Source(),
        "receiver": EYE,
        "target": PLATE,
    } | changes
    return Problem(**parts)


def change(step=0.02, name="asymmetry"):
    return PhaseFunctionChange(
        name=name,
        lower=henyey_greenstein_function(asymmetry=0.5 - step / 2),
        upper=henyey_greenstein_function(asymmetry=0.5 + step / 2),
        step=step,
    )


def of(*parameters, **changes):
    return Derivatives.of(parameters, problem(**changes))


def test_without_parameters_there_is_no_score():
    found = of()
    assert (found.names, found.events, found.scores) == ((), (), ())
    assert found.score.shape == (0, 1, SIZE)
    assert not found.moved
    assert not found.lengths
    assert found.digest == ""
    assert found.distance is None
    plain = Derivatives()
    assert (plain.names, plain.events, plain.radius) == ((), (), 1)
    assert plain.score.shape == (0, 1, 1)


def test_scattering_scores_the_inverse_of_its_coefficient_in_each_layer():
    stack = [
        Layer(absorption=0.1, scattering=b, phase_function=isotropic(), thickness=1.0)
        for b in (0.25, 2.0)
    ]
    medium = Medium.layered(stack, group_index=1.33)
    found = of("absorption", "scattering", medium=medium)
    assert found.events == ("scattering",)
    assert found.score.shape == (1, 2, SIZE)
    assert_allclose(found.score[0, 0], 4, rtol=1e-12)
    assert_allclose(found.score[0, 1], 0.5, rtol=1e-12)
    assert found.radius == 0.02
    assert found.lengths
    assert not found.moved


def test_a_phase_function_scores_the_slope_of_its_logarithm():
    function = henyey_greenstein_function(asymmetry=0.5)
    found = of(change(step=0.002), medium=water(phase_function=function))
    assert found.names == found.events == found.scores == ("asymmetry",)
    assert not found.lengths
    # ln of (1 - g^2) / (1 + g^2 - 2 g cos)^1.5, derived to g.
    cosine = np.cos(cells_of(function).middle)
    g = 0.5
    expected = -2 * g / (1 - g**2) - 1.5 * (2 * g - 2 * cosine) / (
        1 + g**2 - 2 * g * cosine
    )
    assert_allclose(found.score[0, 0, 1:], expected[1:], atol=2e-3)
    # It is that of all layers that share the function.
    stack = [
        Layer(absorption=a, scattering=0.5, phase_function=function, thickness=1.0)
        for a in (0.1, 0.2)
    ]
    both = of(change(step=0.002), medium=Medium.layered(stack, group_index=1.33))
    assert both.score.shape == (1, 2, SIZE)
    assert_allclose(both.score[0, 1], found.score[0, 0])


def test_a_receiver_has_five_scores_that_begin_at_nothing():
    found = of("reflectance", "receiver_radius")
    assert found.events == RECEIVER
    assert found.scores == (*RECEIVER, "reflectance")
    assert found.score.shape == (5, 1, SIZE)
    assert not found.score.any()
    assert found.moved
    assert not found.lengths
    assert found.distance is None


def test_the_range_needs_scattering_and_all_of_the_receiver():
    source = Source(position=(0.3, -0.1, 0.02), direction=(0.0, 0.6, 0.8))
    tilted = PlaneTarget(position=(0, 0, 2), normal=(0, 0.6, -0.8), reflectance=0.5)
    found = of("range", source=source, target=tilted)
    assert found.events == ("scattering", *RECEIVER)
    assert_allclose(found.score[0], 2, rtol=1e-12)
    assert found.lengths
    assert found.moved
    # 0.6 y - 0.8 z = -1.6 is met from y = -0.1, z = 0.02 after (1.6 - 0.076) / 0.28.
    assert found.distance.range == pytest.approx((1.6 - 0.06 - 0.016) / 0.28)
    assert found.distance.attenuation == pytest.approx(0.8)
    assert found.distance.scattering == pytest.approx(0.5)
    assert (found.distance.right, found.distance.down) == (0.3, -0.1)
    twice = of("scattering", "range")
    assert twice.events == ("scattering", *RECEIVER)
    dark = of("range", medium=water(scattering=0.0))
    assert dark.events == ("scattering", *RECEIVER)
    assert not dark.score.any()


def test_a_beam_may_start_a_hundredth_of_the_range_off_the_face():
    for forward, refused in ((0.0195, False), (0.0201, True), (-0.021, True)):
        source = Source(position=(0, 0, forward))
        if refused:
            with pytest.raises(ValueError, match=re.escape(f"{forward:g} m before")):
                of("range", source=source)
        else:
            found = of("range", source=source).distance
            assert found.range == pytest.approx(2 - forward)
    with pytest.raises(ValueError, match=r"got a radius of 0\.01 m"):
        of("range", source=Source(radius=0.01))


def test_parameters_that_a_problem_does_not_have_are_refused():
    layers = Medium.layered(
        [Layer(absorption=0.1, scattering=0.5, phase_function=isotropic(),
               thickness=9.0)],
        group_index=1.33,
    )  # fmt: skip
    black = PlaneTarget(position=(0, 0, 2), reflectance=0.0)
    disc = DiscReceiver(radius=0.05, acceptance_angle=0.1)
    for name, changes, message in (
        ("range", {"medium": layers}, "needs a PlaneTarget in water without layers"),
        ("range", {"target": None}, "needs a PlaneTarget in water without layers"),
        ("range", {"receiver": disc}, "derivative to range needs a GaussianReceiver"),
        ("reflectance", {"target": black}, "needs a target with a reflectance above"),
        ("albedo", {}, "or a PhaseFunctionChange, got 'albedo'"),
    ):
        with pytest.raises(ValueError, match=message):
            of(name, **changes)
    for wrong in (np.nan, np.inf):
        with pytest.raises(ValueError, match="step must be a finite number"):
            PhaseFunctionChange(
                name="g", lower=isotropic(), upper=isotropic(), step=wrong
            )
    assert change(step=-0.02).step == -0.02


def light(seed, rows):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(rows, 1, 2)) + 1j * rng.normal(size=(rows, 1, 2))


def test_rows_are_scores_less_the_light_times_its_length():
    names = ("absorption", "scattering", "reflectance")
    found = of(*names)
    scored, length = light(1, 4), light(2, 2)
    rows = found.rows(scored, length, WAVE)
    assert_allclose(rows[:2], -length)
    assert_allclose(rows[2:4], scored[:2] - length)
    assert_allclose(rows[4:], scored[2:])
    assert of().rows(light(1, 0), length, WAVE).shape == (0, 1, 2)


def test_the_receiver_scores_its_radius_by_the_logarithm():
    found = of("receiver_radius", "receiver_down")
    scored = light(3, 10)
    rows = found.rows(scored, light(4, 2), WAVE)
    assert_allclose(rows[:2], scored[4:6] / 0.02)
    assert_allclose(rows[2:], scored[2:4])


def test_the_range_is_all_lengths_less_those_of_the_receiver():
    source = Source(position=(0.3, -0.1, 0.0))
    found = of("range", source=source)
    scored, length = light(5, 12), light(6, 2)
    scattering, right, down, radius = (scored[2 * k : 2 * k + 2] for k in range(4))
    # With all lengths together: N scatterings, light times (q - c) L, and place and
    # radius of the receiver, which stay as they are.
    expected = 0.5 * scattering + (WAVE - 0.8) * length + 0.3 * right - 0.1 * down
    assert_allclose(found.rows(scored, length, WAVE), (expected - radius) / 2)


def test_runs_with_other_scores_are_told_apart():
    digests = [
        of(*names).digest
        for names in ((), ("absorption",), ("scattering",), ("absorption", "range"))
    ]
    other = of("scattering", medium=water(scattering=0.6)).digest
    assert len({*digests, other}) == 5
    assert digests[1].startswith(" ('absorption',) ")
