"""Labels, sizes, limits and marks of the figures that commands write."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from scipy.stats import norm

from amulor.acquisition import Calibration
from amulor.errors import FormatError
from amulor.imaging.beam_profile import BeamProfile
from amulor.platform import Trajectory
from amulor.site.registration.reliability import Reliability
from amulor.view import beam_profile, calibration, maps, site_plan, site_residuals
from amulor.view import trajectory as trajectories
from amulor.view.site_residuals import PairResiduals
from amulor.view.style import COLOURS, SETTINGS, new_figure, style


def titles(figure: Figure) -> list[str]:
    return [axis.get_title("left") or axis.get_title() for axis in figure.axes]


def pair(rows: int, columns: int, distance: np.ndarray) -> PairResiduals:
    return PairResiduals(
        source="b", target="a", shape=(rows, columns), pixel=np.arange(rows * columns),
        distance=distance.ravel(), score=distance.ravel() / 2e-3,
    )  # fmt: skip


def test_cells_of_a_wide_scan_are_square() -> None:
    values = np.arange(5 * 65.0).reshape(5, 65)
    means, side = site_residuals.cell_means(pair(5, 65, values))
    # 65 columns in 32 cells at most: three to a side.
    assert (side, means.shape) == (3, (2, 22))
    assert means[0, 0] == values[:3, :3].mean()
    assert means[1, -1] == values[3:, 63:].mean()
    assert site_residuals.cell_means(pair(5, 32, values[:, :32]))[1] == 1


@pytest.mark.parametrize(
    ("count", "shape", "high", "lines"),
    # Panels of 1.35 inches, with the ratio of the scan between 0.3 and 2.
    [(1, (4, 8), 0.5, 1), (4, (2, 40), 0.3, 1), (5, (40, 4), 2.0, 2)],
)  # fmt: skip
def test_maps_of_residuals_have_the_shape_of_their_scan(count, shape, high, lines):
    values = 1e-3 * np.arange(float(np.prod(shape))).reshape(shape)
    figure = site_residuals.residual_maps([pair(*shape, values)] * count)
    assert_allclose(figure.get_size_inches(), [7, (1.35 * high + 0.4) * lines + 0.2])
    panels = [axis for axis in figure.axes if axis.get_visible() and axis.images]
    assert len(panels) == count
    hidden = [axis for axis in figure.axes if not axis.get_visible()]
    assert len(hidden) == 4 * lines - count
    means = site_residuals.cell_means(pair(*shape, values))[0]
    limit = 1e3 * np.quantile([means] * count, 0.98)
    scatter = np.sqrt(np.mean((values / 2e-3) ** 2))
    rows, columns = shape
    for number, axis in enumerate(panels):
        assert axis.images[0].get_clim() == pytest.approx((-limit, limit))
        assert (axis.get_title("left") or axis.get_title()) == (
            f"b on a: {scatter:.2f}"
        )
        assert axis.get_xlim() == (-0.5, columns - 0.5)
        assert axis.get_ylim() == (rows - 0.5, -0.5)
        assert axis.get_ylabel() == ("row" if number % 4 == 0 else "")
        assert axis.get_xlabel() == ("column" if number >= count - 4 else "")
        assert to_hex(axis.get_facecolor()) == "#d9d9d9"
    (bar,) = [axis for axis in figure.axes if axis.get_ylabel() == "mean distance [mm]"]
    assert bar is figure.axes[-1]
    extent = panels[0].images[0].get_extent()
    side = -(-max(shape) // 32)
    assert_allclose(extent, [-0.5, -(-columns // side) * side - 0.5,
                             -(-rows // side) * side - 0.5, -0.5])  # fmt: skip


def test_histograms_of_residuals_have_the_normal_distribution() -> None:
    values = np.array([[-0.02, 0.0, 0.0], [0.001, 0.0, 0.02]])
    line = Reliability(
        observation="bar A B", part="length", residual=0.4, uncertainty=1.0,
        redundancy=0.5, score=0.6, detectable=5.8, external=1e-3, external_scan="a2",
    )  # fmt: skip
    lines = [line, replace(line, score=-1.2), replace(line, detectable=None)]
    figure = site_residuals.residual_histograms([pair(2, 3, values)] * 2, lines)
    assert_allclose(figure.get_size_inches(), [7.0, 2.7])
    for axis, count, bins in zip(figure.axes, (12, 2), (50, 20), strict=True):
        heights = [bar.get_height() for bar in axis.patches]
        assert (len(heights), sum(heights)) == (bins, count)
        width = 10 / bins
        assert [bar.get_x() for bar in axis.patches[:2]] == pytest.approx(
            [-5, -5 + width]
        )
        (curve,) = axis.lines
        x, y = curve.get_data()
        assert len(x) == 201
        assert_allclose(y, count * width * norm.pdf(x))
        assert (x[0], x[-1]) == axis.get_xlim() == (-5, 5)
        words = [text.get_text() for text in axis.get_legend().get_texts()]
        assert words == [f"{count} residuals", "normal distribution"] or words == [
            "normal distribution", f"{count} residuals"
        ]  # fmt: skip
        top = max(max(heights), y.max())
        assert axis.get_ylim()[1] == pytest.approx(1.35 * 1.05 * top)
    points, checked = figure.axes
    # Distances of ten times their noise are in the outermost bars.
    assert [points.patches[k].get_height() for k in (0, -1)] == [2, 2]
    assert points.get_xlabel() == "distance over its stated noise"
    assert points.get_ylabel() == "points of all pairs"
    assert checked.get_xlabel() == "standardized residual w"
    assert checked.get_ylabel() == "stated values"
    empty = site_residuals.residual_histograms([], [])
    assert sum(bar.get_height() for bar in empty.axes[0].patches) == 0


@pytest.fixture(scope="module")
def track() -> Trajectory:
    """Return a straight course to the east in 20 s, without a gap."""
    time = np.arange(0.0, 20.5, 0.5)
    return Trajectory.of_angles(
        time=time, position=np.stack([0.5 * time, 0 * time, -8 + 0 * time], axis=1),
        heading=np.full(time.size, np.pi / 2), pitch=np.radians(-20.0) + 0 * time,
        roll=np.radians(10.0) + 0 * time, longest_gap=1.0,
    )  # fmt: skip


def test_a_trajectory_has_a_plan_with_start_end_and_headings(track) -> None:
    figure = trajectories.draw(track)
    assert_allclose(figure.get_size_inches(), [7.2, 4.6])
    plan, *panels = figure.axes
    assert titles(figure)[0].startswith("Plan")
    assert (plan.get_xlabel(), plan.get_ylabel()) == ("east [m]", "north [m]")
    assert plan.get_aspect() == 1
    words = [text.get_text() for text in plan.get_legend().get_texts()]
    assert words == ["start", "end", "heading"]
    (arrows,) = [part for part in plan.collections if hasattr(part, "U")]
    assert_allclose(arrows.U, np.cos(np.radians(20)))
    assert_allclose(arrows.V, 0, atol=1e-9)
    assert arrows.angles == "xy"
    marks = {
        line.get_label(): [*line.get_xdata(), *line.get_ydata()] for line in plan.lines
    }
    assert_allclose(marks["start"], [0, 0], atol=1e-9)
    assert_allclose(marks["end"], [10, 0], atol=1e-9)
    for axis in figure.axes:
        assert any(line.get_visible() for line in axis.get_xgridlines())
    *others, last = panels
    assert last.get_xlabel() == "time since the first pose [s] (gaps in gray)"
    for axis in others:
        assert axis.get_xlabel() == ""
        assert not any(text.get_visible() for text in axis.get_xticklabels())
    assert all(axis.get_shared_x_axes().joined(axis, last) for axis in others)
    names = [text.get_text() for text in last.get_legend().get_texts()]
    assert names == ["pitch", "tilt"]
    assert all(axis.get_legend() is None for axis in others)
    pitch, tilt = (line.get_ydata() for line in last.lines)
    assert_allclose(pitch, -20, atol=1e-6)
    # The upward axis of a body that pitches and rolls.
    both = np.degrees(np.arccos(np.cos(np.radians(20)) * np.cos(np.radians(10))))
    assert_allclose(tilt, both, atol=1e-6)
    heading = panels[2].lines[0].get_ydata()
    assert_allclose(heading, 90, atol=1e-6)
    low, high = last.get_ylim()
    # A third of the span is left at either end for the legend.
    assert high - low == pytest.approx((both + 20) * 1.7)


def test_the_plan_states_the_largest_uncertainty(track) -> None:
    axis = Figure().add_subplot()
    poses = track.at(np.arange(0.0, 20.0, 0.1))
    spread = np.zeros((poses.time.size, 6, 6))
    spread[:, 0, 0], spread[:, 1, 1] = 4e-6, 9e-6
    trajectories._draw_plan(axis, replace(poses, covariance=spread))
    assert (axis.get_title("left") or axis.get_title()) == (
        "Plan; standard uncertainty up to 3 mm"
    )
    other = Figure().add_subplot()
    trajectories._draw_plan(other, replace(poses, covariance=spread + np.inf))
    assert (other.get_title("left") or other.get_title()) == "Plan"


def test_figures_are_written_and_kept(track, tmp_path: Path) -> None:
    path = tmp_path / "track.png"
    trajectories.write_figure(path, track)
    assert path.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(FormatError, match="overwrite"):
        trajectories.write_figure(path, track)
    trajectories.write_figure(path, track, overwrite=True)


BEAM = BeamProfile(
    slant_range=np.linspace(0.5, 2.5, 41), profile=np.full(41, 1e-4), water=None,
    noise=2e-3, surface=np.array([1.5, 2.0]),
    surface_uncertainty=np.array([3e-4, 1e-3]), amplitude=np.array([0.2, 0.1]),
    amplitude_uncertainty=np.array([0.01, 0.02]),
    misfit=1.0, freedom=4, resolution=0.1, unambiguous_span=7.0,
)  # fmt: skip


def test_a_range_profile_has_units_and_a_legend_of_its_surfaces(tmp_path) -> None:
    figure = beam_profile.draw(BEAM, title="t")
    assert_allclose(figure.get_size_inches(), [7.2, 3.0])
    (axis,) = figure.axes
    assert len(axis.lines) == 1 + 2 * 5
    assert (axis.get_xlabel(), axis.get_ylabel()) == (
        "slant range [m]",
        "amplitude [V]",
    )
    assert axis.get_yscale() == "log"
    assert any(line.get_visible() for line in axis.get_xgridlines())
    # The noise, where no profile is above it.
    assert axis.get_ylim() == pytest.approx((2e-3 / 3, 8e-3))
    assert axis.get_xlim() == pytest.approx((0.5, 2.5), abs=1e-9)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "noise level", "target signal", "1: 1.5000 m ± 0.3 mm", "2: 2.0000 m ± 1 mm",
    ]  # fmt: skip
    assert [text.get_text() for text in axis.texts] == ["1", "2"]
    wet = beam_profile.draw(replace(BEAM, water=np.full(41, 1e-3)), title="t")
    assert "subtracted water signal" in [
        text.get_text() for text in wet.legends[0].get_texts()
    ]
    path = tmp_path / "p.SVG"
    beam_profile.write_profile(path, BEAM, title="t")
    assert path.read_bytes().startswith(b"<?xml")
    with pytest.raises(FormatError, match="overwrite"):
        beam_profile.write_profile(path, BEAM, title="t")


def test_a_calibration_has_a_panel_for_each_part_that_was_measured(tmp_path) -> None:
    times = {"modulation_frequency": 40e6, "phases": (0.1, 0.2), "amplitudes": (1, 2)}
    reference = {
        "modulation_frequency": 40e6, "polarization": "VV", "phase": 0.5,
        "uncertainty": 1e-3, "times": (0.0, 60.0), "changes": (0.0, 1e-3),
    }  # fmt: skip
    one = Calibration.model_validate({"reference": [reference]})
    figure = calibration.draw(one)
    assert titles(figure) == ["Drift of the standing reference"]
    assert_allclose(figure.get_size_inches(), [3.2, 2.6])
    single = {**times, "phases": (0.1,), "amplitudes": (1.0,)}
    other = {**single, "modulation_frequency": 60e6, "phases": (0.15,)}
    figure = calibration.draw(
        Calibration.model_validate(
            {"reference": [reference], "frequencies": [single, other]}
        )
    )
    assert len(figure.axes) == 2
    assert_allclose(figure.get_size_inches(), [6.4, 2.6])
    drawn = figure.axes[1].containers[0]
    bars = drawn[2][0].get_segments()
    # Without an error of the phase there is none.
    assert all(np.ptp(part[:, 1]) == 0 for part in bars)
    path = tmp_path / "c.png"
    calibration.write_calibration(path, one)
    with pytest.raises(FormatError, match="overwrite"):
        calibration.write_calibration(path, one)
    calibration.write_calibration(path, one, overwrite=True)


@pytest.mark.parametrize(
    ("value", "rounded"), [(0.5, 1), (1, 1), (1.99, 1), (2, 2), (4.9, 2), (5, 5),
                           (9.9, 5), (10, 10), (499, 200), (500, 500)],
)  # fmt: skip
def test_factors_of_ellipses_are_rounded_down(value, rounded) -> None:
    assert site_plan._rounded_down(value) == rounded


@pytest.mark.parametrize(
    ("place", "inside"),
    [((1, 3), True), ((2, 4), True), ((0.9, 3.5), False), ((2.1, 3.5), False),
     ((1.5, 2.9), False), ((1.5, 4.1), False)],
)  # fmt: skip
def test_a_window_keeps_what_is_on_its_edge(place, inside) -> None:
    assert site_plan._inside(np.array(place), (1, 2, 3, 4)) == inside
    assert site_plan._inside(np.array(place), None)


def test_visits_have_colors_in_turn_without_that_of_contours() -> None:
    site: Any = SimpleNamespace(epoch=[SimpleNamespace(name=f"v{k}") for k in range(8)])
    found = list(site_plan.visit_colours(site).values())
    others = [color for color in COLOURS if color != "#D55E00"]
    assert found == [*others, *others[:2]]


def _placed(error: float) -> tuple[Any, Any, list[Any]]:
    """Two scans of two visits, and their registration with errors of the second."""
    scans: Any = [SimpleNamespace(name=n, epoch=f"visit {n}") for n in "ab"]
    site: Any = SimpleNamespace(
        scan=scans, epoch=[SimpleNamespace(name=f"visit {n}") for n in "ab"]
    )
    poses = {n: SimpleNamespace(position=np.array([x, 1.0, 9.0]))
             for n, x in (("a", 0.0), ("b", 4.0))}  # fmt: skip
    registration: Any = SimpleNamespace(
        poses=poses, points={"T": np.array([2.0, 3.0, 4.0])},
        covariance_of=lambda *names: np.diag(
            [1e-18] * 6 + [error**2, 1e-18, 1.0, 0, 0, 0]),
    )  # fmt: skip
    return site, registration, scans


def test_stations_have_ellipses_of_a_round_factor(monkeypatch) -> None:
    site, registration, scans = _placed(1e-3)
    spread = np.diag([1e-6, 4e-6, 1.0, 0, 0, 0])
    relative = lambda registration, name, first: (name == "b") * spread  # noqa: E731
    monkeypatch.setattr(site_plan, "relative_covariance", relative)
    square = [np.array([[0.0, 0], [1, 0], [1, 1]])]
    found = site_plan.annotations_of(
        site, registration, scans, largest=0.05, outlines={"a": square, "b": []},
        cuts={"A": np.eye(2)},
    )  # fmt: skip
    # 50 mm over 2 mm is 25.
    assert found.enlarged == 20
    assert list(found.stations) == ["a", "b"]
    assert found.stations["b"].position.tolist() == [4.0, 1.0]
    assert_allclose(found.stations["b"].covariance, spread[:2, :2])
    assert [station.colour for station in found.stations.values()] == [
        COLOURS[0], COLOURS[2],
    ]  # fmt: skip
    assert [color for color, _ in found.outlines] == [COLOURS[0], COLOURS[2]]
    assert found.outlines[0][1] is square
    assert found.targets["T"].tolist() == [2.0, 3.0]
    assert list(found.cuts) == ["A"]
    part = site_plan.annotations_of(
        site, registration, scans, largest=0.05, window=(3, 5, 0, 2)
    )
    assert (list(part.stations), list(part.targets)) == (["b"], [])
    assert (list(part.outlines), dict(part.cuts)) == ([], {})


def test_maps_share_a_page_evenly() -> None:
    azimuth, elevation = np.meshgrid(np.radians([0.0, 3, 6]), np.radians([3.0, 0]))
    names = ("row", "column")
    angles = {"azimuth": (names, azimuth), "elevation": (names, elevation)}
    cube = xr.Dataset(coords=angles)
    panels = [
        maps.Map(title=f"title {n} {'w' * 100}", label="m", colours="viridis",
                 values=np.arange(6.0).reshape(2, 3))
        for n in range(3)
    ]  # fmt: skip
    quality = maps.Map(title="q", values=np.array([[0.0, 1, 2]] * 2), label="",
                       colours="quality")  # fmt: skip
    figure = maps.draw_maps([(cube, panel) for panel in (*panels, quality)])
    wide, high = figure.get_size_inches()
    rows, columns, width, height = maps._layout(4, 1 / 2)
    assert (rows, columns) == (2, 2)
    assert wide == pytest.approx(7.2)
    assert high == pytest.approx(2 * (height + 0.74) + 0.04)
    axes, bars = figure.axes[::2], figure.axes[1::2]
    for number, (axis, bar) in enumerate(zip(axes, bars, strict=True)):
        row, column = divmod(number, 2)
        box = axis.get_position()
        left = 3.6 * column + 0.54 + (3.6 - 0.54 - 0.72 - width) / 2
        low = high - (row + 1) * (height + 0.74) + 0.40
        assert_allclose(
            [box.x0 * wide, box.y0 * high, box.width * wide, box.height * high],
            [left, low, width, height],
        )
        beside = bar.get_position()
        assert_allclose([beside.x0 * wide, beside.width * wide],
                        [left + width + 0.06, 0.08])  # fmt: skip
        assert_allclose([beside.y0, beside.height], [box.y0, box.height])
    # 40 letters in a line, and two lines.
    lines = (axes[0].get_title("left") or axes[0].get_title()).split("\n")
    assert len(lines) == 2
    assert max(map(len, lines)) == 40
    ticks = [text.get_text() for text in bars[3].get_yticklabels()]
    assert ticks == ["good", "doubtful", "no range"]
    colors = axes[3].images[0].cmap(axes[3].images[0].norm([0.0, 1.0, 2.0]))
    assert [to_hex(color) for color in colors] == ["#ffffff", "#e69f00", "#d9d9d9"]
    bins = [axes[0].xaxis.get_major_locator()._nbins,
            axes[0].yaxis.get_major_locator()._nbins,
            bars[0].yaxis.get_major_locator()._nbins]  # fmt: skip
    assert bins == [int(width / 0.42), max(2, int(height / 0.4)),
                    max(2, int(height / 0.4))]  # fmt: skip
    assert bars[0].get_ylabel() == "m"


def test_the_style_is_applied_inside_its_block_only() -> None:
    before = mpl.rcParams["font.size"]
    with style():
        assert mpl.rcParams["font.size"] == 8
        assert mpl.rcParams["axes.spines.top"] is False
        assert mpl.rcParams["axes.spines.right"] is False
        assert mpl.rcParams["legend.frameon"] is False
        assert mpl.rcParams["pdf.fonttype"] == 42
    assert mpl.rcParams["font.size"] == before
    assert SETTINGS["svg.fonttype"] == "none"
    assert_allclose(new_figure(3.0, 2.0).get_size_inches(), [3.0, 2.0])
