"""Claims about real polarizers, retarders and quarter-wave plates."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics.polarization import components, depolarization, mueller, stokes

angles = st.floats(-np.pi, np.pi)
shares = st.floats(0, 1)
contrasts = st.floats(-1, 1)


def intensity(matrix, name):
    return mueller.apply(matrix, stokes.state(name))[..., 0]


def test_malus_law_holds():
    turned_to = np.radians([0.0, 30.0, 60.0, 90.0])
    passed = intensity(components.linear_polarizer(turned_to), "H")
    assert_allclose(passed, [1, 0.75, 0.25, 0], rtol=0, atol=1e-15)


def test_a_polarizer_at_45_degrees_passes_p_and_blocks_m():
    matrix = components.linear_polarizer(np.pi / 4)
    assert_allclose(intensity(matrix, "P"), 1, rtol=1e-15)
    assert_allclose(intensity(matrix, "M"), 0, atol=1e-15)


def test_a_polarizer_of_1000_to_1_passes_a_thousandth_when_crossed():
    matrix = components.linear_polarizer(
        0.0, extinction_ratio=1e-3, transmission=[1.0, 0.8]
    )
    assert_allclose(intensity(matrix, "H"), [1, 0.8], rtol=1e-15)
    # (1 + e) - (1 - e) over 2 rounds to 1e-16 of 1.
    assert_allclose(intensity(matrix, "V"), [1e-3, 0.8e-3], rtol=1e-12)
    # Two of them in line and crossed, unpolarized light in: (1 + e^2)/2 and e.
    crossed = components.linear_polarizer(np.pi / 2, extinction_ratio=1e-3)
    assert_allclose(intensity(crossed @ matrix[0], "none"), 1e-3, rtol=1e-12)
    assert_allclose(
        intensity(matrix[0] @ matrix[0], "none"), (1 + 1e-6) / 2, rtol=1e-12
    )


def test_a_polarizer_that_extinguishes_nothing_is_clear_glass():
    clear = components.linear_polarizer(0.4, extinction_ratio=1.0)
    assert_allclose(clear, np.eye(4), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("fast", "name"), [(np.pi / 2, "R"), (0.0, "L")])
def test_a_quarter_wave_plate_makes_plus_45_degrees_circular(fast, name):
    # Hecht, Optics: fast axis vertical turns a P state into a right circular one.
    plate = components.retarder(np.pi / 2, angle=fast)
    out = mueller.apply(plate, stokes.state("P"))
    assert_allclose(out, stokes.state(name), rtol=0, atol=1e-15)


def test_a_half_wave_plate_turns_linear_by_twice_its_angle():
    plate = components.retarder(np.pi, angle=np.radians(22.5))
    out = mueller.apply(plate, stokes.state("H"))
    assert_allclose(out, stokes.state("P"), rtol=0, atol=1e-15)


@settings(deadline=None)
@given(angles)
def test_a_half_wave_plate_that_is_turned_leaks_sine_squared_of_twice_the_angle(angle):
    crossed = components.linear_polarizer(np.pi / 2)
    plate = components.retarder(np.pi, angle=angle)
    leak = intensity(crossed @ plate, "H")
    assert_allclose(leak, np.sin(2 * angle) ** 2, rtol=0, atol=1e-15)


def test_a_retarder_with_full_diattenuation_is_a_polarizer():
    # Half of unpolarized light is all of what is aligned.
    plate = components.retarder(0.7, angle=0.3, diattenuation=1.0, transmission=0.5)
    assert_allclose(plate, components.linear_polarizer(0.3), rtol=0, atol=1e-15)
    slow = components.retarder(0.7, angle=0.3, diattenuation=-1.0, transmission=0.5)
    across = components.linear_polarizer(0.3 + np.pi / 2)
    assert_allclose(slow, across, rtol=0, atol=1e-15)


def test_diattenuation_is_the_contrast_of_both_axes():
    plate = components.retarder(
        np.pi / 2, angle=0.0, diattenuation=0.02, transmission=0.9
    )
    fast, slow = intensity(plate, "H"), intensity(plate, "V")
    assert_allclose((fast - slow) / (fast + slow), 0.02, rtol=1e-13)
    assert_allclose(intensity(plate, "none"), 0.9, rtol=1e-15)


def test_polarizer_and_quarter_wave_plate_before_a_mirror_block_the_echo():
    # The light passes the plate twice; on the way back its fast axis, at +45 degrees
    # of the way there, is at -45 degrees of the axes of the returning light.
    there = components.retarder(np.pi / 2, angle=np.pi / 4)
    back = components.retarder(np.pi / 2, angle=-np.pi / 4)
    through = back @ mueller.ideal_backscatter() @ there
    assert_allclose(
        mueller.detected_fraction(through, pair="HH"), 0, rtol=0, atol=1e-15
    )
    assert_allclose(mueller.detected_fraction(through, pair="HV"), 1, rtol=1e-15)


@settings(deadline=None)
@given(angles, shares, shares)
def test_a_polarizer_is_its_jones_matrix(mueller_of, turned, angle, leak, transmission):
    jones = np.sqrt(transmission) * turned(np.diag([1.0, np.sqrt(leak)]), angle)
    matrix = components.linear_polarizer(
        angle, extinction_ratio=leak, transmission=transmission
    )
    assert_allclose(matrix, mueller_of(jones), rtol=0, atol=1e-14)


@settings(deadline=None)
@given(angles, st.floats(-10, 10), contrasts)
def test_a_retarder_is_its_jones_matrix(
    mueller_of, turned, angle, retardance, contrast
):
    # With exp(-i omega t) a delay multiplies by exp(+i delay): the slow axis, across.
    along, across = np.sqrt((1 + contrast) / 2), np.sqrt((1 - contrast) / 2)
    jones = turned(np.diag([along, across * np.exp(1j * retardance)]), angle)
    matrix = components.retarder(
        retardance, angle=angle, diattenuation=contrast, transmission=0.5
    )
    assert_allclose(matrix, mueller_of(jones), rtol=0, atol=1e-13)


@settings(deadline=None)
@given(angles, angles)
def test_an_element_turned_twice_is_turned_by_the_sum(first, second):
    matrix = components.retarder(0.7, angle=0.2, diattenuation=0.1, transmission=0.9)
    twice = mueller.rotated(mueller.rotated(matrix, angle=first), angle=second)
    once = components.retarder(
        0.7, angle=0.2 + first + second, diattenuation=0.1, transmission=0.9
    )
    assert_allclose(twice, once, rtol=0, atol=1e-14)


@settings(deadline=None)
@given(angles, st.floats(1e-3, 1), shares, st.floats(-10, 10), contrasts)
def test_components_exist_do_not_depolarize_and_make_no_light(
    angle, transmission, leak, retardance, contrast
):
    polarizer = components.linear_polarizer(
        angle, extinction_ratio=leak, transmission=transmission
    )
    plate = components.retarder(
        retardance,
        angle=angle,
        diattenuation=contrast,
        transmission=transmission / (1 + abs(contrast)),
    )
    for matrix in (polarizer, plate, plate @ polarizer, polarizer @ plate):
        if matrix[0, 0] < 1e-9:
            continue  # plate and polarizer crossed; nothing passes
        # Cloude: no negative eigenvalue, up to rounding of the turned elements.
        assert depolarization.realizability_defect(matrix) < 1e-12 / matrix[0, 0]
        # Trace condition of a matrix that does not depolarize.
        trace = np.trace(matrix @ matrix.T)
        assert_allclose(trace, 4 * matrix[0, 0] ** 2, rtol=0, atol=1e-13)
        for way in (matrix, matrix.T):  # there, and with reciprocity back
            assert components.largest_transmission(way) <= 1 + 1e-13


@settings(deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3), angles, shares)
def test_no_light_passes_better_than_the_largest_transmission(vector, angle, leak):
    length = max(np.linalg.norm(vector), 1.0)
    light = np.array([1.0, *(np.array(vector) / length)])
    matrix = components.linear_polarizer(angle, extinction_ratio=leak) @ (
        components.retarder(1.0, angle=0.3)
    )
    passed = mueller.apply(matrix, light)[0]
    assert passed <= components.largest_transmission(matrix) + 1e-14
    # The best state is that of the first row, and it does reach the bound.
    row = matrix[0] / np.linalg.norm(matrix[0, 1:]) if leak < 0.99 else None
    if row is not None:
        best = np.array([1.0, *row[1:]])
        assert_allclose(
            mueller.apply(matrix, best)[0],
            components.largest_transmission(matrix),
            rtol=1e-12,
        )


def test_arguments_broadcast():
    plates = components.retarder(
        np.zeros(3), angle=np.zeros((2, 1)), diattenuation=0.01, transmission=0.9
    )
    assert plates.shape == (2, 3, 4, 4)
    polarizers = components.linear_polarizer(
        np.zeros((2, 1)), extinction_ratio=[0, 0.1, 1], transmission=0.5
    )
    assert polarizers.shape == (2, 3, 4, 4)
    assert components.largest_transmission(polarizers).shape == (2, 3)


def test_components_that_cannot_exist_are_refused():
    with pytest.raises(ValueError, match="extinction_ratio must be from 0 to 1"):
        components.linear_polarizer(0.0, extinction_ratio=10_000)
    with pytest.raises(ValueError, match="transmission must be from 0 to 1"):
        components.linear_polarizer(0.0, transmission=80)
    with pytest.raises(ValueError, match="diattenuation must be from -1 to 1"):
        components.retarder(0.0, angle=0.0, diattenuation=2.0)
    with pytest.raises(ValueError, match=r"must be at most 1, got 1\.02"):
        components.retarder(0.0, angle=0.0, diattenuation=0.02)
    with pytest.raises(ValueError, match=r"last axes \(4, 4\)"):
        components.largest_transmission(np.eye(3))
