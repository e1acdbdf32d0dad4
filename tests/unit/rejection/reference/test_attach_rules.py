"""Open water from another cube: which pixels are shots, and words of refusals."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal

from amulor import rejection
from amulor.errors import CubeError
from amulor.rejection.reference import attach

Make = Callable[..., xr.Dataset]


@pytest.fixture
def cube(by_hand: Make) -> xr.Dataset:
    return by_hand(
        frequency=[20e6, 50e6],
        channels={"VV": (1.0, 1.0), "VH": (0.3, 0.1)},
        shape=(3, 4),
        shots=7,
    )


def refusal(cube: xr.Dataset, reference: xr.Dataset) -> str:
    with pytest.raises(CubeError) as error:
        rejection.with_open_water(cube, reference)
    return str(error.value)


def test_pixels_without_a_target_are_shots_in_the_order_of_time(
    cube: xr.Dataset,
) -> None:
    empty = np.array([[1, 0, 1, 1], [0, 0, 1, 0], [1, 1, 0, 1]], dtype=bool)
    shots = attach.pixels_as_shots(cube, empty)
    at = np.flatnonzero(empty)
    for name in ("in_phase", "quadrature", "in_phase_uncertainty",
                 "quadrature_uncertainty"):  # fmt: skip
        flat = cube[name].values.reshape(2, 2, -1)
        assert_array_equal(shots[name].values, flat[..., at])
    for name in ("azimuth", "elevation"):
        assert_array_equal(shots[name].values, cube[name].values.ravel()[at])
    assert "in_phase_quadrature_covariance" not in shots
    time = np.arange(12.0).reshape(3, 4)
    time[0, 0], time[1, 2] = 99.0, 0.5
    timed = cube.assign_coords(time=(("row", "column"), time))
    timed["saturated"].values[1, 0, 0, 2] = 4
    timed = timed.assign(
        in_phase_quadrature_covariance=0.1 * timed["in_phase_uncertainty"] ** 2
    )
    shots = attach.pixels_as_shots(timed, empty)
    order = np.array([6, 2, 3, 8, 9, 11, 0])
    flat = cube["quadrature"].values.reshape(2, 2, -1)[..., order]
    assert_array_equal(shots["quadrature"].values, flat)
    expected = cube["in_phase"].values.reshape(2, 2, -1)[..., order]
    # The overloaded sample is the second shot.
    expected[1, 0, 1] = np.nan
    assert_array_equal(shots["in_phase"].values, expected)
    flat = timed["in_phase_quadrature_covariance"].values.reshape(2, 2, -1)
    found = shots["in_phase_quadrature_covariance"].values
    assert_array_equal(found, flat[..., order])


def test_a_reference_lacks_frequencies_and_channels(cube: xr.Dataset) -> None:
    both = cube.copy(deep=True)
    both["modulation_frequency"] = both["modulation_frequency"].copy(
        data=[30.5e6, 60e6]
    )
    assert refusal(cube, both) == (
        "the open-water cube has no sample at 20, 50 MHz, which the target cube has; "
        "record it again at these frequencies, or select the common ones first"
    )
    assert "no sample at 50 MHz," in refusal(cube, cube.isel(modulation_frequency=[0]))
    other = cube.copy(deep=True)
    other["polarization"] = other["polarization"].copy(data=["HV", "HH"])
    assert refusal(cube, other) == (
        "the open-water cube has the channels HH, HV, but the target cube has VV, VH "
        "too; record open water in every channel, or select the common ones first"
    )
    # The same channels in another order serve.
    turned = cube.isel(polarization=[1, 0])
    shots = rejection.with_open_water(cube, turned).amulor.open_water
    assert_array_equal(shots["in_phase"], cube.amulor.open_water["in_phase"])


@pytest.mark.parametrize(("off", "refused"), [(0.9e-6, False), (3e-6, True)])
def test_an_instrument_stands_within_a_millionth(
    cube: xr.Dataset, off: float, refused: bool
) -> None:
    moved = cube.copy(deep=True)
    place = np.array([0.0, off, 0.0])
    moved["geometry"].attrs["receiver_position"] = place
    if not refused:
        rejection.with_open_water(cube, moved)
        return
    ours = np.zeros(3)
    assert refusal(cube, moved) == (
        f"receiver_position is {place} in the open-water cube, but {ours} in the "
        "target cube; record open water with the instrument as it stands, in the same "
        "water"
    )


@pytest.mark.parametrize(("index", "refused"), [(1.3800012, False), (1.38001, True)])
def test_water_has_the_same_index_within_a_millionth(
    cube: xr.Dataset, index: float, refused: bool
) -> None:
    other = cube.copy(deep=True)
    other["geometry"].attrs["group_index"] = index
    if refused:
        words = f"group_index is {index} in the open-water cube, but 1.38 in the target"
        assert refusal(cube, other).startswith(words)
    else:
        rejection.with_open_water(cube, other)


def surveyed(**fields: Any) -> Any:
    """Return an object with a survey of a water and an instrument."""
    values = {"water": {"absorption": 0.2}, "instrument": {"power": 0.02}} | fields
    survey = SimpleNamespace(
        **{
            name: SimpleNamespace(model_dump=lambda part=part: part)
            for name, part in values.items()
        }
    )
    return SimpleNamespace(amulor=SimpleNamespace(survey=survey))


def test_surveys_describe_the_same_water_and_instrument() -> None:
    attach._refuse_other_surveys(surveyed(), surveyed())
    bare: Any = SimpleNamespace(amulor=SimpleNamespace(survey=None))
    other = surveyed(water={"absorption": 0.3})
    attach._refuse_other_surveys(bare, other)
    attach._refuse_other_surveys(other, bare)
    with pytest.raises(CubeError) as error:
        attach._refuse_other_surveys(surveyed(), other)
    assert str(error.value) == (
        "the open-water cube is of another water: water.absorption is 0.3 there, but "
        "0.2 in the target cube; record open water in the same water as the target"
    )
    with pytest.raises(CubeError) as error:
        attach._refuse_other_surveys(surveyed(), surveyed(instrument={"power": 0.01}))
    assert str(error.value) == (
        "the open-water cube is of another instrument: instrument.power is 0.01 there, "
        "but 0.02 in the target cube; record open water with the same settings as the "
        "target"
    )


@pytest.mark.parametrize(
    ("ours", "theirs", "difference"),
    [
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}, None),
        ({"a": 1, "b": 2}, {"a": 1, "b": 3}, ("b", 2, 3)),
        ({"a": 1}, {}, ("a", 1, None)),
        ({"a": {"b": {"c": 1}}}, {"a": {"b": {"c": 2}}}, ("a.b.c", 1, 2)),
        ({"a": {"b": 1}, "c": 2}, {"a": {"b": 1}, "c": 3}, ("c", 2, 3)),
        ({"a": {"b": 1}}, {"a": None}, ("a", {"b": 1}, None)),
        ({"polarizations": 1, "a": 2}, {"polarizations": 2, "a": 2}, None),
        ({"modulation_frequencies": 1}, {"modulation_frequencies": 2}, None),
    ],
)
def test_the_first_field_that_differs_is_named(
    ours: Any, theirs: Any, difference: Any
) -> None:
    assert attach._first_difference(ours, theirs) == difference
