"""Moving lines of a site: beams, errors of poses, and their adjustment."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from amulor import io
from amulor.errors import CubeError, SurveyError
from amulor.imaging import moving_frame, point_cloud
from amulor.io.trajectories import read_trajectory, write_trajectory
from amulor.platform import Mounting, Trajectory, instrument_poses, read_mounting
from amulor.platform.mounting import mounting_text
from amulor.site import Site
from amulor.site.blocks import averaged, block_of, pixels_of_scan
from amulor.site.check import check
from amulor.site.load import range_image_of
from amulor.site.merging.cloud import merge
from amulor.site.registration.line import (
    _without_walk,
    by_direction,
    motion_of,
    rows_of_scan,
)
from amulor.site.registration.network import drift_effect
from amulor.site.registration.pair import compared
from amulor.site.registration.register import (
    refined_lines,
    register,
    surface_of,
    surfaces_of,
)

ROOT = Path(__file__).parents[3]
STUDY = runpy.run_path(str(ROOT / "benchmarks" / "measure_moving_sites.py"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two lines and a tripod scan over a rough bed."""
    return tmp_path_factory.mktemp("lines")


@pytest.fixture(scope="module")
def drawn(folder: Path):
    """Site, and true points by scan, for drawn errors."""
    return STUDY["make"](folder, 2, lines=STUDY["LINES"][:2], rows=70, columns=40)


@pytest.fixture(scope="module")
def adjusted(drawn):
    site, _ = drawn
    surfaces, images = surfaces_of(site)
    result = register(site, surfaces=surfaces, images=images)
    return result, surfaces, merge(site, result, surfaces, images)


def _errors(drawn, surface, scan: str, cloud):
    """Errors of the merged points of a scan [m], and their covariances."""
    site, true = drawn
    mine = cloud.scan == [item.name for item in site.scan].index(scan)
    row, column = np.divmod(cloud.pixel[mine], surface.distance.shape[1])
    row = rows_of_scan(surface.attributes, row)
    return cloud.position[mine] - true[scan][row, column], cloud.covariance[mine]


def test_beams_start_where_the_instrument_was(tmp_path: Path) -> None:
    """Without errors of ranges, mounting and navigation, points are exact."""
    site, true = STUDY["make"](
        tmp_path, 3, lines=STUDY["LINES"][:1], rows=40, columns=20, exact=True
    )
    scan = site.scan[0]
    surface = surface_of(site, scan, range_image_of(scan))
    rows = rows_of_scan(surface.attributes, np.arange(surface.distance.shape[0]))
    placed = surface.motion.start.place(surface.position)
    off = (placed - true[scan.name][rows])[surface.usable]
    # Poses are interpolated between messages of 50 ms: below a micrometer.
    assert np.abs(off).max() < 1e-6
    assert surface.usable.sum() > 0.8 * true[scan.name][..., 0].size


def test_rows_of_both_directions_are_separated(drawn) -> None:
    image = io.read_cube(drawn[0].scan[0].file)
    assert np.diff(image["time"].values, axis=1)[1, 0] < 0
    parts = by_direction(image)
    rows = parts.attrs["rows_of_scan"]
    assert list(rows[:35]) == list(range(0, 70, 2))
    assert list(rows[-35:]) == list(range(1, 70, 2))
    assert (parts["quality_flag"].values[rows < 0] == 1).all()
    assert np.isnan(parts["slant_range"].values[rows < 0]).all()
    assert block_of(parts, 2, 5) == (1, 5)
    # Beyond the rows of the scan there is no pixel.
    steps = np.diff(parts["time"].values[:35, 3])
    np.testing.assert_allclose(steps, steps[0])


def test_pixels_are_reported_by_the_rows_of_the_scan(drawn, adjusted) -> None:
    surface = adjusted[1]["line 1"]
    assert pixels_of_scan(surface, np.array([40 * 1 + 7])).tolist() == [40 * 2 + 7]


def test_a_line_one_way_needs_no_separation(drawn) -> None:
    image = io.read_cube(drawn[0].scan[0].file)
    one_way = image.isel(row=slice(0, None, 2))
    assert by_direction(one_way) is one_way


def test_a_drift_has_the_stated_change_along_the_line(drawn) -> None:
    """Half of the change from the first to the last row has the stated size."""
    site, _ = drawn
    scan = site.scan[0]
    line = scan.trajectory.model_copy(
        update={"position_drift": 2e-3, "attitude_drift": 1e-3}
    )
    image = range_image_of(scan)
    stated = scan.model_copy(update={"trajectory": line})
    motion = motion_of(site, stated, image)
    ends = np.array([np.nanargmin(motion.course), np.nanargmax(motion.course)])
    shift = motion.shifts(ends, np.zeros((2, 3)))
    at = [number for number, key in enumerate(motion.keys) if "of position" in key]
    change = np.linalg.norm(shift[at, 1] - shift[at, 0], axis=0)
    # 32 forms of a random walk have 99 % of its variance.
    np.testing.assert_allclose(change, 4e-3, rtol=0.03)
    turns = [number for number, key in enumerate(motion.keys) if "attitude" in key]
    first = motion.poses.vehicle.position[ends[0]]
    away = np.linalg.norm(motion.start.position - first)
    largest = np.linalg.norm(shift[turns, 1] - shift[turns, 0])
    # Two of three axes move a point, by 2 mrad times its distance from the vehicle.
    assert 0.5 * 2e-3 * away < largest < 2 * 2e-3 * away * np.sqrt(2)


def test_the_sum_of_the_shifts_is_that_of_each_error(drawn) -> None:
    site, _ = drawn
    motion = motion_of(site, site.scan[0], range_image_of(site.scan[0]))
    rng = np.random.default_rng(5)
    pixel = rng.choice(motion.course.size, 30, replace=False)
    points, factors = rng.normal(0, 2, (30, 3)), rng.normal(size=len(motion.keys))
    np.testing.assert_allclose(
        motion.shift(pixel, points, factors),
        np.tensordot(factors, motion.shifts(pixel, points), axes=1),
        rtol=1e-9, atol=1e-15,
    )  # fmt: skip


def test_lines_and_a_tripod_scan_are_adjusted_together(drawn, adjusted) -> None:
    result, surfaces, cloud = adjusted
    assert result.settled
    assert not result.contradictions
    for name in ("line 1", "line 2"):
        off, covariance = _errors(drawn, surfaces[name], name, cloud)
        start = surfaces[name].motion.start
        before = start.place(surfaces[name].position)[surfaces[name].usable]
        row, column = np.nonzero(surfaces[name].usable)
        row = rows_of_scan(surfaces[name].attributes, row)
        raw = before - drawn[1][name][row, column]
        # The navigation is off by a centimeter, the surfaces meet to some millimeters.
        assert np.sqrt((raw**2).sum(axis=1).mean()) > 8e-3
        assert np.sqrt((off**2).sum(axis=1).mean()) < 5e-3
        sigma = np.sqrt(np.einsum("nii->ni", covariance))
        assert np.median(sigma) < 4e-3
        # Errors of neighbors are common, so a whole line may be off by 3.5.
        assert np.median(np.abs(off / sigma)) < 2.0
        assert np.abs(off / sigma).max() < 6.0


def test_the_mounting_is_estimated_with_the_site(drawn, adjusted) -> None:
    result = adjusted[0]
    keys = [key for key in result.errors if key.endswith(": instrument, 2026")]
    assert "boresight down: instrument, 2026" in keys
    assert "clock offset: instrument, 2026" in keys
    for key in keys:
        assert abs(result.errors[key]) < 4
    spread = result.covariance_of("error boresight forward: instrument, 2026")
    assert spread[0, 0] < 0.5  # of the stated variance


@pytest.mark.slow
def test_a_mounting_that_is_wrong_by_far_more_than_stated_is_named(tmp_path) -> None:
    site, _ = STUDY["make"](tmp_path, 2, lines=STUDY["LINES"][:2], rows=70, columns=40)
    # 0.1 degrees are stated.
    path = tmp_path / "rov.toml"
    roll = STUDY["ANGLES"][2] + np.radians(1.0)
    path.write_text(
        mounting_text(read_mounting(path).model_copy(update={"roll": roll}))
    )
    surfaces, images = surfaces_of(site)
    result = register(site, surfaces=surfaces, images=images)
    named = {line.error.partition(":")[0] for line in result.contradictions}
    assert "boresight forward" in named


def test_blocks_of_pixels_have_the_mean_time(drawn) -> None:
    image = range_image_of(drawn[0].scan[0])
    coarse = averaged(image, 2)
    whole = image["reading_time"].values[0]
    mean = whole[:34, :].reshape(17, 2, 20, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse["reading_time"].values[0, :17], mean)


def test_a_site_with_lines_has_no_mistakes(drawn) -> None:
    assert check(drawn[0]).mistakes == ()


def _edited(folder: Path, old: str, new: str) -> Site:
    text = (folder / "site.toml").read_text().replace(old, new, 1)
    return Site.from_text(text, folder=folder)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('file = "line 1.csv"', 'file = "none.csv"', "no such file"),
        ('[scan.trajectory]', 'simulated_from = "rov.toml"\n[scan.trajectory]',
         "does not simulate lines"),
        ("[scan.start]", '[scan.trajectory]\nfile = "line 1.csv"\n[scan.start]',
         "has a trajectory and a start pose; remove"),
    ],
)  # fmt: skip
def test_a_line_that_contradicts_itself_is_refused(
    folder: Path, drawn, old: str, new: str, words: str
) -> None:
    with pytest.raises(SurveyError, match=words):
        _edited(folder, old, new)


def test_a_track_without_uncertainties_is_refused(folder: Path, drawn) -> None:
    track = read_trajectory(folder / "line 1.csv")
    bare = replace(track, covariance=np.full_like(track.covariance, np.nan))
    write_trajectory(bare, folder / "bare.csv", overwrite=True)
    site = _edited(folder, 'file = "line 1.csv"', 'file = "bare.csv"')
    (mistake,) = check(site).mistakes
    assert "'line 1'" in mistake
    assert "nobody states the uncertainty of the trajectory" in mistake


def test_a_track_in_another_reference_system_is_refused(folder: Path, drawn) -> None:
    track = replace(read_trajectory(folder / "line 1.csv"), crs="EPSG:32633")
    write_trajectory(track, folder / "other.csv", overwrite=True)
    site = _edited(folder, 'file = "line 1.csv"', 'file = "other.csv"')
    frame = site.frame.model_copy(update={"crs": "EPSG:32632"})
    site = site.model_copy(update={"frame": frame})
    with pytest.raises(CubeError, match="EPSG:32633, the site EPSG:32632"):
        motion_of(site, site.scan[0], range_image_of(site.scan[0]))


def test_the_offset_of_a_reference_system_is_applied(folder: Path, drawn) -> None:
    track = read_trajectory(folder / "line 1.csv")
    moved = replace(
        track, crs="EPSG:32632", crs_offset=(100.0, 0.0, 0.0),
        position=track.position - [90.0, 0.0, 0.0],
    )  # fmt: skip
    write_trajectory(moved, folder / "moved.csv", overwrite=True)
    site = _edited(folder, 'file = "line 1.csv"', 'file = "moved.csv"')
    frame = site.frame.model_copy(
        update={"crs": "EPSG:32632", "crs_offset": (10.0, 0.0, 0.0)}
    )
    site = site.model_copy(update={"frame": frame})
    scan = site.scan[0]
    image = range_image_of(scan)
    here = motion_of(site, scan, image).start.position
    plain = motion_of(drawn[0], drawn[0].scan[0], image).start.position
    np.testing.assert_allclose(here, plain, atol=1e-6)


def test_the_trajectory_is_corrected_within_its_uncertainty(
    drawn, adjusted, tmp_path: Path
) -> None:
    """A run without errors has the true poses at the same messages."""
    STUDY["make"](
        tmp_path, 2, lines=STUDY["LINES"][:2], rows=70, columns=40, exact=True
    )
    site, _ = drawn
    for name, track, mounting in refined_lines(site, adjusted[0]):
        stated = read_trajectory(site.scan[int(name[-1]) - 1].trajectory.file)
        true = read_trajectory(tmp_path / f"{name}.csv")
        at = np.searchsorted(stated.time, track.time)
        off = track.position - true.position[at]
        before = stated.position[at] - true.position[at]
        # The constant error and part of the drift are gone.
        assert (off**2).mean() < 0.5 * (before**2).mean()
        sigma = np.sqrt(np.einsum("nii->ni", track.covariance))
        assert np.abs(off / sigma[:, :3]).max() < 5
        assert np.median(np.abs(off / sigma[:, :3])) < 2
        assert sigma[:, :3].max() < 0.01
        assert mounting.lever_arm_uncertainties is not None
        # Stated: 0.1 degrees.
        assert mounting.boresight_uncertainties[2] < 0.7 * STUDY["SPREAD"][5]


def test_corrected_files_place_points_as_the_site_does(
    folder: Path, drawn, adjusted
) -> None:
    from amulor.cli.site import _write_lines

    site, _ = drawn
    result, _, cloud = adjusted
    _write_lines(refined_lines(site, result), folder / "lines", overwrite=True)
    image = range_image_of(site.scan[0])
    frame = moving_frame(
        image,
        trajectory=read_trajectory(folder / "lines" / "line 1.csv"),
        mounting=read_mounting(folder / "lines" / "line 1.toml"),
    )
    points = point_cloud(image, frame=frame)
    mine = cloud.scan == 0
    number = points["row"].values * 40 + points["column"].values
    place = dict(zip(number.tolist(), range(len(number)), strict=True))
    chosen = [place[pixel] for pixel in cloud.pixel[mine]]
    xyz = np.stack([points[axis].values for axis in "xyz"], axis=1)[chosen]
    # Shifts by centimeters and 0.1 degrees are linear within 0.1 mm.
    np.testing.assert_allclose(xyz, cloud.position[mine], atol=1.5e-4)


def test_forms_and_rest_of_a_drift_are_a_random_walk(drawn, adjusted) -> None:
    motion = adjusted[1]["line 1"].motion
    pixel = np.flatnonzero(np.isfinite(motion.course.ravel()))[::97]
    share = motion.course.ravel()[pixel]
    walks = motion._along(share)[1:]
    for size, walk, rest in zip(motion.drift, walks, motion.rests(pixel), strict=True):
        variance = (walk**2).sum(axis=0) + (rest**2).sum(axis=0)
        # A walk of variance s, less its mean: 1/3 - s (1 - s). 64 forms lack up to
        # 2 sum of 1 / (k pi)^2 beyond k = 64.
        true = size**2 * (1 / 3 - share * (1 - share))
        np.testing.assert_allclose(variance, true, rtol=0, atol=0.0033 * size**2)
    assert len(walks[0]) == motion.forms[0]


def test_velocities_lack_the_noise_of_the_drift() -> None:
    """Waves of 5 mm and 0.5 degrees, with walks of 2.8 mm and 0.016 degrees."""
    rng = np.random.default_rng(7)
    vehicle = STUDY["patch_lines"].Vehicle(
        rng, middle=(0.0, 0.0, -9.0), heading=0.3, speed=0.2, duration=8.0,
        wave=5e-3, rocking=np.radians([0.5, 0.5, 1.0]),
    )  # fmt: skip
    stamps = np.arange(-1.0, 9.0, 0.05)
    position, rotation = vehicle.at(stamps)
    walk = rng.normal(size=(len(stamps), 3)).cumsum(axis=0) * np.sqrt(0.05)
    track = Trajectory(
        time=stamps,
        position=position + 1e-3 * walk,
        attitude=Rotation.from_matrix(rotation).as_quat(),
        covariance=np.zeros((len(stamps), 6, 6)),
        longest_gap=1.0,
    )
    time = np.linspace(0.0, 8.0, 4000)
    poses = instrument_poses(track, Mounting(), time)
    drift = (1e-3 * np.sqrt(8.0), 1e-4 * np.sqrt(8.0))
    filtered = _without_walk(poses, np.arange(4000), drift).vehicle
    step = 1e-4
    true = (vehicle.at(time + step)[0] - vehicle.at(time - step)[0]) / (2 * step)
    before, after = (
        np.sqrt(((values - true) ** 2).mean())
        for values in (poses.vehicle.velocity, filtered.velocity)
    )
    # The walk has velocities of 1 mm / sqrt(0.05 s) = 4.5 mm/s at the poses.
    assert before > 3e-3
    assert after < 2.0e-3
    # Turn rates of 14 mrad/s are far above their noise.
    off = filtered.turn_rate - poses.vehicle.turn_rate
    assert np.sqrt((off**2).mean()) < 5e-4


def test_the_rest_of_a_drift_acts_as_if_it_were_an_unknown(drawn, adjusted) -> None:
    """Forms that are unknowns have derivatives, computed by moving the points."""
    result, surfaces, _ = adjusted
    rng = np.random.default_rng(3)
    for name, source, target in (
        ("line 1", "line 1", "tripod"),
        ("line 2", "tripod", "line 2"),
    ):
        pair = compared(
            surfaces[source], surfaces[target],
            (result.poses[source], result.poses[target]), gate=0.2, errors={},
        )  # fmt: skip
        assert pair is not None
        rows = rng.normal(size=(len(pair.distance), 2))
        motion = surfaces[name].motion
        # As if only the first two forms were unknowns.
        fewer = replace(motion, forms=(2, 2))
        effects = drift_effect(name, fewer, pair, rows).reshape(2, 3, -1, 2)
        for number, quantity in enumerate(("position", "attitude")):
            for axis, label in enumerate(("east", "north", "up")):
                key = f"drift 3 of {quantity} {label}: {name}"
                column = pair.by_target[:, 6 + pair.keys.index(key)]
                # Correcting an error moves the points against it.
                np.testing.assert_allclose(
                    -effects[number, axis, 0], column @ rows, rtol=1e-2,
                    atol=3e-3 * np.abs(column[:, None] * rows).sum(axis=0).max(),
                )  # fmt: skip
