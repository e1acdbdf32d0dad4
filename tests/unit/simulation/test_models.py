"""The forward models of a simulation: where they must agree, and with what."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import transport
from amulor.cli import main
from amulor.errors import SurveyError
from amulor.io import read_cube
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.simulation import (
    ClosureModel,
    DiffusionModel,
    SmallAngleModel,
    measurement,
    simulate,
)
from amulor.simulation.measurement import Setting
from amulor.survey import Survey, water_properties
from amulor.survey.view import view
from amulor.survey.waters.whole_function import whole_function_arguments

#: An asymmetry in place of moments.
WHOLE = {
    "water.asymmetry": 0.95,
    "water.forward_fraction": None,
    "water.second_moment": None,
    "water.phase_function_at_180": None,
}
FREQUENCIES = (10e6, 39e6, 78e6)


def _whole(plate: Survey, *, scattering: float, **water: object) -> Survey:
    """Return the plate in water with a whole phase function."""
    return plate.with_(
        {
            **WHOLE,
            **{f"water.{name}": value for name, value in water.items()},
            "water.scattering": scattering,
            "instrument.modulation_frequencies": FREQUENCIES,
            # No polarizer: photons are counted without one as well.
            "instrument.polarizations": ["none"],
            "scan.columns": 3,
        }
    )


def _light(cube: xr.Dataset, name: str) -> np.ndarray:
    truth = cube.amulor.truth
    return (truth[f"{name}_in_phase"] + 1j * truth[f"{name}_quadrature"]).values


def test_without_scattering_on_the_way_the_models_are_one(plate: Survey) -> None:
    survey = _whole(plate, scattering=1e-6, phase_function_at_180=0.001)
    fast, whole = (
        simulate(survey, rng=1, model=model)
        for model in (DiffusionModel(), SmallAngleModel())
    )
    # What is scattered twice is a millionth of the rest.
    for name in ("target", "water"):
        assert_allclose(_light(fast, name), _light(whole, name), rtol=2e-5)
    for group in ("in_phase", "quadrature"):
        assert_allclose(
            fast[f"open_water_{group}_uncertainty"],
            whole[f"open_water_{group}_uncertainty"],
            rtol=2e-5,
        )


def test_target_and_water_are_those_that_photons_bring(plate: Survey) -> None:
    survey = _whole(plate, scattering=0.595)
    cube = simulate(survey, rng=1, model=SmallAngleModel())
    row, column = 3, 1
    beam = np.array(
        [
            np.tan(float(cube["azimuth"][row, column])),
            -np.tan(float(cube["elevation"][row, column])),
            1.0,
        ]
    )
    receiver = survey.instrument.receiver
    axis = (np.tan(receiver.azimuth), -np.tan(receiver.elevation), 1.0)
    tally = transport.simulate(
        transport.Medium.homogeneous(
            absorption=0.255,
            scattering=0.595,
            phase_function=henyey_greenstein_function(asymmetry=0.95),
            group_index=1.38,
        ),
        transport.Source(direction=beam),
        transport.GaussianReceiver(
            radius=0.02,
            acceptance_angle=0.08,
            position=receiver.position,
            direction=axis,
        ),
        [0.0, *FREQUENCIES],
        histories=1_000_000,
        seed=1,
        target=transport.PlaneTarget(position=(0, 0, 1.5), reflectance=0.1),
        relative_error=0.01,
    )
    water, target = (
        sum(v for part, v in tally.by_part.items() if part.startswith(name))[1:]
        for name in ("water", "target")
    )
    found = {
        name: _light(cube, name)[:, 0, row, column] for name in ("water", "target")
    }
    ratio = found["water"] / found["target"]
    # Small angles only: 3 % are stated for the echo, 4 % for the water; photons 1 %.
    assert_allclose(np.abs(ratio), np.abs(water / target), rtol=0.05)
    # The model counts the delay of scattered light straight: below a degree at 39 MHz.
    turn = np.degrees(np.angle(ratio / (water / target)))
    assert np.all(np.abs(turn) < 1 + 1.5 * np.array(FREQUENCIES) / 78e6)
    # The diffusion form has too little water signal there at high frequencies.
    fast = simulate(survey, rng=1, model=DiffusionModel())
    other = _light(fast, "water") / _light(fast, "target")
    worst = np.abs(np.abs(other[:, 0, row, column]) / np.abs(water / target) - 1).max()
    assert worst > 0.2


def test_the_default_is_the_small_angle_form(plate: Survey) -> None:
    survey = _whole(plate, scattering=0.595)
    plain = simulate(survey, rng=1)
    whole = simulate(survey, rng=1, model=SmallAngleModel())
    assert plain.attrs["source"] == whole.attrs["source"]
    for name in ("target", "water"):
        assert_allclose(_light(plain, name), _light(whole, name), rtol=0)
    paper = simulate(survey, rng=1, model=DiffusionModel())
    assert "paper" in paper.attrs["source"]
    assert not np.allclose(_light(paper, "water"), _light(whole, "water"), rtol=0.05)


def test_the_closure_is_below_the_small_angle_form_by_some_percent(
    plate: Survey,
) -> None:
    survey = _whole(plate, scattering=0.595)
    closed, whole, paper = (
        _light(simulate(survey, rng=1, model=model), "target")[0, 0]
        for model in (ClosureModel(), SmallAngleModel(), DiffusionModel())
    )
    # On the axis of the receiver it is a lower bound, above the paper's form.
    assert np.all(abs(closed) < abs(whole))
    assert np.all(abs(closed) > abs(paper))
    assert_allclose(np.angle(closed), np.angle(whole))


def test_moments_alone_get_a_phase_function_that_has_them(plate: Survey) -> None:
    # Mean square angle, share and value straight back, as the survey states them.
    survey = plate.with_(
        {
            "water.forward_fraction": 0.97,
            "water.phase_function_at_180": 0.003,
            "scan.columns": 1,
        }
    )
    water = water_properties(survey)
    looking = view(survey, np.zeros(1), np.zeros(1))
    arguments = whole_function_arguments(survey, water, looking)
    share, moment = arguments["phase_function"].forward_split(np.pi / 2)
    assert share == pytest.approx(0.97, abs=2e-3)
    assert moment == pytest.approx(0.06, rel=5e-3)
    assert arguments["phase_function"].at_180 == pytest.approx(0.003, rel=1e-3)


def test_moments_that_no_phase_function_has_are_refused_by_name(plate: Survey) -> None:
    survey = plate.with_({"water.forward_fraction": 1.0, "water.second_moment": 1.9})
    with pytest.raises(SurveyError, match=r"second_moment must be.*diffusion model"):
        simulate(survey, rng=1)
    simulate(survey, rng=1, model=DiffusionModel())


@pytest.mark.parametrize(
    "stated",
    [
        {"forward_fraction": 0.0, "second_moment": 0.06},
        {"forward_fraction": 1.0, "second_moment": 0.0},
        {"forward_fraction": 0.4, "second_moment": 0.0},
    ],
)
def test_water_that_spreads_no_light_needs_no_phase_function(
    plate: Survey, stated: dict[str, float]
) -> None:
    survey = plate.with_({f"water.{name}": value for name, value in stated.items()})
    # The diffusion form is exact there: all that is scattered by an angle is lost.
    exact, *others = (
        simulate(survey, rng=1, model=model)
        for model in (DiffusionModel(), SmallAngleModel(), ClosureModel())
    )
    for cube in others:
        for name in ("target", "water"):
            assert_allclose(_light(cube, name), _light(exact, name), rtol=1e-9)


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ([], "whole phase function"),
        (["--model", "closure"], "closure"),
        *(
            pytest.param(["--model", option], words, marks=pytest.mark.slow)
            for option, words in (
                ("small-angle", "whole phase function"),
                ("diffusion", "the paper's form"),
            )
        ),
    ],
)
def test_the_command_takes_the_model_and_says_so(
    tmp_path, plate: Survey, option: list[str], words: str
) -> None:
    path = tmp_path / "plate.toml"
    path.write_text(plate.with_({"scan.columns": 2}).to_toml())
    output = tmp_path / "plate.nc"
    assert main(["simulate", str(path), *option, "-o", str(output)]) == 0
    assert words in read_cube(output).attrs["source"]


def test_the_command_refuses_what_the_model_cannot_use(
    tmp_path, plate: Survey, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plate.toml"
    path.write_text(plate.with_({"water.second_moment": 1.9}).to_toml())
    assert main(["simulate", str(path), "-o", str(tmp_path / "plate.nc")]) == 1
    error = capsys.readouterr().err
    assert "plate.toml: second_moment must be" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("rows", "columns", "whole"),
    [(4, 5, True), (5, 5, False), (20, 1, True), (21, 1, False)],
)
def test_a_model_is_fitted_to_all_pixels_of_a_small_scan(
    plate: Survey, rows: int, columns: int, whole: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = {}

    def fitted(model: object, *_: object, end: np.ndarray, farthest: float) -> object:
        taken.update(pixels=end.size, farthest=farthest)
        return model

    monkeypatch.setattr("amulor.simulation.lock_in.fitted", fitted)
    monkeypatch.setattr("amulor.cube.tiles.SAMPLE", 20)
    survey = plate.with_({"scan.rows": rows, "scan.columns": columns})
    measurement.fit(Setting.of(survey, rng=1, model=SmallAngleModel()))
    assert (taken["pixels"] == rows * columns) == whole
    assert taken["pixels"] <= 20
    # The plate is 1.5 m away; of a larger scan its farthest pixel is unknown.
    assert (taken["farthest"] < 2.0) == whole
