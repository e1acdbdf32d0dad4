"""Range image of a net: beams that meet two surfaces are flagged by amplitudes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import QualityFlag, tiles
from amulor.imaging.range_image import fitted_range_image

FREQUENCY = np.array([10e6, 35e6, 80e6, 146e6])
ROWS, COLUMNS = np.mgrid[0:12, 0:20]


@pytest.fixture(scope="module")
def target():
    """Return a target signal with wires of one pixel, 40 % of the light on them."""
    wave = 4 * np.pi * FREQUENCY[:, None, None] * 1.38 / speed_of_light
    share = np.where((ROWS % 5 == 2) | (COLUMNS % 5 == 2), 0.4, 0.0)
    signal = share * np.exp(1j * wave * 1.88) + (1 - share) * np.exp(1j * wave * 2.0)
    noise = np.random.default_rng(1).normal(0, 1e-3, (2, *signal.shape))
    stated = np.full(signal.shape, 1e-3)[:, None]
    cube = cubes.build(
        "samples",
        {
            "in_phase": (signal.real + noise[0])[:, None],
            "quadrature": (signal.imag + noise[1])[:, None],
            "in_phase_uncertainty": stated,
            "quadrature_uncertainty": stated,
            "saturated": np.zeros(stated.shape, np.int8),
        },
        {
            "modulation_frequency": FREQUENCY,
            "polarization": ["none"],
            "azimuth": 0.002 * COLUMNS,
            "elevation": -0.002 * ROWS,
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("samples", title="by hand", source="by hand"),
    )
    return rejection.keep_water(cube)


def test_a_net_of_wires_of_one_pixel_is_mixed(target) -> None:
    image = imaging.range_image(target, interval=(0.5, 4.0))
    mixed = (image["quality_flag"].values & QualityFlag.MIXED) != 0
    wires = (ROWS % 5 == 2) | (COLUMNS % 5 == 2)
    np.testing.assert_array_equal(mixed, wires)
    # 12 cm times the root of 0.4 * 0.6, and 4 % of the next order.
    spread = image["range_spread"].values
    assert np.isnan(spread[~wires]).all()
    assert np.median(spread[wires]) == pytest.approx(0.0588, rel=0.06)
    # Between the surfaces, so that without the flag the ranges are 5 cm wrong.
    assert np.median(2.0 - image["slant_range"].values[wires]) > 0.04


def test_rows_have_the_flags_of_the_whole_image(target) -> None:
    whole, fit = fitted_range_image(target, interval=(0.5, 4.0))
    rows = target.isel(row=slice(4, 8))
    part, _ = fitted_range_image(
        rows, interval=(0.5, 4.0), fit=fit, span=tiles.span_of(target)
    )
    for name in ("quality_flag", "range_spread"):
        np.testing.assert_array_equal(part[name], whole[name].isel(row=slice(4, 8)))
