"""Parts of the patch test: patches, derivatives, normal equations, random walks."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse
from scipy.spatial.transform import Rotation

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging import patch_test
from amulor.imaging.patch_test import (
    _axes,
    _cell_size,
    _Estimate,
    _Line,
    _Patches,
    _Points,
    _Rows,
    _terms,
)
from amulor.platform import Mounting, Trajectory

MODULE = sys.modules["amulor.imaging.patch_test"]


class _NoPoses:
    """Stands for the poses of points where none are used."""

    def part(self, index: np.ndarray) -> _NoPoses:
        return self


def _points(place: np.ndarray, line: np.ndarray, **changes: Any) -> _Points:
    """Points of lines that look straight down, with 1 mm of noise."""
    count = len(place)
    values: dict[str, Any] = {
        "line": np.asarray(line),
        "knot": np.zeros(count, dtype=np.intp),
        "share": np.zeros(count),
        "place": place,
        "beam": np.tile([0.0, 0.0, -1.0], (count, 1)),
        "sigma": np.full(count, 1e-3),
        "common": np.zeros(count),
        "poses": _NoPoses(),
    }
    return _Points(**{**values, **changes})


def _grid(cells: int, *, height: Any, per_side: int = 6) -> np.ndarray:
    """Points in the middles of cells of 1 m along x, of a surface of given height."""
    side = 0.1 + 0.8 * (np.arange(per_side) + 0.5) / per_side
    x, y = np.meshgrid(side, side)
    x = (x.ravel() + np.arange(cells)[:, None]).ravel()
    y = np.tile(y.ravel(), cells)
    return np.column_stack([x, y, height(x, y)])


def _cubic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the bed [m]."""
    return 0.1 + 0.05 * x + 0.05 * y + 0.02 * x * y - 0.01 * y**3


def _overlapping(cells: int = 8, shift: float = 0.0) -> _Points:
    """Two lines over the same cells, the second higher by a shift."""
    first = _grid(cells, height=_cubic)
    second = _grid(cells, height=lambda x, y: _cubic(x, y) + shift, per_side=5)
    line = np.repeat([0, 1], [len(first), len(second)])
    return _points(np.concatenate([first, second]), line)


def test_terms_of_a_patch_are_all_powers_up_to_the_third() -> None:
    terms, slopes = _terms(np.array([2.0]), np.array([3.0]))
    assert_array_equal(terms[0], [1, 3, 9, 27, 2, 6, 18, 4, 12, 8])
    assert_array_equal(slopes[0, 0], [0, 0, 0, 0, 1, 3, 9, 4, 12, 12])
    assert_array_equal(slopes[1, 0], [0, 1, 6, 27, 0, 2, 12, 0, 4, 0])


def test_axes_of_a_cell_end_with_the_normal_against_the_beams() -> None:
    x, y = (values.ravel() for values in np.meshgrid(np.arange(4.0), np.arange(3.0)))
    normal = np.array([0.6, 0.0, 0.8])
    tilted = np.outer(x, [0.8, 0.0, -0.6]) + np.outer(y, [0.0, 1.0, 0.0]) + 5.0
    thin = np.column_stack([x, 0.01 * y, 0 * x])
    ball = np.concatenate([np.eye(3), -np.eye(3)] * 2)
    place = np.concatenate([tilted, thin, ball])
    begin, cell = np.array([0, 12, 24]), np.repeat([0, 1, 2], 12)
    down = np.tile([0.0, 0.0, -1.0], (36, 1))
    center, axes, flat = _axes(_points(place, 0 * cell, beam=down), begin, cell)
    assert_allclose(center[0], tilted.mean(axis=0))
    assert_allclose(axes[0, 2], normal, atol=1e-9)
    assert_allclose(np.abs(axes[0, 0]), [0.8, 0.0, 0.6], atol=1e-9)
    assert_array_equal(flat, [True, False, False])
    _, turned, _ = _axes(_points(place, 0 * cell, beam=-down), begin, cell)
    assert_allclose(turned[0, 2], -normal, atol=1e-9)


@pytest.mark.parametrize(
    ("height", "width", "flat"),
    # Squares of the least and middle extents, over the next: 0.2 and 0.02.
    [(0.4, 1.0, True), (0.46, 1.0, False), (0.01, 0.15, True), (0.01, 0.135, False)],
)
def test_a_cell_is_flat_by_its_three_extents(
    height: float, width: float, flat: bool
) -> None:
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    place = corners * np.array([1.0, width, height * width])
    cell = np.zeros(8, dtype=np.intp)
    assert _axes(_points(place, cell), np.zeros(1, dtype=np.intp), cell)[2][0] == flat


def test_lines_over_one_surface_are_on_its_patches() -> None:
    patches = _Patches.of(_overlapping(), 1.0)
    assert len(patches.begin) == 8
    assert len(patches.cell) == 8 * (36 + 25)
    assert_array_equal(patches.begin, 61 * np.arange(8))
    assert_allclose(patches.residual, 0.0, atol=2e-6)
    assert_allclose(patches.noise, 1e-3)
    # The gradient of the height above the patch: upwards, and down the slope.
    x, y = patches.points.place[:, :2].T
    slope = np.column_stack(
        [-0.05 - 0.02 * y, -0.05 - 0.02 * x + 0.03 * y**2, 1 + 0 * x]
    )
    direction = patches.gradient / np.linalg.norm(patches.gradient, axis=1)[:, None]
    expected = slope / np.linalg.norm(slope, axis=1)[:, None]
    assert_allclose(direction, expected, atol=1e-4)
    assert_allclose(patches.along, -patches.gradient[:, 2], rtol=1e-6)
    center, apart = patches.apart()
    assert_allclose(np.sort(center[:, 0]), np.arange(8) + 0.5, atol=1e-9)
    assert_allclose(apart, 0.0, atol=1e-6)


def test_residuals_are_ranges_beyond_the_patch() -> None:
    """A flat bed, and one line deeper by 2 mm: seen from above it is farther away."""
    place = _grid(8, height=lambda x, y: 0.5 + 0 * x)
    points = _points(np.tile(place, (2, 1)), np.repeat([0, 1], len(place)))
    points.place[len(place) :, 2] -= 2e-3
    patches = _Patches.of(points, 1.0)
    second = patches.points.line == 1
    assert_allclose(patches.residual[second], 1e-3, rtol=1e-6)
    assert_allclose(patches.residual[~second], -1e-3, rtol=1e-6)
    assert_allclose(patches.apart()[1], 1e-3, rtol=1e-6)
    # Slanted beams meet the deeper bed farther along them.
    slanted = np.tile([0.6, 0.0, -0.8], (len(points.line), 1))
    patches = _Patches.of(replace(points, beam=slanted), 1.0)
    second = patches.points.line == 1
    assert_allclose(patches.residual[second], 1e-3 / 0.8, rtol=0.02)
    assert_allclose(patches.apart()[1], 1e-3, rtol=1e-6)


def test_the_noise_of_a_cell_with_a_misfit_is_its_scatter() -> None:
    """One cell of eight has noise of 20 mm, where 1 mm is stated."""
    points = _overlapping()
    rough = points.place[:, 0] < 1
    noise = np.random.default_rng(4).standard_normal(rough.sum())
    points.place[rough, 2] += 0.02 * noise
    patches = _Patches.of(points, 1.0)
    cell = patches.points.place[:, 0] < 1
    # 61 points less ten coefficients: to 10 %.
    assert_allclose(patches.noise[cell], 0.02, rtol=0.3)
    assert_allclose(patches.noise[~cell], 1e-3)


def test_points_far_from_the_surface_are_left_out() -> None:
    points = _overlapping()
    points.place[10, 2] += 0.05
    patches = _Patches.of(points, 1.0)
    assert len(patches.cell) == 8 * 61 - 1
    assert np.abs(patches.residual).max() < 1e-3
    # A beam along the surface does not measure it.
    points = _overlapping()
    points.beam[20] = [0.99, 0.0, -np.sqrt(1 - 0.99**2)]
    assert len(_Patches.of(points, 1.0).cell) == 8 * 61 - 1


def test_a_cell_needs_two_lines_with_enough_points() -> None:
    points = _overlapping(9)
    # In the last cell the second line has 5 points, which is one too few.
    last = (points.place[:, 0] > 8) & (points.line == 1)
    few = np.flatnonzero(~last | (np.cumsum(last) <= 5))
    assert len(_Patches.of(points.part(few), 1.0).begin) == 8
    enough = np.flatnonzero(~last | (np.cumsum(last) <= 6))
    patches = _Patches.of(points.part(enough), 1.0)
    assert len(patches.begin) == 9
    assert np.sum(patches.points.place[:, 0] > 8) == 42


def test_fewer_than_24_points_or_8_cells_are_no_overlap() -> None:
    points = _overlapping(9)
    last = points.place[:, 0] > 8
    order = np.where(points.line == 0, 0, 1) * last
    first, second = (np.cumsum(last & (points.line == n)) for n in (0, 1))
    assert order.max() == 1
    for total, count in ((23, 8), (24, 9)):
        keep = ~last | ((points.line == 0) & (first <= total - 8))
        keep |= (points.line == 1) & (second <= 8)
        assert len(_Patches.of(points.part(np.flatnonzero(keep)), 1.0).begin) == count
    with pytest.raises(CubeError) as caught:
        _Patches.of(_overlapping(7), 1.0)
    assert str(caught.value) == (
        "the lines overlap in 7 places; needed are at least 8. Check mounting and "
        "trajectories, or measure lines over the same place"
    )


def _rows(count: int = 40, unknowns: int = 9, cells: int = 2) -> _Rows:
    rng = np.random.default_rng(3)
    return _Rows(
        cell=np.repeat(np.arange(cells), count // cells),
        by_patch=rng.standard_normal((count, 10)),
        unknown=sparse.csr_matrix(rng.standard_normal((count, unknowns))),
        residual=rng.standard_normal(count),
    )


def test_patches_are_eliminated_from_the_normal_equations() -> None:
    rows = _rows()
    normal, right, scatter = rows.reduced()
    patch = np.zeros((40, 20))
    patch[:20, :10], patch[20:, 10:] = rows.by_patch[:20], rows.by_patch[20:]
    rest = np.eye(40) - patch @ np.linalg.pinv(patch)
    unknown = rows.unknown.toarray()
    assert_allclose(normal, unknown.T @ rest @ unknown, rtol=1e-6, atol=1e-6)
    assert_allclose(right, unknown.T @ rest @ rows.residual, rtol=1e-6, atol=1e-6)
    assert scatter == pytest.approx(rows.residual @ rest @ rows.residual, rel=1e-6)


def test_derivatives_of_ranges_are_by_quantity_and_by_knot() -> None:
    """Two points below the vehicle; the second half way from knot 3 to knot 4."""
    place = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.0]])
    points = _points(
        place, np.array([0, 1]), knot=np.array([0, 3]), share=np.array([0.0, 0.25]),
        common=np.array([2e-3, 4e-3]),
    )  # fmt: skip
    patches = _Patches(
        points=points,
        cell=np.array([0, 0]),
        begin=np.array([0]),
        center=np.zeros((1, 3)),
        rows=np.ones((2, 10)),
        gradient=np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0]]),
        along=np.array([-1.0, -0.8]),
        residual=np.array([3e-3, 5e-3]),
        noise=np.array([1e-3, 2e-3]),
    )
    derivatives = np.zeros((8, 2, 3))
    derivatives[2, :, 2], derivatives[5, :, 0] = 1.0, 2.0
    away = np.array([[0.0, 0.0, -4.0], [1.0, 0.0, -4.0]])
    size = 9 + 6 * 33 * 2
    rows = _Rows.of(patches, derivatives, away, points.line, size)
    assert_allclose(rows.residual, [3.0, 2.5])
    assert_array_equal(rows.by_patch, patches.rows)
    matrix = rows.unknown.toarray()
    assert matrix.shape == (2, size)
    # A shift by dz changes the range by dz g_z / -along.
    factor = np.array([[0.0, 0.0, 1.0], [0.5 / 0.8, 0.0, 1 / 0.8]])
    factor = factor / np.array([[1e-3], [2e-3]])
    expected = np.zeros((2, size))
    expected[:, 2], expected[:, 5] = factor[:, 2], 2 * factor[:, 0]
    expected[:, 8] = [-2.0, -2.0]
    turns = np.cross(away, factor)
    expected[0, 9:12], expected[0, 12:15] = factor[0], turns[0]
    begin = 9 + 6 * (33 + 3)
    pose = np.concatenate([factor[1], turns[1]])
    expected[1, begin : begin + 6] = 0.75 * pose
    expected[1, begin + 6 : begin + 12] = 0.25 * pose
    assert_allclose(matrix, expected, atol=1e-9)


def test_cells_hold_24_points_of_a_line() -> None:
    # 100 points per square meter, in two lines that do not share points.
    side = 0.1 * np.arange(60) + 0.05
    x, y = (values.ravel() for values in np.meshgrid(side, side))
    place = np.tile(np.column_stack([x, y, 0 * x + 0.01]), (2, 1))
    size = _cell_size(_points(place, np.repeat([0, 1], len(x))))
    assert size == pytest.approx(24**0.5 / 10, rel=0.15)
    dense = _cell_size(_points(place / 10, np.repeat([0, 1], len(x))))
    assert dense == pytest.approx(24**0.5 / 100, rel=0.15)


def _estimate(lines: int = 2, *, drift: bool = False) -> _Estimate:
    """Estimate without points, with knots of 1 s and 2 s."""
    estimate = _Estimate.__new__(_Estimate)
    estimate.lines = [SimpleNamespace()] * lines  # type: ignore[list-item]
    estimate.start = estimate.mounting = Mounting()
    estimate.prior = np.array([*[0.1] * 3, *[0.05] * 3, 0.2, 1e-5 if drift else 0.0])
    estimate.knots = np.arange(33.0) * np.arange(1.0, lines + 1)[:, None]
    estimate.shift = np.array([[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]])[:lines]
    estimate.errors = np.zeros(1 + 6 * estimate.knots.size)
    estimate.walks = np.array([2e-3, 1e-3])
    estimate.misfit = 1.0
    return estimate


def _walk(estimate: _Estimate, line: int, axis: int) -> np.ndarray:
    """Covariance of a random walk about a first value, at the knots of a line."""
    time = estimate.knots[line]
    walk = (2e-3 if axis < 3 else 1e-3) ** 2
    first = walk * time[-1] + (estimate.shift[line, axis] ** 2 if axis < 3 else 0.0)
    return first + walk * np.minimum(time[:, None], time)


def test_the_penalty_is_the_inverse_covariance_of_shifts_and_walks() -> None:
    estimate = _estimate()
    penalty = estimate._penalty(estimate.walks)
    head = penalty[:9, :9]
    assert_allclose(head, np.diag([100] * 3 + [400] * 3 + [25, 1, 1]), rtol=1e-9)
    assert (penalty[:9, 9:] == 0).all()
    total = 0.0
    for line in (0, 1):
        for axis in range(6):
            columns = 9 + 6 * 33 * line + axis + 6 * np.arange(33)
            block = penalty[np.ix_(columns, columns)]
            covariance = _walk(estimate, line, axis)
            assert_allclose(block @ covariance, np.eye(33), atol=1e-8)
            total -= np.linalg.slogdet(covariance)[1]
            others = np.setdiff1d(np.arange(len(penalty)), columns)
            assert (penalty[np.ix_(columns, others)] == 0).all()
    assert estimate._log_prior(estimate.walks) == pytest.approx(total, rel=1e-9)
    more = estimate._penalty(estimate.walks, repeated=0)
    assert len(more) == len(penalty) + 6 * 33
    again = 9 + 6 * 33
    assert_array_equal(more[-198:, -198:], penalty[9:again, 9:again])


def test_quantities_with_a_start_uncertainty_are_estimated() -> None:
    assert_array_equal(_estimate().free[:8], [True] * 7 + [False])
    assert _estimate(drift=True).free.all()
    estimate = _estimate(1)
    normal = np.diag(np.arange(1.0, 9 + 6 * 33 + 1))
    covariance = estimate._covariance(normal, np.eye(len(normal)))
    assert_allclose(np.diag(covariance), [*1 / np.arange(2.0, 9.0), 0.0])


def test_a_step_is_that_of_weighted_means_of_data_and_start() -> None:
    estimate = _estimate(1)
    size = 9 + 6 * 33
    normal = np.zeros((size, size))
    normal[0, 0], normal[4, 4], normal[6, 6], normal[8, 8] = 300.0, 400.0, 75.0, 1.0
    right = np.zeros(size)
    right[0], right[4], right[6], right[8] = 300 * 0.08, 400 * 0.02, 75 * 0.4, 3.0
    for _ in range(2):  # at the best estimate, the start pulls back as much
        estimate._step(normal, right)
        assert_allclose(estimate.mounting.lever_arm, [0.06, 0.0, 0.0], atol=1e-9)
        assert_allclose(estimate.mounting.boresight, [0.0, 0.01, 0.0], atol=1e-9)
        assert estimate.mounting.clock_offset == pytest.approx(0.3)
        assert estimate.mounting.clock_drift == 0.0
        assert estimate.errors[0] == pytest.approx(1.5)
        # What the data say about the rest of the way.
        right[0], right[4], right[6] = 300 * 0.02, 400 * 0.01, 75 * 0.1
        right[8] = 1.5
    away = estimate._to_start()
    assert_allclose(away[:9], [-0.06, 0, 0, 0, -0.01, 0, -0.3, 0, -1.5], atol=1e-9)


def test_the_way_to_the_start_is_in_the_axes_of_the_estimate() -> None:
    estimate = _estimate(1)
    now = Rotation.from_rotvec([0.3, -0.2, 0.5])
    turn = np.array([0.01, 0.02, -0.03])
    back = (now * Rotation.from_rotvec(turn)).as_rotvec()
    estimate.start = Mounting(boresight=tuple(back), lever_arm=(1.0, 2.0, 3.0))
    estimate.mounting = Mounting(
        boresight=tuple(now.as_rotvec()), lever_arm=(0.5, 2.5, 3.0), clock_drift=0.01
    )
    away = estimate._to_start()
    assert_allclose(away[:8], [0.5, -0.5, 0.0, *turn, 0.0, -0.01], atol=1e-9)


def test_walks_are_those_of_the_errors_that_the_data_show() -> None:
    """Errors of the trajectories that the data determine exactly."""
    estimate = _estimate()
    estimate.shift[:] = 0.02
    estimate.walks = np.array([1e-3, 1e-3])
    rng = np.random.default_rng(8)
    true = np.zeros((2, 33, 6))
    for line in (0, 1):
        step = np.sqrt(np.diff(estimate.knots[line]))[:, None]
        size = np.repeat([3e-3, 4e-4], 3)
        true[line, 1:] = np.cumsum(size * step * rng.standard_normal((32, 6)), axis=0)
        true[line] += size * np.sqrt(estimate.knots[line, -1]) * rng.standard_normal(6)
    size = 9 + true.size
    normal = np.zeros((size, size))
    normal[9:, 9:] = 1e10 * np.eye(true.size)
    right = normal @ np.concatenate([np.zeros(9), true.ravel()])
    estimate._fit_walks(normal, right)
    # 192 steps each: 5 % of the size of a step.
    assert_allclose(estimate.walks, [3e-3, 4e-4], rtol=0.15)


def _image(**errors: float) -> Any:
    image = scenes.plane((0, 0, 1), 1.5, **errors)
    rows, columns = image["slant_range"].shape
    time = 0.1 * np.arange(rows)[:, None] * np.ones((rows, columns))
    return image.assign_coords(
        time=(("row", "column"), time, {"units": "s", "long_name": "time of the pixel"})
    )


TRACK = Trajectory.of_angles(
    time=np.arange(0.0, 40.0), position=np.zeros((40, 3)), heading=0.0
)


def test_a_line_has_the_pixels_without_flags() -> None:
    image = _image(own=3e-4, shared=4e-4)
    image["quality_flag"].values[2, 3] = QualityFlag.NO_OPEN_WATER
    image["slant_range"].values[4, 5] = np.nan
    line = _Line.of(image, TRACK, 0)
    assert len(line.distance) == 598
    row, column = line.pixel
    assert (2, 3) not in set(zip(row.tolist(), column.tolist(), strict=True))
    assert_allclose(line.sigma, 3e-4)
    assert_allclose(line.common, 4e-4)
    place = line.begin + line.distance[:, None] * line.direction
    assert_allclose(place[:, 2], 1.5)
    assert_allclose(line.begin, 0.0, atol=1e-12)
    old = image.drop_vars("slant_range_common_uncertainty")
    line = _Line.of(old, TRACK, 0)
    assert_allclose(line.sigma, 5e-4)
    assert_array_equal(line.common, np.zeros(598))
    assert_allclose(_Line.of(_image(own=0.0, shared=1e-3), TRACK, 0).sigma, 1e-6)


def test_long_lines_are_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    for most, count in ((600, 600), (599, 300), (300, 300), (299, 200)):
        monkeypatch.setattr(MODULE, "_MOST", most)
        assert len(_Line.of(_image(), TRACK, 0).distance) == count


def test_lines_without_enough_points_are_one_line() -> None:
    image = _image()
    image["quality_flag"].values[:] = QualityFlag.NO_OPEN_WATER
    image["quality_flag"].values[0, :24] = 0
    assert len(_Line.of(image, TRACK, 0).distance) == 24
    image["quality_flag"].values[0, 23] = QualityFlag.NO_OPEN_WATER
    with pytest.raises(CubeError) as caught:
        _Line.of(image, TRACK, 4)
    assert str(caught.value) == (
        "line 5 has 23 points without a quality flag; leave it out, or measure it again"
    )
    for images, tracks in (([image], [TRACK]), ([image] * 3, [TRACK] * 2)):
        with pytest.raises(CubeError) as caught:
            patch_test(images, trajectories=tracks, mounting=Mounting())
        assert str(caught.value) == (
            f"{len(images)} lines and {len(tracks)} trajectories; needed are two or "
            "more lines that overlap, and one trajectory for all or one for each"
        )


def _placed() -> _Estimate:
    lines = [_Line.of(_image(own=3e-4, shared=4e-4), TRACK, k) for k in (0, 1)]
    return _Estimate(lines, Mounting(pitch="-90 deg"))


def test_points_of_an_estimate_are_those_of_the_cloud() -> None:
    estimate = _placed()
    assert_allclose(estimate.prior, [*[0.1] * 3, *[np.radians(3)] * 3, 0.2, 0.0])
    # A trajectory without an uncertainty may be wrong by a meter.
    assert_allclose(estimate.shift, 1.0)
    assert_allclose(estimate.knots, np.tile(np.linspace(0, 1.9, 33), (2, 1)))
    assert len(estimate.errors) == 1 + 6 * 66
    points = estimate.points()
    assert len(points.line) == 1200
    assert_array_equal(points.line, np.repeat([0, 1], 600))
    # Straight down from the vehicle in 0 m: 1.5 m below.
    assert_allclose(points.place[:, 2], -1.5, atol=1e-9)
    assert_allclose(points.sigma, 3e-4)
    assert_allclose(points.common, 4e-4)
    time = np.repeat(0.1 * np.arange(20), 30)
    knot = points.knot[:600] + points.share[:600]
    assert_allclose(knot, time / 1.9 * 32, atol=1e-9)
    assert points.knot.max() == 31
    assert_array_equal(points.share[[0, 599]], [0.0, 1.0])


def test_errors_of_ranges_and_trajectories_move_points() -> None:
    estimate = _placed()
    plain = estimate.points()
    estimate.misfit = 2.0
    estimate.errors[0] = 3.0
    shared = estimate.points()
    assert_allclose(shared.place, plain.place + 3 * 4e-4 * plain.beam, atol=1e-12)
    assert_allclose(shared.sigma, 6e-4)
    estimate.errors[0] = 0.0
    errors = estimate.errors[1:].reshape(2, 33, 6)
    errors[1, :, 0] = np.arange(33.0)
    moved = estimate.points()
    second = plain.line == 1
    knot = (plain.knot + plain.share) * second
    assert_allclose(moved.place[:, 0], plain.place[:, 0] + knot, atol=1e-9)
    assert_allclose(moved.beam, plain.beam)
    errors[:] = 0.0
    errors[0, :, 4] = 1e-3
    turned = estimate.points()
    spin = np.where(second, 0.0, 1e-3)[:, None] * np.array([0.0, 1.0, 0.0])
    assert_allclose(turned.place, plain.place + np.cross(spin, plain.place), atol=1e-12)
    assert_allclose(turned.beam, plain.beam + np.cross(spin, plain.beam), atol=1e-12)


def test_a_line_without_poses_is_one_line() -> None:
    late = replace(TRACK, time=TRACK.time + 1.0)
    lines = [_Line.of(_image(), TRACK, 0), _Line.of(_image(), late, 1)]
    estimate = _Estimate(lines, Mounting(pitch="-90 deg"))
    assert estimate.knots[1, 0] == pytest.approx(1.0)
    none = replace(TRACK, time=TRACK.time + 1.85)
    with pytest.raises(CubeError) as caught:
        _Estimate(
            [_Line.of(_image(), TRACK, 0),
             _thinned(_Line.of(_image(), none, 1), 23)],
            Mounting(pitch="-90 deg"),
        )  # fmt: skip
    assert str(caught.value) == (
        "line 2: its trajectory has no poses at the times of its pixels; check "
        "clock_offset and the order of the files"
    )


def _thinned(line: _Line, count: int) -> _Line:
    """The last points of a line."""
    cut = slice(-count, None)
    arrays = {
        name: getattr(line, name)[cut]
        for name in ("begin", "direction", "distance", "sigma", "common")
    }
    row, column = line.pixel
    return replace(line, pixel=(row[cut], column[cut]), **arrays)


def test_undetermined_quantities_state_the_line_that_helps_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    estimate = _estimate()
    sigma = np.array([0.051, 0.049, 0.09, 0.01, 0.01, 0.01, 0.19, 0.0])
    # What each additional line would leave of the lever arm, of which 0.7 helps.
    left = {
        "opposite": [0.05, 0, 0.08, 0, 0, 0, 0.19, 0],
        "across": [0.035, 0, 0.07, 0, 0, 0, 0.14, 0],
        "fast": [0.05, 0, 0.05, 0, 0, 0, 0.132, 0],
        "roll": [0.05, 0, 0.06, 0, 0, 0, 0.19, 0],
        "pitch": [0.05, 0, 0.08, 0, 0, 0, 0.19, 0],
    }

    def with_line(
        self: Any, patches: Any, rows: Any, number: int, kind: str
    ) -> np.ndarray:
        assert number == 1
        return np.diag(np.square(left[kind]))

    monkeypatch.setattr(_Estimate, "_with_line", with_line)
    patches = SimpleNamespace(points=SimpleNamespace(line=np.array([0, 1, 1])))
    found = estimate._undetermined(patches, None, np.diag(sigma**2), True)
    assert [
        (entry.quantity, entry.uncertainty, entry.start_uncertainty, entry.line,
         entry.with_line)
        for entry in found
    ] == [
        ("lever arm right", pytest.approx(0.051), 0.1, "a line across line 2",
         pytest.approx(0.035)),
        ("lever arm forward", pytest.approx(0.09), 0.1, "line 2 at twice the speed",
         pytest.approx(0.05)),
        ("clock offset", pytest.approx(0.19), 0.2, "line 2 at twice the speed",
         pytest.approx(0.132)),
    ]  # fmt: skip
    left["fast"][6] = 0.1331
    left["across"][6] = 0.1331
    none = estimate._undetermined(patches, None, np.diag(sigma**2), True)[2]
    assert (none.line, none.with_line) == ("", pytest.approx(0.19))
    silent = estimate._undetermined(patches, None, np.diag(sigma**2), False)
    assert [entry.line for entry in silent] == ["", "", ""]
    assert [entry.with_line for entry in silent] == pytest.approx([0.051, 0.09, 0.19])
    sure = np.diag((0.5 * estimate.prior) ** 2)
    assert estimate._undetermined(patches, None, sure, True) == ()
