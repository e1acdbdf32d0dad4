"""Beams that are followed by photons: places, settings, seeds, and how many."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.phase_functions.models import isotropic
from amulor.simulation import PhotonModel, SmallAngleModel, photons
from amulor.simulation.geometry import Setup, trace
from amulor.simulation.photons import Light, Place, Setting
from amulor.survey import Survey
from amulor.transport import Tally, Technique

SETTING = Setting(
    absorption=0.2, scattering=0.6, phase_function=isotropic(), group_index=1.35,
    receiver_radius=0.02, acceptance_angle=0.07, beam_radius=0.003,
    beam_divergence=0.004,
)  # fmt: skip
PLACE = Place(
    baseline=0.3, tilt=0.36, cross_tilt=0.48, standoff=0.5, depth=2.0, reflectance=0.25
)
WHOLE = {
    "water.asymmetry": 0.95,
    "water.forward_fraction": None,
    "water.second_moment": None,
    "water.phase_function_at_180": None,
    "instrument.polarizations": ["none"],
}


def place(**changes: float) -> Place:
    values = {name: getattr(PLACE, name) for name in Place.__dataclass_fields__}
    return Place(**(values | changes))


def test_a_beam_starts_behind_its_standoff_and_ends_at_its_depth() -> None:
    start, direction, point = photons.ends(PLACE)
    assert_allclose(direction, [0.36, 0.48, 0.8])
    assert_allclose(start, [0.18, 0.24, 0.5])
    assert_allclose(point, [0.9, 1.2, 2.1])
    length = 2 + math.sqrt(0.6**2 + 1.2**2 + 2.1**2) - 0.5
    assert photons.way(PLACE) == pytest.approx(length)
    open_water = photons.ends(place(depth=math.inf))
    assert_allclose(open_water[2], open_water[0])


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Return the calls of photon transport."""
    found: list[tuple[Any, ...]] = []

    def simulate(*arguments: Any, **options: Any) -> Tally:
        found.append((*arguments, options))
        batches = np.arange(1.0, 5.0).reshape(2, 2, 1, 1).astype(complex)
        return Tally(
            modulation_frequency=np.array([1e7]), parts=("water, order 1", "target"),
            batches=batches, histories_of=np.array([8, 8]), groups=2,
            contribution=(1.0, 1.0, 1.0), seed=1, next_batch=2, batch_size=8,
            problem="", seconds=0.0,
        )  # fmt: skip

    monkeypatch.setattr(photons, "simulate", simulate)
    return found


def test_a_beam_is_a_problem_of_photon_transport(calls: list[Any]) -> None:
    frequency = np.array([1e7])
    found = photons.follow(SETTING, PLACE, frequency, histories=64, seed=5)
    medium, source, receiver, given, options = calls[0]
    assert medium.group_index == 1.35
    gap, water = medium.layers
    assert (gap.absorption, gap.scattering, gap.thickness) == (0, 0, 0.5)
    assert (water.absorption, water.scattering) == (0.2, 0.6)
    assert medium.edges == (0, 0.5, math.inf)
    assert_allclose(source.position, [0.18, 0.24, 0.5])
    assert_allclose(source.direction, [0.36, 0.48, 0.8])
    assert (source.radius, source.divergence) == (0.003, 0.004)
    assert receiver.position == (0.3, 0, 0)
    assert (receiver.radius, receiver.acceptance_angle) == (0.02, 0.07)
    assert given is frequency
    assert (options["histories"], options["seed"], options["threads"]) == (64, 5, 1)
    assert options["technique"] == Technique(batch=64)
    assert options["relative_error"] is None
    assert options["derivatives"] == ()
    target = options["target"]
    assert_allclose(target.position, [0.9, 1.2, 2.1])
    assert_allclose(target.normal, [-0.36, -0.48, -0.8])
    assert target.reflectance == 0.25
    # Means of the batches 1, 3 and 2, 4, without the way through the gap.
    turn = np.exp(-2j * np.pi * 1e7 * 1.35 * 0.5 / 299792458)
    assert_allclose(found.water, [2 * turn])
    assert_allclose(found.target, [3 * turn])


def test_a_beam_without_a_gap_or_target_is_one_in_open_water(calls: list[Any]) -> None:
    at_once = place(standoff=0.0, depth=math.inf)
    found = photons.run(
        SETTING, at_once, np.array([1e7]), histories=64, seed=5, relative_error=0.1,
        threads=3, derivatives=("scattering",),
    )  # fmt: skip
    medium, _, _, _, options = calls[0]
    assert medium.unbounded
    assert options["target"] is None
    assert (options["threads"], options["relative_error"]) == (3, 0.1)
    assert options["derivatives"] == ("scattering",)
    assert options["technique"] is None
    assert found.water_signal[0] == 2
    bare = Setting(
        absorption=0.2, scattering=0.6, phase_function=isotropic(), group_index=1.35,
        receiver_radius=0.02, acceptance_angle=0.07,
    )  # fmt: skip
    assert (bare.beam_radius, bare.beam_divergence) == (0, 0)


def test_ratios_of_light_are_one_where_none_is_expected() -> None:
    found = photons._ratio(np.array([2 + 2j, 3, 0]), np.array([1 + 1j, 0, 4]))
    assert found.tolist() == [2, 1, 0]


@pytest.mark.parametrize("between", [(), (1,), (1, 1)])
def test_ratios_multiply_selected_beams_and_keep_their_error(between: Any) -> None:
    value = np.arange(1.0, 13.0).reshape(2, *between, 2, 3) + 1j
    before, error = value.copy(), np.zeros(value.shape)
    selected = np.array([[True, False, False], [False, False, True]])
    ratio = np.array([[2, 3], [4, 5j]])
    standard_error = np.array([[0.1, 0.2], [0.3, 0.4]])
    photons._apply((ratio, standard_error), selected, value, error)
    flat, old, off = (x.reshape(2, 6) for x in (value, before, error))
    assert_allclose(flat[:, [0, 5]], old[:, [0, 5]] * ratio)
    assert_allclose(off[:, [0, 5]], np.abs(old[:, [0, 5]]) * standard_error)
    assert_array_equal(flat[:, 1:5], old[:, 1:5])
    assert not off[:, 1:5].any()


def test_beams_have_four_coordinates() -> None:
    view: Any = SimpleNamespace(
        tilt=np.array([[0.1, 0.2, 0.3]]), cross_tilt=np.array([[-0.2, 0.0, 0.4]]),
        baseline=np.array([[0.07]]),
    )  # fmt: skip
    found = photons._places(view, np.array([[1.0, 2.0, np.inf]]))
    expected = [
        [0.07, 0.1, 0.04, 1], [0.07, 0.2, 0, 2], [0.07, 0.3, 0.16, np.inf]
    ]  # fmt: skip
    assert_allclose(found, expected)


def test_photons_need_homogeneous_water_and_a_plain_beam(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    for name in ("refuse_layers", "refuse_beam_and_edges"):
        monkeypatch.setattr(
            photons, name,
            lambda what, model, name=name: asked.append((name, what, model)),
        )  # fmt: skip
    setup = Setup(plate)
    photons._setting(plate, setup.water, trace(setup).view)
    assert asked == [
        ("refuse_layers", setup.water, "the photon model"),
        ("refuse_beam_and_edges", plate, "the photon model"),
    ]


def test_water_of_a_survey_is_that_of_its_photons(plate: Survey) -> None:
    survey = plate.with_(WHOLE)
    setup = Setup(survey)
    view = trace(setup).view
    found = photons._setting(survey, setup.water, view)
    assert found.absorption == 0.255
    assert found.scattering == pytest.approx(0.595)
    assert (found.group_index, found.receiver_radius) == (1.38, 0.02)
    assert found.acceptance_angle == view.acceptance
    assert found.beam_radius == 0
    wide = photons.setting_of(survey, setup.water, view, beam_radius=0.1)
    assert wide.beam_radius == 0.1
    assert photons._brightness(survey) == 0.1
    assert photons._brightness(survey.with_({"targets": []})) == 0


def test_small_angle_light_of_a_beam_is_that_of_its_pixel(plate: Survey) -> None:
    survey = plate.with_(WHOLE)
    setup = Setup(survey)
    geometry = trace(setup)
    view = geometry.view
    row, column = 1, 10
    beam = Place(
        baseline=float(np.broadcast_to(view.baseline, view.tilt.shape)[row, column]),
        tilt=float(view.tilt[row, column]),
        cross_tilt=float(view.cross_tilt[row, column]),
        standoff=0.0,
        depth=float(geometry.depth[row, column]),
        reflectance=0.1,
    )
    frequency = np.array([0.0, 39e6])
    water, target = (
        photons._small_angle(survey, setup.water, view, beam, frequency, kind)
        for kind in ("water", "target")
    )
    assert water.shape == target.shape == (2,)
    model: Any = SmallAngleModel()
    common = {"survey": survey, "water": setup.water, "view": view}
    axes = frequency[:, None, None]
    column_light = model.column(axes, end=geometry.depth, **common)
    assert_allclose(water, column_light[:, row, column], rtol=1e-9)
    surface = {
        "depth": geometry.depth, "optical_path": geometry.optical_path,
        "return_path": geometry.return_path, "cosine": geometry.cosine,
        "reflectance": np.full(view.tilt.shape, 0.1),
    }  # fmt: skip
    echo = model.echo(axes, surface=surface, **common)
    # The plane lies across the beam, which is 1.5 deg off: its cosine is a thousandth.
    expected = echo[:, row, column]
    assert np.all(np.abs(target - expected) < 0.01 * np.abs(expected))


def test_photons_of_one_beam_are_followed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Place, int, int]] = []

    def follow(setting: Setting, beam: Place, frequency: Any, *, histories: int,
               seed: int) -> Light:  # fmt: skip
        asked.append((beam, histories, seed))
        return Light(water=np.array([seed + 0j]), target=np.array([beam.depth + 0j]))

    monkeypatch.setattr(photons, "follow", follow)
    told: list[tuple[str, float]] = []
    model = PhotonModel(seed=7, progress=lambda *step: told.append(step))
    frequency = np.array([1e7])
    beams = [place(depth=1.0), place(depth=3.0)]
    first = model._followed(SETTING, beams, frequency, 800, 4)
    assert [light.target[0] for light in first] == [1, 3]
    assert sorted(asked, key=lambda each: each[2]) == [
        (beams[0], 800, 7), (beams[1], 800, 1007),
    ]  # fmt: skip
    assert told == [("photons, beam 5", 0.5), ("photons, beam 6", 1.0)]
    again = model._followed(SETTING, beams, frequency, 800, 4)
    assert again == first
    assert len(asked) == 2
    # The same beams in a later run are other runs, with other seeds.
    later = model._followed(SETTING, beams, frequency, 800, 5)
    assert sorted(seed for _, _, seed in asked) == [7, 1007, 2007, 3007]
    assert later[1].water[0] == 3007
    # One that is known as that run is not followed again.
    assert model._followed(SETTING, beams[1:], frequency, 800, 5) == first[1:]
    assert len(asked) == 4


def factor(
    monkeypatch: pytest.MonkeyPatch, noise: float, *, light: str = "water",
    points: int = 300, open_water: bool = False, **options: Any,
) -> tuple[Any, list[int], list[Place]]:  # fmt: skip
    """Return ratio and error of drawn beams whose ratio is 0.9 or 1.2, and the runs."""
    rng = np.random.default_rng(3)
    counts: list[int] = []
    places: list[Place] = []

    def followed(_: Any, __: Any, beams: Any, frequency: Any, histories: int,
                 before: int) -> list[Light]:  # fmt: skip
        assert before == len(places)
        counts.append(histories)
        places.extend(beams)
        return [
            Light(
                water=(0.9 + noise * rng.normal(size=2)) + 0j,
                target=(1.2 + noise * rng.normal(size=2)) + 0j,
            )
            for _ in beams
        ]

    monkeypatch.setattr(PhotonModel, "_followed", followed)
    monkeypatch.setattr(photons, "_setting", lambda *_: SETTING)
    monkeypatch.setattr(photons, "_small_angle", lambda *_: np.ones(2, complex))
    beams = rng.uniform([0.07, 0, 0, 1], [0.0701, 0.3, 1e-5, 1.001], (points, 4))
    if open_water:
        beams[:, 3] = np.inf
    view: Any = SimpleNamespace(standoff=np.array([[0.5]]))
    model = PhotonModel(**options)
    nothing: Any = None
    found = model._factor(
        nothing, nothing, view, beams, np.array([0.0, 1e7]), 0.25, light
    )
    return found, counts, places


def test_runs_go_on_until_the_error_of_the_fit_is_small(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Polynomials of degree 2 along the tilt alone: 3 to fit, 4 with the test.
    (value, error), counts, places = factor(
        monkeypatch, 0.05, relative_error=0.01, histories=64 * 20_000
    )
    assert value.shape == error.shape == (2, 300)
    assert_allclose(value.real, 0.9, atol=5 * 0.05 * np.sqrt(3 / len(places)))
    # Each run has a 64th of the photons, in groups of eight.
    assert set(counts) == {20_000}
    # 12 runs at first, then sqrt(2) times as many, until the error is met.
    steps = [12, 17, 25, 36, 51, 73, 104, 148, 192]
    assert len(places) in steps[3:]
    assert places[0].standoff == 0.5
    assert places[0].reflectance == 0.25
    assert 1 <= places[0].depth <= 1.001
    assert 0 <= places[0].cross_tilt <= math.sqrt(1e-5)
    assert 0.07 <= places[0].baseline <= 0.0701
    assert places[0].tilt > places[0].cross_tilt


def test_runs_end_at_the_most_histories(monkeypatch: pytest.MonkeyPatch) -> None:
    _, _, places = factor(monkeypatch, 0.5, relative_error=1e-4, histories=64 * 20_000)
    # 64 runs for each of the three polynomials.
    assert len(places) == 192
    few = factor(monkeypatch, 0.5, relative_error=1e-4, histories=100_000)
    # A run has 16,384 photons at least: 19 for three times 100,000.
    assert set(few[1]) == {16_384}
    assert len(few[2]) == 19
    # The least number of runs is made in any case, and in open water.
    least = factor(monkeypatch, 0.0, relative_error=0.5, histories=1, open_water=True)
    assert len(least[2]) == 12
    assert math.isinf(least[2][0].depth)


def test_light_of_the_target_has_a_ratio_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (value, error), _, _ = factor(
        monkeypatch, 0.001, light="target", relative_error=0.01
    )
    assert_allclose(value, 1.2, atol=0.01)
    assert np.all(error < 0.01)
    assert PhotonModel().relative_error == 0.005
    assert PhotonModel().histories == 2_000_000
    assert PhotonModel().seed == 1


@pytest.mark.parametrize("error", [0.0, 1.0, -0.1, math.nan])
def test_an_error_is_between_nothing_and_all(error: float) -> None:
    with pytest.raises(ValueError, match=f"above 0 and below 1, got {error}"):
        PhotonModel(relative_error=error)
