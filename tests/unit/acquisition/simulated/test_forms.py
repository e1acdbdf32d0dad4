"""Simulated devices answer any line by an answer or by an error of their manual."""

from __future__ import annotations

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as drawn
from shared_light import scene_light

from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.simulated.pi import SimulatedPiController
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.acquisition.simulated.stanford import SimulatedSr844

NUMBERS = st.sampled_from(
    ["0", "1", "2", "3", "-1", "5.0", "0.5E1", "5.5", "99", "1e9", "1e400", "nan",
     "inf", "-inf", "1_0", "", " ", "X", "TH", "ONE", "IMM", "ON", "é", "1" * 5000]
)  # fmt: skip
ARGUMENTS = st.lists(NUMBERS, max_size=4).map(",".join)


def stanford(bench, model):
    device = model(bench)
    words = {word.removesuffix("?") for word in device._handlers} | {*device.settings}
    return device, sorted(words)


@pytest.mark.parametrize("model", [SimulatedSr844, SimulatedSr865a])
@given(data=st.data())
@drawn(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_lock_in_answers_any_form(small, settings, clock, model, data) -> None:
    bench = simulated_bench(small, settings, scene=scene_light, clock=clock)
    device, words = stanford(bench, model)
    word = data.draw(st.sampled_from([*words, "NONSENSE"]))
    text = (
        word + data.draw(st.sampled_from(["", "?", " ?"])) + " " + data.draw(ARGUMENTS)
    )
    answers = device.answer(text)
    # A refusal has no answer, and an answer sets no error.
    status = int(device.answer("*ESR?")[0])
    assert status in (0, 16, 32)
    if answers:
        assert status == 0, text


@given(data=st.data())
@drawn(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_controller_answers_any_form(small, settings, clock, data) -> None:
    bench = simulated_bench(small, settings, scene=scene_light, clock=clock)
    device = SimulatedPiController(bench, settings)
    word = data.draw(st.sampled_from([*device._commands, *device._questions, "QQQ"]))
    words = data.draw(st.lists(NUMBERS, max_size=4))
    answers = device.answer(" ".join([word, *words]))
    (error,) = device.answer("ERR?")
    assert int(error) in (0, 1, 2, 5, 7, 8, 10, 15, 17)
    if answers and word != "ERR?":
        assert error == "0"


@pytest.mark.parametrize(("question", "sign"), [("TMN?", -1), ("TMX?", 1)])
def test_a_stage_moves_to_its_ends_and_no_farther(
    small, settings, clock, question, sign
) -> None:
    bench = simulated_bench(small, settings, scene=scene_light, clock=clock)
    device = SimulatedPiController(bench, settings)
    ends = dict(line.strip().split("=") for line in device.answer(question))
    assert len(ends) == 5
    for axis, end in ends.items():
        device.answer(f"SVO {axis} 1")
        device.answer(f"FRF {axis}")
        clock.sleep(10.0)
        device.answer(f"MOV {axis} {end}")
        assert device.answer("ERR?") == ["0"]
        clock.sleep(100.0)
        # Beyond the end: position out of limits.
        device.answer(f"MOV {axis} {float(end) + sign * 1e-3:.7f}")
        assert device.answer("ERR?") == ["7"]
        (goal,) = device.answer(f"MOV? {axis}")
        assert goal.strip().split("=")[1] == end
