"""Figures of the report of a site: sizes, scales, labels and the order of its parts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from amulor.errors import FormatError
from amulor.site.change.distances import Change, Region
from amulor.site.change.moved import Motion
from amulor.site.description import ScaleBar
from amulor.site.registration.reliability import Reliability, observation_groups
from amulor.view import site_report, site_residuals
from amulor.view.report import Heading, Paragraph, Picture, Table


class Registration(SimpleNamespace):
    """Registration of scans with the same error of the position along all axes."""

    poses: dict[str, SimpleNamespace]
    error: float

    def covariance_of(self, *names: str) -> np.ndarray:
        size = sum(6 if name.startswith("pose") else 3 for name in names)
        return self.error**2 * np.eye(size)


def registration_of(error: float, **places: tuple[float, ...]) -> Registration:
    poses = {
        name: SimpleNamespace(position=np.array(place))
        for name, place in places.items()
    }
    return Registration(
        poses=poses, error=error, points={}, settled=True, fixed="a", unchecked=(),
        scale=(), reliability=(), pairs=(), disagreements=(), weaknesses=(),
    )  # fmt: skip


def site_of(registration: Registration, **fields: object) -> SimpleNamespace:
    scans = [SimpleNamespace(name=name, epoch="one") for name in registration.poses]
    return SimpleNamespace(
        name="Wreck", scan=scans, epoch=[SimpleNamespace(name="one")], target=[],
        frame=SimpleNamespace(crs=""), **fields,
    )  # fmt: skip


def cloud_of(count: int) -> SimpleNamespace:
    """Cloud of points whose largest standard uncertainties are 1, 2, 3, ... mm."""
    largest = 1e-3 * np.arange(1.0, count + 1)
    sigma = largest[:, None] * [0.5, 0.2, 1.0]
    return SimpleNamespace(
        position=np.outer(np.arange(1.0, count + 1), [2.0, -1.0, 0.0]),
        scan=np.arange(count) % 2, confirmed=np.ones(count), sigma=sigma,
        moving=np.zeros(count, bool), covariance=sigma[:, :, None] ** 2 * np.eye(3),
    )  # fmt: skip


@pytest.fixture
def near_labels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave labels of ellipses where they are, which saves drawing them."""
    monkeypatch.setattr(site_report, "separate", lambda *_: None)


#: Two scans 3 m apart, 0.5 m in north and up.
APART = {"a": (1.0, 2.0, -3.0), "b": (4.0, 2.5, -3.5)}


@pytest.mark.parametrize(
    ("error", "words"),
    # A twentieth of 3 m over the largest error, rounded down to 1, 2, 5.
    [(0.07, "2 times: 0.02 m on the axes for 10 mm"),
     (0.029, "5 times: 0.05 m on the axes for 10 mm"),
     (0.0149, "10 times: 0.1 m on the axes for 10 mm"),
     (0.0071, "20 times: 0.02 m on the axes for 1 mm"),
     (1.0, "0.1 times: 0.1 m on the axes for 1000 mm")],
)  # fmt: skip
def test_the_title_of_ellipses_states_their_factor(
    error: float, words: str, near_labels: None
) -> None:
    registration = registration_of(error, **APART)
    figure = site_report.ellipses(site_of(registration), registration)
    (legend,) = figure.legends
    assert legend.get_title().get_text() == f"Ellipses enlarged {words}"
    (first, second) = (p for p in figure.axes[0].patches if hasattr(p, "angle"))
    factor = float(words.split()[0])
    assert first.width == second.width == pytest.approx(2 * factor * error)


def test_panels_of_ellipses_have_labels_and_the_shape_of_the_site() -> None:
    registration = registration_of(0.01, **APART)
    site = site_of(registration)
    figure = site_report.ellipses(site, registration)
    plan, profile = figure.axes
    # 3 m and 0.5 m with 0.36 m on either side; 6.2 inches wide.
    assert_allclose(figure.get_size_inches(), [7, 6.2 * 2 * 1.22 / 3.72 + 1.3])
    assert [axes.get_title("left") or axes.get_title() for axes in figure.axes] == [
        "Plan", "Profile",
    ]  # fmt: skip
    assert (plan.get_ylabel(), profile.get_ylabel()) == ("north [m]", "up [m]")
    assert (plan.get_xlabel(), profile.get_xlabel()) == ("", "east [m]")
    for axes, height in ((plan, (2.0, 2.5)), (profile, (-3.0, -3.5))):
        assert axes.get_aspect() == 1
        assert any(line.get_visible() for line in axes.get_xgridlines())
        assert not axes.xaxis.get_major_formatter().get_useOffset()
        dots = [line.get_xydata().tolist() for line in axes.lines]
        assert dots[:2] == [[[1.0, height[0]]], [[4.0, height[1]]]]
        assert [text.get_text() for text in axes.texts] == ["a", "b"]
        # Labels stand beside their places, not at the first offset of all.
        offsets = [text.get_position() for text in axes.texts]
        assert all(offset != (8, 8) for offset in offsets)
    handles = plan.get_legend_handles_labels()[1]
    assert handles == ["scans"]
    registration.points = {"T": np.array([2.0, 2.0, -3.0])}
    figure = site_report.ellipses(site, registration)
    assert figure.axes[0].get_legend_handles_labels()[1] == ["scans", "targets"]


@pytest.mark.parametrize(
    ("place", "high"), [((10.0, 0.0, 0.0), 3.7), ((0.0, 10.0, 10.0), 11.0)]
)
def test_a_figure_of_ellipses_fits_a_page(place, high, near_labels) -> None:
    registration = registration_of(1e-3, a=(0.0, 0.0, 0.0), b=place)
    figure = site_report.ellipses(site_of(registration), registration)
    assert figure.get_size_inches()[1] == pytest.approx(high)


def test_a_single_scan_has_ellipses_around_its_place(near_labels) -> None:
    registration = registration_of(1e-3, a=(1.0, 2.0, 3.0))
    figure = site_report.ellipses(site_of(registration), registration)
    # As of a site of 0.1 m: a pad of 12 mm, and a factor of 5.
    assert figure.axes[0].get_xlim() == pytest.approx((0.988, 1.012))
    assert "enlarged 5 times" in figure.legends[0].get_title().get_text()


def test_the_map_of_errors_has_its_scale_and_units() -> None:
    figure = site_report.errors(cloud_of(1001))
    plan, histogram, bar = figure.axes
    assert_allclose(figure.get_size_inches(), [7.0, 3.4])
    (points,) = plan.collections
    # One percent of 1 to 1001 mm on either side.
    assert points.get_clim() == pytest.approx((11, 991))
    assert points.get_cmap().name == "cividis"
    assert points.get_rasterized()
    assert points.get_sizes().tolist() == [0.6]
    assert (plan.get_xlabel(), plan.get_ylabel()) == ("east [m]", "north [m]")
    assert plan.get_aspect() == 1
    assert bar.get_ylabel() == "standard uncertainty [mm]"
    assert histogram.get_xlabel() == "standard uncertainty [mm]"
    assert histogram.get_ylabel() == "points shown"
    bars = histogram.patches
    assert bars[0].get_x() == 0
    last = bars[-1].get_x() + bars[-1].get_width()
    assert last == pytest.approx(996)


def _change(value: np.ndarray, **fields: object) -> Change:
    count = len(value)
    stated = {
        "uncertainty": np.full(count, 1e-3), "significant": np.abs(value) > 2e-3,
        "spacing": 0.01, **fields,
    }  # fmt: skip
    return Change(
        epochs=("one", "two"), position=np.arange(3.0 * count).reshape(-1, 3),
        normal=np.tile([0.0, 0, 1], (count, 1)), value=value, own=np.full(count, 1e-3),
        shape=np.zeros(count), shared=np.zeros((count, 1)), chance=np.ones(count),
        area=np.full(count, 1e-4), radius=0.015, false_alarms=0.05, **stated,
    )  # fmt: skip


def _region(*centre: float, reach: float = 0.1) -> Region:
    return Region(
        members=np.arange(2), centre=np.array(centre), reach=reach, area=12e-4,
        area_uncertainty=3e-4, mean=1.5e-3, mean_uncertainty=2e-4, largest=2e-3,
        volume=7e-6, volume_uncertainty=2e-6, lost=5e-4,
    )  # fmt: skip


def test_the_map_of_changes_has_labels_dots_and_a_legend() -> None:
    figure = site_report.change_map(_change(np.array([4e-3, 0.5e-3])), [])
    plan, histogram, bar = figure.axes
    assert_allclose(figure.get_size_inches(), [7.0, 3.6])
    still, sure = plan.collections
    assert (still.get_sizes().tolist(), sure.get_sizes().tolist()) == ([3.0], [12.0])
    assert {part.get_cmap().name for part in plan.collections} == {"RdBu_r"}
    assert {part.get_linewidths()[0] for part in plan.collections} == {0}
    assert bar.get_ylabel() == "change along the normal [mm]"
    assert (plan.get_xlabel(), plan.get_ylabel()) == ("east [m]", "north [m]")
    assert (len(plan.patches), len(plan.texts)) == (0, 0)
    assert histogram.get_xlabel() == "change over its uncertainty"
    assert list(histogram.get_yticks()) == []
    words = [text.get_text() for text in histogram.get_legend().get_texts()]
    assert words == ["measured", "without change"]
    bars = [patch.get_x() for patch in histogram.patches]
    assert len(bars) == 60
    assert bars[0] == pytest.approx(-6)


def test_changes_beyond_six_standard_uncertainties_are_in_the_last_bars() -> None:
    figure = site_report.change_map(_change(np.array([-0.05, 0.05, 0.0])), [])
    counts = [bar.get_height() for bar in figure.axes[1].patches]
    assert np.flatnonzero(counts).tolist() == [0, 30, 59]


def test_colors_of_no_change_have_limits() -> None:
    figure = site_report.change_map(_change(np.zeros(3)), [])
    assert figure.axes[0].collections[0].get_clim() == (-1e-3, 1e-3)


@pytest.mark.parametrize(
    ("spacing", "margin"), [(0.01, 1.1), (0.3, 1.5)]
)  # fmt: skip
def test_the_map_of_changes_shows_all_regions_with_a_margin(spacing, margin) -> None:
    change = _change(np.array([4e-3, 5e-3]), spacing=spacing)
    places = [_region(1.0, 2.0, 0.0), _region(3.0, 2.5, 0.0)]
    plan = site_report.change_map(change, places).axes[0]
    # From 0.9 to 3.1 m: half of 2.2 m, or five spacings.
    assert plan.get_xlim() == pytest.approx((0.9 - margin, 3.1 + margin))
    assert plan.get_ylim() == pytest.approx((1.9 - margin, 2.6 + margin))
    assert [text.get_text() for text in plan.texts] == ["1", "2"]
    assert plan.texts[1].xy == pytest.approx((3.1, 2.6))
    assert not any(ring.get_fill() for ring in plan.patches)


def test_the_summary_names_what_is_left_out() -> None:
    registration = registration_of(1e-3, **APART)
    site = site_of(registration)
    registration.unchecked = (
        SimpleNamespace(scan="c", reason="no overlap"),
        SimpleNamespace(scan="b", reason="a reason that is none"),
    )
    cloud = cloud_of(1200)
    cloud.moving[:3], cloud.confirmed[:2] = True, 0
    assert site_report._summary(site, registration, cloud) == (
        "2 scans of 1 visits, 1,200 points, 1,198 of them seen by several scans of a "
        "visit, 3 seen through by others and left out of comparisons. The frame is "
        "that of a; nothing ties it to the world. Left out is c: no overlap. "
        "Uncertainties are standard uncertainties (k = 1)."
    )
    site.frame.crs, registration.settled = "EPSG:25832", False
    text = site_report._summary(site, registration, cloud)
    assert " Reference system: EPSG:25832. The fit did not settle." in text


@pytest.mark.parametrize(
    ("count", "words"), [(12, "All pairs: "),
                         (13, "The 12 of 13 pairs with the largest scatter: ")],
)  # fmt: skip
def test_the_caption_of_residuals_says_how_many_are_shown(count, words) -> None:
    pair = site_residuals.PairResiduals(
        source="b", target="a", shape=(4, 4), pixel=np.arange(16),
        distance=np.full(16, 1e-3), score=np.ones(16),
    )  # fmt: skip
    (picture,) = site_report._residuals([pair] * count)
    assert picture.caption.startswith(words)
    assert site_report._residuals([]) == []


def _line(observation: str, part: str, **fields: object) -> Reliability:
    stated = {
        "residual": 0.5e-3, "uncertainty": 1e-3, "redundancy": 0.5, "score": 0.7,
        "detectable": 6e-3, "external": 2e-3, "external_scan": "a", **fields,
    }  # fmt: skip
    return Reliability(observation=observation, part=part, **stated)


def test_scale_bars_are_listed_with_their_lengths() -> None:
    bar = ScaleBar.model_construct(name="s", ends=("S1", "S2"), length=1.25)
    site = SimpleNamespace(target=[SimpleNamespace(name="S1"), bar])
    lines = [_line("bar S1 S2", "length"), _line("bar S1 S3", "length", external=None)]
    (group,) = observation_groups(lines)
    table = site_report._observations(site, group, lines)
    assert table.header[:2] == ["bar", "length [m]"]
    assert table.header[2:4] == ["stated u [mm]", "residual [mm]"]
    assert table.rows == [
        ["S1 S2", "1.2500", "1.00", "+0.500", "0.50", "+0.70", "6.00", "2.00", "a"],
        ["S1 S3", "nan", "1.00", "+0.500", "0.50", "+0.70", "6.00", "-", "a"],
    ]
    assert "reliability. A dash marks values" in table.caption
    assert "unit u" not in table.caption


def test_shared_errors_are_listed_in_their_own_uncertainties() -> None:
    lines = [_line("error shape 1: a1", "", residual=0.4, uncertainty=1.0)]
    (group,) = observation_groups(lines)
    table = site_report._observations(SimpleNamespace(target=[]), group, lines)
    assert table.header[:3] == ["error", "stated u [u]", "residual [u]"]
    assert table.rows[0][:3] == ["shape 1: a1", "1.00", "+0.400"]
    assert table.caption.endswith("shape 1 is the largest independent part.")


def test_angles_are_listed_in_milliradians_and_the_network_has_its_scale(
    near_labels,
) -> None:
    registration = registration_of(1e-3, **APART)
    site = site_of(registration)
    registration.reliability = [_line("start a", "about up", score=9.0, external=None)]
    heading, picture, histograms, summary, values = site_report._network(
        site, registration, []
    )
    assert heading.text == "Network"
    assert isinstance(picture, Picture)
    assert isinstance(histograms, Picture)
    assert summary.rows[0][4].startswith("!+9.00 of ")
    assert summary.rows[0][6:] == ["6.00 mrad", "-"]
    assert values.header[2] == "stated u [mrad]"
    assert values.rows[0][2:6] == ["1.00", "+0.500", "0.50", "!+9.00"]
    registration.scale = [
        SimpleNamespace(
            bar="S1 S2", length=1.0, length_uncertainty=1e-4, measured=1.0,
            measured_uncertainty=1e-4, scale=1.0, scale_uncertainty=1e-4, score=0.5,
            chance=0.6, group_index=None, stated_index=None,
        )
    ]  # fmt: skip
    *_, scale = site_report._network(site, registration, [])
    assert scale.header[0] == "bar"
    registration.reliability = []
    assert site_report._network(site, registration, []) == []


def test_motions_that_a_shape_does_not_show_are_named() -> None:
    free = np.array([0, 0, 0, 0, 0, 1.0])
    motion = Motion(
        centre=np.zeros(3), shift=np.array([0.003, 0.0, -0.004]), turn=np.zeros(3),
        covariance=1e-6 * np.eye(6), loose=(free,), points=100, misfit=1.0,
    )  # fmt: skip
    change = _change(np.array([4e-3, 5e-3]))
    places = [_region(0.0, 0.0, 0.0)] * 4
    *_, areas, motions = site_report._changed(
        change, places, {1: motion, 3: motion, 2: "too few points"}
    )
    assert len(areas.rows) == 4
    assert motions.rows == [
        ["2", "5.00 ± 1.00", "+3.00, +0.00, -4.00", "0.00 ± 0.00",
         "0.000, 0.000, 0.000", "turn about (+0.00, +0.00, +1.00)"],
        ["3", "-", "", "", "", "too few points"],
        ["4", "as place 2", "", "", "", ""],
    ]  # fmt: skip


def test_the_report_of_a_site_has_its_parts_in_order(monkeypatch, tmp_path) -> None:
    registration = registration_of(1e-3, **APART)
    site = site_of(registration)
    plans = lambda *_: (Figure(figsize=(1, 1)), 20.0)  # noqa: E731
    monkeypatch.setattr(site_report, "plan_figure", plans)
    taken = {}

    def keep(path, title, parts, *, overwrite):
        taken.update(title=title, parts=parts, overwrite=overwrite)

    with monkeypatch.context() as patched:
        patched.setattr(site_report, "write_report", keep)
        site_report.write(
            tmp_path / "r.html", site, registration, cloud_of(5), scans=[],
            change=_change(np.array([4e-3, 5e-3])), places=[_region(1.0, 2.0, 0.0)],
            motions={0: "too few points"}, overwrite=True,
        )  # fmt: skip
    assert (taken["title"], taken["overwrite"]) == ("Wreck", True)
    parts = taken["parts"]
    assert [part.text for part in parts if isinstance(part, Heading)] == [
        "Plan", "Poses", "Points", "Change from one to two",
    ]  # fmt: skip
    assert [type(part) for part in parts] == [
        Paragraph, Heading, Picture, Heading, Table, Table, Heading, Picture, Table,
        Heading, Paragraph, Picture, Table, Table,
    ]  # fmt: skip
    assert "enlarged 20 times" in parts[2].caption
    assert parts[-1].rows == [["1", "-", "", "", "", "too few points"]]
    path = tmp_path / "site.html"
    for _ in range(2):
        site_report.write(path, site, registration, cloud_of(5), scans=[],
                          overwrite=path.exists())  # fmt: skip
    assert "Change from" not in path.read_text()
    with pytest.raises(FormatError, match="overwrite"):
        site_report.write(path, site, registration, cloud_of(5), scans=[])
