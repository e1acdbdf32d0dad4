"""Each rejection method: right signal, true uncertainty, flags, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor import rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.simulation import simulate
from amulor.survey import Survey


def _true(cube: xr.Dataset, part: str) -> np.ndarray:
    truth = cube.amulor.truth
    return truth[f"{part}_in_phase"].values + 1j * truth[f"{part}_quadrature"].values


@pytest.fixture(scope="module")
def samples(plate: Survey) -> xr.Dataset:
    return simulate(plate, rng=21)


def test_open_water_leaves_the_target_and_names_what_is_left(
    plate: Survey, samples: xr.Dataset
) -> None:
    square = []
    for seed in range(21, 24):
        cube = samples if seed == 21 else simulate(plate, rng=seed)
        found = rejection.open_water(cube, put_back=False)
        cubes.check(found, "target_signal")
        target, water = _true(cube, "target"), _true(cube, "water")
        left = (
            found["residual_in_phase"].values + 1j * found["residual_quadrature"].values
        )
        signal = found.amulor.signal.values
        # Raw, the water is a twelfth of the target; after, the residual estimate
        # explains what is left to within the noise.
        assert np.median(abs(water / target)[0, 0]) > 0.06
        sigma = np.hypot(found["in_phase_uncertainty"], found["quadrature_uncertainty"])
        square.append(np.mean(abs((signal - left - target) / sigma.values) ** 2))
    # The errors of the shots are shared by all pixels of a scan: 8 % for each.
    assert np.sqrt(np.mean(square)) == pytest.approx(1, abs=0.15)
    # The light of the same water without the plate, less that in front of it.
    empty = simulate(plate.with_({"targets": ()}), rng=21)
    tail = _true(empty, "water") - water
    expected = np.mean(abs(tail / target)[0, 0])
    assert np.mean(abs(left / target)[0, 0]) == pytest.approx(expected, rel=0.1)


def test_the_residual_is_the_tail_of_the_column(plate_text: str) -> None:
    text = plate_text.replace('signal_fluctuation = "5 %"', "")
    text = text.replace('"0.06 deg"', '"0 deg"').replace('"20 mW"', '"2e6 W"')
    text = text.replace('"10 %"', '"10 %"\nsaturation = "1e20 V"')
    cube = simulate(Survey.from_text(text), rng=1)
    found = rejection.open_water(cube, put_back=False)
    left = found["residual_in_phase"].values + 1j * found["residual_quadrature"].values
    true_left = found.amulor.signal.values - _true(cube, "target")
    # The distance comes from the phase, two passes; the polynomial over the scan
    # follows the water to 1e-3 of it, a few per cent of its tail.
    assert_allclose(left, true_left, rtol=0.15)


@pytest.mark.slow
def test_a_tank_wall_ends_the_open_water(plate_text: str) -> None:
    text = plate_text.replace("[water]", '[water]\ncolumn_end = "1.56 m"')
    near, far = (
        rejection.open_water(simulate(Survey.from_text(each), rng=3), put_back=False)
        for each in (text, plate_text)
    )
    size = [
        np.hypot(cube["residual_in_phase"], cube["residual_quadrature"]).mean()
        for cube in (near, far)
    ]
    # 6 cm of water behind the target instead of all of it.
    assert size[0] < 0.3 * size[1]


def test_without_a_survey_there_is_no_residual_estimate(samples: xr.Dataset) -> None:
    bare = samples.copy()
    del bare.attrs["survey"]
    found = rejection.open_water(bare)
    assert "residual_in_phase" not in found
    cubes.check(found, "target_signal")


def test_open_water_needs_shots(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="no open-water shots"):
        rejection.open_water(cubes.without_groups(samples))
    with pytest.raises(CubeError, match="2 open-water shots"):
        rejection.open_water(samples.isel(shot=slice(0, 2)))
    broken = samples.copy(deep=True)
    for name in ("open_water_in_phase", "open_water_quadrature"):
        broken[name][0, 1, 2:] = np.nan
    with pytest.raises(CubeError, match="39 MHz in channel VH"):
        rejection.open_water(broken)


def test_lost_shots_are_left_out(samples: xr.Dataset) -> None:
    broken = samples.copy(deep=True)
    for name in ("open_water_in_phase", "open_water_quadrature"):
        broken[name][0, 0, ::10] = np.nan
    found = rejection.open_water(broken)
    assert np.isfinite(found["in_phase"].values).all()


def test_keeping_the_water_says_so(samples: xr.Dataset) -> None:
    found = rejection.keep_water(samples)
    np.testing.assert_array_equal(found["in_phase"], samples["in_phase"])
    assert (found["quality_flag"].values & QualityFlag.NO_OPEN_WATER).all()
    assert (found["water_in_phase"].values == 0).all()


def test_channels_are_chosen_by_what_water_does_to_them(plate_text: str) -> None:
    circular = plate_text.replace('["VV", "VH"]', '["VV", "VH", "RR", "RL"]')
    cube = simulate(Survey.from_text(circular), rng=1)
    dark = rejection.cross_polarized(cube)
    bright = rejection.co_polarized(cube)
    assert list(dark["polarization"].values) == ["VH", "RR"]
    assert list(bright["polarization"].values) == ["VV", "RL"]
    ratio = abs(_true(cube, "water") / _true(cube, "target"))[0].mean(axis=(1, 2))
    by_channel = dict(zip(cube["polarization"].values, ratio, strict=True))
    assert by_channel["VH"] < by_channel["VV"]
    assert by_channel["RR"] < by_channel["RL"]
    assert (dark["quality_flag"].values & QualityFlag.NO_OPEN_WATER).all()


def test_a_channel_that_is_not_there_is_named(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="none of which is cross-polarized"):
        rejection.cross_polarized(samples.sel(polarization=["VV"]))
    with pytest.raises(CubeError, match=r"VV\+VH"):
        rejection.polarization(
            samples.sel(polarization=["VV"]), target_ratio=0.2, water_ratio=0.1
        )


# Depolarization ratios (1 - m22) / (1 + m22) of paint and of the milky water.
PAINT, MILK = 0.39 / 1.61, 0.19 / 1.81


def test_unmixing_separates_target_and_water(plate_text: str) -> None:
    text = plate_text.replace('signal_fluctuation = "5 %"', "")
    text = text.replace('"0.06 deg"', '"0 deg"').replace('"20 mW"', '"2e6 W"')
    text = text.replace('"10 %"', '"10 %"\nsaturation = "1e20 V"')
    cube = simulate(Survey.from_text(text), rng=1)
    found = rejection.polarization(cube, target_ratio=PAINT, water_ratio=MILK)
    cubes.check(found, "target_signal")
    assert list(found["polarization"].values) == ["VV"]
    assert_allclose(found.amulor.signal.values, _true(cube, "target")[:, :1], rtol=1e-4)
    assert_allclose(
        found.amulor.water_signal.values, _true(cube, "water")[:, :1], rtol=1e-3
    )
    # Nothing is left in: the column that ends at the target is separated as it is.
    assert not (found["quality_flag"].values & QualityFlag.NO_OPEN_WATER).any()


def test_the_noise_of_unmixing_is_propagated(plate_text: str) -> None:
    text = plate_text.replace('signal_fluctuation = "5 %"', "")
    text = text.replace("columns = 12", "columns = 60").replace("rows = 6", "rows = 60")
    cube = simulate(Survey.from_text(text), rng=9)
    found = rejection.polarization(cube, target_ratio=PAINT, water_ratio=MILK)
    error = found.amulor.signal.values - _true(cube, "target")[:, :1]
    z = error.real / found["in_phase_uncertainty"].values
    # 3600 pixels: five standard errors of a mean square.
    assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / z.size)
    noise = found["in_phase_uncertainty"].values.mean()
    assert noise > 2 * cube["in_phase_uncertainty"].values[0, 0].mean()


@pytest.mark.slow
@settings(max_examples=30)
@given(st.floats(0.01, 0.05), st.floats(0.005, 0.02))
def test_wrong_ratios_show_in_the_shared_uncertainty(dt: float, dw: float) -> None:
    cube = _two_channels()
    still: dict[str, float] = {"water_fluctuation": 0.0}
    exact = rejection.polarization(cube, target_ratio=PAINT, water_ratio=MILK, **still)
    unsure = rejection.polarization(
        cube,
        target_ratio=PAINT,
        water_ratio=MILK,
        **still,
        target_ratio_uncertainty=dt,
        water_ratio_uncertainty=dw,
    )
    # Derivative by difference: what the error of a ratio does to the signal.
    step = 1e-6
    by_target = rejection.polarization(
        cube, target_ratio=PAINT + step, water_ratio=MILK, **still
    )
    by_water = rejection.polarization(
        cube, target_ratio=PAINT, water_ratio=MILK + step, **still
    )
    base = exact["in_phase"].values
    expected = np.hypot(
        (by_target["in_phase"].values - base) / step * dt,
        (by_water["in_phase"].values - base) / step * dw,
    )
    assert_allclose(unsure["common_in_phase_uncertainty"], expected, rtol=1e-3)


def _two_channels() -> xr.Dataset:
    target, water = 1.0 * np.exp(2.5j), 0.3 * np.exp(1.0j)
    signal = np.array([target + water, PAINT * target + MILK * water])
    signal = signal.reshape(1, 2, 1, 1)
    return cubes.build(
        "samples",
        {
            "in_phase": signal.real,
            "quadrature": signal.imag,
            "in_phase_uncertainty": np.full(signal.shape, 1e-3),
            "quadrature_uncertainty": np.full(signal.shape, 1e-3),
        },
        {
            "modulation_frequency": [39e6],
            "polarization": ["VV", "VH"],
            "azimuth": np.zeros((1, 1)),
            "elevation": np.zeros((1, 1)),
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("samples", title="two channels", source="by hand"),
    )


@pytest.mark.parametrize(
    ("target_ratio", "water_ratio", "words"),
    [(0.2, 0.2, "cannot tell them apart"), (1.2, 0.1, "between 0 and 1")],
)
def test_ratios_that_cannot_work_are_refused(
    samples: xr.Dataset, target_ratio: float, water_ratio: float, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        rejection.polarization(
            samples, target_ratio=target_ratio, water_ratio=water_ratio
        )


def test_a_strong_residual_is_flagged_and_a_weak_one_is_not(plate_text: str) -> None:
    # Quiet water: the noise is small, so the few millimetres of the tail stand out.
    quiet = plate_text.replace('signal_fluctuation = "5 %"', "")
    noisy = plate_text.replace('"5 %"', '"20 %"')
    flags = [
        rejection.open_water(simulate(Survey.from_text(text), rng=1), put_back=False)[
            "quality_flag"
        ].values[0, 0]
        for text in (quiet, noisy)
    ]
    assert (flags[0] & QualityFlag.WATER_RESIDUAL).all()
    assert not (flags[1] & QualityFlag.WATER_RESIDUAL).any()


def test_input_is_not_changed(samples: xr.Dataset) -> None:
    before = samples.copy(deep=True)
    rejection.open_water(samples)
    rejection.polarization(samples, target_ratio=PAINT, water_ratio=MILK)
    xr.testing.assert_identical(samples, before)


def test_channels_are_sorted_by_what_an_ideal_mirror_does() -> None:
    from amulor.optics.polarization import mueller
    from amulor.rejection import channels as names

    mirror = mueller.ideal_backscatter()
    for pair in names.CROSS_POLARIZED:
        assert mueller.detected_fraction(mirror, pair=pair) == pytest.approx(0)
    for pair in names.CO_POLARIZED:
        assert mueller.detected_fraction(mirror, pair=pair) == pytest.approx(1)


def _scores(text: str, seeds: int, step, **options) -> np.ndarray:
    """Return (range - bias - truth) / uncertainty of all usable pixels."""
    from amulor import imaging

    survey = Survey.from_text(text)
    found = []
    for seed in range(seeds):
        target = step(simulate(survey, rng=seed))
        image = imaging.range_image(target, **options)
        error = image["slant_range"] - image["truth_slant_range"]
        error = error - image.get("slant_range_bias", 0.0)
        found.append((error / image["slant_range_uncertainty"]).values)
    return np.array(found)


@pytest.mark.study
def test_the_fluctuation_is_that_of_the_water_before_the_target(
    plate_text: str,
) -> None:
    # Half of the open water's signal stands behind a target 0.8 m away.
    text = plate_text.replace('"1.5 m"', '"0.8 m"').replace(
        "repeats = 8", "repeats = 60"
    )
    text = text.replace('"0.255 1/m"', '"0.05 1/m"').replace('"5 %"', '"20 %"')
    z = _scores(text, 12, rejection.open_water, polarization="VV")
    # 864 pixels: 2.4 % by chance; a wrong direction gave 1.4.
    assert 0.85 < np.nanstd(z) < 1.15


@pytest.mark.study
def test_the_uncertainty_of_unmixing_holds_in_water_that_fluctuates(
    plate_text: str,
) -> None:
    text = plate_text.replace("repeats = 8", "repeats = 60")
    z = _scores(
        text,
        12,
        lambda c: rejection.polarization(c, target_ratio=PAINT, water_ratio=MILK),
    )
    # Without the fluctuation it was 4.6.
    assert 0.85 < np.nanstd(z) < 1.15


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frequencies", "interval"),
    [
        ('["138 MHz"]', (1.2, 1.8)),
        ('["100 MHz", "110 MHz", "123 MHz"]', None),
    ],
)
def test_the_residual_is_that_of_the_right_ambiguity_interval(
    plate_text: str, frequencies: str, interval: tuple[float, float] | None
) -> None:
    text = plate_text.replace('["39 MHz"]', frequencies)
    text = text.replace("repeats = 8", "repeats = 40")
    z = _scores(
        text,
        8,
        lambda c: rejection.open_water(c, interval=interval),
        polarization="VH",
        interval=interval,
    )
    assert np.isfinite(z).mean() > 0.95
    assert 0.85 < np.nanstd(z) < 1.15
    assert abs(np.nanmean(z)) < 0.6


def test_where_the_distance_is_open_the_residual_is_unknown_and_flagged(
    plate_text: str,
) -> None:
    text = plate_text.replace('["39 MHz"]', '["138 MHz"]')
    cube = simulate(Survey.from_text(text), rng=1)
    found = rejection.open_water(cube, interval=(0.5, 2.5))
    assert np.isnan(found["residual_in_phase"].values).all()
    assert (found["quality_flag"].values & QualityFlag.WATER_RESIDUAL).all()


def test_a_scan_beyond_the_shots_is_refused(samples: xr.Dataset) -> None:
    narrow = samples.isel(shot=slice(0, 40))
    with pytest.raises(CubeError, match="beyond the open-water shots in elevation"):
        rejection.open_water(narrow)


@pytest.mark.slow
def test_a_receiver_that_turns_with_the_beam_needs_no_spread_of_shots(
    plate_text: str,
) -> None:
    text = plate_text.replace("[scan]", '[scan]\nmoves = "both"')
    cube = simulate(Survey.from_text(text), rng=1)
    few = cube.isel(shot=slice(0, 40))
    # These shots leave out a third of the elevations, where the water is the same.
    elevation = few["open_water_elevation"].values
    assert np.ptp(elevation) < 0.7 * np.ptp(cube["elevation"].values)
    found, whole = rejection.open_water(few), rejection.open_water(cube)
    assert not (found["quality_flag"].values & cubes.UNUSABLE).any()
    # Both references are known to a few per cent of the water, 5 % of fluctuation
    # over the square root of 40 shots, and the targets are the same samples.
    water = abs(whole.amulor.water_signal.values)
    change = abs((found.amulor.signal - whole.amulor.signal).values)
    assert np.max(change / water) < 5 * 0.05 * np.sqrt(2 / 40) * 2


@pytest.mark.slow
def test_water_without_backscatter_leaves_nothing_in(plate_text: str) -> None:
    text = plate_text.replace('"0.001 1/sr"', '"0 1/sr"')
    found = rejection.open_water(
        simulate(Survey.from_text(text), rng=1), put_back=False
    )
    assert not (found["quality_flag"].values & cubes.UNUSABLE).any()


def test_a_missing_channel_does_not_spoil_the_other(samples: xr.Dataset) -> None:
    broken = samples.copy(deep=True)
    broken["in_phase"][0, 0, 2, 3] = np.nan
    found, whole = rejection.open_water(broken), rejection.open_water(samples)
    assert found["quality_flag"][0, 0, 2, 3] == QualityFlag.MISSING
    assert_allclose(
        found["residual_in_phase"][0, 1, 2, 3],
        whole["residual_in_phase"][0, 1, 2, 3],
        rtol=0.05,
    )


def test_unmixing_keeps_the_saturation_of_either_channel(samples: xr.Dataset) -> None:
    cube = samples.copy(deep=True)
    cube["saturated"][0, 1, 1, 1] = 1
    found = rejection.polarization(cube, target_ratio=PAINT, water_ratio=MILK)
    assert found["quality_flag"][0, 0, 1, 1].item() & QualityFlag.SATURATED


def test_unmixing_without_shots_asks_how_the_water_fluctuates(
    samples: xr.Dataset,
) -> None:
    bare = cubes.without_groups(samples)
    with pytest.raises(CubeError, match="--water-fluctuation"):
        rejection.polarization(bare, target_ratio=PAINT, water_ratio=MILK)
    rejection.polarization(
        bare, target_ratio=PAINT, water_ratio=MILK, water_fluctuation=0.05
    )
