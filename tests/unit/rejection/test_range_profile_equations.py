"""One surface of several in a beam: what is left, its errors, and limits of doubt."""

from __future__ import annotations

import importlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance

#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.range_profile")

FREQUENCY = np.arange(1.0, 25.0) * 10e6
INDEX = 1.38
WAVE = 4 * np.pi * FREQUENCY * INDEX / 299792458.0
#: Half of the speed in water over the bandwidth.
WIDTH = 299792458.0 / INDEX / 2 / np.ptp(FREQUENCY)
WATER = 0.3 / (1 - 1j * FREQUENCY / 30e6)


def echoes(*pairs: tuple[float, float]) -> np.ndarray:
    """Return surfaces of an amplitude at a slant range."""
    parts = [size * np.exp(1j * WAVE * place) for size, place in pairs]
    return np.asarray(sum(parts, np.zeros(FREQUENCY.size)))


def beam(
    signal: np.ndarray,
    *,
    error: float = 0.01,
    water: np.ndarray | None = None,
    surface: str = "strongest",
) -> Any:
    return module._one_surface(
        signal,
        np.full(FREQUENCY.size, error),
        water,
        frequency=FREQUENCY,
        group_index=INDEX,
        interval=(0.5, 6.0),
        most=3,
        surface=surface,
    )


@pytest.mark.parametrize(
    ("surface", "place"), [("strongest", 2.5), ("nearest", 1.2), ("farthest", 4.1)]
)
def test_a_surface_is_left_without_water_and_other_surfaces(
    surface: str, place: float
) -> None:
    sizes = {1.2: 0.3, 2.5: 1.0, 4.1: 0.5}
    signal = echoes(*((size, at) for at, size in sizes.items())) + 0.8 * WATER
    found = beam(signal, water=WATER, surface=surface)
    assert found.place == pytest.approx(place, abs=1e-3)
    assert_allclose(found.target, echoes((sizes[place], place)), atol=2e-3)
    assert not found.misfit


@pytest.mark.parametrize(("share", "chosen"), [(0.097, 2.5), (0.103, 1.2)])
def test_a_tenth_of_the_strongest_surface_counts(share: float, chosen: float) -> None:
    signal = echoes((share, 1.2), (1.0, 2.5))
    found = beam(signal, error=2e-3, surface="nearest")
    assert found.place == pytest.approx(chosen, abs=2e-3)


def test_errors_of_one_surface_are_those_of_its_samples() -> None:
    found = beam(echoes((1.0, 2.5)), error=0.02)
    assert_allclose(found.variance, 4e-4)
    # A second one takes a part of what the samples tell.
    both = beam(echoes((1.0, 2.5), (0.9, 2.5 + 1.1 * WIDTH)), error=0.02)
    assert both.variance[0] > 4.1e-4


@pytest.mark.parametrize(("apart", "doubted"), [(0.78, False), (0.72, True)])
def test_surfaces_closer_than_three_quarters_of_the_resolution_are_doubted(
    apart: float, doubted: bool
) -> None:
    signal = echoes((1.0, 2.5), (0.9, 2.5 + apart * WIDTH))
    found = beam(signal, error=1e-4)
    assert found.misfit == doubted


@pytest.mark.parametrize(("factor", "misfit"), [(0.97, False), (1.03, True)])
@pytest.mark.parametrize("has_water", [False, True])
def test_samples_depart_by_twice_their_errors(
    monkeypatch: pytest.MonkeyPatch, factor: float, misfit: bool, has_water: bool
) -> None:
    rng = np.random.default_rng(1)
    parts = rng.standard_normal((2, FREQUENCY.size))
    off = parts[0] + 1j * parts[1]
    if has_water:
        off -= WATER * np.sum((WATER.conj() * off).real) / np.sum(np.abs(WATER) ** 2)
    # Of 48 outputs, amplitude and place are fitted, and the water.
    freedom = 48 - 2 - has_water
    off *= factor * 2 * 0.01 * np.sqrt(freedom / np.sum(np.abs(off) ** 2))
    surface = SimpleNamespace(
        amplitude=np.array([1.0]), slant_range=np.array([2.5]), covariance=np.eye(1)
    )
    monkeypatch.setattr(module.profiles, "surfaces", lambda *_, **__: surface)
    signal = echoes((1.0, 2.5)) + off + (0.7 * WATER if has_water else 0)
    found = beam(signal, water=WATER if has_water else None)
    assert found.misfit == misfit
    assert_allclose(found.target, echoes((1.0, 2.5)) + off, atol=1e-12)


def test_no_surface_leaves_what_is_no_water() -> None:
    found = beam(0.9 * WATER, water=WATER)
    assert found.place is None
    assert_allclose(found.target, 0, atol=1e-12)
    assert_allclose(found.variance, 1e-4)
    assert not found.misfit


def test_late_light_is_divided_out_and_put_back() -> None:
    # An echo that is weaker and later at high frequencies.
    logarithm = -(0.05 + 0.02j) * (FREQUENCY / FREQUENCY[-1]) ** 2
    late = module._LateLight(
        np.array([1.0, 4.0]), np.stack([0 * logarithm, 2 * logarithm], axis=1)
    )
    # Linear between the places: one half at 2.5 m is the logarithm itself.
    assert_allclose(late.at(2.5), logarithm)
    signal = echoes((1.0, 2.5)) * np.exp(logarithm)
    words: dict[str, Any] = {
        "frequency": FREQUENCY, "group_index": INDEX, "interval": (0.5, 6.0),
        "most": 3, "surface": "strongest",
    }  # fmt: skip
    error = np.full(FREQUENCY.size, 0.01)
    found = module._separated(signal, error, late, None, **words)
    assert found.place == pytest.approx(2.5, abs=1e-3)
    assert_allclose(found.target, signal, atol=1e-3)
    # Errors of the samples, and a share of the late light as its doubt.
    doubt = module.RELATIVE_UNCERTAINTY * np.abs(logarithm) * np.abs(signal)
    assert_allclose(found.variance, 1e-4 + doubt**2, rtol=0.02)
    plain = module._separated(echoes((1.0, 2.5)), error, None, None, **words)
    assert_allclose(plain.variance, 1e-4, rtol=0.02)


def test_the_second_search_has_the_water_without_late_light(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = []

    def found(signal: Any, error: Any, water: Any) -> Any:
        given.append(water)
        return module._Beam(signal, error**2, 2.5, False)

    monkeypatch.setattr(module, "_one_surface", found)
    weaker = np.full((FREQUENCY.size, 2), np.log(0.5) + 0j)
    late = module._LateLight(np.array([1.0, 4.0]), weaker)
    error = np.full(FREQUENCY.size, 0.01)
    module._separated(echoes((1.0, 2.5)), error, late, WATER)
    assert_allclose(given, [WATER, 2 * WATER])


@pytest.mark.parametrize(
    ("interval", "ends"), [((1.0, 4.0), (1.0, 4.0)), ((0.1, 4.0), (0.2, 4.0))]
)
def test_late_light_is_tabulated_from_a_twentieth_of_the_interval(
    monkeypatch: pytest.MonkeyPatch,
    interval: tuple[float, float],
    ends: tuple[float, float],
) -> None:
    monkeypatch.setattr(
        module, "late_response", lambda scan, place: np.outer(FREQUENCY, place) + 0j
    )
    found = module._LateLight.of(None, interval)
    assert (found.place[0], found.place[-1]) == pytest.approx(ends)
    assert found.place.size == 9
    assert_allclose(found.at(3.0), 3 * FREQUENCY)
    monkeypatch.setattr(
        module, "late_response", lambda scan, place: np.full((2, 9), np.nan)
    )
    assert module._LateLight.of(None, interval) is None
    monkeypatch.setattr(module, "late_response", lambda scan, place: None)
    assert module._LateLight.of(None, interval) is None


def test_open_water_is_a_mean_with_its_error_and_scatter() -> None:
    rng = np.random.default_rng(2)
    parts = rng.standard_normal((2, 3, 1, 20)) * [[[[0.3]]], [[[0.1]]]]
    signal = 2 + parts[0] + 1j * parts[1]
    noise = Covariance(*(np.full((3, 1, 20), v) for v in (0.01, 0.02, 0.0)))
    shots = SimpleNamespace(signal=signal, covariance=noise)
    scan: Any = SimpleNamespace(signal=np.zeros((3, 1, 2, 2)), shots=shots)
    mean, fluctuation, common = module._open_water(scan)
    assert_allclose(mean, signal.mean(axis=2))
    for k in range(3):
        square = np.cov(parts[:, k, 0])
        assert common.in_phase[k, 0] == pytest.approx(square[0, 0] / 20)
        assert common.quadrature[k, 0] == pytest.approx(square[1, 1] / 20)
        assert common.cross[k, 0] == pytest.approx(square[0, 1] / 20)
        # The larger of both outputs, beyond the stated noise.
        beyond = max(square[0, 0] - 0.01, square[1, 1] - 0.02, 0.0)
        assert fluctuation[k, 0] == pytest.approx(beyond)
    quiet = Covariance(*(np.full((3, 1, 20), v) for v in (9.0, 9.0, 0.0)))
    scan.shots = SimpleNamespace(signal=signal, covariance=quiet)
    assert_allclose(module._open_water(scan)[1], 0)
    for count, known in ((1, False), (2, True)):
        part = Covariance(*(v[..., :count] for v in vars(noise).values()))
        scan.shots = SimpleNamespace(signal=signal[..., :count], covariance=part)
        assert (module._open_water(scan)[2] is not None) == known
    scan.shots = None
    assert module._open_water(scan)[0] is None


@pytest.mark.parametrize(("count", "enough"), [(4, False), (5, True)])
def test_two_more_frequencies_than_surfaces_are_needed(
    count: int, enough: bool
) -> None:
    frequency = FREQUENCY[:count]
    if enough:
        span = 299792458.0 / INDEX / 2 / 10e6
        assert module._places(frequency, INDEX, None, 3) == pytest.approx((0, span))
        assert module._places(frequency, INDEX, (1.0, 1 + 0.999 * span), 3)[0] == 1.0
        with pytest.raises(CubeError, match="longer than the unambiguous span"):
            module._places(frequency, INDEX, (1.0, 1 + 1.001 * span), 3)
        return
    with pytest.raises(CubeError, match="needs 5 modulation frequencies or more"):
        module._places(frequency, INDEX, None, 3)


@pytest.mark.parametrize(("cells", "suits"), [(9.99, False), (10.01, True)])
def test_a_profile_needs_ten_resolutions_in_the_interval(
    cells: float, suits: bool
) -> None:
    cube: Any = {
        "modulation_frequency": SimpleNamespace(values=FREQUENCY),
        "geometry": SimpleNamespace(attrs={"group_index": INDEX}),
    }
    said = module._unsuited(cube, (1.0, 1 + cells * WIDTH))
    assert (said == "") == suits
    if not suits:
        assert said == (
            f"a bandwidth of 230 MHz resolves {WIDTH:.2g} m; a profile needs a tenth "
            f"of the interval, {0.999 * WIDTH:.2g} m"
        )
    cube["modulation_frequency"].values = np.array([20e6, 20e6])
    assert (
        module._unsuited(cube, None) == "one modulation frequency has no range profile"
    )
