"""Sharp receiver in small-angle form: plain quadrature, closed limits, invariances."""

from functools import cache, partial
from importlib import resources
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import sharp_receiver_2d as oracle
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light
from scipy.integrate import quad
from scipy.special import exp1, hyp2f1

from amulor.optics import small_angle
from amulor.optics.phase_functions import henyey_greenstein
from amulor.optics.phase_functions.models import fournier_forand
from amulor.optics.phase_functions.tables import petzold
from amulor.optics.small_angle import sharp_receiver as small_angle_sharp_receiver

TESTS = Path(__file__).parents[1]
SPLIT = np.pi / 2
FREQUENCIES = np.array([0.0, 5e6, 40e6, 150e6])
INSTRUMENT = {"baseline": 0.2, "receiver_radius": 0.02, "acceptance_angle": 0.08}
CLEAR = {"absorption": 0.3, "scattering": 0.0}
PEAKED = partial(henyey_greenstein, asymmetry=0.97)


def two_peaks(angle):
    """Return a sum of two peaks, sharp and broad."""
    sharp = henyey_greenstein(angle, asymmetry=0.99)
    return 0.7 * sharp + 0.3 * henyey_greenstein(angle, asymmetry=0.75)


PHASE_FUNCTIONS = {
    "Henyey-Greenstein": PEAKED,
    "two terms": two_peaks,
    "Fournier-Forand": fournier_forand(relative_index=1.1, slope=3.5835),
    "Petzold": petzold("HAOCE 11"),
}


@cache
def mean_transform(name):
    """Return what the plain quadrature needs of a phase function."""
    kinks = ()
    if name == "Petzold":
        source = resources.files("amulor.optics").joinpath("data")
        with source.joinpath("petzold_1972_vsf.csv").open() as table:
            kinks = tuple(np.radians(np.loadtxt(table, delimiter=",")[:, 0]))
    return oracle.mean_transform(PHASE_FUNCTIONS[name], SPLIT, kinks=kinks)


def overlap(depth, phase_function=PEAKED, **column):
    """Return F(z) of the package with the split of these tests."""
    return small_angle_sharp_receiver.overlap(
        depth, phase_function=phase_function, split_angle=SPLIT, **column
    )


def response(frequency, phase_function=PEAKED, **column):
    """Return the response of the package for backscatter_vsf 1 and index 1.34."""
    return small_angle_sharp_receiver.water_response(
        frequency,
        phase_function=phase_function,
        split_angle=SPLIT,
        backscatter_vsf=1.0,
        group_index=1.34,
        **column,
    )


# ------------------------------------------------------------- plain quadrature

COLUMNS = [
    (
        "Henyey-Greenstein",
        {
            "absorption": 0.15,
            "scattering": 0.35,
            "baseline": 0.2,
            "receiver_radius": 0.02,
            "acceptance_angle": 0.08,
        },
    ),
    (
        "two terms",
        {
            "absorption": 0.3,
            "scattering": 1.2,
            "baseline": 0.1,
            "receiver_radius": 0.05,
            "acceptance_angle": 0.2,
            "tilt": 0.03,
            "cross_tilt": 0.01,
            "standoff": 0.2,
            "end": 4.0,
        },
    ),
    (
        "Fournier-Forand",
        {
            "absorption": 0.2,
            "scattering": 0.8,
            "baseline": 0.07,
            "receiver_radius": 0.008,
            "acceptance_angle": 0.05,
            "beam_radius": 0.003,
            "beam_divergence": 0.002,
        },
    ),
    (
        "Petzold",
        {
            "absorption": 0.3,
            "scattering": 0.4,
            "baseline": 0.0,
            "receiver_radius": 0.02,
            "acceptance_angle": 0.02,
            "end": 3.0,
        },
    ),
]


@pytest.mark.parametrize(
    ("name", "column"),
    [
        pytest.param(*case, marks=[] if case[0] == "two terms" else [pytest.mark.slow])
        for case in COLUMNS
    ],
)
def test_response_agrees_with_plain_quadrature(name, column):
    expected = oracle.water_response(
        FREQUENCIES, *mean_transform(name), SPLIT, group_index=1.34, **column
    )
    found = response(FREQUENCIES, PHASE_FUNCTIONS[name], **column)
    # The promise of the docstring.
    assert_allclose(found, expected, rtol=0, atol=1e-6 * expected[0].real)


@pytest.mark.slow
@pytest.mark.parametrize("name", PHASE_FUNCTIONS)
@pytest.mark.parametrize("radius", [1e-3, 7e-3, 0.05])
@pytest.mark.parametrize("acceptance", [5e-3, 0.2])
@pytest.mark.parametrize("baseline", [0.0, 0.3])
def test_overlap_agrees_with_plain_quadrature(name, radius, acceptance, baseline):
    column = {
        "absorption": 0.15,
        "scattering": 0.35,
        "baseline": baseline,
        "receiver_radius": radius,
        "acceptance_angle": acceptance,
    }
    for depth in (1.0, 5.0):
        expected = oracle.unscattered(depth, column) + oracle.collected(
            depth, column, *mean_transform(name), SPLIT, turns=2e4, last=1e3
        )
        found = overlap(depth, PHASE_FUNCTIONS[name], **column)
        # Light far off the axis is what is left of waves that cancel, and the tables
        # of the transform of the phase function are good to about 1e-10 on both sides.
        on_axis = np.pi * (radius * acceptance / max(radius, acceptance * depth)) ** 2
        assert_allclose(found, expected, rtol=1e-6, atol=3e-10 * on_axis)


# ------------------------------------------------------------- closed limits


def test_two_equal_discs_that_pass_through_their_centres_share_what_euclid_knew():
    # Baseline, radius and acceptance times depth are all 5 cm.
    found = overlap(
        0.5, **CLEAR, baseline=0.05, receiver_radius=0.05, acceptance_angle=0.1
    )
    shared = (2 * np.pi / 3 - np.sqrt(3) / 2) * 0.05**2
    # An area times exp(-2 a z) over the squared depth, in closed form.
    assert_allclose(found, shared / 0.5**2 * np.exp(-0.3), rtol=1e-14)


def test_coaxial_receiver_in_clear_water_is_an_exponential_integral():
    edge = 0.02 / 0.08
    rate = 2 * 0.3 - 4j * np.pi * FREQUENCIES * 1.34 / speed_of_light
    near = np.pi * 0.08**2 * -np.expm1(-rate * edge) / rate
    far = np.pi * 0.02**2 * (np.exp(-rate * edge) / edge - rate * exp1(rate * edge))
    found = response(FREQUENCIES, **CLEAR, **INSTRUMENT | {"baseline": 0.0})
    # Up to R / gamma the whole cone is used, beyond it the whole aperture.
    assert_allclose(found, near + far, rtol=0, atol=1e-8 * (near + far)[0].real)


@pytest.mark.parametrize("tilt", [0.0, 0.06])
def test_without_scattering_it_is_the_integral_of_shared_areas(tilt):
    column = CLEAR | INSTRUMENT | {"tilt": tilt}
    cuts = sorted(oracle.edges_of_view(column, 30.0))
    edges = [0.1 * min(cuts), *cuts, 3.0, 30.0]
    wave = 4 * np.pi * FREQUENCIES * 1.34 / speed_of_light
    expected = [
        sum(
            quad(
                lambda z, wheel=wheel, rate=rate: (
                    wheel(rate * z) * oracle.unscattered(z, column)
                ),
                low,
                high,
                epsabs=1e-14,
                epsrel=1e-10,
                limit=400,
            )[0]
            * unit
            for low, high in pairwise(edges)
            for wheel, unit in ((np.cos, 1.0), (np.sin, 1j))
        )
        for rate in wave
    ]
    found = response(FREQUENCIES, **column)
    # At 30 m, exp(-18) is left, and nothing is seen before the first edge.
    assert_allclose(found, expected, rtol=0, atol=3e-8 * abs(expected[0]))


def test_small_receiver_sees_what_a_gaussian_one_of_its_etendue_sees():
    errors = []
    for size in (0.04, 0.02, 0.01):
        column = {
            "absorption": 0.2,
            "scattering": 0.8,
            "baseline": 0.1,
            "receiver_radius": size,
            "acceptance_angle": size,
            "beam_radius": 0.3,
            "end": 1.0,
        }
        sharp = response(FREQUENCIES, **column)
        soft = small_angle.water_response(
            FREQUENCIES,
            phase_function=PEAKED,
            split_angle=SPLIT,
            backscatter_vsf=1.0,
            group_index=1.34,
            **column,
        )
        errors.append(np.max(np.abs(sharp - soft)) / soft[0].real)
    # Transforms 1 - (R kappa)^2 / 8 and 1 - (R kappa)^2 / 4: the rest goes with the
    # square of the size over that of the beam, here up to 2 (0.01 / 0.3)^2 / 2.
    assert errors[-1] < 1.2e-3
    assert_allclose(np.divide(errors[:-1], errors[1:]), 4, rtol=0.05)


def test_large_aperture_keeps_all_light_scattered_forward():
    share, _ = mean_transform("Henyey-Greenstein")
    reduced = 0.15 + 0.85 * (1 - share)
    rate = 2 * reduced - 4j * np.pi * FREQUENCIES * 1.34 / speed_of_light
    expected = np.pi * 1e-3**2 / rate
    found = response(
        FREQUENCIES,
        absorption=0.15,
        scattering=0.85,
        baseline=0.2,
        receiver_radius=1e4,
        acceptance_angle=1e-3,
    )
    # All of the cone is used; light spreads by metres, and the share that leaves an
    # aperture of 10 km beyond the split of 90 degrees is none. Gauss rules to 1e-8.
    assert_allclose(found, expected, rtol=0, atol=1e-7 * expected[0].real)


def test_first_order_in_scattering_is_single_scattering_in_real_space():
    # Once scattered light falls off by 2 b int p(theta) dtheta / rho from rho / z to
    # the split, so in polar coordinates about the beam it needs no transform.
    depth, b = 2.0, 1e-5
    baseline, radius, seen = 0.12, 0.03, 0.05
    lowest = 1e-9
    theta, weight = oracle.gauss(np.geomspace(lowest, SPLIT, 400), 10)
    density = weight * PEAKED(theta) * np.sin(theta) / theta
    beyond = np.cumsum(density[::-1])[::-1]
    # All distances at which the ring is tangent to the edges of the shared area.
    near, far = seen - radius, seen + radius
    cuts = [lowest, *(abs(baseline + s * d) for s in (-1, 1) for d in (near, far)), 2.0]
    rho, step = oracle.gauss(np.unique(np.append(cuts, np.geomspace(1e-6, 2, 80))), 10)
    starts = np.interp(np.log(rho / depth), np.log(theta), beyond - density / 2)
    turn, arc = oracle.gauss(np.linspace(0, np.pi, 200), 10)
    distance = np.sqrt(
        rho[:, None] ** 2 + baseline**2 - 2 * baseline * rho[:, None] * np.cos(turn)
    )
    grid = np.linspace(near, far, 4001)
    areas = [oracle.lens(d, radius, seen) for d in grid]
    shared = 2 * np.interp(distance, grid, areas, right=0.0) @ arc
    once = 2 * b * np.sum(step * starts * shared) / depth**2
    found = overlap(
        depth,
        absorption=0.0,
        scattering=b,
        baseline=baseline,
        receiver_radius=radius,
        acceptance_angle=seen / depth,
    )
    # The second order is b z, 2e-5, of the first; interpolated tables below 1e-5.
    assert_allclose(found, once, rtol=5e-5)


@pytest.mark.parametrize("scattering", [0.0, 0.7])
def test_wide_beam_is_a_bundle_of_thin_ones(scattering):
    column = {
        "absorption": 0.1,
        "scattering": scattering,
        "receiver_radius": 0.02,
        "acceptance_angle": 0.03,
    }
    depth, width = 1.0, 0.015
    stops = [1e-6, 0.01, 0.05, 0.09]  # edges of the view at 1 and 5 cm
    graded = [
        cut + s * 0.01 * 2.0**-k for cut in stops for s in (-1, 1) for k in range(9)
    ]
    edges = np.unique([0.0, *stops, *(x for x in graded if 0 < x < 0.09)])
    rho, weight = oracle.gauss(edges, 10)
    thin = overlap(depth, **column, baseline=rho)
    share = 2 * rho / width**2 * np.exp(-((rho / width) ** 2))
    found = overlap(depth, **column, baseline=0.0, beam_radius=width)
    # Beyond 9 cm exp(-36) of the bundle is left; the wide one uses no shared areas.
    assert_allclose(found, np.sum(weight * share * thin), rtol=1e-7)


def test_transform_that_falls_slowly_is_followed_to_its_end():
    class Slow:
        """Stand-in with a transform that falls like k^-1/2, a head like theta^-3/2."""

        def __call__(self, angle):
            return PEAKED(angle)

        def hankel(self, direction_frequency, *, split_angle):
            return (1 + (np.asarray(direction_frequency) / 3.0) ** 2) ** -0.25

    def mean(x):
        return hyp2f1(0.25, 0.5, 1.5, -((x / 3.0) ** 2))

    share, _ = mean_transform("Henyey-Greenstein")
    column = {
        "absorption": 0.1,
        "scattering": 0.6,
        "baseline": 0.05,
        "receiver_radius": 0.01,
        "acceptance_angle": 0.03,
    }
    for depth in (0.5, 3.0):
        expected = oracle.unscattered(depth, column) + oracle.collected(
            depth, column, share, mean, SPLIT, turns=3e4, last=1e3
        )
        found = overlap(depth, Slow(), **column)
        # The plain integral is cut off at 1e-7 of it.
        assert_allclose(found, expected, rtol=1e-6)


# ------------------------------------------------------------- drawn columns

columns = st.fixed_dictionaries(
    {
        "absorption": st.floats(0.02, 1.0),
        "scattering": st.floats(0.0, 3.0),
        "baseline": st.floats(0.0, 0.3),
        "receiver_radius": st.floats(0.001, 0.05),
        "acceptance_angle": st.floats(0.005, 0.2),
        "beam_radius": st.one_of(st.just(0.0), st.floats(1e-4, 0.03)),
        "beam_divergence": st.one_of(st.just(0.0), st.floats(1e-4, 0.05)),
        "tilt": st.floats(-0.1, 0.1),
        "cross_tilt": st.floats(-0.05, 0.05),
        "standoff": st.floats(0.0, 0.5),
    }
)
ends = st.one_of(st.just(np.inf), st.floats(0.5, 10.0))


def most(column):
    """Return more than the response of losses of 1 m length on the axis [m sr]."""
    return np.pi * column["acceptance_angle"] ** 2


@settings(max_examples=20)
@given(column=columns, end=ends, frequency=st.floats(0, 1e9))
def test_response_is_at_most_that_at_zero_frequency(column, end, frequency):
    at_zero, found = response([0.0, frequency], **column, end=end)
    assert at_zero.imag == 0
    assert abs(found) <= at_zero.real * (1 + 1e-6) + 1e-11 * most(column)


@settings(max_examples=40)
@given(column=columns, depth=st.floats(0.01, 10.0))
def test_aperture_and_field_may_change_places(column, depth):
    path = depth + column["standoff"]
    swapped = column | {
        "receiver_radius": column["acceptance_angle"] * path,
        "acceptance_angle": column["receiver_radius"] / path,
        "cross_tilt": -column["cross_tilt"],
    }
    # F(z) over the squared etendue knows the two discs only by their product.
    assert_allclose(
        overlap(depth, **column), overlap(depth, **swapped), rtol=1e-7, atol=1e-11
    )


@settings(max_examples=40)
@given(column=columns, depth=st.floats(0.01, 10.0), angle=st.floats(0, 2 * np.pi))
def test_only_the_distance_from_the_axis_counts(column, depth, angle):
    path = depth + column["standoff"]
    away = np.hypot(
        column["baseline"] - column["tilt"] * path, column["cross_tilt"] * path
    )
    turned = column | {
        "baseline": 0.0,
        "tilt": away * np.cos(angle) / path,
        "cross_tilt": away * np.sin(angle) / path,
    }
    on_axis = np.pi * column["acceptance_angle"] ** 2
    # Areas near the tangent of two discs turn roundings of 1e-16 into their root.
    assert_allclose(
        overlap(depth, **column),
        overlap(depth, **turned),
        rtol=1e-7,
        atol=1e-9 * on_axis,
    )


@settings(max_examples=12)
@given(column=columns, end=ends, scale=st.floats(0.1, 10.0))
def test_a_scale_model_of_it_all_gives_the_same_signal(column, end, scale):
    model = dict(column)
    for name in ("baseline", "receiver_radius", "beam_radius", "standoff"):
        model[name] *= scale
    for name in ("absorption", "scattering"):
        model[name] /= scale
    full = response([0.0, 3e7], **column, end=end)
    small = response([0.0, 3e7 / scale], **model, end=end * scale)
    atol = 1e-7 * abs(full[0]) + 1e-11 * most(column)
    assert_allclose(small / scale, full, rtol=0, atol=atol)


@settings(max_examples=12)
@given(column=columns, ends=st.tuples(st.floats(0.3, 8.0), st.floats(0.3, 8.0)))
def test_more_water_gives_more_light(column, ends):
    short, long = response(0.0, **column, end=np.sort(ends)).real
    assert short <= long * (1 + 1e-7) + 1e-11 * most(column)
