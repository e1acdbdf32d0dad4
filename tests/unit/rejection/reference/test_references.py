"""References at the pixels: polynomials, their errors, and those of all channels."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.reference import shots as module
from amulor.rejection.reference.shots import (
    NO_DRIFT,
    Drift,
    expected_at_pixels,
    fit_channel,
    fit_shots,
    fluctuation_of,
    real_drift_of,
    shots_of,
)
from amulor.rejection.reference.surface import Surface

Make = Callable[..., xr.Dataset]
#: Directions of ten shots, twice in each of five.
PLACES = np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.1], [0.2, 0.1], [0.1, 0.05]] * 2)
PIXELS = np.array([[0.05, 0.02], [0.1, 0.05], [0.2, 0.1], [0.15, 0.0]])
#: Terms 1, y and x of the scaled directions.
POWERS = np.array([[0, 0], [0, 1], [1, 0]])
X, Y = (PIXELS[:, 0] - 0.1) / 0.1, (PIXELS[:, 1] - 0.05) / 0.05
DESIGN = np.stack([np.ones(4), Y, X], axis=1)
COEFFICIENTS: Any = np.array([0.5 + 0.2j, 0.03j, -0.04])


def surface(**changed: Any) -> Surface:
    rng = np.random.default_rng(1)
    spreads = []
    for _ in range(2):
        root = 1e-3 * rng.standard_normal((3, 3))
        spreads.append(root @ root.T)
    values: dict[str, Any] = {
        "powers": POWERS,
        "coefficients": COEFFICIENTS,
        "spreads": [*spreads, 0.3 * spreads[0]],
        "logarithm": None,
        "relative": np.array([[4e-4, 0.0], [0.0, 1e-4]]),
        "level": np.full(10, 0.5 + 0.2j),
        "cross_validation": 1.0,
        "excess": 0.0,
    }
    return Surface(**values | changed)


INSTRUMENT = Covariance(*(np.full(10, v) for v in (3e-6, 1e-6, 0.0)))
SHOTS: Any = np.full(10, 0.5 + 0.2j)


def reference(of: Surface, shape: Any = None) -> Any:
    return fit_channel(SHOTS, INSTRUMENT, PLACES, PIXELS, surface=of, shape=shape)


def test_a_reference_is_its_polynomial_with_the_errors_of_the_coefficients() -> None:
    of = surface()
    found = reference(of)
    assert_allclose(found.signal, DESIGN @ COEFFICIENTS)
    for errors, spread in zip(vars(found.common).values(), of.spreads, strict=True):
        assert_allclose(errors, np.einsum("ni,ij,nj->n", DESIGN, spread, DESIGN))
    assert found.degree == 1
    assert found.surface is of
    assert found.relative is of.relative
    assert not found.modelled
    assert found.drift.change == 0


def test_pixels_in_blocks_have_the_same_reference(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    of = surface(logarithm=(np.array([0.01, 0.02j, 0.03]), 0.5 + 0.2j))
    whole = reference(of)
    monkeypatch.setattr(module, "_AT_ONCE", 3)
    parts = reference(of)
    assert_allclose(parts.signal, whole.signal, rtol=1e-12)
    for a, b in zip(vars(parts.common).values(), vars(whole.common).values(),
                    strict=True):  # fmt: skip
        assert_allclose(a, b, rtol=1e-12)


def test_the_distance_of_two_surfaces_is_an_error_along_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    logarithm: Any = np.array([0.01, 0.02j, 0.03])
    given: list[Any] = []
    off = np.array([0.001, 0.002j, 0.001 + 0.001j, -0.003])

    def disagreement(signal: Any, along: Any, middle: Any) -> Any:
        given.append((signal.copy(), along, middle))
        return off

    monkeypatch.setattr(module, "disagreement", disagreement)
    found = reference(surface(logarithm=(logarithm, 0.5 + 0.2j)))
    plain = reference(surface())
    ((signal, along, middle),) = given
    assert_allclose(signal, found.signal)
    assert_allclose(along, DESIGN @ logarithm)
    assert middle == 0.5 + 0.2j
    for name, extra in (
        ("in_phase", off.real**2), ("quadrature", off.imag**2),
        ("cross", off.real * off.imag),
    ):  # fmt: skip
        difference = getattr(found.common, name) - getattr(plain.common, name)
        assert_allclose(difference, extra, atol=1e-18)


def test_a_model_turns_the_polynomial_into_a_signal() -> None:
    at_pixels: Any = np.array([2.0, 1j, -1.0, 0.5 - 0.5j])
    shape: Any = SimpleNamespace(at_shots=np.ones(10), at_pixels=at_pixels)
    found, plain = reference(surface(), shape), reference(surface())
    assert found.modelled
    assert_allclose(found.signal, plain.signal * at_pixels)
    expected = plain.common.turned(at_pixels)
    for a, b in zip(vars(found.common).values(), vars(expected).values(), strict=True):
        assert_allclose(a, b)


def test_an_excess_is_an_error_in_every_direction() -> None:
    plain = reference(surface())
    found = reference(surface(excess=3.0))
    signal = plain.signal
    # Half of the variance of both outputs each, and the fluctuation of the water; five
    # directions have ten shots.
    side = signal / np.abs(signal)
    radial, tangential = 4e-4 * np.abs(signal) ** 2, 1e-4 * np.abs(signal) ** 2
    in_phase = 2e-6 + side.real**2 * radial + side.imag**2 * tangential
    quadrature = 2e-6 + side.imag**2 * radial + side.real**2 * tangential
    cross = side.real * side.imag * (radial - tangential)
    for name, extra in (
        ("in_phase", in_phase), ("quadrature", quadrature), ("cross", cross)
    ):  # fmt: skip
        difference = getattr(found.common, name) - getattr(plain.common, name)
        assert_allclose(difference, 3.0 * 5 / 10 * extra, rtol=1e-9)


@pytest.mark.parametrize(("count", "enough"), [(4, False), (5, True)])
def test_a_reference_needs_five_shots(count: int, enough: bool) -> None:
    part = INSTRUMENT.part(slice(0, count))
    arguments = SHOTS[:count], part, PLACES[:count], PIXELS
    if enough:
        fit_channel(*arguments)
        return
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        fit_channel(*arguments)
    assert str(refusal.value) == "a reference needs 5 shots, got 4"


# -- of all channels -------------------------------------------------------------------


@pytest.fixture
def cube(by_hand: Make) -> xr.Dataset:
    return by_hand(
        frequency=[20e6, 50e6], channels={"VV": (1.0, 1.0), "VH": (0.3, 0.1)},
        shape=(2, 3), shots=8,
    )  # fmt: skip


def test_references_follow_frequencies_and_channels(cube: xr.Dataset) -> None:
    scan = Observation(cube=cube)
    fits, fit = fit_shots(scan)
    assert len(fits) == 4
    assert scan.shots is not None
    means = scan.shots.signal.mean(axis=2).ravel()
    assert_allclose([f.signal.mean() for f in fits], means, rtol=0.05)
    signal, common = expected_at_pixels(fits, scan.signal.shape)
    for k, (f, c) in enumerate(np.ndindex(2, 2)):
        assert_array_equal(signal[f, c].ravel(), fits[k].signal)
        assert_array_equal(common.cross[f, c].ravel(), fits[k].common.cross)
        assert fit.surfaces[k] is fits[k].surface
    # Rows have the surfaces of the scan.
    again, same = fit_shots(Observation(cube=cube.isel(row=[1])), fit=fit)
    assert same is fit
    for k, part in enumerate(again):
        assert part.surface is fit.surfaces[k]
        assert_allclose(part.signal, fits[k].signal[3:], rtol=1e-9)


def test_a_lost_shot_is_left_out_and_too_few_are_named(cube: xr.Dataset) -> None:
    values = cube["open_water_quadrature"].values
    values[1, 1, 0] = 1e3
    cube["open_water_in_phase"].values[1, 1, 0] = np.nan
    fits, _ = fit_shots(Observation(cube=cube))
    assert np.abs(fits[3].signal).max() < 1.0
    cube["open_water_in_phase"].values[1, 1, 1:4] = np.nan
    with pytest.raises(CubeError) as refusal:
        fit_shots(Observation(cube=cube))
    assert str(refusal.value) == (
        "only 4 open-water shots at 50 MHz in channel VH are numbers, needed are 5; "
        "record more"
    )


def test_errors_that_all_shots_share_are_added(cube: xr.Dataset) -> None:
    plain, _ = fit_shots(Observation(cube=cube))
    dims = ("modulation_frequency", "polarization")
    size = np.array([[1e-3, 2e-3], [3e-3, 4e-3]])
    shared = cube.assign(
        open_water_common_in_phase_uncertainty=(dims, size),
        open_water_common_quadrature_uncertainty=(dims, 2 * size),
        open_water_common_covariance=(dims, 0.5 * size**2),
    )
    found, _ = fit_shots(Observation(cube=shared))
    for before, after, part in zip(plain, found, size.ravel(), strict=True):
        for name, extra in (("in_phase", 1), ("quadrature", 4), ("cross", 0.5)):
            difference = getattr(after.common, name) - getattr(before.common, name)
            assert_allclose(difference, extra * part**2, rtol=1e-6)


def test_shots_of_unknown_direction_have_no_drift(cube: xr.Dataset) -> None:
    known, _ = fit_shots(Observation(cube=cube))
    assert all(np.isfinite(fit.drift.uncertainty) for fit in known)
    bare = cube.drop_vars(["open_water_azimuth", "open_water_elevation"])
    fits, fit = fit_shots(Observation(cube=bare))
    assert all(part.drift is NO_DRIFT for part in fits)
    assert all(part.degree == 0 for part in fits)
    assert_array_equal(fit.directions, np.zeros((8, 2)))
    assert fit.model is None


@pytest.mark.parametrize("count", [0, 4])
def test_missing_shots_are_named_with_the_remedy(by_hand: Make, count: int) -> None:
    cube = by_hand(
        frequency=[20e6], channels={"VV": (1.0, 1.0)}, shape=(2, 3), shots=count
    )
    with pytest.raises(CubeError) as refusal:
        shots_of(Observation(cube=cube))
    words = (
        f"the cube has {count} open-water shots, needed are at least 5 to judge how "
        "much the water signal fluctuates; record more"
        if count
        else "the cube has no open-water shots (group open_water); record them with "
        "the target out of the beam, or use a method that needs none: joint with two "
        "or more frequencies, polarization with both ratios stated, or cross-polarized"
    )
    assert str(refusal.value) == words


def fake(change: complex, chance: float, relative: np.ndarray | None = None) -> Any:
    return SimpleNamespace(drift=Drift(change, 0.01 + 0.01j, chance), relative=relative)


def test_a_drift_is_real_by_a_chance_of_one_in_a_thousand_for_all() -> None:
    # Four channels: a quarter of a thousandth each.
    fits = [
        fake(0.1, 2.4e-4), fake(0.2j, 2.6e-4), fake(-0.3, 0.0), fake(0.4, 1.0),
    ]  # fmt: skip
    found = real_drift_of(fits, (2, 2, 5, 6))
    assert found.shape == (2, 2, 1, 1)
    assert_array_equal(found.ravel(), [0.1, 0.0, -0.3, 0.0])


def test_water_fluctuates_in_proportion_to_its_signal() -> None:
    rng = np.random.default_rng(1)
    water = rng.standard_normal((2, 1, 2, 3)) + 1j * rng.standard_normal((2, 1, 2, 3))
    relative = [np.diag([0.04, 0.01]), np.diag([0.09, 0.0])]
    found = fluctuation_of([fake(0, 1.0, part) for part in relative], water)
    for k, (radial, tangential) in enumerate(((0.04, 0.01), (0.09, 0.0))):
        a, b = water[k].real, water[k].imag
        assert_allclose(found.in_phase[k], radial * a**2 + tangential * b**2)
        assert_allclose(found.quadrature[k], radial * b**2 + tangential * a**2)
        assert_allclose(found.cross[k], (radial - tangential) * a * b)
