"""Course of a comparison: which methods run, and how their results are combined."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from compared_methods import method_of, returning, row

from amulor import rejection
from amulor.cube import tiles
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
    return cube.drop_vars(
        [name for name in cube.variables if "open_water" in str(name)]
    )


@pytest.fixture(scope="module")
def target(cube: xr.Dataset) -> xr.Dataset:
    return rejection.keep_water(cube)


def raising(error: Exception) -> Callable[..., xr.Dataset]:
    def run(cube: xr.Dataset, *, interval: Any = None) -> xr.Dataset:
        raise error

    return run


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
