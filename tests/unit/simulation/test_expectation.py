"""What is expected of a scan is what its samples then are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.cli import main
from amulor.simulation import expectation, simulate
from amulor.survey import Survey


def test_it_is_what_the_samples_are(plate: Survey) -> None:
    survey = plate.with_(
        {
            "instrument.modulation_frequencies": ["20 MHz", "60 MHz"],
            "scan.columns": 24,
            "water.signal_fluctuation": 0.0,
        }
    )
    cube = simulate(survey, rng=3)
    truth = cube.amulor.truth
    met = truth["target"].values >= 0
    expected = expectation(survey)
    assert expected.hit == pytest.approx(met.mean())
    echo = np.hypot(truth["target_in_phase"], truth["target_quadrature"]).values
    water = np.hypot(truth["water_in_phase"], truth["water_quadrature"]).values
    # The noise is that of the samples themselves: about the truth, so many of them.
    gap = np.hypot(
        cube["in_phase"] - truth["target_in_phase"] - truth["water_in_phase"],
        cube["quadrature"] - truth["target_quadrature"] - truth["water_quadrature"],
    ).values
    noise = np.sqrt(np.mean(gap[:, :, met] ** 2, axis=-1) / 2)
    found = np.median(echo[:, :, met], axis=-1) / noise
    assert_allclose(expected.signal_to_noise, found, rtol=0.15)
    assert_allclose(
        expected.water_to_echo,
        np.median(water[:, :, met] / echo[:, :, met], axis=-1),
        rtol=0.02,
    )
    assert expected.saturated == 0


def test_more_light_saturates(plate: Survey) -> None:
    dim = expectation(plate)
    bright = expectation(plate.with_({"instrument.power": "1e6 W"}))
    assert dim.saturated == 0
    assert bright.saturated == 1


@pytest.mark.parametrize(
    ("position", "said"),
    [
        ('["0 cm", "0 cm", "-150 cm"]', "it stands 1.5 m behind the instrument"),
        ('["80 cm", "0 cm", "150 cm"]', "its center has azimuth 28.1 degrees, the sc"),
    ],
)
def test_a_target_that_no_beam_meets_is_told(
    position: str, said: str, plate_text: str, tmp_path: Path, capsys
) -> None:
    lines = plate_text.splitlines()
    at = lines.index("[[targets]]")
    where = next(
        n for n, line in enumerate(lines) if n > at and line.startswith("position")
    )
    lines[where] = f"position = {position}"
    survey = tmp_path / "aside.toml"
    survey.write_text("\n".join(lines), encoding="utf-8")
    assert main(["survey", "check", str(survey)]) == 0
    out = capsys.readouterr().out
    assert "0% of the beams meet a target" in out
    assert "warning: no beam meets targets.0 (plate): " + said in out
    assert main(["simulate", str(survey), "-o", str(tmp_path / "s.nc")]) == 0
    assert "0.0% of the beams meet a target" in capsys.readouterr().out


def test_weak_light_is_warned_of(plate_text: str, tmp_path: Path, capsys) -> None:
    survey = tmp_path / "weak.toml"
    survey.write_text(plate_text.replace('"20 mW"', '"20 nW"'), encoding="utf-8")
    assert main(["survey", "check", str(survey)]) == 0
    out = capsys.readouterr().out
    assert "warning: VH at 39 MHz is mostly noise" in out
    assert main(["survey", "check", str(survey), "--json"]) == 0
    assert '"signal_to_noise"' in capsys.readouterr().out
