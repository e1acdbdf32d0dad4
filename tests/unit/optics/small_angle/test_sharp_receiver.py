"""Sharp receiver in small-angle form: shapes, what is refused, compiled loops."""

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import j0, j1

from amulor.optics.phase_functions import henyey_greenstein
from amulor.optics.small_angle import _sharp_kernels as kernels
from amulor.optics.small_angle import sharp_receiver as small_angle_sharp_receiver
from amulor.optics.small_angle._columns import disc, table
from amulor.optics.small_angle.sharp_receiver import overlap, water_response

PEAKED = partial(henyey_greenstein, asymmetry=0.95)
WATER = {
    "absorption": 0.2,
    "scattering": 0.6,
    "phase_function": PEAKED,
    "split_angle": np.pi / 2,
}
INSTRUMENT = {"baseline": 0.1, "receiver_radius": 0.02, "acceptance_angle": 0.08}
ALL = WATER | INSTRUMENT | {"group_index": 1.34}


def test_shape_is_that_of_the_frequencies():
    assert water_response(1e7, **ALL).shape == ()
    assert water_response([1e7, 2e7], **ALL).shape == (2,)
    assert water_response(np.zeros((2, 0)), **ALL).shape == (2, 0)


def test_arguments_broadcast_as_if_called_one_by_one():
    frequency = np.array([3e7, 1e6])
    baseline = np.array([[0.07], [0.2]])
    vsf = np.array([[[1e-3]], [[2e-3]], [[4e-3]]])
    found = water_response(
        frequency, **ALL | {"baseline": baseline}, backscatter_vsf=vsf
    )
    assert found.shape == (3, 2, 2)
    for i in range(3):
        for j in range(2):
            one = ALL | {"baseline": baseline[j, 0]}
            expected = water_response(frequency, **one, backscatter_vsf=vsf[i, 0, 0])
            # Sums are taken in another order.
            assert_allclose(found[i, j], expected, rtol=1e-10)


def test_overlap_broadcasts_depth_against_the_water():
    depth = np.array([0.0, 1.0, 3.0])
    arguments = WATER | INSTRUMENT | {"scattering": np.array([[0.0], [0.5]])}
    found = overlap(depth, **arguments)
    assert found.shape == (2, 3)
    one = WATER | INSTRUMENT | {"scattering": 0.5}
    assert_array_equal(found[1, 1], overlap(1.0, **one))


@pytest.mark.parametrize("divergence", [0.0, 0.01])
def test_where_the_water_begins_the_aperture_sees_its_cone_or_nothing(divergence):
    found = overlap(
        0.0,
        **WATER,
        **INSTRUMENT | {"baseline": np.array([0.0, 0.019, 0.021])},
        beam_divergence=divergence,
    )
    # A beam without width there; the solid angle is that of small angles.
    assert_allclose(found, np.pi * 0.08**2 * np.array([1, 1, 0]), rtol=1e-14)


def test_light_that_no_receiver_can_see_is_none():
    clear = WATER | {"scattering": 0.0}
    # Cone and beam meet at 1 m first.
    assert_array_equal(overlap([0.5, 0.99], **clear, **INSTRUMENT), 0.0)
    assert overlap(1.01, **clear, **INSTRUMENT) > 0
    dark = water_response(1e7, **ALL | {"scattering": 0.0}, end=0.99)
    assert dark == 0


def test_backscatter_is_that_of_the_phase_function_unless_given():
    vsf = 0.6 * henyey_greenstein(np.pi, asymmetry=0.95)
    default = water_response(2e7, **ALL)
    assert_allclose(
        default, water_response(2e7, **ALL, backscatter_vsf=vsf), rtol=1e-12
    )


def test_later_echo_has_larger_phase():
    near = water_response(5e6, **ALL, end=1.5)
    far = water_response(5e6, **ALL, end=4.0)
    assert 0 < np.angle(near) < np.angle(far) < np.pi


@pytest.mark.parametrize("beam_radius", [0.0, 1e-3])
def test_water_of_no_depth_sends_nothing(beam_radius):
    assert water_response(1e7, **ALL, beam_radius=beam_radius, end=0.0) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"absorption": -0.1}, "absorption must be finite and not negative"),
        ({"receiver_radius": 0.0}, "receiver_radius must be finite and above 0"),
        ({"acceptance_angle": [0.1, 0.0]}, r"above 0 \[rad\], got 0 at index \(1,\)"),
        ({"beam_radius": -1e-3}, "beam_radius must be finite and not negative"),
        ({"tilt": np.nan}, "tilt must be finite"),
        ({"group_index": 0.9}, "group_index must be finite and at least 1, got 0.9"),
        ({"end": -1.0}, "end must be not negative, .* got -1"),
        ({"split_angle": 0.0}, "split_angle must be above 0 and at most pi"),
        ({"phase_function": np.ones_like}, "must integrate to 1 over the sphere"),
    ],
)
def test_arguments_out_of_range_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        water_response(1e7, **ALL | change)


def test_negative_frequency_and_depth_are_refused():
    with pytest.raises(ValueError, match="modulation_frequency must be finite"):
        water_response(-1.0, **ALL)
    with pytest.raises(ValueError, match="depth must be finite and not negative"):
        overlap(-1.0, **WATER, **INSTRUMENT)


# ------------------------------------------------------------------- kernels


@pytest.mark.parametrize("x", [26.0, 40.0, 3e3])
def test_waves_are_the_bessel_functions(x):
    turned = np.exp(1j * x)
    # Four terms of each asymptotic series: the next is 4e-12 of the wave at 26.
    assert_allclose((kernels._wave_0(x) * turned).real, j0(x), atol=1e-12)
    assert_allclose((kernels._wave_1(x) * turned).real, 2 * j1(x) / x, atol=1e-13)


def test_transform_of_a_disc_joins_its_table_and_its_wave():
    x = np.linspace(0.01, 60, 4001)
    found = [kernels._disc(value, disc()) for value in x]
    # Cells of polynomials of degree 9.
    assert_allclose(found, 2 * j1(x) / x, rtol=0, atol=1e-12)
    assert_allclose(kernels._disc(0.0, disc()), 1.0, rtol=1e-12)


@pytest.mark.parametrize("rate", [0.0, 3.0, -20.0, 500.0])
def test_a_turning_panel_is_integrated_in_closed_form(rate):
    node, weight = np.polynomial.legendre.leggauss(kernels.NODES)
    rule, series = small_angle_sharp_receiver._frequency_rule()
    half, centre, decay = 0.7, 3.0, 0.8 + 0.3j
    value = np.exp(-decay * (centre + half * node))
    exponent = 1j * rate - decay
    ends = np.exp(exponent * (centre + half)) - np.exp(exponent * (centre - half))
    found = kernels._turned(half, centre, rate, value, rule, series)
    # The integral of exp((i rate - decay) x); values are about exp(-2.4).
    assert_allclose(found, (ends / exponent).real, rtol=0, atol=1e-14)
    assert_allclose(np.sum(weight), np.sum(rule[1]), rtol=1e-15)


def test_compiled_loop_is_the_loop_as_written():
    depth = np.array([0.5, 4.0, 30.0])
    look = np.column_stack([depth, *np.tile([0.1, 0.01, 0.02, 0.0], (3, 1)).T])
    kept = table(PEAKED, np.pi / 2)
    thin = kernels.Water(
        loss=0.4,
        forward=1.2,
        split_angle=np.pi / 2,
        receiver_radius=0.02,
        acceptance_angle=0.08,
        beam_radius_squared=0.0,
        beam_divergence_squared=0.0,
    )
    wide = thin._replace(beam_radius_squared=1e-6, beam_divergence_squared=1e-6)
    tables = small_angle_sharp_receiver._tables_of(kept)
    for water in (thin, wide):
        compiled, written = np.empty(3), np.empty(3)
        arguments = (look, water, tables)
        kernels.collected(*arguments, compiled)
        kernels.collected.py_func(*arguments, written)
        # Waves that cancel; contracted multiplications round once less.
        assert_allclose(compiled, written, rtol=1e-9)


def test_water_that_only_absorbs_sends_nothing_back_but_light_that_meets_it():
    clear = ALL | {"scattering": 0.0}
    frequency = [1e6, 3e7]
    thin = water_response(frequency, **clear, backscatter_vsf=1e-3)
    wide = water_response(frequency, **clear, backscatter_vsf=1e-3, beam_radius=1e-4)
    assert np.abs(thin).min() > 0
    # A beam of a tenth of a millimeter has the response of a line.
    assert_allclose(wide, thin, rtol=2e-3)
