"""Tables and figures of the report of a site: residuals of scan pairs, changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_sites import known_registration, one_visit
from numpy.testing import assert_allclose

from amulor.site.change.distances import Change, Region
from amulor.site.registration.reliability import Reliability, observation_groups
from amulor.view import site_report
from amulor.view.site_residuals import (
    PairResiduals,
    cell_means,
    pair_residuals,
    residual_histograms,
    residual_maps,
)


def residuals_of(distance: np.ndarray, pixel: np.ndarray) -> PairResiduals:
    """Residuals of a pair of scans of 64 x 64 pixels, with a noise of 1 mm."""
    return PairResiduals(
        source="b", target="a", shape=(64, 64), pixel=pixel, distance=distance,
        score=distance / 1e-3,
    )  # fmt: skip


def test_a_cell_of_a_map_has_the_mean_distance_of_its_pixels() -> None:
    pixel = np.arange(64 * 32)
    pair = residuals_of(1e-3 * (pixel // 64), pixel)
    means, side = cell_means(pair)
    # 32 cells of two rows along a side; the lower half is not compared.
    assert side == 2
    assert_allclose(means[:16], np.tile(1e-3 * (2 * np.arange(16) + 0.5), (32, 1)).T)
    assert np.isnan(means[16:]).all()
    assert pair.scatter == pytest.approx(np.sqrt(31 * 63 / 6))  # sum of squares


def test_scores_of_a_pair_at_true_poses_are_standard_normal() -> None:
    drawn = one_visit("bed", 3, rows=36)
    registration = replace(
        known_registration(drawn), pairs=({"source": "a2", "target": "a1"},)
    )
    (pair,) = pair_residuals(registration, drawn.surfaces)
    assert (pair.source, pair.target) == ("a2", "a1")
    assert len(pair.score) > 200
    # Scans share the errors of delay and water; their references differ by 0.5 mm.
    assert pair.score.std() == pytest.approx(1, abs=0.15)
    assert pair_residuals(registration, {"a1": drawn.surfaces["a1"]}) == ()


def test_figures_show_at_most_twelve_pairs_and_only_checked_values() -> None:
    rng = np.random.default_rng(1)
    pixel = np.arange(64**2)
    pairs = [residuals_of(1e-3 * rng.normal(size=64**2), pixel) for _ in range(13)]
    maps = [axes for axes in residual_maps(pairs).axes if axes.images]
    assert len(maps) == 12
    values = Reliability(
        observation="error shape 1: a1", part="", residual=0.4, uncertainty=1.0,
        redundancy=0.5, score=0.6, detectable=5.8, external=1e-3, external_scan="a2",
    )  # fmt: skip
    free = replace(values, detectable=None, score=0.0)
    _, axes = residual_histograms(pairs, [values, free]).axes
    bars = [patch.get_height() for patch in axes.patches]
    assert sum(bars) == 1
    # The single value has a residual of 0.6, in the bar from 0.5 to 1.
    (bar,) = [patch for patch in axes.patches if patch.get_height() > 0]
    assert bar.get_x() == pytest.approx(0.5)


def test_errors_without_a_unit_are_given_in_stated_uncertainties() -> None:
    line = Reliability(
        observation="error shape 1: a1", part="", residual=0.4, uncertainty=1.0,
        redundancy=0.5, score=0.6, detectable=5.8, external=1e-3, external_scan="a2",
    )  # fmt: skip
    (group,) = observation_groups([line])
    assert site_report._detectable(group) == "5.80 u"
    assert site_report._detectable(replace(group, detectable=None)) == "-"
    angles = replace(group, unit="rad", detectable=2e-3)
    assert site_report._detectable(angles) == "2.00 mrad"


def test_motions_have_a_table_of_their_own() -> None:
    values = np.array([1e-3, 2e-3, 0.0, np.nan])
    change = Change(
        epochs=("one", "two"), position=np.eye(4, 3), normal=np.eye(4, 3), value=values,
        uncertainty=np.full(4, 1e-3), own=np.full(4, 1e-3), shape=np.zeros(4),
        shared=np.zeros((4, 1)), significant=values > 0, chance=np.ones(4),
        area=np.full(4, 1e-4), spacing=0.01, radius=0.015, false_alarms=0.05,
    )  # fmt: skip
    place = Region(
        members=np.arange(2), centre=np.zeros(3), reach=0.1, area=2e-4,
        area_uncertainty=1e-4, mean=1.5e-3, mean_uncertainty=1e-4, largest=2e-3,
        volume=3e-7, volume_uncertainty=1e-6, lost=1e-4,
    )  # fmt: skip
    _, _, _, areas, motions = site_report._changed(
        change, [place, place], {1: "too few points"}
    )
    assert [row[2] for row in areas.rows] == ["2 ± 1", "2 ± 1"]
    assert motions.rows == [["2", "-", "", "", "", "too few points"]]
    assert len(motions.header) == len(motions.rows[0])
