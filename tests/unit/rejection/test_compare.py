"""All methods side by side, and the one that is recommended."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging.instrument_tests import instrument_tests
from amulor.simulation import simulate
from amulor.studies.trust.scenes.catalogue import BY_NAME
from amulor.survey import Survey

Make = Callable[..., xr.Dataset]
PAIR = {"VV": (1.0, 1.0), "VH": (0.242, 0.105)}


@pytest.fixture(scope="module")
def cube(plate_text: str) -> xr.Dataset:
    text = plate_text.replace('["39 MHz"]', '["10 MHz", "39 MHz", "61 MHz"]')
    return simulate(Survey.from_text(text), rng=31)


@pytest.fixture(scope="module")
def found(cube: xr.Dataset) -> rejection.Comparison:
    return rejection.compare(cube, interval=(0.5, 3.0))


def test_every_method_has_a_row(found: rejection.Comparison) -> None:
    methods = {row.method for row in found.rows}
    of_pixels = {
        "cross-polarized",
        "open-water",
        "background",
        "frequency",
        "polarization",
        "combined",
        "polarization-difference",
        "stokes",
        "joint",
        "range-profile",
    }
    assert of_pixels < methods
    (smooth,) = methods - of_pixels
    base = smooth.removeprefix("smooth-surface of ")
    assert base in of_pixels
    assert sum(row.recommended for row in found.rows) == 1
    best = next(row for row in found.rows if row.recommended)
    assert (best.method, best.polarization) == (found.method, found.polarization)
    assert found.reason.startswith(f"{best.method} {best.polarization}: error")


@pytest.mark.slow
def test_the_stated_errors_are_the_errors(
    cube: xr.Dataset, found: rejection.Comparison
) -> None:
    for row in found.rows:
        if row.method not in ("open-water", "combined"):
            continue
        run = {
            "open-water": lambda c: rejection.open_water(
                c, interval=(0.5, 3.0), column_uncertainty=0.2
            ),
            "combined": lambda c: rejection.combined(c, interval=(0.5, 3.0)),
        }[row.method]
        image = imaging.range_image(
            run(cube), polarization=row.polarization, interval=(0.5, 3.0)
        )
        error = (image["slant_range"] - image["truth_slant_range"]).values
        # 72 pixels that share a reference.
        assert np.sqrt(np.mean(error**2)) == pytest.approx(row.error, rel=0.4), row


def test_the_frequency_alone_carries_its_bias(found: rejection.Comparison) -> None:
    row = next(row for row in found.rows if row.method == "frequency")
    others = [row for row in found.rows if row.method == "open-water"]
    assert row.bias > 10 * max(other.noise for other in others)
    assert row.flagged == 1.0


def test_auto_does_what_is_recommended(
    cube: xr.Dataset, found: rejection.Comparison
) -> None:
    target = rejection.auto(cube, interval=(0.5, 3.0), comparison=found)
    cubes.check(target, "target_signal")
    assert target.attrs["rejection_method"] == found.method
    assert list(target["polarization"].values) == [found.polarization]


@pytest.mark.study
def test_the_recommendation_does_not_hang_on_the_words_of_a_note(
    plate_text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # One frequency, 2.8 m; of 0.5 m to 6 m it leaves two places open.
    cube = simulate(Survey.from_text(plate_text), rng=21)
    found = rejection.compare(cube, interval=(0.5, 6.0))
    row = next(row for row in found.rows if row.method == "frequency")
    assert row.caution is rejection.Caution.AMBIGUOUS
    assert "repeats after 2.79 m" in row.note
    clear = rejection.compare(cube, interval=(0.5, 3.0))
    row = next(row for row in clear.rows if row.method == "frequency")
    assert row.caution is not rejection.Caution.AMBIGUOUS

    class Mute(rejection.Row):
        """A row whose notes say nothing."""

        def __init__(self, **fields: Any) -> None:
            super().__init__(**{**fields, "note": ""})

    # The module, which the function of the same name stands before.
    monkeypatch.setattr(sys.modules["amulor.rejection.compare"], "Row", Mute)
    mute = rejection.compare(cube, interval=(0.5, 6.0))
    assert (mute.method, mute.polarization) == (found.method, found.polarization)
    assert mute.reason == found.reason


def test_methods_that_cannot_run_say_why(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels={"VV": (1.0, 1.0)})
    rows = {row.method: row for row in rejection.compare(cube).rows}
    assert "unmixing needs one of the pairs" in rows["polarization"].note
    assert "one modulation frequency" in rows["joint"].note
    assert rows["smooth-surface of open-water"].recommended
    assert rows["joint"].usable == 0
    assert rows["joint"].caution is rejection.Caution.NOT_RUN
    assert rows["open-water"].caution is rejection.Caution.NONE


def test_without_a_reference_the_crossed_channel_is_left(by_hand: Make) -> None:
    cube = cubes.without_groups(by_hand(frequency=[39e6], channels=PAIR))
    found = rejection.compare(cube)
    assert (found.method, found.polarization) == ("cross-polarized", "VH")
    best = next(row for row in found.rows if row.recommended)
    assert np.isinf(best.bias)
    assert best.caution is rejection.Caution.BIAS_UNKNOWN
    assert "record open-water shots" in found.reason


def test_of_equal_methods_the_simpler_one_wins(by_hand: Make) -> None:
    # The crossed channel adds 0.242^2 = 6 % of weight: 3 % less error.
    cube = by_hand(frequency=[39e6], channels=PAIR, shots=400, shape=(20, 20))
    found = rejection.compare(cube, interval=(0.5, 2.5))
    base = "smooth-surface of open-water"
    assert (found.method, found.polarization) == (base, "VV")
    errors = {row.method: row.error for row in found.rows if row.polarization == "VV"}
    assert errors["combined"] < errors["open-water"]


def test_a_cube_without_any_target_is_refused(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels={"VV": (1.0, 1.0)}, target=0.0)
    with pytest.raises(CubeError, match="no method has a pixel"):
        rejection.compare(cube)


def test_one_channel_at_one_frequency_is_refused_in_a_few_lines(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels={"VV": (1.0, 1.0)})
    with pytest.raises(CubeError) as refused:
        rejection.compare(cubes.without_groups(cube))
    lines = str(refused.value).split("\n")
    assert len(lines) == 4
    assert max(map(len, lines)) < 120
    assert "channel VV at 39 MHz, no open-water shots" in lines[1]
    assert "a cross-polarized channel (VH)" in lines[2]


def _where(target: xr.Dataset, rest: xr.Dataset, there: np.ndarray) -> xr.Dataset:
    cube = target.copy(deep=True)
    for name in ("in_phase", "quadrature"):
        cube[name].values[..., ~there] = rest[name].values[..., ~there]
    return cube


def test_a_few_pixels_are_a_target_if_they_are_neighbors(by_hand: Make) -> None:
    shape = (12, 16)
    scan = {"frequency": [39e6], "channels": {"VV": (1.0, 1.0)}, "shape": shape}
    bright, dark = by_hand(1, **scan), by_hand(2, **scan, target=0.0)
    lone = np.zeros(shape, dtype=bool)
    lone[2, 3] = lone[8, 12] = True
    with pytest.raises(CubeError, match="none of them has a neighbor"):
        rejection.compare(_where(bright, dark, lone))
    rung = np.zeros(shape, dtype=bool)
    rung[4, 5:9] = True
    found = rejection.compare(_where(bright, dark, rung))
    best = next(row for row in found.rows if row.recommended)
    assert best.trusted == pytest.approx(4 / 192)
    assert "hardly any pixel is trusted" in found.reason


def test_a_method_that_trusts_lone_pixels_only_is_not_recommended(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    shape = (12, 16)
    scan = {"frequency": [39e6], "channels": PAIR, "shape": shape}
    bright, dark = by_hand(1, **scan), by_hand(2, **scan, target=0.0)
    rung = np.zeros(shape, dtype=bool)
    rung[4, 5:9] = True
    cube = _where(bright, dark, rung)
    module = sys.modules["amulor.rejection.compare"]
    unmixed = rejection.open_water(cube).sel(polarization=["VV"])
    flag = unmixed["quality_flag"].copy(deep=True)
    flag.values[..., ~np.isin(np.arange(192), [3, 100]).reshape(shape)] = 4
    flag.values[..., 0, 3] = flag.values[..., 6, 4] = 0
    seen = unmixed.assign(quality_flag=flag)
    table, broken = module.compared_methods()
    replaced = [
        replace(one, function=lambda cube: seen) if one.name == "polarization" else one
        for one in table
    ]
    monkeypatch.setattr(module, "compared_methods", lambda: ([*replaced], broken))
    found = rejection.compare(cube)
    row = next(row for row in found.rows if row.method == "polarization")
    assert row.caution is rejection.Caution.LONE_PIXELS
    assert row.trusted == 0
    assert found.method in ("open-water", "combined")


@pytest.mark.slow
def test_no_method_reads_the_truth(cube: xr.Dataset) -> None:
    lying = cube.copy()
    for name in lying.data_vars:
        if str(name).startswith("truth_"):
            lying[name] = lying[name] * 0 + 1.0
    methods: tuple[Callable[[xr.Dataset], xr.Dataset], ...] = (
        lambda c: rejection.open_water(c, column_uncertainty=0.2),
        rejection.polarization,
        rejection.combined,
        rejection.frequency,
    )
    for method in methods:
        honest, other = method(cube), method(lying)
        for name in ("in_phase", "quadrature_uncertainty", "quality_flag"):
            np.testing.assert_array_equal(honest[name], other[name])


@pytest.mark.slow
def test_a_spike_in_one_frequency_does_not_cost_its_pixel() -> None:
    # 58 % of these pixels have one; the image leaves the sample out and trusts them.
    case = BY_NAME["spikes"].make(16, 1)
    comparison = rejection.compare(case.samples, interval=case.interval)
    for row in comparison.rows:
        if row.method in ("open-water", "combined", "joint"):
            assert row.trusted > 0.98
            assert row.error < 1e-4
    assert comparison.method in ("combined", "joint")


def test_a_few_flagged_pixels_do_not_make_the_bias_unknown(cube: xr.Dataset) -> None:
    # Three of 3,924 did: `auto` took 0.55 mm where combination has 0.36.
    table = importlib.import_module("amulor.rejection.compare")
    method = rejection.load("open-water")
    target = rejection.open_water(cube, interval=(0.5, 3.0)).sel(polarization=["VV"])
    flag = target["quality_flag"].values
    row, column = np.argwhere((flag == 0).all(axis=(0, 1)))[0]
    target["residual_in_phase"].values[:, :, row, column] = np.nan
    # Where the pixel does not say so, nothing is known of all.
    unknown = table._row(method, target, (0.5, 3.0)).row
    assert np.isinf(unknown.bias)
    flag[:, :, row, column] |= QualityFlag.WATER_RESIDUAL
    found = table._row(method, target, (0.5, 3.0)).row
    assert found.bias < 1e-4
    assert found.caution.value == "none"
    assert found.trusted < unknown.trusted


def _row(method: str, noise: float) -> rejection.Row:
    return rejection.Row(
        method=method,
        polarization="VV",
        bias=0.0,
        noise=noise,
        usable=1.0,
        flagged=0.0,
        trusted=1.0,
    )


def test_pixels_of_open_water_are_no_doubt_about_the_shots(cube: xr.Dataset) -> None:
    doubted = sys.modules["amulor.rejection.compare"]._shots_are_doubted
    object_in_water = replace(_row("joint", 1e-3), usable=0.25, trusted=0.24)
    assert not doubted(cube, [object_in_water])
    assert doubted(cube, [replace(object_in_water, trusted=0.1)])
    assert not doubted(cubes.without_groups(cube), [object_in_water])


@pytest.mark.parametrize(
    ("noise", "expected"), [(1e-3, 10e-3), (5e-3, 0.0)], ids=["apart", "in errors"]
)
def test_ranges_of_methods_are_compared_within_their_errors(
    by_hand: Make, noise: float, expected: float
) -> None:
    module = importlib.import_module("amulor.rejection.compare")
    cube = by_hand(frequency=[20e6, 80e6], channels={"VV": (1.0, 1.0)})
    # The phases of 20 and 80 MHz repeat after a path of 299792458 / 20e6 m, those of
    # 80 MHz alone after a quarter of it.
    repeat = 299792458.0 / 20e6
    path = np.full((6, 8), 4.0)
    apart = path + 2 * 1.38 * 10e-3 + repeat
    module = importlib.import_module("amulor.rejection.compare")
    trials = [
        module._Trial(row=_row("first", noise), path=path, repeat=repeat),
        module._Trial(row=_row("second", noise), path=apart, repeat=repeat),
        module._Trial(row=_row("near", noise), path=path + 1e-4, repeat=repeat),
        module._Trial(
            row=_row("one frequency", noise), path=path - repeat / 4, repeat=repeat / 4
        ),
    ]
    other, difference = module._disagreement(trials, 0, cube)
    assert difference == pytest.approx(expected, rel=1e-6)
    assert (other is None) == (expected == 0)
    if other is not None:
        assert other.method == "second"


def test_a_disagreement_of_methods_counts_as_an_error(by_hand: Make) -> None:
    cube = by_hand(frequency=[20e6, 80e6], channels={"VV": (1.0, 1.0)})
    comparison = rejection.Comparison(
        rows=(_row("open-water", 1e-3),),
        method="open-water",
        polarization="VV",
        reason="smallest error",
        disagreement=7e-3,
    )
    target = rejection.auto(cube, comparison=comparison)
    image = imaging.range_image(target, interval=(0.5, 3.0))
    assert image["slant_range_uncertainty_instrument"].values == pytest.approx(7e-3)
    assert np.all(image["slant_range_common_uncertainty"].values > 7e-3)


@pytest.mark.slow
def test_light_of_corners_counts_as_in_the_range_image() -> None:
    case = BY_NAME["corner"].make(2, 1)
    module = importlib.import_module("amulor.rejection.compare")
    rows = {}
    for name in ("open-water", "polarization"):
        method = rejection.load(name)
        target = method(case.samples, interval=case.interval).isel(polarization=[0])
        absent = target.assign_attrs(corner_light="absent")
        rows[name] = module._row(method, target, case.interval).row
        without = module._row(method, absent, case.interval).row
        image = imaging.range_image(target, interval=case.interval)
        expected = np.median(image["slant_range_uncertainty_corners"].values)
        corners = np.sqrt(rows[name].noise ** 2 - without.noise**2)
        # Flagged pixels do not count.
        if rows[name].flagged == 0:
            assert corners == pytest.approx(expected, rel=0.1)
        assert without.flagged == 0
    # Unpolarized light passes for water, which `polarization` separates by its ratio.
    assert rows["polarization"].flagged > 0.5
    assert rows["open-water"].flagged == 0


@pytest.mark.slow
def test_light_of_corners_is_named_where_no_water_explains_the_scan() -> None:
    case = BY_NAME["corner"].make(4, 1)
    module = importlib.import_module("amulor.rejection.compare")
    target = rejection.open_water(case.samples, interval=case.interval)
    target = target.isel(polarization=[0])
    row = module._row(rejection.load("open-water"), target, case.interval).row
    assert row.caution is rejection.Caution.INSTRUMENT
    assert "so corners reflect light twice" in row.note
    image = imaging.range_image(target, interval=case.interval)
    causes = {test.name: test.cause for test in instrument_tests(image)}
    assert {"channels", "frequencies"} <= set(causes)
    for cause in causes.values():
        assert cause.startswith("light that corners reflect twice, or ")
    # The same scan without such light blames the instrument alone.
    absent = target.assign_attrs(corner_light="absent")
    row = module._row(rejection.load("open-water"), absent, case.interval).row
    assert "corners" not in row.note
    image = imaging.range_image(absent, interval=case.interval)
    assert not any("corners" in t.cause for t in instrument_tests(image))


@pytest.mark.parametrize(
    ("difference", "error", "expected"),
    [(0.05, 0.6, 1), (0.25, 0.6, None), (0.05, 1.1, None)],
)
def test_a_method_that_agrees_with_the_first_and_has_less_noise_is_taken(
    by_hand: Make, difference: float, error: float, expected: int | None
) -> None:
    # Noise of 0.23 and 0.1 mm, common errors of 0.5 mm and more. With a difference of
    # 0.05 mm the second has 0.11 mm, with 0.25 mm it has 0.27 mm.
    cube = by_hand(frequency=[39e6], channels={"VV": (1.0, 1.0)})
    index = float(cube["geometry"].attrs["group_index"])
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 1e-4, (2, 30, 30))
    second = 2.0 + noise[1] + 1e-3 * difference
    # The second uses the samples of the first, and more.
    first = 2.0 + noise[1] + 2.07 * noise[0]
    module = importlib.import_module("amulor.rejection.compare")
    trials = [
        module._Trial(
            row=rejection.Row(
                method=name, polarization="VV", bias=0.0, noise=1e-3 * total,
                usable=1.0, flagged=0.0, trusted=1.0,
            ),
            path=2 * index * path,
            own_noise=own,
            repeat=7.69,
        )
        for name, total, path, own in (
            ("first", 0.5, first, 2.3e-4), ("second", error, second, 1e-4),
        )
    ]  # fmt: skip
    steadier = module._steadier(trials, 0, cube)
    assert (None if steadier is None else steadier.index) == expected
    if steadier is not None:
        assert steadier.difference == pytest.approx(1e-3 * difference, abs=3e-5)


def test_paths_of_two_methods_differ_up_to_whole_intervals() -> None:
    module = importlib.import_module("amulor.rejection.compare")
    noise = 1e-3
    first = module._Trial(
        row=_row("first", noise),
        path=np.array([1.0, 2.0, np.nan, 4.0, 5.0]),
        repeat=1.0,
    )
    other = module._Trial(
        row=_row("other", noise),
        path=np.array([0.7, 0.8, 1.0, 4.7, np.nan]),
        repeat=4.0,
    )
    # The shorter interval counts, 1 m: 0.3, 1.2 and -0.7 are 0.3, 0.2 and 0.3.
    found = module._differences(first, other)
    assert found == pytest.approx([0.3, 0.2, 0.3])
    none = module._Trial(row=_row("none", noise), path=None)
    for pair in ((none, other), (first, none)):
        assert module._differences(*pair).size == 0


PLATE: dict[str, Any] = {
    "frequency": [10e6, 35e6, 80e6], "channels": {"VV": (1.0, 1.0)}, "shape": (14, 16),
}  # fmt: skip


def test_neighbors_of_a_smooth_surface_are_used_and_the_reason_says_so(
    by_hand: Make,
) -> None:
    cube = by_hand(**PLATE)
    found = rejection.compare(cube, interval=(0.5, 2.5))
    assert found.method.startswith("smooth-surface of ")
    assert "neighbors of a smooth surface reduce the noise, and smooth" in found.reason
    assert "(noise of a pixel " in found.reason
    base = rejection.load(found.method.removeprefix("smooth-surface of "))
    plain = base(cube, interval=(0.5, 2.5))
    target = rejection.auto(cube, interval=(0.5, 2.5))
    total, before = (
        part["in_phase_uncertainty"] ** 2 + part["quadrature_uncertainty"] ** 2
        for part in (target, plain)
    )
    np.testing.assert_allclose(total, before, rtol=1e-9)
    assert target.attrs["rejection_method"] == found.method
    # A comparison that was made before gives the same result.
    again = rejection.auto(cube, interval=(0.5, 2.5), comparison=found)
    for name in ("in_phase", "quadrature_uncertainty", "smoothing_gain"):
        np.testing.assert_array_equal(target[name].values, again[name].values)


def test_a_rough_surface_is_not_smoothed(by_hand: Make) -> None:
    # Bumps of 20 mm, some 20 times the noise.
    bumps = np.random.default_rng(3).normal(0, 0.02, PLATE["shape"])
    cube = by_hand(**PLATE, distance=1.5)
    wave = 4 * np.pi * np.array(PLATE["frequency"]) * 1.38 / 299792458.0
    echo = np.exp(1j * wave[:, None, None, None] * (1.5 + bumps))
    echo -= np.exp(1j * wave[:, None, None, None] * 1.5)
    cube["in_phase"] = cube["in_phase"] + echo.real
    cube["quadrature"] = cube["quadrature"] + echo.imag
    found = rejection.compare(cube, interval=(0.5, 2.5))
    assert not found.method.startswith("smooth-surface")
    assert any(row.method.startswith("smooth-surface of") for row in found.rows)


def test_methods_are_weighed_only_where_the_data_suit_them(by_hand: Make) -> None:
    rows = {row.method: row for row in rejection.compare(by_hand(**PLATE)).rows}
    assert "a bandwidth of 70 MHz resolves 1.6 m" in rows["range-profile"].note
    assert "one launched polarization does not test" in rows["stokes"].note
    assert "the open-water shots show the water" in rows["polarization-difference"].note
    small = by_hand(**{**PLATE, "shape": (4, 9)})
    rows = {row.method: row for row in rejection.compare(small).rows}
    note = rows["smooth-surface"].note
    assert "the scan has 4 x 9 pixels, and a window of neighbors 5 x 5" in note
    # Signal of two launched polarizations, and a sweep.
    stokes, profile = (rejection.load(n).unsuited for n in ("stokes", "range-profile"))
    assert stokes is not None
    assert profile is not None
    channels = dict.fromkeys(("VV", "VH", "RR", "RL"), (1.0, 1.0))
    assert stokes(by_hand(frequency=[39e6], channels=channels), None) == ""
    sweep = [float(f) for f in np.arange(100e6, 1e9 + 1, 50e6)]
    cube = by_hand(frequency=sweep, channels={"VV": (1.0, 1.0)}, shape=(1, 2))
    assert profile(cube, (0.5, 2.4)) == ""
    assert profile(cube, None) == ""
    one = by_hand(frequency=[39e6], channels={"VV": (1.0, 1.0)}, shape=(1, 2))
    assert "one modulation frequency has no range profile" in profile(one, None)


def test_errors_of_few_frequencies_contain_the_late_light_of_the_image() -> None:
    module = importlib.import_module("amulor.rejection.expected_errors")
    for count, expected in ((2, np.hypot(3e-4, 5e-3)), (4, 3e-4)):
        maps = {
            "joint_slant_range": 2.0,
            "joint_slant_range_uncertainty": np.hypot(3e-4, 5e-3),
            "joint_slant_range_common_uncertainty": 5e-3,
        }
        target = xr.Dataset(
            {
                name: (("row", "column"), np.full((2, 2), value))
                for name, value in maps.items()
            },
            coords={"modulation_frequency": np.arange(1, count + 1) * 1e7},
            attrs={
                "joint_instrument_uncertainty_m": 5e-3,
                # Half of 0.25 * 0.01 rad2/m * (2 m)^2.
                "joint_late_echo_uncertainty": 0.5,
                "joint_late_echo_spread_rad2_per_m": 0.01,
            },
        )
        errors = module._errors_of_joint(target, np.ones((2, 2), dtype=bool))
        np.testing.assert_allclose(errors.noise, expected)
