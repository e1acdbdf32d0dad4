"""A cube whose numbers no measurement gives is refused, and says where."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.simulation import simulate
from amulor.survey import Survey


@pytest.fixture(scope="module")
def samples(plate: Survey) -> xr.Dataset:
    return simulate(plate, rng=1)


def _with(cube: xr.Dataset, name: str, value: float, at: tuple[int, ...]) -> xr.Dataset:
    changed = cube.copy(deep=True)
    changed[name].values[at] = value
    return changed


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("in_phase_uncertainty", -1e-3, "is -0.001 V at .* row 2, column 3, but must"),
        ("quadrature_uncertainty", 0.0, "is 0 V at .* row 2, column 3, but must"),
        ("in_phase_uncertainty", np.inf, "is inf V at .* row 2, column 3; make"),
        ("in_phase", 1e300, r"is 1e\+300 V at .* row 2, column 3, more than any"),
        ("quadrature", -np.inf, "is -inf V at .* row 2, column 3, more than any"),
    ],
)
def test_one_wrong_number_is_found(
    name: str, value: float, said: str, samples: xr.Dataset
) -> None:
    with pytest.raises(CubeError, match=f"^the cube: {name} {said}"):
        cubes.check(_with(samples, name, value, (0, 1, 2, 3)))


def test_a_missing_sample_is_no_wrong_number(samples: xr.Dataset) -> None:
    changed = samples
    for name in ("in_phase", "in_phase_uncertainty", "quadrature"):
        changed = _with(changed, name, np.nan, (0, 1, 2, 3))
    cubes.check(changed)


@pytest.mark.parametrize(
    ("name", "value", "at", "words"),
    [
        ("saturated", 127, (0, 1, 2, 3), "is 127 at .* column 3, but must be 0 or 1;"),
        ("saturated", -3, (0, 1, 2, 3), "is -3 at .* column 3, but must be 0 or 1;"),
        ("time", -1.0, (2, 3), "is -1 at row 2, column 3, but must be seconds since"),
        (
            "time",
            np.inf,
            (2, 3),
            "is inf at row 2, column 3, but must be seconds since",
        ),
    ],
)
def test_marks_and_times_outside_of_their_limits_are_found(
    name: str, value: float, at: tuple[int, ...], words: str, samples: xr.Dataset
) -> None:
    with pytest.raises(CubeError, match=f"^the cube: {name} {words}"):
        cubes.check(_with(samples, name, value, at))


def test_the_time_of_a_missing_sample_may_be_unknown(samples: xr.Dataset) -> None:
    cubes.check(_with(samples, "time", np.nan, (2, 3)))


def test_shots_are_looked_at_too(samples: xr.Dataset) -> None:
    wrong = _with(samples, "open_water_in_phase_uncertainty", -1.0, (0, 0, 5))
    with pytest.raises(CubeError, match="open_water: in_phase_uncertainty is -1 V"):
        cubes.check(wrong)
    wrong = _with(samples, "open_water_azimuth", np.inf, (4,))
    with pytest.raises(CubeError, match="open_water azimuth holds values that are no"):
        cubes.check(wrong)


@pytest.mark.parametrize("component", ["in_phase", "quadrature"])
def test_half_of_a_reference_is_refused(component: str, samples: xr.Dataset) -> None:
    wrong = _with(samples, f"open_water_{component}", np.nan, (0, 1, 5))
    with pytest.raises(
        CubeError, match=r"open_water: one of .* polarization 1, shot 5"
    ):
        cubes.check(wrong)
    whole = wrong
    for part in ("in_phase", "quadrature"):
        whole = _with(whole, f"open_water_{part}", np.nan, (0, 1, 5))
    cubes.check(whole)


@pytest.mark.parametrize(
    ("prefix", "at"), [("", (0, 1, 2, 3)), ("open_water_", (0, 1, 5))]
)
@pytest.mark.parametrize(
    "error",
    [
        "in_phase_uncertainty",
        "quadrature_uncertainty",
        "in_phase_quadrature_covariance",
    ],
)
def test_a_sample_without_its_error_is_refused(
    prefix: str, at: tuple[int, ...], error: str, samples: xr.Dataset
) -> None:
    wrong = _with(samples, prefix + error, np.nan, at)
    with pytest.raises(CubeError, match=f"{error} is NaN at .* polarization 1"):
        cubes.check(wrong)
    # Without the sample, or without any errors, nothing is wrong.
    for part in ("in_phase", "quadrature"):
        wrong = _with(wrong, prefix + part, np.nan, at)
    cubes.check(wrong)
    unknown = samples.copy(deep=True)
    unknown[prefix + error][:] = np.nan
    cubes.check(unknown)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_covariance_is_at_most_the_product_of_the_errors(
    sign: int, samples: xr.Dataset
) -> None:
    at = (0, 1, 2, 3)
    first, second = (
        samples[f"{part}_uncertainty"].values[at] for part in ("in_phase", "quadrature")
    )
    name = "in_phase_quadrature_covariance"
    cubes.check(_with(samples, name, sign * first * second, at))
    wrong = _with(samples, name, sign * first * second * 1.001, at)
    with pytest.raises(CubeError, match=f"{name} is above the product .* column 3"):
        cubes.check(wrong)


def test_shared_errors_come_together(samples: xr.Dataset) -> None:
    channel = ("modulation_frequency", "polarization")
    one = samples.assign(
        open_water_common_covariance=xr.Variable(
            channel, np.zeros((1, 2)), {"units": "V2", "long_name": "shared"}
        )
    )
    with pytest.raises(
        CubeError,
        match="has common_covariance, but common_in_phase_uncertainty, "
        "common_quadrature_uncertainty is missing",
    ):
        cubes.check(one)


@given(
    value=st.floats(),
    name=st.sampled_from(["in_phase", "in_phase_uncertainty"]),
)
def test_what_is_let_through_can_be_worked_with(
    value: float, name: str, samples: xr.Dataset
) -> None:
    changed = _with(samples, name, value, (0, 0, 0, 0))
    try:
        cubes.check(changed)
    except CubeError:
        return
    assert np.isnan(value) or abs(value) <= 1e15
    assert not (name == "in_phase_uncertainty" and value <= 0)
