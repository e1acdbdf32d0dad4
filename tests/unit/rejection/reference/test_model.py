"""Between shots water is interpolated against a model; photons and others judge it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor.cube import tiles
from amulor.errors import SurveyError
from amulor.optics import rays
from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.reference import model as shapes
from amulor.rejection.reference.shots import Reference, fit_channel, fit_shots
from amulor.simulation import simulate
from amulor.simulation.models import DiffusionModel
from amulor.studies.trust.surveys import scaled, survey
from amulor.survey import Survey, water_properties
from amulor.survey.waters.whole_function import whole_phase_function
from amulor.transport import GaussianReceiver, Medium, Source
from amulor.transport import simulate as follow_photons

#: Where no number of shots in three rows was dense enough for a polynomial.
WIDE: dict[str, Any] = {"wide": 19, "tall": 4, "columns": 20, "rows": 6}
TALL: dict[str, Any] = {"wide": 9, "tall": 19, "columns": 8, "rows": 20}


def _fits(cube: xr.Dataset) -> list[tuple[Reference, np.ndarray]]:
    truth = cube["truth_water_in_phase"] + 1j * cube["truth_water_quadrature"]
    fits, _ = fit_shots(Observation(cube=cube))
    return list(zip(fits, truth.values.reshape(len(fits), -1), strict=True))


@pytest.mark.parametrize(
    "scan", [WIDE, pytest.param(TALL, marks=pytest.mark.slow)], ids=["wide", "tall"]
)
def test_nine_by_three_shots_do_for_nineteen_degrees(scan: dict[str, Any]) -> None:
    # A polynomial missed up to 18 and 40 % of the largest signal.
    for found, truth in _fits(simulate(survey(1, **scan), rng=1)):
        off = np.abs(found.signal - truth) / np.abs(truth).max()
        # 270 shots that fluctuate by 2 %, 27 directions: 0.4 % where one tells alone.
        assert off.max() < 0.01
        stated = np.sqrt(found.common.in_phase + found.common.quadrature)
        assert np.abs(found.signal - truth).max() < 4 * stated.max()


@pytest.mark.slow
@pytest.mark.parametrize("water", [scaled("tank", 1.6), scaled("tank", 0.6), "harbour"])
def test_water_of_another_model_is_followed_within_what_is_stated(water: Any) -> None:
    # What the user believes is the tank; the light is of other water.
    cube = simulate(survey(2, water=water, **WIDE), rng=2)
    cube = cube.assign_attrs(survey=survey(2, **WIDE).to_toml())
    plain = {index: (0.10, 0.30)[index // 2] for index in range(4)}
    for index, (found, truth) in enumerate(_fits(cube)):
        off = np.abs(found.signal - truth)
        assert off.max() < plain[index] * np.abs(truth).max() / 4
        # Twice the error holds nine of ten; dim directions shows no shot.
        stated = np.sqrt(found.common.in_phase + found.common.quadrature)
        bright = np.abs(truth) > 0.1 * np.abs(truth).max()
        assert np.mean(off[bright] < 2 * stated[bright]) > 0.85


def test_the_form_of_the_paper_is_a_candidate_too() -> None:
    made = survey(1, **WIDE)
    for found, truth in _fits(simulate(made, rng=3, model=DiffusionModel())):
        # 4 % by a polynomial, and worse against the small-angle form alone.
        assert np.abs(found.signal - truth).max() < 0.012 * np.abs(truth).max()


def test_a_narrow_scan_needs_no_model() -> None:
    cube = simulate(survey(1, columns=6, rows=4), rng=1)
    scan = Observation(cube=cube)
    assert scan.shots is not None
    places = np.stack([scan.shots.azimuth, scan.shots.elevation], axis=1)
    found = shapes.model_behind_shots(
        scan, scan.shots, places, span=tiles.span_of(cube)
    )
    assert found is None


@pytest.mark.slow
def test_pixels_take_the_model_from_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    cube = simulate(survey(2, **WIDE), rng=1)
    found = _fits(cube)

    class Direct:
        """The model itself, pixel by pixel."""

        def __init__(self, model: Any, *_: object) -> None:
            self.at = model

    monkeypatch.setattr(shapes, "_Tabled", Direct)
    for (one, truth), (exact, _) in zip(found, _fits(cube), strict=True):
        assert np.abs(one.signal - exact.signal).max() < 1e-6 * np.abs(truth).max()


def _photons(made: Survey, azimuth: float, histories: int, seed: int) -> Any:
    seen, water = made.instrument.receiver, water_properties(made)
    medium = Medium.homogeneous(
        absorption=water.absorption,
        scattering=water.scattering,
        phase_function=whole_phase_function(water),
        group_index=water.group_index,
    )
    receiver = GaussianReceiver(
        position=np.array(seen.position),
        direction=rays.direction(seen.azimuth, seen.elevation),
        radius=seen.radius,
        acceptance_angle=seen.acceptance,
    )
    beam = Source(direction=rays.direction(np.array(azimuth), np.array(0.0)))
    return follow_photons(
        medium, beam, receiver, [50e6], histories=histories, seed=seed
    )


@pytest.mark.slow
def test_photons_between_the_shots_agree() -> None:
    # Every direction by photons of its own: no model has a part in what is true.
    made = survey(1, wide=19, tall=0, rows=1, columns=8, shot_rows=1)
    half = np.radians(9.5)
    at_shots, between = np.linspace(-half, half, 9), np.linspace(-half, half, 17)[1::2]
    tallies = [
        _photons(made, azimuth, 150_000, seed)
        for seed, azimuth in enumerate([*at_shots, *between])
    ]
    signal = np.array([each.water_signal[0] for each in tallies])
    error = np.array([np.sqrt(np.trace(e.water_covariance[0])) for e in tallies])
    shots, spread = np.repeat(signal[:9], 4), np.repeat(error[:9], 4) * 2
    rng = np.random.default_rng(0)
    shots = shots + 1e-3 * np.abs(shots) * rng.standard_normal(36)
    variance = spread**2 / 2
    places = np.stack([np.repeat(at_shots, 4), np.zeros(36)], axis=1)
    pixels = np.stack([between, np.zeros(8)], axis=1)
    instrument = Covariance(variance, variance, np.zeros(36))
    cube = simulate(made, rng=0)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    variables = {
        "in_phase": shots.real,
        "quadrature": shots.imag,
        "in_phase_uncertainty": np.sqrt(variance),
        "quadrature_uncertainty": np.sqrt(variance),
    }
    model = shapes.model_behind_shots(
        Observation(cube=cube),
        Observation(
            cube=xr.Dataset(
                {
                    name: (
                        ("modulation_frequency", "polarization", "shot"),
                        values[None, None],
                    )
                    for name, values in variables.items()
                }
            )
        ),
        places,
        span=tiles.Span((low[0], high[0]), (low[1], high[1])),
    )
    assert model is not None
    shape = model.over(pixels, cube["modulation_frequency"].values)
    missed = [
        np.abs(
            fit_channel(shots, instrument, places, pixels, shape=each).signal
            - signal[9:]
        ).max()
        for each in (None, shape[0])
    ]
    largest = np.abs(signal).max()
    assert missed[0] > 0.03 * largest
    # Photons at both ends of each comparison are known to a percent.
    assert missed[1] < 5 * error.max() + 0.01 * largest
    assert missed[1] < missed[0] / 3


def test_water_without_a_whole_phase_function_is_known(monkeypatch) -> None:
    def none(_: object) -> None:
        raise SurveyError("no phase function")

    has = shapes._has_phase_function.__wrapped__
    clear, peaked, milky = (
        SimpleNamespace(forward_scattering=b, second_moment=moment)
        for b, moment in ((0.0, 0.1), (0.2, 0.0), (0.2, 0.1))
    )
    monkeypatch.setattr(shapes, "whole_phase_function", none)
    # Light that is not turned needs no function.
    assert [has(water) for water in (clear, peaked, milky)] == [True, True, False]
    monkeypatch.setattr(shapes, "whole_phase_function", lambda _: "a function")
    assert has(milky) is True
