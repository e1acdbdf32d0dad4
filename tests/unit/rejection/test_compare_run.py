"""Course of a comparison: which methods run, and how their results are combined."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal

from amulor import rejection
from amulor.cube import QualityFlag, WaterResidualCause, tiles
from amulor.errors import CubeError
from amulor.rejection import Caution, Row
from amulor.rejection.methods import Method, Needs

Make = Callable[..., xr.Dataset]
#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.compare")


@pytest.fixture(scope="module")
def cube(by_hand: Make) -> xr.Dataset:
    return by_hand(
        frequency=[20e6, 50e6],
        channels={"VV": (1.0, 1.0), "VH": (0.3, 0.1)},
        shape=(4, 5),
    )


@pytest.fixture(scope="module")
def bare(cube: xr.Dataset) -> xr.Dataset:
    return cube.drop_vars([name for name in cube.variables if "open_water" in name])


@pytest.fixture(scope="module")
def target(cube: xr.Dataset) -> xr.Dataset:
    return rejection.keep_water(cube)


def method_of(name: str, function: Any, **declared: Any) -> Method:
    return Method(name=name, function=function, **declared)


def returning(target: xr.Dataset) -> Callable[..., xr.Dataset]:
    def run(cube: xr.Dataset, *, interval: Any = None) -> xr.Dataset:
        return target

    return run


def raising(error: Exception) -> Callable[..., xr.Dataset]:
    def run(cube: xr.Dataset, *, interval: Any = None) -> xr.Dataset:
        raise error

    return run


def row(method: str, **changed: Any) -> Row:
    values: dict[str, Any] = {
        "method": method, "polarization": "VV", "bias": 3e-3, "noise": 4e-3,
        "usable": 1.0, "flagged": 0.0, "trusted": 1.0,
    }  # fmt: skip
    return Row(**values | changed)


def test_a_method_that_does_not_suit_the_scan_has_a_row_with_the_reason(
    cube: xr.Dataset, bare: xr.Dataset, target: xr.Dataset
) -> None:
    run = returning(target)
    none_needed = method_of("dry", run, needs=Needs(open_water=False))
    (trial,) = module._rows(none_needed, cube, None)
    note = "not needed: there are open-water shots, so no water stays in"
    assert trial.row.note == note
    assert trial.row.method == "dry"
    assert (trial.row.polarization, trial.row.caution) == ("", Caution.NOT_RUN)
    shares = trial.row.usable, trial.row.flagged, trial.row.trusted
    assert shares == (0.0, 1.0, 0.0)
    assert np.isnan([trial.row.bias, trial.row.noise]).all()
    assert trial.path is None
    assert trial.target is None
    # Without the shots it runs, and so does one that takes either.
    assert len(module._rows(none_needed, bare, None)) == 2
    either = method_of("either", run, needs=Needs(open_water=True))
    assert len(module._rows(either, cube, None)) == 2
    asked = []

    def unsuited(samples: xr.Dataset, interval: Any) -> str:
        asked.append(interval)
        return "too small" if interval == (1.0, 2.0) else ""

    picky = method_of("picky", run, unsuited=unsuited)
    (trial,) = module._rows(picky, cube, (1.0, 2.0))
    assert (trial.row.note, trial.row.caution) == ("too small", Caution.NOT_RUN)
    assert len(module._rows(picky, cube, (1.0, 3.0))) == 2
    assert asked == [(1.0, 2.0), (1.0, 3.0)]
    for error in (CubeError("no light"), ValueError("no light")):
        (trial,) = module._rows(method_of("dark", raising(error)), cube, None)
        assert trial.row.note == "no light"
    with pytest.raises(KeyError):
        module._rows(method_of("broken", raising(KeyError("x"))), cube, None)


def test_each_channel_of_a_small_scan_keeps_its_target(
    cube: xr.Dataset, target: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    trials = module._rows(method_of("kept", returning(target)), cube, None)
    assert [trial.row.polarization for trial in trials] == ["VV", "VH"]
    assert all(trial.target is target for trial in trials)
    for most, kept in ((20, True), (19, False)):
        monkeypatch.setattr(tiles, "SAMPLE", most)
        trials = module._rows(method_of("kept", returning(target)), cube, None)
        assert all((trial.target is target) == kept for trial in trials)


def compared(
    monkeypatch: pytest.MonkeyPatch,
    cube: xr.Dataset,
    rows: dict[str, list[Row]],
    broken: dict[str, CubeError] | None = None,
    **declared: dict[str, Any],
) -> Any:
    """Run a comparison whose methods have given rows; return it and the names tried."""
    tried = []

    def outcomes(method: Method, samples: xr.Dataset, interval: Any) -> list[Any]:
        tried.append(method.name)
        return [module._Trial(row=one) for one in rows[method.name]]

    methods = [
        method_of(name, returning(cube), **declared.get(name, {}))
        for name in rows
        if "without" not in name
    ]
    monkeypatch.setattr(module, "compared_methods", lambda: (methods, broken or {}))
    monkeypatch.setattr(module, "_rows", outcomes)
    return module._compared(cube, None)[0], tried


def test_a_broken_method_has_a_row_before_the_others(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {"a": [row("a", noise=1e-2)], "b": [row("b"), row("b", polarization="VH")]}
    found, tried = compared(
        monkeypatch, cube, rows, {"worn": CubeError("cannot be loaded")}
    )
    assert tried == ["a", "b"]
    assert [one.method for one in found.rows] == ["worn", "a", "b", "b"]
    assert found.rows[0].note == "cannot be loaded"
    assert found.rows[0].caution is Caution.NOT_RUN
    assert (found.method, found.polarization) == ("b", "VV")
    assert [one.recommended for one in found.rows] == [False, False, True, False]
    assert found.rows[2].note == found.reason
    assert found.disagreement == 0.0


@pytest.mark.parametrize("trusted", [0.5, 1.0])
def test_a_doubted_method_is_tried_without_the_shots(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch, trusted: float
) -> None:
    rows = {
        "fit": [row("fit", trusted=trusted)],
        "fit without shots": [row("fit without shots")],
    }
    found, tried = compared(monkeypatch, cube, rows, fit={"distrusts_open_water": True})
    assert tried == (["fit", "fit without shots"] if trusted < 0.8 else ["fit"])
    assert found.method == tried[-1]
    # Another method is never tried twice.
    _, tried = compared(monkeypatch, cube, rows)
    assert tried == ["fit"]


def test_an_error_of_the_instrument_is_no_matter_of_the_shots(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {
        "shots": [row("shots", caution=Caution.INSTRUMENT, note="leakage")],
        "bad": [row("bad", caution=Caution.NOT_RUN, note="no pair", trusted=0.0)],
        "pair": [row("pair")],
        "profile": [row("profile", noise=9e-3, trusted=0.5)],
        "profile without shots": [row("profile without shots")],
    }
    needs = {"needs": Needs(open_water=True)}
    found, tried = compared(
        monkeypatch, cube, rows,
        shots=needs, bad=needs,
        pair={"needs": Needs(channel_pair=True)},
        profile={"distrusts_open_water": True},
    )  # fmt: skip
    assert "profile without shots" not in tried
    # It touches all that use shots or channels; a method that did not run stays so.
    cautions = {one.method: one.caution for one in found.rows}
    assert cautions == {
        "shots": Caution.INSTRUMENT,
        "bad": Caution.NOT_RUN,
        "pair": Caution.INSTRUMENT,
        "profile": Caution.NONE,
    }
    notes = {one.method: one.note for one in found.rows}
    assert (notes["shots"], notes["pair"], notes["bad"]) == (
        "leakage", "leakage", "no pair",
    )  # fmt: skip
    assert [one.trusted for one in found.rows] == [0.0, 0.0, 0.0, 0.5]
    assert found.method == "profile"


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            [row("a", caution=Caution.INSTRUMENT, note="leakage")],
            "no method can be trusted: leakage",
        ),
        (
            [row("a", caution=Caution.LONE_PIXELS, trusted=0.0),
             row("a", caution=Caution.NO_PIXEL, trusted=0.0, usable=0.0)],
            "no method sees a target: single pixels pass for one here and there, and "
            "none of them has a neighbor, as in noise; aim at the target, go nearer, "
            "or raise power or dwell",
        ),
        (
            [row("a", caution=Caution.NO_PIXEL, trusted=0.0, usable=0.0)],
            "no method has a pixel that it can use: none shows a target, all is open "
            "water as the shots have it; aim at the target, or raise power or dwell",
        ),
        (
            [row("a", caution=Caution.NOT_RUN, trusted=0.0, usable=0.0, note="dark")],
            "no method has a pixel that it can use\n  a: dark",
        ),
    ],
)  # fmt: skip
def test_a_scan_that_no_method_can_use_is_refused(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch, rows: list[Row], words: str
) -> None:
    with pytest.raises(CubeError) as refusal:
        compared(monkeypatch, cube, {"a": rows}, a={"needs": Needs(open_water=True)})
    assert str(refusal.value) == words


def test_the_remark_of_the_recommended_method_ends_the_reason(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {"a": [row("a")], "b": [row("b", noise=1.0)]}
    plain, _ = compared(monkeypatch, cube, rows, b={"remark": "other"})
    noted, _ = compared(monkeypatch, cube, rows, a={"remark": "on one surface"})
    assert noted.reason == f"{plain.reason}; on one surface"


def test_a_refined_method_starts_from_the_target_of_the_best(
    cube: xr.Dataset, target: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = []

    def refine(before: xr.Dataset) -> xr.Dataset:
        given.append(before)
        return before

    monkeypatch.setattr(module, "load", lambda name: method_of(name, returning(target)))
    smooth = SimpleNamespace(
        unsuited=lambda cube, interval: "too small" if interval else "",
        refine=refine,
        name="smooth",
        of=lambda base: method_of(f"smooth of {base}", returning(target)),
    )
    first = module._Trial(row=row("joint", polarization="VH"), target=target)
    refused = module._refined(smooth, first, cube, (1.0, 2.0))
    assert (refused.row.note, refused.row.method) == ("too small", "smooth")
    assert refused.row.caution is Caution.NOT_RUN
    for trial in (first, module._Trial(row=row("joint", polarization="VH"))):
        found = module._refined(smooth, trial, cube, None)
        assert (found.row.method, found.row.polarization) == ("smooth of joint", "VH")
        assert found.target is target
    assert given == [target, target]


# -- row of a channel ------------------------------------------------------------------


def evaluated(
    monkeypatch: pytest.MonkeyPatch,
    target: xr.Dataset,
    interval: Any = None,
    keeps_one_frequency: bool = False,
    **errors: Any,
) -> Any:
    """Return the trial of a channel of 4 x 5 pixels with given range errors."""

    def errors_of(target: Any, usable: Any, excluded: Any, *, interval: Any) -> Any:
        count = int(usable.sum())
        values: dict[str, Any] = {
            "noise": np.full(count, 2e-3), "own_noise": np.full(count, 1e-3),
            "bias": np.full(count, 3e-3), "agree": np.ones(count, bool),
            "path": np.arange(count) + 1.0, "mixed": np.zeros(count, bool),
            "in_corner": np.zeros(count, bool), "corner_light": False,
        }  # fmt: skip
        return SimpleNamespace(**values | errors)

    monkeypatch.setattr(module, "errors_of", errors_of)
    monkeypatch.setattr(module, "instrument_error", lambda target: 5e-4)
    run = method_of("kept", returning(target), keeps_one_frequency=keeps_one_frequency)
    return module._row(run, target, interval)


@pytest.fixture
def channel(target: xr.Dataset) -> xr.Dataset:
    """Return a channel in which all samples are good."""
    part = target.sel(polarization=["VH"]).copy(deep=True)
    part["quality_flag"].values[:] = 0
    part["water_residual_cause"].values[:] = 0
    return part


def test_a_row_sums_up_the_errors_of_its_pixels(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    bias, noise = np.arange(20) * 1e-3, (np.arange(20) + 5) * 1e-3
    noise[3] = np.nan
    found = evaluated(monkeypatch, channel, bias=bias, noise=noise, own_noise=noise / 2)
    assert (found.row.method, found.row.polarization) == ("kept", "VH")
    assert found.row.bias == pytest.approx(np.sqrt(np.mean(bias**2)))
    assert found.row.noise == pytest.approx(np.nanmedian(noise))
    assert found.own_noise == pytest.approx(np.nanmedian(noise) / 2)
    assert found.row.instrument == 5e-4
    shares = found.row.usable, found.row.flagged, found.row.trusted
    assert shares == (1.0, 0.0, 1.0)
    assert (found.row.caution, found.row.note) == (Caution.NONE, "")
    assert_array_equal(found.path, np.arange(20).reshape(4, 5) + 1.0)
    # 20 and 50 MHz repeat together after the path of 20 MHz.
    assert found.repeat == pytest.approx(299792458.0 / 20e6)


def test_flagged_pixels_do_not_count_where_there_are_others(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel["quality_flag"].values[:, 0, 0] = QualityFlag.WATER_RESIDUAL
    channel["quality_flag"].values[:, 0, 1] = QualityFlag.NO_TARGET
    bias = np.full(15, 1e-3)
    bias[:5] = 1.0
    agree = np.ones(15, bool)
    agree[6] = False
    mixed, corner = np.zeros(15, bool), np.zeros(15, bool)
    mixed[7], corner[8] = True, True
    found = evaluated(
        monkeypatch, channel, bias=bias, agree=agree, mixed=mixed, in_corner=corner,
        **{name: np.full(15, 2e-3) for name in ("noise", "own_noise")},
        path=np.arange(15) + 1.0,
    )  # fmt: skip
    assert found.row.usable == 0.75
    # Five by the water, five without a target, one mixed beam and one corner.
    assert found.row.flagged == pytest.approx(12 / 20)
    # One of the eight others does not agree.
    assert found.row.trusted == pytest.approx(7 / 20)
    assert np.isfinite(found.path).sum() == 7
    assert found.row.bias == pytest.approx(1e-3)
    channel["quality_flag"].values[:, 0, 0] = 0
    flags = channel["quality_flag"].values
    flags[:] = np.where(flags == 0, QualityFlag.WATER_RESIDUAL, flags)
    found = evaluated(
        monkeypatch, channel, bias=bias,
        **{name: np.full(15, 2e-3) for name in ("noise", "own_noise")},
        agree=np.ones(15, bool), path=np.ones(15), mixed=np.zeros(15, bool),
        in_corner=np.zeros(15, bool),
    )  # fmt: skip
    assert found.row.bias == pytest.approx(np.sqrt(np.mean(bias**2)))
    assert found.row.trusted == 0.0


def test_a_row_without_usable_pixels_has_no_error(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel["quality_flag"].values[:] = QualityFlag.NO_TARGET
    found = evaluated(monkeypatch, channel)
    assert found.row.caution is Caution.NO_PIXEL
    assert found.row.note == "no pixel shows a target"
    assert np.isnan([found.row.bias, found.row.noise, found.own_noise]).all()
    assert np.isnan(found.path).all()
    shares = found.row.usable, found.row.flagged, found.row.trusted
    assert shares == (0.0, 1.0, 0.0)
    nothing = evaluated(
        monkeypatch,
        channel.assign(quality_flag=0 * channel["quality_flag"]),
        noise=np.full(20, np.nan),
    )
    assert np.isnan([nothing.row.noise, nothing.own_noise]).all()
    assert nothing.row.bias == pytest.approx(3e-3)


@pytest.mark.parametrize("unknown", ["flag", "bias"])
def test_water_of_unknown_amount_makes_the_bias_infinite(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch, unknown: str
) -> None:
    errors = {}
    if unknown == "flag":
        channel["quality_flag"].values[0, 0, 1, 1] = QualityFlag.NO_OPEN_WATER
    else:
        errors["bias"] = np.append(np.zeros(19), np.nan)
    found = evaluated(monkeypatch, channel, **errors)
    assert found.row.bias == np.inf
    assert found.row.caution is Caution.BIAS_UNKNOWN
    assert found.row.note == "nothing tells how much water is left in"


@pytest.mark.parametrize("corners", [False, True])
def test_a_contradiction_names_the_instrument_and_corners(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch, corners: bool
) -> None:
    channel["water_residual_cause"].values[1, 0, 2, 2] = (
        WaterResidualCause.INSTRUMENT | WaterResidualCause.PHASE_SHIFT
    )
    found = evaluated(monkeypatch, channel, corner_light=corners)
    assert found.row.caution is Caution.INSTRUMENT
    begin = "no water explains the open-water shots and the scan together, so "
    middle = "corners reflect light twice" if corners else "the instrument has an error"
    assert found.row.note.startswith(begin + middle)
    assert found.row.note.endswith("calibrate the phase against amplitude")
    plain = evaluated(
        monkeypatch, channel.drop_vars("water_residual_cause"), corner_light=corners
    )
    assert plain.row.caution is Caution.NONE


def test_one_frequency_repeats_within_a_long_interval(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = channel.isel(modulation_frequency=[0])
    repeat = 299792458.0 / (2 * 1.38 * 20e6)
    for length, caution, note in (
        (0.999 * repeat, Caution.NONE, ""),
        (1.001 * repeat, Caution.AMBIGUOUS, "repeats after 5.43 m"),
    ):
        interval = (0.5, 0.5 + length)
        found = evaluated(monkeypatch, one, interval, keeps_one_frequency=True)
        assert (found.row.caution, found.row.note) == (caution, note)
        several = evaluated(monkeypatch, one, interval)
        assert several.row.caution is Caution.NONE
    assert evaluated(
        monkeypatch, one, keeps_one_frequency=True
    ).row.caution is Caution.NONE  # fmt: skip


@pytest.mark.parametrize("by", ["usable", "sound"])
def test_pixels_without_neighbors_are_lone(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    lone = np.zeros((4, 5), bool)
    lone[0, 0] = lone[2, 2] = lone[0, 4] = True
    flag = QualityFlag.NO_TARGET if by == "usable" else QualityFlag.WATER_RESIDUAL
    channel["quality_flag"].values[:] = np.where(lone, 0, flag)
    count = 3 if by == "usable" else 20
    found = evaluated(monkeypatch, channel, path=np.ones(count))
    assert found.row.caution is Caution.LONE_PIXELS
    assert found.row.note == "no pixel that it trusts has a neighbor"
    assert found.row.trusted == 0.0
    channel["quality_flag"].values[:, :, 0, 1] = 0
    found = evaluated(monkeypatch, channel, path=np.ones(count + (by == "usable")))
    assert found.row.caution is Caution.NONE
    assert found.row.trusted == pytest.approx(2 / 20)
