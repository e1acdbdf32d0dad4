"""Raw frames of time-of-flight cameras, from a generator that integrates light in time.

The generator adds up photons of taps that are open during a part of each period. It
shares nothing with the import but the frequencies.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.constants import speed_of_light

from amulor import imaging, rejection
from amulor.cli import main
from amulor.errors import FormatError
from amulor.io import read_cube
from amulor.io.recording_table import RecordingMap
from amulor.io.recordings import read_recordings
from amulor.survey import Survey

FREQUENCIES = (16e6, 40e6, 60e6)
ROWS, COLUMNS = 5, 7
#: Photons of a tap at full light, and steps of an integral over a period.
PHOTONS, STEPS = 2e7, 1_200
BACKGROUND, DEPTH = 0.4, 0.6


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    return plate.with_(
        {
            "scan.columns": COLUMNS,
            "scan.rows": ROWS,
            "scan.open_water": None,
            "instrument.modulation_frequencies": [f"{f} Hz" for f in FREQUENCIES],
            "instrument.polarizations": ["none"],
        }
    )


def geometry(survey: Survey) -> tuple[np.ndarray, np.ndarray, float]:
    """Return slant ranges of a tilted scene, optical paths, and the group index."""
    from amulor.survey.directions import scan_directions

    azimuth, elevation, _ = scan_directions(survey)
    distance = 1.4 + 0.02 * np.arange(COLUMNS) + 0.03 * np.arange(ROWS)[:, None]
    # Right, down, forward.
    direction = np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ],
        axis=-1,
    )
    emitter, receiver = (
        np.array(part.position)
        for part in (survey.instrument.emitter, survey.instrument.receiver)
    )
    point = emitter + distance[..., None] * direction
    path = distance + np.linalg.norm(point - receiver, axis=-1)
    index = float(survey.water.group_index)
    return distance, index * path, index


def tap(
    delay: np.ndarray, frequency: float, shift: float, rng: np.random.Generator
) -> np.ndarray:
    """Count photons of a tap that is open for half of each period, from `shift` on."""
    period = 1 / frequency
    time = (np.arange(STEPS) + 0.5) / STEPS * period
    is_open = ((time / period - shift / (2 * np.pi)) % 1.0) < 0.5
    turn = 2 * np.pi * frequency * (time[is_open] - delay[..., None])
    light = BACKGROUND + 1 + DEPTH * np.sin(turn)
    return rng.poisson(PHOTONS * light.mean(axis=-1) / 2).astype(float)


def frames(survey: Survey, count: int, *, difference: bool) -> list[list[np.ndarray]]:
    """Return frames by frequency and phase: of a tap, or of the difference of two."""
    _, path, _ = geometry(survey)
    rng = np.random.default_rng(count)
    # A tap that opens later by a phase sees a smaller phase of the light, so the
    # camera's steps are negative.
    return [
        [
            tap(path / speed_of_light, f, s, rng)
            - (tap(path / speed_of_light, f, s + np.pi, rng) if difference else 0.0)
            for s in 2 * np.pi * np.arange(count) / count
        ]
        for f in FREQUENCIES
    ]


def described(count: int, uncertainty: float, *, form: str) -> str:
    lists = [
        [f"/f{k}/phase{n}" if form == "hdf5" else f"f{k}p{n}" for n in range(count)]
        for k in range(len(FREQUENCIES))
    ]
    steps = [-360.0 * n / count for n in range(count)]
    place = "" if form == "hdf5" else 'row = "row"\ncolumn = "column"\n'
    return (
        f'[table]\nformat = "{form}"\n[columns]\nphases = {lists}\n{place}'
        f"[constants]\nfrequencies = {[f'{f} Hz' for f in FREQUENCIES]}\n"
        f"phase_steps = {steps}\nscale = 1e-9\n"
        f'uncertainty = "{uncertainty} V"\n'
    )


@pytest.mark.parametrize(("count", "difference"), [(4, False), (3, True), (4, True)])
def test_ranges_of_frames_are_true_within_their_errors(
    survey: Survey, tmp_path: Path, *, count: int, difference: bool
) -> None:
    recorded = frames(survey, count, difference=difference)
    with h5py.File(tmp_path / "frames.h5", "w") as file:
        for k, of_frequency in enumerate(recorded):
            for n, frame in enumerate(of_frequency):
                file[f"f{k}/phase{n}"] = frame
    # Poisson noise of a frame, and the variance of a least-squares amplitude: 2 / N.
    of_frame = PHOTONS * (1 + BACKGROUND) / 2 * (2 if difference else 1)
    uncertainty = 1e-9 * np.sqrt(of_frame * 2 / count)
    path = tmp_path / "map.toml"
    path.write_text(described(count, uncertainty, form="hdf5"))
    cube = read_recordings(tmp_path / "frames.h5", RecordingMap.from_toml(path), survey)
    assert cube["modulation_frequency"].values == pytest.approx(FREQUENCIES)
    # The generator has no water that scatters.
    target = rejection.keep_water(cube.assign_attrs(late_echo="absent"))
    image = imaging.range_image(target, interval=(0.5, 3.0))
    distance, _, index = geometry(survey)
    error = image["slant_range"].values - distance
    signal = cube.amulor.signal.values[:, 0]
    wave = 4 * np.pi * np.array(FREQUENCIES) * index / speed_of_light
    weight = (np.abs(signal) / uncertainty * wave[:, None, None]) ** 2
    stated = weight.sum(axis=0) ** -0.5
    assert np.abs(error / stated).max() < 4.0
    assert np.sqrt(np.mean((error / stated) ** 2)) == pytest.approx(1.0, abs=0.4)


def test_a_csv_of_frames_has_a_line_for_each_pixel(
    survey: Survey, tmp_path: Path
) -> None:
    recorded = frames(survey, 4, difference=True)
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    names = [f"f{k}p{n}" for k in range(3) for n in range(4)] + ["row", "column"]
    table = [frame.ravel() for some in recorded for frame in some]
    table += [rows.ravel(), columns.ravel()]
    np.savetxt(
        tmp_path / "frames.csv",
        np.transpose(table)[::-1],
        delimiter=",",
        header=",".join(names),
        comments="",
    )
    (tmp_path / "map.toml").write_text(described(4, 1e-6, form="csv"))
    (tmp_path / "survey.toml").write_text(survey.to_toml())
    paths = [str(tmp_path / name) for name in ("frames.csv", "survey.toml", "map.toml")]
    signals = []
    for options in ([], ["--tile-rows", "2"]):
        output = tmp_path / f"cube{len(options)}.nc"
        main(
            ["import", "recordings", paths[0], "--survey", paths[1], "--columns",
             paths[2], "-o", str(output), *options]
        )  # fmt: skip
        signals.append(read_cube(output).amulor.signal.values[:, 0])
    np.testing.assert_array_equal(signals[0], signals[1])
    # The textbook formula of four phases with negative steps.
    for k, (a0, a1, a2, a3) in enumerate(recorded):
        expected = 0.5e-9 * ((a0 - a2) + 1j * (a1 - a3))
        np.testing.assert_allclose(signals[0][k], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("frequencies = ", "# ", "as many constants.frequencies"),
        ("phase_steps = [", "phase_steps = [1.0, ", "has 5 phases"),
        (
            "[columns]",
            '[columns]\nfrequency = "f"',
            "too much; state constants.frequencies",
        ),
        ("[columns]", '[columns]\nin_phase = "x"\nquadrature = "y"', "or phases"),
    ],
)
def test_wrong_maps_are_refused(
    tmp_path: Path, *, old: str, new: str, message: str
) -> None:
    text = described(4, 1e-6, form="csv").replace(old, new, 1)
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises((FormatError, ValidationError), match=message):
        RecordingMap.from_toml(path)


def test_steps_that_determine_no_phase_are_refused(
    survey: Survey, tmp_path: Path
) -> None:
    text = described(3, 1e-6, form="csv")
    begin = text.index("phase_steps")
    line = text[begin : text.index("\n", begin)]
    path = tmp_path / "map.toml"
    path.write_text(text.replace(line, "phase_steps = [0.0, 180.0, 360.0]"))
    names = [f"f{k}p{n}" for k in range(3) for n in range(3)] + ["row", "column"]
    (tmp_path / "frames.csv").write_text(",".join(names) + "\n" + "1," * 10 + "1\n")
    with pytest.raises(FormatError, match="do not determine the phase"):
        read_recordings(tmp_path / "frames.csv", RecordingMap.from_toml(path), survey)
