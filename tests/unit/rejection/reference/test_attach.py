"""Open water from another cube: taken if it fits, refused by name if not."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor import rejection
from amulor.errors import CubeError
from amulor.simulation import simulate
from amulor.survey import Survey


@pytest.fixture(scope="module")
def samples(plate: Survey) -> xr.Dataset:
    return simulate(plate, rng=4)


@pytest.fixture(scope="module")
def empty_scan(plate_text: str) -> xr.Dataset:
    start, end = plate_text.index("[[targets]]"), plate_text.index("[instrument]")
    text = plate_text[:start] + plate_text[end:]
    text = text[: text.index("[scan.open_water]")]
    text = text.replace("columns = 12", "columns = 20").replace("rows = 6", "rows = 9")
    return simulate(Survey.from_text(text), rng=5)


@pytest.mark.slow
def test_the_shots_of_another_cube_serve_as_its_own(samples: xr.Dataset) -> None:
    bare = cubes.without_groups(samples)
    found = rejection.open_water(rejection.with_open_water(bare, samples))
    own = rejection.open_water(samples)
    assert_allclose(found["in_phase"], own["in_phase"])
    assert_allclose(found["in_phase_uncertainty"], own["in_phase_uncertainty"])


@pytest.mark.slow
def test_a_scan_without_a_target_is_a_reference(
    samples: xr.Dataset, empty_scan: xr.Dataset
) -> None:
    bare = cubes.without_groups(samples)
    joined = rejection.with_open_water(bare, empty_scan)
    assert joined.amulor.open_water.sizes["shot"] == 180
    found, own = rejection.open_water(joined), rejection.open_water(samples)
    # Two measurements of the same water: they differ by their errors.
    spread = np.hypot(
        found["common_in_phase_uncertainty"], own["common_in_phase_uncertainty"]
    )
    score = (found["water_in_phase"] - own["water_in_phase"]) / spread
    assert abs(score).max() < 5


def test_shots_come_in_the_order_of_their_time(
    samples: xr.Dataset, empty_scan: xr.Dataset
) -> None:
    turned = empty_scan.isel(column=slice(None, None, -1))
    first, second = (
        rejection.with_open_water(samples, reference).amulor.open_water
        for reference in (empty_scan, turned)
    )
    np.testing.assert_array_equal(first["in_phase"], second["in_phase"])


def test_saturated_pixels_are_no_shots(
    samples: xr.Dataset, empty_scan: xr.Dataset
) -> None:
    broken = empty_scan.copy(deep=True)
    broken["saturated"][0, 0, 0, 0] = 1
    shots = rejection.with_open_water(samples, broken).amulor.open_water
    assert int(np.isnan(shots["in_phase"].values).sum()) == 1


def _other(text: str, old: str, new: str) -> xr.Dataset:
    assert old in text
    return simulate(Survey.from_text(text.replace(old, new)), rng=6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('["39 MHz"]', '["40 MHz"]', "no sample at 39 MHz"),
        ('["VV", "VH"]', '["VV"]', "target cube has VH too"),
        ('"7 cm"', '"9 cm"', "receiver_position is"),
        ('"0.255 1/m"', '"0.3 1/m"', r"another water: water.absorption is 0.3 there"),
        ('"20 mW"', '"10 mW"', r"another instrument: instrument.power is 0.01"),
        ('"10 ms"', '"20 ms"', r"instrument.lock_in.time_constant is 0.02"),
    ],
)
def test_a_reference_that_does_not_fit_is_named(
    samples: xr.Dataset, plate_text: str, old: str, new: str, words: str
) -> None:
    with pytest.raises(CubeError, match=words):
        rejection.with_open_water(samples, _other(plate_text, old, new))


def test_a_reference_with_more_frequencies_and_channels_serves(
    samples: xr.Dataset, plate_text: str
) -> None:
    wide = plate_text.replace('["39 MHz"]', '["20 MHz", "39 MHz", "80 MHz"]')
    wide = wide.replace('["VV", "VH"]', '["RR", "VH", "VV"]')
    joined = rejection.with_open_water(samples, simulate(Survey.from_text(wide), rng=7))
    cubes.check(joined, "samples")
    shots = joined.amulor.open_water
    assert shots["in_phase"].shape[:2] == (1, 2)
    ratio = abs(shots["in_phase"].values.mean(axis=-1) / 1.0)
    # VV is brighter than VH: the order of the channels was kept.
    assert ratio[0, 0] > 3 * ratio[0, 1]


def test_the_truth_stays_and_nothing_else_of_a_group(samples: xr.Dataset) -> None:
    joined = rejection.with_open_water(samples, samples)
    assert joined.amulor.truth is not None
    xr.testing.assert_equal(joined.drop_attrs(), samples.drop_attrs())
