"""Planes, steps and contrast against scenes made by hand."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging import metrics

ROWS, COLUMNS = 20, 30


def _image(z: np.ndarray, sigma: float, **others: np.ndarray) -> xr.Dataset:
    """Return the range image of points (x, y, z) seen along parallel beams."""
    x, y = np.meshgrid(
        np.linspace(-0.05, 0.05, COLUMNS), np.linspace(-0.02, 0.02, ROWS)
    )
    return cubes.build(
        "range_image",
        {
            "slant_range": z,
            "slant_range_uncertainty": np.full(z.shape, sigma),
            "intensity": np.ones(z.shape),
            "quality_flag": np.zeros(z.shape, dtype=np.int16),
            **others,
        },
        {
            "azimuth": np.zeros(z.shape),
            "elevation": np.zeros(z.shape),
            "origin_x": x,
            "origin_y": y,
            "origin_z": np.zeros(z.shape),
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("range_image", title="by hand", source="by hand"),
    )


LABEL = np.repeat([1, 2, 3], COLUMNS // 3)[None, :].repeat(ROWS, 0)
X = np.linspace(-0.05, 0.05, COLUMNS)[None, :].repeat(ROWS, 0)
Y = np.linspace(-0.02, 0.02, ROWS)[:, None].repeat(COLUMNS, 1)


@settings(max_examples=25)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.001, 0.05))
def test_steps_of_a_leaning_ladder_are_measured_across_its_treads(
    lean_x: float, lean_y: float, step: float
) -> None:
    # Planes a perpendicular distance apart are further apart along the beam.
    along = step * np.sqrt(1 + lean_x**2 + lean_y**2)
    z = 1.5 + lean_x * X + lean_y * Y - along * (LABEL - 1)
    steps = metrics.step_heights(_image(z, 1e-4), LABEL)
    assert [s.height for s in steps] == pytest.approx([step, step], rel=1e-9)


def test_the_uncertainty_of_a_step_is_true() -> None:
    rng = np.random.default_rng(1)
    z_scores = []
    for _ in range(300):
        z = 1.5 - 0.01 * (LABEL - 1) + 2e-3 * rng.standard_normal(LABEL.shape)
        steps = metrics.step_heights(_image(z, 2e-3), LABEL)
        z_scores += [(steps[0].height - 0.01) / steps[0].uncertainty]
    # 300 draws: standard error of a mean square 0.08.
    assert 0.7 < np.mean(np.square(z_scores)) < 1.3
    assert abs(np.mean(z_scores)) < 0.25


def test_scatter_beyond_the_stated_uncertainty_enlarges_the_error() -> None:
    rng = np.random.default_rng(2)
    z = 1.5 - 0.01 * (LABEL - 1) + 2e-3 * rng.standard_normal(LABEL.shape)
    honest = metrics.step_heights(_image(z, 2e-3), LABEL)[0]
    boasting = metrics.step_heights(_image(z, 1e-4), LABEL)[0]
    assert boasting.uncertainty == pytest.approx(honest.uncertainty, rel=0.06)


def test_shared_error_and_bias_count() -> None:
    z = 1.5 - 0.01 * (LABEL - 1.0)
    bias = np.where(LABEL == 2, 3e-3, 0.0)
    shared = np.full(z.shape, 4e-3)
    image = _image(
        z, 1e-6, slant_range_bias=bias, slant_range_common_uncertainty=shared
    )
    step = metrics.step_heights(image, LABEL)[0]
    assert step.uncertainty == pytest.approx(np.sqrt(9 + 2 * 16) * 1e-3, rel=1e-3)
    assert step.random < 1e-6


def test_a_delay_moves_both_planes_and_no_step() -> None:
    rng = np.random.default_rng(3)
    noise = 2e-3 * rng.standard_normal(LABEL.shape)
    z = 1.5 - 0.01 * (LABEL - 1.0) + noise
    alone = metrics.step_heights(_image(z, 2e-3), LABEL)[0]
    delay = np.full(z.shape, 11e-3)
    # The group index moves a farther plane by more.
    index = np.where(LABEL == 1, 2e-3, 2.5e-3)
    common = np.sqrt(delay**2 + index**2)
    image = _image(
        z,
        0.0,
        slant_range_common_uncertainty=common,
        slant_range_uncertainty_delay=delay,
        slant_range_uncertainty_group_index=index,
    )
    image["slant_range_uncertainty"][:] = np.sqrt(common**2 + 2e-3**2)
    step = metrics.step_heights(image, LABEL)[0]
    assert step.height == pytest.approx(alone.height, rel=1e-9)
    assert step.random == pytest.approx(alone.random, rel=1e-6)
    assert step.uncertainty == pytest.approx(np.hypot(step.random, 0.5e-3), rel=1e-3)


def test_flagged_pixels_are_left_out() -> None:
    z = 1.5 - 0.01 * (LABEL - 1.0)
    flag = np.zeros(z.shape, dtype=np.int16)
    z[3, 4], flag[3, 4] = 99.0, QualityFlag.AMBIGUOUS
    image = _image(z, 1e-3)
    image["quality_flag"].values[:] = flag
    assert metrics.step_heights(image, LABEL)[0].height == pytest.approx(0.01)


def test_a_plane_with_too_few_pixels_is_named() -> None:
    label = LABEL.copy()
    label[label == 3] = 0
    label[0, -1] = 3
    with pytest.raises(CubeError, match="plane 3 has 1 usable"):
        metrics.step_heights(_image(1.5 - 0.01 * (LABEL - 1.0), 1e-3), label)
    with pytest.raises(CubeError, match="must agree"):
        metrics.step_heights(_image(1.5 + 0 * X, 1e-3), np.ones((3, 3), int))


def test_the_residual_of_a_leaning_plane_is_its_noise() -> None:
    rng = np.random.default_rng(3)
    lean = 0.2
    z = 1.5 + lean * X + 1e-3 * rng.standard_normal(X.shape)
    fit = metrics.plane_residual(_image(z, 1e-3))
    # Noise along the beam, distance along the normal.
    expected = 1e-3 / np.sqrt(1 + lean**2)
    assert fit.residual == pytest.approx(expected, rel=5 / np.sqrt(2 * X.size))
    # The beam is taken from the origin, the scan is parallel: 3 % aside at most.
    assert fit.expected == pytest.approx(expected, rel=0.01)
    assert fit.points == X.size
    # Noise of 1 mm over 24 mm by 600 points: 3.4e-3 down, less to the right.
    toward = np.array([lean, 0, -1]) / np.hypot(1, lean)
    assert fit.normal == pytest.approx(tuple(toward), abs=8e-3)


def test_contrast_of_known_brightness_and_its_error() -> None:
    rng = np.random.default_rng(4)
    image = _image(1.5 + 0 * X, 1e-3)
    values = []
    for _ in range(300):
        noise = 0.1 * rng.standard_normal(X.shape)
        image["intensity"].values[:] = np.where(LABEL == 2, 3.0, 1.0) + noise
        found = metrics.contrast(image, LABEL == 2, LABEL == 1)
        values.append((found.value - 0.5) / found.uncertainty)
    assert found.value == pytest.approx(0.5, abs=0.01)
    assert 0.75 < np.mean(np.square(values)) < 1.25
    with pytest.raises(CubeError, match="surround has 0"):
        metrics.contrast(image, LABEL == 2, LABEL == 9)


def test_points_on_a_line_leave_the_plane_open() -> None:
    image = _image(1.5 + 0 * X, 1e-3)
    row = np.zeros(X.shape, dtype=int)
    row[4] = np.repeat([1, 2, 3], COLUMNS // 3)
    with pytest.raises(CubeError, match="lie on a line"):
        metrics.step_heights(image, row)
    with pytest.raises(CubeError, match="lie on a line"):
        metrics.plane_residual(image, row > 0)
