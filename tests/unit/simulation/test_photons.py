"""Scans whose light was followed by photons, against photons followed directly."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import transport
from amulor.cli import main
from amulor.io import read_cube
from amulor.optics import rays
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.simulation import PhotonModel, SmallAngleModel, lock_in, photons, simulate
from amulor.simulation.geometry import Setup, trace
from amulor.simulation.photons import Light
from amulor.survey import Survey

FREQUENCIES = (20e6, 60e6)
#: An asymmetry in place of moments; no polarizer, as photons are counted without one.
WHOLE = {
    "water.asymmetry": 0.95,
    "water.forward_fraction": None,
    "water.second_moment": None,
    "water.phase_function_at_180": None,
    "instrument.modulation_frequencies": FREQUENCIES,
    "instrument.polarizations": ["none"],
}


@pytest.mark.study
def test_drawn_pixels_are_those_of_photons_followed_directly(plate: Survey) -> None:
    survey = plate.with_(
        {
            **WHOLE,
            "targets.0.rotation": ["0 deg", "20 deg", "0 deg"],
            "scan.columns": 9,
            "scan.rows": 5,
        }
    )
    model = PhotonModel(relative_error=0.01, histories=200_000, seed=5)
    setup = Setup(survey)
    geometry = trace(setup)
    found = {
        "target": lock_in.target_light(setup, geometry, model=model),
        "water": lock_in.water_light(
            setup, geometry.view, end=geometry.depth, model=model
        ),
    }
    receiver = survey.instrument.receiver
    medium = transport.Medium.homogeneous(
        absorption=0.255,
        scattering=0.595,
        phase_function=henyey_greenstein_function(asymmetry=0.95),
        group_index=1.38,
    )
    normal = np.array([-np.sin(np.radians(20)), 0.0, -np.cos(np.radians(20))])
    square = []
    for row, column in np.random.default_rng(2).integers(0, [5, 9], (4, 2)):
        beam = rays.direction(
            geometry.azimuth[row, column], geometry.elevation[row, column]
        )
        tally = transport.simulate(
            medium,
            transport.Source(direction=beam),
            transport.GaussianReceiver(
                radius=0.02,
                acceptance_angle=0.08,
                position=receiver.position,
                direction=rays.direction(receiver.azimuth, receiver.elevation),
            ),
            [0.0, *FREQUENCIES],
            histories=200_000,
            seed=int(100 * row + column),
            target=transport.PlaneTarget(
                position=(0, 0, 1.5), normal=normal, reflectance=0.1
            ),
            relative_error=0.01,
        )
        for name, direct, covariance in (
            ("target", tally.target_signal, tally.target_covariance),
            ("water", tally.water_signal, tally.water_covariance),
        ):
            light = found[name]
            here = light.modulated[:, 0, row, column]
            variance = np.broadcast_to(light.variance, light.modulated.shape)
            both = variance[:, 0, row, column]
            both = both + np.trace(covariance[1:], axis1=-2, axis2=-1)
            square.append(abs(here - direct[1:]) ** 2 / both)
            # The error says something: 3 % at most where photons have 1 %.
            assert np.all(np.sqrt(variance[:, 0, row, column]) < 0.03 * abs(here))
    # The squared modulus of complex numbers in units of its own mean: 16 of them, of
    # which pixels share their nodes, so no test of a distribution but of its size.
    assert np.mean(square) < 2.5
    assert np.max(square) < 16


def _stand_in(water_part: complex, echo_part: complex):
    """Return a stand-in for `follow` that finds noisy parts of the small-angle form."""

    def follow(setting, place, frequency, *, seed, **_):
        draw = np.random.default_rng(seed).normal(size=2)
        size = len(frequency)
        return Light(
            water=np.full(size, water_part + 0.01 * draw[0]),
            target=np.full(size, echo_part + 0.02 * draw[1]),
        )

    return follow


def test_the_ratio_and_its_error_reach_the_cube(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    survey = plate.with_(
        {**WHOLE, "instrument.polarizations": ["VV"], "water.signal_fluctuation": 0.0}
    )
    # Photons bring 0.97 of the water and 0.9 of the echo, at each place.
    monkeypatch.setattr(photons, "follow", _stand_in(0.97 + 0j, 0.9 + 0j))
    monkeypatch.setattr(
        photons, "_small_angle", lambda *a, **k: np.ones(1 + len(FREQUENCIES), complex)
    )
    cube = simulate(survey, rng=1, model=PhotonModel(relative_error=0.001))
    plain = simulate(survey, rng=1, model=SmallAngleModel())
    lights = {}
    for name, part in (("target", 0.9), ("water", 0.97)):
        lights[name], whole = (_truth(each, name) for each in (cube, plain))
        # Runs of 1 and 2 % noise come to 0.1 %, root mean square over the beams.
        miss = np.sqrt(np.mean(abs(lights[name] / whole - part) ** 2))
        assert miss < 3 * 0.001
    assert "photon" in cube.attrs["source"]
    assert cube.attrs["late_echo"] == "present"
    assert plain.attrs["late_echo"] == "absent"
    # The error is part of the uncertainty, half of the variance in each output.
    extra = cube["in_phase_uncertainty"].values ** 2
    extra = extra - plain["in_phase_uncertainty"].values ** 2
    light = abs(lights["water"]) ** 2 + abs(lights["target"]) ** 2
    assert np.mean(extra) < 9 * np.mean(light) * 0.001**2 / 2
    assert np.mean(extra) > 0.1 * np.mean(light) * 0.001**2 / 2


def _truth(cube: xr.Dataset, name: str) -> np.ndarray:
    truth = cube.amulor.truth
    return (truth[f"{name}_in_phase"] + 1j * truth[f"{name}_quadrature"]).values


def test_a_run_serves_echo_and_water(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    survey = plate.with_({**WHOLE, "scan.open_water": None})
    seeds, places = [], []
    stand_in = _stand_in(1 + 0j, 1 + 0j)

    def follow(setting, place, frequency, *, seed, **options):
        seeds.append(seed)
        places.append(place)
        return stand_in(setting, place, frequency, seed=seed, **options)

    monkeypatch.setattr(photons, "follow", follow)
    monkeypatch.setattr(
        photons, "_small_angle", lambda *a, **k: np.ones(1 + len(FREQUENCIES), complex)
    )
    simulate(survey, rng=1, model=PhotonModel(relative_error=0.5))
    assert len(seeds) == len(set(seeds))
    # All of them look at the plate: one set of runs serves both.
    assert all(place.reflectance == 0.1 for place in places)
    assert len(places) < 60


def test_ctrl_c_leaves_nothing_behind(
    tmp_path: Path, plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(photons, "follow", stop)
    path = tmp_path / "plate.toml"
    path.write_text(plate.with_(WHOLE).to_toml())
    words = ["simulate", str(path), "--model", "photons", "-o", str(tmp_path / "p.nc")]
    assert main(words) == 130
    assert sorted(each.name for each in tmp_path.iterdir()) == ["plate.toml"]


def test_an_interrupted_run_is_not_taken_for_a_result(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dataclasses import replace

    from amulor.simulation import photons as photon_runs

    real = photon_runs.simulate

    def cut(*arguments, **options):
        options |= {"histories": 4000, "relative_error": None, "progress": None}
        return replace(real(*arguments, **options), interrupted=True)

    monkeypatch.setattr(photon_runs, "simulate", cut)
    with pytest.raises(KeyboardInterrupt):
        simulate(plate.with_(WHOLE), rng=1, model=PhotonModel())


@pytest.mark.slow
def test_the_command_follows_photons(tmp_path: Path, plate: Survey) -> None:
    path, output = tmp_path / "plate.toml", tmp_path / "plate.nc"
    small = {**WHOLE, "scan.columns": 2, "scan.rows": 1, "scan.open_water": None}
    path.write_text(plate.with_(small).to_toml())
    words = ["simulate", str(path), "--model", "photons", "--error", "5 %"]
    assert main([*words, "-o", str(output)]) == 0
    assert "photon transport" in read_cube(output).attrs["source"]


@pytest.mark.parametrize("value", ["0 %", "-1 %", "200 %"])
def test_an_error_that_cannot_be_reached_is_refused(
    tmp_path: Path, plate: Survey, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plate.toml"
    path.write_text(plate.to_toml())
    words = ["simulate", str(path), f"--error={value}", "-o", str(tmp_path / "p.nc")]
    assert main(words) == 2
    assert "--error" in capsys.readouterr().err
    with pytest.raises(ValueError, match="relative_error"):
        PhotonModel(relative_error=0.0)


def test_an_axis_that_spans_little_has_no_polynomials_to_fit() -> None:
    rng = np.random.default_rng(2)
    points = np.stack([rng.uniform(-1, 1, 400), rng.uniform(-1e-4, 1e-4, 400)], axis=1)
    wide = np.array([1e-3, 1e-3])
    basis, fitted = photons.basis_of(points, smallest=wide, degree=4)
    # Degrees 0 to 4 along the wide axis, and one more to test the fit.
    assert (fitted, basis.shape[1]) == (5, 6)
    np.testing.assert_allclose(basis.T @ basis / 400, np.eye(6), atol=1e-9)
    # A span of five of the smallest lengths follows ceil(log 5 / log 3) = 2 degrees.
    some = photons.basis_of(points[:, :1], smallest=np.array([0.4]), degree=4)[1]
    assert some == 3
    both = photons.basis_of(points * [1, 5e3], smallest=np.array([0.4, 0.4]), degree=4)
    # The other axis has 2.5 of them, degree 1: five products up to a degree of 2, and
    # four that test them.
    assert (both[1], both[0].shape[1]) == (5, 9)


def test_air_before_the_water_absorbs_nothing() -> None:
    def echo(standoff: float, absorption: float) -> complex:
        setting = photons.Setting(
            absorption=absorption, scattering=0.0, group_index=1.33,
            phase_function=henyey_greenstein_function(asymmetry=0.9),
            receiver_radius=0.02, acceptance_angle=0.05,
        )  # fmt: skip
        place = photons.Place(
            baseline=0.05, tilt=0.02, cross_tilt=0.0,
            standoff=standoff, depth=2.0 - standoff, reflectance=0.5,
        )  # fmt: skip
        frequency = np.array([0.0])
        light = photons.follow(setting, place, frequency, histories=20_000, seed=1)
        return complex(light.target[0])

    # As far from the receiver, a metre of it in air or not. Chance leaves 1 %.
    in_air, in_water = echo(1.0, 1e-9), echo(0.0, 1e-9)
    assert abs(in_water) > 0
    assert in_air == pytest.approx(in_water, rel=0.04)
    # Of 2 m there and back, 1 m is water each way.
    assert abs(echo(0.0, 0.3) / in_water) == pytest.approx(math.exp(-1.2), rel=0.04)
    assert abs(echo(1.0, 0.3) / in_air) == pytest.approx(math.exp(-0.6), rel=0.04)


def test_water_ends_at_a_bright_target_or_at_a_dark_end(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    survey = plate.with_({**WHOLE, "water.column_end": "2 m"})
    setup = Setup(survey)
    view = trace(setup).view
    end = np.full(view.tilt.shape, 1.5)
    end[0, 0], end[0, 1:3], end[1, 0] = np.inf, 2.0, 2.5
    asked: list[tuple[float, list[float], str]] = []

    def noted(
        self, survey, water, view, points, frequency, reflectance, light
    ) -> tuple[np.ndarray, np.ndarray]:
        asked.append((reflectance, sorted(set(points[:, 3].tolist())), light))
        shape = len(frequency), len(points)
        return np.full(shape, 1 + reflectance, complex), np.full(shape, 0.01)

    monkeypatch.setattr(PhotonModel, "_factor", noted)
    options = {"survey": survey, "water": setup.water, "view": view, "end": end}
    frequency = np.array(FREQUENCIES)[:, None, None]
    value, error = PhotonModel().column_with_error(frequency, **options)
    plain = SmallAngleModel().column(frequency, **options)
    # The plate reflects 0.1.
    assert asked == [(0.1, [1.5], "water"), (0.0, [2.0, 2.5], "water"),
                     (0.0, [math.inf], "water")]  # fmt: skip
    ratio = np.where(end == 1.5, 1.1, 1.0)
    assert_allclose(value, ratio * plain, rtol=1e-12)
    assert_allclose(error, 0.01 * abs(plain), rtol=1e-12)


def test_what_a_model_has_found_is_no_part_of_its_text() -> None:
    model = PhotonModel()
    model._known["run"] = 1
    assert model == PhotonModel()
    assert "_known" not in repr(model)
    with pytest.raises(TypeError, match="_known"):
        PhotonModel(_known={})  # type: ignore[call-arg]
