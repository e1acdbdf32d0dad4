"""The method range-profile: closed forms of one and two surfaces, water, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.constants import speed_of_light

from amulor import pipeline, rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.rejection.observation import Observation
from amulor.rejection.reference.late_phase import late_response
from amulor.simulation import simulate
from amulor.studies.benchmark import light, scenes
from amulor.survey import Survey

FREQUENCIES = 1e6 * np.arange(100, 1001, 60)
INTERVAL = (1.0, 2.4)


@pytest.fixture(scope="module")
def frame(plate_text: str) -> xr.Dataset:
    """Return a scan whose samples the tests replace."""
    listed = ", ".join(f'"{f / 1e6:.0f} MHz"' for f in FREQUENCIES)
    text = plate_text.replace('["39 MHz"]', f"[{listed}]")
    cube = simulate(Survey.from_text(text), rng=3)
    # Scattered light is not in the closed forms below.
    return cube.assign_attrs(late_echo="absent")


def turns(cube: xr.Dataset, distance: float) -> np.ndarray:
    """Return the phase factors of an echo, shape (frequency, 1, 1, 1)."""
    index = float(cube["geometry"].attrs["group_index"])
    path = 4 * np.pi * FREQUENCIES * index * distance / speed_of_light
    return np.exp(1j * path)[:, None, None, None]


def with_signal(
    frame: xr.Dataset, scan: np.ndarray, shots: np.ndarray, *, error: float, seed: int
) -> xr.Dataset:
    """Return samples and shots with normal noise of a stated standard deviation."""
    rng = np.random.default_rng(seed)
    cube = frame.copy(deep=True)
    for prefix, clean in (("", scan), ("open_water_", shots)):
        shape = cube[f"{prefix}in_phase"].shape
        noise = rng.normal(0, error, (2, *shape))
        signal = np.broadcast_to(clean, shape) + noise[0] + 1j * noise[1]
        cube[f"{prefix}in_phase"].values = signal.real
        cube[f"{prefix}quadrature"].values = signal.imag
        for name in ("in_phase", "quadrature"):
            cube[f"{prefix}{name}_uncertainty"].values[:] = error
        cube[f"{prefix}in_phase_quadrature_covariance"].values[:] = 0
    return cube


def offsets(
    cube: xr.Dataset, distance: float, **options: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return estimated less true distance of the phases, and its uncertainty [m]."""
    target = rejection.range_profile(
        cube, interval=INTERVAL, model_error=1e-6, **options
    )
    signal = target.amulor.signal.values
    phase = np.angle(signal / turns(cube, distance))
    index = float(cube["geometry"].attrs["group_index"])
    slope = 4 * np.pi * FREQUENCIES[:, None, None, None] * index / speed_of_light
    variance = target["in_phase_uncertainty"].values ** 2 / np.abs(signal) ** 2
    information = np.sum(slope**2 / variance, axis=0)
    return np.sum(slope * phase / variance, axis=0) / information, information**-0.5


#: Water of a first-order low-pass of 20 MHz, eq. (49) of Ricci et al. 2010.
WATER = 0.5 / (1 - 1j * FREQUENCIES / 20e6)


def test_a_second_surface_and_water_do_not_shift_the_range(frame: xr.Dataset) -> None:
    error = 0.01
    echoes = 1.0 * turns(frame, 1.7) + 0.3 * turns(frame, 1.5)
    water = WATER[:, None, None]
    cube = with_signal(
        frame, echoes + 0.7 * water[..., None], water, error=error, seed=1
    )
    off, sigma = offsets(cube, 1.7)
    # Errors of a normal distribution: none beyond 4.5 in some hundred beams.
    assert np.sqrt(np.mean((off / sigma) ** 2)) == pytest.approx(1, abs=0.2)
    assert np.abs(off / sigma).max() < 4.5
    # Without the second surface the bound is that of the sum of phase slopes.
    slope = 4 * np.pi * FREQUENCIES * float(frame["geometry"].attrs["group_index"])
    bound = error / np.sqrt(np.sum((slope / speed_of_light) ** 2))
    assert (sigma > bound).all()


@pytest.mark.parametrize(
    ("surface", "distance"),
    [("nearest", 1.46), ("strongest", 1.58), ("farthest", 1.70)],
)
def test_each_of_three_surfaces_12_cm_apart_is_chosen(
    frame: xr.Dataset, surface: str, distance: float
) -> None:
    # 100 MHz to 1 GHz resolve 12 cm.
    echoes = 0.5 * turns(frame, 1.46) + turns(frame, 1.58) + 0.4 * turns(frame, 1.70)
    water = WATER[:, None, None]
    cube = with_signal(
        frame, echoes + 0.5 * water[..., None], water, error=5e-3, seed=5
    )
    off, sigma = offsets(cube, distance, surface=surface)
    assert np.sqrt(np.mean((off / sigma) ** 2)) == pytest.approx(1, abs=0.25)
    assert np.abs(off / sigma).max() < 4.5
    assert np.median(sigma) < 2e-3


def test_the_tail_of_late_light_is_flagged(frame: xr.Dataset) -> None:
    # Scattered light arrives with an exponential tail of 1 cm, which no resolution of
    # 12 cm separates from a second surface.
    wave = 4 * np.pi * FREQUENCIES * float(frame["geometry"].attrs["group_index"])
    tail = 1 / (1 - 0.01j * wave / speed_of_light)
    nothing = np.zeros((FREQUENCIES.size, 1, 1), dtype=complex)
    echo = tail[:, None, None, None] * turns(frame, 1.6)
    cube = with_signal(frame, echo, nothing, error=1e-3, seed=6)
    target = rejection.range_profile(cube, interval=INTERVAL)
    flagged = (target["quality_flag"].values & QualityFlag.WATER_RESIDUAL) != 0
    assert flagged.mean() > 0.95


@pytest.mark.parametrize("name", ["harbour-white-5-lengths", "harbour-white-7-lengths"])
def test_late_light_of_photon_transport_is_no_second_surface(name: str) -> None:
    (scene,) = (s for s in scenes.read() if s.name == f"{name}-sweep")
    case = scene.case()
    cube = case.samples.isel(row=[0, 6], column=[0, 11])
    # Expected values are those of photon transport.
    assert scene.water is not None
    assert scene.distance is not None
    frequency = np.array(light.FREQUENCIES["sweep"])
    table = light.read(scene.water, scene.distance, highest=frequency.max())
    echo = table.echo[np.searchsorted(light.ALL, frequency)]
    echo = echo[:, np.abs(light.OFFSETS).argmin()]
    depth = np.array([scene.distance])
    logarithm = late_response(Observation(cube=cube), depth)
    assert logarithm is not None
    path = light.GROUP_INDEX * (depth + np.hypot(depth, light.BASELINE))
    turned = echo * np.exp(-2j * np.pi * frequency * path / speed_of_light)
    amplitude = np.exp(logarithm[:, 0].real)
    np.testing.assert_allclose(
        amplitude / amplitude[0], np.abs(echo / echo[0]), rtol=0.025
    )
    assert np.abs(np.angle(turned) - logarithm[:, 0].imag).max() < 0.07
    target = rejection.range_profile(cube, interval=case.interval)
    assert not target["quality_flag"].values.any()
    image = pipeline.run(target, polarization="VV", interval=case.interval)
    error = image["slant_range"].values - scene.distance
    assert (np.abs(error) < 1.96 * image["slant_range_uncertainty"].values).all()
    assert np.abs(error).max() < 1.5e-3


def test_an_unknown_surface_is_refused(frame: xr.Dataset) -> None:
    with pytest.raises(ValueError, match="surface must be strongest, nearest or farth"):
        rejection.range_profile(frame, surface="second")


def test_one_surface_has_the_uncertainty_of_its_phases(frame: xr.Dataset) -> None:
    error = 0.01
    nothing = np.zeros((FREQUENCIES.size, 1, 1), dtype=complex)
    cube = with_signal(frame, turns(frame, 1.6), nothing, error=error, seed=2)
    cube = cube.drop_vars([n for n in cube.variables if str(n).startswith("open_wat")])
    off, sigma = offsets(cube, 1.6)
    slope = 4 * np.pi * FREQUENCIES * float(frame["geometry"].attrs["group_index"])
    bound = error / np.sqrt(np.sum((slope / speed_of_light) ** 2))
    assert np.median(sigma) == pytest.approx(bound, rel=0.05)
    assert np.sqrt(np.mean((off / sigma) ** 2)) == pytest.approx(1, abs=0.2)


def test_noise_alone_is_no_target(frame: xr.Dataset) -> None:
    water = WATER[:, None, None]
    cube = with_signal(frame, 0.9 * water[..., None], water, error=0.01, seed=3)
    target = rejection.range_profile(cube, interval=INTERVAL)
    empty = (target["quality_flag"].values & QualityFlag.NO_TARGET) != 0
    # One beam in a hundred finds a surface by chance.
    assert empty.mean() > 0.95


def test_samples_that_no_surfaces_explain_are_flagged(frame: xr.Dataset) -> None:
    gains = np.where(np.arange(FREQUENCIES.size) % 2, 1.0, 0.5)[:, None, None, None]
    nothing = np.zeros((FREQUENCIES.size, 1, 1), dtype=complex)
    cube = with_signal(frame, gains * turns(frame, 1.6), nothing, error=0.01, seed=4)
    target = rejection.range_profile(cube, interval=INTERVAL)
    flagged = (target["quality_flag"].values & QualityFlag.WATER_RESIDUAL) != 0
    assert flagged.all()


def test_scans_that_a_profile_cannot_resolve_are_refused(frame: xr.Dataset) -> None:
    few = frame.isel(modulation_frequency=slice(0, 4))
    with pytest.raises(CubeError, match="needs 5 modulation frequencies or more"):
        rejection.range_profile(few)
    with pytest.raises(CubeError, match="longer than the unambiguous span"):
        rejection.range_profile(frame, interval=(0.5, 9.0))
    with pytest.raises(ValueError, match="most must be 1 or more"):
        rejection.range_profile(frame, most=0)
