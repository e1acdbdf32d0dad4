"""Parts of the error by light of corners, against formulas on paper."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

from amulor import Survey, rejection
from amulor.cube.tiles import Span
from amulor.imaging import corners
from amulor.imaging.corners import Patches, corner_error, corner_ratio, echo_over_white
from amulor.imaging.observation import Observation, observe
from amulor.simulation import simulate
from amulor.studies.trust.surveys import corner, survey
from amulor.survey import water_properties
from amulor.survey.view import angle_of_view

#: A point 2 m ahead, a patch 1 m to its right; the receiver is in the origin.
POINT, PATCH = np.array([0.0, 0.0, 2.0]), np.array([1.0, 0.0, 2.0])
AREA, BRIGHTNESS = 0.3, 0.4


def _patches(*normals: tuple[float, float, float]) -> Patches:
    """Patches in one place with the given normals."""
    count = len(normals)
    return Patches(
        position=np.tile(PATCH, (count, 1)),
        normal=np.array(normals),
        area=np.full(count, AREA),
        brightness=np.full(count, BRIGHTNESS),
        concerned=np.ones(count, dtype=bool),
    )


def _ratio(
    normal: tuple[float, float, float], patches: Patches, **options: float
) -> np.ndarray:
    return corner_ratio(
        POINT[None],
        np.array([normal]),
        patches,
        receiver=np.zeros(3),
        modulation_frequency=np.array([30e6, 80e6]),
        group_index=1.38,
        **options,
    )[:, 0]


def test_the_ratio_of_one_patch_is_the_equation_of_the_documentation() -> None:
    ratio = _ratio((0.6, 0.0, -0.8), _patches((-0.8, 0.0, -0.6)), attenuation=0.2)
    longer = 1 + math.sqrt(5) - 2
    size = BRIGHTNESS / (math.pi * 0.8) * 0.6 * 0.8 * AREA / (1 + AREA / math.pi)
    size *= 4 / 5 * math.exp(-0.2 * longer)
    turn = 2 * math.pi * np.array([30e6, 80e6]) * 1.38 / speed_of_light * longer
    assert_allclose(ratio, size * np.exp(1j * turn), rtol=1e-12)


def test_light_outside_of_the_angle_of_view_fades() -> None:
    patches = _patches((-0.8, 0.0, -0.6))
    wide = _ratio((0.6, 0.0, -0.8), patches)
    narrow = _ratio((0.6, 0.0, -0.8), patches, acceptance=0.3)
    fades = math.exp(-((math.atan(0.5) / 0.3) ** 2))
    assert_allclose(narrow, fades * wide, rtol=1e-12)


def test_only_surfaces_that_face_each_other_exchange_light() -> None:
    facing = _patches((-0.8, 0.0, -0.6))
    assert (_ratio((-0.6, 0.0, -0.8), facing) == 0).all()
    away = _patches((0.8, 0.0, -0.6))
    assert (_ratio((0.6, 0.0, -0.8), away) == 0).all()
    both = _patches((-0.8, 0.0, -0.6), (0.8, 0.0, -0.6), (-0.8, 0.0, -0.6))
    alone = _ratio((0.6, 0.0, -0.8), facing)
    assert_allclose(_ratio((0.6, 0.0, -0.8), both), 2 * alone, rtol=1e-12)


def test_a_grazing_surface_keeps_a_finite_ratio() -> None:
    patches = _patches((-0.8, 0.0, -0.6))
    grazing = _ratio((1.0, 0.0, 0.0), patches)
    steep = _ratio((0.6, 0.0, -0.8), patches)
    assert_allclose(grazing / steep, (1.0 / 0.05) / (0.6 / 0.8), rtol=1e-12)


@pytest.mark.parametrize(("count", "expected"), [(0, False), (2, False), (3, True)])
def test_more_than_2_percent_of_pixels_make_corners_a_cause(
    count: int, expected: bool
) -> None:
    light = np.where(np.arange(100) < count, 2.0, 1.0)
    assert corners.is_corner_light(light, np.ones(100)) is expected


@pytest.mark.parametrize(
    ("attributes", "frequencies", "expected"),
    [
        ({}, 1, 1.0),
        ({"target_ratio": 0.4}, 1, 1.0),
        ({"target_ratio": 0.4, "water_ratio": 0.1}, 2, 0.5 * 1.4 * 0.9 / 0.3),
        ({"target_ratio": 0.1, "water_ratio": 0.4}, 2, 0.5 * 1.1 * 0.6 / 0.3),
        ({"joint_misfit": 1.0}, 1, 2.0),
        ({"open_water_change": 1, "channel_phase_probability": 1}, 1, 10 / 3),
        ({"open_water_change": 1, "channel_phase_probability": 1}, 2, 1.0),
        ({"open_water_change": 1}, 1, 1.0),
    ],
)
def test_two_channels_enlarge_the_shift(
    attributes: dict[str, float], frequencies: int, expected: float
) -> None:
    observation = SimpleNamespace(
        channel=xr.Dataset(attrs=attributes), frequency=np.ones(frequencies)
    )
    assert corners._leverage(observation) == pytest.approx(expected)


def _scan(
    rows: int, columns: int, *, across: float = 0.002, down: float = 0.001
) -> SimpleNamespace:
    """Scan of even steps, without a span of its own."""
    row, column = np.mgrid[0:rows, 0:columns]
    geometry = SimpleNamespace(azimuth=across * column, elevation=-down * row)
    return SimpleNamespace(geometry=geometry, span=None)


def test_steps_are_the_angles_between_neighbors() -> None:
    assert corners._steps(_scan(3, 5)) == pytest.approx((0.002, 0.001))
    assert corners._steps(_scan(1, 5)) == pytest.approx((0.002, 0.0))
    assert corners._steps(_scan(3, 1)) == pytest.approx((0.0, 0.001))


@pytest.mark.parametrize(
    ("shape", "ratio", "side"),
    [
        ((60, 60), 1e-9, 3),
        ((80, 80), 1e-9, 4),
        ((80, 81), 1e-9, 5),
        ((8, 60), 1e-9, 3),
        # sqrt(12) 0.005 / sqrt(0.002 0.001) = 12.2; its root over 0.15 is 9.04.
        ((90, 60), 0.005, 10),
        ((60, 60), 0.05, 20),
        ((60, 33), 0.05, 11),
    ],
)
def test_patches_are_as_wide_as_noise_and_number_need(
    shape: tuple[int, int], ratio: float, side: int
) -> None:
    distance = np.full(shape, 2.0)
    distance[0, 0] = 0.0
    assert corners._side(_scan(*shape), distance, 2 * np.full(shape, ratio)) == side


def test_without_steps_or_noise_the_number_of_patches_counts() -> None:
    distance = np.full((80, 81), 2.0)
    assert corners._side(_scan(80, 81), np.full((80, 81), np.nan), distance) == 5
    still = _scan(80, 81, across=0.0, down=0.0)
    assert corners._side(still, distance, distance) == 5
    assert corners._side(_scan(80, 81, down=0.0), distance, distance) == 5


def test_the_part_of_a_scan_stands_for_the_whole() -> None:
    part = _scan(3, 5)
    assert corners._coverage(part) == 1.0
    whole = Span(azimuth=(0.0, 0.018), elevation=(-0.005, 0.0))
    part.span = whole
    assert corners._coverage(part) == pytest.approx(10 * 6 / 15)
    part.span = Span(azimuth=(0.0, 0.002), elevation=(-0.001, 0.0))
    assert corners._coverage(part) == 1.0
    for rows, columns in ((1, 5), (3, 1)):
        row = _scan(rows, columns)
        row.span = whole
        assert corners._coverage(row) == 1.0
    still = _scan(3, 5, across=0.0)
    still.span = whole
    assert corners._coverage(still) == 1.0
    smallest = _scan(2, 2)
    smallest.span = whole
    assert corners._coverage(smallest) == pytest.approx(10 * 6 / 4)


def _block(rows: int = 4, columns: int = 5) -> np.ndarray:
    """Pixels of a plane with steps of 20 mm to the right and 30 mm down and ahead."""
    row, column = np.mgrid[0:rows, 0:columns]
    steps = np.stack([0.02 * column, 0.03 * row, 0.04 * row + 1.0], axis=-1)
    return steps.astype(float)


def test_a_flat_block_has_center_normal_area_and_brightness() -> None:
    position = _block()
    noise, bright = np.full((4, 5), 1e-6), np.full((4, 5), 0.2)
    bright[0, 0] = 9.0
    patch = corners._plane(position, noise, bright)
    assert patch is not None
    assert_allclose(patch[0], [0.04, 0.045, 1.06], atol=1e-12)
    assert_allclose(patch[1] * np.sign(patch[1][1]), [0.0, 0.8, -0.6], atol=1e-12)
    assert patch[2] == pytest.approx(20 * 0.02 * 0.05)
    assert patch[3] == pytest.approx(0.2)
    # Pixels without a range have no area.
    position[0, :3] = np.nan
    patch = corners._plane(position, noise, bright)
    assert patch is not None
    assert patch[2] == pytest.approx(17 * 0.02 * 0.05)


@pytest.mark.parametrize(
    ("bump", "noise", "flat"),
    [
        # 20 pixels of 20 x 50 mm are 141 mm wide: 7.07 mm of scatter are the limit.
        (0.0069, 1e-6, True),
        (0.0072, 1e-6, False),
        (0.0072, 0.0035, False),
        (0.0072, 0.0037, True),
    ],
)
def test_a_block_is_flat_within_its_width_or_noise(
    bump: float, noise: float, flat: bool
) -> None:
    # A checkerboard of four rows and columns leaves the fitted plane as it is.
    row, column = np.mgrid[0:4, 0:5]
    sign = np.array([1, -1, -1, 1])[row] * np.array([1, -1, 0, -1, 1])[column]
    sign = sign / np.std(sign)
    off = bump * sign[..., None] * np.array([0.0, 0.8, -0.6])
    found = corners._plane(_block() + off, np.full((4, 5), noise), np.ones((4, 5)))
    assert (found is not None) is flat


def test_blocks_of_few_pixels_or_one_row_are_no_patch() -> None:
    def found(position: np.ndarray) -> bool:
        shape = position.shape[:2]
        return (
            corners._plane(position, np.full(shape, 1e-6), np.ones(shape)) is not None
        )

    assert found(_block(2, 2))
    assert not found(_block(1, 5))
    assert not found(_block(5, 1))
    three = _block(2, 2)
    three[0, 0] = np.nan
    assert not found(three)
    half = _block(4, 5)
    half[:2] = np.nan
    assert found(half)
    half[2, 0] = np.nan
    assert not found(half)
    same = np.zeros((3, 3, 3))
    assert not found(same)


def test_the_nearest_patches_come_first() -> None:
    centers = np.array([[0.0, 0.0, 1.0 * k] for k in range(6)])
    near = corners._nearest(np.array([[0.0, 0.0, 1.9], [0.0, 0.0, 4.2]]), centers)
    assert_array_equal(near, [[2, 1, 3, 0], [4, 5, 3, 2]])
    two = corners._nearest(np.array([[0.0, 0.0, 1.9]]), centers[:2])
    assert_array_equal(two, [[1, 0]])
    assert corners._nearest(np.zeros((0, 3)), centers).shape == (0, 4)


WALLS = {"azimuth": 0.0, "wide": 14, "tall": 10, "columns": 24, "rows": 12}


@pytest.fixture(scope="module")
def walls() -> tuple[Survey, xr.Dataset]:
    """Echoes of an inside corner without water and noise, and their survey."""
    described = survey(2, *corner(2.6, reflectance=0.3), baseline=1, **WALLS).with_(
        {"instrument.receiver.acceptance": "0.3 rad"}
    )
    cube = simulate(described, rng=3)
    for name in ("in_phase", "quadrature"):
        cube[name].values[:] = cube[f"truth_target_{name}"].values
    cube.attrs["corner_light"] = "present"
    return described, rejection.keep_water(cube)


def _observed(
    walls: tuple[Survey, xr.Dataset], polarization: str
) -> tuple[Observation, np.ndarray]:
    channel = walls[1].sel(polarization=polarization)
    return observe(channel), channel["truth_slant_range"].values


def test_the_echo_over_that_of_a_white_surface_is_reflectance_and_cosine(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    water = water_properties(walls[0])
    total, cosines = 0.0, 0.0
    for name in ("VV", "VH"):
        observation, distance = _observed(walls, name)
        total = total + echo_over_white(
            observation, walls[0], water, distance, directions=5
        )
        angle = np.abs(observation.geometry.azimuth)
        cosines = np.cos(math.pi / 4 - angle)
    hit = np.isfinite(distance)
    assert hit.sum() > 20
    assert_allclose(total[hit], 0.3 * cosines[hit], rtol=0.02)
    assert np.isnan(total[~hit]).all()


def test_without_the_field_of_view_the_brightness_is_that_of_its_middle(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    water = water_properties(walls[0])
    middle, full = (
        echo_over_white(observation, walls[0], water, distance, directions=count)
        for count in (1, 5)
    )
    plain = echo_over_white(observation, walls[0], water, distance)
    assert_array_equal(plain, middle)
    # The acceptance of 0.3 rad dims the outer pixels, by less than 8 %.
    ratio = middle / full
    valid = np.isfinite(ratio)
    away = np.hypot(observation.geometry.azimuth, observation.geometry.elevation)
    assert np.corrcoef(ratio[valid], away[valid])[0, 1] < -0.9
    assert 0.9 < np.nanmin(ratio) < np.nanmax(ratio) < 1.0


def test_a_scan_without_ranges_has_no_brightness(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    nothing = np.full(distance.shape, np.nan)
    bright = echo_over_white(observation, walls[0], water_properties(walls[0]), nothing)
    assert bright.shape == distance.shape
    assert np.isnan(bright).all()


def _error(
    observation: Observation, distance: np.ndarray, **options: object
) -> tuple[np.ndarray | None, Patches | None]:
    values = {
        "weight": np.array([0.4, 0.6]),
        "slope": np.full(distance.shape, 0.36),
        "noise": np.full(distance.shape, 1e-4),
    }
    return corner_error(observation, distance, **{**values, **options})


def test_patches_of_a_corner_face_the_instrument_and_cover_the_walls(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    error, patches = _error(observation, distance)
    assert error is not None
    assert patches is not None
    assert patches.concerned.all()
    toward = -patches.position / np.linalg.norm(patches.position, axis=1)[:, None]
    assert (np.sum(toward * patches.normal, axis=1) > 0.6).all()
    side = np.sign(patches.position[:, 0])
    assert_allclose(patches.normal[:, 0], -side / 2**0.5, atol=0.02)
    assert_allclose(patches.normal[:, 2], -1 / 2**0.5, atol=0.02)
    # Nine pixels each, and two walls of 0.3 x 0.3 m with blocks at the rim less full.
    steps = np.radians(14) / 23 * np.radians(10) / 11
    full = 9 * steps * np.linalg.norm(patches.position, axis=1) ** 2 / 0.72
    assert (patches.area / full).max() == pytest.approx(1.0, abs=0.05)
    assert (patches.area / full).min() > 0.45
    assert 0.5 < patches.area.sum() / 0.18 < 1.1
    # 0.75 is the share of a painted echo in VV, at 47 degrees.
    assert_allclose(patches.brightness, 0.3 * 0.72 * 0.81 / 0.75, rtol=0.1)


def test_a_mirrored_scan_has_the_same_patches(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    _, patches = _error(observation, distance)
    mirrored = observe(observation.channel.isel(column=slice(None, None, -1)))
    _, other = _error(mirrored, distance[:, ::-1])
    assert patches is not None
    assert other is not None
    near = np.linalg.norm(patches.position[:, None] - other.position, axis=-1)
    order = near.argmin(axis=1)
    assert near.min(axis=1).max() < 1e-9
    for name in ("normal", "area", "brightness"):
        assert_allclose(getattr(patches, name), getattr(other, name)[order], atol=1e-9)


def _shift(
    walls: tuple[Survey, xr.Dataset],
    position: np.ndarray,
    normal: np.ndarray,
    patches: Patches,
) -> np.ndarray:
    """Shift of the range by the light of patches, with the slope of `_error` [m]."""
    observation, _ = _observed(walls, "VV")
    ratios = corner_ratio(
        position,
        normal,
        patches,
        receiver=observation.geometry.receiver[0, 0],
        modulation_frequency=observation.frequency,
        group_index=1.38,
        attenuation=water_properties(walls[0]).reduced_attenuation,
        acceptance=angle_of_view(walls[0]),
    )
    per_phase = np.array([0.4, 0.6]) * observation.path_per_phase.ravel()
    return np.abs(0.36 * per_phase @ np.angle(1 + ratios))


def test_the_error_by_corners_is_the_largest_by_the_orientations_nearby(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    error, patches = _error(observation, distance)
    assert error is not None
    assert patches is not None
    position = observation.geometry.position(distance)
    for place in map(tuple, np.argwhere(np.isfinite(distance))[[5, 60, -1]]):
        near = corners._nearest(position[place][None], patches.position)[0]
        there = np.tile(position[place], (4, 1))
        shift = _shift(walls, there, patches.normal[near], patches)
        assert error[place] == pytest.approx(shift.max(), rel=1e-9)
    assert (error[~np.isfinite(distance)] == 0).all()


def test_light_counts_from_a_twentieth_of_the_noise_on(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    _, first = _error(observation, distance)
    assert first is not None
    shift = _shift(walls, first.position, first.normal, first)
    order = np.sort(shift)
    for limit in (0.9 * order[0], (order[3] + order[4]) / 2, 1.1 * order[-1]):
        # The same as a limit, by a slope that is smaller.
        slope = np.where(np.isfinite(distance), 0.36 * 0.05 * 1e-4 / limit, np.nan)
        noise = np.where(np.isfinite(distance), 1e-4, 1.0)
        error, patches = _error(observation, distance, slope=slope, noise=noise)
        assert patches is not None
        assert_array_equal(patches.concerned, shift > limit)
        assert (error is None) == (not (shift > limit).any())


def test_pixels_near_surfaces_that_are_not_concerned_have_no_error(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    error, patches = _error(observation, distance)
    assert error is not None
    assert patches is not None
    right = patches.position[:, 0] > 0
    half, _ = _error(observation, distance, fit=replace(patches, concerned=right))
    assert half is not None
    outer_left = observation.geometry.azimuth < -0.08
    assert (half[outer_left] == 0).all()
    assert (error[outer_left & np.isfinite(distance)] > 0).all()


def test_channels_pass_their_shares_of_echoes_and_of_light_of_corners(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    """Weak echoes, taken for VV (75 % pass), VH (25 %), or all light."""
    observation, distance = _observed(walls, "VV")
    weak = observation.channel.copy()
    for name in ("in_phase", "quadrature"):
        weak[name] = 0.01 * weak[name]
    errors, bright = [], []
    for name in ("VV", "HH", "RL", "LR", "VH", "HV", "RR", "none"):
        channel = weak.assign_coords(polarization=name)
        error, patches = _error(replace(observation, channel=channel), distance)
        assert error is not None
        assert patches is not None
        errors.append(error.max())
        bright.append(patches.brightness.mean())
    assert_allclose(np.array(bright) / bright[0], [1] * 4 + [3] * 3 + [0.75])
    # Unpolarized light passes by half: twice as well as the echo in VH, and no less
    # than the echo elsewhere.
    assert_allclose(np.array(errors) / errors[0], [1] * 4 + [6] * 3 + [0.75], rtol=0.01)


def test_no_surface_reflects_more_light_than_it_receives(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    channel = observation.channel.copy()
    for name in ("in_phase", "quadrature"):
        channel[name] = 100 * channel[name]
    _, patches = _error(replace(observation, channel=channel), distance)
    assert patches is not None
    toward = observation.geometry.receiver[0, 0] - patches.position
    facing = np.sum(toward * patches.normal, axis=1) / np.linalg.norm(toward, axis=1)
    assert_allclose(patches.brightness, facing)


def test_light_of_corners_needs_a_survey_that_contains_it(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    assert _error(replace(observation, survey=None), distance) == (None, None)
    absent = observation.channel.assign_attrs(corner_light="absent")
    assert _error(replace(observation, channel=absent), distance) == (None, None)
    error, patches = _error(observation, np.full(distance.shape, np.nan))
    assert error is None
    assert patches is not None
    assert patches.area.size == 0


def test_parts_of_a_scan_use_the_patches_of_the_whole(
    walls: tuple[Survey, xr.Dataset],
) -> None:
    observation, distance = _observed(walls, "VV")
    error, patches = _error(observation, distance)
    assert error is not None
    rows = slice(4, 8)
    part = observe(observation.channel.isel(row=rows))
    again, used = _error(part, distance[rows], fit=patches)
    assert used is patches
    assert_allclose(again, error[rows], rtol=1e-9)
