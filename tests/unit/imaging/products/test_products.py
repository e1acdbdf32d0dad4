"""Rasters, contours, sections and deviations agree with known geometry and errors."""

from __future__ import annotations

import exact_scenes as scenes
import numpy as np
import pytest

from amulor import imaging
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging import products
from amulor.survey import Pose

#: Normal of a wall turned by 30 degrees about the vertical, and tipped a little.
TURNED = (np.sin(0.5), 0.1, np.cos(0.5))


def drawing(image, *, cell=2e-3, side="front", axes="instrument", pose=None):
    frame = imaging.frame_of(image, axes=axes, pose=pose)
    surface = products.surface(image, frame=frame)
    return products.raster(surface, products.plane_of(frame, side), cell=cell)


class TestRaster:
    @pytest.mark.parametrize("cell", [1e-3, 7e-3])
    def test_a_tilted_wall_is_at_its_place(self, cell) -> None:
        found = drawing(scenes.plane(TURNED, 1.5), cell=cell)
        right, up = np.meshgrid(found.columns, found.rows)
        # Down is minus up; the height counts towards the viewer.
        forward = (1.5 - TURNED[0] * right + TURNED[1] * up) / TURNED[2]
        there = np.isfinite(found.height)
        assert there.mean() > 0.8
        off = (found.height + forward)[there]
        # Inside a cell at the edge the mean is that of the part that is covered.
        assert np.percentile(np.abs(off), 85) < 1e-9
        assert np.abs(off).max() < 0.6 * cell

    def test_cells_of_two_scans_fit_over_each_other(self) -> None:
        one = drawing(scenes.plane(TURNED, 1.5))
        other = drawing(scenes.plane((0, 0, 1), 1.43))
        shift = (one.left - other.left) / one.cell
        assert shift == pytest.approx(round(shift), abs=1e-6)

    def test_no_wall_hangs_between_treads(self) -> None:
        found = drawing(scenes.ladder(), cell=1e-3)
        heights = found.height[np.isfinite(found.height)]
        off = np.min(np.abs(heights[:, None] + np.array(scenes.DEPTHS)), axis=1)
        assert off.max() < 1e-9
        assert {round(float(h), 6) for h in heights} == {-d for d in scenes.DEPTHS}

    def test_a_shift_of_the_range_moves_heights_as_stated(self) -> None:
        shared = 1e-4
        stated = scenes.plane(TURNED, 1.5, own=0.0, shared=shared)
        one = drawing(stated)
        other = drawing(stated.assign(slant_range=stated["slant_range"] + shared))
        both = np.isfinite(one.height) & np.isfinite(other.height)
        inside = np.zeros_like(both)
        inside[2:-2, 2:-2] = True
        moved = np.abs(other.height - one.height)[both & inside]
        np.testing.assert_allclose(one.uncertainty[both & inside], moved, rtol=2e-3)

    def test_noise_of_cells_is_that_of_drawn_scans(self) -> None:
        own, rng = 3e-4, np.random.default_rng(3)
        exact = scenes.plane((0, 0, 1), 1.5, own=own)
        stated = drawing(exact, cell=9e-3)
        heights = [
            drawing(scenes.drawn(exact, rng, own), cell=9e-3).height for _ in range(60)
        ]
        inner = (slice(1, -1), slice(1, -1))
        ratio = np.var(heights, axis=0, ddof=1)[inner] / stated.own[inner] ** 2
        # Some 60 cells of 60 draws each: 3 % of the variance, neighbours apart.
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.1)
        assert np.nanmedian(stated.own) < own / 2  # some five pixels a cell

    def test_a_plan_has_the_axes_of_the_world(self) -> None:
        # Straight down from 2 m above the ground, the top of the scan to the east.
        pose = Pose(position=(100, 200, 12), heading=np.pi / 2, pitch=-np.pi / 2)
        image = scenes.plane((0, 0, 1), 2.0)
        found = drawing(image, side="top", axes="pose", pose=pose)
        np.testing.assert_allclose(found.height[np.isfinite(found.height)], 10.0)
        # Up in the scan is east: azimuths of 2.3 degrees lie along north.
        assert np.ptp(found.rows) == pytest.approx(2 * 2 * np.tan(0.04), abs=6e-3)
        assert np.ptp(found.columns) < np.ptp(found.rows)
        assert found.plane.names == ("east", "north", "up")
        assert abs(found.columns.mean() - 100) < 0.01
        assert abs(found.rows.mean() - 200) < 0.01

    def test_an_unsure_pose_is_in_the_uncertainty(self) -> None:
        pose = Pose(pitch=-np.pi / 2, position_uncertainty=0.02)
        image = scenes.plane((0, 0, 1), 2.0, own=0.0)
        found = drawing(image, side="top", axes="pose", pose=pose)
        sigma = found.uncertainty[np.isfinite(found.height)]
        np.testing.assert_allclose(sigma, 0.02, rtol=1e-9)

    def test_mixed_pixels_are_left_out(self) -> None:
        image = scenes.plane((0, 0, 1), 1.5)
        image["slant_range"].values[10, 15] -= 0.02
        image["quality_flag"].values[10, 15] = QualityFlag.MIXED
        found = drawing(image, cell=1e-3)
        np.testing.assert_allclose(found.height[np.isfinite(found.height)], -1.5)

    def test_too_large_a_raster_and_no_surface_are_refused(self) -> None:
        with pytest.raises(CubeError, match=r"too large.*larger cells"):
            drawing(scenes.plane((0, 0, 1), 1.5), cell=1e-6)
        nothing = scenes.plane((0, 0, 1), 1.5)
        nothing["slant_range"].values[:] = np.nan
        with pytest.raises(CubeError, match="no surface to draw"):
            products.surface(nothing)


class TestContours:
    def test_those_of_a_ball_are_circles(self) -> None:
        azimuth, elevation, unit = scenes.directions(60, 60, half=0.06)
        radius, centre = 0.1, np.array([0.0, 0.0, 1.2])
        along = unit @ centre
        distance = along - np.sqrt(along**2 - centre @ centre + radius**2 + 0j).real
        off = along**2 - centre @ centre + radius**2 < 0.0005
        image = scenes.image_of(np.where(off, np.nan, distance), azimuth, elevation)
        lines = products.contours(drawing(image, cell=1e-3), interval=0.005)
        whole = [line for line in lines if np.allclose(line.points[0], line.points[-1])]
        assert len(whole) >= 4
        for line in whole:
            depth = -line.level
            expected = np.sqrt(radius**2 - (centre[2] - depth) ** 2)
            measured = np.hypot(*line.points.T)
            # Chords of a triangle of 2.5 mm on a ball of 100 mm stay within 10 um; at
            # the slope of the outer circle that is 0.03 mm, at the inner one 0.1 mm.
            np.testing.assert_allclose(measured, expected, atol=2e-4)

    def test_noise_on_a_terrace_draws_none(self) -> None:
        rng = np.random.default_rng(8)
        image = scenes.plane((0, 0, 1), 1.5, rows=40, columns=60, own=4e-4)
        flat = drawing(scenes.drawn(image, rng, 4e-4), cell=2e-3)
        assert products.contours(flat, interval=0.01) == []
        tilted = scenes.plane((0.1, 0, 0.995), 1.5, rows=40, columns=60, own=4e-4)
        sloping = drawing(scenes.drawn(tilted, rng, 4e-4), cell=2e-3)
        levels = {line.level for line in products.contours(sloping, interval=2e-3)}
        # 119 mm of width at a slope of a tenth.
        assert len(levels) == pytest.approx(6, abs=1)

    def test_an_interval_that_cannot_be_is_refused(self) -> None:
        found = drawing(scenes.plane((0.0, 0, 1), 1.503))
        with pytest.raises(CubeError, match="crosses no multiple of 10 mm"):
            products.contours(found, interval=0.01)
        with pytest.raises(CubeError, match="too many"):
            products.contours(drawing(scenes.plane(TURNED, 1.5)), interval=1e-6)


class TestSection:
    def test_the_steps_of_the_ladder_are_forty_and_ten_millimetres(self) -> None:
        surface = products.surface(scenes.ladder())
        cut = products.section(
            surface,
            products.plane_of(surface.frame),
            start=(-0.06, 0),
            end=(0.06, 0.004),
        )
        levels = [
            float(np.median(cut.height[cut.piece == number]))
            for number in range(cut.piece.max() + 1)
        ]
        np.testing.assert_allclose(
            np.diff(levels), [0.04, 0.01, 0.01, 0.01], atol=1e-12
        )
        assert np.all(np.diff(cut.along) >= 0)

    def test_a_slanted_line_over_a_tilted_wall_is_straight(self) -> None:
        surface = products.surface(scenes.plane(TURNED, 1.5))
        start, end = np.array([-0.03, -0.02]), np.array([0.02, 0.03])
        cut = products.section(
            surface, products.plane_of(surface.frame), start=start, end=end
        )
        right, up = (
            start + np.outer(cut.along, (end - start)) / np.hypot(*(end - start))
        ).T
        forward = (1.5 - TURNED[0] * right + TURNED[1] * up) / TURNED[2]
        np.testing.assert_allclose(cut.height, -forward, atol=1e-12)
        assert cut.piece.max() == 0
        assert np.ptp(cut.along) == pytest.approx(np.hypot(*(end - start)))

    def test_its_scatter_is_what_it_states(self) -> None:
        own, rng = 3e-4, np.random.default_rng(4)
        exact = scenes.plane(TURNED, 1.5, own=own)
        ends = {"start": (-0.04, 0.0011), "end": (0.04, 0.0011)}
        slope = -TURNED[0] / TURNED[2]
        scores = []
        for _ in range(40):
            surface = products.surface(scenes.drawn(exact, rng, own))
            cut = products.section(surface, products.plane_of(surface.frame), **ends)
            right = -0.04 + cut.along
            true = -(1.5 - TURNED[0] * right + TURNED[1] * 0.0011) / TURNED[2]
            across = (cut.height - true) / np.hypot(1, slope)
            scores.append(across / cut.uncertainty)
        score = np.concatenate(scores)
        # Neighbouring points share pixels: some 1200 of 2500 are independent.
        assert np.std(score) == pytest.approx(1.0, abs=0.08)
        assert abs(np.mean(score)) < 0.1

    def test_a_line_beside_the_surface_says_where_that_is(self) -> None:
        surface = products.surface(scenes.plane((0, 0, 1), 1.5))
        with pytest.raises(
            CubeError, match=r"meets no surface, which reaches from \(-0"
        ):
            products.section(
                surface, products.plane_of(surface.frame), start=(1, 1), end=(2, 1)
            )


class TestDeviation:
    @staticmethod
    def wall(normal, offset):
        """Return a square of that plane, by its own corners."""
        n = np.array(normal) / np.linalg.norm(normal)
        across = np.cross(n, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        other = np.cross(n, across)
        middle = n * offset / np.linalg.norm(normal)
        corners = [middle + a * across + b * other for a in (-1, 1) for b in (-1, 1)]
        return np.array(corners), np.array([[0, 1, 2], [1, 3, 2]])

    @pytest.mark.parametrize("off", [5e-3, -5e-3])
    def test_a_wall_off_its_model_is_off_by_as_much(self, off) -> None:
        length = np.linalg.norm(TURNED)
        surface = products.surface(scenes.plane(TURNED, 1.5, own=1e-4))
        # A model that lies farther leaves the scan nearer: a positive deviation.
        found = products.deviation(surface, *self.wall(TURNED, 1.5 + off * length))
        np.testing.assert_allclose(found.value, off, atol=1e-9)
        assert found.significant.all()
        assert found.mean == pytest.approx(off, abs=1e-9)
        # The range's error along a beam, seen across the wall: cos of the angle.
        facing = surface.direction @ (np.array(TURNED) / length)
        np.testing.assert_allclose(found.uncertainty, 1e-4 * facing, rtol=1e-6)

    def test_stated_and_true_errors_agree_with_a_noisy_earlier_scan(self) -> None:
        rng, own = np.random.default_rng(6), 3e-4
        exact = scenes.plane(TURNED, 1.5, own=own)
        one, other = (products.surface(scenes.drawn(exact, rng, own)) for _ in range(2))
        found = products.deviation(
            one, other.position, other.triangles, own=other.own, shared=other.shared
        )
        score = (found.value / found.uncertainty)[np.isfinite(found.value)]
        # 600 pixels, but for the rim.
        assert len(score) > 500
        assert np.std(score) == pytest.approx(1.0, abs=4 / np.sqrt(2 * len(score)))
        # By chance alone, five tests of a hundred would call something significant.
        assert found.significant.mean() < 0.01

    def test_a_dent_is_found_and_little_else(self) -> None:
        rng, own = np.random.default_rng(7), 3e-4
        exact = scenes.plane((0, 0, 1), 1.5, rows=40, columns=60, own=own)
        dented = scenes.drawn(exact, rng, own)
        dented["slant_range"].values[10:20, 20:35] += 2e-3
        surface = products.surface(dented)
        found = products.deviation(surface, *self.wall((0, 0, 1), 1.5))
        inside = np.zeros((40, 60), dtype=bool)
        inside[10:20, 20:35] = True
        dent = inside.ravel()[surface.pixel]
        assert found.significant[dent].mean() > 0.98
        false = found.significant[~dent].sum() / found.significant.sum()
        assert false < 0.12  # 5 %, and what 150 pixels let it scatter

    def test_what_pixels_share_stays_in_the_mean(self) -> None:
        surface = products.surface(scenes.plane((0, 0, 1), 1.5, own=1e-3, shared=5e-4))
        found = products.deviation(surface, *self.wall((0, 0, 1), 1.5))
        assert found.mean_uncertainty == pytest.approx(
            np.hypot(5e-4, 1e-3 / np.sqrt(600)), rel=2e-3
        )

    def test_a_reference_elsewhere_is_refused(self) -> None:
        surface = products.surface(scenes.plane((0, 0, 1), 1.5))
        corners, faces = self.wall((0, 0, 1), 1.5)
        with pytest.raises(CubeError, match="same frame"):
            products.deviation(surface, corners + np.array([50, 0, 0]), faces)
        with pytest.raises(CubeError, match="--farthest"):
            products.deviation(
                surface, corners + np.array([0, 0, 1]), faces, farthest=0.5
            )

    def test_poses_count_where_the_instrument_was_moved(self) -> None:
        image = scenes.plane((0, 0, 1), 1.5, own=1e-4)
        here = Pose(position_uncertainty=0.01)
        moved = Pose(position=(0, -0.5, 0), position_uncertainty=0.02)
        farther = scenes.plane((0, 0, 1), 2.0, own=1e-4)
        frames = [
            imaging.frame_of(image, axes="pose", pose=here),
            imaging.frame_of(image, axes="pose", pose=moved),
        ]
        one = products.surface(image, frame=frames[0])
        same = products.deviation(
            one, one.position, one.triangles, own=one.own, reference=frames[0]
        )
        # The instrument stood still: its noise twice, at the vertices themselves.
        assert np.nanmedian(same.uncertainty) < 2e-4
        other = products.surface(farther, frame=frames[1])
        both = products.deviation(
            one, other.position, other.triangles, own=other.own, reference=frames[1]
        )
        # The same wall from half a metre behind, with two poses of 10 and 20 mm.
        np.testing.assert_allclose(both.value[np.isfinite(both.value)], 0, atol=1e-9)
        expected = np.hypot(0.01, 0.02)
        np.testing.assert_allclose(np.nanmedian(both.uncertainty), expected, rtol=1e-3)
        assert not both.significant.any()
