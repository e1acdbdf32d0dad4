"""Errors of the instrument from the attributes of a channel."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.cube import QualityFlag, error
from amulor.cube.error import (
    by_frequency,
    error_unknown,
    instrument_phase,
    leakage_volt,
    may_contain,
    without_unknown_errors,
)
from amulor.cube.readings import lag_of


def _channel(count: int = 2, **attributes: object) -> xr.Dataset:
    coordinates = {
        "modulation_frequency": np.arange(1.0, count + 1),
        "polarization": ["VH"],
    }
    return xr.Dataset(coords=coordinates, attrs=attributes)


def test_errors_of_phases_add_in_squares_and_channels_multiply_all_but_one() -> None:
    # 3 and 4 are 5; twice that is 10, and with 24 it is 26.
    channel = _channel(
        calibration_phase_uncertainty_rad=[3.0, 0.0],
        reference_phase_uncertainty_rad=[4.0, 0.0],
        phase_error_gain_VH=[2.0, 1.0],
        phase_error_gain_VV=[7.0, 7.0],
        channel_phase_rad=[24.0, 0.5],
    )
    assert_allclose(instrument_phase(channel, None), [26.0, 0.5])
    assert_allclose(instrument_phase(_channel(3), None), [0, 0, 0])


def test_the_leakage_is_multiplied_by_the_smallest_gain() -> None:
    channel = _channel(
        leakage_uncertainty_volt=[3e-6, 0.0],
        offset_uncertainty_volt=[4e-6, 1e-6],
        phase_error_gain_VH=[2.0, 3.0],
        phase_error_gain_VV=[7.0, 0.5],
    )
    assert_allclose(leakage_volt(channel), [10e-6, 0.5e-6])
    assert_allclose(leakage_volt(_channel(offset_uncertainty_volt=2e-6)), [2e-6, 2e-6])


def test_the_largest_value_serves_where_frequencies_were_left_out() -> None:
    channel = _channel(1, errors=[0.1, 0.3, 0.2])
    assert by_frequency(channel, "errors", 5.0) == [0.3]
    assert by_frequency(channel, "others", 5.0) == [5.0]


def test_the_smallest_gain_is_that_of_a_channel_at_each_frequency() -> None:
    channel = _channel(
        3,
        leakage_uncertainty_volt=1e-6,
        phase_error_gain_VH=[2.0, 3.0, 4.0],
        phase_error_gain_VV=[5.0, 1.0, 7.0],
    )
    assert_allclose(leakage_volt(channel), [2e-6, 1e-6, 4e-6])


def test_what_was_measured_is_not_stated_in_addition(monkeypatch) -> None:
    asked = {}

    def stated(survey: object, **words: object) -> float:
        asked.update(words)
        return 0.2

    monkeypatch.setattr(error, "phase_uncertainty", stated)
    survey = cast(Any, object())
    attributes = {
        "leakage_measured": "leakage_uncertainty_volt",
        "demodulator_measured": "demodulator_calibrated",
        "phases_measured": error.UNCALIBRATED_SHARE,
    }
    nothing = dict.fromkeys(attributes, False) | {"frequencies": 2}
    assert_allclose(instrument_phase(_channel(), survey), [0.2, 0.2])
    assert asked == nothing
    for word, attribute in attributes.items():
        instrument_phase(_channel(**{attribute: 0.1}), survey)
        assert asked == nothing | {word: True}


def test_readings_of_a_moving_instrument_have_lags() -> None:
    moving, standing = (
        cast(Any, SimpleNamespace(platform=platform)) for platform in ("rov", None)
    )
    time = 5.0 + np.arange(8.0).reshape(2, 2, 2, 1)
    dimensions = ("modulation_frequency", "polarization", "row", "column")
    cube = xr.Dataset(coords={"reading_time": (dimensions, time)})
    # Two rows alternate; four readings of a pixel are 2 s apart.
    expected = np.arange(0.0, 8.0, 2.0).reshape(2, 2, 1, 1)
    lag = lag_of(cube, moving)
    assert lag is not None
    assert_allclose(lag, np.broadcast_to(expected, time.shape))
    assert lag_of(cube, standing) is None
    assert lag_of(cube, None) is None
    assert lag_of(cube.drop_vars("reading_time"), moving) is None
    at_once = cube.assign_coords(reading_time=(dimensions, 0 * time + 5.0))
    assert lag_of(at_once, moving) is None


def test_measured_samples_may_contain_light_unless_they_say_otherwise() -> None:
    for attributes, expected in (
        ({}, True),
        ({"simulated": 0}, True),
        ({"simulated": 1}, False),
        ({"corner_light": "absent"}, False),
        ({"corner_light": "present"}, True),
        ({"simulated": 1, "corner_light": "present"}, True),
        ({"simulated": 1, "corner_light": "absent"}, False),
        ({"simulated": 1, "surroundings_light": "present"}, False),
    ):
        assert may_contain(xr.Dataset(attrs=attributes), "corner_light") is expected


NOT_REMOVED = "water not removed: error unknown, expect centimeters"
RELATIVE = error.flag_words()["pixel"]["RELATIVE"]["short"]


def _image(*flags: int, **attributes: object) -> xr.Dataset:
    pixel = ("row", "column")
    shape = 1, len(flags)
    names = (*error._COMBINED, "slant_range_uncertainty_drift", "slant_range")
    values = {name: (pixel, np.ones(shape)) for name in names}
    values["quality_flag"] = (pixel, np.array([flags], np.int16))
    return xr.Dataset(values, attrs=attributes)


def test_only_combined_errors_of_doubtful_pixels_are_unknown() -> None:
    image = _image(
        QualityFlag.NO_OPEN_WATER, QualityFlag.MIXED, 0,
        QualityFlag.RELATIVE | QualityFlag.MIXED,
    )  # fmt: skip
    found = without_unknown_errors(image)
    for name in (
        "slant_range_uncertainty", "slant_range_common_uncertainty", "x_uncertainty",
        "y_uncertainty", "z_uncertainty",
    ):  # fmt: skip
        np.testing.assert_array_equal(found[name], [[np.nan, 1, 1, np.nan]])
    for name in ("slant_range", "slant_range_uncertainty_drift", "quality_flag"):
        xr.testing.assert_identical(found[name], image[name])
    assert found.attrs == {"error_unknown": f"{NOT_REMOVED}; {RELATIVE}"}
    assert image["x_uncertainty"].notnull().all()


def test_a_cube_without_unknown_errors_stays_as_it_is() -> None:
    whole = _image(QualityFlag.MIXED, 0)
    assert without_unknown_errors(whole) is whole
    doubtful = _image(QualityFlag.NO_OPEN_WATER)
    for names in (list(error._COMBINED), ["quality_flag"]):
        bare = doubtful.drop_vars(names)
        assert without_unknown_errors(bare) is bare
    part = doubtful.drop_vars(error._COMBINED[1:])
    assert np.isnan(without_unknown_errors(part)["slant_range_uncertainty"]).all()


@pytest.mark.parametrize(
    ("flags", "attributes", "words"),
    [
        ((0, QualityFlag.MIXED), {}, ""),
        ((0, QualityFlag.NO_OPEN_WATER), {}, NOT_REMOVED),
        ((0, QualityFlag.RELATIVE), {}, RELATIVE),
        ((0,), {"error_unknown": NOT_REMOVED}, NOT_REMOVED),
        ((QualityFlag.RELATIVE,), {"error_unknown": NOT_REMOVED},
         f"{NOT_REMOVED}; {RELATIVE}"),
        ((QualityFlag.RELATIVE,), {"interval_unsettled": "two fit"},
         f"{RELATIVE}: two fit"),
        ((0,), {"interval_unsettled": "two fit"}, ""),
    ],
)  # fmt: skip
def test_the_reason_of_an_unknown_error_is_that_of_its_flags(
    flags: tuple[int, ...], attributes: dict[str, object], words: str
) -> None:
    assert error_unknown(_image(*flags, **attributes)) == words


def test_a_cube_without_flags_has_the_reason_of_its_attribute() -> None:
    bare = _image(QualityFlag.NO_OPEN_WATER).drop_vars("quality_flag")
    assert error_unknown(bare) == ""
    assert error_unknown(bare.assign_attrs(error_unknown=RELATIVE)) == RELATIVE


def test_the_estimate_of_the_bias_is_a_median_in_millimeters() -> None:
    image = _image(QualityFlag.NO_OPEN_WATER, 0, 0, 0)
    for bias, words in (
        ([-0.02, -0.0123, 0.5, np.nan], "-12.3 mm"),
        ([0.004, 0.002, np.nan, np.nan], "+3 mm"),
    ):
        shown = image.assign(slant_range_bias=(("row", "column"), [bias]))
        expected = f"{NOT_REMOVED} (median of the estimated bias {words})"
        assert error_unknown(shown) == expected
        without = shown.assign(quality_flag=shown["quality_flag"] * 0)
        assert error_unknown(without) == ""
    unknown = image.assign(slant_range_bias=image["slant_range"] * np.nan)
    assert error_unknown(unknown) == NOT_REMOVED


def test_the_name_of_a_channel_is_its_own() -> None:
    channel = _channel(phase_error_gain_VH=3.0, calibration_phase_uncertainty_rad=1.0)
    one = channel.isel(polarization=0)
    assert_allclose(instrument_phase(one, None), [3.0, 3.0])
    other = channel.assign_coords(polarization=["VV"])
    assert_allclose(instrument_phase(other, None), [1.0, 1.0])
