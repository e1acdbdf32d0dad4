"""Rules of the fit of shared parameters: limits of steps, rounds and choices."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from joint_states import shared_state
from numpy.testing import assert_allclose

from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import estimate, problem, shared
from amulor.rejection.joint.overlap import Shape
from amulor.rejection.joint.priors import NONE, Shared, layout_of
from amulor.rejection.joint.problem import Problem
from amulor.rejection.joint.samples import Pixels
from amulor.rejection.joint.shared import InitialFit

NOTHING: Any = None
ONES = np.ones(3, dtype=np.complex128)


def pixels_of(count: int, trends: int = 3) -> Pixels:
    """Return samples of ones; nothing else of them is read."""
    shape = count, 2, 3
    ones = np.ones(shape)
    return Pixels(
        signal=ones.astype(complex),
        covariance=Covariance(ones, ones, 0 * ones),
        usable=ones > 0,
        interpolation=np.ones((count, 1)),
        offset=np.zeros(count),
        shortest=np.zeros(count),
        longest=np.ones(count),
        depths=np.zeros((count, 3)),
        trends=np.ones((count, trends)),
    )


def state_of(**changed: Any) -> Shared:
    values: dict[str, Any] = {
        "shape": Shape(0.3, 0.05, 0.7, np.zeros(2), np.array([1.0, 2.0]), np.zeros(2)),
        "shot_departure": np.zeros((2, 3), dtype=complex),
        "trend": np.zeros(3),
        "turn_width": 0.02,
    }
    return shared_state(**values | changed)


@pytest.fixture(autouse=True)
def no_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace tables by the shape that they belong to."""
    for module in (problem, shared):
        monkeypatch.setattr(module, "table_of", lambda frame, shape, deepest: shape)


def problem_of(targets: int = 4, shots: int | None = 5) -> Problem:
    of_shots = None if shots is None else pixels_of(shots)
    return Problem(NOTHING, pixels_of(targets), of_shots, ONES, 3.0)


def test_a_step_moves_each_group_of_parameters() -> None:
    state = state_of()
    layout = layout_of(state)
    step = 0.01 * np.arange(1.0, 1 + layout.size)
    moved = problem_of().moved(state, step, layout)
    assert_allclose(moved.strength, [0.51, 0.22])
    # Logarithms of three coefficients, the axis, the knots, and the drift.
    assert moved.shape.reduced_attenuation == pytest.approx(0.3 * np.exp(0.03))
    assert moved.shape.spread == pytest.approx(0.05 * np.exp(0.04))
    assert moved.shape.forward_scattering == pytest.approx(0.7 * np.exp(0.05))
    # Three standard deviations of the axis are its limit.
    assert_allclose(moved.shape.turn, [0.06, 0.06])
    assert_allclose(moved.shape.correction, [0.08, 0.09])
    assert_allclose(moved.trend, [0.1, 0.11, 0.12])
    water = 0.01 * np.arange(13, 25).reshape(2, 2, 3)
    assert_allclose(moved.departure, water[0] + 1j * water[1])
    echo = 0.01 * np.arange(25, 31).reshape(2, 3)
    assert_allclose(moved.echo, echo[0] + 1j * echo[1])
    shots = 0.01 * np.arange(31, 43).reshape(2, 2, 3)
    assert_allclose(moved.shot_departure, shots[0] + 1j * shots[1])
    assert moved.shot_change == pytest.approx(0.43)
    table: Any = moved.table
    assert table is moved.shape


def test_steps_have_their_limits() -> None:
    state = state_of()
    layout = layout_of(state)
    for sign in (1.0, -1.0):
        moved = problem_of().moved(state, sign * np.full(layout.size, 5.0), layout)
        # A factor of e for coefficients, 0.3 for drifts, e for the shots.
        factor = np.exp(sign)
        assert moved.shape.reduced_attenuation == pytest.approx(0.3 * factor)
        assert moved.shape.spread == pytest.approx(0.05 * factor)
        assert moved.shape.forward_scattering == pytest.approx(0.7 * factor)
        assert_allclose(moved.trend, sign * 0.3)
        assert_allclose(moved.shape.turn, sign * 0.06)
        assert moved.shot_change == pytest.approx(sign)
        # No water has a negative strength.
        assert_allclose(moved.strength, [5.5, 5.2] if sign > 0 else 0.0)
    # A step of the first parameters leaves the others.
    few = problem_of().moved(state, np.full(layout.rigid, 0.1), layout)
    assert_allclose(few.shape.correction, 0)
    assert_allclose(few.departure, 0)
    bare = state_of(shot_departure=np.zeros((0, 3), dtype=complex))
    moved = problem_of().moved(
        bare, np.full(layout_of(bare).size, 0.1), layout_of(bare)
    )
    assert moved.shot_change == 0.0


def test_shots_have_no_time() -> None:
    whole = problem_of()
    assert whole.shots is not None
    assert_allclose(whole.shots.trends, np.zeros((5, 3)))
    empty = Problem(NOTHING, pixels_of(0), pixels_of(5), ONES, 3.0)
    assert empty.shots is not None
    assert empty.shots.trends.shape == (5, 0)


def test_problems_are_copied_with_their_parts() -> None:
    whole = problem_of()
    part = whole.part(np.array([2, 0]))
    assert len(part.targets) == 2
    assert part.shots is not None
    assert whole.part(np.array([1]), shots=False).shots is None
    assert whole.at_rest().still
    assert whole.at_rest().part(np.array([1])).still
    assert not whole.still
    assert len(whole.of(pixels_of(1)).targets) == 1
    fewer = whole.with_shots(pixels_of(2))
    assert fewer.shots is not None
    assert len(fewer.shots) == 2
    assert fewer.deepest == 3.0


@pytest.mark.parametrize(("width", "turns"), [(0.0, 0), (1e-3, 2)])
@pytest.mark.parametrize("targets", [0, 4])
@pytest.mark.parametrize("shots", [None, 5])
def test_starting_values_have_the_parameters_of_the_problem(
    monkeypatch: pytest.MonkeyPatch,
    width: float,
    turns: int,
    targets: int,
    shots: int | None,
) -> None:
    shape = Shape(0.4, 0.02, 1.0, np.zeros(0), np.zeros(0))
    asked: list[Any] = []

    def start(frame: Any, targets: Any, chosen: Any, **_: Any) -> tuple[Any, ...]:
        asked.append(chosen)
        return shape, np.array([0.3, 0.1])

    monkeypatch.setattr(shared, "start", start)
    whole = problem_of(targets, shots)
    for by_shots in (False, True):
        state = shared.first(whole, width, by_shots=by_shots)
        assert asked[-1] is (whole.shots if by_shots else None)
    assert state.shape.turn.shape == (turns,)
    assert state.turn_width == width
    assert state.trend.shape == (3 if targets else 0,)
    doubts = 2 if targets and shots else 0
    assert state.shot_departure.shape == (doubts, 3)
    assert state.departure.shape == (2, 3)
    assert (state.noise_scale, state.fluctuation, state.shot_change) == (1.0, 0.0, 0.0)
    assert (state.widths, state.evidence) == (NONE, 0.0)
    assert state.judged.all()
    assert np.isnan(state.misfit)


@pytest.mark.parametrize(("left", "water"), [(0.0199, True), (0.0201, False)])
@pytest.mark.parametrize(("count", "looked"), [(200, 64), (10, 10)])
def test_a_scan_is_mostly_water_if_water_explains_all_but_two_percent(
    monkeypatch: pytest.MonkeyPatch, left: float, water: bool, count: int, looked: int
) -> None:
    monkeypatch.setattr(shared, "first", lambda *_, **__: state_of())
    sizes: list[int] = []
    steps: list[Any] = []

    def local(self: Any, state: Shared, paths: Any) -> Any:
        return None

    def normal(self: Any, state: Shared, *_: Any) -> Any:
        sizes.append(len(self.shots))
        dark = not state.strength.any()
        return SimpleNamespace(square=1000.0 if dark else 1000.0 * left)

    def descend(self: Any, state: Shared, number: int, **words: Any) -> Any:
        steps.append((number, words))
        return state, None

    for name, function in (("local", local), ("normal", normal), ("descend", descend)):
        monkeypatch.setattr(Problem, name, function)
    whole = problem_of(0, count)
    assert shared.is_mostly_water(whole, 0.0) is water
    assert sizes == [looked, looked]
    assert steps == [(3, {"free": False})]


def fitted(
    monkeypatch: pytest.MonkeyPatch,
    *,
    mostly: bool = False,
    evidence: float = 0.0,
    misfit: float = 1.0,
    targets: int = 4,
    shots: int | None = 5,
    costs: tuple[float, float] = (1.0, 2.0),
) -> tuple[Shared, list[Any]]:
    """Return the state that a fit chooses, and the fits that it makes."""
    made: list[Any] = []
    states = iter(
        state_of(evidence=evidence, misfit=misfit, trend=np.full(3, number))
        for number in range(4)
    )

    def begin(whole: Problem, width: float, *, by_shots: bool) -> Any:
        made.append(("begin", len(whole.targets), by_shots))
        return InitialFit(whole, state_of(), np.zeros(0))

    def with_departures(initial: InitialFit, *, neighbors: bool = True) -> Any:
        made.append(("fit", neighbors))
        return replace(initial, state=next(states))

    monkeypatch.setattr(shared, "is_mostly_water", lambda *_: mostly)
    monkeypatch.setattr(shared, "begin", begin)
    monkeypatch.setattr(shared, "_with_departures", with_departures)
    waiting = iter(costs)
    monkeypatch.setattr(Problem, "cost", lambda self, state: next(waiting))
    found = shared.fit(
        NOTHING, pixels_of(targets), None if shots is None else pixels_of(shots),
        transfer=ONES, deepest=3.0,
    )  # fmt: skip
    return found, made


def test_a_scan_with_shots_starts_from_them(monkeypatch: pytest.MonkeyPatch) -> None:
    found, made = fitted(monkeypatch, mostly=True)
    assert made == [("begin", 4, True), ("fit", True)]
    assert found.trend[0] == 0


@pytest.mark.parametrize(
    ("evidence", "misfit", "taken"),
    [(10.0, 1.199, True), (10.001, 1.0, False), (0.0, 1.2, False)],
)
def test_water_alone_is_taken_where_it_fits(
    monkeypatch: pytest.MonkeyPatch, evidence: float, misfit: float, taken: bool
) -> None:
    words: dict[str, Any] = {"shots": None, "evidence": evidence, "misfit": misfit}
    found, made = fitted(monkeypatch, mostly=True, **words)
    # All pixels are shots of water then, of which none is a target.
    assert made[:2] == [("begin", 0, True), ("fit", True)]
    assert (len(made) == 2) == taken
    assert (found.trend[0] == 0) == taken
    if not taken:
        assert made[2] == ("begin", 4, False)
    _, made = fitted(monkeypatch, mostly=False, **words)
    assert made[0] == ("begin", 4, False)


@pytest.mark.parametrize(("evidence", "again"), [(9.99, False), (10.01, True)])
def test_departures_are_fitted_again_with_drift_as_noise(
    monkeypatch: pytest.MonkeyPatch, evidence: float, again: bool
) -> None:
    found, made = fitted(monkeypatch, evidence=evidence)
    assert made[1:] == [("fit", True)] + [("fit", False)] * again
    assert found.trend[0] == 0
    if again:
        # The likelier one is taken.
        found, _ = fitted(monkeypatch, evidence=evidence, costs=(2.0, 1.0))
        assert found.trend[0] == 1
    _, made = fitted(monkeypatch, evidence=evidence, targets=0)
    assert len(made) == 2


def rounds(
    monkeypatch: pytest.MonkeyPatch, scatters: list[tuple[float, float]],
    *, neighbors: bool = True, cleaner: int = 0,
) -> tuple[Shared, list[Any]]:  # fmt: skip
    """Return the state after rounds whose fluctuation and noise are given."""
    told: list[Any] = []
    waiting = iter(scatters)
    clean = [problem_of() for _ in range(cleaner)]

    def scattered(self: Problem, state: Shared, paths: Any, *, neighbors: bool) -> Any:
        told.append(("scatter", self.still, neighbors))
        fluctuation, scale = next(waiting)
        return replace(state, fluctuation=fluctuation, noise_scale=scale), None

    def descend(self: Problem, state: Shared, steps: int, **words: Any) -> Any:
        told.append(("descend", steps, words["free"], state.widths))
        return replace(state, widths=(1.0, 1.0, 1.0, 1.0, 1.0)), words["paths"]

    def cleaned(whole: Problem, state: Shared, estimates: Any) -> Any:
        told.append("clean")
        return (clean.pop() if clean else whole), state

    monkeypatch.setattr(Problem, "scattered", scattered)
    monkeypatch.setattr(Problem, "descend", descend)
    monkeypatch.setattr(shared, "_cleaned", cleaned)
    whole = problem_of()
    whole.frame = SimpleNamespace(  # type: ignore[assignment]
        quantiles=lambda shape, share: 3 * share
    )
    initial = InitialFit(whole, state_of(), np.zeros(4))
    found = shared._with_departures(initial, neighbors=neighbors)
    return found.state, told


def test_rounds_end_where_noise_and_fluctuation_are_steady(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The second round changes them by 2 %, and keeps those of its fit.
    state, told = rounds(monkeypatch, [(0.1, 2.0), (0.1019, 2.039)])
    assert (state.fluctuation, state.noise_scale) == (0.1, 2.0)
    assert told == [("scatter", True, True), ("descend", 10, True, NONE),
                    ("scatter", False, True), "clean"]  # fmt: skip
    for second in ((0.1022, 2.0), (0.1, 2.042)):
        state, told = rounds(monkeypatch, [(0.1, 2.0), second, second])
        assert (state.fluctuation, state.noise_scale) == second
    # Four rounds at most.
    growing = [(0.1 * 2**k, 1.0) for k in range(5)]
    state, told = rounds(monkeypatch, growing)
    assert sum(one[0] == "descend" for one in told) == 4
    assert state.fluctuation == 0.8
    # A round that removed outliers is followed by another one.
    _, told = rounds(monkeypatch, [(0.1, 2.0)] * 4, cleaner=2)
    assert told.count("clean") == 3
    # Where a drift counts as random, no sample is an outlier.
    _, told = rounds(monkeypatch, [(0.1, 2.0)] * 3, neighbors=False)
    assert "clean" not in told
    assert told[0] == ("scatter", True, False)


def test_knots_stand_at_fractions_of_the_water(monkeypatch: pytest.MonkeyPatch) -> None:
    state, _ = rounds(monkeypatch, [(0.1, 1.0)] * 2)
    shares = [0.002, 0.01, 0.03, 0.08, 0.18, 0.32, 0.5, 0.68, 0.82, 0.92, 0.975]
    assert_allclose(state.shape.knots, 3 * np.array(shares))
    assert_allclose(state.shape.correction, np.zeros(11))


def test_outlying_samples_are_searched_for_up_to_four_times(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[Any] = []
    allowed = np.array([[True, False, True]] * 2)

    def without_outliers(pixels: Any, *_: Any) -> Any:
        told.append(_[2])
        return SimpleNamespace(
            pixels=pixels_of(4), estimates=SimpleNamespace(path=np.zeros(4))
        )

    monkeypatch.setattr(shared, "without_outliers", without_outliers)
    monkeypatch.setattr(shared, "typical_misfit", lambda estimates: 1.0)
    monkeypatch.setattr(shared, "outlier_candidates", lambda *_: allowed)
    monkeypatch.setattr(Problem, "scattered", lambda self, state, paths: (state, None))
    whole = problem_of()
    judged = np.array([[True, True, False]] * 2)
    cleaner, state = shared._cleaned(whole, state_of(judged=judged), NOTHING)
    assert len(told) == 4
    assert cleaner is not whole
    # A sample that was once found wrong everywhere is no outlier later.
    assert_allclose(state.judged, [[True, False, False]] * 2)
    monkeypatch.setattr(
        shared, "without_outliers",
        lambda pixels, *_: SimpleNamespace(pixels=pixels, estimates=None),
    )  # fmt: skip
    same, _ = shared._cleaned(whole, state_of(), NOTHING)
    assert same is whole


def test_the_first_fit_takes_256_pixels_and_leaves_outliers_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[Any] = []

    def descend(self: Problem, state: Shared, steps: int, **words: Any) -> Any:
        told.append((len(self.targets), self.shots is not None, self.still, steps,
                     words["free"]))  # fmt: skip
        return state, np.zeros(len(self.targets))

    inlier = np.arange(300) % 3 > 0
    monkeypatch.setattr(shared, "first", lambda *_, **__: state_of())
    monkeypatch.setattr(shared, "are_inliers", lambda estimates: inlier)
    monkeypatch.setattr(Problem, "descend", descend)
    monkeypatch.setattr(
        Problem, "scattered",
        lambda self, state: (state, SimpleNamespace(path=np.arange(300.0))),
    )  # fmt: skip
    for by_shots in (True, False):
        told.clear()
        found = shared.begin(problem_of(300), 0.0, by_shots=by_shots)
        assert told == [(256, by_shots, True, 14, False),
                        (200, by_shots, True, 14, False)]  # fmt: skip
        # The shots come back, and rates are no errors any more.
        assert found.problem.shots is not None
        assert not found.problem.still
        assert len(found.problem.targets) == 200


def rows_of(azimuth: np.ndarray, usable: np.ndarray) -> Any:
    ones = np.ones(usable.shape)
    return SimpleNamespace(
        azimuth=azimuth, elevation=2 * azimuth, usable=usable,
        covariance=Covariance(ones, ones, 0 * ones),
    )  # fmt: skip


def test_the_extent_of_a_scan_is_that_of_all_its_rows() -> None:
    rng = np.random.default_rng(1)
    azimuth = rng.uniform(-1, 1, (5, 4))
    usable = np.zeros((3, 2, 5, 4), dtype=bool)
    # Two frequencies or more, in any of the channels.
    usable[0, 0], usable[1, 1, :, :2] = True, True
    scan: Any = SimpleNamespace(
        bands=[(0, 2), (2, 5)],
        tile=lambda a, b: rows_of(azimuth[a:b], usable[:, :, a:b]),
    )
    found = estimate._extent_of(scan)
    assert_allclose(
        found.azimuth, [azimuth.min(), azimuth.max(), azimuth.mean()], rtol=1e-12
    )
    assert_allclose(found.elevation, 2 * found.azimuth)
    assert found.enough.tolist() == [[True, True, False, False]] * 5


def test_pixels_of_tiles_are_joined_in_their_order() -> None:
    parts = [replace(pixels_of(2), offset=np.array([1.0, 2.0])),
             replace(pixels_of(1), offset=np.array([3.0]))]  # fmt: skip
    joined = estimate._joined(parts)
    assert joined.offset.tolist() == [1, 2, 3]
    assert joined.covariance.in_phase.shape == (3, 2, 3)
    assert joined.motion is None
    assert estimate._joined(parts[:1]) is parts[0]
    moved = [replace(part, motion=np.ones((len(part), 2, 3, 2))) for part in parts]
    both = estimate._joined(moved).motion
    assert both is not None
    assert both.shape == (3, 2, 3, 2)


def test_a_scan_without_usable_pixels_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    extent = SimpleNamespace(
        azimuth=np.zeros(3), elevation=np.zeros(3), enough=np.zeros((2, 2), dtype=bool)
    )
    monkeypatch.setattr(estimate, "_extent_of", lambda scan: extent)
    monkeypatch.setattr(estimate, "shot_directions", lambda *_: np.zeros((2, 1)))
    monkeypatch.setattr(estimate, "frame_of", lambda *_: None)
    scan: Any = SimpleNamespace(head=SimpleNamespace(shots=None), bands=[])
    with pytest.raises(CubeError, match="no pixel has usable samples at two freq"):
        estimate.common_of(scan, interval=None, transfer=ONES, instrument=NOTHING)
