"""Open-water shots whose directions were read back, and so never repeat exactly."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor import simulation
from amulor.rejection.observation import Observation
from amulor.rejection.reference import shots as reference
from amulor.survey import Survey

#: Columns, rows and repeats of the shots.
PLAN = (3, 2, 6)


@pytest.fixture(scope="module")
def exact(plate: Survey) -> xr.Dataset:
    """Return a cube whose shots are exactly where they were meant to be."""
    columns, rows, repeats = PLAN
    survey = plate.with_(
        {
            "scan.columns": 12,
            "scan.rows": 6,
            "scan.open_water": {"columns": columns, "rows": rows, "repeats": repeats},
        }
    )
    return simulation.simulate(survey, rng=3)


def fits_of(cube: xr.Dataset) -> list[reference.Reference]:
    """Return the fits of the shots of a cube."""
    return reference.fit_shots(Observation(cube=cube))[0]


def moved(cube: xr.Dataset, jitter: float, *, commanded: bool) -> xr.Dataset:
    """Return a cube whose shots stand a little off, as a scanner reads them back."""
    rng = np.random.default_rng(5)
    shots = cube.amulor.open_water.copy(deep=True)
    for name in ("azimuth", "elevation"):
        meant = shots[name].values.copy()
        noise = jitter * rng.standard_normal(meant.size)
        shots[name] = ("shot", meant + noise, shots[name].attrs)
        if commanded:
            shots[f"user_commanded_{name}"] = ("shot", meant)
    bare = cubes.without_groups(cube)
    return cubes.attach(bare, shots, "open_water")


@pytest.mark.parametrize("commanded", [True, False])
@pytest.mark.parametrize("jitter", [5e-5, pytest.param(2e-6, marks=pytest.mark.slow)])
def test_shots_that_stand_a_little_off_count_as_repeats(
    exact: xr.Dataset, jitter: float, commanded: bool
) -> None:
    cube = moved(exact, jitter, commanded=commanded)
    found, ideal = fits_of(cube), fits_of(exact)
    for one, other in zip(found, ideal, strict=True):
        # Fifty microradians are a thousandth of the span of the scan.
        np.testing.assert_allclose(one.signal, other.signal, rtol=2e-3)
        assert one.degree == other.degree
        assert one.drift.change == pytest.approx(other.drift.change, rel=2e-3)
        assert np.isfinite(one.drift.uncertainty)


def test_commanded_directions_hold_however_far_the_read_back_is_off(
    exact: xr.Dataset,
) -> None:
    # Half a milliradian is a fiftieth of what the rows of the shots span.
    cube = moved(exact, 5e-4, commanded=True)
    for fit in fits_of(cube):
        assert np.isfinite(fit.drift.uncertainty)


def test_directions_all_over_the_scan_are_no_repeats(exact: xr.Dataset) -> None:
    rng = np.random.default_rng(2)
    shots = exact.amulor.open_water.copy(deep=True)
    for name in ("azimuth", "elevation"):
        low, high = exact[name].values.min(), exact[name].values.max()
        where = np.concatenate([[low, high], rng.uniform(low, high, 34)])
        shots[name] = ("shot", where, shots[name].attrs)
    cube = cubes.attach(cubes.without_groups(exact), shots, "open_water")
    for fit in fits_of(cube):
        assert not np.isfinite(fit.drift.uncertainty)


def test_one_row_of_shots_is_told_by_the_misses_of_the_pixels(
    plate: Survey,
) -> None:
    # Older cubes hold what was asked for of their pixels only; in elevation the span
    # of the shots is nothing but what the scanner missed.
    survey = plate.with_(
        {
            "scan.columns": 12,
            "scan.rows": 1,
            "scan.elevation_span": "0 rad",
            "scan.open_water": {"columns": 3, "rows": 1, "repeats": 8},
        }
    )
    cube = moved(simulation.simulate(survey, rng=3), 2e-5, commanded=False)
    rng = np.random.default_rng(8)
    for name in ("azimuth", "elevation"):
        cube[f"user_commanded_{name}"] = cube[name].variable.copy(deep=True)
        off = 2e-5 * rng.standard_normal(cube[name].shape)
        cube[name] = cube[name].copy(data=cube[name].values + off)
    for fit in fits_of(cube):
        assert np.isfinite(fit.drift.uncertainty)
