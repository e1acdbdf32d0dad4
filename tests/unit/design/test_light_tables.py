"""Tables of light for a design: nodes, knots, places and looks, each by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.design import geometry, light
from amulor.design.light import case_of, lit
from amulor.errors import SurveyError
from amulor.survey import Survey, water_properties

PLACE = np.linspace(math.log(5e-3), math.log(8.0), 64)
DEPTH = np.array([1.0, 2.5])


def nodes(
    rate: list[float], *, farthest: float = 6.0, end: float | None = None
) -> tuple[Any, np.ndarray]:
    """Return nodes along the water, and their depths."""
    found = light._nodes(PLACE, DEPTH, farthest, np.array(rate), end=end)
    return found, np.exp(PLACE[found.segment] + found.within)


def test_nodes_are_a_quadrature_up_to_each_depth() -> None:
    rate = [0.0, 3.0, 40.0]
    found, depth = nodes(rate)
    assert found.weight.sum() == pytest.approx(6.0)
    for stop, limit in zip(found.stop, DEPTH, strict=True):
        assert found.weight[:stop].sum() == pytest.approx(limit)
        assert depth[stop - 1] < limit < depth[stop]
    # Phasors of the longest and the shortest wave are summed exactly.
    summed = found.weight @ found.turn
    expected = [6.0, *((np.exp(6j * k) - 1) / (1j * k) for k in rate[1:])]
    assert_allclose(summed, expected, rtol=1e-7)
    # In front of the first knot the light is that of the knot.
    assert found.segment.min() == 0
    assert found.segment.max() <= 62
    assert found.within.min() == 0
    assert np.all(found.within <= PLACE[1] - PLACE[0] + 1e-12)
    assert np.all(np.diff(depth) >= 0)


def test_panels_grow_by_a_third_up_to_a_turn_of_the_wave() -> None:
    few, depth = nodes([0.0])
    edges = depth[::6]
    assert np.all(edges[2:] / edges[1:-1] < 1.31)
    # ln(6 / 0.005) / ln 1.3 = 27.02, with 2 depths and the first panel: 31.
    assert few.weight.size == 6 * 31
    fast, depth = nodes([100.0])
    assert np.diff(depth[::6]).max() < 2.5 / 100 * 1.2
    assert fast.weight.size > 6 * 6 / (2.5 / 100)


def test_water_ends_at_a_panel() -> None:
    found, depth = nodes([0.0], end=1.7)
    assert found.weight.sum() == pytest.approx(1.7)
    assert not found.weight[depth > 1.7].any()
    beyond, _ = nodes([0.0], end=7.0)
    assert beyond.weight.sum() == pytest.approx(6.0)
    assert beyond.weight.size == nodes([0.0])[0].weight.size


def knots(monkeypatch: pytest.MonkeyPatch, overlap: Any) -> tuple[Any, Any]:
    monkeypatch.setattr(
        light, "_log_overlap", lambda *words: overlap(np.log(words[-1]))
    )
    nothing: Any = None
    return light._knots(nothing, nothing, nothing, 20.0)


def test_a_straight_overlap_has_64_knots(monkeypatch: pytest.MonkeyPatch) -> None:
    place, value = knots(monkeypatch, lambda x: np.stack([-x, 2 * x]))
    assert_allclose(place, np.linspace(math.log(5e-3), math.log(20.0), 64))
    assert_allclose(value, [-place, 2 * place])


@pytest.mark.parametrize(("slope", "more"), [(0.70, 0), (0.85, 6)])
def test_bends_have_knots_in_quarters(
    monkeypatch: pytest.MonkeyPatch, slope: float, more: int
) -> None:
    step = math.log(20.0 / 5e-3) / 63
    bend = math.log(5e-3) + 20 * step
    # A second difference of the slope times the step of 0.1316.
    place, value = knots(monkeypatch, lambda x: -slope * np.maximum(x - bend, 0)[None])
    assert place.size == 64 + more
    assert_allclose(value[0], -slope * np.maximum(place - bend, 0))
    assert np.all(np.diff(place) > 0)
    if more:
        assert_allclose(np.diff(place)[19:27], step / 4)


def test_bends_of_negligible_light_do_not_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step = math.log(20.0 / 5e-3) / 63
    bend = math.log(5e-3) + 40 * step

    def falling(x: np.ndarray) -> np.ndarray:
        return np.where(x < bend, 0.0, -25.0 - 9 * (x - bend))[None]

    place, _ = knots(monkeypatch, falling)
    assert place.max() == pytest.approx(math.log(20.0))
    # At the fall alone.
    assert 64 < place.size <= 64 + 9


def test_candidates_share_places_and_looks(tank: Survey) -> None:
    case = case_of(tank, water_properties(tank))
    baseline = np.array([0.1, 0.3, 0.1])[:, None]
    radius = np.array([[0.01, 0.02]])
    values = {"baseline": baseline, "radius": radius, "distance": np.array(2.0)}
    places, place = light._places(case, values, np.array([2.0]))
    assert len(places) == 2
    assert place.ravel().tolist() == [0, 1, 0]
    by_axis = light.values_on_axes(case, values)
    looks, look = light._looks(case, by_axis, places, place)
    assert look.shape == (3, 2)
    assert_array_equal(look[0], look[2])
    assert len(set(look.ravel().tolist())) == 4
    for row, column in np.ndindex(3, 2):
        number = look[row, column]
        assert looks.radius[number] == radius[0, column]
        far = places[place.ravel()[row]]
        assert looks.baseline[number] == pytest.approx(float(far.view.baseline))
        assert looks.tilt[number] == pytest.approx(float(far.view.tilt))
        assert_allclose(looks.back[number], far.back)
    assert_allclose(looks.acceptance, 0.06)
    assert_allclose(looks.absorption, 0.1)
    assert_allclose(looks.scattering, 0.25)
    still, index = light._places(case, {"distance": np.array(2.0)}, np.array([2.0]))
    assert (len(still), index.shape) == (1, ())


def test_light_has_a_version_for_each_parameter_of_the_water(tank: Survey) -> None:
    case = case_of(tank, water_properties(tank))
    values = {"distance": np.array([3.0, 1.0, 3.0])}
    found = lit(case, values, np.array([39e6, np.nan, 10e6, 39e6]), joint=True)
    assert found.light.frequency.tolist() == [10e6, 39e6]
    assert found.reach.tolist() == [1, 0, 1]
    water = found.light.water
    assert water.shape == (3, 1, 3, 2)
    assert found.light.mean.shape == (1, 3)
    assert found.light.step == 1e-3
    # A thousandth more absorption takes up to 2 m x 0.1 1/m x 0.001 twice.
    lost = 1 - np.abs(water[1, 0, 1] / water[0, 0, 1])
    assert np.all((lost > 1e-5) & (lost < 2 * 3 * 0.1e-3))
    assert np.all(np.abs(water[2] / water[0] - 1) < 1e-3)
    assert np.any(water[2] != water[0])
    assert_allclose(found.bent, found.light.overlap * 0 + case.water.second_moment
                    * 0.25 * np.array([1.0, 3.0]))  # fmt: skip
    assert found.late.shape == (1, 2)
    assert found.late.any()
    plain = lit(case, values, np.array([39e6]), joint=False, late=False)
    assert plain.light.water.shape == (1, 1, 3, 1)
    assert not plain.late.any()
    expected = geometry.place_of(tank, np.array([1.0, 3.0]))
    assert_allclose(plain.light.path[0], expected.path)
    assert_allclose(plain.light.slope[0], expected.slope)
    assert isinstance(plain.places[0], geometry.Place)


def test_a_target_before_the_water_is_refused(tank: Survey) -> None:
    window = {
        "distance": 0.2, "thickness": 0.02, "refractive_index": 1.5, "group_index": 1.5
    }  # fmt: skip
    behind = tank.with_({"instrument.window": window})
    case = case_of(behind, water_properties(behind))
    with pytest.raises(
        SurveyError, match=r"distance: 0\.2 m lies before the water, which begins at"
    ):
        lit(case, {"distance": np.array([0.2])}, np.array([39e6]), joint=False)
