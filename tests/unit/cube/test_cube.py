"""The schema check names what is wrong; groups travel with their cube."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor.cube import schema
from amulor.errors import CubeError
from amulor.simulation import simulate
from amulor.survey import Survey


@pytest.fixture(scope="module")
def samples(plate: Survey) -> xr.Dataset:
    return simulate(plate, rng=1)


def test_flags_have_the_numbers_that_stand_in_files() -> None:
    assert {flag.name: int(flag) for flag in cubes.QualityFlag} == {
        "MISSING": 1,
        "SATURATED": 2,
        "NO_TARGET": 4,
        "AMBIGUOUS": 8,
        "WATER_RESIDUAL": 16,
        "NO_OPEN_WATER": 32,
        "MIXED": 64,
        "OUTLIER": 128,
        "RELATIVE": 256,
        "CORNER": 512,
        "MOVED": 1024,
    }


def test_causes_have_the_numbers_that_stand_in_files() -> None:
    numbers = {
        "PHASE_SHIFT": 1, "STRONG_COLUMN": 2, "WATER_SHAPE": 4, "MODEL_MISFIT": 8,
        "MODEL_DEPARTURE": 16, "WATER_CHANGED": 32, "INSTRUMENT": 64,
    }  # fmt: skip
    assert {cause.name: int(cause) for cause in cubes.WaterResidualCause} == numbers
    attributes = schema.cause_attributes()
    for name in ("flag_masks", "flag_values"):
        assert attributes[name].tolist() == list(numbers.values())
        assert attributes[name].dtype == np.int8
    assert attributes["flag_meanings"] == " ".join(numbers).lower()
    assert attributes["units"] == "1"


def test_flags_decide_whether_a_pixel_has_a_range_and_an_error() -> None:
    assert int(cubes.QualityFlag.GOOD) == 0
    assert int(schema.UNUSABLE) == 1 + 2 + 4 + 8
    assert int(schema.ERROR_UNKNOWN) == 32 + 256
    assert int(schema.DOUBTFUL) == 16 + 64 + 128 + 512 + 1024 + 32 + 256


def test_levels_state_what_they_need() -> None:
    needed = {
        name: [key for key, spec in level.variables.items() if spec.required]
        for name, level in schema.LEVELS.items()
    }
    errors = ["in_phase_uncertainty", "quadrature_uncertainty"]
    assert needed["samples"][:4] == ["in_phase", "quadrature", *errors]
    assert needed["range_image"] == [
        "slant_range", "slant_range_uncertainty", "intensity", "quality_flag",
    ]  # fmt: skip
    assert needed["point_cloud"] == [
        "x", "y", "z", "intensity", "slant_range_uncertainty", "row", "column",
    ]  # fmt: skip
    shots = [key for key, spec in schema.OPEN_WATER_VARIABLES.items() if spec.required]
    assert shots == ["in_phase", "quadrature", *errors]


def test_a_simulated_cube_keeps_the_schema(samples: xr.Dataset) -> None:
    cubes.check(samples, "samples")
    assert samples["in_phase"].dims == (
        "modulation_frequency",
        "polarization",
        "row",
        "column",
    )
    assert samples.attrs["simulated"] == 1
    assert samples.attrs["seed"] == 1
    assert "survey sha256:" in samples.attrs["input_digests"]


DAMAGES: dict[str, tuple[Callable[[xr.Dataset], xr.Dataset], str]] = {
    "a variable is gone": (lambda c: c.drop_vars("quadrature"), "'quadrature'"),
    "a coordinate is gone": (lambda c: c.drop_vars("azimuth"), "'azimuth'"),
    "no level": (lambda c: c.assign_attrs(level="picture"), "'level'"),
    "another schema": (
        lambda c: c.assign_attrs(amulor_schema_version="0"),
        "'amulor_schema_version'",
    ),
    "dimensions swapped": (lambda c: c.transpose("row", ...), r"\(row, "),
    "wrong unit": (
        lambda c: c.assign(in_phase=c["in_phase"].assign_attrs(units="mV")),
        "'mV'",
    ),
    "no long_name": (
        lambda c: c.assign(in_phase=c["in_phase"].assign_attrs(long_name="")),
        "long_name",
    ),
    "a stranger": (lambda c: c.assign(temperature=1.0), "user_temperature"),
    "frequencies fall": (
        lambda c: xr.concat(
            [c, c.assign_coords(modulation_frequency=[1e6])],
            "modulation_frequency",
            data_vars="minimal",
            coords="minimal",
            compat="override",
        ).assign_coords(
            modulation_frequency=(
                "modulation_frequency",
                [39e6, 1e6],
                c["modulation_frequency"].attrs,
            )
        ),
        "must increase",
    ),
    "a direction is no number": (
        lambda c: c.assign_coords(azimuth=c["azimuth"] * np.nan).pipe(
            lambda d: d.assign_coords(
                azimuth=d["azimuth"].assign_attrs(c["azimuth"].attrs)
            )
        ),
        "'azimuth' holds values",
    ),
    "no group index": (
        lambda c: c.assign_coords(
            geometry=c["geometry"]
            .drop_attrs()
            .assign_attrs(units="1", long_name="where")
        ),
        "'group_index'",
    ),
    "open water lacks the quadrature": (
        lambda c: c.drop_vars("open_water_quadrature"),
        "open_water variable 'quadrature'",
    ),
    "an unknown channel": (
        lambda c: c.assign_coords(
            polarization=("polarization", ["VV", "XY"], c["polarization"].attrs)
        ),
        "'XY'",
    ),
    "no frequency at all": (
        lambda c: c.isel(modulation_frequency=slice(0, 0)),
        "is empty",
    ),
    "a text for a group index": (
        lambda c: c.assign_coords(
            geometry=c["geometry"].assign_attrs(group_index="about 1.4")
        ),
        "'group_index' or holds",
    ),
    "a position with two numbers": (
        lambda c: c.assign_coords(
            geometry=c["geometry"].assign_attrs(receiver_position=[0.07, 0.0])
        ),
        "'receiver_position' or holds something else than 3",
    ),
    "text for numbers": (
        lambda c: c.assign(
            in_phase=c["in_phase"].astype(str).assign_attrs(c["in_phase"].attrs)
        ),
        "needed are numbers",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES, ids=list(DAMAGES))
def test_what_is_wrong_is_named_in_one_line(samples: xr.Dataset, damage: str) -> None:
    harm, words = DAMAGES[damage]
    with pytest.raises(CubeError, match=words) as caught:
        cubes.check(harm(samples.copy()), name="scan.nc")
    assert str(caught.value).startswith("scan.nc: ")
    assert "\n" not in str(caught.value)


def test_a_wrong_level_says_which_command_leads_on(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="amulor reject, then amulor image"):
        cubes.check(samples, "range_image")


def test_a_group_is_selected_with_its_cube(samples: xr.Dataset) -> None:
    one = samples.sel(polarization=["VH"]).amulor.open_water
    assert one is not None
    assert one.sizes["polarization"] == 1
    assert set(one.data_vars) >= {"in_phase", "quadrature", "azimuth"}
    whole = samples.amulor.open_water
    assert whole is not None
    xr.testing.assert_identical(
        one["in_phase"], whole["in_phase"].sel(polarization=["VH"])
    )


def test_without_groups_no_truth_is_left(samples: xr.Dataset) -> None:
    bare = cubes.without_groups(samples)
    assert bare.amulor.truth is None
    assert bare.amulor.open_water is None
    cubes.check(bare)


def test_the_signal_is_in_phase_plus_i_quadrature(samples: xr.Dataset) -> None:
    signal = samples.amulor.signal.values
    np.testing.assert_array_equal(signal.real, samples["in_phase"].values)
    np.testing.assert_array_equal(signal.imag, samples["quadrature"].values)
    np.testing.assert_allclose(
        samples.amulor.amplitude.values * np.exp(1j * samples.amulor.phase.values),
        signal,
        rtol=1e-12,
    )


def test_flags_explain_themselves_as_cf_asks() -> None:
    attributes = schema.flag_attributes()
    masks, names = attributes["flag_masks"], attributes["flag_meanings"].split()
    assert len(masks) == len(names) == len(set(names))
    assert masks.dtype == np.int16
    # Independent flags: each is one bit.
    assert all(bin(mask).count("1") == 1 for mask in masks)


def test_each_step_adds_a_line_to_the_history(samples: xr.Dataset) -> None:
    twice = cubes.note(cubes.note(samples, "one"), "two")
    lines = twice.attrs["history"].splitlines()
    assert lines[-1].endswith(": two")
    assert lines[-2].endswith(": one")
    assert len(lines) == len(samples.attrs["history"].splitlines()) + 2


def test_a_cube_leaves_memory_with_its_last_user(samples: xr.Dataset) -> None:
    cube = samples.copy()
    signal = cube.amulor.signal
    seen = weakref.ref(cube)
    gc.disable()
    try:
        del cube
        # Without a collection: of cubes with gigabytes there may be none in time.
        assert seen() is None
    finally:
        gc.enable()
    assert signal.shape == samples["in_phase"].shape
