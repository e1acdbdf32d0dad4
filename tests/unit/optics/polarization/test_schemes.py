"""Claims about VV, VH, RR, RL and other pairs with imperfect components."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics.polarization import depolarization, mueller, schemes, stokes
from amulor.optics.polarization.components import largest_transmission
from amulor.optics.polarization.schemes import PolarizationArm

MIRROR = mueller.ideal_backscatter()
# Tolerances of 1e-15 are the rounding of readings between 0 and 1.
STATES = "HVPMRL"
PAIRS = [first + second for first in STATES for second in STATES]
OTHER = dict(zip(STATES, "VHMPLR", strict=True))
small = st.floats(-0.5, 0.5)
arms = st.builds(
    PolarizationArm,
    extinction_ratio=st.floats(0, 0.1),
    polarizer_transmission=st.floats(0.1, 1),
    polarizer_error=small,
    retardance_error=small,
    plate_error=small,
    plate_diattenuation=st.floats(-0.2, 0.2),
    plate_transmission=st.floats(0.1, 0.8),
)


def leak_of_mirror(pair, **arms):
    return float(schemes.cross_talk(MIRROR, pair=pair, **arms))


# ------------------------------------------------------------- the ideal limit


@pytest.mark.parametrize("pair", ["none", *PAIRS])
def test_ideal_components_read_what_the_formula_says(pair):
    for matrix in (MIRROR, mueller.painted_metal(), mueller.rayleigh(2.0)):
        share = schemes.received_fraction(matrix, pair=pair)
        expected = mueller.detected_fraction(matrix, pair=pair)
        assert_allclose(share, expected, rtol=0, atol=1e-15)
        talk = schemes.cross_talk(matrix, pair=pair)
        assert_allclose(talk, 0, rtol=0, atol=1e-15)


@pytest.mark.parametrize("state", STATES)
def test_components_make_and_pass_the_state_that_they_are_named_after(state):
    # Handedness included: stokes.state fixes V > 0 for "R" by the turning field.
    made = schemes.launched_stokes(state)
    assert_allclose(made, stokes.state(state), rtol=0, atol=1e-15)
    row = schemes.analyser(state)[0]
    assert_allclose(2 * row, stokes.state(state), rtol=0, atol=1e-15)


def test_painted_metal_reads_the_published_shares_through_real_circuits():
    # Eqs. (68) and (69) as rebuilt: 0.805, 0.195, 0.27 and 0.73.
    shares = {
        pair: float(schemes.received_fraction(mueller.painted_metal(), pair=pair))
        for pair in ("VV", "VH", "RR", "RL")
    }
    expected = {"VV": 0.805, "VH": 0.195, "RR": 0.27, "RL": 0.73}
    assert shares == pytest.approx(expected, rel=1e-14)


# ------------------------------------------------------------- leaks in closed form


def test_polarizers_of_1000_to_1_leak_a_thousandth_each():
    arm = PolarizationArm(extinction_ratio=1e-3)
    assert leak_of_mirror("VH", receiver=arm) == pytest.approx(1e-3, rel=1e-11)
    # Unpolarized laser: a share e / (1 + e) of the launched light is crossed, of which
    # 1 - e more passes the other way round.
    launched = leak_of_mirror("VH", emitter=arm)
    assert launched == pytest.approx(1e-3 / 1.001, rel=1e-11)
    both = leak_of_mirror("VH", emitter=arm, receiver=arm)
    assert both == pytest.approx(2e-3 / 1.001, rel=1e-11)


def test_a_polarized_laser_launches_next_to_nothing_crossed():
    arm = PolarizationArm(extinction_ratio=1e-3)
    vertical = leak_of_mirror("VH", emitter=arm, laser=stokes.state("V"))
    assert abs(vertical) < 1e-15
    # A laser that is itself 100:1 leaves the polarizer with 1e-5.
    laser = 0.99 * stokes.state("V") + 0.01 * stokes.state("H")
    light = leak_of_mirror("VH", emitter=arm, laser=laser)
    assert light == pytest.approx(1e-5 / (0.99 + 1e-5), rel=1e-9)


@settings(deadline=None)
@given(small)
def test_a_retardance_error_leaks_sine_squared_of_its_half(error):
    plate = PolarizationArm(retardance_error=error)
    expected = np.sin(error / 2) ** 2
    for pair in ("RR", "LL"):
        assert_allclose(
            leak_of_mirror(pair, receiver=plate), expected, rtol=1e-12, atol=1e-15
        )
        assert_allclose(
            leak_of_mirror(pair, emitter=plate), expected, rtol=1e-12, atol=1e-15
        )
    # Amplitudes add: equal errors give twice the angle, opposite ones nothing.
    twice = leak_of_mirror("RR", emitter=plate, receiver=plate)
    assert_allclose(twice, np.sin(error) ** 2, rtol=1e-12, atol=1e-15)
    opposite = PolarizationArm(retardance_error=-error)
    none = leak_of_mirror("RR", emitter=plate, receiver=opposite)
    assert_allclose(none, 0, rtol=1e-12, atol=1e-15)


@settings(deadline=None)
@given(small)
def test_a_turned_plate_leaks_sine_squared_and_passed_twice_that_of_twice_the_angle(
    error,
):
    plate = PolarizationArm(plate_error=error)
    expected = np.sin(error) ** 2
    assert_allclose(
        leak_of_mirror("RR", receiver=plate), expected, rtol=1e-12, atol=1e-15
    )
    assert_allclose(
        leak_of_mirror("LL", emitter=plate), expected, rtol=1e-12, atol=1e-15
    )
    # One plate in both ways has the opposite turn in the axes of the returning light.
    back = PolarizationArm(plate_error=-error)
    passed_twice = leak_of_mirror("RR", emitter=plate, receiver=back)
    assert_allclose(passed_twice, np.sin(2 * error) ** 2, rtol=1e-12, atol=1e-15)
    apart = leak_of_mirror("RR", emitter=plate, receiver=plate)
    assert_allclose(apart, np.sin(2 * error) ** 4, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("state", ["L", "R"])
def test_a_plate_error_turns_the_plate_to_the_side_of_positive_angles(state) -> None:
    # First row of a polarizer at 0 behind a quarter-wave plate at the angle a:
    # 1/2 [1, cos(2 a)^2, sin(4 a) / 2, +-sin(2 a)], here at a = +-45 degrees + 0.1.
    error = 0.1
    row = schemes.analyser(state, arm=PolarizationArm(plate_error=error))[0]
    assert_allclose(row[1], np.sin(2 * error) ** 2 / 2, rtol=1e-12)
    assert_allclose(row[2], -np.sin(4 * error) / 4, rtol=1e-12)
    assert_allclose(abs(row[3]), np.cos(2 * error) / 2, rtol=1e-12)


@settings(deadline=None)
@given(small, small)
def test_circular_leak_is_what_the_matrices_give(retardance, turn):
    arm = PolarizationArm(retardance_error=retardance, plate_error=turn)
    expected = schemes.circular_leak(retardance_error=retardance, plate_error=turn)
    assert_allclose(
        leak_of_mirror("RR", receiver=arm), expected, rtol=1e-12, atol=1e-15
    )
    assert_allclose(leak_of_mirror("LL", emitter=arm), expected, rtol=1e-12, atol=1e-15)


@settings(deadline=None)
@given(small, st.floats(0, 0.1))
def test_linear_leak_is_what_the_matrices_give(turn, leak):
    arm = PolarizationArm(polarizer_error=turn, extinction_ratio=leak)
    expected = schemes.linear_leak(axis_error=turn, extinction_ratio=leak)
    assert_allclose(
        leak_of_mirror("VH", receiver=arm), expected, rtol=1e-12, atol=1e-15
    )


def test_linear_leak_keeps_its_digits_and_its_ends():
    leak = schemes.linear_leak(
        axis_error=[1e-9, 0.0, np.pi / 2], extinction_ratio=[0.0, 1e-4, 1e-4]
    )
    assert_allclose(leak, [1e-18, 1e-4, 1.0], rtol=1e-12)
    circular = schemes.circular_leak(
        retardance_error=[2e-9, 0.0, np.pi / 2], plate_error=[0.0, 1e-9, 0.3]
    )
    # A plate without or with twice its retardance passes both helicities alike.
    assert_allclose(circular, [1e-18, 1e-18, 0.5], rtol=1e-12)


# ------------------------------------------------------------- invariances


@settings(deadline=None)
@given(st.sampled_from(STATES), arms)
def test_arms_exist_do_not_depolarize_and_make_no_light(state, arm):
    for matrix in (schemes.generator(state, arm=arm), schemes.analyser(state, arm=arm)):
        assert depolarization.is_realizable(matrix, tolerance=1e-12)
        assert_allclose(depolarization.depolarization_index(matrix), 1, rtol=1e-12)
        assert largest_transmission(matrix) <= 1 + 1e-14


@settings(deadline=None)
@given(st.sampled_from(PAIRS), arms, arms)
def test_no_pair_receives_more_than_all_or_less_than_nothing(pair, emitter, receiver):
    for matrix in (MIRROR, mueller.painted_metal()):
        share = schemes.received_fraction(
            matrix, pair=pair, emitter=emitter, receiver=receiver
        )
        assert -1e-15 <= share <= 1 + 1e-15


@settings(deadline=None)
@given(st.sampled_from("HVPM"), st.sampled_from("HVPM"), st.floats(0, 0.1), arms)
def test_crossed_analysers_share_all_the_light(first, second, leak, emitter):
    receiver = PolarizationArm(extinction_ratio=leak, polarizer_transmission=0.7)
    shares = [
        schemes.received_fraction(
            mueller.painted_metal(),
            pair=first + letter,
            emitter=emitter,
            receiver=receiver,
        )
        for letter in (second, OTHER[second])
    ]
    # Along and across, the polarizer passes T and T e of the power, which is 1.
    assert_allclose(sum(shares), 0.7 * (1 + leak), rtol=1e-13)


@settings(deadline=None)
@given(st.floats(-np.pi, np.pi), small, small, st.floats(0, 0.1))
def test_a_turn_of_the_whole_instrument_changes_nothing(turn, first, second, leak):
    # Axes of the returning light turn the other way.
    pairs = []
    for extra in (0.0, turn):
        emitter = PolarizationArm(polarizer_error=first + extra, extinction_ratio=leak)
        receiver = PolarizationArm(
            polarizer_error=second - extra, extinction_ratio=leak
        )
        pairs.append(leak_of_mirror("VH", emitter=emitter, receiver=receiver))
    assert_allclose(pairs[1], pairs[0], rtol=0, atol=1e-14)


@settings(deadline=None)
@given(st.sampled_from(PAIRS), arms, arms)
def test_losses_without_contrast_are_no_cross_talk(pair, emitter, receiver):
    plain = schemes.cross_talk(
        mueller.painted_metal(), pair=pair, emitter=emitter, receiver=receiver
    )

    def dimmed(arm):
        fields = dict(vars(arm))
        fields["polarizer_transmission"] *= 0.5
        fields["plate_transmission"] *= 0.25
        return PolarizationArm(**fields)

    dark = schemes.cross_talk(
        mueller.painted_metal(),
        pair=pair,
        emitter=dimmed(emitter),
        receiver=dimmed(receiver),
    )
    assert_allclose(dark, plain, rtol=0, atol=1e-13)


@settings(deadline=None)
@given(arms, arms)
def test_mirror_images_of_the_arms_swap_the_helicities(emitter, receiver):
    # Turning all angles round mirrors the instrument: R becomes L.
    def mirrored(arm):
        fields = dict(vars(arm))
        fields["polarizer_error"] *= -1
        fields["plate_error"] *= -1
        return PolarizationArm(**fields)

    for pair, image in (("RR", "LL"), ("RL", "LR"), ("PR", "ML")):
        one = schemes.received_fraction(
            mueller.painted_metal(), pair=pair, emitter=emitter, receiver=receiver
        )
        other = schemes.received_fraction(
            mueller.painted_metal(),
            pair=image,
            emitter=mirrored(emitter),
            receiver=mirrored(receiver),
        )
        assert_allclose(one, other, rtol=0, atol=1e-14)


# ------------------------------------------------------------- shapes and refusals


def test_fields_and_matrices_broadcast():
    receiver = PolarizationArm(
        retardance_error=np.zeros((3, 1)), plate_error=np.zeros(2)
    )
    matrices = mueller.diagonal([0.6, 0.8], -0.6, -0.4)
    share = schemes.received_fraction(matrices, pair="RL", receiver=receiver)
    assert share.shape == (3, 2)
    talk = schemes.cross_talk(matrices, pair="RL", receiver=receiver)
    assert talk.shape == (3, 2)
    assert schemes.launched_stokes("R", arm=receiver).shape == (3, 2, 4)


def test_what_no_instrument_can_do_is_refused():
    with pytest.raises(ValueError, match="pair must be 'none' or two letters"):
        schemes.received_fraction(MIRROR, pair="VX")
    with pytest.raises(ValueError, match="must be one of 'H', 'V'"):
        schemes.analyser("X")
    with pytest.raises(
        ValueError, match=r"light that leaves the emitter .*'V' must be above 0"
    ):
        schemes.launched_stokes("V", laser=np.zeros(4))
    with pytest.raises(ValueError, match="nothing is received"):
        schemes.cross_talk(
            MIRROR, pair="VV", receiver=PolarizationArm(polarizer_transmission=0.0)
        )
    with pytest.raises(ValueError, match="extinction_ratio must be from 0 to 1"):
        schemes.linear_leak(axis_error=0.0, extinction_ratio=1000)
    with pytest.raises(ValueError, match=r"last axes \(4, 4\)"):
        schemes.received_fraction(np.eye(3), pair="VV")
