"""Characters, colors and lines of a running scan in a terminal."""

from __future__ import annotations

from datetime import datetime
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib import colormaps
from numpy.testing import assert_allclose

from amulor import samples
from amulor.view import terminal

NOW = datetime(2026, 5, 4, 12, 30)


@pytest.mark.parametrize(
    ("shape", "room", "shown"),
    [((3, 4), (3, 4), (3, 4)), ((3, 4), (6, 8), (6, 8)), ((3, 4), (5, 8), (3, 4)),
     ((3, 4), (2, 4), (2, 2)), ((3, 4), (3, 3), (2, 2)), ((9, 2), (3, 80), (3, 1))],
)  # fmt: skip
def test_a_map_fits_its_room_in_whole_steps(shape, room, shown) -> None:
    values = np.arange(float(np.prod(shape))).reshape(shape)
    found = terminal.shrunk(values, *room)
    assert found.shape == shown
    if shape == shown:
        assert_allclose(found, values)
    if shown == (6, 8):
        assert_allclose(found[::2, 1::2], values)


def test_limits_of_colors_leave_out_two_percent() -> None:
    values = np.r_[np.arange(101.0), np.nan]
    assert terminal.limits(values) == pytest.approx((2, 98))
    assert terminal.limits(np.full(3, np.nan)) == (0.0, 1.0)
    # A map of one value is drawn between it and a thousandth more.
    assert terminal.limits(np.full(3, -2.0)) == pytest.approx((-2.0, -1.998))
    low, high = terminal.limits(np.zeros(3))
    assert low == 0 < high <= 1e-15


def test_colors_are_those_of_the_scale_and_halves_are_two_pixels() -> None:
    values = np.array([[0.0, 1.0, np.nan], [0.5, np.nan, np.nan], [np.nan, 0.5, 0.25]])
    text = terminal.picture(values, colours="viridis")
    assert text.plain == "▀▀ \n ▀▀"
    low, high = np.nanquantile(values, [0.02, 0.98])

    def color(value: float) -> str:
        share = np.clip((value - low) / (high - low), 0, 1)
        numbers = [int(255 * part) for part in colormaps["viridis"](share)[:3]]
        return f"rgb({','.join(map(str, numbers))})"

    assert [str(span.style) for span in text.spans] == [
        f"{color(0.0)} on {color(0.5)}", color(1.0), color(0.5), color(0.25),
    ]  # fmt: skip
    assert text.no_wrap


def test_letters_darken_with_the_value() -> None:
    values = np.append(np.linspace(0, 1, 9), np.nan)[None]
    text = terminal.picture(np.tile(values, (2, 1)), colours="gray", plain=True)
    assert text.plain == "\n".join([".:-=+*#%@ "] * 2)
    assert text.no_wrap


def test_a_signal_is_compared_with_its_noise() -> None:
    cube = samples.cube("ladder")
    names = cube.amulor.polarizations
    live: Any = SimpleNamespace(recording=SimpleNamespace(samples=cube))
    # 3 and 4 V against noise of 0.1 and 0.2 V in both parts, and of 0 without a number.
    given = cube.copy(deep=True)
    shape = given["in_phase"].shape
    given["in_phase"].values[:], given["quadrature"].values[:] = 3.0, 4.0
    noise = np.where(np.arange(shape[-1]) < 3, 0.1, 0.0)
    for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
        given[name].values[:] = noise
    live.recording.samples = given
    assert terminal.signal_to_noise(live, names[0]) == pytest.approx(50.0)
    assert terminal.signal_to_noise(live, "HH") is None
    given["in_phase_uncertainty"].values[:] = np.nan
    assert terminal.signal_to_noise(live, names[0]) is None
    live.recording.samples = None
    assert terminal.signal_to_noise(live, names[0]) is None


@pytest.mark.parametrize(
    ("status", "words"),
    [({}, "not begun"), ({"state": "running"}, "running"),
     ({"state": "running", "kind": "dark"}, "dark"),
     ({"state": "paused", "kind": "dark", "done": 3}, "paused"),
     ({"state": "x", "done": 1, "total": 3}, "x, 1 of 3 samples (33%)"),
     ({"rate": 0.4, "left": 0}, "not begun, 0/s, 0:00:00 left, ends at 12:30"),
     ({"left": 90.7}, "not begun, 0:01:30 left, ends at 12:31"),
     ({"flagged": {"b": 2, "a": 1000}}, "not begun, 1,000 a, 2 b"),
     ({"drift": {"elapsed": [], "total": {}}}, "not begun")],
)  # fmt: skip
def test_progress_has_what_is_known(status: dict[str, Any], words: str) -> None:
    assert terminal.going(status, ratio=None, now=NOW) == words


def _live(before: np.ndarray, after: np.ndarray, **status: Any) -> Any:
    maps = {"range": after, "range_before": before}
    return SimpleNamespace(
        name="pool", status=status, recording=SimpleNamespace(samples=None),
        now=lambda channel, name: maps[name],
    )  # fmt: skip


def _shown(live: Any, size: tuple[int, int], *, plain: bool = True) -> list[Any]:
    group = terminal.screen(
        live, channel="VV", layer="range", size=size, plain=plain, now=NOW
    )
    return list(group.renderables)


def test_a_screen_has_a_title_a_map_a_scale_and_advice() -> None:
    values = np.linspace(1.0, 2.0, 101)[None].repeat(101, axis=0)
    nothing = np.full((101, 101), np.nan)
    live = _live(nothing, values, advice=["x" * 41], error="broken", done=1, total=4)
    title, picture, scale, line, advice, error = _shown(live, (40, 24))
    assert title.plain == "pool, VV"
    # 24 lines, of which five are kept and three are notices; 101 in steps of 7.
    assert len(picture.plain.split("\n")) == 15
    assert len(picture.plain.split("\n")[0]) == 15
    low, high = (float(word) for word in scale.plain.split()[1:4:2])
    assert scale.plain.endswith(" m")
    assert 1.02 < low < 1.05
    assert 1.95 < high < 2.0
    assert line.plain == "not begun, 1 of 4 samples (25%)"
    assert (advice.plain, error.plain) == ("x" * 41, "broken")
    colored = _shown(live, (40, 24), plain=False)[1]
    # Two pixels in a line: 32 of room, but 39 columns; steps of four.
    assert len(colored.plain.split("\n")) == 13
    assert len(_shown(live, (40, 3))[1].plain.split("\n")) == 2
    assert len(_shown(live, (1, 80))[1].plain.split("\n")[0]) == 2


def test_a_screen_says_that_water_is_left_or_nothing_is_measured() -> None:
    values, nothing = np.ones((4, 4)), np.full((4, 4), np.nan)
    _, _, scale, *_ = _shown(_live(values, nothing), (40, 24))
    assert scale.plain == "range 1 to 1.001 m, water left in"
    _, _, scale, *rest = _shown(_live(nothing, nothing), (40, 24))
    assert scale.plain == "range: nothing measured yet"
    assert len(rest) == 1


def test_maps_of_a_terminal_have_their_units() -> None:
    assert list(terminal.CHOICES) == ["range", "amplitude", "uncertainty"]
    units = [terminal._UNITS[name] for name in terminal.CHOICES]
    assert units == ["m", "V", "m"]
