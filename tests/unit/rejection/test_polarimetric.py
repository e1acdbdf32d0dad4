"""Channels, ratios, Stokes vectors, and subtraction and unmixing in one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor import rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.optics.polarization import mueller
from amulor.rejection import channels
from amulor.rejection.ratios import ratio_of
from amulor.simulation import simulate
from amulor.survey import Survey

Make = Callable[..., xr.Dataset]
PAINT, MILK = 0.39 / 1.61, 0.19 / 1.81
PAIR = {"VV": (1.0, 1.0), "VH": (PAINT, MILK)}
TARGET = mueller.painted_metal()
WATER = mueller.diagonal(0.81, -0.81, -0.62)


def _shares(pairs: list[str]) -> dict[str, tuple[float, float]]:
    return {
        pair: tuple(
            float(mueller.detected_fraction(matrix, pair=pair))
            for matrix in (TARGET, WATER)
        )
        for pair in pairs
    }


# Ratios ---------------------------------------------------------------------------


@pytest.mark.parametrize("method", [rejection.polarization, rejection.combined])
@given(seed=st.integers(0, 10_000), paint=st.sampled_from([1.0, 0.6]))
@settings(max_examples=12)
def test_ratios_at_the_ends_are_not_refused_for_their_noise(
    by_hand: Make, method: Callable[..., xr.Dataset], seed: int, paint: float
) -> None:
    # Water that keeps polarization, on paint that keeps none of it or some.
    pair = {"VV": (1.0, 1.0), "VH": (paint, 0.0)}
    cube = by_hand(seed, frequency=[20e6, 39e6], channels=pair, noise=5e-3)
    try:
        found = method(cube)
    except CubeError as error:
        # Of a thousand steady scans one is refused for a drift, by its P-value. Where
        # a channel has no water signal, any drift is a large part of it.
        assume("from the first shot to the last" not in str(error))
        raise
    assert 0 <= found.attrs["target_ratio"] <= 1
    assert 0 <= found.attrs.get("water_ratio", 0.0) <= 1
    phase = 4 * np.pi * 39e6 * 1.38 * 1.5 / 299792458.0
    # 48 pixels with errors of 5 mV of 1 V, and what they share.
    assert abs(np.mean(found.amulor.signal.values[1]) - np.exp(1j * phase)) < 0.02


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 4))]
)
def test_the_preset_with_two_channels_is_unmixed(seed: int) -> None:
    changed = {"instrument.polarizations": ["VV", "VH"]}
    changed |= {"scan.columns": 6, "scan.rows": 4}
    survey = Survey.preset("amulor-2010-long").with_(changed)
    cube = simulate(survey, rng=np.random.default_rng(seed))
    target = rejection.polarization(cube)
    truth = cube.amulor.truth.sel(polarization=["VV"])
    clean = truth["target_in_phase"].values + 1j * truth["target_quadrature"].values
    miss = np.abs(target.amulor.signal.values - clean) / np.abs(clean)
    assert np.median(miss) < 0.05


@pytest.mark.parametrize("method", [rejection.polarization, rejection.combined])
def test_a_ratio_beyond_its_error_is_refused_with_it(
    by_hand: Make, method: Callable[..., xr.Dataset]
) -> None:
    swapped = {"VV": (0.8, 0.1), "VH": (1.0, 0.2)}
    cube = by_hand(3, frequency=[20e6, 39e6], channels=swapped)
    with pytest.raises(CubeError, match=r"target_ratio must lie .* 1\.25\d \+- 0\.00"):
        method(cube)


@pytest.mark.slow
def test_the_ratios_are_found_within_their_errors(by_hand: Make) -> None:
    scores = {"water": [], "target": []}
    for seed in range(30):
        cube = by_hand(seed, frequency=[20e6, 39e6], channels=PAIR, noise=5e-3)
        for name, found, true in (
            ("water", rejection.water_ratio(cube), MILK),
            ("target", rejection.target_ratio(cube), PAINT),
        ):
            scores[name].append((found.value - true) / found.uncertainty)
            assert found.uncertainty < 0.02
    for name, score in scores.items():
        # 30 draws: the deviation of a standard normal to 13 %. The error of the
        # reference is an upper limit for the target.
        assert 0.4 < np.std(score) < 1.45, name
        assert abs(np.mean(score)) < 0.8, name


def test_pixels_of_water_alone_tell_the_ratio_without_shots(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=PAIR, target=0.0, shots=0)
    everywhere = np.ones(cube["azimuth"].shape, dtype=bool)
    found = rejection.water_ratio(cube, water_only=everywhere)
    assert abs(found.value - MILK) < 4 * found.uncertainty
    assert found.source == "48 pixels of water alone"
    with pytest.raises(CubeError, match="--water-ratio"):
        rejection.water_ratio(cube)
    with pytest.raises(CubeError, match="they must agree"):
        rejection.water_ratio(cube, water_only=np.ones((2, 2)))
    with pytest.raises(CubeError, match="needs 5 pixels"):
        rejection.water_ratio(cube, water_only=np.arange(48).reshape(6, 8) < 3)


def test_targets_of_two_kinds_widen_the_uncertainty(by_hand: Make) -> None:
    one = by_hand(1, frequency=[39e6], channels=PAIR)
    other = by_hand(2, frequency=[39e6], channels={**PAIR, "VH": (0.5, MILK)})
    both = one.copy(deep=True)
    for name in ("in_phase", "quadrature"):
        both[name][..., ::2] = other[name].values[..., ::2]
    found = rejection.target_ratio(both)
    # Half at 0.242 and half at 0.5: mean 0.371, spread 0.129.
    assert found.value == pytest.approx((PAINT + 0.5) / 2, abs=0.02)
    assert found.uncertainty == pytest.approx((0.5 - PAINT) / 2, rel=0.1)
    assert rejection.target_ratio(one).uncertainty < 0.02


def _left(make: Make, light: np.ndarray, noise: np.ndarray) -> xr.Dataset:
    """Return what open water leaves, with light (pair, pixel) and its deviation."""
    cube = rejection.open_water(make(1, frequency=[39e6], channels=PAIR, noise=1e-3))
    rows, columns = cube.sizes["row"], cube.sizes["column"]
    order = ["VV", "VH"]

    def filled(values: np.ndarray) -> xr.DataArray:
        return xr.DataArray(
            values.reshape(2, 1, rows, columns),
            dims=("polarization", "modulation_frequency", "row", "column"),
            coords={"polarization": order},
        ).reindex(polarization=cube["polarization"].values)

    exact = {name: 0.0 * cube[name] for name in cube if str(name).startswith("common_")}
    return cube.assign(
        exact
        | {
            "in_phase": filled(light.real).transpose(*cube["in_phase"].dims),
            "quadrature": filled(light.imag).transpose(*cube["in_phase"].dims),
            "in_phase_uncertainty": filled(noise).transpose(*cube["in_phase"].dims),
            "quadrature_uncertainty": filled(noise).transpose(*cube["in_phase"].dims),
            "in_phase_quadrature_covariance": 0.0 * cube["in_phase"],
            "quality_flag": 0 * cube["quality_flag"],
        }
    )


def test_pixels_count_for_the_ratio_by_the_variance_of_their_difference(
    by_hand: Make,
) -> None:
    # Of b - r a: that of b where a is sure, that of r a where b is. They are alike
    # here, so a small change of b counts alike in both halves of the pixels.
    size, sure = 48, 1e-6
    light = np.array([np.full(size, 1.0 + 0j), np.full(size, PAINT + 0j)])
    noise = np.array([np.full(size, 1e-3), np.full(size, sure)])
    noise[:, size // 2 :] = [[sure], [1e-3 * PAINT]]
    start = ratio_of(_left(by_hand, light, noise)).value
    assert start == pytest.approx(PAINT, rel=1e-5)
    moved = []
    for pixel in (3, size // 2 + 3):
        changed = light.copy()
        changed[1, pixel] += 1e-3
        moved.append(ratio_of(_left(by_hand, changed, noise)).value - start)
    assert moved[0] == pytest.approx(1e-3 / size, rel=1e-2)
    assert moved[1] == pytest.approx(moved[0], rel=1e-2)


def test_the_spread_of_ratios_is_what_noise_leaves_of_their_scatter(
    by_hand: Make,
) -> None:
    size, apart, sigma, own = 48, 0.02, 0.05, 0.008
    sign = np.where(np.arange(size) % 2, 1.0, -1.0)
    light = np.array([np.full(size, 1.0 + 0j), PAINT + apart * sign])
    noise = np.array([np.full(size, sigma), np.full(size, own)])
    found = ratio_of(_left(by_hand, light, noise))
    # The scatter of the ratios, less what noise of either makes of it; and the error
    # of the mean.
    spread = np.sqrt(apart**2 - own**2 - (PAINT * sigma) ** 2)
    expected = np.hypot(spread, apart / np.sqrt(size))
    assert found.uncertainty == pytest.approx(expected, rel=1e-2)


def test_without_a_target_there_is_no_ratio_of_it(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=PAIR, target=0.0)
    with pytest.raises(CubeError, match="--target-ratio"):
        rejection.target_ratio(cube)


def test_unmixing_estimates_what_is_not_stated(plate_text: str) -> None:
    text = plate_text.replace("repeats = 8", "repeats = 60")
    cube = simulate(Survey.from_text(text), rng=11)
    found = rejection.polarization(cube)
    assert abs(found.attrs["target_ratio"] - PAINT) < 0.02
    assert abs(found.attrs["water_ratio"] - MILK) < 0.01
    stated = rejection.polarization(cube, target_ratio=PAINT, water_ratio=MILK)
    change = abs(found.amulor.signal - stated.amulor.signal)
    sigma = np.hypot(found["in_phase_uncertainty"], found["quadrature_uncertainty"])
    assert float((change / sigma).median()) < 1.5


# Channels -------------------------------------------------------------------------


def test_partners_are_what_a_mirror_makes_dark_and_bright() -> None:
    mirror = mueller.ideal_backscatter()
    for co, cross in channels.PARTNERS.items():
        assert mueller.detected_fraction(mirror, pair=co) == pytest.approx(1)
        assert mueller.detected_fraction(mirror, pair=cross) == pytest.approx(0)


@pytest.mark.parametrize(
    "pairs", [["VV", "VH"], ["RR", "RL"], ["VV", "VH", "RR", "RL"]]
)
def test_bright_water_asks_for_the_crossed_channel(
    by_hand: Make, pairs: list[str]
) -> None:
    cube = by_hand(frequency=[39e6], channels=_shares(pairs), water=0.5)
    choice = rejection.choose_channel(cube)
    assert choice.polarization in channels.CROSS_POLARIZED
    # Shares by hand: the circular one has (1 + m44)/2 of the target, 0.27, and 0.19 of
    # the water; the linear one 0.195 and 0.095.
    if len(pairs) == 4:
        assert choice.polarization == "VH"
    assert "cross-polarized" in choice.reason


def test_dark_water_asks_for_the_bright_channel(by_hand: Make) -> None:
    cube = by_hand(
        frequency=[39e6], channels=_shares(["VV", "VH"]), water=1e-4, noise=2e-2
    )
    assert rejection.choose_channel(cube).polarization == "VV"


def test_no_target_no_choice(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=PAIR, target=0.0)
    with pytest.raises(CubeError, match="no pixel shows a target in any channel"):
        rejection.choose_channel(cube)


# Stokes vectors -------------------------------------------------------------------


@settings(max_examples=30)
@given(st.floats(-0.9, 0.9), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.booleans())
def test_four_analysers_tell_the_stokes_vector(
    by_hand: Make, q: float, u: float, v: float, more: bool
) -> None:
    from amulor.optics.polarization import stokes

    vector = np.array([1.0, q, u, v])
    pairs = ["VV", "VH", "VP", "VR"] + (["VM", "VL"] if more else [])
    passed = {pair: (float(stokes.state(pair[1]) @ vector / 2), 0.0) for pair in pairs}
    cube = by_hand(frequency=[39e6], channels=passed, noise=1e-9, water=0.0, shots=0)
    found = rejection.stokes_vectors(cube, launched="V")
    assert found.dims[0] == "stokes"
    assert_allclose(abs(found.values[:, 0, 0, 0]), abs(vector), rtol=0, atol=1e-7)
    # All components have the phase of the echo, or its opposite.
    relative = found.values[:, 0, 0, 0] / found.values[0, 0, 0, 0]
    assert_allclose(relative, vector, rtol=0, atol=1e-7)


@pytest.mark.parametrize("pairs", [["VV", "VH", "VP"], ["VV", "VH", "VP", "VM"]])
def test_analysers_that_do_not_tell_it_are_refused(
    by_hand: Make, pairs: list[str]
) -> None:
    cube = by_hand(frequency=[39e6], channels=_shares(pairs), shots=0)
    with pytest.raises(CubeError, match="do not tell a Stokes vector"):
        rejection.stokes_vectors(cube, launched="V")


def test_unmixing_in_stokes_form_separates_target_and_water(by_hand: Make) -> None:
    cube = by_hand(
        frequency=[20e6, 39e6],
        channels=_shares(["RR", "RL", "RV", "RP"]),
        noise=1e-7,
        water=0.5,
    )
    found = rejection.unmix_stokes(
        cube, launched="R", target_mueller=TARGET, water_mueller=WATER
    )
    cubes.check(found, "target_signal")
    # The first channel, RR, passes 0.27 of the target.
    assert_allclose(found.amulor.amplitude, 0.27, rtol=1e-5)
    assert not found["quality_flag"].values.any()


def test_more_analysers_make_it_better_and_the_error_true(by_hand: Make) -> None:
    arguments = {
        "launched": "V",
        "target_mueller": TARGET,
        "water_mueller": WATER,
        "mueller_uncertainty": 0.0,
    }
    four = by_hand(
        frequency=[39e6],
        channels=_shares(["VV", "VH", "VP", "VR"]),
        shape=(40, 40),
        shots=0,
    )
    two = four.sel(polarization=["VV", "VH"])
    sigma = []
    for cube in (two, four):
        found = rejection.unmix_stokes(cube, **arguments)
        phase = 4 * np.pi * 39e6 * 1.38 * 1.5 / 299792458.0
        error = found.amulor.signal.values - 0.805 * np.exp(1j * phase)
        # 1600 pixels and two outputs: a standard deviation to 1.8 %; four of them.
        scatter = np.sqrt(np.mean(abs(error) ** 2) / 2)
        sigma.append(float(found["in_phase_uncertainty"].mean()))
        assert scatter == pytest.approx(sigma[-1], rel=0.07)
    assert sigma[1] < 0.9 * sigma[0]


def test_what_cannot_be_told_apart_is_refused(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=_shares(["VV", "VH"]))
    with pytest.raises(CubeError, match="same proportions"):
        rejection.unmix_stokes(
            cube, launched="V", target_mueller=WATER, water_mueller=WATER
        )
    with pytest.raises(CubeError, match="two or more with R launched"):
        rejection.unmix_stokes(
            cube, launched="R", target_mueller=TARGET, water_mueller=WATER
        )
    with pytest.raises(CubeError, match="'Z'"):
        rejection.stokes_vectors(cube, launched="Z")


# Combined -------------------------------------------------------------------------


def test_combining_is_no_worse_than_either_channel(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=PAIR, shape=(40, 40), shots=400)
    found = rejection.combined(cube, target_ratio=PAINT)
    cubes.check(found, "target_signal")
    error = found.amulor.signal.values[:, 0] - np.exp(
        1j * 4 * np.pi * 39e6 * 1.38 * 1.5 / 299792458.0
    )
    shared = found["common_in_phase_uncertainty"].values
    stated = np.sqrt(found["in_phase_uncertainty"].values ** 2 - shared**2)
    # The inverse variances of 1 and of VH over its ratio add up; water that departs
    # from its shots is an error that pixels share.
    expected = 2e-3 / np.sqrt(1 + PAINT**2)
    assert stated.mean() == pytest.approx(expected, rel=0.03)
    scatter = np.sqrt(np.mean(abs(error - error.mean()) ** 2) / 2)
    # 3200 outputs: 1.3 %; four of them.
    assert scatter == pytest.approx(expected, rel=0.05)


def test_water_that_changed_is_told_by_polarization(by_hand: Make) -> None:
    cube = by_hand(
        frequency=[39e6],
        channels=PAIR,
        water=0.5,
        reference_water=0.4,
        noise=1e-4,
        shots=200,
    )
    true = np.exp(1j * 4 * np.pi * 39e6 * 1.38 * 1.5 / 299792458.0)
    error = {
        change: abs(
            rejection.combined(
                cube, target_ratio=PAINT, water_change=change
            ).amulor.signal.values
            - true
        ).mean()
        for change in (0.0, 0.3)
    }
    # Subtraction alone would leave 0.1 / sqrt(1 + 1.3^2) = 0.06 of water in. That the
    # channels disagree tells how much it is, whether or not one expects it.
    assert error[0.0] < 0.006
    assert error[0.3] < 0.006


def test_an_unsure_ratio_is_an_error_that_pixels_share(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=PAIR)
    step, dr = 1e-5, 0.05
    base, moved = (
        rejection.combined(cube, target_ratio=ratio) for ratio in (PAINT, PAINT + step)
    )
    unsure = rejection.combined(cube, target_ratio=PAINT, target_ratio_uncertainty=dr)
    grown = np.sqrt(
        unsure["common_in_phase_uncertainty"].values ** 2
        - base["common_in_phase_uncertainty"].values ** 2
    )
    expected = abs((moved["in_phase"] - base["in_phase"]).values) / step * dr
    assert_allclose(grown, expected, rtol=0.15, atol=2e-4)


def test_saturation_and_gaps_in_either_channel_are_kept(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=PAIR)
    cube["saturated"][0, 1, 2, 2] = 1
    cube["in_phase"][0, 0, 3, 3] = np.nan
    flag = rejection.combined(cube, target_ratio=PAINT)["quality_flag"].values[0, 0]
    assert flag[2, 2] & QualityFlag.SATURATED
    assert flag[3, 3] == QualityFlag.MISSING
    assert np.count_nonzero(flag) == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"target_ratio": 1.2}, "between 0 and 1"),
        ({"target_ratio": 0.2, "water_change": -1.0}, "not negative"),
    ],
)
def test_odd_numbers_are_refused(by_hand: Make, arguments: dict, words: str) -> None:
    cube = by_hand(frequency=[39e6], channels=PAIR)
    with pytest.raises(ValueError, match=words):
        rejection.combined(cube, **arguments)


def test_combining_needs_both_channels_and_shots(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=PAIR)
    with pytest.raises(CubeError, match=r"VV\+VH"):
        rejection.combined(cube.sel(polarization=["VV"]))
    with pytest.raises(CubeError, match="no open-water shots"):
        rejection.combined(cubes.without_groups(cube))
