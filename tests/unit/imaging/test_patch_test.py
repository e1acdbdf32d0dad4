"""Patch tests of lines that an independent simulator renders."""

import runpy
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from amulor import imaging, io
from amulor.cli import main
from amulor.errors import CubeError, SurveyError
from amulor.io.trajectories import write_trajectory
from amulor.platform import Mounting, Trajectory, instrument_poses, read_mounting
from amulor.platform.mounting import error_factors, mounting_text

ROOT = Path(__file__).parents[3]
LINES = runpy.run_path(str(ROOT / "benchmarks" / "measure_patch_tests.py"))


@pytest.fixture(scope="module")
def rocked():
    """Images and trajectories of three lines of a vehicle that rolls and pitches."""
    chosen = [LINES["LINES"][number] for number in (0, 2, 4)]
    return LINES["lines_of"](2, lines=chosen, rows=70, columns=30)


@pytest.fixture(scope="module")
def tested(rocked):
    images, tracks, _ = rocked
    return imaging.patch_test(
        images, trajectories=tracks, mounting=LINES["stated_mounting"]()
    )


def test_the_mounting_lies_within_its_uncertainty(rocked, tested):
    true = rocked[2]
    sigma = tested.uncertainty
    # Eight quantities: beyond 3.5 in one of 270 tests.
    assert (np.abs(tested.change - true) < 3.5 * sigma).all()
    # Small beside the errors before: 10 mm, 1 degree and 20 ms.
    assert (sigma[:7] < 0.3 * LINES["SPREAD"][:7]).all()
    assert sigma[3:6].max() < np.radians(0.1)
    assert sigma[6] < 5e-4


def test_lines_meet_after_the_test(tested):
    before, after = (np.median(part[1]) for part in (tested.before, tested.after))
    assert before > 2e-3
    # Means of some 24 ranges with 1 mm of noise.
    assert after < 4e-4
    assert 1.0 <= tested.misfit < 1.15


def test_the_mounting_is_written_with_its_covariance(tested, tmp_path):
    path = tmp_path / "rov.toml"
    path.write_text(mounting_text(tested.mounting))
    factors = error_factors(read_mounting(path))
    scale = np.outer(tested.uncertainty, tested.uncertainty)
    np.testing.assert_allclose(
        factors.T @ factors / scale, tested.covariance / scale, atol=3e-3
    )
    stated = read_mounting(path)
    shift = np.array(stated.lever_arm) - tested.mounting.lever_arm
    assert (np.abs(shift) < 1e-3 * tested.uncertainty[:3]).all()


def test_a_drift_in_short_lines_is_not_determined(tested):
    entries = {entry.quantity: entry for entry in tested.undetermined}
    assert set(entries) == {"clock drift"}
    assert entries["clock drift"].uncertainty > 0.5 * LINES["SPREAD"][7]


def _rocked_by(monkeypatch, *degrees):
    """Let the vehicle of further lines oscillate in heading, pitch and roll (rms)."""
    monkeypatch.setitem(
        LINES["lines_of"].__globals__, "ROCKING", np.radians([*degrees])
    )


def test_a_level_vehicle_does_not_determine_the_lever_arm(monkeypatch):
    """Lines in one direction: only a vehicle that rolls or pitches moves the arm."""
    stated = LINES["stated_mounting"]()
    _rocked_by(monkeypatch, 0.2, 0.2, 0.2)
    chosen = [LINES["LINES"][number] for number in (0, 4)]
    images, tracks, true = LINES["lines_of"](1, lines=chosen, rows=70, columns=30)
    result = imaging.patch_test(images, trajectories=tracks, mounting=stated)
    entries = {entry.quantity: entry for entry in result.undetermined}
    down = entries["lever arm down"]
    assert down.uncertainty > 0.8 * LINES["SPREAD"][1]
    assert down.line == "line 1 while the vehicle rolls by 10 degrees every 4 s"
    assert (np.abs(result.change - true) < 3.5 * result.uncertainty).all()
    # The suggested line, whose amplitude of 10 degrees is 7.07 degrees rms.
    _rocked_by(monkeypatch, 0.2, 0.2, 7.07)
    more = LINES["lines_of"](1, lines=chosen[:1], rows=70, columns=30)
    result = imaging.patch_test(
        images + more[0], trajectories=tracks + more[1], mounting=stated, suggest=False
    )
    assert "lever arm down" not in {entry.quantity for entry in result.undetermined}
    # Periods and phases of the oscillation are random.
    assert 0.5 < result.uncertainty[1] / down.with_line < 1.5
    assert (np.abs(result.change - true) < 3.5 * result.uncertainty).all()


def test_lines_half_an_hour_apart_determine_the_drift(rocked):
    """Dated trajectories, and a clock that gains 20 ms an hour."""
    images, tracks, true = rocked
    begin = datetime(2026, 5, 4, 10, 0, tzinfo=UTC)
    dated = []
    for number, (image, track) in enumerate(zip(images, tracks, strict=True)):
        since = 1800.0 * number
        start = begin + timedelta(seconds=since)
        image = image.assign_attrs(time_coverage_start=start.isoformat())
        # The clock of the vehicle at the start of the line, by the true drift.
        stamps = track.time + start.timestamp() + true[7] * since
        dated.append((image, replace(track, time=stamps, clock="unix")))
    mounting = LINES["stated_mounting"]().model_copy(
        update={"clock_reference": begin.isoformat()}
    )
    result = imaging.patch_test(
        [image for image, _ in dated],
        trajectories=[track for _, track in dated],
        mounting=mounting,
    )
    # 0.5 ms between lines that are 1 hour apart.
    assert result.uncertainty[7] < 2e-7
    assert (np.abs(result.change - true) < 3.5 * result.uncertainty).all()
    assert not result.undetermined


def test_lines_that_do_not_overlap_are_refused(rocked):
    images, tracks, _ = rocked
    far = replace(tracks[1], position=tracks[1].position + 50.0)
    with pytest.raises(CubeError, match="overlap in 0 places"):
        imaging.patch_test(
            images[:2], trajectories=[tracks[0], far], mounting=Mounting()
        )
    with pytest.raises(CubeError, match="1 lines and 1 trajectories"):
        imaging.patch_test(images[:1], trajectories=tracks[:1], mounting=Mounting())
    late = Mounting(clock_offset=1000.0)
    with pytest.raises(CubeError, match="no pixel was measured during"):
        imaging.patch_test(images, trajectories=tracks, mounting=late)


def test_correlated_errors_of_the_mounting_move_points_together():
    """A pitch that cancels the clock: no error along a track at constant speed."""
    track = Trajectory.of_angles(
        time=np.arange(10.0), position=np.outer(np.arange(10.0), [0, 0.5, 0]),
        heading=0.0, position_uncertainty=0.0, heading_uncertainty=0.0,
        level_uncertainty=0.0,
    )  # fmt: skip
    matrix = np.eye(8)
    matrix[3, 6] = matrix[6, 3] = -1.0
    # Looking down from 2 m: 4 mm per 2 mrad about right, 4 mm per 8 ms at 0.5 m/s.
    mounting = Mounting(
        pitch="-90 deg", lever_arm_uncertainty="0 m",
        boresight_uncertainties=("2 mrad", "0 rad", "0 rad"), clock_uncertainty="8 ms",
        correlation=matrix.tolist(),
    )  # fmt: skip
    poses = instrument_poses(track, mounting, [4.0])
    point = poses.place([[0.0, 0.0, 2.0]])
    together = (poses.shared_errors(point) ** 2).sum(axis=0)[0]
    np.testing.assert_allclose(np.sqrt(together), 0.0, atol=1e-9)
    opposite = mounting.model_copy(update={"correlation": np.abs(matrix).tolist()})
    poses = instrument_poses(track, opposite, [4.0])
    spread = np.sqrt((poses.shared_errors(point) ** 2).sum(axis=0)[0])
    np.testing.assert_allclose(spread, [0.0, 8e-3, 0.0], atol=1e-9)


def test_a_clock_that_drifts_reads_later_poses():
    track = Trajectory.of_angles(
        time=np.arange(100.0), position=np.outer(np.arange(100.0), [0.2, 0, 0]),
        heading=0.0,
    )  # fmt: skip
    drift = Mounting(clock_offset="1 s", clock_drift=0.01)
    poses = instrument_poses(track, drift, [50.0])
    assert poses.position[0, 0] == pytest.approx(0.2 * (50 + 1 + 0.5))
    dated = replace(track, clock="unix")
    with pytest.raises(SurveyError, match="clock_reference"):
        instrument_poses(dated, drift, [50.0])
    since = drift.model_copy(update={"clock_reference": "1970-01-01T00:00:20Z"})
    poses = instrument_poses(dated, since, [50.0])
    assert poses.position[0, 0] == pytest.approx(0.2 * (50 + 1 + 0.3))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"correlation": [[1.0]]}, "eight rows"),
        ({"correlation": (2 * np.eye(8) - 1).tolist()}, "eigenvalue"),
        ({"correlation": np.triu(np.full((8, 8), 0.1) + 0.9 * np.eye(8)).tolist()},
         "symmetric"),
        ({"lever_arm_uncertainty": 0.1, "lever_arm_uncertainties": (0.1, 0.1, 0.1)},
         "both stated"),
    ],
)  # fmt: skip
def test_wrong_uncertainties_of_a_mounting_are_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        Mounting(**changes)


def test_the_command_writes_a_mounting_that_clouds_use(
    rocked, tmp_path, monkeypatch, capsys
):
    images, tracks, true = rocked
    monkeypatch.chdir(tmp_path)
    words = ["calibrate", "platform"]
    for number, (image, track) in enumerate(zip(images, tracks, strict=True)):
        io.write_cube(image, f"line-{number}.nc")
        write_trajectory(track, f"line-{number}.csv")
        words += [f"line-{number}.nc", "--trajectory", f"line-{number}.csv"]
    Path("rov.toml").write_text(mounting_text(LINES["stated_mounting"]()))
    assert main([*words, "--mounting", "rov.toml", "-o", "new.toml"]) == 0
    printed = capsys.readouterr().out
    assert "clock drift: not determined by these lines" in printed
    assert Path("new.png").read_bytes()[:4] == b"\x89PNG"
    offset = read_mounting("new.toml").clock_offset
    assert offset == pytest.approx(LINES["OFFSET"] + true[6], abs=1e-3)
    export = ["export", "line-0.nc", "--trajectory", "line-0.csv"]
    assert main([*export, "--mounting", "new.toml", "-o", "cloud.csv"]) == 0
    assert main(["calibrate", "platform", "line-0.nc", "-o", "other.toml"]) == 2
    assert "--trajectory is missing" in capsys.readouterr().err


def test_the_command_without_lines_prints_the_steps(capsys):
    assert main(["calibrate", "platform"]) == 0
    assert "opposite direction" in capsys.readouterr().out
