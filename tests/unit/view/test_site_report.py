"""Numbers in the report on a site are those of its registration, cloud and change.

Each table is read back, and compared with the fields it was made from, in its units.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.patches import Ellipse
from numpy.testing import assert_allclose

from amulor.site.change.distances import Change, Region
from amulor.site.change.moved import Motion
from amulor.site.registration.reliability import Reliability, observation_groups
from amulor.view import site_report
from amulor.view.report import Paragraph, Picture, Table

#: Standard uncertainties of the scans a and b: east, north, up [m], turns [rad].
SIGMA = {
    "a": np.array([1e-3, 2e-3, 3e-3, 4e-4, 5e-4, 6e-4]),
    "b": np.array([7e-3, 8e-3, 9e-3, 1e-4, 2e-4, 3e-4]),
}


def numbers(cells: list[str]) -> list[float]:
    return [float(cell) for cell in cells]


class Placed(SimpleNamespace):
    """Registration of two scans whose poses have independent errors."""

    def covariance_of(self, *names: str) -> np.ndarray:
        parts = [SIGMA[name.partition(" ")[2]] for name in names if "pose" in name]
        if not parts:
            return np.diag([1e-6, 4e-6, 9e-6])
        return np.diag(np.concatenate(parts) ** 2)


@pytest.fixture
def registration() -> Placed:
    poses = {
        "a": SimpleNamespace(position=np.array([1.0, 2.0, -3.0])),
        "b": SimpleNamespace(position=np.array([4.0, 2.5, -3.5])),
    }
    pair = {
        "source": "a", "target": "b", "points": 1234, "median_distance_m": 1.25e-3,
        "misfit": 1.07, "moved_points": 17, "loose": (),
    }  # fmt: skip
    return Placed(
        poses=poses, points={"S1": np.array([2.0, 2.0, -3.0])}, settled=True, fixed="a",
        unchecked=(), scale=(), reliability=(),
        pairs=(pair, {**pair, "source": "b", "target": "a", "loose": ("x", "y", "z")}),
        disagreements=(
            {"scans": ("a", "b"), "shift": 2.5e-3, "turn": 1.5e-3, "trust": 0.25},
        ),
        weaknesses=(
            SimpleNamespace(
                scan="b", shift=np.array([1e-3, -2e-3, 0.5e-3]),
                turn=np.array([1e-4, 2e-4, -3e-4]),
            ),
        ),
    )  # fmt: skip


@pytest.fixture
def site() -> SimpleNamespace:
    scans = [SimpleNamespace(name=name, epoch="one") for name in "ab"]
    return SimpleNamespace(
        name="Wreck", scan=scans, epoch=[SimpleNamespace(name="one")], target=[],
        frame=SimpleNamespace(crs="EPSG:25832"),
    )  # fmt: skip


@pytest.fixture
def cloud() -> SimpleNamespace:
    rng = np.random.default_rng(1)
    count = 400
    sigma = (
        np.tile([1e-3, 2e-3, 3e-3], (count, 1))
        * (1 + (np.arange(count) >= 300))[:, None]
    )
    return SimpleNamespace(
        position=rng.uniform(0, 1, (count, 3)), scan=(np.arange(count) >= 300) * 1,
        confirmed=(np.arange(count) % 4 > 0) * 2, moving=np.arange(count) % 100 == 7,
        sigma=sigma, covariance=sigma[:, :, None] ** 2 * np.eye(3),
    )  # fmt: skip


def test_poses_have_the_uncertainties_of_the_registration(site, registration) -> None:
    table = site_report._poses(site, registration)
    assert all(len(row) == len(table.header) for row in table.rows)
    for row, (name, sigma) in zip(table.rows, SIGMA.items(), strict=True):
        assert row[:2] == [name, "one"]
        assert numbers(row[2:5]) == pytest.approx(registration.poses[name].position)
        assert numbers(row[5:11]) == pytest.approx(1e3 * sigma)
    # Of b against a: both variances, and the turns of a over the arm of 3, 0.5 and
    # -0.5 m, which move b by the cross product.
    arm = np.array([3.0, 0.5, -0.5])
    cross = np.cross(np.eye(3), arm).T
    shift = np.diag(SIGMA["a"][:3] ** 2 + SIGMA["b"][:3] ** 2)
    shift += cross @ np.diag(SIGMA["a"][3:] ** 2) @ cross.T
    expected = 1e3 * np.sqrt(np.linalg.eigvalsh(shift)[-1])
    assert numbers(table.rows[1][11:])[0] == pytest.approx(expected, abs=0.006)
    turn = 1e3 * np.sqrt(SIGMA["a"][5] ** 2 + SIGMA["b"][5] ** 2)
    assert numbers(table.rows[1][11:])[1] == pytest.approx(turn, abs=0.006)


def test_pairs_and_warnings_have_the_numbers_of_the_fit(registration) -> None:
    table = site_report._pairs(registration)
    assert table.rows[0] == ["a on b", "1234", "1.25", "1.07", "17", "6"]
    assert table.rows[1][5] == "!3"
    contradiction, weak = (part.text for part in site_report._warnings(registration))
    assert contradiction == (
        "a on b contradicts all others by 2.50 mm and 1.500 mrad; it counts 25%."
    )
    assert "(1.0, -2.0, 0.5) mm with a turn of (0.10, 0.20, -0.30) mrad" in weak


def test_the_summary_counts_scans_and_points(site, registration, cloud) -> None:
    text = site_report._summary(site, registration, cloud)
    # Three quarters of 400 points are confirmed, and one of a hundred moves.
    assert text.startswith(
        "2 scans of 1 visits, 400 points, 300 of them seen by several scans of a "
        "visit, 4 seen through"
    )
    assert "The frame is that of a; nothing ties it to the world." in text
    assert "did not settle" not in text
    registration.settled, registration.fixed = False, None
    other = site_report._summary(site, registration, cloud)
    assert "The fit did not settle." in other
    assert "ties it" not in other
    table = site_report._scans(site, cloud)
    assert table.rows == [
        ["a", "300", "75%", "!3", "1.00", "2.00", "3.00"],
        ["b", "100", "75%", "!1", "2.00", "4.00", "6.00"],
    ]


def test_the_map_of_errors_shows_the_longest_axis_of_still_points(cloud) -> None:
    figure = site_report.errors(cloud)
    (points,) = figure.axes[0].collections
    still = ~cloud.moving
    assert_allclose(points.get_offsets(), cloud.position[still, :2])
    assert_allclose(points.get_array(), 3 + 3.0 * (cloud.scan[still] == 1))
    heights = [bar.get_height() for bar in figure.axes[1].patches]
    assert len(heights) == 60
    assert sum(heights) == still.sum()
    assert site_report._thinned(np.arange(60_000)).size == 60_000
    assert site_report._thinned(np.arange(180_001)).size == 60_001


def test_ellipses_are_enlarged_by_a_round_factor(site, registration) -> None:
    figure = site_report.ellipses(site, registration)
    plan, profile = figure.axes
    # The site is 3 m wide, the largest error is 9 mm: 0.05 * 3 / 0.009 = 16.7, or 10.
    (legend,) = figure.legends
    words = legend.get_title().get_text()
    assert words == "Ellipses enlarged 10 times: 0.01 m on the axes for 1 mm"
    for axes, second in ((plan, 1), (profile, 2)):
        drawn = [patch for patch in axes.patches if isinstance(patch, Ellipse)]
        sizes = {
            tuple(np.round(patch.center, 6)): sorted((patch.width, patch.height))
            for patch in drawn
        }
        for name, sigma in SIGMA.items():
            place = registration.poses[name].position[[0, second]]
            expected = sorted(2 * 10 * sigma[[0, second]])
            assert sizes[tuple(place)] == pytest.approx(expected)
        assert len(drawn) == 3
        low, high = axes.get_xlim()
        assert (low, high) == pytest.approx((1 - 0.36, 4 + 0.36))
    assert plan.get_ylim() == pytest.approx((2 - 0.36, 2.5 + 0.36))
    assert profile.get_ylim() == pytest.approx((-3.5 - 0.36, -3 + 0.36))


def _change() -> Change:
    value = np.array([4e-3, -3e-3, 0.5e-3, np.nan, 0.0])
    return Change(
        epochs=("one", "two"), position=np.arange(15.0).reshape(5, 3),
        normal=np.tile([0.0, 0, 1], (5, 1)), value=value,
        uncertainty=np.array([1e-3, 1e-3, 1e-3, np.nan, 0.2e-3]), own=np.full(5, 1e-3),
        shape=np.zeros(5), shared=np.zeros((5, 1)), significant=np.abs(value) > 2e-3,
        chance=np.ones(5), area=np.full(5, 1e-4), spacing=0.01, radius=0.015,
        false_alarms=0.05,
    )  # fmt: skip


REGION = Region(
    members=np.arange(2), centre=np.array([1.0, 2.0, -3.0]), reach=0.1, area=12e-4,
    area_uncertainty=3e-4, mean=1.5e-3, mean_uncertainty=2e-4, largest=2e-3,
    volume=7e-6, volume_uncertainty=2e-6, lost=5e-4,
)  # fmt: skip


def test_changes_have_the_numbers_of_their_regions() -> None:
    motion = Motion(
        centre=np.array([1.0, 2.0, -3.0]), shift=np.array([0.03, -0.04, 0.0]),
        turn=np.array([0.0, 0.0, np.radians(2.0)]),
        covariance=np.diag([1e-6] * 3 + [np.radians(0.1) ** 2] * 3), loose=(),
        points=100, misfit=1.0,
    )  # fmt: skip
    parts = site_report._changed(_change(), [REGION, REGION], {0: motion, 1: motion})
    heading, text, picture, areas, motions = parts
    assert heading.text == "Change from one to two"
    assert isinstance(text, Paragraph)
    assert isinstance(picture, Picture)
    assert text.text == (
        "4 places 10 mm apart were compared, in cylinders of 15 mm radius; 2 changed, "
        "of which at most 5% by chance. Median standard uncertainty 1.00 mm, poses "
        "included."
    )
    expected = ["1.00, 2.00, -3.00", "12 ± 3", "+1.50 ± 0.20", "+7 ± 2", "5"]
    assert isinstance(areas, Table)
    assert areas.rows == [["1", *expected], ["2", *expected]]
    assert isinstance(motions, Table)
    assert motions.rows == [
        ["1", "50.00 ± 1.00", "+30.00, -40.00, +0.00", "2.00 ± 0.10",
         "1.000, 2.000, -3.000", "-"],
        ["2", "as place 1", "", "", "", ""],
    ]  # fmt: skip
    *_, nothing = site_report._changed(_change(), [], {})
    assert nothing.text == "No place changed."
    assert site_report._changed(_change(), [REGION], {})[-1].rows == areas.rows[:1]


def test_the_map_of_changes_has_small_and_large_dots() -> None:
    change = _change()
    figure = site_report.change_map(change, [REGION])
    still, sure = figure.axes[0].collections
    assert_allclose(still.get_array(), [0.5, 0.0])
    assert_allclose(sure.get_array(), [4.0, -3.0])
    limit = np.quantile([4.0, 3.0, 0.5, 0.0], 0.995)
    assert still.get_clim() == sure.get_clim() == pytest.approx((-limit, limit))
    assert_allclose(sure.get_offsets(), change.position[:2, :2])
    (ring,) = figure.axes[0].patches
    assert ring.center == (1.0, 2.0)
    assert ring.radius == pytest.approx(0.115)
    # The region and a margin of half its size, or of five spacings.
    assert figure.axes[0].get_xlim() == pytest.approx((0.9 - 0.1, 1.1 + 0.1))
    assert figure.axes[0].get_ylim() == pytest.approx((1.9 - 0.1, 2.1 + 0.1))
    (label,) = figure.axes[0].texts
    assert (label.get_text(), label.xy) == ("1", pytest.approx((1.1, 2.1)))
    # Scores 4, -3, 0.5 and 0 in bars of a fifth; all of them together are 1.
    bars = [bar for bar in figure.axes[1].patches if bar.get_height() > 0]
    assert [bar.get_x() for bar in bars] == pytest.approx(
        [-3.0, 0.0, 0.4, 4.0], abs=0.11
    )
    assert sum(bar.get_height() * bar.get_width() for bar in bars) == pytest.approx(1)
    (curve,) = figure.axes[1].lines
    at, height = curve.get_data()
    assert (at[0], at[-1]) == (-6, 6)
    assert_allclose(np.trapezoid(height, at), 1, rtol=1e-3)
    assert height.max() == pytest.approx(0.3989, abs=1e-4)


def test_the_network_has_the_reliability_of_each_value(site, registration) -> None:
    lines = [
        Reliability(
            observation="start a", part="east", residual=2e-3, uncertainty=1e-3,
            redundancy=0.25, score=1.5, detectable=9e-3, external=4e-3,
            external_scan="b",
        ),
        Reliability(
            observation="start b", part="east", residual=-8e-3, uncertainty=1e-3,
            redundancy=0.75, score=-6.5, detectable=5e-3, external=2e-3,
            external_scan="a",
        ),
        Reliability(
            observation="start b", part="up", residual=0.0, uncertainty=3e-3,
            redundancy=0.0, score=0.0, detectable=None,
        ),
    ]  # fmt: skip
    (group,) = observation_groups(lines)
    assert group.count == 3
    assert group.unchecked == 1
    table = site_report._observations(site, group, lines)
    assert table.rows == [
        ["a", "east", "1.00", "+2.000", "0.25", "+1.50", "9.00", "4.00", "b"],
        ["b", "east", "1.00", "-8.000", "0.75", "!-6.50", "5.00", "2.00", "a"],
        ["b", "up", "3.00", "+0.000", "0.00", "-", "-", "-", "-"],
    ]
    assert len(table.header) == 9
    registration.reliability = lines
    heading, _, _, summary, values = site_report._network(site, registration, [])
    assert heading.text == "Network"
    assert summary.rows == [
        [group.group, "3", "1", "0.33", f"!-6.50 of {group.limit:.2f}",
         "start b, east", "9.00 mm", "4.00"]
    ]  # fmt: skip
    # One false alarm in 1,000 over three values, both tails: 3.59.
    assert group.limit == pytest.approx(3.588, abs=1e-3)
    assert values.rows == table.rows


def test_the_scale_by_a_bar_has_both_lengths() -> None:
    test = SimpleNamespace(
        bar="S1 S2", length=1.0, length_uncertainty=1e-4, measured=1.002,
        measured_uncertainty=4e-4, scale=1.002, scale_uncertainty=4.1e-4, score=4.85,
        chance=1e-6, group_index=1.3772, group_index_uncertainty=6e-4,
        stated_index=1.38, stated_index_uncertainty=1e-3,
    )  # fmt: skip
    unknown = SimpleNamespace(
        **{**vars(test), "group_index": None, "stated_index": None, "chance": 0.01}
    )
    table = site_report._scale(SimpleNamespace(scale=[test, unknown]))
    lengths = ["1000.00 ± 0.10", "1002.00 ± 0.40", "1.002000 ± 0.000410"]
    assert table.rows == [
        ["S1 S2", *lengths, "!+4.85", "1.37720 ± 0.00060", "1.38000 ± 0.00100"],
        ["S1 S2", *lengths, "+4.85", "-", "-"],
    ]
    assert len(table.header) == 7
