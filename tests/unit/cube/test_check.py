"""Whole messages of the schema check, on cubes of a few numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor.cube import schema
from amulor.cube.values import check_errors, check_limits, check_pairs, check_values
from amulor.errors import CubeError

SIZES = {
    "modulation_frequency": 2, "polarization": 1, "row": 2, "column": 3, "shot": 2,
    "point": 4,
}  # fmt: skip
GEOMETRY: dict[str, Any] = {
    "group_index": 1.38,
    "refractive_index": 1.34,
    "emitter_position": [0.0, 0.0, 0.0],
    "receiver_position": [0.07, 0.0, 0.0],
}
COORDINATES = {"modulation_frequency": [1e6, 2e6], "polarization": ["VV"]}


def ones(spec: schema.Variable) -> np.ndarray:
    return np.ones([SIZES[dimension] for dimension in spec.dimensions])


def cube_of(level: str) -> xr.Dataset:
    """Return the smallest cube of a level, with ones for all values."""
    expected = schema.LEVELS[level]
    needed = {name: s for name, s in expected.variables.items() if s.required}
    places = {
        name: COORDINATES.get(name, ones(spec))
        for name, spec in expected.coordinates.items()
        if spec.required and name != "geometry"
    }
    cube = cubes.build(
        level,
        {name: ones(spec) for name, spec in needed.items()},
        places,
        geometry=GEOMETRY,
        attributes=cubes.attributes(level, title="", source=""),
    )
    if "quality_flag" in cube:
        cube["quality_flag"] = cube["quality_flag"].astype(np.int16)
    if level == "samples":
        shots = {name: ones(s) for name, s in schema.OPEN_WATER_VARIABLES.items()}
        cube = cubes.attach(cube, cubes.open_water(shots), "open_water")
    return cube


def with_geometry(**changed: Any) -> Callable[[xr.Dataset], xr.Dataset]:
    def change(cube: xr.Dataset) -> xr.Dataset:
        attributes = {**cube["geometry"].attrs, **changed}
        attributes = {k: v for k, v in attributes.items() if v is not None}
        return cube.assign_coords(geometry=((), np.int32(0), attributes))

    return change


def with_variable(name: str, **changed: Any) -> Callable[[xr.Dataset], xr.Dataset]:
    """Change dimensions, values or attributes of a variable."""

    def change(cube: xr.Dataset) -> xr.Dataset:
        old = cube.variables[name]
        attributes = {**old.attrs, **changed.get("attrs", {})}
        variable = xr.Variable(
            changed.get("dims", old.dims), changed.get("values", old.values), attributes
        )
        whole = cube.drop_vars(name)
        if name in cube.coords:
            return whole.assign_coords({name: variable})
        return whole.assign({name: variable})

    return change


def bad(shape: tuple[int, ...], value: float, at: tuple[int, ...]) -> np.ndarray:
    values = np.ones(shape)
    values[at] = value
    return values


@pytest.mark.parametrize("level", schema.LEVELS)
def test_the_smallest_cube_of_a_level_passes(level: str) -> None:
    cubes.check(cube_of(level))
    cubes.check(cube_of(level), level)


@pytest.mark.parametrize("level", schema.LEVELS)
def test_a_selection_of_one_value_is_one_of_a_list_of_one(level: str) -> None:
    cube = cube_of(level).assign(user_note=("place", [1.0, 2.0]))
    for dimension in set(cube.sizes) - {"place"}:
        one, several = cube.isel({dimension: 0}), cube.isel({dimension: [0]})
        xr.testing.assert_identical(cubes.restore_dimensions(one), several)
        cubes.checked(one, level)
    whole = cube.isel(dict.fromkeys(set(cube.sizes) - {"place"}, 0))
    restored = cubes.restore_dimensions(whole)
    assert {size for name, size in restored.sizes.items() if name != "place"} == {1}
    assert restored["user_note"].dims == ("place",)
    assert cubes.restore_dimensions(cube) is cube


def test_dimensions_without_their_coordinate_stay_away() -> None:
    cube = cube_of("samples")
    bare = cube.isel(polarization=0, drop=True)
    assert cubes.restore_dimensions(bare) is bare
    other = cube.isel(row=0).assign_attrs(level="other")
    assert cubes.restore_dimensions(other) is other
    # A variable that lacks another dimension, too, is left as it is.
    lacking = cube.assign(in_phase=cube["in_phase"].isel(column=0, row=0))
    restored = cubes.restore_dimensions(lacking.isel(modulation_frequency=0))
    assert restored["in_phase"].dims == ("polarization",)
    assert restored["quadrature"].dims == cube["quadrature"].dims
    channel = cubes.restore_dimensions(cube.isel(polarization=0))["polarization"]
    assert (channel.dtype, channel.values.tolist()) == (object, ["VV"])


def test_frequencies_may_be_below_1_hz() -> None:
    cubes.check(with_variable("modulation_frequency", values=[0.5, 2.0])(
        cube_of("samples")))  # fmt: skip


SIGNAL = (2, 1, 2, 3)
AT = "at modulation_frequency 1, polarization 0, row 1, column 2"
#: What is done to a cube of samples, and what is said of it.
WORDS: dict[str, tuple[Callable[[xr.Dataset], xr.Dataset], str]] = {
    "no level": (
        lambda c: c.assign_attrs(level=None),
        "attribute 'level' is None, but must be one of samples, target_signal, "
        "range_image, point_cloud; is this a file of amulor?",
    ),
    "other schema": (
        lambda c: c.assign_attrs(amulor_schema_version="0"),
        "attribute 'amulor_schema_version' is '0', this amulor reads "
        f"{schema.SCHEMA_VERSION!r}; use the amulor that wrote the file",
    ),
    "stranger": (
        lambda c: c.assign(depth=1.0),
        "variable 'depth' has no place in a samples; drop it, or rename it to "
        "'user_depth'",
    ),
    "lost variable": (
        lambda c: c.drop_vars("in_phase"),
        "variable 'in_phase' is missing; needed is "
        f"{schema.LEVELS['samples'].variables['in_phase'].long_name} [V] over "
        "(modulation_frequency, polarization, row, column)",
    ),
    "lost coordinate": (
        lambda c: c.drop_vars("azimuth"),
        "coordinate 'azimuth' is missing; needed is "
        f"{schema.LEVELS['samples'].coordinates['azimuth'].long_name} [rad] over "
        "(row, column)",
    ),
    "dimensions": (
        with_variable("azimuth", dims=("column", "row"), values=np.ones((3, 2))),
        "coordinate 'azimuth' has dimensions (column, row), needed are (row, column); "
        "transpose or rebuild it",
    ),
    "unit": (
        with_variable("quadrature", attrs={"units": "mV"}),
        "variable 'quadrature' has units 'mV', needed is 'V'; convert the values and "
        "set the attribute",
    ),
    "name": (
        with_variable("azimuth", attrs={"long_name": ""}),
        "coordinate 'azimuth' lacks the attribute 'long_name'; write what it is, for "
        f"example {schema.LEVELS['samples'].coordinates['azimuth'].long_name!r}",
    ),
    "texts": (
        with_variable("azimuth", values=np.full((2, 3), "a")),
        "coordinate 'azimuth' holds <U1, needed are numbers",
    ),
    "no frequency": (
        lambda c: c.isel(modulation_frequency=slice(0)),
        "coordinate 'modulation_frequency' is empty; select at least one frequency",
    ),
    "frequency of zero": (
        with_variable("modulation_frequency", values=[0.0, 2e6]),
        "coordinate 'modulation_frequency' must be finite and above 0 Hz, found 0 Hz",
    ),
    "frequency below zero": (
        with_variable("modulation_frequency", values=[2e6, -1e6]),
        "coordinate 'modulation_frequency' must be finite and above 0 Hz, found "
        "-1e+06 Hz",
    ),
    "frequency not finite": (
        with_variable("modulation_frequency", values=[2e6, np.inf]),
        "coordinate 'modulation_frequency' must be finite and above 0 Hz, found "
        "2e+06 Hz",
    ),
    "frequency twice": (
        with_variable("modulation_frequency", values=[2e6, 2e6]),
        "coordinate 'modulation_frequency' must increase; sort the cube by it and drop "
        "what stands there twice",
    ),
    "channel": (
        with_variable("polarization", values=np.array(["VX"], dtype=object)),
        "coordinate 'polarization' holds 'VX'; needed is \"none\" or two of the "
        "letters V, H, P, M, R, L",
    ),
    "direction": (
        with_variable("elevation", values=bad((2, 3), np.inf, (1, 1))),
        "coordinate 'elevation' holds values that are not finite; every pixel needs a "
        "direction, measured or not",
    ),
    "index": (
        with_geometry(group_index=[1.3, 1.4]),
        "coordinate 'geometry' lacks the attribute 'group_index' or holds something "
        "else than 1 finite numbers in it: group index of the water, for the speed of "
        "the modulation [1]",
    ),
    "position": (
        with_geometry(receiver_position=[0.0, 0.0, np.nan]),
        "coordinate 'geometry' lacks the attribute 'receiver_position' or holds "
        "something else than 3 finite numbers in it: middle of the receiver's "
        "aperture [m]",
    ),
    "half of a window": (
        with_geometry(window_distance=0.2),
        "coordinate 'geometry' lacks the attribute 'window_thickness' or holds "
        "something else than 1 finite numbers in it: thickness of the window [m]",
    ),
    "uncertainty of zero": (
        with_variable("in_phase_uncertainty", values=bad(SIGNAL, 0, (1, 0, 1, 2))),
        f"in_phase_uncertainty is 0 V {AT}, but must be above 0 V; state the error of "
        "the samples, or make them NaN",
    ),
    "uncertainty below zero": (
        with_variable("in_phase_uncertainty", values=bad(SIGNAL, -2, (1, 0, 1, 2))),
        f"in_phase_uncertainty is -2 V {AT}, but must be above 0 V; state the error of "
        "the samples, or make them NaN",
    ),
    "large uncertainty": (
        with_variable("in_phase_uncertainty", values=bad(SIGNAL, 2e15, (1, 0, 1, 2))),
        f"in_phase_uncertainty is 2e+15 V {AT}; make the samples NaN that nothing is "
        "known of",
    ),
    "large signal": (
        with_variable("quadrature", values=bad(SIGNAL, -2e15, (1, 0, 1, 2))),
        f"quadrature is -2e+15 V {AT}, more than any instrument gives (1e+15 V); the "
        "file is damaged, or its unit is not the volt",
    ),
    "sample without error": (
        with_variable("in_phase_uncertainty", values=bad(SIGNAL, np.nan, (1, 0, 1, 2))),
        f"in_phase_uncertainty is NaN {AT}, where the sample is a number; state its "
        "error, or make the sample NaN",
    ),
    "saturated": (
        lambda c: c.assign(
            saturated=(c["in_phase"] + 1).assign_attrs(units="1", long_name="overload")
        ),
        "saturated is 2 at modulation_frequency 0, polarization 0, row 0, column 0, "
        "but must be 0 or 1; correct it, or drop the variable",
    ),
    "shot": (
        with_variable("open_water_elevation", values=[0.0, np.nan]),
        "open_water elevation holds values that are not finite; drop the shots whose "
        "direction is not known",
    ),
    "half of a shot": (
        with_variable(
            "open_water_quadrature", values=bad((2, 1, 2), np.nan, (1, 0, 1))
        ),
        "open_water: one of in_phase and quadrature is NaN at modulation_frequency 1, "
        "polarization 0, shot 1; state both, or make both NaN if the sample is missing",
    ),
    "unit of a shot": (
        with_variable("open_water_azimuth", attrs={"units": "deg"}),
        "open_water variable 'azimuth' has units 'deg', needed is 'rad'; convert the "
        "values and set the attribute",
    ),
    "covariance of a shot": (
        with_variable(
            "open_water_in_phase_quadrature_covariance",
            values=bad((2, 1, 2), -1.1, (1, 0, 1)),
        ),
        "open_water: in_phase_quadrature_covariance is above the product of the two "
        "uncertainties at modulation_frequency 1, polarization 0, shot 1; state the "
        "covariance of the errors [V^2]",
    ),
    "two of three": (
        lambda c: c.drop_vars("open_water_common_covariance"),
        "open_water: has common_in_phase_uncertainty, common_quadrature_uncertainty, "
        "but common_covariance is missing; errors that are shared need all three, or "
        "drop what there is of them",
    ),
    "shot without error": (
        with_variable(
            "open_water_quadrature_uncertainty",
            values=bad((2, 1, 2), np.nan, (1, 0, 1)),
        ),
        "open_water: quadrature_uncertainty is NaN at modulation_frequency 1, "
        "polarization 0, shot 1, where the sample is a number; state its error, or "
        "make the sample NaN",
    ),
}


@pytest.mark.parametrize("damage", WORDS)
def test_a_damage_is_named_with_its_place_and_a_remedy(damage: str) -> None:
    harm, words = WORDS[damage]
    cube = harm(cube_of("samples"))
    # `open_water` belongs to the name of what is checked.
    name = "scan.nc, " if words.startswith("open_water: ") else "scan.nc: "
    with pytest.raises(CubeError) as caught:
        cubes.check(cube, name="scan.nc")
    assert str(caught.value) == name + words
    with pytest.raises(CubeError) as caught:
        cubes.checked(cube)
    assert str(caught.value) == name.replace("scan.nc", "the cube") + words


@pytest.mark.parametrize(
    ("actual", "level", "remedy"),
    [
        ("samples", "target_signal", "make it with: amulor reject"),
        ("samples", "range_image", "make it with: amulor reject, then amulor image"),
        ("target_signal", "point_cloud",
         "make it with: amulor image, then amulor export"),
        ("range_image", "samples", "take the samples file that it was made from"),
        ("point_cloud", "range_image",
         "take the range_image file that it was made from"),
    ],
)  # fmt: skip
def test_another_level_names_the_commands_or_the_file(
    actual: str, level: str, remedy: str
) -> None:
    with pytest.raises(CubeError) as caught:
        cubes.checked(cube_of(actual), level)
    assert str(caught.value) == (
        f"the cube: is of level {actual}, but level {level} is needed here; {remedy}"
    )


def test_all_of_a_window_may_be_in_the_geometry() -> None:
    window = dict.fromkeys(schema.WINDOW_ATTRIBUTES, 1)
    cubes.check(with_geometry(**window)(cube_of("samples")))


def array(*values: float, name: str = "x", units: str = "V") -> xr.DataArray:
    return xr.DataArray(
        np.array(values), dims="modulation_frequency", name=name,
        attrs={"units": units},
    )  # fmt: skip


def refused(check: Callable[..., None], checked: Any) -> bool:
    try:
        check(checked, name="")
    except CubeError:
        return True
    return False


@pytest.mark.parametrize(
    ("name", "accepted", "refuses"),
    [
        ("in_phase", [1e15, -1e15, 0, np.nan], [1.1e15, -1.1e15, np.inf]),
        ("a_uncertainty", [1e15, 1e-300, np.nan], [1.1e15, 0, -1e-300]),
        ("common_a_uncertainty", [1e15, 0], [1.1e15, -1e-300]),
        ("phase_uncertainty", [0, -1, 1e15], [1.1e15]),
    ],
)
def test_volts_have_limits(
    name: str, accepted: list[float], refuses: list[float]
) -> None:
    for value in accepted:
        assert not refused(check_values, {name: array(1.0, value)})
    for value in refuses:
        assert refused(check_values, {name: array(1.0, value)})


def test_only_volts_over_frequencies_are_limited() -> None:
    assert not refused(check_values, {"x": array(1e20, units="1")})
    assert not refused(
        check_values, {"x": array(1e20).rename(modulation_frequency="f")}
    )
    assert not refused(check_values, {"x": array(2e15).astype(int)})
    for name in ("x", "x_uncertainty"):
        assert not refused(check_values, {name: array()})
        assert not refused(check_values, {name: array(np.nan, np.nan)})


@pytest.mark.parametrize(
    ("name", "highest"), [("saturated", 1), ("time", 1e11), ("reading_time", 1e11),
                          ("reading_duration", 1e6)]
)  # fmt: skip
def test_flags_and_times_have_limits(name: str, highest: float) -> None:
    for value, wrong in (
        (0.0, False), (highest, False), (1.05 * highest, True), (-1e-9, True)
    ):  # fmt: skip
        assert refused(check_limits, xr.Dataset({name: ("row", [0.5, value])})) == wrong
    assert not refused(check_limits, xr.Dataset({name: ("row", [])}))
    assert not refused(check_limits, xr.Dataset({f"other_{name}": ("row", [-1.0])}))


ERRORS = (
    "in_phase_uncertainty", "quadrature_uncertainty", "in_phase_quadrature_covariance",
)  # fmt: skip


def test_a_covariance_may_be_the_product_of_the_uncertainties() -> None:
    for covariance, wrong in ((6, False), (-6, False), (6.001, True), (-6.001, True)):
        values = (array(9, 2.0), array(9, 3.0), array(0, covariance, units="V2"))
        assert refused(check_values, dict(zip(ERRORS, values, strict=True))) == wrong
    # Of other dimensions nothing can be said, nor without all three.
    shared = array(100.0).rename(modulation_frequency="polarization")
    values = (array(1.0), array(1.0), shared)
    assert not refused(check_values, dict(zip(ERRORS, values, strict=True)))
    assert not refused(check_values, {ERRORS[0]: array(1.0), ERRORS[2]: array(5.0)})


def test_errors_are_of_all_samples_or_of_none() -> None:
    nan = np.nan
    signal = {"in_phase": array(1, nan, 1), "quadrature": array(1, 1, 1)}
    for error in ERRORS:
        for values, wrong in (
            ((1, nan, 1), False), ((1, 1, 1), False), ((nan, nan, nan), False),
            ((nan, 1, 1), True), ((1, 1, nan), True),
        ):  # fmt: skip
            assert refused(check_errors, {**signal, error: array(*values)}) == wrong
        assert not refused(check_errors, {**signal, error: array(nan, 1)})
    assert not refused(check_errors, signal)


def test_a_sample_has_both_components_or_none() -> None:
    nan = np.nan
    for first, second, wrong in (
        ((1, nan), (1, nan), False), ((1, 1), (1, nan), True), ((nan, 1), (1, 1), True)
    ):  # fmt: skip
        pair = {"in_phase": array(*first), "quadrature": array(*second)}
        assert refused(check_pairs, pair) == wrong
