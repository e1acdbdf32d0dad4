"""Slow change of the water during a scan."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.testing import assert_allclose

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint.estimate import joint
from amulor.rejection.joint.priors import (
    TRENDS,
    change_of,
    change_uncertainty,
    clock_of,
    drifted,
    trends_of,
)
from amulor.rejection.joint.samples import Pixels
from amulor.rejection.observation import observe_scan
from amulor.simulation import simulate
from amulor.survey import Survey


def scan(count: int) -> xr.Dataset:
    """Return directions and times of a scan, as little as is looked at."""
    time = 0.125 * np.arange(2 * count).reshape(2, count)
    return xr.Dataset(
        {"azimuth": (("row", "column"), np.zeros((2, count)))},
        {"time": (("row", "column"), time)},
    )


def trends_in(cube: xr.Dataset) -> np.ndarray:
    """Return the trends of all pixels of a scan."""
    scan = observe_scan(cube)
    return trends_of(scan.tile(0, scan.rows), clock_of(scan))


def test_trends_follow_the_time_of_the_pixels() -> None:
    made = scan(60)
    trends = trends_in(made)
    place = np.linspace(-1, 1, 120)
    # Legendre's first three polynomials, written out.
    exact = np.stack(
        [place, 1.5 * place**2 - 0.5, 2.5 * place**3 - 1.5 * place], axis=1
    )
    assert trends.shape == (120, TRENDS)
    assert_allclose(trends, exact, atol=1e-14)
    # A scan backwards in time drifts the other way.
    back = made.assign_coords(time=made["time"].max() - made["time"])
    assert_allclose(trends_in(back)[:, 0], -trends[:, 0], atol=1e-14)
    # Without times pixels come row by row.
    assert_allclose(trends_in(made.drop_vars("time")), trends, atol=1e-14)
    assert trends_in(scan(30)).shape == (60, 0)


def test_the_water_of_a_pixel_is_as_strong_as_it_was_at_its_time() -> None:
    trends = trends_in(scan(60))
    nothing = np.zeros((120, 1, 1))
    pixels = Pixels(
        signal=nothing.astype(complex),
        covariance=Covariance(nothing, nothing, nothing),
        usable=nothing == 0,
        interpolation=np.random.default_rng(1).uniform(0.3, 1, (120, 4)),
        offset=np.zeros(120),
        shortest=np.zeros(120),
        longest=np.ones(120),
        depths=np.zeros((120, 3)),
        trends=trends,
    )
    trend = np.array([0.05, 0.02, -0.01])
    then = drifted(pixels, trend)
    ratio = then.interpolation / pixels.interpolation
    expected = 1 + 0.05 * trends[:, 0] + 0.02 * trends[:, 1] - 0.01 * trends[:, 2]
    assert_allclose(ratio, expected[:, None] * np.ones(4), rtol=1e-12)
    # Its relative change with each coefficient.
    assert_allclose(then.trends * expected[:, None], trends, atol=1e-14)
    assert_allclose(change_of(trend), expected[-1] - expected[0], rtol=1e-12)
    assert drifted(pixels, np.zeros(0)).trends.shape[1] == 0
    assert drifted(pixels, np.zeros(3)) is pixels


def test_the_uncertainty_of_the_change_is_that_of_many_draws() -> None:
    spread = np.array([[4.0, 1.0, -1.0], [1.0, 2.0, 0.5], [-1.0, 0.5, 3.0]]) * 1e-4
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(3), spread, 20_000)
    scatter = np.std([change_of(each) for each in draws])
    stated = change_uncertainty(spread, preferred=True)
    assert_allclose(stated, scatter, rtol=0.02)
    assert change_uncertainty(spread, preferred=False) == np.inf
    assert change_uncertainty(np.zeros((0, 0)), preferred=True) == np.inf


def test_steady_water_does_not_drift(sweep: Callable[..., Survey]) -> None:
    found = joint(simulate(sweep(), rng=8))
    # A tenth of the fluctuation of the samples.
    assert abs(found.attrs["joint_water_drift"]) < 2e-3
