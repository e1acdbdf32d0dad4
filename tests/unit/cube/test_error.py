"""Errors of the instrument from the attributes of a channel."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import xarray as xr
from numpy.testing import assert_allclose

from amulor.cube import error
from amulor.cube.error import by_frequency, instrument_phase, leakage_volt
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
