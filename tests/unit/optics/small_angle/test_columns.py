"""Tables, panels and sums of water columns, each by itself, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import legendre
from numpy.polynomial.polynomial import polyval
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.special import j0, j1

from amulor.optics import small_angle, small_angle_closure
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.small_angle import _columns, _kernels, sharp_receiver
from amulor.optics.small_angle._columns import Column, Table, looks
from amulor.optics.small_angle.gaussian_receiver import overlap, water_response

WATER = henyey_greenstein_function(asymmetry=0.95)
COLUMN = Column(
    absorption=0.1, scattering=0.4, baseline=0.2, receiver_radius=0.02,
    acceptance_angle=0.08, beam_radius=0.003, beam_divergence=0.002, tilt=0.01,
    cross_tilt=-0.02, standoff=0.3, end=9.0,
)  # fmt: skip
ARGUMENTS = COLUMN._asdict() | {"phase_function": WATER, "split_angle": np.pi / 2}


# ------------------------------------------------------------------- phase functions


def test_a_table_is_equal_to_itself_alone() -> None:
    one, other = (Table(1.5, 0.9, np.ones((2, 10))) for _ in range(2))
    assert [one, other].index(other) == 1
    assert (one == other) is False
    assert hash(one) == id(one)


def test_spread_by_a_transform_is_the_integral_of_what_it_lost() -> None:
    # 1 - h(u) = u^2 / 2 + 3 u^3 / 4 has the integral x^3 (1 / 6 + 3 x / 16).
    def transform(u, *, split_angle):
        assert split_angle == 1.25
        return 1 - u**2 / 2 - 0.75 * u**3

    edge = np.array([0.0, 0.5, 2.0, 2.5])
    x = np.array([[0.1, 0.4], [0.7, 1.9], [2.2, 2.5]])
    found = _columns._spread_by_transform(transform, edge, x, 1.25)
    assert_allclose(found, 1 / 6 + 3 * x / 16, rtol=1e-12)


@pytest.mark.parametrize(("at_zero", "good"), [(1 + 9e-7, True), (1 - 1.2e-6, False)])
def test_a_transform_is_one_at_zero_within_a_millionth(
    at_zero: float, good: bool
) -> None:
    def transform(u, *, split_angle):
        return at_zero + 0 * u

    edge, x = np.array([0.0, 1.0]), np.array([[0.5]])
    if good:
        _columns._spread_by_transform(transform, edge, x, 1.0)
        return
    with pytest.raises(ValueError, match=r"must be 1 at frequency 0, got 0\.999999"):
        _columns._spread_by_transform(transform, edge, x, 1.0)


@pytest.mark.parametrize("split", [0.6, np.pi / 2])
def test_a_table_is_the_mean_of_the_transform(split: float) -> None:
    table = _columns.table(WATER, split)
    assert table.split == split
    assert_allclose(table.fraction, WATER.forward_split(split)[0], rtol=1e-9)
    unit, linear, per = _kernels.WIDTH / split, _kernels.LINEAR, _kernels.PER_OCTAVE
    assert len(table.cells) == linear + 16 * per

    def lost(x: float) -> float:
        node, weight = legendre.leggauss(400)
        u = x * (node + 1) / 2
        return float(weight / 2 @ (1 - WATER.hankel(u, split_angle=split)) / x**2)

    for cell, s in ((0, 0.3), (3, -0.6), (linear - 1, 0.9)):
        x = unit * (cell + (s + 1) / 2)
        assert_allclose(polyval(s, table.cells[cell]), lost(x), rtol=1e-6)
    for cell, s in ((linear, -0.5), (linear + 2, 0.4)):
        # From there on a cell is a step of a scale of octaves.
        x = unit * linear * 2 ** ((cell - linear + (s + 1) / 2) / per)
        assert_allclose(polyval(s, table.cells[cell]), lost(x), rtol=1e-6)


def test_a_function_without_a_transform_has_the_same_table() -> None:
    def plain(angle):
        return WATER(angle)

    expected = _columns.table(WATER, 1.2)
    found = _columns._computed_table(plain, 1.2)
    assert_allclose(found.fraction, expected.fraction, rtol=1e-9)
    assert_allclose(found.cells[:, 0], expected.cells[:, 0], rtol=1e-6)
    assert _columns.table(WATER, 1.2) is expected
    assert _columns.table(plain, 1.2) is _columns.table(plain, 1.2)


@pytest.mark.parametrize("power", [-1.5, 0.0, 2.0])
def test_the_rule_of_angles_integrates_powers_between_its_ends(power: float) -> None:
    low, high = np.array([1e-3, 0.2]), np.array([2e-3, 0.3])
    angle, weight = _columns._angle_rule(low, high)
    assert angle.shape == weight.shape == (2, 16)
    found = np.sum(weight * angle**power, axis=1)
    expected = (high ** (power + 1) - low ** (power + 1)) / (power + 1)
    assert_allclose(found, expected, rtol=1e-13)
    assert np.all((angle >= low[:, None]) & (angle <= high[:, None]))


def test_density_of_angles_has_the_ring_of_the_sphere() -> None:
    angle = np.array([[0.3, 1.0], [2.0, 3.0]])
    found = _columns._density(lambda x: 0.5 + 0 * x, angle)
    assert_allclose(found, np.pi * np.sin(angle), rtol=1e-15)


def test_panels_of_angles_meet_the_ends_and_narrow_at_a_kink() -> None:
    kink = 0.3

    def density(angle):
        return np.where(angle < kink, 1.0, 3.0)

    edges = _columns._angle_panels(density, 0.7)
    assert edges[0] == 1e-18
    assert edges[-1] == 0.7
    assert np.all(np.diff(edges) > 0)
    assert edges.size < 200
    near = np.searchsorted(edges, kink)
    assert edges[near] / edges[near - 1] - 1 < 1e-8
    # Elsewhere a panel is at most a factor of e wide.
    assert np.log(edges[1:] / edges[:-1]).max() <= 1.0


def test_table_of_the_mean_bessel_function_is_its_integral() -> None:
    table = _columns._mean_table()
    assert len(table) == _kernels.FAR
    for cell, s in ((0, -0.999), (0, -0.95), (0, 0.5), (1, -1.0), (7, 0.3)):
        x = cell + (s + 1) / 2
        # 1 - J0 = x^2 / 4 - x^4 / 64 + ..., by its integral.
        if x < 0.03:
            expected = 1 / 12 - x**2 / 320
        else:
            expected = quad(lambda u: 1 - j0(u), 0, x, epsabs=1e-14)[0] / x**3
        assert_allclose(polyval(s, table[cell]), expected, rtol=1e-9)


def test_table_of_a_disc_is_its_transform() -> None:
    for cell, s in ((0, -0.5), (4, 0.2), (25, 0.9)):
        x = cell + (s + 1) / 2
        assert_allclose(polyval(s, _columns.disc()[cell]), 2 * j1(x) / x, atol=1e-13)


# ------------------------------------------------------------------------ integrals


def test_integral_of_panels_keeps_the_order_of_the_phases() -> None:
    node, _, _ = _columns.depth_rule()
    edges = np.array([[0.0, 0.5], [0.5, 2.0]])
    depth = edges[:, :1] + np.diff(edges) * (node + 1) / 2
    phases = np.array([4.0, 0.0, 30.0, 1.0])
    found = _columns.integral(phases, edges, np.exp(-depth))
    rate = 1 - 1j * phases
    assert_allclose(found, (1 - np.exp(-2 * rate)) / rate, rtol=1e-12)


def test_rule_of_a_panel_has_the_last_four_terms_of_its_series() -> None:
    node, weight, tail = _columns.depth_rule()
    assert_allclose(weight @ node**4, 2 / 5, rtol=1e-13)
    last = [legendre.Legendre.basis(degree)(node) for degree in (27, 28, 29, 30, 31)]
    assert_allclose(last @ tail, np.eye(5)[:, 1:], atol=1e-11)


def panels_of(light, on_axis=np.ones_like, **changes):
    """Return edges, values and sum of panels of light over depth."""
    options = {
        "loss": 0.0, "length": 1.0, "step": 0.5, "end": 40.0, "partial_sum": 0.0,
    } | changes  # fmt: skip
    return _columns.panels(light, on_axis, **options)


def test_panels_of_smooth_light_double_from_the_first_step_to_the_end() -> None:
    edges, values, total = panels_of(lambda z: np.exp(-z / 100))
    order = np.argsort(edges[:, 0])
    limits = [0, 0.5, 1.5, 4.5, 13.5, 40.0]
    assert_allclose(edges[order], np.stack([limits[:-1], limits[1:]], axis=1))
    assert values.shape == (5, 32)
    node, _, _ = _columns.depth_rule()
    depth = edges[:, :1] + np.diff(edges) * (node + 1) / 2
    assert_allclose(values, np.exp(-depth / 100), rtol=1e-14)
    assert_allclose(total, 100 * (1 - np.exp(-0.4)), rtol=1e-12)


def test_panels_of_water_that_absorbs_are_at_most_twelve_lengths_of_loss() -> None:
    edges, _, total = panels_of(lambda z: np.exp(-0.6 * z), loss=0.6, step=30.0)
    assert_allclose(edges[np.argsort(edges[:, 0])], [[0, 20], [20, 40]])
    assert_allclose(total, (1 - np.exp(-24)) / 0.6, rtol=1e-9)


def test_light_need_not_be_smooth_at_stated_breaks() -> None:
    def light(z):
        return np.where(z < 2.0, 1.0, 0.25)

    edges, _, total = panels_of(light, breaks=(2.0, 0.0, 90.0))
    assert_allclose(np.sort(edges[:, 1]), [0.5, 1.5, 2.0, 4.5, 13.5, 40.0])
    assert_allclose(total, 2 + 38 / 4, rtol=1e-12)


def test_panels_are_halved_where_light_is_not_smooth() -> None:
    edges, _, total = panels_of(lambda z: np.where(z < 0.9, 1.0, 0.5))
    # The tolerance is 1e-8 of the sum, in the last terms of the series.
    assert_allclose(total, 0.9 + 39.1 / 2, rtol=1e-7)
    edges = edges[np.argsort(edges[:, 0])]
    assert_array_equal(edges[1:, 0], edges[:-1, 1])
    widths = np.diff(edges).ravel()
    halved = widths < 0.49
    assert halved.sum() > 10
    steps = np.log2(1.0 / widths[halved])
    assert_allclose(steps, np.round(steps), atol=1e-9)
    # Beside light that was summed before, less counts.
    fewer, _, _ = panels_of(lambda z: np.where(z < 0.9, 1.0, 0.5), partial_sum=1e5)
    assert len(fewer) < len(edges)


@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_panels_end_where_the_rest_of_the_light_no_longer_counts(loss: float) -> None:
    def on_axis(z):
        return 1 / (1 + z) ** 4

    edges, _, total = panels_of(
        lambda z: on_axis(z) * np.exp(-loss * z), on_axis, loss=loss, end=1e9
    )
    expected = quad(lambda z: on_axis(z) * np.exp(-loss * z), 0, np.inf)[0]
    assert_allclose(total, expected, rtol=2e-8)
    # The rest reaches as far as the depth itself, or the length of the loss.
    last = edges[:, 1].max()
    lost = {
        z: on_axis(z) * np.exp(-loss * z) * min(z + 1, 1 / loss if loss else np.inf)
        for z in (last, last / 1.25)
    }
    assert lost[last] <= 1e-8 * total < lost[last / 1.25] * 1.25**5


def test_light_that_is_never_smooth_is_named_with_its_depth() -> None:
    rng = np.random.default_rng(1)
    text = (
        r"^the water column does not settle about [\d.e-]+ m; receiver_radius or "
        r"acceptance_angle may be far too small$"
    )
    with pytest.raises(ArithmeticError, match=text):
        panels_of(lambda z: rng.uniform(size=z.size))


# ---------------------------------------------------------------------------- views


def test_views_that_stand_for_all_are_the_extremes_and_three_between() -> None:
    view = np.zeros((9, 2))
    view[2, 0], view[3, 1], view[5, 0], view[7, 1] = 1.0, -1.0, -2.0, 3.0
    assert_array_equal(_columns._spread(view), [0, 2, 3, 4, 5, 7, 8])


def test_edges_that_differ_by_rounding_are_one() -> None:
    edges = np.array([[0.0, 1.0], [1.0 + 5e-7, 4.0], [2.0, 3.0], [4.0 - 1e-5, 5.0]])
    found = _columns._common(edges)
    limits = [0, 1, 2, 3, 4 - 1e-5, 4, 5]
    assert_allclose(found, np.stack([limits[:-1], limits[1:]], axis=1), rtol=1e-12)


@pytest.mark.parametrize("count", [63, 80])
def test_many_columns_are_what_each_is_alone(count: int) -> None:
    baseline = np.linspace(0.0, 0.5, count)
    water = ARGUMENTS | {"group_index": 1.38}
    frequency = np.array([60e6, 0.0, 140e6])
    found = water_response(frequency[:, None], **water | {"baseline": baseline})
    for k in (0, count // 3, count - 2):
        alone = water_response(frequency, **water | {"baseline": baseline[k]})
        assert_allclose(found[:, k], alone, rtol=3e-5)


def test_the_look_of_depths_is_a_row_each() -> None:
    rows = looks(np.array([1.0, 2.0]), COLUMN._replace(baseline=np.array([0.5, 0.6])))
    expected = [[1.0, 0.5, 0.01, -0.02, 0.3], [2.0, 0.6, 0.01, -0.02, 0.3]]
    assert_array_equal(rows, expected)
    assert COLUMN.look() == {
        "baseline": 0.2, "tilt": 0.01, "cross_tilt": -0.02, "standoff": 0.3,
    }  # fmt: skip
    varied = COLUMN._replace(tilt=np.array([0.1, 0.2])).look()
    assert varied == dict.fromkeys(varied, 0.0)


def test_light_is_lost_both_ways_but_for_what_is_scattered_forward() -> None:
    spread = Table(1.5, 0.75, np.ones((1, 10)))
    assert_allclose(COLUMN.loss(spread), 2 * (0.1 + 0.4 * 0.25), rtol=1e-14)


def test_depths_of_equal_columns_are_worked_out_together() -> None:
    assert _columns._equal_columns([], 0) == []
    assert_array_equal(_columns._equal_columns([], 3), [[0, 1, 2]])
    first, second = np.array([1.0, 2, 1, 2, 1]), np.array([5.0, 5, 5, 6, 5])
    groups = _columns._equal_columns([first, second], 5)
    assert [list(group) for group in groups] == [[0, 2, 4], [1], [3]]


def test_depths_in_several_waters_are_what_each_is_alone() -> None:
    water = {name: value for name, value in ARGUMENTS.items() if name != "end"}
    depth = np.array([[0.5], [1.5], [4.0]])
    varied = {"scattering": np.array([0.4, 0.2]), "tilt": np.array([0.01, 0.03])}
    found = overlap(depth, **water | varied)
    assert found.shape == (3, 2)
    for k in range(2):
        own = {name: value[k] for name, value in varied.items()}
        alone = overlap(depth[:, 0], **water | own)
        assert_allclose(found[:, k], alone, rtol=1e-10)


@pytest.mark.parametrize("model", [small_angle, sharp_receiver, small_angle_closure])
def test_water_and_surfaces_lie_before_the_receiver(model) -> None:
    water = ARGUMENTS | {"standoff": -0.1, "group_index": 1.38}
    text = r"^standoff must be finite and not negative \[m\], got -0\.1$"
    with pytest.raises(ValueError, match=text):
        model.water_response(1e7, **water)
    surface = {
        name: water[name] for name in water if name not in ("end", "group_index")
    }
    if model is not small_angle:
        surface |= {"beam_radius": 0.0, "beam_divergence": 0.0}
    assert np.all(model.overlap([0.1, 0.5], **surface) >= 0)
    text = r"^depth \+ standoff must be finite and not negative \[m\], got -0\.05 at "
    with pytest.raises(ValueError, match=text):
        model.overlap([0.5, 0.05], **surface)


@pytest.mark.parametrize("model", [small_angle, sharp_receiver, small_angle_closure])
def test_backscatter_is_scattering_times_the_phase_function_unless_stated(
    model,
) -> None:
    water = ARGUMENTS | {"group_index": 1.38}
    found = model.water_response([0.0, 4e7], **water)
    at_180 = (1 - 0.95**2) / (4 * np.pi * 1.95**3)
    stated = model.water_response([0.0, 4e7], **water, backscatter_vsf=0.4 * at_180)
    assert_allclose(found, stated, rtol=1e-9)
    twice = model.water_response(
        [0.0, 4e7], **water, backscatter_vsf=[[0.8 * at_180], [0.4 * at_180]]
    )
    assert_allclose(twice, np.array([[2], [1]]) * found, rtol=1e-9)


def test_frequencies_and_pixels_may_stand_on_any_axes() -> None:
    water = ARGUMENTS | {"group_index": 1.38}
    frequency, baseline = np.array([6e7, 2e7, 9e7]), np.array([0.1, 0.3])
    alone = np.array(
        [
            [
                small_angle.water_response(f, **water | {"baseline": b})
                for f in frequency
            ]
            for b in baseline
        ]
    )
    for shape, other in (((3, 1), (2,)), ((3,), (2, 1)), ((1, 3), (2, 1, 1))):
        found = small_angle.water_response(
            frequency.reshape(shape), **water | {"baseline": baseline.reshape(other)}
        )
        expected = alone.T if shape == (3, 1) else alone
        expected = expected.reshape(np.broadcast_shapes(shape, other))
        assert_allclose(found, expected, rtol=1e-6)
    # One frequency for each pixel.
    found = small_angle.water_response(frequency[:2], **water | {"baseline": baseline})
    assert_allclose(found, np.diag(alone[:, :2]), rtol=1e-6)
