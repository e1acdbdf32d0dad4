"""Late light of bright surroundings on dark places, as `simulate` blurs textures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import xarray as xr

from amulor import Survey, imaging, rejection
from amulor.cube import DOUBTFUL
from amulor.imaging import surroundings
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


def pixel(survey: Survey | None, **attributes: object) -> SimpleNamespace:
    """Return the observation of a pixel at two frequencies."""
    return SimpleNamespace(
        channel=xr.Dataset(attrs=attributes),
        survey=survey,
        geometry=SimpleNamespace(
            emitter=np.zeros(3), beam=SimpleNamespace(direction=np.ones((1, 1, 3)))
        ),
        sigma=np.array([1e-3, 2e-3]).reshape(2, 1, 1),
        path_per_phase=np.array([0.5, 0.25]).reshape(2, 1, 1),
    )


#: Share of the light from equal surroundings and light of the real ones, by frequency.
SHARE = np.array([0.2 - 0.05j, 0.18 - 0.1j])
LIGHT = np.array([0.3 - 0.1j, 0.25 - 0.2j])


def error_of(monkeypatch, surface: float, **changes: object) -> float | None:
    """Return the range error [m] of a pixel with a surface of given brightness."""
    bright = surface * (1 - SHARE[0].real) + LIGHT[0].real
    monkeypatch.setattr(
        surroundings, "echo_over_white", lambda *_, **__: np.array([[bright]])
    )
    monkeypatch.setattr(
        surroundings, "_near", lambda *_: (np.zeros((1, 1), int), np.ones((1, 1)))
    )
    fit = surroundings.SurroundingLight(
        direction=np.ones((1, 3)), share=SHARE[:, None], light=LIGHT[:, None],
        matters=True,
    )  # fmt: skip
    error, _ = surroundings.surroundings_error(
        pixel(Survey.from_toml(HARBOUR)), np.array([[1.5]]),
        weight=np.array([0.25, 0.75]), slope=np.array([[2.0]]),
        noise=np.array([[1e-4]]), fit=replace(fit, **changes),
    )  # fmt: skip
    return None if error is None else float(error[0, 0])


def test_late_light_turns_the_phase_of_the_own_echo(monkeypatch):
    for surface in (0.05, 0.6):
        turned = np.angle(surface * (1 - SHARE) + LIGHT)
        expected = 2.0 * abs(0.25 * 0.5 * turned[0] + 0.75 * 0.25 * turned[1])
        assert error_of(monkeypatch, surface) == pytest.approx(expected, rel=1e-12)
    # A surface as bright as its surroundings gets no error: its light is their share.
    alike = LIGHT[0].real / SHARE[0].real
    assert error_of(monkeypatch, alike) == 0
    assert error_of(monkeypatch, 0.05, matters=False) is None


def test_nothing_scatters_light_onto_a_target(monkeypatch):
    survey = Survey.from_toml(HARBOUR)
    clear = {"water": {"absorption": 0.1, "scattering": 0.0, "refractive_index": 1.34,
                       "group_index": 1.38}}  # fmt: skip
    moved = pixel(survey)
    moved.geometry.emitter = np.array([[0.0, 0, 0], [1, 0, 0]])
    for observation in (
        pixel(None),
        pixel(survey, surroundings_light="absent"),
        pixel(survey, simulated=1),
        pixel(survey.with_(clear)),
        moved,
    ):
        assert surroundings.surroundings_error(
            observation, np.array([[1.5]]), weight=np.ones(2),
            slope=np.ones((1, 1)), noise=np.full((1, 1), 1e-4),
        ) == (None, None)  # fmt: skip
