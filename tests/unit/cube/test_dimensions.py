"""Selecting a single value, as xarray users do, is as good as selecting a list."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor import imaging, io, rejection
from amulor.errors import CubeError, SurveyError
from amulor.simulation import simulate
from amulor.survey import Survey

Step = Callable[[xr.Dataset], Any]


@pytest.fixture(scope="module")
def samples(plate_text: str) -> xr.Dataset:
    text = plate_text.replace('["39 MHz"]', '["10 MHz", "39 MHz", "61 MHz"]')
    return simulate(Survey.from_text(text), rng=5)


@pytest.fixture(scope="module")
def target(samples: xr.Dataset) -> xr.Dataset:
    return rejection.open_water(samples)


@pytest.fixture(scope="module")
def image(target: xr.Dataset) -> xr.Dataset:
    return imaging.range_image(target, polarization="VV")


def _one(cube: xr.Dataset, **selection: Any) -> xr.Dataset:
    """Select by value where there are values, by number where there are none."""
    named = {key: value for key, value in selection.items() if key in cube.coords}
    rest = {key: value for key, value in selection.items() if key not in named}
    return cube.sel(named).isel(rest)


def _comparable(result: Any) -> Any:
    """Return a result without the time at which it was made."""
    if isinstance(result, xr.Dataset):
        return result.drop_attrs(deep=False)
    return result


def assert_same(first: Any, second: Any) -> None:
    """Compare what steps return, field by field; not a number equals itself."""
    if isinstance(first, (xr.Dataset, xr.DataArray)):
        xr.testing.assert_identical(_comparable(first), _comparable(second))
    elif hasattr(first, "__dataclass_fields__"):
        assert type(first) is type(second)
        for name in first.__dataclass_fields__:
            assert_same(getattr(first, name), getattr(second, name))
    elif isinstance(first, (tuple, list)):
        assert len(first) == len(second)
        for one, other in zip(first, second, strict=True):
            assert_same(one, other)
    elif isinstance(first, dict):
        assert first.keys() == second.keys()
        for key, value in first.items():
            assert_same(value, second[key])
    else:
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    "selection",
    [
        {"polarization": "VV"},
        {"modulation_frequency": 39e6},
        {"row": 2},
        {"column": 3, "polarization": "VH"},
        {"polarization": "VV", "modulation_frequency": 10e6, "row": 0, "column": 0},
        {"shot": 4},
    ],
    ids=lambda selection: "+".join(selection),
)
def test_what_one_value_took_away_is_put_back(
    samples: xr.Dataset, selection: dict[str, Any]
) -> None:
    lists = {key: [value] for key, value in selection.items()}
    whole = _one(samples, **lists)
    restored = cubes.restore_dimensions(_one(samples, **selection))
    xr.testing.assert_identical(restored, whole)
    assert restored["polarization"].dtype == whole["polarization"].dtype
    cubes.check(restored, "samples")


def test_every_level_gets_its_dimensions_back(
    target: xr.Dataset, image: xr.Dataset
) -> None:
    cloud = imaging.point_cloud(image)
    for cube, name in (
        (target, "polarization"),
        (target, "modulation_frequency"),
        (image, "row"),
        (image, "column"),
        (cloud, "point"),
    ):
        one, several = cube.isel({name: 1}), cube.isel({name: [1]})
        xr.testing.assert_identical(one.amulor.restored, several)


def test_a_whole_cube_is_passed_on_as_it_is(samples: xr.Dataset) -> None:
    assert cubes.restore_dimensions(samples) is samples
    assert cubes.checked(samples, "samples") is samples


def test_what_cannot_be_known_is_still_refused(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="'polarization' is missing"):
        cubes.checked(samples.isel(polarization=0, drop=True))
    turned = samples.sel(polarization="VV").transpose("row", ...)
    with pytest.raises(CubeError, match=r"has dimensions \(row, "):
        cubes.checked(turned)
    lacking = samples.assign(in_phase=samples["in_phase"].isel(row=0))
    with pytest.raises(CubeError, match="'in_phase' has dimensions"):
        cubes.checked(lacking)


def test_a_variable_of_the_user_stays_as_it_is(samples: xr.Dataset) -> None:
    own = samples.assign(user_depth=samples["in_phase"].mean("column"))
    restored = cubes.checked(own.sel(polarization="VV"))
    assert restored["user_depth"].dims == ("modulation_frequency", "row")


def test_the_accessor_follows_the_selection(samples: xr.Dataset) -> None:
    one = samples.sel(polarization="VV", modulation_frequency=39e6)
    assert one.amulor.polarizations == ["VV"]
    for name in ("signal", "amplitude", "phase", "covariance"):
        picked = getattr(one.amulor, name)
        assert picked.dims == ("row", "column")
        np.testing.assert_array_equal(
            picked, getattr(samples.amulor, name).values[1, 0], err_msg=name
        )
    shots = one.amulor.open_water
    assert shots["in_phase"].dims == ("shot",)
    assert one.amulor.restored.amulor.signal.shape == (1, 1, 6, 12)


REJECTION: dict[str, Step] = {
    "co_polarized": rejection.co_polarized,
    "keep_water": rejection.keep_water,
    "open_water": rejection.open_water,
    "frequency": rejection.frequency,
    "choose_frequency": rejection.choose_frequency,
    "smooth_surface": rejection.smooth_surface,
    "choose_channel": rejection.choose_channel,
    "with_open_water": lambda cube: rejection.with_open_water(cube, cube),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REJECTION)
def test_rejection_takes_one_channel(samples: xr.Dataset, name: str) -> None:
    step = REJECTION[name]
    one = step(samples.sel(polarization="VV"))
    assert_same(one, step(samples.sel(polarization=["VV"])))


SINGLE: dict[str, Step] = {"compare": rejection.compare, "auto": rejection.auto}


@pytest.mark.slow
@pytest.mark.parametrize("name", SINGLE)
def test_rejection_takes_one_frequency(samples: xr.Dataset, name: str) -> None:
    step = SINGLE[name]
    one = step(samples.sel(polarization="VV", modulation_frequency=39e6))
    lists = samples.sel(polarization=["VV"], modulation_frequency=[39e6])
    assert_same(one, step(lists))


SWEEPS: dict[str, Step] = {
    "background": rejection.background,
    "joint": rejection.joint,
    "polarization_difference": rejection.polarization_difference,
    "range_profile": rejection.range_profile,
    "water_fit": rejection.water_fit,
}


@pytest.mark.parametrize("name", SWEEPS)
def test_a_fit_of_a_sweep_says_that_one_frequency_is_none(
    samples: xr.Dataset, name: str
) -> None:
    # Not that a dimension is missing, which is put back.
    with pytest.raises(CubeError, match=r"(one|1) modulation frequenc|got 1;"):
        SWEEPS[name](samples.sel(modulation_frequency=39e6))


def test_one_row_of_one_channel_is_estimated_jointly(samples: xr.Dataset) -> None:
    result = rejection.joint(samples.sel(polarization="VV").isel(row=2))
    cubes.check(result, "target_signal")
    assert result["in_phase"].shape == (3, 1, 1, 12)


def test_lines_of_phasors_take_one_frequency_and_channel(samples: xr.Dataset) -> None:
    selected = {"polarization": "VV", "modulation_frequency": 39e6}
    lists = {name: [value] for name, value in selected.items()}
    steps = [lambda: rejection.phasor_lines(samples.sel(selected)),
             lambda: rejection.phasor_lines(samples.sel(lists))]  # fmt: skip
    # The plate has one reflectance, which both refuse in the same words.
    messages = []
    for step in steps:
        with pytest.raises(CubeError) as refusal:
            step()
        messages.append(str(refusal.value))
    assert messages[0] == messages[1]
    assert "reflectance" in messages[0]


PAIRS: dict[str, Step] = {
    "cross_polarized": rejection.cross_polarized,
    "polarization": rejection.polarization,
    "unmix_stokes": lambda cube: rejection.unmix_stokes(
        cube,
        launched="V",
        target_mueller=np.diag([1, 0.61, -0.61, -0.22]),
        water_mueller=np.diag([1, 0.81, -0.81, -0.62]),
    ),
    "combined": rejection.combined,
    "water_ratio": rejection.water_ratio,
    "target_ratio": rejection.target_ratio,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PAIRS)
def test_rejection_takes_one_frequency_and_one_row(
    samples: xr.Dataset, name: str
) -> None:
    step = PAIRS[name]
    one = step(samples.sel(modulation_frequency=39e6).isel(row=2))
    assert_same(one, step(samples.sel(modulation_frequency=[39e6]).isel(row=[2])))


def test_stokes_vectors_take_one_frequency(plate_text: str) -> None:
    text = plate_text.replace('["VV", "VH"]', '["VV", "VH", "VP", "VR"]')
    cube = simulate(Survey.from_text(text), rng=1)
    one = rejection.stokes_vectors(cube.isel(modulation_frequency=0), launched="V")
    assert_same(one, rejection.stokes_vectors(cube, launched="V"))


def test_every_rejection_step_is_tested_here() -> None:
    classes = {name for name in rejection.__all__ if name[0].isupper()}
    # The first two have tests of their own, the third takes a fit, the rest names.
    others = {
        "stokes_vectors", "phasor_lines", "split_scattering", "load", "method", "names",
        "reject",
    }  # fmt: skip
    tested = {*REJECTION, *SINGLE, *SWEEPS, *PAIRS}
    assert set(rejection.__all__) == classes | tested | others


@pytest.mark.parametrize(
    "step",
    [
        imaging.range_image,
        lambda cube: imaging.unwrapped_range_image(cube, interval=(1.0, 2.0)),
    ],
    ids=["range_image", "unwrapped_range_image"],
)
@pytest.mark.parametrize("row", [2, slice(None)], ids=["row", "picture"])
def test_images_are_made_from_one_channel(
    target: xr.Dataset, step: Step, row: Any
) -> None:
    one = target.sel(polarization="VV", modulation_frequency=39e6).isel(row=row)
    rows = [row] if isinstance(row, int) else row
    lists = target.sel(polarization=["VV"], modulation_frequency=[39e6]).isel(row=rows)
    assert_same(step(one), step(lists))


ROW = np.ones((1, 12), dtype=bool)
HALF = np.arange(12)[None] < 6
IMAGING: dict[str, Step] = {
    "point_cloud": imaging.point_cloud,
    "flag_mixed": imaging.flag_mixed,
    "mixed_pixels": imaging.mixed_pixels,
    "flag_outliers": imaging.flag_outliers,
    "outlying_pixels": imaging.outlying_pixels,
    "covariance": lambda image: imaging.correlation.covariance(image, ROW),
    "mean_range": lambda image: imaging.correlation.mean_range(image, ROW),
    "range_difference": lambda image: imaging.correlation.range_difference(
        image, HALF, ~HALF
    ),
    "plane_residual": imaging.metrics.plane_residual,
    "step_heights": lambda image: imaging.metrics.step_heights(image, 1 + HALF),
    "contrast": lambda image: imaging.metrics.contrast(image, HALF, ~HALF),
}


@pytest.mark.parametrize("name", IMAGING)
def test_one_row_of_an_image_is_an_image(image: xr.Dataset, name: str) -> None:
    step = IMAGING[name]
    assert_same(step(image.isel(row=2)), step(image.isel(row=[2])))


def test_a_single_selection_is_stored_as_a_list_is(
    samples: xr.Dataset, image: xr.Dataset, tmp_path: Path
) -> None:
    cloud = imaging.point_cloud(image)
    for number, (cube, name) in enumerate(
        ((samples, "polarization"), (samples, "row"), (image, "row"), (cloud, "point"))
    ):
        path = tmp_path / f"{number}.nc"
        io.write_cube(cube.isel({name: 1}), path)
        xr.testing.assert_identical(
            io.read_cube(path).drop_attrs(deep=False),
            cube.isel({name: [1]}).drop_attrs(deep=False),
        )


@pytest.mark.parametrize("suffix", [".ply", ".las", ".e57"])
def test_a_single_point_is_a_cloud(
    image: xr.Dataset, suffix: str, tmp_path: Path
) -> None:
    cloud = imaging.point_cloud(image)
    paths = [tmp_path / f"{name}{suffix}" for name in ("one", "list")]
    io.write_cloud(cloud.isel(point=7), paths[0])
    io.write_cloud(cloud.isel(point=[7]), paths[1])
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_the_survey_of_a_cube_is_parsed_from_its_text(samples: xr.Dataset) -> None:
    bare = samples.drop_attrs(deep=False)
    assert bare.amulor.survey is None
    survey = Survey.preset("amulor-2010")
    known = bare.assign_attrs(survey=survey.to_toml())
    assert known.amulor.survey == survey
    other = survey.with_({"scan.dwell": "70 ms"})
    assert known.assign_attrs(survey=other.to_toml()).amulor.survey == other
    with pytest.raises(SurveyError, match="survey in the cube"):
        _ = bare.assign_attrs(survey="[water]").amulor.survey
