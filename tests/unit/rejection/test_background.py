"""The method background: pixels without a target are the reference of the others."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import amulor
from amulor import cube as cubes
from amulor import pipeline, rejection
from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.rejection.background import find_background
from amulor.rejection.observation import Observation

#: The module; the package has a method of this name.
background = importlib.import_module("amulor.rejection.background")
INTERVAL = (0.5, 2.5)
PLATE = {
    "kind": "plate",
    "position": ["0 m", "0 m", "1.5 m"],
    "width": "0.12 m",
    "height": "0.1 m",
    "reflectance": 0.3,
}


def scan_of(*targets: dict[str, object], seed: int = 1) -> xr.Dataset:
    """Simulate a scan in which the water signal varies by a factor of ten."""
    survey = amulor.Survey.preset("amulor-2010").with_(
        {
            "water.scattering": "1 1/m",
            "water.signal_fluctuation": 0.02,
            "instrument.modulation_frequencies": ["20 MHz", "80 MHz", "140 MHz"],
            "scan.rows": 16,
            "scan.columns": 24,
            "scan.azimuth_span": "10 deg",
            "scan.elevation_span": "6 deg",
            "targets": list(targets),
        }
    )
    return amulor.simulate(survey, rng=seed)


@pytest.fixture(scope="module")
def plate() -> xr.Dataset:
    return scan_of(PLATE)


def on_target(cube: xr.Dataset) -> np.ndarray:
    return np.asarray(np.isfinite(cube.amulor.truth["slant_range"].values))


def bare(cube: xr.Dataset) -> xr.Dataset:
    return cubes.without_groups(cube, "open_water")


def test_background_contains_no_pixel_of_the_target(plate: xr.Dataset) -> None:
    found = find_background(Observation(cube=bare(plate)), INTERVAL)
    target = on_target(plate)
    assert not (found & target).any()
    assert found[~target].mean() > 0.95


def test_ranges_are_those_with_shots_of_open_water(plate: xr.Dataset) -> None:
    def image(target: xr.Dataset) -> xr.Dataset:
        return pipeline.run(target, polarization="VV", interval=INTERVAL)

    here = image(rejection.background(bare(plate), interval=INTERVAL))
    shots = image(rejection.open_water(plate, interval=INTERVAL))
    target, trusted = on_target(plate), here["quality_flag"].values == 0
    assert trusted[target].all()
    assert not trusted[~target].any()
    error = here["slant_range"].values - plate.amulor.truth["slant_range"].values
    sigma = here["slant_range_uncertainty"].values
    assert np.mean(np.abs(error / sigma)[target] < 1.96) > 0.93
    apart = here["slant_range"].values - shots["slant_range"].values
    assert np.abs(apart[target]).max() < 1e-3


def test_rows_give_the_result_of_the_whole_scan(plate: xr.Dataset) -> None:
    cube, method = bare(plate), rejection.load("background")
    whole = method(cube, interval=INTERVAL)
    of = method.fit(tiles.InMemory(cube), interval=INTERVAL)
    part = of(cube.isel(row=slice(6, 9)), 6)
    for name in ("in_phase", "quadrature_uncertainty", "quality_flag"):
        np.testing.assert_array_equal(
            part[name].values, whole[name].values[:, :, 6:9], err_msg=name
        )


def test_a_wall_behind_the_object_is_no_background() -> None:
    wall = PLATE | {
        "position": ["0 m", "0 m", "1.8 m"], "width": "3 m", "height": "3 m"
    }  # fmt: skip
    cube = scan_of(PLATE | {"reflectance": 0.1}, wall | {"reflectance": 0.1})
    with pytest.raises(CubeError, match="no echoes"):
        rejection.background(bare(cube), interval=INTERVAL)


def test_scans_without_a_background_are_refused(plate: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="a background of water and one of a surface"):
        rejection.background(plate.isel(modulation_frequency=[1]))
    with pytest.raises(CubeError, match="nearly all pixels agree with one smooth"):
        rejection.background(bare(scan_of()), interval=INTERVAL)
    noise = bare(plate).copy(deep=True)
    rng = np.random.default_rng(1)
    for name in ("in_phase", "quadrature"):
        noise[name].values[:] = rng.standard_normal(noise[name].shape)
    with pytest.raises(CubeError, match="no smooth water signal explains"):
        rejection.background(noise, interval=INTERVAL)


def test_echoes_are_searched_over_the_span_that_the_frequencies_tell_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    attrs = {"emitter_position": [0.0, 0, 0], "receiver_position": [0.3, 0.4, 0.0]}
    scan = SimpleNamespace(cube={"geometry": SimpleNamespace(attrs=attrs)})
    # Wavenumbers 3, 5 and 9 per meter: the smallest step is 2, from 3 to 5.
    wave = np.array([9.0, 3.0, 5.0])
    monkeypatch.setattr(background, "_wavenumber", lambda _: wave)
    whole = background._paths(scan, None)
    assert whole[0] == 0
    assert whole[-1] == pytest.approx(np.pi, abs=background._STEP / 9)
    np.testing.assert_allclose(np.diff(whole), background._STEP / 9)
    # A distance there and back, and half a meter between emitter and receiver.
    part = background._paths(scan, (1.0, 2.0))
    assert part[0] == 2
    assert 4.5 - 1.01 * background._STEP / 9 < part[-1] < 4.5
    # One frequency repeats after its own wavelength.
    monkeypatch.setattr(background, "_wavenumber", lambda _: np.array([4.0]))
    assert background._paths(scan, None)[-1] == pytest.approx(np.pi / 2, abs=0.2)
