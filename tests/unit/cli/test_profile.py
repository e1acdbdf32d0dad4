"""`amulor profile`: surfaces along the beam of a pixel, their table and figure."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scripts import script

from amulor import io, rejection, simulate
from amulor.cli import main
from amulor.imaging import beam_profile
from amulor.survey import Survey

#: The survey of the picture in the how-to.
SURVEY = script("docs/make_images.py").NET
FREQUENCIES = [f"{frequency} MHz" for frequency in range(100, 1001, 20)]


def _scan(distance: float) -> xr.Dataset:
    """Simulate a scan of a plate at a distance."""
    text = SURVEY.format(distance=distance, frequencies=FREQUENCIES)
    return simulate(Survey.from_text(text), rng=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with samples and target signal of a net 20 cm before a wall."""
    folder = tmp_path_factory.mktemp("profile")
    scan, net = _scan(2.0), _scan(1.8)
    for part in ("in_phase", "quadrature"):
        scan[part].values += 0.3 * net[f"truth_target_{part}"].values
    io.write_cube(scan, folder / "samples.nc")
    io.write_cube(rejection.open_water(scan), folder / "target.nc")
    return folder


@pytest.mark.parametrize(("pixel", "tilt"), [("1,1", 0), ("1,0", 1)])
def test_both_surfaces_of_a_beam_have_their_ranges(
    folder: Path, pixel: str, tilt: int, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["profile", str(folder / "target.nc"), "--pixel", pixel, "--json"]
    assert main(words) == 0
    beam = json.loads(capsys.readouterr().out)
    true = np.array([1.8, 2.0]) / math.cos(math.radians(tilt))
    error = np.array(beam["surface_uncertainty"])
    assert len(beam["surface"]) == 2
    assert (np.abs(np.array(beam["surface"]) - true) < 4 * error).all()
    assert (error < 2e-4).all()
    # The net has 0.3 of an equal plate at 1.8 m: (2 / 1.8)^2 and the attenuation of
    # 40 cm of water on the way, 0.1 to 0.9 1/m, between the two.
    near, far = beam["amplitude"]
    assert 0.3 * (2 / 1.8) ** 2 < near / far < 0.3 * (2 / 1.8) ** 2 * math.exp(0.36)
    # v / 2 B and v / 2 df, with v = c / 1.38, B = 900 MHz and df = 20 MHz.
    assert beam["resolution"] == pytest.approx(0.12069, rel=1e-4)
    assert beam["unambiguous_span"] == pytest.approx(5.4310, rel=1e-4)
    assert beam["misfit"] < beam["freedom"] + 4 * math.sqrt(2 * beam["freedom"])


def test_table_and_figure_are_written(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "profile.svg"
    words = ["profile", str(folder / "target.nc"), "--pixel", "1,1", "-o", str(picture)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "Range resolution: 12.1 cm" in printed
    assert "Unambiguous span: 5.43 m" in printed
    assert "warning" not in printed
    drawn = picture.read_text("utf-8")
    for text in ("noise level", "subtracted water signal", "1: 1.80", "2: 2.00"):
        assert text in drawn
    assert main(words) == 1
    assert "--overwrite" in capsys.readouterr().err


def test_a_missing_surface_is_reported_as_misfit(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["profile", str(folder / "target.nc"), "--pixel", "1,1", "--most", "1"]
    assert main(words) == 0
    assert "the uncertainties are too small" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "options", "code", "message"),
    [
        ("samples", "--pixel 1,1", 1, "use a result of `amulor reject`"),
        ("target", "--pixel 3,1", 1, "outside the cube of 3 rows and 3 columns"),
        ("target", "--pixel=-1,1", 1, "pixel -1,1 is outside"),
        ("target", "--pixel 1", 2, "no row and column"),
        ("target", "--pixel 1,1 --most 0", 2, "--most must be 1 or more"),
        ("target", "--pixel 1,1 --most 46", 1, "state at most 44"),
        ("target", "--pixel 1,1 --nearest 1.9m --farthest 2m", 1, "no two surfaces"),
        ("target", "--pixel 1,1 -o profile.pdf", 2, "--output"),
        ("two", "--pixel 1,1", 1, "at 2 of 2 modulation frequencies"),
        ("missing", "--pixel 1,1", 1, "at 0 of 46 modulation frequencies"),
    ],
)
def test_refusals_are_lines_with_the_reason(
    folder: Path,
    name: str,
    options: str,
    code: int,
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if name in ("two", "missing"):
        target = io.read_cube(folder / "target.nc")
        if name == "two":
            target = target.isel(modulation_frequency=[0, 1])
        else:
            target["in_phase"].values[:, :, 1, 1] = np.nan
        io.write_cube(target, folder / f"{name}.nc")
    assert main(["profile", str(folder / f"{name}.nc"), *options.split()]) == code
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1


@pytest.mark.parametrize(("misfit", "warned"), [(139.0, False), (141.0, True)])
def test_a_chi_square_beyond_four_standard_deviations_is_warned_of(
    folder: Path, misfit: float, warned: bool, monkeypatch, capsys
) -> None:
    # A chi-square of f degrees of freedom has the variance 2 f: 100 + 4 x 10 for 50.
    beam = SimpleNamespace(
        surface=[], surface_uncertainty=[], amplitude=[], amplitude_uncertainty=[],
        resolution=0.12, unambiguous_span=5.4, noise=1e-6, misfit=misfit - 50,
        freedom=50,
    )  # fmt: skip
    monkeypatch.setattr(beam_profile, "beam_profile", lambda *_, **__: beam)
    assert main(["profile", str(folder / "target.nc"), "--pixel", "1,1"]) == 0
    said = capsys.readouterr()
    assert ("scatter about the surfaces" in said.out + said.err) == warned
