"""Motion of an ellipsoid between two visits, without noise."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from amulor.site.change import moved
from amulor.site.change.moved import Motion, motion_of
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.surface import ScanSurface, scan_surface, shared_errors

ROWS, COLUMNS = 64, 84
AZIMUTH, ELEVATION, UNIT = scenes.directions(ROWS, COLUMNS, half=0.28)
#: Half axes of an ellipsoid that lies on the ground [m], and its place.
AXES, PLACE = np.array([0.22, 0.14, 0.1]), np.array([0.02, -0.01, 0.02])
#: Looking straight down from 1.6 m, and from a place beside.
DOWN = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])
POSES = {
    "a": ScanPose(DOWN, np.array([0.0, 0.0, 1.6])),
    "b": ScanPose(
        Rotation.from_rotvec([0.05, 0.08, 0.1]).as_matrix() @ DOWN,
        np.array([-0.12, 0.08, 1.55]),
    ),
}
SHIFT, TURN = np.array([0.012, -0.008, 0.004]), np.array([0.02, -0.03, 0.06])
DELAY = 1e-3


def _ranges(pose: ScanPose, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Ranges of the ellipsoid after a motion, and of sloping ground around it."""
    beam = pose.turn(UNIT)
    ground = (0.02 * pose.position[0] - pose.position[2]) / (
        beam[..., 2] - 0.02 * beam[..., 0]
    )
    turned = Rotation.from_rotvec(turn).as_matrix()
    start = (pose.position - PLACE - shift) @ turned / AXES
    ahead = (beam @ turned) / AXES
    a, b = (ahead**2).sum(axis=-1), ahead @ start
    inside = b**2 - a * (start @ start - 1)
    near = (-b - np.sqrt(np.maximum(inside, 0.0))) / a
    return np.where(inside > 0, np.minimum(near, ground), ground)


def _scan(name: str, *, own: float = 2e-4) -> ScanSurface:
    still = np.zeros(3)
    motion = (still, still) if name == "a" else (SHIFT, TURN)
    image = scenes.image_of(
        _ranges(POSES[name], *motion), AZIMUTH, ELEVATION, own=own, shared=DELAY
    )
    delay = xr.full_like(image["slant_range"], DELAY)
    image = image.assign(slant_range_uncertainty_delay=delay)
    shared = shared_errors(image, scan=name, instrument=name, water="w")
    return scan_surface(image, name=name, shared=shared, window=5)


def _site() -> Any:
    visits = {"a": "one", "b": "two", "x": "three"}
    scans = [SimpleNamespace(name=name, epoch=visit) for name, visit in visits.items()]
    return SimpleNamespace(
        scan=scans, scans_of=lambda epoch: [s for s in scans if s.epoch == epoch]
    )


def _registration(**variances: float) -> Any:
    """Poses and errors that are known, but for the height of one, or a delay."""

    def covariance_of(*names: str) -> np.ndarray:
        parts = []
        for name in names:
            size = 6 if name.startswith("pose") else 1
            part = np.zeros(size)
            part[2 if size == 6 else 0] = variances.get(name.replace(" ", "_"), 0.0)
            parts.append(part)
        return np.diag(np.concatenate(parts))

    return SimpleNamespace(poses=POSES, errors={}, covariance_of=covariance_of)


@pytest.fixture(scope="module")
def surfaces() -> dict[str, ScanSurface]:
    return {name: _scan(name) for name in "ab"}


def _moved(
    surfaces: dict[str, ScanSurface], registration: Any = None, **options: Any
) -> Motion | str:
    return motion_of(
        _site(), registration or _registration(), surfaces,
        **{"epochs": ("one", "two"), "centre": PLACE, "reach": 0.28, **options},
    )  # fmt: skip


@pytest.fixture(scope="module")
def motion(surfaces: dict[str, ScanSurface]) -> Motion:
    found = _moved(surfaces)
    assert isinstance(found, Motion)
    return found


def test_the_motion_of_an_object_is_that_of_its_points(motion: Motion) -> None:
    spin = Rotation.from_rotvec(TURN).as_matrix() - np.eye(3)
    expected = SHIFT + spin @ (motion.centre - PLACE)
    # A patch of five pixels misses a part of the curvature at the rim.
    assert_allclose(motion.shift, expected, atol=5e-4)
    assert_allclose(motion.turn, TURN, atol=3e-3)
    assert motion.loose == ()
    assert not motion.undetermined.any()
    assert motion.points > 300
    assert motion.misfit == 1.0
    assert motion.distance == pytest.approx(np.linalg.norm(motion.shift))
    assert motion.angle == pytest.approx(np.linalg.norm(motion.turn))
    # The center of the visible points, above that of the ellipsoid.
    assert_allclose(motion.centre[:2], PLACE[:2], atol=0.02)
    assert 0.05 < motion.centre[2] < 0.12


def test_the_other_order_of_the_visits_is_the_inverse_motion(
    surfaces: dict[str, ScanSurface], motion: Motion
) -> None:
    back = _moved(surfaces, epochs=("two", "one"))
    assert isinstance(back, Motion)
    assert_allclose(back.turn, -motion.turn, atol=2e-3)
    assert_allclose(back.shift, -motion.shift, atol=1.5e-3)


def test_noise_of_the_pixels_counts_in_proportion(
    surfaces: dict[str, ScanSurface], motion: Motion
) -> None:
    noisy = _moved(
        {name: replace(scan, own=1.1 * scan.own) for name, scan in surfaces.items()}
    )
    assert isinstance(noisy, Motion)
    scale = np.sqrt(np.outer(np.diag(motion.covariance), np.diag(motion.covariance)))
    expected = 1.21 * motion.covariance / scale
    assert_allclose(noisy.covariance / scale, expected, atol=0.02)
    # Some hundred pixels of 0.2 mm: heights to some 10 um.
    sigma = np.sqrt(np.diag(motion.covariance))
    assert 5e-6 < sigma[2] < 4e-5
    assert (sigma[:2] > sigma[2]).all()


@pytest.mark.parametrize("name", ["a", "b"])
def test_errors_of_both_poses_move_an_object(
    surfaces: dict[str, ScanSurface], motion: Motion, name: str
) -> None:
    unsure = _moved(surfaces, _registration(**{f"pose_{name}": 1e-6}))
    assert isinstance(unsure, Motion)
    added = unsure.covariance - motion.covariance
    # 1 mm of height of a scan is 1 mm of height of the object, and no turn.
    assert added[2, 2] == pytest.approx(1e-6, rel=0.05)
    assert_allclose(added[3:, 3:], 0.0, atol=1e-7)
    assert unsure.shift == pytest.approx(motion.shift)
    along = unsure.shift / unsure.distance
    expected = np.sqrt(along @ unsure.covariance[:3, :3] @ along)
    assert unsure.distance_uncertainty == pytest.approx(expected)
    axis = unsure.turn / unsure.angle
    expected = np.sqrt(axis @ unsure.covariance[3:, 3:] @ axis)
    assert unsure.angle_uncertainty == pytest.approx(expected)


def test_an_error_of_the_delay_moves_an_object_along_the_beams(
    surfaces: dict[str, ScanSurface], motion: Motion
) -> None:
    later = _moved(surfaces, _registration(**{"error_delay:_b": 1.0}))
    assert isinstance(later, Motion)
    added = later.covariance - motion.covariance
    # A delay of 1 mm is a height of 1 mm, but for the slant of the beams.
    assert added[2, 2] == pytest.approx(1e-6, rel=0.2)


def test_an_object_that_does_not_turn_has_the_angle_zero() -> None:
    still = Motion(
        centre=np.zeros(3), shift=np.array([3e-3, 4e-3, 0.0]), turn=np.zeros(3),
        covariance=np.diag([1.0, 4.0, 9.0, 1, 1, 1]) * 1e-6, loose=(), points=1,
        misfit=1.0,
    )  # fmt: skip
    assert still.distance == pytest.approx(5e-3)
    assert still.distance_uncertainty == pytest.approx(1e-3 * np.sqrt(0.36 + 4 * 0.64))
    assert (still.angle, still.angle_uncertainty) == (0.0, 0.0)


def test_components_above_a_tenth_of_a_free_motion_are_undetermined() -> None:
    free = np.array([0.101, 0.099, 0.0, 0.0, 0.0, 1.0])
    motion = Motion(
        centre=np.zeros(3), shift=np.zeros(3), turn=np.zeros(3),
        covariance=np.eye(6), loose=(0 * free, -free), points=1, misfit=1.0,
    )  # fmt: skip
    assert motion.undetermined.tolist() == [True, False, False, False, False, True]
    assert moved.free_motions(motion).endswith("turn about (-0.00, -0.00, -1.00)")
    slide = Motion(
        centre=np.zeros(3), shift=np.zeros(3), turn=np.zeros(3), covariance=np.eye(6),
        loose=(np.array([0.0, 1.0, 0.0, 0.5, 0.0, 0.0]),), points=1, misfit=1.0,
    )  # fmt: skip
    assert moved.free_motions(slide) == "shift along (+0.00, +1.00, +0.00)"


def test_objects_that_meet_no_surface_have_no_motion(
    surfaces: dict[str, ScanSurface], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(moved, "_FEWEST", 100_000)
    found = _moved(surfaces)
    assert isinstance(found, str)
    count = int(found.split()[0])
    assert count > 100
    assert found == (
        f"{count} points of the object meet its surface in one, and 100000 are needed"
    )
    monkeypatch.setattr(moved, "_FEWEST_PIXELS", 100_000)
    assert _moved(surfaces) == (
        "no scan of one has 100000 pixels of an object at least 20 mm above the ground "
        "around it"
    )


def test_regions_that_touch_are_one_body() -> None:
    def region(east: float, reach: float) -> Any:
        return SimpleNamespace(centre=np.array([east, 0.0, 0.0]), reach=reach, area=1.0)

    chain = [region(0.0, 0.1), region(1.0, 0.1), region(0.19, 0.1), region(0.38, 0.1)]
    assert moved.bodies(chain) == ((0, 2, 3), (1,))
    assert moved.bodies([region(0.0, 0.1), region(0.21, 0.1)]) == ((0,), (1,))
    assert moved.bodies([]) == ()
