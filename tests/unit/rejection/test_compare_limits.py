"""Choice of a method: both sides of its limits, and the words of its reasons."""

from __future__ import annotations

import importlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from compared_methods import row
from numpy.testing import assert_array_equal

from amulor.rejection import Caution, Comparison, Row

#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.compare")


def scaled(error: float, **changed: Any) -> Row:
    return row(bias=0.6 * error, noise=0.8 * error, **changed)


def test_an_error_has_three_parts() -> None:
    assert row(instrument=12e-3).error == pytest.approx(13e-3)


@pytest.mark.parametrize(
    ("rows", "best"),
    [
        # Nine tenths as many trusted pixels are enough.
        ([scaled(1.0, trusted=0.9), scaled(2.0)], 0),
        ([scaled(1.0, trusted=0.899), scaled(2.0)], 1),
        # Errors within a twentieth are equal: the simpler method wins.
        ([scaled(1.0499), scaled(1.0)], 0),
        ([scaled(1.0501), scaled(1.0)], 1),
        ([scaled(2.0), scaled(1.05), scaled(1.0)], 1),
        # Flagged pixels count only where no method has others.
        ([scaled(1.0, trusted=0.0), scaled(9.0, trusted=0.01)], 1),
        ([scaled(1.0, trusted=0.0, usable=0.5), scaled(2.0, trusted=0.0)], 1),
        ([scaled(1.0, trusted=0.0, usable=0.9), scaled(2.0, trusted=0.0)], 0),
        ([row(trusted=0.0, caution=Caution.INSTRUMENT),
          scaled(2.0, trusted=0.0, usable=0.1)], 1),
        ([row(trusted=0.0, caution=Caution.LONE_PIXELS)], None),
        ([row(trusted=0.0, usable=0.0)], None),
        ([], None),
        # An ambiguous frequency is taken where there is no other.
        ([scaled(1.0, caution=Caution.AMBIGUOUS), scaled(2.0)], 1),
        ([scaled(1.0, caution=Caution.AMBIGUOUS)], 0),
        # Of unknown errors the least noise.
        ([row(bias=np.inf, noise=2.0), row(bias=np.inf, noise=1.0)], 1),
        ([row(bias=np.inf, noise=2.0), scaled(9.0)], 1),
    ],
)  # fmt: skip
def test_the_best_row_is_chosen_by_these_rules(
    rows: list[Row], best: int | None
) -> None:
    assert module._best(rows) == best


@pytest.mark.parametrize(
    "mask",
    [["x..", "...", "..x"], ["xx.", "...", "..."], ["..x", ".x.", "..."],
     ["x..x", "....", "x..."]],
)  # fmt: skip
def test_pixels_have_eight_neighbors(mask: list[str]) -> None:
    inside = np.array([[letter == "x" for letter in text] for text in mask])
    expected = np.zeros(inside.shape, dtype=bool)
    for i, j in np.ndindex(inside.shape):
        part = inside[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        expected[i, j] = part.sum() > inside[i, j]
    assert_array_equal(module._has_neighbor(inside), expected)
    assert module._has_neighbor(np.array([[False]])).all()


def test_shots_are_doubted_where_few_of_their_targets_are_trusted() -> None:
    shots: Any = SimpleNamespace(amulor=SimpleNamespace(open_water=object()))
    bare: Any = SimpleNamespace(amulor=SimpleNamespace(open_water=None))
    low, high = row(usable=0.5, trusted=0.399), row(usable=0.5, trusted=0.401)
    assert module._shots_are_doubted(shots, [low, low])
    assert not module._shots_are_doubted(shots, [low, high])
    assert not module._shots_are_doubted(bare, [low])
    assert not module._shots_are_doubted(shots, [])
    assert not module._shots_are_doubted(shots, [row(polarization="", trusted=0.0)])


CUBE: Any = {"geometry": xr.DataArray(0, attrs={"group_index": 1.25})}


def trial(
    of: Row, offset: float, *, own: float = 1e-4, count: int = 400, scatter: float = 0.0
) -> Any:
    """Return a trial whose ranges are off by some length."""
    rng = np.random.default_rng(3)
    path = 5.0 + 2.5 * (offset + scatter * rng.standard_normal(count))
    return module._Trial(row=of, path=path, own_noise=own, repeat=100.0)


def test_of_methods_that_agree_the_one_of_least_noise_is_taken() -> None:
    first = trial(row(trusted=0.8), 0.0, own=1e-3, scatter=1e-3)
    flat = trial(row(trusted=0.8), 0.0, own=1e-3)

    def chosen(*others: Any, of: Any = first) -> int | None:
        found = module._steadier([of, *others], 0, CUBE)
        return None if found is None else int(found.index)

    assert chosen(trial(row(), 0.0)) == 1
    assert chosen(trial(row(), 0.0, own=2e-4), trial(row(), 0.0)) == 2
    # Nine tenths of the trusted pixels, no caution, twice the error at most.
    assert chosen(trial(row(trusted=0.7201), 0.0)) == 1
    assert chosen(trial(row(trusted=0.7199), 0.0)) is None
    assert chosen(trial(row(caution=Caution.BIAS_UNKNOWN), 0.0)) is None
    assert chosen(trial(scaled(2 * first.row.error * 0.999), 0.0)) == 1
    assert chosen(trial(scaled(2 * first.row.error * 1.001), 0.0)) is None
    # A twentieth less noise, the difference of the ranges included.
    least = 1e-3 / 1.05
    assert chosen(trial(row(), 0.0, own=0.999 * least), of=flat) == 1
    assert chosen(trial(row(), 0.0, own=1.001 * least), of=flat) is None
    other = float(np.sqrt(least**2 - 1e-8))
    assert chosen(trial(row(), 0.999 * other), of=flat) == 1
    assert chosen(trial(row(), 1.001 * other), of=flat) is None
    found = module._steadier([flat, trial(row(), 3e-4)], 0, CUBE)
    assert found.difference == pytest.approx(3e-4, rel=1e-6)
    # Scatter beyond the noise of the first counts as a difference.
    wide = trial(row(), 0.0, scatter=1.3e-3)
    found = module._steadier([flat, wide], 0, CUBE)
    spread = 1.4826 * np.median(np.abs(wide.path - np.median(wide.path))) / 2.5
    expected = np.hypot(np.median(wide.path - 5.0) / 2.5, np.sqrt(spread**2 - 1e-6))
    assert found.difference == pytest.approx(expected, rel=1e-3)
    # Few common pixels show nothing.
    short = [trial(row(), 0.0, own=own, count=10) for own in (1e-3, 1e-4)]
    assert chosen(short[1], of=short[0]) == 1
    short = [trial(row(), 0.0, own=own, count=9) for own in (1e-3, 1e-4)]
    assert chosen(short[1], of=short[0]) is None
    unknown = trial(row(bias=np.inf), 0.0, own=1e-3)
    assert chosen(trial(row(), 0.0), of=unknown) is None
    exact = trial(row(), 0.0, own=0.0)
    assert chosen(trial(row(), 0.0, own=0.0), of=exact) is None


def test_methods_disagree_beyond_four_times_both_errors() -> None:
    chosen = trial(scaled(3e-3, instrument=1.0), 0.0)
    limit = 4 * 5e-3
    for factor, disagrees in ((0.999, False), (1.001, True)):
        other = trial(scaled(4e-3, method="other"), -factor * limit)
        found, size = module._disagreement([other, chosen], 1, CUBE)
        assert (found is other.row) == disagrees
        assert size == pytest.approx(factor * limit if disagrees else 0.0, rel=1e-6)
    # The largest of several; cautions do not count.
    near, far = (trial(scaled(4e-3), sign * 0.03) for sign in (1, 1.5))
    found, size = module._disagreement([near, chosen, far], 1, CUBE)
    assert found is far.row
    assert size == pytest.approx(0.045, rel=1e-6)
    found, size = module._disagreement([far, chosen, near], 1, CUBE)
    assert found is far.row
    doubted = trial(scaled(4e-3, caution=Caution.BIAS_UNKNOWN), 1.0)
    assert module._disagreement([doubted, chosen], 1, CUBE) == (None, 0.0)
    few = trial(scaled(4e-3), 1.0, count=9)
    short = trial(scaled(3e-3), 0.0, count=9)
    assert module._disagreement([few, short], 1, CUBE) == (None, 0.0)


def reason(rows: list[Row], best: int = 0, *, has_shots: bool = True) -> str:
    return str(module._reason(rows, best, has_shots=has_shots))


def test_a_reason_states_errors_and_the_next_method() -> None:
    first = row(trusted=0.62)
    assert reason([first]) == (
        "first VV: error 5 mm (bias 3 mm, noise 4 mm) with 62% of the pixels trusted"
    )
    others = [
        scaled(9e-3, method="second", trusted=0.4),
        scaled(7e-3, method="third", polarization="VH", trusted=0.5),
        scaled(1e-3, method="first", polarization="VH"),
        row("fourth", bias=np.inf),
    ]
    assert reason([first, *others]).endswith("trusted; third VH 7 mm with 50%")
    # Hardly any pixel, and many flags.
    assert "hardly any" in reason([row(trusted=0.0299)])
    assert "hardly any" not in reason([row(trusted=0.0301)])
    assert "hardly any" not in reason([row(trusted=0.0)])
    assert reason([row(flagged=0.51)]).endswith(
        "; 51% of the pixels carry a flag, see there"
    )
    assert "carry a flag" not in reason([row(flagged=0.5)])


@pytest.mark.parametrize(
    ("has_shots", "remedy"),
    [(True, "the notes of the other methods say why"),
     (False, "record open-water shots")],
)  # fmt: skip
def test_a_reason_says_that_nothing_tells_the_bias(
    has_shots: bool, remedy: str
) -> None:
    assert reason([row(bias=np.inf)], has_shots=has_shots) == (
        "first VV: nothing tells how much water is left, and no other method can run; "
        + remedy
    )


def refusal(
    channels: list[str], frequency: list[float], rows: list[Row], *, shots: bool = False
) -> str:
    cube: Any = SimpleNamespace(
        amulor=SimpleNamespace(
            open_water=object() if shots else None, polarizations=channels
        )
    )
    values = SimpleNamespace(values=np.array(frequency))
    with_items = type("Cube", (SimpleNamespace,), {"__getitem__": lambda *_: values})
    return str(module._refusal(with_items(**vars(cube)), rows))


def test_a_refusal_says_what_to_record() -> None:
    none = [row(caution=Caution.NOT_RUN, note="no shots")]
    said = refusal(["VV"], [39e6], none)
    assert "found: channel VV at 39 MHz, no open-water shots" in said
    assert "a cross-polarized channel (VH), or several" in said
    assert "a cross-polarized channel (VH), or" in refusal(["none"], [39e6], none)
    # Anything else lists the methods by their notes.
    listed = "no method has a pixel that it can use\n  first: no shots"
    assert refusal(["VV"], [39e6], none, shots=True) == listed
    assert refusal(["VV", "VH"], [39e6], none) == listed
    assert refusal(["VV"], [39e6, 50e6], none) == listed
    rows = [*none, row("second", caution=Caution.NOT_RUN, note="no shots"),
            row("third", caution=Caution.NO_PIXEL), row("third", note="")]  # fmt: skip
    assert refusal(["VV"], [39e6], rows) == (
        "no method has a pixel that it can use\n  first, second: no shots"
        "\n  third: no pixel"
    )


def test_the_target_of_a_comparison_states_its_method() -> None:
    target = xr.Dataset(coords={"polarization": ["VV", "VH"]})
    for disagreement, states in ((0.0, False), (0.02, True)):
        found = module._of_comparison(
            target,
            Comparison(
                rows=(row(),), method="first", polarization="VH", reason="why",
                disagreement=disagreement,
            ),
        )  # fmt: skip
        assert found["polarization"].values.tolist() == ["VH"]
        assert found.attrs["rejection_method"] == "first"
        assert found.attrs["rejection_reason"] == "why"
        assert found.attrs.get("method_disagreement_m", 0.0) == disagreement
        assert ("method_disagreement_m" in found.attrs) == states
