"""Figures of range images: profiles, surfaces, limits, labels and sizes on the page."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from amulor import samples
from amulor.errors import FormatError
from amulor.view import figures
from amulor.view.style import COLOURS


@pytest.fixture(scope="module")
def wall() -> xr.Dataset:
    """Return a wall at 1.5 m of 4 x 6 pixels."""
    return scenes.plane((0.1, 0.05, 1), 1.5, own=2e-4, rows=4, columns=6)


def axes_with_images(figure: Figure) -> list[Axes]:
    return [axis for axis in figure.axes if axis.images]


def bars_of(figure: Figure) -> list[str]:
    return [axis.get_ylabel() for axis in figure.axes if not axis.images]


def test_signals_are_drawn_with_units_at_a_frequency() -> None:
    cube = samples.cube("ladder")
    figure = figures.signal_images(cube)
    drawn = axes_with_images(figure)
    names = [str(name) for name in cube["polarization"].values]
    titles = [axis.get_title("left") or axis.get_title() for axis in drawn]
    assert [title.replace("\n", " ").partition(",")[0] for title in titles] == [
        part for name in names
        for part in (f"{name}: amplitude", f"{name}: phase about its mean")
    ]  # fmt: skip
    amplitude = cube.amulor.amplitude.values[0]
    phase = cube.amulor.phase.values[0]
    for number in range(len(names)):
        first, second = drawn[2 * number : 2 * number + 2]
        top = 1e3 * np.nanmax(amplitude[number])
        assert first.images[0].get_clim() == pytest.approx((0, top))
        shown = np.ma.filled(second.images[0].get_array().astype(float), np.nan)
        mean = np.angle(np.nanmean(np.exp(1j * phase[number])))
        assert f"{np.degrees(mean):.1f}°" in titles[2 * number + 1]
        turned = np.exp(1j * np.radians(shown))
        assert_allclose(turned, np.exp(1j * (phase[number] - mean)), atol=1e-9)
        assert np.nanmax(np.abs(shown)) < 180
    assert bars_of(figure) == ["mV", "degrees"] * len(names)


class Signals(dict[str, xr.DataArray]):
    """Signals of two frequencies and one channel, over the pixels of an image."""

    def __init__(self, image: xr.Dataset) -> None:
        values = np.arange(48.0).reshape(2, 1, 4, 6)
        super().__init__(
            azimuth=image["azimuth"], elevation=image["elevation"],
            polarization=xr.DataArray(["VV"]),
        )  # fmt: skip
        self.amulor = SimpleNamespace(
            amplitude=xr.DataArray(values), phase=xr.DataArray(0 * values)
        )


def test_another_frequency_of_a_cube_can_be_drawn(wall: xr.Dataset) -> None:
    cube: Any = Signals(wall)
    drawn = [
        axes_with_images(figures.signal_images(cube, **options))[0].images[0]
        for options in ({}, {"frequency": 1})
    ]
    for number, picture in enumerate(drawn):
        expected = 1e3 * cube.amulor.amplitude.values[number, 0]
        assert_allclose(picture.get_array(), expected)


def test_ranges_before_and_after_have_titles_and_even_limits(wall: xr.Dataset) -> None:
    later = wall.copy(deep=True)
    later["slant_range"].values[:] += 1e-3 * np.arange(24).reshape(4, 6)
    figure = figures.range_images(wall, later)
    titles = [
        (axis.get_title("left") or axis.get_title()).replace("\n", " ")
        for axis in axes_with_images(figure)
    ]
    assert titles == [
        "slant range before rejection", "slant range after rejection",
        "uncertainty after rejection", "moved by rejection (before - after)",
    ]  # fmt: skip
    assert bars_of(figure) == ["mm"] * 4
    before, after, error, moved = (a.images[0] for a in axes_with_images(figure))
    assert_allclose(before.get_array(), 1e3 * wall["slant_range"])
    assert_allclose(after.get_array(), 1e3 * later["slant_range"])
    assert_allclose(error.get_array(), 0.2)
    assert_allclose(moved.get_array(), -np.arange(24.0).reshape(4, 6), atol=1e-9)
    # 3.5 % of 0 to -23 mm on either side.
    high = 23 * 0.965
    assert moved.get_clim() == pytest.approx((-high, high))
    both = 1e3 * np.concatenate([wall["slant_range"], later["slant_range"]])
    low, high = np.percentile(both, [3.5, 96.5])
    room = 0.05 * (high - low)
    assert before.get_clim() == pytest.approx((low - room, high + room))
    assert after.get_clim() == before.get_clim()
    assert figures._even(np.zeros(3)) == (-1e-9, 1e-9)
    assert figures._even(np.array([1.0, 1.0, 3.0]))[0] == pytest.approx(-2.86)


def test_an_overview_names_its_maps_and_an_unknown_error(wall: xr.Dataset) -> None:
    figure = figures.image_overview(wall)
    titles = [a.get_title("left") or a.get_title() for a in axes_with_images(figure)]
    assert titles == ["slant range", "uncertainty", "brightness", "quality"]
    assert bars_of(figure) == ["mm", "mm", "mV", ""]
    first, _, third, _ = axes_with_images(figure)
    assert_allclose(first.images[0].get_array(), 1e3 * wall["slant_range"])
    assert_allclose(third.images[0].get_array(), 1e3 * wall["intensity"])


@pytest.mark.parametrize(
    ("cases", "stages", "size"),
    [(1, 1, (3.6, 1.75)), (2, 1, (3.7, 1.75)), (3, 2, (5.55, 3.5))],
)
def test_profiles_have_a_column_for_each_case(wall, cases, stages, size) -> None:
    names = ["before", "after"][-stages:]
    given = {f"case {n}": dict.fromkeys(names, wall) for n in range(cases)}
    figure = figures.profiles(given)
    assert_allclose(figure.get_size_inches(), size)
    axes = np.reshape(figure.axes, (stages, cases))
    letters = iter("abcdef")
    for row, stage in enumerate(names):
        for column in range(cases):
            axis = axes[row, column]
            name = f"case {column}, {stage}" if stages > 1 else f"case {column}"
            letter = f"({next(letters)}) " if cases > 1 else ""
            assert (axis.get_title("left") or axis.get_title()) == letter + name
            assert any(line.get_visible() for line in axis.get_xgridlines())
            assert len(axis.lines) == 4
            colors = {to_hex(line.get_color()) for line in axis.lines}
            assert colors == {COLOURS[(1, 0)[row]].lower()}
            right = "right [mm]" if row == stages - 1 else ""
            assert axis.get_xlabel() == right
            assert axis.get_ylabel() == ("nearer [mm]" if column == 0 else "")
    heights = [figures._grid(wall)[2]] * cases
    low, high = np.percentile(heights, [3.5, 96.5])
    room = (high - low) / 2
    assert axes[0, 0].get_ylim() == pytest.approx((low - room, high + room))


def test_heights_are_counted_from_the_far_side() -> None:
    image = scenes.plane((0.0, 0.0, 1), 1.5, rows=5, columns=7).copy(deep=True)
    image["slant_range"].values[2, 3] -= 0.01
    image["slant_range"].values[0, 1] = np.nan
    x, y, height = figures._grid(image)
    # The middle pixel looks straight ahead; a hole is placed by its direction.
    assert height[2, 3] == pytest.approx(10.0, abs=0.1)
    assert np.isnan(height[0, 1])
    assert np.nanmin(height) == pytest.approx(0.0, abs=0.1)
    far = 1500.0
    assert x[0, 1] == pytest.approx(
        far * np.tan(image["azimuth"].values[0, 1]), rel=1e-3
    )
    assert y[0, 1] == pytest.approx(
        -far * np.tan(image["elevation"].values[0, 1]), rel=1e-3
    )
    assert_allclose(x[1], x[3], atol=1.0)
    image["slant_range"].values[:] = np.nan
    empty = figures._grid(image)
    assert np.isnan(empty[2]).all()
    assert (empty[0] == 0).all()


def test_rows_of_a_band_have_quantiles_and_gaps() -> None:
    axis = Figure().add_subplot()
    rng = np.random.default_rng(2)
    height = rng.normal(size=(200, 9))
    across = np.tile(np.arange(9.0), (200, 1))
    # Columns with at most 2 % of their rows are left out.
    height[:196, 4], height[:195, 6] = np.nan, np.nan
    figures._rows_of(axis, across, height, "#ff0000")
    (line,) = axis.lines
    x, y = line.get_data()
    assert_allclose(x[np.isfinite(x)], [0, 1, 2, 3, 5, 6, 7, 8])
    assert np.flatnonzero(np.isnan(x)).tolist() == [4]
    assert y[0] == pytest.approx(np.median(height[:, 0]))
    assert to_hex(line.get_color()) == "#ff0000"
    for band, (low, high) in zip(
        axis.collections, ((2.5, 97.5), (16, 84)), strict=True
    ):
        corners = band.get_paths()[0].vertices
        first = corners[corners[:, 0] == 0][:, 1]
        assert (first.min(), first.max()) == pytest.approx(
            tuple(np.percentile(height[:, 0], [low, high]))
        )
    few = Figure().add_subplot()
    figures._rows_of(few, across[:60], height[:60], "#ff0000")
    assert len(few.lines) == 9 or len(few.lines) == 60
    assert len(few.collections) == 0
    none = Figure().add_subplot()
    figures._rows_of(none, across, np.full((200, 9), np.nan), "#ff0000")
    assert len(none.lines) == 0


@pytest.mark.parametrize(("count", "size"), [(1, (3.6, 2.75)), (3, (7.2, 5.5))])
def test_surfaces_have_panels_with_equal_axes(wall, count, size) -> None:
    figure = figures.surfaces({f"image {n}": wall for n in range(count)})
    assert_allclose(figure.get_size_inches(), size)
    assert len(figure.axes) == count
    x, y, height = figures._grid(wall)
    low, high = np.percentile([height] * count, [3.5, 96.5])
    low, high = low - (high - low) / 4, high + (high - low) / 4
    for number, axis in enumerate(figure.axes):
        title = axis.get_title("left") or axis.get_title()
        assert title == f"({'abc'[number]}) image {number}"
        assert (axis.get_xlabel(), axis.get_ylabel(), axis.get_zlabel()) == (
            "right [mm]", "up [mm]", "nearer [mm]",
        )  # fmt: skip
        assert axis.get_zlim() == pytest.approx((low, high))
        assert axis.get_ylim() == pytest.approx((-y.max(), -y.min()))
        assert (axis.elev, axis.azim) == (30, -72)
        wide = np.ptp(x)
        shape = np.array([wide, max(np.ptp(y), 0.4 * wide), 0.6 * wide])
        found = axis._box_aspect
        assert_allclose(found / found[0], shape / shape[0])
        rulers = (axis.xaxis, axis.yaxis, axis.zaxis)
        rooms = [ruler.get_major_locator()._nbins for ruler in rulers]
        assert rooms == [max(1, int(7 * span / shape.max())) for span in shape]


def test_surfaces_leave_out_what_is_far_off() -> None:
    image = scenes.plane((0.1, 0.05, 1), 1.5, rows=8, columns=9).copy(deep=True)
    image["slant_range"].values[4, 4] -= 0.5
    (axis,) = figures.surfaces({"a": image}).axes
    assert axis.get_zlim()[1] < 100


def test_shades_fall_with_the_height_and_holes_are_clear() -> None:
    height = np.array([[0.0, 5.0, 10.0], [0.0, 5.0, np.nan]])
    found = figures._shaded(np.vstack([height[:1]] * 3), 0.0, 10.0)
    assert found.shape == (3, 3, 4)
    # Without slope across rows, the light is the same along columns.
    assert_allclose(found[0], found[2])
    assert (found[..., 3] == 1).all()
    holes = figures._shaded(height, 0.0, 10.0)
    assert holes[1, 2, 3] == 0
    assert holes[0, 0, 3] == 1
    flat = figures._shaded(np.full((3, 3), 5.0), 0.0, 10.0)
    # Light at 50 degrees on a level surface, in the color of the middle.
    from matplotlib import colormaps

    color = np.array(colormaps["viridis"](0.1 + 0.85 / 2)[:3])
    share = 0.55 + 0.45 * np.sin(np.radians(50))
    assert_allclose(flat[1, 1, :3], color * share)
    beyond = figures._shaded(np.array([[-9.0, 19.0]] * 2), 0.0, 10.0)
    ratio = beyond[0, :, 0] / beyond[0, :, 1]
    ends = [colormaps["viridis"](value) for value in (0.1, 0.95)]
    assert_allclose(ratio, [end[0] / end[1] for end in ends])


def test_response_curves_have_bands_a_cut_off_and_units() -> None:
    frequency = np.linspace(0, 100e6, 11)
    response = np.exp(-0.5j * frequency / 1e7) / (1 + frequency / 40e6)
    figure = figures.response_curves(
        frequency, {"model": response, "other": 0.5 * response}, cut_off=40e6,
        errors={"model": np.full(11, 0.1)}, title="water",
    )  # fmt: skip
    top, bottom = figure.axes
    assert_allclose(figure.get_size_inches(), [4.8, 4.4])
    model, other, level, point = top.lines
    assert_allclose(
        model.get_xydata(), np.stack([frequency / 1e6, np.abs(response)], 1)
    )
    assert_allclose(other.get_ydata(), 0.5 * np.abs(response))
    assert_allclose(level.get_ydata(), np.sqrt(0.5))
    assert_allclose(point.get_xydata(), [[40, np.sqrt(0.5)]])
    (band,) = top.collections
    corners = band.get_paths()[0].vertices
    start = corners[corners[:, 0] == 0][:, 1]
    assert (start.min(), start.max()) == pytest.approx((0.9, 1.1))
    # Half a radian in 10 MHz, without a wrap.
    assert_allclose(bottom.lines[0].get_ydata(), -np.degrees(0.5 * frequency / 1e7))
    assert [text.get_text() for text in top.get_legend().get_texts()] == [
        "model", "other", "cut-off 40.0 MHz",
    ]  # fmt: skip
    assert top.get_ylim() == (0, 1.02)
    assert (top.get_title("left") or top.get_title()) == "water"
    assert bottom.get_xlabel() == "modulation frequency [MHz]"
    assert [axis.get_ylabel() for axis in (top, bottom)] == [
        "amplitude over that at 0 MHz", "phase delay [degrees]",
    ]  # fmt: skip
    for axis in (top, bottom):
        assert any(line.get_visible() for line in axis.get_xgridlines())
    plain = figures.response_curves(frequency, {"model": response})
    assert len(plain.axes[0].lines) == 1
    assert not plain.axes[0].collections


def test_response_curves_are_written_as_png_or_svg(tmp_path: Path) -> None:
    frequency = np.linspace(0, 100e6, 3)
    for name, start in (("a.png", b"\x89PNG"), ("b.SVG", b"<?xml")):
        path = tmp_path / name
        figures.write_response_curves(path, frequency, {"m": np.ones(3) + 0j})
        assert path.read_bytes().startswith(start)
    with pytest.raises(FormatError, match="overwrite"):
        figures.write_response_curves(path, frequency, {"m": np.ones(3) + 0j})
    figures.write_response_curves(
        path, frequency, {"m": np.ones(3) + 0j}, overwrite=True, title="new"
    )
    other = tmp_path / "c.pdf"
    with pytest.raises(FormatError) as refused:
        figures.write_response_curves(other, frequency, {"m": np.ones(3) + 0j})
    assert str(refused.value) == (
        f"{other}: pictures are written as .png or .svg; rename it"
    )
