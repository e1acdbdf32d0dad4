"""What other software recorded becomes the cube that it was, and says what is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import imaging, rejection
from amulor.cli import main
from amulor.cube import UNUSABLE
from amulor.errors import FormatError
from amulor.io import read_cube, recording_samples
from amulor.io.recording_table import RecordingMap, read_table
from amulor.io.recordings import BREAKDOWN, NO_NUMBER, ZERO, read_recordings
from amulor.simulation import simulate
from amulor.survey import Survey

XY = """
[columns]
in_phase = "X [V]"
quadrature = "Y [V]"
azimuth = "az"
elevation = "el"
frequency = "f"
polarization = "pol"
what = "what"
"""


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    """Return a survey of 6 x 4 pixels at two frequencies."""
    return plate.with_(
        {
            "scan.columns": 6,
            "scan.rows": 4,
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 6},
            "instrument.modulation_frequencies": ["30 MHz", "41 MHz"],
        }
    )


@pytest.fixture(scope="module")
def cube(survey: Survey) -> xr.Dataset:
    """Return a simulated cube, which stands for what was measured."""
    return simulate(survey, rng=4)


def written(cube: xr.Dataset, *, water: bool = True) -> list[list[str]]:
    """Return a cube as a lock-in of rms volts and falling phase would write it."""
    lines = [["X [V]", "Y [V]", "az", "el", "f", "pol", "what"]]
    parts = [("scan", cube)] + [("open_water", cube.amulor.open_water)] * water
    for what, part in parts:
        azimuth, elevation = (
            np.degrees(part[name].values).ravel() for name in ("azimuth", "elevation")
        )
        for f, frequency in enumerate(cube["modulation_frequency"].values):
            for p, pair in enumerate(cube["polarization"].values):
                x = part["in_phase"].values[f, p].ravel() / math.sqrt(2)
                y = -part["quadrature"].values[f, p].ravel() / math.sqrt(2)
                lines += [
                    [f"{a:.12e}", f"{b:.12e}", f"{c:.9f}", f"{d:.9f}", f"{frequency}",
                     str(pair), what]
                    for a, b, c, d in zip(x, y, azimuth, elevation, strict=True)
                ]  # fmt: skip
    return lines


BETWEEN = """
[table]
delimiter = "{}"
[columns]
in_phase = "x"
quadrature = "y"
polarization = "pol"
[constants]
frequency = "30 MHz"
"""


def saved(path: Path, lines: list[list[str]], delimiter: str = ",") -> Path:
    path.write_text("\n".join(delimiter.join(line) for line in lines) + "\n")
    return path


def mapped(tmp_path: Path, text: str) -> RecordingMap:
    path = tmp_path / "map.toml"
    path.write_text(text)
    return RecordingMap.from_toml(path)


def test_a_recording_of_x_and_y_is_the_cube_that_it_was(tmp_path, survey, cube) -> None:
    path = saved(tmp_path / "scan.csv", written(cube))
    found = read_recordings(path, mapped(tmp_path, XY), survey)
    assert found["in_phase"].shape == cube["in_phase"].shape == (2, 2, 4, 6)
    for name in ("in_phase", "quadrature", "azimuth", "elevation"):
        np.testing.assert_allclose(found[name], cube[name], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(
            found.amulor.open_water[name], cube.amulor.open_water[name],
            rtol=1e-9, atol=1e-10,
        )  # fmt: skip
    assert not found["user_sample_flag"].any()
    # Without a mean output, the amplitude is what is known of the light: a lower limit.
    for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
        ratio = found[name] / cube[name]
        assert 0.3 < float(ratio.min()) <= float(ratio.max()) < 1.05


def test_amplitude_and_phase_of_an_hdf5_file_in_the_order_of_the_scan(
    tmp_path, survey, cube
) -> None:
    one = cube.isel(modulation_frequency=[0]).sel(polarization=["VH"])
    signal = one.amulor.signal.values[0, 0]
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        node = "000/dev2004/demods/0/sample"
        file[f"{node}/r"] = 1e3 * np.abs(signal)
        file[f"{node}/theta"] = np.degrees(np.angle(signal))
        file[f"{node}/auxin0"] = np.full(signal.shape, 0.02)
    text = """
    [table]
    format = "hdf5"
    [columns]
    amplitude = "/000/dev2004/demods/0/sample/r"
    phase = "/000/dev2004/demods/0/sample/theta"
    mean = "/000/dev2004/demods/0/sample/auxin0"
    [constants]
    frequency = "30 MHz"
    polarization = "VH"
    scale = 1e-3
    root_mean_square = false
    phase_falls_with_delay = false
    """
    found = read_recordings(tmp_path / "scan.h5", mapped(tmp_path, text), survey)
    np.testing.assert_allclose(found.amulor.signal.values[0, 0], signal, rtol=1e-12)
    assert found["modulation_frequency"].values.tolist() == [30e6]
    assert found["polarization"].values.tolist() == ["VH"]
    assert (found["user_mean_output"] == 0.02).all()
    recorded = Survey.from_text(found.attrs["survey"])
    assert recorded.instrument.polarizations == ("VH",)


def test_lines_of_labone_with_a_header_behind_a_percent_sign(
    tmp_path, survey, cube
) -> None:
    one = cube.isel(modulation_frequency=[1]).sel(polarization=["VV"])
    signal = one.amulor.signal.values[0, 0].ravel() / math.sqrt(2)
    names = ["% chunk", "timestamp", "x", "y", "freq", "phase", "auxin0"]
    lines = [names] + [
        ["0", str(100 * k), f"{s.real:.12e}", f"{-s.imag:.12e}", "41e6", "0", "0.01"]
        for k, s in enumerate(signal)
    ]
    path = saved(tmp_path / "dev2004_demods_0_sample_00000.csv", lines, ";")
    text = """
    [table]
    delimiter = ";"
    comment = "%"
    [columns]
    in_phase = "x"
    quadrature = "y"
    frequency = "freq"
    mean = "auxin0"
    [constants]
    polarization = "VV"
    """
    found = read_recordings(path, mapped(tmp_path, text), survey)
    np.testing.assert_allclose(
        found["in_phase"].values[0, 0], one["in_phase"].values[0, 0], rtol=1e-9
    )
    # What the mean output says is counted.
    volt = survey.instrument.detector.volt_per_photoelectron_rate
    assert (found["in_phase_uncertainty"] > 0).all()
    assert 0.01 / volt > 0


def test_what_is_no_measurement_is_marked(tmp_path, survey, cube) -> None:
    lines = written(cube, water=False)
    lines[1][:2] = ["0", "0.0"]  # row 0, column 0
    lines[2][:2] = ["9.9e37", "9.9e37"]
    lines[3][:2] = ["nan", "1e-3"]
    lines[4][:2] = ["inf", "-inf"]
    lines[5][:2] = ["inf", "1e-3"]
    # A breakdown of the detector: thirty times the signal, at row 2, column 3.
    middle = 1 + 2 * 6 + 3
    lines[middle][:2] = [f"{30 * float(cell):.6e}" for cell in lines[middle][:2]]
    path = saved(tmp_path / "scan.csv", lines)
    found = read_recordings(path, mapped(tmp_path, XY), survey)
    flag = found["user_sample_flag"].values
    assert flag[0, 0, 0].tolist() == [ZERO] + [NO_NUMBER] * 4 + [0]
    assert flag[0, 0, 2, 3] == BREAKDOWN
    assert (flag != 0).sum() == 6
    assert np.isnan(found["in_phase"].values[0, 0, 0, :5]).all()
    assert found["saturated"].values[0, 0, 2, 3] == 1
    assert int(found["saturated"].sum()) == 1


def test_edges_of_targets_are_no_breakdowns(tmp_path, plate) -> None:
    survey = plate.with_(
        {
            "scan.columns": 12,
            "scan.rows": 8,
            "targets": [
                {"kind": "plate", "position": ["0 m", "0 m", "1.5 m"],
                 "width": "3 cm", "height": "30 cm", "reflectance": 0.5},
            ],
        }
    )  # fmt: skip
    cube = simulate(survey, rng=1)
    path = saved(tmp_path / "scan.csv", written(cube, water=False))
    found = read_recordings(path, mapped(tmp_path, XY), survey)
    assert not found["user_sample_flag"].any()


@pytest.mark.parametrize(
    "times", [1.2, 30.0, pytest.param(0.5, marks=pytest.mark.slow)]
)
def test_round_edges_are_no_breakdowns_and_what_stands_on_the_target_is(
    tmp_path, plate, times
) -> None:
    # On the edge of a disc beams see both sides, each pixel with another share.
    survey = plate.with_(
        {
            "scan.columns": 24,
            "scan.rows": 16,
            "targets": [
                {"kind": "disc", "position": ["4 mm", "3 mm", "1.5 m"],
                 "diameter": "5 cm", "reflectance": 0.5},
            ],
        }
    )  # fmt: skip
    lines = written(simulate(survey, rng=1), water=False)
    found = read_recordings(
        saved(tmp_path / "scan.csv", lines), mapped(tmp_path, XY), survey
    )
    assert not found["user_sample_flag"].any()
    # The middle of the disc in the second channel; the first ones have 16 x 24 lines.
    middle = 1 + 16 * 24 + 8 * 24 + 12
    lines[middle][:2] = [f"{times * float(cell):.6e}" for cell in lines[middle][:2]]
    found = read_recordings(
        saved(tmp_path / "scan.csv", lines), mapped(tmp_path, XY), survey
    )
    flag = found["user_sample_flag"].values
    assert flag[0, 1, 8, 12] == BREAKDOWN
    assert (flag != 0).sum() == 1


def test_samples_of_one_place_are_averaged(tmp_path, survey, cube) -> None:
    lines = written(cube, water=False)
    again = [[f"{2 * float(line[0]):.12e}", *line[1:]] for line in lines[1:25]]
    again[0][:2] = ["0", "0"]
    path = saved(tmp_path / "scan.csv", [*lines, *again])
    found = read_recordings(path, mapped(tmp_path, XY), survey)
    np.testing.assert_allclose(
        found["in_phase"].values[0, 0].ravel()[1:],
        1.5 * cube["in_phase"].values[0, 0].ravel()[1:],
        rtol=1e-9,
    )
    takes = found["user_takes"].values
    assert takes[0, 0].ravel().tolist() == [1] + [2] * 23
    assert (takes[1] == 1).all()


def test_one_of_several_temperatures_is_chosen(tmp_path, survey, cube) -> None:
    lines = [
        [*line, value]
        for value in ("12.0", "18.1")
        for line in written(cube, water=False)[1:]
    ]
    names = [*written(cube, water=False)[0], "T"]
    path = saved(tmp_path / "scan.csv", [names, *lines])
    described = mapped(tmp_path, XY + 'temperature = "T"\n')
    with pytest.raises(FormatError, match=r"several temperatures \(12, 18.1 degC\)"):
        read_recordings(path, described, survey)
    found = read_recordings(path, described, survey, temperature=18.0)
    assert (found["user_temperature"] == 18.1).all()
    assert found["user_temperature"].attrs["units"] == "degC"
    with pytest.raises(FormatError, match=r"no sample at 15 degC; there are 12, 18\.1"):
        read_recordings(path, described, survey, temperature=15.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("az,el", "a,el"), "has no column 'az'; there are"),
        (lambda t: t.replace(",VV,", ",VQ,", 1), "line 2: the polarization is 'VQ'"),
        (lambda t: t.replace("30000000.0", "fast", 1), "'f' holds 'fast', needed is a"),
        (lambda t: t.replace("30000000.0", "-1", 1), "modulation frequency is not kn"),
        (lambda t: t[: len(t) // 2 - 20], r"line \d+: has \d columns, needed are 7"),
        (
            lambda t: (
                "# a\n\n" + t.replace("\n", "\n# b\n", 1).replace("30000000.0", "x")
            ),
            "line 5: column 'f' holds 'x'",
        ),
        (
            lambda t: t.replace("VV,scan", 'VV,"scan', 1),
            "line 2: .*close the quotation",
        ),
        (lambda t: t.split("\n")[0] + "\n", "holds no sample below"),
        (lambda t: "", "has no column 'X \\[V\\]'; there are none"),
    ],
)
def test_bad_recordings_get_one_line(tmp_path, survey, cube, change, message) -> None:
    path = saved(tmp_path / "scan.csv", written(cube, water=False))
    path.write_text(change(path.read_text()))
    with pytest.raises(FormatError, match=message) as raised:
        read_recordings(path, mapped(tmp_path, XY), survey)
    assert "\n" not in str(raised.value)


def test_cells_are_read_as_they_are_written(tmp_path) -> None:
    path = tmp_path / "scan.csv"
    path.write_text(
        'x;y;note;pol\n 0,1234567890123456 ;;"a;b";01 # 2\n# x\n"-1e-3";nan;;VV\n'
    )
    text = """
    [table]
    delimiter = ";"
    decimal = ","
    [columns]
    in_phase = "x"
    quadrature = "y"
    polarization = "pol"
    [constants]
    frequency = "30 MHz"
    """
    table = read_table(path, mapped(tmp_path, text))
    np.testing.assert_allclose(
        table.numbers("x", decimal=","), [0.1234567890123456, -1e-3], rtol=1e-12
    )
    assert np.isnan(table.numbers("y", decimal=",")).all()
    assert table.texts("pol").tolist() == ["01 # 2", "VV"]
    assert table.place(1) == f"{path}, line 4"


@pytest.mark.parametrize(
    ("stated", "content"),
    [
        (r"\t", "x\ty\tnote\tpol\n1\t-2e-3\t\tVV\n3\t4\ttwo words\tVH\n"),
        (" ", "x y note pol\n1 -2e-3 - VV\n3 4 - VH\n"),
        (
            " ",
            '# of "J. Doe", tank 3\r\n# x  y note   pol \r\n'
            "   1   -2e-3 -  VV  \r\n\r\n  3 4  -  VH\r\n",
        ),
        (" ", '#x y note pol\n1 -2e-3 "two words"  VV\n3  4 "" VH\n'),
    ],
)
def test_columns_between_tabs_or_spaces(tmp_path, stated: str, content: str) -> None:
    path = tmp_path / "scan.txt"
    path.write_bytes(content.encode())
    table = read_table(path, mapped(tmp_path, BETWEEN.format(stated)))
    assert table.numbers("x", decimal=".").tolist() == [1, 3]
    assert table.numbers("y", decimal=".").tolist() == [-2e-3, 4]
    assert table.texts("pol").tolist() == ["VV", "VH"]


@pytest.mark.parametrize(("stated", "between"), [(r"\t", "\t"), (" ", "   ")])
def test_a_line_between_tabs_or_spaces_that_is_too_short_is_refused(
    tmp_path, stated: str, between: str
) -> None:
    lines = [["x", "y", "pol"], ["1", "2", "VV"], ["3", "VV"]]
    path = saved(tmp_path / "scan.txt", lines, between)
    with pytest.raises(FormatError, match="line 3: has 2 columns, needed are 3"):
        read_table(path, mapped(tmp_path, BETWEEN.format(stated)))


@pytest.mark.parametrize("stated", [r"\n", r"\r", r"\""])
def test_a_delimiter_that_ends_a_line_or_a_text_is_refused(tmp_path, stated) -> None:
    with pytest.raises(FormatError, match="ends a text or a line; state what"):
        mapped(tmp_path, BETWEEN.format(stated))


def test_shots_of_a_channel_that_were_left_out_are_named(
    tmp_path, survey, cube
) -> None:
    lines = [
        line
        for line in written(cube)
        if (line[4], line[6]) != ("41000000.0", "open_water")
    ]
    path = saved(tmp_path / "scan.csv", lines)
    with pytest.raises(FormatError, match=r"has 41 MHz V[VH], of which there is"):
        read_recordings(path, mapped(tmp_path, XY), survey)


@pytest.mark.parametrize("cell", ["inf", "nan", "0", "1e308"])
def test_a_channel_without_a_usable_shot_is_refused_without_warnings(
    tmp_path, survey, cube, cell
) -> None:
    lines = written(cube)
    for line in lines[1:]:
        if line[4:] == ["41000000.0", "VH", "open_water"]:
            line[:2] = [cell, cell]
    path = saved(tmp_path / "scan.csv", lines)
    with pytest.raises(
        FormatError, match="no open-water shot at 41 MHz VH is a number"
    ):
        read_recordings(path, mapped(tmp_path, XY), survey)


@pytest.mark.parametrize("rows", [None, 1])
def test_the_command_counts_references_without_a_number(
    tmp_path, survey, cube, capsys, rows
) -> None:
    lines = written(cube)
    for line in lines[-3:]:
        line[0] = "nan"
    path = saved(tmp_path / "scan.csv", lines)
    (tmp_path / "map.toml").write_text(XY)
    (tmp_path / "survey.toml").write_text(survey.to_toml())
    words = ["import", "recordings", str(path), "-o", str(tmp_path / "cube.nc")]
    words += ["--survey", str(tmp_path / "survey.toml")]
    words += ["--columns", str(tmp_path / "map.toml")]
    words += [] if rows is None else ["--tile-rows", str(rows)]
    assert main(words) == 0
    text = "marked: 3 open-water references without a usable number"
    assert text in capsys.readouterr().out


def test_samples_beyond_the_scan_are_refused(tmp_path, survey, cube) -> None:
    path = saved(tmp_path / "scan.csv", written(cube, water=False))
    # Milliradians that were taken for degrees.
    text = XY + '[constants]\nangle_unit = "mrad"\n'
    wide = survey.with_({"scan.azimuth": "20 deg"})
    with pytest.raises(FormatError, match="lie between or beyond its 4 x 6 pixels"):
        read_recordings(path, mapped(tmp_path, text), wide)
    ordered = XY.replace('azimuth = "az"\nelevation = "el"\n', "")
    small = survey.with_({"scan.rows": 3})
    with pytest.raises(FormatError, match="lie between or beyond its 3 x 6 pixels"):
        read_recordings(path, mapped(tmp_path, ordered), small)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[columns]\nin_phase = "x"', "in_phase and quadrature belong together"),
        ('[columns]\nazimuth = "a"\nelevation = "e"', "needed are in_phase and quad"),
        (XY + 'frequncy = "f"', "did you mean 'frequency'"),
        (XY + '[constants]\nfrequency = "1 MHz"', "say it twice; keep one"),
        ("[columns", "is no valid TOML"),
    ],
)
def test_bad_maps_get_one_line(tmp_path, text, message) -> None:
    with pytest.raises(FormatError, match=message) as raised:
        mapped(tmp_path, text)
    assert "\n" not in str(raised.value)


@pytest.mark.slow
def test_the_command_takes_a_recording_to_a_range_image(
    tmp_path, survey, cube, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    saved(Path("scan.csv"), written(cube))
    Path("map.toml").write_text(XY)
    Path("tank.toml").write_text(survey.to_toml())
    words = ["import", "recordings", "scan.csv", "--survey", "tank.toml"]
    assert main([*words, "--columns", "map.toml", "-o", "cube.nc"]) == 0
    assert "4 x 6 pixels at 2 frequencies in 2 polarizations" in capsys.readouterr().out
    images = [
        imaging.range_image(rejection.open_water(one).sel(polarization=["VH"]))
        for one in (read_cube("cube.nc"), cube)
    ]
    for image in images:
        assert not (image["quality_flag"].values & UNUSABLE).any()
    # A recording is of real water, whose late light is taken off; the simulated cube
    # says that it has none.
    late = images[0]["slant_range_late_echo"]
    assert (late > 1e-3).all()
    np.testing.assert_allclose(
        images[0]["slant_range"] + late, images[1]["slant_range"], atol=2e-4
    )
    assert main([*words, "--columns", "none.toml", "-o", "other.nc"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(("change", "count"), [(0.99e-6, 1), (1.01e-6, 2)])
def test_frequencies_closer_than_a_millionth_are_equal(change, count) -> None:
    frequencies = 39e6 * np.array([1.0, 1 + change])
    assert len(set(recording_samples.groups(frequencies))) == count
    means, place = recording_samples.distinct(frequencies[::-1])
    assert_allclose(means, [frequencies.mean()] if count == 1 else frequencies)
    assert place.tolist() == ([0, 0] if count == 1 else [1, 0])


def test_a_sample_is_compared_with_mixtures_of_its_neighbours() -> None:
    # On the way from 0 to 4 V the foot of 1 + 3i is 1 V; beyond 4 V the end is nearest.
    beside = np.array([0.0, 4.0])[:, None] * np.ones(3)
    signal = np.array([1 + 3j, 7 + 4j, 2 + 0j])
    off, spread = recording_samples.off_mixtures(signal, beside.astype(complex))
    assert_allclose(off, [3, 5, 0], atol=1e-12)
    assert_allclose(spread, 4)
    alone = np.full((2, 1), np.nan, complex)
    off, spread = recording_samples.off_mixtures(signal[:1], alone)
    assert off == np.inf
    assert spread == 0
