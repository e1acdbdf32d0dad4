"""Parts of the light of the surroundings: planes, weights, blocks, limits."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import Survey
from amulor.errors import SurveyError
from amulor.imaging import surroundings as module
from amulor.imaging.surroundings import SurroundingLight, surroundings_error
from amulor.optics._surroundings import Surroundings

HARBOUR = Path(__file__).parents[3] / "examples" / "surveys" / "harbour.toml"


def _beams(count: int = 7) -> np.ndarray:
    """Directions of a square of beams 60 mrad apart, around one straight ahead."""
    angle = 0.06 * (np.arange(count) - count // 2)
    x, y = (values.ravel() for values in np.meshgrid(angle, angle))
    ahead = np.stack([x, y, np.ones(x.size)], axis=1)
    return ahead / np.linalg.norm(ahead, axis=1)[:, None]


def _surroundings(depth: np.ndarray, ahead: np.ndarray) -> Surroundings:
    zero = np.zeros_like(ahead)
    return Surroundings(zero, ahead, depth, sight_start=zero, sight=ahead)


def test_planes_around_beams_have_the_slope_of_the_surface() -> None:
    ahead = _beams()
    normal = np.array([0.2, -0.1, 1.0])
    depth = 1.5 / (ahead @ normal)
    slope, same = module._planes(_surroundings(depth, ahead), np.full(depth.size, 1e-4))
    assert same.all()
    middle = depth.size // 2
    # Farther by 0.2 m per meter to the left, and a tenth down.
    assert_allclose(slope[middle], [-0.2, 0.1, 0.0], atol=0.02)
    level, _ = module._planes(
        _surroundings(np.full(depth.size, 2.0), ahead), np.full(depth.size, 1e-4)
    )
    assert_allclose(level[middle], 0.0, atol=0.01)


@pytest.mark.parametrize(
    ("step", "error", "same"),
    # Neighbors are 0.12 m from the beam: 0.12 m of range, and three standard errors.
    [
        (0.115, 1e-4, True),
        (0.13, 1e-4, False),
        (0.13, 4.5e-3, True),
        (-0.13, 1e-4, False),
    ],
)
def test_places_far_behind_or_before_a_beam_are_another_surface(
    step: float, error: float, same: bool
) -> None:
    ahead = np.array([[0.0, 0.0, 1.0], [0.06, 0.0, 1.0]])
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    # The plane across the first beam, and a step behind it.
    depth = np.array([2.0, (2.0 + step) / ahead[1, 2]])
    distance = depth[1] * ahead[1, 0]
    assert distance == pytest.approx(0.12, rel=0.1)
    _, found = module._planes(_surroundings(depth, ahead), np.full(2, error))
    assert bool(found[0, 1]) is same
    assert found.diagonal().all()


def test_the_nearest_blocks_share_by_the_inverse_square_of_their_distance() -> None:
    blocks = np.array([[0.0, 0, 1], [0.1, 0, 1], [0.3, 0, 1], [0.7, 0, 1], [2.0, 0, 1]])
    number, part = module._near(np.array([[0.05, 0.0, 1.0], [0.3, 0, 1]]), blocks)
    assert set(number[0]) == {0, 1, 2, 3}
    by_block = dict(zip(number[0], part[0], strict=True))
    inverse = 1 / np.array([0.05, 0.05, 0.25, 0.65]) ** 2
    assert_allclose([by_block[k] for k in range(4)], inverse / inverse.sum())
    assert number[1, 0] == 2
    assert part[1, 0] == pytest.approx(1.0)
    number, part = module._near(np.array([[0.0, 0.0, 1.0]]), blocks[:2])
    assert number.shape == (1, 2)
    assert part.sum() == pytest.approx(1.0)


def test_the_direction_of_a_block_is_the_mean_of_its_beams() -> None:
    direction = np.array([[[0.0, 0.6, 0.8], [0.0, -0.6, 0.8], [1.0, 0.0, 0.0]]])
    valid = np.array([[True, True, False]])
    found = module._mean_direction(direction, valid, np.array([0, 0]))
    assert_allclose(found, [[0.0, 0.0, 1.0]])
    apart = module._mean_direction(direction, valid, np.array([1, 0]))
    assert_allclose(apart, direction[0, [1, 0]])


def test_blocks_have_the_mean_angles_depths_and_noise_of_their_pixels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: dict[str, Any] = {}

    def entered(start: Any, direction: Any, medium: Any) -> SimpleNamespace:
        return SimpleNamespace(entry=start, direction=direction)

    def weights(places: Surroundings, *_: Any, error: np.ndarray) -> Any:
        given.update(depth=places.depth, error=error)
        return np.full((1, 2), 0.5 + 0j), np.zeros((1, 2, 2), dtype=complex)

    def angles(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        given.update(azimuth=azimuth, elevation=elevation)
        return np.tile([0.0, 0.0, 1.0], (2, 1))

    monkeypatch.setattr(module, "_BLOCKS", 2)
    monkeypatch.setattr(
        module, "rays", SimpleNamespace(enter_water=entered, direction=angles)
    )
    along = entered(np.zeros(3), np.array([0.0, 0.0, 1.0]), None)
    monkeypatch.setattr(module, "line_of_sight", lambda *_: along)
    monkeypatch.setattr(module, "gaussian_arguments", lambda *_: {})
    monkeypatch.setattr(module, "view", lambda *_: None)
    monkeypatch.setattr(module, "_weights", weights)
    column = np.tile(np.arange(4.0), (2, 1))
    ahead = np.broadcast_to([0.0, 0.0, 1.0], (2, 4, 3))
    geometry = SimpleNamespace(
        beam=SimpleNamespace(direction=ahead), emitter=np.zeros(3), medium=None,
        azimuth=column, elevation=-column, depth=lambda slant_range: slant_range - 1,
    )  # fmt: skip
    slant_range = np.array([[2.0, 3, 4, np.nan], [2, 5, 8, 9]])
    observation: Any = SimpleNamespace(geometry=geometry, frequency=np.array([1e8]))
    unknown: Any = SimpleNamespace(group_index=1.38)
    module._surrounding_light(
        observation, slant_range, np.ones((2, 4)), 0.1 * slant_range,
        survey=unknown, water=unknown,
    )  # fmt: skip
    # Two squares; the right one has three pixels with a range.
    assert_allclose(given["azimuth"], [0.5, 7 / 3])
    assert_allclose(given["elevation"], [-0.5, -7 / 3])
    assert_allclose(given["depth"], [2, 6])
    assert_allclose(given["error"], [0.3, 0.7])


class _Rings:
    """Two places beside each of two beams, with given weights."""

    depth = np.array([2.0, 2.0])
    ahead = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 0.995]])
    across = np.array([[[1.0, 0, 0]] * 2, [[0.0, 1, 0]] * 2])

    def weights(self, arguments: Any, wavenumber: np.ndarray) -> Any:
        aside = np.array([[[0.3, 0, 0]] * 2, [[-0.3, 0.1, 0]] * 2])
        size = np.array([[[0.1, 0.2], [0.3, 0.4]], [[0.5, 0.6], [0.7, 0.8j]]])
        return np.array([[1.0, 2.0], [3.0, 4.0]], dtype=complex), [(aside, size)]

    def ways(self, aside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        way = 2.0 * self.ahead + aside
        return np.ones(2), way / np.linalg.norm(way, axis=-1)[..., None]


def test_light_of_places_counts_for_the_nearest_block(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slope = np.array([[0.5, 0.0, 0.0], [0.0, 0.2, 0.0]])
    same = np.array([[True, True], [False, True]])
    monkeypatch.setattr(module, "_planes", lambda *_: (slope, same))
    rings: Any = _Rings()
    wave = np.array([1.0, 2.0])
    own, shares = module._weights(rings, {}, wave, error=np.zeros(2))
    total = np.array([[1.4, 2.6], [4.2, 4.6 + 0.8j]])
    # To the right of both beams lies the second block, to the left the first, which is
    # another surface for the second beam.
    turn = np.exp(2j * wave[:, None] * np.array([0.15, -0.15]))
    expected = np.zeros((2, 2, 2), dtype=complex)
    expected[:, 0, 1] = np.array([0.1, 0.5]) * turn[:, 0]
    expected[:, 0, 0] = np.array([0.3, 0.7]) * turn[:, 1]
    expected[:, 1, 1] = np.array([0.2, 0.6])
    assert_allclose(shares, expected / total[..., None])
    assert_allclose(own, shares.sum(axis=2))


def _pixels(sigma: tuple[float, float] = (1e-3, 2e-3)) -> Any:
    """Three pixels at two frequencies in harbor water."""
    return SimpleNamespace(
        channel=xr.Dataset(), survey=Survey.from_toml(HARBOUR),
        geometry=SimpleNamespace(
            emitter=np.zeros(3), beam=SimpleNamespace(direction=np.ones((1, 3, 3)))
        ),
        sigma=np.array(sigma).reshape(2, 1, 1) * np.ones((2, 1, 3)),
        path_per_phase=np.array([0.5, 0.25]).reshape(2, 1, 1),
    )  # fmt: skip


SHARE = np.array([0.2 - 0.05j, 0.18 - 0.1j])
LIGHT = np.array([0.3 - 0.1j, 0.25 - 0.2j])


def _error(
    monkeypatch: pytest.MonkeyPatch,
    bright: list[float],
    *,
    noise: float = 1e-4,
    judged: bool = False,
    **options: Any,
) -> tuple[Any, Any]:
    monkeypatch.setattr(module, "echo_over_white", lambda *_, **__: np.array([bright]))
    near = (np.zeros((1, 1), int), np.ones((1, 1)))
    monkeypatch.setattr(
        module, "_near", lambda direction, _: tuple(
            np.repeat(part, len(direction), axis=0) for part in near
        ),
    )  # fmt: skip
    light = SurroundingLight(
        direction=np.ones((1, 3)), share=SHARE[:, None], light=LIGHT[:, None],
        matters=not judged,
    )  # fmt: skip
    monkeypatch.setattr(module, "_surrounding_light", lambda *_, **__: light)
    return surroundings_error(
        _pixels(**options), np.array([[1.5, 1.5, np.nan]]),
        weight=np.array([0.25, 0.75]), slope=np.full((1, 3), 2.0),
        noise=np.full((1, 3), noise), fit=None if judged else light,
    )  # fmt: skip


def _shift(bright: float) -> float:
    surface = (bright - LIGHT[0].real) / (1 - SHARE[0].real)
    turned = np.angle(max(surface, 0.0) * (1 - SHARE) + LIGHT)
    return 2.0 * abs(0.25 * 0.5 * turned[0] + 0.75 * 0.25 * turned[1])


def test_pixels_unlike_their_surroundings_have_the_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The surroundings alone would give 1.5; the last pixel has no range.
    error, fit = _error(monkeypatch, [0.5, np.nan, 0.6])
    assert_allclose(error, [[_shift(0.5), 0.0, 0.0]])
    assert fit.matters
    dark, _ = _error(monkeypatch, [0.2, 0.5, 0.6])
    # The own echo is not below zero.
    assert_allclose(dark, [[_shift(0.2), _shift(0.5), 0.0]])


@pytest.mark.parametrize(
    ("contrast", "sigma", "differs"),
    # 3 % by the model, and five standard errors of the better frequency.
    [
        (0.029, 1e-6, False),
        (0.031, 1e-6, True),
        (0.049, 0.008, False),
        (0.051, 0.008, True),
    ],
)
def test_a_pixel_differs_beyond_its_noise_and_the_model(
    monkeypatch: pytest.MonkeyPatch, contrast: float, sigma: float, differs: bool
) -> None:
    alike = LIGHT[0].real / SHARE[0].real
    bright = alike / (1 - contrast)
    error, _ = _error(monkeypatch, [bright, bright, 0.6], sigma=(sigma, 3 * sigma))
    assert bool(error[0, 0] > 0) is differs
    more, _ = _error(
        monkeypatch, [alike / (1 + contrast), 1.0, 1.0], sigma=(sigma, 3 * sigma)
    )
    assert bool(more[0, 0] > 0) is differs


def test_light_matters_from_a_twentieth_of_the_other_errors_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    size = _shift(0.5)
    for factor, matters in ((0.99, True), (1.01, False)):
        error, fit = _error(
            monkeypatch, [0.5, 1.5, 1.0], judged=True, noise=20 * size * factor
        )
        assert fit.matters is matters
        assert (error is not None) is matters


def test_water_that_the_theory_does_not_know_has_no_term(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise SurveyError("no small angles")

    options: dict[str, Any] = {
        "weight": np.ones(2), "slope": np.ones((1, 3)), "noise": np.ones((1, 3))
    }  # fmt: skip
    monkeypatch.setattr(module, "echo_over_white", refused)
    ranges = np.full((1, 3), 1.5)
    assert surroundings_error(_pixels(), ranges, **options) == (None, None)
    monkeypatch.setattr(module, "echo_over_white", lambda *_, **__: np.ones((1, 3)))
    monkeypatch.setattr(module, "_surrounding_light", lambda *_, **__: None)
    assert surroundings_error(_pixels(), ranges, **options) == (None, None)
