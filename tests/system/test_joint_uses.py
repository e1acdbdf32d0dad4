"""Joint estimation in uses beyond one channel, in water, from one place."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import xarray as xr
from late_echo import late_transfer, with_echo
from numpy.testing import assert_allclose

from amulor import rejection, simulate
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging import range_image
from amulor.survey import Survey

FREQUENCIES = np.array([12e6, 31e6, 57e6, 83e6, 104e6, 139e6])
INTERVAL = (0.8, 4.0)
#: Joint estimation with an instrument that is what the survey says, to the last bit,
#: and light that is not late: so it is simulated.
joint = functools.partial(
    rejection.joint,
    delay_uncertainty=0.0,
    group_index_uncertainty=0.0,
    receiver_position_uncertainty=0.0,
    late_echo_uncertainty=0.0,
)
WINDOW = '[instrument.window]\ndistance = "30 cm"\nthickness = "2 cm"\n[scan]\n'


def sweep(plate_text: str, **replaced: str) -> Survey:
    """Return the plate survey with a sweep of frequencies and still water."""
    listed = ", ".join(f'"{f / 1e6:g} MHz"' for f in FREQUENCIES)
    text = plate_text.replace('["39 MHz"]', f"[{listed}]")
    text = text.replace('signal_fluctuation = "5 %"', "")
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    return Survey.from_text(text)


def scores(found: xr.Dataset) -> np.ndarray:
    """Return the errors of the slant range over their uncertainty."""
    truth = found.amulor.truth["slant_range"].values
    error = found["joint_slant_range"].values - truth
    return np.asarray(error / found["joint_slant_range_uncertainty"].values)


def are_fair(z: np.ndarray) -> bool:
    """Return whether scores have a mean square of 1, within four standard errors.

    The error that all pixels share is a part of the uncertainty only; here it is the
    smaller one, so that the scores count as independent.
    """
    return bool(abs(np.mean(z**2) - 1) < 4 * np.sqrt(2 / z.size))


@pytest.fixture(scope="module")
def channels(plate_text: str) -> xr.Dataset:
    return simulate(sweep(plate_text), rng=4)


@pytest.fixture(scope="module")
def single(channels: xr.Dataset) -> xr.Dataset:
    return channels.isel(polarization=[0])


@pytest.fixture(scope="module")
def found(single: xr.Dataset) -> xr.Dataset:
    return joint(single, interval=INTERVAL)


def test_two_channels_say_what_each_says_and_more(
    channels: xr.Dataset, found: xr.Dataset
) -> None:
    both = joint(channels, interval=INTERVAL)
    other = joint(channels.isel(polarization=[1]), interval=INTERVAL)
    assert are_fair(scores(both))
    # Two measurements of one range: their informations add up, but for the water.
    alone = [
        one["joint_slant_range_bound"].values.astype(float) ** -2
        for one in (found, other)
    ]
    together = both["joint_slant_range_bound"].values ** -2
    assert_allclose(together, alone[0] + alone[1], rtol=0.1)
    # Each channel has a water signal of its own, and that is what is taken out.
    truth = both.amulor.truth
    water = truth["water_in_phase"].values + 1j * truth["water_quadrature"].values
    size = np.abs(water).max(axis=(2, 3), keepdims=True)
    assert_allclose(both.amulor.water_signal.values / size, water / size, atol=0.02)
    strength = both.attrs["joint_water_strength_volt"]
    expected = np.abs(water[0]).mean(axis=(1, 2))
    assert_allclose(strength[1] / strength[0], expected[1] / expected[0], rtol=0.02)


@pytest.mark.study
def test_a_window_is_looked_through(plate_text: str) -> None:
    cube = simulate(sweep(plate_text, **{"[scan]\n": WINDOW}), rng=5)
    cube = cube.isel(polarization=[0])
    through = joint(cube, interval=INTERVAL)
    assert are_fair(scores(through))
    # Without the window in the survey the same samples mean other ranges.
    text = cube.attrs["survey"]
    start = text.index("[instrument.window]")
    end = text.index("[", start + 1)
    blind = joint(
        cube.assign_attrs(survey=text[:start] + text[end:]), interval=INTERVAL
    )
    assert abs(np.nanmedian(scores(blind))) > 10


def test_a_scan_that_moves_sideways_sees_the_same_water(
    single: xr.Dataset, found: xr.Dataset
) -> None:
    pixel = ("row", "column")
    shift = np.linspace(-0.5, 0.5, single["azimuth"].size)
    shift = shift.reshape(single["azimuth"].shape)
    moved = single.assign_coords(
        origin_x=(pixel, shift, {"units": "m", "long_name": "start of the beam"}),
        origin_y=(pixel, 2 * shift, {"units": "m", "long_name": "start of the beam"}),
        origin_z=(pixel, 0 * shift, {"units": "m", "long_name": "start of the beam"}),
    )
    again = joint(moved, interval=INTERVAL)
    for name in ("slant_range", "slant_range_uncertainty"):
        assert_allclose(again[f"joint_{name}"], found[f"joint_{name}"], rtol=1e-12)
    np.testing.assert_array_equal(again["origin_x"], moved["origin_x"])
    image = range_image(again, interval=INTERVAL)
    off = image["slant_range"] - again["joint_slant_range"]
    assert float(np.abs(off / again["joint_slant_range_uncertainty"]).max()) < 2


def test_a_scan_that_moves_towards_its_window_is_refused(plate_text: str) -> None:
    cube = simulate(sweep(plate_text, **{"[scan]\n": WINDOW}), rng=5)
    pixel = ("row", "column")
    nearer = np.full(cube["azimuth"].shape, 0.1)
    units = {"units": "m", "long_name": "start of the beam"}
    moved = cube.assign_coords(
        origin_x=(pixel, 0 * nearer, units),
        origin_y=(pixel, 0 * nearer, units),
        origin_z=(pixel, nearer, units),
    )
    with pytest.raises(CubeError, match=r"origin_z.*0\.1 m"):
        joint(moved, interval=INTERVAL)


@pytest.mark.slow
def test_a_known_spread_of_the_echo_is_taken_into_account(single: xr.Dataset) -> None:
    transfer = late_transfer(FREQUENCIES, length=0.04)
    cube = with_echo(single, transfer)
    known = joint(cube, interval=INTERVAL, echo_transfer=transfer)
    assert are_fair(scores(known))
    unknown = joint(cube, interval=INTERVAL)
    error = unknown["joint_slant_range"] - single.amulor.truth["slant_range"]
    # 4 cm and half as much, out and back, over the group index: 2.2 cm.
    assert float(error.mean()) == pytest.approx(0.06 / 2.76, rel=0.2)
    missing = np.abs(scores(unknown)) > 1.96
    assert missing.mean() > 0.9
    flagged = unknown["quality_flag"].values[0, 0] & QualityFlag.WATER_RESIDUAL
    assert (flagged != 0).mean() > 0.9


def test_the_range_image_of_the_target_signal_agrees(
    single: xr.Dataset, found: xr.Dataset
) -> None:
    image = range_image(found, interval=INTERVAL)
    own = found["joint_slant_range_uncertainty"].values
    off = image["slant_range"].values - found["joint_slant_range"].values
    # The same samples: what is left are weights, of water that is shared.
    assert np.sqrt(np.mean((off / own) ** 2)) < 0.5
    assert_allclose(image["slant_range_uncertainty"], own, rtol=0.25)
    raw = range_image(rejection.keep_water(single), interval=INTERVAL)
    worse = raw["slant_range"].values - found["joint_slant_range"].values
    assert np.sqrt(np.mean(worse**2)) > 10 * np.sqrt(np.mean(off**2))
    np.testing.assert_array_equal(
        image["quality_flag"], np.bitwise_or.reduce(found["quality_flag"].values[:, 0])
    )
    assert not (image["quality_flag"].values & QualityFlag.AMBIGUOUS).any()
