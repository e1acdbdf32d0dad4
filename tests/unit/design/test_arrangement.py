"""Arguments of an evaluation as arrays of common dimensions, and its names."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.design import evaluate
from amulor.design.axes import PREDICTED, arranged
from amulor.design.evaluate import TERMS, WATERS, scheme_of
from amulor.errors import SurveyError
from amulor.survey import Survey

#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.design.evaluate")


def test_each_list_becomes_a_dimension_in_the_order_of_the_arguments() -> None:
    found = arranged(
        {"power": [0.1, 0.2, 0.3], "distance": 2.0, "radius": [0.01, 0.02]},
        [(20e6, 10e6), (30e6,), (5e6, 8e6)],
    )
    assert found.sizes == {"power": 3, "radius": 2, "frequency_set": 3}
    assert found.shape == (3, 2, 3)
    assert found.values["power"].shape == (3, 1, 1)
    assert found.values["radius"].shape == (1, 2, 1)
    assert found.values["distance"].shape == (1, 1, 1)
    assert found.frequencies is not None
    assert found.frequencies.shape == (2, 1, 1, 3)
    assert_allclose(
        found.frequencies[:, 0, 0], [[10e6, 30e6, 5e6], [20e6, np.nan, 8e6]]
    )
    dims, values, attributes = found.coordinates["power"]
    assert (dims, values.tolist()) == ("power", [0.1, 0.2, 0.3])
    assert attributes == {"long_name": "mean launched power", "units": "W"}
    assert found.coordinates["frequency_set"] == (
        "frequency_set", ["10 + 20 MHz", "30 MHz", "5 + 8 MHz"]
    )  # fmt: skip
    assert "distance" not in found.coordinates
    assert arranged({"power": 1.0}, None).frequencies is None


def test_arrays_keep_their_dimensions_in_any_order() -> None:
    both = xr.DataArray(
        np.arange(1.0, 7.0).reshape(2, 3), dims=("draw", "place"),
        coords={"place": [7, 8, 9]},
    )  # fmt: skip
    found = arranged({"distance": both, "power": both.transpose()}, None)
    assert found.sizes == {"draw": 2, "place": 3}
    assert_allclose(found.values["power"], found.values["distance"])
    assert found.coordinates["place"].values.tolist() == [7, 8, 9]
    assert "distance" not in found.coordinates
    three = xr.DataArray([1.0, 2.0, 3.0], dims="draw")
    with pytest.raises(SurveyError, match="radius: has 3 values along draw, others h"):
        arranged({"distance": both, "radius": three}, None)


@pytest.mark.parametrize(
    ("axes", "frequencies", "message"),
    [
        ({"attenuation": 1.0, "scattering": 1.0}, None, "attenuation is the sum"),
        ({"frequency": 1e6}, [(1e6,)], "state frequency, or frequencies, not both"),
        ({"power": []}, None, "power: found nothing, but it must be above 0 W"),
        (
            {"slope": 1.6},
            None,
            "at least 0 and at most 1.5 rad",
        ),
        ({"power": np.ones((1, 1, 1))}, None, "power: has 3 dimensions without names"),
        ({}, [(1e6,), ()], "frequencies: each set needs one frequency at least"),
        ({}, [], "frequencies: each set needs one frequency at least"),
        ({}, [(0.0, 1e6)], "frequencies: all must be above 0 Hz"),
    ],
)
def test_axes_that_cannot_be_are_refused(
    axes: dict[str, Any], frequencies: Any, message: str
) -> None:
    with pytest.raises(SurveyError, match=message):
        arranged(axes, frequencies)


def test_methods_need_what_they_need() -> None:
    assert [name for name, each in PREDICTED.items() if each.channel_pair] == [
        "polarization", "combined"
    ]  # fmt: skip
    assert [name for name, each in PREDICTED.items() if each.separate_frequencies] == [
        "none", "open-water", "polarization", "combined"
    ]  # fmt: skip
    assert len({each.kernel for each in PREDICTED.values()}) == 6


def test_an_evaluation_has_names_units_and_codes(tank: Survey) -> None:
    found = evaluate(
        tank, distance=[1.0, 2.0, 3.0], polarization=["VH", "VV"],
        method=["open-water", "none"],
    )  # fmt: skip
    assert dict(found.sizes) == {"method": 2, "polarization": 2, "distance": 3}
    assert found["total_error"].dims == ("method", "polarization", "distance")
    assert found["method"].values.tolist() == ["open-water", "none"]
    assert found["polarization"].values.tolist() == ["VH", "VV"]
    assert found.attrs == {"title": "Plate", "source": "amulor.design.evaluate"}
    codes = found["binding_term"]
    assert codes.dtype == np.int8
    assert codes.attrs["flag_meanings"] == " ".join(TERMS)
    assert codes.attrs["flag_values"].tolist() == list(range(len(TERMS)))
    assert "flag_values" not in found["total_error"].attrs
    assert found["total_error"].attrs["units"] == "m"
    assert found["signal"].attrs["units"] == "V"
    for row, method in enumerate(("open-water", "none")):
        for column, pair in enumerate(("VH", "VV")):
            alone = evaluate(
                tank, distance=[1.0, 2.0, 3.0], polarization=pair, method=method
            )
            assert alone["total_error"].dims == ("distance",)
            assert_allclose(found["total_error"][row, column], alone["total_error"])
    usual = evaluate(tank)
    # Of the survey: its channel, its frequency, its plate at 2 m.
    assert usual["total_error"].dims == ()
    assert_allclose(usual["total_error"], found["total_error"][0, 0, 1], rtol=1e-3)


def test_names_are_one_or_several() -> None:
    assert module._several(None, "a") == (["a"], False)
    assert module._several("b", "a") == (["b"], False)
    assert module._several(("b", "c"), "a") == (["b", "c"], True)
    with pytest.raises(SurveyError, match="at least one is needed"):
        module._several([], "a")
    assert scheme_of("VV + none") == ("VV", "none")
    with pytest.raises(SurveyError, match=r"^polarization: "):
        scheme_of("VV+X")


def test_a_survey_without_targets_needs_a_distance(tank: Survey) -> None:
    plates = [
        {"kind": "plate", "position": (0.0, 0.0, far), "width": 1.0, "height": 1.0,
         "reflectance": 0.2} for far in (1.0, 2.0)
    ]  # fmt: skip
    found = module._distance_of(tank.with_({"targets": plates}))
    assert found == pytest.approx(1.5, abs=0.001)
    with pytest.raises(SurveyError, match=r"^distance: is missing, and the survey"):
        module._distance_of(tank.with_({"targets": []}))


def test_the_largest_term_is_named_without_ambiguity() -> None:
    names = [name for name in TERMS if name not in ("ambiguity", "saturation")]
    errors = {name: xr.DataArray(np.full(2, 1.0)) for name in names}
    errors |= {name: xr.DataArray(np.full(2, 9.0)) for name in ("ambiguity",)}
    errors["saturated"] = xr.DataArray([0, 1])
    errors["water_left_in"] = xr.DataArray([2.0, 0.0])
    assert module._largest(errors, 0) == "water left in"
    assert module._largest(errors, 1) == "saturation"
    assert list(WATERS) == ["pure", "IB", "II", "III", "1C", "3C", "5C"]
    assert WATERS["II"][0] == "Jerlov II, open ocean"
    assert WATERS["1C"][0] == "Jerlov 1C, coast"
    assert WATERS["3C"][1]["salinity"] == WATERS["pure"][1]["salinity"] == 35
