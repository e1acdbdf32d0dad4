"""Figures of candidates: rules written out, and both sides of their limits."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.integrate import simpson

from amulor.design import Goal, light, trade
from amulor.design import _kernels as kernel
from amulor.design.candidates import cost_of, first_choice, scan_time
from amulor.design.light import Looks, case_of
from amulor.design.numbers import Assessed, _footprint, _fractions, _numbers
from amulor.design.scores import Grid, Judge, Score, grid_of, merits
from amulor.survey import Survey, water_properties

#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.design.evaluate")


def score(**changed: Any) -> Score:
    values: dict[str, Any] = {
        "error": np.array([[1e-3, 2e-3]]), "wrong": np.zeros((1, 2)),
        "output": np.array([0.5]), "validity": np.array([0.5]),
        "time": np.array([60.0]), "cost": np.array([100.0]),
        "rows": np.array([0.0]), "smear": np.array([0.0]),
    }  # fmt: skip
    return Score(**values | changed)


def goal_with(text: str, budget: float | None = None) -> Goal:
    goal = Goal.from_text(text)
    parts = goal.components.model_copy(update={"budget": budget})
    return goal.model_copy(update={"components": parts})


def test_a_merit_is_the_logarithm_of_the_worst_error(goal_text: str) -> None:
    goal = goal_with(goal_text)
    # 2 mm of 3 mm, at the worse of two distances.
    assert merits(goal, score())[0] == pytest.approx(math.log(2 / 3))
    assert merits(goal, score(error=np.array([[np.nan, 1.0]])))[0] == 40.0
    assert merits(goal, score(error=np.zeros((1, 2))))[0] == -40.0


@pytest.mark.parametrize(
    ("name", "limit"),
    [("output", 1.0), ("validity", 1.0), ("time", 240.0), ("cost", 500.0),
     ("wrong", 0.001)],
)  # fmt: skip
def test_a_missed_requirement_counts_ten_times(
    goal_text: str, name: str, limit: float
) -> None:
    goal = goal_with(goal_text, budget=500.0)
    assert goal.scan.longest == 240.0
    assert goal.accuracy.wrong_interval == 0.001
    plain = math.log(2 / 3)
    for factor, beyond in ((0.5, 0.0), (1 + 1e-10, 0.0), (2.0, 10 * math.log(2))):
        value = np.array([factor * limit])
        if name == "wrong":
            value = np.array([[0.0, factor * limit]])
        found = merits(goal, score(**{name: value}))[0]
        assert found == pytest.approx(plain + beyond, abs=1e-7)
    assert merits(goal, score(wrong=np.array([[1.0, 0.0]])), with_intervals=False)[
        0
    ] == pytest.approx(plain)
    # Without a budget nothing costs too much; a budget of nothing is one.
    free = goal_with(goal_text)
    assert merits(free, score(cost=np.array([1e9])))[0] == pytest.approx(plain)
    none = goal_with(goal_text, budget=0.0)
    assert merits(none, score())[0] == pytest.approx(
        plain + 10 * math.log(100 / 1e-9), rel=1e-6
    )


def test_scores_are_parted_and_joined() -> None:
    both = Score.joined([score(), score(time=np.array([7.0]))])
    assert both.time.tolist() == [60, 7]
    assert both.error.shape == (2, 2)
    part = both.part(np.array([1]))
    assert part.time.tolist() == [7]
    assert part.cost.tolist() == [100]


GRID = Grid(
    baseline=(0.06, 0.2), radius=(0.01, 0.02), field_of_view=(0.03,),
    power=(0.01, 0.03), dwell=(0.03, 0.06, 0.12),
    sets=((15e6,), (15e6, 52e6)),
)  # fmt: skip


def test_candidates_of_a_grid_have_their_own_time_and_price(goal_text: str) -> None:
    goal = Goal.from_text(goal_text)
    laser = goal.components.lasers[0].model_copy(
        update={"price": 50.0, "price_per_watt": 1000.0}
    )
    parts = goal.components.model_copy(update={"lasers": (laser,)})
    goal = goal.model_copy(update={"components": parts})
    like = replace(first_choice(goal), polarization="VH+VV", method="open-water")
    judge = Judge(goal, "green", draws=4)
    time = np.broadcast_to(judge._paces(GRID, like)["time"], GRID.shape).ravel()
    cost = judge._prices(GRID, like)
    assert GRID.shape == (2, 2, 1, 2, 3, 2)
    for number in range(48):
        chosen = GRID.parameters(number, like)
        assert time[number] == pytest.approx(scan_time(goal, chosen))
        assert cost[number] == pytest.approx(cost_of(goal, chosen))
    assert len(set(cost.round(6))) > 1
    assert grid_of(GRID.parameters(5, like)).shape == (1, 1, 1, 1, 1, 1)
    assert GRID.parameters(47, like).frequencies == (15e6, 52e6)
    assert GRID.parameters(47, like).baseline == 0.2


def test_a_judge_takes_the_error_of_the_required_share(goal_text: str) -> None:
    goal = Goal.from_text(goal_text)
    judge = Judge(goal, "green", draws=8)
    count = judge.count
    rng = np.random.default_rng(3)
    shape = 2, 1, 1, 1, 1, 1, 2, count
    result = rng.uniform(0, 1, (*shape, len(kernel.RESULTS)))
    late, footprint, bent = rng.uniform(0, 1, (3, *shape))
    errors: Any = SimpleNamespace(
        result=result, late=late, footprint=footprint, bent=bent
    )
    found = judge._figures(errors)
    column = {name: result[..., k] for k, name in enumerate(kernel.RESULTS)}
    square = late**2 + footprint**2
    square = square + sum(column[name] for name in kernel.RANDOM)
    square = square + sum(column[name] ** 2 for name in kernel.SYSTEMATIC)
    # Half a radian squared, and half of the frequencies in noise.
    validity = np.maximum(bent / 0.5, column["unseen"] / 0.5)
    # As many draws as the share asks for are not worse.
    rank = math.ceil(goal.accuracy.share * count) - 1

    def reached(values: np.ndarray) -> np.ndarray:
        return np.sort(values, axis=-1)[..., rank].reshape(2, 2)

    assert_allclose(found[0], np.sqrt(reached(square)))
    assert_allclose(found[1], reached(column["wrong"]))
    assert_allclose(found[2], reached(column["output"]).max(axis=1))
    assert_allclose(found[3], reached(validity).max(axis=1))
    assert 0 < goal.accuracy.share <= 1


def assessed_of(count: int = 12, **changed: Any) -> Assessed:
    """Return errors of points, zero in all parts but those that are given."""
    result = np.zeros((count, len(kernel.RESULTS)))
    for name in kernel.RESULTS:
        if name in changed:
            result[:, kernel.RESULTS.index(name)] = changed[name]
    values: dict[str, Any] = {
        "result": result, "late": np.zeros(count), "footprint": np.zeros(count),
        "near": np.zeros(count), "far": np.full(count, np.inf),
        "repetition": np.full(count, 100.0), "bent": np.zeros(count), "volt": 2.0,
    }  # fmt: skip
    return Assessed(**values | {k: v for k, v in changed.items() if k in values})


def variables(
    errors: Assessed, distance: float = 2.0, slope: float | None = None
) -> dict[str, np.ndarray]:
    count = errors.near.size
    values = {"distance": np.full(count, distance)}
    if slope is not None:
        values["slope"] = np.full(count, slope)
    case: Any = None
    arrays: Any = SimpleNamespace(values=values)
    return dict(module._variables(errors, (count,), arrays, case, 0.01))


def test_errors_add_up_and_the_largest_binds() -> None:
    rng = np.random.default_rng(4)
    parts: dict[str, Any] = {name: rng.uniform(0, 1e-6, 12) for name in kernel.RANDOM}
    biases: dict[str, Any] = {
        name: rng.uniform(0, 1e-3, 12) for name in kernel.SYSTEMATIC
    }
    late, footprint = rng.uniform(0, 1e-3, (2, 12))
    errors = assessed_of(
        **parts, **biases, late=late, footprint=footprint, signal=0.3, astray=4e-6
    )
    found = variables(errors)
    variance = sum(parts.values())
    water = np.sqrt(sum(value**2 for value in biases.values()) + late**2)
    bias = np.hypot(water, footprint)
    assert_allclose(found["standard_uncertainty"], np.sqrt(variance))
    assert_allclose(found["residual_bias"], bias)
    assert_allclose(found["total_error"], np.sqrt(variance + bias**2))
    assert_allclose(found["water_left_in"], water)
    assert_allclose(found["late_light"], late)
    assert_allclose(found["signal"], 0.6)
    assert_allclose(found["ambiguity"], 2e-3)
    sizes = {name: np.sqrt(value) for name, value in parts.items()}
    sizes |= {"water_left_in": water, "footprint": footprint}
    for n, code in enumerate(found["binding_term"]):
        largest = max(sizes, key=lambda name, n=n: sizes[name][n])  # type: ignore[misc]
        assert module.TERMS[code] == largest


@pytest.mark.parametrize(
    ("changed", "flag", "term"),
    [
        ({"wrong": 0.0101}, "ambiguous", "ambiguity"),
        ({"wrong": 0.0099}, None, None),
        ({"repetition": np.full(12, 1.999)}, "ambiguous", "ambiguity"),
        ({"repetition": np.full(12, 2.001)}, None, None),
        ({"far": np.full(12, 1.999), "repetition": np.full(12, 0.5)}, "ambiguous",
         "ambiguity"),
        ({"far": np.full(12, 2.001), "repetition": np.full(12, 0.5)}, None, None),
        ({"near": np.full(12, 2.001)}, "ambiguous", "ambiguity"),
        ({"near": np.full(12, 1.999)}, None, None),
        ({"output": 1.001}, "saturated", "saturation"),
        ({"output": 0.999}, None, None),
        ({"unseen": 0.501}, "model_not_valid", None),
        ({"unseen": 0.499}, None, None),
        ({"bent": np.full(12, 0.501)}, "model_not_valid", None),
        ({"bent": np.full(12, 0.499)}, None, None),
    ],
)  # fmt: skip
def test_flags_have_their_limits(
    changed: dict[str, Any], flag: str | None, term: str | None
) -> None:
    found = variables(assessed_of(shot=1e-6, **changed))
    for name in ("ambiguous", "saturated", "model_not_valid"):
        assert (found[name] == (name == flag)).all(), name
    expected = "shot" if term is None else term
    assert (found["binding_term"] == module.TERMS.index(expected)).all()


@pytest.mark.parametrize(("slope", "steep"), [(0.499, False), (0.501, True)])
def test_a_steep_surface_is_outside_of_the_model(slope: float, steep: bool) -> None:
    found = variables(assessed_of(), slope=slope)
    assert (found["model_not_valid"] == steep).all()


@pytest.mark.parametrize(
    ("text", "run"),
    [("", (0, 0)), (".....", (0, 0)), ("xx.x", (0, 2)), (".xx.xxx", (4, 7)),
     ("xxx", (0, 3)), (".x.", (1, 2)), ("xx..xx", (0, 2))],
)  # fmt: skip
def test_the_longest_run_is_found(text: str, run: tuple[int, int]) -> None:
    good = np.array([letter == "x" for letter in text], dtype=bool)
    assert module._longest(good) == run


def reached(
    monkeypatch: pytest.MonkeyPatch, tank: Survey, **changed: np.ndarray
) -> Any:
    """Return the reach of an instrument whose errors are given, of 3 mm."""
    values: dict[str, Any] = {name: np.zeros(160) for name in module.TERMS}
    values |= {
        "model_not_valid": np.zeros(160), "saturated": np.zeros(160),
        "total_error": np.full(160, 2e-3), "shot": np.full(160, 1e-3),
        "water_left_in": np.full(160, 0.5e-3),
        "ambiguity_interval": np.full(160, 3.7),
    }  # fmt: skip
    errors = xr.Dataset(
        {name: ("distance", value) for name, value in (values | changed).items()}
    )
    asked: list[Any] = []

    def evaluate(survey: Survey, **words: Any) -> xr.Dataset:
        asked.append(words)
        return errors

    monkeypatch.setattr(module, "evaluate", evaluate)
    found = module.reach(tank, accuracy=3e-3, water="II", reflectance=0.3)
    assert_allclose(asked[0]["distance"], np.geomspace(0.3, 60, 160))
    assert asked[0]["reflectance"] == 0.3
    return found


def test_a_reach_ends_where_an_error_a_flag_or_the_model_says(
    monkeypatch: pytest.MonkeyPatch, tank: Survey
) -> None:
    distance = np.geomspace(0.3, 60, 160)
    far = np.arange(160)
    whole = reached(monkeypatch, tank)
    assert (whole.nearest, whole.farthest) == (pytest.approx(0.3), np.inf)
    assert whole.binding == ""
    assert whole.repetition == 3.7
    assert whole.water == "Jerlov II, open ocean"
    error = np.where((far < 20) | (far >= 90), 3.01e-3, 2.99e-3)
    part = reached(monkeypatch, tank, total_error=error)
    assert part.nearest == pytest.approx(distance[20])
    assert part.farthest == pytest.approx(distance[89])
    assert part.binding == "shot"
    bright = reached(monkeypatch, tank, saturated=(far >= 90).astype(float))
    assert bright.binding == "saturation"
    bent = reached(monkeypatch, tank, model_not_valid=(far >= 90).astype(float))
    assert bent.binding == "model"
    water = np.where(far >= 90, 4e-3, 0.0)
    left = reached(
        monkeypatch, tank, total_error=np.maximum(water, 1e-3), water_left_in=water
    )
    assert left.binding == "water left in"
    none = reached(monkeypatch, tank, total_error=np.full(160, np.nan))
    assert none.nearest is None
    assert none.farthest is None
    assert none.binding == "shot"
    nowhere = reached(monkeypatch, tank, model_not_valid=np.ones(160))
    assert nowhere.binding == "model"


def crossing(monkeypatch: pytest.MonkeyPatch, wins: Any, most: float = 1e9) -> Any:
    """Return the factor at which the other instrument begins to win."""
    tried: list[float] = []

    def scaled(factor: float) -> Any:
        tried.append(factor)
        return factor if factor <= most else None

    monkeypatch.setattr(trade, "_wins", lambda goal, *_: wins(goal))
    nothing: Any = None
    return trade._crossing(nothing, nothing, nothing, scaled, 8), tried


def test_a_crossing_is_found_to_five_percent(monkeypatch: pytest.MonkeyPatch) -> None:
    # Steps of the fourth root of ten, halved five times: 2 %.
    step = 10**0.25
    for at in (1.2, 3.0, 9.5):
        found, tried = crossing(monkeypatch, lambda f, at=at: f >= at)
        assert at <= found <= at * step ** (1 / 32) * (1 + 1e-9)
        found, _ = crossing(monkeypatch, lambda f, at=at: f <= 1 / at)
        assert 1 / at / step ** (1 / 32) * (1 - 1e-9) <= found <= 1 / at
    # The nearer side is found first; beyond ten there is none.
    found, _ = crossing(monkeypatch, lambda f: f >= 5 or f <= 1 / 3)
    assert found < 1
    found, tried = crossing(monkeypatch, lambda f: f > 10.5)
    assert found is None
    assert max(tried) == pytest.approx(10)
    assert min(tried) == pytest.approx(0.1)
    found, _ = crossing(monkeypatch, lambda f: f >= 4, most=3.9)
    assert found is None
    found, tried = crossing(monkeypatch, lambda f: True)
    assert found == 1.0
    assert tried == [1.0]


def test_the_spot_on_a_slope_smears_the_range(tank: Survey) -> None:
    emitter = tank.instrument.emitter.model_copy(
        update={"beam_radius": 0.003, "beam_divergence": 0.002}
    )
    instrument = tank.instrument.model_copy(update={"emitter": emitter})
    case: Any = SimpleNamespace(survey=SimpleNamespace(instrument=instrument))
    by_axis = {"texture": np.array(0.2), "slope": np.array(0.4)}
    found = _footprint(case, by_axis, np.array([2.0, 5.0]))
    # Half of the width, as high as the slope makes it, times the change over it.
    width = np.hypot(0.003, 0.002 * np.array([2.0, 5.0]))
    assert_allclose(found, 0.2 * width * np.tan(0.4) / 2)


def test_numbers_of_candidates_are_those_of_the_survey(tank: Survey) -> None:
    case = case_of(tank, water_properties(tank))
    values = {"distance": np.array([1.0, 2.0]), "power": np.array(0.04),
              "slope": np.array(0.3), "dwell": np.array([20e-3, 5e-3])}  # fmt: skip
    lighting = light.lit(case, values, np.array([39e6]), joint=False, late=False)
    by_axis = light.values_on_axes(case, values)
    found = _numbers(case, by_axis, lighting)
    place = lighting.places[0]
    # A tenth of the dwell at most, of which five are waited for.
    detector = tank.instrument.detector
    time = 2 * detector.excess_noise_factor / found["shot"]
    assert time[0] < 20e-3
    assert time[1] < 5e-3
    assert time[0] / 20e-3 > time[1] / 5e-3
    expected = 0.2 / math.pi * place.cosine * math.cos(0.3)
    passed = float(place.view.transmission)
    assert_allclose(found["echo"], expected * passed)
    # 180 shots determine six coefficients of a surface; 30 pixels.
    assert found["reference"] == pytest.approx(6 / 180)
    assert found["shots"] == 180
    assert found["pixels"] == 30
    double = _numbers(case, by_axis | {"power": np.array(0.08)}, lighting)
    assert_allclose(double["rate"], 2 * found["rate"])
    assert found["per_saturation"] == pytest.approx(
        detector.volt_per_photoelectron_rate / detector.saturation
    )
    for change in ({"scan.rows": 1}, {"scan.elevation_span": "0 deg"}):
        row = case_of(tank.with_(change), water_properties(tank))
        one = _numbers(row, by_axis, lighting)["reference"]
        assert one == pytest.approx(3 / 180)
    few = tank.with_({"scan.open_water.columns": 1, "scan.open_water.rows": 1,
                      "scan.open_water.repeats": 5})  # fmt: skip
    one = _numbers(case_of(few, water_properties(few)), by_axis, lighting)
    assert one["reference"] == 1.0


def test_an_analyzer_passes_its_part_of_each_surface(tank: Survey) -> None:
    case = case_of(tank, water_properties(tank))

    def flat(value: Any) -> np.ndarray:
        return np.broadcast_to(value, (3,))

    pairs = ("VV", "VH", "none")
    target = _fractions(case, {}, pairs, "target", flat)
    # (1 + m22) / 2 and (1 - m22) / 2; all of it without an analyzer.
    assert_allclose(target, [[0.7, 0.3, 1.0]] * 3)
    water = _fractions(case, {}, pairs, "water", flat)
    assert_allclose(water, [[0.925, 0.075, 1.0]] * 3)
    m22 = np.array([0.4, 0.0, -0.2])
    moved = _fractions(case, {"target_m22": m22}, pairs, "target", flat)
    assert_allclose(moved[:, 0], (1 + m22) / 2)
    assert_allclose(moved[:, 1], (1 - m22) / 2)
    assert_allclose(moved[:, 2], 1.0)


def test_a_surface_that_depolarizes_all_light_moves_towards_a_mirror(
    tank: Survey,
) -> None:
    text = "targets.0.mueller"
    case = case_of(tank.with_({text: "ideal-depolarizer"}), water_properties(tank))
    kept = np.array([0.4, 1.0])
    found = _fractions(
        case, {"target_m22": kept}, ("VV", "RR", "RL", "PP", "PM"), "target",
        lambda value: np.broadcast_to(value, (2,)),
    )  # fmt: skip
    # A mirror keeps V, and turns right into left and +45 degrees into -45 degrees.
    same, other = (1 + kept) / 2, (1 - kept) / 2
    assert_allclose(found, np.stack([same, other, same, other, same], axis=1))


def looks_of(tank: Survey, **changed: np.ndarray) -> Looks:
    values: dict[str, Any] = {
        "absorption": np.array([0.1, 0.3]), "scattering": np.array([0.25, 0.5]),
        "baseline": np.array([0.1, 0.1]), "tilt": np.array([0.05, 0.04]),
        "cross_tilt": np.array([0.0, 0.01]), "standoff": np.array([0.0, 0.2]),
        "radius": np.array([0.02, 0.02]), "acceptance": np.array([0.06, 0.05]),
        "back": np.array([[1.0, 2.0], [1.0, 2.0]]),
    }  # fmt: skip
    return Looks(**values | changed)


def test_columns_are_integrals_of_the_overlap(tank: Survey) -> None:
    water = water_properties(tank)
    looks = looks_of(tank)
    depth = np.array([1.0, 2.0])
    frequency = np.array([10e6, 80e6])
    found = light.columns(tank, water, looks, depth=depth, frequency=frequency)
    rate = 4 * np.pi * frequency * water.group_index / 299792458.0
    vsf = water.backscatter_vsf / water.scattering * looks.scattering
    for n, end in enumerate((1.0, 2.0, 60.0)):
        # In steps of the logarithm of the depth.
        z = np.geomspace(5e-3, end, 3001)
        overlap = np.exp(light._log_overlap(tank, water, looks, z)) * z
        mean = vsf * simpson(overlap, x=np.log(z), axis=1)
        assert_allclose(found.mean[:, n], mean, rtol=3e-3)
        for f in range(2):
            turn = np.exp(1j * rate[f] * z)
            expected = vsf * simpson(overlap * turn, x=np.log(z), axis=1)
            assert np.all(np.abs(found.water[:, n, f] - expected) < 3e-3 * mean)
