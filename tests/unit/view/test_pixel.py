"""`amulor explain FILE --pixel`: flags of a pixel and the numbers behind them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.constants import speed_of_light

from amulor import imaging, io, rejection, samples
from amulor.cli import main
from amulor.cube import QualityFlag
from amulor.view.explanations import reasons

SIGMA = 1e-3


@pytest.fixture(scope="module")
def target() -> xr.Dataset:
    cube = samples.cube("ladder").isel(row=slice(0, 16), shot=slice(0, None, 4))
    return rejection.open_water(cube)


@pytest.fixture(scope="module")
def flat(target: xr.Dataset) -> xr.Dataset:
    """Return a range image of a wall at 1.5 m, with errors of 1 mm and no flags."""
    image = imaging.range_image(target, polarization="VV").copy(deep=True)
    image["slant_range"][:] = 1.5
    image["slant_range_uncertainty"][:] = SIGMA
    image["quality_flag"][:] = 0
    return image.drop_vars("slant_range_common_uncertainty")


def of_image(image: xr.Dataset, path: Path, row: int, column: int) -> dict[str, list]:
    """Return names, values and limits of the reasons of a pixel, by flag."""
    io.write_cube(image, path)
    found: dict[str, list] = {}
    for one in reasons(path, row, column)["VV"]:
        found.setdefault(one.flag, []).append((one.quantity, one.value, one.limit))
    return found


def test_a_pixel_off_its_neighbours_states_its_standard_errors(
    flat: xr.Dataset, tmp_path: Path
) -> None:
    flat = flat.copy(deep=True)
    flat["slant_range"][8, 50] += 0.02
    flagged = imaging.flag_outliers(flat)
    ((quantity, value, limit),) = of_image(flagged, tmp_path / "image.nc", 8, 50)[
        "OUTLIER"
    ]
    assert "standard errors" in quantity
    # Lines through two neighbours have half the variance, the median of four 0.3 of it.
    assert value == pytest.approx(0.02 / (SIGMA * math.sqrt(1 + 0.3 / 2)))
    assert limit == "> 2.5"


def test_a_pixel_between_surfaces_states_how_clear_it_is_of_both(
    flat: xr.Dataset, tmp_path: Path
) -> None:
    flat = flat.copy(deep=True)
    flat["slant_range"][:, 50] = 1.55
    flat["slant_range"][:, 51:] = 1.6
    flagged = imaging.flag_mixed(flat)
    found = of_image(flagged, tmp_path / "image.nc", 8, 50)["MIXED"]
    # A line through four has 1.5 of the variance where it meets the pixel; five pixels
    # along the edge have a fifth of it.
    expected = 0.05 / (SIGMA * math.sqrt(2.5 / 5))
    assert found == [
        (found[0][0], pytest.approx(expected), "> 3.5"),
    ]


def test_a_weak_signal_states_its_standard_errors_and_its_phase(
    target: xr.Dataset, tmp_path: Path
) -> None:
    weak = target.copy(deep=True)
    place = {"modulation_frequency": 0, "polarization": 0, "row": 3, "column": 4}
    for name, value in {
        "in_phase": 0.003, "quadrature": 0.004, "in_phase_uncertainty": 2e-3,
        "quadrature_uncertainty": 2e-3, "in_phase_quadrature_covariance": 0.0,
        "residual_in_phase": 0.0, "residual_quadrature": 0.0,
        "signal_significance": 2.5, "quality_flag": QualityFlag.NO_TARGET,
    }.items():  # fmt: skip
        weak[name][place] = value
    io.write_cube(weak, tmp_path / "target.nc")
    found = reasons(tmp_path / "target.nc", 3, 4)
    assert list(found) == ["VV", "VH"]
    values = {one.quantity: (one.value, one.limit, one.unit) for one in found["VV"]}
    assert values == {
        "target signal off zero, in standard errors": (2.5, "< 5", "1"),
        # Perpendicular to the signal of 5 mV there are 2 mV.
        "standard uncertainty of the phase": (pytest.approx(0.4), "> 0.3", "rad"),
    }


def test_a_residual_states_the_angle_and_the_phase_error(
    target: xr.Dataset, tmp_path: Path
) -> None:
    turned = target.copy(deep=True)
    place = {"modulation_frequency": 0, "polarization": 1, "row": 3, "column": 4}
    for name, value in {
        "in_phase": 1.0, "quadrature": 0.0, "in_phase_uncertainty": 0.02,
        "quadrature_uncertainty": 0.01, "in_phase_quadrature_covariance": 0.0,
        "residual_in_phase": 0.0, "residual_quadrature": -0.05,
        "quality_flag": QualityFlag.WATER_RESIDUAL, "water_residual_cause": 1,
    }.items():  # fmt: skip
        turned[name][place] = value
    io.write_cube(turned, tmp_path / "target.nc")
    (one,) = reasons(tmp_path / "target.nc", 3, 4)["VH"]
    assert (one.flag, one.unit) == ("WATER_RESIDUAL", "rad")
    assert one.value == pytest.approx(math.atan(0.05))
    assert one.limit == "> 0.01"


def test_intervals_that_fit_alike_state_the_probability_of_another(
    tmp_path: Path,
) -> None:
    cube = samples.cube("sweep").isel(row=[3], column=[4], shot=slice(0, None, 4))
    one = rejection.keep_water(cube).sel(polarization=["VH"])
    one = one.isel(modulation_frequency=[13, 14]).copy(deep=True)
    frequency = one["modulation_frequency"].values
    # Phases of a path of 2.4 m known to 14 degrees; intervals differ by 45 degrees.
    rate = 2 * np.pi * frequency / speed_of_light
    signal = np.exp(1j * rate * 2.4)[:, None, None, None]
    one["in_phase"][:], one["quadrature"][:] = signal.real, signal.imag
    for name in ("in_phase", "quadrature"):
        one[f"{name}_uncertainty"][:] = 0.25
    one["in_phase_quadrature_covariance"][:] = 0.0
    for name in list(one.data_vars):
        if str(name).startswith("phase_uncertainty_"):
            one = one.drop_vars(name)
    interval = (0.2, 3.0)
    image = imaging.range_image(one, interval=interval)
    io.write_cube(image, tmp_path / "image.nc")
    found = [
        reason
        for reason in reasons(tmp_path / "image.nc", 0, 0)["VH"]
        if reason.flag == "AMBIGUOUS"
    ]
    group_index = float(image["geometry"].attrs["group_index"])
    # All paths of the interval, on a fine grid; the best of each repetition counts.
    path = np.arange(2 * group_index * 0.2, 2 * group_index * 3.0, 1e-4)
    off = np.angle(np.exp(1j * (rate[:, None] * (path - 2.4))))
    chi_square = (off**2).sum(axis=0) / 0.25**2
    inner = chi_square[1:-1]
    lowest = inner[(inner < chi_square[:-2]) & (inner < chi_square[2:])]
    weight = np.exp(-(lowest - lowest.min()) / 2)
    expected = 1 - 1 / weight.sum()
    assert expected > 1e-3
    assert found[0].value == pytest.approx(expected, rel=0.1)
    assert found[0].limit == "> 0.000335"


@pytest.mark.slow
def test_a_joint_estimate_states_what_contradicts_its_model(tmp_path: Path) -> None:
    cube = samples.cube("sweep").isel(
        modulation_frequency=slice(0, None, 3), row=[2, 3], shot=slice(0, None, 4)
    )
    target = rejection.joint(cube, interval=(0.5, 3)).copy(deep=True)
    for name, value in {
        "quality_flag": QualityFlag.WATER_RESIDUAL, "water_residual_cause": 24,
    }.items():  # fmt: skip
        target[name][:, :, 1, 8] = value
    for name, value in {
        "joint_misfit_probability": 1e-6, "joint_departure": 0.003,
        "joint_departure_limit": 0.002,
    }.items():  # fmt: skip
        target[name][1, 8] = value
    io.write_cube(target, tmp_path / "target.nc")
    image = imaging.range_image(target, interval=(0.5, 3))
    io.write_cube(image, tmp_path / "image.nc")
    of_target = reasons(tmp_path / "target.nc", 1, 8)["VV"]
    of_pixel = reasons(tmp_path / "image.nc", 1, 8)["VV"]
    for found in (of_target, of_pixel):
        # The same of all frequencies: once.
        assert [
            (one.cause, one.modulation_frequencies, one.value, one.limit, one.unit)
            for one in found
            if one.flag == "WATER_RESIDUAL"
        ] == [
            ("MODEL_MISFIT", (), 1e-6, "< 0.0001", "1"),
            ("MODEL_DEPARTURE", (), 0.003, "> 0.002", "m"),
        ]


def test_the_command_prints_numbers_limits_and_what_to_do(
    target: xr.Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    io.write_cube(target, tmp_path / "target.nc")
    cause = target["water_residual_cause"].values
    row, column = (int(each[0]) for each in np.nonzero(cause[0, 0] == 2))
    ratio = float(target["column_over_target"][row, column])
    words = ["explain", str(tmp_path / "target.nc"), "--pixel", f"{row},{column}"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    line = next(one for one in printed.splitlines() if "behind the target" in one)
    assert f"{ratio:.3g} │" in line
    assert "> 0.3" in line
    assert "WATER_RESIDUAL (STRONG_COLUMN)" in line
    assert "STRONG_COLUMN, what to do: Record a second modulation" in printed
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found["channels"]) == {"VV", "VH"}
    assert found["to_do"]["STRONG_COLUMN"].startswith("Record a second")
    good = np.argwhere((target["quality_flag"].values == 0).all(axis=(0, 1)))[0]
    assert main([*words[:2], "--pixel", f"{good[0]},{good[1]}"]) == 0
    assert "channel VV: no flags" in capsys.readouterr().out


def test_what_has_no_such_pixel_is_refused_in_one_line(
    target: xr.Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    io.write_cube(target, tmp_path / "target.nc")
    io.write_cube(samples.cube("ladder"), tmp_path / "samples.nc")
    image = imaging.range_image(target, polarization="VV")
    io.write_cube(imaging.point_cloud(image), tmp_path / "cloud.nc")
    (tmp_path / "cloud.ply").write_text("ply\n", encoding="utf-8")
    for name, pixel, words in (
        ("target.nc", "16,0", "row 16 is outside the scan; needed is a row from 0 to"),
        ("target.nc", "0,-1", "column -1 is outside the scan"),
        ("target.nc", "3", "'3' is no row and column"),
        ("samples.nc", "0,0", "of level samples, which has no flags of pixels"),
        ("cloud.nc", "0,0", "of level point_cloud, which has no rows and columns"),
        ("cloud.ply", "0,0", "no flags of pixels; name a target signal"),
        ("none.nc", "0,0", "does not exist"),
    ):
        assert main(["explain", str(tmp_path / name), f"--pixel={pixel}"]) == 1
        said = capsys.readouterr().err
        assert words in said, said
        assert said.count("\n") == 1
    assert main(["explain", "--pixel", "0,0"]) == 1
    assert "--pixel needs one file before it" in capsys.readouterr().err
