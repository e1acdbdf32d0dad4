"""Parts of a transport problem: numbers, vectors, layers, surfaces at their limits."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from layered_water import EVEN, PEAKED, TILTED, layers, plate
from numpy.testing import assert_allclose

from amulor.transport import (
    DiscReceiver,
    Layer,
    Medium,
    ScatteringMatrix,
    Source,
)
from amulor.transport._checks import above, at_least, at_most, axes_of, unit_vector


def water():
    return Medium.homogeneous(
        absorption=0.2, scattering=0.8, phase_function=PEAKED, group_index=1.33
    )


@pytest.mark.parametrize(
    ("check", "value", "limit", "message"),
    [
        (at_least, 2, 2.0, None),
        (at_least, 1.9, 2.0, "way must be at least 2 m, got 1.9"),
        (at_least, np.inf, 2.0, "way must be at least 2 m, got inf"),
        (above, 2.1, 2.0, None),
        (above, 2, 2.0, "way must be above 2 m, got 2"),
        (above, np.inf, 2.0, "way must be above 2 m, got inf"),
        (at_most, 2, 2.0, None),
        (at_most, 0.1, 2.0, None),
        (at_most, 0, 2.0, "way must be above 0 m, got 0"),
        (at_most, 2.1, 2.0, "way must not exceed 2 m, got 2.1"),
    ],
)
def test_a_number_has_a_limit(check, value, limit, message):
    if message is None:
        found = check(value, limit, name="way", unit="m")
        assert isinstance(found, float)
        assert found == value
    else:
        with pytest.raises(ValueError, match=r"^" + message) as info:
            check(value, limit, name="way", unit="m")
        assert str(info.value) == message


def test_the_axes_of_a_view_keep_right_as_far_as_they_can():
    axes = axes_of(TILTED, name="direction")
    assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert_allclose(axes[2], TILTED)
    # The first lies in the plane of the direction and the axis to the right.
    assert axes[0] @ np.cross((1.0, 0, 0), TILTED) == pytest.approx(0, abs=1e-15)
    assert axes[0, 0] == pytest.approx(np.sqrt(1 - 0.48**2))
    assert_allclose(axes_of(np.array([0, 0, 1.0]), name="direction"), np.eye(3))


def test_a_view_to_the_right_has_no_axes_within_a_millionth():
    def along(sine):
        return np.array([np.sqrt(1 - sine**2), 0.6 * sine, 0.8 * sine])

    with pytest.raises(ValueError, match="eye must not lie along the axis to the"):
        axes_of(along(0.95e-6), name="eye")
    assert axes_of(along(1.05e-6), name="eye")[2, 0] == pytest.approx(1)


def test_a_vector_of_any_length_is_a_direction():
    assert_allclose(unit_vector((0, 3e-3, -4e-3), name="way"), (0, 0.6, -0.8))
    for wrong, message in (
        ((0, 0, 0), "way must have a length above zero"),
        ((0, 1), "way must be three finite numbers"),
        ((0, np.nan, 1), "way must be three finite numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            unit_vector(wrong, name="way")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DiscReceiver(radius=1, acceptance_angle=1, position=(0, 1)), "three"),
        (
            lambda: DiscReceiver(radius=1, acceptance_angle=1, direction=(0, 0, 0)),
            "direction must have a length",
        ),
        (
            lambda: DiscReceiver(radius=1, acceptance_angle=1, direction=(1, 0, 0)),
            "not lie along",
        ),
        (lambda: DiscReceiver(radius=1, acceptance_angle=0.0), "above 0 rad"),
        (lambda: plate(position=(0, 0)), "position must be three"),
        (lambda: plate(normal=(0, 0, 0)), "normal must have a length"),
        (lambda: plate(gloss=0.1, rms_slope=0.019), "0.02 to 0.5, got 0.019"),
        (lambda: plate(gloss=0.1, rms_slope=0.51), "0.02 to 0.5, got 0.51"),
        (lambda: plate(mueller=np.eye(3)), "shape"),
        (lambda: Source(divergence=-0.1), "divergence must be at least 0 rad"),
        (lambda: Source(polarization=(1, 0, 0)), "four numbers"),
    ],
)
def test_each_part_of_a_problem_is_checked_when_it_is_made(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_parts_at_their_limits_are_made():
    assert Source(divergence=0.5, radius=0.0).divergence == 0.5
    assert Source(polarization=(1, 0.6, 0, 0.8)).stokes.tolist() == [1, 0.6, 0, 0.8]
    for slope in (0.02, 0.5):
        assert plate(gloss=0.1, rms_slope=slope).rms_slope == slope
    # Without gloss there are no facets that a slope could belong to.
    assert plate(rms_slope=0.9).gloss == 0
    assert plate(reflectance=0.6, gloss=0.4, rms_slope=0.1).matrix[0, 0] == 1
    assert DiscReceiver(radius=1, acceptance_angle=np.pi / 2).radius == 1


def test_a_matrix_may_miss_what_can_be_by_its_last_digit():
    # The smallest eigenvalue of diag(1, 1, 1, 1 - 4 d) is -d of the trace.
    for defect in (0.0019, 0.0021):
        m44 = 1 - 4 * defect
        elements = np.array([[0, 1, 1, 0, m44]] * 2)
        makers = (
            lambda m44=m44: plate(mueller=np.diag([1, 1, 1, m44])).matrix[3, 3],
            lambda elements=elements: (
                ScatteringMatrix(EVEN, np.array([0.0, np.pi]), elements)
                .elements_at(1.0)[4]
            ),
        )  # fmt: skip
        for make in makers:
            if defect < 0.002:
                assert make() == pytest.approx(m44)
            else:
                with pytest.raises(ValueError, match=r"eigenvalue of -0\.0021"):
                    make()


def test_layers_are_those_of_a_medium_one_after_the_other():
    medium = layers(1.0, 2.0, 4.0, top=-1.5)
    assert medium.edges == (-1.5, -0.5, 1.5, 5.5)
    assert [round(b - a, 9) for a, b in pairwise(medium.edges)] == [1, 2, 4]
    assert not medium.unbounded
    assert not medium.polarized
    endless = Layer(absorption=0.2, scattering=0.5, phase_function=EVEN)
    assert endless.attenuation == 0.7
    assert endless.thickness == np.inf
    below = Medium.layered([endless], group_index=1)
    assert below.edges == (0, np.inf)
    assert below.group_index == 1
    assert not below.unbounded
    assert water().unbounded
    assert water().edges == (-np.inf, np.inf)


def test_a_medium_has_one_finite_top_and_one_end():
    endless = Layer(absorption=0.2, scattering=0.5, phase_function=EVEN)
    thin = Layer(absorption=0.0, scattering=0.5, phase_function=EVEN, thickness=1.0)
    empty = Layer(absorption=0.0, scattering=0.0, phase_function=EVEN, thickness=1.0)
    bright = Layer(absorption=0.0, scattering=0.5, phase_function=EVEN)
    # Absorption is needed without an end only, and scattering or absorption once.
    assert Medium.layered([thin], group_index=1.3).edges == (0, 1)
    assert Medium.layered([empty, thin], group_index=1.3).edges == (0, 1, 2)
    for stack, top, message in (
        ([endless, endless], -np.inf, "top must be a finite place"),
        ([endless], np.inf, "top must be a"),
        ([endless, thin], 0.0, "only the last layer"),
        ([thin, bright], 0.0, "a layer without end needs an absorption"),
        ([empty, empty], 0.0, "only layers with an attenuation of 0 1/m"),
    ):
        with pytest.raises(ValueError, match=message):
            Medium.layered(stack, group_index=1.3, top=top)
    for index in (0.99, np.inf, np.nan):
        with pytest.raises(ValueError, match="group_index must be at least 1"):
            Medium.layered([endless], group_index=index)
