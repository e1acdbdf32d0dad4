"""What the trust study counts, on images written by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.cube import QualityFlag
from amulor.studies.trust.case import Case, lateness
from amulor.studies.trust.methods import Outcome
from amulor.studies.trust.scenes import samples
from amulor.studies.trust.scenes.catalogue import BY_NAME
from amulor.studies.trust.study import run
from amulor.studies.trust.table import Row, score, text

SHAPE = (2, 4)


def _case(surfaces: np.ndarray, *, late: float = 0.0) -> Case:
    return Case(
        samples=xr.Dataset(),
        surfaces=surfaces,
        late=np.full(SHAPE, late),
        interval=None,
        judged=np.ones(SHAPE, dtype=bool),
    )


def _outcome(distance: np.ndarray, sigma: float, *, flagged: int = 0) -> Outcome:
    pixel = ("row", "column")
    flag = np.zeros(SHAPE, dtype=np.int16)
    flag.ravel()[:flagged] = QualityFlag.WATER_RESIDUAL
    image = xr.Dataset(
        {
            "slant_range": (pixel, distance),
            "slant_range_uncertainty": (pixel, np.full(SHAPE, sigma)),
            "quality_flag": (pixel, flag),
        },
        attrs={"polarization": "VV"},
    )
    target = xr.Dataset(
        {
            "quality_flag": (
                ("modulation_frequency", "polarization", *pixel),
                np.zeros((1, 1, *SHAPE), dtype=np.int16),
            )
        },
        coords={"polarization": ["VV"]},
    )
    return Outcome(target=target, image=image, note="")


def test_intervals_are_counted_against_the_surface_and_against_the_echo() -> None:
    off = np.array([0.5, -0.9, 1.5, -1.9, 2.5, 3.0, -4.0, 0.0]).reshape(SHAPE)
    found = score(
        _case(np.full((1, *SHAPE), 2.0), late=1e-3), _outcome(2.0 + 1e-3 * off, 1e-3)
    )
    assert (found.trusted, found.pixels, found.empty) == (1.0, 8, 0)
    assert found.inside_68 == 3 / 8
    assert found.inside_95 == 5 / 8
    assert found.far == 1 / 8
    assert found.worst == pytest.approx(4.0)
    # Against the echo, one millimetre later: -0.5 -1.9 0.5 -2.9 1.5 2.0 -5.0 -1.0.
    assert found.echo_95 == 5 / 8
    assert found.rms == pytest.approx(1e-3 * math.sqrt(np.mean(off**2)))


def test_flagged_pixels_do_not_count_and_empty_ones_that_are_not_are_phantoms() -> None:
    surfaces = np.full((1, *SHAPE), 2.0)
    surfaces[0, 1] = np.nan
    distance = np.full(SHAPE, 2.0)
    distance[0, 0] = 9.0
    distance[1, :3] = np.nan
    found = score(_case(surfaces), _outcome(distance, 1e-3, flagged=1))
    assert found.trusted == 3 / 4
    assert found.worst == 0
    assert found.phantoms == 1 / 4


def test_of_two_surfaces_the_nearer_to_the_result_counts() -> None:
    surfaces = np.stack([np.full(SHAPE, 2.0), np.full(SHAPE, 2.1)])
    found = score(_case(surfaces), _outcome(np.full(SHAPE, 2.099), 1e-3))
    assert found.rms == pytest.approx(1e-3)
    assert found.worst == pytest.approx(1.0)


def test_a_refusal_trusts_nothing() -> None:
    refused = Outcome(target=None, image=None, note="refused: no")
    found = score(_case(np.full((1, *SHAPE), 2.0)), refused)
    assert found.trusted == 0
    assert math.isnan(found.inside_95)
    assert "refused: no" in text([Row(scene="s", count=1, method="m", score=found)])


def test_lateness_of_an_echo_that_is_a_plain_delay_is_that_delay() -> None:
    frequency, path = np.array([5e6, 50e6, 146e6]), np.array([5.0, 7.5])
    late = 2e-3
    delay = path + 2 * 1.38 * late
    echo = np.exp(2j * np.pi * frequency[:, None] * delay / 299792458.0)
    assert_allclose(
        lateness(echo, path, modulation_frequency=frequency, group_index=1.38),
        late,
        rtol=1e-9,
    )


def test_no_method_can_read_the_truth() -> None:
    case = samples.mixed(2, 1, gap=0.05)
    assert not [n for n in case.samples.data_vars if str(n).startswith("truth")]
    # Two columns see both plates, and these alone are judged.
    both = np.isfinite(case.surfaces).all(axis=0)
    assert both[0].sum() == 2
    np.testing.assert_array_equal(both, case.judged)


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="no scene 'moon'"):
        run(["moon"])
    with pytest.raises(ValueError, match="no method 'magic'"):
        run(["flat"], ["magic"])
    assert "flat" in BY_NAME
