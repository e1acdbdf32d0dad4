"""Light between the walls of an inside corner, against an independent Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from corner_rays import double_over_single
from numpy.testing import assert_allclose

from amulor import Survey, imaging, rejection
from amulor.cube import QualityFlag
from amulor.imaging.corners import Patches, corner_ratio
from amulor.simulation import simulate
from amulor.studies.trust.surveys import corner, survey

#: The edge of the corner is vertical, at 2.6 m; its walls stand at 45 degrees.
EDGE = np.array([0.0, 0.0, 2.6])
LEFT, RIGHT = np.array([-1.0, 0.0, -1.0]) / 2**0.5, np.array([1.0, 0.0, -1.0]) / 2**0.5
UP = np.array([0.0, -1.0, 0.0])
INSTRUMENT = np.zeros(3)
WIDE, TALL = 0.3, 0.3


def _wall(reflectance: float, *, pitch: float = 0.02) -> Patches:
    """Patches of the right wall, WIDE x TALL around the height of the beam."""
    s, t = np.meshgrid(
        np.arange(pitch / 2, WIDE, pitch), np.arange(pitch / 2, TALL, pitch) - TALL / 2
    )
    position = EDGE + s.reshape(-1, 1) * RIGHT + t.reshape(-1, 1) * UP
    normal = np.broadcast_to(LEFT, position.shape)
    back = INSTRUMENT - position
    facing = np.sum(back * normal, axis=1) / np.linalg.norm(back, axis=1)
    return Patches(
        position=position,
        normal=np.array(normal),
        area=np.full(len(position), pitch**2),
        brightness=reflectance * facing,
        concerned=np.ones(len(position), dtype=bool),
    )


def _by_rays(away: float, reflectance: float, frequency: float, seed: int) -> complex:
    ratio, _ = double_over_single(
        EDGE + away * LEFT,
        RIGHT,
        wall_corner=EDGE - TALL / 2 * UP,
        wall_sides=(WIDE * RIGHT, TALL * UP),
        reflectance=reflectance,
        instrument=INSTRUMENT,
        modulation_frequency=frequency,
        group_index=1.38,
        attenuation=0.17,
        rays=100_000,
        rng=np.random.default_rng(seed),
    )
    return ratio


@pytest.mark.parametrize("away", [0.04, 0.08, 0.2])
@pytest.mark.parametrize("reflectance", [0.1, 0.4])
def test_the_ratio_is_that_of_traced_rays(away: float, reflectance: float) -> None:
    frequency = np.array([50e6, 146e6])
    ratio = corner_ratio(
        (EDGE + away * LEFT)[None],
        RIGHT[None],
        _wall(reflectance),
        receiver=INSTRUMENT,
        modulation_frequency=frequency,
        group_index=1.38,
        attenuation=0.17,
    )[:, 0]
    rays = [_by_rays(away, reflectance, f, k) for k, f in enumerate(frequency)]
    # Rays: 0.2 %. Patches of 2 cm near the edge: some percent.
    assert_allclose(ratio, rays, rtol=0.05)


def _corner_survey(
    count: int, reflectance: float, *, columns: int, rows: int
) -> Survey:
    """Survey of an inside corner whose walls have a given reflectance."""
    walls = corner(2.6, reflectance=reflectance)
    scan = {"azimuth": 0.0, "wide": 14, "tall": 10, "columns": columns, "rows": rows}
    return survey(count, *walls, baseline=1, **scan).with_(
        {"instrument.receiver.acceptance": "0.3 rad"}
    )


def _image(
    reflectance: float, *, lit: bool
) -> tuple[xr.Dataset, np.ndarray, np.ndarray]:
    """Range image of a corner with the light of both walls added to its samples."""
    described = _corner_survey(4, reflectance, columns=36, rows=18)
    cube = simulate(described, rng=3)
    signal = cube["truth_target_in_phase"] + 1j * cube["truth_target_quadrature"]
    distance = cube["truth_slant_range"].values
    across = (
        np.tan(cube["azimuth"].values / 1.34) * distance
    )  # nearly the beam in water
    if lit:
        away = np.abs(across) * 2**0.5
        places = np.linspace(0.005, 0.3, 14)
        ratio = np.zeros(signal.shape, dtype=complex)
        for index, frequency in enumerate(cube["modulation_frequency"].values):
            table = [
                _by_rays(s, reflectance, frequency, k) for k, s in enumerate(places)
            ]
            ratio[index] = np.interp(away, places, np.real(table))
            ratio[index] += 1j * np.interp(away, places, np.imag(table))
        added = np.nan_to_num(signal.values * ratio)
        cube["in_phase"].values[:] += added.real
        cube["quadrature"].values[:] += added.imag
        cube.attrs["corner_light"] = "present"
    target = rejection.open_water(cube, interval=(2.0, 3.0))
    image = imaging.range_image(target, polarization="VV", interval=(2.0, 3.0))
    return image, distance, across


def test_an_inside_corner_states_its_error() -> None:
    image, distance, across = _image(0.4, lit=True)
    flag = image["quality_flag"].values
    # The flag of the corner itself excludes no pixel here.
    valid = ((flag & ~QualityFlag.CORNER) == 0) & np.isfinite(distance)
    near = valid & (np.abs(across) < 0.1) & (np.abs(across) > 0.02)
    assert near.sum() > 50
    error = image["slant_range"].values - distance
    term = image["slant_range_uncertainty_corners"].values
    # The reflectance comes from noisy amplitudes, and the walls are a few patches.
    assert_allclose(np.median(term[near]), np.median(error[near]), rtol=0.5)
    z = error[near] / image["slant_range_uncertainty"].values[near]
    assert np.mean(np.abs(z) < 2) > 0.95
    without = np.sqrt(image["slant_range_uncertainty"].values ** 2 - term**2)
    flagged = (flag & QualityFlag.CORNER) != 0
    assert np.array_equal(flagged[valid], (term > without)[valid])
    assert flagged[near].mean() > 0.5
    assert np.mean(np.abs(error / without)[near] < 2) < 0.85


def test_a_simulation_without_such_light_has_no_term() -> None:
    image, _, _ = _image(0.4, lit=False)
    assert "slant_range_uncertainty_corners" not in image
    assert not (image["quality_flag"].values & QualityFlag.CORNER).any()


def test_at_one_frequency_the_term_includes_a_feigned_change_of_the_water() -> None:
    ranges = []
    for twice in (None, True):
        planned = _corner_survey(1, 0.4, columns=24, rows=12).with_(
            {"scan.second_reflection": twice}
        )
        target = rejection.open_water(simulate(planned, rng=3), interval=(2.0, 3.0))
        image = imaging.range_image(target, polarization="VV", interval=(2.0, 3.0))
        ranges.append(image["slant_range"].values)
    # Noise and water are the same, so the difference is the light of the corner.
    shift = np.nanmedian(ranges[1] - ranges[0])
    term = np.nanmedian(image["slant_range_uncertainty_corners"].values)
    assert shift > 0.005
    assert 0.5 * shift < term < 2 * shift
