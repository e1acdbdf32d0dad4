"""Range profiles of a pixel with one surface or two."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import rejection
from amulor.errors import CubeError
from amulor.imaging.beam_profile import beam_profile

FREQUENCY = 10e6 * np.arange(1.0, 13.0)
INDEX, SIGMA = 1.38, 2e-3
#: Ranges and amplitudes of two surfaces along the beam of one pixel.
SURFACES, ECHOES = np.array([1.6, 3.1]), np.array([0.4, 0.7])


def _target(count: int = 12) -> xr.Dataset:
    """Target signal of two rows and three columns; one pixel has two surfaces."""
    frequency = FREQUENCY[:count]
    wave = 4 * np.pi * frequency * INDEX / speed_of_light
    single = np.exp(1j * wave * 2.0)
    double = np.exp(1j * wave[:, None] * SURFACES) @ ECHOES
    signal = np.tile(single[:, None, None], (1, 2, 3))
    signal[:, 1, 2] = double
    stated = np.full((count, 1, 2, 3), SIGMA)
    cube = cubes.build(
        "samples",
        {
            "in_phase": signal.real[:, None],
            "quadrature": signal.imag[:, None],
            "in_phase_uncertainty": stated,
            "quadrature_uncertainty": stated,
            "saturated": np.zeros(stated.shape, np.int8),
        },
        {
            "modulation_frequency": frequency,
            "polarization": ["none"],
            "azimuth": np.zeros((2, 3)),
            "elevation": np.zeros((2, 3)),
        },
        geometry={
            "group_index": INDEX,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("samples", title="by hand", source="by hand"),
    )
    return rejection.keep_water(cube)


def test_two_surfaces_along_a_beam_have_their_ranges_and_errors() -> None:
    found = beam_profile(_target(), row=1, column=2, most=2)
    assert_allclose(found.surface, SURFACES, atol=1e-4)
    assert_allclose(found.amplitude, ECHOES, rtol=1e-3)
    # Far apart, each surface has the error of a single one: that of an amplitude is
    # sigma over the root of the number of frequencies.
    assert_allclose(found.amplitude_uncertainty, SIGMA / 12**0.5, rtol=0.15)
    wave = 4 * np.pi * FREQUENCY * INDEX / speed_of_light
    scale = SIGMA / np.sqrt((wave**2).sum())
    assert_allclose(found.surface_uncertainty, scale / ECHOES, rtol=0.2)
    assert found.freedom == 24 - 4
    assert found.misfit < 1e-3
    assert found.water is None
    # Frequencies every 10 MHz repeat after c / 2 n df.
    span = speed_of_light / (2 * INDEX * 10e6)
    assert found.unambiguous_span == pytest.approx(span)
    assert found.resolution < span / 8
    assert found.slant_range[0] == pytest.approx(0.0, abs=1e-9)
    assert found.slant_range[-1] == pytest.approx(span)
    peak = found.slant_range[found.profile.argmax()]
    assert peak == pytest.approx(SURFACES[1], abs=0.1)
    single = beam_profile(_target(), row=0, column=0, most=2)
    assert_allclose(single.surface, [2.0], atol=1e-4)
    assert single.freedom == 22


def test_a_profile_reaches_over_the_stated_interval() -> None:
    found = beam_profile(_target(), row=0, column=0, interval=(1.5, 2.7), most=1)
    assert (found.slant_range[0], found.slant_range[-1]) == pytest.approx((1.5, 2.7))
    before = beam_profile(_target(), row=0, column=0, interval=(-1.0, 2.7), most=1)
    assert before.slant_range[0] == pytest.approx(0.0, abs=1e-9)


def test_subtracted_water_has_a_profile_and_costs_a_degree_of_freedom() -> None:
    target = _target()
    for name, value in (("in_phase", 0.1), ("quadrature", 0.0)):
        target[f"water_{name}"] = xr.full_like(target["in_phase"], value)
    found = beam_profile(target, row=0, column=0, most=2)
    assert found.water is not None
    assert found.water.shape == found.profile.shape
    assert found.freedom == 24 - 2 - 1
    dry = target.copy()
    dry["water_in_phase"] = xr.zeros_like(dry["in_phase"])
    assert beam_profile(dry, row=0, column=0, most=2).water is None


def _refused(target: xr.Dataset, **options: Any) -> str:
    with pytest.raises(CubeError) as caught:
        beam_profile(target, **{"row": 0, "column": 0, **options})
    return str(caught.value)


def test_profiles_that_cannot_be_are_one_line() -> None:
    target = _target()
    assert _refused(target.assign_attrs(level="samples")) == (
        "a range profile needs a target signal, but the file has the level samples; "
        "use a result of `amulor reject`"
    )
    for row, column in ((2, 0), (0, 3), (-1, 0), (0, -1)):
        assert _refused(target, row=row, column=column) == (
            f"pixel {row},{column} is outside the cube of 2 rows and 3 columns; count "
            "both from 0"
        )
    assert _refused(target, interval=(1.0, 1.01)).startswith(
        "the frequencies separate no two surfaces between 1 and 1.01 m: their range "
        "resolution is "
    )
    many = _refused(_target(5), most=4)
    assert many.startswith(
        "5 modulation frequencies do not determine 4 surfaces; state "
    )
    few = _target()
    few["in_phase"].values[1:] = np.nan
    words = _refused(few)
    assert words.startswith("pixel 0,0 has valid samples at 1 of 12 modulation ")
