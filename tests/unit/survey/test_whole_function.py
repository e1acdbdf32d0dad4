"""Phase functions with the moments that a survey states, and surveys as shipped."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest

from amulor.cli import main
from amulor.errors import SurveyError
from amulor.survey.water import Water
from amulor.survey.waters.whole_function import phase_function_of

EXAMPLES = sorted(
    entry.name
    for entry in files("amulor.survey.examples").iterdir()
    if entry.name.endswith(".toml")
)


def water(**others):
    usual = {
        "absorption": 0.1, "scattering": 0.4, "forward_fraction": 0.95,
        "second_moment": 0.05, "phase_function_at_180": 0.001,
    }  # fmt: skip
    return Water.model_validate(usual | others)


def integrals(function, split):
    """Return integral and second moment below an angle, and integral beyond it."""
    low = np.concatenate([[0.0], np.geomspace(1e-7, split, 40_000)])
    high = np.linspace(split, np.pi, 40_000)
    below = 2 * np.pi * np.sin(low) * function(low)
    beyond = 2 * np.pi * np.sin(high) * function(high)
    forward = np.trapezoid(below, low)
    moment = np.trapezoid(below * low**2, low) / forward
    return forward, moment, np.trapezoid(beyond, high)


@pytest.mark.parametrize("split", [np.pi / 2, 0.35])
@pytest.mark.parametrize("fraction", [0.9, 0.97, 0.99])
@pytest.mark.parametrize("backwards", [2e-4, 7e-4])
def test_it_has_the_moments_that_are_stated(split, fraction, backwards):
    moment = 0.05 if split > 1 else 0.01
    function = phase_function_of(
        water(
            split_angle=split, forward_fraction=fraction, second_moment=moment,
            phase_function_at_180=backwards,
        )
    )  # fmt: skip
    below, found, beyond = integrals(function, split)
    # The table has 2000 points on either side: a millionth of the curve.
    assert below == pytest.approx(fraction, abs=1e-4)
    assert beyond == pytest.approx(1 - fraction, abs=1e-4)
    assert found == pytest.approx(moment, rel=1e-3)
    assert function(np.pi) == pytest.approx(backwards, rel=1e-3)


def test_scattering_beyond_the_split_that_is_called_none_is_at_most_two_percent():
    function = phase_function_of(water(forward_fraction=1.0))
    below, moment, beyond = integrals(function, np.pi / 2)
    assert 0 < beyond < 0.02
    assert below + beyond == pytest.approx(1, abs=1e-6)
    assert moment == pytest.approx(0.05, rel=1e-3)
    assert function(np.pi) == pytest.approx(0.001, rel=0.03)


def test_only_water_that_does_not_scatter_is_isotropic():
    function = phase_function_of(water(scattering=1.0))
    assert function(0.01) > 10 * function(1.0)
    clear = phase_function_of(water(scattering=0.0))
    assert clear([0.01, 1.0, np.pi]) == pytest.approx(3 * [1 / (4 * np.pi)])


@pytest.mark.parametrize(
    ("others", "words"),
    [
        ({"second_moment": 1.5}, r"second_moment must be from .* got 1\.5 rad\^2"),
        ({"second_moment": 0.0}, "above 0, got 0.0 rad"),
        (
            {"forward_fraction": 1.0, "phase_function_at_180": 0.05},
            "no smooth phase function has a forward_fraction of 1",
        ),
    ],
)
def test_moments_that_do_not_fit_are_refused(others, words):
    with pytest.raises(SurveyError, match=words):
        phase_function_of(water(**others))


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_photons_follow_each_shipped_survey(name, tmp_path, capsys):
    path = tmp_path / name
    path.write_text(files("amulor.survey.examples").joinpath(name).read_text())
    words = ["backscatter", str(path), "--model", "montecarlo", "--error", "5 %"]
    assert main([*words, "--frequency", "1MHz:60MHz:5", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["model"] == "montecarlo"
    assert found["power_share_unmodulated"] > 0
    assert found["power_share_unmodulated_uncertainty"] < (
        0.051 * found["power_share_unmodulated"]
    )
    assert not found["heavy_tailed"]
    sweep = [str(path), "--frequency", "1MHz:60MHz:5", "--json"]
    assert main(["backscatter", *sweep]) == 0
    default = json.loads(capsys.readouterr().out)
    light = found["power_share_unmodulated"] / default["power_share_unmodulated"]
    # Within 5 %, and three times the 5 % to which the photons were followed.
    assert light == pytest.approx(1, abs=0.05 + 3 * 0.05)
    error = found["cut_off_uncertainty_hz"] / found["cut_off_hz"]
    assert default["cut_off_hz"] / found["cut_off_hz"] == pytest.approx(
        1, abs=0.05 + 3 * error
    )
    # The diffusion form has 0.7 to 1.0 of the light of such water, and a cut-off
    # 1.5 to 1.7 times as high (docs/theory/photon-transport.md).
    assert main(["backscatter", *sweep, "--model", "diffusion"]) == 0
    paper = json.loads(capsys.readouterr().out)
    light = found["power_share_unmodulated"] / paper["power_share_unmodulated"]
    assert 0.9 < light < 1.8
    assert 1.15 < paper["cut_off_hz"] / found["cut_off_hz"] < 1.9
