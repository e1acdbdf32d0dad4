"""Centers of targets of exact shapes: place, covariance, shared errors, messages."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import CubeError
from amulor.site.description import (
    CheckerboardTarget,
    DiscTarget,
    PointTarget,
    SphereTarget,
)
from amulor.site.registration import centres
from amulor.site.registration.centres import centre_of
from amulor.site.registration.network import Centre
from amulor.site.registration.surface import ScanSurface, scan_surface, shared_errors

OWN, DELAY = 2e-4, 3e-3
ROWS, COLUMNS = 50, 60
AZIMUTH, ELEVATION, UNIT = scenes.directions(ROWS, COLUMNS, half=0.08)
#: Angle between neighboring columns and rows [rad].
STEP = 0.16 / (COLUMNS - 1), 2 * 0.08 * ROWS / COLUMNS / (ROWS - 1)
PLACES = [{"scan": "a", "row": 30, "column": 39}]


def _surface(
    distance: np.ndarray, *, bright: np.ndarray | None = None, own: float = OWN
) -> tuple[ScanSurface, xr.Dataset]:
    """Surface of a scan with an error by delay that all pixels share."""
    image = scenes.image_of(distance, AZIMUTH, ELEVATION, own=own, shared=DELAY)
    delay = xr.full_like(image["slant_range"], DELAY)
    image = image.assign(slant_range_uncertainty_delay=delay)
    if bright is not None:
        image = image.assign(intensity=image["intensity"].copy(data=bright))
    shared = shared_errors(image, scan="a", instrument="i", water="w")
    return scan_surface(image, name="a", shared=shared), image


def _found(
    target: Any, distance: np.ndarray, place: tuple[int, int], **options: Any
) -> tuple[Centre, np.ndarray]:
    surface, image = _surface(distance, **options)
    return centre_of(target, surface, image, *place)


def _pixel(point: np.ndarray) -> tuple[int, int]:
    """Pixel whose beam is nearest to a point."""
    away = UNIT @ (point / np.linalg.norm(point))
    row, column = np.unravel_index(int(np.argmax(away)), away.shape)
    return int(row), int(column)


BALL = np.array([0.02, -0.01, 1.2])


def _sphere(radius: float = 0.04, *, uncertainty: float = 0.0) -> SphereTarget:
    return SphereTarget.model_validate(
        {
            "kind": "sphere", "name": "S", "radius": radius,
            "radius_uncertainty": radius * uncertainty, "places": PLACES,
        }
    )  # fmt: skip


def _ball(radius: float = 0.04) -> np.ndarray:
    """Ranges of a ball in front of a wall."""
    along = UNIT @ BALL
    inside = along**2 - BALL @ BALL + radius**2
    near = along - np.sqrt(np.maximum(inside, 0.0))
    return np.where(inside > 0, near, 1.6 / UNIT[..., 2])


def test_a_ball_is_found_at_its_center_with_the_noise_of_its_pixels() -> None:
    centre, on = _found(_sphere(), _ball(), _pixel(BALL))
    assert (centre.target, centre.scan) == ("S", "a")
    assert_allclose(centre.position, BALL, atol=1e-8)
    # Beams up to 60 degrees from the normal.
    distance = _ball()[..., None] * UNIT - BALL
    facing = -np.sum(distance * UNIT, axis=-1) / 0.04
    assert_array_equal(on, (np.abs(np.linalg.norm(distance, axis=-1) - 0.04) < 1e-6)
                       & (facing > 0.5))  # fmt: skip
    gradient = distance[on] / np.sum(distance * UNIT, axis=-1)[on][:, None]
    expected = np.linalg.inv(gradient.T @ gradient) * OWN**2
    assert_allclose(centre.covariance, expected, rtol=1e-4)


@pytest.mark.parametrize("row_off", [-4, 5])
def test_a_ball_may_be_picked_off_its_middle(row_off: int) -> None:
    row, column = _pixel(BALL)
    centre, _ = _found(_sphere(), _ball(), (row + row_off, column - 4))
    assert_allclose(centre.position, BALL, atol=1e-7)


def test_a_longer_delay_and_a_larger_radius_move_a_ball_as_stated() -> None:
    place = _pixel(BALL)
    centre, _ = _found(_sphere(uncertainty=0.01), _ball(), place)
    assert set(centre.shared) == {"delay: i", "radius: S"}
    later, _ = _found(_sphere(), _ball() + DELAY, place)
    moved = later.position - centre.position
    assert_allclose(moved, centre.shared["delay: i"], atol=0.02 * DELAY)
    larger, _ = _found(_sphere(0.0404), _ball(), place)
    moved = larger.position - centre.position
    assert_allclose(moved, centre.shared["radius: S"], atol=2e-5)
    assert np.linalg.norm(moved) > 4e-4
    assert "radius: S" not in _found(_sphere(), _ball(), place)[0].shared


def test_scatter_beyond_the_noise_enlarges_the_covariance_of_a_ball() -> None:
    rng = np.random.default_rng(5)
    noise = 3 * OWN * rng.standard_normal((ROWS, COLUMNS))
    plain, on = _found(_sphere(), _ball(), _pixel(BALL))
    rough, _ = _found(_sphere(), _ball() + noise, _pixel(BALL))
    ratio = np.sqrt(np.diag(rough.covariance) / np.diag(plain.covariance))
    # Some 200 pixels: 5 % of the scatter.
    assert on.sum() > 150
    assert_allclose(ratio, 3.0, rtol=0.2)
    sigma = np.sqrt(np.diag(rough.covariance))
    assert (np.abs(rough.position - BALL) < 4 * sigma).all()
    # Twice the noise that is stated is no reason to state less.
    small = _found(_sphere(), _ball() + 0.1 * noise, _pixel(BALL))[0]
    assert_allclose(np.diag(small.covariance), np.diag(plain.covariance), rtol=0.03)


def test_handles_of_a_ball_are_left_out() -> None:
    ranges = _ball()
    row, column = _pixel(BALL)
    ranges[row - 2 : row + 1, column + 3 : column + 5] -= 0.004
    centre, on = _found(_sphere(), ranges, (row, column))
    assert not on[row - 2 : row + 1, column + 3 : column + 5].any()
    assert_allclose(centre.position, BALL, atol=1e-7)


def test_a_pixel_without_a_range_is_replaced_by_the_nearest_one() -> None:
    distance = 1.5 / UNIT[..., 2]
    distance[20:23, 30:33] = np.nan
    surface, _ = _surface(distance)
    point = centres._at(surface, (20, 31), "P")
    assert_allclose(point, surface.position[19, 31])
    point = centres._at(surface, (22, 32), "P")
    assert_allclose(point, surface.position[22, 33])
    assert_allclose(centres._at(surface, (0, 0), "P"), surface.position[0, 0])
    distance[15:28, 25:38] = np.nan
    surface, _ = _surface(distance)
    assert_allclose(centres._at(surface, (16, 30), "P")[2], 1.5)
    for place in ((18, 30), (20, 27), (25, 31), (20, 35)):
        with pytest.raises(CubeError) as caught:
            centres._at(surface, place, "P")
        assert str(caught.value) == (
            f"target 'P' in scan 'a': no pixel near {place} has a range; pick one on "
            "the target, for example with amulor view"
        )
    assert_allclose(centres._at(surface, (26, 30), "P")[2], 1.5)
    assert_allclose(centres._at(surface, (20, 36), "P")[2], 1.5)
    assert_allclose(centres._at(surface, (20, 26), "P")[2], 1.5)


def test_targets_of_few_pixels_are_one_line() -> None:
    with pytest.raises(CubeError) as caught:
        _found(_sphere(0.003), _ball(0.003), _pixel(BALL))
    words = str(caught.value)
    assert words.startswith("target 'S' in scan 'a': ")
    count = int(words.split(": ")[1].split()[0])
    assert 0 < count < 12
    assert words.endswith(
        f": {count} pixels lie on it, at least 12 are needed; scan it finer, or look "
        "at its place and size"
    )


#: A plane turned about both axes, m . p = 1, and a place on it.
NORMAL = np.array([0.3, -0.2, 0.9])
PLANE = NORMAL / 1.35
MIDDLE = np.array([0.01, 0.02, (1.35 - 0.3 * 0.01 + 0.2 * 0.02) / 0.9])


def _tilted() -> np.ndarray:
    return 1 / (UNIT @ PLANE)


def test_a_plane_is_fitted_with_its_covariance() -> None:
    surface, _ = _surface(_tilted())
    on, plane, covariance = centres._plane(surface, MIDDLE, 0.03, _sphere())
    assert_allclose(plane, PLANE, rtol=1e-9)
    away = np.linalg.norm(surface.position - MIDDLE, axis=-1)
    assert_array_equal(on, away < 0.03)
    # p . m scatters by the noise times the change of p . m with the range.
    point = surface.position[on]
    sigma = OWN * np.abs(UNIT[on] @ PLANE)
    rows = point / sigma[:, None]
    assert_allclose(covariance, np.linalg.inv(rows.T @ rows), rtol=1e-9)


def test_points_off_a_plane_do_not_move_it() -> None:
    ranges = _tilted()
    row, column = _pixel(MIDDLE)
    ranges[row - 1, column - 1 : column + 2] -= 0.01
    ranges[row + 2, column] += 5 * OWN
    surface, _ = _surface(ranges)
    on, plane, _ = centres._plane(surface, MIDDLE, 0.03, _sphere())
    assert_allclose(plane, PLANE, rtol=1e-9)
    assert not on[row - 1, column - 1 : column + 2].any()
    assert not on[row + 2, column]
    assert on[row, column]
    with pytest.raises(CubeError, match=r"target 'S' in scan 'a': \d pixels lie on it"):
        centres._plane(surface, MIDDLE, 0.004, _sphere())


def test_a_plane_keeps_points_within_four_standard_errors() -> None:
    rng = np.random.default_rng(8)
    noise = OWN * rng.standard_normal((ROWS, COLUMNS)).clip(-3, 3)
    row, column = _pixel(MIDDLE)
    noise[row + 1, column], noise[row, column + 2] = 3.7 * OWN, 4.6 * OWN
    surface, _ = _surface(_tilted() + noise)
    on, plane, covariance = centres._plane(surface, MIDDLE, 0.04, _sphere())
    near = np.linalg.norm(surface.position - MIDDLE, axis=-1) < 0.04
    left_out = np.argwhere(near & ~on).tolist()
    assert left_out == [[row, column + 2]]
    off = plane - PLANE
    # Three degrees of freedom.
    assert off @ np.linalg.solve(covariance, off) < 16


def test_noise_that_is_stated_too_large_keeps_no_point_off_a_plane() -> None:
    ranges = _tilted()
    row, column = _pixel(MIDDLE)
    ranges[row + 1, column] += 1e-3
    surface, _ = _surface(ranges, own=5e-3)
    on, plane, _ = centres._plane(surface, MIDDLE, 0.03, _sphere())
    assert not on[row + 1, column]
    assert_allclose(plane, PLANE, rtol=1e-9)


def test_noise_of_the_picked_pixel_does_not_move_a_target() -> None:
    place = _pixel(MIDDLE)
    ranges = _tilted()
    ranges[place] -= 3 * OWN
    moved, _ = _found(_board(0.1), ranges, place, bright=_fields(0.3))
    plain, _ = _found(_board(0.1), _tilted(), place, bright=_fields(0.3))
    assert_allclose(moved.position, plain.position, atol=2e-5)
    scene = _disc_scene(0.05)
    first, _ = _found(_disc(0.1), scene, place)
    scene[place] -= 2 * OWN
    second, _ = _found(_disc(0.1), scene, place)
    assert_allclose(first.position, second.position, atol=2e-6)


def _disc_scene(radius: float, *, behind: float = 0.3) -> np.ndarray:
    """Ranges of a disc on the tilted plane, before a wall."""
    plane = _tilted()
    away = np.linalg.norm(plane[..., None] * UNIT - MIDDLE, axis=-1)
    return np.where(away < radius, plane, (1.5 + behind) / UNIT[..., 2])


def _disc(diameter: float, *, uncertainty: float = 1e-3) -> DiscTarget:
    return DiscTarget.model_validate(
        {
            "kind": "disc", "name": "D", "diameter": diameter,
            "diameter_uncertainty": uncertainty, "places": PLACES,
        }
    )  # fmt: skip


def test_the_middle_of_a_disc_has_errors_across_by_its_rim_and_along_by_its_plane() -> (
    None
):
    ranges = _disc_scene(0.05)
    centre, on = _found(_disc(0.1), ranges, _pixel(MIDDLE))
    away = np.linalg.norm(_tilted()[..., None] * UNIT - MIDDLE, axis=-1)
    assert_array_equal(on, away < 0.05)
    unit = PLANE / np.linalg.norm(PLANE)
    assert PLANE @ centre.position == pytest.approx(1.0, abs=1e-9)
    pitch = np.sqrt(STEP[0] * STEP[1] * 1.5**2 / abs(unit[2]))
    assert np.linalg.norm(centre.position - MIDDLE) < pitch
    across = np.linalg.eigvalsh(centre.covariance)
    along = float(unit @ centre.covariance @ unit)
    # The inner 70 % of the diameter have the noise of a plane of n pixels.
    inner = int((away < 0.035).sum())
    assert along == pytest.approx((OWN * abs(unit[2])) ** 2 / inner, rel=0.1)
    rim = np.pi * 0.1 / pitch
    assert_allclose(across[1:], pitch**2 / 12 * 2 / rim, rtol=0.05)
    assert_allclose(centre.shared["delay: i"], DELAY * UNIT[on].mean(axis=0))
    later, _ = _found(_disc(0.1), ranges + DELAY, _pixel(MIDDLE))
    moved = later.position - centre.position
    assert moved @ unit == pytest.approx(DELAY * abs(unit[2]), rel=0.02)


def test_an_area_of_a_pixel_is_its_solid_angle_over_the_cosine() -> None:
    surface, _ = _surface(_tilted())
    unit = PLANE / np.linalg.norm(PLANE)
    area = centres._area(surface, unit)
    inner = (slice(1, -1), slice(1, -1))
    solid = STEP[0] * STEP[1] * np.cos(ELEVATION)
    expected = solid * _tilted() ** 2 / np.abs(UNIT @ unit)
    assert_allclose(area[inner], expected[inner], rtol=1e-3)


@pytest.mark.parametrize(
    ("stated", "uncertainty", "valid"),
    # Two pixels of 4 mm, and three standard uncertainties of the diameter.
    [
        (0.107, 1e-5, True), (0.111, 1e-5, False), (0.111, 2e-3, True),
        (0.093, 1e-5, True), (0.089, 1e-5, False), (0.089, 2e-3, True),
    ],
)  # fmt: skip
def test_a_disc_is_as_wide_as_stated(
    stated: float, uncertainty: float, valid: bool
) -> None:
    target = _disc(stated, uncertainty=uncertainty)
    ranges = _disc_scene(0.05)
    if valid:
        assert _found(target, ranges, _pixel(MIDDLE))[1].any()
        return
    with pytest.raises(CubeError) as caught:
        _found(target, ranges, _pixel(MIDDLE))
    words = str(caught.value)
    wide = int(words.split("looks ")[1].split()[0])
    assert wide == pytest.approx(100, abs=2)
    assert words == (
        f"target 'D' in scan 'a': the disc looks {wide} mm wide, stated are "
        f"{stated * 1e3:.0f} mm; look at its place, or at what stands right behind it"
    )


def test_another_piece_of_the_same_plane_is_no_part_of_a_disc() -> None:
    plane = _tilted()
    place = plane[..., None] * UNIT
    away = np.linalg.norm(place - MIDDLE, axis=-1)
    ring = (away > 0.058) & (away < 0.064) & (place[..., 0] > 0.05)
    ranges = np.where(ring, plane, _disc_scene(0.05))
    assert ring.sum() > 5
    _, on = _found(_disc(0.1), ranges, _pixel(MIDDLE))
    assert not on[ring].any()


def _board(width: float) -> CheckerboardTarget:
    return CheckerboardTarget.model_validate(
        {"kind": "checkerboard", "name": "C", "width": width, "places": PLACES}
    )


def _fields(turn: float) -> np.ndarray:
    """Brightness of four fields about the middle, with edges of 6 mm."""
    unit = NORMAL / np.linalg.norm(NORMAL)
    first = np.cross(unit, [np.sin(turn), np.cos(turn), 0.2])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(unit, first)])
    flat = (_tilted()[..., None] * UNIT - MIDDLE) @ axes.T
    edges = np.tanh(flat / 6e-3)
    return 0.01 + 0.004 * edges[..., 0] * edges[..., 1]


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.7])
def test_the_middle_of_a_checkerboard_is_where_its_edges_meet(turn: float) -> None:
    centre, on = _found(_board(0.1), _tilted(), _pixel(MIDDLE), bright=_fields(turn))
    assert_allclose(centre.position, MIDDLE, atol=2e-5)
    assert on.sum() > 300
    # Along the line of sight: the range of the plane, by the noise of its pixels.
    ahead = MIDDLE / np.linalg.norm(MIDDLE)
    along = float(ahead @ centre.covariance @ ahead)
    assert along == pytest.approx(OWN**2 / on.sum(), rel=0.2)
    assert_allclose(centre.shared["delay: i"], DELAY * ahead, rtol=1e-3)


def test_noise_of_the_brightness_moves_the_middle_of_a_board_as_stated() -> None:
    rng = np.random.default_rng(6)
    scores = []
    for _ in range(5):
        bright = _fields(0.3) + 4e-4 * rng.standard_normal((ROWS, COLUMNS))
        centre, _ = _found(_board(0.1), _tilted(), _pixel(MIDDLE), bright=bright)
        off = centre.position - MIDDLE
        scores.append(float(off @ np.linalg.solve(centre.covariance, off)))
    # The ranges are exact; two degrees of freedom: a mean of 2 to 0.9.
    assert np.mean(scores) == pytest.approx(2.0, abs=1.8)


def test_a_board_without_fields_is_one_line() -> None:
    rng = np.random.default_rng(7)
    even = 0.01 + 1e-3 * rng.standard_normal((ROWS, COLUMNS))
    with pytest.raises(CubeError) as caught:
        _found(_board(0.1), _tilted(), _pixel(MIDDLE), bright=even)
    assert str(caught.value) == (
        "target 'C' in scan 'a': no dark and bright fields are seen around the place; "
        "look at its intensity in amulor view"
    )


def _point(uncertainty: float = 2e-3) -> PointTarget:
    return PointTarget.model_validate(
        {
            "kind": "point", "name": "P", "picking_uncertainty": uncertainty,
            "places": PLACES,
        }
    )  # fmt: skip


def test_a_picked_point_is_unsure_across_the_beam_and_along_the_slope() -> None:
    place = (24, 29)
    centre, on = _found(_point(), _tilted(), place)
    assert_allclose(centre.position, _tilted()[place] * UNIT[place])
    assert np.argwhere(on).tolist() == [list(place)]
    ahead = UNIT[place]
    assert_allclose(centre.shared["delay: i"], DELAY * ahead)
    # The plane keeps a point wherever it is picked: its own noise is left.
    unit = NORMAL / np.linalg.norm(NORMAL)
    facing = abs(unit @ ahead)
    assert unit @ centre.covariance @ unit == pytest.approx(
        (OWN * facing) ** 2 + 1e-12, rel=1e-3
    )
    across = np.cross(unit, ahead)
    across /= np.linalg.norm(across)
    assert across @ centre.covariance @ across == pytest.approx(4e-6, rel=1e-3)
    other = np.cross(unit, across)
    size = other @ centre.covariance @ other
    # Up the slope the picking reaches farther, by the cosine.
    tangent = 1 / facing**2 - 1
    assert size == pytest.approx(
        4e-6 / facing**2 + OWN**2 * tangent * facing**2, rel=0.02
    )


def test_a_point_on_rough_ground_is_unsure_across_the_beam() -> None:
    ranges, place = _tilted(), (24, 29)
    ranges[18:31:2, 23:36] += 0.02
    surface, image = _surface(ranges)
    assert not surface.smooth[place]
    centre, _ = centre_of(_point(), surface, image, *place)
    ahead = UNIT[place]
    expected = 4e-6 * (np.eye(3) - np.outer(ahead, ahead))
    expected += OWN**2 * np.outer(ahead, ahead) + 1e-12 * np.eye(3)
    assert_allclose(centre.covariance, expected, rtol=1e-6, atol=1e-15)


def test_errors_of_a_moving_instrument_move_a_target_by_their_mean() -> None:
    pixels = np.zeros((2, 3), dtype=bool)
    pixels[0, 1] = pixels[1, 2] = True

    def moved(numbers: np.ndarray, points: np.ndarray) -> np.ndarray:
        assert_array_equal(numbers, [1, 5])
        assert_array_equal(points, np.tile([1.0, 2.0, 3.0], (2, 1)))
        return np.array([[[0.0, 0.1, 0.2], [0.2, 0.3, 0.0]]])

    shapes = np.arange(6.0).reshape(1, 2, 3)
    surface: Any = SimpleNamespace(
        name="a", motion=SimpleNamespace(keys=("pose 1: a",)), moved=moved,
        shared=SimpleNamespace(keys=("delay: i",), shapes=shapes),
    )  # fmt: skip
    gain = np.array([[1.0, 0.0], [0.0, 2.0], [0.5, 0.5]])
    centre = centres._centre(
        _point(), surface, np.array([1.0, 2.0, 3.0]), np.eye(3), gain, pixels,
        {"radius: P": np.ones(3)},
    )  # fmt: skip
    assert list(centre.shared) == ["delay: i", "pose 1: a", "radius: P"]
    assert_allclose(centre.shared["delay: i"], [1.0, 10.0, 3.0])
    assert_allclose(centre.shared["pose 1: a"], [0.1, 0.2, 0.1])
    assert_array_equal(centre.covariance, np.eye(3))
