"""Figures of trajectories, maps and range profiles show the numbers of their data."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose

from amulor.cube import QualityFlag
from amulor.imaging.beam_profile import BeamProfile
from amulor.platform import Trajectory
from amulor.view import beam_profile, maps, trajectory
from amulor.view.style import MISSING_COLOUR


@pytest.fixture(scope="module")
def track() -> Trajectory:
    """Return a vehicle that turns on the spot, climbs, and says nothing for 3 s."""
    time = np.r_[np.arange(100.0, 104.0, 0.1), np.arange(107.0, 110.0, 0.1)]
    seconds = time - 100.0
    return Trajectory.of_angles(
        time=time,
        position=np.stack([0.3 * seconds, 0.4 * seconds, -8 + 0.1 * seconds], axis=1),
        heading=np.radians(350.0) + np.radians(4.0) * seconds,
        pitch=np.radians(5.0) + 0 * seconds,
        roll=0 * seconds,
        longest_gap=1.0,
    )


def test_panels_of_a_trajectory_have_its_courses(track: Trajectory) -> None:
    figure = trajectory.draw(track)
    plan, height, speed, heading, angle = figure.axes
    for axes, last in ((height, -7.01), (speed, np.sqrt(0.26)), (angle, 5.0)):
        seconds, values = axes.lines[0].get_data()
        assert (seconds[0], seconds[-1]) == pytest.approx((0.0, 9.9))
        assert values[-1] == pytest.approx(last, abs=1e-3)
        # Gaps are shaded where they are, and not drawn through.
        (shade,) = axes.patches
        begin, end = shade.get_x(), shade.get_x() + shade.get_width()
        assert (begin, end) == pytest.approx((3.9, 7.0))
        inside = (seconds > 3.95) & (seconds < 6.95)
        assert inside.any()
        assert np.isnan(values[inside]).all()
    seconds, values = heading.lines[0].get_data()
    # Clockwise from north, through north at 2.5 s.
    assert_allclose(values[seconds < 2.4], 350 + 4 * seconds[seconds < 2.4], atol=0.01)
    assert_allclose(values[seconds > 7.1], -10 + 4 * seconds[seconds > 7.1], atol=0.01)
    # An upright vehicle that looks up by 5 degrees is tilted by as much.
    assert_allclose(angle.lines[1].get_ydata()[-1], 5.0, atol=1e-6)
    assert [axes.get_ylabel() for axes in figure.axes[1:]] == [
        "height [m]", "speed [m/s]", "heading [deg]", "angle [deg]",
    ]  # fmt: skip
    line, start, end, *_ = plan.lines
    east, north = line.get_data()
    known = np.isfinite(east)
    assert_allclose(4 * east[known], 3 * north[known], atol=1e-9)
    assert_allclose([start.get_xdata()[0], start.get_ydata()[0]], [0, 0], atol=1e-9)
    assert_allclose([end.get_xdata()[0], end.get_ydata()[0]], [2.97, 3.96], atol=1e-6)
    (arrows,) = [part for part in plan.collections if hasattr(part, "U")]
    assert 12 <= arrows.N <= 14
    assert_allclose(
        [arrows.U[0], arrows.V[0]],
        np.cos(np.radians(5))
        * np.array([np.sin(np.radians(-10)), np.cos(np.radians(10))]),
        atol=1e-6,
    )
    assert trajectory._largest(np.array([np.diag([4e-6, 9e-6])])) == pytest.approx(3e-3)
    assert np.isnan(trajectory._largest(np.array([np.diag([4e-6, np.inf])])))


def _scan(rows: int, columns: int, wide: float, high: float) -> xr.Dataset:
    azimuth, elevation = np.meshgrid(
        np.radians(np.linspace(0, wide, columns)),
        np.radians(np.linspace(high, 0, rows)),
    )
    names = ("row", "column")
    return xr.Dataset(
        coords={"azimuth": (names, azimuth), "elevation": (names, elevation)}
    )


def test_a_map_has_the_angles_and_limits_of_its_scan() -> None:
    cube = _scan(4, 6, 12.0, 3.0)
    values = np.arange(24.0).reshape(4, 6)
    values[0, 0] = np.nan
    panel = maps.Map(title="range", values=values, label="m", colours="viridis")
    figure = maps.draw_maps([(cube, panel)])
    axes, bar = figure.axes
    (picture,) = axes.images
    assert_allclose(picture.get_array().filled(np.nan), values)
    assert picture.get_extent() == pytest.approx([0, 12, 0, 3])
    # 3.5 % of the 23 pixels at either end are left out.
    assert picture.get_clim() == pytest.approx(
        np.percentile(np.arange(1, 24), [3.5, 96.5])
    )
    assert to_hex(picture.cmap.get_bad()) == to_hex(MISSING_COLOUR)
    assert bar.get_ylabel() == "m"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("azimuth [°]", "elevation [°]")
    # The map has the shape of the scan, and all of it is on the page.
    box = axes.get_position()
    wide, high = figure.get_size_inches()
    assert box.height * high / (box.width * wide) == pytest.approx(3 / 12)
    assert 0 < box.x0 < bar.get_position().x1 < 1
    stated = maps.Map(
        title="range", values=values, label="m", colours="viridis", limits=(2.0, 5.0)
    )
    drawn = maps.draw_maps([(cube, stated)]).axes[0].images[0]
    assert drawn.get_clim() == (2.0, 5.0)
    assert maps.usual_limits(np.full(3, np.nan)) == (0.0, 1.0)
    assert maps.usual_limits(np.array([1.0, 3.0]), margin=0.5) == pytest.approx(
        (1.07 - 0.93, 2.93 + 0.93)
    )


def test_a_scan_along_a_line_is_drawn_by_pixels() -> None:
    cube = _scan(1, 5, 10.0, 0.0)
    panel = maps.Map(title="a", values=np.ones((1, 5)), label="", colours="viridis")
    axes = maps.draw_maps([(cube, panel)]).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("column", "row")
    assert maps._ratio(cube) == pytest.approx(1 / 5)
    assert maps._ratio(_scan(4, 4, 1.0, 20.0)) == 8.0


@pytest.mark.parametrize(
    ("count", "ratio", "arranged"),
    [(1, 0.5, (1, 1)), (2, 0.25, (2, 1)), (2, 1.0, (1, 2)), (4, 1.0, (2, 2)),
     (3, 4.0, (1, 3)), (8, 1.0, (4, 2))],
)  # fmt: skip
def test_maps_are_arranged_to_be_large(count: int, ratio: float, arranged) -> None:
    rows, columns, width, height = maps._layout(count, ratio)
    assert (rows, columns) == arranged
    assert height / width == pytest.approx(ratio)
    # The page is 7.2 inches wide and at most 7.6 high; labels take 1.26 and 0.74.
    assert columns * (width + 1.26) <= 7.2 + 1e-9
    assert rows * (height + 0.74) <= 7.6 + 1e-9
    fills = columns * (width + 1.26) / 7.2, rows * (height + 0.74) / 7.6
    assert max(fills) == pytest.approx(1)


def test_the_map_of_quality_tells_doubtful_from_missing_pixels() -> None:
    flags = np.array([[0, QualityFlag.MIXED, QualityFlag.MISSING]])
    image = xr.Dataset({"quality_flag": (("row", "column"), flags)})
    assert maps.quality_map(image).values.tolist() == [[0.0, 1.0, 2.0]]


def test_a_range_profile_marks_its_surfaces_and_noise() -> None:
    place = np.linspace(0.5, 2.5, 41)
    beam = BeamProfile(
        slant_range=place, profile=1e-3 + 0.2 * np.exp(-((place - 1.5) ** 2) / 0.01),
        water=1e-2 / place, noise=2e-3, surface=np.array([1.5012]),
        surface_uncertainty=np.array([3e-4]), amplitude=np.array([0.201]),
        amplitude_uncertainty=np.array([0.01]), misfit=1.0, freedom=4,
        resolution=0.1, unambiguous_span=7.0,
    )  # fmt: skip
    figure = beam_profile.draw(beam, title="row 3, column 4")
    (axes,) = figure.axes
    profile, water = axes.lines[:2]
    assert_allclose(profile.get_xydata(), np.stack([place, beam.profile], axis=1))
    assert_allclose(water.get_ydata(), beam.water)
    (level,) = axes.patches
    assert level.get_height() == pytest.approx(2e-3)
    (bars,) = axes.containers
    assert bars.get_label() == "1: 1.5012 m ± 0.3 mm"
    across, upright = (part.get_segments()[0] for part in bars.lines[2])
    assert_allclose(across[:, 0], [1.5012 - 6e-4, 1.5012 + 6e-4])
    assert_allclose(upright[:, 1], [0.201 - 0.02, 0.201 + 0.02])
    (name,) = axes.texts
    assert (name.get_text(), name.xy) == ("1", pytest.approx((1.5012, 0.201)))
    assert axes.get_ylim() == pytest.approx((2e-3 / 3, 4 * beam.profile.max()))
    assert axes.get_title(loc="left") == "row 3, column 4"
