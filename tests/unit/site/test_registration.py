"""Poses from surfaces and targets: errors that hold, and weak geometry that is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation
from site_scenes import make_site, scanning, shapes

from amulor.errors import CubeError
from amulor.imaging import correlation, flag_mixed, flag_outliers
from amulor.imaging.common import own_variance
from amulor.site import Site
from amulor.site.description import SphereTarget
from amulor.site.registration.align import Alignment, align
from amulor.site.registration.centres import centre_of
from amulor.site.registration.network import Centre, KnownPose, Ties
from amulor.site.registration.pair import Pair, _bend, compared, on_grid
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.register import register
from amulor.site.registration.surface import ScanSurface, scan_surface, shared_errors

PLACES = {"a": (-1.2, -1.2, 1.6), "b": (1.3, -1.0, 1.7), "c": (0.2, 1.5, 1.8)}
ERRORS = scanning.Errors(own=1e-3, delay=2e-3, index=5e-4, reference=1e-3)


def surface(image: xr.Dataset, name: str) -> ScanSurface:
    shared = shared_errors(image, scan=name, instrument="i", water="w")
    return scan_surface(image, name=name, shared=shared)


class Scene:
    """Three scans of a mesh from known places."""

    def __init__(self, kind: str, rows: int) -> None:
        mesh = {
            "relief": lambda: shapes.sea_bed(relief=0.04),
            "humps": lambda: shapes.sea_bed(relief=0.15),
            "flat": lambda: shapes.sea_bed(relief=0.0),
            "wreck": lambda: make_site.scene(moved=False),
        }[kind]()
        self.beams = scanning.grid(rows, rows * 4 // 3, 0.35)
        self.poses = {
            name: ScanPose(*scanning.looking(place, (0.0, 0.05, 0.1)))
            for name, place in PLACES.items()
        }
        self.true = {
            name: scanning.ranges(mesh, pose.rotation, pose.position, self.beams[2])
            for name, pose in self.poses.items()
        }

    def scans(
        self, rng: np.random.Generator, *, names: str = "abc"
    ) -> dict[str, ScanSurface]:
        draw = scanning.Draw(rng)
        found = {}
        for name in names:
            image = scanning.image(
                self.true[name], *self.beams[:2], errors=ERRORS, draw=draw, scan=name
            )
            found[name] = surface(flag_outliers(flag_mixed(image)), name)
        return found

    def starts(self, rng: np.random.Generator) -> dict[str, KnownPose]:
        """Return start poses off by 3 cm and 10 mrad; the first scan is known."""
        spread = np.diag([0.03**2] * 3 + [0.01**2] * 3)
        found = {"a": KnownPose(pose=self.poses["a"], covariance=1e-12 * np.eye(6))}
        for name in "bc":
            off = rng.normal(size=6) * np.sqrt(np.diag(spread))
            found[name] = KnownPose(
                pose=self.poses[name].changed(off), covariance=spread
            )
        return found

    def pulls(self, found: Alignment) -> np.ndarray:
        """Return errors of the poses over the uncertainties stated."""
        pulls = []
        for name in "bc":
            pose, true = found.state.poses[name], self.poses[name]
            turn = Rotation.from_matrix(pose.rotation @ true.rotation.T).as_rotvec()
            off = np.concatenate([pose.position - true.position, turn])
            at = found.layout.at["pose", name]
            pulls.append(off / np.sqrt(np.diag(found.covariance[at, at])))
        return np.concatenate(pulls)


@pytest.fixture(scope="module")
def relief() -> Scene:
    return Scene("relief", 48)


def test_shapes_of_shared_errors_are_the_covariance_of_the_image(
    relief: Scene,
) -> None:
    image = scanning.image(
        relief.true["a"], *relief.beams[:2], errors=ERRORS, draw=None, scan="a"
    )
    shared = shared_errors(image, scan="a", instrument="i", water="w")
    region = np.zeros(relief.true["a"].shape, dtype=bool)
    region[10:14, ::6] = np.isfinite(relief.true["a"][10:14, ::6])
    expected = correlation.covariance(image, region)
    expected -= np.diag(own_variance(image)[region])
    flat = shared.shapes[:, region]
    np.testing.assert_allclose(flat.T @ flat, expected, atol=1e-7 * expected.max())
    # Their growth with the range, against a range that is a millimetre longer.
    longer = image.assign(slant_range=image["slant_range"] + 1e-3)
    name = "slant_range_uncertainty_group_index"
    longer = longer.assign({name: ERRORS.index * longer["slant_range"]})
    other = shared_errors(longer, scan="a", instrument="i", water="w")
    at = shared.keys.index("group_index: w")
    step = (other.shapes[at] - shared.shapes[at])[region]
    np.testing.assert_allclose(step, 1e-3 * shared.growth[at][region], rtol=1e-6)


def test_scans_are_aligned_within_what_is_stated(relief: Scene) -> None:
    rng = np.random.default_rng(3)
    found = align(relief.scans(rng), Ties(start=relief.starts(rng)))
    assert found.settled
    assert found.disagreements == ()
    pulls = relief.pulls(found)
    # Of twelve normal numbers one exceeds 4 in 1300 draws.
    assert np.abs(pulls).max() < 4
    # Far better than the start poses, which were off by centimetres.
    at = found.layout.at["pose", "b"]
    assert np.sqrt(found.covariance[at, at].diagonal()[:3]).max() < 8e-3
    # A common scale cannot be seen from inside: the prior is all that is known of it.
    scale = found.layout.at["error", "group_index: w"]
    assert found.covariance[scale, scale].item() == pytest.approx(1, abs=0.05)
    assert abs(found.state.errors["group_index: w"]) < 0.5


def test_a_flat_sea_bed_holds_height_and_tilt_only() -> None:
    scene = Scene("flat", 48)
    scans = scene.scans(np.random.default_rng(1), names="ab")
    pair = compared(
        scans["b"], scans["a"], (scene.poses["b"], scene.poses["a"]),
        gate=None, errors={},
    )  # fmt: skip
    assert pair is not None
    assert len(pair.loose) == 3
    loose = np.array(pair.loose)
    # East, north, and the turn about the vertical; none has a part upwards.
    assert np.abs(loose[:, 2]).max() < 0.05
    rank = np.linalg.matrix_rank(pair.held, tol=1e-6)
    assert rank == 3
    # Noise in normals by itself would pretend to hold it sideways.
    x = pair.by_target[:, :2]
    pretended = np.linalg.inv(x.T @ (pair.weight[:, None] * x))
    assert np.sqrt(pretended.diagonal()).max() < 0.05


def test_a_scan_that_nothing_tells_about_is_named(relief: Scene) -> None:
    scans = relief.scans(np.random.default_rng(2), names="ab")
    with pytest.raises(CubeError, match="scan 'b': nothing tells about where it stood"):
        align(scans, Ties(start={}, fixed="a"))


def test_the_centre_of_a_sphere_has_the_error_that_is_stated() -> None:
    rng = np.random.default_rng(8)
    azimuth, elevation, unit = scanning.grid(40, 52, 0.06)
    centre, radius = np.array([0.02, -0.03, 2.1]), 0.06
    along = unit @ centre
    inside = along**2 - centre @ centre + radius**2
    ball = along - np.sqrt(np.where(inside > 0, inside, np.nan))
    true = np.where(np.isfinite(ball), ball, 2.6)
    target = SphereTarget.model_validate(
        {
            "kind": "sphere", "name": "S", "radius": radius,
            "radius_uncertainty": 0.0,
            "places": [{"scan": "a", "row": 17, "column": 29}],
        }
    )  # fmt: skip
    pulls = []
    for _ in range(30):
        draw = scanning.Draw(rng)
        image = scanning.image(
            true, azimuth, elevation, errors=ERRORS, draw=draw, scan="a"
        )
        found, pixels = centre_of(target, surface(image, "a"), image, 17, 29)
        assert 300 < pixels.sum() < 1200
        spread = found.covariance + sum(
            np.outer(shift, shift) for shift in found.shared.values()
        )
        off = found.position - centre
        pulls.append(off @ np.linalg.solve(spread, off))
    # Chi-square of 3 degrees of freedom: the mean of 30 is 3 +- 0.45.
    assert abs(np.mean(pulls) - 3) < 4 * np.sqrt(6 / 30)


def wide(seed: int, *, noise: float) -> tuple[dict[str, ScanSurface], Ties, ScanPose]:
    """Return two scans 40 degrees wide of humps, far pixels grazing, hardly noisy."""
    rng = np.random.default_rng(seed)
    azimuth, elevation, unit = scanning.grid(48, 64, 0.35)
    mesh = shapes.sea_bed(relief=0.15)
    poses, scans, start = {}, {}, {}
    small = scanning.Errors(own=1e-4, delay=1e-7, index=1e-7, reference=2e-4)
    for name in "ab":
        poses[name] = ScanPose(*scanning.looking(PLACES[name], (0.0, 0.05, 0.1)))
        true = scanning.ranges(mesh, poses[name].rotation, poses[name].position, unit)
        image = scanning.image(
            true, azimuth, elevation, errors=small, draw=None, scan=name
        )
        seen = image["slant_range"] + noise * small.own * rng.normal(size=true.shape)
        scans[name] = surface(image.assign(slant_range=seen), name)
        spread = 1e-12 if name == "a" else 1e-4
        start[name] = KnownPose(pose=poses[name], covariance=spread * np.eye(6))
    return scans, Ties(start=start), poses["b"]


def test_patches_follow_bends_that_stand_out_of_the_noise() -> None:
    scans, ties, true = wide(1, noise=0.0)
    found = align(scans, ties)
    pose, at = found.state.poses["b"], found.layout.at["pose", "b"]
    turn = Rotation.from_matrix(pose.rotation @ true.rotation.T).as_rotvec()
    off = np.concatenate([pose.position - true.position, turn])
    # Without noise nothing is left but what patches do not follow: chi-square of six is
    # small, and no shared error is invented to explain it. Patches of second degree
    # have hundreds.
    assert off @ np.linalg.solve(found.covariance[at, at], off) < 1
    assert max(abs(value) for value in found.state.errors.values()) < 0.5


def inside(pulls: np.ndarray, draws: int) -> None:
    """Assert coverage of 68 and 95 of 100 within what the number of draws allows."""
    for limit, share in ((1.0, 0.6827), (1.96, 0.95)):
        each = (np.abs(pulls) < limit).reshape(draws, -1).mean(axis=1)
        error = np.sqrt(share * (1 - share) / (4 * draws))
        error = max(error, float(each.std()) / np.sqrt(draws))
        assert abs(float(each.mean()) - share) < max(4 * error, 0.02), (
            limit,
            each.mean(),
        )


def loop(slip: float) -> Alignment:
    """Return three scans that meet in three places; one slipped between two of them."""
    scene, rng = Scene("humps", 64), np.random.default_rng(13)
    moved = scene.poses["c"].position + slip * np.array([0.7, -0.5, 0.5])
    mesh, turn = shapes.sea_bed(relief=0.15), scene.poses["c"].rotation
    slipped = scanning.ranges(mesh, turn, moved, scene.beams[2])
    for name, (left, right, top) in {"a": "101", "b": "011", "c": "110"}.items():
        pose, unit = scene.poses[name], scene.beams[2]
        east, north = np.moveaxis(
            pose.place(scene.true[name][..., None] * unit), -1, 0
        )[:2]
        parts = [north < 0.05, east < 0, left == "1", right == "1", top == "1"]
        seen = np.where(parts[0], np.where(parts[1], parts[2], parts[3]), parts[4])
        if name == "c":
            scene.true[name] = np.where(east < 0, scene.true[name], slipped)
        scene.true[name] = np.where(seen, scene.true[name], np.nan)
    start = scene.starts(rng)
    return align(scene.scans(rng), Ties(start=start), overlap=0.05)


@pytest.mark.slow
def test_a_loop_that_does_not_close_counts_less() -> None:
    found = loop(0.0)
    assert len(found.pairs) == 3
    assert found.disagreements == ()
    broken = loop(0.03)
    assert len(broken.pairs) == 3
    assert broken.disagreements
    for one in broken.disagreements:
        assert one.trust < 0.9
        assert one.score > 4
    # What is trusted less is known less.
    for name in "bc":
        at = found.layout.at["pose", name]
        sizes = [np.trace(each.covariance[at, at][:3, :3]) for each in (found, broken)]
        assert sizes[1] > sizes[0]


def test_a_flat_sea_bed_is_reported_as_holding_no_scan_sideways(
    tmp_path: Path,
) -> None:
    scene = Scene("flat", 48)
    rng = np.random.default_rng(14)
    scans = scene.scans(rng, names="ab")
    text = 'name = "Flat"\n[[epoch]]\nname = "now"\n'
    for name in "ab":
        (tmp_path / f"{name}.nc").touch()
        forward = scene.poses[name].rotation[:, 2]
        place = ", ".join(f'"{value:.4f} m"' for value in PLACES[name])
        text += f"""
[[scan]]
name = "{name}"
file = "{name}.nc"
epoch = "now"
[scan.start]
position = [{place}]
heading = "{np.degrees(np.arctan2(forward[0], forward[1])):.4f} deg"
pitch = "{np.degrees(np.arcsin(forward[2])):.4f} deg"
position_uncertainty = "2 cm"
heading_uncertainty = "10 mrad"
level_uncertainty = "10 mrad"
"""
    found = register(
        Site.from_text(text, folder=tmp_path),
        surfaces=scans,
        images={},
    )
    # East, north and the turn about the vertical of each.
    assert sorted(one.scan for one in found.weaknesses) == ["a"] * 3 + ["b"] * 3
    along = np.array([one.shift for one in found.weaknesses])
    # Sideways by as much as the start poses say, not in height.
    assert np.abs(along[:, 2]).max() < 0.1 * np.abs(along[:, :2]).max()


@pytest.mark.slow
def test_the_covariance_holds(relief: Scene) -> None:
    rng = np.random.default_rng(11)
    draws = 10
    pulls = [
        relief.pulls(align(relief.scans(rng), Ties(start=relief.starts(rng))))
        for _ in range(draws)
    ]
    inside(np.array(pulls), draws)


@pytest.mark.study
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("kind", ["relief", "humps", "wreck"])
def test_the_covariance_holds_over_200_draws(kind: str) -> None:
    rng = np.random.default_rng(5)
    scene = Scene(kind, 72)
    pulls = np.array(
        [
            scene.pulls(align(scene.scans(rng), Ties(start=scene.starts(rng))))
            for _ in range(200)
        ]
    )
    inside(pulls, 200)


def test_directions_between_pixels_are_bent_to_second_order() -> None:
    # Exact for a surface of second degree in row and column, also at the rim.
    row, column = np.meshgrid(np.arange(5.0), np.arange(7.0), indexing="ij")
    rng = np.random.default_rng(6)
    first, square, other, mixed = rng.standard_normal((4, 3))

    def direction(r: np.ndarray, c: np.ndarray) -> np.ndarray:
        r, c = r[..., None], c[..., None]
        return first * r + square * r**2 + other * c**2 + mixed * r * c

    grid = direction(row, column).reshape(-1, 3)
    pixel = np.array([8, 17, 26])
    off = rng.uniform(-0.6, 0.6, (3, 2))
    expected = (
        square * off[:, :1] ** 2
        + other * off[:, 1:] ** 2
        + mixed * off[:, :1] * off[:, 1:]
    )
    np.testing.assert_allclose(_bend(grid, (5, 7), pixel, off), expected, rtol=1e-9)
    # A corner has the bend of its neighbor.
    corner = _bend(grid, (5, 7), np.array([0, 34]), off[:2])
    np.testing.assert_allclose(corner, expected[:2], rtol=1e-9)


@pytest.mark.parametrize("off", [(0, 0), (5, -4), (-7, 8), (3, 0), (0, -6)])
def test_a_point_is_found_on_the_grid_from_a_pixel_beside_it(
    off: tuple[int, int],
) -> None:
    azimuth, elevation, unit = scanning.grid(30, 40, 0.2)
    normal = np.array([0.2, -0.1, 1.0])
    exact = 2.0 / (unit @ normal)
    wall = scanning.image(
        exact, azimuth, elevation, errors=ERRORS, draw=None, scan="a",
        instrument="i", water="w",
    )  # fmt: skip
    scan = surface(wall, "a")
    row, column = 14, 20
    begin = (row + off[0]) * 40 + column + off[1]
    point = (exact[row, column] * unit[row, column])[None]
    found = on_grid(scan, point, np.array([begin]))
    assert found.pixel[0] == row * 40 + column
    np.testing.assert_allclose(found.off[0], 0.0, atol=1e-3)
    np.testing.assert_allclose(found.distance[0], 0.0, atol=1e-9)


def test_distances_of_two_scans_change_as_their_derivatives_say() -> None:
    # A ball 1 m wide, seen from two places without noise.
    middle, radius = np.array([0.1, -0.1, 2.6]), 0.5
    azimuth, elevation, unit = scanning.grid(40, 40, 0.09)
    true = [
        ScanPose(np.eye(3), np.zeros(3)),
        ScanPose(
            Rotation.from_rotvec([0.01, 0.03, -0.05]).as_matrix(),
            np.array([-0.1, 0.05, 0.05]),
        ),
    ]
    scans = []
    for name, pose in zip("ab", true, strict=True):
        ahead = pose.turn(unit)
        along = ahead @ (middle - pose.position)
        apart = np.sum((middle - pose.position) ** 2)
        exact = along - np.sqrt(along**2 - apart + radius**2)
        image = scanning.image(
            exact, azimuth, elevation, errors=ERRORS, draw=None, scan=name,
            instrument="i", water="w",
        )  # fmt: skip
        scans.append(surface(image, name))

    def pair(first: ScanPose) -> Pair:
        poses = first, true[1]
        found = compared(scans[0], scans[1], poses, gate=0.1, errors={})
        assert found is not None
        return found

    before = pair(true[0])
    # Pixels are 4.6 mrad or 11 mm apart. A patch of seven is bent to second order.
    assert np.abs(before.distance).max() < 1e-4
    for part in range(6):
        step = np.zeros(6)
        step[part] = 2e-5
        after = pair(true[0].changed(step))
        _, here, there = np.intersect1d(
            before.source_pixel, after.source_pixel, return_indices=True
        )
        assert len(here) > 300
        change = after.distance[there] - before.distance[here]
        # The pose turns about its position, the derivatives about the pivot.
        moved = step.copy()
        moved[:3] += np.cross(step[3:], before.pivot - true[0].position)
        expected = before.by_target[here, :6] @ moved
        # The patches of a curve lean by some percent.
        np.testing.assert_allclose(change, expected, rtol=0.03, atol=1e-6)


class Ball:
    """A ball in front of a wall on a fine grid of beams, without noise."""

    centre, radius = np.array([0.02, -0.03, 2.1]), 0.06

    def __init__(self, errors: scanning.Errors) -> None:
        self.errors = errors
        self.azimuth, self.elevation, self.unit = scanning.grid(40, 52, 0.06)
        along = self.unit @ self.centre
        inside = along**2 - self.centre @ self.centre + self.radius**2
        ball = along - np.sqrt(np.where(inside > 0, inside, np.nan))
        self.met = np.isfinite(ball)
        self.range = np.where(self.met, ball, 2.6)
        outward = self.range[..., None] * self.unit - self.centre
        self.normal = outward / np.linalg.norm(outward, axis=-1, keepdims=True)
        self.facing = -np.sum(self.normal * self.unit, axis=-1)

    def found(
        self, ranges: np.ndarray, *, radius: float | None = None
    ) -> tuple[Centre, np.ndarray, ScanSurface]:
        """Return the center, the pixels on the ball and the scan."""
        image = scanning.image(
            ranges, self.azimuth, self.elevation, errors=self.errors, draw=None,
            scan="a",
        )  # fmt: skip
        scan = surface(image, "a")
        target = SphereTarget.model_validate(
            {
                "kind": "sphere", "name": "S", "radius": radius or self.radius,
                "radius_uncertainty": 2e-4,
                "places": [{"scan": "a", "row": 17, "column": 29}],
            }
        )  # fmt: skip
        centre, pixels = centre_of(target, scan, image, 17, 29)
        return centre, pixels, scan


def test_the_centre_of_an_exact_sphere_is_exact_with_the_error_of_least_squares() -> (
    None
):
    ball = Ball(ERRORS)
    centre, pixels, scan = ball.found(ball.range)
    np.testing.assert_allclose(centre.position, ball.centre, rtol=0, atol=1e-7)
    # Up to an angle of incidence of 60 degrees.
    np.testing.assert_array_equal(pixels, ball.met & (ball.facing > 0.5))
    # A beam is longer by n / (n . d) of a shift of the ball.
    rows = (ball.normal / -ball.facing[..., None] / scan.own[..., None])[pixels]
    np.testing.assert_allclose(
        centre.covariance, np.linalg.inv(rows.T @ rows), rtol=1e-4
    )


def test_a_wrong_radius_shifts_the_centre_of_a_sphere_along_the_beam() -> None:
    ball = Ball(ERRORS)
    step = 1e-5
    near, far = (
        ball.found(ball.range, radius=ball.radius + sign * step)[0].position
        for sign in (-1, 1)
    )
    centre, *_ = ball.found(ball.range)
    expected = (far - near) / (2 * step) * 2e-4
    assert expected[2] > 2e-4
    np.testing.assert_allclose(centre.shared["radius: S"], expected, rtol=5e-3)
