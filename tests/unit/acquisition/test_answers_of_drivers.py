"""Answers of drivers of other packages: each wrong one is named with what is needed."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor.acquisition import plugins
from amulor.acquisition.plugins import GuardedDevice, Wiring, make
from amulor.acquisition.protocols import Overload, Reading, Recorded, Waveform
from amulor.errors import InstrumentError


def reading(**changes: Any) -> Reading:
    known = {"signal": 1j, "mean": math.nan, "modulation_frequency": 39e6}
    return Reading(**{**known, **changes})


def recorded(**changes: Any) -> Recorded:
    known = {
        "times": np.zeros(2), "signals": np.zeros((2, 1), dtype=complex), "mean": 0.5,
        "modulation_frequencies": (39e6,),
    }  # fmt: skip
    return Recorded(**{**known, **changes})


def waveform(**changes: Any) -> Waveform:
    known = {
        "signal": np.zeros(3), "reference": np.zeros(3), "sample_rate": 1e6,
        "clipped": False, "shows_mean": True,
    }  # fmt: skip
    return Waveform(**{**known, **changes})


GOOD = {
    "identity": "a lock-in", "read": reading(), "read_all": [reading(), reading()],
    "record": recorded(), "fetch": recorded(mean=math.nan), "acquire": waveform(),
    "set_frequency": 39e6, "set_frequencies": (20e6, np.float64(39e6)),
    "full_scale": 1, "relieve": True, "sharpen": np.False_, "move": np.zeros(2),
    "where": [0.1, -0.1], "set_output": 0, "input": -5.0,
    "readings": {"laser_current": 0.1, "laser_temperature": -3}, "messages": [(1, "a")],
}  # fmt: skip


@pytest.mark.parametrize("name", GOOD)
def test_a_good_answer_passes(name) -> None:
    device = SimpleNamespace(**{name: lambda: GOOD[name]})
    assert getattr(GuardedDevice(device, "it"), name)() is GOOD[name]


def test_each_method_with_an_answer_is_checked() -> None:
    assert plugins._CHECKS.keys() == GOOD.keys()


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("identity", 5, "5, needed is a text"),
        ("relieve", 1, "1, needed is True or False"),
        ("full_scale", True, "True, needed is a number (in V)"),
        ("full_scale", "1", "'1', needed is a number (in V)"),
        ("full_scale", 0.0, "0, needed is a number above 0 (in V)"),
        ("full_scale", math.inf, "inf, needed is a finite number (in V)"),
        ("set_frequency", -1.0, "-1, needed is a number above 0 (frequency in Hz)"),
        ("set_frequencies", 5, "5, needed is a sequence"),
        ("set_frequencies", "56", "'56', needed is a sequence"),
        (
            "set_frequencies", [1.0, None],
            "None, needed is a number (frequency in Hz)",
        ),
        ("move", [0.1], "1 values, needed are 2"),
        ("where", [0.1, math.nan], "nan, needed is a finite number (angle in rad)"),
        ("read", 5, "5, needed is a Reading"),
        (
            "read", reading(signal=complex(math.nan, 0)),
            "signal = (nan+0j), needed is a finite complex number in V",
        ),
        (
            "read", reading(signal="x"),
            "signal = 'x', needed is a finite complex number in V",
        ),
        (
            "read", reading(modulation_frequency=math.nan),
            "modulation_frequency = nan, needed is a finite number (in Hz)",
        ),
        (
            "read", reading(overload=16),
            "overload = 16, needed is a sum of the bits of Overload, at most 15",
        ),
        (
            "read", reading(overload="x"),
            "overload = 'x', needed is a sum of the bits of Overload, at most 15",
        ),
        (
            "read", reading(mean=math.inf),
            "mean = inf, needed is a number in V, nan if not wired",
        ),
        (
            "read", reading(mean=None),
            "mean = None, needed is a number in V, nan if not wired",
        ),
        ("read_all", [reading(), 7], "7, needed is a Reading"),
        ("record", 5, "5, needed is a Recorded"),
        (
            "record", recorded(times=np.zeros(3)),
            "times of shape (3,) and signals of shape (2, 1), needed are (n,) and (n, "
            "frequency)",
        ),
        (
            "record", recorded(signals=np.zeros(2)),
            "times of shape (2,) and signals of shape (2,), needed are (n,) and (n, "
            "frequency)",
        ),
        (
            "fetch", recorded(times=np.array([0, math.nan])),
            "times or signals that are not finite numbers",
        ),
        (
            "fetch", recorded(signals=np.array([[0], [math.inf]])),
            "times or signals that are not finite numbers",
        ),
        (
            "record", recorded(mean=-math.inf),
            "mean = -inf, needed is a number in V, nan if not wired",
        ),
        ("acquire", 5, "5, needed is a Waveform"),
        (
            "acquire", waveform(signal=np.array([math.nan])),
            "a signal that is not of finite numbers",
        ),
        (
            "acquire", waveform(sample_rate=0),
            "0, needed is a number above 0 (sample rate in 1/s)",
        ),
        ("messages", [5], "5, needed are time of arrival and line of text"),
        ("messages", [(1.0,)], "(1.0,), needed are time of arrival and line of text"),
        ("messages", [("a", "b")], "'a', needed is a number (arrival in s)"),
        ("messages", [(1.0, 2)], "2, needed is a text"),
        ("readings", 5, "5, needed is a dict"),
        (
            "readings", {"x": 1.0, "laser_current": 1.0},
            "x, possible are laser_current and laser_temperature",
        ),
        (
            "readings", {"laser_current": math.inf},
            "inf, needed is a finite number (in A or degC)",
        ),
        ("identity", ["x" * 80], "['" + "x" * 58 + "..., needed is a text"),
    ],
)  # fmt: skip
def test_a_wrong_answer_is_named(name, value, problem) -> None:
    device = GuardedDevice(SimpleNamespace(**{name: lambda: value}), "scanner 'x' of y")
    with pytest.raises(InstrumentError) as caught:
        getattr(device, name)()
    assert str(caught.value) == (
        f"{name}() of the scanner 'x' of y has answered {problem}; correct that "
        "driver, see amulor.acquisition.protocols"
    )


def test_overload_bits_of_any_sum_pass() -> None:
    for bits in range(16):
        assert plugins._state(reading(overload=bits)) is None
    assert plugins._state(reading(overload=Overload.INPUT | Overload.MEAN)) is None


def test_attributes_and_other_methods_pass_as_they_are() -> None:
    device = GuardedDevice(SimpleNamespace(records=True, other=lambda n: n + 1), "it")
    assert device.records is True
    assert device.other(1) == 2
    assert not hasattr(device, "missing")


@pytest.mark.parametrize(("text", "shown"), [("a\n  b", "a b"), ("", "no message")])
def test_a_failure_of_a_driver_names_its_method(text, shown) -> None:
    def broken() -> None:
        raise OSError(text) if text else OSError

    device = GuardedDevice(SimpleNamespace(read=broken), "lock_in 'x' of y")
    with pytest.raises(InstrumentError) as caught:
        device.read()
    assert str(caught.value) == (
        f"the lock_in 'x' of y has failed in read(): OSError: {shown}; check its "
        "cable, its power and its options in the devices file"
    )


class Entry:
    value = "package:factory"

    def __init__(self, factory: Any) -> None:
        self._factory = factory

    def load(self) -> Any:
        return self._factory


def made(monkeypatch: Any, *entries: Entry) -> Any:
    asked: list[Any] = []

    def find(**words: str) -> list[Entry]:
        asked.append(words)
        return [*entries]

    monkeypatch.setattr(plugins.metadata, "entry_points", find)
    monkeypatch.setattr(plugins._plugins, "names", lambda group: ["one", "two"])
    wiring = Wiring(address=None, timeout=1.0, clock=None)
    assert wiring.options == {}
    found = make("source", "x", wiring)
    assert asked == [{"group": "amulor.sources", "name": "x"}]
    return found


def test_a_driver_is_made_by_its_entry_point(monkeypatch) -> None:
    words = ("identity", "make_safe", "close", "set_frequency")
    whole = SimpleNamespace(**{word: lambda *_: 5.0 for word in words})
    source = made(monkeypatch, Entry(lambda wiring: whole))
    assert source.set_frequency(1.0) == 5.0
    with pytest.raises(
        InstrumentError, match="identity\\(\\) of the source 'x' of pack"
    ):
        source.identity()
    part = SimpleNamespace(identity=str, close=5)

    def broken(wiring: Wiring) -> Any:
        raise ValueError("no wire")

    def refused(wiring: Wiring) -> Any:
        raise InstrumentError("its own words")

    for entries, text in (
        (
            [],
            "no installed package offers the source 'x' (entry point amulor.sources); "
            "there are: one, two",
        ),
        (
            [Entry(lambda wiring: part)],
            "the source 'x' of package:factory has no make_safe, close, set_frequency; "
            "see amulor.acquisition.protocols",
        ),
        (
            [Entry(broken)],
            "the source 'x' of package:factory cannot be made: ValueError: no wire",
        ),
        ([Entry(refused)], "its own words"),
    ):
        with pytest.raises(InstrumentError) as caught:
            made(monkeypatch, *entries)
        assert str(caught.value) == text
