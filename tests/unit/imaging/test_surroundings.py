"""Late light of bright surroundings on dark places, as `simulate` blurs textures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
import xarray as xr

from amulor import Survey, imaging, rejection
from amulor.cube import DOUBTFUL
from amulor.simulation import simulate

DISTANCE, EDGE = 1.5, 0.05
TERM = "slant_range_uncertainty_surroundings"
HARBOUR = Path(__file__).parents[3] / "examples" / "surveys" / "harbour.toml"


def target_signal(folder: Path, dark: float) -> xr.Dataset:
    """Return the target signal of a stripe on a plate in harbor water."""
    edges = [-3.0, -EDGE, EDGE, 3.0]
    corners = np.array([(x, y, 0.0) for x in edges for y in (-3, 3)])
    faces = np.array(
        [[2 * k + j, 2 * k + 1 + j, 2 * k + 2 + j] for k in range(3) for j in (0, 1)]
    )
    grey = np.repeat(255 * np.array([1.0, dark, 1.0]), 6).round()
    trimesh.Trimesh(
        corners[faces].reshape(-1, 3),
        np.arange(faces.size).reshape(-1, 3),
        vertex_colors=np.stack([grey] * 3 + [np.full(18, 255)], 1).astype(np.uint8),
        process=False,
    ).export(folder / "stripe.ply")
    survey = Survey.from_toml(HARBOUR).with_(
        {
            "instrument.modulation_frequencies": [50e6, 90e6, 130e6, 200e6],
            "instrument.power": "200 mW",
            "instrument.polarizations": ["VH"],
            "instrument.receiver.azimuth": 0.0,
            "scan.columns": 16,
            "scan.rows": 3,
            "scan.azimuth": 0.0,
            "scan.elevation": 0.0,
            "scan.azimuth_span": 0.3 / DISTANCE,
            "scan.elevation_span": "1 deg",
            "targets": [
                {
                    "kind": "mesh",
                    "file": str(folder / "stripe.ply"),
                    "position": (0.0, 0.0, DISTANCE),
                    "reflectance": 0.5,
                    "mueller": "ideal-depolarizer",
                    "texture": "vertex-colours",
                }
            ],
        }
    )
    return rejection.open_water(simulate(survey, rng=3))


def image_of(target: xr.Dataset) -> xr.Dataset:
    return imaging.range_image(target, polarization="VH", interval=(1.1, 1.9))


@pytest.fixture(scope="module")
def stripe(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    return target_signal(tmp_path_factory.mktemp("stripe"), 0.1)


def test_a_dark_stripe_states_the_late_light_of_its_surroundings(stripe):
    image = image_of(stripe)
    off = (image["slant_range"] - image["truth_slant_range"]).values
    across = DISTANCE * np.sin(image["azimuth"].values)
    dark = np.abs(across) < EDGE - 0.01
    valid = (image["quality_flag"].values & DOUBTFUL) == 0
    assert (valid & dark).sum() > 8
    assert np.median(off[dark]) > 0.005
    term, total = image[TERM].values, image["slant_range_uncertainty"].values
    bright = off[~dark & (across > 0)]
    expected = np.median(off[dark]) - np.median(bright)
    assert 0.7 * expected < np.median(term[dark]) < 1.3 * expected
    without = np.sqrt(total**2 - term**2)
    for part in (dark, ~dark):
        assert np.mean(np.abs(off)[valid & part] < 1.96 * total[valid & part]) > 0.95
    assert np.mean(np.abs(off)[valid & dark] < 1.96 * without[valid & dark]) < 0.5


def test_cubes_without_such_light_have_no_term(stripe):
    assert TERM not in image_of(stripe.assign_attrs(surroundings_light="absent"))


def test_a_uniform_plate_keeps_every_digit(tmp_path):
    target = target_signal(tmp_path, 1.0)
    xr.testing.assert_identical(
        image_of(target).drop_attrs(),
        image_of(target.assign_attrs(surroundings_light="absent")).drop_attrs(),
    )


def test_rows_state_the_term_of_the_whole_scan(stripe):
    from amulor.imaging.range_image import fitted_range_image

    options = {"polarization": "VH", "interval": (1.1, 1.9)}
    whole, fit = fitted_range_image(stripe, **options)
    row, _ = fitted_range_image(stripe.isel(row=slice(1, 2)), fit=fit, **options)
    np.testing.assert_allclose(row[TERM], whole[TERM][1:2], rtol=0.05, atol=5e-5)
