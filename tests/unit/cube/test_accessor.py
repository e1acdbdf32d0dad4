"""Groups, signals and counts of a cube of a few numbers."""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor.cube import accessor, provenance, schema

CHANNEL = ("modulation_frequency", "polarization")


@pytest.fixture
def cube() -> xr.Dataset:
    """Return one row of two pixels with shots, truth and times of readings."""
    pixel = ("row", "column")
    return xr.Dataset(
        {
            "in_phase": (pixel, [[3.0, -1.0]], {"units": "V"}),
            "quadrature": (pixel, [[-4.0, 0.0]], {"units": "V"}),
            "water_in_phase": (pixel, [[1.0, 2.0]]),
            "water_quadrature": (pixel, [[5.0, 6.0]]),
            "open_water_in_phase": ("shot", [7.0, 8.0], {"units": "V"}),
            "open_water_azimuth": ("shot", [0.1, 0.2]),
            "truth_target": (pixel, [[0, -1]]),
            "user_truth": (pixel, [[1, 2]]),
        },
        {
            "azimuth": ("column", [0.3, 0.4]),
            "shot": [10, 11],
            "reading": [0, 1, 2],
            "reading_time": ("reading", [0.0, 1.0, 2.0]),
            "polarization": ("polarization", ["VV", "VH"]),
            "geometry": ((), 0, {"group_index": 1.38}),
        },
        {"level": "samples", "history": "one"},
    )


def test_a_group_has_no_coordinate_of_the_name_of_its_variable(
    cube: xr.Dataset,
) -> None:
    cube["open_water_azimuth"] = cube["open_water_azimuth"].assign_coords()
    crossed = cube.assign_coords(azimuth=("shot", [9.0, 9.0]))
    for each in (cube, crossed):
        shots = cubes.group(each, "open_water")
        assert shots is not None
        assert set(shots.data_vars) == {"in_phase", "azimuth"}
        assert shots["azimuth"].values.tolist() == [0.1, 0.2]
        assert shots["shot"].values.tolist() == [10, 11]
        assert shots.attrs == {}
        assert shots["in_phase"].attrs == {"units": "V"}
    assert cubes.group(cubes.without_groups(cube), "open_water") is None
    assert set(cube.amulor.truth.data_vars) == {"target"}


def test_groups_are_left_out_by_their_names(cube: xr.Dataset) -> None:
    rest = {
        "in_phase", "quadrature", "water_in_phase", "water_quadrature", "user_truth",
    }  # fmt: skip
    assert set(cubes.without_groups(cube).data_vars) == rest
    shots = {"open_water_in_phase", "open_water_azimuth"}
    assert set(cubes.without_groups(cube, "truth").data_vars) == rest | shots
    bare = cubes.without_groups(cube, "open_water")
    assert set(bare.data_vars) == rest | {"truth_target"}
    assert bare["reading_time"].values.tolist() == [0, 1, 2]
    assert bare.attrs == cube.attrs


def test_a_group_is_attached_under_its_prefix(cube: xr.Dataset) -> None:
    part = xr.Dataset({"target": (("row", "column"), [[5, 6]], {"units": "1"})})
    found = cubes.attach(cube, part, "truth")
    assert found["truth_target"].values.tolist() == [[5, 6]]
    assert found["truth_target"].attrs == {"units": "1"}
    assert cube["truth_target"].values.tolist() == [[0, -1]]


def test_flags_are_counted_by_their_names(cube: xr.Dataset) -> None:
    assert cubes.flag_counts(cube) == {}
    flag = np.array([[64 | 128, 64]], np.int16)
    attributes = schema.flag_attributes()
    flagged = cube.assign(quality_flag=(("row", "column"), flag, attributes))
    names = dict(zip(attributes["flag_masks"].tolist(),
                     attributes["flag_meanings"].split(), strict=True))  # fmt: skip
    assert cubes.flag_counts(flagged) == {names[64]: 2, names[128]: 1}


def test_signals_are_complex_with_names_and_units(cube: xr.Dataset) -> None:
    found = cube.amulor
    for name, values, units, meaning in (
        ("signal", [[3 - 4j, -1 + 0j]], "V", "signal"),
        ("amplitude", [[5.0, 1.0]], "V", "amplitude of the modulation"),
        ("phase", [[-np.arctan2(4, 3), np.pi]], "rad", "delay behind the reference"),
        ("water_signal", [[1 + 5j, 2 + 6j]], "V", "water signal"),
    ):
        array = getattr(found, name)
        np.testing.assert_allclose(array.values, values)
        assert array.name == name
        assert array.attrs == {"units": units, "long_name": meaning}


def test_a_covariance_is_0_unless_it_is_in_the_cube(cube: xr.Dataset) -> None:
    zero = cube.amulor.covariance
    assert zero.values.tolist() == [[0, 0]]
    assert zero.attrs == {"units": "V2"}
    stated = cube.assign(in_phase_quadrature_covariance=cube["in_phase"] * 2)
    assert stated.amulor.covariance.values.tolist() == [[6, -2]]


def test_properties_of_a_cube_are_those_of_its_attributes(cube: xr.Dataset) -> None:
    assert cube.amulor.level == "samples"
    assert cube.amulor.polarizations == ["VV", "VH"]
    assert cube.isel(polarization=1).amulor.polarizations == ["VH"]
    assert cube.amulor.geometry == {"group_index": 1.38}
    assert cube.amulor.survey is None
    assert cube.assign_attrs(survey="").amulor.survey is None
    assert xr.Dataset.amulor is accessor.CubeAccessor


def test_a_variable_that_a_level_lacks_is_not_built() -> None:
    with pytest.raises(
        ValueError, match=r"^'depth' is not one of in_phase, quadrature"
    ):
        cubes.build("samples", {"depth": 1.0}, {}, geometry={}, attributes={})


def test_a_built_cube_has_units_and_meanings_of_the_schema() -> None:
    flags = np.zeros((1, 1), np.int16)
    image = cubes.build(
        "range_image",
        {"slant_range": [[2.0]], "quality_flag": flags, "water_residual_cause": flags},
        {"azimuth": [[0.1]]},
        geometry={"group_index": 1.38},
        attributes={"level": "range_image"},
    )
    expected = schema.LEVELS["range_image"].variables["slant_range"]
    assert image["slant_range"].attrs == {"long_name": expected.long_name, "units": "m"}
    assert image["slant_range"].dims == ("row", "column")
    np.testing.assert_equal(image["quality_flag"].attrs, schema.flag_attributes())
    cause = image["water_residual_cause"].attrs
    np.testing.assert_equal(cause, schema.cause_attributes())
    geometry = image["geometry"]
    assert (geometry.dtype, int(geometry)) == (np.int32, 0)
    assert geometry.attrs["group_index"] == 1.38
    assert geometry.attrs["units"] == "1"
    assert image.attrs == {"level": "range_image"}


def test_channels_are_objects_that_grow() -> None:
    cube = cubes.build(
        "samples", {}, {"polarization": ["VV"]}, geometry={}, attributes={}
    )
    assert cube["polarization"].dtype == object


def test_a_digest_is_that_of_bytes_texts_and_files(tmp_path: Path) -> None:
    # FIPS 180-4, SHA-256 of "abc".
    expected = "sha256:ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    path = tmp_path / "file"
    path.write_bytes(b"abc")
    assert [cubes.digest(each) for each in (b"abc", "abc", path)] == [expected] * 3
    assert cubes.digest("é") == cubes.digest("é".encode())


def test_attributes_of_a_cube_state_its_origin() -> None:
    found = cubes.attributes("samples", title="Tank", source="bench", a=None, b=0)
    assert list(found) == [
        "Conventions", "title", "source", "level", "amulor_schema_version",
        "software_versions", "b",
    ]  # fmt: skip
    assert (found["title"], found["source"], found["b"]) == ("Tank", "bench", 0)
    assert found["Conventions"] == schema.CONVENTIONS
    assert found["amulor_schema_version"] == schema.SCHEMA_VERSION
    versions = json.loads(found["software_versions"])
    assert versions == provenance.software_versions()
    assert list(versions) == ["amulor", "numpy", "scipy", "numba", "xarray", "h5netcdf"]


def test_a_history_is_dated_in_universal_time(cube: xr.Dataset) -> None:
    version = provenance.software_versions()["amulor"]
    when = datetime.datetime(2026, 5, 4, 12, 30, 5, tzinfo=datetime.UTC)
    with provenance.dated(when):
        noted = cubes.note(cube, "two")
        first = cubes.note(xr.Dataset(), "two")
    line = f"2026-05-04T12:30:05Z amulor {version}: two"
    assert noted.attrs["history"] == f"one\n{line}"
    assert first.attrs["history"] == line
    before = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    now = cubes.note(xr.Dataset(), "x").attrs["history"].split()[0]
    after = datetime.datetime.now(datetime.UTC)
    assert before <= datetime.datetime.fromisoformat(now) <= after
