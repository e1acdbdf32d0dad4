"""Errors of the instrument from the attributes of a channel."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.testing import assert_allclose

from amulor.cube.error import by_frequency, instrument_phase, leakage_volt


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
