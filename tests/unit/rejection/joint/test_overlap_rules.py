"""Frames of the joint estimation: depths, spreads and series, by closed forms."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import j0

from amulor.errors import CubeError
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.rejection.joint import overlap
from amulor.rejection.joint.overlap import Directions, Frame, Scattered, Shape

SHAPE = Shape(0.3, 0.02, 0.5, np.zeros(0), np.zeros(0))


def frame_with(light: Any, end: float = np.inf) -> Any:
    """Return a frame whose overlap at two directions is given."""
    frame: Any = object.__new__(Frame)
    frame.end = end
    frame.overlap = lambda depth, shape: np.stack([light(depth), 0.5 * light(depth)])
    frame.directions = SimpleNamespace(centre=np.array([0.25, 0.75]), middle=(0.1, 0.2))
    return frame


def test_nothing_is_left_beyond_a_ten_millionth_of_the_light() -> None:
    frame = frame_with(lambda depth: np.exp(-depth))
    found = frame.nothing_left(SHAPE)
    # exp(-z) is 1e-7 at 16.1 m; the depths are 0.8 % apart.
    assert found == pytest.approx(16.1, rel=0.02)
    step = frame_with(lambda depth: np.where(depth < 5, 1.0, 0.0))
    assert step.nothing_left(SHAPE) == pytest.approx(5, rel=0.009)
    with pytest.raises(CubeError, match="does not see the beam at any depth"):
        frame_with(lambda depth: 1e-110 * np.exp(-depth)).nothing_left(SHAPE)


def test_quantiles_are_those_of_the_cumulative_light() -> None:
    frame = frame_with(lambda depth: np.exp(-0.5 * depth))
    shares = np.array([0.1, 0.5, 0.9])
    expected = -2 * np.log(1 - shares)
    assert_allclose(frame.quantiles(SHAPE, shares), expected, atol=0.02)
    # Water that ends has its light in front of the end.
    short = frame_with(lambda depth: np.exp(-0.5 * depth), end=3.0)
    whole = 1 - np.exp(-1.5)
    assert_allclose(
        short.quantiles(SHAPE, shares), -2 * np.log(1 - whole * shares), atol=5e-3
    )


def test_the_middle_of_a_scan_has_its_correction() -> None:
    frame = frame_with(lambda depth: 1 / (1 + depth))
    knots = np.array([1.0, 2.0, 4.0])
    shape = Shape(0.3, 0.02, 0.5, np.array([0.1, -0.2, 0.3]), knots)
    depth = np.array([0.5, 2.0, 3.0, 9.0])
    factor = np.exp(shape.correction @ overlap.hats(depth, knots))
    expected = factor * (0.25 + 0.75 * 0.5) / (1 + depth)
    assert_allclose(frame.middle(depth, shape), expected)


@pytest.mark.parametrize("error", [0.1, 0.7, 3.0])
def test_late_echoes_have_a_mean_of_fit_and_survey(
    monkeypatch: pytest.MonkeyPatch, error: float
) -> None:
    asked: list[Any] = []

    def late(frequency: float, **words: Any) -> np.ndarray:
        asked.append((frequency, words))
        return np.array([0.004])

    monkeypatch.setattr(overlap, "late_echo", late)
    frame = frame_with(None)
    frame._scattered = SimpleNamespace(
        moment=0.05, fraction=0.8, function="f", split_angle=1.2
    )
    frame._properties = SimpleNamespace(scattering=0.6)
    frame.medium = SimpleNamespace(group_index=1.38)
    frame._arguments = lambda azimuth, elevation: {
        "azimuth": azimuth.item(),
        "elevation": elevation.item(),
    }
    found = frame.late_spread(2.0, 0.03, error)
    # A detour of a quarter of the spread and the squared depth is twice that of light.
    assert found == pytest.approx(8 * 0.004 / 4.0)
    fitted = 0.03 / (0.05 * 0.8)
    trust = 0.49 / (0.49 + error**2)
    frequency, words = asked[0]
    assert frequency == 0.0
    assert words["depth"] == 2.0
    assert words["scattering"] == pytest.approx(fitted**trust * 0.6 ** (1 - trust))
    assert (words["azimuth"], words["elevation"]) == (0.1, 0.2)
    assert (words["split_angle"], words["group_index"]) == (1.2, 1.38)
    # Without a depth, a number, or a phase function it is the spread of the fit.
    assert frame.late_spread(0.0, 0.03, error) == 0.03
    assert frame.late_spread(np.nan, 0.03, error) == 0.03
    monkeypatch.setattr(overlap, "late_echo", lambda *_, **__: np.array([np.nan]))
    assert frame.late_spread(2.0, 0.03, error) == 0.03
    frame._scattered = None
    assert frame.late_spread(2.0, 0.03, error) == 0.03


def test_turned_receivers_are_computed_once() -> None:
    asked: list[Any] = []

    class Model(SimpleNamespace):
        def model_copy(self, update: dict[str, Any]) -> Model:
            return Model(**vars(self) | update)

    frame = frame_with(None)
    receiver = Model(azimuth=0.2, elevation=-0.1)
    frame.survey = Model(instrument=Model(receiver=receiver))
    frame.directions = SimpleNamespace(mesh=(1.0, 2.0))
    frame._nodes, frame._turned = {"straight": True}, {}

    def arguments(azimuth: float, elevation: float, survey: Any) -> dict[str, Any]:
        looks = survey.instrument.receiver
        asked.append((azimuth, elevation, looks.azimuth, looks.elevation))
        return {"number": len(asked)}

    frame._arguments = arguments

    def turned(*turn: float) -> Any:
        values = np.array(turn)
        return frame._nodes_of(Shape(0.3, 0.02, 0.5, np.zeros(0), np.zeros(0), values))

    assert turned() == {"straight": True}
    assert turned(0.0, 0.0) == {"straight": True}
    assert turned(0.01, -0.02) == {"number": 1}
    assert asked == [(1.0, 2.0, pytest.approx(0.21), pytest.approx(-0.12))]
    assert turned(0.01, -0.02) == {"number": 1}
    # Of eight directions kept, all are dropped for a ninth.
    for k in range(2, 9):
        assert turned(0.01 * k, 0.0) == {"number": k}
    assert turned(0.01, -0.02) == {"number": 1}
    assert turned(0.09, 0.0) == {"number": 9}
    assert turned(0.01, -0.02) == {"number": 10}


def test_spatial_frequencies_integrate_a_gaussian_with_its_oscillations() -> None:
    for aside in (0.0, 3.0, 15.0):
        rate, weight = overlap._frequencies(max(aside, 0.1))
        # The Hankel transform of a Gaussian is a Gaussian.
        found = np.sum(weight * rate * np.exp(-(rate**2) / 4) * j0(aside * rate))
        assert found == pytest.approx(2 * np.exp(-(aside**2)), abs=1e-8)
    # Ten panels of ten nodes, the wider ones in parts of 18 rad: 2 x 9 and 3 x 6.
    sizes = [overlap._frequencies(aside)[0].size for aside in (1.0, 17.9, 18.1)]
    assert sizes == [100, 150, 170]


def test_lost_light_is_the_mean_of_what_a_transform_lacks() -> None:
    function = henyey_greenstein_function(asymmetry=0.9)
    split = 1.0
    found = overlap._lost(function, split)
    x = 0.02 * np.exp(np.arange(len(found)) / 8)
    assert x[-2] < 3e3 <= x[-1] * (1 + 1e-9)
    for k in (0, 16, 40, 64):
        lost = quad(
            lambda y: float(1 - function.hankel(np.array([y]), split_angle=split)[0]),
            0, x[k], limit=400,
        )[0]  # fmt: skip
        assert np.exp(found[k]) == pytest.approx(lost / x[k], rel=2e-3)


def test_nodes_of_scattered_light_reach_all_depths() -> None:
    function = henyey_greenstein_function(asymmetry=0.9)
    light = Scattered(function, 1.0, radius=0.02, angle=0.05, standoff=0.3)
    # Half of where aperture and field of view are equal, in steps of 0.04 of asinh.
    assert light._length == pytest.approx(0.2)
    assert_allclose(np.diff(np.arcsinh(light.depth / 0.2)), 0.04)
    assert light.depth[0] == pytest.approx(0.2 * math.sinh(0.04))
    assert light.depth[-2] < 2200 <= light.depth[-1]
    assert light._peak == pytest.approx(np.pi * (0.02 * 0.05) ** 2)
    assert light.fraction == pytest.approx(function.forward_split(1.0)[0])
    narrow = Scattered(function, 1.0, radius=1e-6, angle=0.5, standoff=0.0)
    assert narrow._length == 1e-3


def test_light_far_aside_of_the_view_is_not_counted() -> None:
    function = henyey_greenstein_function(asymmetry=0.9)
    light = Scattered(function, 1.0, radius=0.02, angle=0.05, standoff=0.0)
    width = np.sqrt(light._area)
    depth = light.depth[[20, 60, 100]]
    words: dict[str, Any] = {"forward_scattering": 0.5, "spread": 0.02}
    offset = np.stack([0 * width, 19.99 * width, 20.01 * width])
    found = light.light(depth, offset=offset, **words)
    assert (found[0] > found[1]).all()
    assert (found[1] >= 0).all()
    assert_allclose(found[2], 0)
    # At the surface nothing is scattered.
    assert_allclose(light.light(np.zeros(1), offset=offset, **words), 0, atol=1e-15)
    # The same again, from what is known.
    assert_allclose(light.light(depth, offset=offset, **words), found)
    other = light.light(depth, offset=offset, forward_scattering=0.25, spread=0.01)
    assert other[0, 0] < found[0, 0]
    # Beams that come later extend the series, and change nothing of it.
    near = Scattered(function, 1.0, radius=0.02, angle=0.05, standoff=0.0)
    alone = near.light(depth, offset=offset[:1], **words)
    assert_allclose(alone, found[:1], rtol=1e-4)
    near.light(depth, offset=5 * offset[:1] + 3 * width, **words)
    assert_allclose(near.light(depth, offset=offset[:1], **words), alone, rtol=1e-4)


def test_directions_interpolate_at_the_middle_of_the_scan() -> None:
    directions = Directions(
        np.array([0.0, 0.1, 0.2]), np.array([0.0, 0.05]), (0.15, 0.025)
    )
    azimuth, elevation = directions.mesh
    for power, other in ((0, 0), (1, 1), (2, 0)):
        values = azimuth**power * elevation**other
        assert directions.centre @ values == pytest.approx(0.15**power * 0.025**other)
